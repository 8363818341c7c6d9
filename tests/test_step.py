"""Faces of STEP files: reading, places on them, samples, layers on the true faces, and what is refused."""

from __future__ import annotations

import re
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from OCP.BRep import BRep_Builder
from OCP.BRepAlgoAPI import BRepAlgoAPI_Cut
from OCP.BRepBuilderAPI import BRepBuilderAPI_MakeFace
from OCP.BRepPrimAPI import (
    BRepPrimAPI_MakeBox,
    BRepPrimAPI_MakeCylinder,
    BRepPrimAPI_MakeSphere,
    BRepPrimAPI_MakeTorus,
)
from OCP.gp import gp_Ax2, gp_Dir, gp_Pln, gp_Pnt
from OCP.STEPControl import STEPControl_StepModelType, STEPControl_Writer
from OCP.TopoDS import TopoDS_Compound, TopoDS_Shape
from scipy.interpolate import NdBSpline
from scipy.spatial import cKDTree

from planner.base.arrays import Array
from planner.base.errors import InputError
from planner.collision.print_body import print_body
from planner.planning.solve_command import main
from planner.problem import Problem, load_problem
from planner.problem.part import StepSpec
from planner.toolpath.build import build_toolpath
from planner.toolpath.coverage.measures import crossings, laid
from planner.toolpath.step.body import SHELL, FaceBody
from planner.toolpath.step.cover import _TURN, smooth_regions, spread, visits
from planner.toolpath.step.files import Damaged, Face, choose_faces, read_step
from planner.toolpath.step.sampling import TOLERANCE, Sampling, sample_faces
from planner.toolpath.step.splines import SplineSet, SplineSurface
from planner.toolpath.step.top import faces_shape

PROBLEMS = Path(__file__).resolve().parents[1] / "problems"


def written(folder: Path, shape: TopoDS_Shape, name: str = "body.step") -> Path:
    writer = STEPControl_Writer()
    writer.Transfer(shape, STEPControl_StepModelType.STEPControl_AsIs)
    writer.Write(str(folder / name))
    return folder / name


def compound(faces: Sequence[TopoDS_Shape]) -> TopoDS_Compound:
    builder, out = BRep_Builder(), TopoDS_Compound()
    builder.MakeCompound(out)
    for face in faces:
        builder.Add(out, face)
    return out


def complain(reason: str, hint: str | None = None) -> InputError:
    return InputError(reason, hint=hint)


def faces_of(path: Path, **more: object) -> tuple[Face, ...]:
    given = {"file": path, "faces": "all", "normals": "outward", "origin": (0.0, 0.0, 0.0), "rpy": (0.0, 0.0, 0.0)}
    return read_step(StepSpec.model_construct(**{**given, **more}), 2.5e-3, complain)


def holed(folder: Path) -> Path:
    """A block of 50 x 50 x 10 mm with a hole of 16 mm."""
    hole = BRepPrimAPI_MakeCylinder(gp_Ax2(gp_Pnt(25, 25, -1), gp_Dir(0, 0, 1)), 8.0, 20.0).Shape()
    return written(folder, BRepAlgoAPI_Cut(BRepPrimAPI_MakeBox(50.0, 50.0, 10.0).Shape(), hole).Shape())


# Surfaces


