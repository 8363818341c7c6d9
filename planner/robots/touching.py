"""Find which links of an arm touch as hulls, posture by posture, and whether they do so as drawn.

Bodies are convex, and a hull fills the bends of a link: a fork and the flange that turns in it overlap as hulls where
the real ones never meet. So links two or three joints apart are compared in random postures of the joints between them:
as hulls, and as the URDF draws them, triangle by triangle.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import NamedTuple

import coal
import numpy as np

from planner.base.arrays import Array
from planner.base.errors import InputError
from planner.cell.bodies import BodyRules, drawn_meshes, read_bodies
from planner.cell.kinematics.chain import joint_move
from planner.cell.robot import Robot, joint_axis
from planner.cell.solids import Body, Hull
from planner.cell.urdf import Urdf, link_frame
from planner.robots.face import beneath, mounted
from planner.verify.bodies import coal_geometry

APART = (2, 3)  # joints between compared links: with more, a link can get almost anywhere
POSTURES = 500  # random postures of the joints between two links
NEAR = 5e-3  # m: nearer hulls count as touching
SELDOM = 0.02  # share of the postures: hulls that touch less often cost almost nothing, and stay checked
MOSTLY = 0.5  # share of the postures: links that overlap as drawn in so many are drawn into each other
BENT = 0.05  # share of the postures in which the hulls touch but the drawn links do not: above it, cutting is worth it
PIECES = (4, 8)  # numbers of pieces to try, fewest first

Placed = tuple[coal.CollisionGeometry, Array]
# A joint's links as drawn: cached, since reading them takes longer than all postures.
Drawn = Callable[[int], list[Placed]]


@dataclass(frozen=True)
class Touching:
    """What a robot's file should say about its bodies, and why, in words."""

    may_touch: tuple[tuple[str, str], ...]
    pieces: dict[str, int]
    notes: tuple[str, ...]


NOTHING = Touching((), {}, ())


class _Shares(NamedTuple):
    """Share of the postures in which two links touch: as hulls, and as drawn (None: not compared)."""

    hulls: float
    drawn: float | None


def touching(urdf: Urdf, robot: Robot) -> Touching:
    """Compare all links of an arm that are two or three joints apart.

    Left out are what it stands on and what is mounted on its flange: in random postures the real arm hits these too.
    """
    others = {*beneath(urdf, robot), *mounted(urdf, robot)}
    own = tuple(tuple(body for body in each if body.link not in others) for each in robot.bodies)
    robot = replace(robot, bodies=own)
    out, bodies = NOTHING, robot.bodies
    drawn: Drawn = cache(lambda joint: _drawn(urdf, robot, joint))
    for apart in APART:
        for i in range(len(bodies) - apart):
            if bodies[i] and bodies[i + apart]:
                said = _judged(urdf, robot, drawn, (i, i + apart))
                out = Touching(out.may_touch + said.may_touch, out.pieces | said.pieces, out.notes + said.notes)
    return out


def _judged(urdf: Urdf, robot: Robot, drawn: Drawn, between: tuple[int, int]) -> Touching:
    """What the file should say about the bodies that two joints carry."""
    first, second = (robot.bodies[k] for k in between)
    postures = _postures(robot, *between)
    found = _shares(drawn, (first, second), between, postures)
    both = f"{_names(first)} and {_names(second)}"
    if not SELDOM < found.hulls < 1.0:  # pairs that always touch are left out of every collision check
        return NOTHING
    if found.drawn is None:
        if found.hulls < MOSTLY:
            return NOTHING
        return Touching(_pairs(first, second), {}, (f"{both} touch in {found.hulls:.0%} of postures: not checked",))
    if found.drawn == 0.0 or found.drawn >= MOSTLY:
        how = "never touch as drawn" if found.drawn == 0.0 else "are drawn into each other"
        note = f"{both} {how}, and their hulls touch in {found.hulls:.0%} of postures: not checked"
        return Touching(_pairs(first, second), {}, (note,))
    better = _cut(urdf, robot, drawn, between, postures, found) if found.hulls - found.drawn > BENT else {}
    if not better:
        return NOTHING
    note = f"{' and '.join(better)} cut into up to {max(better.values())} convex pieces: one hull would fill the bend"
    return Touching((), better, (note,))


