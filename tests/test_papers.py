"""The pages of the papers: what they name exists, and the problems have the papers' figures, or a reason why not."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from benchmarks.papers import PAPERS, PaperFigure, Rebuilt, is_same, main
from planner.plan.measures import CHECKS
from planner.resolve.strategies import STRATEGIES

PAGES = Path(__file__).parent.parent / "docs" / "papers"
SCHEMA = json.loads((PAGES.parent / "problem.schema.json").read_text(encoding="utf-8"))
NAMED = re.compile(r"`([^`]+)`")
KEY = re.compile(r"[a-z_]+(?:\.[a-z_]+)*")


def words_of(schema: object) -> set[str]:
    """All keys of a problem file, and what stands in some of them."""
    if isinstance(schema, list):
        return set().union(*map(words_of, schema)) if schema else set()
    if not isinstance(schema, dict):
        return set()
    own = set(schema.get("properties", {})) | {each for each in schema.get("enum", []) if isinstance(each, str)}
    own |= {schema["const"]} if isinstance(schema.get("const"), str) else set()
    return own.union(*map(words_of, schema.values()))


@pytest.mark.parametrize("paper", list(PAPERS))
def test_what_a_page_names_exists(paper: str) -> None:
    known = words_of(SCHEMA) | set(CHECKS) | set(STRATEGIES) | {"cell", "part", "layers", "process", "program", "fine"}
    text = (PAGES / f"{paper}.md").read_text(encoding="utf-8")
    for name in NAMED.findall(text):
        if name.startswith((".venv/", "beadwise ")):
            continue  # commands are tested with those of all pages
        key, _, value = name.partition(": ")
        if name in known:
            continue
        assert KEY.fullmatch(key), name
        assert set(key.split(".")) <= known, name
        assert not value or value in known or re.fullmatch(r"\[\]|[\d.]+", value), name


@pytest.mark.slow(keep=1)
@pytest.mark.parametrize("paper", list(PAPERS))
def test_problems_have_the_papers_figures_or_a_reason(paper: str) -> None:
    for figure in PAPERS[paper]():
        if "beads" in figure.what:
            continue  # of built toolpaths: below
        found = figure.here(Rebuilt(figure.problem))
        assert figure.holds(found), f"{figure.problem}: {figure.what}: {found}"
        assert not (figure.differs and is_same(figure.paper, found)), f"{figure.problem}: {figure.what} is the same"


@pytest.mark.slow
def test_the_command_tells_every_figure(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--paper", "onstein"]) == 0
    told = capsys.readouterr().out
    assert "DIFFERS" not in told
    assert all(figure.problem in told for figure in PAPERS["onstein"]())


def test_a_figure_that_differs_without_a_reason_is_told(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(PAPERS, "onstein", lambda: (PaperFigure("shoehorn", "arm", "irb2600", "cell.arm"),))
    assert main(["--paper", "onstein"]) == 3
    assert "DIFFERS" in capsys.readouterr().out
