"""Array types, and read-only arrays, which for compiled code are of another type than writable ones."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Indices = NDArray[np.intp]
Flags = NDArray[np.bool_]

MAD_TO_SIGMA = 1.4826  # × the median absolute deviation: the standard deviation of a normal distribution


class ReadOnlyArrays:
    """Mixin for frozen dataclasses: every array field becomes read-only, so that a value can be shared safely."""

    def __post_init__(self) -> None:
        for value in vars(self).values():
            if isinstance(value, np.ndarray):
                value.setflags(write=False)

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Copies, and values from another process, are read-only, too: compiled code treats that as another type."""
        vars(self).update(state)
        ReadOnlyArrays.__post_init__(self)


def read_only(values: NDArray[Any]) -> NDArray[Any]:
    """The same values, contiguous and read-only, so that kernels that take them are compiled only once."""
    view = np.ascontiguousarray(values).view()
    view.setflags(write=False)
    return view


def true_runs(flags: Flags) -> Indices:
    """For each run of true flags (n), its first index and the index after its last (k, 2)."""
    padded = np.concatenate([[False], flags, [False]])
    return np.flatnonzero(padded[1:] != padded[:-1]).reshape(-1, 2)
