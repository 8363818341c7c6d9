"""Obstacles: every body that may touch in a cell, the distances to keep, and all of it as numbers for kernels."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from planner.base.arrays import Array, Flags, Ints
from planner.base.errors import InputError
from planner.base.processes import in_blocks
from planner.cell.cell import Cell, rigid_inverse
from planner.cell.kinematics.chain import Chain, joint_move
from planner.cell.robot import Robot, joint_axis
from planner.cell.solids import SIZES, Body, Capsule, Frustum, Hull, Mesh, Solid, in_touch, packed
from planner.collision.margins import hit_along, lacking_at, least_margins
from planner.collision.point_tree import PointTree, point_tree
from planner.collision.print_body import (
    CORNER_AREA,
    MERGED,
    TIP_SLOPE,
    PrintBody,
    TipRoom,
    merged,
    print_body,
    split,
    standing,
    tip_room,
    without_slivers,
)
from planner.collision.table import Table, with_fields
from planner.problem import Problem
from planner.toolpath.bead import Toolpath

# ----------------------------------------------------------------------------------------------------
# Points that stand for a surface: no solid that keeps its clearance from them comes nearer to the surface.

_SPACING = 2e-3  # m, longest side of a triangle whose corners stand for it
_MOST = 100_000  # points, roughly: on larger surfaces they are farther apart


def surface_points(triangles: Array, clearance: float) -> tuple[Array, Array]:
    """Points (n, 3) all over triangles (m, 3, 3) [m], and the radii (n) that make up for the gaps between them.

    clearance: the least distance required of them [m]; at less than that, the surface may be nearer than they suggest.
    """
    across = np.linalg.norm(np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]), axis=1)
    side = max(_SPACING, float(np.sqrt(0.5 * across.sum() / (_MOST * CORNER_AREA))))
    pieces = split(without_slivers(np.ascontiguousarray(triangles, dtype=float), side), side)
    points, spread = merged(pieces, MERGED * side)
    return points, np.hypot(clearance, spread) - clearance


# ----------------------------------------------------------------------------------------------------
# Bodies of a cell as obstacles: which frame each moves with, whose it is, and which may touch.

_ON_AXIS = 1e-9  # m, and share of a direction's length: this close to an axis counts as on it
ARM, HEAD, HOLDER, FIXTURE, CARRIED = range(5)


@dataclass(frozen=True)
class CollisionBody:
    """A body, its pose in its frame's coordinates, and whose it is; link: of its robot, 0 for the base."""

    body: Body
    frame: int
    whose: int
    link: int = 0


def collision_bodies(cell: Cell) -> list[CollisionBody]:
    """All bodies of a cell; convex meshes as hulls."""
    na, nh = len(cell.arm), len(cell.holder)
    out = []
    for i, (frame, body) in enumerate(_carried_by(cell.arm_robot, cell.arm, cell.T_world_base, {}, 0)):
        out += [CollisionBody(each, frame, ARM, i) for each in body]
    out += [CollisionBody(_moved(body, cell.arm.T_last_tip), na, HEAD, na) for body in cell.head]
    if cell.holder_robot is not None:
        links = _carried_by(cell.holder_robot, cell.holder, cell.T_world_holder_base, cell.held, na)
        for i, (frame, body) in enumerate(links):
            out += [CollisionBody(each, frame, HOLDER, i) for each in body]
    out += [CollisionBody(body, 0, FIXTURE) for body in cell.fixtures]
    last = 0 if cell.holder_robot is None else cell.holder_robot.model.njoints - 1
    part = na + nh if nh else 0
    out += [CollisionBody(_moved(body, cell.holder.T_last_tip), part, CARRIED, last) for body in cell.carried]
    return [replace(thing, body=_filled(thing.body)) for thing in out]


def _carried_by(
    robot: Robot, chain: Chain, T_world_base: Array, held: dict[str, float], before: int
) -> list[tuple[int, list[Body]]]:
    """For each joint of a robot's model, its base first, the frame that carries its bodies, and these in that frame."""
    model, bodies = robot.model, robot.bodies
    frame, T = 0, T_world_base
    out = [(0, [_moved(body, T) for body in bodies[0]])]
    found = 0
    for i in range(1, model.njoints):
        name = model.names[i]
        if name in chain.names:
            found += 1
            frame, T = before + found, np.eye(4)
        else:
            T = T @ model.jointPlacements[i].homogeneous @ joint_move(joint_axis(model, i), held[name])
        out.append((frame, [_moved(body, T) for body in bodies[i]]))
    return out


