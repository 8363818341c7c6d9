"""What was written, read back: is the path that the program describes the plan's path?"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from planner.export.moves import deposits, nearest_fraction
from planner.export.rapid import external_degrees, quadrants
from planner.export.rapid_reader import Program
from planner.export.rotations import angle, continuous, slerp, to_matrix

if TYPE_CHECKING:
    from planner.plan import Plan

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

LEVER = 0.05  # [m/rad]: turning counts as path where the tip stands still
WINDOW = 64  # samples to either side within which a target's own sample is sought
ASTRAY = 2e-4  # m, between a target and its sample: beyond, the whole piece is searched


@dataclass(frozen=True)
class Agreement:
    """The worst differences between a program and its plan (m, rad); inf where they cannot be compared.

    path      linear moves: targets off the planned path, and the path off the lines between targets
    travel    joint moves: the planned tip path off the one that straight joint motion makes
    angle     orientation along linear moves, and of every target; also tool and work object
    external  the part's axes, likewise
    event     where the extruder is switched, against the sample where deposit begins or ends
    frames    positions of tool and work object; the first posture, times 1 m/rad
    speed     moves that lay material: programmed speed against the mean of the samples [m/s]
    conf      targets whose configuration is not that of the plan's posture
    """

    path: float
    travel: float
    angle: float
    external: float
    event: float
    frames: float
    speed: float
    conf: int

    def complaints(self) -> list[str]:
        """Every difference beyond what rounding and thinning may cause, in words."""
        limits = {
            "path": (0.05e-3, "m"),
            "travel": (1e-3, "m"),
            "angle": (np.radians(0.1), "rad"),
            "external": (np.radians(0.1), "rad"),
            "event": (0.05e-3, "m"),
            "frames": (2e-6, "m"),
            "speed": (1e-3, "m/s"),
            "conf": (0, "targets"),
        }
        return [
            f"{name} differs by {getattr(self, name):.3g} {unit} (limit {limit:.3g})"
            for name, (limit, unit) in limits.items()
            if not getattr(self, name) <= limit
        ]


@dataclass(frozen=True)
class Replay:
    """One stretch between extruder on and off: tip (k, 3) [m], orientation (k, 4), part's axes (k, 6) [rad]."""

    position: Array
    quat: Array
    external: Array


@dataclass(frozen=True)
class _Piece:
    """Targets between two extruder events, both included; `linear`, `speed` (m - 1,) are those of the move to the next."""

    position: Array
    quat: Array
    external: Array
    conf: Indices
    linear: NDArray[np.bool_]
    speed: Array
    known: NDArray[np.bool_]  # a target of the program, not a point where a trigger cuts a move


def replay(program: Program, step: float = 0.5e-3) -> tuple[Replay, ...]:
    """Dense path of every stretch with the extruder on, at most `step` [m] between its points."""
    out = []
    for piece in [piece for on, piece in _pieces(program) if on]:
        parts = np.maximum(1, np.ceil(np.linalg.norm(np.diff(piece.position, axis=0), axis=1) / step)).astype(np.intp)
        a = np.append(np.repeat(np.arange(len(parts)), parts), len(parts) - 1)
        u = np.append((np.arange(len(a) - 1) - np.repeat(np.cumsum(parts) - parts, parts)) / parts[a[:-1]], 1.0)
        between = u[:, None]
        out.append(
            Replay(
                position=piece.position[a] + between * (piece.position[a + 1] - piece.position[a]),
                quat=slerp(piece.quat[a], piece.quat[a + 1], u),
                external=piece.external[a] + between * (piece.external[a + 1] - piece.external[a]),
            )
        )
    return tuple(out)


def compare(plan: Plan, program: Program) -> Agreement:
    """Worst differences between the plan and a program that was read back."""
    trajectory = plan.trajectory
    first, last = deposits(trajectory)
    pieces = list(_pieces(program))
    cuts = np.concatenate([[0], np.column_stack([first, last]).ravel(), [len(trajectory) - 1]])
    expected_on = [k % 2 == 1 for k in range(len(cuts) - 1)]
    if [on for on, _ in pieces] != expected_on:
        return Agreement(np.inf, np.inf, np.inf, np.inf, np.inf, np.inf, np.inf, len(program.conf))
    worst = np.zeros(5)
    event, conf = 0.0, 0
    for k, (on, piece) in enumerate(pieces):
        found, wrong = _compare_piece(plan, piece, int(cuts[k]), int(cuts[k + 1]), on)
        worst, conf = np.maximum(worst, found), conf + wrong
        if k:
            event = max(event, float(np.linalg.norm(piece.position[0] - trajectory.tip[cuts[k]])))
    frames, turned = _frames(plan, program)
    return Agreement(
        path=float(worst[0]),
        travel=float(worst[1]),
        angle=max(float(worst[2]), turned),
        external=float(worst[3]),
        event=event,
        frames=frames,
        speed=float(worst[4]),
        conf=conf,
    )


