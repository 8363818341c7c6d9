"""The search for the nearest place on faces, point by point, compiled."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from planner.readonly import Array, Ints
from planner.toolpath.step.splines import fill_normal, foot_of
from planner.toolpath.step.trim import is_inside

SHELL = 10e-3  # m of material beneath open faces: nothing else is known of it
_ASIDE = 1e-8  # m, by which a perpendicular may miss a point
_TINY = 1e-300


@njit(cache=True)
def _perpendicular(x: Array, d: Array) -> bool:
    """Whether a place with derivatives d (6, 3) is the foot of a perpendicular from x (3), and not where a search ended."""
    gu = gv = a = b = 0.0
    for k in range(3):
        e = d[0, k] - x[k]
        gu += e * d[1, k]
        gv += e * d[2, k]
        a += d[1, k] ** 2
        b += d[2, k] ** 2
    return abs(gu) <= _ASIDE * np.sqrt(a) and abs(gv) <= _ASIDE * np.sqrt(b)


@njit(cache=True)
def settle(
    points: Array,
    faces: Ints,
    starts: Array,
    knots: Array,
    poles: Array,
    table: Ints,
    domain: Array,
    raster: NDArray[np.int8],
    low: Array,
    high: Array,
    rim_uv: Array,
    rim_next: Ints,
    rim_first: Ints,
) -> tuple[Ints, Array]:
    """Face (n) and parameters (n, 2) of the nearest foot that is inside its face; where none is, of the nearest one."""
    found, place = np.empty(len(points), dtype=np.int64), np.empty((len(points), 2))
    d = np.empty((6, 3))
    hit = np.empty(faces.shape[1], dtype=np.bool_)
    for i in range(len(points)):
        best, best_in = np.inf, False
        for c in range(faces.shape[1]):
            face = faces[i, c]
            hit[c] = False
            tried = False
            for earlier in range(c):
                tried = tried or (hit[earlier] and faces[i, earlier] == face)
            if tried:
                continue
            u, v = foot_of(points[i], face, starts[i, c, 0], starts[i, c, 1], knots, poles, table, domain, d)
            gap = 0.0
            for k in range(3):
                gap += (d[0, k] - points[i, k]) ** 2
            within = _perpendicular(points[i], d) and is_inside(
                face, u, v, raster, low, high, rim_uv, rim_next, rim_first
            )
            hit[c] = within
            if (within and not best_in) or (within == best_in and gap < best):
                best, best_in = gap, within
                found[i], place[i, 0], place[i, 1] = face, u, v
    return found, place


@njit(cache=True)
def signed(
    points: Array,
    near: Ints,
    sample_face: Ints,
    sample_uv: Array,
    sample_points: Array,
    knots: Array,
    poles: Array,
    table: Ints,
    domain: Array,
    side: Ints,
    raster: NDArray[np.int8],
    low: Array,
    high: Array,
    rim_uv: Array,
    rim_points: Array,
    rim_normals: Array,
    rim_shared: NDArray[np.bool_],
    rim_next: Ints,
    rim_first: Ints,
    closed: bool,
) -> tuple[Array, Array]:
    """Signed distances (n,) and the normals (n, 3) at the nearest places."""
    out, normals = np.empty(len(points)), np.empty((len(points), 3))
    d, normal, foot = np.empty((6, 3)), np.empty(3), np.empty(3)
    hit = np.empty(near.shape[1], dtype=np.bool_)
    for i in range(len(points)):
        best, above, straight = np.inf, 1.0, True
        at_sample = 0.0  # squared distance of the nearest sample: a foot farther away is another place's
        for k in range(3):
            at_sample += (points[i, k] - sample_points[near[i, 0], k]) ** 2
        for c in range(near.shape[1]):
            face = sample_face[near[i, c]]
            hit[c] = tried = known = False
            for earlier in range(c):
                if sample_face[near[i, earlier]] == face:
                    known = True
                    tried = tried or hit[earlier]
            if tried and best <= at_sample:
                continue
            start = sample_uv[near[i, c]]
            u, v = foot_of(points[i], face, start[0], start[1], knots, poles, table, domain, d)
            if _perpendicular(points[i], d) and is_inside(face, u, v, raster, low, high, rim_uv, rim_next, rim_first):
                hit[c] = True
                gap = 0.0
                for k in range(3):
                    gap += (d[0, k] - points[i, k]) ** 2
                if gap < best:
                    best, straight = gap, True
                    fill_normal(face, u, v, knots, poles, table, domain, normal)
                    above = 0.0
                    for k in range(3):
                        normals[i, k] = side[face] * normal[k]
                        above += normals[i, k] * (points[i, k] - d[0, k])
                continue
            if known:  # its rim has been searched
                continue
            for a in range(rim_first[face], rim_first[face + 1]):
                b = rim_next[a]
                length = ahead = 0.0
                for k in range(3):
                    way = rim_points[b, k] - rim_points[a, k]
                    length += way * way
                    ahead += way * (points[i, k] - rim_points[a, k])
                t = min(max(ahead / max(length, _TINY), 0.0), 1.0)
                gap = 0.0
                for k in range(3):
                    foot[k] = rim_points[a, k] + t * (rim_points[b, k] - rim_points[a, k])
                    gap += (foot[k] - points[i, k]) ** 2
                if gap < best:
                    best, straight = gap, rim_shared[a]
                    size = above = 0.0
                    for k in range(3):
                        normals[i, k] = (1.0 - t) * rim_normals[a, k] + t * rim_normals[b, k]
                        size += normals[i, k] ** 2
                        above += normals[i, k] * (points[i, k] - foot[k])
                    for k in range(3):
                        normals[i, k] /= np.sqrt(max(size, _TINY))
        if best > at_sample:  # far away, where perpendiculars meet: the nearest sample will do
            best, straight, above = at_sample, True, 0.0
            face, start = sample_face[near[i, 0]], sample_uv[near[i, 0]]
            fill_normal(face, start[0], start[1], knots, poles, table, domain, normal)
            for k in range(3):
                normals[i, k] = side[face] * normal[k]
                above += normals[i, k] * (points[i, k] - sample_points[near[i, 0], k])
        gap = np.sqrt(best)
        if above >= 0.0 or not straight:
            out[i] = gap
        elif closed:
            out[i] = -gap
        else:
            out[i] = max(-gap, gap - SHELL)
    return out, normals
