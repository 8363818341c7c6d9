"""What the strategy `sqp` computes with: splines and clocks, Newton's method on the chain, the interior-point method."""

from __future__ import annotations

from dataclasses import dataclass, replace

import clarabel
import numpy as np
import pytest
import scipy.sparse as sp
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.interpolate import BSpline
from scipy.spatial.transform import Rotation

from planner.base.arrays import Array
from planner.cell.cell import Cell, build_cell
from planner.problem import load_problem
from planner.resolve.follow import PosturesFollowed, follow
from planner.resolve.price_kernels import foreseen
from planner.resolve.quadratic import ACCURACY, QuadraticProgram, Status, factorise, solve_qp, substitute
from planner.resolve.segment import HOLDER
from planner.resolve.splines import Clock, basis_over, clock_of
from planner.resolve.sqp import fit
from planner.resolve.terms import model_of

# --- splines ----------------------------------------------------------------------------------------------------


def clamped(controls: int) -> tuple[Array, int]:
    degree = min(5, controls - 1)
    inner = np.linspace(0.0, 1.0, controls - degree + 1)
    return np.concatenate([np.zeros(degree), inner, np.ones(degree)]), degree


def uneven_clock(n: int, bend: float = 0.3) -> Clock:
    """Times that draw together and apart along the samples."""
    u = np.linspace(0.0, 1.0, n)
    return clock_of(3.0 * (u + bend * u**2 + 0.05 * np.sin(4.0 * u)))


@pytest.mark.parametrize("controls", [2, 3, 4, 5, 6, 7, 30])
def test_basis_is_scipys(controls: int) -> None:
    n = 131
    knots, degree = clamped(controls)
    basis = basis_over(
        clock_of(np.linspace(0.0, 1.0, n)), np.linspace(0.0, 1.0, controls)
    )  # time is the splines' own parameter
    assert basis.B.shape == (n, 4, degree + 1)
    dense = np.zeros((n, 4, controls))
    for i in range(n):
        dense[i, :, basis.first[i] : basis.first[i] + degree + 1] = basis.B[i]
    u = np.linspace(0.0, 1.0, n)
    for order in range(4):
        if order > degree:
            np.testing.assert_allclose(dense[:, order], 0.0, atol=1e-7)
            continue
        expected = BSpline(knots, np.eye(controls), degree).derivative(order)(u) if order else (
            BSpline(knots, np.eye(controls), degree)(u)
        )  # fmt: skip
        # a derivative that jumps at a knot may be either side's
        at_knot = np.isclose(u[:, None], knots, atol=1e-9).any(axis=1) & (order >= degree)
        rows = ~at_knot
        np.testing.assert_allclose(dense[rows, order], expected[rows], rtol=1e-8, atol=1e-7 * controls**order)
    np.testing.assert_allclose(dense[:, 0].sum(axis=1), 1.0, atol=1e-12)
    np.testing.assert_allclose(dense[:, 1:].sum(axis=2), 0.0, atol=1e-8 * controls**3)
    assert (dense[:, 0] >= -1e-15).all()
    c = np.random.default_rng(controls).normal(size=(controls, 2))
    np.testing.assert_allclose(basis.values(c), dense[:, 0] @ c, atol=1e-12)


def test_derivatives_in_time_on_an_uneven_clock() -> None:
    """By refinement: the spline as a function of time, interpolated densely and differentiated by scipy."""
    n, controls = 400, 9
    u = np.linspace(0.0, 1.0, n)
    clock, basis = uneven_clock(n), basis_over(uneven_clock(n), np.linspace(0.0, 1.0, controls))
    c = np.random.default_rng(1).normal(size=(controls, 3))
    knots, degree = clamped(controls)
    f = [BSpline(knots, c, degree).derivative(k)(u) for k in (1, 2, 3)]
    t1 = (3.0 * (1 + 0.6 * u + 0.2 * np.cos(4 * u)))[:, None]  # dt/du and so on, by hand
    t2 = (3.0 * (0.6 - 0.8 * np.sin(4 * u)))[:, None]
    t3 = (3.0 * (-3.2 * np.cos(4 * u)))[:, None]
    by_time = [f[0] / t1, f[1] / t1**2 - f[0] * t2 / t1**3]
    by_time.append(f[2] / t1**3 - 3 * f[1] * t2 / t1**4 + f[0] * (3 * t2**2 / t1**5 - t3 / t1**4))
    moved = c[basis.first[:, None] + np.arange(degree + 1)]
    for k, tolerance in ((1, 1e-6), (2, 1e-5), (3, 1e-4)):
        scale = np.abs(by_time[k - 1]).max()
        seen = np.einsum("nb,nbk->nk", basis.B[:, k], moved)
        np.testing.assert_allclose(seen, by_time[k - 1], rtol=0, atol=tolerance * scale)
    # and the clock's own differences of the samples say the same, as well as differences can
    rates = clock.rates(basis.values(c))
    for k, tolerance in ((0, 1e-5), (1, 1e-4), (2, 2e-2)):
        scale = np.abs(by_time[k]).max()
        np.testing.assert_allclose(rates[2:-2, k], by_time[k][2:-2], rtol=0, atol=tolerance * scale)


