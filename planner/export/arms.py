"""Shared by languages that move only an arm: makers' axis conventions and frames, reading, and the check."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from planner.base.arrays import Array, Flags, Indices
from planner.base.errors import InputError
from planner.export.fit import angle, from_matrix, to_matrix
from planner.export.moves import Moves, blend_differences, greatest_until_stop, move_radii
from planner.export.program import UNSPECIFIED, RobotProgram, Trigger, named
from planner.export.readback import filled, played_differences
from planner.export.support import off_differences, output_numbers

if TYPE_CHECKING:
    from planner.cell.cell import Cell
    from planner.plan import Plan

# ----------------------------------------------------------------------------------------------------
# Makers' axis conventions for arms with a spherical wrist. Ours: at zero, the upper arm is upright, the forearm level,
# and the flange's x points down. Joint 1 turns about z, 6 about the flange's axis, 4 about the forearm; 2, 3 and 5 turn
# forwards and down.

# bits of a branch, the same as in ABB's cfx (`Trajectory.branch`)
BEHIND_AXIS_1, BEHIND_LOWER_ARM, AXIS_5_NEGATIVE = 4, 2, 1


@dataclass(frozen=True)
class Convention:
    """A maker's axes and frames.

    axes, offset  the maker's axes are axes @ q + offset [rad] for our joints q
    flange        angle about z from our flange frame to the maker's [rad]
    base          likewise for the base frame
    shoulder      the base frame's origin is level with axis 2; otherwise it is at the foot
    """

    axes: Array
    offset: Array
    flange: float = 0.0
    base: float = 0.0
    shoulder: bool = False

    def counted(self, q: Array) -> Array:
        """The maker's axes (m, 6) for our joints (m, 6) [rad]."""
        out: Array = q @ self.axes.T + self.offset
        return out

    def joints(self, axes: Array) -> Array:
        """Our joints (m, 6) for the maker's axes (m, 6) [rad]."""
        out: Array = (axes - self.offset) @ np.linalg.inv(self.axes).T
        return out

    @property
    def T_flange_maker(self) -> Array:
        """The maker's flange frame (4, 4) in ours."""
        return turned(self.flange)

    def T_world_base(self, cell: Cell) -> Array:
        """The maker's base frame (4, 4) in the world."""
        T = turned(self.base)
        T[2, 3] = cell.wrist.c1 if self.shoulder else 0.0
        out: Array = cell.T_world_base @ T
        return out

    def tool(self, cell: Cell) -> Array:
        """T_flange_nozzle (4, 4) for the maker's flange."""
        out: Array = self.T_flange_maker.T @ cell.T_flange_nozzle
        return out

    def part(self, cell: Cell) -> Array:
        """The part frame (4, 4) in the maker's base frame."""
        out: Array = np.linalg.inv(self.T_world_base(cell)) @ cell.T_world_holder
        return out


def turned(angle: float) -> Array:
    """A rotation (4, 4) about z by an angle [rad]."""
    T = np.eye(4)
    c, s = np.cos(angle), np.sin(angle)
    T[:2, :2] = np.round([[c, -s], [s, c]], 12)
    return T


def signed(*signs: float) -> Array:
    """Axes with the same (1) or the opposite (-1) sense as ours."""
    return np.diag(np.array(signs))


def percent(plan: Plan, moves: Moves) -> list[int]:
    """Axis speed (m) [percent of the greatest] of each move: the plan's greatest between the stops around it."""
    t = plan.trajectory
    limits = [plan.cell.arm_robot.model.velocityLimit]
    if (station := plan.cell.station) is not None:
        free = [station.joint_names.index(name) for name in plan.cell.holder.names]
        limits.append(station.model.velocityLimit[free])
    share = (np.abs(np.diff(t.q, axis=0)) / t.dt / np.concatenate(limits)).max(axis=1)
    return [int(value) for value in np.clip(np.ceil(100.0 * greatest_until_stop(moves, share)), 1, 100)]


def pose_of(T: Array) -> Array:
    """x y z, quaternion x y z w (7) of a pose (4, 4)."""
    return np.concatenate([T[:3, 3], from_matrix(T[None, :3, :3])[0]])


def matrix_of(pose: Array) -> Array:
    """Pose (4, 4) of x y z, quaternion x y z w (7)."""
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = to_matrix(pose[None, 3:])[0], pose[:3]
    return T


# ----------------------------------------------------------------------------------------------------
# Reading: the moves, waits and outputs of a program, statement by statement.


@dataclass(frozen=True)
class ProgramStep:
    """A move.

    linear, fine  it is a line or an arc; it comes to rest at its end
    target        x y z [m], quaternion x y z w (7) for a line; the maker's axes [rad] (6) for a joint move
    speed         of the tip [m/s] for a line; percent for a joint move
    zone          size of the blend at its end [m]; NaN if the language does not give it
    branch        of a line, or UNSPECIFIED
    via           via pose of an arc, in the form of a line's target
    """

    linear: bool
    fine: bool
    target: Array
    speed: float
    zone: float = float("nan")
    branch: int = UNSPECIFIED
    via: Array | None = None


