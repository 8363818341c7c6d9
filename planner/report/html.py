"""report.html of a plan: verdict, scene, the list of what is judged, curves over time, and how it was made."""

from __future__ import annotations

import shlex
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from markupsafe import Markup

from planner.plan.by_layer import AGES, layer_times
from planner.report import page
from planner.report.charts import joint_charts, time_charts
from planner.report.extruder import events_section, materials_section
from planner.report.joints import shown_units
from planner.report.judged import JudgedList, judged
from planner.report.places import check_advice, dips_section, without_stops
from planner.report.robustness import robustness_section
from planner.report.roll_map import roll_map_figures, roll_map_section
from planner.report.scene import plan_scene
from planner.report.templates import render
from planner.report.thinning import CURVE_BUDGET
from planner.report.wording import MISSING, counted, number, resumed_words

if TYPE_CHECKING:
    from planner.plan import Plan

# ----------------------------------------------------------------------------------------------------
# The scene with its player.

PACES = (1, 2, 5, 10, 20, 50)
USUAL_PACE = 5


def stage(*, name: str, moves: bool, layers: int, dips: bool, marks: bool) -> dict[str, Any]:
    """What stage.html shows: the scene with its controls; also its player and colours if it moves."""
    shown = {"name": name, "moves": moves, "layers": layers, "dips": dips, "marks": marks}
    return shown | {"paces": PACES, "usual_pace": USUAL_PACE}


# ----------------------------------------------------------------------------------------------------
# The whole report.

DEFAULT_DT = 0.004
MOST_LAYERS = 200  # in the table


FORECAST = Markup("<!-- forecast -->")  # placeholder for what is known only once all programs are written


def _no_forecast() -> tuple[str, ...]:
    return ()


def write_report(plan: Plan, path: Path, forecast: Callable[[], Sequence[str]] = _no_forecast) -> None:
    """Write one self-contained report.html, at most 8 MB however long the plan.

    forecast: what controllers will make of the plan's programs, in sentences; called when everything else is drawn.

    `plan.settings["overrides"]`, if present, holds the `dotted.key=value` arguments of the command line.
    Raises OutputError if `path` cannot be written.
    """
    listed = judged(plan)
    places = listed.places
    scene = plan_scene(plan, places)
    curves, joints = time_charts(plan), joint_charts(plan)
    charts = [
        {"time": True} | {k: chart[k] for k in ("key", "traces", "layout", "ranges") if k in chart}
        for chart in curves + joints
    ]
    t = plan.trajectory
    others = [name for name in plan.baseline if name != plan.strategy]
    text = page.page(
        "plan",
        f"{plan.name}: {'verified' if plan.verified else 'not verified'}",
        {"scene": scene, "charts": charts, "roll_map": roll_map_figures(plan)},
        **stage(
            name=plan.problem.name,
            moves=bool(t.deposit.any()),
            layers=plan.layers,
            dips=bool(plan.dips),
            marks=any(place.letter for place in places),
        ),
        header=_header(plan),
        plan=plan,
        t=t,
        scene=scene,
        budget=CURVE_BUDGET,
        listed=listed,
        rest_told=_rest_told(listed),
        others=others,
        forecast=FORECAST,
        dips_told=_dips_told(plan),
        dips_section=dips_section(plan, listed.dips_places),
        layer_table=_layers_section(plan),
        layers_told=_layers_told(plan),
        materials=materials_section(plan),
        events=events_section(plan),
        robustness=robustness_section(plan),
        curves=curves,
        roll_map=roll_map_section(plan),
        joints=_joint_rows(plan),
        joint_charts=joints,
        command=_command(plan),
        making=_making(plan),
    )
    sentences = forecast()
    section = render("forecast", sentences=sentences) if sentences else ""
    page.write_text(Path(path), text.replace(FORECAST, section, 1))


def _layers_section(plan: Plan) -> Markup:
    """HTML of the layers in time; empty if there is only one."""
    layers = layer_times(plan)
    if len(layers) < 2:
        return Markup("")
    spec = plan.problem.process.interlayer_time
    least, most = (None, None) if spec is None else (spec.least, spec.most)
    left_out = max(len(layers) - MOST_LAYERS, 0)
    return render("layers", layers=layers[:MOST_LAYERS], left_out=left_out, least=least, most=most)


