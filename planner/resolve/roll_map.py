"""The roll × path map: which rolls of the nozzle are possible along a print, and what rules out the others."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planner.base.arrays import Array, ReadOnlyArrays
from planner.base.geometry import TURN, wrap_angle
from planner.base.processes import in_threads
from planner.base.singular_values import least_singular_values
from planner.cell.cell import Cell
from planner.collision.scene import NOTHING, Obstacles
from planner.resolve.by_nozzle import nozzles_of
from planner.resolve.joint_path import JointPath, flange_poses
from planner.toolpath.task import NozzleTask

# ----------------------------------------------------------------------------------------------------
# The roll × path map: which rolls of the nozzle are possible along a print, and what rules out the others.
#
# With tilt and all chosen joints (a positioner's axes) as planned, one number is left free at each place of the path:
# the roll. At each place and roll, the map holds whether the arm can take that posture and how far from trouble it then
# is, and at each place the roll that was chosen. A path is a curve through the free region.

FREE, REACH, LIMITS, SINGULAR, COLLISION = range(5)
REASONS = ("free", "out of reach", "joint limits", "singularity", "collision")  # by those numbers
COLUMNS, ROLLS = 450, 120  # of a map: as many as a picture shows, rolls 3 degrees apart
EVERY_COLUMN, EVERY_ROLL = 3, 2  # steps at which clearance is computed, then interpolated: it takes longest
CLEAR_ENOUGH = 0.02  # m: greater clearances are not distinguished
CLEAR_CLOSE = 1e-4  # m: an interpolated clearance that small is computed instead


@dataclass(frozen=True)
class RollMap(ReadOnlyArrays):
    """Places (m) along beads, and k rolls at each.

    Attributes:
        bead: Index (m,) of the bead.
        s: Arc length (m,) along it [m].
        along: Length (m,) deposited up to there [m].
        roll: Rolls (k,) from -pi on, evenly round the circle [rad], 0 as in the tasks' frames.
        chosen: The path's own roll (m,) in [-pi, pi) [rad]; NaN where there is no path yet.
        why: FREE (m, k), or the first reason why not: REACH, LIMITS, SINGULAR, COLLISION; see REASONS.
        sigma: Least singular value (m, k) of the arm's Jacobian (linear rows in metres); NaN out of reach or limits.
        limit: Least angle (m, k) from the limit of a joint that turns [rad], negative beyond; NaN out of reach.
        clearance: Clearance (m, k) in excess of what is needed [m], up to CLEAR_ENOUGH; it includes the nozzle's from
            the print near its tip, so it is small even where all is well. NaN where another reason comes first, or
            nothing can touch.
    """

    bead: NDArray[np.int32]
    s: Array
    along: Array
    roll: Array
    chosen: Array
    why: NDArray[np.uint8]
    sigma: Array
    limit: Array
    clearance: Array

    @property
    def reasons(self) -> tuple[str, ...]:
        """What the numbers in `why` mean."""
        return REASONS

    @property
    def free(self) -> NDArray[np.bool_]:
        """Where (m, k) the arm can take the posture."""
        return self.why == FREE


def roll_map(
    cell: Cell,
    paths: Sequence[JointPath],
    obstacles: Obstacles = NOTHING,
    min_sigma: float = 0.0,
    columns: int = COLUMNS,
    rolls: int = ROLLS,
    any_branch: bool = False,
) -> RollMap:
    """The map along joint paths, at their tilt and chosen joints.

    It is judged on each path's own branch of the arm, which cannot change along a bead, or on any branch, see
    `any_branch`.

    Args:
        cell: The cell that the paths are for.
        paths: The joint paths.
        obstacles: What postures are to be clear of; by default, nothing.
        min_sigma: Postures with a sigma below it count as singular.
        columns: Greatest number of places along the paths.
        rolls: Number of rolls at each place.
        any_branch: Whether each place is judged on whichever branch does best there, as it also is if a path has no
            branch.

    Returns:
        The map, place by place and roll by roll.
    """
    places = _places(paths, columns)
    m = len(places.s)
    roll = -np.pi + TURN * np.arange(rolls) / rolls
    q, exists = _postures(cell, places, roll)
    at = np.arange(m)
    if any_branch or (places.branch < 0).any():
        branches = [np.full(m, b) for b in range(q.shape[2])]
    else:
        branches = [places.branch]
    best = _judged(cell, places, q[at, :, branches[0]], exists[at, :, branches[0]], obstacles, min_sigma)
    for b in branches[1:]:
        best = _better(best, _judged(cell, places, q[at, :, b], exists[at, :, b], obstacles, min_sigma))
    return RollMap(places.bead, places.s, places.along, roll, wrap_angle(places.roll), *best)


@dataclass(frozen=True)
class _Places:
    """What is fixed at each place (m): the fields of `RollMap`, task and path there; now: when, in beads."""

    bead: NDArray[np.int32]
    s: Array
    along: Array
    tip: Array
    frames: Array
    now: Array
    roll: Array
    tilt: Array
    q: Array
    branch: NDArray[np.int64]


def _places(paths: Sequence[JointPath], columns: int) -> _Places:
    """Evenly spaced samples along the deposits of all paths."""
    laid = [slice(path.task.first, path.task.last + 1) for path in paths]
    s = [path.task.s[rows] - path.task.s[path.task.first] for path, rows in zip(paths, laid, strict=True)]
    before = np.cumsum([0.0, *(each[-1] for each in s)])
    along = np.concatenate([each + start for each, start in zip(s, before[:-1], strict=True)])
    wanted = np.linspace(0.0, along[-1], min(columns, len(along)))
    at = np.unique(np.clip(np.searchsorted(along, wanted), 0, len(along) - 1))
    pairs = list(zip(paths, laid, strict=True))
    counts = [len(each) for each in s]
    return _Places(
        bead=np.repeat([path.task.bead for path in paths], counts)[at].astype(np.int32),
        s=np.concatenate(s)[at],
        along=along[at],
        tip=np.concatenate([path.task.tip[rows] for path, rows in pairs])[at],
        frames=np.concatenate([path.task.frames[rows] for path, rows in pairs])[at],
        now=np.concatenate([path.task.moments[rows] for path, rows in pairs])[at],
        roll=np.concatenate([path.roll[rows] for path, rows in pairs])[at],
        tilt=np.concatenate([path.tilt[rows] for path, rows in pairs])[at],
        q=np.concatenate([path.q[rows] for path, rows in pairs])[at],
        branch=np.repeat([path.branch for path in paths], counts)[at],
    )


def _postures(cell: Cell, places: _Places, roll: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Arm joints (m, k, branches, na), up to whole turns, and which postures exist."""
    m, k, na, nh = len(places.s), len(roll), len(cell.arm), len(cell.holder)
    each = np.repeat(np.arange(m), k)
    task = NozzleTask(0, "", 0, places.tip[each], places.frames[each], each.astype(float), 0, len(each) - 1, 1.0)
    T = flange_poses(cell, task, np.tile(roll, m), places.tilt[each], places.q[each, na : na + nh])
    q, exists = cell.inverse.solve(T, places.q[each][:, list(cell.given)] if cell.given else None)
    return q.reshape(m, k, -1, na), exists.reshape(m, k, -1)


