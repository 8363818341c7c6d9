"""Chooses which of a slicer's threads to print, sorts them into layers with heights, and notes what is left out."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from planner.base.arrays import Array, Ints
from planner.base.errors import InputError
from planner.problem import Problem
from planner.problem.layers import GcodeLayersSpec
from planner.toolpath.gcode.marks import BRIM, IRONING, PURGE, SKIRT, SUPPORT
from planner.toolpath.gcode.reader import GcodeFile, Thread

SAME_LEVEL = 5e-6  # m: z of one layer differs by less, however it is rounded
SIZES = (1e-5, 50e-3)  # m: plausible widths and heights of beads
STEEPEST = 0.25  # greatest rise / length of a line: a spiral is far below it, and the nozzle stays upright
_ROUNDED = 2e-5  # m that a short step may rise at any slope, because files round z
_PAUSES = frozenset(("M0", "M1", "M25", "M226", "M600", "M601", "PAUSE"))  # stops, and changes of filament
_LOW = 0.7  # × the height of its top above the bed: a thinner first layer hangs in the air
_ODD = 1.5  # factor from the usual height, up or down: a rise beyond it may not be the layer's height
_NAMED = 4  # most commands or lines that a note lists


@dataclass(frozen=True)
class PrintedThread:
    """A thread with its layer, counted from 0, and its height [m]."""

    thread: Thread
    layer: int
    height: float


@dataclass(frozen=True)
class ChosenThreads:
    """The threads to print, in order, those above the requested layers, notes, and the share of length left out."""

    steps: tuple[PrintedThread, ...]
    above: tuple[PrintedThread, ...]
    notes: tuple[str, ...]
    left_out: float


def choose(problem: Problem, spec: GcodeLayersSpec, read: GcodeFile) -> ChosenThreads:
    """Choose the threads to print, and sort them into layers.

    This leaves out the kinds that the problem leaves out, everything above its number of layers, and pieces shorter
    than a bead is wide, up to the share of the length that the problem allows. Where z goes down, as between objects
    printed one after another, the threads are sorted by height. Raises InputError if too much would be left out, or too
    little is left.
    """
    file = spec.source.gcode
    notes = [*_of_file(problem, file, read), *_of_filament(problem, spec, read)]
    kept, told = _without_shares(problem, spec, read)
    notes += told
    kept, told = _levelled(file, kept, read.height)
    notes += told
    kept, told = _by_height(file, kept)
    notes += told
    levels = _levels(kept)
    bottom = float(levels[0]) + spec.source.origin[2]
    if bottom <= 0.0:
        raise problem.error(
            "layers.source.origin_mm",
            f"the first layer is {bottom * 1e3:.3f} mm above the bed",
            "the part frame's xy plane is the bed: z = 0 in most files",
        )
    steps = list(_in_layers(kept, levels, file, read.height))
    steps, told, specks = _without_specks(problem, spec, steps)
    notes += told
    first = steps[0]
    if first.layer == 0 and first.height < _LOW * bottom:
        notes.append(
            f"{file.name}: the first layer is {first.height * 1e3:.3f} mm high and ends {bottom * 1e3:.3f} mm above the bed; "
            "layers.source.origin_mm would lower it"
        )
    layers = steps[-1].layer + 1
    asked = layers if spec.count is None else spec.count
    if asked > layers:
        raise problem.error("layers.count", f"{file.name} has {layers} layers", f"valid: 1 to {layers}")
    if asked < layers:
        notes.append(f"{file.name}: the lowest {asked} of {layers} layers")
    printed, above = (tuple(step for step in steps if (step.layer < asked) == low) for low in (True, False))
    return ChosenThreads(printed, above, tuple(notes), specks)


def _of_file(problem: Problem, file: Path, read: GcodeFile) -> Iterator[str]:
    """Notes on what was skipped as the printer's own code, and on what the file does not state."""
    for count, where in (
        (read.before, "before the first layer"),
        (read.after, "after the last layer"),
        (read.between, "in the printer's own code between layers"),
    ):
        if count:
            yield f"{file.name}: {count} move{'s that extrude' if count > 1 else ' that extrudes'} {where} left out"
    if not read.marked and not read.before:
        yield f"{file.name}: no comment says where a layer begins, so everything extruded is read, from the first move on"
    if read.passed:
        passed = sorted(read.passed, key=lambda each: each[0] not in _PAUSES)  # these first, then the most frequent
        named = ", ".join(f"{name} {count:,}" for name, count in passed[:_NAMED])
        rest = sum(count for _, count in passed[_NAMED:])
        more = f" and {rest:,} of {len(passed) - _NAMED} more kinds" if rest else ""
        yield f"{file.name}: printer commands ignored from the first layer on: {named}{more}"
    if read.guessed:
        yield f"{file.name}: neither M82 nor M83 says how E counts; it is taken from the move before, as its numbers suggest"
    if read.flow != 1.0:
        yield f"{file.name}: M221 sets the printer's flow to {read.flow:.0%}; beads hold what E says"
    if read.counted:
        flows = ", ".join(f"{flow:.0%}" for flow in read.counted)
        yield f"{file.name}: M221 is the slicer's own filament compensation: {flows} of E is laid"
    tools = sorted({thread.tool for thread in read.threads})
    if len(tools) > 1 and not problem.cell.nozzles:
        yield f"{file.name}: tools {', '.join(map(str, tools))} print in turn; here one nozzle lays all of it"


