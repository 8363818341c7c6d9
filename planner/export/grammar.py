"""Strict reading of line-based programs: each line matches a pattern of a table, or is an error with its number."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

from planner.base.errors import InputError

SHOWN = 60  # characters of a line that an error quotes
# building blocks of patterns
NUMBER = r"-?[0-9]+(?:\.[0-9]+)?"
SIX_NUMBERS = rf"({NUMBER}(?:,{NUMBER}){{5}})"


class Statement(NamedTuple):
    """A line that was recognised: its key in the grammar, and the groups of its pattern, empty if unmatched."""

    word: str
    parts: tuple[str, ...]
    text: str
    file: str
    line: int

    def error(self, reason: str) -> InputError:
        """Error about this line."""
        return InputError(reason, file=self.file, line=self.line)

    def misplaced(self, where: str) -> InputError:
        """Error: the line is not allowed at this place."""
        return self.error(f"{self.text[:SHOWN]!r} is not allowed {where}")


@dataclass(frozen=True)
class Grammar:
    """The statements of a language.

    file      named in errors if the text has no file of its own
    comment   what comments begin with; comments and blank lines are skipped
    patterns  word → pattern that a whole line must match; tried in order
    called    what users of the language call a line
    """

    file: str
    comment: str
    patterns: Mapping[str, re.Pattern[str]]
    called: str

    @classmethod
    def of(cls, file: str, comment: str, patterns: Mapping[str, str], called: str = "statement") -> Grammar:
        """A grammar from patterns not yet compiled; \\d matches ASCII digits only."""
        return cls(file, comment, {word: re.compile(text, re.ASCII) for word, text in patterns.items()}, called)

    def unknown(self, text: str, line: int, file: str = "") -> InputError:
        """Error: the line does not belong to the language."""
        return InputError(f"unknown {self.called} {text[:SHOWN]!r}", file=file or self.file, line=line)

    def statement(self, text: str, line: int, file: str = "") -> Statement:
        """The statement of one line. Raises InputError if no pattern matches."""
        for word, pattern in self.patterns.items():
            if match := pattern.fullmatch(text):
                return Statement(word, match.groups(""), text, file or self.file, line)
        raise self.unknown(text, line, file)

    def statements(self, lines: Sequence[str], first: int = 1, file: str = "") -> Iterator[Statement]:
        """The statements of lines, numbered from `first`. Raises InputError for an unknown line."""
        for line, raw in enumerate(lines, first):
            text = raw.strip()
            if text and not text.startswith(self.comment):
                yield self.statement(text, line, file)

    def bodies(self, text: str, incomplete: str) -> dict[str, list[Statement]]:
        """The statements of each program in a text, between its "define" and its "end", without "attribute" statements.

        Raises InputError for statements outside programs, for names that differ only in case, and, with the message
        `incomplete`, if a program does not end or there is none.
        """
        bodies: dict[str, list[Statement]] = {}
        current = ""
        for statement in self.statements(text.split("\n")):
            if statement.word == "attribute":
                continue
            if (statement.word == "define") == bool(current):
                raise statement.misplaced(f"{'inside' if current else 'outside'} a program")
            if statement.word == "define":
                current = statement.parts[0]
                if current.upper() in (name.upper() for name in bodies):
                    raise statement.error(f"program {current} is defined twice")
                bodies[current] = []
            elif statement.word == "end":
                current = ""
            else:
                bodies[current].append(statement)
        if current or not bodies:
            raise InputError(incomplete, file=self.file)
        return bodies


def inlined(bodies: Mapping[str, Sequence[Statement]], main: str, called: str, depth: int = 1) -> Iterator[Statement]:
    """The statements of `main` in the order in which they run, with each call replaced by the callee's statements.

    depth: how deeply calls may be nested. Raises InputError for a call of an unknown program, of main itself, or nested
    too deeply.
    """

    def body(name: str, left: int) -> Iterator[Statement]:
        for statement in bodies[name]:
            if statement.word != "call":
                yield statement
                continue
            callee = statement.parts[0]
            if not left or callee not in bodies or callee == main:
                raise statement.error(f"{callee} is not a {called} that can be called here")
            yield from body(callee, left - 1)

    return body(main, depth)
