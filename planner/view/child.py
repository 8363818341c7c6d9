"""The process that solves for the live view: jobs as lines of JSON on stdin, progress as lines of JSON on stdout.

It is started before there is anything to solve, since importing takes longer than a small solve, and stays alive: the
next draft or small print finds its kernels loaded. A large print is solved by a copy of this process, which can be
cancelled by itself. When stdin closes, the view has ended; this process then ends too, with all that it started.
"""

from __future__ import annotations

import json
import multiprocessing
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import asdict
from functools import partial
from multiprocessing.context import ForkProcess
from pathlib import Path
from queue import SimpleQueue
from typing import Any

from planner.base.errors import InputError, PlannerError, Refusal
from planner.base.progress import Stages
from planner.base.signals import end_with_parent
from planner.planning.pipeline import solve
from planner.planning.solve_command import report_refusal
from planner.problem import Problem, load_problem
from planner.report.html import write_report
from planner.report.wording import counted
from planner.toolpath.build import build_toolpath
from planner.view.content import mistake_of
from planner.view.machine import figures_of

LARGE = 3_000  # waypoints: prints from this size have a draft of one layer first; smaller ones take only seconds
# Read past sys.stdin: a thread waiting in it holds its lock, and a forked worker, which closes it, would wait forever.
STDIN, LONGEST_PIECE = 0, 4096
BEHIND = 10  # niceness added for the whole print after its draft
FORKS = sys.platform == "linux"  # elsewhere a process with threads cannot be copied safely
Say = Callable[..., None]
Job = dict[str, Any]


def main() -> int:
    """Do one job after the other, and report on each."""
    out = os.fdopen(os.dup(sys.stdout.fileno()), "w", encoding="utf-8")
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())  # output of libraries must not appear among the messages
    jobs: SimpleQueue[Job] = SimpleQueue()
    forked = ForkedSolve()
    threading.Thread(target=_listen, args=(jobs, forked), daemon=True).start()

    def say(number: int, **message: Any) -> None:
        out.write(json.dumps({"job": number, **message}) + "\n")
        out.flush()

    while True:
        job = jobs.get()
        if not run(job, partial(say, job["number"]), forked):
            return 1


class ForkedSolve:
    """A solve in a copy of this process, if there is one; another thread may end it."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._process: ForkProcess | None = None
        self._ended = False

    def do(self, begun: Callable[[], None], work: Callable[[], None]) -> bool:
        """Call `begun` here and `work` in a copy, and wait for it; False if it ended by itself with its work undone."""
        process = multiprocessing.get_context("fork").Process(target=_copied, args=(os.getpid(), work))
        with self._lock:  # so that it can be ended as soon as `begun` has announced it
            begun()
            process.start()
            self._process, self._ended = process, False
        process.join()
        with self._lock:
            self._process = None
            if self._ended or process.exitcode == 0:
                return True
        print(f"the process that solved ended with exit code {process.exitcode}", file=sys.stderr)
        return False

    def end(self) -> None:
        """End the copy, if there is one."""
        with self._lock:
            if self._process is not None:
                self._process.kill()
                self._ended = True


def _copied(parent: int, work: Callable[[], None]) -> None:
    end_with_parent(parent)
    work()


def run(job: Job, say: Say, forked: ForkedSolve) -> bool:
    """Solve one job: {number, problem, overrides, strategy, drafts, folder}; reports go into folder/draft and folder/whole.

    False if a copy of this process ended before it was done.
    """
    try:
        problem, folder = load_problem(job["problem"], job["overrides"]), Path(job["folder"])
        layers = getattr(problem.layers, "count", 1) or build_toolpath(problem).layers  # None: all layers
        first = _first_layer(job) if layers > 1 else None
        large = (_waypoints(problem) if first is None else first[1] * layers) >= LARGE
    except PlannerError as error:
        say(mistake=asdict(mistake_of(error)))
        return True
    drafted = first is not None and large and job["drafts"]
    if first is not None and drafted:
        with suppress(
            PlannerError
        ):  # one layer may not be printable alone; errors of the whole print are reported below
            _solve(first[0], job["strategy"], folder / "draft", f"one layer of {layers}", say)
    whole = partial(_whole, problem, job["strategy"], folder / "whole", say)
    if large and FORKS:
        return forked.do(partial(say, apart=True), partial(whole, BEHIND if drafted else 0))
    whole(0)
    return True


def _first_layer(job: Job) -> tuple[Problem, int] | None:
    """The problem with only its first layer, and its waypoints; None if that is not a valid problem."""
    try:
        first = load_problem(job["problem"], [*job["overrides"], "layers.count=1"])
        return first, _waypoints(first)
    except InputError:
        return None


def _waypoints(problem: Problem) -> int:
    return build_toolpath(problem).waypoints


def _whole(problem: Problem, strategy: str, folder: Path, say: Say, behind: int) -> None:
    """Solve the whole print at a lower priority: meanwhile the browser draws the draft."""
    os.nice(behind)
    try:
        _solve(problem, strategy, folder, "", say)
    except PlannerError as error:
        say(mistake=asdict(mistake_of(error)))


def _solve(problem: Problem, strategy: str, folder: Path, draft: str, say: Say) -> None:
    folder.mkdir(parents=True)
    path = folder / "report.html"
    stages = Stages(entered=lambda name: say(stage=name, draft=draft))
    try:
        plan = solve(problem, strategy, stages=stages, second_process=True, draft=bool(draft))
    except Refusal as refusal:
        with stages.stage("report"):
            report_refusal(problem, strategy, refusal, path)
        say(kind="refused", words=f"no plan: {refusal}", figures=[], draft=draft)
        return
    with stages.stage("report"):
        write_report(plan, path)
    failed = [check.name for check in plan.checks if not check.ok]
    size = f"{counted(plan.metrics['beads'], 'bead')}, {counted(plan.metrics['layers'], 'layer')}"
    words = f"not verified: {', '.join(failed)}" if failed else f"verified: {len(plan.checks)} checks hold"
    kind = "failed" if failed else "verified"
    say(kind=kind, words=f"{words}; {size}", figures=figures_of(plan.metrics), draft=draft)


def _listen(jobs: SimpleQueue[Job], forked: ForkedSolve) -> None:
    """Take orders: a job, or cancelling the one done by a copy of this process."""
    for line in _lines():
        order = json.loads(line)
        if "cancel" in order:
            forked.end()
        else:
            jobs.put(order)
    os.killpg(os.getpgid(0), signal.SIGKILL)  # the session created for this process, including workers


def _lines() -> Iterator[bytes]:
    """Lines of stdin, until it closes."""
    kept = b""
    while piece := os.read(STDIN, LONGEST_PIECE):
        *lines, kept = (kept + piece).split(b"\n")
        yield from lines


if __name__ == "__main__":
    sys.exit(main())
