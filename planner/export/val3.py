"""VAL3 for Stäubli's controllers (CS8, CS9; version s7 and later): writer, reader, and check against the plan."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from planner.base.arrays import Array
from planner.base.errors import InputError
from planner.export.arms import (
    ArmProgram,
    Convention,
    ProgramStep,
    ProgramSteps,
    arm_differences,
    arm_program,
    forward_of,
    percent,
    read_arm,
    signed,
)
from planner.export.euler import from_turning_xyz, read_pose, turning_xyz, written
from planner.export.fit import to_matrix
from planner.export.grammar import NUMBER, Grammar, Statement, inlined
from planner.export.moves import Moves, MoveSection, move_radii, moves_with_arcs, sections
from planner.export.parts import in_files
from planner.export.program import RobotProgram, about
from planner.export.rapid.text import module_name
from planner.export.speeds import stepped_speeds
from planner.export.support import by_bead, output_numbers, outputs_about
from planner.export.text import ascii_comment, number, resting

if TYPE_CHECKING:
    from planner.plan import Plan

# ----------------------------------------------------------------------------------------------------
# Stäubli's axes and frames (ROS-Industrial, staubli: URDF files): the axes have the same sense as ours, but the arm is
# straight up at zero. The world's origin is level with axis 2. Rotations are turns about x, the new y and the new z.

STAUBLI = Convention(
    axes=signed(1.0, 1.0, 1.0, 1.0, 1.0, 1.0), offset=np.array([0.0, 0.0, 0.5 * np.pi, 0.0, 0.0, 0.0]), shoulder=True
)

# ----------------------------------------------------------------------------------------------------
# Writer: an application, which is a folder with a project, data, and programs.
#
# Programs queue moves and run ahead of the arm, so a separate task switches the outputs: it waits until the
# controller's current move number exceeds that of the move to the switching point, which was stored when that move was
# queued. Lines keep the posture of the joint move before them (ssame, esame, wsame). An mdesc holds the speed and blend
# of a move; moves with equal ones share it.

LONGEST_NAME = 15  # in VAL3 before s7; later versions accept more
MOST_ELEMENTS = 9999  # of an array
MOST_MOVES = 2000  # of a program and its arrays
MOST_SWITCHES = 9000  # of a table; there are as many tables as needed
MARK = "//"
WAIT = "waitEndMove()\ndelay({:.3f})"
MM, DEGREES = 3, 4  # decimals
SPEED = 2  # decimals of mm/s
# radii of blends [mm]: a dozen per decade, so that few descriptors are needed
LEVELS = np.round(
    np.outer(10.0 ** np.arange(-3, 3), (1, 1.2, 1.5, 1.8, 2.2, 2.7, 3.3, 3.9, 4.7, 5.6, 6.8, 8.2)).ravel(), 3
)
UNBOUND = 99999  # mm/s or deg/s: no limit, as another one applies
OUTPUT = "BasicIO-1\\%Q{}"  # what an output is linked to
XML = '<?xml version="1.0" encoding="utf-8"?>'
ABOUT = "<!-- beadwise: {} -->"  # names the kind of file
SPACE = "http://www.staubli.com/robotics/VAL3"
XSI = 'xmlns:xsi="http://www.w3.org/2001/XMLSchema-instance"'
TASK = ("start", "stop", "extruder")  # programs of every application; others are part1, part2 …
BEGIN_TASK, END_TASK = '  taskCreate "extruder",10,extruder()', '  taskKill("extruder")'


@dataclass(frozen=True)
class MoveDescriptors:
    """Movement descriptors: the number of each move's (m), and the attributes of each in the data file."""

    of_move: list[int]
    values: list[str]


def val3_name(name: str) -> str:
    """Name of the application, and of its folder."""
    return module_name(name, LONGEST_NAME)


def write(plan: Plan) -> dict[str, str]:
    """Files of a verified plan (ASCII, mm, degrees)."""
    name, moves = val3_name(plan.name), moves_with_arcs(plan)
    own = in_files(sections(plan, moves), MOST_MOVES)
    descriptors, switches = _descriptors(plan, moves), _Switches(plan, moves)
    tables = len(switches.tables)
    parts = {f"part{k}": _part(moves, k, group, descriptors, switches) for k, group in enumerate(own, 1)}
    off = [f"  dOut[{k}]=false" for k in range(len(output_numbers(plan.problem)))]
    start = [
        *_header(plan),
        *_forgotten(tables),
        *off,
        BEGIN_TASK,
        *_move(switches.after.get(-1, []), "movej(jStart[0],tNozzle,mPace[0])"),
        *_lines(resting(moves.waits.get(-1, ()), MARK, WAIT, 0)),
        *(f"  call {part}()" for part in parts),
        "  waitEndMove()",
        END_TASK,
        *off,
    ]
    programs = {"start": start, **_fixed(plan, tables), **parts}
    return {
        f"{name}.pjx": _project(name, programs),
        f"{name}.dtx": _data(plan, moves, own, descriptors, switches),
        **{f"{each}.pgx": _program(each, lines) for each, lines in programs.items()},
    }


