"""The first screen of a report: the figures that decide beside the baseline's, the places to go to, the scene and its player."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from html import escape
from typing import TYPE_CHECKING

from planner.report.wording import MISSING, SHORT, distance, duration

if TYPE_CHECKING:
    from planner.plan import Plan
    from planner.report.places import Place

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


def places_list(places: Sequence[Place], times: Sequence[float | None]) -> str:
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
