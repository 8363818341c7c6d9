"""The verifier: a good plan passes, and every way to spoil one is caught by the check that is meant for it.

A test spoils one thing only and demands the whole set of failed checks, so a check that sleeps and one that
cries wolf both show.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from solved import bed_plan, small_plan
from spoilt import (
    bead_named,
    deposit_of,
    failed,
    hump,
    jacobian,
    loose,
    nudged,
    paused,
    report,
    rest_after,
    resting,
    rows,
    shake,
    straight_stretch,
    swapped,
    swing,
    where,
    with_bead,
    with_joints,
    with_process,
    worst,
)

from planner.base.arrays import Array
from planner.base.nearest import distance_to_polyline
from planner.cell.cell import build_cell
from planner.plan import TRAVEL, Plan, Trajectory
from planner.problem import load_problem
from planner.toolpath.bead import Bead
from planner.toolpath.wrapped import Cylinder
from planner.verify.executed import executed_motion
from planner.verify.verdict import Report

CHECKS = {
    "all numbers finite",
    "beads of the toolpath",
    "recorded poses",
    "recorded branch",
    "recorded times and beads",
    "recorded layers and lengths",
    "starts and ends at home",
    "recorded speed",
    "material keeps pace",
    "joint range",
    "joint velocity",
    "joint acceleration",
    "joint jerk",
    "continuity",
    "tip on the path",
    "axis on the normal",
    "path within corner tolerance",
    "input path reached everywhere",
    "every bead complete",
    "singularity margin",
    "branch changes in deposition",
    "speed in deposition",
    "speed in travel",
    "extrusion balance",
    "flow per millimetre",
    "filament fed",
    "primes, retracts and cuts as asked",
    "print pressed by the nozzle",
    "beads as wide and high as asked",
    "layers on the part",
    "nozzle normal to the part",
    "print on the drawn path",
    "drawn path left out",
    "obstacles where the print is",
    "nozzle tip outside the part",
}


@pytest.fixture(scope="module")
def plan() -> Plan:
    return small_plan()


# --- tools to spoil a plan ---------------------------------------------------------------------------------


# --- a good plan -------------------------------------------------------------------------------------------


def test_a_solved_plan_holds_every_check(plan: Plan) -> None:
    found = report(plan)
    names = [check.name for check in found.checks]
    assert set(names) >= CHECKS
    assert len(names) == len(set(names))
    assert failed(plan) == set()
    assert plan.verified
    assert np.isfinite(list(found.metrics.values())).all()


def test_a_plan_on_a_fixed_bed_holds_every_check() -> None:
    assert failed(bed_plan()) == set()
    assert bed_plan().trajectory.q.shape[1] == 6


def test_verifying_changes_nothing_and_repeats_itself(plan: Plan) -> None:
    before = plan.trajectory.q.copy()
    first, second = report(plan), report(plan)
    assert first.checks == second.checks
    assert first.metrics == second.metrics
    assert np.array_equal(plan.trajectory.q, before)


def test_one_failed_check_makes_the_plan_unverified(plan: Plan) -> None:
    tip = plan.trajectory.tip.copy()
    tip[100] += 1e-5
    assert not replace(plan, checks=report(plan, replace(plan.trajectory, tip=tip)).checks).verified


# --- what the trajectory says of itself --------------------------------------------------------------------


@pytest.mark.parametrize("sample", [0, 500, -1])
def test_recorded_tip_that_is_not_where_the_joints_are(plan: Plan, sample: int) -> None:
    tip = plan.trajectory.tip.copy()
    tip[sample, 1] += 2e-6
    assert failed(plan, replace(plan.trajectory, tip=tip)) == {"recorded poses"}


def test_recorded_axis_that_is_not_the_joints(plan: Plan) -> None:
    axis = plan.trajectory.axis.copy()
    axis[700] = Rotation.from_rotvec([0.0, 0.0, 1e-4]).apply(axis[700])
    assert failed(plan, replace(plan.trajectory, axis=axis)) == {"recorded poses"}


@pytest.mark.parametrize("turn", [[0.0, 0.0, 1e-3], [1e-3, 0.0, 0.0]], ids=["roll", "tilt"])
def test_recorded_orientation_that_is_not_the_joints(plan: Plan, turn: list[float]) -> None:
    # The orientation is what the robot program is written from.
    quat = plan.trajectory.quat.copy()
    quat[700] = (Rotation.from_quat(quat[700]) * Rotation.from_rotvec(turn)).as_quat()
    assert failed(plan, replace(plan.trajectory, quat=quat)) != set()


def test_recorded_branch_that_is_not_the_joints(plan: Plan) -> None:
    branch = plan.trajectory.branch.copy()
    branch[straight_stretch(plan, 1)[0]] ^= 1
    assert failed(plan, replace(plan.trajectory, branch=branch)) != set()


# --- joints ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("turns", [1, -2])
def test_joint_beyond_its_range(plan: Plan, turns: int) -> None:
    q = plan.trajectory.q.copy()
    q[:, 5] += turns * 2.0 * np.pi  # the same poses
    assert failed(plan, with_joints(plan, plan.trajectory, q)) == {"joint range", "starts and ends at home"}


@pytest.mark.parametrize(("share", "expected"), [(0.97, set()), (1.03, {"joint velocity", "continuity"})])
def test_joint_too_fast(plan: Plan, share: float, expected: set[str]) -> None:
    trajectory = paused(plan, len(plan.trajectory) - 1, swing(plan, 5, share))
    found = failed(plan, trajectory, problem=with_process(plan.problem, travel_speed=10.0))
    assert found == expected


@pytest.mark.slow(keep=4)
@pytest.mark.parametrize("joint", range(7))
@pytest.mark.parametrize(("share", "expected"), [(0.95, set()), (1.05, {"joint acceleration"})])
def test_joint_accelerates_too_hard(plan: Plan, joint: int, share: float, expected: set[str]) -> None:
    dq = shake(plan, joint, 2, share * plan.cell.limits.acceleration[joint], samples=20)
    relaxed = with_process(plan.problem, travel_speed=10.0)
    assert failed(plan, paused(plan, len(plan.trajectory) - 1, dq), problem=relaxed) == expected


@pytest.mark.slow(keep=4)
@pytest.mark.parametrize("joint", range(7))
@pytest.mark.parametrize(("share", "expected"), [(0.95, set()), (1.05, {"joint jerk"})])
def test_joint_jerks_too_hard(plan: Plan, joint: int, share: float, expected: set[str]) -> None:
    dq = shake(plan, joint, 3, share * plan.cell.limits.jerk[joint], samples=10)
    relaxed = with_process(plan.problem, travel_speed=10.0)
    assert failed(plan, paused(plan, len(plan.trajectory) - 1, dq), problem=relaxed) == expected


def test_jump_of_a_joint(plan: Plan) -> None:
    # There and back with a stay between: central differences see but half of the speed.
    dq = np.zeros((8, plan.trajectory.q.shape[1]))
    dq[2:5, 5] = 1.2 * plan.cell.limits.velocity[5] * plan.trajectory.dt
    trajectory = paused(plan, len(plan.trajectory) - 1, dq)
    relaxed = with_process(plan.problem, travel_speed=10.0)
    assert failed(plan, trajectory, problem=relaxed) == {"continuity", "joint acceleration", "joint jerk"}


def test_whole_turn_between_two_samples(plan: Plan) -> None:
    # The poses are right all along; only the joint knows.
    q = plan.trajectory.q.copy()
    q[straight_stretch(plan, 1)[0] :, 5] -= 2.0 * np.pi
    limits = plan.cell.limits
    wide = replace(plan.cell, limits=replace(limits, q_min=3.0 * limits.q_min, q_max=3.0 * limits.q_max))
    expected = {"continuity", "joint velocity", "joint acceleration", "joint jerk", "starts and ends at home"}
    # the head goes round once in between, past whatever stands there
    found = failed(plan, with_joints(plan, plan.trajectory, q), cell=wide)
    assert found - {"robots clear of each other and of fixtures"} == expected


def test_a_motion_that_does_not_start_from_rest(plan: Plan) -> None:
    way = int(np.argmax(plan.trajectory.deposit))  # to the first bead
    fast = int(np.argmax(np.abs(np.diff(plan.trajectory.q[:way], axis=0)).max(axis=1)))
    late = rows(plan.trajectory, np.arange(fast, len(plan.trajectory)))
    assert failed(plan, late) == {"joint acceleration", "joint jerk", "starts and ends at home"}


def test_the_place_of_the_worst_sample_is_named(plan: Plan) -> None:
    rest = rest_after(plan.trajectory, 0)
    dq = np.zeros((2, plan.trajectory.q.shape[1]))
    dq[0, 2] = 0.6 * plan.cell.limits.acceleration[2] * plan.trajectory.dt**2
    found = report(plan, paused(plan, rest, dq))
    assert where(found, "joint acceleration") == f"t = {(rest + 1) * plan.trajectory.dt:.3f} s, travel"


# --- geometry ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("joint", range(7))
def test_one_joint_off_by_a_tenth_of_a_milliradian(plan: Plan, joint: int) -> None:
    at = straight_stretch(plan, 120)
    q = plan.trajectory.q.copy()
    q[at, joint] += 1e-4 * hump(len(at))
    T = plan.cell.T_part_nozzle(np.stack([plan.trajectory.q[at[60]], q[at[60]]]))
    moved = np.linalg.norm(T[1, :3, 3] - T[0, :3, 3]) * 1e3
    found = report(plan, with_joints(plan, plan.trajectory, q))
    assert found.metrics["position_error_max_mm"] == pytest.approx(moved, rel=0.1)
    names = {check.name for check in found.checks if not check.ok}
    assert ("tip on the path" in names) == (moved > 0.02)
    # around the cylinder the normal turns by a degree in 0.6 mm
    assert names <= {"tip on the path", "axis on the normal", "layers on the part", "nozzle normal to the part"}
    assert f"bead {bead_named(plan, 'wave')}, " in where(found, "tip on the path")


def test_most_joints_move_the_tip_that_far(plan: Plan) -> None:
    """Else the test above would show nothing."""
    i = straight_stretch(plan, 1)[0]
    arms = np.linalg.norm(jacobian(plan.cell, plan.trajectory.q[i])[:3], axis=0)
    assert (arms * 1e-4 > 2e-5).sum() >= 3


@pytest.mark.parametrize(("micrometres", "expected"), [(15.0, set()), (25.0, {"tip on the path"})])
def test_tip_beside_the_path(plan: Plan, micrometres: float, expected: set[str]) -> None:
    # Along the cylinder's axis, where the normal stays the same.
    twist = np.array([0.0, 0.0, 1e-6 * micrometres, 0.0, 0.0, 0.0])
    found = report(plan, nudged(plan, straight_stretch(plan, 120), twist))
    assert {check.name for check in found.checks if not check.ok} == expected
    assert found.metrics["position_error_max_mm"] == pytest.approx(1e-3 * micrometres, rel=0.02)


def test_a_bead_of_one_sample_is_judged_too(plan: Plan) -> None:
    """All other samples of its bead are travel; it is beside the path."""
    at = straight_stretch(plan, 1)
    own = deposit_of(plan.trajectory, int(plan.trajectory.bead[at[0]]))
    q = plan.trajectory.q.copy()
    q[at[0], :6] += np.linalg.solve(jacobian(plan.cell, q[at[0]]), [0.0, 0.0, 1e-3, 0.0, 0.0, 0.0])
    found = report(plan, silent(with_joints(plan, plan.trajectory, q), np.setdiff1d(own, at)))
    assert worst(found, "tip on the path") == pytest.approx(1.0, abs=0.02)
    assert where(found, "tip on the path").startswith(f"t = {plan.trajectory.t[at[0]]:.3f} s, bead")


def test_table_turned_too_far(plan: Plan) -> None:
    # A constant angle: nothing moves differently, all is laid down beside its place.
    q = plan.trajectory.q.copy()
    q[:, 6] += 2e-3
    assert failed(plan, with_joints(plan, plan.trajectory, q)) == {
        "tip on the path",
        "axis on the normal",
        "path within corner tolerance",
        "layers on the part",
        "nozzle normal to the part",
    }


@pytest.mark.parametrize(
    ("degrees", "expected"), [(0.04, set()), (0.06, {"axis on the normal", "nozzle normal to the part"})]
)
def test_axis_tilted_about_the_tip(plan: Plan, degrees: float, expected: set[str]) -> None:
    at = straight_stretch(plan, 120)
    along = np.gradient(plan.trajectory.tip, axis=0)[at[60]]
    twist = np.concatenate([np.zeros(3), np.radians(degrees) * along / np.linalg.norm(along)])
    found = report(plan, nudged(plan, at, twist))
    assert {check.name for check in found.checks if not check.ok} == expected
    assert found.metrics["axis_error_max_deg"] == pytest.approx(degrees, rel=0.01)


def test_turning_about_the_axis_is_free(plan: Plan) -> None:
    at = straight_stretch(plan, 120)
    twist = np.concatenate([np.zeros(3), 1e-2 * plan.trajectory.axis[at[60]]])
    found = report(plan, nudged(plan, at, twist))
    assert found.metrics["axis_error_max_deg"] < 0.05
    assert {check.name for check in found.checks if not check.ok} <= {"tip on the path"}


@pytest.mark.parametrize(
    ("key", "name"), [("nozzle_gravity", "nozzle to gravity"), ("layer_gravity", "layer to gravity")]
)
def test_what_leans_from_the_vertical(plan: Plan, key: str, name: str) -> None:
    """By as much as the nozzle's axis and the part, on a table that turns about the vertical, say."""

    def within(cone: float) -> Report:
        cones = plan.problem.process.cones.model_copy(update={key: cone})
        return report(
            plan, problem=plan.problem.model_copy(update={"process": process.model_copy(update={"cones": cones})})
        )

    process, t = plan.problem.process, plan.trajectory
    greatest = np.arccos(-t.axis[t.deposit, 2]).max()
    assert worst(within(greatest), name) == pytest.approx(np.degrees(greatest), abs=0.05)
    for beyond, expected in ((-0.02, set()), (0.02, {name})):
        found = within(np.radians(worst(within(greatest), name) - 0.05 - beyond))
        assert {check.name for check in found.checks if not check.ok} == expected


