"""Declarations of RAPID modules: header, tool and work object, speeds, zones, and the numbers of external axes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from planner.base.arrays import Array
from planner.export.external import carrying_axes, moving_unit, task_axes
from planner.export.fit import from_matrix
from planner.export.moves import Moves
from planner.export.program import about
from planner.export.rapid.text import OWN_ZONES, Procedure, comment
from planner.export.text import number
from planner.plan import RAPID_EXTERNAL_AXES
from planner.plan.plan import materials_of

if TYPE_CHECKING:
    from planner.plan import Plan

UNUSED = "9E9"


def external_text(external: Array) -> list[str]:
    """`eax_a,..,eax_f` of each row of external axes (n, k) [deg, mm]."""
    unused = ",".join([UNUSED] * (RAPID_EXTERNAL_AXES - external.shape[1]))
    if not external.shape[1]:
        return [unused] * len(external)
    external = np.round(external, 4) + 0.0  # turns minus zero into zero
    pattern = ",".join(["%.4f"] * external.shape[1]) + ("," + unused if unused else "")
    return [pattern % tuple(row) for row in external.tolist()]


def joints_text(degrees: Array) -> list[str]:
    """The joints of each row, in degrees."""
    return [",".join(number(value, 5) for value in row) for row in degrees.tolist()]


# ----------------------------------------------------------------------------------------------------
# Declarations: header, tool and work object, speeds.

HEAD_ROOM = 1.5  # × the plan's reorientation and axis speeds, so that the tip's speed alone governs
TOOL_LOAD = "[1,[0,0,50],[1,0,0,0],0,0,0]"


def header(plan: Plan) -> list[str]:
    """Comments at the head of the main module: the plan, its checks, its materials and the nozzle to begin with."""
    texts = about(plan)
    for each in materials_of(plan.problem):
        texts.append(f"Material {each.name}: tool T{each.tool} of the extruder's board, output {each.signal}")
    if plan.begins_with:
        texts.append(f"Begins with {plan.begins_with}, which has to be on the flange.")
    return [comment(text) for text in texts]


def pose_text(T: Array) -> str:
    """A pose (4, 4) in RAPID's form: mm, quaternion w first."""
    p = ",".join(number(v, 3) for v in T[:3, 3] * 1e3)
    x, y, z, w = from_matrix(T[None, :3, :3])[0]
    return f"[[{p}],[{','.join(number(v, 7) for v in (w, x, y, z))}]]"


def frames(plan: Plan) -> list[str]:
    """Tool and work object, and the poses that the controller's own configuration must have for them to be right."""
    names, cell = plan.problem.program, plan.cell
    lines = [
        comment("The load below is a placeholder: identify it on the robot before the first run."),
        *(f"    PERS tooldata {name}:=[TRUE,{pose_text(T)},{TOOL_LOAD}];" for name, T in _tools(plan)),
        comment("Poses in the world that the controller's configuration must have. The robot's base:"),
        comment("  " + pose_text(cell.T_world_base)),
    ]
    identity, on_plate = pose_text(np.eye(4)), pose_text(cell.T_plate_part)
    letters = [f"eax_{letter} {axis.words}" for letter, axis in zip("abcdef", task_axes(cell), strict=False)]
    if before := letters[: len(carrying_axes(cell))]:
        lines[-2] = comment("Poses in the world that the controller's configuration must have. The base of the track,")
        lines[-1:] = [
            comment("a mechanical unit that carries the robot and is active:"),
            comment("  " + pose_text(cell.T_world_base)),
            comment(f"Its axes: {', '.join(before)}."),
            comment("The robot's base on it, with the axes that move at 0:"),
            comment("  " + pose_text(cell.T_world_foot)),
        ]
    unit = moving_unit(plan)
    if not unit:
        frames = f'TRUE,"",{pose_text(cell.T_world_holder)},{identity}'
    else:
        axes = letters[len(before) :]
        base = [comment("  " + pose_text(cell.T_world_holder_base))]
        if cell.second_arm is not None:
            lines += [comment(f"The base of {unit}, {cell.second_arm.name}:"), *base]
            lines += [comment(f"The user frame is the flange of {unit}; the part frame stands in it.")]
        else:
            lines += [
                comment(f"The base of station {unit}:"),
                *base,
                comment(f"Its axes: {', '.join(axes[:3])}."),
                *([comment(f"  {', '.join(axes[3:])}.")] if len(axes) > 3 else []),
                comment("Its user frame comes from the system parameters; the part frame stands in it, on the plate."),
            ]
        # ABB, RAPID reference, wobjdata: with ufprog FALSE the system parameters define the user frame
        frames = f'FALSE,"{unit}",{identity},{on_plate}'
    return [*lines, f"    PERS wobjdata {names.work_object}:=[FALSE,{frames}];"]


