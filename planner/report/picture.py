"""A still picture of a finished plan, from its output folder alone."""

from __future__ import annotations

import argparse
import json
import struct
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.colors import LinearSegmentedColormap, Normalize
from matplotlib.figure import Figure
from numpy.typing import NDArray

from planner.base.arrays import Array
from planner.base.errors import InputError, OutputError, PlannerError, nearest_name
from planner.report.scene import ALARM, COLOURS, INK
from planner.report.thinning import stretches, thin_curve

# ----------------------------------------------------------------------------------------------------
# The plan, read from plan.json, trajectory.csv, and report_part.stl.

COLUMNS = ("t_s", "bead", "layer", "deposit", "x_mm", "y_mm", "z_mm", "ax", "ay", "az", "speed_mm_s", "flow_mm3_s")


def read_folder(folder: Path) -> tuple[dict[str, Any], dict[str, Array]]:
    """plan.json, and the columns of trajectory.csv that a picture needs, by name."""
    if not folder.is_dir():
        raise InputError(
            "no such folder", file=folder, hint="the folder that the planner wrote, e.g. out/cylinder_logo"
        )
    for name in ("plan.json", "trajectory.csv"):
        if not (folder / name).is_file():
            raise InputError(f"there is no {name} in this folder", file=folder, hint="has a plan been written here?")
    path = folder / "plan.json"
    try:
        summary = json.loads(path.read_text(encoding="utf-8"))
    except (json.JSONDecodeError, UnicodeDecodeError) as error:
        raise InputError(f"not JSON: {error}", file=path, line=getattr(error, "lineno", None)) from error
    for field, kind in (("problem", str), ("strategy", str), ("verified", bool), ("metrics", dict)):
        if not isinstance(summary, dict) or not isinstance(summary.get(field), kind):
            raise InputError("missing, or not of the type that a plan has here", file=path, field=field)
    path = folder / "trajectory.csv"
    with path.open(encoding="utf-8", errors="replace") as stream:
        header = [name.strip() for name in stream.readline().split(",")]
        empty = not (stream.readline().strip() and stream.readline().strip())
    for name in COLUMNS:
        if name not in header:
            near = nearest_name(name, header)
            raise InputError("no such column", file=path, line=1, field=name, hint=f"there is {near}" if near else None)
    if empty:
        raise InputError("the table is empty", file=path, line=2)
    try:
        table = np.loadtxt(path, delimiter=",", skiprows=1, usecols=[header.index(n) for n in COLUMNS], ndmin=2)
    except (ValueError, UnicodeDecodeError) as error:
        raise InputError(f"not a table of numbers: {error}", file=path) from error
    return summary, dict(zip(COLUMNS, table.T, strict=True))


def read_part(folder: Path) -> Array:
    """Triangles (n, 3, 3) of the part [mm] in report_part.stl; none if there is no such file.

    Raises InputError for a file that is no STL file.
    """
    path = folder / "report_part.stl"
    if not path.is_file():
        return np.zeros((0, 3, 3))
    try:
        with path.open("rb") as stream:
            mesh = trimesh.load_mesh(stream, file_type="stl", process=False)
        triangles = np.asarray(mesh.triangles, dtype=float)
    except (ValueError, TypeError, IndexError, struct.error, UnicodeDecodeError) as error:
        raise InputError("not an STL file", file=path) from error
    if not (len(triangles) and np.isfinite(triangles).all()):
        raise InputError("no triangles, or one with a corner that is not finite", file=path)
    return triangles


# ----------------------------------------------------------------------------------------------------
# The picture.
#
#     python -m planner.report.picture OUT_FOLDER PICTURE.png
#
# Reads trajectory.csv, plan.json and, if the part has a shape of its own, report_part.stl.

