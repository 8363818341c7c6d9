"""What a peer is given: a folder with the waypoints, the cell as one URDF, and the limits of its joints."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
import pinocchio as pin

from benchmarks.peer_cases import CASES as MEASURED
from benchmarks.peer_cases import write_case as write_problem
from planner.base.arrays import Array
from planner.cell.cell import Cell, build_cell
from planner.cell.kinematics.chain import Chain
from planner.planning.context import PlanningContext, context_of
from planner.problem import Problem, load_problem
from planner.toolpath.build import build_toolpath

ROOM = np.radians(0.5)  # by which a peer's joint ranges are narrower than those it is judged by
WAYPOINTS, ROBOT, LIMITS = "waypoints.csv", "robot.urdf", "limits.json"
WORLD, BASE, FLANGE, NOZZLE, PART = "world", "base", "flange", "nozzle", "part"  # links of the URDF
COLUMNS = "bead,x,y,z,axis_x,axis_y,axis_z,roll_x,roll_y,roll_z"


@dataclass(frozen=True)
class Case:
    """A problem that ships, or one of the two measured ones at a number of waypoints.

    settings: of the problem file
    """

    name: str
    waypoints: int | None = None
    settings: tuple[str, ...] = ()

    @property
    def key(self) -> str:
        """Its name in tables and on the command line."""
        return self.name if self.waypoints is None else f"{self.name}@{self.waypoints}"


ONE_LAYER = ("layers.count=1",)
CASES = {
    case.key: case
    for case in (
        *(Case(name, waypoints) for waypoints in (1_000, 10_000) for name in MEASURED),
        Case("curved_plate"),
        Case("hemisphere_honeycomb", settings=ONE_LAYER),
        Case("cylinder_logo", settings=ONE_LAYER),
        Case("naca0015_wing", settings=ONE_LAYER),
    )
}


def problem_of(case: Case, folder: Path) -> Problem:
    """The case's problem; one at a number of waypoints is written into the folder first."""
    if case.waypoints is None:
        return load_problem(case.name, case.settings)
    return load_problem(write_problem(case.name, case.waypoints, folder))


def given(case: Case, folder: Path) -> PlanningContext:
    """Read a case, build its toolpath and cell. Raises InputError as planning does."""
    problem = problem_of(case, folder)
    toolpath = build_toolpath(problem)
    cell = build_cell(problem).at(toolpath.beads[0].material)
    return context_of(problem, cell, toolpath)


def write_case(given: PlanningContext, folder: Path) -> None:
    """Write the three files of a case into a folder that exists."""
    rows = [
        np.column_stack([np.full(len(task), i), task.tip, task.frames[:, :, 2], task.frames[:, :, 0]])
        for i, task in enumerate(given.tasks)
    ]
    number = "%.15g"
    np.savetxt(
        folder / WAYPOINTS, np.vstack(rows), fmt=["%d", *[number] * 9], delimiter=",", header=COLUMNS, comments=""
    )
    (folder / ROBOT).write_text(urdf(given.cell), encoding="utf-8")
    (folder / LIMITS).write_text(json.dumps(limits(given), indent=1) + "\n", encoding="utf-8")


def limits(given: PlanningContext) -> dict[str, object]:
    """Joints in order with their limits and home [rad, s], how many are the arm's, the speed [m/s], and the arm's lengths.

    opw: of an arm with a spherical wrist, as Brandstötter et al. name them [m], whose joint 3 is 90 deg less than theirs;
    else null.
    """
    cell = given.cell
    fields = ("velocity", "acceleration", "jerk")
    lengths = None
    if cell.spherical:
        names = ("a1", "a2", "b", "c1", "c2", "c3", "c4")
        lengths = dict(zip(names, cell.wrist.parameters.tolist(), strict=True))
    return {
        "joints": list(cell.joint_names),
        "arm_joints": len(cell.arm),
        "home": cell.home.tolist(),
        "speed": given.problem.process.speed,
        "opw": lengths,
        "q_min": (cell.limits.q_min + ROOM).tolist(),
        "q_max": (cell.limits.q_max - ROOM).tolist(),
        **{name: getattr(cell.limits, name).tolist() for name in fields},
    }


def urdf(cell: Cell) -> str:
    """The cell's free joints as one URDF without bodies: world to flange and nozzle, world to part."""
    root = ET.Element("robot", {"name": "case", "xmlns:tesseract": "https://github.com/tesseract-robotics/tesseract"})
    root.set("tesseract:make_convex", "true")  # without it that reader refuses the file
    ET.SubElement(root, "link", name=WORLD)
    names = cell.joint_names
    na = len(cell.arm)
    arm = replace(cell.arm, placements=cell.arm.placements.copy())
    arm.placements[0] = np.linalg.inv(cell.T_world_base) @ arm.placements[0]
    _fixed(root, WORLD, BASE, cell.T_world_base)
    last = _joints(root, cell, arm, names[:na], 0, BASE, "link")
    T_last_flange = cell.arm.T_last_tip @ np.linalg.inv(cell.T_flange_nozzle)
    _fixed(root, last, FLANGE, T_last_flange)
    _fixed(root, FLANGE, NOZZLE, cell.T_flange_nozzle)
    last = _joints(root, cell, cell.holder, names[na:], na, WORLD, "plate")
    _fixed(root, last, PART, cell.holder.T_last_tip)
    ET.indent(root)
    return '<?xml version="1.0"?>\n' + ET.tostring(root, encoding="unicode") + "\n"


def _joints(
    root: ET.Element, cell: Cell, chain: Chain, names: tuple[str, ...], first: int, parent: str, link: str
) -> str:
    """Append a chain's joints, which are those of the cell from `first` on; returns the last link's name."""
    for i, name in enumerate(names):
        child = f"{link}_{i + 1}"
        joint = _joint(root, name, "revolute", parent, child, chain.placements[i])
        ET.SubElement(joint, "axis", xyz=_numbers(chain.axes[i, :3]))
        k = first + i
        ET.SubElement(
            joint,
            "limit",
            lower=repr(float(cell.limits.q_min[k] + ROOM)),
            upper=repr(float(cell.limits.q_max[k] - ROOM)),
            velocity=repr(float(cell.limits.velocity[k])),
            acceleration=repr(float(cell.limits.acceleration[k])),
            effort="1",
        )
        parent = child
    return parent


def _fixed(root: ET.Element, parent: str, child: str, T: Array) -> None:
    _joint(root, f"{parent}_to_{child}", "fixed", parent, child, T)


def _joint(root: ET.Element, name: str, kind: str, parent: str, child: str, T: Array) -> ET.Element:
    ET.SubElement(root, "link", name=child)
    joint = ET.SubElement(root, "joint", name=name, type=kind)
    ET.SubElement(joint, "origin", xyz=_numbers(T[:3, 3]), rpy=_numbers(pin.rpy.matrixToRpy(T[:3, :3])))
    ET.SubElement(joint, "parent", link=parent)
    ET.SubElement(joint, "child", link=child)
    return joint


def _numbers(values: Array) -> str:
    return " ".join(repr(float(value)) for value in values)
