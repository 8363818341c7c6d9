"""G-code of machines with five and six axes: kinematics, the way chosen, and what is written, read back in full."""

from __future__ import annotations

import re
from dataclasses import replace
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import tree_sitter_gcode
from gcodeparser import parse_gcode_lines
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from solved import solve_alone
from tree_sitter import Language as Grammar
from tree_sitter import Parser

from planner.base.arrays import Array
from planner.base.errors import InputError
from planner.cell.cell import build_cell
from planner.export.axes.flavours import feed_length
from planner.export.axes.gcode import axes_gcode, differences, feed_word, file_name, read_axes
from planner.export.axes.machine import FROM_ZERO, JUMP, FiveAxes, Machine, PoseMachine, chosen, machine_of, missing
from planner.export.fit import from_matrix
from planner.export.languages import check_languages
from planner.export.support import unsupported_in_axes
from planner.export.write import write_robot_code
from planner.plan import Event, Plan
from planner.problem import load_problem
from planner.problem.process import StartSpec
from planner.problem.settings import MachineSpec
from tests.export_fixtures import GOLDEN, axes_texts, make_plan, written_with
from tests.solved import small_problem

X, Y, Z = (1, 0, 0), (0, 1, 0), (0, 0, 1)


def axes_differences(plan: Plan, text: str) -> list[str]:
    """What a program says otherwise than its plan."""
    return differences(plan, {file_name(plan): text})


def axis(letter: str, direction: tuple[float, ...], centre: tuple[float, ...] = (0, 0, 0), **more: Any) -> Any:
    return {"letter": letter, "direction": direction, "centre_mm": centre, **more}


MACHINES: dict[str, dict[str, Any]] = {
    "trunnion": {
        "flavour": "reprap",
        "type": "table_table",
        "rotary": (axis("A", X, (1, 2, 30), range_deg=(-110, 110)), axis("C", Z, (-3, 5, 7))),
        "part_mm": (30, -20, 15),
    },
    "fork": {
        "flavour": "linuxcnc",
        "type": "head_head",
        "rotary": (axis("C", Z, (0, 0, 200)), axis("B", Y, (0, 0, 150))),
        "tcp": True,
    },
    "fork without tcp": {
        "flavour": "linuxcnc",
        "type": "head_head",
        "rotary": (axis("C", Z, (0, 0, 200)), axis("B", Y, (0, 0, 150))),
        "extruder": "U",
    },
    "swivel head": {
        "flavour": "reprap",
        "type": "head_table",
        "rotary": (axis("B", Y, (0, 0, 200)), axis("C", Z, (40, 0, 0))),
        "feed": "per_minute",
    },
    "nutating": {
        "flavour": "linuxcnc",
        "type": "table_table",
        "rotary": (axis("B", (0, 1, 1), (0, 10, 0)), axis("C", Z)),
        "part_rpy_deg": (0, 0, 30),
    },
    "robot": {"flavour": "linuxcnc", "type": "robot"},
}


def spec(name: str, **changes: Any) -> MachineSpec:
    return MachineSpec(**MACHINES[name] | changes)


@cache
def cap() -> Plan:
    """The cap of the peers: a spiral that ends at a pole, with no step between its turns."""
    return solve_alone(load_problem("peer_cap"))


@cache
def fibre() -> Plan:
    """The small print with fibre, its cuts, heating and a fan."""
    changes = [
        "process.fibre={cut_length_mm: 12, cut_wait_s: 2.5}",
        "process.start={nozzle_c: 280, heat_wait_s: 2}",
        "process.fan={number: 1, from_layer: 1, speed: 0.5}",
    ]
    return solve_alone(load_problem(small_problem().file, changes))


def on(plan: Plan, machine: MachineSpec, **more: Any) -> Plan:
    program = plan.problem.program.model_copy(update={"machine": machine, **more})
    problem = plan.problem.model_copy(update={"program": program})
    problem.model_post_init(plan.problem._source)
    return replace(plan, problem=problem)


@cache
def written(name: str) -> tuple[Plan, str]:
    plan = on(cap(), spec(name))
    return plan, axes_gcode(plan)


# --- machines


def unit(v: Array) -> Array:
    out: Array = v / np.linalg.norm(v)
    return out


@st.composite
def machines(draw: st.DrawFn) -> FiveAxes:
    number = st.floats(-1.0, 1.0)
    vector = st.tuples(number, number, number).filter(lambda v: np.linalg.norm(v) > 0.1)
    tables = draw(st.sampled_from([(True, True), (False, True), (False, False)]))
    directions = np.array([unit(np.array(draw(vector))) for _ in range(2)])
    near_nozzle = directions[1 if tables == (False, False) else 0]
    assume(np.linalg.norm(np.cross(*directions)) > 0.1 and np.hypot(*near_nozzle[:2]) > 0.1)
    R = Rotation.from_rotvec(np.array(draw(vector))).as_matrix()
    centres = 0.2 * np.array([draw(vector) for _ in range(2)])
    return FiveAxes(("A", "C"), (None, None), directions, centres, tables, R, np.array(draw(vector)), False)


