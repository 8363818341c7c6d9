"""Closed meshes filled with layers between two surfaces: sections, filling, layers, what they lie on, and refusals."""

from __future__ import annotations

import runpy
import struct
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import shapely
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from planner.base.arrays import Array
from planner.base.errors import InputError
from planner.collision.print_body import print_body
from planner.motion.extrusion import bead_area
from planner.planning.solve_command import main
from planner.problem import find_problem, load_problem
from planner.toolpath.bead import Bead, Toolpath
from planner.toolpath.build import build_toolpath
from planner.toolpath.plane_paths import length
from planner.toolpath.substrate.mesh_surface import LastTrees
from planner.toolpath.volume.layers import walls, zigzag
from planner.toolpath.volume.sections import NotClosed, Solid

Top = Callable[[Array, Array], Array]

OUTER, INNER, MIDDLE, RISE = 15e-3, 6e-3, 3e-3, 0.9e-3  # m: what problems/draw_saddle_ring.py draws
LAYERS = 8

PROBLEM = """\
name: block
cell:
  arm: irb140
  nozzle: {{tip_mm: [-44.51, 9.9, 113.95], axis: [0, 0, 1], diameter_mm: 0.6}}
  home_deg: [0, 0, 0, 0, 90, 0]
  bed_mm: [560, -93, 290]
layers:
  source: {{mesh: block.stl}}
  height_mm: 0.5
  infill: {{density: 0.3}}
{more}
process:
  speed_mm_s: 40
  travel_speed_mm_s: 200
  bead: {{width_mm: 0.6}}
  corner_tolerance_mm: 0.2
"""


def saddle(x: Array, y: Array) -> Array:
    """Height of the ring's top [m]."""
    return MIDDLE + RISE * (x**2 - y**2) / OUTER**2


def block(top: Top, size: tuple[float, float] = (12.0, 8.0), foot: float = 0.0, cells: int = 12) -> Array:
    """Facets (n, 3, 3) [mm] of a block around the origin with that top, as high as it says at x, y [mm]."""
    x, y = (np.linspace(-0.5 * side, 0.5 * side, cells + 1) for side in size)
    gx, gy = np.meshgrid(x, y, indexing="ij")
    sheets = np.stack([np.stack([gx, gy, z], axis=-1) for z in (np.full_like(gx, foot), top(gx, gy))])
    a, b, c, d = sheets[:, :-1, :-1], sheets[:, 1:, :-1], sheets[:, 1:, 1:], sheets[:, :-1, 1:]
    quads = np.stack([a, b, c, d], axis=-2).reshape(2, -1, 4, 3)
    faces = [quads[0][:, ::-1], quads[1]]
    for low, high in (
        (sheets[0, :, 0], sheets[1, :, 0]),
        (sheets[0, -1, :], sheets[1, -1, :]),
        (sheets[0, ::-1, -1], sheets[1, ::-1, -1]),
        (sheets[0, 0, ::-1], sheets[1, 0, ::-1]),
    ):
        faces.append(np.stack([low[:-1], low[1:], high[1:], high[:-1]], axis=1))
    quads = np.concatenate(faces)
    return np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])


def flat(height: float) -> Top:
    """A level top [mm]."""
    return lambda x, y: np.full_like(x, height)


