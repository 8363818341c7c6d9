"""The whole motion: beads and travel laid end to end in time, and sampled as one Trajectory."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from planner.base.arrays import Array
from planner.base.errors import Refusal
from planner.cell.cell import Cell
from planner.motion.cubics import Cubics, chain, rest
from planner.motion.extrusion import Span, events, extruded_volume, feed_of_materials, flow
from planner.motion.interlayer import begins, lags_of
from planner.motion.timing.timed_path import TimedPath
from planner.motion.travel.plan import Travel, ViaRest
from planner.motion.visits import Rest, Visit, rest_of, visits
from planner.plan import TRAVEL, Trajectory
from planner.plan.plan import by_nozzle
from planner.problem.process import ProcessSpec
from planner.toolpath.bead import Bead, Toolpath
from planner.toolpath.contacts import BeadContacts
from planner.toolpath.runs import least_travel_time

BLOCK = 32768  # samples
_SLIGHT = 1e-3  # s: shorter waits are left out
_ON_TIME = 1e-9  # share of dt: an instant this soon after a sample counts as on it


def join(
    cell: Cell,
    toolpath: Toolpath,
    process: ProcessSpec,
    timed: Sequence[TimedPath],
    travels: Sequence[Travel],
    dt: float,
    touching: BeadContacts | None = None,
) -> Trajectory:
    """Rest at home while the extruder gets ready, then travel, bead, travel, …, travel, sampled every dt [s].

    timed: all beads of the toolpath, or the last ones; touching: which places lie on which, see `contacts_within`.
    Travel by way of home rests there as long as its visit takes (see `visits`), or until the material below is old
    enough. The robot ends at rest.
    """
    before = len(toolpath.beads) - len(timed)
    rests = _rests(toolpath, process, timed, travels, touching)
    moves = [_whole(travel, process, rests.get(before + k)) for k, travel in enumerate(travels)]
    pieces: list[TimedPath | Cubics] = [chain([rest(moves[0].start.q, process.start.time), moves[0]])]
    for path, move in zip(timed, moves[1:], strict=True):
        pieces += [path, move]
    starts = np.concatenate([[0.0], np.cumsum([piece.duration for piece in pieces])])
    first = np.ceil(starts / dt - _ON_TIME).astype(int)  # sample of each piece
    first[-1] += 1
    n = int(first[-1])
    t = np.arange(n, dtype=np.float64) * dt
    q = np.empty((n, len(cell.joint_names)))
    s, s_dot, rate, volume = np.zeros(n), np.full(n, np.nan), np.zeros(n), np.zeros(n)
    bead, layer = np.full(n, TRAVEL, dtype=np.int32), np.empty(n, dtype=np.int32)
    begun = np.zeros(n, dtype=np.int32)  # the last bead begun, from its run-in on
    done = 0.0
    for k, piece in enumerate(pieces):
        rows, i = slice(first[k], first[k + 1]), before + k // 2
        layer[rows] = toolpath.beads[min(i, len(toolpath.beads) - 1)].layer
        volume[rows] = done
        begun[rows] = max(i - (k % 2 == 0), before)
        if isinstance(piece, Cubics):
            q[rows] = piece.joints(t[rows] - starts[k])
            continue
        line = toolpath.beads[i]
        half = np.arange(2 * first[k] - 1, 2 * first[k + 1]) * (0.5 * dt) - starts[k]  # edge, sample, edge, …, edge
        joints, way = piece.at(half)
        laid, at = extruded_volume(line, process, half, way), way[1::2]
        inside = (at >= 0.0) & (at <= line.length)
        if inside.sum() < 2:
            raise Refusal(_too_short(line, dt), bead=i)
        q[rows] = joints[1::2]
        bead[rows] = np.where(inside, i, TRAVEL)
        s[rows] = np.where(inside, at, 0.0)
        s_dot[rows] = np.where(inside, np.diff(way[0::2]) / dt, np.nan)
        rate[rows] = _flow(laid[0::2], inside, dt)
        volume[rows] = done + laid[1::2]
        done += float(laid[-1])
    told = events(process, _spans(process, toolpath, timed, rests, starts))
    materials = [line.material for line in toolpath.beads]
    tip, axis, quat, moving = np.empty((n, 3)), np.empty((n, 3)), np.empty((n, 4)), np.empty(n)
    for own, rows in by_nozzle(cell, told, t):
        tip[rows], axis[rows], quat[rows] = _poses(own, q[rows])
        moving[rows] = np.linalg.norm(np.gradient(tip[rows], dt, axis=0), axis=1)
    turned = np.cumprod(np.where((quat[1:] * quat[:-1]).sum(axis=1) < 0.0, -1.0, 1.0))
    quat[1:] *= turned[:, None]
    return Trajectory(
        dt=dt,
        t=t,
        bead=bead,
        layer=layer,
        deposit=bead != TRAVEL,
        s=s,
        q=q,
        tip=tip,
        quat=quat,
        axis=axis,
        branch=cell.inverse.branches(q[:, : len(cell.arm)]),
        speed=np.where(np.isnan(s_dot), moving, s_dot),
        flow=rate,
        extruded=volume,
        feed=feed_of_materials(process, materials, begun, t, bead, volume, rate, told),
        events=told,
        first_bead=before,
    )


def _rests(
    toolpath: Toolpath,
    process: ProcessSpec,
    timed: Sequence[TimedPath],
    travels: Sequence[Travel],
    touching: BeadContacts | None,
) -> dict[int, Rest]:
    """When and how long the robot rests before beads, by bead index."""
    if not any(isinstance(travel, ViaRest) for travel in travels):
        return {}
    by_home, beads = visits(process, toolpath.beads, timed), toolpath.beads
    start = None  # when beads are to begin, after the first one's start [s]
    if touching is not None:
        start = begins(process, toolpath, timed, travels, lags_of(process, toolpath, timed, touching))
    before, now, first = len(beads) - len(timed), process.start.time, 0.0
    found: dict[int, Rest] = {}
    begun: list[float] = []  # when the beads began to be laid [s]
    for k, (path, travel) in enumerate(zip(timed, travels, strict=False)):
        if isinstance(travel, ViaRest):
            visit, now = by_home.get(before + k, Visit()), now + travel.out.duration
            layer = 0.0 if visit.layer_before is None else begun[visit.layer_before - before]
            rest = rest_of(process, visit, now, travel.back.duration + path.when(0.0), layer)
            if start is not None:
                due = first + float(start[k]) - travel.back.duration
                lacking = due - now - rest.time(process)
                rest = replace(rest, cool=rest.cool + lacking) if lacking > _SLIGHT else rest
            found[before + k] = rest
            now += found[before + k].time(process) + travel.back.duration
        else:
            now += travel.duration
        first = now if k == 0 else first
        begun.append(now + path.when(0.0))
        now += path.duration
    return found


def _whole(travel: Travel, process: ProcessSpec, at_home: Rest | None) -> Cubics:
    """A travel as one motion, with its rest, if it has one."""
    if not isinstance(travel, ViaRest):
        return travel
    time = 0.0 if at_home is None else at_home.time(process)
    return chain([travel.out, rest(travel.out.end.q, time), travel.back])


def _spans(
    process: ProcessSpec,
    toolpath: Toolpath,
    timed: Sequence[TimedPath],
    rests: Mapping[int, Rest],
    starts: Array,
) -> list[Span]:
    """When the beads are laid down, if the extruder does anything before, in or after them.

    starts: of all pieces, alternating travel and beads [s].
    """
    if least_travel_time(process) <= 0.0 and process.fibre is None and not process.materials and not rests:
        return []
    spans = []
    before = len(toolpath.beads) - len(timed)
    for i, (path, bead) in enumerate(zip(timed, toolpath.beads[before:], strict=True)):
        at = float(starts[2 * i + 1])
        stops = tuple(at + begin for begin, _ in path.rests)
        begin, end = at + path.when(0.0), at + path.when(bead.length)
        spans.append(Span(before + i, begin, end, stops, bead.material, rests.get(before + i)))
    return spans


def _too_short(line: Bead, dt: float) -> str:
    return f"path {line.name!r} is only {line.length * 1e3:.2f} mm long, too short for samples {dt * 1e3:g} ms apart"


def _flow(at_edges: Array, inside: NDArray[np.bool_], dt: float) -> Array:
    """Mean flow (m) of a bead's samples, from the volume (m + 1) laid down half a sample before and after each."""
    flowing = flow(at_edges, dt)
    # flow in the half sample before a bead's first sample and after its last one belongs to the bead
    start, end = np.flatnonzero(inside)[[0, -1]]
    flowing[start] += flowing[:start].sum()
    flowing[end] += flowing[end + 1 :].sum()
    return np.where(inside, flowing, 0.0)


def _poses(cell: Cell, q: Array) -> tuple[Array, Array, Array]:
    """Nozzle tip (n, 3), axis (n, 3) and orientation (n, 4) in the part frame, block by block to bound the memory."""
    tip, axis, quat = np.empty((len(q), 3)), np.empty((len(q), 3)), np.empty((len(q), 4))
    for start in range(0, len(q), BLOCK):
        rows = slice(start, start + BLOCK)
        T_part_nozzle = cell.T_part_nozzle(q[rows])
        tip[rows], axis[rows] = T_part_nozzle[:, :3, 3], T_part_nozzle[:, :3, 2]
        quat[rows] = Rotation.from_matrix(T_part_nozzle[:, :3, :3], assume_valid=True).as_quat()
    return tip, axis, quat
