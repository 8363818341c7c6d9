"""Wings once more: where their layers are, by the verifier's own sections, and whether beads lie there and fill them.

Layers follow from the figures of the problem: those of a support from the bed up, then those parallel to the lower side,
then those parallel to the upper one. The depths of executed tips beneath both sides, and their heights, say which layer
they lie on. Lengths are metres in the part frame.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.spatial import cKDTree

from planner.base.arrays import Array, Ints
from planner.plan import Check
from planner.problem.layers import AerofoilLayersSpec
from planner.verify.checks import Judged
from planner.verify.reread.aerofoil import Ruled, ruled, sections_of
from planner.verify.reread.areas import MIDDLE, Place, PlaceGrid, area_of
from planner.verify.reread.places import (
    AXIS,
    INSIDE,
    NORMAL,
    OFF_LEVEL,
    ON_PART,
    AskedPlaces,
    Places,
    by_number,
    filled,
    not_read,
    worst_of,
)

_APART = {"lower": 0.1, "upper": 0.5}  # layer heights by which the other side is farther away where a layer ends
_CLOSER = 3  # steps to the foot of a place; each comes some thirty times nearer
_STATIONS = 17  # along the span, at which the outline of a layer is measured where it changes
_PIECE = 3.3  # bead widths: where a layer is narrower it may be left out, as pieces shorter than three are
_NEAR = 0.75  # distances of passes from a pass: half of it is as far as can be
_NARROW = 0.008  # of a layer: sheets of a tapered wing end narrow at both sides
_TURNED = np.radians(0.05)  # by which normals of two curves through the same points may differ
_STRETCHED = 1.05  # by which passes may be farther apart in places
_SLANTED = 1.35  # distances of passes from a pass where they meet edges at an angle
_LOOP = 5e-6  # m, by which a parallel comes nearer to its own side than its depth where it crosses itself
_WITHIN = 1.5  # pitches of places from a bead's middle line to the nearest that is as far within
_BESIDE = 0.5  # layer heights that level layers keep from the ends of curved ones, from where they rise
_UNDERSIDE = 2000  # places of it
_BESIDE_SIDES = 0.25  # of the span, by which sides are looked at beyond its ends
_SPACED = 0.3  # bead widths between places of a side along the span
_ROUND = 1e-9  # m or layers
_LOOKS = 200  # places of a printed layer by which the layer is known that it lies on
_FAR = 1.0  # m


@dataclass(frozen=True)
class WingLayer:
    """Where a layer lies: parallel to the side `kind`, lower or upper, `at` [m] inside it; or level at the height `at`.

    kind     of level ones: cut, the wing's section at the height `end`; or under, beneath what lies on it
    end      distance from the other side at which it ends, or the height of a section [m]
    spacing  of passes [m]
    """

    kind: str
    at: float
    end: float
    spacing: float


@dataclass(frozen=True)
class Wing:
    """A wing's two sides, and the figures that say where its layers end."""

    lower: Ruled
    upper: Ruled
    spec: AerofoilLayersSpec
    width: float

    @cached_property
    def stations(self) -> Array:
        """Shares of the span at which outlines are measured: one where they are the same all along."""
        return np.zeros(1) if self.spec.source.tip is None else np.linspace(0.0, 1.0, _STATIONS)

    @cached_property
    def trees(self) -> dict[str, cKDTree]:
        """Places all over both sides."""
        shares = np.zeros(1)
        if self.spec.source.tip is not None:
            count = int((1.0 + 2.0 * _BESIDE_SIDES) * self.spec.source.span / (_SPACED * self.width))
            shares = np.linspace(-_BESIDE_SIDES, 1.0 + _BESIDE_SIDES, min(max(count, 9), 400))
        lines = np.arange(0.0, len(self.lower.root), 6.0)
        at, v = (each.ravel() for each in np.meshgrid(lines, shares, indexing="ij"))
        return {"lower": cKDTree(self.lower.points(at, v)), "upper": cKDTree(self.upper.points(at, v))}

    def side(self, kind: str) -> Ruled:
        """The side of that name."""
        return self.lower if kind == "lower" else self.upper

    @cached_property
    def undersides(self) -> list[Array]:
        """At each station points (n, 2), by x, of what lies on the level layers of a support."""
        support, height = self.spec.support, self.spec.height
        curved = 0 if support is None or self.spec.source.method == "planar" else support.curved
        layer = WingLayer("lower", -curved * height, 0.0, self.width)
        c, reach = np.linspace(0.0, 1.0, _UNDERSIDE), np.array([_BESIDE * height, 0.0])
        rise = 0.0 if support is None else support.height  # beside curved layers, no steeper than these lean at most
        run = rise / np.tan(self.spec.source.tilt)
        found = []
        for v in self.stations:
            shares = np.full(len(c), v)
            there = np.ones(len(c), dtype=bool)
            if self.spec.source.method != "planar":
                there = _clear(self, layer)(c, shares) >= 0.0
            first, last = int(np.argmax(there)), len(c) - int(np.argmax(there[::-1]))
            points = _parallel(self, layer)(c, shares)[first:last, ::2]
            nose, tail = points[:1] - reach, points[-1:] + reach
            points = np.vstack([nose + [-run, rise], nose, points, tail, tail + [run, rise]])
            found.append(points[np.argsort(points[:, 0], kind="stable")])
        return found

    def outline(self, v: float) -> Array:
        """The section (n, 2) at a share of the span: its upper side from tail to nose, its lower side back."""
        lines = np.arange(float(len(self.lower.root)))
        upper, lower = (side.points(lines, np.full(len(lines), v))[:, ::2] for side in (self.upper, self.lower))
        return np.vstack([upper[::-1], lower])


