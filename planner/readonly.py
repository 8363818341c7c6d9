"""Arrays of frozen values are read-only."""

from __future__ import annotations

import dataclasses

import numpy as np


class ReadOnlyArrays:
    """Mixin for frozen dataclasses: every array field becomes read-only, so that a value can be shared safely."""

    def __post_init__(self) -> None:
        for field in dataclasses.fields(self):  # type: ignore[arg-type]
            value = getattr(self, field.name)
            if isinstance(value, np.ndarray):
                value.setflags(write=False)
