"""The surface of a mesh: its facets in a tree of boxes, and a smooth height field through them.

The tree finds the facet nearest to a point, and the highest facet at x, y. The height field z = f(x, y) is a spline of
degree 5, as coarse as the facets allow. A facet's own normal jumps at its edges, where a nozzle that follows it would
stop; the field has four continuous derivatives, and its distance from the facets is bounded.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import comb

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BSpline
from scipy.sparse import coo_array, csr_array, diags_array, eye_array, kron
from scipy.sparse.linalg import splu

from planner.base.arrays import Array, Ints, ReadOnlyArrays, read_only
from planner.base.compiled import inner_njit, njit

_LEAF = 4  # facets in a leaf
_BITS = 20  # of each coordinate that facets are sorted by
_DEPTH = 64  # of the stack: twice the nesting of boxes that is possible
_UPWARD = 1e-6  # least upward component of the normal of a facet that is seen from above
_RIM = 1e-9  # of a facet: a point this little outside still lies on it, so that no ray slips between two
_TINY = 1e-30
_KEPT = 16  # trees of layers, each of about 10 MB for a large part

_DEGREE = 5
_STIFF = 1e-7  # weight of third differences relative to a sample's: they extrapolate the surface where nothing is known
_NEWTON_STEPS = 12
_HALFWAY = 1.5  # × a step: less is the same step, apart from rounding
_CLOSE = 1e-12  # m: a smaller step has reached the nearest point


@dataclass(frozen=True)
class FacetTree(ReadOnlyArrays):
    """Facets, sorted so that neighbours are close together, and the boxes of a complete binary tree over them.

    corners (n, 3, 3) [m], counter-clockwise seen from outside; normals (n, 3) of unit length
    low, high (m, 3)  of the boxes; box 0 holds all, box i those of 2 i + 1 and 2 i + 2, the last row is of leaves
    turned  how many facets face the other way in their file
    """

    corners: Array
    normals: Array
    low: Array
    high: Array
    turned: int = 0

    @classmethod
    def of(cls, corners: Array, turned: int = 0) -> FacetTree:
        """The tree of facets (n, 3, 3), n at least 1, each with a non-zero area."""
        order = np.argsort(_morton(corners.mean(axis=1)), kind="stable")
        corners = np.ascontiguousarray(corners[order])
        across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        normals = across / np.linalg.norm(across, axis=1)[:, None]
        n = len(corners)
        leaves = 1 << int(np.ceil(np.log2(max(n / _LEAF, 1.0))))
        low, high = np.full((leaves * _LEAF, 3), np.inf), np.full((leaves * _LEAF, 3), -np.inf)
        low[:n], high[:n] = corners.min(axis=1), corners.max(axis=1)
        lows, highs = [low.reshape(leaves, _LEAF, 3).min(axis=1)], [high.reshape(leaves, _LEAF, 3).max(axis=1)]
        while len(lows[0]) > 1:
            lows.insert(0, lows[0].reshape(-1, 2, 3).min(axis=1))
            highs.insert(0, highs[0].reshape(-1, 2, 3).max(axis=1))
        return cls(corners, normals, np.vstack(lows), np.vstack(highs), turned)

    @classmethod
    def over(cls, grid: Array) -> FacetTree | None:
        """The tree of facets between the places of a grid (n, m, 3), where they are not NaN; None if there are none."""
        a, b, c, d = grid[:-1, :-1], grid[1:, :-1], grid[1:, 1:], grid[:-1, 1:]
        facets = np.concatenate([np.stack(each, axis=-2).reshape(-1, 3, 3) for each in ((a, b, c), (a, c, d))])
        facets = facets[np.isfinite(facets).all(axis=(1, 2))]
        return cls.of(facets) if len(facets) else None

    def distance(self, points: Array) -> Array:
        """Distance (n,) of points (n, 3) from the nearest facet [m]."""
        return _distance(read_only(points), self.corners, self.low, self.high)

    def top(self, plane: Array) -> tuple[Array, Ints]:
        """The highest facet that is seen from above at x, y (n, 2): z there [m], or NaN; its index, or -1."""
        return _top(np.ascontiguousarray(plane), self.corners, self.normals, self.low, self.high)

    def upward(self, plane: Array) -> Array:
        """Upward components (n,) of the normals of the highest facets at x, y (n, 2); NaN where there is none."""
        found = self.top(plane)[1]
        return np.where(found >= 0, self.normals[found, 2], np.nan)


class LastTrees:
    """Facets of a part that grows by layers, by their number: the last few requested, as all would take gigabytes."""

    def __init__(self) -> None:
        self._trees: dict[int, FacetTree | None] = {}

    def of(self, solid: int, facets: Callable[[], FacetTree | None]) -> FacetTree | None:
        """The tree of `solid` layers, which `facets` makes."""
        tree = self._trees.pop(solid, None) or facets()
        self._trees[solid] = tree
        for old in list(self._trees)[:-_KEPT]:
            self._trees.pop(old, None)
        return tree


def _morton(points: Array) -> NDArray[np.uint64]:
    """Interleaved bits of the coordinates of points (n, 3): what is near in this order is near in space."""
    span = np.maximum(np.ptp(points, axis=0).max(), _TINY)
    cell = ((points - points.min(axis=0)) / span * (2**_BITS - 1)).astype(np.uint64)
    code = np.zeros(len(points), dtype=np.uint64)
    for bit in range(_BITS):
        for axis in range(3):
            code |= ((cell[:, axis] >> np.uint64(bit)) & np.uint64(1)) << np.uint64(3 * bit + axis)
    return code


@inner_njit
def _box_gap(p: Array, low: Array, high: Array) -> float:
    """Squared distance of a point (3) from a box."""
    square = 0.0
    for k in range(3):
        gap = max(low[k] - p[k], 0.0, p[k] - high[k])
        square += gap * gap
    return square


@inner_njit
def _facet_gap(p: Array, t: Array) -> float:
    """Squared distance of a point (3) from a facet (3, 3); after Ericson, Real-Time Collision Detection, 5.1.5."""
    d1 = d2 = d3 = d4 = d5 = d6 = 0.0
    for k in range(3):
        ab, ac = t[1, k] - t[0, k], t[2, k] - t[0, k]
        d1 += ab * (p[k] - t[0, k])
        d2 += ac * (p[k] - t[0, k])
        d3 += ab * (p[k] - t[1, k])
        d4 += ac * (p[k] - t[1, k])
        d5 += ab * (p[k] - t[2, k])
        d6 += ac * (p[k] - t[2, k])
    va, vb, vc = d3 * d6 - d5 * d4, d5 * d2 - d1 * d6, d1 * d4 - d3 * d2
    v = w = 0.0  # shares of the second and third corner in the nearest point
    if d1 <= 0.0 and d2 <= 0.0:
        pass
    elif d3 >= 0.0 and d4 <= d3:
        v = 1.0
    elif d6 >= 0.0 and d5 <= d6:
        w = 1.0
    elif vc <= 0.0 and d1 >= 0.0 and d3 <= 0.0:
        v = d1 / max(d1 - d3, _TINY)
    elif vb <= 0.0 and d2 >= 0.0 and d6 <= 0.0:
        w = d2 / max(d2 - d6, _TINY)
    elif va <= 0.0 and d4 >= d3 and d5 >= d6:
        w = (d4 - d3) / max((d4 - d3) + (d5 - d6), _TINY)
        v = 1.0 - w
    else:
        total = va + vb + vc
        v, w = vb / total, vc / total
    square = 0.0
    for k in range(3):
        gap = p[k] - t[0, k] - v * (t[1, k] - t[0, k]) - w * (t[2, k] - t[0, k])
        square += gap * gap
    return square


@njit
def _distance(points: Array, corners: Array, low: Array, high: Array) -> Array:
    n, first_leaf = len(corners), len(low) // 2
    out = np.empty(len(points))
    stack = np.empty(_DEPTH, dtype=np.int64)
    nearest = 0  # facet of the previous point: a good first guess for the next
    for i in range(len(points)):
        p = points[i]
        best = _facet_gap(p, corners[nearest])
        stack[0], size = 0, 1
        while size > 0:
            size -= 1
            box = stack[size]
            if _box_gap(p, low[box], high[box]) >= best:
                continue
            if box >= first_leaf:
                start = (box - first_leaf) * _LEAF
                for facet in range(start, min(start + _LEAF, n)):
                    gap = _facet_gap(p, corners[facet])
                    if gap < best:
                        best, nearest = gap, facet
                continue
            left, right = 2 * box + 1, 2 * box + 2
            if _box_gap(p, low[left], high[left]) < _box_gap(p, low[right], high[right]):
                left, right = right, left
            stack[size], stack[size + 1] = left, right  # the nearer one is searched first
            size += 2
        out[i] = np.sqrt(best)
    return out


@njit
def _top(plane: Array, corners: Array, normals: Array, low: Array, high: Array) -> tuple[Array, Ints]:
    n, first_leaf = len(corners), len(low) // 2
    out, found = np.full(len(plane), np.nan), np.full(len(plane), -1, dtype=np.int64)
    stack = np.empty(_DEPTH, dtype=np.int64)
    for i in range(len(plane)):
        x, y = plane[i, 0], plane[i, 1]
        best = -np.inf
        stack[0], size = 0, 1
        while size > 0:
            size -= 1
            box = stack[size]
            if x < low[box, 0] or x > high[box, 0] or y < low[box, 1] or y > high[box, 1] or high[box, 2] <= best:
                continue
            if box < first_leaf:
                stack[size], stack[size + 1] = 2 * box + 1, 2 * box + 2
                size += 2
                continue
            start = (box - first_leaf) * _LEAF
            for facet in range(start, min(start + _LEAF, n)):
                if normals[facet, 2] < _UPWARD:
                    continue
                t = corners[facet]
                ux, uy, wx, wy = t[1, 0] - t[0, 0], t[1, 1] - t[0, 1], t[2, 0] - t[0, 0], t[2, 1] - t[0, 1]
                area = ux * wy - uy * wx
                v = ((x - t[0, 0]) * wy - (y - t[0, 1]) * wx) / area
                w = (ux * (y - t[0, 1]) - uy * (x - t[0, 0])) / area
                if v < -_RIM or w < -_RIM or v + w > 1.0 + _RIM:
                    continue
                z = t[0, 2] + v * (t[1, 2] - t[0, 2]) + w * (t[2, 2] - t[0, 2])
                if z > best:
                    best = z
                    out[i], found[i] = z, facet
    return out, found


def _basis() -> Array:
    """Rows k: the polynomial, lowest power first, of the k-th of the six B-splines that are not 0 on [0, 1]."""
    spline = BSpline.basis_element(np.arange(_DEGREE + 2.0))
    t = np.linspace(0.0, 1.0, _DEGREE + 1)
    powers = t[:, None] ** np.arange(_DEGREE + 1)
    return np.array([np.linalg.solve(powers, spline(np.minimum(t + _DEGREE - k, 6.0))) for k in range(_DEGREE + 1)])


_BASIS = _basis()


@dataclass(frozen=True)
class HeightField(ReadOnlyArrays):
    """f on a rectangle that begins at `corner` (2), with knots `step` apart [m] and coefficients (nx, ny) [m]."""

    corner: Array
    step: float
    coefficients: Array

    @property
    def span(self) -> tuple[Array, Array]:
        """The rectangle's corners with the least and the greatest x and y (2)."""
        return self.corner, self.corner + self.step * (np.array(self.coefficients.shape) - _DEGREE)

    def at(self, plane: Array) -> tuple[Array, Array]:
        """Points (n, 3) and upward unit normals (n, 3) at x, y (n, 2), clamped to the rectangle."""
        values = _values(np.ascontiguousarray(plane), self.corner, self.step, self.coefficients, _BASIS)
        points = np.column_stack([plane, values[:, 0]])
        normals = np.column_stack([-values[:, 1], -values[:, 2], np.ones(len(plane))])
        return points, normals / np.linalg.norm(normals, axis=1)[:, None]

    def nearest(self, points: Array) -> Array:
        """x, y (n, 2) of the places whose normals pass through points (n, 3), searched from above or below them."""
        return _nearest(read_only(points), self.corner, self.step, self.coefficients, _BASIS)

    def level(self, z: float) -> HeightField:
        """The plane at height z [m], with the same knots."""
        return HeightField(self.corner, self.step, np.full(self.coefficients.shape, z))

    def refined(self, finer: HeightField) -> HeightField:
        """The same surface with the knots of a finer one, whose spacing is this one's, halved some number of times.

        Both begin at the same corner, and this one reaches as far.
        """
        step, heights = self.step, self.coefficients
        while step > _HALFWAY * finer.step:
            step, heights = 0.5 * step, _halved(_halved(heights).T).T
        nx, ny = finer.coefficients.shape
        return HeightField(finer.corner, finer.step, heights[:nx, :ny].copy())


