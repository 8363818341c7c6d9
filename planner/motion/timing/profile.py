"""How fast a leg of a path is followed: its limits on a grid of its own, and the fastest profile within them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BSpline
from scipy.ndimage import maximum_filter1d

from planner.base.arrays import Array, ReadOnlyArrays
from planner.base.compiled import inner_njit, njit
from planner.base.processes import in_threads
from planner.cell.cell import Limits
from planner.motion.timing.kernels import APART, LimitRows, fastest, least_nearby, mean_nearby

# ----------------------------------------------------------------------------------------------------
# PiecewiseCurve: a spline as polynomials between its knots, cheap to differentiate at many places: compiled.


@dataclass(frozen=True)
class PiecewiseCurve(ReadOnlyArrays):
    """Values of k columns over a parameter from the first of its breaks to the last.

    breaks (n + 1), increasing; coefficients (n, degree + 1, k) of the powers of the parameter since the piece began,
    the highest first
    """

    breaks: Array
    coefficients: Array

    def __call__(self, u: Array) -> Array:
        """Values (m, k) at places u (m); outside the breaks the nearest piece is extrapolated."""
        return derivatives_at(self.breaks, self.coefficients, u, 0)[0]

    def derivatives(self, u: Array, orders: int) -> Array:
        """Derivatives (orders, m, k) of order 1 to `orders` at places u (m)."""
        return derivatives_at(self.breaks, self.coefficients, u, orders)[1:]

    def columns(self, which: slice) -> PiecewiseCurve:
        """Some of its columns."""
        return PiecewiseCurve(self.breaks, np.ascontiguousarray(self.coefficients[:, :, which]))


def curve_of(spline: BSpline) -> PiecewiseCurve:
    """Convert a spline of several columns, between its end knots."""
    t, k = spline.t, spline.k
    spans = k + np.flatnonzero(np.diff(t[k : len(t) - k]) > 0.0)
    coefficients = _polynomials(np.asarray(t), np.ascontiguousarray(spline.c), k, spans)
    return PiecewiseCurve(np.append(t[spans], t[spans[-1] + 1]), coefficients)


@njit
def _polynomials(t: Array, c: Array, degree: int, spans: NDArray[np.int64]) -> Array:
    """Coefficients (n, degree + 1, k) as in `PiecewiseCurve` between knots t[i] and t[i + 1], i of spans (n).

    The control values c (m, k) that act there are differenced once for each derivative, and each resulting spline is
    evaluated at t[i] by de Boor's algorithm.
    """
    columns = c.shape[1]
    out = np.empty((len(spans), degree + 1, columns))
    felt, now = np.empty((degree + 1, columns)), np.empty((degree + 1, columns))
    for at in range(len(spans)):
        i = spans[at]
        for j in range(degree + 1):
            for column in range(columns):
                felt[j, column] = c[i - degree + j, column]
        scale = 1.0  # of each derivative: one over the factorial of its order
        for order in range(degree + 1):
            left = degree - order  # degree of the derivative, whose control values are felt[order :]
            if order > 0:
                scale /= order
                for j in range(degree, order - 1, -1):
                    low = i - degree + j
                    factor = (left + 1) / (t[low + left + 1] - t[low])
                    for column in range(columns):
                        felt[j, column] = factor * (felt[j, column] - felt[j - 1, column])
            for j in range(order, degree + 1):
                for column in range(columns):
                    now[j, column] = felt[j, column]
            for level in range(1, left + 1):
                for j in range(degree, order + level - 1, -1):
                    low = i - degree + j
                    share = (t[i] - t[low]) / (t[low + left + 1 - level] - t[low])
                    for column in range(columns):
                        now[j, column] = (1.0 - share) * now[j - 1, column] + share * now[j, column]
            for column in range(columns):
                out[at, left, column] = scale * now[degree, column]
    return out


@njit
def derivatives_at(breaks: Array, coefficients: Array, u: Array, orders: int) -> Array:
    """Values and derivatives (1 + orders, m, k) of a `PiecewiseCurve` at places u (m); orders: at most 3.

    The search for a place's piece starts from that of the place before: ordered places are found quickly.
    """
    n, powers, k = coefficients.shape
    out = np.zeros((1 + orders, len(u), k))
    i = 0 if len(u) == 0 else min(max(np.searchsorted(breaks, u[0], side="right") - 1, 0), n - 1)
    for at in range(len(u)):
        while i < n - 1 and u[at] >= breaks[i + 1]:
            i += 1
        while i > 0 and u[at] < breaks[i]:
            i -= 1
        since = u[at] - breaks[i]
        for power in range(powers):  # Horner's scheme, for the derivatives too
            for order in range(min(orders, power), 0, -1):
                for column in range(k):
                    out[order, at, column] = out[order, at, column] * since + order * out[order - 1, at, column]
            for column in range(k):
                out[0, at, column] = out[0, at, column] * since + coefficients[i, power, column]
    return out


# ----------------------------------------------------------------------------------------------------
# Leg: a piece of a joint path, over a parameter that lets it start and end at rest.
#
# A profile x(u) of squared rates cannot leave rest with bounded jerk and a bounded second derivative: there x grows
# with u^(4/3). So near an end at rest the path parameter u follows a nominal motion u(sigma) that begins with the cube
# of sigma, as motion of constant jerk does. Profiles over sigma are then regular, and positive, everywhere.

_LEAST_NOMINAL = 0.2  # share of the nominal motion's full rate: below, it counts as nearly at rest
_MEAN = 0.6  # mean rate of a nominal ramp, as a share of its full rate


@dataclass(frozen=True)
class Leg:
    """The path from u = first to u = last, over sigma from 0 to `end`.

    path: joints and arc length over u [s at the commanded speed]; ramps: the parts of u over which the nominal motion
    accelerates at the start and decelerates at the end, 0 at an end that is passed in motion
    """

    path: PiecewiseCurve
    first: float
    last: float
    ramps: tuple[float, float]

    @property
    def end(self) -> float:
        """The last sigma."""
        a, b = self.ramps
        return self.last - self.first + (a + b) * (1.0 / _MEAN - 1.0)

    @property
    def lasts(self) -> tuple[float, float]:
        """Lengths of the two ramps in sigma."""
        return self.ramps[0] / _MEAN, self.ramps[1] / _MEAN

    @property
    def spacing(self) -> float:
        """Mean spacing of the path's breaks."""
        breaks = self.path.breaks
        return float((breaks[-1] - breaks[0]) / (len(breaks) - 1))

    def along(self, sigma: Array) -> Array:
        """Rate of arc length by sigma (k) [m], with the nominal motion's rate kept from vanishing near rest.

        So the commanded speed bounds profiles there too, where the true, vanishing rate would leave them free.
        """
        u, u1, _, _ = self._nominal(sigma)
        return np.asarray(self.path.derivatives(u, 1)[0, :, -1] * np.maximum(u1, _LEAST_NOMINAL))

    def u(self, sigma: Array) -> Array:
        """Path parameter (k) at sigma (k)."""
        return np.asarray(self._nominal(sigma)[0])

    def rates(self, sigma: Array, orders: int) -> Array:
        """Derivatives by sigma of joints and arc length, (orders, k, nj + 1), of order 1 to `orders` (at most 3)."""
        u, *by_sigma = self._nominal(sigma)
        rates = self.path.derivatives(u, orders)
        _chain(rates, *by_sigma)
        return rates

    def _nominal(self, sigma: Array) -> Array:
        """u(sigma) and its first three derivatives (4, k)."""
        return _nominal(sigma, self.end, self.first, self.last, self.ramps, self.lasts)


