"""KUKA Robot Language for KR C controllers (KSS): writer, reader, and check against the plan."""

from __future__ import annotations

import re
from collections.abc import Callable, Container, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from planner.base.arrays import Array, Indices
from planner.base.errors import InputError
from planner.export.arms import AXIS_5_NEGATIVE, BEHIND_AXIS_1, BEHIND_LOWER_ARM, ROUNDED_TURN, percent
from planner.export.euler import fixed_xyz, from_fixed_xyz, written
from planner.export.external import carrying_axes, external_axes, external_read, external_written
from planner.export.fit import angle, from_matrix, to_matrix
from planner.export.grammar import NUMBER, Grammar, Statement, inlined
from planner.export.moves import (
    Moves,
    MoveSection,
    blend_differences,
    move_radii,
    moves_with_arcs,
    sections,
    tip_acceleration,
)
from planner.export.parts import cut, numbered, packed, part_about
from planner.export.program import UNSPECIFIED, RobotProgram, Trigger, about, named
from planner.export.rapid.text import module_name
from planner.export.readback import filled, played_differences
from planner.export.speeds import stepped_speeds
from planner.export.support import by_bead, off_differences, output_numbers, outputs_about
from planner.export.text import ascii_comment, number, resting

if TYPE_CHECKING:
    from planner.plan import Plan

# ----------------------------------------------------------------------------------------------------
# KUKA's conventions: axes A1 to A6, angles A B C, Status and Turn.
#
# Axes: at KUKA's zero the arm points straight forward, and A1, A4, A6 turn against our joints (ROS-Industrial,
# kuka_experimental, whose URDF files follow the controllers). Angles: R = Rz(A) Ry(B) Rx(C).
#
# Status: bit 0 is set if the wrist centre lies behind axis 1; bit 1 if A3 is beyond the stretched arm (0 without an
# offset between axes 3 and 4, else less by the angle by which that offset turns the forearm); bit 2 if A5 is negative
# (Siemens, SINUMERIK ONE programming manual 6FC5398-2EP40, STAT, which has KUKA's bits). ISG inverts bit 2; a
# controller that does so, too, still finds A5's sign in Turn. Turn: bit i - 1 is set if axis i is negative. LIN ignores
# both; they matter when a program is entered at a target. PTP targets are axis angles here.

SIGNS = np.array([-1.0, 1.0, 1.0, -1.0, 1.0, -1.0])
OFFSETS = np.radians([0.0, -90.0, 90.0, 0.0, 0.0, 0.0])


def to_kuka(q: Array) -> Array:
    """A1 to A6 (m, 6) [rad] for our joints (m, 6)."""
    out: Array = SIGNS * q + OFFSETS
    return out


def from_kuka(axes: Array) -> Array:
    """Our joints (m, 6) for A1 to A6 (m, 6) [rad]."""
    out: Array = SIGNS * (axes - OFFSETS)
    return out


def status(branch: Indices) -> Indices:
    """Status (m) of branches (m)."""
    behind, below, flipped = (branch & bit > 0 for bit in (BEHIND_AXIS_1, BEHIND_LOWER_ARM, AXIS_5_NEGATIVE))
    out: Indices = behind * 1 + ~below * 2 + flipped * 4
    return out


def branch_of(status_: Indices) -> Indices:
    """Branches (m) of Status (m)."""
    out: Indices = (
        (status_ & 1 > 0) * BEHIND_AXIS_1 + (status_ & 2 == 0) * BEHIND_LOWER_ARM + (status_ & 4 > 0) * AXIS_5_NEGATIVE
    )
    return out


def turn(q: Array) -> Indices:
    """Turn (m) of our joints (m, 6)."""
    out: Indices = (np.round(to_kuka(q), 9) < 0.0) @ (1 << np.arange(6))
    return out


def angles(R: Array) -> Array:
    """A B C (m, 3) [rad] of rotations (m, 3, 3); C is 0 if B is a right angle, as A and C then share an axis."""
    return fixed_xyz(R)[:, ::-1]


def quaternions(abc: Array) -> Array:
    """Unit quaternions (m, 4) x y z w of A B C (m, 3) [rad]."""
    return from_fixed_xyz(abc[:, ::-1])


# ----------------------------------------------------------------------------------------------------
# Names, frames and axes as KRL takes them.