def pose(machine: FiveAxes, straight: Array, angles: Array) -> tuple[Array, Array]:
    """Tip and direction in the part, from what carries what: shares nothing with the planner's."""

    def about(i: int) -> Array:
        T = np.eye(4)
        T[:3, :3] = Rotation.from_rotvec(angles[i] * machine.directions[i]).as_matrix()
        T[:3, 3] = machine.centres[i] - T[:3, :3] @ machine.centres[i]
        return T

    head, table = np.eye(4), np.eye(4)
    for i in range(2):
        if machine.tables[i]:
            table = table @ about(i)
        else:
            head = head @ about(i)
    part = np.eye(4)
    part[:3, :3], part[:3, 3] = machine.R, machine.origin
    slide = np.eye(4)
    slide[:3, 3] = straight
    T = np.linalg.inv(table @ part) @ slide @ head
    return T[:3, 3], -T[:3, 2]


@pytest.mark.slow
@settings(max_examples=150, deadline=None)
@given(machines(), st.tuples(*[st.floats(-3.0, 3.0)] * 2), st.integers(0, 10_000))
def test_both_ways_lead_back_to_the_direction_and_the_tip(
    machine: FiveAxes, theta: tuple[float, ...], seed: int
) -> None:
    straight = np.random.default_rng(seed).normal(size=3)
    tip, direction = pose(machine, straight, np.array(theta))
    x = unit(np.cross(direction, [0.3, 0.5, -0.8]))
    quat = from_matrix(np.column_stack([x, np.cross(direction, x), direction])[None])
    ways = machine.ways(quat)
    assert ways.reached[0], "it was reached just now"
    assume(not ways.free[0])
    found = ways.angles[0]
    for way in found:
        there = machine.straight(tip[None], way[None])
        back, again = pose(machine, there[0], way)
        assert np.abs(back - tip).max() < 1e-9 and np.linalg.norm(again - direction) < 2e-7
        assert np.abs(machine.tip(there, way[None])[0] - tip).max() < 1e-9
        assert machine.leaning(way[None], quat)[0] < 2e-7
    apart = np.abs(np.exp(1j * found) - np.exp(1j * np.array(theta))).max(axis=1)
    assert apart.min() < 1e-5, "one of both is how it got there"


@settings(max_examples=100, deadline=None)
@given(machines(), st.integers(0, 10_000))
def test_what_cannot_be_reached_is_told(machine: FiveAxes, seed: int) -> None:
    quat = Rotation.random(20, random_state=seed).as_quat()
    ways = machine.ways(quat)
    u, w = machine.directions[machine.loose], machine.directions[1 - machine.loose]
    tilt = np.degrees(np.arccos(w @ [0.0, 0.0, -1.0]))
    middle = np.degrees(np.arccos(u @ w))
    lean = np.degrees(np.arccos(np.clip((machine.R @ Rotation.from_quat(quat).as_matrix()[:, :, 2].T).T @ u, -1, 1)))
    # the nozzle's cone about the axis next to it, seen from the one next to the part
    least, most = abs(middle - tilt), min(middle + tilt, 360 - middle - tilt)
    inside = (lean > least + 0.01) & (lean < most - 0.01)
    outside = (lean < least - 0.01) | (lean > most + 0.01)
    assert ways.reached[inside].all() and not ways.reached[outside].any()
    assert np.isfinite(ways.angles[ways.reached]).all()


@given(st.floats(-3.1, 3.1), st.floats(-1.6, 1.6) | st.just(np.pi / 2) | st.just(-np.pi / 2), st.floats(-3.1, 3.1))
def test_roll_pitch_yaw_are_those_of_linuxcnc(a: float, b: float, c: float) -> None:
    R = Rotation.from_euler("xyz", [a, b, c])  # fixed axes: Rz(c) Ry(b) Rx(a)
    quat, robot = R.as_quat()[None], PoseMachine()
    ways = robot.ways(quat)
    found = robot.settled(np.array([[a, 0.0, 0.0]]), quat) if ways.free[0] else ways.angles[0]
    for angles in found:
        assert (Rotation.from_euler("xyz", angles) * R.inv()).magnitude() < np.radians(0.03)


# --- the way over the print


def along(machine: Machine, directions: Array) -> Array:
    """Orientations (n, 4) whose z is a direction, from one to the next without turning about it."""
    x = unit(np.cross(directions[0], [0.31, 0.52, -0.79]))
    out = []
    for z in directions:
        x = unit(x - (x @ z) * z)
        out.append(np.column_stack([x, np.cross(z, x), z]))
    return from_matrix(np.array(out))


def ways_of(machine: Machine, directions: Array) -> tuple[Array, Array]:
    quat = along(machine, directions)
    ways = machine.ways(quat)
    assert not len(missing(ways, machine))
    n = len(quat)
    return chosen(ways, machine, np.arange(n) * 0.004, np.ones(n, dtype=bool), quat), quat


