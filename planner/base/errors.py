"""Errors that a user can act on: they carry values, and the command line turns them into exit codes."""

from __future__ import annotations

import difflib
import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

EXIT_VERIFIED = 0
EXIT_BUG = 1
EXIT_INPUT = 2
EXIT_NOT_VERIFIED = 3
EXIT_INTERRUPTED = 130

Hints = tuple[str, ...]
_UNPRINTABLE = re.compile("\0+")


class PlannerError(Exception):
    """Base of every error that is the user's to mend; `str()` is one clear sentence."""

    exit_code = EXIT_BUG


class InputError(PlannerError):
    """The input is wrong: names the file, the line (from 1), the field, and what would be right.

    `all` are the errors of a file of which this is the first, itself among them; none where it is the only one.
    """

    exit_code = EXIT_INPUT

    def __init__(
        self,
        reason: str,
        *,
        file: Path | str | None = None,
        line: int | None = None,
        field: str | None = None,
        hint: str | None = None,
        all: tuple[InputError, ...] = (),
    ) -> None:
        self.reason, self.file, self.line, self.field, self.hint = printable(reason), file, line, field, hint
        self.all = all
        place = "" if file is None else str(file) + ("" if line is None else f":{line}") + ": "
        what = "" if field is None else f"{field}: "
        super().__init__(place + what + self.reason + ("" if hint is None else f" ({hint})"))


Complaint = Callable[..., InputError]  # reason, hint=None → the error with its place


class OutputError(PlannerError):
    """The results cannot be written where the user asked for them."""

    exit_code = EXIT_INPUT


class Change(str):
    """A hint that can be tried: a change of the problem that helped a search, in words.

    tries: from the least change on, what is changed in words, and each field of it with its value as after `--set`, or a
    MovedBy
    """

    tries: tuple[tuple[str, tuple[tuple[str, Any], ...]], ...]

    def __new__(cls, words: str, tries: tuple[tuple[str, tuple[tuple[str, Any], ...]], ...] = ()) -> Change:
        change = super().__new__(cls, words)
        change.tries = tries
        return change


@dataclass(frozen=True)
class MovedBy:
    """In place of a field's value: a vector [mm] that is added to it."""

    vector: tuple[float, float, float]


class Refusal(PlannerError):
    """There is no plan, and this is where and why.

    `bead` and `waypoint` count from 0, `s_mm` runs along the bead, `point_mm` is in the part frame;
    `run` is "run-in" or "run-out" where it is there and not on the bead itself;
    `missing_mm` says by how much a point lies out of reach, where that is the reason; `hints` name changes
    that were tried and would help. A function that finds them is called when they are first asked for: trying
    changes takes longer than all else, and a refusal that another plan makes good needs none.
    `near_ends` is true where a search ended that keeps room to the ends of joints' ranges, and nearer to them there may be a way.
    `posture` has the joints (arm, then holder) [rad, m] of the posture there that comes nearest to serve, where there is one.
    """

    exit_code = EXIT_NOT_VERIFIED

    def __init__(
        self,
        reason: str,
        *,
        bead: int | None = None,
        waypoint: int | None = None,
        s_mm: float | None = None,
        point_mm: tuple[float, float, float] | None = None,
        run: str | None = None,
        missing_mm: float | None = None,
        hints: Hints | Callable[[], Hints] = (),
        near_ends: bool = False,
        posture: tuple[float, ...] | None = None,
    ) -> None:
        self.reason, self.bead, self.waypoint, self.run = reason, bead, waypoint, run
        self.s_mm, self.point_mm, self.missing_mm = s_mm, point_mm, missing_mm
        self._hints, self.near_ends, self.posture = hints, near_ends, posture
        place = []
        if bead is not None:
            place.append(f"bead {bead}")
        if waypoint is not None:
            place.append(f"waypoint {waypoint}")
        if s_mm is not None:
            place.append(f"{s_mm:.1f} mm along it")
        super().__init__((", ".join(place) + ": " if place else "") + reason)

    @property
    def hints(self) -> Hints:
        """Changes that were tried and would help."""
        if callable(self._hints):
            self._hints = self._hints()
        return self._hints

    def trying(self, tried: Callable[[Hints], Hints]) -> None:
        """Have its hints tried, by what makes of hints those that hold, when they are first asked for."""
        given = self._hints
        self._hints = lambda: tried(given() if callable(given) else given)

    def advised_by(self, hints: Hints | Callable[[], Hints]) -> None:
        """Have other hints than its own, or a function that finds them when they are first asked for."""
        self._hints = hints

    def __reduce__(self) -> str | tuple[Any, ...]:
        self._hints = self.hints  # what finds them cannot go to another process
        return super().__reduce__()


class Blocked(Refusal):
    """A Refusal because something blocks every posture searched at a place."""


def printable(text: str) -> str:
    """A text with a ? for whatever of it a terminal would not print, as bytes of a damaged file that a reader quotes."""
    return _UNPRINTABLE.sub("?", "".join(c if c.isprintable() or c == "\n" else "\0" for c in text))


def nearest_name(name: str, names: Iterable[str]) -> str | None:
    """Return the one of `names` that a misspelt `name` most probably meant, or None."""
    close = difflib.get_close_matches(name, list(names), n=1, cutoff=0.5)
    return close[0] if close else None
