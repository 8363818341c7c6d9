"""An SVG shape as lines, cubics and arcs, and these as chords.

Path data is checked here, because svgelements silently skips what it cannot read.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from typing import Literal

import numpy as np
import svgelements

from planner.base.arrays import Array
from planner.base.budgets import SVG_SEGMENTS
from planner.toolpath.svg.document import COMMA, MAX_COORDINATE, MAX_POINTS, NUMBER, SPACE, Node

NUMBER_COUNTS = {"M": 2, "L": 2, "T": 2, "H": 1, "V": 1, "C": 6, "S": 4, "Q": 4}
ARGUMENTS = {letter: COMMA.join([f"({NUMBER})"] * count) for letter, count in NUMBER_COUNTS.items()}
ARGUMENTS["A"] = COMMA.join([f"({NUMBER})"] * 3 + ["([01])"] * 2 + [f"({NUMBER})"] * 2)
SEQUENCES = {letter: re.compile(rf"{SPACE}{one}(?:{COMMA}{one})*+{SPACE}") for letter, one in ARGUMENTS.items()}
SEQUENCES["Z"] = re.compile(SPACE)
VALUES = {letter: re.compile(one) for letter, one in ARGUMENTS.items()}
ROUND = {"rect": svgelements.Rect, "circle": svgelements.Circle, "ellipse": svgelements.Ellipse}
SIZES = {"rect": ("width", "height"), "circle": ("r",), "ellipse": ("rx", "ry")}
PLACES = {"rect": ("x", "y", "rx", "ry"), "circle": ("cx", "cy"), "ellipse": ("cx", "cy")}


@dataclass(frozen=True)
class OutlinePiece:
    """A part of an outline, in user units; an affine map of its points maps the piece.

    lines: points (k, 2), vertices | cubic: points (4, 2), Bézier controls
    arc:   points (5, 2), start, end, centre c, c + u, c + v: the curve c + u cos θ + v sin θ, from θ = first over sweep
    """

    kind: Literal["lines", "cubic", "arc"]
    points: Array
    first: float = 0.0
    sweep: float = 0.0

    @property
    def ends(self) -> Array:
        """First and last point (2, 2)."""
        return self.points[:2] if self.kind == "arc" else self.points[[0, -1]]

    def at(self, t: Array) -> Array:
        """Points (n, 2) of a curve at parameters t (n,) in 0 … 1."""
        t = t[:, None]
        if self.kind == "cubic":
            a, b, c, d = self.points
            s = 1 - t
            return s * s * s * a + 3 * s * s * t * b + 3 * s * t * t * c + t * t * t * d
        angle, centre = self.first + self.sweep * t, self.points[2]
        return centre + (self.points[3] - centre) * np.cos(angle) + (self.points[4] - centre) * np.sin(angle)

    def extremes(self) -> Array:
        """Points (m, 2) that have the same bounding box as the piece."""
        if self.kind == "lines":
            return self.points
        if self.kind == "cubic":
            a, b, c = np.diff(self.points, axis=0)
            with np.errstate(all="ignore"):  # no root, or one at infinity: NaN and inf fall out below
                p, q = a - 2 * b + c, 2 * (b - a)  # B'(t) = 3 (p t² + q t + a)
                half = -0.5 * (q + np.where(q < 0, -1, 1) * np.sqrt(q * q - 4 * p * a))
                t = np.concatenate([half / p, a / half])
        else:
            u, v = self.points[3:] - self.points[2]
            angles = np.arctan2(v, u)[:, None] + np.arange(-8, 9) * np.pi
            t = (angles.ravel() - self.first) / (self.sweep or 1.0)
        return np.vstack([self.ends, self.at(t[(t > 0) & (t < 1)])])

    def count(self, tolerance: float) -> int:
        """Number of equal steps in t whose chords stay within the tolerance: error <= max |B''| h² / 8."""
        p = self.points
        if self.kind == "lines":
            return len(p) - 1
        if self.kind == "cubic":
            along = p[3] - p[0]
            t = np.clip((p[1:3] - p[0]) @ along / max(float(along @ along), 1e-300), 0, 1)
            if np.hypot(*(p[0] + t[:, None] * along - p[1:3]).T).max() <= 1e-3 * tolerance:
                return 1  # straight: a curve lies in the hull of its controls
            bend, span = 6 * float(np.hypot(*np.diff(p, n=2, axis=0).T).max()), 1.0
        else:
            bend, span = float(np.linalg.norm(p[3:] - p[2], 2)), abs(self.sweep)
        return max(1, math.ceil(min(span * math.sqrt(bend / (8 * tolerance)), 2.0 * MAX_POINTS)))

    def flat(self, count: int) -> Array:
        """Vertices of the piece: a curve's `count` chords, with its ends exactly."""
        if self.kind == "lines":
            return self.points
        points = self.at(np.linspace(0, 1, count + 1))
        points[[0, -1]] = self.ends
        return points


