"""Curves over time, as plain plotly dictionaries: each thinned separately, extremes kept."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from planner.base.arrays import Array
from planner.plan.by_layer import AGES
from planner.report.extruder import even_flow, flow_note, pushed, pushes_otherwise
from planner.report.joints import shown_units
from planner.report.scene import INK, PAPER
from planner.report.thinning import CURVE_BUDGET, keep_minima, stretches, thin_curve, with_gaps

if TYPE_CHECKING:
    from planner.plan import Plan

# Okabe and Ito's colours, which any eye can distinguish; dashes distinguish them in print.
BLUE, ORANGE, GREEN, GREY = "#0072b2", "#d55e00", "#007d5c", "#9aa7b4"
LIMIT = "#1b2733"
MAX_LAYER_LINES = 60
CHART_HEIGHT = 175
JOINT_HEIGHT = 190


def time_charts(plan: Plan) -> list[dict[str, Any]]:
    """Charts of the whole plan: speed, flow, singularity, margins, shares of the joints' limits, lean."""
    charts = [_speed(plan), _flow(plan)]
    if "sigma" in plan.series:
        low = float(plan.metrics.get("sigma_min", np.nan))
        charts.append(
            _chart(
                "sigma",
                "Singularity margin",
                "σ of the arm alone",
                [_curve(plan, plan.series["sigma"], "σ", BLUE, "%{y:.4f}")],
                note="Smallest singular value of the arm's Jacobian at the tip. 0 is a singularity: larger is better.",
                lines=[(low, f"least while depositing {low:.4f}")] if np.isfinite(low) else [],
            )
        )
    margins = [
        _curve(plan, plan.series[name], label, colour, "%{y:.1f}°")
        for name, label, colour in (
            ("wrist_deg", "wrist margin", BLUE),
            ("limit_margin_deg", "joint range", ORANGE),
        )
        if name in plan.series
    ]
    if margins:
        note = "How far the wrist is from straight, and the closest joint from its end stop. Larger is better."
        charts.append(_chart("margins", "Margins", "degrees", margins, note=note, from_zero=True))
    ratios = [
        _curve(plan, plan.series[name], label, colour, "%{y:.3f}")
        for name, label, colour in (
            ("velocity_ratio", "speed", BLUE),
            ("acceleration_ratio", "acceleration", ORANGE),
            ("jerk_ratio", "jerk", GREEN),
        )
        if name in plan.series
    ]
    if ratios:
        note = "The busiest joint at each moment, as a share of its limit. Above 1 the robot cannot follow."
        charts.append(
            _chart(
                "ratios",
                "Joint limits used",
                "share of limit",
                ratios,
                note=note,
                lines=[(1.0, "limit")],
                from_zero=True,
            )
        )
    if AGES in plan.series:
        charts.append(_ages(plan))
    if "tilt_deg" in plan.series:
        cone = float(np.degrees(plan.problem.process.cones.tilt))
        charts.append(
            _chart(
                "tilt",
                "Lean of the nozzle",
                "degrees",
                [_curve(plan, plan.series["tilt_deg"], "from the surface normal", BLUE, "%{y:.2f}°")],
                note="How far the nozzle's axis is from the surface normal while depositing. 0 is upright.",
                lines=[(cone, f"allowed {cone:g}°")],
                from_zero=True,
            )
        )
    for chart in charts:
        chart["layout"]["shapes"] = chart["layout"].get("shapes", []) + _layer_lines(plan)
    return charts


def joint_charts(plan: Plan) -> list[dict[str, Any]]:
    """A small chart per joint, degrees or mm over time, over the whole range between its end stops."""
    charts = []
    limits = plan.cell.limits
    scale, units = shown_units(plan.cell)
    for k, name in enumerate(plan.cell.joint_names):
        q = scale[k] * plan.trajectory.q[:, k]
        unit, mark = ("degrees", "°") if units[k] == "deg" else ("mm", " mm")
        ends = [(float(scale[k] * v), "") for v in (limits.q_min[k], limits.q_max[k]) if np.isfinite(v)]
        low, high = (min([q.min(), *(v for v, _ in ends)]), max([q.max(), *(v for v, _ in ends)]))
        pad = 0.06 * max(high - low, 1.0)
        chart = _chart(
            f"joint-{k}",
            name,
            unit,
            [_curve(plan, q, name, BLUE, f"%{{y:.2f}}{mark}")],
            lines=ends,
            height=JOINT_HEIGHT,
        )
        chart["layout"]["yaxis"]["range"] = [float(low - pad), float(high + pad)]
        fit = 0.06 * max(float(np.ptp(q)), 0.1)
        chart["ranges"] = {"limits": [float(low - pad), float(high + pad)], "fit": [q.min() - fit, q.max() + fit]}
        chart["ranges"]["fit"] = [float(v) for v in chart["ranges"]["fit"]]
        charts.append(chart)
    return charts


def _speed(plan: Plan) -> dict[str, Any]:
    traj = plan.trajectory
    commanded, speed = plan.commanded * 1e3, traj.speed * 1e3
    travel = _stretches(traj.t, speed, ~traj.deposit, None, "travel", GREY, 1)
    printing = _stretches(traj.t, speed, traj.deposit, traj.bead, "depositing", BLUE, 1.6)
    curves, lines = [travel, printing], []
    if np.ptp(commanded) > 0.0:
        own = _stretches(traj.t, commanded[traj.bead], traj.deposit, traj.bead, "commanded", GREY, 1)
        curves.append(own)
    else:
        lines.append((float(commanded[0]), f"commanded {commanded[0]:g} mm/s"))
    top = max(float(commanded.max()), float(speed[traj.deposit].max(initial=0.0))) * 1.2
    chart = _chart(
        "speed",
        "Tip speed relative to the part",
        "mm/s",
        curves,
        lines=lines,
        note="Dips are where a joint cannot follow. Travel is faster than this window: double-click shows it all.",
    )
    chart["layout"]["yaxis"]["range"] = [0.0, top]
    return chart


