"""Beads that cover faces of a STEP or IGES file, in layers along the faces' normals.

A bead may cross from one face to another where they meet smoothly. The first layer's points and normals come
exactly from the faces.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from operator import itemgetter

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from planner.base.arrays import Array, Ints, ReadOnlyArrays
from planner.base.geometry import subdivided
from planner.problem import Problem
from planner.problem.layers import DIRECTION_NAMES, FaceLayersSpec, FacesSpec
from planner.toolpath.bead import Bead, Toolpath
from planner.toolpath.coverage.measures import crossings, laid
from planner.toolpath.coverage.rows import NotCoveredError, TooSmallError, cover
from planner.toolpath.coverage.tours import (
    ORDERS,
    ROW_WEIGHT,
    SampledSurface,
    TooManySamplesError,
    VisitRule,
    without_jumps,
)
from planner.toolpath.interpolation import TooRough, calm_path, interpolate
from planner.toolpath.ordering import nearest_first
from planner.toolpath.plane_paths import check_size, length, make_bead
from planner.toolpath.step.body import ON_THE_RIM, FaceBody, FacePlaces
from planner.toolpath.step.files import Damaged, Face, choose_faces, read_faces
from planner.toolpath.step.sampling import TOLERANCE, Sampling, TooMany, sample_faces
from planner.toolpath.step.top import faces_shape
from planner.toolpath.task import roll_zeros

SMOOTH = np.radians(0.04)  # between normals along a shared edge: half of what the tool axis may deviate from the normal

_STEP = 2e-3  # m between the places on the faces through which the curve runs
_TURN = 0.2  # × the spacing: greatest such step on rows, about eight in the half circle from one row to the next
_FEWEST = 12  # steps of a curve
_AHEAD = 0.25  # × a step between waypoints: how far a curve may run beyond the faces' rim

_QUARTER = 0.25  # × the spacing: greatest distance between points along the faces' edges
_APART = 0.5  # × the spacing: greatest distance between the source's points
_PER_RUN = 10.0  # samples per run-in, which set the spacing at the bead's ends
_FOLDED = 0.2  # least length of a short line in the last layer, relative to the faces; at 0 the layer folds


def smooth_regions(faces: Sequence[Face]) -> list[list[Face]]:
    """Groups of faces, in their order, joined by edges across which the normal turns by less than SMOOTH.

    At any other edge a nozzle along the normal would have to turn on the spot, so a bead ends there.
    """
    points = [np.vstack([face.points(loop) for loop in face.loops]) for face in faces]
    normals = [np.vstack([face.normals(loop) for loop in face.loops]) for face in faces]
    edges = [np.concatenate(face.edges) for face in faces]
    joined = []
    for i in range(len(faces)):
        for j in range(i + 1, len(faces)):
            if np.isin(edges[i], edges[j]).any() and _smooth(i, j, points, normals, edges):
                joined.append((i, j))
    a, b = np.array(joined, dtype=np.int64).reshape(-1, 2).T
    links = coo_array((np.ones(len(a)), (a, b)), shape=(len(faces), len(faces)))
    _, label = connected_components(links, directed=False)
    return [[face for face, own in zip(faces, label, strict=True) if own == k] for k in range(int(label.max()) + 1)]


def _smooth(i: int, j: int, points: list[Array], normals: list[Array], edges: list[NDArray[np.int64]]) -> bool:
    """Whether two faces meet smoothly along one of the edges that they share."""
    for edge in np.intersect1d(edges[i], edges[j]):
        a, b = edges[i] == edge, edges[j] == edge
        away, near = cKDTree(points[j][b]).query(points[i][a])
        same = away <= 2.0 * ON_THE_RIM
        cosine = (normals[i][a] * normals[j][b][near]).sum(axis=1)[same]
        if same.any() and cosine.min() >= np.cos(SMOOTH):
            return True
    return False


@dataclass(frozen=True)
class FaceCurve(ReadOnlyArrays):
    """A curve on faces, sampled uniformly in its parameter: places, and those of the input path before rounding."""

    places: FacePlaces
    source: FacePlaces

    def reversed(self) -> FaceCurve:
        """The same curve, run backwards."""
        return FaceCurve(
            *(FacePlaces(*(value[::-1] for value in vars(p).values())) for p in (self.places, self.source))
        )


def pieces_on_faces(body: FaceBody, waypoints: Array) -> list[Array]:
    """Places (n, 3) along straight lines or smooth curves through waypoints (m, 3), cut where they leave the faces."""
    if len(waypoints) < 2:
        return []
    path, chord = calm_path(waypoints)
    step = np.diff(chord)
    pieces = np.maximum(np.ceil(step / _STEP), 1.0).astype(int)
    index, share = subdivided(pieces)
    c = np.append(chord[index] + step[index] * share, chord[-1])
    at = body.beneath(np.asarray(path(c)[:, :3]))
    there = body.inside(at.face, at.uv)
    if not there.all():
        there[~there] = body.rim_distance(at.face[~there], at.points[~there]) <= _AHEAD * float(np.median(step))
    owner = np.append(index, len(pieces) - 1)
    whole = np.ones(len(pieces), dtype=bool)
    whole[owner[~there]] = False  # a step with a place off the faces is left out
    out = []
    starts = np.concatenate([[0], np.cumsum(pieces)])
    k = 0
    while k < len(pieces):
        if not whole[k]:
            k += 1
            continue
        first = k
        while k < len(pieces) and whole[k]:
            k += 1
        out.append(at.points[starts[first] : starts[k] + 1])
    return out


def spread(points: Array, step: float) -> Array:
    """Fewer places (k, 3), `step` [m] apart, on the smooth curve through closely spaced places (n, 3)."""
    path, chord = calm_path(points)
    return np.asarray(path(np.linspace(0.0, chord[-1], max(int(np.ceil(chord[-1] / step)), _FEWEST) + 1))[:, :3])


def curve_on_faces(body: FaceBody, points: Array, tolerance: float, apart: float, ends: float) -> FaceCurve:
    """The smooth curve through places (n, 3) on faces: corners rounded within `tolerance`, all of it on the faces.

    apart, ends: greatest distance between the source's points, and between samples at the ends [m]. Raises TooRough
    if no smooth curve keeps the tolerance.
    """
    at = body.beneath(points)
    curve = interpolate(at.points, at.normals, tolerance, apart, ends)
    return FaceCurve(body.beneath(curve.points), body.beneath(curve.source))


@dataclass(frozen=True)
class FaceTrack:
    """Where a bead runs: arc lengths s (n) [m] of its samples, and the faces (n), uv (n, 2) of a body beneath them."""

    layer: int
    s: Array
    body: FaceBody
    face: Ints
    uv: Array


@dataclass(frozen=True)
class FaceLayers:
    """The body, and the layers on it, each `height` [m] above the one before along the normals.

    tracks   of all beads in print order
    solid    how many layers count as printed: beneath the layer being printed, the body has grown by them everywhere
    """

    body: FaceBody
    height: float
    tracks: tuple[FaceTrack, ...]
    solid: int = 0

    def before(self, bead: int) -> FaceLayers:
        """The surface after the first `bead` beads: the one on which the last one's layer lies."""
        return replace(self, solid=self.tracks[bead - 1].layer if bead > 0 else 0)

    def signed_distance(self, points: Array) -> Array:
        """Distance (n,) of points (n, 3) from the body with its solid layers; negative inside."""
        return self.body.signed_distance(points) - self.solid * self.height

    def normals(self, points: Array) -> Array:
        """Outward unit normals (n, 3) of the layer through points (n, 3)."""
        return self.body.normals(points)

    def normals_on(self, bead: int, s: Array, tips: Array) -> Array:
        """Outward unit normals (n, 3) of the true faces at the feet of perpendiculars from tips (n, 3).

        The search for feet starts from the bead's samples around arc lengths s (n).
        """
        track = self.tracks[bead]
        after = np.clip(np.searchsorted(track.s, s), 1, len(track.s) - 1)
        around = np.stack([after - 1, after], axis=1)
        return track.body.followed(tips, track.face[around], track.uv[around]).normals


