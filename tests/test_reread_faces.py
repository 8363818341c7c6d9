"""Faces of STEP files, read again where they bend: their normals, and prints that go over narrow and S-shaped ones."""

from __future__ import annotations

import subprocess
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from OCP.BRepBuilderAPI import BRepBuilderAPI_MakeFace
from OCP.collections import Array2_gp_Pnt
from OCP.Geom import Geom_BezierSurface
from OCP.gp import gp_Ax3, gp_Cylinder, gp_Dir, gp_Pnt
from OCP.TopoDS import TopoDS_Face
from scipy.interpolate import BPoly
from scipy.spatial.transform import Rotation

from planner.base.arrays import Array
from planner.problem import Problem, load_problem
from planner.problem.part import StepSpec
from planner.toolpath.bead import Bead, Toolpath
from planner.toolpath.build import build_toolpath
from planner.verify.reread.plane_curves import NotRead
from planner.verify.reread.step_faces import TURNED, meshed_faces, read_ahead
from tests.test_reread import BASE, failed, found
from tests.test_reread_bodies import FILLED, INSIDE, NORMAL, PART
from tests.test_step import written

LENGTH, WIDTH = 40.0, 30.0  # mm
BENDS_ONCE, BENDS_TWICE = (0.0, 12.0, -12.0, 0.0), (0.0, 8.0, -8.0, 8.0, -8.0, 0.0)  # mm, heights of poles
PRINT = (
    "part: {{step: {{file: sheet.step, normals: {}}}}}\n"
    "layers: {{source: {{faces: all, spacing_mm: {}, path: rows}}, count: 2, height_mm: 0.8}}\n"
)


def s_sheet(heights: tuple[float, ...]) -> TopoDS_Face:
    """A sheet that goes up and down along x, straight along y."""
    poles = Array2_gp_Pnt(1, len(heights), 1, 2)
    for i, height in enumerate(heights):
        for j, y in enumerate((0.0, WIDTH)):
            poles.SetValue(i + 1, j + 1, gp_Pnt(LENGTH * i / (len(heights) - 1), y, height))
    return BRepBuilderAPI_MakeFace(Geom_BezierSurface(poles), 1e-6).Face()


def quarter(radius: float, up: float) -> TopoDS_Face:
    """A quarter of a cylinder along x, above its axis (up = 1) as a rounded edge, or below it (-1) as a trough."""
    along = gp_Ax3(gp_Pnt(0, 0, 0), gp_Dir(1, 0, 0), gp_Dir(0, 0, up))
    return BRepBuilderAPI_MakeFace(gp_Cylinder(along, radius), -np.pi / 4, np.pi / 4, 0.0, LENGTH).Face()


SHEETS: dict[str, tuple[Callable[[], TopoDS_Face], str, float]] = {  # shape, where its normals look, mm between rows
    "S": (lambda: s_sheet(BENDS_ONCE), "outward", 5.0),
    "strip": (lambda: quarter(5.0, 1.0), "outward", 2.0),
    "trough": (lambda: quarter(8.0, -1.0), "inward", 3.0),
}


@cache
def print_of(name: str) -> tuple[Problem, Toolpath]:
    import tempfile

    folder = Path(tempfile.mkdtemp(prefix="faces"))
    shape, normals, spacing = SHEETS[name]
    written(folder, shape(), "sheet.step")
    bead = f"width_mm: {spacing:g}, height_mm: 0.8"
    text = BASE.replace("width_mm: 0.6, height_mm: 0.5", bead) + "  corner_tolerance_mm: 0.5\n"
    path = folder / "sheet.yaml"
    path.write_text(text + PRINT.format(normals, spacing))
    problem = load_problem(path)
    return problem, build_toolpath(problem)


