"""Texts with a change at random: of a number, a word, a line, or several lines."""

from __future__ import annotations

import random
import re
from collections.abc import Callable

NUMBER = re.compile(r"(?<![\w.])-?\d+\.\d+|(?<=[ T,\[(=:#])-?\d+(?=[,\]); :%\n]|$|mm|cm)|(?<=[ T][FPST])\d+")
SHOWN = 60  # characters of a line that is told

Lines = list[str]
Change = Callable[
    [Lines, list[int], random.Random], None
]  # of lines; those that may be spoilt; changed where they stand


def _number(lines: Lines, own: list[int], by: random.Random, change: Callable[[float, str], str]) -> None:
    i = by.choice(own)
    numbers = list(NUMBER.finditer(lines[i]))
    if numbers:
        found = by.choice(numbers)
        lines[i] = lines[i][: found.start()] + change(float(found[0]), found[0]) + lines[i][found.end() :]


def _digits(value: float, like: str) -> str:
    return f"{value:.{len(like.partition('.')[2])}f}"


def scaled(lines: Lines, own: list[int], by: random.Random) -> None:
    """A number times something."""
    factor = by.choice([0.5, 0.9, 0.99, 1.01, 1.1, 2.0, 10.0])
    _number(lines, own, by, lambda value, like: _digits(value * factor, like))


def shifted(lines: Lines, own: list[int], by: random.Random) -> None:
    """A number plus something, from its last digit on."""
    step = by.choice([-1.0, 1.0]) * 10.0 ** by.uniform(-3.0, 2.0)
    _number(lines, own, by, lambda value, like: _digits(value + step, like))


def turned(lines: Lines, own: list[int], by: random.Random) -> None:
    """A number with the other sign."""
    _number(lines, own, by, lambda value, like: like[1:] if like.startswith("-") else f"-{like}")


def nought(lines: Lines, own: list[int], by: random.Random) -> None:
    """A number that is 0."""
    _number(lines, own, by, lambda value, like: _digits(0.0, like))


def left_out(lines: Lines, own: list[int], by: random.Random) -> None:
    """A line that is not there."""
    del lines[by.choice(own)]


def several_left_out(lines: Lines, own: list[int], by: random.Random) -> None:
    """Lines that are not there."""
    k = by.randrange(len(own))
    for i in reversed(own[k : k + by.randint(2, 12)]):
        del lines[i]


def twice(lines: Lines, own: list[int], by: random.Random) -> None:
    """A line that is there twice."""
    i = by.choice(own)
    lines.insert(i, lines[i])


def swapped(lines: Lines, own: list[int], by: random.Random) -> None:
    """Two lines in each other's place."""
    i, k = by.choice(own), by.choice(own)
    lines[i], lines[k] = lines[k], lines[i]


def swapped_beside(lines: Lines, own: list[int], by: random.Random) -> None:
    """Two lines that follow each other, the other way round."""
    k = by.randrange(max(1, len(own) - 1))
    first, second = own[k], own[min(k + 1, len(own) - 1)]
    lines[first], lines[second] = lines[second], lines[first]


def backwards(lines: Lines, own: list[int], by: random.Random) -> None:
    """Some lines in reversed order."""
    k = by.randrange(max(1, len(own) - 1))
    chosen = own[k : k + by.randint(2, 12)]
    for i, line in zip(chosen, [lines[i] for i in reversed(chosen)], strict=True):
        lines[i] = line


def moved(lines: Lines, own: list[int], by: random.Random) -> None:
    """A line somewhere else."""
    line = lines.pop(by.choice(own))
    lines.insert(min(by.choice(own), len(lines)), line)


def commented(lines: Lines, own: list[int], by: random.Random) -> None:
    """A line of another language's comment."""
    i = by.choice(own)
    lines[i] = by.choice(["! ", "; ", "# ", "// ", "' ", "("]) + lines[i]


def character(lines: Lines, own: list[int], by: random.Random) -> None:
    """A character that is another one."""
    i = by.choice(own)
    if lines[i]:
        k = by.randrange(len(lines[i]))
        lines[i] = lines[i][:k] + chr(by.choice([by.randint(32, 126), ord(lines[i][k]) ^ 1])) + lines[i][k + 1 :]


CHANGES: dict[str, Change] = {
    "number scaled": scaled, "number shifted": shifted, "sign": turned, "number nought": nought, "left out": left_out,
    "several left out": several_left_out, "twice": twice, "swapped": swapped, "swapped with the next": swapped_beside,
    "backwards": backwards, "moved": moved, "comment": commented, "character": character,
}  # fmt: skip
OFTEN = ("number scaled", "number shifted")


def words(pairs: tuple[tuple[str, str], ...]) -> Change:
    """A word in the place of another one, of pairs (old, new)."""

    def change(lines: Lines, own: list[int], by: random.Random) -> None:
        old, new = by.choice(pairs)
        chosen = [i for i in own if old in lines[i]]
        if chosen:
            i = by.choice(chosen)
            lines[i] = lines[i].replace(old, new, 1)

    return change


def spoilt_lines(
    text: str, by: random.Random, chosen: re.Pattern[str], pairs: tuple[tuple[str, str], ...] = ()
) -> tuple[str, str]:
    """A text with a change at random of lines that match, and what it is; always another text."""
    changes = CHANGES | ({"word": words(pairs)} if pairs else {})
    while True:
        lines = text.splitlines()
        own = [k for k, line in enumerate(lines) if chosen.search(line)]
        what = by.choice([*changes, *OFTEN, *OFTEN, *OFTEN, *(["word"] * 2 if pairs else [])])
        changes[what](lines, own, by)
        spoilt = "\n".join(lines) + "\n"
        if spoilt != text and lines != text.splitlines():
            return f"{what}: {_first_difference(text, spoilt)}", spoilt


def _first_difference(text: str, spoilt: str) -> str:
    pairs = zip([*text.splitlines(), ""], [*spoilt.splitlines(), ""], strict=False)
    old, new = next((pair for pair in pairs if pair[0] != pair[1]), ("", ""))
    return f"{old.strip()[:SHOWN]} -> {new.strip()[:SHOWN]}"
