"""Where the time of a plan goes: processor time by stage, and the functions that take most of it.

python -m benchmarks.profile cylinder_logo

Everything runs in one thread of one process, so a profiler sees all of it; a compiled kernel counts as the function that
it is compiled from. The profiler adds some cost to every call from Python, but none within kernels.
"""

from __future__ import annotations

import cProfile
import pstats
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent import futures
from concurrent.futures import Future
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from benchmarks.command import parser_of, told

ROOT = Path(__file__).resolve().parents[1]
MOST = 25  # functions that are shown


class InLine:
    """Stands in for a pool of threads: everything is done at once by who asks for it."""

    def __init__(self, *_: object, **__: object) -> None:
        """Takes what a pool takes."""

    def __enter__(self) -> InLine:
        return self

    def __exit__(self, *_: object) -> None:
        """Nothing waits."""

    def shutdown(self, *_: object, **__: object) -> None:
        """Nothing is left to do."""

    def map(self, function: Callable[..., Any], *items: Iterable[Any]) -> list[Any]:
        """Results for all items, in their order."""
        return [function(*each) for each in zip(*items, strict=False)]

    def submit(self, function: Callable[..., Any], *arguments: Any) -> Future[Any]:
        """A result that is there already."""
        done: Future[Any] = Future()
        done.set_result(function(*arguments))
        return done


def stage_clock(seconds: dict[str, float]) -> Any:
    """Stages that note processor time [s] in `seconds`."""
    from planner.base.progress import Stages

    class Clocked(Stages):
        @contextmanager
        def stage(self, name: str) -> Iterator[None]:
            """Measure the block as stage `name`."""
            start = time.process_time()
            with super().stage(name):
                yield
            seconds[name] = seconds.get(name, 0.0) + time.process_time() - start

    return Clocked()


def place_of(file: str, line: int, name: str) -> str:
    """A function's place, from the project's folder on, or from the package's it comes from."""
    path = Path(file)
    if path.is_relative_to(ROOT):
        return f"{path.relative_to(ROOT)}:{line} {name}"
    parts = path.parts
    if "site-packages" in parts:
        return f"{'/'.join(parts[parts.index('site-packages') + 1 :])}:{line} {name}"
    return f"{path.name}:{line} {name}" if line else name


def dearest(profile: cProfile.Profile, most: int = MOST) -> list[tuple[str, int, float, float]]:
    """Functions that take most time themselves: place, calls, seconds without and with what they call."""
    stats: Any = pstats.Stats(profile)
    rows = [(place_of(*function), calls, own, whole) for function, (_, calls, own, whole, _) in stats.stats.items()]
    return sorted(rows, key=lambda row: -row[2])[:most]


@told
def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit code."""
    parser = parser_of("profile", __doc__)
    parser.add_argument("problem", help="a problem file, a shipped one's name, or peer_cap@10000")
    parser.add_argument("--strategy", default="sqp")
    parser.add_argument("--most", type=int, default=MOST, help="functions to show")
    options = parser.parse_args(arguments)
    futures.ThreadPoolExecutor = InLine  # type: ignore[assignment,misc]  # before any module takes its name
    return _profile(options.problem, options.strategy, options.most)


def _profile(name: str, strategy: str, most: int) -> int:
    import tempfile

    from benchmarks.named import load_named
    from benchmarks.single import warm_up
    from planner.base.errors import EXIT_VERIFIED
    from planner.planning.pipeline import solve

    seconds: dict[str, float] = {}
    profile = cProfile.Profile(time.process_time)
    with tempfile.TemporaryDirectory() as folder:
        problem = load_named(name, (), Path(folder))
        warm_up(problem, strategy)
        profile.enable()
        plan = solve(problem, strategy, stages=stage_clock(seconds), baseline=False)
        profile.disable()
    whole = sum(seconds.values())
    stages = Table("stage", "CPU s", "share", title=f"{name}, {int(plan.metrics['waypoints'])} waypoints, {strategy}")
    for stage, value in seconds.items():
        stages.add_row(stage, f"{value:.2f}", f"{100 * value / whole:.1f} %")
    stages.add_row("all", f"{whole:.2f}", "")
    functions = Table("function", "calls", "own s", "share", "with calls s", title="dearest functions")
    for place, calls, own, total in dearest(profile, most):
        functions.add_row(place, f"{calls}", f"{own:.3f}", f"{100 * own / whole:.1f} %", f"{total:.3f}")
    console = Console(width=150)
    console.print(stages)
    console.print(functions)
    return EXIT_VERIFIED


if __name__ == "__main__":
    sys.exit(main())
