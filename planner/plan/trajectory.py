"""The whole motion as samples, and what the extruder does besides."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

from planner.base.arrays import Array, ReadOnlyArrays

TRAVEL = -1  # index of the bead where there is none
WHOLE = ("dt", "events", "first_bead")  # fields of a trajectory that are not by sample
# Arrays that hold no floats, by the kind of what they hold; and those with columns, besides the joints.
_KINDS = {"bead": "i", "layer": "i", "branch": "i", "deposit": "b"}
_COLUMNS = {"tip": 3, "quat": 4, "axis": 3}


@dataclass(frozen=True)
class Event:
    """Something that the extruder or its heating does: "heat", "select", "purge", "prime", "retract", "cut", "change",
    "pause" (which a layer asks for), "cool" (a rest until the layer before has had its time, or what is below is old enough).

    bead its index, or -1; start, duration [s]; amount of filament [m], signed, 0 if none
    material by its name: what is moved, or selected, or changed to; empty where materials have no names
    note     what a pause is for
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
        """What it is, and of which bead."""
        what = f"{self.kind} {self.material}" if self.kind == "select" else self.kind
        what = f"change to {self.material}" if self.kind == "change" else what
        what = f"pause: {self.note}" if self.kind == "pause" and self.note != "pause" else what
        return what if self.bead < 0 else f"{what}, bead {self.bead}"


@dataclass(frozen=True)
class Trajectory(ReadOnlyArrays):
    """The whole motion, sampled every `dt` seconds (n samples; SI units, radians).

    bead          (n,) int32  index of the bead, or TRAVEL (-1); run-in and run-out count as travel
    layer         (n,) int32
    deposit       (n,) bool   material flows
    s             (n,)        arc length along the bead [m]; 0 in travel
    q             (n, nj)     joints in the cell's order: arm, then the positioner's free axes
    tip           (n, 3)      nozzle tip in the part frame [m]
    quat          (n, 4)      orientation of the nozzle frame in the part frame, x y z w; its z is the axis
    axis          (n, 3)      unit nozzle axis, from the nozzle into the part, part frame
    branch        (n,) int8   ABB's cfx: 4 wrist centre behind axis 1, 2 behind the lower arm, 1 axis 5 negative;
                              without a spherical wrist the number that the inverse kinematics gives the branch
    speed         (n,)        of the tip relative to the part [m/s]
    flow          (n,)        of material [m^3/s]
    extruded      (n,)        volume deposited since the start [m^3]
    feed          (n,)        filament that the motor has pushed since the start [m]: what is deposited, ahead by the
                              extruder's lag, primes and retracts
    events                    what the extruder and its heating do besides, in order of time
    first_bead                index of the first bead that is laid; those before it are there from the beginning
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
        """Whether it is what the fields say, for so many joints: what is read from a file may be anything."""
        if not isinstance(self.dt, float) or not isinstance(self.first_bead, int):
            return False
        if not isinstance(self.events, tuple) or self.odd_array(joints):
            return False
        rows = {len(value) for value in vars(self).values() if isinstance(value, np.ndarray)}
        return rows == {len(self.t)} and all(isinstance(event, Event) for event in self.events)

    def odd_array(self, joints: int) -> str:
        """Name of the first array whose numbers or columns are of another kind than the fields say, for so many joints,
        however many rows it has; empty where none is."""
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
        """Some samples as a motion of their own, whose time, filament and volume begin at 0."""
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
        """Index (n) of the last bead that was begun; before the first of this motion, the one before that."""
        return np.maximum.accumulate(np.maximum(self.bead, self.first_bead - 1).astype(np.int64))

    def __len__(self) -> int:
        return len(self.t)
