"""The ends of a bead: run-in and run-out, the cut of a fibre, the extruder's time between beads.

Along run-in and run-out the nozzle moves without depositing; they continue the bead's curve and frame.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import make_interp_spline
from scipy.spatial.transform import Rotation

from planner.base.arrays import Array
from planner.base.errors import Complaint, InputError
from planner.base.geometry import angles_between, arc_lengths
from planner.problem.process import FibreSpec, ProcessSpec
from planner.toolpath.bead import Bead

_SAMPLES = 12  # at an end: enough for its derivatives
_DEGREE = 5
_SMOOTH = 0.4  # rad or e-folds per sample: an end that turns or stretches more is too coarse for a polynomial
_AGREES = 2.0  # × the turn of neighbouring samples: no smooth end turns more
_STEEPEST_TURN = 1.0  # rad per sample: greatest turn with which a coarse bead's end continues
_WHOLE = 3.0  # rad: beyond pi a rotation vector points the other way
_ROUNDING = 1e-9  # rad per sample

RISE_PER_LENGTH = 0.5  # height of the far end of a run over its length: clears a bead within the run's last half
_STRAIGHTEN = 0.4  # greatest share of a run in which the bead's curvature fades to a straight line
_SETTLE = 1.0  # likewise, for the nozzle to stop turning: sooner would take more jerk of the wrist than the bead does
_BENT = 0.5  # share of a run in which it bends up to its ramp; from there on it is straight
_TURN = 1.0  # rad: twice the greatest turn of a run before it is straight, if the samples allow it
_GROWTH = 0.7  # twice the logarithm of the greatest change in sample spacing along a run
_FADE = 3.0  # samples: shortest fade; a quicker one would look like a step in the samples
_FEWEST = 8.0  # samples of a run at least: fewer cannot show its shape, so a coarse bead has longer runs
SHORTEST = 0.5e-3  # m: length of a short run; at 2 m/s^2 the nozzle is at 40 mm/s after 0.4 mm
_FEWEST_SHORT = 3.0  # samples of a short run: it continues the bead's end and has no shape of its own
_MOST = 500.0  # samples of a run, about: where the bead's own are closer, its runs thin them out
_THINNING = 10.0  # samples over which their spacing grows e-fold
_UPRIGHT = 1e-6  # sine of the angle between a bead and its normal: below this, it counts as running along the normal
_STEEP = 0.5  # least cosine assumed for a bead's elevation above its surface: a steeper bead does not lie on it
_STEEPEST_RUN = 1.0  # rad: greatest elevation with which a run continues
_DOWN = np.sin(0.02)  # sine of the downward slope above which a strut's run leads down: rounding tilts level ones
_SUBSTEPS = 8  # of the integration along a run, per sample


@dataclass(frozen=True)
class BeadEnd:
    """An end of a bead, as seen walking off it: derivatives are by the arc length walked, in the part frame.

    point, tangent (3)  [m, unit]
    bend      (3)       curvature, perpendicular to the tangent [1/m]
    frame     (3, 3)    columns: roll zero, normal x roll zero, normal
    spin      (2, 3)    first and second derivative of the frame's rotation vector [rad/m, rad/m^2]
    step                spacing of samples [m]
    growth              derivative of its logarithm by the sample number
    """

    point: Array
    tangent: Array
    bend: Array
    frame: Array
    spin: Array
    step: float
    growth: float

    @property
    def turning(self) -> tuple[float, float]:
        """Magnitudes of the frame's derivatives [rad/m, rad/m^2]."""
        first, second = np.linalg.norm(self.spin, axis=1)
        return float(first), float(second)

    def turned(self, far: Array, within: float) -> Array:
        """Frames (m, 3, 3) at distances (m), if the turning fades over `within` [m] (see _fade)."""
        y = np.clip(far / within, 0.0, 1.0)
        first = within * (y - y**4 * (2.5 - 3.0 * y + y**2))
        second = within**2 * y**2 * (0.5 - y**3 * (2.0 - 2.5 * y + 6.0 / 7.0 * y**2))
        turn = first[:, None] * self.spin[0] + second[:, None] * self.spin[1]
        return np.asarray(Rotation.from_rotvec(turn).as_matrix() @ self.frame)


