"""report.html of a plan: verdict, first screen, summary, scene, checks, curves over time, and how it came about."""

from __future__ import annotations

import math
import shlex
from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from planner.plan.measures import CHECKS
from planner.report import page as frame
from planner.report.charts import joint_charts, time_charts
from planner.report.extruder import events_section, materials_section
from planner.report.places import ReportPlace, approaches_section, dips_section, places_of, where_words
from planner.report.robustness import robustness_section
from planner.report.roll_map import roll_map_figures, roll_map_section
from planner.report.scene import plan_scene
from planner.report.thinning import CURVE_BUDGET
from planner.report.wording import (
    CHECK_NAMES,
    MISSING,
    SHORT,
    counted,
    distance,
    duration,
    number,
    resumed_words,
    significant,
    summary_table,
)

if TYPE_CHECKING:
    from planner.plan import Check, Plan
    from planner.report.places import ReportPlace

# ----------------------------------------------------------------------------------------------------
# The first screen of a report: the figures that decide beside the baseline's, the places to go to, the scene and its player.

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


def deciding_table(plan: Plan) -> str:
    """The figures that decide, of this plan and of the baseline; the better one is bold and has a mark."""
    name = next((name for name in plan.baseline if name != plan.strategy), None)
    other = None if name is None else plan.baseline[name]
    rows = []
    for key, label, unit, factor, digits, more in DECIDING:
        mine, its = _metric(plan.metrics, key), _metric(other or {}, key)
        if mine is None and its is None:
            continue
        cells = [_cell(mine, key, factor, digits, _better(mine, its, more, factor, digits))]
        if name is not None:
            cells.append(_cell(its, key, factor, digits, _better(its, mine, more, factor, digits)))
        text = f"{label}<span class=unit>{f', {unit}' if unit else ''}</span>"
        rows.append(f"<tr><th scope=row>{text}</th>{''.join(cells)}</tr>")
    head = f"<th scope=col class=chosen>this plan<small>{escape(plan.strategy)}</small></th>"
    if name is not None:
        refused = "" if other else "<small>no plan</small>"
        head += f"<th scope=col>{escape(name)}{refused}</th>"
    return (
        f"<table class=deciding><thead><tr><th class=left>what decides</th>{head}</tr></thead>"
        f"<tbody>{''.join(rows)}</tbody></table>"
    )


def places_list(places: Sequence[ReportPlace], times: Sequence[float | None]) -> str:
    """Buttons that bring scene and time to each place; nothing where there is none."""
    items = "".join(
        f"<li><button type=button data-place={k} aria-pressed=false class={place.kind}><span class=letter>{place.letter}"
        f"</span><span><b>{escape(place.what)}</b><small>{escape(place.value)}"
        f"{'' if t is None else f'; {t:.2f} s'}</small></span></button></li>"
        for k, (place, t) in enumerate(zip(places, times, strict=True))
    )
    return f"<h2 class=small>Places to look at</h2><ol class=places>{items}</ol>" if items else ""


