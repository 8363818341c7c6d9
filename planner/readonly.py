"""Arrays of frozen values are read-only."""

from __future__ import annotations

import numpy as np


class ReadOnlyArrays:
    """Mixin for frozen dataclasses: every array field becomes read-only, so that a value can be shared safely."""

    def __post_init__(self) -> None:
        for value in vars(self).values():
            if isinstance(value, np.ndarray):
                value.setflags(write=False)
