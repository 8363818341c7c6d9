"""The player of programs: what it does to a program is what its speeds, zones, configurations and frames say."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from planner.base.errors import InputError
from planner.export.fit import angle, from_matrix
from planner.export.moves import deposits
from planner.export.player.play import play
from planner.export.program import RobotProgram, Trigger
from planner.export.rapid.reader import read_rapid
from planner.export.rapid.writer import quadrants, rapid
from tests.export_fixtures import make_plan

_CELL = make_plan(positioner=False).cell  # whose limits are those of a synthetic plan
CELL = replace(_CELL, limits=replace(_CELL.limits, acceleration=np.asarray(_CELL.arm_robot.acceleration)))
HOME = CELL.home
FAST = 100.0  # of reorientation and axes, so that they never limit
SPEED = 0.05


def program_through(points, *, fine=(), speed=SPEED, turn=FAST, zone=0.3e-3, linear=None, wait=None, quat=None):
    """A program from home through tip positions relative to home (m, 3), the nozzle turned as at home."""
    points = np.asarray(points, dtype=float)
    m = len(points)
    T = CELL.T_part_nozzle(HOME[None])
    flange = CELL.T_flange_nozzle
    stops = np.isin(np.arange(m), [*fine, m - 1])
    return RobotProgram(
        module="Test",
        tool=_frame(flange),
        uframe=_frame(CELL.T_world_holder),
        oframe=_frame(np.eye(4)),
        station="",
        start=np.concatenate([HOME, np.full(6, np.nan)]),
        linear=np.ones(m, dtype=bool) if linear is None else np.asarray(linear),
        fine=stops,
        position=T[0, :3, 3] + points,
        quat=np.tile(from_matrix(T[:, :3, :3]), (m, 1)) if quat is None else quat,
        conf=np.tile([*quadrants(HOME[None])[0], CELL.inverse.branches(HOME[None])[0]], (m, 1)).astype(np.intp),
        external=np.full((m, 6), np.nan),
        zone=np.where(stops, 0.0, zone),
        speed=np.tile([speed, turn, 1.0, FAST], (m, 1)),
        wait=np.zeros(m) if wait is None else np.asarray(wait, dtype=float),
        triggers={},
        sends={},
    )


def _frame(T):
    return np.concatenate([T[:3, 3], from_matrix(T[None, :3, :3])[0]])


def laid_times(played):
    """How long the extruder was on, each time [s]."""
    switched = [event for event in played.events if event.kind == "output"]
    assert [event.value for event in switched] == [1.0, 0.0] * (len(switched) // 2)
    return np.array([off.t - on.t for on, off in zip(switched[::2], switched[1::2], strict=True)])


@pytest.mark.parametrize("options", [{}, {"positioner": False}, {"free": ("tilt", "rotation")}])
def test_a_plan_s_program_does_what_the_plan_does(options):
    plan = make_plan(dip=False, **options)
    t = plan.trajectory
    program = read_rapid(rapid(plan))
    played = play(program, plan.cell)
    first, last = deposits(t)
    assert laid_times(played) == pytest.approx(t.t[last] - t.t[first], rel=0.002)
    assert played.strays == ()
    assert played.q[0] == pytest.approx(t.q[0], abs=1e-6)
    assert played.at(played.duration).q == pytest.approx(t.q[-1], abs=1e-5)
    for event, sample in zip(played.events, np.sort(np.concatenate([first, last])), strict=True):
        assert np.linalg.norm(np.array(event.position) - t.tip[sample]) < 0.01e-3
        assert np.abs(played.at(event.t).q - t.q[sample]).max() < 1e-4
    assert np.linalg.norm(played.position[played.target] - program.position, axis=1).max() < 2e-6
    assert angle(played.quat[played.target], program.quat).max() < 1e-5


def test_a_wrong_tool_or_work_object_takes_the_true_nozzle_elsewhere():
    plan = make_plan()
    program = read_rapid(rapid(plan))
    for name in ("tool", "oframe"):
        frame = getattr(program, name) + [0.5e-3, 0, 0, 0, 0, 0, 0]
        played = play(replace(program, **{name: frame}), plan.cell)
        off = np.linalg.norm(played.position[played.target] - program.position, axis=1)
        assert off[1:] == pytest.approx(0.5e-3, abs=5e-6)


def test_one_line_is_a_trapezoid():
    played = play(program_through([[0, 0.06, 0]]), CELL)
    v = np.linalg.norm(np.gradient(played.at(np.linspace(0, played.duration, 20001)).position, axis=0), axis=1)
    v *= 20000 / played.duration
    assert v.max() == pytest.approx(SPEED, rel=1e-3)
    assert v[0] < 0.01 * SPEED
    assert v[-1] < 0.01 * SPEED
    rate = np.abs(np.diff(played.q, axis=0)) / np.linalg.norm(np.diff(played.position, axis=0), axis=1)[:, None]
    ramps = [SPEED / (CELL.limits.acceleration / rate[k]).min() for k in (0, -1)]  # a ramp takes v / a, half of it lost
    assert played.duration == pytest.approx(0.06 / SPEED + 0.5 * sum(ramps), rel=1e-3)


def test_the_slowest_governs():
    assert play(program_through([[0, 0.04, 0]]), CELL).limits[0] == "the tip"
    half = np.array([[0, np.sin(0.15), 0, np.cos(0.15)]])  # 0.3 rad
    turned = _product(program_through([[0, 0, 0]]).quat, half)
    slow = play(program_through([[0, 0.001, 0]], turn=0.1, quat=turned), CELL)
    assert slow.duration == pytest.approx(0.3 / 0.1, rel=0.01)
    assert {slow.limits[k] for k in slow.limit} == {"reorientation"}
    quick = play(program_through([[0, 0.1, 0]], speed=50.0), CELL)
    change = np.abs(np.diff(quick.q, axis=0)).sum(axis=0)
    assert quick.duration > (change / CELL.limits.velocity).max()
    assert all(quick.limits[k].startswith("the speed limit of joint_") for k in quick.limit)


def _product(a, b):
    av, aw, bv, bw = a[:, :3], a[:, 3:], b[:, :3], b[:, 3:]
    return np.column_stack([aw * bv + bw * av + np.cross(av, bv), aw * bw - (av * bv).sum(axis=1, keepdims=True)])


def test_rests_and_waits():
    program = program_through([[0, 0.02, 0], [0, 0.04, 0], [0, 0.06, 0]], fine=[1], wait=[0, 0.5, 0.25])
    program = replace(program, sends={-1: ("first",), 0: ("a", "b"), 1: ("c",)})
    played = play(program, CELL)
    assert [(e.kind, e.move, e.text, e.value) for e in played.events] == [
        ("send", -1, "first", 0.0),
        ("send", 0, "a", 0.0),
        ("send", 0, "b", 0.0),
        ("send", 1, "c", 0.0),
        ("wait", 1, "", 0.5),
        ("wait", 2, "", 0.25),
    ]
    rest = played.at(played.arrive[1] + np.linspace(0.0, 0.499, 7))
    assert np.ptp(rest.position, axis=0).max() == 0.0
    assert played.at(played.arrive[1] + 0.51).position[1] > rest.position[0, 1]
    assert played.duration == pytest.approx(played.arrive[2] + 0.25)
    without = play(replace(program, wait=np.zeros(3)), CELL)
    assert played.duration == pytest.approx(without.duration + 0.75)
    assert without.duration > play(replace(without_stop(program), wait=np.zeros(3)), CELL).duration


def without_stop(program):
    fine = np.arange(len(program.fine)) == len(program.fine) - 1
    return replace(program, fine=fine, zone=np.where(fine, 0.0, 0.3e-3))


def test_triggers_have_their_place_on_the_move():
    program = program_through([[0, 0.02, 0], [0, 0.05, 0]])
    triggers = (Trigger(0.004, True, True, "doOne"), Trigger(0.0, False, False, "doOne"))
    played = play(replace(program, triggers={1: triggers}), CELL)
    at = np.array([e.position for e in played.events]) - CELL.T_part_nozzle(HOME[None])[0, :3, 3]
    assert at[:, 1] == pytest.approx([0.024, 0.05], abs=1e-6)
    assert played.events[1].t == played.arrive[1]
    assert played.events[1].t - played.events[0].t == pytest.approx(0.026 / SPEED, rel=0.05)


def test_a_sharp_corner_slows_down_and_a_straight_one_does_not():
    straight = play(program_through([[0, 0.02, 0], [0, 0.04, 0]]), CELL)
    corner = play(program_through([[0, 0.02, 0], [0.02, 0.02, 0]], speed=0.2), CELL)
    wide = play(program_through([[0, 0.02, 0], [0.02, 0.02, 0]], speed=0.2, zone=5e-3), CELL)
    one = play(program_through([[0, 0.04, 0]]), CELL)
    assert straight.duration == pytest.approx(one.duration, rel=1e-3)
    assert corner.duration > wide.duration * 1.03


def test_a_wrong_configuration_on_a_line_is_told_and_not_followed():
    program = program_through([[0, 0.01, 0], [0, 0.02, 0], [0, 0.03, 0]])
    conf = program.conf.copy()
    conf[1, 3] ^= 1
    played = play(replace(program, conf=conf), CELL)
    assert played.strays == (1,)
    assert played.q == pytest.approx(play(program, CELL).q, abs=1e-9)
    for column in range(3):
        conf = program.conf.copy()
        conf[2, column] += 1
        assert play(replace(program, conf=conf), CELL).strays == (2,)


def test_joint_moves_go_to_the_turns_that_they_name():
    program = program_through([[0, 0.02, 0]], linear=[False])
    conf = program.conf.copy()
    conf[0, 2] -= 4
    there, other = play(program, CELL), play(replace(program, conf=conf), CELL)
    assert other.strays == ()
    assert other.q[-1] - there.q[-1] == pytest.approx([0, 0, 0, 0, 0, -2 * np.pi])
    assert np.abs(np.diff(other.q, axis=0)).max() <= np.radians(1.0) + 1e-9
    assert np.linalg.norm(other.position[-1] - program.position[-1]) < 1e-9


def test_joint_moves_go_to_the_joints_that_they_name():
    """As languages say them that name no quarters: a whole turn more is another posture."""
    program = program_through([[0, 0.02, 0], [0, 0.03, 0]], linear=[False, True])
    q = play(program, CELL).q
    turned = q[play(program, CELL).target[0]] + [0, 0, 0, 0, 0, -2 * np.pi]
    named = replace(program, joints=np.vstack([turned, np.full(6, np.nan)]))
    other = play(named, CELL)
    assert other.q[other.target[0]] == pytest.approx(turned)
    assert other.q[-1] - q[-1] == pytest.approx([0, 0, 0, 0, 0, -2 * np.pi])


@pytest.mark.parametrize("fourth", [0.0, 0.3, -0.4])
def test_a_straight_wrist_at_home_is_no_riddle(fourth):
    home = np.array([0.1, 0.2, 0.3, fourth, 0.0, 0.5])
    away = home + [0.1, 0.1, -0.1, 0.2, 0.6, 0.1]
    T = CELL.T_part_nozzle(np.vstack([away, home]))
    program = program_through(np.zeros((2, 3)), linear=[False, False])
    program = replace(
        program,
        start=np.concatenate([home, np.full(6, np.nan)]),
        position=np.round(T[:, :3, 3], 6),
        quat=np.round(from_matrix(T[:, :3, :3]), 7),
        conf=np.column_stack([quadrants(np.vstack([away, home])), [0, 0]]).astype(np.intp),
    )
    played = play(program, CELL)
    assert played.strays == ()
    assert played.q[-1] == pytest.approx(home, abs=0.02)
    assert np.linalg.norm(played.position[-1] - T[1, :3, 3]) < 1e-5
    assert angle(played.quat[-1:], from_matrix(T[1:, :3, :3]))[0] < 5e-5


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (lambda p: {"position": p.position + [0, 5.0, 0]}, "move 0 is out of reach"),
        (lambda p: {"conf": p.conf + [0, 0, 0, 8]}, "names configuration"),
        (lambda p: {"start": np.full(12, np.nan)}, "position of every joint"),
        (lambda p: {"speed": p.speed * [0, 1, 1, 1]}, "move 0 has no speed"),
        (lambda p: {"speed": p.speed * [1, np.nan, 1, 1]}, "move 0 has no speed"),
    ],
)
def test_what_cannot_be_played_is_refused(changes, message):
    program = program_through([[0, 0.02, 0]])
    with pytest.raises(InputError, match=message):
        play(replace(program, **changes(program)), CELL)


def test_axes_of_the_station_must_be_said_and_held_ones_stay():
    plan = make_plan()
    program = read_rapid(rapid(plan))
    names = plan.cell.holder_robot.joint_names
    for name, value, message in (
        ("rotation", np.nan, "position of every axis"),
        ("tilt", 0.1, "tilt of the station is held"),
    ):
        external = program.external.copy()
        external[5, names.index(name)] = value
        with pytest.raises(InputError, match=message):
            play(replace(program, external=external), plan.cell)


def test_any_time_gives_a_moment_of_its_shape():
    played = play(program_through([[0, 0.02, 0], [0.01, 0.02, 0]]), CELL)
    assert played.at(-1.0).q.shape == (6,)
    assert played.at(1e9).q == pytest.approx(played.q[-1])
    grid = played.at(np.linspace(0.0, played.duration, 12).reshape(3, 4))
    assert grid.position.shape == (3, 4, 3)
    assert grid.move.shape == (3, 4)
    assert CELL.T_part_nozzle(grid.q.reshape(-1, 6))[:, :3, 3] == pytest.approx(grid.position.reshape(-1, 3), abs=1e-5)
    assert (np.diff(grid.move.ravel()) >= 0).all()


POINT = st.tuples(*[st.integers(-25, 25)] * 3)


@settings(max_examples=40, deadline=None)
@given(
    st.lists(st.tuples(POINT, st.booleans(), st.booleans()), min_size=1, max_size=8),
    st.sampled_from([0.005, 0.04, 0.5]),
    st.sampled_from([0.3e-3, 5e-3]),
)
def test_whatever_is_played_keeps_its_places_and_speeds(moves, speed, zone):
    points = np.array([point for point, _, _ in moves]) * 1e-3
    fine = [k for k, (_, stop, _) in enumerate(moves) if stop]
    linear = [line for _, _, line in moves]
    program = program_through(points, fine=fine, speed=speed, zone=zone, linear=linear)
    played = play(program, CELL)
    there = played.at(played.arrive).position
    assert np.linalg.norm(there - program.position, axis=1).max() < 1e-8
    way = np.linalg.norm(np.diff(np.vstack([np.zeros(3), points]), axis=0), axis=1).sum()
    assert played.duration >= way / speed * (1 - 1e-9)
    assert (np.diff(played.leave) >= 0.0).all()
    dt = played.duration / 2000 if played.duration > 0 else 1.0
    motion = played.at(np.arange(2001) * dt)
    step = np.linalg.norm(np.diff(motion.position, axis=0), axis=1)
    assert step.max() <= speed * dt * (1 + 1e-6)
    assert (np.abs(np.diff(motion.q, axis=0)) <= CELL.limits.velocity * dt * (1 + 1e-6)).all()
    for k in np.flatnonzero(program.fine):  # comes to rest there
        near = played.at(played.arrive[k] + np.array([-1e-5, 1e-5])).position
        assert np.abs(near - program.position[k]).max() < 1e-7


@settings(max_examples=60, deadline=None)
@given(st.floats(0.0, 1.0), st.integers(0, 30))
def test_when_a_place_is_passed_is_when_it_is_passed(u, k):
    played = play(program_through([[0, 0.02, 0], [0.01, 0.025, 0], [0.01, 0.05, 0]], fine=[0]), CELL)
    k = np.array([k % len(played.move)])
    t = played.reached(k, np.array([u]))
    wanted = played.position[k] + u * (played.position[k + 1] - played.position[k])
    assert np.abs(played.at(t).position - wanted).max() < 1e-8
