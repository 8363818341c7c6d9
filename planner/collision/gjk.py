"""Compiled: the distance between two convex solids, and where they are nearest (Gilbert, Johnson and Keerthi, 1988).

Each round gives a plane between the solids and thus a lower bound: the search ends at the first plane that shows them
to be far enough apart, mostly that of the previous posture. Round solids are a line or a circle and a radius.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from planner.base.compiled import inner_njit
from planner.cell.solids import BOX, CAPSULE, FRUSTUM

_ROUNDS = 40
_EXACT = 1e-4  # share by which a distance may be reported too small
_FACES = np.array([(1, 2, 3), (0, 2, 3), (0, 1, 3), (0, 1, 2)])  # corners of a simplex opposite to each corner
_ZERO: Any = np.int64(0)  # a plain 0 is a type of its own, for which kernels would be compiled again
_TOUCHING = 1e-7  # m: solids closer than this count as overlapping


@inner_njit
def _support(kind, size, span, vertices, pose, b, dx, dy, dz):
    """The point (three numbers) of body b that is farthest along a direction of the world."""
    x = pose[b, 0, 0] * dx + pose[b, 1, 0] * dy + pose[b, 2, 0] * dz
    y = pose[b, 0, 1] * dx + pose[b, 1, 1] * dy + pose[b, 2, 1] * dz
    z = pose[b, 0, 2] * dx + pose[b, 1, 2] * dy + pose[b, 2, 2] * dz
    if kind[b] == BOX:
        px = size[b, 0] if x > 0.0 else -size[b, 0]
        py = size[b, 1] if y > 0.0 else -size[b, 1]
        pz = size[b, 2] if z > 0.0 else -size[b, 2]
    elif kind[b] == CAPSULE:
        px, py, pz = 0.0, 0.0, size[b, 1] if z > 0.0 else -size[b, 1]
    elif kind[b] == FRUSTUM:
        level = np.sqrt(x * x + y * y)
        upper = size[b, 1] * level + size[b, 2] * z > size[b, 0] * level
        r = size[b, 1] if upper else size[b, 0]
        pz = size[b, 2] if upper else 0.0
        px = r * x / level if level > 0.0 else 0.0
        py = r * y / level if level > 0.0 else 0.0
    else:
        first = span[b, 0]
        best, most = first, -np.inf
        for i in range(first, first + span[b, 1]):
            along = x * vertices[i, 0] + y * vertices[i, 1] + z * vertices[i, 2]
            if along > most:
                best, most = i, along
        px, py, pz = vertices[best, 0], vertices[best, 1], vertices[best, 2]
    return (
        pose[b, 0, 0] * px + pose[b, 0, 1] * py + pose[b, 0, 2] * pz + pose[b, 0, 3],
        pose[b, 1, 0] * px + pose[b, 1, 1] * py + pose[b, 1, 2] * pz + pose[b, 1, 3],
        pose[b, 2, 0] * px + pose[b, 2, 1] * py + pose[b, 2, 2] * pz + pose[b, 2, 3],
    )


@inner_njit
def _on_triangle(S, a, b, c):
    """Barycentric coordinates of the point of a triangle (rows of S) nearest to the origin: Ericson, 5.1.5."""
    d1, d2, d3, d4, d5, d6 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for k in range(3):
        ab, ac = S[b, k] - S[a, k], S[c, k] - S[a, k]
        d1 -= ab * S[a, k]
        d2 -= ac * S[a, k]
        d3 -= ab * S[b, k]
        d4 -= ac * S[b, k]
        d5 -= ab * S[c, k]
        d6 -= ac * S[c, k]
    if d1 <= 0.0 and d2 <= 0.0:
        return 1.0, 0.0, 0.0
    if d3 >= 0.0 and d4 <= d3:
        return 0.0, 1.0, 0.0
    vc = d1 * d4 - d3 * d2
    if vc <= 0.0 and d1 >= 0.0 and d3 <= 0.0 and d1 > d3:
        t = d1 / (d1 - d3)
        return 1.0 - t, t, 0.0
    if d6 >= 0.0 and d5 <= d6:
        return 0.0, 0.0, 1.0
    vb = d5 * d2 - d1 * d6
    if vb <= 0.0 and d2 >= 0.0 and d6 <= 0.0 and d2 > d6:
        t = d2 / (d2 - d6)
        return 1.0 - t, 0.0, t
    va = d3 * d6 - d5 * d4
    if va <= 0.0 and d4 >= d3 and d5 >= d6 and d4 - d3 + d5 - d6 > 0.0:
        t = (d4 - d3) / ((d4 - d3) + (d5 - d6))
        return 0.0, 1.0 - t, t
    total = va + vb + vc
    if not abs(total) > 0.0:
        return 1.0, 0.0, 0.0
    return 1.0 - (vb + vc) / total, vb / total, vc / total


@inner_njit
def _beyond(S, a, b, c, d):
    """Whether the origin lies on the other side of the plane a, b, c than d, or d lies in that plane (rows of S)."""
    x, y, z = S[b, 0] - S[a, 0], S[b, 1] - S[a, 1], S[b, 2] - S[a, 2]
    u, v, w = S[c, 0] - S[a, 0], S[c, 1] - S[a, 1], S[c, 2] - S[a, 2]
    n0, n1, n2 = y * w - z * v, z * u - x * w, x * v - y * u
    own = -(S[a, 0] * n0 + S[a, 1] * n1 + S[a, 2] * n2)
    other = (S[d, 0] - S[a, 0]) * n0 + (S[d, 1] - S[a, 1]) * n1 + (S[d, 2] - S[a, 2]) * n2
    return own * other <= 0.0


@inner_njit
def _nearest(S, n):
    """Barycentric coordinates of the point of a simplex (the first n rows of S) nearest to the origin, and whether the
    simplex encloses the origin."""
    if n == 1:
        return 1.0, 0.0, 0.0, 0.0, False
    if n == 2:
        along, length = 0.0, 0.0
        for k in range(3):
            e = S[1, k] - S[0, k]
            along -= S[0, k] * e
            length += e * e
        t = min(max(along / length, 0.0), 1.0) if length > 0.0 else 0.0
        return 1.0 - t, t, 0.0, 0.0, False
    if n == 3:
        s, t, u = _on_triangle(S, _FACES[3, 0], _FACES[3, 1], _FACES[3, 2])
        return s, t, u, 0.0, False
    best = np.inf
    out = (0.0, 0.0, 0.0, 0.0, True)
    for face in range(4):
        i, j, k = _FACES[face, 0], _FACES[face, 1], _FACES[face, 2]
        if not _beyond(S, i, j, k, face):
            continue
        s, t, u = _on_triangle(S, i, j, k)
        square = 0.0
        for m in range(3):
            square += (s * S[i, m] + t * S[j, m] + u * S[k, m]) ** 2
        if square < best:
            best = square
            if face == 0:
                out = (0.0, s, t, u, False)
            elif face == 1:
                out = (s, 0.0, t, u, False)
            elif face == 2:
                out = (s, t, 0.0, u, False)
            else:
                out = (s, t, u, 0.0, False)
    return out


@inner_njit(inline="never")
def solids_distance(kind, size, span, vertices, pose, a, b, enough, little, way, k, S):
    """Distance [m] between bodies a and b, exact from `little` to `enough`; outside these only a bound, on the correct
    side. Overlapping solids: minus their radii.

    kind, size, span, vertices   of all bodies, see `Table`; pose (b, 4, 4) of the solids in the world
    way (p, 3)  row k: on entry a direction that may separate them, from b to a; on exit the one that does, as long as
                their distance, but 0 where they overlap
    S (4, 9)    on exit its first row holds, from column 3 on, the points of a and of b that are nearest
    """
    radii = (size[a, 0] if kind[a] == CAPSULE else 0.0) + (size[b, 0] if kind[b] == CAPSULE else 0.0)
    n = _ZERO
    lower = -np.inf
    x, y, z = way[k, 0], way[k, 1], way[k, 2]
    out = 0.0
    for step in range(_ROUNDS):
        length = np.sqrt(x * x + y * y + z * z)
        if length <= _TOUCHING:
            if step:
                way[k, 0], way[k, 1], way[k, 2] = 0.0, 0.0, 0.0
                return -radii
            x, y, z, length = 0.0, 0.0, 1.0, 1.0
        p0, p1, p2 = _support(kind, size, span, vertices, pose, a, -x, -y, -z)
        q0, q1, q2 = _support(kind, size, span, vertices, pose, b, x, y, z)
        lower = max(lower, (x * (p0 - q0) + y * (p1 - q1) + z * (p2 - q2)) / length)
        out = lower - radii
        if out > enough:
            break
        if step and (length - radii < little or length - lower <= _EXACT * length):
            out = min(lower, length) - radii if length - radii >= little else length - radii
            break
        S[n, 0], S[n, 1], S[n, 2] = p0 - q0, p1 - q1, p2 - q2
        S[n, 3], S[n, 4], S[n, 5] = p0, p1, p2
        S[n, 6], S[n, 7], S[n, 8] = q0, q1, q2
        n += 1
        s0, s1, s2, s3, enclosed = _nearest(S, n)
        if enclosed:
            way[k, 0], way[k, 1], way[k, 2] = 0.0, 0.0, 0.0
            return -radii
        kept = 0
        x, y, z = 0.0, 0.0, 0.0
        near = (s0, s1, s2, s3)
        for i in range(n):
            share = near[i]
            if share > 0.0:
                x += share * S[i, 0]
                y += share * S[i, 1]
                z += share * S[i, 2]
                if i != kept:
                    for m in range(9):
                        S[kept, m] = S[i, m]
                kept += 1
        n = kept
        if n == 4:  # rounding: a flat simplex
            break
    way[k, 0], way[k, 1], way[k, 2] = x, y, z
    if n > 1 and n < 4:
        s0, s1, s2, _, _ = _nearest(S, n)
        for m in range(3, 9):
            S[0, m] = s0 * S[0, m] + s1 * S[1, m] + (s2 * S[2, m] if n == 3 else 0.0)
    return out
