"""Joints streamed by externally guided motion: never a step beyond the limits, and a stop whenever something is odd."""

from __future__ import annotations

import builtins
import json
import signal
import socket
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, closing, contextmanager, suppress
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from export_fixtures import make_plan, socket_plan, two_arms_plan
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from link_ends import as_results

from planner.base.errors import InputError
from planner.export.plan_json import plan_json
from planner.export.tables import write_table
from planner.link import egm_wire as egm_wire_module
from planner.link import guided_motion as egm
from planner.link.connections import Address
from planner.link.egm_wire import EgmState, EgmWire, egm_wire
from planner.link.feed import Feed, FeedStopped, feeding
from planner.link.guided_motion import (
    DEVIATION,
    GAP,
    LEAD,
    NEAR_START,
    PERIOD,
    SLICE,
    EgmStopped,
    FilamentFeed,
    Follower,
    JointPlan,
    Limiter,
    filament_tool,
    read_plan,
)
from planner.link.program_lines import NO_BEAD
from planner.link.telling import GoingOn
from planner.plan import Plan
from planner.simulate.board import BOARD_FAULTS, EGM_FAULTS, faults_of
from planner.simulate.egm import EgmRobot
from planner.simulate.servers import BoardServer
from tests.test_counted import cell_of

DEGREES = np.pi / 180.0
VELOCITY, ACCELERATION = np.array([2.0, 3.0]), np.array([15.0, 30.0])


def folder_of(plan: Plan, folder: Path) -> Path:
    (folder / "plan.json").write_text(plan_json(plan), "utf-8")
    with (folder / "trajectory.csv").open("w", encoding="ascii", newline="\n") as table:
        write_table(plan, table)
    as_results(folder)
    return folder


def bow(seconds: float = 1.2, turn: float = 0.4) -> JointPlan:
    """Two axes from rest to rest and back, well within their limits."""
    t = np.arange(0.0, seconds + PERIOD / 2, PERIOD)
    q = turn * 0.5 * (1.0 - np.cos(2.0 * np.pi * t / seconds))
    return JointPlan(np.column_stack([q, -0.5 * q]), VELOCITY, ACCELERATION)


def within_limits(references: np.ndarray, velocity=VELOCITY, acceleration=ACCELERATION) -> bool:
    speed = np.diff(references, axis=0) / PERIOD
    change = np.diff(speed, axis=0, prepend=0.0 * speed[:1]) / PERIOD
    return bool((np.abs(speed) <= velocity * 1.000001).all() and (np.abs(change) <= acceleration * 1.000001).all())


# ---- the limiter --------------------------------------------------------------------------------------------------


@settings(max_examples=100, deadline=None)
@given(arrays(np.float64, (60, 2), elements=st.floats(-4.0, 4.0)), st.lists(st.integers(0, 59), max_size=2))
def test_no_step_goes_beyond_the_limits_whatever_is_asked_for(goals, stops) -> None:
    limiter = Limiter(goals[0], VELOCITY, ACCELERATION, PERIOD)
    out = [goals[0]]
    for goal in goals:
        out.append(limiter.next(goal))
    assert within_limits(np.array(out))


@settings(max_examples=15, deadline=None)
@given(st.floats(-2.0, 2.0), st.floats(-2.0, 2.0))
def test_a_goal_that_jumped_is_reached_and_not_passed(one: float, two: float) -> None:
    limiter, goal = Limiter(np.zeros(2), VELOCITY, ACCELERATION, PERIOD), np.array([one, two])
    out = np.array([limiter.next(goal) for _ in range(1500)])
    np.testing.assert_allclose(out[-1], goal, atol=1e-6)
    assert (np.abs(out) <= np.abs(goal) * 1.02 + 1e-4).all()


def test_what_keeps_the_limits_comes_out_unchanged() -> None:
    plan = bow()
    limiter = Limiter(plan.q[0], VELOCITY, ACCELERATION, PERIOD)
    out = np.array([limiter.next(goal) for goal in plan.q])
    np.testing.assert_allclose(out, plan.q, atol=1e-9)
    still = Limiter(np.zeros(2), np.array([2.0, 0.0]), np.array([15.0, 0.0]), PERIOD)
    assert [still.next(np.ones(2))[1] for _ in range(5)] == [0.0] * 5


# ---- following, in time that passes only here ---------------------------------------------------------------------


