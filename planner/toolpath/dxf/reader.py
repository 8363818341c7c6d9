"""Reads the lines of a DXF drawing as plane paths in metres; anything else is counted and reported.

The package ezdxf reads the file and evaluates arcs, ellipses and splines.
"""

from __future__ import annotations

import io
import logging
import re
import struct
from collections import Counter
from collections.abc import Collection, Iterable, Iterator
from dataclasses import dataclass, field
from itertools import pairwise
from operator import attrgetter
from typing import Any, NamedTuple

import numpy as np

from planner.base.arrays import Array
from planner.base.budgets import DRAWING_POINTS, DXF_BYTES, DXF_DEPTH, DXF_ENTITIES
from planner.base.errors import Complaint, nearest_name
from planner.base.extras import missing_extra
from planner.base.files import read_bytes
from planner.problem.drawings import NARROWEST_MM, WIDEST_MM, DxfSpec
from planner.problem.part import UNITS
from planner.toolpath.dxf.chains import DrawnLine, joined
from planner.toolpath.svg.outlines import SAME_POINT, PlanePath, distinct
from planner.toolpath.twins import without_twins

_BINARY = b"AutoCAD Binary DXF"
_DWG = re.compile(rb"AC10\d\d")
_START = re.compile(rb"\s*(?:999\s[^\n]*\n\s*)*0\s*[\r\n]+\s*SECTION", re.IGNORECASE)
_END = re.compile(rb"^\s*EOF\s*$", re.MULTILINE)
_UNDRAWN = (ValueError, ZeroDivisionError, TypeError, AttributeError)  # from an entity without data to draw it by
_COARSE = 1e-3  # × the drawing's extent: chord tolerance for a first measurement
_SPANS = 8  # pieces of a spline between knots that are checked
_FLAT = 1e-9  # × the extent: smaller differences count as none
_STRAIGHT = 1e-6  # a smaller bulge (rise over half the chord) counts as straight
_FARTHEST = 1e12  # drawing units: farther from the origin, rounding loses the details of a part-sized drawing
_FRAME = 16  # flag of a vertex that is a corner of a spline's frame
_SHOWN = 8  # names in a sentence

LINES = ("LINE", "ARC", "CIRCLE", "ELLIPSE", "LWPOLYLINE", "POLYLINE", "SPLINE", "HELIX")
# $INSUNITS of the header, by ezdxf's numbers: millimetres per unit
INSUNITS = {1: 25.4, 2: 304.8, 3: 1609344.0, 4: 1.0, 5: 10.0, 6: 1e3, 7: 1e6, 8: 2.54e-5, 9: 0.0254, 10: 914.4}
INSUNITS |= {11: 1e-7, 12: 1e-6, 13: 1e-3, 14: 100.0, 15: 1e4, 16: 1e5}
INSUNITS |= {21: 1200e3 / 3937.0, 22: 100e3 / 3937.0, 23: 3600e3 / 3937.0, 24: 6336e6 / 3937.0}  # US survey units


class DxfRead(NamedTuple):
    """The paths of a drawing, and notes on its other contents and on what was done to it."""

    paths: tuple[PlanePath, ...]
    notes: tuple[str, ...]


@dataclass(frozen=True)
class _Found:
    """What a walk through a drawing has found."""

    lines: list[tuple[Any, str, str]] = field(default_factory=list)  # entity, name, layer
    others: Counter[str] = field(default_factory=Counter)
    unseen: Counter[str] = field(default_factory=Counter)  # on layers that are off, by layer
    unwanted: Counter[str] = field(default_factory=Counter)  # on layers that were not requested


