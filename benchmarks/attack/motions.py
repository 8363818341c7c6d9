"""Plans and programs that are spoilt on purpose, at random: what is not found, though it is beyond tolerance, is an escape.

python -m benchmarks.attack [plans] [rapid] [gcode] [--count 500] [--seed 0] [--problem peer_cap] [--set …] [--csv FILE]

plans   numbers, beads, layers and flags of the trajectory, joints' limits, tool, path and process; then the plan is written
rapid   numbers, speeds, zones and kinds of moves of the program; lines that are left out, said twice or swapped
gcode   likewise of the extruder's file

What is not found is judged by its effect: a program is played beside the true one, filament is added up by a few lines of
this file. Exit code 1 if anything escaped.
"""

from __future__ import annotations

import argparse
import csv
import random
import re
import sys
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from planner.base.arrays import Array
from planner.base.errors import EXIT_VERIFIED, InputError, PlannerError
from planner.base.nearest import distance_to_polyline
from planner.export.extruder import FILE, differences, gcode
from planner.export.languages import LANGUAGES
from planner.export.player.play import play
from planner.export.rapid.reader import read_rapid_files
from planner.export.rapid.writer import rapid_files
from planner.plan import Plan
from planner.planning.pipeline import as_it_is, solve
from planner.problem import load_problem

EXIT_ESCAPED = 1
FOUND, HARMLESS, ESCAPED = "found", "within tolerance", "escaped"
# What is least changed, beyond what checks allow: rad, m, m/s, m^3/s, m^3, s; the greatest is a thousand times as much.
LEAST = {
    "q": 1e-4, "tip": 1e-5, "axis": 1e-4, "quat": 1e-4, "speed": 3e-3, "flow": 1e-9, "s": 1e-4, "t": 1e-6, "extruded": 1e-9,
    "feed": 1e-4,
}  # fmt: skip
PATH, TIME = 1e-3, 0.01  # m and share of the time by which a program may be off that is not found
FILAMENT = 0.05  # mm that may have moved more or less
# A kind of move, zone or order, and another one in its place.
KINDS = (
    ("MoveL", "MoveJ"),
    ("MoveJ", "MoveL"),
    ("TriggL", "MoveL"),
    ("fine", "z50"),
    (",z", ",z1"),
    ("S1", "S0"),
    ("E", "E-"),
)
NUMBERS = re.compile(r"-?\d+\.\d+|(?<=[ T][FPST])\d+|(?<=[\[,])-?\d+(?=[,\]])")  # but not of 9E9, which is no number
MOVES = re.compile(r"^ +(Move|Trigg[LCJ]|SetDO|WaitTime|CONST (speed|zone)data)")
FEEDS = re.compile(r"^ *(G1|G4|M577|T\d|M400)")


@dataclass(frozen=True)
class Attack:
    """What was spoilt, and what became of it."""

    kind: str
    what: str
    verdict: str
    told: str


def spoilt_plan(plan: Plan, by: random.Random) -> tuple[str, Plan]:
    """A plan with a change at random, and what it is."""
    t = plan.trajectory
    what = by.choice(
        [*LEAST, "bead", "layer", "deposit", "branch", "dt", "first_bead", "limits", "tool", "path", "process"]
    )
    n = by.choice([1, 3, 30, 300])
    first = by.randrange(len(t) - n)
    rows = slice(first, first + n)
    if what in LEAST:
        values = getattr(t, what).copy()
        step = LEAST[what] * 10.0 ** by.uniform(0.0, 3.0) * by.choice([-1.0, 1.0])
        at = (rows, by.randrange(values.shape[1])) if values.ndim == 2 else rows
        values[at] += step
        return f"{what} {step:+.3g} in {n} rows", replace(plan, trajectory=replace(t, **{what: values}))
    if what in ("bead", "layer", "deposit", "branch"):
        values = getattr(t, what).copy()
        values[rows] = ~values[rows] if what == "deposit" else values[rows] + by.choice([-2, -1, 1, 2, 99])
        return f"{what} in {n} rows", replace(plan, trajectory=replace(t, **{what: values}))
    if what in ("dt", "first_bead"):
        value: Any = t.dt * by.choice([0.9, 1.01, 2.0]) if what == "dt" else by.choice([-1, 1, 7])
        return what, replace(plan, trajectory=replace(t, **{what: value}))
    if what == "limits":
        name = by.choice(["velocity", "acceleration", "jerk"])
        limits = replace(plan.cell.limits, **{name: getattr(plan.cell.limits, name) * by.uniform(1.01, 3.0)})
        return f"limits of {name}", replace(plan, cell=replace(plan.cell, limits=limits))
    if what == "tool":
        T = plan.cell.T_flange_nozzle.copy()
        T[by.randrange(3), 3] += by.choice([-1.0, 1.0]) * 10.0 ** by.uniform(-4.0, -1.0)
        return what, replace(plan, cell=replace(plan.cell, T_flange_nozzle=T))
    if what == "path":
        beads = list(plan.toolpath.beads)
        k = by.randrange(len(beads))
        beads[k] = replace(beads[k], points=beads[k].points + 10.0 ** by.uniform(-4.0, -1.0))
        return what, replace(plan, toolpath=replace(plan.toolpath, beads=tuple(beads)))
    process = plan.problem.process.model_copy(
        update={"travel_speed": plan.problem.process.travel_speed * by.uniform(1.01, 3.0)}
    )
    return what, replace(plan, problem=plan.problem.model_copy(update={"process": process}))


