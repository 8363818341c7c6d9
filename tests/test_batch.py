"""Many problems at once: each as `solve` has it, and what one of them is refused for ends no other."""

from __future__ import annotations

import pickle
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from solved import small_plan, small_problem, write_small

from planner import Solved, Toolpath, load, solve_all
from planner.base.errors import InputError, Refusal
from planner.plan.seal import changed_since, digest_of
from planner.planning import batch

FAR = ("origin_mm: [633.5, 9.87, 380]", "origin_mm: [9000, 9.87, 380]")


@pytest.mark.slow
def test_each_has_its_plan_or_its_reason_in_their_order(tmp_path: Path) -> None:
    told: list[Solved] = []
    far = write_small(tmp_path / "far", FAR)
    found = solve_all(
        [small_problem(), far, tmp_path / "none.yaml", write_small(tmp_path)], baseline=False, done=told.append
    )
    assert [one.verified for one in found] == [True, False, False, True] and tuple(told) == found
    assert found[0].plan is not None and digest_of(found[0].plan.trajectory) == small_plan().seal["trajectory"]
    assert isinstance(found[1].error, Refusal) and found[1].plan is None and "reach" in str(found[1].error)
    assert isinstance(found[2].error, InputError) and "no such problem file" in repr(found[2])
    assert [one.name for one in found] == ["small", str(far), str(tmp_path / "none.yaml"), "small"]
    assert repr(found[0]).startswith("<Solved <Plan small by ladder: verified") and found[0].seconds > 0.0
    assert solve_all([]) == ()


@pytest.mark.slow
def test_several_processes_do_the_same(tmp_path: Path) -> None:
    line = np.linspace([0.0, -0.02, 0.06], [0.0, 0.02, 0.06], 41)
    arrays = load("peer_cap", toolpath=Toolpath.from_arrays(line, [0.0, 0.0, 1.0]))
    problems = [load(small_problem(), process__speed_mm_s=20), write_small(tmp_path / "far", FAR), "no_problem", arrays]
    one, two = (solve_all(problems, baseline=False, jobs=jobs) for jobs in (1, 2))
    for here, there in zip(one, two, strict=True):
        assert str(here.error) == str(there.error) and type(here.error) is type(there.error)
        assert (here.plan is None) == (there.plan is None)
        if here.plan is not None and there.plan is not None:
            assert here.plan.seal == there.plan.seal and changed_since(there.plan) == ()
    assert [found.verified for found in two] == [True, False, False, True]


@pytest.mark.parametrize(
    ("problems", "options", "message"),
    [
        ("peer_cap", {}, "problems: must be a list of problems (solve takes one of them)"),
        (["peer_cap", 3], {}, "problems[1]: is of type int (a file, a shipped name"),
        ([], {"jobs": 0}, "jobs: 0 is not a number of processes (1 to 256)"),
        ([], {"jobs": 2.0}, "jobs: 2.0 is not a number of processes"),
        ([], {"jobs": 2, "terms": [object()]}, "terms: cannot be evaluated in other processes (jobs=1)"),
        ([], {"jobs": 2, "strategy": "mine"}, "strategy: other processes do not know 'mine' (jobs=1)"),
    ],
)
def test_wrong_arguments_are_said(problems: Any, options: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError) as error:
        solve_all(problems, **options)
    assert message in str(error.value)


def test_what_is_wrong_for_all_is_told_of_each() -> None:
    found = solve_all([small_problem(), small_problem()], strategy="laddre")
    assert ["did you mean ladder" in str(one.error) for one in found] == [True, True]


def test_a_refusal_holds_nothing_of_its_search_and_finds_its_hints_when_it_is_asked(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    planned: list[bool] = []

    def refused(*args: Any, baseline: bool, **options: Any) -> Any:
        planned.append(baseline)
        raise Refusal("no way", hints=lambda: ("higher",)) from ValueError("inside")

    monkeypatch.setattr(batch, "solve", refused)
    (found,) = solve_all(["peer_cap"])
    error = found.error
    assert isinstance(error, Refusal) and str(error) == "no way"
    assert (error.__traceback__, error.__cause__, error.__context__) == (None, None, None)
    assert planned == [True]
    assert error.hints == error.hints == ("higher",) and planned == [True, False]

    done = batch._solved(batch._Item("peer_cap", None, 0.004, None, True, (), None))
    assert pickle.loads(pickle.dumps(done.error)).hints == () and len(planned) == 3  # none is tried on the way


def test_the_file_of_a_plan_goes_when_it_is_loaded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(batch, "Plan", SimpleNamespace(load=lambda path: path.read_text()))
    file = tmp_path / "0.npz"
    file.write_text("a plan")
    assert batch._taken(file) == "a plan" and not file.exists() and batch._taken(None) is None
