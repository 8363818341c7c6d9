"""Struts and columns in space, from waypoints that lie on no surface: read, laid, planned, judged and exported."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from tempfile import mkdtemp

import numpy as np
import pytest

from benchmarks.nozzle_count import counted
from planner import Plan, solve, write
from planner.base.errors import Blocked, InputError, PlannerError
from planner.collision.print_body import print_body
from planner.export.rapid.language import differences
from planner.motion.extrusion import bead_area
from planner.problem import Problem, load_problem
from planner.problem.layers import WaypointLayersSpec
from planner.report.scene import plan_scene
from planner.toolpath.bead import Toolpath
from planner.toolpath.build import build_toolpath
from planner.toolpath.runs import with_runs
from planner.verify.material import volume_of
from planner.verify.nozzle import print_times
from planner.verify.verdict import verify

YAML = """\
name: struts
cell:
  arm: irb2600
  nozzle: {tip_mm: [0, 0, 200], axis: [0, 0, 1], diameter_mm: 0.8}
  home_deg: [0, 0, 0, 0, 60, 0]
  positioner: {robot: irbp_a250, origin_mm: [1100, 0, 600], free: [rotation]}
layers:
  source: {waypoints: struts.txt%s}
process:
  speed_mm_s: 20
  travel_speed_mm_s: 200
  bead: {width_mm: 0.8, height_mm: 0.5}
