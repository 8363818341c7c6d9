"""A user's own strategies: how they join those of the planner, what they are given, and what they must return.

Their paths are timed, joined by travel and verified as those of any other strategy; wrong results are reported here.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike

from planner.base.arguments import as_index, as_list, as_one_of, check_callable
from planner.base.arrays import Array
from planner.base.errors import InputError
from planner.cell.cell import Cell
from planner.collision.scene import Obstacles
from planner.problem.settings import STRATEGY_NAMES, ResolveSpec
from planner.resolve.joint_path import JointPath, at_rest, choose_turns, postures
from planner.resolve.strategies import STRATEGIES
from planner.toolpath.task import NozzleTask

_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,31}")


class OwnStrategy(Protocol):
    """A way to decide what beads leave free; any function with these arguments."""

    def __call__(
        self, cell: Cell, tasks: Sequence[NozzleTask], settings: ResolveSpec, obstacles: Obstacles
    ) -> Sequence[JointPath]:
        """Joint paths of all beads.

        Args:
            cell: The robots, their kinematics and limits.
            tasks: One for each bead in print order, with its run-in and run-out: what the nozzle has to follow.
            settings: The problem's section `problem.resolve`.
            obstacles: What postures are to be clear of, see `obstacles.margins`; verification checks it in any case.

        Returns:
            A `JointPath` for each task, in order, such as `joint_paths` makes.

        Raises:
            Refusal: If there is no path.
        """
        ...


def register_strategy(name: str, strategy: OwnStrategy) -> None:
    """Register a strategy of your own for `solve(problem, strategy=name)`; it is added to STRATEGIES.

    Args:
        name: A letter, then letters, digits or _, at most 32 characters in all; a strategy of your own already
            registered by that name is replaced.
        strategy: The function, see `OwnStrategy`.

    Raises:
        InputError: If the name is invalid or one of the planner's own, or if the strategy cannot be called.
    """
    if not isinstance(name, str) or not _NAME.fullmatch(name):
        hint = "a letter, then letters, digits or _, at most 32 characters in all"
        raise InputError(f"{name!r} is not a valid strategy name", field="name", hint=hint)
    if name in STRATEGY_NAMES:
        raise InputError(f"{name} is one of the planner's own strategies", field="name", hint=f"for example my_{name}")
    check_callable(strategy, "strategy")

    def checked(
        cell: Cell, tasks: Sequence[NozzleTask], settings: ResolveSpec, obstacles: Obstacles
    ) -> tuple[JointPath, ...]:
        return _looked_at(name, strategy(cell, tasks, settings, obstacles), cell, tasks)

    STRATEGIES[name] = checked


def joint_paths(
    cell: Cell,
    tasks: Sequence[NozzleTask],
    rolls: Sequence[ArrayLike],
    tilts: Sequence[ArrayLike] | None = None,
    chosen: Sequence[ArrayLike] | None = None,
    branches: Sequence[int] | None = None,
) -> tuple[JointPath, ...]:
    """Joint paths that follow tasks exactly, for given values of what these leave free.

    Each uses the nozzle that lays its material; whole turns are chosen so that travel is short.

    Args:
        cell: The cell that a strategy is given.
        tasks: The tasks that a strategy is given.
        rolls: For each task: roll (n,) about the nozzle's axis at its samples [rad], or one value for all.
        tilts: For each task: rotation vectors (n, 2) of the axis in the task's frames [rad]; by default, the axis is
            along the normal.
        chosen: For each task: joints (n, k) that are chosen, not solved for (`cell.chosen`: a table, a rail, an elbow),
            or (k,) for all samples [rad; m for sliding joints]; by default, where they rest.
        branches: For each task: branch of the inverse kinematics; by default, that of the home posture.

    Returns:
        A path for each task, in order.

    Raises:
        Refusal: If a pose is out of reach or outside a joint's range, with the place.
        InputError: If shapes are wrong.
    """
    as_one_of(cell, Cell, "cell", "the one a strategy is given")
    tasks = as_list(tasks, "tasks", "tasks")
    for i, task in enumerate(tasks):
        as_one_of(task, NozzleTask, f"tasks[{i}]", "one that a strategy is given")
    if not tasks:
        return ()
    na, k = len(cell.arm), len(cell.chosen)
    home = int(cell.inverse.branches(cell.home[None, :na])[0])
    rolls = _for_each("rolls", rolls, tasks)
    tilts = None if tilts is None else _for_each("tilts", tilts, tasks)
    chosen = None if chosen is None else _for_each("chosen", chosen, tasks)
    branches = None if branches is None else _for_each("branches", branches, tasks)
    rest = at_rest(cell)
    asked = []
    for i, task in enumerate(tasks):  # report all that is wrong before computing anything
        n = len(task)
        roll = _broadcast(f"rolls[{i}]", rolls[i], ((n,), ()), (n,))
        tilt = np.zeros((n, 2)) if tilts is None else _broadcast(f"tilts[{i}]", tilts[i], ((n, 2),), (n, 2))
        free = _broadcast(f"chosen[{i}]", rest if chosen is None else chosen[i], ((n, k), (k,)), (n, k))
        asked.append(
            (task, roll, tilt, free, home if branches is None else _branch(cell, branches[i], f"branches[{i}]"))
        )
    paths = [
        JointPath(task, roll, tilt, postures(cell.at(task.material), task, roll, free, branch, tilt), branch)
        for task, roll, tilt, free, branch in asked
    ]
    return choose_turns(cell, paths)


def _for_each(name: str, given: object, tasks: Sequence[NozzleTask]) -> tuple[Any, ...]:
    """The values given for the tasks. Raises InputError if their number differs."""
    items = as_list(given, name, "one for each task")
    if len(items) != len(tasks):
        raise InputError(f"has {len(items)}, but there are {len(tasks)} tasks", field=name)
    return items


def _branch(cell: Cell, value: object, field: str) -> int:
    branch, most = as_index(value, field), cell.inverse.branch_count - 1
    if not 0 <= branch <= most:
        raise InputError(f"there is no branch {branch}", field=field, hint=f"0 to {most}")
    return branch


def _broadcast(name: str, value: ArrayLike, shapes: Sequence[tuple[int, ...]], to: tuple[int, ...]) -> Array:
    """Finite numbers in one of some shapes, broadcast to all samples."""
    try:
        found = np.asarray(value, dtype=float)
    except (TypeError, ValueError):
        raise InputError("must be numbers", field=name) from None
    if found.shape not in shapes:
        raise InputError(f"has shape {found.shape}", field=name, hint=" or ".join(map(str, shapes)))
    if not np.isfinite(found).all():
        raise InputError("has a number that is not finite", field=name)
    return np.ascontiguousarray(np.broadcast_to(found, to))


def _looked_at(name: str, paths: Any, cell: Cell, tasks: Sequence[NozzleTask]) -> tuple[JointPath, ...]:
    """A strategy's result, checked to be a joint path for each task; its numbers as kernels take them."""
    field = f"strategy {name}"
    if not isinstance(paths, (tuple, list)):
        raise InputError(f"returned {type(paths).__name__}", field=field, hint="a JointPath for each task, in a tuple")
    if len(paths) != len(tasks):
        raise InputError(f"returned {len(paths)} paths for {len(tasks)} tasks", field=field)
    joints = len(cell.joint_names)
    taken = []
    for i, (path, task) in enumerate(zip(paths, tasks, strict=True)):
        if not isinstance(path, JointPath):
            hint = "a JointPath, such as joint_paths makes"
            raise InputError(f"path {i} is of type {type(path).__name__}", field=field, hint=hint)
        if path.task is not task:
            raise InputError(f"path {i} does not belong to task {i}", field=field)
        found: dict[str, Any] = {"branch": _branch(cell, path.branch, f"{field}: path {i}")}
        for part, shape in (("q", (len(task), joints)), ("roll", (len(task),)), ("tilt", (len(task), 2))):
            values = getattr(path, part)
            if not isinstance(values, np.ndarray) or values.shape != shape:
                raise InputError(f"path {i}: {part} has shape {np.shape(values)}", field=field, hint=str(shape))
            if values.dtype.kind not in "fiu":
                raise InputError(f"path {i}: {part} is an array of {values.dtype}", field=field, hint="real numbers")
            if not np.isfinite(values).all():
                at = int(np.argmin(np.isfinite(values).reshape(len(values), -1).all(axis=1)))
                raise InputError(f"path {i}: {part}[{at}] is not finite", field=field)
            found[part] = np.ascontiguousarray(values, dtype=float)
        taken.append(replace(path, **found))
    return tuple(taken)
