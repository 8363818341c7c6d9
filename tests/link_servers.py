"""The two ends of the relay on loopback sockets, each in a thread, with one fault at a chosen line."""

from __future__ import annotations

import socket
import struct
import threading
import time

from link_ends import Board, Controller

from planner.link.program_lines import ProgramLines

GONE = struct.pack("ii", 1, 0)  # SO_LINGER that makes close a reset


class End:
    """A server of one connection in a thread. `fault` is a word, `at` the line at which it strikes."""

    def __init__(self, fault: str | None, at: int) -> None:
        self.fault, self.at = fault, at
        self.listener = socket.create_server(("127.0.0.1", 0))
        self.listener.settimeout(10.0)
        self.address: tuple[str, int] = self.listener.getsockname()
        self.ended_by = ""  # how the connection ended: "closed" or "reset" by the relay, "fault" by this end
        self.thread = threading.Thread(target=self._serve, daemon=True)
        self.thread.start()

    def _serve(self) -> None:
        try:
            made, _ = self.listener.accept()
        except OSError:
            return  # closed before anyone came
        with self.listener, made:
            made.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            made.settimeout(0.02)
            try:
                self.ended_by = "closed" if self.talk(made) else "fault"
            except OSError:
                self.ended_by = "reset"

    def talk(self, made: socket.socket) -> bool:
        raise NotImplementedError

    def close(self) -> None:
        self.listener.close()
        self.thread.join(5.0)
        assert not self.thread.is_alive()

    def strike(self, made: socket.socket) -> bool:
        """Do what the fault asks for; whether the connection is to be left at once."""
        if self.fault == "close":
            return True
        if self.fault == "reset":
            made.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, GONE)
            return True
        if self.fault == "half":
            made.sendall(b"o" if isinstance(self, BoardEnd) else b"L 1")
            return True
        said = {
            "garbage": b"\x00\xff\x80\r\n",
            "long": b"y" * 300,
            "error": b"Error: Heater 1 fault\r\n",
            "wrong ack": b"ok N9999\r\n",
            "again": b"L 1 M83\n",
            "hello": b"H Cup 39\n",
            "gives up": b"X 3 axis 5 overload\n",
            "flood": b"T:200\r\n" * 20_000,
        }.get(self.fault or "", b"")
        if said:
            made.sendall(said)
        return False


def receive(made: socket.socket) -> bytes | None:
    """What came; empty if nothing did, None at the end."""
    try:
        return made.recv(1024) or None
    except TimeoutError:
        return b""


class ControllerEnd(End):
    def __init__(self, lines: ProgramLines, fault: str | None = None, at: int = 0) -> None:
        self.core = Controller(lines)
        super().__init__(fault, at)

    def talk(self, made: socket.socket) -> bool:
        made.sendall(self.core.hello())
        struck = False
        while True:
            if self.fault is not None and not struck and self.core.said >= self.at:
                struck = True
                if self.fault == "deaf":
                    time.sleep(1.0)
                if self.strike(made):
                    return False
            said = self.core.says()
            if said:
                made.sendall(said)
                made.settimeout(0.0005)
            else:
                made.settimeout(0.02)
            data = receive(made)
            if data is None:
                return True
            self.core.hears(data)


class BoardEnd(End):
    def __init__(self, numbered: bool = False, fault: str | None = None, at: int = 0) -> None:
        self.core = Board(numbered)
        self.may_go_on = threading.Event()  # what a board that is "held" waits for
        super().__init__(fault, at)

    def talk(self, made: socket.socket) -> bool:
        struck = False
        while True:
            if self.fault is not None and not struck and len(self.core.done) >= self.at:
                struck = True
                if self.fault == "dumb":
                    while receive(made) is not None:
                        pass
                    return True
                if self.fault == "slow":
                    time.sleep(0.1)
                if self.fault == "held":
                    self.may_go_on.wait(10.0)
                if self.fault == "resend":
                    made.sendall(b"Resend: %d\r\n" % (len(self.core.done) + 7))
                if self.strike(made):
                    return False
            data = receive(made)
            if data is None:
                return True
            self.core.hears(data)
            while answer := self.core.says():
                made.sendall(answer)
