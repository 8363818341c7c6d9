"""The recording of a plan's own program, set beside the path that the program asks: what is found, and what is refused."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
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
from planner.feedback.identify_log import RobotLog
from planner.feedback.identify_match import LogReading, check_clock, readings
from planner.feedback.identify_path import (
    MOST_SHOWN,
    CommandedPath,
    FollowedPath,
    PathDeviation,
    PathFindings,
    ShownValue,
    follow,
)
from planner.feedback.identify_program import counting
from planner.feedback.planned import SAVED, planned_results
from planner.plan import Plan
from planner.problem import Problem

NEAR = (np.radians(1.0), 3e-3)  # from the path's first posture, within which a run begins [rad, m]
LEAVES = 0.03  # m from the path, beyond which it is another program's
REACHED = 1e-3  # m of the path's end, from which it is reached
MOST_STARTS = 6  # times that the robot stands at the first posture, from which a run is looked for
DEGREE = np.pi / 180.0


@dataclass(frozen=True)
class PlannedRun:
    """A plan's program as it is to be run: its path, the cell whose joints it speaks of, its language, and where from, in words."""

    path: CommandedPath
    cell: Cell
    language: str
    words: str


@dataclass(frozen=True)
class RecordedRun:
    """The part of a recording that follows a path: samples set beside it, and what was found out about the file, in words;
    lines: where the samples stand in the file."""

    followed: FollowedPath
    lines: Array
    remarks: tuple[str, ...]


# ----------------------------------------------------------------------------------------------------
# The plan.


def planned_run(given: str, problem: Problem, cell: Cell) -> PlannedRun:
    """What a plan asks: of a plan that was saved, or of a folder of results.

    A folder's RAPID program is read; of programs in other languages a saved plan is needed, and without it the sampled
    path alone is known. Raises InputError for what is no plan of this cell.
    """
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
    if plan.joint_names != cell.joint_names or plan.name != problem.name:
        raise InputError(f"is a plan of {plan.name}", file=path, hint=f"one of {problem.name}, or another CELL")
    name = next((each for each in chosen(plan).names if each in CONTROLLERS), None)
    if name is None:
        return PlannedRun(path_of_samples(plan.q, plan.cell), plan.cell, "", "the plan's samples")
    language = LANGUAGES[name]
    own = language.plan(plan).cell
    program = language.program(plan, language.write(plan))
    return PlannedRun(path_of_program(program, own), own, name, f"the plan's {language.title} program")


def path_of_program(program: RobotProgram, cell: Cell) -> CommandedPath:
    """The path of a program as it stands, corners and all. Raises InputError for one that cannot be played."""
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
    """The path through sampled joints (k, n) [rad, m], of which no targets are known."""
    none, nothing = np.empty(0), np.empty(0, dtype=np.bool_)
    tip = cell.T_part_nozzle(np.ascontiguousarray(q))[:, :3, 3]
    return CommandedPath(q, tip, np.empty(0, dtype=np.intp), none, nothing, nothing, nothing, none)


def _of_folder(folder: Path, problem: Problem, cell: Cell) -> PlannedRun:
    """Of the files that solve wrote."""
    name = planned_results(folder).name
    if name != problem.name:
        raise InputError(
            f"is a plan of {name}", file=folder / "plan.json", hint=f"one of {problem.name}, or another CELL"
        )
    modules = {path.name: path.read_text(encoding="utf-8", errors="replace") for path in sorted(folder.glob("*.mod"))}
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
    """Find the run in a recording. Raises InputError with what was found where it is another program's, in other units,
    with gaps, or not whole."""
    _, signs, offsets = counting(cell, run.language) if run.language else ("", *_as_is(cell))
    ways = [(each, _counted(log.executed * each.scale + each.offset, run, cell)) for each in
            readings(log, cell.limits.sliding, signs, offsets)]  # fmt: skip
    for reading, q in ways:
        begins = _starts(q, run)
        if len(begins):
            return _followed(log, reading, q, begins, run)
    raise _misfit(log, ways[0][1], run, cell)


