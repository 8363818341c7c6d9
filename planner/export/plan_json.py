"""plan.json: the plan's results, and the cell as screws, so that every pose can be recomputed without this code."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from planner.base.shipped import PROBLEMS
from planner.plan.by_layer import LayerTimes, layer_times
from planner.plan.plan import used

if TYPE_CHECKING:
    from planner.base.errors import Refusal
    from planner.cell.cell import Cell
    from planner.plan import Advice, Dip, Plan
    from planner.plan.robustness import Bound, Displacement, Robustness, TriedDisplacement
    from planner.problem import Problem

# ----------------------------------------------------------------------------------------------------
# The section `tolerance`: whether the plan still holds if the part is slightly misplaced.

ROBUSTNESS_DECIMALS = 6  # of millimetres and degrees


def robustness_json(room: Robustness) -> dict[str, Any]:
    """The section `tolerance`, in the units that its names give."""
    return {
        "shift_mm": round(room.tolerance.shift * 1e3, ROBUSTNESS_DECIMALS),
        "turn_deg": round(math.degrees(room.tolerance.turn), ROBUSTNESS_DECIMALS),
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
    return [round(value * 1e3, ROBUSTNESS_DECIMALS) for value in values]


def _displacement(each: Displacement) -> dict[str, Any]:
    return {
        "shift_mm": _mm(each.shift),
        "turn_deg": [round(math.degrees(angle), ROBUSTNESS_DECIMALS) for angle in each.turn],
    }


def _bound(bound: Bound) -> dict[str, Any]:
    """A bound; room and change are in degrees for joints, plain numbers for sigma."""
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
        "at_mm": round(bound.s * 1e3, ROBUSTNESS_DECIMALS),
        **_displacement(bound.worst),
    }


def _tried(each: TriedDisplacement) -> dict[str, Any]:
    return {
        "name": each.displacement.name,
        **_displacement(each.displacement),
        "verified": each.verified,
        "failures": each.failures,
        "metrics": each.metrics,
    }


# ----------------------------------------------------------------------------------------------------
# The whole file.

DIP_DECIMALS = 5  # of the figures of dips, layers and advice
# Contents of the file, in order.
KEYS = {
    "problem": "name of the problem",
    "problem_file": "its file, as it was given; null for waypoints from arrays",
    "problem_sha256": "SHA-256 of that file as it was read; null if there was no file",
    "strategy": "the strategy that planned it",
    "resolved_by": "the strategy whose paths these are: the default takes a simpler one's if that prints better",
    "first_bead": "index of the first bead that is laid; not 0 if an interrupted print is resumed",
    "verified": "whether every check holds, also within the tolerance if one was requested",
    "checks": "each with name, worst value, limit, unit, ok, and where the worst is",
    "metrics": "by name",
    "layer_times": "by layer: when it begins, how long it takes, and the age of the beads that it is laid on",
    "notes": "what was left out of the input, or changed in it, in sentences",
    "nearer": "the clearance of nozzle and head from part and print, only if it is less than usual, and why",
    "splits": "where drawn beads are laid in pieces, each as a bead; only if process.split_beads made some",
    "dips": "stretches where the tip is slower than commanded, each with cause and remedies",
    "advice": "changes within bounds that would help most, tried on some slow beads, the best first",
    "events": "further actions of the extruder and its heating, in order of time",
    "materials": "how much of each material the print takes; only if materials have names",
    "tolerance": "whether the plan still holds if the part is slightly misplaced; only if that was requested",
    "cell": "the cell as screws: joints with limits, and the frames with all joints at 0 (m, rad)",
    "timing_s": "seconds of computing, by stage",
    "versions": "versions of everything that the result depends on",
    "baseline": "the metrics of strategy as_published in the same cell; empty if that has no plan",
    "settings": "seconds between samples, what --set changed, and the names of the user's own terms, if any",
    "files": "SHA-256 of each program and table that was written with it, by name: the link runs no others",
    "refusal": "only if there is no plan, in place of all fields after checks: reason, place and hints",
}
DIP_KEYS = {
    "bead": "its index",
    "layer": "its index",
    "from_mm": "where the dip begins, along the bead",
    "to_mm": "where it ends",
    "at_mm": "where the tip is slowest",
    "t_s": "when",
    "speed_min_mm_s": "how slow",
    "lost_s": "time lost to it",
    "joint": "the joint whose limit causes it; null if none does",
    "limit": "its velocity, acceleration or jerk; else start, end, stop or shape",
    "over_extruded_mm3": "excess material laid here",
    "avoid": "what would avoid it, by kind: fields of the problem file with the values that they would need",
}
SPLIT_KEYS = {
    "bead": "index of the bead that begins there",
    "name": "name of the drawn bead",
    "layer": "its index",
    "at_mm": "where it is cut, along the drawn bead",
    "why": "why it ends there: no branch leads on, or which joint would turn beyond its range",
}
DECIMALS = 12  # of the screws: a picometre; anything below is rounding that differs between machines
COUNT_DECIMALS = 9  # of a controller's offset of a joint's zero [rad]


def plan_json(plan: Plan, files: Mapping[str, str] | None = None) -> str:
    """JSON text of a plan; numbers that are not finite become null. files: digests of the files next to it, by name."""
    checks = [
        {"name": c.name, "worst": c.worst, "limit": c.limit, "unit": c.unit, "ok": c.ok, "where": c.where}
        for c in plan.checks
    ]
    data = {
        "problem": plan.problem.name,
        "problem_file": None if plan.problem.from_arrays else file_as_given(plan.problem),
        "problem_sha256": plan.problem.sources.sha256 or None,
        "strategy": plan.strategy,
        "resolved_by": plan.resolved_by or plan.strategy,
        "first_bead": plan.first_bead,
        "verified": plan.verified,
        "checks": checks,
        "metrics": plan.metrics,
        "layer_times": [_layer(each) for each in layer_times(plan)],
        "notes": plan.toolpath.notes,
        **_nearer(plan),
        **_splits(plan),
        "dips": [_dip(dip) for dip in plan.dips],
        "advice": [_advice(each) for each in plan.advice],
        "events": [
            {
                "kind": event.kind,
                "bead": event.bead,
                "start_s": event.start,
                "duration_s": event.duration,
                "amount_mm": event.amount * 1e3,
                **({"material": event.material} if event.material else {}),
                **({"note": event.note} if event.note else {}),
            }
            for event in plan.trajectory.events
        ],
        **_materials(plan),
        **({} if plan.headroom is None else {"tolerance": robustness_json(plan.headroom)}),
        "cell": cell_screws(plan.cell),
        "timing_s": plan.timing_s,
        "versions": plan.versions,
        "baseline": plan.baseline,
        "settings": plan.settings,
        "files": files or {},
    }
    return json.dumps(_plain(data), indent=1, allow_nan=False) + "\n"


def file_as_given(problem: Problem) -> str:
    """A problem's file, or just its name if it ships with the package, which is the same wherever that is installed."""
    return problem.file.stem if problem.file.parent == PROBLEMS else problem.file.as_posix()


