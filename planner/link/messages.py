"""The messages on both connections of the relay: lines of bounded length, parsed strictly, written in one place."""

from __future__ import annotations

import re
from dataclasses import dataclass

# ----------------------------------------------------------------------------------------------------
# Framing: bytes from a connection → lines of bounded length.

LONGEST_LINE = 256  # bytes; three times the longest message, so anything longer does not belong to this protocol

_TEXT = bytes((0x09, *range(0x20, 0x7F)))


class Garbage(ValueError):
    """A line that does not belong to the protocol; `str()` describes it."""


class Framer:
    """Collects bytes and returns whole lines of ASCII without their LF or CR LF; never holds more than one line."""

    def __init__(self) -> None:
        self._begun = b""

    def lines(self, data: bytes) -> tuple[list[str], Garbage | None]:
        """Whole lines up to any garbage, and that garbage, after which nothing more may be fed."""
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


# ----------------------------------------------------------------------------------------------------
# Messages.
#
# The program's socket (the controller is the server): lines of ASCII ended by LF, at most 80 characters.
# The board: RepRapFirmware over TCP; plain G-code to it, `ok`, `Error: …`, `Resend: …`, `!!` or information from it.

LONGEST_SAID = 80  # characters; RAPID's longest string
LONGEST_GCODE = 70
LONGEST_STOP = 37  # characters to the controller, which reads pieces of 38 bytes
MOST_LINES = 10_000_000
_NUMBER = r"(0|[1-9][0-9]{0,7})"
_HELLO = re.compile(rf"H ([A-Za-z][A-Za-z0-9_]{{0,31}}) {_NUMBER}")
_LINE = re.compile(rf"L {_NUMBER} (.+)")
_END = re.compile(rf"E {_NUMBER}")
_STOPPED = re.compile(rf"X {_NUMBER} (.*)")
_GCODE = re.compile(r"[GMT][0-9]+(\.[0-9]+)?( [\x21-\x7e][\x20-\x7e]*)?")
_OK = re.compile(rf"ok(?: N{_NUMBER})?(?: .*)?")
_RESEND = re.compile(rf"(?:Resend|rs): ?N?{_NUMBER}")
_JAM = re.compile(
    r"(?:Error: |Warning: )?Filament error on extruder [0-9]{1,3}\b.*"
)  # RepRapFirmware's filament monitor


@dataclass(frozen=True)
class Hello:
    """The program has connected: its module, and how many lines it will send."""

    module: str
    lines: int


@dataclass(frozen=True)
class Line:
    """Line `n` (from 1) for the board."""

    n: int
    gcode: str


@dataclass(frozen=True)
class End:
    """The program has ended after `n` lines."""

    n: int


@dataclass(frozen=True)
class Stopped:
    """The controller has stopped of its own accord after line `n`."""

    n: int
    reason: str


@dataclass(frozen=True)
class Ok:
    """The board took a line: line `n` if stated, else the oldest one."""

    n: int | None


@dataclass(frozen=True)
class Resend:
    """The board asks for line `n` again, since its checksum was wrong."""

    n: int


@dataclass(frozen=True)
class Trouble:
    """The board reports an error."""

    text: str


@dataclass(frozen=True)
class Jam:
    """The board's filament monitor reports that filament does not move as it should, or has run out."""

    text: str


@dataclass(frozen=True)
class Remark:
    """The board says something that requires no action."""

    text: str


ControllerMessage = Hello | Line | End | Stopped
BoardMessage = Ok | Resend | Trouble | Jam | Remark


def is_gcode(text: str) -> bool:
    """Whether this can be sent to the board as a line: one code, no comment, no star, which would begin a checksum."""
    return len(text) <= LONGEST_GCODE and _GCODE.fullmatch(text) is not None and not set(text) & {"*", ";"}


def from_controller(text: str) -> ControllerMessage:
    """Parse a line from the program's socket; raises Garbage for anything that is not of the protocol."""
    if len(text) <= LONGEST_SAID:
        if found := _LINE.fullmatch(text):
            if is_gcode(found[2]):
                return Line(int(found[1]), found[2])
        elif found := _HELLO.fullmatch(text):
            return Hello(found[1], int(found[2]))
        elif found := _END.fullmatch(text):
            return End(int(found[1]))
        elif found := _STOPPED.fullmatch(text):
            return Stopped(int(found[1]), found[2])
    raise Garbage(repr(text[:LONGEST_SAID]))


def from_board(text: str) -> BoardMessage:
    """Parse a line from the board; anything but an acknowledgement, a resend request or an error is a remark."""
    if found := _OK.fullmatch(text):
        return Ok(None if found[1] is None else int(found[1]))
    if found := _RESEND.fullmatch(text):
        return Resend(int(found[1]))
    if _JAM.fullmatch(text):
        return Jam(text)
    if text.startswith(("Error", "!!", "Resend", "rs", "halt")):
        return Trouble(text)
    return Remark(text)


def to_board(n: int, gcode: str) -> bytes:
    """Line n for the board, with number and checksum (the exclusive or of all bytes before the star)."""
    line = f"N{n} {gcode}".encode("ascii")
    checksum = 0
    for byte in line:
        checksum ^= byte
    return line + f"*{checksum}\n".encode("ascii")


def to_board_plain(gcode: str) -> bytes:
    """A line that is not part of the program: without a number, so that it is never mistaken for one that is."""
    return gcode.encode("ascii") + b"\n"


def go(n: int) -> bytes:
    """Answer to a hello: start with line n."""
    return f"G {n}\n".encode("ascii")


def acknowledged(n: int) -> bytes:
    """Tell the controller that the board took every line up to n."""
    return f"A {n}\n".encode("ascii")


def stop(reason: str) -> bytes:
    """Tell the controller to stop now."""
    return ("S " + re.sub(r"[^\x20-\x7e]", "?", reason))[:LONGEST_STOP].encode("ascii") + b"\n"
