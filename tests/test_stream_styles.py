"""Streams of programs of every style: the flow of an analog output, lines for the extruder's board, arcs; and their rate."""

from __future__ import annotations

import time
from contextlib import closing
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from export_fixtures import demand_plan, socket_plan
from link_ends import as_results
from simulate_fixtures import program as straight

from benchmarks.stream_rate import kept
from planner.base.errors import InputError
from planner.export.program import RobotProgram
from planner.export.rapid.reader import read_rapid
from planner.export.rapid.writer import rapid, rapid_files
from planner.link.connections import Address
from planner.link.feed import Feed, FeedStopped, feeding
from planner.link.streaming import CIRCULAR, LineFeed, StreamStopped, main, send, server_module, stream_of
from planner.simulate.board import BOARD_FAULTS, STREAM_FAULTS, faults_of
from planner.simulate.servers import BoardServer
from planner.simulate.stream import Buffer, StreamServer, frame_of

PACE = 10.0


@cache
def with_lines() -> RobotProgram:
    return read_rapid(rapid_files(socket_plan())["OneBead.mod"])


@cache
def with_flow() -> RobotProgram:
    return read_rapid(rapid(demand_plan()))


def silent(text: str) -> None:
    """Says nothing."""


# ---- the flow of an analog output -----------------------------------------------------------------------------------


def test_the_flow_goes_along_with_the_moves() -> None:
    """Replayed frame by frame, the output takes the values that the program sets, in order, at the same ends of moves."""
    program = with_flow()
    now, replayed = 0.0, []
    for frame in map(frame_of, list(stream_of(program).frames())[1:-1]):
        move = frame.number - 2
        if frame.flags & 8:
            replayed.append((move, "start", frame.flow[0]))
        elif frame.flags:
            assert frame.flow[0] == np.float32(now)  # a move with other outputs leaves the flow as it is
        now = frame.flow[0]
        if frame.flags & 16:
            replayed.append((move, "end", frame.flow[1]))
        now = frame.flow[1] if frame.flags & 16 else now
    written = [
        (move, "start" if distance > 0.0 else "end", np.float32(value))
        for move in sorted(program.demands)
        for distance, value in program.demands[move]
    ]
    assert replayed == written and len(written) >= 2 and now == 0.0


def test_the_module_drives_output_and_flow() -> None:
    program = with_flow()
    text = server_module(program, stream_of(program).signals, "192.168.125.1", 1026, "aoDemand")
    assert "TriggIO bsFlowOn{s},0\\AOp:=aoDemand,next.flowEnd;" in text and "SetAO aoDemand,0;" in text
    assert "\\T3:=bsFlowing{s}\\T4:=bsFlowOn{s},zone" in text
    without = server_module(straight(), (), "192.168.125.1", 1026)
    assert "AOp" not in without and 'BsStop "no output here";' in without


def test_the_command_finds_the_output_of_the_flow(tmp_path) -> None:
    for name, text in rapid_files(demand_plan()).items():
        (tmp_path / name).write_text(text, "ascii")
    as_results(tmp_path)
    made = tmp_path / "server.mod"
    assert main([str(tmp_path), "--server", str(made)]) == 0
    assert "AOp:=aoDemand,next.flowStart" in made.read_text()


# ---- arcs -----------------------------------------------------------------------------------------------------------


def test_arcs_take_their_length() -> None:
    """A half circle of radius 10 mm takes as long as its 31.4 mm, not its diameter."""
    program = straight(moves=3, step=0.02, speed=0.1)
    via = np.full((3, 3), np.nan)
    via[2] = [0.03, 0.01, 0.0]
    stream = stream_of(replace(program, arcs=via))
    frames = [frame_of(data) for data in stream.frames()]
    assert [f.kind for f in frames[1:4]] == [1, 1, CIRCULAR] and frames[3].via == pytest.approx((30.0, 10.0, 0.0))
    buffer = Buffer()
    for frame in frames:
        buffer.take(frame)
    while not buffer.finished:
        buffer.advance(1e9 * (1 + buffer.state.done))
    assert buffer.state.moved == pytest.approx(0.2 + 0.1 * np.pi)


# ---- lines for the board --------------------------------------------------------------------------------------------


def streamed(
    board_faults: tuple[str, ...] = (), stream_faults: tuple[str, ...] = ()
) -> tuple[list, list[str | None], str]:
    """Lines that the board carried out, what it got without a number, and why the robot's stream ended."""
    stream = stream_of(with_lines())
    with (
        closing(BoardServer("127.0.0.1", 0, 200.0, faults_of(board_faults, BOARD_FAULTS))) as board,
        closing(StreamServer("127.0.0.1", 0, PACE, faults_of(stream_faults, STREAM_FAULTS))) as robot,
    ):
        try:
            with feeding(Address(*board.address)) as feed:
                send(stream, *robot.address, silent, LineFeed(stream, feed))
        except (FeedStopped, StreamStopped) as stopped:
            why = str(stopped)
        else:
            why = ""
        end = time.monotonic() + 5.0
        while not robot.state().reason and time.monotonic() < end:
            time.sleep(0.01)
        accepted = board.record().accepted
        numbered = [gcode for n, gcode in accepted if n is not None]
        return numbered, [gcode for n, gcode in accepted if n is None], why or robot.state().reason


def lines_of(program: RobotProgram) -> list[str]:
    return [text for move in sorted(program.sends) for text in program.sends[move]]