def _tools(plan: Plan) -> list[tuple[str, Array]]:
    """Names and poses on the flange (4, 4) of all tools."""
    cell = plan.cell
    return [(each.name, each.T_flange_nozzle) for each in cell.nozzles] or [(tool_of(plan), cell.T_flange_nozzle)]


def tool_of(plan: Plan) -> str:
    """The name of the tool data of the nozzle in use."""
    return plan.cell.nozzle_name or plan.problem.program.tool


def speed_numbers(plan: Plan, moves: Moves) -> Array:
    """Speeds (m + 1, 4) of the way to the start and of each move, as in a speeddata: tip [mm/s], reorientation [deg/s],
    sliding axes [mm/s], rotary axes [deg/s]."""
    # rounded to the digits that `speeds` writes, so that speeds with the same name are equal
    top, *own = (float(f"{speed * 1e3:.6g}") for speed in (plan.problem.process.travel_speed, *moves.speed.tolist()))
    tip = np.where(moves.laid, own, np.clip(np.ceil(moves.speed * 1e3), 1.0, top))
    turn, axis, slide = np.degrees(moves.turn), np.degrees(moves.axis), moves.slide * 1e3
    axis *= plan.cell.second_arm is None  # a second arm's joints do not belong to this task
    turn_max = with_head_room(float(turn.max()), 10.0)
    axis_max = with_head_room(float(axis.max(initial=0.0)), 10.0)
    slide_max = max(1000.0, 100.0 * float(np.ceil(HEAD_ROOM * float(slide.max(initial=0.0)) / 100.0)))
    # where the tip hardly moves it cannot set the pace: reorientation or axes do, at their real rates
    slow = (moves.speed < 1e-3) & (np.maximum(turn, axis) > 1.0)
    own_turn = np.where(slow, np.maximum(1.0, np.ceil(turn)), turn_max)
    own_axis = np.where(slow, np.maximum(1.0, np.ceil(axis)), axis_max)
    rows = np.column_stack([tip, own_turn, np.full(len(tip), slide_max), own_axis])
    return np.vstack([[top, turn_max, slide_max, axis_max], rows])


def speeds(numbers: Array) -> tuple[list[str], list[str]]:
    """Declarations of `speed_numbers` (k, 4), and the name of each; the first one is for the way to the start."""
    keys = [tuple(row) for row in numbers.tolist()]
    usual = keys[0][1:]
    table = {}
    for key in sorted(set(keys)):
        own = "" if key[1:] == usual else f"o{key[1]:.0f}a{key[3]:.0f}"
        own += "" if key[2] == usual[1] else f"s{key[2]:.0f}"
        table[key] = f"vel{key[0]:g}".replace(".", "_") + own
    lines = [f"    CONST speeddata {name}:=[{v:g},{o:g},{s:g},{a:g}];" for (v, o, s, a), name in table.items()]
    return lines, [table[key] for key in keys]


def with_head_room(value: float, step: float) -> float:
    """A speed with head-room above the one needed, rounded up to a multiple of `step`; at least 100."""
    return max(100.0, step * float(np.ceil(HEAD_ROOM * value / step)))


def extruders(plan: Plan) -> dict[str, str]:
    """The digital output of each extruder, by the suffix of its triggers: none for the first, then 2, 3, …"""
    outputs = [each.signal for each in materials_of(plan.problem)] or [plan.problem.program.extruder_signal]
    return {str(k) if k > 1 else "": signal for k, signal in enumerate(outputs, 1)}


def zone_declarations(procedures: Sequence[Procedure]) -> list[str]:
    """Declarations of our own zones that are used."""
    text = [step[0] for procedure in procedures for step in procedure.steps]
    used = [name for name in OWN_ZONES if any(f",{name}," in move for move in text)]
    return [f"    CONST zonedata {name}:={OWN_ZONES[name]};" for name in used]
