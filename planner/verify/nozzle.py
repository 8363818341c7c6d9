"""Whether nozzle and print head keep clear of part and print, as printed so far at every instant.

No fixed distance can be kept where the nozzle lays one bead beside another. In the tip's zone, a point at distance r
from the tip must be TIP_SLOPE * r away, less a slack for the nozzle's face and the bead; the requirement never exceeds
the clearance that the problem sets. Bodies there from the start may be penetrated by half a bead's height at most;
where the requirement is negative, `pressed` checks how deep beads are pressed. The margin of a point is its distance
minus the required one; checks report true distances, and the required distance at the same place.

The compiled loops bound how much a margin can change with the motion, and skip samples, points and instants between
samples where the least margin cannot lie. All values are in the part frame, in metres; n counts samples.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from operator import attrgetter
from typing import Any, NamedTuple

import numpy as np

from planner.base.arrays import Array, Ints
from planner.base.compiled import inner_njit, njit
from planner.base.geometry import arc_lengths
from planner.base.processes import in_blocks
from planner.cell.solids import Packed, packed
from planner.collision.point_tree import (
    FROM_THE_START,
    PointTree,
    SolidNumbers,
    TipRule,
    nearest_point,
    point_value,
    search_room,
    solid_distance,
)
from planner.collision.print_body import TIP_SLOPE, TipRoom, tip_room
from planner.plan import Check, Trajectory
from planner.problem import Problem
from planner.problem.cell import NozzleSpec
from planner.toolpath.bead import Toolpath
from planner.verify.by_height import HeightBounds, height_above, height_bounds, least_so_high, none_so_near, rise
from planner.verify.checks import DIGITS, EVERYWHERE, FAR, TOLERANCE, Judged, place
from planner.verify.executed import ExecutedMotion

_ZERO: Any = np.int64(0)  # a plain 0 has its own type, for which kernels would be compiled again
_OFTEN = 25  # samples: most in a block, and most between looks at a body without bounds by height
_LOOK = 0.25  # × the tip's zone: beads on a surface this far ahead of the tip may already count as laid
_BLOCK = 2e-3  # m of the tip's path in one block: the longer, the more points may matter
_MOST_PARTS = 64  # most parts of the time between two samples
_RATE = 1.0 + TIP_SLOPE  # × a motion: most that a margin beyond the tip's zone changes
_STEEP = 1e3  # slope so steep that no point within the tip's zone counts
_SPARE = 0.1  # × the least distance beyond the tip's zone: the one found may exceed the true one by this
_AMPLE = 5e-3  # m: margins that exceed that of the nearest body by more are not resolved
_AT_ONCE = 50_000  # samples of a block in which one thread finds true distances
_SHORTEST, _LONGEST = 6, 50  # samples of a stretch skipped by heights
_SKIPPED = 8  # looks after a failed skip before the next one is tried
_WORTH_BOUNDS = 2000  # samples: bounds by height pay off for paths at least this long
_RARELY = 100  # most samples between looks where bounds by height show that none would find anything near
_FEW_LOOKS = 4000  # about the number of looks along a long path where they do
_FIRST_LOOKS = 1000  # about the most looks per body for a first estimate of the least distance
_DEEP = 20e-3  # m beneath the tip: deeper points count as if they were at this depth
_DEEPEST = 64  # intervals waiting at once: more than the samples of a block can produce


class HeadSolids(NamedTuple):
    """Bodies (b) that move with the nozzle, in its frame: the fields of `Packed` of the same names."""

    kind: Ints
    size: Array
    planes: Array
    T_solid_frame: Array
    centre: Array
    reach: Array


class NozzleWay(NamedTuple):
    """The nozzle's motion (n samples), and how much is printed.

    tip (n, 3) [m] and rotation (n, 3, 3)   its tip and axes in the part frame
    path (n) [m], turned (n) [rad]          how far they have moved and turned since the first sample
    now (n), seen (n)                       how much is printed, see `print_times`, and may count as printed
    slack (n), graze (n) [m]                as `TipRule` has them
    """

    tip: Array
    rotation: Array
    path: Array
    turned: Array
    now: Array
    slack: Array
    graze: Array
    seen: Array


class BlockRoom(NamedTuple):
    """Working memory for a block of samples: poses (samples, 4, 4) of a solid, and for waiting intervals the samples
    (m, 2) at their ends and the values (m, 2) there."""

    poses: Array
    samples: Ints
    values: Array


@njit
def least_along(tree, solids, way, clearance, slope, bounds, search):
    """The least value of `nearest_point` along a motion, FAR at most; its sample, body and point, or -1.

    Samples are taken in blocks; each point that could matter is followed through the block separately.

    tree: `TreeArrays`; solids: `HeadSolids`; way: `NozzleWay`; clearance [m] and slope as in `TipRule`; bounds:
    `HeightBounds`, which may cover no body; search: `SearchRoom`.
    """
    points, time, low_ones = tree.points, tree.time, len(bounds.floor)
    centre, reach, since, left, right = tree.centre, tree.reach, tree.since, tree.left, tree.right
    kind, size, planes, T_solid_frame = solids.kind, solids.size, solids.planes, solids.T_solid_frame
    tip, rotation, path = way.tip, way.rotation, way.path
    slack, graze, seen = way.slack, way.graze, way.seen
    n, nodes = len(seen), search.nodes
    least, where, whose, which = _here_and_there(tree, solids, way, clearance, slope, search)
    poses = np.empty((_OFTEN + 1, 4, 4))
    room = BlockRoom(poses, np.empty((_DEEPEST, 2), np.int64), np.empty((_DEEPEST, 2)))
    for j in range(len(kind)):
        solid, a = SolidNumbers(kind[j], size[j], planes), _ZERO
        while a < n - 1:
            b = a + 1
            while b < min(n - 1, a + _OFTEN) and path[b + 1] - path[a] < _BLOCK:
                if slack[b + 1] != slack[b] or graze[b + 1] != graze[b]:
                    break
                b += 1
            c = (a + b) // 2
            T, p, seeing, posed = poses[c - a], tip[c], seen[b], False
            rule = TipRule(clearance, slope, slack[b], graze[b])
            _pose(T_solid_frame[j], rotation[c], p, T)
            gone = max(path[c] - path[a], path[b] - path[c])
            up, turn = rise(way, a, b, c)
            waiting, nodes[0] = 1, 0
            while waiting:
                waiting -= 1
                node = nodes[waiting]
                if since[node] >= seeing:
                    continue
                x, y, z = centre[node, 0], centre[node, 1], centre[node, 2]
                away = np.sqrt((x - p[0]) ** 2 + (y - p[1]) ** 2 + (z - p[2]) ** 2) + reach[node]
                d = solid_distance(
                    kind[j], size[j], planes,
                    T[0, 0] * x + T[0, 1] * y + T[0, 2] * z + T[0, 3],
                    T[1, 0] * x + T[1, 1] * y + T[1, 2] * z + T[1, 3],
                    T[2, 0] * x + T[2, 1] * y + T[2, 2] * z + T[2, 3],
                )  # fmt: skip
                low = d - reach[node] - min(clearance, slope * away - slack[b])
                if since[node] == FROM_THE_START:
                    low = min(low, d - reach[node] + graze[b])
                moved = (1.0 + slope) * gone + (away + gone) * turn
                if low - moved >= least - TOLERANCE:
                    continue
                if low_ones > 0:
                    height = reach[node] + up + away * turn + height_above(x, y, z, p, rotation[c])
                    still = since[node] == FROM_THE_START
                    if least_so_high(bounds, j, height, bounds.widest[node], still, graze[b]) >= least - TOLERANCE:
                        continue
                if left[node] >= 0:
                    nodes[waiting], nodes[waiting + 1] = left[node], right[node]
                    waiting += 2
                    continue
                for i in range(-1 - left[node], -1 - left[node] + right[node]):
                    if time[i] >= seeing:
                        continue
                    x, y, z = points[i, 0], points[i, 1], points[i, 2]
                    away = np.sqrt((x - p[0]) ** 2 + (y - p[1]) ** 2 + (z - p[2]) ** 2)
                    if low_ones > 0:
                        height = up + away * turn + height_above(x, y, z, p, rotation[c])
                        still = time[i] == FROM_THE_START
                        if least_so_high(bounds, j, height, tree.radius[i], still, graze[b]) >= least - TOLERANCE:
                            continue
                    value = point_value(tree, i, solid, T, p, rule)
                    if value - (1.0 + slope) * gone - (away + gone) * turn >= least - TOLERANCE:
                        continue
                    for k in range(a, a if posed else b + 1):
                        _pose(T_solid_frame[j], rotation[k], tip[k], poses[k - a])
                    posed = True
                    value, k = _least_of_point(tree, i, solid, T_solid_frame[j], way, a, b, rule, least, room)
                    if value < least:
                        least, where, whose, which = value, k, j, i
            a = b
    return least, where, whose, which


@inner_njit
def _here_and_there(tree, solids, way, clearance, slope, search):
    """The least value at some samples, its sample, body and point: it saves many of the later looks."""
    kind, size, planes, T_solid_frame = solids.kind, solids.size, solids.planes, solids.T_solid_frame
    tip, rotation, slack, graze, seen = way.tip, way.rotation, way.slack, way.graze, way.seen
    least, where, whose, which = FAR, 0, 0, -1
    T, apart = np.empty((4, 4)), max(_OFTEN, len(seen) // _FIRST_LOOKS)
    for j in range(len(kind)):
        for k in range(0, len(seen), apart):
            _pose(T_solid_frame[j], rotation[k], tip[k], T)
            solid, rule = SolidNumbers(kind[j], size[j], planes), TipRule(clearance, slope, slack[k], graze[k])
            value, point = nearest_point(tree, solid, T, tip[k], rule, seen[k], least, np.inf, search)
            if value < least:
                least, where, whose, which = value, k, j, point
    return least, where, whose, which


@inner_njit
def _least_of_point(tree, of, solid, T_solid_nozzle, way, a, b, rule, least, room):
    """The least value of one point in samples a .. b and its sample, if it is below `least`.

    A point laid in the meantime counts from the first sample that sees it, and at the instants just before that sample.

    of: the point in the tree's order; T_solid_nozzle (4, 4); rule: `TipRule` of the block; room: `BlockRoom` with the
    body's poses at the samples
    """
    point, time = tree.points[of], tree.time[of]
    tip, path, turned, seen = way.tip, way.path, way.turned, way.seen
    poses, samples, values = room.poses, room.samples, room.values
    slope = rule.slope
    first = a
    while time >= seen[first]:
        first += 1
    begin = max(a, first - 1)
    c = max(begin, (a + b) // 2)
    target, where = least - TOLERANCE, c
    middle = point_value(tree, of, solid, poses[c - a], tip[c], rule)
    if c >= first and middle < least:
        least, where = middle, c
    away = np.sqrt((point[0] - tip[c, 0]) ** 2 + (point[1] - tip[c, 1]) ** 2 + (point[2] - tip[c, 2]) ** 2)
    away += max(path[c] - path[begin], path[b] - path[c])
    waiting = 0
    for end in (begin, b):
        moved = (1.0 + slope) * abs(path[end] - path[c]) + away * abs(turned[end] - turned[c])
        if end == c or middle - moved >= target:
            continue
        value = point_value(tree, of, solid, poses[end - a], tip[end], rule)
        if end >= first and value < least:
            least, where = value, end
        samples[waiting, 0], samples[waiting, 1] = min(end, c), max(end, c)
        values[waiting, 0], values[waiting, 1] = (value, middle) if end < c else (middle, value)
        waiting += 1
    while waiting:
        waiting -= 1
        i, k = samples[waiting]
        vi, vk = values[waiting]
        moved = (1.0 + slope) * (path[k] - path[i]) + away * (turned[k] - turned[i])
        if 0.5 * (vi + vk - moved) >= target:
            continue
        if k == i + 1:
            value = _least_between(tree, of, solid, T_solid_nozzle, way, i, rule, vi + vk, moved, target)
            if value < least:
                least, where = value, k
            continue
        m = (i + k) // 2
        value = point_value(tree, of, solid, poses[m - a], tip[m], rule)
        if m >= first and value < least:
            least, where = value, m
        samples[waiting, 0], samples[waiting, 1], samples[waiting + 1, 0], samples[waiting + 1, 1] = i, m, m, k
        values[waiting, 0], values[waiting, 1], values[waiting + 1, 0], values[waiting + 1, 1] = vi, value, value, vk
        waiting += 2
    return least, where


@inner_njit
def _least_between(tree, of, solid, T_solid_nozzle, way, first, rule, both, moved, target):
    """The least value of a point between a sample and the next, at enough instants to miss none below the target.

    of: the point in the tree's order; both: the sum of its values at the two samples; moved: most that a value changes
    in between [m]
    """
    pa, pb, Ra, Rb = way.tip[first], way.tip[first + 1], way.rotation[first], way.rotation[first + 1]
    parts, least = 1, np.inf
    while 0.5 * (both - moved / parts) < target and parts < _MOST_PARTS:
        parts *= 2
    R, p, T = np.empty((3, 3)), np.empty(3), np.empty((4, 4))
    for i in range(1, parts):
        _between(Ra, Rb, pa, pb, i / parts, R, p)
        _pose(T_solid_nozzle, R, p, T)
        least = min(least, point_value(tree, of, solid, T, p, rule))
    return least


@njit
def margins_along(tree, solids, way, rule, often, bounds, margin, search):
    """Fill in `margin`, interpolated between looks; returns the least margin, its sample, body and point.

    The slope is so steep that only points beyond the tip's zone count, at least slack / slope away. Their least margin
    is found to _SPARE of the distance. Looks are as far apart as the margins at both ends of an interval allow: in
    between, a margin is no less than the mean of the two minus half of what the body moves. Where everything lies too
    low to be nearer than the target (`none_so_near`), looks are up to `often` samples apart.

    rule: `TipRule` with the least slack along the path; margin (n) [m]; the others as in `least_along`.
    """
    clearance, slope = rule.clearance, rule.slope
    kind, size, planes, T_solid_frame = solids.kind, solids.size, solids.planes, solids.T_solid_frame
    path, turned, n = way.path, way.turned, len(way.now)
    least, where, whose, which = _here_and_there(tree, solids, way, clearance, slope, search)
    samples, values = np.empty(_DEEPEST, np.int64), np.empty(_DEEPEST)  # looks ahead, the nearest one on top
    T, low_ones = np.empty((4, 4)), len(bounds.floor)
    for j in range(len(kind)):
        solid, own, c = SolidNumbers(kind[j], size[j], planes), T_solid_frame[j], solids.centre[j]
        arm = np.sqrt(c[0] ** 2 + c[1] ** 2 + c[2] ** 2) + solids.reach[j]
        k, known, waiting, sure, span, skipped = _ZERO, -1, 0, _ZERO, _OFTEN, _ZERO
        value, known = _look_at(tree, solid, own, way, clearance, slope, k, known, margin[k] + _AMPLE, search)
        margin[0] = min(margin[0], value)
        if value < least:
            least, where, whose, which = value, k, j, known
        while k < n - 1:
            target = least - max(TOLERANCE, _SPARE * (least + clearance))
            if waiting == 0:
                look, sure = _next_look(way, k, value - target, arm, slope), k
                if skipped > 0:
                    skipped -= 1
                while low_ones > 0 and skipped == 0 and sure < min(n - 1, k + often) and look < sure + span:
                    last = min(n - 1, sure + span)
                    c = (sure + last) // 2
                    _pose(own, way.rotation[c], way.tip[c], T)
                    if none_so_near(tree, solids, j, bounds, way, sure, last, T, rule, target, search):
                        sure, span = last, min(2 * span, _LONGEST)
                    elif span > _SHORTEST:
                        span //= 2
                    else:
                        skipped = _SKIPPED
                look = max(look, sure)
            else:
                ahead, far = samples[waiting - 1], values[waiting - 1]
                moved = _RATE * (path[ahead] - path[k] + arm * (turned[ahead] - turned[k]))
                look = (k + ahead) // 2 if ahead > sure and 0.5 * (value + far - moved) < target else k
            if look > k:
                samples[waiting] = look
                values[waiting], known = _look_at(
                    tree, solid, own, way, clearance, slope, look, known, margin[look] + _AMPLE, search
                )
                if values[waiting] < least:
                    least, where, whose, which = values[waiting], look, j, known
                waiting += 1
                continue
            if ahead == k + 1 and ahead > sure and 0.5 * (value + far - moved) < target:
                here = TipRule(clearance, slope, way.slack[ahead], way.graze[ahead])
                inside, found = _look_between(
                    tree, solid, own, way, here, k, 0.5 * (value + far), 0.5 * moved, target, search
                )
                if found >= 0:
                    least, where, whose, which = inside, ahead, j, found
            for i in range(k + 1, ahead + 1):
                done = (i - k) / (ahead - k)
                margin[i] = min(margin[i], (1.0 - done) * value + done * far)
            k, value, waiting = ahead, far, waiting - 1
    return least, where, whose, which


@inner_njit
def _next_look(way, k, spare, arm, slope):
    """The sample to look at after k: as far on as is enough if the margin there equals that at k.

    spare: how far the margin may fall [m]; arm: how far the body reaches from the tip [m]
    """
    path, turned, now, slack = way.path, way.turned, way.now, way.slack
    seeing, m = way.seen[k], k + 1
    while m < min(len(now) - 1, k + _OFTEN):
        far = path[m + 1] - path[k]
        if spare < 0.5 * _RATE * (far + arm * (turned[m + 1] - turned[k])):
            break
        # beads laid in the meantime lie where the tip has been: well within its zone
        if now[m + 1] > seeing and 2.0 * far > slack[k] / slope:
            break
        m += 1
    return m


@inner_njit
def _look_at(tree, solid, T_solid_nozzle, way, clearance, slope, k, known, most, search):
    """The margin of a body at sample k, capped at `most` and FAR, and its point; `known`: where to begin, or -1."""
    T, rule, seeing = np.empty((4, 4)), TipRule(clearance, slope, way.slack[k], way.graze[k]), way.seen[k]
    _pose(T_solid_nozzle, way.rotation[k], way.tip[k], T)
    enough = min(FAR, most)
    if known >= 0 and tree.time[known] < seeing:
        enough = min(enough, point_value(tree, known, solid, T, way.tip[k], rule))
    value, point = nearest_point(tree, solid, T, way.tip[k], rule, seeing, enough, np.inf, search)
    return value, known if point < 0 else point


@inner_njit
def _look_between(tree, solid, T_solid_nozzle, way, rule, k, mean, fall, target, search):
    """The least margin of a body between samples k and k + 1, if below the target, and its point; otherwise -1.

    mean: of the margins at both samples; fall: how far below the mean a margin in between may be [m]
    """
    T, R, p = np.empty((4, 4)), np.empty((3, 3)), np.empty(3)
    parts, least, which = 1, target, -1
    while mean - fall / parts < target and parts < _MOST_PARTS:
        parts *= 2
    for i in range(1, parts):
        _between(way.rotation[k], way.rotation[k + 1], way.tip[k], way.tip[k + 1], i / parts, R, p)
        _pose(T_solid_nozzle, R, p, T)
        value, point = nearest_point(tree, solid, T, p, rule, way.seen[k + 1], least, np.inf, search)
        if value < least:
            least, which = value, point
    return least, which


@inner_njit
def _pose(T_solid_nozzle, R, p, T):
    """T_solid_part (4, 4) of a solid, from the nozzle frame's axes R and origin p in the part frame."""
    for i in range(3):
        for k in range(3):
            T[i, k] = T_solid_nozzle[i, 0] * R[k, 0] + T_solid_nozzle[i, 1] * R[k, 1] + T_solid_nozzle[i, 2] * R[k, 2]
        T[i, 3] = T_solid_nozzle[i, 3] - T[i, 0] * p[0] - T[i, 1] * p[1] - T[i, 2] * p[2]


