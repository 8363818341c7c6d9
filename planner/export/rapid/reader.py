"""Reader of RAPID: exactly the subset that `writer` uses; anything else is an error with its line."""

from __future__ import annotations

import itertools
import re
from collections import ChainMap
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from planner.base.arrays import Array
from planner.base.errors import InputError
from planner.export.arcs import segments
from planner.export.grammar import Grammar, Statement
from planner.export.program import RobotProgram, Trigger
from planner.export.rapid.extruder import (
    END,
    FIRST_PORT,
    LAST_PORT,
    LATEST,
    LINE,
    LONGEST_LINE,
    OPEN,
    SETTLE,
    server,
    server_declarations,
)
from planner.export.rapid.text import HOME, NOT_LOADED, OWN_ZONES, ZONES

# ----------------------------------------------------------------------------------------------------
# Statements, and where each may stand in a module.

NUMBER = r"-?[0-9]+(?:\.[0-9]+)?(?:E[0-9]+)?"
_NUMBER = re.compile(NUMBER)
NAME = r"[A-Za-z][A-Za-z0-9_]{0,31}"
NEST = r"\[[-0-9.,E\[\]]*\]"
NEST_TARGET = r"\[\[[-0-9.,E]*(?:\],\[[-0-9.,E]*)*\]\]"  # ends where another one begins, whatever is in it
NEST_ZONE = r"\[FALSE(?:,[0-9.]+){6}\]"
POSE = r"\[\[[-0-9.,E]*\],\[[-0-9.,E]*\]\]"
MOST_TRIGGERS = 8  # ABB, RAPID reference, TriggL: T1 to T8
_TRIGGERS = rf"({NAME})((?:\\T[2-{MOST_TRIGGERS}]:={NAME})*)"
# numbers of a target; almost every line is a move that has them, and is recognised at once
_TARGET = "],\\[".join(",".join([NUMBER] * count) for count in (3, 4, 4, 6))
MISSHAPEN = "move without a target"
_ZONE = "|".join(ZONES)
_END = rf"({NAME})(?:,{_TRIGGERS})?,({_ZONE}),({NAME})\\WObj:=({NAME});"
_MOVE = rf"(MoveJ|MoveL|MoveC|TriggL|TriggC) (?:({{target}}),)?({{target}}),{_END}"
_WORD, _VIA, _TO, _SPEED, _FIRST, _MORE, _AT, _TOOL, _WOBJ = range(9)  # parts of a move
GRAMMAR = Grammar.of(
    "RAPID",
    "!",
    {
        "move": _MOVE.replace("{target}", rf"\[\[{_TARGET}\]\]"),
        "module": rf"MODULE ({NAME})",
        "tool": rf"PERS tooldata ({NAME}):=\[TRUE,({POSE}),{NEST}\];",
        "wobj": rf'PERS wobjdata ({NAME}):=\[FALSE,(TRUE|FALSE),"({NAME})?",({POSE}),({POSE})\];',
        "speed": rf"CONST speeddata ({NAME}):=({NEST});",
        "zone": rf"CONST zonedata ({NAME}):=({NEST_ZONE});",
        "variable": rf"VAR triggdata ({NAME});",
        "trigger": rf"TriggIO ({NAME}),({NUMBER})(\\Start)?\\DOp:=({NAME}),([01]);",
        "proc": rf"PROC ({NAME})\(\)",
        "demand": rf"TriggIO ({NAME}),({NUMBER})(\\Start)?\\AOp:=({NAME}),({NUMBER});",
        "absolute": rf"MoveAbsJ ({NEST}),({NAME}),fine,({NAME})\\WObj:=({NAME});",
        MISSHAPEN: _MOVE.replace("{target}", NEST_TARGET),
        "wait": rf"WaitTime ({NUMBER});",
        "unit": rf"(ActUnit|DeactUnit) ({NAME});",
        "output": rf"SetDO ({NAME}),([01]);",
        "demanded": rf"SetAO ({NAME}),({NUMBER});",
        "load": rf'(Load \\Dynamic,|UnLoad )"{HOME}"\\File:="({NAME}).mod";',
        "late": rf'%"({NAME})"%;',
        "error": r"(ERROR)",
        "write": r'TPWrite "([^"]{0,80})";',
        "send": rf'{LINE} ([0-9]{{1,7}}),"([A-Z][-A-Z0-9 .]{{0,{LONGEST_LINE - 1}}})";',
        "settle": rf"{SETTLE} {LATEST};",
        "socket": rf"({OPEN}|{END});",
        "setting": r"(SingArea\\Off|ConfJ\\On|ConfL\\Off|CirPathMode\\ObjectFrame);",
        "end": r"(ENDPROC|ENDMODULE)",
        "call": rf"({NAME});",
    },
)
DECLARATIONS = ("module", "tool", "wobj", "speed", "zone", "variable", "proc")
UNIT = 1e-5  # by which a quaternion's length may miss 1: numbers have 7 decimals
SPEED_UNITS = np.array([1e-3, np.pi / 180.0, 1e-3, np.pi / 180.0])  # of a speeddata
SHAPE_POSE, SHAPE_TARGET, SHAPE_JOINTS = "[3,4]", "[3,4,4,6]", "[6,6]"