def end_of(bead: Bead, at_end: bool) -> BeadEnd:
    """The end of a bead, or its start walked off backwards.

    It comes from a polynomial of degree 5 if that agrees with the samples themselves; otherwise, on a bead of few or
    coarse samples, from the arc through the last three of them.
    """
    take = slice(-1, -_SAMPLES - 1, -1) if at_end else slice(0, _SAMPLES)
    points, normals, roll = bead.points[take], bead.normals[take], bead.roll_zero[take]
    frames = np.stack([roll, np.cross(normals, roll), normals], axis=-1)
    turns = Rotation.from_matrix(frames @ frames[0].T).as_rotvec()
    fine = _smooth_end(points, turns, frames[0]) if len(points) > _DEGREE else None
    return _by_arc(points, turns, frames[0]) if fine is None else fine


def _smooth_end(points: Array, turns: Array, frame: Array) -> BeadEnd | None:
    """The end from a polynomial; None unless the samples near it are smooth, and turn and stretch as it does."""
    chords = np.diff(points[: _DEGREE + 1], axis=0)
    sizes = np.linalg.norm(chords, axis=1)
    turn = float(angles_between(chords[1:], chords[:-1]).max())
    stretch = float(np.abs(np.diff(np.log(sizes))).max())
    spin = float(np.linalg.norm(np.diff(turns[: _DEGREE + 1], axis=0), axis=1).max())
    if max(turn, stretch, spin) > _SMOOTH or np.linalg.norm(turns, axis=1).max() > _WHOLE:
        return None
    fine = _by_polynomial(points, turns, frame)
    measured = (
        (float(angles_between(fine.tangent, -chords[0])), turn),
        (float(np.linalg.norm(fine.bend)) * fine.step, turn),
        (abs(fine.growth), stretch),
        (fine.turning[0] * fine.step, spin),
        (fine.turning[1] * fine.step**2, spin + turn),
    )
    return fine if all(value <= _AGREES * seen + _ROUNDING for value, seen in measured) else None


def _by_polynomial(points: Array, turns: Array, frame: Array) -> BeadEnd:
    """The end from a polynomial through points and rotation vectors (k, 3), the end first; k is more than _DEGREE."""
    spline = make_interp_spline(np.arange(len(points), dtype=float), np.hstack([points, turns]), k=_DEGREE)
    (slope, spin), (bend, spun) = np.split(-spline(0.0, 1), 2), np.split(spline(0.0, 2), 2)
    step = float(np.linalg.norm(slope))
    tangent = slope / step
    growth = float(bend @ tangent) / step
    across = bend - (bend @ tangent) * tangent
    first = spin / step
    second = (spun - growth * spin) / step**2
    return BeadEnd(points[0], tangent, across / step**2, frame, np.stack([first, second]), step, growth)


def _by_arc(points: Array, turns: Array, frame: Array) -> BeadEnd:
    """The end from the arc through three of the points and rotation vectors (k, 3), the end first; k is at least 2."""
    chord = points[0] - points[1]
    size = float(np.linalg.norm(chord))
    tangent, bend, growth = chord / size, np.zeros(3), 0.0
    spin = np.stack([-turns[1], np.zeros(3)])
    if len(points) > 2:
        inner = points[1] - points[2]
        before = float(np.linalg.norm(inner))
        growth = float(np.clip(np.log(size / before), -_SMOOTH, _SMOOTH))
        across = (tangent @ inner) * tangent - inner
        angle = min(
            float(angles_between(chord, inner)), _STEEPEST_TURN * np.exp(-max(growth, 0.0))
        )  # the next chord is longer
        sideways = float(np.linalg.norm(across))
        if sideways > _ROUNDING * before:
            # the arc turns as much from the middle of its last chord to the end as from the sample before to the middle
            toward = across / sideways
            tangent, toward = (
                np.cos(0.5 * angle) * tangent + np.sin(0.5 * angle) * toward,
                np.cos(0.5 * angle) * toward - np.sin(0.5 * angle) * tangent,
            )
            bend = angle / size * toward
    turned = float(np.linalg.norm(spin[0]))
    spin[0] *= min(1.0, _STEEPEST_TURN / turned) / size if turned > 0.0 else 0.0
    return BeadEnd(points[0], tangent, bend, frame, spin, size, growth)


