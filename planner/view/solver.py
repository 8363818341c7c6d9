"""Processes that solve: one working at a time, and one waiting; their messages become events."""

from __future__ import annotations

import asyncio
import json
import os
import signal
import sys
from asyncio.subprocess import PIPE, Process
from collections.abc import Callable, Sequence
from contextlib import suppress
from datetime import datetime
from pathlib import Path
from typing import Any

from planner.view.content import Mistake
from planner.view.machine import Broke, Event, ReportReady, SolveJob, SolveOutcome, Staged

SPARE_TIME = 10.0  # s after a solve before a spare process is started: until then the browser is drawing
LONGEST_LINE = 1_000_000  # bytes of a message
LAST_WORDS = 4_000  # characters kept of a process's stderr
CHILD = (sys.executable, "-m", "planner.view.child")
CANCEL = b'{"cancel": true}\n'
ENDED_EARLY = "the solver ended unexpectedly"


class Solver:
    """Has jobs done by processes, one at a time. Use it in one event loop; `close` leaves no process behind.

    The process of the last job does the next one, with its kernels loaded. It is ended only when a job that it does
    itself is cancelled; a spare one, which has imported all it needs, takes its place.
    """

    def __init__(self, problem: Path, overrides: Sequence[str], folder: Path, take: Callable[[Event], None]) -> None:
        self._problem, self._overrides, self._folder, self._take = problem, list(overrides), folder, take
        self._spare: asyncio.Task[Process] | None = None
        self._later: asyncio.TimerHandle | None = None
        self._process: Process | None = None  # does the job, or did the last one
        self._words: asyncio.Task[str] | None = None  # its stderr
        self._apart = False  # whether a copy of it does the job
        self._listening: asyncio.Task[None] | None = None
        self._ending: list[asyncio.Task[None]] = []

    def warm_up(self) -> None:
        """Get a process ready for the next job."""
        self._not_later()
        if self._spare is None:
            self._spare = asyncio.create_task(_new_process())

    def start(self, job: SolveJob) -> None:
        """Start a job; none may be running."""
        self._not_later()
        self._apart = False
        self._listening = asyncio.create_task(self._run(job))

    def cancel(self) -> None:
        """End the running job, if any, with all its processes; its pending messages are dropped."""
        if self._process is not None and self._process.stdin is not None and self._apart:
            self._listen_no_more()
            with suppress(BrokenPipeError, ConnectionResetError):  # it may have ended by itself
                self._process.stdin.write(CANCEL)
            return
        self._stop()
        self.warm_up()

    def _listen_no_more(self) -> None:
        if self._listening is not None:
            self._listening.cancel()
        self._listening = None

    def _stop(self) -> None:
        self._not_later()
        self._listen_no_more()
        if self._process is not None:
            self._ending.append(asyncio.create_task(_end(self._process)))
        self._process = None
        self._ending = [task for task in self._ending if not task.done()]

    def _not_later(self) -> None:
        if self._later is not None:
            self._later.cancel()
        self._later = None

    def check(self) -> None:
        """Raise an error that occurred while listening to a process: a defect, not a user's mistake."""
        if self._listening is not None and self._listening.done() and not self._listening.cancelled():
            self._listening.result()

    async def close(self) -> None:
        """End everything, and wait until it has ended."""
        self._stop()
        if self._spare is not None:
            with suppress(OSError):  # it may have failed to start
                await _end(await self._spare)
            self._spare = None
        await asyncio.gather(*self._ending)

    async def _run(self, job: SolveJob) -> None:
        if self._process is not None and await self._done(job, self._process):
            return
        process = await self._fresh(job)
        if process is not None and not await self._done(job, process):
            await self._lost(job, process)

    async def _fresh(self, job: SolveJob) -> Process | None:
        """The spare process, once it is ready; None if none can be started, which is reported."""
        self.warm_up()
        if self._spare is None:
            return None
        try:
            process = await asyncio.shield(self._spare)
        except OSError as error:
            self._spare = None
            self._take(Broke(job.number, Mistake(f"no solver can be started: {error.strerror}")))
            return None
        if process.stderr is None:
            raise RuntimeError("a solver has no pipes")
        self._spare, self._process = None, process
        self._words = asyncio.create_task(_tail(process.stderr))
        return process

    async def _done(self, job: SolveJob, process: Process) -> bool:
        """Have a process do a job, and pass on its messages; False if it had ended before receiving the job."""
        order = {
            "number": job.number,
            "problem": str(self._problem),
            "overrides": self._overrides,
            "strategy": job.strategy,
            "drafts": job.drafts,
            "folder": str(self._folder / str(job.number)),
        }
        if process.stdin is None or process.stdout is None:
            raise RuntimeError("a solver has no pipes")
        with suppress(BrokenPipeError, ConnectionResetError):  # if it has ended, its stderr says why
            process.stdin.write(json.dumps(order).encode() + b"\n")
            await process.stdin.drain()
        heard = False
        while line := await process.stdout.readline():
            message = json.loads(line)
            if message["job"] != job.number:
                continue  # from a cancelled job
            heard = True
            if "apart" in message:
                self._apart = True
                continue
            event = event_of(job, message, f"{datetime.now():%H:%M:%S}")
            last = isinstance(event, Broke) or (isinstance(event, ReportReady) and not event.outcome.draft)
            if last:
                self._later = asyncio.get_running_loop().call_later(SPARE_TIME, self.warm_up)
            self._take(event)  # which may start the next job
            if last:
                return True
        if heard:
            await self._lost(job, process)
        return heard

    async def _lost(self, job: SolveJob, process: Process) -> None:
        """Report that a process ended before its job was done."""
        code, words = await process.wait(), "" if self._words is None else await self._words
        self._process = None
        hint = words.strip().splitlines()[-1] if words.strip() else f"exit code {code}"
        sys.stderr.write(words)
        self._take(Broke(job.number, Mistake(ENDED_EARLY, hint=hint)))


def event_of(job: SolveJob, message: dict[str, Any], at: str) -> Event:
    """The event for a message from the solver's process."""
    if "mistake" in message:
        return Broke(job.number, Mistake(**message["mistake"]))
    if "stage" in message:
        return Staged(job.number, message["stage"], message["draft"])
    figures = tuple((name, float(value)) for name, value in message["figures"])
    return ReportReady(job.number, SolveOutcome(message["kind"], message["words"], figures, message["draft"]), at)


async def _new_process() -> Process:
    # in its own session: Ctrl-C in the terminal reaches only the view, which then ends all of that session
    return await asyncio.create_subprocess_exec(
        *CHILD,
        stdin=PIPE, stdout=PIPE, stderr=PIPE, start_new_session=True, limit=LONGEST_LINE,
    )  # fmt: skip


async def _tail(stream: asyncio.StreamReader) -> str:
    kept = ""
    while piece := await stream.read(4096):
        kept = (kept + piece.decode("utf-8", "replace"))[-LAST_WORDS:]
    return kept


async def _end(process: Process) -> None:
    if process.returncode is None:
        with suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
    await process.wait()
