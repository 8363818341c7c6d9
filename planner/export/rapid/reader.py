"""Reader of RAPID: runs the modules of a program, statement by statement."""

from __future__ import annotations

import itertools
import re
from collections.abc import Mapping, Sequence
from functools import lru_cache

import numpy as np

from planner.base.arrays import Array
from planner.base.errors import InputError
from planner.export.arcs import segments
from planner.export.grammar import Statement
from planner.export.program import RobotProgram, Trigger
from planner.export.rapid.extruder import FIRST_PORT, LAST_PORT, OPEN, server
from planner.export.rapid.modules import (
    AT,
    FIRST,
    GRAMMAR,
    ID,
    MORE,
    SPEED_UNITS,
    TO,
    UNIT,
    VIA,
    WORD,
    Module,
    parse,
    target_numbers,
)
from planner.export.rapid.tasks import AROUND, SecondRun, TaskRun, ToolStart, known, moved_together, radians
from planner.export.rapid.text import ZONES

# ----------------------------------------------------------------------------------------------------
# Execution: the motion of all modules, in the order in which they run.

SETTINGS = {"SingArea\\Off", "ConfJ\\On", "ConfL\\Off", "CirPathMode\\ObjectFrame"}
_BIND = re.compile(r'SocketBind bwServer,"(\d{1,3}(?:\.\d{1,3}){3})",(\d{4});', re.ASCII)


def read_rapid(text: str) -> RobotProgram:
    """Program from RAPID text as `writer.rapid` writes it, in one module; otherwise like `read_rapid_files`."""
    return read_rapid_files({GRAMMAR.file: text})


def read_rapid_files(files: Mapping[str, str]) -> RobotProgram:
    """Program from the modules (*.mod) of `writer.rapid_files`; other files are ignored.

    Raises InputError, with file and line, for an unknown statement, name or shape, for two tasks that do not fit
    together, and for several tools.
    """
    first, *others = read_rapid_stretches(files)
    if others:
        reason = f"it changes its tool {len(others)} times: this supports only programs with one tool"
        raise InputError(reason, file=next(iter(files)))
    return first


def read_rapid_stretches(files: Mapping[str, str]) -> tuple[RobotProgram, ...]:
    """What the modules do while each tool is in use, in order; otherwise like `read_rapid_files`."""
    return _read(tuple((file, text) for file, text in files.items() if file.endswith(".mod") or file == GRAMMAR.file))


@lru_cache(maxsize=1)  # a program is first compared with its plan, then used for the forecast
def _read(files: tuple[tuple[str, str], ...]) -> tuple[RobotProgram, ...]:
    return _programs([parse(text, file) for file, text in files])


def _programs(modules: Sequence[Module]) -> tuple[RobotProgram, ...]:
    mains = [each for each in modules if "main" in each.procs]
    seconds = [each for each in mains if each.tasks and not each.wobj]
    if len(mains) != 1 + len(seconds) or len(seconds) > 1:
        raise InputError("no complete module with main, a tool and one work object", file=modules[0].file)
    loaded = {each.parts[1] for main in seconds for each in main.procs["main"] if each.word == "load"}
    own = [each for each in modules if each in seconds or each.name in loaded]
    nozzle = _NozzleRun([each for each in modules if each not in own])
    if bool(nozzle.module.tasks) != bool(seconds):
        raise InputError("one of two modules that belong together is missing", file=modules[0].file)
    programs = nozzle.stretches()
    return (moved_together(programs[0], nozzle, SecondRun(own)),) if seconds else programs


