"""Travel: from state to state within all limits, clear of the part, and as quick as can be."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace

import numpy as np
import pytest
import ruckig
from hypothesis import given, settings
from hypothesis import strategies as st
from test_interlayer import line

import planner.motion.travel.plan
from planner.base.arrays import Array
from planner.base.errors import Refusal
from planner.cell.cell import Cell
from planner.motion.cubics import Cubics, JointState, extremes
from planner.motion.timing.profile import HEADROOM
from planner.motion.timing.timed_path import TimedPath, time_path
from planner.motion.travel.clearance import NOZZLE_POINTS, SLOPE, TravelClearance, travel_clearance
from planner.motion.travel.detours import FITS, _walk
from planner.motion.travel.moves import Bounds, between, resting, time_beside
from planner.motion.travel.plan import TravelTask, _grown, plan_travels, quickest
from planner.motion.travel.ways import Ends, bounds_of, reaching
from planner.problem import Problem
from planner.problem.process import ProcessSpec
from planner.resolve.joint_path import JointPath
from planner.toolpath.bead import Surface, Toolpath
from planner.toolpath.gcode.layers import LevelLayers
from planner.toolpath.runs import least_travel_time
from planner.toolpath.waypoints.nearest import FAR
from planner.toolpath.wrapped import Cylinder

DT = 0.004
PART = Cylinder(0.034, 0.1, np.array([0.0314, 0.037]))  # of the shipped problem


def check_limits(cell: Cell, motion: Cubics, share: float = HEADROOM) -> None:
    """Position, velocity, acceleration and jerk at many instants and on both sides of every breakpoint."""
    limits, wide = cell.limits, share * (1.0 + 1e-9)
    t = np.concatenate([np.linspace(0.0, motion.duration, 3000), motion.times])
    q, v, a = motion.state(t)
    assert (q >= limits.q_min).all()
    assert (q <= limits.q_max).all()
    assert (np.abs(v) <= wide * limits.velocity).all()
    assert (np.abs(a) <= wide * limits.acceleration).all()
    assert (np.abs(6.0 * motion.coefficients[0]) <= wide * limits.jerk).all()


def check_smooth(motion: Cubics) -> None:
    """Continuous to the acceleration over its breakpoints."""
    c3, c2, c1, c0 = motion.coefficients
    tau = np.diff(motion.times)[:, None]
    ends = (c0 + tau * (c1 + tau * (c2 + tau * c3)), c1 + tau * (2 * c2 + 3 * tau * c3), 2 * c2 + 6 * tau * c3)
    for end, begin in zip(ends, (c0, c1, 2 * c2), strict=True):
        np.testing.assert_allclose(end[:-1], begin[1:], rtol=0, atol=1e-9)


def check_joined(motion: Cubics, start: JointState, end: JointState) -> None:
    for found, wanted in ((motion.start, start), (motion.end, end)):
        for ours, theirs in zip(found, wanted, strict=True):
            np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-9)


def tip_speed(cell: Cell, motion: Cubics) -> float:
    """Greatest speed of the tip over the part, by differences of samples as they are written, wherever these fall."""
    fastest = 0.0
    for first in np.linspace(0.0, DT, 5)[:-1]:
        tip = cell.T_part_nozzle(motion.joints(np.arange(first, motion.duration + DT, DT)))[:, :3, 3]
        fastest = max(fastest, float(np.linalg.norm(np.diff(tip, axis=0), axis=1).max(initial=0.0)) / DT)
    return fastest


def still(q: Array) -> JointState:
    return JointState(q, np.zeros_like(q), np.zeros_like(q))


# --- moves ------------------------------------------------------------------------------------------------------


@given(seed=st.integers(0, 2**32 - 1), share=st.sampled_from([1.0, 0.3, 1e-2, 1e-4]), least=st.sampled_from([0.0, 4.0]))
def test_moves_from_rest_to_rest_take_what_ruckig_takes(seed: int, share: float, least: float) -> None:
    random = np.random.default_rng(seed)
    n = 7
    bounds = Bounds(random.uniform(0.5, 5.0, n), random.uniform(5.0, 50.0, n), random.uniform(200.0, 2000.0, n))
    a, b = random.uniform(-2.0, 2.0, (2, n))
    b = a + share * (b - a)
    inputs = ruckig.InputParameter(1)  # the share of the way, from 0 to 1
    inputs.current_position, inputs.target_position = [0.0], [1.0]
    inputs.max_velocity, inputs.max_acceleration, inputs.max_jerk = (
        [float((each / np.abs(b - a)).min())] for each in vars(bounds).values()
    )
    trajectory = ruckig.Trajectory(1)
    ruckig.Ruckig(1).calculate(inputs, trajectory)
    motion = resting(bounds, a, b, least)
    assert motion.duration == pytest.approx(max(trajectory.duration, least), rel=1e-9)
    assert motion.duration >= least - 1e-12
    check_smooth(motion)
    check_joined(motion, still(a), still(b))
    found = extremes(motion)
    for each, limit in zip((found.velocity, found.acceleration, found.jerk), vars(bounds).values(), strict=True):
        assert (each <= limit * (1.0 + 1e-9)).all()
    q = motion.joints(np.linspace(0.0, motion.duration, 200))
    share_of_way = (q - a) @ (b - a) / ((b - a) @ (b - a))
    np.testing.assert_allclose(q, a + share_of_way[:, None] * (b - a), rtol=0, atol=1e-9)  # joints go straight
    assert (np.diff(share_of_way) >= -1e-12).all()


@given(seed=st.integers(0, 2**32 - 1), least=st.sampled_from([0.0, 2.0]))
def test_moves_between_states_in_motion_end_exactly_and_within_bounds(cell: Cell, seed: int, least: float) -> None:
    random = np.random.default_rng(seed)
    bounds = bounds_of(cell)
    states = [
        JointState(
            random.uniform(-1.0, 1.0, 7),
            random.uniform(-0.5, 0.5, 7) * bounds.velocity,
            random.uniform(-0.3, 0.3, 7) * bounds.acceleration,
        )
        for _ in range(2)
    ]
    motion = between(bounds, states[0], states[1], least)
    assert motion is not None
    assert motion.duration >= least - 1e-12
    check_smooth(motion)
    check_joined(motion, states[0], states[1])
    found = extremes(motion)
    for each, limit in zip((found.velocity, found.acceleration, found.jerk), vars(bounds).values(), strict=True):
        assert (each <= limit * (1.0 + 1e-9)).all()


def test_a_move_that_nothing_slows_is_as_fast_as_its_slowest_joint_can(cell: Cell) -> None:
    """One joint alone: the closed form of a jerk-limited move that reaches its top speed."""
    b = cell.home.copy()
    b[5] += 4.0
    v, acc, jerk = (HEADROOM * limit[5] for limit in (cell.limits.velocity, cell.limits.acceleration, cell.limits.jerk))
    motion = resting(bounds_of(cell), cell.home, b)
    assert motion.duration == pytest.approx(4.0 / v + v / acc + acc / jerk, abs=1e-9)


def test_a_move_to_where_it_is_takes_no_time(cell: Cell) -> None:
    motion = resting(bounds_of(cell), cell.home, cell.home)
    assert motion.duration == 0.0
    np.testing.assert_array_equal(motion.joints(np.zeros(1)), cell.home[None])


def test_the_time_that_two_added_moves_need() -> None:
    """Brute force over durations: the first at which what is left suffices."""
    bounds = np.array([[3.0, 3.0], [15.0, 15.0], [750.0, 750.0]])
    along = resting(Bounds(*bounds), np.zeros(2), np.array([0.3, 0.1]))
    found = extremes(along)
    taken = np.stack([found.velocity, found.acceleration, found.jerk])
    vias = np.array([[0.0, 0.0], [0.05, -0.04], [0.0, 0.0]])
    ours = time_beside(bounds, np.full(2, np.inf), taken, along.duration, vias)
    for duration in np.arange(along.duration, 3.0, 1e-3):
        slow = along.duration / duration
        left = bounds - taken * np.array([slow, slow**2, slow**3])[:, None]
        if (left > 0.0).all() and 2.0 * resting(Bounds(*left), vias[0], vias[1]).duration <= duration:
            break
    assert along.duration < ours
    assert ours == pytest.approx(duration, abs=1.2e-3)


@given(seed=st.integers(0, 2**32 - 1))
def test_postures_reach_tips(cell: Cell, seed: int) -> None:
    random = np.random.default_rng(seed)
    q = cell.home + random.uniform(-0.3, 0.3, (5, 7))
    tips = cell.T_part_nozzle(q)[:, :3, 3] + random.uniform(-0.02, 0.02, (5, 3))
    reached = np.hstack([reaching(cell, q, tips), q[:, 6:]])
    np.testing.assert_allclose(cell.T_part_nozzle(reached)[:, :3, 3], tips, rtol=0, atol=2e-6)
    assert np.abs(reached - q).max() < 0.5


# --- one travel -------------------------------------------------------------------------------------------------


def travel(
    cell: Cell,
    start: JointState,
    end: JointState,
    speed: float = 0.2,
    lift: float = 5e-3,
    least: float = 0.0,
    surface: Surface = PART,
) -> Cubics | None:
    space = travel_clearance(cell, surface, 0.0, lift, start, end)
    return quickest(TravelTask(cell, Ends(start, end, least, bounds_of(cell)), space, speed))


@given(seed=st.integers(0, 2**32 - 1), speed=st.floats(0.02, 1.0))
@settings(max_examples=15)
def test_travels_keep_limits_and_tip_speed(cell: Cell, seed: int, speed: float) -> None:
    """Anywhere, with nothing in the way, but for the speed of the tip, from rest and in motion."""
    random = np.random.default_rng(seed)
    q = cell.home + random.uniform(-0.2, 0.2, (2, 7))
    moving = float(random.integers(0, 2)) * 0.1 * speed
    states = [JointState(each, moving * random.uniform(-1, 1, 7), moving * random.uniform(-5, 5, 7)) for each in q]
    motion = travel(cell, *states, speed)
    assert motion is not None
    check_limits(cell, motion)
    check_smooth(motion)
    check_joined(motion, *states)
    assert tip_speed(cell, motion) <= speed


def test_the_tip_speed_is_made_use_of(cell: Cell) -> None:
    end = cell.home.copy()
    end[0] += 0.5
    motion = travel(cell, still(cell.home), still(end))
    assert motion is not None
    assert 0.9 * 0.2 < tip_speed(cell, motion) <= 0.2


def test_tip_speed_counts_relative_to_the_part(cell: Cell) -> None:
    """The table alone turns: the part moves under the nozzle."""
    b = cell.home.copy()
    b[6] += 1.0
    motion = travel(cell, still(cell.home), still(b), 0.05)
    assert motion is not None
    _, v, _ = motion.state(np.linspace(0.0, motion.duration, 500))
    r = np.hypot(*(cell.arm.poses(cell.home[None, :6])[0, :2, 3] - [0.6335, 0.00987]))
    assert 0.04 < np.abs(v[:, 6]).max() * r <= 0.05 * 1.001


@given(seed=st.integers(0, 2**32 - 1), k=st.integers(1, 700))
@settings(max_examples=60)
def test_lacking_height_as_if_every_point_were_looked_at(seed: int, k: int) -> None:
    """Points that wander about a cylinder, no farther than a millimetre from one instant to the next."""
    random = np.random.default_rng(seed)
    steps = np.cumsum(random.uniform(-1, 1, 3) + 0.2 * random.normal(size=(k, 3)), axis=0)
    tip = (
        np.append(PART.centre, PART.height)
        + random.uniform(-0.06, 0.06, 3)
        + 1e-3 * steps / np.abs(steps).max() * k / 3.0**0.5
    )
    points = tip + np.array([0.0, 0.0, 1.0]) * np.array(NOZZLE_POINTS)[:, None, None]
    gaps = np.stack([PART.signed_distance(points[:, i]) for i in (0, -1)])
    space = TravelClearance(PART, 0.0, 5e-3, tip[[0, -1]], gaps)
    away = np.linalg.norm(tip[:, None] - space.tips, axis=2)
    cones = (gaps[:, :, None] + SLOPE * away.T[:, None]).min(axis=0)
    needed = np.maximum(np.minimum(space.full, cones) - 0.25e-3, min(0.0, float(gaps.min())))
    lacking = needed - PART.signed_distance(points.reshape(-1, 3)).reshape(needed.shape)
    assert (space.lacking(points) > 0.0) == (lacking.max() > 0.0)


@pytest.mark.parametrize(
    ("height", "lift", "full"), [(0.5, 5.0, 5.5), (10.0, 30.0, 40.0), (10.0, 100.0, 50.0), (45.0, 30.0, 65.0)]
)
def test_a_travel_keeps_the_whole_lift_as_far_as_surfaces_tell(height: float, lift: float, full: float) -> None:
    """In mm. Waypoints tell no distance beyond 50 from what they lie on; above what stands out more, 20 count."""
    space = TravelClearance(PART, 1e-3 * height, 1e-3 * lift, np.zeros((2, 3)), np.zeros((2, len(NOZZLE_POINTS))))
    assert 1e3 * space.full == pytest.approx(full)


class NearBed(LevelLayers):
    """A bed that is no farther away than FAR, as what waypoints tell of."""

    def signed_distance(self, points: Array) -> Array:
        return np.asarray(np.minimum(super().signed_distance(points), FAR))


@pytest.mark.parametrize("fit", FITS)
def test_an_arc_is_no_higher_than_surfaces_tell(fit: tuple[float, float]) -> None:
    """The whole lift is 50 mm from the bed there; an arc that is to be higher by a fifth would rise all the way."""
    tips = np.array([[0.0, 0.0, 0.01], [0.5, 0.0, 0.01]])
    room = TravelClearance(NearBed((), ()), 0.01, 0.1, tips, np.full((2, len(NOZZLE_POINTS)), 0.01))
    assert _walk(room, *fit)[:, 2].max() == pytest.approx(FAR)


def test_a_travel_lasts_as_long_as_the_process_needs(cell: Cell) -> None:
    end = cell.home.copy()
    end[5] += 0.1
    quick, slow = (travel(cell, still(cell.home), still(end), least=least) for least in (0.0, 1.5))
    assert quick is not None
    assert slow is not None
    assert quick.duration < 0.5
    assert 1.5 - 1e-9 <= slow.duration < 1.6
    check_limits(cell, slow)


def test_joint_ranges_hold_where_a_move_swings_back(cell: Cell) -> None:
    """In motion towards a limit too near to stop before it: refused, and with room enough it is not."""
    for room_left, possible in ((0.001, False), (0.2, True)):
        q = cell.home.copy()
        q[5] = cell.limits.q_max[5] - room_left
        v = np.zeros(7)
        v[5] = 1.5
        end = cell.home.copy()
        end[5] = q[5] - 0.3
        motion = travel(cell, JointState(q, v, np.zeros(7)), still(end), speed=2.0)
        assert (motion is not None) == possible
        if motion is not None:
            check_limits(cell, motion)


# --- travels of a print -----------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Print:
    """Beads as they are timed, and the travels between them."""

    timed: tuple[TimedPath, ...]
    travels: list[Cubics]


@pytest.fixture(scope="module", params=["at rest", "in motion"])
def a_print(
    request: pytest.FixtureRequest,
    cell: Cell,
    timed: tuple[TimedPath, ...],
    toolpath: Toolpath,
    drawing_problem: Problem,
) -> Print:
    if request.param == "in motion":
        timed = tuple(time_path(cell, piece.path, (True, True)) for piece in timed)
        assert not any(state.resting for piece in timed for state in (piece.start, piece.end))
    return Print(timed, plan_travels(cell, timed, toolpath, drawing_problem.process))


def test_travels_join_home_and_beads(cell: Cell, a_print: Print) -> None:
    timed, travels = a_print.timed, a_print.travels
    assert len(travels) == len(timed) + 1
    home = [cell.home.copy() for _ in range(2)]
    home[0][6:], home[1][6:] = timed[0].start.q[6:], timed[-1].end.q[6:]  # the table waits where the beads have it
    starts = [still(home[0]), *(piece.end for piece in timed)]
    ends = [*(piece.start for piece in timed), still(home[1])]
    for motion, start, end in zip(travels, starts, ends, strict=True):
        check_joined(motion, start, end)
        check_smooth(motion)


def test_travels_keep_limits_and_speed(cell: Cell, a_print: Print, drawing_problem: Problem) -> None:
    for motion in a_print.travels:
        check_limits(cell, motion)
        assert tip_speed(cell, motion) <= drawing_problem.process.travel_speed


def distance_to_cylinder(points: Array, radius: float) -> Array:
    """From the upright cylinder of the problem, 100 mm high; negative inside."""
    radial = np.hypot(points[..., 0] - 0.0314, points[..., 1] - 0.037) - radius
    axial = np.maximum(points[..., 2] - 0.1, -points[..., 2])
    outside = np.hypot(np.maximum(radial, 0), np.maximum(axial, 0))
    return np.where((radial < 0) & (axial < 0), np.maximum(radial, axial), outside)


def test_travels_keep_clear_of_the_cylinder(cell: Cell, a_print: Print, toolpath: Toolpath) -> None:
    """Tip and nozzle, up to 100 mm behind the tip, and what is printed by then: above the lift, or a cone at an end."""
    lift = 5e-3
    for i, motion in enumerate(a_print.travels):
        layers = 0 if i == 0 else toolpath.beads[i - 1].layer + 1
        T = cell.T_part_nozzle(motion.joints(np.linspace(0.0, motion.duration, 2000)))
        backs = np.linspace(0.0, 0.1, 41)[:, None, None]
        distance = distance_to_cylinder(T[:, :3, 3] - backs * T[:, :3, 2], 0.034 + layers * 0.5e-3)
        tip = T[:, :3, 3]
        cones = np.stack([distance[:, e][:, None] + SLOPE * np.linalg.norm(tip - tip[e], axis=1) for e in (0, -1)]).min(
            axis=0
        )
        assert (distance > np.minimum(lift, cones) - 0.75e-3).all()  # looked at in steps of a millimetre
        assert distance.min() > 0.5e-3


def test_travel_is_as_quick_as_the_joints_where_the_lift_fits_in(cell: Cell, a_print: Print) -> None:
    """Most travels between beads take little more than the straight move from end to start would."""
    if not a_print.timed[0].start.resting:
        pytest.skip("the straight move is known in closed form from rest to rest")
    bounds = bounds_of(cell)
    direct = [resting(bounds, a.end.q, b.start.q).duration for a, b in itertools.pairwise(a_print.timed)]
    taken = [motion.duration for motion in a_print.travels[1:-1]]
    assert all(ours >= least - 1e-9 for ours, least in zip(taken, direct, strict=True))
    assert np.median(np.array(taken) / direct) < 1.1


def test_some_of_the_travels(cell: Cell, a_print: Print, toolpath: Toolpath, drawing_problem: Problem) -> None:
    some = plan_travels(cell, a_print.timed, toolpath, drawing_problem.process, range(2, 4))
    assert [motion.duration for motion in some] == [motion.duration for motion in a_print.travels[2:4]]


def test_the_extruder_has_the_time_to_retract_and_prime(cell: Cell, a_print: Print, toolpath: Toolpath) -> None:
    """From the end of a bead to the start of the next: exactly that, where the joints alone would be quicker."""
    process = ProcessSpec(
        speed_mm_s=40.0,
        travel_speed_mm_s=200.0,
        bead={"width_mm": 0.6, "height_mm": 0.5},
        prime={"length_mm": 20.0, "speed_mm_s": 20.0},
        retract={"length_mm": 10.0, "speed_mm_s": 20.0},
    )
    needed = least_travel_time(process)
    assert needed == pytest.approx(1.5)
    motions = plan_travels(cell, a_print.timed, toolpath, process, range(1, 4))
    for i, motion in enumerate(motions):
        before, after = a_print.timed[i], a_print.timed[i + 1]
        pause = before.duration - before.when(toolpath.beads[i].length) + motion.duration + after.when(0.0)
        assert needed <= pause < needed + 0.01
        check_limits(cell, motion)
        check_smooth(motion)
        check_joined(motion, before.end, after.start)


def test_without_a_place_to_rest_the_travel_takes_the_time(
    cell: Cell,
    timed: tuple[TimedPath, ...],
    toolpath: Toolpath,
    drawing_problem: Problem,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Neither home nor lifted: no way leads there or back."""
    nowhere = still(cell.home)
    monkeypatch.setattr(planner.motion.travel.plan, "_home_beside", lambda *_: nowhere)
    monkeypatch.setattr(planner.motion.travel.plan, "above", lambda *_: (nowhere, nowhere))

    def no_way_to_a_rest(task: TravelTask) -> Cubics | None:
        ends = task.ends
        return None if ends.start is nowhere or ends.end is nowhere else quickest(task)

    monkeypatch.setattr(planner.motion.travel.plan, "quickest", no_way_to_a_rest)
    (motion,) = plan_travels(cell, timed, toolpath, drawing_problem.process, [2], within={2: 6.0})
    assert isinstance(motion, Cubics)
    assert 6.0 - 1e-9 <= motion.duration < 6.1
    check_joined(motion, timed[1].end, timed[2].start)
    check_limits(cell, motion)


