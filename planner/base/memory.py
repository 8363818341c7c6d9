"""How much memory this process may use, as the machine, its container and its own limits say."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from pathlib import Path

# of containers, version 2 and 1: a number of bytes, or a word where there is no limit
_CONTAINER = (Path("/sys/fs/cgroup/memory.max"), Path("/sys/fs/cgroup/memory/memory.limit_in_bytes"))


def memory() -> float:
    """The least of what the machine has, its container may use and the process may ask for [bytes]; infinite where nobody
    tells."""
    return min(_limits(), default=float("inf"))


def _limits() -> Iterator[float]:
    if hasattr(os, "sysconf") and "SC_PHYS_PAGES" in os.sysconf_names:
        yield float(os.sysconf("SC_PAGE_SIZE")) * os.sysconf("SC_PHYS_PAGES")
    for path in _CONTAINER:
        try:
            text = path.read_text(encoding="ascii").strip()
        except OSError:
            continue
        if text.isdigit():
            yield float(text)
    if sys.platform != "win32":
        import resource

        soft, _ = resource.getrlimit(resource.RLIMIT_DATA)
        if soft != resource.RLIM_INFINITY:
            yield float(soft)
