"""RAPID read back: a written program repeats its plan, and one that was tampered with is found."""

from __future__ import annotations

import re

import numpy as np
import pytest
from export_fixtures import (
    demand_plan,
    executed_beads,
    make_plan,
    written_with,
)
from hypothesis import given
from hypothesis import strategies as st
from rapid_moves import BOTH, moves_of

from planner.base.errors import InputError
from planner.export.fit import angle
from planner.export.grammar import Statement
from planner.export.rapid.modules import NUMBER, numbers
from planner.export.rapid.reader import read_rapid
from planner.export.rapid.writer import rapid, rapid_files
from planner.export.readback import compare
from planner.export.text import number
from planner.export.write import ProgramDiffers, write_robot_code

# ---- RAPID: what is read back -------------------------------------------------------------------------------------


@pytest.mark.parametrize("positioner", [True, False])
def test_program_repeats_the_plan(positioner):
    plan = make_plan(positioner)
    found = compare(plan, read_rapid(rapid(plan)))
    assert found.path < 0.05e-3 and found.travel < 0.3e-3 and found.event < 1e-6
    assert np.degrees(found.axis) < 0.101 and np.degrees(found.external) < 0.251 and np.degrees(found.roll) < 0.251
    assert found.late <= 8e-3
    assert found.conf == 0 and found.differences() == []


def test_program_repeats_a_plan_that_moves_both_axes_of_the_station():
    plan = make_plan(free=BOTH)
    assert plan.cell.joint_names[6:] == BOTH
    text = rapid(plan)
    assert "eax_a tilt, eax_b rotation." in text
    program = read_rapid(text)
    found = compare(plan, program)
    assert found.path < 0.05e-3 and np.degrees(found.external) < 0.251 and found.differences() == []
    # each axis moves for itself, and stands where the plan has it at the targets of the second bead's ends
    turned = np.ptp(program.external[:, :2], axis=0)
    assert turned[0] > 0.05 and turned[1] > 0.2
    np.testing.assert_allclose(program.start[6:8], plan.trajectory.q[0, 6:], atol=1e-6)
    np.testing.assert_allclose(program.external[-1, :2], plan.trajectory.q[-1, 6:], atol=1e-6)
    for column in (0, 1):
        spoilt = _tamper(text, ARC_EXTERNAL, _shifted(column, 0.6, 4), 3)
        assert any("external" in difference for difference in compare(plan, read_rapid(spoilt)).differences())


def test_executed_beads_lie_on_the_plan():
    plan = make_plan()
    t = plan.trajectory
    stretches = executed_beads(read_rapid(rapid(plan)), step=0.2e-3)
    assert len(stretches) == 2
    for k, (position, quat, external) in enumerate(stretches):
        rows = t.bead == k
        step = np.linalg.norm(np.diff(position, axis=0), axis=1)
        assert step.max() <= 0.2e-3 + 1e-12
        gaps = np.linalg.norm(position[:, None] - t.tip[None, rows], axis=2)
        near = np.argmin(gaps, axis=1)
        # between two samples (0.16 mm) a point may be half of that away along the path
        assert gaps.min(axis=1).max() < 0.12e-3
        assert np.degrees(angle(quat, t.quat[rows][near]).max()) < 0.5
        np.testing.assert_allclose(position[[0, -1]], t.tip[rows][[0, -1]], atol=1e-6)
        np.testing.assert_allclose(external[[0, -1], 1], t.q[rows][[0, -1], 6], atol=1e-6)


def _tamper(text, pattern, change, which):
    """The text with one match of a pattern replaced."""
    match = list(re.finditer(pattern, text))[which]
    return text[: match.start()] + change(match) + text[match.end() :]


def _shifted(column, amount, decimals):
    def change(match):
        values = match.group(1).split(",")
        values[column] = f"{float(values[column]) + amount:.{decimals}f}"
        return match.group(0).replace(match.group(1), ",".join(values))

    return change


def _leaning(angle):
    """The nozzle turned by an angle [rad] about its own x axis; quaternions are w x y z here."""

    def change(match):
        w, x, y, z = (float(value) for value in match.group(1).split(","))
        c, s = np.cos(0.5 * angle), np.sin(0.5 * angle)
        turned = (c * w - s * x, c * x + s * w, c * y + s * z, c * z - s * y)
        return match.group(0).replace(match.group(1), ",".join(f"{value:.7f}" for value in turned))

    return change


def _lines(plan):
    """The same plan in a program without arcs."""
    return written_with(plan, arcs=False)


