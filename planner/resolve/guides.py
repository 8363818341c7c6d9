"""Beads that repeat others in higher layers: which ones, which way round, and by how much their rolls differ."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.spatial import cKDTree

from planner.base.arrays import Array, Flags, Ints
from planner.toolpath.task import NozzleTask

_FEW = 5  # places along a bead that are compared to find the nearest of several others
_COMPARED = 64  # places of two beads that are compared
_ALIKE = np.radians(2.5)  # offset between zeros of roll, below which it stems from the two beads' samples
_IN_PLANE, _AHEAD = 1e-3, 0.25  # greatest y and least x of a part axis to which a frame's zero of roll points


def guides_of(tasks: Sequence[NozzleTask]) -> tuple[list[NozzleTask], list[int]]:
    """The tasks that others repeat in higher layers, and for each task which of them (index) it is or repeats.

    They are those of each name in the first layer that has it: one, or several where a path was cut into pieces. A task
    then repeats the piece that it is nearest to.
    """
    lowest: dict[str, int] = {}
    for task in tasks:
        lowest.setdefault(task.name, task.layer)
    guides: list[NozzleTask] = []
    below: dict[str, list[int]] = {}
    above: dict[str, list[int]] = {}
    of = [0] * len(tasks)
    for i, task in enumerate(tasks):
        if task.layer == lowest[task.name]:
            of[i] = len(guides)
            below.setdefault(task.name, []).append(len(guides))
            guides.append(task)
        else:
            above.setdefault(task.name, []).append(i)
    for name, those in above.items():
        own = below[name]
        which = _nearest([guides[g] for g in own], [tasks[i] for i in those]) if len(own) > 1 else [0] * len(those)
        for i, k in zip(those, which, strict=True):
            of[i] = own[k]
    return guides, of


def stacks_of(tasks: Sequence[NozzleTask]) -> list[list[int]]:
    """Indices of tasks that lie on top of each other, from the bottom up, in the order of the lowest ones."""
    guides, of = guides_of(tasks)
    stacks: list[list[int]] = [[] for _ in guides]
    for i, g in enumerate(of):
        stacks[g].append(i)
    return stacks


def _nearest(lower: Sequence[NozzleTask], tasks: Sequence[NozzleTask]) -> list[int]:
    """Index of the lower task that each task is nearest to, whichever way round they run."""
    there, here = (np.stack([_along(task, task.tip, _FEW) for task in each]) for each in (lower, tasks))
    both = np.concatenate([there, there[:, ::-1]]).reshape(2 * len(lower), -1)
    which: Ints = cKDTree(both).query(here.reshape(len(tasks), -1))[1] % len(lower)
    return which.tolist()


def _along(task: NozzleTask, values: Array, n: int) -> Array:
    """Some (n) of a task's values (samples, ...), spread over its deposit."""
    laid = values[task.first : task.last]
    return laid[np.linspace(0, len(laid) - 1, n).astype(int)]


def runs_backwards(task: NozzleTask, guide: NozzleTask) -> bool:
    """Whether a task runs its guide's bead the other way (for a loop: turns the other way)."""
    a, b = (_along(each, each.tip, _COMPARED) for each in (task, guide))
    return bool(((a - b[::-1]) ** 2).sum() < ((a - b) ** 2).sum())


def zeros_apart(task: NozzleTask, guide: NozzleTask, backwards: bool) -> float:
    """Angle [rad] to add to the guide's roll for the same heading in a task, which may run it backwards.

    0 if both count roll from the same zero. Zeros that are carried along beads without turning are at a constant angle
    to each other, see `roll_zeros`.
    """
    if (_counted_from(task) & _counted_from(guide)).any():
        return 0.0
    own, theirs = (_along(each, each.frames, _COMPARED) for each in (task, guide))
    zero = theirs[:: -1 if backwards else 1, :, 0]
    x, y = ((own[:, :, k] * zero).sum() for k in (0, 1))
    apart = float(np.arctan2(y, x))
    return apart if abs(apart) > _ALIKE else 0.0


def _counted_from(task: NozzleTask) -> Flags:
    """Which axes of the part (3) a task's zero of roll points to, all along its deposit."""
    x, y = (task.frames[task.first : task.last, :, k] for k in (0, 1))
    out: Flags = np.all(x > _AHEAD, axis=0) & np.all(np.abs(y) < _IN_PLANE, axis=0)
    return out