@pytest.mark.slow
def test_lines_go_to_the_board_with_the_moves() -> None:
    numbered, plain, why = streamed()
    assert numbered == lines_of(with_lines()) and why == "finished" and "M106 P0 S0" not in plain


@pytest.mark.slow
@pytest.mark.parametrize(
    ("board_faults", "stream_faults", "words"),
    [
        (("error@6",), (), "the board reports"),
        (("clog@7",), (), "the board reports"),
        (("drop@6",), (), "the board closed the connection"),
        (("garbage@6",), (), "the board sent"),
        (("fatal@6",), (), "the board reports"),
        ((), ("drop@5",), "connection"),
        ((), ("stop@5",), "stopped at the controller"),
    ],
)
def test_either_side_that_fails_stops_both(
    board_faults: tuple[str, ...], stream_faults: tuple[str, ...], words: str
) -> None:
    numbered, plain, why = streamed(board_faults, stream_faults)
    lines = lines_of(with_lines())
    assert words in why and numbered == lines[: len(numbered)] and len(numbered) < len(lines)
    if not board_faults:
        assert plain[-1] == "M106 P0 S0"


def test_a_feed_knows_what_its_lines_have_switched() -> None:
    feed = Feed()
    assert feed.safe == ("M106 P0 S0",)
    for text in ("M106 P2 S255", "M42 P5 S255 G4 P500 M42 P5 S0", "M106 P2 S9"):
        feed.add(text)
    assert feed.safe == ("M106 P0 S0", "M106 P2 S0", "M42 P5 S0")


@pytest.mark.parametrize("said", ["Error: bad", "Error: Filament error on extruder 0: tooLittleMovement"])
def test_a_feed_stops_at_whatever_the_board_reports(said: str) -> None:
    with pytest.raises(FeedStopped, match="the board reports"):
        Feed().received(said.encode() + b"\n")


def test_a_board_that_lags_too_far_stops_the_robot() -> None:
    stream = stream_of(straight(tuple(f"G1 E0.{k} F300" for k in range(100, 140)), moves=41))
    feed = type("Silent", (), {"feed": Feed(), "step": lambda self: None})()
    lines = LineFeed(stream, feed)
    lines.step(12)
    with pytest.raises(FeedStopped, match="lines behind the robot"):
        lines.step(40)


def test_frames_wait_at_a_rest_until_the_board_is_through() -> None:
    stream = stream_of(straight(("M109 S200", "G1 E1 F60"), moves=3))
    feed = type("Silent", (), {"feed": Feed(), "step": lambda self: None})()
    lines = LineFeed(stream, feed)
    assert lines.step(0) == 2 and lines.step(2) == 2  # the rest at which it heats, which is frame 2
    feed.feed.due(0.0)
    feed.feed.received(b"ok\r\n")
    assert lines.step(2) is None
    with pytest.raises(InputError, match="waits for 'G4 P100' in motion"):
        LineFeed(stream_of(straight(("M83", "G4 P100", "M84"), moves=4)), feed)


def test_the_feed_is_strict() -> None:
    feed = Feed()
    assert feed.due(0.0) == b""
    feed.add("M83")
    feed.add("G1 E1 F60")
    first = feed.due(0.0)
    assert first.startswith(b"N1 M83*") and feed.due(0.1) == b"" and feed.behind == 2
    assert feed.received(b"Resend: 1\r\n") == first
    with pytest.raises(FeedStopped, match="not due"):
        feed.received(b"ok\r\n")  # may be of either
    feed = Feed()
    feed.add("M83")
    feed.due(0.0)
    with pytest.raises(FeedStopped, match="did not acknowledge line 1 in time"):
        feed.due(100.0)
    for said in (b"ok N7\r\n", b"Error: x\r\n", b"\xff\n", b"Resend: 2\r\n"):
        other = Feed()
        other.add("M83")
        other.due(0.0)
        with pytest.raises(FeedStopped):
            other.received(said)
    with pytest.raises(FeedStopped):
        Feed().received(b"ok\r\n")


@pytest.mark.slow
def test_the_command_wants_the_board_where_there_are_lines(tmp_path, capsys) -> None:
    for name, text in rapid_files(socket_plan()).items():
        (tmp_path / name).write_text(text, "ascii")
    as_results(tmp_path)
    assert main([str(tmp_path), "--controller", "127.0.0.1:1"]) == 2
    assert "sends lines to the extruder's board: say where it is" in capsys.readouterr().err
    assert main([str(tmp_path), "--controller", "127.0.0.1:1", "--head", "a b"]) == 2
    with (
        closing(BoardServer("127.0.0.1", 0, 200.0)) as board,
        closing(StreamServer("127.0.0.1", 0, PACE)) as robot,
    ):
        words = ["--controller", "{}:{}".format(*robot.address), "--head", "{}:{}".format(*board.address)]
        assert main([str(tmp_path), *words]) == 0
        assert [gcode for n, gcode in board.record().accepted if n is not None] == lines_of(with_lines())


# ---- the rate -------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_many_frames_with_one_reading_keep_up() -> None:
    """A task that takes 6.5 ms for each message reads 150 targets a second one by one, and keeps 400 up eight by eight."""
    one, *_ = kept(400.0, 2.0, 6.5e-3, 1)
    many, starved, reason = kept(400.0, 2.0, 6.5e-3, 8)
    assert one < 160.0 and many > 250.0 and starved == 0 and reason == ""
