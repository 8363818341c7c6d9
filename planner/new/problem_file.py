"""The problem file made from the answers, with comments on what else it can hold."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from planner.base.shipped import PROBLEM_SCHEMA
from planner.new.questions import STAND_MM, WING_ABOVE_MM, Answers, extent_mm
from planner.problem.describe import MODELINE
from planner.problem.yaml_file import yaml_text

BED_MM = 20.0  # thickness of the plate under a part on a bed
AROUND_MM = 100.0  # how far the plate extends beyond the print
NARROW_MM = 20.0  # radius of the stand of a part on a positioner


def modeline(folder: Path) -> str:
    """The first line of a problem file in a folder: it tells editors where the schema is; empty without a schema."""
    if not PROBLEM_SCHEMA.is_file():
        return ""
    path = Path(os.path.relpath(PROBLEM_SCHEMA.resolve(), folder.resolve())).as_posix()
    return f"{MODELINE} $schema={path}\n"


def problem_text(answers: Answers, file: Path, home_deg: Sequence[float]) -> str:
    """The text of a problem file whose home posture is given."""
    return f"""\
{modeline(file.parent)}\
# {_title(answers)}.
# Lengths are millimetres, angles degrees, as the names of the keys say. All keys: docs/reference/problem_file.md
#   python -m planner.check {file.name}      reads it
#   python -m planner.solve {file.name}      plans it; results in out/{answers.name}

name: {answers.name}

# The world is the arm's base frame.
cell:
  arm: {answers.arm.key}  # {answers.arm.name}; python -m planner.robots {answers.arm.key} lists its limits
  # The nozzle as seen from the flange; its outline and the print head are assumed until you give them:
  #   profile_mm: [[0, 0.6], [7, 4.6], [40, 4.6]], head: {{motor: {{box_mm: [40, 40, 60], centre_mm: [0, 0, 30]}}}}
  nozzle: {{tip_mm: {_list(answers["tip_mm"])}, axis: [0, 0, 1], diameter_mm: {answers["diameter_mm"]}}}
  home_deg: {_list(home_deg)}  # before and after the print; above the part
{_holder(answers)}
  # Accelerations and jerks of robots are assumed, since nobody publishes them. Put your own here:
  #   limits: {{{answers.arm.joint_names[0]}: {{speed_deg_s: 200, acceleration_rad_s2: 15, jerk_rad_s3: 750}}}}
{_part(answers)}
{_layers(answers)}

# How material is laid down.
process:
  speed_mm_s: {answers["speed_mm_s"]}  # held constant; where a joint cannot follow, it dips and the report says so
  travel_speed_mm_s: 100
  bead: {{width_mm: {answers["width_mm"]}{_bead_height(answers)}}}
{_runs(answers)}\
  # Around a bead; all of these are off:
  #   prime: {{length_mm: 2, speed_mm_s: 25}}     # filament pushed until a bead starts
  #   retract: {{length_mm: 2, speed_mm_s: 25}}   # and pulled back from its end on
  #   start: {{nozzle_c: 210, bed_c: 60, heat_wait_s: 120, purge_mm: 20}}  # at home, before the first move