@njit
def _nominal(
    sigma: Array, length: float, first: float, last: float, ramps: tuple[float, float], lasts: tuple[float, float]
) -> Array:
    """u(sigma) and its first three derivatives (4, k), with ramps whose rate joins full rate with slope and bend 0."""
    out = np.empty((4, len(sigma)))
    for i in range(len(sigma)):
        u, u1, u2, u3 = first + ramps[0] + sigma[i] - lasts[0], 1.0, 0.0, 0.0
        for end in range(2):
            way, long = ramps[end], lasts[end]
            since = sigma[i] if end == 0 else length - sigma[i]
            if way > 0.0 and since < long:
                t = max(since / long, 0.0)
                w = way * (2.0 * t**3 - 2.0 * t**4 + 0.6 * t**5) / _MEAN
                u = first + w if end == 0 else last - w
                u1 = t**2 * (6.0 - 8.0 * t + 3.0 * t**2)
                u2 = (12.0 * t - 24.0 * t**2 + 12.0 * t**3) / long * (1.0 if end == 0 else -1.0)
                u3 = (12.0 - 48.0 * t + 36.0 * t**2) / long**2
        out[0, i], out[1, i], out[2, i], out[3, i] = min(max(u, first), last), u1, u2, u3
    return out


@njit
def _chain(rates: Array, u1: Array, u2: Array, u3: Array) -> None:
    """Convert derivatives by u (orders, k, columns) to those by sigma, in place, given those of u by sigma (k)."""
    orders, k, columns = rates.shape
    for i in range(k):
        for column in range(columns):
            first = rates[0, i, column]
            rates[0, i, column] = first * u1[i]
            if orders > 1:
                second = rates[1, i, column]
                rates[1, i, column] = second * u1[i] ** 2 + first * u2[i]
                if orders > 2:
                    third = rates[2, i, column] * u1[i] ** 3
                    rates[2, i, column] = third + 3.0 * second * (u1[i] * u2[i]) + first * u3[i]


