"""Prints that need a nozzle that leans: searched about leans where an upright nozzle has no way, and advised where it may not."""

from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np
import pytest

from planner.base.errors import Refusal
from planner.base.geometry import angles_between
from planner.base.progress import Stages
from planner.cell.cell import build_cell
from planner.planning import pipeline
from planner.planning.context import PlanningContext, context_of
from planner.planning.leaning import SHARE, best_leans, cheapest_leans, leaned_tasks, leaning
from planner.planning.pipeline import load, solve
from planner.planning.tried import other_places
from planner.problem import Problem
from planner.resolve.joint_path import flange_poses
from planner.resolve.ladder import ladder
from planner.toolpath.bead import Toolpath
from planner.toolpath.build import build_toolpath
from planner.toolpath.finer import sampled_finer

# The tip stands on the flange's axis: with the nozzle upright joint 5 has one angle at each place of a line away from the
# arm, up to 46.4 degrees in its middle, whatever the roll.
PROBLEM = """name: line
cell:
  arm: irb2600
  nozzle: {tip_mm: [0, 0, 200], axis: [0, 0, 1], diameter_mm: 0.8}
  home_deg: [0, 0, 0, 0, 40, 0]
  bed_mm: [1000, 0, 300]
  limits: {joint_5: {range_deg: [-46, 46]}}
layers: {source: {waypoints: path.txt}}
process: {speed_mm_s: 20, travel_speed_mm_s: 200, bead: {width_mm: 0.8, height_mm: 0.5}, run_in_mm: 3}
"""
LEAN = "process.cones.nozzle_normal_deg"


def problem_of(folder: Path, *overrides: str) -> Problem:
    x = np.arange(-150.0, 150.01, 5.0)
    np.savetxt(folder / "path.txt", np.column_stack([x, 0 * x, 0 * x + 0.5, 0 * x, 0 * x, 0 * x + 1.0]), fmt="%.4f")
    (folder / "line.yaml").write_text(PROBLEM)
    return load(folder / "line.yaml", *overrides)


def context(problem: Problem) -> PlanningContext:
    return context_of(problem, build_cell(problem), build_toolpath(problem))


@pytest.mark.slow
@pytest.mark.parametrize("lean", [5.0, 20.0])
def test_what_an_upright_nozzle_cannot_print_is_printed_with_one_that_leans(tmp_path: Path, lean: float) -> None:
    problem = problem_of(tmp_path, f"{LEAN}={lean:g}")
    given = context(problem)
    with pytest.raises(Refusal, match="nearest one exceeds that of joint_5"):
        ladder(given.cell, given.tasks, problem.resolve, given.obstacles)
    plan = solve(problem, baseline=False)
    assert plan.verified
    assert plan.metrics["at_speed_fraction"] > 0.99
    (note,) = (note for note in plan.toolpath.notes if "leans" in note)
    assert note.startswith("the nozzle leans within its cone, as there is no plan with it upright: bead 0, waypoint")
    (check,) = (check for check in plan.checks if check.name == "axis near the file's normals")
    assert 1.0 < check.worst <= check.limit == lean


