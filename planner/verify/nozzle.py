"""Independent check that nozzle and print head keep clear of part and print, as these are at every instant.

Nobody can keep a distance where the nozzle lays a bead beside another: a point at distance r from the tip is to be
TIP_SLOPE * r away, less what face and bead take, until that is the whole distance; from there on, beyond the tip's zone,
the whole distance is kept. All samples are looked at, and instants between them, as far as motion since the last look
could have brought anything too near.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from planner.cell import Cell
from planner.plan import Check, Trajectory
from planner.point_tree import PointTree, search_room
from planner.print_body import TIP_SLOPE, PrintBody, tip_slack
from planner.problem import Problem
from planner.readonly import Array, Ints
from planner.replay import Motion
from planner.solids import Packed, packed
from planner.toolpath.bead import Toolpath
from planner.verify.checks import DIGITS, place
from planner.verify.nozzle_kernel import FAR, least_along, margins_along

_STEEP = 1e3  # slope that lets nothing within the tip's zone count


@dataclass(frozen=True)
class Nearness:
    """How near to part and print bodies come that move with the nozzle (n samples).

    margin (n)   distance less what is needed, FAR at most; between looks it is interpolated; empty if not asked for
    least, at    the least of all, and its sample; body, point: whose it is (index), and the point in the tree's order,
                 or -1 if nothing is nearer than FAR
    """

    margin: Array
    least: float
    at: int
    body: int
    point: int


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
    tree: PointTree, bodies: Packed, motion: Motion, now: Array, slack: Array, clearance: float
) -> Nearness:
    """The least of distance - min(clearance, TIP_SLOPE * distance from the tip - slack) along a motion (see
    `nearest_point`), to TOLERANCE, also between samples."""
    ahead = _looked_ahead(motion.tip, now, slack)
    found = least_along(
        *_points(tree), bodies.kind, bodies.size, bodies.planes, bodies.T_solid_frame,
        *_ways(motion), now, slack, clearance, TIP_SLOPE, ahead, search_room(),
    )  # fmt: skip
    return Nearness(np.empty(0), *found)


def beyond_the_tip(
    tree: PointTree, bodies: Packed, motion: Motion, now: Array, slack: Array, clearance: float
) -> Nearness:
    """The same of true distances, less the clearance, from points beyond the tip's zone; with the margins, and the least
    only so far that none is missed that lacks."""
    zone = (clearance + slack) / TIP_SLOPE
    ahead = _looked_ahead(motion.tip, now, slack)
    margin = np.full(len(now), FAR)
    found = margins_along(
        *_points(tree), bodies.kind, bodies.size, bodies.planes, bodies.T_solid_frame, bodies.centre, bodies.reach,
        *_ways(motion), now, _STEEP * zone, clearance, _STEEP, ahead, margin, search_room(),
    )  # fmt: skip
    return Nearness(margin, *found)


def _points(tree: PointTree) -> tuple[Array, Array, Array, Array, Array, Array, Ints, Ints]:
    """A tree as the kernels want it."""
    return tree.points, tree.radius, tree.time, tree.centre, tree.reach, tree.since, tree.left, tree.right


def _ways(motion: Motion) -> tuple[Array, Array, Array, Array]:
    """Where tip and axes are, and how far (n) they have moved [m] and turned [rad] since the first sample."""
    tip, rotation = np.ascontiguousarray(motion.tip), np.ascontiguousarray(motion.rotation)
    return tip, rotation, *_path_lengths(tip, rotation)


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


def _looked_ahead(tip: Array, now: Array, slack: Array) -> Ints:
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
