"""Questions to processes of their own: asked when the answer is needed, and ahead."""

from __future__ import annotations

import os
import sysconfig
import time
from pathlib import Path
from typing import Any

import pytest

from planner.base import isolated
from planner.base.isolated import Killed, ask, asked_ahead
from planner.base.processes import in_background, spare_core

MODULE = "doubler"  # a module that answers questions, and writes down its process for each
SOURCE = """
import os, signal, sys, time
import numpy as np
from planner.base.isolated import answer

def doubled(question):
    with open(question["log"], "a") as log:
        log.write(f"{os.getpid()}\\n")
    if question["x"] < 0:
        os.kill(os.getpid(), signal.SIGKILL)
    time.sleep(question["x"] if question["x"] > 99 else 0)
    return {"twice": np.array(2 * question["x"])}

sys.exit(answer(doubled))
"""
LONGEST = 60.0  # s


@pytest.fixture
def log(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Where the module writes its processes down."""
    (tmp_path / f"{MODULE}.py").write_text(SOURCE, encoding="utf-8")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    return tmp_path / "log"


def processes(log: Path) -> list[int]:
    return [int(line) for line in log.read_text().split()] if log.exists() else []


def twice(log: Path, x: int) -> Any:
    found = ask(MODULE, {"x": x, "log": str(log)}, LONGEST)
    return found and found["twice"]


def test_what_is_asked_ahead_is_answered_once(log: Path) -> None:
    with asked_ahead(MODULE, {"x": 3, "log": str(log)}), asked_ahead(MODULE, {"log": str(log), "x": 3}):
        assert twice(log, 3) == 6
        assert len(processes(log)) == 1
        assert twice(log, 3) == 6  # it was fetched: asked anew
        assert twice(log, 4) == 8
    assert len(processes(log)) == 3
    assert len(set(processes(log))) == 3


@pytest.mark.skipif(not spare_core(), reason="needs a second core")
def test_a_fork_asks_anew(log: Path) -> None:
    with asked_ahead(MODULE, {"x": 3, "log": str(log)}):
        with in_background(twice, log, 3) as wait:
            assert wait() == 6
        assert twice(log, 3) == 6
    assert len(processes(log)) == 2


def test_what_nobody_asks_for_ends_with_the_block(log: Path) -> None:
    with asked_ahead(MODULE, {"x": 3600, "log": str(log)}):
        until = time.monotonic() + LONGEST
        while not processes(log) and time.monotonic() < until:
            time.sleep(0.01)
    (process,) = processes(log)
    with pytest.raises(ProcessLookupError):
        os.kill(process, 0)


def test_what_is_killed_tells_nothing(log: Path) -> None:
    with asked_ahead(MODULE, {"x": -1, "log": str(log)}), pytest.raises(Killed):
        twice(log, -1)
    with asked_ahead(MODULE, {"x": None, "log": str(log)}):  # it fails
        assert ask(MODULE, {"x": None, "log": str(log)}, LONGEST) is None


def test_the_folder_of_installed_packages_is_not_put_before_python_s_own_modules(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv("PYTHONPATH", "/mine")
    monkeypatch.setattr(isolated, "_ROOT", Path("/clone"))
    assert isolated._environment()["PYTHONPATH"] == f"/clone{os.pathsep}/mine"
    monkeypatch.setattr(isolated, "_ROOT", Path(sysconfig.get_path("purelib")).resolve())
    assert isolated._environment()["PYTHONPATH"] == "/mine"


def test_files_of_the_present_folder_are_no_modules(log: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("PYTHONPATH")
    monkeypatch.chdir(log.parent)
    assert ask(MODULE, {"x": 1, "log": str(log)}, LONGEST) is None
