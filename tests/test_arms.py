"""Arms of every kind: closed forms against Pinocchio, against many starts of Newton, along paths, at singularities."""

from __future__ import annotations

import runpy
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from planner.base.arrays import Array
from planner.base.errors import InputError, Refusal
from planner.base.shipped import ROBOTS
from planner.cell.cell import build_cell
from planner.cell.kinematics.chain import Chain, refine
from planner.cell.kinematics.inverse import (
    Corrected,
    InverseKinematics,
    kind_of,
    solve_one,
    solver_of,
    track,
    with_rest,
)
from planner.cell.kinematics.offset_wrist import OffsetWrist, read_offset_wrist
from planner.cell.kinematics.seven_axes import SevenAxes, read_seven_axes
from planner.cell.robot import Robot, chain_of, read_robot, robot_names
from planner.problem import load_problem

TURN = 2.0 * np.pi


@cache
def robot(key: str) -> Robot:
    return read_robot(ROBOTS / f"{key}.yaml")


@cache
def chain(key: str) -> Chain:
    """Base to flange."""
    return chain_of(robot(key), np.eye(4), np.eye(4), robot(key).joint_names, {})


def measured(key: str) -> Chain:
    """The arm as a calibration might find it: each joint a little aside and askew."""
    rng = np.random.default_rng(sum(map(ord, key)))
    ideal = chain(key)
    errors = [
        pin.exp6(np.concatenate([rng.normal(size=3) * 3e-4, rng.normal(size=3) * 1e-3])).homogeneous
        for _ in ideal.names
    ]
    return replace(ideal, placements=ideal.placements @ np.array(errors))


def turned(key: str) -> Chain:
    """The same arm with other link frames: zero elsewhere, some axes pointing the other way, base and tip anywhere."""
    rng = np.random.default_rng(len(key))
    ideal = chain(key)
    placements, before = [], pin.exp6(rng.normal(size=6)).homogeneous
    axes = []
    for place, axis in zip(ideal.placements, ideal.axes[:, :3], strict=True):
        about = pin.exp6(np.concatenate([np.zeros(3), rng.uniform(-3, 3) * axis])).homogeneous  # zero elsewhere
        slide = pin.SE3(pin.exp3(rng.normal(size=3)), rng.normal() * axis).homogeneous  # along the axis, and turned
        placements.append(before @ place @ about @ slide)
        axes.append(slide[:3, :3].T @ axis * rng.choice([-1.0, 1.0]))
        before = np.linalg.inv(slide)
    tip = before @ ideal.T_last_tip @ pin.exp6(rng.normal(size=6)).homogeneous
    return Chain(ideal.names, np.array(placements), np.hstack([axes, np.zeros((len(axes), 3))]), tip)


@cache
def arm(name: str) -> tuple[Chain, InverseKinematics]:
    """A robot by its key, or a variation of it: `iiwa joint 7`, `ur5 turned`, `ur5 measured`."""
    key, _, variation = name.partition(" ")
    ideal = robot(key).inverse
    if ideal is None:
        raise LookupError(name)
    if variation == "joint 7":
        return chain(key), read_seven_axes(chain(key), 6)
    if not variation:
        return chain(key), ideal
    other = turned(key) if variation == "turned" else measured(key)
    joint = ideal.redundant_joint
    read = read_offset_wrist(other) if joint is None else read_seven_axes(other, 6)
    return other, read if variation == "turned" else Corrected(read, other)


ARMS = [key for key in robot_names() if robot(key).inverse is not None]
ALIKE = ("ur3e", "ur10e", "ur16e", "irb1200_07", "irb1600_12")  # as others, but for their lengths
EXACT = [*(key for key in ARMS if key != "xarm7" and key not in ALIKE), "iiwa joint 7", "ur5 turned", "panda turned"]
NEARLY = ["xarm7", "ur5 measured", "ur10 measured", "panda measured", "iiwa measured"]


def given(inverse: InverseKinematics, q: Array) -> Array | None:
    """What `solve` is to be given so that the postures q are among the solutions."""
    return None if inverse.redundant_joint is None else q[..., inverse.redundant_joint]


def random_postures(name: str, m: int, seed: int) -> Array:
    return np.random.default_rng(seed).uniform(-np.pi, np.pi, (m, arm(name)[1].joints))