def attack_plan(plan: Plan, by: random.Random) -> Attack:
    """Whether a spoilt plan would be written with its programs."""
    what, spoilt = spoilt_plan(plan, by)
    try:
        judged = as_it_is(spoilt)
    except InputError as error:
        return Attack("plans", what, FOUND, str(error))
    told = ", ".join(check.name for check in judged.checks if not check.ok)
    return Attack("plans", what, ESCAPED if judged.verified else FOUND, told)


def spoilt_lines(text: str, by: random.Random, chosen: re.Pattern[str]) -> tuple[str, str]:
    """A text with a change at random of a line that is chosen, and what it is."""
    what, spoilt = _spoilt_once(text, by, chosen)
    while spoilt == text:
        what, spoilt = _spoilt_once(text, by, chosen)
    return what, spoilt


def _spoilt_once(text: str, by: random.Random, chosen: re.Pattern[str]) -> tuple[str, str]:
    lines = text.splitlines()
    own = [k for k, line in enumerate(lines) if chosen.search(line)]
    i = by.choice(own)
    what = by.choice(["number", "number", "number", "number", "left out", "twice", "swapped", "kind"])
    if what == "left out":
        del lines[i]
    elif what == "twice":
        lines.insert(i, lines[i])
    elif what == "swapped":
        k = by.choice(own)
        lines[i], lines[k] = lines[k], lines[i]
    elif what == "kind":
        old, new = by.choice([pair for pair in KINDS if pair[0] in lines[i]] or [("", "")])
        lines[i] = lines[i].replace(old, new, 1)
    else:
        numbers = list(NUMBERS.finditer(lines[i]))
        if numbers:
            found = by.choice(numbers)
            value = float(found[0])
            value = (
                value * by.choice([0.5, 0.9, 1.1, 2.0])
                if by.random() < 0.5
                else value + by.choice([-20.0, -1.0, 1.0, 20.0])
            )
            digits = len(found[0].partition(".")[2])
            lines[i] = f"{lines[i][: found.start()]}{value:.{digits}f}{lines[i][found.end() :]}"
    return f"{what}: {lines[min(i, len(lines) - 1)].strip()[:60]}", "\n".join(lines) + "\n"


def attack_rapid(plan: Plan, files: dict[str, str], by: random.Random) -> Attack:
    """Whether a spoilt program passes for the plan's, and does something else when it is played."""
    name = by.choice(sorted(name for name in files if name.endswith(".mod")))
    what, text = spoilt_lines(files[name], by, MOVES)
    spoilt = files | {name: text}
    try:
        told = LANGUAGES["rapid"].differences(plan, spoilt)
    except InputError as error:
        return Attack("rapid", what, FOUND, str(error))
    if told:
        return Attack("rapid", what, FOUND, told[0])
    effect = played_otherwise(plan, files, spoilt)
    return Attack("rapid", what, ESCAPED if effect else HARMLESS, effect)


def played_otherwise(plan: Plan, files: dict[str, str], spoilt: dict[str, str]) -> str:
    """What a spoilt program does otherwise than the true one, if that is beyond tolerance."""
    true, other = (play(read_rapid_files(each), plan.cell) for each in (files, spoilt))
    off = float(distance_to_polyline(other.position, true.position).max())
    longer = other.duration / true.duration - 1.0
    outputs = [[(event.text, event.value) for event in each.events if event.kind == "output"] for each in (true, other)]
    if off > PATH or abs(longer) > TIME or outputs[0] != outputs[1]:
        return f"{1e3 * off:.2f} mm off, {longer:+.1%} in time, outputs {'alike' if outputs[0] == outputs[1] else 'differ'}"
    return ""


