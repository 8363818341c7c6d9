"""The process that solves for the live view: one job as a line of JSON on stdin, what happens as lines of JSON on stdout.

It is started before there is anything to solve, since importing takes longer than a small solve. When stdin closes,
the view has ended: so does this process, with all that it started.
"""

from __future__ import annotations

import json
import os
import signal
import sys
import threading
from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from planner.base.errors import PlannerError, Refusal
from planner.base.progress import Stages
from planner.planning.pipeline import solve
from planner.planning.solve_command import report_refusal
from planner.problem import Problem, load_problem
from planner.report.html import write_report
from planner.report.wording import counted
from planner.toolpath.build import build_toolpath
from planner.view.content import mistake_of
from planner.view.machine import figures_of

DRAFT_FROM = 3_000  # waypoints from which a draft of one layer comes first: below, the whole takes but some seconds
# Read past sys.stdin: a thread that waits in it holds its lock, and a forked worker, which closes it, would wait for ever.
STDIN, LONGEST_PIECE = 0, 4096
BEHIND = 10  # of priorities that the whole print is solved with, after its draft
Say = Callable[..., None]


def main() -> int:
    """Wait for a job, do it, and tell."""
    line = _first_line()
    if not line.strip():
        return 0
    threading.Thread(target=_end_with_the_view, daemon=True).start()
    out = os.fdopen(os.dup(sys.stdout.fileno()), "w", encoding="utf-8")
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())  # whatever a library prints is no message

    def say(**message: Any) -> None:
        out.write(json.dumps(message) + "\n")
        out.flush()

    run(json.loads(line), say)
    return 0


def run(job: dict[str, Any], say: Say) -> None:
    """Solve one job: {problem, overrides, strategy, drafts, folder}; reports go into folder/draft and folder/whole."""
    try:
        overrides: Sequence[str] = job["overrides"]
        problem, folder = load_problem(job["problem"], overrides), Path(job["folder"])
        draft = _draft_words(problem) if job["drafts"] else ""
        if draft:
            one = load_problem(job["problem"], [*overrides, "layers.count=1"])
            _solve(one, job["strategy"], folder / "draft", draft, say)
            os.nice(BEHIND)  # the browser draws the draft meanwhile
        _solve(problem, job["strategy"], folder / "whole", "", say)
    except PlannerError as error:
        say(mistake=asdict(mistake_of(error)))


def _draft_words(problem: Problem) -> str:
    """What a draft of one layer is called; empty where the whole is small, or does not count its layers."""
    count = getattr(problem.layers, "count", 1)
    if count < 2:
        return ""
    toolpath = build_toolpath(problem)
    waypoints = sum(len(bead.s) for bead in toolpath.beads)
    return f"one layer of {count}" if waypoints >= DRAFT_FROM else ""


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


def _first_line() -> bytes:
    line = b""
    while not line.endswith(b"\n") and (piece := os.read(STDIN, LONGEST_PIECE)):
        line += piece
    return line


def _end_with_the_view() -> None:
    while os.read(STDIN, LONGEST_PIECE):
        pass
    os.killpg(os.getpgid(0), signal.SIGKILL)  # the session that was made for this process, workers included


if __name__ == "__main__":
    sys.exit(main())
