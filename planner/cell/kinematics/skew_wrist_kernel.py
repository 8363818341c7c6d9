"""All postures of an arm whose axes 4 and 6 pass each other, compiled: a search over joint 1, the rest in closed form.

Rotations R_i(q_i) are about h_i, the axes' directions at zero. The flange pose is T, and T_0 at zero; R is the rotation
of T T_0^-1. C is where axes 4 and 5 meet, P the point of axis 6 nearest to C (e = P - C, d = |e|), and X where T T_0^-1
takes P. Axes 2 and 3 are parallel, so joint 1 alone gives two components of w = (R4 R5)^T h2, the direction of axis 2
seen from link 5:

    w . h6 = h2 . R1^T R h6,        w . e = h2 . (p1 + R1^T (X - p1) - C)

As w has unit length, it is one of two (the sign of its third component). R6 turns R^T R1 h2 into w, R5 turns w square
to h4 (two ways), R4 turns it into h2, and R2 R3 is what remains of R; and p3 - p2, which R2 turns, keeps its length L:

    g = |(p1 + R1^T (X - p1) - R1^T R R6^T e) - p2 - R2 R3 (C - p3)|^2 - L^2 = 0,   of the parts square to h2.

w exists on intervals of joint 1, at whose ends both solutions coincide: with q1 = middle - half cos(theta) and the sign
of sin(theta), g is a smooth function on a circle, whose zeros are all postures. It is sampled as finely as the joints
turn, zeros are bracketed, pairs of zeros are searched for where |g| is smallest, and Newton's method on the arm itself
makes them exact. This is like the one-dimensional searches of Elias and Wen, "IK-Geo: unified robot inverse kinematics
using subproblem decomposition", 2022, but on closed curves, so that no zero is lost where w ends.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from planner.base.arrays import Array
from planner.base.compiled import inner_njit, njit
from planner.cell.kinematics.axes import wrap
from planner.cell.kinematics.chain import chain_state, jacobian_at, refine

SLOTS = 16  # as many postures as an arm of six axes can have for a pose
LABELS = 8
BEHIND_AXIS_1, ELBOW_NEGATIVE, TURNED = 4, 2, 1  # bits of a label
CHAIN = 22 * 6 + 16  # numbers of the arm's own chain, before those of its geometry

# numbers of the geometry, behind the chain's
H1, H2, H4, H5, H6, P1, C, E, F, P2, P23, P3C, T0 = 0, 3, 6, 9, 12, 15, 18, 21, 24, 27, 30, 33, 36
D, S3 = 52, 53

_SEAM = -2.5  # rad: where circles begin, at neither end of an interval
_STEPS = 40  # places on a circle, at least
_DOMAIN = 48  # places at which the ends of w are searched for
_TURN = 0.35  # rad: most that directions turn from one place to the next
_DEEPEST = 14  # halvings of a step, at most
_DEEPER = 3  # halvings, at most, of a step over which |g| changes by more than a factor _STEEP, but not its sign
_STEEP = 3.0
_MOST = 1024  # places on a circle, at most
_BESIDE = 3e-4  # rad from a pose that leaves a joint undetermined to one next to it
_POLISH = 30  # steps of Newton's method, at most; three suffice, more near singularities
_SAME = 1e-7  # rad: closer postures are one, found twice
_TOUCHES = 1e-7  # × L^2: a least |g| below this may be a double zero, of two postures that coincide


class _Pose(NamedTuple):
    """Data that a pose's curves share: the arm's parameters p and geometry g; the flange pose R_flange (3, 3), t_flange
    (3) that postures must have; R (3, 3) and X (3) of the pose at which they are searched for, and its lines (2, 3),
    see `_lines`; and scratch: vectors room (13, 3), a place (2, 10), and q (16, 6), which is filled."""

    p: Array
    g: Array
    R_flange: Array
    t_flange: Array
    R: Array
    X: Array
    lines: Array
    room: Array
    place: Array
    q: Array


class _Curve(NamedTuple):
    """A curve of a pose: closed over an interval of joint 1 with these ends (2), or a full turn with w on one side."""

    closed: bool
    ends: Array
    side: float


@inner_njit
def _dot(a: Array, b: Array) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@inner_njit
def _cross(a: Array, b: Array, out: Array) -> None:
    out[0] = a[1] * b[2] - a[2] * b[1]
    out[1] = a[2] * b[0] - a[0] * b[2]
    out[2] = a[0] * b[1] - a[1] * b[0]


@inner_njit
def _turned(axis: Array, c: float, s: float, v: Array, out: Array) -> None:
    """Fill out (3) with v turned about a unit axis by the angle of cosine c and sine s."""
    along = (1.0 - c) * _dot(axis, v)
    out[0] = c * v[0] + s * (axis[1] * v[2] - axis[2] * v[1]) + along * axis[0]
    out[1] = c * v[1] + s * (axis[2] * v[0] - axis[0] * v[2]) + along * axis[1]
    out[2] = c * v[2] + s * (axis[0] * v[1] - axis[1] * v[0]) + along * axis[2]


@inner_njit
def _transposed_times(R: Array, v: Array, out: Array) -> None:
    for i in range(3):
        out[i] = R[0, i] * v[0] + R[1, i] * v[1] + R[2, i] * v[2]


@inner_njit
def _times(R: Array, v: Array, out: Array) -> None:
    for i in range(3):
        out[i] = R[i, 0] * v[0] + R[i, 1] * v[1] + R[i, 2] * v[2]


@inner_njit
def _on(curve: _Curve, theta: float) -> tuple[float, float]:
    """Angle of joint 1 and sign of w's third component at a place on a curve."""
    if not curve.closed:
        return theta, curve.side
    low, high = curve.ends[0], curve.ends[1]
    return 0.5 * (low + high) - 0.5 * (high - low) * np.cos(theta), 1.0 if np.sin(theta) >= 0.0 else -1.0


