"""The harmonic field between two surfaces, derived again by finite differences on horizontal grids.

Grid lines are cut off where they leave the space between the surfaces, where the field is known (Shortley and Weller,
1938). Lengths are in metres in the part frame.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import RBFInterpolator
from scipy.ndimage import map_coordinates
from scipy.sparse import coo_array, csc_array
from scipy.sparse.linalg import LinearOperator, bicgstab, spilu

from planner.base.arrays import Array, Flags, Ints
from planner.verify.reread.slopes import Heights

_COLUMNS = 48  # along the longer side of the body
_FEWEST = 8  # least number along the shorter side
_MOST_COLUMNS = 100  # along the longer side, with the margins
_ROWS = 16  # from surface to surface where these are farthest apart
_SHARES = np.linspace(0.0, 1.0, 33)  # levels of the field whose heights are kept
_BESIDE = 1.5  # × the greatest height: margin of the grid around the body
_NEIGHBOURS = 40  # whose heights extend the surfaces beyond the body
_SHORTEST = 1e-3  # × a step: least distance to a surface
_CLOSE = 1e-8  # relative tolerance of the solver
_ACROSS = ((0, 1), (0, -1), (1, 1), (1, -1))  # axis and sense of the steps along level rows


@dataclass(frozen=True)
class LevelsOff:
    """Offset of the field's levels from an even share of the height: a table (n, m, shares) [m] over a grid that begins
    at `low` (2), with places `pitch` [m] apart."""

    low: Array
    pitch: float
    table: Array

    def at(self, plane: Array, share: Array) -> Array:
        """Offset (n) [m] at x, y (n, 2) and shares (n) of the way from the lower to the upper surface."""
        across = ((plane - self.low) / self.pitch).T
        place = np.vstack([across, np.clip(share, 0.0, 1.0) * (len(_SHARES) - 1)])
        return np.asarray(map_coordinates(self.table, place, order=3, mode="nearest"))


def levels_off(lower: Heights, upper: Heights, low: Array, high: Array) -> LevelsOff:
    """`LevelsOff` of the field between two surfaces over a body from low to high (2), where neither is NaN."""
    longest = float((high - low).max())
    counts = np.maximum(np.ceil(_COLUMNS * (high - low) / longest), _FEWEST).astype(int)
    axes = [np.linspace(a, b, 2 * n + 1)[1::2] for a, b, n in zip(low, high, counts, strict=True)]
    plane = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2)
    z = np.column_stack([lower(plane), upper(plane)])
    there = ~np.isnan(z).any(axis=1) & (z[:, 1] > z[:, 0])
    if not there.any():
        return LevelsOff(low, longest, np.zeros((1, 1, len(_SHARES))))
    greatest = float((z[there, 1] - z[there, 0]).max())
    beside = _BESIDE * greatest
    pitch = max(longest / _COLUMNS, (longest + 2.0 * beside) / _MOST_COLUMNS)
    first = low - beside
    shape = tuple((np.ceil((high + beside - first) / pitch).astype(int) + 1).tolist())
    grid = first + pitch * np.moveaxis(np.indices(shape), 0, -1)
    on = RBFInterpolator(plane[there], z[there], neighbors=_NEIGHBOURS, kernel="thin_plate_spline")
    bottom, top = np.moveaxis(on(grid.reshape(-1, 2)).reshape(*shape, 2), 2, 0)
    top = np.maximum(top, bottom + (z[there, 1] - z[there, 0]).min())
    return LevelsOff(first, pitch, _table(bottom, top, pitch, greatest / _ROWS))


def _table(bottom: Array, top: Array, pitch: float, rise: float) -> Array:
    """Heights (n, m, shares) [m] of the field's levels above an even share."""
    z = np.arange(float(bottom.min()) + 0.5 * rise, float(top.max()), rise)
    inside = (z > bottom[..., None] + _SHORTEST * rise) & (z < top[..., None] - _SHORTEST * rise)
    field = np.where(z >= top[..., None], 1.0, 0.0)
    field[inside] = _solved(bottom, top, z, inside, pitch, rise)
    out = np.empty((*bottom.shape, len(_SHARES)))
    for i, j in np.ndindex(*bottom.shape):
        own = inside[i, j]
        heights = np.concatenate([[bottom[i, j]], z[own], [top[i, j]]])
        out[i, j] = np.interp(_SHARES, np.concatenate([[0.0], field[i, j, own], [1.0]]), heights)
    return np.asarray(out - bottom[..., None] - _SHARES * (top - bottom)[..., None])