def stage(*, name: str, moves: bool, layers: int, dips: bool, marks: bool) -> str:
    """The scene with its controls; with its player and its colours where it moves."""
    grow = "<label><input type=checkbox id=grow autocomplete=off> beads as they are laid</label>"
    paces = "".join(f"<option value={p}{' selected' if p == USUAL_PACE else ''}>{p}×</option>" for p in PACES)
    player = (
        "<div class='player needs-scene'><button type=button id=play aria-label=Play>▶</button>"
        "<label class=pace><span class=unseen>speed of playing</span><select id=pace autocomplete=off>"
        f"{paces}</select></label>"
        "<div class=timeline><div id=track aria-hidden=true></div>"
        "<input type=range id=time min=0 max=1 step=any value=0 autocomplete=off aria-label='time of the print'></div></div>"
        "<p id=clock class=needs-scene aria-live=off></p>"
    )
    legend = (
        "<div class='legend needs-scene'><label>Colour by <select id=colour autocomplete=off></select></label>"
        "<div class=bar><span id=scale-min></span><span id=scale></span><span id=scale-max></span></div>"
        "<span class=unseen id=scale-name></span><small>light is where it gets tight</small></div>"
    )
    filters = (
        f"<label{' hidden' if layers < 2 else ''}>Layers <input type=range id=layers autocomplete=off min=0 max=0 step=1>"
        f"<output id=layer-words></output></label><label{' hidden' if layers < 2 else ''}>"
        "<input type=checkbox id=only autocomplete=off> only this layer</label>"
        "<span class=range role=group aria-label='show only values between'>Show only values from "
        "<input type=range id=from min=0 max=1000 value=0 step=1 autocomplete=off aria-label='least value shown'> to "
        "<input type=range id=to min=0 max=1000 value=1000 step=1 autocomplete=off aria-label='greatest value shown'>"
        "<output id=range-words></output></span>"
    )
    shown = "<label><input type=checkbox id=robots autocomplete=off checked> robots</label>"
    shown += "<label><input type=checkbox id=through autocomplete=off> see through the part</label>"
    if marks:
        shown += "<label><input type=checkbox id=letters-shown autocomplete=off checked> places</label>"
    if dips:
        shown += "<label><input type=checkbox id=dips autocomplete=off checked> dips in speed</label>"
    views = "".join(
        f"<button type=button data-view={key}>{words}</button>"
        for key, words in (("cell", "Whole cell"), ("part", "Part"))
    )
    return (
        f"<section id=stage aria-label='The print in three dimensions'>"
        f"<div class=screen><div id=view tabindex=0 role=img aria-label='{escape(name, quote=True)}: robots, part and "
        "print. Space plays and pauses, left and right arrow step by a second.'></div>"
        "<div id=letters class=needs-scene></div>"
        f"<div class='views needs-scene'>{views}<select id=ride autocomplete=off aria-label='where the camera stands'>"
        "<option value=cell>stand in the cell</option><option value=part>ride with the part</option></select></div>"
        "<div id=card-box hidden><button type=button id=card-close aria-label='Close'>×</button>"
        "<div id=card role=status></div></div>"
        f"{legend if moves else ''}"
        f"<div id=no-scene hidden><p><b>No scene:</b> <span id=no-scene-why></span> Charts and tables work without.</p></div></div>"
        f"{player if moves else ''}"
        f"<div class='controls needs-scene'>{grow + filters if moves else ''}{shown}</div></section>"
    )


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


def _cell(value: float | None, key: str, factor: float, digits: int, better: bool) -> str:
    text = MISSING if value is None else distance(key, value * factor, digits)
    if value is not None and key == "print_time_s":
        text = duration(value)
    if value is not None and key == "joints" and value > 1.0 + 1e-9:
        text = f"<span class=bad>✗ {text}</span>"
    mark = "<i title=better>▲</i><span class=unseen>better: </span>" if better else ""
    return f"<td class=n>{mark}{f'<b>{text}</b>' if better else text}</td>"


# ----------------------------------------------------------------------------------------------------
# report.html of a plan: verdict, summary, scene, checks, curves over time, and how it came about.

DEFAULT_DT = 0.004


def write_report(plan: Plan, path: Path) -> None:
    """Write one self-contained report.html, at most 8 MB however long the plan.

    `plan.settings["overrides"]`, if there, holds the `dotted.key=value` arguments of the command line.
    Raises OutputError where `path` cannot be written.
    """
    places = places_of(plan)
    scene = plan_scene(plan, places)
    curves, joints = time_charts(plan), joint_charts(plan)
    body = "".join(
        [
            _first_screen(plan, places),
            _summary(plan),
            _notes(plan.toolpath.notes),
            _worst(plan, places),
            dips_section(plan),
            materials_section(plan),
            events_section(plan),
            _checks(plan.checks),
            approaches_section(plan, places),
            robustness_section(plan),
            _curves(curves),
            roll_map_section(plan),
            _joints(plan, joints),
            _making(plan),
        ]
    )
    charts = [
        {"time": True} | {k: chart[k] for k in ("key", "traces", "layout", "ranges") if k in chart}
        for chart in curves + joints
    ]
    words = "verified" if plan.verified else "not verified"
    title = f"{plan.name}: {words}"
    footer = _footer(plan, scene)
    figures = {"scene": scene, "charts": charts, "roll_map": roll_map_figures(plan)}
    frame.write_text(Path(path), frame.page(title, _header(plan), body, footer, figures))


