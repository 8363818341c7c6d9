"""Values that are kept for an object as long as it lives."""

from __future__ import annotations

import gc
import weakref
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planner.base.kept import kept


@dataclass(frozen=True)
class Row:
    """Frozen, and without a hash: its field is an array."""

    values: NDArray[np.float64]


def test_each_object_is_worked_on_once() -> None:
    asked: list[Row] = []

    @kept
    def total(row: Row) -> float:
        """The sum of a row."""
        asked.append(row)
        return float(row.values.sum())

    one, other = Row(np.arange(3.0)), Row(np.arange(4.0))
    assert [total(one), total(other), total(one), total(other)] == [3.0, 6.0, 3.0, 6.0]
    assert [row is each for row, each in zip(asked, (one, other), strict=True)] == [True, True]
    assert total.__doc__ == "The sum of a row."


def test_an_equal_object_is_another() -> None:
    seen: list[int] = []
    count = kept(lambda row: seen.append(len(row.values)) or len(seen))  # type: ignore[func-returns-value]
    values = np.arange(3.0)
    one, other = Row(values), Row(values)
    assert (count(one), count(other), count(one)) == (1, 2, 1)


def test_what_is_kept_goes_with_its_object() -> None:
    value_of = kept(lambda row: Row(2.0 * row.values))
    one = Row(np.arange(3.0))
    value = weakref.ref(value_of(one))
    gc.collect()
    assert value() is not None
    del one
    gc.collect()
    assert value() is None