def read_dxf(spec: DxfSpec, flatness: float, where: Complaint) -> DxfRead:
    """Read the lines of a drawing, centred on the origin, in the drawing's unit or `spec.width` metres wide.

    Arcs, ellipses and splines become chords at most `flatness` [m] off; vertices are kept. Lines of a layer whose ends
    are at most `spec.join` [m] apart become one path.
    Raises InputError, made by `where(reason, hint=...)`, for anything wrong with the file.
    """
    document = read_drawing(spec.dxf, where)
    name = spec.dxf.name
    found = _walked(document, spec, where)
    notes = _told(found, spec)
    if not found.lines:
        more = f": {'; '.join(notes)}" if notes else ""
        raise where(f"{name} contains nothing that can be printed{more}", hint=f"lines are {', '.join(LINES)}")
    unit, note = _unit(document, spec)
    if note and spec.width is None:
        notes.append(note)

    rough = _measured(found, where, spec)
    scale = unit * 1e-3 if spec.width is None else spec.width / rough
    lines, heights = _flattened(found, (1.0 - SAME_POINT) * flatness / scale, where, spec)
    every = np.vstack([line.points for line in lines])
    low, high = every.min(axis=0), every.max(axis=0)
    if spec.width is not None:
        if high[0] - low[0] <= _FLAT * float(np.abs(every).max()):
            raise where(f"{name} has no width, so it cannot be made {1e3 * spec.width:g} mm wide")
        scale = spec.width / float(high[0] - low[0])
    extent = float((high - low).max()) * scale * 1e3
    if not NARROWEST_MM <= extent <= WIDEST_MM:
        raise where(
            f"{name} is {extent:.6g} mm across", hint="set its size: layers.source.unit or layers.source.width_mm"
        )
    off = float(np.ptp(heights)) * scale
    if off > max(flatness, _FLAT):
        notes.append(f"lines lie up to {off * 1e3:.3f} mm off a level plane: they are projected onto it")

    same = SAME_POINT * flatness / scale
    kept = [line for line in lines if np.ptp(line.points, axis=0).max() > same]
    if len(kept) < len(lines):
        notes.append(f"mere points when seen from above, left out: {_count(len(lines) - len(kept), 'line')}")
    near = max(same, min(spec.join, flatness) / scale)
    kept, twins = without_twins(kept, near, attrgetter("group"))
    chains = joined(kept, spec.join / scale)
    once, again = without_twins(chains, near, attrgetter("group"))  # such as a polyline over loose lines
    if twins + again:
        notes.append(f"{_count(twins + again, 'line')} drawn twice left out")
    if len(chains) < len(kept):
        notes.append(f"{len(kept)} lines joined into {len(chains)} where ends are within {spec.join * 1e3:g} mm")
    paths = _placed(once, 0.5 * (low + high), scale, SAME_POINT * flatness)
    if not paths:
        raise where(f"{name} draws nothing but points", hint="draw it larger: layers.source.unit or width_mm")
    return DxfRead(paths, tuple(f"layers.source.dxf: {note}" for note in notes))


def read_drawing(path: Any, where: Complaint) -> Any:
    """The document of a file, with errors repaired where possible. Raises InputError if it is no DXF file."""
    data = read_bytes(path, DXF_BYTES.most, where, "save it without anything that is not to be printed")
    name = path.name
    if _DWG.match(data):
        raise where(f"{name} is a DWG file", hint="save it as DXF")
    binary = data.startswith(_BINARY)
    if not binary and not _START.match(data.removeprefix(b"\xef\xbb\xbf")):
        raise where(f"{name} is not a DXF file: it does not begin with a section", hint="save it as DXF")
    try:
        from ezdxf import recover
        from ezdxf.filemanagement import readfile
        from ezdxf.lldxf.const import DXFError
    except ImportError as error:
        raise missing_extra(error, f"reading {name}") or error from None
    logging.getLogger("ezdxf").addHandler(logging.NullHandler())  # its repairs are not for the terminal
    try:
        document = readfile(path) if binary else recover.read(io.BytesIO(data))[0]
        count = len(document.modelspace())
    except (
        DXFError,
        ValueError,
        TypeError,
        KeyError,
        IndexError,
        AttributeError,
        EOFError,
        OSError,
        RecursionError,
        struct.error,
    ) as error:
        # a damaged file may break ezdxf anywhere
        what = " ".join(str(error).split())[:120] or type(error).__name__
        raise where(f"{name} is damaged: {what}", hint="save it again, as DXF R2000 or later") from error
    if not binary and not _END.search(data):
        raise where(
            f"{name} is damaged: its end (EOF) is missing; {_count(count, 'entity', 'entities')} could be read up to there",
            hint="save it again",
        )
    return document