def apart(a: Array, b: Array) -> Array:
    """Greatest difference of two postures (..., n) in any joint, whole turns aside."""
    return np.asarray(np.abs(np.remainder(a - b + np.pi, TURN) - np.pi).max(axis=-1))


def sigma(joints: Chain, inverse: InverseKinematics, q: Array) -> Array:
    """Least singular value of the Jacobian without the redundant joint: 0 where branches meet."""
    J = joints.jacobians(q)
    if inverse.redundant_joint is not None:
        J = np.delete(J, inverse.redundant_joint, axis=2)
    return np.asarray(np.linalg.svd(J, compute_uv=False)[:, -1])


# --- the arms are those of their URDF ---------------------------------------------------------------------------


@pytest.mark.parametrize("key", ARMS)
def test_poses_are_those_of_pinocchio(key: str) -> None:
    one = robot(key)
    data, frame = one.model.createData(), one.model.getFrameId(one.tip)
    q = random_postures(key, 100, 1)
    own = arm(key)[1].poses(q)
    for posture, T in zip(q, own, strict=True):
        pin.framesForwardKinematics(one.model, data, posture)
        np.testing.assert_allclose(T, data.oMf[frame].homogeneous, rtol=0, atol=1e-10)


def denavit_hartenberg(rows: list[tuple[float, float, float]], q: Array) -> Array:
    """Poses (m, 4, 4) by rows of a, alpha, d, each Rz(q) Tz(d) Tx(a) Rx(alpha); lengths in mm, alpha in deg."""
    T = np.tile(np.eye(4), (len(q), 1, 1))
    for j, (a, alpha, d) in enumerate(rows):
        x = pin.SE3(pin.exp3(np.array([np.radians(alpha), 0.0, 0.0])), np.array([a, 0.0, d]) * 1e-3).homogeneous
        z = np.array([pin.SE3(pin.exp3(np.array([0.0, 0.0, angle])), np.zeros(3)).homogeneous for angle in q[:, j]])
        T = T @ z @ x
    return T


UR_ALPHA = (90, 0, 0, 90, -90, 0)
PUBLISHED = {  # a and d of the makers' Denavit-Hartenberg tables; Franka's are of the modified sort, brought to this one
    "ur3": list(zip((0, -243.65, -213.25, 0, 0, 0), UR_ALPHA, (151.9, 0, 0, 112.35, 85.35, 81.9), strict=True)),
    "ur5": list(zip((0, -425, -392.25, 0, 0, 0), UR_ALPHA, (89.159, 0, 0, 109.15, 94.65, 82.3), strict=True)),
    "ur10": list(zip((0, -612, -572.3, 0, 0, 0), UR_ALPHA, (127.3, 0, 0, 163.941, 115.7, 92.2), strict=True)),
    "ur3e": list(zip((0, -243.55, -213.2, 0, 0, 0), UR_ALPHA, (151.85, 0, 0, 131.05, 85.35, 92.1), strict=True)),
    "ur5e": list(zip((0, -425, -392.2, 0, 0, 0), UR_ALPHA, (162.5, 0, 0, 133.3, 99.7, 99.6), strict=True)),
    "ur10e": list(zip((0, -612.7, -571.55, 0, 0, 0), UR_ALPHA, (180.7, 0, 0, 174.15, 119.85, 116.55), strict=True)),
    "ur16e": list(zip((0, -478.4, -360, 0, 0, 0), UR_ALPHA, (180.7, 0, 0, 174.15, 119.85, 116.55), strict=True)),
    "iiwa": [(0, -90, 360), (0, 90, 0), (0, 90, 420), (0, -90, 0), (0, -90, 400), (0, 90, 0), (0, 0, 126)],
    "panda": [
        (0, -90, 333), (0, 90, 0), (82.5, 90, 316), (-82.5, -90, 0), (0, 90, 384), (88, 90, 0), (0, 0, 107),
    ],
}  # fmt: skip


@pytest.mark.parametrize("key", PUBLISHED)
def test_arms_are_those_of_the_makers_tables(key: str) -> None:
    q = random_postures(key, 50, 2)
    T = denavit_hartenberg(PUBLISHED[key], q)
    if key in ("ur3", "ur5", "ur10"):  # their URDFs' base_link and the controller's base look opposite ways
        T = np.diag([-1.0, -1.0, 1.0, 1.0]) @ T
    np.testing.assert_allclose(arm(key)[1].poses(q), T, rtol=0, atol=1e-9)


