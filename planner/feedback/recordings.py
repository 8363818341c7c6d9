"""Recordings of a robot's joints: CSV files from controllers, their interfaces and ROS tools, and ROS bags."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from planner.base.arrays import Array, Flags, Ints, ReadOnlyArrays
from planner.base.command_line import Command
from planner.base.errors import Complaint, InputError
from planner.base.tables import is_number, rows_of, separator_of, split_row
from planner.cell.cell import Cell
from planner.export.external import external_axes
from planner.feedback.bags import BagTable, is_bag, read_bag
from planner.feedback.glitches import cleaned

LARGEST_FILE = 300_000_000  # bytes: an hour at 1 kHz
LEAST_SAMPLES = 50

# Words in column names, by meaning. In a name with words of both kinds, commanded takes precedence over executed.
COMMANDED = {"target", "cmd", "command", "commanded", "desired", "reference", "ref", "setpoint", "planned", "goal"}
EXECUTED = {"actual", "act", "executed", "measured", "meas", "feedback", "fb", "state", "states", "real", "msr"}
FILLING = {
    "position", "positions", "pos", "angle", "angles", "value", "values", "robot", "field", "data", "msg", "name",
}  # fmt: skip
OTHER = {
    "velocity", "velocities", "vel", "qd", "qdd", "speed", "current", "torque", "effort", "acceleration", "acc", "moment",
    "temperature", "temp", "voltage", "jerk", "error", "err", "dq", "ddq", "tau", "pose", "tcp", "force", "output", "mode",
}  # fmt: skip
NUMBERED = {"j", "q", "joint", "joints", "axis", "axes", "a", "ax", "theta", "rax", "aspos", "aipos", "axisact", "jnt"}
EXTERNAL = {"e", "eax", "ext", "external", "extax"}
TIMES = {"t", "time", "timestamp", "stamp", "clock", "clk", "elapsed"}
DEGREE = np.pi / 180.0
PLACES = {"deg": DEGREE, "degree": DEGREE, "degrees": DEGREE, "°": DEGREE, "rad": 1.0, "radian": 1.0, "radians": 1.0,
          "mm": 1e-3, "m": 1.0}  # fmt: skip
CLOCKS = {"s": 1.0, "sec": 1.0, "secs": 1.0, "second": 1.0, "seconds": 1.0, "ms": 1e-3, "msec": 1e-3, "us": 1e-6,
          "µs": 1e-6, "usec": 1e-6, "ns": 1e-9, "nsec": 1e-9, "nsecs": 1e-9, "nanosec": 1e-9}  # fmt: skip
ROS_STAMP = 1e16  # beyond, a stamp without a unit counts nanoseconds since 1970, as rostopic writes them
MOST_STAMP = 1e19  # of a clock: nanoseconds since 1970 are about 1.7e18
MOST_PLACE = 1e6  # of a joint in any unit: thousands of turns in degrees, a kilometre in mm
LEAST_STEP, MOST_STEP = 0.2e-3, 0.5  # s between samples: anything else means another unit
SPELLINGS = "t_s, then joint names, or J1 … J6, q1 … q6, A1 … A6, actual_q_0 … actual_q_5, with _deg or _rad"
_WORD = re.compile(r"[a-z°µ]+|[0-9]+")


@dataclass(frozen=True)
class RobotLog(ReadOnlyArrays):
    """A recording (m samples) of a cell's joints (n), in the file's own units.

    lines (m)            line of each sample, from 1
    time (m)             [s]
    executed (m, n)      actual positions; commanded (m, n): commanded positions, if the file has them
    unit (n)             unit of the numbers in rad or m; NaN if the file does not state it
    told                 names of the columns used, in the order of time, executed, commanded
    remarks              notes on what was left out
    """

    file: Path
    lines: Ints
    time: Array
    executed: Array
    commanded: Array | None
    unit: Array
    commanded_unit: Array | None
    told: tuple[str, ...]
    remarks: tuple[str, ...] = ()

    @property
    def step(self) -> float:
        """Median time between samples [s]."""
        return float(np.median(np.diff(self.time)))


@dataclass(frozen=True)
class LogColumn:
    """A column to be read: its index k in a line, its name, what it holds, and in which unit.

    role    "time", "executed" or "commanded"
    named   the joint whose name the column contains; number: the number after a J, q or similar, as written
    unit    in s, rad or m; NaN if the name does not state it
    """

    k: int
    name: str
    role: str
    unit: float
    named: int | None = None
    number: int | None = None
    external: bool = False


def add_recording(parser: Command) -> None:
    """Add the options for reading a recording: `columns` and `topic` of `read_log`."""
    parser.add_argument(
        "--columns",
        type=_names,
        metavar="NAMES",
        help="column names of a file without a header; - for a column to skip",
    )
    parser.add_argument("--topic", metavar="NAME", help="topic of the executed joints, if a bag has several")


def _names(text: str) -> tuple[str, ...]:
    return tuple(name.strip() for name in text.split(","))


def read_log(file: Path, cell: Cell, columns: Sequence[str] | None = None, topic: str | None = None) -> RobotLog:
    """Read a recording of this cell's joints.

    columns   column names, for a file without a header; only those of times and joints are read
    topic     of the executed joints in a ROS bag, if it has several
    Raises InputError with file, line (in a bag, the message number) and column for whatever cannot be read, and for a
    clock that does not advance.
    """
    if is_bag(file):
        return _of_bag(file, read_bag(file, cell, topic), cell)
    _check_kind(file)
    rows = rows_of(file, LARGEST_FILE)
    if not rows:
        raise InputError("holds no samples", file=file)
    separator = separator_of(rows[0][1])
    if columns is None:
        line, head = rows.pop(0)
        wrong = partial(InputError, file=file, line=line)
        words = split_row(head, separator, wrong)
        if (other := _other_table(words, [split_row(text, separator, wrong) for _, text in rows[:20]])) is not None:
            raise wrong(other, hint=RECORDING)
        if all(is_number(word) for word in words):
            raise wrong("a header that names the columns is missing", hint=f"--columns names them: {SPELLINGS}")
    else:
        words, wrong = list(columns), partial(InputError, file=file, field="--columns")
    clocks, places = _wanted(words, cell, wrong)
    if len(rows) < LEAST_SAMPLES:
        raise InputError(f"holds {len(rows)} samples", file=file, hint=f"at least {LEAST_SAMPLES}")
    table = _numbers(file, rows, separator, [*clocks, *places.values()])
    numbers = np.array([i for i, _ in rows], dtype=np.int64)
    return _without_glitches(_running_on(_log(file, numbers, table, clocks, places)))


def _of_bag(file: Path, bag: BagTable, cell: Cell) -> RobotLog:
    clocks, places = _wanted(bag.names, cell, partial(InputError, file=file))
    if len(bag.numbers) < LEAST_SAMPLES:
        raise InputError(f"holds {len(bag.numbers)} samples", file=file, hint=f"at least {LEAST_SAMPLES}")
    columns = [*clocks, *places.values()]
    table = bag.numbers[:, [column.k for column in columns]]
    return _without_glitches(_running_on(_log(file, bag.messages, table, clocks, places)))


def _log(
    file: Path, lines: Ints, table: Array, clocks: Sequence[LogColumn], places: dict[tuple[str, int], LogColumn]
) -> RobotLog:
    _check_size(file, lines, table, [*clocks, *places.values()])
    n = sum(role == "executed" for role, _ in places)
    executed, commanded = np.empty((len(lines), n)), np.empty((len(lines), n))
    unit, commanded_unit = np.empty(n), np.empty(n)
    for at, ((role, j), column) in enumerate(places.items(), len(clocks)):
        values, units = (executed, unit) if role == "executed" else (commanded, commanded_unit)
        values[:, j], units[j] = table[:, at], column.unit
    there = ("commanded", 0) in places
    return RobotLog(
        file=file,
        lines=lines,
        time=_time(file, lines, table, clocks),
        executed=executed,
        commanded=commanded if there else None,
        unit=unit,
        commanded_unit=commanded_unit if there else None,
        told=tuple(column.name for column in (*clocks, *(places[key] for key in sorted(places, key=_by_role)))),
    )


def _by_role(key: tuple[str, int]) -> tuple[bool, int]:
    role, joint = key
    return role == "commanded", joint


def _check_size(file: Path, lines: Ints, table: Array, columns: Sequence[LogColumn]) -> None:
    """Raises InputError for a number that is too large for a clock or a joint in any unit."""
    most = np.array([MOST_STAMP if column.role == "time" else MOST_PLACE for column in columns])
    beyond = np.abs(table) > most
    if beyond.any():
        row, column = np.unravel_index(int(np.argmax(beyond)), beyond.shape)
        what = "a clock" if columns[int(column)].role == "time" else "a joint"
        reason = f"column {columns[int(column)].name[:40]!r} is {table[row, column]:.3g} here, too large for {what}"
        raise InputError(reason, file=file, line=int(lines[int(row)]))


def _time(file: Path, lines: Ints, table: Array, clocks: Sequence[LogColumn]) -> Array:
    """The clock (m) [s], from 0 at the first sample."""
    time = np.zeros(len(table))
    for values, column in zip(table.T, clocks, strict=False):
        unit = (1e-9 if values[0] > ROS_STAMP else 1.0) if np.isnan(column.unit) else column.unit
        time = time + (values - values[0]) * unit
    step = float(np.median(np.abs(np.diff(time))))
    if step > MOST_STEP or 0.0 < step < LEAST_STEP:
        name = clocks[0].name
        hint = (
            f"a name with its unit, such as {name.split('_')[0][:20]}_ms" if step > MOST_STEP else "a clock in seconds"
        )
        reason = f"column {name[:40]!r} advances by {step:g} s from sample to sample, which no controller records"
        raise InputError(reason, file=file, line=int(lines[0]), hint=hint)
    return time


def _running_on(log: RobotLog) -> RobotLog:
    """The recording without duplicate samples. Raises InputError if its clock runs back, or stands still in motion."""
    steps = np.diff(log.time)
    back = np.flatnonzero(steps < 0.0)
    if len(back):
        k = int(back[0])
        reason = f"the clock runs back by {-steps[k]:.6g} s, {log.time[k]:.6g} s after the first sample"
        hint = "one recording per file, in the order in which it was made"
        raise InputError(reason, file=log.file, line=int(log.lines[k + 1]), hint=hint)
    still = steps == 0.0
    if not still.any():
        return log
    same = (np.diff(log.executed, axis=0) == 0.0).all(axis=1)
    if log.commanded is not None:
        same &= (np.diff(log.commanded, axis=0) == 0.0).all(axis=1)
    moved = np.flatnonzero(still & ~same)
    if len(moved):
        k = int(moved[0])
        reason = f"the clock stands still {log.time[k]:.6g} s after the first sample while the joints move"
        hint = f"{len(moved)} times in all; record time stamps with more digits"
        raise InputError(reason, file=log.file, line=int(log.lines[k + 1]), hint=hint)
    return _rows_of(log, np.append(True, ~still))


def _rows_of(log: RobotLog, kept: Flags) -> RobotLog:
    """The recording reduced to some of its samples."""
    commanded = None if log.commanded is None else log.commanded[kept]
    return replace(log, lines=log.lines[kept], time=log.time[kept], executed=log.executed[kept], commanded=commanded)


def _without_glitches(log: RobotLog) -> RobotLog:
    """The recording without samples that no robot can have produced. Raises InputError if there are more than a few."""
    if len(log.time) < LEAST_SAMPLES:
        hint = f"at least {LEAST_SAMPLES}"
        raise InputError(f"holds {len(log.time)} samples at different times", file=log.file, hint=hint)
    columns = log.executed.shape[1] * (1 if log.commanded is None else 2)
    found = cleaned(log.file, log.lines, log.time, log.executed, log.told[len(log.told) - columns :])
    return log if not found.remarks else replace(_rows_of(log, found.kept), remarks=found.remarks)


# ----------------------------------------------------------------------------------------------------
# Files of another kind, recognised by their contents or names.

RECORDING = "a recording has time and joints"
CLOUD = "looks like a cloud of points, which `beadwise scan` reads"
_BEGINS = {b"ply": CLOUD, b"# .PCD": CLOUD, b"\x93NUMPY": CLOUD, b"PK": CLOUD, b"LASF": CLOUD, b"solid": "is a mesh"}
_ENDINGS = {
    **dict.fromkeys((".ply", ".pcd", ".xyz", ".pts", ".asc", ".npy", ".npz", ".las", ".e57"), CLOUD),
    **dict.fromkeys((".stl", ".obj", ".3mf", ".step", ".stp"), "is a shape"),
    **dict.fromkeys((".mod", ".pgf", ".src", ".dat", ".script", ".ls", ".jbi", ".gcode", ".ngc"), "is a program"),
    **dict.fromkeys((".json", ".html", ".yaml", ".yml"), "is no table"),
}  # fmt: skip
_PLACES = {"x", "y", "z"}
_PLANNED = {"t_s", "bead", "layer", "deposit"}  # columns of trajectory.csv


def _check_kind(file: Path) -> None:
    """Raises InputError for a file of another kind, judged by its first bytes or its suffix."""
    if not file.is_file():
        return
    try:
        with file.open("rb") as stream:
            begins = stream.read(8)
    except OSError:
        return  # reported when the file is read
    kind = next((kind for mark, kind in _BEGINS.items() if begins.startswith(mark)), None)
    kind = kind or _ENDINGS.get(file.suffix.lower())
    if kind is not None and begins:
        raise InputError(kind, file=file, hint=RECORDING)


def _other_table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str | None:
    """What a table is instead of a recording, judged by its first lines; None if it may be a recording."""
    names = {re.sub(r"[^a-z_]|_?(mm|m)[])]?$", "", word.strip().lower()) for word in head}
    if names >= _PLANNED:
        return "is the trajectory of a plan, and not what a robot did"
    if names >= _PLACES and not names & (TIMES | {"joint_1", "q", "j"}):
        return CLOUD
    table = [[float(word) for word in row] for row in (head, *rows) if all(map(is_number, row))]
    if len(table) < 2 or len(table) < len(rows) or {len(row) for row in table} - {3, 6}:
        return None
    if len(table[0]) == 3:
        return CLOUD
    normals = np.linalg.norm(np.array(table)[:, 3:], axis=1)
    return f"{CLOUD}: with normals" if (np.abs(normals - 1.0) < 1e-2).all() else None


# ----------------------------------------------------------------------------------------------------
# Names of columns.


def _wanted(
    words: Sequence[str], cell: Cell, wrong: Complaint
) -> tuple[list[LogColumn], dict[tuple[str, int], LogColumn]]:
    """The clock's columns, and those of joints by role and joint. InputError if one is missing or ambiguous."""
    found = [column for k, word in enumerate(words) if (column := column_of(k, word, cell)) is not None]
    clocks = [column for column in found if column.role == "time"]
    if not clocks:
        raise wrong("no column has the time", hint=SPELLINGS)
    split = [
        column for column in clocks if {"secs", "sec", "nsecs", "nanosec"} & set(_WORD.findall(column.name.lower()))
    ]
    places: dict[tuple[str, int], LogColumn] = {}
    for column, j in _joints([column for column in found if column.role != "time"], cell):
        if (column.role, j) in places:
            reason = f"columns {places[column.role, j].name!r} and {column.name!r} are both of {cell.joint_names[j]}"
            raise wrong(reason, hint="leave one of them out")
        places[column.role, j] = column
    n = len(cell.joint_names)
    missing = [cell.joint_names[j] for j in range(n) if ("executed", j) not in places]
    if len(missing) == n and all(("commanded", j) in places for j in range(n)):
        raise wrong("it has commanded joints, but not the executed ones", hint="columns such as actual_q_0")
    if missing:
        raise wrong(f"no column has {', '.join(missing)}", hint=SPELLINGS)
    told = [j for j in range(n) if ("commanded", j) in places]
    if told and len(told) < n:
        raise wrong(
            f"commanded joints are given for {', '.join(cell.joint_names[j] for j in told)} only", hint=SPELLINGS
        )
    return (split if len(split) == 2 else clocks[:1]), places


