"""Copies of robots' files with the limits that a recording has shown, and their source."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from planner.base.arrays import Array
from planner.base.errors import InputError, OutputError
from planner.base.files import write_new
from planner.base.results import digest
from planner.base.shipped import ROBOTS
from planner.cell.cell import Cell
from planner.cell.robot import Robot, read_robot
from planner.cell.robot_file import RobotFile, read_robot_file
from planner.feedback.identify_delay import JointDelay
from planner.feedback.identify_findings import PathFindings
from planner.feedback.identify_fit import QUANTITIES, IdentifiedLimit, JointFit
from planner.problem import Problem
from planner.problem.rewrite import Value, with_values

FIELDS = ("speed_rad_s", "acceleration_rad_s2", "jerk_rad_s3")  # of a robot's file, in the order of QUANTITIES
DIGITS = 4  # significant digits written: more than any recording resolves


@dataclass(frozen=True)
class MeasuredRobot:
    """One robot of a cell: its file, its role in the copy's name (may be empty), and for each of its joints (k, in
    order) the index among the cell's joints, or None if it does not move there."""

    path: Path
    robot: Robot
    does: str
    joints: tuple[int | None, ...]

    def target(self, folder: Path) -> Path:
        """The path of the copy in a folder."""
        return folder / f"{self.path.stem.removesuffix('_measured')}_{self.does}measured.yaml"


def robots_of(problem: Problem, cell: Cell) -> list[MeasuredRobot]:
    """The robots of a cell: arm, its carrier, and the part's positioner; two of the same model get separate files."""
    spec, na = problem.cell, len(cell.arm)
    names = {name: cell.own.start + k for k, name in enumerate(cell.arm.names[cell.own])}
    out = [_measured(spec.arm, "", names)]
    if spec.carrier is not None and cell.carrier is not None and cell.carrier.free:
        out.append(_measured(spec.carrier.robot, "", {name: k for k, name in enumerate(cell.carrier.free)}))
    if spec.positioner is not None:
        holder = _measured(spec.positioner.robot, "", {name: na + k for k, name in enumerate(cell.holder.names)})
        taken = {robot.target(Path()) for robot in out}
        out.append(replace(holder, does="positioner_") if holder.target(Path()) in taken else holder)
    return out


def _measured(named: str | Path, does: str, joints: Mapping[str, int]) -> MeasuredRobot:
    path = named if isinstance(named, Path) else ROBOTS / f"{named}.yaml"
    robot = read_robot(path)
    return MeasuredRobot(path, robot, does, tuple(joints.get(name) for name in robot.joint_names))


def check_targets(robots: Sequence[MeasuredRobot], folder: Path) -> None:
    """Raises OutputError if a copy already exists."""
    for robot in robots:
        if robot.target(folder).exists():
            raise OutputError(f"{robot.target(folder)} is there already, and stays as it is: name a folder with --out")


def usable(found: IdentifiedLimit) -> bool:
    """Whether a limit is written: the recording shows it, and it is the robot's own rather than set by the program."""
    return found.told and not found.as_asked


def write_measured(
    robots: Sequence[MeasuredRobot],
    fits: Sequence[JointFit],
    delays: Mapping[int, JointDelay],
    source: Path,
    folder: Path,
) -> list[Path]:
    """Write a copy of each robot's file for which a limit was found; returns their paths.

    source: the recording. Raises OutputError if a file already exists or cannot be written.
    """
    by_joint = {fit.joint: fit for fit in fits}
    written: list[Path] = []
    try:
        for robot in robots:
            own = [None if j is None else by_joint.get(j) for j in robot.joints]
            if not any(fit is not None and any(map(usable, fit.limits)) for fit in own):
                continue
            text = measured_text(robot, own, delays, source, folder)
            target = robot.target(folder)
            folder.mkdir(parents=True, exist_ok=True)
            write_new(target, text)
            written.append(target)
            read_robot(target)  # raises InputError for values that no robot may have
    except (OSError, InputError) as error:
        for path in written:
            path.unlink(missing_ok=True)
        if isinstance(error, OSError):
            raise OutputError(f"cannot write into {folder}: {error.strerror}") from error
        raise
    return written


def controller_values(found: PathFindings) -> dict[str, float]:
    """What a run has shown of the controller, as values for the key `controller` of a robot's file."""
    out: dict[str, float] = {}
    if found.lag.told:
        out["lag_ms"] = float(f"{1e3 * found.lag.value:.3g}")
    if found.depth.told:
        out["zone_share"] = float(f"{found.depth.value:.3g}")
    if found.brakes:
        # the model's ramps grow with the cube root of the speed
        ramps = np.array([each.time * each.speed ** (-1.0 / 3.0) for each in found.brakes])
        weights = np.array([each.error * each.speed ** (-1.0 / 3.0) for each in found.brakes]) ** -2.0
        out["ramp_ms"] = float(f"{1e3 * np.average(ramps, weights=weights):.3g}")
    if found.ahead.told:
        out["ahead_moves"] = float(max(round(found.ahead.value), 1))
    return out


