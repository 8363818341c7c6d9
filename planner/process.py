"""What happens around a bead: run-in and run-out, where the nozzle moves and nothing is deposited; where fibre is cut;
how long the extruder needs between beads."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from planner.errors import Complaint, InputError
from planner.problem.process import FibreSpec, ProcessSpec
from planner.readonly import Array
from planner.run_ends import End, end_of
from planner.toolpath.bead import Bead

RISE_PER_LENGTH = 0.5  # height of the far end of a run over its length: clears a bead within the run's last half
_STRAIGHTEN = 0.4  # greatest share of a run in which the bead's curvature fades to a straight line
_SETTLE = 1.0  # likewise in which the nozzle stops turning: quicker asks more jerk of the wrist than the bead does
_BENT = 0.5  # share of a run in which it bends up to its ramp, which is straight from there on
_TURN = 1.0  # rad; twice what a run turns at most before it is straight, where the samples allow it
_GROWTH = 0.7  # twice the logarithm of how far the samples' distance changes along a run
_FADE = 3.0  # samples in which anything fades at least: quicker would be a step to whoever reads the samples
_FEWEST = 8.0  # samples of a run at least: fewer cannot show its shape, so a coarse bead has longer runs
_MOST = 500.0  # samples of a run, about: a bead that begins with closer ones has runs that thin them out
_THINNING = 10.0  # samples in which their distance grows e-fold
_UPRIGHT = 1e-6  # sine of the angle between a bead and its normal: below, it stands upright on its surface
_STEEP = 0.5  # cosine of a bead's elevation above its surface: a steeper one is not a bead on it
_STEEPEST = 1.0  # rad; elevation with which a run goes on
_SUBSTEPS = 8  # of the integration of a run, per sample


@dataclass(frozen=True)
class Run:
    """A bead with its run-in and run-out: what the nozzle follows from rest to rest.

    points, normals, roll_zero (n, 3) part frame [m, unit]; s (n,) arc length [m], 0 where the bead starts,
    negative in the run-in; deposit lasts from sample `first` to sample `last`, both included.
    """

    points: Array
    normals: Array
    roll_zero: Array
    s: Array
    first: int
    last: int


def with_runs(bead: Bead, length: float, ramp: float | None = None) -> Run:
    """Extend a bead by a run-in and a run-out of `length` [m] each, or of eight of its samples if these are longer.

    A run leaves along the bead's tangent with its curvature (continuous to the second derivative) and becomes
    straight. Without a `ramp` it rises from the surface with the cube of the distance, which is then counted along
    the surface; else its far half is straight and stands at the angle `ramp` [rad] to the bead's surface at that end.
    """
    before, s_before = _leave(end_of(bead, at_end=False), length, ramp)
    after, s_after = _leave(end_of(bead, at_end=True), length, ramp)
    points, normals, roll_zero = (
        np.vstack([a[::-1], here, b])
        for a, here, b in zip(before, (bead.points, bead.normals, bead.roll_zero), after, strict=True)
    )
    s = np.concatenate([-s_before[::-1], bead.s, bead.length + s_after])
    normals = normals / np.linalg.norm(normals, axis=1)[:, None]
    roll_zero = roll_zero - (roll_zero * normals).sum(axis=1)[:, None] * normals
    roll_zero = roll_zero / np.linalg.norm(roll_zero, axis=1)[:, None]
    first = len(s_before)
    return Run(points, normals, roll_zero, s, first, first + len(bead.points) - 1)


def _leave(end: End, length: float, ramp: float | None) -> tuple[tuple[Array, Array, Array], Array]:
    """Samples (m, 3) of points, normals and roll directions beyond one end, walking away from the bead, and the
    arc length (m) from that end."""
    length = max(length, _FEWEST * end.step)
    far = _distances(end, length)

    along = _directions(end, far, length, ramp)
    points = end.point + _integral(along, far)
    if ramp is None:
        points = points + (RISE_PER_LENGTH * length * (far / length) ** 3)[:, None] * end.frame[:, 2]
    arc = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])

    keep = slice(_SUBSTEPS, None, _SUBSTEPS)
    frames = end.turned(far[keep], _within(end, length, _SETTLE, *end.turning))
    return (points[keep], frames[:, :, 2], frames[:, :, 0]), arc[keep]


def _distances(end: End, length: float) -> Array:
    """Distances (m) from a bead's end along a run until `length` is reached, _SUBSTEPS of them a sample, from 0 on.

    They begin as the bead's samples go on, and become even.
    """
    usual = length / end.step
    fade = float(np.clip(_GROWTH / max(abs(end.growth), 1e-9), _FADE, _STRAIGHTEN * usual))
    thin = np.log(max(usual / _MOST, 1.0))
    over = max(_THINNING * thin, 1.0)
    fewer = float(np.exp(-0.5 * abs(end.growth) * fade))  # samples may draw together, hence more of them
    m = int(np.ceil(min(usual, _MOST) / fewer + over)) + 1
    u = np.arange(m * _SUBSTEPS + 1) / _SUBSTEPS
    step = end.step * np.exp(end.growth * _faded(u, fade) + thin * (1.0 - _fade(u / over)))
    far = _integral(step, u)
    samples = np.searchsorted(far[::_SUBSTEPS], (1.0 - 1e-9) * length)
    return far[: samples * _SUBSTEPS + 1]


def _within(end: End, length: float, share: float, *rates: float) -> float:
    """Distance [m] in which the rates of an end's n-th derivatives (n = 1, 2; [rad/m^n]) fade: a share of the run."""
    turns = [(_TURN / rate) ** (1.0 / (n + 1)) for n, rate in enumerate(rates) if rate > 0.0]
    return float(np.clip(min(turns, default=np.inf), _FADE * end.step, share * length))


