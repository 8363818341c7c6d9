"""Reads the faces of a STEP or IGES file and their names with Open CASCADE, and notes what could not be read."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

from OCP.collections import IndexedMap_TopoDS_Shape_TopTools_ShapeMapHasher
from OCP.IFSelect import IFSelect_ReturnStatus
from OCP.IGESControl import IGESControl_Reader
from OCP.Message import Message
from OCP.STEPControl import STEPControl_Reader
from OCP.TopAbs import TopAbs_ShapeEnum
from OCP.TopExp import TopExp
from OCP.TopoDS import TopoDS

from planner.base.budgets import STEP_FACES
from planner.problem.cad_files import is_iges
from planner.toolpath.step.files import Damaged

MOST_FACES = STEP_FACES.most
REPAIR = "repair it in a CAD program, and export it again"
_WHEREVER = -1  # finds an entity by its shape, wherever an assembly places it
_SHOWN = 6  # most entities that a sentence lists

# IGES entities (version 5.3, chapter 4) by number: faces, and others that can occur on their own.
_BOUNDED, _TRIMMED, _FACE = 143, 144, 510
_SURFACES = {108: "plane", 114: "spline surface", 118: "ruled surface", 120: "surface of revolution", 122: "cylinder"}
_SURFACES |= {128: "B-spline surface", 140: "offset surface", _BOUNDED: "bounded surface", _TRIMMED: "trimmed surface"}
_SURFACES |= {186: "solid", 190: "plane", 192: "cylinder", 194: "cone", 196: "sphere", 198: "torus", _FACE: "face"}
_OTHERS = {100: "arc", 102: "chain of curves", 104: "conic", 106: "polyline", 110: "line", 112: "spline", 116: "point"}
_OTHERS |= {126: "B-spline curve", 130: "offset curve", 142: "curve on a surface", 212: "text", 216: "dimension"}
_OTHERS |= {150: "block", 152: "wedge", 154: "cylinder", 156: "cone", 158: "sphere", 160: "torus", 180: "Boolean tree"}
_UNITS = range(1, 12)  # unit flags that the standard defines


class Found(NamedTuple):
    """Faces [mm], their names, whether the file leaves them loose, and sentences about what else was found."""

    faces: list[Any]
    names: list[str]
    loose: bool
    notes: list[str]


def subshapes(shape: Any, kind: Any) -> Any:
    """The subshapes of a kind, each once, numbered from 1."""
    found = IndexedMap_TopoDS_Shape_TopTools_ShapeMapHasher()
    TopExp.MapShapes_s(shape, kind, found)
    return found


def all_faces(file: str) -> Found:
    """All faces of a file. Raises Damaged where it has none, or too many."""
    name = Path(file).name
    messages = Message.DefaultMessenger_s()
    for printer in list(messages.Printers()):
        messages.RemovePrinter(printer)
    iges = is_iges(Path(file).read_bytes())
    reader = IGESControl_Reader() if iges else STEPControl_Reader()
    kind = "IGES" if iges else "STEP"
    if reader.ReadFile(file) != IFSelect_ReturnStatus.IFSelect_RetDone:
        raise Damaged(f"{name} is damaged: it cannot be read as {kind}", "export it again")
    notes = _transferred(reader, name) if iges else _transferred_step(reader)
    faces, entities = [], []
    if reader.NbShapes():
        transfer = reader.WS().TransferReader()
        known = subshapes(reader.OneShape(), TopAbs_ShapeEnum.TopAbs_FACE)
        for i in range(1, known.Size() + 1):
            faces.append(TopoDS.Face(known.FindKey(i)))
            entities.append(transfer.EntityFromShapeResult(faces[-1], _WHEREVER))
    names = [_name(entity) for entity in entities]
    loose = False
    if iges:
        loose = not any(entity is not None and entity.TypeNumber() == _FACE for entity in entities)
        notes += _unread(reader.IGESModel(), entities)
    if not faces:
        what = f": {'; '.join(notes)}" if notes else ""
        raise Damaged(f"{name} holds no face{what}", "export a body or a sheet, not curves or a drawing")
    if len(faces) > MOST_FACES:
        raise Damaged(f"{name} has {len(faces)} faces, more than {MOST_FACES}", "export the part without its details")
    return Found(faces, names, loose, notes)


def _transferred_step(reader: Any) -> list[str]:
    reader.TransferRoots()
    return []


def _transferred(reader: Any, name: str) -> list[str]:
    """Transfer the visible parts of an IGES file, or all parts if none is visible; returns a note on hidden ones."""
    notes = []
    everything = reader.NbRootsForTransfer()
    reader.SetReadVisible(True)
    shown = reader.NbRootsForTransfer()
    if not shown:
        reader.SetReadVisible(False)
    elif shown < everything:
        notes.append(f"{everything - shown} of {everything} hidden parts were not read")
    head = reader.IGESModel().GlobalSection()
    if head.UnitFlag() not in _UNITS or head.UnitValue() <= 0.0:
        named = head.UnitName().ToCString() if head.UnitName() is not None else ""
        raise Damaged(
            f"{name} gives lengths in a unit that IGES does not know (flag {head.UnitFlag()}, {named!r})",
            "export it again, in millimetres",
        )
    reader.TransferRoots()
    return notes


def _name(entity: Any) -> str:
    """Name of a face: that of its entity, in IGES its name property or label; empty if it has none."""
    if entity is None:
        return ""
    if hasattr(entity, "HasShortLabel"):
        if entity.HasName():
            return str(entity.NameValue().ToCString()).strip()
        return str(entity.ShortLabel().ToCString()).strip() if entity.HasShortLabel() else ""
    return str(entity.Name().ToCString()) if hasattr(entity, "Name") else ""


def _unread(model: Any, entities: Sequence[Any]) -> list[str]:
    """Notes on what did not become a face in an IGES file: surfaces by kind and directory line, and other entities."""
    read = {model.DNum(entity) for entity in entities if entity is not None}
    notes, lost, others = [], [], Counter[str]()
    for i in range(1, model.NbEntities() + 1):
        entity, number = model.Value(i), model.Value(i).TypeNumber()
        if 2 * i - 1 in read or entity.BlankStatus() == 1:
            continue
        if number in (_BOUNDED, _TRIMMED, _FACE):
            beneath = entity.Surface()
            if beneath is None or model.DNum(beneath) not in read:
                lost.append(f"{_SURFACES[number]} D{2 * i - 1}")
        elif entity.SubordinateStatus() == 0 and number in _OTHERS:
            others[_OTHERS[number]] += 1
    if lost:
        more = f" and {len(lost) - _SHOWN} more" if len(lost) > _SHOWN else ""
        notes.append(
            f"{len(lost)} of {len(lost) + len(read)} faces could not be read: {', '.join(lost[:_SHOWN])}{more}"
        )
    if others:
        listed = ", ".join(f"{count} {name}{'s' if count > 1 else ''}" for name, count in others.most_common(_SHOWN))
        notes.append(f"entities other than faces were passed over: {listed}")
    return notes
