"""From samples to moves: which targets a controller needs, how each is approached, and where the robot rests."""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from operator import attrgetter
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from planner.base.arrays import Array, Flags, Indices, true_runs
from planner.base.geometry import arc_lengths
from planner.base.kept import kept
from planner.export.arcs import LinesAndArcs, segments
from planner.export.fit import angle, by_samples, continuous, fewest, lerp, slerp, to_matrix
from planner.export.primitives import FitRules, Poses, SampledWay, fit, misfits
from planner.export.speeds import TIME_TOLERANCE, even_speeds

if TYPE_CHECKING:
    from planner.export.program import RobotProgram
    from planner.plan import Event, Plan, Trajectory

# ----------------------------------------------------------------------------------------------------
# How fast a controller may go where a plan gives no speed for single moves: as fast as the plan ever does.


def tip_acceleration(trajectory: Trajectory) -> float:
    """Greatest acceleration of the tip along its path [m/s^2], rounded up to a tenth."""
    return rounded_up(float(np.abs(np.diff(trajectory.speed)).max(initial=0.0)) / trajectory.dt)


def rounded_up(value: float) -> float:
    """The next higher tenth, at least 0.1."""
    return max(1.0, float(np.ceil(10.0 * value))) / 10.0


def greatest_until_stop(moves: Moves, rates: Array) -> Array:
    """Greatest of the rates (n - 1; one per step between samples) between the stops around each move (m).

    Moves that are blended into each other share one speed: a blend between different speeds leaves its lines. Joint and
    linear moves are not blended.
    """
    first = np.concatenate([[0], moves.sample[:-1]])
    peaks = np.maximum.reduceat(np.append(rates, 0.0), first)
    run = np.concatenate([[0], np.cumsum(moves.fine[:-1] | (moves.linear[1:] != moves.linear[:-1]))])
    highest = np.zeros(run[-1] + 1)
    np.maximum.at(highest, run, peaks)
    out: Array = highest[run]
    return out


# ----------------------------------------------------------------------------------------------------
# Rests: where the robot stands still, for how long, and why.

LEAST_WAIT = 0.05  # [s]; a shorter rest is merely a reversal of the motion
STILL = 1e-9  # [rad] per sample: a joint that moves no more than this stands still
ON_TIME = 1e-9  # [s] by which an event may miss a sample and still count as on it
SLOW, SHARE = 5e-3, 0.05  # [rad/s], and share of the speed around it: below both, the motion comes to rest
AROUND = 0.1  # [s] before and after, over which that speed is taken
AT_HOME = ("heat", "purge", "change", "pause", "cool")  # events for which the robot rests at home, or lifted
NEAR_EVENT = 2.0  # samples by which a rest may seem to begin after its event


class Wait(NamedTuple):
    """A reason to stand still, in words, and for how long [s]."""

    why: str
    time: float


@dataclass(frozen=True)
class Rests:
    """Where a trajectory (n samples) stands still.

    fine   (n,)  the motion comes to rest at this sample
    waits        sample → its waits there, in order
    inside (n,)  the robot stands still from the previous sample to this one, in a wait
    clock  (n,)  time without waits [s]
    """

    fine: Flags
    waits: dict[int, tuple[Wait, ...]]
    inside: Flags
    clock: Array


