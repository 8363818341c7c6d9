"""Sends a plan's joints to a controller every 4 ms by externally guided motion (EGM), and its filament to the board."""

from __future__ import annotations

import argparse
import math
import sys
import time
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.interpolate import CubicSpline

from planner.base.arrays import Array, Indices
from planner.base.command_line import Command, exit_code
from planner.base.errors import EXIT_NOT_VERIFIED, EXIT_VERIFIED, InputError, PlannerError
from planner.base.signals import hangups_interrupt
from planner.link.as_written import PLAN, add_edited, read_json, table_as_written, within_limits
from planner.link.connections import given_address
from planner.link.egm_wire import ARM_AXES, EgmState, EgmWire, egm_messages, egm_wire
from planner.link.feed import BoardFeed, Feed, FeedStopped, feeding
from planner.link.program_lines import NO_BEAD
from planner.link.telling import GoingOn, begun_words, going_on

# ----------------------------------------------------------------------------------------------------
# Limiter: however goals jump, no step exceeds the joints' speed and acceleration.

CATCHING_UP = 0.5  # share of the acceleration used for braking when a reference catches up with its goal


class Limiter:
    """References (m) every `period` [s]. Goals that keep the limits themselves come out unchanged.

    A reference catches up with its goal as quickly as allowed, without overshooting: its speed towards the goal is what
    can still be braked. An axis whose limits are 0 never moves.
    """

    def __init__(self, at: Array, velocity: Array, acceleration: Array, period: float) -> None:
        self.at, self.speed = np.array(at, np.float64), np.zeros(len(at))
        self._goal = self.at.copy()
        self._velocity, self._acceleration, self._period = velocity, acceleration, period

    def stopped(self) -> None:
        """The robot received no references and stands."""
        self.speed = np.zeros_like(self.speed)

    def next(self, goal: Array) -> Array:
        """The next reference, towards a goal for the same instant."""
        behind = self._goal - self.at
        moving = (goal - self._goal) / self._period
        brake = CATCHING_UP * self._acceleration
        # the greatest speed from which braking in whole steps ends within the remaining distance
        tick = brake * self._period
        most = np.sqrt(0.25 * tick * tick + 2.0 * brake * np.abs(behind)) - 0.5 * tick
        closing = np.sign(behind) * np.minimum(np.abs(behind) / self._period, most)
        change = self._acceleration * self._period
        wanted = np.clip(moving + closing, self.speed - change, self.speed + change)
        self.speed = np.clip(wanted, -self._velocity, self._velocity)
        self.at = self.at + self.speed * self._period
        self._goal = np.array(goal, np.float64)
        return self.at


# ----------------------------------------------------------------------------------------------------
# The joints of a plan over time, read from its folder.

PERIOD = 0.004  # s, of EGM
MOST_EXTERNAL = 6
COUNTS = {"controller_sign": 1.0, "controller_offset": 0.0}  # of a joint that the controller counts like the plan
LARGEST_TABLE = 2 << 30  # bytes
LONGEST_STEP = 0.02  # s between samples of a plan
UNEVEN = 1e-6  # s by which steps of a table may differ because of rounding


@dataclass(frozen=True)
class JointPlan:
    """Joints at EGM's rate (n samples): six of the arm, then all axes of the station in its own order.

    q (n, m) [rad], as the controller counts them
    velocity, acceleration (m) limits [rad/s, rad/s²], 0 for an axis that is held
    filament (n,) pushed by the motor since the start [mm], the board's own unit; None if not needed
    bead (n,) that is being laid, or approached in travel; NO_BEAD after the last one; None if not needed
    """

    q: Array
    velocity: Array
    acceleration: Array
    filament: Array | None = None
    bead: Indices | None = None

    def begun(self, sample: float) -> int | None:
        """The bead that the robot lays, or approaches in travel, at a sample; None after the last, or if unknown."""
        bead = NO_BEAD if self.bead is None else int(self.bead[int(sample)])
        return None if bead == NO_BEAD else bead