@inner_njit
def _place(pose: _Pose, curve: _Curve, theta: float, out: Array) -> float:
    """Fill out (2, 10), for both ways of joint 5 at a place on a curve, with g and the cosines and sines of joints 4,
    5, 6 and of the sum of 2 and 3; and room[11], room[12] with z, to which R2 turns p3 - p2; return joint 1's angle."""
    g, R, X, lines, room = pose.g, pose.R, pose.X, pose.lines, pose.room
    q1, side = _on(curve, theta)
    h1, h2, h4, h5, h6 = g[H1 : H1 + 3], g[H2 : H2 + 3], g[H4 : H4 + 3], g[H5 : H5 + 3], g[H6 : H6 + 3]
    e, f, p2 = g[E : E + 3], g[F : F + 3], g[P2 : P2 + 3]
    d = g[D]
    c1, s1 = np.cos(q1), np.sin(q1)
    a = lines[0, 0] + lines[0, 1] * c1 + lines[0, 2] * s1
    b = lines[1, 0] + lines[1, 1] * c1 + lines[1, 2] * s1
    w, m, x, y, v, u, k = room[0], room[1], room[2], room[3], room[4], room[5], room[6]
    third = np.sqrt(max(1.0 - a * a - b * b, 0.0)) * side
    for i in range(3):
        w[i] = a * h6[i] + b * e[i] / d + third * f[i]
    _turned(h1, c1, s1, h2, x)
    _transposed_times(R, x, m)  # axis 2 seen from the flange
    _cross(m, w, x)
    across, along = _dot(h6, x), _dot(m, w) - a * a
    norm = np.sqrt(across * across + along * along)
    c6, s6 = (along / norm, across / norm) if norm > 1e-14 else (1.0, 0.0)
    # R1^T (X - p1) + p1 - R1^T R R6^T e - p2
    _turned(h6, c6, -s6, e, x)
    _times(R, x, y)
    for i in range(3):
        y[i] = X[i] - g[P1 + i] - y[i]
    _turned(h1, c1, -s1, y, x)
    for i in range(3):
        x[i] += g[P1 + i] - p2[i]
    # joint 5 brings w square to h4
    across5 = _dot(h5, w)
    _cross(h5, w, v)
    one, two = _dot(h4, w) - across5 * _dot(h4, h5), _dot(h4, v)
    norm = np.sqrt(one * one + two * two)
    for way in range(2):
        c5, s5 = (-two / norm, one / norm) if norm > 1e-14 else (1.0, 0.0)
        if way == 1:
            c5, s5 = -c5, -s5
        _turned(h5, c5, s5, w, v)
        _cross(v, h2, u)
        c4, s4 = _dot(h2, v), _dot(h4, u)
        # R2 R3 h4 = R1^T R R6^T R5^T h4, square to h2
        _turned(h5, c5, -s5, h4, u)
        _turned(h6, c6, -s6, u, v)
        _times(R, v, u)
        _turned(h1, c1, -s1, u, k)
        _cross(h4, k, u)
        c23, s23 = _dot(h4, k), _dot(h2, u)
        _turned(h2, c23, s23, g[P3C : P3C + 3], u)
        square = 0.0
        up = 0.0
        for i in range(3):
            v[i] = x[i] - u[i]
            up += v[i] * h2[i]
            square += v[i] * v[i]
        row = out[way]
        row[0] = square - up * up - _dot(g[P23 : P23 + 3], g[P23 : P23 + 3])
        row[1], row[2], row[3], row[4], row[5], row[6], row[7], row[8] = c4, s4, c5, s5, c6, s6, c23, s23
        for i in range(3):
            room[11 + way, i] = v[i] - up * h2[i]
    return q1