def _pieces(program: Program) -> Iterator[tuple[bool, _Piece]]:
    """The program's targets, cut at the points where the extruder is switched: (extruder on, piece)."""
    rows = np.column_stack([program.position, program.quat, program.external, program.conf])
    begun: list[Array] = [rows[0]]
    by: list[int] = []  # the move that goes from each target to the next
    known: list[bool] = [True]
    on = False

    def piece() -> _Piece:
        table = np.array(begun)
        return _Piece(
            position=table[:, :3],
            quat=continuous(table[:, 3:7]),
            external=table[:, 7:13],
            conf=table[:, 13:].astype(np.intp),
            linear=program.linear[np.array(by, dtype=np.intp)],
            speed=program.speed[np.array(by, dtype=np.intp), 0],
            known=np.array(known, dtype=bool),
        )

    for i in range(1, len(rows)):
        length = float(np.linalg.norm(program.position[i] - program.position[i - 1]))
        events = []
        for trigger in program.triggers.get(i, ()):
            at = trigger.distance if trigger.from_start else length - trigger.distance
            events.append((min(max(at / length, 0.0), 1.0) if length else float(not trigger.from_start), trigger.value))
        for u, value in sorted(events, key=lambda event: event[0]):
            cut = rows[i - 1] + u * (rows[i] - rows[i - 1])
            cut[3:7] = slerp(rows[i - 1 : i, 3:7], rows[i : i + 1, 3:7], np.array([u]))[0]
            if u > 0.0:
                begun.append(rows[i] if u == 1.0 else cut)
                by.append(i)
                known.append(u == 1.0)
            if len(begun) > 1 or on != value:
                yield on, piece()
            begun, by, known, on = [begun[-1]], [], [known[-1]], value
        if not events or events[-1][0] < 1.0:
            begun.append(rows[i])
            by.append(i)
            known.append(True)
    yield on, piece()


def _compare_piece(plan: Plan, piece: _Piece, first: int, last: int, on: bool) -> tuple[Array, int]:
    """Worst (path, travel, angle, external, speed) of one piece against samples first..last, and wrong configurations."""
    trajectory, na = plan.trajectory, len(plan.cell.arm)
    rows = slice(first, last + 1)
    tip, quat, q = trajectory.tip[rows], continuous(trajectory.quat[rows]), trajectory.q[rows]
    external = np.radians(external_degrees(plan.cell, q[:, na:]))
    k = external.shape[1]
    unused = np.isnan(piece.external[:, k:]).all() and not np.isnan(piece.external[:, :k]).any()

    at = _own_samples(piece.position, piece.quat, tip, quat)
    off, turned, shifted = [], [], []
    for nearer in (np.maximum(at - 1, 0), at):  # the piece of planned path before and after each target's sample
        after = np.minimum(nearer + 1, len(tip) - 1)
        u = nearest_fraction(tip[nearer], tip[after], piece.position, np.zeros(len(at)))
        off.append(np.linalg.norm(tip[nearer] + u[:, None] * (tip[after] - tip[nearer]) - piece.position, axis=1))
        turned.append(angle(slerp(quat[nearer], quat[after], u), piece.quat))
        between = external[nearer] + u[:, None] * (external[after] - external[nearer])
        shifted.append(np.abs(between - piece.external[:, :k]).max(axis=1, initial=0.0))
    best = np.argmin(off, axis=0)[None]
    worst = np.zeros(5)
    worst[0] = np.take_along_axis(np.array(off), best, axis=0).max()
    worst[2] = np.take_along_axis(np.array(turned), best, axis=0).max()
    worst[3] = np.take_along_axis(np.array(shifted), best, axis=0).max() if unused else np.inf

    if len(at) > 1:
        sample = np.arange(len(tip))
        owner = np.clip(np.searchsorted(at, sample, side="right") - 1, 0, len(at) - 2)
        line = piece.linear[owner]
        a, s = owner[line], sample[line]
        if len(a):
            p = piece.position
            u = nearest_fraction(p[a], p[a + 1], tip[s], _share(at, a, s))
            worst[0] = max(worst[0], np.linalg.norm(p[a] + u[:, None] * (p[a + 1] - p[a]) - tip[s], axis=1).max())
            worst[2] = max(worst[2], angle(slerp(piece.quat[a], piece.quat[a + 1], u), quat[s]).max())
            between = piece.external[a, :k] + u[:, None] * (piece.external[a + 1, :k] - piece.external[a, :k])
            worst[3] = max(worst[3], np.abs(between - external[s]).max(initial=0.0))
        a, s = owner[~line], sample[~line]
        if len(a):
            qa, qb = q[at[a]], q[at[a + 1]]
            u = nearest_fraction(qa, qb, q[s], _share(at, a, s))
            T = plan.cell.T_part_nozzle(qa + u[:, None] * (qb - qa))
            worst[1] = np.linalg.norm(T[:, :3, 3] - tip[s], axis=1).max()
    if on:
        path = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(tip, axis=0), axis=1))])
        real = np.diff(path[at]) / np.maximum(np.diff(at) * trajectory.dt, trajectory.dt)
        worst[4] = np.abs(real - piece.speed).max(initial=0.0)
    # a target rounded across a quarter turn belongs to its neighbour sample
    planned = np.column_stack([quadrants(q), trajectory.branch[rows]])
    near = [planned[np.clip(at + d, 0, len(tip) - 1)] for d in (-1, 0, 1)]
    right = np.any([(piece.conf == conf).all(axis=1) for conf in near], axis=0)
    return worst, int(np.count_nonzero(piece.known & ~right))