def _moved(body: Body, T: Array) -> Body:
    return replace(body, T_frame_solid=T @ body.T_frame_solid)


def _filled(body: Body) -> Body:
    """The body, as a hull if it is a mesh that fills its hull."""
    hull = body.solid.filled if isinstance(body.solid, Mesh) else None
    return body if hull is None else replace(body, solid=hull)


def may_touch(a: CollisionBody, b: CollisionBody, last: int) -> bool:
    """Whether two bodies have to be kept apart: not if they move together, or are neighbouring links."""
    if a.frame == b.frame:
        return False
    whose = {a.whose, b.whose}
    if whose in ({ARM}, {HOLDER}):
        low, high = (a, b) if a.link < b.link else (b, a)
        return high.link - low.link + low.body.below > 1 and not in_touch(a.body, b.body)
    if whose == {ARM, HEAD}:
        return min(a.link, b.link) < last
    return True


def is_round(body: Body, T_frame_nozzle: Array) -> bool:
    """Whether a body looks the same however it is turned about the nozzle's axis."""
    T = rigid_inverse(T_frame_nozzle) @ body.T_frame_solid
    on_axis = np.allclose(T[:2, 2:], 0.0, rtol=0.0, atol=_ON_AXIS)
    return isinstance(body.solid, Capsule | Frustum) and bool(on_axis)


def looked_at(a: CollisionBody, b: CollisionBody, part_frame: int) -> bool:
    """Whether a pair is the head and a body fixed in the part frame: the latter is among the part's points."""
    other = b if a.whose == HEAD else a
    return HEAD in (a.whose, b.whose) and other.frame == part_frame and other.whose != ARM


# ----------------------------------------------------------------------------------------------------
# Obstacles: everything that may touch in a cell, and the distances to keep.

PART = "part or print"
BLOCK = 1024  # postures along which pairs that were far enough apart are remembered
_FAR = 0.2  # m: greater margins are not distinguished along a motion
_SAME_MARGIN = 1e-4  # m: margins that differ by more are of different bodies
_POSTURES = 64  # postures: a pair of a robot's own bodies that is too close at all of them is built that way
_EVERYWHERE, _FINEST = 1024, 128  # most postures of the holder at which its own bodies are checked, in all and per axis
_OF_LOOKS = ("look", "keep", "head_on_part", "round_on_part")  # fields of the table with a row for each look
_BUILT = 5e-3  # m that pairs keep which cannot be as far apart as required; the default of collision.arm_mm


@dataclass(frozen=True)
class Around:
    """What obstacles are made of besides the cell.

    nozzle, arm   clearances of head and robots [m]
    room          what the head need not keep near the tip (n beads)
    part, body    points of part, print and bodies fixed in the part frame, in this frame; what they belong to
    meshes        those of the cell that do not fill their hulls, with points in their own frames
    """

    nozzle: float
    arm: float
    room: TipRoom
    part: PointTree
    body: PrintBody | None = None
    meshes: tuple[tuple[Mesh, PointTree], ...] = ()


