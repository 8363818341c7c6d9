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
from planner.resolve.guides import guides_of, runs_backwards, stacks_of, zeros_apart
from planner.resolve.infeasible import stuck_at
from planner.resolve.joint_path import JointPath, sample_tasks
from planner.resolve.ladder import _corridor
from planner.resolve.nodes import full_grid
from planner.resolve.pauses import Pause
from planner.resolve.search import LadderRoute, Route
from planner.toolpath.bead import Toolpath
from planner.toolpath.task import NozzleTask, make_tasks, roll_zeros

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


def over(normals: Array, turned: bool) -> NozzleTask:
    """A line on a ball of 50 mm with these normals, roll counted from a zero that is carried along it."""
    along = normals[:: -1 if turned else 1]
    # with beads around the whole ball no axis is clear of all normals
    (zero, *_) = roll_zeros([along, np.eye(3)])
    frames = np.stack([zero, np.cross(-along, zero), -along], axis=-1)
    tip = (0.05 + HEIGHT * turned) * along
    s = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(tip, axis=0), axis=1))])
    return NozzleTask(0, "line", int(turned), tip, frames, s, 2, len(tip) - 3, 0.04)


def test_beads_that_count_from_one_axis_are_not_apart_wherever_they_lie() -> None:
    t = np.linspace(-1.0, 1.0, 200)
    normals = [
        np.column_stack([0.6 * t, 0.3 + 0.0 * t, 1.0 - 0.5 * t**2]),
        np.column_stack([0.5 - 0.0 * t, 0.7 * t, 1.0 + 0.0 * t]),
    ]
    units = [each / np.linalg.norm(each, axis=1)[:, None] for each in normals]
    one, other = (
        NozzleTask(0, "line", 0, n, np.stack([zero, np.cross(-n, zero), -n], axis=-1), t, 0, 199, 0.04)
        for n, zero in zip(units, roll_zeros(units), strict=True)
    )
    for backwards in (False, True):
        assert zeros_apart(one, other, backwards) == 0.0


def ball_line(which: str) -> Array:
    t = np.linspace(0.0, 1.0, 200)
    if which == "across an edge":
        return np.column_stack([np.sin(0.5 * np.pi * t), 0.0 * t, np.cos(0.5 * np.pi * t)])
    around = 2.0 * np.pi * t
    polar = np.radians(40.0)
    return np.column_stack(
        [np.sin(polar) * np.cos(around), np.sin(polar) * np.sin(around), np.full(200, np.cos(polar))]
    )


@pytest.mark.parametrize(
    ("which", "apart_deg"), [("across an edge", 90.0), ("a ring", 360.0 * (1.0 - np.cos(np.radians(40.0))))]
)
def test_a_layer_that_runs_back_is_searched_at_the_heading_of_the_one_below(which: str, apart_deg: float) -> None:
    """Where each bead counts roll from a zero of its own, and where both count from the same."""
    lower, upper = (over(ball_line(which), turned) for turned in (False, True))
    assert runs_backwards(upper, lower)
    assert abs(zeros_apart(upper, lower, True)) == pytest.approx(np.radians(apart_deg), abs=np.radians(1.0))
    assert zeros_apart(lower, lower, False) == 0.0
    demand, own = sample_tasks([lower], 5e-3), sample_tasks([lower, upper], 2e-3)
    grid, r = full_grid(demand, 8, np.radians(15.0), 1.0, False), len(demand.rung)
    roll = np.round(np.linspace(3.0, 7.0, r)).astype(np.int64)
    none = np.zeros(r, dtype=np.int64)
    nodes: Any = SimpleNamespace(grid=grid, scale=(0.0, 1.0))
    cell: Any = SimpleNamespace(chosen=(), holder=())
    route = LadderRoute(demand, nodes, Route(roll, none, none, 0.0))
    fine = _corridor(cell, [lower, upper], own, [lower], route, [0, 0], 3, 4, 0)

    def headings(task: NozzleTask, at: slice) -> Array:
        """Directions of the nozzle's x in the middle of the corridor."""
        frames = task.frames[np.round(own.place[at] * (len(task) - 1)).astype(int)]
        angle = (fine.roll_from[at] + 4) * fine.roll_step
        return np.cos(angle)[:, None] * frames[:, :, 0] + np.sin(angle)[:, None] * frames[:, :, 1]

    below, above = headings(lower, own.rungs_of(0)), headings(upper, own.rungs_of(1))[::-1]
    k = np.round(np.linspace(0, len(below) - 1, len(above))).astype(int)
    assert np.degrees(np.arccos(np.clip((below[k] * above).sum(axis=1), -1.0, 1.0))).max() < 15.0
