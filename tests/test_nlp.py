"""Symbolic kinematics, the nonlinear program, and the reference solver of quadratic programs."""

from __future__ import annotations

import importlib
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import casadi as ca
import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from planner.base.arrays import Array
from planner.base.errors import InputError, Refusal
from planner.cell.cell import Cell, build_cell
from planner.cell.kinematics.chain import Chain
from planner.collision.scene import NOTHING
from planner.problem import load_problem
from planner.resolve.joint_path import JointPath
from planner.resolve.ladder import ladder
from planner.resolve.quadratic import QuadraticProgram, Status, solve_qp
from planner.resolve.reference import osqp as osqp_module
from planner.resolve.reference.nlp import (
    EQUALITIES,
    NonlinearProgram,
    bounds_of,
    by_ipopt,
    program_of,
    row_bounds,
    solve_nlp,
    start_values,
    symbolic_jacobian,
    symbolic_pose,
    symbolic_roll,
    symbolic_tilt,
)
from planner.resolve.reference.osqp import solve_with_osqp
from planner.resolve.refine import evaluate, expand, program_around, refine_stretch, watched
from planner.resolve.segment import PathSegment, PathState
from planner.resolve.sqp import (
    SplinePath,
    given_price,
    given_prices,
    qp_solver,
    refine_paths,
    refine_window,
    sigma_floor,
    start_track,
    whole,
)
from planner.resolve.strategies import STRATEGIES
from planner.resolve.terms import model_of
from planner.toolpath.task import Cones, NozzleTask

sqp_module = importlib.import_module("planner.resolve.sqp")
KNOT = 2.5e-3
FINE = 0.5e-3


# --- symbolic kinematics ----------------------------------------------------------------------------------------


def numbers(chain: Chain, q: Array) -> tuple[Array, Array]:
    """Poses (m, 4, 4) and Jacobians (m, 6, n) of a chain's symbolic form."""
    joints = ca.SX.sym("q", len(chain))
    both = ca.Function("both", [joints], [symbolic_pose(chain, joints), symbolic_jacobian(chain, joints)])
    poses, jacobians = zip(*(both(row) for row in q), strict=True)
    return np.array([np.array(T) for T in poses]), np.array([np.array(J).reshape(6, -1) for J in jacobians])


HOMES = {"irb140": [30, 20, 30, 90, -80, 60], "ur5": [0, -60, 60, 30, -80, 60], "iiwa": [0, 20, 0, 60, 0, 30, 0]}


@pytest.mark.parametrize(("arm", "home"), HOMES.items(), ids=HOMES)
def test_symbolic_arm_is_that_of_pinocchio(arm: str, home: list[float]) -> None:
    cell = build_cell(load_problem("cylinder_logo", [f"cell.arm={arm}", f"cell.home_deg={home}"]))
    chain = cell.arm
    model, data = cell.arm_robot.model, cell.arm_robot.model.createData()
    frame = model.getFrameId(cell.arm_robot.tip)
    q = np.random.default_rng(3).uniform(-3.0, 3.0, (20, len(chain)))
    poses, jacobians = numbers(chain, q)
    for k in range(len(q)):
        full = pin.neutral(model)
        for name, angle in zip(chain.names, q[k], strict=True):
            full[model.joints[model.getJointId(name)].idx_q] = angle
        J = pin.computeFrameJacobian(model, data, full, frame, pin.LOCAL_WORLD_ALIGNED)
        pin.framesForwardKinematics(model, data, full)
        T = cell.T_world_base @ data.oMf[frame].homogeneous @ cell.T_flange_nozzle
        np.testing.assert_allclose(poses[k], T, rtol=0, atol=1e-12)
        columns = [model.joints[model.getJointId(name)].idx_v for name in chain.names]
        lever = T[:3, 3] - (cell.T_world_base @ data.oMf[frame].homogeneous)[:3, 3]
        # the tool's tip moves with the flange and turns about it
        tip = J[:3, columns] + np.cross(J[3:, columns], lever, axis=0)
        np.testing.assert_allclose(jacobians[k], np.vstack([tip, J[3:, columns]]), rtol=0, atol=1e-12)