def column_of(k: int, name: str, cell: Cell) -> LogColumn | None:
    """What a column's name says; None if it is neither a time nor a joint position."""
    name = name.strip().strip("\"'").strip()
    plain = name.lower()
    words = _WORD.findall(plain)
    ends = CLOCKS if set(words) & TIMES and not set(words) & NUMBERED else PLACES
    unit = ends[words[-1]] if len(words) > 1 and words[-1] in ends else float("nan")
    plain = plain[: plain.rindex(words[-1])] if unit == unit else plain
    words = words[:-1] if unit == unit else words
    if ends is CLOCKS and set(words) <= TIMES | FILLING | {"header", "from", "start", "rosbag", "ros"}:
        return LogColumn(k, name, "time", unit)
    role = "commanded" if COMMANDED & set(words) else "executed"
    joints = [joint.lower() for joint in cell.joint_names]
    named = _named(plain, joints, len(cell.arm))
    rest = words if named is None else _WORD.findall(plain.replace(joints[named], " "))
    if OTHER & set(rest):
        return None
    kept = [word for word in words if word not in COMMANDED | EXECUTED | FILLING]
    external = len(kept) == 2 and kept[0] in EXTERNAL
    number = None
    if external:
        number = int(kept[1]) if kept[1].isdigit() else "abcdef".find(kept[1]) + 1
    elif kept and kept[-1].isdigit() and len(kept[-1]) < 3 and set(kept[:-1]) <= NUMBERED and len(words) > 1:
        number = int(kept[-1])
    if named is None and number is None:
        return None
    return LogColumn(k, name, role, unit, named, number, external)


