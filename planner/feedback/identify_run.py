"""Compares the recording of a plan's own program with the program's path, and rejects other recordings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from planner.base.arrays import Array
from planner.base.errors import InputError
from planner.cell.cell import Cell
from planner.export.controllers import CONTROLLERS
from planner.export.languages import LANGUAGES, chosen
from planner.export.player.play import play
from planner.export.player.played import laid_moves
from planner.export.program import RobotProgram
from planner.export.rapid.reader import read_rapid_files
from planner.feedback.identify_path import CommandedPath, FollowedPath, follow
from planner.feedback.planned import SAVED, planned_results
from planner.feedback.readings import (
    LEAVES,
    RunStart,
    check_clock,
    check_digits,
    counting,
    departures,
    near_start,
    readings,
    run_starts,
)
from planner.feedback.recordings import DEGREE, RobotLog
from planner.link.streaming import modules_in
from planner.plan import Plan
from planner.problem import Problem

REACHED = 1e-3  # m from the end of the path, within which it is reached
BEHIND = 0.3  # s examined after the end


@dataclass(frozen=True)
class PlannedRun:
    """A plan's program: its path, the cell whose joints it uses, its language, and a description of its source."""

    path: CommandedPath
    cell: Cell
    language: str
    words: str


@dataclass(frozen=True)
class RecordedRun:
    """The part of a recording that follows a path: samples matched to it, and notes on how the file was read;
    lines: the samples' lines in the file."""

    followed: FollowedPath
    lines: Array
    remarks: tuple[str, ...]


# ----------------------------------------------------------------------------------------------------
# The plan.


def planned_run(given: str, problem: Problem, cell: Cell) -> PlannedRun:
    """The program of a saved plan, or of a folder of results.

    A folder's RAPID program is read; programs in other languages need a saved plan, without which only the sampled path
    is known. Raises InputError for anything but a plan of this cell.
    """
    if cell.nozzles:
        raise problem.error("cell.nozzles", "recordings can only be compared with plans for one nozzle")
    path = Path(given)
    if path.is_dir():
        return _of_folder(path, problem, cell)
    if not path.exists():
        raise InputError(
            "there is no such file or folder", file=path, hint="a folder that solve wrote, or a saved plan"
        )
    if path.suffix not in SAVED:
        raise InputError(
            "is no plan", file=path, hint="a folder that solve wrote, or what plan.save wrote (.plan, .npz)"
        )
    plan = Plan.load(path)
    if plan.joint_names != cell.joint_names or plan.problem.name != problem.name:
        raise InputError(
            f"is a plan of {plan.problem.name}", file=path, hint=f"a plan of {problem.name}, or another CELL"
        )
    name = next((each for each in chosen(plan).names if each in CONTROLLERS), None)
    if name is None:
        return PlannedRun(path_of_samples(plan.q, plan.cell), plan.cell, "", "the plan's samples")
    language = LANGUAGES[name]
    own = language.plan(plan).cell
    program = language.program(plan, language.write(plan))
    return PlannedRun(path_of_program(program, own), own, name, f"the plan's {language.title} program")


def path_of_program(program: RobotProgram, cell: Cell) -> CommandedPath:
    """The path of a program as written, sharp corners included. Raises InputError if it cannot be played."""
    played = play(program, cell)
    return CommandedPath(
        q=played.q,
        tip=played.position,
        target=played.target,
        zone=program.zone,
        fine=program.fine,
        line=program.linear & ~program.circular,
        laid=laid_moves(played),
        speed=np.where(program.linear, program.speed[:, 0], np.nan),
    )


def path_of_samples(q: Array, cell: Cell) -> CommandedPath:
    """The path through sampled joints (k, n) [rad, m], without known targets."""
    none, nothing = np.empty(0), np.empty(0, dtype=np.bool_)
    tip = cell.T_part_nozzle(np.ascontiguousarray(q))[:, :3, 3]
    return CommandedPath(q, tip, np.empty(0, dtype=np.intp), none, nothing, nothing, nothing, none)


def _of_folder(folder: Path, problem: Problem, cell: Cell) -> PlannedRun:
    """The run planned in a folder of results."""
    name = planned_results(folder).name
    if name != problem.name:
        raise InputError(
            f"is a plan of {name}", file=folder / "plan.json", hint=f"one of {problem.name}, or another CELL"
        )
    modules = {path.name: path.read_text(encoding="utf-8", errors="replace") for path in modules_in(folder)}
    if modules:
        own = cell.as_counted
        return PlannedRun(
            path_of_program(read_rapid_files(modules), own), own, "rapid", "the RAPID program in the folder"
        )
    return PlannedRun(path_of_samples(_samples(folder / "trajectory.csv", cell), cell), cell, "", "trajectory.csv")


