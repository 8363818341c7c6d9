"""Independent check that nozzle and print head keep clear of part and print, as these are at every instant.

Nobody can keep a distance where the nozzle lays a bead beside another: a point at distance r from the tip is to be
TIP_SLOPE * r away, less what face and bead take, until that is the whole distance; from there on, beyond the tip's zone,
the whole distance is kept. All samples are looked at, and instants between them, as far as motion since the last look
could have brought anything too near.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from planner.cell import Cell
from planner.plan import Check, Trajectory
from planner.point_tree import PointTree, nearest_point, point_value, search_room, solid_distance
from planner.print_body import TIP_SLOPE, PrintBody, tip_slack
from planner.problem import Problem
from planner.replay import Motion
from planner.solids import Packed, packed
from planner.toolpath.bead import Toolpath
from planner.verify.checks import DIGITS, place

Array = NDArray[np.float64]
Index = NDArray[np.int64]

FAR = 50e-3  # m: what is farther away is that far away
TOLERANCE = 1e-4  # m: no distance is missed that is less than the least that is found by more
_SHARE = 1.0  # of what points beyond the tip's zone have to spare, to which the least is found: enough to miss none that lacks
_OFTEN = 25  # samples after which every body is looked at again, wherever it is
_STEEP = 1e3  # slope that lets nothing within the tip's zone count
_MOST_PARTS = 64  # of the time between two samples


@dataclass(frozen=True)
class Nearness:
    """How near to part and print bodies come that move with the nozzle (n samples).

    margin (n)   distance less what is needed, FAR at most; between looks it is interpolated; empty if not asked for
    least, at    the least of all, and its sample; body, point: whose it is (index), and the point in the tree's order,
                 or -1 if nothing is nearer than FAR
    looks        how many distances were asked for
    """

    margin: Array
    least: float
    at: int
    body: int
    point: int
    looks: int


def print_times(toolpath: Toolpath, trajectory: Trajectory) -> Array:
    """What is printed at each sample (n), in beads: index and share of the length; in travel, of the next bead."""
    bead = trajectory.bead
    lengths = np.array([each.length for each in toolpath.beads])
    share = np.clip(trajectory.s / lengths[np.maximum(bead, 0)], 0.0, 1.0)
    begun = trajectory.begun + 1.0
    now = np.where(bead >= 0, bead + share, begun)
    return np.asarray(np.maximum.accumulate(now), dtype=float)


def slack_along(problem: Problem, toolpath: Toolpath, trajectory: Trajectory) -> Array:
    """The slack beside the tip (n) at each sample: of its bead, in travel the greater one of the beads at its ends."""
    own = tip_slack(problem.cell.nozzle, toolpath)
    begun = trajectory.begun
    last, following = np.maximum(begun, 0), np.minimum(begun + 1, len(own) - 1)
    both = np.maximum(own[last], own[following])
    return np.where(trajectory.bead >= 0, own[np.maximum(trajectory.bead, 0)], both)


def nozzle_nearness(
    tree: PointTree,
    bodies: Packed,
    motion: Motion,
    now: Array,
    slack: Array,
    clearance: float,
    slope: float = TIP_SLOPE,
    ahead: Index | None = None,
    share: float = 0.0,
    margins: bool = False,
) -> Nearness:
    """The least of distance - min(clearance, slope * distance from the tip - slack) along a motion (see `nearest_point`).

    It is found to TOLERANCE, or a share of itself, also between samples: that is known for a slope of TIP_SLOPE at most.
    ahead (n): the samples up to which what is laid counts as there; as for that slope, if not given. margins: whether
    those of all samples are asked for.
    """
    ahead = _looked_ahead(motion.tip, now, slack) if ahead is None else ahead
    tip, rotation = np.ascontiguousarray(motion.tip), np.ascontiguousarray(motion.rotation)
    margin = np.full(len(now) if margins else 0, FAR)
    least, at, body, point, looks = _along(
        tree.points, tree.radius, tree.time, tree.centre, tree.reach, tree.since, tree.left, tree.right,
        bodies.kind, bodies.size, bodies.planes, bodies.T_solid_frame, bodies.centre, bodies.reach,
        tip, rotation, *_path_lengths(tip, rotation), now, slack,
        clearance, slope, 1.0 + min(slope, TIP_SLOPE), share, ahead, margin, search_room(),
    )  # fmt: skip
    return Nearness(margin, least, at, body, point, looks)


def beyond_the_tip(
    tree: PointTree, bodies: Packed, motion: Motion, now: Array, slack: Array, clearance: float
) -> Nearness:
    """The same of true distances, less the clearance, from points beyond the tip's zone."""
    zone = (clearance + slack) / TIP_SLOPE
    ahead = _looked_ahead(motion.tip, now, slack)
    return nozzle_nearness(tree, bodies, motion, now, _STEEP * zone, clearance, _STEEP, ahead, _SHARE, True)


