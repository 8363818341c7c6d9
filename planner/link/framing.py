"""Bytes from a connection → lines of bounded length."""

from __future__ import annotations

LONGEST_LINE = 256  # bytes; three times what either side may say, so anything longer is not of this protocol

_TEXT = bytes((0x09, *range(0x20, 0x7F)))


class Garbage(ValueError):
    """What came is not of the protocol; `str()` says what it was."""


class Framer:
    """Collects bytes and hands out whole lines, ASCII, without their LF or CR LF; never holds more than one line."""

    def __init__(self) -> None:
        self._begun = b""

    def lines(self, data: bytes) -> tuple[list[str], Garbage | None]:
        """Whole lines up to what is not of the protocol, and that, if there is any; after it nothing more may be fed."""
        *whole, self._begun = (self._begun + data).split(b"\n")
        out: list[str] = []
        for raw in whole:
            raw = raw.removesuffix(b"\r")
            wrong = _wrong(raw)
            if wrong is not None:
                return out, wrong
            out.append(raw.decode("ascii"))
        if len(self._begun) > LONGEST_LINE:
            return out, Garbage(f"a line of more than {LONGEST_LINE} bytes")
        return out, None


def _wrong(raw: bytes) -> Garbage | None:
    if len(raw) > LONGEST_LINE:
        return Garbage(f"a line of more than {LONGEST_LINE} bytes")
    if raw.translate(None, _TEXT):
        return Garbage(f"bytes that are not text: {raw[:24]!r}")
    return None
