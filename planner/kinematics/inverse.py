"""What everybody needs of an arm's inverse kinematics, whatever its kind; and one compiled entry to all kinds."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numba import njit
from numpy.typing import NDArray

from planner.kinematics import offset_wrist, seven_axes, spherical_wrist
from planner.kinematics.offset_wrist import OffsetWrist
from planner.kinematics.seven_axes import SevenAxes
from planner.kinematics.spherical_wrist import SphericalWrist

Array = NDArray[np.float64]
SPHERICAL_WRIST, OFFSET_WRIST, SEVEN_AXES = 0, 1, 2
_solve_spherical, _solve_offset, _solve_seven = spherical_wrist.solve_one, offset_wrist.solve_one, seven_axes.solve_one


class InverseKinematics(Protocol):
    """Closed-form inverse kinematics of an arm; poses are those of the flange in the arm's base frame.

    Branches are numbered: a posture's number is its index in what `solve` returns, and it changes along a
    continuous motion only in a singularity.
    """

    @property
    def joints(self) -> int:
        """Number n of joints."""

    @property
    def branch_count(self) -> int:
        """Number B of branches."""

    @property
    def redundant_joint(self) -> int | None:
        """Index of the joint whose angle is given to `solve` from outside; None for an arm of six joints."""

    @property
    def parameters(self) -> Array:
        """What `solve_one` needs of this arm, in an order of its own."""

    def poses(self, q: Array) -> Array:
        """Flange poses T_base_flange (m, 4, 4) of postures q (m, n)."""

    def solve(self, T_base_flange: Array, redundant: Array | None = None) -> tuple[Array, NDArray[np.bool_]]:
        """Postures q (m, B, n) in (-pi, pi] of flange poses (m, 4, 4), and which exist (m, B).

        redundant (m) are angles of the redundant joint [rad]; where there is none, it is not looked at.
        """

    def branches(self, q: Array) -> NDArray[np.int8]:
        """Branch numbers (m) of postures q (m, n)."""

    def out_of_reach(self, T_base_flange: Array, redundant: Array | None = None) -> Array:
        """How far (m) the flange poses are out of reach [m]; 0 within."""


def kind_of(inverse: InverseKinematics) -> int:
    """The kind that `solve_one` takes: SPHERICAL_WRIST, OFFSET_WRIST or SEVEN_AXES."""
    kinds = {SphericalWrist: SPHERICAL_WRIST, OffsetWrist: OFFSET_WRIST, SevenAxes: SEVEN_AXES}
    return kinds[type(inverse)]  # type: ignore[index]


@njit(cache=True)
def solve_one(kind: int, p: Array, redundant: float, R: Array, t: Array, q: Array, ok: NDArray[np.bool_]) -> None:
    """Fill q (8, n) and ok (8) with the postures for one flange pose, rotation R (3, 3) and origin t (3).

    kind, p  of the arm: `kind_of`, `parameters`;  redundant  the redundant joint's angle, any number without one
    """
    if kind == SPHERICAL_WRIST:
        _solve_spherical(p, R, t, q, ok)
    elif kind == OFFSET_WRIST:
        _solve_offset(p, R, t, q, ok)
    else:
        _solve_seven(p, redundant, R, t, q, ok)
