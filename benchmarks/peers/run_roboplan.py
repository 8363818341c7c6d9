"""Differential inverse kinematics by roboplan's OInK; the pose's roll is that of the nozzle as it stands."""

from __future__ import annotations

import sys
from collections.abc import Callable

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
from side import Case, main

Array = NDArray[np.float64]

CLOSE = 1e-6  # m and rad off a waypoint at which the next one is taken
TRIES = 20  # steps at a waypoint
APPROACH = 300  # steps from the home posture to the first waypoint
PULL = 1e-3  # weight of staying near home, at the second priority
DAMPING = 1e-9


def prepare(case: Case, options: list[str]) -> Callable[[list[Array]], tuple[list[Array], str]]:
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

    def reach(q: Array, pose: Array, dt: float, tries: int) -> tuple[Array, float]:
        limits[1].dt = dt
        step = np.zeros(len(names))
        off = np.inf
        for _ in range(tries):
            now = scene.forwardKinematics(q, "nozzle", "part")
            off = max(np.abs(now[:3, 3] - pose[:3, 3]).max(), np.linalg.norm(np.cross(now[:3, 2], pose[:3, 2])))
            if off < CLOSE:
                break
            task.setTargetFrameTransform(nearest(pose, now))
            try:
                oink.solveIk(q, [task, rest], limits, step, DAMPING)
            except RuntimeError:
                break
            q = scene.integrate(q, step)
        return q, float(off)

    def plan(beads: list[Array]) -> tuple[list[Array], str]:
        q, out, missed, worst = home, [], 0, 0.0
        for poses in beads:
            joints = np.empty((len(poses), len(names)))
            q, _ = reach(q, poses[0], 0.1, APPROACH)
            apart = np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1)
            steps = np.maximum(np.concatenate([[apart[0]], apart]) / case.speed, 1e-4)
            for i, pose in enumerate(poses):
                q, off = reach(q, pose, float(steps[i]), TRIES)
                missed, worst = missed + (off >= CLOSE), max(worst, off)
                joints[i] = q
            out.append(joints[:, order])
        return out, f"{missed} waypoints missed, by up to {worst:.2g}" if missed else ""

    return plan


if __name__ == "__main__":
    sys.exit(main("roboplan", prepare))
