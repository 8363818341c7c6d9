"""Cores read again: their layers from the facets of body and middle, and the pattern that each of them must hold.

A layer's height is a weighted sum of the heights of body and middle, which come from the facets themselves. Lengths are
in metres in the part frame.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from planner.base.arrays import Array, Flags, Ints
from planner.base.errors import InputError
from planner.plan import Check
from planner.problem.layers import CoreLayersSpec
from planner.verify.checks import EVERYWHERE, Judged
from planner.verify.reread.facets import facets_of
from planner.verify.reread.lines import distances_from_lines, dots_of_lines
from planner.verify.reread.places import (
    DRAWN,
    INSIDE,
    OFF_LEVEL,
    ON_PART,
    WHOLE,
    Places,
    between,
    by_number,
    not_read,
    worst_of,
)
from planner.verify.reread.plane_curves import NotRead, read_again
from planner.verify.reread.slopes import SEEN, Heights, axis_along, normals_over, off_facets

_CHORDS = 2.0  # chord tolerances: one for the planner's reading, one for this
_PIECE = 3.3  # bead widths: shorter pieces may be left out, as the planner leaves out those shorter than three
_STEEP = np.radians(2.0)  # places within this of the steepest slope allowed may be left out
_LEAST = 0.2  # × the layer height: layers of varying height are left out where they would be lower
_UNSURE = 0.02  # layers: uncertainty of the space between body and middle
_UNKNOWN = 1.0  # m, in place of an unknown distance
_FEW = 0.02  # m: shares are taken of at least this length of a layer
_ENDS = 0.005  # × a layer's length: ends of its pieces


@dataclass(frozen=True)
class CoreLayer:
    """A layer at body * (height of the body) + middle * (height of the middle) + rise [m], laid where they are at least
    `room` [m] apart."""

    body: float
    middle: float
    rise: float
    room: float

    def at(self, body: Array, middle: Array) -> Array:
        """Its heights (n) [m]."""
        return np.asarray(self.body * body + self.middle * middle + self.rise)


@dataclass(frozen=True)
class Space:
    """The heights of body and middle, and the lines (n, 2) of the pattern where it is placed."""

    body: Heights
    middle: Heights
    lines: Sequence[Array]


def core(judged: Judged, places: Places) -> Iterator[Check]:
    """All checks of a core; none for other prints."""
    spec = judged.problem.layers
    if not isinstance(spec, CoreLayersSpec):
        return
    try:
        space = _space(judged, spec)
    except (InputError, OSError) as error:
        yield not_read(str(error))
        return
    if isinstance(space, NotRead):
        yield not_read(space.why)
        return
    dots = dots_of_lines(space.lines)[0]
    up = normals_over(space.body, dots)[1, :, 2]
    room = np.where(up >= np.cos(spec.tilt), space.middle(dots) - space.body(dots), np.nan)
    most = float(np.nanmax(np.append(room, 0.0)))
    plane = places.tip[:, :2]
    beneath, above = space.body(plane), space.middle(plane)
    layers, which = _matched(spec, most, places, beneath, above)
    if not layers:
        yield not_read("no layer has room between part and middle")
        return

    off, lacks = np.empty(len(plane)), np.empty(len(plane))
    some = places.few(SEEN)
    few, normals = np.searchsorted(places.sample, some.sample), np.full((3, len(some.tip), 3), np.nan)
    off_by, steepest = off_facets(judged), 1.0
    for k, own in by_number(which):
        layer = layers[k]
        off[own] = places.tip[own, 2] - layer.at(beneath[own], above[own])
        lacks[own] = layer.room - (above - beneath)[own]
        here = np.flatnonzero(which[few] == k)
        if len(here):
            normals[:, here] = normals_over(_heights(space, layer), some.tip[here, :2])
        steepest = max(steepest, abs(layer.body) + abs(layer.middle))
    bound = steepest * off_by / np.cos(spec.tilt) + OFF_LEVEL
    yield worst_of(judged, places, ON_PART, np.abs(off) * 1e3, bound * 1e3, "mm")
    yield axis_along(judged, some, normals)
    yield worst_of(judged, places, INSIDE, np.maximum(lacks, 0.0) * 1e3, 2.0 * bound * 1e3, "mm")
    process = judged.problem.process
    limit = 2.0 * process.corner_tolerance + _CHORDS * process.chord_tolerance + OFF_LEVEL + 0.5 * process.bead.width
    yield worst_of(judged, places, DRAWN, distances_from_lines(space.lines, plane) * 1e3, limit * 1e3, "mm")
    yield _left_out(
        judged,
        spec,
        space,
        layers,
        which,
        places,
        limit + between(judged),
        2.0 * bound,
    )


def _space(judged: Judged, spec: CoreLayersSpec) -> Space | NotRead:
    """Body, middle and pattern. Raises InputError and OSError for files that cannot be read."""
    part = judged.problem.part
    if part is None or part.mesh is None:
        return NotRead("there is no mesh")
    drawn = read_again(spec.source)
    if isinstance(drawn, NotRead):
        return drawn
    c, s = np.cos(spec.turn), np.sin(spec.turn)
    lines = [line @ np.array([[c, s], [-s, c]]) + np.asarray(spec.centre) for line in drawn if len(line) > 1]
    body = facets_of(part.mesh)
    level, mesh = spec.up_to.z, spec.up_to.mesh
    middle = None if mesh is None else facets_of(mesh)

    def height(plane: Array) -> Array:
        return np.full(len(plane), level or 0.0) if middle is None else middle.top(plane)[0]

    return Space(lambda plane: body.top(plane)[0], height, lines)


def _heights(space: Space, layer: CoreLayer) -> Heights:
    return lambda plane: layer.at(space.body(plane), space.middle(plane))


def _stacks(spec: CoreLayersSpec, most: float) -> Iterator[list[CoreLayer]]:
    """The layers in print order if the middle is up to `most` [m] above the body; several candidates where a hair of
    that decides the number of layers."""
    height, both = spec.height, spec.halves == "both"
    if spec.heights == "even":
        count = int(most / height + 1.0)
        lower = [CoreLayer(1.0, 0.0, (k + 1) * height, (k + 1) * height) for k in range(count)]
        upper = [CoreLayer(-1.0, 2.0, -k * height, (k + 0.5) * height) for k in range(count, -1, -1)]
        yield lower + upper if both else lower
        return
    least = _LEAST * height if spec.least_height is None else spec.least_height
    for count in sorted({max(int(np.ceil(most / height + hair)), 1) for hair in (-_UNSURE, _UNSURE)}):
        shares = [(k + 1) / count for k in range(2 * count if both else count)]
        yield [CoreLayer(1.0 - share, share, 0.0, count * least) for share in shares]


def _matched(
    spec: CoreLayersSpec, most: float, places: Places, body: Array, middle: Array
) -> tuple[list[CoreLayer], Ints]:
    """The layers, and for each place the number (n) of the one that its printed layer is mostly nearest to."""
    best: tuple[float, list[CoreLayer], Ints] = (np.inf, [], np.zeros(len(body), dtype=np.int64))
    for layers in _stacks(spec, most):
        which, worst = np.empty(len(body), dtype=np.int64), 0.0
        for _, own in by_number(places.layer):
            off = [np.abs(places.tip[own, 2] - layer.at(body[own], middle[own])) for layer in layers]
            usual = [float(np.median(np.nan_to_num(each, nan=_UNKNOWN))) for each in off]
            which[own] = int(np.argmin(usual))
            worst = max(worst, min(usual))
        if worst < best[0]:
            best = (worst, layers, which)
    return best[1], best[2]


def _left_out(
    judged: Judged, spec: CoreLayersSpec, space: Space, layers: Sequence[CoreLayer], which: Ints, places: Places,
    near: float, unsure: float,
) -> Check:  # fmt: skip
    """The share of the required pattern that is not printed, in the worst layer.

    unsure: uncertainty of the room between body and middle [m]; nothing is required with less to spare
    """
    dots, weight = dots_of_lines(space.lines)
    line = np.cumsum(np.append(True, np.linalg.norm(np.diff(dots, axis=0), axis=1) > 2.0 * weight[1:])) - 1
    low, high = space.body(dots), space.middle(dots)
    slopes = [normals_over(each, dots)[1] for each in (space.body, space.middle)]
    slope_low, slope_high = (-each[:, :2] / each[:, 2:] for each in slopes)
    printed = dict(by_number(which))
    first = min(printed) if judged.trajectory.first_bead else -1
    last, before = max(printed), 0  # before: earlier layers that may have been laid
    worst = 0.0
    where = EVERYWHERE
    for k, layer in enumerate(layers):
        slope = np.arctan(np.linalg.norm(layer.body * slope_low + layer.middle * slope_high, axis=1))
        asked = k <= last or spec.count is None or before < spec.count
        before += bool(((high - low >= layer.room - unsure) & (slope <= spec.tilt + _STEEP)).any())
        if k <= first or not asked:
            continue
        there = (high - low >= layer.room + unsure) & (slope <= spec.tilt - _STEEP)
        there = _pieces(there, line, weight, _PIECE * judged.problem.process.bead.width)
        own = printed.get(k, np.zeros(0, dtype=np.int64))
        cut = np.flatnonzero(np.diff(places.bead[own])) + 1
        beads = [piece for piece in np.split(places.tip[own, :2], cut) if len(piece) > 1]
        lost = there & (distances_from_lines(beads, dots) > near)
        share = float(weight[lost].sum() / max(weight[there].sum(), _FEW))
        if share > worst:
            worst, spot = share, dots[np.argmax(lost)] * 1e3
            where = f"layer {k + 1}, at {spot[0]:.1f}, {spot[1]:.1f} mm"
    # what the notes report as left out is in pieces that are not required
    return Check(WHOLE, worst, _ENDS, "of its length", worst <= _ENDS, where)


def _pieces(there: Flags, line: Ints, weight: Array, least: float) -> Flags:
    """Whether places (n) are in pieces of lines at least this long [m]."""
    change = (there[1:] != there[:-1]) | (line[1:] != line[:-1])
    piece = np.append(0, np.cumsum(change))
    return np.asarray(there & (np.bincount(piece, weight)[piece] >= least))
