"""Reports what a scan found: the map as a table, a picture and words, and the problem file of the rest of the print."""

from __future__ import annotations

import csv
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from planner.base.arrays import Array
from planner.base.errors import OutputError
from planner.base.rapid_names import LONGEST_NAME
from planner.feedback.height_map import FEWEST, HeightMap
from planner.feedback.learn_telling import TAUGHT
from planner.problem import Problem
from planner.problem.rewrite import Value, changed_text, with_values, without
from planner.toolpath.as_printed import COLUMNS, left, made_up
from planner.toolpath.bead import Bead, Toolpath

MAP, PICTURE = "height_map.csv", "height_map.png"
MORE_COLUMNS = ("smoothed_mm", "how", "points", "scatter_mm", "bead", "s_mm")
MEASURED, INTERPOLATED = "measured", "interpolated"
GOOD, GOOD_SHARE = 0.1e-3, 0.5  # m, and × the lowest layer's height: less is not reported as left over
_COLOURS = "RdBu_r"  # red is too high, blue too low
_FACING = 0.3  # least cosine between all normals and their mean, for a map to be drawn as seen along it
_GREY, _INK = "#5b6b7b", "#1b2733"


def write_map(found: HeightMap, target: Path) -> None:
    """Write the map as CSV: a row for each cell. Raises OutputError."""
    top = found.top
    try:
        with target.open("w", encoding="utf-8", newline="") as stream:
            rows = csv.writer(stream, lineterminator="\n")
            rows.writerow((*COLUMNS, *MORE_COLUMNS))
            for k in range(len(top.middle)):
                numbers = (*(top.middle[k] * 1e3), *top.out[k], found.deviation[k] * 1e3, found.smoothed[k] * 1e3)
                more = (
                    MEASURED if found.measured[k] else INTERPOLATED,
                    int(found.count[k]),
                    f"{found.scatter[k] * 1e3:.4f}",
                )
                texts = [f"{value:.6f}" if i not in (3, 4, 5) else f"{value:.9f}" for i, value in enumerate(numbers)]
                rows.writerow((*texts, *more, int(top.bead[k]), f"{top.s[k] * 1e3:.3f}"))
    except OSError as error:
        raise OutputError(f"cannot write {target}: {error.strerror}") from error


def bound_of(toolpath: Toolpath, layer: int, share: float) -> float:
    """How much [m] higher or lower beads above a layer, counted from 1, may be made: a share of the least height."""
    return share * min(float(bead.height.min()) for bead in toolpath.beads if bead.layer >= layer)


def drawn_name(problem: Problem) -> str:
    """A problem's name without the suffix of an earlier scan, such as _after_4."""
    return problem.name if problem.as_printed is None else re.sub(r"_after_[0-9]+$", "", problem.name)


def write_problem(problem: Problem, found: HeightMap, layer: int, most: float, folder: Path) -> str:
    """The text of the problem for the rest of the print, for the folder of the map.

    Corrections learnt from runs are left out: the beads above have other lengths and positions.
    """
    suffix = f"_after_{layer}"
    values: dict[str, Value] = {
        "map": MAP,
        "after_layer": float(layer),
        "most_mm": most * 1e3,
        "smoothing_mm": found.radius * 1e3,
    }
    name: dict[str, Value] = {"name": drawn_name(problem)[: LONGEST_NAME - len(suffix)] + suffix}
    text = without(changed_text(problem, name, folder), ["as_run"]).replace(f"{TAUGHT}\n", "")
    if problem.as_printed is not None:
        return with_values(text, {f"as_printed.{key}": value for key, value in values.items()})
    lines = "".join(
        f"  {key}: {value if isinstance(value, str) else f'{value:.6g}'}\n" for key, value in values.items()
    )
    comment = "# What is printed, by beadwise scan: layers above are laid on that.\n"
    return f"{text.rstrip()}\n\n{comment}as_printed:\n{lines}"


