"""What `from planner import …` gives, and the arrays of a Plan."""

from __future__ import annotations

import csv
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import export_fixtures
import numpy as np
import pytest
from solved import small_plan, small_problem, write_small

import planner
from planner.base.errors import InputError, OutputError
from planner.export.tables import FIXED
from planner.plan import Plan
from planner.plan.plan import columns_of
from planner.plan.seal import sealed
from planner.planning.files import write
from planner.planning.pipeline import load, solve
from planner.problem import Problem
from planner.resolve.strategies import STRATEGIES


def test_public_names_are_what_they_say() -> None:
    assert planner.__all__ == [
        "STRATEGIES", "Cell", "JointPath", "NozzleTask", "OwnStrategy", "OwnTerm", "PathSamples", "Plan", "Problem", "SamplePrice",
        "Solved", "Toolpath", "add_robot", "check_term", "joint_paths", "load", "plots", "random_samples", "register_strategy",
        "show", "solve", "solve_all", "write",
    ]  # fmt: skip
    assert set(planner.__all__) <= set(dir(planner))
    assert planner.solve is solve and solve.__module__ == "planner.planning.pipeline"
    assert {"as_published", "ladder", "sqp"} <= set(STRATEGIES)
    with pytest.raises(AttributeError, match="no attribute 'slove'"):
        _ = planner.slove


def test_importing_the_package_is_quick() -> None:
    """Nothing heavy comes with the package's own name: each command imports it first."""
    code = "import sys, planner; sys.exit(bool({'numpy', 'numba', 'pydantic', 'planner.planning.pipeline'} & set(sys.modules)))"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_the_package_is_typed() -> None:
    assert (Path(planner.__file__).parent / "py.typed").read_text() == ""


def test_load_takes_a_name_or_a_path_and_overrides(tmp_path: Path) -> None:
    logo = load("cylinder_logo", "layers.count=1", "process.speed_mm_s=30")
    assert isinstance(logo, Problem) and logo.process.speed == pytest.approx(0.030)
    assert logo.overrides == ("layers.count=1", "process.speed_mm_s=30")
    assert load(write_small(tmp_path)).name == load(str(tmp_path / "small.yaml")).name == "small"
    with pytest.raises(InputError, match="did you mean cylinder_logo"):
        load("cylinder_logos")
    with pytest.raises(InputError, match=r"--set layers\.cuont"):
        load("cylinder_logo", "layers.cuont=1")


def test_solve_takes_what_load_takes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[str] = []

    def stop(problem: Problem) -> None:
        seen.append(problem.name)
        raise InputError("far enough")

    monkeypatch.setattr("planner.planning.pipeline.build_cell", stop)
    for problem in (small_problem(), write_small(tmp_path), str(tmp_path / "small.yaml")):
        with pytest.raises(InputError, match="far enough"):
            solve(problem)
    assert seen == ["small"] * 3


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"strategy": "laddre"}, "no strategy 'laddre' (did you mean ladder?)"),
        ({"strategy": "%"}, "strategies: as_published"),
        ({"dt": 0.0}, "dt: 0.0 is not a time between 0.0005 and 0.02 s"),
        ({"dt": float("nan")}, "dt: nan is not a time"),
        ({"tolerance": "2 furlongs"}, "tolerance: '2 furlongs' is not a tolerance"),
    ],
)
def test_wrong_arguments_are_said(wrong: dict[str, float | str], message: str) -> None:
    with pytest.raises(InputError) as error:
        solve(small_problem(), **wrong)
    assert message in str(error.value)


def test_arrays_of_a_plan_are_those_of_its_trajectory_and_read_only() -> None:
    plan = small_plan()
    n = len(plan.trajectory)
    assert plan.q.shape == (n, len(plan.joint_names)) and plan.tip.shape == plan.axis.shape == (n, 3)
    for name in ("t", "q", "tip", "axis", "speed", "bead", "deposit", "s"):
        array = getattr(plan, name)
        assert array is getattr(plan.trajectory, name) and len(array) == n
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 0
    np.testing.assert_allclose(plan.cell.T_part_nozzle(plan.q[:5])[:, :3, 3], plan.tip[:5], atol=1e-9)


def test_the_table_has_the_columns_and_the_numbers_of_the_file(tmp_path: Path) -> None:
    plan = small_plan()
    table = plan.table()
    write(plan, tmp_path / "out")
    with (tmp_path / "out" / "trajectory.csv").open(encoding="utf-8", newline="") as stream:
        names, *rows = list(csv.reader(stream))
    assert list(table.dtype.names or ()) == names and len(table) == len(rows)
    written = np.array(rows, dtype=float)
    own = np.column_stack([table[name].astype(float) for name in names])
    np.testing.assert_allclose(own, written, atol=1e-5, rtol=1e-11)
    assert table["deposit"].dtype == bool and table["bead"].dtype == np.int32
    assert set(table["bead"][table["deposit"]]) == {0, 1, 2}
    assert np.abs(table["x_mm"]).max() > 1.0  # millimetres, not metres


def test_the_file_rounds_exactly_the_columns_that_there_are() -> None:
    assert list(FIXED) == list(columns_of(export_fixtures.make_plan().trajectory))


def test_write_puts_all_files_in_place_or_none(tmp_path: Path) -> None:
    plan = small_plan()
    folder = tmp_path / "results"
    done = write(plan, str(folder))
    names = {path.name for path in folder.iterdir()}
    assert {"plan.json", "trajectory.csv", "report.html", "report_part.stl", "Small.mod"} <= names
    assert done.timing_s["total"] >= done.timing_s["export"] > 0.0 and "export" not in plan.timing_s
    failing = replace(plan, checks=(replace(plan.checks[0], ok=False), *plan.checks[1:]))
    write(sealed(failing), folder)
    assert {path.name for path in folder.iterdir()} == {
        "plan.json",
        "trajectory.csv",
        "report.html",
        "report_part.stl",
        "manifest.json",
    }
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputError):
        write(plan, tmp_path / "file")


def test_a_plan_remembers_how_it_was_asked_for(tmp_path: Path) -> None:
    assert small_plan().settings == {"dt": 0.004, "overrides": []}
    assert load(write_small(tmp_path), "resolve.rung_mm=12").overrides == ("resolve.rung_mm=12",)


def test_a_plan_in_words() -> None:
    plan = small_plan()
    text = plan.summary()
    first = text.splitlines()[0]
    assert first == f"small by ladder: verified, {plan.t[-1]:.1f} s, 3 beads" and repr(plan) == f"<Plan {first}>"
    assert f"{100 * plan.metrics['at_speed_fraction']:.1f} %  of the length at the commanded speed" in text
    assert "FAILED" not in text
    wrong = replace(plan, checks=(replace(plan.checks[0], ok=False, where="bead <3>"), *plan.checks[1:]))
    assert f"FAILED {plan.checks[0].name}" in wrong.summary() and "not verified" in repr(wrong)
    html = wrong._repr_html_()
    assert "bead &lt;3&gt;" in html and html.count("<tr>") == len(wrong.summary().splitlines()) - 1
    assert isinstance(wrong, Plan)
