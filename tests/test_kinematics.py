"""Kinematics: chains and the closed-form wrist against Pinocchio, brute force and finite differences."""

from __future__ import annotations

import itertools

import numpy as np
import pinocchio as pin
import pytest

from planner.base.arrays import Array
from planner.cell.cell import Cell, build_cell
from planner.cell.kinematics.chain import invert6, largest_singular_value
from planner.cell.kinematics.spherical_wrist import (
    SphericalWrist,
    inverse_jacobian,
    jacobian,
    sines_of,
    solve_within,
)
from planner.problem import load_problem

# mm, FACTS' table: a1 a2 b c1 c2 c3 c4. The last one is no robot that ships: it has every offset there is.
OPW = {
    "IRB 140": (70, 0, 0, 352, 360, 380, 65),
    "IRB 1200-5/0.9": (0, -42, 0, 399.1, 448, 451, 82),
    "IRB 2600-20/1.65": (150, -115, 0, 445, 700, 795, 85),
    "offsets everywhere": (120, -80, 60, 400, 500, 450, 90),
}


def wrist_of(name: str) -> SphericalWrist:
    return SphericalWrist(*(value * 1e-3 for value in OPW[name]))


def pinocchio_arm(name: str) -> pin.Model:
    """The same arm joint by joint, as a URDF would describe it: a2 is how far the forearm's axis lies below."""
    a1, a2, b, c1, c2, c3, c4 = (value * 1e-3 for value in OPW[name])
    eye = np.eye(3)
    model = pin.Model()
    at = 0
    for kind, place in (
        (pin.JointModelRZ(), (0, 0, c1)),
        (pin.JointModelRY(), (a1, b, 0)),
        (pin.JointModelRY(), (0, 0, c2)),
        (pin.JointModelRX(), (0, 0, -a2)),
        (pin.JointModelRY(), (c3, 0, 0)),
        (pin.JointModelRX(), (c4, 0, 0)),
    ):
        at = model.addJoint(at, kind, pin.SE3(eye, np.array(place, dtype=float)), f"j{model.njoints}")
    forward = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])  # z out of the flange, along x
    model.addFrame(pin.Frame("flange", at, 0, pin.SE3(forward, np.zeros(3)), pin.FrameType.OP_FRAME))
    return model


def pinocchio_poses(model: pin.Model, frame: str, q: Array) -> Array:
    data, i = model.createData(), model.getFrameId(frame)
    out = np.empty((len(q), 4, 4))
    for k, row in enumerate(q):
        pin.framesForwardKinematics(model, data, row)
        out[k] = data.oMf[i].homogeneous
    return out


def pose_errors(A: Array, B: Array) -> tuple[float, float]:
    """Largest distance of origins [m] and largest angle between rotations [rad] of poses (..., 4, 4)."""
    turned = np.linalg.norm(A[..., :3, :3] - B[..., :3, :3], axis=(-2, -1)) / np.sqrt(2.0)  # 2 sin(angle / 2)
    moved = np.linalg.norm(A[..., :3, 3] - B[..., :3, 3], axis=-1)
    return float(moved.max()), float(turned.max())


def angle_apart(a: Array, b: Array) -> Array:
    return np.abs(np.remainder(a - b + np.pi, 2.0 * np.pi) - np.pi)


# --- chains -----------------------------------------------------------------------------------------------------


def askew(free: str, held: str) -> Cell:
    """Base, nozzle and the positioner's held axis all out of the way."""
    return build_cell(
        load_problem(
            "cylinder_logo",
            [
                "cell.base_mm=[120, -340, 560]",
                "cell.nozzle.axis=[0.3, -0.4, 0.5]",
                f"cell.positioner.free=[{free}]",
                f"cell.positioner.held_deg={{{held}: -35}}",
            ],
        )
    )


@pytest.fixture(scope="module")
def tilted_cell() -> Cell:
    return askew("rotation", "tilt")


