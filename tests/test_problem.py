"""The problem file: its values in SI, its defaults, and one clear error for every mistake."""

from __future__ import annotations

import math
import os
import pickle
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from problem_text import TEXT, load, refused, swap
from pydantic import BaseModel, ValidationError

from planner.base.errors import InputError
from planner.base.shipped import PROBLEMS
from planner.problem import Problem, find_problem, load_problem, shipped_problems
from planner.problem.problem import _models
from planner.problem.settings import STRATEGY_NAMES


@pytest.fixture
def in_tmp(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


# What is right


def test_values_are_si(in_tmp: Path) -> None:
    problem = load(TEXT)
    assert problem.name == "test_1"
    assert problem.file == Path("p.yaml")
    assert problem.cell.arm == "irb140"
    assert problem.cell.nozzle.tip == pytest.approx((-0.04451, 0.0099, 0.11395), abs=1e-15)
    assert problem.cell.nozzle.axis == pytest.approx((0, 0.6, 0.8), abs=1e-15)
    assert problem.cell.nozzle.diameter == pytest.approx(0.0006)
    assert problem.cell.home == pytest.approx(
        (math.pi / 6, math.pi / 9, math.pi / 6, math.pi / 2, -math.pi * 4 / 9, math.pi / 3)
    )
    positioner = problem.cell.positioner
    assert positioner is not None
    assert positioner.robot == "irbp_a250"
    assert positioner.origin == pytest.approx((0.6335, 0.00987, 0.38))
    assert positioner.free == ("rotation",)
    assert positioner.held == pytest.approx({"tilt": math.pi / 4})
    assert set(problem.cell.limits) == {"joint_1", "rotation"}
    assert problem.cell.limits["joint_1"].range == pytest.approx((-math.pi, math.pi / 2))
    assert problem.cell.limits["joint_1"].speed == pytest.approx(200 * math.pi / 180)
    assert problem.cell.limits["joint_1"].acceleration is None
    assert problem.cell.limits["rotation"].acceleration == 7
    assert problem.cell.limits["rotation"].jerk == 350
    assert problem.part.cylinder.radius == pytest.approx(0.034)
    assert problem.part.cylinder.height == pytest.approx(0.1)
    assert problem.layers.source.svg == Path("drawings/logo.svg")
    assert problem.layers.source.width == pytest.approx(0.078)
    assert (problem.layers.wrap, problem.layers.count) == ("cylinder", 10)
    assert problem.layers.height == pytest.approx(0.0005)
    assert problem.process.speed == pytest.approx(0.04)
    assert problem.process.travel_speed == pytest.approx(0.2)
    assert problem.process.bead.width == pytest.approx(0.0006)
    assert problem.strategy == "greedy"


def test_defaults(in_tmp: Path) -> None:
    problem = load(swap("strategy: greedy\n", ""))
    assert problem.strategy == "sqp"
    assert problem.cell.base == (0, 0, 0)
    assert problem.cell.bed is None
    assert problem.part.cylinder.centre == (0, 0)
    process = problem.process
    assert process.bead.height == problem.layers.height
    assert process.corner_tolerance == pytest.approx(0.0002)
    assert process.chord_tolerance == pytest.approx(0.00001)
    assert process.run_in == pytest.approx(0.003)
    assert process.lift == pytest.approx(0.005)
    assert process.filament_diameter == pytest.approx(0.00175)
    assert problem.resolve.roll_step == pytest.approx(math.pi / 12)
    assert problem.resolve.table_step == pytest.approx(math.pi / 12)
    assert problem.resolve.rung == pytest.approx(0.005)
    assert problem.resolve.min_sigma == 0.05
    program = problem.program
    names = (program.tool, program.work_object, program.station, program.extruder_signal)
    assert names == ("tPen", "wobjPart", None, "doExtrude")
    assert [program.mover(second_arm) for second_arm in (False, True)] == ["STN1", "ROB_2"]


def test_nozzle_axis_and_limits_may_be_left_out(in_tmp: Path) -> None:
    text = swap("axis: [0, 3, 4], ", "")
    start, end = text.index("  limits:"), text.index("part:")
    problem = load(text[:start] + text[end:])
    assert problem.cell.nozzle.axis == (0, 0, 1)
    assert problem.cell.limits == {}


def test_bead_height_of_its_own(in_tmp: Path) -> None:
    problem = load(swap("width_mm: 0.6}", "width_mm: 0.6, height_mm: 0.4}"))
    assert problem.process.bead.height == pytest.approx(0.0004)
    assert problem.layers.height == pytest.approx(0.0005)


@pytest.mark.parametrize(
    ("height", "given", "chord", "widest"),
    [
        (0.5, [], 0.05e-3, 0.1e-3),
        (0.2, [], 0.05e-3, 0.1e-3),  # a quarter of the height is as much
        (0.05, [], 0.0125e-3, 0.025e-3),
        (0.05, ["program.chord_mm=0.03"], 0.03e-3, 0.06e-3),
    ],
)
def test_lines_of_programs_are_finer_where_beads_are_low(
    in_tmp: Path, height: float, given: list[str], chord: float, widest: float
) -> None:
    program = load(TEXT, [f"process.bead.height_mm={height}", *given]).program
    assert (program.chord, program.widening * program.chord) == pytest.approx((chord, widest))


@pytest.mark.parametrize(
    ("width", "given", "tolerance"),
    [(0.6, [], 0.2e-3), (0.4, [], 0.2e-3), (0.1, [], 0.05e-3), (0.1, ["process.corner_tolerance_mm=0.15"], 0.15e-3)],
)
def test_corners_of_narrow_beads_are_rounded_by_half_of_their_width(
    in_tmp: Path, width: float, given: list[str], tolerance: float
) -> None:
    process = load(TEXT, [f"process.bead.width_mm={width}", *given]).process
    assert process.corner_tolerance == pytest.approx(tolerance)


def test_a_mandrel_may_be_thinner_than_two_millimetres(in_tmp: Path) -> None:
    assert load(swap("radius_mm: 34", "radius_mm: 0.75")).part.cylinder.radius == pytest.approx(0.75e-3)


def test_fixed_bed(in_tmp: Path) -> None:
    start, end = TEXT.index("  positioner:"), TEXT.index("  limits:")
    problem = load(TEXT[:start] + "  bed_mm: [560, -93, 290]\n" + TEXT[end:])
    assert problem.cell.positioner is None
    assert problem.cell.bed == pytest.approx((0.56, -0.093, 0.29))
    assert problem.cell.bed_rpy == (0, 0, 0)
    turned = load(TEXT[:start] + "  bed_mm: [560, -93, 290]\n  bed_rpy_deg: [90, 0, -180]\n" + TEXT[end:])
    assert turned.cell.bed_rpy == pytest.approx((math.pi / 2, 0, -math.pi))


def test_drawing_counts_from_the_folder_of_the_file(in_tmp: Path) -> None:
    Path("sub").mkdir()
    Path("sub/p.yaml").write_text(TEXT)
    assert load_problem("sub/p.yaml").layers.source.svg == Path("sub/drawings/logo.svg")


def test_problem_is_frozen_and_travels(in_tmp: Path) -> None:
    problem = load(TEXT)
    with pytest.raises(ValidationError):
        problem.name = "other"
    with pytest.raises(ValidationError):
        problem.cell.arm = "other"
    again = pickle.loads(pickle.dumps(problem))
    assert again == problem
    assert str(again.error("cell.arm", "no")) == "p.yaml:3: cell.arm: no"


def test_byte_order_mark_and_other_line_ends(in_tmp: Path) -> None:
    assert load(b"\xef\xbb\xbf" + TEXT.encode()).name == "test_1"
    assert load(TEXT.replace("\n", "\r\n")).name == "test_1"
    error = refused(swap("count: 10", "count: 0").replace("\n", "\r\n"))
    assert error.line == 21


def test_shipped_problem_has_the_papers_values() -> None:
    assert "cylinder_logo" in shipped_problems()
    problem = load_problem("cylinder_logo")
    assert problem.name == "cylinder_logo"
    assert problem.cell.nozzle.tip == pytest.approx((-0.04451, 0.0099, 0.11395))
    assert problem.cell.nozzle.axis == (0, 0, 1)
    assert tuple(math.degrees(q) for q in problem.cell.home) == pytest.approx((30, 20, 30, 90, -80, 60))
    assert problem.cell.positioner is not None
    assert problem.cell.positioner.origin == pytest.approx((0.6335, 0.00987, 0.32))
    assert problem.cell.positioner.part == pytest.approx((0.0, 0.0, 0.06))  # together the paper's 380 mm
    assert problem.cell.positioner.held == {"tilt": 0}
    assert problem.part.cylinder.radius == pytest.approx(0.034)
    assert problem.part.cylinder.centre == pytest.approx((0.0314, 0.037))
    assert problem.layers.source.svg == find_problem("cylinder_logo").parent / "logo.svg"
    assert (problem.layers.count, problem.strategy) == (10, "sqp")
    assert problem.process.speed == pytest.approx(0.04)


def sections(model: type[BaseModel]) -> Iterator[type[BaseModel]]:
    yield model
    for field in model.model_fields.values():
        for kind in _models(field.annotation).values():
            yield from sections(kind)


def test_every_field_is_described_with_unit_and_default() -> None:
    units = {"_mm": "[mm]", "_deg": "[deg]", "_mm_s": "[mm/s]", "_deg_s": "[deg/s]"}
    units |= {"_rad_s2": "[rad/s2]", "_rad_s3": "[rad/s3]", "_s": "[s]", "_c": "[°C]"}
    found = list(sections(Problem))
    assert len(found) >= 30
    for model in found:
        for name, field in model.model_fields.items():
            key = field.alias or name
            assert field.description, key
            unit = next((unit for end, unit in units.items() if key.endswith(end)), "")
            assert unit in field.description, key
            assert field.is_required() or "default" in field.description, key


def test_extruder_and_section(in_tmp: Path) -> None:
    process = load(TEXT).process
    assert (process.section, process.extruder.motor, process.extruder.lag) == ("rectangle", "e_axis", 0.0)
    process = load(
        TEXT, ["process.bead.section=rounded", "process.extruder={motor: speed_demand, lag_s: 0.06}"]
    ).process
    assert (process.section, process.extruder.motor, process.extruder.lag) == ("rounded", "speed_demand", 0.06)
    assert load(TEXT, ["process.fibre={cut_length_mm: 30}"]).process.section == "fibre"
    for bad in (-0.001, 2.001):
        assert refused(TEXT, [f"process.extruder.lag_s={bad}"]).hint == "valid: 0 to 2 s"


@pytest.mark.parametrize(
    ("changes", "field", "reason", "hint"),
    [
        (["process.bead.section=round"], "process.bead.section", "unknown name 'round'", "did you mean rounded?"),
        (
            ["process.extruder.motor=off"],
            "process.extruder.motor",
            "unknown name 'off'",
            "e_axis, speed_demand, on_off",
        ),
        (
            ["process.bead={width_mm: 0.4, section: rounded}"],
            "process.bead",
            "0.4 mm wide and 0.5 mm high",
            "at least as wide as high",
        ),
        (
            ["process.extruder.motor=on_off", "process.extruder.lag_s=0.1"],
            "process.extruder.motor",
            "cannot make up for lag_s",
            "leave out lag_s",
        ),
        (
            ["process.extruder.motor=on_off", "process.retract.length_mm=2"],
            "process.extruder",
            "cannot pull filament back",
            "leave out retract",
        ),
        (
            ["process.bead.section=fibre", "process.extruder.motor=on_off"],
            "process.extruder",
            "fed as fast as it is laid",
            "another motor",
        ),
        (
            ["process.bead.section=fibre", "process.extruder.lag_s=0.1"],
            "process.extruder",
            "does not lag",
            "leave out lag_s",
        ),
        (
            ["process.bead.section=fibre", "process.prime.length_mm=2"],
            "process.prime",
            "length_mm is 2, and a fibre is fed as long as its bead",
            "leave it out",
        ),
        (
            ["process.bead.section=fibre", "process.retract.length_mm=1.5"],
            "process.retract",
            "length_mm is 1.5, and a fibre is fed as long as its bead",
            "leave it out",
        ),
        (
            ["process.fibre={cut_length_mm: 30}", "process.bead.section=rounded"],
            "process.fibre",
            "a fibre's section is not rounded",
            "leave out section",
        ),
    ],
)
def test_what_an_extruder_cannot_do(in_tmp: Path, changes: list[str], field: str, reason: str, hint: str) -> None:
    error = refused(TEXT, changes)
    assert (error.field or "").startswith(f"--set {field}")
    assert reason in error.reason
    assert hint in (error.hint or "")


# What is wrong with the text

MISTAKES: list[tuple[str, str, int, str, str, str]] = [
    # old, new, line, field, part of the reason, part of the hint
    ("radius_mm: 34", "raduis_mm: 34", 16, "part.cylinder.raduis_mm", "unknown key", "did you mean radius_mm?"),
    ("radius_mm: 34", "radius: 34", 16, "part.cylinder.radius", "unknown key", "did you mean radius_mm?"),
    ("part:", "prat:", 14, "prat", "unknown key", "did you mean part?"),
    ("strategy: greedy", "qqqq: 1", 27, "qqqq", "unknown key", "known keys: name, cell, layers, part"),
    (
        "speed_deg_s: 200",
        "speed_deg: 200",
        12,
        "cell.limits.joint_1.speed_deg",
        "unknown key",
        "did you mean speed_deg_s?",
    ),
    ("robot: irbp_a250", "robto: irbp_a250", 7, "cell.positioner.robto", "unknown key", "did you mean robot?"),
    ("    height_mm: 100\n", "", 15, "part.cylinder.height_mm", "is missing", "height [mm]"),
    ("name: test_1", "# nothing", 2, "name", "is missing", "name of the problem"),
    ("radius_mm: 34", 'radius_mm: "34"', 16, "part.cylinder.radius_mm", "text '34'", "0.1 to 2000 mm, without quotes"),
    ("radius_mm: 34", "radius_mm: true", 16, "part.cylinder.radius_mm", "not true", "valid: 0.1 to 2000 mm"),
    ("radius_mm: 34", "radius_mm:", 16, "part.cylinder.radius_mm", "not nothing", "valid: 0.1 to 2000 mm"),
    ("radius_mm: 34", "radius_mm: [34]", 16, "part.cylinder.radius_mm", "not a list", "valid: 0.1 to 2000 mm"),
    ("radius_mm: 34", "radius_mm: 1_000", 16, "part.cylinder.radius_mm", "text '1_000'", "without quotes"),
    ("radius_mm: 34", "radius_mm: .nan", 16, "part.cylinder.radius_mm", "finite", "0.1 to 2000 mm"),
    ("radius_mm: 34", "radius_mm: -.inf", 16, "part.cylinder.radius_mm", "finite", "0.1 to 2000 mm"),
    ("radius_mm: 34", "radius_mm: 1e999", 16, "part.cylinder.radius_mm", "finite", "0.1 to 2000 mm"),
    ("radius_mm: 34", "radius_mm: " + "9" * 9000, 16, "part.cylinder.radius_mm", "finite", "0.1 to 2000 mm"),
    ("radius_mm: 34", "radius_mm: 0x" + "f" * 9000, 16, "part.cylinder.radius_mm", "finite", "0.1 to 2000 mm"),
    ("radius_mm: 34", "radius_mm: 0", 16, "part.cylinder.radius_mm", "0 mm is too small", "0.1 to 2000 mm"),
    ("radius_mm: 34", "radius_mm: -34", 16, "part.cylinder.radius_mm", "-34 mm is too small", "0.1 to 2000 mm"),
    ("radius_mm: 34", "radius_mm: 1e6", 16, "part.cylinder.radius_mm", "too large", "0.1 to 2000 mm"),
    ("[633.5, 9.87, 380]", "[633.5, 9.87, 100001]", 8, "cell.positioner.origin_mm", "number 3", "-100000 to 100000"),
    ("[633.5, 9.87, 380]", "[633.5, 9.87]", 8, "cell.positioner.origin_mm", "3 numbers, not of 2", "mm"),
    ("[633.5, 9.87, 380]", "[1, x, 3]", 8, "cell.positioner.origin_mm", "number 2 must be a number", "mm"),
    ("[633.5, 9.87, 380]", "[1, 2,\n     .inf]", 9, "cell.positioner.origin_mm", "number 3", "mm"),
    ("[633.5, 9.87, 380]", "5", 8, "cell.positioner.origin_mm", "a list of 3 numbers, not 5", "mm"),
    ("[30, 20, 30, 90, -80, 60]", "[]", 5, "cell.home_deg", "1 to 12 numbers, not of 0", "-3600 to 3600 deg"),
    ("-80, 60]", "-80, 3601]", 5, "cell.home_deg", "number 6 3601 deg is too large", "-3600 to 3600 deg"),
    ("[0, 3, 4]", "[0, 0, 0]", 4, "cell.nozzle.axis", "zero vector", "not all of them 0"),
    ("count: 10", "count: 0", 21, "layers.count", "0 is too small", "1 to 10000"),
    ("count: 10", "count: 1000000000", 21, "layers.count", "1000000000 is too large", "1 to 10000"),
    ("count: 10", "count: 10.0", 21, "layers.count", "whole number", "1 to 10000"),
    ("speed_mm_s: 40", "speed_mm_s: 0", 24, "process.speed_mm_s", "too small", "0.1 to 2000 mm/s"),
    ("speed_mm_s: 40", "speed_mm_s: 2001", 24, "process.speed_mm_s", "too large", "0.1 to 2000 mm/s"),
    ("strategy: greedy", "strategy: gredy", 27, "strategy", "'gredy'", "did you mean greedy?"),
    ("strategy: greedy", "strategy: 7", 27, "strategy", "not 7", ", ".join(STRATEGY_NAMES)),
    ("wrap: cylinder", "wrap: sphere", 20, "layers.wrap", "'sphere'", "choices: cylinder"),
    ("[-180, 90]", "[90, -180]", 12, "cell.limits.joint_1.range_deg", "first number must be less", "[-180, 180]"),
    ("[-180, 90]", "[90, 90]", 12, "cell.limits.joint_1.range_deg", "first number must be less", "[-180, 180]"),
    ("[rotation]", "[rotation, rotation]", 9, "cell.positioner.free", "'rotation'", "once"),
    ("[rotation]", "rotation", 9, "cell.positioner.free", "must be a list", "[rotation]"),
    ("[rotation]", "[1]", 9, "cell.positioner.free", "must be a name, not 1", "quote"),
    ("[rotation]", "[rotation, tilt]", 10, "cell.positioner.held_deg", "both free and held", "one or the other"),
    ("{tilt: 45}", "{tilt: up}", 10, "cell.positioner.held_deg.tilt", "text 'up'", "-3600 to 3600 deg"),
    ("{tilt: 45}", "tilt", 10, "cell.positioner.held_deg", "must be a section", "names"),
    ("arm: irb140", "arm: 140", 3, "cell.arm", "must be a name, not 140", "quote"),
    ("arm: irb140", "bed_mm: [0, 0, 0]\n  arm: irb140", 7, "cell.positioner", "both", "exactly one"),
    (
        "cylinder:\n    radius_mm: 34\n    height_mm: 100",
        "cylinder: 3",
        15,
        "part.cylinder",
        "must be a section",
        "rad",
    ),
    ("name: test_1", "name: 1test", 1, "name", "'1test'", "a letter, then"),
    ("name: test_1", "name: a-b", 1, "name", "'a-b'", "a letter, then"),
    ("name: test_1", "name: bücher", 1, "name", "'bücher'", "a letter, then"),
    ("name: test_1", 'name: "a\\n"', 1, "name", "text", ""),
    ("name: test_1", "name: " + "a" * 33, 1, "name", "RAPID", "at most 32"),
    ("name: test_1", "name: Module", 1, "name", "word of RAPID", "my_Module"),
    ("strategy: greedy", "program: {tool: ../x}", 27, "program.tool", "RAPID", "letters"),
    ("strategy: greedy", "program: {tool: a, station: A}", 27, "program.tool", "names both", "its own name"),
    ("strategy: greedy", "resolve: {rung_mm: 0.4}", 27, "resolve.rung_mm", "too small", "0.5 to 100 mm"),
    ("strategy: greedy", "resolve: {min_sigma: 1.5}", 27, "resolve.min_sigma", "too large", "0 to 1"),
    ("strategy: greedy", "collision: {arm_mm: 60}", 27, "collision.arm_mm", "too large", "0 to 50 mm"),
    ("strategy: greedy", "resolve:", 27, "resolve", "section, not nothing", "roll_step_deg"),
    ("svg: drawings/logo.svg", "svg: 3", 19, "layers.source.svg", "must be a name, not 3", "quote"),
    ("svg: drawings/logo.svg", 'svg: "a\\0b"', 19, "layers.source.svg", "text", ""),
]


@pytest.mark.parametrize(("old", "new", "line", "field", "reason", "hint"), MISTAKES)
def test_a_mistake_is_told_with_its_place(
    in_tmp: Path, old: str, new: str, line: int, field: str, reason: str, hint: str
) -> None:
    error = refused(swap(old, new))
    assert (str(error.file), error.line, error.field) == ("p.yaml", line, field)
    assert reason in error.reason
    assert hint in (error.hint or "")
    assert "more mistake" not in str(error)
    assert str(error).startswith(f"p.yaml:{line}: {field}: ")
    assert len(str(error)) < 400


@pytest.mark.parametrize(
    ("key", "low", "high", "unit"),
    [
        ("speed_mm_s", 0.1, 2000, "mm/s"),
        ("corner_tolerance_mm", 0.01, 5, "mm"),
        ("chord_tolerance_mm", 0.0005, 1, "mm"),
        ("run_in_mm", 0.5, 100, "mm"),
        ("lift_mm", 1, 500, "mm"),
        ("prime.length_mm", 0, 100, "mm"),
        ("prime.speed_mm_s", 0.1, 200, "mm/s"),
        ("retract.length_mm", 0, 100, "mm"),
        ("retract.speed_mm_s", 0.1, 200, "mm/s"),
        ("start.purge_mm", 0, 1000, "mm"),
        ("start.purge_speed_mm_s", 0.1, 200, "mm/s"),
        ("filament_diameter_mm", 0.1, 500, "mm"),
        ("bead.width_mm", 0.01, 50, "mm"),
        ("bead.height_mm", 0.01, 50, "mm"),
    ],
)
def test_ranges_include_their_ends(in_tmp: Path, key: str, low: float, high: float, unit: str) -> None:
    for good in (low, high):
        value: Any = load(TEXT, ["process.travel_speed_mm_s=2000", f"process.{key}={good}"]).process
        for name in key.replace("_mm_s", "").replace("_mm", "").split("."):
            value = getattr(value, name)
        assert value == pytest.approx(good / 1000)
    for bad in (low * 0.999 if low else -0.001, high * 1.001):
        assert refused(TEXT, [f"process.{key}={bad}"]).hint == f"valid: {low:g} to {high:g} {unit}"


def test_around_a_bead_nothing_happens_by_default(in_tmp: Path) -> None:
    process = load(TEXT).process
    assert (process.ramp, process.fibre, process.prime_length) == (None, None, 0.0)
    assert (process.prime.length, process.retract.length, process.start.time) == (0.0, 0.0, 0.0)
    assert (process.start.nozzle_c, process.start.bed_c, process.start.purge) == (None, None, 0.0)


def test_fibre_brings_its_ramp_its_clearance_and_its_feed(in_tmp: Path) -> None:
    process = load(TEXT, ["process.fibre={cut_length_mm: 45, clearance_mm: 30, least_laid_mm: 8}"]).process
    assert process.fibre is not None
    assert math.degrees(process.ramp or 0.0) == pytest.approx(30)
    assert process.lift == pytest.approx(0.03)
    assert process.prime_length == pytest.approx(0.045)
    assert process.fibre.cut_wait == 3.0
    assert process.fibre.least_length == pytest.approx(0.053)
    given = load(TEXT, ["process.fibre={cut_length_mm: 45}", "process.ramp_deg=20", "process.lift_mm=7"]).process
    assert math.degrees(given.ramp or 0.0) == pytest.approx(20)
    assert given.lift == pytest.approx(0.007)


def test_temperatures_stay_in_celsius_and_waits_in_seconds(in_tmp: Path) -> None:
    start = load(TEXT, ["process.start={nozzle_c: 200, bed_c: 60, heat_wait_s: 90, purge_mm: 30}"]).process.start
    assert (start.nozzle_c, start.bed_c, start.heat_wait) == (200, 60, 90)
    assert start.time == pytest.approx(90 + 30 / 5)


@pytest.mark.parametrize(
    ("change", "field", "reason", "hint"),
    [
        ("ramp_deg=4", "ramp_deg", "4 deg is too small", "valid: 5 to 60 deg"),
        ("ramp_deg=61", "ramp_deg", "61 deg is too large", "valid: 5 to 60 deg"),
        ("ramp_deg=steep", "ramp_deg", "not the text 'steep'", "valid: 5 to 60 deg"),
        ("start.nozzle_c=501", "start.nozzle_c", "501 °C is too large", "valid: 20 to 500 °C"),
        ("start.bed_c=19", "start.bed_c", "19 °C is too small", "valid: 20 to 300 °C"),
        ("start.heat_wait_s=-1", "start.heat_wait_s", "-1 s is too small", "valid: 0 to 3600 s"),
        ("fibre.cut_length_mm=0", "fibre.cut_length_mm", "0 mm is too small", "valid: 1 to 500 mm"),
        ("fibre={cut_wait_s: 1}", "fibre: process.fibre.cut_length_mm", "is missing", "from the cutter to the nozzle"),
        (
            "fibre={cut_length_mm: 9, cut_wait_s: 601}",
            "fibre: process.fibre.cut_wait_s",
            "601 s is too large",
            "0 to 600",
        ),
        (
            "fibre={cut_length_mm: 9, clearance_mm: 0.5}",
            "fibre: process.fibre.clearance_mm",
            "0.5 mm is too",
            "1 to 500 mm",
        ),
        (
            "fibre={cut_length_mm: 9, least_laid_mm: 0}",
            "fibre: process.fibre.least_laid_mm",
            "too small",
            "1 to 500 mm",
        ),
        ("fibre={cut_lenght_mm: 9}", "fibre: process.fibre.cut_lenght_mm", "unknown key", "did you mean cut_length_mm"),
        ("prime={lenght_mm: 9}", "prime: process.prime.lenght_mm", "unknown key", "did you mean length_mm?"),
        ("retract=3", "retract", "must be a section, not 3", "its keys: length_mm, speed_mm_s"),
    ],
)
def test_mistakes_around_a_bead(in_tmp: Path, change: str, field: str, reason: str, hint: str) -> None:
    error = refused(TEXT, [f"process.{change}"])
    assert error.field == f"--set process.{field}"
    assert reason in error.reason
    assert hint in (error.hint or "")


@pytest.mark.parametrize(
    ("lines", "field", "line", "reason", "hint"),
    [
        (
            "lift_mm: 5\n  fibre: {cut_length_mm: 9, clearance_mm: 30}",
            "fibre",
            28,
            "both lift_mm and fibre.clearance_mm are given",
            "give one of them",
        ),
        (
            "fibre: {cut_length_mm: 9}\n  retract: {length_mm: 2}",
            "retract",
            28,
            "retract.length_mm is 2, but there is fibre",
            "cut fibre is not pulled back",
        ),
        (
            "prime: {length_mm: 1.5}\n  fibre: {cut_length_mm: 9}",
            "fibre",
            28,
            "prime.length_mm is 1.5, but there is fibre",
            "fed forward by fibre.cut_length_mm",
        ),
    ],
)
def test_fibre_refuses_what_contradicts_it(
    in_tmp: Path, lines: str, field: str, line: int, reason: str, hint: str
) -> None:
    error = refused(swap("  bead: {width_mm: 0.6}\n", f"  bead: {{width_mm: 0.6}}\n  {lines}\n"))
    assert (error.line, error.field) == (line, f"process.{field}")
    assert reason in error.reason
    assert hint in (error.hint or "")


def test_neither_positioner_nor_bed(in_tmp: Path) -> None:
    start, end = TEXT.index("  positioner:"), TEXT.index("  limits:")
    error = refused(TEXT[:start] + TEXT[end:])
    assert (error.line, error.field) == (2, "cell")
    assert "neither positioner nor bed_mm" in error.reason


def test_the_first_of_several_mistakes_and_how_many_more(in_tmp: Path) -> None:
    text = TEXT.replace("count: 10", "count: 0").replace("radius_mm: 34", "radius_mm: 0").replace("greedy", "greed")
    error = refused(text)
    assert (error.line, error.field) == (16, "part.cylinder.radius_mm")
    assert error.hint == "valid: 0.1 to 2000 mm; 2 more mistakes in this problem"
    assert str(refused(text.replace("greed", "greedy"))).endswith("; 1 more mistake in this problem)")


def test_first_means_first_in_the_file(in_tmp: Path) -> None:
    start, end = TEXT.index("layers:"), TEXT.index("process:")
    backwards = TEXT[end:] + TEXT[start:end] + TEXT[:start]
    error = refused(
        backwards.replace("count: 10", "count: 0").replace("irb140", "140").replace("speed_mm_s: 40", "speed_mm_s: 0")
    )
    assert (error.line, error.field) == (2, "process.speed_mm_s")


def test_a_wrong_layer_height_is_one_mistake(in_tmp: Path) -> None:
    error = refused(TEXT.replace("  height_mm: 0.5", "  height_mm: -0.5"))
    assert error.field == "layers.height_mm"
    assert "more" not in str(error)


@pytest.mark.parametrize(
    ("text", "line", "reason"),
    [
        (b"", None, "empty"),
        (b"# only a comment\n", None, "empty"),
        (b"- a\n- b\n", 1, "not a list"),
        (b"\n\nhello\n", 3, "not the text 'hello'"),
        (b"---\n", None, "empty"),
        (b"name: a\xe9\n", 1, "not UTF-8"),
        (b"a: 1\n\nb: \xff\n", 3, "not UTF-8"),
        (TEXT.encode("utf-16"), 1, "not UTF-8"),
        (b"a: 1\nb: \x07\n", 2, "control character"),
        (b"name: [1, 2\n", 1, "not YAML at column 7"),
        (b"name: x\n\tcell: y\n", 2, "not YAML at column 1"),
        (b"a: 1\nb: c: d\n", 2, "not YAML at column 5"),
        (b"a: 1\nb: 'it\nis\n", 2, "not YAML at column 4"),
        (b"a: 1\nb: 2\na: 3\n", 3, "first in line 1"),
        (b"a: {b: 1,\n b: 2}\n", 2, "a.b is given twice, first in line 1"),
        (b"a: 1\n---\nb: 2\n", 3, "second document"),
        (b"a: 1\n2: 3\n", 2, "key must be a name"),
        (b"a: 1\n? [x]\n: 3\n", 2, "key must be a name"),
        (b"a: 1\ntrue: 3\n", 2, "key must be a name"),
        (b"a: &x 1\nb: *x\n", 1, "anchor or alias"),
        (b"a: 1\nb: *x\n", 2, "anchor or alias"),
        (b"a: &a [*a, *a]\n", 1, "anchor or alias"),
        (b"a: 1\nb: !!python/object/apply:os.system [ls]\n", 2, "tag"),
        (b"a: !!float 1\n", 1, "tag"),
        (b"%YAML 1.1\n---\na: yes\n", 2, "version of YAML"),
        (b'a: 1\nb: "\\UFFFFFFFF"\n', 2, "escape"),
        (b"[" * 100_000, 1, "nested deeper than 20"),
        (b"- " * 100_000, 1, "nested deeper than 20"),
        (b"a: [" + b"1," * 100_000 + b"]", 1, "more than 20000 values"),
        (b"a: b\n" + b"#" * 1_000_000, None, "larger than 1 MB"),
    ],
)
def test_what_is_not_a_problem_file(in_tmp: Path, text: bytes, line: int | None, reason: str) -> None:
    error = refused(text)
    assert (str(error.file), error.line) == ("p.yaml", line)
    assert reason in error.reason
    assert len(str(error)) < 300


def test_words_of_yaml_1_2_only(in_tmp: Path) -> None:
    assert load(swap("name: test_1", "name: yes")).name == "yes"  # a text since YAML 1.2
    assert load(swap("radius_mm: 34", "radius_mm: 0o42")).part.cylinder.radius == pytest.approx(0.034)
    assert load(swap("radius_mm: 34", "radius_mm: 3.4e+1")).part.cylinder.radius == pytest.approx(0.034)
    assert load(swap("radius_mm: 34", "radius_mm: 034")).part.cylinder.radius == pytest.approx(0.034)


# Finding the file


def test_find_by_name_and_path(in_tmp: Path) -> None:
    shipped = find_problem("cylinder_logo")
    assert shipped.is_file()
    assert find_problem("cylinder_logo.yaml") == shipped
    assert find_problem(shipped) == shipped
    Path("cylinder_logo").mkdir()
    assert find_problem("cylinder_logo") == shipped, "a folder of results does not hide the problem"
    Path("cylinder_logo.yaml").write_text(TEXT)
    assert find_problem("cylinder_logo.yaml") == Path("cylinder_logo.yaml")


@pytest.mark.parametrize(
    ("name", "reason", "hint"),
    [
        ("cylinder_lgo", "no such problem", "did you mean cylinder_logo?"),
        ("problems/cylinder_lgo.yaml", "no such problem", "did you mean cylinder_logo?"),
        ("zzz", "no such problem", "aerofoil_core, "),
        ("../problems/cylinder_logo", "no such problem", "cylinder_logo"),
        ("a" * 5000, "no such problem", "aerofoil_core, "),
        ("a\0b", "no such problem", "aerofoil_core, "),
        (".", "is a folder", "the .yaml file in it"),
        ("", "is a folder", "the .yaml file in it"),
        (os.devnull, "not a regular file", ".yaml"),
    ],
)
def test_no_such_file(in_tmp: Path, name: str, reason: str, hint: str) -> None:
    with pytest.raises(InputError) as caught:
        load_problem(name)
    assert reason in caught.value.reason
    assert hint in (caught.value.hint or "")
    listed = len(", ".join(shipped_problems())) + len(str(PROBLEMS)) + len(str(in_tmp))
    assert len(str(caught.value)) < 300 + listed  # however long the name
    assert str(caught.value).isprintable()


def test_a_file_that_may_not_be_read(in_tmp: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*args: object, **kwargs: object) -> None:
        raise PermissionError(13, "Permission denied")

    Path("p.yaml").write_text(TEXT)
    monkeypatch.setattr(Path, "open", refuse)  # the tests may run as root, who may read everything
    with pytest.raises(InputError, match=r"^p\.yaml: cannot be read: Permission denied"):
        load_problem("p.yaml")


# Overrides


def test_overrides(in_tmp: Path) -> None:
    problem = load(
        TEXT,
        [
            *("process.speed_mm_s=30", "resolve.rung_mm=2", "cell.positioner=null", "cell.bed_mm=[560, -93, 290]"),
            *("cell.limits.joint_2.jerk_rad_s3=99", "name=yes", "layers.source.svg=a=b.svg"),
        ],
    )
    assert problem.process.speed == pytest.approx(0.03)
    assert problem.resolve.rung == pytest.approx(0.002)
    assert problem.cell.positioner is None
    assert problem.cell.bed == pytest.approx((0.56, -0.093, 0.29))
    assert problem.cell.limits["joint_2"].jerk == 99
    assert problem.cell.limits["joint_1"].speed == pytest.approx(math.radians(200))
    assert problem.name == "yes"
    assert problem.layers.source.svg == Path("a=b.svg")


def test_the_last_override_wins_and_mends_the_file(in_tmp: Path) -> None:
    assert load(TEXT, ["layers.count=3", "layers.count=4"]).layers.count == 4
    assert load(swap("count: 10", "count: 0"), ["layers.count=4"]).layers.count == 4


@pytest.mark.parametrize(
    ("override", "field", "reason", "hint"),
    [
        ("process.sped_mm_s=3", "--set process.sped_mm_s", "unknown key", "did you mean speed_mm_s?"),
        ("proces.speed_mm_s=3", "--set proces.speed_mm_s", "unknown key", "did you mean process?"),
        ("process.speed_mm_s=0", "--set process.speed_mm_s", "too small", "0.1 to 2000 mm/s"),
        ("process.speed_mm_s=fast", "--set process.speed_mm_s", "text 'fast'", "0.1 to 2000 mm/s"),
        ("process.speed_mm_s=", "--set process.speed_mm_s", "not nothing", "0.1 to 2000 mm/s"),
        ("strategy=laddr", "--set strategy", "'laddr'", "did you mean ladder?"),
        ("cell.home_deg=[1, 2, 3, 4, 5, .nan]", "--set cell.home_deg", "number 6", "deg"),
        ("cell.bed_mm=[0, 0, 0]", "--set cell.bed_mm", "both positioner and bed_mm", "exactly one"),
        ("cell.bed_rpy_deg=[0, 0, 5]", "--set cell.bed_rpy_deg", "a part on a bed", "part_rpy_deg"),
        ("cell.bed_rpy_deg=[0, 0]", "--set cell.bed_rpy_deg", "3 numbers", "-360 to 360"),
        ("part={cylinder: {radius_mm: 1}}", "--set part: part.cylinder.height_mm", "is missing", "height"),
        ("name.x=3", "--set name.x", "would go below the text 'test_1'", ""),
        ("cell.home_deg.0=3", "--set cell.home_deg.0", "below a list", ""),
        ("layers.count=[1", "--set layers.count", "not YAML", ""),
        ("layers.count=&a 1", "--set layers.count", "anchor", ""),
        ("layers.count", "--set layers.count", "dotted.key=value", "for example"),
        ("=3", "--set =3", "dotted.key=value", "for example"),
        ("layers..count=3", "--set layers..count=3", "dotted.key=value", "for example"),
        (".".join("a" * 50) + "=1", "--set " + ".".join("a" * 50)[:79] + "…", "too many dots", ""),
    ],
)
def test_errors_of_overrides_name_set(in_tmp: Path, override: str, field: str, reason: str, hint: str) -> None:
    error = refused(TEXT, [override])
    assert (error.file, error.line, error.field) == (None, None, field)
    assert reason in error.reason
    assert hint in (error.hint or "")
    assert str(error).startswith("--set ")


def test_the_override_that_is_to_blame_is_named(in_tmp: Path) -> None:
    assert refused(TEXT, ["part={cylinder: {radius_mm: 9, height_mm: 9}}", "part.cylinder.radius_mm=0"]).field == (
        "--set part.cylinder.radius_mm"
    )
    error = refused(swap("greedy", "greed"), ["layers.count=0"])
    assert error.field == "--set layers.count", "what was typed just now comes before what stands in the file"
    assert "1 more mistake" in str(error)


# Errors that other rooms find


def test_error_names_the_line_after_loading(in_tmp: Path) -> None:
    problem = load(TEXT, ["process.lift_mm=9"])
    error = problem.error("cell.nozzle.tip_mm", "is inside the flange", "move it")
    assert str(error) == "p.yaml:4: cell.nozzle.tip_mm: is inside the flange (move it)"
    assert problem.error("cell.limits.joint_1", "x").line == 12
    assert problem.error("process.run_in_mm", "x").line == 23, "not in the file: the section around it"
    assert problem.error("resolve.rung_mm", "x").line == 1, "nor the section: where the file starts"
    assert problem.error("process.lift_mm", "x").field == "--set process.lift_mm"
