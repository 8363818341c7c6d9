"""Carries out what the view's state machine wants: reads and watches files, starts solves, serves the page."""

from __future__ import annotations

import asyncio
import json
import shutil
import signal
import tempfile
import time
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

from planner.errors import PlannerError
from planner.view.content import mistake_of, read_content, signatures
from planner.view.events import Cancel, Effect, Event, Read, ReadFiles, Remove, Shown, Start, Tick, Touched
from planner.view.folder import WATCHED, read_results
from planner.view.machine import step
from planner.view.server import News, Server, listen
from planner.view.snapshot import snapshot
from planner.view.solver import Solver
from planner.view.state import View

LOOK_TIME = 0.1  # s between looks at the files
SIGNALS = tuple(getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name))


@dataclass(frozen=True)
class Subject:
    """What is looked at: a problem file with its overrides, or a folder of results (`folder`), and its name."""

    path: Path
    name: str
    folder: bool = False
    overrides: tuple[str, ...] = ()


async def run_view(
    subject: Subject, view: View, port: int, ready: Callable[[str], None], over: asyncio.Event | None = None
) -> int:
    """Serve the view until a signal comes, whose number is returned, or `over` is set (0).

    ready  is told the address as soon as somebody can look at it. Raises InputError where the port is taken.
    """
    over = over or asyncio.Event()
    came = deque((0,), maxlen=1)
    loop = asyncio.get_running_loop()

    def ended(number: int) -> None:
        came.append(number)
        over.set()

    where = listen(port)
    with tempfile.TemporaryDirectory(prefix="beadwise-view-", ignore_cleanup_errors=True) as folder:
        for number in SIGNALS:
            loop.add_signal_handler(number, ended, number)
        runner = _Runner(subject, view, Path(folder))
        server = Server(where, runner.news, runner.report, runner.take)
        watching = asyncio.create_task(runner.watch())
        try:
            ready(server.url)
            await asyncio.wait({watching, asyncio.create_task(over.wait())}, return_when=asyncio.FIRST_COMPLETED)
            if watching.done():
                watching.result()  # raises what ended it
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
        """Something happened."""
        before = self._view
        self._view, effects = step(before, event)
        for effect in effects:
            self._carry_out(effect)
        if self._view != before:
            self._tell()

    async def watch(self) -> None:
        """Look at the files, for ever; they have not been read when this begins."""
        self.take(Touched(time.monotonic()))
        seen = await asyncio.to_thread(signatures, self._watched())
        while True:
            await asyncio.sleep(LOOK_TIME)
            if self._reading is not None and self._reading.done():
                self._reading.result()  # raises what went wrong in it
            self._solver.check()
            now = await asyncio.to_thread(signatures, self._watched())
            if any(path in seen and seen[path] != how for path, how in now.items()):
                self.take(Touched(time.monotonic()))
            seen = now
            self.take(Tick(time.monotonic()))

    async def close(self) -> None:
        """End what runs."""
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
    """What is looked at, with the name that the page shows."""
    return Subject(path, path.resolve().name if folder else path.stem, folder, tuple(overrides))
