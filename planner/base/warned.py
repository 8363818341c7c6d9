"""What becomes of warnings in a block: they are errors, or passed over."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from threading import RLock
from typing import Literal

_ONE = RLock()


@contextmanager
def warnings_are(what: Literal["error", "ignore"], kind: type[Warning] = Warning) -> Iterator[None]:
    """In the block warnings of a kind are errors, or passed over; one block at a time: what becomes of warnings is the same
    for all threads, and blocks that overlap would leave it so for good."""
    with _ONE, warnings.catch_warnings():
        warnings.simplefilter(what, kind)
        yield
