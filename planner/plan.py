"""The Plan: everything that is known at the end, as one frozen value. Export and report see only this."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from planner.cell import Cell
from planner.problem import Problem
from planner.readonly import ReadOnlyArrays
from planner.toolpath.bead import Bead, Toolpath

if TYPE_CHECKING:
    from planner.tolerance import Headroom

Array = NDArray[np.float64]
TRAVEL = -1
RAPID_EXTERNAL_AXES = 6
MOST_SHOWN = 2  # changes of a remedy in words
# Of dips that no joint limits.
CAUSES = {
    "start": "starts from rest",
    "end": "comes to rest",
    "stop": "stops here",
    "shape": "samples of the path coincide",
}


@dataclass(frozen=True)
class Event:
    """Something that the extruder or its heating does: "heat", "select", "purge", "prime", "retract", "cut", "change".

    bead its index, or -1; start, duration [s]; amount of filament [m], signed, 0 if none
    material by its name: what is moved, or selected, or changed to; empty where materials have no names
    """

    kind: str
    bead: int
    start: float
    duration: float
    amount: float
    material: str = ""

    @property
    def words(self) -> str:
        """What it is, and of which bead."""
        what = f"{self.kind} {self.material}" if self.kind == "select" else self.kind
        what = f"change to {self.material}" if self.kind == "change" else what
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

    @property
    def begun(self) -> NDArray[np.int64]:
        """Index (n) of the last bead that was begun; before the first of this motion, the one before that."""
        return np.maximum.accumulate(np.maximum(self.bead, self.first_bead - 1).astype(np.int64))

    def __len__(self) -> int:
        return len(self.t)


@dataclass(frozen=True)
class Check:
    """One named check of the verifier: the worst value found, its limit, and where it stands.

    least  the worst value is the least one, and the limit is one from below
    """

    name: str
    worst: float
    limit: float
    unit: str
    ok: bool
    where: str
    least: bool = False


@dataclass(frozen=True)
class Approach:
    """Where two bodies come nearest to each other: their names, the distance and what they are to keep [m], and when.

    sample  of the trajectory, the nearest one
    """

    a: str
    b: str
    distance: float
    need: float
    sample: int


@dataclass(frozen=True)
class CellView(ReadOnlyArrays):
    """All bodies of the cell, and where they are at each approach (k), for a picture.

    names, kinds (b)       of the bodies; kinds are "arm", "head", "holder", "carried" and "fixture"
    vertices, triangles    of each body: (n, 3) [m] in the frame of its carrier, (m, 3)
    carrier (b)            of each body: a row of poses
    poses (k, c, 4, 4)     T_world_carrier of all carriers at each approach
    T_world_part (k, 4, 4) the part frame there
    """

    names: tuple[str, ...]
    kinds: tuple[str, ...]
    vertices: tuple[Array, ...]
    triangles: tuple[NDArray[np.int64], ...]
    carrier: NDArray[np.int64]
    poses: Array
    T_world_part: Array


@dataclass(frozen=True)
class Remedy:
    """What would avoid a dip: fields of the problem file, and the values that they would need, all of them together.

    kind is "speed", "limits", "corner_tolerance" or "run_in".
    Values are in the file's units, the change that matters most comes first. exact: at constant speed it follows from
    this joint path; else it is an estimate. A plan made anew with the change is another one: the search sees it too.
    """

    kind: str
    changes: tuple[tuple[str, float], ...]
    exact: bool

    @property
    def words(self) -> str:
        """As it may be written into the problem file, with `about` where it is an estimate; of many the first."""
        about = "" if self.exact else "about "
        shown = self.changes if len(self.changes) <= MOST_SHOWN else self.changes[:1]
        text = " and ".join(f"{field}: {about}{value:.12g}" for field, value in shown)
        others = len(self.changes) - len(shown)
        return text + (f" and {others} other limits" if others else "")


@dataclass(frozen=True)
class Dip:
    """A stretch of a bead where the tip is slower than commanded, why, and what would avoid it.

    from_s, to_s, at_s   arc length where it begins, where it ends and where it is slowest [m]
    t                    time of the slowest sample [s]
    speed                there [m/s]
    lost                 time lost to it [s]
    joint, limit         whose "velocity", "acceleration" or "jerk" asks for the lowest constant speed; no joint where
                         it is none of them: then limit is one of CAUSES
    over_extruded        material that flows beyond what the bead holds here [m^3]
    remedies             each by itself avoids it
    """

    bead: int
    layer: int
    from_s: float
    to_s: float
    at_s: float
    t: float
    speed: float
    lost: float
    joint: str
    limit: str
    over_extruded: float
    remedies: tuple[Remedy, ...]

    @property
    def cause(self) -> str:
        """Joint and limit in words, or the rest near by."""
        return CAUSES.get(self.limit) or f"{self.joint} {self.limit}"


def resumed_name(name: str, first_bead: int) -> str:
    """What a problem's print is called that begins with a bead; the problem's own name if that is the first one."""
    return f"{name}_from_{first_bead}" if first_bead else name


@dataclass(frozen=True)
class Plan:
    """A finished plan. `verified` is true only if every check holds, within the tolerance too where one was asked for.

    metrics:  name → value, in the units that the name says (see the output contract in the docs)
    series:   per-sample arrays (n,) or (n, nj) that the verifier found on the way, for the report:
              sigma, wrist_deg (not of seven axes), limit_margin_deg, velocity_ratio, acceleration_ratio, jerk_ratio,
              tilt_deg (where the nozzle may lean from the normal), clearance_mm (of whatever is nearest; no more than 50)
    timing_s: seconds by stage
    baseline: strategy name → its metrics, for the summary beside the chosen strategy
    dips:     where the speed falls short of the commanded one, in order of time
    headroom: whether it holds for parts that stand a little elsewhere; None if nobody asked
    approaches: pairs of bodies that come near each other, those that lack most, or are nearest to it, first
    view:     the cell as it stands at each of them
    """

    problem: Problem
    cell: Cell
    toolpath: Toolpath
    strategy: str
    trajectory: Trajectory
    checks: tuple[Check, ...]
    metrics: dict[str, float]
    series: dict[str, Array]
    timing_s: dict[str, float]
    versions: dict[str, str]
    baseline: dict[str, dict[str, float]]
    settings: dict[str, Any]
    dips: tuple[Dip, ...] = ()
    headroom: Headroom | None = None
    approaches: tuple[Approach, ...] = ()
    view: CellView | None = None

    @property
    def first_bead(self) -> int:
        """Index of the first bead that is laid; not 0 where an interrupted print is resumed."""
        return self.trajectory.first_bead

    @property
    def beads(self) -> tuple[Bead, ...]:
        """The beads that are laid: all of the toolpath's, or the last ones."""
        return self.toolpath.beads[self.first_bead :]

    @property
    def layers(self) -> int:
        """Number of layers that they belong to."""
        toolpath = self.toolpath
        return toolpath.layers_from(self.first_bead) if self.first_bead else toolpath.layers

    @property
    def name(self) -> str:
        """The problem's name, and from which bead on it is printed if not from the first."""
        return resumed_name(self.problem.name, self.first_bead)

    @property
    def holds_as_planned(self) -> bool:
        """True if every check of the verifier holds where the part was planned to stand."""
        return all(check.ok for check in self.checks)

    @property
    def verified(self) -> bool:
        """True if every check of the verifier holds, within the tolerance too where one was asked for."""
        return self.holds_as_planned and (self.headroom is None or self.headroom.holds)