@inner_njit
def _posture(g: Array, q1: float, row: Array, z: Array, q: Array) -> None:
    """Fill q (6) with the joints at a place on a curve."""
    h2, p23 = g[H2 : H2 + 3], g[P23 : P23 + 3]
    across = (
        h2[0] * (p23[1] * z[2] - p23[2] * z[1])
        + h2[1] * (p23[2] * z[0] - p23[0] * z[2])
        + h2[2] * (p23[0] * z[1] - p23[1] * z[0])
    )
    q[0] = q1
    q[1] = np.arctan2(across, _dot(p23, z))
    q[2] = g[S3] * (np.arctan2(row[8], row[7]) - q[1])
    q[3] = np.arctan2(row[2], row[1])
    q[4] = np.arctan2(row[4], row[3])
    q[5] = np.arctan2(row[6], row[5])


@inner_njit
def _lines(g: Array, R: Array, X: Array, room: Array, lines: Array) -> None:
    """Fill lines (2, 3): a and b of w as a constant, and by cosine and sine of joint 1."""
    h1, h2 = g[H1 : H1 + 3], g[H2 : H2 + 3]
    x, y, k = room[0], room[1], room[2]
    _times(R, g[H6 : H6 + 3], x)
    for i in range(3):
        y[i] = X[i] - g[P1 + i]
    # R1 h2 = (h1 . h2) h1 (1 - c) + c h2 + s h1 x h2
    _cross(h1, h2, k)
    tilt, d = _dot(h1, h2), g[D]
    lines[0, 0], lines[0, 1], lines[0, 2] = tilt * _dot(h1, x), _dot(h2, x) - tilt * _dot(h1, x), _dot(k, x)
    lines[1, 0], lines[1, 1], lines[1, 2] = tilt * _dot(h1, y), _dot(h2, y) - tilt * _dot(h1, y), _dot(k, y)
    for i in range(3):
        lines[1, 0] += h2[i] * (g[P1 + i] - g[C + i])
    for i in range(3):
        lines[1, i] /= d


@inner_njit
def _left(lines: Array, q1: float) -> float:
    """Square of the third component of w."""
    c, s = np.cos(q1), np.sin(q1)
    a = lines[0, 0] + lines[0, 1] * c + lines[0, 2] * s
    b = lines[1, 0] + lines[1, 1] * c + lines[1, 2] * s
    return 1.0 - a * a - b * b


@inner_njit
def _slope(lines: Array, q1: float) -> float:
    """Derivative of `_left` with respect to q1, halved and negated."""
    c, s = np.cos(q1), np.sin(q1)
    a = lines[0, 0] + lines[0, 1] * c + lines[0, 2] * s
    b = lines[1, 0] + lines[1, 1] * c + lines[1, 2] * s
    return a * (lines[0, 2] * c - lines[0, 1] * s) + b * (lines[1, 2] * c - lines[1, 1] * s)


@inner_njit
def _between(lines: Array, slope: bool, low: float, high: float) -> float:
    """A zero of `_left` or `_slope` between two places where its signs differ, by bisection down to rounding."""
    first = _slope(lines, low) if slope else _left(lines, low)
    for _ in range(60):
        middle = 0.5 * (low + high)
        value = _slope(lines, middle) if slope else _left(lines, middle)
        if (value > 0.0) == (first > 0.0):
            low = middle
        else:
            high = middle
        if high - low < 1e-15 * 8.0:
            break
    return 0.5 * (low + high)


