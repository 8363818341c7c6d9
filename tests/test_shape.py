"""Bodies as triangles: closed where they should be, on the surface, facing outwards."""

from __future__ import annotations

import io

import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray

from planner.export.tables import part_stl
from planner.toolpath.bead import MOST_TRIANGLES, Shape, cylinder_shape, dome_shape, facets_shape, skin_shape
from planner.toolpath.substrate.bodies import Ball

CENTRE = np.array([0.02, -0.01, -0.015])


def facing(shape: Shape) -> NDArray[np.float64]:
    """How far each triangle's own normal agrees with those of its corners."""
    a, b, c = (shape.vertices[shape.triangles[:, k]] for k in range(3))
    across = np.cross(b - a, c - a)
    own = across / np.linalg.norm(across, axis=1)[:, None]
    return np.asarray((own * shape.normals[shape.triangles[:, 0]]).sum(axis=1))


@pytest.mark.parametrize(
    "shape",
    [
        cylinder_shape(0.034, 0.1, np.array([0.03, 0.04])),
        dome_shape(0.05, CENTRE),
        skin_shape(Ball(0.05, CENTRE).at, np.array([-0.04, -0.05]), np.array([0.06, 0.03])),
    ],
    ids=["cylinder", "dome", "skin"],
)
def test_triangles_face_outwards(shape: Shape) -> None:
    a, b, c = (shape.vertices[shape.triangles[:, k]] for k in range(3))
    real = np.linalg.norm(np.cross(b - a, c - a), axis=1) > 1e-15
    assert real.mean() > 0.9
    assert facing(Shape(shape.vertices, shape.normals, shape.triangles[real])).min() > 0.7


def test_a_dome_ends_on_the_bed_and_a_skin_where_the_surface_does() -> None:
    dome = dome_shape(0.05, CENTRE)
    assert np.linalg.norm(dome.vertices - CENTRE, axis=1) == pytest.approx(np.full(len(dome.vertices), 0.05))
    assert dome.vertices[:, 2].min() == pytest.approx(0.0, abs=1e-12)
    skin = skin_shape(Ball(0.05, CENTRE).at, np.array([-0.1, -0.1]), np.array([0.1, 0.1]))
    assert np.isfinite(skin.vertices).all() and skin.triangles.max() < len(skin.vertices)
    flat = skin.vertices[skin.triangles][:, :, :2]
    a, b = flat[:, 1] - flat[:, 0], flat[:, 2] - flat[:, 0]
    area = 0.5 * (a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]).sum()
    assert 0.8 * np.pi * 0.05**2 < area < np.pi * 0.05**2


def test_too_many_facets_are_not_drawn() -> None:
    one = np.array([[[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]])
    assert facets_shape(np.repeat(one, MOST_TRIANGLES + 1, axis=0)) is None
    few = facets_shape(one)
    assert few is not None and np.allclose(few.normals, [0.0, 0.0, 1.0])


def test_the_file_holds_the_shape_in_millimetres() -> None:
    shape = cylinder_shape(0.034, 0.1, np.array([0.03, 0.04]))
    mesh = trimesh.load(io.BytesIO(part_stl(shape)), file_type="stl")
    assert len(mesh.faces) == len(shape.triangles)
    assert np.allclose(mesh.bounds, [[-4.0, 6.0, 0.0], [64.0, 74.0, 100.0]], atol=0.1)
