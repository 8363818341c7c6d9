"""The fewest lines and arcs that follow a trajectory within tolerance, none shorter than a controller's least time."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from planner.base.arrays import Array, Flags, Indices
from planner.base.compiled import inner_njit, njit
from planner.base.processes import in_threads

# ----------------------------------------------------------------------------------------------------
# What the primitives follow, and how closely.

# What can limit a primitive. The chord and the nozzle's axis affect the print; rotation about that axis and the
# station's axes do not.
TERMS = ("chord", "axis", "roll", "station", "time", "tangent", "flow", "length")


@dataclass(frozen=True)
class Poses:
    """Poses of the nozzle in the part, with the axes of the arm's carrier and then the station's.

    table (n, 7 + k): position [m], quaternion x y z w, free axes of carrier and station [rad, m]
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


class SampledWay(NamedTuple):
    """A trajectory to follow (n samples), as the kernels take it.

    pose       (n, 7 + k) as the table of `Poses`, quaternions sign-continuous
    aim        (n, 7 + k) what a target at each sample would be: the pose, perhaps turned a little
    clock      (n)  time without waits [s]
    path       (n)  length [m]
    fed        (n)  filament that must flow evenly [m], all 0 for none
    laid       (n)  material flows: time, tangent and flow matter
    tolerance  (2, 8)  of each of TERMS [m, rad, rad, 1, s, rad, m, m]: where nothing is laid, and where material is
    free       (k)  tolerance of each axis of carrier and station [rad, m]
    """

    pose: Array
    aim: Array
    clock: Array
    path: Array
    fed: Array
    laid: Flags
    tolerance: Array
    free: Array


@dataclass(frozen=True)
class Fitted:
    """k primitives.

    sample    (k) index of the sample at which each ends, sorted
    circular  (k) an arc; otherwise a straight line
    via       (k, 3) the middle of the arc [m]; the target's position for lines
    aim       (n, 7 + k) what a target at each sample is
    """

    sample: Indices
    circular: Flags
    via: Array
    aim: Array


class FitRules(NamedTuple):
    """How primitives are chosen.

    arcs    arcs are allowed
    least   least time that a primitive should take [s]
    widest  how far tolerances may be widened to that end, as a multiple of the usual ones
    """

    arcs: bool
    least: float
    widest: float


def fit(way: SampledWay, first: Indices, last: Indices, rules: FitRules) -> Fitted:
    """The fewest primitives along stretches from samples `first` to `last` (s, sorted), with targets at both ends.

    The count is the least that the tolerances allow, or nearly, and the primitives' times are as even as possible for
    that count. Where some take less than the least time, they and their neighbours are chosen again with wider
    tolerances, widened no more than the least time requires. Those that remain shorter are needed to keep to the widest
    tolerances.
    """
    plain, via = _fitted(way, way, first, last, rules)
    aimed = way._replace(
        aim=_outwards(way, _half_of_usual(plain, first, last, len(way.clock)), OFF * way.tolerance[1, 1])
    )
    kind, via = _fitted(way, aimed, first, last, rules)
    sample = np.flatnonzero(kind)
    aim = np.where(kind[:, None] & AIMED, aimed.aim, way.aim)
    return Fitted(sample, kind[sample] & ARC == ARC, via[sample], aim)


def misfits(way: SampledWay, first: Indices, last: Indices, circular: Flags, via: Array) -> Array:
    """How far primitives from samples `first` to `last` (k) miss those between, in tolerances: (k, 8), by TERMS."""
    return _misfits(way, first, last, circular, via)


# ----------------------------------------------------------------------------------------------------
# How far one primitive misses the samples that it passes.

