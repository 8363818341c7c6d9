"""The pieces of one SVG shape. Path data is checked here, because svgelements skips in silence what it cannot read."""

from __future__ import annotations

import re

import numpy as np
import svgelements

from planner.readonly import Array
from planner.toolpath.svg.document import COMMA, MAX_COORDINATE, MAX_POINTS, NUMBER, SPACE, Node
from planner.toolpath.svg.pieces import Piece, Subpath

NUMBER_COUNTS = {"M": 2, "L": 2, "T": 2, "H": 1, "V": 1, "C": 6, "S": 4, "Q": 4}
ARGUMENTS = {letter: COMMA.join([f"({NUMBER})"] * count) for letter, count in NUMBER_COUNTS.items()}
ARGUMENTS["A"] = COMMA.join([f"({NUMBER})"] * 3 + ["([01])"] * 2 + [f"({NUMBER})"] * 2)
SEQUENCES = {letter: re.compile(rf"{SPACE}{one}(?:{COMMA}{one})*+{SPACE}") for letter, one in ARGUMENTS.items()}
SEQUENCES["Z"] = re.compile(SPACE)
VALUES = {letter: re.compile(one) for letter, one in ARGUMENTS.items()}
ROUND = {"rect": svgelements.Rect, "circle": svgelements.Circle, "ellipse": svgelements.Ellipse}
SIZES = {"rect": ("width", "height"), "circle": ("r",), "ellipse": ("rx", "ry")}
PLACES = {"rect": ("x", "y", "rx", "ry"), "circle": ("cx", "cy"), "ellipse": ("cx", "cy")}


def subpaths_of(node: Node) -> list[Subpath]:
    """Return the subpaths of a shape in its own user units."""
    if node.tag == "line":
        ends = np.reshape([node.length(name) or 0.0 for name in ("x1", "y1", "x2", "y2")], (2, 2))
        return [((Piece("lines", ends),), False)]
    if node.tag in ("polyline", "polygon"):
        points = _listed_points(node)
        closed = node.tag == "polygon"
        return [((Piece("lines", np.vstack([points, points[:1]]) if closed else points),), closed)]
    if node.tag == "path":
        letters, data = path_commands(node)
        segments = list(svgelements.Path(data))
        _mend_smooth(letters, segments)
        return _pieces(node, segments)
    lengths = {name: node.length(name) for name in SIZES[node.tag] + PLACES[node.tag]}
    if not all(lengths[name] for name in SIZES[node.tag]):
        raise node.error(f"without {' and '.join(SIZES[node.tag])} it draws nothing")
    given = {name: value for name, value in lengths.items() if value is not None}
    return _pieces(node, list(svgelements.Path(ROUND[node.tag](**given))))


def _listed_points(node: Node) -> Array:
    """Return the vertices (n, 2) of a polyline or polygon."""
    text = node.attributes.get("points", "").strip()
    match = SEQUENCES["L"].match(text)
    end = 0 if match is None else match.end()
    if match is None or end < len(text):
        raise node.error(f"points are not pairs of numbers from character {end + 1}: {text[end : end + 30]!r}")
    points = np.array([float(number) for number in re.findall(NUMBER, text)]).reshape(-1, 2)
    if not (np.abs(points) <= MAX_COORDINATE).all():
        raise node.error(f"points lie beyond {MAX_COORDINATE:g} user units")
    return points


