"""Types of arrays, and arrays that are read-only: to compiled code another type than one that may be written."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Indices = NDArray[np.intp]
Flags = NDArray[np.bool_]

MAD_TO_SIGMA = 1.4826  # from the median of absolute deviations to the standard one, of a normal distribution


class ReadOnlyArrays:
    """Mixin for frozen dataclasses: every array field becomes read-only, so that a value can be shared safely."""

    def __post_init__(self) -> None:
        for value in vars(self).values():
            if isinstance(value, np.ndarray):
                value.setflags(write=False)

    def __setstate__(self, state: dict[str, Any]) -> None:
        """A copy, or a value that another process sent, is read-only as well: to compiled code that is another type."""
        vars(self).update(state)
        ReadOnlyArrays.__post_init__(self)


def read_only(values: NDArray[Any]) -> NDArray[Any]:
    """The same values in one piece of memory, read-only: what takes them, compiled, is compiled once."""
    view = np.ascontiguousarray(values).view()
    view.setflags(write=False)
    return view


def true_runs(flags: Flags) -> Indices:
    """Where each run of true flags (n) begins, and the place behind its end (k, 2)."""
    padded = np.concatenate([[False], flags, [False]])
    return np.flatnonzero(padded[1:] != padded[:-1]).reshape(-1, 2)
