"""List the shipped robots, or describe one, shipped or the user's own: reach, limits, bodies, and what is assumed.

python -m planner.robots [NAME or my_robot.yaml]
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table
from scipy.optimize import minimize

from planner.base.arrays import Array
from planner.base.command_line import Command, exit_code
from planner.base.errors import EXIT_VERIFIED, InputError
from planner.base.shipped import ROBOTS
from planner.cell.kinematics.inverse import Corrected, InverseKinematics
from planner.cell.kinematics.offset_wrist import OffsetWrist
from planner.cell.kinematics.placed_wrist import PlacedWrist
from planner.cell.kinematics.seven_axes import SevenAxes
from planner.cell.kinematics.skew_wrist import SkewWrist
from planner.cell.kinematics.spherical_wrist import SphericalWrist
from planner.cell.robot import Robot, chain_of, names_meant, read_robot, robot_names
from planner.cell.robot_file import read_robot_file
from planner.cell.solids import Box, Capsule, Frustum, Solid

_TRIED = 500  # random postures; an optimiser starts from the farthest few
_BETTERED = 3  # how many
_TURN = 2.0 * np.pi


def reach(robot: Robot) -> float | None:
    """The greatest distance of an arm's wrist from axis 1 within the joint limits [m]; None if the robot is not an arm.

    The wrist is where the last three axes meet, as makers define reach, or the flange's centre if they do not.
    """
    inverse = robot.inverse
    if inverse is None:
        return None
    T_flange_wrist = _wrist(inverse)
    chain = chain_of(robot, np.eye(4), np.eye(4) if T_flange_wrist is None else T_flange_wrist, robot.joint_names, {})
    at, axis = chain.placements[0, :3, 3], chain.placements[0, :3, :3] @ chain.axes[0, :3]

    def away(q: Array) -> Array:
        T = chain.poses(np.atleast_2d(q))
        return np.asarray(np.linalg.norm(np.cross(T[:, :3, 3] - at, axis), axis=1))

    low = np.maximum(robot.model.lowerPositionLimit, -np.pi)
    high = np.minimum(robot.model.upperPositionLimit, np.pi)
    tried = np.random.default_rng(0).uniform(low, high, (_TRIED, len(low)))
    starts = tried[np.argsort(-away(tried))[:_BETTERED]]
    ends = list(zip(low, high, strict=True))
    return max(-float(minimize(lambda q: -away(q)[0], start, bounds=ends).fun) for start in starts)


def _wrist(inverse: InverseKinematics) -> Array | None:
    """The point where the last three axes meet, as a frame (4, 4) in the flange's; None if they do not meet."""
    if isinstance(inverse, Corrected):
        return None if isinstance(inverse.nominal, SevenAxes) else _wrist(inverse.nominal)
    back = np.eye(4)
    if isinstance(inverse, SphericalWrist):
        back[2, 3] = -inverse.c4
        return back
    if isinstance(inverse, PlacedWrist):
        back[2, 3] = -inverse.arm.c4
        return np.asarray(np.linalg.inv(inverse.T_end_flange) @ back)
    return None


def kind(inverse: InverseKinematics | None, joints: Sequence[str]) -> str:
    """A robot's kind of inverse kinematics, in words."""
    if inverse is None:
        return "no arm: it holds the part, or carries an arm"
    if isinstance(inverse, Corrected):
        return f"{kind(inverse.nominal, joints)}, refined to the URDF"
    if isinstance(inverse, SphericalWrist | PlacedWrist):
        arm = inverse if isinstance(inverse, SphericalWrist) else inverse.arm
        lengths = ", ".join(f"{name} {1e3 * value + 0.0:.4g}" for name, value in vars(arm).items())
        return f"spherical wrist, 8 branches; mm: {lengths}"
    if isinstance(inverse, OffsetWrist):
        return "offset wrist, 8 branches"
    if isinstance(inverse, SkewWrist):
        return "axes 4 and 6 pass each other, up to 16 postures"
    given = inverse.redundant_joint
    return f"seven axes, {'' if given is None else joints[given]} chosen, {inverse.branch_count} branches"


def overview(robots: Sequence[tuple[Path, Robot]]) -> Table:
    """A table of robots: what each is, its limits, and where its URDF comes from."""
    table = Table(title="* assumed", title_justify="left", show_lines=True)
    table.add_column("robot")
    table.add_column("joints, base first")
    for path, robot in robots:
        table.add_row("\n".join([robot.key, *_facts(robot)]), "\n".join([*_limits(robot), f"URDF: {_source(path)}"]))
    return table


def details(path: Path, robot: Robot) -> list[Table | str]:
    """All that is known about one robot: facts, a table of its joints, and one of its bodies."""
    joints = Table(title="joints", title_justify="left")
    marks = _marks(robot)
    heads = ("range, deg", "speed, deg/s", "acceleration, rad/s²", "jerk, rad/s³")
    if all(robot.slides):
        heads = ("range, mm", "speed, mm/s", "acceleration, m/s²", "jerk, m/s³")
    elif any(robot.slides):
        heads = ("range, deg or mm", "speed, deg/s or mm/s", "acceleration, rad/s² or m/s²", "jerk, rad/s³ or m/s³")
    joints.add_column("joint")
    for head, mark in zip(heads, marks, strict=True):
        joints.add_column(head + mark, justify="right")
    model = robot.model
    for i, name in enumerate(robot.joint_names):
        range_ = _range(model.lowerPositionLimit[i], model.upperPositionLimit[i], robot.slides[i])
        joints.add_row(name, range_, _speed(robot, i), f"{robot.acceleration[i]:g}", f"{robot.jerk[i]:g}")
    bodies = Table(title="bodies for collision checks", title_justify="left")
    bodies.add_column("carried by")
    bodies.add_column("body")
    bodies.add_column("shape")
    for i, own in enumerate(robot.bodies):
        for body in own:
            bodies.add_row(robot.joint_names[i - 1] if i else "the base", body.name, _shape(body.solid))
    facts = [f"{robot.name} ({robot.key})", *_facts(robot)[1:], f"URDF: {_source(path)}", f"tip: {robot.tip}"]
    if robot.assumed:
        facts.append(f"* assumed: {', '.join(robot.assumed)}")
    if robot.measured:
        facts.append(f"measured: {robot.measured}")
    return ["\n".join(facts), joints, *([bodies] if any(robot.bodies) else [])]


