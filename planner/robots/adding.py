"""Make a robot's file from its URDF or from a Pinocchio model: what `beadwise robots add` does, also for Python."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np

from planner.base.arguments import as_one_of, as_path
from planner.base.errors import InputError, OutputError, nearest_name
from planner.base.extras import missing_extra
from planner.base.geometry import wrap_angle
from planner.cell.robot import Robot, read_robot
from planner.cell.robot_file import read_robot_file
from planner.cell.urdf import Urdf, parse_urdf, read_urdf
from planner.problem.settings import LANGUAGE_NAMES
from planner.robots.face import DEEP, beneath, depth, frame_at_the_end, mounted
from planner.robots.files import robot_text, trial_files
from planner.robots.survey import Survey, expanded, key_of, survey
from planner.robots.touching import NOTHING, Touching, touching

if TYPE_CHECKING:
    import pinocchio

_TRIED, _SAME = 500, 1e-6  # random postures; rad within which a posture is found again
NO_ARGUMENTS: Mapping[str, str] = MappingProxyType({})


@dataclass(frozen=True)
class Added:
    """A robot whose file was written: what was found about it and about its bodies, and the robot as read back."""

    found: Survey
    touch: Touching
    robot: Robot


def add_robot(
    urdf: str | Path | pinocchio.Model,
    file: str | Path | None = None,
    *,
    tip: str | None = None,
    language: str | None = None,
    bodies: pinocchio.GeometryModel | None = None,
    arguments: Mapping[str, str] | None = None,
) -> Path:
    """Make a robot's file from its URDF and return where it is, for `load(problem, {"cell.arm": ...})`.

    Args:
        urdf: A URDF or xacro file, or a Pinocchio model, whose URDF is written next to the robot's file.
        file: The robot's file, such as my_robot.yaml; by default, it is named after the robot, in the current folder. A
            file that exists already is kept if it belongs to this URDF: the user may have changed what it assumes.
        tip: Link of the flange, if it is not found automatically.
        language: What its controller is programmed in.
        bodies: Collision shapes of a Pinocchio model; without them, its links collide with nothing.
        arguments: Arguments of a xacro file, by name.

    Returns:
        Path of the robot's file.

    Raises:
        InputError: If the URDF cannot be planned with.
        OutputError: If files cannot be written, or if the file exists and belongs to another robot.
    """
    target = None if file is None else as_path(file, "file")
    if tip is not None:
        as_one_of(tip, str, "tip", "the name of a link")
    if target is not None and target.suffix not in (".yaml", ".yml"):
        raise InputError(f"{target} is not a name for a robot file", field="file", hint="for example my_robot.yaml")
    if language is not None and language not in LANGUAGE_NAMES:
        near = nearest_name(str(language), LANGUAGE_NAMES)
        hint = f"did you mean {near}?" if near else f"languages: {', '.join(LANGUAGE_NAMES)}"
        raise InputError(f"there is no language {language!r}", field="language", hint=hint)
    if isinstance(urdf, (str, Path)):
        if bodies is not None:
            raise InputError("a URDF has bodies of its own", field="bodies", hint="leave it out")
        source, fresh = as_path(urdf, "urdf"), False
        given = arguments or NO_ARGUMENTS
        _check_arguments(source, given)
    else:
        from planner.robots.from_model import written_urdf

        if arguments:
            raise InputError("only xacro files have arguments", field="arguments", hint="leave them out")
        given = NO_ARGUMENTS
        source, fresh = written_urdf(urdf, bodies, target)
    if target is not None and target.exists():
        if read_robot_file(target).urdf().resolve() != _urdf_of(source, given).resolve():
            raise OutputError(f"{target} is there already, and describes another robot: choose another name")
        return target
    try:
        return added(source, target, tip, language, given)[0]
    except ImportError as error:
        raise missing_extra(error, source.name) or error from None
    except (InputError, OutputError):
        if fresh:
            source.unlink(missing_ok=True)
        raise


def added(
    urdf: Path,
    file: Path | None,
    tip: str | None = None,
    language: str | None = None,
    arguments: Mapping[str, str] = NO_ARGUMENTS,
    tried: bool = False,
) -> tuple[Path, Added]:
    """Write a robot's file from its URDF and return its path; by default, it is named after the robot, in this folder.

    tried: whether a trial print will be written next to it, so that none may exist yet

    Raises InputError for a URDF that cannot be planned with, and OutputError if the file cannot be written; then
    nothing is written.
    """
    _check_arguments(urdf, arguments)
    read, text = _read(urdf, arguments)
    found = survey(read, tip)
    file = file or Path(f"{key_of(found.name)}.yaml")
    if not file.parent.is_dir():
        raise OutputError(f"there is no folder {file.parent}")
    if file.exists():
        raise OutputError(f"{file} is there already, and stays as it is: --out gives another name")
    for there in trial_files(file) if tried else ():
        if there.exists():
            reason = f"{there} is there already, and stays as it is: --out gives another name, --no-print plans none"
            raise OutputError(reason)
    source = urdf
    if text is not None:
        # next to the xacro file, so that its meshes are found
        source = _urdf_of(urdf, arguments)
        if source.exists() and source.read_text(encoding="utf-8") != text:
            raise OutputError(
                f"{source} is there already, and differs from what xacro makes: remove it, or add that file instead"
            )
    made, whole = text is not None and not source.exists(), None
    # Other jobs that add the same robot trust a file that exists: until it is complete, it has another name.
    draft = file.with_name(f".{os.getpid()}_{file.name}")
    try:
        if text is not None:
            source.write_text(text, encoding="utf-8")
        # at first without pieces or pairs that may touch: its bodies are examined once the robot is read
        draft.write_text(robot_text(found, NOTHING, source, file, language), encoding="utf-8")
        robot = read_robot(draft)
        if tip is None and (end := frame_at_the_end(read, robot, found.outwards)) is not None:
            found = survey(read, end, named=False)
            draft.write_text(robot_text(found, NOTHING, source, file, language), encoding="utf-8")
            robot = read_robot(draft)
        found = replace(found, notes=(*found.notes, *_notes(read, robot, found)))
        touch = touching(read, robot)
        draft.write_text(robot_text(found, touch, source, file, language), encoding="utf-8")
        robot = replace(read_robot(draft), key=file.stem)
        os.replace(draft, file)
        whole = Added(found, touch, robot)
    except OSError as error:
        where = file if str(error.filename) == str(draft) else error.filename
        raise OutputError(f"cannot write {where}: {error.strerror}") from error
    finally:
        draft.unlink(missing_ok=True)
        if whole is None and made:
            source.unlink(missing_ok=True)
    return file, whole


def _notes(urdf: Urdf, robot: Robot, found: Survey) -> list[str]:
    """Notes on an arm's bodies and postures, for the user."""
    notes, tools = [], mounted(urdf, robot)
    if (deep := depth(robot, found.outwards, tools)) > DEEP:
        notes.append(
            f"{found.tip}'s body reaches {deep * 1e3:.0f} mm beyond its frame: nozzle.tip_mm is measured from the frame"
        )
    if tools:
        notes.append(
            f"{', '.join(tools)} on the flange: counted as parts of the last link; a print head belongs in "
            "cell.nozzle.head of problems, and is left out here with `without`"
        )
    if below := beneath(urdf, robot):
        notes.append(
            f"{', '.join(below)} beneath the arm: counted as its foot, on which nothing can be printed; a mesh counts as its hull, which is not "
            "checked if it encloses the arm in every posture: give it as cell.fixtures of problems, and leave it out with `without`"
        )
    if found.roughly:
        notes.append(
            "axes of its shoulder or wrist do not meet: postures are found from those of an arm where they meet, and "
            f"{_missed(robot):.0%} of random ones are missed"
        )
    return notes


