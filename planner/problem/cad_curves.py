"""Curves of a STEP or IGES file as B-splines, by Open CASCADE: lines, arcs and splines that bound no face.

It runs as a separate process (`curve_files.py`), because a damaged file can crash it at any point.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
from OCP.BRep import BRep_Tool
from OCP.BRepAdaptor import BRepAdaptor_Curve
from OCP.Geom import Geom_TrimmedCurve
from OCP.GeomConvert import GeomConvert, GeomConvert_CompCurveToBSplineCurve
from OCP.IFSelect import IFSelect_ReturnStatus
from OCP.IGESControl import IGESControl_Reader
from OCP.Precision import Precision
from OCP.Standard import Standard_Failure
from OCP.TopAbs import TopAbs_Orientation, TopAbs_ShapeEnum
from OCP.TopExp import TopExp_Explorer
from OCP.TopoDS import TopoDS

from planner.base.arrays import Array
from planner.base.isolated import answer
from planner.problem.cad_facets import quiet_reader

MEETS = 1e-3  # mm between an edge's end and the next one's start: up to this, they are one curve
_REPAIR = "repair it in a CAD program, and export it again"
# IGES entities (version 5.3, chapter 4) that are curves, by number
_KINDS = {100: "arc", 102: "chain of curves", 104: "conic", 106: "polyline", 110: "line", 112: "spline"}
_KINDS |= {126: "B-spline curve", 130: "offset curve"}
_SHOWN = 6  # curves listed in a message
_EXPORT = "export the curves themselves: edges of a body do not count"


def curves(request: dict[str, Any]) -> dict[str, Any]:
    """The curves of a file, in its order, or why there are none.

    `curves` is their number; curve k has `k.degree`, `k.points` (n, 3) [mm], `k.weights` (n) and `k.knots`. Consecutive
    edges, each of which starts where the one before ends, are one curve.
    """
    name = Path(request["file"]).name
    reader = quiet_reader(request["file"])
    try:
        if reader.ReadFile(request["file"]) != IFSelect_ReturnStatus.IFSelect_RetDone:
            return {"reason": f"{name} is damaged", "hint": _REPAIR}
        lost = _transferred(reader)
        if lost:
            listed = ", ".join(lost[:_SHOWN]) + (f" and {len(lost) - _SHOWN} more" if len(lost) > _SHOWN else "")
            return {"reason": f"{name} has curves that cannot be read: {listed}", "hint": _REPAIR}
        found, endless = _edges(reader.OneShape()) if reader.NbShapes() else ([], 0)
        if endless:
            reason = f"{endless} of the {len(found) + endless} edges in {name} are infinite lines"
            return {"reason": reason, "hint": "export it without construction lines, or trim them"}
        if not found:
            return {"reason": f"{name} holds no curves other than the edges of faces", "hint": _EXPORT}
        joined = _joined(found)
    except Standard_Failure as error:
        return {"reason": f"{name} is damaged: {error}", "hint": _REPAIR}
    out: dict[str, Any] = {"curves": len(joined)}
    for k, curve in enumerate(joined):
        out |= {f"{k}.{key}": value for key, value in _arrays(curve).items()}
    return out


def _transferred(reader: Any) -> list[str]:
    """Transfer a file's contents; returns IGES curves that are damaged or gave no shape, by kind and directory line."""
    iges = isinstance(reader, IGESControl_Reader)
    lost: dict[int, Any] = {}
    checks = reader.WS().ModelCheckList(True)
    checks.Start()
    while checks.More():
        if iges and checks.Number() > 0 and checks.Value().HasFailed():
            lost[2 * checks.Number() - 1] = reader.IGESModel().Value(checks.Number())
        checks.Next()
    for i in range(1, reader.NbRootsForTransfer() + 1):
        before = reader.NbShapes()
        reader.TransferOneRoot(i)
        if iges and reader.NbShapes() == before:
            root = reader.RootForTransfer(i)
            lost[reader.IGESModel().DNum(root)] = root
    return [f"{_KINDS[each.TypeNumber()]} D{k}" for k, each in sorted(lost.items()) if each.TypeNumber() in _KINDS]


def _edges(shape: Any) -> tuple[list[Any], int]:
    """The B-spline curves of all edges that bound no face, each in its own direction; and how many are infinite."""
    out, endless = [], 0
    walk = TopExp_Explorer(shape, TopAbs_ShapeEnum.TopAbs_EDGE, TopAbs_ShapeEnum.TopAbs_FACE)
    while walk.More():
        edge = TopoDS.Edge(walk.Current())
        walk.Next()
        if BRep_Tool.Degenerated_s(edge):
            continue
        ends = BRepAdaptor_Curve(edge)
        if Precision.IsInfinite_s(ends.FirstParameter()) or Precision.IsInfinite_s(ends.LastParameter()):
            endless += 1
            continue
        whole = BRep_Tool.Curve_s(edge, 0.0, 1.0)
        curve = GeomConvert.CurveToBSplineCurve_s(Geom_TrimmedCurve(whole, ends.FirstParameter(), ends.LastParameter()))
        if curve.IsPeriodic():
            curve.SetNotPeriodic()
        if edge.Orientation() == TopAbs_Orientation.TopAbs_REVERSED:
            curve.Reverse()
        out.append(curve)
    return out, endless


def _joined(edges: list[Any]) -> list[Any]:
    """Join consecutive edges into one curve each; files hardly ever say which way they run."""
    out: list[Any] = []
    alone = False  # the last curve is a single edge, and may be reversed
    for edge in edges:
        if out and not out[-1].IsClosed():
            last = out[-1]
            if alone and not _meet(last.EndPoint(), edge) and _meet(last.StartPoint(), edge):
                last.Reverse()
            if _meet(last.EndPoint(), edge):
                if last.EndPoint().Distance(edge.StartPoint()) > MEETS:
                    edge.Reverse()
                chain = GeomConvert_CompCurveToBSplineCurve(last)
                if chain.Add(edge, MEETS, True):
                    out[-1], alone = chain.BSplineCurve(), False
                    continue
        out.append(edge)
        alone = True
    return out


def _meet(place: Any, edge: Any) -> bool:
    return min(place.Distance(edge.StartPoint()), place.Distance(edge.EndPoint())) <= MEETS


def _arrays(curve: Any) -> dict[str, Array | int]:
    poles = [curve.Pole(i) for i in range(1, curve.NbPoles() + 1)]
    knots = curve.KnotSequence()
    first, last = curve.FirstParameter(), curve.LastParameter()
    return {
        "degree": curve.Degree(),
        "points": np.array([(p.X(), p.Y(), p.Z()) for p in poles]),
        "weights": np.array([curve.Weight(i) for i in range(1, curve.NbPoles() + 1)]),
        "knots": np.array([(knots.Value(i) - first) / (last - first) for i in range(knots.Lower(), knots.Upper() + 1)]),
    }


if __name__ == "__main__":
    sys.exit(answer(curves))