def read_plan(folder: Path) -> JointPlan:
    """Read the joints from a results folder. Raises InputError if they are missing, damaged, or of an unusable arm."""
    path = folder / PLAN
    data = read_json(path)
    try:
        if data["verified"] is not True:
            raise InputError("the plan is not verified", file=path)
        cell, joints = data["cell"], data["cell"]["joints"]
        names = [str(joint["name"]) for joint in joints]
        arm = [str(joint["name"]) for joint in joints if joint["moves"] == "nozzle"]
        limits = {str(joint["name"]): (float(joint["v_max"]), float(joint["a_max"])) for joint in joints}
        axes = [(str(axis["name"]), axis["held_at"]) for axis in cell["holder_axes"]]
        second_arm = bool(cell.get("holder_is_arm", len(axes) == ARM_AXES))  # older files do not state it
        # an axis with the name of an arm joint gets the same prefix as its column and joint
        holder = {f"positioner_{name}" if name in arm else name: held for name, held in axes}
        held = {name: float(angle) for name, angle in holder.items() if angle is not None}
        counts = [[float(joint.get(key, usual)) for key, usual in COUNTS.items()] for joint in joints[: len(arm)]]
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(f"not a plan of this version: {error}", file=path, hint="solve the problem again") from error
    if second_arm:  # its joints belong to another robot, and are no external axes of this one
        if len(held) < len(holder):
            raise InputError("a second arm moves the part, but EGM guides only one", file=path)
        holder = held = {}
    if len(arm) != ARM_AXES or len(holder) > MOST_EXTERNAL:
        raise InputError(f"EGM guides arms of {ARM_AXES} axes, with up to {MOST_EXTERNAL} external axes", file=path)
    if any(joint.get("type") == "prismatic" for joint in data["cell"]["joints"]):
        raise InputError("guided motion cannot move axes that slide", file=path)
    if any(not 0.0 < value < math.inf for pair in limits.values() for value in pair):
        raise InputError("a limit is not a positive number", file=path)
    moved, filament, bead = _table(folder / "trajectory.csv", names)
    order = [*arm, *holder]
    columns = [np.full(len(moved), held[name]) if name in held else moved[:, names.index(name)] for name in order]
    q, (sign, offset) = np.column_stack(columns), np.transpose(counts)
    q[:, :ARM_AXES] = sign * q[:, :ARM_AXES] + offset
    if not np.isfinite(q).all():
        raise InputError("an angle is not a number", file=path)
    both = np.array([limits.get(name, (0.0, 0.0)) for name in order])
    return JointPlan(q, both[:, 0], both[:, 1], filament, bead)


def filament_tool(folder: Path) -> int:
    """Number of the tool that lays the whole plan in a folder; 0 if its material has no name.

    Raises InputError if several materials are laid, or fibre is cut: only filament is sent, and only for one tool.
    """
    path = folder / PLAN
    data = read_json(path)
    try:
        tools = [int(material["tool"]) for material in data.get("materials", []) if material["beads"]]
        is_cut = any(event["kind"] == "cut" for event in data["events"])
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(f"not a plan of this version: {error}", file=path, hint="solve the problem again") from error
    if is_cut or len(tools) > 1:
        reason = "fibre is cut in this print" if is_cut else f"{len(tools)} materials are laid in this print"
        hint = "python -m planner.link or planner.link.stream, which give the board all of its lines"
        raise InputError(f"{reason}, but the board gets the filament of one tool only", field="--head", hint=hint)
    return tools[0] if tools else 0


def _table(path: Path, names: list[str]) -> tuple[Array, Array, Indices]:
    """The named columns at EGM's rate (n, k), the filament (n), and the current or next bead (n)."""
    try:
        if path.stat().st_size > LARGEST_TABLE:
            raise InputError(f"larger than {LARGEST_TABLE >> 20} MB", file=path)
        with path.open(encoding="ascii") as stream:
            head = stream.readline().strip().split(",")
            wanted = ("t_s", "bead", *names, "e_mm")
            missing = [name for name in wanted if name not in head]
            if missing:
                raise InputError(f"no column {missing[0]!r}", file=path, line=1)
            columns = [head.index(name) for name in wanted]
            rows = np.loadtxt(stream, delimiter=",", usecols=columns, ndmin=2)
    except (OSError, ValueError) as error:
        raise InputError(f"cannot be read: {error}", file=path) from error
    steps = np.diff(rows[:, 0])
    if len(rows) < 4 or not np.isfinite(rows).all() or steps.min() <= 0.0 or np.ptp(steps[:-1]) > 2 * UNEVEN:
        raise InputError("not a trajectory with even steps", file=path)
    if steps.max() > LONGEST_STEP + UNEVEN:
        raise InputError(f"steps of {steps.max():g} s, but no plan has more than {LONGEST_STEP:g} s", file=path, line=3)
    t, bead, joints, filament = rows[:, 0], _coming(rows[:, 1]), rows[:, 2:-1], rows[:, -1]
    if abs(steps[0] - PERIOD) < UNEVEN:
        return joints, filament, bead
    instants = np.minimum(np.arange(0.0, t[-1] + PERIOD, PERIOD), t[-1])
    nearest = np.minimum(np.searchsorted(t, instants), len(t) - 1)
    return np.asarray(CubicSpline(t, joints)(instants)), np.interp(instants, t, filament), bead[nearest]