def wing(judged: Judged, places: Places) -> Iterator[Check]:
    """All checks of a wing; none of another print."""
    spec, process = judged.problem.layers, judged.problem.process
    if not isinstance(spec, AerofoilLayersSpec):
        return
    try:
        root, tip = sections_of(spec.source)
    except (OSError, ValueError) as error:
        yield not_read(str(error))
        return
    y, span, width = spec.source.origin[1], spec.source.span, process.bead.width
    lower, upper = ruled(root.lower, tip.lower, y, span, False), ruled(root.upper, tip.upper, y, span, True)
    body = Wing(lower, upper, spec, width)
    found = list(_areas(body))
    asked = [_asked(body, layer, area) for layer, area in found]
    known = [k for k, (_, area) in enumerate(found) if area.inside.any()]
    if not known:
        return
    off, normals, which = _on_layers(body, {k: found[k] for k in known}, places)
    yield worst_of(judged, places, ON_PART, np.abs(off) * 1e3, OFF_LEVEL * 1e3, "mm")
    lean = np.degrees(np.arccos(np.clip((normals * places.up).sum(axis=1), -1.0, 1.0)))
    yield worst_of(judged, places, NORMAL, lean, float(np.degrees(process.cones.tilt + AXIS + _TURNED)), "deg")
    beyond = np.zeros(len(places.tip))
    for k, own in by_number(which):
        area = found[k][1]  # passes end by their own lengths, however edges slant there
        within = MIDDLE * width - max(area.pitch) if spec.source.tip is None else 0.0
        beyond[own] = area.beyond(places.tip[own], within)
    limit = _WITHIN * max(max(found[k][1].pitch) for k in known) + process.corner_tolerance
    if spec.source.tip is not None:
        # outlines are taken as straight between stations, the planner's between nearer ones
        limit += MIDDLE * width
    yield worst_of(judged, places, INSIDE, beyond * 1e3, limit * 1e3, "mm")
    wanted = [k for k in known if len(asked[k].points)]
    if judged.trajectory.first_bead:  # the rest of a print that was interrupted
        first = int(which.min())
        wanted = [k for k in wanted if k > first and not _at_one_height(found[k][0], found[first][0])]
    if spec.count is not None:
        last = max(int(which.max()), _last_of(spec.count, [found[k][0] for k in known], known))
        wanted = [k for k in wanted if k <= last]
    yield filled(replace(places, layer=which), {k: asked[k] for k in wanted}, 0.0, _NARROW)


