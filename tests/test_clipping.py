"""What of curves cannot be printed on a part: cut, counted, told and drawn up to a share, refused beyond."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from planner.base.errors import InputError
from planner.problem import load_problem
from planner.toolpath.bead import Toolpath
from planner.toolpath.build import build_toolpath
from planner.toolpath.plane_paths import length
from planner.toolpath.substrate.clipping import EDGE, FITS, OFF, SHORT, STEEP, Clipped, at_edges, off_or_steep
from planner.toolpath.svg.outlines import PlanePath

WIDTH = 0.6e-3


def laid(*changes: str) -> Toolpath:
    return build_toolpath(load_problem("hemisphere_honeycomb", ("layers.count=1", *changes)))


def squares(side: float) -> str:
    return f"layers.source={{pattern: squares, cell_mm: 5, size_mm: [{side}, {side}]}}"


@settings(max_examples=60)
@given(
    points=st.lists(st.tuples(st.floats(-0.05, 0.05), st.floats(-0.05, 0.05)), min_size=2, max_size=6, unique=True),
    radius=st.floats(0.005, 0.06),
    closed=st.booleans(),
)
def test_nothing_of_a_path_is_lost_untold(points: list[tuple[float, float]], radius: float, closed: bool) -> None:
    drawn = np.array([*points, points[0]] if closed else points)
    if np.hypot(*np.diff(drawn, axis=0).T).min() < 1e-3:
        return
    path = PlanePath("p", drawn, closed)
    clipped = Clipped.of([path], WIDTH).without(lambda plane: np.where(np.hypot(*plane.T) > radius, OFF, FITS), WIDTH)
    kept = sum(length(each.points) for each in clipped.paths)
    cut = sum(length(each.points) for each in clipped.cuts)
    assert abs(kept + cut - length(drawn)) <= 1e-4 * len(clipped.cuts) * closed + 1e-9
    assert all(length(each.points) >= 3 * WIDTH for each in clipped.paths) or clipped.paths == (path,)
    for each in clipped.paths:
        assert np.hypot(*each.points.T).max() <= radius + 1e-9
    assert bool(clipped.notes) == bool(clipped.cuts)


def test_specks_are_left_out_first() -> None:
    paths = [PlanePath("long", np.array([[0.0, 0.0], [0.1, 0.0]]), False)]
    paths.append(PlanePath("speck", np.array([[0.0, 0.01], [0.5e-3, 0.01]]), False))
    clipped = Clipped.of(paths, WIDTH)
    assert [path.name for path in clipped.paths] == ["long"]
    assert [(cut.name, cut.why) for cut in clipped.cuts] == [("speck", SHORT)]
    assert clipped.share == pytest.approx(0.5 / 100.5)
    assert "0.5 mm too short for a bead (1 piece of path 'speck' at x 0.0, y 10.0 mm)" in clipped.notes[0]


def test_a_steep_facet_among_noise_is_no_wall() -> None:
    up = np.full(200, 0.8)
    up[50] = 0.1
    reasons = off_or_steep(lambda plane: up)(np.zeros((200, 2)))
    assert not reasons.any()
    up[100:130], up[180:] = 0.1, np.nan
    reasons = off_or_steep(lambda plane: up)(np.zeros((200, 2)))
    assert (reasons[103:127] == STEEP).all() and (reasons[180:] == OFF).all() and not reasons[:95].any()


def test_cuts_at_edges_keep_their_distance() -> None:
    plane = np.column_stack([np.linspace(0.0, 0.01, 101), np.zeros(101)])
    reasons = at_edges(np.array([[0.005, 0.0]]), 1e-3)(plane)
    assert (np.flatnonzero(reasons == EDGE) == np.arange(40, 61)).all()
    assert not at_edges(np.zeros((0, 2)), 1e-3)(plane).any()


@pytest.mark.slow
def test_a_pattern_beyond_a_plane_is_cut_at_its_rim() -> None:
    plane = "part={plane: {size_mm: [40, 40]}}"
    with pytest.raises(InputError, match="leaves the part") as caught:
        laid(plane, squares(50))
    share = str(caught.value).rpartition("leave_out_share: ")[2].split()[0]
    assert 0.2 < float(share) < 0.5
    toolpath = laid(plane, squares(50), f"layers.source.leave_out_share={share}")
    points = np.vstack([bead.points for bead in toolpath.beads])
    assert np.abs(points[:, :2]).max() <= 20e-3 + 1e-9
    assert "of the length left out" in toolpath.notes[0] and "off the part" in toolpath.notes[0]
    drawn = sum(length(bead.source[:, :2]) for bead in toolpath.beads) + sum(
        length(line[:, :2]) for line in toolpath.left_out
    )
    assert drawn == pytest.approx(22 * 50e-3, rel=0.01)
    with pytest.raises(InputError, match="leaves the part"):
        laid(plane, squares(50), f"layers.source.leave_out_share={0.9 * float(share)}")


def test_a_little_beyond_the_rim_is_cut_unasked() -> None:
    curve = "layers.source={curves: [{degree: 1, points_mm: [[-25, 0], [25, 0]]}]}"
    toolpath = laid("part={plane: {size_mm: [49.8, 49.8]}}", curve)
    assert "of the length left out, 0.4 mm off the part (2 pieces" in toolpath.notes[0]
    assert len(toolpath.left_out) > 0


def test_a_drawing_keeps_all_but_its_specks(tmp_path: Path) -> None:
    (tmp_path / "a.svg").write_text(
        '<svg xmlns="http://www.w3.org/2000/svg" width="40" height="20"><path d="M0,0 L40,0 L40,20" fill="none"/>'
        '<path d="M10,10 L10.3,10" fill="none"/></svg>'
    )
    source = f"layers.source={{svg: {tmp_path / 'a.svg'}, width_mm: 40}}"
    toolpath = laid(source)
    assert len(toolpath.beads) == 1 and "too short for a bead" in toolpath.notes[0]
    wrapped = build_toolpath(load_problem("cylinder_logo", (source, "layers.count=1")))
    assert len(wrapped.beads) == 1 and "too short for a bead" in wrapped.notes[0] and len(wrapped.left_out) == 1
    with pytest.raises(InputError, match=r"is only 0\.3"):
        laid(source, "layers.source.leave_out_share=0")


def test_a_ring_of_which_rounding_leaves_nothing_is_a_speck(tmp_path: Path) -> None:
    """0.94 mm around, longer than the bead is wide, and 0.3 mm across, where corners may be 0.2 mm off."""
    drawn = '<path d="M0 0H40V40H0"/><circle cx="20" cy="20" r="0.15"/>'
    (tmp_path / "a.svg").write_text(f'<svg xmlns="http://www.w3.org/2000/svg">{drawn}</svg>')
    source = f"layers.source={{svg: {tmp_path / 'a.svg'}, width_mm: 40}}"
    toolpath = build_toolpath(load_problem("cylinder_logo", (source, "layers.count=1")))
    assert len(toolpath.beads) == 1 and "too short for a bead" in toolpath.notes[0] and len(toolpath.left_out) == 1


@pytest.mark.slow
def test_a_pattern_over_a_step_is_cut_at_its_edge(tmp_path: Path) -> None:
    """A ledge of 3 mm across a block: both treads are printed, what lies at the riser is not."""
    low = trimesh.creation.box([40.0, 40.0, 10.0])
    high = trimesh.creation.box([20.0, 40.0, 13.0])
    low.apply_translation([0, 0, 5.0])
    high.apply_translation([10.0, 0, 6.5])
    (tmp_path / "step.ply").write_bytes(trimesh.util.concatenate([low, high]).export(file_type="ply"))
    part = (
        f'part={{mesh: {{file: "{tmp_path / "step.ply"}"}}}}',
        "layers.source={pattern: zigzag, cell_mm: 6, size_mm: [30, 30]}",
    )
    with pytest.raises(InputError, match="leave_out_share"):
        laid(*part)
    toolpath = laid(*part, "layers.source.leave_out_share=0.3")
    heights = {round(float(bead.points[:, 2].mean()) * 1e3, 2) for bead in toolpath.beads}
    assert heights == {10.5, 13.5}
    assert "at edges of the part" in toolpath.notes[-1]
