"""Faces of a STEP or IGES file as triangles of Open CASCADE's own mesher, with normals at their corners.

It runs as a separate process (started by `step_faces.py`): a damaged file can end it anywhere, without a message.
"""

from __future__ import annotations

import sys
from typing import Any, NamedTuple

import numpy as np
from OCP.BRep import BRep_Tool
from OCP.BRepAdaptor import BRepAdaptor_Surface
from OCP.BRepLProp import BRepLProp_SLProps
from OCP.BRepMesh import BRepMesh_IncrementalMesh
from OCP.gp import gp_Pnt, gp_Pnt2d
from OCP.IFSelect import IFSelect_ReturnStatus
from OCP.IGESControl import IGESControl_Reader
from OCP.IMeshTools import IMeshTools_Parameters
from OCP.Message import Message
from OCP.ShapeAnalysis import ShapeAnalysis_Surface
from OCP.Standard import Standard_Failure
from OCP.STEPControl import STEPControl_Reader
from OCP.TopAbs import TopAbs_Orientation, TopAbs_ShapeEnum
from OCP.TopExp import TopExp_Explorer
from OCP.TopLoc import TopLoc_Location
from OCP.TopoDS import TopoDS

from planner.base.arrays import Array, Ints
from planner.base.isolated import answer

_ANGLE = 0.05  # rad between triangles
_SMALLEST = 1e-12  # mm^2 per parameter: below it surfaces have no normal, as at poles
_NEAR = 1e-6  # mm
_COARSE = 16.0  # × the allowed distance, for first triangles within a face: the mesher takes long for small ones
_CUTS = 5  # most cuts of a triangle, two of them for _COARSE: a sharp edge within a surface would be cut without end
_WHEREVER = -1  # an entity is found by its shape, wherever an assembly places it


def triangles(request: dict[str, Any]) -> dict[str, Any]:
    """Triangles of the faces that a request names (see `answered`), or the `reason` why there are none.

    For face k: `k.points` [mm], `k.normals` as in the file, `k.bends` (n, 2) [1/mm], its principal curvatures, positive
    in hollows, and `k.corners`; `faces`: the number of faces; `sure`: whether a solid determines which way each looks.
    """
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
        BRepMesh_IncrementalMesh(face, _mesher_settings(request["off_mm"]))
        k = len(sure)
        meshed = _meshed(face, request["off_mm"], request["turned"])
        if meshed is None:
            return {"reason": "a face cannot be meshed"}
        out |= {f"{k}.{name}": values for name, values in meshed.items()}
        sure.append(any(face.IsSame(other) for other in inside))
    return out | {"faces": len(sure), "sure": np.array(sure, dtype=bool)}


def _mesher_settings(off: float) -> IMeshTools_Parameters:
    """Settings of the mesher for triangles at most `off` [mm] from a face: that exact at its edges, coarser within."""
    wanted = IMeshTools_Parameters()
    wanted.Deflection, wanted.DeflectionInterior = off, _COARSE * off
    wanted.Angle = wanted.AngleInterior = _ANGLE
    return wanted


def _faces(shape: Any, of: Any = None) -> list[Any]:
    """The faces of a shape, or of all its subshapes of one kind, each once, in their order there."""
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
    """A face's name in the file; in IGES its name property or its label."""
    if entity is None:
        return ""
    if hasattr(entity, "ShortLabel"):
        text = entity.NameValue() if entity.HasName() else entity.ShortLabel()
    else:
        text = entity.Name() if hasattr(entity, "Name") else None
    return "" if text is None else str(text.ToCString()).strip()


def _meshed(face: Any, off: float, turned: float) -> dict[str, Array | Ints] | None:
    """A face's triangles: points (n, 3) [mm], outward normals (n, 3) and bends (n, 2) [1/mm], both NaN at poles; and
    corners (m, 3), the points of each triangle. None if there is no mesh.

    The mesher makes a coarse mesh, and misses bends where a surface turns back, as at the middle of an S; so triangles
    are cut into four where the face halfway along a side is more than `off` [mm] from it, or its normal more than
    `turned` [rad] from the mean of those at the ends.
    """
    place = TopLoc_Location()
    mesh = BRep_Tool.Triangulation_s(face, place)
    if mesh is None:
        return None
    moved, count = place.Transformation(), mesh.NbNodes()
    uv, nodes = np.empty((count, 2)), np.empty((count, 3))
    for i in range(count):
        at, node = mesh.UVNode(i + 1), mesh.Node(i + 1).Transformed(moved)
        uv[i], nodes[i] = (at.X(), at.Y()), (node.X(), node.Y(), node.Z())
    net = _Local.of(face, uv)._replace(points=nodes)
    corners = np.array([mesh.Triangle(i + 1).Get() for i in range(mesh.NbTriangles())], dtype=np.int64) - 1
    done = []
    for _ in range(_CUTS):
        net, whole, corners = _cut(face, net, corners, off, turned)
        done.append(whole)
        if not len(corners):
            break
    corners = np.concatenate([*done, corners])
    flip = -1.0 if face.Orientation() == TopAbs_Orientation.TopAbs_REVERSED else 1.0
    if flip < 0.0:
        corners = corners[:, ::-1]
    return {"points": net.points, "normals": flip * net.normals, "bends": flip * net.bends, "corners": corners}


