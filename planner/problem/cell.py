"""Arm, nozzle, positioner and the bodies around them: the sections `cell` and `collision` of the problem file."""

from __future__ import annotations

import itertools
from pathlib import Path
from typing import Annotated, Literal

from pydantic import field_validator, model_validator

from planner.problem.fields import (
    IDENTIFIER,
    INCREASING,
    PATH,
    ROBOT,
    TEXT,
    UNIQUE,
    UNIT_VECTOR,
    Angles,
    Position,
    Quantity,
    Section,
    Vector,
    exactly_one,
    key,
    one_of,
    refusal,
)

CARRIERS = ("world", "part")
MOUNTINGS = ("together", "one")
Side = Annotated[Vector, Quantity("mm", 0.1, 100_000, count=3)]

Text = Annotated[str, TEXT]
NozzleName = Annotated[str, IDENTIFIER]
RobotName = Annotated[str | Path, ROBOT]
Angle = Annotated[float, Quantity("deg", -3600, 3600)]  # ten turns: no cable allows more
Place = Annotated[float, Quantity("mm", -100_000, 100_000)]
Ring = Annotated[tuple[float, float], Quantity("mm", 0, 2000, count=2)]
MOST_JOINTS = 12  # of an arm; its own file says how many it has


class CylinderSolidSpec(Section):
    """A cylinder about its own z axis."""

    radius: Annotated[float, Quantity("mm", 0.1, 50_000)] = key("radius_mm", "radius [mm]")
    height: Annotated[float, Quantity("mm", 0.1, 100_000)] = key("height_mm", "height [mm]")


class BodySpec(Section):
    """One body: a box or a cylinder about its centre, or a file of facets."""

    model_config = exactly_one("box_mm", "cylinder", "mesh")

    box: Side | None = key("box_mm", "sides of a box along x, y and z [mm]; default: none", None)
    cylinder: CylinderSolidSpec | None = key("cylinder", "a cylinder along z; default: none", None)
    mesh: Annotated[Path, PATH] | None = key(
        "mesh", "a file of its facets or from CAD (STL, PLY, OBJ, OFF, 3MF, STEP or IGES), in mm; default: none", None
    )
    centre: Position = key("centre_mm", "centre of box or cylinder, or the file's origin [mm]", (0, 0, 0))
    rpy: Angles = key("rpy_deg", "turned about x, then y, then z of its carrier [deg]", (0, 0, 0))

    @model_validator(mode="after")
    def _one_shape(self) -> BodySpec:
        shapes = {"box": "box_mm", "cylinder": "cylinder", "mesh": "mesh"}
        given = [shapes[name] for name in shapes if getattr(self, name) is not None]
        if len(given) == 1:
            return self
        if not given:
            raise refusal("no shape is given", f"give one of them: {', '.join(shapes.values())}")
        raise refusal(f"both {given[0]} and {given[1]} are given", "give one of them", fields=given)


class FixtureSpec(BodySpec):
    """A body fixed in the cell, or carried with the part: a table, a vice, a wall."""

    on: Annotated[Literal["world", "part"], one_of(CARRIERS)] = key(
        "on", "its carrier: the world, or the part, with which it then moves", "world"
    )


FARTHEST_KEPT_MM = 50  # greatest distance that the verifier resolves


class CollisionSpec(Section):
    """Least distances between everything in the cell."""

    nozzle: Annotated[float, Quantity("mm", 0, FARTHEST_KEPT_MM)] = key(
        "nozzle_mm",
        "least distance of nozzle and print head from everything but what lies at the nozzle's tip [mm]; default: "
        "2, or if no verified plan keeps that, the first of 1, 0.5, 0.2 and 0 that a plan keeps",
        2,
    )
    arm: Annotated[float, Quantity("mm", 0, FARTHEST_KEPT_MM)] = key(
        "arm_mm", "least distance of the robots' links from each other, and from fixtures, part and print [mm]", 5
    )


class NozzleSpec(Section):
    """The nozzle on the arm's flange."""

    tip: Position = key("tip_mm", "nozzle tip in the flange frame [mm]")
    axis: Annotated[Vector, Quantity("", -1e6, 1e6, count=3), UNIT_VECTOR] = key(
        "axis", "direction in which the nozzle points, in the flange frame, any length but 0", (0, 0, 1)
    )
    diameter: Annotated[float, Quantity("mm", 0.05, 50)] = key("diameter_mm", "bore of the nozzle [mm]")
    profile: tuple[Ring, ...] | None = key(
        "profile_mm",
        "outline of the nozzle about its axis, from the tip up: pairs of height above the tip and radius [mm]; "
        "default: a slender one, assumed from the bore",
        None,
    )
    head: dict[Text, BodySpec] | None = key(
        "head", "bodies of the print head by name, in the flange frame; default: a tube to the flange, assumed", None
    )

    @field_validator("profile")
    @classmethod
    def _upwards(cls, profile: tuple[tuple[float, float], ...] | None) -> tuple[tuple[float, float], ...] | None:
        if profile is None:
            return None
        if len(profile) < 2 or profile[0][0] != 0.0:
            raise refusal("must begin at height 0, the tip, and have two pairs or more", "[[0, 0.5], [5, 4], [40, 4]]")
        for i, (before, after) in enumerate(itertools.pairwise(profile), 1):
            if after[0] < before[0] or after == before:
                raise refusal("heights must not fall, and no pair may be repeated", "from the tip up", item=i)
        return profile


