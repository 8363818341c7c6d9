"""The extruder's G-code, spoilt: what is not found is judged by the filament that it moves, and when.

python -m benchmarks.attack --only gcode
"""

from __future__ import annotations

import random
import re
from functools import partial
from pathlib import Path

import numpy as np

from benchmarks.attack.cases import ESCAPED, FOUND, HARMLESS, REFUSED, Case, Kind, Outcome
from benchmarks.attack.prints import ON_POSITIONER, solved
from benchmarks.attack.text import spoilt_lines
from planner.base.arrays import Array
from planner.base.errors import InputError
from planner.export.extruder import FILE, differences, gcode
from planner.plan import Plan

LINES = re.compile(r"^ *[GMT]\d")
WORDS = (("E", "E-"), ("S1", "S0"), ("S0", "S1"), ("G1", "G0"), ("M83", "M82"), (" F", " E"), ("G4 P", "G4 S"))
LATE = 0.02  # s by which filament may move early or late, as a board that waits for the robot may
ROUNDED = 0.002  # mm


def attack_gcode(plan: Plan, text: str, by: random.Random) -> Outcome:
    """Whether a spoilt file of the extruder passes for the plan's, and moves filament otherwise."""
    what, spoilt = spoilt_lines(text, by, LINES, WORDS)
    try:
        told = differences(plan, {FILE: spoilt})
    except InputError as error:
        return Outcome(what, REFUSED, str(error))
    if told:
        return Outcome(what, FOUND, "; ".join(told))
    off = fed_otherwise(text, spoilt)
    return Outcome(what, ESCAPED if off > LATE * fastest(text) + ROUNDED else HARMLESS, f"{off:.3g} mm" if off else "")


def fastest(text: str) -> float:
    """The greatest rate of a file [mm/s]."""
    return max(float(rate) for rate in re.findall(r"^G1 E-?[\d.]+ F([\d.]+)", text, re.MULTILINE)) / 60.0


def fed_otherwise(text: str, spoilt: str) -> float:
    """Filament [mm] by which two files differ at most, at the same time since the same wait; infinite if they wait otherwise."""
    true, other = fed_between_waits(text), fed_between_waits(spoilt)
    if [wait for wait, _ in true] != [wait for wait, _ in other]:
        return float("inf")
    worst = 0.0
    for (_, a), (_, b) in zip(true, other, strict=True):
        times = np.union1d(a[:, 0], b[:, 0])
        worst = max(worst, float(np.abs(np.interp(times, *a.T) - np.interp(times, *b.T)).max()))
    return worst


def fed_between_waits(text: str) -> list[tuple[str, Array]]:
    """Each wait for the robot, and the filament [mm] at times [s] since then (k, 2)."""
    out: list[tuple[str, list[tuple[float, float]]]] = [("", [(0.0, 0.0)])]
    for line in (line.strip() for line in text.splitlines()):
        t, fed = out[-1][1][-1]
        if line.startswith("M577"):
            out.append((line, [(0.0, 0.0)]))
        elif move := re.fullmatch(r"G1 E(-?[\d.]+) F([\d.]+)", line):
            out[-1][1].append((t + abs(float(move[1])) / float(move[2]) * 60.0, fed + float(move[1])))
        elif pause := re.fullmatch(r"G4 P(\d+)", line):
            out[-1][1].append((t + int(pause[1]) * 1e-3, fed))
    return [(wait, np.array(knots)) for wait, knots in out]


def _prepared(folder: Path) -> Case:
    plan = solved(folder, **ON_POSITIONER)
    return partial(attack_gcode, plan, gcode(plan))


KINDS = {"gcode": Kind("lines and words of the extruder's G-code", 400, _prepared)}