def numbers(nest: str, shape: str, statement: Statement) -> list[float]:
    """Flat numbers of a nested list such as [[1,2,3],[1,0,0,0]], whose inner lengths must be `shape`, e.g. [3,4].

    Raises InputError with the statement's line where they are not.
    """
    groups = nest[2:-2].split("],[") if nest.startswith("[[") and nest.endswith("]]") else [nest[1:-1]]
    items = [group.split(",") for group in groups]
    if f"[{','.join(str(len(item)) for item in items)}]" != shape:
        raise statement.error(f"expected lists of lengths {shape} in {nest[:60]}")
    flat = [value for item in items for value in item]
    for value in flat:
        if not _NUMBER.fullmatch(value):
            raise statement.error(f"{value!r} is not a number")
    return [float(value) for value in flat]


def target_numbers(nests: Sequence[str]) -> Array:
    """Numbers (m, 17) of targets that are known to have the right shape."""
    # one conversion for all: the same correctly rounded numbers as float() gives, in a tenth of the time
    flat = ",".join(nests).translate(str.maketrans("", "", "[]"))
    return np.fromstring(flat, sep=",").reshape(len(nests), 17)


def pose(nest: str, statement: Statement) -> Array:
    """Position [m] and quaternion x y z w (7) of a RAPID pose."""
    x, y, z, qw, qx, qy, qz = numbers(nest, SHAPE_POSE, statement)
    return np.array([x * 1e-3, y * 1e-3, z * 1e-3, qx, qy, qz, qw])


@dataclass(frozen=True)
class Module:
    """What stands in a module. `server` holds the lines of the socket's procedures, from `served` on, unread."""

    file: str
    name: str = ""
    tool: dict[str, Array] = field(default_factory=dict)
    wobj: dict[str, tuple[str, Array, Array]] = field(default_factory=dict)
    speeds: dict[str, list[float]] = field(default_factory=dict)
    zones: set[str] = field(default_factory=set)
    triggers: set[str] = field(default_factory=set)
    procs: dict[str, list[Statement]] = field(default_factory=dict)
    server: list[str] = field(default_factory=list)
    served: int = 0
    fallback: list[str] = field(default_factory=list)


def parse(text: str, file: str) -> Module:
    """The statements of one module. Raises InputError with the line for what is not known, or stands where it may not."""
    parser = _Parser(file)
    raw = text.split("\n")
    begins = f"    PROC {OPEN}()"
    served = raw.index(begins) if begins in raw else len(raw)
    closes = max(served, len(raw) - 2)
    for line, text_ in enumerate(map(str.strip, raw), start=1):
        if text_ and not text_.startswith(GRAMMAR.comment) and not served < line <= closes:
            parser.take(text_, line)
    if not parser.closed:
        raise InputError("no complete module: ENDMODULE is missing", file=file)
    if parser.declared != (server_declarations() if served < len(raw) else []):
        raise InputError("the variables of the socket are others than its procedures need", file=file, line=served)
    return replace(parser.module, name=parser.name, server=raw[served:closes], served=served + 1)


