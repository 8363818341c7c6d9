"""Reads the KRL that `krl_files` writes back into numbers: a strict subset, where anything unknown is an error."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from planner.errors import InputError
from planner.export.krl.axes import branch_of, quaternions
from planner.export.program import UNSAID, Program, Trigger
from planner.export.rotations import from_matrix
from planner.readonly import Array, Indices

Forward = Callable[[Array], Array]

NUMBER = r"-?[0-9]+(?:\.[0-9]+)?"
NAME = r"[A-Za-z][A-Za-z0-9_]{0,23}"
FRAME = ",".join(rf"{name} ({NUMBER})" for name in "XYZABC")
EXTERNAL = rf"((?:,E[1-6] {NUMBER}){{0,6}})"
AXES = ",".join(rf"A{i} ({NUMBER})" for i in range(1, 7)) + EXTERNAL
PATTERNS = {
    word: re.compile(pattern)
    for word, pattern in {
        "line": rf"LIN \{{E6POS: {FRAME},S ([0-9]{{1,2}}),T ([0-9]{{1,2}}){EXTERNAL}\}}( C_DIS)?",
        "point": rf"PTP \{{E6AXIS: {AXES}\}}( C_PTP)?",
        "speed": rf"\$VEL\.CP=({NUMBER})",
        "radius": rf"\$APO\.CDIS=({NUMBER})",
        "share": r"BAS\(#VEL_PTP,([0-9]{1,3})\)",
        "trigger": r"TRIGGER WHEN (PATH|DISTANCE)=0 DELAY=0 DO \$OUT\[([0-9]{1,4})\]=(TRUE|FALSE)",
        "output": r"\$OUT\[([0-9]{1,4})\]=FALSE",
        "wait": rf"WAIT SEC ({NUMBER})",
        "call": rf"({NAME})\(\)",
        "start": r"PTP XSTART",
        "defaults": r"BAS\(#INITMOV,0\)",
        "setting": r"(\$[A-Z_0-9.]{1,24})=([#A-Z0-9_.(),\[\]]{1,60})",
        "define": rf"DEF ({NAME})\(\)",
        "end": r"END",
        "attribute": r"&(?:ACCESS RVP|REL 1)",
    }.items()
}
DATA = {
    word: re.compile(pattern)
    for word, pattern in {
        "attribute": PATTERNS["attribute"].pattern,
        "define": rf"DEFDAT ({NAME})",
        "frame": rf"DECL FRAME (FTOOL|FPART)=\{{{FRAME}\}}",
        "start": rf"DECL E6AXIS XSTART=\{{{AXES}\}}",
        "end": r"ENDDAT",
    }.items()
}
COUPLED = re.compile(r"EK\((MACHINE_DEF\[[1-9]\])\.ROOT,\1\.MECH_TYPE,FPART\)")
Statement = tuple[str, int, tuple[str | None, ...]]


@dataclass(frozen=True)
class Source:
    """A program (m moves) that was read.

    program   triggers name outputs by their numbers; joints are counted as KUKA does; the zone of an approximated PTP
              is NaN, for it has no distance
    axes      (m, 6) A1 to A6 of PTP targets [rad]; NaN for others
    turn      (m) Turn of LIN targets; UNSAID for others
    share     (m) speed of the axes [percent]
    settings  system variables and what they are set to
    """

    program: Program
    axes: Array
    turn: Indices
    share: Indices
    settings: dict[str, str]


def read_krl(source: str, data: str, forward: Forward) -> Source:
    """Program of the texts of .src and .dat as `krl_files` writes them.

    forward: A1 to A6 and external axes (m, 12) [rad], NaN where unused → T_part_nozzle (m, 4, 4). Raises InputError
    with the line for a statement or name that is not known, or that stands where it must not.
    """
    title, frames, start = _data(data)
    reader = _Reader(title)
    for line, statement in _statements(source):
        reader.take(statement, line)
    return reader.source(frames, start, forward)


def _error(line: int | None, reason: str, file: str = "KRL") -> InputError:
    return InputError(reason, line=line, file=file)


def _statements(text: str) -> list[tuple[int, str]]:
    found = ((line, raw.strip()) for line, raw in enumerate(text.split("\n"), start=1))
    return [(line, statement) for line, statement in found if statement and not statement.startswith(";")]


def _known(patterns: dict[str, re.Pattern[str]], statement: str, line: int, file: str) -> tuple[str, re.Match[str]]:
    for word, pattern in patterns.items():
        if match := pattern.fullmatch(statement):
            return word, match
    raise _error(line, f"unknown statement {statement[:60]!r}", file)


def _posture(parts: tuple[str | None, ...], line: int) -> list[float]:
    """Twelve axes [rad] of six numbers and the text of external axes; NaN where unused."""
    external = [item.split(" ") for item in str(parts[6]).split(",")[1:]]
    if [name for name, _ in external] != [f"E{i}" for i in range(1, len(external) + 1)]:
        raise _error(line, "external axes must stand in their order, each once")
    degrees = [float(str(value)) for value in parts[:6]] + [float(value) for _, value in external]
    return [*np.radians(degrees).tolist(), *[float("nan")] * (12 - len(degrees))]


def _pose(parts: tuple[str | None, ...]) -> Array:
    values = [float(str(value)) for value in parts[:6]]
    return np.concatenate([np.array(values[:3]) * 1e-3, quaternions(np.radians([values[3:]]))[0]])


def _data(text: str) -> tuple[str, dict[str, Array], list[float]]:
    title, frames, start, closed = "", {}, [], False
    for line, statement in _statements(text):
        word, match = _known(DATA, statement, line, "KRL data")
        if word != "attribute" and (closed or (word == "define") == bool(title)):
            raise _error(line, f"{statement[:60]!r} stands outside the data list, or twice", "KRL data")
        if word == "define":
            title = match[1]
        elif word == "frame":
            frames[match[1]] = _pose(match.groups()[1:])
        elif word == "start":
            start = _posture(match.groups(), line)
        closed = closed or word == "end"
    if not closed or len(frames) != 2 or not start:
        raise _error(None, "no complete data list with FTOOL, FPART and XSTART", "KRL data")
    return title, frames, start


class _Reader:
    def __init__(self, title: str) -> None:
        self.title = title
        self.bodies: dict[str, list[Statement]] = {}
        self.current = ""

    def take(self, statement: str, line: int) -> None:
        word, match = _known(PATTERNS, statement, line, "KRL")
        if word == "attribute":
            return
        if (word == "define") == bool(self.current):
            raise _error(line, f"{statement[:60]!r} stands {'inside' if self.current else 'outside'} a program")
        if word == "define":
            if match[1].upper() in (name.upper() for name in self.bodies):
                raise _error(line, f"program {match[1]} stands there twice")
            self.current = match[1]
            self.bodies[match[1]] = []
        elif word == "end":
            self.current = ""
        else:
            self.bodies[self.current].append((word, line, match.groups()))

    def _run(self, name: str, depth: int) -> list[Statement]:
        out: list[Statement] = []
        for word, line, parts in self.bodies[name]:
            if word != "call":
                out.append((word, line, parts))
            elif depth or str(parts[0]) not in self.bodies or parts[0] == self.title:
                raise _error(line, f"{parts[0]} is no program that may be called here")
            else:
                out += self._run(str(parts[0]), depth + 1)
        return out

    def source(self, frames: dict[str, Array], start: list[float], forward: Forward) -> Source:
        if self.current or next(iter(self.bodies), "") != self.title:
            raise _error(None, f"no complete program {self.title}, which its data list is of")
        run = _Run(start)
        for word, line, parts in self._run(self.title, 0):
            run.take(word, line, parts)
        return run.source(self.title, frames, forward)


class _Run:
    """What the statements of a program do, one after the other."""

    def __init__(self, start: list[float]) -> None:
        self.start = start
        self.points: list[list[float]] = []  # twelve axes of each move; NaN for a line's first six
        self.lines: list[tuple[str | None, ...]] = []
        self.linear: list[bool] = []
        self.fly: list[bool] = []
        self.paces: list[tuple[float, float, int]] = []  # speed, radius, percent
        self.triggers: dict[int, tuple[Trigger, ...]] = {}
        self.waiting: tuple[Trigger, ...] = ()
        self.waits: dict[int, float] = {}
        self.off: list[tuple[int, int]] = []  # moves after which an output is set, and lines
        self.settings: dict[str, str] = {}
        self.speed, self.radius, self.share = np.nan, np.nan, 100

    def take(self, word: str, line: int, parts: tuple[str | None, ...]) -> None:
        at = len(self.points) - 1
        if word in ("start", "line", "point", "wait", "trigger") and (word == "start") == (at >= 0):
            raise _error(line, "the program begins with PTP XSTART, and goes there once")
        first = str(parts[0]) if parts else ""
        if word == "speed":
            self.speed = float(first)
        elif word == "radius":
            self.radius = float(first) * 1e-3
        elif word == "share":
            self.share = int(first)
        elif word == "setting":
            self.settings[first] = str(parts[1])
        elif word == "wait":
            self.waits[at] = self.waits.get(at, 0.0) + float(first)
        elif word == "output":
            self.off.append((at, line))
        elif word == "trigger":
            self.waiting += (Trigger(0.0, first == "DISTANCE", parts[2] == "TRUE", str(parts[1])),)
        elif word == "line":
            if not (self.speed > 0.0 and (self.radius > 0.0 or parts[9] is None)):
                raise _error(line, "a line without a speed, or approximated without a distance")
            external = _posture((*["0"] * 6, parts[8]), line)[6:]
            self._move(parts, [np.nan] * 6 + external, parts[9] is not None)
        elif word in ("start", "point"):
            if self.waiting:
                raise _error(line, "a trigger belongs to a line")
            self._move((), _posture(parts, line) if parts else self.start, bool(parts) and parts[7] is not None)

    def _move(self, pose: tuple[str | None, ...], axes: list[float], fly: bool) -> None:
        if self.waiting:
            self.triggers[len(self.points)] = self.waiting
            self.waiting = ()
        self.lines.append(pose)
        self.points.append(axes)
        self.linear.append(bool(pose))
        self.fly.append(fly)
        self.paces.append((self.speed if pose else np.nan, self.radius if pose else np.nan, self.share))

    def source(self, title: str, frames: dict[str, Array], forward: Forward) -> Source:
        if not any(self.linear) or self.waiting:
            raise _error(None, "no lines, or a trigger without one")
        m = len(self.points)
        for at, line in self.off:
            if at not in (-1, m - 1):
                raise _error(line, "an output is switched beside the path")
        linear, stops = np.array(self.linear), ~np.array(self.fly)
        axes, paces = np.array(self.points), np.array(self.paces)
        pose, conf, turn = np.empty((m, 7)), np.full((m, 4), UNSAID, dtype=np.intp), np.full(m, UNSAID, dtype=np.intp)
        rows = np.array([[float(str(value)) for value in parts[:8]] for parts in self.lines if parts])
        pose[linear] = np.column_stack([rows[:, :3] * 1e-3, quaternions(np.radians(rows[:, 3:6]))])
        conf[linear, 3], turn[linear] = branch_of(rows[:, 6].astype(np.intp)), rows[:, 7]
        T = forward(axes[~linear])
        pose[~linear] = np.column_stack([T[:, :3, 3], from_matrix(T[:, :3, :3])])
        base = COUPLED.fullmatch(self.settings.get("$BASE", ""))
        if (base is None and self.settings.get("$BASE") != "FPART") or self.settings.get("$TOOL") != "FTOOL":
            raise _error(None, "$BASE and $TOOL are not set to FPART and FTOOL")
        still = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
        program = Program(
            module=title,
            tool=frames["FTOOL"],
            uframe=frames["FPART"] if base is None else still,
            oframe=still if base is None else frames["FPART"],
            station="" if base is None else base[1],
            start=np.array(self.start),
            linear=linear,
            fine=stops,
            position=pose[:, :3],
            quat=pose[:, 3:],
            conf=conf,
            external=axes[:, 6:],
            zone=np.where(stops, 0.0, paces[:, 1]),
            speed=np.column_stack([paces[:, 0], np.full((m, 3), np.nan)]),
            wait=np.array([self.waits.get(i, 0.0) for i in range(m)]),
            triggers=self.triggers,
            sends={},
        )
        return Source(program, axes[:, :6], turn, paces[:, 2].astype(np.intp), self.settings)
