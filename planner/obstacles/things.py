"""Bodies of a cell as obstacles: in which frame each moves, whose it is, and which may touch."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from planner.cell import Cell, rigid_inverse
from planner.kinematics.chain import Chain, rotate_about
from planner.readonly import Array
from planner.robot.robot import Robot, joint_axis
from planner.solids import Body, Capsule, Frustum, Hull, Mesh

_FILLED = 1e-6  # of its hull's volume that a mesh may lack to be that hull
_ON_AXIS = 1e-9  # m, and of a direction's length: so near to an axis is on it
ARM, HEAD, HOLDER, FIXTURE, CARRIED = range(5)


@dataclass(frozen=True)
class Thing:
    """A body, its pose in its frame's coordinates, and whose it is; link: of the arm, 0 for its base."""

    body: Body
    frame: int
    whose: int
    link: int = 0


def things_of(cell: Cell) -> list[Thing]:
    """All bodies of a cell; meshes that are convex as hulls."""
    na, nh = len(cell.arm), len(cell.holder)
    out = []
    for i, (frame, body) in enumerate(_carried_by(cell.arm_robot, cell.arm, cell.T_world_base, {}, 0)):
        out += [Thing(each, frame, ARM, i) for each in body]
    out += [Thing(_moved(body, cell.arm.T_last_tip), na, HEAD, na) for body in cell.head]
    if cell.holder_robot is not None:
        for frame, body in _carried_by(cell.holder_robot, cell.holder, cell.T_world_holder_base, cell.held, na):
            out += [Thing(each, frame, HOLDER) for each in body]
    out += [Thing(body, 0, FIXTURE) for body in cell.fixtures]
    out += [Thing(_moved(body, cell.holder.T_last_tip), na + nh if nh else 0, CARRIED) for body in cell.carried]
    return [replace(thing, body=_filled(thing.body)) for thing in out]


def _carried_by(
    robot: Robot, chain: Chain, T_world_base: Array, held: dict[str, float], before: int
) -> list[tuple[int, list[Body]]]:
    """For each joint of a robot's model, its base first, the frame that carries its bodies, and these in that frame."""
    model, bodies = robot.model, robot.bodies
    frame, T = 0, T_world_base
    out = [(0, [_moved(body, T) for body in bodies[0]])]
    found = 0
    for i in range(1, model.njoints):
        name = model.names[i]
        if name in chain.names:
            found += 1
            frame, T = before + found, np.eye(4)
        else:
            turn = np.eye(4)
            rotate_about(joint_axis(model, i), held[name], turn)
            T = T @ model.jointPlacements[i].homogeneous @ turn
        out.append((frame, [_moved(body, T) for body in bodies[i]]))
    return out


def _moved(body: Body, T: Array) -> Body:
    return replace(body, T_frame_solid=T @ body.T_frame_solid)


def corners(body: Body) -> Array:
    """Triangles (m, 3, 3) of a mesh in its frame."""
    mesh, T = body.solid, body.T_frame_solid
    if not isinstance(mesh, Mesh):
        raise TypeError(f"{body.name} is no mesh")
    return np.asarray((mesh.vertices @ T[:3, :3].T + T[:3, 3])[mesh.triangles])


def _filled(body: Body) -> Body:
    """The body, as a hull if it is a mesh that fills its hull."""
    if not isinstance(body.solid, Mesh):
        return body
    own = body.solid.vertices[body.solid.triangles]
    volume = float(np.einsum("ni,ni->", own[:, 0], np.cross(own[:, 1], own[:, 2]))) / 6.0
    hull = Hull(body.solid.vertices)
    try:
        whole = hull.volume
    except ValueError:  # it is flat
        return body
    return replace(body, solid=hull) if volume >= (1.0 - _FILLED) * whole else body


def may_touch(a: Thing, b: Thing, last: int) -> bool:
    """Whether two things may touch that ought not to: what moves together, and links beside each other, do not count."""
    if a.frame == b.frame:
        return False
    whose = {a.whose, b.whose}
    if whose == {ARM}:
        return abs(a.link - b.link) > 1
    if whose == {ARM, HEAD}:
        return min(a.link, b.link) < last
    if whose & {ARM, HEAD}:
        return True
    return FIXTURE in whose


def is_round(body: Body, T_frame_nozzle: Array) -> bool:
    """Whether a body looks the same however it is turned about the nozzle's axis."""
    T = rigid_inverse(T_frame_nozzle) @ body.T_frame_solid
    on_axis = np.allclose(T[:2, 2:], 0.0, rtol=0.0, atol=_ON_AXIS)
    return isinstance(body.solid, Capsule | Frustum) and bool(on_axis)


def looked_at(a: Thing, b: Thing, part_frame: int) -> bool:
    """Whether a pair is that of the head with what does not move in the part frame: it is among the part's points."""
    other = b if a.whose == HEAD else a
    return HEAD in (a.whose, b.whose) and other.frame == part_frame and other.whose != ARM