@pytest.mark.parametrize("degrees", [(1, 1), (2, 3), (3, 1), (5, 4)])
def test_surface_and_its_derivatives(degrees: tuple[int, int]) -> None:
    rng = np.random.default_rng(1)
    counts = degrees[0] + 4, degrees[1] + 6
    knots = [
        np.concatenate([np.zeros(p + 1), np.sort(rng.uniform(size=n - p - 1)), np.ones(p + 1)])
        for p, n in zip(degrees, counts, strict=True)
    ]
    poles = rng.normal(size=(*counts, 4))
    poles[:, :, 3] = 1.0 + 0.3 * np.abs(poles[:, :, 3])
    surfaces = SplineSet.of([SplineSurface(*knots, poles)] * 2)
    uv, face = rng.uniform(size=(50, 2)), np.ones(50, dtype=np.int64)
    expected = NdBSpline(tuple(knots), poles, degrees)(uv)
    got = surfaces.derivatives(face, uv)
    assert np.abs(expected[:, :3] / expected[:, 3:] - got[:, 0]).max() < 1e-13
    step = 1e-5 * np.eye(2)
    for axis, of, order in ((0, 0, 1), (1, 0, 2), (0, 1, 3), (1, 1, 4), (1, 2, 5)):
        ahead, behind = (surfaces.derivatives(face, uv + sign * step[axis])[:, of] for sign in (1.0, -1.0))
        scale = max(1.0, np.abs(got[:, order]).max())
        assert np.abs((ahead - behind) / 2e-5 - got[:, order]).max() < 1e-6 * scale


# Reading


@pytest.mark.slow
def test_normals_look_out_of_a_solid(tmp_path: Path) -> None:
    for face in faces_of(written(tmp_path, BRepPrimAPI_MakeBox(10.0, 20.0, 30.0).Shape())):
        middle = face.surface.domain.mean(axis=0)[None]
        away = face.points(middle) - [0.005, 0.010, 0.015]
        assert (away * face.normals(middle)).sum() > 0.0


@pytest.mark.slow
def test_units_turn_and_place(tmp_path: Path) -> None:
    path = written(tmp_path, BRepPrimAPI_MakeBox(1.0, 2.0, 3.0).Shape())
    millimetres = "(LENGTH_UNIT() NAMED_UNIT(*) SI_UNIT(.MILLI.,.METRE.))"
    text = "".join(path.read_text().split("\n")).replace("( ", "(").replace(" )", ")")
    assert millimetres.replace(" ", "") in text.replace(" ", "")

    def corners(**more: object) -> Array:
        points = np.vstack([face.points(face.loops[0]) for face in faces_of(path, **more)])
        return np.array([points.min(axis=0), points.max(axis=0)])

    assert np.allclose(corners(), [[0, 0, 0], [1e-3, 2e-3, 3e-3]], atol=1e-9)
    turned = corners(rpy=(np.pi / 2, 0.0, 0.0), origin=(0.1, 0.0, 0.0))
    assert np.allclose(turned, [[0.1, -3e-3, 0.0], [0.101, 0.0, 2e-3]], atol=1e-9)
    lines = path.read_text()
    unit = lines[lines.index("( LENGTH_UNIT()") :].split(";")[0]
    inches = (
        "( CONVERSION_BASED_UNIT('INCH',#9001) LENGTH_UNIT() NAMED_UNIT(#9002) );\n"
        "#9001 = LENGTH_MEASURE_WITH_UNIT(LENGTH_MEASURE(25.4),#9003);\n"
        "#9002 = DIMENSIONAL_EXPONENTS(1.,0.,0.,0.,0.,0.,0.);\n"
        "#9003 = ( LENGTH_UNIT() NAMED_UNIT(*) SI_UNIT(.MILLI.,.METRE.) )"
    )
    path.write_text(lines.replace(unit, inches, 1))
    assert np.allclose(corners()[1], 25.4 * np.array([1e-3, 2e-3, 3e-3]), atol=1e-9)


@pytest.mark.slow
def test_faces_that_only_touch_become_one_sheet(tmp_path: Path) -> None:
    up, down = gp_Pln(gp_Pnt(0, 0, 0), gp_Dir(0, 0, 1)), gp_Pln(gp_Pnt(0, 0, 0), gp_Dir(0, 0, -1))
    one = BRepBuilderAPI_MakeFace(up, 0.0, 10.0, 0.0, 10.0).Face()
    probe = faces_of(written(tmp_path, BRepBuilderAPI_MakeFace(down, 0.0, 10.0, 0.0, 10.0).Face()))[0]
    low, high = (f(probe.points(probe.loops[0])[:, 0], axis=0) * 1e3 for f in (np.min, np.max))
    bounds = (10.0, 20.0) if high > 5.0 else (-20.0, -10.0)
    two = BRepBuilderAPI_MakeFace(down, *bounds, 0.0, 10.0).Face()
    faces = faces_of(written(tmp_path, compound([one, two])))
    assert low < high and set(np.concatenate(faces[0].edges)) & set(np.concatenate(faces[1].edges))
    normals = [face.normals(face.loops[0][:1])[0] for face in faces]
    assert np.allclose(normals[0], normals[1])
    assert len(smooth_regions(faces)) == 1


