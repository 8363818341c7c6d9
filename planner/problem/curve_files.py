"""Files of NURBS curves: JSON with the keys of the problem file, read with the line of every mistake."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from pydantic import ValidationError

from planner.base.errors import Complaint, InputError
from planner.problem.cad_files import IGES_ENDINGS, STEP_ENDINGS, asked, check_step
from planner.problem.drawings import FARTHEST_MM, CurveListSpec, CurveSpec
from planner.problem.problem import first_mistake
from planner.problem.yaml_file import LARGEST_FILE, ValueSources, parse_yaml

_CURVES = "planner.problem.cad_curves"


def read_curves(path: Path, where: Complaint) -> tuple[CurveSpec, ...]:
    """The curves of a file, in its order.

    The file is JSON, `{"curves": [{"degree": 2, "points_mm": [...]}, ...]}`, or STEP or IGES, of which curves that
    bound no face are taken. Raises InputError with the file's line for a mistake in it, and the one made by
    `where(reason, hint=...)` for a file that cannot be read.
    """
    if path.suffix.lower() in (*STEP_ENDINGS, *IGES_ENDINGS):
        return _listed(_of_cad(path, where), ValueSources(path, {}))
    try:
        raw = path.read_bytes()
    except OSError as error:
        raise where(f"cannot read {path.name}: {error.strerror}") from None
    if len(raw) > LARGEST_FILE:
        raise where(f"{path.name} has {len(raw)} bytes", hint=f"at most {LARGEST_FILE}")
    try:
        text = raw.decode("utf-8-sig").replace("\t", " ")  # JSON is YAML, except for tabs
    except UnicodeDecodeError:
        raise where(f"{path.name} is not text (UTF-8)") from None

    def complain(reason: str, line: int | None, hint: str | None) -> InputError:
        return InputError(reason, file=path, line=line, hint=hint)

    lines: dict[tuple[str | int, ...], int] = {}
    data = parse_yaml(text, complain, lines)
    if not isinstance(data, dict):
        hint = 'for example {"curves": [{"degree": 2, "points_mm": [[0, 0, 0], [10, 5, 0], [20, 0, 5]]}]}'
        raise complain("has no list of curves", 1, hint)
    return _listed(data, ValueSources(path, lines))


def _listed(data: dict[str, Any], source: ValueSources) -> tuple[CurveSpec, ...]:
    try:
        return CurveListSpec.model_validate(data, context=source).curves
    except ValidationError as error:
        raise first_mistake(error.errors(include_url=False), source, CurveListSpec) from None


def _of_cad(path: Path, where: Complaint) -> dict[str, Any]:
    """The contents of a STEP or IGES file, in the form of a JSON file of curves."""
    check_step(path, where)
    found = asked(_CURVES, {"file": str(path.resolve())}, path.name, where)
    curves = []
    for k in range(int(found["curves"])):
        points, weights, knots = (found[f"{k}.{key}"].tolist() for key in ("points", "weights", "knots"))
        degree, far = int(found[f"{k}.degree"]), float(np.abs(points).max())
        if far > FARTHEST_MM:
            raise where(
                f"curve {k + 1} of {found['curves']} in {path.name} has a coordinate of {far:g} mm",
                hint=f"at most {FARTHEST_MM:g}: is it a construction line, or is the file in the wrong unit?",
            )
        curve = {"degree": degree, "points_mm": tuple(map(tuple, points))}
        curves.append(curve | {"weights": tuple(weights), "knots": tuple(knots)})
    return {"curves": tuple(curves)}