# ----------------------------------------------------------------------------------------------------
# LegLimits: the limits of a leg of a path, on a grid of its own, as the interior-point method takes them.

Allowed = Callable[[Array], tuple[Array, Array]]

_GRID = 0.125  # × the time in which joints build up their acceleration: approximate time between grid points
_GRID_BETWEEN = (2.5e-3, 5e-3)  # s, bounds of that time: slow joints follow quick bends too
LEAST_RATE = 1e-12  # least squared rate: keeps rest above 0 in spite of rounding
_DIP = 20e-3  # s: width over which a slow place slows its neighbourhood in the starting profile
_START = 0.9  # share of what limits allow at constant rates that the starting profile takes
_SLOWEST = 1e-3  # share of the commanded rate: the grid is not refined for slower places
_FASTEST = 1e4  # × the nominal motion: the only bound where samples coincide
_LEAD = 0.08  # share of a ramp from rest that begins with a constant rate, where limits bind only together
_LEAD_LOOKS = 65  # places of a lead at which limits are checked
_COARSE = 20e-3  # s between grid points where only the commanded speed limits the speed, for _FAR around:
_FAR = 80e-3  # s: longer than an arm takes to gather speed
_EASY = 4.0  # × the commanded speed's squared rate: the joints must allow more than this there
_QUIET = 0.3  # s around a place for which that must hold if the grid is to be cut there, the ceiling being _STEADY too:
_STEADY = 1e-2  # greatest relative change from one point to the next
_WORTH_A_CUT = 2048  # intervals: smaller grids are not cut
_BELOW = 1e-3  # share of the ceiling by which a cut stays below it: fixed coefficients need room
_LEAST_INTERVALS = 60
_LOOKS_A_SAMPLE = 3  # places per sample of the path at which the grid's fineness is chosen
_BETWEEN = (0.25, 0.5, 0.75)  # fractions of intervals at which limits are checked again


@dataclass(frozen=True)
class LegLimits:
    """The limits of a leg on a grid of m intervals, and places for checking them again; fields of `LimitRows` as there.

    left, right (m): weight of the first of three coefficients in x at an interval's start, and of the last at its end;
    looks: fractions of intervals, and the path's rates (3, m, nj + 1) there, for checking limits again; v (nj + 1), a,
    j (nj): the limits; cut: start of a block of intervals where the commanded speed is held for so long around that the
    two sides do not affect each other, or 0; start is nearly at that speed there
    """

    sigma: Array
    h: Array
    left: Array
    right: Array
    point: Array
    middle: Array
    ends: Array
    acceleration: Array
    jerk: Array
    looks: tuple[tuple[float, Array], ...]
    v: Array
    a: Array
    j: Array
    ceiling: Array
    start: Array
    level: tuple[bool, bool]
    cut: int

    @property
    def rows(self) -> LimitRows:
        """The limits as `fastest` takes them."""
        return LimitRows(self.point, self.middle, self.ends, self.acceleration, self.jerk, self.ceiling, self.h)


