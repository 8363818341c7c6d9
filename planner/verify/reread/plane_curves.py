"""Drawings, patterns and NURBS curves read again, as polylines in the plane from which curves are projected.

Files are read by other libraries' interpreters, patterns follow from the geometry of their cells, NURBS from de Boor's
recursion: nothing here depends on how the planner reads them. Lengths are in metres; x to the right, y up, the middle
at the origin.
"""

from __future__ import annotations

import io
import json
import re
import subprocess
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from planner.base.arrays import Array
from planner.base.isolated import Killed, ask
from planner.problem.cad_files import is_cad, is_iges
from planner.problem.drawings import CurvesSpec, DxfSpec, NurbsSpec, PatternSpec, SvgSpec

_STEPS, _MOST_STEPS = 96, 10_000  # usual and greatest number of chords of a curved piece of an SVG path
_OFF = 1e-5  # m: such chords may lie this far off; otherwise there are more
_FINE = 1e-5  # × a DXF curve's size: its chords may lie this far off
_SPANS = 200  # chords between the knots of a NURBS curve
# Features that svgelements ignores (clipping), or draws where they are defined instead of where they are used.
_HIDDEN = {"clip paths or masks": ("<clippath", "<mask", ":clippath", ":mask"), "symbols": ("<symbol", ":symbol")}
_PATHS = re.compile(rb"""(\s(?:d|points)\s*=\s*)("[^"]*"|'[^']*')""")
_NO_DATA = re.compile(rb"""(<(?:\w+:)?path)(?=[\s/>])(?!(?:[^<>"']|"[^"]*"|'[^']*')*?\sd\s*=)""")
_FONTS = re.compile(rb"@font-face\s*\{[^{}]*\}", re.IGNORECASE)
_UNPAINTED = ("none", "transparent")
_SHEETS = re.compile(rb"<(?:\w+:)?style\b[^>]*>(.*?)</(?:\w+:)?style>", re.DOTALL)
_BESIDE_RULES = re.compile(rb"/\*.*?\*/|<!\[CDATA\[|\]\]>", re.DOTALL)
_RULE = re.compile(rb"([^{}]*)\{([^{}]*)\}")
_SELECTOR = re.compile(rb"[\w-]+|#[\w-]+|[\w-]*\.[\w-]+")  # those that svgelements reads correctly
_OF_SIGHT = re.compile(rb"(?<![\w-])(?:fill|stroke|display|visibility|(?:fill|clip)-rule|(?:fill-)?opacity)\s*:")
_WORD = re.compile(rb"[\w-]+")
_ROUNDED = 1e-12  # × coordinates: points this near are one
_INSUNITS = {1: 25.4, 2: 304.8, 3: 1609344.0, 4: 1.0, 5: 10.0, 6: 1e3, 7: 1e6, 8: 25.4e-6, 9: 0.0254, 10: 914.4}  # mm
_INSUNITS |= {11: 1e-7, 12: 1e-6, 13: 1e-3, 14: 100.0, 15: 1e4, 16: 1e5}
_INSUNITS |= {21: 304.8006096, 22: 25.4000508, 23: 914.4018288, 24: 1609347.2187}  # US survey foot, inch, yard, mile
_LINES = {"LINE", "ARC", "CIRCLE", "ELLIPSE", "SPLINE", "LWPOLYLINE", "POLYLINE", "HELIX"}
_UNITS = {"mm": 1.0, "cm": 10.0, "m": 1000.0, "in": 25.4, "ft": 304.8, "um": 1e-3}  # mm
_LONGEST = 300  # s that Open CASCADE may take
_ROOM = 1e-9  # m: tolerance for cells that just fit

Curves = tuple[Array, ...]


@dataclass(frozen=True)
class NotRead:
    """Why a source is not read again, in words."""

    why: str


def gone(error: OSError) -> NotRead:
    """The reason that a file used for planning is gone or can no longer be read."""
    return NotRead(f"{Path(error.filename or '').name}: {error.strerror}")