"""
DIAMETER = 2.0 * np.sqrt(0.8 * 0.5 / np.pi) * 1e-3
UP = (0.0, 0.0, 1.0)
Line = tuple[Sequence[float], Sequence[float]]

COLUMN: list[Line] = [((0, 0, 1), (0, 0, 13))]
INTO_ITSELF: list[Line] = [((0, 0, 13), (0, 0, 1))]
SLOPING: list[Line] = [((0, 0, 1), (10, 0, 11))]
CORNERS = [(0, 0), (12, 0), (12, 12), (0, 12)]
CUBE: list[Line] = [
    *(((*a, 1), (*b, 1)) for a, b in zip(CORNERS, [*CORNERS[1:], CORNERS[0]], strict=True)),
    *(((*a, 1), (*a, 13)) for a in CORNERS),
    *(((*a, 13), (*b, 13)) for a, b in zip(CORNERS, [*CORNERS[1:], CORNERS[0]], strict=True)),
]


def problem_of(folder: Path, lines: Sequence[Line], more: str = "", changes: Sequence[str] = ()) -> Problem:
    """A problem that prints straight struts [mm], the nozzle pointing down, of waypoints a millimetre apart."""
    rows = ["x y z nx ny nz bead"]
    for k, (a, b) in enumerate(lines):
        n = max(2, round(float(np.linalg.norm(np.subtract(b, a)))) + 1)
        rows += [f"{x} {y} {z} 0 0 1 {k}" for x, y, z in np.linspace(a, b, n)]
    (folder / "struts.txt").write_text("\n".join(rows), encoding="utf-8")
    (folder / "struts.yaml").write_text(YAML % more, encoding="utf-8")
    return load_problem(folder / "struts.yaml", list(changes))


@cache
def plan_of(name: str) -> Plan:
    """The plan of one of the prints above, made once."""
    lines = {"column": COLUMN, "sloping": SLOPING, "cube": CUBE}[name]
    more = ", kind: spatial" if name == "sloping" else ""  # which could be on a surface
    return solve(problem_of(Path(mkdtemp()), lines, more), "ladder", baseline=False)


def test_what_runs_along_its_axis_is_taken_for_struts_and_told(tmp_path: Path) -> None:
    toolpath = build_toolpath(problem_of(tmp_path, COLUMN))
    (bead,) = toolpath.beads
    assert bead.round
    assert bead.width == pytest.approx(DIAMETER) and bead.height == pytest.approx(DIAMETER)
    (note,) = toolpath.notes
    assert "struts in space, since path 1 runs along its normals" in note and "(line 2)" in note


def test_what_contradicts_every_surface_is_taken_for_struts_unless_it_is_to_be_one(tmp_path: Path) -> None:
    lines: list[Line] = [((0, 0, 5), (20, 0, 5)), ((0, 5, 4.2), (20, -5, 4.2))]
    assert all(bead.round for bead in build_toolpath(problem_of(tmp_path, lines)).beads)
    with pytest.raises(InputError, match=r"what another pass lies on.*layers.source.kind: spatial"):
        build_toolpath(problem_of(tmp_path, lines, ", kind: surface"))


def test_a_surface_stays_one_unless_it_is_to_be_struts(tmp_path: Path) -> None:
    level: list[Line] = [((0, 0, 1), (20, 0, 1))]
    toolpath = build_toolpath(problem_of(tmp_path, level))
    assert not toolpath.beads[0].round and not toolpath.notes
    toolpath = build_toolpath(problem_of(tmp_path, level, ", kind: spatial"))
    assert toolpath.beads[0].round and not toolpath.notes


def test_a_strut_holds_as_much_as_a_usual_bead_however_it_is_counted(tmp_path: Path) -> None:
    for section, area in (("rectangle", 0.4), ("rounded", 0.3 * 0.5 + np.pi / 4 * 0.5**2)):
        problem = problem_of(tmp_path, SLOPING, ", kind: spatial", [f"process.bead.section={section}"])
        (bead,) = build_toolpath(problem).beads
        assert bead_area(bead, problem.process) == pytest.approx(area * 1e-6)
        assert volume_of(bead, problem.process).total == pytest.approx(area * 1e-6 * np.sqrt(200.0) * 1e-3)


@pytest.mark.parametrize("lines", [COLUMN, SLOPING], ids=["column", "sloping"])
def test_a_strut_is_a_capsule_that_ends_at_the_tip(tmp_path: Path, lines: list[Line]) -> None:
    toolpath = build_toolpath(problem_of(tmp_path, lines, ", kind: spatial"))
    body = print_body(toolpath)
    assert set(body.names) == {"bead 0"}
    a, b = (np.array(end) * 1e-3 for end in lines[0])
    tree, half = body.tree, 0.5 * DIAMETER
    down = np.array([0.0, 0.0, half])
    share = tree.time[:, None]  # of the only bead
    assert tree.points == pytest.approx(a + share * (b - a) - down, abs=1e-6)
    # no place of the capsule's own surface is deeper than 2 % of the diameter outside the balls
    rng = np.random.default_rng(1)
    place = a + rng.uniform(0.0, 1.0, (300, 1)) * (b - a) - down
    out = rng.normal(size=(300, 3))
    out -= (out @ (b - a))[:, None] * (b - a) / ((b - a) @ (b - a))
    out *= half / np.linalg.norm(out, axis=1)[:, None]
    away = np.linalg.norm((place + out)[:, None] - tree.points, axis=2) - tree.radius
    assert away.min(axis=1).max() < 0.02 * DIAMETER
    # half-way nothing is there above the tip
    laid = tree.points[tree.time < 0.5]
    assert laid[:, 2].max() + half <= 0.5 * (a + b)[2] + 1e-9


def test_distances_are_those_of_cores(tmp_path: Path) -> None:
    toolpath = build_toolpath(problem_of(tmp_path, [COLUMN[0], ((5, 0, 6), (0, 0, 6))], ", kind: spatial"))
    surface = toolpath.surface
    points = np.array([[2e-3, 0.0, 5e-3], [0.0, 0.0, 13e-3], [0.0, 0.0, 6e-3]])
    assert surface.before(0).signed_distance(points) == pytest.approx(50e-3)
    expected = np.array([2e-3, 0.5 * DIAMETER, 0.0]) - 0.25 * DIAMETER
    assert surface.before(1).signed_distance(points) == pytest.approx(expected, abs=4e-5)
    assert surface.normals(points) == pytest.approx(np.tile(UP, (3, 1)))
    assert surface.normals_on(1, np.array([1e-3]), points[:1]) == pytest.approx(np.array([UP]))


def test_no_run_leads_down_from_a_strut(tmp_path: Path) -> None:
    lines = [COLUMN[0], SLOPING[0], ((0, 0, 9), (10, 0, 9)), ((0, 0, 9), (10, 0, 6))]
    toolpath = build_toolpath(problem_of(tmp_path, lines, ", kind: spatial"))
    runs = [with_runs(bead, 8e-3) for bead in toolpath.beads]
    for bead, run, before, after in zip(toolpath.beads, runs, (0, 0, 1, 1), (1, 1, 1, 0), strict=True):
        assert (run.first > 0) == bool(before) and (run.last < len(run.points) - 1) == bool(after)
        outside = np.concatenate([run.points[: run.first], run.points[run.last + 1 :]])
        assert outside[:, 2].min() > bead.points[:, 2].min() - 1e-9
        assert (np.diff(run.s) > 0.0).all()


@pytest.mark.slow
@pytest.mark.parametrize("name", ["column", "sloping", "cube"])
def test_columns_slopes_and_a_lattice_are_planned_and_verified(name: str) -> None:
    plan = plan_of(name)
    assert plan.verified, plan.checks
    # an independent count: no place of what is laid is in the cone of the nozzle, whose flank is 60 degrees steep
    t, toolpath = plan.trajectory, plan.toolpath
    body = print_body(toolpath)
    now = print_times(toolpath, t)
    for k in np.flatnonzero(t.deposit)[::7]:
        there = body.tree.time < now[k]
        way = body.tree.points[there] - t.tip[k]
        up = -(way @ t.axis[k])
        aside = np.sqrt(np.maximum((way**2).sum(axis=1) - up**2, 0.0))
        inside = (up > body.tree.radius[there]) & (up < 5e-3) & (aside < 0.8e-3 + up * np.tan(np.radians(30.0)))
        assert not inside.any()


@pytest.mark.slow
def test_a_strut_that_is_drawn_into_itself_is_refused_by_its_place(tmp_path: Path) -> None:
    problem = problem_of(tmp_path, INTO_ITSELF)
    with pytest.raises(
        PlannerError, match=r"runs 90 deg down its own normals here.*dips into what it has just laid.*point"
    ):
        solve(problem, "ladder", baseline=False)


@pytest.mark.slow
@pytest.mark.parametrize(("down_mm", "helps"), [(7, True), (10, False)])
def test_a_lean_is_advised_where_it_gives_a_verified_plan(tmp_path: Path, down_mm: float, helps: bool) -> None:
    """A strut that goes down along 9 mm by so much: a nozzle that leans by 20 degrees at most clears the first of these."""
    with pytest.raises(Blocked) as caught:
        solve(problem_of(tmp_path, [((0, 0, 1 + down_mm), (9, 0, 1))], ", kind: spatial"), baseline=False)
    lean = [hint for hint in caught.value.hints if hint.startswith("process.cones.nozzle_normal_deg: ")]
    assert all("gives a verified plan" in hint for hint in lean)
    assert len(lean) == helps
    assert caught.value.hints[-1].startswith("a slimmer nozzle")


@pytest.mark.slow
def test_a_plan_that_lays_its_column_downwards_fails() -> None:
    """What rises and is recorded as falling: the nozzle is in what counts as laid above it."""
    plan = plan_of("column")
    turned = [
        replace(bead, points=bead.points[::-1], s=bead.length - bead.s[::-1], source=bead.source[::-1])
        for bead in plan.toolpath.beads
    ]
    body = print_body(Toolpath(tuple(turned), plan.toolpath.surface))
    report = verify(plan.problem, plan.cell, plan.toolpath, plan.trajectory, body=body)
    failed = [check.name for check in report.checks if not check.ok]
    assert failed == ["nozzle clear of part and print"]
    t = plan.trajectory
    aside = replace(t, q=t.q + np.where(t.deposit, 2e-3, 0.0)[:, None])
    names = {check.name for check in verify(plan.problem, plan.cell, plan.toolpath, aside).checks if not check.ok}
    assert {"tip on the path", "axis on the normal"} <= names


@pytest.mark.slow
def test_programs_are_read_back_and_played_and_the_report_draws_struts(tmp_path: Path) -> None:
    plan = write(plan_of("cube"), tmp_path / "out")
    files = {path.name: path.read_text(encoding="utf-8") for path in (tmp_path / "out").glob("*.mod")}
    assert files and differences(plan, files) == []
    scene = plan_scene(plan, [])
    wide = scene["lines"]["wide"]
    assert scene["lines"]["round"] and wide["low"] + wide["step"] * wide["steps"] == pytest.approx(DIAMETER)
    page = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert "lines.round" in page
    told = json.loads((tmp_path / "out" / "plan.json").read_text(encoding="utf-8"))
    assert told["metrics"]["beads"] == len(CUBE)


@pytest.mark.parametrize(("lines", "said"), [(COLUMN, "clear everywhere"), (INTO_ITSELF, "lacks")], ids=["up", "down"])
def test_the_count_without_a_planner_agrees(tmp_path: Path, lines: list[Line], said: str) -> None:
    problem = problem_of(tmp_path, lines)
    assert isinstance(problem.layers, WaypointLayersSpec)
    assert counted(problem, problem.layers.source).startswith(said)