def lines_of(found: HeightMap, layer: int) -> list[str]:
    """What the map shows, in words."""
    deviation = found.deviation[found.measured] * 1e3
    holes, disagree = ~found.measured, (found.count < FEWEST) | (found.scatter > found.top.most_scatter)
    points = found.count[found.measured]
    low, middle, high = np.quantile(deviation, (0.0, 0.5, 1.0))
    out = [
        f"top of layer {layer}: {len(found.measured)} cells, {found.covered:.1%} measured by {points.sum()} points "
        f"({np.median(points):.0f} in a cell)",
        f"off by {low:+.3f} to {high:+.3f} mm, {middle:+.3f} in the middle; cells are {found.noise * 1e3:.3f} mm off the map "
        f"smoothed over {found.radius * 1e3:g} mm",
    ]
    if holes.any():
        kinds = (
            (holes & disagree, f"with fewer than {FEWEST} points that agree"),
            (holes & ~disagree, "far off what lies around"),
        )
        reasons = [f"{own.sum()} {what}" for own, what in kinds if own.any()]
        out.append(
            f"interpolated: {holes.sum()} cells ({', '.join(reasons)}); the farthest is "
            f"{found.widest_hole * 1e3:.1f} mm from a measured one"
        )
    return out


def table_of(
    found: HeightMap, heights: Sequence[tuple[int, float]], most: float, widths: Sequence[float] | None = None
) -> list[str]:
    """A table by layer above the scanned one (its number from 1, and height [m]): its beads' heights, and what is left.

    widths: of rounded beads, with half a circle at both sides [m], by layer; None for rectangular ones
    """
    out = ["layer  beads, mm     flow, times   top left off, mm (95 %)"]
    rest = found.smoothed
    for k, (layer, height) in enumerate(heights):
        laid = height - made_up(rest, most)
        rest = left(rest, most, 1)
        ends = np.array([laid.min(), laid.max(), height])
        area = ends if widths is None else (widths[k] - ends) * ends + 0.25 * np.pi * ends**2
        out.append(
            f"{layer:5d}  {laid.min() * 1e3:.3f}–{laid.max() * 1e3:.3f}   {area[0] / area[2]:.2f}–{area[1] / area[2]:.2f}     "
            f"{np.abs(rest).max() * 1e3:.3f} ({np.quantile(np.abs(rest), 0.95) * 1e3:.3f})"
        )
    return out


def _good(heights: Sequence[tuple[int, float]]) -> float:
    """The deviation [m] up to which nothing is reported as left over, from the layers' numbers and heights [m]."""
    return min([GOOD, *(GOOD_SHARE * height for _, height in heights)])


def remains(found: HeightMap, heights: Sequence[tuple[int, float]], most: float) -> str:
    """What the bounds leave uncorrected on the last layer, in a sentence."""
    rest, good = np.abs(left(found.smoothed, most, len(heights))), _good(heights)
    share = float((rest > good).mean())
    if share == 0.0:
        done = next(k for k in range(len(heights) + 1) if np.abs(left(found.smoothed, most, k)).max() <= good)
        return f"made up for to {good * 1e3:g} mm from layer {heights[0][0] + max(done - 1, 0)} on"
    return (
        f"not made up for: {rest.max() * 1e3:.3f} mm are left on the last layer, more than {good * 1e3:g} mm on {share:.0%} of it; "
        f"a bead may change by {most * 1e3:g} mm (--share)"
    )


def layer_heights(toolpath: Toolpath, layer: int) -> list[tuple[int, float]]:
    """Numbers from 1, and mean heights of beads [m], of the layers above one."""
    return [(k + 1, float(np.mean([bead.height.mean() for bead in beads]))) for k, beads in _above(toolpath, layer)]


def layer_widths(toolpath: Toolpath, layer: int) -> list[float]:
    """Mean widths of beads [m] of the layers above one."""
    return [float(np.mean([bead.width.mean() for bead in beads])) for _, beads in _above(toolpath, layer)]