@inner_njit
def _intervals(lines: Array, ends: Array) -> tuple[int, bool]:
    """Fill ends (4, 2) with the intervals of joint 1 in which w exists; return their number, or -1 if it always exists,
    and whether one is about to appear, to vanish or to split.

    Between places where its slope changes sign, the square of w's third component is monotonic.
    """
    marks = np.empty(_DOMAIN + 2)
    count = 0
    before = _slope(lines, -np.pi)
    for i in range(_DOMAIN):
        low, high = -np.pi + 2.0 * np.pi * i / _DOMAIN, -np.pi + 2.0 * np.pi * (i + 1) / _DOMAIN
        after = _slope(lines, high)
        if (before > 0.0) != (after > 0.0):
            marks[count] = _between(lines, True, low, high)
            count += 1
        before = after
    if count == 0:
        return -1 if _left(lines, 0.0) >= 0.0 else 0, False
    zeros = np.empty(_DOMAIN + 2)
    rises = np.empty(_DOMAIN + 2, dtype=np.bool_)
    found, barely = 0, False
    for i in range(count):
        start, stop = marks[i], marks[i + 1] if i + 1 < count else marks[0] + 2.0 * np.pi
        one, two = _left(lines, start), _left(lines, stop)
        barely = barely or abs(one) < _BESIDE * _BESIDE
        if (one >= 0.0) != (two >= 0.0):
            zeros[found] = _between(lines, False, start, stop)
            rises[found] = two >= 0.0
            found += 1
    if found == 0:
        return -1 if _left(lines, marks[0]) >= 0.0 else 0, barely
    n = 0
    for i in range(found):
        if rises[i] and n < 4:
            ends[n, 0] = zeros[i]
            ends[n, 1] = zeros[i + 1] if i + 1 < found else zeros[0] + 2.0 * np.pi
            n += 1
    return n, barely


@inner_njit
def _far(one: Array, two: Array) -> bool:
    """Whether any angle differs by more than one step allows."""
    for way in range(2):
        for k in range(1, 9, 2):
            if one[way, k] * two[way, k] + one[way, k + 1] * two[way, k + 1] < 1.0 - 0.5 * _TURN * _TURN:
                return True
    return False


@inner_njit
def _steep(one: Array, two: Array) -> bool:
    """Whether |g| changes so much without a change of sign that there may be two zeros between."""
    for way in range(2):
        low, high = min(abs(one[way, 0]), abs(two[way, 0])), max(abs(one[way, 0]), abs(two[way, 0]))
        if high > _STEEP * low and (one[way, 0] > 0.0) == (two[way, 0] > 0.0):
            return True
    return False


@inner_njit
def _places(pose: _Pose, curve: _Curve, at: Array, rows: Array) -> tuple[int, bool]:
    """Fill at (n) and rows (n, 2, 10) with places all along a curve, as close together as the joints' turning requires;
    return n, and whether a joint turns too quickly for that."""
    step = 2.0 * np.pi / _STEPS
    stack, results = np.empty(_DEEPEST + 2), np.empty((_DEEPEST + 2, 2, 10))
    at[0] = _SEAM
    _place(pose, curve, at[0], rows[0])
    n, quick = 1, False
    for i in range(_STEPS):
        stack[0] = _SEAM + (i + 1) * step
        _place(pose, curve, stack[0], results[0])
        deep = 1
        while deep > 0:
            apart = stack[deep - 1] - at[n - 1]
            fine = not _far(rows[n - 1], results[deep - 1])
            if not fine and apart < 1.5 * step / 2.0**_DEEPEST:
                fine, quick = True, True
            if fine and apart > 1.5 * step / 2.0**_DEEPER:
                fine = not _steep(rows[n - 1], results[deep - 1])
            if deep > _DEEPEST or fine or n + deep >= _MOST:
                at[n] = stack[deep - 1]
                rows[n] = results[deep - 1]
                n += 1
                deep -= 1
            else:
                stack[deep] = 0.5 * (at[n - 1] + stack[deep - 1])
                _place(pose, curve, stack[deep], results[deep])
                deep += 1
            if n >= _MOST:
                return n, True
    return n, quick