def test_symbolic_chains_are_the_compiled_ones(cell: Cell, bed_cell: Cell) -> None:
    rng = np.random.default_rng(4)
    for chain in (cell.arm, cell.holder, bed_cell.holder):
        q = rng.uniform(-3.0, 3.0, (20, len(chain)))
        poses, jacobians = numbers(chain, q)
        np.testing.assert_allclose(poses, chain.poses(q), rtol=0, atol=1e-12)
        np.testing.assert_allclose(jacobians, chain.jacobians(q), rtol=0, atol=1e-12)


@given(st.floats(-1.5, 1.5), st.floats(-1.5, 1.5), st.floats(-7.0, 7.0))
def test_symbolic_tilt_and_roll(x: float, y: float, roll: float) -> None:
    t, a = ca.SX.sym("t", 2), ca.SX.sym("a")
    both = ca.Function("both", [t, a], [symbolic_tilt(t), symbolic_roll(a)])
    tilted, rolled = both([x, y], roll)
    np.testing.assert_allclose(np.array(tilted), Rotation.from_rotvec([x, y, 0.0]).as_matrix(), rtol=0, atol=1e-14)
    np.testing.assert_allclose(np.array(rolled), Rotation.from_euler("z", roll).as_matrix(), rtol=0, atol=1e-14)


def test_symbolic_tilt_is_smooth_at_rest() -> None:
    t = ca.SX.sym("t", 2)
    slopes = ca.Function("slopes", [t], [ca.hessian(ca.sum1(ca.vec(symbolic_tilt(t))), t)[0]])([0.0, 0.0])
    # second derivatives of 1 - (x^2 + y^2) / 2 ... : K^2 / 2 summed over all entries
    np.testing.assert_allclose(np.array(slopes), [[-2.0, 1.0], [1.0, -2.0]], rtol=0, atol=1e-14)


# --- the nonlinear program --------------------------------------------------------------------------------------


def bead(cones: Cones | None = None, n: int = 60, turn: float = 1.0, wide: float = 0.2) -> NozzleTask:
    """A bend on the cylinder's wall, `wide` [rad] round it, with the runs on both sides, 6 mm and its samples."""
    u = np.linspace(0.0, 1.0, n)
    angle = 3.0 + wide * u
    rise = 0.04 + 2e-3 * np.tanh(turn * 6.0 * (u - 0.5))
    normal = np.column_stack([np.cos(angle), np.sin(angle), 0.0 * u])
    tip = np.array([31.4e-3, 37e-3, 0.0]) + 34e-3 * normal + np.column_stack([0.0 * u, 0.0 * u, rise])
    x = np.column_stack([0.0 * u, 0.0 * u, 1.0 + 0.0 * u])
    frames = np.stack([x, np.cross(-normal, x), -normal], axis=-1)
    s = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(tip, axis=0), axis=1))])
    return NozzleTask(0, "bend", 0, tip, frames, s - s[8], 8, n - 9, 0.04, cones or Cones())


@pytest.fixture(scope="module")
def path(cell: Cell) -> JointPath:
    """The ladder's path along the bend."""
    return ladder(cell, [bead()], load_problem("cylinder_logo").resolve)[0]


def started(cell: Cell, path: JointPath, cones: Cones) -> tuple[SplinePath, PathSegment, PathState, float]:
    """A path as splines, its stretch and state, and the floor of the singular value."""
    path = replace(path, task=replace(path.task, cones=cones))
    floor = sigma_floor(given_prices(model_of(cell), [path], load_problem("cylinder_logo").resolve), SETTINGS)
    track = start_track(model_of(cell), KNOT, floor, path, None)
    stretch = whole(track.task, track.clock, track.basis, track.anchor)
    state = evaluate(model_of(cell), stretch, track.c, track.q, floor)
    assert state is not None
    return track, stretch, state, floor


