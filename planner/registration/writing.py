"""A placement written into a copy of a problem file, whose comments and order stay as they are."""

from __future__ import annotations

import io
import os
import re
import tempfile
import warnings
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from ruamel.yaml import YAML
from ruamel.yaml.comments import CommentedSeq
from scipy.spatial.transform import Rotation

from planner.errors import InputError, OutputError
from planner.problem import Problem, load_problem
from planner.problem.fields import Section
from planner.registration.placement import Placement

Array = NDArray[np.float64]
Keys = tuple[str | int, ...]

_MM, _DEG = 4, 5  # decimals: a tenth of a micrometre, and as much at a metre
_UPRIGHT = ("x", "y")


def changes_of(problem: Problem, placement: Placement, start: Placement, free: Sequence[str]) -> dict[Keys, Any]:
    """The fields of a problem file that say where the part is, with their new values in mm and degrees."""
    cell, out = problem.cell, dict[Keys, Any]()
    T = placement.T_plate_part
    moved = np.linalg.inv(start.T_plate_part) @ T
    cylinder = None if problem.part is None else problem.part.cylinder
    if cylinder is not None and set(free) <= set(_UPRIGHT):
        out["part", "cylinder", "centre_mm"] = _mm(np.asarray(cylinder.centre) + moved[:2, 3])
    elif free:
        section: Keys = ("cell",) if cell.positioner is None else ("cell", "positioner")
        name = "bed" if cell.positioner is None else "part"
        out[*section, f"{name}_mm"] = _mm(T[:3, 3])
        if np.abs(moved[:3, :3] - np.eye(3)).max() > 0.0:
            out[*section, f"{name}_rpy_deg"] = rpy_degrees(T[:3, :3])
    if cell.positioner is not None and np.abs(placement.shift).max() > 0.0:
        origin = cell.positioner.origin
        key, at = ("base_mm", cell.positioner.base) if origin is None else ("origin_mm", origin)
        out["cell", "positioner", key] = _mm(np.asarray(at) + placement.shift)
    if placement.growth != 0.0 and problem.part is not None:
        for body, spec in (("cylinder", cylinder), ("sphere", problem.part.sphere)):
            if spec is not None:
                out["part", body, "radius_mm"] = _mm(np.array([spec.radius + placement.growth]))[0]
    return out


def rpy_degrees(R: Array) -> list[float]:
    """The turns about x, then y, then z of the parent's frame that make a rotation (3, 3) [deg]."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # where y is turned by 90 degrees x and z are one, and x is chosen
        angles = Rotation.from_matrix(R).as_euler("xyz", degrees=True)
    return [float(a) + 0.0 for a in np.round(angles, _DEG)]


def _mm(p: Array) -> list[float]:
    return [float(v) + 0.0 for v in np.round(p * 1e3, _MM)]


def write_problem(problem: Problem, changes: Mapping[Keys, Any], target: Path, remark: str) -> Problem:
    """Write the problem's file anew with changed fields, a remark above; returns it as it is read back.

    Files that it names are named as they are seen from the target's folder. Raises OutputError where the target is
    there already or cannot be written.
    """
    yaml = YAML()
    yaml.preserve_quotes = True
    yaml.width = 100_000  # no line is broken that was not
    text = problem.file.read_text(encoding="utf-8-sig")
    indent, offset = _indents(text)
    yaml.indent(mapping=indent, sequence=offset + 2, offset=offset)
    data = yaml.load(text)
    for keys, path in _files(problem, ()):
        if not Path(_at(data, keys)).is_absolute():
            _put(data, keys, Path(os.path.relpath(path, target.parent)).as_posix())
    for keys, value in changes.items():
        _put(data, keys, value)
    stream = io.StringIO()
    yaml.dump(data, stream)
    new = f"# {remark}\n{stream.getvalue()}"
    try:
        with tempfile.NamedTemporaryFile("w", suffix=".yaml", dir=target.parent, encoding="utf-8") as trial:
            trial.write(new)
            trial.flush()
            written = load_problem(Path(trial.name))  # nothing is left behind that cannot be read
        with target.open("x", encoding="utf-8") as file:
            file.write(new)
    except FileExistsError:
        raise taken(target) from None
    except OSError as error:
        raise OutputError(f"cannot write {target}: {error.strerror}") from error
    if written.name != problem.name:
        raise InputError("changed while it was read", file=problem.file)
    return load_problem(target)


def taken(target: Path) -> OutputError:
    """What is said of a target that is there already."""
    return OutputError(f"{target} is there already: it is not written over; name another with --out")


def _files(section: Any, path: Keys) -> Iterator[tuple[Keys, Path]]:
    """Every file that a section of the problem names, by its keys."""
    if isinstance(section, Path):
        yield path, section
    elif isinstance(section, Section):
        for name, field in type(section).model_fields.items():
            if name in section.model_fields_set:
                yield from _files(getattr(section, name), (*path, field.alias or name))
    elif isinstance(section, Mapping):
        for key, value in section.items():
            yield from _files(value, (*path, key))
    elif isinstance(section, (tuple, list)):
        for i, value in enumerate(section):
            yield from _files(value, (*path, i))


def _at(data: Any, keys: Keys) -> Any:
    for key in keys:
        data = data[key]
    return data


def _indents(text: str) -> tuple[int, int]:
    """By how much a file indents sections, and the dashes of lists below their key, as it does first; or two and two."""
    section = re.search(r"^(?:[^\s#-].*:\s*(?:#.*)?)\n(?:\s*#.*\n)*( +)[^\s#-]", text, re.MULTILINE)
    item = re.search(r"^( *)[^\s#-][^\n]*:[ \t]*(?:#.*)?\n(?:\s*#.*\n)*( *)- ", text, re.MULTILINE)
    return (2 if section is None else len(section[1])), (2 if item is None else max(0, len(item[2]) - len(item[1])))


def _put(data: Any, keys: Keys, value: Any) -> None:
    """Set the value at keys; a list stays in the style that it has."""
    section = _at(data, keys[:-1])
    old = section.get(keys[-1]) if isinstance(keys[-1], str) else section[keys[-1]]
    if isinstance(value, list):
        if isinstance(old, CommentedSeq) and len(old) == len(value):
            for i, v in enumerate(value):
                if old[i] != v:
                    old[i] = v
            return
        value = CommentedSeq(value)
        value.fa.set_flow_style()
    section[keys[-1]] = value