NONE, LINE, ARC, AIMED = 0, 1, 2, 4  # AIMED is added where the target is not the sample's pose
LEAST_STEP = 1e-9  # [m] between samples; a shorter step, at rest, has no direction
SHORT = 1e-14  # [m^2], squared length; a shorter line has no nearest point, and shares follow the samples
EVEN = 0.01  # [rad] between quaternions; closer ones are interpolated linearly, which adds 0.003 deg at most
# Controllers require points of an arc to be 0.1 mm apart, and 1 deg between via point and end as seen from the
# beginning, a quarter of the swept angle (ABB, RAPID reference, MoveC); beyond half a circle, via points say less.
LEAST_CHORD = 0.4e-3  # [m]
LEAST_SWEPT, MOST_SWEPT = np.radians(4.4), np.radians(175.0)
USUAL_STEP = 8  # samples: first step when the reach of a stretch's first primitive is searched
HOPELESS = 4.0  # tolerances beyond which an arc's height is not corrected


@inner_njit
def great_arc(a: Array, b: Array) -> tuple[float, float]:
    """Angle [rad] between the quaternions of poses a and b, 0 if at most EVEN, and the sign to give to b."""
    dot = 0.0
    for j in range(3, 7):
        dot += a[j] * b[j]
    omega = np.arccos(min(abs(dot), 1.0))
    return (omega if omega > EVEN else 0.0), (-1.0 if dot < 0.0 else 1.0)


# Kernels use loops where slices would do: each slice takes seconds to compile.


@inner_njit
def _first_from(values: Array, low: int, high: int, value: float) -> int:
    """Index of the first of values[low:high], ascending, that is not below `value`; `high` if there is none."""
    while low < high:
        middle = (low + high) // 2
        if values[middle] < value:
            low = middle + 1
        else:
            high = middle
    return low


# a plain 0 as an argument has another type, for which kernels would be compiled again
_FIRST: Any = np.int64(0)
_NONE: Any = np.int64(-1)
_USUAL: Any = np.int64(USUAL_STEP)


@inner_njit
def _copy(source: Indices, first: int, count: int, target: Indices, to: int) -> None:
    """Copy `count` numbers of `source`, from index `first` on, into `target`, from index `to` on."""
    for j in range(count):
        target[to + j] = source[first + j]


@inner_njit
def _circle(way: SampledWay, a: int, b: int, raised: float, circle: Array) -> bool:
    """The arc from sample a to b through the middle of the path between, `raised` [m] higher above its chord.

    circle (11): swept angle [rad], radius, centre (3), e1 (3), e2 (3) as in `LinesAndArcs`; returns whether controllers
    accept it.
    """
    pose, path = way.pose, way.path
    half = 0.5 * (path[a] + path[b])
    k = min(max(_first_from(path, a, b + 1, half) - 1, a), b - 1)
    step = path[k + 1] - path[k]
    u = (half - path[k]) / step if step > 0.0 else 0.0
    x0, x1, x2 = pose[b, 0] - pose[a, 0], pose[b, 1] - pose[a, 1], pose[b, 2] - pose[a, 2]
    length = np.sqrt(x0 * x0 + x1 * x1 + x2 * x2)
    if length < LEAST_CHORD:
        return False
    x0, x1, x2 = x0 / length, x1 / length, x2 / length
    v0 = pose[k, 0] + u * (pose[k + 1, 0] - pose[k, 0]) - pose[a, 0]
    v1 = pose[k, 1] + u * (pose[k + 1, 1] - pose[k, 1]) - pose[a, 1]
    v2 = pose[k, 2] + u * (pose[k + 1, 2] - pose[k, 2]) - pose[a, 2]
    along = v0 * x0 + v1 * x1 + v2 * x2
    y0, y1, y2 = v0 - along * x0, v1 - along * x1, v2 - along * x2
    height = np.sqrt(y0 * y0 + y1 * y1 + y2 * y2)
    if height < LEAST_STEP:
        return False
    y0, y1, y2 = y0 / height, y1 / height, y2 / height
    below = (along * (length - along) - height * height) / (2.0 * height)
    radius = np.sqrt(0.25 * length * length + below * below)
    top = radius - below + raised
    if top < LEAST_STEP:
        return False
    radius = 0.5 * top + 0.125 * length * length / top
    below = radius - top
    swept = 2.0 * np.arctan2(0.5 * length, below)
    if swept < LEAST_SWEPT or swept > MOST_SWEPT:
        return False
    cosine, sine = below / radius, 0.5 * length / radius
    circle[0], circle[1] = swept, radius
    circle[2] = pose[a, 0] + 0.5 * length * x0 - below * y0
    circle[3] = pose[a, 1] + 0.5 * length * x1 - below * y1
    circle[4] = pose[a, 2] + 0.5 * length * x2 - below * y2
    circle[5], circle[6], circle[7] = cosine * y0 - sine * x0, cosine * y1 - sine * x1, cosine * y2 - sine * x2
    circle[8], circle[9], circle[10] = sine * y0 + cosine * x0, sine * y1 + cosine * x1, sine * y2 + cosine * x2
    return True