def test_nozzle_pointing_out_of_the_part(plan: Plan) -> None:
    # The sine alone is the same for a nozzle that points the wrong way.
    class InsideOut(Cylinder):
        def normals(self, points: Array) -> Array:
            return -super().normals(points)

    surface = InsideOut(*vars(plan.toolpath.surface).values())
    found = report(plan, toolpath=replace(plan.toolpath, surface=surface))
    assert {check.name for check in found.checks if not check.ok} == {"axis on the normal"}
    assert found.metrics["axis_error_max_deg"] == pytest.approx(180.0, abs=1e-3)


def test_path_that_leaves_the_input_path(plan: Plan) -> None:
    # The drawing's path ends earlier: all of it is reached, but the nozzle goes on.
    i = bead_named(plan, "wave")
    source = plan.toolpath.beads[i].source
    shorter = with_bead(plan.toolpath, i, source=source[:-20])
    found = report(plan, toolpath=shorter)
    assert {check.name for check in found.checks if not check.ok} == {"path within corner tolerance"}
    gap = np.linalg.norm(source[-20:] - source[-21], axis=1).max() * 1e3
    assert gap > 1.5
    assert found.metrics["path_deviation_max_mm"] == pytest.approx(gap, rel=0.1)


def test_path_beside_the_input_path(plan: Plan) -> None:
    i = bead_named(plan, "wave")
    beside = plan.toolpath.beads[i].source + np.array([0.0, 0.0, 0.25e-3])
    both = {"path within corner tolerance", "input path reached everywhere"}
    assert failed(plan, toolpath=with_bead(plan.toolpath, i, source=beside)) == both


