"""A smooth surface z = f(x, y) through the facets of a mesh: a spline of degree 5, as coarse as the facets allow.

A facet's own normal jumps at its edges, and a nozzle that must follow it would stop there. This surface bends steadily
(four continuous derivatives), and by how much it leaves the facets is bounded.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import comb

import numpy as np
from numba import njit
from scipy.interpolate import BSpline
from scipy.sparse import coo_array, csr_array, diags_array, eye_array, kron
from scipy.sparse.linalg import splu

from planner.readonly import Array, ReadOnlyArrays, read_only

_DEGREE = 5
_STIFF = 1e-7  # weight of third differences against a sample's: where nothing is known the surface goes on as it was
_NEWTON_STEPS = 12
_HALFWAY = 1.5  # times a step: less is the same step, but for rounding
_CLOSE = 1e-12  # m: near enough to the nearest point


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
        """The rectangle's corners of least and of greatest x and y (2)."""
        return self.corner, self.corner + self.step * (np.array(self.coefficients.shape) - _DEGREE)

    def at(self, plane: Array) -> tuple[Array, Array]:
        """Points (n, 3) and upward unit normals (n, 3) at x, y (n, 2), which are held within the rectangle."""
        values = _values(np.ascontiguousarray(plane), self.corner, self.step, self.coefficients, _BASIS)
        points = np.column_stack([plane, values[:, 0]])
        normals = np.column_stack([-values[:, 1], -values[:, 2], np.ones(len(plane))])
        return points, normals / np.linalg.norm(normals, axis=1)[:, None]

    def nearest(self, points: Array) -> Array:
        """x, y (n, 2) of the places whose normals pass through points (n, 3), found from above or below them."""
        return _nearest(read_only(points), self.corner, self.step, self.coefficients, _BASIS)

    def level(self, z: float) -> HeightField:
        """The plane at height z [m], with the same knots."""
        return HeightField(self.corner, self.step, np.full(self.coefficients.shape, z))

    def refined(self, finer: HeightField) -> HeightField:
        """The same surface with the knots of a finer one, whose distance is this one's halved some times over.

        Both begin at one corner, and this one reaches as far.
        """
        step, heights = self.step, self.coefficients
        while step > _HALFWAY * finer.step:
            step, heights = 0.5 * step, _halved(_halved(heights).T).T
        nx, ny = finer.coefficients.shape
        return HeightField(finer.corner, finer.step, heights[:nx, :ny].copy())


def _halved(heights: Array) -> Array:
    """Coefficients (n, m) of splines over knots twice as dense along the first axis (2 n - 5, m): Lane and Riesenfeld."""
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


@njit(cache=True)
def _value(x: float, y: float, corner: Array, step: float, c: Array, basis: Array, out: Array) -> None:
    """Fill f and its derivatives by x, y, xx, xy, yy (6) at a place that is held within the rectangle."""
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


@njit(cache=True)
def _values(plane: Array, corner: Array, step: float, c: Array, basis: Array) -> Array:
    out = np.empty((len(plane), 6))
    for i in range(len(plane)):
        _value(plane[i, 0], plane[i, 1], corner, step, c, basis, out[i])
    return out


@njit(cache=True)
def _nearest(points: Array, corner: Array, step: float, c: Array, basis: Array) -> Array:
    """Newton's method for the nearest place; where the surface bends away from it, steps of the distance alone."""
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
