"""The cell: where robots, nozzle and part stand, which limits hold, and what is said about names that do not exist."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pinocchio as pin
import pytest

from planner.base.errors import InputError
from planner.cell.cell import Cell, build_cell, frame_from_z, rigid_inverse
from planner.cell.robot import robot_names
from planner.problem import load_problem

BED = ("cell.positioner=null", "cell.bed_mm=[560, -93, 290]")


def built(*overrides: str) -> Cell:
    return build_cell(load_problem("cylinder_logo", overrides))


def error_of(overrides: Sequence[str]) -> InputError:
    problem = load_problem("cylinder_logo", overrides)
    with pytest.raises(InputError) as caught:
        build_cell(problem)
    return caught.value


# --- what is wrong is named -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("override", "wrong", "meant"),
    [
        ("cell.arm=irb141", "irb141", "irb140"),
        ("cell.positioner.robot=irbp_a205", "irbp_a205", "irbp_a250"),
        ("cell.positioner.free=[rotatoin]", "rotatoin", "rotation"),
        ("cell.positioner.held_deg={tlit: 3}", "tlit", "tilt"),
        ("cell.limits={joint_7: {speed_deg_s: 5}}", "joint_7", "joint_"),
        ("cell.limits={rotaton: {speed_deg_s: 5}}", "rotaton", "rotation"),
    ],
)
def test_unknown_names_are_errors_with_the_nearest_name(override: str, wrong: str, meant: str) -> None:
    error = error_of([override])
    key = override.split("=")[0]
    assert error.field is not None
    assert error.field.removeprefix("--set ").startswith(key)
    assert wrong in str(error)
    assert error.hint is not None
    assert meant in error.hint


def test_a_name_like_no_other_lists_what_there_is() -> None:
    error = error_of(["cell.arm=zzz"])
    assert error.hint is not None
    for name in robot_names():
        assert name in error.hint


def test_error_names_file_and_line() -> None:
    problem = load_problem("cylinder_logo")
    text = problem.file.read_text(encoding="utf-8").splitlines()
    line = 1 + next(i for i, row in enumerate(text) if "home_deg" in row)
    error = error_of(["cell.limits={joint_2: {range_deg: [-90, 10]}}"])  # home has 20 deg
    assert (error.field, error.file, error.line) == ("cell.home_deg", problem.file, line)
    assert "2" in error.reason
    assert error.hint is not None
    assert "-90" in error.hint
    assert "10" in error.hint


@pytest.mark.parametrize("joint", range(6))
def test_home_outside_its_range(joint: int) -> None:
    home = [30.0, 20.0, 30.0, 90.0, -80.0, 60.0]
    home[joint] = [181.0, 111.0, 51.0, -201.0, 116.0, 401.0][joint]  # FACTS' ranges, and a degree more
    error = error_of([f"cell.home_deg={home}"])
    assert error.field == "--set cell.home_deg"
    assert f"joint {joint + 1}" in error.reason or f"joint_{joint + 1}" in error.reason


def test_positioner_is_no_arm() -> None:
    error = error_of(["cell.arm=irbp_a250"])
    assert error.field is not None
    assert error.field.removeprefix("--set ") == "cell.arm"


def test_two_free_axes_are_chosen_joints() -> None:
    cell = built("cell.positioner.free=[tilt, rotation]", "cell.positioner.held_deg={}")
    assert cell.joint_names[6:] == ("tilt", "rotation")
    assert cell.chosen == (6, 7) and cell.solved == (0, 1, 2, 3, 4, 5)


# --- limits -----------------------------------------------------------------------------------------------------


def test_limits_are_the_published_ones(cell: Cell) -> None:
    d = np.degrees
    limits = cell.limits
    assert cell.joint_names == (*(f"joint_{i}" for i in range(1, 7)), "rotation")
    np.testing.assert_allclose(d(limits.q_min[:6]), [-180, -90, -230, -200, -115, -400], atol=1e-9)
    np.testing.assert_allclose(d(limits.q_max[:6]), [180, 110, 50, 200, 115, 400], atol=1e-9)
    np.testing.assert_allclose(d(limits.velocity), [200, 200, 260, 360, 360, 450, 180], atol=1e-9)
    np.testing.assert_allclose(limits.acceleration, [15, 15, 15, 25, 25, 30, 5])
    np.testing.assert_allclose(limits.jerk, 50.0 * limits.acceleration)


@pytest.mark.parametrize("turns", [20, 500])
def test_a_table_may_turn_less_often_than_its_file_says_and_more(turns: int) -> None:
    limits = built(f"cell.limits={{rotation: {{range_deg: [{-360 * turns}, {360 * turns}]}}}}").limits
    np.testing.assert_allclose([limits.q_min[6], limits.q_max[6]], [-2.0 * np.pi * turns, 2.0 * np.pi * turns])


def test_each_limit_can_be_overridden_by_itself(cell: Cell) -> None:
    own = built(
        "cell.limits={joint_3: {range_deg: [-100, 40]}, joint_5: {speed_deg_s: 90}, "
        "rotation: {acceleration_rad_s2: 2}, joint_1: {jerk_rad_s3: 100}}"
    ).limits
    was = cell.limits
    expected = {
        "q_min": (2, np.radians(-100.0)),
        "q_max": (2, np.radians(40.0)),
        "velocity": (4, np.radians(90.0)),
        "acceleration": (6, 2.0),
        "jerk": (0, 100.0),
    }
    for name, (joint, value) in expected.items():
        row = getattr(was, name).copy()
        row[joint] = value
        np.testing.assert_allclose(getattr(own, name), row, rtol=0, atol=1e-12)


# --- placement --------------------------------------------------------------------------------------------------


def test_plate_centre_stands_at_the_origin_given() -> None:
    cell = built("cell.positioner.origin_mm=[700, -20, 310]", "cell.positioner.part_mm=[0, 0, 0]")
    for angle in (0.0, 1.0, -2.5):
        T = cell.holder.poses(np.array([[angle]]))[0]
        np.testing.assert_allclose(T[:3, 3], [0.7, -0.02, 0.31], atol=1e-12)
        c, s = np.cos(angle), np.sin(angle)
        np.testing.assert_allclose(T[:3, :3], [[c, -s, 0], [s, c, 0], [0, 0, 1]], atol=1e-12)  # vertical, right-handed
    np.testing.assert_allclose(cell.T_world_holder, cell.holder.poses(np.zeros((1, 1)))[0], atol=0)


@pytest.mark.parametrize("tilt", [30.0, -75.0])
def test_held_tilt_swings_the_plate_about_its_axis(tilt: float) -> None:
    """FACTS: the tilt axis is horizontal (y), the plate 120 mm below it along the table's own axis."""
    place = ("cell.positioner.origin_mm=[700, -20, 310]", "cell.positioner.part_mm=[0, 0, 0]")
    cell = built(f"cell.positioner.held_deg={{tilt: {tilt}}}", *place)
    assert cell.held == {"tilt": pytest.approx(np.radians(tilt))}
    R = pin.exp3(np.array([0.0, np.radians(tilt), 0.0]))
    tilt_axis = np.array([0.7, -0.02, 0.31 + 0.12])
    for angle in (0.0, 0.8):
        T = cell.holder.poses(np.array([[angle]]))[0]
        np.testing.assert_allclose(T[:3, 3], tilt_axis + R @ [0.0, 0.0, -0.12], atol=1e-12)
        np.testing.assert_allclose(T[:3, :3], R @ pin.exp3(np.array([0.0, 0.0, angle])), atol=1e-12)


