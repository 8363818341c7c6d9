"""The server's end of a web socket (RFC 6455): the handshake, outgoing text, and the few frames that a client sends."""

from __future__ import annotations

import base64
import hashlib
import select
import socket
import struct
from email.message import Message

_KEY = b"258EAFA5-E914-47DA-95CA-C5AB0DC85B11"  # RFC 6455, 1.3
TEXT, CLOSE, PING, PONG = 0x1, 0x8, 0x9, 0xA
LONGEST = 125  # bytes of a client's frame: only pings and closing


class SocketClosed(Exception):
    """The other end has gone, or violates the protocol."""


def accepted(headers: Message[str, str], subprotocol: str) -> bytes | None:
    """The answer that upgrades a request to a web socket; None if the request is not for one."""
    key = headers.get("Sec-WebSocket-Key", "")
    upgrade = headers.get("Upgrade", "").lower() == "websocket" and headers.get("Sec-WebSocket-Version") == "13"
    if not upgrade or not key.isascii():
        return None
    proof = base64.b64encode(hashlib.sha1(key.encode() + _KEY, usedforsecurity=False).digest()).decode()
    lines = (
        "HTTP/1.1 101 Switching Protocols",
        "Upgrade: websocket",
        "Connection: Upgrade",
        f"Sec-WebSocket-Accept: {proof}",
        f"Sec-WebSocket-Protocol: {subprotocol}",
    )
    return ("\r\n".join(lines) + "\r\n\r\n").encode("ascii")


class WebSocket:
    """One connection after its handshake."""

    def __init__(self, connection: socket.socket) -> None:
        self._connection, self._begun = connection, b""

    def say(self, text: str, opcode: int = TEXT) -> None:
        """Send a frame."""
        data = text.encode("utf-8")
        length = bytes([len(data)]) if len(data) <= LONGEST else b"\x7e" + struct.pack(">H", len(data))
        self.raw(bytes([0x80 | opcode]) + length + data)

    def raw(self, data: bytes) -> None:
        """Send bytes as they are."""
        try:
            self._connection.sendall(data)
        except OSError as error:
            raise SocketClosed from error

    def heard(self, seconds: float) -> list[tuple[int, str]]:
        """Frames (opcode, text) received within a time [s]."""
        try:
            if select.select([self._connection], [], [], seconds)[0]:
                data = self._connection.recv(4096)
                if not data:
                    raise SocketClosed
                self._begun += data
        except (OSError, ValueError) as error:
            raise SocketClosed from error
        out = []
        while (frame := self._frame()) is not None:
            out.append(frame)
        return out

    def _frame(self) -> tuple[int, str] | None:
        if len(self._begun) < 2:
            return None
        length = self._begun[1] & 0x7F
        if not self._begun[1] & 0x80 or length > LONGEST:
            raise SocketClosed  # a client's frames are masked, and long ones are not expected
        if len(self._begun) < 6 + length:
            return None
        opcode, mask, data = self._begun[0] & 0x0F, self._begun[2:6], self._begun[6 : 6 + length]
        self._begun = self._begun[6 + length :]
        return opcode, bytes(byte ^ mask[k % 4] for k, byte in enumerate(data)).decode("utf-8", "replace")