_Judgement = tuple[NDArray[np.uint8], Array, Array, Array]
_JUDGED = ("why", "sigma", "limit", "clearance")


def _judged(
    cell: Cell, places: _Places, arm: Array, exists: NDArray[np.bool_], obstacles: Obstacles, min_sigma: float
) -> _Judgement:
    """why, sigma, limit and clearance of arm postures (m, k, na), turned closest to the middle of their ranges."""
    na = len(cell.arm)
    low, high, turns = cell.limits.q_min[:na], cell.limits.q_max[:na], cell.limits.turns[:na]
    arm = arm - np.where(turns, TURN * np.round((arm - 0.5 * (low + high)) / TURN), 0.0)
    room = np.minimum(arm - low, high - arm)
    limit = room[:, :, turns].min(axis=2)
    limit[~exists] = np.nan
    why = np.where(exists, np.where((room < 0.0).any(axis=2), LIMITS, FREE), REACH).astype(np.uint8)
    sigma, clearance = np.full(why.shape, np.nan), np.full(why.shape, np.nan)
    inside = why == FREE
    sigma[inside], solved = _sigmas(cell, arm[inside])
    why[inside] = np.where(solved < min_sigma, SINGULAR, FREE)
    if obstacles.any:
        clearance = _clearances(
            places, np.concatenate([arm, _holder(cell, places, arm)], axis=2), why == FREE, obstacles
        )
        why[clearance < 0.0] = COLLISION
    return why, sigma, limit, clearance