def lay_layers(
    curves: Sequence[tuple[FaceBody, FaceCurve, str]], count: int, layer_height: float, width: float, height: float
) -> tuple[list[Bead], list[FaceTrack]]:
    """Beads `width` and `height` [m] along curves, `count` layers of them: each begins where the one before ended."""
    placed = []
    row = list(curves)
    for layer in range(count):
        placed += [(layer, *one) for one in row]
        row = [(body, curve.reversed(), name) for body, curve, name in reversed(row)]
    zeros = roll_zeros([curve.places.normals for _, _, curve, _ in placed])
    beads, tracks = [], []
    for (layer, body, curve, name), zero in zip(placed, zeros, strict=True):
        rise = (layer + 1) * layer_height
        points = curve.places.points + rise * curve.places.normals
        source = curve.source.points + rise * curve.source.normals
        beads.append(make_bead(name, layer, points, curve.places.normals, zero, source, width, height))
        tracks.append(FaceTrack(layer, beads[-1].s, body, curve.places.face, curve.places.uv))
    return beads, tracks


def cover_faces(problem: Problem, spec: FaceLayersSpec) -> Toolpath:
    """Cover the requested faces, and lay the layers on them.

    Raises InputError for a file that cannot be read, faces that do not exist, and layers that would fold.
    """
    process, part = problem.process, problem.part
    if part is None or part.step is None:
        raise problem.error("part", "is missing", "the body whose faces are covered: step")
    spacing = spec.source.spacing
    faces, notes = read_faces(part.step, _QUARTER * spacing, partial(problem.error, "part.step.file"))
    known = [(face.number, face.name) for face in faces]
    try:
        numbers = choose_faces(spec.source.faces, known, "part.step")
    except Damaged as error:
        raise problem.error("layers.source.faces", error.reason, error.hint) from None
    covered = [face for face in faces if face.number in numbers]

    curves: list[tuple[FaceBody, FaceCurve, str]] = []
    dots = 0
    for region in smooth_regions(covered):
        body = FaceBody.of(region)
        lines = _lines(problem, spec, region, body)
        for line in lines:
            if length(line) < process.bead.width or len(line) < 2:
                dots += 1
                continue
            curves.append((body, _curve(problem, spec, body, line), _name(region, len(curves))))
    if not curves:
        raise problem.error(
            "layers.source.spacing_mm", "no bead fits onto the faces", "a smaller distance, or a narrower bead"
        )
    beads, tracks = lay_layers(_in_turn(curves), spec.count, spec.height, process.bead.width, process.bead.height)
    whole = FaceBody.of(faces, part.step.thickness)
    surface = FaceLayers(whole, spec.height, tuple(tracks))
    if dots:
        notes = (*notes, f"{dots} samples or lines shorter than the bead is wide are left out")
    in_the_air = part.step.thickness == 0.0 and not whole.closed
    nothing = np.empty((0, 3, 3)) if in_the_air else None
    return Toolpath(tuple(beads), surface, faces_shape(faces), notes, solid=nothing)


