"""Robot programs by language: each is written from a verified plan, read back, and held against it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

from planner.export.compare import compare
from planner.export.extruder.check import gcode_complaints
from planner.export.extruder.writer import gcode
from planner.export.rapid.reader import read_rapid
from planner.export.rapid.writer import module_name, pgf, rapid

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


def _write_rapid(plan: Plan) -> dict[str, str]:
    name = module_name(plan.name)
    return {f"{name}.mod": rapid(plan), f"{name}.pgf": pgf(plan)}


def _rapid_complaints(plan: Plan, files: Mapping[str, str]) -> list[str]:
    return compare(plan, read_rapid(files[f"{module_name(plan.name)}.mod"])).complaints()


LANGUAGES: dict[str, Language] = {
    "rapid": Language("RAPID", lambda plan: plan.no_rapid, _write_rapid, _rapid_complaints),
    "extruder": Language(
        "the extruder's G-code",
        lambda plan: None,
        lambda plan: {"extrusion.gcode": gcode(plan)},
        lambda plan, files: gcode_complaints(plan, files["extrusion.gcode"]),
    ),
}
