"""Many problems, one after another or in several processes: the refusal of one of them is its result."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from planner.base.arguments import as_list, as_number, check_callable, kind_of
from planner.base.distribution import MOST_JOBS, spread
from planner.base.errors import Hints, InputError, PlannerError, Refusal
from planner.plan import Plan
from planner.planning.options import DEFAULT_DT
from planner.planning.pipeline import solve
from planner.problem import Problem
from planner.problem.settings import STRATEGY_NAMES
from planner.resolve.own_terms import OwnTerm

Asked = Problem | str | Path


@dataclass(frozen=True)
class Solved:
    """The result for one problem of many.

    Attributes:
        problem: The problem as it was given.
        plan: Its plan, verified or not; None if there is none.
        error: Why there is no plan, as InputError, Refusal, or what ended its process; the hints of a Refusal are found
            on demand, by planning the problem once more.
        seconds: Time that it took [s].
    """

    problem: Asked
    plan: Plan | None
    error: PlannerError | None
    seconds: float

    @property
    def verified(self) -> bool:
        """Whether there is a plan, and every check of it holds."""
        return self.plan is not None and self.plan.verified

    @property
    def name(self) -> str:
        """The problem's name, or what was given if it could not be read."""
        if self.plan is not None:
            return self.plan.name
        return self.problem.name if isinstance(self.problem, Problem) else str(self.problem)

    def __repr__(self) -> str:
        return f"<Solved {self.name}: no plan: {self.error}>" if self.plan is None else f"<Solved {self.plan!r}>"


@dataclass(frozen=True)
class _Item:
    """What another process needs: a problem, options, and the file for its plan, None in this process."""

    problem: Asked
    strategy: str | None
    dt: float
    tolerance: str | None
    baseline: bool
    terms: tuple[OwnTerm, ...]
    file: Path | None


@dataclass(frozen=True)
class _Done:
    plan: Plan | Path | None
    error: PlannerError | None
    seconds: float


def solve_all(
    problems: Sequence[Asked],
    strategy: str | None = None,
    *,
    dt: float = DEFAULT_DT,
    tolerance: str | None = None,
    baseline: bool = True,
    terms: Sequence[OwnTerm] = (),
    jobs: int = 1,
    progress: bool = True,
    done: Callable[[Solved], object] | None = None,
) -> tuple[Solved, ...]:
    """Solve many problems, each as by `solve`; a problem without a plan does not end the others.

    Args:
        problems: Problems, each as `solve` takes it.
        strategy: As in `solve`, for all problems; a strategy of your own needs `jobs=1`.
        dt: As in `solve`, for all problems [s].
        tolerance: As in `solve`, for all problems.
        baseline: As in `solve`, for all problems.
        terms: As in `solve`, for all problems; they need `jobs=1`.
        jobs: Number of processes; several are started afresh, so a script may ask for them only when run as the main
            module.
        progress: Whether a bar shows how many are done, if stderr is a terminal or a notebook.
        done: Called with the result of each problem as soon as it is known, in the order in which they finish.

    Returns:
        The results in the order of the problems.

    Raises:
        InputError: If an argument is wrong.
    """
    if isinstance(problems, (str, Path, Problem)):
        raise InputError("must be a list of problems", field="problems", hint="solve takes one of them")
    given = as_list(problems, "problems", "problems")
    terms = as_list(terms, "terms", "terms")
    as_number(dt, "dt")
    if done is not None:
        check_callable(done, "done")
    for i, problem in enumerate(given):
        if not isinstance(problem, (str, Path, Problem)):
            hint = "a file, a shipped name, or what load gives"
            raise InputError(f"is {kind_of(problem)}", field=f"problems[{i}]", hint=hint)
    if type(jobs) is not int or not 1 <= jobs <= MOST_JOBS:
        raise InputError(f"{jobs!r} is not a number of processes", field="jobs", hint=f"1 to {MOST_JOBS}")
    if jobs > 1 and terms:
        raise InputError("cannot be evaluated in other processes", field="terms", hint="jobs=1")
    if jobs > 1 and strategy is not None and strategy not in STRATEGY_NAMES:
        raise InputError(f"other processes do not know {strategy!r}", field="strategy", hint="jobs=1")
    found: dict[int, Solved] = {}
    console = Console(stderr=True)
    bar = Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        console=console,
        disable=not progress or not (console.is_terminal or console.is_jupyter),
    )
    with tempfile.TemporaryDirectory(prefix="beadwise-") as folder, bar:
        shown = bar.add_task("solved", total=len(given))
        files = [Path(folder) / f"{i}.npz" if jobs > 1 else None for i in range(len(given))]
        items = [
            _Item(problem, strategy, dt, tolerance, baseline, terms, file)
            for problem, file in zip(given, files, strict=True)
        ]
        for i, outcome in spread(_solved, items, jobs):
            if isinstance(outcome, PlannerError):  # its process died
                outcome = _Done(None, outcome, 0.0)
            if isinstance(outcome.error, Refusal):
                outcome.error.advised_by(partial(_hints_of, items[i]))
            found[i] = Solved(given[i], _taken(outcome.plan), outcome.error, outcome.seconds)
            bar.update(shown, advance=1, description=found[i].name)
            if done is not None:
                done(found[i])
    return tuple(found[i] for i in range(len(given)))


def _solved(item: _Item) -> _Done:
    """A problem's plan, saved if a file is given for it, or why there is none."""
    begun, plan, error = time.perf_counter(), None, None
    try:
        plan = _plan_of(item, item.baseline)
    except PlannerError as refused:
        error = _alone(refused)
    saved = plan if plan is None or item.file is None else plan.save(item.file)
    return _Done(saved, error, time.perf_counter() - begun)


def _plan_of(item: _Item, baseline: bool) -> Plan:
    return solve(item.problem, item.strategy, item.dt, tolerance=item.tolerance, baseline=baseline, terms=item.terms)


def _alone(error: PlannerError) -> PlannerError:
    """An error stripped of what it holds on to.

    The frames that it came through hold everything that was searched, some 100 MB with many problems; and its hints
    would be tried before it is sent to another process.
    """
    error.__cause__ = error.__context__ = None
    if isinstance(error, Refusal):
        error.advised_by(())
    return error.with_traceback(None)


def _hints_of(item: _Item) -> Hints:
    """A refusal's hints, found by planning the problem once more; none if that ends differently now."""
    try:
        _plan_of(item, baseline=False)
    except Refusal as refused:
        return refused.hints
    except PlannerError:
        pass
    return ()


def _taken(plan: Plan | Path | None) -> Plan | None:
    """The plan; if another process has saved it, it is loaded and its file deleted: hundreds would fill a disk."""
    if not isinstance(plan, Path):
        return plan
    found = Plan.load(plan)
    plan.unlink()
    return found
