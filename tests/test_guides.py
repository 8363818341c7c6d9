"""Beads that repeat others in higher layers: which they repeat where a path was cut into pieces, and which way round."""

from __future__ import annotations

import itertools
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from planner.planning import pieces
from planner.planning.distributed import pieces_of
from planner.problem import Problem
from planner.resolve.guides import guides_of, runs_backwards, stacks_of
from planner.resolve.infeasible import stuck_at
from planner.resolve.joint_path import JointPath, sample_tasks
from planner.resolve.nodes import full_grid
from planner.resolve.pauses import Pause
from planner.toolpath.bead import Toolpath
from planner.toolpath.task import NozzleTask, make_tasks

Array = NDArray[np.float64]
STARTS = (0.0, 0.03, 0.031, 0.08, 0.2)  # m, along x, of the pieces of a layer
HEIGHT = 1e-3


def line(bead: int, name: str, layer: int, start: float, turned: bool) -> NozzleTask:
    """A level line of 25 mm along y."""
    y = np.linspace(0.0, 0.025, 40)[:: -1 if turned else 1]
    tip = np.column_stack([0.0 * y + start, y, 0.0 * y + layer * HEIGHT])
    frames = np.tile(np.diag([1.0, -1.0, -1.0]), (len(y), 1, 1))
    return NozzleTask(bead, name, layer, tip, frames, np.linspace(0.0, 0.025, len(y)), 4, 35, 0.04)


def layers(*names: str) -> list[NozzleTask]:
    """Three layers of pieces of one name, each of the other names once: every second one from its end on, backwards."""
    tasks: list[NozzleTask] = []
    for layer in range(3):
        row = [("zigzag", x) for x in STARTS] + [(name, 0.3 + 0.1 * k) for k, name in enumerate(names)]
        for name, x in row[:: -1 if layer % 2 else 1]:
            tasks.append(line(len(tasks), name, layer, x, layer % 2 == 1))
    return tasks


def test_a_piece_repeats_the_one_beneath_it() -> None:
    tasks = layers("ring")
    guides, of = guides_of(tasks)
    assert guides == tasks[: len(STARTS) + 1]
    for task, g in zip(tasks, of, strict=True):
        assert guides[g].name == task.name and guides[g].tip[0, 0] == task.tip[0, 0]
        assert runs_backwards(task, guides[g]) == (task.layer == 1)
    stacks = [sorted(i for i, g in enumerate(of) if g == k) for k in range(len(guides))]
    assert stacks_of(tasks) == stacks and all(len(stack) == 3 for stack in stacks)
    shared = pieces_of([JointPath(task, *3 * (np.zeros(0),), 0) for task in tasks])
    assert sorted(itertools.chain(*shared)) == list(range(len(tasks)))


def test_of_names_that_a_layer_has_once_the_first_is_the_guide() -> None:
    """Wherever the others lie."""
    tasks = [
        line(i, name, layer, x, False)
        for i, (name, layer, x) in enumerate(
            [("a", 0, 0.0), ("b", 0, 0.1), ("c", 1, 0.2), ("a", 1, 0.1), ("b", 2, 0.0)]
        )
    ]
    assert guides_of(tasks) == (tasks[:3], [0, 1, 2, 0, 1])


def test_what_is_tried_for_a_refusal_has_all_pieces_of_a_layer() -> None:
    tasks = layers("ring")
    demand = sample_tasks(tasks, 5e-3)
    grid = full_grid(demand, 8, 0.5, 0.5, False)
    cell: Any = None
    for at in (1, len(STARTS) + 3):
        rung = int(demand.task_rungs[at]) + 1
        stuck = stuck_at(cell, tasks, demand, grid, rung, 0.0)
        assert {(task.name, task.layer) for task in stuck.tasks} == {("zigzag", tasks[at].layer), ("ring", 0)}
        assert len(stuck.tasks) == len(STARTS) + 1
        assert stuck.demand.rung[stuck.rung] == demand.rung[rung]


def test_pieces_that_lie_on_each_other_have_one_name(
    drawing_problem: Problem, toolpath: Toolpath, tasks: tuple[NozzleTask, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Beads that pause at 30 % of their length, in layers of which the second one runs back."""

    def paused(given: object, task: NozzleTask, *rest: float) -> tuple[Pause, ...]:
        s = task.s
        return (Pause(float(s[task.first] + 0.3 * (s[task.last] - s[task.first])), ""),)

    monkeypatch.setattr(pieces, "_pauses", paused)
    given: Any = SimpleNamespace(problem=drawing_problem, tasks=tasks, toolpath=toolpath, along=lambda cut: cut)
    cut: Any = pieces.in_pieces(given, 0.0)
    assert len(cut.beads) == 2 * len(toolpath.beads)
    parts = make_tasks(cut, drawing_problem.process.speed, drawing_problem.process.run_in)
    guides, of = guides_of(parts)
    assert len(guides) == len(parts) // 2
    for task, g in zip(parts, of, strict=True):
        length, own = (float(each.s[each.last] - each.s[each.first]) for each in (guides[g], task))
        assert own == pytest.approx(length, rel=0.05)
        middle, other = (each.tip[(each.first + each.last) // 2] for each in (guides[g], task))
        assert np.linalg.norm(middle - other) < 2e-3
    assert any(runs_backwards(task, guides[g]) for task, g in zip(parts, of, strict=True))
