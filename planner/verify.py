"""Independent verification of a sampled trajectory: Pinocchio on q(t), the input geometry, and nothing else.

No code of the optimiser, of the planner's own kinematics or of the timing is used here; what the trajectory
says of itself (tip, axis, speed, flow) is compared with what its joints do.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from planner.cell import Cell, Robot
from planner.nearest import distance_to_polyline
from planner.plan import Check, Trajectory
from planner.problem import Problem
from planner.toolpath.bead import Toolpath

Array = NDArray[np.float64]

POSITION_TOLERANCE = 2e-5  # m, tip against the rounded path: a tenth of what an IRB 140 repeats
AXIS_TOLERANCE = np.radians(0.05)  # rad, nozzle axis against the true normal
SPEED_TOLERANCE = 0.02  # of the commanded speed: within it a sample counts as at speed
EXTRUSION_TOLERANCE = 1e-3  # of the volume
RECORD_TOLERANCE = 1e-6  # m: what the trajectory says of its tip against what its joints do
DIGITS = 1e-9  # relative: limits are compared with this much room for rounding


@dataclass(frozen=True)
class Report:
    """checks, metrics by name (units in the names), and per-sample series for the report (see Plan)."""

    checks: tuple[Check, ...]
    metrics: dict[str, float]
    series: dict[str, Array]


@dataclass(frozen=True)
class _Motion:
    """What Pinocchio says of the samples: tip and axis in the part frame; of the arm's Jacobian the smallest
    singular value (NaN in travel, where no limit stands on it) and the determinant."""

    tip: Array
    axis: Array
    sigma: Array
    det: Array


def verify(problem: Problem, cell: Cell, toolpath: Toolpath, trajectory: Trajectory) -> Report:
    """Check a trajectory against the cell's limits and the input geometry; a failed check is reported, not raised."""
    motion = _replay(cell, trajectory)
    checks: list[Check] = []
    metrics: dict[str, float] = {}
    series: dict[str, Array] = {}
    for part in (_records, _limits, _geometry, _coverage, _singularity, _speed, _extrusion, _clearance):
        part(problem, cell, toolpath, trajectory, motion, checks, metrics, series)
    return Report(tuple(checks), metrics, series)


def _replay(cell: Cell, trajectory: Trajectory) -> _Motion:
    """Forward kinematics and Jacobians of every sample, from the robots' URDF models."""
    arm, na = cell.arm_robot, len(cell.arm)
    q = np.ascontiguousarray(trajectory.q)
    T_base_nozzle, J = _nozzle(arm, cell.T_flange_nozzle, q[:, :na])
    T_world_nozzle = cell.T_world_base @ T_base_nozzle
    T_world_part = _part(cell, q[:, na:])
    R = np.swapaxes(T_world_part[:, :3, :3], 1, 2)
    tip = np.einsum("nij,nj->ni", R, T_world_nozzle[:, :3, 3] - T_world_part[:, :3, 3])
    axis = np.einsum("nij,nj->ni", R, T_world_nozzle[:, :3, 2])
    sigma = np.full(len(q), np.nan)
    sigma[trajectory.deposit] = np.linalg.svd(J[trajectory.deposit], compute_uv=False)[:, -1]
    return _Motion(tip, axis, sigma, np.linalg.det(J))


def _nozzle(arm: Robot, T_flange_nozzle: Array, q: Array) -> tuple[Array, Array]:
    """Nozzle poses in the arm's base (n, 4, 4) and Jacobians at the nozzle tip (n, 6, 6), world axes."""
    model = arm.model.copy()
    flange = model.frames[model.getFrameId(arm.tip)]
    placement = flange.placement * pin.SE3(T_flange_nozzle)
    nozzle = model.addFrame(pin.Frame("nozzle", flange.parentJoint, placement, pin.FrameType.OP_FRAME))
    data = model.createData()
    T = np.empty((len(q), 4, 4))
    J = np.empty((len(q), 6, model.nv))
    for i, row in enumerate(q):
        J[i] = pin.computeFrameJacobian(model, data, row, nozzle, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED)
        pin.updateFramePlacement(model, data, nozzle)
        T[i] = data.oMf[nozzle].homogeneous
    return T, J


