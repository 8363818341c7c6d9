"""Streams a plan's moves to a controller while it runs them, in place of loading the whole program."""

from __future__ import annotations

import argparse
import re
import select
import socket
import struct
import sys
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from importlib.resources import files
from ipaddress import AddressValueError, IPv4Address
from pathlib import Path
from zlib import crc32

import numpy as np
from numpy.typing import NDArray

from planner.base.arrays import Array, Indices
from planner.base.command_line import Command, exit_code
from planner.base.errors import EXIT_NOT_VERIFIED, EXIT_VERIFIED, InputError, OutputError, PlannerError
from planner.base.gcode_lines import commands_in
from planner.base.signals import hangups_interrupt
from planner.export.program import RobotProgram, Trigger
from planner.export.rapid.reader import read_rapid_files
from planner.link.as_written import PLAN, add_edited, program_as_written, read_json
from planner.link.connections import given_address, part
from planner.link.feed import BoardFeed, FeedStopped, feeding
from planner.link.run import PASSWORD as BOARD_PASSWORD
from planner.link.telling import GoingOn, begun_words, going_on
from planner.plan import TRAVEL

# ----------------------------------------------------------------------------------------------------
# Frames: one for each move of a program (see BeadwiseStream.mod).
#
# A frame is 116 bytes, little-endian: number, kind, flags of the triggers, tool, place [mm], orientation w x y z,
# configuration, external axes [deg], speeds [mm/s, deg/s], wait [s], zone [mm], number of frames up to and including
# the next rest, the via point of an arc [mm], the flow from the start of the move and from its end [unit of the analog
# output], and two checksums of the above.
#
# A controller's task takes some 6.5 ms to read a message of any length. So frames are sent together, and it reads as
# many at once as fit into its rawbytes.

BODY = struct.Struct("<IBBBx3f4f4b6f4fffHxx3f2f")
SUMS = struct.Struct("<HH")
LENGTH = BODY.size + SUMS.size
MESSAGE = 1024  # bytes of RAPID's rawbytes
AT_ONCE = MESSAGE // LENGTH  # frames that a controller reads at once
LINEAR, JOINT, ABSOLUTE, END, STOP, ALIVE, CIRCULAR = range(1, 8)
ON_AT_START, ON_AT_END, OFF_AT_END, FLOW_AT_START, FLOW_AT_END, TELL = 1, 2, 4, 8, 16, 32
COMBINED = {0, ON_AT_START, ON_AT_END, OFF_AT_END, ON_AT_START | OFF_AT_END}
VALUES = 24
MOST_LEFT = 65535
MOST_TOOLS = 8
NEAR_START = 1e-6  # m
UNUSED = 9e9  # of external axes, as in RAPID
_WORDS = struct.Struct(f"<{BODY.size // 2}H")


@dataclass(frozen=True)
class Stream:
    """A program as frames 1 … total; the last one marks the end.

    signals   outputs of the extruders, indexed by the frames' tool
    longest   time of the longest single move or wait [s], at the programmed speeds
    lines     frame → lines for the extruder's board once the controller has handed the frame to its motion
    beads     (m) of its moves, or approached by them; TRAVEL for none, None if the program does not state them
    plan      checksum of what the server's module must contain of the plan, see `plan_sum`
    """

    total: int
    signals: tuple[str, ...]
    longest: float
    lines: dict[int, tuple[str, ...]]
    beads: Indices | None
    plan: str
    _values: Array
    _codes: NDArray[np.int64]

    def begun(self, done: int) -> int | None:
        """The bead of the last of `done` frames, or the bead it approaches; None if there is none."""
        if self.beads is None or done < 2:
            return None
        bead = int(self.beads[min(done - 2, len(self.beads) - 1)])
        return None if bead == TRAVEL else bead

    def rests(self, frame: int) -> bool:
        """Whether the robot stands at the end of a frame."""
        return float(self._values[frame - 1, 18]) == 0.0

    def frames(self) -> Iterator[bytes]:
        """All frames in order."""
        for n in range(1, self.total):
            kind, flags, tool, *conf, left = self._codes[n - 1].tolist()
            yield packed(n, kind, flags, tool, self._values[n - 1].tolist(), conf, left)
        yield packed(self.total, END, left=1)


