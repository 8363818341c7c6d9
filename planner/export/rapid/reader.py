"""Reads the RAPID that `writer` writes back into numbers: what the program does, in the order in which it runs."""

from __future__ import annotations

import itertools
import re
from collections.abc import Collection

import numpy as np
from numpy.typing import NDArray

from planner.errors import InputError
from planner.export.program import Program, Trigger
from planner.export.rapid.server import FIRST_PORT, LAST_PORT, OPEN, server
from planner.export.rapid.syntax import (
    SHAPE_JOINTS,
    Module,
    Parts,
    Step,
    error,
    numbers,
    parse,
    target_numbers,
)

Array = NDArray[np.float64]

# ABB, RAPID reference, zonedata: radius of the zone of the tool's path [m]
ZONES = {"fine": 0.0, "z0": 0.3e-3, "z1": 1e-3}
_BIND = re.compile(r'SocketBind bwServer,"(\d{1,3}(?:\.\d{1,3}){3})",(\d{4});', re.ASCII)


def read_rapid(text: str) -> Program:
    """Program of RAPID text as `writer.rapid` writes it.

    Raises InputError with the line for a statement, name or shape that is not known.
    """
    return _Run(parse(text)).program()


def _radians(degrees: Array) -> Array:
    """Angles [rad]; 9E9 means unused, here NaN."""
    return np.where(degrees > 1e9, np.nan, np.radians(degrees))


def _known(line: int, name: str | None, names: Collection[str]) -> str:
    if name is None or name not in names:
        raise error(line, f"unknown name {name!r}")
    return name


class _Run:
    """What the module does, statement by statement."""

    def __init__(self, module: Module) -> None:
        if "main" not in module.procs or len(module.tool) != 1 or len(module.wobj) != 1:
            raise InputError("no complete module with main, one tool and one work object", file="RAPID")
        self.module = module
        self.trigger: dict[str, Trigger] = {}
        self.outputs: dict[str, None] = {}
        self.start: list[float] = []
        self.moves: list[tuple[int, Parts]] = []
        self.waits: dict[int, float] = {}
        self.sends: dict[int, list[str]] = {}
        self.rested: dict[int, list[float]] = {}
        self.sent = 0
        self.calls: list[str] = []  # of the socket's procedures
        for step in self.steps("main", 0):
            self.take(step)

    def steps(self, name: str, depth: int) -> list[Step]:
        out: list[Step] = []
        for step in self.module.procs[name]:
            word, line, parts = step
            if word == "call":
                called = _known(line, parts[0], self.module.procs)
                if depth:
                    raise error(line, "only main calls procedures")
                out += self.steps(called, depth + 1)
            else:
                out.append(step)
        return out

    def take(self, step: Step) -> None:
        word, line, parts = step
        at = len(self.moves) - 1
        if word == "absolute":
            if self.moves or self.start:
                raise error(line, "MoveAbsJ is for the start only")
            _known(line, parts[1], self.module.speeds)
            self.start = numbers(str(parts[0]), SHAPE_JOINTS, line)
        elif word == "trigger":
            name, distance, from_start, signal, value = parts
            far = float(str(distance)) * 1e-3
            trigger = Trigger(far, bool(from_start), value == "1", str(signal))
            self.trigger[_known(line, name, self.module.triggers)] = trigger
            self.outputs[str(signal)] = None
        elif word == "move":
            self.moves.append((line, parts))
        elif word == "wait":
            if at < 0:
                raise error(line, "a wait before the first target")
            self.waits[at] = self.waits.get(at, 0.0) + float(str(parts[0]))
        elif word == "send":
            self.sent += 1
            if self.calls != [OPEN] or at < 0 or int(str(parts[0])) != self.sent:
                raise error(line, f"line {parts[0]} is sent out of order")
            self.sends.setdefault(at, []).append(str(parts[1]))
            self.rested.setdefault(at, []).append(self.waits.get(at, 0.0))
        elif word == "socket":
            self.calls.append(str(parts[0]))

    def program(self) -> Program:
        if not self.start or not self.moves:
            raise InputError("no moves", file="RAPID")
        self.check_server()
        speeds, triggers, module = [], {}, self.module
        for i, (line, (word, _, speed, first, others, _, tool, wobj)) in enumerate(self.moves):
            if speed not in module.speeds or tool not in module.tool or wobj not in module.wobj:
                for name, names in ((speed, module.speeds), (tool, module.tool), (wobj, module.wobj)):
                    _known(line, name, names)
            speeds.append(module.speeds[str(speed)])
            if (first is not None) != (word == "TriggL"):
                raise error(line, "TriggL, and nothing else, has triggers")
            if first is not None:
                triggers[i] = tuple(self.trigger[name] for name in self.used(line, first, others or ""))
        table = target_numbers([str(parts[1]) for _, parts in self.moves])
        station, uframe, oframe = next(iter(module.wobj.values()))
        return Program(
            module=module.name,
            tool=next(iter(module.tool.values())),
            uframe=uframe,
            oframe=oframe,
            station=station,
            start=_radians(np.array(self.start)),
            linear=np.array([parts[0] != "MoveJ" for _, parts in self.moves]),
            fine=np.array([parts[5] == "fine" for _, parts in self.moves]),
            position=table[:, :3] * 1e-3,
            quat=table[:, [4, 5, 6, 3]],
            conf=table[:, 7:11].astype(np.intp),
            external=_radians(table[:, 11:]),
            zone=np.array([ZONES[str(parts[5])] for _, parts in self.moves]),
            speed=np.array(speeds) * [1e-3, np.pi / 180.0, 1e-3, np.pi / 180.0],
            wait=np.array([self.waits.get(i, 0.0) for i in range(len(self.moves))]),
            triggers=triggers,
            sends={i: tuple(texts) for i, texts in self.sends.items()},
            send_rests={i: tuple(rests) for i, rests in self.rested.items()},
        )

    def used(self, line: int, first: str, others: str) -> list[str]:
        """The triggers of a move, T1, T2 and so on."""
        numbered = [each.split(":=") for each in others.split("\\")[1:]]
        if [number for number, _ in numbered] != [f"T{k}" for k in range(2, len(numbered) + 2)]:
            raise error(line, "the triggers are not numbered T2, T3, …")
        return [_known(line, name, self.trigger) for name in (first, *(name for _, name in numbered))]

    def check_server(self) -> None:
        """The socket's procedures must stand there as they always do, whatever the address."""
        module, written = self.module, self.module.server
        if not written and not self.calls and not self.sent:
            return
        if len(self.calls) != 2 or not written:
            raise error(module.served, "the socket is not opened and closed once each")
        binds = _BIND.search("\n".join(written))
        if binds is None or not FIRST_PORT <= int(binds[2]) <= LAST_PORT:
            raise error(module.served, "the socket is bound to nothing that it may be bound to")
        expected = server(module.name, self.sent, binds[1], int(binds[2]), self.outputs)
        for k, (line, right) in enumerate(itertools.zip_longest(written, expected), module.served):
            if line != right:
                raise error(k, f"the socket's procedures say {line!r} instead of {right!r}")