def _layers_told(plan: Plan) -> str:
    """The range of ages at which layers are laid on each other, in words."""
    if AGES not in plan.series:
        return "no layer lies on another"
    ages = plan.series[AGES]
    return f"laid on what is {number(np.nanmin(ages), 1)} to {number(np.nanmax(ages), 1)} s old"


def _rest_told(listed: JudgedList) -> str:
    """How many rows are folded, and how many of them are checks."""
    rows = [row for _, rows in listed.rest for row in rows]
    holding = sum(row.ok is True for row in rows)
    return f"{counted(len(rows), 'row')}, of which {counted(holding, 'check')}; {'it holds' if holding == 1 else 'all hold'}"


def _dips_told(plan: Plan) -> str:
    """The number of dips and their cost, in words."""
    dips = without_stops(plan.dips)
    return f"{counted(len(dips), 'dip')}, {number(sum(dip.lost for dip in dips), 2)} s lost" if dips else "none"


def _header(plan: Plan) -> Markup:
    """Name, robots, size and verdict."""
    robots = [plan.cell.arm_robot, *([plan.cell.holder_robot] if plan.cell.holder_robot else [])]
    return render(
        "plan_header",
        plan=plan,
        t=plan.trajectory,
        robots=[robot.name for robot in robots],
        beads=plan.metrics.get("beads", len(plan.beads)),
        layers=plan.metrics.get("layers", plan.layers),
        resumed=resumed_words(plan) if plan.first_bead else "",
        failed=[(check, check_advice(check.name, plan, check.sample)) for check in plan.checks if not check.ok],
    )


def _joint_rows(plan: Plan) -> list[dict[str, str]]:
    """How much of its range each joint uses."""
    scale, units = shown_units(plan.cell)
    q, low, high = (scale * values for values in (plan.trajectory.q, plan.cell.limits.q_min, plan.cell.limits.q_max))
    after = [" mm" if unit == "mm" else "°" for unit in units]
    margin = np.minimum(q.min(axis=0) - low, high - q.max(axis=0))
    return [
        {
            "name": name,
            "used": f"{number(q[:, k].min(), 1)} to {number(q[:, k].max(), 1)}{after[k]}",
            "allowed": _range(low[k], high[k], after[k]),
            "margin": number(margin[k], 1) + after[k] if np.isfinite(margin[k]) else MISSING,
        }
        for k, name in enumerate(plan.cell.joint_names)
    ]


def _making(plan: Plan) -> list[tuple[str, list[tuple[str, str]]]]:
    """Captions and rows of the tables that say how a plan was made."""
    robots = [robot for robot in (plan.cell.arm_robot, plan.cell.holder_robot) if robot is not None]
    return [
        ("Settings", page.flat({k: v for k, v in plan.settings.items() if k != "overrides"})),
        ("Computing time", [(stage, f"{seconds:.2f} s") for stage, seconds in plan.timing_s.items()]),
        ("Versions", page.flat(plan.versions)),
        (
            "Assumed, not published by the maker: set your own in the problem file",
            [(robot.name, ", ".join(robot.assumed)) for robot in robots if robot.assumed],
        ),
    ]


def _command(plan: Plan) -> str:
    words = ["python", "-m", "planner.solve", Path(plan.problem.file).name, "--strategy", plan.strategy]
    if abs(plan.trajectory.dt - DEFAULT_DT) > 1e-12:
        words += ["--dt", f"{plan.trajectory.dt:g}"]
    if plan.first_bead:
        words += ["--from-bead", str(plan.first_bead)]
    if plan.headroom is not None:
        words += ["--tolerance", plan.headroom.tolerance.words]
    for override in plan.settings.get("overrides", ()):
        words += ["--set", str(override)]
    return shlex.join(words)


def _range(low: float, high: float, unit: str) -> str:
    endless = not (np.isfinite(low) or np.isfinite(high))
    return "unlimited" if endless else f"{number(low, 0)} to {number(high, 0)}{unit}"
