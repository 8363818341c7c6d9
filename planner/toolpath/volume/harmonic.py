"""The harmonic field between two surfaces: 0 on the lower one, 1 on the upper one, no flow through the grid's sides.

Its levels divide the space along the field's gradient lines, not along z: bends of the lower or upper surface fade with
the distance from it, the sooner the shorter their waves. Laplace's equation is solved by finite elements: bricks with
eight corners, in columns between the surfaces.
"""

from __future__ import annotations

import itertools

import numpy as np
from scipy.sparse import coo_array, csr_array, diags_array
from scipy.sparse.linalg import cg

from planner.base.arrays import Array, Ints

_BRICKS = 14  # from surface to surface
_GAUSS = 0.5 / np.sqrt(3.0)  # from the middle of a unit brick, along each axis
_CORNERS = np.array(list(itertools.product((0, 1), repeat=3)))  # of a unit brick
_TOLERANCE = 1e-9  # of the solver, relative
_MOST_STEPS = 3_000
POWERS = 5  # number of polynomials for the departure of levels from an even share


def departures(t: Array) -> Array:
    """Polynomials (..., POWERS) of the share t of the way from the lower to the upper surface; they are 0 on both."""
    return np.asarray((t * (1.0 - t))[..., None] * (2.0 * t - 1.0)[..., None] ** np.arange(POWERS))


def harmonic_departures(lower: Array, upper: Array, pitch: float) -> Array:
    """How far the levels of the harmonic field depart from an even share of the height, at the corners of a grid.

    lower, upper (n, m)  heights of the surfaces [m], the second above the first;  pitch of the grid [m]
    Returns factors (n, m, POWERS) [m] of `departures`.
    """
    field = _solved(lower, upper - lower, pitch)
    A = departures(field)  # (n, m, brick corners, POWERS)
    off = np.linspace(0.0, 1.0, _BRICKS + 1) - field
    normal = np.einsum("...ki,...kj->...ij", A, A)
    factors = np.linalg.solve(normal, np.einsum("...ki,...k->...i", A, off)[..., None])[..., 0]
    return np.asarray(factors * (upper - lower)[..., None])


def _solved(lower: Array, height: Array, pitch: float) -> Array:
    """The field (n, m, _BRICKS + 1) at the corners of bricks that fill heights (n, m) [m] above the lower surface."""
    share = np.linspace(0.0, 1.0, _BRICKS + 1)
    z = lower[..., None] + share * height[..., None]
    node: Ints = np.arange(z.size).reshape(z.shape)
    n, m, k = (side - 1 for side in z.shape)
    corners = [node[a : a + n, b : b + m, c : c + k].ravel() for a, b, c in _CORNERS]
    K = _stiffness(np.stack(corners, axis=1), z.ravel(), pitch)
    inner = node[..., 1:-1].ravel()
    field = np.broadcast_to(share, z.shape).ravel().copy()
    inside = K[inner][:, inner]
    scale = diags_array(1.0 / inside.diagonal())
    field[inner] -= cg(inside, K[inner] @ field, rtol=_TOLERANCE, maxiter=_MOST_STEPS, M=scale)[0]
    return np.asarray(field.reshape(z.shape))


def _stiffness(elements: Ints, z: Array, pitch: float) -> csr_array:
    """The stiffness matrix of upright bricks, `pitch` [m] wide, with corners `elements` (n, 8) at heights z [m]."""
    zs = z[elements]
    local = np.zeros((len(elements), 8, 8))
    for point in 0.5 + _GAUSS * (2.0 * _CORNERS - 1.0):
        ends = np.where(_CORNERS == 1, point, 1.0 - point)  # (8, 3)
        slope = np.where(_CORNERS == 1, 1.0, -1.0)
        gradient = np.stack(
            [slope[:, a] * ends[:, (a + 1) % 3] * ends[:, (a + 2) % 3] for a in range(3)], axis=1
        )  # (8, 3) over the unit brick
        zx, zy, zz = (zs @ gradient).T  # of z over the unit brick
        own = np.empty((len(elements), 8, 3))
        own[..., 2] = gradient[:, 2] / zz[:, None]
        own[..., 0] = (gradient[:, 0] - zx[:, None] * own[..., 2]) / pitch
        own[..., 1] = (gradient[:, 1] - zy[:, None] * own[..., 2]) / pitch
        local += np.einsum("nia,nja,n->nij", own, own, 0.125 * pitch**2 * zz)
    row, column = np.repeat(elements, 8, axis=1).ravel(), np.tile(elements, (1, 8)).ravel()
    return csr_array(coo_array((local.ravel(), (row, column)), shape=(len(z), len(z))))