def test_the_tip_points_out_of_the_flange() -> None:
    """The last axis and the tip's z are parallel, and the tip lies beyond the last joint."""
    for key in ARMS:
        joints = chain(key)
        turned_axis = joints.T_last_tip[:3, :3].T @ joints.axes[-1, :3]
        np.testing.assert_allclose(np.abs(turned_axis), [0, 0, 1], atol=1e-5, err_msg=key)
        assert joints.T_last_tip[:3, 3] @ joints.T_last_tip[:3, 2] >= 0.0, key


def test_drawn_files_are_up_to_date(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(ROBOTS))  # as for a script in that folder
    drawn = runpy.run_path(str(ROBOTS / "draw_urdf.py"))["files"]()
    assert len(drawn) > 8
    for name, text in drawn.items():
        assert (ROBOTS / name).read_text(encoding="utf-8") == text, f"{name}: run python robots/draw_urdf.py"


def test_fingers_are_no_joints_of_the_arm() -> None:
    assert robot("panda").joint_names == tuple(f"panda_joint{i}" for i in range(1, 8))


# --- all branches, exactly --------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", EXACT)
def test_every_solution_is_exact_and_the_posture_itself_is_one(name: str) -> None:
    joints, inverse = arm(name)
    q = random_postures(name, 3000, 3)
    T = joints.poses(q)
    found, ok = inverse.solve(T, given(inverse, q))
    assert found.shape == (len(q), inverse.branch_count, inverse.joints)
    assert np.abs(found).max() <= np.pi + 1e-12
    rows, branch = np.nonzero(ok)
    assert np.abs(joints.poses(found[rows, branch]) - T[rows]).max() < 1e-9
    np.testing.assert_array_equal(inverse.branches(found[rows, branch]), branch)
    k, own = np.arange(len(q)), inverse.branches(q)
    assert ok[k, own].all()
    assert apart(found[k, own], q).max() < 1e-6  # as a random posture can be close to a singularity
    assert np.median(apart(found[k, own], q)) < 1e-13
    assert inverse.out_of_reach(T, given(inverse, q)).max() == 0.0


@pytest.mark.slow
@pytest.mark.parametrize("name", NEARLY)
def test_nearly_ideal_arms_are_solved_exactly_too(name: str) -> None:
    joints, inverse = arm(name)
    assert isinstance(inverse, Corrected)
    q = random_postures(name, 2000, 4)
    T = joints.poses(q)
    assert np.abs(inverse.nominal.poses(q) - T).max() > 1e-6
    found, ok = inverse.solve(T, given(inverse, q))
    rows, branch = np.nonzero(ok)
    assert np.abs(joints.poses(found[rows, branch]) - T[rows]).max() < 1e-9
    clear = sigma(joints, inverse, q) > 0.05
    assert clear.sum() > 300
    k, own = np.arange(len(q)), inverse.branches(q)
    assert ok[k, own][clear].all()
    assert apart(found[k, own], q)[clear].max() < 1e-9


@pytest.mark.slow(keep=2)
@pytest.mark.parametrize("name", ["ur5", "ur10", "panda", "iiwa", "iiwa joint 7"])
def test_many_starts_of_newton_find_no_other_branch(name: str) -> None:
    """600 random starts a pose; every posture that they reach is one of the closed form's, and none of those misses."""
    joints, inverse = arm(name)
    q = random_postures(name, 12, 5)
    T = joints.poses(q)
    seeds = np.random.default_rng(6).uniform(-np.pi, np.pi, (len(q), 600, len(joints)))
    held = -1 if inverse.redundant_joint is None else inverse.redundant_joint
    if held >= 0:
        seeds[:, :, held] = q[:, None, held]
    found, ok = inverse.solve(T, given(inverse, q))
    for i in range(len(q)):
        there = [
            refine(joints.placements, joints.axes, joints.T_last_tip, held, T[i, :3, :3], T[i, :3, 3], seed, 60)
            for seed in seeds[i]  # each becomes the posture that it leads to
        ]
        own, seen = found[i, ok[i]], seeds[i, there]
        distance = apart(own[:, None], seen[None])
        assert distance.min(axis=0).max() < 1e-6
        assert distance.min(axis=1).max() < 1e-6


