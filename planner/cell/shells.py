"""Draw a link that is known only as a handful of simple solids as one casting with rounded edges (metres).

The solids of a link blend into one another, as in castings; a box that a joint's axis crosses near its end becomes a
lever, round about that axis; the free end of a box along the next axis tapers, and so does that of a cylinder about its
own. So the shell stays inside the solids except for the fillets between them, and the picture shows what is checked.

The surface is the zero level of a distance function, found by surface nets: S. F. Gibson, Constrained elastic surface
nets, MICCAI 1998.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from planner.base.arrays import Array, Ints
from planner.cell.solids import Body, Box, Capsule, Frustum
from planner.cell.surfaces import TriangleSurface, rgb, rounding

CELLS, MOST_CELLS = 26, 60  # grid cells along a link's longest side, at least and, for thin solids, at most
THIN = 0.8  # × half that thickness: the largest cell
MOST_CELL = 20e-3  # m
FILLET = 0.35  # × the thinnest solid's half thickness: the fillet between solids
MOST_FILLET = 24e-3  # m
END = 0.78  # × the width of a tapered link's other end: the width of its free end
NEAR_END = 1.5  # × a box's half width: an axis this near to an end makes it round
LONG = 1.35  # a box this many times longer than wide, or 1.6 times as many than thick, becomes a lever or a limb
ALONG = 0.98  # least cosine between directions that count as parallel
COVER, LEAST_COVER = 0.62, 18e-3  # × its solid's radius: a joint cover's radius; m: smaller ones are left out
# m: how far a cover stands out, on the joint that carries the link and on the next; how far it reaches in
COVER_RISE, COVER_DEPTH = (3e-3, 2e-3), 6e-3
_STEP = 1e-4  # m, of finite differences

Distance = Callable[[Array], Array]


def casting(bodies: Sequence[Body], axes: Array) -> TriangleSurface:
    """Shell of a link's solids: boxes, cylinders, capsules and balls.

    axes (k, 6)  of the joints that carry the link and that it carries: a point on each and its direction, in the frame
                 of the bodies
    """
    parts = [_in_frame(_shaped(body, axes), body.T_frame_solid) for body in bodies]
    low, high = _bounds(bodies)
    side = float((high - low).max())
    thin = min(_half_thickness(body) for body in bodies)
    step = float(np.clip(min(side / CELLS, THIN * thin), side / MOST_CELLS, MOST_CELL))
    fillet = max(min(FILLET * thin, MOST_FILLET), 1.1 * step)  # one that the net can show

    def whole(points: Array) -> Array:
        out = parts[0](points)
        for part in parts[1:]:
            out = _melted(out, part(points), fillet)
        return out

    vertices, triangles = _net(whole, low - 2.0 * step, high + 2.0 * step, step)
    normals = _slope(whole, vertices)
    for _ in range(3):  # project onto the surface, which the net only approximates
        vertices = vertices - np.clip(whole(vertices), -step, step)[:, None] * normals
        normals = _slope(whole, vertices)
    nearest = np.argmin([part(vertices) for part in parts], axis=0)
    colours = np.array([rgb(body.colour) for body in bodies])[nearest]
    return TriangleSurface(vertices, normals, triangles, colours)


def covers(bodies: Sequence[Body], axes: Array, colour: str) -> list[Body]:
    """Covers on both ends of solids that are round about an axis across the link: flat discs, in the bodies' frame."""
    found: list[Body] = []
    shaped = [_in_frame(_shaped(body, axes), body.T_frame_solid) for body in bodies]
    for body in bodies:
        solid, T = body.solid, body.T_frame_solid
        back = np.linalg.inv(T)
        points, ways = axes[:, :3] @ back[:3, :3].T + back[:3, 3], axes[:, 3:] @ back[:3, :3].T
        for which, (point, way) in enumerate(zip(points, ways, strict=True)):
            k = int(np.argmax(np.abs(way)))
            if abs(way[k]) < ALONG:
                continue
            if isinstance(solid, Box):
                half = 0.5 * np.asarray(solid.size)
                aside = np.delete(half - np.abs(point), k)
                radius, ends, across = (
                    COVER * float(aside.min()),
                    (-half[k], half[k]),
                    half[k] < 1.3 * float(aside.min()),
                )
            elif isinstance(solid, Frustum):
                near = k == 2 and np.hypot(*point[:2]) < 0.1 * solid.bottom
                radius, ends = (COVER * solid.bottom if near else 0.0), (0.0, solid.height)
                across = len(axes) > 1 or solid.height < 1.6 * solid.bottom
            else:
                continue
            if radius < LEAST_COVER or not across:
                continue
            rise = COVER_RISE[min(which, 1)]
            for end, out in zip(ends, (-1.0, 1.0), strict=True):
                place = np.eye(4)
                place[:3, :3] = np.roll(np.eye(3), 2 - k, axis=1)
                if out < 0.0:
                    place[:3, :3] = place[:3, :3] @ np.diag([1.0, -1.0, -1.0])
                place[:3, 3] = point
                place[k, 3] = end - out * COVER_DEPTH
                disc = Frustum(radius, 0.94 * radius, COVER_DEPTH + rise)
                T_cover = T @ place
                top = T_cover[:3, 3] + (COVER_DEPTH + rise) * T_cover[:3, 2]
                if min(float(distance(top[None])[0]) for distance in shaped) > 0.0:  # nothing else is in the way
                    found.append(Body("cover", disc, T_cover, body.link, colour=colour))
    return found


