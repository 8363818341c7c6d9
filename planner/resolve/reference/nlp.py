"""Strategy `nlp`: the refinement of `sqp` as one sparse nonlinear program, solved by IPOPT. A slow reference."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
from scipy import sparse

from planner.base.arrays import Array
from planner.base.errors import Refusal
from planner.cell.cell import Cell
from planner.cell.kinematics.chain import Chain
from planner.problem.settings import ResolveSpec
from planner.resolve.by_nozzle import with_each_nozzle
from planner.resolve.joint_path import JointPath, choose_turns
from planner.resolve.ladder import ladder
from planner.resolve.prices import (
    ANCHOR,
    DIP,
    DIP_PRICE,
    EFFORT,
    LIMIT_COMFORT,
    LIMIT_PRICE,
    SIGMA_COMFORT,
    SIGMA_PRICE,
)
from planner.resolve.refine import CONE_ROOM, bounded_cones, evaluate
from planner.resolve.segment import (
    HOLDER,
    ROLL,
    TILT,
    Model,
    PathSegment,
    PathState,
)
from planner.resolve.sqp import Improve, given_prices, refine_beads, sigma_floor
from planner.resolve.terms import model_of
from planner.toolpath.task import Cones, NozzleTask

# ----------------------------------------------------------------------------------------------------
# Symbolic forward kinematics of serial chains, for programs that need exact derivatives of any order.
#
# Pinocchio's wheel has no CasADi bindings. A `Chain` is read off a Pinocchio model once, so its constants, with symbols
# for the joints, describe the same mechanism.

_TERMS = 14  # terms of the series of sine and cosine: the remainder is below 1e-16 up to an angle of 3 rad


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
        direction = T[:3, :3] @ ca.SX(axis[:3])
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
    """World poses of the world itself and of every link after its joint."""
    frames = [ca.SX.eye(4)]
    for i, (placement, axis) in enumerate(zip(chain.placements, chain.axes, strict=True)):
        T = _times(frames[-1], placement)
        T[:3, :3] = T[:3, :3] @ _rotation(axis[:3], q[i])
        frames.append(T)
    return frames


def _times(T: ca.SX, constant: Array) -> ca.SX:
    """T times a constant transform, whose exact zeros and ones generate no operations."""
    return T @ ca.sparsify(ca.SX(constant))


def _rotation(axis: Array, angle: ca.SX) -> ca.SX:
    """Rotation (3, 3) about a unit axis (Rodrigues)."""
    x, y, z = axis
    K = ca.sparsify(ca.SX(np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])))
    return ca.SX.eye(3) + ca.sin(angle) * K + (1.0 - ca.cos(angle)) * (K @ K)


# ----------------------------------------------------------------------------------------------------
# The program of strategy `nlp`: a bead's price and constraints over all variables, with exact sparse derivatives.
#
# The only variables that samples share are the control values c. Everything else belongs to one sample i, in a vector
# v_i: joints, roll and tilt, the joints' rates as shares of their limits, slack, the arm's least singular value and its
# singular vector.
#
#     minimise   sum_i f(v_i) + ends(c)
#     subject to g(v_i) = 0 or <= 0       pose, singular vector, shares within what the slack allows, cones
#                z_i = sum B c,  share_i = sum D q / limits
#
# So nonlinear derivatives come in blocks along a diagonal, and whatever couples samples is linear.

DAMPING = 1.0  # of control values in the approach, in units of a sample's time: its first steps are too long otherwise
EQUALITIES = 13  # of a sample: pose, singular vector, its length
_LEAST_SIGMA = 1e-3  # bound on sigma in runs: the price divides by it
_ROOM = 1e-3  # slack added to the least one at the start, to be inside the bounds


@dataclass(frozen=True)
class Layout:
    """Where a sample's variables are in its vector: joints, roll and tilt, shares, slack, singular vector, value."""

    joints: int
    tilts: int

    @property
    def turn(self) -> slice:
        """Roll and, where the axis may lean, the two tilts."""
        return slice(self.joints, self.joints + 1 + self.tilts)

    @property
    def shares(self) -> slice:
        """Shares of velocity, acceleration and jerk limits that each joint takes."""
        return slice(self.turn.stop, self.turn.stop + 3 * self.joints)

    @property
    def slack(self) -> int:
        """How far the shares may exceed 1."""
        return self.shares.stop

    @property
    def vector(self) -> slice:
        """Singular vector of the least singular value."""
        return slice(self.slack + 1, self.slack + 7)

    @property
    def sigma(self) -> int:
        """Least singular value."""
        return self.slack + 7

    @property
    def size(self) -> int:
        """Variables of a sample."""
        return self.slack + 8


