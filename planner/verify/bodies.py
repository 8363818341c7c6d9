"""The bodies of a cell for coal, their poses at a posture (Pinocchio), and the pairs that can collide."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import coal
import numpy as np

from planner.base.arrays import Array, Ints
from planner.cell.cell import Cell
from planner.cell.robot import Robot, joint_axis
from planner.cell.solids import Body, Box, Capsule, Frustum, Mesh, Solid, triangles_of
from planner.cell.urdf import link_frame
from planner.verify.executed import joint_poses

ARM, HEAD, HOLDER, CARRIED, FIXTURE = "arm", "head", "holder", "carried", "fixture"
_TRIED = 64  # random postures: two bodies of one robot that are too near in all of them count as joined
BUILT = 5e-3  # m: bodies that never come farther apart count as joined; the default of collision.arm_mm
_CORNERS = 48  # of the polygon around a circle
_ROUND = 0.01  # × a body's reach: its corners may lie this far inside a round surface


@dataclass(frozen=True)
class CheckedBody:
    """One body of the cell.

    carrier   what carries it: a row of `CellBodies.poses`
    joints    how many of its robot's joints carry it; 0 if it stands still
    solid, T_carrier_solid         its shape and pose (4, 4)
    geometry, T_carrier_geometry   the same for coal
    centre, reach                  centre (3) and radius of a bounding ball, in the carrier's frame [m]
    link, beside                   its link, and the links of its robot that it may touch, as the robot's file says
    below     part of what carries an arm: no neighbour of the arm's first link, though fixed to the arm's foot
    """

    name: str
    kind: str
    carrier: int
    joints: int
    solid: Solid
    T_carrier_solid: Array
    geometry: coal.CollisionGeometry
    T_carrier_geometry: Array
    centre: Array
    reach: float
    link: str = ""
    beside: frozenset[str] = frozenset()
    below: bool = False


@dataclass(frozen=True)
class Pair:
    """Two bodies (indices) that can collide, the distance that they must keep [m], and how they can move.

    swing (nq)  upper bound on how far a point of one moves relative to the other per radian of each joint [m]
    """

    a: int
    b: int
    need: float
    swing: Array


@dataclass(frozen=True)
class CellBodies:
    """Bodies of a cell; carriers are the world, the arm's joints, then the holder's."""

    cell: Cell
    things: tuple[CheckedBody, ...]

    @classmethod
    def of(cls, cell: Cell) -> CellBodies:
        """All bodies of the cell: links, print head, fixtures and carried bodies."""
        things = [_thing(body, FIXTURE, 0, 0, np.eye(4)) for body in cell.fixtures]
        arm = cell.arm_robot
        T_last_flange = arm.model.frames[link_frame(arm.model, arm.tip)].placement.homogeneous
        na = arm.model.njoints - 1
        things += [
            _thing(body, ARM, i, i, np.eye(4) if i else cell.T_world_base)
            for i, bodies in enumerate(arm.bodies)
            for body in bodies
        ]
        things += [_thing(body, HEAD, na, na, T_last_flange @ cell.T_flange_nozzle) for body in cell.head]
        holder = cell.holder_robot
        if holder is None:
            things += [_thing(body, CARRIED, 0, 0, cell.T_world_holder) for body in cell.carried]
            return cls(cell, tuple(things))
        nh = holder.model.njoints - 1
        things += [
            _thing(body, HOLDER, na + i if i else 0, i, np.eye(4) if i else cell.T_world_holder_base)
            for i, bodies in enumerate(holder.bodies)
            for body in bodies
        ]
        T_last_plate = holder.model.frames[link_frame(holder.model, holder.tip)].placement.homogeneous
        things += [_thing(body, CARRIED, na + nh, nh, T_last_plate @ cell.T_plate_part) for body in cell.carried]
        return cls(cell, tuple(things))

    def poses(self, q: Array) -> Array:
        """T_world_carrier (n, carriers, 4, 4) at postures q (n, nq), by Pinocchio."""
        cell, na = self.cell, len(self.cell.arm)
        arm = _joint_poses(cell.arm_robot, q[:, :na], cell.T_world_base)
        world = np.broadcast_to(np.eye(4), (len(q), 1, 4, 4))
        if cell.holder_robot is None:
            return np.concatenate([world, arm], axis=1)
        return np.concatenate(
            [world, arm, _joint_poses(cell.holder_robot, self._holder_q(q), cell.T_world_holder_base)], axis=1
        )

    def _holder_q(self, q: Array) -> Array:
        """Angles of all of the holder's joints, including held ones."""
        cell = self.cell
        names = [] if cell.holder_robot is None else list(cell.holder_robot.joint_names)
        out = np.empty((len(q), len(names)))
        for k, name in enumerate(names):
            free = name in cell.holder.names
            out[:, k] = q[:, len(cell.arm) + cell.holder.names.index(name)] if free else cell.held.get(name, 0.0)
        return out

    @cached_property
    def free(self) -> tuple[int, ...]:
        """Which of the holder's joints (from 1) move, in the order of the posture."""
        robot = self.cell.holder_robot
        return () if robot is None else tuple(1 + robot.joint_names.index(name) for name in self.cell.holder.names)

    def moved_by(self, thing: CheckedBody) -> tuple[int, int]:
        """Joints of the posture that carry a body: index of the first, and one past the last."""
        if thing.kind not in (HOLDER, CARRIED):
            return 0, thing.joints
        na = len(self.cell.arm)
        return na, na + sum(joint <= thing.joints for joint in self.free)

    def swing(self, thing: CheckedBody, above: int = 0) -> Array:
        """How far a point of the body can move per radian, or metre, of the cell's joints (nq); `above`: only joints of
        its robot beyond this one count."""
        na, nq = len(self.cell.arm), len(self.cell.joint_names)
        out = np.zeros(nq)
        of_holder = thing.kind in (HOLDER, CARRIED)
        robot = self.cell.holder_robot if of_holder else self.cell.arm_robot
        if robot is None or thing.joints == 0:
            return out
        far = float(np.linalg.norm(thing.centre)) + thing.reach
        for i in range(thing.joints, above, -1):
            model, slides = robot.model, robot.slides[i - 1]
            if not of_holder:
                out[i - 1] = 1.0 if slides else far
            elif i in self.free:
                out[na + self.free.index(i)] = 1.0 if slides else far
            far += float(np.linalg.norm(model.jointPlacements[i].translation))
            if slides:  # its stroke lengthens the lever arm of all joints before it
                joint = i - 1 if not of_holder else na + self.free.index(i) if i in self.free else None
                ends = [model.lowerPositionLimit[i - 1], model.upperPositionLimit[i - 1]]
                if joint is not None:
                    ends += [self.cell.limits.q_min[joint], self.cell.limits.q_max[joint]]
                far += float(np.abs(ends).max())
        return out

    def name(self, thing: CheckedBody) -> str:
        """Its name, preceded by its kind where bodies of another kind have the same name."""
        alike = {other.kind for other in self.things if other.name == thing.name}
        return thing.name if len(alike) == 1 else f"{thing.kind} {thing.name}"


