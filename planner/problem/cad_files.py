"""STEP and IGES files: how to recognise them, and the facets of their bodies.

Open CASCADE reads them in a separate process, because a damaged file may crash its reader.
"""

from __future__ import annotations

import re
import subprocess
from pathlib import Path
from typing import Any

from planner.base.arrays import Array, Ints
from planner.base.budgets import STEP_BYTES
from planner.base.errors import Complaint
from planner.base.files import read_bytes
from planner.base.isolated import Killed, ask

LARGEST_FILE = STEP_BYTES.most
LONGEST = 300  # s that reading a file may take
_BEGIN, _END = b"ISO-10303-21", b"END-ISO-10303-21"
_ENDS = 2048  # bytes at the ends of a file that contain them
_WIDTH = 80  # columns of an IGES file's lines
_TEXT = re.compile(rb"\s*(\d{1,5})H")  # precedes a string in its header: the number of its characters
_MARK = 72  # column of an IGES file's lines, from 0, that names their section: S in the first, T in the last
_COMPRESSED, _BINARY = b"C", b"B"  # in that column: forms of IGES that hardly any program writes
STEP_ENDINGS, IGES_ENDINGS = (".step", ".stp"), (".igs", ".iges")
_KINDS = "STEP (.step, .stp) or IGES (.igs, .iges)"
_FACETS = "planner.problem.cad_facets"
CHORD = 0.01  # mm that facets may be off the body: less than any nozzle's clearance or corner tolerance


def is_cad(path: Path, data: bytes) -> bool:
    """Whether a file is STEP or IGES, by its contents or its name."""
    return path.suffix.lower() in (*STEP_ENDINGS, *IGES_ENDINGS) or _BEGIN in data[:_ENDS]


def facets_of_bodies(path: Path, most: int, where: Complaint) -> tuple[Array, Ints]:
    """Corners (n, 3) [mm] and facets (m, 3) of all bodies in a file, counter-clockwise seen from outside.

    Raises InputError for a file that cannot be read, has no face, or has more than `most` facets.
    """
    check_step(path, where)
    request = {"file": str(path.resolve()), "chord_mm": CHORD, "most": most}
    answer = asked(_FACETS, request, path.name, where)
    return answer["corners"], answer["facets"]


def check_step(path: Path, where: Complaint) -> None:
    """Raise InputError, made by `where`, for a file that is missing, neither STEP nor IGES, or truncated."""
    data = read_bytes(path, LARGEST_FILE, where)
    name = path.name
    if is_iges(data):
        lines = _lines(data)
        if lines[-1][_MARK : _MARK + 1] != b"T":
            raise where(f"{name} is damaged: its end is missing, the line with T in column 73", hint="export it again")
        wrong = _wrong_header(lines)
        if wrong is not None:
            raise where(f"{name} is damaged: {wrong}, so the unit of its lengths is unknown", hint="export it again")
        return
    if path.suffix.lower() in IGES_ENDINGS and _BEGIN not in data[:_ENDS]:
        if data[_MARK : _MARK + 1] in (_COMPRESSED, _BINARY):
            raise where(
                f"{name} is IGES in its binary or compressed form", hint="export it as plain (fixed ASCII) IGES"
            )
        raise where(f"{name} is not an IGES file: its first line has no S in column 73", hint=f"export it as {_KINDS}")
    if _BEGIN not in data[:_ENDS]:
        raise where(
            f"{name} is not a STEP file: it does not begin with {_BEGIN.decode()}", hint=f"export it as {_KINDS}"
        )
    if _END not in data[-_ENDS:]:
        raise where(f"{name} is damaged: its end is missing", hint="export it again")


def is_iges(data: bytes) -> bool:
    """Whether a file is IGES in fixed ASCII form, whatever its name: line 1 has S in column 73, and a number."""
    line = _lines(data[:_ENDS])[0].rstrip()
    return line[_MARK : _MARK + 1] == b"S" and line[_MARK + 1 :].strip().isdigit()


def _lines(data: bytes) -> list[bytes]:
    """The lines of an IGES file; some programs write them without line breaks, each 80 characters long."""
    data = data.rstrip()
    if b"\n" in data:
        return [line.rstrip(b"\r") for line in data.split(b"\n")]
    return [data[i : i + _WIDTH] for i in range(0, max(len(data), 1), _WIDTH)]


def _wrong_header(lines: list[bytes]) -> str | None:
    """What is wrong with an IGES file's header; None if it can be read.

    If a string (such as 2HMM) is not as long as it says, readers take what follows for another value, and they skip a
    line that is shifted: a file in millimetres becomes one in inches.
    """
    header = b""
    for i, line in enumerate(lines, 1):
        mark = line[_MARK : _MARK + 1]
        if mark == b"D":
            break
        if mark not in (b"S", b"G"):
            return f"line {i}, in its header, has neither S nor G in column 73"
        header += line[:_MARK].ljust(_MARK) if mark == b"G" else b""
    place, number, between, end = 0, 1, b",", b";"
    while place < len(header):
        text = _TEXT.match(header, place)
        if text is not None:
            place = text.end() + int(text[1])
            told = header[text.end() : place]
            between, end = (told or between if number == 1 else between), (told or end if number == 2 else end)
            if header[place:].lstrip()[:1] not in (between, end):
                return f"value {number} of its header is a text whose stated length is wrong"
        stop = re.compile(b"[" + re.escape(between + end) + b"]").search(header, place)
        if stop is None or stop[0] == end:
            break
        place, number = stop.end(), number + 1
    return None


def asked(module: str, request: dict[str, Any], name: str, where: Complaint) -> dict[str, Any]:
    """A module's answer to a request about a file called `name`. Raises InputError if it cannot be read."""
    damaged = where(
        f"{name} is damaged: Open CASCADE cannot read it", hint="repair it in a CAD program, and export it again"
    )
    try:
        answer = ask(module, request, LONGEST)
    except subprocess.TimeoutExpired:
        raise where(f"{name} takes more than {LONGEST} s to read", hint="export the part without its details") from None
    except Killed as killed:
        raise where(f"{name} cannot be read: {killed}", hint="export the part without its details") from None
    if answer is None:
        raise damaged
    if "reason" in answer:
        raise where(str(answer["reason"]), hint=str(answer["hint"]) or None)
    return answer