def test_free_tilt_turns_about_the_horizontal_axis() -> None:
    cell = built("cell.positioner.free=[tilt]", "cell.positioner.held_deg={rotation: 90}")
    assert cell.holder.names == ("tilt",)
    np.testing.assert_allclose(cell.holder.jacobians(np.zeros((1, 1)))[0][3:, 0], [0, 1, 0], atol=1e-12)
    T = cell.holder.poses(np.zeros((1, 1)))[0]
    np.testing.assert_allclose(T[:3, :3], pin.exp3(np.array([0.0, 0.0, np.pi / 2])), atol=1e-12)


def test_fixed_bed_has_no_joints(bed_cell: Cell) -> None:
    assert bed_cell.joint_names == tuple(f"joint_{i}" for i in range(1, 7))
    assert bed_cell.holder_robot is None
    np.testing.assert_allclose(bed_cell.T_world_holder[:3, 3], [0.56, -0.093, 0.29], atol=1e-12)
    np.testing.assert_array_equal(bed_cell.T_world_holder[:3, :3], np.eye(3))
    assert bed_cell.home.shape == bed_cell.limits.q_min.shape == (6,)


def test_positioner_whose_axes_are_all_held_is_a_bed() -> None:
    cell = built("cell.positioner.free=[]")
    assert len(cell.holder) == 0
    np.testing.assert_allclose(cell.T_world_holder[:3, 3], [0.6335, 0.00987, 0.38], atol=1e-12)


