"""A folder of results that is written elsewhere: what its plan.json says."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from planner.errors import InputError
from planner.report.wording import counted
from planner.view.content import Content, flattened
from planner.view.figures import figures_of
from planner.view.state import Outcome

LARGEST_PLAN = 50_000_000  # bytes of plan.json; the logo's ten layers have 1 MB
WATCHED = ("plan.json", "report.html")


def read_results(folder: Path) -> tuple[str, str, Outcome, Content]:
    """Problem, strategy, what came of it, and the settings that it was made with. Raises InputError where it is none."""
    if not folder.is_dir():
        raise InputError("is gone", file=folder, hint="the view goes on as soon as it is there again")
    for name in reversed(WATCHED):
        if not (folder / name).is_file():
            raise InputError(f"has no {name}", file=folder, hint="the view goes on as soon as results are there")
    path = folder / "plan.json"
    try:
        with path.open("rb") as stream:
            raw = stream.read(LARGEST_PLAN + 1)
        plan = json.loads(raw)
    except OSError as error:
        raise InputError(f"cannot be read: {error.strerror}", file=path) from error
    except (ValueError, RecursionError) as error:
        raise InputError("is not JSON", file=path, hint="it is written by planner.solve") from error
    if len(raw) > LARGEST_PLAN or not isinstance(plan, dict):
        raise InputError("is no plan", file=path, hint="it is written by planner.solve")
    problem, strategy = (_text(plan, name, path) for name in ("problem", "strategy"))
    settings = Content(tuple(flattened({"strategy": strategy, **_section(plan, "settings")})))
    return problem, strategy, _outcome(plan), settings


def _outcome(plan: dict[str, Any]) -> Outcome:
    numbers = {k: float(v) for k, v in _section(plan, "metrics").items() if isinstance(v, int | float)}
    if not numbers:
        return Outcome("refused", "no plan: the report says why")
    checks = plan.get("checks", [])
    failed = [str(check.get("name")) for check in checks if isinstance(check, dict) and check.get("ok") is not True]
    size = counted(numbers.get("beads", 0), "bead") + ", " + counted(numbers.get("layers", 0), "layer")
    if plan.get("verified") is True:
        return Outcome("verified", f"verified: {len(checks)} checks hold; {size}", figures_of(numbers))
    return Outcome("failed", f"not verified: {', '.join(failed) or 'see the report'}; {size}", figures_of(numbers))


def _section(plan: dict[str, Any], name: str) -> dict[str, Any]:
    value = plan.get(name)
    return value if isinstance(value, dict) else {}


def _text(plan: dict[str, Any], name: str, path: Path) -> str:
    value = plan.get(name)
    if not isinstance(value, str):
        raise InputError("is missing, or no text", file=path, field=name, hint="it is written by planner.solve")
    return value[:80]
