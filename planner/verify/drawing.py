"""What a cell looks like: links by their meshes or shells; print head, fixtures and carried bodies by their solids."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from planner.base.arrays import Array
from planner.cell.cell import Cell
from planner.cell.looks import bodies_surface, link_surface
from planner.cell.robot import Robot, joint_axes
from planner.cell.solids import Body
from planner.cell.surfaces import TriangleSurface
from planner.plan import CellView
from planner.verify.bodies import ARM, CARRIED, FIXTURE, HEAD, HOLDER, CellBodies, CheckedBody

BRASS = "#c8a24a"  # nozzles
COLOURS = {HEAD: "#4a525b", FIXTURE: "#c3c9cf", CARRIED: "#b9a06a"}


def cell_view(cell: Cell) -> CellView:
    """What a cell looks like with all joints at 0; bodies have the names that approaches use."""
    bodies = with_all_nozzles(CellBodies.of(cell))
    drawn = list(_drawn(bodies))
    return CellView(
        names=tuple(things[0].link or bodies.name(things[0]) for things, _ in drawn),
        kinds=tuple(things[0].kind for things, _ in drawn),
        bodies=tuple(tuple(bodies.name(thing) for thing in things) for things, _ in drawn),
        vertices=tuple(surface.vertices for _, surface in drawn),
        normals=tuple(surface.normals for _, surface in drawn),
        colours=tuple(surface.colours for _, surface in drawn),
        triangles=tuple(surface.triangles for _, surface in drawn),
        joints=np.array([bodies.moved_by(things[0]) for things, _ in drawn], dtype=np.int64).reshape(-1, 2),
    )


def with_all_nozzles(bodies: CellBodies) -> CellBodies:
    """The bodies, and those of nozzles that are not on the flange while the cell's current one is in use."""
    there = {thing.name for thing in bodies.things}
    others = (CellBodies.of(bodies.cell.with_nozzle(k)) for k in range(len(bodies.cell.nozzles)))
    more = [thing for other in others for thing in other.things if thing.name not in there]
    return replace(bodies, things=(*bodies.things, *more))


def _drawn(bodies: CellBodies) -> Iterator[tuple[list[CheckedBody], TriangleSurface]]:
    """Groups of bodies drawn as one, with their surface in the world, all joints at 0."""
    cell, na = bodies.cell, bodies.cell.arm_robot.model.njoints - 1
    rest = bodies.poses(np.zeros((1, len(cell.joint_names))))[0]
    yield from _links(bodies, ARM, cell.arm_robot, [cell.T_world_base, *rest[1 : na + 1]])
    if cell.holder_robot is not None:
        yield from _links(bodies, HOLDER, cell.holder_robot, [cell.T_world_holder_base, *rest[na + 1 :]])
    for thing in bodies.things:
        if thing.kind in COLOURS:
            colour = BRASS if "nozzle" in thing.name else COLOURS[thing.kind]
            solid = Body(thing.name, thing.solid, rest[thing.carrier] @ thing.T_carrier_solid)
            yield [thing], bodies_surface([solid], colour)


def _links(
    bodies: CellBodies, kind: str, robot: Robot, T_world_joint: Sequence[Array]
) -> Iterator[tuple[list[CheckedBody], TriangleSurface]]:
    """The links of a robot that have bodies, with their surfaces in the world."""
    for i, solids in enumerate(robot.bodies):
        mine = [thing for thing in bodies.things if thing.kind == kind and thing.joints == i]
        for link in dict.fromkeys(body.link for body in solids):
            own = [body for body in solids if body.link == link]
            looks = [look for look in robot.looks[i] if look.link == link]
            surface = link_surface(own, looks, joint_axes(robot.model, i) if kind == ARM else None)
            yield [thing for thing in mine if thing.link == link], surface.moved(T_world_joint[i])
