"""All checks and metrics of a sampled trajectory: `verify` runs them in the order of the report.

Each part takes the input (`Judged`) and returns its results (`Findings`). Lengths are in metres and angles in radians
here; checks and metrics have the units that they name.
"""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import reduce
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from planner.base.arrays import Array
from planner.base.errors import InputError
from planner.base.nearest import distance_to_polyline
from planner.cell.cell import Cell
from planner.collision.print_body import PrintBody, print_body, standing
from planner.plan import TRAVEL, Approach, Check, Trajectory
from planner.problem import Problem
from planner.toolpath.bead import Toolpath
from planner.verify.around_bead import around_beads
from planner.verify.as_printed import as_printed
from planner.verify.by_layer import by_layer
from planner.verify.checks import (
    DIGITS,
    EVERYWHERE,
    SPEED_TOLERANCE,
    Findings,
    Judged,
    bead_errors,
    check_least,
    check_most,
    joined,
    place,
)
from planner.verify.collision import keep_apart, sweep_cell
from planner.verify.crossing import crossing
from planner.verify.executed import executed_motion, straight_at, wrist_straightens
from planner.verify.input_normals import file_normals
from planner.verify.interlayer import interlayer
from planner.verify.material import extrusion
from planner.verify.nozzle import beyond, by_the_tip
from planner.verify.pressed import pressed
from planner.verify.reread.printed import as_the_problem_says
from planner.verify.steering import steering

POSITION_TOLERANCE = 2e-5  # m: tip against the rounded path, for interpolation between waypoints
AXIS_TOLERANCE = np.radians(0.05)  # rad: nozzle axis against the true normal
SPEED_RECORD = 1e-3  # m/s: recorded speed against the mean of two steps, in excess of the spread of four steps
AT_HOME = 1e-6  # rad or m: tolerance of the motion's start and end at home
RECORD_TOLERANCE = 1e-6  # m: recorded tip against the tip by the joints
BLOCK = 32768  # samples processed at once
# Checks that fail where a motion keeps to its path at the path's samples but not between them.
ON_PATH = frozenset(
    {
        "tip on the path",
        "axis on the normal",
        "nozzle to gravity",
        "layer to gravity",
        "layers on the part",
        "nozzle normal to the part",
    }
)


@dataclass(frozen=True)
class Report:
    """checks, metrics by name (units in the names), per-sample series for the report, and approaches (see Plan)."""

    checks: tuple[Check, ...]
    metrics: dict[str, float]
    series: dict[str, Array]
    approaches: tuple[Approach, ...]


def verify(
    problem: Problem,
    cell: Cell,
    toolpath: Toolpath,
    trajectory: Trajectory,
    body: PrintBody | None = None,
) -> Report:
    """Check a trajectory against the cell's limits and the input geometry; a failed check is reported, not raised.

    Raises InputError if arrays of the trajectory differ in length or are empty: then there are no samples to judge.

    body: part and print as obstacles, as `print_body` makes them of this toolpath and cell; made if not given.

    Distances are found in separate threads: their compiled loops release the GIL.
    """
    trajectory, finite = _finite(_samples(trajectory))
    trajectory, numbered = _numbered(trajectory, len(toolpath.beads))
    body = body or print_body(toolpath, standing(cell))
    with ThreadPoolExecutor() as pool:
        apart = pool.submit(sweep_cell, problem, cell, toolpath, trajectory, body)
        judged = Judged(problem, cell, toolpath, trajectory, executed_motion(cell, trajectory), body)
        near = pool.submit(by_the_tip, judged), pool.submit(beyond, judged)
        parts = [
            finite,
            numbered,
            _records(judged),
            joint_limits(judged),
            _geometry(judged),
            file_normals(judged),
            as_the_problem_says(judged),
            _coverage(judged),
            _singularity(judged),
            _speed(judged),
            extrusion(judged),
            around_beads(judged),
            steering(judged),
            by_layer(judged),
            interlayer(judged),
            crossing(judged),
            as_printed(judged),
            pressed(judged),
            _tip_outside(judged),
        ]
        distances, approaches = keep_apart(judged, (near[0].result(), near[1].result()), apart.result())
    found = joined([*parts, distances])
    return Report(found.checks, dict(found.metrics), dict(found.series), approaches)


