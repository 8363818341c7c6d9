"""Faces of a STEP or IGES file as triangles of Open CASCADE's own mesher, with normals at their corners.

It runs as a process of its own (`step_faces.py`): a damaged file can end it at any place, without a word.
"""

from __future__ import annotations

import sys
from typing import Any

import numpy as np
from OCP.BRep import BRep_Tool
from OCP.BRepAdaptor import BRepAdaptor_Surface
from OCP.BRepMesh import BRepMesh_IncrementalMesh
from OCP.gp import gp_Pnt, gp_Vec
from OCP.IFSelect import IFSelect_ReturnStatus
from OCP.IGESControl import IGESControl_Reader
from OCP.Message import Message
from OCP.Standard import Standard_Failure
from OCP.STEPControl import STEPControl_Reader
from OCP.TopAbs import TopAbs_Orientation, TopAbs_ShapeEnum
from OCP.TopExp import TopExp_Explorer
from OCP.TopLoc import TopLoc_Location
from OCP.TopoDS import TopoDS

from planner.base.arrays import Array, Ints
from planner.base.isolated import answer

_ANGLE = 0.05  # rad between triangles
_SMALLEST = 1e-12  # mm^2 per parameter: where surfaces have no normal, as at poles
_WHEREVER = -1  # an entity is found by its shape, wherever an assembly puts that


def triangles(request: dict[str, Any]) -> dict[str, Any]:
    """Of face k that a request names (see `answered`) `k.points` [mm], `k.normals` as the file has them, `k.corners`; `faces`, how
    many; and `sure`, whether a body says which way each looks. `reason` instead where there are none."""
    for printer in list(Message.DefaultMessenger_s().Printers()):
        Message.DefaultMessenger_s().RemovePrinter(printer)
    reader = IGESControl_Reader() if request["iges"] else STEPControl_Reader()
    if reader.ReadFile(request["file"]) != IFSelect_ReturnStatus.IFSelect_RetDone:
        return {"reason": "it cannot be read"}
    if request["iges"]:
        reader.SetReadVisible(True)
        if not reader.NbRootsForTransfer():
            reader.SetReadVisible(False)
    reader.TransferRoots()
    if not reader.NbShapes():
        return {"reason": "it holds no shape"}
    shape = reader.OneShape()
    inside = _faces(shape, TopAbs_ShapeEnum.TopAbs_SOLID)
    found = _faces(shape)
    wanted = request["faces"]
    source = reader.WS().TransferReader()
    names = [_name(source.EntityFromShapeResult(face, _WHEREVER)) for face in found]
    chosen = [
        face
        for number, (face, name) in enumerate(zip(found, names, strict=True), 1)
        if wanted == "all" or number in wanted or name in wanted
    ]
    out: dict[str, Any] = {}
    sure: list[bool] = []
    for face in chosen:
        BRepMesh_IncrementalMesh(face, request["off_mm"], False, _ANGLE, False)
        k = len(sure)
        meshed = _meshed(face)
        if meshed is None:
            return {"reason": "a face cannot be meshed"}
        out |= {f"{k}.points": meshed[0], f"{k}.normals": meshed[1], f"{k}.corners": meshed[2]}
        sure.append(any(face.IsSame(other) for other in inside))
    return out | {"faces": len(sure), "sure": np.array(sure, dtype=bool)}


def _faces(shape: Any, of: Any = None) -> list[Any]:
    """The faces of a shape, or of all its subshapes of a kind, each once, in the order in which they stand there."""
    out: list[Any] = []
    known: dict[int, list[Any]] = {}
    wholes = [shape]
    if of is not None:
        walk = TopExp_Explorer(shape, of)
        wholes = []
        while walk.More():
            wholes.append(walk.Current())
            walk.Next()
    for whole in wholes:
        walk = TopExp_Explorer(whole, TopAbs_ShapeEnum.TopAbs_FACE)
        while walk.More():
            face = TopoDS.Face(walk.Current())
            alike = known.setdefault(hash(face), [])
            if not any(face.IsSame(other) for other in alike):
                alike.append(face)
                out.append(face)
            walk.Next()
    return out


def _name(entity: Any) -> str:
    """What the file calls a face: by its name, in IGES by its property or its label."""
    if entity is None:
        return ""
    if hasattr(entity, "ShortLabel"):
        text = entity.NameValue() if entity.HasName() else entity.ShortLabel()
    else:
        text = entity.Name() if hasattr(entity, "Name") else None
    return "" if text is None else str(text.ToCString()).strip()


def _meshed(face: Any) -> tuple[Array, Array, Ints] | None:
    """Corners of triangles: points (n, 3) [mm], normals (n, 3) out of the face; and triangles (m, 3). None for no mesh."""
    place = TopLoc_Location()
    mesh = BRep_Tool.Triangulation_s(face, place)
    if mesh is None:
        return None
    surface, moved = BRepAdaptor_Surface(face), place.Transformation()
    flip = -1.0 if face.Orientation() == TopAbs_Orientation.TopAbs_REVERSED else 1.0
    count = mesh.NbNodes()
    points, normals = np.empty((count, 3)), np.full((count, 3), np.nan)
    at, along_u, along_v = gp_Pnt(), gp_Vec(), gp_Vec()
    for i in range(count):
        node, uv = mesh.Node(i + 1).Transformed(moved), mesh.UVNode(i + 1)
        points[i] = node.X(), node.Y(), node.Z()
        surface.D1(uv.X(), uv.Y(), at, along_u, along_v)
        out = along_u.Crossed(along_v)
        if out.Magnitude() > _SMALLEST:
            out.Normalize()
            normals[i] = flip * out.X(), flip * out.Y(), flip * out.Z()
    corners = np.array([mesh.Triangle(i + 1).Get() for i in range(mesh.NbTriangles())], dtype=np.int64) - 1
    return points, normals, corners[:, ::-1] if flip < 0.0 else corners


def answered(request: dict[str, Any]) -> dict[str, Any]:
    """The answer to a request (file, iges, faces, off_mm: by how much triangles may leave faces), or why there is none."""
    try:
        return triangles(request)
    except Standard_Failure as error:
        return {"reason": f"Open CASCADE: {error}"}


if __name__ == "__main__":
    sys.exit(answer(answered))