def _joints(columns: Sequence[LogColumn], cell: Cell) -> list[tuple[LogColumn, int]]:
    """The joint of each column: by its name, or by its number, counted from 0 if one of them is 0."""
    from_zero = {column.role for column in columns if column.number == 0 and not column.external}
    external = _numbered_axes(max((column.number or 0 for column in columns if column.external), default=0), cell)
    out, first, own = [], cell.own.start, cell.own.stop - cell.own.start
    for column in columns:
        j = column.named
        if column.number is not None and (j is None or column.role in from_zero):
            if column.external:
                at = column.number - 1
                j = external[at] if 0 <= at < len(external) else None
            else:
                at = column.number - (column.role not in from_zero)
                j = first + at if 0 <= at < own else None
        if j is not None:
            out.append((column, j))
    return out


def _numbered_axes(highest: int, cell: Cell) -> Sequence[int | None]:
    """The joints of external axes 1, 2 and so on, None for those that are held: programs and controllers number these
    too. A file whose `highest` number does not exceed the number of moving axes is assumed to have only these."""
    if highest <= len(cell.besides):
        return cell.besides
    moving = iter(cell.besides)
    return [next(moving) if axis.held is None else None for axis in external_axes(cell)]


def _named(plain: str, joints: Sequence[str], arm: int) -> int | None:
    """The joint with the longest name that the column's name contains. The first `arm` joints, which are the arm's, do
    not match after positioner_, which marks a holder's axis of the same name, such as one that is held."""
    before = [r"(?<![a-z0-9])" + (r"(?<!positioner_)" if j < arm else "") for j in range(len(joints))]
    inside = [
        j
        for j, name in enumerate(joints)
        if re.search(rf"{before[j]}{re.escape(name)}(?![a-z0-9]|_[0-9])", plain) is not None
    ]
    return max(inside, key=lambda j: len(joints[j])) if inside else None


