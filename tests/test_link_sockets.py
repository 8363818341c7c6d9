"""The relay on loopback sockets: the same faults as in its core's test, with what an operating system adds to them."""

from __future__ import annotations

import json
import os
import signal
import socket
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path

import pytest
from link_ends import program
from link_servers import BoardEnd, ControllerEnd

from planner.base.errors import EXIT_INTERRUPTED, OutputError
from planner.link import relay as patience
from planner.link import relay as relay_module
from planner.link.command import _code
from planner.link.orders import ContinueOrder, PauseOrder, ReprimeOrder, RobotMoves, RobotStands
from planner.link.relay import Effect, LogNote, Relay, RelaySide, RelayState, RunOutcome, RunStatus
from planner.link.run import INTERRUPTIONS, Log, RelayRun, Requests, signals_as

PROGRAM = program()
TOTAL = len(PROGRAM)


class Hand:
    """What moves the robot: notes what it was told, and sees it done at once."""

    def __init__(self, requests: Requests) -> None:
        self.requests = requests
        self.stopped: list[str] = []
        self.moved: list[str] = []

    def stop(self, reason: str) -> None:
        self.stopped.append(reason)

    def pause(self) -> None:
        self.moved.append("pause")
        self.requests.ask(RobotStands())

    def go_on(self) -> None:
        self.moved.append("go on")
        self.requests.ask(RobotMoves())


class Session:
    """One run between two ends; what came of it."""

    def __init__(self, log: Path, controller: ControllerEnd, board: BoardEnd) -> None:
        self.controller, self.board, self.log = controller, board, log
        self.requests = Requests()
        self.hand = Hand(self.requests)
        self.robot = self.hand.stopped
        self.shown: list[RunStatus] = []

    def run(self) -> RunOutcome:
        sockets = {
            RelaySide.CONTROLLER: socket.create_connection(self.controller.address),
            RelaySide.BOARD: socket.create_connection(self.board.address),
        }
        log = Log(self.log)
        relay = Relay(PROGRAM, time.monotonic())
        try:
            return RelayRun(relay, sockets, self.requests, log, self.hand, self.shown.append).run()
        finally:
            log.close()
            for each in sockets.values():
                assert each.fileno() == -1
            self.requests.close()
            self.controller.close()
            self.board.close()


def records(path: Path) -> list[dict[str, object]]:
    return [json.loads(line) for line in path.read_text(encoding="ascii").splitlines()]


def check(session: Session, outcome: RunOutcome) -> None:
    """Nothing lost, nothing doubled, and the log says the same."""
    done = session.board.core.done
    assert done == [(n, PROGRAM[n].text) for n in range(1, len(done) + 1)]
    assert outcome.position.n <= len(done) <= outcome.sent <= outcome.position.n + 1
    told = records(session.log)
    for what, last in (("sent", outcome.sent), ("acknowledged", outcome.position.n)):
        assert [record["n"] for record in told if record["what"] == what] == list(range(1, last + 1))
    assert all(str(record["utc"]).endswith("+00:00") for record in told)
    clock = [float(str(record["ms"])) for record in told]
    assert clock == sorted(clock)
    assert bool(session.robot) == (outcome.reason is not None)
    assert [record["text"] for record in told if record["what"] == "stop"] == session.robot


def test_a_whole_run(tmp_path: Path) -> None:
    session = Session(tmp_path / "log.jsonl", ControllerEnd(PROGRAM), BoardEnd())
    outcome = session.run()
    check(session, outcome)
    assert outcome.reason is None and outcome.position.n == TOTAL and session.shown[-1].acknowledged == TOTAL
    assert session.controller.core.acknowledged == TOTAL