@pytest.mark.slow
def test_seams_of_the_shoehorn_are_smooth_and_those_of_a_box_are_not(tmp_path: Path) -> None:
    assert len(smooth_regions(faces_of(PROBLEMS / "shoehorn.step"))) == 1
    assert len(smooth_regions(faces_of(written(tmp_path, BRepPrimAPI_MakeBox(9.0, 9.0, 9.0).Shape())))) == 6


def test_faces_by_number_and_name() -> None:
    known = [(1, ""), (2, "wing"), (3, "wing"), (5, "tip")]
    assert choose_faces("all", known, "x") == [1, 2, 3, 5]
    assert choose_faces((5, "wing"), known, "x") == [2, 3, 5]
    with pytest.raises(Damaged, match="no face 'win'") as error:
        choose_faces(("win",), known, "x")
    assert "tip, wing" in str(error.value.hint)
    with pytest.raises(Damaged, match="no face 4"):
        choose_faces((4,), known, "x")


# Distances


@pytest.mark.slow
def test_distances_from_bodies(tmp_path: Path) -> None:
    points = np.random.default_rng(0).uniform(-0.06, 0.06, size=(4000, 3))
    near_pole = np.random.default_rng(1).normal(size=(1000, 3)) * 3e-4 + [0.0, 0.0, 0.03]
    both = np.vstack([points, near_pole])
    ball = FaceBody.of(faces_of(written(tmp_path, BRepPrimAPI_MakeSphere(30.0).Shape())))
    assert np.abs(ball.signed_distance(both) - (np.linalg.norm(both, axis=1) - 0.03)).max() < 1e-5
    torus = FaceBody.of(faces_of(written(tmp_path, BRepPrimAPI_MakeTorus(30.0, 10.0).Shape())))
    exact = np.hypot(np.hypot(points[:, 0], points[:, 1]) - 0.03, points[:, 2]) - 0.01
    assert np.abs(torus.signed_distance(points) - exact).max() < 2e-5
    block = FaceBody.of(faces_of(holed(tmp_path)))
    aside = np.abs(points - [0.025, 0.025, 0.005]) - [0.025, 0.025, 0.005]
    box = np.linalg.norm(np.maximum(aside, 0.0), axis=1) + np.minimum(aside.max(axis=1), 0.0)
    within = 8e-3 - np.hypot(points[:, 0] - 0.025, points[:, 1] - 0.025)
    over = np.maximum(aside[:, 2], 0.0)
    hole = np.hypot(np.maximum(within, 0.0), over)
    exact = np.where(within > 0.0, hole, np.maximum(box, within))
    assert np.abs(block.signed_distance(points) - exact).max() < 1e-5


@pytest.mark.slow
def test_open_faces_have_a_shell_beneath(tmp_path: Path) -> None:
    sheet = BRepBuilderAPI_MakeFace(gp_Pln(gp_Pnt(0, 0, 0), gp_Dir(0, 0, 1)), 0.0, 50.0, 0.0, 50.0).Face()
    body = FaceBody.of(faces_of(written(tmp_path, sheet)))
    height = np.array([0.002, -0.002, -0.009, -0.02])
    points = np.column_stack([np.full((4, 2), 0.02), height])
    assert np.allclose(body.signed_distance(points), [0.002, -0.002, SHELL * -0.1, 0.01], atol=1e-9)
    assert body.signed_distance(np.array([[-0.003, 0.02, -0.004]])) == pytest.approx(0.005, abs=1e-9)


