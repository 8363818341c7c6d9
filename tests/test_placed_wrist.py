"""Spherical wrists read off URDFs: public arms, and arms with whatever zero, senses of axes and frames."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from planner.base.arrays import Array
from planner.base.errors import InputError
from planner.base.shipped import ROBOTS
from planner.cell.kinematics.axes import OtherGeometry
from planner.cell.kinematics.chain import Chain, refine
from planner.cell.kinematics.inverse import Corrected, kind_of, solve_one, solver_of
from planner.cell.kinematics.placed_wrist import PlacedWrist, read_spherical_wrist
from planner.cell.kinematics.spherical_wrist import SphericalWrist
from planner.cell.robot import Robot, base_to_tip, chain_of, read_robot
from planner.cell.urdf import model_of, parse_urdf
from planner.robots.listing import reach
from tests.public_arms import ARMS, LEVEL, PublicArm, kuka, urdf_of

TURN = 2.0 * np.pi
TEXT = """\
name: {name}
urdf: arm.urdf
tip: tool0
inverse_kinematics: spherical_wrist
acceleration_rad_s2: [10, 10, 10, 15, 15, 15]
jerk_rad_s3: [500, 500, 500, 750, 750, 750]
"""


def chain_from(arm: PublicArm) -> Chain:
    """Base to tip, by Pinocchio's reading of its URDF."""
    return base_to_tip(model_of(parse_urdf(urdf_of(arm).encode(), Path("arm.urdf")), "tool0", {}, False), "tool0")


def robot_from(arm: PublicArm, folder: Path) -> Robot:
    (folder / "arm.urdf").write_text(urdf_of(arm), encoding="utf-8")
    (folder / "arm.yaml").write_text(TEXT.format(name="arm"), encoding="utf-8")
    return read_robot(folder / "arm.yaml")


def apart(a: Array, b: Array) -> Array:
    """Greatest difference of two postures (..., n) in any joint, whole turns aside."""
    return np.asarray(np.abs(np.remainder(a - b + np.pi, TURN) - np.pi).max(axis=-1))


def newton(chain: Chain, T: Array, starts: int, seed: int) -> Array:
    """Postures that Newton's method reaches for a pose from random starts."""
    seeds = np.random.default_rng(seed).uniform(-np.pi, np.pi, (starts, len(chain)))
    there = [
        refine(chain.placements, chain.axes, chain.T_last_tip, -1, T[:3, :3], T[:3, 3], each, 60) for each in seeds
    ]
    return seeds[there]


# --- public arms ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ARMS)
def test_lengths_of_public_arms_are_those_of_data_sheets(name: str) -> None:
    read = read_spherical_wrist(chain_from(ARMS[name]))
    np.testing.assert_allclose(read.parameters[:7] * 1e3, ARMS[name].lengths, rtol=0, atol=1e-6)


@pytest.mark.slow(keep=3)
@pytest.mark.parametrize("name", ARMS)
def test_public_arms_load_and_all_their_branches_are_exact(name: str, tmp_path: Path) -> None:
    robot = robot_from(ARMS[name], tmp_path)
    chain, inverse = chain_of(robot, np.eye(4), np.eye(4), robot.joint_names, {}), robot.inverse
    assert isinstance(inverse, PlacedWrist | Corrected)
    q = np.random.default_rng(1).uniform(-np.pi, np.pi, (1000, 6))
    T = chain.poses(q)
    found, ok = inverse.solve(T)
    rows, branch = np.nonzero(ok)
    assert np.abs(chain.poses(found[rows, branch]) - T[rows]).max() < 1e-9
    np.testing.assert_array_equal(inverse.branches(found[rows, branch]), branch)
    own = inverse.branches(q)
    assert ok[np.arange(len(q)), own].all()
    assert np.median(apart(found[np.arange(len(q)), own], q)) < 1e-12
    assert inverse.out_of_reach(T).max() < 1e-9
    if ARMS[name].reach is not None:
        assert reach(robot) == pytest.approx(ARMS[name].reach * 1e-3, abs=2e-3)


