"""The command line of the live view, and the runner that carries out the effects of its state machine."""

from __future__ import annotations

import argparse
import asyncio
import json
import os
import shutil
import signal
import sys
import tempfile
import time
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from datetime import datetime
from functools import partial
from pathlib import Path
from typing import Any

from planner.base.command_line import exit_code
from planner.base.errors import EXIT_VERIFIED, InputError, PlannerError
from planner.base.web.options import tell_address
from planner.base.web.server import News, Server, listen
from planner.problem import find_problem, load_problem, shipped_problems
from planner.report.wording import counted
from planner.view.content import Content, flattened, mistake_of, read_content, signatures
from planner.view.machine import (
    Cancel,
    Effect,
    Event,
    Read,
    ReadFiles,
    Remove,
    Shown,
    SolveOutcome,
    Start,
    Tick,
    Touched,
    View,
    figures_of,
    step,
)
from planner.view.options import view_command
from planner.view.server import snapshot, view_site
from planner.view.solver import Solver

# ----------------------------------------------------------------------------------------------------
# A folder of results written elsewhere: the content of its plan.json.

LARGEST_PLAN = 50_000_000  # bytes of plan.json; the logo's ten layers have 1 MB
WATCHED = ("plan.json", "report.html")


def read_results(folder: Path) -> tuple[str, str, SolveOutcome, Content]:
    """Problem, strategy, outcome and settings of a folder of results. Raises InputError if it is not one."""
    if not folder.is_dir():
        raise InputError("is gone", file=folder, hint="the view resumes as soon as it is back")
    for name in reversed(WATCHED):
        if not (folder / name).is_file():
            raise InputError(f"has no {name}", file=folder, hint="the view resumes as soon as there are results")
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
        raise InputError("is not a plan", file=path, hint="it is written by planner.solve")
    problem, strategy = (_text(plan, name, path) for name in ("problem", "strategy"))
    settings = Content(tuple(flattened({"strategy": strategy, **_section(plan, "settings")})))
    return problem, strategy, _outcome(plan), settings


def _outcome(plan: dict[str, Any]) -> SolveOutcome:
    numbers = {k: float(v) for k, v in _section(plan, "metrics").items() if isinstance(v, int | float)}
    if not numbers:
        return SolveOutcome("refused", "no plan: the report says why")
    checks = plan.get("checks")
    checks = checks if isinstance(checks, list) else []
    failed = [str(check.get("name")) for check in checks if isinstance(check, dict) and check.get("ok") is not True]
    size = counted(numbers.get("beads", 0), "bead") + ", " + counted(numbers.get("layers", 0), "layer")
    if plan.get("verified") is True:
        return SolveOutcome("verified", f"verified: {len(checks)} checks hold; {size}", figures_of(numbers))
    return SolveOutcome("failed", f"not verified: {', '.join(failed) or 'see the report'}; {size}", figures_of(numbers))


def _section(plan: dict[str, Any], name: str) -> dict[str, Any]:
    value = plan.get(name)
    return value if isinstance(value, dict) else {}


def _text(plan: dict[str, Any], name: str, path: Path) -> str:
    value = plan.get(name)
    if not isinstance(value, str):
        raise InputError("is missing, or not text", file=path, field=name, hint="it is written by planner.solve")
    return value[:80]


# ----------------------------------------------------------------------------------------------------
# Carries out the effects of the view's state machine: reads and watches files, starts solves, serves the page.

LOOK_TIME = 0.1  # s between looks at the files
SIGNALS = tuple(getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name))


@dataclass(frozen=True)
class Subject:
    """What is viewed: a problem file with its overrides, or a folder of results (`folder`), and its name."""

    path: Path
    name: str
    folder: bool = False
    overrides: tuple[str, ...] = ()


async def run_view(
    subject: Subject, view: View, port: int, ready: Callable[[Server], None], over: asyncio.Event | None = None
) -> int:
    """Serve the view until a signal arrives (returns its number), or `over` is set (returns 0).

    ready  is called as soon as the page can be opened. Raises InputError if the port is taken.
    """
    over = over or asyncio.Event()
    came = deque((0,), maxlen=1)
    loop = asyncio.get_running_loop()

    def ended(number: int) -> None:
        came.append(number)
        over.set()

    where = listen(port, "--port")
    with tempfile.TemporaryDirectory(prefix="beadwise-view-", ignore_cleanup_errors=True) as folder:
        for number in SIGNALS:
            loop.add_signal_handler(number, ended, number)
        runner = _Runner(subject, view, Path(folder))
        server = Server(where, view_site(runner.news, runner.report, runner.take))
        watching = asyncio.create_task(runner.watch())
        try:
            ready(server)
            await asyncio.wait({watching, asyncio.create_task(over.wait())}, return_when=asyncio.FIRST_COMPLETED)
            if watching.done():
                watching.result()  # raises the error that ended it
        finally:
            watching.cancel()
            await runner.close()
            await server.close()
            for number in SIGNALS:
                loop.remove_signal_handler(number)
    return came[0]


