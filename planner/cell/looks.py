"""How a robot's links look: the visual meshes of its URDF, or shells of their collision shapes.

Nothing is planned or checked with these. So a missing or unreadable mesh is no reason to refuse a robot: its link is
drawn from its collision shapes instead.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from planner.base.arrays import Array, Ints
from planner.cell.bodies import read_mesh
from planner.cell.collada import read_collada
from planner.cell.shells import castable, casting, covers
from planner.cell.solids import Body, Look
from planner.cell.surfaces import TriangleSurface, creased, decimated, joined, rgb, solid_surface
from planner.cell.urdf import FARTHEST

PLAIN, TRIM = "#d9dde2", "#6a727b"  # for bodies without a colour of their own, and for covers on joints
STEPS = 46  # grid cells along the longest side of a mesh that is decimated
LEAST_STEP = 2.5e-3  # m: the smallest cell
LARGEST_CAST = 1.7  # m: anything larger is built of beams, not cast


def link_surface(bodies: Sequence[Body], looks: Sequence[Look], axes: Array | None) -> TriangleSurface:
    """The surface of a link as drawn, in the frame that carries it.

    bodies, looks  of the link; without looks, or if one cannot be read, its bodies are drawn
    axes (k, 6)    see `planner.cell.shells.casting`; None for a link that is built of beams, not cast
    """
    if looks:
        try:
            return joined([_mesh_surface(look) for look in looks])
        except ValueError:
            pass  # draw the collision shapes instead
    plain = bodies_surface(bodies)
    if axes is None or not castable(bodies) or np.ptp(plain.vertices, axis=0).max() > LARGEST_CAST:
        return plain
    shell = casting([replace(body, colour=body.colour or PLAIN) for body in bodies], axes)
    caps = covers(bodies, axes, bodies[0].trim or TRIM)
    return joined([shell, bodies_surface(caps)]) if caps else shell


def bodies_surface(bodies: Sequence[Body], colour: str = PLAIN) -> TriangleSurface:
    """Bodies as they are, in the frame that carries them, in their own colours or in one."""
    return joined([solid_surface(body.solid, body.colour or colour).moved(body.T_frame_solid) for body in bodies])


def _mesh_surface(look: Look) -> TriangleSurface:
    try:
        changed = look.file.stat().st_mtime_ns
    except OSError as error:
        raise ValueError(f"{look.file.name} cannot be read") from error
    vertices, triangles, colours = _mesh(look.file, changed)
    if look.colour:
        colours = np.tile(rgb(look.colour), (len(triangles), 1))
    vertices = vertices * np.array(look.scale)
    size = float(np.ptp(vertices, axis=0).max(initial=0.0))
    if not 0.0 < size <= FARTHEST or not np.isfinite(vertices).all():
        raise ValueError(f"{look.file.name} has no size that can be drawn")
    if np.prod(look.scale) < 0.0:
        triangles = triangles[:, ::-1]
    vertices, triangles, kept = decimated(vertices, triangles, max(size / STEPS, LEAST_STEP))
    return creased(vertices, triangles, colours[kept]).moved(look.T_frame_solid)


@cache
def _mesh(path: Path, changed: int) -> tuple[Array, Ints, NDArray[np.uint8]]:
    """Vertices [units of the file], triangles and their colours; cached by the time of the file's last change [ns].

    Raises ValueError for a file that cannot be read.
    """
    if path.suffix.lower() == ".dae":
        try:
            return read_collada(path)
        except ValueError:
            pass  # the loader may understand what this reader does not
    mesh = read_mesh(path)
    return mesh.vertices, mesh.triangles, np.tile(rgb(PLAIN), (len(mesh.triangles), 1))
