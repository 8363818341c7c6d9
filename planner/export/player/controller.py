"""Postures of a program: joints at and between its targets, by the configuration of each target."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from planner.base.arrays import Array, Flags, Indices
from planner.base.errors import InputError
from planner.export.arcs import segments
from planner.export.external import external_axes, external_read
from planner.export.fit import angle, from_matrix, lerp, slerp, to_matrix
from planner.export.program import RobotProgram

if TYPE_CHECKING:
    from planner.cell.cell import Cell

# Joints are interpolated between knots. On an arm of 0.3 m, a path STEP long leaves its chord by 4 um; where the nozzle
# turns by TURN, the tip of a nozzle of 0.15 m does so by 6 um.
STEP = 3e-3  # [m]
TURN = np.radians(1.0)
BEND = np.radians(10.0)  # of an arc, whose chord then leaves it by a thousandth of the radius
JUMP = 0.3  # [rad] between neighbouring knots of a line; beyond, another configuration may be nearer
QUARTER = 0.5 * np.pi
BORDER = 1e-4  # [rad] by which a joint may lie beyond the quarter that a target names, as targets are rounded
ROUNDED = 1e-6  # [rad] by which rounding turns targets; divided by the sine of axis 5, it is what axes 4 and 6 turn by
STRAIGHT = 1e-5  # [rad] of axis 5; below, a target leaves open how axes 4 and 6 share their sum
HELD = np.radians(0.01)  # by which a target's value for a held axis of the station may be off
BLOCK = 20_000  # poses whose postures are computed at once: bounds the memory
SAME = 1e-6  # [rad] between a posture and the same one computed again
REVOLUTION = 2.0 * np.pi


@dataclass(frozen=True)
class PostureKnots:
    """k postures that the robot passes through, with straight joint motion between them.

    q         (k, n) joints in the cell's order
    position, quat  (k, 3) [m], (k, 4) x y z w: pose of the program's tool in its work object
    move      (k - 1) the move that the way to the next knot belongs to
    target    (m) the knot that is the target of each move
    strays    moves whose final posture does not have the configuration that the target names
    """

    q: Array
    position: Array
    quat: Array
    move: Indices
    target: Indices
    strays: tuple[int, ...]


def _check(program: RobotProgram, cell: Cell) -> None:
    """Raise InputError for configurations that the arm does not have, and for moves without a speed."""
    if len(cell.given) > cell.rails:
        raise _error(
            program, f"targets do not give the posture of {cell.arm_robot.name}, which has {len(cell.arm)} joints"
        )
    outside = np.flatnonzero((program.conf[:, 3] < 0) | (program.conf[:, 3] >= cell.inverse.branch_count))
    if len(outside):
        raise _error(
            program, f"move {outside[0]} names configuration {program.conf[outside[0], 3]}, which does not exist"
        )
    speeds = program.speed[:, [0, 1, 3]]
    without = np.flatnonzero(~(np.isfinite(speeds) & (speeds > 0.0)).all(axis=1))
    if len(without):
        raise _error(program, f"move {without[0]} has no speed")


def knots_of(program: RobotProgram, cell: Cell) -> PostureKnots:
    """Postures along a program.

    Lines are followed in the work object, continuously, in the configuration of their target, as with `ConfL\\Off`: if
    that is not reached continuously, the nearest one is taken. Joint moves go straight to the configuration and the
    quarter turns of their target, as with `ConfJ\\On`.

    Raises InputError if a target cannot be reached in its configuration, for axes that the cell does not have, and for
    moves without a speed.
    """
    m, six = len(program.linear), len(cell.solved)
    _check(program, cell)
    frames = _Frames(program, cell)
    beside = frames.free(program.start[None, six:])[0]
    begin = np.concatenate([beside[: cell.rails], program.start[:six], beside[cell.rails :]])
    if not np.isfinite(begin).all():
        raise _error(program, "the start does not give the position of every joint")
    p0, quat0 = frames.pose(begin[None])
    ends = np.vstack([beside[None], frames.free(program.external)])
    position, quat = np.vstack([p0, program.position]), np.vstack([quat0, program.quat])

    ways = segments(position[:-1], program.via, position[1:], program.circular)
    length = np.maximum(ways.length / STEP, ways.swept / BEND)
    turned = np.maximum(angle(quat[1:], quat[:-1]), np.abs(np.diff(ends, axis=0)).max(axis=1, initial=0.0)) / TURN
    parts = np.where(program.linear, np.ceil(np.maximum(length, turned) - 1e-9), 1).clip(1).astype(np.intp)
    move = np.repeat(np.arange(m), parts)
    target = np.cumsum(parts)
    u = (np.arange(len(move)) - np.repeat(target - parts, parts) + 1) / parts[move]
    knots = _Poses(
        ways.take(move).at(u),
        slerp(quat[move], quat[move + 1], u),
        lerp(ends, move, move + 1, u),
    )
    q = _followed(program, cell, frames, knots, move, begin)
    all_p, all_quat = np.vstack([p0, knots.position]), np.vstack([quat0, knots.quat])
    strays = _strays(program, cell, q[target])
    return _with_joint_moves(program, frames, PostureKnots(q, all_p, all_quat, move, target, strays))


class _Frames:
    """A program's frames: where its targets lie for the arm."""

    def __init__(self, program: RobotProgram, cell: Cell) -> None:
        self._program, self._cell = program, cell
        on_plate = np.linalg.inv(cell.T_plate_part) if program.station else np.linalg.inv(cell.T_world_holder)
        self._T_part_object = on_plate @ _matrix(program.uframe) @ _matrix(program.oframe)
        self._T_tool_flange = np.linalg.inv(_matrix(program.tool))

    def free(self, external: Array) -> Array:
        """Free axes (m, f) of the arm's carrier and then the station, from all external axes (m, 6); held axes must be
        where they are held."""
        axes = external_axes(self._cell)
        table = external_read(self._cell, external)
        missing = np.flatnonzero(~np.isfinite(table).all(axis=1))
        if len(missing):
            raise _error(self._program, f"target {missing[0]} does not give the position of every axis of the station")
        for k, axis in enumerate(axes):
            if axis.held is not None and (np.abs(table[:, k] - axis.held) > HELD).any():
                raise _error(self._program, f"axis {axis.name} of the station is held, and the program moves it")
        return table[:, [k for k, axis in enumerate(axes) if axis.held is None]]

    def flange(self, poses: _Poses) -> Array:
        """Flange poses T_base_flange (k, 4, 4)."""
        T = np.zeros((len(poses.position), 4, 4))
        T[:, :3, :3], T[:, :3, 3], T[:, 3, 3] = to_matrix(poses.quat), poses.position, 1.0
        held = np.ascontiguousarray(poses.external[:, self._cell.rails :])
        T_base_part = np.linalg.inv(self._cell.T_world_base) @ self._cell.holder.poses(held)
        out: Array = T_base_part @ (self._T_part_object @ T @ self._T_tool_flange)
        return out

    def solve(self, poses: _Poses) -> tuple[Array, Flags]:
        """Postures (k, branches, na) of the arm, with its carrier where the targets say, and which of them exist."""
        given = poses.external[:, : self._cell.rails] if self._cell.rails else None
        return self._cell.inverse.solve(self.flange(poses), given)

    def pose(self, q: Array) -> tuple[Array, Array]:
        """Position (k, 3) and orientation (k, 4) of the program's tool in its work object."""
        T_nozzle_tool = np.linalg.inv(self._T_tool_flange @ self._cell.T_flange_nozzle)
        T = np.linalg.inv(self._T_part_object) @ self._cell.T_part_nozzle(np.ascontiguousarray(q)) @ T_nozzle_tool
        return T[:, :3, 3], from_matrix(T[:, :3, :3])


