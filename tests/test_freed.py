"""Memory that is given back to the system."""

from __future__ import annotations

import os
import platform
from pathlib import Path

import numpy as np
import pytest

from planner.base.freed import give_back

MEGABYTE = 1e6
BLOCK = 12_000  # numbers: too few for memory of their own, which would be given back at once


def _held() -> float:
    """Memory of this process [MB]."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / MEGABYTE


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="only glibc keeps what was freed")
def test_what_lies_freed_between_what_is_in_use_is_given_back() -> None:
    blocks = [np.ones(BLOCK) for _ in range(2000)]
    kept = blocks[::10]
    full = _held()
    del blocks
    give_back()
    assert full - _held() > 0.5 * 1800 * BLOCK * 8 / MEGABYTE
    assert all(each[0] == each[-1] == 1.0 for each in kept)


def test_elsewhere_nothing_is_done(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.platform", "win32")
    give_back()
