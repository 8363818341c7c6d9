"""Aerofoil cores: layers between a mesh and a middle, trimmed and reflected; and what is refused."""

from __future__ import annotations

import runpy
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import cKDTree
from solved import solve_alone

from benchmarks.parts import spacing
from planner.base.arrays import Array
from planner.base.errors import InputError
from planner.planning.solve_command import main
from planner.problem import load_problem
from planner.toolpath.bead import Toolpath
from planner.toolpath.build import build_toolpath
from planner.toolpath.plane_paths import PlaneCurve, densify
from planner.toolpath.substrate.clipping import trim_curve, trim_path
from planner.toolpath.substrate.cores import CoreSurface, even_levels, varying_levels
from planner.toolpath.substrate.mesh_surface import HeightField
from planner.toolpath.svg.outlines import PlanePath

PROBLEMS = Path(__file__).resolve().parents[1] / "problems"
BRISTOL = Path(__file__).resolve().parents[2] / "shared" / "data" / "bristol"
COARSE = ("resolve.rung_mm=10", "resolve.roll_step_deg=30")
DRAWN: dict[str, Any] = runpy.run_path(str(PROBLEMS / "draw_cores.py"))
TRUE = {"aerofoil_core": DRAWN["straight"], "aerofoil_core_tapered": DRAWN["tapered"]}
NAMES = tuple(TRUE)
STRIP = {"aerofoil_core": "layers.source.size_mm=[30, 99]", "aerofoil_core_tapered": "layers.source.size_mm=[40, 85]"}
SIDEWAYS = 1e-3  # mm, for slopes
PUBLISHED = {
    "aerofoil_core": (
        f'part.mesh={{file: "{BRISTOL}/Aerofoil_Shape.stl", rpy_deg: [90, 0, 0], origin_mm: [35, -65, 0]}}',
    ),
    "aerofoil_core_tapered": (
        f'part.mesh={{file: "{BRISTOL}/taper_aerofoil.stl", rpy_deg: [90, 0, 0], origin_mm: [45, -55, 0]}}',
        f'layers.up_to={{mesh: {{file: "{BRISTOL}/taper_zPlane.stl", rpy_deg: [90, 0, 0], origin_mm: [45, -55, 0]}}}}',
    ),
}


@cache
def core(name: str, *changes: str) -> Toolpath:
    """A strip of a shipped core, unless `changes` ask for another extent."""
    return build_toolpath(load_problem(name, (STRIP[name], *changes)))


def surface(toolpath: Toolpath) -> CoreSurface:
    assert isinstance(toolpath.surface, CoreSurface)
    return toolpath.surface


# Layers against the drawn surfaces, not their meshes


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_beads_lie_on_the_true_surfaces(name: str) -> None:
    toolpath = core(name)
    for bead in toolpath.beads:
        level = surface(toolpath).levels[bead.layer]

        def height(x: Array, y: Array, level: Any = level) -> Array:
            lower, middle = TRUE[name](x, y)
            return np.asarray(level.lower * lower + level.middle * middle + level.rise * 1e3)

        x, y, z = bead.points.T * 1e3
        slopes = [
            (height(x + a, y + b) - height(x - a, y - b)) / (2.0 * SIDEWAYS) for a, b in ((SIDEWAYS, 0), (0, SIDEWAYS))
        ]
        normals = np.column_stack([-slopes[0], -slopes[1], np.ones(len(x))])
        normals /= np.linalg.norm(normals, axis=1)[:, None]
        assert (np.abs(z - height(x, y)) * normals[:, 2]).max() <= 0.01  # mm
        assert np.degrees(np.linalg.norm(np.cross(normals, bead.normals), axis=1)).max() <= 0.1
        lower, middle = TRUE[name](x, y)
        assert (middle - lower).min() >= level.room * 1e3 - 0.02
        high = 1e3 * level.height + level.share * (middle - lower)
        np.testing.assert_allclose(bead.height * 1e3, high * normals[:, 2], atol=2e-3)