def by_the_tip(
    problem: Problem, cell: Cell, toolpath: Toolpath, t: Trajectory, motion: Motion, body: PrintBody
) -> Nearness:
    """How near nozzle and head come, by the rule for the tip."""
    now, slack = print_times(toolpath, t), slack_along(problem, toolpath, t)
    return nozzle_nearness(body.tree, packed(cell.head), motion, now, slack, problem.collision.nozzle)


def beyond(
    problem: Problem, cell: Cell, toolpath: Toolpath, t: Trajectory, motion: Motion, body: PrintBody
) -> Nearness:
    """How near they come beyond the tip's zone."""
    now, slack = print_times(toolpath, t), slack_along(problem, toolpath, t)
    return beyond_the_tip(body.tree, packed(cell.head), motion, now, slack, problem.collision.nozzle)


def check_nozzle(problem: Problem, cell: Cell, t: Trajectory, body: PrintBody, rule: Nearness) -> Check:
    """The check, from how near they come by the rule for the tip."""
    need = problem.collision.nozzle
    worst = rule.least + need
    where = f"{cell.head[rule.body].name} and {body.name_of(rule.point)}, {place(t, rule.at)}"
    if rule.point < 0:
        where = "everywhere"
    ok = worst >= need - DIGITS
    at = rule.at if rule.point >= 0 else -1
    return Check("nozzle clear of part and print", worst * 1e3, need * 1e3, "mm", ok, where, least=True, sample=at)


def _looked_ahead(tip: Array, now: Array, slack: Array) -> Index:
    """For each sample (n) the one up to which what is laid may count as there: a part of the tip's zone ahead."""
    far = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(tip, axis=0), axis=1))])
    bead = np.floor(now)
    last = np.searchsorted(bead, bead, side="right") - 1
    reach = np.searchsorted(far, far + 0.25 * slack / TIP_SLOPE, side="right") - 1
    return np.asarray(np.maximum(np.minimum(last, reach), np.arange(len(now))), dtype=np.int64)


def _path_lengths(tip: Array, rotation: Array) -> tuple[Array, Array]:
    """How far (n) the tip has moved [m] and the axes have turned [rad] since the first sample."""
    turned = np.einsum("nij,nij->n", rotation[1:], rotation[:-1])
    angle = np.arccos(np.clip(0.5 * (turned - 1.0), -1.0, 1.0))
    steps = np.linalg.norm(np.diff(tip, axis=0), axis=1)
    return np.concatenate([[0.0], np.cumsum(steps)]), np.concatenate([[0.0], np.cumsum(angle)])


