"""What a refusal advises has been planned to the end: hints that give no verified plan are not told."""

from __future__ import annotations

import pickle
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from planner.base.errors import Change, MovedBy, Refusal
from planner.planning.pipeline import load, solve
from planner.planning.tried import MOST_PLANS, MOST_SECONDS, MOST_WAYPOINTS, hints_that_hold
from planner.problem import Problem
from planner.toolpath.build import build_toolpath

CELL = """name: try
cell:
  arm: irb2600
  nozzle: {{tip_mm: [0, 0, 200], axis: [0, 0, 1], diameter_mm: 0.8}}
  home_deg: [0, 0, 0, 0, 60, 0]
  {carrier}
layers: {{source: {{waypoints: path.txt, smooth_normals_deg: {smooth}}}}}
process: {{speed_mm_s: 20, travel_speed_mm_s: 200, bead: {{width_mm: 0.8, height_mm: 0.5}}}}
"""
TABLE = "positioner: {robot: irbp_a250, origin_mm: [1100, 0, 600], free: [rotation]}"


def problem_of(
    folder: Path, *overrides: str, noise_deg: float = 0.0, carrier: str = TABLE, smooth: str = "0"
) -> Problem:
    """A line of 15 mm, its normals jittering about straight up."""
    x = np.arange(0.0, 15.01, 0.5)
    lean = np.radians(noise_deg) * np.random.default_rng(1).normal(size=(2, len(x)))
    np.savetxt(folder / "path.txt", np.column_stack([x, 0 * x, 0 * x + 0.5, *lean, np.ones(len(x))]), fmt="%.6f")
    (folder / "try.yaml").write_text(CELL.format(carrier=carrier, smooth=smooth))
    return load(folder / "try.yaml", *overrides)


class Planner:
    """In place of a planner: verified where its fields have the values that are wanted."""

    def __init__(self, wanted: Any) -> None:
        self.wanted, self.asked = wanted, []  # type: ignore[var-annotated]

    def __call__(self, problem: Problem) -> Any:
        self.asked.append(problem.overrides[-1])
        if "refused" in problem.overrides[-1]:
            raise Refusal("no way")
        return SimpleNamespace(verified=self.wanted(problem), metrics={"at_speed_fraction": 0.972})


def change(key: str, *values: str) -> Change:
    return Change(f"{key}: {values[0]} gives a path", tuple((f"{key}: {v}", ((key, v),)) for v in values))


def test_the_least_change_that_gives_a_verified_plan_is_told(tmp_path: Path) -> None:
    problem = problem_of(tmp_path)
    toolpath = build_toolpath(problem)
    nearer, lean = change("collision.nozzle_mm", "1", "0.5", "0.2"), change("process.cones.nozzle_normal_deg", "5")
    plan = Planner(lambda p: p.collision.nozzle == 0.5e-3)
    told = hints_that_hold(problem, toolpath, (nearer, lean, "turn the part"), plan)
    assert told == ("collision.nozzle_mm: 0.5 gives a verified plan, at speed on 97.2% of the length", "turn the part")
    assert plan.asked == ["collision.nozzle_mm=1", "collision.nozzle_mm=0.5", "process.cones.nozzle_normal_deg=5"]


def test_a_change_that_is_no_valid_value_or_is_refused_is_not_told(tmp_path: Path) -> None:
    problem = problem_of(tmp_path)
    hints = (change("resolve.rung_mm", "-3"), change("name", "refused"))
    assert hints_that_hold(problem, build_toolpath(problem), hints, Planner(lambda p: True)) == ()