def write_controller(
    robot: MeasuredRobot, found: PathFindings, about: Sequence[str], source: Path, folder: Path
) -> Path:
    """Write a copy of an arm's file that adds what a run has shown of its controller; returns its path.

    about   lines for the comment at the top;  source: the recording
    Raises OutputError if a file already exists or cannot be written.
    """
    file, text = read_robot_file(robot.path), _read(robot.path)
    told = f"controller from {source.name}"
    # keep the file's value of whatever the run does not show
    known = {str(name): float(value) for name, value in file.data.get("controller", {}).items()}
    changes: dict[str, Value] = {
        "controller": known | controller_values(found),
        "measured": f"{told}; before: {robot.robot.measured}" if robot.robot.measured else told,
    }
    urdf = file.data["urdf"]
    if isinstance(urdf, str) and not Path(urdf).is_absolute():
        changes["urdf"] = Path(os.path.relpath(file.urdf().resolve(), folder.resolve())).as_posix()
    lines = [
        f"# Its controller, measured by `beadwise identify` from {source.name} (SHA-256 {digest_of(source)[:16]}):",
        *(f"# {each}" for each in about),
    ]
    target = robot.target(folder)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        write_new(target, "\n".join(lines) + "\n" + with_values(text, changes))
        read_robot(target)  # raises InputError for values that no robot may have
    except OSError as error:
        raise OutputError(f"cannot write {target}: {error.strerror}") from error
    except InputError:
        target.unlink()
        raise
    return target


def digest_of(source: Path) -> str:
    """SHA-256 of a recording, in hexadecimal; for a bag that is a folder, of its files' names and digests, in order."""
    if not source.is_dir():
        return digest(source)
    own = hashlib.sha256()
    for path in sorted(each for each in source.iterdir() if each.is_file()):
        own.update(f"{path.name} {digest(path)}\n".encode())
    return own.hexdigest()


def measured_text(
    robot: MeasuredRobot,
    fits: Sequence[JointFit | None],
    delays: Mapping[int, JointDelay],
    source: Path,
    folder: Path,
) -> str:
    """The text of a copy in a folder: the file with the measured limits; comments and everything else are unchanged."""
    file = read_robot_file(robot.path)
    text = _read(robot.path)
    changes, told = _changes(robot, file, fits, source, folder)
    lines = [
        f"# Measured by `beadwise identify` from {source.name} (SHA-256 {digest_of(source)[:16]}), standard errors in brackets;",
        "# what is not named here is as it was in the file of which this is a copy.",
        *(
            f"# {name}: {_joint_words(fit, delays.get(fit.joint))}"
            for name, fit in zip(robot.robot.joint_names, fits, strict=True)
            if fit is not None
        ),
    ]
    line = file.source.line((FIELDS[1],))
    if line is None:
        raise InputError(f"{FIELDS[1]} has no line of its own", file=robot.path)
    # from bottom to top, so that line numbers stay valid until they are used
    rows = text.splitlines(keepends=True)
    end = "\r\n" if rows[0].endswith("\r\n") else "\n"
    rows.insert(line - 1, end.join([*lines, ""]))
    return with_values("".join(rows), {**changes, "measured": told})


def _changes(
    robot: MeasuredRobot, file: RobotFile, fits: Sequence[JointFit | None], source: Path, folder: Path
) -> tuple[dict[str, Value], str]:
    """The changed fields of the copy with their values, and a description of which limits were measured."""
    changes: dict[str, Value] = {}
    told: list[str] = []
    assumed = list(file.texts("assumed"))
    old: tuple[Array, ...] = (robot.robot.model.velocityLimit, robot.robot.acceleration, robot.robot.jerk)
    for k, (field, before) in enumerate(zip(FIELDS, old, strict=True)):
        values = [float(f"{value:.{DIGITS + 2}g}") for value in before]
        of = []
        for i, fit in enumerate(fits):
            if fit is not None and usable(fit.limits[k]):
                values[i] = float(f"{fit.limits[k].value:.{DIGITS}g}")
                of.append(robot.robot.joint_names[i])
        if not of:
            continue
        changes[field] = values
        told.append(f"{field} of {', '.join(of) if len(of) < len(fits) else 'all joints'}")
        if len(of) == len(fits) and field in assumed:
            assumed.remove(field)
    if "assumed" in file.data:
        changes["assumed"] = assumed
    urdf = file.data["urdf"]
    if isinstance(urdf, str) and not Path(urdf).is_absolute():
        changes["urdf"] = Path(os.path.relpath(file.urdf().resolve(), folder.resolve())).as_posix()
    earlier = f"; before: {robot.robot.measured}" if robot.robot.measured else ""
    return changes, f"{'; '.join(told)}; from {source.name}{earlier}"


def _joint_words(fit: JointFit, delay: JointDelay | None) -> str:
    """What one joint's moves show, in a line."""
    parts = [f"{what} {_limit_words(found)}" for what, found in zip(QUANTITIES, fit.limits, strict=True)]
    if fit.averaged is not None:
        time, error = fit.averaged
        parts.append(f"smoothed by a mean over {1e3 * time:.3g} ({1e3 * error:.2g}) ms, jerk is acceleration over that")
    if delay is not None:
        parts.append(
            f"follows {1e3 * delay.total:.1f} ms late: delay {1e3 * delay.delay:.1f} ({1e3 * delay.delay_error:.1f}) ms, "
            f"lag {1e3 * delay.lag:.1f} ({1e3 * delay.lag_error:.1f}) ms"
        )
    return f"{', '.join(parts)}; {fit.moves} moves"


def _limit_words(found: IdentifiedLimit) -> str:
    if not found.told:
        return f"not reached, at least {found.value:.3g}"
    words = f"{found.value:.{DIGITS}g} ({100.0 * found.error / found.value:.2g} %)"
    return f"{words}, as asked" if found.as_asked else words


def _read(path: Path) -> str:
    try:
        with path.open(encoding="utf-8-sig", newline="") as stream:
            return stream.read()
    except (OSError, UnicodeDecodeError) as error:
        raise InputError("cannot be read any more", file=path) from error