def tilted(lean: Array, turn: Array) -> Array:
    """Directions (n, 3) that lean from straight down by angles, towards bearings."""
    return np.column_stack([np.sin(lean) * np.cos(turn), np.sin(lean) * np.sin(turn), -np.cos(lean)])


TRUNNION = machine_of(spec("trunnion"))


def test_whole_turns_are_kept() -> None:
    angles, quat = ways_of(TRUNNION, tilted(np.full(3000, 0.7), np.linspace(0.0, 6.0 * np.pi, 3000)))
    assert np.abs(np.diff(angles, axis=0)).max() < 0.01
    assert np.ptp(angles[:, 1]) == pytest.approx(6.0 * np.pi, abs=1e-6) and np.ptp(angles[:, 0]) < 1e-6
    assert TRUNNION.leaning(angles, quat).max() < 1e-6


@pytest.mark.slow
@settings(max_examples=50, deadline=None)
@given(st.floats(0.0, 6.28), st.floats(0.3, 1.4), st.booleans())
def test_through_the_pole_no_axis_leaps(bearing: float, lean: float, hits: bool) -> None:
    """Over the pole the tilt changes its sign and the table stays; both ways meet there, and the better is taken."""
    lean_by = np.linspace(-lean, lean, 401 if hits else 400)
    angles, quat = ways_of(TRUNNION, tilted(lean_by, np.full(len(lean_by), bearing)))
    assert np.abs(np.diff(angles, axis=0)).max() < JUMP
    assert np.ptp(angles[:, 1]) < np.radians(0.05) and np.ptp(angles[:, 0]) == pytest.approx(2 * lean, abs=1e-3)
    assert TRUNNION.leaning(angles, quat).max() < np.radians(0.02)


def test_at_the_pole_the_table_turns_evenly_to_what_comes_next() -> None:
    lean = np.concatenate([np.linspace(0.5, 0.0, 100), np.zeros(200), np.linspace(0.0, 0.5, 100)])
    turn = np.concatenate([np.zeros(200), np.full(200, 1.2)])
    angles, quat = ways_of(TRUNNION, tilted(lean, turn))
    steps = np.abs(np.diff(angles[:, 1]))[99:301]
    assert steps.max() < 1.2 * 1.2 / 200 + 1e-9 and TRUNNION.leaning(angles, quat).max() < np.radians(0.03)
    still = ways_of(TRUNNION, tilted(np.zeros(50), np.zeros(50)))[0]
    assert np.abs(still).max() == 0.0, "nothing needs to turn at all"


@pytest.mark.slow
@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10_000), st.sampled_from(["trunnion", "fork", "swivel head"]))
def test_smooth_directions_make_smooth_axes(seed: int, name: str) -> None:
    rng = np.random.default_rng(seed)
    machine, s = machine_of(spec(name)), np.linspace(0.0, 1.0, 600)
    waves = [rng.normal() * np.sin(rng.uniform(1, 9) * s + rng.uniform(0, 6)) for _ in range(2)]
    bearing = 3.0 * waves[0] + rng.uniform(0, 6)
    lean = 0.9 + 0.3 * np.tanh(waves[1])  # away from the pole, where an axis is free
    angles, quat = ways_of(machine, tilted(lean, bearing))
    turned = np.arccos(np.clip(np.einsum("ij,ij->i", tilted(lean, bearing)[1:], tilted(lean, bearing)[:-1]), -1, 1))
    assert (np.abs(np.diff(angles, axis=0)).max(axis=1) < 3.0 * turned + 1e-6).all()
    assert machine.leaning(angles, quat).max() < 1e-6


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 10_000), st.booleans())
def test_no_other_way_turns_less(seed: int, narrow: bool) -> None:
    """Against all ways that there are over a few far apart directions, for axes with ranges."""
    rng = np.random.default_rng(seed)
    rotary = (axis("A", X, range_deg=(-100, 60 if narrow else 100)), axis("C", Z, range_deg=(-300, 300)))
    machine = machine_of(spec("trunnion", rotary=rotary))
    n = 5
    quat = along(machine, tilted(rng.uniform(0.1, 1.0, n), rng.uniform(-3.0, 3.0, n)))
    ways = machine.ways(quat)
    angles = chosen(ways, machine, np.arange(n) * 1.0, np.zeros(n, dtype=bool), quat)
    assert machine.leaning(angles, quat).max() < 1e-6
    each = []
    for i in range(n):
        whole = [way + 2.0 * np.pi * np.array([0, k]) for way in ways.angles[i] for k in (-1, 0, 1)]
        low, high = (np.array(bound) for bound in zip(*machine.ranges, strict=True))
        each.append([way for way in whole if (low <= way).all() and (way <= high).all()])
    least = {0: [FROM_ZERO * np.abs(way).sum() for way in each[0]]}
    for i in range(1, n):
        steps = [[np.abs(b - a).sum() for a in each[i - 1]] for b in each[i]]
        least[i] = [min(c + s for c, s in zip(least[i - 1], row, strict=True)) for row in steps]
    taken = FROM_ZERO * np.abs(angles[0]).sum() + np.abs(np.diff(angles, axis=0)).sum()
    assert taken == pytest.approx(min(least[n - 1]), abs=1e-9)


