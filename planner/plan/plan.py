"""The Plan: everything that is known at the end, as one frozen value."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from planner.cell import Cell
from planner.plan.columns import table_of
from planner.plan.trajectory import Trajectory
from planner.plan.words import plan_html, plan_line, plan_words
from planner.problem import Problem
from planner.readonly import Array, ReadOnlyArrays
from planner.toolpath.bead import Bead, Toolpath

if TYPE_CHECKING:
    from planner.plan.tolerance import Headroom
    from planner.resolve.jointpath import JointPath
    from planner.resolve.roll_map import RollMap

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
class Check:
    """One named check of the verifier: the worst value found, its limit, and where it stands.

    least  the worst value is the least one, and the limit is one from below
    sample of the trajectory where it is; -1 if it is of no moment
    """

    name: str
    worst: float
    limit: float
    unit: str
    ok: bool
    where: str
    least: bool = False
    sample: int = -1


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
    """All bodies of the cell, and what moves them, for a picture.

    names, kinds (b)       of the bodies; kinds are "arm", "head", "holder", "carried" and "fixture"
    vertices, triangles    of each body: (n, 3) [m] in the world with all joints at 0, (m, 3)
    joints (b, 2)          of each body: joints first to last - 1 of the posture carry it, in this order
    """

    names: tuple[str, ...]
    kinds: tuple[str, ...]
    vertices: tuple[Array, ...]
    triangles: tuple[NDArray[np.int64], ...]
    joints: NDArray[np.int64]


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


@dataclass(frozen=True, repr=False)
class Plan:
    """A finished plan. `verified` is true only if every check holds, within the tolerance too where one was asked for.

    Its motion is sampled in `trajectory`, all of whose arrays are read-only; those that are wanted most stand here by
    their own names: t, q, tip, axis, speed, bead, deposit, s. `table` gives all of them as columns.

    metrics:  name → value, in the units that the name says (see the output contract in the docs)
    series:   per-sample arrays (n,) or (n, nj) that the verifier found on the way, for the report:
              sigma, wrist_deg (not of seven axes), limit_margin_deg, velocity_ratio, acceleration_ratio, jerk_ratio,
              tilt_deg (where the nozzle may lean from the normal), clearance_mm (of whatever is nearest; no more than 50)
    timing_s: seconds by stage
    baseline: strategy name → its metrics, for the summary beside the chosen strategy
    dips:     where the speed falls short of the commanded one, in order of time
    headroom: whether it holds for parts that stand a little elsewhere; None if nobody asked
    approaches: pairs of bodies that come near each other, those that lack most, or are nearest to it, first
    view:     the bodies of the cell, for pictures
    paths:    joints along each bead that is laid, by arc length, before they were timed; with roll and tilt
    roll_maps: what roll could have been chosen: along the whole print, then along the beads where it is tightest
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
    paths: tuple[JointPath, ...] = ()
    roll_maps: tuple[RollMap, ...] = ()

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

    @property
    def t(self) -> Array:
        """Time (n) of the samples, from 0 [s]."""
        return self.trajectory.t

    @property
    def q(self) -> Array:
        """Joints (n, nj) in the order of `joint_names` [rad]."""
        return self.trajectory.q

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names (nj) of the joints: the arm's, then those of what holds the part."""
        return self.cell.joint_names

    @property
    def tip(self) -> Array:
        """Nozzle tip (n, 3) in the part frame [m]."""
        return self.trajectory.tip

    @property
    def axis(self) -> Array:
        """Unit nozzle axis (n, 3), from the nozzle into the part, part frame."""
        return self.trajectory.axis

    @property
    def speed(self) -> Array:
        """Speed (n) of the tip relative to the part [m/s]."""
        return self.trajectory.speed

    @property
    def bead(self) -> NDArray[np.int32]:
        """Index (n) of the bead; -1 in travel."""
        return self.trajectory.bead

    @property
    def deposit(self) -> NDArray[np.bool_]:
        """Whether (n) material flows."""
        return self.trajectory.deposit

    @property
    def s(self) -> Array:
        """Arc length (n) along the bead [m]; 0 in travel."""
        return self.trajectory.s

    def table(self) -> NDArray[np.void]:
        """All samples as a structured array (n), with the columns of trajectory.csv, not rounded.

        `plan.table()["x_mm"]` is a column, and `pandas.DataFrame(plan.table())` a data frame. t_s; bead, -1 in
        travel; layer; deposit; s_mm; x_mm, y_mm, z_mm of the nozzle tip and its unit axis ax, ay, az, both in the
        part frame; speed_mm_s; flow_mm3_s; e_mm of filament; then the joints by their names, in rad.
        """
        return table_of(self.trajectory, self.joint_names)

    def summary(self) -> str:
        """A few lines of text: the verdict, and what matters most."""
        return plan_words(self)

    def __repr__(self) -> str:
        return f"<Plan {plan_line(self)}>"

    def _repr_html_(self) -> str:
        return plan_html(self)