def rests_of(trajectory: Trajectory, first: Indices, last: Indices) -> Rests:
    """Rests between beads, as the samples show them, and those that events require within beads and at home.

    first, last: samples between which material is laid. Within a bead, the nozzle rests only where its fibre is cut.
    """
    fine, found = _between_beads(trajectory, first, last)
    waits: dict[int, tuple[Wait, ...]] = {}
    inside = np.zeros(len(trajectory), dtype=bool)
    for at, a, b in found:
        own = [Wait(event.words, event.duration) for event in rested_for(trajectory, a, b)]
        spare = (b - a) * trajectory.dt - sum(wait.time for wait in own)
        if spare >= LEAST_WAIT:
            own.append(Wait(_meanwhile(trajectory, a, b), spare))
        if own:
            fine[[at, a]] = False, True
            waits[a] = tuple(own)
            inside[a + 1 : b + 1] = True
    clock = trajectory.t - trajectory.t[0] - np.cumsum(inside) * trajectory.dt - rested_in_beads(trajectory)
    for event in cuts(trajectory):
        a, b = samples_of_rest(trajectory, event)
        fine[a] = True
        waits[a] = (Wait(event.words, event.duration),)
        inside[a + 1 : b + 1] = True
    return Rests(fine, waits, inside, clock)


def cuts(trajectory: Trajectory) -> list[Event]:
    """The events for which the nozzle rests on a bead."""
    return [event for event in trajectory.events if event.kind == "cut"]


def passed(t: Array, events: Sequence[Event], amounts: Sequence[float]) -> Array:
    """Total of some events' amounts passed by increasing times (n) [s]; each event spreads its own over its time."""
    out, whole = np.zeros(len(t)), np.zeros(len(t) + 1)
    for event, amount in zip(events, amounts, strict=True):
        a, b = np.searchsorted(t, [event.start, event.start + event.duration])
        out[a:b] += amount * ((t[a:b] - event.start) / event.duration)
        whole[b] += amount
    return out + np.cumsum(whole[:-1])


def rested_in_beads(trajectory: Trajectory) -> Array:
    """How long (n) [s] the nozzle has rested within beads up to each sample."""
    found = cuts(trajectory)
    return passed(trajectory.t, found, [event.duration for event in found])


def samples_of_rest(trajectory: Trajectory, event: Event) -> tuple[int, int]:
    """First and last sample of an event's rest; the sample nearest to its start, twice, if it lies between two."""
    end = event.start + event.duration
    a, b = np.searchsorted(trajectory.t, [event.start - ON_TIME, end + ON_TIME])
    if a >= b:
        a = int(np.argmin(np.abs(trajectory.t - event.start)))
        return a, a
    return int(a), int(b) - 1


def rested_for(trajectory: Trajectory, a: int, b: int) -> list[Event]:
    """The events that take time and for which the robot rests at home from sample a to b."""
    span = trajectory.t[a] - NEAR_EVENT * trajectory.dt, trajectory.t[b]
    first, last = (bisect_left(trajectory.events, when, key=attrgetter("start")) for when in span)
    return [event for event in trajectory.events[first:last] if event.kind in AT_HOME and event.duration > 0.0]


def _meanwhile(trajectory: Trajectory, a: int, b: int) -> str:
    """What the extruder does while the robot stands still from sample a to b, apart from the reasons for that rest."""
    events = trajectory.events
    first = bisect_right(events, trajectory.t[a], key=lambda event: event.start + event.duration)
    last = bisect_left(events, trajectory.t[b], key=attrgetter("start"))
    return "; ".join(event.words for event in events[first:last] if event.kind not in AT_HOME)