LONGEST_NAME = 24
MARK = ";"  # begins a comment
WAIT = "WAIT SEC {:.3f}"
MM, DEGREES = 3, 4  # decimals of targets
FRAME_DEGREES = 6  # decimals of frames
# reserved words and types of KRL that a name in CamelCase might match, KUKA's own programs, and our data
RESERVED = """BRAKE CASE CAST_FROM CAST_TO CHANNEL CIRC CONFIRM CONST CONTINUE DECL DEF DEFAULT DEFDAT DEFFCT DELAY DISABLE
    ELSE ENABLE END ENDDAT ENDFCT ENDFOR ENDIF ENDLOOP ENDSWITCH ENDWHILE ENUM EXIT EXT EXTFCT FALSE FOR FRAME GLOBAL
    GOTO HALT IF IMPORT INTERRUPT IS LIN LOOP MAXIMUM MINIMUM NOT OFF ON OR POS PRIO PTP PUBLIC PULSE REAL REPEAT RESUME
    RETURN SEC SIGNAL SPLINE STRUC SWITCH THEN TO TOOL BASE TRIGGER TRUE UNTIL WAIT WHEN WHILE FINISH FPART FTOOL XSTART
    ANIN ANOUT AXIS BAS CCLOSE CELL CHAR COPEN CREAD CWRITE E3AXIS E3POS E6AXIS E6POS INT LOAD SPS SREAD SWRITE"""


def krl_name(name: str) -> str:
    """CamelCase name, at most 24 letters and digits, from a problem's name; KRL ignores case."""
    joined = module_name(name, LONGEST_NAME)
    return "Print" + joined if joined.upper() in RESERVED.split() else joined


def frame(T: Array) -> str:
    """Components of the FRAME (mm, degrees) for a pose (4, 4)."""
    values = [*(T[:3, 3] * 1e3), *written(angles(T[None, :3, :3])[0], FRAME_DEGREES)]
    decimals = [MM] * 3 + [FRAME_DEGREES] * 3
    return ",".join(f"{name} {number(v, d)}" for name, v, d in zip("XYZABC", values, decimals, strict=True))


def axes(degrees: Array, external: Array) -> str:
    """Components of the E6AXIS for one posture: A1 to A6 (6) and the external axes (k) [deg, mm]."""
    named = [(f"A{i}", v) for i, v in enumerate(degrees, 1)] + [(f"E{i}", v) for i, v in enumerate(external, 1)]
    return ",".join(f"{name} {number(v, DEGREES)}" for name, v in named)


# ----------------------------------------------------------------------------------------------------
# Writer: a .src with a subprogram for each bead, and a .dat with the frames.
#
# Targets are inline in the moves, as in programs of offline systems: E6AXIS for travel, which defines the posture, and
# E6POS in the part's frame for lines. Subprograms are local to the file, so that each bead can be selected, yet there
# is only one file to copy. A longer program is a file that calls others, <Name>_1.src and so on: neither calls nor the
# end of a subprogram stop the advance run, so a bead may continue in the next one.

LOCAL_PROGRAMS = 250  # per .src; KUKA accepts 255
SUBPROGRAM = 1000  # moves in a subprogram
# bytes per .src: some 4,000 lines; users report that the pendant's editor slows down beyond 5,000. KSS 8.3 was seen to
# hold 4 MB of programs in total, whatever the size of each; the header says how many bytes these have.
FILE_SIZE = 400_000
LOADED = 4_000_000

SPEED = 5  # decimals of m/s; a fibre may be laid at 5 mm/s, where a move of 20 mm takes 4 s
LEAST_SPEED = 10.0**-SPEED
STATION = "MACHINE_DEF[2]"  # KUKA's usual entry for an external kinematic system; the robot itself is the first one
ADVANCE = 3  # moves by which the interpreter runs ahead, KUKA's default; blending needs it
HEAD_ROOM = 1.5  # × the plan's rate of reorientation, so that the tip's speed alone governs
LEAST_TURNING = 100.0  # deg/s
# system variables, and the machine data that bound them
GREATEST = {"$VEL.ORI1": "$VEL_MA.ORI1", "$VEL.ORI2": "$VEL_MA.ORI2", "$ACC.CP": "$ACC_MA.CP"}
# radii of blends [mm]: few values, so that few lines are needed to set them
LEVELS = np.array([a * 10.0**k for k in range(-3, 2) for a in (1.0, 2.0, 5.0)])


@dataclass(frozen=True)
class Subprogram:
    """A bead, or a piece of one: its name, and its lines, an empty one and then from DEF to END."""

    name: str
    lines: tuple[str, ...]

    @property
    def size(self) -> int:
        """Bytes in the file."""
        return sum(map(len, self.lines)) + len(self.lines)