@inner_njit
def _lean(lx: float, ly: float, lz: float, p: Array, q: Array) -> float:
    """Tangent of the angle between a direction and the step from pose p to q; 0 if either has no direction."""
    sx, sy, sz = q[0] - p[0], q[1] - p[1], q[2] - p[2]
    if sx * sx + sy * sy + sz * sz <= LEAST_STEP**2:
        return 0.0
    x, y, z = ly * sz - lz * sy, lz * sx - lx * sz, lx * sy - ly * sx
    sine, cosine = np.sqrt(x * x + y * y + z * z), lx * sx + ly * sy + lz * sz
    if sine == 0.0:
        return 0.0
    return sine / cosine if cosine > 0.0 else np.inf


@inner_njit
def _worst(out: Array) -> float:
    worst = 0.0
    for j in range(len(out)):
        worst = max(worst, out[j])
    return worst


@inner_njit
def _measure(way: SampledWay, a: int, b: int, circle: Array, most: float, out: Array) -> tuple[float, float]:
    """How far a line, or an arc if circle[0] > 0, misses samples a to b: into out (8), in tolerances, by TERMS.

    Stops as soon as one of them exceeds `most`. Returns how far the samples lie outside the arc, and inside [m].
    """
    pose, clock, path, fed, laid, free = way.pose, way.clock, way.path, way.fed, way.laid, way.free
    tolerance = way.tolerance[1 if laid[a] and laid[b] else 0]
    width = pose.shape[1]
    p, q, took = way.aim[a], way.aim[b], clock[b] - clock[a]
    omega, sign = great_arc(p, q)
    sine = np.sin(omega) if omega > 0.0 else 1.0
    lx, ly, lz = q[0] - p[0], q[1] - p[1], q[2] - p[2]
    square = lx * lx + ly * ly + lz * lz
    swept, radius = circle[0], circle[1]
    over, under = 0.0, 0.0
    for j in range(8):
        out[j] = 0.0
    out[7] = (path[b] - path[a]) / tolerance[7]
    if out[7] > most:
        return over, under
    before = 0.0
    for k in range(a, b + 1):
        u, off = (k - a) / (b - a), 0.0
        if swept > 0.0:
            v0, v1, v2 = pose[k, 0] - circle[2], pose[k, 1] - circle[3], pose[k, 2] - circle[4]
            x = v0 * circle[5] + v1 * circle[6] + v2 * circle[7]
            y = v0 * circle[8] + v1 * circle[9] + v2 * circle[10]
            u = min(max(np.arctan2(y, x) / swept, 0.0), 1.0)
            flat = np.sqrt(x * x + y * y)
            radial = flat - radius
            over, under = max(over, radial), max(under, -radial)
            off = np.sqrt(radial * radial + max(v0 * v0 + v1 * v1 + v2 * v2 - flat * flat, 0.0))
        elif square >= SHORT:
            v0, v1, v2 = pose[k, 0] - p[0], pose[k, 1] - p[1], pose[k, 2] - p[2]
            u = min(max((v0 * lx + v1 * ly + v2 * lz) / square, 0.0), 1.0)
            off = np.sqrt((v0 - u * lx) ** 2 + (v1 - u * ly) ** 2 + (v2 - u * lz) ** 2)
        else:
            off = np.sqrt((pose[k, 0] - p[0]) ** 2 + (pose[k, 1] - p[1]) ** 2 + (pose[k, 2] - p[2]) ** 2)
        out[0] = max(out[0], off / tolerance[0])
        if k > a and laid[k - 1] and laid[k]:
            if swept > 0.0:
                middle = 0.5 * (u + before) * swept
                c, s = np.cos(middle), np.sin(middle)
                lean = _lean(c * circle[8] - s * circle[5], c * circle[9] - s * circle[6],
                             c * circle[10] - s * circle[7], pose[k - 1], pose[k])  # fmt: skip
            else:
                lean = _lean(lx, ly, lz, pose[k - 1], pose[k])
            out[5] = max(out[5], np.arctan(lean) / tolerance[5])
        before = u
        if k in (a, b):
            continue
        wa, wb = 1.0 - u, u
        if omega > 0.0:
            wa, wb = np.sin((1.0 - u) * omega) / sine, np.sin(u * omega) / sine
        # small rotation from the interpolated to the wanted orientation, in the nozzle's frame: twice the vector part
        wb *= sign
        mx, my, mz, mw = wa * p[3] + wb * q[3], wa * p[4] + wb * q[4], wa * p[5] + wb * q[5], wa * p[6] + wb * q[6]
        x, y, z, w = pose[k, 3], pose[k, 4], pose[k, 5], pose[k, 6]
        ex = mw * x - mx * w - my * z + mz * y
        ey = mw * y + mx * z - my * w - mz * x
        ez = mw * z - mx * y + my * x - mz * w
        out[1] = max(out[1], 2.0 * np.sqrt(ex * ex + ey * ey) / tolerance[1])
        out[2] = max(out[2], 2.0 * abs(ez) / tolerance[2])
        for j in range(7, width):
            out[3] = max(out[3], abs(p[j] + u * (q[j] - p[j]) - pose[k, j]) / free[j - 7])
        if laid[k]:
            out[4] = max(out[4], abs(clock[a] + u * took - clock[k]) / tolerance[4])
            even = fed[a] + (clock[k] - clock[a]) / max(took, 1e-9) * (fed[b] - fed[a])
            out[6] = max(out[6], abs(even - fed[k]) / tolerance[6])
        if _worst(out) > most:
            break
    return over, under