@dataclass(frozen=True)
class ProgramSteps:
    """What the statements of a program have done so far; grows with each statement.

    switched  (move, output, value) for outputs switched after a move; `triggers`: those switched on the path of a move
    """

    moves: list[ProgramStep] = field(default_factory=list)
    waits: dict[int, float] = field(default_factory=dict)
    switched: list[tuple[int, str, bool]] = field(default_factory=list)
    triggers: dict[int, tuple[Trigger, ...]] = field(default_factory=dict)

    def wait(self, seconds: float) -> None:
        """Stand still after the last move."""
        at = len(self.moves) - 1
        self.waits[at] = self.waits.get(at, 0.0) + seconds

    def switch(self, output: str, value: bool) -> None:
        """Set an output after the last move."""
        self.switched.append((len(self.moves) - 1, output, value))

    def trigger(self, distance: float, value: bool, output: str) -> None:
        """Set an output at a distance [m] before the end of the last move."""
        at = len(self.moves) - 1
        self.triggers[at] = (*self.triggers.get(at, ()), Trigger(distance, False, value, output))


@dataclass(frozen=True)
class ArmProgram:
    """A program (m moves) that was read, in the maker's axes, with frames from the maker's flange and base.

    axes, share  (m, 6) [rad] and (m) [percent] of joint moves; NaN for others
    via_quat     (m, 4) orientations at via points of arcs; NaN for others
    off          outputs switched off before the first move, and after the last one
    """

    program: RobotProgram
    axes: Array
    share: Array
    via_quat: Array
    off: tuple[frozenset[str], frozenset[str]]


def switch_triggers(switched: list[tuple[int, str, bool]], m: int) -> dict[int, tuple[Trigger, ...]]:
    """Outputs switched after one of m moves, as triggers at its end; the blend decides how much earlier they switch.

    Leaves out the switching off before the first move and, once more, after the last one.
    """
    found: dict[int, tuple[Trigger, ...]] = {}
    for at, output, value in switched:
        if at == 0 and value:
            found[1] = (*found.get(1, ()), Trigger(0.0, True, value, output))
        elif 0 < at < m - 1 or (at == m - 1 and value):
            found[at] = (*found.get(at, ()), Trigger(0.0, False, value, output))
    return found


def read_arm(
    title: str, steps: ProgramSteps, tool: Array, part: Array, forward: Callable[[Array], Array], file: str
) -> ArmProgram:
    """A program from its steps; the first one must be a joint move to the start.

    tool, part  (7) as from `pose_of`; forward: the maker's axes (k, 6) → T_part_nozzle (k, 4, 4)
    Raises InputError for steps that do not make a program.
    """
    moves, m = steps.moves, len(steps.moves)
    linear: Flags = np.array([move.linear for move in moves], dtype=bool)
    if m < 2 or linear[0] or not linear.any():
        raise InputError("it does not begin with a joint move, or has no lines", file=file)
    speed = np.array([move.speed for move in moves])
    if not (speed > 0.0).all():
        raise InputError("a move without a speed", file=file)
    if any(value for at, _, value in steps.switched if at < 0):
        raise InputError("an output goes on before the first target", file=file)
    axes = np.array([np.full(6, np.nan) if move.linear else move.target for move in moves])
    pose = np.empty((m, 7))
    pose[linear] = np.array([move.target for move in moves if move.linear])
    T = forward(axes[~linear])
    pose[~linear] = np.column_stack([T[:, :3, 3], from_matrix(T[:, :3, :3])])
    fine: Flags = np.array([move.fine for move in moves], dtype=bool)
    conf: Indices = np.full((m, 4), UNSPECIFIED, dtype=np.intp)
    conf[:, 3] = [move.branch for move in moves]
    vias = np.array([np.full(7, np.nan) if move.via is None else move.via for move in moves])
    triggers = switch_triggers(steps.switched, m)
    for at, group in steps.triggers.items():
        triggers[at] = (*triggers.get(at, ()), *group)
    program = RobotProgram(
        module=title,
        tool=tool,
        uframe=part,
        oframe=np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]),
        station="",
        start=np.concatenate([axes[0], np.full(6, np.nan)]),
        linear=linear,
        fine=fine,
        position=pose[:, :3],
        quat=pose[:, 3:],
        conf=conf,
        external=np.full((m, 6), np.nan),
        zone=np.where(fine, 0.0, np.array([move.zone for move in moves])),
        speed=np.column_stack([np.where(linear, speed, np.nan), np.full((m, 3), np.nan)]),
        wait=np.array([steps.waits.get(i, 0.0) for i in range(m)]),
        triggers=triggers,
        arcs=None if np.isnan(vias).all() else vias[:, :3],
    )
    first, last = (
        frozenset(output for at, output, value in steps.switched if at == k and not value) for k in (-1, m - 1)
    )
    return ArmProgram(program, axes, np.where(linear, np.nan, speed), vias[:, 3:], (first, last))


