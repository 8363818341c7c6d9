"""The controller's side of a stream: our RAPID module with a plan's tool, work object, station and outputs in it."""

from __future__ import annotations

import re
from collections.abc import Sequence
from importlib.resources import files

from planner.export.program import Program
from planner.readonly import Array

MODULE = "BeadwiseStream"
_PARTS = re.compile(r"( *! --- of the plan ---\n).*?(?= *! --- of every plan ---\n)", re.DOTALL)


def server_module(program: Program, signals: Sequence[str], address: str, port: int) -> str:
    """Text of the RAPID module that serves a program's stream at an address of the controller."""
    text = files("planner.link").joinpath(f"{MODULE}.mod").read_text("ascii")
    moved = "FALSE" if program.station else "TRUE"
    frames = f'[FALSE,{moved},"{program.station}",{_pose(program.uframe)},{_pose(program.oframe)}]'
    load = "[1,[0,0,50],[1,0,0,0],0,0,0]"
    data = [
        f'CONST string bsAddress:="{address}";',
        f"CONST num bsPort:={port};",
        "! The load below is a placeholder: identify it on the robot before the first run.",
        f"PERS tooldata tBeadwise:=[TRUE,{_pose(program.tool)},{load}];",
        f"PERS wobjdata wobjBeadwise:={frames};",
    ]
    outputs, off = [], []
    for k, name in enumerate(signals, 1):
        outputs.append(f"TriggIO bsOn{{{k}}},0\\DOp:={name},1;")
        outputs.append(f"TriggIO bsOff{{{k}}},0\\DOp:={name},0;")
        outputs.append(f"TriggIO bsOnStart{{{k}}},0\\Start\\DOp:={name},1;")
        off.append(f"SetDO {name},0;")
    units = ["! No station: the part stands still."]
    if program.station:
        units = [
            "IF active THEN",
            f"    ActUnit {program.station};",
            "ELSE",
            f"    DeactUnit {program.station};",
            "ENDIF",
        ]
    procedures = [
        *_procedure("BsOutputs()", outputs),
        *_procedure("BsAllOff()", off),
        *_procedure("BsUnits(bool active)", units),
    ]
    new = iter(("\n".join(f"    {line}" for line in data) + "\n", "\n".join(procedures) + "\n"))
    return _PARTS.sub(lambda match: match[1] + next(new), text)


def _procedure(head: str, lines: Sequence[str]) -> list[str]:
    return [f"    PROC {head}", *(f"        {line}" for line in lines), "    ENDPROC", ""]


def _pose(pose: Array) -> str:
    x, y, z = (f"{value * 1e3:.3f}" for value in pose[:3])
    q = ",".join(f"{value:.7f}" for value in pose[[6, 3, 4, 5]])
    return f"[[{x},{y},{z}],[{q}]]"