def layout_of(model: Model, cones: Cones) -> Layout:
    """The layout of a model's samples; tilts are variables only where a cone lets the axis lean."""
    return Layout(len(model.low), 2 if cones.tilt > 0.0 else 0)


@dataclass(frozen=True)
class _Sample:
    """Variables v and parameters p (tip, frame, normal, step, deposits) of a sample, its share f of the price, and g.

    g: EQUALITIES, then what must not be positive: shares against the slack, from above and from below, then cones.
    convex: diagonal of f's second derivatives without those that are negative, as in `terms`
    """

    v: ca.SX
    p: ca.SX
    f: ca.SX
    g: ca.SX
    convex: ca.SX


def _sample(cell: Cell, model: Model, cones: Cones) -> _Sample:
    """What one sample adds to the program."""
    at = layout_of(model, cones)
    nj, na = at.joints, model.arm
    v, p = ca.SX.sym("v", at.size), ca.SX.sym("p", 17)
    q, shares, slack, u, sigma = v[:nj], v[at.shares], v[at.slack], v[at.vector], v[at.sigma]
    tip, frame, normal, step, deposits = p[:3], ca.reshape(p[3:12], 3, 3).T, p[12:15], p[15], p[16]

    nozzle, part = symbolic_pose(cell.arm, q[:na]), symbolic_pose(cell.holder, q[na:])
    tilt = symbolic_tilt(v[at.turn][1:]) if at.tilts else ca.SX.eye(3)
    wanted = part[:3, :3] @ frame @ tilt @ symbolic_roll(v[at.turn][0])
    error = wanted.T @ nozzle[:3, :3]
    pose = ca.vertcat(part[:3, :3] @ tip + part[:3, 3] - nozzle[:3, 3], error[0, 2], error[1, 2], error[1, 0])
    J = symbolic_jacobian(cell.arm, q[:na])
    singular = ca.vertcat(J @ (J.T @ u) - sigma**2 * u, ca.sumsqr(u) - 1.0)

    allowed = ca.vertcat(*[ca.repmat((1.0 + slack) ** k, nj) for k in (1, 2, 3)])
    rows = [shares - allowed, -shares - allowed]
    if cones.nozzle_gravity < np.pi:
        rows.append(np.cos(cones.nozzle_gravity - CONE_ROOM) + nozzle[2, 2])
    if cones.layer_gravity < np.pi:
        rows.append(np.cos(cones.layer_gravity - CONE_ROOM) - (part[:3, :3] @ normal)[2])
    if cones.tilt > 0.0:
        rows.append(np.cos(cones.tilt - CONE_ROOM) + ca.dot((frame @ tilt)[:, 2], normal))

    convex = ca.SX.zeros(at.size)
    cost = deposits * (slack + DIP_PRICE * slack / (slack + DIP))
    effort = np.repeat(EFFORT, nj) / nj
    cost += ca.dot(effort, shares**2 / (1.0 + shares**2))
    convex[at.shares] = 2.0 * effort / (1.0 + shares**2) ** 2
    close = SIGMA_COMFORT / sigma - 1.0
    cost += SIGMA_PRICE * ca.fmax(0.0, close) ** 2
    convex[at.sigma] = ca.if_else(close > 0.0, 2.0 * SIGMA_PRICE * (SIGMA_COMFORT / sigma**2) ** 2, 0.0)
    for j in range(na):
        # at most one end is near
        for room in (q[j] - model.low[j], model.high[j] - q[j]):
            cost += LIMIT_PRICE * ca.fmax(0.0, 1.0 - room / LIMIT_COMFORT) ** 2
            convex[j] += ca.if_else(room < LIMIT_COMFORT, 2.0 * LIMIT_PRICE / LIMIT_COMFORT**2, 0.0)
    return _Sample(v, p, step * cost, ca.vertcat(pose, singular, *rows), step * convex)


