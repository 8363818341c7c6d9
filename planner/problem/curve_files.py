"""Files of NURBS curves: JSON with the keys of the problem file, read with the line of every mistake."""

from __future__ import annotations

from pathlib import Path

from pydantic import ValidationError

from planner.base.errors import Complaint, InputError
from planner.problem.drawings import CurveListSpec, CurveSpec
from planner.problem.problem import first_mistake
from planner.problem.yaml_file import LARGEST_FILE, ValueSources, parse_yaml


def read_curves(path: Path, where: Complaint) -> tuple[CurveSpec, ...]:
    """The curves of a file, `{"curves": [{"degree": 2, "points_mm": [...]}, ...]}`, in its order.

    Raises InputError with the file's line for what is wrong in it, and made by `where(reason, hint=...)` for a file that
    cannot be read.
    """
    try:
        raw = path.read_bytes()
    except OSError as error:
        raise where(f"cannot read {path.name}: {error.strerror}") from None
    if len(raw) > LARGEST_FILE:
        raise where(f"{path.name} has {len(raw)} bytes", hint=f"at most {LARGEST_FILE}")
    try:
        text = raw.decode("utf-8-sig").replace("\t", " ")  # JSON is YAML but for tabs
    except UnicodeDecodeError:
        raise where(f"{path.name} is not text (UTF-8)") from None

    def complain(reason: str, line: int | None, hint: str | None) -> InputError:
        return InputError(reason, file=path, line=line, hint=hint)

    lines: dict[tuple[str | int, ...], int] = {}
    data = parse_yaml(text, complain, lines)
    if not isinstance(data, dict):
        hint = 'for example {"curves": [{"degree": 2, "points_mm": [[0, 0, 0], [10, 5, 0], [20, 0, 5]]}]}'
        raise complain("has no list of curves", 1, hint)
    source = ValueSources(path, lines)
    try:
        return CurveListSpec.model_validate(data, context=source).curves
    except ValidationError as error:
        raise first_mistake(error.errors(include_url=False), source, CurveListSpec) from None
