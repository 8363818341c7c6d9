"""Arms that are nearly of a kind with a closed form: its postures, refined by Newton's method on the true chain.

Measured (calibrated) arms are of this sort, and URDF files whose right angles were rounded. Branches are those of
the nearest ideal arm; poses are exact.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from planner.kinematics.axes import wrap
from planner.kinematics.chain import Chain
from planner.kinematics.newton import refine
from planner.kinematics.offset_wrist import OffsetWrist
from planner.kinematics.seven_axes import SevenAxes
from planner.readonly import Array

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