@dataclass(frozen=True)
class _Poses:
    """k poses of the tool in the work object, and the free external axes there."""

    position: Array
    quat: Array
    external: Array

    def rows(self, rows: slice) -> _Poses:
        return _Poses(self.position[rows], self.quat[rows], self.external[rows])


def _followed(program: RobotProgram, cell: Cell, frames: _Frames, knots: _Poses, move: Indices, begin: Array) -> Array:
    """Joints (k + 1, n) of the start and of all knots on lines and at targets."""
    na, k = len(cell.arm), len(move)
    raw = np.empty((k, na))
    branch = program.conf[move, 3]
    for first in range(0, k, BLOCK):
        rows = slice(first, first + BLOCK)
        solutions, exists = frames.solve(knots.rows(rows))
        raw[rows] = _chosen(program, solutions, exists, branch[rows], move[rows])
    raw = np.vstack([begin[:na], raw])
    line = np.concatenate([[False], program.linear[move]])  # whether the way to the knot is a line
    if cell.spherical:
        _share_straight_wrists(program, raw[:, cell.own], np.flatnonzero(~line[1:]) + 1, move)
    _keep_continuous(raw, line, lambda i: frames.solve(knots.rows(slice(i - 1, i))))
    turns = np.zeros_like(raw)
    turns[1:] = -np.round(np.diff(raw, axis=0) / REVOLUTION)
    turns[~line] = 0.0
    turns[:, ~cell.limits.turns[:na]] = 0.0
    since = np.maximum.accumulate(np.where(line, 0, np.arange(k + 1)))  # the knot from which lines lead to this one
    added = np.cumsum(turns, axis=0)
    absolute = np.zeros_like(raw)
    at = np.flatnonzero(~line)
    absolute[at[1:], cell.own] = _named_turns(program, cell, raw[at[1:], cell.own], move[at[1:] - 1])
    q = raw + REVOLUTION * (absolute[since] + added - added[since])
    return np.column_stack([q, np.vstack([begin[None, na:], knots.external[:, cell.rails :]])])


