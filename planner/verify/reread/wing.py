"""Wings checked again: where their layers lie, by the verifier's own sections, and whether beads fill them.

Layers follow from the figures of the problem: those of a support from the bed up, then those parallel to the lower side,
then those parallel to the upper one. Depths of the executed tips below both sides, and their heights, identify the
layer that they lie on. Lengths are in metres in the part frame.
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

_APART = {"lower": 0.1, "upper": 0.5}  # layer heights added to a layer's depth: it ends this far from the other side
_CLOSER = 3  # steps to the foot of a place; each reduces the error some thirty times
_STATIONS = 17  # along the span, at which a layer's outline is measured where it varies
_PIECE = 3.3  # bead widths: narrower parts of a layer may be left out, as the planner does with those under three
_NEAR = 0.75  # × the spacing of passes: greatest distance from a pass; half would be exact
_NARROW = 0.008  # × a layer: share left unfilled, as sheets of a tapered wing end narrow on both sides
_TURNED = np.radians(0.05)  # normals of two curves through the same points may differ by this
_STRETCHED = 1.05  # × the spacing of passes: they may be this far apart in places
_SLANTED = 1.35  # × the spacing of passes: greatest distance from a pass where passes meet edges at an angle
_LOOP = 5e-6  # m: where a parallel crosses itself, it is nearer to its own side than its depth by more than this
_WITHIN = 1.5  # pitches of places: from a bead's middle line to the nearest place as far within
_BESIDE = 0.5  # layer heights: level layers keep this far from the ends of curved ones, and rise from there
_UNDERSIDE = 2000  # places of an underside
_BESIDE_SIDES = 0.25  # × the span: sides are sampled this far beyond both ends
_SPACED = 0.3  # bead widths between places of a side along the span
_ROUND = 1e-9  # m or layers: rounding
_LOOKS = 200  # places of a printed layer by which the layer that it lies on is identified
_FAR = 1.0  # m, in place of unknown distances


@dataclass(frozen=True)
class WingLayer:
    """Where a layer lies: parallel to the side `kind`, lower or upper, `at` [m] inside it; or level at the height `at`.

    kind     of level layers: cut, the wing's section at the height `end`; or under, a support beneath other layers
    end      distance from the other side at which it ends, or the height of a section [m]
    spacing  of passes [m]
    """

    kind: str
    at: float
    end: float
    spacing: float


@dataclass(frozen=True)
class Wing:
    """A wing's two sides, and the figures that determine where its layers end."""

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
        """Trees of places all over both sides."""
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
        """At each station, points (n, 2), ordered by x, of the underside of what lies on a support's level layers."""
        support, height = self.spec.support, self.spec.height
        curved = 0 if support is None or self.spec.source.method == "planar" else support.curved
        layer = WingLayer("lower", -curved * height, 0.0, self.width)
        c, reach = np.linspace(0.0, 1.0, _UNDERSIDE), np.array([_BESIDE * height, 0.0])
        rise = 0.0 if support is None else support.height  # next to curved layers, no steeper than they may lean
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
    """All checks of a wing; none for other prints."""
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
        area = found[k][1]  # passes end where their own lengths do, however the edge slants there
        within = MIDDLE * width - max(area.pitch) if spec.source.tip is None else 0.0
        beyond[own] = area.beyond(places.tip[own], within)
    limit = _WITHIN * max(max(found[k][1].pitch) for k in known) + process.corner_tolerance
    if spec.source.tip is not None:
        # outlines are interpolated linearly between stations; the planner's stations are closer
        limit += MIDDLE * width
    yield worst_of(judged, places, INSIDE, beyond * 1e3, limit * 1e3, "mm")
    wanted = [k for k in known if len(asked[k].points)]
    if judged.trajectory.first_bead:  # the rest of an interrupted print
        first = int(which.min())
        wanted = [k for k in wanted if k > first and not _at_one_height(found[k][0], found[first][0])]
    if spec.count is not None:
        last = max(int(which.max()), _last_of(spec.count, [found[k][0] for k in known], known))
        wanted = [k for k in wanted if k <= last]
    yield filled(replace(places, layer=which), {k: asked[k] for k in wanted}, 0.0, _NARROW)


def _at_one_height(one: WingLayer, other: WingLayer) -> bool:
    """Whether two layers are a section of the wing and its support at one height, whichever is laid first."""
    return {one.kind, other.kind} <= {"cut", "under"} and one.at == other.at


def _layers(body: Wing) -> Iterator[WingLayer]:
    """All layers in print order, including those that turn out empty."""
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
    """The number of the last of `count` layers from the first; wing and support at one height count as one.

    Barely existing layers count here; the planner may not have counted them, and then prints more.
    """
    one = [a.kind == "under" and b.kind == "cut" and a.at == b.at for a, b in itertools.pairwise(layers)]
    counted = np.cumsum([1, *np.logical_not(one)])
    return known[int(np.searchsorted(counted, count, side="right")) - 1]


