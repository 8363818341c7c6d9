"""A cell in a posture, drawn in 3-D: bodies as triangles, frames as arrows."""

from __future__ import annotations

from dataclasses import dataclass

import matplotlib.patheffects as halo
import numpy as np
import pinocchio as pin
import trimesh
from mpl_toolkits.mplot3d import Axes3D
from mpl_toolkits.mplot3d.art3d import Poly3DCollection

from planner.base.arrays import Array
from planner.cell.cell import Cell
from planner.cell.robot import Robot
from planner.cell.solids import Body, Frustum, triangles_of

FINEST = 0.04  # m: triangles are cut to this size, so that nearer ones hide farther ones
LIGHT = np.array([0.45, 0.5, 0.74])  # the drawings look at the cell from +x, +y
VIEW = (18, 62)  # degrees of elevation and azimuth: there
ARM, HOLDER, HEAD, PART = (0.72, 0.75, 0.79), (0.80, 0.77, 0.70), (0.93, 0.60, 0.25), (0.66, 0.76, 0.86)
AXES = ("#b3261e", "#1b7837", "#2456a6")  # x, y, z
INK = "#1c2733"
WHITE = [halo.withStroke(linewidth=3.0, foreground="white")]


@dataclass(frozen=True)
class Shape:
    """Triangles (n, 3, 3) in the world [m] and their colours (n, 4)."""

    corners: Array
    colours: Array


def shape_of(body: Body, T_world_frame: Array, colour: tuple[float, float, float], opacity: float = 1.0) -> Shape:
    """A body of a frame, lit from above."""
    vertices, faces = trimesh.remesh.subdivide_to_size(*triangles_of(body.solid), FINEST)
    T = T_world_frame @ body.T_frame_solid
    corners = (vertices @ T[:3, :3].T + T[:3, 3])[faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    bright = 0.66 + 0.34 * np.clip(normals @ LIGHT, -1.0, 1.0)
    colours = np.concatenate([bright[:, None] * colour, np.full((len(bright), 1), opacity)], axis=1)
    return Shape(corners, colours)


def robot_shapes(
    robot: Robot, T_world_base: Array, q: Array, colour: tuple[float, float, float], opacity: float = 1.0
) -> list[Shape]:
    """All bodies of a robot, all its joints at q [rad]."""
    data = robot.model.createData()
    pin.forwardKinematics(robot.model, data, q)
    return [
        shape_of(body, T_world_base @ data.oMi[i].homogeneous, colour, opacity)
        for i, bodies in enumerate(robot.bodies)
        for body in bodies
    ]


def arm_shapes(cell: Cell, q: Array, opacity: float = 1.0) -> list[Shape]:
    """Arm and print head with the arm's joints at q (6) [rad]."""
    T_world_nozzle = cell.arm.poses(q[None])[0]
    head = [shape_of(body, T_world_nozzle, HEAD, opacity) for body in cell.head]
    return robot_shapes(cell.arm_robot, cell.T_world_base, q, ARM, opacity) + head


def holder_shapes(cell: Cell, free: Array) -> list[Shape]:
    """What holds the part and what stands on it, its free axes at the angles `free` [rad]."""
    T_world_part = cell.holder.poses(free[None])[0]
    shapes = [shape_of(body, T_world_part, PART) for body in cell.carried]
    shapes += [shape_of(body, np.eye(4), HOLDER) for body in cell.fixtures]
    if cell.holder_robot is not None:
        angles = {**cell.held, **dict(zip(cell.holder.names, free, strict=True))}
        q = np.array([angles[name] for name in cell.holder_robot.joint_names])
        shapes += robot_shapes(cell.holder_robot, cell.T_world_holder_base, q, HOLDER)
    return shapes


def cylinder(T_world_part: Array, centre: tuple[float, float], radius: float, height: float) -> Shape:
    """An upright cylinder in the part frame, from its foot on."""
    T = np.eye(4)
    T[:2, 3] = centre
    return shape_of(Body("part", Frustum(radius, radius, height), T), T_world_part, PART)


def add_shapes(axes: Axes3D, shapes: list[Shape]) -> None:
    """Draw them together, so that nearer triangles hide farther ones."""
    corners = np.concatenate([shape.corners for shape in shapes])
    colours = np.concatenate([shape.colours for shape in shapes])
    faces = Poly3DCollection(corners, facecolors=colours, edgecolors="none", antialiaseds=False, zorder=1)
    axes.add_collection3d(faces)


def add_frame(axes: Axes3D, T: Array, name: str, size: float, aside: tuple[float, float, float]) -> None:
    """A frame as three arrows with its name; `aside` [m] is where the name stands from the origin."""
    origin = T[:3, 3]
    for k, letter in enumerate("xyz"):
        end = origin + size * T[:3, k]
        axes.plot(*np.transpose([origin, end]), color="white", linewidth=4.5, zorder=5)
        axes.plot(*np.transpose([origin, end]), color=AXES[k], linewidth=2.2, zorder=6)
        tip = origin + 1.22 * size * T[:3, k]
        axes.text(*tip, letter, color=AXES[k], fontsize=8, ha="center", va="center", zorder=7, path_effects=WHITE)
    axes.plot(*origin[:, None], "o", color=INK, markersize=3.5, zorder=8)
    at = origin + aside
    axes.text(*at, name, color=INK, fontsize=10, weight="bold", ha="center", va="center", zorder=9, path_effects=WHITE)


def add_arrow(axes: Axes3D, a: Array, b: Array, name: str, bend: tuple[float, float, float]) -> None:
    """A bent arrow from place a to place b (3) [m], with its name at the middle."""
    u = np.linspace(0.0, 1.0, 40)[:, None]
    middle = 0.5 * (a + b) + bend
    curve = (1 - u) ** 2 * a + 2 * u * (1 - u) * (2 * middle - 0.5 * (a + b)) + u**2 * b
    axes.plot(*curve.T, color=INK, linewidth=1.3, linestyle=(0, (4, 2)), zorder=4)
    axes.text(
        *(0.25 * a + 0.5 * (2 * middle - 0.5 * (a + b)) + 0.25 * b),
        name,
        color=INK,
        fontsize=9,
        ha="center",
        va="center",
        zorder=9,
        path_effects=WHITE,
    )


def frame_view(axes: Axes3D, low: tuple[float, float, float], high: tuple[float, float, float], zoom: float) -> None:
    """Show a box of the world [m], true to scale, without axes, from above and the front."""
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), zlim=(low[2], high[2]))
    axes.set_box_aspect(np.subtract(high, low), zoom=zoom)
    axes.computed_zorder = False
    axes.set_axis_off()
    axes.view_init(*VIEW)
