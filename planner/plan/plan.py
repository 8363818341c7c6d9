"""The Plan: everything known when planning ends, as one frozen value; its columns, materials, and text and HTML forms.

SI units and radians, except for metrics, whose names include their units, and columns, which have those of
trajectory.csv.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from planner.base.arrays import Array, ReadOnlyArrays
from planner.base.errors import InputError
from planner.base.versions import versions
from planner.cell.cell import Cell, build_cell
from planner.plan.frames import data_frame, data_set
from planner.plan.robustness import Robustness
from planner.plan.stored import save, stored_parts
from planner.plan.trajectory import Event, Trajectory
from planner.problem import Problem
from planner.problem.process import signals
from planner.problem.settings import STRATEGY_NAMES
from planner.toolpath.bead import Bead, Toolpath

if TYPE_CHECKING:
    import pandas
    import xarray

    from planner.problem.by_layer import PauseSpec
    from planner.report.inline import InlineScene
    from planner.resolve.joint_path import JointPath
    from planner.resolve.roll_map import RollMap

RAPID_EXTERNAL_AXES = 6
MOST_SHOWN = 2  # changes of a remedy that are given in words
# Causes of dips that no joint limit explains, in words.
CAUSES = {
    "start": "starts from rest",
    "end": "comes to rest",
    "stop": "stops here",
    "shape": "samples of the path coincide",
}
SELECTS = ("select", "change")  # kinds of events after which another tool feeds
NONE = -1  # index in place of a material's, before the first one is selected
EVERY_ROW = slice(None)
# metric → what it is, unit, factor, decimals
ROWS = {
    "at_speed_fraction": ("of the length at the commanded speed", "%", 100.0, 1),
    "speed_min_mm_s": ("slowest while depositing", "mm/s", 1.0, 1),
    "print_time_s": ("whole print, travel included", "s", 1.0, 1),
    "sigma_min": ("least singular value of the arm's Jacobian", "", 1.0, 3),
    "joint_limit_margin_deg": ("least distance from an end stop", "deg", 1.0, 1),
    "clearance_min_mm": ("least clearance beyond the tip", "mm", 1.0, 1),
}


# Singular of the units of checks that count
_OF_ONE = {
    "places": "place",
    "parts": "part",
    "samples and events": "sample or event",
    "beads that do not": "bead that does not",
    "motions that are not": "motion that is not",
    "programs that do not": "program that does not",
}


@dataclass(frozen=True)
class Check:
    """One named check of the verifier: the worst value found, its limit, and where it was found.

    Attributes:
        name: Name of the check.
        worst: The worst value found.
        limit: Its limit.
        unit: Unit of both.
        ok: Whether the check holds.
        where: Where the worst value was found, in words.
        least: Whether the worst value is the least one, and the limit a lower limit.
        sample: Index of the trajectory's sample where it was found; -1 if it belongs to none.
    """

    name: str
    worst: float
    limit: float
    unit: str
    ok: bool
    where: str
    least: bool = False
    sample: int = -1

    @property
    def worst_unit(self) -> str:
        """The unit as it reads after the worst value: 1 place, 2 places."""
        return _OF_ONE.get(self.unit, self.unit) if self.worst == 1.0 else self.unit

    @property
    def words(self) -> str:
        """The check in one line: its name, worst value, limit and place."""
        return f"{self.name}: {self.worst:.4g} {self.worst_unit}, limit {self.limit:.4g} ({self.where})"


@dataclass(frozen=True)
class Approach:
    """Where two bodies come closest to each other: their names, the distance, the required distance [m], and when.

    sample  the closest one of the trajectory
    """

    a: str
    b: str
    distance: float
    need: float
    sample: int


@dataclass(frozen=True)
class CellView(ReadOnlyArrays):
    """What the cell looks like, and what moves it, for a picture: one surface for each link, and for each other body.

    names, kinds (b)       of the surfaces; kinds are "arm", "head", "holder", "carried" and "fixture"
    bodies (b)             names of the bodies, as in approaches, that each surface represents
    vertices, normals      of each: (n, 3) [m] in the world with all joints at 0, and of unit length
    colours, triangles     of each: (n, 3) RGB in 8 bits, and (m, 3)
    joints (b, 2)          of each: joints first to last - 1 of the posture carry it, in this order
    """

    names: tuple[str, ...]
    kinds: tuple[str, ...]
    bodies: tuple[tuple[str, ...], ...]
    vertices: tuple[Array, ...]
    normals: tuple[Array, ...]
    colours: tuple[NDArray[np.uint8], ...]
    triangles: tuple[NDArray[np.int64], ...]
    joints: NDArray[np.int64]


@dataclass(frozen=True)
class Remedy:
    """What would avoid a dip: fields of the problem file, and the values that they would need, all of them together.

    Planning again with the change gives another plan, since it affects the search too.

    Attributes:
        kind: "speed", "limits", "corner_tolerance" or "run_in".
        changes: Fields and the values that they would need, in the file's units; the change that matters most comes
            first.
        exact: Whether it follows from this joint path at constant speed; otherwise it is an estimate.
    """

    kind: str
    changes: tuple[tuple[str, float], ...]
    exact: bool

    @property
    def words(self) -> str:
        """The changes as in the problem file, with `about` for an estimate; only the first one if there are many."""
        about = "" if self.exact else "about "
        shown = self.changes if len(self.changes) <= MOST_SHOWN else self.changes[:1]
        text = " and ".join(f"{field}: {about}{value:.12g}" for field, value in shown)
        others = len(self.changes) - len(shown)
        return text + (f" and {others} other limits" if others else "")


@dataclass(frozen=True)
class Dip:
    """A stretch of a bead where the tip is slower than commanded, why, and what would avoid it.

    Attributes:
        bead: Index of the bead.
        layer: Index of its layer.
        from_s: Arc length along the bead where the dip begins [m].
        to_s: Arc length where it ends [m].
        at_s: Arc length where it is slowest [m].
        t: Time of the slowest sample [s].
        speed: Speed there [m/s].
        lost: Time lost to it [s].
        joint: Name of the joint with the limit that allows the least constant speed; empty if it is no joint's limit.
        limit: "velocity", "acceleration" or "jerk" of that joint; if it is no joint's limit, one of CAUSES: "start",
            "end", "stop" or "shape".
        over_extruded: Material that flows in excess of what the bead holds here [m^3].
        remedies: Changes each of which avoids it by itself.
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
        """The cause in words: joint and limit, or the text in CAUSES."""
        return CAUSES.get(self.limit) or f"{self.joint} {self.limit}"


