"""Faces of a STEP or IGES file in the part frame, chosen by name or number.

Another process reads the file, because a damaged one may end its reader.
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
_SHOWN = 12  # names of faces in a message

FARTHEST = 100.0  # m from the origin: a hall
_WIDEST = 1e9  # of a surface's domain: files count in millimetres, radians, or from 0 to 1
_READER = "planner.toolpath.step.reader"


@dataclass(frozen=True)
class Face(ReadOnlyArrays):
    """One face (metres, part frame), as algorithms that cover faces see it.

    number    in the file, from 1; name as it stands there, often empty
    loops     closed curves (m, 2) in u and v that trim it, the first point not repeated; the outer one first
    edges     for each loop, the number of the edge that each point stands on (the first of the two where edges meet);
              faces that share an edge share its number, and the places of its points
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
        """What a message calls it."""
        return f"face {self.number} {self.name!r}" if self.name else f"face {self.number}"

    def points(self, uv: Array) -> Array:
        """Points (n, 3) at parameters (n, 2) [m]."""
        return self.alone.points(np.zeros(len(uv), dtype=np.int64), uv)

    def normals(self, uv: Array) -> Array:
        """Unit outward normals (n, 3) at parameters (n, 2)."""
        return self.side * self.alone.normals(np.zeros(len(uv), dtype=np.int64), uv)


class Damaged(ValueError):
    """What is wrong with a file, or with what is wanted of it, and what to do about it."""

    def __init__(self, reason: str, hint: str | None = None) -> None:
        self.reason, self.hint = reason, hint
        super().__init__(reason)


def choose_faces(wanted: Wanted, known: Sequence[tuple[int, str]], what: str) -> list[int]:
    """Numbers of the faces that are wanted, in the order of `known` (their numbers and names); a name may be several's.

    Raises Damaged for a face that is not there, with those that are.
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
    """Faces of a file, and sentences about what of it was not read, or was changed."""

    faces: tuple[Face, ...]
    notes: tuple[str, ...]


def read_step(spec: StepSpec, apart: float, where: Complaint) -> tuple[Face, ...]:
    """The faces alone of `read_faces`."""
    return read_faces(spec, apart, where).faces


def read_faces(spec: StepSpec, apart: float, where: Complaint) -> FacesRead:
    """The faces `spec.faces` of a file, in part frame; points of their edges at most `apart` [m] from each other.

    `where(reason, hint=...)` makes the InputError for what is wrong with the file.
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
            raise where(f"{face.title} of {name} is no surface, or farther than {FARTHEST:g} m from the origin")
    return FacesRead(tuple(faces), tuple(f"part.step: {name}: {note}" for note in answer["notes"]))


def _ascend(knots: Array, degree: int) -> bool:
    """Whether knots are those of a spline of a degree: none before the one in front of it, over a domain that has a length."""
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
