"""From the problem to beads that cover faces of a STEP file."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np

from planner.problem import Problem
from planner.problem.faces import FaceLayersSpec
from planner.readonly import Array
from planner.toolpath.bead import Toolpath
from planner.toolpath.coverage.registry import ORDERS
from planner.toolpath.coverage.rows import NotCoveredError, TooSmallError, cover
from planner.toolpath.coverage.tour import TooManySamplesError
from planner.toolpath.interpolation import TooRough
from planner.toolpath.paths import check_size, length
from planner.toolpath.step.body import FaceBody
from planner.toolpath.step.choice import Damaged, choose_faces
from planner.toolpath.step.curves import FaceCurve, lay, pieces_on_faces, spread
from planner.toolpath.step.face import Face
from planner.toolpath.step.files import read_step
from planner.toolpath.step.layers import FaceLayers, laid
from planner.toolpath.step.regions import smooth_regions
from planner.toolpath.step.sampling import TooMany, sample_faces
from planner.toolpath.step.shape import faces_shape

_QUARTER = 0.25  # of the spacing between points along the faces' edges
_APART = 0.5  # of the spacing: so far apart are the source's points at most
_PER_RUN = 10.0  # samples in a run-in, whose spacing is that of the bead's end
_FOLDED = 0.2  # of the way to a layer that folds: nearer to folding it is no layer


def cover_faces(problem: Problem, spec: FaceLayersSpec) -> Toolpath:
    """Cover the faces that are asked for, and lay the layers on them.

    Raises InputError for a file that cannot be read, faces that are not there, and layers that would fold.
    """
    process, part = problem.process, problem.part
    if part is None or part.step is None:
        raise problem.error("part", "is missing", "the body whose faces are covered: step")
    spacing = spec.source.spacing
    faces = read_step(part.step, _QUARTER * spacing, partial(problem.error, "part.step.file"))
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
    beads, tracks = laid(_in_turn(curves), spec.count, spec.height, process.bead.width, process.bead.height)
    surface = FaceLayers(FaceBody.of(faces), spec.height, tuple(tracks))
    notes = (f"{dots} samples or lines shorter than the bead is wide are left out",) if dots else ()
    return Toolpath(tuple(beads), surface, faces_shape(faces), notes)


def _name(region: Sequence[Face], number: int) -> str:
    names = {face.name for face in region if face.name}
    return f"{'_'.join(sorted(names)) if len(names) == 1 else 'faces'} {number}"


def _lines(problem: Problem, spec: FaceLayersSpec, region: Sequence[Face], body: FaceBody) -> list[Array]:
    """Places (n, 3) along the lines that cover a region."""
    source = spec.source
    try:
        if source.path == "rows":
            strokes = cover(region, source.spacing, problem.process.speed)
            return [spread(np.vstack([s.points, s.points[:1]]) if s.closed else s.points) for s in strokes]
        samples = sample_faces(body, source.spacing)
        return pieces_on_faces(body, samples.points[ORDERS[source.path](samples)])
    except (TooMany, TooManySamplesError):
        reason, hint = "gives too many samples on the faces", "a greater distance"
    except TooSmallError:
        return []
    except NotCoveredError as error:
        reason, hint = f"does not go: {error}", "another distance, or another path"
    raise problem.error("layers.source.spacing_mm", reason, hint)


def _curve(problem: Problem, spec: FaceLayersSpec, body: FaceBody, line: Array) -> FaceCurve:
    """The smooth curve through places on faces, its corners within the tolerance in every layer."""
    process = problem.process
    at = body.beneath(line)
    bends = body.side[at.face, None] * body.splines.bends(at.face, at.uv)
    rise = spec.count * spec.height
    room = 1.0 - bends * rise  # by how much a short line on the faces is longer in the last layer
    if room.min() < _FOLDED:
        x, y, z = at.points[int(np.argmin(room.min(axis=1)))] * 1e3
        raise problem.error(
            "layers.count",
            f"the faces are bent inwards too tightly at x {x:.1f}, y {y:.1f}, z {z:.1f} mm: layers would fold",
            "fewer or thinner layers",
        )
    tolerance = process.corner_tolerance / max(1.0, float(room.max()))
    try:
        curve = lay(body, line, tolerance, _APART * spec.source.spacing, process.run_in / _PER_RUN)
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
    """The curves in an order and direction with little travel: always on to the nearest end."""
    left = list(curves)
    out = [left.pop(0)]
    while left:
        here = out[-1][1].places.points[-1]
        ends = np.array([[curve.places.points[0], curve.places.points[-1]] for _, curve, _ in left])
        k, back = divmod(int(np.argmin(np.linalg.norm(ends - here, axis=2))), 2)
        body, curve, name = left.pop(k)
        out.append((body, curve.reversed() if back else curve, name))
    return out