def test_a_spike_of_the_input_path_that_is_not_reached(plan: Plan) -> None:
    i = bead_named(plan, "wave")
    source = plan.toolpath.beads[i].source
    k = len(source) // 2
    outwards = plan.toolpath.surface.normals(source[k : k + 1])
    spike = source[k] + np.linspace(0.0, 1.0, 40)[:, None] * 1e-3 * outwards
    out = np.vstack([source[:k], spike, spike[::-1], source[k:]])
    found = report(plan, toolpath=with_bead(plan.toolpath, i, source=out))
    assert {check.name for check in found.checks if not check.ok} == {"input path reached everywhere"}
    assert worst(found, "input path reached everywhere") == pytest.approx(1.0, abs=0.01)


def test_a_corner_that_is_cut_off(plan: Plan) -> None:
    # Rounded path and motion agree with each other, and not with the drawing.
    i = bead_named(plan, "zigzag")
    bead = plan.toolpath.beads[i]
    coarse = np.linspace(0, len(bead.points) - 1, 7).astype(int)
    cut = np.column_stack([np.interp(bead.s, bead.s[coarse], bead.points[coarse, k]) for k in range(3)])
    off = cut + 0.5e-3 * bead.normals * np.sin(np.pi * bead.s / bead.length)[:, None]
    found = failed(plan, toolpath=with_bead(plan.toolpath, i, points=off))
    assert "input path reached everywhere" in found


