"""The fields of a problem file that say where its part and its table are."""

from __future__ import annotations

import warnings
from collections.abc import Sequence

import numpy as np
from scipy.spatial.transform import Rotation

from planner.problem import Problem
from planner.problem.rewrite import Value
from planner.readonly import Array
from planner.registration.placement import Placement

_MM, _DEG = 4, 5  # decimals: a tenth of a micrometre, and as much at a metre
_TURNED = 1e-9  # rad: less is rounding


def changes_of(problem: Problem, placement: Placement, start: Placement, free: Sequence[str]) -> dict[str, Value]:
    """The fields of a problem file that say where the part is, dotted, with their new values in mm and degrees."""
    cell, out = problem.cell, dict[str, Value]()
    T = placement.T_plate_part
    moved = np.linalg.inv(start.T_plate_part) @ T
    if free:
        name = "cell.bed" if cell.positioner is None else "cell.positioner.part"
        out[f"{name}_mm"] = _mm(T[:3, 3])
        if np.abs(moved[:3, :3] - np.eye(3)).max() > _TURNED:
            out[f"{name}_rpy_deg"] = rpy_degrees(T[:3, :3])
    if cell.positioner is not None and np.abs(placement.shift).max() > 0.0:
        origin = cell.positioner.origin
        key, at = ("base_mm", cell.positioner.base) if origin is None else ("origin_mm", origin)
        out[f"cell.positioner.{key}"] = _mm(np.asarray(at) + placement.shift)
    if placement.growth != 0.0 and problem.part is not None:
        for body, spec in (("cylinder", problem.part.cylinder), ("sphere", problem.part.sphere)):
            if spec is not None:
                out[f"part.{body}.radius_mm"] = _mm(np.array([spec.radius + placement.growth]))[0]
    return out


def rpy_degrees(R: Array) -> list[float]:
    """The turns about x, then y, then z of the parent's frame that make a rotation (3, 3) [deg]."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # where y is turned by 90 degrees x and z are one, and x is chosen
        angles = Rotation.from_matrix(R).as_euler("xyz", degrees=True)
    return [float(a) + 0.0 for a in np.round(angles, _DEG)]


def _mm(p: Array) -> list[float]:
    return [float(v) + 0.0 for v in np.round(p * 1e3, _MM)]
