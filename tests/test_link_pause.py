"""Pauses within a bead: in the relay's core at random moments, in what users can ask for, and at the robot's hand."""

from __future__ import annotations

import json
import os
import threading
import time
from contextlib import closing
from types import SimpleNamespace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from simulate_fixtures import MODULE, Client, program, reader
from test_link_relay import BOARD, CONTROLLER, PROGRAM, TOTAL, Run, check, reason_of, said, started, written
from test_link_rws import files_of, serving, session, silent, until

from planner.link.connections import LinkError
from planner.link.messages import Jam, Remark, Trouble, from_board
from planner.link.orders import (
    JAMMED,
    LENGTHS_MM,
    SPEEDS_MM_S,
    ContinueOrder,
    Order,
    PauseOrder,
    ReprimeOrder,
    RobotMoves,
    RobotStands,
    StopOrder,
    listen_at_terminal,
    order_in_json,
    order_in_words,
)
from planner.link.relay import ROBOT_TIME, Effect, MoveRobot, PauseRobot, Relay, RelayState
from planner.link.robot import RobotWatch, bring, start
from planner.simulate.start import start as start_simulators

CLOG = b"Error: Filament error on extruder 0: tooLittleMovement\r\n"


# --- the core, in virtual time -----------------------------------------------------------------------------


class Pausable(Run):
    """A run whose robot stands still from a pause on: its program says nothing until it is to move."""

    def __init__(self, seed: int) -> None:
        super().__init__(seed)
        self.relay = Relay(PROGRAM, self.now, attended=True)
        self.to_relay[CONTROLLER] = self.controller.hello()

    def carry_out(self, effects: list[Effect]) -> None:
        for effect in effects:
            if isinstance(effect, PauseRobot):
                self.controller.going = False
            elif isinstance(effect, MoveRobot):
                self.controller.going = True
        super().carry_out([effect for effect in effects if not isinstance(effect, PauseRobot | MoveRobot)])

    def take(self, order: Order) -> None:
        self.carry_out(self.relay.take(order, self.now))

    def settle(self) -> None:
        """Everything on its way arrives."""
        while self.step():
            continue


@settings(max_examples=80, deadline=None)
@given(st.integers(0, 10**6), st.integers(1, TOTAL - 2), st.integers(0, 6), st.booleans())
def test_a_pause_anywhere_loses_nothing(seed: int, at: int, steps: int, jam: bool) -> None:
    """Told by the user or by the board, at any line: the board gets no further line until it goes on."""
    run = Pausable(seed)
    run.go_on(until=at)
    for _ in range(steps):
        run.step()
    if run.outcome is not None or run.controller.ended:
        return
    if jam:
        run.to_relay[BOARD] += CLOG
        while run.relay.status.state is RelayState.RUNNING:
            run.step()
        if run.relay.ended:
            return  # the robot's part was over before the jam was told
        assert "tooLittleMovement" in run.relay.status.reason
    else:
        run.take(PauseOrder("wiped"))
    sent = run.relay.status.sent
    run.settle()
    if run.relay.ended:
        return
    run.take(RobotStands())
    assert run.relay.status.state is RelayState.PAUSED
    run.now += 1e5  # a user takes a day
    run.carry_out(run.relay.tick(run.now))
    assert run.relay.status.sent == run.relay.status.acknowledged == len(run.board.done) == sent
    assert run.relay.status.may == {"reprime", "continue", "stop"}
    run.take(ReprimeOrder(10e-3, 5e-3))
    run.settle()
    assert run.board.plain[:2] == ["G1 E10.000 F300.000", "M400"] and run.relay.status.state is RelayState.PAUSED
    run.board.plain.clear()
    run.take(ContinueOrder())
    run.settle()
    assert run.relay.ended or len(run.board.done) == sent, "nothing before the robot was seen to move"
    run.take(RobotMoves())
    run.go_on()
    check(run, stopped=False)