def _walked(document: Any, spec: DxfSpec, where: Complaint) -> _Found:
    """The contents of model space with blocks expanded, on the requested layers or on all that are on."""
    found = _Found()
    known = {layer.dxf.name.lower(): layer for layer in document.layers}
    wanted = None if spec.layers is None else {name.lower() for name in spec.layers}
    visits = _Visits(spec.dxf.name, where)
    frozen = {name for name, layer in known.items() if wanted is None and layer.is_frozen()}
    shown = list(_parts(document.modelspace(), "0", 0, found.others, visits, frozen))
    used = {layer.lower(): layer for _, layer in shown} | {name: layer.dxf.name for name, layer in known.items()}
    for name in spec.layers or ():
        if name.lower() not in used:
            near = nearest_name(name, used.values())
            names = ", ".join(list(used.values())[:_SHOWN])
            raise where(
                f"there is no layer {name!r}", hint=f"{f'did you mean {near!r}? ' if near else ''}layers: {names}"
            )
    for entity, layer in shown:
        kind, low = entity.dxftype(), layer.lower()
        if wanted is not None and low not in wanted:
            found.unwanted[layer] += 1
        elif (wanted is None and low in known and (known[low].is_off() or known[low].is_frozen())) or entity.dxf.get(
            "invisible", 0
        ):
            found.unseen[layer] += 1
        elif kind not in LINES or (kind == "POLYLINE" and not (entity.is_2d_polyline or entity.is_3d_polyline)):
            found.others[kind] += 1
        else:
            _straighten(entity)
            handle = entity.dxf.get("handle") or str(len(found.lines) + 1)
            found.lines.append((entity, f"{kind.lower()} {handle}", layer))
    return found


class _Visits:
    """Counts entities as they are visited: with nested blocks, their number is not known beforehand."""

    def __init__(self, name: str, where: Complaint) -> None:
        self.name, self.where, self.count = name, where, 0

    def one_more(self) -> None:
        """Count one more entity. Raises InputError if that is one too many."""
        self.count += 1
        DXF_ENTITIES.check(
            self.count, f"{self.name}, with its blocks expanded, has at least", self.where, "save it with fewer blocks"
        )


def _parts(
    entities: Iterable[Any], layer: str, depth: int, others: Counter[str], visits: _Visits, frozen: Collection[str]
) -> Iterator[tuple[Any, str]]:
    """Entities with blocks expanded, and the layer that each is drawn on.

    Layer 0 in a block is the layer of its reference. A reference that is hidden or on a frozen layer is not expanded.
    """
    for entity in entities:
        visits.one_more()
        own = str(entity.dxf.get("layer", "0"))
        own = layer if depth and own == "0" else own
        if entity.dxftype() != "INSERT" or entity.dxf.get("invisible", 0) or own.lower() in frozen:
            yield entity, own
        elif depth >= DXF_DEPTH.most or entity.block() is None:
            others["INSERT without its block" if entity.block() is None else "INSERT nested too deeply"] += 1
        else:

            def skipped(part: Any, _: str) -> None:
                others[f"{part.dxftype()} in a block"] += 1

            for one in entity.multi_insert() if entity.mcount > 1 else (entity,):
                visits.one_more()
                if one.dxf.get("zscale", 1.0) == 0.0:
                    one.dxf.zscale = 1.0  # some programs flatten blocks this way; ezdxf cannot turn those
                try:
                    inner = list(one.virtual_entities(skipped_entity_callback=skipped))
                except _UNDRAWN:
                    others["INSERT without size"] += 1
                    continue
                yield from _parts(inner, own, depth + 1, others, visits, frozen)


def _told(found: _Found, spec: DxfSpec) -> list[str]:
    notes = []
    if found.others:
        notes.append(f"not lines, and not printed: {_list(found.others)}")
    if found.unseen:
        notes.append(f"hidden, or on layers that are off, and not printed: {_list(found.unseen)}")
    if found.unwanted:
        notes.append(f"on other layers and not printed: {_list(found.unwanted)}")
    return notes