def _samples(t: Trajectory) -> Trajectory:
    """The trajectory itself. Raises InputError unless it has samples and all of its arrays have a row for each."""
    rows = {name: len(value) for name, value in vars(t).items() if isinstance(value, np.ndarray)}
    odd = next((name for name, count in rows.items() if count != len(t)), None)
    if odd is not None or not len(t):
        raise InputError(f"{rows[odd] if odd else 0} rows for {len(t)} samples", field=f"trajectory.{odd or 't'}")
    return t


def _numbered(t: Trajectory, beads: int) -> tuple[Trajectory, Findings]:
    """The trajectory with samples of beads unknown to the toolpath turned into travel, and the check on these."""
    first = min(max(t.first_bead, 0), beads - 1)
    unknown = (t.bead != TRAVEL) & ((t.bead < first) | (t.bead >= beads))
    odd = unknown | (t.first_bead != first)
    if odd.any():
        t = replace(t, bead=np.where(unknown, TRAVEL, t.bead), first_bead=first)
    return t, Findings((check_most(t, "beads of the toolpath", odd.astype(float), 0.0, "that are not"),))


def _finite(t: Trajectory) -> tuple[Trajectory, Findings]:
    """The trajectory with 0 in place of each number that is not finite, and the check that there are none."""
    fields = {name: value for name, value in vars(t).items() if isinstance(value, np.ndarray)}
    bad = np.zeros(len(t))
    for value in fields.values():
        finite = np.isfinite(value)
        if not finite.all():  # counting per sample takes far longer
            bad += (~finite).reshape(len(t), -1).sum(axis=1)
    if bad.any():
        numbers: dict[str, Any] = {k: np.nan_to_num(v, posinf=0.0, neginf=0.0) for k, v in fields.items()}
        t = replace(t, **numbers)
    return t, Findings((check_most(t, "all numbers finite", bad, 0.0, "that are not"),))


def _records(judged: Judged) -> Findings:
    """Recorded tip, axis, orientation, branch, times and beads agree with the joints and the samples."""
    t, motion = judged.trajectory, judged.motion
    off = np.empty(len(t))
    for rows in _blocks(len(t)):
        tip = np.linalg.norm(motion.tip[rows] - t.tip[rows], axis=1)
        axis = np.linalg.norm(motion.axis[rows] - t.axis[rows], axis=1)
        rotation = _worst(np.abs(motion.rotation[rows] - rotations(t.quat[rows])).reshape(len(tip), 9))
        off[rows] = np.maximum(np.maximum(tip, axis), rotation)
    checks = [check_most(t, "recorded poses", off * 1e3, RECORD_TOLERANCE * 1e3, "mm")]
    if judged.cell.spherical:  # for other wrists, no program states a branch
        checks.append(check_most(t, "recorded branch", (motion.branch != t.branch).astype(float), 0.0, ""))
    odd = (np.abs(t.t - np.arange(len(t)) * t.dt) > DIGITS) | (t.deposit != (t.bead >= 0))
    checks.append(check_most(t, "recorded times and beads", odd.astype(float), 0.0, ""))
    astray = (t.bead == TRAVEL) & (t.s != 0.0) | (_layers_around(judged) != t.layer[:, None]).all(axis=1)
    checks.append(check_most(t, "recorded layers and lengths", astray.astype(float), 0.0, ""))
    return Findings((*checks, _home(judged), *_nozzles(judged)))


def _layers_around(judged: Judged) -> NDArray[np.int64]:
    """Layers (n, 2) of the bead that each sample belongs to, or in travel of those before and after it."""
    t, k = judged.trajectory, np.arange(len(judged.trajectory))
    on = t.bead != TRAVEL
    before = np.maximum.accumulate(np.where(on, k, -1))
    after = np.minimum.accumulate(np.where(on, k, len(t))[::-1])[::-1]
    before, after = np.where(before < 0, after, before), np.where(after == len(t), before, after)
    layers = np.array([bead.layer for bead in judged.toolpath.beads])
    if not on.any():
        return np.broadcast_to(t.layer[:, None], (len(t), 2))  # another check reports that nothing is laid
    return layers[t.bead[np.column_stack([before, after])]]