def test_ranges_decide_the_way() -> None:
    """An axis that tilts one way only takes the way that the other sign would not."""
    for within in ((-110.0, 5.0), (-5.0, 110.0)):
        rotary = (axis("A", X, range_deg=within), axis("C", Z, range_deg=(-720, 720)))
        machine = machine_of(spec("trunnion", rotary=rotary))
        angles, _ = ways_of(machine, tilted(np.linspace(0.5, 1.0, 500), np.linspace(0.0, 12.0, 500)))
        assert np.radians(within[0]) <= angles[:, 0].min() and angles[:, 0].max() <= np.radians(within[1])
        assert np.abs(angles[:, 1]).max() <= np.radians(720) and np.ptp(angles[:, 1]) == pytest.approx(12.0, abs=1e-6)


# --- what is written


def test_the_file_has_another_name_than_the_extruders() -> None:
    plan = written_with(make_plan(), machine=spec("trunnion"))
    for name, file in (("Extrusion", "print_Extrusion.gcode"), ("extrusions", "extrusions.gcode")):
        named = SimpleNamespace(**vars(plan.problem) | {"name": name})
        assert file_name(replace(plan, problem=named)) == file  # type: ignore[arg-type]


def replayed(name: str, plan: Plan, text: str) -> tuple[Array, Array, Array, Array]:
    """Tips, directions, times and filament of all moves at 7 places each, by a reader of the test's own."""
    machine, machine_spec = machine_of(spec(name)), spec(name)
    place: dict[str, float] = {}
    now = pushed = 0.0
    out = []
    inverse = "G93" in text.splitlines()
    for line in text.splitlines():
        words = {word[0]: float(word[1:]) for word in line.split(";")[0].split()}
        if words.get("G") == 4:
            now += words["P"] * (1.0 if machine_spec.flavour == "linuxcnc" else 1e-3)
        if words.get("G") not in (0, 1):
            continue
        before, filament = dict(place), pushed
        if machine_spec.filament in words:
            told = words[machine_spec.filament]
            pushed = told if machine_spec.flavour == "linuxcnc" else pushed + told
        place |= {k: v for k, v in words.items() if k not in ("G", "F", machine_spec.filament)}
        if words["G"] == 0:
            continue
        step = np.array([place[k] - before[k] for k in "XYZ"])
        length = float(np.linalg.norm(step))
        if not inverse and length == 0.0:
            turning = [place[k] - before[k] for k in machine.letters]
            length = float(np.linalg.norm(turning)) or abs(pushed - filament)
        lasts = 60.0 / words["F"] * (1.0 if inverse else length)
        for u in np.arange(7) / 6.0:
            at = {k: before[k] + u * (place[k] - before[k]) for k in place}
            straight = 1e-3 * np.array([at[k] for k in "XYZ"])
            angles = np.radians([at[k] for k in machine.letters])
            if isinstance(machine, PoseMachine):
                R = Rotation.from_euler("xyz", angles).as_matrix()
                tip, direction = straight, R[:, 2]
            elif machine.tcp:
                direction = pose(machine, straight, angles)[1]
                tip = machine.R.T @ (straight - machine.origin)
            else:
                tip, direction = pose(machine, straight, angles)
            out.append((*tip, *direction, now + u * lasts, filament + u * (pushed - filament)))
        now += lasts
    table = np.array(out)
    return table[:, :3], table[:, 3:6], table[:, 6], table[:, 7]


@pytest.mark.slow
@pytest.mark.parametrize("name", MACHINES)
def test_a_spiral_to_the_pole_is_printed_as_planned(name: str) -> None:
    plan, text = written(name)
    assert axes_differences(plan, text) == []
    t = plan.trajectory
    tips, directions, times, filament = replayed(name, plan, text)
    laid = np.flatnonzero(t.deposit)
    begin, end = t.t[laid[0]], t.t[laid[-1]]
    inside = (times > begin + 1e-3) & (times < end - 1e-3)
    # path and direction at the nearest of the plan's samples, which lie 0.16 mm apart
    near = np.clip(np.searchsorted(t.t, times[inside]), 1, len(t) - 1)
    off = np.full(inside.sum(), np.inf)
    lean = np.full(inside.sum(), np.inf)
    for by in range(-4, 5):
        b = np.clip(near + by, 1, len(t) - 1)
        chord = t.tip[b] - t.tip[b - 1]
        share = np.einsum("ij,ij->i", tips[inside] - t.tip[b - 1], chord) / np.einsum("ij,ij->i", chord, chord)
        share = np.clip(share, 0.0, 1.0)[:, None]
        gap = np.linalg.norm(t.tip[b - 1] + share * chord - tips[inside], axis=1)
        wanted = t.axis[b - 1] + share * (t.axis[b] - t.axis[b - 1])
        angle = np.linalg.norm(wanted - directions[inside], axis=1)
        off, lean = np.where(gap < off, gap, off), np.where(gap < off, angle, lean)
    # between samples the tip may leave its chord by a little more than at them
    assert off.max() < plan.problem.program.chord + 0.01e-3 and lean.max() < np.radians(0.1)
    assert times[-1] <= t.t[-1] + 2e-3
    for at in (begin, end):
        assert np.interp(at, times, filament) == pytest.approx(np.interp(at, t.t, t.feed) * 1e3, abs=0.02)
    assert filament[-1] == pytest.approx(t.feed[-1] * 1e3, abs=1e-3)


