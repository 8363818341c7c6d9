"""Tables that people make of a test line, and those that runs and scans leave for the next print, spoilt: each is refused by
name, or what is made of it is right.

python -m benchmarks.attack --only tables corrections
"""

from __future__ import annotations

import random
import re
import shutil
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from benchmarks.attack import files
from benchmarks.attack.cases import ACCEPTED, ESCAPED, FOUND, HARMLESS, REFUSED, Case, Chance, Kind, Outcome
from benchmarks.attack.in_process import Said, attack_command, numbers_after, own_folder, said_by
from benchmarks.attack.prints import NAME, ON_POSITIONER, solved
from benchmarks.attack.problems import badly_told
from benchmarks.attack.recordings import FORMS, Table
from benchmarks.attack.text import spoilt_lines
from benchmarks.learn import ROBOTS
from benchmarks.learn import recorded as recorded_run
from benchmarks.recordings import line_table
from planner.base.errors import InputError
from planner.base.progress import Stages
from planner.feedback.identify_command import main as identify
from planner.feedback.identify_extruder import FlowLine, line_of, line_text
from planner.feedback.learn_command import main as learn
from planner.motion.as_run import corrections_of
from planner.plan import Plan
from planner.planning.pipeline import with_asked
from planner.problem import load_problem

COUNT = 300
LAG, FLOW, DENSITY = 0.1, 0.92, 1240.0  # s; of what is asked; kg/m³
NOISE = {True: 0.02e-6, False: 0.02e-3}  # kg of a piece, m of a width
LENGTH = 240e-3  # m
ERRORS, LAG_OFF, FLOW_OFF = 5.0, 0.01, 0.03  # standard errors, or s and share, by which what is told may be off

# ---- a test line ------------------------------------------------------------------------------------------------------

Rows = list[list[str]]


def typing(rows: Rows, by: random.Random) -> None:
    """A number that was typed wrong."""
    row = by.choice(rows)
    k = by.randrange(len(row))
    text = row[k]
    row[k] = by.choice([
        text.replace(".", ""), text.replace(".", ","), text + "0", text[1:], "-" + text, text + " mg", "?", "", text[::-1],
        f"{10.0 * float(text):g}", f"{0.1 * float(text):g}", "nan", "1e400", "O.5",
    ])  # fmt: skip


def left_out(rows: Rows, by: random.Random) -> None:
    k = by.randrange(len(rows))
    del rows[k : k + by.choice([1, 1, 3, 30])]


def exchanged(rows: Rows, by: random.Random) -> None:
    """Values of two rows: pieces that were mixed up."""
    a, b = by.choice(rows), by.choice(rows)
    a[-1], b[-1] = b[-1], a[-1]


def reversed_rows(rows: Rows, by: random.Random) -> None:
    rows.reverse()


def turned(rows: Rows, by: random.Random) -> None:
    """The line was measured from its other end."""
    values = [row[-1] for row in rows]
    for row, value in zip(rows, reversed(values), strict=True):
        row[-1] = value


def doubled(rows: Rows, by: random.Random) -> None:
    k = by.randrange(len(rows))
    rows.insert(k, list(rows[k]))


def other_unit(rows: Rows, by: random.Random) -> None:
    columns, factor = by.choice([[-1], [*range(len(rows[0]) - 1)], [0]]), by.choice([1e-3, 1e3, 0.1, 10.0])
    for row in rows:
        for k in columns:
            row[k] = f"{float(row[k]) * factor:g}"


def column_missing(rows: Rows, by: random.Random) -> None:
    k = by.randrange(len(rows[0]))
    for row in rows:
        del row[k]


def constant(rows: Rows, by: random.Random) -> None:
    value = by.choice(["0", rows[0][-1], "1", "1e-12", "1e12"])
    for row in rows:
        row[-1] = value


ROW_CHANGES: dict[str, Callable[[Rows, random.Random], None]] = {
    "typing": typing, "left out": left_out, "exchanged": exchanged, "reversed": reversed_rows, "turned": turned,
    "doubled": doubled, "another unit": other_unit, "a column missing": column_missing, "constant": constant,
}  # fmt: skip


def attack_table(line: FlowLine, folder: Path, by: Chance) -> Outcome:
    """Spoil the table of a test line, or what was asked of it, and have lag and flow found."""
    own, weighed = own_folder(folder, by), by.random() < 0.5
    try:
        density = DENSITY if weighed else None
        file = line_table(own / "line.csv", line, LAG, FLOW, density, NOISE[weighed], by.getrandbits(20))
        asked, whats, data = line_text(line).encode(), ["weighed" if weighed else "looked at"], file.read_bytes()
        how = by.random()
        if how < 0.15:
            whats += ["asked", by.choice([*files.CHANGES])]
            asked = files.CHANGES[whats[-1]](asked, by)
        elif how < 0.6:
            head, *lines = data.decode().splitlines()
            rows = [line.split(",") for line in lines]
            whats.append(by.choice([*ROW_CHANGES]))
            ROW_CHANGES[whats[-1]](rows, by)
            data = "\n".join([head, *map(",".join, rows)]).encode() + b"\n"
        else:
            for _ in range(by.choice([1, 1, 2])):
                if data:
                    whats.append(by.choice([*files.CHANGES, "number", "number"]))
                    data = files.CHANGES[whats[-1]](data, by)
        file.write_bytes(data)
        (own / "asked.json").write_bytes(asked)
        out, what = own / "written.yaml", ", ".join(whats)
        arguments = ["extruder", "read", str(file), "peer_cap", "--asked", str(own / "asked.json"), "--write", str(out)]
        if weighed and by.random() < 0.8:
            arguments += ["--density", f"{1e-3 * DENSITY:g}"]
        outcome = attack_command(identify, arguments, out, (file.name, "asked.json"), what, partial(_flow, out, what))
        if outcome.verdict != HARMLESS and out.exists():
            return Outcome(what, ESCAPED, f"{outcome.verdict}, and wrote {out.name}: {outcome.told}")
        return outcome
    finally:
        shutil.rmtree(own)


