"""A small print that plans in about a second, for tests that need a solved plan or a problem file to spoil.

Three short paths on Pollard's cylinder: a zig-zag with sharp corners, a closed curve, and a wave.
"""

from __future__ import annotations

import tempfile
from dataclasses import replace
from functools import cache
from pathlib import Path

from planner.cell.cell import Cell
from planner.collision.print_body import PrintBody, print_body, standing
from planner.collision.scene import obstacles_of
from planner.plan import Plan
from planner.planning.options import DEFAULT_DT
from planner.planning.pipeline import solve, trajectory_of
from planner.problem import Problem, load_problem
from planner.toolpath.bead import Toolpath
from planner.verify.verdict import verify

SVG = """\
<svg xmlns="http://www.w3.org/2000/svg" width="30mm" height="24mm" viewBox="0 0 30 24">
  <path id="zigzag" d="M1,1 L11,1 L11,9 L20,4"/>
  <circle id="ring" cx="7" cy="16" r="5"/>
  <path id="wave" d="M15,18 C18,10 22,10 24,16 S28,20 29,12"/>
</svg>
"""

YAML = """\
name: small
cell:
  arm: irb140
  nozzle: {tip_mm: [-44.51, 9.9, 113.95], axis: [0, 0, 1], diameter_mm: 0.6}
  home_deg: [30, 20, 30, 90, -80, 60]
  positioner:
    robot: irbp_a250
    origin_mm: [633.5, 9.87, 380]
    free: [rotation]
part:
  cylinder: {radius_mm: 34, height_mm: 100, centre_mm: [31.4, 37]}
layers:
  source: {svg: small.svg, width_mm: 30}
  wrap: cylinder
  count: 1
  height_mm: 0.5
process:
  speed_mm_s: 40
  travel_speed_mm_s: 200
  bead: {width_mm: 0.6, height_mm: 0.5}
resolve: {roll_step_deg: 30, table_step_deg: 30, rung_mm: 10}
strategy: ladder
"""

POSITIONER = """\
  positioner:
    robot: irbp_a250
    origin_mm: [633.5, 9.87, 380]
    free: [rotation]
"""
# On a fixed bed behind the arm, whose base is not the world's origin and whose nozzle leans.
BED = (
    (POSITIONER, "  base_mm: [20, -30, 40]\n  bed_mm: [-450, 450, 300]\n"),
    ("axis: [0, 0, 1]", "axis: [0.2, -0.1, 2]"),
)


def write_small(folder: Path, *changes: tuple[str, str], svg: str | bytes = SVG) -> Path:
    """Write the small problem with its drawing into a folder, each (old, new) text of the YAML exchanged."""
    text = YAML
    for old, new in changes:
        if text.count(old) != 1:
            raise ValueError(f"{old!r} stands {text.count(old)} times in the small problem")
        text = text.replace(old, new)
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "small.svg").write_bytes(svg.encode() if isinstance(svg, str) else svg)
    path = folder / "small.yaml"
    path.write_text(text, encoding="utf-8")
    return path


@cache
def small_problem() -> Problem:
    """The small problem, loaded; its files stay until the tests end."""
    return load_problem(write_small(_folder() / "positioner"))


@cache
def small_plan() -> Plan:
    """The small problem, solved once for all tests of a process."""
    return solve(small_problem())


@cache
def bed_plan() -> Plan:
    """The small print on a fixed bed, solved once for all tests of a process."""
    return solve(load_problem(write_small(_folder() / "bed", *BED)))


def solve_alone(problem: Problem, strategy: str | None = None, dt: float = DEFAULT_DT) -> Plan:
    """As `solve`, but without the baseline beside it, which takes as long again; for tests that do not look at it."""
    return solve(problem, strategy, dt=dt, baseline=False)


def sampled(plan: Plan, dt: float) -> Plan:
    """What `solve` makes of a plan's problem with another time between samples, of which joint paths know nothing."""
    problem, cell, toolpath = plan.problem, plan.cell, plan.toolpath
    body = body_of(toolpath, cell)
    obstacles = obstacles_of(problem, cell, toolpath, body)
    trajectory, _ = trajectory_of(problem, cell, toolpath, plan.paths, obstacles, dt, second_process=False)
    report = verify(problem, cell, toolpath, trajectory, body=body)
    return replace(plan, trajectory=trajectory, **{**vars(report), "metrics": plan.metrics | report.metrics})


# Figures of the output contract, in the units of their names.
PROMISES = {
    "position_error_max_mm": 0.02,
    "axis_error_max_deg": 0.05,
    "velocity_ratio_max": 1.0,
    "acceleration_ratio_max": 1.0,
    "branch_changes_in_deposition": 0.0,
}


def promises_kept(plan: Plan) -> None:
    """Raises AssertionError for a plan that is not verified, or misses a figure that is promised."""
    assert plan.verified, [check for check in plan.checks if not check.ok]
    tolerance = plan.problem.process.corner_tolerance * 1e3
    for name, limit in {**PROMISES, "path_deviation_max_mm": tolerance}.items():
        assert plan.metrics[name] <= limit, name


def body_of(toolpath: Toolpath, cell: Cell) -> PrintBody:
    """What takes room of part and print, made once for all that is judged with the same toolpath and cell."""
    key = id(toolpath), id(cell)
    if key not in _BODIES:
        _BODIES[key] = toolpath, cell, print_body(toolpath, standing(cell))  # kept: their ids are not given away again
    return _BODIES[key][2]


def line_of(path: Path, text: str) -> int:
    """Number, from 1, of the first line that holds a text."""
    lines = path.read_text(encoding="utf-8").splitlines()
    return next(number for number, line in enumerate(lines, 1) if text in line)


@cache
def _folder() -> Path:
    keep = tempfile.TemporaryDirectory(prefix="beadwise-")
    _KEPT.append(keep)
    return Path(keep.name)


_KEPT: list[tempfile.TemporaryDirectory[str]] = []
_BODIES: dict[tuple[int, int], tuple[Toolpath, Cell, PrintBody]] = {}