def _halved(heights: Array) -> Array:
    """Coefficients (2 n - 5, m) of splines (n, m) with knots twice as dense along axis 0, by Lane and Riesenfeld."""
    apart = np.zeros((2 * len(heights) - 1, heights.shape[1]))
    apart[::2] = heights
    mask = np.array([comb(_DEGREE + 1, k) for k in range(_DEGREE + 2)]) / 2.0**_DEGREE
    spread = np.stack([np.convolve(column, mask) for column in apart.T], axis=1)
    return np.asarray(spread[_DEGREE:-_DEGREE])


def fit(samples: Array, weights: Array, low: Array, high: Array, step: float) -> HeightField:
    """The surface on the rectangle from `low` to `high` (2) with knots `step` apart, nearest to samples (n, 3).

    weights (n) of the squares of their distances along z.
    """
    cells = np.maximum(np.ceil((high - low) / step - 1e-9).astype(int), 1)
    shape = cells + _DEGREE
    place = (samples[:, :2] - low) / step
    cell = np.clip(np.floor(place).astype(int), 0, cells - 1)
    within = np.clip(place - cell, 0.0, 1.0)
    powers = within[:, :, None] ** np.arange(_DEGREE + 1)
    bx, by = powers[:, 0] @ _BASIS.T, powers[:, 1] @ _BASIS.T
    k = np.arange(_DEGREE + 1)
    column = (cell[:, :1, None] + k[:, None]) * shape[1] + cell[:, 1:, None] + k[None, :]
    row = np.repeat(np.arange(len(samples)), column[0].size)
    value = bx[:, :, None] * by[:, None, :]
    size = int(shape[0] * shape[1])
    A = csr_array(coo_array((value.ravel(), (row, column.reshape(-1))), shape=(len(samples), size)))
    W = diags_array(weights)
    third = [diags_array([-1.0, 3.0, -3.0, 1.0], offsets=[0, 1, 2, 3], shape=(n - 3, n)) for n in shape]
    calm = kron(third[0].T @ third[0], eye_array(shape[1])) + kron(eye_array(shape[0]), third[1].T @ third[1])
    scale = float(weights.sum()) / size
    normal = (A.T @ W @ A + _STIFF * scale * calm).tocsc()
    middle = float(np.average(samples[:, 2], weights=weights))
    solved = splu(normal, permc_spec="MMD_AT_PLUS_A", options={"SymmetricMode": True}).solve(
        A.T @ (weights * (samples[:, 2] - middle))
    )
    return HeightField(low.copy(), step, solved.reshape(shape) + middle)


