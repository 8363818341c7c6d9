"""The body to print on: the section `part` of the problem file."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, model_validator

from planner.problem.fields import PATH, Angles, Position, Quantity, Section, Vector, exactly_one, key, one_of, refusal
from planner.problem.yaml_file import describe


class CylinderSpec(Section):
    """An upright cylinder, standing on the part frame's xy plane."""

    radius: Annotated[float, Quantity("mm", 0.1, 2000)] = key("radius_mm", "radius [mm]")
    height: Annotated[float, Quantity("mm", 0.1, 10_000)] = key("height_mm", "height [mm]")
    centre: Annotated[tuple[float, float], Quantity("mm", -10_000, 10_000, count=2)] = key(
        "centre_mm", "its axis in the part frame, x and y [mm]", (0, 0)
    )


class SphereSpec(Section):
    """A ball; where it reaches below the bed, it is a dome."""

    radius: Annotated[float, Quantity("mm", 0.1, 5000)] = key("radius_mm", "radius [mm]")
    centre: Position = key("centre_mm", "its centre in the part frame [mm]", (0, 0, 0))


Size = Annotated[tuple[float, float], Quantity("mm", 1, 20_000, count=2)]


class PlaneSpec(Section):
    """A level or inclined plane, solid beneath."""

    size: Size = key("size_mm", "its extent around the centre, in x and y of the part frame [mm]")
    centre: Position = key("centre_mm", "its centre in the part frame [mm]", (0, 0, 0))
    slope: Annotated[float, Quantity("deg", 0, 75)] = key(
        "slope_deg", "its angle to the part frame's xy plane [deg]", 0
    )
    rises: Annotated[float, Quantity("deg", -360, 360)] = key(
        "rises_deg", "the direction in which it rises, counted from x towards y [deg]", 0
    )


class CorrugationSpec(Section):
    """A sheet of regular waves, solid beneath."""

    amplitude: Annotated[float, Quantity("mm", 0.001, 1000)] = key(
        "amplitude_mm", "height of its crests above the middle, and depth of its troughs [mm]"
    )
    wavelength: Annotated[float, Quantity("mm", 0.1, 10_000)] = key("wavelength_mm", "from crest to crest [mm]")
    size: Size = key("size_mm", "its extent around the centre, in x and y of the part frame [mm]")
    direction: Annotated[float, Quantity("deg", -360, 360)] = key(
        "direction_deg", "the direction from crest to crest, counted from x towards y [deg]", 0
    )
    centre: Position = key("centre_mm", "the point at mid-height below a crest, in the part frame [mm]", (0, 0, 0))


class EllipsoidSpec(Section):
    """An upright ellipsoid; where it reaches below the bed, it is a dome, such as a bowl turned upside down."""

    radii: Annotated[Vector, Quantity("mm", 0.1, 5000, count=3)] = key("radii_mm", "half axes along x, y and z [mm]")
    centre: Position = key("centre_mm", "its centre in the part frame [mm]", (0, 0, 0))


# How a file of facets becomes a body in millimetres: keys shared by all sections that name such a file.

UNITS = {"mm": 1.0, "cm": 10.0, "m": 1000.0, "in": 25.4, "ft": 304.8, "um": 1e-3}  # mm
UnitName = Literal["mm", "cm", "m", "in", "ft", "um"]
Unit = Annotated[UnitName, one_of(tuple(UNITS))]
Scale = Annotated[float, Quantity("", 1e-6, 1e6)]
Smooth = Annotated[float, Quantity("mm", 0.05, 5)]


def unit_key() -> Unit | None:
    """The field for a file's unit."""
    field: Unit | None = key(
        "unit", f"unit of the file's lengths: {', '.join(UNITS)}; default: the one it states, else mm", None
    )
    return field


def scale_key() -> Scale:
    """The field for the factor by which a file is enlarged."""
    field: Scale = key("scale", "factor by which the file is enlarged about its origin, before it is turned", 1)
    return field


def smooth_key() -> Smooth | None:
    """The field for how far a smooth surface may deviate from facets."""
    field: Smooth | None = key(
        "smooth_mm",
        "how far beads may lie off the facets, on the smoothest surface within that tolerance [mm]; "
        "default: 0.05, and up to 0.5 where facets are coarse or noisy",
        None,
    )
    return field


class MeshSpec(Section):
    """A body from a file of facets; beads are laid on what is visible of it from above."""

    file: Annotated[Path, PATH] = key(
        "file", "the file (STL, PLY, OBJ, OFF, 3MF, STEP or IGES), path relative to the problem file's folder"
    )
    unit: Unit | None = unit_key()
    scale: Scale = scale_key()
    origin: Position = key("origin_mm", "the file's origin in the part frame, once the file is turned [mm]", (0, 0, 0))
    rpy: Angles = key(
        "rpy_deg",
        "the file turned about x, then y, then z of the part frame [deg]; [90, 0, 0] where y points up",
        (0, 0, 0),
    )
    smooth: Smooth | None = smooth_key()