@pytest.mark.slow(cases=("trunnion",))
@pytest.mark.parametrize("name", MACHINES)
def test_others_read_every_line(name: str) -> None:
    _, text = written(name)
    parser = Parser(Grammar(tree_sitter_gcode.language()))
    for line in text.splitlines():
        tree = parser.parse((line + "\n").encode())
        assert not tree.root_node.has_error, line
        assert len(line) <= 256
    letter = spec(name).filament
    told = [each.params[letter] for each in parse_gcode_lines(text) if letter in each.params]
    total = sum(told) if letter == "E" else told[-1]
    assert total == pytest.approx(cap().trajectory.feed[-1] * 1e3, abs=1e-3)


@pytest.mark.parametrize(("name", "noted"), [("fork", True), ("robot", False)])
def test_the_header_says_what_is_purged_above_the_first_bead(name: str, noted: bool) -> None:
    """A robot purges at home."""
    plan = written_with(make_plan(beads=1, length=0.008, dip=False), machine=spec(name))
    process = plan.problem.process.model_copy(update={"start": StartSpec(purge_mm=30)})
    text = axes_gcode(replace(plan, problem=SimpleNamespace(**vars(plan.problem) | {"process": process})))
    assert ("; Note: 30 mm of filament are purged where the machine waits at first" in text) == noted


def test_a_long_note_of_a_pause_is_cut() -> None:
    plan = written_with(make_plan(beads=1, length=0.008, dip=False), machine=spec("trunnion"))
    pause = Event("pause", 0, 0.0, 0.0, 0.0, note="put in the nut, " * 60)
    text = axes_gcode(replace(plan, trajectory=replace(plan.trajectory, events=(pause,))))
    assert "\n; pause: put in the nut, put" in text
    read_axes(text, spec("trunnion"), ("X", "Y", "Z", "A", "C"))


def test_modes_come_first_and_a_program_says_what_it_is_for() -> None:
    lines = [line for line in written("trunnion")[1].splitlines() if not line.startswith(";")]
    assert lines[:5] == ["G21", "G90", "M203 I0.6", "M83", "T0"] and lines.index("G93") == 8
    assert [line.split()[0] for line in lines[5:8]] == ["G0"] * 3
    assert lines[-2:] == ["G94", "M400"]
    lines = [line for line in written("fork")[1].splitlines() if not line.startswith(";")]
    assert lines[:4] == ["G17 G21 G40 G49 G80 G90", "G64 P0.0500", "G92 W0", "M428"] and "G93" in lines
    assert lines[-3:] == ["G94", "M429", "M2"]


@pytest.mark.slow
def test_fibre_heat_and_fan_are_said_to_both_controllers() -> None:
    for name, code, pause in (("trunnion", "M106 P0 S1", "G4 P500"), ("robot", "M106 P0 Q1", "G4 P0.500")):
        plan = on(fibre(), spec(name))
        text = axes_gcode(plan)
        assert axes_differences(plan, text) == []
        lines = text.splitlines()
        heat = "M104 S280" if name == "trunnion" else "M104 Q280"
        assert heat in lines and lines.count(code) == 3
        for k in (i for i, line in enumerate(lines) if line == code):
            assert [lines[k + 1], lines[k + 3]] == [pause, pause]
            for i in (
                k - 2,
                k + 4,
            ):  # a comment stands above the cut; what rounding leaves of the filament takes the rest
                moved = re.fullmatch(r"G1 [EW][\d.]+ F([\d.]+)", lines[i])
                assert not moved or name == "robot" or lines[i].startswith("G1 E0.00001 "), lines[i]
                paused = lines[i].removeprefix("G4 P")
                rest = 60.0 / float(moved[1]) if moved else float(paused) * (1e-3 if name == "trunnion" else 1.0)
                assert rest == pytest.approx(0.5 * (2.5 - 1.0), abs=2 * plan.trajectory.dt), "half of what is left"
        assert any(line.startswith("M106 P1 ") for line in lines)


