"""Check of a program, as read and played, against its plan: path, pace, switching and waits."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from scipy.spatial import cKDTree

from planner.base.arrays import Array, Flags, Indices, true_runs
from planner.base.errors import InputError
from planner.export.arcs import LinesAndArcs, segments
from planner.export.external import external_read, external_written
from planner.export.fit import angle, continuous, lean_and_roll, lerp, slerp, to_matrix
from planner.export.moves import (
    LEAST_WAIT,
    ON_TIME,
    STILL,
    cuts,
    fed_spans,
    nearest_fraction,
    rested_for,
    rested_in_beads,
    samples_of_rest,
)
from planner.export.player.path import corner_depth
from planner.export.player.play import play
from planner.export.player.played import Played, laid_spans, laid_targets
from planner.export.program import UNSPECIFIED, ProgramPiece, RobotProgram, pieces_of
from planner.export.rapid.writer import quadrants
from planner.export.support import by_bead, output_numbers
from planner.export.text import beyond

if TYPE_CHECKING:
    from planner.export.moves import Moves
    from planner.plan import Plan, Trajectory

# ----------------------------------------------------------------------------------------------------
# Waits: the program stands still where the plan does, and for as long.

PLACE = 0.05e-3  # [m] at most between the nozzle's tip and the target at which it waits
DOUBT = 2.0  # samples: accuracy of a rest's length if no event gives it


def waits_differ(plan: Plan, program: RobotProgram) -> float:
    """Longest time [s] by which a wait of the program is longer or shorter than the plan's.

    inf if the number of waits, their order or their places differ, if the robot would not come to rest for one, or if
    it does not come to rest on a straight line where fibre is cut.
    """
    t = plan.trajectory
    rests = [*_before_and_between_beads(t), *((event.start, event.duration, 0.0) for event in cuts(t))]
    planned = sorted(rest for rest in rests if rest[1] > 0.0)
    written = np.flatnonzero(program.wait > 0.0)
    if len(planned) != len(written) or not program.fine[written].all():
        return float("inf")
    worst = 0.0
    for (start, duration, doubt), i in zip(planned, written.tolist(), strict=True):
        tip = t.tip[min(int(np.searchsorted(t.t, start - ON_TIME)), len(t) - 1)]
        if np.linalg.norm(program.position[i] - tip) > PLACE:
            return float("inf")
        worst = max(worst, abs(float(program.wait[i]) - duration) - doubt)
    for event in cuts(t):
        tip = t.tip[samples_of_rest(t, event)[0]]
        there = np.linalg.norm(program.position - tip, axis=1) <= PLACE
        if not (there & program.fine & program.linear).any():
            return float("inf")
    return worst


def moving_time(t: Trajectory) -> Array:
    """Time (n) [s] of each sample without the rests within beads."""
    return t.t - t.t[0] - rested_in_beads(t)


def _before_and_between_beads(t: Trajectory) -> list[tuple[float, float, float]]:
    """Start, duration and its uncertainty [s] of each standstill while nothing is laid."""
    still = (np.abs(np.diff(t.q, axis=0)).max(axis=1) < STILL) & ~(t.deposit[1:] & t.deposit[:-1])
    found = []
    for a, b in true_runs(still).tolist():
        lasts = (b - a) * t.dt
        known = sum(event.duration for event in rested_for(t, a, b))
        if known > 0.0 and abs(lasts - known) < LEAST_WAIT:
            found.append((float(t.t[a] - t.t[0]), known, 0.0))
        elif lasts >= LEAST_WAIT:
            found.append((float(t.t[a]), lasts, DOUBT * t.dt))
    return found


# ----------------------------------------------------------------------------------------------------
# Path: the lines of the program against the samples of the plan.

CLOSE = 3e-5  # [m] between samples: rounding and playing may confuse closer ones
OTHERS = 4.0  # samples to either side, at most, that may there be mistaken for a target's own
LEVER = 0.05  # [m/rad]: weight with which turning counts as path, for where the tip stands still
WINDOWS = (6, 64)  # samples to either side among which a target's own is searched; the second only if need be
FOUND = 1e-6  # [m] between a target and its sample: this close it is the right one, even at the edge of its window
ASTRAY = 4e-5  # [m]: beyond, the whole piece is searched; targets off the path are closer, even with LEVER × angle
ROUNDED_UP = 1.0 + 1e-9
BORDER = 0.01  # [rad] from the end of a joint's quarter turn within which a target off the path may have crossed it
BLOCK = 200_000  # samples examined, and
PIECES = 64  # pieces compared at once: bounds the memory


ROUNDED = 5e-6  # [m] by which rounding in the file, and in the joints that carry the nozzle, may shift a path
# [rad]; limits of `Agreement` before widening, with a margin: the choice of sample matters where the path turns quickly
AXIS, SWING, FREE = np.radians(0.105), np.radians(0.51), np.radians(0.26)
PACE = 2e-3  # [m/s]: speeds of travel are rounded up to whole mm/s
BESIDE = 2  # samples by which the one found for a target may be off
LATE_TARGET = 12e-3  # [s]


@dataclass(frozen=True)
class Agreement:
    """The worst differences between a program and its plan (m, rad); inf where they cannot be compared.

    widest    how far lines and arcs that lay material may leave the path; `widening` scales the other tolerances
    path      where material is laid: targets from the planned path, and that path from the lines and arcs between them
    travel    likewise elsewhere; for joint moves, the planned tip path from that of straight joint motion
    axis      the nozzle's axis where material is laid, and at every target; also tool and work object
    swing     the nozzle's axis along linear moves that lay nothing
    roll      rotation about the nozzle's axis along linear moves
    external  likewise for the part's axes
    event     where the extruder is switched, from the sample where deposition begins or ends
    frames    positions of tool and work object; the first posture, times 1 m/rad
    late      time by which a target in a bead is passed earlier or later than planned, by programmed speeds [s]
    wait      how long the robot stands still, at each wait [s]
    conf      number of targets whose configuration is not that of the plan's posture
    output    how often an output other than that of the bead's material is switched
    pace      programmed speed of travel moves from the plan's greatest within them, if the language gives one [m/s]
    swerves   number of moves in beads that are neither lines nor arcs
    bent      number of arcs whose via point is one of their ends: controllers refuse to start them
    """

    widest: float
    widening: float
    path: float
    travel: float
    axis: float
    swing: float
    roll: float
    external: float
    event: float
    frames: float
    late: float
    wait: float
    conf: int
    output: int
    pace: float
    swerves: int
    bent: int

    def differences(self) -> list[str]:
        """Every difference beyond what rounding and thinning may cause, in words."""
        limits = {
            "path": (self.widest + ROUNDED, "m"),
            "travel": (1e-3, "m"),
            "axis": (self.widening * AXIS, "rad"),
            "swing": (self.widening * SWING, "rad"),
            "roll": (self.widening * FREE, "rad"),
            "external": (self.widening * FREE, "rad"),
            "event": (0.05e-3, "m"),
            "frames": (2e-6, "m"),
            "late": (LATE_TARGET, "s"),
            "wait": (2e-3, "s"),
            "conf": (0, "targets"),
            "output": (0, "times"),
            "pace": (PACE, "m/s"),
            "swerves": (0, "moves in beads"),
            "bent": (0, "arcs without a way"),
        }
        return beyond(
            (f"{name} differs by {{:.3g}} {unit}", getattr(self, name), limit) for name, (limit, unit) in limits.items()
        )


def compare(plan: Plan, program: RobotProgram) -> Agreement:
    """Worst differences between the plan and a program that was read back."""
    trajectory = plan.trajectory
    widening = plan.problem.program.widening
    widest = widening * plan.problem.program.chord
    first, last = fed_spans(trajectory)
    pieces = list(pieces_of(program))
    cuts = np.concatenate([[0], np.column_stack([first, last]).ravel(), [len(trajectory) - 1]])
    expected_on = [k % 2 == 1 for k in range(len(cuts) - 1)]
    if [on for on, _ in pieces] != expected_on:
        far = (np.inf,) * 10
        return Agreement(widest, widening, *far, len(program.conf), len(program.triggers), np.inf, 0, 0)
    match = _matched(plan, [piece for _, piece in pieces], cuts)
    starts = match.targets[1:-1]
    event = np.linalg.norm(match.all.position[starts] - trajectory.tip[cuts[1:-1]], axis=1).max(initial=0.0)
    worst = np.maximum(_targets(plan, match), _lines(plan, match))
    frames, turned = _frames(plan, program)
    return Agreement(
        widest=widest,
        widening=widening,
        path=float(worst[0]),
        travel=float(worst[1]),
        axis=max(float(worst[2]), turned),
        swing=float(worst[3]),
        roll=float(worst[4]),
        external=float(worst[5]),
        event=float(event),
        frames=frames,
        late=_late(plan, match),
        wait=waits_differ(plan, program),
        conf=_wrong_configurations(plan, match),
        output=_wrong_outputs(plan, program, first),
        pace=_travel_pace(plan, match),
        swerves=int(np.count_nonzero(_within(plan, match)[0] & ~match.all.linear[:-1])),
        bent=_bent(match),
    )


@dataclass(frozen=True)
class _Match:
    """All pieces in a row (m targets), and the samples that their targets stand for.

    all               the pieces' targets, one after the other; per-move data has one surplus entry at each piece's end
    ways              (m - 1) from each target to the next; those from piece to piece are no moves
    targets, cuts     (p + 1) first target of each piece, first sample of each piece; a piece's last sample is the
                      first one of the next
    piece, at         (m) piece of each target, and its own sample
    """

    all: ProgramPiece
    ways: LinesAndArcs
    targets: Indices
    cuts: Indices
    piece: Indices
    at: Indices


def _matched(plan: Plan, pieces: Sequence[ProgramPiece], cuts: Indices) -> _Match:
    """Pieces matched with the samples between the extruder's events at `cuts`."""
    trajectory = plan.trajectory
    rows = ProgramPiece(
        position=np.concatenate([piece.position for piece in pieces]),
        quat=np.concatenate([piece.quat for piece in pieces]),
        external=np.concatenate([piece.external for piece in pieces]),
        conf=np.concatenate([piece.conf for piece in pieces]),
        linear=np.concatenate([np.append(piece.linear, False) for piece in pieces]),
        circular=np.concatenate([np.append(piece.circular, False) for piece in pieces]),
        via=np.concatenate([np.vstack([piece.via, piece.position[-1:]]) for piece in pieces]),
        speed=np.concatenate([np.append(piece.speed, 0.0) for piece in pieces]),
        known=np.concatenate([piece.known for piece in pieces]),
    )
    counts = [len(piece.position) for piece in pieces]
    targets = np.concatenate([[0], np.cumsum(counts)])
    owner = np.repeat(np.arange(len(pieces)), counts)
    ways = segments(rows.position[:-1], rows.via[:-1], rows.position[1:], rows.circular[:-1])
    steps = np.linalg.norm(np.diff(trajectory.tip, axis=0), axis=1)
    samples = _PosesAlong(trajectory.tip, continuous(trajectory.quat), steps)
    at = _own_samples(_PosesAlong(rows.position, rows.quat, ways.length), samples, targets, cuts)
    return _Match(rows, ways, targets, cuts, owner, at)