def _as_is(cell: Cell) -> tuple[Array, Array]:
    return np.ones(len(cell.joint_names)), np.zeros(len(cell.joint_names))


def _counted(q: Array, run: PlannedRun, cell: Cell) -> Array:
    """Joints of the cell as those of the run's."""
    return cell.counted(q) if run.cell is not cell and run.language and LANGUAGES[run.language].counted else q


def _away(q: Array, run: PlannedRun) -> Array:
    """How far joints (s, n) are from the path's first posture, over what is near."""
    out: Array = np.abs(q - run.path.q[0]) / np.where(run.cell.limits.turns, *NEAR)
    return out


def _starts(q: Array, run: PlannedRun) -> list[int]:
    """Last samples of stretches in which the robot stands where the path begins, those that move on first."""
    near = np.append((_away(q, run) < 1.0).all(axis=1), False)
    ends = np.flatnonzero(near[:-1] & ~near[1:])
    return [int(k) for k in ends if k < len(q) - 5][:MOST_STARTS]


def _followed(log: RobotLog, reading: LogReading, q: Array, begins: Sequence[int], run: PlannedRun) -> RecordedRun:
    """The run that begins at one of these samples: the one that goes on farthest."""
    total = float(np.linalg.norm(np.diff(run.path.tip, axis=0), axis=1).sum())
    found = []
    for last in begins:
        first = max(last - round(0.2 / log.step), 0)
        followed = follow(run.path, log.time[first:], q[first:], run.cell)
        off = np.flatnonzero(np.linalg.norm(followed.off, axis=1) > LEAVES)
        until = int(off[0]) if len(off) else len(followed.time) - 1
        found.append((float(followed.way[: until + 1].max()), first, until, followed, bool(len(off))))
    way, first, until, followed, leaves = max(found, key=lambda each: each[0])
    hint = "the whole recording of this plan's program, begun before it and ended after it"
    share = 100.0 * way / total
    if way < total - REACHED:
        if leaves:
            far = float(np.linalg.norm(followed.off[until]))
            reason = f"another program: it leaves the plan's path by {1e3 * far:.0f} mm after {share:.1f} % of it"
            raise InputError(reason, file=log.file, line=int(log.lines[first + until]), hint=hint)
        raise InputError(f"ends after {share:.1f} % of the path", file=log.file, line=int(log.lines[-1]), hint=hint)
    end = int(np.argmax(followed.way >= total - REACHED))
    last = min(first + end + round(0.3 / log.step), len(log.time) - 1)
    check_clock(log, first, last)
    cut = follow(run.path, log.time[first : last + 1], q[first : last + 1], run.cell)
    return RecordedRun(
        followed=cut,
        lines=log.lines[first : last + 1].astype(np.float64),
        remarks=(
            *reading.words,
            f"columns {', '.join(log.told)}",
            f"{last - first + 1} samples, one every {1e3 * log.step:.3g} ms, in lines {log.lines[first]} to {log.lines[last]}",
        ),
    )


def _misfit(log: RobotLog, q: Array, run: PlannedRun, cell: Cell) -> InputError:
    """Why no run of the program begins in a recording."""
    hint = "name the columns as they are"
    for scale, unit, said in ((1.0 / DEGREE, "radians", "degrees"), (DEGREE, "degrees", "radians")):
        if _starts(scale * q, run):
            return InputError(f"joints are in {unit}, where its header says {said}", file=log.file, hint=hint)
    names = run.cell.joint_names
    for i in range(len(names)):
        for j in range(i + 1, len(names)):
            order = np.arange(len(names))
            order[[i, j]] = j, i
            if _starts(q[:, order], run):
                reason = f"columns are in another order: {names[i]} is where {names[j]} should be"
                return InputError(reason, file=log.file, hint=hint)
    away = _away(q, run)
    nearest = int(np.argmin(away.max(axis=1)))
    j = int(np.argmax(away[nearest]))
    off = float(np.abs(q[nearest] - run.path.q[0])[j])
    shown = f"{np.degrees(off):.3g} degrees" if run.cell.limits.turns[j] else f"{1e3 * off:.3g} mm"
    reason = f"another program: it never begins where the plan does; at the nearest {names[j]} is {shown} away"
    return InputError(reason, file=log.file, line=int(log.lines[nearest]), hint="the recording of this plan's program")