def attack_gcode(plan: Plan, text: str, by: random.Random) -> Attack:
    """Whether a spoilt file of the extruder passes for the plan's, and moves filament otherwise."""
    what, spoilt = spoilt_lines(text, by, FEEDS)
    try:
        told = differences(plan, {FILE: spoilt})
    except InputError as error:
        return Attack("gcode", what, FOUND, str(error))
    if told:
        return Attack("gcode", what, FOUND, told[0])
    off = fed_otherwise(text, spoilt)
    return Attack("gcode", what, ESCAPED if off > FILAMENT else HARMLESS, f"{off:.3g} mm" if off else "")


def fed_otherwise(text: str, spoilt: str) -> float:
    """Filament [mm] by which two files differ at most, at the same time since the same wait; infinite if they wait otherwise."""
    true, other = fed_between_waits(text), fed_between_waits(spoilt)
    if [wait for wait, _ in true] != [wait for wait, _ in other]:
        return float("inf")
    worst = 0.0
    for (_, a), (_, b) in zip(true, other, strict=True):
        times = np.union1d(a[:, 0], b[:, 0])
        worst = max(worst, float(np.abs(np.interp(times, *a.T) - np.interp(times, *b.T)).max()))
    return worst


def fed_between_waits(text: str) -> list[tuple[str, Array]]:
    """Each wait for the robot, and the filament [mm] at times [s] since then (k, 2)."""
    out: list[tuple[str, list[tuple[float, float]]]] = [("", [(0.0, 0.0)])]
    for line in (line.strip() for line in text.splitlines()):
        t, fed = out[-1][1][-1]
        if line.startswith("M577"):
            out.append((line, [(0.0, 0.0)]))
        elif move := re.fullmatch(r"G1 E(-?[\d.]+) F([\d.]+)", line):
            out[-1][1].append((t + abs(float(move[1])) / float(move[2]) * 60.0, fed + float(move[1])))
        elif pause := re.fullmatch(r"G4 P(\d+)", line):
            out[-1][1].append((t + int(pause[1]) * 1e-3, fed))
    return [(wait, np.array(knots)) for wait, knots in out]


def attacks(plan: Plan, kind: str, count: int, by: random.Random) -> list[Attack]:
    """So many attacks of a kind, each of them on the plan as it was."""
    one: Callable[[], Attack]
    if kind == "plans":
        one = lambda: attack_plan(plan, by)  # noqa: E731
    elif kind == "rapid":
        files = rapid_files(plan)
        one = lambda: attack_rapid(plan, files, by)  # noqa: E731
    else:
        text = gcode(plan)
        one = lambda: attack_gcode(plan, text, by)  # noqa: E731
    return [one() for _ in range(count)]


def command_line() -> argparse.ArgumentParser:
    """The parser of the command."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.attack", description=(__doc__ or "").split("\n")[0])
    parser.add_argument("kinds", nargs="*", metavar="KIND", help="plans, rapid, gcode (default: all)")
    parser.add_argument("--count", type=int, default=500, help="attacks of each kind (default 500)")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--problem", default="peer_cap", help="a shipped problem or a file (default peer_cap)")
    parser.add_argument("--set", dest="changes", action="append", default=[], metavar="KEY=VALUE")
    parser.add_argument("--csv", type=Path, metavar="FILE", help="a row for each attack")
    return parser


def main(arguments: Sequence[str] | None = None) -> int:
    """The command; returns its exit code."""
    parser = command_line()
    options = parser.parse_args(arguments)
    kinds = options.kinds or ["plans", "rapid", "gcode"]
    if unknown := [kind for kind in kinds if kind not in ("plans", "rapid", "gcode")]:
        parser.error(f"there is no kind {unknown[0]!r}: plans, rapid, gcode")
    try:
        plan = solve(load_problem(options.problem, options.changes), baseline=False)
    except PlannerError as error:
        print(f"error: {error}", file=sys.stderr)
        return error.exit_code
    if not plan.verified:
        parser.error(f"{options.problem} is not verified as it is")
    rows = [row for kind in kinds for row in attacks(plan, kind, options.count, random.Random(options.seed))]
    if options.csv is not None:
        with options.csv.open("w", encoding="utf-8", newline="") as stream:
            csv.writer(stream).writerows([(row.kind, row.what, row.verdict, row.told) for row in rows])
    table = Table("kind", "attacks", FOUND, HARMLESS, ESCAPED, title=f"{plan.name}, seed {options.seed}")
    for kind in kinds:
        counts = Counter(row.verdict for row in rows if row.kind == kind)
        table.add_row(kind, str(options.count), *(str(counts[verdict]) for verdict in (FOUND, HARMLESS, ESCAPED)))
    Console().print(table)
    escaped = [row for row in rows if row.verdict == ESCAPED]
    for row in escaped:
        print(f"{row.kind}: {row.what}: {row.told}")
    return EXIT_ESCAPED if escaped else EXIT_VERIFIED


if __name__ == "__main__":
    sys.exit(main())
