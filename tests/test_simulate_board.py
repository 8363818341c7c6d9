"""The simulated extruder's board: what it accepts, when, and what it has fed; its network; its faults."""

from __future__ import annotations

import math
import socket
import time
from contextlib import closing, suppress

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from planner.base.errors import InputError
from planner.simulate import servers
from planner.simulate.board import AMBIENT_C, BOARD_FAULTS, LONGEST_LINE, NOZZLE, QUEUE, Board, Faults, faults_of
from planner.simulate.servers import DISCARDED, TURNED_AWAY, BoardServer, is_http


def framed(n: int, text: str) -> bytes:
    body = f"N{n} {text}".encode()
    total = 0
    for byte in body:
        total ^= byte
    return body + b"*%d\n" % total


def board(*faults: str) -> Board:
    return Board(Faults(faults_of(faults, BOARD_FAULTS)), tool=0)


def texts(replies) -> list[str]:
    return [reply.text for reply in replies]


def test_moves_take_their_time_and_feed_their_tool() -> None:
    b = board()
    assert texts(b.receive(framed(1, "M83") + framed(2, "T1") + framed(3, "G1 E2 F120"), 0.0)) == [
        "ok N1",
        "ok N2",
        "ok N3",
    ]
    assert b.next_change() == pytest.approx(1.0)
    b.advance(0.999)
    assert not b.idle and b.record.filament == {}
    b.advance(1.0)
    assert b.idle and b.record.filament == {1: 2.0}


def test_without_a_tool_it_refuses_to_extrude() -> None:
    b = Board()
    said = texts(b.receive(framed(1, "M83") + framed(2, "G1 E2 F120") + framed(3, "T0") + framed(4, "G1 E2 F120"), 0.0))
    assert said == ["ok N1", "Error: Attempting to extrude with no tool selected", "ok N2", "ok N3", "ok N4"]
    b.advance(10.0)
    assert b.record.filament == {0: 2.0}


def test_e_is_absolute_until_m83() -> None:
    b = board()
    for n, text in enumerate(["G1 E5 F600", "G1 E7", "G92 E0", "G1 E1", "M83", "G1 E1", "G1 E-0.5"], 1):
        b.receive(framed(n, text), 10.0 * n)
    b.advance(100.0)
    assert b.record.filament == {0: pytest.approx(5 + 2 + 1 + 1 - 0.5)}


def test_queue_holds_back_the_ok_of_what_does_not_fit() -> None:
    b = board()
    lines = b"".join(framed(n, "G1 E1 F60") for n in range(1, QUEUE + 3))
    assert len(b.receive(b"M83\n" + lines, 0.0)) == 1 + QUEUE
    assert texts(b.advance(0.99)) == []
    assert texts(b.advance(1.0)) == [f"ok N{QUEUE + 1}"]
    assert texts(b.advance(10.0)) == [f"ok N{QUEUE + 2}"]


def test_waits_are_acknowledged_when_they_are_over() -> None:
    b = board()
    assert texts(
        b.receive(b"M83\n" + framed(1, "G1 E1 F60") + framed(2, "G4 P500") + framed(3, "M106 P0 S1"), 0.0)
    ) == [
        "ok",
        "ok N1",
    ]
    assert texts(b.advance(1.499)) == []
    assert texts(b.advance(1.5)) == ["ok N2", "ok N3"]
    assert b.record.fans == {0: 1.0}


def test_several_commands_in_a_line_are_done_in_turn_and_acknowledged_once() -> None:
    b = board()
    assert texts(b.receive(framed(1, "M106 P0 S1 G4 P500 M106 P0 S0 G4 P500") + framed(2, "M104 S20"), 0.0)) == []
    b.advance(0.25)
    assert b.record.fans == {0: 1.0}
    assert texts(b.advance(0.999)) == [] and b.record.fans == {0: 0.0}
    assert texts(b.advance(1.0)) == ["ok N1", "ok N2"]
    assert [text for _, text in b.record.accepted] == ["M106 P0 S1 G4 P500 M106 P0 S0 G4 P500", "M104 S20"]


