"""Fewest points whose quintic splines repeat the planned joints.

Of a point with position, velocity and acceleration, ROS's joint_trajectory_controller makes a polynomial of degree 5 to
the next one (ros2_controllers, "Trajectory Representation"), so that is what the points are chosen for.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy.interpolate import CubicSpline

from planner.export.moves import ANGLE_TOLERANCE, ROUNDING, TRAVEL_TOLERANCE
from planner.export.rotations import to_matrix
from planner.export.thinning import Indices, by_samples, thin
from planner.readonly import Array

if TYPE_CHECKING:
    from planner.plan import Plan


FARTHEST = 64  # samples between two points, at most: where thinning starts
VELOCITY_SHARE = 0.005  # of a joint's limit, by which the splines may miss the planned velocity
ACCELERATION_SHARE = 0.05  # likewise; where jerk jumps, samples tell the acceleration no better


@dataclass(frozen=True)
class Knots:
    """k points of a joint trajectory: time (k) [s] from its start; q, velocity, acceleration (k, nj) [rad, s]."""

    time: Array
    q: Array
    velocity: Array
    acceleration: Array

    def __len__(self) -> int:
        return len(self.time)

    def chosen(self, rows: Indices) -> Knots:
        """Some of the points."""
        return Knots(self.time[rows], self.q[rows], self.velocity[rows], self.acceleration[rows])


def derived(plan: Plan) -> Knots:
    """Every sample as a point; velocity and acceleration are those of the cubic spline through all, from rest to rest."""
    trajectory = plan.trajectory
    time = trajectory.t - trajectory.t[0]
    spline = CubicSpline(time, trajectory.q, bc_type="clamped")
    return Knots(time, trajectory.q, spline(time, 1), spline(time, 2))


def plan_knots(plan: Plan) -> Knots:
    """The points of a plan: as few of its samples as repeat all others within its tolerances."""
    dense = derived(plan)
    last = len(dense) - 1
    kept = np.unique(np.append(np.arange(0, last, FARTHEST), last))
    nozzle = Nozzle(plan)

    def misfit(a: Indices, b: Indices, k: Indices) -> Array:
        q, velocity, acceleration = quintic(dense.chosen(a), dense.chosen(b), dense.time[k])
        worst = nozzle.misfit(q, k)
        joints = np.abs(q - dense.q[k]).max(axis=1) / ANGLE_TOLERANCE
        limits = plan.cell.limits
        fast = np.abs(velocity - dense.velocity[k]) / (VELOCITY_SHARE * limits.velocity)
        steep = np.abs(acceleration - dense.acceleration[k]) / (ACCELERATION_SHARE * limits.acceleration)
        out: Array = np.maximum.reduce([worst, joints, fast.max(axis=1), steep.max(axis=1)])
        return out

    return dense.chosen(thin(kept, by_samples(misfit)))


class Nozzle:
    """How far postures hold the nozzle from where the samples of a plan have it."""

    def __init__(self, plan: Plan) -> None:
        self._plan = plan
        self._rotation = to_matrix(plan.trajectory.quat / np.linalg.norm(plan.trajectory.quat, axis=1, keepdims=True))

    def misses(self, q: Array, k: Indices) -> tuple[Array, Array]:
        """Distance [m] of the tip and angle [rad], each (m), of postures q (m, nj) from samples k (m)."""
        T = self._plan.cell.T_part_nozzle(q)
        off = np.linalg.norm(T[:, :3, 3] - self._plan.trajectory.tip[k], axis=1)
        # the chord between two rotations, in Frobenius' norm, is sqrt(8) sin(angle / 2)
        chord = np.linalg.norm(T[:, :3, :3] - self._rotation[k], axis=(1, 2))
        return off, 2.0 * np.arcsin(np.minimum(chord / np.sqrt(8.0), 1.0))

    def misfit(self, q: Array, k: Indices) -> Array:
        """The worse of both, in tolerances."""
        off, turned = self.misses(q, k)
        chord = self._plan.problem.program.chord - ROUNDING
        out: Array = np.maximum(
            off / np.where(self._plan.trajectory.deposit[k], chord, TRAVEL_TOLERANCE), turned / ANGLE_TOLERANCE
        )
        return out


def quintic(a: Knots, b: Knots, time: Array) -> tuple[Array, Array, Array]:
    """Position, velocity and acceleration (m, nj) at times (m) between points a (m) and b (m)."""
    h = (b.time - a.time)[:, None]
    u = (time - a.time)[:, None] / h
    # Taylor's polynomial from a, and three terms more that end in b's state; the remainders r are in units of position
    r0 = b.q - a.q - h * a.velocity - 0.5 * h**2 * a.acceleration
    r1 = h * (b.velocity - a.velocity) - h**2 * a.acceleration
    r2 = h**2 * (b.acceleration - a.acceleration)
    c3 = 10.0 * r0 - 4.0 * r1 + 0.5 * r2
    c4 = -15.0 * r0 + 7.0 * r1 - r2
    c5 = 6.0 * r0 - 3.0 * r1 + 0.5 * r2
    c1, c2 = h * a.velocity, 0.5 * h**2 * a.acceleration
    q = a.q + u * (c1 + u * (c2 + u * (c3 + u * (c4 + u * c5))))
    velocity = (c1 + u * (2.0 * c2 + u * (3.0 * c3 + u * (4.0 * c4 + u * 5.0 * c5)))) / h
    acceleration = (2.0 * c2 + u * (6.0 * c3 + u * (12.0 * c4 + u * 20.0 * c5))) / h**2
    return q, velocity, acceleration


def at_times(knots: Knots, time: Array) -> tuple[Array, Array, Array]:
    """Position, velocity and acceleration (m, nj) at times (m) of a trajectory of at least two points."""
    first = np.clip(np.searchsorted(knots.time, time, side="right") - 1, 0, len(knots) - 2)
    return quintic(knots.chosen(first), knots.chosen(first + 1), time)
