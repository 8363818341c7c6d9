"""Bodies of the print head and of fixtures, as the problem gives them; a head of its own where it gives none."""

from __future__ import annotations

import itertools
from functools import partial

import numpy as np
from scipy.spatial.transform import Rotation

from planner.errors import Complaint
from planner.facets import read_corners
from planner.problem import Problem
from planner.problem.cell import NozzleSpec
from planner.problem.solids import SolidSpec
from planner.readonly import Array
from planner.solids import Body, Box, Capsule, Frustum, Hull, Mesh, Solid

# Of a nozzle whose outline is not given: long and slender, as they are sold for printing beside walls.
_CONE = np.radians(30.0)  # half angle above the face, whose radius is the bore's diameter
_THICKNESS = 4e-3  # m by which the nozzle is thicker than its face
_LENGTH = 40e-3  # m
_TUBE = 15e-3  # m, radius of what holds it, from its upper end to the middle of the flange
_FLAT = 1e-6  # m: a mesh that is thinner has no hull


def nozzle_profile(spec: NozzleSpec) -> tuple[tuple[float, float], ...]:
    """Pairs of height above the tip and radius [m], from the tip up: as given, or assumed from the bore."""
    if spec.profile is not None:
        return spec.profile
    face, thick = spec.diameter, spec.diameter + _THICKNESS
    return (0.0, face), (_THICKNESS / float(np.tan(_CONE)), thick), (_LENGTH, thick)


def head_bodies(problem: Problem, T_flange_nozzle: Array) -> tuple[Body, ...]:
    """Nozzle and print head in the nozzle frame, whose z points into the part.

    Raises InputError for a mesh that cannot be read.
    """
    spec = problem.cell.nozzle
    profile = nozzle_profile(spec)
    upwards = np.diag([1.0, -1.0, -1.0, 1.0])
    bodies = []
    for (low, bottom), (high, top) in itertools.pairwise(profile):
        if high > low:
            T = upwards.copy()
            T[2, 3] = -low
            bodies.append(Body("nozzle", Frustum(bottom, top, high - low), T))
    T_nozzle_flange = np.asarray(np.linalg.inv(T_flange_nozzle), dtype=float)
    if spec.head is None:
        bodies += _tube(np.array([0.0, 0.0, -profile[-1][0]]), T_nozzle_flange[:3, 3])
    for name, own in (spec.head or {}).items():
        where = partial(problem.error, f"cell.nozzle.head.{name}")
        body = _body(f"head {name}", own, where)
        solid = _hull(body.solid, where) if isinstance(body.solid, Mesh) else body.solid
        bodies.append(Body(body.name, solid, T_nozzle_flange @ body.T_frame_solid))
    return tuple(bodies)


def _tube(low: Array, flange: Array) -> list[Body]:
    """What is assumed to hold the nozzle: a tube from its upper end to the middle of the flange, if there is room."""
    way = flange - low
    length = float(np.linalg.norm(way))
    if length <= 2.0 * _TUBE:
        return []
    way = way / length
    # its round ends lie within the nozzle's upper end and the flange
    aside = np.cross(way, np.eye(3)[int(np.argmin(np.abs(way)))])
    aside /= np.linalg.norm(aside)
    T = np.eye(4)
    T[:3, :3] = np.column_stack([aside, np.cross(way, aside), way])
    T[:3, 3] = low + 0.5 * (_TUBE + length) * way
    return [Body("print head", Capsule(_TUBE, length - _TUBE), T)]


def fixture_bodies(problem: Problem, carrier: str) -> tuple[Body, ...]:
    """Fixtures that `carrier` carries, "world" or "part", in its frame. Raises InputError for a mesh that cannot be read."""
    return tuple(
        _body(name, spec, partial(problem.error, f"cell.fixtures.{name}"))
        for name, spec in problem.cell.fixtures.items()
        if spec.on == carrier
    )


def _body(name: str, spec: SolidSpec, where: Complaint) -> Body:
    T = np.eye(4)
    T[:3, :3] = Rotation.from_euler("xyz", spec.rpy).as_matrix()
    T[:3, 3] = spec.centre
    if spec.mesh is not None:
        corners = read_corners(spec.mesh, where)
        return Body(name, Mesh(corners.reshape(-1, 3), np.arange(3 * len(corners)).reshape(-1, 3)), T)
    solid: Solid
    if spec.cylinder is not None:
        solid = Frustum(spec.cylinder.radius, spec.cylinder.radius, spec.cylinder.height)
        T[:3, 3] -= 0.5 * spec.cylinder.height * T[:3, 2]
    else:
        solid = Box(spec.box or (0.0, 0.0, 0.0))
    return Body(name, solid, T)


def _hull(mesh: Mesh, where: Complaint) -> Hull:
    if np.linalg.matrix_rank(mesh.vertices - mesh.vertices[0], tol=_FLAT) < 3:
        raise where("its facets lie in one plane", hint="a body has a volume")
    return Hull(mesh.vertices)