def packed(
    number: int,
    kind: int,
    flags: int = 0,
    tool: int = 0,
    values: list[float] | None = None,
    conf: list[int] | None = None,
    left: int = 0,
) -> bytes:
    """One frame; values: place, orientation, external axes, speeds, wait, zone, via point and two flows (24)."""
    v = values or [0.0] * VALUES
    body = BODY.pack(number, kind, flags, tool, *v[:7], *(conf or [0] * 4), *v[7:19], left, *v[19:])
    first = second = 0
    for word in _WORDS.unpack(body):
        first = (first + word) % 65535
        second = (second + first) % 65535
    return body + SUMS.pack(first, second)


def stream_of(program: RobotProgram, demand: str = "") -> Stream:
    """The frames of a program of any style; demand: analog output for the flow, empty for none.

    Raises InputError for anything that only the program itself can do.
    """
    if program.second is not None:
        raise InputError(
            "two arms move together, but a stream moves only one", hint="run the program's own two modules"
        )
    m = len(program.position)
    signals: list[str] = []
    codes = np.zeros((m + 1, 8), np.int64)
    codes[1:, 0] = np.where(program.linear, LINEAR, JOINT)
    codes[0, 0] = ABSOLUTE
    for move, triggers in program.triggers.items():
        codes[move + 1, 1:3] = _flags(triggers, signals)
    codes[1:, 3:7] = program.conf
    rests = np.append(True, program.zone == 0.0)
    ahead = np.append(np.flatnonzero(rests), m + 1)  # the end frame stops all motion
    index = np.arange(m + 1)
    codes[:, 7] = np.minimum(ahead[np.searchsorted(ahead, index)] - index + 1, MOST_LEFT)
    values = np.zeros((m + 1, VALUES))
    values[0, :6] = _degrees(program.start[:6])
    values[0, 7:13] = _degrees(program.start[6:])
    values[1:, :3] = program.position * 1e3
    values[1:, 3:7] = program.quat[:, [3, 0, 1, 2]]
    values[1:, 7:13] = _degrees(program.external)
    speed = np.vstack([program.speed[:1], program.speed])
    values[:, 13:17] = speed * [1e3, 180.0 / np.pi, 1e3, 180.0 / np.pi]
    values[1:, 17] = program.wait
    values[1:, 18] = program.zone * 1e3
    circular = np.append(False, program.circular)
    codes[circular, 0] = CIRCULAR
    values[circular, 19:22] = program.via[program.circular] * 1e3
    _flows(program, codes, values)
    # lines due before the first move come with frame 1, which holds the start joints
    lines = {move + 2: texts for move, texts in sorted(program.sends.items())}
    codes[[frame - 1 for frame in lines], 1] |= TELL
    plan = plan_sum(program, signals, demand)
    return Stream(m + 2, tuple(signals), _longest(program), lines, program.bead, plan, values, codes)


def _flows(program: RobotProgram, codes: NDArray[np.int64], values: Array) -> None:
    """The flow of style demand, at the ends of moves; a move that does not set it keeps the previous value."""
    if not program.demands:
        return
    now = 0.0
    steps = np.append(0.0, program.segments.length)
    for move in range(len(program.position)):
        frame = move + 1
        values[frame, 22:] = now
        for distance, value in program.demands.get(move, ()):
            if distance == 0.0:
                codes[frame, 1] |= FLOW_AT_END
                values[frame, 23] = now = value
            elif distance >= steps[move] - NEAR_START:
                codes[frame, 1] |= FLOW_AT_START
                values[frame, 22:] = now = value
            else:
                raise InputError("only a flow that changes at the ends of moves is streamed", field="program.style")


def _degrees(radians: Array) -> Array:
    return np.where(np.isnan(radians), UNUSED, np.degrees(radians))


