"""Statements of the RAPID that `writer` writes: a strict subset, where anything unknown is an error with its line."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from planner.errors import InputError
from planner.export.rapid.lines import LONGEST_LINE
from planner.export.rapid.modules import HOME
from planner.export.rapid.server import END, LATEST, LINE, OPEN, SETTLE, server_declarations
from planner.readonly import Array

Parts = tuple[str | None, ...]
Place = tuple[str, int]  # file, line
Step = tuple[str, Place, Parts]  # word, place, what stands in it

NUMBER = r"-?[0-9]+(?:\.[0-9]+)?(?:E[0-9]+)?"
_NUMBER = re.compile(NUMBER)
NAME = r"[A-Za-z][A-Za-z0-9_]{0,31}"
NEST = r"\[[-0-9.,E\[\]]*\]"
POSE = r"\[\[[-0-9.,E]*\],\[[-0-9.,E]*\]\]"
MOST_TRIGGERS = 8  # ABB, RAPID reference, TriggL: T1 to T8
_TRIGGERS = rf"({NAME})((?:\\T[2-{MOST_TRIGGERS}]:={NAME})*)"
PATTERNS = {
    word: re.compile(pattern)
    for word, pattern in {
        "module": rf"MODULE ({NAME})",
        "tool": rf"PERS tooldata ({NAME}):=\[TRUE,({POSE}),{NEST}\];",
        "wobj": rf'PERS wobjdata ({NAME}):=\[FALSE,(TRUE|FALSE),"({NAME})?",({POSE}),({POSE})\];',
        "speed": rf"CONST speeddata ({NAME}):=({NEST});",
        "variable": rf"VAR triggdata ({NAME});",
        "trigger": rf"TriggIO ({NAME}),({NUMBER})(\\Start)?\\DOp:=({NAME}),([01]);",
        "proc": rf"PROC ({NAME})\(\)",
        "demand": rf"TriggIO ({NAME}),({NUMBER})(\\Start)?\\AOp:=({NAME}),({NUMBER});",
        "absolute": rf"MoveAbsJ ({NEST}),({NAME}),fine,({NAME})\\WObj:=({NAME});",
        "move": rf"(MoveJ|MoveL|TriggL) ({NEST}),({NAME})(?:,{_TRIGGERS})?,(fine|z0|z1),({NAME})\\WObj:=({NAME});",
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
        "setting": r"(SingArea\\Off|ConfJ\\On|ConfL\\Off);",
        "end": r"(ENDPROC|ENDMODULE)",
        "call": rf"({NAME});",
    }.items()
}
DECLARATIONS = ("module", "tool", "wobj", "speed", "variable", "proc")
SHAPE_POSE, SHAPE_TARGET, SHAPE_JOINTS = "[3,4]", "[3,4,4,6]", "[6,6]"
# A move whose target has the right shape and nothing but numbers: almost every line, and read without a second look.
_TARGET = "],\\[".join(",".join([NUMBER] * count) for count in (3, 4, 4, 6))
_MOVE = re.compile(PATTERNS["move"].pattern.replace(f"({NEST})", rf"(\[\[{_TARGET}\]\])", 1))


def error(place: Place, reason: str) -> InputError:
    """What is wrong in a line of the program."""
    return InputError(reason, file=place[0], line=place[1])


def numbers(nest: str, shape: str, place: Place) -> list[float]:
    """Flat numbers of a nested list such as [[1,2,3],[1,0,0,0]], whose inner lengths must be `shape`, e.g. [3,4]."""
    groups = nest[2:-2].split("],[") if nest.startswith("[[") and nest.endswith("]]") else [nest[1:-1]]
    items = [group.split(",") for group in groups]
    if f"[{','.join(str(len(item)) for item in items)}]" != shape:
        raise error(place, f"expected lists of lengths {shape} in {nest[:60]}")
    flat = [value for item in items for value in item]
    for value in flat:
        if not _NUMBER.fullmatch(value):
            raise error(place, f"{value!r} is not a number")
    return [float(value) for value in flat]


def target_numbers(nests: Sequence[str]) -> Array:
    """Numbers (m, 17) of targets that are known to have the right shape."""
    # one conversion for all: the same correctly rounded numbers as float() gives, in a tenth of the time
    flat = ",".join(nests).translate(str.maketrans("", "", "[]"))
    return np.fromstring(flat, sep=",").reshape(len(nests), 17)


def pose(nest: str, place: Place) -> Array:
    """Position [m] and quaternion x y z w of a RAPID pose."""
    x, y, z, qw, qx, qy, qz = numbers(nest, SHAPE_POSE, place)
    return np.array([x * 1e-3, y * 1e-3, z * 1e-3, qx, qy, qz, qw])


@dataclass(frozen=True)
class Module:
    """What stands in a module. `server` holds the lines of the socket's procedures, from `served` on, unread."""

    file: str
    name: str = ""
    tool: dict[str, Array] = field(default_factory=dict)
    wobj: dict[str, tuple[str, Array, Array]] = field(default_factory=dict)
    speeds: dict[str, list[float]] = field(default_factory=dict)
    triggers: set[str] = field(default_factory=set)
    procs: dict[str, list[Step]] = field(default_factory=dict)
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
    for line, statement in enumerate(raw, start=1):
        statement = statement.strip()
        if statement and not statement.startswith("!") and not served < line <= closes:
            parser.take(statement, (file, line))
    if not parser.closed:
        raise InputError("no complete module: ENDMODULE is missing", file=file)
    if parser.declared != (server_declarations() if served < len(raw) else []):
        raise error((file, served), "the variables of the socket are others than its procedures need")
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

    def take(self, statement: str, place: Place) -> None:
        if self.handling and statement != "ENDPROC":
            self.module.fallback.append(statement)
            return
        move = _MOVE.fullmatch(statement)
        if move is not None and self.current and not self.closed:
            self.module.procs[self.current].append(("move", place, move.groups()))
            return
        if f"    {statement}" in server_declarations() and self.name and not self.current and not self.closed:
            self.declared.append(f"    {statement}")
            return
        known = ((word, pattern.fullmatch(statement)) for word, pattern in PATTERNS.items())
        word, match = next((pair for pair in known if pair[1]), ("", None))
        if match is None:
            raise error(place, f"unknown statement {statement[:60]!r}")
        parts = match.groups()
        if self.closed or (word != "module") == (not self.name):
            raise error(place, f"{statement[:60]!r} stands outside the module")
        inside = word not in DECLARATIONS and statement != "ENDMODULE"
        if inside != bool(self.current):
            raise error(place, f"{statement[:60]!r} stands {'outside' if inside else 'inside'} a procedure")
        if word == "error":
            self.handling = True
            self.module.fallback.append(statement)
        elif word == "end":
            self.handling = False
            self.closed = statement == "ENDMODULE"
            self.current = ""
        elif word in DECLARATIONS:
            self.declare(word, parts, place)
        else:
            if word == "move":
                numbers(str(parts[1]), SHAPE_TARGET, place)
            self.module.procs[self.current].append((word, place, parts))

    def declare(self, word: str, parts: Parts, place: Place) -> None:
        name, module = str(parts[0]), self.module
        if name.lower() in self.names:  # RAPID does not tell capitals from small letters
            what = "procedure" if word == "proc" else "name"
            raise error(place, f"{what} {name} stands there twice, first in line {self.names[name.lower()]}")
        self.names[name.lower()] = place[1]
        if word == "module":
            self.name = name
        elif word == "tool":
            module.tool[name] = pose(str(parts[1]), place)
        elif word == "wobj":
            if (parts[1] == "FALSE") != bool(parts[2]):
                raise error(place, "a work object moves if, and only if, it names a station")
            module.wobj[name] = (parts[2] or "", pose(str(parts[3]), place), pose(str(parts[4]), place))
        elif word == "speed":
            module.speeds[name] = numbers(str(parts[1]), "[4]", place)
        elif word == "variable":
            module.triggers.add(name)
        else:
            self.current = name
            module.procs[name] = []
