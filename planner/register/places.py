"""Where the nozzle can touch the bare part, clear of all else, and which places are most informative."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from planner.base.arrays import Array, ReadOnlyArrays
from planner.cell.cell import Cell, frame_from_z, rigid_inverse, turned_into
from planner.cell.solids import triangles_of
from planner.problem import Problem
from planner.register.contacts import plate_poses
from planner.register.fitting import Distance, Placement, Unknowns, rows, slopes
from planner.toolpath.bead import Toolpath
from planner.verify.bodies import CellBodies, Distances, Pair, all_at_home, pairs

# ----------------------------------------------------------------------------------------------------
# Whether arm and head are clear of everything but the place that the nozzle touches.

ROLLS = 8  # of the nozzle about its axis that are tried
_FREE, _SHARE = 1e-3, 0.1  # m between head and part, or × the height above the tip, whichever is less
_TIP = 1e-3  # m above the tip: parts of the nozzle below this may come as near as they like
_POINTS = 300  # about the number of points of the head that are checked
_ALONG = (0.25, 0.5, 0.75)  # places along the edges of the head's triangles


@dataclass(frozen=True)
class Clearance:
    """Bodies of a cell, pairs that can collide, and points (n, 3) on the head in the nozzle's frame."""

    cell: Cell
    surface: Distance
    bodies: CellBodies
    pairs: tuple[Pair, ...]
    head: Array

    @classmethod
    def of(cls, problem: Problem, cell: Cell, surface: Distance) -> Clearance:
        """For everything that can be hit in a problem's cell."""
        spec, bodies = problem.collision, CellBodies.of(cell)
        found = pairs(bodies, spec.nozzle, spec.arm)
        points, tips = [np.zeros((0, 3))], set()
        for body in cell.head:
            vertices, triangles = triangles_of(body.solid)
            edges = [(vertices[triangles[:, k]], vertices[triangles[:, k - 1]]) for k in range(3)]
            every = np.vstack([vertices, *(a + u * (b - a) for a, b in edges for u in _ALONG)])
            points.append(every @ body.T_frame_solid[:3, :3].T + body.T_frame_solid[:3, 3])
            if (points[-1][:, 2] > -_TIP).any():
                tips.add(body.name)
        # a body at rest with the part, such as a bed, may be the one touched: there the nozzle itself comes near
        near = all_at_home(bodies, (), spec.nozzle)
        found += tuple(pair for pair in near if bodies.things[pair.a].name not in tips)
        head = np.vstack(points)
        return cls(cell, surface, bodies, found, _thinned(head[head[:, 2] < -_TIP]))

    def fits(self, point: Array, normal: Array) -> list[Array]:
        """Nozzle poses (4, 4) at a place (3) of the part, along its normal (3), with the head clear of the part."""
        poses = frame_from_z(point, -normal) @ rolls()
        points = np.einsum("kij,nj->kni", poses[:, :3, :3], self.head) + poses[:, None, :3, 3]
        gap = self.surface.signed_distance(points.reshape(-1, 3)).reshape(len(poses), -1)
        return list(poses[(gap >= np.minimum(_FREE, -_SHARE * self.head[:, 2])).all(axis=1)])

    def at(self, placement: Placement, T_part_nozzle: Sequence[Array], q: Array) -> bool:
        """Whether the arm can bring the nozzle to one of these poses (4, 4) with the holder at q (k), within its joint
        limits, and nothing is hit."""
        postures, able = reached(self.cell, placement, np.array(T_part_nozzle).reshape(-1, 4, 4), q)
        full = np.hstack([postures[able], np.tile(q, (int(able.sum()), 1))])
        distances = Distances(self.bodies)
        return any(
            all(distances.of(pair, poses) >= pair.need for pair in self.pairs) for poses in self.bodies.poses(full)
        )


