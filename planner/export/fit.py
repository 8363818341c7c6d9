"""How well a controller's lines between targets fit a trajectory: all tolerances of a line, over each of its samples."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from planner.export.thinning import Indices

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

TERMS = ("chord", "orientation", "station", "time", "tangent", "flow", "length")  # what can keep a line short
LEAST_STEP = 1e-9  # [m] between samples: a shorter one, at rest, has no direction
SHORT = 1e-14  # [m^2], square of a line's length: a shorter one has no nearest point, and shares follow the samples
PARALLEL = 1e-6  # rad between quaternions: nearer ones are interpolated evenly


@dataclass(frozen=True)
class Poses:
    """Poses of the nozzle in the part, and the station's axes there.

    table (n, 7 + k): position [m], quaternion x y z w, the station's free axes [rad]
    """

    table: Array

    @property
    def position(self) -> Array:
        """(n, 3) [m]."""
        return self.table[:, :3]

    @property
    def quat(self) -> Array:
        """(n, 4) x y z w."""
        return self.table[:, 3:7]

    @property
    def station(self) -> Array:
        """(n, k) [rad]."""
        return self.table[:, 7:]


@dataclass(frozen=True)
class Way:
    """What lines have to follow (n samples).

    poses      of the samples, their quaternions sign-continuous
    clock      (n)  time without waits [s]
    path       (n)  length [m]
    fed        (n)  filament that is to flow evenly [m], all 0 for none
    laid       (n)  material flows: time, tangent and flow count
    tolerance  (7)  of each of TERMS [m, rad, rad, s, rad, m, m]
    """

    poses: Poses
    clock: Array
    path: Array
    fed: Array
    laid: Flags
    tolerance: Array


def misfits(way: Way, targets: Poses, first: Indices, last: Indices) -> Array:
    """How far lines from the targets of samples first to those of last (s) miss the samples between: (s, 7), by TERMS.

    In tolerances, the worst sample of each; 0 where there is none between. targets: what one would be at each sample.
    """
    own = (way.poses.table, way.clock, way.path, way.fed, way.laid)
    return _misfits(*own, targets.table, first, last, way.tolerance)


@njit(cache=True)
def fraction(a: Array, b: Array, p: Array, otherwise: float) -> float:
    """Where the line from the pose a to b is nearest to the pose p, from 0 to 1; `otherwise` if it has no length."""
    square, along = 0.0, 0.0
    for j in range(3):
        square += (b[j] - a[j]) ** 2
        along += (p[j] - a[j]) * (b[j] - a[j])
    if square < SHORT:
        return otherwise
    return min(max(along / square, 0.0), 1.0)


@njit(cache=True)
def between(a: Array, b: Array, u: float, out: Array) -> None:
    """What a controller makes of the fraction u of the line from the pose a to b: even, the orientation on a great arc."""
    dot = 0.0
    for j in range(len(a)):
        out[j] = a[j] + u * (b[j] - a[j])
    for j in range(3, 7):
        dot += a[j] * b[j]
    sign = -1.0 if dot < 0.0 else 1.0
    omega = np.arccos(min(abs(dot), 1.0))
    wa, wb = 1.0 - u, u
    if omega >= PARALLEL:
        sine = np.sin(omega)
        wa, wb = np.sin((1.0 - u) * omega) / sine, np.sin(u * omega) / sine
    for j in range(3, 7):
        out[j] = wa * a[j] + sign * wb * b[j]


@njit(cache=True)
def _misfits(
    pose: Array,
    clock: Array,
    path: Array,
    fed: Array,
    laid: Flags,
    target: Array,
    first: Indices,
    last: Indices,
    tolerance: Array,
) -> Array:
    """`misfits`."""
    out = np.zeros((len(first), len(TERMS)))
    made = np.empty(pose.shape[1])
    for i in range(len(first)):
        a, b = first[i], last[i]
        if b - a < 2:
            continue
        worst = out[i]
        took = clock[b] - clock[a]
        worst[6] = ((path[b] - path[a]) / tolerance[6]) ** 2
        for k in range(a + 1, b):
            u = fraction(target[a], target[b], pose[k], (k - a) / (b - a))
            between(target[a], target[b], u, made)
            square, near, far = 0.0, 0.0, 0.0
            for j in range(3):
                square += (made[j] - pose[k, j]) ** 2
            for j in range(3, 7):
                near += (made[j] - pose[k, j]) ** 2
                far += (made[j] + pose[k, j]) ** 2
            worst[0] = max(worst[0], np.sqrt(square) / tolerance[0])
            # half the chord on the sphere of quaternions: stays accurate where arccos does not
            angle = 4.0 * np.arcsin(min(0.5 * np.sqrt(min(near, far)), 1.0))
            worst[1] = max(worst[1], angle / tolerance[1])
            for j in range(7, pose.shape[1]):
                worst[2] = max(worst[2], abs(made[j] - pose[k, j]) / tolerance[2])
            if laid[k]:
                worst[3] = max(worst[3], abs(clock[a] + u * took - clock[k]) / tolerance[3])
                even = fed[a] + (clock[k] - clock[a]) / max(took, 1e-9) * (fed[b] - fed[a])
                worst[5] = max(worst[5], abs(even - fed[k]) / tolerance[5])
        for k in range(a, b):
            if laid[k] and laid[k + 1]:
                worst[4] = max(worst[4], _lean(target[a], target[b], pose[k], pose[k + 1]) / tolerance[4])
    return out


@njit(cache=True)
def _lean(a: Array, b: Array, p: Array, q: Array) -> float:
    """Angle [rad] between the line from a to b and the step from p to q; 0 where one of them has no direction."""
    lx, ly, lz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    sx, sy, sz = q[0] - p[0], q[1] - p[1], q[2] - p[2]
    if sx * sx + sy * sy + sz * sz <= LEAST_STEP**2:
        return 0.0
    x, y, z = ly * sz - lz * sy, lz * sx - lx * sz, lx * sy - ly * sx
    sine = np.sqrt(x * x + y * y + z * z)
    return np.arctan2(sine, lx * sx + ly * sy + lz * sz) if sine > 0.0 else 0.0
