"""Points all over a surface of triangles, compiled: small triangles first, then one of the corners that nearly coincide."""

from __future__ import annotations

import numpy as np
from numba import njit

_MIXES = 0x9E3779B97F4A7C15  # odd, and of 2**64 the golden ratio's part: keys in a row land far apart


@njit(cache=True, error_model="numpy")
def split(triangles, longest):
    """The same surface (n, 3, 3) in triangles without a longer side: each is halved across its longest one."""
    done, count = np.empty((max(4 * len(triangles), 16), 3, 3)), 0
    now = triangles
    while len(now):
        across, long = np.full(len(now), -1), 0
        for i in range(len(now)):
            side, k = 0.0, 0
            for j in range(3):
                length = _apart(now[i, j], now[i, (j + 1) % 3])
                if length > side:
                    side, k = length, j
            if side > longest:
                across[i] = k
                long += 1
        if count + len(now) - long > len(done):
            more = np.empty((2 * (count + len(now)), 3, 3))
            for i in range(count):
                _copy(done[i], more[i])
            done = more
        halves, j = np.empty((2 * long, 3, 3)), 0
        for i in range(len(now)):
            if across[i] < 0:
                _copy(now[i], done[count])
                count += 1
                continue
            for x in range(3):
                a, b, c = now[i, across[i], x], now[i, (across[i] + 1) % 3, x], now[i, (across[i] + 2) % 3, x]
                middle = 0.5 * (a + b)
                halves[j, 0, x], halves[j, 1, x], halves[j, 2, x] = a, middle, c
                halves[long + j, 0, x], halves[long + j, 1, x], halves[long + j, 2, x] = middle, b, c
            j += 1
        now = halves
    return done[:count].copy()


@njit(cache=True, error_model="numpy")
def _copy(triangle, out):
    for k in range(3):
        for x in range(3):
            out[k, x] = triangle[k, x]


@njit(cache=True, error_model="numpy")
def merged(triangles, size):
    """One of the corners of triangles (n, 3, 3) in each cube of a grid with cubes of that size: points (m, 3), and the
    distance (m) from which no place of the surface that is theirs is farther."""
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    for i in range(len(triangles)):
        for k in range(3):
            for x in range(3):
                low[x], high[x] = min(low[x], triangles[i, k, x]), max(high[x], triangles[i, k, x])
    wide = np.floor((high - low) / size).astype(np.int64) + 1
    bits = 4
    while 1 << bits < 4 * len(triangles):
        bits += 1
    place = np.full(1 << bits, -1, dtype=np.int32)  # a table of cubes by their keys: open addressing
    last = (1 << bits) - 1
    keys, kept = np.empty(3 * len(triangles), np.int64), np.empty((3 * len(triangles), 3))
    far, count = np.zeros(3 * len(triangles)), 0
    for i in range(len(triangles)):
        spread = _farthest(triangles[i])
        for k in range(3):
            p = triangles[i, k]
            key = np.int64(0)
            for x in range(3):
                key = key * wide[x] + np.int64(np.floor((p[x] - low[x]) / size))
            at = np.int64((np.uint64(key) * np.uint64(_MIXES)) >> np.uint64(64 - bits))
            while place[at] >= 0 and keys[place[at]] != key:
                at = (at + 1) & last
            if place[at] < 0:
                place[at] = count
                keys[count] = key
                kept[count] = p
                count += 1
            m = place[at]
            far[m] = max(far[m], spread + _apart(p, kept[m]))
    order = np.argsort(keys[:count])  # what lies near in the grid lies near in the list
    return kept[order], far[order]


@njit(cache=True, error_model="numpy")
def _apart(a, b):
    x, y, z = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    return np.sqrt(x * x + y * y + z * z)


@njit(cache=True, error_model="numpy")
def _farthest(t):
    """Distance that no place of a triangle (3, 3) exceeds from the nearest of its corners."""
    a, b, c = _apart(t[0], t[1]), _apart(t[1], t[2]), _apart(t[2], t[0])
    a, b = min(a, b), max(a, b)
    b, c = min(b, c), max(b, c)
    a, b = min(a, b), max(a, b)
    if a * a + b * b <= c * c:
        return 0.5 * c
    ux, uy, uz = t[1, 0] - t[0, 0], t[1, 1] - t[0, 1], t[1, 2] - t[0, 2]
    vx, vy, vz = t[2, 0] - t[0, 0], t[2, 1] - t[0, 1], t[2, 2] - t[0, 2]
    x, y, z = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    return a * b * c / max(2.0 * np.sqrt(x * x + y * y + z * z), 1e-30)
