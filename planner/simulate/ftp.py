"""The controller's FTP server, limited to what an upload needs (RFC 959, 2428, 3659): one folder, HOME."""

from __future__ import annotations

import hmac
import socket
import socketserver
import threading
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from planner.base.errors import InputError
from planner.simulate.board import Fault, Faults
from planner.simulate.controller import LARGEST_FILE, Controller, Denied
from planner.simulate.servers import is_http

PATIENCE = 30.0  # s without a command, after which a connection is closed
LONGEST = 512  # bytes of a command
FOLDER = "/HOME"
BLOCK = 65536
FTP_FAULTS = {
    "refuse": "answers the command with 550, and does nothing",
    "drop": "closes the connection instead of answering",
    "mute": "answers nothing for VALUE seconds",
    "cut": "keeps half of what is stored, but reports success",
    "garbage": "answers with bytes that are not FTP",
}


@dataclass(frozen=True)
class FtpAccess:
    """User and password of the server."""

    user: str = "Default User"
    password: str = "robotics"


class FtpServer:
    """Serves the controller's HOME, in separate threads. Faults count commands after the login."""

    def __init__(
        self, host: str, port: int, controller: Controller, access: FtpAccess, faults: Sequence[Fault] = ()
    ) -> None:
        the_faults, the_count, the_ending = Faults(faults), [0], threading.Event()

        class FtpHandler(_FtpConnection):
            the_controller, the_access, faults = controller, access, the_faults
            count, ending = the_count, the_ending

        try:
            self._server = socketserver.ThreadingTCPServer((host, port), FtpHandler)
        except OSError as error:
            raise InputError(
                f"cannot listen on {host}:{port}: {error.strerror or error}", field="--ftp-port"
            ) from error
        self._ending, self._count = the_ending, the_count
        self._server.daemon_threads = True
        self.address: tuple[str, int] = self._server.server_address[:2]  # type: ignore[assignment]
        self._thread = threading.Thread(target=self._server.serve_forever, args=(0.05,), name="ftp", daemon=True)
        self._thread.start()

    @property
    def commands(self) -> int:
        """Number of commands so far, after the login."""
        return self._count[0]

    def close(self) -> None:
        """End the threads and close all sockets."""
        self._ending.set()
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()


class _FtpConnection(socketserver.StreamRequestHandler):
    """One command connection."""

    the_controller: Controller
    the_access: FtpAccess
    faults: Faults
    count: list[int]
    ending: threading.Event
    timeout = PATIENCE

    def handle(self) -> None:
        self._user, self._let_in, self._folder = "", False, "/"
        self._passive: socket.socket | None = None
        try:
            self._say("220 ready")
            while line := self.rfile.readline(LONGEST + 1):
                if is_http(line):
                    return
                word, _, rest = line.decode("latin-1").rstrip("\r\n").partition(" ")
                if len(line) > LONGEST or not self._do(word.upper(), rest):
                    return
        except OSError:
            return  # the other end has gone
        finally:
            if self._passive is not None:
                self._passive.close()

    def _do(self, word: str, rest: str) -> bool:
        """Carry out a command; returns whether the connection continues."""
        if word == "QUIT":
            self._say("221 bye")
            return False
        if word in ("USER", "PASS"):
            self._log_in(word, rest)
            return True
        if not self._let_in:
            self._say("530 not logged in")
            return True
        self.count[0] += 1
        number, faults = self.count[0], self.faults
        if faults.take("drop", number):
            return False
        if mute := faults.take("mute", number):
            self.ending.wait(mute.value)
        if faults.take("garbage", number):
            self.wfile.write(b"\xff\xfe?\r\n")
            return False
        if faults.take("refuse", number):
            self._say("550 refused")
            return True
        deeds: dict[str, Any] = {
            "TYPE": lambda: self._say("200 type set"),
            "PWD": lambda: self._say(f'257 "{self._folder}"'),
            "CWD": lambda: self._enter(rest),
            "PASV": lambda: self._listen(extended=False),
            "EPSV": lambda: self._listen(extended=True),
            "SIZE": lambda: self._size(rest),
            "STOR": lambda: self._store(rest, bool(faults.take("cut", number))),
        }
        deeds.get(word, lambda: self._say("502 no such command"))()
        return True

    def _log_in(self, word: str, rest: str) -> None:
        if word == "USER":
            self._user = rest
            self._say("331 password")
            return
        right = hmac.compare_digest(rest.encode("latin-1"), self.the_access.password.encode())
        self._let_in = right and self._user == self.the_access.user
        self._say("230 logged in" if self._let_in else "530 login incorrect")

    def _enter(self, folder: str) -> None:
        place = folder if folder.startswith("/") else f"{self._folder.rstrip('/')}/{folder}"
        if place.rstrip("/") not in ("", FOLDER):
            self._say("550 no such folder")
            return
        self._folder = place.rstrip("/") or "/"
        self._say("250 changed")

    def _listen(self, extended: bool) -> None:
        if self._passive is not None:
            self._passive.close()
        host = self.connection.getsockname()[0]
        self._passive = socket.create_server((host, 0))
        self._passive.settimeout(PATIENCE)
        port = self._passive.getsockname()[1]
        if extended:
            self._say(f"229 entering extended passive mode (|||{port}|)")
        else:
            self._say(f"227 entering passive mode ({host.replace('.', ',')},{port // 256},{port % 256})")

    def _size(self, name: str) -> None:
        try:
            self._say(f"213 {len(self.the_controller.get(f'$HOME/{name}'))}")
        except Denied as denied:
            self._say(f"550 {denied.reason}")

    def _store(self, name: str, cut: bool) -> None:
        if self._passive is None or self._folder != FOLDER:
            self._say("425 no connection for data" if self._passive is None else "550 not here")
            return
        self._say("150 go on")
        data = b""
        with self._passive, self._passive.accept()[0] as made:
            made.settimeout(PATIENCE)
            while len(data) <= LARGEST_FILE and (piece := made.recv(BLOCK)):
                data += piece
        self._passive = None
        try:
            self.the_controller.put(f"$HOME/{name}", data[: len(data) // 2] if cut else data)
            self._say("226 stored")
        except Denied as denied:
            self._say(f"550 {denied.reason}")

    def _say(self, text: str) -> None:
        self.wfile.write(text.encode("latin-1") + b"\r\n")