def pairs(bodies: CellBodies, nozzle: float, arm: float) -> tuple[Pair, ...]:
    """Pairs that can collide; nozzle: distance that the head must keep, arm: that links and fixtures must keep [m].

    Left out are neighbouring links and those named in a robot's file, which may touch; bodies of one robot that are too
    near in every posture, which count as joined; and most of a head with the link before it, which the flange keeps
    apart. Bodies at rest in the part frame, where the nozzle lays its first layer, are checked against the head with
    part and print.
    """
    found = []
    for i, j, above in _candidates(bodies):
        a, b = bodies.things[i], bodies.things[j]
        need = nozzle if HEAD in (a.kind, b.kind) else arm
        if _apart_along_axis(bodies, a, b) >= need:
            continue
        swing = bodies.swing(b, above) if _same(a, b) else bodies.swing(a) + bodies.swing(b)
        if swing.any():
            found.append(Pair(i, j, need, swing))
    return _without_joined(bodies, tuple(found))


def all_at_home(bodies: CellBodies, found: Sequence[Pair], nozzle: float) -> tuple[Pair, ...]:
    """The pairs, and those of the head with bodies at rest in the part frame: at home nothing is laid."""
    heads = [i for i, thing in enumerate(bodies.things) if thing.kind == HEAD]
    more = [
        Pair(i, j, nozzle, bodies.swing(bodies.things[i]))
        for j, thing in enumerate(bodies.things)
        if stands_with_part(bodies, thing)
        for i in heads
    ]
    return (*found, *more)


