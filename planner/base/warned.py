"""Warnings in a block: turned into errors, or ignored."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from threading import RLock
from typing import Literal

_ONE = RLock()


@contextmanager
def warnings_are(what: Literal["error", "ignore"], kind: type[Warning] = Warning) -> Iterator[None]:
    """In the block, raise warnings of a kind as errors, or ignore them; one block at a time.

    Warning filters are shared by all threads, and overlapping blocks would leave them changed for good.
    """
    with _ONE, warnings.catch_warnings():
        warnings.simplefilter(what, kind)
        yield
