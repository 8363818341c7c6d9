"""A second process: what it computes is what would have been computed here, and what goes wrong there is told here."""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from solved import bed_plan, small_plan, solve_alone

from planner.base.errors import InputError, PlannerError, Refusal
from planner.base.processes import MANY, Job, in_background, in_halves, in_turn, of_each, spare_core
from planner.collision.scene import NOTHING, obstacles_of
from planner.plan import Plan
from planner.plan.seal import sealed
from planner.planning import pipeline as planning
from planner.planning.files import write_files
from planner.resolve.strategies import STRATEGIES
from planner.toolpath.task import tasks_of
from planner.verify.verdict import Report, verify

needs_two_cores = pytest.mark.skipif(not spare_core(), reason="nothing is forked here")


def squares(first: int, last: int) -> list[int]:
    return [k * k for k in range(first, last)]


def refuse(reason: str, bead: int) -> None:
    raise Refusal(reason, bead=bead, s_mm=2.5, point_mm=(1.0, 2.0, 3.0))


def mistake() -> None:
    raise InputError("is wrong", file="a.yaml", line=3, field="cell", hint="try b")


def bug() -> None:
    raise KeyError("a bug")


@needs_two_cores
def test_errors_arrive_whole() -> None:
    with in_background(refuse, "too far", 7) as wait, pytest.raises(Refusal) as refusal:
        wait()
    told = refusal.value
    assert (told.reason, told.bead, told.s_mm, told.point_mm) == ("too far", 7, 2.5, (1.0, 2.0, 3.0))
    assert str(told) == "bead 7, 2.5 mm along it: too far"
    with in_background(mistake) as wait, pytest.raises(PlannerError) as error:
        wait()
    assert str(error.value) == "a.yaml:3: cell: is wrong (try b)"
    with in_background(bug) as wait, pytest.raises(RuntimeError, match="bug failed in its own process"):
        wait()


@needs_two_cores
def test_halves_are_the_whole() -> None:
    for count in (0, 1, 2, 3, 10):
        for middle in (None, 0, 1, count):
            parts = in_halves(squares, count, True, middle)
            assert [k for part in parts for k in part] == squares(0, count)


def _same(one: Report, other: Report) -> None:
    assert one.checks == other.checks
    assert one.metrics == other.metrics
    assert one.series.keys() == other.series.keys()
    for name, values in one.series.items():
        np.testing.assert_array_equal(values, other.series[name], err_msg=name)


class _OneByOne:
    """An executor that does everything where it is asked for."""

    def __init__(self, *_: int) -> None: ...

    def __enter__(self) -> _OneByOne:
        return self

    def __exit__(self, *_: object) -> None: ...

    def submit(self, function: Callable[..., Any], *arguments: Any) -> Future[Any]:
        done: Future[Any] = Future()
        done.set_result(function(*arguments))
        return done