def stands_with_part(bodies: CellBodies, thing: CheckedBody) -> bool:
    """Whether a body is at rest in the part frame."""
    free = bodies.free
    if thing.kind == CARRIED:
        return True
    if thing.kind == HOLDER:
        return thing.joints >= max(free, default=0)
    return thing.kind == FIXTURE and not free


def _same(a: CheckedBody, b: CheckedBody) -> bool:
    """Whether two bodies belong to one robot."""
    arms, holders = (ARM, HEAD), (HOLDER, CARRIED)
    return {a.kind, b.kind} <= set(arms) or {a.kind, b.kind} <= set(holders)


def _candidates(bodies: CellBodies) -> Iterator[tuple[int, int, int]]:
    """Indices of bodies that may meet, and for those of one robot the last joint that moves both alike."""
    things = bodies.things
    for i, a in enumerate(things):
        for j, b in enumerate(things):
            if _same(a, b):
                bolted = bool({HEAD, CARRIED} & {a.kind, b.kind})  # to a flange: not a link, and no link's neighbour
                named = a.kind == b.kind and b.link in a.beside
                between = b.joints - a.joints + a.below
                if a.joints < b.joints and (between > 1 or bolted) and not named:
                    yield i, j, a.joints
            elif i < j and HEAD in (a.kind, b.kind):
                other = b if a.kind == HEAD else a
                if not stands_with_part(bodies, other):
                    yield i, j, 0
            elif i < j:
                yield i, j, 0


def _apart_along_axis(bodies: CellBodies, link: CheckedBody, head: CheckedBody) -> float:
    """How far apart [m] the head and the link before the flange stay in every posture, along the axis about which they
    turn relative to each other; -inf for other pairs."""
    robot, k = bodies.cell.arm_robot, head.joints
    if (link.kind, head.kind) != (ARM, HEAD) or link.joints != k - 1 or robot.slides[k - 1]:
        return -np.inf
    axis, T_link_joint = joint_axis(robot.model, k)[:3], robot.model.jointPlacements[k].homogeneous
    turned = T_link_joint[:3, :3] @ axis
    behind = (_corners(link) - T_link_joint[:3, 3]) @ turned
    before = _corners(head) @ axis
    gap = max(before.min() - behind.max(), behind.min() - before.max())
    return float(gap) - _ROUND * (link.reach + head.reach)


def _corners(thing: CheckedBody) -> Array:
    """Corners (n, 3) of a body's surface in its carrier's frame."""
    T = thing.T_carrier_solid
    return np.asarray(triangles_of(thing.solid)[0] @ T[:3, :3].T + T[:3, 3])


def many_postures(cell: Cell) -> Array:
    """Random postures (n, nq): bodies that are too near in all of them are built that way."""
    limits = cell.limits
    return np.random.default_rng(0).uniform(limits.q_min, limits.q_max, (_TRIED, len(limits.q_min)))


def _without_joined(bodies: CellBodies, found: tuple[Pair, ...]) -> tuple[Pair, ...]:
    """The pairs without those of one robot that are too near in all of many postures: they are built that way. Pairs
    that reach BUILT but never the required distance must keep BUILT."""
    poses = bodies.poses(many_postures(bodies.cell))
    distance = Distances(bodies)

    def come_apart(pair: Pair, need: float) -> bool:
        return any(distance.of(pair, poses[k]) >= need for k in range(_TRIED))

    kept = []
    for pair in found:
        if not _same(bodies.things[pair.a], bodies.things[pair.b]) or come_apart(pair, pair.need):
            kept.append(pair)
        elif pair.need > BUILT and come_apart(pair, BUILT):
            kept.append(replace(pair, need=BUILT))
    return tuple(kept)


