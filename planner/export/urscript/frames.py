"""The frame in which a Universal Robots controller counts, and its rotation vectors."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from planner.readonly import Array

if TYPE_CHECKING:
    from planner.cell import Cell


def world_controller(cell: Cell) -> Array:
    """T_world_controller (4, 4): z along joint 1, y against joint 2's axis at zero, as the maker's DH table has it.

    URDF files differ: ROS's base_link is turned by half a turn against the controller's base. Both have one origin.
    """
    first, second = cell.arm.placements[0], cell.arm.placements[0] @ cell.arm.placements[1]
    z = first[:3, :3] @ cell.arm.axes[0]
    y = -second[:3, :3] @ cell.arm.axes[1]
    T = np.eye(4)
    T[:3, :3] = np.column_stack([np.cross(y, z), y, z])
    T[:3, 3] = cell.T_world_base[:3, 3]
    return T


def rotation_vectors(quat: Array) -> Array:
    """Axis times angle (m, 3) [rad], at most half a turn, of unit quaternions (m, 4) x y z w."""
    quat = np.where(quat[:, 3:] < 0.0, -quat, quat)
    sine = np.linalg.norm(quat[:, :3], axis=1, keepdims=True)
    # for small angles angle / sine tends to 2
    scale = np.where(sine > 1e-12, 2.0 * np.arctan2(sine, quat[:, 3:]) / np.maximum(sine, 1e-12), 2.0)
    out: Array = scale * quat[:, :3]
    return out


def quaternions(vectors: Array) -> Array:
    """Unit quaternions (m, 4) x y z w of rotation vectors (m, 3) [rad]."""
    angle = np.linalg.norm(vectors, axis=1, keepdims=True)
    out: Array = np.column_stack([0.5 * np.sinc(0.5 * angle / np.pi) * vectors, np.cos(0.5 * angle)])
    return out
