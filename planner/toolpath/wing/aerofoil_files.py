"""Points of a wing's section: from a file as the UIUC collection has them, or by NACA's formula of four digits.

Two layouts are common: Selig's (from the trailing edge around the leading edge and back) and Lednicer's (the number of
points on each side, then the upper and the lower side, both from the leading edge on).
"""

from __future__ import annotations

import math
from functools import partial
from pathlib import Path

import numpy as np

from planner.errors import Complaint, InputError
from planner.input_file import read_lines
from planner.readonly import Array

Row = tuple[int, float, float]  # line from 1, x, z

LARGEST_FILE = 1_000_000  # bytes
MOST_POINTS = 5000
FEWEST = 5  # points of a side, the leading edge among them: a curve of degree 5 needs six in all
FARTHEST = 1e6  # in the file's unit
_COMMENTS = ("#", "//", "%", ";")
_BOUNDS = 4  # numbers in a line of bounds
_NACA_POINTS = 80  # of a side
_UNEVEN_ENDS = 0.02  # chords along the chord: the largest of a whole published section is 0.009
_SAME = 1e-9  # chords: points nearer than this to each other are one


def naca_section(digits: str) -> Array:
    """Points (n, 2) of a NACA section of four digits, in chords: from the trailing edge over the upper side to the
    leading edge, (0, 0), and along the lower side back. The trailing edge is open, as in NACA report 460."""
    camber, place, thick = int(digits[0]) / 100.0, int(digits[1]) / 10.0, int(digits[2:]) / 100.0
    x = 0.5 * (1.0 - np.cos(np.linspace(0.0, np.pi, _NACA_POINTS)))
    half = 5.0 * thick * (0.2969 * np.sqrt(x) - x * (0.1260 + x * (0.3516 - x * (0.2843 - 0.1015 * x))))
    line, slope = np.zeros_like(x), np.zeros_like(x)
    if camber > 0.0:
        fore = x < place
        scale = camber / np.where(fore, place, 1.0 - place) ** 2
        line = scale * np.where(fore, x * (2.0 * place - x), 1.0 - 2.0 * place + x * (2.0 * place - x))
        slope = 2.0 * scale * (place - x)
    across = half[:, None] * np.column_stack([-slope, np.ones_like(x)]) / np.hypot(1.0, slope)[:, None]
    middle = np.column_stack([x, line])
    return np.vstack([(middle + across)[::-1], (middle - across)[1:]])


def read_section(path: Path, where: Complaint | None = None) -> Array:
    """Points (n, 2) of a section file, in chords: from the trailing edge over the upper side to the leading edge,
    (0, 0), and along the lower side back; the middle of the trailing edge is (1, 0).

    The file's unit and place are its own. Words before the first point and after the last one are passed over, and so
    are comments, blank lines and, before the first point, four numbers (bounds of a flow field, as MSES writes them);
    either side may come first. `where(reason, hint=...)` makes the InputError for what is wrong with the file as a whole.
    Raises InputError with file and line for a line that is no point, or one of no section.
    """
    complain = partial(InputError, file=path) if where is None else where
    rows = _rows(path, read_lines(path, LARGEST_FILE, complain))
    if len(rows) > MOST_POINTS:
        raise complain(f"{path.name} has more than {MOST_POINTS} points")
    if not rows:
        raise complain(f"{path.name} holds no points", hint="lines x z, as in the UIUC collection")
    first, second = _sides(path, rows, complain)
    for side in (first, second):
        if len(side) < FEWEST:
            raise complain(f"{path.name} has {len(side)} points on one side", hint=f"at least {FEWEST} on each")
        _check_forward(path, side)
    x = np.linspace(0.0, 1.0, 33)[1:-1]
    height = [np.interp(x, *_spread(side)) for side in (first, second)]
    upper, lower = (first, second) if height[0].sum() > height[1].sum() else (second, first)
    crossed = np.flatnonzero(np.interp(*(_at(lower), *_spread(upper))) < [row[2] for row in lower[1:-1]])
    if len(crossed):
        raise InputError("the lower side is above the upper side here", file=path, line=lower[1 + crossed[0]][0])
    points = np.array([row[1:] for row in upper[::-1]] + [row[1:] for row in lower])
    points = _in_chords(points, len(upper) - 1, complain, path)
    if abs(points[0, 0] - points[-1, 0]) > _UNEVEN_ENDS:
        ends = points[[0, -1], 0]
        name, side = ("upper", upper) if ends[0] < ends[1] else ("lower", lower)
        raise InputError(
            f"the {name} side ends here, at {ends.min() / ends.max():.2f} of the length of the other one",
            file=path,
            line=side[-1][0],
            hint="points towards the trailing edge are missing",
        )
    return points


