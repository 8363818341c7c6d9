"""As published: each paper's own way, which of them a problem has, and that each shipped problem has its baseline."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache

import numpy as np
import pytest

from benchmarks.wing import ONE_NOZZLE
from planner.base.arrays import Array
from planner.base.errors import InputError, Refusal
from planner.base.singular_values import least_singular_values
from planner.cell.cell import Cell, build_cell
from planner.planning.context import PlanningContext, context_of
from planner.problem import load_problem, shipped_problems
from planner.resolve.joint_path import JointPath
from planner.resolve.strategies import STRATEGIES
from planner.toolpath.build import build_toolpath
from tests.test_problems import SMALL

STEP = np.radians(15.0)  # between headings, and between places where the part is held


@cache
def given(name: str, *overrides: str) -> PlanningContext:
    problem = load_problem(name, (*overrides, *SMALL.get(name, ())))
    return context_of(problem, build_cell(problem), build_toolpath(problem))


def paths(context: PlanningContext) -> tuple[JointPath, ...]:
    resolve = context.problem.resolve
    return STRATEGIES["as_published"](context.cell, context.tasks, resolve, context.obstacles)


def nozzles(cell: Cell, found: Sequence[JointPath]) -> Array:
    """Orientations (n, 3, 3) of the nozzle in the world."""
    return np.concatenate([cell.arm.poses(path.q[:, : len(cell.arm)])[:, :3, :3] for path in found])


def sigma(cell: Cell, found: Sequence[JointPath]) -> float:
    q = np.concatenate([path.q[:, : len(cell.arm)] for path in found])
    return float(least_singular_values(cell.arm.jacobians(q)[:, :, list(cell.solved)]).min())


def headings(cell: Cell, found: Sequence[JointPath]) -> Array:
    """Angles (n) by which the nozzle is turned about its axis, once the least turn from home to that axis is taken away."""
    home = cell.arm.poses(cell.home[None, : len(cell.arm)])[0, :3, :3]
    R = nozzles(cell, found)
    a, b = home[:, 2], R[:, :, 2]
    v, c = np.cross(a, b), b @ a
    K = np.zeros((len(R), 3, 3))
    K[:, 0, 1], K[:, 0, 2], K[:, 1, 2] = -v[:, 2], v[:, 1], -v[:, 0]
    K -= np.swapaxes(K, 1, 2)
    least = np.eye(3) + K + K @ K / (1.0 + c)[:, None, None]  # Rodrigues, from the axis at home to that of each sample
    turned = home.T @ np.swapaxes(least, 1, 2) @ R
    return np.arctan2(turned[:, 1, 0], turned[:, 0, 0])


@pytest.mark.parametrize(
    ("name", "way"),
    [
        ("cylinder_logo", "turning_table"),
        ("hemisphere_honeycomb", "turning_table"),
        ("peer_cap", "turning_table"),
        ("naca0015_wing", "fixed_heading"),
        ("shoehorn", "fixed_heading"),
        ("fibre_bowl", "along_path"),
    ],
)
def test_a_problem_has_the_way_of_its_paper(name: str, way: str) -> None:
    assert load_problem(name).resolve.published == way


def test_a_problem_may_name_another_way() -> None:
    assert load_problem("fibre_bowl", ["resolve.published=fixed_heading"]).resolve.published == "fixed_heading"
    with pytest.raises(InputError, match="turning_table, fixed_heading, along_path"):
        load_problem("fibre_bowl", ["resolve.published=along"])


@pytest.mark.slow(keep=("peer_cap", "rail_panel"))
@pytest.mark.parametrize("name", shipped_problems())
def test_every_shipped_problem_has_its_baseline(name: str) -> None:
    context = given(name)
    found = paths(context)
    low, high = context.cell.limits.q_min, context.cell.limits.q_max
    assert [path.task for path in found] == list(context.tasks)
    for path in found:
        assert (path.q >= low).all() and (path.q <= high).all()
        tip = context.cell.at(path.task.material).T_part_nozzle(path.q)[:, :3, 3]
        np.testing.assert_allclose(tip, path.task.tip, atol=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["naca0015_wing", "propeller_blade"])
def test_a_fixed_heading_is_the_same_all_over_the_print(name: str) -> None:
    """And the part is held; no singularity is met, though the wing's home posture is near one."""
    context = given(name, *(ONE_NOZZLE if name == "naca0015_wing" else ()))
    found = paths(context)
    cell = context.cell
    heading = headings(cell, found)
    assert np.ptp(np.unwrap(heading)) < 1e-6
    assert abs(heading[0] / STEP - round(heading[0] / STEP)) < 1e-6
    held = np.concatenate([path.q[:, len(cell.arm) :] for path in found])
    assert not held.size or np.ptp(held) == 0.0
    assert sigma(cell, found) >= context.problem.resolve.min_sigma


@pytest.mark.slow
def test_on_the_wing_the_nozzle_turns_about_the_span_alone() -> None:
    """Arigela et al., section 2.3.2: one axis of rotation from upright."""
    context = given("naca0015_wing", *ONE_NOZZLE)
    R = nozzles(context.cell, paths(context))
    upright = R[np.argmin(R[:, 2, 2])]
    turned = np.swapaxes(R @ upright.T, 1, 2)
    span = np.array([0.0, 1.0, 0.0])
    np.testing.assert_allclose(turned @ span, np.tile(span, (len(R), 1)), atol=1e-6)


@pytest.mark.parametrize("name", ["fibre_plane", "fibre_corrugated"])
def test_along_the_path_the_nozzles_x_keeps_its_angle_to_it(name: str) -> None:
    context = given(name)
    cell, found = context.cell, paths(context)
    angles = []
    for path in found:
        T = cell.T_part_nozzle(path.q)
        step = np.gradient(path.task.tip, axis=0)
        x, y = (np.einsum("ij,ij->i", step, T[:, :3, k]) for k in (0, 1))
        angles.append(np.arctan2(y, x))
        assert np.ptp(path.q[:, len(cell.arm) :]) == 0.0  # the second arm holds the part
    assert np.ptp(np.unwrap(np.concatenate(angles))) < 1e-5


def test_of_headings_that_pass_the_check_the_nearest_to_home_is_taken() -> None:
    """A ladder of headings by hand: those before the one taken have no way at all."""
    context = given("peer_cap")
    heading = headings(context.cell, paths(context))
    taken = round(abs(heading[0]) / STEP)
    assert np.ptp(np.unwrap(heading)) < 1e-6 and taken == 8
    coarse = given("peer_cap", "resolve.roll_step_deg=90")  # 0, 90, 180: none of them serves
    with pytest.raises(Refusal, match="joint_4 would turn further than its range"):
        paths(coarse)


def test_a_track_goes_along_with_the_nozzle() -> None:
    context = given("rail_panel")
    cell, found = context.cell, paths(context)
    q = np.concatenate([path.q for path in found])
    tip = cell.arm.poses(q[:, : len(cell.arm)])[:, 0, 3]
    home = cell.arm.poses(cell.home[None, : len(cell.arm)])[0, 0, 3]
    np.testing.assert_allclose(q[:, 0] - cell.home[0], tip - home, atol=1e-6)  # it runs along the world's x
