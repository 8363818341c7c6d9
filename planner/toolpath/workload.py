"""How much there is to plan: waypoints, beads and places of the print, before curves are rounded and once laid.

Limits are those of `planner.base.budgets`. Predictions for curves are of what `round_corners` will make of them.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from planner.base.arrays import Array
from planner.base.budgets import BALLS, BEADS, WAYPOINTS
from planner.base.errors import InputError
from planner.problem import Problem
from planner.toolpath.bead import Bead, Toolpath
from planner.toolpath.plane_paths import SAMPLES_PER_TOLERANCE, length

_FEWEST = 9  # samples of a rounded path at least
_STRUT, _WIDER = 0.25, 1.25  # ball diameters, as in `print_body`: spacing along a strut; widest single row


@dataclass(frozen=True)
class Workload:
    """The amount to plan: numbers of beads, layers and waypoints, length [m] of all beads, and number of balls that
    represent the print as an obstacle."""

    beads: int
    layers: int
    waypoints: int
    length: float
    balls: int

    @classmethod
    def of(cls, toolpath: Toolpath) -> Workload:
        """The workload of a toolpath's beads."""
        return cls(
            beads=len(toolpath.beads),
            layers=toolpath.layers,
            waypoints=toolpath.waypoints,
            length=toolpath.length,
            balls=round(sum(_balls(bead) for bead in toolpath.beads)),
        )


def _balls(bead: Bead) -> float:
    """About how many balls `print_body` makes of a bead: rows of them side by side, as thick as the bead."""
    thick = float(np.minimum(bead.width, bead.height).min())
    rows = balls_beside(float(bead.width.max()), thick)
    return max(bead.length / (_STRUT * thick if bead.round else thick) + 1.0, 2.0) * rows


def balls_beside(width: float, thick: float) -> int:
    """How many balls of diameter `thick` [m] side by side represent a bead of this `width` [m]."""
    return max(int(np.ceil(width / thick - _WIDER)), 0) + 1


def samples_of(paths: Iterable[Array], tolerance: float) -> int:
    """About how many samples `round_corners` makes of plane paths (n, 2) at a corner tolerance [m]."""
    return sum(max(int(np.ceil(length(points) / tolerance * SAMPLES_PER_TOLERANCE)) + 1, _FEWEST) for points in paths)


def check_curves(problem: Problem, paths: Sequence[Array], layers: int, field: str) -> None:
    """Raise InputError, before rounding, for plane paths (n, 2) [m] that make too many waypoints in so many layers.

    field: the one that sets the size of the paths
    """
    one = samples_of(paths, problem.process.corner_tolerance)
    drawn = _drawn(len(paths), sum(map(length, paths)))
    if one > WAYPOINTS.most:
        smaller = f"paths of {WAYPOINTS.most / one:.2g} times that length"
        raise _too_many(problem, field, one, drawn, smaller)
    if layers * one > WAYPOINTS.most:
        raise _too_many(problem, "layers.count", layers * one, drawn, f"layers.count: {WAYPOINTS.most // one}")
    check_beads(problem, layers * len(paths))


def check_length(problem: Problem, total: float, layers: int) -> None:
    """As `check_curves`, for paths with a total length of about `total` [m] in all layers together."""
    count = round(total / problem.process.corner_tolerance * SAMPLES_PER_TOLERANCE)
    if count > WAYPOINTS.most:
        fits = f"{max(WAYPOINTS.most * layers // count, 1):,} of its {layers:,} layers"
        raise _too_many(problem, "layers", count, f"walls and infill of some {total:.0f} m make", fits)


def longest(problem: Problem) -> float:
    """Length [m] of paths that make as many waypoints as can be planned."""
    return WAYPOINTS.most * problem.process.corner_tolerance / SAMPLES_PER_TOLERANCE


def check_threads(problem: Problem, lengths: Sequence[float], layers: Sequence[int]) -> None:
    """As `check_curves`, for threads of these lengths (n) [m] in ascending layers (n)."""
    tolerance = problem.process.corner_tolerance
    each = np.maximum(np.ceil(np.asarray(lengths) / tolerance * SAMPLES_PER_TOLERANCE) + 1, _FEWEST)
    total = np.cumsum(each)
    if total[-1] > WAYPOINTS.most:
        fits = int(layers[int(np.searchsorted(total, WAYPOINTS.most, side="right"))])
        drawn = _drawn(len(lengths), sum(lengths))
        raise _too_many(
            problem, "layers.count", int(total[-1]), drawn, f"layers.count: {fits}" if fits else "a smaller part"
        )
    check_beads(problem, len(lengths))


def check_laid(problem: Problem, toolpath: Toolpath) -> None:
    """Raise InputError for a toolpath, whatever its source, that is too large to plan."""
    work = Workload.of(toolpath)
    if work.waypoints > WAYPOINTS.most:
        raise _too_many(
            problem,
            "layers",
            work.waypoints,
            f"{work.beads:,} beads make",
            fewer(work, WAYPOINTS.most / work.waypoints),
        )
    check_beads(problem, work.beads)
    BALLS.check(
        work.balls,
        f"beads of {toolpath.length:.1f} m make",
        lambda reason, hint=None: problem.error("process.bead", reason, hint),
        fewer(work, BALLS.most / work.balls) + ", or higher beads",
    )


def check_beads(problem: Problem, count: int) -> None:
    """Raise InputError for more beads than can be planned."""
    BEADS.check(count, "it makes", partial(problem.error, "layers"), "fewer layers or paths")


def fewer(work: Workload, share: float) -> str:
    """Which part of a print makes up the given share of it, in words."""
    return (
        f"{max(int(work.layers * share), 1):,} of its {work.layers:,} layers" if work.layers > 1 else "a smaller part"
    )


def _drawn(count: int, total: float) -> str:
    return f"1 path of {total:.1f} m makes" if count == 1 else f"{count:,} paths of {total:.1f} m make"


def _too_many(problem: Problem, field: str, count: int, drawn: str, fits: str) -> InputError:
    tolerance = np.ceil(problem.process.corner_tolerance * count / WAYPOINTS.most * 1e5) / 1e2
    hint = f"what would fit: {fits}, or process.corner_tolerance_mm: {tolerance:g}"
    return WAYPOINTS.refusal(count, drawn, partial(problem.error, field), hint)