class _Local(NamedTuple):
    """A surface at parameters uv (n, 2): points (n, 3) [mm], normals (n, 3), and principal curvatures, bends (n, 2) [1/mm]."""

    uv: Array
    points: Array
    normals: Array
    bends: Array

    @classmethod
    def of(cls, face: Any, uv: Array) -> _Local:
        """For a face; normals and bends are NaN at poles."""
        points, normals, bends = np.empty((len(uv), 3)), np.full((len(uv), 3), np.nan), np.full((len(uv), 2), np.nan)
        local = BRepLProp_SLProps(BRepAdaptor_Surface(face), 2, _SMALLEST)
        for i, (u, v) in enumerate(uv.tolist()):
            local.SetParameters(u, v)
            at, out = local.Value(), local.D1U().Crossed(local.D1V())
            points[i] = at.X(), at.Y(), at.Z()
            if out.Magnitude() > _SMALLEST:
                out.Normalize()
                normals[i] = out.X(), out.Y(), out.Z()
                if local.IsCurvatureDefined():
                    bends[i] = local.MinCurvature(), local.MaxCurvature()
        return cls(uv, points, normals, bends)


def _cut(face: Any, net: _Local, corners: Ints, off: float, turned: float) -> tuple[_Local, Ints, Ints]:
    """The net with added points, the triangles (m, 3) that are flat enough, and those that others were cut into."""
    sides = np.sort(np.stack([corners, np.roll(corners, -1, axis=1)], axis=2), axis=2).reshape(-1, 2)
    sides, which = np.unique(sides, axis=0, return_inverse=True)
    halfway, chord = _Local.of(face, net.uv[sides].mean(axis=1)), net.points[sides].mean(axis=1)
    between = net.normals[sides].sum(axis=1)
    cosine = (between * halfway.normals).sum(axis=1) / np.linalg.norm(between, axis=1)
    sag = np.abs(((halfway.points - chord) * halfway.normals).sum(axis=1))
    middles = which.reshape(-1, 3)
    cut = ((cosine < np.cos(turned)) | (sag > off))[middles].any(axis=1)  # NaN, at poles, cuts nothing
    used, place = np.unique(middles[cut], return_inverse=True)
    added = _Local.of(face, _beside(face, halfway.uv[used], chord[used]))
    (a, b, c), (d, e, f) = corners[cut].T, len(net.uv) + place.reshape(-1, 3).T
    four = np.concatenate([np.column_stack(three) for three in ((a, d, f), (d, b, e), (f, e, c), (d, e, f))])
    return _Local(*map(np.concatenate, zip(net, added, strict=True))), corners[~cut], four


def _beside(face: Any, uv: Array, points: Array) -> Array:
    """Parameters (n, 2) of the places of a face nearest to points (n, 3) [mm], searched from uv (n, 2).

    Halfway between parameters may be far from halfway between points: triangles cut there would leave holes next to
    those that are not cut.
    """
    surface, out = ShapeAnalysis_Surface(BRep_Tool.Surface_s(face)), np.empty_like(uv)
    for i, ((u, v), point) in enumerate(zip(uv.tolist(), points.tolist(), strict=True)):
        found = surface.NextValueOfUV(gp_Pnt2d(u, v), gp_Pnt(*point), _NEAR)
        out[i] = found.X(), found.Y()
    return out


def answered(request: dict[str, Any]) -> dict[str, Any]:
    """The answer to a request, or the reason why there is none.

    Request: file, iges, faces; off_mm and turned [rad]: how far triangles may lie off faces, and their normals be off.
    """
    try:
        return triangles(request)
    except Standard_Failure as error:
        return {"reason": f"Open CASCADE: {error}"}


if __name__ == "__main__":
    sys.exit(answer(answered))