def _between_beads(trajectory: Trajectory, first: Indices, last: Indices) -> tuple[Flags, list[tuple[int, int, int]]]:
    """Where (n) the robot comes to rest outside of beads, and each standstill: sample of its rest, first, last sample.

    The exact moment of rest lies between two samples, so a rest shows as a speed that is small compared with the speed
    within 0.1 s of it. A slow bead is slow throughout and is not mistaken for a rest.
    """
    n = len(trajectory)
    change = np.abs(np.diff(trajectory.q, axis=0)).max(axis=1)
    rate = np.empty(n)
    rate[1:-1] = np.abs(trajectory.q[2:] - trajectory.q[:-2]).max(axis=1) / (2.0 * trajectory.dt)
    rate[[0, -1]] = 0.0
    half = max(1, round(AROUND / trajectory.dt))
    around = _sliding_maximum(np.pad(rate, half, mode="edge"), 2 * half + 1)
    slow = (rate < SLOW) & (rate <= SHARE * around)
    edge = np.zeros(n, dtype=bool)
    edge[first], edge[last] = True, True
    slow &= edge | ~trajectory.deposit

    fine: Flags = np.zeros(n, dtype=bool)
    found: list[tuple[int, int, int]] = []
    for a, b in true_runs(slow):
        # an end of a bead is the better place for the stop, if there is one
        at = a + int(np.argmin(np.where(edge[a:b], -1.0, rate[a:b])))
        fine[at] = True
        still = a + np.flatnonzero(change[a : b - 1] < STILL)
        if len(still):  # the longest part in which nothing is switched
            parts = np.concatenate([still[:1], a + np.flatnonzero(edge[a:b]), still[-1:] + 1])
            parts = np.unique(np.clip(parts, still[0], still[-1] + 1))
            longest = int(np.argmax(np.diff(parts)))
            found.append((int(at), int(parts[longest]), int(parts[longest + 1])))
    fine[[0, n - 1]] = True
    return fine, found


def _sliding_maximum(values: Array, width: int) -> Array:
    """Largest of every `width` neighbouring values (n): n - width + 1 maxima."""
    out, covered = values, 1
    while covered < width:  # each step joins two windows, which may overlap
        step = min(covered, width - covered)
        out, covered = np.maximum(out[:-step], out[step:]), covered + step
    return out


# ----------------------------------------------------------------------------------------------------
# Postures of targets that are turned a little: the turn may take them across the border of a configuration.

BLOCK = 20_000  # poses whose postures are computed at once: bounds the memory