def _coming(bead: Array) -> Indices:
    """The bead (n) that is laid at each sample, or else the next one; NO_BEAD after the last."""
    laid = np.flatnonzero(bead != NO_BEAD)
    following = np.searchsorted(laid, np.arange(len(bead)))
    return np.asarray(np.append(bead[laid], NO_BEAD)[following], dtype=np.intp)


# ----------------------------------------------------------------------------------------------------
# The follower, without a network: states of the controller in, joint references out.

NEAR_START = np.radians(1.0)  # greatest distance of the robot from the plan's start before the first reference
DEVIATION = np.radians(2.0)  # greatest deviation of the robot from all references of the last LAG
LAG = 0.3  # s: greatest delay of the robot behind its references
RAMP = 0.2  # s in which the plan's time accelerates to its full rate, or comes to rest
SILENCE = 0.5  # s without a message from the controller
SETTLED = np.radians(0.1)  # of the last reference
STANDING = 1e-6  # rad/s
SETTLING = 2.0  # s in which the robot must reach the last reference
GAP = 2.5  # periods between two messages: after more, the robot is assumed to have stopped


class EgmStopped(PlannerError):
    """The motion has ended early; states why and where."""

    exit_code = EXIT_NOT_VERIFIED


class Follower:
    """Answers each message from the controller with the next reference. The plan's time advances only with the answers.

    sample, total   of the plan, at EGM's rate; `over` once the robot stands at the last one
    robot           sample that the robot itself has reached, as it lags behind its references
    """

    def __init__(self, plan: JointPlan) -> None:
        self._plan, self.total, self.over, self.robot = plan, len(plan.q), False, 0.0
        self._place, self._rate, self._stopping = 0.0, 0.0, False
        self._limiter: Limiter | None = None
        self._sent: deque[Array] = deque(maxlen=round(LAG / PERIOD))
        self._places: deque[float] = deque(maxlen=round(LAG / PERIOD))
        self._clock, self._settling = 0.0, 0.0

    @property
    def sample(self) -> int:
        """Sample of the plan that the references have reached."""
        return int(self._place)

    @property
    def begun(self) -> bool:
        """Whether references have been sent."""
        return self._limiter is not None

    def stop(self) -> None:
        """Come to rest on the path; `over` once the references stand, or at once if none was sent."""
        self._stopping, self.over = True, not self.begun

    def answer(self, state: EgmState) -> Array | None:
        """The reference (m) [rad] in answer to a message; None if there is none yet.

        Raises EgmStopped if the robot is not where it should be, or has stopped.
        """
        if len(state.joints) != self._plan.q.shape[1]:
            raise EgmStopped(f"the controller has {len(state.joints)} axes, the plan {self._plan.q.shape[1]}")
        if not np.isfinite(state.joints).all():
            raise self._ended("the controller sent joints that are not numbers")
        if self._limiter is None:
            return self._begin(state)
        if not state.running:
            raise self._ended("the controller has stopped")
        self._watch(state.joints)
        gap, self._clock = state.clock - self._clock, state.clock
        if not 0.0 <= gap <= GAP * PERIOD:
            self._rate = 0.0
            self._limiter.stopped()
        step = PERIOD / RAMP
        self._rate = max(0.0, self._rate - step) if self._stopping else min(1.0, self._rate + step)
        self._place = min(self._place + self._rate, self.total - 1.0)
        reference = self._limiter.next(self._at(self._place))
        self._sent.append(reference)
        self._places.append(self._place)
        self._finish(state.joints)
        return reference

    def _begin(self, state: EgmState) -> Array | None:
        away = np.abs(state.joints - self._plan.q[0])
        if not state.running:
            return None
        if away.max() > NEAR_START:
            worst = int(away.argmax())
            far = np.degrees(away[worst])
            raise EgmStopped(f"axis {worst + 1} stands {far:.2f} degrees from the plan's start")
        self._limiter = Limiter(state.joints, self._plan.velocity, self._plan.acceleration, PERIOD)
        self._clock = state.clock
        self._sent.append(self._limiter.at)
        self._places.append(0.0)
        return self._limiter.at

    def _watch(self, joints: Array) -> None:
        sent = np.array(self._sent)
        # the newest of the nearest references: if several are equal, the references stand, and so does the robot
        nearest = len(sent) - 1 - int(np.abs(sent[::-1] - joints).max(axis=1).argmin())
        self.robot = max(self.robot, self._places[nearest])
        low, high = sent.min(axis=0), sent.max(axis=0)
        away = np.maximum(low - joints, joints - high)
        if away.max() > DEVIATION:
            worst = int(away.argmax())
            far = np.degrees(away[worst])
            raise self._ended(f"axis {worst + 1} is {far:.1f} degrees away from all references of the last {LAG:g} s")

    def _at(self, place: float) -> Array:
        k = min(int(place), self.total - 2)
        share = place - k
        return (1.0 - share) * self._plan.q[k] + share * self._plan.q[k + 1]

    def _finish(self, joints: Array) -> None:
        if self._limiter is None:
            return
        if self._stopping:
            self._settling += PERIOD
            stands = self._rate == 0.0 and float(np.abs(self._limiter.speed).max()) < STANDING
            self.over = stands or self._settling > SETTLING
        elif self._place >= self.total - 1.0:
            self._settling += PERIOD
            self.over = float(np.abs(joints - self._plan.q[-1]).max()) < SETTLED
            if not self.over and self._settling > SETTLING:
                raise self._ended("the robot does not reach the last reference")

    def _ended(self, reason: str) -> EgmStopped:
        return EgmStopped(f"{reason}, {self.sample * PERIOD:.2f} s of {(self.total - 1) * PERIOD:.2f} s into the plan")