def test_no_plan_is_begun_after_some_time(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    problem = problem_of(tmp_path)
    hours = iter([0.0, 1.0, 1.5 * MOST_SECONDS])
    monkeypatch.setattr("planner.planning.tried.time", SimpleNamespace(monotonic=lambda: next(hours)))
    hints = tuple(change("collision.nozzle_mm", value) for value in ("1", "0.5"))
    told = hints_that_hold(problem, build_toolpath(problem), hints, plan := Planner(lambda p: False))
    assert plan.asked == ["collision.nozzle_mm=1"]
    assert told == (f"{hints[1]} (not planned to the end)",)


def test_what_is_not_tried_is_said_to_be_untried(tmp_path: Path) -> None:
    problem = problem_of(tmp_path)
    toolpath = build_toolpath(problem)
    many = tuple(change("collision.nozzle_mm", str(k / 10)) for k in range(1, MOST_PLANS + 3))
    told = hints_that_hold(problem, toolpath, many, plan := Planner(lambda p: False))
    assert len(plan.asked) == MOST_PLANS
    assert told == tuple(f"{hint} (not planned to the end)" for hint in many[MOST_PLANS:])
    one: Any = {"points": np.zeros((1, 3)), "height": np.array([0.5e-3]), "width": np.array([0.8e-3]), "round": False}
    large: Any = SimpleNamespace(
        beads=[SimpleNamespace(s=np.zeros(MOST_WAYPOINTS + 1), normals=np.array([[0.0, 0.0, 1.0]]), **one)],
        waypoints=MOST_WAYPOINTS + 1,
    )
    quick = problem_of(tmp_path, smooth="1")
    assert hints_that_hold(quick, large, (many[0], "turn"), Planner(lambda p: True)) == (
        f"{many[0]} (not planned to the end)", "turn",
    )  # fmt: skip


@pytest.mark.parametrize(
    ("carrier", "field", "now"),
    [
        (TABLE, "cell.positioner.origin_mm", [1100.0, 0.0, 600.0]),
        (TABLE.replace("origin", "base"), "cell.positioner.base_mm", [1100.0, 0.0, 600.0]),
        ("bed_mm: [900, 10, 300]", "cell.bed_mm", [900.0, 10.0, 300.0]),
    ],
)
def test_a_move_is_from_where_it_stands_and_told_by_the_files_own_key(
    tmp_path: Path, carrier: str, field: str, now: list[float]
) -> None:
    problem = problem_of(tmp_path, carrier=carrier)
    told = "cell.bed_mm" if problem.cell.positioner is None else "cell.positioner.origin_mm"  # by searches
    moved = Change(f"{told}: moved gives a path", ((f"{told}: moved", ((told, MovedBy((-15.0, 0.0, 20.5))),)),))
    plan = Planner(lambda p: True)
    assert hints_that_hold(problem, build_toolpath(problem), (moved,), plan)[0].startswith(
        f"{field}: moved gives a verified"
    )
    assert plan.asked == [f"{field}={[now[0] - 15.0, now[1], now[2] + 20.5]}"]


def test_smoothing_that_is_forbidden_is_advised_where_it_helps(tmp_path: Path) -> None:
    noisy = problem_of(tmp_path, noise_deg=1.0)
    toolpath = build_toolpath(noisy)
    helps = Planner(lambda p: p.layers.source.smoothing > 0.02)  # type: ignore[union-attr]
    assert hints_that_hold(noisy, toolpath, (), helps) == (
        "layers.source.smooth_normals_deg: 3 gives a verified plan, at speed on 97.2% of the length",
    )
    assert helps.asked == ["layers.source.smooth_normals_deg=1", "layers.source.smooth_normals_deg=3"]
    assert hints_that_hold(noisy, toolpath, (), Planner(lambda p: False)) == ()
    assert any("smooth_normals_deg smooths it away" in note for note in toolpath.notes)  # told of a plan, too
    clean = problem_of(tmp_path)
    assert hints_that_hold(clean, build_toolpath(clean), (), Planner(lambda p: True)) == ()


def test_a_change_and_its_tries_go_to_another_process() -> None:
    hint = pickle.loads(pickle.dumps(change("collision.nozzle_mm", "1", "0.5")))
    assert hint == "collision.nozzle_mm: 1 gives a path"
    assert [what for what, _ in hint.tries] == ["collision.nozzle_mm: 1", "collision.nozzle_mm: 0.5"]


@pytest.mark.slow
def test_a_refusal_of_a_solve_names_a_lean_with_which_it_is_verified(tmp_path: Path) -> None:
    """A plate on the table 2.5 mm beside the line and higher than it: a nozzle on the normal touches it, a leaning one not."""
    plate = "cell.fixtures={plate: {on: part, box_mm: [60, 4, 6], centre_mm: [7, -4.2, 3]}}"
    problem = problem_of(tmp_path, plate, "cell.nozzle.profile_mm=[[0, 0.5], [4, 3], [30, 6]]")
    with pytest.raises(Refusal) as caught:
        solve(problem, baseline=False)
    (hint,) = (hint for hint in caught.value.hints if "nozzle_normal_deg" in hint)
    assert "gives a verified plan" in hint
    field, lean = hint.split()[:2]
    again = problem_of(tmp_path, *problem.overrides, f"{field.rstrip(':')}={lean}")
    assert solve(again, baseline=False).verified


@pytest.mark.slow
def test_normals_that_point_down_may_be_meant_the_other_way(tmp_path: Path) -> None:
    problem = problem_of(tmp_path, "layers.source.normals=inward")
    with pytest.raises(Refusal) as caught:
        solve(problem)
    first = caught.value.hints[0]
    assert first.startswith("layers.source.normals: outward (they mostly point down) gives a verified plan")
    upward = problem_of(tmp_path)
    assert hints_that_hold(upward, build_toolpath(upward), (), Planner(lambda _: True)) == ()