def planned_speeds(moves: Moves) -> Array:
    """Speed (m) [m/s] written for each line."""
    return stepped_speeds(moves, 1e-3 * 10.0**-SPEED)


def planned_zones(plan: Plan, moves: Moves) -> Array:
    """Blend radius (m) [m] at the end of each move, the next smaller of LEVELS; 0 where it stops."""
    radii = move_radii(plan, moves)
    below = np.maximum(np.searchsorted(LEVELS, radii * 1e3 * (1.0 + 1e-9), side="right") - 1, 0)
    out: Array = np.where(radii > 0.0, LEVELS[below] * 1e-3, 0.0)
    return out


def _fixed(plan: Plan, tables: int) -> dict[str, list[str]]:
    """Programs that are the same for every print with as many outputs and switching tables."""
    off = [f"  dOut[{k}]=false" for k in range(len(output_numbers(plan.problem)))]
    return {"stop": [END_TASK, *off], "extruder": _switching(tables)}


def _switching(tables: int) -> list[str]:
    """Statements that carry out all switching, one table after the other."""
    lines: list[str] = []
    for k in range(1, tables + 1):
        lines += [
            f"  for nSwitch=0 to size(nAt{k})-1",
            f"    wait(nAt{k}[nSwitch]>=0)",
            f"    wait(getMoveId()>=nAt{k}[nSwitch]+1)",
            f"    dOut[nOut{k}[nSwitch]]=bOn{k}[nSwitch]",
            "  endFor",
        ]
    return lines


def _forgotten(tables: int) -> list[str]:
    """Statements that clear the move numbers stored by an earlier run."""
    lines: list[str] = []
    for k in range(1, tables + 1):
        lines += [f"  for nSwitch=0 to size(nAt{k})-1", f"    nAt{k}[nSwitch]=-1", "  endFor"]
    return lines


def _lines(texts: Iterable[str]) -> list[str]:
    return [f"  {line}" for text in texts for line in text.split("\n")]


def _header(plan: Plan) -> list[str]:
    texts = [
        *about(plan),
        *outputs_about(plan.problem),
        f"Outputs are linked to {OUTPUT.format('')}0 and on, in {val3_name(plan.name)}.dtx",
        f"j1 to j6, as Staubli counts: {', '.join(plan.cell.arm.names)}",
        "Payload: set it before the first run",
    ]
    return [ascii_comment(MARK, text, 2) for text in texts]


def _program(name: str, lines: Sequence[str]) -> str:
    code = [XML, ABOUT.format(f"program {name}"), f'<Programs {XSI} xmlns="{SPACE}/Program/2">']
    inner = [line.replace("]]>", "]] >") for line in lines]  # text in a comment must not end the section
    code += [f'  <Program name="{name}">', "    <Code><![CDATA[begin", *inner, "end]]></Code>", "  </Program>"]
    return "\n".join([*code, "</Programs>", ""])


def _project(name: str, programs: Iterable[str]) -> str:
    lines = [XML, ABOUT.format("project"), f'<Project xmlns="{SPACE}/Project/3">']
    lines += ['  <Parameters version="s7.3.1" stackSize="5000" millimeterUnit="true" />', "  <Programs>"]
    lines += [f'    <Program file="{each}.pgx" />' for each in programs]
    lines += ["  </Programs>", "  <Database>", f'    <Data file="{name}.dtx" />', "  </Database>", "  <Libraries />"]
    return "\n".join([*lines, "</Project>", ""])


def _array(name: str, kind: str, values: Sequence[str]) -> list[str]:
    cells = [f'      <Value key="{k}" {value} />' for k, value in enumerate(values)]
    head = f'    <Data name="{name}" access="private" xsi:type="array" type="{kind}" size="{len(values)}">'
    return [head, *cells, "    </Data>"]


