"""report.html of a plan: verdict, summary, scene, checks, curves over time, and how it came about."""

from __future__ import annotations

import shlex
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from planner.report import page as frame
from planner.report.approaches import approaches_section, cell_figure
from planner.report.curves import joint_charts, time_charts
from planner.report.dips import dips_section
from planner.report.extruder import events_section, materials_section
from planner.report.headroom import headroom_section
from planner.report.places import where_words, worst_places
from planner.report.scene import Place, plan_scene
from planner.report.thinning import CURVE_BUDGET
from planner.report.wording import (
    CHECK_NAMES,
    MISSING,
    counted,
    duration,
    number,
    resumed_words,
    significant,
    summary_table,
)

if TYPE_CHECKING:
    from planner.plan import Check, Plan

DEFAULT_DT = 0.004


def write_report(plan: Plan, path: Path) -> None:
    """Write one self-contained report.html, at most 8 MB however long the plan.

    `plan.settings["overrides"]`, if there, holds the `dotted.key=value` arguments of the command line.
    Raises OutputError where `path` cannot be written.
    """
    places = worst_places(plan)
    scene = plan_scene(plan, places)
    curves, joints = time_charts(plan), joint_charts(plan)
    body = "".join(
        [
            _summary(plan),
            _notes(plan.toolpath.notes),
            _scene(scene, places, plan),
            dips_section(plan),
            materials_section(plan),
            events_section(plan),
            _checks(plan.checks),
            approaches_section(plan),
            headroom_section(plan),
            _curves(curves),
            _joints(plan, joints),
            _making(plan),
        ]
    )
    figures = {
        "scene": scene,
        "cell": cell_figure(plan),
        "charts": [
            {k: chart[k] for k in ("key", "traces", "layout", "ranges") if k in chart} for chart in curves + joints
        ],
    }
    words = "verified" if plan.verified else "not verified"
    title = f"{plan.name}: {words}"
    frame.write_text(Path(path), frame.page(title, _header(plan), body, _footer(plan, scene), figures))


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
    dip = m.get("deposition_time_s", np.nan) - m.get("ideal_deposition_time_s", np.nan)
    cuts = " and to cuts" if any(event.kind == "cut" for event in traj.events) else ""
    figures = [
        (
            _unit(m.get("at_speed_fraction"), 100, 2, "%"),
            f"of the length printed at {plan.problem.process.speed * 1e3:g} mm/s",
        ),
        (_unit(m.get("speed_min_mm_s"), 1, 1, "mm/s"), "slowest while depositing"),
        (duration(m.get("print_time_s")), "whole print, travel included"),
        (_unit(dip, 1, 1, "s"), f"lost to dips in speed{cuts}"),
        (_unit(m.get("wrist_margin_deg"), 1, 1, "°"), "least wrist angle from the singularity"),
        (_unit(m.get("joint_limit_margin_deg"), 1, 1, "°"), "least distance from an end stop"),
    ]
    return (
        f"<p class=kind>Print plan</p><h1>{escape(plan.problem.name)}</h1><p class=about>{about}</p>"
        f"{banner}{frame.tiles(figures)}"
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


def _scene(scene: dict[str, Any], places: list[Place], plan: Plan) -> str:
    options = "".join(f"<option>{escape(channel['label'])}</option>" for channel in scene["channels"])
    last = len(scene["groups"]) - 1
    controls = ""
    if last >= 0:
        controls = (
            f"<label>Colour by <select id=colour autocomplete=off>{options}</select></label>"
            f"<label{'' if last else ' hidden'}>Layers <input type=range id=layers autocomplete=off min=0 max={last} value={last} step=1>"
            f"<output id=layer-words>{'up to ' if last else ''}{scene['groups'][last]}</output></label>"
            f"<label{'' if last else ' hidden'}><input type=checkbox id=only autocomplete=off> only this layer</label>"
            "<label><input type=checkbox id=through autocomplete=off> see through the part</label>"
        )
        if scene["dips"]:
            controls += "<label><input type=checkbox id=dips autocomplete=off checked> mark dips in speed</label>"
        if scene["places"]:
            controls += "<label><input type=checkbox id=places autocomplete=off checked> mark worst places</label>"
    rows = "".join(
        f"<tr><td><span class=letter>{place.letter}</span></td><th scope=row>{escape(place.what)}</th>"
        f"<td class=n>{escape(place.value)}</td><td class=n data-unit=s>{plan.trajectory.t[place.sample]:.2f}</td>"
        f"<td class=where>{escape(where_words(plan, place.sample))}</td></tr>"
        for place in places
    )
    table = (
        "<h3>Worst places while depositing</h3><div class=wide><table class=stack><thead><tr><th></th><th class=left>what</th>"
        f"<th>value</th><th>time, s</th><th class=left>where</th></tr></thead><tbody>{rows}</tbody></table></div>"
        if rows
        else ""
    )
    return (
        "<h2>The print</h2><p class=note>Where the nozzle tip goes while material flows, in the part’s own frame, in "
        "millimetres. Drag to turn; then the wheel, or a pinch, comes closer. Light is where it gets tight.</p>"
        f"<div class=controls>{controls}</div><div id=view></div><p id=reading>Point at a line to read it.</p>{table}"
    )


def _checks(checks: tuple[Check, ...]) -> str:
    rows = "".join(
        f"<tr{'' if check.ok else ' class=bad'}><th scope=row>{escape(check.name.translate(CHECK_NAMES))}</th>"
        f"<td class=n>{significant(check.worst)}</td><td class=n>{significant(check.limit)}</td>"
        f"<td>{escape(check.unit)}</td>"
        f"<td>{'<span class=yes>✓ holds</span>' if check.ok else '<span class=bad>✗ fails</span>'}</td>"
        f"<td class=where>{escape(check.where) or MISSING}</td></tr>"
        for check in checks
    )
    return (
        "<h2>Checks</h2><p class=note>Found on the finished, sampled motion, by code that shares nothing with the "
        "code that planned it.</p><div class=wide><table><thead><tr><th class=left>check</th><th>worst</th>"
        "<th>limit</th><th class=left>unit</th><th class=left>verdict</th><th class=left>where</th></tr></thead>"
        f"<tbody>{rows}</tbody></table></div>"
    )


def _curves(charts: list[dict[str, Any]]) -> str:
    each = "".join(
        f"<div class=chart><h3>{escape(chart['title'])}</h3><p>{escape(chart['note'])}</p>"
        f"<div id='chart-{chart['key']}'></div></div>"
        for chart in charts
    )
    return (
        "<h2>Along time</h2><p class=note>Drag over a stretch to come closer: all charts follow. Double-click to see "
        "everything. Click a moment to ring its place in the scene. Dotted uprights: a new layer begins.</p>" + each
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
    if plan.headroom is not None:
        words += ["--tolerance", plan.headroom.tolerance.words]
    for override in plan.settings.get("overrides", ()):
        words += ["--set", str(override)]
    return shlex.join(words)


def _footer(plan: Plan, scene: dict[str, Any]) -> str:
    return (
        f"Drawn from {number(len(plan.trajectory), 0)} samples. The scene shows {number(scene['points'], 0)} of "
        f"{number(int(plan.trajectory.deposit.sum()), 0)} deposited ones, curves at most {number(CURVE_BUDGET, 0)} points each; what was "
        "left out lies between the extremes of its neighbours, corners and ends of lines are kept. Tables and "
        "verdict use every sample. This file needs no network."
    )


def _unit(value: float | None, scale: float, digits: int, unit: str) -> str:
    if value is None or np.isnan(value):
        return MISSING
    return number(value * scale, digits) + (unit if unit == "°" else f"\u202f{unit}")


def _range(low: float, high: float) -> str:
    endless = not (np.isfinite(low) or np.isfinite(high))
    return "no end" if endless else f"{number(low, 0)} to {number(high, 0)}"


def _share(ratio: float) -> str:
    text = number(ratio * 100, 1)
    return f"<span class=bad>✗ over {text}</span>" if ratio > 1 + 1e-9 else text
