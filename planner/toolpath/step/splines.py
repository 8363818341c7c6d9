"""Rational B-spline surfaces, several in one set: values, derivatives, normals, and the feet of perpendiculars.

All faces of a STEP file become such surfaces exactly. Beyond its domain a surface continues the polynomials at
its rim.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from planner.base.arrays import Array, Ints, ReadOnlyArrays
from planner.base.compiled import inner_njit, njit

BEYOND = 0.02  # share of the domain's width by which a surface is followed beyond its rim
_POLE = 1e-7  # m: a shorter side of a surface is a pole
_NEWTON_STEPS = 30
_CLOSE = 1e-12  # m: a shorter step has reached the foot
_FARTHEST_STEP = 0.25  # greatest Newton step, as a share of the domain's width
_NUDGE = 1e-5  # share of the way to the domain's middle by which to step aside where there is no normal (a pole)
_NO_NORMAL = 1e-9  # sine between the tangents, or ratio of their lengths, below which there is no normal
_TINY = 1e-300


@dataclass(frozen=True)
class SplineSurface(ReadOnlyArrays):
    """One surface: knots with their multiplicities (p + 1 at both ends), homogeneous poles (nu, nv, 4) [m]."""

    knots_u: Array
    knots_v: Array
    poles: Array

    @property
    def degrees(self) -> tuple[int, int]:
        """Along u and v."""
        return len(self.knots_u) - self.poles.shape[0] - 1, len(self.knots_v) - self.poles.shape[1] - 1

    @property
    def domain(self) -> Array:
        """Least and greatest u and v, (2, 2)."""
        p, q = self.degrees
        u, v = self.knots_u, self.knots_v
        return np.array([[u[p], v[q]], [u[-p - 1], v[-q - 1]]])

    @property
    def reach(self) -> Array:
        """Least and greatest u and v (2, 2) to which it is followed: a little beyond its rim, but not beyond a pole."""
        domain, places = self.domain, self.poles[:, :, :3] / self.poles[:, :, 3:]
        beyond = BEYOND * (domain[1] - domain[0])
        out = np.stack([domain[0] - beyond, domain[1] + beyond])
        for end, at in ((0, 0), (1, -1)):
            for axis in (0, 1):
                if np.ptp(np.take(places, at, axis=axis), axis=0).max() < _POLE:
                    out[end, axis] = domain[end, axis]
        return out

    def placed(self, turn: Array, origin: Array) -> SplineSurface:
        """The surface turned (3, 3), then moved (3)."""
        weight = self.poles[:, :, 3:]
        return SplineSurface(
            self.knots_u,
            self.knots_v,
            np.concatenate([self.poles[:, :, :3] @ turn.T + weight * origin, weight], axis=2),
        )


class SplineArrays(NamedTuple):
    """A `SplineSet` as compiled kernels take it: its fields, with their shapes."""

    knots: Array
    poles: Array
    table: Ints
    domain: Array


@dataclass(frozen=True)
class SplineSet(ReadOnlyArrays):
    """B-spline surfaces packed into flat arrays.

    table  (k, 8): degrees, first knots, first pole, numbers of poles
    domain (k, 4, 2): least and greatest u and v; then the limits to which a surface is followed, which never lie
           beyond a pole
    """

    knots: Array
    poles: Array
    table: Ints
    domain: Array

    @classmethod
    def of(cls, surfaces: Sequence[SplineSurface]) -> SplineSet:
        """The set of surfaces, at least one."""
        table, knots, poles = [], [], []
        knot = pole = 0
        for s in surfaces:
            nu, nv = s.poles.shape[:2]
            p, q = s.degrees
            table.append([p, q, knot, knot + len(s.knots_u), pole, nu, nv, 0])
            knots += [s.knots_u, s.knots_v]
            poles.append(s.poles.reshape(-1, 4))
            knot, pole = knot + len(s.knots_u) + len(s.knots_v), pole + nu * nv
        return cls(
            np.concatenate(knots),
            np.ascontiguousarray(np.vstack(poles)),
            np.array(table, dtype=np.int64),
            np.array([np.vstack([s.domain, s.reach]) for s in surfaces]),
        )

    @property
    def arrays(self) -> SplineArrays:
        """The arrays that kernels use."""
        return SplineArrays(self.knots, self.poles, self.table, self.domain)

    def points(self, face: Ints, uv: Array) -> Array:
        """Points (n, 3) [m] of surfaces face (n) at parameters (n, 2)."""
        return self.derivatives(face, uv)[:, 0]

    def derivatives(self, face: Ints, uv: Array) -> Array:
        """Values and derivatives by u, v, uu, uv, vv (n, 6, 3) of surfaces face (n) at parameters (n, 2)."""
        return _derivatives(
            np.ascontiguousarray(face, dtype=np.int64), np.ascontiguousarray(uv), self.knots, self.poles, self.table
        )

    def normals(self, face: Ints, uv: Array) -> Array:
        """Unit normals (n, 3), du x dv, of surfaces face (n) at parameters (n, 2); at a pole, those next to it."""
        return _normals(
            np.ascontiguousarray(face, dtype=np.int64),
            np.ascontiguousarray(uv),
            self.knots,
            self.poles,
            self.table,
            self.domain,
        )

    def bends(self, face: Ints, uv: Array) -> Array:
        """Principal curvatures (n, 2) [1/m], the lesser one first: positive where a surface bends towards du x dv."""
        d = self.derivatives(face, uv)
        normal = self.normals(face, uv)
        E, F, G = ((a * b).sum(axis=1) for a, b in ((d[:, 1], d[:, 1]), (d[:, 1], d[:, 2]), (d[:, 2], d[:, 2])))
        L, M, N = ((d[:, k] * normal).sum(axis=1) for k in (3, 4, 5))
        area = np.maximum(E * G - F * F, _TINY)
        mean, gauss = (E * N - 2.0 * F * M + G * L) / (2.0 * area), (L * N - M * M) / area
        apart = np.sqrt(np.maximum(mean**2 - gauss, 0.0))
        return np.column_stack([mean - apart, mean + apart])


@inner_njit
def _span(u: float, knots: Array, first: int, p: int, n: int) -> int:
    """Index i of the knot below u, p <= i < n: the first and last spans extend beyond the domain."""
    low, high = p, n
    while high - low > 1:
        middle = (low + high) // 2
        if u < knots[first + middle]:
            high = middle
        else:
            low = middle
    return low


@inner_njit
def _basis(u: float, span: int, knots: Array, first: int, p: int, out: Array) -> None:
    """The nonzero B-splines of degree p in a span, with two derivatives: out (3, p + 1).

    Derivatives come from the splines of degrees p - 1 and p - 2, which differ only in their normalisation.
    """
    low = np.zeros((3, p + 1))  # degrees p - 2, p - 1, p
    value = np.zeros(p + 1)
    value[0] = 1.0
    left, right = np.zeros(p + 1), np.zeros(p + 1)
    if p <= 2:
        low[max(2 - p, 0), 0] = 1.0
    for j in range(1, p + 1):
        left[j] = u - knots[first + span + 1 - j]
        right[j] = knots[first + span + j] - u
        saved = 0.0
        for r in range(j):
            ratio = value[r] / (right[r + 1] + left[j - r])
            value[r] = saved + right[r + 1] * ratio
            saved = left[j - r] * ratio
        value[j] = saved
        if j >= p - 2:
            for r in range(j + 1):
                low[j - p + 2, r] = value[r]
    # derivative of the k-th of degree d: d (N_k^(d-1) / width - N_(k+1)^(d-1) / width)
    slope = np.zeros(p + 1)  # of degree p - 1
    for k in range(p + 1):
        out[0, k] = low[2, k]
        out[1, k] = 0.0
        out[2, k] = 0.0
    if p >= 2:
        for k in range(p):
            i = first + span - p + 1 + k
            total = 0.0
            if k > 0:
                total += low[0, k - 1] / (knots[i + p - 1] - knots[i])
            if k < p - 1:
                total -= low[0, k] / (knots[i + p] - knots[i + 1])
            slope[k] = (p - 1) * total
    for k in range(p + 1):
        i = first + span - p + k
        if k > 0:
            width = knots[i + p] - knots[i]
            out[1, k] += p * low[1, k - 1] / width
            out[2, k] += p * slope[k - 1] / width
        if k < p:
            width = knots[i + p + 1] - knots[i + 1]
            out[1, k] -= p * low[1, k] / width
            out[2, k] -= p * slope[k] / width


@inner_njit
def _evaluate(face: int, u: float, v: float, knots: Array, poles: Array, table: Ints, out: Array) -> None:
    """Fill the value and derivatives by u, v, uu, uv, vv (6, 3) of a surface."""
    p, q, fu, fv, fp, nu, nv = (
        table[face, 0],
        table[face, 1],
        table[face, 2],
        table[face, 3],
        table[face, 4],
        table[face, 5],
        table[face, 6],
    )
    i, j = _span(u, knots, fu, p, nu), _span(v, knots, fv, q, nv)
    bu, bv = np.empty((3, p + 1)), np.empty((3, q + 1))
    _basis(u, i, knots, fu, p, bu)
    _basis(v, j, knots, fv, q, bv)
    h = np.zeros((6, 4))
    for a in range(p + 1):
        row = fp + (i - p + a) * nv + j - q
        for k in range(4):
            f = fd = fdd = 0.0
            for b in range(q + 1):
                c = poles[row + b, k]
                f += bv[0, b] * c
                fd += bv[1, b] * c
                fdd += bv[2, b] * c
            h[0, k] += bu[0, a] * f
            h[1, k] += bu[1, a] * f
            h[2, k] += bu[0, a] * fd
            h[3, k] += bu[2, a] * f
            h[4, k] += bu[1, a] * fd
            h[5, k] += bu[0, a] * fdd
    w = h[0, 3]
    for k in range(3):
        s = h[0, k] / w
        su, sv = (h[1, k] - h[1, 3] * s) / w, (h[2, k] - h[2, 3] * s) / w
        out[0, k], out[1, k], out[2, k] = s, su, sv
        out[3, k] = (h[3, k] - 2.0 * h[1, 3] * su - h[3, 3] * s) / w
        out[4, k] = (h[4, k] - h[1, 3] * sv - h[2, 3] * su - h[4, 3] * s) / w
        out[5, k] = (h[5, k] - 2.0 * h[2, 3] * sv - h[5, 3] * s) / w


@njit
def _derivatives(face: Ints, uv: Array, knots: Array, poles: Array, table: Ints) -> Array:
    out = np.empty((len(uv), 6, 3))
    for i in range(len(uv)):
        _evaluate(face[i], uv[i, 0], uv[i, 1], knots, poles, table, out[i])
    return out


@inner_njit
def fill_normal(
    face: int, u: float, v: float, knots: Array, poles: Array, table: Ints, domain: Array, out: Array
) -> None:
    """Fill the unit normal (3) at a place or, if there is none, at one slightly nearer to the domain's middle."""
    d = np.empty((6, 3))
    for _ in range(3):
        _evaluate(face, u, v, knots, poles, table, d)
        a, b = d[1], d[2]
        out[0] = a[1] * b[2] - a[2] * b[1]
        out[1] = a[2] * b[0] - a[0] * b[2]
        out[2] = a[0] * b[1] - a[1] * b[0]
        size = np.sqrt(out[0] ** 2 + out[1] ** 2 + out[2] ** 2)
        la = (domain[face, 1, 0] - domain[face, 0, 0]) * np.sqrt(a[0] ** 2 + a[1] ** 2 + a[2] ** 2)
        lb = (domain[face, 1, 1] - domain[face, 0, 1]) * np.sqrt(b[0] ** 2 + b[1] ** 2 + b[2] ** 2)
        longest = max(la, lb)
        span = (domain[face, 1, 0] - domain[face, 0, 0]) * (domain[face, 1, 1] - domain[face, 0, 1])
        if size * span > _NO_NORMAL * longest * longest:
            break
        u += _NUDGE * (0.5 * (domain[face, 0, 0] + domain[face, 1, 0]) - u)
        v += _NUDGE * (0.5 * (domain[face, 0, 1] + domain[face, 1, 1]) - v)
    for k in range(3):
        out[k] /= max(size, _TINY)


