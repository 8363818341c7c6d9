"""What a task demands of the joints, a joint path that meets it, and its derivatives by arc length."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import NoReturn

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BSpline, make_interp_spline
from scipy.spatial.transform import Rotation

from planner.base.arrays import Array, Ints
from planner.base.compiled import njit
from planner.base.errors import Hints, Refusal
from planner.base.geometry import TURN
from planner.base.processes import of_each
from planner.cell.cell import Cell, Limits, rigid_inverse
from planner.resolve.prices import WOUND
from planner.resolve.splines import places_along
from planner.toolpath.task import FREE, Cones, NozzleTask

# ----------------------------------------------------------------------------------------------------
# What a nozzle task demands of the joints at the commanded speed: twists, their rates, and rungs.

SAMPLES_TURNING = 2  # per rung, at least, where the normal turns so quickly that a table could not keep up otherwise
SAMPLES_PER_RUNG = 8  # at least: samples must resolve what roll and holder do between rungs


@dataclass(frozen=True)
class SampledTasks:
    """All tasks' samples and rungs end to end, ready for compiled kernels (n samples, r rungs).

    tip, normals (n, 3), frames (n, 3, 3)   as in the tasks
    twist, rate (n, 6)             velocity of the nozzle in the part frame with roll and holder at rest, at the
                                   commanded speed, linear rows first [m/s, rad/s], and its time derivative
    now (n)                        when a sample is reached, in beads: see `NozzleTask.moments`
    weight (n)                     time that a sample stands for at that speed [s]; 0 where nothing is deposited
    rung (r)                       sample of each rung
    place (r)                      where along its task a rung is, as a fraction of the task's samples from 0 to 1
    start, stop (r)                samples that a rung stands for
    time (r)                       time from the previous rung at the commanded speed [s]
    task_rungs (b + 1)             rungs of task i are task_rungs[i] .. task_rungs[i + 1]
    cones                          of the tasks, the same for all
    lean                           share of the surface normal's lean from the vertical that the nozzle's axis has: 1 if
                                   it follows the frames, see `share_of_lean`
    """

    tip: Array
    normals: Array
    frames: Array
    twist: Array
    rate: Array
    now: Array
    weight: Array
    rung: NDArray[np.int64]
    place: Array
    start: NDArray[np.int64]
    stop: NDArray[np.int64]
    time: Array
    task_rungs: NDArray[np.int64]
    cones: Cones = FREE
    lean: float = 1.0

    def rungs_of(self, task: int) -> slice:
        """Rungs of the task at this index."""
        return slice(int(self.task_rungs[task]), int(self.task_rungs[task + 1]))

    def only(self, rungs: NDArray[np.int64], task_rungs: Sequence[int]) -> SampledTasks:
        """The same samples with some of the rungs (indices), divided into tasks by `task_rungs`."""
        return replace(
            self,
            rung=self.rung[rungs],
            place=self.place[rungs],
            start=self.start[rungs],
            stop=self.stop[rungs],
            time=self.time[rungs],
            task_rungs=np.array(task_rungs),
        )


def share_of_lean(cones: Cones) -> float:
    """Share of the surface normal's lean from the vertical that the nozzle's axis has before refinement.

    Between the vertical and the normal, it uses the cones about both in proportion, and so keeps to both where
    possible.
    """
    if cones.nozzle_gravity == np.pi or cones.tilt == 0.0:
        return 1.0
    return cones.nozzle_gravity / (cones.nozzle_gravity + cones.tilt)


def least_cone(cones: Cones) -> float:
    """How far the surface normal may lean from the vertical [rad] if all cones are to be kept."""
    return min(cones.layer_gravity, cones.nozzle_gravity + cones.tilt)


def leaned(R_world_task: Array, share: float) -> Array:
    """Orientations (n, 3, 3) in the world, turned by the least angle that reduces their z's lean from straight down to
    a share of what it was."""
    z = R_world_task[:, :, 2]
    axis = np.stack([-z[:, 1], z[:, 0], np.zeros(len(z))], axis=1)  # about which z comes down
    level = np.linalg.norm(axis, axis=1)
    lean = np.arctan2(level, -z[:, 2])
    turn = ((1.0 - share) * lean / np.maximum(level, 1e-12))[:, None] * axis
    return np.asarray(Rotation.from_rotvec(turn).as_matrix() @ R_world_task)


def leaned_on_part(cell: Cell, frames: Array, holder: Array, share: float) -> Array:
    """Orientations (n, 3, 3) in the part frame, leaned in the world as by `leaned`, for holder joints (n, nh)."""
    R_world_part = cell.holder.poses(holder)[:, :3, :3]
    return np.asarray(np.swapaxes(R_world_part, 1, 2) @ leaned(R_world_part @ frames, share))


def rolled(roll: Array) -> Array:
    """Rotations (n, 3, 3) about z by roll (n)."""
    out = np.zeros((len(roll), 3, 3))
    out[:, 0, 0] = out[:, 1, 1] = np.cos(roll)
    out[:, 1, 0] = np.sin(roll)
    out[:, 0, 1] = -out[:, 1, 0]
    out[:, 2, 2] = 1.0
    return out


def turned_from(frames: Array, R_part_nozzle: Array) -> tuple[Array, Array]:
    """Roll (n), continuous, and tilt (n, 2) of nozzle orientations (n, 3, 3) in a task's frames (n, 3, 3)."""
    R = np.swapaxes(frames, 1, 2) @ R_part_nozzle
    z = R[:, :, 2]
    level = np.hypot(z[:, 0], z[:, 1])
    size = np.arctan2(level, z[:, 2]) / np.maximum(level, 1e-12)
    tilt = np.stack([-size * z[:, 1], size * z[:, 0]], axis=1)
    back = Rotation.from_rotvec(-np.column_stack([tilt, np.zeros(len(tilt))])).as_matrix() @ R
    return np.unwrap(np.arctan2(back[:, 1, 0], back[:, 0, 0])), tilt