def _external(plan: Plan, samples: Indices) -> Array:
    """The station's axes (n, k) [rad, m] at samples."""
    cell = plan.cell
    written = np.radians(external_written(cell, plan.trajectory.q[samples][:, cell.besides]))
    return external_read(cell, written)


def _targets(plan: Plan, match: _Match) -> Array:
    """Worst (path, travel, axis, swing, roll, external) of targets against the planned path around their samples."""
    tip, rows = plan.trajectory.tip, match.all
    least, most = match.cuts[match.piece], match.cuts[match.piece + 1]
    off, leant, rolled, shifted = [], [], [], []
    for nearer in (np.maximum(match.at - 1, least), match.at):  # the piece of path before and after the sample
        after = np.minimum(nearer + 1, most)
        u = nearest_fraction(tip[nearer], tip[after], rows.position, np.zeros(len(nearer)))
        off.append(np.linalg.norm(lerp(tip, nearer, after, u) - rows.position, axis=1))
        quat_a, quat_b = _unit(plan.trajectory.quat[nearer]), _unit(plan.trajectory.quat[after])
        lean, roll = lean_and_roll(slerp(quat_a, quat_b, u), rows.quat)
        leant.append(lean)
        rolled.append(roll)
        a, b = _external(plan, nearer), _external(plan, after)
        k = a.shape[1]
        between = a + u[:, None] * (b - a)
        shifted.append(np.abs(between - external_read(plan.cell, rows.external)).max(axis=1, initial=0.0))
    best = np.argmin(off, axis=0)[None]
    unused = np.isnan(rows.external[:, k:]).all() and not np.isnan(rows.external[:, :k]).any()
    worst = [np.take_along_axis(np.array(values), best, axis=0).max() for values in (off, leant, rolled, shifted)]
    return np.array([worst[0], 0.0, worst[1], 0.0, worst[2], worst[3] if unused else np.inf])


