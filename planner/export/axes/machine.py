"""Inverse kinematics of machines with five or six axes, and the choice of branches over a whole print."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Protocol

import numpy as np

from planner.base.arrays import Array, Flags, Indices
from planner.base.compiled import njit
from planner.export.fit import angle, continuous, from_matrix, lerp, slerp, to_matrix

if TYPE_CHECKING:
    from planner.plan import Plan
    from planner.problem.settings import MachineSpec

# ----------------------------------------------------------------------------------------------------
# Machines: axes from the nozzle's pose in the part, and back.
#
# A five-axis machine has X, Y, Z and two rotary axes. Whether these turn head or table, the nozzle's direction n at
# zero angles becomes R(u, a) R(w, b) n in the part as it lies at zero angles: u is the axis next to the part, w the one
# next to the nozzle, and a, b are their angles, negated for axes that turn the table. Two rotations reach a direction
# in two ways (Paden and Kahan's second subproblem); if it lies along u, a is free.

FREE = np.radians(0.02)  # a direction this close to one that leaves an axis free counts as that; 0.1 deg are allowed
BEYOND = 1e-9  # by which rounding may make a square negative
DOWN = np.array([0.0, 0.0, -1.0])  # of the nozzle at zero angles, on the machine


@dataclass(frozen=True)
class Ways:
    """Angles for directions (n): both ways (n, 2, k) [rad], whether they exist (n), and where an axis is free (n)."""

    angles: Array
    reached: Flags
    free: Flags


class Machine(Protocol):
    """Interface of machines; poses are tip (n, 3) [m] and quaternion (n, 4) in the part."""

    @property
    def letters(self) -> tuple[str, ...]:
        """Letters of the rotary axes."""

    @property
    def ranges(self) -> tuple[tuple[float, float] | None, ...]:
        """Ranges of the rotary axes [rad]; None if unlimited."""

    @property
    def loose(self) -> int:
        """Index of the rotary axis that is free where one is."""

    def ways(self, quat: Array) -> Ways:
        """Both ways to orientations (n, 4)."""

    def settled(self, angles: Array, quat: Array) -> Array:
        """Angles (n, k) at orientations that leave an axis free; that axis keeps its angle."""

    def straight(self, tip: Array, angles: Array) -> Array:
        """X, Y, Z (n, 3) [m] that bring the tip to its position at angles (n, k)."""

    def tip(self, straight: Array, angles: Array) -> Array:
        """The tip (n, 3) in the part."""

    def leaning(self, angles: Array, quat: Array) -> Array:
        """Angle (n) [rad] of the nozzle at angles (n, k) from orientations (n, 4), in the sense that matters here."""


def turned(direction: Array, theta: Array) -> Array:
    """Rotation matrices (n, 3, 3) by theta (n) about a unit vector (Rodrigues)."""
    x, y, z = direction
    K = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    s, c = np.sin(theta)[:, None, None], np.cos(theta)[:, None, None]
    out: Array = np.eye(3) + s * K + (1.0 - c) * (K @ K)
    return out


@dataclass(frozen=True)
class FiveAxes:
    """X, Y, Z and two rotary axes; with `tcp` the controller itself keeps the tip in place.

    directions, centres   (2, 3) of the axes at zero angles, on the machine [m]; centres in the head are from the tip
    tables                which of them turn the table
    R, origin             the part frame on the machine at zero angles
    least, greatest       (3,) limits of the machine's X, Y, Z [m], infinite if unknown
    """

    letters: tuple[str, ...]
    ranges: tuple[tuple[float, float] | None, ...]
    directions: Array
    centres: Array
    tables: tuple[bool, bool]
    R: Array
    origin: Array
    tcp: bool
    least: Array = field(default_factory=lambda: np.full(3, -np.inf))
    greatest: Array = field(default_factory=lambda: np.full(3, np.inf))

    @property
    def loose(self) -> int:
        """The axis next to the part."""
        return 1 if self.tables[1] else 0

    @property
    def _pair(self) -> tuple[Array, Array, float, float]:
        """Directions of the axes next to the part and next to the nozzle, and the signs of their angles."""
        part, nozzle = self.loose, 1 - self.loose
        sign = [-1.0 if table else 1.0 for table in self.tables]
        return self.directions[part], self.directions[nozzle], sign[part], sign[nozzle]

    def ways(self, quat: Array) -> Ways:
        """Both ways to the nozzle's direction in the part; rotation about it does not matter."""
        u, w, part_sign, nozzle_sign = self._pair
        wanted = self._direction(quat)
        along, g, N = wanted @ u, float(u @ w), float(DOWN @ w)
        free = np.linalg.norm(np.cross(wanted, u), axis=1) < FREE
        wanted = np.where(free[:, None], np.sign(along)[:, None] * u, wanted)
        along = np.where(free, np.sign(along), along)
        p, q = (along - g * N) / (1.0 - g * g), (N - g * along) / (1.0 - g * g)
        square = (1.0 - p * p - q * q - 2.0 * g * p * q) / (1.0 - g * g)
        across = np.sqrt(np.maximum(square, 0.0))
        angles = np.empty((len(quat), 2, 2))
        for k, side in enumerate((1.0, -1.0)):
            middle = p[:, None] * u + q[:, None] * w + (side * across)[:, None] * np.cross(u, w)
            b = np.arctan2(np.cross(DOWN, middle) @ w, middle @ DOWN - N * N)
            a = np.arctan2(np.cross(middle, wanted) @ u, np.einsum("ij,ij->i", middle, wanted) - along * along)
            angles[:, k, self.loose] = part_sign * a
            angles[:, k, 1 - self.loose] = nozzle_sign * b
        return Ways(angles, square > -BEYOND, free)

    def settled(self, angles: Array, quat: Array) -> Array:
        """Angles with the free axis kept; the other axis does not depend on it."""
        out = self.ways(quat).angles[:, 0]
        out[:, self.loose] = angles[:, self.loose]
        return out

    def straight(self, tip: Array, angles: Array) -> Array:
        """Position of the tip on the machine, less its displacement by the head; with `tcp`, as at zero angles."""
        return tip @ self.R.T + self.origin if self.tcp else self.slides(tip, angles)

    def slides(self, tip: Array, angles: Array) -> Array:
        """Positions (n, 3) of the machine's own X, Y and Z, whatever the program gives."""
        return self._carried(tip @ self.R.T + self.origin, angles) - self._swung(angles)

    def tip(self, straight: Array, angles: Array) -> Array:
        """The tip in the part."""
        place = straight if self.tcp else self._put_back(straight + self._swung(angles), angles)
        out: Array = (place - self.origin) @ self.R
        return out

    def leaning(self, angles: Array, quat: Array) -> Array:
        """Angle between the nozzle's directions."""
        away = np.tile(DOWN, (len(angles), 1))
        for i in (1, 0):
            if not self.tables[i]:
                away = np.einsum("nij,nj->ni", turned(self.directions[i], angles[:, i]), away)
        for i in (0, 1):
            if self.tables[i]:
                away = np.einsum("nji,nj->ni", turned(self.directions[i], angles[:, i]), away)
        half = 0.5 * np.linalg.norm(away - self._direction(quat), axis=1)
        out: Array = 2.0 * np.arcsin(np.minimum(half, 1.0))
        return out

    def _direction(self, quat: Array) -> Array:
        """The nozzle's direction (n, 3) on the machine, the part lying as at zero angles."""
        out: Array = to_matrix(quat)[:, :, 2] @ self.R.T
        return out

    def _carried(self, place: Array, angles: Array) -> Array:
        for i in (1, 0):
            if self.tables[i]:
                R = turned(self.directions[i], angles[:, i])
                place = self.centres[i] + np.einsum("nij,nj->ni", R, place - self.centres[i])
        return place

    def _put_back(self, place: Array, angles: Array) -> Array:
        for i in (0, 1):
            if self.tables[i]:
                R = turned(self.directions[i], angles[:, i])
                place = self.centres[i] + np.einsum("nji,nj->ni", R, place - self.centres[i])
        return place

    def _swung(self, angles: Array) -> Array:
        """Displacement (n, 3) of the tip by the head's angles."""
        out = np.zeros((len(angles), 3))
        for i in (1, 0):
            if not self.tables[i]:
                R = turned(self.directions[i], angles[:, i])
                out = self.centres[i] + np.einsum("nij,nj->ni", R, out - self.centres[i])
        return out