@dataclass(frozen=True)
class Obstacles:
    """Everything that may touch: numbers for the kernels, names of its bodies and of its trees of points.

    slide_to (nj): how far from 0 sliding joints can go [m]
    head_counts: whether a search checks the head against part and print even where the nozzle may lean
    """

    table: Table
    bodies: tuple[str, ...]
    trees: tuple[str, ...]
    around: Around | None
    slide_to: tuple[float, ...] = ()
    head_counts: bool = False

    @property
    def any(self) -> bool:
        """Whether anything may touch."""
        return len(self.table.pair) + len(self.table.look) > 0

    @property
    def but_head_on_part(self) -> Obstacles:
        """Without the head's clearance from part and print, which tilt may provide; unchanged if `head_counts`."""
        return self if self.head_counts else self._looking(~self.table.head_on_part)

    @property
    def counting_head(self) -> Obstacles:
        """The same for a search that keeps the head clear by itself, not relying on tilt."""
        return replace(self, head_counts=True)

    @cached_property
    def but_round_on_part(self) -> Obstacles:
        """Without the clearance from part and print of bodies round about the nozzle's axis: only tilt changes it."""
        return self._looking(~self.table.round_on_part)

    @cached_property
    def but_arm(self) -> Obstacles:
        """Only pairs that no joint of the arm moves: what the holder's axes bring close, whatever the arm does."""
        table, na = self.table, int(self.table.arm[0])
        still = (table.frame == 0) | (table.frame > na)
        looks = still[table.look[:, 0]] & ((table.tree_frame == 0) | (table.tree_frame > na))[table.look[:, 1]]
        kept = np.append(still[table.pair].all(axis=1), looks)
        return replace(self, table=_only(table, np.flatnonzero(kept)))

    def _looking(self, kept: Flags) -> Obstacles:
        pairs = len(self.table.pair)
        return replace(self, table=_only(self.table, np.append(np.arange(pairs), pairs + np.flatnonzero(kept))))

    def of(self, cell: Cell) -> Obstacles:
        """The same obstacles in a cell whose holder or part is elsewhere."""
        return self if self.around is None else replace(_assembled(cell, self.around), head_counts=self.head_counts)

    def for_nozzle(self, cell: Cell, own: Cell) -> Obstacles:
        """These obstacles, which are those of `cell`, for its `own` cell, which has another nozzle in use."""
        return self if own is cell else self.of(own)

    def with_nozzle_at(self, cell: Cell, nozzle: float) -> Obstacles | None:
        """The same with nozzle and head keeping this distance [m], if that is less than they keep now; else None."""
        if self.around is None or nozzle >= self.around.nozzle:
            return None
        return _assembled(cell, replace(self.around, nozzle=nozzle, meshes=()))

    def standing(self, cell: Cell, q: Array, now: float, margin: float) -> tuple[str, ...]:
        """Names of the bodies fixed in the part frame, if it is one of them, not part or print, that leaves a posture
        q (nj) so little margin [m] at a time of the print; else none."""
        around = self.around
        if around is None or around.body is None or not around.body.bodies:
            return ()
        alone = _assembled(cell, replace(around, part=around.body.without_bodies.tree))
        without, _ = alone.margins(q[None], np.array([now]), np.inf)
        return around.body.names[: around.body.bodies] if without[0] > margin + _SAME_MARGIN else ()

    def margins(self, q: Array, now: Array, enough: float, more: float = 0.0) -> tuple[Array, Ints]:
        """Least clearance (n) beyond what is needed at postures q (n, nj) at times of the print now (n), if below
        `enough` [m]; and which pair (n) has it, or -1. `more` [m] is required between bodies in addition.

        Raises InputError for other shapes: compiled code would read beyond their ends.
        """
        margin, which = np.full(len(q), enough), np.full(len(q), -1, dtype=np.int64)
        if self.any:
            q, now = np.ascontiguousarray(q), np.ascontiguousarray(now)
            joints = len(self.table.axes)
            if q.ndim != 2 or q.shape[1] < joints or now.shape != (len(q),):
                raise InputError(f"postures have shape {q.shape}, times {now.shape}", hint=f"(n, {joints}) and (n,)")
            in_blocks(
                lambda at: least_margins(self.table, q[at], now[at], enough, more, margin[at], which[at]), len(q), BLOCK
            )
        return margin, which

    def hit(self, q: Array, now: float, allowed: float) -> int:
        """The first pair found whose margin falls below `allowed` [m] along postures q (n, nj) at a time of the print,
        or -1; between postures as well, provided that their steps are small."""
        if not self.any:
            return -1
        steps = np.abs(np.diff(q, axis=0)) @ self.swing
        rate = 1.0 + TIP_SLOPE if self.table.head_on_part.any() else 1.0  # what is required depends on the tip, too
        gone = rate * np.concatenate([np.zeros(1), np.cumsum(steps)])
        return int(hit_along(self.table, np.ascontiguousarray(q), gone, now, allowed, allowed + _FAR))

    @cached_property
    def swing(self) -> Array:
        """The farthest that anything moves per radian, or metre, of the joints (nj) [m]."""
        table, na = self.table, int(self.table.arm[0])
        nj = len(table.axes)
        length = np.linalg.norm(table.placements[:, :3, 3], axis=1)
        own = np.zeros(nj + 1)  # of what a frame itself carries
        np.maximum.at(own, table.frame, np.linalg.norm(table.ball[:, :3], axis=1) + table.ball[:, 3])
        for t, frame in enumerate(table.tree_frame):
            if table.first[t, 1]:
                root = (
                    table.T_frame_tree[t, :3, :3] @ table.node_centre[table.first[t, 2]] + table.T_frame_tree[t, :3, 3]
                )
                own[frame] = max(own[frame], float(np.linalg.norm(root)) + float(table.node_reach[table.first[t, 2]]))
        out = np.zeros(nj)
        for last, first in ((na, 0), (nj, na)):
            far = 0.0
            for j in range(last - 1, first - 1, -1):
                far = max(own[j + 1], far + (float(length[j + 1]) if j + 1 < last else 0.0))
                turns = table.axes[j, :3].any()
                out[j] = far if turns else 1.0
                far += 0.0 if turns else self.slide_to[j]
        return out

    def names(self, which: int) -> tuple[str, str]:
        """The two things of a pair, as `margins` counts them."""
        pairs = len(self.table.pair)
        if which < pairs:
            a, b = self.table.pair[which]
            return self.bodies[a], self.bodies[b]
        body, tree = self.table.look[which - pairs]
        return self.bodies[body], self.trees[tree]


