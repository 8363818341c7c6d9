"""From a problem and its contacts to the placement of the part, or to the fault of the contacts."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from planner.base.arrays import Array, Flags
from planner.base.errors import InputError, nearest_name
from planner.cell.cell import Cell, build_cell
from planner.problem import Problem
from planner.register.contacts import (
    Contacts,
    Readings,
    Turntable,
    axis_of,
    contacts_of,
    locate,
    other_units,
    plate_poses,
    read_readings,
    settled,
)
from planner.register.fitting import (
    FREEDOMS,
    BeadWaypoints,
    Fit,
    Placement,
    Touch,
    Uncertainty,
    Unknowns,
    fit,
    looked_for,
    split,
    table_ways,
    uncertainty_of,
    waypoints_of,
    words,
)
from planner.register.places import (
    Clearance,
    Tangents,
    TouchPlaces,
    most_telling,
    next_place,
    reachable,
    surface_places,
)
from planner.toolpath.bead import Surface, Toolpath
from planner.toolpath.build import build_toolpath

MISFIT = 1e-3  # m: contacts that agree no better are of another part, or in other units
FAR_OFF = 0.3  # m: no part is placed this far from its place in the problem
_MUCH_BETTER = 0.1  # × the misfit: the file is in a unit that brings it down to this


@dataclass(frozen=True)
class Ask:
    """A request: freedoms of the part to be found (None: those that suit it), whether to find the table's axis and the
    size; radius of the probe's ball and standard deviation of a touch, if known [m]."""

    free: tuple[str, ...] | None = None
    table: bool = False
    size: bool = False
    ball: float = 0.0
    noise: float | None = None


@dataclass(frozen=True)
class Scene:
    """A problem with what registration needs of it: its cell, beads, bare surface, and where the part should be.

    points, normals (n, 3) on the surface, where it may be touched;  tangents there, a rough stand-in for the surface
    nozzle  the one of several that touches; empty if not specified: the cell then has the first one
    """

    problem: Problem
    cell: Cell
    toolpath: Toolpath
    surface: Surface
    start: Placement
    waypoints: BeadWaypoints
    points: Array
    normals: Array
    tangents: Tangents
    nozzle: str = ""

    @property
    def home_plates(self) -> Array:
        """Poses (k, 4, 4) of the part's plate with the holder at home, and turned all the way around if it can turn."""
        limits = self.cell.limits
        home = self.cell.home[len(self.cell.arm) :]
        turns = len(home) > 0 and bool(limits.turns[-1])
        q = np.tile(home, (12 if turns else 1, 1))
        if turns:
            q[:, -1] = np.clip(home[-1] + np.linspace(-np.pi, np.pi, len(q)), limits.q_min[-1], limits.q_max[-1])
        return plate_poses(self.cell, q)


@dataclass(frozen=True)
class Registration:
    """The result from contacts.

    held      freedoms that the contacts do not observe and the nozzle's height does not depend on, in words
    turntable the table as published, if it can be found from these contacts
    """

    scene: Scene
    ask: Ask
    fit: Fit
    held: tuple[str, ...]
    uncertainty: Uncertainty
    turntable: Turntable | None


def scene_of(problem: Problem, nozzle: str = "") -> Scene:
    """The scene of a problem; nozzle: which of several touches. Raises InputError for whatever is wrong with it."""
    cell = build_cell(problem)
    names = [each.name for each in cell.nozzles]
    if nozzle and nozzle not in names:
        near = nearest_name(nozzle, names)
        hint = f"did you mean {near}?" if near else f"nozzles: {', '.join(names)}" if names else "leave it out"
        raise InputError(f"there is no nozzle {nozzle!r}", field="--nozzle", hint=hint)
    if nozzle:
        cell = cell.with_nozzle(names.index(nozzle))
    toolpath = build_toolpath(problem)
    if any(bead.round for bead in toolpath.beads):
        raise problem.error(
            "layers.source.kind",
            "struts in space do not lie on a surface that could be touched",
            "touch whatever stands there instead",
        )
    surface = toolpath.surface.before(0)
    T = cell.T_world_holder if cell.holder_robot is None else cell.T_plate_part
    points, normals = surface_places(toolpath, surface)
    return Scene(
        problem,
        cell,
        toolpath,
        surface,
        Placement(T, np.zeros(3)),
        waypoints_of(toolpath),
        points,
        normals,
        Tangents.of(toolpath, surface, points, normals),
        nozzle,
    )