ELEVATION = np.radians(20.0)
SCENE_INCHES = np.array([6.2, 6.1])  # width and height of the scene
SHEEN = 0.45  # share of the way to white, where light falls straight on a bead
WIDEST = 1.35  # points: greatest width of a bead's line
LINE = 0.75  # × a bead's size: width of its line, so that beads side by side stay apart
LEAST_DOT = 0.03  # × the costliest dip's time: cheaper ones are not marked
SMALLEST_DOT, LARGEST_DOT = 5.0, 40.0  # square points: a dip's dot
SOFT = "#5b6b7b"
PART_LIT, PART_DARK = np.array([238.0, 242.0, 246.0]), np.array([176.0, 187.0, 199.0])
REST = "stop"  # limit of a dip that is a planned rest
_FLAT = 1e-12  # mm^2: a triangle without an area
COLOUR_MAP = LinearSegmentedColormap.from_list("calm", COLOURS)


def draw_picture(folder: Path, picture: Path) -> None:
    """Draw the plan in `folder` into the PNG `picture`.

    Raises InputError for a missing or damaged folder, and OutputError if the picture cannot be written.
    """
    summary, rows = read_folder(folder)
    printing = rows["deposit"] > 0.5
    if not printing.any():
        raise InputError("nothing is deposited in this plan", file=folder / "trajectory.csv", field="deposit")
    points = np.column_stack([rows["x_mm"], rows["y_mm"], rows["z_mm"]])
    normals = -np.column_stack([rows["ax"], rows["ay"], rows["az"]])
    part = read_part(folder)
    summary["dips"] = [dip for dip in summary.get("dips", []) if dip["limit"] != REST]
    metrics = summary["metrics"]
    ideal = metrics.get("ideal_deposition_time_s") or np.nan
    commanded = metrics.get("deposited_length_mm", np.nan) / ideal
    speed = rows["speed_mm_s"]
    top = commanded if np.isfinite(commanded) else speed[printing].max()
    norm = Normalize(min(float(speed[printing].min()), 0.9 * top), max(top, float(speed[printing].max())))

    figure = Figure(figsize=(12.0, 6.4), dpi=150, facecolor="white")
    scene = figure.add_axes((0.01, 0.02, 0.52, 0.96))
    _draw_scene(scene, points, normals, rows, printing, part, norm)
    _mark_dips(scene, points, normals, rows["t_s"], summary["dips"], _view(normals[printing]))
    _draw_words(figure, summary)
    _draw_speed(figure.add_axes((0.60, 0.13, 0.37, 0.32)), rows, printing, commanded, norm)
    try:
        FigureCanvasAgg(figure).print_png(str(picture), metadata={"Software": None})
    except OSError as error:
        raise OutputError(f"cannot write {picture}: {error.strerror}") from error


def _view(normals: Array) -> tuple[Array, Array, Array]:
    """Unit vectors to the right, up, and towards the eye (an orthographic view from where the print faces)."""
    mean = normals.mean(axis=0)
    azimuth = np.arctan2(mean[1], mean[0]) if np.hypot(mean[0], mean[1]) > 0.15 else np.radians(-60.0)
    azimuth += np.radians(14.0)
    up_angle = ELEVATION if abs(mean[2]) < 0.5 else np.radians(42.0)
    eye = np.array([np.cos(azimuth) * np.cos(up_angle), np.sin(azimuth) * np.cos(up_angle), np.sin(up_angle)])
    right = np.array([-np.sin(azimuth), np.cos(azimuth), 0.0])
    return right, np.cross(eye, right), eye


def _light(right: Array, up: Array, eye: Array) -> Array:
    """Unit vector to the light: from the left and above, in front."""
    light = eye - 0.75 * right + 0.35 * up
    return np.asarray(light / np.linalg.norm(light))