def _layer(each: LayerTimes) -> dict[str, Any]:
    """Times of a layer."""
    return {
        "layer": each.layer,
        "begin_s": round(each.begin, DIP_DECIMALS),
        "time_s": round(each.time, DIP_DECIMALS),
        "on_others_fraction": round(each.covered, DIP_DECIMALS),
        "interlayer_min_s": _rounded(each.least),
        "interlayer_median_s": _rounded(each.median),
        "interlayer_max_s": _rounded(each.greatest),
    }


def _rounded(value: float | None) -> float | None:
    return None if value is None else round(value, DIP_DECIMALS)


def _nearer(plan: Plan) -> dict[str, Any]:
    """The clearance kept if it is less than usual; otherwise nothing."""
    if plan.nearer is None:
        return {}
    kept, usual = (round(each * 1e3, DIP_DECIMALS) for each in (plan.nearer.kept, plan.nearer.usual))
    return {"nearer": {"nozzle_mm": kept, "usual_mm": usual, "because": plan.nearer.because}}


def _splits(plan: Plan) -> dict[str, Any]:
    """Where drawn beads are cut; nothing if none is."""
    rows = [
        {
            "bead": split.bead,
            "name": split.name,
            "layer": split.layer,
            "at_mm": round(split.s * 1e3, DIP_DECIMALS),
            "why": split.why,
        }
        for split in plan.toolpath.splits
    ]
    return {"splits": rows} if rows else {}


