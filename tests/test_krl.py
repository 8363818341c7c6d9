"""KRL: golden files, a reading with nothing of ours, and programs that were tampered with."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest
from export_fixtures import GOLDEN, golden_texts, make_plan, resting_in_a_bead
from scipy.spatial.transform import Rotation
from solved import small_plan

from planner.base.arrays import Array
from planner.base.errors import InputError
from planner.export import krl
from planner.export.krl import (
    angles,
    branch_of,
    differences,
    from_kuka,
    krl_name,
    quaternions,
    read_krl,
    status,
    to_kuka,
    turn,
    write,
)
from planner.export.languages import LANGUAGES
from planner.export.support import unsupported_in_krl
from planner.plan import Plan

TURNED = np.radians(0.1)  # of a target beside its nearest sample
SOURCE, DATA = "TwoBeads.src", "TwoBeads.dat"
MOVE = re.compile(r"^  (LIN |PTP |CIRC \{.*?\},)\{(E6POS|E6AXIS): (.*?)\}( C_DIS| C_PTP)?$", re.MULTILINE)
# ROS-Industrial's URDF of the KR 6 R900 sixx, which counts axes as the controller does: place in the link before, axis
LINKS = (
    ((0, 0, 0.4), (0, 0, -1)),
    ((0.025, 0, 0), (0, 1, 0)),
    ((0.455, 0, 0), (0, 1, 0)),
    ((0, 0, 0.035), (-1, 0, 0)),
    ((0.42, 0, 0), (0, 1, 0)),
    ((0.08, 0, 0), (-1, 0, 0)),
)


@cache
def wave(**changes: object) -> Plan:
    """Beads round a cylinder by a KR 6 R900, which the station turns."""
    return make_plan(**{"arm": "kr6_r900", **changes})  # type: ignore[arg-type]


def controller(axes: Array) -> Array:
    """$FLANGE in $ROBROOT of A1 to A6 [rad]."""
    T = np.eye(4)
    for (origin, axis), value in zip(LINKS, axes, strict=True):
        step = np.eye(4)
        step[:3, 3] = origin
        step[:3, :3] = Rotation.from_rotvec(np.array(axis) * value).as_matrix()
        T = T @ step
    T[:3, :3] = T[:3, :3] @ Rotation.from_euler("y", 90, degrees=True).as_matrix()
    return T


def values_of(text: str) -> dict[str, float]:
    return {name: float(value) for name, value in (item.strip().split(" ") for item in text.split(","))}


def frame(values: dict[str, float]) -> Array:
    T = np.eye(4)
    T[:3, 3] = [values[name] * 1e-3 for name in "XYZ"]
    T[:3, :3] = Rotation.from_euler("ZYX", [values[name] for name in "ABC"], degrees=True).as_matrix()
    return T


def moves_of(text: str) -> list[SimpleNamespace]:
    return [
        SimpleNamespace(word=word[:4].strip(), kind=kind, values=values_of(values), fly=bool(fly))
        for word, kind, values, fly in MOVE.findall(text)
    ]


# ---- how KUKA counts ----------------------------------------------------------------------------------------------


def test_axes_are_kukas() -> None:
    """The same posture, as KUKA's own axes have it and as our closed form has it: one flange."""
    plan = wave()
    q = np.random.default_rng(4).uniform(-2.0, 2.0, (50, 6))
    np.testing.assert_allclose(from_kuka(to_kuka(q)), q, atol=1e-12)
    for own, T in zip(q, plan.cell.wrist.poses(q), strict=True):
        np.testing.assert_allclose(controller(to_kuka(own[None])[0]), T, atol=1e-9)