def test_a_bead_over_a_gap_is_high_until_its_layer_is_done() -> None:
    walls = [line(layer, (x, 0), (x, 20)) for layer in range(8) for x in (0, 8)]
    roofed = [*walls, *(line(layer, (0, 10), (8, 10)) for layer in (8, 9, 10))]
    layers = LevelLayers.of(roofed)
    printed = _grown(roofed, [layers.before(i) for i in range(len(roofed) + 1)])
    assert printed == pytest.approx([0.0, *[0.5e-3] * 16, np.hypot(3.7e-3, 0.5e-3), 0.5e-3, 0.5e-3])


def test_on_a_surface_that_does_not_grow_nothing_is_forgotten() -> None:
    beads = [line(layer, (60, y), (90, y)) for layer in range(3) for y in (30, 0)]
    heights = [float(PART.signed_distance(bead.points).max()) for bead in beads]
    assert _grown(beads, [PART] * 7) == list(itertools.accumulate(heights, max, initial=0.0))


class Wall:
    """A surface that is everywhere too near."""

    def signed_distance(self, points: Array) -> Array:
        return np.zeros(len(points))

    def normals(self, points: Array) -> Array:
        return np.tile([1.0, 0.0, 0.0], (len(points), 1))

    def normals_on(self, bead: int, s: Array, tips: Array) -> Array:
        return self.normals(tips)

    def before(self, bead: int) -> Wall:
        return self


