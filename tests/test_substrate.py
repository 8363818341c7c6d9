"""Plane curves projected onto a ball or a mesh: patterns, surfaces, layers, and what is refused."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import cKDTree
from solved import solve_alone

from benchmarks.orientation import angles, published_axes
from benchmarks.orientation import main as orientation
from planner.base.arrays import Array
from planner.base.errors import InputError
from planner.planning.solve_command import main
from planner.problem import Problem, load_problem
from planner.problem.drawings import PatternSpec
from planner.toolpath.build import build_toolpath
from planner.toolpath.plane_paths import densify
from planner.toolpath.substrate.bodies import Ball
from planner.toolpath.substrate.mesh_surface import FacetTree, fit
from planner.toolpath.substrate.mesh_top import FARTHEST_FROM_FACETS, MeshTop, TooRoughMesh, reach_beside
from planner.toolpath.substrate.patterns import NoPattern, pattern
from planner.toolpath.substrate.projection import Substrate, beneath_turned, nothing_falls

PUBLISHED = Path(__file__).resolve().parents[2] / "shared" / "data" / "bristol" / "printbed_hemisphere.stl"
COARSE = ("layers.count=1", "resolve.rung_mm=10", "resolve.roll_step_deg=30")
DOME = Ball(0.05, np.array([0.0, 0.0, -0.02]))
SHAPES = ("honeycomb", "zigzag", "squares", "concentric")


def spec(name: str, cell: float, size: tuple[float, float], outline: str = "rectangle") -> PatternSpec:
    return PatternSpec.model_construct(pattern=name, cell=cell, size=size, outline=outline)


def dome(folder: Path, *changes: str, name: str = "dome.stl", ascii_: bool = False, faces: int = 4) -> Problem:
    """The shipped problem on a mesh of its dome, with facets of some 3 mm."""
    ball = trimesh.creation.icosphere(subdivisions=faces, radius=50.0)
    ball.apply_translation([10.0, 20.0, 0.0])
    data = ball.export(file_type="stl_ascii" if ascii_ else "stl")
    (folder / name).write_bytes(data.encode() if isinstance(data, str) else data)
    return load_problem("hemisphere_honeycomb", (*on_mesh(folder / name), *changes))


def on_mesh(path: Path, more: str = "origin_mm: [-10, -20, -20]") -> tuple[str, ...]:
    return ("part.sphere=null", f'part.mesh={{file: "{path}", {more}}}')


# Patterns


@pytest.mark.slow
@settings(max_examples=60)
@given(
    st.sampled_from(SHAPES),
    st.floats(3e-3, 9e-3),
    st.tuples(st.floats(20e-3, 60e-3), st.floats(20e-3, 60e-3)),
    st.sampled_from(("rectangle", "ellipse")),
)
def test_patterns_stay_in_their_outline_and_keep_their_distance(
    name: str, cell: float, size: tuple[float, float], outline: str
) -> None:
    width = 0.6e-3
    try:
        paths = pattern(spec(name, cell, size, outline), width, 1e-5)
    except NoPattern:
        assert outline == "ellipse" and 3.0 * cell > min(size)
        return
    points = np.vstack([path.points for path in paths])
    half = 0.5 * np.asarray(size)
    share = ((points / half) ** 2).sum(axis=1) if outline == "ellipse" else np.abs(points / half).max(axis=1)
    assert share.max() <= 1.0 + 1e-6
    for path in paths:
        assert path.closed == (name == "concentric")
        assert np.hypot(*np.diff(path.points, axis=0).T).min() > 1e-6
    if name in ("honeycomb", "concentric") and len(paths) > 1:
        dense = [densify(path.points) for path in paths]
        for i, own in enumerate(dense):
            others = np.vstack(dense[:i] + dense[i + 1 :])
            least = width if name == "honeycomb" else 0.9 * cell * min(size) / max(size)
            assert cKDTree(others).query(own)[0].min() >= 0.999 * least


def test_a_honeycomb_has_the_walls_of_its_cells_in_few_lines() -> None:
    """Around the middle of each cell six walls, half a cell away but for the gap of double walls."""
    cell, width = 8e-3, 0.6e-3
    paths = pattern(spec("honeycomb", cell, (60e-3, 60e-3), "ellipse"), width, 1e-5)
    dense = np.vstack([densify(path.points) for path in paths])
    side = cell / np.sqrt(3.0)
    cells = 0
    for i in range(-1, 2):
        for k in range(-1, 2):
            centre = np.array([1.5 * side * i, cell * (k + 0.5 * (i % 2))])
            away = np.linalg.norm(dense - centre, axis=1)
            assert away.min() >= 0.5 * cell - 0.5 * width - 1e-9
            angle = np.arctan2(*(dense - centre)[away < 0.6 * cell][:, ::-1].T)
            assert set(np.round(np.degrees(angle) / 30).astype(int) % 12) == set(range(12))
            cells += 1
    assert cells == 9
    assert len(paths) == 14  # two ribbons for each row of cells and one more


def test_squares_have_each_edge_once() -> None:
    paths = pattern(spec("squares", 5e-3, (20e-3, 15e-3)), 0.6e-3, 1e-5)
    length = sum(np.hypot(*np.diff(path.points, axis=0).T).sum() for path in paths)
    assert len(paths) == 4 + 5
    assert length == pytest.approx(4 * 20e-3 + 5 * 15e-3)


def test_a_zigzag_is_one_line() -> None:
    (path,) = pattern(spec("zigzag", 5e-3, (20e-3, 15e-3)), 0.6e-3, 1e-5)
    length = np.hypot(*np.diff(path.points, axis=0).T).sum()
    assert length == pytest.approx(4 * 20e-3 + 3 * 5e-3)


# Surfaces


def test_facet_tree_agrees_with_every_facet() -> None:
    rng = np.random.default_rng(3)
    corners = rng.normal(size=(200, 1, 3)) + 0.3 * rng.normal(size=(200, 3, 3))
    tree = FacetTree.of(corners)
    points = 2.0 * rng.normal(size=(300, 3))
    inside = np.full(len(points), np.inf)
    top = np.full(len(points), -np.inf)
    for a, b, c in corners:
        normal = np.cross(b - a, c - a)
        normal /= np.linalg.norm(normal)
        height = (points - a) @ normal
        foot = points - height[:, None] * normal
        over = np.all([np.cross(q - p, foot - p) @ normal >= 0.0 for p, q in ((a, b), (b, c), (c, a))], axis=0)
        gap = np.where(over, np.abs(height), np.inf)
        for p, q in ((a, b), (b, c), (c, a)):
            t = np.clip((points - p) @ (q - p) / ((q - p) @ (q - p)), 0.0, 1.0)
            gap = np.minimum(gap, np.linalg.norm(points - p - t[:, None] * (q - p), axis=1))
        inside = np.minimum(inside, gap)
        if normal[2] > 1e-6:
            z = a[2] - ((points[:, :2] - a[:2]) @ normal[:2]) / normal[2]
            at = np.column_stack([points[:, :2], z])
            hit = np.all([np.cross(q - p, at - p) @ normal >= 0.0 for p, q in ((a, b), (b, c), (c, a))], axis=0)
            top = np.where(hit, np.maximum(top, z), top)
    np.testing.assert_allclose(tree.distance(points), inside, atol=1e-12)
    z, found = tree.top(points[:, :2])
    assert 40 < (found >= 0).sum() < 300
    np.testing.assert_allclose(np.where(found >= 0, z, -np.inf), top, atol=1e-9)


def test_height_field_is_exact_for_what_it_can_be() -> None:
    rng = np.random.default_rng(5)
    plane = rng.uniform(-0.02, 0.03, (4000, 2))

    def height(p: Array) -> Array:
        return 0.01 + 0.2 * p[:, 0] - 0.1 * p[:, 1] + 8.0 * p[:, 0] * p[:, 1] - 5.0 * p[:, 1] ** 2

    field = fit(np.column_stack([plane, height(plane)]), np.ones(len(plane)), np.full(2, -0.02), np.full(2, 0.03), 0.01)
    points, normals = field.at(plane)
    np.testing.assert_allclose(points[:, 2], height(plane), atol=1e-9)
    slope = np.column_stack([-(0.2 + 8.0 * plane[:, 1]), -(-0.1 + 8.0 * plane[:, 0] - 10.0 * plane[:, 1])])
    np.testing.assert_allclose(normals[:, :2] / normals[:, 2:], slope, atol=1e-7)
    inner = (np.abs(plane - 0.005) < 0.02).all(axis=1)
    np.testing.assert_allclose(field.nearest((points + 0.002 * normals)[inner]), plane[inner], atol=1e-9)


def mesh_of_dome(subdivisions: int = 4) -> FacetTree:
    ball = trimesh.creation.icosphere(subdivisions=subdivisions, radius=0.05)
    return FacetTree.of(np.asarray(ball.triangles) + DOME.centre)


@pytest.mark.slow
def test_the_smooth_surface_of_a_mesh_is_calm_and_near() -> None:
    """Facets turn the normal by 3 degrees at a time; the surface turns with the ball that their corners stand on."""
    facets = mesh_of_dome()
    x = np.linspace(-0.03, 0.03, 3001)
    line = np.column_stack([x, 0.3 * x + 0.001])
    body = MeshTop.near(facets, line, reach_beside(facets, line, 1.2e-3))
    assert body.gap <= 6e-5 and body.why == "coarse"
    points, normals = body.at(line)
    assert np.abs(body.signed_distance(points)).max() <= body.gap * 1.001
    assert np.abs(DOME.signed_distance(points)).max() <= 5e-6
    turned = np.degrees(np.linalg.norm(np.cross(normals, DOME.normals(points)), axis=1))
    assert turned.max() <= 0.05
    found = facets.top(line)[1]
    jump = np.degrees(np.linalg.norm(np.diff(facets.normals[found], axis=0), axis=1))
    assert jump.max() > 2.0
    step = np.degrees(np.linalg.norm(np.diff(normals, axis=0), axis=1))
    ball = np.degrees(np.linalg.norm(np.diff(DOME.at(line)[1], axis=0), axis=1))
    assert (step / ball).max() <= 1.1
    above = points + 0.001 * normals
    np.testing.assert_allclose(body.normals(above), normals, atol=1e-9)


def test_an_edge_has_no_smooth_surface() -> None:
    x = np.linspace(-0.02, 0.02, 401)
    box = trimesh.creation.box([0.05, 0.05, 0.02])
    roof = trimesh.creation.box([0.05, 0.05, 0.02])
    roof.apply_transform(trimesh.transformations.rotation_matrix(np.pi / 4, [0, 1, 0]))
    line = np.column_stack([x, np.zeros(len(x))])
    flat = MeshTop.near(FacetTree.of(np.asarray(box.triangles)), line, 5e-3)
    assert flat.gap <= 1e-9
    with pytest.raises(TooRoughMesh) as caught:
        MeshTop.near(FacetTree.of(np.asarray(roof.triangles)), line, 5e-3)
    assert caught.value.gap > FARTHEST_FROM_FACETS


@pytest.mark.slow
def test_distances_of_a_mesh_are_quick_and_signed() -> None:
    rng = np.random.default_rng(2)
    away = rng.normal(size=(20_000, 3))
    away /= np.linalg.norm(away, axis=1)[:, None]
    away[:, 2] = np.abs(away[:, 2])
    radius = rng.uniform(0.03, 0.09, len(away))
    points = DOME.centre + away * radius[:, None]
    body = MeshTop.near(mesh_of_dome(), np.zeros((1, 2)) + np.linspace(-1e-2, 1e-2, 100)[:, None], 3e-3)
    np.testing.assert_allclose(body.signed_distance(points), radius - 0.05, atol=6e-5)


# Layers


@pytest.mark.slow
@pytest.mark.parametrize("mesh", [False, True])
@pytest.mark.parametrize("offset", ["normal", "z"])
def test_layers_lie_on_each_other(tmp_path: Path, mesh: bool, offset: str) -> None:
    changes = (f"layers.offset={offset}", "layers.count=3", "layers.source.cell_mm=10")
    problem = dome(tmp_path, *changes) if mesh else load_problem("hemisphere_honeycomb", changes)
    toolpath = build_toolpath(problem)
    assert toolpath.layers == 3
    spacing = 0.5e-3
    for i, bead in enumerate(toolpath.beads):
        surface = toolpath.surface.before(i + 1)
        gap = surface.signed_distance(bead.points)
        steep = bead.normals[:, 2] if offset == "z" else np.ones(len(bead.s))
        rough = 6e-5 if mesh else 5e-6 if offset == "z" else 1e-9  # 0.5 mm above a ball moved upwards is not on a ball
        np.testing.assert_allclose(gap, spacing * steep, atol=rough)
        np.testing.assert_allclose(bead.height, spacing * steep)
        np.testing.assert_allclose(surface.normals(bead.points), bead.normals, atol=1e-8)
        np.testing.assert_allclose(np.linalg.norm(bead.normals, axis=1), 1.0)
        assert np.abs((bead.roll_zero * bead.normals).sum(axis=1)).max() < 1e-9
    if offset == "normal":  # the spacing along the normal, from bead to bead
        one, two = (np.vstack([b.points for b in toolpath.beads if b.layer == k]) for k in (1, 2))
        between, _ = cKDTree(one).query(two)
        assert between.min() >= 0.98 * spacing
        normals = np.vstack([b.normals for b in toolpath.beads if b.layer == 2])
        assert np.percentile(cKDTree(one).query(two - spacing * normals)[0], 99) <= 0.02 * spacing


def test_beads_of_neighbouring_ribbons_do_not_overlap() -> None:
    toolpath = build_toolpath(load_problem("hemisphere_honeycomb", ("layers.count=1",)))
    width = float(toolpath.beads[0].width[0])
    for i, bead in enumerate(toolpath.beads):
        others = np.vstack([b.points for k, b in enumerate(toolpath.beads) if k != i])
        assert cKDTree(others).query(bead.points)[0].min() >= 0.98 * width


def test_corners_are_rounded_within_the_tolerance_on_the_surface() -> None:
    """The plane's tolerance shrinks where the surface is steep; it is used, but not exceeded, in all layers."""
    size = ("layers.source.size_mm=[70, 70]", "layers.count=2")
    toolpath = build_toolpath(load_problem("hemisphere_honeycomb", size))
    worst = [cKDTree(bead.source).query(bead.points)[0].max() for bead in toolpath.beads]
    assert 0.15e-3 <= max(worst) <= 0.2e-3
    assert min(bead.normals[:, 2].min() for bead in toolpath.beads) < 0.75


