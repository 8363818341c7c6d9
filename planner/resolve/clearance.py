"""Clearance in the refinement: the least margins of a path, how they change with its free variables, rows of a program.

Only what is near is looked at: where all postures are far from everything there is nothing to hold.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from planner.background import in_blocks
from planner.obstacles import Obstacles
from planner.obstacles.scene import BLOCK
from planner.obstacles.slopes import nearest_margins
from planner.readonly import Array, Ints

COMFORT = 15e-3  # m of margin above which nothing is held: three times what arms keep
COMFORT_OF_POINTS = 2e-3  # m, the same of part and print: to look farther around the nozzle takes five times as long
EVERY = 1e-3  # m of the tip's way from one sample that is looked at to the next, where margins are small
SPARSE = 4  # times as far elsewhere
_SMALL = 6e-3  # m
ROOM = 2e-4  # m of margin that is asked for, since paths are looked at in samples
UNIT = 10.0  # 1/m: a tenth of a millimetre that lacks counts as much as a milliradian beyond a cone
_ROWS = 4  # pairs of a sample that are held
_FEW = 2  # blocks of postures that are looked at sooner than threads begin
_STILL = 1e-6  # m/rad: margins that change by less do not change


@dataclass(frozen=True)
class Clearances:
    """Margins below COMFORT along n samples: sample (k) and margin (k) [m] of each, slope (k, m) by free variables
    [m/rad]; time (n): what a sample stands for among those that are looked at, in samples."""

    time: Array
    sample: Ints
    margin: Array
    slope: Array


def clearances(
    obstacles: Obstacles, q: Array, G: Array, now: Array, tip: Array, first: int = 0, *, held: bool = True
) -> Clearances:
    """The least margins of postures q (n, nj) at times now (n), the nozzle's tip at tip (n, 3); G (n, nj, m) is dq/dz.

    first: the sample to begin with; those before are of no concern.
    held: whether margins are to be held; if not, only those that lack something come back.
    """
    n, nj = q.shape
    if not obstacles.any:
        return Clearances(np.zeros(n), np.zeros(0, dtype=np.int64), np.zeros(0), np.zeros((0, G.shape[2])))
    gone = np.concatenate([np.zeros(1), np.cumsum(np.linalg.norm(np.diff(tip, axis=0), axis=1))]) // EVERY
    begins = np.concatenate([np.ones(1, dtype=np.bool_), np.diff(gone) > 0.0])
    begins[:first], begins[first] = False, True
    fine = np.flatnonzero(begins)
    margin, slope = np.empty((n, _ROWS)), np.empty((n, _ROWS, nj))
    which = np.empty((n, _ROWS), dtype=np.int64)
    wanted, comfort = np.zeros(n, dtype=np.bool_), (COMFORT, COMFORT_OF_POINTS) if held else (ROOM, ROOM)

    def look(at: Ints) -> None:
        mask = np.zeros(n, dtype=np.bool_)
        mask[at] = wanted[at] = True
        in_blocks(
            lambda b: nearest_margins(obstacles.table, q[b], now[b], mask[b], *comfort, margin[b], slope[b], which[b]),
            n,
            BLOCK,
            _FEW,
        )

    if held:
        look(fine[::SPARSE])
        look(fine[_beside_small(margin[fine[::SPARSE]], slope[fine[::SPARSE]], len(fine))])
    else:
        look(fine)
    group = np.cumsum(wanted)[first:] - 1
    time = np.zeros(n)
    time[first:] = np.where(wanted[first:], np.bincount(group)[group], 0)
    margin[~wanted] = np.inf
    sample, row = np.nonzero(margin < comfort[0])
    return Clearances(time, sample, margin[sample, row], np.einsum("kj,kjm->km", slope[sample, row], G[sample]))


def _beside_small(margin: Array, slope: Array, count: int) -> Ints:
    """Which of `count` samples, each SPARSE-th of which has margins (k, rows) with slopes (k, rows, nj), lie between
    two of them one of which has a small margin that can change."""
    small = ((margin < _SMALL) & (np.abs(slope).sum(axis=2) > _STILL)).any(axis=1)
    between = np.repeat(small | np.append(small[1:], False), SPARSE)[:count]
    between[::SPARSE] = False
    return np.flatnonzero(between)


def shortage(near: Clearances) -> Array:
    """What lacks (n, 1), in the units of a cone's excess."""
    lacking = np.zeros(len(near.time))
    np.add.at(lacking, near.sample, UNIT * near.time[near.sample] * np.maximum(ROOM - near.margin, 0.0))
    return lacking[:, None]


def clearance_rows(
    near: Clearances, step: Array, first: Ints, B: Array, free: Array, trust: float
) -> tuple[Array, Array, Ints, Array]:
    """Rows A (r, w) x <= b (r) that keep margins, from which variable on (r), and the time each stands for (r) [s].

    Only margins that a step within `trust` [rad] could use up have rows.
    """
    reach = trust * np.abs(near.slope).sum(axis=1)
    held = np.flatnonzero((reach > near.margin - ROOM) & (reach > trust * _STILL))
    i, m, width = near.sample[held], near.slope.shape[1], B.shape[2]
    moved = B[i, 0] * free[first[i][:, None] + np.arange(width)]
    A = -UNIT * moved[:, :, None] * near.slope[held][:, None, :]
    return A.reshape(len(held), width * m), UNIT * (near.margin[held] - ROOM), first[i] * m, near.time[i] * step[i]
