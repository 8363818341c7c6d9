"""Writes the results of a plan: tables of any plan, robot code only of verified ones."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from planner.base.errors import OutputError, PlannerError, Refusal
from planner.base.results import digest
from planner.export.controllers import CONTROLLERS
from planner.export.forecast import FORECAST, Forecast, forecast, forecast_json, joined
from planner.export.languages import LANGUAGES, chosen
from planner.export.plan_json import plan_json, refusal_json
from planner.export.rapid.text import module_name, written_notes
from planner.export.tables import part_stl, write_table

if TYPE_CHECKING:
    from planner.plan import Plan
    from planner.problem import Problem

PLAN, REPORT = "plan.json", "report.html"
LONGEST_HEADER = 20_000  # characters


def write_trajectory(plan: Plan, folder: Path) -> Path:
    """Write trajectory.csv of any plan; returns its path. OutputError if that is impossible."""
    return _write(folder / "trajectory.csv", lambda stream: write_table(plan, stream))


def write_plan(plan: Plan, folder: Path) -> Path:
    """Write plan.json of any plan, after all other files, which it lists. Returns its path.

    OutputError if that is impossible.
    """
    return _write_text(folder / PLAN, plan_json(plan, _digests(folder)))


def _digests(folder: Path) -> dict[str, str]:
    """SHA-256 of each file next to plan.json, by name; except the report, which contains run times."""
    beside = sorted(path for path in folder.iterdir() if path.is_file() and path.name not in (PLAN, REPORT))
    return {path.name: digest(path) for path in beside}


def write_part(plan: Plan, folder: Path) -> None:
    """Write report_part.stl if the part has a shape of its own. OutputError if that is impossible."""
    shape = plan.toolpath.shape
    if shape is not None:
        _write(folder / "report_part.stl", lambda stream: stream.write(part_stl(shape)), binary=True)


def write_refusal(problem: Problem, strategy: str, refusal: Refusal, folder: Path) -> Path:
    """Write the plan.json of a problem without a plan: not verified, with where and why it was refused."""
    return _write_text(folder / PLAN, refusal_json(problem, strategy, refusal))


class ProgramDiffers(PlannerError):
    """A program that was read back differs from its plan; says in which language, and how."""


def write_robot_code(plan: Plan, folder: Path) -> tuple[Path, ...]:
    """Write a verified plan in the languages chosen for it; returns the paths of the programs.

    How controllers will run them is written alongside, as forecast.json.
    All programs are read back and compared with the plan before anything is written. Raises ProgramDiffers if one of
    them differs from the plan, ValueError if the plan is not verified (both are bugs here or in the caller), InputError
    for a requested language that does not support the cell, OutputError if the files cannot be written.
    """
    texts: dict[str, str] = {}
    foretold: dict[str, Forecast] = {}
    for name in chosen(plan).names:
        language = LANGUAGES[name]
        counted = language.plan(plan)
        own = language.write(counted)
        if differences := language.differences(counted, own):
            raise ProgramDiffers(f"{language.title} does not repeat the plan: " + "; ".join(differences))
        texts |= own
        if name in CONTROLLERS:
            controller = CONTROLLERS[name].measured(plan.cell.arm_robot.controller)
            planned = [None if plan.asked is None else each.trajectory for each in plan.stretches]
            each = zip(language.programs(counted, own), planned, strict=True)
            parts = [forecast(program, part.cell, controller, path) for (part, program), path in each]
            foretold[name] = joined(parts, controller)
    if foretold:
        _write_text(folder / FORECAST, forecast_json(foretold))
    return tuple(_write_text(folder / name, text) for name, text in texts.items())


def forecast_words(folder: Path) -> tuple[str, ...]:
    """How controllers will run the programs of a folder, in words; empty without a program."""
    path = folder / FORECAST
    if not path.exists():
        return ()
    with path.open(encoding="utf-8") as stream:
        return tuple(words for each in json.load(stream)["forecasts"].values() for words in each["words"])


def program_notes(plan: Plan, folder: Path) -> tuple[str, ...]:
    """Notes for users from the header of a folder's RAPID program; empty without a program."""
    path = folder / f"{module_name(plan.name)}.mod"
    if not path.exists():
        return ()
    with path.open(encoding="utf-8") as stream:
        return written_notes(stream.read(LONGEST_HEADER))


def _write_text(path: Path, text: str) -> Path:
    return _write(path, lambda stream: stream.write(text))


def _write(path: Path, fill: Callable[[Any], object], binary: bool = False) -> Path:
    """Fill a file next to its destination, then move it there: an interruption leaves no half-written file."""
    part = path.with_name(path.name + ".part")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        try:
            with part.open("wb") if binary else part.open("w", encoding="utf-8", newline="\n") as stream:
                fill(stream)
            os.replace(part, path)
        finally:
            part.unlink(missing_ok=True)
    except OSError as error:
        raise OutputError(f"cannot write {path}: {error.strerror}") from error
    return path