def _frame(T: Array, father: str) -> str:
    values = [*(T[:3, 3] * 1e3), *written(turning_xyz(T[None, :3, :3])[0], DEGREES)]
    decimals = [MM] * 3 + [DEGREES] * 3
    names = ("x", "y", "z", "rx", "ry", "rz")
    said = " ".join(f'{n}="{number(v, d)}"' for n, v, d in zip(names, values, decimals, strict=True))
    return f'{said} fatherId="{father}[0]"'


def _joints(axes: Array) -> list[str]:
    form = " ".join(f'j{i}="%.{DEGREES}f"' for i in range(1, 7))
    return [form % tuple(row) for row in (np.round(np.degrees(axes), DEGREES) + 0.0).tolist()]


def _points(position: Array, quat: Array) -> list[str]:
    """Poses in the form that lines and arcs use."""
    r = written(turning_xyz(to_matrix(quat)), DEGREES)
    rows = np.column_stack([np.round(position * 1e3, MM) + 0.0, r])
    form = " ".join(f'{n}="%.{MM}f"' for n in "xyz") + " " + " ".join(f'r{n}="%.{DEGREES}f"' for n in "xyz")
    form += ' shoulder="ssame" elbow="esame" wrist="wsame" fatherId="fPart[0]"'
    return [form % tuple(row) for row in rows.tolist()]


def _data(
    plan: Plan, moves: Moves, own: list[list[MoveSection]], descriptors: MoveDescriptors, switches: _Switches
) -> str:
    cell = plan.cell
    joints = _joints(STAUBLI.counted(plan.trajectory.q[moves.sample][:, cell.own]))
    ends, vias = (
        _points(moves.targets.position[1:], moves.targets.quat[1:]),
        _points(moves.via.position, moves.via.quat),
    )
    points = [[via, end] if arc else [end] for arc, via, end in zip(moves.circular.tolist(), vias, ends, strict=True)]
    blocks = [
        _array("tNozzle", "tool", [_frame(STAUBLI.tool(cell), "flange")]),
        _array("fPart", "frame", [_frame(STAUBLI.part(cell), "world")]),
        _array("dOut", "dio", [f'link="{OUTPUT.format(k)}"' for k in output_numbers(plan.problem).values()]),
        _array("mPace", "mdesc", descriptors.values),
    ]
    for k, table in enumerate(switches.tables, 1):
        blocks.append(_array(f"nAt{k}", "num", ['value="-1"'] * len(table)))
        blocks.append(_array(f"nOut{k}", "num", [f'value="{output}"' for output, _ in table]))
        blocks.append(_array(f"bOn{k}", "bool", [f'value="{str(value).lower()}"' for _, value in table]))
    blocks.append(_array("nSwitch", "num", ['value="0"']))
    blocks.append(_array("jStart", "jointRx", _joints(STAUBLI.counted(plan.trajectory.q[:1, cell.own]))))
    for k, group in enumerate(own, 1):
        rows = [i for section in group for i in section.moves]
        blocks.append(_array(f"jPath{k}", "jointRx", [joints[i] for i in rows if not moves.linear[i]] or joints[:1]))
        blocks.append(
            _array(f"pPath{k}", "pointRx", [each for i in rows if moves.linear[i] for each in points[i]] or ends[:1])
        )
    lines = [XML, ABOUT.format("data"), f'<Database {XSI} xmlns="{SPACE}/Data/2">', "  <Datas>"]
    lines += [line for block in blocks for line in block]
    return "\n".join([*lines, "  </Datas>", "</Database>", ""])


def _descriptors(plan: Plan, moves: Moves) -> MoveDescriptors:
    blends = planned_zones(plan, moves) * 1e3
    numbers: dict[str, int] = {_pace(percent(plan, moves)[0], UNBOUND, "off", 0.0): 0}  # to the start
    found = []
    for linear, speed, share, blend in zip(
        moves.linear.tolist(),
        (planned_speeds(moves) * 1e3).tolist(),
        percent(plan, moves),
        blends.tolist(),
        strict=True,
    ):
        kind = "off" if blend == 0.0 else "Cartesian" if linear else "Joint"
        said = _pace(100, speed, kind, blend) if linear else _pace(share, UNBOUND, kind, blend)
        found.append(numbers.setdefault(said, len(numbers)))
    return MoveDescriptors(found, list(numbers))


def _pace(vel: int, tmax: float, blend: str, radius: float) -> str:
    return (
        f'accel="100" vel="{vel}" decel="100" tmax="{tmax:.{SPEED}f}" rmax="{UNBOUND}" '
        f'blend="{blend}" leave="{radius:.{MM}f}" reach="{radius:.{MM}f}"'
    )


