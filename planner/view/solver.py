"""Processes that solve: one at a time, and one that waits; what they say becomes events."""

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

SPARE_TIME = 3.0  # s into a solve after which the next process gets ready, so that it does not hold up a short one
LONGEST_LINE = 1_000_000  # bytes of a message
LAST_WORDS = 4_000  # characters of what a process says on stderr that are kept
CHILD = (sys.executable, "-m", "planner.view.child")
ENDED_EARLY = "the solver ended before its time"


class Solver:
    """Starts and ends processes for jobs. Use it in one event loop; `close` leaves no process behind."""

    def __init__(self, problem: Path, overrides: Sequence[str], folder: Path, take: Callable[[Event], None]) -> None:
        self._problem, self._overrides, self._folder, self._take = problem, list(overrides), folder, take
        self._spare: asyncio.Task[Process] | None = None
        self._listening: asyncio.Task[None] | None = None
        self._process: Process | None = None
        self._later: asyncio.TimerHandle | None = None
        self._ending: list[asyncio.Task[None]] = []

    def warm_up(self) -> None:
        """Have a process ready, for the next job."""
        if self._later is not None:
            self._later.cancel()
            self._later = None
        if self._spare is None:
            self._spare = asyncio.create_task(_new_process())

    def start(self, job: SolveJob) -> None:
        """Begin a job; none may run."""
        self._listening = asyncio.create_task(self._run(job))

    def cancel(self) -> None:
        """End the job that runs, if any, with all its processes; nothing that it said since is told."""
        self._stop()
        self.warm_up()

    def _stop(self) -> None:
        if self._later is not None:
            self._later.cancel()
        if self._listening is not None:
            self._listening.cancel()
        if self._process is not None:
            self._ending.append(asyncio.create_task(_end(self._process)))
        self._listening = self._process = self._later = None
        self._ending = [task for task in self._ending if not task.done()]

    def check(self) -> None:
        """Raise what went wrong while a process was listened to: a defect, not a user's mistake."""
        if self._listening is not None and self._listening.done() and not self._listening.cancelled():
            self._listening.result()

    async def close(self) -> None:
        """End everything, and wait for the end."""
        self._stop()
        if self._spare is not None:
            with suppress(OSError):  # it could not be started
                await _end(await self._spare)
            self._spare = None
        await asyncio.gather(*self._ending)

    async def _run(self, job: SolveJob) -> None:
        self.warm_up()
        spare = self._spare
        if spare is None:
            return
        try:
            process = await asyncio.shield(spare)
        except OSError as error:
            self._spare = None
            self._take(Broke(job.number, Mistake(f"no solver can be started: {error.strerror}")))
            return
        self._spare, self._process = None, process
        self._later = asyncio.get_running_loop().call_later(SPARE_TIME, self.warm_up)
        order = {
            "problem": str(self._problem),
            "overrides": self._overrides,
            "strategy": job.strategy,
            "drafts": job.drafts,
            "folder": str(self._folder / str(job.number)),
        }
        if process.stdin is None or process.stdout is None or process.stderr is None:
            raise RuntimeError("a solver has no pipes")
        with suppress(BrokenPipeError, ConnectionResetError):  # it has ended: its last words tell why
            process.stdin.write(json.dumps(order).encode() + b"\n")
            await process.stdin.drain()
        last_words = asyncio.create_task(_tail(process.stderr))
        told = False
        while line := await process.stdout.readline():
            event = event_of(job, json.loads(line), f"{datetime.now():%H:%M:%S}")
            told = told or isinstance(event, Broke) or (isinstance(event, ReportReady) and not event.outcome.draft)
            self._take(event)
        code, words = await process.wait(), await last_words
        self.warm_up()
        if not told:
            hint = words.strip().splitlines()[-1] if words.strip() else f"exit code {code}"
            sys.stderr.write(words)
            self._take(Broke(job.number, Mistake(ENDED_EARLY, hint=hint)))


def event_of(job: SolveJob, message: dict[str, Any], at: str) -> Event:
    """What a message of the solver's process means."""
    if "mistake" in message:
        return Broke(job.number, Mistake(**message["mistake"]))
    if "stage" in message:
        return Staged(job.number, message["stage"], message["draft"])
    figures = tuple((name, float(value)) for name, value in message["figures"])
    return ReportReady(job.number, SolveOutcome(message["kind"], message["words"], figures, message["draft"]), at)


async def _new_process() -> Process:
    # a session of its own: Ctrl-C in the terminal is for the view, which ends the whole of it
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
