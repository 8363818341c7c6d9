"""Programs split into parts that a controller can load: sections cut to size and packed into files."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence
from typing import TypeVar
from zlib import crc32

from planner.export.moves import MoveSection

Item = TypeVar("Item")

CONTINUED = "continued"


def cut(sections: Iterable[MoveSection], most: int) -> Iterator[MoveSection]:
    """The sections, those of more than `most` moves cut into pieces; all but the first piece are called continued."""
    for section in sections:
        for first in range(section.moves.start, section.moves.stop, most):
            own = range(first, min(first + most, section.moves.stop))
            about = section.about if own.start == section.moves.start else f"{CONTINUED} {section.about}".strip()
            yield MoveSection(section.number, own, about)


def packed(items: Iterable[Item], sizes: Iterable[int], most: int, count: int) -> list[list[Item]]:
    """Items grouped in order, at most `most` in total size and `count` items each; a larger item is a group alone."""
    groups: list[list[Item]] = []
    room = -1
    for item, size in zip(items, sizes, strict=True):
        if size > room or len(groups[-1]) == count:
            groups.append([])
            room = most
        groups[-1].append(item)
        room -= size
    return groups


def in_files(sections: Iterable[MoveSection], most: int) -> list[list[MoveSection]]:
    """Sections in groups of at most `most` moves; only sections longer than that are cut."""
    pieces = list(cut(sections, most))
    return packed(pieces, (len(piece.moves) for piece in pieces), most, max(1, len(pieces)))


def numbered(name: str, k: int, longest: int, separator: str = "_") -> str:
    """Name of the k-th part of a program, at most `longest` characters; a suffix for where a print resumes is kept.

    A name that has to be cut gets digits from a checksum of the whole name, so that parts of other programs differ.
    """
    resumed = re.search(r"(?i)from\d+$", name)
    tail = (resumed[0] if resumed else "") + f"{separator}{k}"
    whole = name[: resumed.start()] if resumed else name
    room = longest - len(tail)
    if len(whole) <= room:
        return whole + tail
    own = f"{crc32(whole.encode()) & 511:03d}"[: max(room - 1, 0)]  # nine bits; leaves room for the leading letter
    return whole[: room - len(own)] + own + tail


def part_about(lines: Sequence[str], k: int, parts: int) -> list[str]:
    """Header of the k-th of `parts` files: the first two lines of the program's own header, and which part it is."""
    return [*lines[:2], f"Part {k} of {parts}"]
