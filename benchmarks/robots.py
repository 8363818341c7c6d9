"""Draw the collision bodies of all shipped robots, each at the same scale.

python -m benchmarks.robots docs/pictures/robots.png
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

import matplotlib
import numpy as np
import pinocchio as pin
import trimesh

from planner.base.arrays import Array
from planner.base.shipped import ROBOTS
from planner.cell.robot import Robot, read_robot, robot_names
from planner.cell.robot_file import read_robot_file
from planner.cell.solids import triangles_of

matplotlib.use("Agg")
import matplotlib.pyplot as plt  # after the choice of its backend
from mpl_toolkits.mplot3d import Axes3D
from mpl_toolkits.mplot3d.art3d import Poly3DCollection

BENT = {  # deg: postures in which arms of each kind are easily seen
    "spherical_wrist": (0, 15, 10, 0, 55, 0),
    "offset_wrist": (0, -60, 80, -110, -90, 0),
    "seven_axes": (0, 30, 0, -80, 0, 60, 0),
}
OTHERS = {
    "panda": (0, -30, 0, -120, 0, 100, 45),
    "xarm7": (0, -10, 0, 70, 0, 60, 0),
    "irbp_a250": (25, 0),
    "track_3m": (0,),
    "gantry_xy": (0, 0),
}
FINEST = 0.04  # m: triangles are cut to this size, so that nearer ones hide farther ones
LIGHT = np.array([0.35, -0.55, 0.76])
COLOURS = ((0.62, 0.66, 0.72), (0.93, 0.60, 0.25))  # of every second link
COLUMNS = 6
HIGHEST, WIDEST = 1.45, 0.8  # m, of what is seen


def posture(key: str, robot: Robot) -> Array:
    """A posture [rad] within the robot's ranges in which its links are seen."""
    given = read_robot_file(ROBOTS / f"{key}.yaml").data
    kind = "spherical_wrist" if "spherical_wrist" in given else given.get("inverse_kinematics")
    angles = OTHERS.get(key) or BENT[str(kind)]
    return np.clip(np.radians(angles), robot.model.lowerPositionLimit, robot.model.upperPositionLimit)


def triangles(robot: Robot, q: Array) -> tuple[Array, Array]:
    """Corners (n, 3, 3) [m] of all bodies in a posture, in the base frame, and their colours (n, 3)."""
    data = robot.model.createData()
    pin.forwardKinematics(robot.model, data, q)
    corners, colours = [], []
    for i, bodies in enumerate(robot.bodies):
        for body in bodies:
            vertices, faces = trimesh.remesh.subdivide_to_size(*triangles_of(body.solid), FINEST)
            T = data.oMi[i].homogeneous @ body.T_frame_solid
            own = (vertices @ T[:3, :3].T + T[:3, 3])[faces]
            normal = np.cross(own[:, 1] - own[:, 0], own[:, 2] - own[:, 0])
            normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
            bright = 0.62 + 0.38 * np.clip(normal @ LIGHT, -1.0, 1.0)
            corners.append(own)
            colours.append(bright[:, None] * COLOURS[i % 2])
    return np.concatenate(corners), np.concatenate(colours)


def draw(axes: Axes3D, key: str) -> None:
    """One robot, on the floor."""
    robot = read_robot(ROBOTS / f"{key}.yaml")
    corners, colours = triangles(robot, posture(key, robot))
    middle = 0.5 * (corners.min(axis=(0, 1)) + corners.max(axis=(0, 1)))
    faces = Poly3DCollection(corners - [*middle[:2], 0.0], facecolors=colours, edgecolors="none", antialiaseds=False)
    axes.add_collection3d(faces)
    axes.set(xlim=(-WIDEST, WIDEST), ylim=(-WIDEST, WIDEST), zlim=(0, HIGHEST))
    axes.set_box_aspect((2 * WIDEST, 2 * WIDEST, HIGHEST), zoom=1.7)
    axes.view_init(14, 50 if key == "irbp_a250" else -62)  # its column stands at -y
    axes.set_axis_off()
    axes.set_title(robot.name, fontsize=9, y=-0.07)


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.robots", description="Draw all robots that ship.")
    parser.add_argument("picture", type=Path, help="a PNG file to write")
    target = parser.parse_args(arguments).picture
    keys = robot_names()
    rows = -(-len(keys) // COLUMNS)
    figure = plt.figure(figsize=(2.1 * COLUMNS, 2.2 * rows))
    for k, key in enumerate(keys):
        draw(figure.add_subplot(rows, COLUMNS, k + 1, projection="3d"), key)
    figure.subplots_adjust(0, 0.05, 1, 1, wspace=0, hspace=0.02)
    figure.savefig(target, dpi=100)
    print(target)
    return 0


if __name__ == "__main__":
    sys.exit(main())