class _NozzleRun(TaskRun):
    """The task that moves the nozzle, and drives the extruder."""

    placed_first = False

    def __init__(self, modules: Sequence[Module]) -> None:
        super().__init__(modules)
        if not self.module.tool or len(self.module.wobj) != 1:
            raise InputError("no complete module with main, a tool and one work object", file=modules[0].file)
        self.trigger: dict[str, Trigger] = {}
        self.demand: dict[str, tuple[float, bool, float]] = {}
        self.outputs: dict[str, None] = {}
        self.flows: set[str] = set()
        self.around: tuple[set[str], set[str]] = (set(), set())
        self.waits: dict[int, float] = {}
        self.sends: dict[int, list[str]] = {}
        self.rested: dict[int, list[float]] = {}
        self.sent = 0
        self.calls: list[str] = []  # of the socket's procedures
        self.follow()
        self.check_around()

    def take(self, statement: Statement) -> None:
        word, parts = statement.word, statement.parts
        at = len(self.moves) - 1
        if word == "move":
            if self.around[1]:
                raise statement.error("a move after the end")
            self.go(statement, parts[ID], parts[AT])
        elif word == "absolute":
            _, identity, _, zone, tool, wobj = parts
            self.begin(statement, identity, zone)
            known(statement, tool, self.module.tool)
            if wobj or not self.module.tasks:  # a work object that another task moves is only for synchronised moves
                known(statement, wobj, () if self.module.tasks else self.module.wobj)
        elif word in ("trigger", "demand"):
            distance, from_start, signal, value = (
                float(parts[1]) * 1e-3,
                bool(parts[2]),
                parts[3],
                parts[4],
            )
            name = known(statement, parts[0], self.module.triggers)
            if word == "trigger":
                self.trigger[name] = Trigger(distance, from_start, value == "1", signal)
                self.outputs[signal] = None
            else:
                self.demand[name] = (distance, from_start, float(value))
                self.flows.add(signal)
        elif word in AROUND:
            if self.begun and not self.moves:
                raise statement.error("it is between the start and the first move")
            self.around[bool(self.moves)].add(" ".join(parts))
        elif word == "wait":
            if at < 0:
                raise statement.error("a wait before the first target")
            self.waits[at] = self.waits.get(at, 0.0) + float(parts[0])
        elif word == "send":
            self.sent += 1
            if self.calls != [OPEN] or at < 0 or int(parts[0]) != self.sent:
                raise statement.error(f"line {parts[0]} is sent out of order")
            self.sends.setdefault(at, []).append(parts[1])
            self.rested.setdefault(at, []).append(self.waits.get(at, 0.0))
        elif word == "socket":
            self.calls.append(parts[0])

    def check_around(self) -> None:
        """Check that outputs are off before and after motion, the station is active, and settings are as written."""
        station = next(iter(self.module.wobj.values()))[0]
        off = {f"{signal} 0" for signal in (*self.outputs, *self.flows)}
        station = "" if self.module.tasks else station  # an arm's unit is always active
        before = off | SETTINGS | ({f"ActUnit {station}"} if station else set())
        after = off | ({f"DeactUnit {station}"} if station else set())
        for where, found, wanted in zip(("before", "after"), self.around, (before, after), strict=True):
            if found != wanted:
                other = ", ".join(sorted(found ^ wanted))
                raise InputError(
                    f"missing in main {where} all moves, or not known there: {other}", file=self.module.file
                )

    def stretches(self) -> tuple[RobotProgram, ...]:
        """The program while each tool is in use."""
        if not self.begun or not self.moves:
            raise InputError("no moves", file=GRAMMAR.file)
        self.check_server()
        ends = [*(start.first for start in self.begun[1:]), len(self.moves)]
        return tuple(self.program(start, end) for start, end in zip(self.begun, ends, strict=True))

    def program(self, start: ToolStart, end: int) -> RobotProgram:
        """The program up to a move (its number) while a tool is in use."""
        speeds, triggers, module = [], {}, self.module
        moves, first_move = self.moves[start.first : end], start.first
        asks: dict[int, list[tuple[float, bool, float]]] = {}
        if not moves:
            raise InputError(f"no moves with {start.tool}", file=module.file)
        for i, move in enumerate(moves):
            word, via, _, _, speed, first, _, _, tool, wobj = move.parts
            if tool != start.tool and tool in module.tool:
                raise move.error(f"it moves {tool} while {start.tool} is in use")
            if tool not in module.tool or wobj not in module.wobj:
                for name, names in ((tool, module.tool), (wobj, module.wobj)):
                    known(move, name, names)
            speeds.append(self.speed(move, speed))
            if bool(first) != word.startswith("Trigg"):
                raise move.error("only TriggL and TriggC have triggers, and must have them")
            if bool(via) != word.endswith("C"):
                raise move.error("only MoveC and TriggC have a via point, and must have one")
            if first:
                used = self.used(move)
                if switches := tuple(self.trigger[name] for name in used if name in self.trigger):
                    triggers[i] = switches
                asks[i] = [self.demand[name] for name in used if name in self.demand]
        table = target_numbers([move.parts[TO] for move in moves])
        position, circular = table[:, :3] * 1e-3, np.array([bool(move.parts[VIA]) for move in moves])
        arcs, postures = np.full_like(position, np.nan), np.full((len(position), 14), np.nan)
        self.check_orientations(moves, table)
        if circular.any():
            on_arcs = [move for move in moves if move.parts[VIA]]
            vias = target_numbers([move.parts[VIA] for move in on_arcs])
            self.check_orientations(on_arcs, vias)
            arcs[circular] = vias[:, :3] * 1e-3
            postures[circular] = np.column_stack([vias[:, [4, 5, 6, 3, 7, 8, 9, 10]], radians(vias[:, 11:])])
        begin = np.vstack([position[:1], position[:-1]])
        lengths = segments(begin, np.where(circular[:, None], arcs, position), position, circular).length
        station, uframe, oframe = next(iter(module.wobj.values()))
        return RobotProgram(
            module=module.name,
            tool=module.tool[start.tool],
            uframe=uframe,
            oframe=oframe,
            station=station,
            start=radians(np.array(start.joints)),
            linear=np.array([move.parts[WORD] != "MoveJ" for move in moves]),
            fine=np.array([move.parts[AT] == "fine" for move in moves]),
            position=position,
            quat=table[:, [4, 5, 6, 3]],
            conf=table[:, 7:11].astype(np.intp),
            external=radians(table[:, 11:]),
            zone=np.array([ZONES[move.parts[AT]] for move in moves]),
            speed=np.array(speeds) * SPEED_UNITS,
            bead=np.array(self.beads[first_move:end]),
            wait=np.array([self.waits.get(i, 0.0) for i in range(first_move, end)]),
            triggers=triggers,
            sends={i - first_move: tuple(texts) for i, texts in self.sends.items() if first_move <= i < end},
            demands={
                i: tuple((float(lengths[i]) - far if from_start else far, value) for far, from_start, value in own)
                for i, own in asks.items()
                if own
            },
            send_rests={i - first_move: tuple(rests) for i, rests in self.rested.items() if first_move <= i < end},
            arcs=arcs if circular.any() else None,
            arc_postures=postures if circular.any() else None,
            approach=np.array(module.speeds[start.approach]) * SPEED_UNITS,
        )

    @staticmethod
    def check_orientations(moves: Sequence[Statement], targets: Array) -> None:
        """Raise InputError for the first move whose target (m, 17) has a quaternion that is not of unit length, which
        stops a controller."""
        length = np.linalg.norm(targets[:, 3:7], axis=1)
        wrong = np.flatnonzero(np.abs(length - 1.0) > UNIT)
        if len(wrong):
            raise moves[wrong[0]].error(f"an orientation whose quaternion has length {length[wrong[0]]:.5g}, not 1")

    def used(self, move: Statement) -> list[str]:
        """The triggers of a move, in order: the first, T2, T3 and so on."""
        numbered = [each.split(":=") for each in move.parts[MORE].split("\\")[1:]]
        if [number for number, _ in numbered] != [f"T{k}" for k in range(2, len(numbered) + 2)]:
            raise move.error("the triggers are not numbered T2, T3, …")
        declared = {**self.trigger, **self.demand}
        return [known(move, name, declared) for name in (move.parts[FIRST], *(name for _, name in numbered))]

    def check_server(self) -> None:
        """Check that the socket's procedures are exactly the standard ones, whatever the address."""
        module, written = self.module, self.module.server

        def error(reason: str, line: int = module.served) -> InputError:
            return InputError(reason, file=module.file, line=line)

        if not written and not self.calls and not self.sent:
            return
        if len(self.calls) != 2 or not written:
            raise error("the socket must be opened once and closed once")
        binds = _BIND.search("\n".join(written))
        if binds is None or not FIRST_PORT <= int(binds[2]) <= LAST_PORT:
            raise error("the socket is bound to an address or port that is not allowed")
        expected = server(module.name, self.sent, binds[1], int(binds[2]), self.outputs, not module.tasks)
        for k, (line, right) in enumerate(itertools.zip_longest(written, expected), module.served):
            if line != right:
                raise error(f"the socket's procedures say {line!r} instead of {right!r}", k)
