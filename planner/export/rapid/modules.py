"""Parser of RAPID modules: exactly the statements that `writer` uses; anything else is an error with its line."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from planner.base.arrays import Array
from planner.base.errors import InputError
from planner.export.grammar import Grammar, Statement
from planner.export.rapid.extruder import END, LATEST, LINE, LONGEST_LINE, OPEN, SETTLE, server_declarations
from planner.export.rapid.multimove import LISTED
from planner.export.rapid.text import HOME, OWN_ZONES, ZONES

# ----------------------------------------------------------------------------------------------------
# Statements, and where each is allowed in a module.

NUMBER = r"-?[0-9]+(?:\.[0-9]+)?(?:E[0-9]+)?"
_NUMBER = re.compile(NUMBER)
NAME = r"[A-Za-z][A-Za-z0-9_]{0,31}"
NEST = r"\[[-0-9.,E\[\]]*\]"
NEST_TARGET = r"\[\[[-0-9.,E]*(?:\],\[[-0-9.,E]*)*\]\]"  # of any shape, but never runs into the next one
NEST_ZONE = r"\[FALSE(?:,[0-9.]+){6}\]"
POSE = r"\[\[[-0-9.,E]*\],\[[-0-9.,E]*\]\]"
MOST_TRIGGERS = 8  # ABB, RAPID reference, TriggL: T1 to T8
_TRIGGERS = rf"({NAME})((?:\\T[2-{MOST_TRIGGERS}]:={NAME})*)"
# numbers of a target: almost every line is a move with these, and is recognised at once
_TARGET = "],\\[".join(",".join([NUMBER] * count) for count in (3, 4, 4, 6))
MISSHAPEN = "move without a target"
_ZONE = "|".join(ZONES)
_IDENTITY = (
    r"(?:\\ID:=([1-9][0-9]{0,6}))?"  # of moves synchronised between tasks; RAPID's nums are exact up to 8 388 608
)
_END = rf"{_IDENTITY},({NAME})(?:,{_TRIGGERS})?,({_ZONE}),({NAME})\\WObj:=({NAME});"
_MOVE = rf"(MoveJ|MoveL|MoveC|TriggL|TriggC) (?:({{target}}),)?({{target}}){_END}"
WORD, VIA, TO, ID, SPEED, FIRST, MORE, AT, TOOL, WOBJ = range(10)  # parts of a move
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
        "point": rf"VAR syncident ({NAME});",
        "tasks": rf"PERS tasks ({NAME}){re.escape(LISTED)};",
        "trigger": rf"TriggIO ({NAME}),({NUMBER})(\\Start)?\\DOp:=({NAME}),([01]);",
        "proc": rf"PROC ({NAME})\(\)",
        "demand": rf"TriggIO ({NAME}),({NUMBER})(\\Start)?\\AOp:=({NAME}),({NUMBER});",
        "absolute": rf"MoveAbsJ ({NEST}){_IDENTITY},({NAME}),({_ZONE}),({NAME})(?:\\WObj:=({NAME}))?;",
        MISSHAPEN: _MOVE.replace("{target}", NEST_TARGET),
        "wait": rf"WaitTime ({NUMBER});",
        "unit": rf"(ActUnit|DeactUnit) ({NAME});",
        "output": rf"SetDO ({NAME}),([01]);",
        "demanded": rf"SetAO ({NAME}),({NUMBER});",
        "load": rf'(Load \\Dynamic,|UnLoad )"{HOME}"\\File:="({NAME}).mod";',
        "late": rf'%"({NAME})"%;',
        "meet": rf"(WaitSyncTask|SyncMoveOn|SyncMoveOff) ({NAME})(?:,({NAME}))?;",
        "handler": r"(ERROR|UNDO)",
        "write": r'TPWrite "([^"]{0,80})";',
        "send": rf'{LINE} ([0-9]{{1,7}}),"([A-Z][-A-Z0-9 .]{{0,{LONGEST_LINE - 1}}})";',
        "settle": rf"{SETTLE} {LATEST};",
        "socket": rf"({OPEN}|{END});",
        "setting": r"(SingArea\\Off|ConfJ\\On|ConfL\\Off|CirPathMode\\ObjectFrame);",
        "end": r"(ENDPROC|ENDMODULE)",
        "call": rf"({NAME});",
    },
)
DECLARATIONS = ("module", "tool", "wobj", "speed", "zone", "variable", "point", "tasks", "proc")
UNIT = 1e-5  # by which a quaternion's length may differ from 1; numbers have 7 decimals
SPEED_UNITS = np.array([1e-3, np.pi / 180.0, 1e-3, np.pi / 180.0])  # of a speeddata
SHAPE_POSE, SHAPE_TARGET, SHAPE_JOINTS = "[3,4]", "[3,4,4,6]", "[6,6]"


def numbers(nest: str, shape: str, statement: Statement) -> list[float]:
    """Flat numbers of a nested list such as [[1,2,3],[1,0,0,0]], whose inner lengths must be `shape`, e.g. [3,4].

    Raises InputError, with the statement's line, if they are not.
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
    # one conversion for all: the same correctly rounded numbers as from float(), in a tenth of the time
    flat = ",".join(nests).translate(str.maketrans("", "", "[]"))
    return np.fromstring(flat, sep=",").reshape(len(nests), 17)