@dataclass(frozen=True)
class Advice:
    """A change that a user could make, tried on some slow beads, and its effect.

    kind               "corner_tolerance", "lean" or "speed"
    field, value       of the problem file, in its units
    beads              indices of those that it was tried on
    covered            share of the print's length below speed that lies on these
    share_now, share   of these beads' length at the commanded speed, before and with it
    time_now, time     that laying them takes, before and with it [s]
    seconds            by which the print takes longer with it, other beads at the same share of their speed [s]
    whole_now, whole   share of the whole print's length at speed, before, and with it on these beads alone
    """

    kind: str
    field: str
    value: float
    beads: tuple[int, ...]
    covered: float
    share_now: float
    share: float
    time_now: float
    time: float
    whole_now: float
    whole: float
    seconds: float

    @property
    def words(self) -> str:
        """The change, its effect where it was tried, and the cost of another speed."""
        longer = f", print {self.seconds:.1f} s longer" if self.kind == "speed" else ""
        return f"{self.field}: {self.value:g} ({self.share_now:.0%} of their length at speed becomes {self.share:.0%}{longer})"

    @property
    def tried_on(self) -> str:
        """What it was tried on, in words."""
        beads = "1 slow bead" if len(self.beads) == 1 else f"{len(self.beads)} slow beads"
        return f"tried on {beads} with {self.covered:.0%} of the length below speed"


@dataclass(frozen=True)
class Nearer:
    """Nozzle and head keep less distance from part and print than usual, because the usual one is not feasible [m].

    because  why not, in words
    """

    kept: float
    usual: float
    because: str

    @property
    def words(self) -> str:
        """As a note for the user."""
        kept, usual = (f"{each * 1e3:g}" for each in (self.kept, self.usual))
        return (
            f"nozzle and head keep {kept} mm from part and print instead of {usual}, and are verified by that: {self.because}; "
            f"collision.nozzle_mm: {usual} requires the full distance"
        )


def resumed_name(name: str, first_bead: int) -> str:
    """Name of a problem's print that begins with this bead; the problem's own name if it is the first one."""
    return f"{name}_from_{first_bead}" if first_bead else name