def _flags(triggers: tuple[Trigger, ...], signals: list[str]) -> tuple[int, int]:
    """Flags and tool of a move's triggers; new signals are added to `signals`."""
    flags, names = 0, {trigger.signal for trigger in triggers}
    for trigger in triggers:
        if trigger.distance != 0.0 or (trigger.from_start and not trigger.value):
            raise InputError("only switching at the ends of moves is streamed", field="program.style")
        flags |= ON_AT_START if trigger.from_start else ON_AT_END if trigger.value else OFF_AT_END
    if flags not in COMBINED or len(names) != 1:
        raise InputError("a move switches in a way that is not streamed", field="program.style")
    name = names.pop()
    if name not in signals:
        signals.append(name)
    if len(signals) > MOST_TOOLS:
        raise InputError(f"more than {MOST_TOOLS} extruders are not streamed", field="process.materials")
    return flags, signals.index(name)


def _longest(program: RobotProgram) -> float:
    """Time of the longest single move or wait [s]."""
    step = program.segments.length / program.speed[1:, 0]
    same = np.abs(np.einsum("ij,ij->i", program.quat[1:], program.quat[:-1])).clip(0.0, 1.0)
    turn = 2.0 * np.arccos(same) / program.speed[1:, 1]
    axes = np.nan_to_num(np.abs(np.diff(program.external, axis=0))).max(axis=1, initial=0.0) / program.speed[1:, 3]
    return float(max(np.max([step, turn, axes], initial=0.0), program.wait.max(initial=0.0)))


# ----------------------------------------------------------------------------------------------------
# The sender, without sockets: answers of the controller in, bytes out.

VERSION = 3
ANY_PLAN = "any"  # of a simulated controller, which moves no robot
LONGEST_LINE = 80  # characters, as for RAPID's strings
ALIVE_EVERY = 0.5  # s; the controller stops after 2 s of silence
MOST_SENT = 8 * AT_ONCE  # frames sent before reading answers
PATIENCE = 30.0  # s without a message from the controller, in addition to its longest move
SLOWEST = 10.0  # × the programmed duration: an operator may lower the speed this far
_WORD = re.compile(
    r"([BCE]) (0|[1-9][0-9]{0,8}) (0|[1-9][0-9]{0,8})(?: ([0-9a-f]{8}|any))?|X (0|[1-9][0-9]{0,8}) (.{1,70})"
)


class StreamStopped(PlannerError):
    """The stream has ended early; states why and after how many moves."""

    exit_code = EXIT_NOT_VERIFIED


