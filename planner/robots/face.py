"""Whether a flange's frame stands at the end of the link that it belongs to.

Some URDFs begin their last link where the axes of the wrist meet, 50 to 200 mm inside it. A nozzle that is measured from the
flange would be as much too long; so another frame at the end is taken instead, or it is said how deep the frame lies.
"""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from planner.base.arrays import Array
from planner.cell.robot import Robot, base_to_tip
from planner.cell.solids import Hull, triangles_of
from planner.cell.urdf import Urdf, hanging_on, joints_to, link_frame, moved_by
from planner.robots.survey import is_flange

DEEP = 10e-3  # m: a frame no deeper is at the end, whatever stands out of it, a pin or a screw
NEAR = 5e-3  # m from the end, of a frame that is there
ASIDE = 1e-3  # m from the last axis


def depth(robot: Robot, outwards: Array, without: Collection[str] = ()) -> float:
    """How far the bodies of the last joint reach beyond the flange's frame [m], on the last axis; 0 if they do not.

    outwards: where the axis leaves the flange (3), in the flange's frame; without: links whose bodies do not count
    """
    T_flange_last = np.linalg.inv(base_to_tip(robot.model, robot.tip).T_last_tip)
    deepest = 0.0
    for body in robot.bodies[-1]:
        if body.link in without:
            continue
        T = T_flange_last @ body.T_frame_solid
        points = triangles_of(body.solid)[0] @ T[:3, :3].T + T[:3, 3]
        deepest = max(deepest, _leaves(Hull(points).planes, outwards))
    return deepest


def _leaves(planes: Array, along: Array) -> float:
    """How far from the origin a line leaves a convex body [m]; 0 where it misses it."""
    height, rate = planes[:, 3], planes[:, :3] @ along
    out, into, level = rate > 1e-12, rate < -1e-12, np.abs(rate) <= 1e-12
    if (height[level] > 0.0).any() or not out.any():
        return 0.0
    last = float((-height[out] / rate[out]).min())
    first = float((-height[into] / rate[into]).max(initial=-np.inf))
    return max(last, 0.0) if first <= last else 0.0


def mounted(urdf: Urdf, robot: Robot) -> list[str]:
    """Links with bodies that hang on a link named as a flange: what somebody has mounted there."""
    if not is_flange(robot.tip):
        return []
    behind = hanging_on(urdf, [robot.tip]) - {robot.tip}
    return [link for link in dict.fromkeys(body.link for body in robot.bodies[-1]) if link in behind]


def beneath(urdf: Urdf, robot: Robot) -> list[str]:
    """Links with bodies on which the arm's own base stands, or beside which it does: a room, a table, a gantry."""
    own = hanging_on(urdf, [robot.stand])
    return [link for link in dict.fromkeys(body.link for body in robot.bodies[0]) if link not in own]


def frame_at_the_end(urdf: Urdf, robot: Robot, outwards: Array) -> str | None:
    """An empty link, fixed to the flange's on the last axis, where its bodies end; None if the flange's frame is there, or
    no such link is. One whose z leaves the arm comes first."""
    deep = depth(robot, outwards, mounted(urdf, robot))
    if deep <= DEEP:
        return None
    model, moved = robot.model, moved_by(urdf, robot.tip)
    T_tip = model.frames[link_frame(model, robot.tip)].placement.homogeneous
    found = []
    for name in urdf.links():
        path = [joint.find("child").get("link", "") for joint in joints_to(urdf, name)]  # type: ignore[union-attr]
        if moved_by(urdf, name) != moved or robot.tip not in path[:-1]:
            continue
        links = urdf.links()
        if any(
            links[link].find(tag) is not None
            for link in path[path.index(robot.tip) + 1 :]
            for tag in ("collision", "visual")
        ):
            continue
        T = np.linalg.inv(T_tip) @ model.frames[link_frame(model, name)].placement.homogeneous
        along = float(T[:3, 3] @ outwards)
        if np.linalg.norm(T[:3, 3] - along * outwards) < ASIDE and abs(along - deep) < NEAR:
            found.append((-round(float(T[:3, 2] @ outwards), 6), abs(along - deep), name))
    return min(found)[2] if found else None
