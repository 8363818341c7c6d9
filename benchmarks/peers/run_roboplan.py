"""Differential inverse kinematics by roboplan's OInK; the pose's roll is that of the nozzle as it stands."""

from __future__ import annotations

import sys

import follow
import numpy as np
from numpy.typing import NDArray
from roboplan.core import CartesianConfiguration, Scene, loadUrdfSceneDescription
from roboplan.optimal_ik import (
    ConfigurationTask,
    ConfigurationTaskOptions,
    FrameTask,
    FrameTaskOptions,
    Oink,
    PositionLimit,
    VelocityLimit,
)
from side import Case, Plan, main

Array = NDArray[np.float64]

PULL = 1e-3  # weight of staying near home, at the second priority
DAMPING = 1e-9


def prepare(case: Case, options: list[str]) -> Plan:
    """The scene and the tasks."""
    scene = Scene("case", loadUrdfSceneDescription(str(case.folder / "robot.urdf")))
    names = scene.getJointNames()
    order = [names.index(name) for name in case.joints]
    home = np.empty(len(names))
    home[order] = case.home
    velocity = np.empty(len(names))
    velocity[order] = case.velocity
    oink = Oink(scene)
    target = CartesianConfiguration("part", "nozzle", np.asfortranarray(case.poses[0]))
    task = FrameTask(oink, scene, target, FrameTaskOptions())
    rest = ConfigurationTask(oink, home, np.full(len(names), PULL), ConfigurationTaskOptions(priority=2))
    limits = [PositionLimit(oink), VelocityLimit(oink, 1.0, velocity)]

    def nearest(pose: Array, now: Array) -> Array:
        """The pose with the roll that turns the nozzle from now by the least angle."""
        z, x = pose[:3, 2], now[:3, 0] + 0.0
        axis = np.cross(now[:3, 2], z)
        x += np.cross(axis, x) + np.cross(axis, np.cross(axis, x)) / (1.0 + now[:3, 2] @ z)
        x -= (x @ z) * z
        x /= np.linalg.norm(x)
        out = pose.copy(order="F")
        out[:3, 0], out[:3, 1] = x, np.cross(z, x)
        return out

    def step(q: Array, pose: Array, dt: float) -> tuple[Array, float] | None:
        full = np.empty(len(names))
        full[order] = q
        limits[1].dt = dt
        task.setTargetFrameTransform(nearest(pose, scene.forwardKinematics(full, "nozzle", "part")))
        change = np.zeros(len(names))
        try:
            oink.solveIk(full, [task, rest], limits, change, DAMPING)
        except RuntimeError:
            return None
        full = scene.integrate(full, change)
        now = scene.forwardKinematics(full, "nozzle", "part")
        off = max(np.abs(now[:3, 3] - pose[:3, 3]).max(), np.linalg.norm(np.cross(now[:3, 2], pose[:3, 2])))
        return full[order], float(off)

    def sigma(q: Array) -> float:
        full = np.empty(len(names))
        full[order] = q
        jacobian = scene.computeFrameJacobian(full, "nozzle")[:, order[: case.arm_joints]]
        return float(np.linalg.svd(jacobian, compute_uv=False)[-1])

    return follow.planner(case, step, sigma)


if __name__ == "__main__":
    sys.exit(main("roboplan", prepare))