@pytest.mark.parametrize("name", [*EXACT, "xarm7"])
def test_compiled_entry_is_the_same(name: str) -> None:
    joints, inverse = arm(name)
    q = random_postures(name, 20, 7)
    T = joints.poses(q)
    values = given(inverse, q)
    found, ok = inverse.solve(T, values)
    one, exists = np.zeros(found.shape[1:]), np.zeros(inverse.branch_count, dtype=np.bool_)
    for i in range(len(q)):
        redundant = np.zeros(1) if values is None else values[i : i + 1]
        solve_one(kind_of(inverse), solver_of(inverse), inverse.parameters, redundant, T[i], one, exists)
        np.testing.assert_array_equal(exists, ok[i])
        np.testing.assert_allclose(one[exists], found[i, ok[i]], rtol=0, atol=1e-12)


@pytest.mark.parametrize("name", ["panda", "iiwa", "xarm7"])
def test_without_an_angle_the_redundant_joint_rests(name: str) -> None:
    joints, inverse = arm(name)
    resting = with_rest(inverse, 0.3)
    T = joints.poses(random_postures(name, 50, 8))
    found, ok = resting.solve(T)
    explicit, also = inverse.solve(T, np.full(50, 0.3))
    np.testing.assert_array_equal(ok, also)
    np.testing.assert_array_equal(found, explicit)
    assert ok.any()
    assert inverse.redundant_joint is not None
    np.testing.assert_allclose(found[ok][:, inverse.redundant_joint], 0.3, atol=1e-12)


# --- along paths ------------------------------------------------------------------------------------------------


def wandering(name: str, m: int, seed: int) -> Array:
    """Smooth random motion (m, n) of all joints."""
    n = arm(name)[1].joints
    rng = np.random.default_rng(seed)
    s = np.linspace(0.0, 1.0, m)[:, None, None]
    waves = np.sin(TURN * (s * rng.uniform(0.5, 2.5, (1, n, 3)) + rng.uniform(0, 1, (1, n, 3))))
    return np.asarray(rng.uniform(-2, 2, n) + (waves * rng.uniform(0.2, 1.0, (1, n, 3))).sum(axis=2))


@pytest.mark.parametrize("name", [*EXACT, "xarm7"])
def test_the_branch_changes_only_in_a_singularity(name: str) -> None:
    joints, inverse = arm(name)
    changes = 0
    for seed in range(4):
        q = wandering(name, 8000, seed)
        b = inverse.branches(q)
        at = np.flatnonzero(b[1:] != b[:-1])
        changes += len(at)
        step = np.abs(np.diff(q, axis=0)).max()
        if len(at):
            # the Jacobian's least singular value passes 0 within the step, so it is small on both sides of it
            assert sigma(joints, inverse, q[at]).max() < 3.0 * step
            J = joints.jacobians(q[np.concatenate([at, at + 1])])
            if inverse.redundant_joint is not None:
                J = np.delete(J, inverse.redundant_joint, axis=2)
            sign = np.sign(np.linalg.det(J)).reshape(2, -1)
            odd = np.array([bin(b[i] ^ b[i + 1]).count("1") % 2 == 1 for i in at])
            np.testing.assert_array_equal(sign[0] != sign[1], odd)  # each bit turns the determinant's sign
    assert changes > 0


@pytest.mark.parametrize("name", ["ur5", "panda", "iiwa", "iiwa joint 7", "xarm7", "irb140"])
def test_tracking_follows_a_path_exactly(name: str) -> None:
    """The longest stretch of a wandering motion without a change of branch comes back as it was, turns and all."""
    joints, inverse = arm(name)
    q = wandering(name, 4000, 11)
    b = inverse.branches(q)
    good = np.split(np.arange(len(q)), np.flatnonzero(b[1:] != b[:-1]) + 1)
    q = q[max(good, key=len)]
    q = q[sigma(joints, inverse, q) > 1e-3]
    assert len(q) > 100
    T = joints.poses(q)
    seen, ok = track(inverse, T, given(inverse, q), q[0])
    assert ok.all()
    assert np.abs(joints.poses(seen) - T).max() < 1e-9
    np.testing.assert_allclose(seen, q, rtol=0, atol=1e-8)