def guided(plan: JointPlan, lag: float = 0.03, spoil=None) -> tuple[Follower, np.ndarray]:
    """A robot that follows with a first-order lag; spoil(k, heard) may change the words that are heard."""
    follower, at, out = Follower(plan), plan.q[0].copy(), []
    for k in range(20_000):
        heard = EgmState(at.copy(), True, k * PERIOD)
        reference = follower.answer(spoil(k, heard, follower) if spoil else heard)
        if reference is not None:
            out.append(reference)
            at += (1.0 - np.exp(-PERIOD / lag)) * (reference - at)
        if follower.over:
            return follower, np.array(out)
    raise AssertionError("never over")


def test_the_whole_plan_is_followed() -> None:
    plan = bow()
    follower, out = guided(plan)
    assert follower.sample == len(plan.q) - 1 and within_limits(out)
    # the ramp delays the plan by half its length, and moves no reference off the path
    assert np.abs(out[:, 1] + 0.5 * out[:, 0]).max() < 1e-4
    assert out[:, 0].max() == pytest.approx(plan.q[:, 0].max(), abs=1e-4)
    np.testing.assert_allclose(out[-1], plan.q[-1], atol=1e-6)


def test_a_start_that_is_a_little_off_is_taken_over_smoothly() -> None:
    off = bow()
    moved = replace(off, q=off.q + 0.9 * NEAR_START)
    follower, at, out = Follower(moved), off.q[0].copy(), []
    for k in range(2000):
        reference = follower.answer(EgmState(at.copy(), True, k * PERIOD))
        out.append(reference)
        at += 0.1 * (reference - at)
        if follower.over:
            break
    assert follower.over and within_limits(np.array(out)) and np.all(out[0] == off.q[0])
    far = Follower(replace(off, q=off.q + 1.1 * NEAR_START))
    with pytest.raises(EgmStopped, match=r"1\.10 degrees from the plan's start"):
        far.answer(EgmState(off.q[0], True, 0.0))


def test_it_waits_until_the_robot_runs() -> None:
    plan = bow()
    follower = Follower(plan)
    assert follower.answer(EgmState(plan.q[0], False, 0.0)) is None and not follower.begun
    assert follower.answer(EgmState(plan.q[0], True, 0.004)) is not None


@pytest.mark.parametrize(
    ("spoil", "reason"),
    [
        (lambda h: replace(h, running=False), "has stopped"),
        (lambda h: replace(h, joints=h.joints + [0.0, 1.3 * DEVIATION]), "axis 2 is .* away"),
        (lambda h: replace(h, joints=h.joints[:1]), "1 axes, the plan 2"),
        (lambda h: replace(h, joints=h.joints * np.nan), "not numbers"),
    ],
)
def test_whatever_is_odd_stops_it(spoil, reason: str) -> None:
    with pytest.raises(EgmStopped, match=reason):
        guided(bow(), spoil=lambda k, heard, _: spoil(heard) if k >= 100 else heard)


def test_a_robot_that_lags_too_much_is_stopped() -> None:
    with pytest.raises(EgmStopped, match="away from all references"):
        guided(bow(turn=0.6), lag=0.6)


def test_a_gap_lets_it_start_again_from_rest() -> None:
    plan, late = bow(), 0.1

    def gap(k: int, heard: EgmState, _: Follower) -> EgmState:
        return replace(heard, clock=heard.clock + (late if k >= 120 else 0.0))

    assert late > GAP * PERIOD
    _, out = guided(plan, spoil=gap)
    speed = np.diff(out, axis=0) / PERIOD
    assert np.abs(speed[118]).max() > 0.2 and np.abs(speed[119]).max() <= ACCELERATION[0] * PERIOD
    # after the gap the first step counts from rest, like the very first one
    assert within_limits(out[:120]) and within_limits(out[119:])


def test_a_stop_comes_to_rest_on_the_path() -> None:
    def stop(k: int, heard: EgmState, follower: Follower) -> EgmState:
        if k == 120:
            follower.stop()
        return heard

    follower, out = guided(bow(), spoil=stop)
    assert within_limits(out) and 110 < follower.sample < 125  # either ramp takes half its length
    assert np.abs(out[:, 1] + 0.5 * out[:, 0]).max() < 0.01 and np.abs(out[-1] - out[-2]).max() < 1e-6


# ---- the plan -----------------------------------------------------------------------------------------------------