def test_arm_poses_and_jacobians_are_those_of_pinocchio(tilted_cell: Cell) -> None:
    cell = tilted_cell
    q = np.random.default_rng(1).uniform(-7.0, 7.0, (3000, 6))
    flange = pinocchio_poses(cell.arm_robot.model, "tool0", q)
    assert pose_errors(cell.arm.poses(q), cell.T_world_base @ flange @ cell.T_flange_nozzle) < (1e-12, 1e-12)
    model = cell.arm_robot.model.copy()
    parent = model.frames[model.getFrameId("tool0")]
    nozzle = parent.placement * pin.SE3(cell.T_flange_nozzle)
    frame = model.addFrame(pin.Frame("nozzle", parent.parentJoint, 0, nozzle, pin.FrameType.OP_FRAME))
    data = model.createData()
    J = cell.arm.jacobians(q)
    for k in range(len(q)):
        seen = pin.computeFrameJacobian(model, data, q[k], frame, pin.LOCAL_WORLD_ALIGNED)
        np.testing.assert_allclose(J[k], seen, rtol=0, atol=1e-12)


@pytest.mark.parametrize(("free", "held"), [("rotation", "tilt"), ("tilt", "rotation")])
def test_holder_poses_and_jacobians_are_those_of_pinocchio(free: str, held: str) -> None:
    cell = askew(free, held)
    assert cell.holder_robot is not None
    model = cell.holder_robot.model
    q = np.random.default_rng(2).uniform(-7.0, 7.0, (2000, 1))
    both = np.full((2000, 2), np.radians(-35.0))
    column = ("tilt", "rotation").index(free)
    both[:, column] = q[:, 0]
    seen = cell.T_world_holder_base @ pinocchio_poses(model, "plate", both) @ cell.T_plate_part
    assert pose_errors(cell.holder.poses(q), seen) < (1e-12, 1e-12)
    model = model.copy()
    plate = model.frames[model.getFrameId("plate")]
    placement = plate.placement * pin.SE3(cell.T_plate_part)
    frame = model.addFrame(pin.Frame("part", plate.parentJoint, placement, pin.FrameType.OP_FRAME))
    data = model.createData()
    J = cell.holder.jacobians(q)
    for k in range(len(q)):
        expected = pin.computeFrameJacobian(model, data, both[k], frame, pin.LOCAL_WORLD_ALIGNED)
        np.testing.assert_allclose(J[k][:, 0], expected[:, column], rtol=0, atol=1e-12)


def test_chain_takes_arrays_that_are_not_contiguous(cell: Cell) -> None:
    q = np.random.default_rng(3).uniform(-3.0, 3.0, (5, 7))
    np.testing.assert_array_equal(cell.arm.poses(q[:, :6]), cell.arm.poses(q[:, :6].copy()))
    np.testing.assert_array_equal(cell.arm.poses(q[::-1, :6]), cell.arm.poses(q[:, :6].copy())[::-1])


def test_chain_without_joints_stays_where_it_is(bed_cell: Cell) -> None:
    T = bed_cell.holder.poses(np.zeros((4, 0)))
    assert T.shape == (4, 4, 4)
    np.testing.assert_array_equal(T, np.tile(bed_cell.T_world_holder, (4, 1, 1)))
    assert bed_cell.holder.jacobians(np.zeros((4, 0))).shape == (4, 6, 0)


# --- the closed form --------------------------------------------------------------------------------------------


def test_zero_posture_of_the_irb_140() -> None:
    T = wrist_of("IRB 140").poses(np.zeros((1, 6)))[0]
    np.testing.assert_allclose(T[:3, 3] * 1e3, [515.0, 0.0, 712.0], atol=1e-9)
    np.testing.assert_allclose(T[:3, 2], [1.0, 0.0, 0.0], atol=1e-15)


def test_closed_form_of_the_irb_140_is_the_urdf(cell: Cell) -> None:
    q = np.random.default_rng(4).uniform(-7.0, 7.0, (3000, 6))
    assert pose_errors(cell.wrist.poses(q), pinocchio_poses(cell.arm_robot.model, "tool0", q)) < (1e-12, 1e-12)


