"""Run a command that may hang, crash or eat all memory, and say in words which of these it did."""

from __future__ import annotations

import os
import signal
import subprocess
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

POLL = 0.05  # s between looks at the memory
SHOWN = 300  # characters of what a command said last
_PAGE = os.sysconf("SC_PAGE_SIZE")


@dataclass(frozen=True)
class Ended:
    """How a command ended: reason is empty if it did so by itself, without an error; peak_mb is the most it held."""

    reason: str
    peak_mb: float


def watched(command: Sequence[str], log: Path, seconds: float, megabytes: float, env: Mapping[str, str]) -> Ended:
    """Run a command with its output in `log`; it is killed after so many seconds or with more memory than that."""
    start, peak, reason = time.monotonic(), 0.0, ""
    with log.open("wb") as out:
        process = subprocess.Popen(
            command, stdout=out, stderr=out, stdin=subprocess.DEVNULL, env=dict(env), start_new_session=True
        )
        try:
            while process.poll() is None:
                peak = max(peak, _resident_mb(process.pid))
                if peak > megabytes:
                    reason = f"out of memory: more than {megabytes / 1e3:g} GB"
                elif time.monotonic() - start > seconds:
                    reason = f"out of time: more than {seconds:g} s"
                if reason:
                    break
                time.sleep(POLL)
        finally:
            if process.poll() is None:
                os.killpg(process.pid, signal.SIGKILL)
            code = process.wait()
    if not reason and code != 0:
        reason = _crash(code, log)
    return Ended(reason, peak)


def _crash(code: int, log: Path) -> str:
    """The end of what a command said that failed, or the signal that ended it."""
    lines = [line.strip() for line in log.read_text(encoding="utf-8", errors="replace").splitlines() if line.strip()]
    last = lines[-1][:SHOWN] if lines else "it said nothing"
    return f"killed by signal {-code}: {last}" if code < 0 else f"exit code {code}: {last}"


def _resident_mb(pid: int) -> float:
    """Memory that a process holds [MB]; 0 once it has ended, or where there is no /proc."""
    try:
        return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * _PAGE / 1e6
    except (OSError, IndexError):
        return 0.0