# --- beads -------------------------------------------------------------------------------------------------


def silent(trajectory: Trajectory, at: NDArray[np.intp]) -> Trajectory:
    """Samples turned into travel: the same motion with the extruder off."""
    bead, deposit, s, flow = (v.copy() for v in (trajectory.bead, trajectory.deposit, trajectory.s, trajectory.flow))
    bead[at], deposit[at], s[at], flow[at] = TRAVEL, False, 0.0, 0.0
    return replace(trajectory, bead=bead, deposit=deposit, s=s, flow=flow)


@pytest.mark.parametrize("bead", [0, 1, 2])
def test_missing_bead(plan: Plan, bead: int) -> None:
    missing = silent(plan.trajectory, deposit_of(plan.trajectory, bead))
    lost = {"every bead complete", "extrusion balance", "material keeps pace", "drawn path left out"}
    assert failed(plan, missing) == lost


@pytest.mark.parametrize("end", ["start", "end"])
def test_bead_that_is_cut_short(plan: Plan, end: str) -> None:
    at = deposit_of(plan.trajectory, 1)
    lost = at[:2] if end == "start" else at[-2:]
    flow = plan.trajectory.flow.copy()
    flow[at[10]] += flow[lost].sum()
    short = silent(replace(plan.trajectory, flow=flow), lost)
    assert failed(plan, short) == {"every bead complete", "material keeps pace", "flow per millimetre"}


def test_bead_that_is_interrupted(plan: Plan) -> None:
    at = deposit_of(plan.trajectory, 1)
    flow = plan.trajectory.flow.copy()
    flow[at[10]] += flow[at[50:55]].sum()
    found = report(plan, silent(replace(plan.trajectory, flow=flow), at[50:55]))
    assert {check.name for check in found.checks if not check.ok} == {
        "every bead complete",
        "material keeps pace",
        "flow per millimetre",
    }
    assert where(found, "every bead complete") == "beads out of order, missing, or laid down twice"