def _samples(file: Path, cell: Cell) -> Array:
    """Joints (k, n) [rad, m] of trajectory.csv."""
    try:
        with file.open(encoding="utf-8") as stream:
            head = [name.strip() for name in stream.readline().split(",")]
            table = np.loadtxt(stream, delimiter=",", usecols=[head.index(name) for name in cell.joint_names], ndmin=2)
    except FileNotFoundError as error:
        raise InputError("there is no such file", file=file, hint="a folder that solve wrote") from error
    except (OSError, ValueError) as error:
        raise InputError(f"is no trajectory of this cell: {error}"[:160], file=file) from error
    if len(table) < 2:
        raise InputError("holds no motion", file=file)
    return table


# ----------------------------------------------------------------------------------------------------
# The recording.


def recorded_run(log: RobotLog, run: PlannedRun, cell: Cell) -> RecordedRun:
    """Find the run in a recording. Raises InputError that names the cause if it is of another program, in other units,
    has gaps, or is incomplete."""
    counted = counting(cell, run.language or cell.arm_robot.language)
    starts = run_starts(log, run.cell, counted, run.path.q[0], partial(_counted, run=run, cell=cell))
    if not starts:
        plain = next(readings(log, cell.limits.sliding, counted))
        raise _misfit(log, _counted(plain.of(log.executed), run, cell), run)
    return _followed(log, starts, run)


def _counted(q: Array, run: PlannedRun, cell: Cell) -> Array:
    """The cell's joints, counted as in the run's program."""
    return cell.counted(q) if run.cell is not cell and run.language and LANGUAGES[run.language].counted else q


def _followed(log: RobotLog, starts: Sequence[RunStart], run: PlannedRun) -> RecordedRun:
    """The run that follows the path farthest from one of these starts."""
    total = float(run.path.way[-1])
    found = []
    for start in starts:
        first = start.first
        followed = follow(run.path, log.time[first:], start.q[first:], run.cell)
        off = np.flatnonzero(np.linalg.norm(followed.off, axis=1) > LEAVES)
        until = int(off[0]) if len(off) else len(followed.time) - 1
        found.append((float(followed.way[: until + 1].max()), start, first, until, followed, bool(len(off))))
    way, start, first, until, followed, leaves = max(found, key=lambda each: each[0])
    hint = "the whole recording of this plan's program, begun before it and ended after it"
    share = 100.0 * way / total
    if way < total - REACHED:
        if leaves:
            far = float(np.linalg.norm(followed.off[until]))
            reason = f"another program: it leaves the plan's path by {1e3 * far:.0f} mm after {share:.1f} % of it"
            raise InputError(reason, file=log.file, line=int(log.lines[first + until]), hint=hint)
        raise InputError(f"ends after {share:.1f} % of the path", file=log.file, line=int(log.lines[-1]), hint=hint)
    end = int(np.argmax(followed.way >= total - REACHED))
    last = min(first + end + round(BEHIND / log.step), len(log.time) - 1)
    check_digits(log, start.reading, run.cell)
    check_clock(log, first, last)
    cut = follow(run.path, log.time[first : last + 1], start.q[first : last + 1], run.cell)
    return RecordedRun(
        followed=cut,
        lines=log.lines[first : last + 1].astype(np.float64),
        remarks=(
            *start.reading.words,
            *log.remarks,
            f"columns {', '.join(log.told)}",
            f"{last - first + 1} samples, one every {1e3 * log.step:.3g} ms, in lines {log.lines[first]} to {log.lines[last]}",
        ),
    )


def _misfit(log: RobotLog, q: Array, run: PlannedRun) -> InputError:
    """Why no run of the program begins in a recording."""
    hint = "correct the names of the columns"
    for scale, unit, said in ((1.0 / DEGREE, "radians", "degrees"), (DEGREE, "degrees", "radians")):
        if departures(np.where(run.cell.limits.turns, scale, 1.0) * q, run.path.q[0], run.cell):
            return InputError(f"joints are in {unit}, but its header says {said}", file=log.file, hint=hint)
    names = run.cell.joint_names
    for i in range(len(names)):
        for j in range(i + 1, len(names)):
            order = np.arange(len(names))
            order[[i, j]] = j, i
            if departures(q[:, order], run.path.q[0], run.cell):
                reason = f"columns are in another order: {names[i]} is where {names[j]} should be"
                return InputError(reason, file=log.file, hint=hint)
    away = near_start(q, run.path.q[0], run.cell)
    nearest = int(np.argmin(away.max(axis=1)))
    j = int(np.argmax(away[nearest]))
    off = float(np.abs(q[nearest] - run.path.q[0])[j])
    shown = f"{np.degrees(off):.3g} degrees" if run.cell.limits.turns[j] else f"{1e3 * off:.3g} mm"
    reason = f"another program: it never begins where the plan does; at the nearest {names[j]} is {shown} away"
    return InputError(reason, file=log.file, line=int(log.lines[nearest]), hint="the recording of this plan's program")
