"""Whether a plan holds for a slightly displaced part: bounds to first order, and trials planned again.

The robot program runs in a work object. A displaced part is measured and the work object corrected; the nozzle then
takes the same poses relative to the part, with the same table angles and on the same branch, but with other joint
angles. Bounds to first order give how far every joint moves within the whole tolerance; displacements on the
tolerance's edge are followed, timed, joined by the same travel and verified like the plan itself.

A part displaced by a shift d and a turn w about its middle m takes the nozzle's pose at p along: by d + w x (p - m),
and by the turn w. With R the part's orientation in the world, the joints that follow change by
J^-1 [R (d + w x (p - m)); R w], which is linear in (d, w). The greatest value of a linear form a.d + b.w over shifts
of length delta and turns of angle alpha is delta |a| + alpha |b| (their dual norms), so one product per sample bounds
all displacements at once. The singular value's slope is u^T (dJ/dq) v with its two singular vectors.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import Protocol

import numpy as np

from planner.base.arrays import Array
from planner.base.errors import PlannerError
from planner.base.geometry import TURN
from planner.base.processes import in_halves
from planner.cell.cell import Cell, rigid_inverse
from planner.cell.solids import Body, triangles_of
from planner.plan import Check
from planner.plan.robustness import NONE, Bound, Displacement, Robustness, Tolerance, TriedDisplacement, Vector
from planner.problem import Problem
from planner.resolve.joint_path import JointPath, flange_poses, refuse_at
from planner.toolpath.bead import Toolpath
from planner.toolpath.substrate.mesh_surface import FacetTree

BLOCK = 8192  # samples at once: bounds the memory
RANGE, SINGULARITY = "joint range", "singularity margin"
AS_PLANNED = Displacement("as planned")
AXES = "xyz"


class Verified(Protocol):
    """The verifier's result for a motion."""

    @property
    def checks(self) -> tuple[Check, ...]:
        """All checks, by name."""

    @property
    def metrics(self) -> dict[str, float]:
        """All metrics, by name."""


Again = Callable[
    [Cell, Sequence[JointPath]], Verified
]  # times joint paths in a cell, carries travel along, and verifies


def assess_robustness(
    tolerance: Tolerance,
    problem: Problem,
    cell: Cell,
    toolpath: Toolpath,
    paths: Sequence[JointPath],
    planned: Verified,
    again: Again,
    second_process: bool = False,
) -> Robustness:
    """Judge a plan's joint paths over a tolerance; failures there are reported, not raised.

    planned: the verifier's result for the plan itself; again: gives that of its paths in another cell. A second process
    gives the same sooner.
    """
    middle = middle_of(toolpath)
    bounds = first_order(cell, paths, tolerance, middle, problem.resolve.min_sigma)
    along = beneath(cell, toolpath, problem.collision.nozzle)
    elsewhere = displacements(tolerance)
    if elsewhere:
        elsewhere += tuple(bound.worst for bound in (bounds[0], bounds[-1]) if math.isfinite(bound.factor))

    def some(first: int, last: int) -> list[TriedDisplacement]:
        cells = [displaced(cell, each.matrix(middle), along) for each in elsewhere[first:last]]
        return [_try(each, there, paths, again) for each, there in zip(elsewhere[first:last], cells, strict=True)]

    tried = [each for half in in_halves(some, len(elsewhere), second_process) for each in half]
    x, y, z = middle.tolist()
    return Robustness(
        tolerance, (x, y, z), bounds, (TriedDisplacement(AS_PLANNED, planned.checks, planned.metrics), *tried)
    )


def middle_of(toolpath: Toolpath) -> Array:
    """Middle (3) of the bounding box of the print, part frame [m]."""
    low = np.min([bead.points.min(axis=0) for bead in toolpath.beads], axis=0)
    high = np.max([bead.points.max(axis=0) for bead in toolpath.beads], axis=0)
    return np.asarray(0.5 * (low + high))


