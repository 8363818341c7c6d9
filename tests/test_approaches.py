"""What comes near, in the report: the right pairs, bodies where they are, and names that cannot become markup."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from solved import small_plan

from planner.plan import Approach, Plan
from planner.report.approaches import MARKED, approaches_section, cell_figure


@pytest.fixture(scope="module")
def plan() -> Plan:
    return small_plan()


def test_bodies_are_drawn_where_they_come_near(plan: Plan) -> None:
    """The nozzle's own vertices, taken through its carrier's pose, end at the tip of that moment."""
    figure, view = cell_figure(plan), plan.view
    assert figure is not None
    assert view is not None
    assert len(figure["poses"]) == len(plan.approaches) == len(figure["pairs"])
    k = view.names.index("nozzle")
    body = figure["bodies"][k]
    local = np.asarray(body["points"], dtype=float).reshape(-1, 3)
    for which, approach in enumerate(plan.approaches):
        T = np.asarray(figure["poses"][which], dtype=float).reshape(-1, 4, 4)
        nozzle = local @ T[body["carrier"], :3, :3].T + T[body["carrier"], :3, 3]
        tip = T[-1, :3, :3] @ plan.trajectory.tip[approach.sample] * 1e3 + T[-1, :3, 3]
        assert np.allclose(tip, figure["tips"][which], atol=0.01)
        assert np.linalg.norm(nozzle - tip, axis=1).min() < 0.61  # the face is as wide as twice the bore


def test_the_print_and_the_part_move_with_the_part_frame(plan: Plan) -> None:
    figure = cell_figure(plan)
    assert figure is not None
    by_name = {body["name"]: body for body in figure["bodies"]}
    last = len(np.asarray(figure["poses"][0]).reshape(-1, 4, 4)) - 1
    assert by_name["part"]["carrier"] == by_name["print"]["carrier"] == last
    points = np.asarray(by_name["print"]["points"]).reshape(-1, 3)
    assert np.nanmax(np.abs(points[:, 2] - 1e3 * np.nanmean(plan.trajectory.tip[plan.trajectory.deposit, 2]))) < 30.0
    assert "corners" not in by_name["print"]


def test_the_pair_is_named_marked_and_told_with_its_place(plan: Plan) -> None:
    figure, text = cell_figure(plan), approaches_section(plan)
    assert figure is not None
    names = {body["name"] for body in figure["bodies"]}
    assert all(name in names for pair in figure["pairs"] for name in pair)
    assert figure["marked"] == list(MARKED)
    assert text.count("<option>") == len(plan.approaches)
    assert f"{plan.approaches[0].distance * 1e3:.1f}" in text


def test_a_pair_that_is_too_near_stands_out_and_names_are_escaped(plan: Plan) -> None:
    evil = Approach("<img src=x>", "bead 3", 1e-3, 5e-3, 0)
    changed = replace(plan, approaches=(evil, *plan.approaches[1:]))
    text = approaches_section(changed)
    assert "<tr class=bad>" in text
    assert "<img" not in text
    figure = cell_figure(changed)
    assert figure is not None
    assert figure["pairs"][0] == ["<img src=x>", "print"]


def test_nothing_near_is_no_section(plan: Plan) -> None:
    assert approaches_section(replace(plan, approaches=())) == ""
    assert cell_figure(replace(plan, view=None)) is None