@pytest.mark.parametrize(
    ("flavour", "moved", "length"),
    [
        ("linuxcnc", {"X": 3.0, "Y": 0.0, "Z": 4.0, "A": 90.0, "W": 7.0}, 5.0),
        ("linuxcnc", {"X": 0.0, "A": 90.0, "U": 3.0, "W": 4.0}, 5.0),
        ("linuxcnc", {"A": 3.0, "C": 4.0, "W": 0.0}, 5.0),
        ("reprap", {"X": 0.3, "Y": 0.4, "A": 90.0, "E": 7.0}, 0.5),
        ("reprap", {"X": 0.0, "A": 3.0, "U": 4.0, "E": 7.0}, 5.0),
        ("reprap", {"A": 0.0, "E": -7.0}, 7.0),
    ],
)
def test_feed_counts_what_the_controller_counts(flavour: str, moved: dict[str, float], length: float) -> None:
    assert feed_length(flavour, moved) == pytest.approx(length)


@pytest.mark.slow
def test_a_robot_on_a_turning_part_keeps_its_feed() -> None:
    """Its part's axis is U, which LinuxCNC counts with the filament's W where the tip rests."""
    plan = on(fibre(), spec("robot", feed="per_minute"))
    assert axes_differences(plan, axes_gcode(plan)) == []


def test_tools_are_changed_at_rest_at_home() -> None:
    plan = make_plan(materials=("pla", "pva"))
    program = plan.problem.program.model_copy(update={"machine": spec("trunnion")})
    plan = replace(plan, problem=SimpleNamespace(**vars(plan.problem) | {"program": program}))  # type: ignore[arg-type]
    text = axes_gcode(plan)
    assert axes_differences(plan, text) == [] and unsupported_in_axes(plan) is None
    assert [line for line in text.splitlines() if line.startswith("T")] == ["T1", "T0"]
    spoilt = text.replace("\nT0\n", "\nT1\n")
    assert any("there are other orders" in each for each in axes_differences(plan, spoilt))
    program = plan.problem.program.model_copy(update={"machine": spec("fork")})
    plan = replace(plan, problem=SimpleNamespace(**vars(plan.problem) | {"program": program}))  # type: ignore[arg-type]
    assert "T0 cannot be sent to linuxcnc" in str(unsupported_in_axes(plan))


def test_what_runs_taught_of_the_robot_is_refused_for_another_machine() -> None:
    plan = make_plan()
    program = plan.problem.program.model_copy(update={"machine": spec("trunnion")})
    taught = vars(plan.problem) | {"program": program, "as_run": object()}
    assert "another machine" in str(unsupported_in_axes(replace(plan, problem=SimpleNamespace(**taught))))  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ("process.fibre={cut_length_mm: 12, cut_code: [M280 P0 S9]}", "M280 P0 S9 cannot be sent to linuxcnc"),
        (
            "cell.positioner.free=[tilt, rotation]",
            "U is the letter both of the filament and of an axis that moves the part",
        ),
    ],
)
def test_what_cannot_be_said_is_refused_before_all_is_planned(change: str, says: str) -> None:
    own = "{flavour: linuxcnc, type: robot, extruder: U}" if "free" in change else "{flavour: linuxcnc, type: robot}"
    problem = load_problem(small_problem().file, [f"program.machine={own}", change])
    with pytest.raises(InputError) as refused:
        check_languages(problem, build_cell(problem))
    assert says in str(refused.value) and "program.machine" in str(refused.value)


