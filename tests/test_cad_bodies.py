"""Bodies in STEP and IGES files as facets: wherever a mesh may stand, a CAD program's own file may."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import numpy as np
import pytest
import trimesh
from OCP.BRepAlgoAPI import BRepAlgoAPI_Cut
from OCP.BRepBuilderAPI import BRepBuilderAPI_Transform
from OCP.BRepPrimAPI import BRepPrimAPI_MakeBox, BRepPrimAPI_MakeCylinder, BRepPrimAPI_MakeSphere
from OCP.gp import gp_Ax2, gp_Dir, gp_Pnt, gp_Trsf, gp_Vec
from OCP.IGESControl import IGESControl_Writer
from OCP.TopLoc import TopLoc_Location
from OCP.TopoDS import TopoDS_Shape
from solved import write_small
from test_step import compound, holed, written

from planner.base.errors import InputError
from planner.cell.bodies import head_bodies
from planner.cell.solids import Hull
from planner.problem import load_problem
from planner.problem.cad_files import CHORD
from planner.problem.mesh_files import read_corners
from planner.toolpath.build import build_toolpath

HOLE = gp_Ax2(gp_Pnt(25, 25, -1), gp_Dir(0, 0, 1))


def body_of(path: Path) -> trimesh.Trimesh:
    corners = read_corners(path, partial(InputError, file=path)) * 1e3
    return trimesh.Trimesh(corners.reshape(-1, 3), np.arange(3 * len(corners)).reshape(-1, 3), process=True)


def as_iges(folder: Path, shape: TopoDS_Shape) -> Path:
    writer = IGESControl_Writer("MM", 1)  # 1: solids, not loose faces
    writer.AddShape(shape)
    writer.ComputeModel()
    writer.Write(str(folder / "body.igs"))
    return folder / "body.igs"


@pytest.mark.slow
def test_a_body_is_closed_and_faces_outwards(tmp_path: Path) -> None:
    body = body_of(holed(tmp_path))
    assert body.is_watertight
    assert body.volume == pytest.approx(50 * 50 * 10 - np.pi * 64 * 10, rel=1e-3)
    np.testing.assert_allclose(np.ptp(body.vertices, axis=0), [50, 50, 10], atol=1e-6)


@pytest.mark.slow
def test_facets_of_a_ball_keep_to_it(tmp_path: Path) -> None:
    body = body_of(written(tmp_path, BRepPrimAPI_MakeSphere(20.0).Shape()))
    assert body.is_watertight
    off = 20.0 - np.linalg.norm(body.triangles.mean(axis=1), axis=1)
    assert off.min() > -1e-6
    assert off.max() < 4.0 * CHORD


@pytest.mark.slow
def test_bodies_of_an_assembly_stand_where_it_puts_them(tmp_path: Path) -> None:
    far, mirror = gp_Trsf(), gp_Trsf()
    far.SetTranslation(gp_Vec(100.0, 0.0, 0.0))
    mirror.SetMirror(gp_Ax2(gp_Pnt(-30, 0, 0), gp_Dir(1, 0, 0)))
    cut = BRepAlgoAPI_Cut(
        BRepPrimAPI_MakeBox(20.0, 10.0, 30.0).Shape(), BRepPrimAPI_MakeCylinder(3.0, 40.0).Shape()
    ).Shape()
    mirrored = BRepBuilderAPI_Transform(cut, mirror, True).Shape()
    body = body_of(written(tmp_path, compound([cut, cut.Moved(TopLoc_Location(far)), mirrored])))
    assert body.is_watertight
    volume = 20 * 10 * 30 - 0.25 * np.pi * 9 * 30
    assert sorted(part.volume for part in body.split()) == pytest.approx([volume] * 3, rel=1e-3)
    np.testing.assert_allclose(body.bounds[:, 0], [-80, 120], atol=1e-3)


@pytest.mark.slow
def test_iges_is_read_as_step_is(tmp_path: Path) -> None:
    body = body_of(as_iges(tmp_path, BRepPrimAPI_MakeBox(10.0, 20.0, 30.0).Shape()))
    assert abs(body.volume) == pytest.approx(6000.0)


@pytest.mark.slow
def test_a_print_head_from_cad(tmp_path: Path) -> None:
    written(tmp_path, BRepPrimAPI_MakeBox(40.0, 40.0, 60.0).Shape(), "motor.step")
    head = ("diameter_mm: 0.6}", "diameter_mm: 0.6, head: {motor: {mesh: motor.step, centre_mm: [-20, -20, 0]}}}")
    problem = load_problem(write_small(tmp_path, head))
    bodies = head_bodies(problem, problem.cell.nozzle, "cell.nozzle", np.eye(4))
    motor = next(body for body in bodies if body.name == "head motor")
    assert isinstance(motor.solid, Hull)
    np.testing.assert_allclose(np.ptp(motor.solid.vertices, axis=0), [0.04, 0.04, 0.06], atol=1e-9)


@pytest.mark.slow
def test_a_body_from_cad_is_filled_with_layers(tmp_path: Path) -> None:
    written(tmp_path, BRepPrimAPI_MakeCylinder(20.0, 6.0).Shape(), "puck.step")
    layers = f"layers={{source: {{mesh: {tmp_path}/puck.step}}, height_mm: 1}}"
    toolpath = build_toolpath(load_problem("saddle_ring", [layers]))
    assert toolpath.layers == 6


@pytest.mark.slow(cases=("ISO-10303*END-ISO*",))
@pytest.mark.parametrize(
    ("data", "reason"),
    [
        (b"ISO-10303-21;\nHEADER;\n", "its end is missing"),
        (b"ISO-10303-21;\nHEADER;\nENDSEC;\nDATA;\nENDSEC;\nEND-ISO-10303-21;\n", "holds no body|is damaged"),
        (b"nothing of the kind", "is not a STEP file"),
    ],
)
def test_files_that_hold_no_body(tmp_path: Path, data: bytes, reason: str) -> None:
    path = tmp_path / "body.step"
    path.write_bytes(data)
    with pytest.raises(InputError, match=reason):
        read_corners(path, partial(InputError, file=path))
