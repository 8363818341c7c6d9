"""RAPID as a language: its writer, and the check of a program against its plan, with flow and lines to the board."""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from planner.base.arrays import Array
from planner.base.geometry import arc_lengths
from planner.export.board import selected_tool
from planner.export.external import external_written, moving_unit, task_axes
from planner.export.extruder import AMOUNT, filament_differences, orders
from planner.export.moves import fed_spans
from planner.export.program import RobotProgram
from planner.export.rapid.declarations import speed_numbers
from planner.export.rapid.extruder import COLUMNS, PERCENT, first_lines, flow
from planner.export.rapid.modules import SPEED_UNITS
from planner.export.rapid.multimove import second_joints, second_speeds
from planner.export.rapid.reader import read_rapid_files, read_rapid_stretches
from planner.export.rapid.text import module_name
from planner.export.rapid.writer import quadrants, rapid_moves
from planner.export.rapid.writer import rapid_files as write
from planner.export.readback import readback

if TYPE_CHECKING:
    from planner.plan import Plan

__all__ = ["differences", "write"]

SHIFTS = (-1, 0, 1)  # samples by which a target may be mistaken for its neighbour
LONGER = 20e-6  # [m] from a bead's beginning to a target: along lines, scaled to the bead's length, against the path
SPEED_ROUNDING = 1e-5  # share of a speed; speeds have six digits
SAME_ORIENTATION = 1e-6  # 1 - |cosine| of half the angle: 0.16 deg; quaternions have seven decimals
SECOND_ROUNDING = 1e-5  # [deg]; joints of a second arm have five decimals
AXIS_ROUNDING = 1e-5  # [rad], also for mm read as if they were degrees; axes have four decimals
ROUNDING = 2e-6  # [m]; a trigger this close to a move's end, or start, counts as there
_EXTRUDES = re.compile(r"G1 E(-?\d+\.\d+) F(\d+\.\d+)", re.ASCII)


def program(plan: Plan, files: Mapping[str, str]) -> RobotProgram:
    """The program in the modules. InputError for an unknown line."""
    return read_rapid_files(files)


def programs(files: Mapping[str, str]) -> tuple[RobotProgram, ...]:
    """What the modules do while each tool is in use. InputError for an unknown line."""
    return read_rapid_stretches(files)


def differences(plan: Plan, files: Mapping[str, str]) -> list[str]:
    """Differences of the modules from the plan beyond rounding and thinning. InputError for an unknown line."""
    parts, each = plan.stretches, read_rapid_stretches(files)
    if len(parts) != len(each):
        return [f"tools are changed {len(each) - 1} times, not {len(parts) - 1}"]
    found = []
    for part, program in zip(parts, each, strict=True):
        found += [*readback(part, program), *posture_and_speed_differences(part, program)]
        found += station_differences(part, program)
    program = each[0]
    if plan.problem.program.style == "socket":
        found += line_differences(plan, program, files[f"{module_name(plan.name)}_lines.csv"])
    if plan.problem.program.style == "demand":
        found += demand_differences(plan, program)
    return found


def posture_and_speed_differences(plan: Plan, program: RobotProgram) -> list[str]:
    """Differences that neither the path nor the time of beads shows: in speeds of reorientation and axes, in the speed
    of the way to the start, and in orientation, configuration and axes at via points of arcs.

    A controller ignores the latter (ABB, RAPID reference, MoveC: orientation and external axes of a circle point are
    not used with `CirPathMode\\ObjectFrame`), but a program with other ones has been changed.
    """
    moves = rapid_moves(plan)
    speeds, arcs = speed_numbers(plan, moves) * SPEED_UNITS, np.flatnonzero(moves.circular)
    if len(program.speed) != len(speeds):
        return [f"it has {len(program.speed)} moves, not {len(speeds)}"]
    found = []
    off = np.abs(program.speed - speeds) > SPEED_ROUNDING * speeds
    for column, of in ((1, "reorientation"), (2, "axes that slide"), (3, "axes that turn")):
        if (wrong := np.flatnonzero(off[:, column])).size:
            found.append(f"speeds of {of} differ from the plan in {len(wrong)} moves, first move {wrong[0]}")
    if program.approach is None or (np.abs(program.approach - speeds[0]) > SPEED_ROUNDING * speeds[0]).any():
        found.append("the speed of the way to the start is not the planned one")
    if program.arc_postures is not None and len(arcs):
        said = program.arc_postures[1:][arcs]
        q, branch = moves.q[1:][arcs][:, plan.cell.own], plan.trajectory.branch[moves.sample[arcs]]
        conf = np.column_stack([quadrants(q), branch])
        axes = np.radians(external_written(plan.cell, moves.via.station[arcs]))[:, : len(task_axes(plan.cell))]
        wrong = (said[:, 4:8] != conf).any(axis=1)
        wrong |= 1.0 - np.abs((said[:, :4] * moves.via.quat[arcs]).sum(axis=1)) > SAME_ORIENTATION
        wrong |= (np.abs(said[:, 8 : 8 + axes.shape[1]] - axes) > AXIS_ROUNDING).any(axis=1)
        wrong |= ~np.isnan(said[:, 8 + axes.shape[1] :]).all(axis=1)
        if wrong.any():
            first = arcs[np.flatnonzero(wrong)[0]] + 1
            found.append(
                f"{np.count_nonzero(wrong)} via points of arcs differ from the plan in orientation, configuration or"
                f" axes, first move {first}"
            )
    return found