def read_again(source: SvgSpec | DxfSpec | PatternSpec | CurvesSpec | NurbsSpec) -> Curves | NotRead:
    """Polylines (n, 2), or (n, 3) for curves in space, of a source [m], with chords within 0.01 mm of its curves."""
    try:
        if isinstance(source, SvgSpec):
            stamp = source.svg.stat()
            return _svg(source.svg, source.width, stamp.st_mtime_ns, stamp.st_size)
        if isinstance(source, DxfSpec):
            stamp = source.dxf.stat()
            return _dxf(source.dxf, source.width, source.unit, source.layers, stamp.st_mtime_ns, stamp.st_size)
        if isinstance(source, NurbsSpec):
            return _nurbs_file(source.nurbs)
    except OSError as error:
        return gone(error)
    if isinstance(source, PatternSpec):
        return _PATTERNS[source.pattern](source)
    return tuple(_nurbs(each.degree, np.asarray(each.points), each.weights, each.knots) for each in source.curves)


@lru_cache(maxsize=4)
def _svg(path: Path, width: float, changed: int, size: int) -> Curves | NotRead:
    """The visible outlines of a drawing by svgelements, `width` [m] wide; `changed` and `size` identify the file."""
    text = path.read_bytes()
    small = text.lower()
    for what, names in _HIDDEN.items():
        if any(name.encode() in small for name in names):
            return NotRead(f"the drawing has {what}")
    for sheet in _SHEETS.finditer(text):
        named = _named(sheet[1])
        if named is None:
            return NotRead("its style sheet shows and hides by selectors that are not read")
        if any(word[0] in named for word in _WORD.finditer(text, 0, sheet.start())):
            return NotRead("its style sheet comes after the elements that it shows and hides")
    from svgelements import SVG, Shape
    from svgelements import Path as Outline

    shapes = [
        shape
        for shape in SVG.parse(io.BytesIO(_as_parsed(text)), reify=True).elements()
        if isinstance(shape, Shape) and shape.values.get("visibility") not in ("hidden", "collapse")
    ]
    parts = [
        (_painted(shape), pieces)
        for shape in shapes
        for part in abs(Outline(shape)).as_subpaths()
        if _is_line(_joined(pieces := _pieces(part)))
    ]
    seen = [pieces for painted, pieces in parts if painted] or [pieces for _, pieces in parts]
    wide = float(np.ptp(np.concatenate([_joined(pieces) for pieces in seen])[:, 0])) if seen else 0.0
    off = _OFF * wide / width or np.inf
    lines = (np.concatenate([_finer(*piece, off) for piece in pieces]) for pieces in seen)
    return _as_wide(_once(("", line) for line in lines), width, np.array([1.0, -1.0]))


def _named(sheet: bytes) -> set[bytes] | None:
    """The tags, ids and classes whose visibility a style sheet sets; None if a rule may be misread."""
    rules = _RULE.findall(_BESIDE_RULES.sub(b"", sheet))
    said = [each.strip() for selectors, body in rules if _OF_SIGHT.search(body) for each in selectors.split(b",")]
    if not (all(_SELECTOR.fullmatch(each) for each in said) and all(body.strip() for _, body in rules)):
        return None  # svgelements loses the rule after an empty one
    return {each.removeprefix(b"#").rpartition(b".")[2] for each in said}


def _painted(shape: Any) -> bool:
    """Whether a shape is filled or stroked."""
    paints = (str(shape.values.get(name, "")).strip().lower() for name in ("fill", "stroke"))
    return any(paint not in _UNPAINTED for paint in paints)


def _is_line(points: Array) -> bool:
    """Whether points (n, 2) are more than a single one."""
    return len(points) > 1 and float(np.ptp(points, axis=0).max()) > _ROUNDED * float(np.abs(points).max())