def _lines(plan: Plan, match: _Match) -> Array:
    """Worst (path, travel, axis, swing, roll, external) of planned samples against lines and arcs between targets."""
    worst, laid = np.zeros(6), plan.trajectory.deposit
    for first in range(0, len(match.cuts) - 1, PIECES):
        pieces = np.arange(first, min(first + PIECES, len(match.cuts) - 1))
        pieces = pieces[np.diff(match.targets)[pieces] > 1]
        counts = match.cuts[pieces + 1] - match.cuts[pieces] + 1
        inner = np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts)
        sample = inner + np.repeat(match.cuts[pieces], counts)
        piece = np.repeat(pieces, counts)
        owner = np.searchsorted(match.at, sample, side="right") - 1
        owner = np.clip(owner, match.targets[piece], match.targets[piece + 1] - 2)
        line = match.all.linear[owner]
        for lays in (True, False):
            rows = line & (laid[sample] == lays)
            if rows.any():
                off, lean, roll, shifted = _straight(plan, match, owner[rows], sample[rows])
                found = [off, 0.0, lean, 0.0, roll, shifted] if lays else [0.0, off, 0.0, lean, roll, shifted]
                worst = np.maximum(worst, found)
        if not line.all():
            worst[1] = max(worst[1], _joint(plan, match, owner[~line], sample[~line]))
    return worst


