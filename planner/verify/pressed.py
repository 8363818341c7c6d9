"""How deep the nozzle presses into what it has laid: the verifier's own model of the print as it grows.

The planner's obstacles are not used. Beads are modelled again from the tip as the joints move it: rows of balls across
the bead's width, so dense that their tops are flat, each present from the instant at which the tip passes. The nozzle
is its outline, revolved about its axis. Where it just touches a neighbouring bead, the distance is 0; where it is
lower, it presses the bead flat by the depth reported. Material just laid, which the nozzle's face is still shaping,
does not count.

All values are in the part frame, in metres; n counts samples, m rows of balls.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from planner.base.arrays import Array, Ints
from planner.base.compiled import inner_njit, njit
from planner.cell.bodies import nozzle_profile
from planner.plan import Check
from planner.verify.checks import DIGITS, EVERYWHERE, Findings, Judged, place

_ZERO: Any = np.int64(0)  # a plain 0 has its own type, for which kernels would be compiled again
_APART = 0.25  # bead heights between balls: their tops lie at most 0.016 heights below the bead's
_OFTEN = 0.25  # bead heights: how far the tip moves, or the nozzle's rim turns, between two looks
_CELLS = 1.5  # grid cells per reach of the nozzle: more are slower, and so are fewer
_AT_ONCE = 100_000  # rows made at once
_MIXES = 0x9E3779B97F4A7C15  # odd, 2**64 / golden ratio: consecutive keys land far apart
LIMIT = 0.5  # × a bead's height: the nozzle may press this deep into it; the rest stays where it was laid


class LaidRows(NamedTuple):
    """The beads as rows (m) of balls across them, in the order of their cells' keys, with cells (c) of a grid.

    centre (m, 3), half (m, 3) [m]   middle of each row, and the vector from there to its last ball
    radius (m) [m], across (m)       radius and number of the balls of each row
    height (m) [m], bead (m)         height of the bead there, and the bead
    when (m)                         sample, and fraction of the way to the next, at which the tip passes
    first (c + 1), key (c), since (c)   first row of each cell, its key, and its earliest `when`
    table (2^k)                      cell by its key: open addressing, -1 where there is none
    low (3), wide (3), size          corner of the grid [m], cells along its sides, and a cell's side [m]
    """

    centre: Array
    half: Array
    radius: Array
    across: Ints
    height: Array
    when: Array
    bead: Ints
    first: Ints
    key: Ints
    since: Array
    table: Ints
    low: Array
    wide: Ints
    size: float


@dataclass(frozen=True)
class Pressed:
    """The worst overlap of nozzle and print: share of the bead's height, depth [m], at sample `at` in bead `bead`,
    `away` [m] from the tip; and the greatest depth anywhere [m]. 0 and -1 where nothing overlaps."""

    share: float = 0.0
    depth: float = 0.0
    at: int = -1
    bead: int = -1
    away: float = 0.0
    greatest: float = 0.0


def pressed(judged: Judged) -> Findings:
    """The check of how deep the nozzle presses into beads printed earlier, as a share of their height."""
    found, where = deepest(judged), EVERYWHERE
    if found.at >= 0:
        where = f"{found.depth * 1e3:.3f} mm into bead {found.bead}, {found.away * 1e3:.1f} mm from the tip, "
        where += place(judged.trajectory, found.at)
    ok = found.share <= LIMIT * (1.0 + DIGITS)
    check = Check("print pressed by the nozzle", found.share, LIMIT, "of a bead's height", ok, where, sample=found.at)
    return Findings((check,), {"nozzle_pressed_max_mm": found.greatest * 1e3})


def deepest(judged: Judged) -> Pressed:
    """The deepest overlap of the nozzle's outline with beads laid earlier, relative to their heights."""
    t, motion, cell = judged.trajectory, judged.motion, judged.problem.cell
    profiles = {
        own.nozzle_name: np.array(nozzle_profile(cell.nozzle_named(own.nozzle_name))) for own, _ in judged.stretches
    }
    laid, face = laid_beads(judged), max(float(profile[0, 1]) for profile in profiles.values())
    reach, shaped = face + float((laid.width + laid.height).max()), face + float(laid.width.max())
    rows = _rows(laid, reach / _CELLS)
    looks = _looks(motion.tip, motion.axis, _OFTEN * float(laid.height.min()), reach)
    found = Pressed()
    for own, samples in judged.stretches:
        first, last = np.searchsorted(looks, [samples.start, samples.stop])
        profile = profiles[own.nozzle_name]
        share, at, row, away, greatest = _deepest(
            rows, motion.tip, motion.axis, t.bead, looks[first:last], profile, reach, shaped
        )
        if row >= 0 and share > found.share:
            depth = share * rows.height[row]
            found = Pressed(float(share), float(depth), int(at), int(rows.bead[row]), float(away), found.greatest)
        found = replace(found, greatest=max(found.greatest, float(greatest)))
    return found