def swapped(text: str, pattern: str, change: Any) -> str:
    """A program whose middle line that matches is changed."""
    lines = text.splitlines()
    found = [i for i, line in enumerate(lines) if re.search(pattern, line)]
    i = found[len(found) // 2]
    lines[i] = re.sub(pattern, change, lines[i])
    return "\n".join(line for line in lines if line) + "\n"


SPOILT = {
    "a place": (r"( Y)(-?\d+\.\d+)", lambda m: f"{m[1]}{float(m[2]) + 0.1:.4f}", "path"),
    "a place along the path": (r"^(G1 X)(-?\d+\.\d+)", lambda m: f"{m[1]}{float(m[2]) + 0.8:.4f}", "its time"),
    "an angle": (r"(C)(-?\d+\.\d+)", lambda m: f"{m[1]}{float(m[2]) + 3:.4f}", "path"),
    "a turn": (r"(C)(-?\d+\.\d+)", lambda m: f"{m[1]}{float(m[2]) + 360:.4f}", "path"),
    "where it begins": (r"^(G0 X)(-?\d+\.\d+)", lambda m: f"{m[1]}{float(m[2]) + 0.1:.4f}", "path"),
    "filament": (r"(E)(\d+\.\d+)", lambda m: f"{m[1]}{float(m[2]) + 0.5:.5f}", "filament"),
    "a feed": (r"(F)(\d+\.\d+)", lambda m: f"{m[1]}{float(m[2]) / 2:.4f}", "lasts"),
    "a line lost": (r"^G1 X.*", "", "path"),
    "a stop": (r"^(G1 X.*)", r"\1\nG4 P100", "lasts"),
}


@pytest.mark.parametrize("what", SPOILT)
def test_a_spoilt_program_is_found(what: str) -> None:
    pattern, change, difference = SPOILT[what]
    plan, text = written("trunnion")
    assert any(difference in each for each in axes_differences(plan, swapped(text, pattern, change)))


def test_a_program_of_finer_lines_is_held_to_these() -> None:
    """0.03 mm along the nozzle are across the path: more than a chord of 0.0125 mm, and less than the usual one."""
    plan = on(cap(), spec("trunnion"), chord=0.0125e-3)
    text = axes_gcode(plan)
    assert axes_differences(plan, text) == []
    off = swapped(text, r"( Z)(-?\d+\.\d+)", lambda m: f"{m[1]}{float(m[2]) + 0.03:.4f}")
    assert any("path" in each for each in axes_differences(plan, off))


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("M83\n", "", "M83 is missing"),
        ("G90\n", "G91\n", "unknown line 'G91'"),
        ("G93\n", "G94\n", "G93 is missing"),
        ("\nG94\nM400\n", "\nM400\n", "it does not end with"),
        ("G21\n", "G20\n", "unknown line"),
        ("G93\n", "G93\nM112\n", "unknown line 'M112'"),
        ("G93\n", "G93\nG1 X1.0000 X2.0000 F1.0000\n", "unknown line"),
        ("G93\n", "G93\nG1 X1.0000\n", "unknown line"),
        ("G93\n", "G93\nG1 X1e3 F1.0000\n", "unknown line"),
        ("G93\n", "G93\nG1 F1.0000\n", "unknown line"),
        ("G93\n", "G93\nG0 X1.0000\n", "unknown line"),
        ("G93\n", "G93\nG1 U1.0000 F1.0000\n", "unknown line"),
    ],
)
def test_what_is_not_of_the_subset_is_no_program(old: str, new: str, says: str) -> None:
    text = written("trunnion")[1]
    assert text.count(old) == 1
    with pytest.raises(InputError) as refused:
        read_axes(text.replace(old, new), spec("trunnion"), ("X", "Y", "Z", "A", "C"))
    assert says in str(refused.value)


@settings(max_examples=150, deadline=None)
@given(st.data())
def test_damage_is_an_input_error_or_read_as_it_stands(data: st.DataObject) -> None:
    """Whatever a few characters become, the reader says where it stumbled, or gives finite numbers."""
    text = (GOLDEN / "two_beads.gcode").read_text(encoding="utf-8")
    for _ in range(data.draw(st.integers(1, 3))):
        at = data.draw(st.integers(0, len(text) - 1))
        text = text[:at] + data.draw(st.text("GMXYZACEFPIJ0123456789.-; \n\0é", max_size=3)) + text[at + 1 :]
    try:
        program = read_axes(text, spec("trunnion"), ("X", "Y", "Z", "A", "C"))
    except InputError as error:
        assert "G-code" in str(error)
    else:
        for values in (program.straight, program.turning, program.filament, program.time):
            assert np.isfinite(values).all() and len(values) == len(program.time)
        assert (np.diff(program.time) >= 0.0).all()


@pytest.mark.parametrize("lasts", [0.02, 59.9, 161.7, 900.0])
def test_a_line_lasts_as_long_as_it_is_to(lasts: float) -> None:
    text = (GOLDEN / "two_beads.gcode").read_text(encoding="utf-8")
    text = text.replace("G93\n", f"G93\nG1 X1.0000 {feed_word(60.0 / lasts)}\n", 1)
    program = read_axes(text, spec("trunnion"), ("X", "Y", "Z", "A", "C"))
    assert program.time[1] == pytest.approx(lasts, abs=3.1e-3)


def test_a_hundred_kilometres_of_filament_are_read() -> None:
    """As a bead of 400 m, 30 mm wide and 10 mm high takes, where a millimetre of filament is a cubic one."""
    text = (GOLDEN / "two_beads.gcode").read_text(encoding="utf-8")
    text = text.replace("G93\n", "G93\nG1 X1.0000 E120000000.12345 F1.0000\n", 1)
    program = read_axes(text, spec("trunnion"), ("X", "Y", "Z", "A", "C"))
    assert program.filament[1] == pytest.approx(120_000.00012345, rel=1e-12)


def test_turning_beyond_a_range_is_found() -> None:
    _, text = written("trunnion")
    narrow = on(cap(), spec("trunnion", rotary=(axis("A", X, (1, 2, 30)), axis("C", Z, (-3, 5, 7), range_deg=(-1, 1)))))
    assert "C turns beyond its range" in axes_differences(narrow, text)
    low = on(cap(), spec("trunnion", greatest_mm=(500, 500, 100)))
    assert axes_differences(low, text) == ["Z goes beyond its limits"]


def test_the_way_to_the_first_place_goes_no_higher_than_the_machine() -> None:
    plan = written_with(make_plan(beads=1, length=0.008, dip=False), machine=spec("trunnion"))
    text = axes_gcode(plan)
    lifted = re.search(r"^G0 Z(\S+)$", text, re.MULTILINE)
    assert lifted is not None
    most = float(lifted[1]) - 2.0  # and the motion itself ends 5 mm below
    low = written_with(plan, machine=spec("trunnion", greatest_mm=(500, 500, most)))
    lower = axes_gcode(low)
    assert f"\nG0 Z{most:.4f}\n" in lower
    found = [axes_differences(low, each) for each in (lower, text)]
    assert ["Z goes beyond its limits" in each for each in found] == [False, True]