@dataclass(frozen=True, repr=False)
class Plan:
    """A finished plan. `verified` is true only if every check holds, also within the tolerance if one was requested.

    Its motion is sampled in `trajectory`, all of whose arrays are read-only; those needed most often are available here
    by their own names: t, q, tip, axis, speed, bead, deposit, s. `table` gives all of them as columns.

    Attributes:
        problem: The problem that was planned.
        cell: Its robots, placed.
        toolpath: All beads of the print.
        strategy: Name of the strategy that was asked for.
        trajectory: The whole motion, sampled.
        checks: The verifier's checks.
        metrics: Name → value, in the units that the name gives (see the output contract in the docs).
        series: Per-sample arrays (n,) that the verifier computed along the way, for the report: sigma, wrist_deg (not
            for seven axes), limit_margin_deg, velocity_ratio, acceleration_ratio, jerk_ratio, tilt_deg (if the nozzle
            may lean from the normal), clearance_mm (from whatever is nearest; at most 50), interlayer_time_s (where a
            bead lies on material laid before; not a number elsewhere).
        timing_s: Seconds by stage.
        versions: Package → version, including Python.
        baseline: Strategy name → its metrics, for the summary next to the chosen strategy.
        settings: What else the plan was made with: `dt` [s], the problem's `overrides`, and the names of your own
            `terms`.
        resolved_by: Strategy that found these paths: the default takes a simpler one's if they are better; empty if
            unknown.
        dips: Where the speed falls short of the commanded one, in order of time.
        advice: Changes that would help most, tried on some slow beads, the best first.
        headroom: Whether it holds for slightly displaced parts; None without a tolerance.
        approaches: Pairs of bodies that come near each other; those that lack most clearance, or have least to spare,
            first.
        view: The bodies of the cell, for pictures.
        paths: Joints along each bead that is laid, by arc length, before timing; with roll and tilt.
        roll_maps: What roll could have been chosen, along the whole print, then along the beads where it is tightest.
        nearer: What nozzle and head keep from part and print, if it is less than usual; the problem has it, too.
        asked: The motion that programs command so that the robot executes the trajectory, as learnt from runs; None if
            it is the trajectory itself.
        seal: Digests of what was verified, and of the verdict, by part (see `planner.plan.seal`); empty if nothing was.
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
    resolved_by: str = ""
    dips: tuple[Dip, ...] = ()
    advice: tuple[Advice, ...] = ()
    headroom: Robustness | None = None
    approaches: tuple[Approach, ...] = ()
    view: CellView | None = None
    paths: tuple[JointPath, ...] = ()
    roll_maps: tuple[RollMap, ...] = ()
    nearer: Nearer | None = None
    asked: Trajectory | None = None
    seal: Mapping[str, str] = field(default_factory=dict)

    def save(self, path: str | Path) -> Path:
        """Write the whole plan into one file, from which `Plan.load` restores it to the last bit.

        Args:
            path: The file to write; an earlier one is replaced.

        Returns:
            Path of the file.

        Raises:
            OutputError: If it cannot be written.
        """
        return save(self, path)

    @classmethod
    def load(cls, path: str | Path) -> Plan:
        """The plan that `save` wrote. Its cell is built again from its problem and the robots' files.

        The seal reveals anything that has changed since the plan was verified, be it numbers in its file or a robot's
        file: `write` verifies such a plan again, and also one that another version has verified.

        Args:
            path: The file that `save` wrote.

        Raises:
            InputError: If the file is no saved plan, or does not match this version.
        """
        parts = stored_parts(path, {each.name for each in fields(cls)} - {"cell"})
        wrong = [name for name, kind in KINDS.items() if not isinstance(parts[name], kind)]
        items = {name: kind for name, kind in ITEMS.items() if name not in wrong}
        wrong += [name for name, kind in items.items() if not all(isinstance(each, kind) for each in parts[name])]
        _refuse_wrong(wrong, path)
        cell = build_cell(parts["problem"])
        motions = [(name, parts[name]) for name in ("trajectory", "asked") if parts[name] is not None]
        _refuse_wrong([name for name, each in motions if not each.is_of(len(cell.joint_names))], path)
        if parts["seal"] and parts["versions"].get("beadwise") != versions()["beadwise"]:
            parts["seal"] = {**parts["seal"], "verdict": ""}
        return cls(cell=cell, **parts)

    @property
    def stretches(self) -> tuple[Plan, ...]:
        """The plan itself, or with several nozzles a plan for each period that one is in use, from home to home."""
        return self._parts or (self,)

    @cached_property
    def _parts(self) -> tuple[Plan, ...]:
        """Empty if there is one nozzle: a plan that refers to itself would be freed late."""
        t = self.trajectory
        found = by_nozzle(self.cell, t.events, t.t)
        if len(found) == 1:
            return (replace(self, cell=found[0][0]),) if self.cell.nozzles else ()
        return tuple(replace(self, cell=cell, trajectory=t.part(rows)) for cell, rows in found)

    @property
    def first_bead(self) -> int:
        """Index of the first bead that is laid; not 0 if an interrupted print is resumed."""
        return self.trajectory.first_bead

    @property
    def beads(self) -> tuple[Bead, ...]:
        """The beads that are laid: all of the toolpath's, or the last ones."""
        return self.toolpath.beads[self.first_bead :]

    @property
    def begins_with(self) -> str:
        """Name of the nozzle that has to be on the flange at the start, if one of several is mounted; else empty."""
        one = self.problem.cell.mounted == "one"
        return self.cell.at(self.beads[0].material).nozzle_name if one else ""

    @property
    def pause_left_out(self) -> PauseSpec | None:
        """The pause before the layer that a resumed print begins with, which comes before the start.

        None if that layer was begun earlier, or no pause is requested.
        """
        pauses = {pause.before_layer - 1: pause for pause in self.problem.process.pauses}
        if not pauses or not self.first_bead:
            return None
        *before, first = (bead.layer for bead in self.toolpath.beads[: self.first_bead + 1])
        return None if first in before else pauses.get(first)

    @property
    def commanded(self) -> Array:
        """Speed (k,) [m/s] at which each bead of the toolpath is to be laid."""
        return np.array([bead.commanded(self.problem.process.speed) for bead in self.toolpath.beads])

    @property
    def layers(self) -> int:
        """Number of layers that are laid."""
        toolpath = self.toolpath
        return toolpath.layers_from(self.first_bead) if self.first_bead else toolpath.layers

    @property
    def name(self) -> str:
        """The problem's name, with the bead that the print begins with if that is not the first."""
        return resumed_name(self.problem.name, self.first_bead)

    @property
    def holds_as_planned(self) -> bool:
        """True if every check of the verifier holds at the part's planned place."""
        return all(check.ok for check in self.checks)

    @property
    def verified(self) -> bool:
        """True if every check of the verifier holds, also within the tolerance if one was requested."""
        return self.holds_as_planned and (self.headroom is None or self.headroom.holds)

    @property
    def from_python(self) -> tuple[str, ...]:
        """Inputs that only Python can give, in words: waypoints from arrays, a user's own strategy and terms."""
        arrays = ["waypoints from arrays"] if self.problem.from_arrays else []
        own = [] if self.strategy in STRATEGY_NAMES else [f"strategy {self.strategy}"]
        return (*arrays, *own, *(f"term {name}" for name in self.settings.get("terms", ())))

    @property
    def as_counted(self) -> Plan:
        """The same motion, joints and frames of the arm as controllers count them: see `Cell.as_counted`."""
        return self._counted or self

    @cached_property
    def _counted(self) -> Plan | None:
        cell = self.cell.as_counted
        if cell is self.cell:
            return None
        return replace(self, cell=cell, trajectory=replace(self.trajectory, q=self.cell.counted(self.trajectory.q)))

    @property
    def moving_only(self) -> Plan:
        """The same plan for a controller without the external axes that stand still: see `Cell.station`."""
        return self if self.cell.station is None or len(self.cell.holder) else self._moving_only

    @cached_property
    def _moving_only(self) -> Plan:
        return replace(self, cell=replace(self.cell, moving_only=True))

    @property
    def t(self) -> Array:
        """Time (n,) of the samples, from 0 [s]."""
        return self.trajectory.t

    @property
    def q(self) -> Array:
        """Joints (n, nj) in the order of `joint_names` [rad; m for sliding joints]."""
        return self.trajectory.q

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names (nj) of the joints: the arm's, then those of the part's holder."""
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
        """Speed (n,) of the tip relative to the part [m/s]."""
        return self.trajectory.speed

    @property
    def bead(self) -> NDArray[np.int32]:
        """Index (n,) of the bead; -1 in travel."""
        return self.trajectory.bead

    @property
    def deposit(self) -> NDArray[np.bool_]:
        """Whether (n,) material flows."""
        return self.trajectory.deposit

    @property
    def s(self) -> Array:
        """Arc length (n,) along the bead [m]; 0 in travel."""
        return self.trajectory.s

    def table(self) -> NDArray[np.void]:
        """All samples as a structured array (n,), with the columns of trajectory.csv, not rounded.

        `plan.table()["x_mm"]` is a column.

        Returns:
            The columns t_s; bead, -1 in travel; layer; deposit; s_mm; x_mm, y_mm, z_mm of the nozzle tip and its unit
                axis ax, ay, az, both in the part frame; speed_mm_s; flow_mm3_s; e_mm of filament; then the joints by
                their names, in rad, or m for sliding joints.
        """
        return table_of(self.trajectory, self.joint_names)

    def to_pandas(self) -> pandas.DataFrame:
        """The columns of `table` as a data frame; its `attrs` name problem, strategy and verdict.

        Raises:
            InputError: If pandas is missing, which the extra `tables` installs.
        """
        return data_frame(self)

    def to_xarray(self) -> xarray.Dataset:
        """The columns of `table` along `t_s`, and all joints as `q` along `t_s` and `joint`, with their ranges.

        Raises:
            InputError: If xarray is missing, which the extra `tables` installs.
        """
        return data_set(self)

    def show(self, height: int = 640) -> InlineScene:
        """The print in 3-D, animated, below a notebook cell.

        Elsewhere `plan.show().save("scene.html")` writes the page.

        Args:
            height: Height of the frame around it [px], 200 to 4000.

        Raises:
            InputError: If the height is invalid.
        """
        from planner import show  # by the public name: what draws plans is imported only when one is drawn

        return show(self, height)

    def summary(self) -> str:
        """A few lines of text: the verdict and the most important metrics."""
        return plan_words(self)

    def __repr__(self) -> str:
        return f"<Plan {plan_line(self)}>"

    def _repr_html_(self) -> str:
        return plan_html(self)


# What a loaded plan must have, by field name: types of the fields, and of their items.
KINDS: dict[str, type | tuple[type, ...]] = {
    **dict.fromkeys(("strategy", "resolved_by"), str),
    **dict.fromkeys(("metrics", "series", "timing_s", "versions", "baseline", "settings", "seal"), dict),
    **dict.fromkeys(("checks", "dips", "advice", "approaches", "paths", "roll_maps"), tuple),
    "problem": Problem,
    "toolpath": Toolpath,
    "trajectory": Trajectory,
    "headroom": (Robustness, type(None)),
    "view": (CellView, type(None)),
    "nearer": (Nearer, type(None)),
    "asked": (Trajectory, type(None)),
}
ITEMS: dict[str, type] = {"checks": Check, "dips": Dip, "advice": Advice, "approaches": Approach}


def _refuse_wrong(wrong: Sequence[str], path: str | Path) -> None:
    """Raise InputError for a file if any of its fields do not fit a plan."""
    if wrong:
        raise InputError(f"{', '.join(wrong)}: not what a plan has", file=path, hint="plan it again")


def columns_of(trajectory: Trajectory, rows: slice = EVERY_ROW) -> dict[str, NDArray[Any]]:
    """All columns (n) by name, except the joints, of some rows: mm, mm/s, mm^3/s; `e_mm` is filament."""
    t = trajectory
    return {
        "t_s": t.t[rows],
        "bead": t.bead[rows],
        "layer": t.layer[rows],
        "deposit": t.deposit[rows],
        "s_mm": t.s[rows] * 1e3,
        **dict(zip(("x_mm", "y_mm", "z_mm"), t.tip[rows].T * 1e3, strict=True)),
        **dict(zip(("ax", "ay", "az"), t.axis[rows].T, strict=True)),
        "speed_mm_s": t.speed[rows] * 1e3,
        "flow_mm3_s": t.flow[rows] * 1e9,
        "e_mm": t.feed[rows] * 1e3,
    }


def table_of(trajectory: Trajectory, joint_names: Sequence[str]) -> NDArray[np.void]:
    """A structured array (n) of all columns and then the joints [rad, m where they slide]."""
    columns = columns_of(trajectory) | dict(zip(joint_names, trajectory.q.T, strict=True))
    table = np.empty(len(trajectory), dtype=[(name, column.dtype) for name, column in columns.items()])
    for name, column in columns.items():
        table[name] = column
    return table


@dataclass(frozen=True)
class Material:
    """A material: name, number of its tool in G-code, digital output of its extruder in RAPID, temperature [°C]."""

    name: str
    tool: int
    signal: str
    nozzle_c: float | None


@dataclass(frozen=True)
class Used:
    """How much of a material a print uses: beads and their length [m], volume laid down [m^3], filament fed [m]."""

    material: Material
    beads: int
    length: float
    volume: float
    filament: float


def materials_of(problem: Problem) -> tuple[Material, ...]:
    """All named materials, in the problem's order."""
    process = problem.process
    return tuple(
        Material(name, process.tool(name), signal, process.nozzle_c(name)) for name, signal in signals(problem).items()
    )


