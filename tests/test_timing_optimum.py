"""The interior-point method of timing against IPOPT on the same program, and each of its steps' promises."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.interpolate import make_interp_spline

from planner.base.arrays import Array
from planner.cell.cell import Limits
from planner.motion.timing.kernels import APART, OVERRUN, even_out, fastest, least_nearby, mean_nearby
from planner.motion.timing.profile import ACCURACY, HEADROOM, Leg, LegLimits, curve_of, fastest_profile, leg_limits

Blocks = NDArray[np.bool_]
Solution = tuple[Array, bool]
JOINTS = 3
LENGTH = 0.25  # s at the commanded speed: some hundred intervals


def program(seed: int, ramps: tuple[float, float] = (0.05, 0.05)) -> LegLimits:
    """A short path of three joints with a bend that its limits slow down."""
    rng = np.random.default_rng(seed)
    u = np.linspace(0.0, LENGTH, 60)
    waves = sum(
        rng.normal(size=JOINTS)
        * 0.02
        * k**-1.5
        * np.sin(2 * np.pi * k * u[:, None] / LENGTH + rng.uniform(0, 6, JOINTS))
        for k in range(1, 5)
    )
    bend = np.outer(np.exp(-(((u - 0.12) / 0.02) ** 2)), rng.normal(size=JOINTS) * 0.02)
    path = make_interp_spline(u, np.column_stack([waves + bend, 0.04 * u]), k=5)
    v, a, j = np.array([3.0, 3.0, 3.0, 0.04]), rng.uniform(10.0, 30.0, JOINTS), rng.uniform(500.0, 1500.0, JOINTS)
    return leg_limits(Leg(curve_of(path), 0.0, LENGTH, ramps), v, a, j)


def solve(
    p: LegLimits, accuracy: float = ACCURACY, start: Array | None = None, wanted: Blocks | None = None
) -> Solution:
    begin = p.start if start is None else start
    blocks = np.ones(-(-len(p.h) // APART), dtype=np.bool_) if wanted is None else wanted
    c, found = fastest(p.rows, begin, p.level, accuracy, blocks)
    return np.asarray(c), bool(found)


def time_of(p: LegLimits, c: Array) -> float:
    return float((p.h / np.sqrt((p.middle * np.column_stack([c[:-2], c[1:-1], c[2:]])).sum(axis=1))).sum())


def overrun(p: LegLimits, c: Array) -> float:
    """Largest share by which any limit is missed, each written out anew."""
    two, three = np.column_stack([c[:-1], c[1:]]), np.column_stack([c[:-2], c[1:-1], c[2:]])
    twice = np.repeat(three, 2, axis=0)
    x = (p.point * two).sum(axis=1)
    acceleration = np.abs(np.einsum("mjk,mk->mj", p.acceleration, two))
    jerk = np.abs(np.einsum("mjk,mk->mj", p.jerk, twice)) - 1.0 / np.sqrt((p.ends * twice).sum(axis=1))[:, None]
    return float(max((x / p.ceiling).max() - 1.0, acceleration.max() - 1.0, jerk.max()))


def by_ipopt(p: LegLimits) -> float:
    """The least time of the same program, from the same start, with the jerk limit as it is, not convex."""
    m = len(p.h)
    opti = ca.Opti()
    c = opti.variable(m + 2)
    x = [ca.dot(p.point[i], ca.vertcat(c[i], c[i + 1])) for i in range(m + 1)]
    total = 0
    for i in range(m):
        three = ca.vertcat(c[i], c[i + 1], c[i + 2])
        middle = ca.dot(p.middle[i], three)
        opti.subject_to(middle >= 1e-9)
        total += p.h[i] / ca.sqrt(middle)
        for e in (2 * i, 2 * i + 1):
            at = ca.dot(p.ends[e], three)
            opti.subject_to(at >= 1e-9)
            for k in range(JOINTS):
                row = ca.dot(p.jerk[e, k], three)
                opti.subject_to(row * ca.sqrt(at) <= 1)
                opti.subject_to(row * ca.sqrt(at) >= -1)
    for i in range(m + 1):
        opti.subject_to(x[i] <= p.ceiling[i])
        for k in range(JOINTS):
            opti.subject_to(opti.bounded(-1, ca.dot(p.acceleration[i, k], ca.vertcat(c[i], c[i + 1])), 1))
    if p.level[0]:
        opti.subject_to(c[0] == c[1])
    if p.level[1]:
        opti.subject_to(c[m] == c[m + 1])
    opti.minimize(total)
    opti.set_initial(c, p.start)
    opti.solver("ipopt", {"print_time": False, "expand": True}, {"print_level": 0, "max_iter": 500})
    return float(opti.solve().value(total))


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(2))
def test_as_fast_as_ipopt_finds(seed: int) -> None:
    p = program(seed)
    c, found = solve(p)
    assert found
    assert overrun(p, c) <= OVERRUN
    assert time_of(p, c) <= (1.0 + 2e-3) * by_ipopt(p)


@pytest.mark.parametrize("ramps", [(0.05, 0.05), (0.0, 0.05), (0.05, 0.0), (0.0, 0.0)])
def test_limits_hold_however_it_starts_and_ends(ramps: tuple[float, float]) -> None:
    times = []
    for seed in range(20):
        p = program(seed, ramps)
        c, found = solve(p)
        assert found
        assert overrun(p, c) <= OVERRUN
        if p.level[0]:
            assert c[0] == c[1]
        times.append(time_of(p, c))
    assert min(times) > 0.9 * LENGTH


def test_a_limit_that_is_raised_makes_nothing_slower() -> None:
    for seed in range(10):
        p = program(seed)
        slow = time_of(p, solve(p)[0])
        wide = LegLimits(**{**vars(p), "jerk": 0.5 * p.jerk})
        assert time_of(wide, solve(wide)[0]) <= slow * (1.0 + 2.0 * ACCURACY)


@pytest.mark.parametrize("seed", [8, 53, 142])
def test_peaks_of_jerk_between_grid_points_slow_what_is_around_them_only(seed: int) -> None:
    """Rough joint values in the middle of 3 s, for which a limit of jerk is 1.3 to 2.3 times too low."""
    rng = np.random.default_rng(seed)
    knot = 10.0 ** rng.uniform(-2.3, -1.0)
    u = np.arange(int(3.0 / knot) + 1) * knot
    rng.normal(size=len(u))
    rough = rng.normal(size=len(u)) * np.exp(-(((u - 0.5 * u[-1]) / (4.0 * knot)) ** 2))
    path = make_interp_spline(u, np.column_stack([rough, 0.04 * u]), k=5)
    most = [np.abs(path(np.linspace(0.0, u[-1], 200_001), order)[:, 0]).max() for order in (1, 2, 3)]
    low = 10.0 ** rng.uniform(-0.1, 0.4)
    roomy = 3.0 * most[0], rng.uniform(1.0, 3.0) * most[1]
    limits = Limits(*(np.array([value]) for value in (-9.0, 9.0, *roomy, most[2] / low)))
    profile = fastest_profile(Leg(curve_of(path), 0.0, u[-1], (0.05, 0.05)), limits, 0.04)
    away = (np.abs(profile.sigma - 0.5 * profile.sigma[-1]) > 0.9) & (np.abs(profile.sigma - 1.5) < 1.2)
    assert np.sqrt(profile.x[away[:-1], 0]).min() > 0.999
    assert profile.duration < 1.021 * u[-1]


@pytest.mark.parametrize("ramps", [(0.05, 0.08), (0.0, 0.0)])
def test_rates_of_a_leg_by_finite_differences(ramps: tuple[float, float]) -> None:
    rng = np.random.default_rng(5)
    path = make_interp_spline(np.linspace(0.0, LENGTH, 9), rng.normal(size=(9, JOINTS + 1)), k=5)
    leg = Leg(curve_of(path), 0.02, LENGTH - 0.01, ramps)
    joints = [0.0, *leg.lasts, leg.end - leg.lasts[1], leg.end]
    sigma = np.linspace(0.0, leg.end, 203)[1:-1]
    sigma = sigma[np.abs(sigma[:, None] - joints).min(axis=1) > 1e-4]  # the nominal third derivative jumps there
    np.testing.assert_allclose(leg.u(np.array([0.0, leg.end])), [0.02, LENGTH - 0.01], atol=1e-12)
    h = 1e-5
    before = [path(leg.u(sigma - h)), *leg.rates(sigma - h, 2)]
    after = [path(leg.u(sigma + h)), *leg.rates(sigma + h, 2)]
    for a, b, rate in zip(before, after, leg.rates(sigma, 3), strict=True):
        np.testing.assert_allclose((b - a) / (2 * h), rate, rtol=1e-4, atol=1e-5 * np.abs(rate).max())


def test_a_hard_place_shortens_steps_around_it_only() -> None:
    given = np.ones(9 * APART + 7)
    given[[4 * APART, -1]] = 0.01, 0.2
    lengths = given.copy()
    even_out(lengths, np.empty(len(lengths) + 1), np.empty(len(lengths)))
    assert (lengths <= given * (1.0 + 1e-12)).all()
    assert np.abs(np.diff(lengths)).max() <= 2.0 / APART
    assert (lengths[: 2 * APART] > 1.0 - 1e-9).all()
    assert lengths[4 * APART] == pytest.approx(0.01) and lengths[-1] == pytest.approx(0.2)


def long_program() -> LegLimits:
    """A path of many blocks with one hard place."""
    u = np.linspace(0.0, 6.0, 1200)
    bend = np.outer(0.5 * np.exp(-(((u - 2.0) / 0.01) ** 2)), [1.0, -0.7, 0.4])
    path = make_interp_spline(
        u, np.column_stack([0.02 * np.sin(np.outer(u, [20.0, 25.0, 30.0])) + bend, 0.04 * u]), k=5
    )
    v, a, j = np.array([3.0, 3.0, 3.0, 0.04]), np.full(JOINTS, 20.0), np.full(JOINTS, 1000.0)
    return leg_limits(Leg(curve_of(path), 0.0, 6.0, (0.05, 0.05)), v, a, j)


def test_what_is_settled_early_is_as_good_in_the_end() -> None:
    """The hard place goes on for long after all else is settled."""
    p = long_program()
    assert len(p.h) > 6 * APART
    (c, found), (better, found_too) = solve(p), solve(p, 1e-2 * ACCURACY)
    assert found and found_too
    assert max(overrun(p, c), overrun(p, better)) <= OVERRUN
    assert time_of(p, c) == pytest.approx(time_of(p, better), rel=ACCURACY)
    far = int(np.searchsorted(p.sigma, 4.0))
    np.testing.assert_allclose(c[far:], better[far:], rtol=1e-2)


def test_blocks_that_are_not_wanted_stay_and_the_others_are_as_good() -> None:
    """Limits that become tighter in one place are met by a change nearby, as quick as if all had been sought anew."""
    p = long_program()
    before, _ = solve(p)
    jerk, at = p.jerk.copy(), int(np.searchsorted(p.sigma, 2.0))
    jerk[2 * at : 2 * at + 2] *= 1.05
    tighter = LegLimits(**{**vars(p), "jerk": jerk})
    wanted = np.abs(np.arange(-(-len(p.h) // APART)) - at // APART) <= 1
    c, found = solve(tighter, start=before, wanted=wanted)
    assert found
    assert overrun(tighter, c) <= OVERRUN < overrun(tighter, before)
    first, last = np.flatnonzero(wanted)[[0, -1]] * APART + (0, APART + 2)
    np.testing.assert_array_equal(c[:first], before[:first])
    np.testing.assert_array_equal(c[last:], before[last:])
    assert time_of(tighter, c) == pytest.approx(time_of(tighter, solve(tighter)[0]), rel=ACCURACY)


def test_least_and_mean_nearby_by_definition() -> None:
    rng = np.random.default_rng(3)
    at, values, reach = np.sort(np.append(rng.uniform(0.0, 1.0, 300), [0.4, 0.4])), rng.uniform(size=302), 0.03
    near = np.abs(at - at[:, None]) <= reach
    np.testing.assert_array_equal(least_nearby(values, at, reach), np.where(near, values, np.inf).min(axis=1))
    np.testing.assert_allclose(mean_nearby(values, at, reach), near @ values / near.sum(axis=1), rtol=1e-9)


@pytest.mark.parametrize("samples", [2, 3, 6, 7, 40])
def test_a_curve_is_its_spline(samples: int) -> None:
    rng = np.random.default_rng(samples)
    u = np.cumsum(rng.uniform(0.2, 1.0, samples))
    spline = make_interp_spline(u, rng.normal(size=(samples, JOINTS)), k=min(5, samples - 1))
    at = np.concatenate([np.linspace(u[0], u[-1], 500), rng.uniform(u[0], u[-1], 100)])
    curve = curve_of(spline)
    np.testing.assert_allclose(curve(at), spline(at), rtol=1e-9, atol=1e-9)
    for order, rates in enumerate(curve.derivatives(at, 3), start=1):
        wanted = spline(at, order) if order <= spline.k else np.zeros((len(at), JOINTS))
        np.testing.assert_allclose(rates, wanted, rtol=1e-7, atol=1e-7 * max(float(np.abs(wanted).max()), 1.0))


def test_a_profile_in_two_halves_is_as_fast(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two bends far apart, and sampling that is closer at one of them: cut in between, at the commanded speed."""
    length, speed, n = 60.0, 0.04, 3000
    u = np.linspace(0.0, length, n)
    time = u - 0.5 * np.exp(-(((u - 15.0) / 1.0) ** 2))
    bends = sum(np.outer(np.exp(-(((time - at) / 0.02) ** 2)), [0.1, -0.07, 0.04]) for at in (14.6, 45.0))
    path = make_interp_spline(u, np.column_stack([bends, speed * time]), k=5)
    leg = Leg(curve_of(path), 0.0, length, (0.05, 0.05))
    limits = Limits(*(np.full(JOINTS, value) for value in (-3.0, 3.0, 3.0, 20.0, 1000.0)))
    used = (HEADROOM * limits.acceleration, HEADROOM * limits.jerk)
    p = leg_limits(leg, np.append(HEADROOM * limits.velocity, speed), *used)
    assert p.cut > 0
    assert 20.0 < p.sigma[p.cut] < 40.0
    assert float(p.point[p.cut] @ p.start[p.cut : p.cut + 2]) < 0.9995 * p.ceiling[p.cut], "what cannot move needs room"
    halves = fastest_profile(leg, limits, speed)
    monkeypatch.setattr("planner.motion.timing.profile._WORTH_A_CUT", 10**9)
    whole = fastest_profile(leg, limits, speed)
    assert halves.duration == pytest.approx(whole.duration, rel=3.0 * ACCURACY)
    assert halves.duration > length + 0.05  # both bends cost time
