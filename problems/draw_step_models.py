"""Draws the STEP files of the problems whose layers cover faces: a curved plate, a propeller blade and a shoehorn.

Run from the project's folder: python problems/draw_step_models.py. The same files come out every time. The paper's own
models (Onstein et al.) are not public; these are of the same kind and size.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Callable, Sequence
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from OCP.BRep import BRep_Builder
from OCP.BRepAlgoAPI import BRepAlgoAPI_Cut
from OCP.BRepBuilderAPI import BRepBuilderAPI_MakeFace, BRepBuilderAPI_Sewing
from OCP.BRepPrimAPI import BRepPrimAPI_MakeBox, BRepPrimAPI_MakeCylinder, BRepPrimAPI_MakePrism
from OCP.collections import Array1_double, Array1_int, Array2_gp_Pnt, IndexedMap_TopoDS_Shape_TopTools_ShapeMapHasher
from OCP.Geom import Geom_BSplineSurface
from OCP.gp import gp_Ax2, gp_Dir, gp_Pnt, gp_Vec
from OCP.Message import Message
from OCP.STEPConstruct import STEPConstruct
from OCP.STEPControl import STEPControl_StepModelType, STEPControl_Writer
from OCP.TCollection import TCollection_HAsciiString
from OCP.TopAbs import TopAbs_ShapeEnum
from OCP.TopExp import TopExp
from OCP.TopoDS import TopoDS, TopoDS_Compound
from scipy.interpolate import make_interp_spline

Array = NDArray[np.float64]

HERE = Path(__file__).resolve().parent
DEGREE = 3
DIGITS = 5  # of a millimetre, that poles are rounded to


def spline(points: Array) -> Geom_BSplineSurface:
    """The B-spline surface of degree 3 through a grid of points (m, n, 3) [mm], over the grid's indices."""
    knots = []
    poles = points
    for axis in (0, 1):
        one = make_interp_spline(np.arange(points.shape[axis], dtype=float), np.moveaxis(poles, axis, 0), k=DEGREE)
        poles = np.moveaxis(one.c, 0, axis)
        knots.append(one.t)
    return surface(np.round(poles, DIGITS), knots[0], knots[1])


def surface(poles: Array, u: Array, v: Array) -> Geom_BSplineSurface:
    """The B-spline surface of degree 3 with poles (m, n, 3) [mm] and knots with their multiplicities."""
    grid = Array2_gp_Pnt(1, poles.shape[0], 1, poles.shape[1])
    for i, j in np.ndindex(*poles.shape[:2]):
        grid.SetValue(i + 1, j + 1, gp_Pnt(*(float(x) for x in poles[i, j])))
    arrays = []
    for knots in (u, v):
        values, counts = np.unique(knots, return_counts=True)
        value, count = Array1_double(1, len(values)), Array1_int(1, len(values))
        for i, (knot, times) in enumerate(zip(values, counts, strict=True)):
            value.SetValue(i + 1, float(knot))
            count.SetValue(i + 1, int(times))
        arrays.append((value, count))
    (ku, mu), (kv, mv) = arrays
    return Geom_BSplineSurface(grid, ku, kv, mu, mv, DEGREE, DEGREE, False, False)


def patch(whole: Geom_BSplineSurface, u: tuple[float, float], v: tuple[float, float]) -> Any:
    """The part of a surface between two values of u and of v, as a face: exactly the same surface."""
    part = whole.Copy()
    part.Segment(*u, *v)
    return BRepBuilderAPI_MakeFace(part, 1e-7).Face()


def grid(at: Callable[[Array, Array], Array], m: int, n: int) -> Array:
    """Points (m, n, 3) of a surface given over the unit square."""
    return at(*np.meshgrid(np.linspace(0.0, 1.0, m), np.linspace(0.0, 1.0, n), indexing="ij"))


def faces_of(shape: Any) -> list[Any]:
    """The faces of a shape, each once."""
    found = IndexedMap_TopoDS_Shape_TopTools_ShapeMapHasher()
    TopExp.MapShapes_s(shape, TopAbs_ShapeEnum.TopAbs_FACE, found)
    return [TopoDS.Face(found.FindKey(i + 1)) for i in range(found.Size())]


def sewn(faces: Sequence[Any]) -> tuple[Any, list[Any]]:
    """One shell of faces that share their edges, and what each face has become."""
    sewing = BRepBuilderAPI_Sewing(1e-3)
    for face in faces:
        sewing.Add(face)
    sewing.Perform()
    return sewing.SewedShape(), [sewing.Modified(face) if sewing.IsModified(face) else face for face in faces]


def write(name: str, shape: Any, names: Sequence[tuple[Any, str]]) -> None:
    """A STEP file of a shape, some of its faces named; without the date and what else differs from day to day."""
    writer = STEPControl_Writer()
    writer.Transfer(shape, STEPControl_StepModelType.STEPControl_AsIs)
    finder = writer.WS().TransferWriter().FinderProcess()
    for face, title in names:
        STEPConstruct.FindEntity_s(finder, face).SetName(TCollection_HAsciiString(title))
    path = HERE / f"{name}.step"
    writer.Write(str(path))
    text = path.read_text(encoding="ascii")
    text = re.sub(r"FILE_NAME\(.*?\);", f"FILE_NAME('{name}','',(''),(''),'','','');", text, count=1, flags=re.DOTALL)
    text = re.sub(r"Open CASCADE STEP translator [0-9. ]+", name, text)
    number = count(1)  # counted on from file to file otherwise
    text = re.sub(r"(_USAGE_OCCURRENCE\(')\d+", lambda found: f"{found[1]}{next(number)}", text)
    path.write_text(text, encoding="ascii")


