"""Inverse kinematics of an arm, whatever its kind: what everybody needs of it, and arms that are nearly of a kind."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from planner.base.arrays import Array
from planner.base.compiled import njit
from planner.cell.kinematics import offset_wrist, seven_axes_kernel, spherical_wrist
from planner.cell.kinematics.axes import wrap
from planner.cell.kinematics.chain import Chain, refine
from planner.cell.kinematics.offset_wrist import OffsetWrist
from planner.cell.kinematics.seven_axes import SevenAxes
from planner.cell.kinematics.spherical_wrist import SphericalWrist

# ----------------------------------------------------------------------------------------------------
# Arms that are nearly of a kind with a closed form: its postures, refined by Newton's method on the true chain.
#
# Measured (calibrated) arms are of this sort, and URDF files whose right angles were rounded. Branches are those of
# the nearest ideal arm; poses are exact.

_ITERATIONS = 20  # two or three do, a few more beside singularities


@dataclass(frozen=True)
class Corrected:
    """The closed form of the nearest ideal arm, and the chain from base to flange that counts."""

    nominal: OffsetWrist | SevenAxes
    chain: Chain

    @property
    def joints(self) -> int:
        """Number of joints."""
        return self.nominal.joints

    @property
    def branch_count(self) -> int:
        """As many as the ideal arm has."""
        return self.nominal.branch_count

    @property
    def redundant_joint(self) -> int | None:
        """The ideal arm's."""
        return self.nominal.redundant_joint

    @property
    def parameters(self) -> Array:
        """The joint that is held (-1 for none), placements, axes and tip of the chain, then the ideal arm's own."""
        held = -1.0 if self.redundant_joint is None else float(self.redundant_joint)
        chain = self.chain
        pieces = [[held], chain.placements.ravel(), chain.axes.ravel(), chain.T_last_tip.ravel()]
        return np.concatenate([*pieces, self.nominal.parameters])

    def poses(self, q: Array) -> Array:
        """Flange poses T_base_flange (m, 4, 4) of postures q (m, n)."""
        return self.chain.poses(q)

    def solve(self, T_base_flange: Array, redundant: Array | None = None) -> tuple[Array, NDArray[np.bool_]]:
        """Postures q (m, B, n) in (-pi, pi] of flange poses (m, 4, 4), and which exist (m, B).

        Those of the ideal arm, refined; where that fails, at the edge of reach or in a singularity, there is none.
        """
        q, ok = self.nominal.solve(T_base_flange, redundant)
        _refine_all(self.parameters, np.ascontiguousarray(T_base_flange), q, ok)
        return q, ok

    def branches(self, q: Array) -> NDArray[np.int8]:
        """Branch numbers (m) of postures q (m, n), as if the arm were ideal."""
        return self.nominal.branches(q)

    def out_of_reach(self, T_base_flange: Array, redundant: Array | None = None) -> Array:
        """How far (m) the flange poses are out of the ideal arm's reach [m]; 0 within."""
        return self.nominal.out_of_reach(T_base_flange, redundant)


@njit(cache=True)
def length(n: int) -> int:
    """Length of the parameters before the ideal arm's own, for n joints."""
    return 1 + 19 * n + 16


@njit(cache=True)
def refine_branches(p: Array, R: Array, t: Array, q: Array, ok: NDArray[np.bool_]) -> None:
    """Refine the postures q (B, n) that exist (ok), all for one pose; ok becomes False where that fails."""
    n = q.shape[1]
    placements = p[1 : 1 + 16 * n].reshape(n, 4, 4)
    axes = p[1 + 16 * n : 1 + 19 * n].reshape(n, 3)
    tip = p[1 + 19 * n : length(n)].reshape(4, 4)
    for k in range(ok.size):
        if ok[k]:
            ok[k] = refine(placements, axes, tip, int(p[0]), R, t, q[k], _ITERATIONS)
            for j in range(n):
                q[k, j] = wrap(q[k, j])


@njit(cache=True)
def _refine_all(p: Array, T: Array, q: Array, ok: NDArray[np.bool_]) -> None:
    for i in range(T.shape[0]):
        refine_branches(p, T[i, :3, :3], T[i, :3, 3], q[i], ok[i])


# ----------------------------------------------------------------------------------------------------
# What everybody needs of an arm's inverse kinematics, whatever its kind; and one compiled entry to all kinds.

SPHERICAL_WRIST, OFFSET_WRIST, SEVEN_AXES, CORRECTED = 0, 1, 2, 4
_solve_spherical, _solve_offset, _solve_seven = (
    spherical_wrist.solve_one,
    offset_wrist.solve_one,
    seven_axes_kernel.solve_one,
)


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