def _at_one_height(one: WingLayer, other: WingLayer) -> bool:
    """Whether two layers are a section of the wing and its support at a height, whichever of them is laid first."""
    return {one.kind, other.kind} <= {"cut", "under"} and one.at == other.at


def _layers(body: Wing) -> Iterator[WingLayer]:
    """All layers in print order, those too that come out empty."""
    spec, width, height = body.spec, body.width, body.spec.height
    support, planar = spec.support, spec.source.method == "planar"
    ends = [np.vstack(each) for each in ((body.lower.root, body.upper.root), (body.lower.tip, body.upper.tip))]
    level = 0 if support is None else int(support.height / height + _ROUND)
    top = int(np.ceil(max(float(end[:, 1].max()) for end in ends) / height)) if planar else 0
    for k in range(max(level, top)):
        if support is not None and k < level:
            yield WingLayer("under", (k + 1) * height, 0.0, width / support.infill)
        if k < top:
            yield WingLayer("cut", (k + 1) * height, (k + 0.5) * height, width)
    if planar:
        return
    for k in range(0 if support is None else support.curved, 0, -1):
        yield WingLayer("lower", -(k - 1) * height, 0.0, width)
    most = 1 + int(max(float(np.ptp(end[:, 1])) for end in ends) / height)
    for k in range(most):
        yield WingLayer("lower", (k + 1) * height, (k + 1 + _APART["lower"]) * height, width)
    for k in range(most, -1, -1):
        yield WingLayer("upper", k * height, (k + _APART["upper"]) * height, width)


def _last_of(count: int, layers: Sequence[WingLayer], known: Sequence[int]) -> int:
    """The number of the last of so many layers from the first: of wing and support at one height both are one.

    Layers that are hardly one count here, and may not have been counted: then more are printed.
    """
    one = [a.kind == "under" and b.kind == "cut" and a.at == b.at for a, b in itertools.pairwise(layers)]
    counted = np.cumsum([1, *np.logical_not(one)])
    return known[int(np.searchsorted(counted, count, side="right")) - 1]


