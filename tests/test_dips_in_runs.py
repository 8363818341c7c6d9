"""A plan whose tip is in the part only where nothing is laid is planned again with short runs."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from planner.plan import Check
from planner.planning import pipeline
from planner.planning.candidates import DEFAULT
from planner.planning.short_runs import PRESSED_CHECK, TIP_CHECK, dips_in_a_run
from planner.problem import load_problem

LAID = np.array([False, True, True])


def check(name: str, worst: float, ok: bool, sample: int) -> Check:
    return Check(name, worst, 0.0, "mm", ok, "t = 2.000 s, travel", sample=sample)


def planned(*checks: Check) -> Any:
    report = SimpleNamespace(checks=checks)
    plan = SimpleNamespace(report=report, trajectory=SimpleNamespace(deposit=LAID), verified=all(c.ok for c in checks))
    return "given", plan, ()


GOOD, IN_A_RUN, ON_A_BEAD = (
    check(TIP_CHECK, 0.0, True, 0),
    check(TIP_CHECK, -0.027, False, 0),
    check(TIP_CHECK, -1.0, False, 1),
)
OTHER = check("axis on the normal", 1.0, False, 0)
PRESSED, PRESSED_ON_A_BEAD = check(PRESSED_CHECK, 0.737, False, 0), check(PRESSED_CHECK, 0.737, False, 2)
NEAR = check("nozzle clear of part and print", 1.2, False, 0)
DIPS, PRESSES, TOO_NEAR = (
    "the tip is 0.027 mm in the part (t = 2.000 s, travel)",
    "the nozzle presses 0.74 of a bead's height into the print (t = 2.000 s, travel)",
    "the nozzle is 1.2 mm from part or print (t = 2.000 s, travel)",
)


@pytest.mark.parametrize(
    ("checks", "said"),
    [
        ((IN_A_RUN,), DIPS), ((PRESSED, NEAR), PRESSES), ((NEAR,), TOO_NEAR), ((IN_A_RUN, PRESSED, GOOD), DIPS),
        ((ON_A_BEAD,), ""), ((IN_A_RUN, OTHER), ""), ((GOOD,), ""), ((PRESSED_ON_A_BEAD, NEAR), ""),
    ],
)  # fmt: skip
def test_only_what_short_runs_may_mend_is_told(checks: tuple[Check, ...], said: str) -> None:
    _, plan, _ = planned(*checks)
    told = dips_in_a_run(plan.trajectory, plan.report)
    assert told == (said and f"with their usual length {said}")


@pytest.mark.parametrize(("mine", "second", "taken"), [(False, GOOD, 1), (False, IN_A_RUN, 0), (True, GOOD, 0)])
def test_short_runs_are_taken_where_they_give_a_verified_plan(
    monkeypatch: pytest.MonkeyPatch, mine: bool, second: Check, taken: int
) -> None:
    """And a user's own length of runs stays."""
    plans = [planned(IN_A_RUN), planned(second)]
    monkeypatch.setattr(pipeline, "all_short", lambda given, because: ("short", because))
    problem = load_problem("peer_cap", ["process.run_in_mm=3"] if mine else [])
    given: Any = SimpleNamespace(problem=problem)

    def print_of(given: Any, over: Any = None) -> Any:
        return plans[int(isinstance(given, tuple) and given[0] == "short")]

    found, _ = pipeline._as_clear_as_can_be(DEFAULT, given, print_of, SimpleNamespace(), None)  # type: ignore[arg-type]
    assert found is plans[taken]
