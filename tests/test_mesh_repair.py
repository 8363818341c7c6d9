"""Facets that are mended: turned as their neighbours, slits and holes closed, and all of it told."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from planner.base.arrays import Array
from planner.problem import load_problem
from planner.problem.mesh_repair import facing_alike, mend
from planner.toolpath.build import build_toolpath
from planner.toolpath.volume.sections import NotClosed, Solid

BALL = np.asarray(trimesh.creation.icosphere(2, 0.02).triangles)  # 320 facets of 4 to 6 mm
VOLUME = Solid.of(BALL).volume


def ring(large: float = 0.02, small: float = 0.008, n: int = 24) -> Array:
    """Facets of a torus [m]."""
    return np.array(trimesh.creation.torus(large, small, n, n).triangles)


def test_what_is_closed_stays_as_it_is() -> None:
    mended = mend(BALL, 1e-3)
    assert mended.words == "" and not mended.open
    assert np.array_equal(np.sort(mended.corners, axis=None), np.sort(BALL, axis=None))
    same, turned = facing_alike(BALL)
    assert same is BALL and turned == 0


@settings(max_examples=25, deadline=None)
@given(
    st.sets(st.integers(0, 319), min_size=1, max_size=150),
    st.sets(st.integers(0, 319), max_size=25),
    st.floats(0.0, 4e-6),
    st.integers(0, 2**31),
)
def test_any_facets_turned_lost_and_torn_off_give_back_the_body(
    turned: set[int], lost: set[int], torn: float, seed: int
) -> None:
    """Corners are up to 4 um apart, which is a slit; fewer facets are lost than would leave two surfaces."""
    rng = np.random.default_rng(seed)
    facets = BALL + rng.uniform(-torn, torn, BALL.shape)
    facets[list(turned)] = facets[list(turned)][:, ::-1]
    facets = np.delete(facets, list(lost), axis=0)
    mended = mend(facets, 1.0)
    assert not mended.open and mended.twisted is None
    body = Solid.of(mended.corners)
    assert body.volume == pytest.approx(VOLUME, rel=0.08)
    assert sum(hole.area for hole in mended.closed) <= 1.05 * len(lost) * _largest() + 1e-12
    assert ("turned round" in mended.words) == (mended.turned > 0)


def _largest() -> float:
    across = np.cross(BALL[:, 1] - BALL[:, 0], BALL[:, 2] - BALL[:, 0])
    return float(0.5 * np.linalg.norm(across, axis=1).max())


def test_holes_wider_than_allowed_stay_open_the_widest_first() -> None:
    middle = BALL.mean(axis=1)
    lost = middle[:, 2] > 0.017
    lost[np.argmax(middle[:, 0])] = True
    mended = mend(BALL[~lost], 4e-3)
    (wide,), (narrow,) = mended.open, mended.closed
    assert narrow.width < 4e-3 < wide.width
    assert wide.place[2] > 0.015 and narrow.place[0] > 0.015
    assert "1 hole closed" in mended.words
    with pytest.raises(NotClosed):
        Solid.of(mended.corners)


def test_an_edge_met_by_two_halves_is_joined_to_them() -> None:
    """One facet of a box is cut in two on one side only: no hole, though an edge has three facets' corners on it."""
    box = np.asarray(trimesh.creation.box((0.04, 0.02, 0.01)).triangles)
    a, b, c = box[0]
    middle = 0.5 * (a + b)
    cut = np.concatenate([box[1:], [[a, middle, c], [middle, b, c]]])
    mended = mend(cut, 1e-4)
    assert mended.words == "1 edge joined to the halves beside it" and not mended.open
    assert Solid.of(mended.corners).volume == pytest.approx(8e-6)


def test_all_but_one_facet_turned_still_face_outwards() -> None:
    facets = ring()
    facets[1:] = facets[1:, ::-1]
    mended = mend(facets, 1e-3)
    assert Solid.of(mended.corners).volume > 0.0
    assert mended.turned == len(facets) - 1


def test_a_surface_that_is_printed_on_is_turned_upwards_as_one() -> None:
    """Most of an open surface faces down in its file: what is printed on is its upper side."""
    x, y = (each.ravel() for each in np.meshgrid(np.linspace(0, 0.05, 11), np.linspace(0, 0.05, 11)))
    flat = trimesh.Trimesh(np.column_stack([x, y, 10.0 * x * y]), _grid(11), process=False)
    facets = np.asarray(flat.triangles)
    mixed = facets.copy()
    mixed[: len(facets) * 2 // 3] = mixed[: len(facets) * 2 // 3, ::-1]
    found, turned = facing_alike(mixed)
    assert turned == len(facets) * 2 // 3
    assert (np.cross(found[:, 1] - found[:, 0], found[:, 2] - found[:, 0])[:, 2] > 0.0).all()


@pytest.mark.slow
def test_beads_on_a_mesh_do_not_mind_which_way_its_facets_face(tmp_path: Path) -> None:
    ball = trimesh.creation.icosphere(4, 40.0)
    facets = np.array(ball.triangles)
    wrong = np.random.default_rng(3).permutation(len(facets))[: len(facets) // 3]
    toolpaths = []
    for name in ("right", "wrong"):
        if name == "wrong":
            facets[wrong] = facets[wrong][:, ::-1]
        soup = trimesh.Trimesh(facets.reshape(-1, 3), np.arange(3 * len(facets)).reshape(-1, 3), process=False)
        soup.export(tmp_path / f"{name}.stl")
        part = {"mesh": {"file": str(tmp_path / f"{name}.stl"), "origin_mm": [0, 0, 40]}}
        layers = {
            "source": {"pattern": "zigzag", "cell_mm": 6, "size_mm": [20, 20]},
            "project": "z",
            "count": 1,
            "height_mm": 0.5,
        }
        settings = (f"part={json.dumps(part)}", f"layers={json.dumps(layers)}")
        toolpaths.append(build_toolpath(load_problem("hemisphere_honeycomb", settings)))
    right, turned = toolpaths
    told = f"part.mesh: {len(wrong)} facets turned round to face as their neighbours do"
    assert turned.notes[0].startswith(told) and "turned round" not in " ".join(right.notes)
    for one, other in zip(right.beads, turned.beads, strict=True):
        assert other.points == pytest.approx(one.points, abs=1e-8)


def _grid(n: int) -> NDArray[np.int64]:
    i, j = (each.ravel() for each in np.meshgrid(np.arange(n - 1), np.arange(n - 1)))
    a = j * n + i
    return np.concatenate([np.column_stack([a, a + 1, a + n + 1]), np.column_stack([a, a + n + 1, a + n])])


def test_sheets_that_come_near_each_other_are_not_joined_into_one_of_one_side() -> None:
    """A band with half a twist whose ends are 5 um apart has two sides as it is, and one once they are joined."""
    t = np.linspace(0.0, 2.0 * np.pi - 2.5e-4, 61)[:, None]
    out = np.column_stack([np.cos(t), np.sin(t), np.zeros_like(t)])
    across = 0.004 * (np.cos(0.5 * t) * out + np.sin(0.5 * t) * np.array([0.0, 0.0, 1.0]))
    a, b = 0.02 * out - across, 0.02 * out + across
    band = np.concatenate([np.stack([a[:-1], b[:-1], b[1:]], axis=1), np.stack([a[:-1], b[1:], a[1:]], axis=1)])
    mended = mend(band, 1e-3)
    assert mended.twisted is None and mended.joined == 0
    assert mended.open