@dataclass(frozen=True)
class PoseMachine:
    """Six axes whose controller takes poses: R = Rz(C) Ry(B) Rx(A), as in LinuxCNC's genserkins."""

    letters: tuple[str, ...] = ("A", "B", "C")
    ranges: tuple[tuple[float, float] | None, ...] = (None, None, None)
    loose: int = 0

    def ways(self, quat: Array) -> Ways:
        """Roll, pitch and yaw, and the equivalent angles with pitch beyond a right angle."""
        R = to_matrix(quat)
        level = np.hypot(R[:, 0, 0], R[:, 1, 0])
        roll, yaw = np.arctan2(R[:, 2, 1], R[:, 2, 2]), np.arctan2(R[:, 1, 0], R[:, 0, 0])
        pitch = np.arctan2(-R[:, 2, 0], level)
        angles = np.stack(
            [np.column_stack([roll, pitch, yaw]), np.column_stack([roll + np.pi, np.pi - pitch, yaw + np.pi])], axis=1
        )
        return Ways(angles, np.ones(len(quat), dtype=bool), level < FREE)

    def settled(self, angles: Array, quat: Array) -> Array:
        """Angles with roll kept: straight up or down, only the sum or the difference of roll and yaw is determined."""
        R = to_matrix(quat)
        up = R[:, 2, 0] < 0.0  # pitch of 90 degrees
        together = np.arctan2(np.where(up, R[:, 0, 1], -R[:, 0, 1]), R[:, 1, 1])
        roll = angles[:, 0]
        return np.column_stack([roll, np.where(up, 0.5, -0.5) * np.pi, np.where(up, roll - together, together - roll)])

    def straight(self, tip: Array, angles: Array) -> Array:
        """The tip itself."""
        return tip

    def tip(self, straight: Array, angles: Array) -> Array:
        """The tip itself."""
        return straight

    def leaning(self, angles: Array, quat: Array) -> Array:
        """Angle between orientations."""
        x, y, z = np.eye(3)
        R = turned(z, angles[:, 2]) @ turned(y, angles[:, 1]) @ turned(x, angles[:, 0])
        return angle(from_matrix(R), quat)


