"""A program that was played: where everything is at any time, and what happens when."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from planner.base.arrays import Array, Flags, Indices
from planner.export.fit import lerp, slerp

# ----------------------------------------------------------------------------------------------------
# The motion over time.

# A way has three phases: from its first speed to a constant speed, at that speed, and on to the next way's first speed.
PHASES = ("speed", "first acceleration", "its time", "time of even speed", "last acceleration", "its time")
TIMES = [2, 3, 5]


@dataclass(frozen=True)
class ProgramEvent:
    """Something that a program does besides moving.

    t         when it happens [s]
    kind      "output" (text: the signal, value: 1 or 0), "demand" (value of the analog output), "send" (text: the
              line), "wait" (value: how long [s])
    move      index of the move that it belongs to; -1 before the first
    position  of the nozzle's tip in the part frame [m]
    """

    t: float
    kind: str
    move: int
    position: tuple[float, float, float]
    value: float = 0.0
    text: str = ""


@dataclass(frozen=True)
class Moment:
    """Where everything is at one or many times; the shape of the times leads that of each array.

    q (..., n) joints in the cell's order [rad]; position (..., 3) [m] and quat (..., 4) x y z w of the nozzle in the
    part frame; move (...) the current move, or the one at whose target the robot rests
    """

    q: Array
    position: Array
    quat: Array
    move: Indices


@dataclass(frozen=True)
class Played:
    """A program over time (m moves; k knots with straight joint motion between them; SI units, radians).

    q, position, quat  (k, n), (k, 3), (k, 4) x y z w: joints, and the true nozzle in the part frame
    move      (k - 1)     the move that the way from each knot to the next belongs to
    leave     (k)         when the robot leaves the knot: after it arrives, by the time it waits there [s]
    length    (k - 1)     of the way, in metres of path (see pace.py)
    phases    (k - 1, 6)  of each way, as in PHASES [m/s, m/s^2, s, s, m/s^2, s]
    limit     (k - 1)     what limits the top speed on the way: index into `limits`
    target    (m)         the knot that is the target of each move
    arrive    (m)         when the robot reaches it [s]
    strays                moves whose final posture does not have the configuration that the target names
    events                what else happens, in order of time
    """

    q: Array
    position: Array
    quat: Array
    move: Indices
    leave: Array
    length: Array
    phases: Array
    limit: Indices
    limits: tuple[str, ...]
    target: Indices
    arrive: Array
    strays: tuple[int, ...]
    events: tuple[ProgramEvent, ...]

    @property
    def duration(self) -> float:
        """When the robot has reached the last target and has waited there [s]."""
        return float(self.leave[-1])

    def at(self, t: float | Array) -> Moment:
        """Where everything is at times t [s], of any shape; before the start and after the end it rests there."""
        times = np.asarray(t, dtype=np.float64)
        flat = np.atleast_1d(times).ravel()
        k = np.clip(np.searchsorted(self.leave, flat, side="right") - 1, 0, len(self.move) - 1)
        u = np.clip(self.gone(k, flat - self.leave[k]) / np.where(self.length[k] > 0.0, self.length[k], 1.0), 0.0, 1.0)
        quat = slerp(self.quat[k], self.quat[k + 1], u)
        shape = times.shape
        return Moment(
            q=lerp(self.q, k, k + 1, u).reshape(*shape, -1),
            position=lerp(self.position, k, k + 1, u).reshape(*shape, 3),
            quat=(quat / np.linalg.norm(quat, axis=1, keepdims=True)).reshape(*shape, 4),
            move=self.move[k].reshape(shape),
        )

    def reached(self, k: Indices, u: Array) -> Array:
        """When (n) the robot has covered the fraction u (n) of the way from knots k (n) to the next ones [s]."""
        way = u * self.length[k]
        v, a, first, even, b, last = self.phases[k].T
        top = v + a * first
        begun, kept = (v + 0.5 * a * first) * first, top * even
        left = np.maximum(way - begun - kept, 0.0)
        in_first, in_even = _time(v, a, way), first + (way - begun) / np.maximum(top, TINY)
        took = np.where(left > 0.0, first + even + _time(top, b, left), np.where(way > begun, in_even, in_first))
        out: Array = self.leave[k] + np.clip(took, 0.0, first + even + last)
        return out

    def gone(self, k: Indices, since: Array) -> Array:
        """Metres of path (n) that the robot has covered from knots k (n) at a time (n) [s] after it left them."""
        v, a, first, even, b, last = self.phases[k].T
        top = v + a * first
        t1 = np.clip(since, 0.0, first)
        t2 = np.clip(since - first, 0.0, even)
        t3 = np.clip(since - first - even, 0.0, last)
        out: Array = (v + 0.5 * a * t1) * t1 + top * t2 + (top + 0.5 * b * t3) * t3
        return out


TINY = 1e-300  # keeps 0 / 0 finite where there is no speed at all


def _time(v: Array, a: Array, way: Array) -> Array:
    """How long (n) [s] a way (n) [m] takes from a speed v [m/s] at an acceleration a [m/s^2]."""
    out: Array = 2.0 * way / np.maximum(v + np.sqrt(np.maximum(v * v + 2.0 * a * way, 0.0)), TINY)
    return out


# ----------------------------------------------------------------------------------------------------
# Where it lays material: spans of time, moves and targets.

AT_ONCE = 1e-9  # [s] by which an event at a target may miss it


def laid_spans(played: Played) -> Array:
    """When the extruder goes on and off again (b, 2) [s], whichever output switches it."""
    spans, on = [], float("nan")
    for event in played.events:
        if event.kind == "output" and event.value and np.isnan(on):
            on = event.t
        elif event.kind == "output" and not event.value and not np.isnan(on):
            spans.append((on, event.t))
            on = float("nan")
    return np.array(spans).reshape(-1, 2)


def laid_targets(played: Played) -> tuple[Flags, Flags]:
    """Which targets (m) are within beads, and at which beads begin or end."""
    on, off = _around(played)
    arrive, leave = played.arrive, played.leave[played.target]
    edges = np.zeros(len(arrive), dtype=bool)
    for switched in laid_spans(played).T:
        for passed in (arrive, leave):
            near = np.searchsorted(passed, switched - AT_ONCE)
            near = near[near < len(passed)]
            edges[near[np.isin(near, np.searchsorted(passed, switched + AT_ONCE, side="right") - 1)]] = True
    return (arrive > on + AT_ONCE) & (arrive < off - AT_ONCE) & ~edges, edges


def laid_moves(played: Played) -> Flags:
    """Which moves (m) lay material from beginning to end."""
    on, off = _around(played)
    began = np.append(0.0, played.leave[played.target[:-1]])
    out: Flags = (began >= on - AT_ONCE) & (played.arrive > on + AT_ONCE) & (played.arrive <= off + AT_ONCE)
    return out


def _around(played: Played) -> tuple[Array, Array]:
    """For each target (m), when the extruder last went on before the robot arrived, and when it next goes off."""
    spans = np.vstack([[-np.inf, -np.inf], laid_spans(played)])
    k = np.searchsorted(spans[:, 0], played.arrive - AT_ONCE) - 1
    return spans[k, 0], spans[k, 1]
