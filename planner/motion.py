"""The whole motion: beads and travel joined into one sampled Trajectory."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from planner.cell import Cell
from planner.errors import Refusal
from planner.extrusion import deposited_volume, flow
from planner.plan import TRAVEL, Trajectory
from planner.timing import TimedPath
from planner.toolpath.bead import Toolpath
from planner.travel import Travel

Array = NDArray[np.float64]
BLOCK = 32768  # samples


def join(
    cell: Cell, toolpath: Toolpath, timed: Sequence[TimedPath], travels: Sequence[Travel], dt: float
) -> Trajectory:
    """Travel, bead, travel, …, travel. All pieces start and end at rest, so their common samples coincide."""
    q, bead, layer, s, s_dot, rate, volume = [], [], [], [], [], [], []
    done = 0.0
    for i in range(len(travels)):
        first = 0 if i == 0 else 1  # a piece's first sample is the last one of the piece before
        m = len(travels[i].q) - first
        q.append(travels[i].q[first:])
        bead.append(np.full(m, TRAVEL, dtype=np.int32))
        layer.append(np.full(m, toolpath.beads[min(i, len(timed) - 1)].layer, dtype=np.int32))
        s.append(np.zeros(m))
        s_dot.append(np.full(m, np.nan))
        rate.append(np.zeros(m))
        volume.append(np.full(m, done))
        if i == len(timed):
            break
        piece, line = timed[i], toolpath.beads[i]
        inside = (piece.s[1:] >= 0.0) & (piece.s[1:] <= line.length)
        q.append(piece.q[1:])
        bead.append(np.where(inside, i, TRAVEL).astype(np.int32))
        layer.append(np.full(len(inside), line.layer, dtype=np.int32))
        s.append(np.where(inside, piece.s[1:], 0.0))
        s_dot.append(np.where(inside, piece.s_dot[1:], np.nan))
        if inside.sum() < 2:
            raise Refusal(
                f"path {line.name!r} is only {line.length * 1e3:.2f} mm long, too short for samples {dt * 1e3:g} ms apart",
                bead=i,
            )
        at_edges = deposited_volume(line, piece.edges)
        # what flows in the half sample before the first and after the last one of a bead belongs to the bead
        flowing = flow(at_edges, dt)[1:]
        edge = np.flatnonzero(inside)[[0, -1]]
        flowing[edge[0]] += flowing[: edge[0]].sum()
        flowing[edge[1]] += flowing[edge[1] + 1 :].sum()
        rate.append(np.where(inside, flowing, 0.0))
        volume.append(done + deposited_volume(line, piece.s[1:]))
        done += line.width * line.height * line.length
    joints = np.vstack(q)
    tip, axis, quat = _poses(cell, joints)
    speed = np.concatenate(s_dot)
    moving = np.linalg.norm(np.gradient(tip, dt, axis=0), axis=1)
    speed = np.where(np.isnan(speed), moving, speed)
    beads = np.concatenate(bead)
    turned = np.cumprod(np.where((quat[1:] * quat[:-1]).sum(axis=1) < 0.0, -1.0, 1.0))
    quat[1:] *= turned[:, None]
    return Trajectory(
        dt=dt,
        t=np.arange(len(joints), dtype=np.float64) * dt,
        bead=beads,
        layer=np.concatenate(layer),
        deposit=beads != TRAVEL,
        s=np.concatenate(s),
        q=joints,
        tip=tip,
        quat=quat,
        axis=axis,
        branch=cell.inverse.branches(joints[:, : len(cell.arm)]),
        speed=speed,
        flow=np.concatenate(rate),
        extruded=np.concatenate(volume),
    )


def _poses(cell: Cell, q: Array) -> tuple[Array, Array, Array]:
    """Nozzle tip (n, 3), axis (n, 3) and orientation (n, 4) in the part frame, block by block to bound the memory."""
    tip, axis, quat = np.empty((len(q), 3)), np.empty((len(q), 3)), np.empty((len(q), 4))
    for start in range(0, len(q), BLOCK):
        rows = slice(start, start + BLOCK)
        T_part_nozzle = cell.T_part_nozzle(q[rows])
        tip[rows], axis[rows] = T_part_nozzle[:, :3, 3], T_part_nozzle[:, :3, 2]
        quat[rows] = Rotation.from_matrix(T_part_nozzle[:, :3, :3]).as_quat()
    return tip, axis, quat