class Sender:
    """Hands out frames as far as the controller's buffer allows, or else a sign of life.

    done, starved   moves handed to the motion, and how often the robot waited within a bead (known at the end)
    """

    def __init__(self, stream: Stream, now: float) -> None:
        self.total, self.sent, self.taken, self.done, self.starved = stream.total, 0, 0, 0, 0
        self.finished = False
        self._plan, self._frames = stream.plan, stream.frames()
        self._patience = PATIENCE + SLOWEST * stream.longest
        self._capacity: int | None = None
        self._partial = b""
        self._sent_at, self._received_at = now, now

    def receive(self, data: bytes, now: float) -> None:
        """Take bytes from the controller. Raises StreamStopped if it stopped, or violated the protocol."""
        *whole, self._partial = (self._partial + data).split(b"\n")
        if max(len(each) for each in (*whole, self._partial)) > LONGEST_LINE:
            raise self._stopped("the controller sent a line that is too long")
        for raw in whole:
            self._take(raw.decode("ascii", errors="replace"))
            self._received_at = now  # only whole lines count, not single bytes

    def due(self, now: float, hold: int | None = None) -> bytes:
        """What to send now, up to frame `hold`. Raises StreamStopped if the controller is silent for too long."""
        if self.finished:
            return b""
        if now - self._received_at > self._patience:
            raise self._stopped(f"the controller has said nothing for {self._patience:.0f} s")
        out = b""
        if self._capacity is not None:
            last = min(self.total, self.done + self._capacity, self.sent + MOST_SENT, hold or self.total)
            out = b"".join(next(self._frames) for _ in range(last - self.sent))
            self.sent = max(last, self.sent)
        if not out and now - self._sent_at >= ALIVE_EVERY:
            out = packed(self.sent, ALIVE)
        if out:
            self._sent_at = now
        return out

    def stop(self, unsent: bytes) -> bytes:
        """Bytes that stop the robot, after the rest of a frame that was partly sent."""
        return unsent[: len(unsent) % LENGTH] + packed(self.sent, STOP)

    def lost(self) -> StreamStopped:
        """The error of a lost connection."""
        return self._stopped("the connection to the controller is lost")

    def _take(self, text: str) -> None:
        match = _WORD.fullmatch(text)
        if match is None:
            raise self._stopped(f"the controller sent {text[:20]!r}, which is not understood")
        word, one, two, plan, _, reason = match.groups()
        if reason is not None:
            raise self._stopped(f"the controller stopped: {reason}")
        first, second = int(one), int(two)
        if word == "B" and self._capacity is None and second > 0:
            if first != VERSION or plan not in (self._plan, ANY_PLAN):
                what = "of another version" if first != VERSION else "with tool, work object or outputs of another plan"
                raise self._stopped(f"the controller runs {MODULE}.mod {what}: load the one that --server writes")
            self._capacity = second
        elif plan is not None:
            raise self._stopped(f"the controller sent {text!r}, which cannot be")
        elif word == "C" and self.taken <= first <= self.sent and self.done <= second <= first:
            self.taken, self.done = first, second
        elif word == "E" and self.sent == self.total and first == self.total - 1:
            self.done, self.starved, self.finished = self.total, second, True
        else:
            raise self._stopped(f"the controller sent {text!r}, which cannot be")

    def _stopped(self, reason: str) -> StreamStopped:
        return StreamStopped(f"{reason}; {self.done} of {self.total} moves were begun")


# ----------------------------------------------------------------------------------------------------
# Lines for the extruder's board, in style socket.

SLOW = ("G4", "M109", "M116", "M190", "M191", "M400")  # acknowledged only when complete: the robot rests until then
MOST_BEHIND = 16  # lines by which the board may lag behind the robot, as in a program of style socket


class LineFeed:
    """Sends the board its lines as their moves are handed to the motion."""

    def __init__(self, stream: Stream, board: BoardFeed) -> None:
        """Raises InputError for a slow line that is not at a rest."""
        self._board, self._left = board, deque(stream.lines.items())
        self._holds: deque[tuple[int, int]] = deque()  # frame, and number of lines up to and including it
        count = 0
        for frame, texts in stream.lines.items():
            count += len(texts)
            if any(command.split(" ", 1)[0] in SLOW for text in texts for command in commands_in(text)):
                if not stream.rests(frame):
                    raise InputError(f"waits for {texts[0]!r} in motion", field="program.style")
                self._holds.append((frame, count))

    def step(self, done: int) -> int | None:
        """Advance to `done` frames; returns the frame beyond which none may be sent yet. Raises FeedStopped."""
        while self._left and self._left[0][0] <= done:
            for text in self._left.popleft()[1]:
                self._board.feed.add(text)
        self._board.step()
        if self._board.feed.behind > MOST_BEHIND:
            raise FeedStopped(f"the board is {self._board.feed.behind} lines behind the robot")
        while self._holds and self._board.feed.acknowledged >= self._holds[0][1]:
            self._holds.popleft()
        return self._holds[0][0] if self._holds else None

    def finish(self) -> None:
        """Wait for the board after the motion. Raises FeedStopped."""
        self._board.finish()


# ----------------------------------------------------------------------------------------------------
# The module for the controller, with a plan's tool, work object, station and outputs.

MODULE = "BeadwiseStream"
_DEMAND = re.compile(r"\\AOp:=(\w+),")
_PARTS = re.compile(r"( *! --- of the plan ---\n).*?(?= *! --- of every plan ---\n)", re.DOTALL)


