"""A robot program as read from any language, and the header that every program has."""

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
# What decides whether a language supports a plan, known before planning: the problem and its cell.


class Setup(Protocol):
    """Problem and cell; every Plan is one."""

    @property
    def problem(self) -> Problem:
        """The problem to solve."""
        ...

    @property
    def cell(self) -> Cell:
        """The robots that solve it."""
        ...


@dataclass(frozen=True)
class ProblemSetup:
    """Problem and cell, before planning."""

    problem: Problem
    cell: Cell


# ----------------------------------------------------------------------------------------------------
# The header of every program.


def about(plan: Plan) -> list[str]:
    """Header lines: problem, versions, size, where it resumes, and what was verified."""
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
    """Versions of the software that made the plan, in as many comment lines as needed."""
    versions = ", ".join(f"{name} {version}" for name, version in sorted(plan.versions.items()))
    return textwrap.wrap(versions, LONGEST_COMMENT, break_on_hyphens=False)


def resumed(plan: Plan) -> list[str]:
    """Lines that say where the rest of a print begins, and which pause precedes its start; none for a whole print."""
    if not plan.first_bead:
        return []
    pause = plan.pause_left_out
    lines = [f"Resumes at bead {plan.first_bead}: those before it must be there"]
    if pause is not None:
        lines.append(f"Before the start, as in the pause before layer {pause.before_layer}: {pause.what}")
    return lines


def held_by(cell: Cell) -> list[str]:
    """Lines with the axis positions of the part's holder if the controller moves none of them; none for other cells."""
    robot = cell.holder_robot
    if robot is None or cell.station is not None:
        return []
    kind, units = "positioner" if robot.inverse is None else "second arm", "deg, mm" if any(robot.slides) else "deg"
    title = f"A {kind}, {robot.name}, holds the part and is not moved. It stands at [{units}]"
    places = [
        cell.held[name] * 1e3 if slides else np.degrees(cell.held[name])
        for name, slides in zip(robot.joint_names, robot.slides, strict=True)
    ]
    # never break a line between a name and its value
    joints = ", ".join(f"{name}\xa0{place:g}" for name, place in zip(robot.joint_names, places, strict=True))
    lines = textwrap.wrap(joints, LONGEST_COMMENT - 2, break_on_hyphens=False)
    return [*textwrap.wrap(title, LONGEST_COMMENT), *("  " + line.replace("\xa0", " ") for line in lines)]


def verified(plan: Plan) -> list[str]:
    """A line for each check."""
    return [f"  {c.name}: {c.worst:.6g} {c.unit} (limit {c.limit:.6g})" for c in plan.checks]


# ----------------------------------------------------------------------------------------------------
# A program that was read.

UNSPECIFIED = -128  # stands for a part of a configuration that a language leaves open


@dataclass(frozen=True)
class Trigger:
    """Switches an extruder's digital output at `distance` [m] from the end of a move, or from its start."""

    distance: float
    from_start: bool
    value: bool
    signal: str


@dataclass(frozen=True)
class RobotProgram:
    """What a program does, in the order in which it runs (m moves; SI units, radians).

    tool, uframe, oframe       (7,) x y z [m], quaternion x y z w
    station                    mechanical unit that moves the part; empty for a fixed bed
    start                      (12,) joints and station axes of the first move [rad], as `external`; NaN where unused
    approach                   (4,) speed of that move, as `speed`; None if the program does not give it
    bead                       (m,) bead whose procedure contains the move, on the bead or on the way to it, -1 for
                               none; None if the reader does not report it
    second                     (m + 1, 4) speeds, as `speed`, of the flange (in the world) of an arm that moves the
                               part: on its way to the start, then of each move; None without such an arm
    linear, fine               (m,) bool; a move that is not linear is straight in joint space
    position, quat             (m, 3) [m], (m, 4) x y z w
    conf                       (m, 4) cf1, cf4, cf6, cfx; UNSPECIFIED where the language has none
    external                   (m, 6) station axes [rad], NaN where unused. A program does not say which of them slide,
                               so mm of sliding axes are read as degrees, see `external_read`
    zone                       (m,) radius of the corner zone at the target [m]; 0 where the motion comes to rest, NaN
                               if it is not given as a distance
    speed                      (m, 4) tip [m/s], reorientation [rad/s], linear axes [m/s], rotary axes [rad/s]
    wait                       (m,) time at rest after the move [s]
    triggers                   move → its triggers, in order
    arcs                       (m, 3) via points of linear moves that are arcs [m], NaN for others; None without arcs
    arc_postures               (m, 14) further data of the via points: quaternion x y z w, cf1, cf4, cf6, cfx, and
                               station axes [rad]; None if the language has none
    joints                     (m, n) of the arm at targets of joint moves, if the language gives them [rad]
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
        """(m, 3) via points of arcs, and targets of all other moves [m]."""
        return self.position if self.arcs is None else np.where(np.isnan(self.arcs), self.position, self.arcs)

    @property
    def segments(self) -> LinesAndArcs:
        """The lines and arcs (m - 1) from each target to the next; joint moves count as lines."""
        p = self.position
        return segments(p[:-1], self.via[1:], p[1:], self.circular[1:])


# ----------------------------------------------------------------------------------------------------
# A program cut into pieces where the extruder is switched.


@dataclass(frozen=True)
class ProgramPiece:
    """Targets (m) between two extruder events, both included, and moves (m - 1) from each to the next.

    linear, circular, via, speed  (m - 1) of the moves
    known                         (m) a target of the program rather than a point where a trigger cuts a move
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
    """The program with output numbers replaced by their signals; other numbers stay."""
    names = {str(number): signal for signal, number in numbers.items()}
    return replace(
        program,
        triggers={
            move: tuple(replace(each, signal=names.get(each.signal, each.signal)) for each in group)
            for move, group in program.triggers.items()
        },
    )
