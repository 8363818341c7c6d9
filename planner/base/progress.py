"""Stages of a run: how long each takes, and their progress on stderr."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager

from rich.console import Console
from rich.progress import BarColumn, Progress, SpinnerColumn, TaskID, TextColumn, TimeElapsedColumn

# of planning with a strategy, in the order they begin
STAGES = ("load", "toolpath", "obstacles", "resolve", "timing", "travel", "verify", "map", "compare", "dips")


class Stages:
    """Times named stages; with a console, draws a bar for each. `seconds` holds the times measured so far.

    The times of a stage entered twice add up. `entered` is called with the name of each stage as it begins. With a
    console, terminal or not, a note is printed when kernels have to be compiled, which happens once after an
    installation and takes minutes.
    """

    def __init__(self, console: Console | None = None, entered: Callable[[str], None] | None = None) -> None:
        self.seconds: dict[str, float] = {}
        self._entered = entered
        self._console, self._open = console, ExitStack()
        # anything but a terminal would get an empty line
        self._progress = None if console is None or not console.is_terminal else Progress(
            SpinnerColumn(), TextColumn("{task.description:<10}"), BarColumn(), TimeElapsedColumn(),
            console=console, transient=True,
        )  # fmt: skip

    def __enter__(self) -> Stages:
        if self._progress is not None:
            self._progress.start()
            self._open.callback(self._progress.stop)
        if self._console is not None:
            from planner.base.compiled import while_compiling  # imports numba, needed with a console only

            self._open.enter_context(while_compiling(self._compiling))
        return self

    def __exit__(self, *_: object) -> None:
        self._open.close()

    def _compiling(self, kernels: int, seconds: float) -> Callable[[int], None]:
        """Announce that kernels are compiled and for how long; returns what to call with the number done after each."""
        if self._console is not None:
            self._console.print(f"compiling kernels, about {_minutes(seconds)}, once", markup=False)
        progress = self._progress
        if progress is None:
            return lambda _: None
        bar = progress.add_task("compiling", total=kernels)
        return lambda there: progress.update(bar, completed=there)

    def tell(self, words: str) -> None:
        """Print a message for the user, if there is a console."""
        if self._console is not None:
            self._console.print(words, markup=False)

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Measure the block as stage `name`."""
        with self._measured(name, None):
            yield

    @contextmanager
    def counted(self, name: str, steps: int) -> Iterator[Callable[[], None]]:
        """Measure the block as stage `name`; its bar advances by a step at each call of what is yielded."""
        with self._measured(name, steps) as bar:
            progress = self._progress
            yield (lambda: None) if progress is None or bar is None else (lambda: progress.advance(bar))

    @contextmanager
    def _measured(self, name: str, steps: int | None) -> Iterator[TaskID | None]:
        if self._entered is not None:
            self._entered(name)
        bar = None if self._progress is None else self._progress.add_task(name, total=steps)
        start = time.perf_counter()
        try:
            yield bar
        finally:
            self.seconds[name] = self.seconds.get(name, 0.0) + time.perf_counter() - start
            if self._progress is not None and bar is not None:
                self._progress.update(bar, total=steps or 1, completed=steps or 1)


def _minutes(seconds: float) -> str:
    """A time in words, no more precise than the estimate."""
    if seconds < 45.0:
        return "half a minute"
    minutes = max(1, round(seconds / 60.0))
    return "a minute" if minutes == 1 else f"{minutes} minutes"