def test_status_of_postures_that_manuals_show() -> None:
    """KUKA's home has S 2, T 2; a wrist bent the other way adds 4; reaching over backwards, basic becomes overhead."""
    plan = wave()

    def state(*degrees: float) -> tuple[int, int]:
        q = from_kuka(np.radians([degrees]))
        branch = plan.cell.wrist.branches(q).astype(np.intp)
        return int(status(branch)[0]), int(turn(q)[0])

    assert state(0, -90, 90, 0, 0, 0) == (2, 2)
    assert state(0, -90, 90, 0, 30, 0) == (2, 2)
    assert state(0, -90, 90, 0, -30, 0) == (6, 18)
    assert state(-10, -90, 90, -20, 30, -40) == (2, 43)
    assert state(0, -180, 45, 0, 30, 0) == (3, 2)
    assert state(0, -30, -90, 0, 30, 0) == (0, 6)
    # where the wrist's centre lies on the line through axes 2 and 3, which the offset of 35 mm turns
    stretched = -np.degrees(np.arctan2(-35, 420))
    assert state(0, -60, stretched + 0.1, 0, 30, 0)[0] == 2 and state(0, -60, stretched - 0.1, 0, 30, 0)[0] == 0
    assert branch_of(status(np.arange(8))).tolist() == list(range(8))


def test_angles_against_scipy() -> None:
    random = Rotation.random(300, rng=np.random.default_rng(3))
    upright = Rotation.from_euler("ZYX", [[30, 90, 0], [-120, -90, 0], [5, 90, 40]], degrees=True)
    for rotations in (random, upright):
        abc = angles(rotations.as_matrix())
        assert (Rotation.from_euler("ZYX", abc).inv() * rotations).magnitude().max() < 1e-7
        assert (Rotation.from_quat(quaternions(abc)).inv() * rotations).magnitude().max() < 1e-7
    np.testing.assert_allclose(angles(random.as_matrix()), random.as_euler("ZYX"), atol=1e-9)


@pytest.mark.parametrize("last_bit", [-1e-17, 1e-17])
def test_half_a_turn_is_written_one_way(last_bit: float) -> None:
    T = np.diag([1.0, -1.0, -1.0, 1.0])
    T[2, 1] = T[1, 2] = last_bit
    assert krl.frame(T).endswith(",A 0.000000,B 0.000000,C 180.000000")


def test_names() -> None:
    assert krl_name("cylinder_logo") == "CylinderLogo"
    assert krl_name("loop") == "PrintLoop"
    assert krl_name("bas") == "PrintBas"  # a program of KUKA's own, which every program calls
    assert krl_name("x_start") == "PrintXStart"
    assert krl_name("axis") == "PrintAxis"
    assert krl_name("a_very_long_name_of_a_problem") == "AVeryLongNameOfAProblem"
    assert krl_name("a_very_long_name_of_a_problem_from_12") == "AVeryLongNameOfAPrFrom12"
    assert len(krl_name("a_very_long_name_" * 5)) == 24


# ---- what is written ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", [SOURCE, DATA])
def test_golden_file(name: str) -> None:
    assert golden_texts()[name] == (GOLDEN / name).read_text(encoding="utf-8")


@pytest.mark.parametrize("positioner", [True, False])
def test_targets_are_where_the_plan_has_the_nozzle(positioner: bool) -> None:
    """KUKA's axes, FTOOL and FPART alone put each target where the plan's joints have it."""
    plan = wave(positioner=positioner)
    files, cell = write(plan), plan.cell
    tool, part = (frame(values_of(re.search(rf"{name}=\{{(.*?)\}}", files[DATA])[1])) for name in ("FTOOL", "FPART"))  # type: ignore[index]
    q, samples = plan.trajectory.q, len(plan.trajectory)
    on = np.tile(np.eye(4), (samples, 1, 1))
    if positioner:
        assert "$BASE=EK(MACHINE_DEF[2].ROOT,MACHINE_DEF[2].MECH_TYPE,FPART)" in files[SOURCE]
        on[:, :3, :3] = Rotation.from_rotvec(q[:, 6:] * [0, 0, 1]).as_matrix()
        on[:, :3, 3] = plan.problem.cell.positioner.origin  # type: ignore[union-attr]
    else:
        assert "  $BASE=FPART\n" in files[SOURCE]
    world = cell.T_world_base @ np.array([controller(row) for row in to_kuka(q[:, :6])]) @ tool
    planned = np.linalg.inv(on @ part) @ world
    lines = 0
    for move in moves_of(files[SOURCE]):
        external = [move.values.get(f"E{i}") for i in (1, 2, 3)]
        assert external == ([0.0, external[1], None] if positioner else [None] * 3)
        if move.word == "PTP":
            axes = np.radians([move.values[f"A{i}"] for i in range(1, 7)])
            assert np.abs(to_kuka(q[:, :6]) - axes).max(axis=1).min() < 1e-6
            continue
        T = frame(move.values)
        k = int(np.argmin(np.linalg.norm(planned[:, :3, 3] - T[:3, 3], axis=1)))
        assert np.linalg.norm(planned[k, :3, 3] - T[:3, 3]) < plan.problem.program.chord
        assert Rotation.from_matrix(planned[k, :3, :3].T @ T[:3, :3]).magnitude() < TURNED
        if positioner:
            assert np.radians(external[1]) == pytest.approx(q[k, 6], abs=TURNED)
        lines += 1
    assert lines > 10


