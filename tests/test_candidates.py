"""The default strategy takes a simpler one's paths where these print better, and winds along helices."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from benchmarks.random_cells import make_case
from planner.base.errors import Refusal
from planner.base.progress import Stages
from planner.cell.cell import build_cell
from planner.plan import Event
from planner.planning import context
from planner.planning.candidates import CLEAR, PlannedPaths, _best, _leaves_to_be_desired, _refined_with_held_ends
from planner.planning.pipeline import solve
from planner.problem import Problem, load_problem
from planner.resolve.joint_path import JointPath
from planner.resolve.sqp import refine_paths
from planner.resolve.strategies import STRATEGIES
from planner.toolpath.build import build_toolpath

CELL = """\
name: helix
cell:
  arm: irb2600
  nozzle: {tip_mm: [100, 0, 150], axis: [0.5, 0, 0.866], diameter_mm: 0.8}
  home_deg: [0, 0, 0, 0, 60, 0]
  positioner: {robot: irbp_a250, origin_mm: [1100, 0, 600], held_deg: {tilt: 0}, free: [rotation]}
layers:
  source: {waypoints: helix.txt}
process:
  speed_mm_s: 40
  travel_speed_mm_s: 200
  bead: {width_mm: 0.8, height_mm: 0.5}
"""


def planned(by: str, speed: float, time: float, verified: bool = True, events: tuple[Event, ...] = ()) -> PlannedPaths:
    waits = sum(event.duration for event in events)
    metrics = {"at_speed_fraction": speed, "print_time_s": time + waits, "deposition_time_s": 0.97 * time}
    report: Any = SimpleNamespace(checks=(SimpleNamespace(name="speed in deposition", ok=verified),), metrics=metrics)
    trajectory: Any = SimpleNamespace(events=events)
    return PlannedPaths(by, (), trajectory, report, ())


@pytest.mark.parametrize(
    ("plans", "best"),
    [
        ([("own", 0.95, 100.0), ("other", 0.9505, 99.5)], "own"),  # as good, about as quick
        ([("own", 0.95, 100.0), ("other", 0.9505, 95.0)], "other"),
        ([("own", 0.95, 100.0), ("other", 0.97, 105.0)], "other"),  # 1 % at speed is worth 5 % of the time
        ([("own", 0.95, 100.0), ("other", 0.94, 97.0)], "own"),
        ([("own", 0.95, 100.0), ("other", 0.94, 50.0)], "other"),
        ([("own", 0.999, 100.0), ("other", 1.0, 99.8)], "other"),  # as good in both, where the own plan is not
        ([("own", 0.93, 99.0), ("other", 1.0, 101.5), ("third", 0.9, 100.5)], "other"),
    ],
)
def test_speed_and_time_are_weighed(plans: list[tuple[str, float, float]], best: str) -> None:
    assert _best([planned(*each) for each in plans]).by == best


WAITS = (
    Event("heat", -1, 0.0, 600.0, 0.0),
    Event("purge", -1, 600.0, 10.0, 0.01),
    Event("cut", 0, 650.0, 100.0, 0.0),
    Event("pause", 1, 800.0, 3600.0, 0.0),
    Event("change", 2, 4500.0, 300.0, 0.0),
)


@pytest.mark.parametrize(
    "plans", [[("own", 0.95, 100.0), ("other", 0.9505, 95.0)], [("own", 1.0, 60.0), ("other", 1.0, 50.0)]]
)
def test_waits_that_all_plans_have_weigh_nothing(plans: list[tuple[str, float, float]]) -> None:
    assert _best([planned(*each) for each in plans]).by == "other"
    assert _best([planned(*each, events=WAITS) for each in plans]).by == "other"


def test_waits_do_not_count_as_travel() -> None:
    assert not _leaves_to_be_desired(planned("own", 1.0, 100.0, events=WAITS), 1000, 1)


def test_others_are_asked_where_something_is_left_to_be_desired() -> None:
    assert not _leaves_to_be_desired(planned("own", 1.0, 100.0), 1000, 1)
    assert _leaves_to_be_desired(planned("own", 0.99, 100.0), 1000, 1)
    assert not _leaves_to_be_desired(planned("own", 0.99, 100.0), 10_000, 1)  # 1 % is not worth so long a search
    assert _leaves_to_be_desired(planned("own", 0.98, 100.0), 10_000, 1)
    assert not _leaves_to_be_desired(planned("own", 0.98, 100.0), 100_000, 1)
    assert _leaves_to_be_desired(planned("own", 1.0, 100.0, verified=False), 100_000, 1)
    travels = planned("own", 1.0, 100.0)
    travels.report.metrics["deposition_time_s"] = 50.0
    assert _leaves_to_be_desired(travels, 1000, 1)
    assert not _leaves_to_be_desired(
        travels, 10_000, 2_000
    )  # many beads: each further plan travels between all of them


def helix(folder: Path, turns: float) -> Problem:
    """A helix up a cone of 80 mm radius that stands on a turntable."""
    angle = np.linspace(0.0, 2.0 * np.pi * turns, int(turns * 250))
    z = angle / (2.0 * np.pi) + 10.0
    r = 80.0 - 0.3 * (z - 10.0)
    n = np.column_stack([np.cos(angle), np.sin(angle), np.full(len(angle), 0.3)]) / np.hypot(1.0, 0.3)
    np.savetxt(folder / "helix.txt", np.column_stack([r * np.cos(angle), r * np.sin(angle), z, n]), fmt="%.5f")
    (folder / "helix.yaml").write_text(CELL)
    return load_problem(folder / "helix.yaml")


@pytest.mark.slow
def test_a_draft_is_the_first_verified_plan() -> None:
    """Of a print whose travel would have the other strategies asked: in the end its own plan is the best one."""
    draft, whole = solve("peer_cap", draft=True), solve("peer_cap")
    assert draft.verified
    assert draft.baseline == {} and draft.advice == () and "as_published" in whole.baseline
    assert draft.resolved_by == whole.resolved_by == "sqp"
    np.testing.assert_array_equal(draft.trajectory.q, whole.trajectory.q)


@pytest.mark.slow
def test_a_helix_of_several_turns_is_printed(tmp_path: Path) -> None:
    """A joint would leave its range if the arm went round; the table has to turn."""
    problem = helix(tmp_path, 3.0)
    plan, published = solve(problem, baseline=False), solve(problem, "as_published", baseline=False)
    assert published.verified
    assert plan.verified
    assert plan.metrics["at_speed_fraction"] >= published.metrics["at_speed_fraction"] - 1e-3
    assert plan.metrics["print_time_s"] <= 1.02 * published.metrics["print_time_s"]
    limits = plan.cell.limits
    assert np.ptp(plan.q[:, 6]) > 2.0 * np.pi
    assert (plan.q <= limits.q_max + 1e-9).all() and (plan.q >= limits.q_min - 1e-9).all()


@pytest.mark.slow
def test_ends_of_beads_are_held_where_refined_ones_would_cost_travel(tmp_path: Path) -> None:
    """Two short beads of a seven-axes arm, whose elbow is refined far from home otherwise."""
    problem = load_problem(make_case("seven_axes", 702).write(tmp_path))
    cell = build_cell(problem)
    given = context.with_way(context.context_of(problem, cell, build_toolpath(problem)), Stages())
    held = _refined_with_held_ends(given)
    free = refine_paths(cell, given.start, problem.resolve, given.obstacles, given.terms)

    def moved(paths: Sequence[JointPath]) -> float:
        both = zip(paths, given.start, strict=True)
        return max(float(np.abs(path.q[[0, -1]] - start.q[[0, -1]]).max()) for path, start in both)

    assert moved(held) < 0.3 * moved(free)


@pytest.mark.slow
def test_what_the_search_refuses_a_simpler_strategy_may_print(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Another than the search itself, which is not asked again."""

    def refuse(*_: object) -> None:
        raise Refusal("no way")

    def ask(*_: object) -> None:
        raise AssertionError("the ladder is asked again")

    monkeypatch.setattr(context, "ladder", refuse)
    monkeypatch.setitem(STRATEGIES, "ladder", ask)
    plan = solve(helix(tmp_path, 1.0), baseline=False)
    assert plan.verified
    assert plan.resolved_by.split(",")[0] in ("as_published", "fixed", "greedy")


@pytest.mark.slow
def test_a_head_that_leaning_does_not_clear_is_kept_clear_by_the_search(tmp_path: Path) -> None:
    problem = load_problem(make_case("cones", 2).write(tmp_path))
    plan = solve(problem, "sqp", baseline=False)
    assert plan.verified
    assert plan.resolved_by.startswith(CLEAR)
    with pytest.raises(
        Refusal, match=r"print head and part or print lack \d+\.\d mm of clearance where this bead ends"
    ):
        solve(problem, "ladder", baseline=False)