def _share(at: Indices, a: Indices, s: Indices) -> Array:
    out: Array = (s - at[a]) / np.maximum(at[a + 1] - at[a], 1)
    return out


def _own_samples(position: Array, quat: Array, tip: Array, sample_quat: Array) -> Indices:
    """Sample of each target, ascending: the nearest one, around the place that the way travelled so far points to."""

    def way(p: Array, o: Array) -> Array:
        steps = np.linalg.norm(np.diff(p, axis=0), axis=1) + LEVER * angle(o[1:], o[:-1])
        return np.concatenate([[0.0], np.cumsum(steps)])

    planned, written = way(tip, sample_quat), way(position, quat)
    guess = written * (planned[-1] / written[-1]) if written[-1] > 0.0 else written

    def nearest(i: Indices, near: Indices) -> tuple[Indices, Array]:
        gap = tip[near] - position[i, None]
        cost = np.sqrt(np.einsum("ijk,ijk->ij", gap, gap))
        same = np.minimum(np.abs(np.einsum("ijk,ik->ij", sample_quat[near], quat[i])), 1.0)
        cost += LEVER * np.sqrt(8.0 * (1.0 - same))  # the angle, to third order
        # the last term only decides where the path meets itself
        best = np.argmin(cost + 1e-3 * np.abs(planned[near] - guess[i, None]), axis=1)
        row = np.arange(len(i))
        return near[row, best], cost[row, best]

    every = np.arange(len(position))
    centre = np.searchsorted(planned, guess)
    at, cost = nearest(every, np.clip(centre[:, None] + np.arange(-WINDOW, WINDOW + 1), 0, len(tip) - 1))
    for i in every[cost > ASTRAY]:  # joint moves cut wide turns short, and the guess is then far off
        at[i] = nearest(np.array([i]), np.arange(len(tip))[None])[0][0]
    at = np.maximum.accumulate(at)
    at[0], at[-1] = 0, len(tip) - 1
    return at


def _frames(plan: Plan, program: Program) -> tuple[float, float]:
    """Worst difference of tool, work object and first posture: position [m], orientation [rad]."""
    cell = plan.cell
    identity = np.eye(4)
    moving = cell.holder_robot is not None
    far, turned = [], []
    for written, T in (
        (program.tool, cell.T_flange_nozzle),
        (program.uframe, identity if moving else cell.T_world_holder),
        (program.oframe, identity),
    ):
        far.append(float(np.linalg.norm(written[:3] - T[:3, 3])))
        cosine = 0.5 * (np.trace(to_matrix(written[None, 3:])[0].T @ T[:3, :3]) - 1.0)
        turned.append(float(np.arccos(min(1.0, cosine))) if cosine < 1.0 - 1e-9 else 0.0)
    na = len(cell.arm)
    start = plan.trajectory.q[:1]
    posture = np.concatenate([start[0, :na], np.radians(external_degrees(cell, start[:, na:]))[0]])
    difference = np.abs(program.start[: len(posture)] - posture).max()
    if moving != bool(program.station) or np.isnan(difference) or not np.isnan(program.start[len(posture) :]).all():
        return float("inf"), max(turned)
    return max(*far, float(difference)), max(turned)