class _Parser:
    def __init__(self, file: str) -> None:
        self.module = Module(file)
        self.name = ""
        self.names: dict[str, int] = {}
        self.declared: list[str] = []
        self.current = ""
        self.handling = False  # behind ERROR of main
        self.closed = False

    def take(self, text: str, line: int) -> None:
        if self.handling and text != "ENDPROC":
            self.module.fallback.append(text)
            return
        if self.name and not self.current and not self.closed and f"    {text}" in server_declarations():
            self.declared.append(f"    {text}")
            return
        statement = GRAMMAR.statement(text, line, self.module.file)
        word = statement.word
        if self.closed or (word != "module") == (not self.name):
            raise statement.misplaced("outside the module")
        inside = word not in DECLARATIONS and text != "ENDMODULE"
        if inside != bool(self.current):
            raise statement.misplaced(f"{'outside' if inside else 'inside'} a procedure")
        if word == "error":
            self.handling = True
            self.module.fallback.append(text)
        elif word == "end":
            self.handling = False
            self.closed = text == "ENDMODULE"
            self.current = ""
        elif word in DECLARATIONS:
            self.declare(statement)
        elif word == MISSHAPEN:
            for target in filter(None, statement.parts[_VIA : _TO + 1]):
                numbers(target, SHAPE_TARGET, statement)  # says what is wrong with it
        else:
            self.module.procs[self.current].append(statement)

    def declare(self, statement: Statement) -> None:
        parts, module = statement.parts, self.module
        name = parts[0]
        if name.lower() in self.names:  # RAPID does not tell capitals from small letters
            what = "procedure" if statement.word == "proc" else "name"
            raise statement.error(f"{what} {name} stands there twice, first in line {self.names[name.lower()]}")
        self.names[name.lower()] = statement.line
        if statement.word == "module":
            self.name = name
        elif statement.word == "tool":
            module.tool[name] = pose(parts[1], statement)
        elif statement.word == "wobj":
            if (parts[1] == "FALSE") != bool(parts[2]):
                raise statement.error("a work object moves if, and only if, it names a station")
            module.wobj[name] = (parts[2], pose(parts[3], statement), pose(parts[4], statement))
        elif statement.word == "speed":
            module.speeds[name] = numbers(parts[1], "[4]", statement)
        elif statement.word == "zone":
            if OWN_ZONES.get(name) != parts[1]:
                raise statement.error(f"zone {name} is none that these programs have")
            module.zones.add(name)
        elif statement.word == "variable":
            module.triggers.add(name)
        else:
            self.current = name
            module.procs[name] = []


# ----------------------------------------------------------------------------------------------------
# Execution: the motion of all modules, in the order in which they run.

# What stands around the motion, in main alone: it must all be there, before the start or behind the last move.
AROUND = ("setting", "unit", "output", "demanded")
SETTINGS = {"SingArea\\Off", "ConfJ\\On", "ConfL\\Off", "CirPathMode\\ObjectFrame"}
_BIND = re.compile(r'SocketBind bwServer,"(\d{1,3}(?:\.\d{1,3}){3})",(\d{4});', re.ASCII)


def read_rapid(text: str) -> RobotProgram:
    """Program of RAPID text as `writer.rapid` writes it, in one module; else as `read_rapid_files`."""
    return read_rapid_files({GRAMMAR.file: text})


def read_rapid_files(files: Mapping[str, str]) -> RobotProgram:
    """Program of the modules (*.mod) of `writer.rapid_files`, whatever else there is.

    Raises InputError with file and line for a statement, name or shape that is not known, and for several tools.
    """
    first, *others = read_rapid_stretches(files)
    if others:
        raise InputError(
            f"it changes its tool {len(others)} times: this is made for programs with one", file=next(iter(files))
        )
    return first


