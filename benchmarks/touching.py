"""Contacts as a robot would report them, with a part that is not where the problem places it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from planner.base.arrays import Array
from planner.register.contacts import plate_poses
from planner.register.finding import Scene
from planner.register.fitting import UNKNOWNS, Placement, slopes


def misplaced(scene: Scene, move_mm: Sequence[float] = (), turn_deg: Sequence[float] = (), shift_mm: Sequence[float] = ()
) -> Placement:  # fmt: skip
    """Where the part really is: moved and turned in its own frame, its table shifted in the world."""
    step = np.zeros(UNKNOWNS)
    step[: len(move_mm)] = np.asarray(move_mm) * 1e-3
    step[3 : 3 + len(turn_deg)] = np.radians(turn_deg)
    step[6 : 6 + len(shift_mm)] = np.asarray(shift_mm) * 1e-3
    return scene.start.moved(step, np.zeros(3))


def tips_of(scene: Scene, truth: Placement, points: Array, off: Array, q: Array) -> Array:
    """Tips (n, 3) in the world [m] on places (n, 3) of the part, `off` (n) [m] above, the holder at q (n, k) [rad]."""
    T = plate_poses(scene.cell, q) @ truth.T_plate_part
    points = points + off[:, None] * slopes(scene.surface, points)
    return np.einsum("nij,nj->ni", T[:, :3, :3], points) + T[:, :3, 3] + truth.shift


def from_one_side(
    scene: Scene, truth: Placement, noise: float, aim: float, random: np.random.Generator, wrong: Array | None = None
) -> dict[str, Array]:
    """Columns of nine contacts with a cylinder on a turntable, as Pollard et al. take them: at nine angles of the table the
    nozzle comes along x of the world, `aim` [m] beside the cylinder's axis, and stops within `noise` [m] of the wall
    (standard deviations). wrong (9) is added to where it stops [m]."""
    part = scene.problem.part
    if part is None or part.cylinder is None:
        raise ValueError("the problem has no cylinder")
    a = np.radians(np.linspace(-160.0, 160.0, 9))[:, None]
    T = plate_poses(scene.cell, a) @ truth.T_plate_part
    middle = np.array([*part.cylinder.centre, 0.5 * part.cylinder.height])
    beside = random.normal(0.0, aim, len(a))
    before = np.sqrt(part.cylinder.radius**2 - beside**2) + random.normal(0.0, noise, len(a))
    before += 0.0 if wrong is None else wrong
    tips = T[:, :3, :3] @ middle + T[:, :3, 3] + truth.shift + np.column_stack([-before, beside, 0.0 * beside])
    return cartesian(scene, tips, a) | {"ax": np.ones(len(a)), "ay": np.zeros(len(a)), "az": np.zeros(len(a))}


def write_contacts(path: Path, columns: dict[str, Array], rows: Sequence[str] = ()) -> Path:
    """A CSV file of columns by their headers; `rows` are added as they are."""
    table = np.column_stack(list(columns.values()))
    lines = [",".join(columns), *(",".join(f"{v:.9g}" for v in row) for row in table), *rows]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def cartesian(scene: Scene, tips: Array, q: Array) -> dict[str, Array]:
    """Columns of tips (n, 3) [m] and the holder's axes (n, k) [rad]."""
    names = scene.cell.joint_names[len(scene.cell.arm) :]
    columns = {f"{axis}_mm": tips[:, k] * 1e3 for k, axis in enumerate("xyz")}
    return columns | {name: np.degrees(q[:, k]) for k, name in enumerate(names)}