class _Switches:
    """What is switched when: (index of our output, value) in order, and the rows that follow each move."""

    def __init__(self, plan: Plan, moves: Moves) -> None:
        bead = plan.trajectory.bead
        of_bead = by_bead(plan, list(range(len(output_numbers(plan.problem)))))
        self.table: list[tuple[int, bool]] = []
        self.after: dict[int, list[int]] = {}  # move, or -1 for the move to the start → rows of the table
        for i in range(len(moves)):
            begins, ends = (of_bead[bead[at]] for at in (moves.sample[i - 1] if i else 0, moves.sample[i]))
            for flag, at, row in (
                (moves.on_start[i], i - 1, (begins, True)),
                (moves.on_end[i], i, (ends, True)),
                (moves.off_end[i], i, (ends, False)),
            ):
                if flag:
                    self.after.setdefault(at, []).append(len(self.table))
                    self.table.append(row)

    @property
    def tables(self) -> list[list[tuple[int, bool]]]:
        """The table in pieces that fit into arrays; at least one."""
        return [self.table[k : k + MOST_SWITCHES] for k in range(0, max(1, len(self.table)), MOST_SWITCHES)]


def _part(moves: Moves, k: int, own: list[MoveSection], descriptors: MoveDescriptors, switches: _Switches) -> list[str]:
    """Statements of the k-th program."""
    lines: list[str] = []
    counts = {True: 0, False: 0}
    for section in own:
        lines += [ascii_comment(MARK, section.about, 2)] if section.about else []
        for i in section.moves:
            linear = bool(moves.linear[i])
            taken = 2 if moves.circular[i] else 1
            keys = range(counts[linear], counts[linear] + taken)
            counts[linear] += taken
            target = ",".join(f"{'p' if linear else 'j'}Path{k}[{key}]" for key in keys)
            word = "c" if moves.circular[i] else "l" if linear else "j"
            move = f"move{word}({target},tNozzle,mPace[{descriptors.of_move[i]}])"
            lines += _move(switches.after.get(i, []), move)
            lines += _lines(resting(moves.waits.get(i, ()), MARK, WAIT, 0))
    return lines


def _move(rows: Sequence[int], move: str) -> list[str]:
    """Statements of a move, whose number is stored for the switching (rows of the table) that waits for it."""
    cells = [f"nAt{1 + row // MOST_SWITCHES}[{row % MOST_SWITCHES}]" for row in rows]
    gives = f"{cells[0]}=" if cells else ""
    return [f"  {gives}{move}", *(f"  {cell}={cells[0]}" for cell in cells[1:])]


# ----------------------------------------------------------------------------------------------------
# Reader: exactly the subset that the writer uses.

NAME = r"[A-Za-z][A-Za-z0-9_]{0,31}"
POSE = " ".join(rf'{n}="({NUMBER})"' for n in ("x", "y", "z", "rx", "ry", "rz"))
KEY = '<Value key="([0-9]{1,5})" '
DATA = Grammar.of(
    "VAL3 data",
    "<!--",
    {
        "array": rf'<Data name="({NAME})" access="private" xsi:type="array" type="([A-Za-z]+)" size="([0-9]{{1,5}})">',
        "jointRx": KEY + " ".join(rf'j{i}="({NUMBER})"' for i in range(1, 7)) + " />",
        "pointRx": rf'{KEY}{POSE} shoulder="ssame" elbow="esame" wrist="wsame" fatherId="fPart\[0\]" />',
        "tool": rf'{KEY}{POSE} fatherId="flange\[0\]" />',
        "frame": rf'{KEY}{POSE} fatherId="world\[0\]" />',
        "mdesc": rf'{KEY}accel="100" vel="([0-9]{{1,3}})" decel="100" tmax="({NUMBER})" rmax="{UNBOUND}" '
        rf'blend="(off|Joint|Cartesian)" leave="({NUMBER})" reach="\5" />',
        "num": rf'{KEY}value="(-?[0-9]{{1,6}})" />',
        "bool": rf'{KEY}value="(true|false)" />',
        "dio": rf'{KEY}link="BasicIO-1\\%Q([0-9]{{1,2}})" />',
        "end": r"</Data>",
    },
)
CELL = r"nAt([0-9]{1,2})\[([0-9]{1,4})\]"
MOVE = r"(Start|Path[0-9]{1,4})\[([0-9]{1,5})\],tNozzle,mPace\[([0-9]{1,6})\]\)"
CODE = Grammar.of(
    "VAL3",
    MARK,
    {
        "arc": rf"(?:{CELL}=)?movec\(p(Path[0-9]{{1,4}})\[([0-9]{{1,5}})\],p" + MOVE,
        "line": rf"(?:{CELL}=)?movel\(p" + MOVE,
        "point": rf"(?:{CELL}=)?movej\(j" + MOVE,
        "also": f"{CELL}={CELL}",
        "rest": r"waitEndMove\(\)",
        "wait": rf"delay\(({NUMBER})\)",
        "output": r"dOut\[([0-9]{1,2})\]=false",
        "call": rf"call ({NAME})\(\)",
        "task": r'taskCreate "extruder",10,extruder\(\)',
        "killed": r'taskKill\("extruder"\)',
    },
)
Arrays = dict[str, list[tuple[str, ...]]]
_pose = partial(read_pose, of_angles=from_turning_xyz)