def test_tracking_says_where_there_is_no_posture() -> None:
    joints, inverse = arm("ur5")
    q = np.tile([0.3, -1.2, 1.4, -1.0, -1.5, 0.2], (5, 1))
    T = joints.poses(q)
    T[2, :3, 3] += 5.0
    seen, ok = track(inverse, T, None, q[0] + TURN)
    np.testing.assert_array_equal(ok, [True, True, False, True, True])
    np.testing.assert_allclose(seen, q + TURN, atol=1e-12)


# --- singularities and reach ------------------------------------------------------------------------------------


def singular(name: str) -> dict[str, Callable[[Array], None]]:
    """Ways to push postures into a singularity of the arm, by its own angles."""
    if name.startswith("ur"):
        return {
            "wrist": lambda q: q.__setitem__((slice(None), 4), 0.0),
            "wrist turned over": lambda q: q.__setitem__((slice(None), 4), np.pi),
            "elbow": lambda q: q.__setitem__((slice(None), 2), 0.0),
            "both": lambda q: q.__setitem__((slice(None), [2, 4]), 0.0),
        }
    return {
        "elbow": lambda q: q.__setitem__((slice(None), 3), 0.0),
        "shoulder": lambda q: q.__setitem__((slice(None), 1), 0.0),
        "wrist": lambda q: q.__setitem__((slice(None), 5), 0.0),
        "straight up": lambda q: q.__setitem__((slice(None), [1, 2, 3, 4, 5]), 0.0),
    }


@pytest.mark.parametrize("name", ["ur5", "ur10", "ur3", "panda", "iiwa", "iiwa joint 7", "xarm7", "ur5 measured"])
@pytest.mark.parametrize("hair", [0.0, 1e-15, 1e-12, 1e-9, 1e-7, 1e-4])
def test_beside_singularities_all_is_finite_and_exact(name: str, hair: float) -> None:
    joints, inverse = arm(name)
    rng = np.random.default_rng(12)
    lost = 0
    for push in singular(name).values():
        q = rng.uniform(-np.pi, np.pi, (60, len(joints)))
        push(q)
        q += hair * rng.normal(size=q.shape)
        T = joints.poses(q)
        found, ok = inverse.solve(T, given(inverse, q))
        assert np.isfinite(found).all()
        assert np.isfinite(inverse.out_of_reach(T, given(inverse, q))).all()
        rows, branch = np.nonzero(ok)
        if len(rows):
            assert np.abs(joints.poses(found[rows, branch]) - T[rows]).max() < 2e-8
        lost += int((~ok.any(axis=1)).sum())
    if name in ("panda", "iiwa", "iiwa joint 7"):
        assert lost == 0


def test_axis_6_parallel_to_axis_2_has_q6_at_zero() -> None:
    joints, inverse = arm("ur5")
    q = np.array([[0.4, -1.1, 1.3, -0.7, 0.0, 0.0], [0.4, -1.1, 1.3, -0.7, 0.0, 1.1]])
    T = joints.poses(q)
    found, ok = inverse.solve(T)
    own = inverse.branches(q)
    assert ok[[0, 1], own].all()
    np.testing.assert_allclose(found[0, own[0]], q[0], atol=1e-9)
    assert found[1, own[1], 5] == 0.0
    np.testing.assert_allclose(joints.poses(found[[1], own[1]]), T[1:], atol=1e-9)


@pytest.mark.parametrize("name", ["ur5", "ur10", "panda", "iiwa", "iiwa joint 7"])
def test_out_of_reach_is_said_and_measured(name: str) -> None:
    """Poses moved outwards: the gap is positive where no posture exists, and there only."""
    joints, inverse = arm(name)
    q = random_postures(name, 300, 13)
    T = joints.poses(q)
    for shift in (0.02, 0.3, 2.0):
        moved = T.copy()
        outwards = T[:, :3, 3] / np.linalg.norm(T[:, :3, 3], axis=1)[:, None]
        moved[:, :3, 3] += shift * outwards
        gap, (_, ok) = inverse.out_of_reach(moved, given(inverse, q)), inverse.solve(moved, given(inverse, q))
        np.testing.assert_array_equal(gap > 1e-9, ~ok.any(axis=1))
        if shift == 2.0:  # far out it is nearly the distance moved, less what was left to go
            assert gap.min() > 0.3
            assert gap.max() < 1.01 * shift


