"""Reads faces from a STEP or IGES file with Open CASCADE: each an exact B-spline surface with the curves that trim it.

It runs as a separate process (see `files.py`): a damaged file can crash it anywhere, without a message.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from OCP.BRep import BRep_Builder, BRep_Tool
from OCP.BRepAdaptor import BRepAdaptor_Curve, BRepAdaptor_Curve2d
from OCP.BRepBuilderAPI import BRepBuilderAPI_NurbsConvert, BRepBuilderAPI_Sewing
from OCP.BRepTools import BRepTools, BRepTools_WireExplorer
from OCP.collections import Array1_double
from OCP.GeomAbs import GeomAbs_Shape
from OCP.Standard import Standard_Failure
from OCP.TopAbs import TopAbs_Orientation, TopAbs_ShapeEnum
from OCP.TopExp import TopExp_Explorer
from OCP.TopoDS import TopoDS, TopoDS_Compound

from planner.base.arrays import Array
from planner.base.isolated import answer
from planner.toolpath.step.files import Damaged, choose_faces
from planner.toolpath.step.shapes import REPAIR, all_faces, subshapes

_FEWEST = 3  # points in a loop
_CHORD = 2e-3  # mm: greatest deviation of the straight lines between an edge's points from the edge
_MOST_POINTS = 4000  # on an edge
_LOOKS = 65  # places on an edge at which its curvature is measured


def read(request: dict[str, Any]) -> dict[str, Any]:
    """Arrays of the requested faces (see `answered`): `k.poles` etc. of face k, the number of `faces`, and `notes`.

    Raises Damaged.
    """
    name = Path(request["file"]).name
    try:
        found = all_faces(request["file"])
        chosen = choose_faces(request["faces"], [(i + 1, title) for i, title in enumerate(found.names)], name)
        faces, notes = _converted([found.faces[i - 1] for i in chosen], found.loose, request["sew_mm"])
        arrays = _arrays(faces, chosen, [found.names[i - 1] for i in chosen], request["apart_mm"])
        return arrays | {"notes": [*found.notes, *notes]}
    except Standard_Failure as error:
        raise Damaged(f"{name} is damaged: {error}", REPAIR) from error


def _compound(faces: Sequence[Any]) -> Any:
    builder, compound = BRep_Builder(), TopoDS_Compound()
    builder.MakeCompound(compound)
    for face in faces:
        builder.Add(compound, face)
    return compound


def _converted(faces: list[Any], loose: bool, sew: float) -> tuple[list[Any], list[str]]:
    """The faces with B-spline surfaces, and notes; faces that only touch are sewn so that they share edges.

    loose: the file joins none; otherwise they are sewn only if one shares no edge. sew: mm between edges to be joined.
    """
    notes = []
    if len(faces) > 1 and (loose or _apart(faces)):
        sewing = BRepBuilderAPI_Sewing(sew)
        for face in faces:
            sewing.Add(face)
        sewing.Perform()
        sewn = subshapes(sewing.SewedShape(), TopAbs_ShapeEnum.TopAbs_FACE)  # these know their orientation
        places = [sewn.FindIndex(sewing.Modified(face)) for face in faces]
        lost = [face for face, place in zip(faces, places, strict=True) if not place]
        faces = [TopoDS.Face(sewn.FindKey(place)) for place in places if place] if not lost else faces
        joined, free = sewing.NbContigousEdges(), sewing.NbFreeEdges()
        note = f"{len(faces)} loose faces could not be sewn" if lost else f"{len(faces)} loose faces were sewn"
        note += f" at {joined} edge{'' if joined == 1 else 's'}, within {sew:g} mm"
        notes.append(note + (f"; {free} edges are free: part.step.sew_mm joins edges farther apart" if free else ""))
    converted = subshapes(BRepBuilderAPI_NurbsConvert(_compound(faces), True).Shape(), TopAbs_ShapeEnum.TopAbs_FACE)
    return [TopoDS.Face(converted.FindKey(i + 1)) for i in range(len(faces))], notes


def _apart(faces: Sequence[Any]) -> bool:
    """Whether a face shares no edge with any other."""
    maps = [subshapes(face, TopAbs_ShapeEnum.TopAbs_EDGE) for face in faces]
    count: dict[int, int] = {}
    shared = subshapes(_compound(faces), TopAbs_ShapeEnum.TopAbs_EDGE)
    index = [[shared.FindIndex(edges.FindKey(i)) for i in range(1, edges.Size() + 1)] for edges in maps]
    for numbers in index:
        for number in numbers:
            count[number] = count.get(number, 0) + 1
    return any(all(count[number] == 1 for number in numbers) for numbers in index)


def _arrays(faces: Sequence[Any], numbers: Sequence[int], names: Sequence[str], apart: float) -> dict[str, Any]:
    known = subshapes(_compound(faces), TopAbs_ShapeEnum.TopAbs_EDGE)
    out: dict[str, Any] = {"faces": len(faces), "numbers": list(numbers), "names": list(names)}
    sides = []
    senses: dict[int, list[tuple[int, int]]] = {}  # for each edge: its faces, and in which direction they run along it
    for k, shape in enumerate(faces):
        knots_u, knots_v, poles = _surface(shape)
        out |= {f"{k}.knots_u": knots_u, f"{k}.knots_v": knots_v, f"{k}.poles": poles}
        reverse = shape.Orientation() == TopAbs_Orientation.TopAbs_REVERSED
        sides.append(-1 if reverse else 1)
        wires = _wires(shape)
        for w, wire in enumerate(wires):
            places, on = [], []
            for edge, forward in wire:
                index = known.FindIndex(edge)
                senses.setdefault(index, []).append((k, 1 if forward != reverse else -1))
                at = _edge_points(edge, _with_side(shape), apart)
                at = at if forward else at[::-1]
                places.append(at[:-1])
                on.append(np.full(len(at) - 1, index, dtype=np.int64))
            if sum(len(place) for place in places) < _FEWEST:
                raise Damaged(f"face {numbers[k]} has no edge around it", REPAIR)
            out |= {f"{k}.loop.{w}": np.vstack(places), f"{k}.edges.{w}": np.concatenate(on)}
        out[f"{k}.loops"] = len(wires)
    out["sides"] = [side * flip for side, flip in zip(sides, _flips(len(faces), senses), strict=True)]
    return out


def _with_side(face: Any) -> Any:
    return TopoDS.Face(face.Oriented(TopAbs_Orientation.TopAbs_FORWARD))


def _surface(face: Any) -> tuple[Array, Array, Array]:
    """Knots along u and v and homogeneous poles (nu, nv, 4) of a converted face [mm]."""
    given = BRep_Tool.Surface_s(face)
    surface = given.Copy()
    for closed, open_up in (
        (surface.IsUPeriodic(), surface.SetUNotPeriodic),
        (surface.IsVPeriodic(), surface.SetVNotPeriodic),
    ):
        if closed:
            open_up()
    u, v = (
        [k.Value(i) for i in range(k.Lower(), k.Upper() + 1)]
        for k in (surface.UKnotSequence(), surface.VKnotSequence())
    )
    poles = np.empty((surface.NbUPoles(), surface.NbVPoles(), 4))
    for i in range(poles.shape[0]):
        for j in range(poles.shape[1]):
            p, w = surface.Pole(i + 1, j + 1), surface.Weight(i + 1, j + 1)
            poles[i, j] = p.X() * w, p.Y() * w, p.Z() * w, w
    return np.array(u), np.array(v), poles


def _wires(face: Any) -> list[list[tuple[Any, bool]]]:
    """The edges around a face, in order, and whether they run forwards; the outer wire first."""
    face = _with_side(face)
    outer = BRepTools.OuterWire_s(face)
    wires = []
    found = TopExp_Explorer(face, TopAbs_ShapeEnum.TopAbs_WIRE)
    while found.More():
        wires.append(TopoDS.Wire(found.Current()))
        found.Next()
    wires.sort(key=lambda wire: not wire.IsSame(outer))
    out = []
    for wire in wires:
        edges = []
        walk = BRepTools_WireExplorer(wire, face)
        while walk.More():
            edge = walk.Current()
            edges.append((edge, edge.Orientation() == TopAbs_Orientation.TopAbs_FORWARD))
            walk.Next()
        out.append(edges)
    return out


def _edge_points(edge: Any, face: Any, apart: float) -> Array:
    """Parameters (n, 2) on a face of places along an edge, in the edge's direction; the same places on every face."""
    flat = BRepAdaptor_Curve2d(edge, face)
    first, last = flat.FirstParameter(), flat.LastParameter()
    t = np.linspace(first, last, _LOOKS) if BRep_Tool.Degenerated_s(edge) else _places(edge, apart)
    out = np.empty((len(t), 2))
    for i, at in enumerate(t):
        p = flat.Value(float(at))
        out[i] = p.X(), p.Y()
    return out