class PositionerSpec(Section):
    """A positioner, or an arm, that holds the part; its plate or flange carries the part frame."""

    model_config = exactly_one("origin_mm", "base_mm")

    robot: RobotName = key(
        "robot", "positioner, or arm that holds the part: its name in robots/, or a file of your own, my_robot.yaml"
    )
    origin: Position | None = key(
        "origin_mm", "centre of the plate in the world, with all axes at 0 [mm]; default: none, base_mm instead", None
    )
    base: Position | None = key("base_mm", "position of its base in the world [mm]; default: none", None)
    turn: Annotated[float, Quantity("deg", -360, 360)] = key(
        "turn_deg", "rotation of its base about the vertical [deg]", 0
    )
    free: Annotated[tuple[Text, ...], UNIQUE] = key(
        "free", "axes that the planner may move, such as [rotation]; the others are held"
    )
    held: dict[Text, Angle] = key("held_deg", "angles of held axes by name [deg]; each default 0", {})
    held_mm: dict[Text, Place] = key("held_mm", "positions of held linear axes, by name [mm]; each default 0", {})
    home: dict[Text, Angle] = key(
        "home_deg", "angles of free axes that the search starts from, by name [deg]; each default 0", {}
    )
    home_mm: dict[Text, Place] = key(
        "home_mm", "positions of free linear axes that the search starts from, by name [mm]; each default 0", {}
    )
    part: Position = key("part_mm", "origin of the part frame on the plate or flange [mm]", (0, 0, 0))
    part_rpy: Angles = key(
        "part_rpy_deg", "the part frame turned about x, then y, then z of the plate or flange [deg]", (0, 0, 0)
    )

    @model_validator(mode="after")
    def _one_place(self) -> PositionerSpec:
        if (self.origin is None) == (self.base is None):
            found = "neither origin_mm nor base_mm is" if self.base is None else "both origin_mm and base_mm are"
            raise refusal(f"{found} given", "give exactly one of them", fields=["origin_mm", "base_mm"])
        return self

    @model_validator(mode="after")
    def _free_or_held(self) -> PositionerSpec:
        for field, held in (("held_deg", self.held), ("held_mm", self.held_mm)):
            for name in self.free:
                if name in held:
                    reason = f"axis {name!r} is both free and held"
                    raise refusal(reason, "an axis is one or the other", fields=["free", field])
        return self


class CarrierSpec(Section):
    """The carrier of the arm, such as a rail: its base is at base_mm, and the arm on its tip."""

    robot: RobotName = key("robot", "its name in robots/, or a file of your own, my_rail.yaml")
    free: Annotated[tuple[Text, ...], UNIQUE] = key(
        "free", "joints that the planner may move, such as [rail]; [] for none; the others are held"
    )
    held_mm: dict[Text, Place] = key("held_mm", "positions of held linear joints, by name [mm]; each default 0", {})
    held_deg: dict[Text, Angle] = key("held_deg", "angles of held rotary joints, by name [deg]; each default 0", {})
    home_mm: dict[Text, Place] = key(
        "home_mm", "positions of free linear joints before and after the print, by name [mm]; each default 0", {}
    )
    home_deg: dict[Text, Angle] = key(
        "home_deg", "angles of free rotary joints then, by name [deg]; each default 0", {}
    )


