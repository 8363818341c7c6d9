"""The relay's core between two simulated ends, in virtual time, with a fault injected into every run."""

from __future__ import annotations

import random
from collections import Counter

import pytest
from link_ends import Board, Controller, program

from planner.link import relay as relay_module
from planner.link.messages import LONGEST_LINE
from planner.link.program_lines import ProgramLine, ProgramLines
from planner.link.relay import ACK_TIME, HEAT_TIME, Effect, LogNote, Relay, RelaySide, RunOutcome, StopRobot, Write

FAULTS = 1000
PROGRAM = program()
TOTAL = len(PROGRAM)
CONTROLLER, BOARD = RelaySide.CONTROLLER, RelaySide.BOARD


class Run:
    """One run in virtual time: messages travel in random order between the ends, cut into random pieces."""

    def __init__(self, seed: int, lines: ProgramLines = PROGRAM, numbered: bool | None = None) -> None:
        self.random = random.Random(seed)
        self.now = 0.0
        self.lines = lines
        self.controller = Controller(lines)
        self.board = Board(self.random.random() < 0.5 if numbered is None else numbered)
        self.relay = Relay(lines, self.now)
        self.to_relay = {CONTROLLER: b"", BOARD: b""}
        self.from_relay = {CONTROLLER: b"", BOARD: b""}
        self.open = {CONTROLLER, BOARD}
        self.deaf: set[RelaySide] = set()  # ends that neither read nor answer any more
        self.notes: list[LogNote] = []
        self.robot_stopped: str | None = None
        self.outcome: RunOutcome | None = None

    def carry_out(self, effects: list[Effect]) -> None:
        for effect in effects:
            assert self.outcome is None, "an effect after the outcome"
            if isinstance(effect, Write):
                if effect.side in self.open:
                    self.from_relay[effect.side] += effect.data
            elif isinstance(effect, LogNote):
                self.notes.append(effect)
            elif isinstance(effect, StopRobot):
                assert self.robot_stopped is None
                self.robot_stopped = effect.reason
            else:
                self.outcome = effect

    def cut(self, side: RelaySide) -> None:
        self.open.discard(side)
        self.from_relay[side] = b""
        self.carry_out(self.relay.lost(side, "connection reset", self.now))

    def step(self) -> bool:
        """One thing that can happen next; False if nothing can but time passing."""
        ways = []
        for side in sorted(self.open, key=str):
            if self.to_relay[side]:
                ways.append(("in", side))
            if self.from_relay[side] and side not in self.deaf:
                ways.append(("out", side))
        if CONTROLLER in self.open - self.deaf:
            said = self.controller.says()
            if said:
                self.to_relay[CONTROLLER] += said
                return True
        if BOARD in self.open - self.deaf and self.board.answers and self.random.random() < 0.5:
            self.to_relay[BOARD] += self.board.says()
            return True
        if not ways:
            if BOARD in self.open - self.deaf and self.board.answers:
                self.to_relay[BOARD] += self.board.says()
                return True
            return False
        way, side = self.random.choice(ways)
        pipe = self.to_relay if way == "in" else self.from_relay
        size = self.random.randint(1, len(pipe[side]))
        piece, pipe[side] = pipe[side][:size], pipe[side][size:]
        self.now += 0.0005
        if way == "in":
            self.carry_out(self.relay.received(side, piece, self.now))
        elif side is CONTROLLER:
            self.controller.hears(piece)
        else:
            self.board.hears(piece)
        return True

    def go_on(self, until: int | None = None) -> None:
        """Run until the board has carried out so many lines, or until it is over."""
        for _ in range(100_000):
            if self.outcome is not None or (until is not None and len(self.board.done) >= until):
                return
            if not self.step():
                self.now = self.relay.deadline
                self.carry_out(self.relay.tick(self.now))
        raise AssertionError("the run does not end")

    def deliver_last(self) -> None:
        """What was written before the end still arrives, as a closing connection brings it."""
        for side in self.open - self.deaf:
            (self.controller if side is CONTROLLER else self.board).hears(self.from_relay[side])
            self.from_relay[side] = b""


def resumable(run: Run) -> int | None:
    """The first bead that is not through: its last line acknowledged, and something sent after it."""
    assert run.outcome is not None
    beads = sorted({line.bead for line in run.lines.lines} - {-1})
    asked = max([note.n for note in run.notes if note.what == "received"], default=0)
    asked += any(note.what == "end" for note in run.notes)
    for bead in beads:
        last = max(line.n for line in run.lines.lines if line.bead == bead)
        if last > run.outcome.position.n or asked <= last:
            return bead
    return None