def write(plan: Plan) -> dict[str, str]:
    """Source and data files of a verified plan (ASCII, mm, degrees)."""
    name, moves = krl_name(plan.name), moves_with_arcs(plan)
    header = _header(plan)
    subprograms = list(_subprograms(plan, moves))
    files = packed(subprograms, (each.size for each in subprograms), FILE_SIZE, LOCAL_PROGRAMS)
    further: dict[str, str] = {}
    if len(files) == 1:
        calls = [each.name for each in subprograms]
    else:
        calls = [numbered(name, k, LONGEST_NAME) for k in range(1, len(files) + 1)]
        for k, (title, own) in enumerate(zip(calls, files, strict=True), 1):
            about_part = [ascii_comment(MARK, text, 2) for text in part_about(about(plan), k, len(files))]
            further[f"{title}.src"] = _source(title, [*about_part, *(f"  {each.name}()" for each in own)], own)
        size = sum(map(len, further.values()))
        header.append(ascii_comment(MARK, f"Calls {len(files)} more files, {size} bytes: copy all of them", 2))
        if size > LOADED:
            words = f"Note: KSS 8.3 was seen to hold {LOADED // 10**6} MB of programs in all; see docs/languages.md"
            header.append(ascii_comment(MARK, words, 2))
    off = [f"  $OUT[{k}]=FALSE" for k in output_numbers(plan.problem).values()]
    body = [
        *header,
        "  BAS(#INITMOV,0)",
        *(line for key, value in settings(plan, moves).items() for line in _set(key, value)),
        *off,
        f"  BAS(#VEL_PTP,{percent(plan, moves)[0]})",
        "  PTP XSTART",
        *resting(moves.waits.get(-1, ()), MARK, WAIT, 2),
        *(f"  {call}()" for call in calls),
        *off,
    ]
    cell, start = plan.cell, plan.trajectory.q[:1]
    degrees = np.degrees(to_kuka(start[:, cell.own]))[0]
    external = external_written(cell, start[:, cell.besides])[0]
    on = plan.cell.T_world_holder if plan.cell.station is None else plan.cell.T_plate_part
    data = [
        "&ACCESS RVP",
        "&REL 1",
        f"DEFDAT {name}",
        f"  DECL FRAME FTOOL={{{frame(plan.cell.T_flange_nozzle)}}}",
        f"  DECL FRAME FPART={{{frame(on)}}}",
        f"  DECL E6AXIS XSTART={{{axes(degrees, external)}}}",
        "ENDDAT",
        "",
    ]
    local = [] if further else subprograms
    return {f"{name}.src": _source(name, body, local), f"{name}.dat": "\n".join(data), **further}


def _set(key: str, value: str) -> list[str]:
    """Lines that set a system variable, to no more than the machine's own maximum, beyond which a controller stops."""
    if key not in GREATEST:
        return [f"  {key}={value}"]
    greatest = GREATEST[key]
    return [f"  IF {greatest}<{value} THEN", f"    {key}={greatest}", "  ELSE", f"    {key}={value}", "  ENDIF"]


def _source(name: str, body: list[str], subprograms: list[Subprogram]) -> str:
    """Text of a source file: the program that it is named after, and its local programs."""
    inner = [line for each in subprograms for line in each.lines]
    return "\n".join(["&ACCESS RVP", "&REL 1", f"DEF {name}()", *body, "END", *inner, ""])


def settings(plan: Plan, moves: Moves) -> dict[str, str]:
    """System variables that are set once, in order."""
    turning = max(LEAST_TURNING, 10.0 * float(np.ceil(HEAD_ROOM * np.degrees(moves.turn.max()) / 10.0)))
    station = plan.cell.station
    base = "FPART" if station is None else f"EK({STATION}.ROOT,{STATION}.MECH_TYPE,FPART)"
    return {
        "$TOOL": "FTOOL",
        "$BASE": base,
        "$IPO_MODE": "#BASE",
        "$ORI_TYPE": "#VAR",
        "$CIRC_TYPE": "#BASE",
        "$ADVANCE": f"{ADVANCE}",
        "$APO.CPTP": "50",
        "$VEL.ORI1": f"{turning:.1f}",
        "$VEL.ORI2": f"{turning:.1f}",
        "$ACC.CP": f"{tip_acceleration(plan.trajectory):.1f}",
    }


def radii_of(plan: Plan, moves: Moves) -> Array:
    """Approximation distance (m) [m] at the end of each move: the next smaller of LEVELS; 0 where the robot stops."""
    radius = move_radii(plan, moves) * 1e3 * (1.0 + 1e-9)
    below = np.searchsorted(LEVELS, radius, side="right")
    # a radius below the smallest level is still no reason to stop
    out: Array = np.where(radius > 0.0, LEVELS[np.maximum(below - 1, 0)], 0.0) * 1e-3
    return out


