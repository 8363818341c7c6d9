"""G-code for machines with five or six axes: writer, reader, and check against the plan."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from planner.base.arrays import Array, Indices
from planner.base.errors import InputError
from planner.base.gcode_lines import PAUSE, commands_in, time_of
from planner.export.arcs import LinesAndArcs, segments
from planner.export.axes.arcs import centre_and_swept, via_point, with_arcs
from planner.export.axes.flavours import FLAVOURS, Flavour, arcs_said, feed_length
from planner.export.axes.machine import FiveAxes, Followed, Machine, PoseMachine, above, follow, machine_of, spec_of
from planner.export.board import select
from planner.export.extruder import FILE, Order, order_differences, orders
from planner.export.fit import by_samples, continuous, lerp, thin
from planner.export.grammar import Grammar, Statement
from planner.export.moves import ANGLE_TOLERANCE, ON_TIME, ROUNDING, nearest_fraction
from planner.export.program import held_by, made_with, resumed, verified
from planner.export.speeds import TIME_TOLERANCE
from planner.export.support import STATION
from planner.export.text import ascii_comment, beyond, number
from planner.plan.plan import materials_of

if TYPE_CHECKING:
    from planner.plan import Plan
    from planner.problem.settings import MachineSpec

# ----------------------------------------------------------------------------------------------------
# The fewest targets between which evenly moving axes keep the tip on its path.

FILAMENT_TOLERANCE = 5e-6  # [m] of filament by which a line may be ahead or behind
STILL = 1e-7  # [m, rad] per sample; an axis that moves less stands still
BOARD = "reprap"  # firmware whose orders the flavours translate


def kept(plan: Plan, motion: Followed, due: Array) -> tuple[Indices, Array]:
    """Samples of the motion that become targets (m), including the first and the last; and via points of arcs.

    The via points (m, 3) are X Y Z [m] for the move that ends at each target, NaN if it is a line.

    due: times [s] at which orders to the board are placed between moves.
    """
    n = len(motion)
    must = np.zeros(n, dtype=bool)
    must[[0, n - 1]] = True
    edge = np.flatnonzero(np.diff(motion.laid.astype(np.int8)))
    must[edge] = must[edge + 1] = True
    bead = plan.trajectory.bead[motion.sample]
    must[1:] |= (np.diff(bead) != 0) & motion.laid[1:] & motion.laid[:-1]
    moved = np.column_stack([motion.tip, motion.straight, motion.angles, motion.station])
    still = (np.abs(np.diff(moved, axis=0)) < STILL).all(axis=1)
    change = np.flatnonzero(np.diff(still.astype(np.int8))) + 1
    must[change] = True
    must[np.minimum(np.searchsorted(motion.t, due - ON_TIME), n - 1)] = True
    for event in plan.trajectory.events:
        if event.amount:
            ends = np.array([event.start, event.start + event.duration]) - plan.trajectory.t[0]
            must[np.minimum(np.searchsorted(motion.t, ends - ON_TIME), n - 1)] = True
    targets = thin(np.flatnonzero(must), by_samples(_Misfit(plan, motion)))
    program = plan.problem.program
    if not (program.arcs and arcs_said(spec_of(plan))):
        return targets, np.full((len(targets), 3), np.nan)
    tolerance = (program.chord - ROUNDING, FILAMENT_TOLERANCE, TIME_TOLERANCE)
    return with_arcs(motion, targets, np.flatnonzero(must), tolerance)


class _Misfit:
    """How far even motion of all axes between two samples misses a third one, in tolerances."""

    def __init__(self, plan: Plan, motion: Followed) -> None:
        self._m = motion
        self._chord = plan.problem.program.chord - ROUNDING

    def __call__(self, a: Indices, b: Indices, k: Indices) -> Array:
        m = self._m
        share = (m.t[k] - m.t[a]) / (m.t[b] - m.t[a])
        u = nearest_fraction(m.tip[a], m.tip[b], m.tip[k], share)
        angles = lerp(m.angles, a, b, u)
        tip = m.machine.tip(lerp(m.straight, a, b, u), angles)
        worst = np.linalg.norm(tip - m.tip[k], axis=1) / self._chord
        worst = np.maximum(worst, m.machine.leaning(angles, m.quat[k]) / ANGLE_TOLERANCE)
        worst = np.maximum(worst, np.abs(lerp(m.feed, a, b, u) - m.feed[k]) / FILAMENT_TOLERANCE)
        late = np.where(m.laid[k], np.abs(share - u) * (m.t[b] - m.t[a]) / TIME_TOLERANCE, 0.0)
        worst = np.maximum(worst, late)
        for e in m.station.T:
            worst = np.maximum(worst, np.abs(lerp(e, a, b, u) - e[k]) / ANGLE_TOLERANCE)
        return worst


# ----------------------------------------------------------------------------------------------------
# Writer: every line moves all axes together, in the plan's time.

DECIMALS = 4  # of mm (0.1 um) and of degrees
FILAMENT_DECIMALS = 5  # of mm
LEAST_PAUSE = 1e-3  # [s]
SHORTEST = 1e-5  # [s] of a move: near a direction that leaves an axis free, that axis may turn any angle in no time
FAST = 60.0  # [s] per minute
LONGEST_COMMENT = 150


def file_name(plan: Plan) -> str:
    """Name of the file, different from the extruder's."""
    name = f"{plan.name}.{FLAVOURS[spec_of(plan).flavour].suffix}"
    return f"print_{name}" if name.lower() == FILE else name


