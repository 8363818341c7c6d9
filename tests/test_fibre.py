"""Continuous fibre on what a second arm holds: the shipped problems, and how programs divide their curves."""

from __future__ import annotations

import re
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray
from solved import promises_kept, solve_alone

from planner.base.arrays import Array
from planner.base.errors import InputError
from planner.export import extruder
from planner.export.extruder import gcode
from planner.export.languages import LANGUAGES
from planner.export.moves import cuts, plan_moves, samples_of_rest
from planner.export.rapid.reader import read_rapid_files
from planner.export.rapid.writer import rapid_files
from planner.export.readback import compare
from planner.plan import Plan
from planner.problem import load_problem

FIBRES = ("fibre_plane", "fibre_bowl", "fibre_corrugated")
MOST_LEAN, MOST_OFF = 0.1, 0.05  # deg, mm: what the true surface may be missed by
PUBLISHED = (
    "program.chord_mm=1",
    "program.tangent_deg=45",
    "program.longest_mm=1000",
)  # Tawfik et al., section III.A.1


@cache
def solved(name: str, strategy: str | None = None) -> Plan:
    return solve_alone(load_problem(name, ("process.start.heat_wait_s=0",)), strategy)


@cache
def divided(name: str, *program: str, strategy: str | None = "as_published") -> Plan:
    """A plan with other settings of the program, which the motion does not know; by the strategy that is soonest done."""
    return replace(solved(name, strategy), problem=load_problem(name, program))


def segments(plan: Plan) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """First and last samples (m) of the program's lines that lay fibre."""
    moves = plan_moves(plan)
    first = np.concatenate([[0], moves.sample[:-1]])
    return first[moves.laid], moves.sample[moves.laid]


def chords(plan: Plan) -> tuple[Array, Array, Array]:
    """Length [m] of each line that lays fibre, how far the path leaves it [m], and by what angle [rad] at most."""
    tip, moves = plan.trajectory.tip, plan_moves(plan)
    starts, ends = (moves.targets.position[side][moves.laid] for side in (slice(None, -1), slice(1, None)))
    rows = []
    for a, b, start, end in zip(*segments(plan), starts, ends, strict=True):
        line = end - start
        size = float(np.linalg.norm(line))
        along = np.clip((tip[a : b + 1] - start) @ line / size**2, 0.0, 1.0)
        off = float(np.linalg.norm(start + along[:, None] * line - tip[a : b + 1], axis=1).max())
        steps = np.diff(tip[a : b + 1], axis=0)
        going = np.linalg.norm(steps, axis=1) > 1e-9
        cosine = steps[going] @ line / (np.linalg.norm(steps[going], axis=1) * size)
        rows.append((size, off, float(np.arccos(np.clip(cosine.min(), -1.0, 1.0)))))
    sizes, offs, leans = np.array(rows).T
    return sizes, offs, leans


@pytest.mark.slow
@pytest.mark.parametrize("name", FIBRES)
def test_fibre_is_laid_on_the_true_surface_at_its_speed(name: str) -> None:
    plan = solved(name)
    promises_kept(plan)
    t, surface = plan.trajectory, plan.toolpath.surface
    tip, axis = t.tip[t.deposit], t.axis[t.deposit]
    assert np.abs(surface.signed_distance(tip) * 1e3 - 0.3).max() <= MOST_OFF
    cosine = -(surface.normals(tip) * axis).sum(axis=1)
    assert np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))).max() <= MOST_LEAN
    assert plan.metrics["at_speed_fraction"] >= 0.99
    assert plan.cell.holder.names == ("joint_6",)
    assert len(plan.cell.joint_names) == 7
    assert [event.kind for event in t.events].count("cut") == len(plan.toolpath.beads)


@pytest.mark.slow
def test_two_free_axes_of_the_second_arm_keep_the_part_clear_of_it() -> None:
    """They bend the bowl towards the forearm that holds it."""
    wrist = ("cell.positioner.free=[joint_5, joint_6]", "cell.positioner.held_deg={joint_2: 60, joint_3: -40}")
    plan = solve_alone(load_problem("fibre_bowl", ("process.start.heat_wait_s=0", *wrist)), "sqp")
    promises_kept(plan)