def test_heating_takes_as_long_as_the_curve_says() -> None:
    b = board()
    b.receive(framed(1, "M109 S200"), 0.0)
    expected = NOZZLE.time_constant * math.log((NOZZLE.limit - AMBIENT_C) / (NOZZLE.limit - 200.0))
    assert b.next_change() == pytest.approx(expected) and 60 < expected < 180
    b.advance(expected / 2)
    assert AMBIENT_C + 20 < b.temperatures()[0] < 180
    assert texts(b.advance(expected)) == ["ok N1"]
    assert b.temperatures()[0] == pytest.approx(200.0)
    b.receive(framed(2, "M104 S0"), expected)
    b.advance(expected + 1e4)
    assert b.temperatures()[0] == pytest.approx(AMBIENT_C, abs=0.1)


@pytest.mark.parametrize(
    ("line", "start"),
    [
        ("M998 P3", "Warning: M998: Command is not supported"),
        ("G1 X10 E1", "Error: G1: insufficient axes"),
        ("T9", "Error: Tool 9"),
        ("M104 S900", "Error: M104"),
        ("bla", "Warning: "),
    ],
)
def test_what_it_cannot_do_it_says_and_acknowledges(line: str, start: str) -> None:
    b = board()
    said, ok = texts(b.receive(framed(1, line), 0.0))
    assert said.startswith(start) and ok == "ok N1"
    assert b.record.accepted == []


def test_wrong_checksums() -> None:
    b = board()
    assert texts(b.receive(b"N7 G1 E1 F60*1\n", 0.0)) == ["Resend: 7"]
    assert texts(b.receive(b"G1 E1 F60*1\n", 0.0)) == []
    assert texts(b.receive(framed(7, "G1 E1 F60"), 0.0)) == ["ok N7"]
    assert b.record.accepted == [(7, "G1 E1 F60")]


def test_a_line_too_long_is_dropped_whole() -> None:
    b = board()
    long = b"G1 E1 " + b"1" * (LONGEST_LINE * 3)
    assert not b.receive(long[:100], 0.0) and not b.receive(long[100:], 0.0)
    said = texts(b.receive(b"999\n" + framed(1, "M83"), 0.0))
    assert said == ["Error: G-Code buffer 'telnet' length overflow", "ok N1"]


def test_faults_of_the_board() -> None:
    b = board("error@2")
    assert texts(b.receive(framed(1, "M83") + framed(2, "G1 E1 F60"), 0.0))[1].startswith("Error: G1")
    b = board("resend@1")
    assert texts(b.receive(framed(1, "M83"), 0.0) + b.receive(framed(1, "M83"), 0.0)) == ["Resend: 1", "ok N1"]
    b = board("fatal@2")
    assert texts(b.receive(framed(1, "M83") + framed(2, "M83") + framed(3, "M83"), 0.0)) == ["ok N1", "!!"]
    assert b.record.accepted == [(1, "M83")]
    b = board("jam@2")
    said = texts(b.receive(b"".join(framed(n, "G1 E1 F60") for n in range(1, 20)), 0.0) + b.advance(1e6))
    assert any(text.startswith("Error: Filament error") for text in said)
    assert sum(text.startswith("ok") for text in said) == 1 + QUEUE and not b.idle
    assert b.record.filament == {0: 1.0}


@pytest.mark.parametrize("word", ["dorp@3", "drop", "drop@0", "drop@1:x", "drop@-1", "DROP@1"])
def test_what_is_no_fault_is_told(word: str) -> None:
    with pytest.raises(InputError, match="fault"):
        faults_of([word], BOARD_FAULTS)


@settings(max_examples=60, deadline=None)
@given(
    st.lists(st.sampled_from(["G1 E0.5 F300", "G4 P40", "M106 P0 S1", "T1", "T0", "M83"]), max_size=30),
    st.lists(st.integers(1, 40), min_size=1, max_size=30),
    st.lists(st.floats(0.0, 0.3), min_size=1, max_size=30),
)
def test_however_lines_arrive_each_is_done_once_in_order(lines, cuts, pauses) -> None:
    data = b"".join(framed(n, text) for n, text in enumerate(lines, 1))
    b, now, said, k = Board(tool=0), 0.0, [], 0
    while data:
        piece, data = data[: cuts[k % len(cuts)]], data[cuts[k % len(cuts)] :]
        said += b.receive(piece, now)
        now += pauses[k % len(pauses)]
        k += 1
    said += b.advance(now + 100.0)
    assert texts(said) == [f"ok N{n}" for n in range(1, len(lines) + 1)]
    assert b.record.accepted == list(enumerate(lines, 1)) and b.idle


