"""Bodies that are known exactly: their points, normals and distances, and layers on them."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import minimize
from scipy.spatial import cKDTree

from planner.base.arrays import Array
from planner.base.errors import InputError
from planner.planning.solve_command import main
from planner.problem import load_problem
from planner.toolpath.build import build_toolpath
from planner.toolpath.substrate.bodies import Ball, Corrugation, Ellipsoid, Plane, SubstrateBody

SIZE = np.array([0.2, 0.15])
BODIES: dict[str, SubstrateBody] = {
    "level": Plane(np.array([0.01, 0.0, 0.02]), np.zeros(2), SIZE),
    "inclined": Plane(np.array([0.01, 0.0, 0.02]), np.array([0.3, -0.5]), SIZE),
    "corrugation": Corrugation(np.array([0.01, 0.02, -0.005]), 0.006, 2.0 * np.pi / 0.06, np.array([0.6, 0.8]), SIZE),
    "ellipsoid": Ellipsoid(np.array([0.01, -0.02, 0.005]), np.array([0.095, 0.08, 0.06])),
    "flat ellipsoid": Ellipsoid(np.zeros(3), np.array([0.095, 0.095, 0.02])),
}
PARTS = {
    "inclined": "{plane: {size_mm: [220, 220], slope_deg: 25, rises_deg: 30}}",
    "corrugation": "{corrugation: {amplitude_mm: 5, wavelength_mm: 70, size_mm: [220, 220], direction_deg: 20}}",
    "ellipsoid": "{ellipsoid: {radii_mm: [120, 95, 60]}}",
}


def plane_points(seed: int, n: int, half: float = 0.045) -> Array:
    return np.random.default_rng(seed).uniform(-half, half, (n, 2))


@pytest.mark.parametrize("name", BODIES)
def test_points_lie_on_the_body_and_normals_stand_on_it(name: str) -> None:
    body, at, step = BODIES[name], plane_points(1, 200), 1e-5
    points, normals = body.at(at)
    np.testing.assert_allclose(points[:, :2], at, atol=1e-15)
    np.testing.assert_allclose(body.signed_distance(points), 0.0, atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1.0, atol=1e-12)
    assert normals[:, 2].min() > 0.0
    for aside in np.eye(2) * step:
        slope = body.at(at + aside)[0] - body.at(at - aside)[0]
        assert np.abs((slope * normals).sum(axis=1)).max() <= 1e-5 * 2.0 * step  # to second order
    np.testing.assert_allclose(body.upward(at), normals[:, 2], atol=1e-15)


@pytest.mark.parametrize("name", BODIES)
@settings(max_examples=20, deadline=None)
@given(st.integers(0, 10_000), st.floats(-0.008, 0.05))
def test_along_its_normal_a_point_is_as_far_from_the_body_as_it_went(name: str, seed: int, height: float) -> None:
    """Inwards no farther than the tightest bend, 8 mm at the flat ellipsoid's rim and 11 mm above a trough's middle."""
    body = BODIES[name]
    if name == "corrugation":
        height = min(height, 0.01)
    if name == "flat ellipsoid":
        height = max(height, -0.003)
    points, normals = body.at(plane_points(seed, 50))
    moved = points + height * normals
    np.testing.assert_allclose(body.signed_distance(moved), height, atol=1e-10)
    np.testing.assert_allclose(body.normals(moved), normals, atol=1e-7)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["corrugation", "ellipsoid", "flat ellipsoid"])
def test_the_distance_is_the_least_there_is(name: str) -> None:
    """Against a general minimiser, from several places, for points above, beside and far away."""
    body = BODIES[name]
    points = np.random.default_rng(4).uniform([-0.08, -0.07, 0.03], [0.08, 0.07, 0.2], (20, 3))
    found = body.signed_distance(points)

    def far(plane: Array, p: Array) -> float:
        return float(np.linalg.norm(np.nan_to_num(body.at(plane[None])[0][0], nan=9.0) - p))

    for p, d in zip(points, found, strict=True):
        starts = [0.5 * p[:2], *(0.5 * p[:2] + plane_points(2, 8, 0.03))]
        best = min(minimize(far, x, args=(p,), method="Nelder-Mead", options={"xatol": 1e-9}).fun for x in starts)
        assert d <= best + 1e-9
        assert d == pytest.approx(best, abs=1e-6)


def test_an_ellipsoid_with_three_equal_radii_is_a_ball() -> None:
    centre = np.array([0.01, 0.02, 0.03])
    ball, same = Ball(0.05, centre), Ellipsoid(centre, np.full(3, 0.05))
    points = centre + np.random.default_rng(3).normal(size=(200, 3)) * 0.05
    points = np.vstack([points, centre + [[0.0, 0.0, 0.08], [0.0, 0.06, 0.0], [0.0, 0.0, 0.01], [0.02, 0.0, 0.0]]])
    np.testing.assert_allclose(same.signed_distance(points), ball.signed_distance(points), atol=1e-9)
    np.testing.assert_allclose(same.normals(points), ball.normals(points), atol=1e-6)


@pytest.mark.parametrize("name", BODIES)
def test_beneath_a_body_distances_are_negative_and_beside_it_nothing_is_there(name: str) -> None:
    body = BODIES[name]
    points = body.at(plane_points(5, 50))[0]
    assert body.signed_distance(points - [0.0, 0.0, 0.002]).max() < 0.0
    assert np.isnan(body.upward(np.array([[0.5, 0.0], [0.0, -0.5]]))).all()


@pytest.mark.parametrize("name", BODIES)
def test_a_body_has_a_shape_whose_triangles_lie_near_it_and_face_outwards(name: str) -> None:
    body = BODIES[name]
    shape = body.shape()
    assert shape is not None
    np.testing.assert_allclose(body.signed_distance(shape.vertices), 0.0, atol=1e-9)
    corners = shape.vertices[shape.triangles]
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    there = np.linalg.norm(across, axis=1) > 1e-12
    assert ((across * shape.normals[shape.triangles[:, 0]]).sum(axis=1)[there] > 0.0).all()


# Layers


@cache
def cloud(part: str) -> tuple[cKDTree, Array]:
    """The body's surface as points 0.2 mm apart, by its own formula; and unit normals by differences of it."""
    x, y = (a.ravel() for a in np.meshgrid(*[np.arange(-0.06, 0.06, 2e-4)] * 2, indexing="ij"))

    def height(x: Array, y: Array) -> Array:
        if part == "inclined":
            return np.tan(np.radians(25)) * (np.cos(np.radians(30)) * x + np.sin(np.radians(30)) * y)
        if part == "corrugation":
            along = np.cos(np.radians(20)) * x + np.sin(np.radians(20)) * y
            return 0.005 * np.cos(2.0 * np.pi * along / 0.07)
        return 0.06 * np.sqrt(1.0 - (x / 0.12) ** 2 - (y / 0.095) ** 2)

    e = 1e-6
    normals = np.column_stack(
        [
            -(height(x + e, y) - height(x - e, y)) / (2 * e),
            -(height(x, y + e) - height(x, y - e)) / (2 * e),
            np.ones(len(x)),
        ]
    )
    points = np.column_stack([x, y, height(x, y)])
    return cKDTree(points), normals / np.linalg.norm(normals, axis=1)[:, None]