class _Runner:
    def __init__(self, subject: Subject, view: View, folder: Path) -> None:
        self.news = News()
        self._subject, self._view, self._folder = subject, view, folder
        self._solver = Solver(subject.path, subject.overrides, folder, self.take)
        self._named: tuple[Path, ...] = ()
        self._reading: asyncio.Task[None] | None = None
        self._tell()
        if view.solving:
            self._solver.warm_up()

    def report(self, key: str) -> Path | None:
        """The file of a report that is shown."""
        if key not in {result.key for result in self._view.results.values()}:
            return None
        if self._subject.folder:
            return self._subject.path / "report.html"
        return self._place(key) / "report.html"

    def take(self, event: Event) -> None:
        """Take an event: update the view and carry out its effects."""
        before = self._view
        self._view, effects = step(before, event)
        for effect in effects:
            self._carry_out(effect)
        if self._view != before:
            self._tell()

    async def watch(self) -> None:
        """Watch the files forever; they have not been read when this begins."""
        self.take(Touched(time.monotonic()))
        seen = await asyncio.to_thread(signatures, self._watched())
        while True:
            await asyncio.sleep(LOOK_TIME)
            if self._reading is not None and self._reading.done():
                self._reading.result()  # raises its error, if any
            self._solver.check()
            now = await asyncio.to_thread(signatures, self._watched())
            if any(path in seen and seen[path] != how for path, how in now.items()):
                self.take(Touched(time.monotonic()))
            seen = now
            self.take(Tick(time.monotonic()))

    async def close(self) -> None:
        """End everything that runs."""
        if self._reading is not None:
            self._reading.cancel()
            with suppress(asyncio.CancelledError):
                await self._reading
        await self._solver.close()

    def _watched(self) -> Iterable[Path]:
        if self._subject.folder:
            return [self._subject.path / name for name in WATCHED]
        return [self._subject.path, *self._named]

    def _carry_out(self, effect: Effect) -> None:
        match effect:
            case ReadFiles():
                self._reading = asyncio.create_task(self._read())
            case Start(job):
                self._solver.start(job)
            case Cancel():
                self._solver.cancel()
            case Remove(key):
                shutil.rmtree(self._place(key), ignore_errors=True)

    async def _read(self) -> None:
        subject, at = self._subject, f"{datetime.now():%H:%M:%S}"
        try:
            if subject.folder:
                _, strategy, outcome, settings = await asyncio.to_thread(read_results, subject.path)
                self.take(Shown(strategy, outcome, settings, at))
            else:
                content, self._named = await asyncio.to_thread(read_content, subject.path, subject.overrides)
                self.take(Read(content, at))
        except PlannerError as error:
            self.take(Read(mistake_of(error), at))

    def _place(self, key: str) -> Path:
        number, _, part = key.partition("-")
        return self._folder / number / part

    def _tell(self) -> None:
        state = snapshot(self._view, self._subject.name, str(self._subject.path))
        self.news.tell(json.dumps(state, separators=(",", ":")))


def subject_of(path: Path, folder: bool, overrides: Sequence[str]) -> Subject:
    """The subject of the view, with the name that the page shows."""
    return Subject(path, path.resolve().name if folder else path.stem, folder, tuple(overrides))


# ----------------------------------------------------------------------------------------------------
# The command line of the live view.

USUAL_STRATEGY = "sqp"  # as long as the file that would name one cannot be read


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit code."""
    options = view_command().parse_args(arguments)
    say = partial(print, file=sys.stderr)
    return exit_code(partial(_run, options), say, interrupted="the view has ended; no results were written")


def _run(options: argparse.Namespace) -> int:
    subject = _subject(options.subject, options.set)
    view = View(panes=_panes(subject, options), solving=not subject.folder, drafts=options.drafts)
    came = asyncio.run(run_view(subject, view, options.port, partial(_ready, subject, options.browser)))
    if came == signal.SIGINT:
        raise KeyboardInterrupt
    return EXIT_VERIFIED


def _subject(given: str, overrides: Sequence[str]) -> Subject:
    """A folder of results if a folder is given, else a problem. Raises InputError if it is neither."""
    path = Path(given)
    named = os.sep not in given and path.name in shipped_problems()
    if not path.is_dir() or named:
        return subject_of(find_problem(given), False, overrides)
    if not any((path / name).is_file() for name in ("report.html", "plan.json")):
        raise InputError(
            "is a folder without results", file=path, hint="give a problem file, or the folder that planner.solve wrote"
        )
    if overrides:
        raise InputError("a folder of results is shown as it is", field="--set", hint="give the problem file")
    return subject_of(path, True, ())


def _panes(subject: Subject, options: argparse.Namespace) -> tuple[str, ...]:
    """The strategies to begin with. Raises InputError for mistakes in an override."""
    first = options.strategy
    if subject.folder:
        return (first or USUAL_STRATEGY,)
    try:
        own: str = load_problem(subject.path, subject.overrides).strategy
    except InputError as error:
        if error.field is not None and error.field.startswith("--set"):
            raise
        own = USUAL_STRATEGY  # the page shows the mistake, and the view continues once it is fixed
    panes = (first or own, options.beside)
    return tuple(dict.fromkeys(strategy for strategy in panes if strategy is not None))


def _ready(subject: Subject, browser: bool, server: Server) -> None:
    what = "results in" if subject.folder else "problem"
    tell_address(f"live view of {what} {subject.path}", server.address, server.address_once() if browser else None)
    print("Ctrl-C ends it", file=sys.stderr)
