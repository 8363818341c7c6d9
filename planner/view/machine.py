"""The live view without files, clocks, processes or sockets: events go in, effects to be carried out come out."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from planner.report.wording import METRICS, MetricLabel
from planner.view.content import Content, Mistake, changes

# ----------------------------------------------------------------------------------------------------
# Key figures of a plan: those that decide between two plans, and which of two values is better.

SHOWN = (
    "at_speed_fraction",
    "speed_min_mm_s",
    "deposition_time_s",
    "print_time_s",
    "sigma_min",
    "joint_limit_margin_deg",
    "clearance_min_mm",
    "velocity_ratio_max",
    "acceleration_ratio_max",
    "jerk_ratio_max",
    "path_deviation_max_mm",
    "over_extruded_mm3",
)
ROWS: tuple[MetricLabel, ...] = tuple(metric for key in SHOWN for metric in METRICS if metric.key == key)
NONE = "–"

Figures = tuple[tuple[str, float], ...]  # (name of the metric, value) for those in SHOWN that a plan has


def figures_of(metrics: Mapping[str, float]) -> Figures:
    """Those of a plan's metrics that are shown, if finite."""
    return tuple((row.key, float(metrics[row.key])) for row in ROWS if math.isfinite(metrics.get(row.key, math.nan)))


def heading(row: MetricLabel) -> dict[str, str]:
    """A figure's label, with its unit."""
    unit = f", {row.unit}" if row.unit else ""
    return {"label": row.label + unit}


def rounded(row: MetricLabel, value: float) -> float:
    """A figure in its unit, rounded as shown."""
    return round(value * row.scale, row.digits)


def written(row: MetricLabel, value: float | None) -> str:
    """A figure as text, with its number of digits."""
    return NONE if value is None else f"{value * row.scale:.{row.digits}f}"


def verdict(row: MetricLabel, value: float | None, other: float | None) -> str:
    """How a value compares with another: "better", "worse", "same" to the digits shown; "" if neither is better."""
    if value is None or other is None:
        return ""
    if rounded(row, value) == rounded(row, other):
        return "same"
    if not row.better:
        return ""
    return "better" if (value > other) == (row.better == "up") else "worse"


def difference(row: MetricLabel, value: float | None, other: float | None) -> str:
    """The signed difference of a value from another, both rounded as shown."""
    if value is None or other is None:
        return NONE
    if rounded(row, value) == rounded(row, other):
        return "0"
    return f"{rounded(row, value) - rounded(row, other):+.{row.digits}f}".replace("-", "\u2212")


# ----------------------------------------------------------------------------------------------------
# The state of the live view.


@dataclass(frozen=True)
class SolveOutcome:
    """The outcome of a solve.

    kind   "verified", "failed" (a plan with failed checks) or "refused" (no plan)
    words  one line for people
    draft  what part of the print a draft covers, in words; empty for the whole print
    """

    kind: str
    words: str
    figures: Figures = ()
    draft: str = ""


@dataclass(frozen=True)
class Result:
    """A report that can be shown; `turn` is the number of the content of the files that it belongs to."""

    key: str
    turn: int
    strategy: str
    outcome: SolveOutcome


@dataclass(frozen=True)
class Entry:
    """A row of the history: the changes since the strategy's last row (None: there is none), and the outcome."""

    number: int
    at: str
    strategy: str
    changes: tuple[str, ...] | None
    outcome: SolveOutcome
    before: Figures = ()


@dataclass(frozen=True)
class SolveJob:
    """A running solve: its number, its strategy, and its progress."""

    number: int
    strategy: str
    drafts: bool
    stage: str = "start"
    draft: str = ""


@dataclass(frozen=True)
class View:
    """The whole state of the view.

    panes     the strategy of each pane, left to right
    solving   whether this view solves, or only shows results written elsewhere
    tried     strategies that need no (further) solve of the present content
    mistake   in the files as they are; `trouble`: of the solver with files that could be read
    results   the newest by strategy
    solved    content of the files at each strategy's last row of the history
    touched   time of the first change not read yet [s], and when to read it
    """

    panes: tuple[str, ...]
    solving: bool = True
    drafts: bool = True
    content: Content | None = None
    turn: int = 0
    note: str = ""
    mistake: Mistake | None = None
    trouble: Mistake | None = None
    running: SolveJob | None = None
    jobs: int = 0
    tried: frozenset[str] = frozenset()
    results: Mapping[str, Result] = field(default_factory=dict)
    history: tuple[Entry, ...] = ()
    entries: int = 0
    solved: Mapping[str, Content] = field(default_factory=dict)
    touched: tuple[float, float] | None = None
    reading: bool = False