def _list(counts: Counter[str]) -> str:
    shown = ", ".join(f"{count} {name}" for name, count in counts.most_common(_SHOWN))
    return shown + (", ..." if len(counts) > _SHOWN else "")


def _count(count: int, one: str, several: str | None = None) -> str:
    return f"1 {one}" if count == 1 else f"{count} {several or one + 's'}"


def _unit(document: Any, spec: DxfSpec) -> tuple[float, str]:
    """Millimetres per unit of the drawing, and a note about it, if any."""
    if spec.unit is not None:
        return UNITS[spec.unit], ""
    number = document.header.get("$INSUNITS", 0)
    if number in INSUNITS:
        return INSUNITS[number], ""
    why = "names no unit" if number == 0 else f"gives an unknown unit, {number}"
    return 1.0, f"the drawing {why}: lengths are taken as millimetres (layers.source.unit)"


def _measured(found: _Found, where: Complaint, spec: DxfSpec) -> float:
    """About how wide the drawing is, or how large if it has no width, in its units."""
    from ezdxf.bbox import extents

    try:
        box = extents((entity for entity, _, _ in found.lines), fast=True)
    except _UNDRAWN as error:
        raise where(f"a line of {spec.dxf.name} cannot be drawn: {error}", hint="redraw it") from error
    size = max(float(box.size.x), float(box.size.y)) if box.has_data else 0.0
    if not (np.isfinite(size) and size > 0.0):
        raise where(f"{spec.dxf.name} draws nothing but points", hint="is it drawn in the xy plane?")
    lines, _ = _flattened(found, _COARSE * size, where, spec)
    every = np.vstack([line.points for line in lines])
    width = float(np.ptp(every[:, 0]))
    return width if width > _FLAT * size else size


def _flattened(found: _Found, chord: float, where: Complaint, spec: DxfSpec) -> tuple[list[DrawnLine], Array]:
    """The lines as chords at most `chord` off, and the heights of all their vertices, in the drawing's units."""
    lines, heights, room = [], [], DRAWING_POINTS.most
    for entity, name, layer in found.lines:
        try:
            points = np.array([(p.x, p.y, p.z) for p in _vertices(entity, chord)], dtype=float)
        except _UNDRAWN as error:
            raise where(f"{name} of {spec.dxf.name} cannot be drawn: {error}", hint="redraw it") from error
        if len(points) == 0:
            continue
        if not (np.abs(points) <= _FARTHEST).all():  # NaN is not
            reason = f"{name} of {spec.dxf.name} has a coordinate that is not a number, or greater than {_FARTHEST:g}"
            raise where(reason, hint="redraw it")
        room -= len(points)
        if room < 0:
            raise where(
                f"{spec.dxf.name} has more than {DRAWING_POINTS.most} points",
                hint="use a larger tolerance, or layers of it",
            )
        closed = len(points) > 2 and bool(
            np.abs(points[0] - points[-1]).max() <= _FLAT * max(1.0, np.abs(points).max())
        )
        lines.append(DrawnLine(name, layer, points[:, :2], closed))
        heights.append(points[:, 2])
    if not lines:
        raise where(f"{spec.dxf.name} draws nothing but points", hint="is it drawn in the xy plane?")
    return lines, np.concatenate(heights)


def _vertices(entity: Any, chord: float) -> Iterator[Any]:
    """Vertices of an entity in the drawing's frame, curves divided so that chords are at most `chord` off."""
    kind = entity.dxftype()
    if kind == "LINE":
        yield entity.dxf.start
        yield entity.dxf.end
    elif kind in ("ARC", "CIRCLE"):
        radius = abs(entity.dxf.radius)
        start = entity.dxf.start_angle if kind == "ARC" else 0.0
        sweep = ((entity.dxf.end_angle - start) % 360.0 if kind == "ARC" else 0.0) or 360.0
        if radius > 0.0:
            step = 2.0 * np.degrees(np.arccos(1.0 - min(chord / radius, 0.5)))
            yield from entity.vertices(start + np.linspace(0.0, sweep, int(np.ceil(sweep / step)) + 1))
    elif kind == "ELLIPSE":
        yield from entity.flattening(chord)
    elif kind in ("SPLINE", "HELIX"):
        yield from _spline(entity.construction_tool(), chord)
    elif kind == "POLYLINE" and not entity.is_2d_polyline:
        points = list(entity.points())
        yield from points
        if entity.is_closed and points:
            yield points[0]
    else:
        yield from _polyline(entity, chord)


