"""Machines that G-code moves: what their axes make of the nozzle's pose in the part, and back.

A machine of five axes has X, Y, Z and two that turn. Whatever the two turn, head or table, the nozzle's direction at
zero angles, n, becomes R(u, a) R(w, b) n in the part as it lies then: u is the axis next to the part, w the one next
to the nozzle, and a, b are their angles, with the sign turned of those that turn the table. Two rotations reach a
direction in two ways (Paden and Kahan's second subproblem); where it lies along u, a is free.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Protocol

import numpy as np

from planner.export.rotations import angle, from_matrix, to_matrix
from planner.readonly import Array, Flags

if TYPE_CHECKING:
    from planner.problem.machine import MachineSpec


FREE = np.radians(0.02)  # from a direction that leaves an axis free: nearer counts as there, of 0.1 deg allowed
BEYOND = 1e-9  # by which a square may be negative from rounding
DOWN = np.array([0.0, 0.0, -1.0])  # of the nozzle at zero angles, on the machine


@dataclass(frozen=True)
class Ways:
    """Angles that give directions (n): both ways (n, 2, k) [rad], whether there is one, and where an axis is free (n)."""

    angles: Array
    reached: Flags
    free: Flags


class Machine(Protocol):
    """What is common to machines; poses are tip (n, 3) [m] and quaternion (n, 4) in the part."""

    @property
    def letters(self) -> tuple[str, ...]:
        """Of the axes that turn."""

    @property
    def ranges(self) -> tuple[tuple[float, float] | None, ...]:
        """Of them [rad]; None without end."""

    @property
    def loose(self) -> int:
        """Which of them is free where one is."""

    def ways(self, quat: Array) -> Ways:
        """Both ways to orientations (n, 4)."""

    def settled(self, angles: Array, quat: Array) -> Array:
        """Angles (n, k) at orientations that leave an axis free, which stays as it is."""

    def straight(self, tip: Array, angles: Array) -> Array:
        """X, Y, Z (n, 3) [m] that bring the tip to its place at angles (n, k)."""

    def tip(self, straight: Array, angles: Array) -> Array:
        """The tip (n, 3) in the part."""

    def leaning(self, angles: Array, quat: Array) -> Array:
        """How far (n) [rad] the nozzle at angles (n, k) is from orientations (n, 4), as far as that matters here."""


def turned(direction: Array, theta: Array) -> Array:
    """Rotation matrices (n, 3, 3) by theta (n) about a unit vector (Rodrigues)."""
    x, y, z = direction
    K = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    s, c = np.sin(theta)[:, None, None], np.cos(theta)[:, None, None]
    out: Array = np.eye(3) + s * K + (1.0 - c) * (K @ K)
    return out


@dataclass(frozen=True)
class FiveAxes:
    """X, Y, Z and two axes that turn; with `tcp` the controller itself keeps the tip in its place.

    directions, centres   (2, 3) of the axes at zero angles, on the machine [m]; centres in the head are from the tip
    tables                which of them turn the table
    R, origin             the part frame on the machine at zero angles
    least, greatest       (3,) X, Y, Z of the machine [m], infinite where it is not known how far they go
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
        """Both ways to the nozzle's direction in the part; how it is turned about itself does not matter."""
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
        """The other axis does not depend on the one that is free."""
        out = self.ways(quat).angles[:, 0]
        out[:, self.loose] = angles[:, self.loose]
        return out

    def straight(self, tip: Array, angles: Array) -> Array:
        """Where the tip is on the machine, less what the turned head moves it by; with `tcp` as at zero angles."""
        return tip @ self.R.T + self.origin if self.tcp else self.slides(tip, angles)

    def slides(self, tip: Array, angles: Array) -> Array:
        """Where X, Y and Z of the machine stand (n, 3), whatever the controller is told."""
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
        """From where the tip would be at zero angles of the head to where it is (n, 3)."""
        out = np.zeros((len(angles), 3))
        for i in (1, 0):
            if not self.tables[i]:
                R = turned(self.directions[i], angles[:, i])
                out = self.centres[i] + np.einsum("nij,nj->ni", R, out - self.centres[i])
        return out


@dataclass(frozen=True)
class Robot:
    """Six axes whose controller takes poses: R = Rz(C) Ry(B) Rx(A), as LinuxCNC's genserkins has it."""

    letters: tuple[str, ...] = ("A", "B", "C")
    ranges: tuple[tuple[float, float] | None, ...] = (None, None, None)
    loose: int = 0

    def ways(self, quat: Array) -> Ways:
        """Roll, pitch and yaw, and those of the other half turn."""
        R = to_matrix(quat)
        level = np.hypot(R[:, 0, 0], R[:, 1, 0])
        roll, yaw = np.arctan2(R[:, 2, 1], R[:, 2, 2]), np.arctan2(R[:, 1, 0], R[:, 0, 0])
        pitch = np.arctan2(-R[:, 2, 0], level)
        angles = np.stack(
            [np.column_stack([roll, pitch, yaw]), np.column_stack([roll + np.pi, np.pi - pitch, yaw + np.pi])], axis=1
        )
        return Ways(angles, np.ones(len(quat), dtype=bool), level < FREE)

    def settled(self, angles: Array, quat: Array) -> Array:
        """Straight up or down only the sum, or the difference, of roll and yaw is given."""
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
        return Robot()
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
