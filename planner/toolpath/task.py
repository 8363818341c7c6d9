"""What a bead fixes for the robot (NozzleTask), and what it leaves free: roll, tilt and the holder's joints.

Roll is measured from a direction in the tangent plane that is smooth along the bead and does not spin. Where the nozzle
may tilt, the frames follow smoothed normals, since noisy ones pass their noise on to every joint. The cones are still
checked against the true normals.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.ndimage import gaussian_filter1d, minimum_filter1d

from planner.base.arrays import Array, ReadOnlyArrays
from planner.base.compiled import njit
from planner.base.errors import Complaint
from planner.base.geometry import angles_between
from planner.base.processes import of_each
from planner.problem import Problem
from planner.problem.process import ConesSpec, FibreSpec
from planner.toolpath.bead import Bead, Toolpath
from planner.toolpath.runs import cut_place, with_runs

_SMOOTHING = 1.25e-3  # m: sigma of the Gaussian that smooths normals; published ones are noisy at such distances
_SMOOTHED_SAMPLES = 1.5  # samples: least sigma
_GRID = 8.0  # grid points per sigma, on which normals are smoothed
_ANY_CONE = 2.0  # rad: a cone that bounds nothing
_CONE_SHARE = 0.5  # × the nozzle's cone: what smoothing may use up; the rest is left for the cone's purpose

_CLEAR = 0.3  # least sine of the angle between normals and an axis that is projected onto the tangent plane


def roll_zeros(normals: Sequence[Array]) -> list[Array]:
    """Unit tangents (n, 3) for each bead's unit normals (n, 3).

    If one axis of the part frame keeps clear of all normals, its projection is used on all beads. Otherwise, each bead
    starts with the projection of the axis clearest of its first normal, which is carried along without turning about
    the normal (parallel transport).
    """
    sines = [np.sqrt(np.maximum(1.0 - n**2, 0.0)).min(axis=0) for n in normals]
    least = np.min(sines, axis=0)
    if least.max() >= _CLEAR:
        axis = np.eye(3)[int(np.argmax(least))]
        return [_projected(axis, n) for n in normals]
    starts = (np.eye(3)[int(np.argmin(np.abs(n[0])))] for n in normals)
    return [
        _transport(np.ascontiguousarray(n), _projected(axis, n[:1])[0]) for axis, n in zip(starts, normals, strict=True)
    ]


def _projected(axis: Array, normals: Array) -> Array:
    tangent = axis - (normals @ axis)[:, None] * normals
    return np.asarray(tangent / np.linalg.norm(tangent, axis=1)[:, None])


@njit
def _transport(normals: Array, start: Array) -> Array:
    """Carry a tangent from sample to sample by the smallest rotation that takes one normal to the next."""
    out = np.empty_like(normals)
    for k in range(3):
        out[0, k] = start[k]
    for i in range(1, len(normals)):
        a, b, r = normals[i - 1], normals[i], out[i - 1]
        cosine = a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
        share = (r[0] * b[0] + r[1] * b[1] + r[2] * b[2]) / max(1.0 + cosine, 1e-9)
        for k in range(3):
            out[i, k] = r[k] - share * (a[k] + b[k])
        # only rounding makes it leave the plane
        lean = out[i, 0] * b[0] + out[i, 1] * b[1] + out[i, 2] * b[2]
        size = 0.0
        for k in range(3):
            out[i, k] -= lean * b[k]
            size += out[i, k] ** 2
        for k in range(3):
            out[i, k] /= np.sqrt(size)
    return out


def smooth_normals(normals: Array, s: Array, cone: float) -> Array:
    """Unit normals (n, 3) at arc lengths s (n) [m], smoothed along the bead; none turns by more than half `cone` [rad].

    Smoothing is by sample, not by length: around a sharp corner, where samples are closer together, the nozzle turns as
    slowly as the tip then moves. If it kept turning evenly there, the joints would need many times the jerk of the tip.
    """
    if not np.ptp(normals, axis=0).any():
        return normals  # all the same, as on a level layer
    spacing = float(np.median(np.diff(s)))
    length, width = spacing * (len(s) - 1), max(_SMOOTHING, _SMOOTHED_SAMPLES * spacing)
    m = max(int(np.ceil(_GRID * length / width)), 1) + 1
    at_samples, even, sigma = np.arange(len(s)) * spacing, np.linspace(0.0, length, m), width / (length / (m - 1))

    def along(values: Array) -> Array:
        """Values (n, k), smoothed; the ends stay in place, since values are point-mirrored beyond them."""
        at = np.stack([np.interp(even, at_samples, column) for column in values.T], axis=1)
        at = np.concatenate([2.0 * at[:1] - at[:0:-1], at, 2.0 * at[-1:] - at[-2::-1]])
        return np.asarray(CubicSpline(even, gaussian_filter1d(at, sigma, axis=0)[m - 1 : 2 * m - 1])(at_samples))

    smooth = _unit(along(normals))
    share = np.minimum(1.0, _CONE_SHARE * cone / np.maximum(angles_between(smooth, normals), 1e-12))
    if share.min() < 1.0:
        # less smoothing near places that turn too far, gradually more away from them
        beside = 2 * int(np.ceil(2.0 * width / spacing)) + 1
        share = np.minimum(
            share, np.clip(along(minimum_filter1d(share, beside, mode="nearest")[:, None])[:, 0], 0.0, 1.0)
        )
        smooth = _unit(normals + share[:, None] * (smooth - normals))
    return smooth


def noise_of(beads: Sequence[Bead]) -> tuple[float, float]:
    """Angles [rad] within which half, and 99 %, of the beads' normals are from the smoothed ones."""
    off = [angles_between(smooth_normals(bead.normals, bead.s, _ANY_CONE), bead.normals) for bead in beads]
    half, nearly_all = np.quantile(np.concatenate(off), (0.5, 0.99))
    return float(half), float(nearly_all)


