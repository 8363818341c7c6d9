"""Cells with simple bodies for tests of collisions: capsules along an arm's links."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import NamedTuple

import coal
import numpy as np
from scipy.spatial.transform import Rotation

from planner.cell.cell import Cell
from planner.cell.kinematics.chain import Chain
from planner.cell.robot import Robot
from planner.cell.solids import Body, Box, Capsule, Frustum, Hull, Mesh, Solid

AROUND = 200  # corners of a circle
THICK = 0.04  # m, radius of the links


def along(start: np.ndarray, end: np.ndarray, radius: float, name: str) -> Body:
    """A capsule from point to point."""
    way = end - start
    length = float(np.linalg.norm(way))
    z = way / length if length > 1e-6 else np.array([0.0, 0.0, 1.0])
    x = np.cross(z, np.eye(3)[int(np.argmin(np.abs(z)))])
    x /= np.linalg.norm(x)
    T = np.eye(4)
    T[:3, :3] = np.column_stack([x, np.cross(z, x), z])
    T[:3, 3] = 0.5 * (start + end)
    return Body(name, Capsule(radius, length), T)


def with_links(robot: Robot, chain: Chain, radius: float = THICK) -> Robot:
    """The robot with a capsule from each joint to the next; the base and the last link have none."""
    bodies: list[tuple[Body, ...]] = [()]
    for i in range(len(chain)):
        end = chain.placements[i + 1][:3, 3] if i + 1 < len(chain) else np.zeros(3)
        bodies.append((along(np.zeros(3), end, radius, f"link {i + 1}"),) if np.linalg.norm(end) > 1e-3 else ())
    return replace(robot, bodies=tuple(bodies))


def with_bodies(cell: Cell, fixtures: tuple[Body, ...] = (), carried: tuple[Body, ...] = ()) -> Cell:
    """The cell with such links on its arm, a holder without bodies, and fixtures."""
    arm = with_links(cell.arm_robot, cell.arm)
    holder = cell.holder_robot
    if holder is not None:
        holder = replace(holder, bodies=((),) * holder.model.njoints)
    return replace(cell, arm_robot=arm, holder_robot=holder, fixtures=fixtures, carried=carried)


class Placed(NamedTuple):
    """A solid and its pose in the world."""

    solid: Solid
    T: np.ndarray


def placed(cell: Cell, q: np.ndarray) -> dict[tuple[str, int], Placed]:
    """All convex bodies of a cell at a posture q (nj) by name and number: links, head, fixtures, carried ones."""
    na = len(cell.arm)
    out: list[tuple[str, Placed]] = []

    def frames(chain: Chain, angles: np.ndarray) -> list[np.ndarray]:
        T, all_of_them = np.eye(4), []
        for placement, axis, angle in zip(chain.placements, chain.axes, angles, strict=True):
            turn = np.eye(4)
            turn[:3, :3] = Rotation.from_rotvec(angle * axis[:3]).as_matrix()
            T = T @ placement @ turn
            all_of_them.append(T)
        return all_of_them

    for T, bodies in zip(frames(cell.arm, q[:na]), cell.arm_robot.bodies[1:], strict=True):
        out += [(body.name, Placed(body.solid, T @ body.T_frame_solid)) for body in bodies]
    T_world_nozzle, T_world_part = cell.arm.poses(q[None, :na])[0], cell.holder.poses(q[None, na:])[0]
    out += [(body.name, Placed(body.solid, T_world_nozzle @ body.T_frame_solid)) for body in cell.head]
    out += [(body.name, Placed(body.solid, body.T_frame_solid)) for body in cell.fixtures]
    out += [(body.name, Placed(body.solid, T_world_part @ body.T_frame_solid)) for body in cell.carried]
    convex = [(name, body) for name, body in out if not isinstance(body.solid, Mesh)]
    return {(name, k): body for k, (name, body) in enumerate(convex)}


def coal_distance(a: Solid, T_a: np.ndarray, b: Solid, T_b: np.ndarray) -> float:
    """Distance [m] of two solids at poses in the world, by coal; negative where they overlap."""
    poses = [coal.Transform3s(T[:3, :3], T[:3, 3]) for T in (T_a, T_b)]
    result = coal.DistanceResult()
    coal.distance(_shape(a), poses[0], _shape(b), poses[1], coal.DistanceRequest(), result)
    return float(result.min_distance)


def _shape(solid: Solid) -> coal.CollisionGeometry:
    return _convex(solid.vertices) if isinstance(solid, Hull) else _known_shape(solid)


@cache
def _known_shape(solid: Solid) -> coal.CollisionGeometry:
    if isinstance(solid, Box):
        return coal.Box(*solid.size)
    if isinstance(solid, Capsule):
        return coal.Capsule(solid.radius, solid.length)
    if isinstance(solid, Frustum):
        angle = np.arange(AROUND) * 2.0 * np.pi / AROUND
        circle = np.column_stack([np.cos(angle), np.sin(angle), np.zeros(AROUND)])
        return _convex(np.vstack([solid.bottom * circle, solid.top * circle + [0.0, 0.0, solid.height]]))
    raise TypeError(f"{solid} is not convex")


def _convex(points: np.ndarray) -> coal.CollisionGeometry:
    vertices = coal.StdVec_Vec3s()
    for point in points:
        vertices.append(point)
    return coal.Convex.convexHull(vertices, False, None)