def _directions(end: End, far: Array, length: float, ramp: float | None) -> Array:
    """Directions (m, 3) of a run at distances (m), by heading in the bead's surface and elevation above it.

    Both go on as the bead does, by less and less. From _BENT of the run on, the elevation is the ramp; without one it
    is the bead's own, but never down into the surface.
    """
    normal = end.frame[:, 2]
    up = float(end.tangent @ normal)
    level = end.tangent - up * normal
    size = float(np.linalg.norm(level))
    # a bead along its own normal has no heading: any will do
    level = level / size if size > _UPRIGHT else end.frame[:, 0]
    aside = np.cross(normal, level)
    lifted = float(np.arctan2(up, size))
    heads = float(end.bend @ aside) / max(size, _STEEP)
    climbs = float(end.bend @ (np.cos(lifted) * normal - np.sin(lifted) * level))

    faded = _faded(far, _within(end, length, _STRAIGHTEN, float(np.linalg.norm(end.bend))))
    heading, elevation = heads * faded, lifted + climbs * faded
    risen = float(np.clip(elevation[-1], 0.0, _STEEPEST)) if ramp is None else ramp
    elevation = elevation + (risen - elevation[-1]) * (1.0 - _fade(far / (_BENT * length)))
    flat = np.cos(heading)[:, None] * level + np.sin(heading)[:, None] * aside
    return np.asarray(np.cos(elevation)[:, None] * flat + np.sin(elevation)[:, None] * normal)


def _fade(x: Array) -> Array:
    """From 1 at x = 0 to 0 at x = 1 and beyond, with two flat derivatives at both ends."""
    x = np.clip(x, 0.0, 1.0)
    return 1.0 - x**3 * (10.0 - 15.0 * x + 6.0 * x**2)


def _faded(x: Array, end: float) -> Array:
    """Integral from 0 to x (m) of what is 1 at 0 and fades until `end`: half of `end` there and beyond."""
    y = np.clip(x / end, 0.0, 1.0)
    return end * (y - y**4 * (2.5 - 3.0 * y + y**2))


def _integral(f: Array, u: Array) -> Array:
    """Integral of f (m, ...) over u (m) from u[0], by the trapezoidal rule."""
    mid = 0.5 * (f[1:] + f[:-1])
    steps = np.diff(u).reshape((-1,) + (1,) * (f.ndim - 1))
    return np.concatenate([np.zeros_like(f[:1]), np.cumsum(mid * steps, axis=0)])


def cut_place(bead: Bead, fibre: FibreSpec, where: Complaint | None = None) -> float:
    """Arc length [m] at which the fibre is cut, so that its end is laid down at the end of the bead.

    `where(reason, hint)` makes the InputError for a bead that is too short, in which the fibre would not hold.
    """
    if bead.length >= fibre.least_length:
        return bead.length - fibre.cut_length
    complain = InputError if where is None else where
    cut, laid, least = fibre.cut_length * 1e3, fibre.least_laid * 1e3, fibre.least_length * 1e3
    raise complain(
        f"path {bead.name!r} in layer {bead.layer + 1} is {bead.length * 1e3:.2f} mm long, too short to be cut fibre",
        hint=f"at least {least:g} mm: {laid:g} laid before the cut (least_laid_mm), {cut:g} after it (cut_length_mm)",
    )


def least_travel_time(process: ProcessSpec, leaves: str | None = "", reaches: str | None = "") -> float:
    """Least time [s] between the end of a bead and the start of the next: what retract and prime take.

    The runs count to it, a change of material does not. leaves, reaches: the materials of the two beads by name; None
    before the first bead and after the last.
    """
    return (0.0 if leaves is None else process.of(leaves).retract.time) + (
        0.0 if reaches is None else prime_time(process.of(reaches))
    )


def prime_time(process: ProcessSpec) -> float:
    """How long the extruder pushes filament before a bead [s]."""
    return process.prime_length / process.prime.speed