def paused() -> Relay:
    """At line 3, which the board has taken; lines 4 to 6 wait."""
    relay = Relay(PROGRAM, 0.0, attended=True)
    relay.received(CONTROLLER, f"H {PROGRAM.module} {TOTAL}\n".encode() + said(PROGRAM, 1, 6), 0.0)
    relay.received(BOARD, b"ok\r\nok\r\n", 0.0)
    assert relay.take(PauseOrder("wiped"), 1.0)[-1] == PauseRobot()
    assert relay.received(BOARD, b"ok\r\n", 1.0)[-1].data == b"A 3\n"  # type: ignore[union-attr]
    relay.take(RobotStands(), 2.0)
    return relay


def test_what_cannot_be_now_has_no_effect() -> None:
    new = Relay(PROGRAM, 0.0)
    for order in (PauseOrder("x"), ContinueOrder(), ReprimeOrder(0.01, 0.005), RobotStands(), RobotMoves()):
        assert new.take(order, 0.0) == []
    relay = paused()
    for order in (PauseOrder("x"), RobotStands(), RobotMoves()):
        assert relay.take(order, 3.0) == [] and relay.status.state is RelayState.PAUSED
    assert relay.take(ContinueOrder(), 3.0)[-1] == MoveRobot()
    for order in (ContinueOrder(), ReprimeOrder(0.01, 0.005), RobotStands()):
        assert relay.take(order, 3.0) == [], "pressed twice, or on two pages"
    assert written(relay.take(RobotMoves(), 3.1))[0].startswith(b"N4 ")
    assert relay.status.reason == ""


def test_the_board_is_not_primed_before_it_has_answered() -> None:
    relay = started()
    relay.received(CONTROLLER, said(PROGRAM, 1, 3), 0.0)
    relay.take(PauseOrder("wiped"), 0.0)
    relay.take(RobotStands(), 0.1)
    assert relay.status.may == {"continue", "stop"}, "line 1, which makes filament relative, is not taken"
    assert relay.take(ReprimeOrder(0.01, 0.005), 0.2) == []
    relay.received(BOARD, b"ok\r\n", 0.3)
    assert relay.status.may == {"reprime", "continue", "stop"}


@pytest.mark.parametrize(
    ("before", "fault", "words"),
    [
        ([], lambda r: r.lost(BOARD, "reset", 9.0), "board's connection was lost"),
        ([], lambda r: r.lost(CONTROLLER, "reset", 9.0), "controller's connection was lost"),
        ([], lambda r: r.received(BOARD, b"Error: Heater 1 fault\r\n", 9.0), "board reports"),
        ([], lambda r: r.received(BOARD, b"ok\r\n", 9.0), "acknowledged a line where none was due"),
        ([], lambda r: r.received(CONTROLLER, b"X 6 collision\n", 9.0), "controller stopped: collision"),
        ([], lambda r: r.received(CONTROLLER, f"E {TOTAL}\n".encode(), 9.0), "ended after line"),
        ([], lambda r: r.take(StopOrder("interrupted"), 9.0), "interrupted"),
        ([ReprimeOrder(1e-2, 5e-3)], lambda r: r.tick(100.0), "did not acknowledge the repriming in time"),
        ([ReprimeOrder(1e-2, 5e-3)], lambda r: r.received(BOARD, b"Error: cold\r\n", 9.0), "board reports 'Error: cold"),
        ([ContinueOrder()], lambda r: r.tick(2.0 + ROBOT_TIME), "the robot was not seen to go on in time"),
        ([ContinueOrder(), RobotMoves()], lambda r: r.tick(1e4), "did not acknowledge line 4 in time"),
    ],
)  # fmt: skip
def test_a_fault_in_a_pause_stops_the_run(before: list[Order], fault, words: str) -> None:  # type: ignore[no-untyped-def]
    relay = paused()
    for order in before:
        assert relay.take(order, 2.0)
    assert words in reason_of(fault(relay))
    assert relay.status.state is RelayState.STOPPING or "connection" in words


def test_a_robot_that_does_not_stand_in_time() -> None:
    relay = started()
    relay.take(PauseOrder("wiped"), 5.0)
    assert relay.tick(5.0 + 0.99 * ROBOT_TIME) == []
    assert "was not seen to stand in time" in reason_of(relay.tick(5.0 + ROBOT_TIME))


