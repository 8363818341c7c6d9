"""Bodies as coal has them, placed by Pinocchio: what tests measure distances with."""

from __future__ import annotations

from itertools import combinations

import coal
import numpy as np
import pinocchio as pin

from planner.base.arrays import Array
from planner.cell.robot import Robot
from planner.cell.solids import Body, Box, Capsule, Frustum, triangles_of

Placed = tuple[int, str, coal.CollisionGeometry, coal.Transform3s]  # joint index, name, shape, pose in the base


def shape_of(body: Body) -> tuple[coal.CollisionGeometry, Array]:
    """The shape, and its pose (4, 4) in the frame that carries the body."""
    solid, T = body.solid, body.T_frame_solid.copy()
    if isinstance(solid, Box):
        return coal.Box(*solid.size), T
    if isinstance(solid, Capsule):
        return coal.Capsule(solid.radius, solid.length) if solid.length else coal.Sphere(solid.radius), T
    if isinstance(solid, Frustum) and solid.bottom == solid.top:
        T[:3, 3] += 0.5 * solid.height * T[:3, 2]
        return coal.Cylinder(solid.bottom, solid.height), T
    vertices, triangles = triangles_of(solid)
    points, faces = coal.StdVec_Vec3s(), coal.StdVec_Triangle()
    for point in vertices:
        points.append(point)
    for face in triangles:
        faces.append(coal.Triangle(*map(int, face)))
    return coal.Convex(points, faces), T


def placed(robot: Robot, q: Array, T_world_base: Array | None = None) -> list[Placed]:
    """All bodies of a robot in a posture q (n)."""
    data = robot.model.createData()
    pin.forwardKinematics(robot.model, data, q)
    base = np.eye(4) if T_world_base is None else T_world_base
    out = []
    for i, bodies in enumerate(robot.bodies):
        for body in bodies:
            shape, T = shape_of(body)
            pose = base @ data.oMi[i].homogeneous @ T
            out.append((i, body.name, shape, coal.Transform3s(pose[:3, :3], pose[:3, 3])))
    return out


def distance(a: Placed, b: Placed) -> float:
    """Least distance [m]; negative inside each other."""
    return float(coal.distance(a[2], a[3], b[2], b[3], coal.DistanceRequest(), coal.DistanceResult()))


def nearest_links(robot: Robot, q: Array) -> tuple[float, str, str]:
    """The two bodies of links that are no neighbours, and are nearest to each other."""
    pairs = [(a, b) for a, b in combinations(placed(robot, q), 2) if abs(a[0] - b[0]) > 1]
    return min((distance(a, b), a[1], b[1]) for a, b in pairs)
