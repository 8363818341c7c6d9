"""Faces of IGES files: the same paths as of STEP, units, loose faces sewn, bodies, files read in part, and what is refused."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from OCP.BRepBuilderAPI import BRepBuilderAPI_MakeEdge, BRepBuilderAPI_MakeFace
from OCP.BRepPrimAPI import BRepPrimAPI_MakeBox, BRepPrimAPI_MakeSphere
from OCP.gp import gp_Ax3, gp_Dir, gp_Pln, gp_Pnt
from OCP.IGESControl import IGESControl_Controller, IGESControl_Writer
from OCP.STEPControl import STEPControl_Reader
from OCP.TCollection import TCollection_HAsciiString
from OCP.TopAbs import TopAbs_ShapeEnum
from OCP.TopoDS import TopoDS_Shape
from scipy.spatial import cKDTree

from planner.base.errors import InputError
from planner.planning.solve_command import main
from planner.problem import load_problem
from planner.problem.cad_files import is_iges
from planner.problem.part import StepSpec
from planner.toolpath.bead import Toolpath
from planner.toolpath.build import build_toolpath
from planner.toolpath.step.cover import smooth_regions
from planner.toolpath.step.files import Face, FacesRead, read_faces
from planner.toolpath.step.shapes import subshapes

PROBLEMS = Path(__file__).resolve().parents[1] / "problems"
LOOSE, SOLID = 0, 1  # how the writer leaves faces: trimmed surfaces (144), or a solid (186)
TRIMMED = 144


def written(path: Path, shapes: Sequence[TopoDS_Shape], unit: str = "MM", mode: int = LOOSE) -> Path:
    """An IGES file of shapes."""
    IGESControl_Controller.Init_s()
    writer = IGESControl_Writer(unit, mode)
    for shape in shapes:
        writer.AddShape(shape)
    writer.ComputeModel()
    writer.Write(str(path))
    return path


def converted(name: str, folder: Path) -> Path:
    """A shipped STEP file as IGES: trimmed surfaces in the same order, called by the same names."""
    reader = STEPControl_Reader()
    reader.ReadFile(str(PROBLEMS / f"{name}.step"))
    reader.TransferRoots()
    known = subshapes(reader.OneShape(), TopAbs_ShapeEnum.TopAbs_FACE)
    faces = [known.FindKey(i) for i in range(1, known.Size() + 1)]
    found = reader.WS().TransferReader()
    names = [found.EntityFromShapeResult(face, -1).Name().ToCString() for face in faces]
    IGESControl_Controller.Init_s()
    writer = IGESControl_Writer("MM", LOOSE)
    for face in faces:
        writer.AddShape(face)
    writer.ComputeModel()
    model = writer.Model()
    entities = [model.Entity(i) for i in range(1, model.NbEntities() + 1)]
    trimmed = [entity for entity in entities if entity.TypeNumber() == TRIMMED]
    assert len(trimmed) == len(faces)
    for entity, title in zip(trimmed, names, strict=True):
        if title:
            entity.SetLabel(TCollection_HAsciiString(title))
    path = folder / f"{name}.igs"
    writer.Write(str(path))
    return path


def complain(reason: str, hint: str | None = None) -> InputError:
    return InputError(reason, hint=hint)


def read(path: Path, **more: object) -> FacesRead:
    given = {"file": path, "faces": "all", "normals": "outward", "origin": (0.0, 0.0, 0.0), "rpy": (0.0, 0.0, 0.0)}
    return read_faces(StepSpec.model_construct(**{"sew": 1e-5, **given, **more}), 2.5e-3, complain)


def corners(faces: Sequence[Face]) -> np.ndarray:
    points = np.vstack([face.points(loop) for face in faces for loop in face.loops])
    return np.array([points.min(axis=0), points.max(axis=0)])


def square(x: float, size: float = 10.0) -> TopoDS_Shape:
    """A level square face from x on [mm]."""
    plane = gp_Pln(gp_Ax3(gp_Pnt(x, 0, 0), gp_Dir(0, 0, 1), gp_Dir(1, 0, 0)))
    return BRepBuilderAPI_MakeFace(plane, 0.0, size, 0.0, size).Face()


def tips(toolpath: Toolpath) -> np.ndarray:
    return np.vstack([bead.points for bead in toolpath.beads])


@pytest.mark.slow
@pytest.mark.parametrize("name", ["curved_plate", "propeller_blade"])
def test_shipped_models_as_iges_give_the_same_paths(name: str, tmp_path: Path) -> None:
    changes = ("layers.source.spacing_mm=15", "layers.count=1")
    step = build_toolpath(load_problem(name, changes))
    iges = build_toolpath(load_problem(name, (*changes, f"part.step.file={converted(name, tmp_path)}")))
    assert len(iges.beads) == len(step.beads)
    assert iges.length == pytest.approx(step.length, rel=1e-3)
    apart, nearest = cKDTree(tips(step)).query(tips(iges))  # beads may be laid the other way, and begin at another end
    assert apart.max() < 1e-3  # of samples 1 mm apart
    ours, theirs = (np.vstack([bead.normals for bead in t.beads]) for t in (iges, step))
    assert (ours * theirs[nearest]).sum(axis=1).min() > np.cos(np.radians(3.0))  # as much as they turn in a millimetre


@pytest.mark.slow
def test_a_shoehorn_of_iges_is_planned_and_verified(tmp_path: Path) -> None:
    file = converted("shoehorn", tmp_path)
    out = tmp_path / "out"
    given = ["--set", f"part.step.file={file}", "--set", "layers.source.spacing_mm=20", "--set", "layers.count=1"]
    assert main(["shoehorn", *given, "--out", str(out)]) == 0


@pytest.mark.slow
@pytest.mark.parametrize(("unit", "mode"), [("MM", LOOSE), ("IN", LOOSE), ("M", SOLID), ("CM", SOLID)])
def test_units_are_the_files(unit: str, mode: int, tmp_path: Path) -> None:
    faces, notes = read(written(tmp_path / "box.igs", [BRepPrimAPI_MakeBox(10.0, 20.0, 30.0).Shape()], unit, mode))
    assert np.allclose(corners(faces), [[0, 0, 0], [0.01, 0.02, 0.03]], atol=1e-9)
    assert len(faces) == 6
    for face in faces:
        middle = face.surface.domain.mean(axis=0)[None]
        outward = ((face.points(middle) - [0.005, 0.01, 0.015]) * face.normals(middle)).sum() > 0.0
        assert outward or mode == LOOSE
    assert any("sewn" in note for note in notes) == (mode == LOOSE)


@pytest.mark.slow
def test_loose_faces_are_sewn_within_the_tolerance(tmp_path: Path) -> None:
    path = written(tmp_path / "two.igs", [square(0.0), square(10.05)])
    apart, notes = read(path)
    assert not set(np.concatenate(apart[0].edges)) & set(np.concatenate(apart[1].edges))
    assert any("within 0.01 mm" in note and "part.step.sew_mm" in note for note in notes)
    joined, notes = read(path, sew=1e-4)
    assert set(np.concatenate(joined[0].edges)) & set(np.concatenate(joined[1].edges))
    assert len(smooth_regions(joined)) == 1 and any("at 1 edge" in note for note in notes)


@pytest.mark.slow
def test_several_bodies_and_what_is_no_face(tmp_path: Path) -> None:
    ball = BRepPrimAPI_MakeSphere(gp_Pnt(50, 0, 0), 5.0).Shape()
    line = BRepBuilderAPI_MakeEdge(gp_Pnt(0, 0, 0), gp_Pnt(9, 9, 9)).Edge()
    faces, notes = read(written(tmp_path / "b.igs", [BRepPrimAPI_MakeBox(10.0, 10.0, 10.0).Shape(), ball, line]))
    assert len(faces) == 7 and corners(faces)[1, 0] == pytest.approx(0.055, abs=1e-5)
    assert any("passed over: 1 line" in note for note in notes)


@pytest.mark.slow
@pytest.mark.parametrize("surface", ["none", "no surface"])
def test_a_face_that_cannot_be_read_is_named(tmp_path: Path, surface: str) -> None:
    path = written(tmp_path / "two.igs", [square(0.0), square(20.0)])
    lines = path.read_text().splitlines()
    k = next(i for i, line in enumerate(lines) if line.startswith(f"{TRIMMED},") and line[72] == "P")
    values = lines[k][:64].rstrip().rstrip(";").split(",")
    values[1] = "0" if surface == "none" else values[4]  # a curve in place of a surface
    lines[k] = f"{','.join(values) + ';':64}" + lines[k][64:]
    path.write_text("\n".join(lines) + "\n")
    faces, notes = read(path)
    assert len(faces) == 1
    owner = int(lines[k][64:72])
    assert any("1 of 2 faces could not be read" in note and f"D{owner}" in note for note in notes)


@pytest.mark.slow
def test_a_unit_that_is_none_is_refused(tmp_path: Path) -> None:
    path = written(tmp_path / "one.igs", [square(0.0)])
    text = path.read_text()
    assert ",2,2HMM," in text
    path.write_text(text.replace(",2,2HMM,", ",0,2HXX,", 1))
    with pytest.raises(InputError, match="flag 0, 'XX'") as error:
        read(path)
    assert "millimetres" in str(error.value.hint)


def test_what_is_iges_is_told_by_the_first_line() -> None:
    start = f"{'Anything':72}S{1:7d}\r\n".encode()
    assert is_iges(start) and not is_iges(b"ISO-10303-21;\n") and not is_iges(b"")
    assert not is_iges(f"{'x':72}Sentence\n".encode())


@pytest.mark.slow
def test_wrong_files_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    good = written(tmp_path / "good.igs", [square(0.0)]).read_bytes()
    lines = good.splitlines(keepends=True)
    line = BRepBuilderAPI_MakeEdge(gp_Pnt(0, 0, 0), gp_Pnt(9, 9, 9)).Edge()
    cases = {
        "empty.igs": (b"", "is not an IGES file"),
        "short.igs": (b"".join(lines[: len(lines) // 2]), "its end is missing"),
        "binary.igs": (good[:72] + b"B" + good[73:], "binary or compressed"),
        "curve.igs": (written(tmp_path / "curve.igs", [line]).read_bytes(), "passed over: 1 line"),
        "hollow.igs": (b"".join(each for each in lines if each[72:73] != b"P"), "hollow.igs"),
        "none.step": (b"solid x\nendsolid x\n", "is not a STEP file"),
    }
    for name, (data, reason) in cases.items():
        (tmp_path / name).write_bytes(data)
        assert main(["curved_plate", "--set", f"part.step.file={tmp_path / name}", "--out", str(tmp_path / "o")]) == 2
        message = " ".join(capsys.readouterr().err.split())
        assert reason in message and name in message and "Traceback" not in message


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(4))
def test_damaged_files_never_end_the_planner(tmp_path: Path, seed: int) -> None:
    path = written(tmp_path / "bad.igs", [BRepPrimAPI_MakeBox(10.0, 20.0, 30.0).Shape()])
    rng = np.random.default_rng(seed)
    lines = path.read_bytes().split(b"\n")
    kept = [line for i, line in enumerate(lines) if i < 5 or i > len(lines) - 4 or rng.uniform() > 0.03]
    path.write_bytes(b"\n".join(kept))
    try:
        assert read(path).faces
    except InputError as error:
        assert error.hint
