"""The moves of a RAPID program, read with nothing of ours."""

from __future__ import annotations

import json
import re
from types import SimpleNamespace

import numpy as np

TARGET = r"\[\[[^ ;]*?\]\]"
MOVE = re.compile(
    rf"(MoveJ|MoveL|MoveC|TriggL|TriggC) (?:({TARGET}),)?({TARGET}),(\w+),(?:(trg[\w\\:=]+),)?"
    r"(fine|z0|z1|z5|z10|zon0_1|zon0_02),tPen\\WObj:=wobjPart;"
)
ALONG = ("MoveL", "MoveC", "TriggL", "TriggC")  # what lays material

BOTH = ("tilt", "rotation")  # axes of the station


def moves_of(text: str) -> list[SimpleNamespace]:
    """The moves of a program, read with nothing of ours but the order of the procedures."""
    out = []
    for match in MOVE.finditer(text):
        word, via, target, speed, trigger, zone = match.groups()
        assert (via is not None) == word.endswith("C")
        position, quat, conf, external = json.loads(target.replace("9E9", "null"))
        declared = re.search(rf"CONST speeddata {speed}:=\[(.*?)\];", text)
        assert declared is not None
        out.append(
            SimpleNamespace(
                word=word,
                via=None if via is None else _place(*json.loads(via.replace("9E9", "null"))),
                position=np.array(position),
                quat=np.array(quat),
                conf=conf,
                external=external,
                speed=float(declared.group(1).split(",")[0]),
                trigger=trigger,
                zone=zone,
            )
        )
    assert len(out) == len(re.findall(r"^ {8}(?:Move[JLC]|Trigg[LC]) ", text, re.MULTILINE))
    return out


def _place(position, quat, conf, external):
    return SimpleNamespace(position=np.array(position), quat=np.array(quat), conf=conf, external=external)
