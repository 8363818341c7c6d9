"""Compiled kernels are used again only as long as nothing has changed that they are made of."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

CALLEE = """
from planner.base.compiled import njit
from constants import STEP

@njit(cache=True)
def inner(x):
    return {0} * x + STEP
"""
CALLER = """
from planner.base.compiled import njit
from callee import inner

@njit(cache=True)
def outer(x):
    return inner(x)
"""
RUN = """
import caller
print(caller.outer(2.0), sum(caller.outer.stats.cache_hits.values()))
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for name, text in (("callee", CALLEE.format(1.0)), ("caller", CALLER), ("constants", "STEP = 0.5"), ("run", RUN)):
        (tmp_path / f"{name}.py").write_text(text)
    return tmp_path


def run(folder: Path) -> tuple[float, int]:
    """What the caller's kernel returns, and how often its code came from the cache."""
    value, hits = subprocess.run(
        [sys.executable, "run.py"], cwd=folder, capture_output=True, text=True, check=True
    ).stdout.split()
    return float(value), int(hits)


@pytest.mark.slow
def test_code_is_compiled_anew_after_a_change_in_another_file(folder: Path) -> None:
    assert run(folder) == (2.5, 0)
    assert run(folder) == (2.5, 1)
    (folder / "callee.py").write_text(CALLEE.format(3.0))
    assert run(folder) == (6.5, 0)
    assert run(folder) == (6.5, 1)
    (folder / "constants.py").write_text("STEP = 0.25")
    assert run(folder) == (6.25, 0)
    (folder / "caller.py").touch()  # its content is the same
    assert run(folder) == (6.25, 1)