def _header(plan: Plan) -> list[str]:
    cell = plan.cell
    texts = [
        *about(plan),
        *outputs_about(plan.problem),
        f"A1 to A6, as KUKA counts: {', '.join(cell.arm.names[-6:])}",
        "The tool's load is that of the controller: set it there before the first run.",
        f"$ROBROOT in $WORLD must be {frame(cell.T_world_base)}",
    ]
    named = [f"E{i} {axis.words}" for i, axis in enumerate(external_axes(cell), 1)]
    if before := named[: len(carrying_axes(cell))]:
        texts[-1] = "What carries the robot must be coupled to it in the machine data (ERSYSROOT), its root in $WORLD"
        texts += [f"  {frame(cell.T_world_base)}", f"Its external axes: {', '.join(before)}"]
        texts += ["$ROBROOT on it, with the axes that move at 0, must be in $WORLD", f"  {frame(cell.T_world_foot)}"]
    if cell.station is not None:
        texts += [
            f"External axes of {STATION}, {cell.station.name}: {', '.join(named[len(before) :])}",
            f"  its root in $WORLD must be {frame(cell.T_world_holder_base)}",
        ]
    return [ascii_comment(MARK, text, 2) for text in texts]


def _targets(plan: Plan, moves: Moves) -> list[str]:
    """The aggregate of each move's target; for an arc, preceded by that of its middle."""
    t, own, k = plan.trajectory, plan.cell.own, moves.sample
    external = np.round(external_written(plan.cell, moves.targets.station[1:]), DEGREES) + 0.0
    joints = np.round(np.degrees(to_kuka(t.q[k, own])), DEGREES) + 0.0
    lines, vias = (
        _frames(moves.targets.position[1:], moves.targets.quat[1:]),
        _frames(moves.via.position, moves.via.quat),
    )
    beside = np.round(external_written(plan.cell, moves.via.station), DEGREES) + 0.0
    states, turns = status(t.branch[k].astype(np.intp)).tolist(), turn(moves.q[1:, own]).tolist()
    extra = "".join(f",E{i} %.{DEGREES}f" for i in range(1, external.shape[1] + 1))
    axis = "{E6AXIS: " + ",".join(f"A{i} %.{DEGREES}f" for i in range(1, 7)) + extra + "}"
    place = "{E6POS: " + ",".join(f"{n} %.{MM if n in 'XYZ' else DEGREES}f" for n in "XYZABC")
    line, middle = f"{place},S %d,T %d{extra}}}", f"{place}{extra}}},"
    first = [
        middle % (*via, *e) if circular else ""
        for circular, via, e in zip(moves.circular.tolist(), vias.tolist(), beside.tolist(), strict=True)
    ]
    return [
        via + line % (*p, s, w, *e) if linear else axis % (*q, *e)
        for linear, via, p, q, s, w, e in zip(
            moves.linear.tolist(), first, lines.tolist(), joints.tolist(), states, turns, external.tolist(), strict=True
        )
    ]


def _frames(position: Array, quat: Array) -> Array:
    """X Y Z A B C (m, 6) as written [mm, deg]."""
    return np.column_stack([np.round(position * 1e3, MM) + 0.0, written(angles(to_matrix(quat)), DEGREES)])


def _subprograms(plan: Plan, moves: Moves) -> Iterator[Subprogram]:
    """All subprograms with moves, in calling order."""
    bead = plan.trajectory.bead
    outputs = by_bead(plan, list(output_numbers(plan.problem).values()))
    targets, shares = _targets(plan, moves), percent(plan, moves)
    speeds = stepped_speeds(moves, LEAST_SPEED).tolist()
    radii = radii_of(plan, moves).tolist()
    share, speed, radius = shares[0], -1.0, -1.0
    taken: set[str] = set()
    for section in cut(sections(plan, moves), SUBPROGRAM):
        name = _name(section, taken)
        taken.add(name)
        lines = ["", f"DEF {name}()"]
        lines += [ascii_comment(MARK, section.about, 2)] if section.about else []
        for i in section.moves:
            if not moves.linear[i]:
                if shares[i] != share:
                    share = shares[i]
                    lines.append(f"  BAS(#VEL_PTP,{share})")
                lines.append(f"  PTP {targets[i]}" + (" C_PTP" if radii[i] > 0.0 else ""))
            else:
                if speeds[i] != speed:
                    speed = speeds[i]
                    lines.append(f"  $VEL.CP={speed:.{SPEED}f}")
                if radii[i] not in (0.0, radius):
                    radius = radii[i]
                    lines.append(f"  $APO.CDIS={radius * 1e3:.3f}")
                begins, ends = (outputs[bead[at]] for at in (moves.sample[i - 1] if i else 0, moves.sample[i]))
                for switched, where, output, value in (
                    (moves.on_start[i], "DISTANCE", begins, "TRUE"),
                    (moves.on_end[i], "PATH", ends, "TRUE"),
                    (moves.off_end[i], "PATH", ends, "FALSE"),
                ):
                    if switched:
                        lines.append(f"  TRIGGER WHEN {where}=0 DELAY=0 DO $OUT[{output}]={value}")
                lines.append(
                    f"  {'CIRC' if moves.circular[i] else 'LIN'} {targets[i]}" + (" C_DIS" if radii[i] > 0.0 else "")
                )
            lines += resting(moves.waits.get(i, ()), MARK, WAIT, 2)
        yield Subprogram(name, (*lines, "END"))