FAULTS = [
    (end, fault, at, words)
    for at in (0, 5, 23)
    for end, fault, words in (
        ("controller", "close", "controller's connection was lost"),
        ("controller", "reset", "controller's connection was lost"),
        ("controller", "half", "controller's connection was lost"),
        ("controller", "garbage", "controller sent bytes that are not text"),
        ("controller", "long", "controller sent a line of more than 256 bytes"),
        ("controller", "hello", "started again"),
        ("controller", "gives up", "controller stopped: axis 5 overload"),
        ("board", "close", "board's connection was lost"),
        ("board", "reset", "board's connection was lost"),
        ("board", "half", "board's connection was lost"),
        ("board", "garbage", "board sent bytes that are not text"),
        ("board", "error", "Heater 1 fault"),
        ("board", "wrong ack", "acknowledged line 9999"),
        ("board", "resend", "again, which was not the last one sent"),
        ("board", "flood", "more than 1000 lines that acknowledge nothing"),
    )
    if not (end == "controller" and fault == "hello" and at == 0)
]


@pytest.mark.parametrize(("end", "fault", "at", "words"), FAULTS)
def test_a_fault_stops_both_sides(tmp_path: Path, end: str, fault: str, at: int, words: str) -> None:
    controller = ControllerEnd(PROGRAM, fault if end == "controller" else None, at)
    board = BoardEnd(at % 2 == 0, fault if end == "board" else None, at)
    session = Session(tmp_path / "log.jsonl", controller, board)
    outcome = session.run()
    check(session, outcome)
    assert outcome.reason is not None and words in outcome.reason
    assert session.robot == [outcome.reason]
    if fault not in ("close", "reset", "half") or end == "board":
        assert controller.core.stopped
    if fault not in ("close", "reset", "half") or end == "controller":
        assert board.core.plain == ["M106 P0 S0"]


def test_a_board_that_says_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(patience, "ACK_TIME", 0.2)
    monkeypatch.setattr(relay_module, "STOP_TIME", 0.2)
    session = Session(tmp_path / "log.jsonl", ControllerEnd(PROGRAM), BoardEnd(fault="dumb", at=5))
    outcome = session.run()
    check(session, outcome)
    assert outcome.reason == "the board did not acknowledge line 6 in time" and not outcome.safe
    assert session.controller.core.stopped


@pytest.mark.parametrize("fault", ["slow", "deaf"])
def test_who_is_slow_is_waited_for(tmp_path: Path, fault: str) -> None:
    controller = ControllerEnd(PROGRAM, fault if fault == "deaf" else None, 9)
    session = Session(tmp_path / "log.jsonl", controller, BoardEnd(fault=fault if fault == "slow" else None, at=9))
    outcome = session.run()
    check(session, outcome)
    assert outcome.reason is None


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_ctrl_c_stops_both_sides(tmp_path: Path, number: signal.Signals) -> None:
    board = BoardEnd(fault="slow", at=3)
    session = Session(tmp_path / "log.jsonl", ControllerEnd(PROGRAM), board)

    def strike() -> None:
        while len(board.core.done) < 3:
            time.sleep(0.001)
        os.kill(os.getpid(), number)

    threading.Thread(target=strike, daemon=True).start()
    before = signal.getsignal(number)
    with signals_as(session.requests):
        outcome = session.run()
    assert signal.getsignal(number) is before
    check(session, outcome)
    assert outcome.reason == INTERRUPTIONS[number.name] and _code(outcome) == EXIT_INTERRUPTED
    assert session.controller.core.stopped and board.core.plain == ["M106 P0 S0"] and outcome.safe