def read_rapid_stretches(files: Mapping[str, str]) -> tuple[RobotProgram, ...]:
    """What the modules do while each tool is in use, in order; the rest as `read_rapid_files`."""
    modules = [parse(text, file) for file, text in files.items() if file.endswith(".mod") or file == GRAMMAR.file]
    return _RapidRun(modules).stretches()


def _radians(degrees: Array) -> Array:
    """Angles [rad]; 9E9 means unused, here NaN."""
    return np.where(degrees > 1e9, np.nan, np.radians(degrees))


def _known(statement: Statement, name: str, names: Collection[str]) -> str:
    if name not in names:
        raise statement.error(f"unknown name {name!r}")
    return name


@dataclass(frozen=True)
class ToolStart:
    """Where a tool comes into use: its name, joints and speed of the way there as written, and its first move (number)."""

    tool: str
    joints: list[float]
    approach: list[float]
    first: int


class _RapidRun:
    """What the modules do, statement by statement."""

    def __init__(self, modules: Sequence[Module]) -> None:
        mains = [module for module in modules if "main" in module.procs]
        if len(mains) != 1 or not mains[0].tool or len(mains[0].wobj) != 1:
            raise InputError("no complete module with main, a tool and one work object", file=modules[0].file)
        self.module = mains[0]
        self.others = {module.name: module for module in modules if module is not self.module}
        self.loaded: dict[str, Module] = {}
        self.cleared: set[str] = set()
        self.trigger: dict[str, Trigger] = {}
        self.demand: dict[str, tuple[float, bool, float]] = {}
        self.outputs: dict[str, None] = {}
        self.flows: set[str] = set()
        self.around: tuple[set[str], set[str]] = (set(), set())
        self.begun: list[ToolStart] = []
        self.moves: list[Statement] = []
        self.waits: dict[int, float] = {}
        self.sends: dict[int, list[str]] = {}
        self.rested: dict[int, list[float]] = {}
        self.sent = 0
        self.calls: list[str] = []  # of the socket's procedures
        for module in self.others.values():
            if any((module.tool, module.wobj, module.speeds, module.zones, module.triggers, module.server)):
                raise InputError("a module that is loaded has procedures and nothing else", file=module.file)
        known: dict[str, str] = {}
        for module in modules:
            for proc in module.procs:
                first = known.setdefault(proc.lower(), module.file)
                if first is not module.file:
                    raise InputError(f"procedure {proc} stands there twice, first in {first}", file=module.file)
        loads = self.run()
        self.check_around()
        if self.module.fallback != ([line.strip() for line in NOT_LOADED] if loads else []):
            raise InputError("main handles other errors than that a module was not loaded", file=self.module.file)
        if self.cleared != loads:
            left = ", ".join(sorted(loads - self.cleared))
            raise InputError(f"what is loaded before it begins is not taken out: {left}", file=self.module.file)
        if set(self.others) != loads:
            raise InputError(f"not loaded: {', '.join(sorted(set(self.others) - loads))}", file=self.module.file)

    def run(self) -> set[str]:
        """Follow main; returns the names of all modules that were loaded."""
        loads: set[str] = set()
        for statement in self.module.procs["main"]:
            if statement.word == "call":
                self.call(statement, self.module.procs)
            elif statement.word == "late":
                self.call(statement, ChainMap(*(each.procs for each in reversed(self.loaded.values()))))
            elif statement.word == "load":
                way, name = statement.parts
                if way == "UnLoad " and not self.begun:
                    self.cleared.add(_known(statement, name, self.others))
                    continue
                if not self.moves or self.moves[-1].parts[_AT] != "fine":
                    raise statement.error("modules are loaded, and taken out, at rest")
                if way == "UnLoad ":
                    self.loaded.pop(_known(statement, name, self.loaded))
                else:
                    other = _known(statement, name, set(self.others) - set(self.loaded))
                    self.loaded[other] = self.others[other]
                    loads.add(other)
            else:
                self.take(statement)
        return loads

    def call(self, statement: Statement, procs: Mapping[str, list[Statement]]) -> None:
        for inner in procs[_known(statement, statement.parts[0], procs)]:
            if inner.word in ("call", "late", "load", *AROUND):
                raise inner.error("only main calls procedures, loads modules, and sets what holds for all")
            self.take(inner)

    def take(self, statement: Statement) -> None:
        word, parts = statement.word, statement.parts
        at = len(self.moves) - 1
        if word == "move":
            if self.around[1]:
                raise statement.error("a move behind the end")
            self.moves.append(statement)
        elif word == "absolute":
            self.begin(statement)
        elif word in ("trigger", "demand"):
            distance, from_start, signal, value = (
                float(parts[1]) * 1e-3,
                bool(parts[2]),
                parts[3],
                parts[4],
            )
            name = _known(statement, parts[0], self.module.triggers)
            if word == "trigger":
                self.trigger[name] = Trigger(distance, from_start, value == "1", signal)
                self.outputs[signal] = None
            else:
                self.demand[name] = (distance, from_start, float(value))
                self.flows.add(signal)
        elif word in AROUND:
            if self.begun and not self.moves:
                raise statement.error("it stands between the start and the first move")
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

    def begin(self, statement: Statement) -> None:
        """The way to the start, or a change of the tool, which is made at rest."""
        joints, speed, tool, wobj = statement.parts
        if self.begun and (not self.moves or self.begun[-1].tool == tool):
            raise statement.error("MoveAbsJ is for the start, and for a change of the tool")
        if self.begun and (self.moves[-1].parts[_AT] != "fine" or self.begun[-1].first == len(self.moves)):
            raise statement.error("a tool is changed at rest")
        _known(statement, wobj, self.module.wobj)
        there = numbers(joints, SHAPE_JOINTS, statement)
        approach = self.module.speeds[_known(statement, speed, self.module.speeds)]
        self.begun.append(ToolStart(_known(statement, tool, self.module.tool), there, approach, len(self.moves)))

    def check_around(self) -> None:
        """Outputs are off before and after, the station is active, and singularities and configurations are as written."""
        station = next(iter(self.module.wobj.values()))[0]
        off = {f"{signal} 0" for signal in (*self.outputs, *self.flows)}
        before = off | SETTINGS | ({f"ActUnit {station}"} if station else set())
        after = off | ({f"DeactUnit {station}"} if station else set())
        for where, found, wanted in zip(("before", "behind"), self.around, (before, after), strict=True):
            if found != wanted:
                other = ", ".join(sorted(found ^ wanted))
                raise InputError(
                    f"missing in main {where} all moves, or not known there: {other}", file=self.module.file
                )

    def stretches(self) -> tuple[RobotProgram, ...]:
        """What is done while each tool is in use."""
        if not self.begun or not self.moves:
            raise InputError("no moves", file=GRAMMAR.file)
        self.check_server()
        ends = [*(start.first for start in self.begun[1:]), len(self.moves)]
        return tuple(self.program(start, end) for start, end in zip(self.begun, ends, strict=True))

    def program(self, start: ToolStart, end: int) -> RobotProgram:
        """What is done up to a move (its number) while a tool is in use."""
        speeds, triggers, module = [], {}, self.module
        moves, first_move = self.moves[start.first : end], start.first
        asks: dict[int, list[tuple[float, bool, float]]] = {}
        if not moves:
            raise InputError(f"no moves with {start.tool}", file=module.file)
        for i, move in enumerate(moves):
            word, via, _, speed, first, _, zone, tool, wobj = move.parts
            if tool != start.tool and tool in module.tool:
                raise move.error(f"it moves {tool} while {start.tool} is in use")
            if speed not in module.speeds or tool not in module.tool or wobj not in module.wobj:
                for name, names in ((speed, module.speeds), (tool, module.tool), (wobj, module.wobj)):
                    _known(move, name, names)
            if min(module.speeds[speed]) <= 0.0:
                raise move.error(f"{speed} has a speed that is not above 0")
            speeds.append(module.speeds[speed])
            if bool(first) != word.startswith("Trigg"):
                raise move.error("TriggL and TriggC, and nothing else, have triggers")
            if bool(via) != word.endswith("C"):
                raise move.error("MoveC and TriggC, and nothing else, have a point on the way")
            if zone in OWN_ZONES and zone not in module.zones:
                _known(move, zone, module.zones)
            if first:
                used = self.used(move)
                if switches := tuple(self.trigger[name] for name in used if name in self.trigger):
                    triggers[i] = switches
                asks[i] = [self.demand[name] for name in used if name in self.demand]
        table = target_numbers([move.parts[_TO] for move in moves])
        position, circular = table[:, :3] * 1e-3, np.array([bool(move.parts[_VIA]) for move in moves])
        arcs, postures = np.full_like(position, np.nan), np.full((len(position), 14), np.nan)
        self.check_orientations(moves, table)
        if circular.any():
            on_arcs = [move for move in moves if move.parts[_VIA]]
            vias = target_numbers([move.parts[_VIA] for move in on_arcs])
            self.check_orientations(on_arcs, vias)
            arcs[circular] = vias[:, :3] * 1e-3
            postures[circular] = np.column_stack([vias[:, [4, 5, 6, 3, 7, 8, 9, 10]], _radians(vias[:, 11:])])
        begin = np.vstack([position[:1], position[:-1]])
        lengths = segments(begin, np.where(circular[:, None], arcs, position), position, circular).length
        station, uframe, oframe = next(iter(module.wobj.values()))
        return RobotProgram(
            module=module.name,
            tool=module.tool[start.tool],
            uframe=uframe,
            oframe=oframe,
            station=station,
            start=_radians(np.array(start.joints)),
            linear=np.array([move.parts[_WORD] != "MoveJ" for move in moves]),
            fine=np.array([move.parts[_AT] == "fine" for move in moves]),
            position=position,
            quat=table[:, [4, 5, 6, 3]],
            conf=table[:, 7:11].astype(np.intp),
            external=_radians(table[:, 11:]),
            zone=np.array([ZONES[move.parts[_AT]] for move in moves]),
            speed=np.array(speeds) * SPEED_UNITS,
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
            approach=np.array(start.approach) * SPEED_UNITS,
        )

    @staticmethod
    def check_orientations(moves: Sequence[Statement], targets: Array) -> None:
        """Raises InputError for the first of some moves whose target (m, 17) has a quaternion that is none of a rotation,
        at which a controller stops."""
        length = np.linalg.norm(targets[:, 3:7], axis=1)
        wrong = np.flatnonzero(np.abs(length - 1.0) > UNIT)
        if len(wrong):
            raise moves[wrong[0]].error(f"an orientation whose quaternion has length {length[wrong[0]]:.5g}, not 1")

    def used(self, move: Statement) -> list[str]:
        """The triggers of a move, T1, T2 and so on."""
        numbered = [each.split(":=") for each in move.parts[_MORE].split("\\")[1:]]
        if [number for number, _ in numbered] != [f"T{k}" for k in range(2, len(numbered) + 2)]:
            raise move.error("the triggers are not numbered T2, T3, …")
        known = {**self.trigger, **self.demand}
        return [_known(move, name, known) for name in (move.parts[_FIRST], *(name for _, name in numbered))]

    def check_server(self) -> None:
        """The socket's procedures must stand there as they always do, whatever the address."""
        module, written = self.module, self.module.server

        def error(reason: str, line: int = module.served) -> InputError:
            return InputError(reason, file=module.file, line=line)

        if not written and not self.calls and not self.sent:
            return
        if len(self.calls) != 2 or not written:
            raise error("the socket is not opened and closed once each")
        binds = _BIND.search("\n".join(written))
        if binds is None or not FIRST_PORT <= int(binds[2]) <= LAST_PORT:
            raise error("the socket is bound to nothing that it may be bound to")
        expected = server(module.name, self.sent, binds[1], int(binds[2]), self.outputs)
        for k, (line, right) in enumerate(itertools.zip_longest(written, expected), module.served):
            if line != right:
                raise error(f"the socket's procedures say {line!r} instead of {right!r}", k)