@pytest.mark.slow
@pytest.mark.parametrize(("name", "size"), [("aerofoil_core", (70.0, 100.0)), ("aerofoil_core_tapered", (100.0, 88.0))])
def test_what_ships_has_the_papers_extent(name: str, size: tuple[float, float]) -> None:
    """Whole cells of 8 mm come to both ends of the span, and along the chord to where the core is too thin or too steep."""
    toolpath = build_toolpath(load_problem(name))
    points = np.vstack([bead.points for bead in toolpath.beads]) * 1e3
    span, chord = np.ptp(points[:, :2], axis=0)
    assert size[0] - 1.1 * 8.0 <= span <= size[0]
    assert 0.85 * size[1] <= chord <= size[1]
    assert toolpath.layers == {"aerofoil_core": 40, "aerofoil_core_tapered": 28}[name]


@pytest.mark.parametrize("name", NAMES)
def test_files_are_those_that_the_script_draws(name: str) -> None:
    for file, data in DRAWN["meshes"]().items():
        assert (PROBLEMS / file).read_bytes() == data, f"{file}: run python problems/draw_cores.py"


def test_drawn_meshes_are_closed() -> None:
    for file in ("aerofoil_core", "aerofoil_core_tapered", "aerofoil_core_middle"):
        mesh = trimesh.load_mesh(PROBLEMS / f"{file}.stl")
        assert mesh.is_watertight and mesh.volume > 0.0


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_layers_lie_as_far_apart_as_they_should(name: str) -> None:
    found = spacing(core(name, "layers.halves=lower"))
    assert found is not None and found.places > 10_000
    assert found.median == pytest.approx(1.0, abs=2e-3)
    assert found.within >= 0.99


@pytest.mark.slow
def test_a_layer_ends_at_the_middle_and_the_halves_leave_less_than_a_layer_open() -> None:
    toolpath = core("aerofoil_core")
    top = max(bead.points[:, 2].max() for bead in toolpath.beads if not _above(toolpath, bead.layer))
    assert 44.5e-3 < top <= 45e-3
    lower, upper = (
        np.vstack([bead.points - [0.0, 0.0, h] for bead in toolpath.beads if _above(toolpath, bead.layer) == above])
        for above, h in ((False, 0.0), (True, 0.5e-3))
    )
    order = np.argsort(lower[:, 2])
    tree = cKDTree(lower[order[::-1]][:, :2])
    for x in (upper[upper[:, 2] > 45e-3]).tolist()[::50]:
        below = tree.query_ball_point(x[:2], 5e-5)
        if below:
            highest = lower[order[::-1]][below, 2].max()
            assert x[2] >= highest - 0.02e-3  # of the same place, to the slope over 0.05 mm
    assert sum(_above(toolpath, k) for k in range(toolpath.layers)) == toolpath.layers / 2


def _above(toolpath: Toolpath, layer: int) -> bool:
    return surface(toolpath).levels[layer].above_middle


@given(st.floats(0.1e-3, 2e-3), st.floats(1e-3, 20e-3), st.floats(0.0, 1.0))
def test_even_layers_fill_both_halves_but_for_less_than_one(height: float, most: float, share: float) -> None:
    """At any place: those that are laid there lie on each other up to the middle, and from there on."""
    room = share * most
    here = [level for level in even_levels(height, most, True) if room >= level.room]
    tips = [level.lower * 0.0 + level.middle * room + level.rise for level in here]
    lower = [tip for tip, level in zip(tips, here, strict=True) if not level.above_middle]
    upper = [tip for tip, level in zip(tips, here, strict=True) if level.above_middle]
    assert len(upper) - len(lower) in (0, 1)
    np.testing.assert_allclose(lower, height * np.arange(1, len(lower) + 1), atol=1e-9)
    np.testing.assert_allclose(upper, 2.0 * room - height * np.arange(len(upper))[::-1], atol=1e-9)
    left = 2.0 * room - height * len(here)
    assert -1e-9 <= left <= height + 1e-9