@dataclass(frozen=True)
class BeadRun:
    """A bead with its run-in and run-out: the nozzle's path from rest to rest.

    points, normals, roll_zero (n, 3) part frame [m, unit]; s (n,) arc length [m], 0 where the bead starts,
    negative in the run-in; material is deposited from sample `first` to sample `last`, both included.
    """

    points: Array
    normals: Array
    roll_zero: Array
    s: Array
    first: int
    last: int


def with_runs(bead: Bead, length: float, ramp: float | None = None) -> BeadRun:
    """Extend a bead by a run-in and a run-out of `length` [m] each, or of eight of its samples if these are longer.

    Where the bead requires a short run, it is SHORTEST at most, or three samples if these are longer.

    A run leaves along the bead's tangent with its curvature (continuous to the second derivative) and becomes
    straight. Without a `ramp` it rises from the surface with the cube of the distance, which is then measured along
    the surface; otherwise its far half is straight, at the angle `ramp` [rad] to the bead's surface at that end.

    A strut has no run where that would first lead down, into whatever it stands on or into the print: there the nozzle
    starts or ends at rest.
    """
    before, s_before = _run_of(bead, False, length, ramp)
    after, s_after = _run_of(bead, True, length, ramp)
    points, normals, roll_zero = (
        np.vstack([a[::-1], here, b])
        for a, here, b in zip(before, (bead.points, bead.normals, bead.roll_zero), after, strict=True)
    )
    s = np.concatenate([-s_before[::-1], bead.s, bead.length + s_after])
    normals = normals / np.linalg.norm(normals, axis=1)[:, None]
    roll_zero = roll_zero - (roll_zero * normals).sum(axis=1)[:, None] * normals
    roll_zero = roll_zero / np.linalg.norm(roll_zero, axis=1)[:, None]
    first = len(s_before)
    return BeadRun(points, normals, roll_zero, s, first, first + len(bead.points) - 1)


def _run_length(end: BeadEnd, length: float, short: bool) -> float:
    """Actual length [m] of a run that should be of the given length, or short."""
    return max(min(length, SHORTEST), _FEWEST_SHORT * end.step) if short else max(length, _FEWEST * end.step)


def _run_of(bead: Bead, at_end: bool, length: float, ramp: float | None) -> tuple[tuple[Array, Array, Array], Array]:
    """As `_leave`, for one end of a bead; no samples if a strut's end is left downwards."""
    end = end_of(bead, at_end)
    if bead.round and float(end.tangent @ end.frame[:, 2]) < -_DOWN:
        nothing = np.zeros((0, 3))
        return (nothing, nothing, nothing), np.zeros(0)
    return _leave(end, _run_length(end, length, bead.short_runs[int(at_end)]), ramp)


def _leave(end: BeadEnd, length: float, ramp: float | None) -> tuple[tuple[Array, Array, Array], Array]:
    """Samples (m, 3) of points, normals and roll directions beyond an end, and their arc lengths (m) from it.

    They are ordered away from the bead.
    """
    far = _distances(end, length)

    along = _directions(end, far, length, ramp)
    points = end.point + _integral(along, far)
    if ramp is None:
        points = points + (RISE_PER_LENGTH * length * (far / length) ** 3)[:, None] * end.frame[:, 2]
    arc = arc_lengths(points)

    keep = slice(_SUBSTEPS, None, _SUBSTEPS)
    frames = end.turned(far[keep], _within(end, length, _SETTLE, *end.turning))
    return (points[keep], frames[:, :, 2], frames[:, :, 0]), arc[keep]


def _distances(end: BeadEnd, length: float) -> Array:
    """Distances (m) from a bead's end along a run, from 0 until `length` is reached, _SUBSTEPS per sample.

    Their spacing first continues that of the bead's samples and then becomes even.
    """
    usual = length / end.step
    fade = float(np.clip(_GROWTH / max(abs(end.growth), 1e-9), _FADE, _STRAIGHTEN * usual))
    thin = np.log(max(usual / _MOST, 1.0))
    over = max(_THINNING * thin, 1.0)
    fewer = float(np.exp(-0.5 * abs(end.growth) * fade))  # samples may get closer together, hence more of them
    m = int(np.ceil(min(usual, _MOST) / fewer + over)) + 1
    u = np.arange(m * _SUBSTEPS + 1) / _SUBSTEPS
    step = end.step * np.exp(end.growth * _faded(u, fade) + thin * (1.0 - _fade(u / over)))
    far = _integral(step, u)
    samples = np.searchsorted(far[::_SUBSTEPS], (1.0 - 1e-9) * length)
    return far[: samples * _SUBSTEPS + 1]


