"""The nozzle's distances from the beads it has laid, by the verifier and by coal, side by side.

For coal the nozzle is a convex body of 128 sides, and beads are capsules from sample to sample in seven rows across. To
compare depths, beads are spheres along their axes, since a long capsule must move farther to come free than its deepest
place is deep. Two things are compared: how deep the nozzle presses into earlier beads, and how close nozzle and head come
beyond the tip's zone. Both are taken at the samples where the verifier found the worst values, and at others between.

python -m benchmarks.clearance                              three prints
python -m benchmarks.clearance peer_cap saddle_ring         or others, `--set` as for planner.solve
"""

from __future__ import annotations

import argparse
import itertools
import sys
from collections.abc import Iterator, Sequence

import coal
import numpy as np
from rich.console import Console
from rich.table import Table
from scipy.spatial import cKDTree

from benchmarks.wing import ONE_NOZZLE
from planner.base.arrays import Array
from planner.base.errors import PlannerError
from planner.base.geometry import arc_lengths
from planner.cell.bodies import nozzle_profile
from planner.cell.solids import Body, triangles_of
from planner.collision.print_body import TIP_SLOPE, print_body, standing
from planner.plan import Plan
from planner.planning.pipeline import solve
from planner.problem import load_problem
from planner.verify.checks import FAR, Judged
from planner.verify.executed import executed_motion
from planner.verify.nozzle import beyond, room_along
from planner.verify.pressed import Laid, deepest, laid_beads

PRINTS = (
    ("cylinder_logo", "layers.count=2"),
    ("hemisphere_honeycomb",),
    ("naca0015_wing", "layers.count=34", *ONE_NOZZLE),
)
ROWS = 7  # of capsules across a bead
SIDES = 128  # of the nozzle
LOOKS = 200  # samples beside the worst
SEEN = 5e-3  # m beyond the tip's zone in which beads are looked at there


class PrintOfCapsules:
    """What is laid as capsules: a row of them from each sample of a bead to the next.

    k rows of m capsules; `begins` (m) are samples, as in `Laid`
    """

    def __init__(self, laid: Laid) -> None:
        same = np.flatnonzero((np.diff(laid.bead) == 0) & (np.linalg.norm(np.diff(laid.tip, axis=0), axis=1) > 1e-6))
        radius = 0.5 * np.minimum(laid.width, laid.height)
        way = laid.tip[same + 1] - laid.tip[same]
        side = np.cross(laid.normal[same], way)
        side /= np.linalg.norm(side, axis=1)[:, None]
        low = laid.tip - radius[:, None] * laid.normal
        room = 0.5 * laid.width - radius
        self.radius, self.bead, self.begins = radius[same], laid.bead[same], laid.sample[same]
        self.ends = [
            (low[same] + x * room[same, None] * side, low[same + 1] + x * room[same, None] * side)
            for x in np.linspace(-1.0, 1.0, ROWS)
        ]
        self.tree = cKDTree(laid.tip[same])
        self.longest = float(np.linalg.norm(way, axis=1).max())

    def near(self, tip: Array, within: float) -> Sequence[int]:
        """Capsules of which a part may be within a distance [m] of the tip."""
        found: Sequence[int] = self.tree.query_ball_point(tip, within + self.longest)
        return found

    def spheres(self, pieces: Array) -> tuple[Array, Array]:
        """Middles (n, 3) and radii (n) of spheres at the ends and in the middle of the capsules of some pieces."""
        shares = (0.0, 0.5, 1.0)
        middles = [(1.0 - x) * low[pieces] + x * high[pieces] for low, high in self.ends for x in shares]
        return np.concatenate(middles), np.tile(self.radius[pieces], len(middles))

    def capsules(self, k: int) -> Iterator[tuple[coal.Capsule, coal.Transform3s]]:
        """The capsules of piece k, across the bead."""
        for low, high in self.ends:
            axis = high[k] - low[k]
            length = float(np.linalg.norm(axis))
            z = axis / length
            x = np.cross(z, np.eye(3)[int(np.argmin(np.abs(z)))])
            x /= np.linalg.norm(x)
            pose = coal.Transform3s(np.column_stack([x, np.cross(z, x), z]), 0.5 * (low[k] + high[k]))
            yield coal.Capsule(float(self.radius[k]), length), pose


def convex(vertices: Array, triangles: Sequence[Sequence[int]]) -> coal.Convex:
    """A convex body from its surface."""
    points, faces = coal.StdVec_Vec3s(), coal.StdVec_Triangle()
    for point in vertices:
        points.append(point)
    for face in triangles:
        faces.append(coal.Triangle(*map(int, face)))
    return coal.Convex(points, faces)


def frustum(low: tuple[float, float], high: tuple[float, float]) -> coal.Convex:
    """Part of a nozzle between two pairs of height above the tip and radius, z pointing into the part."""
    a = 2.0 * np.pi * np.arange(SIDES) / SIDES
    rings = [np.column_stack([r * np.cos(a), -r * np.sin(a), np.full(SIDES, -z)]) for z, r in (low, high)]
    around = [(i, (i + 1) % SIDES) for i in range(SIDES)]
    triangles = [face for i, k in around for face in ((i, k, SIDES + i), (k, SIDES + k, SIDES + i))]
    triangles += [(0, k, i) for i, k in around[1:-1]] + [(SIDES, SIDES + i, SIDES + k) for i, k in around[1:-1]]
    return convex(np.concatenate(rings), triangles)