@given(st.floats(0.1e-3, 2e-3), st.floats(1e-3, 20e-3), st.floats(0.01, 1.0), st.booleans())
def test_varying_layers_share_the_height_out(height: float, most: float, share: float, both: bool) -> None:
    levels = varying_levels(height, 0.2 * height, most, both)
    room = share * most
    tips = [(level.lower + level.middle - 1.0) * 0.0 + level.middle * room + level.rise for level in levels]
    np.testing.assert_allclose(np.diff([0.0, *tips]), [level.share * room for level in levels], atol=1e-9)
    assert tips[-1] == pytest.approx((2.0 if both else 1.0) * room)
    assert max(level.share for level in levels) * most <= height * (1.0 + 1e-6)
    assert levels[0].room == pytest.approx(0.2 * height / levels[0].share)


@pytest.mark.slow
def test_heights_vary_within_their_bounds() -> None:
    toolpath = core("aerofoil_core_tapered")
    heights = np.concatenate([bead.height / bead.normals[:, 2] for bead in toolpath.beads])
    assert 0.1e-3 <= heights.min() <= 0.12e-3 and 0.4e-3 <= heights.max() <= 0.5e-3
    assert min(float(np.ptp(bead.height)) for bead in toolpath.beads if bead.length > 0.02) > 0.01e-3
    thick = core("aerofoil_core_tapered", "layers.least_height_mm=0.3")
    assert thick.length < 0.7 * toolpath.length
    assert min(float((bead.height / bead.normals[:, 2]).min()) for bead in thick.beads) >= 0.3e-3


@pytest.mark.slow
def test_short_pieces_are_left_out_and_counted() -> None:
    toolpath = core("aerofoil_core")
    assert min(bead.length for bead in toolpath.beads) >= 1.8e-3
    (note,) = toolpath.notes
    assert "pieces of layers shorter than 1.8 mm left out" in note
    with pytest.raises(InputError, match=r"30\.9 mm of the layers are in pieces too short.*leave_out_share: 0\.002"):
        core("aerofoil_core", "layers.source.leave_out_share=0.001")


@pytest.mark.slow
def test_short_pieces_of_the_pattern_are_counted_in_each_layer() -> None:
    """Two of 1.2 and 1.6 mm, besides 28 pieces of layers that are short at their own ends."""
    (note,) = build_toolpath(load_problem("aerofoil_core_tapered")).notes
    assert note == "56 pieces of layers shorter than 1.8 mm left out, 48.3 mm in all"


@pytest.mark.slow
def test_a_steep_part_is_left_out() -> None:
    gentle = core("aerofoil_core", "layers.tilt_deg=20", "layers.count=2")
    normals = np.vstack([bead.normals for bead in gentle.beads])
    assert 19.0 <= np.degrees(np.arccos(normals[:, 2].min())) <= 20.0


@pytest.mark.slow
def test_a_count_takes_the_first_layers() -> None:
    few, all_ = core("aerofoil_core", "layers.count=3"), core("aerofoil_core")
    assert few.layers == 3
    for one, other in zip(few.beads, all_.beads[: len(few.beads)], strict=True):
        np.testing.assert_array_equal(one.points, other.points)