@pytest.mark.parametrize("name", OPW)
def test_closed_form_poses_are_those_of_pinocchio(name: str) -> None:
    q = np.random.default_rng(5).uniform(-np.pi, np.pi, (1000, 6))
    seen = pinocchio_poses(pinocchio_arm(name), "flange", q)
    assert pose_errors(wrist_of(name).poses(q), seen) < (1e-12, 1e-12)


def postures_at_singularities(name: str, n: int, seed: int) -> Array:
    """Random postures (m, 6), most of them pushed to, or within a hair of, one or more singularities."""
    a1, a2, _b, _c1, c2, c3, _c4 = (value * 1e-3 for value in OPW[name])
    k, bend = np.hypot(a2, c3), np.arctan2(a2, c3)
    rng = np.random.default_rng(seed)
    hairs = np.array([0.0, 1e-15, 1e-12, 1e-10, 0.9e-9, 1.1e-9, 1e-8, 1e-6, 1e-3])
    rows = []
    for straight_wrist, stretched, over_axis_1 in itertools.product((False, True), repeat=3):
        q = rng.uniform(-np.pi, np.pi, (n, 6))
        hair = rng.choice(hairs, (n, 3)) * rng.choice([-1.0, 1.0], (n, 3))
        if straight_wrist:
            q[:, 4] = hair[:, 0]
        phi3 = q[:, 2] + 0.5 * np.pi + bend
        if stretched:
            phi3 = hair[:, 1] + rng.choice([0.0, np.pi], n)
            q[:, 2] = phi3 - 0.5 * np.pi - bend
        if over_axis_1:
            # a1 + s sin(q2 + beta) = 0 puts the wrist centre onto axis 1 (or the b beside it)
            x, y = c2 + k * np.cos(phi3), k * np.sin(phi3)
            s, beta = np.hypot(x, y), np.arctan2(y, x)
            possible = s > a1
            q[possible, 1] = (np.arcsin(-a1 / s[possible]) - beta[possible]) + hair[possible, 2]
        rows.append(q)
    return np.vstack(rows)


@pytest.mark.parametrize("name", OPW)
def test_every_solution_reproduces_the_pose(name: str) -> None:
    wrist = wrist_of(name)
    q = np.vstack([np.random.default_rng(6).uniform(-np.pi, np.pi, (3000, 6)), postures_at_singularities(name, 400, 7)])
    T = wrist.poses(q)
    found, ok = wrist.solve(T)
    b = wrist.b  # beside axis 1, as near to it as b lets it come, rounding may hide the way
    centre = T[:, :2, 3] - wrist.c4 * T[:, :2, 2]
    assert (ok.any(axis=1) | ((b > 0) & (np.hypot(*centre.T) < b + 1e-8))).all()  # a posture led to each pose
    rows, branches = np.nonzero(ok)
    moved, turned = pose_errors(wrist.poses(found[rows, branches]), T[rows])
    assert moved < 1e-8
    assert turned < 1e-8
    assert np.abs(found[rows, branches]).max() < np.pi + 1e-12


@pytest.mark.parametrize("name", OPW)
def test_the_posture_itself_is_among_the_solutions(name: str) -> None:
    wrist = wrist_of(name)
    q = np.random.default_rng(8).uniform(-np.pi, np.pi, (4000, 6))
    found, ok = wrist.solve(wrist.poses(q))
    own = wrist.branches(q)
    assert ok[np.arange(len(q)), own].all()
    apart = angle_apart(found[np.arange(len(q)), own], q)
    # rounding of a pose grows with closeness to a singularity; a random posture is never closer than some 1e-4
    assert apart.max() < 1e-8
    assert np.median(apart) < 1e-14


@pytest.mark.parametrize("name", OPW)
@pytest.mark.parametrize("hair", [1e-3, 1e-5, 1e-7, 2e-9])
def test_the_posture_itself_is_found_beside_a_straight_wrist(name: str, hair: float) -> None:
    wrist = wrist_of(name)
    q = np.random.default_rng(9).uniform([-3, 0.3, -1.0, -3, 0, -3], [3, 0.9, 0.8, 3, 0, 3], (500, 6))
    q[:, 4] = hair * np.where(np.arange(len(q)) % 2, 1.0, -1.0)
    found, ok = wrist.solve(wrist.poses(q))
    k, own = np.arange(len(q)), wrist.branches(q)
    assert ok[k, own].all()
    apart = angle_apart(found[k, own], q)
    assert apart[:, [0, 1, 2, 4]].max() < 1e-12
    assert apart[:, [3, 5]].max() < 1e-12 + 1e-14 / hair  # a pose has no more digits than this of q4 and q6
    assert angle_apart(found[k, own] @ [0, 0, 0, 1, 0, 1], q @ [0, 0, 0, 1, 0, 1]).max() < 1e-12  # but of their sum


