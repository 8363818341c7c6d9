"""Whether files are those a plan was verified with; edited ones are played before a robot runs them."""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from planner.base.arrays import Array
from planner.base.errors import InputError
from planner.base.nearest import distance_to_polyline
from planner.base.results import digest, listed
from planner.export.program import RobotProgram
from planner.export.rapid.reader import read_rapid_files

if TYPE_CHECKING:
    from planner.cell.cell import Cell

PLAN, TABLE = "plan.json", "trajectory.csv"
LARGEST_PLAN = 256 << 20  # bytes
EDITED = "--edited"
WITHIN = 0.02  # relative excess of speeds and accelerations that resampling at EGM's rate may cause
ROUNDING = 1e-6  # rad or m beyond a joint's range that count as rounding
Say = Callable[[str], None]


def add_edited(parser: argparse.ArgumentParser) -> None:
    """Add the option for running edited files to a command that runs result files."""
    parser.add_argument(
        EDITED,
        metavar="YAML",
        help="run files even if they were changed since; they are played first in this problem's cell",
    )


def read_json(path: Path) -> dict[str, Any]:
    """Read plan.json. Raises InputError if it is missing or invalid."""
    try:
        if path.stat().st_size > LARGEST_PLAN:
            raise InputError(f"larger than {LARGEST_PLAN >> 20} MB", file=path)
        data = json.loads(path.read_text("utf-8"))
    except FileNotFoundError as error:
        raise InputError("no plan here", file=path, hint="solve a problem first: python -m planner.solve") from error
    except (OSError, ValueError, RecursionError) as error:
        raise InputError(f"cannot be read: {error}", file=path) from error
    if not isinstance(data, dict):
        raise InputError("not a plan", file=path)
    return data


def differing(folder: Path, names: Iterable[str]) -> dict[str, str]:
    """Those of the named files of a folder that are not as written with its plan → how they differ.

    plan.json itself is compared with the folder's manifest, if there is one. Raises InputError if there is no plan, or
    one that does not state the files written with it.
    """
    path = folder / PLAN
    written = read_json(path).get("files")
    if not isinstance(written, dict):
        raise InputError("does not say which files were written with it", file=path, hint="solve the problem again")
    own = listed(folder).get(PLAN)
    found = {} if own is None or digest(path) == own.sha256 else {PLAN: "was changed"}
    for name in names:
        if name not in written:
            found[name] = "was not written with the plan"
        elif not (folder / name).is_file():
            found[name] = "is missing"
        elif digest(folder / name) != written[name]:
            found[name] = "was changed"
    return found


def program_as_written(folder: Path, names: Iterable[str], edited: str | None, say: Say) -> None:
    """Raises InputError unless the files of a program are those that were verified, or were edited and can be played.

    edited  the problem in whose cell edited files are played; None if files may not differ
    say     is called with what differs, and with the result of playing: deviation from the plan, and duration
    """
    names = list(names)
    found = differing(folder, names)
    if not found:
        return
    cell = _may_differ(folder, found, edited, say)
    modules = {name: _ascii(folder / name) for name in names if name.lower().endswith(".mod")}
    _play(read_rapid_files(modules), cell.as_counted, folder, found, say)


def table_as_written(folder: Path, edited: str | None, say: Say) -> Cell | None:
    """Raises InputError unless trajectory.csv is the one that was verified, or may be edited: then returns the cell
    whose joint limits it must keep, see `within_limits`."""
    found = differing(folder, [TABLE])
    return _may_differ(folder, found, edited, say) if found else None


def within_limits(cell: Cell, q: Array, period: float, say: Say) -> None:
    """Raises InputError if joints q (n, m), one row per period [s], exceed a cell's limits; reports how near they come.

    q has the cell's joints only, without axes that the cell holds still.
    """
    limits = cell.limits
    _within_range(cell, q, period * np.arange(len(q), dtype=np.float64))
    speed, bend = np.abs(np.diff(q, axis=0)) / period, np.abs(np.diff(q, 2, axis=0)) / period**2
    for what, share in (("speed", speed / limits.velocity), ("acceleration", bend / limits.acceleration)):
        row, joint = np.unravel_index(int(np.argmax(share)), share.shape)
        if not share[row, joint] <= 1.0 + WITHIN:
            raise InputError(
                f"{cell.joint_names[joint]} is at {share[row, joint]:.2f} times its {what} at {row * period:.3f} s"
            )
    say(
        f"played: joints within range, at most {100 * np.max(speed / limits.velocity, initial=0.0):.0f} % of their speed"
    )


def _within_range(cell: Cell, q: Array, times: Array) -> None:
    """Raises InputError if a joint (n, m), at times (n) [s], leaves its range."""
    beyond = np.maximum(cell.limits.q_min - q, q - cell.limits.q_max)
    row, joint = np.unravel_index(int(np.argmax(beyond)), beyond.shape)
    if not beyond[row, joint] <= ROUNDING:
        raise InputError(f"{cell.joint_names[joint]} leaves its range at {times[row]:.3f} s")


def _may_differ(folder: Path, found: Mapping[str, str], edited: str | None, say: Say) -> Cell:
    """The cell in which files that differ are played. Raises InputError if they may not differ."""
    words = "; ".join(f"{name} {how}" for name, how in found.items())
    if edited is None:
        raise InputError(
            f"not the files that were verified: {words}",
            file=folder,
            hint=f"solve the problem again; {EDITED} PROBLEM plays them as they are, and runs them then",
        )
    from planner.cell.cell import build_cell  # here, as importing the planner takes seconds
    from planner.problem import load_problem

    say(f"WARNING: not verified: {words}")
    return build_cell(load_problem(edited))


def _play(program: RobotProgram, cell: Cell, folder: Path, found: Mapping[str, str], say: Say) -> None:
    """Play a program. Raises InputError if it cannot be played; reports its distance from the plan's motion, if that is
    still as written."""
    from planner.export.player.play import play  # here, as importing the planner takes seconds

    played = play(program, cell)
    if played.strays:
        raise InputError(f"{len(played.strays)} targets name a configuration other than the one the arm arrives in")
    _within_range(cell, played.q, played.leave)
    say(f"played: {played.duration:.1f} s, {len(played.target)} moves, no joint beyond its range")
    if TABLE in found or differing(folder, [TABLE]):
        say(f"{TABLE} no longer belongs to the plan: how far the program is from it is unknown")
        return
    planned = np.loadtxt(folder / TABLE, delimiter=",", skiprows=1, usecols=_columns(folder / TABLE, ("x", "y", "z")))
    times = np.linspace(0.0, played.duration, max(2, 10 * len(played.target)))
    tip = played.at(times).position
    off = distance_to_polyline(tip, planned * 1e-3)
    worst = int(np.argmax(off))
    say(
        f"the tip is at most {1e3 * off[worst]:.2f} mm off the planned path, at {times[worst]:.1f} s of the program; "
        "that is from the path's nearest point, which may be on another pass"
    )


def _columns(path: Path, names: Iterable[str]) -> list[int]:
    with path.open(encoding="ascii") as stream:
        head = stream.readline().strip().split(",")
    return [head.index(f"{name}_mm") for name in names]


def _ascii(path: Path) -> str:
    try:
        return path.read_text("ascii")
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"cannot be read: {error}", file=path) from error