# A sheet of 200 x 400 x 200 mm that rises in an S, bent across as well; as thick as a bead is high is enough for it.


def curved_plate() -> None:
    """The curved rectangular surface: one face, `top`, of a plate 5 mm thick."""

    def at(s: Array, t: Array) -> Array:
        x, y = 200.0 * (s - 0.5), 400.0 * (t - 0.5)
        z = 90.0 * np.sin(np.pi * y / 400.0) + 100.0 - 10.0 * (2.0 * s - 1.0) ** 2
        return np.stack([x, y, z], axis=-1)

    top = BRepBuilderAPI_MakeFace(spline(grid(at, 7, 13)), 1e-7).Face()
    prism = BRepPrimAPI_MakePrism(top, gp_Vec(0.0, 0.0, -5.0))
    write("curved_plate", prism.Shape(), [(prism.FirstShape(), "top")])


# A shoehorn of 300 mm, hollow above: four faces that continue one another exactly, each with parameters of its own.


def shoehorn() -> None:
    """An open shell: faces `handle`, `neck` (two, side by side) and `spoon`."""

    def at(s: Array, t: Array) -> Array:
        across, y = 2.0 * s - 1.0, 300.0 * (t - 0.5)
        wide = t * t * (3.0 - 2.0 * t)
        x = (22.0 + 14.0 * wide) * across
        z = (3.0 + 9.0 * wide) * (across**2 - 1.0) + 6e-4 * y**2 + 0.05 * y + 15.0
        return np.stack([x, y, z], axis=-1)

    whole = spline(grid(at, 7, 11))
    last_u, last_v = 6.0, 10.0
    parts = [
        ("handle", (0.0, last_u), (0.0, 3.2)),
        ("neck", (0.0, 2.5), (3.2, 6.1)),
        ("neck", (2.5, last_u), (3.2, 6.1)),
        ("spoon", (0.0, last_u), (6.1, last_v)),
    ]
    faces = []
    for k, (_, u, v) in enumerate(parts):
        part = whole.Copy()
        part.Segment(*u, *v)
        if k == 1:
            part.ExchangeUV()
        elif k == 2:
            part.UReverse()
        elif k == 3:
            part.IncreaseDegree(4, 5)
        faces.append(BRepBuilderAPI_MakeFace(part, 1e-7).Face())
    shell, faces = sewn(faces)
    write("shoehorn", shell, [(face, name) for face, (name, _, _) in zip(faces, parts, strict=True)])


# A blade of 557 mm: sections with camber, less twist towards the tip, and a root to hold it.


def propeller_blade(file: str, spans: int, chords: int) -> None:
    """A shell of sides `suction` and `pressure` in so many faces each, on a block with a bore and bolt holes."""
    length = 557.0

    def side(sign: float) -> Callable[[Array, Array], Array]:
        def at(s: Array, t: Array) -> Array:
            y = length * (t - 0.5)
            chord = 70.0 + 130.0 * t * (1.0 - t) ** 0.7 + 10.0 * t - 40.0 * t**3
            twist = np.radians(28.0 - 26.0 * t + 6.0 * t * t)
            along = chord * (s - 0.45)
            camber = 0.06 * chord * (1.0 - (2.0 * s - 1.0) ** 2)
            thick = sign * (0.10 - 0.05 * t) * chord * (np.sin(np.pi * s) * (1.0 - 0.3 * s))
            up = camber + 0.5 * thick
            x, z = along * np.cos(twist) + up * np.sin(twist), -along * np.sin(twist) + up * np.cos(twist)
            return np.stack([x, y, z + 30.0 * t * t], axis=-1)

        return at

    faces, names = [], []
    for name, sign in (("suction", 1.0), ("pressure", -1.0)):
        whole = spline(grid(side(sign), 10, 13))
        u, v = np.linspace(0.0, 9.0, chords + 1), np.linspace(0.0, 12.0, spans + 1)
        for i, j in np.ndindex(chords, spans):
            faces.append(patch(whole, (u[i], u[i + 1]), (v[j], v[j + 1])))
            names.append(name)
    shell, faces = sewn(faces)
    block = BRepPrimAPI_MakeBox(gp_Pnt(-45.0, -0.5 * length - 70.0, -30.0), 90.0, 50.0, 60.0).Shape()
    for radius, x, z in ((16.0, 0.0, 0.0), *((4.0, x, z) for x in (-33.0, 33.0) for z in (-20.0, 20.0))):
        axis = gp_Ax2(gp_Pnt(x, -0.5 * length - 80.0, z), gp_Dir(0.0, 1.0, 0.0))
        block = BRepAlgoAPI_Cut(block, BRepPrimAPI_MakeCylinder(axis, radius, 80.0).Shape()).Shape()
    builder, both = BRep_Builder(), TopoDS_Compound()
    builder.MakeCompound(both)
    for shape in (shell, block):
        builder.Add(both, shape)
    write(file, both, [(face, name) for face, name in zip(faces, names, strict=True)])


def main() -> int:
    """Write the files."""
    messages = Message.DefaultMessenger_s()
    for printer in list(messages.Printers()):
        messages.RemovePrinter(printer)
    curved_plate()
    shoehorn()
    propeller_blade("propeller_blade", 1, 1)
    propeller_blade("propeller_blade_faces", 6, 3)
    return 0


if __name__ == "__main__":
    sys.exit(main())