def selected(materials: Sequence[str], events: Sequence[Event], t: Array) -> NDArray[np.intp]:
    """Index of the material whose tool is selected at instants t (n), by the events; NONE before the first."""
    chosen = sorted((event for event in events if event.kind in SELECTS), key=lambda event: event.start)
    which = [materials.index(event.material) if event.material in materials else NONE for event in chosen]
    return np.array([NONE, *which])[np.searchsorted([event.start for event in chosen], t, side="right")]


def by_nozzle(cell: Cell, events: Sequence[Event], t: Array) -> tuple[tuple[Cell, slice], ...]:
    """Split the instants t (n) into stretches with one nozzle in use, that of the selected material.

    For each stretch: the cell with that nozzle, and its samples.
    """
    if not cell.nozzles:
        return ((cell, slice(0, len(t))),)
    names = list(cell.nozzle_of)
    which = selected(names, events, t)
    known = which[which != NONE]
    which[which == NONE] = known[0] if len(known) else 0  # the first nozzle is there before its material is selected
    nozzle = np.array(list(cell.nozzle_of.values()))[which]
    bounds = [0, *(np.flatnonzero(np.diff(nozzle)) + 1).tolist(), len(t)]
    return tuple((cell.with_nozzle(int(nozzle[a])), slice(a, b)) for a, b in itertools.pairwise(bounds))