def _as_parsed(text: bytes) -> bytes:
    """The drawing changed so that svgelements reads it correctly.

    svgelements ends a path at a number like "1.", fails at a path without data, continues S from Q or T, and T from C
    or S, unless a line is between them, and treats whatever follows the address of a font as a comment.
    """

    def mended(found: re.Match[bytes]) -> bytes:
        data = re.sub(rb"([0-9]\.)(?![0-9])", rb"\g<1>0", found[2])
        return found[1] + re.sub(rb"[QqTt][^A-DF-Za-df-z]*(?=[Ss])|[CcSs][^A-DF-Za-df-z]*(?=[Tt])", rb"\g<0>l0 0", data)

    return _PATHS.sub(mended, _NO_DATA.sub(rb'\1 d=""', _FONTS.sub(b"", text)))


def _pieces(part: Iterable[Any]) -> list[tuple[Any, Array]]:
    """The segments of a subpath, with None in place of straight ones, and points (n, 2) along each."""
    from svgelements import Close, Line, Move

    out: list[tuple[Any, Array]] = []
    for segment in part:
        if isinstance(segment, (Line, Close)):
            ends = [(p.x, p.y) for p in (segment.start, segment.end) if p is not None]
            out += [(None, np.array(ends, dtype=float))] if ends else []
        elif not isinstance(segment, Move):
            out.append((segment, _along_segment(segment, _STEPS)))
    return out


def _joined(pieces: Sequence[tuple[Any, Array]]) -> Array:
    return np.concatenate([np.zeros((0, 2)), *(points for _, points in pieces)])


def _along_segment(segment: Any, steps: int) -> Array:
    return np.array(segment.npoint(np.linspace(0.0, 1.0, steps + 1)), dtype=np.float64)


def _finer(segment: Any, points: Array, off: float) -> Array:
    """Points (n, 2) along a segment, with chords at most `off` from it; those of a straight one are kept."""
    if segment is None:
        return points
    bulge = float(np.linalg.norm(np.diff(points, 2, axis=0), axis=1).max()) / 8.0
    steps = int(np.ceil(_STEPS * np.sqrt(bulge / off)))
    return points if steps <= _STEPS else _along_segment(segment, min(steps, _MOST_STEPS))


@lru_cache(maxsize=4)
def _dxf(
    path: Path, width: float | None, unit: str | None, names: tuple[str, ...] | None, changed: int, size: int
) -> Curves | NotRead:
    """The lines of a drawing by ezdxf's own paths, blocks exploded; in its unit, or scaled to `width` [m]."""
    from ezdxf import recover
    from ezdxf.lldxf.const import DXFError

    try:
        document, _ = recover.readfile(path)
        layers = {layer.dxf.name.lower(): layer for layer in document.layers}
        off = {name for name, layer in layers.items() if layer.is_off() or layer.is_frozen()}
        wanted = None if names is None else {name.lower() for name in names}
        frozen = {name for name in off if wanted is None and layers[name].is_frozen()}
        lines = _once(
            (layer, _along(entity))
            for entity, layer in _entities(document.modelspace(), frozen)
            if (layer not in off if wanted is None else layer in wanted)
        )
    except (DXFError, ArithmeticError, TypeError, ValueError) as error:
        return NotRead(f"ezdxf makes no paths of the drawing: {error}")
    if width is not None:
        return _as_wide(lines, width, np.ones(2))
    lines = [line for line in lines if len(line) > 1]
    scale = _UNITS[unit] if unit is not None else _INSUNITS.get(document.header.get("$INSUNITS", 0), 1.0)
    return _centred(lines, np.full(2, scale * 1e-3)) if lines else NotRead("the drawing has no lines")


def _along(entity: Any) -> Array:
    """Points (n, 2) along an entity: ezdxf's own path, or de Boor's recursion for splines, which that only nears."""
    from ezdxf.path import make_path

    if entity.dxftype() == "SPLINE":
        tool = entity.construction_tool()
        places = np.array([(p.x, p.y) for p in tool.control_points])
        return _nurbs(tool.degree, places, tool.weights() or None, tool.knots())
    if entity.dxftype() == "POLYLINE":  # flag 16: a control point of a spline, stored along with its own vertices
        entity.vertices[:] = [vertex for vertex in entity.vertices if not vertex.dxf.flags & 16] or entity.vertices
    path = make_path(entity)
    if not len(path):
        return np.zeros((0, 2))
    size = float(np.ptp([(p.x, p.y) for p in path.control_vertices()], axis=0).max())
    return np.array([(p.x, p.y) for p in path.flattening(max(_FINE * size, 1e-12))])


