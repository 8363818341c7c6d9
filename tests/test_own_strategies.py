"""Strategies of a user's own: planned, verified and told as any other, and what is said of wrong ones."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from solved import small_problem

from planner import STRATEGIES, Cell, JointPath, NozzleTask, joint_paths, load, register_strategy, solve
from planner.base.errors import InputError, Refusal
from planner.cell.cell import build_cell
from planner.collision.scene import NOTHING, Obstacles
from planner.problem.settings import ResolveSpec
from planner.toolpath.build import build_toolpath
from planner.toolpath.task import tasks_of


def table_turned(
    cell: Cell, tasks: Sequence[NozzleTask], settings: ResolveSpec, obstacles: Obstacles
) -> Sequence[JointPath]:
    """The paths of as_published, by way of what a user would call."""
    known = STRATEGIES["as_published"](cell, tasks, settings, obstacles)
    chosen = [path.q[:, list(cell.chosen)] for path in known]
    return joint_paths(
        cell, tasks, [path.roll for path in known], chosen=chosen, branches=[path.branch for path in known]
    )


@pytest.fixture(autouse=True)
def as_it_was(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    before = dict(STRATEGIES)
    yield
    STRATEGIES.clear()
    STRATEGIES.update(before)


def given() -> tuple[Cell, tuple[NozzleTask, ...]]:
    problem = small_problem()
    return build_cell(problem), tasks_of(problem, build_toolpath(problem))


@pytest.mark.slow
def test_it_plans_as_any_other_and_stands_beside_the_baseline() -> None:
    register_strategy("my_table", table_turned)
    plan, like = (
        solve(small_problem(), strategy="my_table"),
        solve(small_problem(), strategy="as_published", baseline=False),
    )
    assert plan.strategy == plan.resolved_by == "my_table"
    assert (plan.paths[0].roll == like.paths[0].roll).all()
    assert np.abs(plan.paths[1].q - like.paths[1].q).max() < 1e-12
    assert set(plan.baseline) == {"as_published"} and plan.baseline["as_published"]
    assert {check.name for check in plan.checks} == {check.name for check in like.checks}


@pytest.mark.slow
def test_what_it_answers_is_verified() -> None:
    def off(cell: Cell, tasks: Any, settings: Any, obstacles: Any) -> Any:
        return [replace(path, q=path.q + 0.01) for path in table_turned(cell, tasks, settings, obstacles)]

    register_strategy("off", off)
    plan = solve(small_problem(), strategy="off", baseline=False)
    assert not plan.verified and "tip on the path" in {check.name for check in plan.checks if not check.ok}


@pytest.mark.slow
def test_a_refusal_of_its_own_is_a_refusal() -> None:
    def none(cell: Any, tasks: Any, settings: Any, obstacles: Any) -> Any:
        raise Refusal("nothing I like", bead=1)

    register_strategy("picky", none)
    with pytest.raises(Refusal, match="bead 1: nothing I like"):
        solve(small_problem(), strategy="picky", baseline=False)


def test_names_near_it_are_told() -> None:
    register_strategy("my_table", table_turned)
    with pytest.raises(InputError, match="did you mean my_table"):
        solve(small_problem(), strategy="my_tabel")
    register_strategy("my_table", lambda cell, tasks, settings, obstacles: ())  # one's own may be replaced
    with pytest.raises(InputError, match="strategy my_table: returned 0 paths for 3 tasks"):
        solve(small_problem(), strategy="my_table", baseline=False)


@pytest.mark.parametrize(
    ("name", "strategy", "message"),
    [
        ("ladder", table_turned, "name: ladder is one of the planner's own strategies (for example my_ladder)"),
        ("my strategy", table_turned, "name: 'my strategy' is not a valid strategy name"),
        (3, table_turned, "name: 3 is not a valid strategy name"),
        ("mine", "table_turned", "strategy: cannot be called: it is of type str"),
    ],
)
def test_what_cannot_be_registered_is_said(name: Any, strategy: Any, message: str) -> None:
    with pytest.raises(InputError) as error:
        register_strategy(name, strategy)
    assert message in str(error.value)


Spoil = Callable[[Sequence[JointPath]], Any]


@pytest.mark.slow(keep=3)
@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda paths: None, "returned NoneType (a JointPath for each task, in a tuple)"),
        (lambda paths: paths[:2], "returned 2 paths for 3 tasks"),
        (lambda paths: [path.q for path in paths], "path 0 is of type ndarray"),
        (lambda paths: paths[::-1], "path 0 does not belong to task 0"),
        (lambda paths: [replace(path, q=path.q[:, :3]) for path in paths], "path 0: q has shape"),
        (lambda paths: [*paths[:2], replace(paths[2], roll=paths[2].roll[1:])], "path 2: roll has shape"),
        (lambda paths: [replace(path, tilt=0.0) for path in paths], "path 0: tilt has shape ()"),
        (lambda paths: [replace(path, q=path.q * np.nan) for path in paths], "path 0: q[0] is not finite"),
        (lambda paths: [replace(path, branch=9) for path in paths], "path 0: there is no branch 9 (0 to 7)"),
    ],
)
def test_what_it_answers_wrongly_is_said(spoil: Spoil, message: str) -> None:
    register_strategy("mine", lambda *given: spoil(table_turned(*given)))
    with pytest.raises(InputError) as error:
        solve(small_problem(), strategy="mine", baseline=False)
    assert str(error.value).startswith("strategy mine: ") and message in str(error.value)


@pytest.mark.parametrize("kind", [np.float32, np.int64, complex])
def test_arrays_of_other_numbers_are_those_that_kernels_take_or_told(kind: type) -> None:
    cell, tasks = given()

    def still(cell: Cell, tasks: Sequence[NozzleTask], settings: Any, obstacles: Any) -> list[JointPath]:
        paths = []
        for task in tasks:
            n, joints = len(task), len(cell.joint_names)
            q = np.zeros((n, joints), kind, order="F")
            paths.append(JointPath(task, np.zeros(n, kind), np.zeros((n, 2), kind), q, np.int64(0)))  # type: ignore[arg-type]
        return paths

    register_strategy("still", still)
    if kind is complex:
        with pytest.raises(InputError, match="path 0: q is an array of complex128"):
            STRATEGIES["still"](cell, tasks, small_problem().resolve, NOTHING)
        return
    for path in STRATEGIES["still"](cell, tasks, small_problem().resolve, NOTHING):
        for values in (path.q, path.roll, path.tilt):
            assert values.dtype == float and values.flags.c_contiguous
        assert type(path.branch) is int


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"rolls": [0.0]}, "rolls: has 1, but there are 3 tasks"),
        ({"rolls": [0.0, [1.0, 2.0], 0.0]}, "rolls[1]: has shape (2,)"),
        ({"rolls": [0.0, np.nan, 0.0]}, "rolls[1]: has a number that is not finite"),
        ({"rolls": ["a", 0.0, 0.0]}, "rolls[0]: must be numbers"),
        ({"rolls": [0.0] * 3, "tilts": [0.0] * 3}, "tilts[0]: has shape ()"),
        ({"rolls": [0.0] * 3, "chosen": [[0.0, 1.0]] * 3}, "chosen[0]: has shape (2,)"),
        ({"rolls": [0.0] * 3, "branches": [0]}, "branches: has 1, but there are 3 tasks"),
    ],
)
def test_wrong_shapes_are_said(wrong: dict[str, Any], message: str) -> None:
    cell, tasks = given()
    with pytest.raises(InputError) as error:
        joint_paths(cell, tasks, **wrong)
    assert message in str(error.value)


def test_one_number_serves_all_samples() -> None:
    problem = load("peer_cap")
    cell = build_cell(problem)
    tasks = tasks_of(problem, build_toolpath(problem))
    (one,) = joint_paths(cell, tasks, [0.5])
    (each,) = joint_paths(cell, tasks, [np.full(len(tasks[0]), 0.5)], tilts=[np.zeros((len(tasks[0]), 2))])
    assert (one.q == each.q).all() and one.branch == each.branch
    (once,) = joint_paths(cell, tasks, iter([0.5]), branches=iter([one.branch]))  # type: ignore[arg-type]
    assert (once.q == one.q).all()
    assert joint_paths(cell, (), []) == ()