# ----------------------------------------------------------------------------------------------------
# In words.


def path_lines(found: PathFindings, run: RecordedRun, cell: Cell) -> list[str]:
    """What a recording shows of how a program was followed."""
    out = [f"tip off the path: {deviation_words(found.tip, run.lines)}"]
    if found.laid is not None:
        out.append(f"where material is laid: {deviation_words(found.laid, run.lines)}")
    out += joint_lines(found.joints, cell)
    for zone in found.corners:
        scatter = f" ±{1e3 * zone.scatter:.2f}" if zone.count > 1 else ""
        left = f"; the line is left {1e3 * zone.leaves:.2f} mm before" if np.isfinite(zone.leaves) else ""
        out.append(
            f"corners with zones of {1e3 * zone.zone:.3g} mm: {zone.count}, cut by {1e3 * zone.mean:.2f}{scatter} mm, "
            f"at most {1e3 * zone.most:.2f}{left}"
        )
    if not found.corners:
        out.append("corners: not shown, none has a zone and lines on both sides, or the program is not known")
    out.append(f"share of a zone's parabola that is cut: {_estimate_words(found.depth, 1.0, '', 2)}")
    out.append(f"lag that rounds corners: {_estimate_words(found.lag, 1e3, ' ms', 1)}")
    out += [
        f"brakes from {1e3 * each.speed:.0f} mm/s: begins {1e3 * each.time:.0f} ±{1e3 * each.error:.0f} ms and "
        f"{1e3 * each.way:.1f} mm before the stop ({each.count})"
        for each in found.brakes
    ]
    if not found.brakes:
        out.append("braking: not shown, it never stops from a steady speed on lines")
    out.append(f"look-ahead: {_estimate_words(found.ahead, 1.0, ' moves', 1)}")
    return out


def joint_lines(joints: Sequence[PathDeviation], cell: Cell) -> list[str]:
    """How far each joint leaves a path."""
    return [
        f"  {name}: {_joint_words(each, bool(turns))}"
        for name, each, turns in zip(cell.joint_names, joints, cell.limits.turns, strict=True)
    ]


def deviation_words(each: PathDeviation, lines: Array | None = None) -> str:
    """How far a tip leaves a path; lines (s): of the file, where its samples stand."""
    noise = f"noise {1e3 * each.error:.3f} mm"
    if not each.shown:
        return f"not shown, below {1e3 * MOST_SHOWN * each.error:.2f} mm ({noise})"
    where = "" if lines is None else f", in line {int(lines[each.at])}"
    return f"mean {1e3 * each.mean:.3f}, most {1e3 * each.most:.3f} mm ({noise}){where}"


def _joint_words(each: PathDeviation, turns: bool) -> str:
    scale, unit = (float(np.degrees(1.0)), "degrees") if turns else (1e3, "mm")
    if not each.shown:
        return f"not shown, below {scale * MOST_SHOWN * each.error:.3f} {unit}"
    return f"mean {scale * each.mean:.3f}, most {scale * each.most:.3f} {unit} (noise {scale * each.error:.4f})"


def _estimate_words(each: ShownValue, scale: float, unit: str, digits: int) -> str:
    if each.told:
        return f"{scale * each.value:.{digits}f} ±{scale * each.error:.{digits}f}{unit}"
    if each.reason == "at least":
        return f"at least {scale * each.value:.0f}{unit}: it never held the robot back"
    return f"not shown: {each.reason}"
