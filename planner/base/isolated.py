"""Questions to a separate process, which may die at any point without a message, as readers of damaged files do.

A question is JSON on standard input, its answer arrays as NPZ on standard output. The caller uses `ask`; the module
that answers ends with `sys.exit(answer(function))`. Slow questions can be asked ahead: `asked_ahead`.
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

_ROOT = Path(__file__).resolve().parents[2]  # where modules are found, whatever the working directory


class Killed(Exception):
    """The process that was asked was ended from outside, which says nothing about the question."""

    def __init__(self) -> None:
        super().__init__("the system killed the process that read it, as when memory runs out")


class _Begun(NamedTuple):
    """A process that answers a question, and the process id of the one that asks."""

    process: subprocess.Popen[bytes]
    asks: int


# Questions asked ahead whose answers are not fetched yet. A fork of this process has a copy, but asks again: only one
# of them can fetch an answer.
_ahead: dict[str, _Begun] = {}


def ask(module: str, question: Mapping[str, Any], longest: float) -> dict[str, Any] | None:
    """A module's answer to a question, as arrays by name; None if its process ends without an answer.

    Raises subprocess.TimeoutExpired after `longest` [s], and Killed. The process ends with this one, however that ends.
    """
    key = _key(module, question)
    ours = key in _ahead and _ahead[key].asks == os.getpid()
    with _ahead.pop(key).process if ours else _begin(module, question) as process:
        try:
            found, _ = process.communicate(timeout=longest)
        finally:
            process.kill()  # no effect if it has ended
    if process.returncode == -signal.SIGKILL:
        raise Killed
    if process.returncode != 0:
        return None
    with np.load(io.BytesIO(found), allow_pickle=False) as arrays:
        return dict(arrays)


@contextmanager
def asked_ahead(module: str, question: Mapping[str, Any]) -> Iterator[None]:
    """Have a question answered alongside the block, so that the first to ask it there gets the answer sooner."""
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
    """Start a process that answers a question."""
    with TemporaryFile() as asked:
        asked.write(json.dumps({**question, "parent": os.getpid()}).encode())
        asked.seek(0)
        return subprocess.Popen(
            [sys.executable, "-P", "-m", module],  # -P: no modules from the working directory
            stdin=asked,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            env=_environment(),
        )


def _environment() -> dict[str, str]:
    """Environment in which a process finds this package.

    Where Python finds it anyway, its folder is not named: it would come before Python's own modules, and outdated
    versions of some (`pathlib`, `typing`) can be installed next to it.
    """
    given = dict(os.environ)
    if Path(sysconfig.get_path("purelib")).resolve() == _ROOT:
        return given
    paths = os.pathsep.join([str(_ROOT), *filter(None, [given.get("PYTHONPATH")])])
    return {**given, "PYTHONPATH": paths}


def answer(function: Callable[[dict[str, Any]], Mapping[str, Any]]) -> int:
    """Answer the question on standard input with `function`; returns the exit code."""
    question = json.load(sys.stdin)
    end_with_parent(question.pop("parent"))
    out = io.BytesIO()
    np.savez(out, **function(question))
    sys.stdout.buffer.write(out.getvalue())
    return 0
