"""Figures of a report: a mark for each problem and strategy, hollow if the plan is not verified."""

from __future__ import annotations

import io
from collections.abc import Callable, Sequence
from pathlib import Path

import matplotlib
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from PIL import Image

from benchmarks.summary import AT_SPEED, JERK, MARGIN, OVER_BOUND, OVER_IDEAL, RATE, SIGMA, Measure, Result
from planner.report.plots import COLOURS, FAINT, INK, tidy

PALETTE = 64  # colours of a picture: a quarter of the bytes, and nothing that one sees
DPI = 110
MARKS = "osD^vP*X<>"
_ROW = 0.24  # inches a problem
_SPREAD = 0.12  # of a row between strategies, so that equal marks are seen


def draw_figures(results: Sequence[Result], folder: Path) -> list[tuple[str, str]]:
    """Draw all figures into a folder; returns file and description of each, none where there is nothing of ours."""
    ours = [result for result in results if result.ours]
    if not ours:
        return []
    drawn: tuple[tuple[str, str, Callable[[Sequence[Result]], Figure]], ...] = (
        ("success.png", "Problems that each strategy claims and that are verified", _success),
        ("speed.png", "Share at speed, and deposition time over its two bounds, by problem and strategy", _speed),
        ("margins.png", "Distance from singularities and joint limits, and jerk, by problem and strategy", _margins),
        ("rate.png", "Waypoints planned and verified per second, by problem and strategy", _rate),
    )
    # text in figures must not depend on what somebody has in a file of settings
    with matplotlib.rc_context({**matplotlib.rcParamsDefault, "font.size": 9.0, "backend": "agg"}):
        for name, _, draw in drawn:
            _save(draw(ours), folder / name)
    return [(name, words) for name, words, _ in drawn]


def _save(figure: Figure, file: Path) -> None:
    """Save as a picture of few colours."""
    raw = io.BytesIO()
    figure.savefig(raw, format="png", dpi=DPI)
    with Image.open(raw) as picture:
        picture.convert("RGB").quantize(PALETTE).save(file, optimize=True)


def _success(results: Sequence[Result]) -> Figure:
    strategies = list(dict.fromkeys(result.strategy for result in results))
    figure = Figure(figsize=(6.5, 0.8 + 0.35 * len(strategies)), layout="constrained")
    ax = tidy(figure.subplots())
    for i, strategy in enumerate(strategies):
        own = [result for result in results if result.strategy == strategy]
        held, claimed = sum(r.verified for r in own), sum(r.found for r in own)
        ax.barh(i, held, height=0.6, color=COLOURS[0], label="verified" if i == 0 else None)
        ax.barh(
            i, claimed - held, left=held, height=0.6, label="claimed only" if i == 0 else None,
            facecolor="white", edgecolor=COLOURS[1], hatch="///",
        )  # fmt: skip
        ax.barh(i, len(own) - claimed, left=claimed, height=0.6, color=FAINT, label="no plan" if i == 0 else None)
    ax.set_yticks(range(len(strategies)), strategies)
    ax.invert_yaxis()
    ax.set_xlabel("problems")
    figure.legend(loc="outside upper right", ncols=3, frameon=False)
    return figure


def _speed(results: Sequence[Result]) -> Figure:
    return _panels(results, (AT_SPEED, OVER_IDEAL, OVER_BOUND), ("share at speed", OVER_IDEAL.name, OVER_BOUND.name))


def _margins(results: Sequence[Result]) -> Figure:
    return _panels(results, (SIGMA, MARGIN, JERK), ("least singular value", MARGIN.name, JERK.name))


def _rate(results: Sequence[Result]) -> Figure:
    figure = _panels(results, (RATE,), ("waypoints per second",))
    figure.axes[0].set_xscale("log")
    return figure


def _panels(results: Sequence[Result], measures: Sequence[Measure], titles: Sequence[str]) -> Figure:
    """A panel for each measure, problems below each other, a mark for each strategy with its spread."""
    problems = list(dict.fromkeys((result.problem, result.set) for result in results))
    strategies = list(dict.fromkeys(result.strategy for result in results))
    size = (2.2 + 2.6 * len(measures), 1.1 + _ROW * len(problems))
    figure = Figure(figsize=size, layout="constrained")
    panels = figure.subplots(1, len(measures), sharey=True, squeeze=False)[0]
    for ax, measure, title in zip(panels, measures, titles, strict=True):
        tidy(ax).grid(axis="y", color=FAINT, linewidth=0.6)
        for k, strategy in enumerate(strategies):
            shift = (k - 0.5 * (len(strategies) - 1)) * _SPREAD
            _marks(ax, [r for r in results if r.strategy == strategy], measure, problems, k, shift)
        ax.set_title(title, loc="left", color=INK, fontsize=9)
    panels[0].set_yticks(range(len(problems)), [name for name, _ in problems])
    panels[0].set_ylim(len(problems) - 0.5, -0.5)
    handles = [
        panels[0].plot([], [], MARKS[k % len(MARKS)], color=COLOURS[k % len(COLOURS)], label=name, markersize=5)[0]
        for k, name in enumerate(strategies)
    ]
    figure.legend(handles=handles, loc="outside upper right", ncols=len(strategies), frameon=False)
    return figure


def _marks(
    ax: Axes, own: Sequence[Result], measure: Measure, problems: Sequence[tuple[str, str]], k: int, shift: float
) -> None:
    """The marks of one strategy."""
    colour = COLOURS[k % len(COLOURS)]
    for result in own:
        spread = result.spread(measure)
        if spread is None:
            continue
        y = problems.index((result.problem, result.set)) + shift
        ax.plot([spread.low, spread.high], [y, y], color=colour, linewidth=1.0)
        face = colour if result.verified else "white"
        ax.plot(spread.median, y, MARKS[k % len(MARKS)], color=colour, markerfacecolor=face, markersize=4.5)
