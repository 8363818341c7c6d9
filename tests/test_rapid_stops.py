"""What our procedures in RAPID do when a relay answers, or does not: they are run, strictly, without a robot."""

from __future__ import annotations

import re
from importlib.resources import files
from typing import Any

import pytest
from rapid_runner import Ended, Raised, Runner, SystemStop

from planner.export.rapid.extruder import LONGEST_LINE, WINDOW, server, server_declarations

STREAM = files("planner.link").joinpath("BeadwiseStream.mod").read_text("ascii")


class Controller:
    """What a program does to a controller, in order, and the words of a relay that come in pieces."""

    def __init__(self, *pieces: str) -> None:
        self.pieces = list(pieces)
        self.done: list[str] = []
        self.connected = True

    def instructions(self) -> dict[str, Any]:
        def does(name: str) -> Any:
            return lambda *values, **named: self.done.append(" ".join([name, *map(str, values), *named]))

        names = ("StopMove", "SetDO", "TPWrite", "SocketClose", "WaitRob", "ClearPath", "StartMove")
        return {
            "SystemStopAction": self.stop_all,
            **{name: does(name) for name in names},
            "SocketPeek": self.peek,
            "SocketReceive": self.receive,
            "SocketSend": self.send,
            "SocketGetStatus": lambda socket: "SOCKET_CONNECTED" if self.connected else "SOCKET_CLOSED",
            "StrToVal": None,
            "Trunc": int,
            **{name: name for name in ("bwClient", "bwServer", "bsClient", "bsServer")},
        }

    def stop_all(self, StopBlock: bool) -> None:
        self.done.append("SystemStopAction StopBlock")
        raise Ended

    def peek(self, socket: str) -> int:
        if not self.connected:
            raise Raised("ERR_SOCK_CLOSED")
        return len(self.pieces[0]) if self.pieces else 0

    def receive(self, socket: str, Str: str, ReadNoOfBytes: int, Time: float) -> str:
        if not self.connected:
            raise Raised("ERR_SOCK_CLOSED")
        if not self.pieces:
            raise Raised("ERR_SOCK_TIMEOUT")
        here = self.pieces.pop(0)
        self.pieces[:0] = [here[ReadNoOfBytes:]] if len(here) > ReadNoOfBytes else []
        return here[:ReadNoOfBytes]

    def send(self, socket: str, Str: str) -> None:
        if not self.connected:
            raise Raised("ERR_SOCK_CLOSED")
        if len(Str) > 80:
            raise SystemStop(f"a string of {len(Str)} characters")
        self.done.append(f"says {Str}")


def program(controller: Controller, alone: bool = True) -> Runner:
    """The server of a program, with StrToVal, which alone gives a value back through a parameter."""
    text = "\n".join([*server_declarations(), *server("M" * 32, 9999999, "127.0.0.1", 1025, ["doA", "doB"], alone)])
    text = re.sub(r"whole:=StrToVal\((.*),n\);", r"n:=value(\1);\nwhole:=n<>none;", text)
    number = re.compile(r" *-?\d+(\.\d+)?")
    runner = Runner(
        text,
        {**controller.instructions(), "none": None, "value": lambda s: float(s) if number.fullmatch(s) else None},
    )
    runner.names["bwGo"] = True
    return runner


@pytest.mark.parametrize("size", [1, 2, 3, 5, 13, 38, 39, 77])
def test_answers_are_taken_in_whatever_pieces_they_come(size):
    text = "".join(f"A {n}\n" for n in range(1, 60))
    controller = Controller(*(text[k : k + size] for k in range(0, len(text), size)))
    runner = program(controller)
    runner.names["bwSent"] = 59
    runner.names["BwSettle"](2)
    assert runner.names["bwTaken"] == 59 and runner.names["bwHeard"] == ""


def test_the_longest_line_with_the_largest_number_fits():
    controller = Controller("A 9999998\n")
    runner = program(controller)
    runner.names["bwSent"] = 9999998
    runner.names["BwLine"](9999999, "G" * LONGEST_LINE)
    assert controller.done == [f"says L 9999999 {'G' * LONGEST_LINE}\n"]


ALONE, BOTH = ("ClearPath", "StartMove"), ("SystemStopAction StopBlock",)


def stopped(controller: Controller, over: tuple[str, ...] = ALONE) -> list[str]:
    """What was done at a stop, checked: rest first, outputs off at once and again at rest, nothing left to go on with."""
    done = controller.done
    stop, rest = done.index("StopMove"), done.index("WaitRob ZeroSpeed")
    off = ["SetDO doA 0", "SetDO doB 0"]
    assert done[stop + 1 : stop + 3] == off
    assert done[rest:] == ["WaitRob ZeroSpeed", *off, *over]
    return [words for words in done if words.startswith("says X")]


@pytest.mark.parametrize(
    ("pieces", "sent", "reason"),
    [
        ((), WINDOW, "no answer of the relay"),
        (("S the board has gone\n",), 3, "the relay asked for it"),
        (("A 99\n",), 3, "unknown words of the relay"),
        (("A x\n",), 3, "unknown words of the relay"),
        (("\n",), 3, "unknown words of the relay"),
        (("A\n",), 3, "unknown words of the relay"),
        (("x" * 200,), WINDOW, "unknown words of the relay"),
    ],
)
def test_a_relay_that_fails_is_told_and_the_robot_stops(pieces, sent, reason):
    controller = Controller(*pieces)
    runner = program(controller)
    runner.names["bwSent"] = sent
    with pytest.raises(Ended):
        runner.names["BwLine"](sent + 1, "G1 E1.00000 F60.000")
    assert stopped(controller) == [f"says X {sent} {reason}\n"]


def test_where_two_arms_move_together_both_tasks_are_stopped():
    """A task that has ended alone would leave the other one waiting: the controller stops them, at rest, until both begin anew."""
    controller = Controller("S the board has gone\n")
    runner = program(controller, alone=False)
    runner.names["bwSent"] = 3
    with pytest.raises(Ended):
        runner.names["BwLine"](4, "G1 E1.00000 F60.000")
    assert stopped(controller, BOTH) == ["says X 3 the relay asked for it\n"]


def test_a_lost_connection_stops_the_robot_though_nobody_hears_it():
    controller = Controller()
    controller.connected = False
    with pytest.raises(Ended):
        program(controller).names["BwLine"](1, "M83")
    assert stopped(controller) == []


@pytest.mark.parametrize("connected", [True, False])
def test_the_stream_s_server_stops_in_the_same_way(connected):
    controller = Controller()
    controller.connected = connected
    texts = re.findall(r" +PROC BsStop.*?ENDPROC\n", STREAM, re.DOTALL)
    off = "PROC BsAllOff()\nSetDO doA,0;\nSetDO doB,0;\nENDPROC\n"
    runner = Runner(off + "".join(texts), {**controller.instructions(), "bsDone": 9999999})
    with pytest.raises(Ended):
        runner.names["BsStop"]("no frames within a bead")
    assert stopped(controller) == (["says X 9999999 no frames within a bead\n"] if connected else [])


def test_every_error_of_a_streamed_move_ends_in_a_stop():
    handler = re.search(r"PROC BsMove.*?\n    ERROR\n(.*?)ENDPROC", STREAM, re.DOTALL)[1]
    assert "RAISE" not in handler and handler.strip().split("\n")[-1].strip().startswith("BsStop ")