def freedoms_of(problem: Problem, ask: Ask) -> tuple[str, ...]:
    """The freedoms of the part to be found: by default all, but only x and y for an upright cylinder."""
    if ask.free is not None:
        return ask.free
    return ("x", "y") if problem.part is not None and problem.part.cylinder is not None else FREEDOMS


def unknowns_of(scene: Scene, ask: Ask, T_world_plate: Array) -> Unknowns:
    """The unknowns to be found, with the plate at (n, 4, 4). Raises InputError for any that the problem lacks."""
    part, problem = scene.problem.part, scene.problem
    free = freedoms_of(problem, ask)
    if ask.size and (part is None or (part.cylinder is None and part.sphere is None)):
        raise problem.error("part", "has no radius", "--size is for a cylinder or a sphere")
    ways = np.zeros((3, 0))
    if ask.table:
        if problem.cell.positioner is None or len(scene.cell.holder) == 0:
            raise problem.error("cell", "has no table that turns", "--table is for a positioner with a free axis")
        ways = table_ways(T_world_plate)
    places = scene.points if len(scene.points) else scene.waypoints.points
    if not free and ways.shape[1] == 0 and not ask.size:
        raise InputError("there is nothing to look for", field="--free", hint=f"any of {','.join(FREEDOMS)}")
    return looked_for(free, ways, ask.size, places)


def register(scene: Scene, file: Path, ask: Ask) -> Registration:
    """Find the part from a file of contacts.

    Raises InputError for contacts that cannot be read, that are too few or badly spread for the unknowns, or that are
    of another part.
    """
    readings = _readings(scene, file)
    contacts = contacts_of(scene.cell, readings)
    if ask.table and len(readings.holder) and table_ways(contacts.T_world_plate).shape[1] == 0:
        raise InputError(
            "the table stands at one angle in all contacts, so its axis cannot be found",
            file=file,
            hint="touch at three angles or more, far apart",
        )
    unknowns = unknowns_of(scene, ask, contacts.T_world_plate)
    plates = _plates(scene, ask, contacts)
    _enough(scene, unknowns, contacts, plates)
    touch = Touch(scene.surface, scene.tangents, contacts, unknowns, ask.ball)
    found = fit(touch, scene.start, ask.noise)
    _fits(scene, readings, found, ask)
    return replace(judged(scene, ask, found), turntable=_turntable(scene, contacts, ask.ball))


def _readings(scene: Scene, file: Path) -> Readings:
    """The readings of a file. Raises InputError for joints if it is not known which of several nozzles touched."""
    readings = read_readings(file, scene.cell)
    if readings.joints is not None and scene.cell.nozzles and not scene.nozzle:
        hint = f"give --nozzle, one of {', '.join(each.name for each in scene.cell.nozzles)}"
        raise InputError("joints do not show which of the nozzles touched", file=file, hint=hint)
    return readings


def judged(scene: Scene, ask: Ask, found: Fit) -> Registration:
    """A fit with its free directions and uncertainty. Raises InputError if the nozzle's height is left free."""
    plates = _plates(scene, ask, found.touch.contacts)
    return Registration(
        scene=scene,
        ask=ask,
        fit=found,
        held=tuple(_determined(scene, found, plates)),
        uncertainty=uncertainty_of(found, scene.waypoints, plates, ask.noise),
        turntable=None,
    )


@dataclass(frozen=True)
class Published:
    """A table and the cylinder on it by Pollard et al., eq. (1); the same settled by least squares over the contacts
    that it fits; whether each contact (n) is among these, and the names of all; and the resulting placement."""

    table: Turntable
    settled: Turntable
    right: Flags
    names: tuple[str, ...]
    placement: Placement

    @property
    def off(self) -> float:
        """Eq. (1b)'s mean over the contacts that are right [m]."""
        return float(np.abs(self.table.off[self.right]).sum(axis=1).mean())