def _linear(model: Model, stretch: PathSegment, k: int) -> sparse.csr_matrix:
    """Rows A with A [v; c] = 0: splines, then shares; v sample by sample, c (k, m)."""
    at = layout_of(model, stretch.cones)
    n, nj = len(stretch.tip), at.joints
    active = model.active(stretch.cones)
    m = len(active)
    places = {ROLL: nj, TILT[0]: nj + 1, TILT[1]: nj + 2}
    chosen = [*range(model.arm, nj), *model.given]
    places.update({HOLDER + h: int(joint) for h, joint in enumerate(chosen)})
    A = sparse.lil_matrix((n * (m + 3 * nj), n * at.size + k * m))
    for i in range(n):
        for c, column in enumerate(active):
            row = i * m + c
            A[row, i * at.size + places[int(column)]] = 1.0
            for e, b in enumerate(stretch.B[i, 0]):
                A[row, n * at.size + (stretch.first[i] + e) * m + c] = -b
        for o in range(3):
            for j in range(nj):
                row = n * m + (i * 3 + o) * nj + j
                A[row, i * at.size + at.shares.start + o * nj + j] = 1.0
                for s in range(5):
                    A[row, (stretch.centre[i] + s - 2) * at.size + j] = -stretch.D[i, o, s] / model.limits[o, j]
    return A.tocsr()


@dataclass(frozen=True)
class NonlinearProgram:
    """The whole program's functions in the form that `nlpsol` takes; rows: how many g has at a sample.

    hessian, convex: second derivatives of the Lagrangian, all of them and the convex part of the price only
    """

    values: ca.Function
    gradient: ca.Function
    jacobian: ca.Function
    hessian: ca.Function
    convex: ca.Function
    rows: int

    def solver(self, exact: bool, options: Mapping[str, Any]) -> ca.Function:
        """IPOPT for this program."""
        given = {"grad_f": self.gradient, "jac_g": self.jacobian, "hess_lag": self.hessian if exact else self.convex}
        return ca.nlpsol("nlp", "ipopt", self.values, {**given, "print_time": False, "ipopt": dict(options)})


def program_of(cell: Cell, model: Model, stretch: PathSegment, k: int) -> NonlinearProgram:
    """The program of a whole bead with k control values of each free variable; derivatives are exact and sparse."""
    sample = _sample(cell, model, stretch.cones)
    v, p, f, g = sample.v, sample.p, sample.f, sample.g
    n, size, rows = len(stretch.tip), v.numel(), g.numel()
    m = len(model.active(stretch.cones))
    typical = float(stretch.step.mean())
    x, none = ca.MX.sym("x", n * size + k * m), ca.MX.sym("p", 0)
    V, c = ca.reshape(x[: n * size], size, n), x[n * size :]
    given = np.vstack(
        [stretch.tip.T, stretch.frames.reshape(n, 9).T, stretch.normals.T, stretch.step / typical, stretch.deposits]
    )
    P = ca.MX(ca.DM(given))
    pull = ca.DM(np.repeat(stretch.hold, m) * ANCHOR / typical)
    away = c - ca.DM(stretch.anchor.ravel())
    A = ca.DM(_linear(model, stretch, k).tocsc())

    f_all, g_all = ca.Function("value", [v, p], [f, g]).map(n)(V, P)
    f_all, g_all = ca.sum2(f_all) + ca.dot(pull, away**2), ca.vertcat(ca.vec(g_all), A @ x)
    slopes = ca.Function("slope", [v, p], [ca.gradient(f, v)]).map(n)(V, P)
    gradient = ca.vertcat(ca.vec(slopes), 2.0 * pull * away)
    jacobian = _along_diagonal(ca.Function("jacobian", [v, p], [ca.jacobian(g, v)]), n, V, P)
    jacobian = ca.vertcat(ca.horzcat(jacobian, ca.MX(n * rows, k * m)), A)

    lam_f, lam_g = ca.SX.sym("lam_f"), ca.SX.sym("lam_g", rows)
    exact = ca.triu(ca.hessian(lam_f * f + ca.dot(lam_g, g), v)[0])
    ends = ca.MX.sym("lam_f")
    lam = ca.MX.sym("lam_g", g_all.numel())
    arguments = (V, P, ca.repmat(ends, 1, n), ca.reshape(lam[: n * rows], rows, n))
    hessians = []
    for name, block in (("hessian", exact), ("convex", ca.diag(lam_f * sample.convex))):
        own = _along_diagonal(ca.Function(name, [v, p, lam_f, lam_g], [block]), n, *arguments)
        H = ca.diagcat(own, ca.diag(2.0 * ends * pull + (0.0 if name == "hessian" else DAMPING)))
        hessians.append(ca.Function(name, [x, none, ends, lam], [H], ["x", "p", "lam_f", "lam_g"], ["H"]))
    return NonlinearProgram(
        ca.Function("values", [x, none], [f_all, g_all], ["x", "p"], ["f", "g"]),
        ca.Function("gradient", [x, none], [f_all, gradient], ["x", "p"], ["f", "slope"]),
        ca.Function("jacobian", [x, none], [g_all, jacobian], ["x", "p"], ["g", "J"]),
        hessians[0],
        hessians[1],
        rows,
    )


