"""Scan lines across or along a sheet of a wing: zig-zag beads drawn on the unrolled sheet, laid on the true one."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from planner.base.arrays import Array, true_runs
from planner.toolpath.bead import Bead
from planner.toolpath.wing.section import SHORTEST
from planner.toolpath.wing.sheets import WingSheet
from planner.toolpath.wing.strips import APART, PER_RUN, STEP, TURN, Filling, rolled_bead

Segment = tuple[int, float, float]  # a row, and the two ends of a pass on it
_SHORTEST_PASS = 2.0  # bead widths: in a shorter one both turns would share a corner
_INSET = 0.49  # bead widths that passes along the wing stay inside: 0.5 would leave the outermost ones to chance
_LOOKS = (15, 9)  # places across and along a sheet at which its stretch is measured
_DIFFERENCE = 1e-5  # m: step of finite differences for the stretch


@dataclass(frozen=True)
class PassSpacing:
    """How unrolling a sheet changes distances, as true length per unrolled length.

    mean, least, greatest  between passes
    any                    greatest in any direction
    """

    mean: float
    least: float
    greatest: float
    any: float


def stretch_of(sheet: WingSheet, across: bool) -> PassSpacing:
    """How unrolling a sheet changes the distances between its passes, which run across the wing or along it."""
    there = np.flatnonzero(~np.isnan(sheet.area.edges[:, 0]).any(axis=1))
    rows = np.unique(np.linspace(there[0], there[-1], _LOOKS[1]).astype(int))
    rows = rows[np.isin(rows, there)]
    low, high = np.nanmin(sheet.area.edges[rows], axis=(1, 2)), np.nanmax(sheet.area.edges[rows], axis=(1, 2))
    share = np.linspace(0.01, 0.99, _LOOKS[0])
    c, y = (low[:, None] + share * (high - low)[:, None]).ravel(), np.repeat(sheet.area.y[rows], len(share))
    x = sheet.unrolled(c, y)
    by = []
    for shift in ((_DIFFERENCE, 0.0), (0.0, _DIFFERENCE)):
        ahead, behind = (on_sheet(sheet, np.column_stack([x + k * shift[0], y + k * shift[1]]))[0] for k in (1, -1))
        by.append((ahead - behind) / (2.0 * _DIFFERENCE))
    size = np.linalg.norm(np.cross(by[0], by[1]), axis=1)
    pass_direction = by[0] if across else by[1] + sheet.slope * by[0]
    apart = size / np.linalg.norm(pass_direction, axis=1) * (1.0 if across else np.hypot(1.0, sheet.slope))
    squares = np.array([[(a * b).sum(axis=1) for a in by] for b in by]).transpose(2, 0, 1)
    most = float(np.sqrt(np.linalg.eigvalsh(squares)[:, -1].max()))
    return PassSpacing(float(apart.mean()), float(apart.min()), float(apart.max()), most)


def on_sheet(sheet: WingSheet, plane: Array) -> tuple[Array, Array]:
    """Points and outward unit normals (n, 3) of places (n, 2) on an unrolled sheet."""
    return sheet.tips(sheet.rolled(plane[:, 0], plane[:, 1]), plane[:, 1])


def fill_sheet(
    sheet: WingSheet, across: bool, filling: Filling, name: str, layer: int, start: Array | None, stretch: PassSpacing
) -> list[Bead]:
    """Beads that fill a sheet in passes across the wing or along it; the first begins near `start` (3), if given.

    They stay half a bead inside the edges of the sheet.
    """
    chains, width = _across(sheet, filling, stretch) if across else _along(sheet, filling, stretch)
    left = [chain for chain in chains if _length(chain) >= SHORTEST * filling.width]
    beads: list[Bead] = []
    pieces = 0
    while left:
        choices = [(k, way) for k, chain in enumerate(left) for way in _ways(chain)]
        ends = np.array([way[0] for _, way in choices])
        if start is None:
            k, way = choices[0]
        else:
            k, way = choices[int(np.argmin(np.linalg.norm(on_sheet(sheet, ends)[0] - start, axis=1)))]
        left.pop(k)
        pieces += 1
        piece = name if len(chains) == 1 else f"{name} piece {pieces}"
        for each, line in filling.lines(list(way.reshape(-1, 2, 2)), piece):
            beads.append(_bead(sheet, across, line, width, filling, stretch, each, layer))
        start = beads[-1].points[-1]
    return beads


def _across(sheet: WingSheet, filling: Filling, stretch: PassSpacing) -> tuple[list[list[Array]], float]:
    """Chains of passes at even distances along the span, each pass as its two ends (2, 2); and the width of a bead."""
    area, half = sheet.area, 0.5 * filling.width
    low, high = float(area.y[0]), float(area.y[-1])
    pitch = filling.width * filling.spacing / stretch.mean
    count = max(round((high - low) / pitch), 1)
    pitch = (high - low) / count
    y = np.asarray(low + pitch * (np.arange(count, dtype=np.float64) + 0.5))
    edges = area.at(y)
    rows: list[list[tuple[float, float]]] = []
    for k in range(count):
        inside = edges[k][~np.isnan(edges[k, :, 0])]
        x = sheet.unrolled(inside.ravel(), np.full(inside.size, y[k])).reshape(-1, 2)
        x.sort(axis=1)
        rows.append([(a + half, b - half) for a, b in x if b - a > 2.0 * half + _SHORTEST_PASS * filling.width])
    chains = [[np.array([[a, y[row]], [b, y[row]]]) for row, a, b in chain] for chain in linked(rows)]
    return chains, pitch * stretch.mean / filling.spacing


def _along(sheet: WingSheet, filling: Filling, stretch: PassSpacing) -> tuple[list[list[Array]], float]:
    """Chains of passes at even distances across the wing, parallel to its middle line, and the width of a bead."""
    area, half = sheet.area, 0.5 * filling.width
    first, last = float(area.y[0]) + half, float(area.y[-1]) - half
    y = np.unique(np.concatenate([[first, last], area.y[(area.y > first) & (area.y < last)]]))
    edges = area.at(y)
    shift = sheet.slope * (y - y[0])
    ends = sheet.unrolled(np.nan_to_num(edges).ravel(), np.repeat(y, edges[0].size)).reshape(edges.shape)
    ends = np.sort(np.where(np.isnan(edges), np.nan, ends) - shift[:, None, None], axis=2)
    pitch = filling.width * filling.spacing * np.hypot(1.0, sheet.slope) / stretch.mean
    if np.isnan(ends).all():  # too short along the span for a bead to turn
        return [], filling.width
    low, high = np.nanmin(ends), np.nanmax(ends)
    count = max(round((high - low) / pitch), 1)
    pitch = (high - low) / count
    x = low + pitch * (np.arange(count) + 0.5)
    inset = _INSET * min(filling.width, pitch)
    rows = [_where(np.fmax.reduce(np.minimum(k - ends[:, :, 0], ends[:, :, 1] - k), axis=1) - inset, y) for k in x]
    least = _SHORTEST_PASS * filling.width
    rows = [[(a, b) for a, b in row if b - a > least] for row in rows]
    chains = [
        [np.array([[x[row] + sheet.slope * (v - y[0]), v] for v in (a, b)]) for row, a, b in chain]
        for chain in linked(rows)
    ]
    return chains, pitch * stretch.mean / filling.spacing / float(np.hypot(1.0, sheet.slope))


def _where(room: Array, y: Array) -> list[tuple[float, float]]:
    """Intervals of y where room (n), linear between its places y (n), is not negative; NaN counts as no room."""
    ok = np.nan_to_num(room, nan=-np.inf) >= 0.0
    found = []
    for start, behind in true_runs(ok):
        bounds = []
        for inner, outer in ((start, start - 1), (behind - 1, behind)):
            beyond = outer < 0 or outer >= len(y) or np.isnan(room[outer])
            share = 0.0 if beyond else max(room[inner], 0.0) / (max(room[inner], 0.0) - room[outer])
            bounds.append(float(y[inner] + share * (y[np.clip(outer, 0, len(y) - 1)] - y[inner])))
        found.append((bounds[0], bounds[1]))
    return found


def linked(rows: Sequence[Sequence[tuple[float, float]]]) -> list[list[Segment]]:
    """Intervals on successive rows as chains: they continue to the next row if two intervals face only each other."""
    chains: list[list[Segment]] = []
    open_chains: dict[int, list[Segment]] = {}  # by the interval on the row before
    before: Sequence[tuple[float, float]] = ()
    for number, row in enumerate(rows):
        facing = [[i for i, other in enumerate(before) if _overlap(each, other)] for each in row]
        faced = list(itertools.chain.from_iterable(facing))
        now: dict[int, list[Segment]] = {}
        for k, each in enumerate(row):
            if len(facing[k]) == 1 and faced.count(facing[k][0]) == 1:
                now[k] = open_chains[facing[k][0]]
            else:
                now[k] = []
                chains.append(now[k])
            now[k].append((number, *each))
        open_chains, before = now, row
    return chains


def _overlap(one: tuple[float, float], other: tuple[float, float]) -> bool:
    return min(one[1], other[1]) > max(one[0], other[0])


def _length(chain: list[Array]) -> float:
    return float(sum(np.linalg.norm(ends[1] - ends[0]) for ends in chain))


def _ways(chain: list[Array]) -> list[Array]:
    """The four zig-zag lines (n, 2) along a chain's passes: from either end of its first or its last pass."""
    found = []
    for passes, turned in itertools.product((chain, chain[::-1]), (0, 1)):
        ends = [ends if (k + turned) % 2 == 0 else ends[::-1] for k, ends in enumerate(passes)]
        found.append(np.vstack(ends))
    return found


def _bead(
    sheet: WingSheet,
    across: bool,
    way: Array,
    width: float,
    filling: Filling,
    stretch: PassSpacing,
    name: str,
    layer: int,
) -> Bead:
    step = min(STEP, TURN / max(sheet.bend, 1e-9)) if across else STEP
    plane = _dense(way, step)
    apart, ends = APART * width * filling.spacing, filling.run_in / PER_RUN
    lift, tolerance = partial(on_sheet, sheet), filling.tolerance / stretch.any
    return rolled_bead(name, layer, plane, lift, tolerance, apart, ends, width, filling.height)


def _dense(way: Array, step: float) -> Array:
    """A polyline's corners (n, 2), and enough points between them to keep steps at most `step` long."""
    size = np.linalg.norm(np.diff(way, axis=0), axis=1)
    pieces = [
        a + np.linspace(0.0, 1.0, max(int(np.ceil(d / step)), 1), endpoint=False)[:, None] * (b - a)
        for a, b, d in zip(way[:-1], way[1:], size, strict=True)
    ]
    return np.vstack([*pieces, way[-1:]])
