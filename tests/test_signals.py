"""Interruptions: none is lost, and none leaves a traceback."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent

INTERRUPTED = """\
import os, signal, time
from planner.base.signals import terminations_interrupt

class Closing:
    def __del__(self):
        os.kill(os.getpid(), signal.{number})
        time.sleep(0.01)

class HalfClosed:
    def __del__(self):
        raise AttributeError("half closed")

terminations_interrupt()
try:
    closing = Closing()
    del closing
    time.sleep(30.0)
except KeyboardInterrupt:
    half_closed = HalfClosed()
    del half_closed
    print("interrupted")
"""


def test_an_interruption_in_a_finalizer_comes_again_and_leaves_no_traceback() -> None:
    for number in ("SIGINT", "SIGTERM"):
        done = subprocess.run(
            [sys.executable, "-c", INTERRUPTED.format(number=number)],
            cwd=ROOT, capture_output=True, text=True, timeout=60, check=False,
        )  # fmt: skip
        assert (done.returncode, done.stdout, done.stderr) == (0, "interrupted\n", "")