def _draw_scene(
    axes: Any,
    points: Array,
    normals: Array,
    rows: dict[str, Array],
    printing: NDArray[np.bool_],
    part: Array,
    norm: Normalize,
) -> None:
    right, up, eye = _view(normals[printing])
    index, begin, _ = stretches(printing, rows["bead"].astype(int))
    joined = np.ones(len(index) - 1, dtype=bool)
    joined[begin[1:] - 1] = False
    p, n = points[index], normals[index]
    flat = np.column_stack([p @ right, p @ up])
    middle = 0.5 * (p[:-1] + p[1:])
    facing = (n @ eye)[:-1] > 0.0
    depth = middle @ eye
    segments = np.stack([flat[:-1], flat[1:]], axis=1)
    value = np.minimum(rows["speed_mm_s"][index][:-1], rows["speed_mm_s"][index][1:])
    lit = np.clip(n[:-1] @ _light(right, up, eye), 0.0, 1.0)
    section = np.median(rows["flow_mm3_s"][index] / np.maximum(rows["speed_mm_s"][index], _FLAT))
    scale = 72.0 * min(SCENE_INCHES / np.ptp(flat, axis=0))  # points per millimetre, at most
    width = min(WIDEST, float(np.sqrt(section)) * scale * LINE)
    outlines = [flat]
    if len(part):
        outlines.append(_draw_part(axes, part, right, up, eye))
    # Lines on the far side are drawn behind the part: only what sticks out past it shows.
    for mine, order in ((joined & ~facing, 1), (joined & facing, 3)):
        at = np.flatnonzero(mine)
        at = at[np.argsort(depth[at], kind="stable")]
        colours = COLOUR_MAP(norm(value[at]))[:, :3]
        colours += SHEEN * lit[at, None] * (1.0 - colours)
        lines = LineCollection(list(segments[at]), colors=colours, linewidths=width, capstyle="round", zorder=order)
        axes.add_collection(lines)
    every = np.vstack(outlines)
    low, high = every.min(axis=0), every.max(axis=0)
    pad = 0.04 * float((high - low).max())
    axes.set_xlim(low[0] - pad, high[0] + pad)
    axes.set_ylim(low[1] - pad, high[1] + pad)
    axes.set_aspect("equal")
    axes.set_axis_off()


def _mark_dips(
    axes: Any, points: Array, normals: Array, time: Array, dips: Sequence[dict[str, Any]], view: tuple[Array, ...]
) -> None:
    """A white dot with a black edge at each dip on the near side, the larger the more time the dip costs."""
    right, up, eye = view
    at = np.searchsorted(time, [dip["t_s"] - 0.5 * (time[1] - time[0]) for dip in dips])
    cost = np.array([dip["lost_s"] for dip in dips])
    near = (normals[at] @ eye > 0.0) & (cost >= LEAST_DOT * cost.max()) if len(dips) else np.empty(0, dtype=bool)
    at, cost = at[near], cost[near]
    if not len(at):
        return
    size = SMALLEST_DOT + (LARGEST_DOT - SMALLEST_DOT) * cost / cost.max()
    axes.scatter(points[at] @ right, points[at] @ up, s=size, c="white", edgecolors="black", linewidths=0.7, zorder=4)


def _draw_part(axes: Any, triangles: Array, right: Array, up: Array, eye: Array) -> Array:
    """Shade the visible triangles of (n, 3, 3), the nearest last; returns their corners (k, 2) on the picture."""
    normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1), _FLAT)[:, None]
    near = np.flatnonzero(normals @ eye > 0.0)
    near = near[np.argsort(triangles[near].mean(axis=1) @ eye, kind="stable")]
    flat = triangles[near] @ np.column_stack([right, up])
    lit = np.clip(normals[near] @ _light(right, up, eye), 0.0, 1.0)[:, None]
    colours = (PART_DARK + lit * (PART_LIT - PART_DARK)) / 255.0
    axes.add_collection(PolyCollection(list(flat), facecolors=colours, edgecolors=colours, linewidths=0.6, zorder=2))
    return flat.reshape(-1, 2)