def displacements(tolerance: Tolerance) -> tuple[Displacement, ...]:
    """Displacements on the edge of a tolerance, always the same ones; none if it is 0.

    The full shift along each axis, the full turn about each, both ways (12); and eight corners, with full shift and
    turn at once, their signs those of the fractional factorial design 2^(6-3): any two of the six occur in all four
    combinations (Box and Hunter 1961). Those that coincide, because shift or turn is 0, are tried once.
    """
    out: dict[tuple[Vector, Vector], Displacement] = {}

    def add(shift: Sequence[float], turn: Sequence[float]) -> None:
        each = Displacement(
            _words(tolerance, shift, turn), _along(tolerance.shift, shift), _along(tolerance.turn, turn)
        )
        if (each.shift, each.turn) != (NONE, NONE):
            out.setdefault((each.shift, each.turn), each)

    for axis, sign in itertools.product(range(3), (1.0, -1.0)):
        only = [sign * (k == axis) for k in range(3)]
        add(only, NONE)
        add(NONE, only)
    for a, b, c in itertools.product((1.0, -1.0), repeat=3):
        add((a, b, c), (a * b, a * c, b * c))
    return tuple(out.values())


def _along(size: float, signs: Sequence[float]) -> Vector:
    """A vector of this length in the direction of signs (3), or 0."""
    length = math.hypot(*signs)
    x, y, z = (size * sign / length + 0.0 if length and size else 0.0 for sign in signs)
    return x, y, z


def _words(tolerance: Tolerance, shift: Sequence[float], turn: Sequence[float]) -> str:
    """Name of a displacement: how far along and about which axes."""
    parts = []
    if tolerance.shift and any(shift):
        parts.append(f"{tolerance.shift * 1e3:g} mm along {_axes(shift)}")
    if tolerance.turn and any(turn):
        parts.append(f"{math.degrees(tolerance.turn):g} deg about {_axes(turn)}")
    return ", ".join(parts)


def _axes(signs: Sequence[float]) -> str:
    """Axes with their signs, such as "+x-z"."""
    return "".join(f"{'+' if sign > 0.0 else '-'}{axis}" for sign, axis in zip(signs, AXES, strict=True) if sign)


def _try(displacement: Displacement, elsewhere: Cell, paths: Sequence[JointPath], again: Again) -> TriedDisplacement:
    """The paths followed with the part displaced, and verified there; or why they cannot be."""
    try:
        report = again(elsewhere, [followed(elsewhere.at(path.task.material), path) for path in paths])
    except PlannerError as error:  # the same that would be reported for a part planned there
        return TriedDisplacement(displacement, refusal=str(error))
    return TriedDisplacement(displacement, report.checks, report.metrics)


def followed(cell: Cell, path: JointPath) -> JointPath:
    """The path with the same roll, tilt, chosen joints, branch and turns, its other joints as this cell requires.

    Raises Refusal, with the place, where a pose is out of reach or a joint leaves its range.
    """
    na, redundant, solved = len(cell.arm), list(cell.given), list(cell.solved)
    given = path.q[:, redundant] if redundant else None
    T_base_flange = flange_poses(cell, path.task, path.roll, path.tilt, path.q[:, na:])
    solutions, exists = cell.inverse.solve(T_base_flange, given)
    if not exists[:, path.branch].all():
        i = int(np.argmin(exists[:, path.branch]))
        missing = float(
            cell.inverse.out_of_reach(T_base_flange[i : i + 1], None if given is None else given[i : i + 1])[0]
        )
        refuse_at(path.task, i, "out of the arm's reach", missing)
    change = np.unwrap(solutions[:, path.branch][:, solved] - path.q[:, solved], axis=0)
    q = path.q.copy()
    q[:, solved] += change - TURN * np.round(change[0] / TURN)
    beyond = np.maximum(cell.limits.q_min - q, q - cell.limits.q_max)
    i, j = divmod(int(np.argmax(beyond)), beyond.shape[1])
    if beyond[i, j] > 0.0:
        refuse_at(path.task, i, f"{cell.joint_names[j]} leaves its range by {np.degrees(beyond[i, j]):.2f} deg")
    return replace(path, q=q)