def axes_gcode(plan: Plan) -> str:
    """The whole print for the machine in `program.machine`; InputError if it cannot perform the motion."""
    spec = spec_of(plan)
    flavour = FLAVOURS[spec.flavour]
    motion = follow(plan)
    waiting = orders(plan, BOARD)
    at, via = kept(plan, motion, np.array([order.start for order in waiting]))
    lines = [*_header(plan, motion, len(at)), *_start_lines(plan, spec, flavour, motion)]
    lines += _lines(plan, motion, at, via, list(waiting))
    lines += ["G94"] if spec.feed == "inverse_time" else []
    lines += [spec.tcp_off] if spec.tcp else []
    return "\n".join([*lines, *flavour.end]) + "\n"


def write(plan: Plan) -> dict[str, str]:
    """The program of a verified plan, by the name of its file."""
    return {file_name(plan): axes_gcode(plan)}


def letters_of(plan: Plan, motion: Followed) -> tuple[str, ...]:
    """Letters of all axes except the filament's, in the order in which they are written."""
    return ("X", "Y", "Z", *motion.machine.letters, *STATION[: motion.station.shape[1]])


def _header(plan: Plan, motion: Followed, targets: int) -> list[str]:
    spec, cell = spec_of(plan), plan.cell
    size = f"{len(plan.beads)} beads in {plan.layers} layers"
    texts = [
        f"{plan.name} for {spec.flavour}, {spec.type}, strategy {plan.strategy}",
        *made_with(plan),
        f"{size}, {targets} targets, {plan.trajectory.t[-1] - plan.trajectory.t[0]:.3f} s",
        *resumed(plan),
        "Verified for the robot before it was written:",
        *verified(plan),
    ]
    if isinstance(motion.machine, FiveAxes):
        reach = [
            f"{letter} {number(np.degrees(low), 1)} to {number(np.degrees(high), 1)} deg"
            for letter, low, high in zip(
                motion.machine.letters, motion.angles.min(axis=0), motion.angles.max(axis=0), strict=True
            )
        ]
        low, high = motion.straight.min(axis=0) * 1e3, motion.straight.max(axis=0) * 1e3
        reach += [f"{letter} {a:.1f} to {b:.1f}" for letter, a, b in zip("XYZ", low, high, strict=True)]
        what = "the tip in the part as it lies at zero angles" if spec.tcp else "on the machine"
        texts += [f"X Y Z are {what}. How far it goes:", f"  {', '.join(reach)}", _fastest(motion)]
        texts += ["The robot's clearances hold for its own head and ways: look at those of this machine."]
        purge = plan.problem.process.start.purge * 1e3
        if purge > 0.0:
            texts += [
                f"Note: {purge:g} mm of filament are purged where the machine waits at first, right above the first bead.",
                "  Robots do that at home: leave out process.start.purge_mm, and purge by hand or by a macro.",
            ]
    else:
        home = ", ".join(f"{v:.4f}" for v in np.degrees(plan.trajectory.q[0]))
        texts += [f"Joints at the start, from which the controller's iteration follows: {home} deg"]
        frame = "on the turning part" if len(cell.holder) else "in the part frame"
        texts += [f"X Y Z A B C are the nozzle's pose {frame}: A, B, C are roll, pitch and yaw, yaw last"]
        texts += held_by(cell)
    return [ascii_comment(";", text, longest=LONGEST_COMMENT) for text in texts]