@inner_njit
def _fits(way: SampledWay, a: int, b: int, arcs: bool, most: float, circle: Array, out: Array) -> tuple[int, float]:
    """Kind of primitive (a line, else an arc) that meets samples a to b within `most` tolerances, and its misfit.

    NONE if neither does. The arc is left in `circle`. It passes through the middle of the path; if it misses, its
    height is corrected by half the difference between the misses on both sides.
    """
    circle[0] = 0.0
    if b - a == 1:
        return LINE, 0.0
    worst, raised = 0.0, 0.0
    for attempt in range(3):  # a line, an arc, and the arc with its height corrected
        if attempt and not _circle(way, a, b, raised, circle):
            circle[0] = 0.0
            return NONE, worst
        stop = HOPELESS * most if attempt == 1 else most
        over, under = _measure(way, a, b, circle, stop, out)
        worst, raised = _worst(out), 0.5 * (over - under)
        if worst <= most:
            return (ARC if attempt else LINE), worst
        if not arcs or (attempt == 1 and (out[0] <= most or worst > stop)):
            break
    return NONE, worst


@njit
def _misfits(way: SampledWay, first: Indices, last: Indices, circular: Flags, via: Array) -> Array:
    """`misfits`."""
    found, circle, up, across = np.zeros((len(first), len(TERMS))), np.zeros(11), np.zeros(3), np.zeros(3)
    for i in range(len(first)):
        a, b = first[i], last[i]
        circle[0] = 0.0
        if circular[i]:  # the via point lies above the middle of the chord
            top, half = 0.0, 0.0
            for d in range(3):
                across[d] = 0.5 * (way.pose[b, d] - way.pose[a, d])
                up[d] = via[i, d] - way.pose[a, d] - across[d]
                top, half = top + up[d] ** 2, half + across[d] ** 2
            top, half = np.sqrt(top), np.sqrt(half)
            radius = 0.5 * (top + half * half / top)
            circle[0], circle[1] = 2.0 * np.arctan2(half, radius - top), radius
            for d in range(3):
                circle[2 + d] = via[i, d] - radius * up[d] / top
                circle[5 + d] = (way.pose[a, d] - circle[2 + d]) / radius
                circle[8 + d] = half / radius * up[d] / top + (radius - top) / radius * across[d] / half
        if b - a > 1:
            _measure(way, a, b, circle, np.inf, found[i])
    return found