SETTINGS = load_problem("cylinder_logo").resolve
CONES = (Cones(), Cones(tilt=0.3, nozzle_gravity=2.0, layer_gravity=2.0))


def built(cell: Cell, stretch: PathSegment, state: PathState) -> tuple[NonlinearProgram, Array]:
    model = model_of(cell)
    return program_of(cell, model, stretch, len(state.c)), start_values(cell, model, stretch, state)


@pytest.mark.parametrize("cones", CONES, ids=["axis fixed", "axis free"])
def test_a_followed_path_satisfies_the_program_at_the_same_price(cell: Cell, path: JointPath, cones: Cones) -> None:
    track, stretch, _, floor = started(cell, path, cones)
    floor *= 0.9  # what is shaken may come closer to a singularity
    rng = np.random.default_rng(5)
    c = track.c + rng.uniform(-0.02, 0.02, track.c.shape)
    state = evaluate(model_of(cell), stretch, c, track.q, floor)
    assert state is not None
    program, x = built(cell, stretch, state)
    low, high = bounds_of(model_of(cell), stretch, state)
    g_low, g_high = row_bounds(stretch, program.rows, program.values.size1_out("g"))
    price, g = program.values(x, [])
    g = np.array(g).ravel()
    assert (g >= g_low - 1e-8).all()
    assert (g <= g_high + 1e-8).all()
    assert (x >= low - 1e-9).all()
    assert (x <= high + 1e-9).all()
    # the slacks of the start are 1e-3 larger than they must be
    typical = stretch.step.mean()
    assert 0.0 <= float(price) * typical - state.price < 0.0062 * stretch.step.sum()
    per_sample = g[: len(stretch.tip) * program.rows].reshape(-1, program.rows)
    assert np.abs(per_sample[:, :EQUALITIES]).max() < 1e-10


def test_a_wrong_joint_violates_the_program(cell: Cell, path: JointPath) -> None:
    _, stretch, state, _ = started(cell, path, Cones())
    program, x = built(cell, stretch, state)
    for joint in range(7):
        spoilt = x.copy()
        spoilt[joint] += 1e-3
        g = np.array(program.values(spoilt, [])[1]).ravel()
        assert np.abs(g[:6]).max() > 1e-5


@pytest.mark.slow(keep=("axis fixed",))
@pytest.mark.parametrize("cones", CONES, ids=["axis fixed", "axis free"])
def test_derivatives_are_those_of_differences(cell: Cell, path: JointPath, cones: Cones) -> None:
    _, stretch, state, _ = started(cell, path, cones)
    program, x = built(cell, stretch, state)
    rng = np.random.default_rng(6)
    along = rng.normal(size=len(x))
    lam = rng.normal(size=program.values.size1_out("g"))
    h = 1e-6

    def lagrangian_slope(at: Array) -> Array:
        slope = np.array(program.gradient(at, [])[1]).ravel()
        return slope + np.array(program.jacobian(at, [])[1].T @ lam).ravel()

    def lagrangian(at: Array) -> float:
        f, g = program.values(at, [])
        return float(f) + float(np.array(g).ravel() @ lam)

    first = (lagrangian(x + h * along) - lagrangian(x - h * along)) / (2 * h)
    assert first == pytest.approx(lagrangian_slope(x) @ along, rel=1e-5)
    second = (lagrangian_slope(x + h * along) - lagrangian_slope(x - h * along)) / (2 * h)
    upper = np.array(program.hessian(x, [], 1.0, lam))
    rounding = 1e-6 * float(np.abs(second).max())  # of differences of slopes, which are large
    np.testing.assert_allclose((upper + np.triu(upper, 1).T) @ along, second, rtol=1e-4, atol=max(1e-4, rounding))