Subpath = tuple[tuple[OutlinePiece, ...], bool]  # and whether it is closed


def subpaths_of(node: Node) -> list[Subpath]:
    """Return the subpaths of a shape in its own user units."""
    if node.tag == "line":
        ends = np.reshape([node.length(name) or 0.0 for name in ("x1", "y1", "x2", "y2")], (2, 2))
        return [((OutlinePiece("lines", ends),), False)]
    if node.tag in ("polyline", "polygon"):
        points = _listed_points(node)
        closed = node.tag == "polygon"
        return [((OutlinePiece("lines", np.vstack([points, points[:1]]) if closed else points),), closed)]
    if node.tag == "path":
        letters, data = path_commands(node)
        if not letters:
            return []
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

    Both are empty if there is none. svgelements silently stops or skips at errors, so it is given only data that has
    passed this check.
    """
    data = node.attributes.get("d", "").strip()
    if data in ("", "none"):
        return "", ""
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
        SVG_SEGMENTS.check(len(letters), "from here on it has", node.error, "draw it in several files")
        at = end
    return "".join(letters), re.sub(r"([0-9]\.)(?![0-9])", r"\g<1>0", data)  # svgelements does not know "1."


def _mend_smooth(letters: str, segments: list[svgelements.PathSegment]) -> None:
    """Make S and T reflect only controls of their own kind (SVG 1.1, 8.3.6): svgelements reflects any."""
    for k, (letter, segment) in enumerate(zip(letters, segments, strict=True)):
        if letter == "S" and letters[k - 1] not in "CS":
            segment.control1 = segment.start
        elif letter == "T":
            middle, last = segment.start, segments[k - 1]
            reflected = letters[k - 1] in "QT"
            x, y = (2 * middle.x - last.control.x, 2 * middle.y - last.control.y) if reflected else (middle.x, middle.y)
            segment.control = svgelements.Point(x, y)


def _pieces(node: Node, segments: list[svgelements.PathSegment]) -> list[Subpath]:
    """Return the pieces of each subpath; consecutive straight segments make one piece."""
    subpaths: list[Subpath] = []
    pieces: list[OutlinePiece] = []
    line: list[tuple[float, float]] = []

    def end_line() -> None:
        if len(line) > 1 or not pieces:
            pieces.append(OutlinePiece("lines", np.array(line)))
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


def _curve(node: Node, segment: svgelements.PathSegment) -> OutlinePiece | None:
    """Return the piece of a curved segment; None for a straight one, which includes an arc without a radius."""
    if isinstance(segment, svgelements.CubicBezier):
        return OutlinePiece("cubic", _array(segment.start, segment.control1, segment.control2, segment.end))
    if isinstance(segment, svgelements.QuadraticBezier):
        a, b, c = _array(segment.start, segment.control, segment.end)
        return OutlinePiece("cubic", np.array([a, (a + 2 * b) / 3, (2 * b + c) / 3, c]))
    if not isinstance(segment, svgelements.Arc) or segment.rx == 0 or segment.ry == 0:
        return None
    points = _array(segment.start, segment.end, segment.center, segment.prx, segment.pry)
    arc = OutlinePiece("arc", points, float(segment.get_start_t()), float(segment.sweep))
    gap = arc.at(np.array([0.0, 1.0])) - arc.ends
    if not np.abs(gap).max() <= 1e-6 * float(np.hypot(*(points[1] - points[0]))) + 1e-9:
        raise node.error(f"an arc at {points[0].tolist()} is too flat to be computed", "draw a line")
    return arc


def _array(*points: svgelements.Point) -> Array:
    return np.array([(point.x, point.y) for point in points])