@pytest.mark.parametrize("name", OPW)
@pytest.mark.parametrize("q5", [0.0, 1e-12, -1e-12])
def test_straight_wrist_has_q4_at_zero(name: str, q5: float) -> None:
    wrist = wrist_of(name)
    q = np.random.default_rng(10).uniform([-3, 0.3, -1.0, -3, 0, -3], [3, 0.9, 0.8, 3, 0, 3], (200, 6))
    q[:, 4] = q5
    found, ok = wrist.solve(wrist.poses(q))
    assert ok[:, 0].all()
    assert (found[:, 0, 3] == 0.0).all()
    assert angle_apart(found[:, 0, 5], q[:, 3] + q[:, 5]).max() < 1e-11


@pytest.mark.parametrize("name", OPW)
def test_branch_numbers_are_the_indices_of_solutions(name: str) -> None:
    wrist = wrist_of(name)
    q = np.vstack(
        [np.random.default_rng(10).uniform(-np.pi, np.pi, (3000, 6)), postures_at_singularities(name, 200, 11)]
    )
    found, ok = wrist.solve(wrist.poses(q))
    rows, index = np.nonzero(ok)
    solutions = found[rows, index]
    a1, a2, _b, _c1, c2, c3, _c4 = (value * 1e-3 for value in OPW[name])
    phi3 = angle_apart(solutions[:, 2] + 0.5 * np.pi + np.arctan2(a2, c3), 0.0)
    q23 = solutions[:, 1] + solutions[:, 2] + 0.5 * np.pi
    radial = a1 + c2 * np.sin(solutions[:, 1]) + c3 * np.sin(q23) + a2 * np.cos(q23)
    # on a singularity itself two branches are one
    decided = (np.abs(solutions[:, 4]) > 0) & (np.minimum(phi3, np.pi - phi3) > 1e-11) & (np.abs(radial) > 1e-11)
    decided &= np.abs(solutions[:, 4]) < np.pi - 1e-11
    assert decided.sum() > 10_000
    np.testing.assert_array_equal(wrist.branches(solutions[decided]), index[decided])


def test_branch_number_has_the_bits_of_abb_cfx() -> None:
    """Postures of which one can see where the wrist centre is and how the wrist bends (IRB 140, FACTS §4)."""
    wrist = wrist_of("IRB 140")
    d = np.radians
    seen = {
        (0, 0, 0, 0, 30, 0): 0,
        (0, 0, 0, 0, -30, 0): 1,
        (0, 90, -150, 0, 30, 0): 2,  # lower arm forwards, forearm up and back: the centre is behind the lower arm
        (0, -60, 0, 0, 30, 0): 4,  # leaning back: the centre is behind axis 1 (z up), but before the lower arm
        (0, -80, -110, 0, -30, 0): 7,
    }
    for degrees, branch in seen.items():
        assert wrist.branches(d(np.array([degrees], dtype=float)))[0] == branch, degrees


def test_solve_says_what_does_not_exist() -> None:
    wrist = wrist_of("IRB 140")
    far = np.tile(np.eye(4), (2, 1, 1))
    far[0, :3, 3] = (3.0, 0.0, 0.5)
    far[1, :3, 3] = (0.07, 0.0, 0.352 + 0.065)  # the wrist centre on the shoulder: 20 mm too near
    _, ok = wrist.solve(far)
    assert not ok.any(axis=1)[0]
    assert not ok[1, :4].any()


# --- reach ------------------------------------------------------------------------------------------------------