def castable(bodies: Sequence[Body]) -> bool:
    """Whether a shell can be made for these bodies."""
    return bool(bodies) and all(isinstance(body.solid, Box | Frustum | Capsule) for body in bodies)


# ----------------------------------------------------------------------------------------------------
# Distance functions of the shaped solids.


def _shaped(body: Body, axes: Array) -> Distance:
    solid, T = body.solid, body.T_frame_solid
    back = np.linalg.inv(T)
    points, ways = axes[:, :3] @ back[:3, :3].T + back[:3, 3], axes[:, 3:] @ back[:3, :3].T
    if isinstance(solid, Capsule):
        return lambda p: _capsule(p, solid.radius, solid.length)
    if isinstance(solid, Frustum):
        return _drum(solid, points[:1], ways[:1])
    if isinstance(solid, Box):
        return _lever(np.asarray(solid.size), points, ways)
    raise TypeError(f"{body.name} has no shell")


def _capsule(p: Array, radius: float, length: float) -> Array:
    z = p[:, 2] - np.clip(p[:, 2], -0.5 * length, 0.5 * length)
    return np.asarray(np.sqrt(p[:, 0] ** 2 + p[:, 1] ** 2 + z**2) - radius)


def _drum(solid: Frustum, points: Array, ways: Array) -> Distance:
    """A cylinder; one about the axis of the joint that carries the link tapers towards its end away from that joint."""
    about = abs(ways[0, 2]) > ALONG and float(np.hypot(*points[0, :2])) < 0.1 * solid.bottom if len(ways) else False
    edge = 2.0 * rounding(solid)
    middle = 0.5 * solid.height
    tall = solid.height > solid.bottom
    narrow = END if about and tall else 1.0
    up = 1.0 if not len(ways) or ways[0, 2] >= 0.0 else -1.0

    def distance(p: Array) -> Array:
        z = p[:, 2] - middle
        share = np.clip(z / solid.height + 0.5, 0.0, 1.0)
        radius = solid.bottom + share * (solid.top - solid.bottom)
        end = share if up > 0.0 else 1.0 - share
        radius = radius * (1.0 - (1.0 - narrow) * end**2)
        return _rounded(np.hypot(p[:, 0], p[:, 1]) - radius, np.abs(z) - middle, edge)

    return distance