# ----------------------------------------------------------------------------------------------------
# The filament, in time with the robot: short extruder moves, each sent when the robot reaches its place.

SLICE = 25  # samples per extruder move: 0.1 s, so that little is left in the board's queue when the robot stops
LEAD = 5  # samples by which a move is sent early, to allow for the delays of network and board
MOST_SLICES = 5  # lines by which the board may lag behind
LEAST = 1e-5  # mm, the last digit that is written


class FilamentFeed:
    """Hands a plan's filament to a feed as the robot advances. One extruder, already hot."""

    def __init__(self, filament: Array, feed: Feed, tool: int = 0) -> None:
        """filament (n,): pushed since the start [mm], at EGM's rate; tool: the number of the tool that pushes it."""
        self._filament, self._feed = filament, feed
        self._next, self._said = 0, float(filament[0])
        feed.add("M83")
        feed.add(f"T{tool}")  # RepRapFirmware refuses to extrude without a selected tool

    def step(self, robot: float) -> None:
        """Feed up to the robot's sample. Raises FeedStopped if the board lags behind."""
        last = len(self._filament) - 1
        while self._next < last and self._next <= robot + LEAD:
            end = min(self._next + SLICE, last)
            amount = round(float(self._filament[end]) - self._said, 5)
            if abs(amount) >= LEAST:
                rate = 60.0 * abs(amount) / ((end - self._next) * PERIOD)
                self._feed.add(f"G1 E{amount:.5f} F{rate:.3f}")
                self._said += amount
            self._next = end
        if self._feed.behind > MOST_SLICES:
            raise FeedStopped(f"the board is {self._feed.behind} lines behind the robot")


# ----------------------------------------------------------------------------------------------------
# The command.
#
# python -m planner.link.egm OUT_DIR