def server_module(program: RobotProgram, signals: Sequence[str], address: str, port: int, demand: str = "") -> str:
    """Text of the RAPID module that receives a program's stream at an address of the controller.

    demand  analog output for the flow; empty for none
    """
    text = files("planner.link").joinpath(f"{MODULE}.mod").read_text("ascii")
    data = [
        f'CONST string bsAddress:="{address}";',
        f"CONST num bsPort:={port};",
        f'CONST string bsPlan:="{plan_sum(program, signals, demand)}";',
        "! The load below is a placeholder: identify it on the robot before the first run.",
        *_data(program),
    ]
    procedures = _procedures(program, signals, demand)
    new = iter(("\n".join(f"    {line}" for line in data) + "\n", "\n".join(procedures) + "\n"))
    return _PARTS.sub(lambda match: match[1] + next(new), text)


def plan_sum(program: RobotProgram, signals: Sequence[str], demand: str = "") -> str:
    """Checksum (8 hex digits) of what a module contains of a plan: tool, work object, station and outputs."""
    text = "\n".join([*_data(program), *_procedures(program, signals, demand)])
    return f"{crc32(text.encode('ascii')):08x}"


def _data(program: RobotProgram) -> list[str]:
    """Declarations of tool and work object."""
    moved = "FALSE" if program.station else "TRUE"
    frames = f'[FALSE,{moved},"{program.station}",{_pose(program.uframe)},{_pose(program.oframe)}]'
    load = "[1,[0,0,50],[1,0,0,0],0,0,0]"
    return [
        f"PERS tooldata tBeadwise:=[TRUE,{_pose(program.tool)},{load}];",
        f"PERS wobjdata wobjBeadwise:={frames};",
    ]


def _procedures(program: RobotProgram, signals: Sequence[str], demand: str) -> list[str]:
    """Procedures that depend on outputs and station."""
    off = [f"SetDO {name},0;" for name in signals] + ([f"SetAO {demand},0;"] if demand else [])
    units = ["! No station: the part stands still."]
    if program.station:
        units = [
            "IF active THEN",
            f"    ActUnit {program.station};",
            "ELSE",
            f"    DeactUnit {program.station};",
            "ENDIF",
        ]
    return [
        *_procedure("BsTrigg(bsstep next,robtarget via,robtarget target,zonedata zone)", _triggers(signals, demand)),
        *_procedure("BsAllOff()", off or ["! No output: the extruder has its own connection."]),
        *_procedure("BsUnits(bool active)", units),
    ]


def _triggers(signals: Sequence[str], demand: str) -> list[str]:
    """Statements of a move with outputs: both of its ends set all of them, whether they change or not."""
    if not signals and not demand:
        return ['BsStop "no output here";']
    out = ["VAR num s;", "s:=1+bsDone MOD 16;"]
    if signals:
        out.append("TEST next.tool")
    for k, name in enumerate(signals, 1):
        out += [
            f"CASE {k - 1}:",
            f"    IF BitCheck(next.flags,1) bsState{{{k}}}:=1;",
            f"    TriggIO bsStarting{{s}},0\\Start\\DOp:={name},bsState{{{k}}};",
            f"    IF BitCheck(next.flags,2) bsState{{{k}}}:=1;",
            f"    IF BitCheck(next.flags,3) bsState{{{k}}}:=0;",
            f"    TriggIO bsEnding{{s}},0\\DOp:={name},bsState{{{k}}};",
        ]
    if signals:
        out += ["DEFAULT:", '    BsStop "unknown tool";', "ENDTEST"]
    names = ["bsStarting{s}", "bsEnding{s}"] if signals else []
    if demand:
        names += ["bsFlowing{s}", "bsFlowOn{s}"]
        out.append(f"TriggIO bsFlowing{{s}},0\\Start\\AOp:={demand},next.flowStart;")
        out.append(f"TriggIO bsFlowOn{{s}},0\\AOp:={demand},next.flowEnd;")
    used = names[0] + "".join(f"\\T{k}:={name}" for k, name in enumerate(names[1:], 2))
    rest = f"next.speed,{used},zone,tBeadwise\\WObj:=wobjBeadwise;"
    return [*out, "IF next.kind=7 THEN", f"    TriggC via,target,{rest}", "ELSE", f"    TriggL target,{rest}", "ENDIF"]