def machine_of(spec: MachineSpec) -> Machine:
    """The machine that a problem describes."""
    if spec.type == "robot":
        return PoseMachine()
    roll, pitch, yaw = (np.array([each]) for each in spec.part_rpy)
    x, y, z = np.eye(3)
    head, table = spec.type.split("_")
    return FiveAxes(
        letters=tuple(axis.letter for axis in spec.rotary),
        ranges=tuple(axis.range for axis in spec.rotary),
        directions=np.array([axis.direction for axis in spec.rotary]),
        centres=np.array([axis.centre for axis in spec.rotary]),
        tables=(head == "table", table == "table"),
        R=(turned(z, yaw) @ turned(y, pitch) @ turned(x, roll))[0],
        origin=np.array(spec.part),
        tcp=spec.tcp,
        least=np.array((-np.inf,) * 3 if spec.least is None else spec.least),
        greatest=np.array((np.inf,) * 3 if spec.greatest is None else spec.greatest),
    )


# ----------------------------------------------------------------------------------------------------
# The branch and the whole turns of each orientation, chosen over the whole print at once.

TURN = 2.0 * np.pi
JUMP = np.radians(10.0)  # between two samples; more is a change of branch, not a motion
DEAR = 1000.0  # × its angle is the cost of a jump while material is laid
FROM_ZERO = 1e-3  # cost of each radian from zero at the start, in radians of motion


