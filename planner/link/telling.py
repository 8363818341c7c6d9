"""What users see of a run: its progress while it lasts, and how it ended."""

from __future__ import annotations

import json
import shlex
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn

from planner.base.results import digest
from planner.base.shipped import PROBLEMS
from planner.link.program_lines import NO_BEAD, ProgramLines
from planner.link.relay import STANDING, LogNote, RelayState, RunOutcome, RunStatus
from planner.problem.settings import STRATEGY_NAMES

SETTLED = 10.0  # s of the plan after which the run's own pace is used to estimate the remaining time
OF_PLAN = ("problem", "problem_file", "problem_sha256", "strategy", "settings")  # keys needed to plan it again


@dataclass(frozen=True)
class RunProgress:
    """Progress of a run: its status, the share of the planned time that has passed, and the remaining time [s]."""

    status: RunStatus
    share: float
    left: float


class Show:
    """A progress bar with bead, layer, line and time left; none if the console is None. `also` gets the same."""

    def __init__(self, lines: ProgramLines, console: Console | None, also: Callable[[RunProgress], None]) -> None:
        self._lines, self._also = lines, also
        self._first: float | None = None  # when the first line was acknowledged [s of a monotonic clock]
        self._stood, self._last = 0.0, time.monotonic()  # time paused, and time of the last update [s]
        self._progress = None if console is None else Progress(
            TextColumn("{task.description}"), BarColumn(), TextColumn("{task.percentage:>5.1f} %"),
            TextColumn("{task.fields[left]}"), console=console, auto_refresh=False,
        )  # fmt: skip
        self._bar = None if self._progress is None else self._progress.add_task("waiting", total=1.0, left="")

    def __enter__(self) -> Show:
        if self._progress is not None:
            self._progress.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._progress is not None:
            self._progress.stop()

    def __call__(self, status: RunStatus) -> None:
        """Draw the progress of the run."""
        now = time.monotonic()
        if status.state in STANDING:
            self._stood += now - self._last
        self._last = now
        if not status.acknowledged:
            self._also(RunProgress(status, 0.0, self._lines[len(self._lines)].t))
            return
        if self._first is None:
            self._first, self._stood = now, 0.0
        share, left = progress(self._lines, status.acknowledged, now - self._first - self._stood)
        self._also(RunProgress(status, share, left))
        if self._progress is None or self._bar is None:
            return
        words = f"{place(self._lines, status.acknowledged)}, line {status.acknowledged} of {len(self._lines)}"
        if status.state is not RelayState.RUNNING:
            words = f"{status.state.value}: {words}"
        self._progress.update(self._bar, completed=share, description=words, left=f"{duration(left)} left")
        self._progress.refresh()


def progress(lines: ProgramLines, acknowledged: int, since: float) -> tuple[float, float]:
    """Share of the planned time that has passed, and the remaining time [s] at the pace so far.

    since  time since the first acknowledgement, without pauses [s]
    """
    first, last, here = lines[1].t, lines[len(lines)].t, lines[acknowledged].t
    if acknowledged == len(lines) or last <= first:
        return acknowledged / len(lines), 0.0
    pace = since / (here - first) if here - first >= SETTLED and since > 0.0 else 1.0
    return (here - first) / (last - first), (last - here) * pace


def place(lines: ProgramLines, n: int) -> str:
    """Bead and layer of a line in words, numbered as everywhere; those of the last bead before it if it has none."""
    line = next((lines[k] for k in range(n, 0, -1) if lines[k].bead != NO_BEAD), None)
    return "before the first bead" if line is None else f"bead {line.bead}, layer {line.layer}"


def duration(seconds: float) -> str:
    """A time as 1:02:03 or 2:03."""
    minutes, rest = divmod(round(seconds), 60)
    return f"{minutes // 60}:{minutes % 60:02d}:{rest:02d}" if minutes >= 60 else f"{minutes}:{rest:02d}"


@dataclass(frozen=True)
class GoingOn:
    """How to plan a print again: by a command with the problem, and the options after the bead; or in Python, if it was
    made with something that no command offers.

    file     the problem's file, or the name of a shipped problem
    sha256   of the file as it was planned; empty if unknown
    """

    problem: str
    options: str = ", with the same --set and --strategy"
    file: str = ""
    sha256: str = ""
    in_python: bool = False

    def lines(self, bead: int) -> list[str]:
        """How to resume from a bead, preceded by a warning if the problem's file has changed."""
        if self.in_python:
            return [f"to go on: solve(..., first_bead={bead}) in Python, with all else as {self.problem} was planned"]
        command = f"to go on: python -m planner.solve {self.problem} --from-bead {bead}{self.options}"
        if not self._is_changed():
            return [command]
        words = f"{self.file} was changed since it was planned: bead {bead} may be a different one; restore the file"
        return [words, command]

    def _is_changed(self) -> bool:
        """Whether the problem's file has changed since. A missing one is reported by the planner itself."""
        if not self.sha256:
            return False
        own, shipped = Path(self.file), PROBLEMS / f"{self.file.removesuffix('.yaml')}.yaml"
        try:
            return digest(own if own.is_file() or own.name != self.file else shipped) != self.sha256
        except OSError:
            return False


def going_on(plan: Mapping[str, Any], name: str) -> GoingOn:
    """How to plan the print of a plan.json again; by the name in its program's header if it does not say. Waypoints
    from arrays, which are in no file, and a user's own strategies and terms exist only in Python."""
    try:
        problem, sha256 = plan.get("problem_file") or plan["problem"], plan.get("problem_sha256")
        words = ["--strategy", plan["strategy"]]
        settings = plan["settings"]
        for override in settings["overrides"]:
            words += ["--set", override]
        known = sha256 if isinstance(sha256, str) else ""
        arrays = "problem_file" in plan and plan["problem_file"] is None
        in_python = arrays or plan["strategy"] not in STRATEGY_NAMES or bool(settings.get("terms"))
        return GoingOn(shlex.quote(problem), f" {shlex.join(words)}", problem, known, in_python)
    except (AttributeError, KeyError, TypeError):
        return GoingOn(name)


def for_the_log(plan: Mapping[str, Any]) -> LogNote:
    """The log record of a run's plan, with what `going_on` needs, as its folder may hold another plan by then."""
    return LogNote("plan", 0, json.dumps({key: plan[key] for key in OF_PLAN if key in plan}))


def begun_words(bead: int, planned: GoingOn | None) -> list[str]:
    """What to check, and how to resume, if a motion ended on a bead or on the way to it."""
    ahead = [] if planned is None else planned.lines(bead)
    return [f"bead {bead} or the way to it was begun: check whether the bead before it is complete", *ahead]


def ending(lines: ProgramLines, outcome: RunOutcome, planned: GoingOn) -> list[str]:
    """How a run ended, in lines: why, where it stands, what the user should check, and how to resume."""
    total, n = len(lines), outcome.position.n
    if outcome.reason is None:
        return [f"done: all {total} lines were acknowledged"]
    where = f"last acknowledged line {n} of {total} ({place(lines, n)})" if n else "no line was acknowledged"
    out = [f"stopped: {outcome.reason}; {where}"]
    if outcome.sent > n:
        out.append(f"line {outcome.sent} ({lines[outcome.sent].text}) went to the board, which may have carried it out")
    if not outcome.safe:
        out.append(
            "the board did not confirm that it is safe: check its heaters, its cutter, and whether it still extrudes"
        )
    resume = outcome.position.resume
    if resume is None:
        return [*out, "all beads were printed"]
    return [*out, *planned.lines(resume)]