def read_val3(files: Mapping[str, str], name: str, plan: Plan) -> ArmProgram:
    """Program from the texts of an application's files, by name.

    Raises InputError, with the line, for anything unknown or misplaced, and for an incomplete application.
    """
    programs = [file.removesuffix(".pgx") for file in files if file.endswith(".pgx")]
    if files.get(f"{name}.pjx") != _project(name, programs) or not set(TASK) <= set(programs):
        raise InputError(f"no complete application {name} with its project and programs", file=CODE.file)
    arrays = _arrays(files[f"{name}.dtx"])
    tables = _table_count(arrays)
    for fixed, lines in _fixed(plan, tables).items():
        if files[f"{fixed}.pgx"] != _program(fixed, lines):
            raise InputError(f"{fixed}.pgx is not the program of this application", file=CODE.file)
    bodies = {each: list(_code(files[f"{each}.pgx"], each, tables)) for each in programs if each not in TASK[1:]}
    outputs = [value for (value,) in arrays["dOut"]]
    given: dict[tuple[int, int], int] = {}  # (switching table, row) → the move that it follows
    steps, tasks, before = ProgramSteps(), [], ""
    for statement in inlined(bodies, "start", "program"):
        word, parts = statement.word, statement.parts
        if word in ("wait", "killed") and before != "rest":
            raise statement.misplaced("before the arm has come to rest")
        before = word
        if word in ("line", "arc", "point"):
            steps.moves.append(_step(statement, arrays))
            if parts[0]:
                given[int(parts[0]), int(parts[1])] = len(steps.moves) - 1
        elif word == "also":
            given[int(parts[0]), int(parts[1])] = given.get((int(parts[2]), int(parts[3])), -1)
        elif word == "wait":
            steps.wait(float(parts[0]))
        elif word == "output":
            steps.switch(outputs[_at(statement, parts[0], outputs)], False)
        elif word in ("task", "killed"):
            tasks.append((word, bool(steps.moves)))
    if tasks != [("task", False), ("killed", True)]:
        raise InputError(
            "the task that switches outputs does not run from before the first move to the end", file=CODE.file
        )
    if list(given) != [(k, row) for k in range(1, tables + 1) for row in range(len(arrays[f"nAt{k}"]))]:
        raise InputError("moves refer to other switches than the tables have, or in another order", file=CODE.file)
    for (k, row), at in given.items():
        (output,), (value,) = arrays[f"nOut{k}"][row], arrays[f"bOn{k}"][row]
        if not int(output) < len(outputs):
            raise InputError(f"there is no output {output}", file=DATA.file)
        steps.switched.append((at, outputs[int(output)], value == "true"))
    (tool,), (part,) = arrays["tNozzle"], arrays["fPart"]
    return read_arm(name, steps, _pose(tool), _pose(part), forward_of(plan.cell, STAUBLI), CODE.file)


def _step(statement: Statement, arrays: Arrays) -> ProgramStep:
    path, key, pace = statement.parts[-3:]
    linear = statement.word != "point"
    values = arrays.get(f"{'p' if linear else 'j'}{path}", [])
    target, via = values[_at(statement, key, values)], None
    if statement.word == "arc":
        there = arrays.get(f"p{statement.parts[-5]}", [])
        via = _pose(there[_at(statement, statement.parts[-4], there)])
    vel, tmax, blend, radius = arrays["mPace"][_at(statement, pace, arrays["mPace"])]
    fine = blend == "off"
    if not fine and (blend == "Cartesian") != linear:
        raise statement.error(f"{blend} is not a blend for this move")
    if (vel != "100") if linear else (float(tmax) != UNBOUND):
        raise statement.error("only the tip's speed may limit a line, and only the joints' speed a joint move")
    numbers = np.array([float(value) for value in target])
    if not linear:
        return ProgramStep(False, fine, np.radians(numbers), float(vel), 1e-3 * float(radius))
    return ProgramStep(True, fine, _pose(target), 1e-3 * float(tmax), 1e-3 * float(radius), via=via)