def candidates(angles: Array, ranges: Sequence[tuple[float, float] | None]) -> Array:
    """Angles (n, c, k) within the ranges that are equivalent to both ways (n, 2, k); NaN where there are none."""
    found = []
    turns = [range(1 if each is None else int((each[1] - each[0]) / TURN) + 1) for each in ranges]
    for way, *turn in itertools.product((0, 1), *turns):
        own = angles[:, way].copy()
        for j, within in enumerate(ranges):
            if within is not None:
                own[:, j] += TURN * (np.ceil((within[0] - own[:, j]) / TURN) + turn[j])
                own[own[:, j] > within[1], j] = np.nan
        own[np.isnan(own).any(axis=1)] = np.nan
        found.append(own)
    return np.stack(found, axis=1)


def missing(ways: Ways, machine: Machine) -> Indices:
    """Samples that no angles within the machine's ranges reach."""
    reachable = ~np.isnan(candidates(ways.angles, machine.ranges)[:, :, 0]).all(axis=1)
    # a free axis need not take the angle that the formula gives, but the others must
    bound = tuple(None if j == machine.loose else each for j, each in enumerate(machine.ranges))
    loosely = ~np.isnan(candidates(ways.angles, bound)[:, :, 0]).all(axis=1)
    return np.flatnonzero(~(ways.reached & np.where(ways.free, loosely, reachable)))


def chosen(ways: Ways, machine: Machine, t: Array, laid: Flags, quat: Array) -> Array:
    """Angles (n, k) of the machine's axes that turn least over samples at times t (n), none of which may be missing.

    Whole turns are kept: no angle jumps from one end of a turn to the other. While material is laid, axes change branch
    only if nothing else is possible. A free axis moves evenly from the angle required before to the one required after.
    """
    bound = np.flatnonzero(~ways.free)
    angles = np.zeros((len(t), len(machine.letters)))
    if len(bound):
        table = candidates(ways.angles[bound], machine.ranges)
        endless = np.array([each is None for each in machine.ranges])
        pick = _cheapest(np.ascontiguousarray(table), endless, laid[bound])
        own = table[np.arange(len(bound)), pick]
        own[:, endless] = np.unwrap(own[:, endless], axis=0)
        for j in range(angles.shape[1]):
            angles[:, j] = np.interp(t, t[bound], own[:, j])
    else:
        for j, within in enumerate(machine.ranges):
            angles[:, j] = 0.0 if within is None else np.clip(0.0, *within)
    free = np.flatnonzero(ways.free)
    if len(free):
        settled = machine.settled(angles[free], quat[free])
        settled += TURN * np.round((angles[free] - settled) / TURN)
        angles[free] = settled
    return angles


@njit
def _cheapest(table: Array, endless: Flags, laid: Flags) -> Indices:
    """Index of the candidate (n) for each sample on the route that turns least."""
    n, count, axes = table.shape
    before = np.full((n, count), -1, dtype=np.int16)
    cost = np.full(count, np.inf)
    for s in range(count):
        if not np.isnan(table[0, s, 0]):
            cost[s] = 0.0
            for j in range(axes):
                cost[s] += FROM_ZERO * abs(table[0, s, j])
    for i in range(1, n):
        best = np.full(count, np.inf)
        for s in range(count):
            if np.isnan(table[i, s, 0]):
                continue
            for r in range(count):
                if not cost[r] < best[s]:
                    continue
                step, largest = 0.0, 0.0
                for j in range(axes):
                    d = table[i, s, j] - table[i - 1, r, j]
                    if endless[j]:
                        d -= TURN * np.rint(d / TURN)
                    step += abs(d)
                    largest = max(largest, abs(d))
                if largest > JUMP and laid[i] and laid[i - 1]:
                    step *= DEAR
                if cost[r] + step < best[s]:
                    best[s] = cost[r] + step
                    before[i, s] = r
        cost = best
    out = np.empty(n, dtype=np.intp)
    out[n - 1] = np.argmin(cost)
    for i in range(n - 1, 0, -1):
        out[i - 1] = before[i, out[i]]
    return out