def test_bead_laid_down_twice(plan: Plan) -> None:
    """To and fro over one bead, from rest to rest, and half of the material each time."""
    trajectory = plan.trajectory
    at = deposit_of(trajectory, 1)
    rest = resting(trajectory)
    first, last = int(rest[rest < at[0]][-1]), rest_after(trajectory, 1)
    n = len(trajectory)
    there, back = np.arange(first, last + 1), np.arange(last, first - 1, -1)  # standing still at both ends
    order = np.concatenate([np.arange(first), there, back, there, np.arange(last + 1, n)])
    twice = rows(trajectory, order)
    returning = first + len(there) + np.arange(len(back))
    halved = np.where(twice.bead == 1, 0.5, 1.0)
    twice = silent(replace(twice, flow=twice.flow * halved), returning)
    # the motion turns back on a sample, but comes to rest between two
    expected = {"every bead complete", "material keeps pace", "flow per millimetre"}
    assert failed(plan, twice) - {"joint jerk", "joint acceleration", "recorded speed"} == expected


def test_beads_in_the_wrong_order(plan: Plan) -> None:
    first, second, third = plan.toolpath.beads
    bead = np.array([1, 0, 2, TRAVEL])[plan.trajectory.bead].astype(np.int32)
    other = replace(plan.toolpath, beads=(second, first, third))
    assert failed(plan, replace(plan.trajectory, bead=bead), toolpath=other) == {
        "every bead complete",
        "material keeps pace",
    }


def test_bead_laid_down_backwards(plan: Plan) -> None:
    # Played backwards, with the order of the beads put right again: only s tells.
    n = len(plan.trajectory)
    backwards = rows(plan.trajectory, np.arange(n - 1, -1, -1))
    bead = np.array([2, 1, 0, TRAVEL])[backwards.bead].astype(np.int32)
    extruded = plan.trajectory.extruded[-1] - backwards.extruded
    backwards = replace(backwards, bead=bead, extruded=extruded, feed=plan.trajectory.feed[-1] - backwards.feed)
    other = replace(plan.toolpath, beads=plan.toolpath.beads[::-1])
    assert failed(plan, backwards, toolpath=other) == {
        "every bead complete",
        "material keeps pace",
        "flow per millimetre",
        "recorded speed",
    }


def test_s_that_goes_back_for_one_sample(plan: Plan) -> None:
    i = straight_stretch(plan, 1)[0]
    s = plan.trajectory.s.copy()
    s[[i, i + 1]] = s[[i + 1, i]]
    assert failed(plan, replace(plan.trajectory, s=s)) == {
        "every bead complete",
        "tip on the path",
        "speed in deposition",
        "flow per millimetre",
    }


def test_deposit_without_a_bead(plan: Plan) -> None:
    deposit = plan.trajectory.deposit.copy()
    deposit[deposit_of(plan.trajectory, 0)[0] - 1] = True
    assert failed(plan, replace(plan.trajectory, deposit=deposit)) != set()


def test_bead_without_deposit(plan: Plan) -> None:
    # The extruder stands still in the middle of a bead; its material is booked elsewhere.
    at = straight_stretch(plan, 5)
    deposit, flow = plan.trajectory.deposit.copy(), plan.trajectory.flow.copy()
    deposit[at] = False
    flow[at[-1] + 1] += flow[at].sum()
    flow[at] = 0.0
    assert failed(plan, replace(plan.trajectory, deposit=deposit, flow=flow)) != set()


# --- singularities -----------------------------------------------------------------------------------------


@pytest.mark.parametrize(("factor", "expected"), [(0.999, set()), (1.001, {"singularity margin"})])
def test_singularity_margin(plan: Plan, factor: float, expected: set[str]) -> None:
    least = factor * report(plan).metrics["sigma_min"]
    resolve = plan.problem.resolve.model_copy(update={"min_sigma": least})
    assert failed(plan, problem=plan.problem.model_copy(update={"resolve": resolve})) == expected


def test_wrist_straightened_in_deposition(plan: Plan) -> None:
    # Joint 5 at 0: axes 4 and 6 are one. The geometry is lost too, which other checks say.
    q = plan.trajectory.q.copy()
    at = straight_stretch(plan, 1)
    q[at, 4] = 0.0
    found = report(plan, with_joints(plan, plan.trajectory, q))
    assert found.metrics["sigma_min"] == pytest.approx(0.0, abs=1e-12)
    assert not next(check for check in found.checks if check.name == "singularity margin").ok