def _dip(dip: Dip) -> dict[str, Any]:
    """A dip in the units that the names give; each remedy with all its fields, and whether it is exact."""
    return {
        "bead": dip.bead,
        "layer": dip.layer,
        "from_mm": round(dip.from_s * 1e3, DIP_DECIMALS),
        "to_mm": round(dip.to_s * 1e3, DIP_DECIMALS),
        "at_mm": round(dip.at_s * 1e3, DIP_DECIMALS),
        "t_s": round(dip.t, DIP_DECIMALS),
        "speed_min_mm_s": round(dip.speed * 1e3, DIP_DECIMALS),
        "lost_s": round(dip.lost, DIP_DECIMALS),
        "joint": dip.joint or None,
        "limit": dip.limit,
        "over_extruded_mm3": round(dip.over_extruded * 1e9, DIP_DECIMALS),
        "avoid": {remedy.kind: {"exact": remedy.exact, "change": dict(remedy.changes)} for remedy in dip.remedies},
    }


def _advice(each: Advice) -> dict[str, Any]:
    """A change that was tried: what it gains on the beads that it was tried on, and at least on the whole print."""
    return {
        "kind": each.kind,
        "field": each.field,
        "value": each.value,
        "tried_on_beads": list(each.beads),
        "slow_length_fraction_tried": round(each.covered, DIP_DECIMALS),
        "at_speed_fraction_now": round(each.share_now, DIP_DECIMALS),
        "at_speed_fraction": round(each.share, DIP_DECIMALS),
        "time_now_s": round(each.time_now, DIP_DECIMALS),
        "time_s": round(each.time, DIP_DECIMALS),
        "print_longer_s": round(each.seconds, DIP_DECIMALS),
        "whole_at_speed_fraction_now": round(each.whole_now, DIP_DECIMALS),
        "whole_at_speed_fraction_at_least": round(each.whole, DIP_DECIMALS),
    }


def _materials(plan: Plan) -> dict[str, Any]:
    """How much of each material the print takes; nothing if they have no names."""
    rows = [
        {
            "name": each.material.name,
            "tool": each.material.tool,
            "beads": each.beads,
            "length_mm": each.length * 1e3,
            "extruded_volume_mm3": each.volume * 1e9,
            "extruded_mm": each.filament * 1e3,
        }
        for each in used(plan)
    ]
    return {"materials": rows} if rows else {}


def refusal_json(problem: Problem, strategy: str, refusal: Refusal) -> str:
    """JSON text if there is no plan: the same first fields, and the refusal with its place."""
    data = {
        "problem": problem.name,
        "strategy": strategy,
        "verified": False,
        "checks": [],
        "refusal": {
            "reason": refusal.reason,
            "bead": refusal.bead,
            "waypoint": refusal.waypoint,
            "s_mm": refusal.s_mm,
            "point_mm": refusal.point_mm,
            "missing_mm": refusal.missing_mm,
            "hints": refusal.hints,
        },
    }
    return json.dumps(_plain(data), indent=1, allow_nan=False) + "\n"