def _sigmas(cell: Cell, q: Array) -> tuple[Array, Array]:
    """Least singular values (n) of the arm's Jacobian at postures q (n, na), as in `sigma_min`, and those for the six
    joints that are solved for, by which a search judges seven-axis arms."""
    columns = tuple(dict.fromkeys((tuple(range(cell.rails, len(cell.arm))), tuple(cell.solved))))
    out = np.empty((len(columns), len(q)))

    def part(first: int, last: int) -> None:
        jacobians = cell.arm.jacobians(q[first:last])
        for own, some in zip(out, columns, strict=True):
            own[first:last] = least_singular_values(jacobians[:, :, list(some)])

    in_threads(part, len(q))
    return out[0], out[-1]


def _holder(cell: Cell, places: _Places, arm: Array) -> Array:
    """The holder's joints (m, k, nh) at every roll of each place."""
    held = places.q[:, len(cell.arm) :]
    return np.broadcast_to(held[:, None], (*arm.shape[:2], held.shape[1]))


def _clearances(places: _Places, q: Array, asked: NDArray[np.bool_], obstacles: Obstacles) -> Array:
    """Clearance (m, k) of postures q (m, k, nj) where it is `asked` for, NaN elsewhere.

    Computed at every few places and rolls and interpolated linearly between them; computed directly where that comes
    close to contact, and where there is nothing to interpolate.
    """
    m, k = asked.shape
    known = np.full((m, k), np.nan)
    lattice = np.zeros((m, k), dtype=np.bool_)
    lattice[::EVERY_COLUMN, ::EVERY_ROLL] = True
    _find(places, q, asked & lattice, obstacles, known)
    i, j = np.meshgrid(np.arange(m), np.arange(k), indexing="ij")
    i0, j0 = i - i % EVERY_COLUMN, j - j % EVERY_ROLL
    i1, j1 = i0 + EVERY_COLUMN, np.where(j0 + EVERY_ROLL < k, j0 + EVERY_ROLL, 0)
    a, b = (i - i0) / EVERY_COLUMN, (j - j0) / EVERY_ROLL
    total, weights = np.zeros((m, k)), np.zeros((m, k))
    for row, column, weight in (
        (i0, j0, (1 - a) * (1 - b)),
        (i0, j1, (1 - a) * b),
        (i1, j0, a * (1 - b)),
        (i1, j1, a * b),
    ):
        inner = np.minimum(row, m - 1)
        value = known[inner, column]
        use = np.where((row < m) & (places.bead[inner] == places.bead[i]) & np.isfinite(value), weight, 0.0)
        total += use * np.nan_to_num(value)
        weights += use
    drawn = np.divide(total, weights, out=np.full((m, k), np.nan), where=weights > 0.0)
    out = np.where(asked, np.where(lattice, known, drawn), np.nan)
    _find(places, q, asked & ~lattice & ~(np.abs(out) > CLEAR_CLOSE), obstacles, out)
    return out


def _find(places: _Places, q: Array, which: NDArray[np.bool_], obstacles: Obstacles, out: Array) -> None:
    """Fill in the clearances of some postures."""
    some, now = q[which], np.broadcast_to(places.now[:, None], which.shape)[which]
    found = np.empty(len(some))

    def part(first: int, last: int) -> None:
        found[first:last] = obstacles.margins(some[first:last], now[first:last], CLEAR_ENOUGH)[0]

    in_threads(part, len(some))
    out[which] = found


