"""The roll × path map of the report: what the nozzle's roll could have been, why not more, and what was chosen."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_cdt, label

from planner.base.arrays import Array
from planner.report.scene import COLOURS, INK, PAPER
from planner.report.templates import render
from planner.report.wording import counted

if TYPE_CHECKING:
    from planner.plan import Plan
    from planner.resolve.roll_map import RollMap

LETTERS = ("", "R", "L", "S", "C")  # by the number of the reason
STEPS = 249  # of a measure from 0 to its greatest; numbers from CODE on encode reasons
CODE = 250
# key, label, unit, factor, decimals
MEASURES = (
    ("sigma", "singularity margin, σ", "", 1.0, 3),
    ("limit", "joint range", "°", 180.0 / np.pi, 1),
)
HEIGHT = 300  # px
LATTICE = (28, 10)  # letters along the path and around the circle, at most
ROOM = 3  # places or rolls that a letter keeps from the edge of its area


def roll_map_section(plan: Plan) -> Markup:
    """HTML of the section; empty if the plan has no map."""
    if not plan.roll_maps:
        return Markup("")
    whole = plan.roll_maps[0]
    present = np.unique(np.concatenate([np.unique(each.why) for each in plan.roll_maps])).tolist()
    return render(
        "roll_map",
        share=100.0 * float(whole.free.mean()),
        maps=_labels(plan),
        measures=[label for _, label, *_ in MEASURES],
        keys=[(LETTERS[why], whole.reasons[why]) for why in present if LETTERS[why]],
    )


def roll_map_figures(plan: Plan) -> dict[str, Any] | None:
    """What roll_map.js draws: maps with a byte for each place and roll, for each measure; None without a map."""
    if not plan.roll_maps:
        return None
    highest = {
        key: max(
            float(np.nanmax(np.where(each.free, getattr(each, key), np.nan), initial=0.0)) for each in plan.roll_maps
        )
        for key, *_ in MEASURES
    }
    return {
        "reasons": list(plan.roll_maps[0].reasons),
        "code": CODE,
        "colours": COLOURS,
        "layout": _layout(),
        "measures": [
            {"key": key, "label": label, "unit": unit, "digits": digits, "step": highest[key] * factor / STEPS}
            for key, label, unit, factor, digits in MEASURES
        ],
        "maps": [_packed(plan, each, highest) for each in plan.roll_maps],
    }


def _labels(plan: Plan) -> list[str]:
    """Labels of the maps: the whole print, then single beads."""
    beads = [f"bead {int(each.bead[0])}, closely" for each in plan.roll_maps[1:]]
    return [f"the whole print, {counted(len(plan.beads), 'bead')}", *beads]


def _packed(plan: Plan, found: RollMap, highest: dict[str, float]) -> dict[str, Any]:
    """One map; bytes run along the path, from the least roll to the greatest."""
    return {
        "along": (found.along * 1e3).astype(np.float32),
        "s": (found.s * 1e3).astype(np.float32),
        "bead": found.bead,
        "roll": np.degrees(found.roll).astype(np.float32),
        "chosen": np.degrees(found.chosen).astype(np.float32),
        "t": _times(plan, found).astype(np.float32),
        "letters": _letters(found),
        "values": [_bytes(found, getattr(found, key), highest[key]).T.ravel() for key, *_ in MEASURES],
    }


def _bytes(found: RollMap, values: Array, highest: float) -> NDArray[np.uint8]:
    """Values (m, k) in steps of their greatest, or the reason why there is none."""
    steps = np.round(np.nan_to_num(values) * (STEPS / highest if highest > 0.0 else 0.0))
    return np.where(found.free, np.clip(steps, 0, STEPS), CODE + found.why).astype(np.uint8)


def _letters(found: RollMap) -> dict[str, Any]:
    """Where letters are drawn: in the middle of each infeasible area, and evenly spread over large ones."""
    m, k = found.why.shape
    every = np.zeros((m, k), dtype=np.bool_)
    every[
        round(m / LATTICE[0] / 2) :: max(round(m / LATTICE[0]), 1),
        round(k / LATTICE[1] / 2) :: max(round(k / LATTICE[1]), 1),
    ] = True
    rows: list[tuple[int, int, int]] = []
    for why in np.unique(found.why[~found.free]).tolist():
        inside = distance_transform_cdt(np.pad(found.why == why, 1))[1:-1, 1:-1]
        areas, count = label(inside > 0)
        for area in range(1, count + 1):
            depth = np.where(areas == area, inside, 0)
            deep = np.argwhere(every & (depth > ROOM))
            if not len(deep):
                deep = np.array([np.unravel_index(int(depth.argmax()), depth.shape)])
            rows += [(int(i), int(j), why) for i, j in deep]
    i, j, code = np.array(rows, dtype=np.int64).reshape(-1, 3).T
    along, roll = (found.along[i] * 1e3).astype(np.float32), np.degrees(found.roll[j]).astype(np.float32)
    return {"x": along, "y": roll, "text": [LETTERS[c] for c in code.tolist()]}


def _times(plan: Plan, found: RollMap) -> Array:
    """Times (m) at which the nozzle is at each place [s]."""
    out = np.zeros(len(found.s))
    for bead in np.unique(found.bead):
        rows = np.flatnonzero(plan.deposit & (plan.bead == bead))
        here = found.bead == bead
        out[here] = np.interp(found.s[here], plan.s[rows], plan.t[rows]) if len(rows) else 0.0
    return out


def _layout() -> dict[str, Any]:
    axis = {"gridcolor": "#e6ebf0", "zeroline": False, "linecolor": "#c3ccd5", "automargin": True}
    return {
        "height": HEIGHT,
        "margin": {"l": 52, "r": 10, "t": 8, "b": 40},
        "paper_bgcolor": PAPER,
        "plot_bgcolor": PAPER,
        "font": {"family": "system-ui, sans-serif", "color": INK, "size": 12},
        "xaxis": axis | {"title": {"text": "deposited length, mm", "standoff": 4}, "showgrid": False},
        "yaxis": axis | {"title": {"text": "roll, °"}, "range": [-180, 180], "dtick": 90, "showgrid": False},
        "showlegend": False,
    }