def leg_limits(leg: Leg, v: Array, a: Array, j: Array, known: tuple[Array, Array] | None = None) -> LegLimits:
    """The program of a leg under limits of velocity (nj + 1), the last of arc length, acceleration and jerk (nj).

    known: places, and the squared rates of a solution on another grid there, to which this grid is fitted.
    """
    leads = (_LEAD * leg.lasts[0], _LEAD * leg.lasts[1])
    level = (leads[0] > 0.0, leads[1] > 0.0)
    allowed = partial(_allowed, leg, v, a, j)
    apart = float(np.clip(_GRID * (a / j).min(), *_GRID_BETWEEN))
    sigma, envelope, quiet = _grid(leg, leads, allowed, apart, known)
    h = np.diff(sigma)
    around = np.concatenate([h[:1], h, h[-1:]])
    left, right = h / (around[:-2] + h), h / (h + around[2:])
    share = np.append(left, 0.5)
    slope = 2.0 / (around[:-1] + around[1:])
    points = leg.rates(sigma, 3)
    ceiling = np.minimum(*_ceilings(leg, v, sigma, points[0]))
    for end, lead in enumerate(leads):  # the grid's rows do not cover the leads, where x is that of the grid's end
        if lead > 0.0:
            within = np.linspace(0.0, lead, _LEAD_LOOKS)
            at = sigma[0] - within if end == 0 else sigma[-1] + within
            ceiling[-end] = min(ceiling[-end], float(np.minimum(*allowed(at)).min()))
    start, cut = _start(envelope, ceiling, level), _cut(ceiling, quiet)
    if cut > 0:  # coefficients belong to the middles of intervals
        start[cut : cut + 2] = 0.5 * (ceiling[cut - 1 : cut + 1] + ceiling[cut : cut + 2])
        here = float(start[cut : cut + 2] @ (share[cut], 1.0 - share[cut]))
        start[cut : cut + 2] *= min(1.0, (1.0 - _BELOW) * ceiling[cut] / here)
    first, second = points[0][:, :-1], points[1][:, :-1]
    bases = [_basis(left, right, h, f) for f in (0.0, 0.5, 1.0)]
    return LegLimits(
        sigma=sigma,
        h=h,
        left=left,
        right=right,
        point=np.column_stack([share, 1.0 - share]),
        middle=bases[1][0],
        ends=_in_turn(bases[0][0], bases[2][0]),
        acceleration=np.stack(
            [
                second * share[:, None] - 0.5 * first * slope[:, None],
                second * (1.0 - share)[:, None] + 0.5 * first * slope[:, None],
            ],
            axis=-1,
        )
        / a[:, None],
        jerk=_in_turn(
            _jerk_rows(bases[0], points[:, :-1], j),
            _jerk_rows(bases[2], points[:, 1:], j),
        ),
        looks=(
            (0.0, np.ascontiguousarray(points[:, :-1])),
            *((f, leg.rates(sigma[:-1] + f * h, 3)) for f in _BETWEEN),
            (1.0, np.ascontiguousarray(points[:, 1:])),
        ),
        v=v,
        a=a,
        j=j,
        ceiling=ceiling,
        start=start,
        level=level,
        cut=cut,
    )


def _allowed(leg: Leg, v: Array, a: Array, j: Array, sigma: Array) -> tuple[Array, Array]:
    """Largest constant x (k) that the joints' limits allow at sigma (k), and that the commanded speed allows."""
    first, second, third = leg.rates(sigma, 3)
    with np.errstate(divide="ignore", over="ignore"):
        x = np.minimum(_ceilings(leg, v, sigma, first)[0], (a / np.abs(second[:, :-1])).min(axis=1))
        x = np.minimum(x, (j / np.abs(third[:, :-1])).min(axis=1) ** (2.0 / 3.0))
    return np.maximum(x, LEAST_RATE), np.maximum(_ceilings(leg, v, sigma, first)[1], LEAST_RATE)


