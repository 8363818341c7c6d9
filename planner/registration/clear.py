"""Whether arm and head are clear of everything but the place that the nozzle touches."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planner.cell import Cell, frame_from_z, rigid_inverse
from planner.problem import Problem
from planner.readonly import Array
from planner.registration.contacts import plate_poses
from planner.registration.placement import Distance, Placement
from planner.solids import triangles_of
from planner.verify.bodies import CellBodies, Distances, Pair, all_at_home, pairs

ROLLS = 8  # of the nozzle about its axis, that are tried
_FREE, _SHARE = 1e-3, 0.1  # m that the head keeps from the part, or a tenth of the height above the tip, where less
_TIP = 1e-3  # m above the tip, below which the nozzle may be as near as it likes
_POINTS = 300  # of the head that are looked at
_ALONG = (0.25, 0.5, 0.75)  # of the edges of the head's triangles


@dataclass(frozen=True)
class Clearance:
    """Bodies of a cell, pairs that can hit each other, and points (n, 3) on the head in the nozzle's frame."""

    cell: Cell
    surface: Distance
    bodies: CellBodies
    pairs: tuple[Pair, ...]
    head: Array

    @classmethod
    def of(cls, problem: Problem, cell: Cell, surface: Distance) -> Clearance:
        """All that can be hit in a problem's cell."""
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
        # what stands with the part may be what is touched, as a bed is: there the nozzle itself comes near
        near = all_at_home(bodies, (), spec.nozzle)
        found += tuple(pair for pair in near if bodies.things[pair.a].name not in tips)
        head = np.vstack(points)
        return cls(cell, surface, bodies, found, _thinned(head[head[:, 2] < -_TIP]))

    def fits(self, point: Array, normal: Array) -> list[Array]:
        """Nozzle poses (4, 4) on a place (3) of the part, along its normal (3), in which the head keeps from the part."""
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
    """At most so many points (n, 3), the lower ones first: they are the nearest to the part."""
    order = np.argsort(-points[:, 2], kind="stable")
    return points[order[:: max(1, len(points) // _POINTS)]]


def rolls() -> Array:
    """Turns (ROLLS, 4, 4) of the nozzle about its axis."""
    a = 2.0 * np.pi * np.arange(ROLLS) / ROLLS
    out = np.tile(np.eye(4), (ROLLS, 1, 1))
    out[:, 0, 0], out[:, 0, 1], out[:, 1, 0], out[:, 1, 1] = np.cos(a), -np.sin(a), np.sin(a), np.cos(a)
    return out


def reached(cell: Cell, placement: Placement, T_part_nozzle: Array, q: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Postures (n, branches, joints) of the arm for nozzle poses (n, 4, 4) on the part, the holder at q (k), and which
    of them exist within joint limits."""
    na = len(cell.arm)
    T_world_part = plate_poses(cell, q[None])[0] @ placement.T_plate_part
    T_world_part[:3, 3] += placement.shift
    T_base_part = rigid_inverse(cell.T_world_base) @ T_world_part
    postures, exists = cell.inverse.solve(T_base_part @ T_part_nozzle @ rigid_inverse(cell.T_flange_nozzle))
    inside = (postures >= cell.limits.q_min[:na]) & (postures <= cell.limits.q_max[:na])
    return postures, exists & inside.all(axis=2)