def _procedure(head: str, lines: Sequence[str]) -> list[str]:
    return [f"    PROC {head}", *(f"        {line}" for line in lines), "    ENDPROC", ""]


def _pose(pose: Array) -> str:
    x, y, z = (f"{value * 1e3:.3f}" for value in pose[:3])
    q = ",".join(f"{value:.7f}" for value in pose[[6, 3, 4, 5]])
    return f"[[{x},{y},{z}],[{q}]]"


# ----------------------------------------------------------------------------------------------------
# The command.
#
# python -m planner.link.stream OUT_DIR --controller HOST

PORT = 1026
CONNECTING = 10.0  # s
LAST_WORDS = 2.0  # s in which the controller may say that it has stopped
LOOK = 0.01  # s between checks of the clock
FEED_LOOK = 0.001  # s between checks of the board
BOARD_PORT = 23  # telnet
LARGEST = 256 << 20  # bytes of all modules
BLOCK = 4096  # bytes read at once
LONGEST_NAME = 80  # bytes of a module's first line
REPORT_EVERY = 0.1  # share of all moves


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit code."""
    options = _options(arguments)
    say = lambda text: print(text, file=sys.stderr, flush=True)  # noqa: E731
    return exit_code(lambda: _run(options, say), say, "the robot was stopped")


def stream_command() -> Command:
    """The parser of `python -m planner.link.stream`."""
    parser = Command(
        "link.stream",
        f"Send a plan's moves to a controller that runs {MODULE}.mod, as fast as it takes them.",
        {
            "out/my_part --controller 192.168.125.1 --server player.mod": "write the module for this plan, and send",
            "out/my_part --controller 192.168.125.1": "send to a controller that runs the module already",
        },
        {0: "finished", 2: "wrong input", 3: "stopped before the end", 130: "interrupted"},
        [f"the board's password, if it has one, comes from {BOARD_PASSWORD}"],
    )
    parser.add_argument("folder", type=Path, metavar="OUT_DIR", help="results of planner.solve")
    parser.add_argument("--controller", metavar="HOST[:PORT]", help=f"the controller (port {PORT} unless said)")
    parser.add_argument("--head", metavar="HOST[:PORT]", help="the extruder's board, for style socket (port 23)")
    parser.add_argument(
        "--server", type=Path, metavar="FILE", help=f"write {MODULE}.mod for this plan, to be loaded on the controller"
    )
    add_edited(parser)
    return parser


def _options(arguments: Sequence[str] | None) -> argparse.Namespace:
    parser = stream_command()
    options: argparse.Namespace = parser.parse_args(arguments)
    if options.controller is None and options.server is None:
        parser.error("a --controller to send to, or a file for the --server's module")
    return options


def _run(options: argparse.Namespace, say: Callable[[str], None]) -> int:
    program, demand = program_in(options.folder)
    program_as_written(options.folder, [path.name for path in modules_in(options.folder)], options.edited, say)
    stream = stream_of(program, demand)
    if options.controller is not None and bool(stream.lines) != (options.head is not None):
        what = "sends lines to the extruder's board: say where it is" if stream.lines else "has no lines for a board"
        raise InputError(f"the program {what}", field="--head")
    address = given_address(options.controller or "127.0.0.1", PORT, "--controller")
    host, port = address.host, address.port
    if options.server is not None:
        if not _is_ipv4(host):
            raise InputError(
                f"the server's module needs an address such as 192.168.125.1, not {host}", field="--controller"
            )
        try:
            _check_own(options.server)
            options.server.write_text(server_module(program, stream.signals, host, port, demand), "ascii", newline="\n")
        except OSError as error:
            raise OutputError(f"cannot write {options.server}: {error.strerror or error}") from error
    if options.controller is not None:
        with hangups_interrupt(), ExitStack() as stack:
            board = None
            if options.head is not None:
                board = stack.enter_context(feeding(given_address(options.head, BOARD_PORT, "--head")))
            feed = None if board is None else LineFeed(stream, board)
            sender = send(stream, host, port, say, feed, going_on(read_json(options.folder / PLAN), "PROBLEM"))
        say(f"finished after {sender.total - 1} moves; the robot waited for moves {sender.starved} times within beads")
    return EXIT_VERIFIED


def _check_own(path: Path) -> None:
    """Raises InputError for an existing file other than the server's module, which must not be replaced."""
    if path.is_file():
        with path.open("rb") as stream:
            if stream.readline(LONGEST_NAME).split() != [b"MODULE", MODULE.encode()]:
                raise InputError(f"is not {MODULE}.mod, and stays as it is", file=path)