def filament_areas(problem: Problem, events: Sequence[Event], t: Array) -> Array | float:
    """Cross-section [m^2] of the filament that is fed: a single one, or (n) for the tool selected at instants t (n)."""
    process = problem.process
    if not process.materials:
        return float(np.pi * (0.5 * process.filament_diameter) ** 2)
    names = list(process.materials)
    areas = [np.pi * (0.5 * process.of(name).filament_diameter) ** 2 for name in names]
    return np.array([*areas, 0.0])[selected(names, events, t)]  # the last one for NONE: nothing comes out


def used(plan: Plan) -> tuple[Used, ...]:
    """How much of each named material the print uses; material laid counts towards the selected tool."""
    t, process, found = plan.trajectory, plan.problem.process, []
    materials = materials_of(plan.problem)
    own = selected([material.name for material in materials], t.events, t.t)
    laid = np.diff(t.extruded, prepend=0.0)
    for k, material in enumerate(materials):
        beads = [bead for bead in plan.beads if bead.material == material.name]
        volume = float(laid[own == k].sum())
        moved = sum(event.amount for event in t.events if event.material == material.name)
        filament = volume / (0.25 * np.pi * process.of(material.name).filament_diameter ** 2) + moved
        found.append(Used(material, len(beads), sum(bead.length for bead in beads), volume, filament))
    return tuple(found)