@pytest.mark.slow(keep=2)
@pytest.mark.parametrize("part", PARTS)
def test_layers_are_spaced_along_the_true_normal(part: str) -> None:
    """Spacing within 2 % and normals within 0.1 degrees, against the formula of the surface."""
    curves = "[{degree: 2, points_mm: [[-45, -20], [-20, 45], [20, -45], [45, 20]]}]"
    changes = (f"part={PARTS[part]}", f"layers.source.curves={curves}", "layers.count=4", "layers.height_mm=0.4")
    toolpath = build_toolpath(load_problem("fibre_plane", (*changes, "process.bead={width_mm: 1.2, height_mm: 0.4}")))
    tree, normals = cloud(part)
    for bead in toolpath.beads:
        nearest = tree.query(bead.points)[1]
        # the nearest point of the cloud is beside the foot: what is left after its normal is not height
        height = ((bead.points - tree.data[nearest]) * normals[nearest]).sum(axis=1)
        assert height == pytest.approx((bead.layer + 1) * 0.4e-3, rel=0.02)
        lean = np.degrees(np.arccos(np.clip((bead.normals * normals[nearest]).sum(axis=1), -1.0, 1.0)))
        assert np.quantile(lean, 0.5) <= 0.2  # what 0.1 mm beside the foot turns on a bend of 30 mm
        exact = toolpath.surface.normals_on(0, bead.s, bead.points)
        assert np.degrees(np.arccos(np.clip((exact * bead.normals).sum(axis=1), -1.0, 1.0))).max() <= 1e-5


