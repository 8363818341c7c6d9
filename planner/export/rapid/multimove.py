"""MultiMove: a second arm that moves the part in a task of its own, in step with the task that moves the nozzle.

ABB, Application manual MultiMove (3HAC021272): moves with the same `\\ID` begin and end together, and the slower arm
sets the pace of both. All moves between `SyncMoveOn` and `SyncMoveOff` have an identity, none is used twice, and both
tasks have equally many of them. Identities of synchronisation points (`syncident`) are global and used once. A work
object with `ufprog` FALSE and an arm in `ufmec` has its user frame at that arm's flange, and speeds in it are relative
to the flange.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from planner.base.arrays import Array
from planner.base.rapid_names import ARMS, LONGEST_NAME
from planner.export.external import carrying_axes, external_written, moving_unit
from planner.export.fit import angle, from_matrix
from planner.export.moves import Moves
from planner.export.parts import numbered
from planner.export.rapid.declarations import (
    TOOL_LOAD,
    external_text,
    joints_text,
    pose_text,
    speeds,
    with_head_room,
    zone_declarations,
)
from planner.export.rapid.text import (
    NOT_LOADED,
    Procedure,
    batches_of,
    comment,
    module_name,
    running,
    unloading,
)

if TYPE_CHECKING:
    from planner.plan import Plan

TASKS = {unit: "T_" + unit.replace("_", "") for unit in ARMS}  # as every system of two arms names them: T_ROB1, T_ROB2
TASK_LIST, FLANGE = "bwTasks", "bwFlange"
PLACED, TOGETHER, APART = "bwPlaced", "bwTogether", "bwApart"  # points at which both tasks wait for each other
WAIT = f"        WaitSyncTask {PLACED},{TASK_LIST};"
ON = f"        SyncMoveOn {TOGETHER},{TASK_LIST};"
OFF = f"        SyncMoveOff {APART};"
# when the program pointer is moved out of main, the task is no longer synchronised with the other one
UNDO = ("    UNDO", "        SyncMoveUndo;")
LISTED = "{2}:=[" + ",".join(f'["{task}"]' for task in TASKS.values()) + "]"
DECLARED = (
    f"    PERS tasks {TASK_LIST}{LISTED};",
    *(f"    VAR syncident {name};" for name in (PLACED, TOGETHER, APART)),
)
UNUSED_SPEEDS = (1000.0, 100.0)  # of external axes, which the second arm's task does not have [mm/s, deg/s]
SLOW = 1e-3  # [m/s] of the nozzle's tip in the part; below, it does not set the pace


def identity(move: int) -> str:
    """The identity that a move shares with the other arm's, from its number; -1 is the planned start."""
    return f"\\ID:={move + 2}"


def second_name(name: str, unit: str) -> str:
    """Name of the module that moves the part by a mechanical unit, from the name of the nozzle's module."""
    return numbered(name, ARMS.index(unit) + 1, LONGEST_NAME, "_Rob")


def second_module(plan: Plan) -> str:
    """Name of the module that moves the part of a plan."""
    return second_name(module_name(plan.name), moving_unit(plan))


def nozzle_task(plan: Plan) -> str:
    """The task that moves the nozzle."""
    return next(task for unit, task in TASKS.items() if unit != moving_unit(plan))


def second_joints(plan: Plan, station: Array) -> Array:
    """Joints (m, k) [deg] of the second arm, including held ones, from all moving axes (m, f) other than the arm's."""
    return external_written(plan.cell, station)[:, len(carrying_axes(plan.cell)) :]


