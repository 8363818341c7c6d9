"""Contacts of shipped problems, true or off, in files."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from functools import cache
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from benchmarks.touching import cartesian, tips_of, write_contacts
from planner.base.arrays import Array
from planner.problem import load_problem
from planner.register.finding import Ask, Scene, plan_contacts, scene_of
from planner.register.fitting import Placement

PART = Ask()
MOVED, TURNED = (3.0, -2.0, 1.5), (1.5, -1.0, 0.8)


SPARSE = {
    "curved_plate": "layers.source.spacing_mm=50",  # rows of the print
    "shoehorn": "layers.source.spacing_mm=20",
    "aerofoil_core": "layers.source.size_mm=[30, 99]",  # a strip
}


@cache
def scene(name: str, *overrides: str) -> Scene:
    return scene_of(load_problem(name, (*overrides, *([SPARSE[name]] if name in SPARSE else []))))


@cache
def chosen(name: str, count: int, ask: Ask = PART, overrides: tuple[str, ...] = ()) -> tuple[Array, Array]:
    """Places and angles of the holder that are suggested for a problem."""
    places, best = plan_contacts(scene(name, *overrides), ask, count)
    return places.points[best], places.q[best]


def contacts(
    path: Path, name: str, truth: Placement, count: int, off: Sequence[float] = (), ask: Ask = PART, overrides=()
) -> Path:  # fmt: skip
    points, q = chosen(name, count, ask, overrides)
    above = np.zeros(count)
    above[: len(off)] = off
    here = scene(name, *overrides)
    return write_contacts(path / "contacts.csv", cartesian(here, tips_of(here, truth, points, above, q), q))


def apart(one: Placement, other: Placement) -> tuple[float, Array]:
    """How far two placements are apart: the part's origin [m], and the turn in the part frame (3) [rad]."""
    E = np.linalg.inv(one.T_plate_part) @ other.T_plate_part
    return float(np.linalg.norm(E[:3, 3])), Rotation.from_matrix(E[:3, :3]).as_rotvec()


@cache
def scratch() -> Path:
    return Path(tempfile.mkdtemp(prefix="beadwise-contacts-"))