def _unit(vectors: Array) -> Array:
    return np.asarray(vectors / np.linalg.norm(vectors, axis=1)[:, None])


@dataclass(frozen=True)
class Cones:
    """Half angles [rad] that bound the nozzle's and the layer's directions; pi where there is no bound.

    tilt            between nozzle axis and surface normal; 0: the axis is exactly normal to the surface
    nozzle_gravity  between nozzle axis and gravity
    layer_gravity   between surface normal and the vertical
    """

    tilt: float = 0.0
    nozzle_gravity: float = math.pi
    layer_gravity: float = math.pi


FREE = Cones()


def cones_of(spec: ConesSpec) -> Cones:
    """The cones of a problem's process."""
    return Cones(spec.tilt, spec.nozzle_gravity, spec.layer_gravity)


@dataclass(frozen=True)
class Stop:
    """A place where the nozzle comes to rest within a bead: arc length s [m], wait [s], and what it does there."""

    s: float
    wait: float
    kind: str


@dataclass(frozen=True)
class NozzleTask(ReadOnlyArrays):
    """The nozzle's path along one bead with its runs, sampled uniformly in the path parameter (n samples).

    The tip is fixed, as is the axis up to its cones; roll about the axis (periodic), tilt within the cone and the
    holder's joints are free.

    Attributes:
        bead: Index of the bead.
        name: Name of the bead.
        layer: Index of its layer.
        tip: Nozzle tip (n, 3), part frame [m].
        frames: Orientation R_part_nozzle (n, 3, 3) at roll 0 and without tilt: z is the nozzle axis, x the zero of
            roll; smooth; where the nozzle may tilt, only close to the true normals.
        s: Arc length (n,), 0 at the bead's start [m].
        first: First of the samples between which material is deposited.
        last: Last of these samples.
        speed: Commanded speed [m/s].
        cones: Bounds on the nozzle's axis.
        stops: Where it comes to rest while material is deposited, in order of s.
        travel_speed: Greatest tip speed between beads and from and to home [m/s].
        true_normals: Unit normals (n, 3) of the surface, out of the part; None if the frames follow them exactly.
        material: Name of the material laid.
    """

    bead: int
    name: str
    layer: int
    tip: Array
    frames: Array
    s: Array
    first: int
    last: int
    speed: float
    cones: Cones = FREE
    stops: tuple[Stop, ...] = ()
    travel_speed: float = math.inf
    true_normals: Array | None = None
    material: str = ""

    def __len__(self) -> int:
        return len(self.s)

    @property
    def normals(self) -> Array:
        """True unit normals (n, 3) of the surface, part frame, against which all cones are checked."""
        return np.asarray(-self.frames[:, :, 2]) if self.true_normals is None else self.true_normals

    @property
    def moments(self) -> Array:
        """Progress (n,) of the print at the samples, in beads: this bead's number plus the share of it that is laid."""
        laid = (self.s - self.s[self.first]) / (self.s[self.last] - self.s[self.first])
        return np.asarray(self.bead + np.clip(laid, 0.0, 1.0))


def make_tasks(
    toolpath: Toolpath,
    speed: float,
    run_length: float,
    cones: Cones = FREE,
    ramp: float | None = None,
    fibre: FibreSpec | None = None,
    where: Complaint | None = None,
    travel_speed: float = math.inf,
) -> tuple[NozzleTask, ...]:
    """One task per bead, in print order.

    speed [m/s] is that of beads without their own; run_length [m] that of run-in and run-out; ramp as in `with_runs`.

    Raises InputError, made by `where`, for the shortest bead if that is too short to be laid with this fibre.
    """
    if fibre is not None:
        cut_place(min(toolpath.beads, key=lambda bead: bead.length), fibre, where)
    runs = of_each(lambda bead: with_runs(bead, run_length, ramp), toolpath.beads)
    normals, zeros = [run.normals for run in runs], [run.roll_zero for run in runs]
    if cones.tilt > 0.0:
        normals = [smooth_normals(run.normals, run.s, cones.tilt) for run in runs]
        zeros = roll_zeros(normals)
    tasks = []
    for i, (bead, run) in enumerate(zip(toolpath.beads, runs, strict=True)):
        stops = () if fibre is None else (Stop(cut_place(bead, fibre), fibre.cut_wait, "cut"),)
        x, z = zeros[i], -normals[i]
        frames = np.stack([x, np.cross(z, x), z], axis=-1)
        samples = (run.points, frames, run.s, run.first, run.last)
        judged = run.normals if cones.tilt > 0.0 else None
        own = bead.commanded(speed)
        task = NozzleTask(i, bead.name, bead.layer, *samples, own, cones, stops, travel_speed, judged, bead.material)
        tasks.append(task)
    return tuple(tasks)


def tasks_of(problem: Problem, toolpath: Toolpath) -> tuple[NozzleTask, ...]:
    """The tasks of a problem's toolpath.

    Raises InputError for a bead that is too short for the problem's fibre.
    """
    process = problem.process
    where = partial(problem.error, "process.fibre.cut_length_mm")
    cones = cones_of(process.cones)
    return make_tasks(
        toolpath, process.speed, process.run_in, cones, process.ramp, process.fibre, where, process.travel_speed
    )