def diameter_of(tool: int, problem: Problem, spec: GcodeLayersSpec, read: GcodeFile) -> float:
    """Filament diameter [m] that a tool's E refers to: from the problem's source, else the file, else the process."""
    if spec.source.filament_diameter is not None:
        return spec.source.filament_diameter
    if not read.filament:
        return problem.process.filament_diameter
    return read.filament[tool if tool < len(read.filament) else 0]


def _of_filament(problem: Problem, spec: GcodeLayersSpec, read: GcodeFile) -> Iterator[str]:
    """Notes on the filament diameter that E refers to, where file and problem do not plainly agree."""
    file, own = spec.source.gcode.name, problem.process.filament_diameter
    if read.volume:
        return
    tools = sorted({thread.tool for thread in read.threads})
    used = _millimetres(diameter_of(tool, problem, spec, read) for tool in tools)
    if spec.source.filament_diameter is not None:
        if read.filament and (said := _millimetres(read.filament)) != used:
            yield f"{file}: says that its E is for {said} mm filament; layers.source.filament_diameter_mm, {used} mm, is used"
    elif not read.filament:
        yield f"{file}: does not say what filament its E is for; {used} mm is used, from process.filament_diameter_mm"
    elif used != _millimetres([own]):
        yield f"{file}: its E is for {used} mm filament, as it says; process.filament_diameter_mm is what your extruder pushes"


def _millimetres(diameters: Iterable[float]) -> str:
    """Diameters [m] as text in millimetres, each once."""
    return ", ".join(dict.fromkeys(f"{1e3 * each:.4g}" for each in diameters))


def _without_shares(problem: Problem, spec: GcodeLayersSpec, read: GcodeFile) -> tuple[list[Thread], list[str]]:
    """The threads without the kinds that the problem leaves out; and notes."""
    source, notes = spec.source, []
    kept = [thread for thread in read.threads if thread.share not in source.leave_out]
    for share in (PURGE, SKIRT, BRIM, SUPPORT, IRONING):
        own = [thread for thread in read.threads if thread.share == share]
        if not own:
            continue
        names = ", ".join(dict.fromkeys(thread.kind for thread in own))
        size = f"{len(own)} piece{'s' if len(own) > 1 else ''} of {share} ({names}), {_metres(own)} m"
        if share in source.leave_out:
            notes.append(f"{source.gcode.name}: {size}, left out")
        else:
            notes.append(f"{source.gcode.name}: {size}, printed; layers.source.leave_out would leave it out")
    if not kept:
        raise problem.error("layers.source.leave_out", f"nothing else is in {source.gcode.name}", "leave out less")
    return kept, notes


def _levelled(file: Path, threads: list[Thread], usual: float | None) -> tuple[list[Thread], list[str]]:
    """The threads, with those that rise within their layer levelled at its height; and notes.

    A scarf joint begins on the layer below, next to lines that already have the layer's full height: there the nozzle
    would touch both. Its flow grows as it rises, and so does the bead.
    """
    out = []
    for thread in threads:
        rise, most = thread.z - float(thread.points[0, 2]), thread.height or usual or 0.0
        if 0.0 < rise <= most + SAME_LEVEL:
            flat = thread.points.copy()
            flat[:, 2] = thread.z
            out.append(replace(thread, points=flat))
        else:
            _check_slope(file, thread)
            out.append(thread)
    count = sum(a is not b for a, b in zip(threads, out, strict=True))
    pieces = f"{count} piece{'s rise within their layer and are' if count > 1 else ' rises within its layer and is'}"
    return out, [f"{file.name}: {pieces} laid level, as high as it ends"] if count else []


def _check_slope(file: Path, thread: Thread) -> None:
    """Raise InputError, with file and line, where a thread rises too steeply."""
    rise, way = np.diff(thread.points[:, 2]), np.hypot(*np.diff(thread.points[:, :2], axis=0).T)
    steep = rise > np.maximum(STEEPEST * way, _ROUNDED)
    if steep.any():
        i = int(np.argmax(steep))
        raise InputError(
            f"z rises by {rise[i] * 1e3:.3f} mm in {way[i] * 1e3:.3f} mm while material flows",
            file=file,
            line=int(thread.lines[i]),
            hint=f"by at most {STEEPEST:g} of the way: the nozzle stays upright",
        )


