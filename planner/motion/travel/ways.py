"""Ways from one state to another: straight, with a hump over the part, or by way of postures at which it rests.

A hump is a second motion of the arm alone, added to the straight move: the sum of piecewise cubics is piecewise cubic
again, and the travel takes no longer if the limits' remainder suffices to lift the nozzle during the straight move.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from planner.base.arrays import Array
from planner.base.compiled import njit
from planner.cell.cell import Cell
from planner.cell.kinematics.chain import chain_jacobians, chain_poses, solve_symmetric
from planner.motion.cubics import Cubics, JointState, add, chain, extremes, rest
from planner.motion.timing.profile import HEADROOM
from planner.motion.travel.clearance import TravelClearance, glance
from planner.motion.travel.moves import LEAST_LEFT, Bounds, between, resting, time_beside

DRAW_BACK = 0.5  # rad of the lower arm, backwards: lifts the nozzle off the part and towards the arm's base
_NEWTON_STEPS = 4  # towards a tip position, at most
_REACHED = 1e-6  # m: close enough to it
_DAMPING = 1e-6  # m^2: keeps steps small where the arm is stretched
_STRETCHES = 8  # attempts to give the lift the time it needs
_SHARE = 0.5  # share of an arm joint's acceleration and jerk for a straight move between moving ends; the rest lifts
_MORE = 1e-6  # s that a straight move lasts longer than its hump needs
_SLOWER_TRIES = 4  # for a move whose tip is too fast: between rests the first one suffices
SLOWEST = 1e-3  # rad/s that a joint may always move at, so that a cap never stops it
_IN_TIME = 1.0 - 1e-9  # share of the straight move: the hump ends within it, in spite of rounding


@dataclass(frozen=True)
class Caps:
    """Greatest joint velocities of the straight move (nj), and of the hump over it [rad/s]."""

    along: Array
    over: Array


@dataclass(frozen=True)
class Built:
    """A way as it would be driven, and its parts: the straight move, and the hump over it if there is one."""

    motion: Cubics
    along: Cubics | None = None
    over: Cubics | None = None


@dataclass(frozen=True)
class Ends:
    """The two states that a travel joins, its least duration [s], and the bounds that it may use."""

    start: JointState
    end: JointState
    least: float
    bounds: Bounds

    @property
    def resting(self) -> bool:
        """Whether both are at rest."""
        return self.start.resting and self.end.resting


def bounds_of(cell: Cell) -> Bounds:
    """The bounds that travel keeps: joint limits less headroom."""
    limits = cell.limits
    return Bounds(HEADROOM * limits.velocity, HEADROOM * limits.acceleration, HEADROOM * limits.jerk)


def straight(cell: Cell, ends: Ends, caps: Caps) -> Built | None:
    """One move from state to state."""
    motion = between(ends.bounds.capped(caps.along), ends.start, ends.end, ends.least)
    return None if motion is None else Built(motion)


def hump(cell: Cell, ends: Ends, room: TravelClearance, raised: float, turns: int, caps: Caps) -> Built | None:
    """The straight move, the nozzle lifted off the part by `raised` [m] more than at the ends.

    With one turn the lift is that of the middle; with three it follows the part at the start, the middle and the end.
    """
    shares = np.array([0.5]) if turns == 1 else np.array([0.0, 0.5, 1.0])
    along = _along(cell, ends, caps, ends.least)
    if along is None:
        return None
    q = along.joints(shares * along.duration)
    lifts = lifted(cell, q, room, raised) - q[:, : len(cell.arm)]
    vias = np.vstack([np.zeros_like(lifts[:1]), lifts, np.zeros_like(lifts[:1])])
    for _ in range(_STRETCHES):
        laid, needed = _laid_over(ends, along, vias, caps)
        if laid is not None:
            return Built(add(along, _with_holder(cell, laid)), along, laid)
        slower = _along(cell, ends, caps, needed)
        if slower is None:
            return None
        along = slower
    return None


def _along(cell: Cell, ends: Ends, caps: Caps, least: float) -> Cubics | None:
    """The straight move below a hump."""
    bounds = ends.bounds.capped(caps.along)
    if not ends.resting:  # then joints do not move in proportion, and each uses all that it is given
        share = np.where(np.arange(len(bounds.jerk)) < len(cell.arm), _SHARE, 1.0)
        own = np.maximum(np.abs(ends.start.a), np.abs(ends.end.a))
        acceleration = np.minimum(bounds.acceleration, np.maximum(share * bounds.acceleration, own))
        bounds = replace(bounds, acceleration=acceleration, jerk=share * bounds.jerk)
    return between(bounds, ends.start, ends.end, least)


def _laid_over(ends: Ends, along: Cubics, vias: Array, caps: Caps) -> tuple[Cubics | None, float]:
    """A motion of the arm's joints over vias (k, na) within what a straight move leaves of the limits.

    Or None, and how long the straight move should last for it [s]. The first and last vias are 0; the first and last
    moves are as quick as possible, and the remaining time is spent between them.
    """
    na = vias.shape[1]
    found = extremes(along)
    taken = np.stack([found.velocity[:na], found.acceleration[:na], found.jerk[:na]])
    bounds = np.stack([ends.bounds.velocity[:na], ends.bounds.acceleration[:na], ends.bounds.jerk[:na]])
    needed = time_beside(bounds, caps.over, taken, _IN_TIME * along.duration, vias)
    if needed > _IN_TIME * along.duration:
        return None, needed * (2.0 - _IN_TIME) + _MORE
    bounds = np.maximum(bounds - taken, LEAST_LEFT * bounds)
    left = Bounds(np.minimum(bounds[0], caps.over), bounds[1], bounds[2])
    pieces = [resting(left, a, b) for a, b in itertools.pairwise(vias)]
    spare = _IN_TIME * along.duration - sum(piece.duration for piece in pieces)
    if len(pieces) == 2:
        pieces.insert(1, rest(vias[1], spare))
    else:
        share = spare / (len(pieces) - 2)
        for i in range(1, len(pieces) - 1):
            pieces[i] = resting(left, vias[i], vias[i + 1], pieces[i].duration + share)
    return chain(pieces), needed


def _with_holder(cell: Cell, arm: Cubics) -> Cubics:
    """The arm's motion with a holder that stays still."""
    still = np.zeros((*arm.coefficients.shape[:2], len(cell.holder)))
    return Cubics(arm.times, np.concatenate([arm.coefficients, still], axis=2))


