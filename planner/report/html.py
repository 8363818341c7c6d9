"""report.html of a plan: verdict, first screen, summary, scene, checks, curves over time, and how it came about."""

from __future__ import annotations

import math
import shlex
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from markupsafe import Markup

from planner.base.arrays import Array
from planner.report import page
from planner.report.charts import joint_charts, time_charts
from planner.report.extruder import events_section, materials_section
from planner.report.joints import shown_units
from planner.report.places import approaches_section, dips_section, places_of, without_stops
from planner.report.robustness import robustness_section
from planner.report.roll_map import roll_map_figures, roll_map_section
from planner.report.scene import plan_scene
from planner.report.templates import render
from planner.report.thinning import CURVE_BUDGET
from planner.report.wording import MISSING, SHORT, counted, distance, duration, number, resumed_words, summary_rows

if TYPE_CHECKING:
    from planner.plan import Plan

# ----------------------------------------------------------------------------------------------------
# The figures that decide, beside the baseline's, and the scene with its player.

# metric, label, unit, factor, decimals, whether more is better
DECIDING = (
    ("at_speed_fraction", SHORT["at_speed_fraction"], "%", 100.0, 1, True),
    ("speed_min_mm_s", SHORT["speed_min_mm_s"], "mm/s", 1.0, 1, True),
    ("print_time_s", SHORT["print_time_s"], "", 1.0, 0, False),
    ("joints", "Joint limits used", "%", 100.0, 0, False),  # the worst of JOINTS
    ("sigma_min", SHORT["sigma_min"], "", 1.0, 3, True),
    ("joint_limit_margin_deg", SHORT["joint_limit_margin_deg"], "°", 1.0, 1, True),
    ("clearance_min_mm", SHORT["clearance_min_mm"], "mm", 1.0, 1, True),
)
JOINTS = ("velocity_ratio_max", "acceleration_ratio_max", "jerk_ratio_max")
PACES = (1, 2, 5, 10, 20, 50)
USUAL_PACE = 5


def deciding_rows(plan: Plan, rival: str | None) -> list[tuple[str, str, list[tuple[str, bool, bool]]]]:
    """The figures that decide: label, unit, and of this plan and its rival the text, whether too much, whether better."""
    other = plan.baseline[rival] if rival else {}
    rows = []
    for key, label, unit, factor, digits, more in DECIDING:
        mine, its = _metric(plan.metrics, key), _metric(other, key)
        if mine is None and its is None:
            continue
        better = _better(mine, its, more, factor, digits), _better(its, mine, more, factor, digits)
        pairs = zip((mine, its) if rival else (mine,), better, strict=False)
        rows.append((label, unit, [(*_cell(value, key, factor, digits), best) for value, best in pairs]))
    return rows


def stage(*, name: str, moves: bool, layers: int, dips: bool, marks: bool) -> dict[str, Any]:
    """What stage.html shows: the scene with its controls; with its player and its colours where it moves."""
    shown = {"name": name, "moves": moves, "layers": layers, "dips": dips, "marks": marks}
    return shown | {"paces": PACES, "usual_pace": USUAL_PACE}


def _metric(metrics: Mapping[str, float], key: str) -> float | None:
    """A metric, or the worst share of the joints' limits; None where it is not known."""
    if key == "joints":
        found = [metrics[each] for each in JOINTS if each in metrics]
        return max(found) if found else None
    value = metrics.get(key)
    return None if value is None or math.isnan(value) else value


def _better(value: float | None, other: float | None, more: bool, factor: float, digits: int) -> bool:
    """Whether a value is better than the other one, as both are shown."""
    if value is None or other is None:
        return False
    mine, its = round(value * factor, digits), round(other * factor, digits)
    return mine > its if more else mine < its


def _cell(value: float | None, key: str, factor: float, digits: int) -> tuple[str, bool]:
    """Text of a figure, and whether it is more than the limits allow."""
    if value is None:
        return MISSING, False
    if key == "print_time_s":
        return duration(value), False
    return distance(key, value * factor, digits), key == "joints" and value > 1.0 + 1e-9


# ----------------------------------------------------------------------------------------------------
# The whole report.

DEFAULT_DT = 0.004


FORECAST = Markup("<!-- forecast -->")  # the place of what is known only when all programs are written


def _no_forecast() -> tuple[str, ...]:
    return ()