@pytest.mark.slow
def test_the_shell_is_as_thick_as_it_is_said_to_be(tmp_path: Path) -> None:
    sheet = BRepBuilderAPI_MakeFace(gp_Pln(gp_Pnt(0, 0, 0), gp_Dir(0, 0, 1)), 0.0, 50.0, 0.0, 50.0).Face()
    faces = faces_of(written(tmp_path, sheet))
    points = np.column_stack([np.full((3, 2), 0.02), [0.002, -0.002, -0.009]])
    assert np.allclose(FaceBody.of(faces, 3e-3).signed_distance(points), [0.002, -0.001, 0.006], atol=1e-9)
    assert np.allclose(FaceBody.of(faces, 0.0).signed_distance(points), [0.002, 0.002, 0.009], atol=1e-9)
    solid = faces_of(PROBLEMS / "curved_plate.step")
    inside = np.array([[0.0, 0.0, 0.0975]])
    assert FaceBody.of(solid, 0.0).signed_distance(inside) < 0.0  # a closed body is solid all through


SHEET = ("layers.source.spacing_mm=20", "part.step.rpy_deg=[100, 0, 0]", "part.step.origin_mm=[0, 0, 250]")


@pytest.mark.slow
def test_a_sheet_in_the_air_is_in_nobodys_way() -> None:
    names = {}
    for thickness in (0, 10):
        toolpath = build_toolpath(load_problem("shoehorn", (*SHEET, f"part.step.thickness_mm={thickness}")))
        names[thickness] = set(print_body(toolpath).names)
        assert toolpath.shape is not None
    assert names[10] - names[0] == {"part"}


@pytest.mark.slow
def test_a_sheet_that_hangs_over_is_planned_and_verified(tmp_path: Path) -> None:
    given = [each for one in (*SHEET, "part.step.thickness_mm=0") for each in ("--set", one)]
    assert main(["shoehorn", *given, "--out", str(tmp_path / "out")]) == 0


# Samples


@pytest.mark.slow
def test_samples_stand_at_the_distance_and_off_the_hole(tmp_path: Path) -> None:
    top = [face for face in faces_of(holed(tmp_path)) if face.normals(face.loops[0][:1])[0, 2] > 0.9]
    samples = sample_faces(FaceBody.of(top), Sampling((5e-3, 5e-3)))
    away = np.hypot(*(samples.points[:, :2] - 0.025).T)
    assert away.min() >= 8e-3 - 1e-5 and len(samples.points) == 121 - 9
    for row in np.unique(samples.row):
        steps = np.linalg.norm(np.diff(samples.points[samples.row == row], axis=0), axis=1)
        assert np.abs(steps[steps < 7.5e-3] - 5e-3).max() <= TOLERANCE


@pytest.mark.slow
@pytest.mark.parametrize(("along", "row", "apart"), [(0, 20e-3, 10e-3), (1, 10e-3, 20e-3)])
def test_rows_run_along_either_parameter_at_distances_of_their_own(along: int, row: float, apart: float) -> None:
    plate = FaceBody.of([face for face in faces_of(PROBLEMS / "curved_plate.step") if face.name == "top"])
    samples = sample_faces(plate, Sampling((20e-3, 10e-3), along))
    for number in np.unique(samples.row):
        own = samples.row == number
        assert np.ptp(samples.parameters[own, 1 - along]) == 0.0
        steps = np.linalg.norm(np.diff(samples.points[own], axis=0), axis=1)
        assert np.abs(steps - row).max() <= TOLERANCE
    first = [samples.points[samples.row == number][0] for number in np.unique(samples.row)]
    assert np.linalg.norm(np.diff(first, axis=0), axis=1).max() == pytest.approx(apart, rel=0.2)


@pytest.mark.slow
def test_samples_may_miss_the_distance_by_what_is_allowed() -> None:
    plate = FaceBody.of([face for face in faces_of(PROBLEMS / "curved_plate.step") if face.name == "top"])
    samples = sample_faces(plate, Sampling((10e-3, 10e-3), tolerance=1e-4))
    own = samples.points[samples.row == 0]
    off = np.abs(np.linalg.norm(np.diff(own, axis=0), axis=1) - 10e-3)
    assert TOLERANCE < off.max() <= 1e-4