def _fastest(motion: Followed) -> str:
    """How fast the axes must turn to keep the planned times, in words."""
    lasts = np.maximum(np.diff(motion.t), SHORTEST)
    rates = np.degrees((np.abs(np.diff(motion.angles, axis=0)) / lasts[:, None]).max(axis=0, initial=0.0))
    names = (f"{letter} up to {rate:.0f} deg/s" for letter, rate in zip(motion.machine.letters, rates, strict=True))
    return f"To keep the planned times: {', '.join(names)}; where it turns more slowly all of it slows down."


def _start_lines(plan: Plan, spec: MachineSpec, flavour: Flavour, motion: Followed) -> list[str]:
    """Modes, and the way to the first target; on machines other than the robot: up, across, and down."""
    lines = [*flavour.begin, *_selected(spec, first_tool(plan))]
    if spec.flavour == "linuxcnc":
        lines.append(f"G64 P{plan.problem.program.chord * 1e3:.4f}")
        lines.append(f"G92 {spec.filament}0")
    lines += [spec.tcp_on] if spec.tcp else []
    first = dict(zip(letters_of(plan, motion), _rows(motion, np.array([0]))[0].tolist(), strict=True))
    if isinstance(motion.machine, FiveAxes):
        # with tcp, Z is the tip's, to which the machine's limits do not apply
        most = np.inf if spec.tcp else float(motion.machine.greatest[2])
        high = min(float(motion.straight[:, 2].max()) + plan.problem.process.lift, most) * 1e3
        across = " ".join(f"{name}{number(value, DECIMALS)}" for name, value in first.items() if name != "Z")
        lines += [f"G0 Z{number(high, DECIMALS)}", f"G0 {across}", f"G0 Z{number(first['Z'], DECIMALS)}"]
    else:
        lines.append("G0 " + " ".join(f"{name}{number(value, DECIMALS)}" for name, value in first.items()))
    return [*lines, "G93" if spec.feed == "inverse_time" else "G94"]


def first_tool(plan: Plan) -> int | None:
    """The tool that a print of one material selects first of all; None if its materials have names."""
    return None if materials_of(plan.problem) else plan.problem.program.board.first_tool


def _selected(spec: MachineSpec, tool: int | None) -> list[str]:
    """The line that selects a tool before the first move, if filament cannot be pushed without one."""
    return [select(BOARD, tool)] if tool is not None and spec.flavour == "reprap" else []


def _rows(motion: Followed, at: NDArray[np.intp]) -> Array:
    """All axes except the filament's at samples, rounded as written [mm, deg]."""
    turning = np.degrees(np.column_stack([motion.angles[at], motion.station[at]]))
    return np.round(np.column_stack([motion.straight[at] * 1e3, turning]), DECIMALS) + 0.0