def write_report(plan: Plan, path: Path, forecast: Callable[[], Sequence[str]] = _no_forecast) -> None:
    """Write one self-contained report.html, at most 8 MB however long the plan.

    forecast: what controllers will make of the plan's programs, in sentences; asked for when all else is drawn.

    `plan.settings["overrides"]`, if there, holds the `dotted.key=value` arguments of the command line.
    Raises OutputError where `path` cannot be written.
    """
    places = places_of(plan)
    scene = plan_scene(plan, places)
    curves, joints = time_charts(plan), joint_charts(plan)
    charts = [
        {"time": True} | {k: chart[k] for k in ("key", "traces", "layout", "ranges") if k in chart}
        for chart in curves + joints
    ]
    t, listed = plan.trajectory, [place for place in places if place.letter]
    others = [name for name in plan.baseline if name != plan.strategy]
    rival = others[0] if others else None
    ratios = _joint_ratios(plan)
    text = page.page(
        "plan",
        f"{plan.name}: {'verified' if plan.verified else 'not verified'}",
        {"scene": scene, "charts": charts, "roll_map": roll_map_figures(plan)},
        **stage(
            name=plan.problem.name,
            moves=bool(t.deposit.any()),
            layers=plan.layers,
            dips=bool(plan.dips),
            marks=bool(listed),
        ),
        header=_header(plan),
        plan=plan,
        t=t,
        scene=scene,
        budget=CURVE_BUDGET,
        rival=rival,
        deciding=deciding_rows(plan, rival),
        places=[(place, float(t.t[place.sample])) for place in listed],
        others=others,
        summary=summary_table(plan.strategy, plan.metrics, plan.baseline),
        forecast=FORECAST,
        failed=sum(not check.ok for check in plan.checks),
        dips_told=_dips_told(plan),
        dips_section=dips_section(plan),
        materials=materials_section(plan),
        events=events_section(plan),
        approaches=approaches_section(plan, places),
        robustness=robustness_section(plan),
        curves=curves,
        roll_map=roll_map_section(plan),
        ratios=list(ratios),
        joints=_joint_rows(plan, ratios),
        joint_charts=joints,
        command=_command(plan),
        making=_making(plan),
    )
    sentences = forecast()
    section = render("forecast", sentences=sentences) if sentences else ""
    page.write_text(Path(path), text.replace(FORECAST, section, 1))


def summary_table(strategy: str, metrics: Mapping[str, float], baseline: Mapping[str, Mapping[str, float]]) -> Markup:
    """HTML table: the chosen strategy's metrics beside the baselines'; the best of a row is bold."""
    others = {name: values for name, values in baseline.items() if name != strategy}
    return render("summary", strategy=strategy, others=list(others), rows=summary_rows([metrics, *others.values()]))


def _dips_told(plan: Plan) -> str:
    """How many dips there are, and what they cost."""
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
        failed=[check for check in plan.checks if not check.ok],
    )


def _joint_ratios(plan: Plan) -> dict[str, Array]:
    """Share (n, joints) of each limit that joints use, by what it limits."""
    return {
        name: np.abs(plan.series[key]).reshape(len(plan.trajectory), -1)
        for name, key in (("speed", "velocity_ratio"), ("acceleration", "acceleration_ratio"), ("jerk", "jerk_ratio"))
        if key in plan.series and np.ndim(plan.series[key]) == 2
    }


def _joint_rows(plan: Plan, ratios: Mapping[str, Array]) -> list[dict[str, Any]]:
    """What each joint uses of its range, and the greatest of its ratios."""
    scale, units = shown_units(plan.cell)
    q, low, high = (scale * values for values in (plan.trajectory.q, plan.cell.limits.q_min, plan.cell.limits.q_max))
    after = [" mm" if unit == "mm" else "" for unit in units]
    margin = np.minimum(q.min(axis=0) - low, high - q.max(axis=0))
    return [
        {
            "name": name,
            "used": f"{number(q[:, k].min(), 1)} to {number(q[:, k].max(), 1)}{after[k]}",
            "allowed": _range(low[k], high[k]) + after[k],
            "margin": number(margin[k], 1) + after[k] if np.isfinite(margin[k]) else MISSING,
            "ratios": [float(np.nanmax(values[:, k])) for values in ratios.values()],
        }
        for k, name in enumerate(plan.cell.joint_names)
    ]


def _making(plan: Plan) -> list[tuple[str, list[tuple[str, str]]]]:
    """Captions and pairs of the tables that say how a plan was made."""
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


def _range(low: float, high: float) -> str:
    endless = not (np.isfinite(low) or np.isfinite(high))
    return "no end" if endless else f"{number(low, 0)} to {number(high, 0)}"