# ----------------------------------------------------------------------------------------------------
# Numbers.

_AT_ROW = re.compile(r"(.*) at row ([0-9]+)")


def _numbers(file: Path, rows: Sequence[tuple[int, str]], separator: str | None, columns: Sequence[LogColumn]) -> Array:
    """The numbers (m, c) of the wanted columns. InputError, with the line, for anything else."""
    if separator is not None:
        count = rows[0][1].count(separator)
        other = next((line for line, text in rows if text.count(separator) != count), None)
        if other is not None and '"' not in rows[0][1]:
            hint = "a decimal point, not a comma, and every line whole"
            raise InputError(
                "has a different number of columns from the lines before", file=file, line=other, hint=hint
            )
    try:
        table = np.loadtxt(
            [text for _, text in rows],
            delimiter=separator,
            usecols=[column.k for column in columns],
            comments=None,
            quotechar='"',
            ndmin=2,
        )
    except ValueError as error:
        found = _AT_ROW.match(str(error))
        line = rows[min(int(found[2]), len(rows) - 1)][0] if found else None
        reason = f"{found[1] if found else error}"[:120]
        hint = "numbers with a decimal point, as many in every line as in the header"
        raise InputError(reason, file=file, line=line, hint=hint) from None
    bad = ~np.isfinite(table)
    if bad.any():
        row, column = np.unravel_index(int(np.argmax(bad)), bad.shape)
        name = columns[int(column)].name[:40]
        raise InputError(f"column {name!r} is no finite number here", file=file, line=rows[int(row)][0])
    return table