def key_of(job: int, draft: str) -> str:
    """The name of a report: of a solve's draft, or of the whole print."""
    return f"{job}-{'draft' if draft else 'whole'}"


# ----------------------------------------------------------------------------------------------------
# Events of the live view, and the effects that it then requests.


@dataclass(frozen=True)
class Touched:
    """A watched file has changed, appeared or gone, at a time [s] of a monotonic clock."""

    now: float


@dataclass(frozen=True)
class Tick:
    """Time has passed."""

    now: float


@dataclass(frozen=True)
class Read:
    """The files were read, at a time of day: their content, or the mistake in them."""

    found: Content | Mistake
    at: str


@dataclass(frozen=True)
class Shown:
    """A folder of results was read: its strategy, its outcome, and its settings."""

    strategy: str
    outcome: SolveOutcome
    settings: Content
    at: str


@dataclass(frozen=True)
class Staged:
    """A solve has reached a stage; that of a draft, if `draft` is not empty."""

    job: int
    stage: str
    draft: str = ""


@dataclass(frozen=True)
class ReportReady:
    """A solve has a report, of a draft or of the whole print."""

    job: int
    outcome: SolveOutcome
    at: str


@dataclass(frozen=True)
class Broke:
    """A solve ended without any report."""

    job: int
    mistake: Mistake


@dataclass(frozen=True)
class Choose:
    """The user wants another strategy in a pane."""

    pane: int
    strategy: str


@dataclass(frozen=True)
class Beside:
    """The user wants a second pane with a strategy, or none."""

    strategy: str | None


@dataclass(frozen=True)
class Drafts:
    """The user wants drafts of large prints first, or not."""

    wanted: bool


@dataclass(frozen=True)
class Again:
    """The user wants all panes solved again."""


Event = Touched | Tick | Read | Shown | Staged | ReportReady | Broke | Choose | Beside | Drafts | Again


@dataclass(frozen=True)
class ReadFiles:
    """Read the files; a Read or Shown follows."""


@dataclass(frozen=True)
class Start:
    """Start a solve."""

    job: SolveJob


@dataclass(frozen=True)
class Cancel:
    """End the running solve; further messages from it are ignored."""


@dataclass(frozen=True)
class Remove:
    """Remove a report that will not be shown again."""

    key: str


Effect = ReadFiles | Start | Cancel | Remove


# ----------------------------------------------------------------------------------------------------
# The live view without files, clocks, processes or sockets: events go in, effects to be carried out come out.
#
# A burst of saves causes one reading of the files, and one solve: they are read when they have been quiet for a moment.
# A save without new content changes nothing; one with new content ends the running solve. Files that cannot be read or
# planned leave the last good results in place.

QUIET_TIME = 0.15  # s without another change before files are read: editors write in several steps
LONGEST_WAIT = 2.0  # s after which a file that keeps changing is read anyway
MOST_ENTRIES = 50  # of the history

Step = tuple[View, tuple[Effect, ...]]


def step(view: View, event: Event) -> Step:
    """The view after an event, and the effects to be carried out, in order."""
    match event:
        case Touched(now):
            first = now if view.touched is None else view.touched[0]
            return replace(view, touched=(first, min(now + QUIET_TIME, first + LONGEST_WAIT))), ()
        case Tick(now):
            if view.touched is None or view.reading or now < view.touched[1]:
                return view, ()
            return replace(view, touched=None, reading=True), (ReadFiles(),)
        case Read(found, at):
            return _read(replace(view, reading=False), found, at)
        case Shown():
            return _shown(replace(view, reading=False), event)
        case Staged(job, stage, draft):
            if view.running is None or view.running.number != job:
                return view, ()
            return replace(view, running=replace(view.running, stage=stage, draft=draft)), ()
        case ReportReady(job, outcome, at):
            return _solved(view, job, outcome, at)
        case Broke(job, mistake):
            return _broke(view, job, mistake)
        case Choose(pane, strategy):
            return _with_panes(view, _exchanged(view.panes, pane, strategy))
        case Beside(strategy):
            kept = view.panes[:1]
            return _with_panes(view, kept if strategy is None or strategy in kept else (*kept, strategy))
        case Drafts(wanted):
            return replace(view, drafts=wanted), ()
        case Again():
            return _anew(replace(view, trouble=None))