def write(path: Path, facets: Array) -> None:
    """A binary STL file."""
    record = np.zeros(len(facets), dtype=[("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
    record["corners"] = facets
    path.write_bytes(b"block".ljust(80) + struct.pack("<I", len(facets)) + record.tobytes())


def problem_file(folder: Path, facets: Array, more: str = "") -> Path:
    """A problem that fills these facets."""
    write(folder / "block.stl", facets)
    file = folder / "block.yaml"
    file.write_text(PROBLEM.format(more=more))
    return file


def built(folder: Path, facets: Array, more: str = "") -> Toolpath:
    """Its toolpath."""
    return build_toolpath(load_problem(problem_file(folder, facets, more)))


@cache
def ring() -> Toolpath:
    """The problem that ships."""
    return build_toolpath(load_problem("saddle_ring"))


def every(beads: tuple[Bead, ...], name: str) -> Array:
    """An array of all beads, one after another."""
    return np.concatenate([getattr(bead, name) for bead in beads])


def levels(toolpath: Toolpath) -> Array:
    """Of every sample, how many layers up its tip is."""
    return np.concatenate([np.full(len(bead.points), bead.layer + 1.0) for bead in toolpath.beads])


# The problem that ships


def test_the_file_is_what_the_script_draws() -> None:
    script = runpy.run_path(str(find_problem("saddle_ring").with_name("draw_saddle_ring.py")))
    assert script["TARGET"].read_bytes() == script["stl"](script["corners"]())
    assert script["MIDDLE"] == MIDDLE * 1e3
    assert script["RISE"] == RISE * 1e3


@pytest.mark.slow
def test_layers_share_the_height_of_the_true_ring_out() -> None:
    toolpath = ring()
    assert toolpath.layers == LAYERS
    x, y, z = every(toolpath.beads, "points").T
    share = levels(toolpath) / LAYERS
    assert np.abs(z - share * saddle(x, y)).max() < 0.02e-3
    slope = np.column_stack([-2.0 * RISE * x / OUTER**2, 2.0 * RISE * y / OUTER**2]) * share[:, None]
    true = np.column_stack([slope, np.ones(len(x))])
    true /= np.linalg.norm(true, axis=1)[:, None]
    off = np.linalg.norm(np.cross(true, every(toolpath.beads, "normals")), axis=1)
    assert np.degrees(np.arcsin(off)).max() < 0.1


@pytest.mark.slow
def test_beads_are_as_high_as_their_layers_are_apart_along_the_normal() -> None:
    toolpath = ring()
    points, normals, high = (every(toolpath.beads, name) for name in ("points", "normals", "height"))
    share = (levels(toolpath) - 1.0) / LAYERS  # of the layer beneath
    away = np.zeros(len(points))
    for _ in range(20):  # to where the normal meets that layer
        foot = points - away[:, None] * normals
        away += foot[:, 2] - share * saddle(foot[:, 0], foot[:, 1])
    assert np.abs(away / high - 1.0).max() < 0.02


@pytest.mark.slow
def test_beads_stay_within_the_walls_and_keep_the_corner_tolerance() -> None:
    for bead in ring().beads:
        away = np.hypot(bead.points[:, 0], bead.points[:, 1])
        assert away.min() > INNER + 0.3e-3 - 0.2e-3
        assert away.max() < OUTER - 0.3e-3 + 0.2e-3


@pytest.mark.slow
@pytest.mark.parametrize("infill", [0.4, 1.0])
def test_as_much_is_printed_as_the_ring_holds_times_what_is_filled(infill: float) -> None:
    problem = load_problem("saddle_ring", (f"layers.infill.density={infill}",))
    toolpath = ring() if infill == 0.4 else build_toolpath(problem)
    printed = sum(float(np.trapezoid(bead_area(bead, problem.process), bead.s)) for bead in toolpath.beads)
    inner, outer = INNER + 0.6e-3, OUTER - 0.6e-3
    whole = np.pi * (OUTER**2 - INNER**2)
    filled = infill * np.pi * (outer**2 - inner**2)
    share = 1.0 - np.pi * (outer**2 - inner**2) / whole + filled / whole
    assert printed / (whole * MIDDLE) == pytest.approx(share, rel=0.04)


@pytest.mark.slow
def test_every_second_layer_lies_across() -> None:
    def way(layer: int) -> float:
        """The direction in which most of a layer's infill runs, within half a turn [rad]."""
        steps = np.vstack(
            [np.diff(b.points[:, :2], axis=0) for b in ring().beads if b.layer == layer and "infill" in b.name]
        )
        return float(0.5 * np.angle(((steps[:, 0] + 1j * steps[:, 1]) ** 2).sum()))

    assert np.degrees(way(0)) == pytest.approx(45.0, abs=5.0)
    assert np.degrees(way(1)) == pytest.approx(-45.0, abs=5.0)


def test_the_surface_grows_with_the_layers() -> None:
    surface = ring().surface
    top = np.array([[10e-3, 0.0, saddle(np.array(10e-3), np.array(0.0))]])
    assert surface.before(0).signed_distance(top)[0] == pytest.approx(top[0, 2])  # nothing but the bed
    last = len(ring().beads)
    done = surface.before(last)
    height = top[0, 2] / LAYERS
    assert done.signed_distance(top)[0] == pytest.approx(height, rel=0.03)  # the layer of the last bead does not count
    assert done.signed_distance(top - [[0.0, 0.0, 2.0 * height]])[0] < 0.0
    assert surface.before(1).signed_distance(top)[0] > 0.0  # asked in any order it is what it is when asked at once
    alone = replace(surface, grown=LastTrees(), tops=[]).before(last)
    np.testing.assert_array_equal(done.signed_distance(top), alone.signed_distance(top))
    beside = np.array([[0.0, 0.0, 1e-3]])  # within the hole
    assert 0.5e-3 < done.signed_distance(beside)[0] <= 1e-3
    tips = ring().beads[-1].points
    assert np.degrees(np.arccos((done.normals(tips) * ring().beads[-1].normals).sum(axis=1).clip(-1, 1))).max() < 0.01


def test_the_user_is_told_how_high_layers_are() -> None:
    assert ring().notes[0].startswith(f"saddle_ring.stl: {LAYERS} layers, 0.2")
    assert len(ring().notes) == 1


# Sections


def test_a_section_is_what_the_planes_cut() -> None:
    facets = np.concatenate([block(flat(4.0)), block(flat(3.0), (4.0, 2.0), foot=1.0)[:, ::-1]]) * 1e-3
    solid = Solid.of(facets)
    assert solid.volume == pytest.approx((12 * 8 * 4 - 4 * 2 * 2) * 1e-9)
    heights = solid.vertices[:, 2]
    assert solid.section(heights, 2e-3).area == pytest.approx((12 * 8 - 4 * 2) * 1e-6)
    assert solid.section(heights, 3.5e-3).area == pytest.approx(12 * 8 * 1e-6)
    assert solid.section(heights, 5e-3).is_empty


@pytest.mark.parametrize("longest", [0.4e-3, 0.8e-3, 1.1e-3])  # 1.1: only some edges of a facet
def test_halving_edges_keeps_the_body(longest: float) -> None:
    solid = Solid.of(block(lambda x, y: 3.0 + 0.1 * x) * 1e-3)
    fine = solid.finer(longest)
    corners = fine.vertices[fine.facets][:, :, :2]
    assert np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max() <= longest
    assert len(fine.facets) > len(solid.facets)
    assert fine.volume == pytest.approx(solid.volume)
    Solid.of(fine.vertices[fine.facets])  # is closed


def test_an_open_edge_is_found() -> None:
    facets = block(flat(4.0)) * 1e-3
    with pytest.raises(NotClosed) as caught:
        Solid.of(facets[:-1])
    assert np.abs(facets[-1].mean(axis=0) - caught.value.place).max() < 4e-3
    with pytest.raises(NotClosed):
        Solid.of(np.concatenate([facets, facets[:1]]))


# Filling


def test_walls_lie_side_by_side() -> None:
    region = shapely.MultiPolygon([shapely.box(0, 0, 20e-3, 10e-3)])
    paths = walls(region, 1e-3, 2, 1e-5, "part")
    assert [length(path.points) for path in paths] == pytest.approx([56e-3, 48e-3])
    assert all(path.closed and (path.points[0] == path.points[-1]).all() for path in paths)


@pytest.mark.parametrize("density", [0.25, 0.5, 1.0])
@pytest.mark.parametrize("angle", [0.0, 30.0, 90.0])
def test_a_zigzag_fills_its_share(density: float, angle: float) -> None:
    region = shapely.MultiPolygon([shapely.box(0, 0, 40e-3, 30e-3)])
    paths = zigzag(region, 0.5e-3, 1, density, np.radians(angle), "part")
    total = sum(length(path.points) for path in paths) * 0.5e-3
    assert total == pytest.approx(density * 39e-3 * 29e-3, rel=0.05)
    inside = region.buffer(-0.75e-3 + 1e-9, join_style="mitre")
    assert all(inside.covers(shapely.LineString(path.points)) for path in paths)
    assert len(paths) == 1


def test_a_zigzag_ends_at_a_hole() -> None:
    region = shapely.MultiPolygon([shapely.box(0, 0, 40e-3, 30e-3) - shapely.Point(20e-3, 15e-3).buffer(8e-3)])
    paths = zigzag(region, 0.5e-3, 0, 0.4, 0.0, "part")
    assert len(paths) > 1
    hole = shapely.Point(20e-3, 15e-3).buffer(8e-3)
    assert not any(hole.crosses(shapely.LineString(path.points)) for path in paths)


# Layers between surfaces


@pytest.mark.slow
def test_thin_layers_end_where_they_reach_the_top(tmp_path: Path) -> None:
    """A wedge from 0.4 to 3 mm: layers half as high as the greatest, and fewer of them where it is thin."""
    facets = block(lambda x, y: 1.7 + 1.3 * x / 15.0, size=(30.0, 8.0))
    toolpath = built(tmp_path, facets, "  least_height_mm: 0.25")
    x, _, z = every(toolpath.beads, "points").T
    normals, height = every(toolpath.beads, "normals"), every(toolpath.beads, "height")
    along_z = height / normals[:, 2]
    assert along_z.min() > 0.249e-3
    assert along_z.max() < 0.5e-3 + 1e-8
    top = 1.7e-3 + 1.3 * x / 15.0
    assert (z - 0.5 * along_z <= top + 0.02e-3).all()
    thin = np.array(
        [len({b.layer for b in toolpath.beads if (b.points[:, 0] < edge).any()}) for edge in (-13e-3, 15e-3)]
    )
    assert thin[0] < thin[1] == toolpath.layers == 6


@pytest.mark.slow
def test_a_turned_mesh_is_still_closed(tmp_path: Path) -> None:
    facets = block(lambda x, y: 3.0 + 0.05 * x)[..., [0, 2, 1]] * [1.0, 1.0, -1.0]  # y points up
    file = problem_file(tmp_path, facets)
    turned = build_toolpath(load_problem(file, ("layers.source.rpy_deg=[90, 0, 0]",)))
    assert turned.layers == 7
    x, _, z = turned.beads[-1].points.T
    assert np.abs(z - (3e-3 + 0.05 * x)).max() < 1e-6
    assert build_toolpath(load_problem(file, ("layers.source.rpy_deg=[90, 0, 33]",))).layers == 7


def test_level_guides_give_level_layers(tmp_path: Path) -> None:
    def dome(x: Array, y: Array) -> Array:
        return 3.0 - (x / 6.0) ** 2 - (y / 4.0) ** 2

    toolpath = built(tmp_path, block(dome), "  upper: {z_mm: 3}")
    assert toolpath.layers == 6
    for bead in toolpath.beads:
        assert bead.normals[:, 2] == pytest.approx(1.0, abs=1e-12)
        assert bead.points[:, 2] == pytest.approx((bead.layer + 1) * 0.5e-3, abs=1e-9)
        x, y = bead.points[:, :2].T * 1e3
        assert (dome(x, y) * 1e-3 > (bead.layer + 0.5) * 0.5e-3 - 1e-6).all()


@pytest.mark.slow
def test_a_low_upper_surface_cuts_nothing_off(tmp_path: Path) -> None:
    """It shapes layers; the body is printed to its own top."""
    low, own = (built(tmp_path, block(flat(3.0)), f"  upper: {{z_mm: {z}}}") for z in (1, 3))
    assert low.layers == own.layers
    np.testing.assert_allclose(max(bead.points[:, 2].max() for bead in low.beads), 3e-3, atol=1e-6)


@pytest.mark.slow
def test_layers_may_begin_at_a_mesh(tmp_path: Path) -> None:
    """Two wedges, one on the other: layers begin along the lower one's top, parallel to it."""

    def slope(x: Array, y: Array) -> Array:
        return 2.0 + 0.1 * x

    write(tmp_path / "base.stl", block(slope, size=(20.0, 20.0)))
    facets = block(lambda x, y: slope(x, y) + 2.0)
    facets[..., 2] = np.where(facets[..., 2] == 0.0, slope(facets[..., 0], facets[..., 1]), facets[..., 2])
    toolpath = built(tmp_path, facets, "  lower: {mesh: {file: base.stl}}")
    assert toolpath.layers == 4
    x, _, z = every(toolpath.beads, "points").T
    assert np.abs(z - (2e-3 + 0.1 * x + levels(toolpath) * 0.5e-3)).max() < 1e-6
    assert every(toolpath.beads, "width") == pytest.approx(0.6e-3, rel=0.01)
    above = np.array([[0.0, 0.0, 3e-3]])
    assert toolpath.surface.before(0).signed_distance(above)[0] == pytest.approx(1e-3 / np.hypot(1.0, 0.1))
    assert toolpath.shape is not None


def test_infill_of_another_material_changes_once_a_layer() -> None:
    toolpath = ring()
    assert {bead.material for bead in toolpath.beads if "wall" in bead.name} == {"shell"}
    assert {bead.material for bead in toolpath.beads if "infill" in bead.name} == {"core"}
    order = [bead.material for bead in toolpath.beads]
    assert sum(a != b for a, b in zip(order[:-1], order[1:], strict=True)) == LAYERS


# Bad input


def roofs(x: Array, y: Array) -> Array:
    """A top of sharp edges, five in a millimetre."""
    return 3.0 + 0.5 * np.cos(5.0 * np.pi * x)


BAD: dict[str, tuple[Array, str, str, str]] = {
    "open": (block(flat(3.0))[200:], "", "layers.source.mesh", "is not closed"),
    "inside out": (block(flat(3.0))[:, ::-1], "", "layers.source.mesh", "inside out"),
    "below the bed": (block(flat(3.0), foot=-1.0), "", "layers.source.mesh", "1.000 mm below the bed"),
    "edge on top": (block(roofs, cells=60), "", "layers.source.mesh", "z_mm: 3.5} for layers that end level"),
    "too steep": (block(lambda x, y: 4.0 + 0.5 * x), "  tilt_deg: 20", "layers.tilt_deg", "tilts by"),
    "upper below": (block(flat(3.0)), "  upper: {z_mm: -1}", "layers.upper", "nowhere above"),
    "lower above": (block(flat(3.0)), "  lower: {z_mm: 4}", "layers.lower", "nowhere above"),
    "lower beneath": (block(flat(8.0), foot=5.0), "  lower: {z_mm: 0}", "layers.lower", "below the body"),
    "guide too small": (
        block(flat(3.0)),
        "  upper: {mesh: {file: small.stl}}",
        "layers.upper.mesh.file",
        "does not reach over the whole body",
    ),
    "both guides": (block(flat(3.0)), "  upper: {z_mm: 1, mesh: {file: small.stl}}", "layers.upper", "both"),
    "no guide": (block(flat(3.0)), "  lower: {}", "layers.lower", "neither"),
    "heights": (block(flat(3.0)), "  least_height_mm: 0.5", "layers.least_height_mm", "not less"),
    "too small": (block(flat(6.0), size=(1.0, 0.5)), "", "process.bead.width_mm", "long enough"),
    "too many layers": (block(flat(3000.0)), "", "layers.height_mm", "6000 layers"),
    "material": (block(flat(3.0)), "  material: pva", "layers.material", "no material"),
    "perimeters": (block(flat(3.0)), "  perimeters: 1.5", "layers.perimeters", "whole number"),
    "body": (block(flat(3.0)), "part:\n  sphere: {radius_mm: 9}", "part", "its own body"),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", BAD)
def test_bad_input_is_refused(name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    facets, more, field, words = BAD[name]
    write(tmp_path / "small.stl", block(flat(2.0), size=(5.0, 5.0)))
    file = problem_file(tmp_path, facets, more)
    assert main([str(file), "--out", str(tmp_path / "out")]) == 2
    told = capsys.readouterr().err
    assert field in told
    assert words in " ".join(told.split())
    assert "Traceback" not in told
    assert not (tmp_path / "out").exists()


# Several bodies, and what is too narrow


def boxes(*places: tuple[tuple[float, float, float], tuple[float, float, float]]) -> Array:
    """Facets of boxes [mm], each with its sides and its middle."""
    found = []
    for sides, middle in places:
        box = trimesh.creation.box(sides)
        box.apply_translation(middle)
        found.append(np.asarray(box.triangles))
    return np.concatenate(found)


SIDE = (10.0, 10.0, 6.0)
BODIES = {
    "face to face": (boxes((SIDE, (0, 0, 3)), (SIDE, (10, 0, 3))), 200.0, 1),
    "edge to edge": (boxes((SIDE, (0, 0, 3)), (SIDE, (10, 10, 3))), 200.0, 2),
    "on each other": (boxes((SIDE, (0, 0, 3)), (SIDE, (0, 0, 9))), 100.0, 1),
    "overlapping": (boxes((SIDE, (0, 0, 3)), (SIDE, (5, 0, 3))), 150.0, 1),
    "apart": (boxes((SIDE, (0, 0, 3)), (SIDE, (30, 0, 3))), 200.0, 2),
    "one in the other": (boxes((SIDE, (0, 0, 3)), ((4, 4, 6), (0, 0, 3))), 100.0, 1),
    "a cavity": (np.concatenate([boxes((SIDE, (0, 0, 3))), boxes(((4, 4, 4), (0, 0, 3)))[:, ::-1]]), 84.0, 1),
    "a plug wider than its cavity": (
        np.concatenate([boxes((SIDE, (0, 0, 3)), ((5, 5, 5), (0, 0, 3))), boxes(((4, 4, 4), (0, 0, 3)))[:, ::-1]]),
        100.0,
        1,
    ),
    "a plug in one of two cavities": (
        np.concatenate(
            [
                boxes((SIDE, (0, 0, 3)), ((5, 5, 5), (2, 0, 3))),
                boxes(((4, 4, 4), (2, 0, 3)), ((2, 2, 4), (-3, 0, 3)))[:, ::-1],
            ]
        ),
        96.0,
        1,
    ),
}


@pytest.mark.parametrize("name", BODIES)
def test_several_bodies_are_one_region(name: str) -> None:
    facets, area, pieces = BODIES[name]
    solid = Solid.of(facets * 1e-3)
    region = solid.section(solid.vertices[:, 2], 2.9e-3)
    assert region.area * 1e6 == pytest.approx(area, rel=1e-6)
    assert len(region.geoms) == pieces


@settings(max_examples=40)
@given(
    st.lists(st.tuples(*[st.integers(0, 3)] * 3), min_size=1, max_size=8, unique=True),
    st.integers(0, 3),
)
def test_blocks_that_touch_anyhow_have_the_area_of_their_cells(cells: list[tuple[int, int, int]], level: int) -> None:
    """Blocks of a lattice that share faces, edges and corners."""
    facets = boxes(*[((10.0, 10.0, 10.0), (10.0 * x, 10.0 * y, 10.0 * z + 5.0)) for x, y, z in cells])
    solid = Solid.of(facets * 1e-3)
    assert solid.volume == pytest.approx(len(cells) * 1e-6)
    region = solid.section(solid.vertices[:, 2], 10e-3 * level + 4.9e-3)
    assert region.area * 1e6 == pytest.approx(100.0 * sum(z == level for _, _, z in cells), abs=1e-3)


@pytest.mark.slow
def test_a_layer_too_narrow_is_left_out_and_told(tmp_path: Path) -> None:
    """A ball stands on a point: its lowest layers are specks."""
    ball = trimesh.creation.icosphere(subdivisions=4, radius=6.0)
    ball.apply_translation([0, 0, 6.24])
    write(tmp_path / "block.stl", np.asarray(ball.triangles))
    text = PROBLEM.format(more="  upper: {z_mm: 12}\n  lower: {z_mm: 0}")
    (tmp_path / "a.yaml").write_text(text)
    toolpath = build_toolpath(load_problem(tmp_path / "a.yaml"))
    note = next(note for note in toolpath.notes if "left out" in note)
    assert "too narrow for a bead (number 1" in note and len(toolpath.left_out) > 0
    lowest = min(bead.layer for bead in toolpath.beads)
    assert lowest > 0
    # the body for collisions stands beneath the lowest layer that is there
    assert {bead.layer for bead in toolpath.lowest} == {lowest}
    under = print_body(toolpath)
    assert under.name_of(int(np.argmin(under.tree.points[:, 2]))) == "part"
    strict = load_problem(tmp_path / "a.yaml", ("layers.source.leave_out_share=0",))
    with pytest.raises(InputError, match=r"is too narrow for a bead 0\.6 mm wide, first in layer 1"):
        build_toolpath(strict)


@pytest.mark.slow
def test_too_much_that_is_too_narrow_is_refused(tmp_path: Path) -> None:
    """A plate of 8 mm with a fin of 0.4 mm: printed without the fin only where that is said."""
    facets = boxes(((8.0, 8.0, 2.0), (0, 0, 1)), ((0.4, 8.0, 6.0), (0, 0, 5)))
    write(tmp_path / "block.stl", facets)
    (tmp_path / "a.yaml").write_text(PROBLEM.format(more="  upper: {z_mm: 8}"))
    with pytest.raises(InputError, match="too narrow for a bead") as caught:
        build_toolpath(load_problem(tmp_path / "a.yaml"))
    share = str(caught.value).rpartition("leave_out_share: ")[2].split()[0]
    toolpath = build_toolpath(load_problem(tmp_path / "a.yaml", (f"layers.source.leave_out_share={share}",)))
    assert max(bead.layer for bead in toolpath.beads) == 3
    assert "12 layers too narrow for a bead" in " ".join(toolpath.notes)


def laid(tmp_path: Path, facets: Array, *settings: str) -> Toolpath:
    """The toolpath of a body of facets [mm], in level layers."""
    write(tmp_path / "block.stl", facets)
    top = float(facets[..., 2].max())
    (tmp_path / "a.yaml").write_text(PROBLEM.format(more=f"  upper: {{z_mm: {top:.3f}}}"))
    return build_toolpath(load_problem(tmp_path / "a.yaml", settings))


def same_beads(one: Toolpath, other: Toolpath) -> bool:
    return len(one.beads) == len(other.beads) and all(
        np.array_equal(a.points, b.points) for a, b in zip(one.beads, other.beads, strict=True)
    )


@pytest.mark.slow
def test_facets_that_face_the_other_way_are_turned_and_told(tmp_path: Path) -> None:
    facets = boxes((SIDE, (0, 0, 3)))
    right = laid(tmp_path, facets)
    facets[[3, 7]] = facets[[3, 7], ::-1]
    turned = laid(tmp_path, facets)
    assert turned.notes[0] == "block.stl: 2 facets turned round to face as their neighbours do"
    assert turned.notes[1:] == right.notes and same_beads(turned, right)


@pytest.mark.slow
def test_a_small_hole_is_closed_and_told_a_wide_one_refused_with_what_would_do(tmp_path: Path) -> None:
    """A triangle of 1 by 0.67 mm is missing, 4 times its area over its rim wide; then a strip of 1 by 8 mm."""
    facets = block(flat(3.0))
    whole = laid(tmp_path, facets)
    closed = laid(tmp_path, np.delete(facets, 40, axis=0))
    assert closed.notes[0] == "block.stl: 1 hole closed, 0.465 mm wide at most, 0.11% of its surface"
    assert same_beads(closed, whole)
    strip = np.delete(facets, [*range(12), *range(len(facets) // 2, len(facets) // 2 + 12)], axis=0)
    told = r"is not closed: 1 hole wider than 0\.6 mm, 1\.78 mm around x -5\.50, y 0\.00, z 0\.00 mm"
    with pytest.raises(InputError, match=told) as caught:
        laid(tmp_path, strip)
    setting = "layers.source.close_holes_mm"
    enough = str(caught.value).partition(f"{setting}: ")[2].split()[0]
    assert same_beads(laid(tmp_path, strip, f"{setting}={enough}"), whole)
    with pytest.raises(InputError, match=r"21\.4% of its surface would be closed holes, more than 5%.* 0\.47 closes"):
        laid(tmp_path, facets[200:])
    with pytest.raises(InputError, match=r"1 hole wider than 0\.4 mm"):
        laid(tmp_path, np.delete(facets, 40, axis=0), f"{setting}=0.4")


def test_a_surface_and_what_has_one_side_are_no_bodies(tmp_path: Path) -> None:
    facets = block(flat(3.0))
    top = facets[(facets[:, :, 2] == 3.0).all(axis=1)]
    with pytest.raises(InputError, match="is not closed: 1 hole wider") as caught:
        laid(tmp_path, top)
    assert "a surface is not a body: print on it as part.mesh" in str(caught.value)
    assert "close_holes_mm" not in str(caught.value)
    with pytest.raises(InputError, match=r"has facets that face opposite ways .* only one side"):
        laid(tmp_path, one_sided())


def test_a_body_that_hangs_in_the_air_is_named(tmp_path: Path) -> None:
    facets = boxes(((8.0, 8.0, 2.0), (0, 0, 1)), ((8.0, 8.0, 2.0), (0, 0, 5)))
    with pytest.raises(InputError, match=r"block\.stl has nothing in layer 5: what is above hangs in the air"):
        laid(tmp_path, facets)


def one_sided() -> Array:
    """Facets (n, 3, 3) [mm] of a Moebius strip 10 mm wide around a circle of 10 mm radius."""
    turn = np.linspace(0.0, 2.0 * np.pi, 41)
    rims = []
    for side in (-5.0, 5.0):
        away = 10.0 + side * np.cos(0.5 * turn)
        rims.append(np.column_stack([away * np.cos(turn), away * np.sin(turn), 6.0 + side * np.sin(0.5 * turn)]))
    one, other = np.round(rims, 9)
    a, b, c, d = one[:-1], one[1:], other[1:], other[:-1]
    return np.concatenate([np.stack(each, axis=1) for each in ((a, b, c), (a, c, d))])


def test_what_begins_in_the_air_beside_the_body_is_told_of(tmp_path: Path) -> None:
    """A loose piece from 3 to 5 mm: layers are 0.5 mm high, the middle of the seventh is at 3.25 mm."""
    loose = built(tmp_path, boxes((SIDE, (0.0, 0.0, 3.0)), ((6.0, 6.0, 2.0), (20.0, 0.0, 4.0))), "  upper: {z_mm: 6}")
    note = "block.stl: nothing is beneath 1 place in layer 7 at x 20.0, y "
    assert sum(each.startswith(note) for each in loose.notes) == 1
    assert not any("beneath" in each for each in ring().notes)


def test_a_body_that_begins_above_the_bed_is_told_of(tmp_path: Path) -> None:
    toolpath = built(tmp_path, block(flat(7.0), foot=4.0))
    assert toolpath.notes[-1] == (
        "block.stl: begins 4.000 mm above the bed (z = 0), and layers.lower names nothing beneath it; "
        "layers.source.origin_mm: [0, 0, -4] stands it on the bed"
    )
    lower = built(tmp_path, block(flat(7.0), foot=4.0), "  lower: {z_mm: 4}")
    assert lower.notes == toolpath.notes[:-1]


def test_a_top_that_is_steep_everywhere_is_refused(tmp_path: Path) -> None:
    steep = block(lambda x, y: 50.0 + 8.0 * x)  # 83 degrees
    with pytest.raises(InputError, match=r"no layer can lie on .* block\.stl: .* steeper than 80 deg"):
        built(tmp_path, steep)