def _ceilings(leg: Leg, v: Array, sigma: Array, first: Array) -> tuple[Array, Array]:
    """Largest x (k) that joint speeds, and the commanded speed, allow at sigma (k); first (k, nj + 1): first rates."""
    with np.errstate(divide="ignore", over="ignore"):
        joints = (v[:-1] / np.abs(first[:, :-1])).min(axis=1)
        along = v[-1] / np.abs(leg.along(sigma))
    return np.minimum(joints, _FASTEST) ** 2, np.minimum(along, _FASTEST) ** 2


def _grid(
    leg: Leg, leads: tuple[float, float], allowed: Allowed, apart: float, known: tuple[Array, Array] | None
) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Grid points (m + 1) between the leads, some `apart` [s] apart, a guess of x, and which are far from dips.

    As fine as required in the time that the path will take, and as the path's own samples: where these draw together,
    it is not finer than they are.
    """
    a, b = leads[0], leg.end - leads[1]
    step = min(max(apart, leg.spacing / _LOOKS_A_SAMPLE), leg.spacing)
    even = np.linspace(a, b, max(int(np.ceil((b - a) / step)), _LEAST_INTERVALS) + 1)
    joints, commanded = allowed(even)
    # time at the commanded speed: a measure of nearness that does not depend on how close the samples are
    time = _cumulated(1.0 / np.sqrt(commanded), even)
    guess = np.minimum(joints, commanded) if known is None else np.interp(even, *known)
    envelope = _smoothed(guess, time, 0.5 * _DIP)
    calm = _smoothed(np.where(_calm(leg, even, time, joints, commanded), 1.0, 0.0), time, 0.5 * _FAR)
    lasting = (apart + calm * (_COARSE - apart)) * np.clip(np.sqrt(envelope), _SLOWEST, None)
    count = _cumulated(1.0 / np.minimum(lasting, leg.spacing), even)
    m = max(int(np.ceil(count[-1])), _LEAST_INTERVALS)
    grid = np.interp(np.linspace(0.0, count[-1], m + 1), count, even)
    grid[[0, -1]] = a, b
    quiet = np.interp(grid, even, least_nearby(calm, time, _QUIET)) == 1.0
    return grid, np.interp(grid, even, envelope), quiet


def _cut(ceiling: Array, quiet: NDArray[np.bool_]) -> int:
    """Where a grid may be cut in two, as near to its middle as possible; 0 if nowhere, or if it is not worth it."""
    m = len(quiet) - 1
    at = np.arange(APART, m - APART, APART)
    if m < _WORTH_A_CUT:
        return 0
    steady = np.abs(ceiling[at[:, None] + (-1, 1)] / ceiling[at, None] - 1.0).max(axis=1) < _STEADY
    at = at[quiet[at] & steady]
    return int(at[np.argmin(np.abs(at - m // 2))]) if len(at) else 0


def _smoothed(values: Array, time: Array, reach: float) -> Array:
    """Values (k) smoothed over times (k), after taking the least of those nearby."""
    least = least_nearby(values, time, reach)
    return np.maximum(mean_nearby(least, time, reach), least.min())


def _cumulated(density: Array, even: Array) -> Array:
    """Integral (k) of a density over an even grid (k) up to each place."""
    step = float(even[1] - even[0])
    return np.concatenate([[0.0], np.cumsum(0.5 * step * (density[1:] + density[:-1]))])


def _calm(leg: Leg, even: Array, time: Array, joints: Array, commanded: Array) -> NDArray[np.bool_]:
    """Places (k) of an even grid where, for _FAR around, the commanded speed alone limits the speed."""
    start, end = leg.lasts
    inside = (even > start + _FAR) & (even < leg.end - end - _FAR)
    return np.asarray((least_nearby(joints / commanded, time, _FAR) > _EASY) & inside)


def _start(envelope: Array, ceiling: Array, level: tuple[bool, bool]) -> Array:
    """Starting coefficients (m + 2): most of the guess."""
    c = np.concatenate([envelope[:1], np.minimum(envelope[1:], envelope[:-1]), envelope[-1:]])
    c[:2], c[-2:] = np.minimum(c[:2], ceiling[0]), np.minimum(c[-2:], ceiling[-1])
    if level[0]:
        c[0] = c[1]
    if level[1]:
        c[-1] = c[-2]
    return _START * c


def _basis(left: Array, right: Array, h: Array, f: float) -> tuple[Array, Array, Array]:
    """Weights of c[i : i + 3] in x, x' and x'' at the fraction f of each interval, (m, 3) each."""
    ends = (
        (left * (1.0 - f) ** 2, right * f**2, 1.0),
        (-2.0 * left * (1.0 - f) / h, 2.0 * right * f / h, 0.0),
        (2.0 * left / h**2, 2.0 * right / h**2, 0.0),
    )
    x, slope, bend = (np.column_stack([a, total - a - b, b]) for a, b, total in ends)
    return x, slope, bend


