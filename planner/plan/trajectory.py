"""The whole motion as samples, and the extruder's events."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

from planner.base.arrays import Array, ReadOnlyArrays

TRAVEL = -1  # bead index where there is none
WHOLE = ("dt", "events", "first_bead")  # fields of a trajectory that are not per sample
# NumPy kinds of the arrays that hold no floats; and column counts of two-dimensional arrays other than the joints.
_KINDS = {"bead": "i", "layer": "i", "branch": "i", "deposit": "b"}
_COLUMNS = {"tip": 3, "quat": 4, "axis": 3}


@dataclass(frozen=True)
class Event:
    """An action of the extruder or its heating.

    Attributes:
        kind: "heat", "select", "purge", "prime", "retract", "cut", "change", "pause" (before a layer), or "cool" (a
            rest until the previous layer has had its time, or the material below is old enough).
        bead: Index of the bead, or -1.
        start: Time at which it starts [s].
        duration: How long it takes [s].
        amount: Amount of filament [m], signed, 0 if none.
        material: Name of the material that is moved, selected or changed to; empty if materials have no names.
        note: What a pause is for.
    """

    kind: str
    bead: int
    start: float
    duration: float
    amount: float
    material: str = ""
    note: str = ""

    @property
    def words(self) -> str:
        """The event in words, with its bead."""
        what = f"{self.kind} {self.material}" if self.kind == "select" else self.kind
        what = f"change to {self.material}" if self.kind == "change" else what
        what = f"pause: {self.note}" if self.kind == "pause" and self.note != "pause" else what
        return what if self.bead < 0 else f"{what}, bead {self.bead}"


@dataclass(frozen=True)
class Trajectory(ReadOnlyArrays):
    """The whole motion, sampled every `dt` seconds (n samples; SI units, radians).

    Attributes:
        dt: Time between samples [s].
        t: Time (n,) of the samples, from 0 [s].
        bead: Index (n,) int32 of the bead, or TRAVEL (-1); run-in and run-out count as travel.
        layer: Index (n,) int32 of the bead's layer; in travel, of the next bead's, or at the end, of the last one's.
        deposit: Whether (n,) bool material flows.
        s: Arc length (n,) along the bead [m]; 0 in travel.
        q: Joints (n, nj) in the cell's order: arm, then the positioner's free axes [rad; m for sliding joints].
        tip: Nozzle tip (n, 3) in the part frame [m].
        quat: Orientation (n, 4) of the nozzle frame in the part frame, x y z w; its z is the axis.
        axis: Unit nozzle axis (n, 3), from the nozzle into the part, part frame.
        branch: ABB's cfx (n,) int8, a sum of 4 for the wrist centre behind axis 1, 2 for it behind the lower arm, and 1
            for a negative axis 5; without a spherical wrist, the number that the inverse kinematics gives the branch.
        speed: Speed (n,) of the tip relative to the part [m/s].
        flow: Flow (n,) of material [m^3/s].
        extruded: Volume (n,) deposited since the start [m^3].
        feed: Filament (n,) that the motor has pushed since the start [m]: for the deposited volume, ahead by the
            extruder's lag, and for primes and retracts.
        events: What else the extruder and its heating do, in order of time.
        first_bead: Index of the first bead that is laid; those before it are there from the beginning.
    """

    dt: float
    t: Array
    bead: NDArray[np.int32]
    layer: NDArray[np.int32]
    deposit: NDArray[np.bool_]
    s: Array
    q: Array
    tip: Array
    quat: Array
    axis: Array
    branch: NDArray[np.int8]
    speed: Array
    flow: Array
    extruded: Array
    feed: Array
    events: tuple[Event, ...] = ()
    first_bead: int = 0

    def is_of(self, joints: int) -> bool:
        """Whether all fields are of their declared types, for so many joints: a file may contain anything.

        Args:
            joints: Number of joints.
        """
        if not isinstance(self.dt, float) or not isinstance(self.first_bead, int):
            return False
        if not isinstance(self.events, tuple) or self.odd_array(joints):
            return False
        rows = {len(value) for value in vars(self).values() if isinstance(value, np.ndarray)}
        return rows == {len(self.t)} and all(isinstance(event, Event) for event in self.events)

    def odd_array(self, joints: int) -> str:
        """Name of the first array whose type or number of columns is wrong, for so many joints; empty if none is.

        The number of rows is not checked.

        Args:
            joints: Number of joints.
        """
        columns = _COLUMNS | {"q": joints}
        for each in fields(self):
            if each.name in WHOLE:
                continue
            value, shape = getattr(self, each.name), (columns[each.name],) if each.name in columns else ()
            if (
                not isinstance(value, np.ndarray)
                or value.ndim != 1 + len(shape)
                or value.shape[1:] != shape
                or value.dtype.kind != _KINDS.get(each.name, "f")
            ):
                return each.name
        return ""

    def part(self, rows: slice) -> Trajectory:
        """Some samples as a separate motion, whose time, filament and volume begin at 0.

        Args:
            rows: The samples, with a start and a stop.
        """
        a, b = rows.start, rows.stop
        begin, end = self.t[a - 1] if a else -np.inf, self.t[b - 1] if b < len(self) else np.inf
        laid = self.bead[rows][self.bead[rows] != TRAVEL]
        own = {each.name: getattr(self, each.name)[rows] for each in fields(self) if each.name not in WHOLE}
        own |= {name: own[name] - own[name][0] for name in ("t", "extruded", "feed")}
        events = [event for event in self.events if begin < event.start <= end]
        return replace(
            self,
            **own,
            events=tuple(replace(event, start=event.start - float(self.t[a])) for event in events),
            first_bead=int(laid.min()) if len(laid) else self.first_bead,
        )

    @property
    def begun(self) -> NDArray[np.int64]:
        """Index (n,) of the last bead begun; before this motion's first bead, the one preceding that."""
        return np.maximum.accumulate(np.maximum(self.bead, self.first_bead - 1).astype(np.int64))

    def __len__(self) -> int:
        return len(self.t)