def at_centre(wrist: SphericalWrist, centre: Array) -> Array:
    """Flange poses (n, 4, 4), all turned alike, whose wrist centres are given (n, 3)."""
    R = pin.exp3(np.array([0.3, -1.1, 0.7]))
    T = np.tile(np.eye(4), (len(centre), 1, 1))
    T[:, :3, :3] = R
    T[:, :3, 3] = centre + wrist.c4 * R[:, 2]
    return T


@pytest.mark.parametrize("name", ["IRB 140", "IRB 1200-5/0.9", "IRB 2600-20/1.65"])
def test_out_of_reach_along_rays(name: str) -> None:
    """From the shoulder outwards, and from it inwards to the hole around it; by hand from the drawing."""
    wrist = wrist_of(name)
    forearm = np.hypot(wrist.a2, wrist.c3)
    rng = np.random.default_rng(12)
    for _ in range(50):
        turn, up = rng.uniform(-np.pi, np.pi), rng.uniform(-1.4, 1.4)
        outwards = np.array([np.cos(turn), np.sin(turn), 0.0])
        shoulder = wrist.a1 * outwards + [0.0, 0.0, wrist.c1]
        ray = np.cos(up) * outwards + [0.0, 0.0, np.sin(up)]
        beyond = rng.uniform(0.0, 1.0, 8)
        centres = shoulder + (wrist.c2 + forearm + beyond)[:, None] * ray
        T = at_centre(wrist, centres)
        np.testing.assert_allclose(wrist.out_of_reach(T), beyond, atol=1e-12)
        assert not wrist.solve(T)[1].any()
        within = shoulder + (wrist.c2 + forearm - rng.uniform(1e-6, 0.05, 8))[:, None] * ray
        T = at_centre(wrist, within)
        assert (wrist.out_of_reach(T) == 0.0).all()
        assert wrist.solve(T)[1].any(axis=1).all()


def test_out_of_reach_in_the_hole_around_the_shoulder() -> None:
    wrist = wrist_of("IRB 140")  # a hole of 380 - 360 = 20 mm, which only the shoulder turned backwards may reach into
    inside = np.array([0.0, 0.005, 0.015])
    centres = np.array([wrist.a1, 0.0, wrist.c1]) + inside[:, None] * np.array([0.0, 0.0, 1.0])
    np.testing.assert_array_less(wrist.out_of_reach(at_centre(wrist, centres)), 1e-12)  # backwards: 140 mm away
    wrist = SphericalWrist(0.005, 0.0, 0.0, 0.352, 0.36, 0.38, 0.065)
    centres = np.array([0.005, 0.0, 0.352]) + inside[:, None] * np.array([1.0, 0.0, 0.0])
    # of the shoulder in front the target is `inside` away, of the one turned backwards 10 mm more
    expected = np.maximum(0.02 - (inside + 0.01), 0.0)
    np.testing.assert_allclose(wrist.out_of_reach(at_centre(wrist, centres)), expected, atol=1e-12)


# --- Jacobians and small matrices of the kernels ----------------------------------------------------------------


@pytest.mark.parametrize("name", OPW)
def test_solutions_within_ranges_are_those_of_solve(name: str) -> None:
    wrist = wrist_of(name)
    rng = np.random.default_rng(24)
    low, high = np.full(6, -9.0), np.full(6, 9.0)
    low[:3], high[:3] = [-1.2, -0.8, -2.2], [1.9, 1.7, 0.4]
    T = wrist.poses(rng.uniform(-np.pi, np.pi, (2000, 6)))
    found, ok = wrist.solve(T)
    q, seen = np.empty((8, 6)), np.empty(8, dtype=np.bool_)
    inside = np.zeros_like(ok)
    for turned in (found[..., :3], found[..., :3] + 2 * np.pi, found[..., :3] - 2 * np.pi):
        inside |= ((turned >= low[:3]) & (turned <= high[:3])).all(axis=2)
    for k in range(len(T)):
        wanted = rng.random(8) < 0.6
        solve_within(wrist.parameters, T[k, :3, :3], T[k, :3, 3], low, high, wanted, q, seen)
        np.testing.assert_array_equal(seen, ok[k] & wanted & inside[k])
        assert angle_apart(q[seen], found[k, seen]).max(initial=0.0) < 1e-8


