"""Commanded speeds: the process's, those set for some layers or beads, and lower ones in layers otherwise too quick."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import replace
from itertools import pairwise

import numpy as np

from planner.base.arrays import Array
from planner.base.errors import InputError, nearest_name
from planner.problem import Problem
from planner.problem.by_layer import fits
from planner.problem.process import ProcessSpec
from planner.toolpath.bead import Toolpath

_MOST_NAMES = 6  # of beads in a hint


def check_layers(problem: Problem, toolpath: Toolpath) -> None:
    """Raise InputError for names that fit no bead, and for a pause before a layer that does not exist.

    If `layers.count` is overridden, nothing is checked: both may refer to layers that are not printed.
    """
    if problem.sources.override(("layers", "count")) is not None:
        return
    process, count = problem.process, 1 + max(bead.layer for bead in toolpath.beads)
    for k, spec in enumerate(process.speeds):
        if any(spec.covers(bead.name, bead.layer) for bead in toolpath.beads):
            continue
        if spec.from_layer > count:
            reason = f"there is no layer {spec.from_layer}"
            raise problem.error(f"process.speeds.{k}.from_layer", reason, f"there are {count}, counted from 1")
        where = "" if spec.from_layer == 1 and spec.to_layer is None else " in these layers"
        raise _unknown(problem, toolpath, f"process.speeds.{k}.beads", spec.beads, where)
    for k, pattern in enumerate(process.order):
        if not any(fits(pattern, bead.name) for bead in toolpath.beads):
            raise _unknown(problem, toolpath, f"process.order.{k}", pattern)
    for k, pause in enumerate(process.pauses):
        if pause.before_layer > count:
            reason = f"there is no layer {pause.before_layer}"
            hint = f"there are {count}, counted from 1" if count > 1 else "there is one layer"
            raise problem.error(f"process.pauses.{k}.before_layer", reason, hint)


def _unknown(problem: Problem, toolpath: Toolpath, field: str, pattern: str, where: str = "") -> InputError:
    """The error for a pattern that fits no bead's name."""
    names = list(dict.fromkeys(bead.name for bead in toolpath.beads))
    near = nearest_name(pattern, names)
    some = ", ".join(names[:_MOST_NAMES]) + (", …" if len(names) > _MOST_NAMES else "")
    return problem.error(
        field, f"no bead{where} is called {pattern!r}", f"did you mean {near}?" if near else f"names: {some}"
    )


def with_speeds(problem: Problem, toolpath: Toolpath) -> Toolpath:
    """The toolpath with beads' own speeds where they differ from the process's; a note says what is slowed down."""
    process = problem.process
    if not process.speeds and process.layer_time is None:
        return toolpath
    speeds, notes = commanded_speeds(process, toolpath), toolpath.notes
    if process.layer_time is not None:
        asked = commanded_speeds(process.model_copy(update={"layer_time": None}), toolpath)
        slower = np.flatnonzero(speeds < asked)
        if len(slower):
            layers = {toolpath.beads[i].layer + 1 for i in slower}
            notes = (*notes, _slowed(layers, float(speeds[slower].min())))
    beads = tuple(
        bead if v == process.speed else replace(bead, speed=float(v))
        for bead, v in zip(toolpath.beads, speeds, strict=True)
    )
    return replace(toolpath, beads=beads, notes=notes)


def _slowed(layers: set[int], lowest: float) -> str:
    """Which layers are laid more slowly, in words; `lowest` is their lowest speed [m/s]."""
    few = f"layer {min(layers)} is" if len(layers) == 1 else f"{len(layers)} layers are"
    return f"{few} laid more slowly than asked, down to {lowest * 1e3:.3g} mm/s, so that the next starts no sooner than asked"


def commanded_speeds(process: ProcessSpec, toolpath: Toolpath) -> Array:
    """Speed (beads) [m/s] of each bead: that of the last rule that covers it.

    A layer whose beads would take less than the least layer time is laid more slowly, all of its beads by the same
    share, but none slower than the process allows: the robot then waits at home for the rest of the time.
    """
    speeds = np.full(len(toolpath.beads), process.speed)
    for spec in process.speeds:
        for i, bead in enumerate(toolpath.beads):
            if spec.covers(bead.name, bead.layer):
                speeds[i] = spec.speed
    if process.layer_time is None:
        return speeds
    floor = process.layer_time.floor(process.speed)
    for own in list(beads_by_layer(toolpath).values())[:-1]:  # nothing is laid on the last one
        times = np.array([toolpath.beads[i].length for i in own]) / speeds[own]
        share = min(1.0, float(times.sum()) / process.layer_time.least)
        speeds[own] = np.minimum(speeds[own], np.maximum(share * speeds[own], floor))
    return speeds


def beads_by_layer(toolpath: Toolpath) -> dict[int, list[int]]:
    """Indices of beads, in their order, by layer; layers in the order in which they begin."""
    found: dict[int, list[int]] = defaultdict(list)
    for i, bead in enumerate(toolpath.beads):
        found[bead.layer].append(i)
    return dict(found)


def mean_speed(process: ProcessSpec, toolpath: Toolpath) -> float:
    """Length of all beads over the time they take at their commanded speeds [m/s]."""
    length = sum(bead.length for bead in toolpath.beads)
    return length / sum(bead.length / bead.commanded(process.speed) for bead in toolpath.beads)


def resting_time(process: ProcessSpec, toolpath: Toolpath) -> float:
    """Estimate, before the motion is known, how long the robot rests during a print [s].

    It rests until everything is hot, at cuts of fibre, for changes of material, for pauses, and until a layer is cool
    or old enough for the next one.
    """
    beads, layers = toolpath.beads, beads_by_layer(toolpath)
    cuts = 0.0 if process.fibre is None else len(beads) * process.fibre.cut_wait
    changes = sum(before.material != after.material for before, after in pairwise(beads)) * process.change.time
    least = 0.0 if process.layer_time is None else process.layer_time.least
    if process.interlayer_time is not None and process.interlayer_time.least is not None:
        least = max(least, process.interlayer_time.least)  # assuming that layers lie on each other
    pauses = {pause.before_layer - 1: pause.time for pause in process.pauses}
    between = 0.0
    for layer, after in pairwise(layers):
        laying = sum(beads[i].length / beads[i].commanded(process.speed) for i in layers[layer])
        between += max(least - laying, pauses.get(after, 0.0))
    return process.start.time + cuts + changes + between