def _lines(plan: Plan, motion: Followed, at: NDArray[np.intp], via: Array, waiting: list[Order]) -> list[str]:
    """Moves and pauses to all targets, and the orders between them."""
    spec = spec_of(plan)
    flavour = FLAVOURS[spec.flavour]
    names, rows = letters_of(plan, motion), _rows(motion, at)
    fed = np.round(motion.feed[at] * 1e3, FILAMENT_DECIMALS)
    bead, layer, laid = (values[motion.sample] for values in (plan.trajectory.bead, plan.trajectory.layer, motion.laid))
    lines: list[str] = []
    now, last = 0.0, -1
    ends = motion.t[at].tolist()
    for i in range(1, len(at)):
        while waiting and waiting[0].start - ON_TIME <= ends[i - 1]:
            written, took = _order(flavour, waiting.pop(0))
            lines += written
            now += took
        a, b = rows[i - 1], rows[i]
        circular = not np.isnan(via[i, 0])
        if circular:
            b[2:] = a[2:]  # these rest; rounding might still differ
        own = int(bead[at[i]])
        if laid[at[i]] and own != last:
            lines.append(f"; bead {own}, layer {layer[at[i]]}")
            last = own
        filament = float(fed[i] - fed[i - 1])
        words = [f"{name}{number(v, DECIMALS)}" for name, u, v in zip(names, a, b, strict=True) if u != v]
        if filament:
            amount = filament if flavour.relative else float(fed[i])
            words.append(f"{spec.filament}{number(amount, FILAMENT_DECIMALS)}")
        lasts = ends[i] - now
        if not words:
            pause = round(lasts / LEAST_PAUSE) * LEAST_PAUSE
            if pause > 0.0:
                lines.append(flavour.pause.format(pause / flavour.unit))
                now += pause
            continue
        lasts = max(lasts, SHORTEST)
        moved = dict(zip(names, (b - a).tolist(), strict=True)) | {spec.filament: filament}
        length, code = feed_length(spec.flavour, moved), "G1"
        if circular:
            centre, swept = centre_and_swept(a, via[i] * 1e3, b)
            offset = np.round(centre - a[:2], DECIMALS) + 0.0
            length, code = float(np.hypot(*offset)) * abs(swept), "G3" if swept > 0.0 else "G2"
            words += [f"{letter}{number(v, DECIMALS)}" for letter, v in zip("IJ", offset.tolist(), strict=True)]
        feed = feed_word(FAST / lasts if spec.feed == "inverse_time" else FAST * length / lasts)
        rate = float(feed[1:])
        lines.append(f"{code} {' '.join(words)} {feed}")
        now += FAST / rate if spec.feed == "inverse_time" else FAST * length / rate
    for order in waiting:
        lines += _order(flavour, order)[0]
    return lines


def feed_word(rate: float) -> str:
    """F of a line, precise enough for it to end within 3 ms of its time, even if it lasts for minutes."""
    digits = 4 if rate >= 1.0 else 8
    return f"F{max(rate, 10.0**-digits):.{digits}f}"


def _order(flavour: Flavour, order: Order) -> tuple[list[str], float]:
    """Lines of an order for this controller, and how long its pauses take [s]; ValueError if it has no such line."""
    lines = [ascii_comment(";", order.words, longest=LONGEST_COMMENT)]
    for line in order.lines:
        if line.startswith(";"):
            continue
        for command in commands_in(line):
            if command.startswith(PAUSE):
                lines.append(flavour.pause.format(time_of([command]) / flavour.unit))
                continue
            own = flavour.order(command)
            if own is None:
                raise ValueError(f"{command} cannot be sent to this controller")
            lines.append(own)
    return lines, order.time


# ----------------------------------------------------------------------------------------------------
# Reader: exactly the subset that the writer uses.

MOST_CHARACTERS = 256  # of a line; LinuxCNC accepts no more
GRAMMAR = Grammar.of(
    "G-code",
    ";",
    {
        "move": r"G([0-3])((?: [A-Z]-?\d{1,9}\.\d{4,5})+(?: F\d\.\d{8})?)",
        "pause": r"G4 P(\d{1,8}(?:\.\d{3})?)",
        "order": r"M(?:42|104|106|107|109|116|140|190|280)(?: [A-Z]-?\d{1,6}(?:\.\d{1,4})?)*|T\d{1,2}(?: M6)?",
        "blend": r"G64 P\d\.\d{4}",
    },
    called="line",
)
_MODES = {"inverse_time": "G93", "per_minute": "G94"}


@dataclass(frozen=True)
class AxesProgram:
    """What a program does (m places, the first one where it begins; SI units, radians).

    straight, turning   (m, 3), (m, k + e) X Y Z, and all other axes but the filament's, in the order of the letters
    filament            (m)  pushed so far [m]
    time                (m)  since the first place [s]; where the machine pauses, a place occurs twice
    via                 (m, 3) X Y Z of the via point of the arc that ends at each place, NaN for lines
    highest             greatest Z on the way to the first place
    orders              (time, line) of everything other than motion
    """

    straight: Array
    turning: Array
    filament: Array
    time: Array
    via: Array
    highest: float
    orders: tuple[tuple[float, str], ...]


