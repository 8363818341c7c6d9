"""A module in its own process, watched: its time limit, the memory of all its processes, and how it ends.

The process leads a group, so everything it starts ends with it. It ends when its watcher is gone, because its input
then ends (`end_with_parent`).
"""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from benchmarks.memory import children_of, held_mb
from benchmarks.usage import ROOT

_WATCHED = 0.25  # s between looks at the memory
_LAST = 300  # characters of what it said at last


@dataclass(frozen=True)
class Ended:
    """How a process ended: the text that it left, or why there is none; and the most memory that was seen [MB],
    its children's as well; 0 where it had none, for then it knows better itself."""

    text: str
    reason: str
    peak_mb: float


def in_own_process(module: str, arguments: Sequence[str], limit: float | None = None) -> Ended:
    """Run `python -m module FILE arguments…`, which writes a text into FILE; end it after `limit` seconds."""
    with tempfile.TemporaryDirectory() as folder:
        result, said = Path(folder) / "result", Path(folder) / "said"
        paths = [str(ROOT), *filter(None, [os.environ.get("PYTHONPATH")])]
        environment = {**os.environ, "PYTHONPATH": os.pathsep.join(paths)}
        with said.open("wb") as output:
            process = subprocess.Popen(
                [sys.executable, "-m", module, str(result), *arguments],
                stdin=subprocess.PIPE, stdout=output, stderr=subprocess.STDOUT, env=environment, start_new_session=True,
            )  # fmt: skip
            try:
                in_time, peak = _watch(process, limit)
            finally:
                _end(process)
        if not in_time:
            return Ended("", f"longer than {limit:g} s", peak)
        if process.returncode or not result.is_file():
            return Ended("", _words(process.returncode, said.read_text(encoding="utf-8", errors="replace")), peak)
        return Ended(result.read_text(encoding="utf-8"), "", peak)


def _watch(process: subprocess.Popen[bytes], limit: float | None) -> tuple[bool, float]:
    """Wait for a process: whether it ended in time, and the most memory seen of it and its children [MB]."""
    until, peak = time.monotonic() + (limit or float("inf")), 0.0
    while process.poll() is None:
        if time.monotonic() > until:
            return False, peak
        peak = max(peak, held_mb(process.pid) if children_of(process.pid) else 0.0)
        try:
            process.wait(min(_WATCHED, max(until - time.monotonic(), 0.0)))
        except subprocess.TimeoutExpired:
            continue
    return True, peak


def _end(process: subprocess.Popen[bytes]) -> None:
    """End whatever is left of a process and of what it started."""
    with contextlib.suppress(ProcessLookupError, PermissionError):  # all gone; macOS says the latter of what has ended
        os.killpg(process.pid, signal.SIGKILL)
    process.wait()
    if process.stdin is not None:
        process.stdin.close()


def _words(code: int, said: str) -> str:
    """Why there is no result."""
    if code == -signal.SIGKILL:
        return "killed (signal 9), probably for want of memory"
    last = " ".join(said.split())[-_LAST:]
    how = f"killed (signal {-code})" if code < 0 else f"ended with exit code {code}"
    return f"crashed: {how}" + (f": {last}" if last else "")


def end_with_parent() -> None:
    """From here on this process and what it starts end when the process that started it does."""
    threading.Thread(target=_wait_for_the_end, daemon=True).start()


def _wait_for_the_end() -> None:
    os.read(sys.stdin.fileno(), 1)  # nothing is ever written: it returns at the end; sys.stdin's lock would outlast us
    os.killpg(os.getpgrp(), signal.SIGKILL)