def _name(section: MoveSection, taken: Container[str]) -> str:
    """Name of a section's subprogram, or of its next piece."""
    name = f"Bead{section.number:04d}" if section.number else "Finish"
    k = 2
    whole = name
    while name in taken:
        name, k = f"{whole}_{k}", k + 1
    return name


# ----------------------------------------------------------------------------------------------------
# Reader: exactly the subset that the writer uses.

Forward = Callable[[Array], Array]

NAME = r"[A-Za-z][A-Za-z0-9_]{0,23}"
FRAME = ",".join(rf"{name} ({NUMBER})" for name in "XYZABC")
EXTERNAL = rf"((?:,E[1-6] {NUMBER}){{0,6}})"
AXES = ",".join(rf"A{i} ({NUMBER})" for i in range(1, 7)) + EXTERNAL
ATTRIBUTE = r"&(?:ACCESS RVP|REL 1)"
SOURCE = Grammar.of(
    "KRL",
    MARK,
    {
        "arc": rf"CIRC \{{E6POS: {FRAME}{EXTERNAL}\}},\{{E6POS: {FRAME},S ([0-9]{{1,2}}),T ([0-9]{{1,2}}){EXTERNAL}\}}( C_DIS)?",
        "line": rf"LIN \{{E6POS: {FRAME},S ([0-9]{{1,2}}),T ([0-9]{{1,2}}){EXTERNAL}\}}( C_DIS)?",
        "point": rf"PTP \{{E6AXIS: {AXES}\}}( C_PTP)?",
        "speed": rf"\$VEL\.CP=({NUMBER})",
        "radius": rf"\$APO\.CDIS=({NUMBER})",
        "share": r"BAS\(#VEL_PTP,([0-9]{1,3})\)",
        "trigger": r"TRIGGER WHEN (PATH|DISTANCE)=0 DELAY=0 DO \$OUT\[([0-9]{1,4})\]=(TRUE|FALSE)",
        "output": r"\$OUT\[([0-9]{1,4})\]=FALSE",
        "wait": rf"WAIT SEC ({NUMBER})",
        "call": rf"({NAME})\(\)",
        "start": r"PTP XSTART",
        "defaults": r"BAS\(#INITMOV,0\)",
        "bound": rf"IF (\$[A-Z_0-9.]{{1,24}})<({NUMBER}) THEN",
        "else": r"ELSE",
        "bounded": r"ENDIF",
        "setting": r"(\$[A-Z_0-9.]{1,24})=([#$A-Z0-9_.(),\[\]]{1,60})",
        "define": rf"DEF ({NAME})\(\)",
        "end": r"END",
        "attribute": ATTRIBUTE,
    },
)
DATA = Grammar.of(
    "KRL data",
    MARK,
    {
        "attribute": ATTRIBUTE,
        "define": rf"DEFDAT ({NAME})",
        "frame": rf"DECL FRAME (FTOOL|FPART)=\{{{FRAME}\}}",
        "start": rf"DECL E6AXIS XSTART=\{{{AXES}\}}",
        "end": r"ENDDAT",
    },
)
COUPLED = re.compile(r"EK\((MACHINE_DEF\[[1-9]\])\.ROOT,\1\.MECH_TYPE,FPART\)")


@dataclass(frozen=True)
class KrlProgram:
    """A program (m moves) that was read.

    program   triggers name outputs by number; joints are in KUKA's axes; the zone of an approximated PTP is NaN, as it
              has no distance
    axes      (m, 6) A1 to A6 of PTP targets [rad]; NaN for others
    turn      (m) Turn of LIN targets; UNSPECIFIED for others
    middle    (m, 10) quaternion x y z w and external axes [rad] at via points of arcs; NaN for others
    share     (m) speed of the axes [percent]
    settings  system variables and their values
    off       outputs switched off before the first move, and after the last one
    """

    program: RobotProgram
    axes: Array
    turn: Indices
    middle: Array
    share: Indices
    settings: dict[str, str]
    off: tuple[frozenset[str], ...]


