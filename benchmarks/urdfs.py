"""Public arm URDFs, each added as published: is it read, are all branches found, is a print verified?

python -m benchmarks.urdfs FOLDER [NAME …] [--no-print | --peer-cap]

A row for each .urdf and .xacro file in the folder, or for those whose names begin with a NAME. Branches are compared with
those that Newton's method finds from many random starts, without the closed forms.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from planner.base.arrays import Array
from planner.base.errors import InputError, PlannerError
from planner.base.geometry import wrap_angle
from planner.base.shipped import PROBLEMS
from planner.cell.kinematics.chain import refine
from planner.cell.robot import Robot, chain_of
from planner.robots.adding import added
from planner.robots.files import Cap
from planner.robots.trial import trial

POSTURES, STARTS = 5, 400  # whose poses are solved, and Newton's starts for each
SAME = 1e-5  # rad: postures that differ by less are one
SINGULAR = 0.02  # least singular value of the Jacobian below which branches are about to meet
COLUMNS = "{:<34} {:<18} {:>9} {:>8} {:>9} {:>7} {:>6}  {}"


@dataclass(frozen=True)
class Row:
    """What became of a URDF: kind of its inverse, branches found and missed, greatest error of a pose [m], links that may
    touch, the share of its print at speed (NaN: none was verified), seconds, and a remark."""

    name: str
    kind: str = "-"
    branches: str = "-"
    error: float = np.nan
    touch: int = 0
    at_speed: float = np.nan
    seconds: float = 0.0
    remark: str = ""

    def __str__(self) -> str:
        speed = "-" if np.isnan(self.at_speed) else f"{self.at_speed:.0%}"
        error = "-" if np.isnan(self.error) else f"{self.error:.0e}"
        return COLUMNS.format(
            self.name[:34], self.kind, self.branches, error, self.touch, speed, f"{self.seconds:.0f}", self.remark[:150]
        )


def branches_of(robot: Robot) -> tuple[int, int, float]:
    """Postures that Newton finds for some poses, how many of them the closed form lacks, and its worst pose [m, or 1]."""
    inverse = robot.inverse
    if inverse is None:
        raise LookupError(f"{robot.key} has no inverse kinematics")
    chain = chain_of(robot, np.eye(4), np.eye(4), robot.joint_names, {})
    rng = np.random.default_rng(0)
    q = rng.uniform(-np.pi, np.pi, (POSTURES, len(chain)))
    held = -1 if inverse.redundant_joint is None else inverse.redundant_joint
    T = chain.poses(q)
    solved, ok = inverse.solve(T, None if held < 0 else q[:, held])
    worst = float(np.abs(chain.poses(solved[ok]) - np.repeat(T, ok.sum(axis=1), axis=0)).max(initial=0.0))
    found = lacking = 0
    for i in range(POSTURES):
        seeds = rng.uniform(-np.pi, np.pi, (STARTS, len(chain)))
        if held >= 0:
            seeds[:, held] = q[i, held]
        there = [
            refine(chain.placements, chain.axes, chain.T_last_tip, held, T[i, :3, :3], T[i, :3, 3], seed, 60)
            for seed in seeds
        ]
        distinct: list[Array] = []
        for seen in seeds[there]:
            J = np.delete(chain.jacobians(seen[None])[0], [held] if held >= 0 else [], axis=1)
            clear = np.linalg.svd(J, compute_uv=False)[-1] > SINGULAR
            if clear and all(_apart(seen, other) > SAME for other in distinct):
                distinct.append(seen)
        found += len(distinct)
        lacking += sum(min((_apart(seen, own) for own in solved[i, ok[i]]), default=np.inf) > SAME for seen in distinct)
    return found, lacking, worst


def _apart(a: Array, b: Array) -> float:
    return float(np.abs(wrap_angle(a - b)).max())


def peer_cap() -> Cap:
    """What the problem peer_cap prints, as it is."""
    path = PROBLEMS / "peer_cap.txt"
    rows = np.loadtxt(path)
    return Cap(
        float(np.linalg.norm(rows[0, :3])) * 1e-3, float(np.arccos(rows[:, 5].min())), path.read_text(encoding="utf-8")
    )


def row(path: Path, printing: bool, cap: Cap | None = None) -> Row:
    """Add one robot in a folder of its own."""
    begin = time.perf_counter()
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "robot.yaml"
        try:
            _, made = added(path, file)
        except PlannerError as error:
            words = error.reason if isinstance(error, InputError) else str(error)
            hint = f" ({error.hint})" if isinstance(error, InputError) and error.hint else ""
            return Row(path.stem, seconds=time.perf_counter() - begin, remark=f"refused: {words}{hint}")
        found, lacking, worst = branches_of(made.robot)
        tried = trial(made.robot, file, made.found.outwards, cap) if printing else None
    plan = None if tried is None else tried.plan
    return Row(
        path.stem,
        made.found.kind,
        f"{found - lacking}/{found}",
        worst,
        len(made.touch.may_touch),
        np.nan if plan is None else plan.metrics["at_speed_fraction"],
        time.perf_counter() - begin,
        "" if tried is None or plan is not None else f"no print: {tried.reason}",
    )


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.urdfs", description="Add all URDFs of a folder.")
    parser.add_argument("folder", type=Path, help="where .urdf and .xacro files are")
    parser.add_argument("names", nargs="*", help="only files whose names begin like this")
    parser.add_argument("--no-print", action="store_true", help="plan nothing")
    parser.add_argument(
        "--peer-cap", action="store_true", help="print what the problem peer_cap does, whatever the reach"
    )
    options = parser.parse_args(arguments)
    cap = peer_cap() if options.peer_cap else None
    paths = sorted(path for path in options.folder.iterdir() if path.suffix in (".urdf", ".xacro"))
    if options.names:
        paths = [path for path in paths if path.name.startswith(tuple(options.names))]
    print(COLUMNS.format("URDF", "inverse", "branches", "error", "touching", "at speed", "s", ""))
    rows = []
    for path in paths:
        rows.append(row(path, not options.no_print, cap))
        print(rows[-1], flush=True)
    read = [each for each in rows if each.kind != "-"]
    complete = sum(len(set(each.branches.split("/"))) == 1 for each in read)
    printed = sum(not np.isnan(each.at_speed) for each in read)
    verified = "" if options.no_print else f", {printed} print"
    print(f"{len(read)} of {len(rows)} read, {complete} with all branches{verified}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