def test_joints_of_a_plan_and_axes_that_are_held(tmp_path) -> None:
    plan = make_plan()
    read = read_plan(folder_of(plan, tmp_path))
    names = list(plan.cell.holder_robot.model.names)[1:]
    assert read.q.shape == (len(plan.trajectory), 6 + len(names)) and plan.cell.held
    for k, name in enumerate(names):
        if name in plan.cell.held:
            assert (read.q[:, 6 + k] == plan.cell.held[name]).all() and read.velocity[6 + k] == 0.0
        else:
            np.testing.assert_allclose(read.q[:, 6 + k], plan.trajectory.q[:, 6], atol=1e-9)
    np.testing.assert_allclose(read.q[:, :6], plan.trajectory.q[:, :6], atol=1e-9)
    np.testing.assert_allclose(read.velocity[:6], plan.cell.limits.velocity[:6])


def test_axes_named_as_those_of_the_arm_are_told_from_them(tmp_path) -> None:
    """A turntable whose axes are joint_1 and joint_2: plan.json names them so, the table positioner_joint_1 and so on."""
    folder = folder_of(make_plan(), tmp_path)
    as_named = read_plan(folder)
    data = json.loads((folder / "plan.json").read_text())
    data["cell"]["joints"][-1]["name"] = "positioner_joint_2"
    for axis, name in zip(data["cell"]["holder_axes"], ("joint_1", "joint_2"), strict=True):
        axis["name"] = name
    (folder / "plan.json").write_text(json.dumps(data))
    table = folder / "trajectory.csv"
    table.write_text(table.read_text().replace(",rotation\n", ",positioner_joint_2\n", 1))
    read = read_plan(folder)
    np.testing.assert_array_equal(read.q, as_named.q)
    np.testing.assert_array_equal(read.velocity, as_named.velocity)


@pytest.mark.parametrize(("axes", "said"), [(6, {}), (6, {"holder_is_arm": True}), (7, {"holder_is_arm": True})])
def test_a_second_arm_that_only_holds_has_no_part_in_it(axes: int, said: dict[str, bool], tmp_path) -> None:
    plan = make_plan(positioner=False)
    folder = folder_of(plan, tmp_path)
    data = json.loads((folder / "plan.json").read_text())
    held = [{"name": f"joint_{k}", "held_at": 0.1 * k} for k in range(1, axes + 1)]
    data["cell"] |= {"holder_axes": held, **said}
    (folder / "plan.json").write_text(json.dumps(data))
    read = read_plan(folder)
    np.testing.assert_allclose(read.q, plan.trajectory.q, atol=1e-9)
    np.testing.assert_allclose(read.velocity, plan.cell.limits.velocity)


def test_joints_are_sent_as_the_controller_counts_them(tmp_path) -> None:
    """An arm whose URDF has other zeros and senses: RAPID counts as data sheets do, and so does EGM."""
    (tmp_path / "own").mkdir()
    cell, plan = cell_of("KUKA KR 16-2", tmp_path / "own"), make_plan(positioner=False)
    twin = cell.as_counted
    assert np.abs(cell.counted(plan.trajectory.q) - plan.trajectory.q).max() > 1.0
    read = read_plan(folder_of(replace(plan, cell=cell), tmp_path))
    np.testing.assert_allclose(read.q, cell.counted(plan.trajectory.q), atol=1e-9)
    np.testing.assert_allclose(twin.arm.poses(read.q[:9]), cell.arm.poses(plan.trajectory.q[:9]), atol=1e-9)


def test_a_second_arm_that_moves_the_part_is_refused(tmp_path) -> None:
    with pytest.raises(InputError, match="a second arm moves the part"):
        read_plan(folder_of(two_arms_plan(), tmp_path))


def test_a_table_of_other_steps_is_resampled(tmp_path) -> None:
    plan = make_plan()
    every = slice(0, None, 2)
    t = plan.trajectory
    coarse = {k: v[every] for k, v in vars(t).items() if isinstance(v, np.ndarray)}
    read = read_plan(folder_of(replace(plan, trajectory=replace(t, dt=0.008, **coarse)), tmp_path))
    assert abs(len(read.q) - len(t)) <= 1
    assert np.abs(read.q[: len(t) - 1, :6] - t.q[: len(read.q), :6][: len(t) - 1]).max() < 2e-3