def _thinned(points: Array) -> Array:
    """Points (n, 3) thinned to about _POINTS, the lower ones first: they are the nearest to the part."""
    order = np.argsort(-points[:, 2], kind="stable")
    return points[order[:: max(1, len(points) // _POINTS)]]


def rolls() -> Array:
    """Turns (ROLLS, 4, 4) of the nozzle about its axis."""
    a = 2.0 * np.pi * np.arange(ROLLS) / ROLLS
    out = np.tile(np.eye(4), (ROLLS, 1, 1))
    out[:, 0, 0], out[:, 0, 1], out[:, 1, 0], out[:, 1, 1] = np.cos(a), -np.sin(a), np.sin(a), np.cos(a)
    return out


def reached(cell: Cell, placement: Placement, T_part_nozzle: Array, q: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Postures (n, m, joints) of the arm for nozzle poses (n, 4, 4) on the part, the holder at q (k), and whether they
    exist within joint limits (n, m): all branches, with given joints at the positions of `_stands`."""
    na, given = len(cell.arm), cell.given
    T_world_part = plate_poses(cell, q[None])[0] @ placement.T_plate_part
    T_world_part[:3, 3] += placement.shift
    T_base_part = rigid_inverse(cell.T_world_base) @ T_world_part
    T = T_base_part @ T_part_nozzle @ rigid_inverse(cell.T_flange_nozzle)
    found = [cell.inverse.solve(T, np.tile(at, (len(T), 1)) if given else None) for at in _stands(cell, given)]
    postures, exists = (np.concatenate(each, axis=1) for each in zip(*found, strict=True))
    low, high = cell.limits.q_min[:na], cell.limits.q_max[:na]
    postures = np.where(cell.limits.turns[:na], turned_into(postures, low, high), postures)
    inside = (postures >= low) & (postures <= high)
    return postures, exists & inside.all(axis=2)


# ----------------------------------------------------------------------------------------------------
# Where the nozzle can touch the bare part, and which of these places are most informative about its placement.

_TANGENTS = 4_000  # about the number of places beneath beads
_MOST = 160  # most places considered, beneath beads and on the body
_ON = 1e-6  # m: a place no farther off lies on the surface; others are beyond its rim
_RIM = 5e-3  # m: no place this close to the lower edge of the body, where its support is in the way
_CLEAR = (2e-3, 10e-3, 40e-3)  # m above a place: the nozzle is there, so the part must not be
_BESIDE, _BENT = 8e-3, 2e-3  # m to all sides, and m that the surface may be off there: else a rim or edge is near
_ANGLES = 12  # of a chosen joint that are tried
APART = 5e-3  # m between places: closer ones add nothing to reveal a wrong touch
# Square of a touch's noise (0.1 mm) over the placement's prior uncertainty (10 mm): makes few contacts comparable.
_ROUGH = (0.1 / 10.0) ** 2
_ROUNDS = 8
_HEIGHTS = 1_000  # about the number at which a next place is judged: places times heights bound the memory


@dataclass(frozen=True)
class TouchPlaces(ReadOnlyArrays):
    """Places (n) that the nozzle can touch along the surface's normal.

    points, normals (n, 3)  part frame;  q (n, k) of the holder's free axes [rad, m];  T_world_plate (n, 4, 4)
    """

    points: Array
    normals: Array
    q: Array
    T_world_plate: Array

    def __len__(self) -> int:
        return len(self.points)

    def only(self, which: NDArray[np.bool_]) -> TouchPlaces:
        """A selection (n) of them."""
        return TouchPlaces(self.points[which], self.normals[which], self.q[which], self.T_world_plate[which])

    def columns(self, unknowns: Unknowns, placement: Placement) -> Array:
        """Derivatives (n, p), by each unknown, of the residual of a contact at each place."""
        T_world_part = self.T_world_plate @ placement.T_plate_part
        return unknowns.columns(rows(self.points, self.normals, T_world_part, unknowns.centre))


@dataclass(frozen=True)
class Tangents:
    """Tangent planes at places (n, 3) of the side printed on, each valid where its place is the nearest one."""

    points: Array
    normals: Array
    tree: cKDTree

    @classmethod
    def of(cls, toolpath: Toolpath, surface: Distance, points: Array, normals: Array) -> Tangents:
        """Tangent planes beneath the first layer's beads, and at further places (n, 3) with normals."""
        beneath = np.vstack([bead.points for bead in toolpath.lowest])
        beneath = beneath[:: max(1, len(beneath) // _TANGENTS)]
        outward = slopes(surface, beneath)
        beneath = beneath - surface.signed_distance(beneath)[:, None] * outward
        every = np.vstack([beneath, points])
        return cls(every, np.vstack([outward, normals]), cKDTree(every))

    def signed_distance(self, points: Array) -> Array:
        """Distance (n,) of points (n, 3) from the plane at the nearest place; negative below."""
        near = self.tree.query(points)[1]
        return np.asarray(((points - self.points[near]) * self.normals[near]).sum(axis=1))


def surface_places(toolpath: Toolpath, surface: Distance) -> tuple[Array, Array]:
    """Places (n, 3) spread over the bare surface, beneath the first beads and on the displayed shape; normals."""
    first = [bead.points for bead in toolpath.lowest]
    points = _spread(np.vstack(first), _MOST)
    if toolpath.shape is not None:
        vertices = toolpath.shape.vertices
        high = vertices[:, 2] > vertices[:, 2].min() + _RIM
        if high.any():
            points = np.vstack([points, _spread(vertices[high], _MOST)])
    for _ in range(2):
        points = points - surface.signed_distance(points)[:, None] * slopes(surface, points)
    points = points[np.abs(surface.signed_distance(points)) < _ON]
    normals = slopes(surface, points)
    smooth = np.abs(np.linalg.norm(normals, axis=1) - 1.0) < 1e-2
    for height in _CLEAR:
        smooth &= surface.signed_distance(points + height * normals) > 0.5 * height
    for aside in _around(normals):
        smooth &= np.abs(surface.signed_distance(points + _BESIDE * aside)) < _BENT
    points = points[smooth]
    return points, normals[smooth] / np.linalg.norm(normals[smooth], axis=1)[:, None]


def _around(normals: Array) -> list[Array]:
    """Unit vectors to four sides, each (n, 3), perpendicular to normals (n, 3)."""
    across = np.cross(normals, np.eye(3)[np.argmin(np.abs(normals), axis=1)])
    across /= np.maximum(np.linalg.norm(across, axis=1), 1e-12)[:, None]
    other = np.cross(normals, across)
    return [across, -across, other, -other]


def reachable(cell: Cell, placement: Placement, points: Array, normals: Array) -> TouchPlaces:
    """The places (n, 3) that the arm can touch along their normals, one row for each angle of the holder.

    Joint limits are checked here; whether arm and head are clear is up to `Clearance`.
    """
    if not len(points):
        return TouchPlaces(points, normals, np.empty((0, len(cell.holder))), np.empty((0, 4, 4)))
    local = np.array([frame_from_z(p, -normal) for p, normal in zip(points, normals, strict=True)])
    turned = (local[:, None] @ rolls()).reshape(-1, 4, 4)
    found: list[tuple[NDArray[np.intp], Array]] = []
    na = len(cell.arm)
    for q in _stands(cell, range(na, na + len(cell.holder))):
        able = reached(cell, placement, turned, q)[1]
        at = np.flatnonzero(able.any(axis=1).reshape(len(points), -1).any(axis=1))
        found.append((at, np.tile(q, (len(at), 1))))
    which = np.concatenate([at for at, _ in found])
    q_all = np.vstack([q for _, q in found])
    return TouchPlaces(points[which], normals[which], q_all, plate_poses(cell, q_all))


def most_telling(places: TouchPlaces, unknowns: Unknowns, placement: Placement, count: int) -> list[int]:
    """The places (count of them, or as many as are APART) that fix the unknowns best: greatest determinant of the
    information matrix, by exchange (Fedorov)."""
    J = places.columns(unknowns, placement)
    rough = _ROUGH * np.eye(J.shape[1])
    chosen: list[int] = []

    def gains(others: list[int]) -> Array:
        C = np.linalg.inv(J[others].T @ J[others] + rough)
        gain = np.einsum("ij,jk,ik->i", J, C, J)
        gain[_taken(places, others, unknowns.table)] = -1.0
        return np.asarray(gain)

    while len(chosen) < count and (gain := gains(chosen)).max() >= 0.0:
        chosen.append(int(np.argmax(gain)))
    for _ in range(_ROUNDS):
        before = list(chosen)
        for k in range(len(chosen)):
            chosen[k] = int(np.argmax(gains(chosen[:k] + chosen[k + 1 :])))  # it may stay where it is
        if chosen == before:
            break
    return chosen


def next_place(
    places: TouchPlaces, touched: Array, unknowns: Unknowns, placement: Placement, told: Array, heights: Array
) -> tuple[int, float]:
    """The place whose touch lowers the worst uncertainty of the nozzle's height most, and the share that remains.

    touched (m, 3): places of earlier contacts; told (m, p): their derivatives by the unknowns; heights (w, p): those of
    the nozzle's height at waypoints.
    """
    J = places.columns(unknowns, placement)
    heights = heights[:: max(1, len(heights) // _HEIGHTS)]
    C = np.linalg.inv(told.T @ told + _ROUGH * np.eye(told.shape[1]))
    variance = np.einsum("ij,jk,ik->i", heights, C, heights)
    gain = (heights @ C @ J.T) ** 2 / (1.0 + np.einsum("ij,jk,ik->i", J, C, J))
    worst = (variance[:, None] - gain).max(axis=0)
    near = np.linalg.norm(places.points[:, None] - touched[None], axis=2).min(axis=1) < APART
    worst = np.where(near & ~near.all(), np.inf, worst)
    k = int(np.argmin(worst))
    return k, float(np.sqrt(max(worst[k], 0.0) / variance.max()))


def _taken(places: TouchPlaces, others: list[int], table: bool) -> NDArray[np.bool_]:
    """Whether places are too near to others; if a table is to be found, only at the same angles of the holder."""
    out = np.zeros(len(places), dtype=bool)
    for k in others:
        near = np.linalg.norm(places.points - places.points[k], axis=1) < APART
        out |= near & ((np.abs(places.q - places.q[k]).max(axis=1, initial=0.0) < 1e-6) | (not table))
    return out


def _stands(cell: Cell, joints: Sequence[int]) -> list[Array]:
    """Positions of chosen joints (k) that are tried: home, and each of them turned, or slid, in steps."""
    home, low, high = (each[list(joints)] for each in (cell.home, cell.limits.q_min, cell.limits.q_max))
    out = [home]
    turns = 2.0 * np.pi * np.arange(1, _ANGLES) / _ANGLES
    turns[turns > np.pi] -= 2.0 * np.pi
    for k, joint in enumerate(joints):
        slides = joint in cell.limits.sliding
        steps = np.linspace(low[k], high[k], _ANGLES) if slides else home[k] + turns
        for step in steps[(steps >= low[k]) & (steps <= high[k])]:
            q = home.copy()
            q[k] = step
            out.append(q)
    return out


def _spread(points: Array, most: int) -> Array:
    """At most `most` of the points (n, 3), each the one farthest from those before."""
    if len(points) <= most:
        return points
    points = points[:: max(1, len(points) // (20 * most))]
    chosen = [0]
    away = np.linalg.norm(points - points[0], axis=1)
    while len(chosen) < min(most, len(points)):
        chosen.append(int(np.argmax(away)))
        away = np.minimum(away, np.linalg.norm(points - points[chosen[-1]], axis=1))
    return points[chosen]