def _draw_words(figure: Figure, summary: dict[str, Any]) -> None:
    metrics = summary["metrics"] | {"dips": len(summary["dips"])}
    figure.text(0.575, 0.895, summary["problem"], fontsize=21, weight="bold", color=INK, parse_math=False)
    verdict = "✓ verified" if summary["verified"] else "✗ not verified"
    colour = "#00599c" if summary["verified"] else ALARM
    figure.text(0.575, 0.838, verdict, fontsize=13, weight="bold", color=colour)
    figure.text(0.69, 0.838, f"strategy {summary['strategy']}", fontsize=13, color=SOFT, parse_math=False)
    rows = [
        ("at_speed_fraction", 100.0, "{:.2f} %", "of the length at the commanded speed"),
        ("speed_min_mm_s", 1.0, "{:.1f} mm/s", "slowest while depositing"),
        ("dips", 1.0, "{:.0f}", "dips in speed, white dots by time lost"),
        ("sigma_min", 1.0, "{:.3f}", "least distance from singularity, σ"),
        ("joint_limit_margin_deg", 1.0, "{:.1f}°", "least distance from an end stop"),
        ("print_time_s", 1.0, "{:.0f} s", "whole print, travel included"),
    ]
    y = 0.77
    for key, scale, form, label in rows:
        if isinstance(metrics.get(key), int | float):
            figure.text(0.675, y, form.format(metrics[key] * scale), fontsize=13, weight="bold", color=INK, ha="right")
            figure.text(0.687, y, label, fontsize=12, color=SOFT)
            y -= 0.046


def _draw_speed(
    axes: Any, rows: dict[str, Array], printing: NDArray[np.bool_], commanded: float, norm: Normalize
) -> None:
    """Tip speed over time while depositing, coloured as in the scene, so that it also serves as the legend.

    The commanded speed, or the mean of several, is dashed.
    """
    index, begin, end = stretches(printing, rows["bead"].astype(int))
    speed = rows["speed_mm_s"][index]
    kept = thin_curve(speed, always=np.union1d(begin, end))
    line = np.column_stack([rows["t_s"][index][kept], speed[kept]])
    joined = ~np.isin(kept[1:], begin)
    segments = np.stack([line[:-1], line[1:]], axis=1)[joined]
    lines = LineCollection(list(segments), cmap=COLOUR_MAP, norm=norm, linewidths=1.0)
    lines.set_array(segments[:, :, 1].min(axis=1))
    axes.add_collection(lines)
    top = float(speed.max())
    if np.isfinite(commanded):
        axes.axhline(commanded, color=SOFT, linewidth=0.8, linestyle=(0, (5, 4)), zorder=0)
        top = max(top, commanded)
    axes.set_xlim(float(rows["t_s"][0]), float(rows["t_s"][-1]))
    axes.set_ylim(0.0, 1.12 * top)
    axes.set_title("Tip speed while depositing", loc="left", fontsize=12, color=INK, weight="bold", pad=8)
    axes.set_xlabel("time, s", color=SOFT)
    axes.set_ylabel("mm/s", color=SOFT)
    axes.tick_params(colors=SOFT, labelsize=9)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    for side in ("left", "bottom"):
        axes.spines[side].set_color("#c3ccd5")


def main(arguments: list[str] | None = None) -> int:
    """Command line; returns the exit code (0, or 2 for wrong input)."""
    parser = argparse.ArgumentParser(prog="python -m planner.report.picture", description="Draw a finished plan.")
    parser.add_argument("folder", type=Path, help="what the planner wrote: holds trajectory.csv and plan.json")
    parser.add_argument("picture", type=Path, help="the PNG to write")
    options = parser.parse_args(arguments)
    try:
        draw_picture(options.folder, options.picture)
    except PlannerError as error:
        print(f"error: {error}", file=sys.stderr)
        return error.exit_code
    return 0


if __name__ == "__main__":
    sys.exit(main())