@njit
def _normals(face: Ints, uv: Array, knots: Array, poles: Array, table: Ints, domain: Array) -> Array:
    out = np.empty((len(uv), 3))
    for i in range(len(uv)):
        fill_normal(face[i], uv[i, 0], uv[i, 1], knots, poles, table, domain, out[i])
    return out


@inner_njit
def foot_of(
    x: Array, face: int, u: float, v: float, knots: Array, poles: Array, table: Ints, domain: Array, d: Array
) -> tuple[float, float]:
    """Parameters of the foot from a point x (3); d (6, 3) is filled with the value and derivatives there."""
    wide, deep = domain[face, 1, 0] - domain[face, 0, 0], domain[face, 1, 1] - domain[face, 0, 1]
    u0, u1, v0, v1 = domain[face, 2, 0], domain[face, 3, 0], domain[face, 2, 1], domain[face, 3, 1]
    for _ in range(_NEWTON_STEPS):
        _evaluate(face, u, v, knots, poles, table, d)
        gu = gv = a = b = c = xa = xb = xc = 0.0
        for k in range(3):
            e = d[0, k] - x[k]
            gu += e * d[1, k]
            gv += e * d[2, k]
            a += d[1, k] * d[1, k]
            b += d[1, k] * d[2, k]
            c += d[2, k] * d[2, k]
            xa += e * d[3, k]
            xb += e * d[4, k]
            xc += e * d[5, k]
        full = (a + xa) * (c + xc) - (b + xb) ** 2
        if a + xa > 0.0 and full > 0.1 * (a * c - b * b):  # full Newton; otherwise Gauss-Newton
            a, b, c = a + xa, b + xb, c + xc
        a, c = a + _TINY, c + _TINY
        # at a rim, move only along it
        held_u = (u <= u0 and gu > 0.0) or (u >= u1 and gu < 0.0)
        held_v = (v <= v0 and gv > 0.0) or (v >= v1 and gv < 0.0)
        if held_u and held_v:
            break
        if held_u:
            du, dv = 0.0, -gv / c
        elif held_v:
            du, dv = -gu / a, 0.0
        else:
            det = a * c - b * b
            if det <= 1e-14 * a * c:
                du, dv = -gu / a, -gv / c
            else:
                du, dv = (b * gv - c * gu) / det, (b * gu - a * gv) / det
        most = max(abs(du) / wide, abs(dv) / deep)
        if most > _FARTHEST_STEP:
            du, dv = du * _FARTHEST_STEP / most, dv * _FARTHEST_STEP / most
        before_u, before_v = u, v
        u, v = min(max(u + du, u0), u1), min(max(v + dv, v0), v1)
        if np.sqrt(a) * abs(u - before_u) + np.sqrt(c) * abs(v - before_v) < _CLOSE:
            break
    _evaluate(face, u, v, knots, poles, table, d)
    return u, v
