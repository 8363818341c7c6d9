"""Which cells each language supports, and the output numbers that switch the extruders."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, TypeVar

from planner.base.rapid_names import ARMS, LONGEST_NAME, OWN_NAMES
from planner.export.axes.flavours import FLAVOURS
from planner.export.external import external_axes, moving_unit
from planner.export.rapid.text import module_name
from planner.plan import RAPID_EXTERNAL_AXES
from planner.plan.plan import materials_of

if TYPE_CHECKING:
    from planner.cell.robot import Robot
    from planner.export.program import Setup
    from planner.plan import Plan
    from planner.problem import Problem
    from planner.problem.settings import MachineSpec

Output = TypeVar("Output", int, str)

EXTERNAL_AXES = 6  # in KRL: E1 to E6
STANDARD_OUTPUTS = 8  # of a UR control box, numbered from 0
VAL3_OUTPUTS = 16  # of the I/O board of a CS8 or CS9, numbered from 0
STATION = ("U", "V")  # letters of the axes that move a robot's part: genserkins passes them on to further joints


def off_differences(plan: Plan, off: Sequence[frozenset[str]]) -> list[str]:
    """What is wrong with the outputs (by number) that a program switches off before its first move and after its last,
    in words: they must be the extruders'."""
    outputs = frozenset(map(str, output_numbers(plan.problem).values()))
    if all(each == outputs for each in off):
        return []
    return ["other outputs than the extruders' are switched off at the start, or at the end"]


def output_numbers(problem: Problem) -> dict[str, int]:
    """Output number of each extruder's signal: the problem's own, then consecutive ones for further materials."""
    signals = [each.signal for each in materials_of(problem)] or [problem.program.extruder_signal]
    return {signal: problem.program.extruder_output + k for k, signal in enumerate(signals)}


def outputs_about(problem: Problem) -> list[str]:
    """A line for each output, and for each material that has a name."""
    return [
        *(f"Output {k}: {signal}" for signal, k in output_numbers(problem).items()),
        *(f"Material {each.name}: tool T{each.tool}, {each.signal}" for each in materials_of(problem)),
    ]


def by_bead(plan: Plan, outputs: Sequence[Output]) -> list[Output]:
    """The output for each bead of the toolpath; `outputs` are the extruders', in the order of their materials."""
    names = [each.name for each in materials_of(plan.problem)]
    return [outputs[names.index(bead.material)] if names else outputs[0] for bead in plan.toolpath.beads]


def unsupported_in_joint_trajectory(setup: Setup) -> str | None:
    """Why a message of trajectory samples does not support a problem; None if it does."""
    if setup.problem.as_run is not None:
        return (
            "as_run displaces targets between which the controller plans; it does not apply to samples of a trajectory"
        )
    return None


def _one_nozzle(setup: Setup) -> str | None:
    """Why a language whose programs have one nozzle does not support a cell; None if it does."""
    names = [nozzle.name for nozzle in setup.cell.nozzles]
    return f"it supports one nozzle, and the cell has {' and '.join(names)}" if names else None


def unsupported_in_rapid(setup: Setup) -> str | None:
    """Why RAPID does not support a cell; None if it does.

    Raises InputError for a mechanical unit that no arm of a MultiMove system has.
    """
    arm, holder, second = setup.cell.arm_robot, setup.cell.station, setup.cell.second_arm
    if setup.cell.nozzles and setup.problem.program.style != "output":
        return f"with several nozzles program.style must be output, not {setup.problem.program.style}"
    if setup.cell.nozzles and second is not None:
        return f"{second.name} moves the part in a task of its own, which supports one nozzle"
    if not setup.cell.tells_posture:
        return f"a target's configuration requires a spherical wrist, which {arm.name} does not have"
    if second is not None:
        return _unsupported_in_multimove(setup, second)
    if holder is not None and len(holder.joint_names) > RAPID_EXTERNAL_AXES:
        return f"{holder.name} has more axes than RAPID's {RAPID_EXTERNAL_AXES} external ones"
    if len(external_axes(setup.cell)) > RAPID_EXTERNAL_AXES:
        return f"more axes carry the arm and the part than RAPID's {RAPID_EXTERNAL_AXES} external ones"
    return None


def check_rapid_names(problem: Problem) -> None:
    """Raise InputError for a name in the problem that means something else in RAPID."""
    nozzles = {f"cell.nozzles.{name}": name for name in problem.cell.nozzles}
    outputs = {f"process.materials.{each.name}.extruder_signal": each.signal for each in materials_of(problem)}
    for field, name in (nozzles | outputs).items():
        if OWN_NAMES.fullmatch(name) or name.upper() in ARMS:
            reason = f"{name!r} may be a name of the program's own, or of the controller's"
            raise problem.error(field, reason, f"for example my_{name}"[:LONGEST_NAME])
    tools = nozzles or {"program.tool": problem.program.tool}
    for field, name in {**tools, "program.work_object": problem.program.work_object}.items():
        if name.lower() == module_name(problem.name).lower():
            reason = f"{name!r} is also the name of the module, which is named after the problem"
            raise problem.error(field, reason, "give another name")