@inner_njit
def _between(Ra, Rb, pa, pb, share, R, p):
    """The pose at a fraction of the way between two that differ little."""
    for k in range(3):
        p[k] = (1.0 - share) * pa[k] + share * pb[k]
    for column in (2, 0):  # z interpolated, x perpendicular to it
        length, along = 0.0, 0.0
        for i in range(3):
            R[i, column] = (1.0 - share) * Ra[i, column] + share * Rb[i, column]
        if column == 0:
            for i in range(3):
                along += R[i, 0] * R[i, 2]
            for i in range(3):
                R[i, 0] -= along * R[i, 2]
        for i in range(3):
            length += R[i, column] ** 2
        for i in range(3):
            R[i, column] /= np.sqrt(length)
    R[0, 1] = R[1, 2] * R[2, 0] - R[2, 2] * R[1, 0]
    R[1, 1] = R[2, 2] * R[0, 0] - R[0, 2] * R[2, 0]
    R[2, 1] = R[0, 2] * R[1, 0] - R[1, 2] * R[0, 0]


@dataclass(frozen=True)
class Nearness:
    """How near bodies that move with the nozzle come to part and print (n samples).

    margin (n)   distance minus the required one [m], FAR at most; interpolated between evaluations; may be empty
    least, at    the least margin [m] and its sample
    body, point  index of its body, and of its point in the tree's order; -1 if none is nearer than FAR
    """

    margin: Array
    least: float
    at: int
    body: int
    point: int