# ----------------------------------------------------------------------------------------------------
# The fewest primitives between two kept samples, with even times.


class _Scratch(NamedTuple):
    """Working memory of the search; n is the most samples between two kept ones.

    circle, out    (11), (8) of `_fits`
    ahead, behind  (n + 2) targets of a stretch: the farthest from its beginning, and those farthest back from its end
    better         (n + 2) the best of several stretches
    targets        (n + 2) chosen so far between two kept samples
    """

    circle: Array
    out: Array
    ahead: Indices
    behind: Indices
    better: Indices
    targets: Indices


@inner_njit
def _reach(way: SampledWay, a: int, end: int, step: int, arcs: bool, most: float, s: _Scratch) -> int:
    """The farthest sample, up to `end`, that one primitive from sample a reaches; `end` may lie before a.

    A part of a primitive that fits nearly always fits, too: steps are doubled until one fails, then halved.
    """
    way_to = 1 if end > a else -1
    good, bad, step = a + way_to, end + way_to, max(step, 1)
    doubling = True
    while good != end and abs(bad - good) > 1:
        b = good + way_to * step if doubling else (good + bad) // 2
        if (end - b) * way_to < 0:
            b = end
        kind, _ = _fits(way, min(a, b), max(a, b), arcs, most, s.circle, s.out)
        if kind == NONE:
            bad, doubling = b, False
        else:
            good, step = b, 2 * step
    return good


