"""Reads the RAPID that `rapid` writes back into numbers: a strict subset, where anything unknown is an error."""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from planner.errors import InputError
from planner.export.program import Program, Trigger

Array = NDArray[np.float64]

NUMBER = r"-?[0-9]+(?:\.[0-9]+)?(?:E[0-9]+)?"
_NUMBER = re.compile(NUMBER)
NAME = r"[A-Za-z][A-Za-z0-9_]{0,31}"
NEST = r"\[[-0-9.,E\[\]]*\]"
POSE = r"\[\[[-0-9.,E]*\],\[[-0-9.,E]*\]\]"
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
        "absolute": rf"MoveAbsJ ({NEST}),({NAME}),fine,({NAME})\\WObj:=({NAME});",
        "move": rf"(MoveJ|MoveL|TriggL) ({NEST}),({NAME})(?:,({NAME})(?:\\T2:=({NAME}))?)?,(fine|z0|z1),({NAME})"
        rf"\\WObj:=({NAME});",
        "wait": rf"WaitTime ({NUMBER});",
        "unit": rf"(ActUnit|DeactUnit) ({NAME});",
        "output": rf"SetDO ({NAME}),([01]);",
        "write": r'TPWrite "([^"]{0,80})";',
        "setting": r"(SingArea\\Off|ConfJ\\On|ConfL\\Off);",
        "end": r"(ENDPROC|ENDMODULE)",
        "call": rf"({NAME});",
    }.items()
}
# ABB, RAPID reference, zonedata: radius of the zone of the tool's path [m]
ZONES = {"fine": 0.0, "z0": 0.3e-3, "z1": 1e-3}
SHAPE_POSE, SHAPE_TARGET, SHAPE_JOINTS = "[3,4]", "[3,4,4,6]", "[6,6]"
# A move whose target has the right shape and nothing but numbers: almost every line, and read without a second look.
_TARGET = "],\\[".join(",".join([NUMBER] * count) for count in (3, 4, 4, 6))
_MOVE = re.compile(PATTERNS["move"].pattern.replace(f"({NEST})", rf"(\[\[{_TARGET}\]\])", 1))


def read_rapid(text: str) -> Program:
    """Program of RAPID text as `rapid.rapid` writes it.

    Raises InputError with the line for a statement, name or shape that is not known.
    """
    reader = _Reader()
    for line, raw in enumerate(text.split("\n"), start=1):
        statement = raw.strip()
        if statement and not statement.startswith("!"):
            reader.take(statement, line)
    return reader.program()


def _error(line: int, reason: str) -> InputError:
    return InputError(reason, line=line, file="RAPID")


def numbers(nest: str, shape: str, line: int) -> list[float]:
    """Flat numbers of a nested list such as [[1,2,3],[1,0,0,0]], whose inner lengths must be `shape`, e.g. [3,4]."""
    groups = nest[2:-2].split("],[") if nest.startswith("[[") and nest.endswith("]]") else [nest[1:-1]]
    items = [group.split(",") for group in groups]
    if f"[{','.join(str(len(item)) for item in items)}]" != shape:
        raise _error(line, f"expected lists of lengths {shape} in {nest[:60]}")
    flat = [value for item in items for value in item]
    for value in flat:
        if not _NUMBER.fullmatch(value):
            raise _error(line, f"{value!r} is not a number")
    return [float(value) for value in flat]


def _targets(nests: Sequence[str]) -> Array:
    """Numbers (m, 17) of targets that are known to have the right shape."""
    # one conversion for all: the same correctly rounded numbers as float() gives, in a tenth of the time
    flat = ",".join(nests).translate(str.maketrans("", "", "[]"))
    return np.fromstring(flat, sep=",").reshape(len(nests), 17)


def _pose(nest: str, line: int) -> Array:
    x, y, z, qw, qx, qy, qz = numbers(nest, SHAPE_POSE, line)
    return np.array([x * 1e-3, y * 1e-3, z * 1e-3, qx, qy, qz, qw])


def _radians(degrees: Array) -> Array:
    """Angles [rad]; 9E9 means unused, here NaN."""
    return np.where(degrees > 1e9, np.nan, np.radians(degrees))