class Laid(NamedTuple):
    """Where beads are laid (k): tip and outward normal (k, 3), width and height [m], bead, and the sample (k), -1 for
    beads that are there from the start."""

    tip: Array
    normal: Array
    width: Array
    height: Array
    bead: Ints
    sample: Array


def laid_beads(judged: Judged) -> Laid:
    """The beads that the motion lays, after those that are there already where a print is resumed."""
    t, beads = judged.trajectory, judged.toolpath.beads
    at = np.flatnonzero(t.deposit)
    ends = np.cumsum([bead.length + 1.0 for bead in beads])  # of all beads on one line, 1 m apart
    starts = np.append(0.0, ends[:-1])
    s = np.concatenate([bead.s + start for bead, start in zip(beads, starts, strict=True)])
    before = beads[: t.first_bead]
    number = np.repeat(np.arange(len(before)), [len(bead.s) for bead in before])
    bead = np.concatenate([number, t.bead[at]]).astype(np.int64)
    along = np.concatenate([*(bead.s for bead in before), t.s[at]]) + starts[bead]
    tip = np.concatenate([*(bead.points for bead in before), judged.motion.tip[at]])
    width, height, x, y, z = (
        np.interp(along, s, values)
        for values in (
            *(np.concatenate([getattr(bead, name) for bead in beads]) for name in ("width", "height")),
            *np.concatenate([bead.normals for bead in beads]).T,
        )
    )
    normal = np.column_stack([x, y, z])
    sample = np.concatenate([np.full(len(number), -1.0), at])
    return Laid(tip, normal / np.linalg.norm(normal, axis=1)[:, None], width, height, bead, sample)


def _rows(laid: Laid, size: float) -> LaidRows:
    """The rows of balls of the beads, in a grid with cells of this size [m]."""
    tip, _, width, height, bead, sample = laid
    same = np.diff(bead) == 0
    apart = _APART * np.minimum(width, height)[1:]
    covered = np.concatenate(
        [[0.0], np.cumsum(np.where(same, np.linalg.norm(np.diff(tip, axis=0), axis=1) / apart, 1.0))]
    )
    starts = np.flatnonzero(np.append(True, ~same))
    low, high = covered[starts], covered[np.append(starts[1:], len(tip)) - 1]
    rows = np.floor(high - low).astype(np.int64) + 2
    of, number = np.repeat(np.arange(len(rows)), rows), np.arange(rows.sum()) - np.repeat(np.cumsum(rows) - rows, rows)
    at = np.minimum(low[of] + number, high[of])

    def balls(rows: slice) -> Balls:
        own = of[rows]
        return _balls(laid, covered, at[rows], low[own], high[own])

    centre = np.empty((len(at), 3))
    for rows in _blocks(len(at)):
        centre[rows] = balls(rows).centre
    corner = centre.min(axis=0)
    cell = np.floor((centre - corner) / size).astype(np.int64)
    wide = cell.max(axis=0) + 1
    key = (cell[:, 0] * wide[1] + cell[:, 1]) * wide[2] + cell[:, 2]
    order = np.argsort(key, kind="stable")
    keys, first = np.unique(key[order], return_index=True)
    of, at = of[order], at[order]
    found = Balls(centre, *(np.empty((len(at), *shape), kind) for shape, kind in _KINDS))
    for rows in _blocks(len(at)):  # computed again in this order: sorting them would take as much memory again
        for values, own in zip(found, balls(rows), strict=True):
            values[rows] = own
    when = np.interp(at, covered, sample)
    bits = max(4, int(np.ceil(np.log2(4.0 * len(keys)))))
    return LaidRows(
        *found, when, bead[starts][of], np.append(first, len(at)), keys, np.minimum.reduceat(when, first),
        _table(keys, bits), corner, wide, size,
    )  # fmt: skip