def _on_layers(body: Wing, layers: dict[int, tuple[WingLayer, PlaceGrid]], places: Places) -> tuple[Array, Array, Ints]:
    """How far (n) [m] tips are off the layer that most of a printed layer is nearest to, outward unit normals (n, 3) of it,
    and its number (n)."""
    level = places.tip[:, 2]
    groups = list(by_number(_layer_and_material(places, body)))
    few = np.concatenate([own[:: max(len(own) // _LOOKS, 1)] for _, own in groups])
    some = {kind: np.full(len(level), np.nan) for kind in ("lower", "upper")}
    for kind, depth in some.items():
        depth[few] = body.side(kind).depths(places.tip[few])[0]
    off, normals = np.empty(len(places.tip)), np.empty_like(places.tip)
    which = np.empty(len(places.tip), dtype=np.int64)
    for _, own in groups:
        looks = own[:: max(len(own) // _LOOKS, 1)]
        usual = {k: _usual(some.get(each.kind, level)[looks] - each.at) for k, (each, _) in layers.items()}
        nearest = [k for k, away in usual.items() if away <= min(usual.values()) + _ROUND]
        if len(nearest) > 1:  # of the wing and its support, side by side
            beside = [_usual(layers[k][1].beyond(places.tip[looks], 0.0)) for k in nearest]
            nearest = [nearest[int(np.argmin(beside))]]
        which[own] = nearest[0]
    for kind in ("lower", "upper", "level"):
        of_kind = [
            k for k, (each, _) in layers.items() if each.kind == kind or (kind == "level" and each.kind not in some)
        ]
        own = np.flatnonzero(np.isin(which, of_kind))
        if not len(own):
            continue
        at = np.array([layers[k][0].at for k in which[own].tolist()])
        if kind == "level":
            off[own], normals[own] = level[own] - at, [0.0, 0.0, 1.0]
        else:
            depth, inward, _ = body.side(kind).depths(places.tip[own])
            # layers of the lower half grow upwards, into the wing
            off[own], normals[own] = depth - at, inward if kind == "lower" else -inward
    return off, normals, which


def _usual(off: Array) -> float:
    """How far places usually are off a layer [m]."""
    return float(np.median(np.abs(np.nan_to_num(off, nan=_FAR))))


def _layer_and_material(places: Places, body: Wing) -> Ints:
    """Numbers (n) of what is matched as one: a layer, or a bead where two kinds of layers share their heights."""
    both = body.spec.source.method == "planar" and body.spec.support is not None
    return places.bead if both else places.layer


def _asked(body: Wing, layer: WingLayer, area: PlaceGrid) -> AskedPlaces:
    """What of a layer is to be filled, and how near to a bead that is."""
    near, beside = _NEAR * _STRETCHED * layer.spacing, _SLANTED * layer.spacing
    if body.spec.source.tip is None:
        sizes = [body.spec.source.span, *_runs(area, layer.spacing)]
        near = _NEAR * max(size / max(round(size / layer.spacing), 1) for size in sizes)
        beside = near
    return area.asked(near, beside, _PIECE * body.width)


def _runs(area: PlaceGrid, least: float) -> list[float]:
    """How long [m] the pieces of a layer are across that are longer than `least` [m]."""
    row = area.inside[len(area.inside) // 2]
    ends = np.flatnonzero(np.diff(np.concatenate([[0], row.astype(np.int8), [0]])))
    sizes = (ends[1::2] - ends[::2]) * area.pitch[1]
    return sizes[sizes > least].tolist()


def _areas(body: Wing) -> Iterator[tuple[WingLayer, PlaceGrid]]:
    """The layers, and their places; of each half the layers inwards of the first that comes out empty are not looked at."""
    ended: set[str] = set()
    upper: list[tuple[WingLayer, PlaceGrid]] = []
    layers = list(_layers(body))
    for layer in [each for each in layers if each.kind != "upper"]:
        if layer.kind in ended:
            continue
        area = _area(body, layer)
        if not area.inside.any() and layer.kind == "lower" and layer.at > 0.0:
            ended.add(layer.kind)
        yield layer, area
    for layer in [each for each in layers if each.kind == "upper"][::-1]:
        upper.append((layer, _area(body, layer)))
        if not upper[-1][1].inside.any():
            break
    yield from upper[::-1]


def _area(body: Wing, layer: WingLayer) -> PlaceGrid:
    """The places of a layer."""
    span = body.spec.source.span
    if layer.kind in ("cut", "under"):
        low, high = _ends(body, layer)
        place, room, across = _level(body, layer, low, high), _rooms(body, layer, low, high), high - low
    else:
        side = body.side(layer.kind)
        across = max(float(np.linalg.norm(np.diff(end, axis=0), axis=1).sum()) for end in (side.root, side.tip))
        place, room = _parallel(body, layer), _clear(body, layer)
    return area_of(place, room, (span, across), body.stations, body.width)


def _lines(side: Ruled, c: Array) -> Array:
    """Lines (n) of a side at shares c (n) of its length at the root."""
    s = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(side.root, axis=0), axis=1)))
    return np.interp(c * s[-1], s, np.arange(len(s)))


def _parallel(body: Wing, layer: WingLayer) -> Place:
    """Points of a layer parallel to a side, v counted where they are, not where their feet are."""
    side = body.side(layer.kind)

    def place(c: Array, v: Array) -> Array:
        line, foot = _lines(side, c), v
        for _ in range(_CLOSER):
            foot = v - layer.at * side.normals(line, foot)[:, 1] / side.span
        return side.points(line, foot) + layer.at * side.normals(line, foot)

    return place


def _clear(body: Wing, layer: WingLayer) -> Place:
    """Room of a layer parallel to a side: to the other side, to where it crosses itself, and to where it is too steep."""
    side, own = body.side(layer.kind), body.trees[layer.kind]
    other = body.trees["upper" if layer.kind == "lower" else "lower"]
    place = _parallel(body, layer)

    def room(c: Array, v: Array) -> Array:
        points, inward = place(c, v), side.normals(_lines(side, c), v)
        steep = np.abs(inward[:, 2]) - np.cos(body.spec.source.tilt)
        most = layer.end + body.spec.height
        clear = np.minimum(other.query(points, distance_upper_bound=most)[0], most) - layer.end
        room = np.minimum(clear, steep)
        if layer.at != 0.0:  # a loop is one or is none: in between nothing tells how far it is
            room = np.where(own.query(points)[0] < abs(layer.at) - _LOOP, np.minimum(room, -_LOOP), room)
        return np.asarray(room)

    return room


def _ends(body: Wing, layer: WingLayer) -> tuple[float, float]:
    """Least and greatest x of a level layer [m]."""
    support = body.spec.support
    if layer.kind == "under" and support is not None:
        middle = body.spec.source.origin[0] + 0.5 * body.spec.source.chord
        return middle - 0.5 * support.length, middle + 0.5 * support.length
    x = np.concatenate([body.outline(v)[:, 0] for v in (0.0, 1.0)])
    return float(x.min()), float(x.max())


def _level(body: Wing, layer: WingLayer, low: float, high: float) -> Place:
    y, span = body.spec.source.origin[1], body.spec.source.span
    return lambda c, v: np.column_stack([low + c * (high - low), y + v * span, np.full(len(c), layer.at)])


def _rooms(body: Wing, layer: WingLayer, low: float, high: float) -> Place:
    """Room along x of a level layer: in a section of the wing, or beneath and beside what lies on a support."""

    def room(c: Array, v: Array) -> Array:
        x = low + c * (high - low)
        if layer.kind == "cut":
            return _within(x, _crossings(body.outline(float(v[0])), layer.end))
        under = body.undersides[int(np.argmin(np.abs(body.stations - v[0])))]
        return _within(x, _beneath(under, layer.at, low, high))

    return room


def _beneath(under: Array, top: float, low: float, high: float) -> Array:
    """x (k), in order, between which from `low` to `high` there is nothing of `under` (n, 2) below a height [m]."""
    x = np.unique(np.concatenate([np.linspace(low, high, _UNDERSIDE), np.clip(under[:, 0], low, high)]))
    free = np.interp(x, under[:, 0], under[:, 1], left=_FAR, right=_FAR) >= top - _ROUND
    ends = np.flatnonzero(np.diff(np.concatenate([[0], free.astype(np.int8), [0]])))
    return x[np.clip(ends - np.arange(len(ends)) % 2, 0, len(x) - 1)]


def _crossings(outline: Array, height: float) -> Array:
    """x (k), in order, at which an outline (n, 2), closed by a straight line, is as high."""
    ahead = np.roll(outline, -1, axis=0)
    k = np.flatnonzero((outline[:, 1] > height) != (ahead[:, 1] > height))
    share = (height - outline[k, 1]) / (ahead[k, 1] - outline[k, 1])
    return np.sort(outline[k, 0] + share * (ahead[k, 0] - outline[k, 0]))


def _within(x: Array, ends: Array) -> Array:
    """How far (n) [m] x (n) lie within intervals between ends (k); negative outside."""
    if not len(ends):
        return np.full(len(x), -_FAR)
    away = np.abs(x[:, None] - ends).min(axis=1)
    return np.where(np.searchsorted(ends, x) % 2 == 1, away, -away)
