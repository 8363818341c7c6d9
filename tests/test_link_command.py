"""The command, from its arguments to its exit code, against the simulated controller and board."""

from __future__ import annotations

import io
import json
import os
import signal
import socket
import threading
import time
from collections.abc import Iterator
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest
from export_fixtures import socket_plan, two_arms_plan
from link_ends import as_results
from rich.console import Console
from simulate_fixtures import MODULE, program, reader

from planner.base.errors import InputError
from planner.export.rapid.writer import rapid_files
from planner.link import command, demo, robot
from planner.link import run as board
from planner.link.command import main
from planner.link.connections import Address, Secret, connect, parse_address, password
from planner.link.program_lines import ProgramLine, ProgramLines
from planner.link.relay import RelayState, RunStatus
from planner.link.rws import DIALECTS, Rws
from planner.link.telling import RunProgress, Show, duration, place, progress
from planner.simulate.controller import Controller
from planner.simulate.ftp import FtpAccess, FtpServer
from planner.simulate.rws import Access, RwsServer
from planner.simulate.start import Simulated, start

PGF = b"<Program>\n\t<Module>Made.mod</Module>\n</Program>\n"
LINES = ["M83", *(f"G1 E0.{k} F600" for k in range(100, 118)), "M104 S0"]
PASSWORD, HEAD_PASSWORD = "r0b0tics-of-ours", "h3ad"


@pytest.fixture
def files(tmp_path: Path) -> Path:
    """A program of a line, 3 beads with 6 lines each, and a line; with its table."""
    made = tmp_path / "Made.mod"
    text = MODULE.replace("MODULE Made\n", "MODULE Made\n    ! Problem cup_7, strategy sqp\n", 1)
    hello = f'        SocketSend bwClient\\Str:="H Made {len(LINES)}\\0A";\n'
    made.write_text(text.replace("PROC main()\n", f"PROC main()\n{hello}", 1))
    rows = [f"{n},{-1 if n in (1, 20) else (n - 2) // 6},0,{0.05 * n:.3f},{text}" for n, text in enumerate(LINES, 1)]
    (tmp_path / "Made_lines.csv").write_text("\n".join(["n,bead,layer,t_s,text", *rows, ""]))
    as_results(tmp_path)
    return made