def as_published(scene: Scene, file: Path, ball: float = 0.0) -> Published:
    """The table's axis and the cylinder on it by eq. (1) of Pollard et al., settled by least squares.

    Contacts of a nozzle that always comes from one side are enough, at several angles of the table; ball [m]: radius of
    the probe's ball.
    Raises InputError for other parts and tables, and for contacts that do not determine these axes.
    """
    readings = _readings(scene, file)
    contacts = contacts_of(scene.cell, readings)
    part, cell = scene.problem.part, scene.cell
    if part is None or part.cylinder is None:
        raise scene.problem.error(
            "part", "is not a cylinder", "eq. (1) is for a cylinder on a turntable: leave out --published"
        )
    if cell.holder_robot is None or not len(cell.holder):
        raise scene.problem.error("cell", "has no table that turns", "--published is for a positioner with a free axis")
    if contacts.axes is None:
        raise InputError(
            "nothing says from which side the nozzle came",
            file=file,
            hint="columns ax, ay, az: the nozzle's direction in the world",
        )
    table = _turntable(scene, contacts, ball)
    if table is None:
        raise InputError(
            "eq. (1) cannot tell the table's axis from these contacts",
            file=file,
            hint="an upright table at two angles or more, and a nozzle that comes from the side",
        )
    if table.usual > MISFIT:
        raise InputError(
            f"the contacts do not lie on this cylinder: by eq. (1) half of them are {table.usual * 1e3:.1f} mm off and more",
            file=file,
            hint="a nozzle that always comes from one side, straight at the cylinder's axis; lengths in mm in the world",
        )
    found, right = settled(table, contacts.T_world_plate[:, :2, :2])
    axis, aside = axis_of(contacts.T_world_plate)
    T = scene.start.T_plate_part.copy()
    T[:2, 3] = found.cylinder - aside - T[:2, :2] @ np.asarray(part.cylinder.centre)
    shift = np.append(found.axis - axis, 0.0)
    return Published(table, found, right, contacts.names, Placement(T, shift))


def suggest_next(found: Registration) -> tuple[TouchPlaces, int, float] | None:
    """Places, the index of the one to touch next, and the share of the worst error in height that it would leave; None
    if the arm can touch no place along its normal while clear of everything else."""
    scene, fit = found.scene, found.fit
    places = reachable(scene.cell, fit.placement, scene.points, scene.normals)
    contacts, unknowns = fit.touch.contacts, fit.touch.unknowns
    H = scene.waypoints.heights(unknowns, fit.placement, _plates(scene, found.ask, contacts))
    touched = fit.placement.seen(contacts.tips, contacts.T_world_plate)[fit.kept]
    clearance = Clearance.of(scene.problem, scene.cell, scene.surface)
    while len(places):
        k, left = next_place(places, touched, unknowns, fit.placement, fit.columns, H)
        hit = _hit(clearance, fit.placement, places, k)
        if not hit.any():
            return places, k, left
        places = places.only(~hit)
    return None


def _hit(clearance: Clearance, placement: Placement, places: TouchPlaces, k: int) -> NDArray[np.bool_]:
    """Which places are ruled out as something is hit at the k-th: all at its point if it is the part, else itself."""
    poses = clearance.fits(places.points[k], places.normals[k])
    if not poses:
        return np.asarray((places.points == places.points[k]).all(axis=1))
    return (np.arange(len(places)) == k) & (not clearance.at(placement, poses, places.q[k]))


def plan_contacts(scene: Scene, ask: Ask, count: int) -> tuple[TouchPlaces, list[int]]:
    """Where to touch first: places, and the indices of the chosen ones (count, or as many as are far enough from each
    other).

    Raises InputError if the arm can reach none of them while clear of everything else.
    """
    places = reachable(scene.cell, scene.start, scene.points, scene.normals)
    clearance = Clearance.of(scene.problem, scene.cell, scene.surface)
    while len(places):
        unknowns = unknowns_of(scene, ask, places.T_world_plate)
        chosen = most_telling(places, unknowns, scene.start, count)
        hit = np.any([_hit(clearance, scene.start, places, k) for k in set(chosen)], axis=0)
        if not hit.any():
            return places, chosen
        places = places.only(~hit)
    raise InputError("the arm can touch no place of the surface along its normal", file=scene.problem.file)


def _plates(scene: Scene, ask: Ask, contacts: Contacts) -> Array:
    """Poses (k, 4, 4) of the part's plate during the print that matter to the nozzle's height."""
    return scene.home_plates if ask.table else contacts.T_world_plate[:1]


