"""Lower bounds of a point's margin by its height, so that points beneath the nozzle's tip can be skipped.

A bounding ball of points on a bead reaches above the bead, so a search by balls opens everything around the nozzle. By
height above the plane through the tip, perpendicular to the nozzle's axis, most points can be ruled out: `HeightBounds`
holds, for each height, the least margin (see `nozzle`) that a point at that height or lower can have, wherever it is.

The slower the axis turns, the longer a bound holds: while the nozzle slides along a plane, nothing rises. All values
are in the part frame, in metres; n counts samples, b bodies, h heights, m nodes of the tree.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from planner.base.arrays import Array
from planner.base.compiled import inner_njit, njit
from planner.cell.solids import BOX, CAPSULE, FRUSTUM
from planner.collision.point_tree import FROM_THE_START, SolidNumbers, solid_distance
from planner.verify.checks import FAR

_STEP = 1e-5  # m between heights
_ABOVE = 4e-3  # m above the tip: higher points are not ruled out by height
_COAXIAL = 1e-9  # m or rad


class HeightBounds(NamedTuple):
    """least (b, h) [m]: the least margin of points whose height is at most low + _STEP * column; floor (b) [m]: height of
    each body's lowest point; widest (m) [m]: greatest radius of the points of each node."""

    least: Array
    floor: Array
    widest: Array
    low: float


@njit
def height_bounds(tree, solids, rule, deep, nearest, fine):
    """Bounds of all bodies, from `deep` [m] beneath the tip upwards.

    tree: `TreeArrays`; solids: `HeadSolids`; rule: `TipRule` with the least slack along the path; nearest [m]:
    everything nearer to the tip is one cell; fine: a cell's height relative to its distance from the tip, and its width
    in rad.
    """
    count, size = len(solids.kind), int(np.ceil((deep + _ABOVE) / _STEP)) + 1
    least, floor = np.empty((count, size)), np.empty(count)
    for j in range(count):
        T = solids.T_solid_frame[j]
        floor[j] = _lowest(solids, j)
        c = solids.centre[j]
        far = np.sqrt(c[0] ** 2 + c[1] ** 2 + c[2] ** 2) + solids.reach[j]
        round_ = solids.kind[j] == FRUSTUM or solids.kind[j] == CAPSULE
        if round_ and 1.0 - abs(T[2, 2]) < _COAXIAL and T[0, 3] ** 2 + T[1, 3] ** 2 < _COAXIAL**2:
            _by_cells(solids, j, far, rule, deep, nearest, fine, least[j])
        else:
            least[j] = -np.inf
        for i in range(size):
            least[j, i] = max(least[j, i], floor[j] - (i * _STEP - deep) - rule.clearance)
    return HeightBounds(least, floor, _widest(tree), -deep)


@inner_njit
def _widest(tree):
    """The greatest radius of the points of each node; children are stored after their parents."""
    left, right = tree.left, tree.right
    out = np.zeros(len(left))
    for node in range(len(left) - 1, -1, -1):
        if left[node] >= 0:
            out[node] = max(out[left[node]], out[right[node]])
        else:
            for i in range(-1 - left[node], -1 - left[node] + right[node]):
                out[node] = max(out[node], tree.radius[i])
    return out


@inner_njit
def _lowest(solids, j):
    """Height of a body's lowest point above the tip, or a lower bound; the nozzle's z axis points into the part."""
    T, size, kind = solids.T_solid_frame[j], solids.size[j], solids.kind[j]
    dx, dy, dz = T[0, 2], T[1, 2], T[2, 2]  # the axis in the body's frame
    if kind == BOX:
        along = abs(dx) * size[0] + abs(dy) * size[1] + abs(dz) * size[2]
    elif kind == CAPSULE:
        along = size[0] + abs(dz) * size[1]
    elif kind == FRUSTUM:
        side = np.sqrt(dx * dx + dy * dy)
        along = max(side * size[0], side * size[1] + dz * size[2])
    else:
        return -solids.centre[j, 2] - solids.reach[j]
    return dx * T[0, 3] + dy * T[1, 3] + dz * T[2, 3] - along


@inner_njit
def _by_cells(solids, j, far, rule, deep, nearest, fine, least):
    """Fill in the bounds (h) of a body that is round about the nozzle's axis: the plane of radius and height is divided
    into cells, and the least margin within each counts from its lowest height upwards."""
    kind, size, planes, T = solids.kind[j], solids.size[j], solids.planes, solids.T_solid_frame[j]
    least[:] = np.inf
    top = len(least)
    sectors = int(np.ceil(np.pi / fine))
    away, half = 0.0, nearest
    while away - half < far + rule.clearance + FAR:
        for k in range(sectors if away > 0.0 else 1):
            angle = (k + 0.5) * np.pi / sectors
            height, r = -away * np.cos(angle), away * np.sin(angle)
            first = int(np.ceil((height - half + deep) / _STEP))
            if first >= top:
                break
            d = solid_distance(
                kind, size, planes, T[0, 0] * r - T[0, 2] * height + T[0, 3], T[1, 0] * r - T[1, 2] * height + T[1, 3],
                T[2, 0] * r - T[2, 2] * height + T[2, 3],
            )  # fmt: skip
            value = d - half - min(rule.clearance, rule.slope * (away + half) - rule.slack)
            first = max(first, 0)
            least[first] = min(least[first], value)
        away = nearest * (1.0 + 0.5 * fine) if away == 0.0 else away * (1.0 + fine)
        half = 0.75 * fine * away  # slightly more than half of a cell's diagonal
    for i in range(1, top):
        least[i] = min(least[i], least[i - 1])