class Distances:
    """Signed distances of pairs by coal."""

    def __init__(self, bodies: CellBodies) -> None:
        self._things = bodies.things
        self._request, self._result = coal.DistanceRequest(), coal.DistanceResult()
        self._request.enable_signed_distance = True

    def of(self, pair: Pair, poses: Array) -> float:
        """The distance [m] with carriers at poses (carriers, 4, 4); minus the penetration depth where they overlap."""
        return float(self.along(pair, poses[None])[0])

    def along(self, pair: Pair, poses: Array) -> Array:
        """Distances (n) [m] with carriers at poses (n, carriers, 4, 4)."""
        a, b = self._things[pair.a], self._things[pair.b]
        Ta, Tb = poses[:, a.carrier] @ a.T_carrier_geometry, poses[:, b.carrier] @ b.T_carrier_geometry
        return np.array([self.between(a.geometry, each, b.geometry, other) for each, other in zip(Ta, Tb, strict=True)])

    def between(self, a: coal.CollisionGeometry, Ta: Array, b: coal.CollisionGeometry, Tb: Array) -> float:
        """The same for two of coal's bodies at poses in the world."""
        self._result.clear()
        Fa, Fb = coal.Transform3s(Ta[:3, :3], Ta[:3, 3]), coal.Transform3s(Tb[:3, :3], Tb[:3, 3])
        return float(coal.distance(a, Fa, b, Fb, self._request, self._result))


def coal_geometry(solid: Solid) -> tuple[coal.CollisionGeometry, Array]:
    """coal's body, and its frame's pose (4, 4) in the solid's. A cone's circles become polygons around them."""
    T = np.eye(4)
    if isinstance(solid, Box):
        return coal.Box(*solid.size), T
    if isinstance(solid, Capsule):
        return coal.Capsule(solid.radius, solid.length) if solid.length else coal.Sphere(solid.radius), T
    if isinstance(solid, Frustum) and solid.bottom == solid.top:
        T[2, 3] = 0.5 * solid.height
        return coal.Cylinder(solid.bottom, solid.height), T
    if isinstance(solid, Mesh):
        return triangle_model(solid.vertices, solid.triangles), T
    if isinstance(solid, Frustum):
        angle = np.arange(_CORNERS) * 2.0 * np.pi / _CORNERS
        circle = np.column_stack([np.cos(angle), np.sin(angle), np.zeros(_CORNERS)]) / np.cos(np.pi / _CORNERS)
        rings = [solid.bottom * circle, solid.top * circle + [0.0, 0.0, solid.height]]
        return _convex(np.vstack(rings)), T
    return _convex(solid.vertices), T


def _convex(points: Array) -> coal.CollisionGeometry:
    return coal.Convex.convexHull(_points(points), True, "Qt")


def _points(points: Array) -> coal.StdVec_Vec3s:
    out = coal.StdVec_Vec3s()
    out.extend([np.ascontiguousarray(point) for point in points])
    return out


def triangle_model(vertices: Array, triangles: Ints) -> coal.BVHModelOBBRSS:
    """Triangles (m, 3) of vertices (n, 3), as coal's model."""
    corners = coal.StdVec_Triangle()
    corners.extend([coal.Triangle(*corner) for corner in triangles.tolist()])
    out = coal.BVHModelOBBRSS()
    out.beginModel(len(triangles), len(vertices))
    out.addSubModel(_points(vertices), corners)
    out.endModel()
    return out


def _thing(body: Body, kind: str, carrier: int, joints: int, T_carrier_frame: Array) -> CheckedBody:
    geometry, shift = coal_geometry(body.solid)
    T = T_carrier_frame @ body.T_frame_solid
    vertices = triangles_of(body.solid)[0]
    middle = 0.5 * (vertices.min(axis=0) + vertices.max(axis=0))
    reach = float(np.linalg.norm(vertices - middle, axis=1).max()) / float(np.cos(np.pi / _CORNERS))
    centre = T[:3, :3] @ middle + T[:3, 3]
    return CheckedBody(
        body.name,
        kind,
        carrier,
        joints,
        body.solid,
        T,
        geometry,
        T @ shift,
        centre,
        reach,
        body.link,
        body.beside,
        body.below,
    )


def _joint_poses(robot: Robot, q: Array, T_world_base: Array) -> Array:
    """World poses (n, joints, 4, 4) of a robot's joint frames, moved by their joints."""
    return np.asarray(T_world_base @ joint_poses(robot.model, q))
