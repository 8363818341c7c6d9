"""Curves of STEP and IGES files as sources: those that bound no face, read twice, and files that hold none."""

from __future__ import annotations

import signal
import subprocess
import sys
from contextlib import nullcontext
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from OCP.BRep import BRep_Builder
from OCP.BRepBuilderAPI import BRepBuilderAPI_MakeEdge, BRepBuilderAPI_MakeWire
from OCP.BRepPrimAPI import BRepPrimAPI_MakeBox
from OCP.collections import Array1_double, Array1_gp_Pnt, Array1_int
from OCP.GC import GC_MakeArcOfCircle
from OCP.Geom import Geom_BSplineCurve
from OCP.gp import gp_Ax2, gp_Circ, gp_Dir, gp_Lin, gp_Pnt
from OCP.IGESControl import IGESControl_Writer
from OCP.STEPControl import STEPControl_StepModelType, STEPControl_Writer
from OCP.TopoDS import TopoDS_Compound
from scipy.spatial import cKDTree
from solved import solve_alone

from planner.base.errors import InputError
from planner.problem import Problem, load_problem
from planner.problem.cad_files import asked
from planner.problem.curve_files import read_curves
from planner.problem.drawings import CurveSpec
from planner.problem.part import StepSpec
from planner.toolpath.nurbs import nurbs_paths
from planner.verify.reread.plane_curves import NotRead, _nurbs_file
from planner.verify.reread.step_faces import meshed_faces
from planner.verify.verdict import verify

KINDS = ("step", "igs", "inches")
HALF, SPACING = 40.0, 30.0  # mm


def compound(*shapes: Any) -> Any:
    whole, builder = TopoDS_Compound(), BRep_Builder()
    builder.MakeCompound(whole)
    for shape in shapes:
        builder.Add(whole, shape)
    return whole


def written(shape: Any, folder: Path, kind: str = "step") -> Path:
    """A shape in a file: STEP, IGES in mm, or IGES in inches."""
    if kind == "step":
        path = folder / "curves.step"
        writer = STEPControl_Writer()
        writer.Transfer(shape, STEPControl_StepModelType.STEPControl_AsIs)
        writer.Write(str(path))
        return path
    path = folder / f"{kind}.igs"
    iges = IGESControl_Writer("IN" if kind == "inches" else "MM", 0)
    iges.AddShape(shape)
    iges.ComputeModel()
    iges.Write(str(path))
    return path


def spline(points: Any, weights: Any, knots: Any, counts: Any, degree: int) -> Any:
    """The edge of a rational B-spline curve."""
    poles, heavy = Array1_gp_Pnt(1, len(points)), Array1_double(1, len(points))
    for i, (point, weight) in enumerate(zip(points, weights, strict=True), 1):
        poles.SetValue(i, gp_Pnt(*map(float, point)))
        heavy.SetValue(i, float(weight))
    at, many = Array1_double(1, len(knots)), Array1_int(1, len(knots))
    for i, (knot, count) in enumerate(zip(knots, counts, strict=True), 1):
        at.SetValue(i, float(knot))
        many.SetValue(i, int(count))
    return BRepBuilderAPI_MakeEdge(Geom_BSplineCurve(poles, heavy, at, many, degree)).Edge()


def slot() -> tuple[Any, Any]:
    """A line that goes on in an arc, and a circle above the plane."""
    line = BRepBuilderAPI_MakeEdge(gp_Pnt(-HALF, 0, 0), gp_Pnt(-10, 0, 0)).Edge()
    arc = BRepBuilderAPI_MakeEdge(GC_MakeArcOfCircle(gp_Pnt(-10, 0, 0), gp_Pnt(0, 10, 0), gp_Pnt(10, 0, 0)).Value())
    ring = BRepBuilderAPI_MakeEdge(gp_Circ(gp_Ax2(gp_Pnt(0, -SPACING, 5), gp_Dir(0, 0, 1)), 8.0)).Edge()
    return BRepBuilderAPI_MakeWire(line, arc.Edge()).Wire(), ring


def complain(reason: str, hint: str | None = None) -> InputError:
    return InputError(reason, field="layers.source.nurbs", hint=hint)