@njit
def _jerk_rows(basis: tuple[Array, Array, Array], rates: Array, limit: Array) -> Array:
    """Jerk over sqrt(x) from c[i : i + 3], as a share of its limit (nj), (m, nj, 3); rates (3, m, nj + 1)."""
    m, joints = rates.shape[1], len(limit)
    out = np.empty((m, joints, 3))
    for i in range(m):
        for k in range(joints):
            for n in range(3):
                by_x, by_slope = rates[2, i, k] * basis[0][i, n], 1.5 * rates[1, i, k] * basis[1][i, n]
                out[i, k, n] = (0.5 * rates[0, i, k] * basis[2][i, n] + by_slope + by_x) / limit[k]
    return out


def _in_turn(a: Array, b: Array) -> Array:
    """Rows of a and b (m, ...) interleaved, (2 m, ...)."""
    return np.ascontiguousarray(np.stack([a, b], axis=1).reshape(2 * len(a), *a.shape[1:]))


def overruns(program: LegLimits, c: Array) -> tuple[Array, Array, Array]:
    """Largest squared speed, acceleration and jerk (m) as shares of their limits in each interval, ends included."""
    p, worst = program, np.zeros((3, len(program.h)))
    for f, rates in p.looks:
        _raise_worst(f, rates, c, p.h, p.left, p.right, p.v, p.a, p.j, worst)
    return worst[0], worst[1], worst[2]


@njit
def _raise_worst(
    f: float, rates: Array, c: Array, h: Array, left: Array, right: Array, v: Array, a: Array, j: Array, worst: Array
) -> None:
    """Raise worst (3, m) to the shares of the limits reached at the fraction f of each interval.

    rates (3, m, nj + 1): those of the path there
    """
    joints = len(a)
    for i in range(len(h)):
        before, after = left[i] * (c[i] - c[i + 1]), right[i] * (c[i + 2] - c[i + 1])
        x = c[i + 1] + before * (1.0 - f) ** 2 + after * f**2
        slope = 2.0 * (after * f - before * (1.0 - f)) / h[i]
        bend = 2.0 * (before + after) / h[i] ** 2
        root = np.sqrt(x)
        speed, acceleration, jerk = abs(rates[0, i, joints]) / v[joints], 0.0, 0.0
        for k in range(joints):
            first, second, third = rates[0, i, k], rates[1, i, k], rates[2, i, k]
            speed = max(speed, abs(first) / v[k])
            acceleration = max(acceleration, abs(second * x + 0.5 * first * slope) / a[k])
            jerk = max(jerk, abs(third * x + 1.5 * second * slope + 0.5 * first * bend) / j[k])
        worst[0, i] = max(worst[0, i], speed**2 * x)
        worst[1, i] = max(worst[1, i], acceleration)
        worst[2, i] = max(worst[2, i], root * jerk)


# ----------------------------------------------------------------------------------------------------
# Profile: how fast a leg of a path is followed, at best as fast as speed, acceleration and jerk limits allow.

HEADROOM = 0.99  # share of the joint limits that is used: the rest covers the path between grid points
ACCURACY = 1e-4  # share of the time by which the optimum may be missed
_NEWTON_STEPS = 8
_ON_TIME = 1e-13  # s: a thousandth of what the third difference of samples would show
_LONGEST = 30e-3  # s: greatest duration of a grid interval
_ROUNDS = 10  # of tightening limits where the path between grid points overruns them
_TIGHTENED = 2  # rounds after which the speed is lowered there, too: limits at points may not reach peaks between them
_BESIDE = 4  # points on either side at which it is lowered as well: an even speed adds no jerk of its own
# Limits are tightened only if squared speed, acceleration or jerk exceed these shares of them, less headroom, between
# grid points.
_ENOUGH = (1.003, 1.005, 1.005)

