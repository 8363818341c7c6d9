"""Triangles that are far longer than they are wide, cut across: halving their longest sides makes ever thinner ones."""

from __future__ import annotations

import numpy as np

from planner.base.arrays import Array

# Longest side over height. Halved down to a length, a triangle makes about as many as it is slender times as many as a good
# one of its area: a cylinder of 10 m, drawn in facets 1.7 mm wide, would make thousands of millions of them.
SLENDER = 150.0


def without_slivers(triangles: Array, longest: float) -> Array:
    """The same surface (n, 3, 3) [m] with what is longer than `longest` and slender cut across, about as long as it is wide
    or as `longest`; other triangles as they are, before it. Which side of them is the front is not kept."""
    sides = np.linalg.norm(np.roll(triangles, -1, axis=1) - triangles, axis=2)
    k, n = np.argmax(sides, axis=1), np.arange(len(triangles))
    long = sides[n, k]
    a, b, c = (triangles[n, (k + i) % 3] for i in range(3))  # a to b is the longest side
    height = np.linalg.norm(np.cross(b - a, c - a), axis=1) / np.maximum(long, np.finfo(float).tiny)
    slender = (long > longest) & (long > SLENDER * height)
    if not slender.any():
        return triangles
    a, b, c, height = a[slender], b[slender], c[slender], height[slender]
    along = (b - a) / long[slender, None]
    foot = a + np.einsum("ij,ij->i", c - a, along)[:, None] * along
    strips = [_strips(tip, foot, c, np.maximum(height, longest)) for tip in (a, b)]
    return np.concatenate([triangles[~slender], *strips])


def _strips(tip: Array, foot: Array, top: Array, wide: Array) -> Array:
    """Triangles (m, 3, 3) of right-angled ones (n, 3) with the right angle at the foot, cut across from the tip on."""
    count = np.maximum(np.ceil(np.linalg.norm(foot - tip, axis=1) / wide), 1.0).astype(int)
    own = np.repeat(np.arange(len(count)), count)
    first = np.arange(len(own)) - np.repeat(np.cumsum(count) - count, count)
    u, v = (first / count[own])[:, None], ((first + 1) / count[own])[:, None]
    tip, to_foot, to_top = tip[own], (foot - tip)[own], (top - tip)[own]
    begin, end = (tip + u * to_foot, tip + u * to_top), (tip + v * to_foot, tip + v * to_top)
    halves = np.stack([begin[0], end[0], end[1]], axis=1), np.stack([begin[0], end[1], begin[1]], axis=1)
    return np.concatenate([halves[0], halves[1][first > 0]])