def _name(region: Sequence[Face], number: int) -> str:
    names = {face.name for face in region if face.name}
    return f"{'_'.join(sorted(names)) if len(names) == 1 else 'faces'} {number}"


def _lines(problem: Problem, spec: FaceLayersSpec, region: Sequence[Face], body: FaceBody) -> list[Array]:
    """Places (n, 3) along the lines that cover a region."""
    source = spec.source
    try:
        if source.path == "rows":
            strokes = cover(region, source.spacing, problem.process.speed)
            step = min(_STEP, _TURN * source.spacing)
            return [spread(np.vstack([s.points, s.points[:1]]) if s.closed else s.points, step) for s in strokes]
        samples, pieces = visits(body, source)
        return [line for piece in pieces for line in pieces_on_faces(body, samples.points[piece])]
    except (TooMany, TooManySamplesError):
        reason, hint = "gives too many samples on the faces", "a greater distance"
    except TooSmallError:
        return []
    except NotCoveredError as error:
        reason, hint = f"does not work: {error}", "another distance, or another path"
    raise problem.error("layers.source.spacing_mm", reason, hint)


def visits(body: FaceBody, source: FacesSpec) -> tuple[SampledSurface, list[Ints]]:
    """Samples of faces, and the order in which they are visited, in pieces.

    If no direction of rows is requested, it is the one whose path crosses itself less often or, if equal, has fewer
    pieces.
    Raises TooMany and TooManySamplesError.
    """
    asked = DIRECTION_NAMES[::-1] if source.direction is None else (source.direction,)
    tolerance = TOLERANCE if source.tolerance is None else source.tolerance
    found = []
    for direction in asked:
        samples = sample_faces(body, Sampling(source.spacings, DIRECTION_NAMES.index(direction), tolerance))
        pieces = without_jumps(samples, ORDERS[source.path](samples, _rule(samples, source)))
        lines = [laid(samples, piece) for piece in pieces if len(piece) > 1]
        found.append(((len(crossings(lines)) if lines else 0, len(pieces)), samples, pieces))
        if found[-1][0] <= (0, 1):
            break
    return min(found, key=itemgetter(0))[1:]


