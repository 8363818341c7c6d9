"""The page of messages quotes messages that there are, fields and options that there are, checks that there are."""

from __future__ import annotations

import re
from functools import cache
from pathlib import Path

import pytest

from benchmarks.reference.fields import sections
from planner.base.completion import parsers
from planner.plan.measures import CHECKS
from planner.problem.fields import described

ROOT = Path(__file__).resolve().parents[1]
PAGE = (ROOT / "docs" / "troubleshooting.md").read_text(encoding="utf-8")
HEADINGS = re.findall(r"^### (.+)$", PAGE, re.MULTILINE)
FIELD = re.compile(r"`((?:cell|part|layers|process|resolve|collision|program)(?:\.[a-z_]+)+)\b")


@cache
def sources() -> str:
    """All sources, texts in pieces put together."""
    text = "\n".join(path.read_text(encoding="utf-8") for path in sorted((ROOT / "planner").rglob("*.py")))
    return re.sub(r'"\s*\n\s*f?"', "", text)


def parts(heading: str) -> list[str]:
    """What of a message is always the same."""
    return [part.strip() for part in heading.split("…") if part.strip()]


def test_there_are_enough_and_none_twice() -> None:
    assert len(HEADINGS) >= 40
    assert len(set(HEADINGS)) == len(HEADINGS)


@pytest.mark.parametrize("heading", HEADINGS)
def test_the_message_is_one_of_ours(heading: str) -> None:
    assert parts(heading)
    for part in parts(heading):
        assert part in sources() or part in CHECKS or f"joint {part.split()[-1]}" in CHECKS, part


def test_checks_have_their_own_chapter() -> None:
    chapter = PAGE.split("## Not verified")[1].split("\n## ")[0]
    for name in re.findall(r"^### (.+)$", chapter, re.MULTILINE):
        assert name in CHECKS


def test_fields_and_options_are_there() -> None:
    known = set()
    for model, places in sections():
        for place in places:
            for one in described(model).values():
                known.add(re.sub(r"\.NAME|\[\]", "", f"{place}.{one.key}" if place else one.key))
    fields = set(FIELD.findall(PAGE))
    assert len(fields) > 25
    assert fields <= known
    options = {name for each in parsers() for action in each._actions for name in action.option_strings}
    assert set(re.findall(r"`(--[a-z-]+)", PAGE)) <= options
