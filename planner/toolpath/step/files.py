"""Faces of a STEP or IGES file in the part frame, chosen by name or number.

A separate process reads the file, because a damaged one may crash its reader.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from planner.base.arrays import Array, Ints, ReadOnlyArrays
from planner.base.errors import Complaint
from planner.problem.cad_files import asked, check_step
from planner.problem.part import StepSpec
from planner.toolpath.step.splines import SplineSet, SplineSurface

Wanted = Sequence[int | str] | str
_SHOWN = 12  # most face names in a message

FARTHEST = 100.0  # m from the origin: the size of a hall
_WIDEST = 1e9  # greatest width of a surface's domain: parameters are in millimetres or radians, or run from 0 to 1
_READER = "planner.toolpath.step.reader"


@dataclass(frozen=True)
class Face(ReadOnlyArrays):
    """One face (metres, part frame), as seen by the algorithms that cover faces.

    number    in the file, from 1; name as given there, often empty
    loops     closed curves (m, 2) in u and v that trim it, the first point not repeated; the outer one first
    edges     for each loop, the number of the edge that each point lies on (where edges meet, of the one that begins);
              faces that share an edge share its number and the positions of its points
    side      1 where du x dv points out of the material, -1 where it points into it
    """

    number: int
    name: str
    surface: SplineSurface
    loops: tuple[Array, ...]
    edges: tuple[Ints, ...]
    side: int
    alone: SplineSet = field(repr=False)

    @property
    def title(self) -> str:
        """Its name in messages."""
        return f"face {self.number} {self.name!r}" if self.name else f"face {self.number}"

    def points(self, uv: Array) -> Array:
        """Points (n, 3) at parameters (n, 2) [m]."""
        return self.alone.points(np.zeros(len(uv), dtype=np.int64), uv)

    def normals(self, uv: Array) -> Array:
        """Unit outward normals (n, 3) at parameters (n, 2)."""
        return self.side * self.alone.normals(np.zeros(len(uv), dtype=np.int64), uv)


class Damaged(ValueError):
    """A fault of a file, or of what is requested from it, and what to do about it."""

    def __init__(self, reason: str, hint: str | None = None) -> None:
        self.reason, self.hint = reason, hint
        super().__init__(reason)


def choose_faces(wanted: Wanted, known: Sequence[tuple[int, str]], what: str) -> list[int]:
    """Numbers of the wanted faces, in the order of `known` (numbers and names); several faces may share a name.

    Raises Damaged for a face that does not exist, listing those that do.
    """
    if isinstance(wanted, str):  # all
        return [number for number, _ in known]
    chosen = set()
    for face in wanted:
        found = [number for number, name in known if face in (number, name)]
        if not found:
            names = sorted({name for _, name in known if name})
            shown = ", ".join(names[:_SHOWN]) + (", ..." if len(names) > _SHOWN else "")
            numbers = f"numbers {known[0][0]} to {known[-1][0]}" if known else "none"
            raise Damaged(
                f"there is no face {face!r} in {what}", hint=f"faces: {numbers}; names: {shown}" if names else numbers
            )
        chosen.update(found)
    return [number for number, _ in known if number in chosen]


class FacesRead(NamedTuple):
    """Faces of a file, and sentences about what was not read or was changed."""

    faces: tuple[Face, ...]
    notes: tuple[str, ...]


def read_step(spec: StepSpec, apart: float, where: Complaint) -> tuple[Face, ...]:
    """The faces of `read_faces`, without its notes."""
    return read_faces(spec, apart, where).faces


def read_faces(spec: StepSpec, apart: float, where: Complaint) -> FacesRead:
    """The faces `spec.faces` of a file, in part frame, with points on their edges at most `apart` [m] apart.

    `where(reason, hint=...)` makes the InputError for a fault of the file.
    """
    name = spec.file.name
    check_step(spec.file, where)
    request = {
        "file": str(spec.file.resolve()), "faces": spec.faces, "apart_mm": apart * 1e3, "sew_mm": spec.sew * 1e3,
    }  # fmt: skip
    answer = asked(_READER, request, name, where)
    turn = Rotation.from_euler("xyz", spec.rpy).as_matrix()
    faces = [_face(answer, k, turn, spec) for k in range(int(answer["faces"]))]
    for face in faces:
        poles = face.surface.poles
        finite = (
            np.isfinite(poles).all() and (poles[:, :, 3] > 0.0).all() and all(np.isfinite(x).all() for x in face.loops)
        )
        finite = finite and all(map(_ascend, (face.surface.knots_u, face.surface.knots_v), face.surface.degrees))
        if not finite or not (np.abs(poles[:, :, :3] / poles[:, :, 3:]) <= FARTHEST).all():
            raise where(f"{face.title} of {name} is not a surface, or is farther than {FARTHEST:g} m from the origin")
    return FacesRead(tuple(faces), tuple(f"part.step: {name}: {note}" for note in answer["notes"]))


def _ascend(knots: Array, degree: int) -> bool:
    """Whether knots suit a spline of this degree: they never decrease, and the domain has a positive, sane length."""
    return bool((np.diff(knots) >= 0.0).all() and 0.0 < knots[-degree - 1] - knots[degree] <= _WIDEST)


def _face(answer: dict[str, Any], k: int, turn: Any, spec: StepSpec) -> Face:
    poles = answer[f"{k}.poles"].copy()
    poles[:, :, :3] *= 1e-3
    surface = SplineSurface(answer[f"{k}.knots_u"], answer[f"{k}.knots_v"], poles).placed(turn, np.asarray(spec.origin))
    loops = range(int(answer[f"{k}.loops"]))
    return Face(
        int(answer["numbers"][k]),
        str(answer["names"][k]),
        surface,
        tuple(answer[f"{k}.loop.{w}"] for w in loops),
        tuple(answer[f"{k}.edges.{w}"] for w in loops),
        int(answer["sides"][k]) * (-1 if spec.normals == "inward" else 1),
        SplineSet.of([surface]),
    )