def test_no_way_round_is_a_refusal_that_names_the_bead(
    cell: Cell, timed: tuple[TimedPath, ...], toolpath: Toolpath, drawing_problem: Problem
) -> None:
    surface: Surface = Wall()
    with pytest.raises(Refusal) as caught:
        plan_travels(cell, timed, Toolpath(toolpath.beads, surface), drawing_problem.process)
    assert caught.value.bead == 0
    assert "clear" in str(caught.value)


def test_the_table_stays_where_the_last_bead_leaves_it(
    cell: Cell, joint_paths: dict[str, tuple[JointPath, ...]], toolpath: Toolpath, drawing_problem: Problem
) -> None:
    # As published the table does all the turning, so that it ends elsewhere than it began.
    timed = [time_path(cell, path) for path in joint_paths["as_published"]]
    assert abs(timed[-1].end.q[6] - timed[-1].start.q[6]) > 1e-3
    home = plan_travels(cell, timed, toolpath, drawing_problem.process, range(len(timed), len(timed) + 1))[-1]
    q = home.joints(np.linspace(0.0, home.duration, 100))
    np.testing.assert_allclose(q[:, 6], timed[-1].end.q[6], rtol=0, atol=1e-9)


@dataclass(frozen=True)
class NoRoomAtHome:
    """Obstacles that leave the arm no room at home while the table stands as beads have it."""

    cell: Cell
    any: bool = False  # as far as the way itself is concerned

    def for_nozzle(self, cell: Cell, own: Cell) -> NoRoomAtHome:
        return self

    def margins(self, q: Array, now: Array, enough: float) -> tuple[Array, Array]:
        home = self.cell.home
        at_home = (np.abs(q[:, :6] - home[:6]) < 1e-9).all(axis=1)
        return np.where(at_home & (np.abs(q[:, 6] - home[6]) > 1e-9), -1e-3, enough), np.zeros(len(q))


