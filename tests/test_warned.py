"""What becomes of warnings in blocks of several threads."""

from __future__ import annotations

import warnings
from concurrent.futures import ThreadPoolExecutor

import pytest

from planner.base.warned import warnings_are


def test_blocks_of_two_threads_follow_each_other_and_leave_all_as_it_was() -> None:
    before = list(warnings.filters)

    def other() -> None:
        with warnings_are("ignore"):
            warnings.warn("nobody hears", stacklevel=1)

    with ThreadPoolExecutor(1) as pool:
        with warnings_are("error", UserWarning):
            waiting = pool.submit(other)
            with pytest.raises(TimeoutError):
                waiting.result(timeout=0.05)
            with pytest.raises(UserWarning, match="an error here"):
                warnings.warn("an error here", stacklevel=1)
        waiting.result(timeout=60.0)
    assert list(warnings.filters) == before
