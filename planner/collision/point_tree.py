"""Points in a tree of balls, and how close convex solids come to them: obstacles that grow in print order.

A point stands for a ball of its own radius. It is there from its time on, so one tree represents a part at all stages
of its print. Distances to solids are signed (negative inside) and change by no more than a point moves, so a ball of
points is skipped as soon as its centre is far enough away.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from planner.base.arrays import Array, Ints, ReadOnlyArrays
from planner.base.compiled import inner_njit, njit
from planner.cell.solids import BOX, CAPSULE, FRUSTUM

_ZERO: Any = np.int64(0)  # a plain 0 is a type of its own, for which kernels would be compiled again
_LEAF = 8  # points of a leaf, at most
_DEEP = 128  # most nodes pending at once: twice the depth of a tree of as many points as an index can count
FROM_THE_START = -np.inf  # the time of what is there before the print


class TreeArrays(NamedTuple):
    """A `PointTree` as compiled kernels take it: its fields except `number`, with their shapes and units."""

    points: Array
    radius: Array
    time: Array
    centre: Array
    reach: Array
    since: Array
    left: Ints
    right: Ints


class SolidNumbers(NamedTuple):
    """One convex solid as compiled kernels take it: its kind and size (SIZES), and planes (k, 4) of all hulls, see
    `Packed`."""

    kind: int
    size: Array
    planes: Array


class TipRule(NamedTuple):
    """Clearance required of a point at distance r [m] from the nozzle's tip: min(clearance, slope * r - slack) [m].

    A point that is there from the start must also be at least -graze away, its ball not counted. To require the
    clearance everywhere, set slope to 0 and slack to -clearance.
    """

    clearance: float
    slope: float
    slack: float
    graze: float


class SearchRoom(NamedTuple):
    """Scratch for the pending nodes of a search, and lower bounds on their points' values [m]."""

    nodes: Ints
    lows: Array


@dataclass(frozen=True)
class PointTree(ReadOnlyArrays):
    """A tree over n points; build it with `point_tree`.

    points (n, 3) [m], radius (n) [m], time (n)   in the tree's order; number (n) as they were given
    centre (m, 3), reach (m), since (m)           of the nodes: a ball around all of a node's balls, and the first time
    left, right (m)                               children, or in a leaf: -1 - first point, and the number of points
    """

    points: Array
    radius: Array
    time: Array
    number: Ints
    centre: Array
    reach: Array
    since: Array
    left: Ints
    right: Ints

    @property
    def arrays(self) -> TreeArrays:
        """The tree as kernels take it."""
        return TreeArrays(
            self.points, self.radius, self.time, self.centre, self.reach, self.since, self.left, self.right
        )