@pytest.mark.parametrize(
    ("spoil", "reason"),
    [
        (lambda d: d.update(verified=False), "not verified"),
        (lambda d: d.pop("cell"), "not a plan of this version"),
        (lambda d: d["cell"]["joints"].pop(0), "6 axes"),
        (lambda d: d["cell"]["joints"][0].update(v_max=0.0), "not a positive number"),
        (lambda d: d["cell"]["joints"][0].update(name="elbow"), "no column 'elbow'"),
        (lambda d: d["cell"].update(holder_axes=3), "not a plan of this version"),
        (lambda d: d["cell"]["joints"][1].update(controller_offset=np.nan), "an angle is not a number"),
    ],
)
def test_what_is_no_plan_is_told(spoil, reason: str, tmp_path) -> None:
    folder_of(make_plan(), tmp_path)
    data = json.loads((tmp_path / "plan.json").read_text())
    spoil(data)
    (tmp_path / "plan.json").write_text(json.dumps(data))
    with pytest.raises(InputError, match=reason):
        read_plan(tmp_path)


@pytest.mark.parametrize(
    ("old", "new"), [("0.040000,", "0.041000,"), ("0.040000,", "nan,"), ("0.040000,", "x,"), ("0.040000,", "")]
)
def test_a_damaged_table_is_told(old: str, new: str, tmp_path) -> None:
    table = folder_of(make_plan(), tmp_path) / "trajectory.csv"
    text = table.read_text()
    assert "\n" + old in text
    table.write_text(text.replace("\n" + old, "\n" + new, 1))
    with pytest.raises(InputError, match="trajectory"):
        read_plan(tmp_path)
    table.unlink()
    with pytest.raises(InputError, match="cannot be read"):
        read_plan(tmp_path)


def test_a_table_of_steps_that_no_plan_has_is_not_filled_up(tmp_path) -> None:
    """A second between rows would be 250 joints for each of them."""
    table = folder_of(make_plan(), tmp_path) / "trajectory.csv"
    head, *rows = table.read_text().splitlines()
    late = [f"{k}.0,{row.split(',', 1)[1]}" for k, row in enumerate(rows)]
    table.write_text("\n".join([head, *late, ""]))
    with pytest.raises(InputError, match=r"steps of 1 s, but no plan has more than 0\.02 s"):
        read_plan(tmp_path)


def test_nested_lists_without_end_are_no_plan(tmp_path) -> None:
    (tmp_path / "plan.json").write_text("[" * 200_000)
    with pytest.raises(InputError, match="cannot be read"):
        read_plan(tmp_path)


def test_a_stop_tells_which_bead_was_begun_and_how_to_go_on() -> None:
    """A robot that is where it is asked to be, and stops 0.1 or 0.4 s after it began; bead 8 begins 0.16 s into the plan."""

    class Wire:
        def __init__(self, stops: int) -> None:
            self.at, self.heard, self.stops = bow().q[0], 0, stops
            self.remarks: list[str] = []

        def newest(self) -> EgmState:
            self.heard += 1
            return EgmState(self.at.copy(), self.heard < self.stops, self.heard * PERIOD)

        def send(self, reference: np.ndarray) -> None:
            self.at = reference

    plan = replace(bow(), bead=np.where(np.arange(len(bow().q)) < 40, 7, 8))
    for stops, bead in ((30, 7), (100, 8)):
        told: list[str] = []
        with pytest.raises(EgmStopped, match="the controller has stopped"):
            egm.follow(plan, Wire(stops), told.append, planned=GoingOn("my.yaml", " --strategy sqp"))
        assert told[-2:] == [
            f"bead {bead} or the way to it was begun: check whether the bead before it is complete",
            f"to go on: python -m planner.solve my.yaml --from-bead {bead} --strategy sqp",
        ]
    assert [plan.begun(sample) for sample in (0.0, 39.9, 40.0)] == [7, 7, 8]
    assert replace(plan, bead=np.full(len(plan.q), NO_BEAD)).begun(3.0) is bow().begun(3.0) is None


# ---- on the wire --------------------------------------------------------------------------------------------------


@cache
def short() -> JointPlan:
    """Six axes that swing for 0.8 s."""
    t = np.arange(0.0, 0.8 + PERIOD / 2, PERIOD)
    q = 0.1 * (1.0 - np.cos(2.0 * np.pi * t / 0.8))[:, None] * np.array([1.0, -1.0, 0.5, 0.2, -0.3, 1.5])
    return JointPlan(q, np.full(6, 3.0), np.full(6, 20.0))


