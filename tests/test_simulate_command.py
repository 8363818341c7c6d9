"""The command of the simulators."""

from __future__ import annotations

import os
import re
import signal
import socket
import subprocess
import sys
from pathlib import Path

import pytest

from planner.simulate.command import main, simulate_command

ROOT = Path(__file__).resolve().parents[1]


@pytest.mark.slow
def test_a_simulator_runs_until_it_is_interrupted() -> None:
    command = [sys.executable, "-m", "planner.simulate", "board", "--port", "0"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        try:
            said = process.stdout.readline()
            host, port = re.search(r"board on ([0-9.]+):([0-9]+);", said).groups()
            assert host == "127.0.0.1"
            socket.create_connection((host, int(port)), timeout=3.0).close()
            process.send_signal(signal.SIGINT)
            assert process.wait(timeout=10) == 130 and "has ended" in process.stderr.read()
        finally:
            process.kill()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("command", "package"),
    [
        ("planner.simulate", "ruamel"),
        ("planner.solve", "ruamel"),
        ("planner.link", "rich"),
        ("planner.link.stream", "ruamel"),
        ("planner.link.egm", "scipy"),
    ],
)
def test_an_interrupt_while_it_is_being_imported_is_quiet(command: str, package: str, tmp_path) -> None:
    """Importing takes seconds; a package that is imported on the way and never ends stands in for them."""
    (tmp_path / package).mkdir()
    (tmp_path / package / "__init__.py").write_text("import time\nprint('here', flush=True)\ntime.sleep(60)\n")
    where = {**os.environ, "PYTHONPATH": os.pathsep.join([str(tmp_path), str(ROOT)])}
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    with subprocess.Popen([sys.executable, "-m", command], env=where, cwd=tmp_path, text=True, **pipes) as process:
        try:
            assert process.stdout.readline() == "here\n"
            process.send_signal(signal.SIGINT)
            assert process.wait(timeout=10) == 130 and process.stderr.read() == ""
        finally:
            process.kill()


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("board --fault dorp@3", "did you mean drop?"),
        ("stream --fault drop", "is not a fault"),
        ("controller --port 0 --web-fault dorp@3", "did you mean drop?"),
        ("controller --port 0 --ftp-port 0 --ftp-fault cat@3", "did you mean cut?"),
        ("controller --certificate x", "needs its key"),
        ("controller --certificate x --key y --port 0", "no certificate"),
        ("board --host 203.0.113.1", "cannot listen on 203.0.113.1"),
        ("egm --start 0,0,0,0,0,0 --host no.such.host.invalid", "there is no host no.such.host.invalid"),
    ],
)
def test_wrong_input_is_told(words: str, said: str, capsys) -> None:
    assert main(words.split()) == 2 and said in capsys.readouterr().err


def test_a_robot_that_reaches_nobody_ends(capsys) -> None:
    assert main(["egm", "--start", "0,0,0,0,0,0", "--port", "0"]) == 0
    assert "nothing can be sent to 127.0.0.1:0" in capsys.readouterr().out


@pytest.mark.parametrize("first", ["-10", "-.5"])
def test_the_first_joint_may_be_negative(first: str) -> None:
    options = simulate_command().parse_args(["egm", "--start", f"{first},20,30,0,-0.5,0"])
    assert options.start == (float(first), 20.0, 30.0, 0.0, -0.5, 0.0)


@pytest.mark.parametrize("words", ["board --port 70000", "board --pace 0", "egm", "egm --start 1,2", "egm --start nan"])
def test_wrong_options_end_it(words: str) -> None:
    with pytest.raises(SystemExit) as end:
        main(words.split())
    assert end.value.code == 2