def first_order(
    cell: Cell, paths: Sequence[JointPath], tolerance: Tolerance, middle: Array, least_sigma: float
) -> tuple[Bound, ...]:
    """The bound of each joint that follows from the nozzle's pose, tightest first, then that of the singularity margin.

    Joints count along beads and their runs, singularities where material flows; travel is not considered. middle (3):
    of the print [m].
    """
    tightest: dict[int, Bound] = {}
    for path in paths:
        for rows in _blocks(len(path.task)):
            own = cell.at(path.task.material)
            for k, bound in enumerate(_bounds(own, path, rows, tolerance, middle, least_sigma)):
                if k not in tightest or bound.factor < tightest[k].factor:
                    tightest[k] = bound
    *joints, sigma = (tightest[k] for k in sorted(tightest))
    return (*sorted(joints, key=lambda bound: bound.factor), sigma)


def _blocks(n: int) -> Iterator[slice]:
    """Samples in blocks."""
    return (slice(start, min(start + BLOCK, n)) for start in range(0, n, BLOCK))


def _bounds(
    cell: Cell, path: JointPath, rows: slice, tolerance: Tolerance, middle: Array, least_sigma: float
) -> Iterator[Bound]:
    """The tightest place of each solved joint and of the singularity margin among some samples of a path."""
    task, q, solved = path.task, path.q[rows], list(cell.solved)
    slopes, sigma = displacement_slopes(cell, path, rows, middle)
    change = tolerance.shift * np.linalg.norm(slopes[:, :, :3], axis=2)
    change += tolerance.turn * np.linalg.norm(slopes[:, :, 3:], axis=2)
    below, above = (q - cell.limits.q_min)[:, solved], (cell.limits.q_max - q)[:, solved]
    at = np.arange(rows.start, rows.stop)
    deposits = (at >= task.first) & (at <= task.last)
    room = np.column_stack([np.minimum(below, above), np.where(deposits, sigma - least_sigma, np.inf)])
    towards = np.column_stack([np.where(above < below, 1.0, -1.0), -np.ones(len(q))])
    factor = np.divide(room, change, out=np.full_like(room, np.inf), where=change > 0.0)
    for k, i in enumerate(np.argmin(factor, axis=0)):
        joint = cell.arm.names[solved[k]] if k < len(solved) else ""
        yield Bound(
            what=RANGE if joint else SINGULARITY,
            joint=joint,
            change=float(change[i, k]),
            room=float(room[i, k]),
            factor=float(factor[i, k]),
            bead=task.bead,
            layer=task.layer,
            s=float(task.s[at[i]]),
            worst=_worst(joint, towards[i, k] * slopes[i, k], tolerance),
        )


def _worst(joint: str, slope: Array, tolerance: Tolerance) -> Displacement:
    """The displacement that most raises a quantity with this slope (6)."""
    name = f"worst for {joint}, to first order" if joint else "worst for the singularity margin, to first order"
    parts = []
    for size, part in ((tolerance.shift, slope[:3]), (tolerance.turn, slope[3:])):
        length = float(np.linalg.norm(part))
        x, y, z = size * part / length if length > 0.0 else np.zeros(3)
        parts.append((float(x), float(y), float(z)))
    return Displacement(name, *parts)