@inner_njit
def _stretch(way: SampledWay, first: int, last: int, arcs: bool, most: float, s: _Scratch) -> int:
    """The fewest targets from sample `first` to `last`, both included, into s.ahead; returns the number of primitives.

    The farthest targets from the beginning and those farthest back from the end bound each target. Within these bounds,
    each is chosen so that the remaining primitives share the remaining time evenly.
    """
    count, counts = 0, np.zeros(2, dtype=np.int64)
    for back in range(2):  # as far as possible from the beginning, then from the end
        at, end, count, step = (last, first, 0, _USUAL) if back else (first, last, 0, _USUAL)
        found = s.behind if back else s.ahead
        found[0] = at
        while at != end:
            before = at
            at = _reach(way, at, end, step, arcs, most, s)
            count, step = count + 1, max(abs(at - before) // 2, 1)
            found[count] = at
        counts[back] = count
        if count < 2:
            return count
    if counts[0] != counts[1]:
        return counts[0]
    for j in range((count + 1) // 2):  # into the order of samples
        s.behind[j], s.behind[count - j] = s.behind[count - j], s.behind[j]
    clock = way.clock
    for j in range(1, count + 1):  # behind[j], so far a bound, becomes the chosen target
        before = s.behind[j - 1]
        low, high = (max(s.behind[j], before + 1), s.ahead[j]) if j < count else (last, last)
        ideal = clock[before] + (clock[last] - clock[before]) / (count - j + 1)
        b = min(max(_first_from(clock, before + 1, last, ideal), low), high)
        while True:
            kind, _ = _fits(way, before, b, arcs, most, s.circle, s.out)
            if kind != NONE:
                break
            if b <= low:
                return count  # part of a primitive that fits need not fit: keep the farthest targets
            b = (low + b) // 2
        s.behind[j] = b
    _copy(s.behind, _FIRST, count + 1, s.ahead, _FIRST)
    return count


# ----------------------------------------------------------------------------------------------------
# The least time.

ON_TIME = 1e-9  # [s] by which a sum of sample times may miss the least time
WIDER = 1.26  # ratio of each tolerance tried to the previous one, the cube root of two
AROUND = (1, 3)  # primitives before and after those that are too short, chosen again with them


@inner_njit
def _too_short(way: SampledWay, targets: Indices, first: int, last: int, least: float) -> int:
    """How many of the primitives `first` to `last` (exclusive) between `targets` take less than the least time."""
    found = 0
    for j in range(first, last):
        found += way.clock[targets[j + 1]] - way.clock[targets[j]] < least - ON_TIME
    return found


@inner_njit
def _lengthen(way: SampledWay, count: int, rules: FitRules, s: _Scratch) -> int:
    """Mend primitives shorter than the least time among the `count` between s.targets; returns the new count.

    Consecutive ones, with some before and after, are chosen again with wider and wider tolerances until none is too
    short. If that never happens, the tolerances that leave the fewest are taken.
    """
    t, i = s.targets, 0
    while i < count:
        if not _too_short(way, t, i, i + 1, rules.least):
            i += 1
            continue
        end = i + 1
        while end < count and _too_short(way, t, end, end + 1, rules.least):
            end += 1
        fewest, chosen, low, high = _too_short(way, t, i, end, rules.least), _NONE, i, end
        for around in AROUND:
            a, b, most = max(i - around, 0), min(end + around, count), 1.0
            while fewest and most <= rules.widest:
                n = _stretch(way, t[a], t[b], rules.arcs, most, s)
                short = _too_short(way, s.ahead, _FIRST, n, rules.least)
                if short < fewest:
                    fewest, chosen, low, high = short, n, a, b
                    _copy(s.ahead, _FIRST, n + 1, s.better, _FIRST)
                most = min(WIDER * most, rules.widest) if most < rules.widest else np.inf
        if chosen >= 0:
            _copy(t, high, count + 1 - high, s.ahead, _FIRST)  # the targets that follow
            _copy(s.better, _FIRST, chosen, t, low)
            _copy(s.ahead, _FIRST, count + 1 - high, t, low + chosen)
            count, end = count + chosen - (high - low), low + chosen
        i = end
    return count


@inner_njit
def _chosen(way: SampledWay, first: int, last: int, rules: FitRules, s: _Scratch) -> int:
    """Targets from sample `first` to `last` into s.targets; returns the number of primitives."""
    count = _stretch(way, first, last, rules.arcs, 1.0, s)
    _copy(s.ahead, _FIRST, count + 1, s.targets, _FIRST)
    return _lengthen(way, count, rules, s)


def _fitted(
    way: SampledWay, aimed: SampledWay, first: Indices, last: Indices, rules: FitRules
) -> tuple[Indices, Array]:
    """Kind (n) of the primitive that ends at each sample, 0 for none, and its via point (n, 3).

    Each stretch takes its targets from `way` or `aimed`, whichever leaves fewer too short, or else needs fewer.
    """
    n = len(way.clock)
    kind, via = np.zeros(n, dtype=np.int64), np.zeros((n, 3))

    def part(begin: int, end: int) -> None:
        _fit(way, aimed, first[begin:end], last[begin:end], rules, kind, via)

    in_threads(part, len(first))
    return kind, via


@njit
def _fit(
    way: SampledWay, aimed: SampledWay, first: Indices, last: Indices, rules: FitRules, kind: Indices, via: Array
) -> None:
    """Fill in kind (n) and via (n, 3) of `_fitted` along some stretches."""
    most = 1
    for i in range(len(first)):
        most = max(most, last[i] - first[i])
    room = np.zeros((5, most + 2), dtype=np.int64)
    s = _Scratch(np.zeros(11), np.zeros(len(TERMS)), room[0], room[1], room[2], room[3])
    found, circle = room[4], s.circle
    for i in range(len(first)):
        own, mark, least, short = way, 0, 0, 0
        for each in range(2):
            count = _chosen(aimed if each else way, first[i], last[i], rules, s)
            missing = _too_short(way, s.targets, _FIRST, count, rules.least)
            if each == 0 or (missing, count) < (short, least):
                own, mark, least, short = (aimed, AIMED, count, missing) if each else (way, 0, count, missing)
                _copy(s.targets, _FIRST, count + 1, found, _FIRST)
        for j in range(least):
            a, b = found[j], found[j + 1]
            fits, within = NONE, 1.0
            while fits == NONE and within <= rules.widest:
                fits, _ = _fits(own, a, b, rules.arcs, within, s.circle, s.out)
                within = rules.widest if within < rules.widest else np.inf
            kind[b] = fits + mark
            cosine, sine = np.cos(0.5 * circle[0]), np.sin(0.5 * circle[0])
            for d in range(3):
                arm = circle[1] * (cosine * circle[5 + d] + sine * circle[8 + d])
                via[b, d] = circle[2 + d] + arm if fits == ARC else way.pose[b, d]


# ----------------------------------------------------------------------------------------------------
# Targets turned outwards, so that fewer are enough.
#
# Between two targets a controller turns the nozzle evenly, and so misses the orientations of a bend on one side only.
# If both targets are turned out of the bend by half the tolerance, the primitive may be longer by a factor of sqrt(1.5)
# and still miss by no more.

OFF = 0.5  # × the tolerance: how far targets may be turned
SHARE = (
    0.5  # × a usual primitive's miss at its middle; since that is within tolerance, the turn is within OFF tolerances
)
TINY = 1e-15  # avoids a division by zero where nothing is turned


def _half_of_usual(kind: Indices, first: Indices, last: Indices, n: int) -> Array:
    """Half the length of a usual primitive around each sample (n) [samples], within its stretch; 0 elsewhere."""
    at, sample = np.arange(n), np.flatnonzero(kind)
    out: Array = np.zeros(n)
    if len(sample) < 2:
        return out
    half = np.interp(at, 0.5 * (sample[1:] + sample[:-1]), 0.5 * np.diff(sample))
    k = np.searchsorted(first, at, side="right") - 1
    inside = (k >= 0) & (at < last[np.maximum(k, 0)])
    k = np.maximum(k, 0)
    out = np.where(inside, np.minimum(half, np.minimum(at - first[k], last[k] - at)), 0.0)
    return out


@inner_njit
def _at(values: Array, place: float, out: Array) -> None:
    """Row of values interpolated at a place between two samples, into out."""
    i = min(int(place), len(values) - 2)
    for j in range(values.shape[1]):
        out[j] = values[i, j] + (place - i) * (values[i + 1, j] - values[i, j])


@njit
def _outwards(way: SampledWay, reach: Array, most: float) -> Array:
    """Poses turned out of bends by half of a usual primitive's miss there, by at most `most` [rad].

    reach (n): half of a usual primitive around each sample, in samples; 0 leaves the target as it is.
    """
    pose, out = way.pose, way.pose.copy()
    a, b, off = np.empty(pose.shape[1]), np.empty(pose.shape[1]), np.zeros(7)
    for k in range(len(pose)):
        if reach[k] <= 0.0 or not way.laid[k]:
            continue
        _at(pose, k - reach[k], a)
        _at(pose, k + reach[k], b)
        omega, sign = great_arc(a, b)
        w = 0.5 if omega == 0.0 else np.sin(0.5 * omega) / np.sin(omega)
        turned = 0.0
        for j in range(3, 7):
            off[j] = SHARE * (pose[k, j] - w * (a[j] + sign * b[j]))
            turned += 4.0 * off[j] ** 2  # a rotation is twice the angle between its quaternions
        scale = min(1.0, most / max(np.sqrt(turned), TINY))
        norm = 0.0
        for j in range(3, 7):
            out[k, j] += scale * off[j]
            norm += out[k, j] ** 2
        for j in range(3, 7):
            out[k, j] /= np.sqrt(norm)
    return out