def _part(cell: Cell, q_free: Array) -> Array:
    """Part poses in the world (n, 4, 4), from the positioner's URDF model with its held axes at their angles."""
    if cell.holder_robot is None:
        return np.broadcast_to(cell.T_world_holder, (len(q_free), 4, 4))
    robot = cell.holder_robot
    model, data = robot.model, robot.model.createData()
    tip = model.getFrameId(robot.tip)
    names = list(model.names[1:])
    q = np.array([cell.held.get(name, 0.0) for name in names])
    free = [names.index(name) for name in cell.holder.names]
    postures, which = np.unique(q_free, axis=0, return_inverse=True)  # a table often rests
    T = np.empty((len(postures), 4, 4))
    for i, row in enumerate(postures):
        q[free] = row
        pin.framesForwardKinematics(model, data, q)
        T[i] = data.oMf[tip].homogeneous
    return (cell.T_world_holder_base @ T)[which.ravel()]


def _where(trajectory: Trajectory, i: int) -> str:
    """The place of a sample in words."""
    bead = int(trajectory.bead[i])
    spot = f"bead {bead}, {trajectory.s[i] * 1e3:.1f} mm" if bead >= 0 else "travel"
    return f"t = {trajectory.t[i]:.3f} s, {spot}"


def _check_most(checks: list[Check], t: Trajectory, name: str, values: Array, limit: float, unit: str) -> float:
    """Append the check that no value (n) exceeds the limit; returns the worst. NaN fails."""
    i = int(np.argmax(np.where(np.isnan(values), np.inf, values)))
    worst = float(values[i])
    checks.append(Check(name, worst, limit, unit, bool(worst <= limit * (1.0 + DIGITS)), _where(t, i)))
    return worst


def _check_least(checks: list[Check], t: Trajectory, name: str, values: Array, limit: float, unit: str) -> float:
    """Append the check that no value (n) falls below the limit; returns the worst. NaN fails."""
    i = int(np.argmin(np.where(np.isnan(values), -np.inf, values)))
    worst = float(values[i])
    checks.append(Check(name, worst, limit, unit, bool(worst >= limit - DIGITS * abs(limit)), _where(t, i)))
    return worst


def _records(problem, cell, toolpath, t, motion, checks, metrics, series) -> None:  # type: ignore[no-untyped-def]
    """The trajectory's own tip and axis are those of its joints."""
    off = np.maximum(np.linalg.norm(motion.tip - t.tip, axis=1), np.linalg.norm(motion.axis - t.axis, axis=1))
    _check_most(checks, t, "recorded poses", off * 1e3, RECORD_TOLERANCE * 1e3, "mm")


def _limits(problem, cell, toolpath, t, motion, checks, metrics, series) -> None:  # type: ignore[no-untyped-def]
    """Joint ranges, speed, acceleration and jerk by central differences of the samples."""
    limits = cell.limits
    margin = np.minimum(t.q - limits.q_min, limits.q_max - t.q)
    series["limit_margin_deg"] = np.degrees(margin.min(axis=1))
    metrics["joint_limit_margin_deg"] = _check_least(checks, t, "joint range", series["limit_margin_deg"], 0.0, "deg")
    q = np.vstack([t.q[:1], t.q[:1], t.q, t.q[-1:], t.q[-1:]])  # at rest before and after
    velocity = (q[3:-1] - q[1:-3]) / (2.0 * t.dt)
    acceleration = (q[3:-1] - 2.0 * q[2:-2] + q[1:-3]) / t.dt**2
    jerk = (q[4:] - 2.0 * q[3:-1] + 2.0 * q[1:-3] - q[:-4]) / (2.0 * t.dt**3)
    for name, values, limit in (
        ("velocity", velocity, limits.velocity),
        ("acceleration", acceleration, limits.acceleration),
        ("jerk", jerk, limits.jerk),
    ):
        ratio = (np.abs(values) / limit).max(axis=1)
        series[f"{name}_ratio"] = ratio
        metrics[f"{name}_ratio_max"] = float(ratio.max())
        if name != "jerk":
            _check_most(checks, t, f"joint {name}", ratio, 1.0, "of limit")
    step = (np.abs(np.diff(t.q, axis=0, prepend=t.q[:1])) / (limits.velocity * t.dt)).max(axis=1)
    _check_most(checks, t, "continuity", step, 1.0, "of a sample's travel at full speed")


