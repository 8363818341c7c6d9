"""Bodies of the robots that ship: as long as the arms are, clear of each other where robots can be."""

from __future__ import annotations

from functools import cache

import coal
import numpy as np
import pinocchio as pin
import pytest
from coal_bodies import distance, nearest_links, placed

from planner.base.arrays import Array
from planner.base.shipped import ROBOTS
from planner.cell.cell import Cell, build_cell
from planner.cell.robot import Robot, joint_axis, read_robot, robot_names
from planner.problem import load_problem

DRAWN = [key for key in robot_names() if key not in ("panda", "ur3", "ur5", "ur10", "xarm7")]
ABB = [key for key in DRAWN if key.startswith("irb") and key != "irbp_a250"]
PROBLEMS = (
    "cylinder_logo", "curved_plate", "peer_cylinder", "hemisphere_honeycomb", "naca0015_wing", "peer_cap", "fibre_bowl",
    "ceiling_logo", "rail_panel",
)  # fmt: skip
CLEAR = 5e-3  # m: the clearance that arms keep unless told otherwise


@cache
def robot(key: str) -> Robot:
    return read_robot(ROBOTS / f"{key}.yaml")


@cache
def cell_of(name: str) -> Cell:
    return build_cell(load_problem(name))


def mid_range(one: Robot) -> Array:
    return np.clip(np.zeros(one.model.nq), one.model.lowerPositionLimit, one.model.upperPositionLimit)


@pytest.mark.slow(keep=5)
@pytest.mark.parametrize("key", robot_names())
def test_every_link_has_a_body(key: str) -> None:
    assert all(robot(key).bodies)
    assert sum(map(len, robot(key).bodies)) <= 16  # each costs time in every check


@pytest.mark.parametrize("key", DRAWN)
def test_links_reach_from_joint_to_joint(key: str) -> None:
    """A link has body on the axis of its own joint and on that of the next one."""
    one = robot(key)
    bodies = placed(one, mid_range(one))
    data = one.model.createData()
    pin.forwardKinematics(one.model, data, mid_range(one))
    frame = one.model.getFrameId(one.tip)
    pin.updateFramePlacements(one.model, data)
    for i in range(one.model.njoints):
        own = [body for body in bodies if body[0] == i]
        ends = [data.oMi[i], data.oMi[i + 1] if i + 1 < one.model.njoints else data.oMf[frame]]
        for k, end in enumerate(ends[1:] if i == 0 else ends):
            at = i + k if i else 1
            axis = joint_axis(one.model, min(at, one.model.njoints - 1))
            axis = end.rotation @ (axis[:3] if axis[:3].any() else axis[3:])
            rod = coal.Capsule(1e-4, 2.0)
            turn = pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), axis).toRotationMatrix()
            line = (-1, "axis", rod, coal.Transform3s(turn, end.translation))
            assert min(distance(line, body) for body in own) < 1e-3, (key, i, at)


@pytest.mark.parametrize("key", DRAWN)
def test_links_are_no_longer_than_the_arm(key: str) -> None:
    """Nothing but the wrist's own thickness lies beyond the flange's centre, seen along the last axis."""
    one = robot(key)
    data = one.model.createData()
    pin.framesForwardKinematics(one.model, data, mid_range(one))
    tip = data.oMf[one.model.getFrameId(one.tip)]
    plane = coal.Halfspace(-tip.rotation[:, 2], -tip.rotation[:, 2] @ tip.translation - 1e-6)  # beyond the flange
    last = [body for body in placed(one, mid_range(one)) if body[0] == one.model.njoints - 1]
    assert min(distance((-1, "beyond", plane, coal.Transform3s()), body) for body in last) > -1e-5


@pytest.mark.parametrize("key", ABB + ["iiwa"])
def test_the_wrist_turns_freely(key: str) -> None:
    """Through all of its range the flange keeps the usual clearance from the link before the last but one."""
    one = robot(key)
    n = one.model.nq
    q = mid_range(one)
    least = np.inf
    for bend in np.linspace(one.model.lowerPositionLimit[n - 2], one.model.upperPositionLimit[n - 2], 31):
        q[n - 2] = bend
        bodies = placed(one, q)
        for a in (body for body in bodies if body[0] == n - 2):
            least = min(least, *(distance(a, b) for b in bodies if b[0] == n))
    assert CLEAR < least < 0.03


@pytest.mark.parametrize("key", ABB)
def test_arms_seldom_stand_in_their_own_way(key: str) -> None:
    """Most postures within the ranges are possible; those that are not fold the wrist into the base."""
    one = robot(key)
    rng = np.random.default_rng(4)
    low, high = one.model.lowerPositionLimit, one.model.upperPositionLimit
    least = [nearest_links(one, rng.uniform(low, high)) for _ in range(60)]
    assert sum(distance < CLEAR for distance, _, _ in least) < 12


@pytest.mark.parametrize("name", PROBLEMS)
def test_at_home_nothing_touches(name: str) -> None:
    cell = cell_of(name)
    na = len(cell.arm)
    arm = placed(cell.arm_robot, cell.home[:na], cell.T_world_base)
    assert nearest_links(cell.arm_robot, cell.home[:na])[0] > CLEAR
    if cell.holder_robot is not None:
        rest = dict(zip(cell.holder.names, cell.home[na:], strict=True)) | cell.held
        q = np.array([rest[joint] for joint in cell.holder_robot.joint_names])
        holder = placed(cell.holder_robot, q, cell.T_world_holder_base)
        assert min(distance(a, b) for a in arm for b in holder) > CLEAR


# --- the positioner ---------------------------------------------------------------------------------------------


def test_the_positioner_turns_clear_of_its_column() -> None:
    one = robot("irbp_a250")
    for tilt in np.radians(np.arange(-180, 181, 15)):
        q = np.array([tilt, 0.4])
        column = [body for body in placed(one, q) if body[0] == 0]
        turned = [body for body in placed(one, q) if body[0] > 0 and "tilt joint" not in body[1]]
        assert min(distance(a, b) for a in column for b in turned) > 0.02


def test_the_plate_ends_at_the_plate_frame() -> None:
    (plate,) = robot("irbp_a250").bodies[2]
    assert plate.T_frame_solid[2, 3] + plate.solid.height == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("tilt", [0, 30, 90, -90, 180])
def test_nothing_of_the_positioner_is_where_parts_are(tilt: float) -> None:
    """A part 1 m across and 0.4 m high turns on the plate, at any tilt, and the column stands away from the arm."""
    one = robot("irbp_a250")
    q = np.array([np.radians(tilt), 0.0])
    bodies = placed(one, q)
    T = next(body for body in bodies if body[1].startswith("plate"))[3]
    rotation, centre = T.getRotation(), T.getTranslation()
    part = coal.Cylinder(0.5, 0.4)
    half_plate = 0.5 * one.bodies[2][0].solid.height
    pose = coal.Transform3s(rotation, centre + rotation @ np.array([0.0, 0.0, half_plate + 0.2 + 1e-3]))
    assert min(distance((-1, "part", part, pose), body) for body in bodies) > 0.0


def test_the_column_stands_on_the_side_away_from_the_arm() -> None:
    cell = cell_of("cylinder_logo")
    na = len(cell.arm)
    arm = placed(cell.arm_robot, cell.home[:na], cell.T_world_base)
    column = [body for body in placed(cell.holder_robot, np.zeros(2), cell.T_world_holder_base) if "column" in body[1]]
    assert min(distance(a, b) for a in arm for b in column) > 0.4