def _rows(path: Path, lines: list[str]) -> list[Row]:
    """All lines that hold two numbers: one run of them, with nothing but words before and behind."""
    content = [(i, line.split()) for i, line in enumerate(lines, 1) if line.strip()]
    content = [(i, words) for i, words in content if not words[0].startswith(_COMMENTS)]
    rows: list[Row] = []
    behind: int | None = None  # the first line of words after a point
    for place, (number, words) in enumerate(content):
        values = [_number(word) for word in words]
        point = len(words) == 2 and None not in values
        if not point and (place == 0 or behind is not None or (not rows and len(words) == _BOUNDS)):
            continue
        if _is_text(words, values):
            behind = number if rows else None
            continue
        if behind is not None:
            raise InputError("is no point, but points follow", file=path, line=behind, hint="words stand at the ends")
        wrong = partial(InputError, file=path, line=number)
        if len(words) != 2:
            raise wrong(f"a point has two numbers, x z; here are {len(words)} words")
        for word, value in zip(words, values, strict=True):
            if value is None or not abs(value) <= FARTHEST:
                raise wrong(f"{word[:40]!r} is not a number" + ("" if value is None else " that a point can have"))
        x, z = (value for value in values if value is not None)
        rows.append((number, x, z))
    return rows


def _is_text(words: list[str], values: list[float | None]) -> bool:
    """Words that nobody means as a point. Two of which one is a number may be a point with a slip in it."""
    return None in values and (len(words) != 2 or values == [None, None])


def _number(word: str) -> float | None:
    try:
        return float(word) if "_" not in word else None
    except ValueError:
        return None


def _sides(path: Path, rows: list[Row], complain: Complaint) -> tuple[list[Row], list[Row]]:
    """The two sides, each from the leading edge on."""
    line, *counts = rows[0]
    rest = rows[1:]
    if all(count == round(count) and count >= 2 for count in counts) and max(row[1] for row in rest or rows) < 1.5:
        first, second = (int(count) for count in counts)
        if first + second != len(rest):
            reason = f"says that {first} and {second} points follow, but there are {len(rest)}"
            raise InputError(reason, file=path, line=line)
        return _distinct(rest[:first]), _distinct(rest[first:])
    rows = _distinct(rows)
    nose = min(range(len(rows)), key=lambda i: rows[i][1])
    if nose in (0, len(rows) - 1):
        raise complain(
            f"{path.name} has no leading edge: x is least at an end of its points",
            hint="points run from the trailing edge around the leading edge and back",
        )
    return rows[: nose + 1][::-1], rows[nose:]


def _distinct(rows: list[Row]) -> list[Row]:
    """Without points that repeat the one before."""
    size = max(row[1] for row in rows) - min(row[1] for row in rows)
    return [
        row for i, row in enumerate(rows) if i == 0 or math.dist(row[1:], rows[i - 1][1:]) > _SAME * max(size, _SAME)
    ]


def _check_forward(path: Path, side: list[Row]) -> None:
    for before, row in zip(side[:-1], side[1:], strict=True):
        if row[1] < before[1]:
            raise InputError("x runs back here, towards the leading edge", file=path, line=max(row[0], before[0]))


def _spread(side: list[Row]) -> tuple[Array, Array]:
    """x from 0 to 1 along a side, and z: what np.interp takes."""
    x, z = np.array([row[1] for row in side]), np.array([row[2] for row in side])
    return (x - x[0]) / (x[-1] - x[0]), z


def _at(side: list[Row]) -> Array:
    """x of a side's points between its ends, from 0 to 1."""
    return _spread(side)[0][1:-1]


def _in_chords(points: Array, nose: int, complain: Complaint, path: Path) -> Array:
    """Moved, turned and scaled so that the leading edge is (0, 0) and the middle of the trailing edge (1, 0)."""
    points = points[np.concatenate([[True], np.linalg.norm(np.diff(points, axis=0), axis=1) > 0.0])]
    nose = int(np.argmin(np.linalg.norm(points - points[min(nose, len(points) - 1)], axis=1)))
    away = points - points[nose]
    chord = 0.5 * (away[0] + away[-1])
    length = float(np.hypot(*chord))
    if length <= 0.0:
        raise complain(f"{path.name} has no length")
    along = chord / length
    return np.column_stack([away @ along, away @ np.array([-along[1], along[0]])]) / length