@pytest.mark.slow
def test_a_nozzle_that_leans_leans_on_finer_samples_too(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """An upright one has no way there either."""
    problem = problem_of(tmp_path, f"{LEAN}=10")
    n = len(build_toolpath(problem).beads[0].s)
    asked: list[PlanningContext] = []

    def once(given: PlanningContext, *_: object) -> PlanningContext | None:
        asked.append(given)
        return given.along(sampled_finer(given.toolpath, {0: np.array([0.15])})) if len(asked) == 1 else None

    monkeypatch.setattr(pipeline, "with_finer_samples", once)
    plan = solve(problem, baseline=False, draft=True)
    assert plan.verified and len(plan.toolpath.beads[0].s) > n
    assert len(asked) == 2 and all(given.leans and given.draft for given in asked)


@pytest.mark.slow
def test_a_refusal_advises_the_lean_and_shows_the_posture(tmp_path: Path) -> None:
    problem = problem_of(tmp_path)
    with pytest.raises(Refusal) as caught:
        solve(problem, baseline=False)
    told = f"{LEAN}: 5 gives a verified plan, at speed on 100.0% of the length"
    assert told in caught.value.hints
    posture, point = np.array(caught.value.posture), np.array(caught.value.point_mm) * 1e-3
    cell = build_cell(problem)
    tip = (cell.T_world_base @ cell.arm.poses(posture[None])[0])[:3, 3]
    np.testing.assert_allclose(tip, point + [1.0, 0.0, 0.3], atol=1e-6)
    beyond = np.maximum(posture - cell.limits.q_max, cell.limits.q_min - posture)
    assert 0.0 < np.degrees(beyond[4]) < 0.05
    assert (np.delete(beyond, 4) < 0.0).all()


@pytest.mark.slow
def test_the_default_is_offered_where_another_strategy_has_no_way(tmp_path: Path) -> None:
    with pytest.raises(Refusal) as caught:
        solve(problem_of(tmp_path, f"{LEAN}=5"), "ladder", baseline=False)
    assert caught.value.hints[0] == "strategy: sqp gives a verified plan, at speed on 100.0% of the length"


def test_the_search_for_other_places_is_named_as_it_can_be_typed(tmp_path: Path) -> None:
    problem = problem_of(tmp_path, f"{LEAN}=5")
    (hint,) = other_places(problem)
    assert hint.startswith(f"python -m planner.place {problem.file} --set {LEAN}=5 looks for a place")
    points = np.column_stack([np.linspace(0.0, 0.1, 30), np.zeros((30, 2))])
    assert other_places(load(problem, toolpath=Toolpath.from_arrays(points, [0.0, 0.0, 1.0]))) == ()


def test_nothing_leans_that_may_not_or_has_no_posture(tmp_path: Path) -> None:
    refusal = Refusal("none")
    assert leaning(context(problem_of(tmp_path)), refusal, Stages()) is None
    too_little = problem_of(
        tmp_path, f"{LEAN}=5", "cell.limits={joint_5: {range_deg: [-37, 37]}}", "cell.home_deg=[0, 0, 0, 0, 30, 0]"
    )
    assert best_leans(context(too_little)) is None
    assert leaning(context(too_little), refusal, Stages()) is None


def test_leaned_tasks_stay_within_the_cone_and_stand_on_the_same_places(tmp_path: Path) -> None:
    given = context(problem_of(tmp_path, f"{LEAN}=10"))
    tilts = best_leans(given)
    assert tilts is not None
    for task, tilt, leaned in zip(given.tasks, tilts, leaned_tasks(given.tasks, tilts), strict=True):
        size = np.linalg.norm(tilt, axis=1)
        assert size.max() <= np.radians(SHARE * 10.0) + 1e-12
        np.testing.assert_allclose(angles_between(-leaned.frames[:, :, 2], task.normals), size, atol=1e-7)
        np.testing.assert_allclose(np.linalg.det(leaned.frames), 1.0, atol=1e-12)
        np.testing.assert_array_equal(leaned.normals, task.normals)
        still = np.zeros((len(task), 0))
        zero = np.zeros(len(task))
        there = flange_poses(given.cell, leaned, zero, np.zeros((len(task), 2)), still) @ given.cell.T_flange_nozzle
        np.testing.assert_allclose((given.cell.T_world_base @ there)[:, :3, 3] - [1.0, 0.0, 0.3], task.tip, atol=1e-12)


def test_leans_against_brute_force() -> None:
    rng = np.random.default_rng(0)
    tilts = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
    for _ in range(50):
        price = np.where(rng.random((5, 3, 2)) < 0.4, np.inf, rng.random((5, 3, 2)))

        def cost(way: tuple[int, ...], branch: int, price: np.ndarray = price) -> float:
            own = sum(price[i, k, branch] + 0.02 * np.linalg.norm(tilts[k]) for i, k in enumerate(way))
            steps = zip(way[:-1], way[1:], strict=True)
            return float(own + 0.5 * sum(((tilts[a] - tilts[b]) ** 2).sum() for a, b in steps))

        ways = [*itertools.product(range(3), repeat=5)]
        least = min(cost(way, branch) for way in ways for branch in range(2))
        found = cheapest_leans(price, tilts)
        if found is None:
            assert np.isinf(least)
        else:
            assert min(cost(tuple(found), branch) for branch in range(2)) == pytest.approx(least)
