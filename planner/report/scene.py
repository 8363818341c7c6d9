"""The 3-D scene: printed beads on the part in the part frame (millimetres), as plain plotly dictionaries.

Beads share one colour axis. What they may be coloured by stands beside the traces, so that the page can
switch without carrying the coordinates twice. Layers are bundled into at most MAX_GROUPS traces.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from planner.report.dips import dip_traces
from planner.report.extruder import surplus
from planner.report.part import earlier_traces, eye, part_traces
from planner.report.thinning import SCENE_BUDGET, keep_minima, stretches, turning, with_gaps

if TYPE_CHECKING:
    from planner.plan import Plan
    from planner.toolpath.bead import Bead
    from planner.toolpath.shape import Shape

Array = NDArray[np.float64]

MAX_GROUPS = 40
EARLIER_BUDGET = 10_000  # points of beads that are there before the motion
FILL = 2.1
# Marks stand a little off the surface, or the part would hide half of each.
MARK_OUT_MM = 3.0
# Cividis, reversed and without its palest end: the ordinary is dark and calm, the exceptional is light.
COLOURS: list[tuple[float, str]] = [
    (0.0, "#f2c928"),
    (0.2, "#c9ae5c"),
    (0.4, "#9b9476"),
    (0.6, "#6e7277"),
    (0.8, "#404d6c"),
    (1.0, "#00224e"),
]
PAPER = "#ffffff"
INK = "#1b2733"
ALARM = "#d1495b"


@dataclass(frozen=True)
class Place:
    """A worst place: what is worst there, its value in words, the sample, and where it is drawn [mm]."""

    letter: str
    what: str
    value: str
    sample: int
    point: Array


def plan_scene(plan: Plan, places: Sequence[Place]) -> dict[str, Any]:
    """Scene of a plan: `traces`, `layout`, `beads`, `dips` and `places` (trace numbers), `groups` (labels) and `channels`."""
    traj = plan.trajectory
    facing = -traj.axis[traj.deposit].mean(axis=0) if traj.deposit.any() else np.zeros(3)
    kept, cuts = _kept_samples(plan)
    layer = traj.layer[kept]
    layers = np.unique(layer)
    bundles = np.array_split(layers, min(len(layers), MAX_GROUPS)) if len(layers) else []
    shown = {
        "x": traj.tip[kept, 0] * 1e3,
        "y": traj.tip[kept, 1] * 1e3,
        "z": traj.tip[kept, 2] * 1e3,
        "t": traj.t[kept],
        "bead": traj.bead[kept],
    }
    channels = _channels(plan, kept)
    solid, groups = part_traces(plan.toolpath.shape, facing), []
    traces = solid + earlier_traces(plan.toolpath.beads[: plan.first_bead], EARLIER_BUDGET)
    carried: dict[str, list[Array]] = {key: [] for key in ("t", "bead", *(c["key"] for c in channels))}
    first_bead = len(traces)
    for bundle in bundles:
        mine = np.isin(layer, bundle)
        breaks = np.flatnonzero(cuts[mine])[1:]
        x, y, z = (with_gaps(shown[k][mine], breaks) for k in "xyz")
        traces.append(_line(x, y, z, {"width": 4, "coloraxis": "coloraxis"}))
        groups.append(_layer_words(bundle))
        for key in ("t", "bead"):
            carried[key].append(with_gaps(shown[key][mine], breaks))
        for channel in channels:
            carried[channel["key"]].append(with_gaps(channel["values"][mine], breaks))
    for channel in channels:
        channel["values"] = carried[channel["key"]]
    marks = dip_traces(plan, bundles)
    first_mark = len(traces)
    worst = _place_traces(places)
    traces += [*marks, *worst]
    return {
        "traces": traces,
        "layout": scene_layout(traces, facing, colour_bar=True),
        "beads": list(range(first_bead, first_bead + len(groups))),
        "dips": list(range(first_mark, first_mark + len(marks))),
        "places": list(range(first_mark + len(marks), len(traces))),
        "part": list(range(len(solid))),
        "groups": groups,
        "channels": channels,
        "t": carried["t"],
        "bead": carried["bead"],
        "points": len(kept),
    }


def bead_scene(
    shape: Shape | None, beads: Sequence[Bead], failed: int | None, point_mm: Sequence[float] | None
) -> dict[str, Any]:
    """Scene where there is no trajectory: all beads as planned, the failed one and the place marked."""
    points = [np.asarray(bead.points, dtype=float) * 1e3 for bead in beads]
    every = np.concatenate(points) if points else np.zeros((0, 3))
    last = np.cumsum([len(p) for p in points]) - 1 if points else np.empty(0, dtype=int)
    first = last + 1 - [len(p) for p in points]
    kept = keep_minima([-turning(every, first, last), np.zeros(len(every))], SCENE_BUDGET, np.union1d(first, last))
    owner = np.repeat(np.arange(len(points)), [len(p) for p in points])[kept] if points else np.empty(0, dtype=int)
    facing = _facing(beads, failed, point_mm)
    traces = part_traces(shape, facing)
    sets = [(owner != failed, "#40566e", 3, "planned beads")]
    if failed is not None:
        sets.append((owner == failed, ALARM, 7, f"bead {failed}"))
    for mine, colour, width, name in sets:
        breaks = np.flatnonzero(np.diff(owner[mine]) != 0) + 1
        x, y, z = (with_gaps(every[kept][mine, k], breaks) for k in range(3))
        traces.append(_line(x, y, z, {"width": width, "color": colour}) | {"name": name, "showlegend": True})
    if point_mm is not None:
        where = np.asarray(point_mm, dtype=float) + MARK_OUT_MM * facing
        traces.append(_marks(where[None], ["here"], size=9) | {"name": "the place", "showlegend": True})
    return {
        "traces": traces,
        "layout": scene_layout(traces, facing, colour_bar=False),
        "part": [],
        "beads": [],
        "dips": [],
        "places": [],
    }


def scene_layout(traces: Sequence[dict[str, Any]], facing: Array, *, colour_bar: bool) -> dict[str, Any]:
    """Layout of a scene of `traces`, seen from where `facing` (3,), a mean outward normal, points."""
    low, high = _extent(traces)
    size = high - low
    axes = {
        f"{name}axis": {
            "title": {"text": f"{name} mm"},
            "backgroundcolor": "#f6f8fa",
            "showbackground": name == "z",
            "gridcolor": "#d5dce4",
            "zeroline": False,
            "showspikes": False,
            "tickfont": {"size": 10},
            "range": [float(low[k]), float(high[k])],
        }
        for k, name in enumerate("xyz")
    }
    layout: dict[str, Any] = {
        "scene": {
            **axes,
            # One scale for all axes; orthographic, because parallel should look parallel.
            "aspectmode": "manual",
            "aspectratio": {name: float(v) for name, v in zip("xyz", FILL * size / np.linalg.norm(size), strict=True)},
            "camera": {"eye": eye(facing), "projection": {"type": "orthographic"}},
            "domain": {"x": [0, 1], "y": [0.1 if colour_bar else 0, 1]},
            "dragmode": "orbit",
        },
        "margin": {"l": 0, "r": 0, "t": 0, "b": 0},
        "paper_bgcolor": PAPER,
        "font": {"family": "system-ui, sans-serif", "color": INK, "size": 12},
        "showlegend": not colour_bar,
        "legend": {"orientation": "h", "x": 0, "y": 0},
        "hoverlabel": {"align": "left"},
        "uirevision": "keep",
    }
    if colour_bar:
        layout["coloraxis"] = {
            "colorscale": COLOURS,
            "colorbar": {
                "orientation": "h",
                "x": 0.5,
                "y": 0,
                "yanchor": "bottom",
                "len": 0.6,
                "thickness": 10,
                "title": {"side": "top", "text": ""},
            },
        }
    return layout


def _kept_samples(plan: Plan) -> tuple[NDArray[np.intp], NDArray[np.bool_]]:
    """Samples of deposition to draw, in order, and which of them start a new line."""
    traj = plan.trajectory
    index, begin, end = stretches(traj.deposit, traj.bead)
    if not len(index):
        return index, np.empty(0, dtype=bool)
    sharp = turning(traj.tip[index], begin, end)
    even = np.zeros(len(index))
    signals = [traj.speed[index], -sharp, even]
    signals += [
        plan.series[name][index] for name in ("sigma", "limit_margin_deg", "clearance_mm") if name in plan.series
    ]
    kept = keep_minima(signals, SCENE_BUDGET, np.union1d(begin, end))
    starts = np.zeros(len(index), dtype=bool)
    starts[begin] = True
    return index[kept], starts[kept]


def _channels(plan: Plan, kept: NDArray[np.intp]) -> list[dict[str, Any]]:
    """What beads can be coloured by, with the range of the colour bar."""
    commanded = plan.problem.process.speed * 1e3
    speed = plan.trajectory.speed[kept] * 1e3
    out = []
    if len(speed):
        low, high = min(speed.min(), 0.9 * commanded), max(speed.max(), commanded)
        out.append(_channel("speed", "Tip speed", "mm/s", speed, low, high))
        over = surplus(plan)
        if over is not None:
            values = over[kept]
            channel = _channel(
                "surplus", "Too much material, share of what flows", "%", values, 0.0, max(values.max(), 1.0)
            )
            out.append(channel | {"reverse": True})
    for name, label, unit in (
        ("sigma", "Distance from singularity, σ", ""),
        ("wrist_deg", "Wrist: joint 5 from straight", "°"),
        ("limit_margin_deg", "Distance from the nearest end stop", "°"),
        ("clearance_mm", "Least distance of two bodies beyond the tip", "mm"),
    ):
        if name in plan.series:
            values = plan.series[name][kept]
            finite = values[np.isfinite(values)]
            if len(finite):
                low = finite.min()
                out.append(_channel(name, label, unit, values, low, max(finite.max(), low + 1e-6)))
    if "tilt_deg" in plan.series and len(kept):
        lean = plan.series["tilt_deg"][kept]
        channel = _channel("tilt_deg", "Nozzle off the surface normal", "°", lean, 0.0, max(lean.max(), 1e-6))
        out.append(channel | {"reverse": True})
    return out


def _channel(key: str, label: str, unit: str, values: Array, low: float, high: float) -> dict[str, Any]:
    return {"key": key, "label": label, "unit": unit, "values": values, "min": float(low), "max": float(high)}


def _line(x: Array, y: Array, z: Array, line: dict[str, Any]) -> dict[str, Any]:
    return {"type": "scatter3d", "mode": "lines", "x": x, "y": y, "z": z, "line": line, "showlegend": False}


def _place_traces(places: Sequence[Place]) -> list[dict[str, Any]]:
    if not places:
        return []
    # Several things are often worst at one and the same sample: one mark, all its letters.
    samples = list(dict.fromkeys(place.sample for place in places))
    groups = [[place for place in places if place.sample == sample] for sample in samples]
    trace = _marks(np.array([g[0].point for g in groups]), [" ".join(p.letter for p in g) for g in groups], size=7)
    text = ["<br>".join(f"{p.letter}: {p.what}, {p.value}" for p in g) for g in groups]
    return [trace | {"hovertext": text, "hoverinfo": "text", "name": "worst places", "showlegend": False}]


def _marks(points: Array, letters: list[str], size: int) -> dict[str, Any]:
    return {
        "type": "scatter3d",
        "mode": "markers+text",
        "x": points[:, 0].astype(np.float32),
        "y": points[:, 1].astype(np.float32),
        "z": points[:, 2].astype(np.float32),
        "text": letters,
        "textposition": "top center",
        "textfont": {"size": 15, "color": ALARM},
        "marker": {"size": size, "symbol": "diamond", "color": ALARM, "line": {"width": 2, "color": PAPER}},
    }


def _extent(traces: Sequence[dict[str, Any]]) -> tuple[Array, Array]:
    """Corners (3,), (3,) of the box round all traces, a little larger than they are."""
    each = [np.concatenate([trace[name] for trace in traces] or [np.zeros(1)]) for name in "xyz"]
    low, high = (np.array([np.nanmin(v) for v in each]), np.array([np.nanmax(v) for v in each]))
    pad = 0.03 * max(float((high - low).max()), 1.0)
    return low - pad, high + pad


def _facing(beads: Sequence[Bead], failed: int | None, point_mm: Sequence[float] | None) -> Array:
    """Outward normal at the place, else the mean over the failed bead, else over all beads."""
    shown = beads if failed is None else [beads[failed]]
    if not shown:
        return np.zeros(3)
    if point_mm is None:
        return np.mean([np.mean(bead.normals, axis=0) for bead in shown], axis=0)
    points, normals = (np.concatenate([getattr(bead, name) for bead in shown]) for name in ("points", "normals"))
    return normals[np.linalg.norm(points - np.asarray(point_mm) * 1e-3, axis=1).argmin()]


def _layer_words(layers: NDArray[np.integer]) -> str:
    low, high = int(layers[0]) + 1, int(layers[-1]) + 1
    return str(low) if low == high else f"{low} to {high}"