def _straight(plan: Plan, match: _Match, a: Indices, s: Indices) -> tuple[float, float, float, float]:
    """Worst distance [m], lean, roll, and external axes [rad, m] of samples s (n) from the ways after targets a (n)."""
    rows, tip = match.all, plan.trajectory.tip
    ways, external = match.ways.take(a), _external(plan, s)
    u = ways.fraction(tip[s], _share(match.at, a, s))
    off = np.linalg.norm(ways.at(u) - tip[s], axis=1).max()
    lean, roll = lean_and_roll(slerp(rows.quat[a], rows.quat[a + 1], u), _unit(plan.trajectory.quat[s]))
    between = lerp(external_read(plan.cell, rows.external), a, a + 1, u)
    return float(off), float(lean.max()), float(roll.max()), float(np.abs(between - external).max(initial=0.0))


def _joint(plan: Plan, match: _Match, a: Indices, s: Indices) -> float:
    """Worst distance [m] of samples s (n) from the tip paths of joint moves that begin at targets a (n)."""
    q = plan.trajectory.q
    at_targets = q[match.at]
    u = nearest_fraction(at_targets[a], at_targets[a + 1], q[s], _share(match.at, a, s))
    T = plan.cell.T_part_nozzle(lerp(at_targets, a, a + 1, u))
    return float(np.linalg.norm(T[:, :3, 3] - plan.trajectory.tip[s], axis=1).max())


