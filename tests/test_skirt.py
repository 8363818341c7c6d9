"""Lines around the first layer: where they lie, what comes first, and that the verifier finds lines that lie elsewhere."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import shapely
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from planner.base.errors import InputError
from planner.planning.pipeline import solve
from planner.problem import Problem, load_problem
from planner.toolpath.bead import Bead, Toolpath
from planner.toolpath.build import build_toolpath
from planner.toolpath.skirt import with_skirt
from tests.test_reread import BASE, failed, found

AROUND = "lines around the first layer"
WIDTH = 1.0  # mm, of beads
TEXT = "layers: {source: {mesh: blocks.stl}, height_mm: 0.6, infill: {density: 0.3}, upper: {z_mm: 1.8}}\n"


def prism(rim: np.ndarray, middle: tuple[float, float], height: float) -> trimesh.Trimesh:
    """What stands on an outline (n, 2), counter-clockwise, all of which is seen from its middle [mm]."""
    n = len(rim)
    plane = np.vstack([rim, middle])
    vertices = np.vstack([np.column_stack([plane, np.full(n + 1, z)]) for z in (0.0, height)])
    a = np.arange(n)
    b = (a + 1) % n
    lower, upper = np.column_stack([b, a, 0 * a + n]), np.column_stack([a + n + 1, b + n + 1, 0 * a + 2 * n + 1])
    sides = [np.column_stack([a, b, b + n + 1]), np.column_stack([a, b + n + 1, a + n + 1])]
    return trimesh.Trimesh(vertices, np.vstack([lower, upper, *sides]), process=False)


@cache
def folder() -> Path:
    """Two blocks, 12 mm apart, the taller one with a hollow at its side."""
    import tempfile

    made = Path(tempfile.mkdtemp(prefix="skirt"))
    block = trimesh.creation.box((10.0, 10.0, 1.2))
    block.apply_translation([24.0, 0.0, 0.6])
    rim = np.array([(-7, -8), (7, -8), (7, -2), (0, 0), (7, 2), (7, 8), (-7, 8)], dtype=float)
    hollow = prism(rim, (-3.0, 0.0), 1.8)
    trimesh.util.concatenate([hollow, block]).export(made / "blocks.stl")
    (made / "blocks.yaml").write_text(BASE.replace("width_mm: 0.6", f"width_mm: {WIDTH:g}") + TEXT)
    return made


@cache
def print_with(*changes: str) -> tuple[Problem, Toolpath]:
    problem = load_problem(folder() / "blocks.yaml", changes)
    return problem, build_toolpath(problem)


def lines_of(toolpath: Toolpath) -> list[Bead]:
    return [bead for bead in toolpath.beads if bead.name.startswith("skirt")]


def covered(toolpath: Toolpath) -> shapely.Geometry:
    """What the first layer covers [mm]."""
    first = [bead for bead in toolpath.beads if bead.layer == 0 and not bead.name.startswith("skirt")]
    return shapely.union_all([shapely.LineString(1e3 * bead.points[:, :2]).buffer(0.5 * WIDTH) for bead in first])


@pytest.mark.slow(keep=1)
@pytest.mark.parametrize(("loops", "gap"), [(1, 2.0), (3, 0.0)])
def test_lines_lie_around_each_part_of_the_first_layer(loops: int, gap: float) -> None:
    toolpath = print_with(f"process.skirt={{loops: {loops}, gap_mm: {gap}}}")[1]
    lines, inside = lines_of(toolpath), covered(toolpath)
    assert lines == list(toolpath.beads[: len(lines)]) and len(lines) == 2 * loops
    away = [shapely.distance(inside, shapely.points(1e3 * line.points[:, :2])) for line in lines]
    for k, own in enumerate(away):  # from the outside in
        expected = gap + (loops - k // 2 - 0.5) * WIDTH
        assert np.abs(own - expected).max() < 0.21  # mm: the tolerance of rounded corners
    level = toolpath.beads[len(lines)].points[0, 2]
    for line in lines:
        assert line.closed and line.layer == 0
        np.testing.assert_allclose(line.points[:, 2], level, atol=1e-12)
        np.testing.assert_array_equal(line.normals, np.tile([0.0, 0.0, 1.0], (len(line.s), 1)))


def test_lines_that_meet_are_one() -> None:
    toolpath = print_with("process.skirt={loops: 1, gap_mm: 8}")[1]
    (line,) = lines_of(toolpath)
    assert shapely.Polygon(1e3 * line.points[:, :2]).contains(covered(toolpath))


def test_lines_are_as_wide_as_the_first_bead_usually_is() -> None:
    """It may begin with a scarf, whose flow grows from next to nothing."""
    problem = print_with("process.skirt={loops: 2}")[0]
    first, *others = print_with()[1].beads
    faded = replace(first, width=np.where(first.s < 1e-3, 1e-5, first.width))
    assert problem.process.skirt is not None
    toolpath = with_skirt(problem, replace(print_with()[1], beads=(faded, *others)), problem.process.skirt)
    assert {float(line.width[0]) for line in lines_of(toolpath)} == {1e-3 * WIDTH}
    assert AROUND not in failed(found(problem, toolpath))


def test_lines_keep_off_beads_of_other_widths() -> None:
    problem = print_with("process.skirt={loops: 2}")[0]
    first, *others = print_with()[1].beads
    wide = [replace(bead, width=bead.width * np.linspace(1.5, 2.5, len(bead.width))) for bead in others]
    assert problem.process.skirt is not None
    toolpath = with_skirt(problem, replace(print_with()[1], beads=(first, *wide)), problem.process.skirt)
    findings = found(problem, toolpath)
    assert AROUND in {check.name for check in findings.checks} and AROUND not in failed(findings)


@pytest.mark.slow
def test_the_print_within_is_the_one_without() -> None:
    alone, toolpath = print_with()[1], print_with("process.skirt={loops: 2}")[1]
    count = len(lines_of(toolpath))
    for a, b in zip(alone.beads, toolpath.beads[count:], strict=True):
        np.testing.assert_array_equal(a.points, b.points)
    last = len(toolpath.beads) - 1
    tips = toolpath.beads[last].points[:5]
    expected = alone.surface.normals_on(last - count, alone.beads[-1].s[:5], tips)
    np.testing.assert_array_equal(toolpath.surface.normals_on(last, toolpath.beads[last].s[:5], tips), expected)


@pytest.mark.slow
def test_a_true_line_passes() -> None:
    findings = found(*print_with("process.skirt={}"))
    assert not failed(findings), failed(findings)
    assert AROUND in {check.name for check in findings.checks}


@pytest.mark.slow
@settings(max_examples=15)
@given(loops=st.integers(1, 4), gap=st.floats(0.0, 9.0), tolerance=st.floats(0.05, 0.3))
def test_true_lines_pass(loops: int, gap: float, tolerance: float) -> None:
    problem, toolpath = print_with(
        f"process.skirt={{loops: {loops}, gap_mm: {gap:.3f}}}", f"process.corner_tolerance_mm={tolerance:.3f}"
    )
    findings = found(problem, toolpath)
    assert not failed(findings), failed(findings)
    assert AROUND in {check.name for check in findings.checks}


def moved(line: Bead, by: tuple[float, float, float]) -> Bead:
    return replace(line, points=line.points + 1e-3 * np.array(by))


def opened(line: Bead) -> Bead:
    half = slice(0, len(line.s) // 2)
    cut = {name: getattr(line, name)[half] for name in ("s", "points", "normals", "roll_zero", "width", "height")}
    return replace(line, closed=False, **cut)


SPOILT: dict[str, Callable[[list[Bead]], list[Bead]]] = {
    "aside": lambda lines: [moved(line, (0.5, 0.0, 0.0)) for line in lines],
    "high": lambda lines: [moved(line, (0.0, 0.0, 0.3)) for line in lines],
    "one is missing": lambda lines: lines[2:],
    "one part has none": lambda lines: [line for line in lines if line.points[:, 0].max() > 0.02],
    "all are missing": lambda lines: [],
    "open": lambda lines: [opened(lines[0]), *lines[1:]],
    "leaning": lambda lines: [replace(line, normals=line.normals @ lean().T) for line in lines],
}  # fmt: skip


def lean() -> np.ndarray:
    c, s = np.cos(0.02), np.sin(0.02)
    return np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])


@pytest.mark.slow(keep=3)
@pytest.mark.parametrize("how", SPOILT)
def test_lines_that_lie_elsewhere_fail(how: str) -> None:
    problem, toolpath = print_with("process.skirt={loops: 2}")
    lines = lines_of(toolpath)
    beads = [*SPOILT[how](lines), *toolpath.beads[len(lines) :]]
    assert AROUND in failed(found(problem, replace(toolpath, beads=tuple(beads))))


def test_a_bead_of_the_print_does_not_pass_as_a_line() -> None:
    problem, toolpath = print_with("process.skirt={loops: 1}")
    count = len(lines_of(toolpath))
    renamed = replace(toolpath.beads[count], name=f"skirt {count + 1}")
    beads = (*toolpath.beads[:count], renamed, *toolpath.beads[count + 1 :])
    assert AROUND in failed(found(problem, replace(toolpath, beads=beads)))


def test_lines_that_nobody_asked_for_are_of_the_print() -> None:
    problem, _ = print_with()
    assert failed(found(problem, print_with("process.skirt={loops: 2}")[1]))


def test_around_a_curved_layer_there_is_no_bed() -> None:
    with pytest.raises(InputError, match=r"process\.skirt: the first layer is not level"):
        build_toolpath(load_problem("peer_cap", ["process.skirt={loops: 1}"]))


@pytest.mark.slow
def test_a_print_with_a_brim_and_an_order_is_verified() -> None:
    changes = ["process.skirt={loops: 2, gap_mm: 0}", 'process.speeds=[{beads: "skirt *", speed_mm_s: 20}]']
    plan = solve(load_problem("planar_gcode", changes), draft=True)
    assert plan.verified
    assert [bead.speed for bead in plan.toolpath.beads[:3]] == [0.02, 0.02, None]