def _flow(out: Path, what: str, said: Said) -> Outcome:
    """Whether lag and flow that are told are the extruder's."""
    load_problem(out)
    lag = numbers_after(said.out, r"flow lags the motor by ([0-9.]+) ±([0-9.]+) s")
    flow = numbers_after(said.out, r"laid is ([0-9.]+) ±([0-9.]+) of")
    wrong = [f"lag {value} ±{error}" for value, error in lag if abs(value - LAG) > max(ERRORS * error, LAG_OFF)]
    wrong += [f"flow {value} ±{error}" for value, error in flow if abs(value - FLOW) > max(ERRORS * error, FLOW_OFF)]
    return Outcome(what, ESCAPED if wrong else HARMLESS, "; ".join(wrong))


def _prepared_tables(folder: Path) -> Case:
    return partial(attack_table, line_of(load_problem("peer_cap"), LENGTH), folder)


# ---- corrections --------------------------------------------------------------------------------------------------------

ROWS = re.compile(r"^[0-9]")
FINER = 0.12  # of the cases go on: the program is verified, or a second run is learned from
MOST = 1e-3  # m


@dataclass(frozen=True)
class Corrected:
    """A plan, what its first run taught, and the recording of a second run."""

    folder: Path
    plan: Plan


def attack_corrections(given: Corrected, by: Chance) -> Outcome:
    """Spoil the file of corrections that a first run has left, and go on with it."""
    own, source = own_folder(given.folder, by), given.folder / "taught"
    try:
        for path in source.iterdir():
            shutil.copy(path, own / path.name)
        text, whats = (source / "corrections.csv").read_text("utf-8"), []
        if by.random() < 0.5:
            what, text = spoilt_lines(text, by, ROWS)
            whats, data = [what], text.encode()
        else:
            data = text.encode()
            for _ in range(by.choice([1, 1, 2])):
                if data:
                    whats.append(by.choice([*files.CHANGES, "number", "number"]))
                    data = files.CHANGES[whats[-1]](data, by)
        (own / "corrections.csv").write_bytes(data)
        what, target = ", ".join(whats), own / f"{NAME}_run_2.yaml"
        how = by.random()
        if how < FINER:
            arguments = [str(target), str(given.folder / "second.csv"), "--out", str(own / "out"), "--quiet"]
            judged = partial(_third_run, given, own, f"learn, {what}")
            return attack_command(learn, arguments, own / "out", ("corrections.csv",), f"learn, {what}", judged)
        return _asked(given, target, what, whole=how < 2.0 * FINER)
    finally:
        shutil.rmtree(own)


def _asked(given: Corrected, target: Path, what: str, whole: bool) -> Outcome:
    """What a program would ask for."""
    try:
        problem = load_problem(target)
        found = corrections_of(problem, given.plan.toolpath)
        if found is None:
            return Outcome(what, ESCAPED, "no corrections")
        if not np.isfinite(found.shift).all() or found.most > MOST * 1.001:
            return Outcome(what, ESCAPED, f"displaces by {found.most} m")
        if not whole:
            return Outcome(what, ACCEPTED)
        plan = with_asked(replace(given.plan, problem=problem), Stages())
    except InputError as error:
        wrong = badly_told(error)
        return Outcome(what, ESCAPED if wrong else REFUSED, wrong or str(error))
    failed = [check.name for check in plan.checks if not check.ok]
    return Outcome(what, FOUND if failed else ACCEPTED, "; ".join(failed))


def _third_run(given: Corrected, own: Path, what: str, said: Said) -> Outcome:
    """What is learned from a second run on top of it."""
    problem = load_problem(own / "out" / f"{NAME}_run_3.yaml")
    found = corrections_of(problem, given.plan.toolpath)
    if found is None or not np.isfinite(found.shift).all() or found.most > MOST * 1.001:
        return Outcome(what, ESCAPED, "corrections that are none")
    return Outcome(what, ACCEPTED)


def _prepared_corrections(folder: Path) -> Case:
    plan = solved(folder, **ON_POSITIONER)
    saved = plan.save(folder / f"{NAME}.plan")
    time, q = recorded_run(plan, ROBOTS["as fitted"])
    (folder / "first.csv").write_bytes(FORMS["degrees"](Table(time, q, q, plan.joint_names)))
    if said_by(learn, [str(saved), str(folder / "first.csv"), "--out", str(folder / "first"), "--quiet"]).code:
        raise RuntimeError("nothing was taught by the first run")
    taught = folder / "taught"
    taught.mkdir()
    for name in (f"{NAME}_run_2.yaml", "corrections.csv"):
        shutil.copy(folder / "first" / name, taught / name)
    problem = load_problem(folder / "first" / f"{NAME}_run_2.yaml")
    second = with_asked(replace(plan, problem=problem), Stages())
    time, q = recorded_run(second, ROBOTS["as fitted"])
    (folder / "second.csv").write_bytes(FORMS["degrees"](Table(time, q, q, plan.joint_names)))
    return partial(attack_corrections, Corrected(folder, plan))


KINDS = {
    "tables": Kind("tables of a test line of the extruder, and what it asked", COUNT, _prepared_tables),
    "corrections": Kind("what a run has taught, for the next one", COUNT, _prepared_corrections),
}