@pytest.mark.slow
@pytest.mark.parametrize("cones", [Cones(), Cones(tilt=0.2)], ids=["axis fixed", "tilt"])
def test_sqp_is_as_good_as_the_reference(cell: Cell, path: JointPath, cones: Cones) -> None:
    track, stretch, state, floor = started(cell, path, cones)
    found = solve_nlp(cell, model_of(cell), stretch, state)
    assert found.status == "Solve_Succeeded"
    refined = refine_stretch(model_of(cell), stretch, state)
    assert found.state.price < 0.999 * track.price
    assert refined.price < 1.02 * found.state.price
    # what came back is a path of that price, on the same branch
    again = evaluate(model_of(cell), stretch, found.state.c, found.state.q, floor)
    assert again is not None
    assert again.price == pytest.approx(found.state.price, rel=1e-9)
    assert (cell.inverse.branches(found.state.q[:, :6]) == path.branch).all()


@pytest.mark.slow
def test_strategy_returns_paths_that_hold_the_task(cell: Cell) -> None:
    task = bead()
    (found,) = STRATEGIES["nlp"](cell, [task], SETTINGS, NOTHING)
    T = cell.T_part_nozzle(found.q)
    np.testing.assert_allclose(T[:, :3, 3], task.tip, rtol=0, atol=1e-10)
    np.testing.assert_allclose(T[:, :3, 2], task.frames[:, :, 2], rtol=0, atol=1e-10)