def test_outputs_are_switched_on_the_path() -> None:
    lines = write(wave())[SOURCE].split("\n")
    at = [i for i, line in enumerate(lines) if "TRIGGER" in line]
    assert [lines[i] for i in at] == [
        f"  TRIGGER WHEN PATH=0 DELAY=0 DO $OUT[1]={value}" for value in ("TRUE", "FALSE")
    ] * 2
    assert all(lines[i + 1].startswith(("  LIN", "  CIRC")) and lines[i + 1].endswith("C_DIS") for i in at)
    assert next(i for i, line in enumerate(lines) if line == "  $OUT[1]=FALSE") < at[0]


def test_without_run_in_the_extruder_goes_on_at_the_start_of_the_bead() -> None:
    plan = wave()
    spec = SimpleNamespace(**vars(plan.problem))
    spec.process = plan.problem.process.model_copy(update={"run_in": 0.0})
    plan = replace(plan, problem=spec)  # type: ignore[arg-type]
    files = write(plan)
    assert files[SOURCE].count("TRIGGER WHEN DISTANCE=0 DELAY=0 DO $OUT[1]=TRUE") == 2
    assert differences(plan, files) == []


def test_materials_have_outputs_one_after_the_other() -> None:
    plan = wave(materials=("pla", "pva"))
    files = write(plan)
    assert re.findall(r"DO \$OUT\[(\d)\]=(\w+)", files[SOURCE]) == [
        *(("1", "TRUE"), ("1", "FALSE"), ("2", "TRUE"), ("2", "FALSE"))
    ]
    assert files[SOURCE].count("WAIT SEC 2.0") == 1  # for the change
    assert differences(plan, files) == []


@pytest.mark.parametrize(
    "changes",
    [{}, {"positioner": False}, {"free": ("tilt", "rotation")}, {"beads": 3, "dip": False}, {"arm": "irb140"}],
    ids=str,
)
def test_the_program_repeats_the_plan(changes: dict[str, object]) -> None:
    plan = wave(**changes)
    assert differences(plan, write(plan)) == []


def test_a_solved_print() -> None:
    """Of an arm that another maker's controller moves: its axes are of the same kind."""
    plan = small_plan()
    assert differences(plan, write(plan)) == []


def test_lines_that_the_arm_cannot_keep_up_with_are_found() -> None:
    """The program is played, not only compared: joints that turn slowly take longer than the plan has it."""
    plan = wave()
    limits = replace(plan.cell.limits, velocity=0.03 * plan.cell.limits.velocity)
    slow = replace(plan, cell=replace(plan.cell, limits=limits))
    found = differences(slow, write(plan))
    assert len(found) == 1 and found[0].startswith("time of deposition is "), found


def test_rests_in_a_bead_are_kept() -> None:
    resting = resting_in_a_bead(wave(dip=False))
    files = write(resting)
    assert re.search(r"DO \$OUT\[1\]=FALSE\n  (LIN|CIRC) \{.*\}\n  ; cut, bead 0\n  WAIT SEC 0.500", files[SOURCE])
    assert differences(resting, files) == []


def test_lines_and_names_are_within_what_a_controller_takes() -> None:
    for text in write(replace(wave(), strategy="ladder ü" + "x" * 300)).values():
        assert text.isascii() and all(len(line) <= 200 for line in text.split("\n"))
        names = re.findall(r"(?:DEF|DEFDAT) (\w+)", text)
        assert all(len(name) <= 24 for name in names) and len({name.upper() for name in names}) == len(names)


