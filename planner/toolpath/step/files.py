"""Faces of a STEP file, in the part frame: read by another process, which a damaged file may end."""

from __future__ import annotations

import io
import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from planner.errors import Complaint
from planner.input_file import read_bytes
from planner.problem.faces import StepSpec
from planner.toolpath.step.face import Face
from planner.toolpath.step.splines import SplineSet, SplineSurface

LARGEST_FILE = 100_000_000  # bytes
FARTHEST = 100.0  # m from the origin: a hall
LONGEST = 300  # s that a file may take
_READER = "planner.toolpath.step.reader"
_ROOT = Path(__file__).resolve().parents[3]  # from where that is found, whatever the present folder
_BEGIN, _END = b"ISO-10303-21", b"END-ISO-10303-21"
_ENDS = 2048  # bytes of a file in which they stand


def read_step(spec: StepSpec, apart: float, where: Complaint) -> tuple[Face, ...]:
    """The faces `spec.faces` of a file, in part frame; points of their edges at most `apart` [m] from each other.

    `where(reason, hint=...)` makes the InputError for what is wrong with the file.
    """
    name = spec.file.name
    check_step(spec.file, where)
    request = {"file": str(spec.file.resolve()), "faces": spec.faces, "apart_mm": apart * 1e3}
    answer = _answer(request, name, where)
    if "reason" in answer:
        raise where(str(answer["reason"]), hint=str(answer["hint"]) or None)
    turn = Rotation.from_euler("xyz", spec.rpy).as_matrix()
    faces = [_face(answer, k, turn, spec) for k in range(int(answer["faces"]))]
    for face in faces:
        poles = face.surface.poles
        finite = (
            np.isfinite(poles).all() and (poles[:, :, 3] > 0.0).all() and all(np.isfinite(x).all() for x in face.loops)
        )
        if not finite or not (np.abs(poles[:, :, :3] / poles[:, :, 3:]) <= FARTHEST).all():
            raise where(f"{face.title} of {name} is no surface, or farther than {FARTHEST:g} m from the origin")
    return tuple(faces)


def check_step(path: Path, where: Complaint) -> None:
    """Raise the InputError, made by `where`, of a file that is missing, no STEP file, or cut off."""
    data = read_bytes(path, LARGEST_FILE, where)
    if _BEGIN not in data[:_ENDS]:
        raise where(f"{path.name} is no STEP file: it does not begin with {_BEGIN.decode()}", hint="export it as STEP")
    if _END not in data[-_ENDS:]:
        raise where(f"{path.name} is damaged: its end is missing", hint="export it anew")


def _answer(request: dict[str, Any], name: str, where: Complaint) -> dict[str, Any]:
    damaged = where(
        f"{name} is damaged: Open CASCADE cannot read it", hint="repair it in a CAD program, and export it anew"
    )
    paths = os.pathsep.join([str(_ROOT), *filter(None, [os.environ.get("PYTHONPATH")])])
    try:
        done = subprocess.run(
            [sys.executable, "-m", _READER],
            input=json.dumps(request).encode(),
            capture_output=True,
            timeout=LONGEST,
            env={**os.environ, "PYTHONPATH": paths},
            check=False,
        )
    except subprocess.TimeoutExpired:
        raise where(
            f"{name} takes more than {LONGEST} s to be read", hint="export the part without its details"
        ) from None
    if done.returncode != 0:
        raise damaged
    with np.load(io.BytesIO(done.stdout), allow_pickle=False) as arrays:
        return dict(arrays)


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
