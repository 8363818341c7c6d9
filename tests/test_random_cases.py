"""Random cases: the same each time, judged by what every strategy reaches, and searched by brute force."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from benchmarks import brute_force, random_cases
from benchmarks.random_cases import Outcome, Result
from benchmarks.random_cells import KINDS, flow, make_case
from planner.base.errors import EXIT_INPUT
from planner.cell.cell import build_cell
from planner.collision.scene import NOTHING
from planner.problem import Problem, load_problem
from planner.toolpath.build import build_toolpath
from planner.toolpath.task import tasks_of
from planner.verify.collision import check_start

GOOD = {"ladder": Outcome("verified", "", 0.9, 100.0), "fixed": Outcome("failed", "tip on the path", 1.0, 50.0)}
# the same line in reach, and far beyond it
LINE = """\
name: line
cell:
  arm: irb140
  nozzle: {{tip_mm: [0, 0, 100], axis: [1, 0, 1], diameter_mm: 0.6}}
  home_deg: [60, 0, 0, 0, 45, 0]
  bed_mm: [{x}, 0, 200]
layers:
  source: {{waypoints: line.txt}}
process:
  speed_mm_s: 40
  travel_speed_mm_s: 200
  bead: {{width_mm: 0.6, height_mm: 0.5}}
"""


@pytest.mark.parametrize("kind", KINDS)
def test_a_case_is_a_problem_that_begins_well(kind: str, tmp_path: Path) -> None:
    case = make_case(kind, 0)
    assert case == make_case(kind, 0) != make_case(kind, 1)
    problem = load_problem(case.write(tmp_path))
    assert problem.name == case.name == f"{kind}_0"
    check_start(problem, build_cell(problem))
    assert build_toolpath(problem).waypoints > 20


def test_values_stand_in_yaml_as_people_write_them() -> None:
    assert flow({"a": [1, 2.5], "b": {"c": "d"}}) == "{a: [1, 2.5], b: {c: d}}"


@pytest.mark.parametrize(
    ("own", "broken"),
    [
        (Outcome("verified", "", 0.8995, 101.9), []),
        (Outcome("verified", "", 0.898, 99.0), ["slower"]),
        (Outcome("verified", "", 0.95, 102.1), ["longer"]),
        (Outcome("refused", "out of reach"), ["not verified"]),
        (Outcome("crashed", "ValueError()"), ["not verified"]),
    ],
)
def test_the_default_is_held_to_the_best(own: Outcome, broken: list[str]) -> None:
    result = Result("bed", 3, {**GOOD, "sqp": own})
    assert result.broken("sqp") == broken
    assert random_cases.result_of(result.json()) == result
    assert ("BROKEN" in result.line("sqp")) == bool(broken)


def test_what_nobody_verifies_is_held_to_brute_force() -> None:
    outcomes = {"sqp": Outcome("refused", "out of reach"), "ladder": Outcome("failed", "tip on the path")}
    assert Result("bed", 3, outcomes).broken("sqp") == []
    assert Result("bed", 3, outcomes, False, "none found").broken("sqp") == []
    assert Result("bed", 3, outcomes, True, "a continuous motion").broken("sqp") == ["refused"]


def test_cases_are_dealt_to_kinds_in_turn(capsys: pytest.CaptureFixture[str]) -> None:
    assert random_cases.named([], ["bed", "cones"], 5, 3) == [("bed", 5), ("cones", 5), ("bed", 6)]
    assert random_cases.named(["helix_two_axes_12"], ["bed"], 0, 1) == [("helix_two_axes", 12)]
    assert random_cases.main(["conse_3"]) == EXIT_INPUT
    assert "cones_0" in capsys.readouterr().err


@pytest.mark.slow
def test_cases_run_once_and_are_judged(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "cases.jsonl"
    command = ["bed_1", "cones_1", "--strategies", "fixed", "--default", "ladder", "--out", str(out)]
    assert random_cases.main(command) == 0
    assert [json.loads(line)["kind"] for line in out.read_text(encoding="utf-8").splitlines()] == ["bed", "cones"]
    said = capsys.readouterr().out
    assert "bed_1: fixed" in said and "promises that ladder breaks" in said
    with out.open("a", encoding="utf-8") as stream:
        stream.write('{"kind": "bed", "num')  # torn
    assert random_cases.main(command) == 0
    assert "bed_1: fixed" not in capsys.readouterr().out
    assert random_cases.main([*command, "--default", "sqp"]) == 0  # which the file knows nothing of
    assert "bed_1: fixed" in capsys.readouterr().out
    assert random_cases.main(["bed_1", "--write", str(tmp_path / "files")]) == 0
    assert {path.name for path in (tmp_path / "files").iterdir()} == {"bed_1.txt", "bed_1.yaml"}


def line_at(x: float, folder: Path) -> Problem:
    """A straight line of 40 mm on a bed at x [mm]."""
    rows = [f"0 {y} 0 0 0 1" for y in range(-20, 21)]
    (folder / "line.txt").write_text("\n".join(rows) + "\n", encoding="utf-8")
    (folder / "line.yaml").write_text(LINE.format(x=x), encoding="utf-8")
    return load_problem(folder / "line.yaml")


def test_brute_force_finds_a_motion_where_there_is_one(tmp_path: Path) -> None:
    problem = line_at(500, tmp_path)
    found = brute_force.find_motion(problem)
    assert found and found.words.startswith("a continuous motion")
    (q,), cell = found.motion, build_cell(problem)
    tips = cell.T_part_nozzle(q)[:, :3, 3]
    assert np.abs(tips[:, 0]).max() < 1e-6
    assert tips[0, 1] < -0.02 and tips[-1, 1] > 0.02 and (np.diff(tips[:, 1]) > 0.0).all()  # its runs are followed, too
    assert np.abs(np.diff(q, axis=0)).max() < brute_force.SMALL_LEAP
    assert ((q >= cell.limits.q_min) & (q <= cell.limits.q_max)).all()
    assert all(check.ok for check in brute_force.plan_along(problem, found.motion).checks)


@pytest.mark.slow
def test_brute_force_finds_none_where_reach_ends_on_the_way(tmp_path: Path) -> None:
    problem = line_at(500, tmp_path)
    rows = [f"{x} 0 0 0 0 1" for x in range(0, 700, 2)]
    (tmp_path / "line.txt").write_text("\n".join(rows) + "\n", encoding="utf-8")
    found = brute_force.find_motion(problem)
    assert not found and 50.0 < float(found.words.split()[-2]) < 700.0


def test_brute_force_finds_none_out_of_reach(tmp_path: Path) -> None:
    found = brute_force.find_motion(line_at(1500, tmp_path))
    assert not found and found.words.startswith("none found: bead 0, up to 0.0 mm")


def test_a_rail_hides_no_singularity_from_brute_force(tmp_path: Path) -> None:
    problem = load_problem(make_case("rail", 0).write(tmp_path))
    cell = build_cell(problem)
    task = tasks_of(problem, build_toolpath(problem))[0]
    search = brute_force._Search(cell, task, NOTHING, problem.resolve.min_sigma)
    q = np.tile(cell.home, (2, 1))
    q[:, cell.rails + 4] = 0.8, 0.0  # the wrist, bent and stretched
    assert search.allowed(q).tolist() == [True, False]
