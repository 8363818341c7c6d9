"""Differential inverse kinematics by pin-pink: nozzle against part with free roll, table free, manipulability preferred."""

from __future__ import annotations

import itertools
import logging
import sys
from collections.abc import Callable

import numpy as np
import pink
import pinocchio as pin
from numpy.typing import NDArray
from pink.exceptions import NoSolutionFound
from pink.limits import ConfigurationLimit, VelocityLimit
from pink.tasks import DampingTask, ManipulabilityTask, RelativeFrameTask
from side import Case, main

Array = NDArray[np.float64]

POSITION, TILT = 1000.0, 300.0  # cost by m and by rad; roll about the nozzle's axis costs nothing
MANIPULABILITY, RATE = 1e-2, 0.03  # cost, and the rise that is asked for at a step
DAMPING = 1e-2
CLOSE = 1e-6  # m and rad off a waypoint at which the next one is taken
TRIES = 20  # steps at a waypoint
APPROACH = 300  # steps to the first waypoint of a bead
WRISTS = (
    (-2.0, -1.0, 0.0, 1.0, 2.0),
    (-0.8, 0.8),
    (-2.0, 0.0, 2.0),
)  # rad: last three joints of postures to start from
LOOKS = 200  # waypoints of the first bead at which a start is tried
SOLVER = "daqp"  # the fastest of three; quadprog finds the Hessian singular


logging.disable(logging.WARNING)  # of joints that are a rounding error beyond a limit


def prepare(case: Case, options: list[str]) -> Callable[[list[Array]], tuple[list[Array], str]]:
    """Pinocchio's model of the case, and the tasks."""
    model = pin.buildModelFromUrdf(str(case.folder / "robot.urdf"))
    order = np.array([model.joints[model.getJointId(name)].idx_q for name in case.joints])
    task = RelativeFrameTask(
        "nozzle", "part", position_cost=POSITION, orientation_cost=np.array([TILT, TILT, 0.0]), lm_damping=0.0
    )
    prefer = ManipulabilityTask("nozzle", model, cost=MANIPULABILITY, manipulability_rate=RATE)
    tasks = [task, prefer, DampingTask(cost=DAMPING)]
    limits = [ConfigurationLimit(model), VelocityLimit(model)]

    def reach(configuration: pink.Configuration, pose: Array, dt: float, tries: int, least: int = 0) -> float:
        """Step until the pose is met, at least so many times; returns how far it is off in the end."""
        task.set_target(pin.SE3(pose))
        off = np.inf
        for k in range(tries):
            try:
                v = pink.solve_ik(configuration, tasks, dt, SOLVER, limits=limits, safety_break=False)
            except NoSolutionFound:
                return float(np.abs(task.compute_error(configuration)[:5]).max())
            configuration.integrate_inplace(v, dt)
            off = float(np.abs(task.compute_error(configuration)[:5]).max())
            if off < CLOSE and k >= least:
                break
        return off

    def follow(configuration: pink.Configuration, poses: Array) -> tuple[Array, float, int]:
        """Joints (n, nq) at the poses, how far they are off at the worst, and how many are missed."""
        q = np.empty((len(poses), model.nq))
        reach(configuration, poses[0], 0.025, APPROACH, APPROACH // 2)
        apart = np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1)
        steps = np.maximum(np.concatenate([[apart[0]], apart]) / case.speed, 1e-4)
        off = np.empty(len(poses))
        for i, pose in enumerate(poses):
            off[i] = reach(configuration, pose, float(steps[i]), TRIES)
            q[i] = configuration.q
        return q, float(off.max()), int((off >= CLOSE).sum())

    def rating(q: Array, off: float) -> float:
        """The least singular value of the arm's Jacobian or distance from a limit [rad] at postures (n, nq), less what is off."""
        data, frame = model.createData(), model.getFrameId("nozzle")
        arm = [model.joints[model.getJointId(name)].idx_v for name in case.joints[: case.arm_joints]]
        jacobians = np.array([pin.computeFrameJacobian(model, data, row, frame)[:, arm] for row in q])
        margin = np.minimum(q - model.lowerPositionLimit, model.upperPositionLimit - q).min()
        return float(min(np.linalg.svd(jacobians, compute_uv=False).min(), margin)) - 1e3 * off

    def best_start() -> Array:
        """The posture from which the first bead, taken in long steps, keeps farthest from singularities and limits."""
        home = np.zeros(model.nq)
        home[order] = case.home
        low, high = model.lowerPositionLimit, model.upperPositionLimit
        starts = []
        for wrist in itertools.product(*WRISTS):
            posture = home.copy()
            posture[order[case.arm_joints - 3 : case.arm_joints]] = wrist
            starts.append(np.clip(posture, low, high))
        rated = []
        poses = case.beads[0][:: max(1, len(case.beads[0]) // LOOKS)]
        for start in starts:
            q, off, _ = follow(pink.Configuration(model, model.createData(), start), poses)
            rated.append(rating(q, off))
        return starts[int(np.argmax(rated))]

    start = best_start()

    def plan(beads: list[Array]) -> tuple[list[Array], str]:
        configuration = pink.Configuration(model, model.createData(), start)
        followed = [follow(configuration, poses) for poses in beads]
        missed, worst = sum(each[2] for each in followed), max(each[1] for each in followed)
        said = f"{missed} waypoints missed, by up to {worst:.2g}" if missed else ""
        return [q[:, order] for q, _, _ in followed], said

    return plan


if __name__ == "__main__":
    sys.exit(main("pin-pink", prepare))