@pytest.mark.parametrize("name", ["KUKA KR 16-2", "Fanuc M-10iA", "Yaskawa MotoMini", "Stäubli TX2-90"])
def test_newton_finds_no_other_posture_of_public_arms(name: str) -> None:
    chain = chain_from(ARMS[name])
    read = read_spherical_wrist(chain)
    for i, q in enumerate(np.random.default_rng(2).uniform(-np.pi, np.pi, (4, 6))):
        T = chain.poses(q[None])
        found, ok = read.solve(T)
        seen = newton(chain, T[0], 400, i)
        distance = apart(found[0, ok[0]][:, None], seen[None])
        assert distance.min(axis=0).max() < 1e-6
        assert distance.min(axis=1).max() < 1e-6


def test_the_flange_may_leave_along_any_axis_of_its_frame() -> None:
    """The MH5's last link has its x along axis 6: what is read is the same arm, its end frame turned."""
    read = read_spherical_wrist(chain_from(ARMS["Yaskawa MH5"]))
    np.testing.assert_allclose(np.abs(read.T_end_flange[:3, 0]), [0, 0, 1], atol=1e-12)


def test_a_base_that_was_drawn_lying_is_upright_where_its_urdf_has_it_so() -> None:
    chain, lying = chain_from(ARMS["KUKA KR 6 R700 sixx"]), np.eye(4)
    lying[:3, :3] = pin.rpy.rpyToMatrix(np.pi / 2, 0.0, 0.0)
    upright = read_spherical_wrist(chain).parameters
    np.testing.assert_allclose(read_spherical_wrist(chain, lying).parameters, upright, rtol=0, atol=1e-12)


# --- whatever zero, senses and frames ---------------------------------------------------------------------------


def anywhere(lengths: SphericalWrist, seed: int, twist: float = 0.0) -> Chain:
    """An arm of these lengths in frames that nobody chose: zero elsewhere, axes either way, link frames turned and slid
    along their axes, base and tip anywhere; twist: of axes against where they ought to be [m, rad]."""
    rng = np.random.default_rng(seed)
    a1, a2, b, c1, c2, c3, c4 = lengths.parameters
    places = np.array([[0, 0, 0], [a1, 0, c1], [0, b, c2], [0, 0, -a2], [c3, 0, 0], [0, 0, 0]], dtype=float)
    axes = np.array([[0, 0, 1], [0, 1, 0], [0, 1, 0], [1, 0, 0], [0, 1, 0], [1, 0, 0]], dtype=float)
    before = pin.exp6(rng.normal(size=6)).homogeneous
    placements, directions = [], []
    for place, axis in zip(places, axes, strict=True):
        T = np.eye(4)
        T[:3, 3] = place
        about = pin.exp6(np.concatenate([np.zeros(3), rng.uniform(-np.pi, np.pi) * axis])).homogeneous
        slide = pin.SE3(pin.exp3(rng.normal(size=3)), rng.normal() * 0.3 * axis).homogeneous
        askew = pin.exp6(twist * rng.normal(size=6)).homogeneous
        placements.append(before @ T @ askew @ about @ slide)
        directions.append(slide[:3, :3].T @ axis * rng.choice([-1.0, 1.0]))
        before = np.linalg.inv(slide)
    end = np.eye(4)
    end[:3, :3], end[0, 3] = pin.exp3(np.array([0.0, np.pi / 2, 0.0])), c4
    tip = before @ end @ pin.exp6(np.concatenate([np.zeros(3), rng.normal(size=3)])).homogeneous
    return Chain(tuple(f"j{k}" for k in range(6)), np.array(placements), np.hstack([directions, np.zeros((6, 3))]), tip)


mm = st.integers
LENGTHS = st.builds(
    lambda a1, a2, b, c1, c2, c3, c4: SphericalWrist(*(value * 1e-3 for value in (a1, a2, b, c1, c2, c3, c4))),
    mm(0, 400), mm(-300, 100), mm(-60, 60), mm(100, 900), mm(150, 1300), mm(150, 1600), mm(20, 300),
)  # fmt: skip