def _header(plan: Plan) -> str:
    m, traj = plan.metrics, plan.trajectory
    robots = [plan.cell.arm_robot.name] + ([plan.cell.holder_robot.name] if plan.cell.holder_robot else [])
    beads, layers = m.get("beads", len(plan.beads)), m.get("layers", plan.layers)
    about = (
        f"{escape(' with '.join(robots))}, strategy <b>{escape(plan.strategy)}</b>; {counted(beads, 'bead')} in "
        f"{counted(layers, 'layer')}, {number(len(traj), 0)} samples of {traj.dt * 1e3:g} ms"
    )
    if plan.first_bead:
        about += f"; {resumed_words(plan)}"
    failed = [check for check in plan.checks if not check.ok]
    count = len(plan.checks)
    room = plan.headroom
    if not failed and room is not None and not room.holds:
        detail = (
            f"<p>All {count} checks hold where the part was planned to stand, but not wherever it may stand within "
            f"{escape(room.tolerance.words)}, so no robot code was written.</p>"
        )
        banner = frame.verdict(False, "Not verified within the tolerance", detail)
    elif not failed:
        detail = (
            f"<p>All {count} independent checks of the finished motion hold. Robot code may be written from it.</p>"
        )
        banner = frame.verdict(True, "Verified: this motion can be printed", detail)
    else:
        items = "".join(
            f"<li><b>{escape(check.name.translate(CHECK_NAMES))}</b>: {significant(check.worst)} {escape(check.unit)}, "
            f"limit {significant(check.limit)} {escape(check.unit)}; {escape(check.where)}</li>"
            for check in failed
        )
        what = "check fails" if len(failed) == 1 else "checks fail"
        detail = f"<p>{len(failed)} of {count} {what}, so no robot code was written:</p><ul>{items}</ul>"
        banner = frame.verdict(False, "Not verified: do not print this", detail)
    return f"<div class=name><h1>{escape(plan.problem.name)}</h1><p class=about>{about}</p></div>{banner}"


def _first_screen(plan: Plan, places: list[ReportPlace]) -> str:
    listed = [place for place in places if place.letter]
    times = [float(plan.trajectory.t[place.sample]) for place in listed]
    scene = stage(
        name=plan.problem.name,
        moves=bool(plan.trajectory.deposit.any()),
        layers=plan.layers,
        dips=bool(plan.dips),
        marks=bool(listed),
    )
    return (
        f"<div class=first><div class=decides>{deciding_table(plan)}</div>{scene}"
        f"<div class=goto>{places_list(listed, times)}</div></div>"
    )


def _summary(plan: Plan) -> str:
    others = [name for name in plan.baseline if name != plan.strategy]
    note = "What this plan reaches"
    if others:
        note += f", beside {escape(', '.join(others))} on the same problem. Bold is the better of a row"
    return f"<h2>Summary</h2><p class=note>{note}.</p>{summary_table(plan.strategy, plan.metrics, plan.baseline)}"


def _notes(notes: tuple[str, ...]) -> str:
    """What was left out of the input or changed in it; nothing where there is nothing to tell."""
    if not notes:
        return ""
    items = "".join(f"<li>{escape(note)}</li>" for note in notes)
    return f"<h2>What became of the input</h2><ul>{items}</ul>"


def _worst(plan: Plan, places: list[ReportPlace]) -> str:
    rows = "".join(
        f"<tr><td><span class=letter>{place.letter}</span></td><th scope=row>{escape(place.what)}</th>"
        f"<td class=n>{escape(place.value)}</td><td class=n data-unit=s>{plan.trajectory.t[place.sample]:.2f}</td>"
        f"<td class=where>{escape(where_words(plan, place.sample))}</td></tr>"
        for place in places
        if place.kind in ("fail", "worst")
    )
    if not rows:
        return ""
    return (
        "<h2>Worst places</h2><p class=note>The letters are those of the scene.</p>"
        "<div class=wide><table class=stack><thead><tr><th></th><th class=left>what</th>"
        f"<th>value</th><th>time, s</th><th class=left>where</th></tr></thead><tbody>{rows}</tbody></table></div>"
    )


def _checks(checks: tuple[Check, ...]) -> str:
    rows = "".join(
        f"<tr{'' if check.ok else ' class=bad'}><th scope=row>{escape(check.name.translate(CHECK_NAMES))}"
        f"{_asked(check)}</th><td class=n>{significant(check.worst)}</td><td class=n>{significant(check.limit)}</td>"
        f"<td>{escape(check.unit)}</td>"
        f"<td>{'<span class=yes>✓ holds</span>' if check.ok else '<span class=bad>✗ fails</span>'}</td>"
        f"<td class=where>{escape(check.where) or MISSING}</td></tr>"
        for check in checks
    )
    return (
        "<h2>Checks</h2><p class=note>Found on the finished, sampled motion, by other kinematics, timing and search "
        "than those that planned it. Both use one model of cell, part, print and surfaces, and one routine for "
        "singular values.</p><div class=wide><table><thead><tr><th class=left>check</th><th>worst</th>"
        "<th>limit</th><th class=left>unit</th><th class=left>verdict</th><th class=left>where</th></tr></thead>"
        f"<tbody>{rows}</tbody></table></div>"
    )


def _asked(check: Check) -> str:
    """What a check asks, in small print below its name."""
    known = CHECKS.get(check.name)
    return f"<small>{escape(known.text)}</small>" if known else ""