def _home(judged: Judged) -> Check:
    """The arm starts at home and returns there; the positioner may stand where the first bead wants it instead."""
    return _at_home(judged, "starts and ends at home", [0, len(judged.trajectory) - 1])


def _nozzles(judged: Judged) -> Iterator[Check]:
    """The check that the arm is at home whenever another nozzle comes into use."""
    if judged.cell.nozzles:
        yield _at_home(judged, "nozzles changed at home", [rows.start for _, rows in judged.stretches[1:]])


def _at_home(judged: Judged, name: str, samples: list[int]) -> Check:
    """The check that the arm is at home at some samples: in degrees, or in mm if a sliding joint is farthest off."""
    t, cell, arm = judged.trajectory, judged.cell, len(judged.cell.arm)
    away, turns = np.abs(t.q[samples, :arm] - cell.home[:arm]), cell.limits.turns[:arm]
    turned, slid = (away[:, kind].max(axis=1, initial=0.0) for kind in (turns, ~turns))
    slides = slid.max(initial=0.0) > turned.max(initial=0.0)
    scale, unit = (1e3, "mm") if slides else (float(np.degrees(1.0)), "deg")
    off = np.zeros(len(t))
    off[samples] = slid if slides else turned
    return check_most(t, name, scale * off, scale * AT_HOME, unit)


def joint_limits(judged: Judged) -> Findings:
    """Joint ranges, and velocity, acceleration and jerk by central differences of the samples."""
    t, limits = judged.trajectory, judged.cell.limits
    q = np.vstack([t.q[:1], t.q[:1], t.q, t.q[-1:], t.q[-1:]])  # at rest before and after
    margin, room, step = np.empty(len(t)), np.empty(len(t)), np.empty(len(t))
    ratios = {name: np.empty(len(t)) for name in ("velocity", "acceleration", "jerk")}
    for rows in _blocks(len(t)):
        a, b, c, d, e = (q[rows.start + k : rows.stop + k] for k in range(5))
        beyond = np.maximum(limits.q_min - c, c - limits.q_max)
        margin[rows] = np.degrees(-_worst(beyond[:, limits.turns]))
        if limits.sliding:
            room[rows] = -_worst(beyond[:, ~limits.turns])
        step[rows] = _worst(np.abs(c - b) / (limits.velocity * t.dt))
        velocity, acceleration = (d - b) / (2.0 * t.dt), (d - 2.0 * c + b) / t.dt**2
        jerk = (e - 2.0 * d + 2.0 * b - a) / (2.0 * t.dt**3)
        ratios["velocity"][rows] = _worst(np.abs(velocity) / limits.velocity)
        ratios["acceleration"][rows] = _worst(np.abs(acceleration) / limits.acceleration)
        ratios["jerk"][rows] = _worst(np.abs(jerk) / limits.jerk)
    in_range = check_least(t, "joint range", margin, 0.0, "deg")
    on_rail = (check_least(t, "rail range", room * 1e3, 0.0, "mm"),) if limits.sliding else ()
    return Findings(
        (
            in_range,
            *on_rail,
            *(check_most(t, f"joint {name}", ratio, 1.0, "of limit") for name, ratio in ratios.items()),
            check_most(t, "continuity", step, 1.0, "of a sample's travel at full speed"),
        ),
        {"joint_limit_margin_deg": in_range.worst}
        | ({"rail_margin_mm": on_rail[0].worst} if on_rail else {})
        | {f"{name}_ratio_max": float(ratio.max()) for name, ratio in ratios.items()},
        {"limit_margin_deg": margin} | {f"{name}_ratio": ratio for name, ratio in ratios.items()},
    )