class JointLimitsSpec(Section):
    """Limits of one joint, where the user knows better than the robot's own file; in mm for a linear joint."""

    # a thousand turns, as many as a table on a slip ring makes in a print
    range: Annotated[tuple[float, float], Quantity("deg", -360_000, 360_000, count=2), INCREASING] | None = key(
        "range_deg", "least and greatest angle [deg]; default: the robot's", None
    )
    speed: Annotated[float, Quantity("deg/s", 0.01, 10_000)] | None = key(
        "speed_deg_s", "greatest speed [deg/s]; default: the robot's", None
    )
    acceleration: Annotated[float, Quantity("rad/s2", 0.001, 10_000)] | None = key(
        "acceleration_rad_s2", "greatest acceleration [rad/s2]; default: the robot's", None
    )
    jerk: Annotated[float, Quantity("rad/s3", 0.01, 1e7)] | None = key(
        "jerk_rad_s3", "greatest jerk [rad/s3]; default: the robot's", None
    )
    range_mm: Annotated[tuple[float, float], Quantity("mm", -100_000, 100_000, count=2), INCREASING] | None = key(
        "range_mm", "of a linear joint: least and greatest position [mm]; default: the robot's", None
    )
    speed_mm_s: Annotated[float, Quantity("mm/s", 0.1, 100_000)] | None = key(
        "speed_mm_s", "of a linear joint: greatest speed [mm/s]; default: the robot's", None
    )
    acceleration_mm_s2: Annotated[float, Quantity("mm/s2", 1, 1e7)] | None = key(
        "acceleration_mm_s2", "of a linear joint: greatest acceleration [mm/s2]; default: the robot's", None
    )
    jerk_mm_s3: Annotated[float, Quantity("mm/s3", 10, 1e10)] | None = key(
        "jerk_mm_s3", "of a linear joint: greatest jerk [mm/s3]; default: the robot's", None
    )


class CellSpec(Section):
    """Arm, nozzle and what carries the part: a positioner or a fixed bed."""

    model_config = exactly_one("positioner", "bed_mm", and_of=("nozzle", "nozzles"))

    arm: RobotName = key("arm", "its name in robots/, or a file of your own, my_robot.yaml")
    base: Position = key("base_mm", "base of the arm, or of its carrier, in the world [mm]", (0, 0, 0))
    base_rpy: Angles = key(
        "base_rpy_deg",
        "that base turned about x, then y, then z of the world [deg]; [180, 0, 0] hangs the arm from a ceiling",
        (0, 0, 0),
    )
    carrier: CarrierSpec | None = key(
        "base", "the carrier of the arm, such as a rail; default: none, the arm's base is fixed", None
    )
    only_nozzle: NozzleSpec | None = key(
        "nozzle", "the nozzle on the arm's flange; default: none, nozzles instead", None
    )
    nozzles: dict[NozzleName, NozzleSpec] = key(
        "nozzles",
        "several nozzles for the arm's flange, by their names in programs: each material names its own; "
        "default: none, nozzle instead",
        {},
    )
    mounted: Annotated[Literal["together", "one"], one_of(MOUNTINGS)] = key(
        "mounted",
        "with several nozzles, what is on the flange: all of them together, or only the one in use, exchanged at home",
        "together",
    )
    home: Annotated[tuple[float, ...], Quantity("deg", -3600, 3600, count=(1, MOST_JOINTS))] = key(
        "home_deg", "posture of the arm before and after the print, each joint from the base on [deg]"
    )
    positioner: PositionerSpec | None = key("positioner", "what turns the part; default: none, a bed instead", None)
    bed: Position | None = key("bed_mm", "origin of the part frame on a fixed bed [mm]; default: none", None)
    bed_rpy: Angles = key(
        "bed_rpy_deg", "the part frame on a fixed bed turned about x, then y, then z of the world [deg]", (0, 0, 0)
    )
    fixtures: dict[Text, FixtureSpec] = key(
        "fixtures", "other bodies in the cell, or carried with the part, by name; default: none", {}
    )
    limits: dict[Text, JointLimitsSpec] = key("limits", "limits of your own by joint; default: the robots'", {})

    @property
    def nozzle(self) -> NozzleSpec:
        """The only nozzle, or the first of several."""
        return self.only_nozzle or next(iter(self.nozzles.values()))

    def nozzle_named(self, name: str) -> NozzleSpec:
        """One of several nozzles, or the only one, which has no name."""
        return self.nozzles[name] if name else self.nozzle

    @model_validator(mode="after")
    def _one_nozzle_or_several(self) -> CellSpec:
        if (self.only_nozzle is None) == (not self.nozzles):
            found = "both nozzle and nozzles are" if self.nozzles else "neither nozzle nor nozzles is"
            raise refusal(f"{found} given", "give exactly one of them", fields=["nozzle", "nozzles"])
        if not self.nozzles and "mounted" in self.model_fields_set:
            raise refusal("mounted is for several nozzles", "leave it out, or give nozzles", fields=["mounted"])
        return self

    @model_validator(mode="after")
    def _one_holder(self) -> CellSpec:
        if (self.positioner is None) == (self.bed is None):
            found = "neither positioner nor bed_mm is" if self.bed is None else "both positioner and bed_mm are"
            reason = f"{found} given"
            raise refusal(reason, "give exactly one of them", fields=["positioner", "bed_mm"])
        if self.bed is None and "bed_rpy" in self.model_fields_set:
            fields = ["positioner", "bed_rpy_deg"]
            raise refusal("bed_rpy_deg is for a part on a bed", "use part_rpy_deg on a positioner", fields=fields)
        return self
