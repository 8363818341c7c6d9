"""One mesh as a substrate or as a volume: its row written as JSON; benchmarks.meshes starts it.

python -m benchmarks.mesh_runs FILE JOB      JOB: the fields of a `MeshJob` as JSON

The amounts requested by a pattern and laid are counted here, independently of the planner's own figures.
"""

from __future__ import annotations

import json
import re
import sys
import time
import traceback
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
import trimesh

from benchmarks.own_process import end_with_parent
from planner.base.errors import InputError, PlannerError, Refusal
from planner.motion.extrusion import bead_area
from planner.planning.pipeline import solve
from planner.problem import Problem, load_problem
from planner.problem.drawings import PatternSpec
from planner.problem.layers import SolidSpec
from planner.problem.mesh_files import read_corners
from planner.problem.mesh_repair import mend
from planner.toolpath.bead import Toolpath
from planner.toolpath.build import build_toolpath
from planner.toolpath.plane_paths import length
from planner.toolpath.substrate.patterns import pattern

Row = dict[str, str | float | int | None]

KINDS = ("substrate", "volume")
COLUMNS = (
    "file", "as", "verdict", "reason", "facets", "scale", "asked", "printed", "told", "silent", "at_speed",
    "notes", "seconds",
)  # fmt: skip
CLOSES = re.compile(r"close_holes_mm: ([\d.]+) closes")  # what the refusal of an open body advises
NO_TOP = ("layers.upper", "layers.tilt_deg")  # what the refusal of a body says whose top is no layer
LINES_MM = 4.0  # apart
WIDTH_MM, HEIGHT_MM = 1.5, 1.0  # of beads that fill a mesh
COARSE = ("resolve.rung_mm=8", "resolve.roll_step_deg=20")


@dataclass(frozen=True)
class MeshJob:
    """A mesh, taken for a substrate or a volume, made `size` [mm] large along its longest side, on a problem's cell.

    cover  share of its sides that the pattern covers
    """

    file: str
    name: str
    kind: str
    cell: str
    size: float
    leave_out: float
    plan: bool
    cover: float = 0.7


def problem_of(job: MeshJob, level: bool = False, holes: float | None = None) -> tuple[Problem, Row]:
    """The problem, and of the mesh how many facets it has and by how much it is enlarged.

    level: with level layers; holes: how wide ones are closed [mm]
    """
    corners = read_corners(Path(job.file), partial(InputError, file=Path(job.file))) * 1e3
    low, high = corners.min(axis=(0, 1)), corners.max(axis=(0, 1))
    scale = float(f"{job.size / float((high - low).max()):.6g}")
    size = scale * (high - low)
    origin = -scale * np.array([*(0.5 * (low + high))[:2], low[2]])
    mesh = {"scale": scale, "origin_mm": [round(float(each), 6) for each in origin]}
    share = {"leave_out_share": job.leave_out}
    if job.kind == "substrate":
        sides = [max(round(job.cover * float(side), 3), 0.1) for side in size[:2]]
        source = {"pattern": "zigzag", "cell_mm": LINES_MM, "size_mm": sides, **share}
        layers: dict[str, object] = {"source": source, "project": "z", "count": 1, "height_mm": 0.5}
        settings = [f"part={json.dumps({'mesh': {'file': job.file, **mesh}})}", f"layers={json.dumps(layers)}"]
    else:
        closing = {} if holes is None else {"close_holes_mm": holes}
        layers = {"source": {"mesh": job.file, **mesh, **share, **closing}, "height_mm": HEIGHT_MM}
        if level:
            layers["upper"] = {"z_mm": round(float(size[2]), 3)}
        settings = ["part=null", f"layers={json.dumps(layers)}", f"process.bead={{width_mm: {WIDTH_MM}}}"]
    facts: Row = {"facets": len(corners), "scale": scale}
    return load_problem(job.cell, (*settings, *COARSE)), facts