def _unsupported_in_multimove(setup: Setup, second: Robot) -> str | None:
    """Why two RAPID tasks, one for the arm that moves the part, do not support a cell; None if they do."""
    unit = moving_unit(setup)
    if unit not in ARMS:
        hint = f"one of {', '.join(ARMS)}, or leave it out"
        raise setup.problem.error("program.station", f"{unit!r} is not an arm of a MultiMove system", hint)
    if second.language != "rapid":
        return f"MultiMove moves ABB arms, and the robot file of {second.name}, which moves the part, names another language"
    if not second.counts_as_controllers:
        return f"{second.name}, which moves the part, counts its joints differently from its controller"
    if setup.cell.rails:
        return f"{setup.cell.joint_names[0]} carries one of the two arms, which MultiMove programs do not support"
    return None


def unsupported_in_krl(setup: Setup) -> str | None:
    """Why KRL does not support a cell; None if it does."""
    arm, holder = setup.cell.arm_robot, setup.cell.station
    if several := _one_nozzle(setup):
        return several
    if not setup.cell.tells_posture:
        return f"KR C controllers require six axes and a spherical wrist, which {arm.name} does not have"
    if holder is not None and holder.inverse is not None:
        return f"the part is held by an arm, {holder.name}, and external axes can only be a positioner's"
    if holder is not None and len(holder.joint_names) > EXTERNAL_AXES:
        return f"{holder.name} has more axes than KRL's {EXTERNAL_AXES} external ones"
    if len(external_axes(setup.cell)) > EXTERNAL_AXES:
        return f"more axes carry the arm and the part than KRL's {EXTERNAL_AXES} external ones"
    if min(output_numbers(setup.problem).values()) < 1:
        return "outputs count from 1, and program.extruder_output is 0"
    return None


def unsupported_in_urscript(setup: Setup) -> str | None:
    """Why URScript does not support a cell; None if it does."""
    arm, holder = setup.cell.arm_robot, setup.cell.station
    if several := _one_nozzle(setup):
        return several
    if arm.language != "urscript":
        return f"{arm.name} is not a Universal Robots arm, going by the language in its file"
    if setup.cell.rails:
        return f"it moves the arm alone, and here {setup.cell.joint_names[0]} carries it"
    if holder is not None and len(setup.cell.holder):
        return f"it moves the arm alone, and here {holder.name} moves the part"
    last = max(output_numbers(setup.problem).values())
    if last >= STANDARD_OUTPUTS:
        return f"an extruder has the output {last}, and the last one is {STANDARD_OUTPUTS - 1}"
    return None


def arm_alone(setup: Setup, first: int, count: int | None = None) -> str | None:
    """Why a language for just a six-axis arm with a spherical wrist does not support a cell; None if it does.

    first  number of the first output; count: how many there are, None if that depends on the cell
    """
    cell = setup.cell
    if several := _one_nozzle(setup):
        return several
    if not cell.tells_posture:
        return f"postures require a spherical wrist, which {cell.arm_robot.name} does not have"
    if cell.rails:
        return f"it moves the arm alone, and here {cell.joint_names[0]} carries it"
    if cell.station is not None and len(cell.holder):
        return f"it moves the arm alone, and here {cell.station.name} moves the part"
    numbers = output_numbers(setup.problem).values()
    if min(numbers) < first:
        return f"outputs count from {first}, and program.extruder_output is {min(numbers)}"
    if count is not None and max(numbers) >= first + count:
        return f"an extruder has the output {max(numbers)}, and the last one is {first + count - 1}"
    return None


def unsupported_in_axes(setup: Setup) -> str | None:
    """Why G-code for a multi-axis machine does not support a cell; None if it does."""
    spec: MachineSpec | None = setup.problem.program.machine
    if spec is None:
        return "program.machine describes no machine"
    if spec.type != "robot" and setup.problem.as_run is not None:
        return "as_run was learned from runs of the robot, and this is another machine"
    if several := _one_nozzle(setup):
        return several
    if spec.type == "robot" and setup.cell.rails:
        return f"no letter is left for {setup.cell.joint_names[0]}, which carries the robot"
    if spec.type == "robot" and setup.cell.holder.slides.any():
        return "a sliding axis moves the part, and only letters for rotary axes are left"
    carrying = len(setup.cell.holder) if spec.type == "robot" else 0
    if carrying > len(STATION):
        return f"{carrying} axes move the part, and {len(STATION)} letters are left for them"
    if spec.filament in STATION[:carrying]:
        return f"{spec.filament} is the letter both of the filament and of an axis that moves the part"
    fibre = setup.problem.process.fibre
    orders = [f"T{each.tool}" for each in materials_of(setup.problem)]
    orders += [each for each in fibre.commands if each.startswith("M")] if fibre is not None else []
    for line in orders:
        if FLAVOURS[spec.flavour].order(line) is None:
            return (
                f"{line} cannot be sent to {spec.flavour}, which numbers tools from 1 and has M100 to M199 with P and S"
            )
    return None