def test_a_singular_posture_in_travel_is_no_matter(plan: Plan) -> None:
    rest = rest_after(plan.trajectory, 0)
    dq = np.zeros((3, 7))
    dq[1, 4] = -plan.trajectory.q[rest, 4]
    found = report(plan, paused(plan, rest, dq))
    assert found.metrics["sigma_min"] == pytest.approx(plan.metrics["sigma_min"])
    assert found.metrics["wrist_margin_deg"] == pytest.approx(plan.metrics["wrist_margin_deg"])
    of_deposition = {"singularity margin", "branch changes in deposition"}
    assert not of_deposition & {check.name for check in found.checks if not check.ok}


def test_a_wrist_is_in_line_at_half_a_turn_too(plan: Plan) -> None:
    q, at = plan.trajectory.q.copy(), straight_stretch(plan, 1)[0]
    q[at, 4] = np.radians(175.0)
    found = report(plan, with_joints(plan, plan.trajectory, q))
    assert found.metrics["wrist_margin_deg"] == pytest.approx(5.0)
    assert found.series["wrist_deg"].max() <= 90.0


def test_wrist_flips_in_the_middle_of_a_bead(plan: Plan) -> None:
    # The other solution of the wrist has the same pose: the geometry is right all along.
    q = plan.trajectory.q.copy()
    i = straight_stretch(plan, 40)
    q[i, 3] -= np.copysign(np.pi, q[i[0], 3])
    q[i, 4] *= -1.0
    q[i, 5] += np.copysign(np.pi, q[i[0], 3])
    found = report(plan, with_joints(plan, plan.trajectory, q))
    jump = {"continuity", "joint velocity", "joint acceleration", "joint jerk"}
    names = {check.name for check in found.checks if not check.ok}
    # what the arm sweeps with its wrist flipped may reach further
    assert names - {"recorded poses", "robots clear of each other and of fixtures"} == {
        "branch changes in deposition",
        "recorded branch",
        *jump,
    }  # the record keeps the old branch
    assert found.metrics["branch_changes_in_deposition"] == 2.0


# --- speed -------------------------------------------------------------------------------------------------


def played_faster(plan: Plan, factor: float) -> Trajectory:
    t = plan.trajectory
    return replace(t, dt=t.dt / factor, t=t.t / factor, speed=factor * t.speed, flow=factor * t.flow)


def test_too_fast_in_deposition(plan: Plan) -> None:
    faster = played_faster(plan, 1.03)
    relaxed = with_process(plan.problem, travel_speed=1.0)
    # a sample's way is longer than the commanded speed's, too
    expected = {"speed in deposition", "every bead complete"}
    assert failed(plan, faster, problem=relaxed, cell=loose(plan.cell, 1.05)) == expected


def test_a_little_too_fast_is_within_tolerance(plan: Plan) -> None:
    faster = played_faster(plan, 1.01)
    relaxed = with_process(plan.problem, travel_speed=1.0)
    assert failed(plan, faster, problem=relaxed, cell=loose(plan.cell, 1.05)) == set()


def test_recorded_speed_too_high(plan: Plan) -> None:
    i = straight_stretch(plan, 1)[0]
    speed = swapped(plan.trajectory.speed, i, 0.001)
    assert failed(plan, replace(plan.trajectory, speed=speed)) == {"speed in deposition"}


def test_recorded_speed_too_low(plan: Plan) -> None:
    i = straight_stretch(plan, 1)[0]
    speed = swapped(plan.trajectory.speed, i, -0.01)
    assert failed(plan, replace(plan.trajectory, speed=speed)) != set()


def test_too_slow_is_counted_and_not_refused(plan: Plan) -> None:
    slower = report(plan, played_faster(plan, 0.5))
    assert {check.name for check in slower.checks if not check.ok} == set()
    assert slower.metrics["at_speed_fraction"] == 0.0
    assert slower.metrics["deposition_time_s"] == pytest.approx(2.0 * plan.metrics["deposition_time_s"])


def test_too_fast_in_travel(plan: Plan) -> None:
    """Every other sample of the way home: twice as fast, and joints that could follow."""
    last = deposit_of(plan.trajectory, 2)[-1]
    home = np.arange(rest_after(plan.trajectory, 2), len(plan.trajectory))
    keep = np.concatenate([np.arange(home[0]), home[::2]])
    hasty = rows(plan.trajectory, keep)
    assert last < home[0]
    found = report(plan, hasty, cell=loose(plan.cell, 2.1))
    assert {check.name for check in found.checks if not check.ok} == {"speed in travel", "recorded speed"}
    assert "travel" in where(found, "speed in travel")


# --- material ----------------------------------------------------------------------------------------------


def test_material_outside_beads(plan: Plan) -> None:
    i = deposit_of(plan.trajectory, 1)[-1] + 5
    found = report(plan, replace(plan.trajectory, flow=swapped(plan.trajectory.flow, i, 1e-12)))
    assert {check.name for check in found.checks if not check.ok} == {"extrusion balance"}
    assert where(found, "extrusion balance") == "material flows outside a bead"