def _enough(scene: Scene, unknowns: Unknowns, contacts: Contacts, plates: Array) -> None:
    """Raise InputError if there are fewer contacts than unknowns that affect the nozzle's height."""
    asked = split(scene.waypoints.heights(unknowns, scene.start, plates))[0].shape[1]
    if len(contacts) < asked:
        raise InputError(
            f"{len(contacts)} contact{'s' if len(contacts) != 1 else ''} cannot fix {asked} freedoms of the part",
            file=contacts.file,
            hint=f"{asked + 3} or more, or fewer freedoms with --free",
        )


def _fits(scene: Scene, readings: Readings, found: Fit, ask: Ask) -> None:
    """Raise InputError if contacts are not on this surface: in which unit they would be, or how far they are off."""
    off = _off(found)
    before = float(np.median(np.abs(found.touch.residuals(scene.start))))
    if off <= MISFIT and before <= FAR_OFF:
        return
    for length, angle in other_units(readings):
        contacts = contacts_of(scene.cell, readings, length, angle)
        other = fit(
            Touch(scene.surface, scene.tangents, contacts, found.touch.unknowns, ask.ball), scene.start, ask.noise
        )
        nearer = float(np.median(np.abs(other.touch.residuals(scene.start))))
        right = _off(other) <= MISFIT and nearer <= FAR_OFF
        if right and (off <= MISFIT or _off(other) <= _MUCH_BETTER * off):
            unit = length if readings.joints is None and length != "mm" else angle
            raise InputError(
                f"the readings seem to be in {unit}: read that way they fit the part to {_off(other) * 1e3:.2f} mm, "
                f"read as they should be only to {off * 1e3:.1f} mm",
                file=readings.file,
                hint="lengths in mm, angles in degrees",
            )
    if off > MISFIT:
        k = int(np.argmax(np.where(found.kept, np.abs(found.residuals), -1.0)))
        raise InputError(
            f"the contacts do not lie on this part: wherever it is, they are {off * 1e3:.1f} mm off",
            file=readings.file,
            line=int(readings.lines[k]),
            hint="this contact is the farthest; is it this problem's part, and its nozzle's tip?",
        )
    raise InputError(
        f"the contacts are {before * 1e3:.0f} mm from where the problem has the part",
        file=readings.file,
        hint="lengths in mm in the world, whose origin is the arm's base unless cell.base_mm says otherwise",
    )


def _off(found: Fit) -> float:
    """Root mean square of the residuals of the kept contacts [m]."""
    return float(np.sqrt((found.residuals[found.kept] ** 2).mean()))


def _determined(scene: Scene, found: Fit, plates: Array) -> list[str]:
    """Freedoms that contacts do not observe, in words; InputError if the nozzle's height depends on one."""
    unknowns = found.touch.unknowns
    hidden = split(found.columns)[1]
    H = scene.waypoints.heights(unknowns, found.placement, plates)
    matters = hidden @ split(H @ hidden)[0]
    if matters.shape[1]:
        free = "; ".join(words(unknowns, matters))
        contacts = found.touch.contacts
        raise InputError(
            f"the contacts do not fix what the nozzle's height depends on: {free}",
            file=contacts.file,
            hint="touch places whose normals point other ways, far apart and not in one line; --suggest names them",
        )
    return words(unknowns, hidden)


def _turntable(scene: Scene, contacts: Contacts, ball: float) -> Turntable | None:
    """The table as published, if the part is a cylinder on an upright table that stood at several angles."""
    part = scene.problem.part
    R = contacts.T_world_plate[:, :3, :3]
    upright = bool((R[:, 2, 2] > math.cos(1e-6)).all())
    if part is None or part.cylinder is None or scene.cell.holder_robot is None or not upright:
        return None
    reach = np.zeros((len(contacts), 2))
    if contacts.axes is not None:
        level = contacts.axes[:, :2]
        length = np.linalg.norm(level, axis=1)[:, None]
        if (length < 0.5).any():
            return None  # the nozzle points down, which does not show from which side it came
        reach = -(part.cylinder.radius + ball) * level / length
    try:
        return locate(contacts.tips[:, :2], R[:, :2, :2], reach)
    except ValueError:
        return None
