"""Robot programs by language: each is written from a verified plan, read back, and compared with it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from importlib import import_module
from typing import TYPE_CHECKING, Protocol, cast

from planner.export.program import ProblemSetup, RobotProgram, Setup
from planner.export.support import (
    VAL3_OUTPUTS,
    arm_alone,
    check_rapid_names,
    unsupported_in_axes,
    unsupported_in_joint_trajectory,
    unsupported_in_krl,
    unsupported_in_rapid,
    unsupported_in_urscript,
)

if TYPE_CHECKING:
    from planner.cell.cell import Cell
    from planner.plan import Plan
    from planner.problem import Problem


class _LanguageModule(Protocol):
    def write(self, plan: Plan) -> dict[str, str]: ...

    def differences(self, plan: Plan, files: Mapping[str, str]) -> list[str]: ...


class _RobotModule(_LanguageModule, Protocol):
    def program(self, plan: Plan, files: Mapping[str, str]) -> RobotProgram: ...


class _SeveralNozzles(_RobotModule, Protocol):
    def programs(self, files: Mapping[str, str]) -> tuple[RobotProgram, ...]: ...


@dataclass(frozen=True)
class Language:
    """A language of robot controllers, or of extruders.

    module       under planner.export, with `write` and `differences`; loaded on first use, as all of them together take
                 half a second
    unsupported  why a program for this cell cannot be written in it; None if it can
    counted      it gives postures in the joint convention of industrial controllers, whatever the arm's URDF does
    moving_only  its programs have no held axes: a part's holder is not a station if all of its axes are held
    """

    title: str
    module: str
    unsupported: Callable[[Setup], str | None]
    counted: bool = False
    moving_only: bool = False

    def plan(self, plan: Plan) -> Plan:
        """The plan with the motion that programs command, and the joints that this language uses."""
        plan = plan if plan.asked is None else replace(plan, trajectory=plan.asked, asked=None)
        plan = plan.moving_only if self.moving_only else plan
        return plan.as_counted if self.counted else plan

    def write(self, plan: Plan) -> dict[str, str]:
        """File name → text. ValueError (the caller's mistake) if the plan is not verified, or the language does not
        support its cell."""
        plan = self.plan(plan)
        if not plan.verified:
            raise ValueError("robot code is written for verified plans only")
        if (reason := self.unsupported(plan)) is not None:
            raise ValueError(reason)
        return self._module.write(plan)

    def differences(self, plan: Plan, files: Mapping[str, str]) -> list[str]:
        """Differences of files from the plan beyond rounding, in words. InputError if they cannot be read."""
        return self._module.differences(self.plan(plan), files)

    def program(self, plan: Plan, files: Mapping[str, str]) -> RobotProgram:
        """The program in files, ready to be played; for languages with a row in CONTROLLERS.

        Raises InputError if there are several nozzles, see `programs`.
        """
        if plan.cell.nozzles:
            raise plan.problem.error("cell.nozzles", "this supports only programs with one nozzle")
        return cast("_RobotModule", self._module).program(self.plan(plan), files)

    def programs(self, plan: Plan, files: Mapping[str, str]) -> tuple[tuple[Plan, RobotProgram], ...]:
        """The program while each nozzle is in use, with the plan of that stretch, see `Plan.stretches`."""
        plan = self.plan(plan)
        if not plan.cell.nozzles:
            return ((plan, self.program(plan, files)),)
        return tuple(zip(plan.stretches, cast("_SeveralNozzles", self._module).programs(files), strict=True))

    @property
    def _module(self) -> _LanguageModule:
        return cast("_LanguageModule", import_module(f"planner.export.{self.module}"))


def _always(setup: Setup) -> None:
    """For a language that supports every cell."""


LANGUAGES: dict[str, Language] = {
    "rapid": Language("RAPID", "rapid.language", unsupported_in_rapid, counted=True),
    "urscript": Language("URScript", "urscript", unsupported_in_urscript, moving_only=True),
    "krl": Language("KRL", "krl", unsupported_in_krl, counted=True),
    "fanuc": Language("FANUC TP", "fanuc", partial(arm_alone, first=1), counted=True, moving_only=True),
    "inform": Language("INFORM", "inform", partial(arm_alone, first=1), counted=True, moving_only=True),
    "val3": Language("VAL3", "val3", partial(arm_alone, first=0, count=VAL3_OUTPUTS), counted=True, moving_only=True),
    "kawasaki": Language("Kawasaki AS", "kawasaki", partial(arm_alone, first=1), counted=True, moving_only=True),
    "melfa": Language("MELFA-BASIC", "melfa", partial(arm_alone, first=0), counted=True, moving_only=True),
    "joint_trajectory": Language("ROS JointTrajectory", "joint_trajectory", unsupported_in_joint_trajectory),
    "axes": Language("multi-axis G-code", "axes.gcode", unsupported_in_axes, moving_only=True),
    "extruder": Language("the extruder's G-code", "extruder", _always),
}
ALWAYS = ("extruder",)  # always written alongside the arm's program, so never requested


@dataclass(frozen=True)
class Chosen:
    """The languages (keys of LANGUAGES) in which a plan is written, and a note on one left out, or empty."""

    names: tuple[str, ...]
    note: str

    @property
    def words(self) -> str:
        """The programs written, for the summary."""
        titles = ", ".join(LANGUAGES[name].title for name in self.names)
        return f"programs: {titles}" + (f"; {self.note}" if self.note else "")


def chosen(setup: Setup) -> Chosen:
    """The languages that the problem requests; by default, that of the arm's controller.

    By default, a machine that the problem describes gets its G-code, too. Raises InputError for a requested language
    that does not support the cell.
    """
    asked = setup.problem.program.languages
    if asked is None and setup.problem.program.machine is not None:
        if (reason := LANGUAGES["axes"].unsupported(setup)) is not None:
            raise setup.problem.error("program.machine", reason)
        usual = _usual(setup)
        return Chosen(("axes", *usual.names), usual.note)
    if asked is None:
        return _usual(setup)
    for i, name in enumerate(asked):
        reason = LANGUAGES[name].unsupported(setup)
        if reason is not None:
            raise setup.problem.error(f"program.languages.{i}", f"{name} cannot say this: {reason}", "leave it out")
    return Chosen((*asked, *ALWAYS), "")


def _usual(setup: Setup) -> Chosen:
    """The language of the arm's controller, or a note if that does not support the cell."""
    own = setup.cell.arm_robot.language
    reason = LANGUAGES[own].unsupported(setup)
    if reason is not None:
        return Chosen(ALWAYS, f"no {LANGUAGES[own].title} program: {reason}")
    return Chosen((own, *ALWAYS), "")


def check_languages(problem: Problem, cell: Cell) -> None:
    """Raise InputError, before anything is planned, for a requested language that does not support the cell, and for a
    name in the problem that a program cannot have."""
    if "rapid" in chosen(ProblemSetup(problem, cell)).names:
        check_rapid_names(problem)