def test_material_sucked_back(plan: Plan) -> None:
    i = straight_stretch(plan, 1)[0]
    flow = plan.trajectory.flow
    back = swapped(swapped(flow, i, -1.5 * flow[i]), i + 1, 1.5 * flow[i])
    assert failed(plan, replace(plan.trajectory, flow=back)) == {"extrusion balance", "flow per millimetre"}


@pytest.mark.parametrize(
    ("share", "expected"),
    [
        (0.9995, set()),
        (0.998, {"extrusion balance", "material keeps pace"}),
        (1.002, {"extrusion balance", "material keeps pace"}),
        (1.006, {"extrusion balance", "material keeps pace", "flow per millimetre"}),
    ],
)
def test_too_little_and_too_much_material(plan: Plan, share: float, expected: set[str]) -> None:
    t = plan.trajectory
    less = replace(t, flow=share * t.flow, extruded=share * t.extruded, feed=share * t.feed)
    assert failed(plan, less) == expected


def test_material_of_one_bead_given_to_another(plan: Plan) -> None:
    t = plan.trajectory
    flow = t.flow.copy()
    a, b = deposit_of(t, 0), deposit_of(t, 2)
    shift = 0.01 * flow[a].sum()
    flow[a] *= 0.99
    flow[b] *= 1.0 + shift / flow[b].sum()
    assert failed(plan, replace(t, flow=flow)) == {"extrusion balance", "material keeps pace", "flow per millimetre"}


def test_material_that_does_not_follow_the_speed(plan: Plan) -> None:
    # As much as the bead holds, but all of it in its first half.
    t = plan.trajectory
    at = straight_stretch(plan, 100)
    flow = t.flow.copy()
    flow[at[:50]] *= 2.0
    flow[at[50:]] = 0.0
    assert failed(plan, replace(t, flow=flow)) != set()


def test_extruded_sum_that_is_not_the_flow(plan: Plan) -> None:
    i = straight_stretch(plan, 1)[0]
    extruded = swapped(plan.trajectory.extruded, i, 1e-10)
    assert failed(plan, replace(plan.trajectory, extruded=extruded)) != set()


# --- the part ----------------------------------------------------------------------------------------------


def test_nozzle_pushed_into_the_part(plan: Plan) -> None:
    rest = rest_after(plan.trajectory, 0)
    q = plan.trajectory.q[rest]
    dq = np.zeros((250, 7))
    axis = plan.trajectory.axis[rest]
    dq[:, :6] = hump(250)[:, None] * np.linalg.solve(jacobian(plan.cell, q), np.concatenate([5e-3 * axis, np.zeros(3)]))
    found = report(plan, paused(plan, rest, dq))
    assert {check.name for check in found.checks if not check.ok} == {
        "nozzle tip outside the part",
        "nozzle clear of part and print",
    }
    assert worst(found, "nozzle tip outside the part") < -2.0
    assert found.metrics["tip_clearance_min_mm"] == worst(found, "nozzle tip outside the part")


def test_part_that_is_thicker_than_planned(plan: Plan) -> None:
    surface: Any = plan.toolpath.surface
    thicker = replace(surface, radius=surface.radius + 0.6e-3)
    found = failed(plan, toolpath=replace(plan.toolpath, surface=thicker))
    assert found == {"nozzle tip outside the part"}


# --- what is no number -------------------------------------------------------------------------------------


@pytest.mark.slow(keep=("*-deposit-nan",))
@pytest.mark.filterwarnings("ignore::RuntimeWarning")
@pytest.mark.parametrize(
    ("place", "value"), [("deposit", np.nan), ("deposit", np.inf), ("travel", np.nan), ("end", np.nan)]
)
@pytest.mark.parametrize("field", ["t", "s", "q", "tip", "quat", "axis", "speed", "flow", "extruded", "feed"])
def test_what_is_no_number_never_passes(plan: Plan, field: str, place: str, value: float) -> None:
    at = {"deposit": int(straight_stretch(plan, 1)[0]), "travel": 300, "end": -1}[place]
    values = getattr(plan.trajectory, field).copy()
    values[at] = value
    assert failed(plan, replace(plan.trajectory, **{field: values})) != set()


def test_times_that_are_not_the_samples(plan: Plan) -> None:
    t = plan.trajectory.t.copy()
    t[1000:] += 0.1
    assert failed(plan, replace(plan.trajectory, t=t)) != set()


# --- distance to a polyline --------------------------------------------------------------------------------


def brute_force(point: Array, polyline: Array) -> tuple[float, int]:
    """Distance to the nearest segment, and which one it is."""
    best, which = np.inf, 0
    for k in range(len(polyline) - 1):
        a, b = polyline[k], polyline[k + 1]
        length = float((b - a) @ (b - a))
        t = 0.0 if length == 0.0 else min(max(float((point - a) @ (b - a)) / length, 0.0), 1.0)
        d = float(np.linalg.norm(point - (a + t * (b - a))))
        if d < best:
            best, which = d, k
    return best, which