def _names(bodies: Sequence[Body]) -> str:
    return "/".join(dict.fromkeys(body.link for body in bodies))


def _pairs(first: Sequence[Body], second: Sequence[Body]) -> tuple[tuple[str, str], ...]:
    return tuple((a, b) for a in dict.fromkeys(x.link for x in first) for b in dict.fromkeys(x.link for x in second))


def _postures(robot: Robot, i: int, j: int) -> list[Array]:
    """Poses (4, 4) of joint frame j in joint frame i, sampled over the ranges of the joints between them."""
    model = robot.model
    low = np.maximum(model.lowerPositionLimit[i:j], -np.pi)
    high = np.minimum(model.upperPositionLimit[i:j], np.pi)
    q = np.random.default_rng(0).uniform(low, high, (POSTURES, j - i))
    q[0] = np.clip(0.0, low, high)
    out = []
    for posture in q:
        T = np.eye(4)
        for k, angle in zip(range(i + 1, j + 1), posture, strict=True):
            T = T @ model.jointPlacements[k].homogeneous @ joint_move(joint_axis(model, k), angle)
        out.append(T)
    return out


def _shares(
    drawn: Drawn, bodies: tuple[Sequence[Body], Sequence[Body]], between: tuple[int, int], postures: list[Array]
) -> _Shares:
    own, other = ([_placed(body) for body in each] for each in bodies)
    near = [_distance(own, other, T) < NEAR for T in postures]
    if not any(near):
        return _Shares(0.0, None)
    first, second = (drawn(k) for k in between)
    if not (first and second):
        return _Shares(float(np.mean(near)), None)
    meet = [close and _meet(first, second, T) for close, T in zip(near, postures, strict=True)]
    return _Shares(float(np.mean(near)), float(np.mean(meet)))


def _placed(body: Body) -> Placed:
    geometry, shift = coal_geometry(body.solid)
    return geometry, body.T_frame_solid @ shift


def _drawn(urdf: Urdf, robot: Robot, joint: int) -> list[Placed]:
    """The visual meshes of all links that a joint carries, or else their collision meshes; empty if both lack some."""
    model = robot.model
    links = dict.fromkeys(body.link for body in robot.bodies[joint])
    for tag in ("visual", "collision"):
        try:
            found = []
            for link in links:
                place = model.frames[link_frame(model, link)].placement.homogeneous
                own = drawn_meshes(urdf, link, tag, place)
                found.append(own)
        except InputError:
            continue
        if all(found):
            return [each for own in found for each in own]
    return []


def _distance(own: Sequence[Placed], other: Sequence[Placed], T: Array) -> float:
    request, result = coal.DistanceRequest(), coal.DistanceResult()
    least = np.inf
    for a, T_a in own:
        for b, T_b in other:
            result.clear()
            least = min(least, coal.distance(a, _transform(T_a), b, _transform(T @ T_b), request, result))
    return float(least)


def _meet(own: Sequence[Placed], other: Sequence[Placed], T: Array) -> bool:
    request, result = coal.CollisionRequest(), coal.CollisionResult()
    for a, T_a in own:
        for b, T_b in other:
            result.clear()
            if coal.collide(a, _transform(T_a), b, _transform(T @ T_b), request, result):
                return True
    return False


def _transform(T: Array) -> coal.Transform3s:
    return coal.Transform3s(T[:3, :3], T[:3, 3])


def _cut(
    urdf: Urdf, robot: Robot, drawn: Drawn, between: tuple[int, int], postures: list[Array], found: _Shares
) -> dict[str, int]:
    """Numbers of pieces by link: the fewest that at least halve the postures in which only the hulls touch."""
    own = {body.link for k in between for body in robot.bodies[k]}
    links = dict.fromkeys(body.link for k in between for body in robot.bodies[k] if isinstance(body.solid, Hull))
    vain = found.hulls - (found.drawn or 0.0)
    for most in PIECES if links else ():
        wanted = dict.fromkeys(links, most)
        bodies = read_bodies(urdf, robot.model, BodyRules(pieces=wanted), own)
        pair = (bodies[between[0]], bodies[between[1]])
        after = _shares(drawn, pair, between, postures)
        if after.hulls - (found.drawn or 0.0) <= 0.5 * vain:
            return {link: most for link in links if sum(body.link == link for each in pair for body in each) > 1}
    return {}