def _read(view: View, found: Content | Mistake, at: str) -> Step:
    if isinstance(found, Mistake):
        return replace(view, mistake=found, note=""), ()
    if found == view.content and view.trouble is None:
        return _go_on(replace(view, mistake=None, note=f"saved at {at}: nothing that matters to the plan"))
    fresh = replace(view, content=found, turn=view.turn + 1, mistake=None, trouble=None, note=f"files as of {at}")
    return _anew(replace(fresh, panes=_following(view, found)))


def _following(view: View, content: Content) -> tuple[str, ...]:
    """The panes; the first one takes the strategy that the file names, if it named another before."""
    wanted = dict(content.fields).get("strategy")
    if view.content is None or wanted is None or wanted == dict(view.content.fields).get("strategy"):
        return view.panes
    return _exchanged(view.panes, 0, wanted)


def _anew(view: View) -> Step:
    """Solve all panes again; results of strategies that no pane shows are dropped."""
    if view.content is None or not view.solving:
        return view, ()
    past = [result for name, result in view.results.items() if name not in view.panes]
    kept = {name: result for name, result in view.results.items() if name in view.panes}
    cancel: tuple[Effect, ...] = () if view.running is None else (Cancel(),)
    fresh, more = _go_on(replace(view, running=None, tried=frozenset(), results=kept))
    return fresh, (*cancel, *(Remove(result.key) for result in past), *more)


def _go_on(view: View) -> Step:
    """Start the next solve that a pane is waiting for, if none is running and the files can be read."""
    due = next((strategy for strategy in view.panes if strategy not in view.tried), None)
    ready = view.solving and view.running is None and view.content is not None and view.mistake is None
    if not ready or due is None:
        return view, ()
    job = SolveJob(view.jobs + 1, due, view.drafts)
    return replace(view, jobs=job.number, running=job), (Start(job),)


def _solved(view: View, number: int, outcome: SolveOutcome, at: str) -> Step:
    job, content = view.running, view.content
    if job is None or content is None or job.number != number:
        return view, (Remove(key_of(number, outcome.draft)),)
    result = Result(key_of(number, outcome.draft), view.turn, job.strategy, outcome)
    old = view.results.get(job.strategy)
    removed = () if old is None else (Remove(old.key),)
    view = replace(view, results={**view.results, job.strategy: result})
    if outcome.draft:
        return view, removed
    view = _noted(view, job.strategy, outcome, content, at)
    view, effects = _go_on(replace(view, running=None, tried=view.tried | {job.strategy}))
    return view, (*removed, *effects)


def _noted(view: View, strategy: str, outcome: SolveOutcome, content: Content, at: str) -> View:
    """The view with another row in its history."""
    last = next((entry for entry in reversed(view.history) if entry.strategy == strategy), None)
    known = view.solved.get(strategy)
    entry = Entry(
        number=view.entries + 1,
        at=at,
        strategy=strategy,
        changes=None if known is None else changes(known, content),
        outcome=outcome,
        before=() if last is None else last.outcome.figures,
    )
    history = (*view.history, entry)[-MOST_ENTRIES:]
    return replace(view, history=history, entries=entry.number, solved={**view.solved, strategy: content})


def _broke(view: View, number: int, mistake: Mistake) -> Step:
    if view.running is None or view.running.number != number:
        return view, ()
    # a mistake in a file affects every strategy; anything else may concern only this one
    over = frozenset(view.panes) if mistake.file or mistake.field else frozenset({view.running.strategy})
    return _go_on(replace(view, running=None, trouble=mistake, tried=view.tried | over))


def _shown(view: View, event: Shown) -> Step:
    turn = view.turn + 1
    result = Result(f"{turn}-folder", turn, event.strategy, event.outcome)
    view = replace(view, panes=(event.strategy,), turn=turn, mistake=None, note=f"results as of {event.at}")
    view = replace(view, content=event.settings, tried=frozenset(view.panes), results={event.strategy: result})
    return _noted(view, event.strategy, event.outcome, event.settings, event.at), ()


def _exchanged(panes: tuple[str, ...], pane: int, strategy: str) -> tuple[str, ...]:
    """The panes with a strategy put into one of them; if another pane shows that strategy, the two swap."""
    if not 0 <= pane < len(panes):
        return panes
    old = panes[pane]
    return tuple(strategy if i == pane else old if name == strategy else name for i, name in enumerate(panes))


def _with_panes(view: View, panes: tuple[str, ...]) -> Step:
    if not view.solving:
        return view, ()
    view = replace(view, panes=panes)
    if view.running is not None and view.running.strategy not in panes:
        view, effects = _go_on(replace(view, running=None))
        return view, (Cancel(), *effects)
    return _go_on(view)
