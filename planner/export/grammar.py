"""Strict reading of line-based programs: each line is a statement of a table of patterns, or an error with its number."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

from planner.base.errors import InputError

SHOWN = 60  # characters of a line that an error quotes
# patterns that grammars are made of
NUMBER = r"-?[0-9]+(?:\.[0-9]+)?"
SIX_NUMBERS = rf"({NUMBER}(?:,{NUMBER}){{5}})"


class Statement(NamedTuple):
    """A line that was recognised: its key in the grammar, and the groups of its pattern, empty where they are not there."""

    word: str
    parts: tuple[str, ...]
    text: str
    file: str
    line: int

    def error(self, reason: str) -> InputError:
        """What is wrong with this line."""
        return InputError(reason, file=self.file, line=self.line)

    def misplaced(self, where: str) -> InputError:
        """The line stands where it may not."""
        return self.error(f"{self.text[:SHOWN]!r} stands {where}")


@dataclass(frozen=True)
class Grammar:
    """The statements of a language.

    file      named in errors where the text has no file of its own
    comment   what comments begin with; they are skipped, as blank lines are
    patterns  word → pattern that a whole line must match, tried in their order
    called    what a line is to whoever writes the language
    """

    file: str
    comment: str
    patterns: Mapping[str, re.Pattern[str]]
    called: str

    @classmethod
    def of(cls, file: str, comment: str, patterns: Mapping[str, str], called: str = "statement") -> Grammar:
        """A grammar of patterns that are not compiled yet; digits are those of ASCII."""
        return cls(file, comment, {word: re.compile(text, re.ASCII) for word, text in patterns.items()}, called)

    def unknown(self, text: str, line: int, file: str = "") -> InputError:
        """A line that is none of the language's."""
        return InputError(f"unknown {self.called} {text[:SHOWN]!r}", file=file or self.file, line=line)

    def statement(self, text: str, line: int, file: str = "") -> Statement:
        """The statement of one line. Raises InputError where no pattern matches."""
        for word, pattern in self.patterns.items():
            if match := pattern.fullmatch(text):
                return Statement(word, match.groups(""), text, file or self.file, line)
        raise self.unknown(text, line, file)

    def statements(self, lines: Sequence[str], first: int = 1, file: str = "") -> Iterator[Statement]:
        """The statements of lines, the first of which has the number `first`. Raises InputError for any other line."""
        for line, raw in enumerate(lines, first):
            text = raw.strip()
            if text and not text.startswith(self.comment):
                yield self.statement(text, line, file)

    def bodies(self, text: str, incomplete: str) -> dict[str, list[Statement]]:
        """The statements of each program of a text, between its "define" and its "end"; an "attribute" is none of them.

        Raises InputError for what stands outside, for names that are the same in capitals, and where a program does not
        end or there is none, which is said by `incomplete`.
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
                    raise statement.error(f"program {current} stands there twice")
                bodies[current] = []
            elif statement.word == "end":
                current = ""
            else:
                bodies[current].append(statement)
        if current or not bodies:
            raise InputError(incomplete, file=self.file)
        return bodies


def inlined(bodies: Mapping[str, Sequence[Statement]], main: str, called: str, depth: int = 1) -> Iterator[Statement]:
    """The statements of `main` in the order in which they run, with those of what it calls in place of each call.

    depth: how many calls may be within each other. Raises InputError for a call of what is not there, of main itself, or
    from too deep.
    """

    def body(name: str, left: int) -> Iterator[Statement]:
        for statement in bodies[name]:
            if statement.word != "call":
                yield statement
                continue
            callee = statement.parts[0]
            if not left or callee not in bodies or callee == main:
                raise statement.error(f"{callee} is no {called} that may be called here")
            yield from body(callee, left - 1)

    return body(main, depth)