@pytest.mark.parametrize("first", [True, False])
def test_the_table_turns_on_the_way_where_the_arm_has_no_room_at_home_otherwise(
    cell: Cell, timed: tuple[TimedPath, ...], toolpath: Toolpath, drawing_problem: Problem, first: bool
) -> None:
    bead, home = timed[0].start if first else timed[-1].end, cell.home.copy()
    home[6] = bead.q[6] + 0.3
    turned = replace(cell, home=home)
    which = [0 if first else len(timed)]
    (motion,) = plan_travels(turned, timed, toolpath, drawing_problem.process, which, NoRoomAtHome(turned))
    check_joined(motion, *((still(home), bead) if first else (bead, still(home))))
    check_limits(cell, motion)


@pytest.mark.parametrize(("joint", "turn"), [(5, -1), (6, 1)])
def test_a_joint_unwinds_on_the_way(
    cell: Cell, timed: tuple[TimedPath, ...], toolpath: Toolpath, drawing_problem: Problem, joint: int, turn: int
) -> None:
    """A whole turn between two beads: clear of the part, within all limits, at the travel's speed."""
    start, end = timed[1].end, timed[2].start
    q = end.q.copy()
    q[joint] += turn * 2.0 * np.pi
    if not cell.limits.q_min[joint] < q[joint] < cell.limits.q_max[joint]:
        q[joint] -= 2 * turn * 2.0 * np.pi
    motion = travel(cell, start, replace_q(end, q))
    assert motion is not None
    check_limits(cell, motion)
    assert tip_speed(cell, motion) <= 0.2
    T = cell.T_part_nozzle(motion.joints(np.linspace(0.0, motion.duration, 4000)))
    for back in NOZZLE_POINTS:
        assert distance_to_cylinder(T[:, :3, 3] - back * T[:, :3, 2], 0.034).min() > 0.5e-3


def replace_q(state: JointState, q: Array) -> JointState:
    return JointState(q, state.v, state.a)
