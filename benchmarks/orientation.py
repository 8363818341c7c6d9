"""How far the published ways of directing the nozzle are off a substrate's normals: median and maximum, in degrees.

python -m benchmarks.orientation
python -m benchmarks.orientation --set part.sphere=null --set 'part.mesh={file: part.stl, rpy_deg: [90, 0, 0]}'
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from planner.errors import EXIT_VERIFIED, PlannerError
from planner.problem import load_problem
from planner.toolpath.bead import Bead
from planner.toolpath.build import build_toolpath
from planner.toolpath.substrate.bodies import MeshTop
from planner.toolpath.substrate.layers import Substrate

Array = NDArray[np.float64]


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


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit code."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.orientation", description=__doc__)
    parser.add_argument("problem", nargs="?", default="hemisphere_honeycomb")
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE")
    options = parser.parse_args(arguments)
    try:
        problem = load_problem(options.problem, (*options.set, "layers.count=1", "layers.offset=normal"))
        toolpath = build_toolpath(problem)
    except PlannerError as error:
        print(f"error: {error}", file=sys.stderr)
        return error.exit_code
    normals = np.vstack([bead.normals for bead in toolpath.beads])
    _tell("equation (3), axis off the normal", angles(published_axes(normals), -normals))
    surface = toolpath.surface
    if isinstance(surface, Substrate) and isinstance(surface.body, MeshTop):
        by_bead = [facet_normals(surface.body, bead, surface.height) for bead in toolpath.beads]
        _tell("facets, normal off the smooth surface's", angles(np.vstack(by_bead), normals))
        jumps = np.concatenate([angles(found[1:], found[:-1]) for found in by_bead])
        _tell("facets, jump of the normal from one to the next", jumps[jumps > 0.0])
        print(f"smooth surface off the facets: at most {surface.body.gap * 1e3:.4f} mm")
    return EXIT_VERIFIED


def _tell(what: str, degrees: Array) -> None:
    print(f"{what}: median {np.median(degrees):.3f}, maximum {degrees.max():.3f} deg")


if __name__ == "__main__":
    sys.exit(main())
