"""Plots: that they draw on the axes they are given, and the numbers that they draw."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
import pytest
from matplotlib.axes import Axes
from mpl_toolkits.mplot3d.art3d import Line3DCollection
from solved import small_plan

from planner import plots
from planner.base.errors import InputError
from planner.plan import Plan
from planner.resolve.roll_map import LIMITS, SINGULAR

mpl.use("agg")
ZIGZAG, RING = 0, 1


@pytest.fixture
def ax() -> Iterator[Axes]:
    figure, axes = plt.subplots()
    yield axes
    plt.close(figure)


DRAWN: dict[str, Callable[[Plan, Any], Any]] = {
    "speed": plots.speed,
    "speed_of_a_bead": lambda plan, ax: plots.speed(plan, ax, bead=ZIGZAG),
    "path_derivatives": lambda plan, ax: plots.path_derivatives(plan, ZIGZAG, 2, ax),
    "speed_ceilings": lambda plan, ax: plots.speed_ceilings(plan, ZIGZAG, ax),
    "joint_ranges": plots.joint_ranges,
    "redundancy_map": lambda plan, ax: plots.redundancy_map(plan.roll_maps[0], ax),
    "compare": lambda plan, ax: plots.compare({"one": plan, "two": plan}, "print_time_s", ax),
}


@pytest.mark.slow(keep=2)
@pytest.mark.parametrize("name", DRAWN)
def test_each_draws_on_the_axes_it_is_given(name: str, ax: Axes) -> None:
    assert DRAWN[name](small_plan(), ax) is ax and ax.has_data()
    if name != "compare":
        assert any(unit in ax.get_xlabel() for unit in (", mm", ", s", ", deg"))
    ax.figure.canvas.draw()


def test_axes_are_made_where_none_are_given() -> None:
    drawn = plots.toolpath(small_plan(), measure="layer")
    assert drawn.name == "3d" and len(plt.get_fignums()) == 1
    plt.close(drawn.figure)


def test_derivatives_times_speed_are_the_rates_of_the_motion(ax: Axes) -> None:
    """Where the ring is printed at about the commanded speed, central differences of its samples say the same."""
    plan = small_plan()
    plots.path_derivatives(plan, RING, 1, ax)
    rows = np.flatnonzero(plan.deposit & (plan.bead == RING))[5:-5]
    rates = np.abs(plan.q[rows + 1] - plan.q[rows - 1]) / (2 * plan.trajectory.dt) / plan.cell.limits.velocity
    pace = plan.speed[rows] / plan.problem.process.speed
    steady = np.abs(pace - 1) < 0.02
    assert steady.sum() > 100
    drawn = {line.get_label(): line for line in ax.lines}
    for j, name in enumerate(plan.joint_names):
        share = np.interp(plan.s[rows] * 1e3, drawn[name].get_xdata(), drawn[name].get_ydata())
        np.testing.assert_allclose((share * pace)[steady], rates[steady, j], atol=1e-3)


def test_the_speed_reached_stays_below_the_ceiling_of_velocity(ax: Axes) -> None:
    plan = small_plan()
    plots.speed_ceilings(plan, ZIGZAG, ax)
    lines = {line.get_label(): line for line in ax.lines}
    reached, ceiling = lines["reached"], lines["velocity limits"]
    at = np.interp(reached.get_xdata(), ceiling.get_xdata(), ceiling.get_ydata())
    assert (reached.get_ydata() <= 1.01 * at).all()
    assert min(lines["jerk limits"].get_ydata()) < 0.9 * plan.problem.process.speed * 1e3, "corners ask for a dip"
    assert min(reached.get_ydata()) == pytest.approx(plan.metrics["speed_min_mm_s"], rel=0.05)


def test_a_rest_that_was_planned_is_no_dip(ax: Axes) -> None:
    plan = small_plan()
    first, *others = plan.dips
    plots.speed(replace(plan, dips=(replace(first, limit="stop"), *others)), ax)
    assert f"dips: {len(others)}" in ax.get_legend_handles_labels()[1]


def test_ranges_are_those_used(ax: Axes) -> None:
    plan = small_plan()
    plots.joint_ranges(plan, ax)
    bars = [bar for bar in ax.patches if bar.get_height() == 0.5]
    q = np.degrees(plan.q[plan.deposit])
    np.testing.assert_allclose([bar.get_x() for bar in bars], q.min(axis=0))
    np.testing.assert_allclose([bar.get_width() for bar in bars], np.ptp(q, axis=0))


def test_a_long_rail_ends_where_it_does(ax: Axes) -> None:
    plan = small_plan()
    of_plan, last = plan.cell.limits, len(plan.joint_names) - 1
    low, high = (np.append(ends[:-1], end) for ends, end in ((of_plan.q_min, 0.0), (of_plan.q_max, 3.0)))
    limits = replace(of_plan, sliding=(last,), q_min=low, q_max=high)
    plots.joint_ranges(replace(plan, cell=replace(plan.cell, limits=limits)), ax)
    rail = ax.containers[0][last]
    assert (rail.get_x(), rail.get_width()) == (0.0, 3000.0) and ax.get_xlim()[1] > 3000.0


def test_a_thinned_path_keeps_its_slowest_place(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(plots, "MOST_SEGMENTS", 100)
    plan = small_plan()
    drawn = plots.toolpath(plan)
    (lines,) = [each for each in drawn.collections if isinstance(each, Line3DCollection)]
    assert len(lines.get_array()) <= 100
    assert lines.get_array().min() == pytest.approx(plan.metrics["speed_min_mm_s"])
    plt.close(drawn.figure)


def test_excluded_areas_are_hatched_each_in_its_way(ax: Axes) -> None:
    found = small_plan().roll_maps[0]
    why = found.why.copy()
    why[:, :20], why[:, 20:40] = LIMITS, SINGULAR
    plots.redundancy_map(replace(found, why=why), ax)
    legend = ax.get_legend()
    assert legend is not None
    assert [text.get_text() for text in legend.get_texts()] == ["joint limits", "singularity"]
    hatches = {patch.get_hatch() for patch in legend.get_patches()}
    assert len(hatches) == 2 and None not in hatches
    values = ax.collections[0].get_array()
    assert (
        values is not None
        and np.ma.count_masked(values) + np.isnan(np.ma.filled(values, 0.0)).sum() == (why != 0).sum()
    )


def test_what_is_not_verified_is_hatched(ax: Axes) -> None:
    plan = small_plan()
    bad = replace(plan, checks=(replace(plan.checks[0], ok=False),))
    plots.compare({"good": plan, "bad": bad}, "sigma_min", ax, "σ")
    assert [bar.get_hatch() for bar in ax.patches] == [None, "///"]
    assert ax.get_title(loc="left") == "σ" and [each.get_text() for each in ax.get_yticklabels()] == ["good", "bad"]


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        (lambda plan: plots.redundancy_map(plan.roll_maps[0], measure="sgima"), "did you mean sigma"),
        (lambda plan: plots.toolpath(plan, measure="colour"), "one of speed, sigma, layer, bead"),
        (lambda plan: plots.path_derivatives(plan, 3, 1), "no bead 3 in this plan (a number from 0 to 2)"),
        (lambda plan: plots.path_derivatives(plan, 0, 4), "1 velocity, 2 acceleration, 3 jerk"),
        (lambda plan: plots.compare({"a": plan}, "sigma_mim"), "did you mean sigma_min"),
    ],
)
def test_wrong_names_are_said(wrong: Callable[[Plan], object], message: str) -> None:
    with pytest.raises(InputError) as error:
        wrong(small_plan())
    assert message in str(error.value)
    assert not plt.get_fignums(), "no empty figure is left behind"
