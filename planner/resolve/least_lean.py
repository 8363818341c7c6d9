"""Cones about the vertical that cannot be kept: how far layer and nozzle lean at least, whatever the holder does.

The surface normal's lean from the vertical decides: it must be within the layer's cone, and within the nozzle's cone
with that about the normal added. The arm plays no part in it, so this is known before any search.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from planner.base.arrays import Array, Ints
from planner.base.compiled import njit
from planner.base.errors import InputError
from planner.base.geometry import angles_between
from planner.cell.cell import Cell
from planner.cell.kinematics.chain import Chain
from planner.problem import Problem
from planner.resolve.joint_path import least_cone
from planner.toolpath.task import Cones, NozzleTask

TOLERANCE = np.radians(0.05)  # by which verification lets an axis leave a cone
_STARTS = 96  # postures of all axes but the last, from which the search for the least lean starts
_ROUNDS = 60  # rounds of turning one axis after the other
_STILL = 1e-12  # gain in the lean's cosine below which rounds end
_ROUNDING = 0.01  # tenths of a degree that are ignored in rounding up to the next tenth
_FINE, _FINE_OF_TWO = np.radians(0.1), np.radians(1.0)  # steps of a lattice of one axis, and of two
_WIDE = np.radians(600.0)  # range of an axis that is as good as unbounded along one bead
_BEADS = 4  # beads that lean most, along which continuous motions are sought
_RUNGS = 400  # rungs of a bead, between which the lattice's angles may change
_TURN = np.radians(3.0)  # largest median turn of the normal from rung to rung: a cell has to serve for both


@dataclass(frozen=True)
class LeastLean:
    """The place where the surface normal leans most from the vertical, even with the part held as upright as possible.

    task, sample   where it is
    here           least lean there [rad], over all angles of the holder
    along          the smallest maximum lean [rad] of any continuous motion along a bead, or along some turns of it
                   where it winds round many times; the largest of the beads that lean most, never below `here`
    """

    task: NozzleTask
    sample: int
    here: float
    along: float


def check_cones(problem: Problem, cell: Cell, tasks: Sequence[NozzleTask]) -> None:
    """Raise an InputError for cones about the vertical that no angles of the holder can keep to, with the smallest half
    angles that could be kept."""
    cones = tasks[0].cones
    least = least_lean(cell, tasks, least_cone(cones) + TOLERANCE)
    if least is not None:
        raise _too_narrow(problem, cell, cones, least)


def _too_narrow(problem: Problem, cell: Cell, cones: Cones, least: LeastLean) -> InputError:
    task, i = least.task, least.sample
    where = f"bead {task.bead}, layer {task.layer + 1}, path {task.name!r}, {task.s[i] * 1e3:.1f} mm along it"
    turned = [name for name, slides in zip(cell.holder.names, cell.holder.slides, strict=True) if not slides]
    however = f"at any angle of {' and '.join(turned)}" if turned else "and nothing turns the part"
    values, fields, said = {}, [], []
    if least.along > cones.layer_gravity + TOLERANCE:
        values["layer_gravity_deg"] = least.along
    if least.here > cones.layer_gravity + TOLERANCE:
        fields.append("layer_gravity_deg")
        said.append(f"the layer leans from straight up by at least {np.degrees(least.here):.1f} deg here")
    if least.along > cones.nozzle_gravity + cones.tilt + TOLERANCE:
        values["nozzle_gravity_deg"] = least.along - cones.tilt
    if least.here > cones.nozzle_gravity + cones.tilt + TOLERANCE:
        fields.append("nozzle_gravity_deg")
        own = np.degrees(least.here - cones.tilt)
        said.append(f"the nozzle leans from straight down by at least {own:.1f} deg here")
    reason = f"{', and '.join(said)}, {however} ({where})"
    if least.along > least.here + TOLERANCE:
        reason += f"; {np.degrees(least.along - least.here):.1f} deg more elsewhere along the beads that lean most"
    rounded = {key: np.ceil(np.degrees(value) * 10.0 - _ROUNDING) / 10.0 for key, value in values.items()}
    hint = "the smallest that can be kept: process.cones: {"
    hint += ", ".join(f"{key}: {value:.1f}" for key, value in rounded.items()) + "}"
    if not set(cell.holder_robot.joint_names if cell.holder_robot else ()) <= set(cell.holder.names):
        hint += "; or more axes in cell.positioner.free"
    return problem.error(f"process.cones.{fields[0]}", reason, hint)


def least_lean(cell: Cell, tasks: Sequence[NozzleTask], enough: float) -> LeastLean | None:
    """Where beads lean most, even with the part held as upright as possible; None if never beyond `enough` [rad].

    Continuous motions are sought along the few beads that lean most.
    """
    if enough >= np.pi:
        return None
    na = len(cell.arm)
    low, high = cell.limits.q_min[na:], cell.limits.q_max[na:]
    ends = np.cumsum([task.last + 1 - task.first for task in tasks])
    leans = np.split(
        least_leans(cell.holder, low, high, np.concatenate([_laid(task) for task in tasks]), enough), ends[:-1]
    )
    most = np.array([lean.max() for lean in leans])
    worst = int(np.argmax(most))
    i, here = int(np.argmax(leans[worst])), float(most[worst])
    if here <= enough:
        return None
    looked = [k for k in np.argsort(-most)[:_BEADS] if most[k] > enough]
    along = max(least_along(cell.holder, low, high, _laid(tasks[k])) for k in looked)
    return LeastLean(tasks[worst], tasks[worst].first + i, here, max(along, here))


def _laid(task: NozzleTask) -> Array:
    """Normals (n, 3) where material is laid."""
    return task.normals[task.first : task.last + 1]


def least_leans(holder: Chain, low: Array, high: Array, normals: Array, enough: float = 0.0) -> Array:
    """Least angles (n) [rad] of the part's unit normals (n, 3) from the vertical, in the holder's ranges (nh).

    A normal found within `enough` is not pursued further. In the angle of a single axis, the cosine of the lean is a
    cosine plus a constant: starting from many postures, axes are turned one after the other to where it is greatest,
    until that gains nothing.
    """
    axes = np.flatnonzero(~holder.slides)
    starts = np.zeros((1, len(holder)))
    if len(axes) > 1:
        drawn = np.random.default_rng(0).random((_STARTS, len(axes) - 1))
        starts = np.zeros((_STARTS, len(holder)))
        a, b = _once_round(low[axes[:-1]], high[axes[:-1]])
        starts[:, axes[:-1]] = a + drawn * (b - a)
    best = np.full(len(normals), -1.0)
    most = np.full((len(normals), len(holder)), 0.0)
    open_ = np.arange(len(normals))
    for start in starts:
        q = np.tile(start, (len(open_), 1))
        cosine = _upright(holder, low, high, q, axes[-1:], normals[open_])
        better = cosine > best[open_]
        best[open_[better]], most[open_[better]] = cosine[better], q[better]
        open_ = open_[best[open_] < np.cos(enough)]
    for _ in range(_ROUNDS if len(axes) > 1 else 0):
        q = most[open_]
        cosine = _upright(holder, low, high, q, axes, normals[open_])
        won = cosine - best[open_]
        best[open_], most[open_] = np.maximum(cosine, best[open_]), q
        open_ = open_[(won > _STILL) & (cosine < np.cos(enough))]
        if not len(open_):
            break
    return np.asarray(np.arccos(np.clip(best, -1.0, 1.0)))


def _once_round(low: Array, high: Array) -> tuple[Array, Array]:
    """The ranges, limited to one turn each."""
    middle, half = 0.5 * (low + high), np.minimum(0.5 * (high - low), np.pi)
    return middle - half, middle + half


def _upright(holder: Chain, low: Array, high: Array, q: Array, axes: Ints, normals: Array) -> Array:
    """Turn some axes of q (n, nh), the last one first, to where normals (n, 3) lean least; returns the cosines (n)."""
    n, cosine = len(normals), np.empty(len(normals))
    if not len(axes):
        return np.asarray(normals @ holder.poses(q[:1])[0, 2, :3])
    for j in reversed(axes):
        k = holder.axes[j, :3]
        b = normals @ holder.T_last_tip[:3, :3].T  # the normal as the axis sees it
        for i in range(len(holder) - 1, j, -1):
            b = _rotated(holder.axes[i, :3], q[:, i], b) @ holder.placements[i, :3, :3].T
        a = np.tile(holder.placements[0, 2, :3], (n, 1))  # the vertical likewise
        for i in range(j):
            a = _rotated(holder.axes[i, :3], -q[:, i], a) @ holder.placements[i + 1, :3, :3]
        still = (a @ k) * (b @ k)
        c, s = (a * b).sum(axis=1) - still, (a * np.cross(k, b)).sum(axis=1)
        best = np.arctan2(s, c)
        best += 2.0 * np.pi * np.ceil((low[j] - best) / (2.0 * np.pi))
        ends = np.where(
            c * np.cos(low[j]) + s * np.sin(low[j]) > c * np.cos(high[j]) + s * np.sin(high[j]), low[j], high[j]
        )
        q[:, j] = np.where(best <= high[j], best, ends)
        cosine = still + c * np.cos(q[:, j]) + s * np.sin(q[:, j])
    return cosine


def _rotated(axis: Array, angle: Array, vectors: Array) -> Array:
    """Vectors (n, 3), each turned about a unit axis (3) by an angle (n); as they are where the axis is 0."""
    c, s = np.cos(angle)[:, None], np.sin(angle)[:, None]
    if not axis.any():
        return vectors
    return np.asarray(c * vectors + s * np.cross(axis, vectors) + (1.0 - c) * (vectors @ axis)[:, None] * axis)


def least_along(holder: Chain, low: Array, high: Array, normals: Array) -> float:
    """The smallest maximum lean [rad], along a bead with unit normals (n, 3), of any continuous motion of the holder.

    Motions stay within the ranges and may be as slow as they like. They are found on a lattice, so the result is a
    little too high; see `_rungs` for how much of the bead is covered. Holders with more than two axes are assumed to
    follow the least lean of each place.
    """
    axes = np.flatnonzero(~holder.slides)
    leans = least_leans(holder, low, high, normals)
    if not 1 <= len(axes) <= 2:
        return float(leans.max())
    step = _FINE if len(axes) == 1 else _FINE_OF_TWO
    angles, round_ = zip(*(_lattice(low[j], high[j], step) for j in axes), strict=True)
    grid = np.stack(np.meshgrid(*angles, indexing="ij"), axis=-1).reshape(-1, len(axes))
    q = np.zeros((len(grid), len(holder)))
    q[:, axes] = grid
    up = np.ascontiguousarray(holder.poses(q)[:, 2, :3]).reshape(*(len(each) for each in angles), 3)
    if len(axes) == 1:
        up, round_ = up[:, None], (*round_, False)
    some = _rungs(normals, int(np.argmax(leans)))
    cosine = _least_way(np.ascontiguousarray(up), np.ascontiguousarray(normals[some]), *round_)
    return float(np.arccos(np.clip(cosine, -1.0, 1.0)))


def _rungs(normals: Array, worst: int) -> Ints:
    """Samples of a bead with unit normals (n, 3) between which the lattice's angles may change.

    They cover all of it or, if it winds round so often that they would be too far apart, the part around the worst.
    """
    first, last = 0, len(normals) - 1
    while True:
        count = min(last + 1 - first, _RUNGS)
        some = np.unique(np.append(np.linspace(first, last, count).astype(np.int64), worst))
        turned = angles_between(normals[some[:-1]], normals[some[1:]])
        if last < first + _RUNGS or float(np.median(turned)) <= _TURN:
            return some
        first, last = (first + worst) // 2, (last + worst + 1) // 2


def _lattice(low: float, high: float, step: float) -> tuple[Array, bool]:
    """Angles of an axis, both ends among them, and whether they form a circle: if the range is as good as unbounded."""
    if high - low >= _WIDE:
        n = int(np.ceil(2.0 * np.pi / step))
        return np.asarray(2.0 * np.pi / n * np.arange(n)), True
    return np.linspace(low, high, int(np.ceil((high - low) / step)) + 1), False


@njit
def _least_way(up, normals, round_a, round_b):
    """The largest minimum cosine between `up` (na, nb, 3) and normals (r, 3) of any way over the lattice.

    round_a, round_b: whether the lattice is periodic in each index. At a rung, the way may go from cell to neighbour as
    far as it likes.
    """
    na, nb = up.shape[0], up.shape[1]
    here, least = np.empty((na, nb)), np.full((na, nb), 1.0)
    for k in range(len(normals)):
        for i in range(na):
            for j in range(nb):
                c = up[i, j, 0] * normals[k, 0] + up[i, j, 1] * normals[k, 1] + up[i, j, 2] * normals[k, 2]
                here[i, j] = c
                least[i, j] = min(least[i, j], c)
        changed = k > 0  # the first cell may be any
        while changed:
            changed = False
            for way in range(2):
                for m in range(na * nb):
                    at = m if way == 0 else na * nb - 1 - m
                    i, j = at // nb, at % nb
                    most = least[i, j]
                    for d in range(-1, 2, 2):
                        x, y = i + d, j + d
                        if round_a:
                            x %= na
                        if round_b:
                            y %= nb
                        if 0 <= x < na:
                            most = max(most, min(least[x, j], here[i, j]))
                        if 0 <= y < nb:
                            most = max(most, min(least[i, y], here[i, j]))
                    if most > least[i, j]:
                        least[i, j] = most
                        changed = True
    return least.max()