@inner_njit
def rise(way, a, b, c):
    """Most that a point at the tip rises [m] and that the axis turns [rad] from sample c to any from a to b."""
    tip, rotation, path, turned = way.tip, way.rotation, way.path, way.turned
    most = 0.0
    for k in range(a, b + 1):
        up = 0.0
        for x in range(3):
            up -= (tip[c, x] - tip[k, x]) * rotation[k, x, 2]
        if k > a:  # and between samples
            up += (path[k] - path[k - 1]) * (turned[k] - turned[k - 1])
        most = max(most, up)
    return most, max(turned[c] - turned[a], turned[b] - turned[c])


@inner_njit
def least_so_high(bounds, j, height, radius, still, graze):
    """The least margin [m] that points up to a height can have if their radius is at most `radius`; still: whether some
    of them may be there from the start."""
    i = int(np.ceil((height - bounds.low) / _STEP))
    if i >= bounds.least.shape[1]:
        return -np.inf
    low = bounds.least[j, max(i, 0)] - radius
    return min(low, bounds.floor[j] - height + graze) if still else low


@inner_njit
def none_so_near(tree, solids, j, bounds, way, a, b, T, rule, target, room):
    """Whether no point has a margin below the target [m] in samples a .. b, by its distance or its height at the middle
    sample; T (4, 4) takes points into the body's frame there; rule: `TipRule` with the least slack along the path."""
    time, since, left, right = tree.time, tree.since, tree.left, tree.right
    solid = SolidNumbers(solids.kind[j], solids.size[j], solids.planes)
    c, seeing = (a + b) // 2, way.seen[b]
    p, R = way.tip[c], way.rotation[c]
    gone = max(way.path[c] - way.path[a], way.path[b] - way.path[c])
    up, turn = rise(way, a, b, c)
    nodes, waiting = room.nodes, 1
    nodes[0] = 0
    while waiting:
        waiting -= 1
        node = nodes[waiting]
        if since[node] >= seeing:
            continue
        still, reach = since[node] == FROM_THE_START, tree.reach[node]
        x, y, z = tree.centre[node]
        height = height_above(x, y, z, p, R) + reach + up + (_away(x, y, z, p) + reach) * turn
        if least_so_high(bounds, j, height, bounds.widest[node], still, rule.graze) >= target:
            continue
        if _spared(tree.centre[node], reach, reach, solid, T, p, rule, still, gone, turn, target):
            continue
        if left[node] >= 0:
            nodes[waiting], nodes[waiting + 1] = left[node], right[node]
            waiting += 2
            continue
        for i in range(-1 - left[node], -1 - left[node] + right[node]):
            if time[i] >= seeing:
                continue
            still, radius = time[i] == FROM_THE_START, tree.radius[i]
            x, y, z = tree.points[i]
            away = _away(x, y, z, p)
            height = height_above(x, y, z, p, R)
            if least_so_high(bounds, j, height + up + away * turn, radius, still, rule.graze) >= target:
                continue
            if not _spared(tree.points[i], radius, 0.0, solid, T, p, rule, still, gone, turn, target):
                return False
    return True


@inner_njit
def height_above(x, y, z, p, R):
    """Height of a point above the plane through the tip p (3), perpendicular to the downward z axis of R (3, 3)."""
    return (p[0] - x) * R[0, 2] + (p[1] - y) * R[1, 2] + (p[2] - z) * R[2, 2]


@inner_njit
def _away(x, y, z, p):
    return np.sqrt((x - p[0]) ** 2 + (y - p[1]) ** 2 + (z - p[2]) ** 2)


@inner_njit
def _spared(centre, radius, around, solid, T, p, rule, still, gone, turn, target):
    """Whether balls of points keep the target by their distance, wherever they are within `around` of the centre, while
    the tip moves by `gone` [m] and the nozzle turns by `turn` [rad]."""
    x, y, z = centre[0], centre[1], centre[2]
    d = solid_distance(
        solid.kind, solid.size, solid.planes,
        T[0, 0] * x + T[0, 1] * y + T[0, 2] * z + T[0, 3],
        T[1, 0] * x + T[1, 1] * y + T[1, 2] * z + T[1, 3],
        T[2, 0] * x + T[2, 1] * y + T[2, 2] * z + T[2, 3],
    )  # fmt: skip
    away = _away(x, y, z, p) + around
    low = d - radius - gone - away * turn
    if still and low + rule.graze < target:
        return False
    return low - min(rule.clearance, rule.slope * (away + gone) - rule.slack) >= target