def _entities(
    container: Iterable[Any], frozen: Collection[str], inherited: str | None = None
) -> Iterator[tuple[Any, str]]:
    """The visible entities that are lines, blocks exploded, each with the layer that it is on."""
    for entity in container:
        layer = entity.dxf.layer.lower()
        if layer == "0" and inherited is not None:
            layer = inherited
        if entity.dxf.get("invisible", 0):
            continue
        if entity.dxftype() == "INSERT" and layer not in frozen:
            for one in entity.multi_insert() if entity.mcount > 1 else (entity,):
                yield from _entities(one.virtual_entities(), frozen, layer)
        elif entity.dxftype() in _LINES:
            yield entity, layer


def _once(lines: Iterable[tuple[str, Array]]) -> list[Array]:
    """Lines (n, 2) of layers, without exact copies within a layer, in either direction."""
    return list({(layer, min(line.tobytes(), line[::-1].tobytes())): line for layer, line in lines}.values())


def _as_wide(lines: Sequence[Array], width: float, sense: Array) -> Curves | NotRead:
    """Lines scaled to `width` [m] and centred; sense (2): signs of their axes."""
    lines = [line for line in lines if len(line) > 1]
    if not lines:
        return NotRead("the drawing has no lines")
    wide = float(np.ptp(np.concatenate(lines)[:, 0]))
    return _centred(lines, sense * width / wide) if wide > 0.0 else NotRead("the drawing has no width")


def _centred(lines: Sequence[Array], scale: Array) -> Curves:
    """Lines (n, 2) scaled to metres, with the middle of their bounding box at the origin."""
    every = np.concatenate(lines)
    middle = 0.5 * (every.min(axis=0) + every.max(axis=0))
    return tuple((line - middle) * scale for line in lines)


def _inside(spec: PatternSpec, points: Array) -> Array:
    """Whether points (..., 2) lie within the pattern's outline."""
    share = points / (0.5 * np.asarray(spec.size) + _ROOM)
    return np.asarray((share**2).sum(axis=-1) <= 1.0 if spec.outline == "ellipse" else (abs(share) <= 1.0).all(axis=-1))


def _honeycomb(spec: PatternSpec) -> Curves:
    """All walls of the regular hexagons within the outline, with a cell's middle at the origin."""
    side = spec.cell / np.sqrt(3.0)
    turns = np.radians(60.0 * np.arange(7))
    hexagon = side * np.column_stack([np.cos(turns), np.sin(turns)])
    most = int(max(spec.size) / side) + 2
    a, b = (each.ravel() for each in np.meshgrid(np.arange(-most, most + 1), np.arange(-2 * most, 2 * most + 1)))
    middle = np.column_stack([1.5 * side * a, spec.cell * (b + 0.5 * a)])
    cells = middle[:, None] + hexagon
    return tuple(cells[_inside(spec, cells).all(axis=1)])


def _squares(spec: PatternSpec) -> Curves:
    """All sides of the squares within the outline."""
    count = (np.asarray(spec.size) / spec.cell + _ROOM).astype(int)
    x, y = np.meshgrid(*(spec.cell * (np.arange(n) - 0.5 * n) for n in count))
    corner = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0], [0.0, 0.0]]) * spec.cell
    cells = np.column_stack([x.ravel(), y.ravel()])[:, None] + corner
    return tuple(cells[_inside(spec, cells).all(axis=1)])


def _zigzag(spec: PatternSpec) -> Curves:
    """Lines along x, joined at alternate ends."""
    rows = int(spec.size[1] / spec.cell + _ROOM) + 1
    y = spec.cell * (np.arange(rows) - 0.5 * (rows - 1))
    x = np.full(rows, 0.5 * spec.size[0])
    if spec.outline == "ellipse":
        x = x * np.sqrt(np.maximum(1.0 - (2.0 * y / spec.size[1]) ** 2, 0.0))
    x, y = x[x >= 0.5 * spec.cell], y[x >= 0.5 * spec.cell]
    way = np.where(np.arange(len(x)) % 2 == 0, x, -x)
    return (np.column_stack([np.column_stack([-way, way]).ravel(), np.repeat(y, 2)]),)