def _spline(tool: Any, chord: float) -> Iterator[Any]:
    """Vertices of a spline; an unclamped one, such as a closed one, is cut to its domain, since it has knots beyond."""
    if tool.is_clamped:
        yield from tool.flattening(chord, _SPANS)
        return
    ends = np.unique(tool.knots()[tool.degree : tool.count + 1])
    u = np.unique([np.linspace(a, b, _SPANS + 1) for a, b in pairwise(ends)])
    while len(u) <= DRAWING_POINTS.most:
        half = 0.5 * (u[1:] + u[:-1])
        at, between = (np.array([point.xyz for point in tool.points(t)]) for t in (u, half))
        off = np.linalg.norm(between - 0.5 * (at[1:] + at[:-1]), axis=1) > chord
        if not off.any():
            break
        u = np.sort(np.append(u, half[off]))
    yield from tool.points(u)


def _straighten(entity: Any) -> None:
    """Straighten tiny bulges of a polyline, and leave out the corners of a spline's frame.

    The centre of such a bulge would be too far away to compute with; no program shows the frame.
    """
    if entity.dxftype() == "LWPOLYLINE":
        rows = entity.get_points("xyseb")
        if any(0.0 < abs(row[4]) < _STRAIGHT for row in rows):
            entity.set_points([(*row[:4], row[4] if abs(row[4]) >= _STRAIGHT else 0.0) for row in rows], "xyseb")
    elif entity.dxftype() == "POLYLINE":
        entity.vertices[:] = [each for each in entity.vertices if not each.dxf.flags & _FRAME] or entity.vertices
        for vertex in entity.vertices:
            if 0.0 < abs(vertex.dxf.get("bulge", 0.0)) < _STRAIGHT:
                vertex.dxf.bulge = 0.0


def _polyline(entity: Any, chord: float) -> Iterator[Any]:
    """Vertices of a polyline, with its bulges divided."""
    last = None
    for part in entity.virtual_entities():
        points = list(_vertices(part, chord))
        if last is not None and points and last.distance(points[0]) > last.distance(points[-1]):
            points = points[::-1]  # an arc runs counter-clockwise, whatever the polyline does
        elif last is None and part.dxftype() == "ARC":
            points = points if _starts(entity, points) else points[::-1]
        yield from points if last is None else points[1:]
        last = points[-1] if points else last


def _starts(entity: Any, points: list[Any]) -> bool:
    """Whether a polyline's first vertex is the first of these points rather than the last."""
    if entity.dxftype() == "LWPOLYLINE":
        first = next(iter(entity.vertices_in_wcs()))
    else:
        first = next(iter(entity.points_in_wcs()))
    return bool(first.distance(points[0]) <= first.distance(points[-1]))


def _placed(chains: Iterable[DrawnLine], centre: Array, scale: float, same: float) -> tuple[PlanePath, ...]:
    """Paths in metres about the centre; points within `same` [m] of the one before are merged."""
    paths = []
    names = Counter[str]()
    for chain in chains:
        points = (chain.points - centre) * scale
        if chain.closed:
            points = points if np.hypot(*(points[-1] - points[0])) <= same else np.vstack([points, points[:1]])
        closed = chain.closed or bool(np.hypot(*(points[-1] - points[0])) <= same)
        if closed:
            points[-1] = points[0]
        points = distinct(points, same)
        if len(points) < (3 if closed else 2):
            continue
        points.flags.writeable = False
        names[chain.name] += 1
        copy = f" ({names[chain.name]})" if names[chain.name] > 1 else ""
        paths.append(PlanePath(f"{chain.name}{copy}", points, closed))
    return tuple(paths)
