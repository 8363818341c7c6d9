"""What can happen to the live view, and what it then wants done."""

from __future__ import annotations

from dataclasses import dataclass

from planner.view.content import Content, Mistake
from planner.view.state import Job, Outcome


@dataclass(frozen=True)
class Touched:
    """A file that counts has changed, come or gone, at a time [s] of a steady clock."""

    now: float


@dataclass(frozen=True)
class Tick:
    """Time has passed."""

    now: float


@dataclass(frozen=True)
class Read:
    """The files were read, at a time of the day: what they say, or what is wrong with them."""

    found: Content | Mistake
    at: str


@dataclass(frozen=True)
class Shown:
    """A folder of results was read: what it holds, of which strategy, and the settings that it was made with."""

    strategy: str
    outcome: Outcome
    settings: Content
    at: str


@dataclass(frozen=True)
class Staged:
    """A solve has come to a stage; of a draft, if that is not empty."""

    job: int
    stage: str
    draft: str = ""


@dataclass(frozen=True)
class Solved:
    """A solve has a report, of a draft or of all."""

    job: int
    outcome: Outcome
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
    """The user wants all panes solved anew."""


Event = Touched | Tick | Read | Shown | Staged | Solved | Broke | Choose | Beside | Drafts | Again


@dataclass(frozen=True)
class ReadFiles:
    """The files are to be read; a Read or Shown follows."""


@dataclass(frozen=True)
class Start:
    """A solve is to be started."""

    job: Job


@dataclass(frozen=True)
class Cancel:
    """The solve that runs is to be ended; nothing more that it says counts."""


@dataclass(frozen=True)
class Remove:
    """A report that nobody will see again."""

    key: str


Effect = ReadFiles | Start | Cancel | Remove