def _late(plan: Plan, match: _Match) -> float:
    """Longest time by which, at programmed speeds, a target of a bead is passed earlier or later than planned [s].

    Where samples lie within CLOSE of each other, as before a rest, a target's own sample is uncertain by OTHERS.
    """
    trajectory, at = plan.trajectory, match.at
    clock, tip = moving_time(trajectory), trajectory.tip
    took = match.ways.length / np.where(match.all.speed[:-1] > 0.0, match.all.speed[:-1], np.inf)
    run = np.concatenate([[0.0], np.cumsum(took)])
    # pieces alternate: travel, bead; what is laid after a cut is in a travel piece, but timed from its bead's start
    first = match.targets[np.maximum(match.piece - (match.piece % 2 == 0), 0)]
    programmed = run - run[first]
    planned = clock[at] - clock[at[first]]
    steps = np.linalg.norm(np.diff(tip, axis=0), axis=1)
    beside = np.minimum(np.append(steps, np.inf), np.append(np.inf, steps))[at]
    doubt = np.where(beside < CLOSE, OTHERS, 1.0) * trajectory.dt
    off = np.maximum(np.abs(programmed - planned) - doubt, 0.0)
    return float(off[1:][_within(plan, match)[0]].max(initial=0.0))


def _within(plan: Plan, match: _Match) -> tuple[Flags, Flags]:
    """Ways (m - 1) in beads, and in travel; those from one piece to the next are neither.

    The part of a bead after its fibre is cut is laid like the rest, though nothing is fed there.
    """
    own = match.piece[1:] == match.piece[:-1]
    bare = np.cumsum(~plan.trajectory.deposit)
    laid = plan.trajectory.deposit[match.at[:-1]] & (bare[match.at[1:]] == bare[match.at[:-1]])
    return own & laid, own & ~laid


def _bent(match: _Match) -> int:
    """How many arcs have their via point at one of their ends."""
    rows = match.all
    ends = np.stack([rows.position[:-1], rows.position[1:]])
    near = np.linalg.norm(ends - rows.via[:-1], axis=2).min(axis=0) <= ROUNDED
    return int(np.count_nonzero(rows.circular[:-1] & near))


def _travel_pace(plan: Plan, match: _Match) -> float:
    """Worst difference of a travel move's programmed speed from the plan's greatest within it [m/s].

    A target's own sample is known to within BESIDE. Speeds from FAST on stand for those that a language leaves open.
    """
    speed = match.all.speed[:-1]
    step = np.linalg.norm(np.diff(plan.trajectory.tip, axis=0), axis=1) / plan.trajectory.dt
    fastest = plan.problem.process.travel_speed
    a, b = match.at[:-1], match.at[1:]
    chosen = np.flatnonzero(_within(plan, match)[1] & (speed < FAST) & (b - a > 2 * BESIDE) & (match.ways.length > 0.0))
    if not len(chosen):
        return 0.0

    def peak(first: Indices, last: Indices) -> Array:
        n = len(step)
        cuts = np.column_stack([np.clip(first, 0, n - 1), np.clip(last, 1, n - 1)]).ravel()
        return np.maximum.reduceat(step, cuts)[::2]

    least, most = peak(a[chosen] + BESIDE, b[chosen] - BESIDE), peak(a[chosen] - BESIDE, b[chosen] + BESIDE)
    over = speed[chosen] - np.clip(most, 0.0, fastest)
    return float(np.maximum(over, np.minimum(least, fastest) - speed[chosen]).max())


def _wrong_configurations(plan: Plan, match: _Match) -> int:
    """How many targets have a configuration that no planned posture around them has, or nearly has.

    Targets off the path may have crossed the border of a quarter turn; the player checks whether they have.
    """
    trajectory = plan.trajectory
    least, most = match.cuts[match.piece], match.cuts[match.piece + 1]
    conf, right = match.all.conf, np.zeros(len(match.at), dtype=bool)
    for d in (-1, 0, 1):  # a target rounded across a quarter turn belongs to its neighbour sample
        near = np.clip(match.at + d, least, most)
        q, branch = trajectory.q[near][:, plan.cell.own], trajectory.branch[near]
        within = (quadrants(q - BORDER) <= conf[:, :3]) & (conf[:, :3] <= quadrants(q + BORDER))
        right |= (within | (conf[:, :3] == UNSPECIFIED)).all(axis=1) & (
            (conf[:, 3] == branch) | (conf[:, 3] == UNSPECIFIED)
        )
    return int(np.count_nonzero(match.all.known & ~right))