def plan_line(plan: Plan) -> str:
    """Name, strategy and verdict."""
    verdict = "verified" if plan.verified else "not verified"
    return f"{plan.name} by {plan.strategy}: {verdict}, {plan.t[-1]:.1f} s, {len(plan.beads)} beads"


def plan_words(plan: Plan) -> str:
    """The plan's line, a line for each metric that it has, and one for each check that fails."""
    rows = [f"{value:>12}  {label}" for value, label in _rows(plan)]
    return "\n".join([plan_line(plan), *rows, *(f"FAILED {text}" for text in _failed(plan))])


def plan_html(plan: Plan) -> str:
    """The same as a table."""
    rows = "".join(f"<tr><td>{escape(value)}</td><td>{escape(label)}</td></tr>" for value, label in _rows(plan))
    failed = "".join(f"<tr><td>FAILED</td><td>{escape(text)}</td></tr>" for text in _failed(plan))
    return f"<table><caption>{escape(plan_line(plan))}</caption><tbody>{rows}{failed}</tbody></table>"


def _rows(plan: Plan) -> list[tuple[str, str]]:
    """Value with unit, and label, of each metric of ROWS that the plan has."""
    return [
        (f"{plan.metrics[key] * factor:.{decimals}f} {unit}".strip(), label)
        for key, (label, unit, factor, decimals) in ROWS.items()
        if key in plan.metrics
    ]


def _failed(plan: Plan) -> list[str]:
    """A line for each check that fails."""
    return [check.words for check in plan.checks if not check.ok]
