"""Prints on faces of a STEP or IGES file: whether tips keep their height above the named faces, and cover them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager, nullcontext

import numpy as np

from planner.base.arrays import Array, Ints
from planner.plan import Check
from planner.problem import Problem
from planner.problem.drawings import ProjectedLayersSpec
from planner.problem.layers import FaceLayersSpec
from planner.problem.part import StepSpec
from planner.verify.checks import Judged
from planner.verify.reread.places import (
    AXIS,
    INSIDE,
    NORMAL,
    OFF_LEVEL,
    ON_PART,
    AskedPlaces,
    Places,
    begun_layers,
    beyond_limits,
    filled,
    not_read,
    worst_of,
)
from planner.verify.reread.plane_curves import NotRead
from planner.verify.reread.step_faces import OFF, TURNED, MeshedFaces, meshed_faces, read_ahead

_MOST = 20_000  # places of the print for which the nearest point on the faces is found
_SMOOTH = 2e-5  # m: projected beads may lie this far off the faces, as a smooth surface crosses their seams
_FOLDED = 0.2  # × a hollow's radius: no layer comes nearer to its centre, as it would fold
_RIM = 0.25  # × the line spacing: rounded corners may leave the faces by this much
_SPACED = 0.25  # × the line spacing: distance between places to be covered
_NEAR = {"rows": 0.75}  # × the line spacing: greatest distance to a line; rows stay within half of the spacing
_THROUGH_SAMPLES = 1.4  # the same for paths through samples, which may leave a strip at an edge


def faces_ahead(problem: Problem) -> AbstractContextManager[None]:
    """Context in which the faces that a print lies on are read in the background; no-op for other prints."""
    layers, part = problem.layers, problem.part
    if part is None or part.step is None or not isinstance(layers, (FaceLayersSpec, ProjectedLayersSpec)):
        return nullcontext()
    return read_ahead(part.step, _lain_on(layers, part.step))


def _lain_on(layers: FaceLayersSpec | ProjectedLayersSpec, step: StepSpec) -> Sequence[int | str] | str:
    """The faces of a file that the layers lie on."""
    return layers.source.faces if isinstance(layers, FaceLayersSpec) else step.faces


def faces(judged: Judged, places: Places) -> Iterator[Check]:
    """All checks of a print on faces; none for other prints."""
    layers, part = judged.problem.layers, judged.problem.part
    if part is None or part.step is None or not isinstance(layers, (FaceLayersSpec, ProjectedLayersSpec)):
        return
    covering = isinstance(layers, FaceLayersSpec)
    try:
        found = meshed_faces(part.step, _lain_on(layers, part.step))
    except OSError as error:
        yield not_read(f"{part.step.file.name}: {error.strerror}")
        return
    if isinstance(found, NotRead):
        yield not_read(f"{part.step.file.name}: {found.why}")
        return
    some = places.few(_MOST)
    rise = (some.layer + 1.0) * layers.height
    along_z = isinstance(layers, ProjectedLayersSpec) and layers.offset == "z"
    tips = some.tip - rise[:, None] * [0.0, 0.0, 1.0] if along_z else some.tip
    at = found.nearest(tips)
    away = tips - at.points
    sides = np.ones(len(tips)) if along_z else _sides(found, at.face, (away * at.normals).sum(axis=1))
    normals, bends = at.normals * sides[:, None], at.bends * sides[:, None]
    high = (away * normals).sum(axis=1)
    off = np.abs(high) if along_z else np.abs(high - rise)
    bound = OFF_LEVEL + OFF + (0.0 if covering else _SMOOTH)
    yield worst_of(judged, some, ON_PART, off * 1e3, bound * 1e3, "mm")
    lean = np.arccos(np.clip((normals * some.up).sum(axis=1), -1.0, 1.0))
    aside = np.linalg.norm(away - high[:, None] * normals, axis=1)
    # past a rim a bead keeps turning as the face bends there, and more so above a hollow, where the radius is smaller
    room = np.maximum(1.0 - bends * (0.0 if along_z else rise[:, None]), _FOLDED)
    turned = aside * (np.abs(bends) / room).max(axis=1)
    most = judged.problem.process.cones.tilt + AXIS + TURNED + turned
    yield beyond_limits(judged, some, NORMAL, np.degrees(lean), np.degrees(most), "deg")
    if isinstance(layers, FaceLayersSpec):
        limit = min(judged.problem.process.corner_tolerance, _RIM * layers.source.spacing) + OFF_LEVEL
        yield worst_of(judged, some, INSIDE, aside * 1e3, limit * 1e3, "mm")
        yield _covered(judged, layers, found, places)


def _sides(found: MeshedFaces, face: Ints, high: Array) -> Array:
    """1 (n), or -1 for loose faces that look the other way than the faces they adjoin: tips lie above these, too.

    At least one face must look where the file says.
    """
    out = np.ones(len(high))
    flipped = [k for k in np.unique(face).tolist() if not found.sure[k] and np.median(high[face == k]) < 0.0]
    if len(flipped) < len(found.sure):
        out[np.isin(face, flipped)] = -1.0
    return out


def _covered(judged: Judged, layers: FaceLayersSpec, found: MeshedFaces, places: Places) -> Check:
    """The check of the share of the faces that no bead comes near to."""
    spacing = max(layers.source.spacings)
    points, area = found.spread(_SPACED * spacing)
    near = _NEAR.get(layers.source.path, _THROUGH_SAMPLES) * spacing + OFF_LEVEL
    begun = begun_layers(judged)
    asked = {}
    for layer in range(layers.count):
        if layer in begun:
            continue
        rise = (layer + 1.0) * layers.height
        asked[layer] = AskedPlaces(points, area, np.full(len(points), np.hypot(near, rise)), float(area.sum()))
    return filled(places, asked, 0.0)
