"""The end of a bead: how its curve and its frame would go on from there."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import make_interp_spline
from scipy.spatial.transform import Rotation

from planner.readonly import Array
from planner.toolpath.bead import Bead

_SAMPLES = 12  # enough for the end's derivatives
_DEGREE = 5
_SMOOTH = 0.4  # rad or e-folds a sample: what turns or stretches more is too coarse for a polynomial
_AGREES = 2.0  # times what neighbouring samples turn: no smooth end turns more
_STEEPEST = 1.0  # rad a sample that a coarse bead's end goes on with
_WHOLE = 3.0  # rad: beyond pi a rotation vector points the other way
_ROUNDING = 1e-9  # rad a sample


@dataclass(frozen=True)
class End:
    """An end of a bead, seen by who walks off it; derivatives are by the arc length walked, part frame.

    point, tangent (3)  [m, unit]
    bend      (3)       curvature, perpendicular to the tangent [1/m]
    frame     (3, 3)    columns: roll zero, normal x roll zero, normal
    spin      (2, 3)    first and second derivative of the frame's rotation vector [rad/m, rad/m^2]
    step                distance of samples [m]
    growth              its logarithm's derivative by the sample number
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
        """Sizes of the frame's derivatives [rad/m, rad/m^2]."""
        first, second = np.linalg.norm(self.spin, axis=1)
        return float(first), float(second)

    def turned(self, far: Array, within: float) -> Array:
        """Frames (m, 3, 3) at distances (m), if the turning fades until `within` [m] (see process._fade)."""
        y = np.clip(far / within, 0.0, 1.0)
        first = within * (y - y**4 * (2.5 - 3.0 * y + y**2))
        second = within**2 * y**2 * (0.5 - y**3 * (2.0 - 2.5 * y + 6.0 / 7.0 * y**2))
        turn = first[:, None] * self.spin[0] + second[:, None] * self.spin[1]
        return np.asarray(Rotation.from_rotvec(turn).as_matrix() @ self.frame)


def end_of(bead: Bead, at_end: bool) -> End:
    """The end of a bead, or its start walked off backwards.

    A polynomial of degree 5 gives it where that agrees with the samples themselves; else, on a bead of few or coarse
    samples, the arc through the last three of them.
    """
    take = slice(-1, -_SAMPLES - 1, -1) if at_end else slice(0, _SAMPLES)
    points, normals, roll = bead.points[take], bead.normals[take], bead.roll_zero[take]
    frames = np.stack([roll, np.cross(normals, roll), normals], axis=-1)
    turns = Rotation.from_matrix(frames @ frames[0].T).as_rotvec()
    fine = _smooth_end(points, turns, frames[0]) if len(points) > _DEGREE else None
    return _by_arc(points, turns, frames[0]) if fine is None else fine


def _smooth_end(points: Array, turns: Array, frame: Array) -> End | None:
    """The end by a polynomial, if the samples beside it are smooth and turn and stretch as it says."""
    chords = np.diff(points[: _DEGREE + 1], axis=0)
    sizes = np.linalg.norm(chords, axis=1)
    turn = float(_angles(chords[1:], chords[:-1]).max())
    stretch = float(np.abs(np.diff(np.log(sizes))).max())
    spin = float(np.linalg.norm(np.diff(turns[: _DEGREE + 1], axis=0), axis=1).max())
    if max(turn, stretch, spin) > _SMOOTH or np.linalg.norm(turns, axis=1).max() > _WHOLE:
        return None
    fine = _by_polynomial(points, turns, frame)
    measured = (
        (float(_angles(fine.tangent, -chords[0])), turn),
        (float(np.linalg.norm(fine.bend)) * fine.step, turn),
        (abs(fine.growth), stretch),
        (fine.turning[0] * fine.step, spin),
        (fine.turning[1] * fine.step**2, spin + turn),
    )
    return fine if all(value <= _AGREES * seen + _ROUNDING for value, seen in measured) else None


def _by_polynomial(points: Array, turns: Array, frame: Array) -> End:
    """From points and rotation vectors (k, 3), k more than _DEGREE, the end first."""
    spline = make_interp_spline(np.arange(len(points), dtype=float), np.hstack([points, turns]), k=_DEGREE)
    (slope, spin), (bend, spun) = np.split(-spline(0.0, 1), 2), np.split(spline(0.0, 2), 2)
    step = float(np.linalg.norm(slope))
    tangent = slope / step
    growth = float(bend @ tangent) / step
    across = bend - (bend @ tangent) * tangent
    first = spin / step
    second = (spun - growth * spin) / step**2
    return End(points[0], tangent, across / step**2, frame, np.stack([first, second]), step, growth)


def _by_arc(points: Array, turns: Array, frame: Array) -> End:
    """From points and rotation vectors (k, 3), k at least 2, the end first: the arc through three of them."""
    chord = points[0] - points[1]
    size = float(np.linalg.norm(chord))
    tangent, bend, growth = chord / size, np.zeros(3), 0.0
    spin = np.stack([-turns[1], np.zeros(3)])
    if len(points) > 2:
        inner = points[1] - points[2]
        before = float(np.linalg.norm(inner))
        growth = float(np.clip(np.log(size / before), -_SMOOTH, _SMOOTH))
        across = (tangent @ inner) * tangent - inner
        angle = min(float(_angles(chord, inner)), _STEEPEST * np.exp(-max(growth, 0.0)))  # the next chord is longer
        sideways = float(np.linalg.norm(across))
        if sideways > _ROUNDING * before:
            # the arc turns by as much from the middle of its last chord to the end as from the middle to the sample before
            toward = across / sideways
            tangent, toward = (
                np.cos(0.5 * angle) * tangent + np.sin(0.5 * angle) * toward,
                np.cos(0.5 * angle) * toward - np.sin(0.5 * angle) * tangent,
            )
            bend = angle / size * toward
    turned = float(np.linalg.norm(spin[0]))
    spin[0] *= min(1.0, _STEEPEST / turned) / size if turned > 0.0 else 0.0
    return End(points[0], tangent, bend, frame, spin, size, growth)


def _angles(a: Array, b: Array) -> Array:
    """Angles (...) between vectors a and b (..., 3)."""
    return np.asarray(np.arctan2(np.linalg.norm(np.cross(a, b), axis=-1), (a * b).sum(axis=-1)))