def asked_of(problem: Problem, job: MeshJob) -> float:
    """How much is to be printed: the pattern's length [m], or the body's volume [m^3]."""
    source = problem.layers.source
    if isinstance(source, PatternSpec):
        beside = problem.process.bead.width + 1.8 * problem.process.corner_tolerance
        return sum(length(path.points) for path in pattern(source, beside, problem.process.chord_tolerance))
    corners = read_corners(Path(job.file), partial(InputError, file=Path(job.file)))
    mesh = trimesh.Trimesh(corners.reshape(-1, 3), np.arange(corners.size // 3).reshape(-1, 3))
    if not mesh.is_watertight and isinstance(
        source, SolidSpec
    ):  # how a hole is closed is the planner's choice, and told
        widest = problem.process.bead.width if source.holes is None else source.holes
        a, b, c = mend(source.scale * corners, widest).corners.transpose(1, 0, 2)
        return float((a * np.cross(b, c)).sum() / 6.0)
    return float(mesh.volume * source.scale**3)  # type: ignore[union-attr]


def printed_of(problem: Problem, toolpath: Toolpath) -> float:
    """How much of that is laid: in the plane the drawn length of all beads, or the volume that they hold."""
    if isinstance(problem.layers.source, PatternSpec):
        return sum(length(bead.source[:, :2]) for bead in toolpath.beads)
    return float(sum(np.trapezoid(bead_area(bead, problem.process), bead.s) for bead in toolpath.beads))


def told_of(notes: Sequence[str]) -> float:
    """The share that is said to be left out, or not to be filled."""
    held = [re.search(r"beads hold ([\d.]+)% of the volume", note) for note in notes]
    if any(held):
        return 1.0 - sum(0.01 * float(each.group(1)) for each in held if each)
    found = [re.search(r"([\d.]+)% of the (?:length|volume)", note) for note in notes]
    return sum(0.01 * float(each.group(1)) for each in found if each)


def laid_of(job: MeshJob) -> tuple[Problem, Toolpath, Row]:
    """The problem and its toolpath, and facts: a body's open skin is closed, and its layers are level, if the refusal says so.

    Raises InputError for what is refused all the same.
    """
    level, holes = False, None
    while True:
        problem, facts = problem_of(job, level, holes)
        kind = (
            job.kind
            + (", level layers" if level else "")
            + ("" if holes is None else f", holes to {holes:g} mm closed")
        )
        try:
            return problem, build_toolpath(problem), facts | {"as": kind}
        except InputError as error:
            closes = CLOSES.search(str(error))
            if job.kind == "volume" and holes is None and closes:
                holes = float(closes.group(1))
            elif job.kind == "volume" and not level and any(each in str(error) for each in NO_TOP):
                level = True
            else:
                raise


def row_of(job: MeshJob) -> Row:
    """The row of a mesh, whatever becomes of it."""
    begun = time.monotonic()
    row: Row = dict.fromkeys(COLUMNS) | {"file": job.name, "as": job.kind}
    try:
        problem, toolpath, facts = laid_of(job)
        row |= facts
        asked, printed, told = asked_of(problem, job), printed_of(problem, toolpath), told_of(toolpath.notes)
        row |= {"asked": asked, "printed": printed, "told": told, "silent": 1.0 - printed / asked - told}
        row |= {"verdict": "laid", "notes": " | ".join(toolpath.notes)}
        if job.plan:
            plan = solve(problem, baseline=False)
            failed = ", ".join(check.name for check in plan.checks if not check.ok)
            row |= {"verdict": "verified" if plan.verified else "unverified", "reason": failed or None}
            row |= {"at_speed": plan.metrics["at_speed_fraction"]}
    except Refusal as error:
        row |= {"verdict": "no plan", "reason": str(error)}
    except PlannerError as error:
        row |= {"verdict": "refused", "reason": str(error)}
    except Exception as error:  # whatever it is, it is a row, and the other meshes go on
        place = traceback.extract_tb(error.__traceback__)[-1]
        row |= {"verdict": "crashed", "reason": f"{error!r} in {Path(place.filename).name}, line {place.lineno}"}
    return row | {"seconds": time.monotonic() - begun}


def main(arguments: Sequence[str]) -> int:
    """What benchmarks.meshes starts; returns the exit code."""
    end_with_parent()
    file, text = arguments
    Path(file).write_text(json.dumps(row_of(MeshJob(**json.loads(text)))), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