def path_commands(node: Node) -> tuple[str, str]:
    """Check path data against the grammar (SVG 1.1, 8.3.9); return the letter of each segment, and the data.

    svgelements stops or skips in silence at errors, so it is given nothing that has not passed here.
    """
    data = node.attributes.get("d", "").strip()
    if data in ("", "none"):
        raise node.error("it has no path data, so it draws nothing")
    letters: list[str] = []
    at = 0
    while at < len(data):
        letter = data[at].upper()
        known = letter in SEQUENCES and (letter == "M" or at > 0)
        match = SEQUENCES[letter].match(data, at + 1) if known else None
        end = match.end() if match else at
        if match is None or (end < len(data) and data[end].upper() not in SEQUENCES):
            raise node.error(f"path data is wrong from character {end + 1}: {data[end : end + 30]!r}")
        count = 0
        for group in VALUES[letter].finditer(match[0]) if letter != "Z" else ():
            count += 1
            if not all(abs(float(number)) <= MAX_COORDINATE for number in group.groups()):
                raise node.error(f"path data goes beyond {MAX_COORDINATE:g} user units: {group[0][:40]!r}")
        letters += [letter] + ["L" if letter == "M" else letter] * (count - 1)
        if len(letters) > MAX_POINTS:
            raise node.error(f"it has more than {MAX_POINTS} segments")
        at = end
    return "".join(letters), re.sub(r"([0-9]\.)(?![0-9])", r"\g<1>0", data)  # svgelements does not know "1."


def _mend_smooth(letters: str, segments: list[svgelements.PathSegment]) -> None:
    """Let S and T reflect only controls of their own kind (SVG 1.1, 8.3.6): svgelements reflects any."""
    for k, (letter, segment) in enumerate(zip(letters, segments, strict=True)):
        if letter == "S" and letters[k - 1] not in "CS":
            segment.control1 = segment.start
        elif letter == "T":
            middle, last = segment.start, segments[k - 1]
            reflected = letters[k - 1] in "QT"
            x, y = (2 * middle.x - last.control.x, 2 * middle.y - last.control.y) if reflected else (middle.x, middle.y)
            segment.control = svgelements.Point(x, y)


def _pieces(node: Node, segments: list[svgelements.PathSegment]) -> list[Subpath]:
    """Return the pieces of each subpath; straight segments that follow each other make one piece."""
    subpaths: list[Subpath] = []
    pieces: list[Piece] = []
    line: list[tuple[float, float]] = []

    def end_line() -> None:
        if len(line) > 1 or not pieces:
            pieces.append(Piece("lines", np.array(line)))
        line.clear()

    def end_subpath(closed: bool) -> None:
        if line:
            end_line()
            subpaths.append((tuple(pieces), closed))
            pieces.clear()

    for segment in segments:
        if isinstance(segment, svgelements.Move):
            end_subpath(False)
        else:
            if not line:  # Z without an M after it: a new subpath starts where the last one did
                line.append((segment.start.x, segment.start.y))
            curve = _curve(node, segment)
            if curve is not None:
                if len(line) > 1:
                    end_line()
                line.clear()
                pieces.append(curve)
        line.append((segment.end.x, segment.end.y))
        if isinstance(segment, svgelements.Close):
            end_subpath(True)
    end_subpath(False)
    return subpaths


def _curve(node: Node, segment: svgelements.PathSegment) -> Piece | None:
    """Return the piece of a curved segment; None for a straight one, which includes an arc without a radius."""
    if isinstance(segment, svgelements.CubicBezier):
        return Piece("cubic", _array(segment.start, segment.control1, segment.control2, segment.end))
    if isinstance(segment, svgelements.QuadraticBezier):
        a, b, c = _array(segment.start, segment.control, segment.end)
        return Piece("cubic", np.array([a, (a + 2 * b) / 3, (2 * b + c) / 3, c]))
    if not isinstance(segment, svgelements.Arc) or segment.rx == 0 or segment.ry == 0:
        return None
    points = _array(segment.start, segment.end, segment.center, segment.prx, segment.pry)
    arc = Piece("arc", points, float(segment.get_start_t()), float(segment.sweep))
    gap = arc.at(np.array([0.0, 1.0])) - arc.ends
    if not np.abs(gap).max() <= 1e-6 * float(np.hypot(*(points[1] - points[0]))) + 1e-9:
        raise node.error(f"an arc at {points[0].tolist()} is too flat to be computed", "draw a line")
    return arc


def _array(*points: svgelements.Point) -> Array:
    return np.array([(point.x, point.y) for point in points])
