"""How far joints and singularity margin change, to first order, for a part displaced within a tolerance.

A part displaced by a shift d and a turn w about its middle m takes the nozzle's pose at p along: by d + w x (p - m),
and by the turn w. With R the part's orientation in the world the joints that follow change by
J^-1 [R (d + w x (p - m)); R w], which is linear in (d, w). The greatest value of a linear form a.d + b.w over shifts
of length delta and turns of angle alpha is delta |a| + alpha |b| (their dual norms), so one product a sample tells the
worst of all displacements at once. The singular value's slope is u^T (dJ/dq) v with its two singular vectors.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from planner.cell import Cell
from planner.plan.tolerance import Bound, Displacement, Tolerance
from planner.readonly import Array
from planner.resolve.jointpath import JointPath

BLOCK = 8192  # samples at once: bounds the memory
RANGE, SINGULARITY = "joint range", "singularity margin"


def first_order(
    cell: Cell, paths: Sequence[JointPath], tolerance: Tolerance, middle: Array, least_sigma: float
) -> tuple[Bound, ...]:
    """The bound of each joint that follows from the nozzle's pose, tightest first, then that of the singularity margin.

    Joints count along beads and their runs, singularities where material flows; travel is not looked at. middle (3) of
    what is printed [m].
    """
    tightest: dict[int, Bound] = {}
    for path in paths:
        for rows in _blocks(len(path.task)):
            for k, bound in enumerate(_bounds(cell, path, rows, tolerance, middle, least_sigma)):
                if k not in tightest or bound.factor < tightest[k].factor:
                    tightest[k] = bound
    *joints, sigma = (tightest[k] for k in sorted(tightest))
    return (*sorted(joints, key=lambda bound: bound.factor), sigma)


def _blocks(n: int) -> Iterator[slice]:
    return (slice(start, min(start + BLOCK, n)) for start in range(0, n, BLOCK))


def _bounds(
    cell: Cell, path: JointPath, rows: slice, tolerance: Tolerance, middle: Array, least_sigma: float
) -> Iterator[Bound]:
    """The tightest place of each solved joint and of the singularity margin among some samples of a path."""
    task, q, solved = path.task, path.q[rows], list(cell.solved)
    slopes, sigma = displacement_slopes(cell, path, rows, middle)
    change = tolerance.shift * np.linalg.norm(slopes[:, :, :3], axis=2)
    change += tolerance.turn * np.linalg.norm(slopes[:, :, 3:], axis=2)
    below, above = (q - cell.limits.q_min)[:, solved], (cell.limits.q_max - q)[:, solved]
    at = np.arange(rows.start, rows.stop)
    deposits = (at >= task.first) & (at <= task.last)
    room = np.column_stack([np.minimum(below, above), np.where(deposits, sigma - least_sigma, np.inf)])
    towards = np.column_stack([np.where(above < below, 1.0, -1.0), -np.ones(len(q))])
    factor = np.divide(room, change, out=np.full_like(room, np.inf), where=change > 0.0)
    for k, i in enumerate(np.argmin(factor, axis=0)):
        joint = cell.arm.names[solved[k]] if k < len(solved) else ""
        yield Bound(
            what=RANGE if joint else SINGULARITY,
            joint=joint,
            change=float(change[i, k]),
            room=float(room[i, k]),
            factor=float(factor[i, k]),
            bead=task.bead,
            layer=task.layer,
            s=float(task.s[at[i]]),
            worst=_worst(joint, towards[i, k] * slopes[i, k], tolerance),
        )


def _worst(joint: str, slope: Array, tolerance: Tolerance) -> Displacement:
    """The displacement that raises a quantity of this slope (6) most."""
    name = f"worst for {joint}, to first order" if joint else "worst for the singularity margin, to first order"
    parts = []
    for size, part in ((tolerance.shift, slope[:3]), (tolerance.turn, slope[3:])):
        length = float(np.linalg.norm(part))
        x, y, z = size * part / length if length > 0.0 else np.zeros(3)
        parts.append((float(x), float(y), float(z)))
    return Displacement(name, *parts)


def displacement_slopes(cell: Cell, path: JointPath, rows: slice, middle: Array) -> tuple[Array, Array]:
    """Slopes (n, k + 1, 6) of the k solved joints [rad] and of sigma by shift [m] and turn [rad] of the part, and sigma (n).

    sigma is the smallest singular value of the arm's whole Jacobian at the tip. Slopes are infinite in a singularity.
    """
    na, q = len(cell.arm), path.q[rows]
    J = cell.arm.jacobians(q[:, :na])
    solved = list(cell.solved)
    J6 = J[:, :, solved]
    regular = np.linalg.det(J6) != 0.0
    inverse = np.full_like(J6, np.inf)
    inverse[regular] = np.linalg.inv(J6[regular])
    R = cell.holder.poses(q[:, na:])[:, :3, :3]
    arm = path.task.tip[rows] - middle
    moves = np.zeros((len(q), 6, 6))
    moves[:, :3, :3] = moves[:, 3:, 3:] = R
    moves[:, :3, 3:] = -R @ _cross_matrices(arm)
    joints = np.full((len(q), len(solved), 6), np.inf)
    joints[regular] = inverse[regular] @ moves[regular]
    u, values, vt = np.linalg.svd(J)
    by_joint = _sigma_slope(J, u[:, :, 5], vt[:, 5])[:, solved]
    with np.errstate(invalid="ignore"):
        sigma = np.einsum("nk,nkc->nc", by_joint, joints)
    return np.concatenate([joints, np.nan_to_num(sigma, nan=np.inf)[:, None]], axis=1), values[:, 5]


def _cross_matrices(v: Array) -> Array:
    """Matrices (n, 3, 3) that multiply a vector as v x does, for v (n, 3)."""
    out = np.zeros((len(v), 3, 3))
    out[:, 2, 1], out[:, 0, 2], out[:, 1, 0] = v.T
    out[:, 1, 2], out[:, 2, 0], out[:, 0, 1] = -v.T
    return out


def _sigma_slope(J: Array, u: Array, v: Array) -> Array:
    """Slopes (n, na) of a singular value by the arm's joints, u (n, 6) and v (n, na) its singular vectors, J (n, 6, na).

    Turning joint k carries all columns o >= k along, and moves the tip for those before it.
    """
    direction = np.swapaxes(J[:, 3:], 1, 2)
    linear = np.cross(u[:, None, :3], direction) @ J[:, :3]  # [k, o]: u . (d_k x J_o)
    angular = np.cross(u[:, None, 3:], direction) @ J[:, 3:]
    upper = np.triu(linear)
    both = upper + np.swapaxes(np.triu(linear, 1), 1, 2) + np.triu(angular)
    return np.asarray(np.einsum("nko,no->nk", both, v))