def _within(end: BeadEnd, length: float, share: float, *rates: float) -> float:
    """Distance [m], a share of the run at most, over which an end's n-th derivatives (n = 1, 2; [rad/m^n]) fade."""
    turns = [(_TURN / rate) ** (1.0 / (n + 1)) for n, rate in enumerate(rates) if rate > 0.0]
    return float(np.clip(min(turns, default=np.inf), _FADE * end.step, share * length))


def _directions(end: BeadEnd, far: Array, length: float, ramp: float | None) -> Array:
    """Directions (m, 3) of a run at distances (m), from the heading in the bead's surface and the elevation above it.

    Both begin as the bead ends, and their change fades. From _BENT of the run on, the elevation is the ramp; without
    one, it is the bead's own, but never down into the surface.
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
    risen = float(np.clip(elevation[-1], 0.0, _STEEPEST_RUN)) if ramp is None else ramp
    elevation = elevation + (risen - elevation[-1]) * (1.0 - _fade(far / (_BENT * length)))
    flat = np.cos(heading)[:, None] * level + np.sin(heading)[:, None] * aside
    return np.asarray(np.cos(elevation)[:, None] * flat + np.sin(elevation)[:, None] * normal)


def _fade(x: Array) -> Array:
    """Falls from 1 at x = 0 to 0 at x = 1 and beyond; the first two derivatives vanish at both ends."""
    x = np.clip(x, 0.0, 1.0)
    return 1.0 - x**3 * (10.0 - 15.0 * x + 6.0 * x**2)


def _faded(x: Array, end: float) -> Array:
    """Integral from 0 to x (m) of a function that fades from 1 at 0 to 0 at `end`: half of `end` there and beyond."""
    y = np.clip(x / end, 0.0, 1.0)
    return end * (y - y**4 * (2.5 - 3.0 * y + y**2))


def _integral(f: Array, u: Array) -> Array:
    """Integral of f (m, ...) over u (m) from u[0], by the trapezoidal rule."""
    mid = 0.5 * (f[1:] + f[:-1])
    steps = np.diff(u).reshape((-1,) + (1,) * (f.ndim - 1))
    return np.concatenate([np.zeros_like(f[:1]), np.cumsum(mid * steps, axis=0)])


def cut_place(bead: Bead, fibre: FibreSpec, where: Complaint | None = None) -> float:
    """Arc length [m] at which the fibre is cut, so that its end is laid at the end of the bead.

    Raises InputError, made by `where(reason, hint)`, for a bead that is too short for the fibre to hold.
    """
    if bead.length >= fibre.least_length:
        return bead.length - fibre.cut_length
    complain = InputError if where is None else where
    cut, laid, least = fibre.cut_length * 1e3, fibre.least_laid * 1e3, fibre.least_length * 1e3
    raise complain(
        f"path {bead.name!r} in layer {bead.layer + 1} is {bead.length * 1e3:.2f} mm long, too short for cut fibre",
        hint=f"at least {least:g} mm: {laid:g} laid before the cut (least_laid_mm), {cut:g} after it (cut_length_mm)",
    )


def least_travel_time(process: ProcessSpec, leaves: str | None = "", reaches: str | None = "") -> float:
    """Least time [s] between the end of a bead and the start of the next: that for retracting and priming.

    The runs count towards it, a change of material does not. leaves, reaches: the names of the two beads' materials;
    None before the first bead and after the last.
    """
    return (0.0 if leaves is None else process.of(leaves).retract.time) + (
        0.0 if reaches is None else prime_time(process.of(reaches))
    )


def prime_time(process: ProcessSpec) -> float:
    """How long the extruder pushes filament before a bead [s]."""
    return process.prime_length / process.prime.speed