@inner_njit
def _value(x: float, y: float, corner: Array, step: float, c: Array, basis: Array, out: Array) -> None:
    """Fill f and its derivatives by x, y, xx, xy, yy (6) at a place, clamped to the rectangle."""
    u = min(max((x - corner[0]) / step, 0.0), c.shape[0] - 5.0)
    v = min(max((y - corner[1]) / step, 0.0), c.shape[1] - 5.0)
    i, j = min(int(u), c.shape[0] - 6), min(int(v), c.shape[1] - 6)
    u, v = u - i, v - j
    bx, by = np.zeros((3, 6)), np.zeros((3, 6))  # derivative, spline
    for k in range(6):
        for power in range(5, -1, -1):  # Horner, with first and half of second derivative
            bx[2, k] = bx[2, k] * u + bx[1, k]
            bx[1, k] = bx[1, k] * u + bx[0, k]
            bx[0, k] = bx[0, k] * u + basis[k, power]
            by[2, k] = by[2, k] * v + by[1, k]
            by[1, k] = by[1, k] * v + by[0, k]
            by[0, k] = by[0, k] * v + basis[k, power]
    out[:] = 0.0
    for a in range(6):
        f = fy = fyy = 0.0
        for b in range(6):
            f += by[0, b] * c[i + a, j + b]
            fy += by[1, b] * c[i + a, j + b]
            fyy += by[2, b] * c[i + a, j + b]
        out[0] += bx[0, a] * f
        out[1] += bx[1, a] * f / step
        out[2] += bx[0, a] * fy / step
        out[3] += 2.0 * bx[2, a] * f / step**2
        out[4] += bx[1, a] * fy / step**2
        out[5] += 2.0 * bx[0, a] * fyy / step**2