def _wrong_outputs(plan: Plan, program: RobotProgram, first: Indices) -> int:
    """How often an output is switched that is not that of the bead; `first` (b): samples at which beads begin."""
    outputs = by_bead(plan, list(output_numbers(plan.problem)))
    own = [outputs[k] for k in plan.trajectory.bead[first].tolist()]
    wrong = 0
    for on in (True, False):
        switched = [
            trigger.signal for _, group in sorted(program.triggers.items()) for trigger in group if trigger.value == on
        ]
        wrong += abs(len(switched) - len(own)) + sum(a != b for a, b in zip(switched, own, strict=False))
    return wrong


def _share(at: Indices, a: Indices, s: Indices) -> Array:
    out: Array = (s - at[a]) / np.maximum(at[a + 1] - at[a], 1)
    return out


def _unit(quat: Array) -> Array:
    out: Array = quat / np.linalg.norm(quat, axis=1, keepdims=True)
    return out


@dataclass(frozen=True)
class _PosesAlong:
    """Positions (n, 3) [m], orientations (n, 4), and the lengths (n - 1) of the ways between them [m]."""

    position: Array
    quat: Array
    steps: Array

    @property
    def way(self) -> Array:
        """Distance travelled up to each pose (n) [m], with turning counted by LEVER."""
        return np.concatenate([[0.0], np.cumsum(self.steps + LEVER * angle(self.quat[1:], self.quat[:-1]))])


