"""The files of an added robot: what a URDF cannot hold, and a trial print."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from planner.base.arrays import Array
from planner.base.geometry import arc_lengths
from planner.base.shipped import PROBLEM_SCHEMA
from planner.problem.fields import identifier_like
from planner.problem.yaml_file import yaml_text
from planner.robots.survey import Survey
from planner.robots.touching import Touching

ROBOT_SCHEMA = PROBLEM_SCHEMA.with_name("robot.schema.json")


def trial_files(file: Path) -> tuple[Path, Path]:
    """Paths of the trial print's waypoints and problem file, next to the robot's file."""
    name = identifier_like(file.stem, "_print")
    return file.with_name(f"{name}.txt"), file.with_name(f"{name}.yaml")


def robot_text(found: Survey, touch: Touching, urdf: Path, file: Path, language: str | None) -> str:
    """The text of a robot's file."""
    address = Path(os.path.relpath(urdf.resolve(), file.parent.resolve())).as_posix()
    lines = []
    if ROBOT_SCHEMA.is_file():
        schema = Path(os.path.relpath(ROBOT_SCHEMA.resolve(), file.parent.resolve())).as_posix()
        lines.append(f"# yaml-language-server: $schema={schema}")
    lines += [f"# Written by: beadwise robots add {urdf.name}", *(f"# {note}" for note in (*found.notes, *touch.notes))]
    lines += [f"name: {yaml_text(found.name)}", f"urdf: {yaml_text(address)}", f"tip: {yaml_text(found.tip)}"]
    if language is not None:
        lines.append(f"language: {language}")
    lines.append(f"inverse_kinematics: {found.kind}")
    if found.redundant is not None:
        lines.append(f"redundant_joint: {yaml_text(found.redundant)}")
    if found.ranges:
        ranges = ", ".join(f"{yaml_text(name)}: {_list(pair)}" for name, pair in found.ranges.items())
        lines.append(f"range_deg: {{{ranges}}}")
    if found.speeds is not None:
        lines.append(f"speed_rad_s: {_list(found.speeds)}")
    if touch.pieces:
        lines.append(f"pieces: {{{', '.join(f'{yaml_text(link)}: {n}' for link, n in touch.pieces.items())}}}")
    if touch.may_touch:
        lines.append(f"may_touch: [{', '.join(f'[{yaml_text(a)}, {yaml_text(b)}]' for a, b in touch.may_touch)}]")
    lines += [
        "# ASSUMED: replace these with your own; assumed values bear a star in listings and are named in reports.",
        f"assumed: [{', '.join(found.assumed)}]",
        f"acceleration_rad_s2: {_list(found.acceleration)}",
        f"jerk_rad_s3: {_list(found.jerk)}",
    ]
    return "\n".join(lines) + "\n"


def _list(values: Sequence[float] | Array) -> str:
    return f"[{', '.join(f'{value:g}' for value in values)}]"


# ----------------------------------------------------------------------------------------------------
# The trial print: a spiral on a cap.

TIP_MM = 100.0  # from the flange to the nozzle tip
BENDS = (np.radians(45.0), 0.0)  # rad from the last axis to the nozzle's, to try: as in the problem peer_cap; straight
CAP_MM = 60.0  # radius of the cap for an arm that reaches REACH or farther
REACH = 0.6  # m: with less, the cap is smaller
LEAST_MM = 20.0  # radius of the smallest cap
POLAR = 0.5  # rad from its top to its rim
PITCH_MM, STEP_MM = 3.0, 1.0
BED_MM = 20.0


@dataclass(frozen=True)
class Cap:
    """A cap of a sphere and a path on it: radius [m], angle from its top to its rim [rad], waypoints as lines
    x y z nx ny nz [mm] from the sphere's centre."""

    radius: float
    polar: float
    waypoints: str


def cap_for(reach: float) -> Cap:
    """A spiral on a cap sized for an arm's reach [m]."""
    radius_mm = float(np.clip(np.round(CAP_MM * reach / REACH), LEAST_MM, CAP_MM))
    return Cap(radius_mm * 1e-3, POLAR, spiral(radius_mm))


def spiral(radius_mm: float) -> str:
    """Waypoints of a spiral from the top of a cap to its rim, in the form of `Cap.waypoints`."""
    turns = POLAR * radius_mm / PITCH_MM
    fine = np.linspace(0.0, 2.0 * np.pi * turns, 20000)
    arc = arc_lengths(_cap(fine, turns) * radius_mm)
    at = np.interp(np.linspace(0.0, arc[-1], int(arc[-1] / STEP_MM) + 1), arc, fine)
    normals = _cap(at, turns)
    rows = np.hstack([radius_mm * normals, normals])
    return "".join(" ".join(f"{value:.6f}" for value in row + 0.0) + "\n" for row in rows)


def _cap(azimuth: Array, turns: float) -> Array:
    """Unit normals (n, 3) of the cap along its spiral."""
    polar = POLAR * azimuth / (2.0 * np.pi * turns)
    return np.column_stack([np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.cos(polar)])


@dataclass(frozen=True)
class TrialNozzle:
    """The nozzle's tip [m] and its direction, both in the flange frame."""

    tip: Array
    axis: Array


def nozzle_of(outwards: Array, bend: float, deep: float = 0.0) -> TrialNozzle:
    """A nozzle bent by an angle [rad] from `outwards`, the direction in which the last axis leaves the flange; deep:
    how far the flange's frame lies inside its link [m]."""
    aside = np.eye(3)[int(np.argmin(np.abs(outwards)))]
    aside = aside - (aside @ outwards) * outwards
    axis = np.cos(bend) * outwards + np.sin(bend) * aside / np.linalg.norm(aside)
    return TrialNozzle((TIP_MM * 1e-3 + deep) * outwards, axis)


def print_text(
    name: str, robot: Path, waypoints: str, nozzle: TrialNozzle, place: Array, home_deg: Sequence[float]
) -> str:
    """The text of the trial print's problem file; place: the cap's centre [m]."""
    tip, axis = (_list(np.round(values, 6) + 0.0) for values in (1e3 * nozzle.tip, nozzle.axis))
    at, bed = np.round(place * 1e3, 3) + 0.0, np.round(place * 1e3 - [0.0, 0.0, 0.5 * BED_MM + 10.0], 3) + 0.0
    return f"""\
# A spiral on a cap, to try a robot with. Lengths are millimetres, angles degrees.
name: {name}

# The world is the arm's base frame.
cell:
  arm: {yaml_text(robot.name)}
  nozzle: {{tip_mm: {tip}, axis: {axis}, diameter_mm: 0.6}}
  home_deg: {_list(home_deg)}
  bed_mm: {_list(at)}  # centre of the cap
  fixtures: {{bed: {{box_mm: [200, 200, {BED_MM:g}], centre_mm: {_list(bed)}}}}}

layers:
  source: {{waypoints: {yaml_text(waypoints)}}}

process:
  speed_mm_s: 40
  travel_speed_mm_s: 200
  bead: {{width_mm: 0.6, height_mm: 0.5}}
"""