def wired(faults: tuple[str, ...] = (), say=lambda text: None, beside=None) -> tuple[np.ndarray, EgmRobot]:
    """References that a robot got; beside(address) may be somebody else who sends to the same port."""
    with egm_wire("127.0.0.1", 0) as wire, ExitStack() as stack:
        address = ("127.0.0.1", wire.port)
        if beside is not None:
            stack.enter_context(beside(address))
        robot = EgmRobot(address, np.degrees(short().q[0]), 4.0, faults_of(faults, EGM_FAULTS))
        with closing(robot):
            egm.follow(short(), wire, say)
    return robot.references() * DEGREES, robot


def test_a_robot_is_guided_through_a_plan() -> None:
    references, robot = wired()
    # in real time a message may come late, and the robot then starts again from rest
    assert (np.abs(np.diff(references, axis=0)) <= 3.000001 * PERIOD).all()
    assert references[:, 5].max() == pytest.approx(short().q[:, 5].max(), abs=2e-3)
    np.testing.assert_allclose(robot.joints() * DEGREES, short().q[-1], atol=0.2 * DEGREES)


@pytest.mark.slow(keep=2)
@pytest.mark.parametrize(
    ("fault", "reason"),
    [
        ("mute@60", "said nothing for 0.5 s"),
        ("stop@60", "has stopped"),
        ("stray@60:3", "axis 1 is .* away"),
        (" ".join(f"garbage@{k}" for k in range(60, 900)), "said nothing for 0.5 s"),
    ],
    ids=["mute", "stop", "stray", "garbage"],
)
def test_faults_of_the_robot_stop_it(fault: str, reason: str) -> None:
    with pytest.raises(EgmStopped, match=reason):
        wired(tuple(fault.split()))


@pytest.mark.parametrize("at", [(1, 2, 3), (60,), (60, 61, 90)])
def test_garbage_is_survived_and_told(at: tuple[int, ...]) -> None:
    """Before the first message, and in the middle of the motion."""
    said: list[str] = []
    references, robot = wired(tuple(f"garbage@{k}" for k in at), said.append)
    np.testing.assert_allclose(robot.joints() * DEGREES, short().q[-1], atol=0.2 * DEGREES)
    assert (np.abs(np.diff(references, axis=0)) <= 3.000001 * PERIOD).all()
    assert sum("sent something that is not an EGM message of a controller" in text for text in said) == 1


@contextmanager
def stranger(address: tuple[str, int], datagrams: Callable[[int], bytes]) -> Iterator[list[bytes]]:
    """Somebody else who sends as fast as possible; what comes back."""
    over, back = threading.Event(), []

    def send() -> None:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as here:
            here.setblocking(False)
            for k in range(200_000):
                with suppress(BlockingIOError):
                    here.sendto(datagrams(k), address)
                with suppress(OSError):
                    back.append(here.recv(4096))
                if over.wait(0.0005):
                    return

    thread = threading.Thread(target=send, daemon=True)
    thread.start()
    yield back
    over.set()
    thread.join()


def message(joints: Sequence[float], number: int = 1, kind: int = 2) -> bytes:
    """What a controller sends: joints [deg], running."""
    m = egm_wire_module.egm_messages()
    made = m.EgmRobot()
    made.header.seqno, made.header.tm, made.header.mtype = number, number * 4, kind
    made.feedBack.joints.joints.extend(joints[:6])
    made.motorState.state, made.mciState.state = m.EgmMotorState.MOTORS_ON, m.EgmMCIState.MCI_RUNNING
    made.rapidExecState.state = m.EgmRapidCtrlExecState.RAPID_RUNNING
    return bytes(made.SerializeToString())


@pytest.mark.parametrize("kind", ["garbage", "empty", "correction"])
def test_a_stranger_who_floods_is_no_peer(kind: str) -> None:
    """He was there first, and sends eight times as often as the controller; he gets no reference."""
    data = {"garbage": b"\xff\xfe\x00", "empty": b"", "correction": message([90.0] * 6, kind=3)}[kind]
    heard: list[list[bytes]] = []

    @contextmanager
    def beside(address: tuple[str, int]) -> Iterator[None]:
        with stranger(address, lambda k: data) as back:
            heard.append(back)
            time.sleep(0.05)
            yield

    references, robot = wired(beside=beside)
    np.testing.assert_allclose(robot.joints() * DEGREES, short().q[-1], atol=0.2 * DEGREES)
    assert (np.abs(np.diff(references, axis=0)) <= 3.000001 * PERIOD).all() and heard == [[]]