def check(run: Run, stopped: bool) -> None:
    """What holds after every run: nothing lost, nothing doubled, a safe end, a right position."""
    outcome = run.outcome
    assert outcome is not None
    run.deliver_last()
    done = [n for n, _ in run.board.done]
    assert done == list(range(1, len(done) + 1)), "lost, doubled or out of order"
    assert [text for _, text in run.board.done] == [line.text for line in run.lines.lines[: len(done)]]
    # the board did what was acknowledged, and at most the one line that was under way besides
    assert outcome.position.n <= len(done) <= outcome.sent <= outcome.position.n + 1
    assert run.controller.acknowledged <= outcome.position.n
    assert outcome.position.resume == resumable(run)
    if outcome.position.n:
        last = run.lines[outcome.position.n]
        assert (outcome.position.bead, outcome.position.layer) == (last.bead, last.layer)
    assert (outcome.reason is not None) == stopped == (run.robot_stopped is not None), outcome
    if not stopped:
        assert len(done) == len(run.lines) and outcome.safe and run.board.plain == []
        return
    assert outcome.reason and "\n" not in outcome.reason and len(outcome.reason) < 250
    if CONTROLLER in run.open - run.deaf:
        assert run.controller.stopped and run.controller.heard[-1].startswith("S ")
    if BOARD in run.open - run.deaf:
        assert run.board.plain == ["M106 P0 S0"]
    else:
        assert not outcome.safe


# Each fault strikes when the board has carried out a random number of lines; returns words that the reason must have.


def lose_controller(run: Run) -> str:
    run.cut(CONTROLLER)
    return "controller's connection"


def lose_board(run: Run) -> str:
    run.cut(BOARD)
    return "board's connection"