def _geometry(judged: Judged) -> Findings:
    """Tip on the rounded path, axis on the true normal, and rounded and input path within tolerance of each other."""
    process, t, motion = judged.problem.process, judged.trajectory, judged.motion
    position, deviation, normals, unreached = _off_the_path(judged)
    cosine = -(normals * motion.axis).sum(axis=1)
    sine = np.linalg.norm(np.cross(normals, motion.axis), axis=1)
    lean = np.where(t.deposit, np.arctan2(sine, cosine), 0.0)
    tilt = np.maximum(lean - process.cones.tilt, 0.0)
    tolerance = process.corner_tolerance * 1e3
    on_path = check_most(t, "tip on the path", position * 1e3, POSITION_TOLERANCE * 1e3, "mm")
    on_normal = check_most(t, "axis on the normal", np.degrees(tilt), np.degrees(AXIS_TOLERANCE), "deg")
    within = check_most(t, "path within corner tolerance", deviation * 1e3, tolerance, "mm")
    reached = unreached * 1e3 <= tolerance * (1.0 + DIGITS)
    both_ways = Check("input path reached everywhere", unreached * 1e3, tolerance, "mm", reached, "input path")
    metrics: dict[str, float] = {}
    series: dict[str, Array] = {}
    if process.cones.tilt > 0.0:
        series["tilt_deg"] = np.degrees(lean)
        metrics["tilt_max_deg"] = float(series["tilt_deg"].max())
        metrics["tilt_bead_error_max_mm"] = float(bead_errors(judged.toolpath, t, lean).max()) * 1e3
    metrics["position_error_max_mm"] = on_path.worst
    metrics["axis_error_max_deg"] = on_normal.worst
    metrics["path_deviation_max_mm"] = max(within.worst, unreached * 1e3)
    leans = list(_to_gravity(judged, normals))
    off = [position / POSITION_TOLERANCE, tilt / AXIS_TOLERANCE, *(beyond / AXIS_TOLERANCE for _, beyond in leans)]
    series["off_the_path"] = np.max(off, axis=0)
    return Findings((on_path, on_normal, *(check for check, _ in leans), within, both_ways), metrics, series)


def _off_the_path(judged: Judged) -> tuple[Array, Array, Array, float]:
    """Distances (n) [m] of the tip from the rounded path and from the input path, the true surface normals (n, 3), and
    the greatest distance [m] of the input path from the rounded one. 0 in travel."""
    t, tip = judged.trajectory, judged.motion.tip
    position, deviation, normals, unreached = np.zeros(len(t)), np.zeros(len(t)), np.zeros((len(t), 3)), 0.0
    for i, (at, bead) in enumerate(zip(judged.samples, judged.toolpath.beads, strict=True)):
        if not len(at):
            continue  # the coverage check names this bead
        path = CubicSpline(bead.s, bead.points)
        position[at] = np.linalg.norm(path(t.s[at]) - tip[at], axis=1)
        deviation[at] = distance_to_polyline(tip[at], bead.source)
        normals[at] = judged.toolpath.surface.normals_on(i, t.s[at], judged.drawn_tip[at])
        unreached = max(unreached, float(distance_to_polyline(bead.source, path(_denser(bead.s))).max()))
    return position, deviation, normals, unreached


def _to_gravity(judged: Judged, normals: Array) -> Iterator[tuple[Check, Array]]:
    """The checks of the cones about the vertical that the problem sets, and the lean beyond each cone (n) [rad];
    normals (n, 3) of the surface."""
    t, motion, cones = judged.trajectory, judged.motion, judged.problem.process.cones
    for name, cosine, cone in (
        ("nozzle to gravity", -(motion.axis * motion.up).sum(axis=1), cones.nozzle_gravity),
        ("layer to gravity", (normals * motion.up).sum(axis=1), cones.layer_gravity),
    ):
        if cone == np.pi:
            continue
        lean = np.where(t.deposit, np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))), 0.0)
        yield check_most(t, name, lean, np.degrees(cone + AXIS_TOLERANCE), "deg"), np.radians(lean) - cone


def _coverage(judged: Judged) -> Findings:
    """Every bead from the first one on is laid once, in order, from start to end, never backwards."""
    t, toolpath = judged.trajectory, judged.toolpath
    step = float(judged.commanded.max()) * t.dt * (1.0 + SPEED_TOLERANCE)
    worst, where = 0.0, EVERYWHERE
    starts = np.flatnonzero(t.deposit & (np.concatenate([[-1], t.bead[:-1]]) != t.bead))
    beads = toolpath.beads
    laid = range(t.first_bead, len(beads))
    in_order = np.array_equal(t.bead[starts], laid)
    for i in laid:
        s, bead = t.s[judged.samples[i]], beads[i]
        gaps = np.diff(np.concatenate([[0.0], s, [bead.length]]))
        gap = float(gaps.max()) if len(s) and gaps.min() >= 0.0 else bead.length
        if gap > worst:
            worst, where = gap, f"bead {i}"
    if not in_order:
        where = "beads out of order, missing, or laid down twice"
    ok = in_order and worst <= step
    return Findings(
        (Check("every bead complete", worst * 1e3, step * 1e3, "mm between samples", ok, where),),
        {
            "beads": len(laid),
            "layers": toolpath.layers_from(t.first_bead),
            "waypoints": sum(len(bead.s) for bead in beads[t.first_bead :]),
            "deposited_length_mm": sum(bead.length for bead in beads[t.first_bead :]) * 1e3,
        },
    )


