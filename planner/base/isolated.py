"""Questions to a process of its own: what answers them may end at any place, without a word, as readers of damaged files do.

A question is JSON on standard input, its answer arrays as NPZ on standard output. The one who asks calls `ask`, the module
that is asked ends with `sys.exit(answer(function))`. What is long to answer can be asked ahead: `asked_ahead`.
"""

from __future__ import annotations

import io
import json
import os
import signal
import subprocess
import sys
import sysconfig
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryFile
from typing import Any, NamedTuple

import numpy as np

from planner.base.signals import end_with_parent

_ROOT = Path(__file__).resolve().parents[2]  # from where modules are found, whatever the present folder


class Killed(Exception):
    """The process that was asked was ended from outside, which tells nothing about what it was asked."""

    def __init__(self) -> None:
        super().__init__("what reads it was ended by the system, as where there is no memory left")


class _Begun(NamedTuple):
    """A process that answers a question, and the one that asks."""

    process: subprocess.Popen[bytes]
    asks: int


# What is asked ahead and not fetched yet. A fork of this process has a copy, and asks anew: one of them alone can fetch it.
_ahead: dict[str, _Begun] = {}


def ask(module: str, question: Mapping[str, Any], longest: float) -> dict[str, Any] | None:
    """What a module answers to a question, as arrays by their names; None where its process ends without an answer.

    Raises subprocess.TimeoutExpired after `longest` [s], and Killed. The process ends with this one, however that ends.
    """
    key = _key(module, question)
    ours = key in _ahead and _ahead[key].asks == os.getpid()
    with _ahead.pop(key).process if ours else _begin(module, question) as process:
        try:
            found, _ = process.communicate(timeout=longest)
        finally:
            process.kill()  # of one that has ended, nothing
    if process.returncode == -signal.SIGKILL:
        raise Killed
    if process.returncode != 0:
        return None
    with np.load(io.BytesIO(found), allow_pickle=False) as arrays:
        return dict(arrays)


@contextmanager
def asked_ahead(module: str, question: Mapping[str, Any]) -> Iterator[None]:
    """Have a question answered beside the block: the first that asks it there has the answer the sooner."""
    key = _key(module, question)
    if key in _ahead:
        yield
        return
    begun = _ahead[key] = _Begun(_begin(module, question), os.getpid())
    try:
        yield
    finally:
        if _ahead.get(key) is begun:
            del _ahead[key]
            with begun.process:
                begun.process.kill()


def _key(module: str, question: Mapping[str, Any]) -> str:
    return json.dumps([module, question], sort_keys=True)


def _begin(module: str, question: Mapping[str, Any]) -> subprocess.Popen[bytes]:
    """A process that was asked a question."""
    with TemporaryFile() as asked:
        asked.write(json.dumps({**question, "parent": os.getpid()}).encode())
        asked.seek(0)
        return subprocess.Popen(
            [sys.executable, "-P", "-m", module],  # -P: files of the present folder are no modules
            stdin=asked,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            env=_environment(),
        )


def _environment() -> dict[str, str]:
    """What a process needs to find this package. Where Python finds it anyway its folder is not named: named, it would
    stand before Python's own modules, of which some (`pathlib`, `typing`) can be installed in an old form beside it."""
    given = dict(os.environ)
    if Path(sysconfig.get_path("purelib")).resolve() == _ROOT:
        return given
    paths = os.pathsep.join([str(_ROOT), *filter(None, [given.get("PYTHONPATH")])])
    return {**given, "PYTHONPATH": paths}


def answer(function: Callable[[dict[str, Any]], Mapping[str, Any]]) -> int:
    """Answer the question on standard input by a function of it; returns the exit code."""
    question = json.load(sys.stdin)
    end_with_parent(question.pop("parent"))
    out = io.BytesIO()
    np.savez(out, **function(question))
    sys.stdout.buffer.write(out.getvalue())
    return 0