def _concentric(spec: PatternSpec) -> Curves:
    """The outline, and copies inside it, each a cell narrower on all sides."""
    turns = np.linspace(0.0, 2.0 * np.pi, 4 * _STEPS + 1)
    round_ = np.column_stack([np.cos(turns), np.sin(turns)])
    square = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0]])
    one = round_ if spec.outline == "ellipse" else square
    rings: list[Array] = []
    while (half := 0.5 * np.asarray(spec.size) - len(rings) * spec.cell).min() >= 0.5 * spec.cell - _ROOM:
        rings.append(one * half)
    return tuple(rings)


_PATTERNS: dict[str, Callable[[PatternSpec], Curves]] = {
    "honeycomb": _honeycomb,
    "squares": _squares,
    "zigzag": _zigzag,
    "concentric": _concentric,
}


def _nurbs_file(path: Path) -> Curves | NotRead:
    """The curves of a JSON file, by Python's own reader, or of a STEP or IGES file, by Open CASCADE."""
    if path.suffix.lower() != ".json" and is_cad(path, path.read_bytes()):
        return _cad_file(path)
    try:
        listed = json.loads(path.read_text(encoding="utf-8-sig"))["curves"]
        return tuple(
            _nurbs(each["degree"], np.array(each["points_mm"]) * 1e-3, each.get("weights"), each.get("knots"))
            for each in listed
        )
    except (KeyError, TypeError, ValueError) as error:
        return NotRead(f"{path.name} holds no curves: {error}")


def _cad_file(path: Path) -> Curves | NotRead:
    request = {"file": str(path.resolve()), "iges": is_iges(path.read_bytes())}
    try:
        found = ask("planner.verify.reread.curve_process", request, _LONGEST)
    except subprocess.TimeoutExpired:
        found = None
    except Killed as killed:
        return NotRead(f"{path.name}: {killed}")
    if found is None or "reason" in found:
        return NotRead(f"{path.name}: {'it cannot be read' if found is None else found['reason']}")
    return tuple(found[str(k)] * 1e-3 for k in range(len(found)))


def _nurbs(p: int, points: Array, given: Sequence[float] | None, breaks: Sequence[float] | None) -> Array:
    """Points (n, 2 or 3) of a rational B-spline curve of degree p, by de Boor's recursion in homogeneous coordinates;
    given, breaks: its weights and knots; by default equal weights and uniform clamped knots."""
    weights = np.ones(len(points)) if given is None else np.asarray(given, dtype=float)
    if breaks is None:
        knots = np.concatenate([np.zeros(p), np.linspace(0.0, 1.0, len(points) - p + 1), np.ones(p)])
    else:
        knots = np.asarray(breaks, dtype=float)
    control = np.column_stack([points * weights[:, None], weights])
    return np.concatenate(list(_spans(knots, control, p)))


def _spans(knots: Array, control: Array, p: int) -> Iterator[Array]:
    """Points of each span between distinct knots, including both ends; control (n, 3 or 4): weight times x, y and, in
    space, z, then the weight."""
    for k in range(p, len(control)):
        if knots[k + 1] <= knots[k]:
            continue
        u = np.linspace(knots[k], knots[k + 1], _SPANS + 1)[:, None]
        d = [np.broadcast_to(control[k - p + j], (len(u), control.shape[1])) for j in range(p + 1)]
        for level in range(1, p + 1):
            for j in range(p, level - 1, -1):
                low, high = knots[k - p + j], knots[k + 1 + j - level]
                share = (u - low) / (high - low)
                d[j] = (1.0 - share) * d[j - 1] + share * d[j]
        yield d[p][:, :-1] / d[p][:, -1:]