def _singularity(judged: Judged) -> Findings:
    """Distance from singularities of the arm alone, and no change of branch while material flows."""
    cell, t, motion = judged.cell, judged.trajectory, judged.motion
    metrics: dict[str, float] = {}
    series = {"sigma": motion.sigma}
    sides = [np.sign(motion.det)]
    if len(cell.solved) == len(cell.arm) - cell.rails and wrist_straightens(cell):
        # singular where axes 4 and 6 are parallel; seven axes and skew wrists have other singularities
        fifth = t.q[:, 4 + cell.rails]
        if away := straight_at(cell):
            fifth = fifth - away
        sides.append(np.sign(np.sin(fifth)))
        series["wrist_deg"] = np.degrees(np.arcsin(np.abs(np.sin(fifth))))  # parallel at half a turn, too
        metrics["wrist_margin_deg"] = float(series["wrist_deg"][t.deposit].min(initial=90.0))
    sigma = np.where(t.deposit, motion.sigma, np.inf)
    margin = check_least(t, "singularity margin", sigma, judged.problem.resolve.min_sigma, "")
    together = t.deposit[1:] & (t.bead[1:] == t.bead[:-1])
    flips = np.any([side[1:] != side[:-1] for side in sides], axis=0)
    count = int((flips & together).sum())
    i = int(np.argmax(flips & together))
    where, at = (place(t, i), i) if count else (EVERYWHERE, -1)
    metrics["sigma_min"] = margin.worst
    metrics["sigma_p01"] = float(np.quantile(motion.sigma[t.deposit], 0.01)) if t.deposit.any() else 0.0
    metrics["branch_changes_in_deposition"] = count
    changes = Check("branch changes in deposition", float(count), 0.0, "", count == 0, where, sample=at)
    return Findings((margin, changes), metrics, series)


def _speed(judged: Judged) -> Findings:
    """Speed of the tip along the part, from the tip itself; excess fails, dips only lower the metrics."""
    process, t, motion = judged.problem.process, judged.trajectory, judged.motion
    commanded = np.where(t.deposit, judged.commanded[t.bead], judged.commanded.max())
    step = np.linalg.norm(np.diff(motion.tip, axis=0), axis=1) / t.dt
    # within a bead, along the path, since chords cut sharp corners; whether the tip is on the path is checked elsewhere
    inside = t.deposit[1:] & (t.bead[1:] == t.bead[:-1])
    step = np.where(inside, np.diff(t.s) / t.dt, step)
    for _, rows in judged.stretches[1:]:
        step[rows.start - 1] = 0.0  # another nozzle's tip, not a motion
    before, after = np.concatenate([step[:1], step]), np.concatenate([step, step[-1:]])
    mean = 0.5 * (before + after)
    limit = commanded * (1.0 + SPEED_TOLERANCE)
    fast = np.where(t.deposit, np.maximum(mean, t.speed), 0.0)
    differ = _of_four(np.maximum, before, after) - _of_four(np.minimum, before, after)
    claim = np.where(t.deposit, np.abs(t.speed - mean) - differ, np.abs(t.speed - _own_speed(judged)))
    travel = np.where(t.deposit, 0.0, mean)
    slow = np.minimum(mean, t.speed)[t.deposit]  # the mean alone would smooth away the bottom of a short dip
    at_speed = t.deposit & (mean >= commanded * (1.0 - SPEED_TOLERANCE)) & (mean <= limit)
    deposited = mean[t.deposit].sum()
    fastest = _fastest(judged, fast, limit)
    laid = slice(t.first_bead, None)
    lengths = np.array([bead.length for bead in judged.toolpath.beads])
    return Findings(
        (
            fastest,
            check_most(t, "recorded speed", claim * 1e3, SPEED_RECORD * 1e3, "mm/s"),
            check_most(t, "speed in travel", travel * 1e3, process.travel_speed * 1e3, "mm/s"),
        ),
        {
            "speed_max_mm_s": float(fast.max()) * 1e3,
            "speed_min_mm_s": float(slow.min()) * 1e3 if len(slow) else 0.0,
            "at_speed_fraction": float(mean[at_speed].sum() / deposited) if deposited else 0.0,
            "deposition_time_s": float(np.count_nonzero(t.deposit & (mean > 0.0)) * t.dt),
            "ideal_deposition_time_s": float((lengths / judged.commanded)[laid].sum()),
            "print_time_s": float(t.t[-1]),
        },
    )