def _along_diagonal(block: ca.Function, n: int, *arguments: ca.MX) -> ca.MX:
    """The sparse matrix with a function's n values, for n columns of arguments, as blocks along its diagonal."""
    whole_of_it = ca.diagcat(*[block.sparsity_out(0)] * n)
    return ca.sparsity_cast(block.map(n)(*arguments), whole_of_it)


def start_values(cell: Cell, model: Model, stretch: PathSegment, state: PathState) -> Array:
    """The variables of a path, with slacks a little larger than necessary."""
    at = layout_of(model, stretch.cones)
    n = len(stretch.tip)
    v = np.zeros((n, at.size))
    v[:, : at.joints] = state.q
    z = np.einsum("nb,nbk->nk", stretch.B[:, 0], state.c[stretch.first[:, None] + np.arange(stretch.B.shape[2])])
    v[:, at.turn] = z[:, : 1 + at.tilts]
    v[:, at.shares] = (state.rates / model.limits).reshape(n, -1)
    v[:, at.slack] = (state.slack + _ROOM) * stretch.deposits
    J = cell.arm.jacobians(state.q[:, : model.arm])
    squares, vectors = np.linalg.eigh(J @ np.swapaxes(J, 1, 2))
    v[:, at.vector], v[:, at.sigma] = vectors[:, :, 0], np.sqrt(squares[:, 0])
    return np.concatenate([v.ravel(), state.c.ravel()])


def bounds_of(model: Model, stretch: PathSegment, state: PathState) -> tuple[Array, Array]:
    """Least and greatest values of all variables; control values that are not free stay where they are."""
    at = layout_of(model, stretch.cones)
    n = len(stretch.tip)
    low, high = np.full((n, at.size), -np.inf), np.full((n, at.size), np.inf)
    low[:, : model.arm], high[:, : model.arm] = model.low[: model.arm], model.high[: model.arm]
    low[:, at.slack] = 0.0
    high[stretch.deposits == 0.0, at.slack] = 0.0
    low[:, at.sigma] = np.where(
        stretch.deposits > 0.0, state.least_sigma, _LEAST_SIGMA
    )  # no floor in runs, but above 0
    c_low, c_high = np.full(state.c.shape, -np.inf), np.full(state.c.shape, np.inf)
    chosen = [*range(model.arm, len(model.low)), *model.given]
    columns = slice(state.c.shape[1] - len(chosen), None)
    c_low[:, columns], c_high[:, columns] = model.low[chosen], model.high[chosen]
    held = stretch.free == 0.0
    c_low[held] = c_high[held] = state.c[held]
    return np.concatenate([low.ravel(), c_low.ravel()]), np.concatenate([high.ravel(), c_high.ravel()])


def row_bounds(stretch: PathSegment, rows: int, count: int) -> tuple[Array, Array]:
    """Least and greatest values of all rows; rates are unbounded where nothing is deposited."""
    n = len(stretch.tip)
    low, high = np.zeros(count), np.zeros(count)
    own_low, own_high = low[: n * rows].reshape(n, rows), high[: n * rows].reshape(n, rows)
    own_low[:, EQUALITIES:] = -np.inf
    bounded, _ = bounded_cones(stretch.cones)
    own_high[stretch.deposits == 0.0, EQUALITIES : rows - len(bounded)] = np.inf
    return low, high


# ----------------------------------------------------------------------------------------------------
# Strategy `nlp`: the refinement of `sqp` as one sparse nonlinear program, solved by IPOPT. A slow reference.
#
# The same windows of the same splines, the same bounds, and the same price except for peaks of the joints' speed
# (`refine.calmed`) and clearance. But no variable is eliminated and nothing stays linearised: besides the control
# values, all joints, rates, slacks and singular values are variables at every sample, and kinematics and differences
# are constraints with exact first and second derivatives.
# So where `sqp` stops early, or its elimination of the joints is wrong, this finds a lower price from the same start.