def second_speeds(plan: Plan, moves: Moves) -> Array:
    """Speeds (m + 1, 4) of the second arm's flange in the world, as in a speeddata: on its way to the start, then in
    each move [mm/s, deg/s].

    They have head-room, so that the nozzle's speed alone governs; where its tip hardly moves, the second arm sets the
    pace, at its real rate.
    """
    t, cell = plan.trajectory, plan.cell
    flange = cell.flange_of_second_arm(np.ascontiguousarray(t.q[:, len(cell.arm) :]))
    quat = from_matrix(flange[:, :3, :3])
    steps = np.column_stack(
        [
            np.linalg.norm(np.diff(flange[:, :3, 3], axis=0), axis=1) * 1e3,
            np.degrees(angle(quat[1:], quat[:-1])),
        ]
    )
    usual = [with_head_room(float(greatest) / t.dt, 10.0) for greatest in steps.max(axis=0)]
    way = np.vstack([np.zeros(2), np.cumsum(steps, axis=0)])
    mean = (way[moves.sample] - way[moves.start]) / (t.t[moves.sample] - t.t[moves.start])[:, None]
    slow = (moves.speed < SLOW) & (mean.max(axis=1) > 1.0)
    own = np.where(slow[:, None], np.maximum(1.0, np.ceil(mean)), usual)
    return np.column_stack([np.vstack([usual, own]), np.tile(UNUSED_SPEEDS, (len(own) + 1, 1))])


def second_modules(plan: Plan, moves: Moves, nozzle: Sequence[Procedure], zones: Sequence[str]) -> dict[str, str]:
    """Modules of the task that moves the part, by file name; the one with main first.

    nozzle  all procedures of the other task: each has as many moves here, with the same identities
    zones   of each move
    """
    name = second_module(plan)
    declared, speed_names = speeds(second_speeds(plan, moves))
    targets = [f"[[{joints}],[{NO_AXES}]]" for joints in joints_text(second_joints(plan, moves.targets.station))]
    parts = zip(targets, speed_names, ("fine", *zones), strict=True)
    statements = iter(
        f"        MoveAbsJ {target}{identity(k)},{speed},{zone},{FLANGE};"
        for k, (target, speed, zone) in enumerate(parts, -1)
    )
    start, *others = [replace(each, about=(), steps=tuple((next(statements),) for _ in each.steps)) for each in nozzle]
    most = plan.problem.program.module_moves
    batches = batches_of(name, others, most) if len(moves) > most else ()
    here = [start, *(others if not batches else [])]
    main = [
        "    PROC main()",
        *unloading(batches),
        f"        MoveAbsJ {targets[0]},{speed_names[0]},fine,{FLANGE};",
        WAIT,
        ON,
        *(f"        {procedure.name};" for procedure in here),
        *(statement for batch in batches for statement in running(batch)),
        OFF,
        *(NOT_LOADED if batches else []),
        *UNDO,
        "    ENDPROC",
    ]
    lines = [
        f"MODULE {name}",
        *(comment(text) for text in _about(plan)),
        "",
        comment("The load below is a placeholder: identify what the flange carries before the first run."),
        f"    PERS tooldata {FLANGE}:=[TRUE,{pose_text(np.eye(4))},{TOOL_LOAD}];",
        *DECLARED,
        "",
        *declared,
        *zone_declarations([start, *others]),
        "",
        *main,
        "",
        *(line for procedure in here for line in procedure.text),
        "ENDMODULE",
        "",
    ]
    return {f"{name}.mod": "\n".join(lines)} | {f"{each.name}.mod": each.text for batch in batches for each in batch}


NO_AXES = external_text(np.empty((1, 0)))[0]


def _about(plan: Plan) -> list[str]:
    """Comments at the head of the module that moves the part."""
    unit, robot = moving_unit(plan), plan.cell.second_arm
    return [
        f"Problem {plan.name}: task {TASKS[unit]} with {unit}, {'' if robot is None else robot.name}, which moves the part",
        *together(plan),
    ]


def together(plan: Plan) -> list[str]:
    """Which modules run where, in words."""
    name = module_name(plan.name)
    return [
        f"MultiMove: {name}.mod in task {nozzle_task(plan)} and {second_module(plan)}.mod in {TASKS[moving_unit(plan)]} run at the",
        "same time: load both, set both program pointers to main, start both. Neither runs without the other.",
    ]