def station_differences(plan: Plan, program: RobotProgram) -> list[str]:
    """Whether the part is moved by the planned mechanical unit, and a second arm by the planned joints and speeds."""
    unit = moving_unit(plan)
    found = [] if program.station == unit else [f"the part is moved by {program.station or 'nothing'}, not by {unit}"]
    if program.second is None or plan.cell.second_arm is None:
        both = (program.second is None) == (plan.cell.second_arm is None)
        return (
            found
            if both
            else [*found, "one arm moves, not two" if program.second is None else "two arms move, not one"]
        )
    moves = rapid_moves(plan)
    joints, speeds = second_joints(plan, moves.targets.station), second_speeds(plan, moves) * SPEED_UNITS
    if len(program.second) != len(speeds) + 1:
        return found  # reported for the nozzle's moves
    off = np.abs(np.degrees(program.external) - joints).max(axis=1) > SECOND_ROUNDING
    if off.any():
        found.append(
            f"the arm that moves the part goes elsewhere in {np.count_nonzero(off)} moves, first move {np.argmax(off)}"
        )
    planned = np.vstack([speeds[:1], speeds])
    wrong = (np.abs(program.second - planned) > SPEED_ROUNDING * planned).any(axis=1)
    if wrong.any():
        found.append(f"speeds of the arm that moves the part are not the planned ones {np.count_nonzero(wrong)} times")
    return found


def line_differences(plan: Plan, program: RobotProgram, table: str) -> list[str]:
    """Every difference, in words, between the lines of a program and its plan, or the table that lists them."""
    sent = [text for move in sorted(program.sends) for text in program.sends[move]]
    planned = [text for order in orders(plan) for text in order.lines if not text.startswith(";")]
    found = [] if _listed(table) == list(enumerate(sent, 1)) else ["the table lists other lines than are sent"]
    if [text for text in sent if not _EXTRUDES.fullmatch(text)] != [*first_lines(plan), *planned]:
        found.append("the board is sent other orders than the plan's, or in another order")
    return found + _fed_otherwise(plan, sent) + _fed_elsewhere(plan, program)


def _listed(table: str) -> list[tuple[int, str]]:
    rows = list(csv.DictReader(io.StringIO(table)))
    if not rows or list(rows[0]) != COLUMNS.split(",") or any(None in row or None in row.values() for row in rows):
        return []
    return [(int(row["n"]) if row["n"].isdecimal() else 0, row["text"]) for row in rows]


def _fed_otherwise(plan: Plan, sent: list[str]) -> list[str]:
    """Tools that get a different amount of filament than planned."""
    filament: dict[int | None, float] = {}
    tool = None
    for text in sent:
        if (selects := selected_tool(text)) is not None:
            tool = selects
        elif extrudes := _EXTRUDES.fullmatch(text):
            filament[tool] = filament.get(tool, 0.0) + float(extrudes[1]) * 1e-3
    return filament_differences(plan, filament)