def read_krl(source: str, data: str, forward: Forward, further: Mapping[str, str] | None = None) -> KrlProgram:
    """Program from the texts of .src and .dat as `write` writes them; further: program → text of other .src files.

    forward: A1 to A6 and external axes (m, 12) [rad], NaN where unused → T_part_nozzle (m, 4, 4). Raises InputError,
    with the line, for an unknown or misplaced statement or name.
    """
    title, frames, start = _data(data)
    run = _KrlRun(start)
    bodies = _subprogram_bodies(source, title)
    files = {title: set(bodies)}
    for name, text in (further or {}).items():
        own = _subprogram_bodies(text, name)
        if twice := next((each for each in own if each in bodies), None):
            raise InputError(f"program {twice} is defined in two files", file=SOURCE.file)
        files[name] = set(own)
        bodies |= own
    for names in files.values():  # local subprograms are known only in their file
        for statement in (each for name in names for each in bodies[name] if each.word == "call"):
            if statement.parts[0] not in names | set(files):
                raise statement.error(f"{statement.parts[0]} is not a program that can be called here")
    for statement in inlined(bodies, title, "program", 2 if further else 1):
        run.take(statement)
    return run.source(title, frames, forward)


def _posture(parts: tuple[str, ...], statement: Statement) -> list[float]:
    """Twelve axes [rad] from six numbers and the text of external axes; NaN where unused."""
    external = [item.split(" ") for item in parts[6].split(",")[1:]]
    if [name for name, _ in external] != [f"E{i}" for i in range(1, len(external) + 1)]:
        raise statement.error("external axes must be in order, each once")
    degrees = [float(value) for value in parts[:6]] + [float(value) for _, value in external]
    return [*np.radians(degrees).tolist(), *[float("nan")] * (12 - len(degrees))]


def _pose(parts: tuple[str, ...]) -> Array:
    values = [float(value) for value in parts[:6]]
    return np.concatenate([np.array(values[:3]) * 1e-3, quaternions(np.radians([values[3:]]))[0]])


def _data(text: str) -> tuple[str, dict[str, Array], list[float]]:
    """Name, frames and start posture in a data list."""
    title, frames, start, closed = "", {}, [], False
    for statement in DATA.statements(text.split("\n")):
        word, parts = statement.word, statement.parts
        if word != "attribute" and (closed or (word == "define") == bool(title)):
            raise statement.misplaced("outside the data list, or twice")
        if word == "define":
            title = parts[0]
        elif word == "frame":
            frames[parts[0]] = _pose(parts[1:])
        elif word == "start":
            start = _posture(parts, statement)
        closed = closed or word == "end"
    if not closed or len(frames) != 2 or not start:
        raise InputError("no complete data list with FTOOL, FPART and XSTART", file=DATA.file)
    return title, frames, start


def _subprogram_bodies(text: str, title: str) -> dict[str, list[Statement]]:
    """Statements of each program of a source file, the first of which must be the one that its data list belongs to."""
    incomplete = f"no complete program {title}, to which the data list belongs"
    bodies = SOURCE.bodies(text, incomplete)
    if next(iter(bodies)) != title:
        raise InputError(incomplete, file=SOURCE.file)
    return bodies