def read_axes(text: str, spec: MachineSpec, letters: Sequence[str], tool: int | None = 0) -> AxesProgram:
    """The program for a machine with these letters (X, Y, Z, then rotary axes). InputError for any unknown line.

    tool  selected before the first move, if the flavour requires one; None if orders do that
    """
    lines = text.splitlines()
    for n, line in enumerate(lines, 1):
        if len(line) > MOST_CHARACTERS:
            raise GRAMMAR.unknown(line, n)
    mode = _MODES[spec.feed]
    if mode not in lines:
        raise InputError(f"{mode} is missing", file=GRAMMAR.file)
    start = lines.index(mode)
    place, highest = _read_start(lines[:start], spec, letters, _selected(spec, tool))
    flavour = FLAVOURS[spec.flavour]
    end = [*(["G94"] if spec.feed == "inverse_time" else []), *([spec.tcp_off] if spec.tcp else []), *flavour.end]
    if lines[-len(end) :] != end:
        raise InputError(f"it does not end with {', '.join(end)}", file=GRAMMAR.file, line=len(lines))
    places, filament, time = [list(place.values())], [0.0], [0.0]
    ordered: list[tuple[float, str]] = []
    vias = [[np.nan] * 3]
    now, pushed = 0.0, 0.0
    for statement in GRAMMAR.statements(lines[start + 1 : -len(end)], start + 2):
        if statement.word == "order":
            ordered.append((now, statement.text))
            continue
        via = [np.nan] * 3
        if statement.word == "pause":
            now += float(statement.parts[0]) * flavour.unit
        else:
            words = _words(statement, "123")
            centre = [words.pop(letter, None) for letter in "IJ"] if statement.parts[0] != "1" else None
            rate = words.pop("F", 0.0)
            own = words.pop(spec.filament, None)
            if not rate > 0.0 or not words.keys() <= place.keys() or not (words or own is not None):
                raise GRAMMAR.unknown(statement.text, statement.line)
            moved = 0.0 if own is None else own if flavour.relative else own - pushed
            steps = {letter: value - place[letter] for letter, value in words.items()} | {spec.filament: moved}
            length = feed_length(spec.flavour, steps)
            if centre is not None:
                via, length = _arc(statement, place, words, centre)
            place |= words
            length = 1.0 if mode == "G93" else length
            now += 60.0 * length / rate
            pushed = pushed + moved
        places.append(list(place.values()))
        vias.append(via)
        filament.append(pushed)
        time.append(now)
    table = np.array(places)
    return AxesProgram(
        straight=table[:, :3] * 1e-3,
        turning=np.radians(table[:, 3:]),
        filament=np.array(filament) * 1e-3,
        time=np.array(time),
        via=np.array(vias) * 1e-3,
        highest=highest * 1e-3,
        orders=tuple(ordered),
    )


def _arc(
    statement: Statement, place: Mapping[str, float], words: Mapping[str, float], offset: Sequence[float | None]
) -> tuple[list[float], float]:
    """Via point of a G2 or G3 from a place, and the arc's length [mm].

    Raises InputError if anything but X and Y moves, or the centre is not equidistant from beginning and end.
    """
    i, j = offset
    if words.keys() <= {"X", "Y"} and i is not None and j is not None:
        begin, end = np.array([place["X"], place["Y"]]), np.array([words.get(letter, place[letter]) for letter in "XY"])
        clockwise = statement.parts[0] == "2"
        via = via_point(begin * 1e-3, end * 1e-3, (begin + (i, j)) * 1e-3, clockwise)
        if via is not None:
            swept = centre_and_swept(begin, via * 1e3, end)[1]
            return [*(via * 1e3).tolist(), place["Z"]], float(np.hypot(i, j)) * abs(swept)
    raise GRAMMAR.unknown(statement.text, statement.line)


def _read_start(
    lines: Sequence[str], spec: MachineSpec, letters: Sequence[str], selected: Sequence[str]
) -> tuple[dict[str, float], float]:
    """Where the opening lines leave the machine, by letter, and the greatest Z on the way there."""
    must = [*FLAVOURS[spec.flavour].begin, *selected]
    if spec.flavour == "linuxcnc":
        must.append(f"G92 {spec.filament}0")
    must += [spec.tcp_on] if spec.tcp else []
    place: dict[str, float] = {}
    highest = -np.inf
    for n, line in enumerate(lines, 1):
        if line in must and not place:
            must.remove(line)
            continue
        for statement in GRAMMAR.statements([line], n):
            if spec.flavour == "linuxcnc" and statement.word == "blend":
                continue
            words = _words(statement, "0")
            if not words.keys() <= set(letters):
                raise GRAMMAR.unknown(line, n)
            place |= words
            highest = max(highest, words.get("Z", highest))
    if must or set(place) != set(letters):
        missing = ", ".join([*must, *(name for name in letters if name not in place)])
        raise InputError(f"{missing} is missing before the first move", file=GRAMMAR.file, line=len(lines) + 1)
    return {name: place[name] for name in letters}, highest


