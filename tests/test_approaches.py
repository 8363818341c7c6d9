"""The cell in the report: bodies where the joints' screws bring them, postures close enough, and what comes near."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from report_page import own_text
from solved import bed_plan, small_plan

from planner.cell.cell import Cell
from planner.plan import Approach, Plan
from planner.report.html import write_report
from planner.report.judged import PAIRS, judged
from planner.report.places import places_data
from planner.report.scene import TOLERANCE, cell_data, postures
from planner.verify.bodies import CellBodies
from planner.verify.drawing import cell_view
from planner.verify.executed import executed_motion

Array = np.ndarray


@pytest.fixture(scope="module")
def plan() -> Plan:
    return small_plan()


def exponential(screw: Array, angle: float) -> Array:
    """A turn about an axis through screw[:3] along screw[3:], by SciPy-free Rodrigues."""
    p, (x, y, z) = screw[:3], screw[3:]
    K = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    T = np.eye(4)
    T[:3, :3] += np.sin(angle) * K + (1 - np.cos(angle)) * K @ K
    T[:3, 3] = p - T[:3, :3] @ p
    return T


def carried(data: dict, q: Array, joints: list[int]) -> Array:
    T = np.eye(4)
    for j in range(*joints):
        T = T @ exponential(data["screws"].reshape(-1, 6)[j], q[j])
    return T


@pytest.mark.slow(keep=1)
@pytest.mark.parametrize("solved", [small_plan, bed_plan])
def test_screws_bring_every_body_where_the_checks_have_it(solved) -> None:
    """Poses by the product of exponentials are Pinocchio's."""
    plan = solved()
    data, bodies, cell = cell_data(plan.cell, plan.view), CellBodies.of(plan.cell), plan.cell
    assert data is not None
    drawn = {name: body for body in data["bodies"] for name in body["bodies"]}
    assert sorted(drawn) == sorted({bodies.name(thing) for thing in bodies.things})
    zero = np.zeros(len(cell.joint_names))
    for q in plan.trajectory.q[:: len(plan.trajectory) // 3]:
        now, rest = bodies.poses(np.array([q, zero]))
        for thing in bodies.things:
            expected = now[thing.carrier] @ np.linalg.inv(rest[thing.carrier])
            assert carried(data, q, drawn[bodies.name(thing)]["joints"]) == pytest.approx(expected, abs=1e-9)
        nozzle = carried(data, q, [0, data["arm"]]) @ data["nozzle"].reshape(4, 4)
        part = carried(data, q, [data["arm"], len(q)]) @ data["part"].reshape(4, 4)
        expected = cell.T_part_nozzle(q[None])[0]
        assert np.linalg.inv(part) @ nozzle == pytest.approx(expected, abs=1e-9)


def test_postures_between_those_of_the_page_are_close_enough(plan: Plan) -> None:
    kept = postures(plan.cell, plan.trajectory)
    t, nj = plan.trajectory, len(plan.cell.joint_names)
    q = kept["q"].reshape(-1, nj)
    assert kept["sample"][0] == 0 and kept["sample"][-1] == len(t) - 1 and (np.diff(kept["sample"]) > 0).all()
    assert len(q) < len(t) / 4, "far fewer than samples"
    between = np.column_stack([np.interp(np.arange(len(t)), kept["sample"], q[:, k]) for k in range(nj)])
    tip = executed_motion(plan.cell, replace(t, q=between)).tip
    off = np.linalg.norm(tip - t.tip, axis=1).max()
    assert off < TOLERANCE + 2e-6
    assert 1e-3 * kept["off_mm"] == pytest.approx(off, abs=3e-6)


def test_too_many_postures_are_thinned_further(plan: Plan, monkeypatch: pytest.MonkeyPatch) -> None:
    fine = postures(plan.cell, plan.trajectory)
    monkeypatch.setattr("planner.report.scene.MOST_POSTURES", len(fine["sample"]) // 2)
    coarse = postures(plan.cell, plan.trajectory)
    assert len(coarse["sample"]) <= len(fine["sample"]) // 2 and coarse["off_mm"] > fine["off_mm"]


def test_thinning_ends_where_the_first_looks_alone_would_be_too_many(
    plan: Plan, monkeypatch: pytest.MonkeyPatch
) -> None:
    most = len(plan.trajectory) // 50
    monkeypatch.setattr("planner.report.scene.FIRST", 10)
    monkeypatch.setattr("planner.report.scene.MOST_POSTURES", most)
    kept = postures(plan.cell, plan.trajectory)["sample"]
    assert len(kept) <= most and kept[-1] == len(plan.trajectory) - 1


def test_a_cell_can_be_shown_without_a_plan(plan: Plan) -> None:
    view = cell_view(plan.cell)
    assert plan.view is not None and view.names == plan.view.names
    assert (view.joints == plan.view.joints).all() and set(view.kinds) >= {"arm", "head", "holder"}
    assert cell_data(plan.cell, None) is None and isinstance(plan.cell, Cell)


def test_each_pair_is_one_row_and_the_nearest_is_that_of_its_check(plan: Plan) -> None:
    found = judged(plan)
    pairs = [row.place.pair for row in found.rows if row.place is not None and row.place.pair]
    assert len(pairs) == len(set(pairs)) and set(pairs) == {(each.a, each.b) for each in plan.approaches}
    worst = next(check for check in plan.checks if check.name == "robots clear of each other and of fixtures")
    (nearest,) = (each for each in plan.approaches if worst.where.startswith(f"{each.a} and {each.b}"))
    (row,) = (row for row in found.rows if row.name == worst.name)
    assert row.place is not None and row.place.pair == (nearest.a, nearest.b) and row.place.sample == nearest.sample
    data = places_data(plan, found.places)
    drawn = {*sum(plan.view.bodies, ()), "part", "print"} if plan.view else set()
    assert all(name in drawn for each in data for name in each["pair"])


def test_a_pair_that_is_too_near_stands_out_and_names_are_escaped(plan: Plan, tmp_path: Path) -> None:
    evil = Approach("<img src=x>", "bead 3", 1e-3, 5e-3, 0)
    changed = replace(plan, approaches=(evil, *plan.approaches[1:]))
    found = judged(changed)
    (row,) = found.failed
    assert row.name == "<img src=x> – bead 3" and row.value == "1.0" and row.limit == "≥\u20095"
    assert found.places[0].letter == "A" and found.places[0].pair == ("<img src=x>", "bead 3")
    (first,) = (each for each in places_data(changed, found.places) if each["pair"][:1] == ["<img src=x>"])
    assert first["pair"] == ["<img src=x>", "print"]
    write_report(changed, tmp_path / "r.html")
    text = own_text(tmp_path / "r.html")
    assert "<tr class=bad>" in text and "<img" not in text


def test_nothing_near_is_no_row(plan: Plan) -> None:
    found = judged(replace(plan, approaches=()))
    assert PAIRS not in dict(found.rest) and not any(place.pair for place in found.places)
