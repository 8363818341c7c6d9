"""A finished plan as its output folder holds it: plan.json, trajectory.csv, and report_part.stl."""

from __future__ import annotations

import json
import struct
from pathlib import Path
from typing import Any

import numpy as np
import trimesh

from planner.errors import InputError, nearest_name
from planner.readonly import Array

COLUMNS = ("t_s", "bead", "layer", "deposit", "x_mm", "y_mm", "z_mm", "ax", "ay", "az", "speed_mm_s", "flow_mm3_s")


def read_folder(folder: Path) -> tuple[dict[str, Any], dict[str, Array]]:
    """plan.json, and the columns of trajectory.csv that a picture needs, by name."""
    if not folder.is_dir():
        raise InputError(
            "no such folder", file=folder, hint="the folder that the planner wrote, e.g. out/cylinder_logo"
        )
    for name in ("plan.json", "trajectory.csv"):
        if not (folder / name).is_file():
            raise InputError(f"there is no {name} in this folder", file=folder, hint="has a plan been written here?")
    path = folder / "plan.json"
    try:
        summary = json.loads(path.read_text(encoding="utf-8"))
    except (json.JSONDecodeError, UnicodeDecodeError) as error:
        raise InputError(f"not JSON: {error}", file=path, line=getattr(error, "lineno", None)) from error
    for field, kind in (("problem", str), ("strategy", str), ("verified", bool), ("metrics", dict)):
        if not isinstance(summary, dict) or not isinstance(summary.get(field), kind):
            raise InputError("missing, or not what a plan has here", file=path, field=field)
    path = folder / "trajectory.csv"
    with path.open(encoding="utf-8", errors="replace") as stream:
        header = [name.strip() for name in stream.readline().split(",")]
        empty = not (stream.readline().strip() and stream.readline().strip())
    for name in COLUMNS:
        if name not in header:
            near = nearest_name(name, header)
            raise InputError("no such column", file=path, line=1, field=name, hint=f"there is {near}" if near else None)
    if empty:
        raise InputError("the table is empty", file=path, line=2)
    try:
        table = np.loadtxt(path, delimiter=",", skiprows=1, usecols=[header.index(n) for n in COLUMNS], ndmin=2)
    except (ValueError, UnicodeDecodeError) as error:
        raise InputError(f"not a table of numbers: {error}", file=path) from error
    return summary, dict(zip(COLUMNS, table.T, strict=True))


def read_part(folder: Path) -> Array:
    """Triangles (n, 3, 3) of the part [mm] in report_part.stl; none where there is no such file.

    Raises InputError for a file that is no STL file.
    """
    path = folder / "report_part.stl"
    if not path.is_file():
        return np.zeros((0, 3, 3))
    try:
        with path.open("rb") as stream:
            mesh = trimesh.load_mesh(stream, file_type="stl", process=False)
        triangles = np.asarray(mesh.triangles, dtype=float)
    except (ValueError, TypeError, IndexError, struct.error, UnicodeDecodeError) as error:
        raise InputError("not an STL file", file=path) from error
    if not (len(triangles) and np.isfinite(triangles).all()):
        raise InputError("no triangles, or one with a corner that is no number", file=path)
    return triangles