@pytest.mark.slow(keep=2)
@pytest.mark.parametrize("name", OPW)
def test_jacobian_of_a_spherical_wrist_and_its_inverse(name: str) -> None:
    """Of a point that stands off the flange, against Pinocchio's Jacobian."""
    model = pinocchio_arm(name)
    tool = pin.SE3(np.eye(3), np.array([0.1, -0.05, 0.2]))
    frame = model.addFrame(
        pin.Frame("tip", model.njoints - 1, model.frames[-1].placement * tool, pin.FrameType.OP_FRAME)
    )
    data, parameters, out = model.createData(), wrist_of(name).parameters, np.empty((6, 6))
    forward = np.empty((6, 6))
    for q in np.random.default_rng(25).uniform(-np.pi, np.pi, (1000, 6)):
        J = pin.computeFrameJacobian(model, data, q, frame, pin.LOCAL_WORLD_ALIGNED)
        pin.updateFramePlacements(model, data)
        assert inverse_jacobian(parameters, sines_of(q), data.oMf[frame].translation, out)
        np.testing.assert_allclose(out @ J, np.eye(6), rtol=0, atol=1e-12 * np.linalg.cond(J))
        jacobian(parameters, sines_of(q), data.oMf[frame].translation, forward)
        np.testing.assert_allclose(forward, J, rtol=0, atol=1e-13)


def test_inverse_jacobian_refuses_a_straight_wrist_and_a_stretched_arm(cell: Cell) -> None:
    out = np.empty((6, 6))
    q = np.array([0.3, 0.4, -0.2, 0.5, 0.0, 0.1])
    assert not inverse_jacobian(cell.wrist.parameters, sines_of(q), np.zeros(3), out)
    q[2], q[4] = -0.5 * np.pi - np.arctan2(cell.wrist.a2, cell.wrist.c3), 0.6
    assert not inverse_jacobian(cell.wrist.parameters, sines_of(q), np.zeros(3), out)


def test_invert6_against_numpy() -> None:
    rng = np.random.default_rng(15)
    B = np.empty((6, 6))
    for k in range(500):
        A = rng.normal(size=(6, 6)) * 10.0 ** rng.integers(-2, 3)
        if k % 5 == 0:
            A[0, 0] = A[1, 1] = 0.0  # pivots have to be looked for
        assert invert6(A.copy(), B)
        np.testing.assert_allclose(B, np.linalg.inv(A), rtol=1e-7, atol=1e-9 * np.abs(B).max())


def test_invert6_refuses_singular_matrices() -> None:
    A = np.random.default_rng(16).normal(size=(6, 6))
    A[4] = 0.0
    assert not invert6(A.copy(), np.empty((6, 6)))
    assert not invert6(np.zeros((6, 6)), np.empty((6, 6)))
    assert not invert6(np.full((6, 6), np.nan), np.empty((6, 6)))


def test_largest_singular_value_against_numpy(cell: Cell) -> None:
    """Within 2 % and never above, for the inverse Jacobians that it is made for."""
    q = np.random.default_rng(17).uniform(cell.limits.q_min[:6], cell.limits.q_max[:6], (5000, 6))
    inverses = np.linalg.inv(cell.arm.jacobians(q))
    seen = np.array(
        [largest_singular_value(np.ascontiguousarray(B), np.empty((6, 6)), np.empty((6, 6))) for B in inverses]
    )
    ratio = seen / np.linalg.svd(inverses, compute_uv=False)[:, 0]
    assert ratio.max() < 1.0 + 1e-12
    assert ratio.min() > 0.98


def test_largest_singular_value_where_one_stands_out() -> None:
    rng = np.random.default_rng(18)
    for _ in range(200):
        U, V = (np.linalg.qr(rng.normal(size=(6, 6)))[0] for _ in range(2))
        B = U @ np.diag([9.0, 3.0, 2.0, 1.0, 0.5, 0.1]) @ V
        assert abs(largest_singular_value(B, np.empty((6, 6)), np.empty((6, 6))) / 9.0 - 1.0) < 1e-3
