"""Changes of a problem from Python: dictionaries and keywords, what they make, and what is said of wrong ones."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from solved import write_small

from planner import load
from planner.base.errors import InputError
from planner.problem import load_problem
from planner.problem.overrides import overrides_of, parse_override
from planner.problem.rewrite import absolute_overrides, paths_in

TEXTS = st.text(st.characters(exclude_categories=["Cs", "Cc"]), max_size=12)
VALUES = st.recursive(
    st.none() | st.booleans() | st.integers(-(10**9), 10**9) | st.floats(allow_nan=False) | TEXTS,
    lambda inner: st.lists(inner, max_size=3).map(tuple) | st.dictionaries(TEXTS.filter(bool), inner, max_size=3),
    max_leaves=6,
)


def test_texts_dictionaries_and_keywords_do_the_same() -> None:
    one = load("cylinder_logo", "layers.count=1", "process.speed_mm_s=30.0")
    for other in (
        load("cylinder_logo", {"layers.count": 1, "process.speed_mm_s": 30.0}),
        load("cylinder_logo", layers__count=1, process__speed_mm_s=30.0),
        load("cylinder_logo", "layers.count=1", {"process.speed_mm_s": 30.0}),
        load(load("cylinder_logo", layers__count=1), process__speed_mm_s=np.float64(30.0)),
    ):
        assert other.model_dump() == one.model_dump() and other.overrides == one.overrides


def test_later_ones_win_and_a_section_is_replaced_whole() -> None:
    assert load("cylinder_logo", {"layers.count": 1}, layers__count=2).layers.count == 2  # type: ignore[union-attr]
    with pytest.raises(InputError) as error:
        load("cylinder_logo", {"layers": {"count": 1}})
    assert "is missing" in str(error.value)


@given(VALUES)
def test_what_is_told_of_a_value_reads_as_that_value(value: object) -> None:
    """So that the command in a report, or another process, plans the same print."""
    (one,) = overrides_of([{"a.b": value}], {})
    assert parse_override(one.words).value == one.value and parse_override(one.words).path == ("a", "b")


def test_arrays_are_lists_and_a_path_counts_from_this_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    problem = load("peer_cap", {"cell.nozzle.tip_mm": np.array([0.0, 0.0, 120.0])})
    assert problem.cell.nozzle.tip == (0.0, 0.0, 0.12)
    monkeypatch.chdir(tmp_path)
    here, beside = (
        load("peer_cap", {"layers.source.waypoints": kind("mine.txt")}).layers.source for kind in (Path, str)
    )
    assert here.waypoints == tmp_path / "mine.txt" != beside.waypoints  # type: ignore[union-attr]


@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        ({"layers.cuont": 1}, "overrides['layers.cuont']: unknown key (did you mean count?"),
        ({"layers.count": "two"}, "overrides['layers.count']: must be a number, not the text 'two'"),
        ({"layers.count": float("nan")}, "overrides['layers.count']: must be a finite number"),
        ({"layers.count": 1.5}, "overrides['layers.count']: must be a whole number"),
        ({"layers.count": object()}, "overrides['layers.count']: is of type object (a number, text, list"),
        ({"process.bead.width_mm": [1, {2}]}, "overrides['process.bead.width_mm'][1]: is of type set"),
        ({"cell.nozzle": {1: 2}}, "overrides['cell.nozzle']: a key must be a name, not of type int"),
        ({"layers..count": 1}, "overrides['layers..count']: a key is names joined by dots"),
        ({3: 1}, "overrides[3]: a key is names joined by dots"),
        ({"name.of.it": 1}, "overrides['name.of.it']: `of` would go below the text 'cylinder_logo'"),
        (7, "overrides, number 0: must be a text or a dictionary, not of type int"),
        ("layers.count", "--set layers.count: is not of the form"),
    ],
)
def test_wrong_ones_are_said(overrides: object, message: str) -> None:
    with pytest.raises(InputError) as error:
        load("cylinder_logo", overrides)  # type: ignore[arg-type]
    assert message in str(error.value)


def test_a_wrong_keyword_is_said() -> None:
    with pytest.raises(InputError, match="layers__cuont: unknown key"):
        load("cylinder_logo", layers__cuont=1)


def test_a_problem_keeps_its_changes_when_it_is_changed_again(tmp_path: Path) -> None:
    problem = load(write_small(tmp_path), resolve__rung_mm=12.0)
    assert load(problem, strategy="greedy").overrides == ("resolve.rung_mm=12.0", "strategy=greedy")


@pytest.mark.parametrize("own", ["layers.source.svg=other.svg", "layers.source={svg: other.svg, width_mm: 30}"])
def test_changes_with_paths_say_the_same_beside_a_file_in_another_folder(own: str, tmp_path: Path) -> None:
    problem = load_problem(write_small(tmp_path / "here"), [own, "layers.count=1"])
    moved = absolute_overrides(problem)
    assert moved[1] == problem.sources.overrides[1]
    there = write_small(tmp_path / "there")
    for changes in (moved, [each.words for each in moved]):
        paths = dict(paths_in(load_problem(there, changes)))
        assert paths["layers", "source", "svg"] == (tmp_path / "here" / "other.svg").resolve()