coordinates = st.floats(-1.0, 1.0, width=32)


@settings(max_examples=150, deadline=None)
@given(
    arrays(float, (5, 3), elements=coordinates),
    arrays(float, st.tuples(st.integers(2, 12), st.just(3)), elements=coordinates),
)
def test_distance_to_any_polyline(points: Array, polyline: Array) -> None:
    """However coarse it is, and however often it crosses itself."""
    found = distance_to_polyline(points, polyline)
    expected = [brute_force(point, polyline)[0] for point in points]
    assert found == pytest.approx(expected, abs=1e-12) or found.max() < 1e-5


@pytest.mark.slow
@settings(max_examples=20, deadline=None)
@given(st.floats(0.5, 3.0), st.floats(0.0, 0.3), arrays(float, (20, 3), elements=coordinates))
def test_distance_to_a_dense_curve_is_exact(turns: float, pitch: float, offsets: Array) -> None:
    """A helix sampled densely, and points near it: what the verifier asks."""
    u = np.linspace(0.0, 2.0 * np.pi * turns, 400)
    helix = np.column_stack([np.cos(u), np.sin(u), 0.5 * u + pitch * u])
    points = helix[::20] + 0.2 * offsets
    expected = [brute_force(point, helix)[0] for point in points]
    assert distance_to_polyline(points, helix) == pytest.approx(expected, abs=1e-12)


def test_distance_to_a_line_that_crosses_itself_between_vertices() -> None:
    """The nearest vertices are another pass's."""
    line = np.array([[-1.0, 0, 0], [1.0, 0, 0], [1.0, 0.5, 0], [0.1, 0.5, 0], [0.1, 0.1, 0], [0.1, -1.0, 0]])
    assert distance_to_polyline(np.array([[0.3, 0.0, 0.0], [0.09, 0.04, 0.0]]), line) == pytest.approx([0.0, 0.01])


def test_distance_of_nothing_and_of_two_points() -> None:
    line = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]])
    assert distance_to_polyline(np.zeros((0, 3)), line).shape == (0,)
    points = np.array([[0.5, 3.0, 4.0], [-3.0, 4.0, 0.0], [4.0, 0.0, 4.0], [1.0, 0.0, 0.0]])
    assert distance_to_polyline(points, line) == pytest.approx([5.0, 5.0, 5.0, 0.0])


# --- the files alone: nothing below uses the project's code but to write them ------------------------------


def test_a_bead_has_its_source_and_points_within_tolerance_by_brute_force(plan: Plan) -> None:
    bead: Bead = plan.toolpath.beads[bead_named(plan, "zigzag")]
    forth = max(brute_force(point, bead.source)[0] for point in bead.points[::5])
    assert forth * 1e3 <= 0.2
    assert forth * 1e3 > 0.1, "a sharp corner uses its tolerance"


def test_a_station_with_two_moving_axes_is_replayed_as_it_moves() -> None:
    """Pinocchio on the URDFs, against the planner's own kinematics; one axis moves, then the other, then both."""
    changes = ["cell.positioner.free=[rotation, tilt]", "cell.positioner.held_deg={}"]
    cell = build_cell(load_problem("cylinder_logo", changes))
    assert cell.joint_names[6:] == ("tilt", "rotation")
    wave = np.sin(np.linspace(0.0, 6.0, 40))
    q = np.tile(cell.home, (120, 1)) + 0.2 * np.random.default_rng(3).uniform(-1.0, 1.0, (120, 8)) * (
        [1.0] * 6 + [0, 0]
    )
    q[:40, 6], q[40:80, 7] = wave, 2.0 * wave
    q[80:, 6], q[80:, 7] = -wave, wave[::-1]
    T = cell.T_part_nozzle(q)
    nothing = np.zeros(len(q))
    motion = executed_motion(
        cell,
        Trajectory(
            dt=0.004, t=nothing, bead=nothing.astype(np.int32), layer=nothing.astype(np.int32), deposit=nothing > 0,
            s=nothing, q=q, tip=T[:, :3, 3], quat=np.zeros((120, 4)), axis=T[:, :3, 2], branch=nothing.astype(np.int8),
            speed=nothing, flow=nothing, extruded=nothing, feed=nothing,
        ),
    )  # fmt: skip
    np.testing.assert_allclose(motion.tip, T[:, :3, 3], atol=1e-12)
    np.testing.assert_allclose(motion.rotation, T[:, :3, :3], atol=1e-12)
    np.testing.assert_allclose(motion.up, np.linalg.inv(cell.holder.poses(q[:, 6:]))[:, :3, 2], atol=1e-12)
