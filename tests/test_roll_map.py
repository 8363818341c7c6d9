"""The roll × path map against single postures, one by one."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from solved import small_plan

from planner.base.arrays import Array
from planner.cell.cell import Cell, build_cell
from planner.collision.scene import Obstacles
from planner.plan import Plan
from planner.problem import load_problem
from planner.report.page import packed
from planner.report.roll_map import roll_map_figures, roll_map_section
from planner.resolve import roll_map as module
from planner.resolve.joint_path import JointPath
from planner.resolve.roll_map import (
    BEAD_COLUMNS,
    COLLISION,
    FREE,
    LIMITS,
    REACH,
    REASONS,
    SINGULAR,
    RollMap,
    roll_map,
    roll_maps,
)
from planner.toolpath.task import NozzleTask

COLUMNS, ROLLS = 9, 24


class Wave(Obstacles):
    """Something that is touched by some angles of joint 6 and of the holder."""

    def __init__(self, width: float = 0.01) -> None:
        object.__setattr__(self, "width", width)
        object.__setattr__(self, "asked", [])

    @property
    def any(self) -> bool:
        return True

    def margins(self, q: Array, now: Array, enough: float, more: float = 0.0) -> tuple[Array, NDArray[np.int64]]:
        self.asked.append(len(q))  # type: ignore[attr-defined]
        assert len(now) == len(q)
        margin = self.width * (0.3 + np.sin(q[:, 5] + q[:, 6]))  # type: ignore[attr-defined]
        return np.minimum(margin, enough), np.zeros(len(q), dtype=np.int64)


def unplanned(cell: Cell, task: NozzleTask, *chosen: float) -> JointPath:
    """A task without a path, on any branch: the nozzle upright, the chosen joints at angles [rad], or at home."""
    q = np.tile(cell.home, (len(task), 1))
    if chosen:
        q[:, list(cell.chosen)] = chosen
    return JointPath(task, np.full(len(task), np.nan), np.zeros((len(task), 2)), q, -1)


def small_paths() -> tuple[JointPath, ...]:
    return small_plan().paths


def by_hand(
    path: JointPath, i: int, roll: float, min_sigma: float, limits: tuple[Array, Array]
) -> tuple[int, float, float]:
    """why, sigma and limit of one posture of the small print, from the pose of its nozzle."""
    cell = small_plan().cell
    c, s = np.cos(roll), np.sin(roll)
    T_part_nozzle = np.eye(4)
    T_part_nozzle[:3, :3] = path.task.frames[i] @ np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    T_part_nozzle[:3, 3] = path.task.tip[i]
    T_world_nozzle = cell.holder.poses(path.q[i : i + 1, 6:])[0] @ T_part_nozzle
    flange = np.linalg.inv(cell.T_world_base) @ T_world_nozzle @ np.linalg.inv(cell.T_flange_nozzle)
    every, exists = cell.inverse.solve(flange[None])
    if not exists[0, path.branch]:
        return REACH, np.nan, np.nan
    q = every[0, path.branch]
    np.testing.assert_allclose(cell.arm.poses(q[None])[0], T_world_nozzle, atol=1e-9)
    low, high = limits
    turned = q + 2 * np.pi * np.array([[-1], [0], [1]])
    room = float(np.minimum(turned - low, high - turned).max(axis=0).min())
    if room < 0:
        return LIMITS, np.nan, room
    sigma = float(np.linalg.svd(cell.arm.jacobians(q[None])[0], compute_uv=False)[-1])
    return (SINGULAR if sigma < min_sigma else FREE), sigma, room


def column(path: JointPath, s: float) -> int:
    task = path.task
    return int(np.argmin(np.abs(task.s - task.s[task.first] - s)))


def test_every_posture_by_hand() -> None:
    """With ranges so narrow, and a part so far away, that all reasons but collision come up."""
    cell, paths = small_plan().cell, small_paths()
    low, high = cell.limits.q_min.copy(), cell.limits.q_max.copy()
    low[5], high[5] = -2.2, 2.5
    tight = replace(cell, limits=replace(cell.limits, q_min=low, q_max=high))
    far = replace(paths[1].task, tip=paths[1].task.tip - 0.05 * paths[1].task.frames[:, :, 2])
    moved = (paths[0], replace(paths[1], task=far))
    found = roll_map(tight, moved, min_sigma=0.215, columns=COLUMNS, rolls=ROLLS)
    assert found.why.shape == found.sigma.shape == (COLUMNS, ROLLS) and set(found.bead) == {0, 1}
    for m in range(COLUMNS):
        path = moved[found.bead[m]]
        for k in range(ROLLS):
            why, sigma, limit = by_hand(path, column(path, found.s[m]), found.roll[k], 0.215, (low[:6], high[:6]))
            assert found.why[m, k] == why, (m, k, REASONS[why], limit)
            np.testing.assert_allclose(found.sigma[m, k], sigma, rtol=1e-9)
            np.testing.assert_allclose(found.limit[m, k], limit, atol=1e-9)
    assert {FREE, LIMITS, SINGULAR} <= set(np.unique(found.why))
    assert np.isnan(found.clearance).all()


def test_out_of_reach() -> None:
    plan = small_plan()
    away = replace(plan.paths[0].task, tip=plan.paths[0].task.tip + np.array([5.0, 0.0, 0.0]))
    found = roll_map(plan.cell, (replace(plan.paths[0], task=away),), columns=3, rolls=8)
    assert (found.why == REACH).all() and np.isnan(found.limit).all() and not found.free.any()


def test_metres_to_a_rails_end_are_no_angle() -> None:
    cell, x = build_cell(load_problem("rail_panel")), np.linspace(0.0, 0.1, 9)
    tip, frames = np.column_stack([x, 0.0 * x, 0.0 * x]), np.tile(np.diag([1.0, -1.0, -1.0]), (len(x), 1, 1))
    path = unplanned(cell, NozzleTask(0, "line", 0, tip, frames, x, 0, len(x) - 1, 0.08))

    def map_with(room: float) -> RollMap:
        low, high = cell.limits.q_min.copy(), cell.limits.q_max.copy()
        low[0], high[0] = cell.home[0] - room, cell.home[0] + room
        ending = replace(cell, limits=replace(cell.limits, q_min=low, q_max=high))
        return roll_map(ending, [path], columns=3, rolls=8)

    found, at_its_end = map_with(1.5), map_with(1e-3)
    assert found.free.any()
    np.testing.assert_array_equal(at_its_end.limit, found.limit)
    np.testing.assert_array_equal(at_its_end.why, found.why)
    assert not map_with(-1e-3).free.any()


def test_of_seven_axes_all_count_as_in_the_metric() -> None:
    cell = build_cell(load_problem("peer_cap", ["cell.arm=iiwa", "cell.home_deg=[0, 30, 0, -80, 0, 60, 0]"]))
    q = np.random.default_rng(0).uniform(cell.limits.q_min, cell.limits.q_max, (20, 7))
    J = cell.arm.jacobians(q)
    for found, columns in zip(module._sigmas(cell, q), (range(7), cell.solved), strict=True):
        expected = np.linalg.svd(J[:, :, list(columns)], compute_uv=False)[:, -1]
        np.testing.assert_allclose(found, expected, atol=1e-9)


def test_the_chosen_roll_is_free_and_has_the_plans_sigma() -> None:
    plan = small_plan()
    found = roll_map(plan.cell, plan.paths, columns=40, rolls=720)
    assert (found.chosen >= -np.pi).all() and (found.chosen < np.pi).all()
    nearest = np.round((found.chosen + np.pi) / (2 * np.pi) * 720).astype(int) % 720
    at = np.arange(len(found.s))
    assert found.free[at, nearest].all()
    for m in range(0, len(at), 4):
        path = plan.paths[found.bead[m]]
        q = path.q[column(path, found.s[m])]
        sigma = np.linalg.svd(plan.cell.arm.jacobians(q[None, :6])[0], compute_uv=False)[-1]
        np.testing.assert_allclose(found.sigma[m, nearest[m]], sigma, rtol=0.02)


def test_places_run_evenly_along_what_is_deposited() -> None:
    plan = small_plan()
    found = roll_map(plan.cell, plan.paths, columns=60, rolls=4)
    length = plan.metrics["deposited_length_mm"] / 1e3
    assert found.along[0] == 0.0 and found.along[-1] == pytest.approx(length, rel=1e-3)
    np.testing.assert_allclose(np.diff(found.along), length / 59, atol=1e-3)
    before = np.concatenate([[0.0], np.cumsum([bead.length for bead in plan.beads])])
    np.testing.assert_allclose(found.along, before[found.bead] + found.s, atol=1e-4)


def test_any_branch_is_the_best_of_all() -> None:
    plan = small_plan()
    narrow = replace(plan.cell.limits, q_min=np.full(7, -1.9), q_max=np.full(7, 1.9))
    cell = replace(plan.cell, limits=narrow)
    every = [
        roll_map(cell, [replace(path, branch=b) for path in plan.paths], min_sigma=0.1, columns=COLUMNS, rolls=ROLLS)
        for b in range(8)
    ]
    best = roll_map(cell, plan.paths, min_sigma=0.1, columns=COLUMNS, rolls=ROLLS, any_branch=True)
    assert (best.free == np.any([each.free for each in every], axis=0)).all()
    sigma = np.max([np.where(each.free, each.sigma, 0.0) for each in every], axis=0)
    np.testing.assert_array_equal(best.sigma[best.free], sigma[best.free])
    assert 0 < best.free.sum() < best.free.size


def test_a_task_without_a_path() -> None:
    plan = small_plan()
    task, angle = plan.paths[0].task, float(plan.paths[0].q[0, 6])
    found = roll_map(plan.cell, [unplanned(plan.cell, task, angle)], columns=5, rolls=12)
    assert np.isnan(found.chosen).all() and found.free.any()
    held = [replace(plan.paths[0], q=np.column_stack([plan.paths[0].q[:, :6], np.full(len(task), angle)]))]
    same = roll_map(plan.cell, held, columns=5, rolls=12, any_branch=True)
    np.testing.assert_array_equal(found.why, same.why)


def test_what_touches_is_a_collision(monkeypatch: pytest.MonkeyPatch) -> None:
    plan, wave = small_plan(), Wave()
    drawn = roll_map(plan.cell, plan.paths, wave, columns=90, rolls=120)
    asked = sum(wave.asked)
    monkeypatch.setattr(module, "EVERY_COLUMN", 1)
    monkeypatch.setattr(module, "EVERY_ROLL", 1)
    exact = roll_map(plan.cell, plan.paths, Wave(), columns=90, rolls=120)
    assert asked < 0.4 * exact.why.size, "most is drawn between what was found"
    assert 0.2 < (exact.why == COLLISION).mean() < 0.6
    assert (exact.why != drawn.why).mean() < 2e-3
    np.testing.assert_allclose(drawn.clearance, exact.clearance, atol=3e-4)
    assert (exact.clearance[exact.why == COLLISION] < 0.0).all() and (exact.clearance[exact.free] >= 0.0).all()


def test_a_plan_carries_its_maps() -> None:
    plan = small_plan()
    whole, *beads = plan.roll_maps
    assert isinstance(whole, RollMap) and whole.free[0].any()
    assert len(whole.s) <= round(plan.metrics["deposited_length_mm"])
    assert beads and all(len(set(each.bead)) == 1 and len(each.s) <= BEAD_COLUMNS for each in beads)
    worst = int(plan.bead[np.flatnonzero(plan.deposit)[np.argmin(plan.series["sigma"][plan.deposit])]])
    assert beads[0].bead[0] == worst
    with pytest.raises(ValueError, match="read-only"):
        whole.why[0, 0] = 3
    cap = roll_maps(plan.cell, plan.paths[:1], Wave(), 0.0)
    assert len(cap) == 2


def report_map(plan: Plan) -> dict[str, Any]:
    figures = roll_map_figures(plan)
    assert figures is not None
    return figures


def excluded(plan: Plan) -> Plan:
    """The plan as if some rolls led to collisions, and others, in two areas, to a singularity."""
    found = plan.roll_maps[0]
    why = found.why.copy()
    why[:, 100:], why[5:25, 10:14], why[60:70, 40:60] = COLLISION, SINGULAR, SINGULAR
    return replace(plan, roll_maps=(replace(found, why=why), *plan.roll_maps[1:]))


def test_the_report_carries_the_map() -> None:
    plan = excluded(small_plan())
    figures = report_map(plan)
    for found, drawn in zip(plan.roll_maps, figures["maps"], strict=True):
        for measure, flat in zip(figures["measures"], drawn["values"], strict=True):
            values = flat.reshape(len(found.roll), len(found.s)).T.astype(float)
            assert ((values >= figures["code"]) == ~found.free).all()
            assert (values[~found.free] - figures["code"] == found.why[~found.free]).all()
            own = np.degrees(found.limit) if measure["key"] == "limit" else found.sigma
            np.testing.assert_allclose(
                values[found.free] * measure["step"], own[found.free], atol=0.51 * measure["step"]
            )
        assert (np.diff(drawn["t"]) > 0).all() and (np.diff(drawn["along"]) > 0).all()
        at = np.interp(drawn["t"], plan.t, np.arange(len(plan.t))).round().astype(int)
        assert (plan.bead[at] == found.bead).all()
        np.testing.assert_allclose(plan.s[at], found.s, atol=0.5e-3)


def test_each_area_that_cannot_be_used_has_a_letter_in_it() -> None:
    plan = excluded(small_plan())
    found, drawn = plan.roll_maps[0], report_map(plan)["maps"][0]["letters"]
    where: dict[int, set[str]] = {}
    for x, y, letter in zip(drawn["x"], drawn["y"], drawn["text"], strict=True):
        i = int(np.argmin(np.abs(found.along * 1e3 - x)))
        j = int(np.argmin(np.abs(np.degrees(found.roll) - y)))
        assert letter == ("S" if found.why[i, j] == SINGULAR else "C") and not found.free[i, j]
        where.setdefault(j // 30, set()).add(letter)
    assert where[3] == {"C"} and where[0] == where[1] == {"S"}
    section = roll_map_section(plan)
    assert "<span class=key>C</span> collision" in section and "joint limits" not in section
    assert f"{100 * found.free.mean():.0f} % of this is free" in section


def test_a_large_map_is_small_in_the_report() -> None:
    plan = small_plan()
    rng = np.random.default_rng(1)
    m, k = 450, 120
    big = replace(
        plan.roll_maps[0], bead=np.zeros(m, dtype=np.int32), s=np.linspace(0.0, 0.03, m), along=np.linspace(0.0, 9.0, m),
        chosen=np.zeros(m), why=np.zeros((m, k), dtype=np.uint8), sigma=rng.random((m, k)), limit=rng.random((m, k)),
        clearance=rng.random((m, k)),
    )  # fmt: skip
    noise = packed(roll_map_figures(replace(plan, roll_maps=(big,))))
    assert len(noise) < 300_000, "even where nothing can be compressed"


def test_no_map_no_section() -> None:
    plan = replace(small_plan(), roll_maps=())
    assert roll_map_section(plan) == "" and roll_map_figures(plan) is None
