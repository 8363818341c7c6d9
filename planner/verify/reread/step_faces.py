"""Faces of a STEP or IGES file read again: triangles by Open CASCADE's own mesher in a separate process, and nearest
points on them by coal. Lengths are in metres in the part frame.
"""

from __future__ import annotations

import subprocess
from collections.abc import Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from typing import Any, NamedTuple

import coal
import numpy as np
from scipy.spatial.transform import Rotation

from planner.base.arrays import Array, Ints
from planner.base.isolated import Killed, ask, asked_ahead
from planner.problem.part import StepSpec
from planner.verify.bodies import triangle_model
from planner.verify.reread.plane_curves import NotRead

OFF = 2e-6  # m: triangles may lie this far off the faces
TURNED = np.radians(0.1)  # normals interpolated in triangles may differ this much from a face's
_HALF = 0.5  # × TURNED: allowed halfway between corners, since elsewhere normals may be off by more
_PROCESS = "planner.verify.reread.step_process"
_LONGEST = 300  # s that a file may take
_MOST_KNOWN = 2  # files whose faces are kept
_MARK = 72  # column, from 0, of the S in an IGES file's first line
_POINT = 1e-9  # m: radius of a ball that represents a point


@dataclass(frozen=True)
class FaceFeet:
    """Nearest places (n) on faces: points, outward unit normals (n, 3), faces (n), bends (n, 2): see `MeshedFaces`."""

    points: Array
    normals: Array
    face: Ints
    bends: Array


@dataclass(frozen=True)
class MeshedFaces:
    """Faces as triangles.

    corners, normals  (m, 3, 3) of the triangles [m]; unit normals as in the file
    bends             (m, 2) least and greatest principal curvature at a triangle's corners [1/m]; positive in hollows
    face              (m) that each belongs to
    sure              whether a solid determines which way each face looks
    """

    corners: Array
    normals: Array
    bends: Array
    face: Ints
    sure: Sequence[bool]
    model: coal.BVHModelOBBRSS

    def nearest(self, points: Array) -> FaceFeet:
        """The places nearest to points (n, 3)."""
        ball, still, request, at = coal.Sphere(_POINT), coal.Transform3s(), coal.DistanceRequest(), coal.Transform3s()
        request.enable_signed_distance = False
        triangle, foot = np.empty(len(points), dtype=np.int64), np.empty((len(points), 3))
        for i, point in enumerate(points):
            at.setTranslation(point)
            result = coal.DistanceResult()
            coal.distance(self.model, still, ball, at, request, result)
            triangle[i], foot[i] = result.b1, result.getNearestPoint1()
        a, b, c = (self.corners[triangle, k] for k in range(3))
        shares = np.stack([_area(foot, b, c), _area(a, foot, c), _area(a, b, foot)], axis=1)
        shares = shares / np.maximum(shares.sum(axis=1), 1e-300)[:, None]
        normals = (shares[:, :, None] * self.normals[triangle]).sum(axis=1)
        return FaceFeet(
            foot, normals / np.linalg.norm(normals, axis=1)[:, None], self.face[triangle], self.bends[triangle]
        )

    def spread(self, apart: float) -> tuple[Array, Array]:
        """Places (n, 3) all over the faces, up to `apart` [m] from each other, and the area (n) of each."""
        points, areas = [], []
        across = np.cross(self.corners[:, 1] - self.corners[:, 0], self.corners[:, 2] - self.corners[:, 0])
        whole = 0.5 * np.linalg.norm(across, axis=1)
        longest = np.linalg.norm(np.roll(self.corners, -1, axis=1) - self.corners, axis=2).max(axis=1)
        pieces = np.maximum(np.ceil(longest / apart), 1.0).astype(int)
        for count in np.unique(pieces):
            own = np.flatnonzero(pieces == count)
            weights = _middles(int(count))
            points.append(np.einsum("wk,mkx->mwx", weights, self.corners[own]).reshape(-1, 3))
            areas.append(np.repeat(whole[own] / len(weights), len(weights)))
        return np.concatenate(points), np.concatenate(areas)


def _area(a: Array, b: Array, c: Array) -> Array:
    return np.asarray(np.linalg.norm(np.cross(b - a, c - a), axis=1))


def _middles(count: int) -> Array:
    """Barycentric coordinates (n, 3) of the centres of a triangle's pieces, with each side cut into `count`."""
    out = []
    for i in range(count):
        for j in range(count - i):
            out.append((i + 1 / 3, j + 1 / 3))
            if i + j < count - 1:
                out.append((i + 2 / 3, j + 2 / 3))
    uv = np.array(out) / count
    return np.column_stack([uv, 1.0 - uv.sum(axis=1)])