def _solved(bottom: Array, top: Array, z: Array, inside: Flags, pitch: float, rise: float) -> Array:
    """The field at the inside places (n)."""
    number: Ints = np.full(inside.shape, -1)
    number[inside] = np.arange(int(inside.sum()))
    size = int(inside.sum())
    i, j, k = np.nonzero(inside)
    here = z[k]
    ways = [_upwards(number, inside, (i, j, k), here, bottom, top, rise, sense) for sense in (1, -1)]
    ways += [_sideways(number, (i, j, k), here, bottom, top, pitch, *way) for way in _ACROSS]
    rows, columns, values, right = [], [], [], np.zeros(size)
    diagonal = np.zeros(size)
    for one, other in ((0, 1), (2, 3), (4, 5)):
        whole = ways[one][1] + ways[other][1]
        for to, length, value in (ways[one], ways[other]):
            weight = 2.0 / (whole * length)
            weight[np.isnan(value) & (to < 0)] = 0.0  # no flux through the sides of the grid
            known = to < 0
            right += np.where(known, weight * np.nan_to_num(value), 0.0)
            diagonal += weight
            rows.append(np.flatnonzero(~known))
            columns.append(to[~known])
            values.append(-weight[~known])
    rows.append(np.arange(size))
    columns.append(np.arange(size))
    values.append(diagonal)
    entries = (np.concatenate(values), (np.concatenate(rows), np.concatenate(columns)))
    A = csc_array(coo_array(entries, shape=(size, size)))
    ahead = LinearOperator((size, size), spilu(A, drop_tol=1e-3, fill_factor=20).solve)
    start = (here - bottom[i, j]) / (top - bottom)[i, j]
    return np.asarray(bicgstab(A, right, x0=start, rtol=_CLOSE, M=ahead)[0])


Way = tuple[
    Ints, Array, Array
]  # the next place, or -1; distance to it, or to a surface before it [m]; the field there, if known


def _upwards(
    number: Ints, inside: Flags, at: tuple[Ints, ...], here: Array, bottom: Array, top: Array, rise: float, sense: int
) -> Way:
    """From each place (n) to the one above or below it."""
    i, j, k = at
    there = np.clip(k + sense, 0, inside.shape[2] - 1)
    to = np.where((there != k) & inside[i, j, there], number[i, j, there], -1)
    end = (top if sense > 0 else bottom)[i, j]
    return to, np.where(to >= 0, rise, np.abs(end - here)), np.full(len(i), float(sense > 0))


def _sideways(
    number: Ints, at: tuple[Ints, ...], here: Array, bottom: Array, top: Array, pitch: float, axis: int, sense: int
) -> Way:
    """From each place (n) to the next one in its horizontal row."""
    there = [at[0].copy(), at[1].copy()]
    there[axis] = there[axis] + sense
    beside = (there[axis] < 0) | (there[axis] >= number.shape[axis])
    there[axis] = np.clip(there[axis], 0, number.shape[axis] - 1)
    p, q = there
    to = np.where(beside, -1, number[p, q, at[2]])
    leaves = (to < 0) & ~beside
    over = here >= 0.5 * (bottom + top)[p, q]
    edge = np.where(over, top[at[0], at[1]], bottom[at[0], at[1]])
    next_edge = np.where(over, top[p, q], bottom[p, q])
    fall = np.where(leaves, edge - next_edge, 1.0)
    share = np.clip((edge - here) / np.where(fall == 0.0, 1.0, fall), _SHORTEST, 1.0)
    return to, np.where(leaves, share * pitch, pitch), np.where(leaves, over.astype(float), np.nan)
