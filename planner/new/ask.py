"""Questions on the terminal, or to a pipe: each answer is checked when it is given."""

from __future__ import annotations

import sys
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.markup import escape
from rich.prompt import InvalidResponse, PromptBase

from planner.errors import InputError, nearest_name
from planner.problem.described import Model, described, read_value

Check = Callable[[str], Any]  # a text → the answer; raises ValueError in words


class _Prompt(PromptBase[Any]):
    """A question whose answer is whatever its check makes of the text."""

    response_type = str
    prompt_suffix = " "
    check: Check = str

    def process_response(self, value: str) -> Any:
        """Return what the check makes of an answer; ask again where it refuses."""
        try:
            return self.check(value.strip())
        except ValueError as error:
            raise InvalidResponse(f"[prompt.invalid]{escape(str(error))}") from None


@dataclass(frozen=True)
class Asker:
    """Asks on a console; with `take_defaults` nobody is asked.

    At a terminal a wrong answer is told and asked for again. In a pipe it ends the command: what follows it would be
    answers to other questions.
    """

    console: Console
    take_defaults: bool = False

    def __call__(self, question: str, default: str, check: Check) -> Any:
        """The answer to a question; an empty one is the default, an empty default must be answered.

        Raises InputError for a wrong answer of a pipe, KeyboardInterrupt where the input ends.
        """
        if self.take_defaults:
            return check(default)
        try:
            return self._ask(question, default, check)
        except EOFError:
            raise KeyboardInterrupt from None

    def _ask(self, question: str, default: str, check: Check) -> Any:
        shown = f"{escape(question)} [prompt.default]({escape(default)})[/]:" if default else f"{escape(question)}:"
        prompt = _Prompt(shown, console=self.console)

        def answered(text: str) -> Any:
            if not text and not default:
                raise ValueError("an answer is needed here")
            return check(text or default)

        prompt.check = answered
        if sys.stdin.isatty():
            return prompt()
        text = prompt.get_input(self.console, prompt.make_prompt(...), False).strip()
        self.console.print()  # nobody has typed an end of the line
        try:
            return answered(text)
        except ValueError as error:
            raise InputError(f"{text!r}: {error}", field=question) from None


def name_of(kind: str, names: Collection[str] | Mapping[str, str]) -> Check:
    """One of some names."""

    def check(text: str) -> str:
        if text in names:
            return text
        near = nearest_name(text, names)
        meant = f"did you mean {near}? " if near else ""
        raise ValueError(f"no {kind} {text!r}; {meant}choices: {', '.join(names)}")

    return check


def field_of(model: Model, name: str) -> Check:
    """A value of a field of a problem, in the file's unit; lists with or without brackets."""
    return lambda text: read_value(described(model)[name], text)


def file_in(folder: Path, read: Callable[[Path], object]) -> Check:
    """A file, counted from the folder of the problem file, that can be read."""

    def check(text: str) -> str:
        try:
            read(folder / text)
        except InputError as error:
            raise ValueError(str(error)) from None
        return text

    return check
