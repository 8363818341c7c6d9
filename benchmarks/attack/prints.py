"""Small prints that plan in a second or two, for attacks on what comes of them."""

from __future__ import annotations

from pathlib import Path

from planner.plan import Plan
from planner.planning.pipeline import solve
from planner.problem import load_problem

NAME = "small"
DRAWING = """\
<svg xmlns="http://www.w3.org/2000/svg" width="30mm" height="24mm" viewBox="0 0 30 24">
  <path id="zigzag" d="M1,1 L11,1 L11,9 L20,4"/>
  <circle id="ring" cx="7" cy="16" r="5"/>
  <path id="wave" d="M15,18 C18,10 22,10 24,16 S28,20 29,12"/>
</svg>
"""
# On a positioner; `{…}` are what other cells have in their places.
PROBLEM = """\
name: small
cell:
  arm: {arm}
  nozzle: {{tip_mm: [-44.51, 9.9, 113.95], axis: [0, 0, 1], diameter_mm: 0.6}}
  home_deg: {home}
{holder}
part:
  cylinder: {{radius_mm: 34, height_mm: 100, centre_mm: [31.4, 37]}}
layers:
  source: {{svg: small.svg, width_mm: 30}}
  wrap: cylinder
  count: 1
  height_mm: 0.5
process:
  speed_mm_s: 40
  travel_speed_mm_s: 200
  bead: {{width_mm: 0.6, height_mm: 0.5}}
resolve: {{roll_step_deg: 30, table_step_deg: 30, rung_mm: 10}}
strategy: ladder
"""
HOME = "[30, 20, 30, 90, -80, 60]"
POSITIONER = """\
  positioner:
    robot: irbp_a250
    origin_mm: [633.5, 9.87, 380]
    free: [rotation]"""
ON_POSITIONER = {"arm": "irb140", "home": HOME, "holder": POSITIONER}
ON_BED = {"arm": "irb140", "home": HOME, "holder": "  base_mm: [20, -30, 40]\n  bed_mm: [-450, 450, 300]"}
WITH_UR = {"arm": "ur5e", "home": "[150, -110, 110, 0, 70, 20]", "holder": "  bed_mm: [450, -50, 380]"}


def write_print(folder: Path, **cell: str) -> Path:
    """Write the small print with a cell (ON_POSITIONER and the like) into a folder; its problem file."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / f"{NAME}.svg").write_text(DRAWING, encoding="utf-8")
    path = folder / f"{NAME}.yaml"
    path.write_text(PROBLEM.format(**cell), encoding="utf-8")
    return path


def solved(folder: Path, **cell: str) -> Plan:
    """The small print in a cell, verified as it is."""
    plan = solve(load_problem(write_print(folder, **cell)), baseline=False)
    if not plan.verified:
        raise RuntimeError(f"the small print is not verified with {cell['arm']}")
    return plan
