"""What the ways from and to home cost, for each node at which a print could start or end."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from planner.cell import Cell
from planner.readonly import Array
from planner.resolve.nodes import Nodes
from planner.resolve.search import joint_limits
from planner.resolve.search_kernel import TRAVEL_PRICE
from planner.task import NozzleTask

_LOOKS = 9  # postures along a way, by which the tip's way is measured


def ways_home(cell: Cell, tasks: Sequence[NozzleTask], nodes: Nodes, share: float = 1.0) -> tuple[Array, Array]:
    """Prices [s] (rolls, holders, c) of the ways from home to the first rung's nodes, and from the last one's home.

    The holder rests meanwhile. share: of the print that these nodes stand for, if they are those of some of its beads.
    """
    speed = tasks[0].travel_speed
    return (
        share * TRAVEL_PRICE * _times(cell, nodes, 0, speed),
        share * TRAVEL_PRICE * _times(cell, nodes, -1, speed),
    )


def _times(cell: Cell, nodes: Nodes, rung: int, speed: float) -> Array:
    """Time [s] (rolls, holders, c) of the way between home and a rung's nodes, all joints together: the slowest joint's
    from rest to rest, or the tip's at the speed [m/s] that it may have; 0 where there is no posture."""
    v, a, wraps = joint_limits(nodes, cell.limits)
    there = np.isfinite(nodes.price[rung])
    home = cell.home[: len(wraps)]
    way = nodes.q[rung][there].astype(float) - home
    way -= np.where(wraps, 2.0 * np.pi * np.round(way / (2.0 * np.pi)), 0.0)
    v, a, far = v[:-1], a[:-1], np.abs(way)
    by_joints = np.where(far * a < v * v, 2.0 * np.sqrt(far / a), far / v + v / a).max(axis=1, initial=0.0)
    shares = np.linspace(0.0, 1.0, _LOOKS)[:, None]
    postures = home + shares[None] * way[:, None]
    tips = (cell.arm.poses(postures.reshape(-1, len(home))) @ cell.T_flange_nozzle)[:, :3, 3].reshape(-1, _LOOKS, 3)
    by_tip = np.linalg.norm(np.diff(tips, axis=1), axis=2).sum(axis=1) / speed
    times = np.zeros(there.shape)
    times[there] = np.maximum(by_joints, by_tip)
    return times