def test_all_answers_are_awaited_when_a_stop_comes_while_it_primes() -> None:
    relay = paused()
    relay.take(ReprimeOrder(1e-2, 5e-3), 2.0)
    relay.take(StopOrder("enough"), 2.5)
    assert relay.received(BOARD, b"ok\r\nok\r\nok\r\n", 3.0) == []
    (over,) = relay.received(BOARD, b"ok\r\n", 3.0)
    assert over.safe and over.reason == "enough" and over.position.n == 3  # type: ignore[union-attr]


def test_a_pause_that_comes_with_the_program_s_end() -> None:
    """The robot is through before it could stand: the board runs dry, and all is printed."""
    run = Pausable(5)
    run.go_on(until=TOTAL)
    run.take(PauseOrder("wiped"))
    run.controller.going = True
    run.settle()
    run.take(RobotStands())
    run.go_on()
    check(run, stopped=False)


def test_a_jam_that_nobody_can_mend_stops_the_run() -> None:
    relay = started()
    relay.received(CONTROLLER, said(PROGRAM, 1, 3), 0.0)
    assert "tooLittleMovement" in reason_of(relay.received(BOARD, CLOG, 0.1))


def test_a_jam_while_it_goes_on_pauses_again() -> None:
    relay = paused()
    relay.take(ContinueOrder(), 3.0)
    assert relay.received(BOARD, CLOG, 3.1)[-1] == PauseRobot()
    assert relay.take(RobotMoves(), 3.2) == [], "it was told to pause since"
    relay.take(RobotStands(), 3.3)
    assert relay.status.state is RelayState.PAUSED and "tooLittleMovement" in relay.status.reason
    assert "more than 1000 lines" in reason_of(relay.received(BOARD, CLOG * 1001, 3.4)), "it has lost its mind"


@pytest.mark.parametrize(
    ("text", "kind"),
    [
        ("Error: Filament error on extruder 0: tooLittleMovement", Jam),
        ("Filament error on extruder 12: noFilament", Jam),
        ("Warning: Filament error on extruder 1", Jam),
        ("Error: Filament errors were reset", Trouble),
        ("Error: Heater 1 fault", Trouble),
        ("Filament monitor 0 calibrated", Remark),
    ],
)
def test_a_jam_as_the_board_tells_it(text: str, kind: type) -> None:
    assert isinstance(from_board(text), kind)


# --- what users can ask for --------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "order"),
    [
        ("p", PauseOrder("paused at the terminal")), ("Pause", PauseOrder("paused at the terminal")),
        ("jam", PauseOrder(JAMMED)), ("c", ContinueOrder()), ("stop", StopOrder("stopped at the terminal")),
        ("r", ReprimeOrder(0.01, 0.005)), ("reprime 20", ReprimeOrder(0.02, 0.005)), ("r 20 2", ReprimeOrder(0.02, 0.002)),
    ],
)  # fmt: skip
def test_words_at_the_terminal(text: str, order: Order) -> None:
    assert order_in_words(text)[1] == order


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "is not one of pause, jam, reprime, continue, stop"), ("paus3", "did you mean pause?"), ("p 3", "only reprime"),
        ("r x", "only reprime takes numbers"), ("r nan", "only reprime"), ("r 0", "0 mm is not 0.1 to 500 mm"),
        ("r 10 99", "99 mm/s is not 0.1 to 50 mm/s"), ("r 1 2 3", "only reprime takes numbers"), ("r inf", "inf mm is not"),
    ],
)  # fmt: skip
def test_other_words_are_refused(text: str, words: str) -> None:
    with pytest.raises(ValueError, match=words.replace("?", r"\?")):
        order_in_words(text)


@pytest.mark.parametrize(
    ("order", "made"),
    [
        ({"do": "pause"}, PauseOrder("paused on the page")), ({"do": "jam"}, PauseOrder(JAMMED)),
        ({"do": "continue"}, ContinueOrder()), ({"do": "stop"}, StopOrder("stopped on the page")),
        ({"do": "reprime", "mm": 10, "mm_s": 2.5}, ReprimeOrder(0.01, 0.0025)),
        ({"do": "reprime"}, None), ({"do": "reprime", "mm": "10", "mm_s": 5}, None), ({"do": "pause", "why": 1}, None),
        ({"do": "reprime", "mm": 1e9, "mm_s": 5}, None), ({"do": "reprime", "mm": 10, "mm_s": 5, "x": 1}, None),
        ({"do": "M112"}, None), ({"do": ["stop"]}, None), ([], None), (None, None),
    ],
)  # fmt: skip
def test_orders_of_the_page(order: object, made: Order | None) -> None:
    found = order_in_json(json.dumps(order).encode())
    assert (None if found is None else found[1]) == made