def point_tree(points: Array, radius: Array | float = 0.0, time: Array | float = FROM_THE_START) -> PointTree:
    """A tree of points (n, 3) [m] with radius (n) [m] that are there from time (n) on; n may be 0."""
    n = len(points)
    points = np.ascontiguousarray(points, dtype=float)
    radius = np.ascontiguousarray(np.broadcast_to(np.asarray(radius, dtype=float), (n,)))
    time = np.ascontiguousarray(np.broadcast_to(np.asarray(time, dtype=float), (n,)))
    order = np.arange(n)
    most = max(1, 4 * (n // _LEAF + 1))
    centre, reach, since = np.zeros((most, 3)), np.zeros(most), np.full(most, np.inf)
    left, right = np.full(most, -1, dtype=np.int64), np.zeros(most, dtype=np.int64)
    count = _build(points, radius, time, order, centre, reach, since, left, right)
    return PointTree(
        points[order], radius[order], time[order], order,
        centre[:count].copy(), reach[:count].copy(), since[:count].copy(), left[:count].copy(), right[:count].copy(),
    )  # fmt: skip


@njit
def _build(points, radius, time, order, centre, reach, since, left, right):
    """Fill the nodes and sort `order`; returns the number of nodes. Each is halved across its longest side."""
    n = order.size
    todo = [(0, 0, n)]
    count = 1
    while todo:
        node, a, b = todo.pop()
        if a == b:
            left[node], right[node] = -1 - a, 0
            continue
        widest, axis = -1.0, _ZERO
        for k in range(3):
            low, high = points[order[a], k], points[order[a], k]
            for i in range(a, b):
                low, high = min(low, points[order[i], k]), max(high, points[order[i], k])
            centre[node, k] = 0.5 * (low + high)
            if high - low > widest:
                widest, axis = high - low, k
        for i in range(a, b):
            since[node] = min(since[node], time[order[i]])
            p = points[order[i]]
            x, y, z = p[0] - centre[node, 0], p[1] - centre[node, 1], p[2] - centre[node, 2]
            reach[node] = max(reach[node], np.sqrt(x * x + y * y + z * z) + radius[order[i]])
        if b - a <= _LEAF:
            left[node], right[node] = -1 - a, b - a
            continue
        middle = (a + b) // 2
        _halve(points, axis, order, a, b, middle)
        left[node], right[node] = count, count + 1
        todo.append((count, a, middle))
        todo.append((count + 1, middle, b))
        count += 2
    return count


@inner_njit
def _halve(points, axis, order, a, b, middle):
    """Quickselect: sort order[a:b] until no point before `middle` is beyond any from there on, along an axis."""
    low, high = a, b - 1
    while low < high:
        pivot = points[order[(low + high) // 2], axis]
        i, j = low, high
        while i <= j:
            while points[order[i], axis] < pivot:
                i += 1
            while points[order[j], axis] > pivot:
                j -= 1
            if i <= j:
                order[i], order[j] = order[j], order[i]
                i += 1
                j -= 1
        if middle <= j:
            high = j
        elif middle >= i:
            low = i
        else:
            break


@inner_njit(inline="never")
def solid_distance(kind, size, planes, x, y, z):
    """Signed distance [m] from a solid to a point in the solid's frame (see `Packed`); a lower bound for hulls."""
    if kind == BOX:
        dx, dy, dz = abs(x) - size[0], abs(y) - size[1], abs(z) - size[2]
        ox, oy, oz = max(dx, 0.0), max(dy, 0.0), max(dz, 0.0)
        return np.sqrt(ox * ox + oy * oy + oz * oz) + min(max(dx, max(dy, dz)), 0.0)
    if kind == CAPSULE:
        dz = max(abs(z) - size[1], 0.0)
        return np.sqrt(x * x + y * y + dz * dz) - size[0]
    if kind == FRUSTUM:
        r = np.sqrt(x * x + y * y)
        bottom, top, height = size[0], size[1], size[2]
        ux, uz, along = size[3], size[4], size[5]  # the side from (bottom, 0) to (top, height)
        side = (r - bottom) * uz - z * ux
        inside = max(side, max(-z, z - height))
        if inside <= 0.0:
            return inside
        t = min(max((r - bottom) * ux + z * uz, 0.0), along)
        sx, sz = r - bottom - t * ux, z - t * uz
        best = sx * sx + sz * sz
        for lid in range(2):
            lr, lz = max(r - (bottom if lid == 0 else top), 0.0), z - (0.0 if lid == 0 else height)
            best = min(best, lr * lr + lz * lz)
        return np.sqrt(best)
    worst = -np.inf
    first = int(size[0])
    for k in range(first, first + int(size[1])):
        worst = max(worst, planes[k, 0] * x + planes[k, 1] * y + planes[k, 2] * z + planes[k, 3])
    return worst


@inner_njit
def point_value(tree, i, solid, T_solid_tree, tip, rule):
    """The value of a point, given by its index in the tree's order, that `nearest_point` minimises."""
    points = tree.points
    away, d = _between(points, i, tip), _apart(points, i, solid.kind, solid.size, solid.planes, T_solid_tree)
    value = d - tree.radius[i] - min(rule.clearance, rule.slope * away - rule.slack)
    return min(value, d + rule.graze) if tree.time[i] == FROM_THE_START else value


@inner_njit
def nearest_point(tree, solid, T_solid_tree, tip, rule, now, enough, deep, room):
    """Least value over the points that are there before time `now` of

        distance(solid, ball of the point) - min(clearance, slope * (distance of the point from the tip) - slack)

    and, for those that are there from the start, also of distance(solid, point) + graze; if that is less than `enough`
    [m]. Also returns the point, in the tree's order, or -1. If there are values below -deep, any of these.

    tree: `TreeArrays`; solid: `SolidNumbers`; rule: `TipRule`; T_solid_tree (4, 4) takes points of the tree's frame
    into the solid's; tip (3) in the tree's frame [m]; room: `SearchRoom`.
    """
    # local names: counting references to a field costs more than the arithmetic
    points, radius, time, since = tree.points, tree.radius, tree.time, tree.since
    centre, reach, left, right = tree.centre, tree.reach, tree.left, tree.right
    kind, size, planes = solid.kind, solid.size, solid.planes
    clearance, slope, slack, graze = rule.clearance, rule.slope, rule.slack, rule.graze
    nodes, lows = room.nodes, room.lows
    best, found, T = enough, -1, T_solid_tree
    nodes[0], lows[0], waiting = 0, -np.inf, 1
    while waiting:
        waiting -= 1
        node = nodes[waiting]
        if lows[waiting] >= best:
            continue
        if left[node] < 0:
            for i in range(-1 - left[node], -1 - left[node] + right[node]):
                if time[i] >= now:
                    continue
                away, d = _between(points, i, tip), _apart(points, i, kind, size, planes, T)
                value = d - radius[i] - min(clearance, slope * away - slack)
                if time[i] == FROM_THE_START:
                    value = min(value, d + graze)
                if value < best:
                    best, found = value, i
            if best < -deep:
                break
            continue
        first, before = waiting, np.inf
        for k in range(2):
            child = left[node] if k == 0 else right[node]
            if since[child] >= now:
                continue
            away, d = _between(centre, child, tip), _apart(centre, child, kind, size, planes, T)
            low = d - reach[child] - min(clearance, slope * (away + reach[child]) - slack)
            if since[child] == FROM_THE_START:
                low = min(low, d - reach[child] + graze)
            if low >= best:
                continue
            nodes[waiting], lows[waiting] = child, low
            middle = d - min(clearance, slope * away - slack)
            # the child whose centre is nearer, or deeper, is visited first: it is put on top
            if waiting > first and before < middle:
                nodes[first], nodes[waiting] = nodes[waiting], nodes[first]
                lows[first], lows[waiting] = lows[waiting], lows[first]
            before = middle
            waiting += 1
    return best, found


@njit
def least_distances(tree, solid, T_solid_tree, now, exact, most, share, room, distance, point) -> None:
    """Distances (n) of a solid at poses (n, 4, 4) from the points that are there before times now (n), at most `most`,
    and the points (n) that have them, or -1; beyond `exact`, any that is about as far.

    A distance beyond `exact` may be too small, but is at least `share` of the true one: among many points that are
    about as far, slightly nearer ones are not sought. A search begins with the previous nearest point.

    tree: `TreeArrays`; solid: `SolidNumbers`; room: `SearchRoom`.
    """
    points, radius, time = tree.points, tree.radius, tree.time
    centre, reach, since, left, right = tree.centre, tree.reach, tree.since, tree.left, tree.right
    kind, size, planes = solid.kind, solid.size, solid.planes
    nodes, lows, known = room.nodes, room.lows, -1
    for i in range(len(now)):
        T, best, found, passed = T_solid_tree[i], most, -1, np.inf
        if known >= 0 and time[known] < now[i]:
            best, found = _apart(points, known, kind, size, planes, T) - radius[known], known
            if best >= most:
                best, found = most, -1
        nodes[0], lows[0], waiting = 0, -np.inf, 1
        while waiting:
            waiting -= 1
            node, low = nodes[waiting], lows[waiting]
            if since[node] >= now[i] or low >= best:
                continue
            if low >= exact and low >= share * best:
                passed = min(passed, low)
                continue
            if left[node] < 0:
                for k in range(-1 - left[node], -1 - left[node] + right[node]):
                    if time[k] < now[i]:
                        value = _apart(points, k, kind, size, planes, T) - radius[k]
                        if value < best:
                            best, found = value, k
                continue
            a, b = left[node], right[node]
            low_a = _apart(centre, a, kind, size, planes, T) - reach[a]
            low_b = _apart(centre, b, kind, size, planes, T) - reach[b]
            if low_a > low_b:  # the nearer child is visited first: it is put on top
                a, b, low_a, low_b = b, a, low_b, low_a
            nodes[waiting], lows[waiting] = b, low_b
            nodes[waiting + 1], lows[waiting + 1] = a, low_a
            waiting += 2
        distance[i], point[i] = min(best, passed), found
        known = found if found >= 0 else known


@njit(inline="always")
def _apart(points, i, kind, size, planes, T):
    """Signed distance of a point, i of (n, 3), from a solid; T (4, 4) takes points into the solid's frame."""
    x, y, z = points[i, 0], points[i, 1], points[i, 2]
    return solid_distance(
        kind, size, planes,
        T[0, 0] * x + T[0, 1] * y + T[0, 2] * z + T[0, 3],
        T[1, 0] * x + T[1, 1] * y + T[1, 2] * z + T[1, 3],
        T[2, 0] * x + T[2, 1] * y + T[2, 2] * z + T[2, 3],
    )  # fmt: skip


@njit(inline="always")
def _between(points, i, p):
    """Distance of a point, i of (n, 3), from p (3)."""
    return np.sqrt((points[i, 0] - p[0]) ** 2 + (points[i, 1] - p[1]) ** 2 + (points[i, 2] - p[2]) ** 2)


@njit
def search_room():
    """Scratch for a search; one for each thread."""
    return SearchRoom(np.empty(_DEEP, dtype=np.int64), np.empty(_DEEP))