def _facts(robot: Robot) -> list[str]:
    farthest = reach(robot)
    point = "flange" if robot.inverse is None or _wrist(robot.inverse) is None else "wrist"
    count = sum(map(len, robot.bodies))
    mark = "*" if any("links" in word for word in robot.assumed) else ""
    return [
        robot.name,
        kind(robot.inverse, robot.joint_names),
        *([] if farthest is None else [f"reach {farthest * 1e3:.0f} mm (axis 1 to {point})"]),
        f"bodies{mark}: {' '.join(str(len(own)) for own in robot.bodies)}"
        if count
        else "no bodies: its collisions are not checked",
    ]


def _limits(robot: Robot) -> list[str]:
    model = robot.model
    ranges = " ".join(map(_range, model.lowerPositionLimit, model.upperPositionLimit, robot.slides))
    speeds = " ".join(_speed(robot, i) for i in range(len(robot.slides)))
    acceleration, jerk = (" ".join(f"{value:g}" for value in values) for values in (robot.acceleration, robot.jerk))
    angle, way = ("mm", "m") if all(robot.slides) else ("deg", "rad")
    rows = ((ranges, angle), (speeds, f"{angle}/s"), (acceleration, f"{way}/s²"), (jerk, f"{way}/s³"))
    return [f"{text} {unit}{mark}" for (text, unit), mark in zip(rows, _marks(robot), strict=True)]


def _marks(robot: Robot) -> list[str]:
    """A star for each of range, speed, acceleration and jerk if part of it is assumed."""
    return ["*" if any(word in told for told in robot.assumed) else "" for word in ("range", "speed", "accel", "jerk")]


def _speed(robot: Robot, i: int) -> str:
    """Speed of a joint in deg/s, or mm/s where it slides."""
    value = robot.model.velocityLimit[i]
    return f"{value * 1e3 if robot.slides[i] else np.degrees(value):.4g}"


def _range(low: float, high: float, slides: bool) -> str:
    if slides:
        return f"{low * 1e3:.4g}…{high * 1e3:.4g}"
    if high - low > 20 * _TURN:
        return f"{(high - low) / _TURN:.0f} turns"
    a, b = np.degrees([low, high])
    return f"±{b:.4g}" if abs(a + b) < 1e-6 else f"{a:.4g}…{b:.4g}"


def _source(path: Path) -> str:
    urdf = read_robot_file(path).data["urdf"]
    return str(urdf) if isinstance(urdf, str) else f"{urdf['path']} of the package {urdf['package']}"


def _shape(solid: Solid) -> str:
    """A solid in words [mm]."""
    if isinstance(solid, Box):
        return "box " + " x ".join(f"{1e3 * size:.4g}" for size in solid.size)
    if isinstance(solid, Frustum):
        return f"cylinder, radius {1e3 * solid.bottom:.4g}, length {1e3 * solid.height:.4g}"
    if isinstance(solid, Capsule):
        return (
            f"ball, radius {1e3 * solid.radius:.4g}"
            if solid.length == 0
            else (f"capsule, radius {1e3 * solid.radius:.4g}, length {1e3 * solid.length:.4g}")
        )
    size = 1e3 * np.ptp(solid.vertices, axis=0)
    return f"convex hull of a mesh, {' x '.join(f'{value:.0f}' for value in size)}, {len(solid.vertices)} corners"


def _path_of(name: str) -> Path:
    """The file of a robot that ships, by its key, or of the user's own, by its path."""
    if name in robot_names():
        return ROBOTS / f"{name}.yaml"
    if name.endswith((".yaml", ".yml")):
        return Path(name)
    raise InputError(f"unknown robot {name!r}", hint=names_meant(name))


def robots_command() -> Command:
    """The parser of `python -m planner.robots`."""
    parser = Command(
        "robots",
        "List the robots that ship, or describe one of them in full.",
        {
            "": "all that ship: joints, reach, limits",
            "irb1600_145": "one of them: every joint's limits, every body, what is assumed",
            "my_robot.yaml": "whether a robot's file of your own is read as you mean it",
            "add --help": "how such a file is made from a published URDF",
        },
        {0: "printed", 2: "wrong input"},
    )
    parser.add_argument(
        "robot", nargs="?", metavar="NAME", help="a robot that ships, or a robot's own file, my_robot.yaml"
    )
    return parser


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit code."""
    options = robots_command().parse_args(arguments)
    out, errors = Console(highlight=False), Console(stderr=True, highlight=False)

    def show() -> int:
        if options.robot is None:
            out.print(overview([(path, read_robot(path)) for path in map(_path_of, robot_names())]))
            return EXIT_VERIFIED
        path = _path_of(options.robot)
        for part in details(path, read_robot(path)):
            out.print(part, markup=False, soft_wrap=True) if isinstance(part, str) else out.print(part)
        return EXIT_VERIFIED

    return exit_code(show, partial(errors.print, markup=False, soft_wrap=True))