def test_base_moves_the_arm_and_nothing_else(cell: Cell) -> None:
    moved = built("cell.base_mm=[100, -200, 300]")
    q = np.random.default_rng(1).uniform(-1.0, 1.0, (20, 7))
    step = np.array([0.1, -0.2, 0.3])
    np.testing.assert_allclose(moved.arm.poses(q[:, :6])[:, :3, 3], cell.arm.poses(q[:, :6])[:, :3, 3] + step)
    np.testing.assert_allclose(moved.holder.poses(q[:, 6:]), cell.holder.poses(q[:, 6:]))


def test_nozzle_tip_and_axis_in_the_flange_frame() -> None:
    axis = np.array([0.3, -0.4, 0.5])
    cell = built("cell.nozzle.axis=[0.3, -0.4, 0.5]", "cell.nozzle.tip_mm=[10, 20, 130]")
    q = np.random.default_rng(2).uniform(-1.0, 1.0, (20, 6))
    T_flange, T_nozzle = cell.wrist.poses(q), cell.arm.poses(q)
    tip = T_flange[:, :3, 3] + T_flange[:, :3, :3] @ [0.01, 0.02, 0.13]
    np.testing.assert_allclose(T_nozzle[:, :3, 3], tip, atol=1e-12)
    np.testing.assert_allclose(T_nozzle[:, :3, 2], T_flange[:, :3, :3] @ (axis / np.linalg.norm(axis)), atol=1e-12)


def test_pose_in_the_part_frame_by_hand(cell: Cell) -> None:
    """A point of the world, seen from a table turned by 90 deg."""
    q = np.array([[0.1, 0.2, 0.3, 0.4, 0.5, 0.6, np.pi / 2]])
    T_world_nozzle = cell.arm.poses(q[:, :6])[0]
    T = cell.T_part_nozzle(q)[0]
    x, y, z = T_world_nozzle[:3, 3] - [0.6335, 0.00987, 0.38]
    np.testing.assert_allclose(T[:3, 3], [y, -x, z], atol=1e-12)
    ax, ay, az = T_world_nozzle[:3, 2]
    np.testing.assert_allclose(T[:3, 2], [ay, -ax, az], atol=1e-12)


def test_home_is_the_arms_then_zero(cell: Cell) -> None:
    np.testing.assert_allclose(np.degrees(cell.home), [30, 20, 30, 90, -80, 60, 0], atol=1e-12)


def test_rigid_inverse_against_numpy() -> None:
    rng = np.random.default_rng(3)
    T = np.array([pin.SE3.Random().homogeneous for _ in range(20)])
    T[:, :3, 3] = rng.normal(size=(20, 3))
    np.testing.assert_allclose(rigid_inverse(T), np.linalg.inv(T), atol=1e-12)
    np.testing.assert_allclose(rigid_inverse(T[0]), np.linalg.inv(T[0]), atol=1e-12)


@pytest.mark.parametrize("z", [(0, 0, 1), (0, 0, -2), (1e-3, 0, -1), (1, 0, 0), (0.3, -0.4, 0.5)])
def test_frame_from_z_is_a_rotation_by_the_least_angle(z: tuple[float, float, float]) -> None:
    T = frame_from_z(np.array([1.0, 2.0, 3.0]), np.array(z, dtype=float))
    R, unit = T[:3, :3], np.array(z) / np.linalg.norm(z)
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(R) == pytest.approx(1.0)
    np.testing.assert_allclose(R[:, 2], unit, atol=1e-12)
    np.testing.assert_array_equal(T[:3, 3], [1, 2, 3])
    assert (np.trace(R) - 1.0) / 2.0 == pytest.approx(unit[2], abs=1e-9)  # turned by the angle between the axes