def test_a_longer_program_is_files_that_call_each_other(monkeypatch: pytest.MonkeyPatch) -> None:
    """Local programs and bytes of each file stay within what is stated, a bead goes on in the next program."""
    monkeypatch.setattr(krl, "LOCAL_PROGRAMS", 2)
    monkeypatch.setattr(krl, "SUBPROGRAM", 12)
    monkeypatch.setattr(krl, "FILE_SIZE", 4_000)
    plan = wave()
    files = write(plan)
    assert list(files)[:2] == [SOURCE, DATA] and len(files) > 4
    assert re.findall(r"^  (TwoBeads_\d)\(\)$", files[SOURCE], re.MULTILINE) == [name[:-4] for name in list(files)[2:]]
    assert files[SOURCE].count("DEF ") == 1 and "  ; Calls" in files[SOURCE]
    for name in list(files)[2:]:
        title, *local = re.findall(r"^DEF (\w+)\(\)$", files[name], re.MULTILINE)
        assert title == name[:-4] and len(local) <= 2
        assert re.findall(r"^  (\w+)\(\)$", files[name], re.MULTILINE) == local
        assert len(files[name]) < 4_000 + 1_000
    assert "DEF Bead0001_2()\n  ; continued Bead 0" in files["TwoBeads_1.src"]
    assert differences(plan, files) == []
    second = files["TwoBeads_2.src"]
    assert differences(plan, files | {"TwoBeads_2.src": re.sub(r"X (-?\d+)\.", r"X \g<1>9.", second, count=1)}) != []
    with pytest.raises(InputError, match="TwoBeads_3 is not a program"):
        differences(plan, {name: text for name, text in files.items() if name != "TwoBeads_3.src"})
    with pytest.raises(InputError, match="can be called here"):  # which is local to another file
        differences(plan, files | {SOURCE: files[SOURCE].replace("  TwoBeads_1()", "  Bead0001()")})
    with pytest.raises(InputError, match="is defined in two files"):
        differences(plan, files | {"Other.src": second.replace("TwoBeads_2", "Other")})


@pytest.mark.slow
def test_programs_that_a_pendant_can_edit() -> None:
    """A print of as many beads as the ten-layer logo has."""
    plan = make_plan(arm="kr6_r900", beads=402, length=0.002, dip=False)
    files = {name: text for name, text in write(plan).items() if name.endswith(".src")}
    assert len(files) > 2
    for text in files.values():
        assert text.count("\nDEF ") - 1 <= 255 and len(text) <= krl.FILE_SIZE + 30_000


# ---- what cannot be said ------------------------------------------------------------------------------------------


def test_what_cannot_be_said() -> None:
    plan = wave()
    offset = SimpleNamespace(problem=plan.problem, cell=make_plan(positioner=False, arm="ur5e").cell)
    assert "spherical wrist, which Universal Robots UR5e does not have" in str(unsupported_in_krl(offset))
    arm = replace(plan.cell, holder_robot=plan.cell.arm_robot)
    assert "held by an arm" in str(unsupported_in_krl(SimpleNamespace(problem=plan.problem, cell=arm)))
    with pytest.raises(ValueError, match="held by an arm"):
        LANGUAGES["krl"].write(replace(plan, cell=arm))


# ---- what is read back --------------------------------------------------------------------------------------------

LINE, POINT = r"(?:LIN |\},)\{E6POS: (.*?)\}", r"PTP \{E6AXIS: (.*?)\}"


def shifted(name: str, amount: float, decimals: int = 4) -> Callable[[re.Match[str]], str]:
    def change(match: re.Match[str]) -> str:
        return re.sub(
            rf"\b{name} (-?[\d.]+)", lambda value: f"{name} {float(value[1]) + amount:.{decimals}f}", match[0], count=1
        )

    return change


def said(old: str, new: str) -> Callable[[re.Match[str]], str]:
    return lambda match: match[0].replace(old, new)


