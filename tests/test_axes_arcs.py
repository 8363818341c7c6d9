"""Circular moves of multi-axis G-code: what they are written for, and that wrong ones are found."""

from __future__ import annotations

import re
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from gcodeparser import parse_gcode_lines
from hypothesis import given, settings
from hypothesis import strategies as st
from solved import solve_alone

from planner.base.errors import InputError
from planner.export.axes.arcs import centre_and_swept, via_point
from planner.export.axes.gcode import axes_gcode, differences, file_name
from planner.plan import Plan
from planner.problem import load_problem
from planner.problem.settings import MachineSpec

FORK: dict[str, Any] = {
    "flavour": "linuxcnc",
    "type": "head_head",
    "rotary": (
        {"letter": "C", "direction": (0, 0, 1), "centre_mm": (0, 0, 200)},
        {"letter": "B", "direction": (0, 1, 0), "centre_mm": (0, 0, 150)},
    ),
}
MACHINES: dict[str, dict[str, Any]] = {
    "fork": FORK,
    "fork with tcp": FORK | {"tcp": True},
    "per minute": FORK | {"feed": "per_minute"},
    "reprap": FORK | {"flavour": "reprap", "feed": "per_minute"},
    "robot": {"flavour": "linuxcnc", "type": "robot"},
}
ARC = re.compile(r"^G[23] ", re.MULTILINE)


@cache
def level() -> Plan:
    """A box in level layers."""
    return solve_alone(load_problem("planar_gcode"))


def told(machine: dict[str, Any], **more: Any) -> Plan:
    """The plan for a machine."""
    program = level().problem.program.model_copy(update={"machine": MachineSpec(**machine), **more})
    problem = level().problem.model_copy(update={"program": program})
    problem.model_post_init(level().problem._source)
    return replace(level(), problem=problem)


def wrong(plan: Plan, text: str) -> list[str]:
    """What a program says otherwise than its plan."""
    return differences(plan, {file_name(plan): text})


angles = st.floats(0.08, 6.2)


@settings(max_examples=200, deadline=None)
@given(angles, st.floats(-3.1, 3.1), st.floats(1e-3, 0.3), st.booleans())
def test_an_arc_is_what_its_via_point_says(swept: float, begin: float, radius: float, clockwise: bool) -> None:
    centre, signed = np.array([0.02, -0.05]), -swept if clockwise else swept
    a, b = (centre + radius * np.array([np.cos(v), np.sin(v)]) for v in (begin, begin + signed))
    via = via_point(a, b, centre, clockwise)
    assert via is not None
    middle = begin + 0.5 * signed
    assert np.abs(via - centre - radius * np.array([np.cos(middle), np.sin(middle)])).max() < 1e-9
    found, again = centre_and_swept(a, via, b)
    assert np.abs(found - centre).max() < 1e-6 and again == pytest.approx(signed, abs=1e-4)


@pytest.mark.slow
@pytest.mark.parametrize("name", MACHINES)
def test_arcs_take_the_place_of_lines(name: str) -> None:
    plan, lines = told(MACHINES[name]), told(MACHINES[name], arcs=False)
    text, without = axes_gcode(plan), axes_gcode(lines)
    assert wrong(plan, text) == [] and wrong(lines, without) == []
    assert len(ARC.findall(text)) > 20 and not ARC.search(without)
    assert len(text.splitlines()) < len(without.splitlines())
    for each in parse_gcode_lines(text):  # nothing moves but X, Y and filament
        if each.command_str in ("G2", "G3"):
            assert each.params.keys() <= {"X", "Y", "I", "J", "E", "W", "F"} and {"I", "J"} <= each.params.keys()


@pytest.mark.slow
def test_reprap_is_told_lines_where_each_says_its_time() -> None:
    assert not ARC.search(axes_gcode(told(MACHINES["reprap"] | {"feed": "inverse_time"})))


def moved(letter: str, by: float) -> Any:
    """Adds to the number behind a letter."""
    return lambda line: re.sub(rf" {letter}(-?[\d.]+)", lambda m: f" {letter}{float(m[1]) + by:.4f}", line)


SPOILT = {
    "centre across": moved("I", 0.2),
    "centre along": moved("J", 0.2),
    "the other way": lambda line: ("G3" if line.startswith("G2") else "G2") + line[2:],
    "another plane": lambda line: f"G18\n{line}",
    "wrong plane": lambda line: line.replace(" J", " K"),
    "a line": lambda line: "G1" + re.sub(r" [IJ]-?[\d.]+", "", line[2:]),
    "a helix": lambda line: line.replace(" I", " Z9.0000 I"),
    "no centre": lambda line: re.sub(r" [IJ]-?[\d.]+", "", line),
    "its feed": moved("F", 900.0),
}


@pytest.mark.slow
@pytest.mark.parametrize("what", SPOILT)
def test_a_spoilt_arc_is_found(what: str) -> None:
    plan = told(FORK)
    lines = axes_gcode(plan).splitlines()

    at = [i for i, line in enumerate(lines) if ARC.match(line)][len(ARC.findall("\n".join(lines))) // 2]
    lines[at] = SPOILT[what](lines[at])
    try:
        found = wrong(plan, "\n".join(lines) + "\n")
    except InputError as error:
        found = [str(error)]
    assert found
