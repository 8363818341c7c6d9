"""Clearance given up where nothing else is left: the greatest that gives a verified plan, told, and never a user's own."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from planner.base.errors import Refusal
from planner.base.progress import Stages
from planner.cell.cell import build_cell
from planner.collision.scene import NOTHING
from planner.planning import context
from planner.planning.clearance import coming_nearer, leads_on, may_come_nearer
from planner.planning.context import context_of
from planner.planning.files import write
from planner.planning.pipeline import load, solve
from planner.problem import Problem
from planner.resolve.drawn import passable
from planner.resolve.joint_path import refuse_at
from planner.resolve.ladder import ladder
from planner.resolve.strategies import STRATEGIES
from planner.toolpath.build import build_toolpath
from planner.verify.verdict import verify

# A rim of 12 mm that stands so far above the tip: on a flat first layer it cannot be farther from what is printed.
RIM = "cell.nozzle.profile_mm=[[0, 0.4], [0.5, 0.8], [{0}, 12], [30, 12]]"


def flat(folder: Path, *overrides: str) -> Problem:
    """Two passes of 6 mm side by side on a turning table."""
    rows = [f"{x / 2} {y} 0.5 0 0 1 {k}" for k, y in enumerate((0.0, 0.8)) for x in range(-6, 7)[:: 1 - 2 * k]]
    (folder / "flat.txt").write_text("x y z nx ny nz bead\n" + "\n".join(rows) + "\n")
    text = """name: flat
cell:
  arm: irb2600
  nozzle: {tip_mm: [0, 0, 200], axis: [0, 0, 1], diameter_mm: 0.8}
  home_deg: [0, 0, 0, 0, 60, 0]
  positioner: {robot: irbp_a250, origin_mm: [1100, 0, 600], free: [rotation]}
layers: {source: {waypoints: flat.txt}}
process: {speed_mm_s: 20, travel_speed_mm_s: 200, bead: {width_mm: 0.8, height_mm: 0.5}}
"""
    (folder / "flat.yaml").write_text(text)
    return load(folder / "flat.yaml", *overrides)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("changed", "kept"),
    [(RIM.format(0.9), [0.5, 0.2, 0.0]), ("cell.positioner.origin_mm=[4000, 0, 600]", [])],
    ids=["a rim", "out of reach"],
)
def test_only_distances_at_which_there_is_a_way_are_planned(tmp_path: Path, changed: str, kept: list[float]) -> None:
    problem = flat(tmp_path, changed)
    given = context_of(problem, build_cell(problem), build_toolpath(problem))
    found = list(coming_nearer(given, "of a rim", Stages()))
    assert [told.kept * 1e3 for told, _ in found] == pytest.approx(kept)
    for told, nearer in found:
        assert nearer.problem.collision.nozzle == told.kept
        assert told.usual == problem.collision.nozzle == 2e-3
        assert nearer.toolpath is given.toolpath
        own = context_of(nearer.problem, given.cell, given.toolpath)
        anew = ladder(own.cell, own.tasks, own.problem.resolve, own.obstacles)
        assert all((known.q == path.q).all() for known, path in zip(nearer.start, anew, strict=True))


def test_a_distance_of_ones_own_is_kept(tmp_path: Path) -> None:
    assert may_come_nearer(flat(tmp_path))
    assert may_come_nearer(flat(tmp_path, "collision.arm_mm=4"))
    assert not may_come_nearer(flat(tmp_path, "collision.nozzle_mm=2"))


@pytest.mark.slow
def test_the_plan_says_what_is_kept_and_is_judged_by_it(tmp_path: Path) -> None:
    plan = solve(flat(tmp_path, RIM.format(0.9)), baseline=False)
    assert plan.verified
    assert plan.nearer is not None
    assert (plan.nearer.kept, plan.nearer.usual) == (0.5e-3, 2e-3)
    assert "lacks" in plan.nearer.because
    assert plan.problem.collision.nozzle == 0.5e-3
    (note,) = plan.toolpath.notes
    assert note.startswith("nozzle and head keep 0.5 mm from part and print instead of 2")
    assert 0.5 <= plan.metrics["nozzle_clearance_min_mm"] < 1.0
    (check,) = (check for check in plan.checks if check.name == "nozzle clear of part and print")
    assert check.limit == 0.5
    write(plan, tmp_path / "out")
    told = json.loads((tmp_path / "out" / "plan.json").read_text())
    assert told["nearer"] == {"nozzle_mm": 0.5, "usual_mm": 2.0, "because": plan.nearer.because}
    assert told["notes"] == [note]
    assert "instead of 2" in (tmp_path / "out" / "report.html").read_text()
    # the same motion does not pass where all of the clearance is asked for
    asked = flat(tmp_path, RIM.format(0.9), "collision.nozzle_mm=2")
    report = verify(asked, plan.cell, plan.toolpath, plan.trajectory)
    assert [check.name for check in report.checks if not check.ok] == ["nozzle clear of part and print"]


@pytest.mark.slow
def test_a_distance_of_ones_own_is_refused_with_the_one_that_would_do(tmp_path: Path) -> None:
    with pytest.raises(Refusal) as caught:
        solve(flat(tmp_path, RIM.format(0.9), "collision.nozzle_mm=2"), baseline=False)
    assert any(hint.startswith("collision.nozzle_mm: 0.5") for hint in caught.value.hints)


@pytest.mark.parametrize("down", [True, False])
def test_a_path_that_runs_down_its_normals_is_told(tmp_path: Path, down: bool) -> None:
    """Normals lean 40 degrees along a level path: the nozzle's face is in the bead behind it, or ahead of it above nothing."""
    problem = flat(tmp_path)
    (tmp_path / "flat.txt").write_text(
        "\n".join(f"{x / 2} 0 20.5 {-0.643 if down else 0.643} 0 0.766" for x in range(30))
    )
    given = context_of(problem, build_cell(problem), build_toolpath(problem))
    if down:
        with pytest.raises(Refusal, match=r"collision of nozzle .*; the path runs 40 deg down its own normals here"):
            ladder(given.cell, given.tasks, problem.resolve, given.obstacles)
    else:
        assert len(ladder(given.cell, given.tasks, problem.resolve, given.obstacles)) == 1