@pytest.mark.slow
def test_layers_that_fold_are_refused(tmp_path: Path) -> None:
    """A bowl of 12 mm radius has no layers 12 mm above it."""
    bowl = trimesh.creation.icosphere(subdivisions=5, radius=12.0)
    up = bowl.copy()
    up.update_faces(bowl.triangles_center[:, 2] < -1.0)
    up.invert()
    (tmp_path / "bowl.stl").write_bytes(up.export(file_type="stl"))
    size = ("layers.source={pattern: zigzag, cell_mm: 3, size_mm: [10, 10]}", "process.bead.height_mm=0.5")
    few = load_problem("hemisphere_honeycomb", (*on_mesh(tmp_path / "bowl.stl", "origin_mm: [0, 0, 0]"), *size))
    assert build_toolpath(few).layers == 3
    many = load_problem(
        "hemisphere_honeycomb",
        (*on_mesh(tmp_path / "bowl.stl", "origin_mm: [0, 0, 0]"), *size, "layers.count=23"),
    )
    with pytest.raises(InputError, match="layers would fold"):
        build_toolpath(many)


def test_the_surface_grows_with_the_layers() -> None:
    body = Substrate(DOME, 0.5e-3, False, (0, 0, 1, 2))
    points = np.array([[0.0, 0.0, 0.04]])
    found = [float(body.before(i).signed_distance(points)[0]) for i in range(5)]
    np.testing.assert_allclose(found, [0.01, 0.01, 0.01, 0.0095, 0.009])


