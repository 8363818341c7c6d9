"""Moves that show what each joint can do: one joint after another, within the space that is free around a posture.

Short moves end before the acceleration is reached and show the jerk, longer ones the acceleration, the longest the
speed. Each joint goes from one end of its free space, out and back over distances that double, at full speed; then some
of the way at shares of it. Rests between the moves tell them apart in a recording.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from planner.base.arrays import Array
from planner.base.errors import InputError
from planner.cell.cell import Cell
from planner.collision.scene import Obstacles
from planner.motion.travel.clearance import SWEPT
from planner.problem import Problem

# Least and greatest length of moves: of joints that turn [rad], and of those that slide [m]. At 0.5 degrees an arm with
# 15 rad/s² and 750 rad/s³ is limited by its jerk alone. In longer moves a jerk only rounds corners by less than a noise of
# 0.01 degrees, in shorter ones noise counts for more: so several short ones are made, each some times.
SHORTEST = (np.radians(0.25), 1e-3)
SHORT = 5.0  # times the shortest: moves up to that are repeated
REPEATS = 3
USUAL_MOST = (np.radians(180.0), 1.0)
END_ROOM = (np.radians(2.0), 10e-3)  # from the ends of joints' ranges
LEAST_SPACE = 8.0  # of the shortest moves: a joint with less shows nothing, and is left out
SLOW_SHARES = (0.5, 0.25)  # of the joint's speed, at which it goes by that share of the whole way as well
REST = 0.5  # s between moves: servos settle, and a recording shows that all joints stand
JOINT_REST = 1.0  # s before another joint's moves
END = "the end of its range"
CLEAR = 2e-3  # m of clearance beyond what is needed from which nothing more is looked at


@dataclass(frozen=True)
class FreeSpace:
    """How far a joint may move alone while all others stand at the start posture.

    low, high  ends, in the joint's own places [rad, m]
    bounds     what ends it, in words, at low and at high
    """

    low: float
    high: float
    bounds: tuple[str, str]


@dataclass(frozen=True)
class AskedMove:
    """A joint (its index) goes from one place to another [rad, m] at a share of its speed, the others stand."""

    joint: int
    start: float
    end: float
    share: float


@dataclass(frozen=True)
class AskedMoves:
    """What a test program asks of a cell's joints (n): from a start posture (n) one move after another, and back there.

    asked   limits of speed, acceleration, jerk (n each) that the program itself sets [rad, m]; None where the controller
            takes its own
    signs, offsets (n)   the controller's joints are signs * q + offsets [rad, m]
    """

    problem: str
    language: str
    joint_names: tuple[str, ...]
    sliding: tuple[int, ...]
    start: Array
    moves: tuple[AskedMove, ...]
    asked: tuple[Array | None, Array | None, Array | None]
    signs: Array
    offsets: Array

    @property
    def postures(self) -> Array:
        """Where the joints rest (m + 1, n): at the start, and after each of m moves."""
        out = np.tile(self.start, (len(self.moves) + 1, 1))
        for k, move in enumerate(self.moves, 1):
            out[k:, move.joint] = move.end
        return out

    @property
    def rests(self) -> Array:
        """How long they rest (m + 1) [s] there."""
        joints = np.array([move.joint for move in self.moves])
        changes = np.concatenate([np.ones(1, bool), np.diff(joints) != 0, np.ones(1, bool)])
        return np.where(changes, JOINT_REST, REST)


def start_posture(cell: Cell, given: Sequence[float] | None) -> Array:
    """The posture (n) [rad, m] from values in degrees, and mm of joints that slide; home where none are given.

    Raises InputError for another number of them, and for one that is outside its joint's range.
    """
    if given is None:
        return cell.home.copy()
    names = cell.joint_names
    if len(given) != len(names):
        raise InputError(f"{len(given)} values for {len(names)} joints", field="--start", hint=", ".join(names))
    q = np.asarray(given, dtype=np.float64) * _units(cell)
    outside = (q < cell.limits.q_min) | (q > cell.limits.q_max)
    if outside.any():
        j = int(np.argmax(outside))
        low, high = np.array([cell.limits.q_min[j], cell.limits.q_max[j]]) / _units(cell)[j]
        raise InputError(f"{names[j]} is outside its range", field="--start", hint=f"{low:.0f} to {high:.0f}")
    return q


def greatest_lengths(cell: Cell, given: Sequence[float] | None) -> Array:
    """How long each joint's space may be (n) [rad, m] from one value for all in degrees, or one for each joint; mm where
    it slides. Raises InputError for another number of them."""
    n = len(cell.joint_names)
    usual = np.where(cell.limits.turns, *USUAL_MOST)
    if given is None:
        return usual
    if len(given) == 1:
        return np.where(cell.limits.turns, np.radians(given[0]), usual)
    if len(given) != n:
        raise InputError(f"{len(given)} values for {n} joints", field="--most", hint=", ".join(cell.joint_names))
    return np.asarray(given, dtype=np.float64) * _units(cell)


def free_spaces(cell: Cell, obstacles: Obstacles, start: Array, most: Array) -> tuple[FreeSpace, ...]:
    """The space of each joint around a start posture (n): clear of all that is in the cell, the finished print too.

    most (n)  greatest length of each space [rad, m]
    Raises InputError where the start posture itself is not clear.
    """
    _check_start(obstacles, start)
    return tuple(_space(cell, obstacles, start, j, float(most[j])) for j in range(len(start)))


def asked_moves(
    problem: Problem, cell: Cell, start: Array, spaces: Sequence[FreeSpace], controlled: tuple[str, Array, Array]
) -> AskedMoves:
    """The moves of a test program; those of joints without enough space are left out.

    controlled  language, and signs and offsets (n each) of its controller's joints
    Raises InputError where no joint has space enough.
    """
    moves: list[AskedMove] = []
    for j, space in enumerate(spaces):
        if moves_enough(cell, j, space):
            moves += _joint_moves(j, float(start[j]), space, SHORTEST[int(not cell.limits.turns[j])])
    if not moves:
        raise InputError("no joint has space to move: choose another posture", field="--start")
    language, signs, offsets = controlled
    limits = cell.limits
    own = {"urscript": (True, True, False), "joint_trajectory": (True, True, True)}.get(language, (False, False, False))
    values = (limits.velocity, limits.acceleration, limits.jerk)
    speed, acceleration, jerk = (value if is_asked else None for value, is_asked in zip(values, own, strict=True))
    return AskedMoves(
        problem=problem.name,
        language=language,
        joint_names=cell.joint_names,
        sliding=limits.sliding,
        start=start,
        moves=tuple(moves),
        asked=(speed, acceleration, jerk),
        signs=signs,
        offsets=offsets,
    )


def moves_enough(cell: Cell, j: int, space: FreeSpace) -> bool:
    """Whether a joint has space enough to show anything."""
    return space.high - space.low >= LEAST_SPACE * SHORTEST[int(not cell.limits.turns[j])]


def _joint_moves(j: int, home: float, space: FreeSpace, shortest: float) -> list[AskedMove]:
    whole = space.high - space.low
    # the last of the distances that double is the whole space, unless that is hardly more than the one before
    count = int(np.log2(whole / shortest) - 0.5)
    distances = [*(shortest * 2.0**k for k in range(count + 1)), whole]
    distances = [each for each in distances for _ in range(REPEATS if each <= SHORT * shortest else 1)]
    out = [AskedMove(j, home, space.low, 1.0)] if home - space.low > 0.5 * shortest else []
    base = out[-1].end if out else home
    for distance, share in [*((each, 1.0) for each in distances), *((share * whole, share) for share in SLOW_SHARES)]:
        there = min(base + distance, space.high)
        out += [AskedMove(j, base, there, share), AskedMove(j, there, base, share)]
    return [*out, AskedMove(j, base, home, 1.0)] if base != home else out


def _check_start(obstacles: Obstacles, start: Array) -> None:
    margin, which = obstacles.margins(start[None], np.array([np.inf]), CLEAR)
    if margin[0] < 0.0:
        one, other = obstacles.names(int(which[0]))
        raise InputError(
            f"{one} and {other} lack {-1e3 * margin[0]:.1f} mm of their clearance at the start posture",
            field="--start",
            hint="choose another posture",
        )


def _space(cell: Cell, obstacles: Obstacles, start: Array, j: int, most: float) -> FreeSpace:
    slides = int(not cell.limits.turns[j])
    low, high = cell.limits.q_min[j] + END_ROOM[slides], cell.limits.q_max[j] - END_ROOM[slides]
    ways = [
        _way(obstacles, start, j, min(most, float(room)), sign)
        for room, sign in ((start[j] - low, -1.0), (high - start[j], 1.0))
    ]
    # both sides alike, what one of them lacks added to the other
    below = min(ways[0][0], max(0.5 * most, most - ways[1][0]))
    above = min(ways[1][0], most - below)
    bounds = [
        "as far as asked" if length < way or way == most else words
        for (way, words), length in zip(ways, (below, above), strict=True)
    ]
    return FreeSpace(float(start[j]) - below, float(start[j]) + above, (bounds[0], bounds[1]))


def _way(obstacles: Obstacles, start: Array, j: int, room: float, sign: float) -> tuple[float, str]:
    """How far a joint may go to one side, up to some room [rad, m], and what ends it there."""
    if room <= 0.0:
        return 0.0, END
    if not obstacles.any:
        return room, END
    # no point of the cell moves by more than SWEPT from one posture to the next, so half of that must be to spare
    offsets = np.linspace(0.0, room, max(int(np.ceil(room * float(obstacles.swing[j]) / SWEPT)), 1) + 1)
    q = np.tile(start, (len(offsets), 1))
    q[:, j] += sign * offsets
    margin, which = obstacles.margins(q, np.full(len(q), np.inf), CLEAR)
    blocked = np.flatnonzero(margin < 0.5 * SWEPT)
    if not len(blocked):
        return room, END
    first = int(blocked[0])
    return float(offsets[max(first - 1, 0)]), " near ".join(obstacles.names(int(which[first])))


def _units(cell: Cell) -> Array:
    """Degrees, and mm of joints that slide, in rad and m (n)."""
    return np.where(cell.limits.turns, np.pi / 180.0, 1e-3)