def pose(nest: str, statement: Statement) -> Array:
    """Position [m] and quaternion x y z w (7) of a RAPID pose."""
    x, y, z, qw, qx, qy, qz = numbers(nest, SHAPE_POSE, statement)
    return np.array([x * 1e-3, y * 1e-3, z * 1e-3, qx, qy, qz, qw])


@dataclass(frozen=True)
class Module:
    """Contents of a module.

    points, tasks  points at which two tasks meet, and the name of the list of tasks; empty if there are none
    server         lines of the socket's procedures, from line `served` on, not parsed
    fallback       lines of main's handlers
    """

    file: str
    name: str = ""
    tool: dict[str, Array] = field(default_factory=dict)
    wobj: dict[str, tuple[str, Array, Array]] = field(default_factory=dict)
    speeds: dict[str, list[float]] = field(default_factory=dict)
    zones: set[str] = field(default_factory=set)
    triggers: set[str] = field(default_factory=set)
    points: set[str] = field(default_factory=set)
    tasks: str = ""
    procs: dict[str, list[Statement]] = field(default_factory=dict)
    server: list[str] = field(default_factory=list)
    served: int = 0
    fallback: list[str] = field(default_factory=list)


def parse(text: str, file: str) -> Module:
    """The statements of one module. Raises InputError, with the line, for anything unknown or misplaced."""
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
        raise InputError("the socket's variables are not those that its procedures need", file=file, line=served)
    return replace(parser.module, name=parser.name, tasks=parser.tasks, server=raw[served:closes], served=served + 1)


class _Parser:
    def __init__(self, file: str) -> None:
        self.module = Module(file)
        self.name = self.tasks = ""
        self.names: dict[str, int] = {}
        self.declared: list[str] = []
        self.current = ""
        self.handling = False  # after ERROR or UNDO in main
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
        if word == "handler":
            self.handling = True
            self.module.fallback.append(text)
        elif word == "end":
            self.handling = False
            self.closed = text == "ENDMODULE"
            self.current = ""
        elif word in DECLARATIONS:
            self.declare(statement)
        elif word == MISSHAPEN:
            for target in filter(None, statement.parts[VIA : TO + 1]):
                numbers(target, SHAPE_TARGET, statement)  # raises the error that says what is wrong
        else:
            self.module.procs[self.current].append(statement)

    def declare(self, statement: Statement) -> None:
        parts, module = statement.parts, self.module
        name = parts[0]
        if name.lower() in self.names:  # RAPID ignores case
            what = "procedure" if statement.word == "proc" else "name"
            raise statement.error(f"{what} {name} is defined twice, first in line {self.names[name.lower()]}")
        self.names[name.lower()] = statement.line
        if statement.word == "module":
            self.name = name
        elif statement.word == "tool":
            module.tool[name] = pose(parts[1], statement)
        elif statement.word == "wobj":
            if (parts[1] == "FALSE") != bool(parts[2]):
                raise statement.error("a work object must name a station if it moves, and only then")
            module.wobj[name] = (parts[2], pose(parts[3], statement), pose(parts[4], statement))
        elif statement.word == "speed":
            module.speeds[name] = numbers(parts[1], "[4]", statement)
        elif statement.word == "zone":
            if OWN_ZONES.get(name) != parts[1]:
                raise statement.error(f"zone {name} is not one that these programs have")
            module.zones.add(name)
        elif statement.word == "variable":
            module.triggers.add(name)
        elif statement.word == "point":
            module.points.add(name)
        elif statement.word == "tasks":
            self.tasks = name
        else:
            self.current = name
            module.procs[name] = []
