"""Nozzle directions from facets: how they turn from one to the next, and what is refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st
from solved import solve_alone

from benchmarks.orientation import main as orientation
from planner.base.arrays import Array
from planner.base.errors import InputError
from planner.problem import Problem, load_problem
from planner.toolpath.build import build_toolpath
from planner.toolpath.substrate.bodies import Ball, Facing
from planner.toolpath.substrate.projection import Substrate

COARSE = ("layers.count=1", "resolve.rung_mm=10", "resolve.roll_step_deg=30")
DOME = Ball(0.05, np.array([0.0, 0.0, -0.02]))


def dome(folder: Path, *changes: str) -> Problem:
    """The shipped problem on a mesh of its dome, with facets of some 3 mm."""
    ball = trimesh.creation.icosphere(subdivisions=4, radius=50.0)
    (folder / "dome.stl").write_bytes(ball.export(file_type="stl"))
    mesh = ("part.sphere=null", f'part.mesh={{file: "{folder}/dome.stl", origin_mm: [0, 0, -20]}}')
    return load_problem("hemisphere_honeycomb", (*mesh, *changes))


def turned(one: Array, other: Array) -> Array:
    return np.asarray(np.degrees(np.linalg.norm(np.cross(one, other), axis=-1)))


@given(st.floats(0.5e-3, 8e-3), st.integers(0, 1000))
def test_beyond_half_a_blend_from_an_edge_the_normal_is_the_facet_s(blend: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    s = np.concatenate([[0.0], np.cumsum(rng.uniform(0.5e-4, 1.5e-4, 600))])
    edges = np.sort(rng.uniform(0.0, s[-1], 3))
    facets = rng.normal(size=(4, 3)) * 0.1 + [0.0, 0.0, 1.0]
    facets /= np.linalg.norm(facets, axis=1)[:, None]
    seen = facets[np.searchsorted(edges, s)]
    facing = Facing.along(s, seen, blend, False)
    found = facing.at(s)
    np.testing.assert_allclose(np.linalg.norm(found, axis=1), 1.0)
    clear = np.abs(s[:, None] - edges).min(axis=1) > 0.5 * blend + 1e-4
    np.testing.assert_allclose(found[clear], seen[clear], atol=1e-9)
    shuffled = rng.permutation(len(s))
    np.testing.assert_array_equal(facing.at(s[shuffled]), found[shuffled])


def test_half_of_a_turn_is_done_at_the_edge_and_all_of_it_smoothly() -> None:
    s = np.linspace(0.0, 20e-3, 2001)
    lean = np.radians(2.0)
    seen = np.where(s[:, None] < 10e-3, [np.sin(-lean), 0.0, np.cos(lean)], [np.sin(lean), 0.0, np.cos(lean)])
    found = Facing.along(s, seen, 4e-3, False).at(s)
    angle = np.degrees(np.arctan2(found[:, 0], found[:, 2]))
    assert angle[1000] == pytest.approx(0.0, abs=0.03)  # the edge is between two samples
    assert (np.diff(angle) >= -1e-9).all()
    rate = np.gradient(angle, s)
    assert rate.max() < 3.4 * 4.0 / 4e-3  # deg/m: 3.3 times the mean over the blend, and no jump
    bend = np.diff(angle, 2) / (s[1] - s[0]) ** 2
    assert np.abs(bend).max() < 20.0 * 4.0 / 4e-3**2


def test_a_closed_bead_turns_across_its_seam() -> None:
    s = np.linspace(0.0, 40e-3, 801)
    seen = np.where((s < 20e-3)[:, None], [0.0, 0.1, 1.0], [0.1, 0.0, 1.0])
    seen[-1] = seen[0]
    found = Facing.along(s, seen / np.linalg.norm(seen, axis=1)[:, None], 5e-3, True).at(s)
    assert turned(found[0], found[-1]) < 0.3
    middle = np.array([0.05, 0.05, 1.0]) / np.linalg.norm([0.05, 0.05, 1.0])
    assert turned(found[0], middle) < 0.3  # half of the turn between last and first facet


@pytest.mark.slow
def test_facets_are_followed_and_the_plan_verifies(tmp_path: Path) -> None:
    """The axis is off the true ball's normals by up to half a facet, ten times what the smooth surface is."""
    few = ("layers.source.size_mm=[24, 24]", *COARSE)
    plans = {
        name: solve_alone(dome(tmp_path, *few, f"layers.normals={name}"), "ladder") for name in ("facets", "smooth")
    }
    off = {}
    for name, plan in plans.items():
        assert plan.verified, [check for check in plan.checks if not check.ok]
        off[name] = max(float(turned(b.normals, DOME.normals(b.points)).max()) for b in plan.toolpath.beads)
    assert off["smooth"] < 0.3
    assert 0.5 < off["facets"] < 3.0
    assert plans["facets"].metrics["at_speed_fraction"] < 0.6 < plans["smooth"].metrics["at_speed_fraction"]
    surface = plans["facets"].toolpath.surface
    assert isinstance(surface, Substrate) and len(surface.facings) == len(plans["facets"].toolpath.beads)


@pytest.mark.slow
def test_points_do_not_depend_on_what_the_nozzle_is_normal_to(tmp_path: Path) -> None:
    smooth, facets = (build_toolpath(dome(tmp_path, f"layers.normals={name}")) for name in ("smooth", "facets"))
    for one, other in zip(smooth.beads, facets.beads, strict=True):
        np.testing.assert_array_equal(one.points, other.points)
        assert turned(one.normals, other.normals).max() > 0.2


MISTAKES = (
    (("layers.normals=facets",), "part.sphere", "a sphere has no facets"),
    (("layers.blend_mm=3",), "layers.blend_mm", "normals are smooth"),
    (("layers.normals=facet",), "layers.normals", "did you mean facets"),
    (("layers.blend_mm=0",), "layers.blend_mm", "too small"),
)


@pytest.mark.parametrize(("changes", "field", "said"), MISTAKES)
def test_mistakes_are_told(changes: tuple[str, ...], field: str, said: str) -> None:
    with pytest.raises(InputError) as caught:
        load_problem("hemisphere_honeycomb", changes)
    assert str(caught.value.field).endswith(field)
    assert said in str(caught.value)


@pytest.mark.slow
def test_the_benchmark_tells_of_facets(capsys: pytest.CaptureFixture[str]) -> None:
    assert orientation(["--set", "layers.source.size_mm=[30, 30]"]) == 0
    told = capsys.readouterr().out
    assert "facets, jump of the normal" in told
    assert "turning over 6 mm, axis off the ball's normal" in told
