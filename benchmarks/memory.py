"""Peak memory of a process and all the processes it started, shared pages counted once."""

from __future__ import annotations

import os
import threading
from contextlib import suppress
from pathlib import Path
from types import TracebackType

from benchmarks.usage import MEGABYTE, peak_mb

_EVERY = 0.25  # s between two looks: a large print holds what it holds for longer
_KILOBYTE = 1024


def held_mb(pid: int) -> float:
    """Memory of a process and of all its descendants [MB]; pages that processes share count once. 0 where Linux does not
    tell it."""
    total = 0.0
    with suppress(OSError):  # it may have ended
        text = Path(f"/proc/{pid}/smaps_rollup").read_text(encoding="ascii")
        total = sum(int(line.split()[1]) for line in text.splitlines() if line.startswith("Pss:")) * _KILOBYTE
    total /= MEGABYTE
    return total + sum(held_mb(child) for child in children_of(pid))


def children_of(pid: int) -> list[int]:
    """The processes that a process started; none where it has ended, or Linux does not tell it."""
    found: list[int] = []
    with suppress(OSError):
        for task in Path(f"/proc/{pid}/task").iterdir():
            found += map(int, (task / "children").read_text(encoding="ascii").split())
    return found


class Peak:
    """Watches this process and its descendants during a block; `mb` is the most that they held together [MB].

    Where Linux does not tell it, the most that one of them held.
    """

    def __init__(self) -> None:
        self.mb = 0.0
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._watch, daemon=True)

    def __enter__(self) -> Peak:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._ended.set()
        self._thread.join()
        self.mb = max(self.mb, held_mb(os.getpid())) or peak_mb()

    def _watch(self) -> None:
        while not self._ended.wait(_EVERY):
            self.mb = max(self.mb, held_mb(os.getpid()))
