"""How a controller will run a program: speed on beads, distance from the lines, and targets that come too fast."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from planner.base.arrays import Array, Flags, Indices
from planner.base.nearest import distance_to_polyline
from planner.export.controllers import ControllerLimits
from planner.export.moves import fed_spans
from planner.export.player.executed import executed_run
from planner.export.player.path import MOST_TICKS
from planner.export.player.play import play
from planner.export.player.played import TIMES, Played, laid_moves, laid_spans
from planner.export.program import RobotProgram

if TYPE_CHECKING:
    from planner.cell.cell import Cell
    from planner.plan import Trajectory

FORECAST = "forecast.json"  # in a results folder
FORMAT = "beadwise forecast 1"
AT_SPEED = 0.02  # share of the programmed speed by which a tip at speed may be slower, as in the plan's own figures
SECOND = 1.0  # [s] over which targets are counted
FINE_TICK = 2e-3  # [s] between instants at which the arm is sampled: sharp corners lie between a controller's own ticks
BESIDE = 0.1  # [s] before and after a bead in which the tip may come nearest to the bead's ends
MANY = 0.001  # share of moves on beads that may be too short without a warning: a few corners do no harm


@dataclass(frozen=True)
class Forecast:
    """How a controller runs a program, according to its model (SI units).

    controller   its name
    assumed      its model is assumed, not fitted to recordings
    time         of the whole program
    programmed   mean programmed speed on beads; mean, least: predicted speeds; share: share of bead length at speed
    off          greatest distance of the executed tip from the programmed path on beads
    slowest      move on a bead with the least speed; -1 without beads
    targets      number of targets in the program; laid: number of moves on beads
    per_second   mean rate of targets on beads; most: number in the second with most of them
    closest      least time between two targets on a bead; nearest: the move that takes it, -1 without beads
    close        number of moves on beads shorter than the warning limit
    warnings     what exceeds the controller's known limits, in words
    of_plan      `off` is from the plan rather than from the lines, which were displaced from it by learning from runs
    """

    controller: str
    assumed: bool
    time: float
    programmed: float
    mean: float
    least: float
    share: float
    off: float
    slowest: int
    targets: int
    laid: int
    per_second: float
    most: int
    closest: float
    nearest: int
    close: int
    warnings: tuple[str, ...]
    of_plan: bool = False

    @property
    def words(self) -> tuple[str, ...]:
        """What to expect, one sentence each."""
        if not self.laid:
            return (f"{self.controller}: {self.targets} moves, none on beads, {self.time:.1f} s",)
        model = ", by an assumed model" if self.assumed else ""
        return (
            f"{self.controller}{model}: {1e3 * self.mean:.1f} mm/s on beads of {1e3 * self.programmed:.1f} programmed, "
            f"at least {1e3 * self.least:.1f}; {100 * self.share:.1f} % of their length at speed (within 2 %); "
            f"at most {1e3 * self.off:.2f} mm off {'the plan, as learned' if self.of_plan else 'the lines'}",
            f"{self.targets} targets; on beads {self.per_second:.0f} a second, {self.most} in the second with most, "
            f"the closest after {1e3 * self.closest:.1f} ms",
            *(f"WARNING: {warning}" for warning in self.warnings),
        )

    @property
    def figures(self) -> dict[str, object]:
        """The forecast for forecast.json: numbers by name and unit, and the words."""
        return {
            "controller": self.controller,
            "assumed": self.assumed,
            "time_s": self.time,
            "programmed_mm_s": 1e3 * self.programmed,
            "mean_mm_s": 1e3 * self.mean,
            "least_mm_s": 1e3 * self.least,
            "at_speed_fraction": self.share,
            "off_mm": 1e3 * self.off,
            "targets": self.targets,
            "targets_on_beads": self.laid,
            "targets_per_second": self.per_second,
            "targets_in_a_second_max": self.most,
            "closest_ms": 1e3 * self.closest,
            "closer_than_warned": self.close,
            "warnings": list(self.warnings),
            "words": list(self.words),
        }


def forecast_json(found: Mapping[str, Forecast]) -> str:
    """Text of forecast.json: a forecast for each language."""
    table = {name: each.figures for name, each in found.items()}
    return json.dumps({"format": FORMAT, "forecasts": table}, indent=1, allow_nan=False, ensure_ascii=False) + "\n"


def forecast(
    program: RobotProgram, cell: Cell, controller: ControllerLimits, planned: Trajectory | None = None
) -> Forecast:
    """How a controller runs a program. Raises InputError for a program that cannot be played.

    planned: the intended motion, if the program deliberately commands another one
    """
    played = play(program, cell, controller.motion)
    found = judged(program, played, controller)
    return replace(found, off=_off(program, played, cell, controller, planned), of_plan=planned is not None)


def joined(parts: Sequence[Forecast], controller: ControllerLimits) -> Forecast:
    """One forecast for programs run one after the other; `slowest` and `nearest` count moves over all of them."""
    if len(parts) == 1:
        return parts[0]
    before = np.cumsum([0, *(part.targets for part in parts)]).tolist()
    time, targets, close = sum(part.time for part in parts), before[-1], sum(part.close for part in parts)
    laid = [(part, first) for part, first in zip(parts, before, strict=False) if part.laid]
    if not laid:
        return replace(parts[0], time=time, targets=targets)
    took = np.array([part.laid / part.per_second for part, _ in laid])
    length = took * [part.mean for part, _ in laid]
    slow, first_of_slow = min(laid, key=lambda each: each[0].least)
    near, first_of_near = min(laid, key=lambda each: each[0].closest)
    count = sum(part.laid for part, _ in laid)
    whole = replace(
        slow,
        time=time,
        programmed=float(length.sum() / (length / [part.programmed for part, _ in laid]).sum()),
        mean=float(length.sum() / took.sum()),
        share=float((length * [part.share for part, _ in laid]).sum() / length.sum()),
        off=max(part.off for part, _ in laid),
        slowest=first_of_slow + slow.slowest,
        targets=targets,
        laid=count,
        per_second=float(count / took.sum()),
        most=max(part.most for part, _ in laid),
        closest=near.closest,
        nearest=first_of_near + near.nearest,
        close=close,
    )
    return _warned(whole, controller)


def _off(
    program: RobotProgram, played: Played, cell: Cell, controller: ControllerLimits, planned: Trajectory | None
) -> float:
    """Greatest distance [m] of the executed tip from the lines of the beads, or from their planned paths."""
    run = executed_run(program, played, controller.motion, max(FINE_TICK, played.duration / MOST_TICKS))
    tip = cell.T_part_nozzle(np.ascontiguousarray(run.q))[:, :3, 3]
    spans, when = laid_spans(played), np.union1d(run.t, played.arrive)  # corners are at targets
    lines = played.at(when).position
    paths = [lines[_within(when, on, off)] for on, off in spans]
    if planned is not None:
        paths = [planned.tip[a : b + 1] for a, b in zip(*fed_spans(planned), strict=True)]
    worst = 0.0
    for (on, off), path in zip(spans, paths, strict=False):
        executed = tip[_within(run.t, on - BESIDE, off + BESIDE)]
        worst = max(worst, float(distance_to_polyline(path, executed).max(initial=0.0)))
    return worst


def _within(t: Array, low: float, high: float) -> slice:
    """Slice of increasing times from low to high, both included."""
    return slice(int(np.searchsorted(t, low, "left")), int(np.searchsorted(t, high, "right")))


def close_moves(played: Played, controller: ControllerLimits) -> Flags:
    """Moves (m) on beads that take less time than the warning limit."""
    m = len(played.target)
    took = np.bincount(played.move, played.phases[:, TIMES].sum(axis=1), minlength=m)
    length = np.bincount(played.move, np.linalg.norm(np.diff(played.position, axis=0), axis=1), minlength=m)
    return np.asarray(laid_moves(played) & (length > 0.0) & (took < controller.warned_time))


def judged(program: RobotProgram, played: Played, controller: ControllerLimits) -> Forecast:
    """The forecast of a program played with the controller's motion, without its distance from the lines."""
    laid = laid_moves(played)
    m, count = len(laid), int(laid.sum())
    took = np.bincount(played.move, played.phases[:, TIMES].sum(axis=1), minlength=m)
    length = np.bincount(played.move, np.linalg.norm(np.diff(played.position, axis=0), axis=1), minlength=m)
    laid &= length > 0.0
    if not laid.any():
        return _without_beads(played, controller, m)
    meant = length / program.speed[:, 0]
    nominal = np.where(laid, np.maximum(took, 1e-9), np.inf)
    least = _least(played)
    slowest = int(np.argmin(np.where(laid, least, np.inf)))
    nearest = int(np.argmin(nominal))
    ways = np.flatnonzero(laid[played.move])
    most = _most(played.arrive[laid])
    at_speed = _at_speed(program, played, ways)
    total = float(took[laid].sum())
    figures = Forecast(
        controller=controller.title,
        assumed=len(controller.motion.assumed) > 1,
        time=played.duration,
        programmed=float(length[laid].sum() / meant[laid].sum()),
        mean=float(length[laid].sum() / total),
        least=float(least[slowest]),
        share=at_speed,
        off=0.0,
        slowest=slowest,
        targets=m,
        laid=count,
        per_second=count / total,
        most=most,
        closest=float(nominal[nearest]),
        nearest=nearest,
        close=int(close_moves(played, controller).sum()),
        warnings=(),
    )
    return _warned(figures, controller)