def _geometry(problem, cell, toolpath, t, motion, checks, metrics, series) -> None:  # type: ignore[no-untyped-def]
    """Tip on the rounded path, axis on the true normal, rounded path within tolerance of the input, both ways."""
    position, deviation = np.zeros(len(t)), np.zeros(len(t))
    unreached = 0.0
    for i, bead in enumerate(toolpath.beads):
        at = np.flatnonzero(t.bead == i)
        if len(at) < 2:
            continue  # the coverage check names this bead
        tip = motion.tip[at]
        path = CubicSpline(bead.s, bead.points)
        position[at] = np.linalg.norm(path(t.s[at]) - tip, axis=1)
        deviation[at] = distance_to_polyline(tip, bead.source)
        unreached = max(unreached, float(distance_to_polyline(bead.source, path(_denser(bead.s))).max()))
    normals = toolpath.surface.normals(motion.tip)
    cosine = -(normals * motion.axis).sum(axis=1)
    sine = np.linalg.norm(np.cross(normals, motion.axis), axis=1)
    tilt = np.where(t.deposit, np.arctan2(sine, cosine), 0.0)
    tolerance = problem.process.corner_tolerance * 1e3
    worst = _check_most(checks, t, "tip on the path", position * 1e3, POSITION_TOLERANCE * 1e3, "mm")
    metrics["position_error_max_mm"] = worst
    worst = _check_most(checks, t, "axis on the normal", np.degrees(tilt), np.degrees(AXIS_TOLERANCE), "deg")
    metrics["axis_error_max_deg"] = worst
    worst = _check_most(checks, t, "path within corner tolerance", deviation * 1e3, tolerance, "mm")
    ok = unreached * 1e3 <= tolerance * (1.0 + DIGITS)
    checks.append(Check("input path reached everywhere", unreached * 1e3, tolerance, "mm", ok, "input path"))
    metrics["path_deviation_max_mm"] = max(worst, unreached * 1e3)


def _denser(s: Array) -> Array:
    """Arc lengths four times as dense, so that the chords between samples do not count as deviation."""
    k = np.arange(len(s), dtype=float)
    return np.interp(np.linspace(0.0, k[-1], 4 * len(k)), k, s)


def _coverage(problem, cell, toolpath, t, motion, checks, metrics, series) -> None:  # type: ignore[no-untyped-def]
    """Every bead is laid down once, in order, from its start to its end, always forwards."""
    step = problem.process.speed * t.dt * (1.0 + SPEED_TOLERANCE)
    worst, where = 0.0, "everywhere"
    starts = np.flatnonzero(t.deposit & (np.concatenate([[-1], t.bead[:-1]]) != t.bead))
    in_order = np.array_equal(t.bead[starts], np.arange(len(toolpath.beads)))
    for i, bead in enumerate(toolpath.beads):
        s = t.s[t.bead == i]
        gaps = np.diff(np.concatenate([[0.0], s, [bead.length]]))
        gap = float(gaps.max()) if len(s) and gaps.min() >= 0.0 else bead.length
        if gap > worst:
            worst, where = gap, f"bead {i}"
    if not in_order:
        where = "beads out of order, missing, or laid down twice"
    ok = in_order and worst <= step
    checks.append(Check("every bead complete", worst * 1e3, step * 1e3, "mm between samples", ok, where))
    metrics["beads"] = len(toolpath.beads)
    metrics["layers"] = toolpath.layers
    metrics["waypoints"] = sum(len(bead.s) for bead in toolpath.beads)
    metrics["deposited_length_mm"] = toolpath.length * 1e3