LINE_TARGET = r"MoveL \[\[([^\]]*)\]"
LINE_QUAT = r"MoveL \[\[[^\]]*\],\[([^\]]*)\]"
LINE_CONF = r"MoveL \[\[[^\]]*\],\[[^\]]*\],\[([^\]]*)\]"
LINE_EXTERNAL = r"MoveL \[\[[^\]]*\],\[[^\]]*\],\[[^\]]*\],\[([^\]]*)\]"
JOINT_TARGET = r"MoveJ \[\[([^\]]*)\]"
_ARC = r"(?:Move|Trigg)C \[\["
ARC_VIA = rf"{_ARC}([^\]]*)\]"
ARC_TARGET = rf"{_ARC}[^ ]*?\]\],\[\[([^\]]*)\]"
ARC_QUAT = rf"{_ARC}[^ ]*?\]\],\[\[[^\]]*\],\[([^\]]*)\]"
ARC_CONF = rf"{_ARC}[^ ]*?\]\],\[\[[^\]]*\],\[[^\]]*\],\[([^\]]*)\]"
ARC_EXTERNAL = rf"{_ARC}[^ ]*?\]\],\[\[[^\]]*\],\[[^\]]*\],\[[^\]]*\],\[([^\]]*)\]"
ARCS, LINES = range(8), range(22)  # of the plan's program, and of the one without arcs


def _differences(plan, pattern, change, which):
    return compare(plan, read_rapid(_tamper(rapid(plan), pattern, change, which))).differences()


def test_the_programs_that_are_tampered_with_have_arcs_and_lines():
    assert len(re.findall(ARC_VIA, rapid(make_plan()))) == len(re.findall(ARC_TARGET, rapid(make_plan()))) == len(ARCS)
    assert len(re.findall(LINE_TARGET, rapid(_lines(make_plan())))) == len(LINES)
    assert re.search(ARC_VIA, rapid(_lines(make_plan()))) is None


@pytest.mark.parametrize("which", LINES[::2])
def test_any_target_moved_by_a_fifth_of_a_millimetre_is_found(which):
    """Into or out of the cylinder, which the first axis does where these beads lie."""
    plan = _lines(make_plan())
    found = compare(plan, read_rapid(_tamper(rapid(plan), LINE_TARGET, _shifted(0, 0.2, 3), which)))
    assert found.path > 0.15e-3 and any(difference.startswith("path") for difference in found.differences())


@pytest.mark.slow(keep=8)
@pytest.mark.parametrize("which", ARCS)
@pytest.mark.parametrize("pattern", [ARC_VIA, ARC_TARGET], ids=["via", "target"])
@pytest.mark.parametrize("amount", [0.2, -0.2])
def test_any_point_of_an_arc_moved_by_a_fifth_of_a_millimetre_is_found(which, pattern, amount):
    plan = make_plan()
    found = compare(plan, read_rapid(_tamper(rapid(plan), pattern, _shifted(0, amount, 3), which)))
    assert found.path > 0.15e-3 and any(difference.startswith("path") for difference in found.differences())


@pytest.mark.parametrize("which", ARCS)
def test_a_line_in_place_of_an_arc_is_found(which):
    """Where the arc stands over its chord by more than moves may be widened to, and rounding."""
    plan = make_plan()
    text = rapid(plan)
    moves = moves_of(text)
    at = [k for k, move in enumerate(moves) if move.via is not None][which]
    begin, arc = moves[at - 1].position, moves[at]
    over = 1e-3 * np.linalg.norm(arc.via.position - 0.5 * (begin + arc.position))  # via points stand over the middle

    def straightened(match):
        return match[0].replace("C [[", "L [[").replace(match[1], "")

    pattern = rf"{_ARC[:-4]}(\[\[[^ ]*?\]\],)(?=\[\[).*\n"
    found = compare(plan, read_rapid(_tamper(text, pattern, straightened, which)))
    assert found.path == pytest.approx(over, abs=0.05e-3)
    assert any(difference.startswith("path") for difference in found.differences()) == (over > 0.13e-3)
    assert over > (0.07e-3 if which % 4 == 2 else 0.13e-3)


@pytest.mark.parametrize("which", [2, 3, 8, 14])
@pytest.mark.parametrize("way", [{}, {"arcs": False}], ids=["with arcs", "without"])
def test_an_arc_in_place_of_a_line_is_found(which, way):
    """Through a point 0.2 mm beside the line's middle; through that itself it is the line."""
    plan = written_with(make_plan(), **way)
    text = rapid(plan)
    lines = list(re.finditer(r"MoveL (\[\[[^ ]*?\]\])(?=,)(?!.*fine)", text))
    own = lines[which % len(lines)]
    places = [move.position for move in moves_of(text)]
    k = next(k for k, place in enumerate(places) if own[1].startswith("[[{:.3f},{:.3f},{:.3f}]".format(*place)))
    for aside, right in ((0.0, True), (0.2, False)):
        x, y, z = 0.5 * (places[k - 1] + places[k]) + [aside, 0.0, 0.0]
        via = re.sub(r"\[\[[^\]]*\]", f"[[{x:.4f},{y:.4f},{z:.4f}]", own[1], count=1)
        spoilt = text[: own.start()] + f"MoveC {via},{own[1]}" + text[own.end() :]
        found = compare(plan, read_rapid(spoilt)).differences()
        assert (found == []) == right and all(difference.startswith("path") for difference in found)


