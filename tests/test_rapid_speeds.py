"""Speeds of reorientation and of axes, and what is said of points on arcs' ways: changed ones are found."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest

from planner.export.languages import LANGUAGES
from planner.export.moves import plan_moves
from planner.export.rapid.declarations import speed_numbers, speeds
from planner.export.rapid.writer import rapid_files
from planner.plan import Plan
from tests.export_fixtures import make_plan, socket_plan

MODULE = "TwoBeads.mod"
USUAL = r"CONST speeddata vel\w+:=\[([-\d.,]+)\];"  # a move's speeds: tip, reorientation, axes that slide, that turn
ON_ARC = r"(?:MoveC|TriggC) \[(\[[^\]]*\],\[[^\]]*\],\[[^\]]*\],\[[^\]]*\])\],"
SPEEDS = {1: "speeds of reorientation", 2: "speeds of axes that slide", 3: "speeds of axes that turn"}


@cache
def plan() -> Plan:
    return make_plan()


@cache
def files() -> dict[str, str]:
    return rapid_files(plan())


def changed(pattern: str, which: int, change: Callable[[str], str]) -> list[str]:
    """What is found when the first group of a match is changed."""
    text = files()[MODULE]
    matches = list(re.finditer(pattern, text))
    match = matches[which % len(matches)]
    new = text[: match.start(1)] + change(match[1]) + text[match.end(1) :]
    assert new != text
    return LANGUAGES["rapid"].differences(plan(), files() | {MODULE: new})


def number(at: int, change: Callable[[float], float], of: str = ",") -> Callable[[str], str]:
    """A change of one number of a list."""

    def change_one(text: str) -> str:
        parts = text.split(of)
        parts[at] = f"{change(float(parts[at])):.7g}"
        return of.join(parts)

    return change_one


def in_target(group: int, change: Callable[[str], str]) -> Callable[[str], str]:
    """A change within one of the four lists of a target."""

    def change_one(text: str) -> str:
        groups = text[1:-1].split("],[")
        groups[group] = change(groups[group])
        return f"[{'],['.join(groups)}]"

    return change_one


def test_a_program_as_it_is_written_has_nothing() -> None:
    assert LANGUAGES["rapid"].differences(plan(), files()) == []
    other = socket_plan()
    assert LANGUAGES["rapid"].differences(other, rapid_files(other)) == []


@pytest.mark.slow(keep=8)
@pytest.mark.parametrize("factor", [0.5, 0.97, 1.03, 4.0])
@pytest.mark.parametrize("column", [1, 2, 3])
@pytest.mark.parametrize("which", [0, -1])
def test_speeds_that_were_changed_are_found(column: int, factor: float, which: int) -> None:
    used = [
        name for name in re.findall(r"speeddata (vel\w+)", files()[MODULE]) if files()[MODULE].count(f",{name},") > 0
    ]
    pattern = USUAL.replace(r"vel\w+", used[which])
    found = changed(pattern, 0, number(column, lambda v: v * factor))
    assert any(difference.startswith(SPEEDS[column]) for difference in found), found


def test_a_slow_bead_s_speed_keeps_the_digits_that_its_time_needs() -> None:
    """At 5.862 mm/s a bead of 400 s would end 34 ms off its time."""
    moves = plan_moves(plan())
    numbers = speed_numbers(plan(), replace(moves, speed=np.where(moves.laid, 5.8625e-3, moves.speed)))
    lines, names = speeds(numbers)
    assert names[1 + int(np.argmax(moves.laid))] == "vel5_8625"
    assert any("vel5_8625:=[5.8625," in line for line in lines)


@pytest.mark.parametrize("mm_s", [33.3333333, 133.3333333])
def test_a_bead_as_fast_as_travel_has_the_same_speed(mm_s: float) -> None:
    process = plan().problem.process.model_copy(update={"travel_speed": mm_s * 1e-3})
    asked = SimpleNamespace(**vars(plan().problem) | {"process": process})
    moves = plan_moves(plan())
    moves = replace(moves, speed=np.where(moves.laid, mm_s * 1e-3, moves.speed))
    lines, names = speeds(speed_numbers(replace(plan(), problem=asked), moves))  # type: ignore[arg-type]
    declared = [line.split(":=")[0] for line in lines]
    assert len(set(declared)) == len(declared)
    assert names[0] == names[1 + int(np.argmax(moves.laid))] == f"vel{mm_s:.6g}".replace(".", "_")


def test_the_way_to_the_start_has_its_speed() -> None:
    name = re.search(r"MoveAbsJ \[.*?\]\],(vel\w+),", files()[MODULE])
    assert name is not None
    others = sorted(set(re.findall(r"speeddata (vel\w+)", files()[MODULE])) - {name[1]})
    found = changed(r"MoveAbsJ \[.*?\]\],(vel\w+),", 0, lambda _: others[0])
    assert "the speed of the way to the start is not the planned one" in found


@pytest.mark.parametrize(
    "change",
    [
        in_target(2, number(0, lambda v: v + 1)),
        in_target(2, number(1, lambda v: v - 1)),
        in_target(2, number(2, lambda v: v + 1)),
        in_target(2, number(3, lambda v: 1 - v)),
        in_target(3, number(0, lambda v: v + 0.6)),
        in_target(3, number(1, lambda v: v - 0.6)),
        in_target(3, lambda text: text.replace("9E9", "0", 1)),
        in_target(1, lambda text: ",".join(f"{float(v):.7f}" for v in turned([float(v) for v in text.split(",")]))),
    ],
    ids=["cf1", "cf4", "cf6", "cfx", "first axis", "second axis", "an axis that is none", "orientation"],
)
def test_what_is_said_of_a_point_on_the_way_is_the_plans(change: Callable[[str], str]) -> None:
    found = changed(ON_ARC, 1, change)
    assert any("via points of arcs" in difference for difference in found), found


def turned(q: list[float]) -> list[float]:
    """An orientation w x y z turned by 1 degree about its own x."""
    w, x, y, z = q
    c, s = 0.9999619, 0.0087265
    return [c * w - s * x, c * x + s * w, c * y + s * z, c * z - s * y]
