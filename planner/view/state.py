"""What the live view knows at one time."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from planner.view.content import Content, Mistake
from planner.view.figures import Figures


@dataclass(frozen=True)
class Outcome:
    """What came of a solve.

    kind   "verified", "failed" (a plan with failed checks) or "refused" (no plan)
    words  one line for people
    draft  what of the print was left out, in words; empty for all of it
    """

    kind: str
    words: str
    figures: Figures = ()
    draft: str = ""


@dataclass(frozen=True)
class Result:
    """A report that can be shown; `turn` tells which content of the files it is of."""

    key: str
    turn: int
    strategy: str
    outcome: Outcome


@dataclass(frozen=True)
class Entry:
    """A row of the history: what was changed since the strategy's last row (None: there is none), and what came of it."""

    number: int
    at: str
    strategy: str
    changes: tuple[str, ...] | None
    outcome: Outcome
    before: Figures = ()


@dataclass(frozen=True)
class Job:
    """A solve that runs: its number, what it plans with, and how far it is."""

    number: int
    strategy: str
    drafts: bool
    stage: str = "start"
    draft: str = ""


@dataclass(frozen=True)
class View:
    """All that the view knows.

    panes     the strategy of each pane, left to right
    solving   whether this view solves, or only shows what is written elsewhere
    tried     strategies that need no solve of the present content (any more)
    mistake   of the files as they stand; `trouble` of the solver with files that could be read
    results   the newest by strategy
    solved    what the files said at each strategy's last row of the history
    touched   when the first change came that has not been read [s], and when to read it
    """

    panes: tuple[str, ...]
    solving: bool = True
    drafts: bool = True
    content: Content | None = None
    turn: int = 0
    note: str = ""
    mistake: Mistake | None = None
    trouble: Mistake | None = None
    running: Job | None = None
    jobs: int = 0
    tried: frozenset[str] = frozenset()
    results: Mapping[str, Result] = field(default_factory=dict)
    history: tuple[Entry, ...] = ()
    entries: int = 0
    solved: Mapping[str, Content] = field(default_factory=dict)
    touched: tuple[float, float] | None = None
    reading: bool = False


def key_of(job: int, draft: str) -> str:
    """The name of a report: of a solve's draft, or of all."""
    return f"{job}-{'draft' if draft else 'whole'}"
