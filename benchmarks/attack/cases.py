"""One attack after another, each from a seed of its own, in processes that may die: what became of each."""

from __future__ import annotations

import contextlib
import multiprocessing
import random
import resource
import signal
import time
import traceback
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from multiprocessing.connection import Connection, wait
from pathlib import Path
from types import FrameType
from typing import Any

from benchmarks.usage import peak_mb

FOUND, REFUSED, HARMLESS, ACCEPTED, ESCAPED = "found", "refused", "within tolerance", "accepted", "escaped"
STOPPED = "stopped"  # a solve that was not waited for
VERDICTS = (FOUND, REFUSED, HARMLESS, ACCEPTED, STOPPED, ESCAPED)
# What else is counted, beside the verdicts: each of them must be nought.
BUGS, ORPHANS, ZOMBIES, LOST_RESULTS, LOST_FILES, LEFT_OVER = HARMS = (
    "exit 1",
    "orphans",
    "zombies",
    "lost results",
    "lost user files",
    "temporary files",
)
MOST_MEMORY = 6 << 30  # bytes of addresses: a MemoryError is an escape
LONGEST = 150.0  # s: a case that takes longer has escaped, whatever it would have come to


@dataclass(frozen=True)
class Outcome:
    """What was spoilt, what became of it, and what was told; `harm` counts what must not be (BUGS, ORPHANS, …)."""

    what: str
    verdict: str
    told: str = ""
    harm: dict[str, int] = field(default_factory=dict)


@dataclass(frozen=True)
class Attack:
    """An attack of a kind by its number, what came of it, how long it took [s], and the most memory till then [MB]."""

    kind: str
    number: int
    outcome: Outcome
    seconds: float
    memory: float

    @property
    def words(self) -> str:
        """A line on it."""
        return f"{self.kind} {self.number}: {self.outcome.what}: {self.outcome.verdict}: {self.outcome.told}"


class Chance(random.Random):
    """The random numbers of one attack, and its number."""

    number: int = 0


Case = Callable[[Chance], Outcome]


@dataclass(frozen=True)
class Kind:
    """A kind of attack.

    does     in a few words
    count    how many there are in a full run
    prepare  makes, once, what all of them need (in a folder that they may write to), and gives what does one of them
    """

    does: str
    count: int
    prepare: Callable[[Path], Case]


class TimeLimit(BaseException):
    """What is raised in a block that is not waited for any longer; no error that anything would catch."""


@contextlib.contextmanager
def time_limit(seconds: float) -> Iterator[None]:
    """Raise TimeLimit in the block after so long."""

    def over(number: int, frame: FrameType | None) -> None:
        raise TimeLimit

    before = signal.signal(signal.SIGALRM, over)
    signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    except SystemError as error:  # what Python makes of it when a compiled function returns just then
        if isinstance(error.__cause__, TimeLimit):
            raise TimeLimit from None
        raise
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)


def one(case: Case, kind: str, number: int, seed: int) -> Outcome:
    """An attack by its number: the same one, whichever others are run. An exception that nobody expects is a bug."""
    try:
        by = Chance(f"{seed} {kind} {number}")
        by.number = number
        return case(by)
    except Exception as error:
        last = traceback.extract_tb(error.__traceback__)[-1]
        told = f"{type(error).__name__}: {error} ({Path(last.filename).name}:{last.lineno})"
        return Outcome("an exception", ESCAPED, told, {BUGS: 1})


def run(kind: str, case: Case, numbers: Sequence[int], seed: int, jobs: int) -> list[Attack]:
    """The attacks of these numbers, in their order, in so many processes; one that dies or hangs has escaped."""
    left, done = list(reversed(numbers)), []
    workers: list[_Worker] = []
    try:
        while left or workers:
            while left and len(workers) < jobs:
                workers.append(_Worker.started(kind, case, seed))
                workers[-1].ask(left.pop())
            ready = wait([worker.pipe for worker in workers], timeout=1.0)
            for worker in list(workers):
                outcome = worker.answer() if worker.pipe in ready else worker.too_long()
                if outcome is None:
                    continue
                memory = worker.memory if worker.process.is_alive() else 0.0
                done.append(Attack(kind, worker.number, outcome, time.monotonic() - worker.began, memory))
                # what was stopped anywhere, such as in the middle of a compilation, is in no state to go on
                if left and worker.process.is_alive() and outcome.verdict != STOPPED:
                    worker.ask(left.pop())
                else:
                    worker.end()
                    workers.remove(worker)
    finally:
        for worker in workers:
            worker.end()
    return sorted(done, key=lambda attack: attack.number)


@dataclass
class _Worker:
    """A process that does attacks, one at a time, as it is asked for them by number."""

    process: Any
    pipe: Connection
    number: int = -1
    began: float = 0.0
    memory: float = 0.0

    @staticmethod
    def started(kind: str, case: Case, seed: int) -> _Worker:
        context = multiprocessing.get_context("fork")
        ours, theirs = context.Pipe()
        process = context.Process(target=_work, args=(theirs, kind, case, seed), daemon=True)
        process.start()
        theirs.close()
        return _Worker(process, ours)

    def ask(self, number: int) -> None:
        self.number, self.began = number, time.monotonic()
        self.pipe.send(number)

    def answer(self) -> Outcome:
        try:
            outcome: Outcome
            outcome, self.memory = self.pipe.recv()
            return outcome
        except EOFError:
            self.process.join()
            return Outcome("a process", ESCAPED, f"it died: exit code {self.process.exitcode}", {BUGS: 1})

    def too_long(self) -> Outcome | None:
        if time.monotonic() - self.began < LONGEST:
            return None
        self.process.kill()
        self.process.join()
        return Outcome("a process", ESCAPED, f"no end in {LONGEST:.0f} s")

    def end(self) -> None:
        self.pipe.close()
        self.process.kill()
        self.process.join()


def _work(pipe: Connection, kind: str, case: Case, seed: int) -> None:
    signal.signal(signal.SIGINT, lambda number, frame: None)  # not ignored, which runs that are killed would inherit
    resource.setrlimit(resource.RLIMIT_AS, (MOST_MEMORY, MOST_MEMORY))
    with contextlib.suppress(EOFError):
        while True:
            outcome = one(case, kind, pipe.recv(), seed)
            pipe.send((outcome, peak_mb()))