class Balls(NamedTuple):
    """Balls of rows (m): fields as in `LaidRows`."""

    centre: Array
    half: Array
    radius: Array
    across: Ints
    height: Array


_KINDS = (
    ((3,), float),
    ((), float),
    ((), np.int64),
    ((), float),
)  # shape and type of a row, for the fields after the first


def _balls(laid: Laid, covered: Array, at: Array, low: Array, high: Array) -> Balls:
    """Rows of balls at places (m) along the beads, from `low` to `high` (m) of each; covered (k): of the samples."""

    def there(values: Array, at: Array = at) -> Array:
        """Values (k) or (k, 3) of samples, interpolated at each row."""
        columns = values.reshape(len(values), -1).T
        return np.stack([np.interp(at, covered, column) for column in columns], axis=-1).reshape(-1, *values.shape[1:])

    w, h, up = there(laid.width), there(laid.height), there(laid.normal)
    way = there(laid.tip, np.minimum(at + 0.5, high)) - there(laid.tip, np.maximum(at - 0.5, low))
    side = np.cross(up, way)
    side /= np.maximum(np.linalg.norm(side, axis=1), 1e-15)[:, None]
    radius = 0.5 * np.minimum(w, h)
    room = 0.5 * w - radius
    across = np.ceil(room / (_APART * radius) - 1e-6).astype(np.int64) + 1
    half = np.where(across > 1, room, 0.0)[:, None] * side
    return Balls(there(laid.tip) - radius[:, None] * up, half, radius, across, h)


def _blocks(count: int) -> Iterator[slice]:
    return (slice(first, min(first + _AT_ONCE, count)) for first in range(0, count, _AT_ONCE))


@njit
def _table(keys, bits):
    """Hash table of cell numbers by their keys (c): open addressing in 2^bits places."""
    table = np.full(1 << bits, -1, dtype=np.int64)
    last = (1 << bits) - 1
    for k in range(len(keys)):
        at = np.int64((np.uint64(keys[k]) * np.uint64(_MIXES)) >> np.uint64(64 - bits))
        while table[at] >= 0:
            at = (at + 1) & last
        table[at] = k
    return table


@njit
def _looks(tip, axis, often, reach):
    """Samples at which the tip, with the nozzle's turn at its reach, has moved by `often` [m] since the last."""
    out, count = np.empty(len(tip), np.int64), _ZERO
    for i in range(len(tip)):
        if count > 0:
            k, moved, turned = out[count - 1], 0.0, 0.0
            for x in range(3):
                moved += (tip[i, x] - tip[k, x]) ** 2
                turned += (axis[i, x] - axis[k, x]) ** 2
            if np.sqrt(moved) + reach * np.sqrt(turned) < often:
                continue
        out[count] = i
        count += 1
    return out[:count].copy()


@inner_njit
def outline_distance(profile, r, z):
    """Signed distance [m] of a point at radius r and height z above the tip from the nozzle's outline (k, 2), which
    extends upwards without end."""
    inside = z > 0.0
    best = np.inf
    for k in range(-1, len(profile)):
        az, ar = (profile[0, 0], 0.0) if k < 0 else (profile[k, 0], profile[k, 1])
        if k + 1 < len(profile):
            bz, br = profile[k + 1, 0], profile[k + 1, 1]
        else:
            bz, br = max(az, z) + 1.0, ar
        uz, ur = bz - az, br - ar
        length = uz * uz + ur * ur
        share = 0.0 if length == 0.0 else min(max(((z - az) * uz + (r - ar) * ur) / length, 0.0), 1.0)
        away = (z - az - share * uz) ** 2 + (r - ar - share * ur) ** 2
        best = min(best, away)
        if k >= 0 and az <= z < bz and r > ar + (z - az) / uz * ur:
            inside = False
    return -np.sqrt(best) if inside else np.sqrt(best)