@pytest.mark.slow
def test_a_pattern_may_reach_to_the_edge(tmp_path: Path) -> None:
    """A zig-zag over all of a slab's top; turns that would swing over the edge are cut, and that is more than may be."""
    slab = trimesh.creation.box([40.0, 40.0, 20.0])
    (tmp_path / "slab.stl").write_bytes(slab.export(file_type="stl"))
    mesh = on_mesh(tmp_path / "slab.stl", "origin_mm: [0, 0, 10]")
    for pattern_name, side, fits in (("squares", 40, True), ("zigzag", 39, True), ("zigzag", 40, False)):
        source = f"layers.source={{pattern: {pattern_name}, cell_mm: 5, size_mm: [{side}, {side}]}}"
        problem = load_problem("hemisphere_honeycomb", (*mesh, source, "layers.count=1"))
        if fits:
            points = np.vstack([bead.points for bead in build_toolpath(problem).beads])
            np.testing.assert_allclose(points[:, 2], 20.5e-3, atol=1e-9)
            continue
        with pytest.raises(InputError, match=r"leave_out_share: 0\.18 leaves out what cannot be printed"):
            build_toolpath(problem)


# Files


@pytest.mark.slow
@pytest.mark.parametrize("ascii_", [False, True])
def test_text_and_binary_files_are_read(tmp_path: Path, ascii_: bool) -> None:
    toolpath = build_toolpath(dome(tmp_path, "layers.count=1", ascii_=ascii_))
    points = np.vstack([bead.points for bead in toolpath.beads])
    assert np.abs(DOME.signed_distance(points) - 0.5e-3).max() <= 6e-5