def test_a_pause_a_reprime_and_on(tmp_path: Path) -> None:
    """While it is paused the board gets nothing but what primes it, and then every line that is left, once."""
    board = BoardEnd(fault="held", at=9)  # else the program can be through before it is asked to pause
    session = Session(tmp_path / "log.jsonl", ControllerEnd(PROGRAM), board)
    frozen: list[int] = []

    def user() -> None:
        wait_for(lambda: len(session.board.core.done) >= 9)
        session.requests.ask(PauseOrder("wiped"))
        wait_for(lambda: session.hand.moved == ["pause"])
        board.may_go_on.set()
        wait_for(lambda: session.shown[-1].state is RelayState.PAUSED and "reprime" in session.shown[-1].may)
        frozen.append(len(session.board.core.done))
        time.sleep(0.3)
        frozen.append(len(session.board.core.done))
        session.requests.ask(ReprimeOrder(20e-3, 5e-3))
        wait_for(lambda: len(session.board.core.plain) == 3 and session.shown[-1].state is RelayState.PAUSED)
        session.requests.ask(ContinueOrder())

    thread = threading.Thread(target=user, daemon=True)
    thread.start()
    outcome = session.run()
    thread.join()
    check(session, outcome)
    assert outcome.reason is None and outcome.position.n == TOTAL
    assert session.hand.moved == ["pause", "go on"] and frozen[0] == frozen[1] < TOTAL
    assert session.board.core.plain == ["G1 E20.000 F300.000", "M400", "G1 F300"]
    told = [record["what"] for record in records(session.log)]
    order = [what for what in told if what in ("pause", "stands", "reprime", "reprimed", "continue", "moves")]
    assert order == ["pause", "stands", *["reprime"] * 3, "reprimed", "continue", "moves"]


def wait_for(holds: Callable[[], bool]) -> None:
    end = time.monotonic() + 10.0
    while not holds():
        assert time.monotonic() < end
        time.sleep(0.002)


def test_a_log_that_cannot_be_written_stops_the_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    real = os.write

    def full(file: int, data: bytes) -> int:
        if b'"n": 7' in bytes(data):
            raise OSError(28, "No space left on device")
        return real(file, data)

    monkeypatch.setattr(os, "write", full)
    session = Session(tmp_path / "log.jsonl", ControllerEnd(PROGRAM), BoardEnd())
    outcome = session.run()
    assert outcome.reason == "the log cannot be written: No space left on device"
    assert session.controller.core.stopped and session.board.core.plain == ["M106 P0 S0"]


def test_a_log_that_cannot_be_begun_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(file: int, data: bytes) -> int:
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patched, pytest.raises(OutputError, match=r"cannot write .*: No space left"):
        patched.setattr(os, "write", full)
        Log(tmp_path / "log.jsonl", first=[LogNote("board", 0, "FIRMWARE_NAME: some")])
    assert not (tmp_path / "log.jsonl").exists()


@pytest.mark.parametrize("where", ["received", "tick"])
def test_a_mistake_of_the_relay_s_own_stops_both_sides(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, where: str
) -> None:
    """Nobody is left to say `stop` afterwards, so it is said on the way out."""

    class Faulty(Relay):
        def received(self, side: RelaySide, data: bytes, now: float) -> list[Effect]:
            return self._slip("received") or super().received(side, data, now)

        def tick(self, now: float) -> list[Effect]:
            return self._slip("tick") or super().tick(now)

        def _slip(self, here: str) -> list[Effect]:
            if here == where and self.acknowledged >= 7:
                raise ZeroDivisionError
            return []

    monkeypatch.setattr(sys.modules[__name__], "Relay", Faulty)
    session = Session(tmp_path / "log.jsonl", ControllerEnd(PROGRAM), BoardEnd())
    with pytest.raises(ZeroDivisionError):
        session.run()
    assert session.controller.core.stopped and session.board.core.plain == ["M106 P0 S0"]
    assert session.robot == ["the relay failed"]
    assert records(session.log)[-1]["text"] == "the relay failed"


def test_a_log_is_not_written_over(tmp_path: Path) -> None:
    (tmp_path / "log.jsonl").write_text("precious")
    with pytest.raises(OutputError, match="is there already"):
        Log(tmp_path / "log.jsonl")
    with pytest.raises(OutputError, match="cannot write"):
        Log(tmp_path / "nowhere" / "log.jsonl")
    assert (tmp_path / "log.jsonl").read_text() == "precious"
