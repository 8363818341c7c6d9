"""How differential inverse kinematics is walked along waypoints, the same for every solver of it."""

from __future__ import annotations

import itertools
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from side import Case, Plan

Array = NDArray[np.float64]
Step = Callable[[Array, Array, float], tuple[Array, float] | None]

CLOSE = 3e-6  # m and rad off a waypoint at which the next one is taken
TRIES = 20  # steps at a waypoint
APPROACH = 600  # steps to the first waypoint of a bead
SETTLE = 300  # of these, at least, before the first bead
TICK = 0.025  # s that a step of the approach takes
# Postures to start from: home, with these angles of the last three joints [rad].
WRISTS = ((-2.0, -1.0, 0.0, 1.0, 2.0), (-0.8, 0.8), (-2.0, 0.0, 2.0))
LOOKS = 60  # waypoints of the first bead at which a start is tried
DRIFT = 10  # steps at each of these, at most, in place of those between them


def planner(case: Case, step: Step, sigma: Callable[[Array], float]) -> Plan:
    """Choose a start, which is not timed, and return what follows beads from there.

    step(q, pose, dt) makes one step from joints q (nj) within dt [s]: joints, and how far they are then off the pose
    [m, rad]; None where there is no solution. sigma(q): least singular value of the arm's Jacobian.
    """

    def reach(q: Array, pose: Array, dt: float, tries: int, least: int = 0) -> tuple[Array, float]:
        """Step until the pose is met, at least so many times; joints, and how far they are off in the end."""
        off = np.inf
        for k in range(tries):
            done = step(q, pose, dt)
            if done is None:
                break
            q, off = done
            if off < CLOSE and k >= least:
                break
        return q, off

    def follow(q: Array, poses: Array, settle: int, least: int = 0) -> tuple[Array, Array]:
        """Joints (n, nj) at poses, and how far they are off (n); least steps at each, for poses that are left out."""
        out, off = np.empty((len(poses), len(q))), np.empty(len(poses))
        q, _ = reach(q, poses[0], TICK, APPROACH, settle)
        apart = np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1)
        lasts = np.maximum(np.concatenate([apart[:1], apart]) / case.speed, 1e-4) / (1 + least)
        for i, pose in enumerate(poses):
            q, off[i] = reach(q, pose, float(lasts[i]), TRIES + least, least)
            out[i] = q
        return out, off

    def rating(start: Array) -> float:
        """Least distance from singularities and limits along the first bead, in long steps; less by what is off."""
        skip = max(1, len(case.beads[0]) // LOOKS)
        q, off = follow(start, case.beads[0][::skip], SETTLE, min(skip - 1, DRIFT))
        margin = np.minimum(q - case.q_min, case.q_max - q).min()
        return float(min(margin, min(map(sigma, q))) - 1e3 * min(off.max(), 1.0))

    start = max(_starts(case), key=rating)

    def plan(beads: list[Array]) -> tuple[list[Array], str]:
        q, out, offs = start, [], []
        for i, poses in enumerate(beads):
            joints, off = follow(q, poses, SETTLE if i == 0 else 0)
            q = joints[-1]
            out.append(joints)
            offs.append(off)
        off = np.concatenate(offs)
        missed = int((off >= CLOSE).sum())
        return out, f"{missed} waypoints missed, by up to {off.max():.2g}" if missed else ""

    return plan


def _starts(case: Case) -> list[Array]:
    """Home, and home with other angles of the wrist, all within limits."""
    starts = [np.clip(case.home, case.q_min, case.q_max)]
    for wrist in itertools.product(*WRISTS):
        posture = case.home.copy()
        posture[case.arm_joints - 3 : case.arm_joints] = wrist
        starts.append(np.clip(posture, case.q_min, case.q_max))
    return starts