# ----------------------------------------------------------------------------------------------------
# Check of a program that was read against the plan.

ROUNDED_TURN = 2e-4  # [rad]; more than rounding three angles to three decimals in degrees can turn an orientation


def arm_differences(
    plan: Plan,
    moves: Moves,
    read: ArmProgram,
    convention: Convention,
    rounding: float,
    speeds: Array,
    tick: float = 0.0,
    zones: Array | None = None,
) -> list[str]:
    """Differences of a program from its plan, in words.

    rounding  of the axes [rad]
    speeds    (m) [m/s] of lines, as rounded in the file
    tick      that waits are rounded to [s]
    zones     (m) [m] of blends, if the language gives them
    Blends whose size a language does not give are assumed to be as large as the tolerance allows.
    """
    cell = plan.cell
    linear, circular = (np.concatenate([[False], kind]) for kind in (moves.linear, moves.circular))
    if not (np.array_equal(linear, read.program.linear) and np.array_equal(circular, read.program.circular)):
        return [f"moves are not of the planned kinds: {len(read.program.linear)}, planned {len(linear)}"]
    radii = np.concatenate([[0.0], move_radii(plan, moves)])
    program = _in_the_cell(plan, moves, read, convention, rounding, tick)
    said = replace(program, zone=read.program.zone)  # blends that the language does not give cannot be judged
    found = [*played_differences(plan, moves, program, speeds), *blend_differences(plan, said)]
    off = np.abs(read.axes - convention.counted(moves.q[:, cell.own]))[~linear].max()
    if not off <= rounding:
        found.append(f"axes differ by {off:.3g} rad")
    shares = np.array(percent(plan, moves))
    if not np.array_equal(read.share[~linear], np.concatenate([shares[:1], shares[~moves.linear]])):
        found.append("speeds of axes are not the planned ones")
    if np.abs(program.speed[linear, 0] - speeds[moves.linear]).max() > 1e-9:
        found.append("speeds of lines are not the planned ones")
    if not np.array_equal(program.fine, radii == 0.0):
        found.append("it stops elsewhere than planned")
    on_way = angle(read.via_quat[circular], moves.via.quat[moves.circular]).max(initial=0.0)
    if not on_way <= ROUNDED_TURN:
        found.append(f"orientations at via points of arcs differ by {on_way:.3g} rad")
    if zones is not None and np.abs(program.zone[1:] - zones).max() > 1e-9:
        found.append("blends are not the planned ones")
    return [*found, *off_differences(plan, read.off)]


def arm_program(plan: Plan, moves: Moves, read: ArmProgram, convention: Convention, rounding: float) -> RobotProgram:
    """A program of the plan's moves, ready to be played, with whatever its language leaves open taken from the plan.

    rounding  of the axes [rad]
    """
    return filled(plan, moves, _in_the_cell(plan, moves, read, convention, rounding, 0.0))


def _in_the_cell(
    plan: Plan, moves: Moves, read: ArmProgram, convention: Convention, rounding: float, tick: float
) -> RobotProgram:
    """The program in the cell's own frames and joints, with the plan's waits and blends where they are left open."""
    radii = np.concatenate([[0.0], move_radii(plan, moves)])
    planned = np.array([sum(wait.time for wait in moves.waits.get(i, ())) for i in range(-1, len(moves))])
    rounded = np.abs(read.program.wait - planned) <= 0.501 * tick
    start, own = convention.joints(read.axes[:1])[0], plan.trajectory.q[0, plan.cell.own]
    near = np.abs(start - own).max() <= 3.0 * rounding  # up to three of the maker's axes add up to one joint
    return replace(
        named(read.program, output_numbers(plan.problem)),
        start=np.concatenate([own if near else start, np.full(6, np.nan)]),
        wait=np.where(rounded, planned, read.program.wait),
        tool=pose_of(convention.T_flange_maker @ matrix_of(read.program.tool)),
        uframe=pose_of(convention.T_world_base(plan.cell) @ matrix_of(read.program.uframe)),
        joints=convention.joints(read.axes),
        zone=np.where(np.isnan(read.program.zone), radii, read.program.zone),
    )


def forward_of(cell: Cell, convention: Convention) -> Callable[[Array], Array]:
    """The maker's axes (k, 6) [rad] → T_part_nozzle (k, 4, 4), by the cell's own kinematics."""
    return lambda axes: cell.T_part_nozzle(convention.joints(axes))
