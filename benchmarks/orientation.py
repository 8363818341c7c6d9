"""How far published methods of directing the nozzle are off a substrate's normals: median and maximum, in degrees.

A mesh's facets are measured too: those of the file, or of a mesh of the sphere with facets of some 3 mm.

python -m benchmarks.orientation --speed
python -m benchmarks.orientation --set part.sphere=null --set 'part.mesh={file: part.stl, rpy_deg: [90, 0, 0]}'
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import trimesh
from scipy.spatial.transform import Rotation

from benchmarks.command import told
from planner.base.arrays import Array
from planner.base.errors import EXIT_VERIFIED
from planner.planning.pipeline import solve
from planner.problem import load_problem
from planner.toolpath.bead import Bead
from planner.toolpath.build import build_toolpath
from planner.toolpath.substrate.bodies import Ball
from planner.toolpath.substrate.mesh_top import MeshTop
from planner.toolpath.substrate.projection import Substrate

FACET = 3e-3  # m, of the mesh of a ball: as large as those of the published one
EDGE = 1.05  # times the radius, of an icosahedron


def published_axes(normals: Array) -> Array:
    """Nozzle axes (n, 3) for unit surface normals (n, 3) by equation (3) of Pollard et al.: the quaternion q_x q_y.

    q_x turns about y by asin of the x component of the normal's projection on the xz plane, and half a turn; q_y about
    x by asin of the y component of its projection on the yz plane. Exact only where n_x or n_y is zero.
    """
    x, y, z = normals.T
    about_y = np.arcsin(x / np.hypot(x, z)) + np.pi
    about_x = np.arcsin(y / np.hypot(y, z))
    turned = Rotation.from_euler("YX", np.column_stack([about_y, about_x]))  # about y, then about the turned x
    return np.asarray(turned.apply([0.0, 0.0, 1.0]))


def angles(one: Array, other: Array) -> Array:
    """Angles (n) between unit vectors (n, 3) [deg]."""
    sine = np.linalg.norm(np.cross(one, other), axis=1)
    return np.asarray(np.degrees(np.arctan2(sine, (one * other).sum(axis=1))))


def facet_normals(body: MeshTop, bead: Bead, rise: float) -> Array:
    """Normals (n, 3) of the facets above or below which a bead's samples lie, `rise` [m] along the smooth normal."""
    _, found = body.facets.top((bead.points - rise * bead.normals)[:, :2])
    return body.facets.normals[found]


@told
def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit code."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.orientation", description=__doc__)
    parser.add_argument("problem", nargs="?", default="hemisphere_honeycomb")
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE")
    parser.add_argument("--speed", action="store_true", help="also plan both, and tell how fast they are")
    options = parser.parse_args(arguments)
    changes = (*options.set, "layers.count=1", "layers.offset=normal")
    problem = load_problem(options.problem, changes)
    normals = np.vstack([bead.normals for bead in build_toolpath(problem).beads])
    _tell("equation (3), axis off the normal", angles(published_axes(normals), -normals))
    sphere = None if problem.part is None else problem.part.sphere
    if sphere is None:
        _tell_of_facets(options.problem, changes, None, options.speed)
        return EXIT_VERIFIED
    ball = Ball(sphere.radius, np.asarray(sphere.centre))
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "ball.stl"
        file.write_bytes(meshed(sphere.radius))
        origin = ", ".join(f"{x * 1e3:.9g}" for x in sphere.centre)
        mesh = ("part.sphere=null", f'part.mesh={{file: "{file}", origin_mm: [{origin}]}}')
        _tell_of_facets(options.problem, (*changes, *mesh), ball, options.speed)
    return EXIT_VERIFIED


def meshed(radius: float) -> bytes:
    """A ball about the origin as an STL file [mm], with facets of some 3 mm."""
    halvings = max(round(np.log2(EDGE * radius / FACET)), 1)
    data = trimesh.creation.icosphere(subdivisions=halvings, radius=radius * 1e3).export(file_type="stl")
    return bytes(data)


def _tell_of_facets(name: str, changes: Sequence[str], ball: Ball | None, speed: bool) -> None:
    """How far the normals of a mesh's facets, and the nozzle that follows them, are off the ball or the smooth surface."""
    plain, facing = (load_problem(name, (*changes, f"layers.normals={kind}")) for kind in ("smooth", "facets"))
    toolpath, turning = build_toolpath(plain), build_toolpath(facing)
    surface = toolpath.surface
    if not (isinstance(surface, Substrate) and isinstance(surface.body, MeshTop)):
        return
    normals = np.vstack([bead.normals for bead in toolpath.beads])
    true, what = normals, "smooth surface's"
    if ball is not None:
        true, what = ball.normals(np.vstack([bead.points for bead in toolpath.beads])), "ball's"
        _tell("smooth surface, normal off the ball's", angles(normals, true))
    by_bead = [facet_normals(surface.body, bead, surface.height) for bead in toolpath.beads]
    _tell(f"facets, normal off the {what}", angles(np.vstack(by_bead), true))
    jumps = np.concatenate([angles(found[1:], found[:-1]) for found in by_bead])
    _tell("facets, jump of the normal from one to the next", jumps[jumps > 0.0])
    blended = np.vstack([bead.normals for bead in turning.beads])
    blend = 0.0 if not isinstance(turning.surface, Substrate) else turning.surface.facings[0].blend
    off = "axis off the ball's normal" if ball is not None else "axis off the smooth surface's normal"
    _tell(f"facets, turning over {blend * 1e3:g} mm, {off}", angles(blended, true))
    print(f"smooth surface off the facets: at most {surface.body.gap * 1e3:.4f} mm")
    if speed:
        for kind, problem in (("smooth", plain), ("facets", facing)):
            metrics = solve(problem, "ladder").metrics
            share, least = metrics["at_speed_fraction"], metrics["speed_min_mm_s"]
            longer = metrics["deposition_time_s"] / metrics["ideal_deposition_time_s"]
            print(f"{kind}: {share:.1%} at speed, lowest {least:.1f} mm/s, {longer:.2f} times the time")


def _tell(what: str, degrees: Array) -> None:
    print(f"{what}: median {np.median(degrees):.3f}, maximum {degrees.max():.3f} deg")


if __name__ == "__main__":
    sys.exit(main())