def _empty() -> Table:
    """An empty table."""
    none, no_index, no_poses = np.zeros(0), np.zeros(0, dtype=np.int64), np.zeros((0, 4, 4))
    no_points, no_pairs = np.zeros((0, 3)), np.zeros((0, 2), dtype=np.int64)
    table = Table(
        placements=no_poses, axes=np.zeros((0, 6)), arm=np.zeros(1, dtype=np.int64), tip=np.zeros(3),
        frame=no_index, kind=no_index, size=np.zeros((0, SIZES)), planes=np.zeros((0, 4)), vertices=no_points, span=no_pairs,
        T_frame_solid=no_poses, ball=np.zeros((0, 4)), pair=no_pairs, needed=none,
        points=no_points, radius=none, time=none, node_centre=no_points, node_reach=none, since=none,
        left=no_index, right=no_index, first=np.zeros((0, 4), dtype=np.int64), tree_frame=no_index,
        T_frame_tree=no_poses, look=no_pairs, keep=no_points, slack=none, graze=none,
        head_on_part=np.zeros(0, dtype=np.bool_), round_on_part=np.zeros(0, dtype=np.bool_),
    )  # fmt: skip
    return with_fields(table, **table._asdict())


NOTHING = Obstacles(_empty(), (), (), None)


def obstacles_of(problem: Problem, cell: Cell, toolpath: Toolpath, body: PrintBody | None = None) -> Obstacles:
    """What may touch in a problem's cell while a toolpath is printed; body: as for `verify`."""
    body = body or print_body(toolpath, standing(cell))
    keep = problem.collision
    return _assembled(cell, Around(keep.nozzle, keep.arm, tip_room(problem, toolpath), body.tree, body))