def tampered(pattern: str, change: Callable[[re.Match[str]], str], which: int, name: str = SOURCE) -> list[str]:
    files = write(wave())
    matches = list(re.finditer(pattern, files[name]))
    match = matches[which % len(matches)]
    changed = files[name][: match.start()] + change(match) + files[name][match.end() :]
    assert changed != files[name]
    return differences(wave(), files | {name: changed})


@pytest.mark.slow(keep=5)
@pytest.mark.parametrize("which", range(0, 42, 3))
def test_any_target_moved_by_a_fifth_of_a_millimetre_is_found(which: int) -> None:
    assert any("path" in difference for difference in tampered(LINE, shifted("X", 0.2), which))


@pytest.mark.slow(keep=("1-0", "3-44", "6-77"))
@pytest.mark.parametrize("which", range(0, 80, 11))
@pytest.mark.parametrize("axis", range(1, 7))
def test_any_axis_of_travel_that_was_moved_is_found(which: int, axis: int) -> None:
    assert any("axes differ" in difference for difference in tampered(POINT, shifted(f"A{axis}", 0.01), which))


@pytest.mark.slow(keep=6)
@pytest.mark.parametrize(
    ("pattern", "change", "which", "name", "named"),
    [
        (LINE, shifted("B", 0.6), 12, SOURCE, "differs"),
        (LINE, shifted("E2", 0.9), 12, SOURCE, "external"),
        (LINE, shifted("E1", 0.9), 12, SOURCE, "held"),
        (LINE, shifted("S", -2, 0), 12, SOURCE, "conf"),
        (LINE, shifted("T", -1, 0), 12, SOURCE, "Turn"),
        (POINT, shifted("A6", 360.0), 12, SOURCE, "axes"),
        (POINT, shifted("E2", 0.9), 12, SOURCE, "external"),
        (r"\$VEL\.CP=([\d.]+)", lambda m: "$VEL.CP=0.0600", 3, SOURCE, "speed"),
        (r"\$VEL\.CP=([\d.]+)", lambda m: "$VEL.CP=0.0600", 0, SOURCE, "speeds of lines"),
        (r"\$APO\.CDIS=([\d.]+)", lambda m: "$APO.CDIS=9.000", 1, SOURCE, "middle of a line"),
        (r"LIN .* C_DIS", said(" C_DIS", ""), 12, SOURCE, "stops"),
        (r"PTP .* C_PTP", said(" C_PTP", ""), 12, SOURCE, "stops elsewhere"),
        (r"VEL_PTP,\d+", lambda m: "VEL_PTP,100", 1, SOURCE, "speeds of axes"),
        (r"<460.0 THEN\n    \$VEL.ORI1=\S+\n  ELSE\n    \$VEL.ORI1=460.0", said("460.0", "10.0"), 0, SOURCE, "VEL.ORI1"),
        (r"\$ADVANCE=3", lambda m: "$ADVANCE=0", 0, SOURCE, "ADVANCE"),
        (r"  \$IPO_MODE=#BASE\n", lambda m: "", 0, SOURCE, "IPO_MODE"),
        (r"  TRIGGER .*TRUE", said("TRUE", "FALSE"), 0, SOURCE, "path"),
        (r"  TRIGGER .*TRUE", said("[1]", "[2]"), 0, SOURCE, "output"),
        (r"  TRIGGER .*TRUE", said("PATH", "DISTANCE"), 0, SOURCE, "event"),
        (r"  TRIGGER .*FALSE\n", lambda m: "", 0, SOURCE, "path"),
        (r" *LIN .*\n", lambda m: "", 5, SOURCE, "not of the planned kinds"),
        (r"CIRC \{E6POS: (.*?)\}", shifted("X", 0.5), 2, SOURCE, "path"),
        (r"CIRC \{E6POS: (.*?)\}", shifted("A", 0.1), 2, SOURCE, "via points of arcs"),
        (r"CIRC \{E6POS: (.*?)\}", shifted("E1", 0.01), 2, SOURCE, "external axes at via points of arcs"),
        (r"CIRC \{E6POS: (.*?)\}", shifted("E2", 0.01), 2, SOURCE, "external axes at via points of arcs"),
        (r"(CIRC \{E6POS: .*?),E2 [-\d.]+\}", lambda m: m[1] + "}", 2, SOURCE, "external axes at via points of arcs"),
        (r"CIRC \{E6POS: .*?\},", lambda m: "LIN ", 2, SOURCE, "not of the planned kinds"),
        (r"  \$CIRC_TYPE=#BASE\n", lambda m: "", 0, SOURCE, "CIRC_TYPE"),
        (r"  Bead0002\(\)\n", lambda m: "", 0, SOURCE, "path"),
        (r"FTOOL=.*", shifted("Z", 0.1), 0, DATA, "frames"),
        (r"FPART=.*", shifted("X", 0.1), 0, DATA, "frames"),
        (r"FPART=.*", shifted("B", 0.5), 0, DATA, "axis"),
        (r"XSTART=.*", shifted("A3", 0.1), 0, DATA, "frames"),
    ],
)  # fmt: skip
def test_a_program_that_says_something_else_is_found(
    pattern: str, change: Callable[[re.Match[str]], str], which: int, name: str, named: str
) -> None:
    found = tampered(pattern, change, which, name)
    assert any(named in difference for difference in found), found