def _of_four(extreme: np.ufunc, before: Array, after: Array) -> Array:
    """The greatest or least (n) of the speeds of the two steps before and the two after each sample."""
    out = np.asarray(extreme(before, after))
    extreme(out[1:], before[:-1], out=out[1:])
    extreme(out[:-1], after[1:], out=out[:-1])
    return out


def _own_speed(judged: Judged) -> Array:
    """Speed of the tip (n) [m/s] by central differences, one-sided at the ends of each nozzle's stretch."""
    tip, dt, out = judged.motion.tip, judged.trajectory.dt, np.zeros(len(judged.trajectory))
    for _, stretch in judged.stretches:
        if stretch.stop - stretch.start < 2:
            continue
        for rows in _blocks(stretch.stop - stretch.start):
            first, last = max(stretch.start + rows.start - 1, stretch.start), stretch.start + rows.stop
            some = np.linalg.norm(np.gradient(tip[first : min(last + 1, stretch.stop)], dt, axis=0), axis=1)
            begin = stretch.start + rows.start
            out[begin:last] = some[begin - first : last - first]
    return out


def _fastest(judged: Judged, fast: Array, limit: Array) -> Check:
    """The check that the tip's speed (n) [m/s] keeps to its limit (n), at the sample with the greatest share of it."""
    i = int(np.argmax(fast / limit))
    worst, most = float(fast[i]) * 1e3, float(limit[i]) * 1e3
    return Check(
        "speed in deposition",
        worst,
        most,
        "mm/s",
        worst <= most * (1.0 + DIGITS),
        place(judged.trajectory, i),
        sample=i,
    )


def _tip_outside(judged: Judged) -> Findings:
    """The nozzle tip stays outside the part, as printed so far.

    Of the bead being laid, only the stretch that lies on nothing else counts: the bead may be its own next layer.
    """
    t = judged.trajectory
    begun = np.where(t.deposit, t.bead, t.begun + 1)
    gap = np.zeros(len(t))
    changes = np.flatnonzero(np.diff(begun)) + 1
    for first, last in zip(np.append(0, changes), np.append(changes, len(t)), strict=True):
        surface = judged.toolpath.surface.before(int(begun[first]))
        gap[first:last] = surface.signed_distance(judged.drawn_tip[first:last])
    outside = check_least(t, "nozzle tip outside the part", gap * 1e3, 0.0, "mm")
    return Findings((outside,), {"tip_clearance_min_mm": outside.worst})


def _blocks(n: int) -> Iterator[slice]:
    """Samples in blocks, to bound the memory."""
    return (slice(start, min(start + BLOCK, n)) for start in range(0, n, BLOCK))


def _worst(values: Array) -> Array:
    """The greatest value of each row (n) of a few columns; column by column, numpy takes a tenth of the time."""
    return np.asarray(reduce(np.maximum, values.T))


def rotations(quat: Array) -> Array:
    """Rotation matrices (n, 3, 3) of unit quaternions (n, 4), x y z w."""
    x, y, z, w = quat.T
    return np.stack(
        [
            np.stack([1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)], axis=-1),
            np.stack([2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)], axis=-1),
            np.stack([2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)], axis=-1),
        ],
        axis=1,
    )


def _denser(s: Array) -> Array:
    """Arc lengths four times as dense, so that chords between them hardly count as deviation."""
    k = np.arange(len(s), dtype=float)
    return np.interp(np.linspace(0.0, k[-1], 4 * len(k)), k, s)
