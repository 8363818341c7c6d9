"""Unit quaternions, x y z w, in batches: what the exporters need and no more."""

from __future__ import annotations

import numpy as np

from planner.readonly import Array


def continuous(quat: Array) -> Array:
    """Quaternions (n, 4), normalised, each of the sign that lies nearer to its predecessor."""
    quat = quat / np.linalg.norm(quat, axis=1, keepdims=True)
    flips = np.einsum("ij,ij->i", quat[1:], quat[:-1]) < 0.0
    sign = np.concatenate([[1.0], np.cumprod(np.where(flips, -1.0, 1.0))])
    out: Array = quat * sign[:, None]
    return out


def slerp(a: Array, b: Array, u: Array) -> Array:
    """Quaternions (n, 4) at the fraction u (n) of the shorter great arc from a to b (n, 4)."""
    dot = np.einsum("ij,ij->i", a, b)
    b = np.where(dot[:, None] < 0.0, -b, b)
    omega = np.arccos(np.clip(np.abs(dot), 0.0, 1.0))
    near = omega < 1e-6  # sin(k w) / sin(w) tends to k
    sine = np.where(near, 1.0, np.sin(omega))
    wa = np.where(near, 1.0 - u, np.sin((1.0 - u) * omega) / sine)
    wb = np.where(near, u, np.sin(u * omega) / sine)
    out: Array = wa[:, None] * a + wb[:, None] * b
    return out


def angle(a: Array, b: Array) -> Array:
    """Angles (n) between orientations a and b (n, 4) [rad]."""
    sign = np.where(np.einsum("ij,ij->i", a, b) < 0.0, -1.0, 1.0)[:, None]
    # half the chord on the sphere of quaternions: stays accurate where arccos does not
    out: Array = 4.0 * np.arcsin(np.clip(0.5 * np.linalg.norm(a - sign * b, axis=1), 0.0, 1.0))
    return out


def from_matrix(R: Array) -> Array:
    """Quaternions (n, 4), w >= 0, of rotation matrices (n, 3, 3): the largest component is found first (Shepperd)."""
    d = np.einsum("nii->ni", R)
    trace = d.sum(axis=1)
    squares = 0.25 * np.column_stack([1.0 + 2.0 * d - trace[:, None], 1.0 + trace])
    K = np.empty((len(R), 4, 4))  # q q^T: each row is the quaternion, times one of its own components
    for i in range(4):
        K[:, i, i] = squares[:, i]
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        K[:, i, j] = K[:, j, i] = 0.25 * (R[:, i, j] + R[:, j, i])
        K[:, k, 3] = K[:, 3, k] = 0.25 * (R[:, j, i] - R[:, i, j])
    largest = np.argmax(squares, axis=1)
    q = K[np.arange(len(R)), largest]
    q = q / np.linalg.norm(q, axis=1, keepdims=True)
    out: Array = np.where(q[:, 3:] < 0.0, -q, q)
    return out


def to_matrix(quat: Array) -> Array:
    """Rotation matrices (n, 3, 3) of unit quaternions (n, 4)."""
    x, y, z, w = quat.T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), -1, 0)