@pytest.mark.slow
@pytest.mark.parametrize("name", ["curved_plate", "propeller_blade", "shoehorn"])
def test_the_papers_path_crosses_nothing_on_the_shipped_faces(name: str) -> None:
    problem = load_problem(name)
    assert problem.layers.source.path == "weighted_greedy"
    faces = faces_of(PROBLEMS / f"{name}.step")
    numbers = choose_faces(problem.layers.source.faces, [(face.number, face.name) for face in faces], "part.step")
    for region in smooth_regions([face for face in faces if face.number in numbers]):
        samples, pieces = visits(FaceBody.of(region), problem.layers.source)
        assert np.array_equal(np.sort(np.concatenate(pieces)), np.arange(len(samples.points)))
        assert len(pieces) <= 2
        assert len(crossings([laid(samples, piece) for piece in pieces if len(piece) > 1])) == 0


@pytest.mark.slow
def test_a_path_starts_near_the_place_that_is_given() -> None:
    near = np.array([95.0, 190.0, 180.0])
    problem = load_problem("curved_plate", ["layers.source.spacing_mm=40", f"layers.source.start_mm={near.tolist()}"])
    first = build_toolpath(problem).beads[0].points[0]
    plain = build_toolpath(load_problem("curved_plate", ["layers.source.spacing_mm=40"])).beads[0].points[0]
    assert np.linalg.norm(first - near * 1e-3) < 0.04 < np.linalg.norm(plain - near * 1e-3)


@pytest.mark.slow
def test_steps_on_a_curved_face_are_chords_of_the_distance() -> None:
    plate = [face for face in faces_of(PROBLEMS / "curved_plate.step") if face.name == "top"]
    samples = sample_faces(FaceBody.of(plate), Sampling((10e-3, 10e-3)))
    for row in np.unique(samples.row):
        steps = np.linalg.norm(np.diff(samples.points[samples.row == row], axis=0), axis=1)
        assert np.abs(steps - 10e-3).max() <= TOLERANCE


@pytest.mark.slow
def test_samples_across_seams_keep_their_distance() -> None:
    samples = sample_faces(FaceBody.of(faces_of(PROBLEMS / "shoehorn.step")), Sampling((10e-3, 10e-3)))
    gaps = np.linalg.norm(samples.points[:, None] - samples.points, axis=2) + np.eye(len(samples.points))
    assert gaps.min() >= 5e-3 - 1e-9
    assert set(samples.face) == {0, 1, 2, 3}


# Layers


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "path"), [("shoehorn", "rows"), ("shoehorn", "weighted_greedy"), ("curved_plate", "rows")]
)
def test_layers_lie_on_the_true_faces(name: str, path: str) -> None:
    changes = (f"layers.source.path={path}", "layers.source.spacing_mm=15", "layers.count=2")
    problem = load_problem(name, changes)
    toolpath = build_toolpath(problem)
    assert toolpath.layers == 2
    covered = {"shoehorn": {"handle", "neck", "spoon"}, "curved_plate": {"top"}}[name]
    faces = [face for face in faces_of(PROBLEMS / f"{name}.step") if face.name in covered]
    body = FaceBody.of(faces)
    for i, bead in enumerate(toolpath.beads):
        rise = (bead.layer + 1) * problem.layers.height
        feet = bead.points - rise * bead.normals
        back = body.beneath(feet)
        assert np.linalg.norm(back.points - feet, axis=1).max() < 1e-9
        assert np.linalg.norm(back.normals - bead.normals, axis=1).max() < 1e-6
        seen = toolpath.surface.normals_on(i, bead.s, bead.points)
        assert np.linalg.norm(seen - bead.normals, axis=1).max() < 1e-9
        distance = toolpath.surface.signed_distance(bead.points)
        inside = body.rim_distance(back.face, back.points) > 3e-3
        assert np.abs(distance[inside] - rise).max() < 0.02 * problem.layers.height