NOISIEST_MM = 5.0  # of scans: points farther off are not noise


class ScanSpec(Section):
    """A bed or part as scanned: a smooth surface through noisy points or facets, seen from above."""

    file: Annotated[Path, PATH] = key(
        "file",
        "the scan: points (PLY, XYZ, TXT, CSV, ASC, PTS, NPY, NPZ) or facets (STL, PLY, OBJ, OFF), path relative to "
        "the problem file's folder",
    )
    unit: Unit | None = unit_key()
    scale: Scale = scale_key()
    origin: Position = key("origin_mm", "the file's origin in the part frame, once the file is turned [mm]", (0, 0, 0))
    rpy: Angles = key("rpy_deg", "the file turned about x, then y, then z of the part frame [deg]", (0, 0, 0))
    noise: Annotated[float, Quantity("mm", 0.01, NOISIEST_MM)] = key(
        "noise_mm",
        "how far points may lie off the smooth surface; if one is farther off, the scan is refused [mm]",
        0.5,
    )
    hole: Annotated[float, Quantity("mm", 0.5, 100)] | None = key(
        "hole_mm",
        "how wide a gap without points may be under the curves [mm]; default: five times the usual distance between "
        "points, at least 2",
        None,
    )


Face = int | str  # its number in the file, from 1, or its name

ANY_FACES = "all, or a list of names and numbers (from 1) as in the file"


def _faces(value: Any) -> Any:
    if value == "all":
        return value
    if not isinstance(value, (tuple, list)):
        raise refusal(f"must be a list of faces or all, not {describe(value)}", ANY_FACES)
    if not value:
        raise refusal("names no face", ANY_FACES)
    for i, face in enumerate(value):
        if type(face) not in (int, str) or face == "":
            raise refusal(f"is neither a name nor a number of a face: {describe(face)}", ANY_FACES, item=i)
        if face in value[:i]:
            raise refusal(f"{face!r} appears twice in the list", "name each face once", item=i)
    return tuple(value)


Faces = Annotated[tuple[Face, ...] | Literal["all"], BeforeValidator(_faces)]


class StepSpec(Section):
    """A body from a STEP or IGES file: faces, with material beneath them."""

    file: Annotated[Path, PATH] = key("file", "the file (STEP or IGES), path relative to the problem file's folder")
    faces: Faces = key("faces", f"the faces to use: {ANY_FACES}", "all")
    normals: Annotated[Literal["outward", "inward"], one_of(("outward", "inward"))] = key(
        "normals", "which way the file's faces point: out of the material, or into it, as open sheets may", "outward"
    )
    origin: Position = key("origin_mm", "the file's origin in the part frame, once the file is turned [mm]", (0, 0, 0))
    rpy: Angles = key("rpy_deg", "the file turned about x, then y, then z of the part frame [deg]", (0, 0, 0))
    thickness: Annotated[float, Quantity("mm", 0, 1000)] = key(
        "thickness_mm",
        "thickness of the material beneath open faces [mm]; 0: none, the sheet is printed in the air",
        10,
    )
    sew: Annotated[float, Quantity("mm", 1e-4, 1)] = key(
        "sew_mm", "how far apart edges of loose faces, as in IGES files, may be and still be joined [mm]", 1e-2
    )


class PartSpec(Section):
    """The body to print on: one of these."""

    model_config = exactly_one("cylinder", "sphere", "ellipsoid", "plane", "corrugation", "mesh", "scan", "step")

    cylinder: CylinderSpec | None = key("cylinder", "an upright cylinder; default: none", None)
    sphere: SphereSpec | None = key("sphere", "a ball or a dome; default: none", None)
    ellipsoid: EllipsoidSpec | None = key("ellipsoid", "an ellipsoid, or a dome or bowl of it; default: none", None)
    plane: PlaneSpec | None = key("plane", "a level or inclined plane; default: none", None)
    corrugation: CorrugationSpec | None = key("corrugation", "a sheet of regular waves; default: none", None)
    mesh: MeshSpec | None = key("mesh", "a file of facets; default: none", None)
    scan: ScanSpec | None = key("scan", "a scan with noise, smoothed; default: none", None)
    step: StepSpec | None = key("step", "faces of a STEP or IGES file; default: none", None)

    @property
    def body(self) -> str:
        """The key of the body that is given."""
        return next(name for name in type(self).model_fields if getattr(self, name) is not None)

    @model_validator(mode="after")
    def _one_body(self) -> PartSpec:
        given = [name for name in type(self).model_fields if getattr(self, name) is not None]
        if len(given) == 1:
            return self
        names = list(type(self).model_fields)
        if not given:
            raise refusal("no body is given", f"give one of them: {', '.join(names)}")
        raise refusal(f"both {given[0]} and {given[1]} are given", "give one of them", fields=given)