# ----------------------------------------------------------------------------------------------------
# A plan on such a machine: its axes at every sample, or where and why it cannot follow.

FINEST = np.radians(2.0)  # that an axis may turn between two samples; beyond, poses are added between them
MOST_ADDED = 60  # parts that an interval is divided into, in each round
ROUNDS = 2  # of adding poses
OFF, LEANING = 0.05e-3, np.radians(0.1)  # [m, rad] by which the nozzle may miss its path between two samples


@dataclass(frozen=True)
class Followed:
    """Motion of a machine (n samples, at least the plan's).

    t                   (n)     since the trajectory began [s]
    tip, quat           (n, 3), (n, 4) in the part
    feed                (n)     filament pushed since the start [m]
    laid                (n)     material flows
    straight, angles    (n, 3), (n, k) X Y Z [m] and the rotary axes [rad], with whole turns kept
    station             (n, e)  axes that move a robot's part [rad]
    sample              (n)     the plan's own sample, or the last one before it
    """

    machine: Machine
    t: Array
    tip: Array
    quat: Array
    feed: Array
    laid: Flags
    straight: Array
    angles: Array
    station: Array
    sample: Indices

    def __len__(self) -> int:
        return len(self.t)


def spec_of(plan: Plan) -> MachineSpec:
    """The machine that the problem describes; ValueError (the caller's mistake) if it describes none."""
    spec = plan.problem.program.machine
    if spec is None:
        raise ValueError("the problem describes no machine")
    return spec


def follow(plan: Plan) -> Followed:
    """A plan's motion on the machine in `program.machine`; InputError, with bead and place, if that is impossible.

    A five-axis machine does not share the robot's home: it stands still above the first bead while the robot comes from
    home, and above the last one while the robot returns.
    """
    t, spec = plan.trajectory, spec_of(plan)
    machine = machine_of(spec)
    tip, quat = t.tip.copy(), continuous(t.quat)
    station = np.empty((len(t), 0))
    if isinstance(machine, PoseMachine):
        station = t.q[:, len(plan.cell.arm) :]
    else:
        first, last = above(plan)
        tip[:first], quat[:first], tip[last:], quat[last:] = tip[first], quat[first], tip[last], quat[last]
    empty = np.empty((len(t), 0))
    now = Followed(
        machine, t.t - t.t[0], tip, quat, t.feed - t.feed[0], t.deposit, empty, empty, station, np.arange(len(t))
    )
    for _ in range(ROUNDS):
        now = _turned(plan, now)
        most = np.abs(np.diff(now.angles, axis=0)).max(axis=1)
        parts = np.clip(np.ceil(most / FINEST), 1, MOST_ADDED).astype(np.intp)
        if (parts == 1).all():
            break
        now = _finer(now, parts)
    else:
        now = _turned(plan, now)
    now = replace(now, straight=machine.straight(now.tip, now.angles))
    _check_slides(plan, now)
    _check_between(plan, now)
    return now


def above(plan: Plan) -> tuple[int, int]:
    """Last sample before the first bead, and first after the last one, at least lift and run-in away from it."""
    t, process = plan.trajectory, plan.problem.process
    laid = np.flatnonzero(t.deposit)
    high = process.lift + process.run_in
    before = np.flatnonzero(np.linalg.norm(t.tip[: laid[0]] - t.tip[laid[0]], axis=1) >= high)
    after = np.flatnonzero(np.linalg.norm(t.tip[laid[-1] :] - t.tip[laid[-1]], axis=1) >= high)
    first = int(before[-1]) if len(before) else 0
    return first, int(laid[-1] + after[0]) if len(after) else len(t) - 1