# The core as it grows


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_what_has_grown_is_solid(name: str) -> None:
    """A bead's tips are its height above what it lies on; what was laid before is inside or on it."""
    toolpath = core(name)
    step = max(len(toolpath.beads) // 40, 1)
    for i in range(0, len(toolpath.beads), step):
        bead, there = toolpath.beads[i], toolpath.surface.before(i + 1)
        gap = there.signed_distance(bead.points)
        joint = 1.1 * 0.5e-3 if _above(toolpath, bead.layer) else 0.0  # the halves may leave a layer's height open
        assert gap.min() >= 0.4 * bead.height.min() and (gap <= bead.height + joint + 0.06e-3).all()
        buried = there.signed_distance(bead.points - 3.0 * bead.height[:, None] * bead.normals)
        assert np.median(buried) < 0.0
        np.testing.assert_allclose(toolpath.surface.normals_on(i, bead.s, bead.points), bead.normals, atol=1e-9)
        far = there.signed_distance(bead.points + [0.0, 0.0, 0.2])
        assert far.min() > 0.15


@pytest.mark.slow
def test_far_beside_a_core_there_is_only_its_mould() -> None:
    toolpath = core("aerofoil_core")
    last = toolpath.surface.before(len(toolpath.beads))
    beside = np.array([[0.0, 0.054, 0.050], [0.0, 0.12, 0.020], [0.030, 0.0, 0.060]])
    body = surface(toolpath).body.signed_distance(beside)
    assert last.signed_distance(beside)[1] == pytest.approx(body[1])
    assert (last.signed_distance(beside) > 2e-3).all()
    np.testing.assert_allclose(last.normals(beside)[1], [0.0, 0.0, 1.0])


# Cutting curves


@settings(max_examples=50)
@given(st.integers(0, 10_000), st.booleans())
def test_cut_curves_are_those_that_were_kept(seed: int, closed: bool) -> None:
    rng = np.random.default_rng(seed)
    angle = np.sort(rng.uniform(0.0, 6.2, 12))
    corners = 0.02 * np.column_stack([np.cos(angle), np.sin(angle)])
    if closed:
        corners = np.vstack([corners, corners[:1]])
    dense = densify(corners)
    keep = rng.random(20)[np.arange(len(dense)) * 20 // len(dense)] > 0.4
    if closed:
        keep[-1] = keep[0]
    pieces = trim_path(PlanePath("p", corners, closed), dense, keep)
    if not keep.any():
        assert not pieces
        return
    found = [densify(piece.points) for piece in pieces]
    assert keep.all() == (closed and any(piece.closed for piece in pieces)) or not closed
    tree = cKDTree(np.vstack(found))
    inner = keep & np.roll(keep, 1) & np.roll(keep, -1)
    assert tree.query(dense[inner])[0].max(initial=0.0) <= 1.1e-4
    assert cKDTree(dense[keep]).query(np.vstack(found))[0].max() <= 1.1e-4
    # the same of a curve whose samples are uniform in the arc length of its source
    arc = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(corners, axis=0).T))])
    u = np.linspace(0.0, arc[-1], 400)
    points = np.column_stack([np.interp(u, arc, corners[:, k]) for k in range(2)])
    kept = rng.random(20)[np.arange(400) * 20 // 400] > 0.4
    for piece in trim_curve(PlaneCurve("p", points, corners, closed), kept):
        np.testing.assert_allclose(piece.source[[0, -1]], piece.points[[0, -1]], atol=1e-12)
        total = np.hypot(*np.diff(piece.source, axis=0).T).sum()
        if not piece.closed:
            assert total == pytest.approx((len(piece.points) - 1) * u[1], abs=1e-9)


def test_a_closed_curve_cut_once_stays_in_one_piece() -> None:
    angle = np.linspace(0.0, 2.0 * np.pi, 201)
    ring = 0.01 * np.column_stack([np.cos(angle), np.sin(angle)])
    ring[-1] = ring[0]
    (piece,) = trim_curve(PlaneCurve("ring", ring, ring, True), ring[:, 0] > 0.0)
    assert not piece.closed
    assert np.hypot(*np.diff(piece.points, axis=0).T).max() < 0.4e-3  # the seam is inside, and stands there once
    assert (np.hypot(*np.diff(piece.points, axis=0).T) > 0.0).all()


def test_a_surface_is_the_same_with_more_knots() -> None:
    rng = np.random.default_rng(0)
    coarse = HeightField(np.zeros(2), 1.0, rng.normal(size=(7, 9)))
    fine = HeightField(np.zeros(2), 0.25, np.zeros((12, 16)))
    places = rng.uniform(0.0, [1.75, 2.75], (50, 2))
    for one, other in zip(coarse.at(places), coarse.refined(fine).at(places), strict=True):
        np.testing.assert_allclose(one, other, atol=1e-13)
    np.testing.assert_allclose(coarse.level(0.3).at(places)[0][:, 2], 0.3)


# What is refused

BAD_KEYS = (
    (("layers.up_to={}",), "layers.up_to.z_mm", "neither z_mm nor mesh is given"),
    (("layers.up_to.mesh={file: a.stl}",), "layers.up_to.mesh", "both z_mm and mesh are given"),
    (("layers.up_to.height_mm=4",), "layers.up_to.height_mm", "known keys: z_mm, mesh"),
    (("layers.least_height_mm=0.2",), "layers.least_height_mm", "heights are even"),
    (("layers.heights=varying", "layers.least_height_mm=0.6"), "layers.least_height_mm", "is more than the greatest"),
    (("layers.heights=uneven",), "layers.heights", "choices: even, varying"),
    (("layers.halves=upper",), "layers.halves", "choices: both, lower"),
    (("layers.tilt_deg=80",), "layers.tilt_deg", "too large"),
    (("layers.tilt=30",), "layers.tilt", "did you mean tilt_deg"),
    (("part={sphere: {radius_mm: 30}}",), "part.sphere", "do not go together"),
    (("part=null",), "part", "is missing"),
)


@pytest.mark.parametrize(("changes", "field", "said"), BAD_KEYS)
def test_mistakes_are_told(changes: tuple[str, ...], field: str, said: str) -> None:
    with pytest.raises(InputError) as caught:
        load_problem("aerofoil_core", changes)
    assert str(caught.value.field).endswith(field)
    assert said in str(caught.value)


NO_CORE = (
    (("layers.up_to.z_mm=30",), "layers.height_mm", "the middle is at most -[0-9.]+ mm above the part"),
    (("layers.up_to.z_mm=35.2",), "layers.height_mm", "at most 0.2. mm above"),
    (("layers.source.size_mm=[90, 99]",), "layers.source", "leaves the part at x"),
    (("layers.centre_mm=[300, 0]",), "layers.centre_mm", "no curve falls onto the part"),
    (("layers.up_to={mesh: {file: none.stl}}",), "layers.up_to.mesh.file", "there is no file"),
    (("layers.height_mm=0.5", "layers.source.size_mm=[20, 20]", "layers.centre_mm=[0, 40]", "layers.tilt_deg=5"),
     "layers.height_mm", "leans by more than 5 degrees"),
)  # fmt: skip


@pytest.mark.parametrize(("changes", "field", "said"), NO_CORE)
def test_cores_without_room_are_refused(changes: tuple[str, ...], field: str, said: str) -> None:
    with pytest.raises(InputError, match=said) as caught:
        build_toolpath(load_problem("aerofoil_core", changes))
    assert str(caught.value.field).endswith(field)


def test_a_middle_that_ends_too_soon_is_refused(tmp_path: Path) -> None:
    plate = trimesh.creation.box([70.0, 40.0, 40.0])
    plate.apply_translation([0.0, 0.0, 25.0])
    (tmp_path / "plate.stl").write_bytes(plate.export(file_type="stl"))
    with pytest.raises(InputError, match="leaves the middle") as caught:
        build_toolpath(load_problem("aerofoil_core", (f'layers.up_to={{mesh: {{file: "{tmp_path}/plate.stl"}}}}',)))
    assert str(caught.value.field).endswith("layers.up_to.mesh.file") or "--set" in str(caught.value.field)


def test_the_command_ends_with_two_and_writes_nothing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "out"
    assert main(["aerofoil_core", "--set", "layers.up_to.z_mm=30", "--out", str(out)]) == 2
    assert "no room for a layer" in capsys.readouterr().err
    assert not out.exists()


# Whole prints


@pytest.mark.slow
@pytest.mark.skipif(not BRISTOL.exists(), reason="the authors' meshes are not part of the project")
@pytest.mark.parametrize("name", NAMES)
def test_the_published_meshes_are_solved(name: str) -> None:
    """The moulds as their authors published them, y up; a few layers of each half's pattern."""
    toolpath = core(name, *PUBLISHED[name])
    assert toolpath.layers == {"aerofoil_core": 39, "aerofoil_core_tapered": 24}[name]
    assert surface(toolpath).body.gap <= 0.011e-3
    few = ("layers.count=2", "layers.source.size_mm=[30, 70]")
    plan = solve_alone(load_problem(name, (*COARSE, *PUBLISHED[name], *few)), "ladder")
    assert plan.verified, [check for check in plan.checks if not check.ok]