def _singularity(problem, cell, toolpath, t, motion, checks, metrics, series) -> None:  # type: ignore[no-untyped-def]
    """Distance from singularities of the arm alone, and no change of branch while material flows."""
    series["sigma"] = motion.sigma
    series["wrist_deg"] = np.degrees(np.abs(t.q[:, 4]))
    sigma = np.where(t.deposit, motion.sigma, np.inf)
    metrics["sigma_min"] = _check_least(checks, t, "singularity margin", sigma, problem.resolve.min_sigma, "")
    metrics["sigma_p01"] = float(np.quantile(motion.sigma[t.deposit], 0.01)) if t.deposit.any() else 0.0
    metrics["wrist_margin_deg"] = float(series["wrist_deg"][t.deposit].min(initial=180.0))
    together = t.deposit[1:] & (t.bead[1:] == t.bead[:-1])
    flips = (np.sign(motion.det[1:]) != np.sign(motion.det[:-1])) | (np.sign(t.q[1:, 4]) != np.sign(t.q[:-1, 4]))
    count = int((flips & together).sum())
    i = int(np.argmax(flips & together))
    where = _where(t, i) if count else "everywhere"
    checks.append(Check("branch changes in deposition", float(count), 0.0, "", count == 0, where))
    metrics["branch_changes_in_deposition"] = count


def _speed(problem, cell, toolpath, t, motion, checks, metrics, series) -> None:  # type: ignore[no-untyped-def]
    """Speed of the tip along the part, from the tip itself; dips are counted, excess fails."""
    commanded = problem.process.speed
    chord = np.linalg.norm(np.diff(motion.tip, axis=0), axis=1)
    mean = np.concatenate([chord[:1], 0.5 * (chord[1:] + chord[:-1]), chord[-1:]]) / t.dt
    limit = commanded * (1.0 + SPEED_TOLERANCE)
    fast = np.where(t.deposit, np.maximum(mean, t.speed), 0.0)
    metrics["speed_max_mm_s"] = _check_most(checks, t, "speed in deposition", fast * 1e3, limit * 1e3, "mm/s")
    travel = np.where(t.deposit, 0.0, mean)
    _check_most(checks, t, "speed in travel", travel * 1e3, problem.process.travel_speed * 1e3, "mm/s")
    metrics["speed_min_mm_s"] = float(mean[t.deposit].min()) * 1e3 if t.deposit.any() else 0.0
    at_speed = t.deposit & (mean >= commanded * (1.0 - SPEED_TOLERANCE)) & (mean <= limit)
    deposited = mean[t.deposit].sum()
    metrics["at_speed_fraction"] = float(mean[at_speed].sum() / deposited) if deposited else 0.0
    metrics["deposition_time_s"] = float(t.deposit.sum() * t.dt)
    metrics["ideal_deposition_time_s"] = toolpath.length / commanded
    metrics["print_time_s"] = float(t.t[-1])


def _extrusion(problem, cell, toolpath, t, motion, checks, metrics, series) -> None:  # type: ignore[no-untyped-def]
    """Material: none outside beads, never backwards, and per bead as much as the bead holds."""
    worst, where = 0.0, "everywhere"
    for i, bead in enumerate(toolpath.beads):
        volume = bead.width * bead.height * bead.length
        off = abs(float(t.flow[t.bead == i].sum()) * t.dt - volume) / volume
        if off > worst:
            worst, where = off, f"bead {i}"
    stray = bool((t.flow[~t.deposit] != 0.0).any() or (t.flow < 0.0).any())
    balanced = abs(float(t.extruded[-1]) - _volume(toolpath)) <= EXTRUSION_TOLERANCE * _volume(toolpath)
    if stray:
        where = "material flows outside a bead"
    ok = worst <= EXTRUSION_TOLERANCE and balanced and not stray
    checks.append(Check("extrusion balance", worst, EXTRUSION_TOLERANCE, "of a bead's volume", ok, where))
    filament = np.pi * (0.5 * problem.process.filament_diameter) ** 2
    metrics["extruded_volume_mm3"] = float(t.extruded[-1]) * 1e9
    metrics["extruded_mm"] = float(t.extruded[-1]) / filament * 1e3


def _volume(toolpath: Toolpath) -> float:
    return float(sum(bead.width * bead.height * bead.length for bead in toolpath.beads))


def _clearance(problem, cell, toolpath, t, motion, checks, metrics, series) -> None:  # type: ignore[no-untyped-def]
    """The nozzle tip stays outside the part."""
    gap = toolpath.surface.signed_distance(motion.tip)
    metrics["clearance_min_mm"] = _check_least(checks, t, "nozzle tip outside the part", gap * 1e3, 0.0, "mm")
