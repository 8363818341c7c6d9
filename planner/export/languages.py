"""Robot programs by language: each is written from a verified plan, read back, and held against it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

from planner.export.program import ProblemSetup, Setup
from planner.export.rapid.text import module_name
from planner.export.support import unsaid_in_axes, unsaid_in_krl, unsaid_in_rapid, unsaid_in_urscript

if TYPE_CHECKING:
    from planner.cell.cell import Cell
    from planner.plan import Plan
    from planner.problem import Problem


@dataclass(frozen=True)
class Language:
    """How a plan is said to a controller.

    unsaid      why this language cannot say what a cell does; None if it can
    write       file name → text
    complaints  what files say otherwise than the plan, beyond rounding, in words
    """

    title: str
    unsaid: Callable[[Setup], str | None]
    write: Callable[[Plan], dict[str, str]]
    complaints: Callable[[Plan, Mapping[str, str]], list[str]]


# Writer and reader of a language are loaded for who asks for it only: those of all of them take half a second.


def _rapid(plan: Plan) -> dict[str, str]:
    from planner.export.rapid.writer import rapid_files

    return rapid_files(plan)


def _rapid_complaints(plan: Plan, files: Mapping[str, str]) -> list[str]:
    from planner.export.rapid.extruder import demand_complaints, line_complaints
    from planner.export.rapid.reader import read_rapid_files
    from planner.export.readback import readback

    name = module_name(plan.name)
    program = read_rapid_files(files)
    complaints = readback(plan, program)
    if plan.problem.program.style == "socket":
        complaints += line_complaints(plan, program, files[f"{name}_lines.csv"])
    if plan.problem.program.style == "demand":
        complaints += demand_complaints(plan, program)
    return complaints


def _urscript(plan: Plan) -> dict[str, str]:
    from planner.export.urscript import script_name, urscript

    return {script_name(plan): urscript(plan)}


def _urscript_complaints(plan: Plan, files: Mapping[str, str]) -> list[str]:
    from planner.export.urscript import urscript_complaints

    return urscript_complaints(plan, files)


def _krl(plan: Plan) -> dict[str, str]:
    from planner.export.krl import krl_files

    return krl_files(plan)


def _krl_complaints(plan: Plan, files: Mapping[str, str]) -> list[str]:
    from planner.export.krl import krl_complaints

    return krl_complaints(plan, files)


def _joint_trajectory(plan: Plan) -> dict[str, str]:
    from planner.export.joint_trajectory import joint_trajectory, switches, switches_name, trajectory_name

    return {trajectory_name(plan): joint_trajectory(plan), switches_name(plan): switches(plan)}


def _joint_trajectory_complaints(plan: Plan, files: Mapping[str, str]) -> list[str]:
    from planner.export.joint_trajectory import trajectory_complaints

    return trajectory_complaints(plan, files)


def _axes(plan: Plan) -> dict[str, str]:
    from planner.export.axes.gcode import axes_gcode, file_name

    return {file_name(plan): axes_gcode(plan)}


def _axes_complaints(plan: Plan, files: Mapping[str, str]) -> list[str]:
    from planner.export.axes.gcode import axes_complaints, file_name

    return axes_complaints(plan, files[file_name(plan)])


def _extruder(plan: Plan) -> dict[str, str]:
    from planner.export.extruder import gcode

    return {"extrusion.gcode": gcode(plan)}


def _extruder_complaints(plan: Plan, files: Mapping[str, str]) -> list[str]:
    from planner.export.extruder import gcode_complaints

    return gcode_complaints(plan, files["extrusion.gcode"])


def _always(setup: Setup) -> None:
    """Of a language that says what any cell does."""


LANGUAGES: dict[str, Language] = {
    "rapid": Language("RAPID", unsaid_in_rapid, _rapid, _rapid_complaints),
    "urscript": Language("URScript", unsaid_in_urscript, _urscript, _urscript_complaints),
    "krl": Language("KRL", unsaid_in_krl, _krl, _krl_complaints),
    "joint_trajectory": Language("ROS JointTrajectory", _always, _joint_trajectory, _joint_trajectory_complaints),
    "axes": Language("multi-axis G-code", unsaid_in_axes, _axes, _axes_complaints),
    "extruder": Language("the extruder's G-code", _always, _extruder, _extruder_complaints),
}
ALWAYS = ("extruder",)  # written beside whatever moves the arm, so not asked for


@dataclass(frozen=True)
class Chosen:
    """The languages (keys of LANGUAGES) in which a plan is written, and a note on one that is left out, or none."""

    names: tuple[str, ...]
    note: str

    @property
    def words(self) -> str:
        """Which programs there are, for the summary."""
        titles = ", ".join(LANGUAGES[name].title for name in self.names)
        return f"programs: {titles}" + (f"; {self.note}" if self.note else "")


def chosen(setup: Setup) -> Chosen:
    """The languages that the problem asks for; without that, the one that the arm's controller speaks.

    A machine that the problem describes has its G-code then, too. Raises InputError for a language that was asked for
    and cannot say what the cell does.
    """
    asked = setup.problem.program.languages
    if asked is None and setup.problem.program.machine is not None:
        if (reason := LANGUAGES["axes"].unsaid(setup)) is not None:
            raise setup.problem.error("program.machine", reason)
        usual = _usual(setup)
        return Chosen(("axes", *usual.names), usual.note)
    if asked is None:
        return _usual(setup)
    for i, name in enumerate(asked):
        reason = LANGUAGES[name].unsaid(setup)
        if reason is not None:
            raise setup.problem.error(f"program.languages.{i}", f"{name} cannot say this: {reason}", "leave it out")
    return Chosen((*asked, *ALWAYS), "")


def _usual(setup: Setup) -> Chosen:
    """The language of the arm's controller, or a note where that cannot say what the cell does."""
    own = setup.cell.arm_robot.language
    reason = LANGUAGES[own].unsaid(setup)
    if reason is not None:
        return Chosen(ALWAYS, f"no {LANGUAGES[own].title} program: {reason}")
    return Chosen((own, *ALWAYS), "")


def check_languages(problem: Problem, cell: Cell) -> None:
    """Raise InputError for a language that was asked for and cannot say what the cell does, before all is planned."""
    chosen(ProblemSetup(problem, cell))