def _on_layers(body: Wing, layers: dict[int, tuple[WingLayer, PlaceGrid]], places: Places) -> tuple[Array, Array, Ints]:
    """Distance (n) [m] of tips from the layer that their printed layer is mostly nearest to, its outward unit normals
    (n, 3), and its number (n)."""
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
        if len(nearest) > 1:  # the wing and its support, side by side
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
    """Median distance of places from a layer [m]."""
    return float(np.median(np.abs(np.nan_to_num(off, nan=_FAR))))


def _layer_and_material(places: Places, body: Wing) -> Ints:
    """Numbers (n) of the units matched to layers: layers, or beads where two kinds of layers share heights."""
    both = body.spec.source.method == "planar" and body.spec.support is not None
    return places.bead if both else places.layer


def _asked(body: Wing, layer: WingLayer, area: PlaceGrid) -> AskedPlaces:
    """The places of a layer that must be filled, and how near to a bead they must be."""
    near, beside = _NEAR * _STRETCHED * layer.spacing, _SLANTED * layer.spacing
    if body.spec.source.tip is None:
        sizes = [body.spec.source.span, *_runs(area, layer.spacing)]
        near = _NEAR * max(size / max(round(size / layer.spacing), 1) for size in sizes)
        beside = near
    return area.asked(near, beside, _PIECE * body.width)


def _runs(area: PlaceGrid, least: float) -> list[float]:
    """Lengths [m] across of the pieces of a layer that are longer than `least` [m]."""
    row = area.inside[len(area.inside) // 2]
    ends = np.flatnonzero(np.diff(np.concatenate([[0], row.astype(np.int8), [0]])))
    sizes = (ends[1::2] - ends[::2]) * area.pitch[1]
    return sizes[sizes > least].tolist()


def _areas(body: Wing) -> Iterator[tuple[WingLayer, PlaceGrid]]:
    """The layers and their places; in each half, layers further inside than the first empty one are skipped."""
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
    """The grid of places of a layer."""
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
    """Points of a layer parallel to a side; v is their own share of the span, not that of their feet."""
    side = body.side(layer.kind)

    def place(c: Array, v: Array) -> Array:
        line, foot = _lines(side, c), v
        for _ in range(_CLOSER):
            foot = v - layer.at * side.normals(line, foot)[:, 1] / side.span
        return side.points(line, foot) + layer.at * side.normals(line, foot)

    return place


def _clear(body: Wing, layer: WingLayer) -> Place:
    """Room of a layer parallel to a side: up to the other side, a crossing with itself, or a slope too steep."""
    side, own = body.side(layer.kind), body.trees[layer.kind]
    other = body.trees["upper" if layer.kind == "lower" else "lower"]
    place = _parallel(body, layer)

    def room(c: Array, v: Array) -> Array:
        points, inward = place(c, v), side.normals(_lines(side, c), v)
        steep = np.abs(inward[:, 2]) - np.cos(body.spec.source.tilt)
        most = layer.end + body.spec.height
        clear = np.minimum(other.query(points, distance_upper_bound=most)[0], most) - layer.end
        room = np.minimum(clear, steep)
        if layer.at != 0.0:  # only inside a loop or not: there is no distance to one
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
    """Room along x of a level layer: in a section of the wing, or beneath and next to what lies on a support."""

    def room(c: Array, v: Array) -> Array:
        x = low + c * (high - low)
        if layer.kind == "cut":
            return _within(x, _crossings(body.outline(float(v[0])), layer.end))
        under = body.undersides[int(np.argmin(np.abs(body.stations - v[0])))]
        return _within(x, _beneath(under, layer.at, low, high))

    return room


def _beneath(under: Array, top: float, low: float, high: float) -> Array:
    """Ends x (k), in order, of intervals in `low` to `high` where `under` (n, 2) stays above the height `top` [m]."""
    x = np.unique(np.concatenate([np.linspace(low, high, _UNDERSIDE), np.clip(under[:, 0], low, high)]))
    free = np.interp(x, under[:, 0], under[:, 1], left=_FAR, right=_FAR) >= top - _ROUND
    ends = np.flatnonzero(np.diff(np.concatenate([[0], free.astype(np.int8), [0]])))
    return x[np.clip(ends - np.arange(len(ends)) % 2, 0, len(x) - 1)]


def _crossings(outline: Array, height: float) -> Array:
    """x (k), in order, at which an outline (n, 2), closed by a straight line, crosses a height."""
    ahead = np.roll(outline, -1, axis=0)
    k = np.flatnonzero((outline[:, 1] > height) != (ahead[:, 1] > height))
    share = (height - outline[k, 1]) / (ahead[k, 1] - outline[k, 1])
    return np.sort(outline[k, 0] + share * (ahead[k, 0] - outline[k, 0]))


def _within(x: Array, ends: Array) -> Array:
    """Depth (n) [m] of x (n) within intervals with ends (k); negative outside."""
    if not len(ends):
        return np.full(len(x), -_FAR)
    away = np.abs(x[:, None] - ends).min(axis=1)
    return np.where(np.searchsorted(ends, x) % 2 == 1, away, -away)