def _by_height(file: Path, threads: list[Thread]) -> tuple[list[Thread], list[str]]:
    """The threads, sorted by height if z goes down between any two of them; and notes."""
    falls = [after for before, after in zip(threads[:-1], threads[1:], strict=True) if after.z < before.z - SAME_LEVEL]
    if not falls:
        return threads, []
    where = ", ".join(str(int(thread.lines[0])) for thread in falls[:_NAMED]) + (", ..." if len(falls) > _NAMED else "")
    lines = f"line{'s' if len(falls) > 1 else ''} {where}"
    note = f"{file.name}: z goes down at {lines}; layers are printed from the lowest on instead, all objects at once"
    levels = _levels(threads)
    numbers = np.searchsorted(levels, [thread.z - SAME_LEVEL for thread in threads])
    return [threads[i] for i in np.argsort(numbers, kind="stable")], [note]


def _levels(threads: Sequence[Thread]) -> Array:
    """Heights (n) [m] of the tops of the layers, ascending."""
    heights = np.sort([thread.z for thread in threads])
    return heights[np.append(True, np.diff(heights) > SAME_LEVEL)]


def _in_layers(threads: Sequence[Thread], levels: Array, file: Path, usual: float | None) -> Iterator[PrintedThread]:
    """The threads with their layers and heights; heights come from comments, else from the layer's rise and flow."""
    layers = np.searchsorted(levels, [thread.z + SAME_LEVEL for thread in threads]) - 1
    heights = _heights(threads, layers, levels, usual)
    for thread, layer in zip(threads, layers.tolist(), strict=True):
        height = float(heights[layer]) if thread.height is None else thread.height
        if layer == 0 and thread.z - float(thread.points[0, 2]) > height + SAME_LEVEL:
            raise InputError(
                f"rises from the bed to {thread.z * 1e3:.3f} mm while material flows",
                file=file,
                line=int(thread.lines[0]),
                hint="begin a spiral on a level first layer: one solid layer at the bottom",
            )
        if not SIZES[0] <= height <= SIZES[1]:
            raise InputError(
                f"this layer is {height * 1e3:.3f} mm high",
                file=file,
                line=int(thread.lines[0]),
                hint="z = 0 is the bed, and each layer rises",
            )
        yield PrintedThread(thread, layer, height)


def _heights(threads: Sequence[Thread], layers: Ints, levels: Array, usual: float | None) -> Array:
    """Heights (n) [m] of layers without a height in a comment: how far each rises above the one below.

    Above a raft there is a gap, followed by a layer that rises by less than its height, and a spiral's layer ends with
    its last turn. So where a rise is unusual, the flow decides: the layer has the usual height if that brings the width
    of its beads closer to that of the others.
    """
    rises = np.diff(levels, prepend=0.0)
    if usual is None:
        usual = float(np.median(rises))
    odd = np.abs(np.log(np.maximum(rises, 1e-9) / usual)) > np.log(_ODD)
    if not odd.any():
        return rises
    flow, length = np.zeros(len(levels)), np.zeros(len(levels))
    np.add.at(flow, layers, [float(thread.filament.sum()) for thread in threads])
    np.add.at(length, layers, [thread.length for thread in threads])
    area = flow / length
    width = float(np.median(area[~odd])) / usual if (~odd).any() else float(np.median(area)) / usual
    by_rise, by_usual = (np.abs(np.log(area / each / width)) for each in (np.maximum(rises, 1e-9), usual))
    return np.where(odd & (by_usual < by_rise), usual, rises)


def _without_specks(
    problem: Problem, spec: GcodeLayersSpec, steps: list[PrintedThread]
) -> tuple[list[PrintedThread], list[str], float]:
    """The threads at least as long as a bead is wide, notes on the shorter ones, and their share of the length."""
    width, name = problem.process.bead.width, spec.source.gcode.name
    lengths = np.array([step.thread.length for step in steps])
    short = lengths < width
    if not short.any():
        return steps, [], 0.0
    if short.all():
        reason = f"everything that {name} extrudes is in pieces shorter than a bead is wide"
        raise problem.error("process.bead.width_mm", reason, "shorter pieces are left out as specks")
    share, most = float(lengths[short].sum() / lengths.sum()), spec.source.crumbs
    count = int(short.sum())
    pieces = f"{count} piece{'s' if count > 1 else ''} shorter than a bead is wide, {width * 1e3:g} mm"
    lines = [int(steps[i].thread.lines[0]) for i in np.flatnonzero(short)]
    if share > most:
        raise InputError(
            f"{pieces}, would be left out, {share:.2%} of the length; this is the first",
            file=spec.source.gcode,
            line=lines[0],
            hint=f"choose a smaller process.bead.width_mm, or a greater layers.source.leave_out_share, now {most:g}",
        )
    where = ", ".join(map(str, lines[:_NAMED])) + (", ..." if count > _NAMED else "")
    kept = [step for step, leave in zip(steps, short, strict=True) if not leave]
    # a layer of nothing but specks does not count
    numbers = {layer: i for i, layer in enumerate(sorted({step.layer for step in kept}))}
    kept = [PrintedThread(step.thread, numbers[step.layer], step.height) for step in kept]
    note = f"{name}: {pieces}, left out, {share:.2%} of the length (line{'s' if count > 1 else ''} {where})"
    return kept, [note], share


def _metres(threads: Sequence[Thread]) -> str:
    return f"{sum(thread.length for thread in threads):.3f}"
