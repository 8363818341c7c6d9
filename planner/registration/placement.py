"""A part's placement as unknowns: its pose on what carries it, where the table's axis stands, how large the body is.

Contacts see it through the distance of their tips from the part's bare surface; how that changes with each unknown
follows from the slope of the distance alone, so any surface that knows its signed distance can be found.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from scipy.spatial.transform import Rotation

from planner.readonly import Array, ReadOnlyArrays

TURNS = slice(3, 6)
SHIFTS = slice(6, 9)
SIZE = 9
UNKNOWNS = 10  # x, y, z, turns about x, y, z of the part frame; shift of the table in the world; growth of the body
_ASIDE = 1e-5  # m, to either side, for the slope of the distance


class Distance(Protocol):
    """A surface that knows how far points are (metres, part frame)."""

    def signed_distance(self, points: Array) -> Array:
        """Distance (n,) of points (n, 3); negative inside."""
        ...


@dataclass(frozen=True)
class Placement(ReadOnlyArrays):
    """Where the part is.

    T_plate_part (4, 4)  on its plate or flange; of a bed, in the world
    shift (3)            of the table from where the problem has it, in the world [m]
    growth               by which the body is larger than drawn, along its normals [m]
    """

    T_plate_part: Array
    shift: Array
    growth: float = 0.0

    def seen(self, tips: Array, T_world_plate: Array) -> Array:
        """Points of the world (n, 3) in the part frame (n, 3), with the plate at (n, 4, 4)."""
        T_world_part = T_world_plate @ self.T_plate_part
        away = tips - self.shift - T_world_part[:, :3, 3]
        return np.einsum("nji,nj->ni", T_world_part[:, :3, :3], away)

    def moved(self, step: Array, centre: Array) -> Placement:
        """The placement moved by unknowns (10) in metres and radians, turned about `centre` (3) of the part frame."""
        T = np.eye(4)
        T[:3, :3] = Rotation.from_rotvec(step[TURNS]).as_matrix()
        T[:3, 3] = centre + step[:3] - T[:3, :3] @ centre
        return replace(
            self,
            T_plate_part=self.T_plate_part @ T,
            shift=self.shift + step[SHIFTS],
            growth=self.growth + float(step[SIZE]),
        )


def slopes(surface: Distance, points: Array) -> Array:
    """Gradients (n, 3) of the signed distance at points (n, 3): outward unit normals where it is smooth."""
    n = len(points)
    steps = _ASIDE * np.vstack([np.eye(3), -np.eye(3)])
    around = surface.signed_distance((points[None] + steps[:, None]).reshape(-1, 3)).reshape(6, n)
    return np.asarray((around[:3] - around[3:]).T / (2.0 * _ASIDE))


def rows(points: Array, normals: Array, T_world_part: Array, centre: Array) -> Array:
    """How much the distance of points fixed in the world (n, 3 in the part frame) from the surface grows with each unknown.

    normals (n, 3) of the surface there, T_world_part (n, 4, 4), centre (3) about which the part turns; returns (n, 10).
    """
    away = np.einsum("nij,nj->ni", T_world_part[:, :3, :3], normals)
    return np.column_stack([-normals, -np.cross(points - centre, normals), -away, -np.ones(len(points))])