def apart(shapes: Sequence[tuple[coal.Convex, Array]], T: Array, other: coal.ShapeBase, at: coal.Transform3s) -> float:
    """Signed distance [m] of bodies on the nozzle, whose pose is T (4, 4), from another."""
    least = np.inf
    for shape, own in shapes:
        pose = T @ own
        placed = coal.Transform3s(pose[:3, :3], pose[:3, 3])
        least = min(least, coal.distance(shape, placed, other, at, coal.DistanceRequest(), coal.DistanceResult()))
    return float(least)


def pressed_by_coal(judged: Judged, looks: Sequence[int]) -> float:
    """How deep [m] the nozzle presses into beads printed before, at some samples, as `planner.verify.pressed` has it."""
    profile = nozzle_profile(judged.problem.cell.nozzle)
    shapes = [(frustum(*pair), np.eye(4)) for pair in itertools.pairwise(profile)]
    laid, t, motion = laid_beads(judged), judged.trajectory, judged.motion
    reach, shaped = profile[0][1] + float((laid.width + laid.height).max()), profile[0][1] + float(laid.width.max())
    print_, far = PrintOfCapsules(laid), arc_lengths(motion.tip)
    deepest_ = 0.0
    for j in looks:
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = motion.rotation[j], motion.tip[j]
        near = np.array(print_.near(motion.tip[j], reach), dtype=np.int64)
        begun = print_.begins[near]
        gone = far[j] - far[np.maximum(begun, 0).astype(np.int64)]
        near = near[(begun < j - 1) & ~((print_.bead[near] == t.bead[j]) & (gone <= shaped))]
        for middle, radius in zip(*print_.spheres(near), strict=True):
            away = middle - motion.tip[j]
            if away @ away > reach**2 or -away @ motion.axis[j] < -radius:  # too far, or wholly beneath the face
                continue
            at = coal.Transform3s(np.eye(3), middle)
            deepest_ = max(deepest_, -apart(shapes, T, coal.Sphere(radius), at))
    return deepest_


def beyond_by_coal(judged: Judged, looks: Sequence[int]) -> float:
    """How near [m] nozzle and head come to the beads beyond the tip's zone, at some samples."""
    spec, laid, t, motion = judged.problem.collision, laid_beads(judged), judged.trajectory, judged.motion
    shapes = [(coal_body(body), body.T_frame_solid) for body in judged.cell.head]
    slack = room_along(judged.problem, judged.toolpath, t, judged.problem.cell.nozzle).slack
    print_, least = PrintOfCapsules(laid), FAR
    for j in looks:
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = motion.rotation[j], motion.tip[j]
        zone = (spec.nozzle + slack[j]) / TIP_SLOPE
        for k in print_.near(motion.tip[j], zone + SEEN):
            if print_.begins[k] >= j - 1:
                continue
            for capsule, pose in itertools.islice(print_.capsules(k), 0, None, ROWS // 2):
                if np.linalg.norm(pose.getTranslation() - motion.tip[j]) > zone:
                    least = min(least, apart(shapes, T, capsule, pose))
    return least


def coal_body(body: Body) -> coal.Convex:
    """A body of the head from its picture's triangles."""
    return convex(*triangles_of(body.solid))


def row(plan: Plan) -> tuple[str, ...]:
    """What both find."""
    body = print_body(plan.toolpath, standing(plan.cell))
    given = (plan.problem, plan.cell, plan.toolpath, plan.trajectory)
    judged = Judged(*given, executed_motion(plan.cell, plan.trajectory), body)
    found, far = deepest(judged), beyond(judged)
    n = len(plan.trajectory)
    spread = np.linspace(0, n - 1, LOOKS).astype(int).tolist()
    worst = [k for k in range(found.at - 20, found.at + 21) if found.at >= 0 and 0 <= k < n]
    near = [k for k in range(far.at - 2, far.at + 3) if 0 <= k < n]
    coal_deep = pressed_by_coal(judged, [*worst, *spread])
    coal_near = beyond_by_coal(judged, [*near, *spread[:: LOOKS // 10]])
    asked = plan.problem.collision.nozzle
    of = judged.body.name_of(far.point) if far.point >= 0 else "-"
    figures = (found.depth, coal_deep, far.least + asked, coal_near)
    return (plan.problem.name, str(n), *(f"{each * 1e3:.3f}" for each in figures), of)


def main(argv: Sequence[str] | None = None) -> int:
    """Solve the problems and print the table."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.clearance", description=(__doc__ or "").splitlines()[0])
    parser.add_argument("problems", nargs="*", help="default: " + ", ".join(name for name, *_ in PRINTS))
    parser.add_argument(
        "--set", action="append", default=[], metavar="KEY=VALUE", help="change a value of all problems"
    )
    args = parser.parse_args(argv)
    table = Table("print", "samples", "pressed mm", "by coal", "beyond the tip mm", "beads by coal", "nearest")
    for name, *changes in [(each,) for each in args.problems] or PRINTS:
        try:
            problem = load_problem(name, [*changes, *args.set])
            if problem.cell.nozzles:
                raise problem.error("cell.nozzles", "the distances are those of one nozzle", "a print with cell.nozzle")
            table.add_row(*row(solve(problem)))
        except PlannerError as error:
            print(f"{name}: {error}", file=sys.stderr)
            return 2
    Console(width=160).print(table)
    return 0


if __name__ == "__main__":
    sys.exit(main())
