"""Arms whose axes 4 and 6 pass each other: all postures, against Newton's method; their numbers, along paths."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from planner.base.arrays import Array
from planner.cell.kinematics.axes import OtherGeometry
from planner.cell.kinematics.chain import Chain, refine
from planner.cell.kinematics.inverse import branches_of, kind_of, solve_one, solver_of
from planner.cell.kinematics.skew_wrist import SkewWrist, read_skew_wrist

pytestmark = pytest.mark.slow  # the kernels of these arms alone take some 17 s to compile

X, Y, Z = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
SIGMA = 0.01  # least singular value below which two postures are about to meet
# by the makers' data sheets [m]: where each joint stands in the one before, and the flange behind the last one
ARMS = {
    "Fanuc CRX-10iA": ((0, 0, 0.245), (0, 0, 0), (0, 0, 0.54), (0, 0, 0), (0.54, 0, 0), (0, -0.15, 0), (0.16, 0, 0)),
    "Yaskawa HC10": ((0, 0, 0.275), (0, 0, 0), (0, 0, 0.7), (0, 0, 0), (0.5, 0, 0), (0, -0.162, 0), (0.13, 0, 0)),
    "ABB CRB 15000": ((0, 0, 0.265), (0, 0, 0), (0, 0, 0.444), (0, 0, 0.11), (0.47, 0, 0), (0, 0, 0.08), (0.101, 0, 0)),
    "Fanuc M-430iA": ((0, 0, 0.35), (0, 0, 0), (0, 0, 0.35), (0, 0, 0), (0.35, 0, 0), (0, -0.095, 0), (0.08, 0, 0)),
}
AXES = (Z, Y, Y, X, Y, X)


def chain(places: object, axes: object = AXES) -> Chain:
    rows = np.asarray(places, dtype=np.float64)
    T = np.tile(np.eye(4), (7, 1, 1))
    T[:, :3, 3] = rows
    turns = np.zeros((6, 6))
    turns[:, :3] = np.asarray(axes)
    return Chain(tuple(f"joint_{k}" for k in range(1, 7)), T[:6].copy(), turns, T[6].copy())


def arm(name: str) -> tuple[Chain, SkewWrist]:
    joints = chain(ARMS[name])
    return joints, read_skew_wrist(joints)


def apart(a: Array, b: Array) -> Array:
    return np.asarray(np.abs(np.remainder(a - b + np.pi, 2 * np.pi) - np.pi).max(axis=-1))


def sigma(joints: Chain, q: Array) -> Array:
    return np.asarray(np.linalg.svd(joints.jacobians(q), compute_uv=False)[:, -1])


def missed(joints: Chain, inverse: SkewWrist, q: Array) -> Array:
    """Which of postures q (m, 6), clear of singularities, are not among those of their poses; all of these are exact."""
    T = joints.poses(q)
    found, ok = inverse.solve(T)
    np.testing.assert_allclose(joints.poses(found[ok]), np.repeat(T, ok.sum(axis=1), axis=0), rtol=0, atol=1e-10)
    nearest = np.where(ok, apart(found, q[:, None]), np.inf).min(axis=1)
    return np.asarray((nearest > 1e-5) & (sigma(joints, q) > SIGMA))


@pytest.mark.parametrize("name", ARMS)
def test_a_posture_is_among_those_of_its_pose(name: str) -> None:
    joints, inverse = arm(name)
    q = np.random.default_rng(0).uniform(-np.pi, np.pi, (3000, 6))
    assert missed(joints, inverse, q).sum() == 0
    counts = inverse.solve(joints.poses(q))[1].sum(axis=1)
    assert counts.max() == 16  # as many as six axes can have


@pytest.mark.parametrize("name", ARMS)
def test_postures_in_the_arms_own_plane_are_found(name: str) -> None:
    """With joint 4 at 0 axes 2, 3 and 5 are parallel: joint 1 alone leaves joint 5 open there."""
    joints, inverse = arm(name)
    rng = np.random.default_rng(1)
    q = rng.uniform(-np.pi, np.pi, (600, 6))
    q[:, 3] = rng.choice([0.0, np.pi], 600)
    q[200:400, 3] += 10.0 ** rng.uniform(-8.0, -1.0, 200)
    q[400:, 4] = 10.0 ** rng.uniform(-8.0, -1.0, 200)
    assert missed(joints, inverse, q).sum() == 0


@pytest.mark.parametrize("name", ARMS)
def test_beside_singularities_nothing_is_lost_that_is_not_about_to_vanish(name: str) -> None:
    """Pairs of postures that are about to meet: along the way on which joint 3 takes the arm towards a singularity."""
    joints, inverse = arm(name)
    rng = np.random.default_rng(2)
    start = rng.uniform(-np.pi, np.pi, (40, 6))
    q = np.repeat(start, 200, axis=0)
    q[:, 2] += np.tile(np.linspace(-np.pi, np.pi, 200), 40)
    near = sigma(joints, q) < 0.05
    assert near.sum() > 500
    assert missed(joints, inverse, q[near]).sum() == 0


@pytest.mark.parametrize("name", ARMS)
def test_many_starts_of_newton_find_no_other_posture(name: str) -> None:
    joints, inverse = arm(name)
    rng = np.random.default_rng(3)
    T = joints.poses(rng.uniform(-np.pi, np.pi, (6, 6)))
    found, ok = inverse.solve(T)
    for i in range(len(T)):
        seeds = rng.uniform(-np.pi, np.pi, (400, 6))
        there = [
            refine(joints.placements, joints.axes, joints.T_last_tip, -1, T[i, :3, :3], T[i, :3, 3], seed, 60)
            for seed in seeds  # each becomes the posture that it leads to
        ]
        seen = seeds[there]
        seen = seen[sigma(joints, seen) > SIGMA]
        assert apart(found[i, ok[i]][:, None], seen[None]).min(axis=0).max() < 1e-5


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_axis_6_may_be_anywhere(seed: int) -> None:
    """Any lengths, offsets and senses of axes; axis 6 in any direction, at any distance; axis 1 not square to the base."""
    rng = np.random.default_rng(seed)
    places = rng.uniform(-0.3, 0.3, (7, 3))
    places[2, [0, 2]] = rng.uniform(0.15, 0.8, 2)
    places[4] = [rng.uniform(0.2, 0.8), 0.0, 0.0]  # axis 5 meets axis 4
    axes = np.array(AXES)
    axes[5] = rng.normal(size=3)
    axes[5] /= np.linalg.norm(axes[5])
    axes *= rng.choice([-1.0, 1.0], (6, 1))
    joints = chain(places, axes)
    e = places[5] - (places[5] @ axes[5]) * axes[5]
    if np.linalg.norm(e) < 0.02:
        return
    inverse = read_skew_wrist(joints)
    lost = missed(joints, inverse, rng.uniform(-np.pi, np.pi, (40, 6)))
    assert lost.sum() == 0


def test_an_arm_as_it_was_measured_is_solved_exactly() -> None:
    """Axes that are square and meet up to 2 mm and 3 mrad: the ideal arm's postures, made exact on the true chain."""
    rng = np.random.default_rng(4)
    axes = np.array(AXES) + rng.normal(scale=2e-3, size=(6, 3))
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    joints = chain(np.array(ARMS["ABB CRB 15000"]) + rng.normal(scale=1e-3, size=(7, 3)), axes)
    inverse = read_skew_wrist(joints)
    q = rng.uniform(-np.pi, np.pi, (1000, 6))
    q = q[sigma(joints, q) > 0.05]
    assert missed(joints, inverse, q).mean() < 0.01