def _words(statement: Statement, motions: str) -> dict[str, float]:
    """Values of a move by letter, if its G is one of `motions`. Raises InputError for any other statement, and for a
    letter that occurs twice."""
    if statement.word == "move" and statement.parts[0] in motions:
        found = [(word[0], float(word[1:])) for word in statement.parts[1].split()]
        if len({letter for letter, _ in found}) == len(found):
            return dict(found)
    raise GRAMMAR.unknown(statement.text, statement.line)


# ----------------------------------------------------------------------------------------------------
# Check of a program that was read against the plan: nozzle, filament, times and orders.

LEAN = np.radians(0.1)
ROUNDED = 1e-6  # [m]
STANDS = 1e-6  # [m]; a shorter line is rounding, and does not show where on it the tip is
LATE = 15e-3  # [s] by which the tip may be early or late on a bead
FILAMENT = 0.02e-3  # [m] too much or too little at the beginning or end of a bead
ORDER_LATE = 3e-3  # [s], plus a sample: how far an order may be from its time
DURATION = 3e-3  # [s]


def differences(plan: Plan, files: Mapping[str, str]) -> list[str]:
    """Differences of the program from the plan beyond rounding and thinning. InputError for an unknown line."""
    spec = spec_of(plan)
    machine = machine_of(spec)
    t = plan.trajectory
    station = t.q[:, len(plan.cell.arm) :] if isinstance(machine, PoseMachine) else np.empty((len(t), 0))
    letters = ("X", "Y", "Z", *machine.letters, *STATION[: station.shape[1]])
    program = read_axes(files[file_name(plan)], spec, letters, first_tool(plan))
    tip, quat = t.tip.copy(), continuous(t.quat)
    if not isinstance(machine, PoseMachine):
        first, last = above(plan)
        tip[:first], quat[:first], tip[last:], quat[last:] = tip[first], quat[first], tip[last], quat[last]
    near = plan.problem.program.chord
    found = _moved(machine, program, tip, quat, station, t.t - t.t[0], t.deposit, near)
    found += _beyond_reach(machine, program)
    found += _fed(plan, program)
    found += _order_differences(plan, program)
    if not abs(program.time[-1] - (t.t[-1] - t.t[0])) <= DURATION:
        found.append(f"it lasts {program.time[-1]:.3f} s")
    return found


def _moved(
    machine: Machine,
    program: AxesProgram,
    tip: Array,
    quat: Array,
    station: Array,
    clock: Array,
    laid: NDArray[np.bool_],
    near: float,
) -> list[str]:
    """Differences of the program's lines: tip more than `near` [m] off the path, directions, times, the part's axes."""
    k = len(machine.letters)
    places = machine.tip(program.straight, program.turning[:, :k])
    arcs = _ways(machine, program, places)
    best = np.full(len(tip), np.inf)
    lean, late, shifted = np.full(len(tip), np.inf), np.full(len(tip), np.inf), np.zeros(len(tip))
    own = np.searchsorted(program.time, clock) - 1
    for by in (-1, 0, 1):  # a sample next to a target may belong to the line before or after it
        a = np.clip(own + by, 0, len(places) - 2)
        lasts = program.time[a + 1] - program.time[a]
        share = np.clip((clock - program.time[a]) / np.where(lasts > 0.0, lasts, 1.0), 0.0, 1.0)
        u = nearest_fraction(places[a], places[a + 1], tip, share)
        u = np.where(np.linalg.norm(places[a + 1] - places[a], axis=1) < STANDS, share, u)
        own_arc = arcs.take(a)
        u = np.where(own_arc.circular, own_arc.fraction(tip, share), u)
        turning = lerp(program.turning, a, a + 1, u)
        straight = lerp(program.straight, a, a + 1, u)
        there = np.where(own_arc.circular[:, None], own_arc.at(u), machine.tip(straight, turning[:, :k]))
        off = np.linalg.norm(there - tip, axis=1)
        nearer = off < best - 1e-9
        best = np.where(nearer, off, best)
        lean = np.where(nearer, machine.leaning(turning[:, :k], quat), lean)
        late = np.where(off <= near, np.minimum(late, np.abs(program.time[a] + u * lasts - clock)), late)
        off_station = np.abs(turning[:, k:] - station).max(axis=1, initial=0.0)
        shifted = np.where(nearer, off_station, shifted)
    at = np.clip(np.searchsorted(clock, program.time), 1, len(clock) - 1)
    astray = np.full(len(places), np.inf)
    for by in (-1, 0, 1):
        b = np.clip(at + by, 1, len(clock) - 1)
        u = nearest_fraction(tip[b - 1], tip[b], places, np.zeros(len(places)))
        astray = np.minimum(astray, np.linalg.norm(lerp(tip, b - 1, b, u) - places, axis=1))
    return beyond(
        [
            ("the tip is {:.3g} m off its path", float(best.max()), near),
            ("a target is {:.3g} m off the path", float(astray.max()), near),
            ("the nozzle leans {:.3g} rad from its direction", float(lean.max()), LEAN),
            ("an axis that moves the part is off by {:.3g} rad", float(shifted.max()), LEAN),
            ("the tip is {:.3g} s off its time", float(late[laid].max(initial=0.0)), LATE),
        ]
    )