def _flow(plan: Plan) -> dict[str, Any]:
    curves = [_curve(plan, even_flow(plan.trajectory) * 1e9, "laid down", BLUE, "%{y:.3f} mm³/s")]
    if pushes_otherwise(plan):
        curves.insert(0, _curve(plan, pushed(plan) * 1e9, "pushed by the motor", ORANGE, "%{y:.3f} mm³/s"))
    return _chart("flow", "Flow of material", "mm³/s", curves, note=flow_note(plan), from_zero=True)


def _ages(plan: Plan) -> dict[str, Any]:
    t, ages, spec = plan.trajectory, plan.series[AGES], plan.problem.process.interlayer_time
    asked = () if spec is None else ((spec.least, "at least"), (spec.most, "at most"))
    trace = _stretches(t.t, ages, np.isfinite(ages), t.bead, "interlayer time", BLUE, 1.6, "%{y:.1f} s")
    trace |= {
        "x": np.insert(trace["x"], 0, t.t[0]),
        "y": np.insert(trace["y"], 0, np.nan),
    }  # from the print's beginning
    return _chart(
        "interlayer",
        "Age of the material below",
        "s",
        [trace],
        note="How long ago the material under the nozzle was laid. Gaps are travel, first layers and bridges.",
        lines=[(value, f"{words} {value:g} s") for value, words in asked if value is not None],
        from_zero=True,
    )


def _curve(plan: Plan, y: Array, name: str, colour: str, hover: str) -> dict[str, Any]:
    kept = thin_curve(y)
    return _line(plan.trajectory.t[kept], y[kept], name, colour, 1.3, hover)


def _stretches(
    t: Array, y: Array, mask: Any, label: Any, name: str, colour: str, width: float, hover: str = "%{y:.2f} mm/s"
) -> dict[str, Any]:
    """The part of a curve where `mask` holds, with a gap between stretches."""
    index, begin, end = stretches(mask, label)
    kept = keep_minima([y[index], -y[index]], CURVE_BUDGET, np.union1d(begin, end)) if len(index) else index
    starts = np.zeros(len(index), dtype=bool)
    starts[begin] = True
    breaks = np.flatnonzero(starts[kept])[1:]
    kept = index[kept]
    trace = _line(t[kept], y[kept], name, colour, width, hover)
    return trace | {"x": with_gaps(t[kept], breaks), "y": with_gaps(y[kept], breaks), "connectgaps": False}


def _line(x: Array, y: Array, name: str, colour: str, width: float, hover: str) -> dict[str, Any]:
    return {
        "type": "scatter",
        "mode": "lines",
        "x": np.asarray(x, dtype=np.float32),
        "y": np.asarray(y, dtype=np.float32),
        "name": name,
        "line": {"color": colour, "width": width},
        "hovertemplate": hover,
    }


def _chart(
    key: str,
    title: str,
    unit: str,
    traces: list[dict[str, Any]],
    *,
    note: str = "",
    lines: list[tuple[float, str]] | None = None,
    from_zero: bool = False,
    height: int = CHART_HEIGHT,
) -> dict[str, Any]:
    """A chart: `lines` are horizontal limits with their labels, `from_zero` keeps 0 in view."""
    shapes = [
        {"type": "line", "xref": "paper", "x0": 0, "x1": 1, "y0": y, "y1": y, "layer": "above"}
        | {"line": {"color": LIMIT, "width": 1.2, "dash": "dash"}}
        for y, _ in lines or []
    ]
    words = [
        {"xref": "paper", "x": 1, "xanchor": "right", "y": y, "yanchor": "bottom", "text": text, "showarrow": False}
        | {"font": {"size": 11, "color": LIMIT}, "bgcolor": "rgba(255,255,255,0.75)"}
        for y, text in lines or []
        if text
    ]
    axis = {"gridcolor": "#e6ebf0", "zeroline": False, "linecolor": "#c3ccd5", "automargin": True}
    layout: dict[str, Any] = {
        "height": height,
        "margin": {"l": 52, "r": 10, "t": 8, "b": 36},
        "paper_bgcolor": PAPER,
        "plot_bgcolor": PAPER,
        "font": {"family": "system-ui, sans-serif", "color": INK, "size": 12},
        "xaxis": axis | {"title": {"text": "time, s", "standoff": 4}},
        "yaxis": axis | {"title": {"text": unit}},
        "hovermode": "x unified",
        "showlegend": len(traces) > 1,
        "legend": {"orientation": "h", "x": 0, "y": 1, "yanchor": "bottom"},
        "shapes": shapes,
        "annotations": words,
    }
    if len(traces) > 1:
        layout["margin"]["t"] = 30
    if from_zero:
        layout["yaxis"]["rangemode"] = "tozero"
    return {"key": key, "title": title, "note": note, "traces": traces, "layout": layout}


def _layer_lines(plan: Plan) -> list[dict[str, Any]]:
    """Fine vertical lines where a new layer begins, unless there are too many to read."""
    traj = plan.trajectory
    layer = traj.layer[traj.deposit]
    t = traj.t[traj.deposit]
    begin = t[1:][np.diff(layer) != 0]
    if len(begin) > MAX_LAYER_LINES:
        return []
    line = {"color": "#c3ccd5", "width": 1, "dash": "dot"}
    return [
        {"type": "line", "yref": "paper", "y0": 0, "y1": 1, "x0": float(x), "x1": float(x)}
        | {"line": line, "layer": "below"}
        for x in begin
    ]