@given(LENGTHS, st.integers(0, 10**6))
@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.too_slow])
def test_any_frames_give_the_same_arm(lengths: SphericalWrist, seed: int) -> None:
    chain = anywhere(lengths, seed)
    read = read_spherical_wrist(chain)
    # signs of lengths are a matter of how joints are counted; c1 and c4 depend on where base and tip were put
    np.testing.assert_allclose(
        np.abs(read.parameters[[0, 2, 4, 5]]), np.abs(lengths.parameters[[0, 2, 4, 5]]), atol=1e-9
    )
    q = np.random.default_rng(seed).uniform(-np.pi, np.pi, (40, 6))
    T = chain.poses(q)
    np.testing.assert_allclose(read.poses(q), T, rtol=0, atol=1e-9)
    found, ok = read.solve(T)
    rows, branch = np.nonzero(ok)
    assert np.abs(chain.poses(found[rows, branch]) - T[rows]).max() < 1e-8
    np.testing.assert_array_equal(read.branches(found[rows, branch]), branch)
    own = read.branches(q)
    assert ok[np.arange(len(q)), own].all()
    J = chain.jacobians(q)
    clear = np.linalg.svd(J, compute_uv=False)[:, -1] > 1e-3
    assert apart(found[np.arange(len(q)), own], q)[clear].max(initial=0.0) < 1e-6


@given(LENGTHS, st.integers(0, 10**6))
@settings(max_examples=8, deadline=None, suppress_health_check=[HealthCheck.too_slow])
def test_newton_finds_no_posture_that_is_missed(lengths: SphericalWrist, seed: int) -> None:
    chain = anywhere(lengths, seed)
    read = read_spherical_wrist(chain)
    q = np.random.default_rng(seed).uniform(-np.pi, np.pi, (1, 6))
    T = chain.poses(q)
    found, ok = read.solve(T)
    seen = newton(chain, T[0], 150, seed)
    regular = np.linalg.svd(chain.jacobians(seen), compute_uv=False)[:, -1] > 1e-3
    distance = apart(found[0, ok[0]][:, None], seen[regular][None])
    assert distance.min(axis=0).max(initial=0.0) < 1e-5


@pytest.mark.parametrize("seed", range(5))
def test_measured_arms_are_refined(seed: int, tmp_path: Path) -> None:
    """Axes that miss each other by tenths of a millimetre: the branches are the ideal arm's, the poses exact."""
    chain = anywhere(SphericalWrist(0.15, -0.115, 0.0, 0.445, 0.7, 0.795, 0.085), seed, twist=3e-4)
    read = read_spherical_wrist(chain)
    q = np.random.default_rng(seed).uniform(-np.pi, np.pi, (500, 6))
    T = chain.poses(q)
    assert np.abs(read.poses(q) - T).max() > 1e-5
    found, ok = Corrected(read, chain).solve(T)
    rows, branch = np.nonzero(ok)
    assert np.abs(chain.poses(found[rows, branch]) - T[rows]).max() < 1e-9
    clear = np.linalg.svd(chain.jacobians(q), compute_uv=False)[:, -1] > 0.05
    own = read.branches(q)
    assert ok[np.arange(len(q)), own][clear].all()
    assert apart(found[np.arange(len(q)), own], q)[clear].max() < 1e-9


def test_compiled_entry_is_the_same() -> None:
    chain = chain_from(ARMS["KUKA KR 10 R1420"])
    read = read_spherical_wrist(chain)
    T = chain.poses(np.random.default_rng(7).uniform(-np.pi, np.pi, (20, 6)))
    found, ok = read.solve(T)
    one, exists = np.zeros((8, 6)), np.zeros(8, dtype=np.bool_)
    for i in range(len(T)):
        solve_one(kind_of(read), solver_of(read), read.parameters, np.zeros(1), T[i], one, exists)
        np.testing.assert_array_equal(exists, ok[i])
        np.testing.assert_allclose(one[exists], found[i, ok[i]], rtol=0, atol=1e-12)


# --- what is as the shipped ones, and what is refused -----------------------------------------------------------


