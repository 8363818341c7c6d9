"""Where a part may stand so that an arm reaches all of it with room to spare, and the posture to begin from."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from planner.base.arrays import Array
from planner.cell.cell import frame_from_z, turned_into
from planner.cell.robot import Robot, chain_of

ROLLS = 24  # rotations about the nozzle axis to try
REDUNDANT = 9  # angles of a redundant joint to try, over the middle half of its range
GOOD_ANGLE = np.radians(30.0)  # rad from an end stop: more than this counts as no better
GOOD_SIGMA = 0.2  # likewise for the smallest singular value of the Jacobian (lengths in metres)
FAR = (0.4, 0.5, 0.55, 0.6, 0.65, 0.7, 0.75)  # distances of the part from the base to try, as fractions of the reach
HIGH = (0.0, 0.15, 0.3, 0.45)  # heights to try, likewise
MOST_POSTURES = 8
DIFFERENT = np.radians(25.0)  # rad: postures that differ by less in every joint count as one
ROUND = 0.01  # m: places are rounded to this
OUT = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True)
class Reached:
    """How well points are reached.

    worth     of the worst point, from 0 (out of reach) to 1
    postures  (m, n) that reach the first point [rad], best first, no two alike; in some, links may be too close to each
              other
    """

    worth: float
    postures: Array


def reached(robot: Robot, tip: Array, points: Array, axis: Array, along: Array = OUT) -> Reached:
    """How well an arm at the world's origin reaches points (k, 3) [m] with its nozzle along an axis (world).

    tip, along  the nozzle's tip [m] and its direction in the flange frame; by default, it points along z
    """
    inverse, model = robot.inverse, robot.model
    if inverse is None:
        raise ValueError(f"{robot.key} is not an arm")
    T_flange_nozzle = frame_from_z(tip, along)
    turns = np.linspace(0.0, 2.0 * np.pi, ROLLS, endpoint=False)
    about = np.tile(np.eye(4), (ROLLS, 1, 1))
    about[:, 0, 0] = about[:, 1, 1] = np.cos(turns)
    about[:, 1, 0], about[:, 0, 1] = np.sin(turns), -np.sin(turns)
    starts = np.array([frame_from_z(point, axis) for point in points])
    poses = starts[:, None] @ about[None] @ np.linalg.inv(T_flange_nozzle)
    chosen = np.zeros(1)
    if (j := inverse.redundant_joint) is not None:
        low, high = model.lowerPositionLimit[j], model.upperPositionLimit[j]
        chosen = np.linspace(low + (high - low) / 4.0, high - (high - low) / 4.0, REDUNDANT)
    many = np.repeat(poses.reshape(-1, 4, 4), len(chosen), axis=0)
    q, there = inverse.solve(many, np.tile(chosen, len(poses) * ROLLS))
    q, there = q.reshape(len(points), -1, inverse.joints), there.reshape(len(points), -1)
    q = turned_into(q, model.lowerPositionLimit, model.upperPositionLimit)
    room = np.minimum(q - model.lowerPositionLimit, model.upperPositionLimit - q).min(axis=-1)
    chain = chain_of(robot, np.eye(4), T_flange_nozzle, robot.joint_names, {})
    sigma = np.zeros(there.shape)
    sigma[there] = np.linalg.svd(chain.jacobians(q[there]), compute_uv=False)[:, -1]
    worth = np.where(
        there, np.minimum(np.clip(room / GOOD_ANGLE, 0.0, 1.0), np.clip(sigma / GOOD_SIGMA, 0.0, 1.0)), 0.0
    )
    return Reached(float(worth.max(axis=1).min()), _unlike(q[0], worth[0]))


def _unlike(q: Array, worth: Array) -> Array:
    """The best of the postures q (m, n) that differ from each other; worth (m) is 0 where none was found."""
    kept: list[Array] = []
    for i in np.argsort(-worth, kind="stable"):
        if not worth[i] > 0.0 or len(kept) == MOST_POSTURES:
            break
        if all(np.abs(q[i] - other).max() > DIFFERENT for other in kept):
            kept.append(q[i])
    return np.array(kept).reshape(len(kept), q.shape[1])


def usual_place(robot: Robot, tip: Array, points: Array, axis: Array, reach: float) -> Array | None:
    """The best place (3) [m], rounded, in front of an arm for a part whose points (k, 3), in the part's frame [m], it
    has to reach; None if no place brings all of them within reach."""
    best, place = 0.0, None
    for high in HIGH:
        for far in FAR:
            at = np.round(np.array([far, 0.0, high]) * reach / ROUND) * ROUND
            worth = reached(robot, tip, at + points, axis).worth
            if worth > best + 1e-6:
                best, place = worth, at
    return place