def _assembled(cell: Cell, around: Around) -> Obstacles:
    things = collision_bodies(cell)
    meshes = [thing for thing in things if isinstance(thing.body.solid, Mesh)]
    solid = [thing for thing in things if not isinstance(thing.body.solid, Mesh)]
    nh = len(cell.holder)
    part_frame = len(cell.arm) + nh if nh else 0
    pairs = [
        (a, b)
        for a, b in itertools.combinations(range(len(solid)), 2)
        if may_touch(solid[a], solid[b], len(cell.arm)) and not looked_at(solid[a], solid[b], part_frame)
    ]
    needed = [around.nozzle if HEAD in (solid[a].whose, solid[b].whose) else around.arm for a, b in pairs]
    trees, frames, poses = [around.part], [part_frame], [cell.holder.T_last_tip]
    look = [
        (k, 0)
        for k, thing in enumerate(solid)
        if thing.whose == HEAD or (thing.whose != CARRIED and thing.frame != part_frame)
    ]
    clearance = [around.nozzle if solid[k].whose == HEAD else around.arm for k, _ in look]
    around = replace(around, meshes=_points_of([thing.body.solid for thing in meshes], around))
    for mesh, (_, tree) in zip(meshes, around.meshes, strict=True):
        look_at = [
            k
            for k, thing in enumerate(solid)
            if may_touch(thing, mesh, len(cell.arm)) and not looked_at(thing, mesh, part_frame)
        ]
        look += [(k, len(trees)) for k in look_at]
        clearance += [around.nozzle if solid[k].whose == HEAD else around.arm for k in look_at]
        trees.append(tree)
        frames.append(mesh.frame)
        poses.append(mesh.body.T_frame_solid)
    on_part = np.array([tree == 0 and solid[k].whose == HEAD for k, tree in look], dtype=np.bool_)
    round_ = np.array([is_round(solid[k].body, cell.arm.T_last_tip) for k, _ in look], dtype=np.bool_)
    keep = np.array(clearance, dtype=float)
    table = with_fields(
        _table(cell, [thing.body for thing in solid], [thing.frame for thing in solid]),
        pair=np.array(pairs, dtype=np.int64).reshape(-1, 2),
        needed=np.array(needed, dtype=float),
        tree_frame=np.array(frames, dtype=np.int64),
        T_frame_tree=np.array(poses),
        look=np.array(look, dtype=np.int64).reshape(-1, 2),
        keep=np.column_stack([keep, np.where(on_part, TIP_SLOPE, 0.0), -keep]),
        slack=around.room.slack,
        graze=around.room.graze,
        head_on_part=on_part,
        round_on_part=on_part & round_,
        **_joined(trees),
    )
    names = tuple(thing.body.name for thing in solid)
    farthest = np.maximum(np.abs(cell.limits.q_min), np.abs(cell.limits.q_max))
    trees_of = (PART, *(mesh.body.name for mesh in meshes))
    made = Obstacles(table, names, trees_of, around, tuple(farthest.tolist()))
    return replace(made, table=_without_needless_pairs(cell, made, solid, meshes))


def _points_of(solids: Sequence[Solid], around: Around) -> tuple[tuple[Mesh, PointTree], ...]:
    """The meshes among solids with points all over each; points that are known are reused."""
    known = {id(mesh): tree for mesh, tree in around.meshes}
    clearance = min(around.nozzle, around.arm)
    return tuple(
        (mesh, known.get(id(mesh)) or point_tree(*surface_points(mesh.vertices[mesh.triangles], clearance)))
        for mesh in solids
        if isinstance(mesh, Mesh)
    )


def _table(cell: Cell, bodies: Sequence[Body], frames: Sequence[int]) -> Table:
    """Bodies in their frames, without anything that they may touch."""
    numbers = packed(bodies)
    vertices, span = [np.zeros((0, 3))], np.zeros((len(bodies), 2), dtype=np.int64)
    for k, body in enumerate(bodies):
        if isinstance(body.solid, Hull):
            own = body.solid.corners
            span[k] = sum(map(len, vertices)), len(own)
            vertices.append(own)
    poses = np.array([body.T_frame_solid for body in bodies]).reshape(-1, 4, 4)
    arm, holder = cell.arm, cell.holder
    return with_fields(
        _empty(),
        placements=np.concatenate([arm.placements, holder.placements]),
        axes=np.concatenate([arm.axes, holder.axes]),
        arm=np.array([len(arm)]),
        tip=arm.T_last_tip[:3, 3].copy(),
        frame=np.array(frames, dtype=np.int64),
        kind=numbers.kind,
        size=numbers.size,
        planes=numbers.planes,
        vertices=np.concatenate(vertices),
        span=span,
        T_frame_solid=poses,
        ball=np.column_stack([numbers.centre, numbers.reach]),
    )


def _joined(trees: Sequence[PointTree]) -> dict[str, Any]:
    """Trees end to end, as fields of the table."""
    points, nodes = [len(tree.points) for tree in trees], [len(tree.centre) for tree in trees]
    first = np.column_stack([np.cumsum([0, *points[:-1]]), points, np.cumsum([0, *nodes[:-1]]), nodes])
    return {
        "points": np.concatenate([tree.points for tree in trees]),
        "radius": np.concatenate([tree.radius for tree in trees]),
        "time": np.concatenate([tree.time for tree in trees]),
        "node_centre": np.concatenate([tree.centre for tree in trees]),
        "node_reach": np.concatenate([tree.reach for tree in trees]),
        "since": np.concatenate([tree.since for tree in trees]),
        "left": np.concatenate([tree.left for tree in trees]),
        "right": np.concatenate([tree.right for tree in trees]),
        "first": first.astype(np.int64),
    }


