"""The smooth surface on a mesh: coarse facets, noise, edges, and how far it may leave them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from solved import solve_alone

from planner.base.arrays import Array
from planner.base.errors import InputError
from planner.problem import load_problem
from planner.toolpath.build import build_toolpath
from planner.toolpath.substrate.curved_facets import bent, bulges, corner_normals
from planner.toolpath.substrate.mesh_surface import FacetTree
from planner.toolpath.substrate.mesh_top import (
    FARTHEST_FROM_FACETS,
    MOST_UNASKED,
    MeshTop,
    TooRoughMesh,
    reach_beside,
)

COARSE = ("layers.count=1", "resolve.rung_mm=8", "resolve.roll_step_deg=20")
PATTERN = "layers.source={pattern: concentric, cell_mm: 6, size_mm: [36, 36], outline: ellipse}"


def ball(radius: float, subdivisions: int, noise: float = 0.0, seed: int = 0) -> Array:
    """Facets of a ball whose corners are up to `noise` off it."""
    mesh = trimesh.creation.icosphere(subdivisions=subdivisions, radius=radius)
    off = np.random.default_rng(seed).uniform(-noise, noise, len(mesh.vertices))
    mesh.vertices = mesh.vertices * (1.0 + off / radius)[:, None]
    return np.asarray(mesh.triangles)


def lying_cylinder(radius: float, length: float, sides: int) -> Array:
    mesh = trimesh.creation.cylinder(radius=radius, height=length, sections=sides)
    mesh.apply_transform(trimesh.transformations.rotation_matrix(np.pi / 2, [0, 1, 0]))
    return np.asarray(mesh.triangles)


def sheet(heights: Array, step: float) -> Array:
    """Facets of a square sheet of heights (n, n)."""
    x = step * (np.arange(len(heights)) - 0.5 * (len(heights) - 1))
    p = np.dstack([*np.meshgrid(x, x, indexing="ij"), heights])
    a, b, c, d = p[:-1, :-1], p[1:, :-1], p[1:, 1:], p[:-1, 1:]
    return np.concatenate([np.stack(each, axis=-2).reshape(-1, 3, 3) for each in ((a, b, c), (a, c, d))])


def lines(half: float, across: int = 5, n: int = 600) -> Array:
    x = np.linspace(-half, half, n)
    return np.vstack([np.column_stack([x, 0.1 * x + y]) for y in np.linspace(-0.6, 0.6, across) * half])


def top_of(corners: Array, plane: Array, bound: float | None = None) -> MeshTop:
    facets = FacetTree.of(corners)
    return MeshTop.near(facets, plane, reach_beside(facets, plane, 1.2e-3), bound=bound)


def off_facets(body: MeshTop, plane: Array) -> float:
    return float(body.facets.distance(body.at(plane)[0]).max())


# Facets that are bent


def test_normals_at_corners_stop_at_edges() -> None:
    box = np.asarray(trimesh.creation.box([0.02, 0.03, 0.04]).triangles)
    normals, smooth = corner_normals(box)
    flat = np.cross(box[:, 1] - box[:, 0], box[:, 2] - box[:, 0])
    np.testing.assert_allclose(
        normals, np.repeat((flat / np.linalg.norm(flat, axis=1)[:, None])[:, None], 3, 1), atol=1e-12
    )
    assert smooth.sum() == 12  # the diagonals of six sides, from either facet
    assert len(bent(box, normals)) == len(box)
    round_ = lying_cylinder(0.04, 0.12, 24)
    normals, _ = corner_normals(round_)
    middle, corner = round_.mean(axis=1), round_[:, 0]
    side = np.abs(middle[:, 0]) < 0.0599
    away = corner[side] * [0, 1, 1] / 0.04
    np.testing.assert_allclose(normals[side, 0], away, atol=1e-9)
    np.testing.assert_allclose(np.abs(normals[~side, :, 0]), 1.0, atol=1e-12)


@pytest.mark.parametrize(("subdivisions", "most"), [(3, 0.013e-3), (2, 0.08e-3)])
def test_bent_facets_are_near_the_ball_that_corners_stand_on(subdivisions: int, most: float) -> None:
    facets = ball(0.05, subdivisions)
    normals, smooth = corner_normals(facets)
    assert smooth.all()
    small = bent(facets, normals)
    off = np.abs(np.linalg.norm(small.mean(axis=1), axis=1) - 0.05).max()
    assert off <= most < 0.2 * bulges(facets, normals).max()


# Coarse facets


@pytest.mark.slow
@pytest.mark.parametrize(
    ("corners", "off", "turned"),
    [(ball(0.05, 3), 1e-5, 0.1), (ball(0.02, 3), 5e-6, 0.1), (lying_cylinder(0.04, 0.12, 24), 1.2e-5, 0.15)],
    ids=["ball", "small ball", "cylinder"],
)
def test_coarse_facets_give_the_surface_that_their_corners_stand_on(corners: Array, off: float, turned: float) -> None:
    half = 0.5 * float(np.linalg.norm(corners.reshape(-1, 3)[:, 1:], axis=1).max())
    plane = lines(half)
    body = top_of(corners, plane)
    assert body.why == "coarse" and "facets are coarse" in body.words and f"{body.gap * 1e3:.3f} mm" in body.words
    points, normals = body.at(plane)
    axis = [0, 1, 1] if len(corners) == 96 else [1, 1, 1]
    true = points * axis
    radius = np.linalg.norm(true, axis=1)
    assert np.abs(radius - 2.0 * half).max() <= off
    angle = np.degrees(np.linalg.norm(np.cross(normals, true / radius[:, None]), axis=1))
    assert angle.max() <= turned
    assert off_facets(body, plane) <= body.gap * 1.001


@pytest.mark.slow
def test_facets_too_coarse_are_followed_and_what_would_help_is_named() -> None:
    """A ball of 320 facets: the ball itself is 0.66 mm off them."""
    facets, plane = ball(0.05, 2), lines(0.02)
    body = top_of(facets, plane)
    assert body.gap <= FARTHEST_FROM_FACETS and not body.why
    assert "a smooth surface through their corners is" in body.words
    asked = 1e-3 * float(body.words.rpartition("smooth_mm: ")[2].split()[0])
    calm = top_of(facets, plane, asked)
    assert calm.gap <= asked and off_facets(calm, plane) <= asked
    step = np.linalg.norm(np.diff(plane, axis=0), axis=1) < 1e-3
    turn = np.linalg.norm(np.diff(calm.at(plane)[1], axis=0), axis=1)[step]
    assert turn.max() < 0.5 * np.linalg.norm(np.diff(body.at(plane)[1], axis=0), axis=1)[step].max()


# Noise


@pytest.mark.slow
@settings(max_examples=12, deadline=None)
@given(
    noise=st.floats(0.0, 0.3e-3),
    radius=st.floats(0.03, 0.1),
    seed=st.integers(0, 99),
    bound=st.sampled_from((None, 5e-4)),
)
def test_noise_is_smoothed_within_the_bound(noise: float, radius: float, seed: int, bound: float | None) -> None:
    facets, plane = ball(radius, 5, noise, seed), lines(0.4 * radius)
    body = top_of(facets, plane, bound)
    assert body.gap <= (MOST_UNASKED if bound is None else bound)
    assert off_facets(body, plane) <= body.gap * 1.001
    if bound is None:
        normals = body.at(plane)[1]
        true = plane / radius
        up = np.sqrt(1.0 - (true**2).sum(axis=1))
        angle = np.degrees(np.linalg.norm(np.cross(normals, np.column_stack([true, up])), axis=1))
        assert angle.max() <= 1.0 + 2.5e4 * noise  # degrees, at the ends of lines; facets are off by four times as much


@pytest.mark.slow
def test_noise_is_told() -> None:
    body = top_of(ball(0.05, 5, 0.2e-3), lines(0.02))
    assert body.why == "noisy" and "since facets are noisy" in body.words and "keeps to the facets" in body.words
    close = top_of(ball(0.05, 5, 0.2e-3), lines(0.02), FARTHEST_FROM_FACETS)
    assert close.gap <= FARTHEST_FROM_FACETS and not close.words


@pytest.mark.slow
def test_waves_are_no_noise() -> None:
    """What is as small as noise, but goes on from facet to facet, is a shape: followed or refused, not smoothed away."""
    x = np.arange(81) * 0.5e-3
    waves = 0.15e-3 * np.sin(2.0 * np.pi * x / 5e-3)[:, None] * np.ones(81)
    body = top_of(sheet(waves, 0.5e-3), lines(0.015))
    assert body.why == "" and body.gap <= FARTHEST_FROM_FACETS


@pytest.mark.slow
def test_a_bump_is_no_noise() -> None:
    x = (np.arange(81) - 40) * 0.5e-3
    far = x[:, None] ** 2 + x[None] ** 2
    body = top_of(sheet(0.3e-3 * np.exp(-far / 2e-3**2), 0.5e-3), lines(0.015))
    assert body.gap <= FARTHEST_FROM_FACETS
    assert body.at(np.zeros((1, 2)))[0][0, 2] == pytest.approx(0.3e-3, abs=5e-5)


@pytest.mark.slow
def test_edges_stay_sharp_unless_they_may_be_rounded() -> None:
    x = (np.arange(81) - 40) * 1e-3
    roof = sheet(-np.abs(x)[:, None] * np.ones(81), 1e-3)
    with pytest.raises(TooRoughMesh) as caught:
        top_of(roof, lines(0.03))
    asked = 1e-3 * float(caught.value.words.split("smooth_mm: ")[1].split()[0])
    assert top_of(roof, lines(0.03), asked).gap <= asked


# Whole prints


@pytest.mark.slow
@pytest.mark.parametrize("name", ["ball", "cylinder", "noise"])
def test_coarse_and_noisy_bodies_print_at_speed(tmp_path: Path, name: str) -> None:
    corners, origin = {
        "ball": (ball(50.0, 3), "[0, 0, -20]"),
        "cylinder": (lying_cylinder(40.0, 120.0, 24), "[0, 0, 0]"),
        "noise": (ball(50.0, 5, 0.3), "[0, 0, -20]"),
    }[name]
    mesh = trimesh.Trimesh(**trimesh.triangles.to_kwargs(corners))
    (tmp_path / "part.stl").write_bytes(mesh.export(file_type="stl"))
    where = f'part.mesh={{file: "{tmp_path / "part.stl"}", origin_mm: {origin}}}'
    plan = solve_alone(load_problem("hemisphere_honeycomb", ("part.sphere=null", where, PATTERN, *COARSE)), "ladder")
    assert plan.verified, [check for check in plan.checks if not check.ok]
    assert plan.metrics["at_speed_fraction"] >= 0.95
    assert any("beads lie on a smooth surface" in note for note in plan.toolpath.notes)


@pytest.mark.slow
def test_a_refusal_names_how_far_a_surface_would_be(tmp_path: Path) -> None:
    x = (np.arange(41) - 20) * 1.0
    roof = trimesh.Trimesh(**trimesh.triangles.to_kwargs(sheet(30.0 - np.abs(x)[:, None] * np.ones(41), 1.0)))
    (tmp_path / "roof.stl").write_bytes(roof.export(file_type="stl"))
    where = f'part.mesh={{file: "{tmp_path / "roof.stl"}"}}'
    changes = ("part.sphere=null", where, "layers.source={pattern: zigzag, cell_mm: 8, size_mm: [24, 24]}", *COARSE)
    with pytest.raises(InputError, match="mm off them at x") as caught:
        build_toolpath(load_problem("hemisphere_honeycomb", changes))
    said = str(caught.value)
    smooth, share = said.split("smooth_mm: ")[1].split()[0], said.split("leave_out_share: ")[1].split()[0]
    rounded = build_toolpath(load_problem("hemisphere_honeycomb", (*changes, f"part.mesh.smooth_mm={smooth}")))
    assert len(rounded.beads) == 1
    cut = build_toolpath(load_problem("hemisphere_honeycomb", (*changes, f"layers.source.leave_out_share={share}")))
    assert len(cut.beads) > 1 and "at edges of the part" in cut.notes[0]