@pytest.mark.parametrize(
    ("row", "place", "said"),
    [
        (4, (0.54, 0, 0.08), "axes 4 and 5 pass each other by 80.0 mm"),
        (5, (0.0, 0.0, 0.0), "meet in one point"),
    ],
)
def test_other_arms_are_none_of_these(row: int, place: tuple[float, float, float], said: str) -> None:
    places = np.array(ARMS["Fanuc CRX-10iA"])
    places[row] = place
    with pytest.raises(OtherGeometry, match=said):
        read_skew_wrist(chain(places))


# --- numbers of postures ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ARMS)
def test_a_postures_number_is_its_index(name: str) -> None:
    joints, inverse = arm(name)
    q = np.random.default_rng(5).uniform(-np.pi, np.pi, (300, 6))
    found, ok = inverse.solve(joints.poses(q))
    pose, index = np.nonzero(ok)
    own = found[pose, index]
    clear = sigma(joints, own) > SIGMA
    np.testing.assert_array_equal(inverse.branches(own)[clear], index[clear])
    one, exists = np.zeros((16, 6)), np.zeros(16, dtype=np.bool_)
    T = joints.poses(q[:1])[0]
    assert branches_of(kind_of(inverse)) == 16
    solve_one(kind_of(inverse), solver_of(inverse), inverse.parameters, np.zeros(1), T, one, exists)
    np.testing.assert_array_equal(exists, ok[0])


@pytest.mark.parametrize("name", ARMS)
def test_a_number_seldom_changes_clear_of_singularities(name: str) -> None:
    """Along random smooth ways of 100 steps without a singularity; where it changes, it is where the arm is stretched, its
    wrist above axis 1, or two postures share a label."""
    joints, inverse = arm(name)
    rng = np.random.default_rng(6)
    ways, steps = 200, 100
    t = np.linspace(0.0, 1.0, steps)[:, None]
    q = np.concatenate(
        [
            start + rng.normal(scale=0.3, size=6) * t + rng.normal(scale=0.2, size=6) * np.sin(3.0 * t)
            for start in rng.uniform(-np.pi, np.pi, (ways, 6))
        ]
    )
    J = joints.jacobians(q)
    det = np.linalg.det(J).reshape(ways, steps)
    regular = (np.linalg.svd(J, compute_uv=False)[:, -1].reshape(ways, steps) > 0.05).all(axis=1)
    regular &= (np.sign(det) == np.sign(det[:, :1])).all(axis=1)
    number = inverse.branches(q).reshape(ways, steps)[regular]
    assert len(number) > 40
    changes = (np.diff(number, axis=1) != 0).any(axis=1)
    print(name, f"{changes.sum()} of {len(number)} ways")
    assert changes.mean() < 0.15