def _lever(size: Array, points: Array, ways: Array) -> Distance:
    """A box: round about the axes that cross it near its ends, or else tapered along an axis that runs lengthwise."""
    half = 0.5 * size
    long = int(np.argmax(half))
    rest = [k for k in range(3) if k != long]
    edge = min(0.45 * float(half.min()), 1.6 * MOST_FILLET)
    if half[long] < LONG * max(half[rest]) and half[long] < LONG * 1.6 * min(half[rest]):
        return lambda p: _rounded_box(p, half, edge)
    for across in rest:
        ends = _hubs(points, ways, half, long, across)
        if ends is not None:
            return _plate(half, long, across, ends)
    along = [k for k, way in enumerate(ways) if abs(way[long]) > ALONG]
    if not along:
        return lambda p: _rounded_box(p, half, edge)
    towards = np.sign(points[along[-1], long] - 0.0) or np.sign(ways[along[-1], long])

    def limb(p: Array) -> Array:
        share = np.clip(0.5 + 0.5 * towards * p[:, long] / half[long], 0.0, 1.0)
        narrow = 1.0 - (1.0 - END) * share**1.5
        q = np.abs(p) - half
        for k in rest:
            q[:, k] = np.abs(p[:, k]) - half[k] * narrow
        q += edge
        return np.asarray(np.linalg.norm(np.maximum(q, 0.0), axis=1) + np.minimum(q.max(axis=1), 0.0) - edge)

    return limb


def _hubs(points: Array, ways: Array, half: Array, long: int, across: int) -> list[tuple[float, float]] | None:
    """Positions along a box of the axes that cross it, with the radii about them; None if none does near an end."""
    third = 3 - long - across
    found = []
    for point, way in zip(points, ways, strict=True):
        inside = 0.0 < half[long] - abs(point[long]) < NEAR_END * half[third] and abs(point[third]) < 0.5 * half[third]
        if abs(way[across]) > ALONG and inside:
            found.append(float(point[long]))
    if not found:
        return None
    radius = float(half[third])
    low, high = min(found), max(found)
    if high - low < 0.5 * half[long]:  # one hub: the other end is a plain one
        other = -np.sign(low) * (half[long] - END * radius)
        return [(low, min(radius, half[long] - abs(low))), (float(other), END * radius)]
    return [(low, min(radius, half[long] + low)), (high, min(END * radius, half[long] - high))]


def _plate(half: Array, long: int, across: int, ends: list[tuple[float, float]]) -> Distance:
    """The area that two circles in a plane enclose between them, as thick as the box."""
    (a, ra), (b, rb) = ends
    third = 3 - long - across
    edge = min(0.5 * float(half[across]), 0.5 * min(ra, rb))
    apart = (b - a) or 1.0

    def distance(p: Array) -> Array:
        share = np.clip((p[:, long] - a) / apart, 0.0, 1.0)
        round_ = np.hypot(p[:, long] - (a + share * (b - a)), p[:, third]) - (ra + share * (rb - ra))
        return _rounded(round_, np.abs(p[:, across]) - half[across], edge)

    return distance


def _rounded_box(p: Array, half: Array, edge: float) -> Array:
    q = np.abs(p) - half + edge
    return np.asarray(np.linalg.norm(np.maximum(q, 0.0), axis=1) + np.minimum(q.max(axis=1), 0.0) - edge)


def _rounded(a: Array, b: Array, edge: float) -> Array:
    """Distance from the region where both a and b are below zero, the edge between them rounded."""
    a, b = a + edge, b + edge
    return np.asarray(np.hypot(np.maximum(a, 0.0), np.maximum(b, 0.0)) + np.minimum(np.maximum(a, b), 0.0) - edge)


def _melted(a: Array, b: Array, fillet: float) -> Array:
    """Distance from the union of both, with a fillet between them: outside both by a quarter of it at most."""
    share = np.maximum(fillet - np.abs(a - b), 0.0) / fillet
    return np.asarray(np.minimum(a, b) - 0.25 * fillet * share**2)


