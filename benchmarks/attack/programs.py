"""Robot programs whose text is spoilt: what is not found is played beside the true one.

python -m benchmarks.attack --only rapid krl urscript fanuc inform
"""

from __future__ import annotations

import random
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.attack.cases import ESCAPED, FOUND, HARMLESS, REFUSED, Case, Kind, Outcome
from benchmarks.attack.prints import ON_BED, ON_POSITIONER, WITH_UR, solved
from benchmarks.attack.text import spoilt_lines
from planner.base.arrays import Array, Indices
from planner.base.errors import InputError
from planner.export.fit import angle
from planner.export.languages import LANGUAGES
from planner.export.player.play import play
from planner.export.player.played import Played
from planner.plan import Plan

COUNT = 400
# What may differ of a program that is not found: of path, in beads and in travel [m], of time [share, s], of the axis [rad].
IN_BEADS, IN_TRAVEL, SHARE, TIME, TURN = 0.2e-3, 1e-3, 0.01, 0.05, np.radians(1.0)
LEVER = 0.05  # m/rad: turning counts as way, as nothing else moves while the tip stands still
PLACES = 3000  # along a program
WINDOW = 40  # of them to either side, among which the same place is looked for


@dataclass(frozen=True)
class Text:
    """How a language's files are spoilt.

    cell   of the small print, one that the language supports
    lines  that may be spoilt: those that say something
    words  and others in their places
    again  makes numbers of lines right once more, where a language counts them
    """

    cell: dict[str, str]
    lines: str
    words: tuple[tuple[str, str], ...]
    again: Callable[[str], str] = str


def _counted(text: str) -> str:
    """A TP program with the numbers of its lines in order."""
    number = 0

    def line(match: re.Match[str]) -> str:
        nonlocal number
        number += 1
        return f"{number:4}:{match[1]}"

    return re.sub(r"^ *\d+:(?! +:)(.*)$", line, text, flags=re.MULTILINE)


TEXTS: dict[str, Text] = {
    "rapid": Text(
        ON_POSITIONER,
        r"^(?! *!) *[A-Z]",
        (("MoveL", "MoveJ"), ("MoveJ", "MoveL"), ("TriggL", "MoveL"), ("fine", "z50"), (",z", ",z1"), ("MoveC", "MoveL"),
         ("\\On", "\\Off"), (",1;", ",0;"), (",0;", ",1;")),
    ),
    "krl": Text(
        ON_BED,
        r"^(?! *;) *[$A-Z]",
        (("LIN ", "PTP "), ("PTP ", "LIN "), ("CIRC ", "LIN "), ("=TRUE", "=FALSE"), ("=FALSE", "=TRUE"), (" C_DIS", ""),
         ("}", "} C_DIS"), ("S 2", "S 6"), ("OUT[1]", "OUT[2]"), ("#BASE", "#TCP"), (" C_PTP", "")),
    ),
    "urscript": Text(
        WITH_UR,
        r"^(?! *#) *[a-z]",
        (("movep", "movej"), ("movec", "movep"), ("movej", "movel"), ("True", "False"), ("False", "True"), ("r=0.000", "r=0.009"),
         ("out(1", "out(2"), ("v=0.0", "v=0.1"), ("pose_trans(part, ", "(")),
    ),
    "fanuc": Text(
        ON_BED,
        r"^ *\d+: *(?![! ])|^\s+[XWJ]1? ?=|^P\[|CONFIG",
        ((" L ", " J "), (" J ", " L "), ("CNT100", "FINE"), ("FINE", "CNT100"), ("=ON", "=OFF"), ("=OFF", "=ON"), ("cm/min", "%"),
         ("DO[1]", "DO[2]"), ("'N U", "'F U"), ("U T", "D T"), (", 0, 0'", ", 1, 0'"), ("UT : 9", "UT : 8")),
        _counted,
    ),
    "inform": Text(
        ON_BED,
        r"^(?!')[A-Z/]",
        (("MOVL", "MOVJ"), ("MOVJ", "MOVL"), ("MOVC", "MOVL"), (" PL=0", ""), (" ON", " OFF"), (" OFF", " ON"), ("#(1)", "#(2)"),
         ("RCONF 1", "RCONF 0"), ("USER 1", "USER 2"), ("TOOL 1", "TOOL 0")),
    ),
    "val3": Text(ON_BED, r"^(?! *//) *\S", (("movel", "movej"), ("movej", "movel"), ("true", "false"), ("false", "true"))),
    "kawasaki": Text(ON_BED, r"^(?! *;) *\S", (("LMOVE", "JMOVE"), ("JMOVE", "LMOVE"), ("SIGNAL 1", "SIGNAL -1"))),
    "melfa": Text(ON_BED, r"^(?! *\d* *')\S", (("Mvs", "Mov"), ("Mov ", "Mvs "), ("=1", "=0"), ("=0", "=1"))),
}  # fmt: skip
ASKED = ("rapid", "krl", "urscript", "fanuc", "inform")  # of a full run: each reads its own way, the others as these