class _Wanted(NamedTuple):
    """Faces of a file; its time of change and size distinguish it from other versions."""

    spec: StepSpec
    faces: tuple[int | str, ...] | str
    changed: int
    size: int

    @classmethod
    def of(cls, spec: StepSpec, faces: Sequence[int | str] | str) -> _Wanted:
        """With the file's current stamp. Raises OSError for a file that is missing."""
        stamp = spec.file.stat()
        return cls(spec, faces if isinstance(faces, str) else tuple(faces), stamp.st_mtime_ns, stamp.st_size)

    @property
    def question(self) -> dict[str, Any]:
        """The request to the process. Raises OSError."""
        head = self.spec.file.read_bytes()[: _MARK + 8]
        return {
            "file": str(self.spec.file.resolve()), "iges": head[_MARK : _MARK + 1] == b"S" and b"ISO-10303" not in head,
            "faces": self.faces, "off_mm": OFF * 1e3, "turned": _HALF * TURNED,
        }  # fmt: skip


_known: dict[_Wanted, MeshedFaces | NotRead] = {}  # the most recent results


def meshed_faces(spec: StepSpec, faces: Sequence[int | str] | str) -> MeshedFaces | NotRead:
    """Faces of a file by their names and numbers, as triangles. Raises OSError for a file that is missing."""
    wanted = _Wanted.of(spec, faces)
    if wanted not in _known:
        try:
            found = _meshed(wanted)
        except Killed as killed:
            return NotRead(str(killed))
        for old in list(_known)[: 1 - _MOST_KNOWN]:
            del _known[old]
        _known[wanted] = found
    return _known[wanted]


def read_ahead(spec: StepSpec, faces: Sequence[int | str] | str) -> AbstractContextManager[None]:
    """Context in which faces are read in the background, so that `meshed_faces` has them sooner; known ones are not."""
    try:
        wanted = _Wanted.of(spec, faces)
        return nullcontext() if wanted in _known else asked_ahead(_PROCESS, wanted.question)
    except OSError:  # reported when the faces are needed
        return nullcontext()


def _meshed(wanted: _Wanted) -> MeshedFaces | NotRead:
    """The faces. Raises OSError, and Killed."""
    try:
        answer = ask(_PROCESS, wanted.question, _LONGEST)
    except subprocess.TimeoutExpired:
        return NotRead(f"it takes more than {_LONGEST} s")
    if answer is None:
        return NotRead("Open CASCADE ends while it reads or meshes the file")
    if "reason" in answer or not int(answer["faces"]):
        return NotRead(str(answer.get("reason", "it holds no such face")))
    return _placed(wanted.spec, answer)


def _placed(spec: StepSpec, answer: dict[str, Array]) -> MeshedFaces:
    """The faces in the part frame."""
    turn = Rotation.from_euler("xyz", spec.rpy).as_matrix()
    flip = -1.0 if spec.normals == "inward" else 1.0
    corners, normals, bends, owner = [], [], [], []
    for k in range(int(answer["faces"])):
        of = answer[f"{k}.corners"]
        points = 1e-3 * answer[f"{k}.points"] @ turn.T + np.asarray(spec.origin)
        own = flip * answer[f"{k}.normals"] @ turn.T
        flat = np.cross(points[of[:, 1]] - points[of[:, 0]], points[of[:, 2]] - points[of[:, 0]])
        there = np.linalg.norm(flat, axis=1) > 0.0
        of, flat = of[there], flip * flat[there]
        at_corners = own[of]
        lost = np.isnan(at_corners).any(axis=2)  # at a pole, the triangle's own normal is used
        at_corners[lost] = (flat / np.linalg.norm(flat, axis=1)[:, None])[np.nonzero(lost)[0]]
        bent = flip * 1e3 * np.nan_to_num(answer[f"{k}.bends"])[of].reshape(len(of), -1)
        corners.append(points[of])
        normals.append(at_corners)
        bends.append(np.column_stack([bent.min(axis=1), bent.max(axis=1)]))
        owner.append(np.full(len(of), k, dtype=np.int64))
    every = np.concatenate(corners)
    model = triangle_model(every.reshape(-1, 3), np.arange(3 * len(every)).reshape(-1, 3))
    sure = answer["sure"].tolist()
    return MeshedFaces(every, np.concatenate(normals), np.concatenate(bends), np.concatenate(owner), sure, model)
