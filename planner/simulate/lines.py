"""What the simulators' sockets share: listening, and reading lines of bounded length."""

from __future__ import annotations

import socket

from planner.errors import InputError

HOST = "127.0.0.1"
BLOCK = 4096  # bytes read at once


def bound_socket(host: str, port: int, kind: socket.SocketKind = socket.SOCK_STREAM) -> socket.socket:
    """A socket bound to an address, any free port for 0. Raises InputError where that cannot be had."""
    out = socket.socket(socket.AF_INET, kind)
    try:
        out.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        out.bind((host, port))
    except OSError as error:
        out.close()
        raise InputError(f"cannot listen on {host}:{port}: {error.strerror or error}", field="--port") from error
    return out


class Lines:
    """Lines of at most `longest` bytes, ended by LF, out of a stream of bytes."""

    def __init__(self, longest: int) -> None:
        self._longest = longest
        self._partial = b""

    def feed(self, data: bytes) -> list[str]:
        """The lines that are whole now, without their end. Raises ValueError for what is no line of printable ASCII."""
        *whole, self._partial = (self._partial + data).split(b"\n")
        for raw in (*whole, self._partial):
            if len(raw) > self._longest:
                raise ValueError(f"a line of more than {self._longest} bytes")
        out = []
        for raw in whole:
            text = raw.decode("ascii", errors="replace")
            if not text.isascii() or not text.isprintable():
                raise ValueError(f"not printable: {raw[:20]!r}")
            out.append(text)
        return out