def lifted(cell: Cell, q: Array, room: TravelClearance, raised: float) -> Array:
    """The arm's joints (m, na) near postures q (m, nj), the tip lifted off the part along its normal.

    It is lifted to a distance `raised` [m] greater than that of the end nearer to the part.
    """
    tip = cell.T_part_nozzle(q)[:, :3, 3]
    want = float(room.gaps[:, 0].min()) + raised
    rise = np.maximum(want - room.surface.signed_distance(tip), 0.0)
    return reaching(cell, q, tip + rise[:, None] * room.surface.normals(tip))


def reaching(cell: Cell, q: Array, tips: Array) -> Array:
    """The arm's joints (m, na) near postures q (m, nj) that bring the tip to points (m, 3) of the part frame.

    Of all such joints, those that are reached soonest; the nozzle's direction is left free.
    """
    na = len(cell.arm)
    T_world_part = cell.holder.poses(q[:, na:])
    goal = np.einsum("mij,mj->mi", T_world_part[:, :3, :3], tips) + T_world_part[:, :3, 3]
    arm, limits = cell.arm, cell.limits.acceleration[:na]
    return _reaching(arm.placements, arm.axes, arm.T_last_tip, q[:, :na].copy(), goal, limits / limits.max())


@njit
def _reaching(placements: Array, axes: Array, T_last_tip: Array, q: Array, goal: Array, weight: Array) -> Array:
    """Postures q (m, na) moved to tip positions goal (m, 3) by Newton's method, joints weighted by weight (na)."""
    near = q.copy()
    m, na = q.shape
    off, A = np.empty((m, 3)), np.empty((3, 3))
    for _ in range(_NEWTON_STEPS):
        poses = chain_poses(placements, axes, T_last_tip, near)
        furthest = 0.0
        for i in range(m):
            for k in range(3):
                off[i, k] = goal[i, k] - poses[i, k, 3]
                furthest = max(furthest, abs(off[i, k]))
        if furthest < _REACHED:
            break
        jacobians = chain_jacobians(placements, axes, T_last_tip, near)
        for i in range(m):
            J, b = jacobians[i], off[i]
            for k in range(3):
                for n in range(3):
                    A[k, n] = _DAMPING if k == n else 0.0
                    for j in range(na):
                        A[k, n] += J[k, j] * weight[j] * J[n, j]
            solve_symmetric(A, b)
            for j in range(na):
                near[i, j] += weight[j] * (J[0, j] * b[0] + J[1, j] * b[1] + J[2, j] * b[2])
    return near