def sent(wire: EgmWire, *each: tuple[socket.socket, bytes]) -> EgmState | None:
    """What a wire takes of datagrams that came one after the other."""
    for source, data in each:
        source.sendto(data, ("127.0.0.1", wire.port))
    return wire.newest()


def test_who_spoke_first_is_heard_alone_until_it_is_gone() -> None:
    with egm_wire("127.0.0.1", 0) as wire, ExitStack() as stack:
        robot, other = (stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) for _ in range(2))
        assert sent(wire, (other, b""), (other, b"\x00")) is None
        state = sent(wire, (robot, message([1.0] * 6)), (other, message([2.0] * 6, 2)))
        assert state is not None and state.joints[0] == pytest.approx(DEGREES) and state.running
        assert sent(wire, (other, message([2.0] * 6, 3))) is None
        wire.send(np.zeros(6))
        assert robot.recv(4096)
        assert len(wire.remarks) == 2 and "it is not the controller" in wire.remarks[1]
        # what was overtaken on its way would be a step back
        state = sent(wire, (robot, message([4.0] * 6, 9)), (robot, message([3.0] * 6, 8)))
        assert state is not None and state.joints[0] == pytest.approx(4.0 * DEGREES)
        assert sent(wire, (robot, message([3.0] * 6, 7))) is None
        wire.release()
        assert sent(wire, (other, message([2.0] * 6, 1))) is not None


def test_a_controller_that_is_named_is_heard_alone() -> None:
    with egm_wire("127.0.0.1", 0, "127.0.0.2") as wire, ExitStack() as stack:
        robot, other = (stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) for _ in range(2))
        try:
            robot.bind(("127.0.0.2", 0))
        except OSError:
            pytest.skip("this system has one loopback address only")
        assert sent(wire, (other, message([2.0] * 6))) is None
        assert sent(wire, (robot, message([1.0] * 6))) is not None
    with pytest.raises(InputError, match="there is no host"), egm_wire("127.0.0.1", 0, "no host"):
        pass


@settings(max_examples=200, deadline=None)
@given(st.binary(max_size=200))
def test_no_datagram_ends_in_a_traceback(data: bytes) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as here:
        found = EgmWire(here, egm_wire_module.egm_messages())._state(data)
    if found is not None and found[0] is not None:
        assert len(found[0].joints) > 0


def test_the_simulated_robot_follows_its_partner_alone() -> None:
    """Neither garbage of the partner nor references of somebody else end or move it."""
    with (
        egm_wire("127.0.0.1", 0) as wire,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other,
        closing(EgmRobot(("127.0.0.1", wire.port), [0.0] * 6)) as robot,
    ):
        assert wire.newest() is not None and wire._peer is not None
        other.sendto(wire._correction(np.ones(6)), wire._peer)
        wire._here.sendto(b"\xff\xfe", wire._peer)
        wire.send(np.full(6, 0.1))
        end = time.monotonic() + 2.0
        while not len(robot.references()) and time.monotonic() < end:
            time.sleep(0.005)
        np.testing.assert_allclose(robot.references() * DEGREES, np.full((1, 6), 0.1))


def test_a_gap_on_the_wire_is_survived() -> None:
    references, _ = wired(("gap@80:10",))
    speed = np.abs(np.diff(references, axis=0)).max(axis=1) / PERIOD
    assert (speed <= 3.000001).all() and references[:, 5].max() > 0.29


def test_an_interrupt_brings_it_to_rest() -> None:
    def interrupt(text: str) -> None:
        if not text.startswith("0.0"):
            raise KeyboardInterrupt

    with (
        egm_wire("127.0.0.1", 0) as wire,
        closing(EgmRobot(("127.0.0.1", wire.port), np.degrees(short().q[0]), 4.0)) as robot,
    ):
        with pytest.raises(KeyboardInterrupt):
            egm.follow(short(), wire, interrupt)
        while not robot.reason:  # takes what is still on its way, until nothing comes any more
            time.sleep(0.01)
        references = robot.references() * DEGREES
    steps = np.abs(np.diff(references, axis=0))
    assert (steps <= 3.000001 * PERIOD).all() and steps[-1].max() < 1e-5 and len(references) < 150


def test_an_interrupt_before_the_first_word_ends_it_at_once(monkeypatch) -> None:
    def interrupt(wire):
        monkeypatch.setattr(EgmWire, "newest", lambda wire: pytest.fail("waits for a robot that was never guided"))
        raise KeyboardInterrupt

    monkeypatch.setattr(EgmWire, "newest", interrupt)
    with egm_wire("127.0.0.1", 0) as wire, pytest.raises(KeyboardInterrupt):
        egm.follow(short(), wire, lambda text: None)


