"""Moves streamed to a controller: frames, back-pressure, time-outs, and the RAPID module that takes them."""

from __future__ import annotations

import re
import signal
import socket
import struct
import time
from contextlib import closing, suppress
from dataclasses import replace
from functools import cache
from importlib.resources import files

import numpy as np
import pytest
from export_fixtures import in_modules, make_plan
from hypothesis import given, settings
from hypothesis import strategies as st
from link_ends import as_results
from simulate_fixtures import program as straight

from planner.base.errors import InputError
from planner.export.program import RobotProgram, Trigger
from planner.export.rapid.reader import read_rapid
from planner.export.rapid.writer import rapid, rapid_files
from planner.link import streaming as stream_sender
from planner.link.streaming import (
    ALIVE_EVERY,
    CIRCULAR,
    END,
    LENGTH,
    LINEAR,
    PATIENCE,
    VALUES,
    Sender,
    StreamStopped,
    main,
    packed,
    plan_sum,
    program_in,
    send,
    server_module,
    stream_of,
)
from planner.link.telling import GoingOn
from planner.simulate import stream as server
from planner.simulate.board import STREAM_FAULTS, faults_of
from planner.simulate.stream import Buffer, Frame, StreamEnded, StreamServer, frame_of

TEXT = files("planner.link").joinpath("BeadwiseStream.mod").read_text("ascii")


@cache
def printed(materials: tuple[str, ...] = ()) -> RobotProgram:
    return read_rapid(rapid(make_plan(materials=materials)))


def silent(text: str) -> None:
    """Says nothing."""


def arrived(program: RobotProgram) -> list[Frame]:
    return [frame_of(data) for data in stream_of(program).frames()]


# ---- frames -------------------------------------------------------------------------------------------------------


def test_frames_hold_what_the_program_does() -> None:
    program = printed()
    frames = arrived(program)
    start, *moves, end = frames
    assert [f.number for f in frames] == list(range(1, len(frames) + 1)) and end.kind == END
    np.testing.assert_allclose(start.numbers[:6], np.degrees(program.start[:6]), atol=1e-4)
    numbers = np.array([f.numbers for f in moves])
    np.testing.assert_allclose(numbers[:, :3], 1e3 * program.position, atol=1e-4)
    np.testing.assert_allclose(numbers[:, 3:7], program.quat[:, [3, 0, 1, 2]], atol=1e-7)
    used = ~np.isnan(program.external)
    np.testing.assert_allclose(numbers[:, 7:13][used], np.degrees(program.external[used]), atol=1e-4)
    assert np.all(numbers[:, 7:13][~used] == np.float32(9e9))
    np.testing.assert_allclose(numbers[:, 13], 1e3 * program.speed[:, 0], rtol=1e-6)
    np.testing.assert_allclose(numbers[:, 18], 1e3 * program.zone, atol=1e-7)
    assert [f.conf for f in moves] == [tuple(row) for row in program.conf.tolist()]
    assert [f.kind in (LINEAR, CIRCULAR) for f in moves] == program.linear.tolist()
    assert [f.kind == CIRCULAR for f in moves] == program.circular.tolist() and program.circular.any()
    arcs = np.array([f.via for f in moves if f.kind == CIRCULAR])
    np.testing.assert_allclose(arcs, 1e3 * program.via[program.circular], atol=1e-4)
    # at rest only where the program rests, and so at no place within a bead
    assert [f.numbers[18] == 0.0 for f in moves] == program.fine.tolist() and not program.fine.all()


def test_frames_switch_what_the_program_switches() -> None:
    program = printed(("pla", "pva"))
    stream = stream_of(program)
    assert stream.signals == ("doExtrude", "doSupport")
    for move, frame in enumerate(arrived(program)[1:-1]):
        expected = 0
        for trigger in program.triggers.get(move, ()):
            expected += 1 if trigger.from_start else 2 if trigger.value else 4
            assert stream.signals[frame.tool] == trigger.signal
        assert frame.flags == expected