def _in_frame(distance: Distance, T: Array) -> Distance:
    return lambda p: distance((p - T[:3, 3]) @ T[:3, :3])


def _half_thickness(body: Body) -> float:
    solid = body.solid
    if isinstance(solid, Box):
        return 0.5 * min(solid.size)
    if isinstance(solid, Frustum):
        return min(solid.bottom, solid.top, 0.5 * solid.height)
    return solid.radius if isinstance(solid, Capsule) else 0.0


def _bounds(bodies: Sequence[Body]) -> tuple[Array, Array]:
    """Corners of a box around all solids."""
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    for body in bodies:
        solid, T = body.solid, body.T_frame_solid
        middle = np.zeros(3)
        if isinstance(solid, Box):
            half = 0.5 * np.asarray(solid.size)
        elif isinstance(solid, Frustum):
            wide = max(solid.bottom, solid.top)
            half, middle = np.array([wide, wide, 0.5 * solid.height]), np.array([0.0, 0.0, 0.5 * solid.height])
        elif isinstance(solid, Capsule):
            half = solid.radius + np.array([0.0, 0.0, 0.5 * solid.length])
        else:
            raise TypeError(f"{body.name} has no shell")
        reach, centre = np.abs(T[:3, :3]) @ half, T[:3, :3] @ middle + T[:3, 3]
        low, high = np.minimum(low, centre - reach), np.maximum(high, centre + reach)
    return low, high


# ----------------------------------------------------------------------------------------------------
# The surface of a distance function.


def _slope(distance: Distance, points: Array) -> Array:
    """Unit gradients (n, 3)."""
    out = np.column_stack([distance(points + step) - distance(points - step) for step in _STEP * np.eye(3)])
    return np.asarray(out / np.maximum(np.linalg.norm(out, axis=1), 1e-12)[:, None])


def _net(distance: Distance, low: Array, high: Array, step: float) -> tuple[Array, Ints]:
    """Vertices (n, 3), one in each cell of a grid that the surface crosses, and triangles (m, 3) between them."""
    shape = np.ceil((high - low) / step).astype(int) + 1
    grid = np.stack(np.meshgrid(*(np.arange(k) for k in shape), indexing="ij"), axis=-1).reshape(-1, 3)
    value = distance(low + step * grid).reshape(shape)
    inside = value < 0.0
    cells = shape - 1
    total, count = np.zeros((*cells, 3)), np.zeros(cells)
    quads = []
    number = np.full(cells, -1)
    crossings = []
    for k in range(3):
        u, v = (k + 1) % 3, (k + 2) % 3
        here = tuple(slice(None, -1) if j == k else slice(None) for j in range(3))
        there = tuple(slice(1, None) if j == k else slice(None) for j in range(3))
        at = np.argwhere(inside[here] != inside[there])
        a, b = value[here][tuple(at.T)], value[there][tuple(at.T)]
        point = at.astype(float)
        point[:, k] += a / (a - b)
        around = []
        for du, dv in ((0, 0), (-1, 0), (-1, -1), (0, -1)):
            cell = at.copy()
            cell[:, u] += du
            cell[:, v] += dv
            around.append(cell)
            np.add.at(total, tuple(cell.T), point)
            np.add.at(count, tuple(cell.T), 1.0)
        crossings.append((around, a < 0.0))
    used = np.argwhere(count > 0.0)
    number[tuple(used.T)] = np.arange(len(used))
    for around, outward in crossings:
        corner = np.column_stack([number[tuple(cell.T)] for cell in around])
        corner = np.where(outward[:, None], corner, corner[:, ::-1])
        quads.append(corner)
    quad = np.concatenate(quads)
    vertices = low + step * total[tuple(used.T)] / count[tuple(used.T)][:, None]
    return vertices, np.vstack([quad[:, [0, 1, 2]], quad[:, [0, 2, 3]]])