def _turned(plan: Plan, now: Followed) -> Followed:
    """The motion with its axes' angles chosen."""
    ways = now.machine.ways(now.quat)
    if len(lost := missing(ways, now.machine)):
        i = int(lost[0])
        why = "no angles of its axes give the nozzle's direction"
        if ways.reached[i]:
            both = ["/".join(f"{np.degrees(v):.2f}" for v in way) for way in ways.angles[i]]
            why = f"{'/'.join(now.machine.letters)} would have to be at {' or '.join(both)} degrees, beyond range_deg"
        raise plan.problem.error("program.machine", f"{where(plan, int(now.sample[i]))}: {why}")
    return replace(now, angles=chosen(ways, now.machine, now.t, now.laid, now.quat))


def _finer(now: Followed, parts: Indices) -> Followed:
    """The motion with poses added, so that each interval is divided into `parts` (n - 1)."""
    a = np.append(np.repeat(np.arange(len(parts)), parts), len(parts))
    u = np.append((np.arange(len(a) - 1) - np.repeat(np.cumsum(parts) - parts, parts)) / parts[a[:-1]], 0.0)
    b = np.minimum(a + 1, len(parts))

    def between(values: Array) -> Array:
        return lerp(values, a, b, u)

    return replace(
        now,
        t=between(now.t),
        tip=between(now.tip),
        quat=np.where(u[:, None] == 0.0, now.quat[a], slerp(now.quat[a], now.quat[b], u)),
        feed=between(now.feed),
        laid=now.laid[a] & (now.laid[b] | (u == 0.0)),
        station=between(now.station),
        sample=now.sample[a],
    )


def _check_slides(plan: Plan, now: Followed) -> None:
    """Raise InputError for a place where X, Y or Z would have to move beyond the machine's limits."""
    machine = now.machine
    if not isinstance(machine, FiveAxes):
        return
    slides = machine.slides(now.tip, now.angles)
    beyond = (slides < machine.least) | (slides > machine.greatest)
    wrong = np.flatnonzero(beyond.any(axis=1))
    if len(wrong):
        i = int(wrong[0])
        j = int(np.argmax(beyond[i]))
        low, high = machine.least[j] * 1e3, machine.greatest[j] * 1e3
        reason = f"{'XYZ'[j]} would have to be at {slides[i, j] * 1e3:.2f} mm; its limits are {low:g} and {high:g}"
        raise plan.problem.error("program.machine", f"{where(plan, int(now.sample[i]))}: {reason}")


def _check_between(plan: Plan, now: Followed) -> None:
    """Raise InputError for a place where evenly moving axes take the nozzle off its path between two samples."""
    halves = [0.5 * (values[1:] + values[:-1]) for values in (now.straight, now.angles, now.tip)]
    off = np.linalg.norm(now.machine.tip(halves[0], halves[1]) - halves[2], axis=1)
    quat = slerp(now.quat[:-1], now.quat[1:], np.full(len(off), 0.5))
    lean = now.machine.leaning(halves[1], quat)
    wrong = np.flatnonzero((off > OFF) | (lean > LEANING))
    if len(wrong):
        i = int(wrong[0])
        j = int(np.argmax(np.abs(now.angles[i + 1] - now.angles[i])))
        a, b = np.degrees(now.angles[i : i + 2, j])
        reason = f"{now.machine.letters[j]} would have to turn from {a:.1f} to {b:.1f} degrees at one place"
        hint = "another part_rpy_deg keeps the print away from where the axis is free; a wider range_deg may help"
        raise plan.problem.error("program.machine", f"{where(plan, int(now.sample[i]))}: {reason}", hint)


def where(plan: Plan, sample: int) -> str:
    """A sample's place in words."""
    t = plan.trajectory
    if t.bead[sample] >= 0:
        return f"bead {t.bead[sample]}, {t.s[sample] * 1e3:.1f} mm along it"
    later = t.bead[sample:][t.bead[sample:] >= 0]
    return f"on the way to bead {later[0]}" if len(later) else "on the way from the last bead"
