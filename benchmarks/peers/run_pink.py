"""Differential inverse kinematics by pin-pink: nozzle against part with free roll, table free, manipulability preferred."""

from __future__ import annotations

import logging
import sys

import follow
import numpy as np
import pink
import pinocchio as pin
from numpy.typing import NDArray
from pink.exceptions import NoSolutionFound
from pink.limits import ConfigurationLimit, VelocityLimit
from pink.tasks import DampingTask, ManipulabilityTask, RelativeFrameTask
from side import Case, Plan, main

Array = NDArray[np.float64]

POSITION, TILT = 1000.0, 300.0  # cost by m and by rad; roll about the nozzle's axis costs nothing
MANIPULABILITY, RATE = 1e-2, 0.1  # cost, and the rise that is asked for at a step
DAMPING = 1e-2
SOLVER = "daqp"  # the fastest of three; quadprog finds the Hessian singular

logging.disable(logging.WARNING)  # of joints that are a rounding error beyond a limit


def prepare(case: Case, options: list[str]) -> Plan:
    """Pinocchio's model of the case, and the tasks."""
    model = pin.buildModelFromUrdf(str(case.folder / "robot.urdf"))
    order = [model.joints[model.getJointId(name)].idx_q for name in case.joints]
    task = RelativeFrameTask(
        "nozzle", "part", position_cost=POSITION, orientation_cost=np.array([TILT, TILT, 0.0]), lm_damping=0.0
    )
    prefer = ManipulabilityTask("nozzle", model, cost=MANIPULABILITY, manipulability_rate=RATE)
    tasks = [task, prefer, DampingTask(cost=DAMPING)]
    limits = [ConfigurationLimit(model), VelocityLimit(model)]
    configuration = pink.Configuration(model, model.createData(), np.zeros(model.nq))
    data, nozzle = model.createData(), model.getFrameId("nozzle")

    def full(q: Array) -> Array:
        out = np.empty(model.nq)
        out[order] = q
        return out

    def step(q: Array, pose: Array, dt: float) -> tuple[Array, float] | None:
        if not np.array_equal(configuration.q[order], q):  # else it is where the last step has left it
            configuration.update(full(q))
        task.set_target(pin.SE3(pose))
        try:
            velocity = pink.solve_ik(configuration, tasks, dt, SOLVER, limits=limits, safety_break=False)
        except NoSolutionFound:
            return None
        if not np.isfinite(velocity).all():  # so the solver ends at times, and claims to have found a solution
            return None
        configuration.integrate_inplace(velocity, dt)
        return configuration.q[order], float(np.abs(task.compute_error(configuration)[:5]).max())

    def sigma(q: Array) -> float:
        jacobian = pin.computeFrameJacobian(model, data, full(q), nozzle)[:, order[: case.arm_joints]]
        return float(np.linalg.svd(jacobian, compute_uv=False)[-1])

    return follow.planner(case, step, sigma)


if __name__ == "__main__":
    sys.exit(main("pin-pink", prepare))