# How the motion that the path leaves free is decided: sqp is the best, ladder the quickest that is good.
strategy: sqp
"""


def _title(answers: Answers) -> str:
    on = {"plane": " on a plane", "dome": " on a dome", "cylinder": " around a cylinder"}.get(
        answers.values.get("body", ""), ""
    )
    what = {
        "pattern": f"A {answers.values.get('pattern')} pattern",
        "drawing": "A drawing",
        "waypoints": "A path given by points",
        "gcode": "A slicer's layers",
        "mesh": "A closed mesh in layers",
        "wing": "A wing in layers parallel to its surfaces",
    }[answers.what]
    return f"{what}{on}"


def _list(values: Sequence[Any]) -> str:
    return "[" + ", ".join(f"{value:g}" for value in values) + "]"


def _size(answers: Answers) -> tuple[float, float]:
    width, length = extent_mm(answers.values)[:2]
    return width, length


def _holder(answers: Answers) -> str:
    x, y, z = answers["place_mm"]
    if answers.holder == "bed":
        width, length = (side + 2 * AROUND_MM for side in _size(answers))
        return (
            f"  bed_mm: {_list((x, y, z))}  # origin of the part frame\n"
            "  fixtures:  # bodies in the cell, or carried with the part (on: part)\n"
            f"    bed: {{box_mm: {_list((width, length, BED_MM))}, centre_mm: {_list((x, y, z - BED_MM / 2))}}}  # assumed"
        )
    return (
        "  positioner:\n"
        f"    robot: {answers.holder}\n"
        f"    origin_mm: {_list((x, y, z))}  # centre of its plate\n"
        f"    part_mm: {_list((0, 0, STAND_MM))}  # the part frame stands above it and turns with it\n"
        "    free: [rotation]  # axes that the planner may move; the others stay where held_deg says, or at 0\n"
        "  fixtures:  # bodies in the cell, or carried with the part (on: part)\n"
        f"    stand: {{cylinder: {{radius_mm: {NARROW_MM:g}, height_mm: {STAND_MM:g}}}, "
        f"centre_mm: {_list((0, 0, -STAND_MM / 2))}, on: part}}  # assumed"
    )


def _part(answers: Answers) -> str:
    body = answers.values.get("body")
    if body is None:
        return ""
    if body == "plane":
        width, length = (1.5 * side for side in _size(answers))
        text = f"plane: {{size_mm: {_list((width, length))}}}  # about the part frame's origin"
    elif body == "dome":
        text = f"sphere: {{radius_mm: {answers['radius_mm']}}}  # its centre is the part frame's origin: a half ball"
    else:
        text = f"cylinder: {{radius_mm: {answers['radius_mm']}, height_mm: {answers['body_height_mm']}}}"
    return f"\n# The body to print on, in the part frame.\npart:\n  {text}\n"


def _layers(answers: Answers) -> str:
    what = answers.what
    lines = ["# The layers to print. Paths of files are relative to this file's folder.", "layers:"]
    if what == "pattern":
        size = _list(answers["size_mm"])
        lines.append(f"  source: {{pattern: {answers['pattern']}, cell_mm: {answers['cell_mm']}, size_mm: {size}}}")
    elif what == "drawing":
        kind = "dxf" if str(answers["file"]).lower().endswith(".dxf") else "svg"
        lines.append(f"  source: {{{kind}: {yaml_text(answers['file'])}, width_mm: {answers['svg_width_mm']}}}")
    elif what == "wing":
        thick = int(answers["naca"][2:]) / 100 * answers["chord_mm"]
        up = 0.5 * thick + WING_ABOVE_MM
        place = f"origin_mm: {_list((15, 0, up))}"
        lines += [
            f"  source: {{naca: '{answers['naca']}', chord_mm: {answers['chord_mm']}, span_mm: {answers['span_mm']}, {place}}}",
            f"  support: {{length_mm: {answers['chord_mm'] + 30:g}, height_mm: {up - 0.2:g}}}  # printed under it",
        ]
    else:
        key = {"waypoints": "waypoints", "gcode": "gcode", "mesh": "mesh"}[what]
        lines.append(f"  source: {{{key}: {yaml_text(answers['file'])}}}  # origin_mm moves it in the part frame")
    if what in ("pattern", "drawing"):
        around = answers["body"] == "cylinder"
        lines.append("  wrap: cylinder" if around else "  project: z  # falls onto the part along z")
        lines.append(f"  count: {answers['count']}")
    if what not in ("waypoints", "gcode"):
        lines.append(f"  height_mm: {answers['height_mm']}")
    return "\n".join(lines)


def _bead_height(answers: Answers) -> str:
    return f", height_mm: {answers['height_mm']}" if answers.what == "waypoints" else ""


def _runs(answers: Answers) -> str:
    if answers.what != "wing":
        return ""
    return (
        "  run_in_mm: 1.2  # short and steep, so that the nozzle keeps clear of neighbouring layers\n  ramp_deg: 45\n"
    )
