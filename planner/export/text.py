"""Shared by all languages: numbers and comments for writers, messages for checks."""

from __future__ import annotations

import re
from collections.abc import Iterable
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from planner.export.moves import Wait

LONGEST_COMMENT = 100


def number(value: float, decimals: int) -> str:
    """Fixed-point number, never minus zero."""
    text = f"{value:.{decimals}f}"
    return text[1:] if text.startswith("-") and not text.strip("-0.") else text


def ascii_comment(mark: str, text: str, indent: int = 0, longest: int = LONGEST_COMMENT) -> str:
    """One comment line in ASCII, with at most `longest` characters after its mark."""
    text = re.sub(r"[^\x20-\x7e]", "?", text)
    return f"{'':{indent}}{mark} {text[:longest].rstrip()}"


def resting(waits: Iterable[Wait], mark: str, statement: str, indent: int) -> list[str]:
    """Lines that wait, each with a comment that says why; `statement` is a format for the seconds."""
    lines = []
    for wait in waits:
        lines += [ascii_comment(mark, wait.why, indent)] if wait.why else []
        lines += [f"{'':{indent}}{statement.format(wait.time)}"] if wait.time > 0.0 else []
    return lines


def in_waits(total: float, longest: float, tick: float) -> list[float]:
    """Times [s] of successive waits that add up to `total`, none longer than the `longest` that a controller accepts,
    nor shorter than half of the `tick` that it counts in."""
    whole = int(total // longest)
    return [wait for wait in (*[longest] * whole, total - whole * longest) if wait >= 0.5 * tick]


def beyond(found: Iterable[tuple[str, float, float]]) -> list[str]:
    """Messages for differences (format for the value, value, limit) that exceed their limits or are NaN."""
    return [f"{words.format(value)} (limit {limit:.3g})" for words, value, limit in found if not value <= limit]