_COMMON = {
    "print_level": 0,
    "sb": "yes",
    "bound_push": 1e-4,
    "bound_frac": 1e-4,
    "slack_bound_push": 1e-4,
    "slack_bound_frac": 1e-4,
}
# First with only the convex part of the second derivatives, which needs no regularisation but creeps at the end; then,
# from a point that is nearly right, with all of them.
_APPROACH = {
    **_COMMON,
    "max_iter": 100,
    "mu_init": 1e-2,
    "acceptable_iter": 4,
    "acceptable_tol": 1e10,
    "acceptable_dual_inf_tol": 1e10,
    "acceptable_constr_viol_tol": 1e-5,
    "acceptable_compl_inf_tol": 3e-4,
    "acceptable_obj_change_tol": 1e-5,
}
_FINISH = {
    **_COMMON,
    "max_iter": 250,
    "mu_init": 1e-5,
    "tol": 1e-6,
    "warm_start_init_point": "yes",
    "warm_start_bound_push": 1e-8,
    "warm_start_bound_frac": 1e-8,
    "warm_start_slack_bound_push": 1e-8,
    "warm_start_slack_bound_frac": 1e-8,
    "warm_start_mult_bound_push": 1e-8,
}


@dataclass(frozen=True)
class NlpSolution:
    """IPOPT's result for a path: its state, the number of steps, and the status at the end."""

    state: PathState
    steps: int
    status: str


@with_each_nozzle
def nlp(cell: Cell, tasks: Sequence[NozzleTask], settings: ResolveSpec) -> tuple[JointPath, ...]:
    """The ladder's paths, refined by IPOPT in the windows of `sqp` with its default weights, as a reference for it.

    Takes minutes for a window of a thousand samples or so. No path costs more than before. Raises Refusal as `ladder`
    does, and for joints that slide.
    """
    if cell.limits.sliding:
        name = cell.joint_names[cell.limits.sliding[0]]
        raise Refusal(
            f"strategy nlp does not support sliding joints, such as {name}; strategy sqp solves the same problem"
        )
    model = model_of(cell)
    paths = ladder(cell, tasks, settings)
    given = given_prices(model, paths, settings)
    refined = refine_beads(cell, model, paths, settings, given, sigma_floor(given, settings), by_ipopt(cell))
    return choose_turns(cell, refined)


def by_ipopt(cell: Cell) -> Improve:
    """Refinement of a window by IPOPT."""
    return lambda model, stretch, state: solve_nlp(cell, model, stretch, state).state


def solve_nlp(cell: Cell, model: Model, stretch: PathSegment, state: PathState) -> NlpSolution:
    """Refine a state; the result never costs more than the given one, and stays on its branch."""
    program = program_of(cell, model, stretch, len(state.c))
    lbx, ubx = bounds_of(model, stretch, state)
    lbg, ubg = row_bounds(stretch, program.rows, int(program.values.size1_out("g")))
    x, lam_x, lam_g = start_values(cell, model, stretch, state), np.zeros(len(lbx)), np.zeros(len(lbg))
    steps, status = 0, ""
    for exact, options in ((False, _APPROACH), (True, _FINISH)):
        solver = program.solver(exact, options)
        found = solver(x0=x, lam_x0=lam_x, lam_g0=lam_g, lbx=lbx, ubx=ubx, lbg=lbg, ubg=ubg)
        x, lam_x, lam_g = (np.asarray(found[name]).ravel() for name in ("x", "lam_x", "lam_g"))
        steps += int(solver.stats()["iter_count"])
        status = str(solver.stats()["return_status"])
        state = _cheaper(cell, model, stretch, state, x)
    return NlpSolution(state, steps, status)


def _cheaper(cell: Cell, model: Model, stretch: PathSegment, state: PathState, x: Array) -> PathState:
    """The state with the control values in x, if that costs less and stays on the branch."""
    c = x[len(x) - state.c.size :].reshape(state.c.shape)
    q = x[: len(x) - state.c.size].reshape(len(state.q), -1)[:, : state.q.shape[1]]
    other = evaluate(model, stretch, c, np.ascontiguousarray(q), state.least_sigma)
    if other is None or other.price >= state.price:
        return state
    before, after = (cell.inverse.branches(each.q[:, : model.arm]) for each in (state, other))
    return state if (before != after).any() else other
