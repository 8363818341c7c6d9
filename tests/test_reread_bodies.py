"""Wings, cores, filled meshes and STEP faces, read again: true prints pass, and whatever strays from the input fails.

Most of what is spoilt is printed from another input, and judged by the true one: another chord, sweep, height, face.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from planner.base.arrays import Array
from planner.base.errors import InputError
from planner.base.shipped import PROBLEMS
from planner.collision.print_body import print_body
from planner.problem import Problem, load_problem
from planner.problem.layers import AerofoilLayersSpec
from planner.toolpath.bead import Bead, Told, Toolpath
from planner.toolpath.build import build_toolpath
from planner.toolpath.step.files import read_step
from planner.toolpath.wing.section import root_section, tip_section
from planner.verify.reread.aerofoil import sections_of
from planner.verify.reread.facets import Facets
from tests.test_reread import BASE, failed, found

PART, NORMAL, INSIDE = "layers on the part", "nozzle normal to the part", "beads within the part"
FILLED, DENSE, DRAWN, LEFT = (
    "layers filled",
    "layers as dense as asked",
    "print on the drawn path",
    "drawn path left out",
)

TIP = "tip: {naca: '2412', chord_mm: 26, sweep_mm: 2, washout_deg: 2}"
WING = "layers: {{source: {{naca: '2415', chord_mm: 30, span_mm: 12, origin_mm: [15, 0, 6]{}}}, height_mm: 0.6{}}}\n"
CORE = (
    "part: {{mesh: {{file: mould.stl}}}}\nlayers: {{source: {{pattern: honeycomb, cell_mm: 8, size_mm: [30, 60]}}, "
    "project: z, up_to: {{z_mm: 12}}, height_mm: 0.6{}}}\n"
)
SOLID = "layers: {{source: {{mesh: {}}}, height_mm: 0.6, infill: {{density: {}}}{}}}\n"
FACES = "part: {{step: {{file: curved_plate.step}}}}\nlayers: {{source: {{faces: [{}], spacing_mm: 14, path: {}}}, count: {}, height_mm: {}}}\n"
PRINTS = {
    "wing": WING.format("", ""),
    "wing on a support": WING.format("", ", support: {length_mm: 40, height_mm: 5.4, infill: 0.5, curved: 2}"),
    "tapered wing": WING.format(f", {TIP}", ""),
    "level wing": WING.format(", method: planar", ""),
    "core": CORE.format(""),
    "core of varying layers": CORE.format(", heights: varying"),
    "core turned": CORE.format(", turn_deg: 20, centre_mm: [3, -2], halves: lower"),
    "box": SOLID.format("box.stl", 1, ", upper: {z_mm: 4}"),
    "hill": SOLID.format("hill.stl", 0.4, ", least_height_mm: 0.3"),
    "faces": FACES.format("top", "rows", 1, 2),
    "faces twice": FACES.format("top", "greedy", 2, 1),
}
WINGS = [name for name in PRINTS if "wing" in name]
CORES = [name for name in PRINTS if "core" in name]
SOLIDS = ["box", "hill"]
SHEETS = ["faces", "faces twice"]
SOME = {
    "four layers": WING.format("", ", count: 4"),
    "four layers of wing and support": WING.format(
        ", method: planar", ", count: 4, support: {length_mm: 40, height_mm: 5.4, infill: 0.5}"
    ),
    "core of four layers": CORE.format(", count: 4"),
}
FEW = ("wing",)  # of which all is tried in quick tests


def mould() -> trimesh.Trimesh:
    """A block with a trough along x, its bottom 4 mm deep: the lower surface of a core."""
    x, y = np.meshgrid(np.linspace(-25.0, 25.0, 60), np.linspace(-38.0, 38.0, 120), indexing="ij")
    return grid_body(x, y, 12.0 - 4.0 * np.cos(np.clip(np.pi * y / 70.0, -0.5 * np.pi, 0.5 * np.pi)))


def hill() -> trimesh.Trimesh:
    """A block whose top rises and falls by 1.5 mm."""
    x, y = np.meshgrid(np.linspace(-15.0, 15.0, 60), np.linspace(-10.0, 10.0, 40), indexing="ij")
    return grid_body(x, y, 4.0 + 1.5 * np.cos(0.2 * x) * np.cos(0.15 * y))


def grid_body(x: Array, y: Array, z: Array) -> trimesh.Trimesh:
    """What is under heights z (n, m) down to 0."""
    n, m = x.shape
    top = np.column_stack([x.ravel(), y.ravel(), z.ravel()])
    index = np.arange(n * m).reshape(n, m)
    a, b, c, d = index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]
    up = np.concatenate([np.stack(each, axis=-1).reshape(-1, 3) for each in ((a, b, c), (a, c, d))])
    rim = np.concatenate([index[:, 0], index[-1, 1:], index[-2::-1, -1], index[0, -2:0:-1]])
    ahead = np.roll(rim, -1)
    walls = np.concatenate(
        [np.column_stack([rim, rim + n * m, ahead]), np.column_stack([ahead, rim + n * m, ahead + n * m])]
    )
    faces = np.concatenate([up, up[:, ::-1] + n * m, walls])
    return trimesh.Trimesh(np.concatenate([top, top * [1.0, 1.0, 0.0]]), faces, process=False)


@cache
def folder() -> Path:
    import tempfile

    made = Path(tempfile.mkdtemp(prefix="bodies"))
    mould().export(made / "mould.stl")
    hill().export(made / "hill.stl")
    block = trimesh.creation.box((24.0, 16.0, 4.0))
    block.apply_translation([0.0, 0.0, 2.0])
    block.export(made / "box.stl")
    slab = trimesh.creation.box((3.3, 20.0, 2.0))
    slab.apply_translation([0.0, 0.0, 1.0])
    slab.export(made / "slab.stl")
    shutil.copy(PROBLEMS / "curved_plate.step", made)
    return made


@cache
def printed(text: str) -> tuple[Problem, Toolpath]:
    """A problem, and its toolpath."""
    base = BASE.replace("width_mm: 0.6", f"width_mm: {12 if 'step' in text else 1}")
    base = base.replace(", height_mm: 0.5", ", height_mm: 2" if "step" in text else "")
    path = folder() / f"{abs(hash(text))}.yaml"
    path.write_text(base + text)
    problem = load_problem(path)
    return problem, build_toolpath(problem)


def print_of(name: str) -> tuple[Problem, Toolpath]:
    return printed(PRINTS[name])


def judged_as(name: str, other: str) -> set[str]:
    """What fails where the print of another text is judged by the problem of this name."""
    return failed(found(print_of(name)[0], printed(other)[1]))


def moved(
    toolpath: Toolpath, by: Callable[[Array], Array], normals: Callable[[Array], Array] = lambda n: n
) -> list[Bead]:
    return [replace(bead, points=by(bead.points), normals=normals(np.array(bead.normals))) for bead in toolpath.beads]


@pytest.mark.slow(keep=("level wing", "box"))
@pytest.mark.parametrize("name", PRINTS)
def test_a_true_print_passes_and_is_judged(name: str) -> None:
    findings = found(*print_of(name))
    assert not failed(findings), findings
    checks = {check.name for check in findings.checks}
    assert {PART, NORMAL, INSIDE} <= checks
    assert {DRAWN, LEFT} <= checks if name in CORES else FILLED in checks
    assert (DENSE in checks) == (name in SOLIDS)
    assert not [check for check in findings.checks if "not read" in check.where]


def test_a_thin_walls_round_end_lies_within_the_part_and_one_farther_out_does_not() -> None:
    """It may bulge by the corner tolerance, which is nearly half of so narrow a bead."""
    path = folder() / "slab.yaml"
    path.write_text(BASE + SOLID.format("slab.stl", 1, ", upper: {z_mm: 2}"))
    problem = load_problem(path, ["process.bead.width_mm=0.5", "layers.height_mm=0.5"])
    toolpath = build_toolpath(problem)
    end = max(bead.points[:, 1].max() for bead in toolpath.beads)
    assert problem.process.corner_tolerance == 0.2e-3
    assert end == pytest.approx(10e-3 - 0.25e-3 + 0.19e-3, abs=0.02e-3)
    assert INSIDE not in failed(found(problem, toolpath))
    farther = moved(toolpath, lambda p: p + [0.0, 0.2e-3, 0.0])
    assert INSIDE in failed(found(problem, toolpath, farther))


@pytest.mark.slow(keep=FEW)
@pytest.mark.parametrize("name", PRINTS)
def test_a_print_turned_by_five_degrees(name: str) -> None:
    problem, toolpath = print_of(name)
    turn = Rotation.from_euler("z", 5.0, degrees=True)
    middle = np.mean([bead.points.mean(axis=0) for bead in toolpath.beads], axis=0)
    beads = moved(toolpath, lambda p: turn.apply(p - middle) + middle, turn.apply)
    assert failed(found(problem, toolpath, beads)) & {PART, INSIDE, FILLED, DRAWN, LEFT}


@pytest.mark.slow(keep=FEW)
@pytest.mark.parametrize("name", PRINTS)
def test_a_print_beside_its_place(name: str) -> None:
    """By two bead widths across, or a millimetre up."""
    problem, toolpath = print_of(name)
    width = problem.process.bead.width
    for way in ([2.0 * width, 0.0, 0.0], [0.0, 2.0 * width, 0.0], [0.0, 0.0, 1e-3]):
        lost = failed(found(problem, toolpath, moved(toolpath, lambda p, way=way: p + way)))
        assert lost & {PART, INSIDE, FILLED, DRAWN, LEFT}, way


@pytest.mark.slow(keep=FEW)
@pytest.mark.parametrize("name", PRINTS)
def test_a_larger_print(name: str) -> None:
    problem, toolpath = print_of(name)
    beads = moved(toolpath, lambda p: 1.05 * p)
    assert failed(found(problem, toolpath, beads)) & {PART, INSIDE}


@pytest.mark.slow(keep=FEW)
@pytest.mark.parametrize("name", PRINTS)
def test_a_nozzle_that_leans_by_three_degrees(name: str) -> None:
    problem, toolpath = print_of(name)
    for axis in "xy":
        lean = Rotation.from_euler(axis, 3.0, degrees=True)
        assert NORMAL in failed(found(problem, toolpath, moved(toolpath, lambda p: p, lean.apply)))


@pytest.mark.slow(keep=FEW)
@pytest.mark.parametrize("name", PRINTS)
def test_layers_of_twice_the_height(name: str) -> None:
    height = "height_mm: 0.6" if "step" not in PRINTS[name] else f"height_mm: {2 if name == 'faces' else 1}"
    twice = PRINTS[name].replace(f"{height}", f"height_mm: {2 * float(height.split()[1]):g}")
    assert twice != PRINTS[name]
    assert judged_as(name, twice) & {PART, FILLED, LEFT}


@pytest.mark.slow(keep=FEW)
@pytest.mark.parametrize("name", PRINTS)
def test_lost_layers_and_beads(name: str) -> None:
    problem, toolpath = print_of(name)
    body = print_body(toolpath)
    longest = max(toolpath.beads, key=lambda bead: bead.length)
    lost = {FILLED, LEFT, DENSE}
    if len(toolpath.beads) > 1:
        fewer = [bead for bead in toolpath.beads if bead is not longest]
        assert failed(found(problem, toolpath, fewer, body)) & lost
    half = longest.s <= 0.6 * longest.length
    cut = replace(
        longest,
        **{
            field: getattr(longest, field)[half] for field in ("s", "points", "normals", "width", "height", "roll_zero")
        },
    )
    beads = [cut if bead is longest else bead for bead in toolpath.beads]
    assert failed(found(problem, toolpath, beads, body)) & lost
    layers = {bead.layer for bead in toolpath.beads}
    if len(layers) > 2:
        lost_layer = sorted(layers)[len(layers) // 3]
        fewer = [bead for bead in toolpath.beads if bead.layer != lost_layer]
        assert failed(found(problem, toolpath, fewer, body)) & lost


@pytest.mark.slow(keep=("box", "core of four layers"))
@pytest.mark.parametrize("name", [*SOLIDS, *SOME])
def test_lost_last_layers(name: str) -> None:
    """Of a filled mesh, and where so many layers are asked for: those that are printed do not tell how many there are to be."""
    problem, toolpath = printed(SOME.get(name) or PRINTS[name])
    assert not failed(found(problem, toolpath))
    body, top = print_body(toolpath), max(bead.layer for bead in toolpath.beads)
    for last in (top, top - 1):
        fewer = [bead for bead in toolpath.beads if bead.layer < last]
        assert failed(found(problem, toolpath, fewer, body)) & {FILLED, LEFT}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "key", "other"),
    [
        ("wing", "chord_mm: 30", "chord_mm: 30.5"),
        ("wing", "'2415'", "'2414'"),
        ("wing", "'2415'", "'2515'"),
        ("wing", "span_mm: 12", "span_mm: 15"),
        ("wing", "[15, 0, 6]", "[15.5, 0, 6]"),
        ("tapered wing", "sweep_mm: 2", "sweep_mm: 2.5"),
        ("tapered wing", "washout_deg: 2", "washout_deg: 3"),
        ("tapered wing", "washout_deg: 2", "washout_deg: -2"),
        ("tapered wing", "chord_mm: 26", "chord_mm: 27"),
        ("tapered wing", "'2412'", "'2512'"),
        ("tapered wing", f", {TIP}", ""),
        ("wing on a support", "infill: 0.5", "infill: 0.2"),
        ("wing on a support", "curved: 2", "curved: 1"),
        ("wing on a support", "length_mm: 40", "length_mm: 46"),
        ("level wing", "chord_mm: 30", "chord_mm: 34"),
        ("core", "z_mm: 12", "z_mm: 11"),
        ("core", "cell_mm: 8", "cell_mm: 9"),
        ("core", "size_mm: [30, 60]", "size_mm: [30, 44]"),
        ("core", "halves: both", "halves: lower"),
        ("core turned", "turn_deg: 20", "turn_deg: 25"),
        ("core turned", "centre_mm: [3, -2]", "centre_mm: [4, -2]"),
        ("box", "density: 1", "density: 0.5"),
        ("box", "z_mm: 4", "z_mm: 3"),
        ("hill", "density: 0.4", "density: 0.25"),
        ("faces", "[top]", "[1]"),
        ("faces", "spacing_mm: 14", "spacing_mm: 40"),
        ("faces twice", "count: 2", "count: 1"),
    ],
)
def test_a_print_of_another_input(name: str, key: str, other: str) -> None:
    text = PRINTS[name] if key in PRINTS[name] else PRINTS[name].replace("height_mm: 0.6", f"{key}, height_mm: 0.6")
    if other == "[1]":
        other = f"[{_another_face()}]"
    assert judged_as(name, text.replace(key, other)) & {PART, INSIDE, FILLED, DENSE, DRAWN, LEFT}


@pytest.mark.slow
def test_level_layers_that_wall_in_the_curved_ones() -> None:
    """Those of a wing that may lean further, and so rise beside the curved layers more steeply than they should."""
    shallow, steep = (
        PRINTS["wing on a support"].replace("[15, 0, 6]", f"[15, 0, 6], tilt_deg: {tilt}") for tilt in (12, 75)
    )
    problem, toolpath = printed(shallow)
    level = [bead for bead in printed(steep)[1].beads if (bead.normals == [0.0, 0.0, 1.0]).all()]
    curved = [bead for bead in toolpath.beads if not (bead.normals == [0.0, 0.0, 1.0]).all()]
    assert not failed(found(problem, toolpath))
    assert failed(found(problem, toolpath, [*level, *curved])) & {INSIDE, FILLED, DENSE}


def _another_face() -> int:
    """The number of a face of the plate beneath the one called top."""
    part = print_of("faces")[0].part
    assert part is not None
    assert part.step is not None
    faces = read_step(part.step, 5e-3, InputError)
    others = [face for face in faces if face.name != "top"]
    return max(others, key=lambda face: float(np.ptp(face.points(np.vstack(face.loops)), axis=0)[:2].prod())).number


@pytest.mark.slow(keep=("box",))
@pytest.mark.parametrize("name", ["box", "hill"])
def test_what_a_mesh_has_lost_since_it_was_planned(name: str, tmp_path: Path) -> None:
    """The file is another one when the print is judged: with a hole in it, or moved by 3 mm."""
    problem, toolpath = print_of(name)
    body = trimesh.load(folder() / f"{name}.stl")
    hole = trimesh.creation.box((5.0, 5.0, 3.2))
    hole.apply_translation([4.0, 2.0, 1.8])
    hole.invert()
    shifted = body.copy()
    shifted.apply_translation([3.0, 0.0, 0.0])
    for other in (trimesh.util.concatenate([body, hole]), shifted):
        path = tmp_path / "other.stl"
        other.export(path)
        source = problem.layers.source.model_copy(update={"mesh": path})  # type: ignore[union-attr]
        there = problem.model_copy(update={"layers": problem.layers.model_copy(update={"source": source})})  # type: ignore[union-attr]
        assert INSIDE in failed(found(there, toolpath))


def test_a_volume_s_loss_is_excused_only_where_it_is_told() -> None:
    problem, toolpath = print_of("box")
    lost = [bead for bead in toolpath.beads if not ("infill" in bead.name and bead.layer == 1)]
    body = print_body(toolpath)
    assert FILLED in failed(found(problem, replace(toolpath, notes=("box.stl: another thing",)), lost, body))
    assert FILLED in failed(found(problem, replace(toolpath, told=Told(off=1e-4)), lost, body))


@pytest.mark.slow(cases=("0006", "0024"))
@pytest.mark.parametrize("digits", ["0006", "0024", "2412", "4415", "6309", "9921"])
def test_naca_sections_are_those_of_the_planner(digits: str) -> None:
    problem, _ = print_of("tapered wing")
    layers = problem.layers
    assert isinstance(layers, AerofoilLayersSpec)
    assert layers.source.tip is not None
    tip = layers.source.tip.model_copy(update={"naca": digits, "washout": 0.05})
    source = layers.source.model_copy(update={"naca": digits, "tip": tip})
    ours = (root_section(problem, source), tip_section(problem, source, tip))
    for mine, theirs in zip(sections_of(source), ours, strict=True):
        assert theirs.upper.distance(mine.upper[0]).max() < 1e-5
        assert theirs.lower.distance(mine.lower[0]).max() < 1e-5


@pytest.mark.slow
@pytest.mark.parametrize("shape", ["ball", "two balls", "turned facets", "ring"])
def test_lines_through_a_body_tell_its_inside(shape: str) -> None:
    """Against trimesh's own test of what a body holds; bodies that overlap are one, and facets may face the wrong way."""
    ball = trimesh.creation.icosphere(subdivisions=3, radius=10.0)
    if shape == "ring":
        ball = trimesh.creation.torus(8.0, 3.0)
    other = ball.copy()
    other.apply_translation([7.0, 3.0, 2.0])
    body = trimesh.util.concatenate([ball, other]) if shape == "two balls" else ball
    corners = np.array(body.triangles)
    if shape == "turned facets":
        corners[::7] = corners[::7, ::-1]
    points = np.random.default_rng(0).uniform(-12.0, 18.0, (4000, 3))
    inside, known = Facets.of(1e-3 * corners).crossings(1e-3 * points[:, :2]).inside(1e-3 * points[:, 2])
    truth = trimesh_holds(ball, points)
    if shape == "two balls":
        truth |= trimesh_holds(other, points)
    assert known.all()
    assert (inside != truth).mean() < 0.001


def trimesh_holds(body: trimesh.Trimesh, points: Array) -> NDArray[np.bool_]:
    """By the solid angle that a body's facets fill, seen from points."""
    a, b, c = (body.triangles[None, :, k] - points[: 400 * (len(points) // 400), None] for k in range(3))
    la, lb, lc = (np.linalg.norm(each, axis=2) for each in (a, b, c))
    above = (a * np.cross(b, c)).sum(axis=2)
    beneath = la * lb * lc + (a * b).sum(axis=2) * lc + (b * c).sum(axis=2) * la + (c * a).sum(axis=2) * lb
    return np.asarray(np.arctan2(above, beneath).sum(axis=1) > np.pi)


def test_files_that_are_gone_say_so(tmp_path: Path) -> None:
    problem, toolpath = print_of("box")
    source = problem.layers.source.model_copy(update={"mesh": tmp_path / "gone.stl"})  # type: ignore[union-attr]
    there = problem.model_copy(update={"layers": problem.layers.model_copy(update={"source": source})})  # type: ignore[union-attr]
    findings = found(there, toolpath)
    assert "not read again" in next(check.where for check in findings.checks if check.name == PART)