@pytest.mark.parametrize("n", [5, 6, 41])
def test_stencils_are_exact_for_polynomials_of_the_index(n: int) -> None:
    """At the ends too; time runs evenly, so a polynomial of the index is one of time."""
    t = 0.7 + 0.02 * np.arange(n)
    clock = clock_of(t)
    x = (t - t[n // 2]) / (t[-1] - t[0])
    span = t[-1] - t[0]
    for power in range(5):
        rates = clock.rates(x[:, None] ** power)[:, :, 0]
        for k in (1, 2, 3):
            factor = np.prod([power - i for i in range(k)]) if power >= k else 0.0
            expected = factor * x ** max(power - k, 0) / span**k
            np.testing.assert_allclose(rates[:, k - 1], expected, rtol=0, atol=1e-8 * (n / span) ** k)
    np.testing.assert_allclose(clock.step, 0.02, rtol=1e-9)


def test_clock_of_a_sine_on_uneven_samples() -> None:
    u = np.linspace(0.0, 1.0, 300)
    t = u + 0.3 * u**2
    rates = clock_of(t).rates(np.sin(9.0 * t)[:, None])[:, :, 0]
    for k, exact in enumerate((9.0 * np.cos(9 * t), -81.0 * np.sin(9 * t), -729.0 * np.cos(9 * t))):
        error = np.abs(rates[:, k] - exact) / 9.0 ** (k + 1)
        assert error[2:-2].max() < (2e-6, 2e-5, 2e-3)[k]
        assert error.max() < (1e-5, 1e-3, 1e-1)[k]


@pytest.mark.parametrize(("controls", "n"), [(2, 5), (4, 13), (6, 25), (40, 170)])
def test_fit_reproduces_splines_and_is_the_least_squares_fit(controls: int, n: int) -> None:
    rng = np.random.default_rng(controls)
    basis = basis_over(uneven_clock(n), np.linspace(0.0, 1.0, controls))
    c = rng.normal(size=(controls, 3))
    np.testing.assert_allclose(fit(basis, basis.values(c)), c, rtol=0, atol=1e-8)
    values = rng.normal(size=(n, 2))
    dense = basis.values(np.eye(controls))
    best = np.linalg.lstsq(dense, values, rcond=None)[0]
    np.testing.assert_allclose(dense @ fit(basis, values), dense @ best, rtol=0, atol=1e-8)


# --- Newton's method on the chain -------------------------------------------------------------------------------

BUILDS = {
    "table": (),
    "turned base": (),
    "bed": ("cell.positioner=null", "cell.bed_mm=[560, -93, 290]", "cell.nozzle.axis=[0.2, -0.1, 2]"),
    "table and tilt": (
        "cell.positioner.held_deg={}",
        "cell.positioner.free=[tilt, rotation]",
        "cell.base_mm=[20, -30, 40]",
    ),
    "seven axes": ("cell.arm=iiwa", "cell.home_deg=[10, 30, -20, -80, 15, 60, 0]"),
}


@pytest.fixture(scope="module", params=BUILDS)
def any_cell(request: pytest.FixtureRequest) -> Cell:
    cell = build_cell(load_problem("cylinder_logo", BUILDS[request.param]))
    return turned_base(cell) if request.param == "turned base" else cell


def turned_base(cell: Cell) -> Cell:
    """The cell with its arm mounted askew."""
    T_world_base = cell.T_world_base.copy()
    T_world_base[:3, :3] = Rotation.from_rotvec([0.4, -0.7, 1.1]).as_matrix()
    placements = cell.arm.placements.copy()
    placements[0] = T_world_base @ np.linalg.inv(cell.T_world_base) @ placements[0]
    return replace(cell, T_world_base=T_world_base, arm=replace(cell.arm, placements=placements))


@dataclass
class Followed:
    """What `follow` fills."""

    lost: int
    q: Array
    G: Array
    sigma: Array
    sigma_slope: Array
    lean: Array
    lean_slope: Array


def run_follow(
    cell: Cell, tip: Array, frames: Array, z: Array, q_near: Array, normals: Array | None = None
) -> Followed:
    model = model_of(cell)
    n, m = len(tip), z.shape[1]
    nan = np.nan
    out = Followed(
        -2, q_near.copy(), np.full((n, q_near.shape[1], m), nan), np.full(n, nan), np.full((n, m), nan),
        np.full((n, 3, 2), nan), np.full((n, 3, 2, m), nan),
    )  # fmt: skip
    task = [np.array(each) for each in (tip, frames, -frames[:, :, 2] if normals is None else normals)]
    for each in task[:2]:
        each.setflags(write=False)  # as a task's are: `follow` need not be compiled twice
    out.lost = follow(
        model.numbers, model.holder, model.given, *task, z, np.arange(m),
        PosturesFollowed(out.q, out.G, out.sigma, out.sigma_slope, out.lean, out.lean_slope),
    )  # fmt: skip
    return out


def tilted(frames: Array, z: Array) -> Array:
    """frames Exp(tilt) Rz(roll), by scipy."""
    zero = np.zeros(len(z))
    tilt = Rotation.from_rotvec(np.column_stack([z[:, 1], z[:, 2], zero])).as_matrix()
    return frames @ tilt @ Rotation.from_rotvec(np.column_stack([zero, zero, z[:, 0]])).as_matrix()


def made_up_tasks(cell: Cell, rng: np.random.Generator, n: int) -> tuple[Array, Array, Array, Array]:
    """tip, frames, z, and the postures q that hold them: the postures come first, so they are known."""
    na, nh = len(cell.arm), len(cell.holder)
    low, high = np.maximum(cell.limits.q_min, -2.5), np.minimum(cell.limits.q_max, 2.5)
    q = rng.uniform(low, high, (40 * n, na + nh))
    sigma = np.linalg.svd(cell.arm.jacobians(q[:, :na])[:, :, list(cell.solved)], compute_uv=False)[:, -1]
    q = q[sigma > 0.06][:n]
    assert len(q) == n
    angle, towards = np.radians(20.0) * np.sqrt(rng.random(n)), rng.uniform(0.0, 2 * np.pi, n)
    z = np.zeros((n, HOLDER + len(cell.chosen)))
    z[:, 0] = rng.uniform(-7.0, 7.0, n)
    z[:, 1], z[:, 2] = angle * np.cos(towards), angle * np.sin(towards)
    z[: n // 10, 1:3] = 0.0
    z[:, HOLDER:] = q[:, list(cell.chosen)]
    T = cell.T_part_nozzle(q)
    turn = tilted(np.broadcast_to(np.eye(3), (n, 3, 3)), z)
    return T[:, :3, 3].copy(), T[:, :3, :3] @ np.swapaxes(turn, 1, 2), z, q


@pytest.mark.slow(keep=2)
def test_postures_hold_the_task_exactly(any_cell: Cell) -> None:
    rng = np.random.default_rng(3)
    tip, frames, z, q = made_up_tasks(any_cell, rng, 400)
    near = q + rng.uniform(-0.02, 0.02, q.shape)
    out = run_follow(any_cell, tip, frames, z, near)
    assert out.lost == -1
    T = any_cell.T_part_nozzle(out.q)
    np.testing.assert_allclose(T[:, :3, 3], tip, rtol=0, atol=1e-11)
    np.testing.assert_allclose(T[:, :3, :3], tilted(frames, z), rtol=0, atol=1e-11)
    np.testing.assert_array_equal(out.q[:, list(any_cell.chosen)], z[:, HOLDER:])
    same = np.abs(out.q - q).max(axis=1) < 1e-8  # from further away Newton's method may find another posture
    assert same.mean() > 0.99
    lean = np.arccos(np.clip(np.einsum("ni,ni->n", T[:, :3, 2], frames[:, :, 2]), -1, 1))
    np.testing.assert_allclose(lean, np.hypot(z[:, 1], z[:, 2]), rtol=0, atol=1e-7)


@pytest.mark.slow(keep=2)
def test_slopes_are_finite_differences(any_cell: Cell) -> None:
    na = len(any_cell.arm)
    tip, frames, z, q = made_up_tasks(any_cell, np.random.default_rng(4), 60)
    h = 1e-5
    noise = 0.2 * np.random.default_rng(5).normal(size=tip.shape)
    normals = noise - frames[:, :, 2]
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    for i in range(len(q)):
        one = slice(i, i + 1)
        out = run_follow(any_cell, tip[one], frames[one], z[one], q[one], normals[one])
        assert out.lost == -1
        axis = any_cell.T_part_nozzle(out.q)[0, :3, 2]
        assert np.hypot(*out.lean[0, 2]) == pytest.approx(np.arccos(np.clip(-axis @ normals[i], -1.0, 1.0)), abs=1e-7)
        singular = np.linalg.svd(any_cell.arm.jacobians(out.q[:, :na])[0], compute_uv=False)
        clear = singular[-2] > 1.15 * singular[-1]  # else the two smallest are about to change places
        assert out.sigma[0] == pytest.approx(singular[-1], rel=1e-9 if clear else 1e-2)
        T_world_nozzle = any_cell.arm.poses(out.q[:, :na])[0]
        T_world_part = any_cell.holder.poses(out.q[:, na:])[0]
        directions = -T_world_nozzle[:3, 2], T_world_part[:3, :3] @ normals[i]
        for lean, d in zip(out.lean[0, :2], directions, strict=True):
            level = np.hypot(d[0], d[1])
            np.testing.assert_allclose(lean, np.arctan2(level, d[2]) * d[:2] / level, rtol=0, atol=1e-10)
        for m in range(z.shape[1]):
            sides = []
            for sign in (1.0, -1.0):
                moved = z[one].copy()
                moved[0, m] += sign * h
                side = run_follow(any_cell, tip[one], frames[one], moved, out.q, normals[one])
                assert side.lost == -1
                sides.append(side)
            plus, minus = sides
            scale = 1.0 + np.abs(out.G[0, :, m]).max()
            np.testing.assert_allclose((plus.q - minus.q)[0] / (2 * h), out.G[0, :, m], rtol=0, atol=1e-5 * scale**3)
            for k in range(3):
                if np.hypot(*out.lean[0, k]) < 3.0:  # upside down all directions meet
                    slope = (plus.lean - minus.lean)[0, k] / (2 * h)
                    np.testing.assert_allclose(slope, out.lean_slope[0, k, :, m], rtol=0, atol=1e-5)
            if clear:
                by = [np.linalg.svd(any_cell.arm.jacobians(s.q[:, :na])[0], compute_uv=False)[-1] for s in sides]
                slope = (by[0] - by[1]) / (2 * h)
                assert slope == pytest.approx(out.sigma_slope[0, m], abs=1e-4 * scale**3)


def test_smallest_singular_value_is_followed_along_a_path(cell: Cell) -> None:
    """From sample to sample the iteration goes on where it was, through places where two values come close."""
    rng = np.random.default_rng(5)
    closest = np.inf
    for _ in range(40):
        a, b = rng.uniform(-1.2, 1.2, (2, 7))
        a[4], b[4] = abs(a[4]) + 0.3, abs(b[4]) + 0.3
        q = a + np.linspace(0.0, 0.5, 300)[:, None] * (b - a)
        T = cell.T_part_nozzle(q)
        z = np.zeros((300, 4))
        z[:, HOLDER] = q[:, 6]
        out = run_follow(cell, T[:, :3, 3], T[:, :3, :3], z, q)
        assert out.lost == -1
        singular = np.linalg.svd(cell.arm.jacobians(q[:, :6]), compute_uv=False)
        closest = min(closest, float((singular[:, -2] / singular[:, -1]).min()))
        assert (out.sigma > singular[:, -1] * (1 - 1e-6)).all()
        assert (out.sigma < singular[:, -1] * (1 + 5e-3)).all()
    assert closest < 1.05


def test_singular_values_where_closed_form_and_steps_take_turns() -> None:
    """With a base that stands askew: both tell of the Jacobian in the world."""
    cell = turned_base(build_cell(load_problem("cylinder_logo")))
    rng = np.random.default_rng(12)
    tip, frames, z, q = made_up_tasks(cell, rng, 200)
    near = q.copy()
    near[::3, 0] += 0.6  # too far for the closed form
    out = run_follow(cell, tip, frames, z, near)
    assert out.lost == -1
    same = np.abs(out.q - q).max(axis=1) < 1e-8
    assert same[::3].sum() > 30 and same[1::3].all() and same[2::3].all()
    one = run_follow(cell, tip, frames, z, q)
    np.testing.assert_allclose(out.G[same], one.G[same], rtol=0, atol=1e-8 * np.abs(one.G).max())
    values = np.linalg.svd(cell.arm.jacobians(out.q[:, : len(cell.arm)]), compute_uv=False)
    clear = values[:, -2] > 3.0 * values[:, -1]
    assert clear.sum() > 30
    np.testing.assert_allclose(out.sigma[clear], values[clear, -1], rtol=1e-6)


def test_foreseen_joints_are_those_of_the_slopes() -> None:
    rng = np.random.default_rng(31)
    q, G, moved = rng.normal(size=(9, 7)), rng.normal(size=(9, 7, 3)), rng.normal(size=(9, 3))
    np.testing.assert_allclose(foreseen(q, G, moved), q + np.einsum("njm,nm->nj", G, moved), rtol=0, atol=1e-14)


def test_failure_is_reported_by_its_place(any_cell: Cell) -> None:
    tip, frames, z, q = made_up_tasks(any_cell, np.random.default_rng(6), 9)
    away = tip.copy()
    away[5] += 10.0
    lost_axis = z.copy()
    lost_axis[3, 0] = np.nan
    lost_tip = tip.copy()
    lost_tip[7, 1] = np.nan
    singular = q.copy()
    singular[4, list(any_cell.solved)] = 0.0  # stretched out
    for expected, out in (
        (5, run_follow(any_cell, away, frames, z, q)),
        (3, run_follow(any_cell, tip, frames, lost_axis, q)),
        (7, run_follow(any_cell, lost_tip, frames, z, q)),
        (4, run_follow(any_cell, tip, frames, z, singular)),
    ):
        assert out.lost == expected
        done = slice(0, expected)
        for values in (out.q, out.G, out.sigma, out.sigma_slope, out.lean, out.lean_slope):
            assert np.isfinite(values[done]).all()
    assert run_follow(any_cell, tip, frames, z, q).lost == -1


def test_half_a_turn_away_is_not_taken_for_there(any_cell: Cell) -> None:
    """Where the nozzle has to turn by pi, the rotation's antisymmetric part is zero, as it is at the goal."""
    tip, frames, z, q = made_up_tasks(any_cell, np.random.default_rng(8), 30)
    z[:, 0] += np.pi
    held = 0
    for i in range(len(q)):
        one = slice(i, i + 1)
        out = run_follow(any_cell, tip[one], frames[one], z[one], q[one])
        if out.lost == -1:
            T = any_cell.T_part_nozzle(out.q)[0]
            np.testing.assert_allclose(T[:3, :3], tilted(frames[one], z[one])[0], rtol=0, atol=1e-9)
            held += 1
    assert held > 3


# --- the interior-point method ----------------------------------------------------------------------------------


def random_program(
    rng: np.random.Generator, *, rows: int = 4, price: float = 1.0, curvature: float = 1.0, hard: float = 0.0
) -> QuadraticProgram:
    """A convex program; `hard` is the share of groups whose price is a thousand times the others'."""
    w = int(rng.integers(1, 7))
    n, groups = int(rng.integers(w, 30)), int(rng.integers(0, 40))
    F = np.zeros((n, n))
    for i in range(n):
        F[i, i : i + w] = rng.normal(size=min(w, n - i))
    M = curvature * (F.T @ F)
    H = np.zeros((n, w))
    for d in range(w):
        H[d:, d] = np.diag(M, -d)
    count = np.where(rng.random(groups) < 0.2, 0, rng.integers(1, rows + 1, groups))
    group = np.concatenate([[0], np.cumsum(count)]).astype(np.int64)
    at = np.repeat(rng.integers(0, n - w + 1, groups), count).astype(np.int64)
    r = int(group[-1])
    prices = price * rng.exponential(size=groups)
    b = rng.normal(size=r)
    is_hard = rng.random(groups) < hard
    prices[is_hard] *= 1e3
    b[np.repeat(is_hard, count)] = np.abs(b[np.repeat(is_hard, count)])
    return QuadraticProgram(
        H, rng.normal(size=n), rng.uniform(0.05, 2.0, n), rng.normal(size=(r, w)), b, at, group, prices
    )


def dense(qp: QuadraticProgram) -> tuple[Array, Array, NDArray[np.int64]]:
    """H (n, n), A (r, n), and the group of each row."""
    n, w = qp.H.shape
    H, A = np.zeros((n, n)), np.zeros((len(qp.b), n))
    for d in range(min(w, n)):
        H += np.diag(qp.H[d:, d], -d) + (np.diag(qp.H[d:, d], d) if d else 0.0)
    for r in range(len(qp.b)):
        A[r, qp.at[r] : qp.at[r] + w] = qp.A[r]
    return H, A, np.repeat(np.arange(len(qp.price)), np.diff(qp.group))


def direct_value(qp: QuadraticProgram, x: Array) -> float:
    H, A, group = dense(qp)
    over = A @ x - qp.b
    slack = [max([0.0, *over[group == k]]) for k in range(len(qp.price))]
    return float(0.5 * x @ H @ x + qp.g @ x + qp.price @ np.array(slack, dtype=float))


def clarabels_value(qp: QuadraticProgram) -> float:
    """The least objective, by Clarabel, with the slacks as variables."""
    H, A, group = dense(qp)
    n, k = len(qp.g), len(qp.price)
    of_group = np.zeros((len(qp.b), k))
    of_group[np.arange(len(qp.b)), group] = -1.0
    rows = np.block([
        [A, of_group],
        [np.zeros((k, n)), -np.eye(k)],
        [np.eye(n), np.zeros((n, k))],
        [-np.eye(n), np.zeros((n, k))],
    ])  # fmt: skip
    P = np.zeros((n + k, n + k))
    P[:n, :n] = H
    options = clarabel.DefaultSettings()
    options.verbose = False
    solution = clarabel.DefaultSolver(
        sp.csc_matrix(np.triu(P)), np.concatenate([qp.g, qp.price]), sp.csc_matrix(rows),
        np.concatenate([qp.b, np.zeros(k), qp.box, qp.box]), [clarabel.NonnegativeConeT(len(rows))], options,
    ).solve()  # fmt: skip
    assert str(solution.status) in {"Solved", "AlmostSolved"}
    return float(solution.obj_val)


def check_solution(qp: QuadraticProgram) -> None:
    at_zero, least = qp.value(np.zeros(len(qp.g))), clarabels_value(qp)
    room = at_zero + float(np.abs(qp.g * qp.box).sum())  # what there is to gain at all
    for accuracy in (1e-4, ACCURACY):
        solution = solve_qp(qp, accuracy)
        x, steps = solution.x, solution.steps
        assert solution.status is Status.SOLVED
        assert np.isfinite(x).all()
        assert (np.abs(x) <= qp.box).all()
        assert steps < 60
        mine = qp.value(x)
        assert mine == pytest.approx(direct_value(qp, x), rel=1e-9, abs=1e-9)
        assert mine <= at_zero
        assert mine - least < 10.0 * accuracy * (at_zero - least) + 1e-7 * room
        assert mine - least < 2.0 * accuracy * room  # complementarity and residual
        assert mine - least > -1e-5 * room
        assert max(solution.gap, solution.residual) <= accuracy * room * (1.0 + 1e-9)
        assert mine - least <= solution.gap + 2.0 * solution.residual + 1e-6 * room  # so far off it says that it may be


@pytest.mark.slow
@given(
    seed=st.integers(0, 2**32 - 1),
    rows=st.integers(1, 8),
    price=st.sampled_from([1e-6, 1e-2, 1.0, 1e2, 1e5]),
    curvature=st.sampled_from([0.0, 1e-4, 1.0, 30.0]),
    hard=st.sampled_from([0.0, 0.3, 0.9]),
)
@settings(max_examples=150)
def test_random_programs_against_clarabel(seed: int, rows: int, price: float, curvature: float, hard: float) -> None:
    rng = np.random.default_rng(seed)
    check_solution(random_program(rng, rows=rows, price=price, curvature=curvature, hard=hard))


def test_dear_and_distant_bounds_do_not_blunt_the_solution() -> None:
    """A thousand bounds that are far away: whatever they cost, the little there is to gain is gained."""
    n = 50
    H, g = np.ones((n, 1)), np.full(n, 1e-3)
    rows = np.arange(n).repeat(20)
    r = len(rows)
    qp = QuadraticProgram(
        H, g, np.full(n, 0.15), np.ones((r, 1)), np.full(r, 0.2), rows, np.arange(r + 1), np.full(r, 1e3)
    )
    x = solve_qp(qp).x
    np.testing.assert_allclose(qp.value(x), -0.5 * n * 1e-6, rtol=1e-2)


def test_degenerate_programs() -> None:
    rng = np.random.default_rng(2)
    qp = random_program(rng, price=1.0)
    while len(qp.price) < 8 or np.diff(qp.group).min() > 0:
        qp = random_program(rng, price=1.0)
    nothing = np.zeros(0)
    no_rows = replace(
        qp, A=np.zeros((0, qp.H.shape[1])), b=nothing, at=np.zeros(0, dtype=np.int64),
        group=np.zeros(1, dtype=np.int64), price=nothing,
    )  # fmt: skip
    check_solution(no_rows)
    check_solution(replace(no_rows, H=np.zeros_like(qp.H)))  # linear: to the walls of the box
    free = qp.price.copy()
    free[::2] = 0.0
    check_solution(replace(qp, price=free))
    check_solution(replace(qp, price=np.zeros_like(free)))
    check_solution(replace(qp, A=np.zeros_like(qp.A)))
    check_solution(replace(qp, b=np.zeros_like(qp.b)))
    check_solution(replace(qp, b=np.full_like(qp.b, -30.0)))  # not to be met by any x in the box
    flat = replace(qp, H=np.zeros_like(qp.H), g=np.zeros_like(qp.g), b=np.abs(qp.b))
    still = solve_qp(flat)  # 0 is as good as any
    assert (still.steps, still.status, np.abs(still.x).max()) == (0, Status.SOLVED, 0.0)
    bent = qp.H.copy()
    bent[:, 0] = -5.0  # not convex: anything finite that is no worse than standing still
    left = solve_qp(replace(qp, H=bent))
    x = left.x
    assert left.status is Status.STOPPED
    assert np.isfinite(x).all()
    assert replace(qp, H=bent).value(x) <= replace(qp, H=bent).value(np.zeros(len(x)))
    spoilt = qp.g.copy()
    spoilt[0] = np.nan
    failed = solve_qp(replace(qp, g=spoilt))
    assert failed.status is Status.FAILED
    np.testing.assert_array_equal(failed.x, 0.0)


def test_banded_factor_solves() -> None:
    rng = np.random.default_rng(9)
    for n, w in ((1, 1), (1, 3), (7, 2), (20, 6), (5, 9)):
        F = np.tril(rng.normal(size=(n, n))) + 6.0 * np.eye(n)
        F[np.subtract.outer(np.arange(n), np.arange(n)) >= w] = 0.0
        M, band = F @ F.T, np.zeros((n, w))
        for d in range(min(w, n)):
            band[: n - d, d] = np.diag(M, d)
        rhs = rng.normal(size=n)
        x = rhs.copy()
        assert factorise(band)
        substitute(band, x)
        np.testing.assert_allclose(M @ x, rhs, rtol=0, atol=1e-9)
    assert not factorise(np.array([[1.0, 2.0], [1.0, 0.0]]))  # indefinite


@pytest.mark.parametrize("seed", [3, 7, 11, 16])
def test_where_arrays_lie_in_memory_does_not_matter(seed: int) -> None:
    """Small ones above all, which may lie so close to each other that loops take no vectors."""
    qp = random_program(np.random.default_rng(seed), rows=4, price=1.0)
    rng, between, found = np.random.default_rng(0), [], set()
    for _ in range(40):
        between = [*between[-8:], np.empty(rng.integers(1, 60))]
        solution = solve_qp(qp, 1e-9)
        found.add((solution.x.tobytes(), solution.steps, solution.gap, solution.residual))
    assert len(found) == 1


def test_a_program_whose_steps_run_out_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    """One that asks for more than numbers can hold."""
    qp = random_program(np.random.default_rng(3), rows=4, price=1.0)
    left = solve_qp(qp, 1e-30)
    assert left.status is Status.STOPPED
    assert np.isfinite(left.x).all()
    assert qp.value(left.x) < qp.value(np.zeros(len(qp.g)))
    assert left.gap + left.residual > 0.0
