"""Running RAPID tasks: what main calls and loads, where two tasks meet, and the task that moves the part."""

from __future__ import annotations

import re
from collections import ChainMap
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from planner.base.arrays import Array
from planner.base.errors import InputError
from planner.export.grammar import Statement
from planner.export.program import RobotProgram
from planner.export.rapid.modules import SHAPE_JOINTS, SPEED_UNITS, Module, numbers
from planner.export.rapid.multimove import TASKS, UNDO
from planner.export.rapid.text import NOT_LOADED, OWN_ZONES
from planner.plan import TRAVEL

# ----------------------------------------------------------------------------------------------------
# Any task.

# Statements before and after the motion, only in main: all must be there, before the start or after the last move.
AROUND = ("setting", "unit", "output", "demanded")
ONLY_MAIN = ("call", "late", "load", "meet", *AROUND)  # allowed only in main
MEETINGS = ("WaitSyncTask", "SyncMoveOn", "SyncMoveOff")  # of two tasks, once each and in this order
_BEAD = re.compile(r"Bead(\d+)")  # procedures are numbered from 1
BINDS = "both tasks must wait for each other, move together and part, once each"


def radians(degrees: Array) -> Array:
    """Angles [rad]; 9E9 means unused, here NaN."""
    return np.where(degrees > 1e9, np.nan, np.radians(degrees))


def known(statement: Statement, name: str, names: Collection[str]) -> str:
    """The name; raises InputError if it is not among `names`."""
    if name not in names:
        raise statement.error(f"unknown name {name!r}")
    return name


@dataclass(frozen=True)
class ToolStart:
    """Where a tool comes into use: its name, joints [deg], the name of the speed on the way there, and the number of
    its first move."""

    tool: str
    joints: list[float]
    approach: str
    first: int