HOST, PORT = "127.0.0.1", 6510  # ABB's port
JOINING = 120.0  # s in which the controller's first message must come
REPORT_EVERY = 0.1  # share of the plan
BOARD_PORT = 23  # telnet
MOST_TOOL = 99  # number of a tool, as in program.board.tools


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit code."""
    options = egm_command().parse_args(arguments)

    def say(text: str) -> None:
        print(text, file=sys.stderr, flush=True)

    return exit_code(lambda: _run(options, say), say, "the robot was brought to rest")


def egm_command() -> Command:
    """The parser of `python -m planner.link.egm`."""
    parser = Command(
        "link.egm",
        "Answer a controller's EGM messages with the joints of a plan, 250 times a second.",
        {"out/my_part --host 192.168.125.2 --controller 192.168.125.1": "wait there for the controller, then guide it"},
        {0: "finished", 2: "wrong input", 3: "stopped before the end", 130: "interrupted"},
    )
    parser.add_argument("folder", type=Path, metavar="OUT_DIR", help="results of planner.solve")
    parser.add_argument("--host", default=HOST, help=f"own address that the controller sends to (default {HOST})")
    parser.add_argument("--port", type=int, default=PORT, help=f"own UDP port (default {PORT})")
    parser.add_argument(
        "--controller", metavar="HOST", help="listen to this address only (default: the first that sends)"
    )
    parser.add_argument("--head", metavar="HOST[:PORT]", help="the extruder's board, which gets the filament (port 23)")
    parser.add_argument(
        "--tool", type=_tool, metavar="N", help="number of its tool (default: that of the plan's material, or 0)"
    )
    add_edited(parser)
    return parser


def _tool(text: str) -> int:
    if not (text.isascii() and text.isdigit()) or int(text) > MOST_TOOL:
        raise argparse.ArgumentTypeError(f"{text!r} is not the number of a tool, 0 to {MOST_TOOL}")
    return int(text)


def _run(options: argparse.Namespace, say: Callable[[str], None]) -> int:
    egm_messages()  # before a large plan is read
    cell = table_as_written(options.folder, options.edited, say)
    plan = read_plan(options.folder)
    if cell is not None:
        within_limits(cell.as_counted, plan.q[:, plan.velocity > 0.0], PERIOD, say)
    tool = 0 if options.head is None else filament_tool(options.folder)
    planned = going_on(read_json(options.folder / PLAN), "PROBLEM")
    with hangups_interrupt(), egm_wire(options.host, options.port, options.controller) as wire:
        say(f"waiting for {options.controller or 'the controller'} on {options.host}:{wire.port} (UDP)")
        if options.head is None:
            follow(plan, wire, say, None, tool, planned)
        else:
            with feeding(given_address(options.head, BOARD_PORT, "--head")) as board:
                follow(plan, wire, say, board, tool if options.tool is None else options.tool, planned)
                board.finish()
    say("finished")
    return EXIT_VERIFIED


def follow(
    plan: JointPlan,
    wire: EgmWire,
    say: Callable[[str], None],
    board: BoardFeed | None = None,
    tool: int = 0,
    planned: GoingOn | None = None,
) -> Follower:
    """Guide the robot through the plan, and send its filament to the board's tool of this number.

    Raises EgmStopped if it ends early. An interrupt brings the robot to rest, and so does the board's FeedStopped.
    `say` then reports the bead that was begun, and how to resume from it.
    """
    follower, extruder = Follower(plan), None if board is None else _Extruder(plan, board, tool)
    try:
        _guide(follower, wire, say, extruder)
    except (EgmStopped, FeedStopped, KeyboardInterrupt):
        if follower.begun and (bead := plan.begun(follower.robot)) is not None:
            for text in begun_words(bead, planned):
                say(text)
        raise
    return follower


def _guide(follower: Follower, wire: EgmWire, say: Callable[[str], None], extruder: _Extruder | None) -> None:
    try:
        _loop(follower, wire, say, extruder)
        if extruder is not None:
            extruder.step(follower.total, begun=True)
    except (KeyboardInterrupt, FeedStopped):
        follower.stop()
        _loop(follower, wire, lambda text: None)
        raise


class _Extruder:
    """Feeds the filament of a plan to the board."""

    def __init__(self, plan: JointPlan, board: BoardFeed, tool: int) -> None:
        if plan.filament is None:
            raise InputError("the plan has no filament", field="--head")
        self._filament, self._board = FilamentFeed(plan.filament, board.feed, tool), board

    def step(self, robot: float, begun: bool) -> None:
        if begun:
            self._filament.step(robot)
        self._board.step()


def _loop(
    follower: Follower,
    wire: EgmWire,
    say: Callable[[str], None],
    extruder: _Extruder | None = None,
) -> None:
    reported = 0.0
    began = received_at = time.monotonic()
    while not follower.over:
        state = wire.newest()
        now = time.monotonic()
        while wire.remarks:
            say(wire.remarks.pop())
        if extruder is not None:
            extruder.step(follower.robot, follower.begun)
        if state is None:
            limit = SILENCE if follower.begun else JOINING
            if now - received_at > limit:
                raise EgmStopped(f"the controller has said nothing for {limit:g} s")
            if not follower.begun and now - received_at > SILENCE:
                wire.release()
            continue
        received_at = now
        reference = follower.answer(state)
        if reference is None:
            if now - began > JOINING:
                raise EgmStopped(f"the controller did not run within {JOINING:g} s")
            continue
        wire.send(reference)
        if follower.sample >= reported * (follower.total - 1):
            say(f"{follower.sample * PERIOD:.1f} s of {(follower.total - 1) * PERIOD:.1f} s")
            reported = follower.sample / (follower.total - 1) + REPORT_EVERY