@settings(max_examples=200, deadline=None)
@given(st.one_of(st.binary(max_size=80), st.text(max_size=40).map(str.encode)))
def test_any_bytes_are_an_order_or_none(body: bytes) -> None:
    order_in_json(body)
    try:
        word, order = order_in_words(body.decode("utf-8", "replace"))
    except ValueError as error:
        assert str(error)
    else:
        inside = [1e3 * order.length, LENGTHS_MM, 1e3 * order.speed, SPEEDS_MM_S] if word == "reprime" else []  # type: ignore[union-attr]
        assert all(low <= value <= high for value, (low, high) in zip(inside[::2], inside[1::2], strict=True))  # type: ignore[misc]


@pytest.mark.parametrize("body", [b"", b"{", b"\xff", b"[" * 1000, b'{"do": "reprime", "mm": NaN, "mm_s": 5}'])
def test_orders_that_are_none(body: bytes) -> None:
    assert order_in_json(body) is None


def test_what_is_typed_is_asked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    master, slave = os.openpty()
    monkeypatch.setattr("sys.stdin", SimpleNamespace(fileno=lambda: slave))
    asked: list[Order] = []
    told: list[str] = []
    listen_at_terminal(lambda: frozenset({"pause", "stop"}), asked.append, told.append)
    os.write(master, b"p\ncontinue\nbrake\nstop\n")
    until(lambda: len(asked) == 2)
    assert asked == [PauseOrder("paused at the terminal"), StopOrder("stopped at the terminal")]
    assert told[0] == "continue: not possible now; possible are: pause, stop" and told[1].startswith(
        "'brake' is not one of"
    )
    os.close(master)


# --- the robot's hand, on the simulated controller ---------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("version", [1, 2])
def test_the_robot_pauses_and_goes_on_in_its_place(version: int) -> None:
    asked: list[Order] = []
    with serving(version) as (server, controller), closing(session(server, version)) as rws:
        bring(rws, files_of(MODULE), silent)
        start(rws)
        watch = RobotWatch(rws, asked.append, lambda: False)
        until(lambda: watch.subscribed)
        for _ in range(2):
            watch.pause()
            until(lambda: asked != [])
            assert asked == [RobotStands()] and not controller.running
            time.sleep(2.5)  # two looks that would tell of a stop
            assert asked == [RobotStands()]
            state = controller.state()
            watch.go_on()
            until(lambda: len(asked) > 1)
            assert asked == [RobotStands(), RobotMoves()] and controller.running
            now = controller.state()
            assert state is not None and now is not None and now.time >= state.time and not now.reason
            asked.clear()
        watch.stop("over")
        assert watch.close() is None and not controller.running


def test_who_starts_a_paused_robot_elsewhere_ends_the_run() -> None:
    asked: list[Order] = []
    with serving() as (server, controller), closing(session(server)) as rws:
        bring(rws, files_of(MODULE), silent)
        start(rws)
        watch = RobotWatch(rws, asked.append, lambda: False)
        until(lambda: watch.subscribed)
        watch.pause()
        until(lambda: asked != [])
        controller.start()  # at the pendant
        until(lambda: len(asked) > 1, 10.0)
        assert asked[1:] == [StopOrder("the program was started on the controller while it was paused")]
        watch.stop("over")
        assert watch.close() is None and not controller.running