@njit
def _values(plane: Array, corner: Array, step: float, c: Array, basis: Array) -> Array:
    out = np.empty((len(plane), 6))
    for i in range(len(plane)):
        _value(plane[i, 0], plane[i, 1], corner, step, c, basis, out[i])
    return out


@njit
def _nearest(points: Array, corner: Array, step: float, c: Array, basis: Array) -> Array:
    """Newton's method for the nearest place; Gauss-Newton steps where the Hessian is not safely positive."""
    out = np.empty((len(points), 2))
    f = np.empty(6)
    wide, deep = (c.shape[0] - 5) * step, (c.shape[1] - 5) * step
    for i in range(len(points)):
        x, y = points[i, 0], points[i, 1]
        for _ in range(_NEWTON_STEPS):
            x, y = min(max(x, corner[0]), corner[0] + wide), min(max(y, corner[1]), corner[1] + deep)
            _value(x, y, corner, step, c, basis, f)
            up = f[0] - points[i, 2]
            gx, gy = x - points[i, 0] + up * f[1], y - points[i, 1] + up * f[2]
            xx, xy, yy = 1.0 + f[1] ** 2, f[1] * f[2], 1.0 + f[2] ** 2
            bent = (xx + up * f[3]) * (yy + up * f[5]) - (xy + up * f[4]) ** 2
            if bent > 0.1 * (xx * yy - xy * xy) and xx + up * f[3] > 0.0:
                xx, xy, yy = xx + up * f[3], xy + up * f[4], yy + up * f[5]
            det = xx * yy - xy * xy
            dx, dy = (yy * gx - xy * gy) / det, (xx * gy - xy * gx) / det
            x, y = x - dx, y - dy
            if abs(dx) + abs(dy) < _CLOSE:
                break
        out[i, 0], out[i, 1] = x, y
    return out
