"""How well a controller's lines between targets fit a trajectory: all tolerances of a line, over all its samples."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

from planner.export.thinning import Indices
from planner.readonly import Array, Flags

TERMS = ("chord", "orientation", "station", "time", "tangent", "flow", "length")  # what can keep a line short
LEAST_STEP = 1e-9  # [m] between samples: a shorter one, at rest, has no direction
SHORT = 1e-14  # [m^2], square of a line's length: a shorter one has no nearest point, and shares follow the samples
EVEN = 0.01  # rad between quaternions: nearer ones are interpolated evenly, which adds 0.003 deg at most
HOPELESS = 16.0  # tolerances: by how much more a line misses changes nothing


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

    In tolerances, the worst sample of each; 0 where there is none between. Where one is HOPELESS the others may be too
    small. targets: what one would be at each sample.
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
def great_arc(a: Array, b: Array) -> tuple[float, float]:
    """Angle [rad] between the quaternions of poses a and b, 0 if it hardly matters, and the sign that b takes."""
    dot = 0.0
    for j in range(3, 7):
        dot += a[j] * b[j]
    omega = np.arccos(min(abs(dot), 1.0))
    return (omega if omega > EVEN else 0.0), (-1.0 if dot < 0.0 else 1.0)


@njit(cache=True)
def between(a: Array, b: Array, u: float, omega: float, sign: float, out: Array) -> None:
    """What a controller makes of the fraction u of a line from pose a to b: even, the orientation on `great_arc`."""
    for j in range(len(a)):
        out[j] = a[j] + u * (b[j] - a[j])
    wa, wb = 1.0 - u, u
    if omega > 0.0:
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
        out[i, 6] = ((path[b] - path[a]) / tolerance[6]) ** 2
        if out[i, 6] > HOPELESS:
            continue
        p, q, took = target[a], target[b], clock[b] - clock[a]
        omega, sign = great_arc(p, q)
        off, turned, axis, late, lean, uneven = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        for k in range(a, b):
            if laid[k] and laid[k + 1]:
                lean = max(lean, _lean(p, q, pose[k], pose[k + 1]))
            if k == a:
                continue
            u = fraction(p, q, pose[k], (k - a) / (b - a))
            between(p, q, u, omega, sign, made)
            square, near, far = 0.0, 0.0, 0.0
            for j in range(3):
                square += (made[j] - pose[k, j]) ** 2
            for j in range(3, 7):
                near += (made[j] - pose[k, j]) ** 2
                far += (made[j] + pose[k, j]) ** 2
            off, turned = max(off, square), max(turned, min(near, far))
            for j in range(7, len(made)):
                axis = max(axis, abs(made[j] - pose[k, j]))
            if laid[k]:
                late = max(late, abs(clock[a] + u * took - clock[k]))
                even = fed[a] + (clock[k] - clock[a]) / max(took, 1e-9) * (fed[b] - fed[a])
                uneven = max(uneven, abs(even - fed[k]))
            if off > HOPELESS**2 * tolerance[0] ** 2:
                break
        # half the chord on the sphere of quaternions: stays accurate where arccos does not
        angle = 4.0 * np.arcsin(min(0.5 * np.sqrt(turned), 1.0))
        out[i, :6] = np.array([np.sqrt(off), angle, axis, late, np.arctan(lean), uneven]) / tolerance[:6]
    return out


@njit(cache=True)
def _lean(a: Array, b: Array, p: Array, q: Array) -> float:
    """Tangent of the angle between the line from a to b and the step from p to q; 0 where one has no direction."""
    lx, ly, lz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    sx, sy, sz = q[0] - p[0], q[1] - p[1], q[2] - p[2]
    if sx * sx + sy * sy + sz * sz <= LEAST_STEP**2:
        return 0.0
    x, y, z = ly * sz - lz * sy, lz * sx - lx * sz, lx * sy - ly * sx
    sine, cosine = np.sqrt(x * x + y * y + z * z), lx * sx + ly * sy + lz * sz
    if sine == 0.0:
        return 0.0
    return sine / cosine if cosine > 0.0 else np.inf
