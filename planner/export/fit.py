"""The fewest targets between which a controller's lines keep to a trajectory, within all tolerances."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planner.base.arrays import Array, Flags, Indices
from planner.base.compiled import njit

# ----------------------------------------------------------------------------------------------------
# Unit quaternions, x y z w, in batches.


def continuous(quat: Array) -> Array:
    """Quaternions (n, 4), normalised, each of the sign that lies nearer to its predecessor."""
    quat = quat / np.linalg.norm(quat, axis=1, keepdims=True)
    flips = np.einsum("ij,ij->i", quat[1:], quat[:-1]) < 0.0
    sign = np.concatenate([[1.0], np.cumprod(np.where(flips, -1.0, 1.0))])
    out: Array = quat * sign[:, None]
    return out


def slerp(a: Array, b: Array, u: Array) -> Array:
    """Quaternions (n, 4) at the fraction u (n) of the shorter great arc from a to b (n, 4)."""
    dot = np.einsum("ij,ij->i", a, b)
    b = np.where(dot[:, None] < 0.0, -b, b)
    omega = np.arccos(np.clip(np.abs(dot), 0.0, 1.0))
    near = omega < 1e-6  # sin(k w) / sin(w) tends to k
    sine = np.where(near, 1.0, np.sin(omega))
    wa = np.where(near, 1.0 - u, np.sin((1.0 - u) * omega) / sine)
    wb = np.where(near, u, np.sin(u * omega) / sine)
    out: Array = wa[:, None] * a + wb[:, None] * b
    return out


def lerp(values: Array, a: Indices, b: Indices, u: Array) -> Array:
    """Values (n, ...) at the fraction u (n) of the way from rows a (n) to rows b (n) of a table."""
    out: Array = values[a] + u.reshape(-1, *[1] * (values.ndim - 1)) * (values[b] - values[a])
    return out


def angle(a: Array, b: Array) -> Array:
    """Angles (n) between orientations a and b (n, 4) [rad]."""
    sign = np.where(np.einsum("ij,ij->i", a, b) < 0.0, -1.0, 1.0)[:, None]
    # half the chord on the sphere of quaternions: stays accurate where arccos does not
    out: Array = 4.0 * np.arcsin(np.clip(0.5 * np.linalg.norm(a - sign * b, axis=1), 0.0, 1.0))
    return out


def from_matrix(R: Array) -> Array:
    """Quaternions (n, 4), w >= 0, of rotation matrices (n, 3, 3): the largest component is found first (Shepperd)."""
    d = np.einsum("nii->ni", R)
    trace = d.sum(axis=1)
    squares = 0.25 * np.column_stack([1.0 + 2.0 * d - trace[:, None], 1.0 + trace])
    K = np.empty((len(R), 4, 4))  # q q^T: each row is the quaternion, times one of its own components
    for i in range(4):
        K[:, i, i] = squares[:, i]
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        K[:, i, j] = K[:, j, i] = 0.25 * (R[:, i, j] + R[:, j, i])
        K[:, k, 3] = K[:, 3, k] = 0.25 * (R[:, j, i] - R[:, i, j])
    largest = np.argmax(squares, axis=1)
    q = K[np.arange(len(R)), largest]
    q = q / np.linalg.norm(q, axis=1, keepdims=True)
    out: Array = np.where(q[:, 3:] < 0.0, -q, q)
    return out


def to_matrix(quat: Array) -> Array:
    """Rotation matrices (n, 3, 3) of unit quaternions (n, 4)."""
    x, y, z, w = quat.T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), -1, 0)


# ----------------------------------------------------------------------------------------------------
# Sharp turns: targets near enough that a corner zone does not cut them off.

ZONE = 0.3e-3  # m, of the targets of linear moves (RAPID's z0); controllers cut it to half of the neighbouring lines


def closer_at_turns(sample: Indices, tip: Array, target: Array, turns: Flags, most: float) -> Indices:
    """Samples (m, sorted) that are targets, and what must be added for no corner to be cut by more than `most` [m].

    Within a zone controllers fly a parabola. Where that passes too far inside of the sample's tip (n, 3), targets (n, 3)
    halfway to its neighbours make the zone smaller and the turn less sharp. turns (n) says at which samples this counts.
    """
    while True:
        a, k, b = sample[:-2], sample[1:-1], sample[2:]
        before, after = target[k] - target[a], target[b] - target[k]
        far_a, far_b = np.linalg.norm(before, axis=1), np.linalg.norm(after, axis=1)
        with np.errstate(invalid="ignore"):  # lines without length: nothing is cut there
            swing = after / far_b[:, None] - before / far_a[:, None]
        middle = target[k] + 0.25 * np.minimum(ZONE, 0.5 * np.minimum(far_a, far_b))[:, None] * swing
        bad = turns[k] & (np.linalg.norm(middle - tip[k], axis=1) > most)
        more = np.unique(np.concatenate([sample, (a[bad] + k[bad]) // 2, (k[bad] + b[bad] + 1) // 2]))
        if len(more) == len(sample):
            return sample
        sample = more


# ----------------------------------------------------------------------------------------------------
# Misfits: all tolerances of a line between targets, over all its samples.

TERMS = ("chord", "orientation", "station", "time", "tangent", "flow", "length")  # what can keep a line short
LEAST_STEP = 1e-9  # [m] between samples: a shorter one, at rest, has no direction
SHORT = 1e-14  # [m^2], square of a line's length: a shorter one has no nearest point, and shares follow the samples
EVEN = 0.01  # rad between quaternions: nearer ones are interpolated evenly, which adds 0.003 deg at most
HOPELESS = 16.0  # tolerances: by how much more a line misses changes nothing


@dataclass(frozen=True)
class Poses:
    """Poses of the nozzle in the part, and the station's axes there, before them what carries the arm.

    table (n, 7 + k): position [m], quaternion x y z w, the station's free axes [rad, m]
    """

    table: Array

    @property
    def position(self) -> Array:
        """(n, 3) [m]."""
        return self.table[:, :3]

    @property
    def quat(self) -> Array:
        """(n, 4) x y z w."""
        return self.table[:, 3:7]

    @property
    def station(self) -> Array:
        """(n, k) [rad]."""
        return self.table[:, 7:]


@dataclass(frozen=True)
class SampledWay:
    """What lines have to follow (n samples).

    poses      of the samples, their quaternions sign-continuous
    clock      (n)  time without waits [s]
    path       (n)  length [m]
    fed        (n)  filament that is to flow evenly [m], all 0 for none
    laid       (n)  material flows: time, tangent and flow count
    tolerance  (7)  of each of TERMS [m, rad, rad, s, rad, m, m]
    """

    poses: Poses
    clock: Array
    path: Array
    fed: Array
    laid: Flags
    tolerance: Array


def misfits(way: SampledWay, targets: Poses, first: Indices, last: Indices) -> Array:
    """How far lines from the targets of samples first to those of last (s) miss the samples between: (s, 7), by TERMS.

    In tolerances, the worst sample of each; 0 where there is none between. Where one is HOPELESS the others may be too
    small. targets: what one would be at each sample.
    """
    own = (way.poses.table, way.clock, way.path, way.fed, way.laid)
    return _misfits(*own, targets.table, first, last, way.tolerance)


@njit(cache=True)
def fraction(a: Array, b: Array, p: Array, otherwise: float) -> float:
    """Where the line from the pose a to b is nearest to the pose p, from 0 to 1; `otherwise` if it has no length."""
    square, along = 0.0, 0.0
    for j in range(3):
        square += (b[j] - a[j]) ** 2
        along += (p[j] - a[j]) * (b[j] - a[j])
    if square < SHORT:
        return otherwise
    return min(max(along / square, 0.0), 1.0)


@njit(cache=True)
def great_arc(a: Array, b: Array) -> tuple[float, float]:
    """Angle [rad] between the quaternions of poses a and b, 0 if it hardly matters, and the sign that b takes."""
    dot = 0.0
    for j in range(3, 7):
        dot += a[j] * b[j]
    omega = np.arccos(min(abs(dot), 1.0))
    return (omega if omega > EVEN else 0.0), (-1.0 if dot < 0.0 else 1.0)


@njit(cache=True)
def between(a: Array, b: Array, u: float, omega: float, sign: float, out: Array) -> None:
    """What a controller makes of the fraction u of a line from pose a to b: even, the orientation on `great_arc`."""
    for j in range(len(a)):
        out[j] = a[j] + u * (b[j] - a[j])
    wa, wb = 1.0 - u, u
    if omega > 0.0:
        sine = np.sin(omega)
        wa, wb = np.sin((1.0 - u) * omega) / sine, np.sin(u * omega) / sine
    for j in range(3, 7):
        out[j] = wa * a[j] + sign * wb * b[j]


@njit(cache=True)
def _misfits(
    pose: Array,
    clock: Array,
    path: Array,
    fed: Array,
    laid: Flags,
    target: Array,
    first: Indices,
    last: Indices,
    tolerance: Array,
) -> Array:
    """`misfits`."""
    out = np.zeros((len(first), len(TERMS)))
    made = np.empty(pose.shape[1])
    for i in range(len(first)):
        a, b = first[i], last[i]
        if b - a < 2:
            continue
        out[i, 6] = ((path[b] - path[a]) / tolerance[6]) ** 2
        if out[i, 6] > HOPELESS:
            continue
        p, q, took = target[a], target[b], clock[b] - clock[a]
        omega, sign = great_arc(p, q)
        off, turned, axis, late, lean, uneven = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        for k in range(a, b):
            if laid[k] and laid[k + 1]:
                lean = max(lean, _lean(p, q, pose[k], pose[k + 1]))
            if k == a:
                continue
            u = fraction(p, q, pose[k], (k - a) / (b - a))
            between(p, q, u, omega, sign, made)
            square, near, far = 0.0, 0.0, 0.0
            for j in range(3):
                square += (made[j] - pose[k, j]) ** 2
            for j in range(3, 7):
                near += (made[j] - pose[k, j]) ** 2
                far += (made[j] + pose[k, j]) ** 2
            off, turned = max(off, square), max(turned, min(near, far))
            for j in range(7, len(made)):
                axis = max(axis, abs(made[j] - pose[k, j]))
            if laid[k]:
                late = max(late, abs(clock[a] + u * took - clock[k]))
                even = fed[a] + (clock[k] - clock[a]) / max(took, 1e-9) * (fed[b] - fed[a])
                uneven = max(uneven, abs(even - fed[k]))
            if off > HOPELESS**2 * tolerance[0] ** 2:
                break
        # half the chord on the sphere of quaternions: stays accurate where arccos does not
        angle = 4.0 * np.arcsin(min(0.5 * np.sqrt(turned), 1.0))
        out[i, :6] = np.array([np.sqrt(off), angle, axis, late, np.arctan(lean), uneven]) / tolerance[:6]
    return out


@njit(cache=True)
def _lean(a: Array, b: Array, p: Array, q: Array) -> float:
    """Tangent of the angle between the line from a to b and the step from p to q; 0 where one has no direction."""
    lx, ly, lz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    sx, sy, sz = q[0] - p[0], q[1] - p[1], q[2] - p[2]
    if sx * sx + sy * sy + sz * sz <= LEAST_STEP**2:
        return 0.0
    x, y, z = ly * sz - lz * sy, lz * sx - lx * sz, lx * sy - ly * sx
    sine, cosine = np.sqrt(x * x + y * y + z * z), lx * sx + ly * sy + lz * sz
    if sine == 0.0:
        return 0.0
    return sine / cosine if cosine > 0.0 else np.inf


# ----------------------------------------------------------------------------------------------------
# The fewest targets: spans of samples are split until interpolation meets every sample between.

# (first, last, k) → how far interpolation between samples first and last misses sample k, in tolerances
Misfit = Callable[[Indices, Indices, Indices], Array]
# (first, last) → the worst of that over the samples between them; 0 where there is none
Judge = Callable[[Indices, Indices], Array]
MOST_PARTS = 4
LANE = 200  # targets that are chosen one after the other; as many lanes as there are go on at the same time
ENOUGH = 0.95  # misfit of a span that is as good as the longest one
SHORTER = 0.98  # of what the misfit says of the longest span
GUESSES = 4  # at the longest span before its bounds are halved


def fewest(kept: Indices, judge: Judge) -> Indices:
    """As `thin`, with fewer targets, for more work.

    `thin` leaves many spans that fit too well: stretches of some hundreds of them are gone through again, from target to
    target as far as each reaches.
    """
    found = thin(kept, judge)
    within = np.arange(len(found)) - np.searchsorted(found, kept)[np.searchsorted(kept, found, side="right") - 1]
    lanes = found[within % LANE == 0]
    reached = _farthest(lanes, judge)
    fewer = np.diff(np.searchsorted(reached, lanes)) < np.diff(np.searchsorted(found, lanes))
    return np.unique(np.concatenate([lanes, _within(lanes, found, ~fewer), _within(lanes, reached, fewer)]))


def _within(lanes: Indices, found: Indices, chosen: NDArray[np.bool_]) -> Indices:
    """Those of `found` that stand in the chosen lanes."""
    owner = np.clip(np.searchsorted(lanes, found, side="right") - 1, 0, len(chosen) - 1)
    return found[chosen[owner]]


def _farthest(lanes: Indices, judge: Judge) -> Indices:
    """Targets of each lane, each as far from the one before as misfit allows, or nearly."""
    found = [lanes]
    at, end = lanes[:-1].copy(), lanes[1:]
    fits, misses, tried = at + 1, end + 1, np.zeros(len(at), dtype=np.intp)  # bounds of the longest span's end
    guess = np.minimum(at + np.maximum((end - at) // LANE, 1), end)
    going = np.flatnonzero(at < end)
    while len(going):
        a, g = at[going], guess[going]
        worst = judge(a, g)
        good = worst <= 1.0
        fits[going] = np.where(good, g, fits[going])
        misses[going] = np.where(good, misses[going], g)
        tried[going] += 1
        low, high = fits[going], misses[going]
        done = (high - low <= 1) | (low == end[going]) | (good & (worst >= ENOUGH))
        step = (g - a) * SHORTER / np.sqrt(np.maximum(worst, 0.05))
        ahead = np.where(tried[going] < GUESSES, a + step.astype(np.intp), (low + high) // 2)
        guess[going] = np.clip(ahead, low + 1, np.maximum(high - 1, low + 1))
        arrived = going[done]
        length = fits[arrived] - at[arrived]
        at[arrived] = fits[arrived]
        found.append(fits[arrived])
        fits[arrived], misses[arrived], tried[arrived] = at[arrived] + 1, end[arrived] + 1, 0
        guess[arrived] = np.minimum(at[arrived] + length, end[arrived])
        going = going[at[going] < end[going]]
    return _balanced(lanes, np.unique(np.concatenate(found)), judge)


def _balanced(lanes: Indices, found: Indices, judge: Judge) -> Indices:
    """The same, with what was left over at the end of a lane shared with the span before, where that fits too."""
    last = np.searchsorted(found, lanes[1:])
    last = last[last - np.searchsorted(found, lanes[:-1]) >= 2]
    begin, end = found[last - 2], found[last]
    middle = (begin + end) // 2
    fits = np.maximum(judge(begin, middle), judge(middle, end)) <= 1.0
    found[last[fits] - 1] = middle[fits]
    return found


def by_samples(misfit: Misfit) -> Judge:
    """A judge of spans by the misfit of each sample within."""

    def judge(first: Indices, last: Indices) -> Array:
        out = np.zeros(len(first))
        inner = last - first - 1
        some = inner > 0
        if some.any():
            first, last, inner = first[some], last[some], inner[some]
            offset = np.concatenate([[0], np.cumsum(inner)[:-1]])
            k = np.arange(int(inner.sum())) - np.repeat(offset - first - 1, inner)
            out[some] = np.maximum.reduceat(misfit(np.repeat(first, inner), np.repeat(last, inner), k), offset)
        return out

    return judge


def thin(kept: Indices, judge: Judge) -> Indices:
    """Sorted sample indices: `kept` (sorted, unique, never dropped) and what must be added to bring misfit to <= 1.

    All spans are judged at once, level by level. A span that misses by e tolerances is cut into about sqrt(e)
    equal parts: this gives few targets in few passes.
    """
    found = [kept]
    first, last = kept[:-1], kept[1:]
    while True:
        worst = judge(first, last)
        bad = ~(worst <= 1.0)
        if not bad.any():
            return np.unique(np.concatenate(found))
        first, last, worst = first[bad], last[bad], worst[bad]
        parts = np.clip(np.ceil(np.sqrt(worst)), 2, np.minimum(MOST_PARTS, last - first)).astype(np.intp)
        owner = np.repeat(np.arange(len(first)), parts)
        part = np.arange(len(owner)) - np.repeat(np.cumsum(parts) - parts, parts)
        length = (last - first)[owner]
        first, last = (
            first[owner] + length * part // parts[owner],
            first[owner] + length * (part + 1) // parts[owner],
        )
        found.append(first)


# ----------------------------------------------------------------------------------------------------
# Targets beside the path, so that fewer are enough: lines between them pass it on both sides.
#
# A line between two points of a bend misses the path between them on one side only. Where both points lie outside of the
# bend by half of what a line may miss, it may be longer by a factor of sqrt(1.5) and still miss the path by no more. What
# holds for positions holds for orientations and the station's axes as well.

OFF = 0.5  # of the tolerances: how far targets may lie beside the path
TINY = 1e-15  # m, rad: keeps what is not moved from dividing by nothing
SHARE = 0.5  # of what a usual line misses at its middle; it is within its tolerance, so that this is within OFF of it


def chosen_targets(
    way: SampledWay, kept: Indices, linear: Flags, cornered: Flags, joint: Judge, chord: float
) -> tuple[Indices, Poses]:
    """Samples (m) that become targets, `kept` (sorted) among them, and the targets (m).

    linear (n - 1) flags the steps between samples that belong to lines; `joint` judges spans of the others. At the samples
    `cornered` (n) no zone may cut off more than `chord` [m]. Kept samples have their targets on the path, and so have
    all between two of them where it takes no fewer to leave it. The count is near the least, by a few per cent: each
    line reaches as far as it can, but a target has one place beside the path, and not a choice of all.
    """

    def enough(targets: Poses, settled: Indices, joint: Judge) -> Indices:
        sample = fewest(settled, _judge(way, targets, linear, joint))
        return closer_at_turns(sample, way.poses.position, targets.position, cornered, chord)

    plain = enough(way.poses, kept, joint)
    beside = outwards(way, _offset_limit(plain, kept, linear))
    travel = plain[:-1][~linear[plain[:-1]]]  # which stays as it is, so that it need not be judged again
    found = enough(beside, np.union1d(kept, travel), lambda first, last: np.zeros(len(first)))
    fewer = np.diff(np.searchsorted(found, kept)) < np.diff(np.searchsorted(plain, kept))
    owner = np.clip(np.searchsorted(kept, np.arange(len(way.clock)), side="right") - 1, 0, len(fewer) - 1)
    sample = np.unique(np.concatenate([kept, found[fewer[owner[found]]], plain[~fewer[owner[plain]]]]))
    moved = fewer[owner[sample], None]
    return sample, Poses(np.where(moved, beside.table[sample], way.poses.table[sample]))


def outwards(way: SampledWay, reach: Array) -> Poses:
    """Poses moved off the way to the outer side of its bends, by half of what a usual line misses there.

    reach (n) is half of a usual line around each sample, in samples; 0 leaves the target where it is.
    """
    return Poses(_outwards(way.poses.table, reach, OFF * way.tolerance[:3]))


def _judge(way: SampledWay, targets: Poses, linear: Flags, joint: Judge) -> Judge:
    """How far the controller's interpolation between two samples' targets misses the samples between, in tolerances."""

    def judge(first: Indices, last: Indices) -> Array:
        out = np.empty(len(first))
        line = linear[first]
        out[line] = misfits(way, targets, first[line], last[line]).max(axis=1, initial=0.0)
        out[~line] = joint(first[~line], last[~line])
        return out

    return judge


def _offset_limit(sample: Indices, kept: Indices, linear: Flags) -> Array:
    """Half of a usual line around each sample (n) [samples], never beyond what is kept; 0 outside of lines."""
    at = np.arange(len(linear) + 1)
    half = np.interp(at, 0.5 * (sample[1:] + sample[:-1]), 0.5 * np.diff(sample))
    k = np.searchsorted(kept, at)
    edge = np.minimum(at - kept[np.maximum(k - 1, 0)], kept[k] - at)
    within = np.append(linear, False) & np.append(False, linear)
    out: Array = np.where(within, np.minimum(half, edge), 0.0)
    return out


@njit(cache=True)
def _at(values: Array, place: float, out: Array) -> None:
    """Row of values at a place between two samples."""
    i = min(int(place), len(values) - 2)
    for j in range(values.shape[1]):
        out[j] = values[i, j] + (place - i) * (values[i + 1, j] - values[i, j])


@njit(cache=True)
def _outwards(pose: Array, reach: Array, most: Array) -> Array:
    """`outwards`; most (3): of positions [m], orientations and the station's axes [rad]."""
    out, width = pose.copy(), pose.shape[1]
    a, b, off = np.empty(width), np.empty(width), np.empty(width)
    for k in range(len(pose)):
        if reach[k] <= 0.0:
            continue
        _at(pose, k - reach[k], a)
        _at(pose, k + reach[k], b)
        omega, sign = great_arc(a, b)
        between(a, b, fraction(a, b, pose[k], 0.5), omega, sign, off)
        for j in range(width):
            off[j] = SHARE * (pose[k, j] - off[j])
        moved = np.sqrt(np.sum(off[:3] ** 2))
        turned = 2.0 * np.sqrt(np.sum(off[3:7] ** 2))  # a rotation is twice the angle of its quaternions
        for j in range(3):
            out[k, j] += off[j] * min(1.0, most[0] / max(moved, TINY))
        for j in range(3, 7):
            out[k, j] += off[j] * min(1.0, most[1] / max(turned, TINY))
        out[k, 3:7] /= np.sqrt(np.sum(out[k, 3:7] ** 2))
        for j in range(7, width):
            out[k, j] += min(max(off[j], -most[2]), most[2])
    return out
