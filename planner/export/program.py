"""A robot program as its reader gives it, whatever its language; and the header that every program has."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import NDArray

from planner.base.arrays import Array, Indices
from planner.export.arcs import LinesAndArcs, segments
from planner.export.fit import continuous, slerp
from planner.export.text import LONGEST_COMMENT

if TYPE_CHECKING:
    from planner.cell.cell import Cell
    from planner.plan import Plan
    from planner.problem import Problem

# ----------------------------------------------------------------------------------------------------
# What decides whether a language supports a plan, known before there is one: the problem and its cell.


class Setup(Protocol):
    """Problem and cell; every Plan is one."""

    @property
    def problem(self) -> Problem:
        """What was asked for."""
        ...

    @property
    def cell(self) -> Cell:
        """The robots that it is asked of."""
        ...


@dataclass(frozen=True)
class ProblemSetup:
    """Problem and cell, before they are planned with."""

    problem: Problem
    cell: Cell


# ----------------------------------------------------------------------------------------------------
# The header of every program.


def about(plan: Plan) -> list[str]:
    """Problem, versions, size, where it resumes, and what was verified, line by line."""
    m = plan.metrics
    return [
        f"Problem {plan.name}, strategy {plan.strategy}",
        *made_with(plan),
        f"{len(plan.beads)} beads in {plan.layers} layers, "
        f"{m['deposited_length_mm']:.1f} mm deposited, {m['print_time_s']:.1f} s",
        *resumed(plan),
        *held_by(plan.cell),
        "Verified before it was written:",
        *verified(plan),
    ]


def made_with(plan: Plan) -> list[str]:
    """Versions of what the plan was made with, in as many comments as they need."""
    versions = ", ".join(f"{name} {version}" for name, version in sorted(plan.versions.items()))
    return textwrap.wrap(versions, LONGEST_COMMENT, break_on_hyphens=False)


def resumed(plan: Plan) -> list[str]:
    """Lines that say where the rest of a print begins, and which pause comes before its start; none for a whole one."""
    if not plan.first_bead:
        return []
    pause = plan.pause_left_out
    lines = [f"Resumes at bead {plan.first_bead}: those before it must be there"]
    if pause is not None:
        lines.append(f"Before the start, as in the pause before layer {pause.before_layer}: {pause.what}")
    return lines


def held_by(cell: Cell) -> list[str]:
    """Lines that say where all axes stand of what holds the part, where the controller moves none; none for other cells."""
    robot = cell.holder_robot
    if robot is None or cell.station is not None:
        return []
    kind, units = "positioner" if robot.inverse is None else "second arm", "deg, mm" if any(robot.slides) else "deg"
    title = f"A {kind}, {robot.name}, holds the part and is not moved. It stands at [{units}]"
    places = [
        cell.held[name] * 1e3 if slides else np.degrees(cell.held[name])
        for name, slides in zip(robot.joint_names, robot.slides, strict=True)
    ]
    # no line ends between a name and its value
    joints = ", ".join(f"{name}\xa0{place:g}" for name, place in zip(robot.joint_names, places, strict=True))
    lines = textwrap.wrap(joints, LONGEST_COMMENT - 2, break_on_hyphens=False)
    return [*textwrap.wrap(title, LONGEST_COMMENT), *("  " + line.replace("\xa0", " ") for line in lines)]


def verified(plan: Plan) -> list[str]:
    """A line for each check."""
    return [f"  {c.name}: {c.worst:.6g} {c.unit} (limit {c.limit:.6g})" for c in plan.checks]


# ----------------------------------------------------------------------------------------------------
# A program that was read.

UNSPECIFIED = -128  # in place of a part of a configuration that a language leaves open


@dataclass(frozen=True)
class Trigger:
    """Switches the extruder of a digital output `distance` [m] from the end of a move, or from its start."""

    distance: float
    from_start: bool
    value: bool
    signal: str


@dataclass(frozen=True)
class RobotProgram:
    """What a program does, in the order in which it runs (m moves; SI units, radians).

    tool, uframe, oframe       (7,) x y z [m], quaternion x y z w
    station                    mechanical unit that moves the part; empty for a fixed bed
    start                      (12,) joints and station axes of the first move [rad], NaN where unused; likewise
    approach                   (4,) speed of that move, as `speed`; None where a program does not say
    bead                       (m,) whose procedure the move stands in, that of its bead or on the way there, -1 for none; None
                               where a reader does not tell
    second                     (m + 1, 4) likewise of the arm that moves the part, by its flange in the world: of its way to the
                               start, then of each move; None where no arm does
    linear, fine               (m,) bool; what is not linear goes straight in joint space
    position, quat             (m, 3) [m], (m, 4) x y z w
    conf                       (m, 4) cf1, cf4, cf6, cfx; UNSPECIFIED where the language has none
    external                   (m, 6) station axes [rad], NaN where unused. Which of them slide a program does not say: their
                               mm were read as degrees, see `external_read`
    zone                       (m,) radius of the corner zone at the target [m]; 0 where the motion comes to rest,
                               NaN where it has no distance
    speed                      (m, 4) tip [m/s], reorientation [rad/s], linear axes [m/s], rotating axes [rad/s]
    wait                       (m,) time at rest after the move [s]
    triggers                   move → its triggers, in order
    arcs                       (m, 3) of linear moves that are arcs, a point on the way [m]; NaN for all others, None for no arcs
    arc_postures               (m, 14) what else is said of these points: quaternion x y z w, cf1, cf4, cf6, cfx, and station axes
                               [rad]; None where a language does not have it
    joints                     (m, n) of the arm at targets of joint moves, where the language has them [rad]
    demands                    move → (distance [m] from its end, value that an analog output takes there), in order
    sends                      move → strings sent to the extruder's board after it, in order; -1: before the first
    send_rests                 move → for each of them, how long the robot has rested there when it is sent [s]
    """

    module: str
    tool: Array
    uframe: Array
    oframe: Array
    station: str
    start: Array
    linear: NDArray[np.bool_]
    fine: NDArray[np.bool_]
    position: Array
    quat: Array
    conf: NDArray[np.intp]
    external: Array
    zone: Array
    speed: Array
    wait: Array
    triggers: dict[int, tuple[Trigger, ...]]
    sends: dict[int, tuple[str, ...]] = field(default_factory=dict)
    send_rests: dict[int, tuple[float, ...]] = field(default_factory=dict)
    demands: dict[int, tuple[tuple[float, float], ...]] = field(default_factory=dict)
    joints: Array | None = None
    arcs: Array | None = None
    arc_postures: Array | None = None
    approach: Array | None = None
    bead: Indices | None = None
    second: Array | None = None

    @property
    def circular(self) -> NDArray[np.bool_]:
        """Moves (m) that are arcs."""
        return np.zeros(len(self.linear), dtype=bool) if self.arcs is None else ~np.isnan(self.arcs[:, 0])

    @property
    def via(self) -> Array:
        """(m, 3) points on the way of arcs, and targets of all other moves [m]."""
        return self.position if self.arcs is None else np.where(np.isnan(self.arcs), self.position, self.arcs)

    @property
    def segments(self) -> LinesAndArcs:
        """The lines and arcs (m - 1) from each target to the next; of joint moves, the line."""
        p = self.position
        return segments(p[:-1], self.via[1:], p[1:], self.circular[1:])


# ----------------------------------------------------------------------------------------------------
# The same cut where the extruder is switched.


@dataclass(frozen=True)
class ProgramPiece:
    """Targets (m) between two extruder events, both included, and moves (m - 1) from each to the next.

    linear, circular, via, speed  (m - 1) of the moves
    known                         (m) a target of the program, not a point where a trigger cuts a move
    """

    position: Array
    quat: Array
    external: Array
    conf: Indices
    linear: NDArray[np.bool_]
    circular: NDArray[np.bool_]
    via: Array
    speed: Array
    known: NDArray[np.bool_]


def pieces_of(program: RobotProgram) -> Iterator[tuple[bool, ProgramPiece]]:
    """The program's targets, cut at the points where the extruder is switched: (extruder on, piece)."""
    rows = np.column_stack([program.position, program.quat, program.external, program.conf])
    m, circular, via = len(rows), program.circular, program.via
    begun: list[Array] = [rows[:1]]
    by: list[Indices] = []  # the move that goes from each target to the next
    vias: list[Array] = []  # and its via point
    known: list[NDArray[np.bool_]] = [np.array([True])]
    on, done = False, 1  # rows before `done` have been dealt with

    def take(last: int) -> None:
        begun.append(rows[done:last])
        by.append(np.arange(done, last))
        vias.append(via[done:last])
        known.append(np.ones(last - done, dtype=bool))

    def piece() -> ProgramPiece:
        table = np.concatenate(begun)
        moves = np.concatenate([np.empty(0, dtype=np.intp), *by])
        return ProgramPiece(
            position=table[:, :3],
            quat=continuous(table[:, 3:7]),
            external=table[:, 7:13],
            conf=table[:, 13:].astype(np.intp),
            linear=program.linear[moves],
            circular=circular[moves],
            via=np.concatenate([np.empty((0, 3)), *vias]),
            speed=program.speed[moves, 0],
            known=np.concatenate(known),
        )

    way = program.segments
    lengths = np.concatenate([[0.0], way.length])
    for i in sorted(move for move in program.triggers if 0 < move < m):
        take(i)
        length, own = float(lengths[i]), way.take(np.array([i - 1]))
        events = []
        for trigger in program.triggers[i]:
            at = trigger.distance if trigger.from_start else length - trigger.distance
            events.append((min(max(at / length, 0.0), 1.0) if length else float(not trigger.from_start), trigger.value))
        cut_at = 0.0
        for u, value in sorted(events, key=lambda event: event[0]):
            cut = rows[i - 1] + u * (rows[i] - rows[i - 1])
            cut[:3] = own.at(np.array([u]))[0]
            cut[3:7] = slerp(rows[i - 1 : i, 3:7], rows[i : i + 1, 3:7], np.array([u]))[0]
            if u > 0.0:
                begun.append((rows[i] if u == 1.0 else cut)[None])
                by.append(np.array([i]))
                vias.append(own.at(np.array([0.5 * (cut_at + u)])))
                known.append(np.array([u == 1.0]))
            if sum(len(part) for part in begun) > 1 or on != value:
                yield on, piece()
            begun, by, vias, known, on = [begun[-1][-1:]], [], [], [known[-1][-1:]], value
            cut_at = u
        done = i
        if not events or events[-1][0] < 1.0:
            begun.append(rows[i : i + 1])
            by.append(np.array([i]))
            vias.append(own.at(np.array([0.5 * (cut_at + 1.0)])))
            known.append(np.ones(1, dtype=bool))
        done = i + 1
    take(m)
    yield on, piece()


def named(program: RobotProgram, numbers: dict[str, int]) -> RobotProgram:
    """The program with signals in place of their outputs' numbers; a number that is none of theirs stays."""
    names = {str(number): signal for signal, number in numbers.items()}
    return replace(
        program,
        triggers={
            move: tuple(replace(each, signal=names.get(each.signal, each.signal)) for each in group)
            for move, group in program.triggers.items()
        },
    )