@pytest.mark.slow
@pytest.mark.parametrize("heights", [BENDS_ONCE, BENDS_TWICE])
def test_normals_between_corners_are_those_of_the_face(tmp_path: Path, heights: tuple[float, ...]) -> None:
    """Where a surface turns back, triangles as flat as it is may be so long that normals between their ends are not its."""
    path = written(tmp_path, s_sheet(heights))
    given = {"file": path, "normals": "outward", "origin": (0.0, 0.0, 0.0), "rpy": (0.0, 0.0, 0.0)}
    mesh = meshed_faces(StepSpec.model_construct(**given), "all")
    assert not isinstance(mesh, NotRead)
    shares = np.random.default_rng(0).dirichlet([1.0, 1.0, 1.0], (len(mesh.corners), 20))
    points, normals = (
        np.einsum("mwk,mkx->mwx", shares, corners).reshape(-1, 3) for corners in (mesh.corners, mesh.normals)
    )
    heights_of = BPoly(1e-3 * np.array(heights)[:, None], [0.0, 1e-3 * LENGTH])
    true = np.column_stack([-heights_of.derivative()(points[:, 0]), np.zeros(len(points)), np.ones(len(points))])
    sine = np.linalg.norm(np.cross(true, normals), axis=1)
    assert (sine / np.linalg.norm(true, axis=1) / np.linalg.norm(normals, axis=1)).max() < np.sin(TURNED)
    bend = heights_of.derivative(2)(points[:, 0]) / np.linalg.norm(true, axis=1) ** 3
    side = np.sign((true * normals).sum(axis=1))
    assert np.repeat(np.abs(mesh.bends).max(axis=1), 20).max() == pytest.approx(np.abs(bend).max(), rel=0.05)
    least, most = (np.repeat(mesh.bends[:, k], 20) for k in range(2))
    assert (side * bend > least - 2.0).all() and (side * bend < most + 2.0).all()  # 1/m: an end's, not the middle's


@pytest.mark.slow
def test_what_is_read_ahead_is_read_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    given = {"normals": "outward", "origin": (0.0, 0.0, 0.0), "rpy": (0.0, 0.0, 0.0)}
    part = StepSpec.model_construct(file=written(tmp_path, s_sheet(BENDS_ONCE)), **given)
    begun: list[object] = []
    popen = subprocess.Popen

    def counted(*arguments: Any, **options: Any) -> subprocess.Popen[bytes]:
        begun.append(arguments)
        return popen(*arguments, **options)

    monkeypatch.setattr(subprocess, "Popen", counted)
    with read_ahead(part, "all"):
        mesh = meshed_faces(part, "all")
    assert not isinstance(mesh, NotRead)
    with read_ahead(part, "all"):
        assert meshed_faces(part, "all") is mesh
    assert len(begun) == 1
    with read_ahead(StepSpec.model_construct(file=tmp_path / "none.step", **given), "all"):
        assert len(begun) == 1


@pytest.mark.slow
@pytest.mark.parametrize("name", SHEETS)
def test_a_true_print_passes(name: str) -> None:
    findings = found(*print_of(name))
    assert not failed(findings), findings
    assert {PART, NORMAL, INSIDE, FILLED} <= {check.name for check in findings.checks}
    assert not [check for check in findings.checks if "not read" in check.where]


def changed(beads: tuple[Bead, ...], by: Callable[[Bead], tuple[Array, Array]]) -> list[Bead]:
    """The beads, their points and normals replaced."""
    return [replace(bead, points=points, normals=normals) for bead in beads for points, normals in (by(bead),)]


@pytest.mark.slow
@pytest.mark.parametrize("name", SHEETS)
def test_a_spoilt_print_fails(name: str) -> None:
    """Turned, off its height, leaning by half a degree, or a bead too few."""
    problem, toolpath = print_of(name)
    turn, lean = (
        Rotation.from_euler(axes, degrees, degrees=True) for axes, degrees in (("z", 5.0), ("xy", [0.5, 0.5]))
    )
    middle = np.mean([bead.points.mean(axis=0) for bead in toolpath.beads], axis=0)

    def lost(by: Callable[[Bead], tuple[Array, Array]]) -> set[str]:
        return failed(found(problem, toolpath, changed(toolpath.beads, by)))

    assert lost(lambda b: (turn.apply(b.points - middle) + middle, turn.apply(np.array(b.normals)))) & {PART, INSIDE}
    for off in (3e-4, -3e-4, 3e-5):
        assert PART in lost(lambda b, off=off: (b.points + off * b.normals, b.normals))
    assert NORMAL in lost(lambda b: (b.points, lean.apply(np.array(b.normals))))
    assert FILLED in failed(found(problem, toolpath, list(toolpath.beads[1:])))
