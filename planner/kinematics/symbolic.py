"""Symbolic forward kinematics of serial chains, for programs that want exact derivatives of any order.

Pinocchio's wheel carries no CasADi bindings. A `Chain` is read off a Pinocchio model once, so its constants, with
symbols for the joints, are the same mechanism.
"""

from __future__ import annotations

import casadi as ca
import numpy as np

from planner.kinematics.chain import Chain
from planner.readonly import Array

_TERMS = 14  # of the series of sine and cosine: the rest is below 1e-16 up to an angle of 3 rad


def symbolic_pose(chain: Chain, q: ca.SX) -> ca.SX:
    """Tip pose T_world_tip (4, 4) of joints q (n) [rad, m]."""
    T = _frames(chain, q)[-1]
    return _times(T, chain.T_last_tip)


def symbolic_jacobian(chain: Chain, q: ca.SX) -> ca.SX:
    """Geometric Jacobian (6, n) at the tip, world axes, linear rows first [m/rad, rad/rad]."""
    frames = _frames(chain, q)
    tip = _times(frames[-1], chain.T_last_tip)[:3, 3]
    columns = []
    for axis, T in zip(chain.axes, frames[1:], strict=True):
        # turning about the axis leaves the axis and the joint's origin where they are
        direction = T[:3, :3] @ ca.SX(axis)
        columns.append(ca.vertcat(ca.cross(direction, tip - T[:3, 3]), direction))
    return ca.horzcat(*columns) if columns else ca.SX(6, 0)


def symbolic_tilt(tilt: ca.SX) -> ca.SX:
    """Rotation (3, 3) by the rotation vector (tilt_x, tilt_y, 0), smooth at rest as well, up to 3 rad."""
    square = ca.sumsqr(tilt)
    one, two = ca.SX(0), ca.SX(0)  # sin(a) / a and (1 - cos(a)) / a^2 as series in a^2
    for k in range(_TERMS, -1, -1):
        one = 1.0 - square / ((2 * k + 2) * (2 * k + 3)) * one
        two = 1.0 - square / ((2 * k + 3) * (2 * k + 4)) * two
    K = ca.SX(3, 3)
    K[0, 2], K[1, 2], K[2, 0], K[2, 1] = tilt[1], -tilt[0], -tilt[1], tilt[0]
    return ca.SX.eye(3) + one * K + 0.5 * two * (K @ K)


def symbolic_roll(roll: ca.SX) -> ca.SX:
    """Rotation (3, 3) by `roll` about z."""
    return _rotation(np.array([0.0, 0.0, 1.0]), roll)


def _frames(chain: Chain, q: ca.SX) -> list[ca.SX]:
    """Poses in the world of the world itself and of every link behind its joint."""
    frames = [ca.SX.eye(4)]
    for i, (placement, axis) in enumerate(zip(chain.placements, chain.axes, strict=True)):
        T = _times(frames[-1], placement)
        T[:3, :3] = T[:3, :3] @ _rotation(axis, q[i])
        frames.append(T)
    return frames


def _times(T: ca.SX, constant: Array) -> ca.SX:
    """T times a constant transform, whose exact zeros and ones make no operations."""
    return T @ ca.sparsify(ca.SX(constant))


def _rotation(axis: Array, angle: ca.SX) -> ca.SX:
    """Rotation (3, 3) about a unit axis (Rodrigues)."""
    x, y, z = axis
    K = ca.sparsify(ca.SX(np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])))
    return ca.SX.eye(3) + ca.sin(angle) * K + (1.0 - ca.cos(angle)) * (K @ K)