def test_frames_say_how_far_the_next_rest_is() -> None:
    frames = arrived(printed())
    rests = [f.kind == END or f.numbers[18] == 0.0 for f in frames]
    assert [f.left for f in frames] == [rests[k:].index(True) + 1 for k in range(len(frames))]
    assert max(f.left for f in frames) > 10


@settings(max_examples=100, deadline=None)
@given(st.integers(0, LENGTH * 8 - 1))
def test_a_bit_that_changed_is_noticed(bit: int) -> None:
    data = bytearray(packed(77, LINEAR, values=[1.5 * k for k in range(VALUES)], conf=[-1, 0, 1, 4], left=3))
    data[bit // 8] ^= 1 << bit % 8
    with pytest.raises(StreamEnded, match="checksum"):
        frame_of(bytes(data))


def test_words_that_changed_places_are_noticed() -> None:
    data = packed(77, LINEAR, values=[1.5 * k for k in range(VALUES)], left=3)
    with pytest.raises(StreamEnded, match="checksum"):
        frame_of(data[:8] + data[12:16] + data[8:12] + data[16:])


def test_what_cannot_be_streamed_is_refused() -> None:
    with pytest.raises(InputError, match="a flow that changes at the ends"):
        stream_of(replace(straight(), demands={1: ((0.005, 5.0),)}))
    for trigger in (Trigger(0.001, False, True, "do"), Trigger(0.0, True, False, "do")):
        with pytest.raises(InputError, match="ends of moves"):
            stream_of(replace(straight(), triggers={1: (trigger,)}))
    both = (Trigger(0.0, True, True, "do"), Trigger(0.0, False, False, "other"))
    with pytest.raises(InputError, match="not streamed"):
        stream_of(replace(straight(), triggers={1: both}))


# ---- the RAPID module ---------------------------------------------------------------------------------------------


def number_in(name: str) -> float:
    return float(re.search(rf"CONST num {name}:=([0-9.]+);", TEXT)[1])


def test_all_three_tell_the_same() -> None:
    assert number_in("bsFrame") == LENGTH == server.FRAME
    assert number_in("bsCapacity") == server.CAPACITY and f"bsRing{{{server.CAPACITY}}}" in TEXT
    assert number_in("bsSilence") == server.SILENCE > 2 * ALIVE_EVERY
    assert number_in("bsStarving") == server.STARVING
    assert number_in("bsVersion") == stream_sender.VERSION == server.VERSION
    assert stream_sender.ANY_PLAN == server.ANY_PLAN
    assert number_in("bsAtOnce") == stream_sender.AT_ONCE == server.MESSAGE and server.MESSAGE * server.FRAME <= 1024
    assert f"FOR i FROM 0 TO {(LENGTH - 4) // 2 - 1} DO" in TEXT and f"at+{LENGTH - 3},said" in TEXT


def test_rapid_unpacks_what_was_packed() -> None:
    """Its statements are carried out here, on frames of a plan."""
    statements = re.findall(r"UnpackRawBytes bsRaw,at\+(\d+),new\.([\w.]+)\\(Float4|Hex1|IntX:=(\w+));", TEXT)
    formats = {"Float4": "<f", "Hex1": "<B", "UINT": "<H", "UDINT": "<I", "SINT": "<b"}
    order = ["at.x", "at.y", "at.z", "turn.q1", "turn.q2", "turn.q3", "turn.q4"]
    order += [f"axes.eax_{letter}" for letter in "abcdef"]
    order += ["speed.v_tcp", "speed.v_ori", "speed.v_leax", "speed.v_reax", "wait", "zone"]
    last = ["via.x", "via.y", "via.z", "flowStart", "flowEnd"]
    for data in list(stream_of(printed()).frames())[:60]:
        found = {
            name: struct.unpack_from(formats[kind or form], data, int(at) - 1)[0] for at, name, form, kind in statements
        }
        frame = frame_of(data)
        assert [found[name] for name in order] == list(frame.numbers)
        assert [found[name] for name in last] == [*frame.via, *frame.flow]
        assert [found[f"conf.{name}"] for name in ("cf1", "cf4", "cf6", "cfx")] == list(frame.conf)
        whole = (found["number"], found["kind"], found["flags"], found["tool"], found["left"])
        assert whole == (frame.number, frame.kind, frame.flags, frame.tool, frame.left)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_a_foreign_parser_accepts_the_module(monkeypatch) -> None:
    config = pytest.importorskip("rapidchecker.config")
    monkeypatch.setattr(config.CONFIG, "indentation_size", 4)
    check = pytest.importorskip("rapidchecker.check")
    whitespace = pytest.importorskip("rapidchecker.whitespace_checks")
    program = printed(("pla", "pva"))
    made = server_module(program, stream_of(program).signals, "192.168.125.1", 1026)
    for text in (TEXT, made):
        assert check.check_format(text) == [] and whitespace.check_whitespace(text) == []
        assert all(len(string) <= 80 for string in re.findall(r'"([^"]*)"', text)) and text.isascii()
    assert check.check_format(made.replace("ActUnit STN1;", "ActUnit STN1", 1)) != []
    own = rapid(make_plan(materials=("pla", "pva")))
    assert re.search(r"tooldata \w+:=(.*);", made)[1] == re.search(r"tooldata \w+:=(.*);", own)[1]
    ours, theirs = (re.search(r"wobjdata \w+:=(.*);", text)[1] for text in (made, own))
    assert [float(v) for v in re.findall(r"[-\d.]+", ours.replace("STN1", ""))] == [
        float(v) for v in re.findall(r"[-\d.]+", theirs.replace("STN1", ""))
    ]
    assert made.count("doSupport") == 3 and "TriggIO bsEnding{s},0\\DOp:=doSupport,bsState{2};" in made


# ---- back-pressure, in time that passes only here -----------------------------------------------------------------


def simulated(program: RobotProgram, capacity: int, latency: float, step: float) -> Buffer:
    """A stream from end to end with a network that takes `latency` [s] either way, looked at every `step` [s]."""
    stream, now = stream_of(program), 0.0
    sender, buffer = Sender(stream, now), Buffer(capacity)
    there: list[tuple[float, bytes]] = []
    back = [(latency, f"B 3 {capacity} {stream.plan}\n".encode())]
    for _ in range(200_000):
        if sender.finished:
            return buffer
        while back and back[0][0] <= now:
            sender.receive(back.pop(0)[1], now)
        data = sender.due(now)
        there += [(now + latency, data)] if data else []
        before = buffer.taken, buffer.state.done
        while there and there[0][0] <= now:
            data = there.pop(0)[1]
            for k in range(0, len(data), LENGTH):
                buffer.take(frame_of(data[k : k + LENGTH]))
        if not buffer.finished:
            buffer.advance(now)
            if buffer.finished:
                back.append((now + latency, f"E {buffer.state.done} {buffer.state.starved}\n".encode()))
            elif (buffer.taken, buffer.state.done) != before:
                back.append((now + latency, f"C {buffer.taken} {buffer.state.done}\n".encode()))
        now += step
    raise AssertionError("never finished")


@settings(max_examples=30, deadline=None)
@given(st.integers(2, 300), st.floats(0.0, 0.02), st.floats(0.0005, 0.004), st.integers(2, 120))
def test_what_arrives_is_what_was_sent_and_never_too_much(capacity, latency, step, moves) -> None:
    program = straight(moves=moves, step=0.002)
    buffer = simulated(program, capacity, latency, step)
    record = buffer.record()
    assert list(record.frames) == arrived(program)
    assert record.fullest <= capacity and record.done == moves + 1
    # 20 ms a move: enough of them fit to bridge the way there and back and the looks in between
    if capacity * 0.02 > 2 * latency + 5 * step + 0.02:
        assert record.starved == 0


def test_too_long_a_way_starves_it_and_is_told() -> None:
    buffer = simulated(straight(moves=60, step=0.002), 4, 0.2, 0.001)
    assert buffer.record().starved > 5
    with pytest.raises(StreamEnded, match="no frames within a bead"):
        simulated(straight(moves=60, step=0.002), 4, 0.4, 0.001)


def test_the_buffer_refuses_what_must_not_come() -> None:
    frames = arrived(straight(moves=10))
    small = Buffer(3)
    for frame in frames[:3]:
        small.take(frame)
    with pytest.raises(StreamEnded, match="more frames than fit"):
        small.take(frames[3])
    with pytest.raises(StreamEnded, match="out of order"):
        Buffer().take(frames[1])
    with pytest.raises(StreamEnded, match="asked for it"):
        Buffer().take(replace(frames[0], kind=5))


def test_it_sets_off_once_the_bead_is_there_or_nothing_more_fits() -> None:
    frames = arrived(straight(moves=10))
    for capacity, enough in ((100, 9), (4, 4)):
        buffer = Buffer(capacity)
        for frame in frames[:2]:  # both at rest
            buffer.take(frame)
        buffer.advance(0.0)
        assert buffer.state.done == 2
        for k, frame in enumerate(frames[2 : 2 + enough], 1):
            buffer.take(frame)
            assert buffer.advance(1.0) == (k == enough)


def test_a_rail_takes_the_time_of_an_axis_that_slides() -> None:
    made = straight(moves=3)
    external = np.full((3, 6), np.nan)
    external[:, 0] = np.radians([0.0, 0.0, 1000.0])  # mm, read as degrees
    speed = np.tile([0.1, 1.0, 0.5, np.radians(100.0)], (3, 1))
    buffer = Buffer()
    for frame in arrived(replace(made, external=external, speed=speed)):
        buffer.take(frame)
    assert buffer.advance(np.inf) and buffer.state.moved == pytest.approx(2.1, rel=1e-5)


# ---- the sender ---------------------------------------------------------------------------------------------------


def begun(moves: int = 20) -> Sender:
    sender = Sender(stream_of(straight(moves=moves)), 0.0)
    sender.receive(b"B 3 8 any\n", 0.0)
    assert len(sender.due(0.0)) == 8 * LENGTH
    return sender


@pytest.mark.parametrize(
    "said",
    [
        *(b"C 9 0\n", b"C 2 3\n", b"C 4 4\nC 3 3\n", b"C 4 4\nC 5 3\n", b"B 3 8 any\n", b"E 21 0\n", b"E 8 0\n"),
        *(b"C 1\n", b"hello\n", b"C 01 0\n", b"C 1 0 \n", b"\xff\n", b"C 1" + b"1" * 200, b"X 3 jam\n"),
        *(b"C 4 4 any\n", b"C -1 0\n", b"\n"),
    ],
)
def test_what_cannot_be_stops_the_sender(said: bytes) -> None:
    with pytest.raises(StreamStopped):
        begun().receive(said, 0.1)


def test_credit_in_pieces_lets_it_go_on() -> None:
    sender = begun()
    assert sender.due(0.1) == b""
    sender.receive(b"C 8 ", 0.1)
    sender.receive(b"3\nC 8 5\n", 0.2)
    assert [frame_of(sender.due(0.2)[:LENGTH]).number, sender.sent] == [9, 13]


def test_a_module_of_another_plan_gets_no_move() -> None:
    """Tool, work object and outputs are the module's own: with those of another plan the same moves lead elsewhere."""
    program = printed(("pla", "pva"))
    stream = stream_of(program)
    text = server_module(program, stream.signals, "192.168.125.1", 1026)
    elsewhere = program.oframe + [0.0003, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]
    others = [
        plan_sum(replace(program, oframe=elsewhere), stream.signals),
        plan_sum(program, stream.signals[::-1]),
        plan_sum(program, stream.signals, "aoDemand"),
    ]
    assert f'bsPlan:="{stream.plan}";' in text and len({stream.plan, *others}) == 4
    assert stream.plan == stream_of(replace(program, position=program.position + 1.0)).plan
    for said, words in (
        *((f"B 3 8 {plan}", "of another plan: load the one that --server writes") for plan in (*others, "00000000")),
        *((said, "of another version") for said in ("B 2 8", "B 1 8 any")),
    ):
        sender = Sender(stream, 0.0)
        with pytest.raises(StreamStopped, match=words):
            sender.receive(f"{said}\n".encode(), 0.0)
        assert sender.due(0.0) == b""
    sender = Sender(stream, 0.0)
    sender.receive(f"B 3 8 {stream.plan}\n".encode(), 0.0)
    assert len(sender.due(0.0)) == 8 * LENGTH


def test_it_says_that_it_is_there_and_notices_silence() -> None:
    sender = begun()
    assert sender.due(ALIVE_EVERY / 2) == b""
    alive = frame_of(sender.due(ALIVE_EVERY))
    assert alive.kind == 6 and sender.due(ALIVE_EVERY * 1.5) == b""
    with pytest.raises(StreamStopped, match="said nothing"):
        sender.due(PATIENCE + 11.0)


def test_half_a_word_is_silence() -> None:
    sender = begun()
    limit = PATIENCE + 100.0
    for k, byte in enumerate(b"C 4"):
        sender.receive(bytes([byte]), limit / 2 * (k + 1))
    with pytest.raises(StreamStopped, match="said nothing for"):
        sender.due(1.5 * limit)


def test_a_stop_is_understood_even_where_a_frame_has_gone_in_part() -> None:
    sender = begun()
    sender.receive(b"C 8 3\n", 0.1)
    due = sender.due(0.1)
    for gone in (0, 40, LENGTH, LENGTH + 1):
        data = due[:gone] + sender.stop(due[gone:])
        assert len(data) % LENGTH == 0 and frame_of(data[-LENGTH:]).kind == 5
        assert data[:-LENGTH] == due[: len(data) - LENGTH]


# ---- on the wire --------------------------------------------------------------------------------------------------


def test_a_plan_is_streamed_whole() -> None:
    stream = stream_of(printed())
    told: list[str] = []
    with closing(StreamServer("127.0.0.1", 0, pace=10.0, capacity=64, latency=0.005)) as there:
        sender = send(stream, *there.address, told.append)
        state = there.state()
    assert list(state.frames) == arrived(printed()) and state.reason == "finished"
    assert sender.starved == state.starved and state.fullest <= 64
    assert told[0] == f"0 of {stream.total} moves begun" and len(told) > 5


def until_over(there: StreamServer) -> str:
    since = time.monotonic()
    while not there.state().reason and time.monotonic() - since < 15.0:
        time.sleep(0.01)
    return there.state().reason


@pytest.mark.parametrize(
    ("fault", "said", "there_said"),
    [
        ("drop@30", "lost", "connection lost"),
        ("stop@30", "stopped at the controller", "stopped at the controller"),
        ("garbage@30", "is not understood", "the PC asked for it"),
    ],
)
def test_whatever_goes_wrong_stops_both(fault: str, said: str, there_said: str) -> None:
    with closing(StreamServer("127.0.0.1", 0, 5.0, faults_of([fault], STREAM_FAULTS), capacity=16)) as there:
        with pytest.raises(StreamStopped, match=said):
            send(stream_of(printed()), *there.address, silent)
        assert until_over(there) == there_said


def test_a_stop_tells_which_bead_was_begun_and_how_to_go_on() -> None:
    stream, told = stream_of(printed()), list[str]()
    assert [stream.begun(done) for done in (0, 1, 2, stream.total)] == [None] * 4
    with (
        closing(StreamServer("127.0.0.1", 0, 5.0, faults_of(["stop@30"], STREAM_FAULTS), capacity=16)) as there,
        pytest.raises(StreamStopped),
    ):
        send(stream, *there.address, told.append, planned=GoingOn("my.yaml", " --strategy sqp"))
    assert told[-2].startswith("bead 0 or the way to it was begun")
    assert told[-1] == "to go on: python -m planner.solve my.yaml --from-bead 0 --strategy sqp"


def test_a_page_in_a_browser_streams_no_move() -> None:
    with closing(StreamServer("127.0.0.1", 0)) as there, closing(socket.create_connection(there.address)) as page:
        page.sendall(b"POST / HTTP/1.1\r\nContent-Length: 500\r\n\r\n" + b"x" * 500)
        assert until_over(there) not in ("", "finished") and there.state().done == 0


def test_an_interrupt_stops_the_robot() -> None:
    def interrupt(text: str) -> None:
        if not text.startswith("0 of"):
            raise KeyboardInterrupt

    with closing(StreamServer("127.0.0.1", 0, 5.0)) as there:
        with pytest.raises(KeyboardInterrupt):
            send(stream_of(printed()), *there.address, interrupt)
        assert until_over(there) == "the PC asked for it"


@pytest.mark.slow
def test_silence_stops_the_robot() -> None:
    with closing(StreamServer("127.0.0.1", 0)) as there, closing(socket.create_connection(there.address)) as pc:
        since = time.monotonic()
        assert until_over(there) == "silence of the PC" and time.monotonic() - since > 0.9 * server.SILENCE
        heard = b""
        with suppress(OSError):
            while more := pc.recv(200):
                heard += more
        assert b"X 0 silence" in heard


# ---- the command --------------------------------------------------------------------------------------------------


def test_the_command(tmp_path, capsys, monkeypatch) -> None:
    for name, text in rapid_files(in_modules(make_plan(), 50)).items():
        (tmp_path / name).write_text(text, "ascii")
    as_results(tmp_path)
    assert len(list(tmp_path.glob("*.mod"))) > 2
    made = tmp_path / "BeadwiseStream.mod"  # beside the program's own modules
    handlers = []  # of a terminal that closes

    def sent(*given):
        handlers.append(signal.getsignal(signal.SIGHUP))
        return send(*given)

    monkeypatch.setattr(stream_sender, "send", sent)
    before = signal.signal(signal.SIGHUP, signal.SIG_DFL)
    with closing(StreamServer("127.0.0.1", 0, 20.0)) as there:
        host, port = there.address
        assert main([str(tmp_path), "--controller", f"{host}:{port}", "--server", str(made)]) == 0
    assert signal.signal(signal.SIGHUP, before) is signal.SIG_DFL and callable(handlers[0])
    assert f"bsPort:={port};" in made.read_text() and "finished after" in capsys.readouterr().err
    assert main([str(tmp_path), "--controller", f"{host}:{port}"]) == 2  # nobody is there any more
    assert "no connection to" in capsys.readouterr().err
    for wrong in ("127.0.0.1:x", ":1", "127.0.0.1:0", "127.0.0.1:²"):
        assert main([str(tmp_path), "--controller", wrong]) == 2
    assert main([str(tmp_path), "--controller", "robot.local", "--server", str(made)]) == 2
    other = tmp_path / "notes.txt"
    other.write_text("mine")
    for path in (other, next(tmp_path.glob("TwoBeads.mod"))):
        before = path.read_text()
        assert main([str(tmp_path), "--server", str(path)]) == 2 and path.read_text() == before
        assert f"{path.name}: is not BeadwiseStream.mod" in capsys.readouterr().err
    assert main([str(tmp_path), "--server", str(made)]) == 0
    with pytest.raises(InputError, match="no RAPID program"):
        program_in(tmp_path / "nowhere")
    with pytest.raises(SystemExit):
        main([str(tmp_path)])