def half_a_line_then_gone(run: Run) -> str:
    """The relay's own line is cut off, too: the board has half of what was on its way."""
    side = run.random.choice([CONTROLLER, BOARD])
    half = run.from_relay[BOARD][: len(run.from_relay[BOARD]) // 2]
    run.board.hears(half)
    run.from_relay[BOARD] = run.from_relay[BOARD][len(half) :]
    if side is CONTROLLER:
        run.carry_out(run.relay.received(side, run.to_relay[side] + b"L 1", run.now))
    else:
        run.carry_out(run.relay.received(side, b"o", run.now))
    run.to_relay[side] = b""
    run.cut(side)
    return f"{side.value}'s connection"


def garbage(run: Run) -> str:
    side = run.random.choice([CONTROLLER, BOARD])
    junk = [b"\x00\xff\xfe\x80\n", b"x" * (LONGEST_LINE + 1), b"\xc3\xa9\r\n"]
    if side is CONTROLLER:
        junk += [b"L x M83\n", b"hello\n", b"L 3 G1 E1*7\n", b"L -1 M83\n", b"L 1 import os\n", b"\n", b"A 3\n"]
    run.carry_out(run.relay.received(side, b"\n" if side is BOARD else b"", run.now))
    run.to_relay[side] = run.to_relay[side].rpartition(b"\n")[0] + b"\n" if run.to_relay[side] else b""
    run.to_relay[side] += run.random.choice(junk)
    return side.value


def board_chatters(run: Run) -> str:
    run.to_relay[BOARD] += b"T:205 /205\r\n" * (relay_module.MOST_REMARKS + 1)
    run.deaf.add(BOARD)
    return "board sent more than"


def board_error(run: Run) -> str:
    said = run.random.choice([b"Error: Heater 1 fault\r\n", b"!! jam\r\n", b"Error: bad command\r\n"])
    run.board.answers.append(said)
    return "board reports"


def wrong_ack(run: Run) -> str:
    n = run.random.choice([0, len(run.board.done) + 3, 9999, max(len(run.board.done) - 2, 0)])
    run.board.answers.appendleft(b"ok N%d\r\n" % n)
    return "board acknowledged"


def dumb_board(run: Run) -> str:
    run.deaf.add(BOARD)
    return "in time"


def dumb_controller(run: Run) -> str:
    run.deaf.add(CONTROLLER)
    return "in time"


def restart(run: Run) -> str:
    """The controller is there again, and would begin anew."""
    run.to_relay[CONTROLLER] += run.controller.hello()
    return "started again"


def from_the_start(run: Run) -> str:
    run.to_relay[CONTROLLER] += b"L 1 M83\n"
    return "controller sent"


def skipped(run: Run) -> str:
    n = min(run.controller.said + 2, TOTAL + 5)
    run.to_relay[CONTROLLER] += b"L %d M83\n" % n
    return "controller sent"


def other_text(run: Run) -> str:
    if run.controller.said >= TOTAL:
        return from_the_start(run)
    n = run.controller.said + 1
    run.to_relay[CONTROLLER] += b"L %d G1 E99 F6000\n" % n
    return "table"


def other_end(run: Run) -> str:
    run.to_relay[CONTROLLER] += b"E %d\n" % run.random.choice([0, max(run.controller.said - 1, 0), TOTAL + 1])
    return "controller"


def gives_up(run: Run) -> str:
    run.to_relay[CONTROLLER] += b"X %d collision at joint 4\n" % run.controller.said
    return "controller stopped: collision"


def ctrl_c(run: Run) -> str:
    run.carry_out(run.relay.stop("interrupted", run.now))
    return "interrupted"


STOPPING = (
    lose_controller, lose_board, half_a_line_then_gone, garbage, board_chatters, board_error, wrong_ack, dumb_board,
    dumb_controller, restart, from_the_start, skipped, other_text, other_end, gives_up, ctrl_c,
)  # fmt: skip


# These must be borne.


def slow_board(run: Run) -> None:
    run.now += 0.9 * ACK_TIME


def slow_controller(run: Run) -> None:
    run.now += 0.9 * min(relay_module.SILENCE_TIME, ACK_TIME)


def bad_transmission(run: Run) -> None:
    """A byte of a line on its way to the board is another: its checksum is wrong, and the board wants it again."""
    at = run.from_relay[BOARD].find(b"G1 E0")
    if at >= 0:
        pipe = bytearray(run.from_relay[BOARD])
        pipe[at + 4] = ord("1")
        run.from_relay[BOARD] = bytes(pipe)


def remarks(run: Run) -> None:
    run.board.answers.append(b"T:204.9 /205.0\r\n")
    run.board.answers.append(b"Warning: Tool 0 was not driven\r\n")


BORNE = (slow_board, slow_controller, bad_transmission, remarks)


@pytest.mark.slow(keep=("0",))
@pytest.mark.parametrize("part", range(4))
def test_faults(part: int) -> None:
    """A thousand runs, each with one of twenty kinds of fault at a random moment."""
    seen: Counter[str] = Counter()
    for seed in range(part * FAULTS // 4, (part + 1) * FAULTS // 4):
        run = Run(seed)
        run.to_relay[CONTROLLER] = run.controller.hello()
        fault = (*STOPPING, *BORNE)[seed % 20]
        at = run.random.randint(0, TOTAL - 1)
        run.go_on(until=at)
        for _ in range(run.random.randint(0, 6)):
            run.step()
        over = run.outcome is not None
        words = None if over else fault(run)
        run.go_on()
        assert run.outcome is not None
        if over or fault in BORNE:
            check(run, stopped=False)
        elif run.outcome.reason is None:
            # the fault came when all was done already, so that nobody listened any more
            assert run.outcome.position.n == TOTAL
            check(run, stopped=False)
            seen["too late"] += 1
        else:
            check(run, stopped=True)
            assert words is not None and (words in run.outcome.reason or run.controller.ended), (
                seed, fault.__name__, run.outcome.reason
            )  # fmt: skip
            seen[fault.__name__] += 1
    assert seen["too late"] < 20
    assert all(seen[fault.__name__] >= 5 for fault in STOPPING), seen


@pytest.mark.parametrize("numbered", [False, True])
def test_a_whole_run(numbered: bool) -> None:
    run = Run(7, numbered=numbered)
    run.to_relay[CONTROLLER] = run.controller.hello()
    run.go_on()
    check(run, stopped=False)
    assert run.controller.acknowledged == TOTAL and run.controller.ended


def test_the_board_may_lag_behind_an_end() -> None:
    """The controller's program is over and its socket closed while the board still has lines."""
    run = Run(3)
    run.to_relay[CONTROLLER] = run.controller.hello()
    run.go_on(until=TOTAL - 4)
    run.deaf.add(BOARD)
    while run.step():
        pass
    assert run.controller.ended
    run.open.discard(CONTROLLER)
    run.carry_out(run.relay.lost(CONTROLLER, "closed", run.now))
    run.deaf.clear()
    run.go_on()
    check(run, stopped=False)


def started(lines: ProgramLines = PROGRAM) -> Relay:
    relay = Relay(lines, 0.0)
    assert written(relay.received(CONTROLLER, f"H {lines.module} {len(lines)}\n".encode(), 0.0)) == [b"G 1\n"]
    return relay


def written(effects: list[Effect]) -> list[bytes]:
    return [effect.data for effect in effects if isinstance(effect, Write)]


def said(lines: ProgramLines, first: int, last: int) -> bytes:
    return b"".join(f"L {n} {lines[n].text}\n".encode() for n in range(first, last + 1))


def reason_of(effects: list[Effect]) -> str:
    return next(effect.reason for effect in effects if isinstance(effect, StopRobot))


def outcome_of(effects: list[Effect]) -> RunOutcome:
    return next(effect for effect in effects if isinstance(effect, RunOutcome))


def test_the_checksum() -> None:
    """The example of the RepRap wiki: N7 G1 X2.0 Y2.0 F3000.0*85 (checksum over all before the star)."""
    lines = ProgramLines("Cup", (ProgramLine(1, 0, 0, 0.0, "G1 X2.0 Y2.0 F3000.0"),))
    sent = written(started(lines).received(CONTROLLER, said(lines, 1, 1), 0.0))
    assert sent == [b"N1 G1 X2.0 Y2.0 F3000.0*%d\n" % (85 ^ ord("7") ^ ord("1"))]


@pytest.mark.parametrize(
    ("hello", "words"),
    [
        (b"H Cup 41\n", "not Cup with 39"),
        (b"H Cap 39\n", "runs Cap"),
        (b"L 1 M83\n", "before its hello"),
        (b"H Cup 039\n", "controller sent 'H Cup 039'"),
        (b"H Cup\n", "controller sent 'H Cup'"),
        (b"X 0 no motors\n", "controller stopped: no motors"),
    ],
)
def test_another_program_is_refused(hello: bytes, words: str) -> None:
    relay = Relay(PROGRAM, 0.0)
    effects = relay.received(CONTROLLER, hello, 0.1)
    assert words in reason_of(effects)
    assert not any(data.startswith(b"G") for data in written(effects))


def test_no_more_than_a_window_ahead() -> None:
    window = relay_module.WINDOW
    assert len(written(started().received(CONTROLLER, said(PROGRAM, 1, window), 0.0))) == 1
    effects = started().received(CONTROLLER, said(PROGRAM, 1, window + 1), 0.0)
    assert f"sent line {window + 1} when only 0 were acknowledged" in reason_of(effects)


def test_an_ack_after_an_error_means_nothing() -> None:
    relay = started()
    relay.received(CONTROLLER, said(PROGRAM, 1, 3), 0.0)
    assert "Heater" in reason_of(relay.received(BOARD, b"Error: Heater 1 fault\r\n", 0.0))
    relay.received(BOARD, b"ok\r\n", 0.0)  # of the line
    over = outcome_of(relay.received(BOARD, b"ok\r\n", 0.0))  # of what makes the board safe
    assert (over.position.n, over.sent, over.safe) == (0, 1, True)


def test_an_ack_out_of_order_takes_the_right_one_with_it() -> None:
    relay = started()
    relay.received(CONTROLLER, said(PROGRAM, 1, 3), 0.0)
    effects = relay.received(BOARD, b"ok N2\r\nok N1\r\nok\r\n", 0.0)
    assert "acknowledged line 2 where line 1 was due" in reason_of(effects)
    assert outcome_of(effects).position.n == 0


def test_nothing_is_heard_after_garbage() -> None:
    relay = started()
    relay.received(CONTROLLER, said(PROGRAM, 1, 1), 0.0)
    effects = relay.received(BOARD, b"\xff\xfe\r\nok\r\nok\r\n", 0.0)
    assert (outcome_of(effects).position.n, outcome_of(effects).safe) == (0, False)


def test_a_line_is_sent_again_only_if_the_board_did_not_take_it() -> None:
    relay = started()
    first = written(relay.received(CONTROLLER, said(PROGRAM, 1, 2), 0.0))
    assert written(relay.received(BOARD, b"Resend: 1\r\n", 0.0)) == first
    # a bare ok may be the one that some firmwares send after Resend, or the line's own
    assert "may be for either" in reason_of(relay.received(BOARD, b"ok\r\n", 0.0))

    relay = started()
    relay.received(CONTROLLER, said(PROGRAM, 1, 2), 0.0)
    relay.received(BOARD, b"Resend: 1\r\n", 0.0)
    assert written(relay.received(BOARD, b"ok N1\r\n", 0.0))[0] == b"A 1\n"
    assert "asked for line 1 again" in reason_of(relay.received(BOARD, b"Resend: 1\r\n", 0.0))

    relay = started()
    assert "asked for line 0 again" in reason_of(relay.received(BOARD, b"Resend: 0\r\n", 0.0))

    relay = started()
    relay.received(CONTROLLER, said(PROGRAM, 1, 1), 0.0)
    effects = relay.received(BOARD, b"Resend: 1\r\n" * (relay_module.MOST_RESENDS + 1), 0.0)
    assert len([data for data in written(effects) if data == first[0]]) == relay_module.MOST_RESENDS
    assert "more than 3 times" in reason_of(effects)


def test_heating_is_waited_for() -> None:
    """Line 2 of the program heats and waits: the board's ack comes when it is hot."""
    relay = started()
    relay.received(CONTROLLER, said(PROGRAM, 1, 2), 0.0)
    relay.received(BOARD, b"ok\r\n", 1.0)
    assert relay.tick(0.99 * HEAT_TIME) == []
    assert "line 2 in time" in reason_of(relay.tick(1.0 + HEAT_TIME))


def test_a_long_move_in_the_queue_is_waited_for() -> None:
    """60 mm at 120 mm/min take 30 s: the lines after it wait until the queue has room."""
    texts = ("G1 E60 F120", "G1 E0.1", "T0")
    lines = ProgramLines("Cup", tuple(ProgramLine(n, 0, 0, 0.0, text) for n, text in enumerate(texts, 1)))
    for n, takes in ((1, 30.0), (2, 30.0), (3, 30.05)):
        relay = started(lines)
        relay.received(CONTROLLER, said(lines, 1, 3), 0.0)
        for _ in range(n - 1):
            relay.received(BOARD, b"ok\r\n", 0.0)
        assert relay.deadline == pytest.approx(ACK_TIME + takes)


def test_cold_switches_the_heaters_off() -> None:
    relay = Relay(PROGRAM, 0.0, cold=True)
    effects = relay.stop("interrupted", 0.0)
    assert written(effects) == [b"S interrupted\n", b"M106 P0 S0\n", b"M104 S0\n", b"M140 S0\n"]
    assert outcome_of(relay.received(BOARD, b"ok\r\nok\r\nok\r\n", 0.0)).safe


def lines_of(*texts: str) -> ProgramLines:
    return ProgramLines("Cup", tuple(ProgramLine(n, 0, 0, 0.0, text) for n, text in enumerate(texts, 1)))


def test_every_tool_that_was_heated_is_cooled() -> None:
    lines = lines_of("M140 S60", "M104 T0 S195", "M104 T2 S190", "M109 T2 S190", "T2", "G1 E1 F60")
    effects = Relay(lines, 0.0, cold=True).stop("interrupted", 0.0)
    assert [text.decode().strip() for text in written(effects)[1:]] == [
        "M106 P0 S0", "M104 S0", "M140 S0", "M104 T0 S0", "M104 T2 S0"
    ]  # fmt: skip


def test_every_output_that_was_switched_goes_off() -> None:
    """A cutter on an output of its own, stopped between its orders, and a fan."""
    lines = lines_of("M106 P2 S255", "M104 T1 S200", "M42 P5 S255 G4 P500 M42 P5 S0", "M106 P0 S1", "M280 P1 S90")
    relay = Relay(lines, 0.0)
    effects = relay.stop("interrupted", 0.0)
    off = [b"M106 P0 S0\n", b"M106 P2 S0\n", b"M42 P5 S0\n"]
    assert written(effects)[1:] == off and relay.last_words[BOARD] == b"".join(off)
    assert outcome_of(relay.received(BOARD, b"ok\r\nok\r\nok\r\n", 0.0)).safe


def test_where_to_go_on() -> None:
    """A bead is through once its last line was acknowledged and a further one came."""
    beads = (-1, 4, 4, 5, -1, 6)
    lines = ProgramLines("Cup", tuple(ProgramLine(n, bead, 2, 0.0, "M83") for n, bead in enumerate(beads, 1)))
    expected = {
        (0, 0): 4, (1, 1): 4, (2, 2): 4, (3, 3): 4, (3, 4): 5, (4, 4): 5, (4, 5): 6, (5, 5): 6, (6, 6): 6, (6, 7): None
    }  # fmt: skip
    assert {key: lines.position(*key).resume for key in expected} == expected


def test_all_is_said_when_the_end_came_before_the_fault() -> None:
    lines = ProgramLines("Cup", (ProgramLine(1, 0, 0, 0.0, "M83"), ProgramLine(2, 0, 0, 0.0, "M83")))
    relay = started(lines)
    relay.received(CONTROLLER, said(lines, 1, 2) + b"E 2\n", 0.0)
    relay.received(BOARD, b"ok\r\n", 0.0)
    relay.stop("interrupted", 0.0)
    over = outcome_of(relay.received(BOARD, b"ok\r\nok\r\n", 0.0))
    assert (over.position.n, over.position.resume) == (2, None)