def _warned(figures: Forecast, controller: ControllerLimits) -> Forecast:
    """The forecast, with warnings about the controller's known limits."""
    found = []
    if figures.close > MANY * figures.laid:
        found.append(
            f"{figures.close} of {figures.laid} moves on beads take less than {1e3 * controller.warned_time:g} ms "
            f"({controller.source})"
        )
    if figures.most > controller.most_per_second:
        found.append(f"{figures.most} targets in a second, and it is known to take in {controller.most_per_second:.0f}")
    if controller.most_targets is not None and figures.targets > controller.most_targets:
        found.append(
            f"{figures.targets} targets in one program, and users report trouble beyond {controller.most_targets}"
        )
    return replace(figures, warnings=tuple(found))


def _without_beads(played: Played, controller: ControllerLimits, targets: int) -> Forecast:
    none = float("nan")
    assumed = len(controller.motion.assumed) > 1
    return Forecast(
        controller.title, assumed, played.duration, none, none, none, none, 0.0, -1, targets, 0, 0.0, 0, none, -1, 0, ()
    )


def _least(played: Played) -> Array:
    """Least speed of the tip on each move (m) [m/s], at its ends and between, without rests; inf if it only rests."""
    v0, a, begin, _, b, end = played.phases.T
    middle = v0 + a * begin
    v1 = middle + b * end
    # path length is in metres of the tip wherever the tip sets the pace
    slow = np.minimum(np.where(v0 > 0.0, v0, np.inf), np.where(v1 > 1e-9, v1, np.inf))
    slow = np.where(played.length > 0.0, np.minimum(slow, np.where(middle > 0.0, middle, np.inf)), np.inf)
    out = np.full(len(played.target), np.inf)
    np.minimum.at(out, played.move, slow)
    return out