@pytest.mark.slow
def test_a_bowl_from_a_file_of_facets_is_nearly_the_exact_one(tmp_path: Path) -> None:
    """As scanned: facets of 2 mm; the same curves lie within 0.05 mm of the true bowl, normals within 0.1 degrees."""
    mesh = trimesh.creation.icosphere(subdivisions=6, radius=1.0)
    mesh.apply_scale([95.0, 95.0, 60.0])
    (tmp_path / "bowl.stl").write_bytes(mesh.export(file_type="stl"))
    exact = build_toolpath(load_problem("fibre_bowl"))
    scanned = build_toolpath(load_problem("fibre_bowl", (f"part={{mesh: {{file: '{tmp_path / 'bowl.stl'}'}}}}",)))
    bowl = exact.surface
    for bead in scanned.beads:
        assert np.abs(bowl.signed_distance(bead.points) - 0.3e-3).max() <= 0.05e-3
        lean = np.degrees(np.arccos(np.clip((bowl.normals(bead.points) * bead.normals).sum(axis=1), -1.0, 1.0)))
        assert lean.max() <= 0.1


@pytest.mark.slow(cases=("{ellipsoid*95, 60*",))
@pytest.mark.parametrize(
    ("part", "words"),
    [
        ("{ellipsoid: {radii_mm: [70, 95, 60]}}", "leaves the part"),
        ("{ellipsoid: {radii_mm: [95, 0, 60]}}", "too small"),
        ("{ellipsoid: {radius_mm: 95}}", "did you mean radii_mm"),
        ("{plane: {size_mm: [120, 220]}}", "leaves the part at x -70.0"),
        ("{plane: {size_mm: [220, 220], slope_deg: 80}}", "too large"),
        ("{plane: {}}", "size_mm: is missing"),
        ("{corrugation: {amplitude_mm: 30, wavelength_mm: 40, size_mm: [220, 220]}}", "wall"),
        ("{corrugation: {amplitude_mm: 5, wavelength_mm: 0, size_mm: [220, 220]}}", "too small"),
        ("{plane: {size_mm: [220, 220]}, sphere: {radius_mm: 50}}", "both sphere and plane"),
        ("{cylinder: {radius_mm: 34, height_mm: 100}}", "do not go together"),
    ],
)
def test_bad_bodies_are_refused(part: str, words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "out"
    assert main(["fibre_plane", "--set", f"part={part}", "--out", str(out)]) == 2
    said = " ".join(capsys.readouterr().err.split())
    assert words in said
    assert "Traceback" not in said
    assert not out.exists()


def test_layers_that_would_fold_in_a_trough_are_refused() -> None:
    steep = "part={corrugation: {amplitude_mm: 3, wavelength_mm: 20, size_mm: [220, 220]}}"  # bent to 3.4 mm
    curves = "layers.source.curves=[{degree: 2, points_mm: [[-45, -20], [0, 20], [45, -20]]}]"
    with pytest.raises(InputError, match="fold"):
        build_toolpath(load_problem("fibre_plane", (steep, curves, "layers.count=12")))