# --- cells and their files --------------------------------------------------------------------------------------

HOMES = {
    "ur5": "[0, -90, 90, -90, -90, 0]",
    "panda": "[0, -45, 0, -135, 0, 90, 45]",
    "iiwa": "[0, 30, 0, -90, 0, 60, 0]",
    "irb1600_145": "[0, 0, 0, 0, 30, 0]",
}


@pytest.mark.parametrize("key", HOMES)
def test_cells_are_built_with_these_arms(key: str) -> None:
    cell = build_cell(load_problem("cylinder_logo", [f"cell.arm={key}", f"cell.home_deg={HOMES[key]}"]))
    n = robot(key).model.nq
    assert len(cell.arm) == n
    assert len(cell.home) == len(cell.limits.q_min) == n + 1
    assert (cell.limits.velocity > 0.0).all()
    home = cell.home[None, :n]
    T_world_nozzle = cell.arm.poses(home)
    T_base_flange = np.linalg.inv(cell.T_world_base) @ T_world_nozzle @ np.linalg.inv(cell.T_flange_nozzle)
    found, ok = cell.inverse.solve(T_base_flange)  # the redundant joint rests where home has it
    branch = cell.inverse.branches(home)[0]
    assert ok[0, branch]
    assert apart(found[0, branch], home[0]) < 1e-12


def test_what_needs_a_spherical_wrist_is_refused_by_name() -> None:
    cell = build_cell(load_problem("cylinder_logo", ["cell.arm=ur5", f"cell.home_deg={HOMES['ur5']}"]))
    with pytest.raises(Refusal, match="UR5"):
        _ = cell.wrist


def test_home_has_as_many_angles_as_the_arm() -> None:
    problem = load_problem("cylinder_logo", ["cell.arm=panda"])
    with pytest.raises(InputError, match="7 joints, not 6") as caught:
        build_cell(problem)
    assert caught.value.field == "cell.home_deg"
    assert caught.value.file == problem.file
    assert caught.value.hint is not None
    assert "panda_joint7" in caught.value.hint


UR5 = (ROBOTS / "ur5.yaml").read_text(encoding="utf-8")
PANDA = (ROBOTS / "panda.yaml").read_text(encoding="utf-8")
IRB140 = (ROBOTS / "irb140.yaml").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("text", "change", "field", "said"),
    [
        (UR5, ("tip: tool0", "tip: tool1"), "tip", "did you mean tool0?"),
        (UR5, ("tip: tool0", ""), "tip", "is missing"),
        (UR5, ("tip:", "tipp:"), "tipp", "did you mean tip?"),
        (UR5, ("package: example-robot-data", "package: example-robot-date"), "urdf", "not installed"),
        (UR5, ("ur5_robot.urdf", "ur55_robot.urdf"), "urdf", "no file ur55_robot.urdf"),
        (UR5, ("{package: example-robot-data, path: ", "{file: "), "urdf", "a package and a path"),
        (UR5, ("[10, 10, 10, 15, 15, 15]", "[10, 10, 10]"), "acceleration_rad_s2", "6 positive numbers"),
        (UR5, ("[10, 10, 10, 15, 15, 15]", "[10, 10, 10, 15, 15, 0]"), "acceleration_rad_s2", "6 positive numbers"),
        (UR5, ("[500, 500, 500, 750, 750, 750]", "[a, b, c, d, e, f]"), "jerk_rad_s3", "6 positive numbers"),
        (UR5, ("offset_wrist", "ofset_wrist"), "inverse_kinematics", "known: spherical_wrist"),
        (UR5, ("offset_wrist", "seven_axes"), "inverse_kinematics", "redundant_joint"),
        (UR5, ("inverse_kinematics: offset_wrist", "redundant_joint: a\ninverse_kinematics: offset_wrist"),
         "redundant_joint", "only such an arm"),
        (UR5, ("robots/ur_description/urdf/ur5_robot", "robots/kinova_description/robots/kinova"), "tip", "no link"),
        (PANDA, ("redundant_joint: panda_joint7", "redundant_joint: panda_joint3"), "inverse_kinematics", "joint 7"),
        (PANDA, ("redundant_joint: panda_joint7", "redundant_joint: panda_joint8"), "redundant_joint", "panda_joint7"),
        (IRB140, ("urdf: irb140.urdf", f"urdf: {ROBOTS}/iiwa.urdf"), "acceleration_rad_s2", "7 positive numbers"),
        (IRB140, ("c4_mm: 65", "c4_mm: 66"), "spherical_wrist", "disagree"),
        (IRB140, (", c4_mm: 65", ""), "spherical_wrist", "c4_mm"),
        (IRB140, ("c4_mm: 65", "c4_mm: long"), "spherical_wrist", "numbers"),
        (IRB140, ("spherical_wrist: {", "inverse_kinematics: offset_wrist\nspherical_wrist: {"),
         "inverse_kinematics", "given as well"),
    ],
)  # fmt: skip
def test_mistakes_in_a_robot_file_are_told_with_their_line(
    text: str, change: tuple[str, str], field: str, said: str, tmp_path: Path
) -> None:
    assert change[0] in text
    file = tmp_path / "own.yaml"
    file.write_text(text.replace(*change).replace("urdf: irb140.urdf", f"urdf: {ROBOTS}/irb140.urdf"), encoding="utf-8")
    with pytest.raises(InputError) as caught:
        read_robot(file)
    error = caught.value
    assert error.file == file
    assert error.field == field
    assert said in str(error)
    lines = file.read_text(encoding="utf-8").splitlines()
    if "is missing" not in said:
        assert error.line is not None
        assert lines[error.line - 1].startswith(field)


