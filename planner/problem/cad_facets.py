"""Facets of the bodies in a STEP or IGES file, by Open CASCADE.

It runs as a separate process (`cad_files.py`), because a damaged file can crash it at any point.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
from OCP.BRep import BRep_Tool
from OCP.BRepMesh import BRepMesh_IncrementalMesh
from OCP.IFSelect import IFSelect_ReturnStatus
from OCP.IGESControl import IGESControl_Reader
from OCP.Message import Message
from OCP.Standard import Standard_Failure
from OCP.STEPControl import STEPControl_Reader
from OCP.TopAbs import TopAbs_Orientation, TopAbs_ShapeEnum
from OCP.TopExp import TopExp_Explorer
from OCP.TopLoc import TopLoc_Location
from OCP.TopoDS import TopoDS

from planner.base.isolated import answer
from planner.problem.cad_files import is_iges

_TURN = 0.2  # rad between neighbouring facets of a curved face
_MERGED = 6  # decimals [mm] to which corners are rounded to merge them along edges that two faces share
_REPAIR = "repair it in a CAD program, and export it again"


def quiet_reader(file: str) -> Any:
    """A reader for a STEP or an IGES file that prints nothing."""
    messages = Message.DefaultMessenger_s()
    for printer in list(messages.Printers()):
        messages.RemovePrinter(printer)
    return IGESControl_Reader() if is_iges(Path(file).read_bytes()) else STEPControl_Reader()


def facets(request: dict[str, Any]) -> dict[str, Any]:
    """Corners (n, 3) [mm] and facets (m, 3) of all faces, or why there are none."""
    name = Path(request["file"]).name
    reader = quiet_reader(request["file"])
    try:
        if reader.ReadFile(request["file"]) != IFSelect_ReturnStatus.IFSelect_RetDone:
            return {"reason": f"{name} is damaged", "hint": _REPAIR}
        reader.TransferRoots()
        if not reader.NbShapes():
            return {"reason": f"{name} holds no body", "hint": "export a body, not curves or a drawing"}
        shape = reader.OneShape()
        BRepMesh_IncrementalMesh(shape, request["chord_mm"], False, _TURN, False)
        return _arrays(shape, name, request["most"])
    except Standard_Failure as error:
        return {"reason": f"{name} is damaged: {error}", "hint": _REPAIR}


def _arrays(shape: Any, name: str, most: int) -> dict[str, Any]:
    corners, triangles, count = [], [], 0
    faces = TopExp_Explorer(shape, TopAbs_ShapeEnum.TopAbs_FACE)
    while faces.More():
        face = TopoDS.Face(faces.Current())
        faces.Next()
        place = TopLoc_Location()
        mesh = BRep_Tool.Triangulation_s(face, place)
        if mesh is None:
            return {"reason": f"a face of {name} cannot be cut into facets", "hint": _REPAIR}
        move = place.Transformation()
        points = [mesh.Node(k).Transformed(move) for k in range(1, mesh.NbNodes() + 1)]
        own = np.array([mesh.Triangle(k).Get() for k in range(1, mesh.NbTriangles() + 1)]).reshape(-1, 3) - 1
        if (face.Orientation() == TopAbs_Orientation.TopAbs_REVERSED) != (move.IsNegative()):
            own = own[:, ::-1]
        corners.append(np.array([(p.X(), p.Y(), p.Z()) for p in points]).reshape(-1, 3))
        triangles.append(own + count)
        count += len(points)
        if sum(map(len, triangles)) > most:
            return {"reason": f"{name} becomes more than {most} facets", "hint": "export the body without its details"}
    if not triangles:
        return {"reason": f"{name} holds no face", "hint": "export a body, not curves or a drawing"}
    merged, which = np.unique(np.round(np.vstack(corners), _MERGED), axis=0, return_inverse=True)
    return {"corners": merged, "facets": which.reshape(-1)[np.vstack(triangles)]}


if __name__ == "__main__":
    sys.exit(answer(facets))