def attack_program(language: str, plan: Plan, files: Mapping[str, str], by: random.Random) -> Outcome:
    """Whether a spoilt program passes for the plan's, and does something else when it is played."""
    text = TEXTS[language]
    lines = re.compile(text.lines, re.MULTILINE)
    names = sorted(files)
    name = by.choices(names, [len(lines.findall(files[each])) for each in names])[0]
    what, spoilt = spoilt_lines(files[name], by, lines, text.words)
    changed = {**files, name: text.again(spoilt)}
    try:
        told = LANGUAGES[language].differences(plan, changed)
    except InputError as error:
        return Outcome(what, REFUSED, str(error))
    if told:
        return Outcome(what, FOUND, "; ".join(told))
    effect = played_otherwise(plan, language, files, changed)
    return Outcome(what, ESCAPED if effect else HARMLESS, effect)


@dataclass(frozen=True)
class Walk:
    """A program at PLACES along its way: tip (k, 3) [m], quaternion (k, 4), time (k) [s], and whether material is laid (k)."""

    tip: Array
    quat: Array
    t: Array
    laid: Array

    @staticmethod
    def of(played: Played) -> Walk:
        """Of a program that was played."""
        step = np.linalg.norm(np.diff(played.position, axis=0), axis=1) + LEVER * angle(
            played.quat[1:], played.quat[:-1]
        )
        way = np.concatenate([[0.0], np.cumsum(step)])
        at = np.linspace(0.0, way[-1], PLACES)
        k = np.clip(np.searchsorted(way, at, side="right") - 1, 0, len(step) - 1)
        u = (at - way[k]) / np.maximum(step[k], 1e-12)
        t = played.reached(k, np.clip(u, 0.0, 1.0))
        there = played.at(t)
        switched = [(event.t, event.value) for event in played.events if event.kind == "output"]
        laid = np.zeros(PLACES)
        for when, value in switched:
            laid[t >= when] = value
        return Walk(there.position, there.quat, t, laid)


def played_otherwise(plan: Plan, language: str, files: Mapping[str, str], spoilt: Mapping[str, str]) -> str:
    """What a spoilt program does otherwise than the true one, if that is beyond tolerance; matched by progress along the way."""
    true, other = (play(LANGUAGES[language].program(plan, each), _cell_of(plan, language)) for each in (files, spoilt))
    a, b = Walk.of(true), Walk.of(other)
    off_a, off_b = (np.maximum(*(_off(x, y)[i] for x, y in ((a, b), (b, a)))) for i in (0, 1))
    laid = (a.laid > 0.0) | (b.laid > 0.0)
    in_beads, in_travel = float(off_a[laid].max(initial=0.0)), float(off_a[~laid].max(initial=0.0))
    longer = other.duration - true.duration
    events = [
        [(event.kind, event.text, event.value) for event in each.events if event.kind in ("output", "demand", "send")]
        for each in (true, other)
    ]
    told = []
    if in_beads > IN_BEADS:
        told.append(f"{1e3 * in_beads:.2f} mm off in beads")
    if in_travel > IN_TRAVEL:
        told.append(f"{1e3 * in_travel:.2f} mm off in travel")
    if (turned := float(off_b.max())) > TURN:
        told.append(f"{np.degrees(turned):.1f} deg off")
    if abs(longer) > max(TIME, SHARE * true.duration):
        told.append(f"{longer:+.2f} s of {true.duration:.1f} s")
    if events[0] != events[1]:
        told.append("outputs differ")
    return ", ".join(told)


def _cell_of(plan: Plan, language: str) -> Any:
    return LANGUAGES[language].plan(plan).cell


def _off(a: Walk, b: Walk) -> tuple[Array, Array]:
    """Distance [m] and angle [rad] of each place of a walk from the nearest of another one at about the same progress."""
    near: Indices = np.clip(np.arange(PLACES)[:, None] + np.arange(-WINDOW, WINDOW + 1), 0, PLACES - 1)
    gap = np.linalg.norm(b.tip[near] - a.tip[:, None], axis=2)
    turn = 2.0 * np.arccos(np.clip(np.abs(np.einsum("ijk,ik->ij", b.quat[near], a.quat)), 0.0, 1.0))
    best = np.argmin(gap + LEVER * turn, axis=1)
    row = np.arange(PLACES)
    # between two places of the other: half a step at most is no distance
    half = 0.5 * np.linalg.norm(np.diff(b.tip, axis=0), axis=1).max(initial=0.0)
    return np.maximum(gap[row, best] - half, 0.0), turn[row, best]


def _prepared(language: str, folder: Path) -> Case:
    plan = solved(folder, **TEXTS[language].cell)
    files = LANGUAGES[language].write(plan)
    if told := LANGUAGES[language].differences(plan, files):
        raise RuntimeError(f"the true {language} program differs: {told[0]}")
    return partial(attack_program, language, plan, files)


KINDS = {
    name: Kind(
        f"lines and words of a {LANGUAGES[name].title} program", COUNT if name in ASKED else 0, partial(_prepared, name)
    )
    for name in TEXTS
}