def _chosen(program: RobotProgram, solutions: Array, exists: Flags, branch: Indices, move: Indices) -> Array:
    """The solutions (k, n) of the branches that targets name."""
    row = np.arange(len(branch))
    missing = np.flatnonzero(~exists[row, branch])
    if len(missing):
        i = missing[0]
        raise _error(program, f"move {move[i]} is out of reach in configuration {branch[i]}")
    out: Array = solutions[row, branch]
    return out


def _share_straight_wrists(program: RobotProgram, raw: Array, ends: Indices, move: Indices) -> None:
    """Where the wrist is straight at the end of a joint move, put axis 4 where it was at the start, within its quarter.

    Only the sum of axes 4 and 6 follows from such a target; home is the usual one.
    """
    straight = ends[np.abs(raw[ends, 4]) < STRAIGHT]
    low = program.conf[move[straight - 1], 1] * QUARTER
    fourth = np.clip(raw[0, 3], low, low + QUARTER)
    raw[straight, 5] = _wrapped(raw[straight, 3] + raw[straight, 5] - fourth)
    raw[straight, 3] = fourth


def _keep_continuous(raw: Array, line: Flags, solve: Callable[[int], tuple[Array, Flags]]) -> None:
    """Where joints jump on a line, take the nearest posture instead until it is the named one again."""
    jumps = np.abs(_wrapped(np.diff(raw, axis=0))).max(axis=1) > JUMP
    done = 0
    for first in (np.flatnonzero(line[1:] & jumps) + 1).tolist():
        i = max(first, done)
        while i < len(raw) and line[i]:
            solutions, exists = solve(i)
            far = np.abs(_wrapped(solutions[0] - raw[i - 1])).max(axis=1)
            nearest = solutions[0, int(np.argmin(np.where(exists[0], far, np.inf)))]
            if np.abs(nearest - raw[i]).max() < SAME:
                break
            raw[i] = nearest
            i += 1
        done = i


def _wrapped(angles: Array) -> Array:
    out: Array = angles - REVOLUTION * np.round(angles / REVOLUTION)
    return out


def _named_turns(program: RobotProgram, cell: Cell, raw: Array, move: Indices) -> Array:
    """Whole turns (k, n) to add to joints in (-pi, pi]: by the targets' joints or quarters, else by joint ranges."""
    limits = cell.limits
    if program.joints is not None:
        turns: Array = np.round((program.joints[move] - raw) / REVOLUTION)
        return turns
    middle = np.tile(0.5 * (limits.q_min + limits.q_max)[cell.own], (len(raw), 1))
    if cell.spherical:
        middle[:, [0, 3, 5]] = (program.conf[move, :3] + 0.5) * QUARTER
    out: Array = np.round((middle - raw) / REVOLUTION)
    return out


def _strays(program: RobotProgram, cell: Cell, q: Array) -> tuple[int, ...]:
    """Moves whose posture at the target, q (m, n), does not have the configuration that the target names."""
    if not cell.spherical:
        return ()
    own = q[:, cell.own]
    bent = np.abs(own[:, 4])
    wrong = (cell.inverse.branches(q[:, : len(cell.arm)]) != program.conf[:, 3]) & (bent > BORDER)
    low = program.conf[:, :3] * QUARTER
    over = np.maximum(low - own[:, [0, 3, 5]], own[:, [0, 3, 5]] - low - QUARTER)
    unsure = np.minimum(BORDER + ROUNDED / np.maximum(np.sin(bent), STRAIGHT), QUARTER)
    wrong |= (over[:, 0] > BORDER) | (over[:, 1:] > unsure[:, None]).any(axis=1)
    return tuple(np.flatnonzero(wrong).tolist())


def _with_joint_moves(program: RobotProgram, frames: _Frames, ends: PostureKnots) -> PostureKnots:
    """The knots, with further ones on the straight line in joint space between those that joint moves connect."""
    change = np.abs(np.diff(ends.q, axis=0)).max(axis=1)
    parts = np.where(program.linear[ends.move], 1, np.ceil(change / TURN).clip(1)).astype(np.intp)
    owner = np.repeat(np.arange(len(parts)), parts)
    after = np.cumsum(parts)
    u = (np.arange(len(owner)) - np.repeat(after - parts, parts) + 1) / parts[owner]

    def spread(values: Array) -> Array:
        return np.vstack([values[:1], lerp(values, owner, owner + 1, u)])

    q, position, quat = spread(ends.q), spread(ends.position), np.vstack([ends.quat[:1], ends.quat[owner + 1]])
    inner = np.flatnonzero(u < 1.0) + 1
    position[inner], quat[inner] = frames.pose(q[inner])
    return PostureKnots(q, position, quat, ends.move[owner], after[ends.target - 1], ends.strays)


def _matrix(frame: Array) -> Array:
    """Pose (4, 4) of x y z [m] and a quaternion x y z w (7)."""
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = to_matrix(frame[None, 3:])[0], frame[:3]
    return T


def _error(program: RobotProgram, reason: str) -> InputError:
    return InputError(reason, file=program.module)
