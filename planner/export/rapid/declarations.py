"""What stands before the procedures of a module: header, tool and work object, speeds, triggers."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from planner.export.about import about
from planner.export.moves import Moves
from planner.export.rapid.text import comment, number
from planner.export.rotations import from_matrix
from planner.plan.materials import materials_of
from planner.readonly import Array

if TYPE_CHECKING:
    from planner.plan import Plan


HEAD_ROOM = 1.5  # of reorientation and axis speeds over what the plan needs, so that the tip's speed alone governs
SECOND_ARM = (
    "NOTE: what holds the part is an arm. A controller runs two arms as two tasks (MultiMove), not as external axes:",
    "this program says what both arms do, but runs only where the second one is set up as a mechanical unit of this",
    "task, as in a simulation. On two real arms, start from trajectory.csv.",
)
TOOL_LOAD = "[1,[0,0,50],[1,0,0,0],0,0,0]"


def header(plan: Plan) -> list[str]:
    texts = about(plan)
    for each in materials_of(plan.problem):
        texts.append(f"Material {each.name}: tool T{each.tool} of the extruder's board, output {each.signal}")
    return [comment(text) for text in texts]


def _pose(T: Array) -> str:
    p = ",".join(number(v, 3) for v in T[:3, 3] * 1e3)
    x, y, z, w = from_matrix(T[None, :3, :3])[0]
    return f"[[{p}],[{','.join(number(v, 7) for v in (w, x, y, z))}]]"


def frames(plan: Plan) -> list[str]:
    """Tool and work object, and what the controller's own configuration must say for them to be right."""
    names, cell = plan.problem.program, plan.cell
    lines = [
        comment("The load below is a placeholder: identify it on the robot before the first run."),
        f"    PERS tooldata {names.tool}:=[TRUE,{_pose(cell.T_flange_nozzle)},{TOOL_LOAD}];",
        comment("Poses in the world that the controller's configuration must have. The robot's base:"),
        comment("  " + _pose(cell.T_world_base)),
    ]
    identity, on_plate = _pose(np.eye(4)), _pose(cell.T_plate_part)
    if cell.holder_robot is None:
        frames = f'TRUE,"",{_pose(cell.T_world_holder)},{identity}'
    else:
        axes = [
            f"eax_{letter} {name}" + (" (held)" if name in cell.held else "")
            for letter, name in zip("abcdef", cell.holder_robot.joint_names, strict=False)
        ]
        lines += [
            comment(f"The base of station {names.station}:"),
            comment("  " + _pose(cell.T_world_holder_base)),
            comment(f"Its axes: {', '.join(axes[:3])}."),
            *([comment(f"  {', '.join(axes[3:])}.")] if len(axes) > 3 else []),
            comment("Its user frame comes from the system parameters; the part frame stands in it, on the plate."),
        ]
        if cell.holder_robot.inverse is not None:
            lines += [comment(text) for text in SECOND_ARM]
        # ABB, RAPID reference, wobjdata: with ufprog FALSE the system parameters define the user frame
        frames = f'FALSE,"{names.station}",{identity},{on_plate}'
    return [*lines, f"    PERS wobjdata {names.work_object}:=[FALSE,{frames}];"]


def _quantised(speed: Array) -> Array:
    """Speeds to 1 mm/s, below 10 mm/s to 0.1 mm/s, never 0 [mm/s]."""
    return np.where(speed >= 9.95, np.round(speed), np.maximum(np.round(speed, 1), 0.1))


def speeds(plan: Plan, moves: Moves) -> tuple[list[str], list[str]]:
    """Declarations of all speeds, and the name of each move's speed; the first one is for the way to the start."""
    top = plan.problem.process.travel_speed * 1e3
    tip = _quantised(np.where(moves.laid, moves.speed * 1e3, np.minimum(np.ceil(moves.speed * 1e3), top)))
    turn, axis = np.degrees(moves.turn), np.degrees(moves.axis)
    turn_max = _rounded_up(HEAD_ROOM * float(turn.max()), 10.0)
    axis_max = _rounded_up(HEAD_ROOM * float(axis.max(initial=0.0)), 10.0)
    # where the tip hardly moves it cannot set the pace: there the turning does, at its real rate
    slow = (moves.speed < 1e-3) & (np.maximum(turn, axis) > 1.0)
    own_turn = np.where(slow, np.maximum(1.0, np.ceil(turn)), turn_max)
    own_axis = np.where(slow, np.maximum(1.0, np.ceil(axis)), axis_max)
    keys = [(top, turn_max, axis_max), *zip(tip.tolist(), own_turn.tolist(), own_axis.tolist(), strict=True)]
    table = {}
    for key in sorted(set(keys)):
        own = "" if key[1:] == (turn_max, axis_max) else f"o{key[1]:.0f}a{key[2]:.0f}"
        table[key] = f"vel{key[0]:g}".replace(".", "_") + own
    lines = [f"    CONST speeddata {name}:=[{v:g},{o:g},1000,{a:g}];" for (v, o, a), name in table.items()]
    return lines, [table[key] for key in keys]


def _rounded_up(value: float, step: float) -> float:
    return max(100.0, step * float(np.ceil(value / step)))


def extruders(plan: Plan) -> dict[str, str]:
    """The digital output of each extruder, by what its triggers end with: nothing for the first, then 2, 3, …"""
    outputs = [each.signal for each in materials_of(plan.problem)] or [plan.problem.program.extruder_signal]
    return {str(k) if k > 1 else "": signal for k, signal in enumerate(outputs, 1)}