@settings(max_examples=60, deadline=None)
@given(st.binary(max_size=2000), st.integers(1, 300))
def test_any_bytes_leave_it_standing(data: bytes, cut: int) -> None:
    b = Board(tool=0)
    for k in range(0, len(data), cut):
        b.receive(data[k : k + cut], 0.01 * k)
    if not b.halted:
        assert texts(b.receive(b"\n" + framed(1, "M115"), 1e6))[-1] == "ok N1"


def connected(server: BoardServer) -> socket.socket:
    out = socket.create_connection(server.address, timeout=3.0)
    time.sleep(DISCARDED + 0.4)  # it counts from when it has seen the connection
    return out


def heard(connection: socket.socket, count: int) -> bytes:
    data = b""
    while data.count(b"\r\n") < count:
        piece = connection.recv(4096)
        if not piece:
            break
        data += piece
    return data


@pytest.mark.slow
def test_network_of_the_board() -> None:
    with closing(
        BoardServer("127.0.0.1", 0, 100.0, faults_of(["delay@3:0.2", "drop@5"], BOARD_FAULTS), tool=0)
    ) as server:
        with closing(socket.create_connection(server.address, timeout=3.0)) as one:
            one.sendall(framed(1, "G1 E99 F1"))  # too early: thrown away
            time.sleep(DISCARDED + 0.4)  # it counts from when it has seen the connection
            with closing(socket.create_connection(server.address, timeout=3.0)) as other:
                assert other.recv(10) == b""  # one at a time
            one.sendall(framed(1, "M83") + framed(2, "G1 E1 F6000"))
            assert heard(one, 2) == b"ok N1\r\nok N2\r\n"
            since = time.monotonic()
            one.sendall(framed(3, "M106 P0 S1") + framed(4, "M107"))
            assert heard(one, 2) == b"ok N3\r\nok N4\r\n" and time.monotonic() - since >= 0.2
            one.sendall(framed(5, "G1 E1 F6000"))
            assert heard(one, 1) == b""
        time.sleep(0.1)
        assert [n for n, _ in server.record().accepted] == [1, 2, 3, 4, 5]
        assert server.record().filament == {0: 2.0}


def test_password_of_the_board() -> None:
    with closing(BoardServer("127.0.0.1", 0, password="tea")) as server, closing(connected(server)) as one:
        assert heard(one, 1) == b"Please enter your password:\r\n"
        one.sendall(b"coffee\n")
        assert heard(one, 1) == b"Invalid password\r\n"
        one.sendall(b"tea\r\n")
        assert heard(one, 1) == b"Log in successful!\r\n"
        one.sendall(b"M83\n")
        assert heard(one, 1) == b"ok\r\n"


@pytest.mark.slow(keep=1)
@pytest.mark.parametrize(
    "head", ["POST / HTTP/1.1\r\nHost: 127.0.0.1\r\n", "PUT /x HTTP/1.1\r\n", "OPTIONS * HTTP/1.1\r\n"]
)
@pytest.mark.parametrize("pieces", [1, 3])
def test_a_page_in_a_browser_cannot_post_to_the_board(head: str, pieces: int, monkeypatch) -> None:
    """A body that comes once the board throws nothing away any more is not taken for G-code; the next one is served."""
    monkeypatch.setattr(servers, "DISCARDED", 0.1)
    with closing(BoardServer("127.0.0.1", 0, tool=0)) as server:
        with closing(socket.create_connection(server.address)) as page:
            page.settimeout(2.0)
            data = f"{head}Content-Length: 30\r\n\r\n".encode()
            for k in range(pieces):
                page.sendall(data[3 * k : None if k == pieces - 1 else 3 * (k + 1)])
                time.sleep(0.02)
            time.sleep(0.15)
            with suppress(OSError):
                page.sendall(b"M83\nG1 E5 F300\nM106 P0 S1\n")
                assert page.recv(100) == b""
        record = server.record()
        assert record.accepted == [] and record.fans == {} and record.warnings == [TURNED_AWAY]
        with closing(connected(server)) as link:
            link.sendall(b"M115\n")
            assert b"ok" in heard(link, 2)


def test_no_line_of_a_board_is_http() -> None:
    for line in (b"M83", b"G1 E5 F300", b"N1 T0*22", b"M98 P/sys/x.g", b"T0", b"PASSWORD 1", b""):
        assert not is_http(line)
