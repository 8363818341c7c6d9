"""Plane curves on the upper faces of STEP files: where these are, how near a smooth surface comes, what is refused."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pytest
from OCP.BRepBuilderAPI import BRepBuilderAPI_GTransform, BRepBuilderAPI_MakeFace, BRepBuilderAPI_MakePolygon
from OCP.BRepPrimAPI import BRepPrimAPI_MakePrism, BRepPrimAPI_MakeSphere
from OCP.gp import gp_GTrsf, gp_Mat, gp_Pnt, gp_Vec, gp_XYZ
from OCP.STEPControl import STEPControl_StepModelType, STEPControl_Writer
from solved import solve_alone

from planner.base.errors import InputError
from planner.planning.solve_command import main
from planner.problem import Problem, load_problem
from planner.toolpath.build import build_toolpath
from planner.toolpath.step.files import read_step
from planner.toolpath.step.top import FaceTop, UpperFaces
from planner.toolpath.substrate.bodies import Ellipsoid

RADII = (95.0, 95.0, 60.0)
BOWL = Ellipsoid(np.zeros(3), np.array(RADII) * 1e-3)
COARSE = ("strategy=ladder", "resolve.rung_mm=10", "resolve.roll_step_deg=30", "resolve.table_step_deg=30")


def write(shape: object, path: Path) -> Path:
    writer = STEPControl_Writer()
    writer.Transfer(shape, STEPControl_StepModelType.STEPControl_AsIs)
    writer.Write(str(path))
    return path


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A bowl, which is a scaled ball, and a roof of two faces along y."""
    keep = tmp_path_factory.mktemp("step")
    scale = gp_GTrsf(gp_Mat(RADII[0], 0, 0, 0, RADII[1], 0, 0, 0, RADII[2]), gp_XYZ(0, 0, 0))
    write(BRepBuilderAPI_GTransform(BRepPrimAPI_MakeSphere(1.0).Shape(), scale, True).Shape(), keep / "bowl.step")
    gable = BRepBuilderAPI_MakePolygon()
    for x, z in ((-100, 0), (0, 40), (100, 0)):
        gable.Add(gp_Pnt(x, -100, z))
    gable.Close()
    side = BRepBuilderAPI_MakeFace(gable.Wire()).Face()
    write(BRepPrimAPI_MakePrism(side, gp_Vec(0, 200, 0)).Shape(), keep / "roof.step")
    sheet = BRepBuilderAPI_MakePolygon()
    for x, y in ((-60, -60), (60, -60), (60, 60), (-60, 60)):
        sheet.Add(gp_Pnt(x, y, 0))
    sheet.Close()
    write(BRepBuilderAPI_MakeFace(sheet.Wire()).Face(), keep / "sheet.step")
    return keep


def on(folder: Path, name: str, more: str = "", *changes: str) -> Problem:
    return load_problem("fibre_bowl", (f"part={{step: {{file: '{folder / name}'{more}}}}}", *changes))


@cache
def upper(folder: Path, name: str) -> UpperFaces:
    part = on(folder, name).part
    assert part is not None and part.step is not None
    found = UpperFaces.of(read_step(part.step, 1e-3, InputError))
    assert found is not None
    return found


@pytest.mark.slow
def test_the_uppermost_place_is_found_on_the_whole_bowl(folder: Path) -> None:
    """Its pole and its seam too, which are places in u and v and nothing to be seen."""
    rng = np.random.default_rng(6)
    seam = np.column_stack([np.linspace(0.0, 0.09, 40), np.zeros(40)])
    pole = rng.uniform(-2e-3, 2e-3, (60, 2))
    plane = np.vstack([rng.uniform(-0.06, 0.06, (200, 2)), seam, pole, [[0.0, 0.0]]])
    z, up = upper(folder, "bowl.step").top(plane)
    points, normals = BOWL.at(plane)
    np.testing.assert_allclose(z, points[:, 2], atol=1e-9)
    np.testing.assert_allclose(up, normals[:, 2], atol=1e-5)
    beside = rng.uniform(0.07, 0.1, (20, 2))
    assert np.isnan(upper(folder, "bowl.step").top(beside)[0]).all()


@pytest.mark.slow
def test_the_upper_one_of_two_faces_counts(folder: Path) -> None:
    plane = np.random.default_rng(7).uniform(-0.09, 0.09, (100, 2))
    z, up = upper(folder, "roof.step").top(plane)
    np.testing.assert_allclose(z, 0.04 * (1.0 - np.abs(plane[:, 0]) / 0.1), atol=1e-9)
    np.testing.assert_allclose(up, np.cos(np.arctan(0.4)), atol=1e-9)


@pytest.mark.slow
def test_beads_lie_on_the_true_bowl(folder: Path) -> None:
    """Within a micrometre of the formula, and the nozzle within 0.02 degrees of its normal."""
    toolpath = build_toolpath(on(folder, "bowl.step"))
    for bead in toolpath.beads:
        assert np.abs(BOWL.signed_distance(bead.points) - 0.3e-3).max() <= 1e-6
        true = BOWL.normals(bead.points)
        assert np.degrees(np.linalg.norm(true - bead.normals, axis=1)).max() <= 0.02
        np.testing.assert_allclose(toolpath.surface.normals_on(0, bead.s, bead.points), true, atol=1e-5)


@pytest.mark.slow
def test_a_bowl_from_a_step_file_is_printed(folder: Path) -> None:
    one = "layers.source.curves=[{degree: 2, points_mm: [[-70, 0], [-25, -35], [25, 35], [70, 0]]}]"
    plan = solve_alone(on(folder, "bowl.step", "", one, "process.start.heat_wait_s=0", *COARSE))
    assert plan.verified, [check for check in plan.checks if not check.ok]
    t = plan.trajectory
    assert np.abs(BOWL.signed_distance(t.tip[t.deposit]) - 0.3e-3).max() <= 0.05e-3


@pytest.mark.slow
def test_curves_along_one_slope_are_laid_and_over_the_ridge_refused(folder: Path) -> None:
    slope = "layers.source.curves=[{degree: 2, points_mm: [[20, -60], [40, 0], [20, 60]]}]"
    toolpath = build_toolpath(on(folder, "roof.step", "", slope))
    body = toolpath.surface
    assert isinstance(body.body, FaceTop)
    normal = np.array([0.4, 0.0, 1.0]) / np.sqrt(1.16)
    np.testing.assert_allclose(toolpath.beads[0].normals, np.tile(normal, (len(toolpath.beads[0].s), 1)), atol=1e-4)
    with pytest.raises(InputError, match="edge or a step") as caught:
        build_toolpath(on(folder, "roof.step"))
    assert str(caught.value.field).endswith("file") or "part" in str(caught.value.field)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "more", "words"),
    [
        ("sheet.step", ", rpy_deg: [180, 0, 0]", "looks upwards"),
        ("sheet.step", "", "leaves the part at x -70.0"),
        ("sheet.step", ", faces: [7]", "no face 7"),
        ("none.step", "", "none.step"),
        ("sheet.step", ", origin_mm: [500, 0, 0]", "no curve falls onto the part"),
    ],
)
def test_what_cannot_be_printed_on_is_refused(
    folder: Path, name: str, more: str, words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    step = f"part={{step: {{file: '{folder / name}'{more}}}}}"
    assert main(["fibre_bowl", "--set", step, "--out", str(out)]) == 2
    said = " ".join(capsys.readouterr().err.split())
    assert words in said
    assert "Traceback" not in said
    assert not out.exists()