def print_times(toolpath: Toolpath, trajectory: Trajectory) -> Array:
    """How much is printed at each sample (n): bead index plus share of its length; in travel, the next index."""
    bead = trajectory.bead
    lengths = np.array([each.length for each in toolpath.beads])
    share = np.clip(trajectory.s / lengths[np.maximum(bead, 0)], 0.0, 1.0)
    begun = trajectory.begun + 1.0
    now = np.where(bead >= 0, bead + share, begun)
    return np.asarray(np.maximum.accumulate(now), dtype=float)


def room_along(problem: Problem, toolpath: Toolpath, trajectory: Trajectory, nozzle: NozzleSpec) -> TipRoom:
    """Relief from the required distance near a nozzle's tip at each sample (n): that of its bead, or in travel the
    greater of the beads before and after."""
    begun, bead = trajectory.begun, np.maximum(trajectory.bead, 0)
    last, following = np.maximum(begun, 0), np.minimum(begun + 1, len(toolpath.beads) - 1)
    return TipRoom(
        *(
            np.where(trajectory.bead >= 0, own[bead], np.maximum(own[last], own[following]))
            for own in tip_room(problem, toolpath, nozzle)
        )
    )


def nozzle_nearness(
    tree: PointTree,
    bodies: Packed,
    motion: ExecutedMotion,
    now: Array,
    room: TipRoom,
    clearance: float,
    look: float = _LOOK,
) -> Nearness:
    """The least of distance - min(clearance, TIP_SLOPE * distance from the tip - slack) along a motion, and of distance +
    graze for points there from the start (see `nearest_point`), to TOLERANCE, also between samples."""
    way, solids = _way(motion, now, room.slack, room, look), _solids(bodies)
    bounds = _bounds(tree, solids, way, TipRule(clearance, TIP_SLOPE, float(room.slack.min()), np.inf), 2e-5, 0.02)
    found = least_along(tree.arrays, solids, way, clearance, TIP_SLOPE, bounds, search_room())
    return Nearness(np.empty(0), *found)


