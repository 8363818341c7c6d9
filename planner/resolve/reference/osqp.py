"""OSQP in place of our own solver: another algorithm (ADMM), slower here, to check the refinement against."""

from __future__ import annotations

import numpy as np
import osqp
from scipy import sparse

from planner.base.arrays import Array
from planner.resolve.quadratic import QuadraticProgram, Solution, Status

_STEPS = 20_000
_TOLERANCE = 1e-6  # absolute and relative, of OSQP's residuals
_STATUS = {  # all others: it claims that there is no solution, but our programs always have one
    int(osqp.SolverStatus.OSQP_SOLVED): Status.SOLVED,
    int(osqp.SolverStatus.OSQP_SOLVED_INACCURATE): Status.STOPPED,
    int(osqp.SolverStatus.OSQP_MAX_ITER_REACHED): Status.STOPPED,
}


def standard_form(qp: QuadraticProgram) -> tuple[sparse.csc_matrix, Array, sparse.csc_matrix, Array, Array]:
    """P, c, A, low, high of: minimise 1/2 y^T P y + c^T y, low <= A y <= high, y = (x, slacks); P: upper triangle."""
    (n, width), rows, groups = qp.H.shape, len(qp.b), len(qp.price)
    i, d = np.meshgrid(np.arange(n), np.arange(width), indexing="ij")
    inside = i >= d
    P = sparse.csc_matrix((qp.H[inside], ((i - d)[inside], i[inside])), shape=(n, n))
    row, column = np.repeat(np.arange(rows), width), (qp.at[:, None] + np.arange(width)).ravel()
    own = sparse.csc_matrix((qp.A.ravel(), (row, column)), shape=(rows, n))
    group_of = np.repeat(np.arange(groups), np.diff(qp.group))
    slack = sparse.csc_matrix((np.ones(rows), (np.arange(rows), group_of)), shape=(rows, groups))
    return (
        sparse.block_diag([P, sparse.csc_matrix((groups, groups))], format="csc"),
        np.concatenate([qp.g, qp.price]),
        sparse.vstack([sparse.hstack([own, -slack]), sparse.eye(n + groups)], format="csc"),
        np.concatenate([np.full(rows, -np.inf), -qp.box, np.zeros(groups)]),
        np.concatenate([qp.b, qp.box, np.full(groups, np.inf)]),
    )


def solve_with_osqp(qp: QuadraticProgram) -> Solution:
    """As `solve_qp`; gap and residual are those that OSQP reports for its own iterate."""
    P, c, A, low, high = standard_form(qp)
    solver = osqp.OSQP()
    solver.setup(
        P, c, A, low, high, verbose=False, polishing=True, max_iter=_STEPS, eps_abs=_TOLERANCE, eps_rel=_TOLERANCE,
    )  # fmt: skip
    result = solver.solve(raise_error=False)
    info = result.info
    x = np.clip(np.asarray(result.x[: len(qp.g)]), -qp.box, qp.box)
    status = _STATUS.get(int(info.status_val), Status.FAILED)
    if not np.isfinite(x).all():
        x, status = np.zeros(len(qp.g)), Status.FAILED
    if not qp.value(x) < qp.value(np.zeros(len(x))):
        x = np.zeros(len(qp.g))
    residual = float(info.dual_res) * float(qp.box.sum())
    return Solution(x, int(info.iter), status, abs(float(info.duality_gap)), residual)
