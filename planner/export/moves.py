"""From samples to moves: which targets a controller needs, and how each is approached."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from planner.export.beside import chosen_targets
from planner.export.fit import Poses, Way
from planner.export.reached import reached
from planner.export.rests import Rests, Wait, rests_of
from planner.export.rotations import angle, continuous
from planner.export.thinning import Indices, by_samples
from planner.readonly import Array, Flags

if TYPE_CHECKING:
    from planner.plan import Plan, Trajectory


ROUNDING = 1e-6  # [m]; what the numbers in the file take of the tolerance of the path
ANGLE_TOLERANCE = np.radians(0.045)  # orientation and the part's axes [rad]; likewise of 0.05 deg
TIME_TOLERANCE = 8e-3  # [s]; keeps dips of the speed in the program
LONGEST = 9.5e-3  # [m] of path between two targets in a bead: at most 10 mm with the rounding to samples
TRAVEL_TOLERANCE = 0.2e-3  # [m]; joint moves against the planned tip path
TRAVEL_ANGLE_TOLERANCE = np.radians(0.5)


@dataclass(frozen=True)
class Moves:
    """m moves, each to one sample of the trajectory; the first starts where the trajectory does.

    sample  (m,)   index of the sample that is the target
    start   (m,)   index of the sample from which the move sets out: behind a wait, where there is one
    linear  (m,)   straight line in the part frame; otherwise straight in joint space
    laid    (m,)   material flows; the controller must keep the speed, elsewhere it accelerates as it likes
    speed   (m,)   of the tip relative to the part: mean of a move that lays material, along its line; peak of any other
                   [m/s]
    turn    (m,)   mean rate of reorientation [rad/s]
    axis    (m,)   fastest mean rate of the part's axes [rad/s]
    fine    (m,)   the motion really comes to rest there
    waits          move → what it waits for at its end, one after the other; -1: before the first move
    on_end, on_start   (m,)  the extruder goes on at the end (start) of this move
    off_end            (m,)  it goes off at the end of this move
    after   (m,)   the move belongs to what comes after this many beads: run-outs still count to their bead
    targets (m + 1) the start and the target of each move; within lines they may lie a little beside the path (`beside`)
    q       (m + 1, n) joints there [rad], in the branches of the samples
    """

    sample: Indices
    start: Indices
    linear: Flags
    laid: Flags
    speed: Array
    turn: Array
    axis: Array
    fine: Flags
    waits: dict[int, tuple[Wait, ...]]
    on_end: Flags
    on_start: Flags
    off_end: Flags
    after: Indices
    targets: Poses
    q: Array

    def __len__(self) -> int:
        return len(self.sample)

    @property
    def length(self) -> Array:
        """Distances (m) between the targets at both ends of each move [m]."""
        out: Array = np.linalg.norm(np.diff(self.targets.position, axis=0), axis=1)
        return out


def deposits(trajectory: Trajectory) -> tuple[Indices, Indices]:
    """First and last sample (inclusive) of each stretch with material; ValueError for one that is a single sample."""
    edge = np.diff(np.concatenate([[False], trajectory.deposit, [False]]).astype(np.int8))
    first, last = np.flatnonzero(edge > 0), np.flatnonzero(edge < 0) - 1
    if (first == last).any():
        k = int(first[first == last][0])
        raise ValueError(f"sample {k} deposits alone: the extruder cannot be switched within one sample")
    return first, last


def plan_moves(plan: Plan, also: Indices | None = None, fed: Array | None = None) -> Moves:
    """Choose the targets of a plan and say how each is approached.

    also  samples that are to be targets, too
    fed   (n) filament that is fed by each sample [m], for which every move that lays material has one rate
    """
    trajectory = plan.trajectory
    n = len(trajectory)
    first, last = deposits(trajectory)
    rests = rests_of(trajectory, first, last)
    way = way_of(plan, rests, fed)
    approach, leave = _flown(way.path, first, last, np.flatnonzero(rests.fine), plan.problem.process.run_in)

    linear = np.zeros(n - 1, dtype=bool)  # of the interval from sample i to i + 1
    for a, b in zip(approach, leave, strict=True):
        linear[a:b] = True
    must = np.zeros(n, dtype=bool)
    must[[0, n - 1]] = True
    must[np.concatenate([first, last, approach, leave])] = True
    if also is not None:
        must[also] = True
    must |= rests.fine
    must[1:] |= rests.inside[1:] & ~np.append(rests.inside[2:], False)  # where the robot goes on after a wait
    must[1:] |= (np.diff(trajectory.bead) != 0) & trajectory.deposit[1:] & trajectory.deposit[:-1]
    must[1:] |= np.diff(trajectory.branch) != 0
    cornered = trajectory.deposit & ~rests.fine & np.append(linear, False) & np.append(False, linear)
    joint, chord = by_samples(_Joint(plan)), plan.problem.program.chord
    sample, targets = chosen_targets(way, np.flatnonzero(must), linear, cornered, joint, chord)
    a, b = sample[:-1], sample[1:]
    goes = ~rests.inside[b]  # from one sample of a wait to another there is no move
    a, b = a[goes], b[goes]
    leaves, comes = Poses(targets.table[:-1][goes]), Poses(targets.table[1:][goes])
    took = rests.clock[b] - rests.clock[a]
    peaks = np.maximum.reduceat(np.append(np.diff(way.path), 0.0), a) / trajectory.dt
    rates = np.abs(comes.station - leaves.station) / took[:, None]
    is_linear, laid = linear[a], trajectory.deposit[a] & trajectory.deposit[b]
    arrives_linear = np.zeros(n, dtype=bool)
    arrives_linear[b[is_linear]] = True
    starts, ends = np.zeros(n, dtype=bool), np.zeros(n, dtype=bool)
    starts[first], ends[last] = True, True
    k, table = np.concatenate([[0], b]), np.vstack([targets.table[:1], comes.table])
    moved = (table != way.poses.table[k]).any(axis=1)
    return Moves(
        sample=b,
        start=a,
        linear=is_linear,
        laid=laid,
        speed=np.where(laid, np.linalg.norm(comes.position - leaves.position, axis=1) / took, peaks),
        turn=angle(leaves.quat, comes.quat) / took,
        axis=rates.max(axis=1, initial=0.0),
        fine=rests.fine[b],
        waits={int(np.searchsorted(b, at, side="right")) - 1: waits for at, waits in rests.waits.items()},
        on_end=(starts & arrives_linear)[b],
        on_start=(starts & ~arrives_linear)[a],
        off_end=ends[b],
        after=np.searchsorted(leave, a, side="right"),
        targets=Poses(table),
        q=reached(plan, k, Poses(table), moved),
    )


def way_of(plan: Plan, rests: Rests, fed: Array | None = None) -> Way:
    """What the lines of a program follow, and how nearly; rests and filament are those of `plan_moves`."""
    t, program = plan.trajectory, plan.problem.program
    fed = np.zeros(len(t)) if fed is None else fed
    amount = max(float(np.diff(fed).max(initial=0.0)) / t.dt * TIME_TOLERANCE, 1e-12)  # of filament, out of place [m]
    chord, turned = program.chord - ROUNDING, ANGLE_TOLERANCE
    tolerance = np.array([chord, turned, turned, TIME_TOLERANCE, program.tangent, amount, LONGEST])
    path = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(t.tip, axis=0), axis=1))])
    poses = Poses(np.column_stack([t.tip, continuous(t.quat), t.q[:, len(plan.cell.arm) :]]))
    return Way(poses, rests.clock, path, fed, t.deposit.copy(), tolerance)


class _Joint:
    """How far joint moves between two samples miss a third, in tolerances."""

    def __init__(self, plan: Plan) -> None:
        self._trajectory, self._cell = plan.trajectory, plan.cell

    def __call__(self, a: Indices, b: Indices, k: Indices) -> Array:
        q, tip = self._trajectory.q, self._trajectory.tip
        u = nearest_fraction(q[a], q[b], q[k], (k - a) / (b - a))
        T = self._cell.T_part_nozzle(q[a] + u[:, None] * (q[b] - q[a]))
        off = np.linalg.norm(T[:, :3, 3] - tip[k], axis=1) / TRAVEL_TOLERANCE
        cosine = np.einsum("ij,ij->i", T[:, :3, 2], self._trajectory.axis[k])
        out: Array = np.maximum(off, np.arccos(np.clip(cosine, -1.0, 1.0)) / TRAVEL_ANGLE_TOLERANCE)
        return out


def nearest_fraction(a: Array, b: Array, p: Array, otherwise: Array) -> Array:
    """Fractions (n) of the chords a→b at which points p (n, d) are nearest; `otherwise` where a chord has no length."""
    chord = b - a
    square = np.einsum("ij,ij->i", chord, chord)
    short = square < 1e-14
    u = np.einsum("ij,ij->i", p - a, chord) / np.where(short, 1.0, square)
    out: Array = np.where(short, otherwise, np.clip(u, 0.0, 1.0))
    return out


def _flown(path: Array, first: Indices, last: Indices, rests: Indices, run_in: float) -> tuple[Indices, Indices]:
    """Samples from which, and up to which, each bead's straight run-in and run-out are flown as lines.

    A little more than the run itself: the bead's true end lies up to one sample outside the first one that deposits.
    A rest nearby is the better place to change from joint to linear motion.
    """
    reach = 1.05 * run_in + 0.2e-3 if run_in > 0.0 else 0.0
    approach = np.searchsorted(path, path[first] - reach, side="left")
    leave = np.searchsorted(path, path[last] + reach, side="right") - 1
    for k in range(len(first)):
        before = rests[(path[rests] >= path[first[k]] - 1.5 * reach) & (rests <= first[k])]
        after = rests[(rests >= last[k]) & (path[rests] <= path[last[k]] + 1.5 * reach)]
        approach[k] = before[-1] if len(before) else approach[k]
        leave[k] = after[0] if len(after) else leave[k]
    leave[:-1] = np.minimum(leave[:-1], first[1:])
    return np.minimum(approach, first), np.maximum(leave, last)