@inner_njit
def _keep(pose: _Pose, way: int, q1: float, count: int) -> int:
    """Make the posture of `pose.place` exact, and keep it if that succeeds and it is new; return how many there are."""
    q, p = pose.q, pose.p
    if count >= q.shape[0]:
        return count
    own = q[count]
    _posture(pose.g, q1, pose.place[way], pose.room[11 + way], own)
    placements, axes = p[: 16 * 6].reshape(6, 4, 4), p[16 * 6 : 22 * 6].reshape(6, 6)
    tip = p[22 * 6 : CHAIN].reshape(4, 4)
    if not refine(placements, axes, tip, -1, pose.R_flange, pose.t_flange, own, _POLISH):
        return count
    for j in range(6):
        own[j] = wrap(own[j])
    for k in range(count):
        apart = 0.0
        for j in range(6):
            apart = max(apart, abs(wrap(own[j] - q[k, j])))
        if apart < _SAME:
            return count
    return count + 1


@inner_njit
def all_postures(p: Array, R_flange: Array, t_flange: Array, q: Array) -> int:
    """Fill q (16, 6) with all postures in (-pi, pi] for one flange pose, rotation (3, 3) and origin (3); their number.

    Where axis 5 or 6 is parallel to axis 2, as in the arm's own plane, w leaves joint 5 or 6 undetermined: then the
    postures of poses next to this one are found as well, and made exact for it.
    """
    asked, beside, turned = np.empty((4, 3)), np.empty((4, 3)), np.empty(3)  # rotation and origin
    for i in range(3):
        for j in range(3):
            asked[i, j] = R_flange[i, j]
        asked[3, i] = t_flange[i]
    count, open_ = _postures(p, asked, asked, q, np.int64(0))
    if open_:
        axis = np.array((0.48, -0.6, 0.64))  # not an axis of any arm
        for away in (_BESIDE, -2.0 * _BESIDE):
            for j in range(3):
                _turned(axis, np.cos(away), np.sin(away), R_flange[:, j], turned)
                for i in range(3):
                    beside[i, j] = turned[i]
            for i in range(3):
                beside[3, i] = t_flange[i] + p[CHAIN + D] * away * axis[2 - i]
            count, _ = _postures(p, beside, asked, q, count)
    return count


@inner_njit
def _postures(p: Array, beside: Array, asked: Array, q: Array, count: int) -> tuple[int, bool]:
    """Add to q the postures of a pose (4, 3), rotation and origin, made exact for another pose, `asked`; return their
    number, and whether a joint is nearly undetermined."""
    g = p[CHAIN:]
    room, lines = np.empty((13, 3)), np.empty((2, 3))
    R, X, ends = np.empty((3, 3)), np.empty(3), np.empty((4, 2))
    T_0 = g[T0 : T0 + 16].reshape(4, 4)
    for i in range(3):
        for j in range(3):
            R[i, j] = beside[i, 0] * T_0[j, 0] + beside[i, 1] * T_0[j, 1] + beside[i, 2] * T_0[j, 2]
    for i in range(3):
        X[i] = beside[3, i]
        for j in range(3):  # P = C + e, seen from where the flange was at zero
            X[i] += R[i, j] * (g[C + j] + g[E + j] - T_0[j, 3])
    _lines(g, R, X, room, lines)
    n_intervals, open_ = _intervals(lines, ends)
    curves = 2 if n_intervals < 0 else n_intervals
    at, rows = np.empty(_MOST + 1), np.empty((_MOST + 1, 2, 10))
    pose = _Pose(p, g, asked[:3], asked[3], R, X, lines, room, np.empty((2, 10)), q)
    for k in range(curves):
        closed = n_intervals >= 0
        curve = _Curve(closed, ends[k if closed else 0], 1.0 if k == 0 else -1.0)
        n, quick = _places(pose, curve, at, rows)
        open_ = open_ or quick
        for way in range(2):
            for i in range(n - 1):
                value, after = rows[i, way, 0], rows[i + 1, way, 0]
                if (value > 0.0) != (after > 0.0):
                    count = _zero(pose, curve, way, (at[i], at[i + 1]), (value, after), count)
                    continue
                h = i - 1 if i > 0 else n - 2  # the last place is the first one
                before = rows[h, way, 0]
                if abs(value) <= abs(before) and abs(value) < abs(after) and (before > 0.0) == (value > 0.0):
                    start = at[h] - (0.0 if i > 0 else 2.0 * np.pi)
                    count = _pair(pose, curve, way, (start, at[i], at[i + 1]), (before, value, after), count)
    return count, open_