class _Reader:
    def __init__(self) -> None:
        self.module = ""
        self.tool: dict[str, Array] = {}
        self.wobj: dict[str, tuple[str, Array, Array]] = {}
        self.speeds: dict[str, list[float]] = {}
        self.declared: set[str] = set()
        self.trigger: dict[str, Trigger] = {}
        self.procs: dict[str, list[tuple[str, int, tuple[str | None, ...]]]] = {}
        self.current = ""
        self.closed = False

    def take(self, statement: str, line: int) -> None:
        move = _MOVE.fullmatch(statement)
        if move is not None and self.current and not self.closed:
            self.procs[self.current].append(("move", line, move.groups()))
            return
        known = ((word, pattern.fullmatch(statement)) for word, pattern in PATTERNS.items())
        word, match = next((pair for pair in known if pair[1]), ("", None))
        if match is None:
            raise _error(line, f"unknown statement {statement[:60]!r}")
        parts = match.groups()
        if self.closed or (word != "module") == (not self.module):
            raise _error(line, f"{statement[:60]!r} stands outside the module")
        inside = word not in ("module", "tool", "wobj", "speed", "variable", "proc") and statement != "ENDMODULE"
        if inside != bool(self.current):
            raise _error(line, f"{statement[:60]!r} stands {'outside' if inside else 'inside'} a procedure")
        if word == "module":
            self.module = parts[0]
        elif word == "tool":
            self.tool[parts[0]] = _pose(parts[1], line)
        elif word == "wobj":
            if (parts[1] == "FALSE") != bool(parts[2]):
                raise _error(line, "a work object moves if, and only if, it names a station")
            self.wobj[parts[0]] = (parts[2] or "", _pose(parts[3], line), _pose(parts[4], line))
        elif word == "speed":
            self.speeds[parts[0]] = numbers(parts[1], "[4]", line)
        elif word == "variable":
            self.declared.add(parts[0])
        elif word == "proc":
            if parts[0] in self.procs:
                raise _error(line, f"procedure {parts[0]} stands there twice")
            self.current = parts[0]
            self.procs[parts[0]] = []
        elif word == "end":
            self.closed = statement == "ENDMODULE"
            self.current = ""
        else:
            if word == "move":
                numbers(parts[1], SHAPE_TARGET, line)
            self.procs[self.current].append((word, line, parts))

    def program(self) -> Program:
        if not self.closed or "main" not in self.procs or len(self.tool) != 1 or len(self.wobj) != 1:
            raise InputError("no complete module with main, one tool and one work object", file="RAPID")
        start: list[float] = []
        moves: list[tuple[int, tuple[str | None, ...]]] = []
        waits: dict[int, float] = {}
        for word, line, parts in self._run("main", 0):
            if word == "absolute":
                if moves or start:
                    raise _error(line, "MoveAbsJ is for the start only")
                self._known(line, parts[1], self.speeds)
                start = numbers(str(parts[0]), SHAPE_JOINTS, line)
            elif word == "trigger":
                name, distance, from_start, signal, value = parts
                self._known(line, name, self.declared)
                far = float(str(distance)) * 1e-3
                self.trigger[str(name)] = Trigger(far, bool(from_start), value == "1", str(signal))
            elif word == "move":
                moves.append((line, parts))
            elif word == "wait":
                at = len(moves) - 1
                if at < 0:
                    raise _error(line, "a wait before the first target")
                waits[at] = waits.get(at, 0.0) + float(str(parts[0]))
        if not start or not moves:
            raise InputError("no moves", file="RAPID")
        return self._arrays(start, moves, waits)

    def _run(self, name: str, depth: int) -> list[tuple[str, int, tuple[str | None, ...]]]:
        out = []
        for word, line, parts in self.procs[name]:
            if word == "call":
                self._known(line, parts[0], self.procs)
                if depth:
                    raise _error(line, "only main calls procedures")
                out += self._run(str(parts[0]), depth + 1)
            else:
                out.append((word, line, parts))
        return out

    @staticmethod
    def _known(line: int, name: str | None, names: object) -> None:
        if name not in names:  # type: ignore[operator]
            raise _error(line, f"unknown name {name!r}")

    def _arrays(
        self, start: list[float], moves: list[tuple[int, tuple[str | None, ...]]], waits: dict[int, float]
    ) -> Program:
        speeds, triggers = [], {}
        for i, (line, (word, _, speed, first, second, _, tool, wobj)) in enumerate(moves):
            if speed not in self.speeds or tool not in self.tool or wobj not in self.wobj:
                for name, names in ((speed, self.speeds), (tool, self.tool), (wobj, self.wobj)):
                    self._known(line, name, names)
            speeds.append(self.speeds[str(speed)])
            if (first is not None) != (word == "TriggL"):
                raise _error(line, "TriggL, and nothing else, has triggers")
            if first is not None:
                used = [name for name in (first, second) if name]
                for name in used:
                    self._known(line, name, self.trigger)
                triggers[i] = tuple(self.trigger[name] for name in used)
        table = _targets([str(parts[1]) for _, parts in moves])
        station, uframe, oframe = next(iter(self.wobj.values()))
        return Program(
            module=self.module,
            tool=next(iter(self.tool.values())),
            uframe=uframe,
            oframe=oframe,
            station=station,
            start=_radians(np.array(start)),
            linear=np.array([parts[0] != "MoveJ" for _, parts in moves]),
            fine=np.array([parts[5] == "fine" for _, parts in moves]),
            position=table[:, :3] * 1e-3,
            quat=table[:, [4, 5, 6, 3]],
            conf=table[:, 7:11].astype(np.intp),
            external=_radians(table[:, 11:]),
            zone=np.array([ZONES[str(parts[5])] for _, parts in moves]),
            speed=np.array(speeds) * [1e-3, np.pi / 180.0, 1e-3, np.pi / 180.0],
            wait=np.array([waits.get(i, 0.0) for i in range(len(moves))]),
            triggers=triggers,
            sends={},
        )