def reached(plan: Plan, sample: Indices, targets: Poses, turned: Flags) -> Array:
    """Joints (m, n) [rad] that hold the nozzle at targets (m): the samples' own, unless the target was turned (m).

    Turned targets are solved for in the same branch and the nearest turn. Arms whose poses do not determine a posture
    keep the samples' joints.
    """
    cell, t = plan.cell, plan.trajectory
    na, rails = len(cell.arm), cell.rails
    out: Array = t.q[sample]
    if len(cell.given) > rails:
        return out
    which = np.flatnonzero(turned)
    for rows in np.array_split(which, 1 + len(which) // BLOCK):
        T = np.tile(np.eye(4), (len(rows), 1, 1))
        T[:, :3, :3], T[:, :3, 3] = to_matrix(targets.quat[rows]), targets.position[rows]
        near, station = out[rows], targets.station[rows]
        near[:, :rails], near[:, na:] = station[:, :rails], station[:, rails:]
        out[rows], _ = cell.postures(T, near, t.branch[sample[rows]].astype(np.intp))
    return out


# ----------------------------------------------------------------------------------------------------
# Moves: the targets that a controller needs, and how each is approached.

ROUNDING = 1e-6  # [m]; share of the path tolerance that rounding in the file uses up
AXIS_TOLERANCE = np.radians(0.0995)  # [rad], of the nozzle's axis; rounding uses up the rest of 0.1 deg
# Rotation about the nozzle's axis and axes that turn the part do not affect the print. A head of 0.1 m swings 0.4 mm.
FREE_TOLERANCE = np.radians(0.25)  # [rad]
SLIDE_TOLERANCE = 0.8e-3  # [m], likewise for axes that slide
ANGLE_TOLERANCE = np.radians(0.045)  # [rad], of joints and orientation in languages that name joints or axes
TRAVEL_TOLERANCE = 0.3e-3  # [m]; between moves that lay nothing and the planned tip path
TRAVEL_ANGLE_TOLERANCE = np.radians(0.5)
RUN_CHORDS = 6.0  # × chord: tolerance of run-ins and run-outs, no wider because they begin and end as low as the bead


@dataclass(frozen=True)
class Moves:
    """m moves, each to one sample of the trajectory; the first starts where the trajectory does.

    sample  (m,)   index of the sample that is the target
    start   (m,)   index of the sample at which the move starts: after a wait, if there is one
    linear  (m,)   a line or an arc in the part frame; otherwise straight in joint space
    circular (m,)  an arc
    laid    (m,)   material flows, and the controller must keep the speed; elsewhere it accelerates as it likes
    speed   (m,)   of the tip relative to the part [m/s]: where material is laid, such that each target is passed when
                   planned (`even_speeds`); otherwise the peak
    turn    (m,)   mean rate of reorientation [rad/s]
    axis    (m,)   fastest mean rate of the part's axes, and of the arm's carrier if it turns [rad/s]
    slide   (m,)   mean rate of the arm's carrier if it slides [m/s]
    fine    (m,)   the motion really comes to rest there
    waits          move → the waits at its end, in order; -1: before the first move
    on_end, on_start   (m,)  the extruder is switched on at the end (start) of this move
    off_end            (m,)  it is switched off at the end of this move: a bead ends, or its fibre is cut
    after   (m,)   number of beads finished before the move; a run-out still belongs to its bead
    targets (m + 1) the start, then each move's target; in beads the nozzle may be turned slightly out of a bend (`fit`)
    via     (m) the middle of each arc; the target where there is none
    q       (m + 1, n) joints at the start and the targets [rad]
    """

    sample: Indices
    start: Indices
    linear: Flags
    circular: Flags
    laid: Flags
    speed: Array
    turn: Array
    axis: Array
    slide: Array
    fine: Flags
    waits: dict[int, tuple[Wait, ...]]
    on_end: Flags
    on_start: Flags
    off_end: Flags
    after: Indices
    targets: Poses
    via: Poses
    q: Array

    def __len__(self) -> int:
        return len(self.sample)

    @property
    def segments(self) -> LinesAndArcs:
        """The lines and arcs between targets; joint moves count as lines."""
        p = self.targets.position
        return segments(p[:-1], self.via.position, p[1:], self.circular)

    @property
    def length(self) -> Array:
        """Length of each move along its line or arc (m) [m]."""
        return self.segments.length


def deposits(trajectory: Trajectory) -> tuple[Indices, Indices]:
    """First and last sample (inclusive) of each stretch with material; ValueError for a stretch of a single sample."""
    edge = np.diff(np.concatenate([[False], trajectory.deposit, [False]]).astype(np.int8))
    first, last = np.flatnonzero(edge > 0), np.flatnonzero(edge < 0) - 1
    if (first == last).any():
        k = int(first[first == last][0])
        raise ValueError(f"sample {k} deposits by itself: the extruder cannot be switched within one sample")
    return first, last


def fed_spans(trajectory: Trajectory) -> tuple[Indices, Indices]:
    """First and last sample (inclusive) of each stretch that the extruder feeds: a bead, or the part before its cut."""
    first, last = deposits(trajectory)
    for event in cuts(trajectory):
        at = samples_of_rest(trajectory, event)[0]
        last[np.searchsorted(first, at, side="right") - 1] = at
    return first, last


class MoveSection(NamedTuple):
    """The moves of one subroutine: a bead and the approach to it, or the way home.

    number  of the bead in the whole print, from 1; 0 for the way home
    moves   its moves
    about   bead, layer, length and material in words; empty for the way home
    """

    number: int
    moves: range
    about: str


def sections(plan: Plan, moves: Moves) -> Iterator[MoveSection]:
    """All sections that have moves, in the order in which they run."""
    t = plan.trajectory
    first, last = deposits(t)
    bounds = np.searchsorted(moves.after, np.arange(len(first) + 2)).tolist()
    for k, own in enumerate(map(range, bounds[:-1], bounds[1:])):
        if own and k == len(first):
            yield MoveSection(0, own, "")
        elif own:
            bead = int(t.bead[first[k]])
            of = plan.toolpath.beads[bead].material
            length = f"{1e3 * (t.s[last[k]] - t.s[first[k]]):.1f} mm" + (f" of {of}" if of else "")
            yield MoveSection(bead + 1, own, f"Bead {bead}, layer {t.layer[first[k]]}: {length}")


@kept
def moves_with_arcs(plan: Plan) -> Moves:
    """Targets of a plan in a language with circular moves, see `plan_moves`."""
    return plan_moves(plan, arcs=True)


@kept
def moves_of_lines(plan: Plan) -> Moves:
    """Targets of a plan in a language without circular moves."""
    return plan_moves(plan)


def plan_moves(plan: Plan, also: Indices | None = None, fed: Array | None = None, arcs: bool = False) -> Moves:
    """Targets of a plan, and how each is approached.

    also  further samples that must be targets
    fed   (n) filament fed up to each sample [m]; each move that lays material then feeds at one rate
    arcs  the language has circular moves; the problem may still disable them
    """
    trajectory, program = plan.trajectory, plan.problem.program
    n = len(trajectory)
    first, last = deposits(trajectory)
    rests = rests_of(trajectory, first, last)
    way = way_of(plan, rests, fed)
    approach, leave = _flown(way.path, first, last, np.flatnonzero(rests.fine), plan.problem.process.run_in)

    linear = np.zeros(n - 1, dtype=bool)  # whether the interval from sample i to i + 1 is
    for a, b in zip(approach, leave, strict=True):
        linear[a:b] = True
    must = np.zeros(n, dtype=bool)
    must[[0, n - 1]] = True
    must[np.concatenate([first, last, approach, leave])] = True
    if also is not None:
        must[also] = True
    must |= rests.fine
    must[1:] |= rests.inside[1:] & ~np.append(rests.inside[2:], False)  # where the robot moves on after a wait
    must[1:] |= (np.diff(trajectory.bead) != 0) & trajectory.deposit[1:] & trajectory.deposit[:-1]
    must[1:] |= np.diff(trajectory.branch) != 0
    kept = np.flatnonzero(must)
    lines = linear[kept[:-1]]
    rules = FitRules(arcs and program.arcs, program.least_time, program.widening)
    fitted = fit(way, kept[:-1][lines], kept[1:][lines], rules)
    travel = _travel_targets(plan, kept, linear, way.clock, rules)
    sample = np.union1d(fitted.sample, travel)
    arc, middle = np.zeros(n, dtype=bool), trajectory.tip.copy()
    arc[fitted.sample], middle[fitted.sample] = fitted.circular, fitted.via

    a, b = sample[:-1], sample[1:]
    goes = ~rests.inside[b]  # no move between two samples of the same wait
    a, b = a[goes], b[goes]
    took = rests.clock[b] - rests.clock[a]
    leaves, comes = fitted.aim[a], fitted.aim[b]
    is_linear, laid, circular = linear[a], trajectory.deposit[a] & trajectory.deposit[b], arc[b]
    arrives_linear = np.zeros(n, dtype=bool)
    arrives_linear[b[is_linear]] = True
    starts, ends = np.zeros(n, dtype=bool), np.zeros(n, dtype=bool)
    starts[first], ends[fed_spans(trajectory)[1]] = True, True
    half = np.full(len(a), 0.5)
    via = np.column_stack([middle[b], slerp(leaves[:, 3:7], comes[:, 3:7], half), 0.5 * (leaves + comes)[:, 7:]])
    rates = np.abs(comes - leaves)[:, 7:] / took[:, None]
    turns = plan.cell.limits.turns[list(plan.cell.besides)]
    length = segments(leaves[:, :3], via[:, :3], comes[:, :3], circular).length
    peaks = np.maximum.reduceat(np.append(np.diff(way.path), 0.0), a) / trajectory.dt
    whole = np.where(laid, np.cumsum(starts[a]), 0)  # the bead that each move belongs to, from 1
    usual = plan.commanded[trajectory.bead[a]]  # unused for travel
    k = np.concatenate([[0], b])
    targets, turned = Poses(fitted.aim[k]), (fitted.aim[k] != way.pose[k]).any(axis=1)
    return Moves(
        sample=b,
        start=a,
        linear=is_linear,
        circular=circular,
        laid=laid,
        speed=np.where(laid, even_speeds(length, took, whole, usual, program.least_time), peaks),
        turn=angle(leaves[:, 3:7], comes[:, 3:7]) / took,
        axis=rates[:, turns].max(axis=1, initial=0.0),
        slide=rates[:, ~turns].max(axis=1, initial=0.0),
        fine=rests.fine[b],
        waits={int(np.searchsorted(b, at, side="right")) - 1: waits for at, waits in rests.waits.items()},
        on_end=(starts & arrives_linear)[b],
        on_start=(starts & ~arrives_linear)[a],
        off_end=ends[b],
        after=np.searchsorted(leave, a, side="right"),
        targets=targets,
        via=Poses(np.where(circular[:, None], via, comes)),
        q=reached(plan, k, targets, turned),
    )


def run_tolerance(chord: float) -> float:
    """How far lines and arcs may be from the planned run-in and run-out [m], given the chord tolerance on beads [m]."""
    return min(TRAVEL_TOLERANCE, RUN_CHORDS * chord)


def way_of(plan: Plan, rests: Rests, fed: Array | None = None) -> SampledWay:
    """The path that a program's lines and arcs follow, with tolerances; rests and filament as in `plan_moves`."""
    t, program = plan.trajectory, plan.problem.program
    fed = np.zeros(len(t)) if fed is None else fed
    amount = max(float(np.diff(fed).max(initial=0.0)) / t.dt * TIME_TOLERANCE, 1e-12)  # misplaced filament [m]
    # the nozzle may be off by as much along its path as across it; a long chord alone puts it that far off
    time = max(TIME_TOLERANCE, program.chord / float(plan.commanded.max()))
    others = [1.0, time, program.tangent, amount, program.longest]
    turns = plan.cell.limits.turns[list(plan.cell.besides)]
    pose = np.column_stack([t.tip, continuous(t.quat), t.q[:, plan.cell.besides]])
    return SampledWay(
        pose=pose,
        aim=pose,
        clock=rests.clock,
        path=arc_lengths(t.tip),
        fed=np.array(fed),
        laid=t.deposit.copy(),
        tolerance=np.array(
            [
                [run_tolerance(program.chord), TRAVEL_ANGLE_TOLERANCE, TRAVEL_ANGLE_TOLERANCE, *others],
                [program.chord - ROUNDING, AXIS_TOLERANCE, FREE_TOLERANCE, *others],
            ]
        ),
        free=np.where(turns, FREE_TOLERANCE, SLIDE_TOLERANCE),
    )


# ----------------------------------------------------------------------------------------------------
# How well moves fit.


SHORTER = 1e-6  # [s] by which a move may fall short of the least time


@dataclass(frozen=True)
class FitFigures:
    """Moves that lay material but miss a requirement.

    short     those that take less than the least time at their programmed speed; shortest: the shortest move's time [s]
    wide      those that miss the bead by more than the usual tolerances; off, turned: their greatest distance of the
              nozzle's tip from the bead [m], and angle of its axis from the plan's [rad]
    """

    short: Indices
    shortest: float
    wide: Indices
    off: float
    turned: float


def fit_of(plan: Plan, moves: Moves, fed: Array | None = None) -> FitFigures:
    """Which moves of a plan take less than the least time, and which exceed the tolerances to meet it."""
    t = plan.trajectory
    rests = rests_of(t, *deposits(t))
    way = way_of(plan, rests, fed)
    aim = way.pose.copy()
    aim[moves.start], aim[moves.sample] = moves.targets.table[:-1], moves.targets.table[1:]
    way = way._replace(aim=aim)
    laid = np.flatnonzero(moves.laid)
    took = (moves.length / moves.speed)[laid]
    used = misfits(way, moves.start[laid], moves.sample[laid], moves.circular[laid], moves.via.position[laid])
    wide = used.max(axis=1, initial=0.0) > 1.0 + 1e-6
    worst = (used[wide, :2] * way.tolerance[1, :2]).max(axis=0, initial=0.0)
    return FitFigures(
        short=laid[took < plan.problem.program.least_time - SHORTER],
        shortest=float(took.min(initial=np.inf)),
        wide=laid[wide],
        off=float(worst[0]),
        turned=float(worst[1]),
    )


# ----------------------------------------------------------------------------------------------------
# Travel: targets of joint moves.


def _travel_targets(plan: Plan, kept: Indices, linear: Flags, clock: Array, rules: FitRules) -> Indices:
    """Samples at the ends of joint moves, including `kept`: the fewest within tolerance, then fewer still where moves
    take less than the least time and wider tolerances allow it."""
    joint = by_samples(_Joint(plan))

    def judge(a: Indices, b: Indices) -> Array:
        worst = np.zeros(len(a))
        travel = ~linear[a]
        worst[travel] = joint(a[travel], b[travel])
        return worst

    found = fewest(kept, judge)
    failed = np.zeros(len(clock), dtype=bool)
    failed[kept] = True
    while True:
        short = np.diff(clock[found]) < rules.least - 1e-9
        spare = (short[:-1] | short[1:]) & ~failed[found[1:-1]] & ~linear[found[1:-1]]
        at = np.flatnonzero(spare) + 1
        if not len(at):
            return found
        begins = np.concatenate([[True], np.diff(at) > 1])  # of consecutive ones, every other one
        at = at[(at - np.maximum.accumulate(np.where(begins, at, 0))) % 2 == 0]
        good = judge(found[at - 1], found[at + 1]) <= rules.widest
        failed[found[at[~good]]] = True
        found = np.delete(found, at[good])


class _Joint:
    """How far joint moves between two samples miss a third one, in tolerances."""

    def __init__(self, plan: Plan) -> None:
        self._trajectory, self._cell = plan.trajectory, plan.cell

    def __call__(self, a: Indices, b: Indices, k: Indices) -> Array:
        q, tip = self._trajectory.q, self._trajectory.tip
        u = nearest_fraction(q[a], q[b], q[k], (k - a) / (b - a))
        T = self._cell.T_part_nozzle(lerp(q, a, b, u))
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
    """First and last sample of the lines along each bead, including its straight run-in and run-out.

    Slightly more than the run itself: the bead's true end lies up to one sample outside the first one that deposits.
    A rest nearby is a better place to change from joint to linear motion.
    """
    reach = 1.05 * run_in + 0.2e-3 if run_in > 0.0 else 0.0
    approach = np.searchsorted(path, path[first] - reach, side="left")
    leave = np.searchsorted(path, path[last] + reach, side="right") - 1
    if len(rests):
        before = np.searchsorted(rests, first, side="right") - 1
        near = (before >= 0) & (path[rests[before]] >= path[first] - 1.5 * reach)
        approach = np.where(near, rests[before], approach)
        after = np.minimum(np.searchsorted(rests, last), len(rests) - 1)
        near = (rests[after] >= last) & (path[rests[after]] <= path[last] + 1.5 * reach)
        leave = np.where(near, rests[after], leave)
    leave[:-1] = np.minimum(leave[:-1], first[1:])
    return np.minimum(approach, first), np.maximum(leave, last)


# ----------------------------------------------------------------------------------------------------
# Blends: corners between targets are rounded, but blends never overlap and never exceed a tolerance.
#
# A blend leaves the line to a target, and joins the next one, at its radius from the target. Whether it is an arc or a
# parabola, it passes the target at r tan(a / 4), to first order in the angle a by which the lines turn. If r is half a
# segment of a polygon inscribed in a curve, that equals the distance of the segments' midpoints from the curve, on the
# other side. Targets off the path lie on the outer side of its bends, so cutting those corners leads back towards it.

STEP = 1e-6  # [m]; radii are rounded down to multiples of it
NEAR_REST = 0.05e-3  # [m] at most between a target where the program stops and a rest of the plan


def blend_radii(primitives: LinesAndArcs, stops: Flags, tolerance: Array) -> Array:
    """Largest radii (m + 1) [m] at the ends of m primitives with which blends do not overlap and each stays within its
    tolerance (m + 1) of the end.

    0 at `stops` (m + 1), and at the first and the last end, where the motion comes to rest.
    """
    reach, bend = corners(primitives)
    radius = np.minimum(0.5 * reach, tolerance / np.maximum(np.tan(0.25 * bend), 1e-9))
    out: Array = np.where(stops | (reach == 0.0), 0.0, np.floor(radius / STEP * (1.0 + 1e-9)) * STEP)
    return out


def move_radii(plan: Plan, moves: Moves) -> Array:
    """Radii (m) [m] at the ends of moves: 0 at rests, and where joint and linear moves meet."""
    following = np.append(moves.linear[1:], not moves.linear[-1])
    stops = np.concatenate([[True], moves.fine | (following != moves.linear)])
    tolerance = np.concatenate([[0.0], corner_tolerance(plan, moves)])
    tip, via = np.round(moves.targets.position, 6), np.round(moves.via.position, 6)
    return blend_radii(segments(tip[:-1], via, tip[1:], moves.circular), stops, tolerance)[1:]


def corner_tolerance(plan: Plan, moves: Moves) -> Array:
    """How far a blend may pass from the target of each move (m) [m]."""
    out: Array = np.where(moves.linear, plan.problem.program.chord, TRAVEL_TOLERANCE)
    return out


def blend_differences(plan: Plan, program: RobotProgram) -> list[str]:
    """What is wrong with a program's blends and stops, in words; joint moves have a wider tolerance."""
    reach, bend = corners(program.segments)
    lines = program.linear & np.append(program.linear[1:], False)
    allowed = np.where(lines, plan.problem.program.chord, TRAVEL_TOLERANCE)
    found = []
    overlap = program.zone - 0.5 * reach
    if (overlap > 2.0 * STEP).any():
        found.append(f"blends reach {overlap.max():.3g} m beyond the middle of a line")
    beyond = program.zone * np.tan(0.25 * bend) - allowed
    if (beyond > 2.0 * STEP).any():
        found.append(f"blends leave their targets by {beyond.max():.3g} m more than the tolerance")
    stops = lines & program.fine
    if stops.any():
        t = plan.trajectory
        rests = t.tip[rests_of(t, *deposits(t)).fine]
        off = cKDTree(rests).query(program.position[stops])[0]
        if off.max() > NEAR_REST:
            found.append(f"it stops {np.count_nonzero(off > NEAR_REST)} times where the plan does not")
    return found


def corners(primitives: LinesAndArcs) -> tuple[Array, Array]:
    """Length of the shorter primitive at each corner (m + 1) [m], 0 at the first and the last end, and the angle turned
    there (m + 1) [rad]."""
    length = primitives.length
    reach, bend = np.zeros(len(length) + 1), np.zeros(len(length) + 1)
    a, b = primitives.tangents(at_end=True)[:-1], primitives.tangents(at_end=False)[1:]
    reach[1:-1] = np.minimum(length[:-1], length[1:])
    bend[1:-1] = np.arctan2(np.linalg.norm(np.cross(a, b), axis=1), np.einsum("ij,ij->i", a, b))
    return reach, bend