class TaskRun:
    """Run of one task's modules, statement by statement; subclasses take the statements that move or switch.

    module     the one with main
    begun      the start, and where further tools come into use
    moves, zones, beads, identities   of all further moves: beads are those whose procedures contain them, identities
               are shared with another task's moves
    met        where the task waits for the other one, and where synchronised motion begins and ends
    """

    placed_first: ClassVar[bool]  # it goes to its start before it waits for the other task, not after

    def __init__(self, modules: Sequence[Module]) -> None:
        self.module, *others = sorted(modules, key=lambda each: "main" not in each.procs)
        self.others = {each.name: each for each in others}
        self.loaded: dict[str, Module] = {}
        self.cleared: set[str] = set()
        self.begun: list[ToolStart] = []
        self.moves: list[Statement] = []
        self.zones: list[str] = []
        self.beads: list[int] = []
        self.bead = TRAVEL  # whose procedure is being followed
        self.identities: list[int] = []
        self.met: list[tuple[str, str]] = []
        for each in others:
            declared = (
                each.tool,
                each.wobj,
                each.speeds,
                each.zones,
                each.triggers,
                each.tasks,
                each.points,
                each.server,
            )
            if any(declared):
                raise InputError("a loaded module may have procedures and nothing else", file=each.file)
        first: dict[str, str] = {}
        for each in modules:
            for proc in each.procs:
                there = first.setdefault(proc.lower(), each.file)
                if there is not each.file:
                    raise InputError(f"procedure {proc} is defined twice, first in {there}", file=each.file)

    def take(self, statement: Statement) -> None:
        """A statement that moves, switches, waits or sends."""
        raise NotImplementedError

    def follow(self) -> None:
        """Follow main to its end. Raises InputError if modules or meetings are not as required."""
        file, loads = self.module.file, self._run()
        expected = [*(NOT_LOADED if loads else ()), *(UNDO if self.module.tasks else ())]
        if self.module.fallback != [line.strip() for line in expected]:
            raise InputError("main handles errors other than a module that was not loaded", file=file)
        if self.cleared != loads:
            left = ", ".join(sorted(loads - self.cleared))
            raise InputError(f"modules that an earlier run may have left loaded are not unloaded: {left}", file=file)
        if set(self.others) != loads:
            raise InputError(f"not loaded: {', '.join(sorted(set(self.others) - loads))}", file=file)
        words = tuple(word for word, _ in self.met)
        if words != (MEETINGS if self.module.tasks else ()):
            raise InputError(f"{MEETINGS[len(words)]} is missing: {BINDS}", file=file)

    def _run(self) -> set[str]:
        """Follow main; returns the names of all modules that were loaded."""
        loads: set[str] = set()
        for statement in self.module.procs["main"]:
            if statement.word == "call":
                self._call(statement, self.module.procs)
            elif statement.word == "late":
                self._call(statement, ChainMap(*(each.procs for each in reversed(self.loaded.values()))))
            elif statement.word == "load":
                way, name = statement.parts
                if way == "UnLoad " and not self.begun:
                    self.cleared.add(known(statement, name, self.others))
                    continue
                if not self.zones or self.zones[-1] != "fine":
                    raise statement.error("modules may be loaded and unloaded only at rest")
                if way == "UnLoad ":
                    self.loaded.pop(known(statement, name, self.loaded))
                else:
                    other = known(statement, name, set(self.others) - set(self.loaded))
                    self.loaded[other] = self.others[other]
                    loads.add(other)
            elif statement.word == "meet":
                self._meet(statement)
            else:
                self.take(statement)
        return loads

    def _call(self, statement: Statement, procs: Mapping[str, list[Statement]]) -> None:
        name = known(statement, statement.parts[0], procs)
        bead = _BEAD.fullmatch(name)
        self.bead = TRAVEL if bead is None else int(bead[1]) - 1
        for inner in procs[name]:
            if inner.word in ONLY_MAIN:
                raise inner.error("only main calls procedures, loads modules, and sets what holds for all")
            self.take(inner)

    def _meet(self, statement: Statement) -> None:
        """A point at which this task waits for the other one."""
        word, name, tasks = statement.parts
        if len(self.met) == len(MEETINGS) or word != MEETINGS[len(self.met)]:
            raise statement.misplaced(f"out of order: {BINDS}")
        known(statement, name, self.module.points - {name for _, name in self.met})
        if tasks != ("" if word == "SyncMoveOff" else self.module.tasks):
            raise statement.error("it names no tasks" if not tasks else f"unknown name {tasks!r}")
        here = {
            "WaitSyncTask": bool(self.begun) is self.placed_first and not self.moves,
            "SyncMoveOn": bool(self.begun) and not self.moves,
            "SyncMoveOff": bool(self.zones) and self.zones[-1] == "fine",
        }
        if not here[word]:
            raise statement.misplaced(
                "where an arm moves, or has not gone to its start, or has gone before the other one"
            )
        self.met.append((word, name))

    def begin(self, statement: Statement, identity: str, zone: str) -> None:
        """The way to the start, which is not synchronised with another task; later, a change of tool, made at rest.

        Raises InputError otherwise."""
        joints, _, speed, _, tool, _ = statement.parts
        if self.begun and (not self.moves or self.begun[-1].tool == tool or self.module.tasks):
            raise statement.error("MoveAbsJ is only for the start and for a change of tool")
        if self.begun and (self.zones[-1] != "fine" or self.begun[-1].first == len(self.moves)):
            raise statement.error("a tool may be changed only at rest")
        if identity or zone != "fine":
            raise statement.error("the way to the start must end at rest, without \\ID")
        there = numbers(joints, SHAPE_JOINTS, statement)
        self.begun.append(ToolStart(tool, there, known(statement, speed, self.module.speeds), len(self.moves)))

    def go(self, statement: Statement, identity: str, zone: str) -> None:
        """A move. Raises InputError if it has an identity that it must not have, or lacks one that it needs."""
        together = len(self.met) == 2
        if bool(identity) != together:
            raise statement.error(
                "no \\ID, though both arms move together" if together else "an \\ID outside SyncMoveOn"
            )
        if identity:
            if self.identities and int(identity) <= self.identities[-1]:
                raise statement.error(f"\\ID:={identity} does not follow \\ID:={self.identities[-1]}")
            self.identities.append(int(identity))
        if zone in OWN_ZONES:
            known(statement, zone, self.module.zones)
        self.moves.append(statement)
        self.zones.append(zone)
        self.beads.append(self.bead)

    def speed(self, statement: Statement, name: str) -> list[float]:
        """The numbers of a speeddata. Raises InputError if it is unknown, or has a speed of 0."""
        found = self.module.speeds[known(statement, name, self.module.speeds)]
        if min(found) <= 0.0:
            raise statement.error(f"{name} has a speed that is not above 0")
        return found


