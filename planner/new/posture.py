"""Where a part may stand so that an arm reaches all of it with room to spare, and the posture to begin from."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from planner.base.arrays import Array
from planner.cell.cell import frame_from_z, turned_into
from planner.cell.robot import Robot, chain_of

ROLLS = 24  # tried rotations about the nozzle's axis
REDUNDANT = 9  # tried angles of a redundant joint, over the middle half of its range
GOOD_ANGLE = np.radians(30.0)  # from an end stop: more of it is no better
GOOD_SIGMA = 0.2  # likewise, of the least singular value of the Jacobian (metres)
FAR = (0.4, 0.5, 0.55, 0.6, 0.65, 0.7, 0.75)  # tried distances of the part from the base, as shares of the reach
HIGH = (0.0, 0.15, 0.3, 0.45)  # and heights
MOST_POSTURES = 8
DIFFERENT = np.radians(25.0)  # of some joint: postures that are nearer are one
ROUND = 0.01  # m: places are round figures
OUT = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True)
class Reached:
    """How well points are reached.

    worth     of the worst one, from 0 (out of reach) to 1
    postures  (m, n) of the first point [rad], the best one first, none like another; links may be too near each other in one
    """

    worth: float
    postures: Array


def reached(robot: Robot, tip: Array, points: Array, axis: Array, along: Array = OUT) -> Reached:
    """How well an arm at the world's origin reaches points (k, 3) [m] with its nozzle along an axis (world).

    tip, along  of the nozzle in the flange frame [m], and where it points there; the flange's z mostly
    """
    inverse, model = robot.inverse, robot.model
    if inverse is None:
        raise ValueError(f"{robot.key} is no arm")
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
    """The best of postures (m, n) that differ from each other; worth (m) is 0 of those that are none."""
    kept: list[Array] = []
    for i in np.argsort(-worth, kind="stable"):
        if not worth[i] > 0.0 or len(kept) == MOST_POSTURES:
            break
        if all(np.abs(q[i] - other).max() > DIFFERENT for other in kept):
            kept.append(q[i])
    return np.array(kept).reshape(len(kept), q.shape[1])


def usual_place(robot: Robot, tip: Array, points: Array, axis: Array, reach: float) -> Array | None:
    """The round place (3) [m] in front of an arm from which points (k, 3) of a part's frame are reached best; None where there
    is no place from which all are."""
    best, place = 0.0, None
    for high in HIGH:
        for far in FAR:
            at = np.round(np.array([far, 0.0, high]) * reach / ROUND) * ROUND
            worth = reached(robot, tip, at + points, axis).worth
            if worth > best + 1e-6:
                best, place = worth, at
    return place