def test_a_shipped_arm_is_read_as_its_own_lengths(tmp_path: Path) -> None:
    text = (ROBOTS / "irb2600.yaml").read_text(encoding="utf-8")
    rows = [
        "inverse_kinematics: spherical_wrist" if row.startswith("spherical_wrist") else row for row in text.splitlines()
    ]
    file = tmp_path / "own.yaml"
    file.write_text("\n".join(rows).replace("urdf: ", f"urdf: {ROBOTS}/"), encoding="utf-8")
    own, shipped = read_robot(file).inverse, read_robot(ROBOTS / "irb2600.yaml").inverse
    assert isinstance(own, SphericalWrist)
    assert isinstance(shipped, SphericalWrist)
    np.testing.assert_allclose(own.parameters, shipped.parameters, rtol=0, atol=1e-12)


@pytest.mark.parametrize(
    ("exact", "rounded", "kind"),
    [
        ("1.5707963267948966", "1.5708", PlacedWrist),
        ('<origin xyz="0.795 0 0"/>', '<origin xyz="0.795 0 0" rpy="0 0 0.00001"/>', Corrected),
    ],
    ids=["tip", "joint 5"],
)
def test_lengths_are_taken_though_the_urdf_is_rounded(tmp_path: Path, exact: str, rounded: str, kind: type) -> None:
    """A tip at 1.5708 instead of a quarter turn, 4 um at the flange's x and z, is one of the frames that are read off: such
    an arm has programs that tell postures. One with a joint that is askew has the closed form of another arm."""
    text = (ROBOTS / "irb2600.yaml").read_text(encoding="utf-8")
    urdf = (ROBOTS / "irb2600.urdf").read_text(encoding="utf-8")
    (tmp_path / "irb2600.urdf").write_text(urdf.replace(exact, rounded), encoding="utf-8")
    assert rounded in (tmp_path / "irb2600.urdf").read_text(encoding="utf-8")
    (tmp_path / "own.yaml").write_text(text, encoding="utf-8")
    assert type(read_robot(tmp_path / "own.yaml").inverse) is kind


def test_lengths_of_another_zero_are_refused_with_the_way_out(tmp_path: Path) -> None:
    lengths = "{a1_mm: 150, a2_mm: -20, b_mm: 0, c1_mm: 450, c2_mm: 610, c3_mm: 660, c4_mm: 80}"
    (tmp_path / "arm.urdf").write_text(urdf_of(ARMS["KUKA KR 10 R1420"]), encoding="utf-8")
    text = TEXT.format(name="arm").replace("inverse_kinematics: spherical_wrist", f"spherical_wrist: {lengths}")
    (tmp_path / "arm.yaml").write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match="inverse_kinematics: spherical_wrist reads them off") as caught:
        read_robot(tmp_path / "arm.yaml")
    assert caught.value.field == "spherical_wrist"


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({4: ((0.66, 0.05, 0), (0, 1, 0)), 5: ((0.08, 0.162, 0), (-1, 0, 0))}, "4 and 6 are 212 mm apart along axis 5"),
        ({5: ((0.08, 0, 0.08), (-1, 0, 0))}, "axes 5 and 6 pass each other by 80.0 mm"),
        ({2: ((0.61, 0, 0), (0, 0, 1))}, "axes 2 and 3 are not parallel"),
        ({1: ((0.15, 0, 0), (0, 0, 1)), 2: ((0.61, 0, 0), (0, 0, 1))}, "axes 1 and 2 are not square"),
    ],
)
def test_other_arms_are_refused_with_what_they_lack(change: dict[int, object], said: str) -> None:
    arm = ARMS["KUKA KR 10 R1420"]
    rows = tuple(change.get(k, row) for k, row in enumerate(arm.rows))
    with pytest.raises(OtherGeometry, match=said):
        read_spherical_wrist(chain_from(replace(arm, rows=rows)))  # type: ignore[arg-type]


def test_an_arm_without_an_upper_arm_is_refused() -> None:
    arm = replace(ARMS["KUKA KR 10 R1420"], rows=kuka(450, 150, 0, 20, 660, 80), tip=LEVEL)
    with pytest.raises(OtherGeometry, match="three different places"):
        read_spherical_wrist(chain_from(arm))