def modules_in(folder: Path) -> list[Path]:
    """The modules of a folder, except the server's."""
    return [path for path in sorted(folder.glob("*.mod")) if path.stem != MODULE]


def program_in(folder: Path) -> tuple[RobotProgram, str]:
    """The RAPID program in a folder of results, and its analog output for the flow, if any.

    Raises InputError if there is none, or it cannot be read.
    """
    paths = modules_in(folder)
    if not paths:
        raise InputError("no RAPID program here", file=folder, hint="solve a problem first: python -m planner.solve")
    if sum(path.stat().st_size for path in paths) > LARGEST:
        raise InputError(f"modules larger than {LARGEST >> 20} MB together", file=folder)
    texts = {}
    for path in paths:
        try:
            texts[path.name] = path.read_text("ascii")
        except (OSError, UnicodeDecodeError) as error:
            raise InputError(f"cannot be read: {error}", file=path) from error
    found = next((match for text in texts.values() if (match := _DEMAND.search(text))), None)
    return read_rapid_files(texts), "" if found is None else found[1]


def send(
    stream: Stream,
    host: str,
    port: int,
    say: Callable[[str], None],
    lines: LineFeed | None = None,
    planned: GoingOn | None = None,
) -> Sender:
    """Send a whole stream, from connection to end, and its lines to the board.

    Raises InputError if nobody answers, StreamStopped and FeedStopped if it ends early; then, and when interrupted, the
    controller is told to stop, if still reachable, and `say` reports the bead that was begun, and how to resume.
    """
    try:
        connection = socket.create_connection((host, port), timeout=CONNECTING)
    except OSError as error:
        reason = error.strerror or str(error)
        raise InputError(f"no connection to {host}:{port}: {reason}", field="--controller") from error
    with connection:
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        sender, waiting = Sender(stream, time.monotonic()), bytearray()
        try:
            _pump(connection, sender, waiting, say, lines)
        except (StreamStopped, FeedStopped, KeyboardInterrupt):
            part(connection, sender.stop(bytes(waiting)), LAST_WORDS)
            if (bead := stream.begun(sender.done)) is not None:
                for text in begun_words(bead, planned):
                    say(text)
            raise
    if lines is not None:
        lines.finish()
    return sender


def _pump(
    connection: socket.socket, sender: Sender, waiting: bytearray, say: Callable[[str], None], lines: LineFeed | None
) -> None:
    reported, hold = 0.0, None
    connection.setblocking(False)
    while not sender.finished:
        if lines is not None:
            hold = lines.step(sender.done)
        if not waiting:
            waiting += sender.due(time.monotonic(), hold)
        readable, writable, _ = select.select(
            [connection], [connection] if waiting else [], [], LOOK if lines is None else FEED_LOOK
        )
        try:
            if readable:
                data = connection.recv(BLOCK)
                if not data:
                    raise sender.lost()
                sender.receive(data, time.monotonic())
            if writable:
                del waiting[: connection.send(waiting)]
        except OSError as error:
            raise sender.lost() from error
        if sender.done >= reported * sender.total:
            say(f"{sender.done} of {sender.total} moves begun")
            reported = sender.done / sender.total + REPORT_EVERY


def _is_ipv4(host: str) -> bool:
    try:
        IPv4Address(host)
    except AddressValueError:
        return False
    return True