@pytest.mark.slow(keep=4)
@pytest.mark.parametrize(
    ("pattern", "change", "which", "named"),
    [
        (JOINT_TARGET, _shifted(2, 0.2, 3), 12, "path"),
        (ARC_QUAT, _leaning(0.01), 2, "axis"),
        (ARC_CONF, _shifted(3, 2, 0), 2, "conf"),
        (ARC_CONF, _shifted(1, 1, 0), 2, "conf"),
        (ARC_EXTERNAL, _shifted(1, 0.6, 4), 2, "external"),
        (ARC_EXTERNAL, _shifted(0, 0.6, 4), 2, "external"),
        (r"tooldata tPen:=\[TRUE,\[\[([^\]]*)\]", _shifted(2, 0.1, 3), 0, "frames"),
        (r"\"STN1\",\[\[[^\]]*\],\[[^\]]*\]\],\[\[([^\]]*)\]", _shifted(0, 0.1, 3), 0, "frames"),
        (r"MoveAbsJ \[\[([^\]]*)\]", _shifted(0, 0.1, 3), 0, "frames"),
        (r"trgOn,(0)\\DOp", lambda m: "trgOn,2\\DOp", 0, "event"),
        (r"(vel42_2:=\[)42\.2,", lambda m: f"{m[1]}46.4,", 0, "late"),
        (r",vel19_5,z1", lambda m: ",vel41_7,z1", 0, "late"),
        (r",vel41_7,z1", lambda m: ",vel19_5,z1", 0, "late"),
        (r",trgOff,z1", lambda m: ",trgOn,z1", 0, "path"),
        (r",trgOn,z5((?s:.*?)),trgOff,z1", lambda m: f",trgOff,z5{m[1]},trgOn,z1", 0, "path"),
        (r" *MoveC .*\n", lambda m: "", 1, "path"),
        (
            r" *TriggL .*trgOn.*\n",
            lambda m: m[0].replace("TriggL [[-", "MoveL [[-1").replace(",trgOn", "") + m[0],
            0,
            "path",
        ),
    ],
)
def test_a_program_that_says_something_else_is_found(pattern, change, which, named):
    found = _differences(make_plan(), pattern, change, which)
    assert any(difference.startswith(named) for difference in found), found


@pytest.mark.parametrize(
    ("pattern", "change", "which", "named"),
    [
        (LINE_QUAT, _leaning(0.01), 12, "axis"),
        (LINE_CONF, _shifted(3, 2, 0), 12, "conf"),
        (LINE_CONF, _shifted(1, 1, 0), 12, "conf"),
        (LINE_EXTERNAL, _shifted(1, 0.6, 4), 12, "external"),
        (LINE_EXTERNAL, _shifted(0, 0.6, 4), 12, "external"),
        (r" *MoveL .*\n", lambda m: "", 2, "path"),
        (r"(speeddata vel4\w+:=\[4)(\d)", lambda m: f"{m[1]}{(int(m[2]) + 5) % 10}", 0, "late"),
    ],
)
def test_a_program_of_lines_that_says_something_else_is_found(pattern, change, which, named):
    found = _differences(_lines(make_plan()), pattern, change, which)
    assert any(difference.startswith(named) for difference in found), found


def test_a_wrong_program_is_not_written(tmp_path, monkeypatch):
    wrong = _tamper(rapid(make_plan()), ARC_VIA, _shifted(0, 0.2, 3), 2)
    monkeypatch.setattr(
        "planner.export.rapid.language.write", lambda plan: {**rapid_files(plan), "TwoBeads.mod": wrong}
    )
    with pytest.raises(ProgramDiffers, match="path differs"):
        write_robot_code(make_plan(), tmp_path)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow(keep=9)