def test_without_the_package_it_is_said_which_one(tmp_path, monkeypatch, capsys) -> None:
    real = builtins.__import__

    def none(name: str, *rest: object) -> object:
        if name.startswith("abb_robot_client"):
            raise ModuleNotFoundError(name, name=name)
        return real(name, *rest)

    monkeypatch.setattr(builtins, "__import__", none)
    assert egm.main([str(tmp_path)]) == 2
    assert "pip install 'beadwise[link]'" in capsys.readouterr().err


def test_the_command_says_what_is_wrong(tmp_path, capsys) -> None:
    assert egm.main([str(tmp_path)]) == 2 and "no plan here" in capsys.readouterr().err
    folder_of(make_plan(), tmp_path)
    assert egm.main([str(tmp_path), "--port", "70000"]) == 2 and "cannot listen" in capsys.readouterr().err


def test_the_command_listens_for_a_terminal_that_closes(tmp_path, monkeypatch) -> None:
    handlers = []
    monkeypatch.setattr(egm, "follow", lambda *_: handlers.append(signal.getsignal(signal.SIGHUP)))
    folder_of(make_plan(), tmp_path)
    before = signal.signal(signal.SIGHUP, signal.SIG_DFL)
    assert egm.main([str(tmp_path), "--port", "0"]) == 0
    assert signal.signal(signal.SIGHUP, before) is signal.SIG_DFL
    assert callable(handlers[0])


# ---- with the extruder ----------------------------------------------------------------------------------------------


def with_filament(plan: JointPlan) -> JointPlan:
    """Three millimetres a second from 0.2 s on, a rest, and on again."""
    t = PERIOD * np.arange(len(plan.q))
    rate = np.where((t > 0.2) & ((t < 0.4) | (t > 0.5)), 3.0, 0.0)
    return replace(plan, filament=np.concatenate([[0.0], np.cumsum(rate[1:]) * PERIOD]))


def moved_by(lines: list[str]) -> list[float]:
    return [float(line.split()[1][1:]) for line in lines if line.startswith("G1")]