@inner_njit
def _zero(
    pose: _Pose, curve: _Curve, way: int, at: tuple[float, float], values: tuple[float, float], count: int
) -> int:
    """Keep the posture between two places of a curve where the signs of g differ (Illinois method)."""
    low, high = at
    f_low, f_high = values
    last, q1 = 0, 0.0
    for _ in range(60):
        theta = high - f_high * (high - low) / (f_high - f_low)
        if not low < theta < high:
            theta = 0.5 * (low + high)
        q1 = _place(pose, curve, theta, pose.place)
        value = pose.place[way, 0]
        if abs(value) < 1e-9 or high - low < 1e-10:
            break
        if (value > 0.0) == (f_high > 0.0):
            high, f_high = theta, value
            if last == 1:
                f_low *= 0.5
            last = 1
        else:
            low, f_low = theta, value
            if last == -1:
                f_high *= 0.5
            last = -1
    return _keep(pose, way, q1, count)


@inner_njit
def _pair(
    pose: _Pose, curve: _Curve, way: int, at: tuple[float, float, float], values: tuple[float, float, float], count: int
) -> int:
    """Keep both postures, or the one in which they coincide, around the middle place, where |g| is least, if any."""
    low, middle, high = at
    f_low, f_middle, f_high = values
    sign = 1.0 if f_middle > 0.0 else -1.0
    # how far a parabola through the three would fall, and some more, since g is not one
    one, two = (f_middle - f_low) / (middle - low), (f_high - f_middle) / (high - middle)
    bend = (two - one) / (high - low)
    slope = one + bend * (middle - low)
    fall = slope * slope / (4.0 * abs(bend)) if bend != 0.0 else np.inf
    if abs(f_middle) > 4.0 * fall + max(abs(f_low - f_middle), abs(f_high - f_middle)):
        return count
    for _ in range(40):
        # a golden section of the wider side, unless a parabola gives a better place
        left = middle - low > high - middle
        theta = middle - 0.381966 * (middle - low) if left else middle + 0.381966 * (high - middle)
        one, two = (f_middle - f_low) / (middle - low), (f_high - f_middle) / (high - middle)
        bend = (two - one) / (high - low)
        if bend * sign > 0.0:
            vertex = middle - 0.5 * (one + bend * (middle - low)) / bend
            if low < vertex < high and abs(vertex - middle) > 1e-3 * (high - low):
                theta = vertex
        _place(pose, curve, theta, pose.place)
        value = pose.place[way, 0]
        if value * sign <= 0.0:
            count = _zero(pose, curve, way, (at[0], theta), (values[0], value), count)
            return _zero(pose, curve, way, (theta, at[2]), (value, values[2]), count)
        if abs(value) < abs(f_middle):
            if theta < middle:
                high, f_high = middle, f_middle
            else:
                low, f_low = middle, f_middle
            middle, f_middle = theta, value
        elif theta < middle:
            low, f_low = theta, value
        else:
            high, f_high = theta, value
        if high - low < 1e-7:
            break
    p23 = pose.g[P23 : P23 + 3]
    if abs(f_middle) > _TOUCHES * _dot(p23, p23):
        return count
    q1 = _place(pose, curve, middle, pose.place)
    return _keep(pose, way, q1, count)


# ----------------------------------------------------------------------------------------------------
# The slot of a posture: its label, and of postures that share a label, the less singular one first.


@inner_njit
def label_of(p: Array, q: Array, lines: Array, T: Array, J: Array, A: Array) -> tuple[int, float]:
    """Label of a posture q (6), and |det| of its Jacobian; lines (2, 6, 3), T (4, 4), J, A (6, 6) are scratch.

    Behind axis 1 and elbow refer to C, where axes 4 and 5 meet; the third bit is what the determinant's sign adds to
    them: for a spherical wrist, the sign of joint 5.
    """
    placements, axes = p[: 16 * 6].reshape(6, 4, 4), p[16 * 6 : 22 * 6].reshape(6, 6)
    chain_state(placements, axes, p[22 * 6 : CHAIN].reshape(4, 4), q, lines[0], lines[1], T)
    jacobian_at(lines[0], lines[1], T[:3, 3], J)
    det = _determinant(J, A)
    g = p[CHAIN:]
    h1, h2 = g[H1 : H1 + 3], g[H2 : H2 + 3]
    q23 = q[1] + g[S3] * q[2]
    upper, fore, k = lines[0, 0], lines[0, 1], lines[0, 2]
    _turned(h2, np.cos(q[1]), np.sin(q[1]), g[P23 : P23 + 3], upper)
    _turned(h2, np.cos(q23), np.sin(q23), g[P3C : P3C + 3], fore)
    _cross(upper, fore, k)
    elbow = _dot(k, h2)
    _cross(h2, h1, k)
    ahead = 0.0
    for i in range(3):
        ahead += k[i] * (g[P2 + i] + upper[i] + fore[i] - g[P1 + i])
    label = 0
    if ahead < 0.0:
        label += BEHIND_AXIS_1
    if elbow < 0.0:
        label += ELBOW_NEGATIVE
    if (det < 0.0) != ((ahead < 0.0) != (elbow < 0.0)):
        label += TURNED
    return label, abs(det)


