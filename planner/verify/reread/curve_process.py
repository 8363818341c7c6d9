"""Curves of a STEP or IGES file that bound no face, as polylines of Open CASCADE's own discretisation.

It runs as a separate process (started by `plane_curves.py`): a damaged file can end it anywhere, without a message.
"""

from __future__ import annotations

import sys
from typing import Any

import numpy as np
from OCP.BRepAdaptor import BRepAdaptor_Curve
from OCP.GCPnts import GCPnts_TangentialDeflection
from OCP.IFSelect import IFSelect_ReturnStatus
from OCP.IGESControl import IGESControl_Reader
from OCP.Message import Message
from OCP.STEPControl import STEPControl_Reader
from OCP.TopAbs import TopAbs_Orientation, TopAbs_ShapeEnum
from OCP.TopExp import TopExp_Explorer
from OCP.TopoDS import TopoDS

from planner.base.arrays import Array
from planner.base.isolated import answer

_TURN, _OFF = 0.005, 0.001  # rad between chords, and mm that chords may lie off the curve
_FEWEST = 200  # least number of points of an edge
_ONE = 2e-3  # mm: edges whose ends are nearer are parts of one curve


def lines(request: dict[str, Any]) -> dict[str, Any]:
    """Points (n, 3) [mm] of each curve, by its number; or the `reason` why there are none."""
    for printer in list(Message.DefaultMessenger_s().Printers()):
        Message.DefaultMessenger_s().RemovePrinter(printer)
    reader = IGESControl_Reader() if request["iges"] else STEPControl_Reader()
    if reader.ReadFile(request["file"]) != IFSelect_ReturnStatus.IFSelect_RetDone or not reader.TransferRoots():
        return {"reason": "it cannot be read"}
    walk = TopExp_Explorer(reader.OneShape(), TopAbs_ShapeEnum.TopAbs_EDGE, TopAbs_ShapeEnum.TopAbs_FACE)
    out: list[list[Array]] = []
    while walk.More():
        points = _points(TopoDS.Edge(walk.Current()))
        walk.Next()
        if out and not _near(out[-1][0][0], out[-1][-1][-1]):
            if len(out[-1]) == 1 and not _touches(out[-1][0][-1], points) and _touches(out[-1][0][0], points):
                out[-1] = [out[-1][0][::-1]]
            if _touches(out[-1][-1][-1], points):
                out[-1].append(points if _near(out[-1][-1][-1], points[0]) else points[::-1])
                continue
        out.append([points])
    return {str(k): np.vstack(parts) for k, parts in enumerate(out)} if out else {"reason": "it holds no curve"}


def _near(one: Array, other: Array) -> bool:
    return bool(np.linalg.norm(one - other) < _ONE)


def _touches(place: Array, points: Array) -> bool:
    return _near(place, points[0]) or _near(place, points[-1])


def _points(edge: Any) -> Array:
    along = GCPnts_TangentialDeflection(BRepAdaptor_Curve(edge), _TURN, _OFF, _FEWEST)
    points = np.array([along.Value(i).Coord() for i in range(1, along.NbPoints() + 1)])
    return points[::-1] if edge.Orientation() == TopAbs_Orientation.TopAbs_REVERSED else points


if __name__ == "__main__":
    sys.exit(answer(lines))