@pytest.mark.parametrize("lag", [0.0101, 0.03, 0.08])
def test_filament_is_due_when_the_robot_is_there(lag: float) -> None:
    """Whatever the robot's lag, which nobody is told: a slice is handed over as its start is reached, and all of it in sum."""
    plan = with_filament(bow())
    follower, at, feed = Follower(plan), plan.q[0].copy(), Feed()
    filament, handed = FilamentFeed(plan.filament, feed), []
    outwards = plan.q[: len(plan.q) // 2, 0]
    for k in range(1000):
        reference = follower.answer(EgmState(at.copy(), True, k * PERIOD))
        filament.step(follower.robot)
        # where the robot truly is along the plan, until it turns back
        handed += [float(np.interp(at[0], outwards, np.arange(len(outwards)))) for line in feed._waiting if "E" in line]
        feed._waiting.clear()
        at += (1.0 - np.exp(-PERIOD / lag)) * (reference - at)
        if follower.over:
            break
    assert follower.over and len(plan.q) - 1 - follower.robot < 10
    starts = SLICE * np.array([2, 3, 5])  # of the slices with filament on the way out
    assert np.abs(np.array(handed[:3]) - (starts - LEAD)).max() <= 2.5  # samples of 4 ms


def test_all_filament_arrives_and_no_more() -> None:
    plan = with_filament(bow())
    feed = Feed()
    filament, lines = FilamentFeed(plan.filament, feed), []
    for sample in np.arange(0.0, len(plan.q), 0.5):
        filament.step(sample)
        lines += list(feed._waiting)
        feed._waiting.clear()
    assert lines[:2] == ["M83", "T0"] and sum(moved_by(lines)) == pytest.approx(plan.filament[-1], abs=1e-5)
    rates = [float(line.split()[2][1:]) for line in lines[2:]]
    assert max(rates) == pytest.approx(180.0, rel=1e-3)  # 3 mm/s
    with pytest.raises(FeedStopped, match="lines behind the robot"):
        FilamentFeed(plan.filament, Feed()).step(len(plan.q))


def test_filament_of_a_plan_is_read(tmp_path) -> None:
    plan = make_plan()
    read = read_plan(folder_of(plan, tmp_path))
    np.testing.assert_allclose(read.filament, 1e3 * plan.trajectory.feed, atol=1e-5)
    t = plan.trajectory
    first = [int(np.argmax(t.bead == k)) for k in (0, 1)]
    assert (read.bead[: first[0] + 1] == 0).all() and read.bead[first[1] - 1] in (0, 1) and read.bead[-1] == NO_BEAD
    np.testing.assert_array_equal(read.bead[t.bead >= 0], t.bead[t.bead >= 0])
    every = slice(0, None, 2)
    coarse = {k: v[every] for k, v in vars(plan.trajectory).items() if isinstance(v, np.ndarray)}
    again = read_plan(folder_of(replace(plan, trajectory=replace(plan.trajectory, dt=0.008, **coarse)), tmp_path))
    assert (np.diff(again.filament) >= 0.0).all() and again.filament[-1] == pytest.approx(read.filament[-1], abs=1e-3)
    assert len(again.bead) == len(again.q) and set(again.bead.tolist()) == {0, 1, NO_BEAD}


def test_the_tool_is_that_of_the_material(tmp_path) -> None:
    assert filament_tool(folder_of(make_plan(), tmp_path)) == 0
    assert filament_tool(folder_of(make_plan(beads=1, materials=("pla", "pva")), tmp_path)) == 1


@pytest.mark.parametrize(
    ("plan", "reason"),
    [
        (lambda: make_plan(materials=("pla", "pva")), "2 materials are laid in this print"),
        (socket_plan, "fibre is cut in this print"),
    ],
)
def test_what_is_more_than_filament_of_one_tool_is_refused(plan, reason: str, tmp_path, capsys) -> None:
    folder_of(plan(), tmp_path)
    assert egm.main([str(tmp_path), "--port", "0", "--head", "127.0.0.1:1"]) == 2
    assert reason in capsys.readouterr().err


def fed(board_faults: tuple[str, ...] = (), robot_faults: tuple[str, ...] = ()) -> tuple[list[str], list[str | None]]:
    """Lines that the board carried out, with a number and without."""
    plan = with_filament(short())
    accepted: list[tuple[int | None, str]] = []
    with (
        closing(BoardServer("127.0.0.1", 0, 1.0, faults_of(board_faults, BOARD_FAULTS))) as board,
        egm_wire("127.0.0.1", 0) as wire,
    ):
        try:
            with feeding(Address(*board.address)) as feed:
                start = np.degrees(plan.q[0])
                address = ("127.0.0.1", wire.port)
                with closing(EgmRobot(address, start, 1.0, faults_of(robot_faults, EGM_FAULTS))):
                    egm.follow(plan, wire, lambda text: None, feed)
                feed.finish()
        finally:
            time.sleep(0.1)
            accepted += board.record().accepted
            fed.accepted = accepted  # type: ignore[attr-defined]
    return [g for n, g in accepted if n is not None], [g for n, g in accepted if n is None]


@pytest.mark.slow
def test_robot_and_extruder_are_guided_together() -> None:
    numbered, plain = fed()
    assert numbered[:2] == ["M83", "T0"] and sum(moved_by(numbered)) == pytest.approx(
        with_filament(short()).filament[-1], abs=1e-5
    )
    assert "M106 P0 S0" not in plain


@pytest.mark.slow
@pytest.mark.parametrize(
    ("board", "robot", "error", "words"),
    [
        (("error@3",), (), FeedStopped, "the board reports"),
        (("clog@3",), (), FeedStopped, "the board reports"),
        (("drop@3",), (), FeedStopped, "the board closed the connection"),
        ((), ("mute@90",), EgmStopped, "said nothing for 0.5 s"),
        ((), ("stop@90",), EgmStopped, "has stopped"),
    ],
)
def test_either_that_fails_stops_the_other(board, robot, error, words) -> None:
    with pytest.raises(error, match=words):
        fed(board, robot)
    accepted = fed.accepted  # type: ignore[attr-defined]
    pushed = sum(moved_by([g for n, g in accepted if n is not None]))
    assert pushed < with_filament(short()).filament[-1] - 0.2
    if robot:
        assert accepted[-1] == (None, "M106 P0 S0")


def test_the_command_refuses_a_wrong_board(tmp_path, capsys) -> None:
    folder_of(make_plan(), tmp_path)
    for words in (["--head", "a b"], ["--head", "127.0.0.1:1"]):
        assert egm.main([str(tmp_path), "--port", "0", *words]) in (2, 3)
    assert "--head" in capsys.readouterr().err