def test_turns_of_narrow_rows_are_kept() -> None:
    """Rows 2 mm apart, joined by half circles."""
    spacing, turn = 2e-3, np.linspace(-np.pi / 2, np.pi / 2, 40)
    rows = []
    for k in range(4):
        side = 1.0 if k % 2 == 0 else -1.0
        x, y = side * (0.01 + 0.5 * spacing * np.cos(turn)), spacing * (k + 0.5) + 0.5 * spacing * np.sin(turn)
        rows.append(np.column_stack([x, y, np.zeros(len(turn))]))
    points = np.vstack(rows)
    kept = spread(points, _TURN * spacing)
    fine = np.vstack(
        [a + np.linspace(0.0, 1.0, 20)[:, None] * (b - a) for a, b in zip(kept[:-1], kept[1:], strict=True)]
    )
    assert cKDTree(fine).query(points)[0].max() < 0.05 * spacing


@pytest.mark.slow
def test_triangles_of_a_wide_bend_keep_to_the_face(tmp_path: Path) -> None:
    radius = 300.0
    tube = faces_of(written(tmp_path, BRepPrimAPI_MakeCylinder(radius, 50.0).Shape()))
    side = [face for face in tube if abs(face.normals(face.loops[0][:1])[0, 2]) < 0.1]
    shape = faces_shape(side)
    inside = shape.vertices[shape.triangles].mean(axis=1)
    halves = 0.5 * (shape.vertices[shape.triangles] + shape.vertices[np.roll(shape.triangles, -1, axis=1)])
    for points in (inside, halves.reshape(-1, 3)):
        assert np.abs(np.hypot(points[:, 0], points[:, 1]) - 1e-3 * radius).max() < 2e-3


@pytest.mark.slow
def test_a_sharp_seam_ends_a_bead(tmp_path: Path) -> None:
    path = written(tmp_path, BRepPrimAPI_MakeBox(60.0, 60.0, 60.0).Shape())
    problem = load_problem(
        "curved_plate", (f"part.step.file={path}", "layers.source.faces=all", "layers.source.path=weighted_greedy")
    )
    toolpath = build_toolpath(problem)
    assert len(toolpath.beads) == 6
    for bead in toolpath.beads:
        assert np.linalg.norm(bead.normals - bead.normals[0], axis=1).max() < 1e-9


# What is refused


def problem_with(path: Path, *changes: str) -> Problem:
    return load_problem("curved_plate", (f"part.step.file={path}", *changes))