def sample_tasks(tasks: Sequence[NozzleTask], spacing: float, turn: float = np.inf) -> SampledTasks:
    """Differentiate the tasks' paths at the commanded speed and place rungs.

    Rungs are `spacing` [m] apart, or closer, so that the normal turns by at most `turn` [rad] between them, see
    `places_along`.
    """
    rungs, places, starts, stops, times = [], [], [], [], []
    offset = 0
    counts = [0]
    clocks = [task.s / task.speed for task in tasks]
    for task, t in zip(tasks, clocks, strict=True):
        n = len(task)
        place = places_along(task, spacing, SAMPLES_PER_RUNG, turn, SAMPLES_TURNING)
        at = np.round(place * (n - 1)).astype(np.int64)
        edges = np.concatenate([[0], (at[1:] + at[:-1]) // 2, [n]])
        rungs.append(at + offset)
        places.append(place)
        starts.append(edges[:-1] + offset)
        stops.append(edges[1:] + offset)
        times.append(np.concatenate([[0.0], np.diff(t[at])]))
        counts.append(counts[-1] + len(at))
        offset += n
    tip, frames = (np.concatenate(each) for each in ([task.tip for task in tasks], [task.frames for task in tasks]))
    ends = np.cumsum([0, *(len(task) for task in tasks)])
    laid = np.array([(task.first, task.last) for task in tasks])
    twist, rate, weight = _motion_along(tip, frames, np.concatenate(clocks), ends, laid)
    return SampledTasks(
        tip=tip,
        normals=np.concatenate([task.normals for task in tasks]),
        frames=frames,
        twist=twist,
        rate=rate,
        now=np.concatenate([task.moments for task in tasks]),
        weight=weight,
        rung=np.concatenate(rungs),
        place=np.concatenate(places),
        start=np.concatenate(starts),
        stop=np.concatenate(stops),
        time=np.concatenate(times),
        task_rungs=np.array(counts),
        cones=tasks[0].cones,
        lean=share_of_lean(tasks[0].cones),
    )


@njit
def _motion_along(tip: Array, frames: Array, t: Array, ends: Ints, laid: Ints) -> tuple[Array, Array, Array]:
    """Twists (n, 6) of frames (n, 3, 3) at tips (n, 3) at times t (n), their rates (n, 6) and the time (n) that each
    sample stands for, 0 where nothing is laid.

    ends (m + 1): where each task's samples begin, and the last task's end; laid (m, 2): first and last sample of its
    deposit
    """
    n = len(t)
    twist, rate, weight = np.empty((n, 6)), np.empty((n, 6)), np.zeros(n)
    slope = np.empty((3, 3))
    for task in range(len(ends) - 1):
        first, last = ends[task], ends[task + 1] - 1
        for i in range(first, last + 1):
            a, b, c, before, after = _differences(t, first, last, i)
            for k in range(3):
                twist[i, k] = a * tip[before, k] + b * tip[i, k] + c * tip[after, k]
                twist[i, 3 + k] = 0.0
                for j in range(3):
                    slope[j, k] = a * frames[before, j, k] + b * frames[i, j, k] + c * frames[after, j, k]
            for k in range(3):  # omega = 1/2 sum of e_k x e_k' over the frame's axes
                for d in range(3):
                    e, f = (d + 1) % 3, (d + 2) % 3
                    twist[i, 3 + d] += 0.5 * (frames[i, e, k] * slope[f, k] - frames[i, f, k] * slope[e, k])
            if first + laid[task, 0] <= i <= first + laid[task, 1]:
                weight[i] = (t[after] - t[before]) / (2.0 if before < i < after else 1.0)
        for i in range(first, last + 1):
            a, b, c, before, after = _differences(t, first, last, i)
            for k in range(6):
                rate[i, k] = a * twist[before, k] + b * twist[i, k] + c * twist[after, k]
    return twist, rate, weight


@njit(inline="always")
def _differences(t: Array, first: int, last: int, i: int) -> tuple[float, float, float, int, int]:
    """Weights of the values before, at and after i in the slope there, and the two neighbours' indices.

    Exact for parabolas; one-sided at first and last.
    """
    if i in (first, last):
        before, after = (first, first + 1) if i == first else (last - 1, last)
        step = t[after] - t[before]
        return (0.0, -1.0 / step, 1.0 / step, i, after) if i == first else (-1.0 / step, 1.0 / step, 0.0, before, i)
    h, k = t[i] - t[i - 1], t[i + 1] - t[i]
    return -k / (h * (h + k)), (k - h) / (h * k), h / (k * (h + k)), i - 1, i + 1


# ----------------------------------------------------------------------------------------------------
# JointPath: the joints along one task, from a choice of roll, holder angle and branch.

TURNS = 5  # numbers of whole turns of a joint that are tried along a bead
COMBINATIONS = 128  # combinations of joints' whole turns that are tried along a bead
MARGIN = 1e-6  # rad kept from a joint's limit, so that rounding cannot cross it


@dataclass(frozen=True)
class JointPath:
    """Joints along one task, without jumps by whole turns.

    Attributes:
        task: What the nozzle follows (n samples).
        roll: Roll (n,) about the nozzle axis [rad].
        tilt: Rotation vector (n, 2) of the axis in the task's frames [rad].
        q: Joints (n, nj) at the task's samples, arm then holder [rad; m for sliding joints].
        branch: Branch of the inverse kinematics, one all along.
    """

    task: NozzleTask
    roll: Array
    tilt: Array
    q: Array
    branch: int


def at_rest(cell: Cell) -> Array:
    """Where the chosen joints (k) rest: at home, or as close to it as their ranges allow a path."""
    return np.clip(cell.home[list(cell.chosen)], *_inner_ranges(cell))


def _inner_ranges(cell: Cell) -> tuple[Array, Array]:
    """Lowest and highest positions (k) of the chosen joints in a path.

    Joints of the arm keep `Limits.room` from the ends of their ranges, as in all its postures, and MARGIN; the others
    keep MARGIN twice, for rounding. Ranges too narrow for that are reduced to their middle.
    """
    chosen = list(cell.chosen)
    low, high = cell.limits.q_min[chosen], cell.limits.q_max[chosen]
    room = MARGIN + np.where(np.array(chosen, dtype=int) < len(cell.arm), cell.limits.room, MARGIN)
    room = np.minimum(room, 0.5 * (high - low))
    return low + room, high - room


def gone_along(cell: Cell, tip: Array) -> Array:
    """Positions (m, k) of the arm's given joints if those that slide go along with the nozzle and the others rest.

    tip (m, 3) of the nozzle in the world [m]. Sliding joints start from their home positions and stay in their ranges.
    """
    home, nh = cell.home[None, : len(cell.arm)], len(cell.holder)
    away = tip - cell.arm.poses(home)[0, :3, 3]
    along = cell.arm.jacobians(home)[0, :3]  # for sliding joints, the columns are their directions
    low, high = (ends[nh:] for ends in _inner_ranges(cell))
    out = np.tile(at_rest(cell)[nh:], (len(tip), 1))
    for k, j in enumerate(cell.given):
        if cell.arm.slides[j]:
            out[:, k] = np.clip(out[:, k] + away @ along[:, j], low[k], high[k])
    return out


def spread(values: Array, n: int, places: Array) -> Array:
    """n samples of a smooth curve controlled by rung values (m) or (m, k): a clamped B-spline of degree 5.

    places (m): where the rungs are, as fractions of the samples from 0 to 1. The curve has four continuous derivatives,
    does not overshoot its control values, and starts and ends at the first and last of them; with fewer than six rungs
    the degree is one less than their number.
    """
    m = len(values)
    degree = min(5, m - 1)
    if degree == 0:
        return np.repeat(values, n, axis=0)
    # inner knots at the rungs themselves, so that each value takes effect where its rung is, near the ends too
    knots = np.concatenate([np.zeros(degree + 1), places[3 : m - 3], np.ones(degree + 1)])
    return np.asarray(BSpline(knots, values, degree)(np.linspace(0.0, 1.0, n)))


def upright(task: NozzleTask) -> Array:
    """No tilt (n, 2): the nozzle's axis is normal to the surface."""
    return np.zeros((len(task), 2))


def postures(cell: Cell, task: NozzleTask, roll: Array, chosen: Array, branch: int, tilt: Array | None = None) -> Array:
    """Joints (n, nj) that hold the task exactly, for roll (n) and the cell's chosen joints (n, k) on one branch.

    tilt (n, 2) of the nozzle, none if not given.

    Joints are continuous along the path; whole turns are chosen later, by `choose_turns`.
    Raises Refusal, with the place, where a pose is out of reach or outside a joint's range.
    """
    na, nh = len(cell.arm), len(cell.holder)
    holder, redundant = chosen[:, :nh], chosen[:, nh:] if cell.given else None
    T_base_flange = flange_poses(cell, task, roll, upright(task) if tilt is None else tilt, holder)
    q_all, ok_all = cell.inverse.solve(T_base_flange, redundant)
    q, ok = q_all[:, branch], ok_all[:, branch]
    if not ok.all():
        i = int(np.argmin(ok))
        given = None if redundant is None else redundant[i : i + 1]
        missing = float(cell.inverse.out_of_reach(T_base_flange[i : i + 1], given)[0])
        refuse_at(task, i, "out of the arm's reach", missing)
    middle = 0.5 * (cell.limits.q_min[:na] + cell.limits.q_max[:na])
    q = np.where(cell.limits.turns[:na], np.unwrap(turned_to_middle(cell.limits, q), axis=0), q)
    span = cell.limits.q_max[:na] - cell.limits.q_min[:na]
    for j in np.flatnonzero(np.ptp(q, axis=0) > span):
        i = int(np.argmax(np.abs(q[:, j] - middle[j])))
        refuse_at(task, i, f"{cell.arm.names[j]} would turn further than its range along this bead")
    return np.hstack([q, holder])


def turned_to_middle(limits: Limits, q: Array) -> Array:
    """The arm's joints (..., na), with whole turns added that bring them closest to the middles of their ranges."""
    na = q.shape[-1]
    middle = 0.5 * (limits.q_min[:na] + limits.q_max[:na])
    return np.where(limits.turns[:na], middle + np.remainder(q - middle + np.pi, TURN) - np.pi, q)


def flange_poses(cell: Cell, task: NozzleTask, roll: Array, tilt: Array, holder: Array) -> Array:
    """Flange poses in the arm's base frame (n, 4, 4) that the task requires: frames Exp(tilt) Rz(roll)."""
    c, s = np.cos(roll), np.sin(roll)
    T_part_nozzle = np.zeros((len(task), 4, 4))
    turned = task.frames
    if tilt.any():
        turned = turned @ Rotation.from_rotvec(np.column_stack([tilt, np.zeros(len(tilt))])).as_matrix()
    x, y = turned[:, :, 0], turned[:, :, 1]
    T_part_nozzle[:, :3, 0] = c[:, None] * x + s[:, None] * y
    T_part_nozzle[:, :3, 1] = -s[:, None] * x + c[:, None] * y
    T_part_nozzle[:, :3, 2] = turned[:, :, 2]
    T_part_nozzle[:, :3, 3] = task.tip
    T_part_nozzle[:, 3, 3] = 1.0
    T_world_part = cell.holder.poses(holder)
    before, after = rigid_inverse(cell.T_world_base), rigid_inverse(cell.T_flange_nozzle)
    return before @ T_world_part @ T_part_nozzle @ after


def choose_turns(cell: Cell, paths: Sequence[JointPath]) -> tuple[JointPath, ...]:
    """Add whole turns to joints, bead by bead, so that all stay within limits and travel takes the least time.

    Turns change only in travel, never within a bead: that is where a joint unwinds as it approaches a limit. They are
    chosen by dynamic programming over the beads, for all joints together, since a travel takes as long as its slowest
    joint. Candidates are those near home, and those with which a table that keeps turning need not come back. Raises
    Refusal for a bead along which a joint leaves its range whatever whole turns are added.
    """

    def options_of(own: tuple[JointPath, Array]) -> Array:
        return turns_within(cell, *own)

    options = of_each(options_of, list(zip(paths, _onward(cell, paths), strict=True)))
    limits, na = cell.limits, len(cell.arm)
    home, rate = cell.home, WOUND / limits.velocity
    # the holder waits where the first bead begins, and stays where the last one ends
    arm = slice(0, na)
    cost = _slowest(paths[0].q[0, arm] + options[0][:, arm] - home[arm], limits, arm)
    cost = cost + np.abs(paths[0].q[0] + options[0] - home) @ rate
    back = []
    for a, b, oa, ob in zip(paths[:-1], paths[1:], options[:-1], options[1:], strict=True):
        begin = b.q[0] + ob
        step = _slowest(begin[None] - (a.q[-1] + oa)[:, None], limits, slice(None))
        total = cost[:, None] + step + np.abs(begin - home) @ rate
        back.append(np.argmin(total, axis=0))
        cost = total.min(axis=0)
    pick = int(np.argmin(cost + _slowest(home[arm] - paths[-1].q[-1, arm] - options[-1][:, arm], limits, arm)))
    turned = []
    for i in range(len(paths) - 1, -1, -1):
        turned.append(replace(paths[i], q=paths[i].q + options[i][pick]))
        if i:
            pick = int(back[i - 1][pick])
    return tuple(turned[::-1])


def turns_within(cell: Cell, path: JointPath, onward: Array | None = None) -> Array:
    """Whole turns (k, nj) [rad] that keep a path in the joints' ranges, nearest to home; raises Refusal if none do.

    onward (nj): numbers of whole turns of the joints to include as well, see `_onward`
    """
    low, high = cell.limits.q_min + MARGIN, cell.limits.q_max - MARGIN
    least, most = path.q.min(axis=0), path.q.max(axis=0)
    each = []
    far = np.zeros(len(low), dtype=np.bool_)  # joints whose onward turns are not among those nearest to home
    for j in range(len(low)):
        k = np.arange(np.ceil((low[j] - least[j]) / TURN), np.floor((high[j] - most[j]) / TURN) + 1)
        k = k if cell.limits.turns[j] else k[k == 0]
        if len(k) == 0:
            worst = int(np.argmax(np.maximum(low[j] - path.q[:, j], path.q[:, j] - high[j])))
            refuse_at(path.task, worst, f"{cell.joint_names[j]} leaves its range here")
        nearest = np.argsort(np.abs(0.5 * (least[j] + most[j]) + k * TURN - cell.home[j]), kind="stable")
        taken = k[nearest[:TURNS]]
        if onward is not None and onward[j] not in taken:
            far[j], taken = True, np.append(taken, onward[j])
        each.append(taken * TURN)
    together = np.stack(np.meshgrid(*each, indexing="ij"), axis=-1).reshape(-1, len(low))
    off = np.abs(0.5 * (least + most) + together - cell.home)
    if onward is not None:
        off = np.where(far, np.minimum(off, np.abs(together - onward * TURN)), off)
    away = off @ (1.0 / cell.limits.velocity)
    return np.asarray(together[np.sort(np.argsort(away, kind="stable")[:COMBINATIONS])])


def _onward(cell: Cell, paths: Sequence[JointPath]) -> list[Array]:
    """Numbers of whole turns (nj) that bring each path's start closest to the previous path's end, or to home for the
    first one, within the joints' ranges."""
    low, high = cell.limits.q_min + MARGIN, cell.limits.q_max - MARGIN
    at, out = cell.home, []
    for path in paths:
        fewest = np.ceil((low - path.q.min(axis=0)) / TURN)
        most = np.floor((high - path.q.max(axis=0)) / TURN)
        turns = np.where(cell.limits.turns, np.clip(np.round((at - path.q[0]) / TURN), fewest, most), 0.0)
        out.append(turns)
        at = path.q[-1] + turns * TURN
    return out


def _slowest(way: Array, limits: Limits, joints: slice) -> Array:
    """Time [s] that joints need from rest to rest over ways (..., n), the slowest of them."""
    v, a, jerk = limits.velocity[joints], limits.acceleration[joints], limits.jerk[joints]
    way = np.abs(way)
    rise = np.minimum(a / jerk, np.sqrt(v / jerk))  # time for acceleration to build up; it is held, then falls again
    held = v / (jerk * rise) - rise
    full = way / v + 2.0 * rise + held
    less = np.maximum(np.minimum(a / jerk, np.cbrt(0.5 * way / jerk)), 1e-12)  # where full speed is not reached
    short = 4.0 * less + 2.0 * np.maximum(np.sqrt(0.25 * less**2 + way / (jerk * less)) - 1.5 * less, 0.0)
    return np.asarray(np.where(way >= v * (2.0 * rise + held), full, short).max(axis=-1))


def refuse_at(
    task: NozzleTask,
    i: int,
    reason: str,
    missing: float | None = None,
    hints: Callable[[], Hints] | None = None,
    kind: type[Refusal] = Refusal,
    near_ends: bool = False,
    posture: Array | None = None,
) -> NoReturn:
    """Raise a Refusal of this kind that names the task's bead, sample and point; places in a run are the bead's end."""
    mm = task.tip[i] * 1e3
    if missing is not None:
        reason += f" by {missing * 1e3:.1f} mm"
    run = "run-in" if i < task.first else "run-out" if i > task.last else None
    there = f", in the {run}" if run else ""
    nearest = min(max(i, task.first), task.last)
    raise kind(
        f"{reason} (layer {task.layer + 1}, path {task.name!r}{there}, "
        f"point {mm[0]:.1f} {mm[1]:.1f} {mm[2]:.1f} mm on the part)",
        bead=task.bead,
        waypoint=nearest - task.first,
        s_mm=float(task.s[nearest] * 1e3),
        point_mm=(float(mm[0]), float(mm[1]), float(mm[2])),
        run=run,
        missing_mm=None if missing is None else missing * 1e3,
        hints=hints or (),
        near_ends=near_ends,
        posture=None if posture is None else tuple(np.asarray(posture, dtype=float).tolist()),
    )


# ----------------------------------------------------------------------------------------------------
# A joint path by arc length: its derivatives, which at a constant speed are the joints' rates.
#
# At speed v along the path a joint moves at q' v, accelerates at q'' v^2 and jerks at q''' v^3, with derivatives by arc
# length: a limit of the joint is a limit on a derivative of the path.

ORDERS = np.array([1, 2, 3])
_STILL = 1e-6  # share of the mean distance between samples, below which a path has no direction


@dataclass(frozen=True)
class ByArcLength:
    """Derivatives (k, nj, 3) of a joint path by arc length at places s (k) [m]: q', q'', q''' in rad and m."""

    s: Array
    rates: Array


def spline_of(path: JointPath) -> BSpline:
    """Joints and arc length (nj + 1) as functions of the sample's index, with four continuous derivatives."""
    n = len(path.task)
    return make_interp_spline(np.arange(n, dtype=float), np.column_stack([path.q, path.task.s]), k=min(5, n - 1))


def by_arc_length(path: JointPath, spline: BSpline, low: float, high: float, per_sample: int) -> ByArcLength:
    """Derivatives between two arc lengths of the task [m], at `per_sample` places per sample of it.

    Places where samples coincide have no direction and are left out.
    """
    s = path.task.s
    k = np.interp([low, high], s, np.arange(len(s), dtype=float))
    u = np.linspace(k[0], k[1], max(int(np.ceil(per_sample * (k[1] - k[0]))), 1) + 1)
    first, second, third = (np.asarray(spline(u, order)) for order in ORDERS)
    moving = first[:, -1] > _STILL * (s[-1] - s[0]) / len(s)
    u, first, second, third = u[moving], first[moving], second[moving], third[moving]
    s1, s2, s3 = (each[:, -1:] for each in (first, second, third))
    by_s = first[:, :-1] / s1
    by_ss = (second[:, :-1] - by_s * s2) / s1**2
    by_sss = (third[:, :-1] - 3.0 * by_ss * s1 * s2 - by_s * s3) / s1**3
    return ByArcLength(np.asarray(spline(u))[:, -1], np.stack([by_s, by_ss, by_sss], axis=-1))