def _better(one: _Judgement, other: _Judgement) -> _Judgement:
    """The better of two branches at each place and roll, by the reason; on a tie, the less singular one."""
    further = np.array([4, 0, 1, 2, 3])  # ranks of the reasons, best first: free, collision, singularity, limits, reach
    a, b = further[one[0]], further[other[0]]
    second = (b > a) | ((b == a) & (np.nan_to_num(other[1]) > np.nan_to_num(one[1])))
    why = np.where(second, other[0], one[0])
    sigma, limit, clearance = (np.where(second, y, x) for x, y in zip(one[1:], other[1:], strict=True))
    return why, sigma, limit, clearance


# ----------------------------------------------------------------------------------------------------
# The roll × path maps that a plan carries: of the whole print, and of the beads where it is tightest.

BEAD_COLUMNS = 150  # of the map of a bead
FINEST = 1e-3  # m that a column stands for, at least
_FEW = 50  # places of a path at which it is compared with others


def roll_maps(cell: Cell, paths: Sequence[JointPath], obstacles: Obstacles, min_sigma: float) -> tuple[RollMap, ...]:
    """The map of all paths; then those of the beads that come nearest to a singularity and to an end stop.

    Only the first if there are few beads, since it then shows them well.
    """
    parts: list[RollMap] = []
    around: dict[int, tuple[Cell, Obstacles]] = {}
    columns = _columns(paths, COLUMNS)
    for own, which in nozzles_of(cell, paths):
        there = obstacles.for_nozzle(cell, own)
        mine = [paths[i] for i in which]
        around |= dict.fromkeys(which, (own, there))
        parts.append(roll_map(own, mine, there, min_sigma, max(round(columns * len(mine) / len(paths)), 2)))
    whole = parts[0] if len(parts) == 1 else _in_order(parts, paths)
    if len(paths) * BEAD_COLUMNS <= len(whole.s):
        return (whole,)
    tightest = _tightest([around[i][0] for i in range(len(paths))], paths)
    single = [
        roll_map(around[i][0], [paths[i]], around[i][1], min_sigma, _columns([paths[i]], BEAD_COLUMNS))
        for i in tightest
    ]
    return (whole, *single)


def _in_order(parts: Sequence[RollMap], paths: Sequence[JointPath]) -> RollMap:
    """Maps of the beads of several nozzles as one, in the order of the beads."""
    lengths = [path.task.s[path.task.last] - path.task.s[path.task.first] for path in paths]
    before = dict(zip((path.task.bead for path in paths), np.cumsum([0.0, *lengths]), strict=False))
    each = {name: [getattr(part, name) for part in parts] for name in ("bead", "s", "chosen", *_JUDGED)}
    rows = {name: np.concatenate(values) for name, values in each.items()}
    order = np.argsort(rows["bead"], kind="stable")
    rows = {name: values[order] for name, values in rows.items()}
    along = np.array([before[bead] for bead in rows["bead"].tolist()]) + rows["s"]
    return RollMap(along=along, roll=parts[0].roll, **rows)


def _columns(paths: Sequence[JointPath], most: int) -> int:
    length = sum(float(path.task.s[path.task.last] - path.task.s[path.task.first]) for path in paths)
    return min(max(round(length / FINEST), 2), most)


def _tightest(cells: Sequence[Cell], paths: Sequence[JointPath]) -> tuple[int, ...]:
    """Indices of the paths, each in its cell, that come nearest to a singularity and to the end of the range of an arm
    joint that turns, in this order."""
    na = len(cells[0].arm)
    turns = cells[0].limits.turns[:na]
    sigma, limit = [], []
    for cell, path in zip(cells, paths, strict=True):
        arm = path.q[path.task.first : path.task.last + 1, :na]
        jacobians = cell.arm.jacobians(arm[:: max(len(arm) // _FEW, 1)])[:, :, cell.rails :]
        sigma.append(least_singular_values(jacobians).min())
        limit.append(np.minimum(arm - cell.limits.q_min[:na], cell.limits.q_max[:na] - arm)[:, turns].min())
    return tuple(dict.fromkeys((int(np.argmin(sigma)), int(np.argmin(limit)))))