@njit(cache=True, nogil=True, error_model="numpy")
def _along(
    points, radius, time, centre, reach, since, left, right,
    kind, size, planes, T_solid_frame, body_centre, body_reach,
    tip, rotation, path, turned, now, slack, clearance, slope, rate, share, ahead, margin, stack,
):  # fmt: skip
    """Fill margin, unless it is empty; returns the least, its sample, body and point, and how often it was looked.

    A margin changes by `rate` times the motion at most, so that samples are passed over as long as this cannot matter.
    A search begins with the point that was the nearest one before; where no margins are asked for, it ends at what lets
    the most samples be passed over.
    """
    n, fill = len(now), len(margin) > 0
    least, where, whose, which, looks = FAR, 0, 0, -1, 0
    T, R, p = np.empty((4, 4)), np.empty((3, 3)), np.empty(3)
    for j in range(len(kind)):  # a look here and there, which spares many of those that follow
        for k in range(0, n, _OFTEN):
            _pose(T_solid_frame[j], rotation[k], tip[k], T)
            value, point = nearest_point(
                points, radius, time, centre, reach, since, left, right, kind[j], size[j], planes, T,
                now[ahead[k]], least, clearance, tip[k], slope, slack[k], stack,
            )  # fmt: skip
            looks += 1
            if value < least:
                least, where, whose, which = value, k, j, point
    for j in range(len(kind)):
        c = body_centre[j]
        arm = np.sqrt(c[0] ** 2 + c[1] ** 2 + c[2] ** 2) + body_reach[j]
        own = T_solid_frame[j]
        tip_away = solid_distance(kind[j], size[j], planes, own[0, 3], own[1, 3], own[2, 3])
        k, before, value_before, known = 0, -1, 0.0, -1
        while True:
            seeing = now[ahead[k]]
            _pose(own, rotation[k], tip[k], T)
            enough = FAR
            if not fill:
                m = min(n - 1, k + _OFTEN)
                moved = path[m] - path[k] + arm * (turned[m] - turned[k])
                enough = min(FAR, max(least, least - max(TOLERANCE, share * least) + rate * moved))
            found = -1
            if known >= 0 and time[known] < seeing:
                value = point_value(
                    points[known], radius[known], kind[j], size[j], planes, T, clearance, tip[k], slope, slack[k]
                )
                if value < enough:
                    enough, found = value, known
            value, point = nearest_point(
                points, radius, time, centre, reach, since, left, right, kind[j], size[j], planes, T,
                seeing, enough, clearance, tip[k], slope, slack[k], stack,
            )  # fmt: skip
            point = found if point < 0 else point
            known = point if point >= 0 else known
            looks += 1
            if value < least:
                least, where, whose, which = value, k, j, point
            if k == before + 1 and k > 0:
                moved = rate * (path[k] - path[before] + arm * (turned[k] - turned[before]))
                parts = 1
                while (
                    0.5 * (value + value_before - moved / parts) < least - max(TOLERANCE, share * least)
                    and parts < _MOST_PARTS
                ):
                    parts *= 2
                for i in range(1, parts):
                    _between(rotation[before], rotation[k], tip[before], tip[k], i / parts, R, p)
                    _pose(own, R, p, T)
                    inside, found = nearest_point(
                        points, radius, time, centre, reach, since, left, right, kind[j], size[j], planes, T,
                        seeing, least, clearance, p, slope, slack[k], stack,
                    )  # fmt: skip
                    looks += 1
                    if inside < least:
                        least, where, whose, which = inside, k, j, found
            for i in range(max(before, 0), k + 1 if fill else 0):
                done = (i - before) / max(k - before, 1)
                margin[i] = min(margin[i], (1.0 - done) * value_before + done * value if before >= 0 else value)
            if k == n - 1:
                break
            target = least - max(TOLERANCE, share * least)
            m = k + 1
            while m < min(n - 1, k + _OFTEN):
                moved = path[m + 1] - path[k] + arm * (turned[m + 1] - turned[k])
                if value - rate * moved < target:
                    break
                # what is laid in the meantime lies where the tip has been: far within its zone, if only what is beyond counts
                far = path[m + 1] - path[k]
                counts = slope <= TIP_SLOPE or 2.0 * far > slack[k] / slope
                if now[m + 1] > seeing and counts and tip_away - far - slack[k] / TIP_SLOPE - clearance < target:
                    break
                m += 1
            before, value_before, k = k, value, m
    return least, where, whose, which, looks


@njit(cache=True, nogil=True, error_model="numpy")
def _pose(T_solid_nozzle, R, p, T):
    """T_solid_part (4, 4) of a solid in the nozzle frame, whose axes in the part frame are R and whose origin is p."""
    for i in range(3):
        for k in range(3):
            T[i, k] = T_solid_nozzle[i, 0] * R[k, 0] + T_solid_nozzle[i, 1] * R[k, 1] + T_solid_nozzle[i, 2] * R[k, 2]
        T[i, 3] = T_solid_nozzle[i, 3] - T[i, 0] * p[0] - T[i, 1] * p[1] - T[i, 2] * p[2]


@njit(cache=True, nogil=True, error_model="numpy")
def _between(Ra, Rb, pa, pb, share, R, p):
    """The pose at a share of the way between two that differ little."""
    for k in range(3):
        p[k] = (1.0 - share) * pa[k] + share * pb[k]
    for column in (2, 0):  # z as it lies between, x at right angles to it
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