@pytest.mark.slow
@pytest.mark.parametrize("name", FIBRES)
@pytest.mark.parametrize("program", [(), PUBLISHED, ("program.chord_mm=0.1", "program.tangent_deg=3")])
def test_lines_of_the_program_keep_chord_and_angle(name: str, program: tuple[str, ...]) -> None:
    plan = divided(name, *program)
    _, offs, leans = chords(plan)
    assert offs.max() <= plan.problem.program.chord
    assert leans.max() <= plan.problem.program.tangent + 1e-9
    assert compare(plan, read_rapid_files(rapid_files(plan))).differences() == []


@pytest.mark.slow
def test_no_length_hides_what_chord_and_angle_allow() -> None:
    """Where the curve is nearly straight, segments are longer than the usual cap, unless they are to be shorter."""
    free, usual, short = (
        chords(divided("fibre_plane", *PUBLISHED[:2], f"program.longest_mm={longest}", strategy=None))[0]
        for longest in (1000, 20, 6)
    )
    assert free.max() > 21e-3 and 20e-3 >= usual.max() > 15e-3
    assert short.max() <= 6e-3 and len(short) > 1.3 * len(free)
    tight = chords(divided("fibre_plane", *PUBLISHED, "program.tangent_deg=4", strategy=None))[2]
    assert np.degrees(tight).max() <= 4.0 and len(tight) > 1.5 * len(free)


@pytest.mark.slow
def test_a_looser_program_has_fewer_lines_and_a_tighter_one_more() -> None:
    count = {chord: len(segments(divided("fibre_plane", f"program.chord_mm={chord}"))[0]) for chord in (0.01, 0.1, 1)}
    assert count[0.01] > 2 * count[0.1]
    assert count[0.1] > 1.1 * count[1]
    tight = len(segments(divided("fibre_plane", "program.tangent_deg=1"))[0])
    assert tight > 1.5 * len(segments(divided("fibre_plane"))[0])


