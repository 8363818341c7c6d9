"""What everybody needs of an arm's inverse kinematics, whatever its kind; and one compiled entry to all kinds."""

from __future__ import annotations

from dataclasses import replace
from typing import Protocol

import numpy as np
from numba import njit
from numpy.typing import NDArray

from planner.kinematics import offset_wrist, seven_axes, spherical_wrist
from planner.kinematics.corrected import Corrected, length, refine_branches
from planner.kinematics.offset_wrist import OffsetWrist
from planner.kinematics.seven_axes import SevenAxes
from planner.kinematics.spherical_wrist import SphericalWrist
from planner.readonly import Array

SPHERICAL_WRIST, OFFSET_WRIST, SEVEN_AXES, CORRECTED = 0, 1, 2, 4
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
        """By how much (m) the arm's lengths fail to reach the flange poses, about the distance out of reach [m]; 0 within."""


def kind_of(inverse: InverseKinematics) -> int:
    """The kind that `solve_one` takes: one of the constants above, CORRECTED added for a corrected arm."""
    if isinstance(inverse, Corrected):
        return CORRECTED + kind_of(inverse.nominal)
    if isinstance(inverse, SphericalWrist):
        return SPHERICAL_WRIST
    return OFFSET_WRIST if isinstance(inverse, OffsetWrist) else SEVEN_AXES


def with_rest(inverse: InverseKinematics, angle: float) -> InverseKinematics:
    """The same arm, its redundant joint at an angle [rad] wherever `solve` is not given one."""
    if isinstance(inverse, Corrected) and isinstance(inverse.nominal, SevenAxes):
        return replace(inverse, nominal=replace(inverse.nominal, rest=angle))
    return replace(inverse, rest=angle) if isinstance(inverse, SevenAxes) else inverse


def track(
    inverse: InverseKinematics, T_base_flange: Array, redundant: Array | None, q_start: Array
) -> tuple[Array, NDArray[np.bool_]]:
    """Postures q (m, n) along a path of flange poses (m, 4, 4) on the branch of q_start (n), and where they exist (m).

    redundant (m) as in `solve`. Joints are continuous in whole turns from q_start on; where there is no posture, the
    one before is repeated.
    """
    solutions, exists = inverse.solve(T_base_flange, redundant)
    branch = int(inverse.branches(q_start[None])[0])
    q, ok = solutions[:, branch], exists[:, branch]
    last = np.maximum.accumulate(np.where(ok, np.arange(len(q)), -1))
    held = np.where((last >= 0)[:, None], q[last], q_start)
    return np.unwrap(np.vstack([q_start, held]), axis=0)[1:], ok


@njit(cache=True)
def solve_one(kind: int, p: Array, redundant: float, R: Array, t: Array, q: Array, ok: NDArray[np.bool_]) -> None:
    """Fill q (8, n) and ok (8) with the postures for one flange pose, rotation R (3, 3) and origin t (3).

    kind, p  of the arm: `kind_of`, `parameters`;  redundant  the redundant joint's angle, any number without one
    """
    own = p[length(q.shape[1]) :] if kind >= CORRECTED else p
    if kind % CORRECTED == SPHERICAL_WRIST:
        _solve_spherical(own, R, t, q, ok)
    elif kind % CORRECTED == OFFSET_WRIST:
        _solve_offset(own, R, t, q, ok)
    else:
        _solve_seven(own, redundant, R, t, q, ok)
    if kind >= CORRECTED:
        refine_branches(p, R, t, q, ok)
