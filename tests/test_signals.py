"""Interruptions: none is lost, and none leaves a traceback."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

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


# A command in which an interruption comes where it is not raised as one: as code in C does that was calling Python.
SWALLOWED = """\
import os, signal, sys, threading, time
from pathlib import Path
from types import ModuleType
from planner.base import launch
from planner.base.command_line import exit_code
from planner.base.processes import in_background
from planner.base.results import results_folder

def interrupt():
    try:
        os.kill(os.getpid(), signal.{number})
        time.sleep(30.0)
    except KeyboardInterrupt:
        pass

def work():
    with results_folder(Path("out"), "solve") as fresh:
        (fresh / "plan.json").write_text("half")
        {what}
    return 0

def command(arguments):
    try:
        return exit_code(work, lambda text: print(text, file=sys.stderr), at_once={at_once})
    finally:
        {then}

module = sys.modules["made_up"] = ModuleType("made_up")
module.main = command
launch.COMMANDS["made_up"] = launch.CommandModule("made_up", "")
launch.end(launch.launch("made_up", []))
"""


def swallowed(
    folder: Path, what: str, number: str = "SIGTERM", then: str = "pass", at_once: bool = False
) -> tuple[int, str]:
    """Exit code and standard error output of that command; its results are gone."""
    done = subprocess.run(
        [sys.executable, "-c", SWALLOWED.format(number=number, what=what, then=then, at_once=at_once)],
        cwd=folder, env={**os.environ, "PYTHONPATH": str(ROOT)}, capture_output=True, text=True, timeout=60, check=False,
    )  # fmt: skip
    assert [*folder.iterdir()] == []
    return done.returncode, done.stderr


@pytest.mark.slow(keep=2)
@pytest.mark.parametrize(
    "what",
    [
        "interrupt()",
        "interrupt(); raise TypeError('no common dtype')",
        "interrupt(); raise SystemError from SystemError()",
        "interrupt(); import made_up_package",
    ],
)
def test_an_interruption_that_was_swallowed_ends_the_command(tmp_path: Path, what: str) -> None:
    assert swallowed(tmp_path, what) == (130, "interrupted: nothing was written\n")


def test_signals_while_an_interruption_is_answered(tmp_path: Path) -> None:
    for number in ("SIGINT", "SIGTERM"):
        code, said = swallowed(
            tmp_path, "interrupt()", number, f"os.kill(os.getpid(), signal.{number}); time.sleep(9.0)"
        )
        assert (code, said) == (130, "interrupted: nothing was written\n")


def test_threads_do_not_outlast_an_interrupted_command(tmp_path: Path) -> None:
    thread = "threading.Thread(target=time.sleep, args=(50.0,)).start(); interrupt()"
    assert swallowed(tmp_path, thread) == (130, "interrupted: nothing was written\n")


@pytest.mark.slow(keep=("asleep-SIGINT", "a thread that writes-SIGTERM"))
@pytest.mark.parametrize("number", ["SIGINT", "SIGTERM"])
@pytest.mark.parametrize(
    "what",
    [
        "interrupt()",
        "sys.stderr.write('x' * 0); interrupt(); raise TypeError('never reached')",
        "threading.Thread(target=lambda: [open(fresh / str(k % 100), 'w').close() for k in range(10**9)]).start(); interrupt()",
        "in_background(time.sleep, 50.0).__enter__(); interrupt()",
    ],
    ids=["asleep", "swallowed", "a thread that writes", "a process beside"],
)
def test_an_interruption_ends_a_command_where_it_is(tmp_path: Path, what: str, number: str) -> None:
    assert swallowed(tmp_path, what, number, at_once=True) == (130, "interrupted: nothing was written\n")


def test_interruptions_that_are_held_come_later() -> None:
    script = (
        "import os, signal\n"
        "from planner.base.signals import interruptions_held, terminations_interrupt\n"
        "terminations_interrupt()\n"
        "try:\n"
        "    with interruptions_held():\n"
        "        os.kill(os.getpid(), signal.SIGTERM)\n"
        "        print('held')\n"
        "    print('never reached')\n"
        "except KeyboardInterrupt:\n"
        "    print('interrupted')\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", script], cwd=ROOT, capture_output=True, text=True, timeout=60, check=False
    )
    assert (done.returncode, done.stdout, done.stderr) == (0, "held\ninterrupted\n", "")


CLOSED = """\
import os, signal, time
from planner.base.signals import hangups_interrupt

signal.signal(signal.SIGHUP, signal.SIG_DFL)
try:
    with hangups_interrupt():
        try:
            os.kill(os.getpid(), signal.SIGHUP)
            time.sleep(30.0)
        finally:
            os.kill(os.getpid(), signal.SIGHUP)
            print("safe")
except KeyboardInterrupt:
    print("interrupted")
signal.signal(signal.SIGHUP, signal.SIG_IGN)
with hangups_interrupt():
    os.kill(os.getpid(), signal.SIGHUP)
print("not with nohup")
"""


def test_a_terminal_that_closes_interrupts_once() -> None:
    done = subprocess.run(
        [sys.executable, "-c", CLOSED], cwd=ROOT, capture_output=True, text=True, timeout=60, check=False
    )
    assert (done.returncode, done.stdout, done.stderr) == (0, "safe\ninterrupted\nnot with nohup\n", "")


def test_errors_without_an_interruption_are_told(tmp_path: Path) -> None:
    code, said = swallowed(tmp_path, "raise TypeError('no common dtype')")
    assert code == 1
    assert said.endswith("TypeError: no common dtype\n")