@inner_njit
def _determinant(J: Array, A: Array) -> float:
    """Determinant of J (6, 6); A (6, 6) is scratch."""
    for i in range(6):
        for j in range(6):
            A[i, j] = J[i, j]
    det = 1.0
    for k in range(6):
        best = k
        for i in range(k + 1, 6):
            if abs(A[i, k]) > abs(A[best, k]):
                best = i
        if A[best, k] == 0.0:
            return 0.0
        if best != k:
            det = -det
            for j in range(6):
                A[k, j], A[best, j] = A[best, j], A[k, j]
        det *= A[k, k]
        for i in range(k + 1, 6):
            share = A[i, k] / A[k, k]
            for j in range(k + 1, 6):
                A[i, j] -= share * A[k, j]
    return det


@njit
def solve_one(p: Array, R: Array, t: Array, q: Array, ok: NDArray[np.bool_]) -> None:
    """Fill q (16, 6) and ok (16) with the postures for one flange pose, rotation R (3, 3) and origin t (3).

    The index of a posture is its label, plus 8 for a label's second, more singular one; a third gets any free index.
    """
    found = np.empty((SLOTS, 6))
    ok[:] = False
    count = all_postures(p, R, t, found)
    labels, dets = np.empty(SLOTS, dtype=np.int64), np.empty(SLOTS)
    lines, T, J, A = np.empty((2, 6, 3)), np.empty((4, 4)), np.empty((6, 6)), np.empty((6, 6))
    for k in range(count):
        labels[k], dets[k] = label_of(p, found[k], lines, T, J, A)
    for late in range(2):  # third and further postures of a label come last
        for k in range(count):
            rank = 0
            for other in range(count):
                if labels[other] == labels[k] and (dets[other] > dets[k] or (dets[other] == dets[k] and other < k)):
                    rank += 1
            if (rank >= 2) != (late == 1):
                continue
            slot = int(labels[k]) + LABELS * rank
            if late == 1:
                slot = SLOTS - 1
                while ok[slot]:
                    slot -= 1
            for j in range(6):
                q[slot, j] = found[k, j]
            ok[slot] = True


@njit
def solve_all(p: Array, T: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Postures (m, 16, 6) of flange poses (m, 4, 4), and which exist (m, 16)."""
    m = T.shape[0]
    q, ok = np.zeros((m, SLOTS, 6)), np.zeros((m, SLOTS), dtype=np.bool_)
    for i in range(m):
        solve_one(p, T[i, :3, :3], T[i, :3, 3], q[i], ok[i])
    return q, ok


@njit
def slots_of(p: Array, T: Array, q: Array) -> NDArray[np.int8]:
    """Slots (m) of postures q (m, 6), whose flange poses are T (m, 4, 4): those of the nearest of a pose's postures."""
    out = np.empty(q.shape[0], dtype=np.int8)
    found, ok = np.empty((SLOTS, 6)), np.empty(SLOTS, dtype=np.bool_)
    lines, own, J, A = np.empty((2, 6, 3)), np.empty((4, 4)), np.empty((6, 6)), np.empty((6, 6))
    for i in range(q.shape[0]):
        solve_one(p, T[i, :3, :3], T[i, :3, 3], found, ok)
        label, _ = label_of(p, q[i], lines, own, J, A)
        out[i], least = label, 1e-3  # rad: near a singularity, two postures are this close together
        for k in range(SLOTS):
            if ok[k]:
                apart = 0.0
                for j in range(6):
                    apart = max(apart, abs(wrap(found[k, j] - q[i, j])))
                if apart < least:
                    out[i], least = k, apart
    return out
