"""A finished plan as its output folder holds it: plan.json, trajectory.csv, and the part guessed from both."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planner.errors import InputError, nearest_name

Array = NDArray[np.float64]

COLUMNS = ("t_s", "bead", "layer", "deposit", "x_mm", "y_mm", "z_mm", "ax", "ay", "az", "speed_mm_s")
FIT_TOLERANCE_MM = 0.05


@dataclass(frozen=True)
class Cylinder:
    """An upright part: centre (2,), radius and the z of its two ends, in mm."""

    centre: Array
    radius: float
    bottom: float
    top: float


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


def fit_cylinder(points: Array, normals: Array, layer: Array, printing: NDArray[np.bool_]) -> Cylinder | None:
    """The upright cylinder under the lowest layer, or None: points (n, 3) mm, outward unit normals (n, 3).

    Least squares of p_xy - r n_xy = c over the centre c and the radius r; it must hold to 0.05 mm everywhere.
    """
    lowest = printing & (layer == layer[printing].min())
    p, n = points[lowest], normals[lowest]
    if np.abs(n[:, 2]).max() > 1e-3:
        return None
    one, zero = np.ones(len(p)), np.zeros(len(p))
    A = np.vstack([np.column_stack([one, zero, n[:, 0]]), np.column_stack([zero, one, n[:, 1]])])
    b = np.concatenate([p[:, 0], p[:, 1]])
    solution, _, rank, _ = np.linalg.lstsq(A, b, rcond=1e-6)
    if rank < 3 or np.abs(A @ solution - b).max() > FIT_TOLERANCE_MM or solution[2] <= 0:
        return None
    z = points[printing, 2]
    # The part stands on z = 0; as much is left free above the print as below it.
    bottom = min(0.0, float(z.min()))
    return Cylinder(solution[:2], float(solution[2]), bottom, float(z.max()) + max(float(z.min()), 2.0))