# ----------------------------------------------------------------------------------------------------
# The task that moves the part.


class SecondRun(TaskRun):
    """The task of a second arm, whose flange carries the part; it only moves to joint targets."""

    placed_first = True

    def __init__(self, modules: Sequence[Module]) -> None:
        super().__init__(modules)
        tools = list(self.module.tool.values())
        if len(tools) != 1 or np.abs(tools[0] - [0, 0, 0, 0, 0, 0, 1]).max() > 0.0 or self.module.triggers:
            raise InputError("the task that moves the part must have one tool, at its flange", file=self.module.file)
        self.follow()

    def take(self, statement: Statement) -> None:
        """A move to joints: the way to the start, or a move synchronised with one of the other task."""
        if statement.word != "absolute":
            raise statement.misplaced("in the task that moves the part")
        _, identity, _, zone, tool, wobj = statement.parts
        known(statement, tool, self.module.tool)
        if wobj:
            raise statement.error("a work object for the arm that moves the part")
        (self.go if self.met else self.begin)(statement, identity, zone)


def moved_together(program: RobotProgram, nozzle: TaskRun, second: SecondRun) -> RobotProgram:
    """The nozzle's program with the moves of the arm that moves the part.

    Raises InputError if a controller would not run both, or one would wait for the other for ever.
    """
    file = second.module.file
    if (nozzle.module.tasks, nozzle.met) != (second.module.tasks, second.met):
        raise InputError(f"it meets {nozzle.module.file} at other points, or with other tasks", file=file)
    for (k, one), other in zip(enumerate(nozzle.moves), second.moves, strict=False):
        if nozzle.identities[k] != second.identities[k]:
            words = f"\\ID:={second.identities[k]} meets \\ID:={nozzle.identities[k]} of {one.file}, line {one.line}"
            raise other.error(f"{words}: both would wait for ever")
        if nozzle.zones[k] != second.zones[k]:
            raise other.error(f"zone {second.zones[k]}, and {nozzle.zones[k]} in {one.file}, line {one.line}")
    if len(nozzle.moves) != len(second.moves):
        words = f"{len(second.moves)} moves together with {len(nozzle.moves)} of {nozzle.module.file}"
        raise InputError(f"{words}: one would wait for ever", file=file)
    if program.station not in TASKS:
        raise InputError(f"its work object is moved by {program.station!r}, not by an arm", file=nozzle.module.file)
    if not (np.isnan(program.external).all() and np.isnan(program.start[6:]).all()):
        raise InputError("it has external axes besides a second arm", file=nozzle.module.file)
    joints = radians(
        np.array([second.begun[0].joints, *(numbers(each.parts[0], SHAPE_JOINTS, each) for each in second.moves)])
    )
    if np.isnan(joints[:, :6]).any() or not np.isnan(joints[:, 6:]).all():
        raise InputError("a target with axes other than the arm's six joints", file=file)
    speeds = [
        second.module.speeds[second.begun[0].approach],
        *(second.speed(each, each.parts[2]) for each in second.moves),
    ]
    return replace(
        program,
        start=np.concatenate([program.start[:6], joints[0, :6]]),
        external=joints[1:, :6],
        second=np.array(speeds) * SPEED_UNITS,
    )
