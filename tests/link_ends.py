"""The two ends of the relay as simple machines without sockets, and a program of lines to run between them."""

from __future__ import annotations

import json
import re
from collections import deque
from pathlib import Path

from planner.base.results import digest
from planner.link.program_lines import ProgramLine, ProgramLines

MODULE = "Cup"
WINDOW = 16


def as_results(folder: Path) -> None:
    """Files of a folder as if they had been written with a plan: all that the link asks of one."""
    files = {path.name: digest(path) for path in folder.iterdir() if path.is_file() and path.name != "plan.json"}
    path = folder / "plan.json"
    data = json.loads(path.read_text("utf-8")) if path.exists() else {}
    path.write_text(json.dumps(data | {"files": files}), "utf-8")


def program(beads: int = 4, each: int = 8) -> ProgramLines:
    """Heating, then beads of lines with a cut between them, then cooling; every line's text is its own."""
    texts: list[tuple[int, str]] = [(-1, "M83"), (-1, "M109 S205")]
    for bead in range(beads):
        texts += [(bead, f"G1 E0.{100 + bead * each + k} F300") for k in range(each)]
        texts.append((-1, "M106 P0 S0" if bead % 2 else "G4 P500"))
    texts.append((-1, "M104 S0"))
    lines = (ProgramLine(n, bead, max(bead, 0) // 2, 0.1 * n, text) for n, (bead, text) in enumerate(texts, 1))
    return ProgramLines(MODULE, tuple(lines))


class Controller:
    """Says the program's lines as the protocol has it, within its window; `lines` are what it has in mind."""

    def __init__(self, lines: ProgramLines) -> None:
        self.lines = lines
        self.said = self.acknowledged = 0
        self.going = self.stopped = self.ended = False
        self.heard: list[str] = []
        self._begun = b""

    def hello(self) -> bytes:
        return f"H {MODULE} {len(self.lines)}\n".encode()

    def hears(self, data: bytes) -> None:
        *whole, self._begun = (self._begun + data).split(b"\n")
        for text in map(bytes.decode, whole):
            self.heard.append(text)
            if text.startswith("S "):
                self.stopped = True
            elif text == "G 1" and not self.going:
                self.going = True
            else:
                assert text == f"A {self.acknowledged + 1}", f"{text!r} after A {self.acknowledged}"
                self.acknowledged += 1

    def says(self) -> bytes:
        """The next message, or nothing if it must wait."""
        if not self.going or self.stopped or self.ended:
            return b""
        if self.said == len(self.lines):
            self.ended = True
            return f"E {self.said}\n".encode()
        if self.said - self.acknowledged >= WINDOW:
            return b""
        self.said += 1
        return f"L {self.said} {self.lines[self.said].text}\n".encode()


class Board:
    """Carries out what comes with a right checksum, answers in turn, and keeps a record."""

    def __init__(self, numbered: bool) -> None:
        self.numbered = numbered
        self.done: list[tuple[int, str]] = []  # lines of the program, in the order in which they were carried out
        self.plain: list[str] = []
        self.answers: deque[bytes] = deque()
        self._begun = b""
        self._resent = 0

    def hears(self, data: bytes) -> None:
        *whole, self._begun = (self._begun + data).split(b"\n")
        for raw in whole:
            self.takes(raw)

    def takes(self, raw: bytes) -> None:
        found = re.fullmatch(rb"(N(\d+) ([^*]+))\*(\d+)", raw)
        if found is None:
            self.plain.append(raw.decode("ascii", "replace"))
            self.answers.append(b"ok\r\n")
            return
        checksum = 0
        for byte in found[1]:
            checksum ^= byte
        n = int(found[2])
        if checksum != int(found[4]):
            self._resent = n
            self.answers.append(b"Resend: %d\r\n" % n)
            return
        self.done.append((n, found[3].decode()))
        self.answers.append(b"ok N%d\r\n" % n if self.numbered or n == self._resent else b"ok\r\n")

    def says(self) -> bytes:
        return self.answers.popleft() if self.answers else b""
