"""Inverse kinematics of six-axis arms whose axes 4 and 6 pass each other: Fanuc's CRX, Yaskawa's HC10, ABB's GoFa.

Axes 2 and 3 are parallel; axis 4 is square to them and to axis 5, which it meets. Axis 6 may lie anywhere. There is no
closed form: `skew_wrist_kernel` searches over joint 1 and finds up to 16 postures per pose. Such arms may be cuspidal:
they can move from one posture to another without passing a singularity, so a posture's number holds only locally. It
changes at singularities, where the arm is stretched, where the wrist is above axis 1, and where, of two postures that
share a label, the other one becomes the less singular.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planner.base.arrays import Array
from planner.cell.kinematics import skew_wrist_kernel as kernel
from planner.cell.kinematics.axes import OtherGeometry, SixJoints, axes_at_zero
from planner.cell.kinematics.chain import Chain

_LEAST_OFFSET = 5e-3  # m by which axis 6 passes the point where 4 and 5 meet; with less, the wrist is a spherical one
_LEAST_LENGTH = 1e-3  # m


@dataclass(frozen=True)
class SkewWrist(SixJoints):
    """An arm's own chain, and the geometry of the nearest arm with right angles, for which postures are searched.

    geometry  (54), see `skew_wrist_kernel`
    """

    chain: Chain
    geometry: Array

    @property
    def branch_count(self) -> int:
        """Sixteen."""
        return kernel.SLOTS

    @property
    def parameters(self) -> Array:
        """Placements, axes and tip of the chain, then the geometry."""
        chain = self.chain
        return np.concatenate([chain.placements.ravel(), chain.axes.ravel(), chain.T_last_tip.ravel(), self.geometry])

    def poses(self, q: Array) -> Array:
        """Flange poses T_base_flange (m, 4, 4) of postures q (m, 6)."""
        return self.chain.poses(q)

    def solve(self, T_base_flange: Array, redundant: Array | None = None) -> tuple[Array, NDArray[np.bool_]]:
        """All postures q (m, 16, 6) in (-pi, pi] of flange poses (m, 4, 4), and which exist (m, 16).

        The index of a posture is its label: 4 wrist behind axis 1, 2 elbow bent the negative way, 1 for the sign of the
        Jacobian's determinant relative to these; of two postures that share a label, the more singular one has 8 more.
        """
        return kernel.solve_all(self.parameters, np.ascontiguousarray(T_base_flange))

    def branches(self, q: Array) -> NDArray[np.int8]:
        """Branch numbers (m) of postures q (m, 6)."""
        q = np.ascontiguousarray(q)
        return kernel.slots_of(self.parameters, self.chain.poses(q), q)

    def out_of_reach(self, T_base_flange: Array, redundant: Array | None = None) -> Array:
        """By how much (m) axis 6 is farther from the shoulder than the arm's lengths add up to [m]; 0 within."""
        g = self.geometry
        h1, p1 = g[kernel.H1 :][:3], g[kernel.P1 :][:3]
        T_zero = g[kernel.T0 :][:16].reshape(4, 4)
        P = g[kernel.C :][:3] + g[kernel.E :][:3]
        seen = T_zero[:3, :3].T @ (P - T_zero[:3, 3])
        X = T_base_flange[:, :3, :3] @ seen + T_base_flange[:, :3, 3] - p1
        shoulder = g[kernel.P2 :][:3] - p1
        up, own = X @ h1, float(shoulder @ h1)
        out = np.linalg.norm(X - up[:, None] * h1, axis=1)
        own_out = float(np.linalg.norm(shoulder - own * h1))
        far = np.hypot(out - own_out, up - own)
        upper, fore = np.linalg.norm(g[kernel.P23 :][:3]), np.linalg.norm(g[kernel.P3C :][:3])
        return np.asarray(np.maximum(far - (upper + fore + g[kernel.D]), 0.0))


def read_skew_wrist(chain: Chain) -> SkewWrist:
    """Read the geometry off a chain from base to flange; OtherGeometry if it is not of this kind."""
    if len(chain) != 6:
        raise OtherGeometry(f"it has {len(chain)} joints, not 6")
    lines, T_zero = axes_at_zero(chain)
    h1, h2, _, h4, h5, h6 = lines.directions
    sense = lines.parallel(1, 2)
    lines.square(0, 1)
    lines.square(1, 3)
    C = lines.meet(3, 4)
    e = lines.points[5] - C
    e = e - (e @ h6) * h6
    d = float(np.linalg.norm(e))
    if d < _LEAST_OFFSET:
        raise OtherGeometry("axes 4, 5 and 6 meet in one point, or nearly so")
    h4 = _square_to(h4, h2)  # as if square; exact postures come from the chain itself
    h5 = _square_to(h5, h4)
    p1, h1 = lines.points[0], _square_to(h1, h2)
    p2 = lines.points[1] + ((p1 - lines.points[1]) @ h2) * h2
    p3 = lines.points[2] + ((C - lines.points[2]) @ h2) * h2
    upper = (p3 - p2) - ((p3 - p2) @ h2) * h2
    if min(np.linalg.norm(upper), np.linalg.norm(C - p3)) < _LEAST_LENGTH:
        raise OtherGeometry("axes 2 and 3, or axis 3 and the wrist, coincide")
    parts = [h1, h2, h4, h5, h6, p1, C, e, np.cross(h6, e / d), p2, upper, C - p3]
    return SkewWrist(chain, np.concatenate([*parts, T_zero.ravel(), [d, sense]]))


def _square_to(direction: Array, other: Array) -> Array:
    """The nearest unit direction (3) that is square to another direction."""
    direction = direction - (direction @ other) * other
    return np.asarray(direction / np.linalg.norm(direction))