_NODES, _WEIGHTS = (np.ascontiguousarray(each) for each in np.polynomial.legendre.leggauss(6))


@dataclass(frozen=True)
class Profile:
    """Squared rate x of sigma along a leg, quadratic in each of k intervals, and the times at their ends.

    sigma (k + 1); x (k, 3): x = x0 + x1 f + x2 f^2 at the fraction f of an interval; times (k + 1) from 0 [s]
    """

    leg: Leg
    sigma: Array
    x: Array
    times: Array

    @property
    def duration(self) -> float:
        """Time that the leg takes [s]."""
        return float(self.times[-1])

    def u(self, t: Array) -> Array:
        """Path parameter (k) at times t (k), which are held within [0, duration]."""
        return self.leg.u(_when(np.clip(t, 0.0, self.times[-1]), self.sigma, self.x, self.times))

    def rates_at_end(self, last: bool) -> tuple[Array, Array]:
        """First and second time derivatives of joints and arc length (nj + 1) where the leg begins or ends."""
        i, f = (-1, 1.0) if last else (0, 0.0)
        x0, x1, x2 = self.x[i]
        x, slope = x0 + f * (x1 + f * x2), (x1 + 2.0 * f * x2) / (self.sigma[1:] - self.sigma[:-1])[i]
        first, second = (each[0] for each in self.leg.rates(self.sigma[[i if last else 0]], 2))
        return first * np.sqrt(x), second * x + 0.5 * first * slope


def fastest_profile(leg: Leg, limits: Limits, speed: float) -> Profile:
    """The fastest profile of a leg whose last column is arc length, its rate at most `speed` [m/s].

    Limits hold between grid points too: where the path overruns them there, they are tightened, then the speed nearby
    is lowered, and finally the whole leg is slowed down by the remaining overrun.
    """
    v = np.append(HEADROOM * limits.velocity, speed)
    program_on = partial(leg_limits, leg, v, HEADROOM * limits.acceleration, HEADROOM * limits.jerk)
    profile = _within_limits(leg, program_on())
    if float(np.diff(profile.times).max()) > _LONGEST:  # it is slower there than the grid was made for
        profile = _within_limits(leg, program_on((profile.sigma[:-1], profile.x[:, 0])))
    return profile