def _nozzle(cell: Cell, k: int) -> dict[str, Any]:
    """One of several nozzles: its name, its materials, and its frame with all joints at 0."""
    own = cell.with_nozzle(k)
    return {
        "name": own.nozzle_name,
        "materials": [name for name, which in cell.nozzle_of.items() if which == k],
        "T_world_nozzle_zero": np.round(own.arm.poses(np.zeros((1, len(own.arm))))[0], DECIMALS),
    }


def _controller_counts(cell: Cell) -> list[dict[str, Any]]:
    """How the controller counts each joint; nothing for a joint that it counts as the cell does."""
    n = len(cell.joint_names)
    zero, one = np.round(cell.counted(np.vstack([np.zeros(n), np.ones(n)])), COUNT_DECIMALS)
    signs = np.rint(one - zero)
    return [
        {"controller_sign": sign, "controller_offset": offset} if (sign, offset) != (1.0, 0.0) else {}
        for sign, offset in zip(signs.tolist(), zero.tolist(), strict=True)
    ]


def cell_screws(cell: Cell) -> dict[str, Any]:
    """Joint screws in the world with all joints at 0 (m, rad), limits, and the two end frames there (4, 4).

    A prismatic joint slides along its direction; its values are in metres. A joint that the controller counts
    differently has `controller_sign` and `controller_offset` (sign * q + offset).

    `holder_axes` lists all axes of the part's holder in the order and by the names of its own robot, with the positions
    of those that are held [rad, m]; `holder_is_arm` says if it is an arm. `carrier_axes` does the same for the arm's
    carrier, if there is one.

    A pose is the product of exponentials of the screws that move it, in the order given, times its frame at 0.
    """
    joints: list[dict[str, Any]] = []
    limits, counts = cell.limits, _controller_counts(cell)
    for moves, chain in (("nozzle", cell.arm), ("part", cell.holder)):
        for screw, slides in zip(np.round(chain.screws, DECIMALS), chain.slides, strict=True):
            i = len(joints)
            joints.append(
                {
                    "name": cell.joint_names[i],
                    "type": "prismatic" if slides else "revolute",
                    "moves": moves,
                    "origin_m": screw[:3],
                    "direction": screw[3:],
                    "q_min": limits.q_min[i],
                    "q_max": limits.q_max[i],
                    "v_max": limits.velocity[i],
                    "a_max": limits.acceleration[i],
                    "j_max": limits.jerk[i],
                    **counts[i],
                }
            )
    holder = [] if cell.holder_robot is None else list(cell.holder_robot.model.names)[1:]
    carrier = {} if cell.carrier is None else dict.fromkeys(cell.carrier.robot.joint_names) | cell.carrier.held
    return {
        "joints": joints,
        **({"carrier_axes": [{"name": name, "held_at": at} for name, at in carrier.items()]} if carrier else {}),
        "holder_axes": [{"name": name, "held_at": cell.held.get(name)} for name in holder],
        **({"holder_is_arm": True} if cell.holder_robot is not None and cell.holder_robot.inverse is not None else {}),
        "T_world_nozzle_zero": np.round(cell.arm.poses(np.zeros((1, len(cell.arm))))[0], DECIMALS),
        **({"nozzles": [_nozzle(cell, k) for k in range(len(cell.nozzles))]} if cell.nozzles else {}),
        "T_world_part_zero": np.round(cell.holder.poses(np.zeros((1, len(cell.holder))))[0], DECIMALS),
    }


def _plain(value: Any) -> Any:
    """The same value in JSON's own types; TypeError for a value that has no such form."""
    if value is None or isinstance(value, str):
        return value
    if isinstance(value, (bool, np.bool_)):
        return bool(value)
    if isinstance(value, (int, np.integer)):
        return int(value)
    if isinstance(value, (float, np.floating)):
        return float(value) + 0.0 if math.isfinite(value) else None
    if isinstance(value, np.ndarray):
        return [_plain(item) for item in value.tolist()]
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(item) for item in value]
    if isinstance(value, Path):
        return value.as_posix()
    raise TypeError(f"no JSON form of {type(value).__name__}")
