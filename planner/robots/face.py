"""Check whether a flange's frame lies at the end of its link.

Some URDFs start their last link where the wrist axes meet, 50 to 200 mm inside it. A nozzle measured from that flange
would be too long by as much; so another frame, at the end, is used instead, or a note says how deep the frame lies.
"""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from planner.base.arrays import Array
from planner.cell.robot import Robot, base_to_tip
from planner.cell.solids import Hull, triangles_of
from planner.cell.urdf import Urdf, hanging_on, joints_to, link_frame, moved_by
from planner.robots.survey import is_flange

DEEP = 10e-3  # m: a frame no deeper than this is at the end; only a pin or a screw stands out
NEAR = 5e-3  # m: a frame within this distance of the end is at the end
ASIDE = 1e-3  # m: a frame within this distance of the last axis is on it


def depth(robot: Robot, outwards: Array, without: Collection[str] = ()) -> float:
    """How far the last joint's bodies extend beyond the flange's frame along the last axis [m]; 0 if they do not.

    outwards: direction (3) in which that axis leaves the flange, in its frame; without: links whose bodies do not count
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
    """How far from the origin a line leaves a convex body [m]; 0 if the line misses the body."""
    height, rate = planes[:, 3], planes[:, :3] @ along
    out, into, level = rate > 1e-12, rate < -1e-12, np.abs(rate) <= 1e-12
    if (height[level] > 0.0).any() or not out.any():
        return 0.0
    last = float((-height[out] / rate[out]).min())
    first = float((-height[into] / rate[into]).max(initial=-np.inf))
    return max(last, 0.0) if first <= last else 0.0


def mounted(urdf: Urdf, robot: Robot) -> list[str]:
    """Links with bodies that hang on a link named as a flange: tools that are mounted there."""
    if not is_flange(robot.tip):
        return []
    behind = hanging_on(urdf, [robot.tip]) - {robot.tip}
    return [link for link in dict.fromkeys(body.link for body in robot.bodies[-1]) if link in behind]


def beneath(urdf: Urdf, robot: Robot) -> list[str]:
    """Links with bodies beneath or next to the arm's own base: a room, a table, a gantry."""
    own = hanging_on(urdf, [robot.stand])
    return [link for link in dict.fromkeys(body.link for body in robot.bodies[0]) if link not in own]


def frame_at_the_end(urdf: Urdf, robot: Robot, outwards: Array) -> str | None:
    """An empty link, fixed to the flange's, on the last axis where the flange's bodies end; None if the flange's frame
    is there already, or if there is no such link. One whose z points away from the arm is preferred."""
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