def beyond_the_tip(
    tree: PointTree,
    bodies: Packed,
    motion: ExecutedMotion,
    now: Array,
    room: TipRoom,
    clearance: float,
    look: float = _LOOK,
) -> Nearness:
    """Margins of true distances, minus the clearance, from points beyond the tip's zone.

    The least is exact to TOLERANCE where it is negative, and to _SPARE of the distance elsewhere.
    """
    zone = (clearance + room.slack) / TIP_SLOPE
    beyond_it = TipRoom(_STEEP * zone, np.full(len(now), np.inf))
    way, solids = _way(motion, now, room.slack, beyond_it, look), _solids(bodies)
    n, margin = len(now), np.full(len(now), FAR)
    least_zone, often = float(zone.min()), int(np.clip(n // _FEW_LOOKS, _OFTEN, _RARELY))
    rule = TipRule(clearance, _STEEP, _STEEP * least_zone, np.inf)
    bounds = _bounds(tree, solids, way, rule, 0.98 * least_zone, 0.006)
    found: dict[int, tuple[float, int, int, int]] = {}

    def look_along(at: slice) -> None:
        """Search a block, up to and including the first sample of the next."""
        some = NozzleWay(*(values[at.start : min(at.stop + 1, n)] for values in way))
        own = np.full(len(some.now), FAR)
        least, k, body, point = margins_along(tree.arrays, solids, some, rule, often, bounds, own, search_room())
        margin[at] = own[: at.stop - at.start]
        found[at.start] = least, at.start + k, body, point

    in_blocks(look_along, n, _AT_ONCE)
    return Nearness(margin, *found[min(found, key=lambda start: (found[start][0], start))])


def _bounds(
    tree: PointTree, solids: HeadSolids, way: NozzleWay, rule: TipRule, nearest: float, fine: float
) -> HeightBounds:
    """Least margins by height; for no body where the path is too short for them to pay off."""
    arrays, enough = tree.arrays, len(way.now) >= _WORTH_BOUNDS
    own = solids if enough else _no_solids(solids)
    return height_bounds(arrays, own, rule, _DEEP, nearest, fine)


def _no_solids(like: HeadSolids) -> HeadSolids:
    """No solids, as empty arrays of the same types."""
    kind, size, planes, T_solid_frame, centre, reach = like
    return HeadSolids(kind[:0], size[:0], planes[:0], T_solid_frame[:0], centre[:0], reach[:0])


def _solids(bodies: Packed) -> HeadSolids:
    """Bodies in the form that the kernels take."""
    return HeadSolids(bodies.kind, bodies.size, bodies.planes, bodies.T_solid_frame, bodies.centre, bodies.reach)


def _way(motion: ExecutedMotion, now: Array, slack: Array, asked: TipRoom, look: float) -> NozzleWay:
    """A motion in the form that the kernels take; asked: the slack and graze that they apply."""
    tip, rotation = np.ascontiguousarray(motion.tip), np.ascontiguousarray(motion.rotation)
    seen = now[_looked_ahead(motion.tip, now, slack, look)]
    return NozzleWay(tip, rotation, *_path_lengths(tip, rotation), now, *asked, seen)


def by_the_tip(judged: Judged) -> Nearness:
    """How near nozzle and head come to part and print, by the rule for the tip."""
    return _nearest(judged, nozzle_nearness)


def beyond(judged: Judged) -> Nearness:
    """How near nozzle and head come to part and print beyond the tip's zone."""
    return _nearest(judged, beyond_the_tip)


def _nearest(judged: Judged, look: Callable[..., Nearness]) -> Nearness:
    """The least of the results of `look` for each nozzle while it is in use."""
    problem, toolpath, t = judged.problem, judged.toolpath, judged.trajectory
    now, found = print_times(toolpath, t), []
    for cell, rows in judged.stretches:
        room = room_along(problem, toolpath, t, problem.cell.nozzle_named(cell.nozzle_name))
        own = TipRoom(room.slack[rows], room.graze[rows])
        there = judged.body.tree, packed(cell.head), judged.motion.rows(rows), now[rows], own
        near = look(*there, problem.collision.nozzle, _look(toolpath))
        found.append(replace(near, at=near.at + rows.start))
    least = min(found, key=attrgetter("least"))
    return least if len(found) == 1 else replace(least, margin=np.concatenate([near.margin for near in found]))


def check_nozzle(judged: Judged, near: tuple[Nearness, Nearness]) -> Check:
    """The check of nozzle and head, by the rule for the tip; true distances are reported.

    Where the rule holds, the least distance beyond the tip's zone is reported; where it does not, the distance at the
    worst place and the one required there. near: the results of `by_the_tip` and `beyond`
    """
    rule, far = near
    name, need = "nozzle clear of part and print", judged.problem.collision.nozzle
    ok = rule.least >= -DIGITS
    told, asked, where = far, need, ""
    if not ok:
        told, asked = rule, asked_at(judged, rule)
        where = f", {_away(judged, rule) * 1e3:.1f} mm from the tip"
    worst, at = min(FAR, told.least + asked), told.at if told.point >= 0 else -1
    return Check(name, worst * 1e3, asked * 1e3, "mm", ok, _whose(judged, told) + where, least=True, sample=at)


def asked_at(judged: Judged, rule: Nearness) -> float:
    """The distance [m] that the rule for the tip requires at the place of the least margin."""
    need, tree = judged.problem.collision.nozzle, judged.body.tree
    if rule.point < 0:
        return need
    nozzle = judged.problem.cell.nozzle_named(judged.cell_at(rule.at).nozzle_name)
    room = room_along(judged.problem, judged.toolpath, judged.trajectory, nozzle)
    asked = float(min(need, TIP_SLOPE * _away(judged, rule) - room.slack[rule.at]))
    still, graze = tree.time[rule.point] == FROM_THE_START, float(room.graze[rule.at])
    return -graze if still and asked < -graze - tree.radius[rule.point] else asked


def _away(judged: Judged, near: Nearness) -> float:
    """Distance [m] of the nearest point from the tip."""
    return float(np.linalg.norm(judged.body.tree.points[near.point] - judged.motion.tip[near.at]))


def _whose(judged: Judged, near: Nearness) -> str:
    """The place in words: which body, near which other, and when."""
    if near.point < 0:
        return EVERYWHERE
    pair = f"{judged.cell_at(near.at).head[near.body].name} and {judged.body.name_of(near.point)}"
    return f"{pair}, {place(judged.trajectory, near.at)}"


def _look(toolpath: Toolpath) -> float:
    """Share of the tip's zone ahead of it in which beads may count as laid: 0 where struts rise into the nozzle."""
    return 0.0 if any(bead.round for bead in toolpath.beads) else _LOOK


def _looked_ahead(tip: Array, now: Array, slack: Array, look: float) -> Ints:
    """The later sample (n) up to which beads may count as printed at each sample: a part of the tip's zone ahead."""
    far = arc_lengths(tip)
    bead = np.floor(now)
    last = np.searchsorted(bead, bead, side="right") - 1
    reach = np.searchsorted(far, far + look * slack / TIP_SLOPE, side="right") - 1
    return np.asarray(np.maximum(np.minimum(last, reach), np.arange(len(now))), dtype=np.int64)


def _path_lengths(tip: Array, rotation: Array) -> tuple[Array, Array]:
    """How far (n) the tip has moved [m] and the axes have turned [rad] since the first sample."""
    turned = np.einsum("nij,nij->n", rotation[1:], rotation[:-1])
    angle = np.arccos(np.clip(0.5 * (turned - 1.0), -1.0, 1.0))
    return arc_lengths(tip), np.concatenate([[0.0], np.cumsum(angle)])
