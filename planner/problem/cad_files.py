"""STEP and IGES files: what tells them from others, and the facets of their bodies.

Open CASCADE reads them in a process of its own, because a damaged file may end its reader.
"""

from __future__ import annotations

import subprocess
from pathlib import Path
from typing import Any

from planner.base.arrays import Array, Ints
from planner.base.budgets import STEP_BYTES
from planner.base.errors import Complaint
from planner.base.files import read_bytes
from planner.base.isolated import ask

LARGEST_FILE = STEP_BYTES.most
LONGEST = 300  # s that a file may take
_BEGIN, _END = b"ISO-10303-21", b"END-ISO-10303-21"
_ENDS = 2048  # bytes of a file in which they stand
_MARK = 72  # column of an IGES file's lines, from 0, that names their section: S at first, T in the last one
_COMPRESSED, _BINARY = b"C", b"B"  # there, for the forms of IGES that hardly a program writes
STEP_ENDINGS, IGES_ENDINGS = (".step", ".stp"), (".igs", ".iges")
_KINDS = "STEP (.step, .stp) or IGES (.igs, .iges)"
_FACETS = "planner.problem.cad_facets"
CHORD = 0.01  # mm, by how much facets may leave the body: less than any nozzle's clearance or corner tolerance


def is_cad(path: Path, data: bytes) -> bool:
    """Whether a file is STEP or IGES, or called so."""
    return path.suffix.lower() in (*STEP_ENDINGS, *IGES_ENDINGS) or _BEGIN in data[:_ENDS]


def facets_of_bodies(path: Path, most: int, where: Complaint) -> tuple[Array, Ints]:
    """Corners (n, 3) [mm] of all bodies in a file, and facets (m, 3) of them, counter-clockwise seen from outside.

    Raises the InputError of a file that cannot be read, has no face, or more than so many facets.
    """
    check_step(path, where)
    request = {"file": str(path.resolve()), "chord_mm": CHORD, "most": most}
    answer = asked(_FACETS, request, path.name, where)
    if "reason" in answer:
        raise where(str(answer["reason"]), hint=str(answer["hint"]) or None)
    return answer["corners"], answer["facets"]


def check_step(path: Path, where: Complaint) -> None:
    """Raise the InputError, made by `where`, of a file that is missing, neither STEP nor IGES, or cut off."""
    data = read_bytes(path, LARGEST_FILE, where)
    name = path.name
    if is_iges(data):
        last = data.rstrip().rsplit(b"\n", 1)[-1]
        if last[_MARK : _MARK + 1] != b"T":
            raise where(f"{name} is damaged: its end is missing, the line with T in column 73", hint="export it anew")
        return
    if path.suffix.lower() in IGES_ENDINGS and _BEGIN not in data[:_ENDS]:
        if data[_MARK : _MARK + 1] in (_COMPRESSED, _BINARY):
            raise where(
                f"{name} is IGES in its binary or compressed form", hint="export it as plain (fixed ASCII) IGES"
            )
        raise where(f"{name} is no IGES file: its first line has no S in column 73", hint=f"export it as {_KINDS}")
    if _BEGIN not in data[:_ENDS]:
        raise where(f"{name} is no STEP file: it does not begin with {_BEGIN.decode()}", hint=f"export it as {_KINDS}")
    if _END not in data[-_ENDS:]:
        raise where(f"{name} is damaged: its end is missing", hint="export it anew")


def is_iges(data: bytes) -> bool:
    """Whether a file is IGES in fixed ASCII form, whatever it is called: its first line has S in column 73, and a number."""
    line = data[:_ENDS].partition(b"\n")[0].rstrip()
    return line[_MARK : _MARK + 1] == b"S" and line[_MARK + 1 :].strip().isdigit()


def asked(module: str, request: dict[str, Any], name: str, where: Complaint) -> dict[str, Any]:
    """What a module answers to a request about a file called `name`. Raises the InputError of one that cannot be read."""
    damaged = where(
        f"{name} is damaged: Open CASCADE cannot read it", hint="repair it in a CAD program, and export it anew"
    )
    try:
        answer = ask(module, request, LONGEST)
    except subprocess.TimeoutExpired:
        raise where(
            f"{name} takes more than {LONGEST} s to be read", hint="export the part without its details"
        ) from None
    if answer is None:
        raise damaged
    return answer