def _within_limits(leg: Leg, program: LegLimits) -> Profile:
    """The fastest profile on a program's grid, its limits tightened as described for `fastest_profile`."""
    m = len(program.h)
    at_speed, acceleration, jerk = np.ones(m + 1), np.ones(m + 1), np.ones(m)  # shares of the limits that are used
    c, wanted = program.start, np.ones(-(-m // APART), dtype=np.bool_)
    for done in range(_ROUNDS):
        tightened = replace(
            program,
            acceleration=program.acceleration / acceleration[:, None, None],
            jerk=program.jerk / np.repeat(jerk, 2)[:, None, None],
            ceiling=program.ceiling * at_speed,
            start=np.maximum(c, LEAST_RATE),
        )
        c = _fastest(tightened, wanted)
        c = np.maximum(c, LEAST_RATE)
        over = overruns(program, c)
        if all(float(values.max()) <= enough for values, enough in zip(over, _ENOUGH, strict=True)):
            break
        tighter = [np.where(values > enough, values, 1.0) for values, enough in zip(over, _ENOUGH, strict=True)]
        for share, overrun in ((at_speed, tighter[0]), (acceleration, tighter[1])):
            share[:-1] /= overrun
            share[1:] /= overrun
        jerk /= tighter[2]
        if done >= _TIGHTENED:
            slower = np.maximum(tighter[1], tighter[2] ** (2.0 / 3.0))
            slower = maximum_filter1d(np.maximum(np.append(slower, 1.0), np.append(1.0, slower)), 2 * _BESIDE + 1)
            now = program.point[:, 0] * c[:-1] + program.point[:, 1] * c[1:]
            at_speed = np.where(slower > 1.0, np.minimum(at_speed, now / slower / program.ceiling), at_speed)
        wanted = _blocks_beside(np.any([values > 1.0 for values in tighter], axis=0))
    left = [float(values.max()) / enough for values, enough in zip(over, _ENOUGH, strict=True)]
    worst = max(1.0, left[0], left[1], left[2] ** (2.0 / 3.0))
    return _profile(leg, program, c / worst)


def _fastest(program: LegLimits, wanted: NDArray[np.bool_]) -> Array:
    """Coefficients (m + 2) of the fastest profile, optimised in the wanted blocks.

    If all blocks are wanted and the program can be cut, two threads solve a half each; if either fails, it is solved
    whole.
    """
    p, blocks = program, np.arange(len(wanted))
    before = blocks < p.cut // APART
    parts = [before, ~before] if p.cut > 0 and wanted.all() else [wanted]
    found = [(p.start, False)] * len(parts)

    def seek(first: int, last: int) -> None:
        for k in range(first, last):
            found[k] = fastest(p.rows, p.start, p.level, ACCURACY, parts[k])

    if len(parts) == 2:
        in_threads(seek, 2)
        if all(reached for _, reached in found):
            return np.concatenate([found[0][0][: p.cut], found[1][0][p.cut :]])
        parts[0] = wanted
    seek(0, 1)
    return found[0][0]


def _blocks_beside(tightened: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """The blocks with intervals (m) whose limits were tightened, and their neighbours; all others stay as they are."""
    blocks = np.zeros(-(-len(tightened) // APART) + 2, dtype=np.bool_)
    at = np.flatnonzero(tightened) // APART + 1
    for beside in (-1, 0, 1):
        blocks[at + beside] = True
    return blocks[1:-1]


def _profile(leg: Leg, program: LegLimits, c: Array) -> Profile:
    """The profile of coefficients c (m + 2), with its leads."""
    x = np.column_stack(
        [
            program.left * c[:-2] + (1.0 - program.left) * c[1:-1],
            2.0 * program.left * (c[1:-1] - c[:-2]),
            program.left * (c[:-2] - c[1:-1]) + program.right * (c[2:] - c[1:-1]),
        ]
    )
    sigma = program.sigma
    if program.level[0]:
        x, sigma = np.vstack([[[c[0], 0.0, 0.0]], x]), np.append(0.0, sigma)
    if program.level[1]:
        x, sigma = np.vstack([x, [[c[-1], 0.0, 0.0]]]), np.append(sigma, leg.end)
    times = np.concatenate([[0.0], np.cumsum(_durations(np.diff(sigma), x))])
    return Profile(leg, sigma, x, times)


@inner_njit
def _lasts(h: float, x: Array, f: float) -> float:
    """Time from an interval's start to its fraction f: the integral of h / sqrt(x)."""
    total = 0.0
    for k in range(len(_NODES)):
        at = 0.5 * f * (1.0 + _NODES[k])
        total += _WEIGHTS[k] / np.sqrt(x[0] + at * (x[1] + at * x[2]))
    return 0.5 * f * h * total


@njit
def _durations(h: Array, x: Array) -> Array:
    """Time (k) that each interval takes."""
    out = np.empty(len(h))
    for i in range(len(h)):
        out[i] = _lasts(h[i], x[i], 1.0)
    return out


@njit
def _when(t: Array, sigma: Array, x: Array, times: Array) -> Array:
    """Sigma (k) at times t (k), by Newton's method in the interval of each."""
    out = np.empty(len(t))
    last = len(times) - 2
    for k in range(len(t)):
        i = min(max(np.searchsorted(times, t[k], side="right") - 1, 0), last)
        h = sigma[i + 1] - sigma[i]
        wanted, whole = t[k] - times[i], times[i + 1] - times[i]
        f = min(max(wanted / whole, 0.0), 1.0)
        for _ in range(_NEWTON_STEPS):
            off = _lasts(h, x[i], f) - wanted
            f = min(max(f - off * np.sqrt(x[i, 0] + f * (x[i, 1] + f * x[i, 2])) / h, 0.0), 1.0)
            if abs(off) <= _ON_TIME:
                break
        out[k] = sigma[i] + h * f
    return out