def _missed(robot: Robot) -> float:
    """Share of random postures that the inverse kinematics does not recover from their poses."""
    inverse, model = robot.inverse, robot.model
    if inverse is None or inverse.redundant_joint is None:
        return 0.0
    low, high = np.maximum(model.lowerPositionLimit, -np.pi), np.minimum(model.upperPositionLimit, np.pi)
    q = np.random.default_rng(0).uniform(low, high, (_TRIED, len(low)))
    solved, ok = inverse.solve(inverse.poses(q), q[:, inverse.redundant_joint])
    away = np.abs(wrap_angle(solved - q[:, None])).max(axis=2)
    return 1.0 - float((ok & (away < _SAME)).any(axis=1).mean())


def _check_arguments(path: Path, arguments: Mapping[str, str]) -> None:
    """Raise InputError for arguments of any file but a xacro file, and for values that are not strings."""
    if arguments and path.suffix != ".xacro":
        raise InputError("only xacro files have arguments", file=path, field="arguments", hint="leave them out")
    for name, value in arguments.items():
        as_one_of(value, str, f"arguments[{name!r}]", "text, as xacro expects it")


def _urdf_of(path: Path, arguments: Mapping[str, str]) -> Path:
    """Path of the URDF that a xacro file makes: next to it, so that meshes are found; one per choice of arguments."""
    if path.suffix != ".xacro":
        return path
    chosen = [key_of(value) for value in dict.fromkeys(arguments.values())]
    return path.with_name("_".join([path.stem.removesuffix(".urdf"), *chosen]) + ".urdf")


def _read(path: Path, arguments: Mapping[str, str]) -> tuple[Urdf, str | None]:
    """The URDF, and its text if xacro made it."""
    if path.suffix != ".xacro":
        return read_urdf(path), None
    if not path.is_file():
        raise InputError("there is no such file", file=path)
    text = expanded(path, arguments)
    return parse_urdf(text.encode(), _urdf_of(path, arguments)), text