class _KrlRun:
    """What the statements of a program do, one after the other."""

    def __init__(self, start: list[float]) -> None:
        self.start = start
        self.points: list[list[float]] = []  # twelve axes of each move; NaN for a line's first six
        self.lines: list[tuple[str, ...]] = []
        self.vias: list[list[float]] = []  # of each move X to C [mm, deg] and six axes [rad]; NaN where it is no arc
        self.linear: list[bool] = []
        self.fly: list[bool] = []
        self.paces: list[tuple[float, float, int]] = []  # speed, radius, percent
        self.triggers: dict[int, tuple[Trigger, ...]] = {}
        self.waiting: tuple[Trigger, ...] = ()
        self.waits: dict[int, float] = {}
        self.off: list[tuple[int, Statement]] = []  # moves after which an output is set, and the statement
        self.settings: dict[str, str] = {}
        self.bound: list[Statement] = []  # of a bounded setting: from IF until ENDIF
        self.speed, self.radius, self.share = np.nan, np.nan, 100

    def take(self, statement: Statement) -> None:
        word, parts = statement.word, statement.parts
        at = len(self.points) - 1
        if word in ("start", "line", "arc", "point", "wait", "trigger") and (word == "start") == (at >= 0):
            raise statement.error("the program must begin with PTP XSTART, and go there once")
        first = parts[0] if parts else ""
        if self.bound or word in ("bound", "else", "bounded"):
            self._bounded(statement)
        elif word == "speed":
            self.speed = float(first)
        elif word == "radius":
            self.radius = float(first) * 1e-3
        elif word == "share":
            self.share = int(first)
        elif word == "setting":
            self.settings[first] = parts[1]
        elif word == "wait":
            self.waits[at] = self.waits.get(at, 0.0) + float(first)
        elif word == "output":
            self.off.append((at, statement))
        elif word == "trigger":
            self.waiting += (Trigger(0.0, first == "DISTANCE", parts[2] == "TRUE", parts[1]),)
        elif word in ("line", "arc"):
            via, parts = (parts[:7], parts[7:]) if word == "arc" else ((*["nan"] * 6, ""), parts)
            if not (self.speed > 0.0 and (self.radius > 0.0 or not parts[9])):
                raise statement.error("a line without a speed, or approximated without a distance")
            external = _posture((*["0"] * 6, parts[8]), statement)[6:]
            beside = _posture((*["0"] * 6, via[6]), statement)[6:]
            self.vias.append([*map(float, via[:6]), *beside])
            self._move(parts, [np.nan] * 6 + external, bool(parts[9]))
        elif word in ("start", "point"):
            if self.waiting:
                raise statement.error("a trigger without a line after it")
            self.vias.append([np.nan] * 12)
            self._move((), _posture(parts, statement) if parts else self.start, bool(parts) and bool(parts[7]))

    def _bounded(self, statement: Statement) -> None:
        """Next line of a setting bounded by the machine's value: IF, the machine's, ELSE, the program's, ENDIF."""
        self.bound.append(statement)
        if statement.word != "bounded":
            return
        if [each.word for each in self.bound] != ["bound", "setting", "else", "setting", "bounded"]:
            raise statement.error("no setting bounded by the machine's own between IF and ENDIF")
        (greatest, value), its, _, own, _ = (each.parts for each in self.bound)
        key = own[0]
        if (its, own) != ((key, greatest), (key, value)) or GREATEST.get(key) != greatest:
            raise statement.error(f"{key} is not bounded by the machine's own")
        self.settings[key] = value
        self.bound = []

    def _move(self, pose: tuple[str, ...], axes: list[float], fly: bool) -> None:
        if self.waiting:
            self.triggers[len(self.points)] = self.waiting
            self.waiting = ()
        self.lines.append(pose)
        self.points.append(axes)
        self.linear.append(bool(pose))
        self.fly.append(fly)
        self.paces.append((self.speed if pose else np.nan, self.radius if pose else np.nan, self.share))

    def source(self, title: str, frames: dict[str, Array], forward: Forward) -> KrlProgram:
        if not any(self.linear) or self.waiting or self.bound:
            raise InputError("no lines, a trigger without one, or an IF without its end", file=SOURCE.file)
        m = len(self.points)
        for at, statement in self.off:
            if at not in (-1, m - 1):
                raise statement.error("an output is switched beside the path")
        linear, stops = np.array(self.linear), ~np.array(self.fly)
        axes, paces, vias = np.array(self.points), np.array(self.paces), np.array(self.vias)
        middle = np.column_stack([quaternions(np.radians(vias[:, 3:6])), vias[:, 6:]])
        pose, conf, turn = (
            np.empty((m, 7)),
            np.full((m, 4), UNSPECIFIED, dtype=np.intp),
            np.full(m, UNSPECIFIED, dtype=np.intp),
        )
        rows = np.array([[float(value) for value in parts[:8]] for parts in self.lines if parts])
        pose[linear] = np.column_stack([rows[:, :3] * 1e-3, quaternions(np.radians(rows[:, 3:6]))])
        conf[linear, 3], turn[linear] = branch_of(rows[:, 6].astype(np.intp)), rows[:, 7]
        T = forward(axes[~linear])
        pose[~linear] = np.column_stack([T[:, :3, 3], from_matrix(T[:, :3, :3])])
        base = COUPLED.fullmatch(self.settings.get("$BASE", ""))
        if (base is None and self.settings.get("$BASE") != "FPART") or self.settings.get("$TOOL") != "FTOOL":
            raise InputError("$BASE and $TOOL are not set to FPART and FTOOL", file=SOURCE.file)
        still = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
        program = RobotProgram(
            module=title,
            tool=frames["FTOOL"],
            uframe=frames["FPART"] if base is None else still,
            oframe=still if base is None else frames["FPART"],
            station="" if base is None else base[1],
            start=np.array(self.start),
            linear=linear,
            fine=stops,
            position=pose[:, :3],
            quat=pose[:, 3:],
            conf=conf,
            external=axes[:, 6:],
            zone=np.where(stops, 0.0, paces[:, 1]),
            speed=np.column_stack([paces[:, 0], np.full((m, 3), np.nan)]),
            wait=np.array([self.waits.get(i, 0.0) for i in range(m)]),
            triggers=self.triggers,
            arcs=None if np.isnan(vias[:, 0]).all() else 1e-3 * vias[:, :3],
        )
        off = tuple(frozenset(each.parts[0] for at, each in self.off if at == k) for k in (-1, m - 1))
        return KrlProgram(program, axes[:, :6], turn, middle, paces[:, 2].astype(np.intp), self.settings, off)