def _places(edge: Any, apart: float) -> Array:
    """Curve parameters of an edge, from one of its corners to the next in even steps."""
    curve = BRepAdaptor_Curve(edge)
    pieces = curve.NbIntervals(GeomAbs_Shape.GeomAbs_C1)
    bounds = Array1_double(1, pieces + 1)
    curve.Intervals(bounds, GeomAbs_Shape.GeomAbs_C1)
    corners = [bounds.Value(i) for i in range(1, pieces + 2)]
    out = []
    for a, b in zip(corners[:-1], corners[1:], strict=True):
        inner = np.linspace(a, b, _LOOKS)[1:-1]
        rates = np.array([[curve.DN(float(t), k).Magnitude() for k in (1, 2)] for t in inner])
        needed = (b - a) * max(float(rates[:, 0].max()) / (apart), float(np.sqrt(rates[:, 1].max() / (8.0 * _CHORD))))
        out.append(np.linspace(a, b, min(max(int(np.ceil(needed)), 1), _MOST_POINTS) + 1)[:-1])
    return np.append(np.concatenate(out), corners[-1])


def _flips(count: int, senses: dict[int, list[tuple[int, int]]]) -> list[int]:
    """For each face 1, or -1 if its orientation is opposite to that of the faces joined to it."""
    beside: list[list[tuple[int, int]]] = [[] for _ in range(count)]
    for on in senses.values():
        for i, (a, along_a) in enumerate(on):
            for b, along_b in on[i + 1 :]:
                if a != b:
                    beside[a].append((b, -along_a * along_b))
                    beside[b].append((a, -along_a * along_b))
    flips = [0] * count
    for start in range(count):
        if flips[start]:
            continue
        flips[start] = 1
        stack = [start]
        while stack:
            a = stack.pop()
            for b, same in beside[a]:
                if not flips[b]:
                    flips[b] = flips[a] * same
                    stack.append(b)
    return flips


def answered(request: dict[str, Any]) -> dict[str, Any]:
    """The answer to a request (file, faces, apart_mm, sew_mm), or the reason why there is none."""
    try:
        return read(request)
    except Damaged as error:
        return {"reason": error.reason, "hint": error.hint or ""}


if __name__ == "__main__":
    sys.exit(answer(answered))