@pytest.fixture(autouse=True)
def secrets(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(command.PASSWORD, PASSWORD)
    monkeypatch.setenv(board.PASSWORD, HEAD_PASSWORD)


@pytest.fixture
def machine(request: pytest.FixtureRequest) -> Iterator[Simulated]:
    with start(
        pace=4.0,
        read=reader(program(LINES, moves=21)),
        board_tool=0,
        **{"access": Access(password=PASSWORD), **getattr(request, "param", {})},
    ) as made:
        yield made


def arguments(files: Path, machine: Simulated, *more: str) -> list[str]:
    rws, head = (f"{host}:{port}" for host, port in (machine.rws, machine.board))
    ends = ["--controller", rws, "--head", head, "--socket-port", str(machine.program[1])]
    return [str(files), *ends, "--quiet", "--log", str(files.with_name("log.jsonl")), *more]


def records(files: Path) -> list[dict[str, object]]:
    return [json.loads(line) for line in files.with_name("log.jsonl").read_text().splitlines()]


def carried_out(machine: Simulated) -> list[str]:
    """Lines of the program that the board carried out, in order, each with its number."""
    lines = [(n, gcode) for n, gcode in machine.board_record().accepted if n is not None]
    assert [n for n, _ in lines] == list(range(1, len(lines) + 1))
    return [gcode for _, gcode in lines]


@pytest.mark.parametrize("machine", [{"board_password": HEAD_PASSWORD}], indirect=True)
def test_a_print(files: Path, machine: Simulated, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(arguments(files, machine)) == 0
    assert carried_out(machine) == LINES
    said = capsys.readouterr()
    assert "done: all 20 lines were acknowledged" in said.err
    text = files.with_name("log.jsonl").read_text()
    for shown in (said.out + said.err, text):
        assert PASSWORD not in shown and HEAD_PASSWORD not in shown
    assert [record["n"] for record in records(files) if record["what"] == "acknowledged"] == list(range(1, 21))
    assert records(files)[0]["what"] == "plan"


def test_a_dry_run_starts_nothing(files: Path, machine: Simulated) -> None:
    assert main(arguments(files, machine, "--dry-run")) == 0
    assert machine.state() is None and machine.controller.files() == [] and carried_out(machine) == []
    assert not files.with_name("log.jsonl").exists()


@pytest.mark.slow
@pytest.mark.parametrize(
    "machine", [{"in_use": True}, {"in_use": True, "access": Access(password=PASSWORD, version=2)}], indirect=True
)
def test_a_second_print_with_files_over_ftp_and_an_empty_task(
    files: Path, machine: Simulated, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch,
    request: pytest.FixtureRequest,
) -> None:  # fmt: skip
    """On a controller in use: a print, the same again, and the task is left empty."""
    version = request.node.callspec.params["machine"].get("access", Access()).version
    monkeypatch.setitem(DIALECTS, 2, replace(DIALECTS[2], scheme="http"))
    assert main(arguments(files, machine, "--rws", str(version))) == 0
    again = ["--rws", str(version), "--log", str(files.with_name("again.jsonl")), "--upload", "ftp", "--unload"]
    with closing(FtpServer("127.0.0.1", 0, machine.controller, FtpAccess(password=PASSWORD))) as ftp:
        assert main(arguments(files, machine, *again, "--ftp-port", str(ftp.address[1]))) == 0
        assert main(arguments(files, machine, *again, "--ftp-port", str(ftp.address[1]), "--dry-run")) == 0
    assert "FTP is ready" in capsys.readouterr().err
    assert [gcode for n, gcode in machine.board_record().accepted if n is not None] == 2 * LINES
    assert machine.controller.modules() == []
    assert sum(each.startswith("PUT") for each in machine.requests()) == 2  # those of the first print


@pytest.mark.slow
@pytest.mark.parametrize(
    ("machine", "words", "resume"),
    [
        ({"board_faults": ["error@9"]}, "the board reports 'Error", 1),
        ({"board_faults": ["drop@9"]}, "the board's connection was lost", 1),
        ({"board_faults": ["garbage@9"]}, "the board sent", 1),
        ({"controller_faults": ["drop@9"]}, "the controller's connection was lost", 1),
        ({"controller_faults": ["stop@9"]}, "stopped", 1),
        ({"controller_faults": ["restart@9"]}, "the controller's connection was lost", 1),
        ({"controller_faults": ["garbage@9"]}, "the controller sent", 1),
        ({"controller_faults": ["skip@9"]}, "the controller sent line 10 where line 9 of 20 was due", 1),
    ],
    indirect=["machine"],
)
def test_a_fault(files: Path, machine: Simulated, capsys: pytest.CaptureFixture[str], words: str, resume: int) -> None:
    assert main(arguments(files, machine)) == 3
    said = capsys.readouterr().err
    assert words in said
    assert f"to go on: python -m planner.solve cup_7 --from-bead {resume}, with the same --set and --strategy\n" in said
    assert "stopped: " in said and f"(bead {resume}, layer 0)" in said
    done = carried_out(machine)
    assert done == LINES[: len(done)] and len(done) < len(LINES)
    assert not machine.controller.running


@pytest.mark.slow
def test_ctrl_c(files: Path, machine: Simulated, capsys: pytest.CaptureFixture[str]) -> None:
    def strike() -> None:
        while len(carried_out(machine)) < 5:
            time.sleep(0.005)
        os.kill(os.getpid(), signal.SIGINT)

    threading.Thread(target=strike, daemon=True).start()
    assert main(arguments(files, machine, "--cold")) == 130
    assert "interrupted from the keyboard; last acknowledged line" in capsys.readouterr().err
    assert not machine.controller.running
    assert [gcode for n, gcode in machine.board_record().accepted if n is None][-3:] == [
        "M106 P0 S0",
        "M104 S0",
        "M140 S0",
    ]


@pytest.mark.slow
def test_ctrl_c_before_the_program_listens(
    files: Path, machine: Simulated, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(address: Address, what: str, patience: float = 0.0) -> socket.socket:
        assert machine.controller.running
        raise KeyboardInterrupt

    monkeypatch.setattr(command, "connect", interrupted)
    assert main(arguments(files, machine)) == 130
    assert not machine.controller.running


@pytest.mark.parametrize(
    ("attribute", "value", "words"),
    [("mode", "MANR", "in mode MANR, not in AUTO"), ("motors", "motoroff", "motors are not on (motoroff)")],
)
def test_a_robot_that_is_not_ready(
    files: Path, machine: Simulated, capsys: pytest.CaptureFixture[str], attribute: str, value: str, words: str
) -> None:
    setattr(machine.controller, attribute, value)
    assert main(arguments(files, machine)) == 3
    assert words in capsys.readouterr().err
    assert machine.controller.files() == [] and machine.state() is None


def test_a_program_that_runs_is_left_alone(files: Path, machine: Simulated, capsys: pytest.CaptureFixture[str]) -> None:
    rws = Rws(Address(*machine.rws), 1, "Default User", Secret(PASSWORD))
    robot.bring(rws, robot.program_files(files), lambda text: None)
    rws.start()
    assert main(arguments(files, machine)) == 3
    assert "a program runs on the controller" in capsys.readouterr().err
    assert machine.controller.running
    rws.stop()
    rws.close()


@pytest.mark.parametrize(
    ("machine", "change", "words"),
    [
        ({}, {command.PASSWORD: "wrong"}, "does not take user and password"),
        ({"board_password": "other"}, {}, "does not take the password"),
        ({}, {command.PASSWORD: None}, "there is no password for Default User"),
    ],
    indirect=["machine"],
)
def test_wrong_passwords(
    files: Path, machine: Simulated, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch,
    change: dict[str, str | None], words: str,
) -> None:  # fmt: skip
    for name, value in change.items():
        monkeypatch.setenv(name, value) if value is not None else monkeypatch.delenv(name)
    assert main(arguments(files, machine)) == 2
    assert words in capsys.readouterr().err
    assert machine.state() is None and carried_out(machine) == []


@pytest.mark.slow(keep=2)
@pytest.mark.parametrize(
    ("name", "old", "new", "code", "words"),
    [
        ("Made_lines.csv", "10,1,", "11,1,", 2, "Made_lines.csv:11: n: 11 where 10 is due"),
        ("Made.mod", "MODULE Made", "MODULE Mode", 2, "its first line is not MODULE Made"),
        (
            "Made_lines.csv",
            "G1 E0.108 F600",
            "G1 E0.108 F601",
            3,
            "line 10 is 'G1 E0.108 F600' from the controller, but",
        ),
        (
            "Made_lines.csv",
            "\n20,-1,0,1.000,M104 S0",
            "",
            2,
            "Made.mod: sends 20 lines, and its table has 19 (both must be as they were written together)",
        ),
        ("Made.mod", "H Made 20", "H Made 21", 2, "Made.mod: sends 21 lines, and its table has 20"),
        ("Made.mod", '"H Made 20', '"Hi', 2, "Made.mod: sends no lines (the link runs programs of `program: style: s"),
        ("Made.mod", "ENDMODULE", "", 2, "Made.mod: does not end with ENDMODULE (it was cut off)"),
    ],
)
def test_a_program_that_does_not_fit(
    files: Path, machine: Simulated, capsys: pytest.CaptureFixture[str],
    name: str, old: str, new: str, code: int, words: str,
) -> None:  # fmt: skip
    path = files.with_name(name)
    assert old in path.read_text()
    path.write_text(path.read_text().replace(old, new, 1))
    as_results(path.parent)  # as if it had been written so
    assert main(arguments(files, machine)) == code
    assert words in capsys.readouterr().err
    assert not machine.controller.running
    assert carried_out(machine) == LINES[: len(carried_out(machine))]


@pytest.mark.parametrize(
    ("more", "words"),
    [
        (["--controller", "no.such.host.invalid"], "there is no host no.such.host.invalid"),
        (["--controller", "127.0.0.1:1"], "web services at 127.0.0.1:1 do not answer"),
        (["--head", "127.0.0.1:1"], "the board at 127.0.0.1:1 does not answer: Connection refused"),
        (["--head", "no.such.host.invalid"], "the board: there is no host"),
    ],
)
def test_nobody_there(
    files: Path, machine: Simulated, capsys: pytest.CaptureFixture[str], more: list[str], words: str
) -> None:
    assert main(arguments(files, machine, *more)) == (2 if "host" in words else 3)
    assert words in capsys.readouterr().err
    assert machine.state() is None


@pytest.mark.parametrize(
    "text",
    ["", "a b", "host:", "host:x", "host:0", "host:70000", "http://host", "host:80/x", "-" * 300]
    + ["a..b", ".a", "..", "-a", "a-", "a" * 64, "a." * 126 + "aa"],
)
def test_no_address(text: str) -> None:
    with pytest.raises(ValueError, match=r"HOST|port"):
        parse_address(text, 80)


def test_web_services_2(tmp_path: Path) -> None:
    """Version 2.0: basic authentication, actions as paths, mastership asked for with what needs it."""
    controller = Controller(("127.0.0.1", 0), read=reader(program(LINES)))
    server = RwsServer("127.0.0.1", 0, controller, Access(password=PASSWORD, version=2))
    try:
        rws = Rws(Address(*server.address), 2, "Default User", Secret(PASSWORD), scheme="http")
        robot.check_ready(rws)
        robot.bring(rws, {"Made.mod": MODULE.encode(), "Made.pgf": PGF}, lambda text: None)
        assert controller.files() == ["Made.mod", "Made.pgf"] and controller.modules() == ["Made"]
        rws.start()
        assert rws.running()
        rws.stop()
        assert not rws.running()
        rws.close()
    finally:
        server.close()
        controller.close()


def test_an_answer_is_bounded_and_not_believed(monkeypatch: pytest.MonkeyPatch) -> None:
    """What answers is no controller: too much, no JSON, JSON of another form, a redirection."""
    answers = [
        (b"HTTP/1.1 200 OK\r\nContent-Length: 2000000\r\n\r\n" + b" " * 2_000_000, "refuses"),
        (b"HTTP/1.1 200 OK\r\nContent-Length: 5\r\n\r\n<xml>", "gives no opmode"),
        (b"HTTP/1.1 200 OK\r\nContent-Length: 15\r\n\r\n{\"state\": [[1]]}", "gives no opmode"),
        (b"HTTP/1.1 200 OK\r\nContent-Length: 20000\r\n\r\n" + b"[" * 20_000, "gives no opmode"),
        (b"HTTP/1.1 302 Found\r\nLocation: http://127.0.0.1:1/\r\nContent-Length: 0\r\n\r\n", "status 302"),
        (b"nonsense\r\n\r\n", "do not answer"),
        (b"", "do not answer"),
    ]  # fmt: skip
    for answer, words in answers:
        with socket.create_server(("127.0.0.1", 0)) as server:

            def serve(server: socket.socket = server, answer: bytes = answer) -> None:
                made, _ = server.accept()
                with made:
                    made.recv(4096)
                    try:
                        made.sendall(answer)
                    except OSError:
                        return  # nobody wants to hear all of it

            threading.Thread(target=serve, daemon=True).start()
            rws = Rws(Address(*server.getsockname()), 1, "Default User", Secret(PASSWORD))
            with pytest.raises(command.LinkError, match=words):
                rws.mode()
            rws._session.close()


def test_a_secret_is_not_shown() -> None:
    secret = Secret(PASSWORD)
    assert PASSWORD not in f"{secret} {secret!r} {[secret]}"


def test_no_password_is_no_traceback(monkeypatch: pytest.MonkeyPatch) -> None:
    def end(prompt: str) -> str:
        raise EOFError

    monkeypatch.delenv(command.PASSWORD)
    monkeypatch.setattr("getpass.getpass", end)
    monkeypatch.setattr("sys.stdin", SimpleNamespace(isatty=lambda: True))
    with pytest.raises(InputError, match=r"no password was given for us \(type it, or set BEADWISE_RWS_PASSWORD\)"):
        password(command.PASSWORD, "us")


def test_a_connection_notices_that_the_other_end_is_gone() -> None:
    """Asked every second: an unplugged cable is found within a few seconds."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        made = connect(Address(*server.getsockname()), "it")
        with made:
            assert made.getsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE)
            assert made.getsockopt(socket.IPPROTO_TCP, socket.TCP_KEEPIDLE) == 1
            assert made.getsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT) == 3000
            assert made.getsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY)


def test_a_program_in_modules(files: Path) -> None:
    """All that main loads goes to the controller; what is missing is named."""
    load = '        Load \\Dynamic,"HOME:"\\File:="Made_{}.mod";\n        UnLoad "HOME:"\\File:="Made_{}.mod";\n'
    calls = "".join(load.format(k, k) for k in (1, 2))
    files.write_text(files.read_text().replace("PROC main()\n", f"PROC main()\n{calls}"))
    for name in ("Made_1.mod", "Made_3.mod"):
        files.with_name(name).write_text(f"{name}\nENDMODULE\n")
    with pytest.raises(InputError, match=r"there is no file .*Made_2\.mod"):
        robot.program_files(files)
    files.with_name("Made_2.mod").write_text("two")
    with pytest.raises(InputError, match=r"Made_2\.mod: does not end with ENDMODULE"):
        robot.program_files(files)
    files.with_name("Made_2.mod").write_text("two\nENDMODULE\n")
    made = robot.program_files(files)
    assert list(made) == ["Made.mod", "Made_1.mod", "Made_2.mod", "Made.pgf"]
    assert b"<Module>Made.mod</Module>" in made["Made.pgf"]  # made for it where none was written
    files.with_name("Made.pgf").write_bytes(PGF.replace(b"Made", b"Other"))
    with pytest.raises(InputError, match=r"Made\.pgf: does not name Made\.mod alone"):
        robot.program_files(files)


@pytest.mark.slow
@pytest.mark.parametrize("arms", [1, 2])
def test_the_demo_with_a_program_as_it_is_written(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], arms: int
) -> None:
    """Writer, link, simulated controller with our reader, simulated board: each knows only the wire."""
    texts = rapid_files(socket_plan() if arms == 1 else two_arms_plan(style="socket"))
    for name, text in texts.items():
        (tmp_path / name).write_text(text)
    as_results(tmp_path)
    module = next(tmp_path.glob("*_lines.csv")).name.removesuffix("_lines.csv")
    log = tmp_path / "log.jsonl"
    assert main(["--demo", str(tmp_path / f"{module}.mod"), "--pace", "100", "--quiet", "--log", str(log)]) == 0
    count = len(texts[f"{module}_lines.csv"].splitlines()) - 1
    said = capsys.readouterr().err
    assert f"done: all {count} lines were acknowledged" in said
    assert ("unloaded: both tasks are empty" if arms == 2 else "unloaded: the task is empty") in said
    sent = [json.loads(line)["n"] for line in log.read_text().splitlines() if json.loads(line)["what"] == "sent"]
    assert sent == list(range(1, count + 1)) and count > 2


def test_the_demo_solves_anew_what_another_version_wrote(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its program is kept from run to run; what the simulator would not read is solved again rather than refused."""
    solved: list[list[str]] = []

    def stands_in(arguments: list[str]) -> int:
        solved.append(arguments)
        for name, text in rapid_files(socket_plan()).items():
            (tmp_path / name).write_text(text)
        as_results(tmp_path)
        return 0

    monkeypatch.setattr(demo, "FOLDER", tmp_path)
    monkeypatch.setattr(demo, "solve", stands_in)
    program = demo.demo_program(lambda text: None)
    assert demo.demo_program(lambda text: None) == program and len(solved) == 1
    program.write_text(program.read_text().replace("PROC main()", "PROC main()\n        MoveSideways;"))
    assert demo.demo_program(lambda text: None) == program and len(solved) == 2


def test_the_progress() -> None:
    lines = ProgramLines("Made", tuple(ProgramLine(n, (-1, 0, 0, 1)[n - 1], 0, 20.0 * n, "M83") for n in range(1, 5)))
    assert progress(lines, 1, 0.0) == (0.0, 60.0)
    # 20 s of the program took 30 s: the 40 s that are left will take 60 s
    assert progress(lines, 2, 30.0) == pytest.approx((1 / 3, 60.0))
    assert progress(lines, 4, 90.0) == (1.0, 0.0)
    assert [place(lines, n) for n in (1, 3, 4)] == ["before the first bead", "bead 0, layer 0", "bead 1, layer 0"]
    assert [duration(s) for s in (0.4, 59.6, 3599.9, 7384)] == ["0:00", "1:00", "1:00:00", "2:03:04"]
    console = Console(file=io.StringIO(), width=120, force_terminal=True)
    told: list[RunProgress] = []
    with Show(lines, console, told.append) as show:
        for n, state in ((0, RelayState.HELLO), (3, RelayState.RUNNING), (3, RelayState.PAUSED)):
            show(RunStatus(state, "", n, n, n, frozenset()))
    assert "bead 0, layer 0, line 3 of 4" in console.file.getvalue()  # type: ignore[attr-defined]
    assert "paused: bead 0" in console.file.getvalue()  # type: ignore[attr-defined]
    assert [each.status.acknowledged for each in told] == [0, 3, 3]
    assert told[0].left == 80.0 and told[2].share == pytest.approx(2 / 3)