@pytest.mark.slow
def test_wrong_files_are_refused(tmp_path: Path) -> None:
    good = (PROBLEMS / "shoehorn.step").read_bytes()
    curve_only = good.replace(b"ADVANCED_FACE", b"ADVANCED_FICE")
    cases = {
        "no.step": (None, "there is no file"),
        "empty.step": (b"", "is not a STEP file"),
        "mesh.step": (b"solid x\nendsolid x\n", "is not a STEP file"),
        "short.step": (good[: len(good) // 2], "its end is missing"),
        "faceless.step": (curve_only, "holds no face"),
    }
    for name, (data, reason) in cases.items():
        if data is not None:
            (tmp_path / name).write_bytes(data)
        with pytest.raises(InputError, match=reason) as error:
            build_toolpath(problem_with(tmp_path / name))
        assert str(tmp_path / name) in str(error.value) or "part.step.file" in str(error.value)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(6))
def test_damaged_files_never_end_the_planner(tmp_path: Path, seed: int) -> None:
    rng = np.random.default_rng(seed)
    lines = (PROBLEMS / "shoehorn.step").read_bytes().split(b"\n")
    kept = [line for i, line in enumerate(lines) if i < 8 or i > len(lines) - 4 or rng.uniform() > 0.02]
    (tmp_path / "bad.step").write_bytes(b"\n".join(kept))
    try:
        faces = faces_of(tmp_path / "bad.step")
    except InputError as error:
        assert error.hint
    else:
        assert faces


@pytest.mark.slow
@pytest.mark.parametrize(
    ("change", "words"),
    [
        ("layers.source.faces=[roof]", ("layers.source.faces", "'roof'", "top")),
        ("layers.source.faces=[77]", ("layers.source.faces", "77")),
        ("layers.source.faces=top", ("layers.source.faces", "list")),
        ("layers.source.faces=[]", ("layers.source.faces", "no face")),
        ("layers.source.faces=[top, top]", ("layers.source.faces", "twice")),
        ("layers.source.path=spiral", ("layers.source.path", "rows")),
        ("layers.source.spacing_mm=0", ("layers.source.spacing_mm", "small")),
        ("layers.source.spacing_v_mm=0", ("layers.source.spacing_v_mm", "small")),
        ("layers.source.direction=w", ("layers.source.direction", "u, v")),
        ("layers.source.weight=-1", ("layers.source.weight", "0 to 100")),
        ("layers.source.start_mm=[1, 2]", ("layers.source.start_mm", "3 numbers")),
        ("part.step.thickness_mm=-1", ("part.step.thickness_mm", "0 to 1000")),
        ("layers.source.tolerance_mm=0", ("layers.source.tolerance_mm", "1e-06 to 1")),
        ("layers.source.weight=2 layers.source.path=rows", ("layers.source.weight", "path rows", "weighted_greedy")),
        ("layers.source.start_mm=[0,0,0] layers.source.path=tour", ("layers.source.start_mm", "chooses its own start")),
        ("layers.source.direction=u layers.source.path=rows", ("layers.source.direction", "path rows")),
        ("part={sphere: {radius_mm: 50}}", ("part", "step")),
    ],
)
def test_wrong_fields_are_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], change: str, words: tuple[str, ...]
) -> None:
    changes = [each for one in re.split(r" (?=layers)", change) for each in ("--set", one)]
    assert main(["curved_plate", *changes, "--out", str(tmp_path / "out")]) == 2
    message = capsys.readouterr().err
    assert "Traceback" not in message
    for word in words:
        assert word in message
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_layers_that_would_fold_are_refused() -> None:
    with pytest.raises(InputError, match="would fold"):
        build_toolpath(load_problem("shoehorn", ("layers.count=40", "layers.source.spacing_mm=15")))


# What ships


NUMBER = r"[-+]?\d+\.\d*(?:E[-+]?\d+)?"


@pytest.mark.slow
def test_models_come_out_the_same(tmp_path: Path) -> None:
    script = tmp_path / "draw_step_models.py"
    script.write_bytes((PROBLEMS / "draw_step_models.py").read_bytes())
    subprocess.run([sys.executable, str(script)], check=True, capture_output=True)
    for name in ("curved_plate", "propeller_blade", "propeller_blade_faces", "shoehorn"):
        drawn, ships = ((folder / f"{name}.step").read_text(encoding="ascii") for folder in (tmp_path, PROBLEMS))
        assert re.sub(NUMBER, "#", drawn.replace("\n", "")) == re.sub(NUMBER, "#", ships.replace("\n", ""))
        # the last digit, and the sign of zero, are the processor's
        values = [[float(x) for x in re.findall(NUMBER, text.replace("\n", ""))] for text in (drawn, ships)]
        np.testing.assert_allclose(*values, rtol=1e-9, atol=1e-9)


@pytest.mark.slow
def test_faces_are_drawn_where_they_are() -> None:
    toolpath = build_toolpath(load_problem("shoehorn", ["layers.source.spacing_mm=20"]))
    assert toolpath.shape is not None
    corners = toolpath.shape.vertices[toolpath.shape.triangles]
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert ((across * toolpath.shape.normals[toolpath.shape.triangles[:, 0]]).sum(axis=1) > 0.0).all()
    assert np.abs(toolpath.surface.signed_distance(toolpath.shape.vertices)).max() < 1e-4
    # Every line lies a layer's height above a triangle, as near as triangles come to the faces.
    tree = cKDTree(corners.mean(axis=1))
    tips = np.vstack([bead.points for bead in toolpath.beads])
    assert tree.query(tips)[0].max() < 0.012