def _fed_elsewhere(plan: Plan, program: RobotProgram) -> list[str]:
    """Whether the filament sent by the beginning, or end, of each bead is what the plan has fed by then."""
    t = plan.trajectory
    amounts = np.zeros(len(program.linear) + 1)  # sent after each move; the last entry: before all moves
    for move, texts in program.sends.items():
        amounts[move] += sum(float(match[1]) * 1e-3 for match in map(_EXTRUDES.fullmatch, texts) if match)
    sent = np.concatenate([[0.0], np.cumsum(amounts[:-1])])
    first, last = fed_spans(t)
    places = {True: iter(first), False: iter(last)}
    near = 2.0 * float(np.abs(np.diff(t.feed)).max(initial=0.0)) + AMOUNT
    worst = 0.0
    for move, triggers in sorted(program.triggers.items()):
        for trigger in triggers:
            sample = int(next(places[trigger.value], len(t) - 1))
            if not trigger.from_start:  # at a start the line for the bead may have been sent, or not
                worst = max(worst, abs(float(sent[move] - (t.feed[sample] - t.feed[0]))))
    words = f"where a bead begins or ends, {worst * 1e3:.3g} mm of filament are fed too early or too late"
    return [] if worst <= near else [words]


def demand_differences(plan: Plan, program: RobotProgram) -> list[str]:
    """Whether each move in a bead demands a flow that the plan has there, and no flow is demanded elsewhere."""
    t, scale = plan.trajectory, plan.problem.program.demand_scale * 1e9
    planned = flow(plan) * scale
    total = np.concatenate([[0.0], np.cumsum(planned)])
    path = arc_lengths(t.tip)
    lengths = np.concatenate([[0.0], program.segments.length])
    way = np.cumsum(lengths)
    asked = _asked(program, lengths)
    switched = [(move, trigger) for move in sorted(program.triggers) for trigger in program.triggers[move]]
    edges = [move if not trigger.from_start else move - 1 for move, trigger in switched]
    first, last = fed_spans(t)
    if len(edges) != 2 * len(first):
        return ["the extruder is not switched on and off once for each bead"]
    most = float(planned.max(initial=0.0))
    if plan.problem.process.extruder.lag > 0.0:  # steps refer to the flow laid, not to that which builds up pressure
        most = min(most, float(np.diff(t.extruded).max(initial=0.0)) / t.dt * scale)
    worst, wrong = 0.0, np.nan_to_num(asked, nan=1.0)
    for a, b, begin, end in zip(first.tolist(), last.tolist(), edges[::2], edges[1::2], strict=True):
        along = (way[begin : end + 1] - way[begin]) * ((path[b] - path[a]) / max(way[end] - way[begin], 1e-12))
        gone = path[a : b + 1] - path[a]
        near = [np.searchsorted(gone, along - LONGER), np.searchsorted(gone, along + LONGER)]  # before or after a rest
        places = [np.clip(a + at + d, a, b) for at in near for d in SHIFTS]
        own = np.unique(np.array(places), axis=0).T.tolist()
        for i, (since, until) in enumerate(zip(own[:-1], own[1:], strict=True), begin + 1):
            ends = [(j, min(max(k, j + 1), b)) for j in set(since) for k in set(until)]
            means = [float(total[k] - total[j]) / max(k - j, 1) for j, k in ends]
            off = max(min(means) - asked[i], asked[i] - max(means))
            here = float(planned[min(since) : max(max(until), min(since) + 1)].max(initial=most))
            worst = np.inf if np.isnan(off) else max(worst, off / max(PERCENT * here, 1e-300))
        wrong[begin + 1 : end + 1] = 0.0
    found = [] if worst <= 1.01 else [f"a demanded flow is off by {worst:.3g} % of the largest"]
    return found + (["a flow is demanded outside beads"] if wrong.any() else [])


def _asked(program: RobotProgram, lengths: Array) -> Array:
    """Value of the analog output along each move (m); NaN where it changes within one."""
    out, now = np.empty(len(program.linear)), 0.0
    for i in range(len(out)):
        levels = program.demands.get(i, ())
        at_start = [value for far, value in levels if far >= lengths[i] - ROUNDING]
        at_end = [value for far, value in levels if far <= ROUNDING and len(at_start) < len(levels)]
        now = at_start[-1] if at_start else now
        out[i] = now if len(at_start) + len(at_end) >= len(levels) else np.nan
        now = at_end[-1] if at_end else now
    return out
