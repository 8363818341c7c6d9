"""The section `tolerance` of plan.json: whether the plan holds where the part stands a little elsewhere."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from planner.plan.tolerance import Bound, Displacement, Headroom, Tried

PLACES = 6  # decimals of millimetres and degrees


def headroom_json(room: Headroom) -> dict[str, Any]:
    """The section, in the units that its names say."""
    return {
        "shift_mm": round(room.tolerance.shift * 1e3, PLACES),
        "turn_deg": round(math.degrees(room.tolerance.turn), PLACES),
        "holds": room.holds,
        "middle_mm": _mm(room.middle),
        "first_order": [_bound(bound) for bound in room.bounds],
        "worst": {
            name: {"value": value, "placement": where.name} for name, (value, where) in room.worst_metrics.items()
        },
        "checks": [
            {
                "name": check.name,
                "worst": check.worst,
                "limit": check.limit,
                "unit": check.unit,
                "ok": check.ok,
                "where": check.where,
                "placement": where.name,
            }
            for check, where in room.worst_checks
        ],
        "placements": [_tried(each) for each in room.tried],
    }


def _mm(values: tuple[float, ...]) -> list[float]:
    return [round(value * 1e3, PLACES) for value in values]


def _displacement(each: Displacement) -> dict[str, Any]:
    return {"shift_mm": _mm(each.shift), "turn_deg": [round(math.degrees(angle), PLACES) for angle in each.turn]}


def _bound(bound: Bound) -> dict[str, Any]:
    """A bound; of joints room and change are degrees, of sigma the number itself."""
    unit = math.degrees(1.0) if bound.joint else 1.0
    return {
        "what": bound.what,
        "joint": bound.joint or None,
        "times_tolerance": bound.factor,
        "room": bound.room * unit,
        "change": bound.change * unit,
        "unit": "deg" if bound.joint else "",
        "bead": bound.bead,
        "layer": bound.layer,
        "at_mm": round(bound.s * 1e3, PLACES),
        **_displacement(bound.worst),
    }


def _tried(each: Tried) -> dict[str, Any]:
    return {
        "name": each.displacement.name,
        **_displacement(each.displacement),
        "verified": each.verified,
        "failures": each.failures,
        "metrics": each.metrics,
    }
