"""Beads from a slicer's G-code: level layers on a bed, the nozzle upright."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from planner.base.arrays import Array
from planner.base.errors import InputError, nearest_name
from planner.base.geometry import arc_lengths
from planner.problem import Problem
from planner.problem.layers import GcodeLayersSpec
from planner.problem.process import SectionName
from planner.toolpath.bead import Bead, Told, Toolpath
from planner.toolpath.gcode.reader import GcodeFile, read_gcode
from planner.toolpath.gcode.threads import SIZES, ChosenThreads, PrintedThread, choose, diameter_of
from planner.toolpath.plane_paths import SAMPLES_PER_TOLERANCE, PlaneCurve, densify, length, make_bead, round_corners
from planner.toolpath.svg.outlines import PlanePath
from planner.toolpath.workload import check_threads, longest

VOLUMETRIC = 1e-6  # m^2: cross-section of a filament of which 1 mm holds 1 mm^3
_SHRUNK = 0.8  # share of its length that a rounded path must keep: otherwise it is rounded less
_FEWER = 0.5  # factor on the tolerance for each further try
_TRIES = 8
_FADING = 0.05  # greatest share of a thread that may be thinner than any bead


@dataclass(frozen=True)
class Layer:
    """The space that a level layer covers, from its top [m] down: discs around the samples of its beads.

    tree of their centres in the plane; radii (n), half the beads' widths [m]
    """

    top: float
    tree: cKDTree
    radii: Array


@dataclass(frozen=True)
class LevelLayers:
    """The bed, the part frame's xy plane, and layers on it, solid down to the bed; lengths in metres, part frame.

    layers   lowest first
    levels   the layer of each bead, in print order
    solid    how many layers are already there
    """

    layers: tuple[Layer, ...]
    levels: tuple[int, ...]
    solid: int = 0

    @classmethod
    def of(cls, beads: Sequence[Bead]) -> LevelLayers:
        """The layers that beads make; each bead is as high as its layer."""
        by_level: dict[int, list[Bead]] = defaultdict(list)
        for bead in beads:
            by_level[bead.layer].append(bead)
        layers = []
        for _, own in sorted(by_level.items()):
            centres = np.vstack([bead.points[:, :2] for bead in own])
            radii = np.concatenate([0.5 * bead.width for bead in own])
            layers.append(Layer(max(float(bead.points[-1, 2]) for bead in own), cKDTree(centres), radii))
        return cls(tuple(layers), tuple(bead.layer for bead in beads))

    def before(self, bead: int) -> LevelLayers:
        """The surface after the first `bead` beads, without the layer of the last of them."""
        return replace(self, solid=self.levels[bead - 1] if bead > 0 else 0)

    def signed_distance(self, points: Array) -> Array:
        """Distance (n,) of points (n, 3) from bed and layers; negative inside."""
        best = points[:, 2].copy()
        for layer in reversed(self.layers[: self.solid]):
            above = points[:, 2] - layer.top
            near = np.flatnonzero(above < best)
            if len(near) == 0:
                break  # the layers beneath are farther still
            away, k = layer.tree.query(points[near, :2])
            beyond, above = away - layer.radii[k], above[near]
            outside = np.hypot(np.maximum(beyond, 0.0), np.maximum(above, 0.0))
            distance = outside + np.minimum(np.maximum(beyond, above), 0.0)
            best[near] = np.minimum(best[near], distance)
        return np.asarray(best)

    def normals(self, points: Array) -> Array:
        """Straight up (n, 3), wherever the points are."""
        return np.tile([0.0, 0.0, 1.0], (len(points), 1))

    def normals_on(self, bead: int, s: Array, tips: Array) -> Array:
        """Straight up (n, 3), on every bead."""
        return self.normals(tips)


def slicer_print(problem: Problem, spec: GcodeLayersSpec) -> Toolpath:
    """Lay a bead along each uninterrupted extrusion of the file, in its order.

    A bead is as high as its layer and has the volume that the file extrudes; the notes list what is left out.
    Raises InputError for a file that cannot be read, or that cannot be printed as level layers.
    """
    process, source = problem.process, spec.source
    most = longest(problem) if spec.count is None else np.inf
    read = read_gcode(source.gcode, process.chord_tolerance, partial(problem.error, "layers.source.gcode"), most)
    chosen = choose(problem, spec, read)
    origin = np.asarray(source.origin)
    check_threads(problem, [step.thread.length for step in chosen.steps], [step.layer for step in chosen.steps])
    check_sizes(problem, spec, read, chosen)  # of all layers, before any is laid
    filament = _filaments(problem, spec, read)
    file, materials = source.gcode, _materials(problem, spec, chosen.steps)
    beads = []
    for number, step in enumerate(chosen.steps, 1):
        name = f"path {number}" + (f" ({step.thread.kind})" if step.thread.kind else "")
        curve, sizes = _laid(step, process.corner_tolerance, filament[step.thread.tool], process.section, file, name)
        beads.append(_bead(step, curve, sizes, origin, materials[step.thread.tool]))
    notes = (*chosen.notes, *_sizes_and_speeds(file, read, beads))
    return Toolpath(tuple(beads), LevelLayers.of(beads), notes=notes, told=Told(chosen.left_out))


def check_sizes(problem: Problem, spec: GcodeLayersSpec, read: GcodeFile, chosen: ChosenThreads) -> None:
    """Raise InputError, as `slicer_print` does, for a thread whose extrusion implies an implausible bead."""
    process, filament = problem.process, _filaments(problem, spec, read)
    for step in (*chosen.steps, *chosen.above):
        samples = max(int(step.thread.length / process.corner_tolerance * SAMPLES_PER_TOLERANCE), 8) + 1
        sizes_of(step, filament[step.thread.tool], process.section, spec.source.gcode, samples)


def _filaments(problem: Problem, spec: GcodeLayersSpec, read: GcodeFile) -> dict[int, float]:
    """Cross-section of the filament that E counts [m^2], by tool."""
    tools = {thread.tool for thread in read.threads}
    if read.volume:
        return dict.fromkeys(tools, VOLUMETRIC)
    return {tool: 0.25 * float(np.pi) * diameter_of(tool, problem, spec, read) ** 2 for tool in tools}


def _materials(problem: Problem, spec: GcodeLayersSpec, steps: Sequence[PrintedThread]) -> dict[int, str]:
    """The material of each tool that prints, by tool number; empty where the problem does not say."""
    names = spec.source.tools
    materials = {step.thread.tool: "" for step in steps}
    if names is None:
        return materials
    for tool in materials:
        if tool >= len(names):
            reason = f"tool {tool} of {spec.source.gcode.name} has no material"
            raise problem.error("layers.source.tool_materials", reason, "one for each tool, that of tool 0 first")
        if names[tool] not in problem.process.materials:
            near = nearest_name(names[tool], tuple(problem.process.materials))
            hint = f"did you mean {near}?" if near else "a name in process.materials"
            raise problem.error("layers.source.tool_materials", f"there is no material {names[tool]!r}", hint)
        materials[tool] = names[tool]
    return materials


def _sizes_and_speeds(file: Path, read: GcodeFile, beads: Sequence[Bead]) -> Iterator[str]:
    """Notes on bead sizes, which the file determines, and on its speeds, which the problem overrides."""
    width, height = (
        np.array([[size.min(), size.max()] for size in (getattr(bead, name) for bead in beads)]) * 1e3
        for name in ("width", "height")
    )
    yield (
        f"{file.name}: beads are {_range(width.min(), width.max(), 3)} mm wide and "
        f"{_range(height.min(), height.max(), 3)} mm high, judging by what it extrudes"
    )
    if read.speeds:
        slow, fast = (1e3 * speed for speed in read.speeds)
        yield f"{file.name}: its own speeds, {_range(slow, fast, 0)} mm/s, are ignored; process.speed_mm_s is used"


def _range(least: float, greatest: float, digits: int) -> str:
    """Both values as text, or one if they look the same."""
    texts = [f"{value:.{digits}f}" for value in (least, greatest)]
    return " to ".join(dict.fromkeys(texts))


def _laid(
    step: PrintedThread, tolerance: float, filament: float, section: SectionName, file: Path, name: str
) -> tuple[PlaneCurve, tuple[Array, Array]]:
    """A thread with rounded corners, and the width and height (n) [m] at its samples that preserve its volume.

    filament: area of its cross-section [m^2]. Short pieces are rounded less, so that they do not shrink.
    """
    path = PlanePath(name, step.thread.points[:, :2], False)
    curve = round_corners(path, tolerance)
    for _ in range(_TRIES):
        if length(curve.points) >= _SHRUNK * length(path.points):
            break
        tolerance *= _FEWER
        curve = round_corners(path, tolerance)
    return curve, sizes_of(step, filament, section, file, len(curve.points))


def sizes_of(
    step: PrintedThread, filament: float, section: SectionName, file: Path, samples: int
) -> tuple[Array, Array]:
    """Width and height (n) [m] of a thread's bead at n = `samples` evenly spaced places, preserving its volume.

    filament: area of its cross-section [m^2]. A scarf's end, where the flow fades away, keeps the least width. Raises
    InputError, with file and line, for an implausible bead.
    """
    thread = step.thread
    arc = arc_lengths(thread.points)
    volume = filament * np.concatenate([[0.0], np.cumsum(thread.filament)])
    # samples are evenly spaced on the input: each takes the mean over half a step before and after it
    n = samples
    edges = np.interp(np.arange(2 * n + 1) - 1.0, [0.0, 2.0 * n - 2.0], [0.0, arc[-1]])
    held = np.interp(edges, arc, volume)
    area = (held[2::2] - held[:-1:2]) / (edges[2::2] - edges[:-1:2])
    width, height = _section(area, step.height, section)
    thin, bad = width < SIZES[0], width > SIZES[1]
    if thin.mean() > _FADING:
        bad |= thin
    if bad.any():
        i = int(np.argmax(bad))
        k = min(int(np.searchsorted(arc, edges[2 * i + 1], side="right")) - 1, len(thread.lines) - 1)
        raise InputError(
            f"extrudes for a bead {width[i] * 1e3:.3f} mm wide at a height of {height[i] * 1e3:.3f} mm",
            file=file,
            line=int(thread.lines[k]),
            hint="check M82 or M83, and layers.source.filament_diameter_mm",
        )
    return np.maximum(width, SIZES[0]), np.maximum(height, SIZES[0])


def _section(area: Array, height: float, section: SectionName) -> tuple[Array, Array]:
    """Width and height (n) [m] of beads with cross-sections `area` (n) [m^2] in a layer of a given height [m].

    A rounded bead with less than the area of a circle as high as the layer is a round thread, as on a bridge.
    """
    if section != "rounded":
        return area / height, np.full(len(area), height)
    width = area / height + (1.0 - 0.25 * np.pi) * height
    thread = np.sqrt(4.0 / np.pi * area)
    thin = thread < height
    return np.where(thin, thread, width), np.where(thin, thread, height)


def _bead(step: PrintedThread, curve: PlaneCurve, sizes: tuple[Array, Array], origin: Array, material: str) -> Bead:
    thread, n = step.thread, len(curve.points)
    way = arc_lengths(thread.points[:, :2])  # z rises along it, and the samples divide it evenly
    source = densify(curve.source)
    points, dense = (
        np.column_stack([plane, np.interp(at, way, thread.points[:, 2])]) + origin
        for plane, at in ((curve.points, np.linspace(0.0, way[-1], n)), (source, arc_lengths(source)))
    )
    upright, roll_zero = np.tile([0.0, 0.0, 1.0], (n, 1)), np.tile([1.0, 0.0, 0.0], (n, 1))
    return make_bead(curve.name, step.layer, points, upright, roll_zero, dense, *sizes, material=material)