def _without_needless_pairs(
    cell: Cell, obstacles: Obstacles, solid: Sequence[CollisionBody], meshes: Sequence[CollisionBody]
) -> Table:
    """The table without pairs of one robot's own bodies that need no check; part and print count as the holder's own.

    These are pairs that are too close in every posture before the print, since they are built that way, and pairs of
    the holder that none of its postures brings close. Pairs that merely cannot be as far apart as required keep _BUILT.
    """
    table, p = obstacles.table, len(obstacles.table.pair)
    whose = [(solid[a].whose, solid[b].whose) for a, b in table.pair]
    whose += [(solid[k].whose, meshes[t - 1].whose if t else CARRIED) for k, t in table.look]
    of_holder = np.array([{a, b} <= {HOLDER, CARRIED} for a, b in whose], dtype=np.bool_)
    of_arm = np.array([k < p and {a, b} <= {ARM, HEAD} for k, (a, b) in enumerate(whose)], dtype=np.bool_)
    low, high = _within_a_turn(cell)
    q = np.random.default_rng(0).uniform(low, high, (_POSTURES, len(low)))
    own = np.flatnonzero(of_arm | of_holder)

    def built(table: Table) -> Ints:
        return own[_lacking(_only(table, own), q, 0.0).all(axis=0)]

    wanted, joined = _wanted(table), built(table)
    if (wanted[joined] > _BUILT).any():
        wanted[joined] = np.minimum(wanted[joined], _BUILT)
        table = _wanting(table, wanted)
        joined = built(table)
    kept = np.ones(len(wanted), dtype=np.bool_)
    kept[joined] = False
    asked = np.flatnonzero(kept & of_holder)
    if len(asked):
        some = _only(table, asked)
        q, around = _all_over(cell, low, high, obstacles.swing)
        near = _lacking(_wanting(some, _wanted(some) + around), q, float(len(table.slack))).any(axis=0)
        kept[asked[~near]] = False
    return _only(table, np.flatnonzero(kept))


def _wanted(table: Table) -> Array:
    """The distances [m] that pairs, and then looks, keep."""
    return np.concatenate([table.needed, table.keep[:, 0]])


def _wanting(table: Table, wanted: Array) -> Table:
    """The table with other distances [m] that pairs, and then looks, keep."""
    p = len(table.pair)
    return with_fields(table, needed=wanted[:p], keep=np.column_stack([wanted[p:], table.keep[:, 1], -wanted[p:]]))


def _lacking(table: Table, q: Array, now: float) -> Flags:
    """Which pairs, and then looks, lack clearance at postures q (n, nj) at a time of the print (n, p + k)."""
    lacking = np.zeros((len(q), len(table.pair) + len(table.look)), dtype=np.bool_)
    lacking_at(table, q, now, lacking)
    return lacking


def _only(table: Table, kept: Ints) -> Table:
    """The table with some of its pairs and looks, which are numbered after the pairs."""
    p = len(table.pair)
    pairs, looks = kept[kept < p], kept[kept >= p] - p
    there = {name: getattr(table, name)[looks] for name in _OF_LOOKS}
    return with_fields(table, pair=table.pair[pairs], needed=table.needed[pairs], **there)


def _within_a_turn(cell: Cell) -> tuple[Array, Array]:
    """Ranges of all joints (nj), reduced to one turn where they are wider."""
    limits = cell.limits
    free = limits.turns & (limits.q_max - limits.q_min > 2.0 * np.pi)
    return np.where(free, -np.pi, limits.q_min), np.where(free, np.pi, limits.q_max)


def _all_over(cell: Cell, low: Array, high: Array, swing: Array) -> tuple[Array, float]:
    """Postures (n, nj) all over the ranges of the holder's joints, and the farthest that anything moves from any
    posture to the nearest of them [m]."""
    na, nh = len(cell.arm), len(cell.holder)
    each = min(int(_EVERYWHERE ** (1.0 / nh)), _FINEST)
    step = (high - low)[na:] / each
    places = [low[na + j] + step[j] * (np.arange(each) + 0.5) for j in range(nh)]
    of_holder = np.stack(np.meshgrid(*places, indexing="ij"), axis=-1).reshape(-1, nh)
    q = np.hstack([np.tile(cell.home[:na], (len(of_holder), 1)), of_holder])
    return q, float(0.5 * (swing[na:] @ step))
