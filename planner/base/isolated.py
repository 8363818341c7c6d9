"""Questions to a process of its own: what answers them may end at any place, without a word, as readers of damaged files do.

A question is JSON on standard input, its answer arrays as NPZ on standard output. The one who asks calls `ask`, the module
that is asked ends with `sys.exit(answer(function))`.
"""

from __future__ import annotations

import io
import json
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from planner.base.signals import end_with_parent

_ROOT = Path(__file__).resolve().parents[2]  # from where modules are found, whatever the present folder


class Killed(Exception):
    """The process that was asked was ended from outside, which tells nothing about what it was asked."""

    def __init__(self) -> None:
        super().__init__("what reads it was ended by the system, as where there is no memory left")


def ask(module: str, question: Mapping[str, Any], longest: float) -> dict[str, Any] | None:
    """What a module answers to a question, as arrays by their names; None where its process ends without an answer.

    Raises subprocess.TimeoutExpired after `longest` [s], and Killed. The process ends with this one, however that ends.
    """
    paths = os.pathsep.join([str(_ROOT), *filter(None, [os.environ.get("PYTHONPATH")])])
    done = subprocess.run(
        [sys.executable, "-m", module],
        input=json.dumps({**question, "parent": os.getpid()}).encode(),
        capture_output=True,
        timeout=longest,
        env={**os.environ, "PYTHONPATH": paths},
        check=False,
    )
    if done.returncode < 0 and -done.returncode == signal.SIGKILL:
        raise Killed
    if done.returncode != 0:
        return None
    with np.load(io.BytesIO(done.stdout), allow_pickle=False) as arrays:
        return dict(arrays)


def answer(function: Callable[[dict[str, Any]], Mapping[str, Any]]) -> int:
    """Answer the question on standard input by a function of it; returns the exit code."""
    question = json.load(sys.stdin)
    end_with_parent(question.pop("parent"))
    out = io.BytesIO()
    np.savez(out, **function(question))
    sys.stdout.buffer.write(out.getvalue())
    return 0