def paths_in(path: Path) -> list[np.ndarray]:
    return [each.points for each in nurbs_paths(read_curves(path, complain), lambda _: complain)]


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_lines_and_arcs_that_follow_one_another_are_one_curve(tmp_path: Path, kind: str) -> None:
    way, ring = paths_in(written(compound(*slot()), tmp_path, kind))
    np.testing.assert_allclose(way[[0, -1]] * 1e3, [[-HALF, 0, 0], [10, 0, 0]], atol=1e-6)
    length = np.linalg.norm(np.diff(way, axis=0), axis=1).sum() * 1e3
    assert length == pytest.approx(30.0 + 10.0 * np.pi, abs=1e-2)
    assert np.abs(np.linalg.norm(ring * 1e3 - [0, -SPACING, 5], axis=1) - 8.0).max() < 1e-6
    np.testing.assert_array_equal(ring[0], ring[-1])


@pytest.mark.slow
@pytest.mark.parametrize("turned", range(8))
def test_edges_of_a_wire_may_run_either_way(tmp_path: Path, turned: int) -> None:
    """Three edges in a row, each written from either of its ends."""
    places = [gp_Pnt(-HALF, 0, 0), gp_Pnt(-10, 0, 0), gp_Pnt(0, 20, 0), gp_Pnt(30, 20, 6)]
    edges = []
    for k, (a, b) in enumerate(zip(places[:-1], places[1:], strict=True)):
        edges.append(BRepBuilderAPI_MakeEdge(*((b, a) if turned >> k & 1 else (a, b))).Edge())
    path = written(compound(*edges), tmp_path)
    (way,) = paths_in(path)
    theirs = _nurbs_file(path)
    assert not isinstance(theirs, NotRead) and len(theirs) == 1
    for line in (way, theirs[0]):
        np.testing.assert_allclose(line[[0, -1]] * 1e3, [[-HALF, 0, 0], [30, 20, 6]], atol=1e-6)
        length = np.linalg.norm(np.diff(line, axis=0), axis=1).sum() * 1e3
        assert length == pytest.approx(30.0 + np.hypot(10, 20) + np.hypot(30, 6), abs=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_a_nurbs_curve_keeps_its_degree_points_and_weights(tmp_path: Path, kind: str) -> None:
    points, weights = [(-70, -20, 0), (-25, -55, 4), (25, 15, 0), (70, -20, 9)], (1.0, 0.8, 1.5, 1.0)
    (found,) = read_curves(
        written(compound(spline(points, weights, (0, 0.3, 1), (3, 1, 3), 2)), tmp_path, kind), complain
    )
    assert found.degree == 2
    np.testing.assert_allclose(np.array(found.points) * 1e3, points, atol=1e-9)
    np.testing.assert_allclose(np.array(found.weights) / found.weights[0], weights, atol=1e-12)
    assert found.knots is not None
    knots = np.array(found.knots)
    np.testing.assert_allclose((knots - knots[0]) / (knots[-1] - knots[0]), [0, 0, 0, 0.3, 1, 1, 1], atol=1e-12)


@pytest.mark.slow
@settings(max_examples=12, deadline=None)
@given(st.data(), st.sampled_from((1, 2, 3, 4, 5, 14)))
def test_other_code_reads_the_same_curves(
    tmp_path_factory: pytest.TempPathFactory, data: st.DataObject, degree: int
) -> None:
    """The planner's B-splines against points of Open CASCADE's own evaluator, both ways."""
    count = data.draw(st.integers(degree + 1, degree + 4))
    number = st.floats(-30.0, 30.0)
    points = [(12.0 * k, data.draw(number), data.draw(number)) for k in range(count)]
    weights = [data.draw(st.floats(0.3, 3.0)) for _ in range(count)]
    inner = count - degree
    knots, counts = np.linspace(0.0, 1.0, inner + 1), [degree + 1, *[1] * (inner - 1), degree + 1]
    path = written(compound(spline(points, weights, knots, counts, degree)), tmp_path_factory.mktemp("curve"))
    (ours,), theirs = paths_in(path), _nurbs_file(path)
    assert not isinstance(theirs, NotRead) and len(theirs) == 1
    for one, other in ((ours, theirs[0]), (theirs[0], ours)):
        a, b = other[:-1], np.diff(other, axis=0)
        near = cKDTree(0.5 * (other[1:] + other[:-1])).query(one, k=min(16, len(a)))[1].reshape(len(one), -1)
        u = np.clip(((one[:, None] - a[near]) * b[near]).sum(-1) / np.maximum((b[near] ** 2).sum(-1), 1e-18), 0.0, 1.0)
        assert np.linalg.norm(a[near] + u[..., None] * b[near] - one[:, None], axis=2).min(axis=1).max() < 0.01e-3


# ---- a print -----------------------------------------------------------------------------------------------------


def printed(path: Path, *changes: str) -> Problem:
    return load_problem("fibre_plane", (f"layers.source={{nurbs: '{path}'}}", *changes))


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_a_tow_along_the_curves_of_a_file_is_verified(tmp_path: Path, kind: str) -> None:

    def edges(off: float) -> Any:
        return compound(
            *(
                spline(
                    [(-70, y, 0), (-25, y - 35, 0), (25, y + 35, 0), (70, y, 0)],
                    (1, 1, 1, 1),
                    (0, 0.5, 1),
                    (3, 1, 3),
                    2,
                )
                for y in (-30 + off, 0, 30)
            )
        )

    plan = solve_alone(printed(written(edges(0.0), tmp_path, kind), "strategy=greedy"))
    assert [check.name for check in plan.checks if not check.ok] == []
    assert len(plan.beads) == 3
    written(edges(1.0), tmp_path, kind)  # one curve of the file is now elsewhere
    report = verify(plan.problem, plan.cell, plan.toolpath, plan.trajectory)
    assert {"drawn path left out", "print on the drawn path"} <= {each.name for each in report.checks if not each.ok}


# ---- what is wrong with a file -----------------------------------------------------------------------------------


def whole(folder: Path, kind: str = "step") -> bytes:
    return written(compound(*slot()), folder, kind).read_bytes()


def spoilt(text: str, how: str) -> str:
    """An IGES file whose unit or a line of which a reader can only guess."""
    lines = text.splitlines()
    if how == "text":  # the name of the unit is longer by a character
        return text.replace("2HMM", "3HMM")
    if how == "shifted":
        lines[2] = lines[2][1:]
    else:  # the values of a line no longer say whose they are
        k = next(i for i, line in enumerate(lines) if line.startswith("110,") and line[72] == "P")
        lines[k] = f"{lines[k][:64]:72}{lines[k][72:]}"
    return "\n".join(lines) + "\n"


@pytest.mark.slow
def test_iges_without_ends_of_lines(tmp_path: Path) -> None:
    path = written(compound(*slot()), tmp_path, "igs")
    apart = read_curves(path, complain)
    path.write_text("".join(f"{line:80}" for line in path.read_text().splitlines()))
    assert read_curves(path, complain) == apart
    assert not isinstance(_nurbs_file(path), NotRead)


@pytest.mark.slow(
    cases=("curves.step-lines*", "curves.step-endless*", "curves.igs-lost*", "curves.step-far*", "curves.step-cusp*")
)
@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("gone.igs", None, "gone.igs"),
        ("curves.stp", b"%PDF-1.4\n", "curves.stp is not a STEP file"),
        ("curves.iges", b"solid facets\n", "curves.iges is not an IGES file: its first line has no S in column 73"),
        ("curves.step", "cut", "curves.step is damaged: its end is missing"),
        ("curves.igs", "cut", "curves.igs is damaged: its end is missing"),
        (
            "curves.step",
            "box",
            "curves.step holds no curves other than the edges of faces (export the curves themselves",
        ),
        ("curves.step", "far", "curve 1 of 1 in curves.step has a coordinate of 200000 mm"),
        ("curves.step", "endless", "1 of the 1 edges in curves.step are infinite lines"),
        ("curves.igs", "text", "value 15 of its header is a text whose stated length is wrong, so the"),
        ("curves.igs", "shifted", "line 3, in its header, has neither S nor G in column 73, so the unit"),
        ("curves.igs", "lost", "curves.igs has curves that cannot be read: line D"),
        ("curves.step", "cusp", "curve 1 turns back on itself at"),
        ("curves.step", "lines", "curves.step is damaged"),
    ],
)
def test_what_cannot_be_taken_is_told(tmp_path: Path, name: str, content: Any, words: str) -> None:
    path = tmp_path / name
    shapes = {
        "box": lambda: BRepPrimAPI_MakeBox(10.0, 10.0, 10.0).Shape(),
        "endless": lambda: BRepBuilderAPI_MakeEdge(gp_Lin(gp_Pnt(0, 0, 0), gp_Dir(1, 0, 0))).Edge(),
        "far": lambda: spline([(0, 0, 0), (2e5, 0, 0)], (1, 1), (0, 1), (2, 2), 1),
        "cusp": lambda: spline([(0, 0, 0), (20, 0, 0), (0, 0, 0)], (1, 1, 1), (0, 0.5, 1), (2, 1, 2), 1),
    }
    if content in shapes:
        path = written(compound(shapes[content]()), tmp_path)
    elif content == "cut":
        data = whole(tmp_path, "step" if name.endswith("step") else "igs")
        path.write_bytes(data[: len(data) // 2])
    elif content in ("text", "shifted", "lost"):
        path.write_text(spoilt(whole(tmp_path, "igs").decode(), content))
    elif content == "lines":
        path.write_bytes(b"ISO-10303-21;\nHEADER;\nENDSEC;\nDATA;\n#1=NONSENSE(;\nENDSEC;\nEND-ISO-10303-21;\n")
    elif content is not None:
        path.write_bytes(content)
    with pytest.raises(InputError) as caught:
        paths_in(path)
    assert words in str(caught.value) and caught.value.exit_code == 2


@pytest.mark.slow
def test_a_verifier_that_cannot_read_the_file_says_so(tmp_path: Path) -> None:
    box = written(BRepPrimAPI_MakeBox(10.0, 10.0, 10.0).Shape(), tmp_path)
    assert _nurbs_file(box) == NotRead("curves.step: it holds no curve")
    assert isinstance(_nurbs_file(written(compound(*slot()), tmp_path, "igs")), tuple)


@pytest.mark.skipif(sys.platform == "win32", reason="signals as on Linux and macOS")
def test_a_reader_that_is_killed_tells_nothing_about_its_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "part.step"
    path.write_bytes(b"ISO-10303-21;\nEND-ISO-10303-21;\n")
    part = StepSpec.model_construct(file=path, normals="outward", origin=(0.0, 0.0, 0.0), rpy=(0.0, 0.0, 0.0))
    done = SimpleNamespace(returncode=-signal.SIGKILL, communicate=lambda timeout: (b"", None), kill=lambda: None)
    monkeypatch.setattr(subprocess, "Popen", lambda *_, **__: nullcontext(done))
    with pytest.raises(InputError, match=r"part\.step cannot be read: the system killed"):
        asked("any", {}, "part.step", complain)
    for found in (_nurbs_file(path), meshed_faces(part, "all")):
        assert isinstance(found, NotRead) and "memory runs out" in found.why
    done.returncode = -signal.SIGSEGV
    with pytest.raises(InputError, match=r"part\.step is damaged"):
        asked("any", {}, "part.step", complain)
    assert _nurbs_file(path) == NotRead("part.step: it cannot be read")
    assert meshed_faces(part, "all") == NotRead("Open CASCADE ends while it reads or meshes the file")


@pytest.mark.slow
def test_the_curves_are_those_of_the_problem_file(tmp_path: Path) -> None:
    """The same curve given in the problem, and in a file, is the same polyline."""
    points = [(-70, -20, 0), (-25, -55, 0), (25, 15, 0), (70, -20, 0)]
    (ours,) = paths_in(written(compound(spline(points, (1, 1, 1, 1), (0, 0.5, 1), (3, 1, 3), 2)), tmp_path))
    spec = CurveSpec.model_validate({"degree": 2, "points_mm": tuple(points)})
    (theirs,) = nurbs_paths([spec], lambda _: complain)
    np.testing.assert_allclose(ours, theirs.points, atol=1e-12)