@pytest.mark.parametrize(
    ("name", "changes", "says"),
    [
        ("trunnion", {"rotary": (axis("A", X, range_deg=(-20, 20)), axis("C", Z))}, r"bead 0, .* mm along it: A/C"),
        ("trunnion", {"rotary": (axis("A", X), axis("C", Z, range_deg=(-180, 180)))}, r"C would have to turn from"),
        (
            "trunnion",
            {"greatest_mm": (500, 28.0, 500)},
            r"Y would have to be at 28.* mm; its limits are -inf and 28",
        ),
        ("fork", {"least_mm": (-60, -500, 0), "tcp": True}, r"X would have to be at -60.* mm; its limits are -60"),
        ("nutating", {"rotary": (axis("B", (0, 0.2, 1)), axis("C", Z))}, "no angles of its axes give the nozzle's"),
    ],
)
def test_what_a_machine_cannot_do_is_refused_with_bead_and_place(name: str, changes: Any, says: str) -> None:
    with pytest.raises(InputError, match=says) as refused:
        axes_gcode(on(cap(), spec(name, **changes)))
    assert "program.machine" in str(refused.value)


# --- the problem file


@pytest.mark.parametrize(
    ("machine", "says"),
    [
        ("{flavour: linuxcnc, type: table_table}", "table_table has 2 rotary axes, not 0"),
        ("{flavour: linuxncn, type: robot}", "did you mean linuxcnc?"),
        ("{flavour: reprap, type: robot}", "reprap has no kinematics"),
        ("{flavour: linuxcnc, type: robot, tcp: true}", "a robot has no rotary axes"),
        ("{flavour: linuxcnc, type: robot, extruder: A}", "linuxcnc has no filament axis A"),
        ("{flavour: linuxcnc, type: robot, tcp_on: M428 ; M2 now}", "must be words of G-code"),
        (
            "{flavour: reprap, type: head_head, rotary: [{letter: C, direction: [0, 0, 1]}, "
            "{letter: B, direction: [0, 1, 0]}], least_mm: [0, 0, 0], greatest_mm: [100, 0, 100]}",
            "Y has no range: least_mm is not below greatest_mm",
        ),
        (
            "{flavour: linuxcnc, type: head_head, rotary: [{letter: U, direction: [0, 0, 1]}, "
            "{letter: B, direction: [0, 1, 0]}]}",
            "linuxcnc has no rotary axis U",
        ),
        (
            "{flavour: reprap, type: head_head, rotary: [{letter: B, direction: [0, 0, 1]}, "
            "{letter: B, direction: [0, 1, 0]}]}",
            "two axes are called B",
        ),
        (
            "{flavour: reprap, type: head_head, rotary: [{letter: C, direction: [0, 0, 1]}, "
            "{letter: B, direction: [0, 0, -1]}]}",
            "the two axes are parallel",
        ),
        (
            "{flavour: reprap, type: head_head, rotary: [{letter: B, direction: [0, 1, 0]}, "
            "{letter: C, direction: [0, 0, 1]}]}",
            "the axis that tilts and the nozzle are parallel",
        ),
        (
            "{flavour: reprap, type: head_head, tcp: 'yes', rotary: [{letter: C, direction: [0, 0, 1]}, "
            "{letter: B, direction: [0, 1, 0], range_deg: [-2000, 0]}]}",
            "range_deg",
        ),
    ],
)
def test_a_machine_that_cannot_be_is_refused_with_its_line(machine: str, says: str) -> None:
    with pytest.raises(InputError) as refused:
        load_problem(small_problem().file, [f"program.machine={machine}"])
    assert says in str(refused.value)


def test_a_machine_in_the_problem_has_its_program_written(tmp_path: Path) -> None:
    plan = on(cap(), spec("trunnion"))
    names = [path.name for path in write_robot_code(plan, tmp_path)]
    assert names == ["peer_cap.gcode", "PeerCap.mod", "PeerCap.pgf", "extrusion.gcode"]
    assert (tmp_path / "peer_cap.gcode").read_text() == written("trunnion")[1]
    narrow = on(cap(), spec("trunnion", rotary=(axis("A", X, range_deg=(-20, 20)), axis("C", Z))))
    with pytest.raises(InputError):
        write_robot_code(narrow, tmp_path / "other")
    assert not (tmp_path / "other").exists(), "nothing is half-written"


@pytest.mark.parametrize("name", ["two_beads.ngc", "two_beads.gcode"])
def test_golden(name: str) -> None:
    expected = (GOLDEN / name).read_text(encoding="utf-8")
    assert axes_texts()[name] == expected, "python -m tests.export_fixtures writes them anew"
    assert len(expected) < 15_000