def _own_samples(written_poses: _PosesAlong, samples: _PosesAlong, targets: Indices, cuts: Indices) -> Indices:
    """Sample of each target, ascending: the nearest one around the place suggested by the distance travelled.

    targets, cuts (p + 1) are the first target and the first sample of each piece (see `_Match`).
    """
    position, quat, tip, sample_quat = written_poses.position, written_poses.quat, samples.position, samples.quat
    planned, written = samples.way, written_poses.way
    counts = np.diff(targets)
    begin, end = written[targets[:-1]], written[targets[1:] - 1]
    length = end - begin
    stretch = np.where(length > 0.0, np.diff(planned[cuts]) / np.where(length > 0.0, length, 1.0), 0.0)
    guess = np.repeat(planned[cuts[:-1]], counts) + np.repeat(stretch, counts) * (written - np.repeat(begin, counts))
    least, most = np.repeat(cuts[:-1], counts), np.repeat(cuts[1:], counts)
    centre = np.clip(np.searchsorted(planned, guess), least, most)

    def costs(i: Indices, near: Indices) -> tuple[Array, Array]:
        """Distance of targets from samples, and the same plus a small term that decides where the path meets itself."""
        gap = tip[near] - position[i]
        same = np.minimum(np.abs(np.einsum("...k,...k->...", sample_quat[near], quat[i])), 1.0)
        cost = np.sqrt(np.einsum("...k,...k->...", gap, gap))
        cost += LEVER * np.sqrt(8.0 * (1.0 - same))  # the angle, to third order
        return cost, cost + 1e-3 * np.abs(planned[near] - guess[i])

    n = len(position)
    at, cost, total = np.empty(n, dtype=np.intp), np.empty(n), np.empty(n)
    wanted = np.arange(n)
    for window in WINDOWS:
        reach = np.arange(-window, window + 1)
        for block in np.array_split(wanted, 1 + len(wanted) * len(reach) // BLOCK):
            near = np.clip(centre[block, None] + reach, least[block, None], most[block, None])
            own, with_way = costs(block[:, None], near)
            best = np.argmin(with_way, axis=1)
            row = np.arange(len(block))
            at[block], cost[block], total[block] = near[row, best], own[row, best], with_way[row, best]
        edge = (np.abs(at - centre) >= window) & (at > least) & (at < most)
        wanted = np.flatnonzero((cost > FOUND) & (edge | (cost > ASTRAY)))
    # joint moves cut wide turns short, so the guess may be far off; a better sample lies in a ball of the cost's radius
    astray = np.flatnonzero(cost > ASTRAY)
    if len(astray):
        tree, radius = cKDTree(tip, balanced_tree=False, compact_nodes=False), ROUNDED_UP * total[astray]
        sizes = tree.query_ball_point(position[astray], radius, return_length=True)
        for block in np.split(np.arange(len(astray)), np.flatnonzero(np.diff(np.cumsum(sizes) // BLOCK)) + 1):
            found = tree.query_ball_point(position[astray[block]], radius[block], return_sorted=True)
            i, near = np.repeat(astray[block], sizes[block]), np.concatenate(found).astype(np.intp)
            inside = (near >= least[i]) & (near <= most[i])
            i, near = i[inside], near[inside]
            order = np.lexsort((near, costs(i, near)[1], i))
            first = order[np.flatnonzero(np.diff(i[order], prepend=-1))]
            at[i[first]] = near[first]
    # the ends are known; on a closed path, the sample nearest to one end may be the other
    at[targets[:-1]], at[targets[1:] - 1] = cuts[:-1], cuts[1:]
    return np.maximum.accumulate(at)


def _frames(plan: Plan, program: RobotProgram) -> tuple[float, float]:
    """Worst difference of tool, work object and first posture: position [m], orientation [rad]."""
    cell = plan.cell
    identity = np.eye(4)
    moving = cell.station is not None
    far, turned = [], []
    for written, T in (
        (program.tool, cell.T_flange_nozzle),
        (program.uframe, identity if moving else cell.T_world_holder),
        (program.oframe, cell.T_plate_part if moving else identity),
    ):
        far.append(float(np.linalg.norm(written[:3] - T[:3, 3])))
        cosine = 0.5 * (np.trace(to_matrix(written[None, 3:])[0].T @ T[:3, :3]) - 1.0)
        turned.append(float(np.arccos(min(1.0, cosine))) if cosine < 1.0 - 1e-9 else 0.0)
    start = plan.trajectory.q[:1]
    posture = np.concatenate([start[0, cell.own], np.radians(external_written(cell, start[:, cell.besides]))[0]])
    difference = np.abs(program.start[: len(posture)] - posture).max()
    if moving != bool(program.station) or np.isnan(difference) or not np.isnan(program.start[len(posture) :]).all():
        return float("inf"), max(turned)
    return max(*far, float(difference)), max(turned)


# ----------------------------------------------------------------------------------------------------
# The program as it is played: pace, corners, stops and configurations.

# share of the deposition time: wide, as the time is a model's, in which small prints full of corners take 5 per cent
# longer; shipped problems stay within half a per cent (`python -m benchmarks.programs`)
LATE = 0.1
# [m] by which corners in travel may be cut, as much as `Agreement` allows paths to differ
TRAVEL = 1e-3


@dataclass(frozen=True)
class Readback:
    """Differences of a played program from its plan.

    agreement  of the played nozzle, as the cell's joints carry it, with the plan
    laid       deposition time of the program over that of the plan; worst: of the bead that differs most
    corner     how far the nozzle passes inside of a target at which material is laid, at most [m]
    swing      how far it passes inside of any other target, at most [m]
    stops      number of targets within beads at which the robot comes to rest without waiting
    strays     targets at which the robot does not arrive in their configuration
    """

    agreement: Agreement
    laid: float
    worst: float
    corner: float
    swing: float
    stops: int
    strays: tuple[int, ...]

    def differences(self) -> list[str]:
        """Every difference beyond what rounding and thinning may cause, in words."""
        found = self.agreement.differences()
        if not abs(self.laid - 1.0) <= LATE:
            found.append(f"time of deposition is {self.laid:.4g} of the plan's (limit {LATE:g} from 1)")
        in_bead = ("a corner in a bead is cut by {:.3g} m", self.corner, self.agreement.widest + ROUNDED)
        found += beyond([in_bead, ("a corner in travel is cut by {:.3g} m", self.swing, TRAVEL)])
        if self.stops:
            found.append(f"the robot stops at {self.stops} targets within beads")
        if self.strays:
            found.append(
                f"{len(self.strays)} targets are not reached in their configuration, first move {self.strays[0]}"
            )
        return found


def readback(plan: Plan, program: RobotProgram) -> list[str]:
    """Differences between a program that was read and its plan, in words; none if it does the same."""
    try:
        played = play(program, plan.cell)
    except InputError as error:
        return [*compare(plan, program).differences(), f"cannot be played: {error.reason}"]
    return judge(plan, program, played).differences()


def judge(plan: Plan, program: RobotProgram, played: Played) -> Readback:
    """A program, as played in the plan's cell, compared with the plan."""
    nozzle = replace(program, position=played.position[played.target], quat=played.quat[played.target])
    spans = laid_spans(played)
    first, last = fed_spans(plan.trajectory)
    planned = plan.trajectory.t[last] - plan.trajectory.t[first]
    laid, worst = float("inf"), float("inf")
    if len(spans) == len(planned):
        took = spans[:, 1] - spans[:, 0]
        ratio = took / planned
        laid, worst = float(took.sum() / planned.sum()), float(ratio[np.argmax(np.abs(ratio - 1.0))])
    inside, edges = laid_targets(played)
    cut = corner_depth(program, played)
    return Readback(
        agreement=compare(plan, nozzle),
        laid=laid,
        worst=worst,
        corner=float(cut[inside | edges].max(initial=0.0)),
        swing=float(cut[~(inside | edges)].max(initial=0.0)),
        stops=int(np.count_nonzero(inside & program.fine & (program.wait == 0.0))),
        strays=played.strays,
    )


# ----------------------------------------------------------------------------------------------------
# Programs in languages that leave postures and speeds open are played with those of the plan.

COARSE = 0.05  # share of a speed in a bead by which the steps of a language may change it at most
SAID = 1e-9  # [m/s] to which a speed that was read equals the one that was written
FAST = 100.0  # [m/s, rad/s]: stands for a speed that a program leaves open; the joints then limit the robot


def played_differences(plan: Plan, moves: Moves, program: RobotProgram, stepped: Array) -> list[str]:
    """Differences between a program that was read and its plan, in words.

    stepped: speed (m) [m/s] of each move in the steps of its language (`stepped_speeds`)
    Configurations that targets do not name are taken from the planned postures. The controller must arrive at them by
    itself: it is given the joints where each line begins, and keeps its configuration along lines.
    """
    if len(program.linear) != len(moves.sample) + 1:
        count = f"it has {len(program.linear)} moves, not {len(moves.sample) + 1}"
        return [*compare(plan, program).differences(), count]
    found = readback(plan, filled(plan, moves, program))
    if found:
        meant = readback(plan, filled(plan, moves, _unstepped(moves, program, stepped)))
        found = min(found, meant, key=len)
    return found


def _unstepped(moves: Moves, program: RobotProgram, stepped: Array) -> RobotProgram:
    """The program with the intended speeds where it has them rounded to steps of its language that are fine enough: the
    next moves make up for a long move's rounding, and no finer speed can be given."""
    written, meant = program.speed[1:, 0], moves.speed
    near = moves.laid & (np.abs(written - stepped) <= SAID) & (np.abs(stepped - meant) <= COARSE * meant)
    speed = program.speed.copy()
    speed[1:, 0] = np.where(near, meant, written)
    return replace(program, speed=speed)


def filled(plan: Plan, moves: Moves, program: RobotProgram) -> RobotProgram:
    """A program of the plan's moves, completed where its language leaves configurations, speeds and zones open."""
    at = np.concatenate([[0], moves.sample])
    planned = np.column_stack([quadrants(moves.q[:, plan.cell.own]), plan.trajectory.branch[at]])
    return replace(
        program,
        conf=np.where(program.conf == UNSPECIFIED, planned, program.conf),
        speed=np.where(np.isnan(program.speed), FAST, program.speed),
        zone=np.nan_to_num(program.zone),  # of travel: the controller chooses how much it rounds
    )