def _at(statement: Statement, key: str, values: Sequence[object]) -> int:
    if not int(key) < len(values):
        raise statement.error(f"there is no element {key}")
    return int(key)


def _code(text: str, name: str, tables: int) -> Iterator[Statement]:
    """Statements of a program's file, without the loops that clear what an earlier run has stored."""
    lines = text.split("\n")
    head, tail = _program(name, []).split("begin\n")
    if not (text.startswith(f"{head}begin\n") and text.endswith(f"\n{tail}")):
        raise InputError(f"no complete program {name}", file=f"{name}.pgx")
    first, last = head.count("\n") + 1, len(lines) - tail.count("\n") - 1
    inner = lines[first:last]
    if name == "start":
        loops = _forgotten(tables)
        begin = next((k for k in range(len(inner)) if inner[k : k + len(loops)] == loops), None)
        if begin is None:
            raise InputError("switches of an earlier run are not cleared", file=f"{name}.pgx")
        inner[begin : begin + len(loops)] = [f"  {MARK}"] * len(loops)
    return CODE.statements(inner, first + 1, f"{name}.pgx")


def _table_count(arrays: Arrays) -> int:
    """Number of switching tables, at least one."""
    return max(1, sum(re.fullmatch(r"nAt[0-9]{1,2}", name) is not None for name in arrays))


def _arrays(text: str) -> Arrays:
    """The data arrays, by name."""
    head, tail = (
        f'{XML}\n{ABOUT.format("data")}\n<Database {XSI} xmlns="{SPACE}/Data/2">\n  <Datas>\n',
        "  </Datas>\n</Database>\n",
    )
    if not (text.startswith(head) and text.endswith(tail)):
        raise InputError("no complete data file", file=DATA.file)
    found: Arrays = {}
    name, kind, size = "", "", 0
    for statement in DATA.statements(text[len(head) : -len(tail)].split("\n"), head.count("\n") + 1):
        word, parts = statement.word, statement.parts
        if word == "array":
            if name or parts[0] in found:
                raise statement.misplaced("within another one, or twice")
            name, kind, size = parts[0], parts[1], int(parts[2])
            if size > MOST_ELEMENTS:
                raise statement.error(f"{name} has more than {MOST_ELEMENTS} elements, the most that an array may have")
            found[name] = []
        elif word == "end":
            if not name or len(found[name]) != size:
                raise statement.error(f"{name} does not have the size that it states")
            name = ""
        elif word != kind or not name or int(parts[0]) != len(found[name]):
            raise statement.misplaced("in an array of another kind, or out of order")
        else:
            found[name].append(parts[1:])
    tables = [[f"{column}{k}" for column in ("nAt", "nOut", "bOn")] for k in range(1, _table_count(found) + 1)]
    needed = {"tNozzle", "fPart", "dOut", "mPace", "nSwitch", "jStart", *(each for table in tables for each in table)}
    if name or not needed <= set(found) or any(len({len(found[each]) for each in table}) > 1 for table in tables):
        raise InputError(
            f"data are missing: {', '.join(sorted(needed - set(found))) or 'of the switches'}", file=DATA.file
        )
    return found


# ----------------------------------------------------------------------------------------------------
# Check of a program that was read against the plan.


def program(plan: Plan, files: Mapping[str, str]) -> RobotProgram:
    """The program in the files, with whatever they leave open taken from the plan. InputError for an unknown line."""
    read = read_val3(files, val3_name(plan.name), plan)
    return arm_program(plan, moves_with_arcs(plan), read, STAUBLI, np.radians(0.51 * 10.0**-DEGREES))


def differences(plan: Plan, files: Mapping[str, str]) -> list[str]:
    """Differences of the files from the plan beyond rounding and thinning, in words. InputError for an unknown line."""
    read = read_val3(files, val3_name(plan.name), plan)
    moves = moves_with_arcs(plan)
    rounding, speeds = np.radians(0.51 * 10.0**-DEGREES), planned_speeds(moves)
    return arm_differences(plan, moves, read, STAUBLI, rounding, speeds, zones=planned_zones(plan, moves))