@pytest.mark.slow
def test_lines_are_shorter_where_the_curve_is_tighter() -> None:
    """On an arc of radius r a line that leaves it by e is as long as the root of 8 r e: it grows with the root of r."""
    plan = divided("fibre_plane", "program.chord_mm=0.02")
    sizes = chords(plan)[0]
    tip = plan.trajectory.tip
    radius = []
    for a, b in zip(*segments(plan), strict=True):
        p, q, r = tip[a], tip[(a + b) // 2], tip[b]
        area = float(np.linalg.norm(np.cross(q - p, r - p)))
        sides = np.linalg.norm(q - p) * np.linalg.norm(r - q) * np.linalg.norm(r - p)
        radius.append(sides / max(2.0 * area, 1e-15))
    order = np.argsort(radius)
    quarter = len(order) // 4
    tight, wide = order[:quarter], order[-quarter:]
    assert sizes[wide].mean() > 1.5 * sizes[tight].mean()


def cut_places(plan: Plan) -> Array:
    """Where (b, 3) the nozzle rests in each bead [m]."""
    t = plan.trajectory
    return t.tip[[samples_of_rest(t, event)[0] for event in cuts(t)]]


@pytest.mark.slow
def test_the_program_is_the_papers() -> None:
    """Figure 7 of Tawfik et al.: a line for each straight segment, and the cutter's between two waits of a second."""
    plan = divided("fibre_plane")
    files = rapid_files(plan)
    text = files["FibrePlane.mod"]
    cut = r"WaitTime 1\.000;\n +BwLine \d+,\"M106 P0 S1 G4 P500 M106 P0 S0 G4 P500\";\n +WaitTime 1\.000;\n +BwSettle 900;\n +WaitTime 1\.000;"
    assert len(re.findall(cut, text)) == len(plan.beads)
    program, laid = read_rapid_files(files), plan_moves(plan).laid
    assert not re.search(r"MoveC|TriggC", text) and set(re.findall(r",(z\d+|fine),", text)) == {"z0", "fine"}
    # each segment until the cut has a line of its own, sent before the robot sets out on it
    fed = [move for move, texts in program.sends.items() if any(each.startswith("G1 E") for each in texts)]
    before = sum(len(plan.beads[k].points) > 0 for k in range(len(plan.beads)))
    assert len(fed) >= np.count_nonzero(laid) // 2 + before
    assert '"M109 S280";\n        BwSettle 900;' in text


@pytest.mark.slow(cases=("output",))
@pytest.mark.parametrize("style", ["output", "socket"])
def test_the_output_falls_at_the_cut_and_stays_low_behind_it(style: str) -> None:
    plan = divided("fibre_plane", f"program.style={style}")
    files = LANGUAGES["rapid"].write(plan)
    assert LANGUAGES["rapid"].differences(plan, files) == []
    program = read_rapid_files(files)
    switched = [(move, each.value) for move, group in sorted(program.triggers.items()) for each in group]
    assert [value for _, value in switched] == [True, False] * len(plan.beads)
    off = [move for move, value in switched if not value]
    assert np.linalg.norm(program.position[off] - cut_places(plan), axis=1).max() < 2e-6
    assert program.fine[off].all() and program.wait[off] == pytest.approx(3.0)
    # one that goes on until the bead's end is found
    longer = files["FibrePlane.mod"].replace(",trgOff,", ",").replace("TriggL", "MoveL", 0)
    spoilt = re.sub(r"TriggL (\[\[[^\n]*\d,vel[^,]*),(fine,)", r"MoveL \1,\2", longer)
    assert LANGUAGES["rapid"].differences(plan, files | {"FibrePlane.mod": spoilt}) != []


@pytest.mark.slow
def test_no_line_feeds_behind_the_cut() -> None:
    plan = divided("fibre_plane")
    files = LANGUAGES["rapid"].write(plan)
    program, t = read_rapid_files(files), plan.trajectory
    texts = [text for move in sorted(program.sends) for text in program.sends[move]]
    prime, cut = "G1 E45.00000 F1500.000", "M106 P0 S1 G4 P500 M106 P0 S0 G4 P500"
    fed, behind, amounts = 0.0, False, []
    for text in texts:
        if text == prime:
            fed, behind = 0.0, False
        elif text == cut:
            amounts.append(fed)
            behind = True
        elif text.startswith("G1"):
            assert not behind, text
            fed += float(text.split(" ")[1][1:])
    assert amounts == pytest.approx([1e3 * bead.length - 45.0 for bead in plan.beads], abs=0.02 + 1e3 * 0.005 * t.dt)
    # a segment's line behind the cut, in place of one before it
    number = int(re.search(rf'BwLine (\d+),"{cut}"', files["FibrePlane.mod"])[1])
    last = re.search(rf'BwLine {number - 1},"(.*)"', files["FibrePlane.mod"])[1]
    spoilt = files["FibrePlane.mod"].replace(f'{number - 1},"{last}"', f'{number - 1},"{cut}"', 1)
    spoilt = spoilt.replace(f'{number},"{cut}"', f'{number},"{last}"', 1)
    assert LANGUAGES["rapid"].differences(plan, files | {"FibrePlane.mod": spoilt}) != []


@pytest.mark.parametrize("sync", ["signal", "free"])
@pytest.mark.parametrize("firmware", ["reprap", "marlin"])
def test_the_board_cuts_where_the_output_has_gone_off_and_feeds_nothing_more(firmware: str, sync: str) -> None:
    own = () if firmware == "reprap" else ("process.fibre.cut_code=[M106 P0 S1, G4 P500, M106 P0 S0, G4 P500]",)
    plan = divided("fibre_plane", f"program.board={{firmware: {firmware}, sync: {sync}}}", *own)
    text = gcode(plan)
    assert extruder.differences(plan, {extruder.FILE: text}) == []
    for piece in text.split("; prime, bead ")[1:]:
        before, behind = piece.split("; cut, bead ")
        assert "G1 E" in before and "G1" not in behind
        if sync == "signal":
            assert re.search(r"M(577|226) P1 S0\nG4 P\d+\n$", before), "it waits for the robot, and another second"
            assert int(before.split("G4 P")[-1]) == pytest.approx(1000, abs=5)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ("longest_mm=0", "too small"),
        ("largest_zone=z2", "z0, z1, z5"),
        ("chord_mm=0", "too small"),
        ("chord_mm=2", "0.005 to 1"),
        ("tangent_deg=60", "0.5 to 45"),
        ("chord=1", "chord_mm"),
    ],
)
def test_settings_of_the_program_are_checked(change: str, words: str) -> None:
    with pytest.raises(InputError, match="program") as caught:
        load_problem("fibre_plane", (f"program.{change}",))
    assert words in str(caught.value)


def test_a_board_that_takes_one_command_a_line_is_not_told_several() -> None:
    with pytest.raises(InputError, match=r"process\.fibre\.cut_code: marlin takes one command per line") as caught:
        load_problem("fibre_plane", ("program.board={firmware: marlin}",))
    assert "[M106 P0 S1, G4 P500, M106 P0 S0, G4 P500]" in str(caught.value)