def test_an_arm_of_another_kind_is_refused_with_the_reason(tmp_path: Path) -> None:
    file = tmp_path / "own.yaml"
    text = IRB140.replace("urdf: irb140.urdf", f"urdf: {ROBOTS}/irb140.urdf")
    kind = "inverse_kinematics: offset_wrist"
    file.write_text("\n".join(kind if "spherical_wrist" in row else row for row in text.splitlines()), encoding="utf-8")
    with pytest.raises(InputError, match="axes 1 and 2 pass each other by 70"):
        read_robot(file)


@pytest.mark.parametrize("text", ["a: [1, 2", "- 1\n- 2\n", ""])
def test_a_robot_file_that_is_no_yaml_mapping(text: str, tmp_path: Path) -> None:
    file = tmp_path / "own.yaml"
    file.write_text(text, encoding="utf-8")
    with pytest.raises(InputError) as caught:
        read_robot(file)
    assert caught.value.file == file


def test_kinds_of_the_shipped_arms() -> None:
    kinds = {key: type(robot(key).inverse) for key in ("ur3", "ur5", "ur10", "panda", "iiwa", "xarm7")}
    assert kinds == {
        **dict.fromkeys(("ur3", "ur5", "ur10"), OffsetWrist),
        **dict.fromkeys(("panda", "iiwa"), SevenAxes),
        "xarm7": Corrected,
    }


def test_a_wrist_that_nearly_meets_is_refined_where_joint_3_is_given(tmp_path: Path) -> None:
    """Axis 7 passes axes 5 and 6 by 3 mm: the closed form cannot know to which side, and all else is exact."""
    before, behind = (ROBOTS / "iiwa.urdf").read_text(encoding="utf-8").split('<joint name="joint_7"')
    beside = behind.replace('<origin xyz="0 0 0"/>', '<origin xyz="0.003 0 0"/>', 1)
    assert beside != behind
    (tmp_path / "iiwa.urdf").write_text(f'{before}<joint name="joint_7"{beside}', encoding="utf-8")
    file = tmp_path / "own.yaml"
    file.write_text((ROBOTS / "iiwa.yaml").read_text(encoding="utf-8"), encoding="utf-8")
    one = read_robot(file)
    assert isinstance(one.inverse, Corrected)
    q = np.random.default_rng(3).uniform(-2.0, 2.0, (200, 7))
    T = chain_of(one, np.eye(4), np.eye(4), one.joint_names, {}).poses(q)
    found, ok = one.inverse.solve(T, q[:, 2])
    rows, branch = np.nonzero(ok)
    np.testing.assert_allclose(one.inverse.poses(found[rows, branch]), T[rows], rtol=0, atol=1e-9)
    assert ok.any(axis=1).mean() > 0.9
