"""Printing where a terminal or a pipe does not take it: the command's verdict and files stay what they are."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
LIST = [sys.executable, "-m", "planner.solve", "--list"]


def environment(**more: str) -> dict[str, str]:
    return {**os.environ, "PYTHONPATH": str(ROOT), **more}


@pytest.mark.parametrize("unbuffered", ["", "1"])
def test_letters_that_an_encoding_lacks_become_question_marks(unbuffered: str) -> None:
    script = "from planner.base.terminal import forgive_output; forgive_output(); print('within ±2 %, Σ, 层')"
    for encoding, printed in {"ascii": "within ?2 %, ?, ?", "latin-1": "within ±2 %, ?, ?"}.items():
        done = subprocess.run(
            [sys.executable, "-c", script],
            env=environment(PYTHONIOENCODING=encoding, PYTHONUNBUFFERED=unbuffered),
            capture_output=True,
            check=True,
        )
        assert done.stdout.decode(encoding).strip() == printed


@pytest.mark.slow
@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full here")
@pytest.mark.parametrize("unbuffered", ["", "1"])
def test_a_full_disk_is_said_and_changes_no_exit_code(unbuffered: str) -> None:
    with Path("/dev/full").open("w") as full:
        done = subprocess.run(
            LIST,
            env=environment(PYTHONUNBUFFERED=unbuffered),
            stdout=full,
            stderr=subprocess.PIPE,
            text=True,
            check=False,
        )
    assert done.returncode == 0
    assert done.stderr.strip() == "warning: what follows could not be printed: No space left on device"
    with Path("/dev/full").open("w") as full:  # nobody is left to be told
        done = subprocess.run(
            [*LIST[:-1], "nowhere.yaml"], env=environment(), stdout=subprocess.PIPE, stderr=full, text=True, check=False
        )
    assert done.returncode == 2 and done.stdout == ""


@pytest.mark.slow
@pytest.mark.parametrize("unbuffered", ["", "1"])
def test_a_pipe_whose_reader_has_gone_is_no_failure(unbuffered: str) -> None:
    reader, writer = os.pipe()
    os.close(reader)
    done = subprocess.run(
        LIST,
        env=environment(PYTHONUNBUFFERED=unbuffered),
        stdout=writer,
        stderr=subprocess.PIPE,
        text=True,
        check=False,
    )
    os.close(writer)
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.slow
def test_closed_streams_are_no_failure() -> None:
    script = "import sys; from planner.base.launch import launch; sys.exit(launch('solve', ['--list']))"
    for closed in (">&-", "2>&-", ">&- 2>&-"):
        done = subprocess.run(
            f'"{sys.executable}" -c "{script}" {closed}',
            shell=True,
            env=environment(),
            capture_output=True,
            check=False,
        )
        assert done.returncode == 0
