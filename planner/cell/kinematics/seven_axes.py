"""Closed-form inverse kinematics of seven-axis arms with a spherical shoulder, for one joint's angle given.

Neighbouring axes are square to each other; axes 1, 2, 3 meet in the shoulder S, axes 5 and 6 in the wrist W. With
theta_i = q_i + offset, the pose of the frame on axis 7 in the shoulder's (origin S, z along axis 1, y along axis 2) is

    Rz(th1) Ry(th2) Rz(th3) (a3, 0, d3) Ry(th4) (a4, 0, d5) Rz(th5) Ry(th6) (a6, y6, 0) Rz(th7)

Given th7 (Panda, and any other): W is known, the distance SW gives th4 (two solutions), S seen from the wrist gives th6
(two) and th5, the rest is Rz Ry Rz and gives th1, th2, th3 (two). He and Liu, "Analytical inverse kinematics for Franka
Emika Panda", 2021, do so by another geometry. Given th3 (a6 = y6 = 0, such as LBR iiwa): W is known from the pose
alone, SW gives th4, the height of W gives th2 (two) and th1, the rest is Rz Ry Rz and gives th5, th6, th7 (two).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planner.base.arrays import Array
from planner.cell.kinematics import seven_axes_kernel as kernel
from planner.cell.kinematics.axes import OtherGeometry, about_y, about_z, at, axes_at_zero, from_zy
from planner.cell.kinematics.chain import Chain
from planner.cell.kinematics.seven_axes_kernel import BRANCHES, SEVENTH, THIRD

# m by which axes that should meet may pass each other:
NEAR = 5e-3  # as in a measured arm
FAR = 0.12  # if Newton's method is to find postures from those of the ideal arm
_FAR_WRIST = 0.03  # likewise for the wrist's axes, with joint 3 given; with joint 7 given, they need not meet
_ROUNDING = 1e-9  # if they do meet


@dataclass(frozen=True)
class SevenAxes:
    """Lengths [m] and angle offsets of an arm; poses are those of the flange in the arm's base frame.

    parameters       (46): a3, d3, a4, d5, a6, y6; offsets (7) of theta = q + offset; T_shoulder_base (16) and
                     T_flange_7 (16) by rows; redundant_joint once more, for the kernel
    redundant_joint  index of the joint whose angle is given from outside: 2 or 6
    rest             its angle if none is given [rad]
    """

    parameters: Array
    redundant_joint: int
    rest: float = 0.0

    @property
    def joints(self) -> int:
        """Seven."""
        return 7

    @property
    def branch_count(self) -> int:
        """Eight for each angle of the redundant joint."""
        return BRANCHES

    def poses(self, q: Array) -> Array:
        """Flange poses T_base_flange (m, 4, 4) of postures q (m, 7)."""
        return kernel.poses(self.parameters, np.ascontiguousarray(q))

    def solve(self, T_base_flange: Array, redundant: Array | None = None) -> tuple[Array, NDArray[np.bool_]]:
        """All eight postures q (m, 8, 7) in (-pi, pi] of flange poses (m, 4, 4), and which exist (m, 8).

        redundant (m) are the redundant joint's angles [rad], `rest` if not given. The index of a posture is its
        branch number: 4 elbow bent the negative way; with joint 7 given, 2 theta_2 negative, 1 the shoulder behind
        axis 6, seen from the hand; with joint 3 given, 2 wrist behind axis 1, 1 theta_6 negative. Joint limits are
        not checked. Where two axes coincide, the first joint of the two (of 5 and 7: joint 5) is at the zero of its
        theta.
        """
        return kernel.solve(self.parameters, self._given(T_base_flange, redundant), np.ascontiguousarray(T_base_flange))

    def branches(self, q: Array) -> NDArray[np.int8]:
        """Branch numbers (m) of postures q (m, 7)."""
        return kernel.branches(self.parameters, np.ascontiguousarray(q))

    def out_of_reach(self, T_base_flange: Array, redundant: Array | None = None) -> Array:
        """By how much (m) the arm is too short or too long for these redundant angles [m]; 0 within reach.

        Another redundant angle may reach poses that this one does not. With a nearly straight elbow, the result is too
        large.
        """
        given = self._given(T_base_flange, redundant)
        return kernel.out_of_reach(self.parameters, given, np.ascontiguousarray(T_base_flange))

    def _given(self, T: Array, redundant: Array | None) -> Array:
        if redundant is None:
            return np.full(len(T), self.rest)
        return np.ascontiguousarray(np.ravel(redundant), dtype=np.float64)


def read_seven_axes(chain: Chain, redundant_joint: int, near: float = NEAR) -> SevenAxes:
    """Read lengths and offsets off a chain from base to flange; OtherGeometry if it is not of this kind, or if axes
    that should meet pass each other by more than `near` [m]. If they pass by less, an arm is read whose axes meet."""
    if len(chain) != 7:
        raise OtherGeometry(f"it has {len(chain)} joints, not 7")
    lines, T_base_flange = axes_at_zero(chain)
    T = T_base_shoulder = from_zy(lines.meet(0, 1, near), lines.directions[0], lines.directions[1])
    local = lines.seen_from(T)
    local.square(1, 2)
    if np.linalg.norm(np.cross(local.points[2], local.directions[2])) > near:
        raise OtherGeometry("axes 1, 2, 3 do not meet in one point")
    offsets = np.zeros(7)
    for i in range(1, 6):  # theta_i turns the frame so that its z (even i: its y) is the axis of joint i + 1
        local = lines.seen_from(T)
        local.square(i, i + 1)
        x, y, z = local.directions[i + 1]
        offsets[i] = np.arctan2(x, z) if i % 2 else np.arctan2(-x, y)
        T = T @ (about_y(offsets[i]) if i % 2 else about_z(offsets[i]))
        if i == 2:
            a3, _, d3 = lines.seen_from(T).points[3]
            T = T @ at(a3, 0.0, d3)
        elif i == 3:
            local = lines.seen_from(T)
            a4, aside, _ = local.points[4]
            d5 = local.meet(4, 5, near)[2]
            if abs(aside) > near:
                raise OtherGeometry("the forearm's axis passes beside the elbow's plane")
            T = T @ at(a4, 0.0, d5)
    local = lines.seen_from(T)
    a6, y6, _ = local.points[6] - local.points[6, 2] * local.directions[6]
    if redundant_joint not in (THIRD, SEVENTH):
        raise OtherGeometry("the redundant joint can be joint 3 or joint 7")
    missed = np.hypot(a6, y6) if redundant_joint == THIRD else 0.0  # with joint 7 given, it may be anything
    if missed > min(near, _FAR_WRIST):
        raise OtherGeometry("axes 5, 6, 7 do not meet in one point: the redundant joint can only be joint 7")
    if missed > _ROUNDING:
        a6 = y6 = 0.0
    T_flange_7 = np.linalg.inv(T_base_flange) @ T @ at(a6, y6, 0.0)
    lengths = [a3, d3, a4, d5, a6, y6]
    frames = [np.linalg.inv(T_base_shoulder).ravel(), T_flange_7.ravel()]
    return SevenAxes(np.concatenate([lengths, offsets, *frames, [redundant_joint]]), redundant_joint)
