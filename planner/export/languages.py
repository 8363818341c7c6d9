"""Robot programs by language: each is written from a verified plan, read back, and held against it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

from planner.export.compare import compare
from planner.export.extruder.check import gcode_complaints
from planner.export.extruder.writer import gcode
from planner.export.rapid.check import line_complaints
from planner.export.rapid.reader import read_rapid
from planner.export.rapid.text import module_name
from planner.export.rapid.writer import rapid_files

if TYPE_CHECKING:
    from planner.plan import Plan


@dataclass(frozen=True)
class Language:
    """How a plan is said to a controller.

    unsaid      why this language cannot say a plan; None if it can
    write       file name → text
    complaints  what files say otherwise than the plan, beyond rounding, in words
    """

    title: str
    unsaid: Callable[[Plan], str | None]
    write: Callable[[Plan], dict[str, str]]
    complaints: Callable[[Plan, Mapping[str, str]], list[str]]


def _rapid_complaints(plan: Plan, files: Mapping[str, str]) -> list[str]:
    name = module_name(plan.problem.name)
    program = read_rapid(files[f"{name}.mod"])
    complaints = compare(plan, program).complaints()
    if plan.problem.program.style == "socket":
        complaints += line_complaints(plan, program, files[f"{name}_lines.csv"])
    return complaints


LANGUAGES: dict[str, Language] = {
    "rapid": Language("RAPID", lambda plan: plan.no_rapid, rapid_files, _rapid_complaints),
    "extruder": Language(
        "the extruder's G-code",
        lambda plan: None,
        lambda plan: {"extrusion.gcode": gcode(plan)},
        lambda plan, files: gcode_complaints(plan, files["extrusion.gcode"]),
    ),
}
