"""An aerofoil core: the section `layers` of the problem file, where layers fill what is between a body and a middle."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal

from pydantic import model_validator

from planner.problem.drawings import OnPartSpec, PatternSpec
from planner.problem.fields import Quantity, Section, Thickness, exactly_one, key, one_of, refusal
from planner.problem.materials import MaterialName, material_key
from planner.problem.part import MeshSpec


class MiddleSpec(Section):
    """What the lower half of a core reaches up to, and is reflected at: one of these."""

    model_config = exactly_one("z_mm", "mesh")

    z: Annotated[float, Quantity("mm", -100_000, 100_000)] | None = key(
        "z_mm", "height of a level plane in the part frame [mm]; default: none, but mesh", None
    )
    mesh: MeshSpec | None = key(
        "mesh", "a file of facets, of which counts what is seen from above; default: none", None
    )

    @model_validator(mode="after")
    def _one_middle(self) -> MiddleSpec:
        if (self.z is None) == (self.mesh is None):
            found = "neither z_mm nor mesh is" if self.z is None else "both z_mm and mesh are"
            raise refusal(f"{found} given", "give exactly one of them", fields=["z_mm", "mesh"])
        return self


class CoreLayersSpec(OnPartSpec):
    """What is printed, if it is a core: a pattern in layers from the part up to a middle, and the reflection on them."""

    bodies: ClassVar[tuple[str, ...]] = ("mesh",)

    source: PatternSpec = key("source", "where the curves come from")
    up_to: MiddleSpec = key("up_to", "the middle of the core: z_mm or mesh")
    halves: Annotated[Literal["both", "lower"], one_of(("both", "lower"))] = key(
        "halves", "what is printed: both halves, or the lower one", "both"
    )
    heights: Annotated[Literal["even", "varying"], one_of(("even", "varying"))] = key(
        "heights",
        "even: each layer height_mm above the one before, left out beyond the middle; "
        "varying: all layers from end to end, as high as their place asks",
        "even",
    )
    height: Thickness = key("height_mm", "vertical height of a layer; where heights vary, the greatest [mm]")
    least_height: Thickness | None = key(
        "least_height_mm",
        "where layers of varying height were less high than this, they are left out [mm]; default: a fifth of height_mm",
        None,
    )
    tilt: Annotated[float, Quantity("deg", 5, 75)] = key(
        "tilt_deg", "greatest tilt of a layer [deg]; where a layer is steeper, it is left out", 45
    )
    count: Annotated[int, Quantity("", 1, 10_000, whole=True)] | None = key(
        "count", "number of layers, from the first; default: all", None
    )
    material: MaterialName | None = material_key("all beads")

    @model_validator(mode="after")
    def _heights_in_order(self) -> CoreLayersSpec:
        if self.least_height is None:
            return self
        if self.heights == "even":
            raise refusal("heights are even", "leave out least_height_mm, or heights: varying", item="least_height_mm")
        if self.least_height > self.height:
            least, most = self.least_height * 1e3, self.height * 1e3
            reason = f"the least height, {least:g} mm, is more than the greatest, {most:g} mm"
            raise refusal(reason, "at most height_mm", item="least_height_mm")
        return self