def damaged(data: bytes, text: bytes) -> dict[str, tuple[bytes, str]]:
    """Files that are none, and what is said of them."""
    ball = trimesh.creation.icosphere(subdivisions=2, radius=50.0)
    inside_out = ball.copy()
    inside_out.invert()
    far = ball.copy()
    far.apply_scale(1e7)
    cap = ball.copy()
    cap.update_faces(ball.triangles_center[:, 2] < 30.0)
    flat = np.frombuffer(data[84:], dtype=np.uint8).reshape(-1, 50).copy()
    flat[:, 24:36] = flat[:, 12:24]  # the second corner is the first
    nan = bytearray(data)
    nan[84 + 12 : 84 + 16] = np.float32("nan").tobytes()
    huge = bytearray(data[:84])
    huge[80:84] = np.uint32(10_000_000).tobytes()
    return {
        "empty": (b"", "is not an STL file: it has 0 bytes"),
        "short": (b"solid x", "holds no facets"),
        "no facets": (bytes(80) + np.uint32(0).tobytes(), "holds no facets"),
        "no facets in words": (b"solid x\nendsolid x\n" + b" " * 80, "not an STL file|holds no facets"),
        "cut": (data[:-30], "announces 320 facets but has room for 319"),
        "cut text": (text[: len(text) // 2], "is damaged"),
        "words for numbers": (text.replace(b"vertex ", b"vertex x", 3), "is damaged"),
        "not a file of facets": (b"<svg/>" * 100, "is not an STL file, or is damaged"),
        "lines": (data[:84] + flat.tobytes(), "no facet with an area"),
        "nan": (bytes(nan), "a corner that is not a number"),
        "far": (far.export(file_type="stl"), "farther than"),
        "inside out": (inside_out.export(file_type="stl"), "inside out"),
        "open": (cap.export(file_type="stl"), "no curve falls onto|leaves the part"),
        "too many": (bytes(huge), "announces 10000000 facets but has room for 0"),
    }


@pytest.mark.parametrize("name", list(damaged(bytes(84 + 50), b"")))
def test_bad_files_are_refused(tmp_path: Path, name: str) -> None:
    ball = trimesh.creation.icosphere(subdivisions=2, radius=50.0)
    text = ball.export(file_type="stl_ascii")
    content, said = damaged(ball.export(file_type="stl"), text.encode())[name]
    (tmp_path / "bad.stl").write_bytes(content)
    problem = load_problem("hemisphere_honeycomb", on_mesh(tmp_path / "bad.stl", "origin_mm: [0, 0, -20]"))
    with pytest.raises(InputError, match=said) as caught:
        build_toolpath(problem)
    assert caught.value.exit_code == 2


@pytest.mark.slow
def test_facets_that_stand_there_twice_or_have_no_area_change_nothing(tmp_path: Path) -> None:
    ball = trimesh.creation.icosphere(subdivisions=4, radius=50.0)
    faces = ball.faces[[*range(len(ball.faces)), *range(0, len(ball.faces), 3)]]
    faces = np.vstack([faces, np.repeat(np.arange(7)[:, None], 3, axis=1)])
    beads = []
    for name, mesh in (("once", ball), ("twice", trimesh.Trimesh(ball.vertices, faces, process=False))):
        (tmp_path / f"{name}.stl").write_bytes(mesh.export(file_type="stl"))
        changes = on_mesh(tmp_path / f"{name}.stl", "origin_mm: [0, 0, -20]")
        beads.append(build_toolpath(load_problem("hemisphere_honeycomb", [*changes, "layers.count=1"])).beads)
    assert len(beads[0]) == len(beads[1])
    for once, twice in zip(*beads, strict=True):
        assert np.allclose(once.points, twice.points, atol=1e-9)


def test_a_mesh_of_too_many_facets_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("planner.problem.mesh_files.MOST_FACETS", 1000)
    with pytest.raises(InputError, match="has 5120 facets"):
        build_toolpath(dome(tmp_path))


BAD = (
    (("layers.centre_mm=[300, 0]",), "layers.centre_mm", "no curve falls onto the part"),
    (("layers.centre_mm=[40, 0]",), "layers.source", "leaves the part|comes to a wall"),
    (("layers.source.size_mm=[99.9, 99.9]",), "layers.source", "comes to a wall of 7|leaves the part"),
    (("layers.source.size_mm=[5, 5]",), "layers.source.cell_mm", "no cell of 8 mm fits into 5 x 5 mm"),
    (("layers.source.cell_mm=2",), "layers.source.cell_mm", "narrower than"),
    (("layers.source.cell_mm=0.1", "layers.source.pattern=zigzag", "layers.source.size_mm=[90, 90]"),) * 1
    + ("layers.source.cell_mm", "more than 100000 cells"),
)


@pytest.mark.slow(cases=("changes2*",))
@pytest.mark.parametrize(("changes", "field", "said"), BAD)
def test_curves_that_do_not_fit_are_refused(changes: tuple[str, ...], field: str, said: str) -> None:
    with pytest.raises(InputError, match=said) as caught:
        build_toolpath(load_problem("hemisphere_honeycomb", changes))
    assert str(caught.value.field).endswith(field)


UNKNOWN = (
    ("layers.source.pattern=honycomb", "layers.source.pattern", "did you mean honeycomb"),
    ("layers.source.cel_mm=3", "layers.source.cel_mm", "did you mean cell_mm"),
    ("layers.project=x", "layers.project", "choices: z"),
    ("layers.offset=up", "layers.offset", "choices: normal, z"),
    ("layers.ofset=z", "layers.ofset", "did you mean offset"),
    ("layers.source.svg=a.svg", "layers.source.svg", "both svg and pattern are given"),
    ("part.cylinder={radius_mm: 3, height_mm: 5}", "part.cylinder", "both cylinder and sphere are given"),
    ("part={cylinder: {radius_mm: 3, height_mm: 5}}", "part.cylinder", "layers.project and a cylinder do not go"),
    ("part={}", "part", "no body is given"),
    ("part=null", "part", "is missing"),
    ("part.sphere.radius=3", "part.sphere.radius", "did you mean radius_mm"),
    ("layers.wrap=cylinder", "layers.wrap", "unknown key"),
)


@pytest.mark.parametrize(("change", "field", "said"), UNKNOWN)
def test_mistakes_are_told(change: str, field: str, said: str) -> None:
    with pytest.raises(InputError) as caught:
        load_problem("hemisphere_honeycomb", (change,))
    assert str(caught.value.field).endswith(field)
    assert said in str(caught.value)


def test_a_drawing_is_not_wrapped_around_a_ball() -> None:
    with pytest.raises(InputError, match=r"layers\.wrap and a sphere do not go together"):
        load_problem("cylinder_logo", ("part={sphere: {radius_mm: 30}}",))


def test_a_body_that_is_inside_out_on_another_is_refused(tmp_path: Path) -> None:
    """As one that was mirrored: its underside, which faces upwards, would be printed on."""
    slab, lump = trimesh.creation.box((90.0, 90.0, 5.0)), trimesh.creation.box((70.0, 70.0, 6.0))
    lump.apply_translation([0.0, 0.0, 5.5])
    right = FacetTree.of(np.concatenate([slab.triangles, lump.triangles]) * 1e-3)
    lump.invert()
    wrong = FacetTree.of(np.concatenate([slab.triangles, lump.triangles]) * 1e-3)
    plane = np.array([[0.001, 0.002], [0.04, 0.001]])
    assert beneath_turned(wrong, plane).tolist() == [True, False] and not beneath_turned(right, plane).any()
    trimesh.util.concatenate([slab, lump]).export(tmp_path / "two.stl")
    with pytest.raises(InputError, match=r"a body in two\.stl is inside out"):
        build_toolpath(load_problem("hemisphere_honeycomb", on_mesh(tmp_path / "two.stl", "scale: 1")))


def test_curves_beside_the_part_are_told_where_both_are() -> None:
    problem = load_problem("hemisphere_honeycomb", ["layers.centre_mm=[5, 0]"])
    curves, body = np.array([[0.0, 0.0], [0.01, 0.02]]), np.array([[0.9, 1.0], [1.1, 1.2]])
    said = str(nothing_falls(problem, "part", curves, body))
    assert "they lie at x 0.0 to 10.0, y 0.0 to 20.0 mm, the part at x 900.0 to 1100.0, y 1000.0 to 1200.0 mm" in said
    assert "layers.centre_mm: [1000.0, 1090.0] brings their middle" in said


def test_the_command_ends_with_two(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    bad = ["hemisphere_honeycomb", "--set", "layers.centre_mm=[300, 0]", "--out", str(tmp_path)]
    assert main(bad) == 2
    assert "no curve falls onto the part" in capsys.readouterr().err


# Whole prints


@pytest.mark.slow
@pytest.mark.parametrize("name", SHAPES[1:])
def test_patterns_are_solved(name: str) -> None:
    small = ("layers.source.size_mm=[24, 24]", f"layers.source.pattern={name}")
    plan = solve_alone(load_problem("hemisphere_honeycomb", (*COARSE, *small)), "ladder")
    assert plan.verified, [check for check in plan.checks if not check.ok]


@pytest.mark.slow
@pytest.mark.parametrize("offset", ["normal", "z"])
def test_a_mesh_is_solved(tmp_path: Path, offset: str) -> None:
    changes = (*COARSE, "layers.count=2", "layers.source.size_mm=[30, 30]", f"layers.offset={offset}")
    plan = solve_alone(dome(tmp_path, *changes), "ladder")
    assert plan.verified, [check for check in plan.checks if not check.ok]
    assert plan.metrics["at_speed_fraction"] > 0.9


def test_a_drawing_is_projected(drawing: Callable[..., Problem]) -> None:
    path = drawing('<path d="M0,0 L20,0 L20,10"/>', 20).layers.source.svg
    changes = (f"layers.source={{svg: {path}, width_mm: 20}}", "layers.turn_deg=90")
    toolpath = build_toolpath(load_problem("hemisphere_honeycomb", (*COARSE, *changes)))
    (bead,) = toolpath.beads
    np.testing.assert_allclose(np.ptp(bead.points[:, :2], axis=0), [10e-3, 20e-3], rtol=0.03)


@pytest.mark.slow
@pytest.mark.skipif(not PUBLISHED.exists(), reason="the authors' mesh is not part of the project")
def test_the_published_mesh_is_solved() -> None:
    """The dome as its authors published it, y up: the ball of the shipped problem, to the facets' accuracy."""
    mesh = on_mesh(PUBLISHED, "rpy_deg: [90, 0, 0], origin_mm: [45, -45, 0]")
    plan = solve_alone(load_problem("hemisphere_honeycomb", (*COARSE, *mesh)), "ladder")
    assert plan.verified, [check for check in plan.checks if not check.ok]
    points = np.vstack([bead.points for bead in plan.toolpath.beads])
    normals = np.vstack([bead.normals for bead in plan.toolpath.beads])
    assert np.abs(DOME.signed_distance(points) - 0.5e-3).max() <= 5e-5
    assert np.degrees(np.linalg.norm(np.cross(normals, DOME.normals(points)), axis=1)).max() <= 0.3


# The published way of directing the nozzle


def test_equation_3_is_exact_only_on_two_great_circles() -> None:
    lean = np.radians(np.array([-50.0, -20.0, 0.0, 35.0]))
    none = np.zeros(4)
    for along in ([np.sin(lean), none, np.cos(lean)], [none, np.sin(lean), np.cos(lean)]):
        normals = np.column_stack(along)
        np.testing.assert_allclose(published_axes(normals), -normals, atol=1e-12)
    normals = DOME.at(np.array([[0.02, 0.02], [0.03, -0.02]]))[1]
    off = angles(published_axes(normals), -normals)
    # by hand for the first: n = (0.4, 0.4, 0.8246), whose projections lean by 25.88 degrees each
    s = 0.4 / np.hypot(0.4, normals[0, 2])
    axis = -np.array([s * np.sqrt(1 - s**2), s, 1 - s**2])
    assert off[0] == pytest.approx(np.degrees(np.arccos(-axis @ normals[0])), abs=1e-6)
    assert (off > 1.0).all()


@pytest.mark.slow
def test_the_orientation_benchmark_tells_both(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert orientation([]) == 0
    assert "equation (3)" in capsys.readouterr().out
    dome(tmp_path)
    changes = [word for change in on_mesh(tmp_path / "dome.stl") for word in ("--set", change)]
    assert orientation(changes) == 0
    assert "jump of the normal" in capsys.readouterr().out
    assert orientation(["--set", "layers.centre_mm=[300, 0]"]) == 2
