"""Finds what was planned from a saved plan, a folder of results, a problem file, or a shipped problem's name."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

from planner.base.errors import InputError
from planner.plan import Plan
from planner.planning.options import DEFAULT_DT
from planner.problem import Problem, load_problem, shipped_problems

SAVED = (".npz", ".plan")  # suffixes of saved plans


def planned_problem(given: str) -> tuple[Problem, Plan | None]:
    """The problem that was planned, and the plan itself if it was saved.

    Raises InputError if the problem's file can no longer be found.
    """
    path = Path(given)
    if _is_results(given):
        return _of_folder(path), None
    if path.suffix in SAVED or (path.is_file() and path.suffix not in (".yaml", ".yml")):
        plan = Plan.load(path)
        return _of_plan(plan, path), plan
    return load_problem(given), None


@dataclass(frozen=True)
class PlannedWith:
    """What else determines a plan of a problem: strategy (None: the problem's own), first bead, sample interval [s]."""

    strategy: str | None = None
    first_bead: int = 0
    dt: float = DEFAULT_DT


def planned_with(given: str, plan: Plan | None) -> PlannedWith:
    """What determined a plan besides its problem; plan: as `planned_problem` returned it."""
    if plan is not None:
        return PlannedWith(plan.strategy, plan.first_bead, float(plan.settings.get("dt", DEFAULT_DT)))
    return planned_results(Path(given)).made if _is_results(given) else PlannedWith()


def check_as_planned(given: str, problem: Problem) -> None:
    """Raise InputError if the problem file of a folder of results has changed since it was planned."""
    if not _is_results(given):
        return
    then, now = planned_results(Path(given)).sha256, problem.sources.sha256
    if then and now and then != now:
        hint = "restore it; if it still gives the same plan, name it instead of the folder, with the same --set"
        raise InputError(f"was changed since {given} was planned", file=problem.file, hint=hint)


def _is_results(given: str) -> bool:
    return Path(given).is_dir() and given not in shipped_problems()


def _of_plan(plan: Plan, path: Path) -> Problem:
    """The problem of a plan, read again from its file."""
    if plan.problem.from_arrays:
        raise InputError("its waypoints are in no file", file=path, hint="plan them from a file of waypoints")
    if not plan.problem.file.is_file():
        raise InputError(f"its problem file {plan.problem.file} no longer exists", file=path)
    return load_problem(plan.problem.file, plan.problem.sources.overrides)


@dataclass(frozen=True)
class PlannedResults:
    """What a results folder's plan.json says of its problem: name, file or shipped name (None: from arrays), `--set`
    overrides (None: not stated), what else determined the plan, and the file's SHA-256 then (None: not stated)."""

    name: str
    problem_file: str | None
    overrides: tuple[str, ...] | None
    made: PlannedWith
    sha256: str | None


def planned_results(folder: Path) -> PlannedResults:
    """Read what a folder of results says of its problem. Raises InputError for one that solve did not write."""
    file = folder / "plan.json"
    try:
        held = json.loads(file.read_text(encoding="utf-8"))
        name, settings = str(held["problem"]), held.get("settings")
        overrides = None if settings is None else tuple(str(each) for each in settings["overrides"])
        given = held.get("problem_file", name)
        dt = float((settings or {}).get("dt", DEFAULT_DT))
        made = PlannedWith(held.get("strategy"), int(held.get("first_bead", 0)), dt)
        sha256 = held.get("problem_sha256")
    except FileNotFoundError as error:
        raise InputError("holds no plan.json", file=folder, hint="a folder that solve wrote") from error
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise InputError("is no plan.json that solve wrote", file=file) from error
    given, sha256 = (each if isinstance(each, str) else None for each in (given, sha256))
    return PlannedResults(name, given, overrides, made, sha256)


def _of_folder(folder: Path) -> Problem:
    """The problem of a folder of results: a shipped one, or the file, relative to here, the folder or its parents."""
    held = planned_results(folder)
    given, overrides = held.problem_file, held.overrides
    if overrides is None:
        raise InputError("is no plan.json that solve wrote", file=folder / "plan.json")
    if given is None:
        raise InputError("was planned from waypoints in arrays, which are in no file", file=folder)
    if given in shipped_problems():
        return load_problem(given, overrides)
    found = next((base / given for base in (Path(), folder, *folder.parents) if (base / given).is_file()), None)
    if found is None:
        hint = "run this where it was planned, or name the problem file instead of the folder, with the same --set"
        raise InputError(f"its problem file {given} does not exist", file=folder, hint=hint)
    return load_problem(found, overrides)
