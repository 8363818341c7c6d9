"""One print shared by processes: chains of beads are refined apart, and the plan is the same bit for bit."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from solved import small_problem, write_small

from planner.base.distribution import crew
from planner.base.errors import InputError
from planner.cell.cell import build_cell
from planner.planning import distributed as chains
from planner.planning.context import context_elsewhere, digest_of, found_anywhere
from planner.planning.distributed import pieces_of
from planner.planning.pipeline import load, solve
from planner.resolve.joint_path import JointPath
from planner.toolpath.build import build_toolpath
from planner.toolpath.task import NozzleTask, tasks_of


def test_pieces_are_whole_chains(tasks: Sequence[NozzleTask], monkeypatch: pytest.MonkeyPatch) -> None:
    """Six beads, three names in two layers: chains stay whole and in order; short ones go together."""
    paths = [JointPath(task, *3 * (np.zeros(0),), 0) for task in tasks]
    for least, count in ((1, 3), (10**9, 1)):
        monkeypatch.setattr(chains, "LEAST", least)
        pieces = pieces_of(paths)
        assert len(pieces) == count and sorted(i for piece in pieces for i in piece) == list(range(6))
        assert all(piece == sorted(piece) for piece in pieces)
        for piece in pieces:
            names = {tasks[i].name for i in piece}
            assert piece == [i for i, task in enumerate(tasks) if task.name in names]


@pytest.mark.slow
def test_a_shared_print_is_the_print(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Pieces know the problem by its file alone; whatever order they come back in."""
    monkeypatch.setattr(chains, "LEAST", 1)
    problem, pieces = load(write_small(tmp_path)), []

    def backwards(function: Callable[[Any], Any], items: Sequence[Any]) -> Iterator[tuple[int, Any]]:
        pieces.extend(items)
        with crew() as over:
            yield from sorted(over(function, items), key=lambda pair: -pair[0])

    plan = solve(problem, "sqp", over=backwards, baseline=False)
    alone = solve(problem, "sqp", baseline=False)
    assert pieces and not any(isinstance(each, JointPath) for piece in pieces for each in piece[-1])
    assert plan.metrics == alone.metrics and plan.checks == alone.checks
    for name, values in vars(plan.trajectory).items():
        np.testing.assert_array_equal(values, getattr(alone.trajectory, name), err_msg=name)


@pytest.mark.parametrize(
    "change",
    [
        ("radius_mm: 34", "radius_mm: 33"),
        ("tip_mm: [-44.51, 9.9, 113.95]", "tip_mm: [-44.51, 9.9, 114]"),
        ("resolve: {", "collision: {nozzle_mm: 1}\nresolve: {weights: {joint_limits: 2}, "),
        ("part:", "  limits: {joint_1: {acceleration_rad_s2: 9}}\npart:"),
        ("bead: {width_mm: 0.6", "bead: {width_mm: 0.62"),
    ],
    ids=["part", "nozzle", "settings", "limits", "beads"],
)
def test_a_file_that_is_another_one_elsewhere_is_told(tmp_path: Path, change: tuple[str, str]) -> None:
    problem = small_problem()
    cell, toolpath = build_cell(problem), build_toolpath(problem)
    tasks = tasks_of(problem, toolpath)
    digest = digest_of(problem, cell, toolpath, tasks)
    file = write_small(tmp_path, change)
    with pytest.raises(InputError, match=r"small\.yaml.* differs on a worker"):
        context_elsewhere(str(file), (), digest)
    assert digest != digest_of(problem, cell, toolpath, [replace(tasks[0], tip=tasks[0].tip + 1e-9), *tasks[1:]])


def test_a_linked_problem_is_named_by_its_link(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Paths in it count from there."""
    link = tmp_path / "here" / "linked.yaml"
    link.parent.mkdir()
    link.symlink_to(write_small(tmp_path / "there"))
    monkeypatch.chdir(link.parent)
    assert found_anywhere(load("linked.yaml")) == str(link)
    assert found_anywhere(load("peer_cap")) == "peer_cap"
