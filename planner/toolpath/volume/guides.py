"""The two surfaces that layers change between: levels, meshes, or a body's own top."""

from __future__ import annotations

from functools import partial

import numpy as np

from planner.errors import Complaint
from planner.facets import read_facets
from planner.problem import Problem
from planner.problem.volume import GuideSpec, VolumeLayersSpec
from planner.readonly import Array
from planner.toolpath.substrate.bodies import MeshTop, TooRough, reach_beside
from planner.toolpath.substrate.facet_tree import FacetTree
from planner.toolpath.volume.morph import Heights, Morph
from planner.toolpath.volume.solid import Solid

_GRID = 120  # places along the body's longer side at which its surfaces are looked at
_REACH = 2.0  # bead widths beside the body within which its surfaces count


def stack_of(problem: Problem, spec: VolumeLayersSpec, solid: Solid, tree: FacetTree) -> tuple[Morph, MeshTop | None]:
    """The stack of layers between a body's surfaces, and the mesh that it begins at if it does; the body's facets.

    Raises InputError for surfaces that are not one above the other, or have edges.
    """
    low, high = solid.vertices[:, :2].min(axis=0), solid.vertices[:, :2].max(axis=0)
    axes = [np.linspace(a, b, _GRID) for a, b in zip(low, high, strict=True)]
    plane = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2)
    plane = plane[tree.top(plane)[1] >= 0]
    reach = _REACH * problem.process.bead.width
    lowest = GuideSpec.model_construct(z=float(solid.vertices[:, 2].min()), mesh=None)
    lower, base = _heights(problem, spec.lower or lowest, "layers.lower", plane, reach)
    if spec.upper is None:
        top = _smooth(tree, plane, reach, spec.source.mesh.name, partial(problem.error, "layers.source.mesh"))
        upper = _over(top)
    else:
        upper, _ = _heights(problem, spec.upper, "layers.upper", plane, reach)
    room = float((upper(plane) - lower(plane)).max())
    if room <= 0.0:
        field = "layers.upper" if spec.upper is not None else "layers.lower"
        reason = f"the upper surface is nowhere above the lower one: {room * 1e3:.3f} mm at most"
        raise problem.error(field, reason, "the upper surface must lie above the lower one, within the body's outline")
    return Morph.between(lower, upper, spec.height, spec.thinnest, room, low - reach, high + reach), base


def _heights(
    problem: Problem, guide: GuideSpec, field: str, plane: Array, reach: float
) -> tuple[Heights, MeshTop | None]:
    """The heights of a surface that is given, over all of plane (n, 2), and its mesh if it is one."""
    if guide.mesh is None:
        z = guide.z or 0.0
        return (lambda places: np.full(len(places), z)), None
    complain = partial(problem.error, f"{field}.mesh.file")
    facets = FacetTree.of(read_facets(guide.mesh, complain))
    found = facets.top(plane)[1] >= 0
    if not found.all():
        x, y = plane[int(np.argmin(found))] * 1e3
        raise complain(
            f"{guide.mesh.file.name} does not reach over the whole body: nothing at x {x:.1f}, y {y:.1f} mm",
            f"a larger surface, or move it by {field}.mesh.origin_mm",
        )
    top = _smooth(facets, plane, reach, guide.mesh.file.name, complain)
    return _over(top), top


def _over(top: MeshTop) -> Heights:
    return lambda places: top.surface.at(places)[0][:, 2]


def _smooth(facets: FacetTree, plane: Array, reach: float, name: str, complain: Complaint) -> MeshTop:
    try:
        return MeshTop.near(facets, plane, reach_beside(facets, plane, reach))
    except TooRough as error:
        x, y = error.place * 1e3
        raise complain(
            f"the smooth surface through the top of {name} is {error.gap * 1e3:.3f} mm off it at x {x:.1f}, y {y:.1f} mm",
            "there is an edge or a wall, or facets are too large: give layers.upper a smooth surface above the body's top",
        ) from None
