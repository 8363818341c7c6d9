"""Beads from a slicer's G-code: level layers on a bed, the nozzle upright."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from planner.base.arrays import Array
from planner.base.errors import InputError
from planner.base.geometry import arc_lengths
from planner.problem import Problem
from planner.problem.layers import GcodeLayersSpec
from planner.problem.process import SectionName
from planner.toolpath.bead import Bead, Toolpath
from planner.toolpath.gcode.reader import GcodeFile, Thread, read_gcode
from planner.toolpath.plane_paths import PlaneCurve, densify, length, make_bead, round_corners
from planner.toolpath.svg.outlines import PlanePath

SAME_LEVEL = 5e-6  # m: z of one layer differs by less, however it is rounded
SIZES = (1e-5, 50e-3)  # m: widths and heights of beads that can be meant
_SHRUNK = 0.8  # of its length that a path keeps when it is rounded: else it is rounded less
_FEWER = 0.5  # times the tolerance then
_TRIES = 8


@dataclass(frozen=True)
class Layer:
    """What a level layer covers, from its top [m] down: discs around the samples of its beads.

    tree of their centres in the plane; radii (n), half the beads' widths [m]
    """

    top: float
    tree: cKDTree
    radii: Array


@dataclass(frozen=True)
class LevelLayers:
    """The bed, the part frame's xy plane, and layers on it, solid down to the bed; lengths in metres, part frame.

    layers   from the lowest on
    levels   the layer of each bead, in print order
    solid    how many layers are there
    """

    layers: tuple[Layer, ...]
    levels: tuple[int, ...]
    solid: int = 0

    @classmethod
    def of(cls, beads: Sequence[Bead]) -> LevelLayers:
        """The layers that beads make; each bead is as high as its layer."""
        layers = []
        for level in range(max(bead.layer for bead in beads) + 1):
            own = [bead for bead in beads if bead.layer == level]
            centres = np.vstack([bead.points[:, :2] for bead in own])
            radii = np.concatenate([0.5 * bead.width for bead in own])
            layers.append(Layer(float(own[0].points[0, 2]), cKDTree(centres), radii))
        return cls(tuple(layers), tuple(bead.layer for bead in beads))

    def before(self, bead: int) -> LevelLayers:
        """The surface when the first `bead` beads have been printed: without the layer of the last of them."""
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


@dataclass(frozen=True)
class _Step:
    """A thread with its layer, counted from 0, and its height [m]."""

    thread: Thread
    layer: int
    height: float


def slicer_print(problem: Problem, spec: GcodeLayersSpec) -> Toolpath:
    """Lay a bead along whatever the file extrudes without interruption, in its order.

    A bead is as high as its layer and has the volume that the file extrudes. Pieces shorter than the width in the
    problem are left out. Raises InputError for a file that cannot be read, and for layers that do not rise.
    """
    process, file = problem.process, spec.source.gcode
    read = read_gcode(file, process.chord_tolerance, partial(problem.error, "layers.source.gcode"))
    long = [thread for thread in read.threads if length(thread.points) >= process.bead.width]
    if not long:
        reason = f"all that {file.name} extrudes is shorter than a bead is wide"
        raise problem.error("process.bead.width_mm", reason, "shorter pieces are specks, which are left out")
    origin = np.asarray(spec.source.origin)
    diameter = spec.source.filament_diameter or process.filament_diameter
    if long[0].z + origin[2] <= 0.0:
        raise problem.error(
            "layers.source.origin_mm",
            f"the first layer is {(long[0].z + origin[2]) * 1e3:.3f} mm above the bed",
            "the part frame's xy plane is the bed: z = 0 in most files",
        )
    beads = []
    for number, step in enumerate(_layers(long, file), 1):
        name = f"path {number}" + (f" ({step.thread.kind})" if step.thread.kind else "")
        curve, sizes = _laid(step, process.corner_tolerance, 0.25 * np.pi * diameter**2, process.section, file, name)
        beads.append(_bead(step, curve, sizes, origin))
    return Toolpath(tuple(beads), LevelLayers.of(beads), notes=tuple(_notes(file, read, long, beads)))


def _notes(file: Path, read: GcodeFile, long: Sequence[Thread], beads: Sequence[Bead]) -> Iterator[str]:
    """What was left out, and what the file says that the problem says otherwise."""
    if read.before:
        moves = "1 move that extrudes" if read.before == 1 else f"{read.before} moves that extrude"
        yield f"{file.name}: {moves} before the first layer left out"
    specks = len(read.threads) - len(long)
    if specks:
        lost = 1.0 - sum(t.filament.sum() for t in long) / sum(t.filament.sum() for t in read.threads)
        pieces = "1 piece" if specks == 1 else f"{specks} pieces"
        yield f"{file.name}: {pieces} shorter than a bead is wide left out, {lost:.2%} of the material"
    width, height = (
        np.array([[size.min(), size.max()] for size in (getattr(bead, name) for bead in beads)]) * 1e3
        for name in ("width", "height")
    )
    yield (
        f"{file.name}: beads are {_range(width.min(), width.max(), 3)} mm wide and "
        f"{_range(height.min(), height.max(), 3)} mm high, as what it extrudes says"
    )
    if read.speeds:
        slow, fast = (1e3 * speed for speed in read.speeds)
        yield f"{file.name}: its own speeds, {_range(slow, fast, 0)} mm/s, do not count; process.speed_mm_s does"


def _range(least: float, greatest: float, digits: int) -> str:
    """Both values, or one where they read alike."""
    texts = [f"{value:.{digits}f}" for value in (least, greatest)]
    return " to ".join(dict.fromkeys(texts))


def _layers(threads: Sequence[Thread], file: Path) -> Iterator[_Step]:
    """The threads with their layers and heights, that of a comment or the rise over the layer before."""
    layer, top, below = -1, -np.inf, 0.0
    for thread in threads:
        wrong = partial(InputError, file=file, line=int(thread.lines[0]))
        if thread.z < top - SAME_LEVEL:
            raise wrong(
                f"z goes down from {top * 1e3:.3f} to {thread.z * 1e3:.3f} mm",
                hint="layers rise: print all objects at once, not one after another",
            )
        if thread.z > top + SAME_LEVEL:
            layer, top, below = layer + 1, thread.z, max(top, 0.0) if layer >= 0 else 0.0
        height = top - below if thread.height is None else thread.height
        if not SIZES[0] <= height <= SIZES[1]:
            raise wrong(f"this layer is {height * 1e3:.3f} mm high", hint="z = 0 is the bed, and each layer rises")
        yield _Step(thread, layer, height)


def _laid(
    step: _Step, tolerance: float, filament: float, section: SectionName, file: Path, name: str
) -> tuple[PlaneCurve, tuple[Array, Array]]:
    """A thread rounded, and width and height (n) [m] at its samples, so that these hold its volume.

    filament: area of its cross-section [m^2]. Short pieces are rounded less, so that they do not shrink.
    """
    path = PlanePath(name, step.thread.points, False)
    curve = round_corners(path, tolerance)
    for _ in range(_TRIES):
        if length(curve.points) >= _SHRUNK * length(path.points):
            break
        tolerance *= _FEWER
        curve = round_corners(path, tolerance)
    arc = arc_lengths(path.points)
    volume = filament * np.concatenate([[0.0], np.cumsum(step.thread.filament)])
    # samples stand evenly on the input: each has the mean of the half step before it and the one behind it
    n = len(curve.points)
    edges = np.interp(np.arange(2 * n + 1) - 1.0, [0.0, 2.0 * n - 2.0], [0.0, arc[-1]])
    held = np.interp(edges, arc, volume)
    area = (held[2::2] - held[:-1:2]) / (edges[2::2] - edges[:-1:2])
    width, height = _section(area, step.height, section)
    bad = ~((width >= SIZES[0]) & (width <= SIZES[1]))
    if bad.any():
        i = int(np.argmax(bad))
        k = min(int(np.searchsorted(arc, edges[2 * i + 1], side="right")) - 1, len(step.thread.lines) - 1)
        raise InputError(
            f"extrudes for a bead {width[i] * 1e3:.3f} mm wide at a height of {height[i] * 1e3:.3f} mm",
            file=file,
            line=int(step.thread.lines[k]),
            hint="check M82 or M83, and layers.source.filament_diameter_mm",
        )
    return curve, (width, height)


def _section(area: Array, height: float, section: SectionName) -> tuple[Array, Array]:
    """Width and height (n) [m] of beads of cross-sections (n) [m^2] in a layer of a height [m].

    A rounded bead of less than a whole round is a thread thinner than the layer, as over a bridge.
    """
    if section != "rounded":
        return area / height, np.full(len(area), height)
    width = area / height + (1.0 - 0.25 * np.pi) * height
    thread = np.sqrt(4.0 / np.pi * area)
    thin = thread < height
    return np.where(thin, thread, width), np.where(thin, thread, height)


def _bead(step: _Step, curve: PlaneCurve, sizes: tuple[Array, Array], origin: Array) -> Bead:
    n, up = len(curve.points), step.thread.z
    points, source = (
        np.column_stack([plane, np.full(len(plane), up)]) + origin for plane in (curve.points, densify(curve.source))
    )
    upright, roll_zero = np.tile([0.0, 0.0, 1.0], (n, 1)), np.tile([1.0, 0.0, 0.0], (n, 1))
    return make_bead(curve.name, step.layer, points, upright, roll_zero, source, *sizes)