# ----------------------------------------------------------------------------------------------------
# Check of a program that was read against the plan.

ROUNDING = np.radians(1.01e-4)  # of axes


def program(plan: Plan, files: Mapping[str, str]) -> RobotProgram:
    """The program of both files, with the plan's postures at its targets. InputError for an unknown line."""
    return filled(plan, moves_with_arcs(plan), _read(plan, files)[1])


def differences(plan: Plan, files: Mapping[str, str]) -> list[str]:
    """Differences of the files from the plan beyond rounding and thinning, in words. InputError for an unknown line."""
    source, motion = _read(plan, files)
    moves = moves_with_arcs(plan)
    return [
        *played_differences(plan, moves, motion, stepped_speeds(moves, LEAST_SPEED)),
        *blend_differences(plan, motion),
        *_moves(plan, moves, source),
    ]


def _read(plan: Plan, files: Mapping[str, str]) -> tuple[KrlProgram, RobotProgram]:
    """Both files as read, and their program in the cell's own joints."""
    name, cell = krl_name(plan.name), plan.cell
    free = [k for k, axis in enumerate(external_axes(cell)) if axis.held is None]

    def forward(axes: Array) -> Array:
        beside = external_read(cell, axes[:, 6:])[:, free]
        q = [beside[:, : cell.rails], from_kuka(axes[:, :6]), beside[:, cell.rails :]]
        return cell.T_part_nozzle(np.column_stack(q))

    further = {file[:-4]: text for file, text in files.items() if file.endswith(".src") and file != f"{name}.src"}
    source = read_krl(files[f"{name}.src"], files[f"{name}.dat"], forward, further)
    written = named(source.program, output_numbers(plan.problem))
    start = written.start.copy()
    start[:6] = from_kuka(start[None, :6])[0]
    return source, replace(written, start=start, joints=from_kuka(source.axes))


def _moves(plan: Plan, moves: Moves, source: KrlProgram) -> list[str]:
    """Postures, Turn, speeds of axes and settings, each compared with those of the plan's moves."""
    linear, circular = (np.concatenate([[False], kind]) for kind in (moves.linear, moves.circular))
    if not (np.array_equal(linear, source.program.linear) and np.array_equal(circular, source.program.circular)):
        return ["moves are not of the planned kinds"]
    q, found = moves.q[:, plan.cell.own], []
    off = np.abs(source.axes - to_kuka(q))[~linear].max()
    if off > ROUNDING:
        found.append(f"axes differ by {off:.3g} rad")
    wrong = np.count_nonzero(source.turn[linear] != turn(q[linear]))
    if wrong:
        found.append(f"Turn differs at {wrong} targets")
    said, beside = source.middle[circular], np.radians(external_written(plan.cell, moves.via.station[moves.circular]))
    wrong = np.count_nonzero(~(angle(said[:, :4], moves.via.quat[moves.circular]) <= ROUNDED_TURN))
    if wrong:
        found.append(f"orientations differ at {wrong} via points of arcs")
    k = 4 + beside.shape[1]
    if not (np.abs(said[:, 4:k] - beside).max(initial=0.0) <= ROUNDING and np.isnan(said[:, k:]).all()):
        found.append("external axes at via points of arcs are not the planned ones")
    shares = np.array(percent(plan, moves))
    if not np.array_equal(source.share[~linear], np.concatenate([shares[:1], shares[~moves.linear]])):
        found.append("speeds of axes are not the planned ones")
    lines = stepped_speeds(moves, LEAST_SPEED)[moves.linear]
    if np.abs(source.program.speed[linear, 0] - lines).max() > 0.5 * LEAST_SPEED:
        found.append("speeds of lines are not the planned ones")
    if not np.array_equal(source.program.fine[1:], radii_of(plan, moves) == 0.0):
        found.append("it stops elsewhere than planned")
    expected = settings(plan, moves)
    found += [f"{key} is not {value}" for key, value in expected.items() if source.settings.get(key) != value]
    found += [f"{key} is set as well" for key in source.settings if key not in expected]
    return [*found, *off_differences(plan, source.off)]