@njit
def _deepest(rows, tip, axis, bead, looks, profile, reach, shaped):
    """The greatest overlap of the nozzle with balls laid earlier, as a share of their bead's height; its sample and
    row, or -1; the ball's distance from the tip [m]; and the greatest depth anywhere [m].

    Only balls within `reach` [m] of the tip are examined, and none of the bead being laid that lie on the last `shaped`
    [m] of the tip's path.
    """
    centre, half, radius, across, when, whose = rows.centre, rows.half, rows.radius, rows.across, rows.when, rows.bead
    height, lowest = rows.height, rows.height.min()
    first, since, key, table, low, wide, size = (
        rows.first, rows.since, rows.key, rows.table, rows.low, rows.wide, rows.size,
    )  # fmt: skip
    last, bits = len(table) - 1, 0
    while (1 << bits) < len(table):
        bits += 1
    thickest, widest = radius.max(), 0.0
    for i in range(len(half)):
        widest = max(widest, half[i, 0] ** 2 + half[i, 1] ** 2 + half[i, 2] ** 2)
    widest = np.sqrt(widest)
    span = 0.5 * np.sqrt(3.0) * size + thickest + widest
    best, where, which, apart, greatest = 0.0, _ZERO - 1, _ZERO - 1, 0.0, 0.0
    beat = 0.0  # m: no depth up to this is a greater share of any bead's height
    from_, to = np.empty(3, np.int64), np.empty(3, np.int64)
    for j in looks:
        p, a = tip[j], axis[j]
        for x in range(3):
            from_[x] = max(0, int(np.floor((p[x] - reach - widest - low[x]) / size)))
            to[x] = min(wide[x] - 1, int(np.floor((p[x] + reach + widest - low[x]) / size)))
        for cx in range(from_[0], to[0] + 1):
            for cy in range(from_[1], to[1] + 1):
                for cz in range(from_[2], to[2] + 1):
                    vx = low[0] + (cx + 0.5) * size - p[0]
                    vy = low[1] + (cy + 0.5) * size - p[1]
                    vz = low[2] + (cz + 0.5) * size - p[2]
                    z = -(vx * a[0] + vy * a[1] + vz * a[2])
                    if z < -span:
                        continue
                    r = np.sqrt(max(vx * vx + vy * vy + vz * vz - z * z, 0.0))
                    if outline_distance(profile, r, z) > span - beat:
                        continue
                    k = (cx * wide[1] + cy) * wide[2] + cz
                    at = np.int64((np.uint64(k) * np.uint64(_MIXES)) >> np.uint64(64 - bits))
                    while table[at] >= 0 and key[table[at]] != k:
                        at = (at + 1) & last
                    c = table[at]
                    if c < 0 or since[c] >= j:
                        continue
                    for i in range(first[c], first[c + 1]):
                        if when[i] >= j:
                            continue
                        hx, hy, hz = half[i, 0], half[i, 1], half[i, 2]
                        mx, my, mz = centre[i, 0] - p[0], centre[i, 1] - p[1], centre[i, 2] - p[2]
                        rise = abs(hx * a[0] + hy * a[1] + hz * a[2])
                        if rise - (mx * a[0] + my * a[1] + mz * a[2]) < beat - radius[i]:
                            continue  # the whole row is below the nozzle's face
                        for b in range(across[i]):
                            off = 2.0 * b / (across[i] - 1) - 1.0 if across[i] > 1 else 0.0
                            vx, vy, vz = mx + off * hx, my + off * hy, mz + off * hz
                            z = -(vx * a[0] + vy * a[1] + vz * a[2])
                            if z < beat - radius[i]:
                                continue
                            away = vx * vx + vy * vy + vz * vz
                            if away > (reach + radius[i]) ** 2:
                                continue
                            depth = radius[i] - outline_distance(profile, np.sqrt(max(away - z * z, 0.0)), z)
                            share = depth / height[i]
                            if share <= best and depth <= greatest:
                                continue
                            if whose[i] == bead[j] and _still_shaped(when[i], j, shaped, tip):
                                continue
                            greatest = max(greatest, depth)
                            if share > best:
                                best, where, which, apart, beat = share, j, i, np.sqrt(away), share * lowest
    return best, where, which, apart, greatest


@inner_njit
def _still_shaped(when, j, shaped, tip):
    """Whether the tip has moved at most `shaped` [m] along its path between an instant and sample j."""
    gone = 0.0
    for k in range(int(when), j):
        step = 0.0
        for x in range(3):
            step += (tip[k + 1, x] - tip[k, x]) ** 2
        gone += np.sqrt(step)
        if gone > shaped:
            return False
    return True