def lifted_over(cell: Cell, ends: Ends, room: TravelClearance, raised: float, through: str) -> list[Array]:
    """Postures (nj) of a travel that is lifted along the normal, crosses by `POSTURES[through]`, and is lowered."""
    na = len(cell.arm)
    both = np.stack([ends.start.q, ends.end.q])
    a, b = np.hstack([lifted(cell, both, room, raised), both[:, na:]])
    return [a, *POSTURES[through](cell, a, b), b]


def resting_at(cell: Cell, ends: Ends, vias: Sequence[Array], speed: float, caps: Caps) -> Built | None:
    """A way that rests at postures (nj); moves between them are slow enough for the tip to keep to `speed` [m/s]."""
    bounds = ends.bounds.capped(caps.along)
    states = [ends.start, *(at_rest(via) for via in vias), ends.end]
    moves = [below_tip_speed(cell, bounds, a, b, speed) for a, b in itertools.pairwise(states)]
    motion = waiting(moves, ends.least)
    return None if motion is None else Built(motion)


def below_tip_speed(cell: Cell, bounds: Bounds, start: JointState, end: JointState, speed: float) -> Cubics | None:
    """The quickest move from state to state whose tip is no faster than `speed` [m/s], or close to that."""
    move = between(bounds, start, end)
    for _ in range(_SLOWER_TRIES):
        if move is None:
            break
        over = glance(cell, move).tip_speed / speed
        if over <= 1.0:
            break
        move = between(bounds.capped(np.maximum(extremes(move).velocity / over, SLOWEST)), start, end)
    return move


def at_rest(q: Array) -> JointState:
    """The state of rest at posture q (nj)."""
    return JointState(q, np.zeros_like(q), np.zeros_like(q))


def waiting(pieces: Sequence[Cubics | None], least: float) -> Cubics | None:
    """Pieces end to end, at rest in between; time missing to the least duration [s] is spent waiting at the first rest.

    None if any piece is missing.
    """
    known = [piece for piece in pieces if piece is not None]
    if len(known) < len(pieces):
        return None
    wait = least - sum(piece.duration for piece in known)
    if wait > 0.0:
        known.insert(1, rest(known[0].end.q, wait))
    return chain(known)


def _drawn_back(cell: Cell, q: Array) -> Array:
    back = q.copy()
    lower = 1 + cell.rails
    back[lower] = max(q[lower] - DRAW_BACK, cell.limits.q_min[lower])
    return back


def _home(cell: Cell, b: Array) -> Array:
    return np.concatenate([cell.home[: len(cell.arm)], b[len(cell.arm) :]])


# Postures between two lifted ones at which a way across rests; the quickest first.
POSTURES = {
    "straight": lambda cell, a, b: [],
    "drawn back at the start": lambda cell, a, b: [_drawn_back(cell, a)],
    "drawn back at the end": lambda cell, a, b: [_drawn_back(cell, b)],
    "drawn back": lambda cell, a, b: [_drawn_back(cell, a), _drawn_back(cell, b)],
    "home": lambda cell, a, b: [_home(cell, b)],
    "drawn back and home": lambda cell, a, b: [_drawn_back(cell, a), _home(cell, b), _drawn_back(cell, b)],
}