def _ways(machine: Machine, program: AxesProgram, places: Array) -> LinesAndArcs:
    """The tip's way in the part from each place to the next; valid only for arcs.

    Rotary axes stand still on arcs, so these are arcs in the part as well.
    """
    circular = ~np.isnan(program.via[1:, 0])
    via = np.where(circular[:, None], program.via[1:], program.straight[1:])
    return segments(places[:-1], machine.tip(via, program.turning[1:, : len(machine.letters)]), places[1:], circular)


def _beyond_reach(machine: Machine, program: AxesProgram) -> list[str]:
    """Axes that turn beyond their range, or move beyond their limits."""
    found = []
    for letter, within, turning in zip(machine.letters, machine.ranges, program.turning.T, strict=False):
        if within is not None and not (within[0] - 1e-6 <= turning.min() and turning.max() <= within[1] + 1e-6):
            found.append(f"{letter} turns beyond its range")
    if isinstance(machine, FiveAxes):
        slides = machine.slides(machine.tip(program.straight, program.turning), program.turning)
        if not machine.tcp:  # Z is the machine's own
            slides = np.vstack([slides, [*slides[0, :2], program.highest]])
        inside = (slides >= machine.least - ROUNDED) & (slides <= machine.greatest + ROUNDED)
        for name, ok in zip("XYZ", inside.T, strict=True):
            found += [] if ok.all() else [f"{name} goes beyond its limits"]
    return found


def _fed(plan: Plan, program: AxesProgram) -> list[str]:
    """Differences in filament at both ends of every bead, and in total."""
    t = plan.trajectory
    edge = np.flatnonzero(np.diff(t.deposit.astype(np.int8), prepend=0, append=0))
    ends = np.unique(np.concatenate([np.clip(edge, 0, len(t) - 1), np.clip(edge - 1, 0, len(t) - 1), [len(t) - 1]]))
    fed = np.interp(t.t[ends] - t.t[0], program.time, program.filament)
    off = np.abs(fed - (t.feed[ends] - t.feed[0]))
    # beads of different tools may meet within a sample; what a few milliseconds push is rounding
    most = FILAMENT + ORDER_LATE * float(np.abs(np.diff(t.feed)).max(initial=0.0)) / t.dt
    worst = int(np.argmax(off))
    if off[worst] <= most:
        return []
    return [f"{off[worst] * 1e3:.3g} mm of filament too much or too little by {t.t[ends[worst]] - t.t[0]:.3f} s"]


def _order_differences(plan: Plan, program: AxesProgram) -> list[str]:
    """Differences in orders to the board, and in their times."""
    flavour = FLAVOURS[spec_of(plan).flavour]
    planned = [(due, flavour.order(line)) for order in orders(plan, BOARD) for due, line in order.due]
    others = "there are other orders to heaters, tools, fan and cutter"
    return order_differences(planned, program.orders, ORDER_LATE + plan.trajectory.dt, others)