def down(folder: Path, *overrides: str) -> Problem:
    """A pass that runs 45 degrees down its own normals, and level at its end: the nozzle's face dips into what it has laid."""
    problem = flat(folder, *overrides)
    rows = [f"{x / 2} 0 {max(6 - x / 2, 1)} 0 0 1" for x in range(17)]
    (folder / "flat.txt").write_text("x y z nx ny nz\n" + "\n".join(rows) + "\n")
    return problem


@pytest.mark.slow(keep=1)
@pytest.mark.parametrize(
    "far", [[], ["cell.positioner.origin_mm=[4000, 0, 600]"]], ids=["in the print", "out of reach"]
)
def test_what_nothing_can_pass_is_refused_after_one_search(
    tmp_path: Path, far: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    searches = []

    def counted(*given: object) -> object:
        searches.append(given)
        return ladder(*given)  # type: ignore[arg-type]

    monkeypatch.setattr(context, "ladder", counted)
    monkeypatch.setitem(STRATEGIES, "ladder", counted)
    with pytest.raises(Refusal, match="lacks" if not far else "out of the arm's reach"):
        solve(down(tmp_path, *far), baseline=False)
    assert len(searches) == (3 if far else 1)  # out of reach in a run-in: with that shortened, and with all runs short


@pytest.mark.slow
def test_a_place_is_passable_where_something_drawn_there_is_clear(tmp_path: Path) -> None:
    for print_of, free in ((down, False), (flat, True)):
        problem = print_of(tmp_path)
        given = context_of(problem, build_cell(problem), build_toolpath(problem))
        task = given.tasks[0]
        middle = len(task) // 3
        with pytest.raises(Refusal) as refused:
            refuse_at(task, middle, "of a test")
        assert leads_on(given, refused.value, 0.0) is free
        # a nozzle that leans as steeply as the path descends is clear
        leaning = print_of(tmp_path, "process.cones.nozzle_normal_deg=45")
        given = context_of(leaning, build_cell(leaning), build_toolpath(leaning))
        assert leads_on(given, refused.value, 0.0)
        # what no one is near to is clear
        assert passable(given.cell, given.tasks, refused.value, NOTHING)