@pytest.mark.parametrize(("state", "words"), [("motoroff", "the robot does not go on"), ("motoron", "")])
def test_a_robot_that_cannot_go_on(state: str, words: str) -> None:
    asked: list[Order] = []
    with serving() as (server, controller), closing(session(server)) as rws:
        bring(rws, files_of(MODULE), silent)
        start(rws)
        watch = RobotWatch(rws, asked.append, lambda: False)
        watch.pause()
        until(lambda: asked != [])
        controller.motors = state
        watch.go_on()
        until(lambda: len(asked) > 1)
        if words:
            assert isinstance(asked[1], StopOrder) and words in asked[1].reason and not controller.running
        else:
            assert asked[1] == RobotMoves()
        watch.stop("over")
        assert watch.close() is None and not controller.running


@pytest.mark.slow
def test_a_robot_that_cannot_be_seen_to_pause() -> None:
    """The web services fail from the pause on: the run ends, and the user is told."""
    asked: list[Order] = []
    with serving() as (server, _), closing(session(server)) as rws:
        bring(rws, files_of(MODULE), silent)
        start(rws)
        watch = RobotWatch(rws, asked.append, lambda: False)
        until(lambda: watch.subscribed)
        server.close()
        watch.pause()
        until(lambda: asked != [], 15.0)
        assert isinstance(asked[0], StopOrder) and "the robot was not seen to pause" in asked[0].reason
        watch.stop("enough")
        assert watch.close() is not None, "nor to stop"


def test_a_robot_that_is_to_pause_while_it_sets_out_is_not_taken_for_stopped(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[Order] = []
    begun, through, stands = threading.Event(), threading.Event(), threading.Event()

    def late(rws: object) -> None:
        begun.set()
        through.wait(5.0)
        stands.clear()

    def none() -> None:
        raise LinkError("no subscription")

    rws = SimpleNamespace(running=lambda seconds: not stands.is_set(), subscribe=none, close=lambda: None)
    rws.again = lambda: rws
    monkeypatch.setattr("planner.link.robot.WATCH_TIME", 0.01)
    monkeypatch.setattr("planner.link.robot.start", late)
    monkeypatch.setattr("planner.link.robot.stop_robot", lambda rws: stands.set())
    watch = RobotWatch(rws, asked.append, lambda: False)  # type: ignore[arg-type]
    watch.pause()
    until(lambda: asked != [])
    watch.go_on()
    begun.wait(5.0)
    watch.pause()
    through.set()
    until(lambda: len(asked) > 2)
    time.sleep(0.1)  # some looks that would tell of a stop
    assert asked == [RobotStands(), RobotMoves(), RobotStands()]
    watch.stop("over")
    assert watch.close() is None


@pytest.mark.slow
def test_a_stop_overtakes_a_start_that_is_under_way(monkeypatch: pytest.MonkeyPatch) -> None:
    """The controller takes the start late, when the robot was told to stop already: it stands all the same."""
    asked: list[Order] = []
    begun = threading.Event()

    def late(rws) -> None:  # type: ignore[no-untyped-def]
        begun.set()
        time.sleep(1.0)
        start(rws)

    with serving() as (server, controller), closing(session(server)) as rws:
        bring(rws, files_of(MODULE), silent)
        start(rws)
        watch = RobotWatch(rws, asked.append, lambda: False)
        watch.pause()
        until(lambda: asked != [])
        monkeypatch.setattr("planner.link.robot.start", late)
        watch.go_on()
        begun.wait(5.0)
        watch.stop("enough")
        assert watch.close() is None and not controller.running


@pytest.mark.slow
def test_a_paused_program_of_the_simulator_waits_for_nothing() -> None:
    """Its window is full and nobody answers for longer than it would bear while it ran."""
    lines = ["M83", *(f"G1 E0.{k} F600" for k in range(100, 130))]
    with start_simulators(read=reader(program(lines, moves=32)), pace=10.0) as made:
        made.controller.put("HOME:/Made.mod", MODULE.encode())
        made.controller.load("HOME:/Made.mod", True)
        made.controller.reset_pointer()
        made.controller.start()
        with closing(Client(made.program)) as client:
            client.read()
            client.say("G 1")
            until(lambda: (state := made.state()) is not None and state.sent == 16)
            made.controller.stop()
            time.sleep(2.5)
            made.controller.start()
            client.say("A 16")
            until(lambda: (state := made.state()) is not None and state.sent > 20)
            state = made.state()
            assert state is not None and state.sent > 20 and not state.reason
