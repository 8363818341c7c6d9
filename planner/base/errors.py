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
    """Base of every error that the user can fix; `str()` is one clear sentence."""

    exit_code = EXIT_BUG


class InputError(PlannerError):
    """The input is wrong: names the file, the line (from 1), the field, and what would be right.

    Attributes:
        reason: What is wrong, in words.
        file: The file; None if the input is no file.
        line: Line in the file, from 1; None if unknown.
        field: The field of the file, or the argument; None if it is neither.
        hint: What would be right, in words; None if there is nothing to say.
        all: Every error found in the file, this one first; empty if there are no others.
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

    tries: the smallest change first: the change in words, and each field with its value as in `--set`, or a MovedBy
    """

    tries: tuple[tuple[str, tuple[tuple[str, Any], ...]], ...]

    def __new__(cls, words: str, tries: tuple[tuple[str, tuple[tuple[str, Any], ...]], ...] = ()) -> Change:
        change = super().__new__(cls, words)
        change.tries = tries
        return change


@dataclass(frozen=True)
class MovedBy:
    """A vector [mm] to add to a field's value, given in place of a new one."""

    vector: tuple[float, float, float]


class Refusal(PlannerError):
    """There is no plan: where, and why.

    Attributes:
        reason: Why there is none, in words.
        bead: Index of the bead, from 0.
        waypoint: Index of the waypoint of the bead, from 0.
        s_mm: Arc length along the bead [mm].
        point_mm: Position in the part frame [mm].
        run: "run-in" or "run-out" if the place is there and not on the bead itself.
        missing_mm: How far the point lies out of reach [mm], where that is the reason.
        near_ends: Whether the failed search kept away from the ends of joint ranges, nearer to which a path may exist.
        posture: Joints (arm, then holder) [rad; m for sliding joints] of the posture there that comes closest to
            working, if any.
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
        """Changes that were tried and would help.

        A function that finds them is called on first access: trying changes takes longer than anything else, and a
        refusal that another plan makes good needs no hints.
        """
        if callable(self._hints):
            self._hints = self._hints()
        return self._hints

    def trying(self, tried: Callable[[Hints], Hints]) -> None:
        """Have its hints tried on first access.

        Args:
            tried: Takes the hints and returns those that hold.
        """
        given = self._hints
        self._hints = lambda: tried(given() if callable(given) else given)

    def advised_by(self, hints: Hints | Callable[[], Hints]) -> None:
        """Replace its hints.

        Args:
            hints: The new hints, or a function that finds them on first access.
        """
        self._hints = hints

    def __reduce__(self) -> str | tuple[Any, ...]:
        self._hints = self.hints  # the function that finds them cannot be sent to another process
        return super().__reduce__()


class Blocked(Refusal):
    """A Refusal because something blocks every posture tried at a place."""


def printable(text: str) -> str:
    """A text with a ? for each run of unprintable characters, such as bytes of a damaged file quoted by its reader."""
    return _UNPRINTABLE.sub("?", "".join(c if c.isprintable() or c == "\n" else "\0" for c in text))


def nearest_name(name: str, names: Iterable[str]) -> str | None:
    """Return the one of `names` that a misspelt `name` most probably meant, or None."""
    close = difflib.get_close_matches(name, list(names), n=1, cutoff=0.5)
    return close[0] if close else None