def _curves(charts: list[dict[str, Any]]) -> str:
    each = "".join(
        f"<div class=chart><h3>{escape(chart['title'])}</h3><p>{escape(chart['note'])}</p>"
        f"<div id='chart-{chart['key']}'></div></div>"
        for chart in charts
    )
    return (
        "<h2>Along time</h2><p class=note>Drag over a stretch to come closer: all charts follow. Double-click to see "
        "everything. Click a moment to bring the scene there. Dotted uprights: a new layer begins.</p>" + each
    )


def _joints(plan: Plan, charts: list[dict[str, Any]]) -> str:
    each = "".join(
        f"<div class=chart><h3>{escape(chart['title'])}</h3><div id='chart-{chart['key']}'></div></div>"
        for chart in charts
    )
    columns = [
        (name, np.abs(plan.series[key]).reshape(len(plan.trajectory), -1))
        for name, key in (("speed", "velocity_ratio"), ("acceleration", "acceleration_ratio"), ("jerk", "jerk_ratio"))
        if key in plan.series and np.ndim(plan.series[key]) == 2
    ]
    q = np.degrees(plan.trajectory.q)
    low, high = np.degrees(plan.cell.limits.q_min), np.degrees(plan.cell.limits.q_max)
    rows = []
    for k, name in enumerate(plan.cell.joint_names):
        margin = min(q[:, k].min() - low[k], high[k] - q[:, k].max())
        shares = "".join(f"<td class=n>{_share(float(np.nanmax(values[:, k])))}</td>" for _, values in columns)
        rows.append(
            f"<tr><th scope=row>{escape(name)}</th><td class=n>{number(q[:, k].min(), 1)} to {number(q[:, k].max(), 1)}"
            f"</td><td class=n>{_range(low[k], high[k])}</td><td class=n>{number(margin, 1) if np.isfinite(margin) else MISSING}</td>{shares}</tr>"
        )
    heads = "".join(f"<th>{name}, % of limit</th>" for name, _ in columns)
    return (
        "<h2>Joints</h2><p class=note>The whole motion, travel included. Dashed lines are the end stops.</p>"
        "<div class=wide><table><thead><tr><th class=left>joint</th><th>used, °</th><th>allowed, °</th>"
        f"<th>least margin, °</th>{heads}</tr></thead><tbody>{''.join(rows)}</tbody></table></div>"
        "<div class=controls><label class=long><input type=checkbox id=fit autocomplete=off> fit the charts to the motion instead of the range"
        f"</label></div><div class=joints>{each}</div>"
    )


def _making(plan: Plan) -> str:
    settings = {k: v for k, v in plan.settings.items() if k != "overrides"}
    assumed = [
        (robot.name, ", ".join(robot.assumed))
        for robot in (plan.cell.arm_robot, plan.cell.holder_robot)
        if robot is not None and robot.assumed
    ]
    timing = [(stage, f"{seconds:.2f} s") for stage, seconds in plan.timing_s.items()]
    tables = (
        frame.pairs_table("Settings", frame.flat(settings))
        + frame.pairs_table("Computing time", timing)
        + frame.pairs_table("Versions", frame.flat(plan.versions))
        + frame.pairs_table("Assumed, not published by the maker: set your own in the problem file", assumed)
    )
    return (
        "<h2>How it was made</h2><p class=note>The same file and the same versions give the same motion, byte for "
        f"byte. To make it again, in the folder of the problem file:</p><pre>{escape(_command(plan))}</pre>"
        f"<div class=pairs>{tables}</div>"
    )


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


def _footer(plan: Plan, scene: dict[str, Any]) -> str:
    motion = ""
    if scene["motion"] is not None:
        motion = (
            f"Robots stand in the scene as at {number(len(scene['motion']['sample']), 0)} samples, joints between them "
            f"taken as moving evenly; so the tip is off by {scene['motion']['off_mm']:.2f} mm at most. "
        )
    return (
        f"Drawn from {number(len(plan.trajectory), 0)} samples. The scene shows {number(len(scene['lines']['sample']), 0)} of "
        f"{number(int(plan.trajectory.deposit.sum()), 0)} deposited ones, curves at most {number(CURVE_BUDGET, 0)} points each; what was "
        "left out lies between the extremes of its neighbours, corners and ends of lines are kept. "
        f"{motion}Tables and verdict use every sample. This file needs no network."
    )


def _range(low: float, high: float) -> str:
    endless = not (np.isfinite(low) or np.isfinite(high))
    return "no end" if endless else f"{number(low, 0)} to {number(high, 0)}"


def _share(ratio: float) -> str:
    text = number(ratio * 100, 1)
    return f"<span class=bad>✗ over {text}</span>" if ratio > 1 + 1e-9 else text