def _above(toolpath: Toolpath, layer: int) -> list[tuple[int, list[Bead]]]:
    """The layers above one, counted from 0, and their beads."""
    above = sorted({bead.layer for bead in toolpath.beads if bead.layer >= layer})
    return [(k, [bead for bead in toolpath.beads if bead.layer == k]) for k in above]


def write_picture(
    found: HeightMap, layer: int, heights: Sequence[tuple[int, float]], most: float, target: Path
) -> None:
    """Write the map, and the deviation left on each layer above, as PNG. Raises OutputError."""
    figure = Figure(figsize=(12.0, 5.0), dpi=120, facecolor="white", layout="constrained")
    _draw_map(figure, found, layer)
    _draw_layers(figure, found, layer, heights, most)
    try:
        FigureCanvasAgg(figure).print_png(str(target), metadata={"Software": None})
    except OSError as error:
        raise OutputError(f"cannot write {target}: {error.strerror}") from error


def _draw_map(figure: Figure, found: HeightMap, layer: int) -> None:
    """Cells coloured by their deviation; interpolated ones with a ring."""
    top, values = found.top, found.smoothed * 1e3
    bound = max(float(np.abs(values).max()), 0.05)
    mean = top.out.mean(axis=0)
    size = float(np.linalg.norm(mean))
    flat = size > 0.0 and bool(((top.out @ mean) / size > _FACING).all())
    place = (_plane(top.middle, mean / size) if flat else top.middle) * 1e3
    ax: Any = figure.add_subplot(1, 2, 1, projection=None if flat else "3d")
    for own, dot, edge in ((found.measured, 5, "none"), (~found.measured, 10, _GREY)):
        dots = ax.scatter(
            *place[own].T, c=values[own], s=dot, edgecolors=edge, linewidths=0.5, cmap=_COLOURS, vmin=-bound, vmax=bound
        )
    ax.set_aspect("equal")
    if flat:
        ax.set_xlabel("mm")
        ax.spines[["top", "right"]].set_visible(False)
    ax.set_title(f"top of layer {layer}: deviation from the plan (rings: interpolated)", fontsize=10, color=_INK)
    figure.colorbar(dots, ax=ax, shrink=0.8, label="along the normal [mm]: red too high, blue too low")


def _draw_layers(
    figure: Figure, found: HeightMap, layer: int, heights: Sequence[tuple[int, float]], most: float
) -> None:
    """The deviation left on top of each layer."""
    ax = figure.add_subplot(1, 2, 2)
    numbers = [layer, *(number for number, _ in heights)]
    rest = [np.abs(left(found.smoothed, most, k)) * 1e3 for k in range(len(numbers))]
    for share, style, label in ((1.0, "-", "at most"), (0.95, "--", "95 % of the cells"), (0.5, ":", "half of them")):
        ax.plot(numbers, [np.quantile(each, share) for each in rest], style, marker="o", color="#0072b2", label=label)
    ax.axhline(_good(heights) * 1e3, color=_GREY, linewidth=0.8)
    ax.set_xticks(numbers[:: max(1, len(numbers) // 10)])
    ax.set_ylim(bottom=0.0)
    ax.set_xlabel("layer")
    ax.set_ylabel("top off the drawing [mm]")
    ax.set_title(f"made up for, at most {most * 1e3:g} mm in a layer", fontsize=10, color=_INK)
    ax.spines[["top", "right"]].set_visible(False)
    ax.legend(frameon=False, fontsize=9)


def _plane(points: Array, towards: Array) -> Array:
    """Points (n, 3) as seen (n, 2) against a direction (3); from above, x is to the right."""
    right = np.array([1.0, 0.0, 0.0]) - towards[0] * towards
    if np.linalg.norm(right) < 0.1:
        right = np.array([0.0, 1.0, 0.0]) - towards[1] * towards
    right /= np.linalg.norm(right)
    return np.stack([points @ right, points @ np.cross(towards, right)], axis=1)