def _rule(samples: SampledSurface, source: FacesSpec) -> VisitRule:
    """Where the order of visits starts, and what leaving a row costs."""
    weight = ROW_WEIGHT if source.weight is None else source.weight
    if source.start is None or not len(samples.points):
        return VisitRule(weight=weight)
    away = np.linalg.norm(samples.points - source.start, axis=1)
    return VisitRule(int(np.argmin(away)), weight)


def _curve(problem: Problem, spec: FaceLayersSpec, body: FaceBody, line: Array) -> FaceCurve:
    """The smooth curve through places on faces, its corners within the tolerance in every layer."""
    process = problem.process
    at = body.beneath(line)
    bends = body.side[at.face, None] * body.splines.bends(at.face, at.uv)
    rise = spec.count * spec.height
    room = 1.0 - bends * rise  # length of a short line in the last layer, relative to the faces
    if room.min() < _FOLDED:
        x, y, z = at.points[int(np.argmin(room.min(axis=1)))] * 1e3
        raise problem.error(
            "layers.count",
            f"the faces are bent inwards too tightly at x {x:.1f}, y {y:.1f}, z {z:.1f} mm: layers would fold",
            "fewer or thinner layers",
        )
    tolerance = process.corner_tolerance / max(1.0, float(room.max()))
    try:
        curve = curve_on_faces(body, line, tolerance, _APART * spec.source.spacing, process.run_in / _PER_RUN)
    except TooRough as error:
        x, y, z = line[min(error.waypoint, len(line) - 1)] * 1e3
        raise problem.error(
            "process.corner_tolerance_mm",
            f"no smooth curve keeps it at x {x:.1f}, y {y:.1f}, z {z:.1f} mm",
            "a greater tolerance, or another path or spacing",
        ) from None
    hint = "choose a smaller tolerance, or a greater layers.source.spacing_mm"
    check_size(problem, "over the faces", length(line), length(curve.places.points), hint)
    return curve


def _in_turn(curves: list[tuple[FaceBody, FaceCurve, str]]) -> list[tuple[FaceBody, FaceCurve, str]]:
    """The curves in an order and direction with little travel: the nearest end always comes next."""
    order = nearest_first([(curve.places.points, False) for _, curve, _ in curves])
    turned = ((*curves[k], back) for k, back in order)
    return [(body, curve.reversed() if back else curve, name) for body, curve, name, back in turned]