def displacement_slopes(cell: Cell, path: JointPath, rows: slice, middle: Array) -> tuple[Array, Array]:
    """Slopes (n, k + 1, 6) of k solved joints [rad] and sigma by the part's shift [m] and turn [rad], and sigma (n).

    sigma is the smallest singular value of the arm's whole Jacobian at the tip, without joints that carry the arm.
    Slopes are infinite at a singularity.
    """
    na, q = len(cell.arm), path.q[rows]
    J = cell.arm.jacobians(q[:, :na])[:, :, cell.rails :]
    solved = [j - cell.rails for j in cell.solved]
    J6 = J[:, :, solved]
    regular = np.linalg.det(J6) != 0.0
    inverse = np.full_like(J6, np.inf)
    inverse[regular] = np.linalg.inv(J6[regular])
    R = cell.holder.poses(q[:, na:])[:, :3, :3]
    arm = path.task.tip[rows] - middle
    moves = np.zeros((len(q), 6, 6))
    moves[:, :3, :3] = moves[:, 3:, 3:] = R
    moves[:, :3, 3:] = -R @ _cross_matrices(arm)
    joints = np.full((len(q), len(solved), 6), np.inf)
    joints[regular] = inverse[regular] @ moves[regular]
    u, values, vt = np.linalg.svd(J)
    by_joint = _sigma_slope(J, u[:, :, 5], vt[:, 5])[:, solved]
    with np.errstate(invalid="ignore"):
        sigma = np.einsum("nk,nkc->nc", by_joint, joints)
    return np.concatenate([joints, np.nan_to_num(sigma, nan=np.inf)[:, None]], axis=1), values[:, 5]


def _cross_matrices(v: Array) -> Array:
    """Cross-product matrices (n, 3, 3) of v (n, 3)."""
    out = np.zeros((len(v), 3, 3))
    out[:, 2, 1], out[:, 0, 2], out[:, 1, 0] = v.T
    out[:, 1, 2], out[:, 2, 0], out[:, 0, 1] = -v.T
    return out


def _sigma_slope(J: Array, u: Array, v: Array) -> Array:
    """Slopes (n, na) of a singular value by the arm's joints; u (n, 6), v (n, na): its singular vectors; J (n, 6, na).

    Turning joint k carries all columns o >= k along, and moves the tip for those before it.
    """
    direction = np.swapaxes(J[:, 3:], 1, 2)
    linear = np.cross(u[:, None, :3], direction) @ J[:, :3]  # [k, o]: u . (d_k x J_o)
    angular = np.cross(u[:, None, 3:], direction) @ J[:, 3:]
    upper = np.triu(linear)
    both = upper + np.swapaxes(np.triu(linear, 1), 1, 2) + np.triu(angular)
    return np.asarray(np.einsum("nko,no->nk", both, v))


def displaced(cell: Cell, T_planned_displaced: Array, along: tuple[str, ...] = ()) -> Cell:
    """The cell with its part displaced on the holder: the part's frame (4, 4) is given in the planned part frame.

    Bodies carried with the part stay with it, and so do the fixtures named in `along`, if nothing turns.
    """
    T_world_moved = cell.T_world_holder @ T_planned_displaced @ rigid_inverse(cell.T_world_holder)
    return replace(
        cell,
        holder=replace(cell.holder, T_last_tip=cell.holder.T_last_tip @ T_planned_displaced),
        T_world_holder=cell.T_world_holder @ T_planned_displaced,
        T_plate_part=cell.T_plate_part @ T_planned_displaced,
        fixtures=tuple(
            replace(body, T_frame_solid=T_world_moved @ body.T_frame_solid) if body.name in along else body
            for body in cell.fixtures
        ),
    )


def beneath(cell: Cell, toolpath: Toolpath, near: float) -> tuple[str, ...]:
    """Names of the fixtures that part or print lie on: closer to them than `near` [m]. None if the part turns.

    A part that is found lower than planned has not sunk into its bed: the bed is lower.
    """
    if len(cell.holder):
        return ()
    points = [bead.points for bead in toolpath.beads]
    if toolpath.shape is not None:
        points.append(np.asarray(toolpath.shape.vertices, dtype=float))
    T = cell.T_world_holder
    in_world = np.concatenate(points) @ T[:3, :3].T + T[:3, 3]
    return tuple(body.name for body in cell.fixtures if _distance(body, in_world) < near)


def _distance(body: Body, points: Array) -> float:
    """Least distance [m] of points (n, 3) from a body's surface, in the frame that carries it."""
    vertices, triangles = triangles_of(body.solid)
    T = body.T_frame_solid
    corners = (vertices @ T[:3, :3].T + T[:3, 3])[triangles]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    return float(FacetTree.of(corners[area > 0.0]).distance(points).min())
