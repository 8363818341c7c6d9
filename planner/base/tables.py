"""Tables as text; the separator of their columns is taken from the first line."""

from __future__ import annotations

import csv
from functools import partial
from pathlib import Path

from planner.base.errors import Complaint, InputError
from planner.base.files import read_text


def rows_of(file: Path, largest: int) -> list[tuple[int, str]]:
    """Lines with their numbers, from 1, without empty ones and comments (#). Raises InputError as `read_text` does."""
    lines = read_text(file, largest, partial(InputError, file=file))
    return [(i, line) for i, line in enumerate(lines, 1) if line.strip() and not line.lstrip().startswith("#")]


def separator_of(line: str) -> str | None:
    """The separator between the columns of a line; None for blanks."""
    return next((mark for mark in (",", ";", "\t") if mark in line), None)


def split_row(line: str, separator: str | None, wrong: Complaint) -> list[str]:
    """The words of a line, stripped of blanks; `wrong` makes the InputError for a line that is not CSV."""
    if separator is None:
        return line.split()
    try:
        return [word.strip() for word in next(csv.reader([line], delimiter=separator))]
    except csv.Error as error:
        raise wrong(f"is not CSV: {error}") from None


def is_number(word: str) -> bool:
    """Whether a word is a number, infinity and NaN included."""
    try:
        float(word)
    except ValueError:
        return False
    return True