@pytest.mark.slow(keep=4)
@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("  LIN {", "  SLIN {", "unknown statement"),
        ("E6POS: X ", "E6POS: X nan", "unknown statement"),
        ("  $OUT[1]=FALSE", "  $OUT[1]=TRUE", "unknown statement"),
        ("  LIN {", "  $OUT[1]=FALSE\n  LIN {", "beside the path"),
        ("  PTP XSTART\n", "", "must begin with PTP XSTART"),
        ("  PTP XSTART\n", "  PTP XSTART\n  PTP XSTART\n", "go there once"),
        ("  Bead0002()\n", "  Bead0009()\n", "Bead0009 is not a program"),
        ("DEF Bead0002", "DEF BEAD0001", "twice"),
        ("DEF TwoBeads()", "DEF OtherBeads()", "no complete program TwoBeads"),
        ("\nEND\n\nDEF Bead0002", "\n\nDEF Bead0002", "inside a program"),
        (",E1 0.0000,E2", ",E2 0.0000,E1", "must be in order"),
        ("  $VEL.CP=", "  $VEL.ORI3=", "without a speed"),
        ("  $TOOL=FTOOL\n", "", "are not set to"),
        ("  $BASE=EK(MACHINE_DEF[2].ROOT", "  $BASE=EK(MACHINE_DEF[3].ROOT", "are not set to"),
        ("  ENDIF\n", "", "between IF and ENDIF"),
        ("    $VEL.ORI1=460", "    $VEL.ORI1=461", "not bounded by"),
        ("    $VEL.ORI1=$VEL_MA", "    $VEL.ORI2=$VEL_MA", "not bounded by"),
        ("IF $ACC_MA.CP<10.5", "IF $ACC_MA.ORI1<10.5", "not bounded by"),
        ("  PTP {", "  TRIGGER WHEN PATH=0 DELAY=0 DO $OUT[1]=TRUE\n  PTP {", "a trigger without a line after it"),
    ],
)
def test_reader_refuses_what_it_does_not_know(old: str, new: str, message: str) -> None:
    files, cell = write(wave()), wave().cell
    assert old in files[SOURCE]
    with pytest.raises(InputError, match=message):
        read_krl(
            files[SOURCE].replace(old, new, 1),
            files[DATA],
            lambda axes: cell.T_part_nozzle(np.column_stack([from_kuka(axes[:, :6]), axes[:, 7]])),
        )


@pytest.mark.parametrize(
    ("old", "new"),
    [("ENDDAT", ""), ("DECL FRAME FTOOL", "DECL FRAME FPART"), ("XSTART", "XOTHER"), ("X -44.510", "X -44.5.1")],
)
def test_reader_refuses_data_that_it_does_not_know(old: str, new: str) -> None:
    files = write(wave())
    assert old in files[DATA]
    with pytest.raises(InputError, match="KRL data"):
        read_krl(files[SOURCE], files[DATA].replace(old, new, 1), lambda axes: np.empty(0))