def test_a_window_moves_its_own_control_values(cell: Cell, path: JointPath) -> None:
    """And lowers the price of the path that it is a part of."""
    model, floor = model_of(cell), 0.05
    track = start_track(model, FINE, floor, path, None)
    stretch = whole(track.task, track.clock, track.basis, track.anchor)
    state = evaluate(model, stretch, track.c, track.q, floor)
    assert state is not None
    k = len(track.c)
    window = (k // 6, 5 * k // 6)
    piece = refine_window(model, floor, track, window, by_ipopt(cell))
    assert piece is not None and piece.state.price < piece.before.price
    c, q = track.c.copy(), track.q.copy()
    c[piece.controls], q[piece.samples] = piece.state.c, piece.state.q
    moved = np.flatnonzero((c != track.c).any(axis=1))
    assert moved.min() >= window[0] and moved.max() < window[1]
    again = evaluate(model, stretch, c, q, floor)
    assert again is not None
    assert state.price - again.price == pytest.approx(piece.before.price - piece.state.price, rel=1e-6)


@pytest.mark.slow
def test_long_beads_are_refined_in_windows(cell: Cell, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sqp_module, "WINDOW", 16)
    monkeypatch.setattr(sqp_module, "OVERLAP", 4)
    task, settings = bead(n=180, wide=0.6), load_problem("cylinder_logo", [f"resolve.knot_mm={FINE * 1e3}"]).resolve
    start = ladder(cell, [task], settings)[0]
    model = model_of(cell)
    assert len(sqp_module.windows(len(start_track(model, FINE, 0.0, start, None).c))) > 1
    (found,) = STRATEGIES["nlp"](cell, [task], settings, NOTHING)
    before, after = (given_price(model, each, 0.0).price for each in (start, found))
    assert after < before
    T = cell.T_part_nozzle(found.q)
    np.testing.assert_allclose(T[:, :3, 3], task.tip, rtol=0, atol=1e-10)


def test_joints_that_slide_are_refused() -> None:
    problem = load_problem("rail_panel")
    with pytest.raises(Refusal, match="strategy sqp solves the same problem"):
        STRATEGIES["nlp"](build_cell(problem), [bead()], problem.resolve, NOTHING)


def test_other_strategies_do_not_load_the_references() -> None:
    code = "import sys, planner.solve; sys.exit(bool({'casadi', 'osqp'} & set(sys.modules)))"
    root = Path(__file__).resolve().parents[1]
    assert subprocess.run([sys.executable, "-c", code], cwd=root, check=False).returncode == 0


# --- quadratic programs -----------------------------------------------------------------------------------------


def random_program(seed: int) -> QuadraticProgram:
    """A small program with bands, groups of one to three rows, and rows that are far away."""
    rng = np.random.default_rng(seed)
    n, w = 12, 4
    L = np.tril(rng.normal(size=(n, n))) * (np.subtract.outer(np.arange(n), np.arange(n)) < w // 2)
    full = L @ L.T + 1e-2 * np.eye(n)
    H = np.array([[full[i, i - d] if i >= d else 0.0 for d in range(w)] for i in range(n)])
    sizes = rng.integers(1, 4, 8)
    at = np.repeat(rng.integers(0, n - w + 1, len(sizes)), sizes)
    rows = int(sizes.sum())
    return QuadraticProgram(
        H, rng.normal(size=n), np.full(n, 0.5), rng.normal(size=(rows, w)), rng.normal(0.3, 0.5, rows), at,
        np.concatenate([[0], np.cumsum(sizes)]), rng.uniform(0.1, 5.0, len(sizes)),
    )  # fmt: skip


@settings(max_examples=40)
@given(st.integers(0, 10_000))
def test_our_solver_is_as_good_as_osqp(seed: int) -> None:
    qp = random_program(seed)
    own, other = solve_qp(qp).x, solve_with_osqp(qp).x
    assert (np.abs(own) <= qp.box).all()
    rest = qp.value(np.zeros(len(own)))
    descent = rest - min(qp.value(own), qp.value(other))
    assert qp.value(own) <= rest
    assert qp.value(own) - qp.value(other) <= 0.02 * descent + 1e-9
    assert qp.value(other) - qp.value(own) <= 1e-4 * descent + 1e-6


def test_osqp_says_how_it_left_a_program(monkeypatch: pytest.MonkeyPatch) -> None:
    qp = random_program(7)
    solution = solve_with_osqp(qp)
    assert solution.status is Status.SOLVED
    assert solution.gap < 1e-4 and solution.residual < 1e-3
    monkeypatch.setattr(osqp_module, "_STEPS", 2)
    assert solve_with_osqp(qp).status is Status.STOPPED
    assert solve_with_osqp(replace(qp, g=qp.g * np.inf)).status is Status.FAILED


def test_programs_of_a_bead_are_solved_alike(cell: Cell, path: JointPath) -> None:
    _, stretch, state, _ = started(cell, path, Cones(tilt=0.2))
    for trust in (0.3, 0.05, 0.005):
        model = model_of(cell)
        around, watch = expand(model, stretch, state), watched(model, stretch, state, trust)
        qp = program_around(model, stretch, state, around, trust, watch)
        own, other = solve_qp(qp).x, solve_with_osqp(qp).x
        rest = qp.value(np.zeros(len(own)))
        assert qp.value(own) - qp.value(other) <= 0.01 * (rest - qp.value(other))


def test_refinement_may_use_osqp(cell: Cell, path: JointPath) -> None:
    assert qp_solver("osqp") is solve_with_osqp
    assert qp_solver("interior_point") is solve_qp
    model = model_of(cell)
    prices = []
    for name in ("interior_point", "osqp"):
        chosen = load_problem("cylinder_logo", [f"resolve.qp={name}"]).resolve
        prices.append(given_prices(model, refine_paths(cell, [path], chosen), chosen)[0][0])
    assert prices[0] < given_prices(model, [path], SETTINGS)[0][0]
    assert prices[0] == pytest.approx(prices[1], rel=0.01)


def test_unknown_solver_is_an_input_error() -> None:
    with pytest.raises(InputError, match="interior_point"):
        load_problem("cylinder_logo", ["resolve.qp=oqsp"])