@pytest.mark.slow
@pytest.mark.parametrize("plan", [small_plan, bed_plan], ids=["positioner", "bed"])
def test_verification_in_threads_is_the_same(plan: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    plan = plan()
    spoilt = replace(plan.trajectory, bead=np.roll(plan.trajectory.bead, 300))
    for trajectory in (plan.trajectory, spoilt):
        given = plan.problem, plan.cell, plan.toolpath, trajectory
        beside = verify(*given)
        with monkeypatch.context() as patch:
            patch.setattr("planner.verify.verdict.ThreadPoolExecutor", _OneByOne)
            patch.setattr("planner.verify.executed.ThreadPoolExecutor", _OneByOne)
            _same(verify(*given), beside)


@needs_two_cores
def test_trajectory_in_two_processes_is_the_same() -> None:
    plan = small_plan()
    tasks = tasks_of(plan.problem, plan.toolpath)
    paths = STRATEGIES[plan.strategy](
        plan.cell, tasks, plan.problem.resolve, obstacles_of(plan.problem, plan.cell, plan.toolpath)
    )
    here, beside = (
        planning.trajectory_of(plan.problem, plan.cell, plan.toolpath, paths, NOTHING, plan.trajectory.dt, both)[0]
        for both in (False, True)
    )
    for name, values in vars(here).items():
        np.testing.assert_array_equal(values, getattr(beside, name), err_msg=name)
        np.testing.assert_array_equal(values, getattr(plan.trajectory, name), err_msg=name)


def _files(folder: Path) -> dict[str, bytes]:
    found = {path.name: path.read_bytes() for path in folder.iterdir()}
    del found["plan.json"]  # holds the time it took
    return found


@needs_two_cores
def test_files_of_two_processes_are_the_same(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    plan: Plan = small_plan()
    monkeypatch.setattr(planning, "WORTH_A_FORK", 0)
    for name, both in (("here", False), ("beside", True)):
        (tmp_path / name).mkdir()
        write_files(plan, tmp_path / name, second_process=both)
    assert len(_files(tmp_path / "here")) == 7
    assert _files(tmp_path / "here") == _files(tmp_path / "beside")


@needs_two_cores
def test_an_unverified_plan_has_no_robot_code_from_any_process(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(planning, "WORTH_A_FORK", 0)
    plan = small_plan()
    failed = replace(plan, checks=(replace(plan.checks[0], ok=False),))
    write_files(sealed(failed), tmp_path, second_process=True)
    assert {path.name for path in tmp_path.iterdir()} == {
        "plan.json",
        "trajectory.csv",
        "report.html",
        "report_part.stl",
    }


@pytest.mark.slow
@needs_two_cores
def test_baseline_and_maps_beside_are_those_made_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    plan = small_plan()
    monkeypatch.setattr(planning, "WORTH_A_FORK", 0)
    monkeypatch.setattr(planning, "WORTH_HALVES", 0)
    beside = planning.solve(plan.problem, second_process=True)
    assert beside.baseline == plan.baseline and set(beside.baseline) == {"as_published"}
    assert beside.metrics == plan.metrics and beside.checks == plan.checks
    assert len(beside.roll_maps) == len(plan.roll_maps) > 0
    for made, alone in zip(beside.roll_maps, plan.roll_maps, strict=True):
        for name, values in vars(alone).items():
            np.testing.assert_array_equal(getattr(made, name), values, err_msg=name)
            assert not getattr(made, name).flags.writeable


@pytest.mark.slow
def test_a_plan_says_of_the_baseline_what_its_own_plan_says() -> None:
    plan = small_plan()
    metrics = solve_alone(plan.problem, "as_published").metrics
    bound = {"bound_any_path_s", "bound_gap_fraction"}  # which is of the problem, and is found once
    assert plan.baseline == {"as_published": {key: metrics[key] for key in metrics if key not in bound}}


def test_each_of_many_items_in_order_from_two_processes() -> None:
    here = os.getpid()
    found = of_each(lambda k: (k * k, os.getpid()), range(MANY))
    assert [square for square, _ in found] == [k * k for k in range(MANY)]
    assert len({where for _, where in found}) == (2 if spare_core() else 1)
    assert {where for _, where in of_each(lambda k: (k, os.getpid()), range(MANY - 1))} == {here}


def test_no_other_thread_than_the_main_one_copies_the_process() -> None:
    with ThreadPoolExecutor(1) as pool:
        found = pool.submit(of_each, lambda k: os.getpid(), range(MANY)).result()
    assert set(found) == {os.getpid()}


def test_what_is_refused_of_many_items_is_the_first_of_them() -> None:
    def half(k: int) -> int:
        if k in (3, MANY - 1):
            refuse("no way", k)
        return k

    with pytest.raises(Refusal) as caught:
        of_each(half, range(MANY))
    assert caught.value.bead == 3


def test_jobs_begin_when_those_that_give_them_are_done() -> None:
    done: list[tuple[int, ...]] = []

    def job(*path: int) -> list[Job]:
        done.append(path)
        return [partial(job, *path, k) for k in range(3)] if len(path) < 4 else []

    in_turn([partial(job, 0), partial(job, 1)])
    assert sorted(done) == sorted(set(done))
    assert len(done) == 2 * (1 + 3 + 9 + 27)
    for path in done:
        assert len(path) == 1 or done.index(path[:-1]) < done.index(path)


def test_a_job_that_fails_ends_the_others() -> None:
    begun: list[int] = []

    def job(k: int) -> list[Job]:
        begun.append(k)
        if k == 5:
            refuse("no way", k)
        return [partial(job, k + 1)]

    with pytest.raises(Refusal):
        in_turn([partial(job, 0)])
    assert begun == [0, 1, 2, 3, 4, 5]