@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("SingArea\\Off;", "SingArea\\Wrist;", "unknown statement"),
        ("ConfL\\Off;", "StopMove\\Quick;", "unknown statement"),
        ("ConfL\\Off;", "StopMove;", "unknown name"),
        (",vel41_7,", ",vel41x,", "unknown name"),
        ("Bead0002;", "Bead0009;", "unknown name"),
        ("[0.0000,0.0000,9E9", "[0.0000,9E9", "lengths"),
        ("-185.811", "-185.8.11", "not a number"),
        ("PROC Finish()", "PROC Start()", "twice"),
        ("TriggL ", "MoveL ", "only TriggL and TriggC have triggers"),
        ("TriggC ", "MoveC ", "only TriggL and TriggC have triggers"),
        ("MoveC ", "TriggC ", "only TriggL and TriggC have triggers"),
        ("MoveC ", "MoveL ", "only MoveC and TriggC have a via point"),
        ("MoveL ", "MoveC ", "only MoveC and TriggC have a via point"),
        ("    ENDPROC\n\n    PROC Start", "\n    PROC Start", "inside a procedure"),
        ('FALSE,"STN1"', 'FALSE,""', "must name a station"),
        ("ENDMODULE", "", "no complete module"),
        ("ENDMODULE\n", "ENDMODULE\nMODULE B\n", "outside"),
        ("        ConfL\\Off;\n", "", r"before all moves.*: ConfL\\Off"),
        ("        CirPathMode\\ObjectFrame;\n", "", r"before all moves.*: CirPathMode\\ObjectFrame"),
        ("CirPathMode\\ObjectFrame;", "CirPathMode\\PathFrame;", "unknown statement"),
        ("        ActUnit STN1;\n", "", "before all moves.*: ActUnit STN1"),
        ("        SetDO doExtrude,0;\n", "", "before all moves.*: doExtrude 0"),
        ("SetDO doExtrude,0;", "SetDO doExtrude,1;", "before all moves.*: doExtrude 0, doExtrude 1"),
        ("        SetDO doExtrude,0;\n        DeactUnit", "        DeactUnit", "after all moves.*: doExtrude 0"),
        ("        ! Bead 0", "        SetDO doExtrude,1;\n        ! Bead 0", "only main"),
        ("        Finish;\n", "        SetDO doExtrude,0;\n        Finish;\n", "after the end"),
        ("        Start;\n", "        SetDO doExtrude,0;\n        Start;\n", "between the start"),
    ],
)
def test_reader_refuses_what_it_does_not_know(old, new, message):
    text = rapid(make_plan())
    assert old in text
    line = text[: text.index(old)].count("\n") + 1
    with pytest.raises(InputError, match=message) as error:
        read_rapid(text.replace(old, new, 1))
    if "unknown" in message and "Bead" not in old:
        assert error.value.line == line


@pytest.mark.parametrize("target", [0, 1], ids=["on the way", "at the end"])
def test_reader_refuses_an_orientation_that_is_none(target):
    """A controller stops at a quaternion whose length is not 1, be it of a point on an arc's way, whose own nobody follows."""
    lines = rapid(make_plan()).splitlines()
    at = next(k for k, line in enumerate(lines) if "MoveC [[" in line)
    orientation = list(re.finditer(r"\],\[(-?\d\.\d{7}),", lines[at]))[target]
    more = f"{float(orientation[1]) + 0.01:.7f}"
    lines[at] = f"{lines[at][: orientation.start(1)]}{more}{lines[at][orientation.end(1) :]}"
    with pytest.raises(InputError, match="an orientation whose quaternion has length") as error:
        read_rapid("\n".join(lines) + "\n")
    assert error.value.line == at + 1


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("    CONST zonedata zon0_1:=[FALSE,0.1,0.1,0.1,0.01,0.1,0.01];\n", "", "unknown name 'zon0_1'"),
        (
            "zonedata zon0_1:=[FALSE,0.1,",
            "zonedata zon0_1:=[FALSE,5.0,",
            "zone zon0_1 is not one that these programs have",
        ),
        ("zonedata zon0_1:=", "zonedata zon0_2:=", "zone zon0_2 is not one that these programs have"),
        (",zon0_1,tPen", ",zon0_2,tPen", "unknown statement"),
    ],
)
def test_reader_refuses_zones_that_it_does_not_know(old, new, message):
    text = rapid(demand_plan())
    assert old in text
    with pytest.raises(InputError, match=message):
        read_rapid(text.replace(old, new, 1))


SOMEWHERE = Statement("move", (), "", "RAPID", 1)


@given(st.floats(-1e5, 1e5), st.integers(1, 7))
def test_numbers_survive_writing_and_reading(value, decimals):
    text = number(value, decimals)
    assert re.fullmatch(NUMBER, text)
    (read,) = numbers(f"[{text}]", "[1]", SOMEWHERE)
    assert abs(read - value) <= 0.5000001 * 10.0**-decimals + 1e-11
    assert not text.startswith("-") or read < 0.0


@given(st.text(alphabet="0123456789.-+eE_naif ", max_size=8))
def test_only_plain_numbers_are_read(text):
    plain = re.fullmatch(r"-?\d+(\.\d+)?(E\d+)?", text, re.ASCII) is not None
    try:
        numbers(f"[{text}]", "[1]", SOMEWHERE)
    except InputError:
        assert not plain
    else:
        assert plain