def _at_speed(program: RobotProgram, played: Played, ways: Indices) -> float:
    """Share of the ways' length on which the tip is within AT_SPEED of the programmed speed."""
    v0, a, begin, even, b, end = played.phases[ways].T
    least = (1.0 - AT_SPEED) * program.speed[played.move[ways], 0]
    top = v0 + a * begin
    v1 = top + b * end
    length = played.length[ways]
    with np.errstate(divide="ignore", invalid="ignore"):
        # the part of each ramp above `least`: from there to the top, at constant acceleration
        up = np.where(v0 >= least, begin, np.where(a != 0.0, np.maximum(top - least, 0.0) / np.abs(a), 0.0))
        down = np.where(v1 >= least, end, np.where(b != 0.0, np.maximum(top - least, 0.0) / np.abs(b), 0.0))
    fast = np.where(top >= least, 0.5 * (np.maximum(v0, least) + top) * up, 0.0) + np.where(
        top >= least, top * even, 0.0
    )
    fast += np.where(top >= least, 0.5 * (np.maximum(v1, least) + top) * down, 0.0)
    return float(np.minimum(fast, length).sum() / length.sum())


def _most(arrive: Array) -> int:
    """Greatest number of the times (k), ascending, within one second."""
    return int((np.searchsorted(arrive, arrive + SECOND, side="left") - np.arange(len(arrive))).max(initial=0))
