"""Noisy scans of the bowl of fibre_bowl, and how close the planned path comes to the true bowl.

python -m benchmarks.scanned_bed [--folder DIR]

Points lie on an upright ellipsoid, off it by uniform noise of up to 0.3 mm along its normals. The problem is fibre_bowl
with `part.scan` in place of the ellipsoid; its curves' heights and normals are compared with the ellipsoid's. With
--folder the scans and problems are kept there, to be solved.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import trimesh
from rich.console import Console
from rich.table import Table
from scipy.spatial import Delaunay

from planner.base.arrays import Array
from planner.problem import find_problem, load_problem
from planner.toolpath.build import build_toolpath

NOISE = 0.3  # mm, the largest
BOWL = np.array([95.0, 95.0, 60.0])  # mm
EXACT = "ellipsoid: {radii_mm: [95, 95, 60]}"
CASES = ((2.0, NOISE, "xyz"), (1.0, NOISE, "xyz"), (1.0, NOISE, "stl"), (0.5, NOISE, "ply"), (1.0, 0.0, "xyz"))
COVERED = 0.92  # of the radii, as far as the scans reach


def dome(radii: Array, apart: float = 1.0, noise: float = NOISE, seed: int = 1) -> Array:
    """Points (n, 3) [mm] about `apart` [mm] from each other on an ellipsoid, off it by up to `noise` [mm]."""
    rng = np.random.default_rng(seed)
    axes = [np.arange(-COVERED * r, COVERED * r, apart) for r in radii[:2]]
    plane = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2)
    plane += rng.uniform(-0.3, 0.3, plane.shape) * apart
    share = ((plane / radii[:2]) ** 2).sum(axis=1)
    plane, share = plane[share < COVERED**2], share[share < COVERED**2]
    points = np.column_stack([plane, radii[2] * np.sqrt(1.0 - share)])
    return np.asarray(points + rng.uniform(-noise, noise, (len(points), 1)) * outward(radii, points))


def outward(radii: Array, points: Array) -> Array:
    """Unit normals (n, 3) of the ellipsoid through points (n, 3), or through those of a like one."""
    normals = points / radii**2
    return np.asarray(normals / np.linalg.norm(normals, axis=1)[:, None])


def above(radii: Array, points: Array) -> Array:
    """How far points (n, 3) lie above the ellipsoid (n), near to it, in their unit."""
    value = np.linalg.norm(points / radii, axis=1)
    return np.asarray((value - 1.0) * value / np.linalg.norm(points / radii**2, axis=1))


def save(path: Path, points: Array) -> None:
    """A scan in the way that its ending says; STL and OFF with facets between the points (n, 3), facing upwards."""
    if path.suffix in (".stl", ".off"):
        facets = Delaunay(points[:, :2]).simplices
        a, b, c = (points[facets[:, k]] for k in range(3))
        down = np.cross(b - a, c - a)[:, 2] < 0.0
        facets[down] = facets[down][:, ::-1]
        trimesh.Trimesh(points, facets, process=False).export(path)
    elif path.suffix == ".ply":
        trimesh.PointCloud(points).export(path)
    elif path.suffix == ".npy":
        np.save(path, points)
    else:
        np.savetxt(path, points, fmt="%.5f")


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the table; returns the exit code."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.scanned_bed")
    parser.add_argument("--folder", type=Path)
    options = parser.parse_args(arguments)
    table = Table(
        "scan", "points", "noise, mm", "largest residual", "rms residual", "height off, mm", "normals off, deg", "s"
    )
    with tempfile.TemporaryDirectory() as drawn:
        folder = options.folder or Path(drawn)
        folder.mkdir(parents=True, exist_ok=True)
        for apart, noise, ending in CASES:
            table.add_row(*_row(folder, apart, noise, ending))
    Console().print(table)
    return 0


def _row(folder: Path, apart: float, noise: float, ending: str) -> list[str]:
    name = f"bowl_{apart:g}_{noise:g}_{ending}"
    points = dome(BOWL, apart, noise)
    save(folder / f"{name}.{ending}", points)
    text = find_problem("fibre_bowl").read_text("utf-8")
    path = folder / f"{name}.yaml"
    changed = text.replace(EXACT, f"scan: {{file: {name}.{ending}}}").replace("name: fibre_bowl", "name: scanned_bowl")
    path.write_text(changed, "utf-8")
    problem, since = load_problem(path), time.monotonic()
    toolpath = build_toolpath(problem)
    took = time.monotonic() - since
    normals = np.vstack([bead.normals for bead in toolpath.beads])
    rise = problem.layers.height  # type: ignore[union-attr]
    places = 1e3 * (np.vstack([bead.points for bead in toolpath.beads]) - rise * normals)
    turned = np.arccos(np.clip((outward(BOWL, places) * normals).sum(axis=1), -1.0, 1.0))
    (note,) = [note for note in toolpath.notes if note.startswith("part.scan: ")]
    most, rms = (note.split(" mm ")[k].split()[-1] for k in (0, 1))
    height, turn = float(np.abs(above(BOWL, places)).max()), float(np.degrees(turned).max())
    return [
        f"{ending}, {apart:g} mm",
        str(len(points)),
        f"{noise:g}",
        most,
        rms,
        f"{height:.3f}",
        f"{turn:.2f}",
        f"{took:.0f}",
    ]


if __name__ == "__main__":
    raise SystemExit(main())
