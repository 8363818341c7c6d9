"""Recordings of runs held against their plan: places, what is off across the path, noise, and what is refused."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from learn_fixtures import (
    corrections_by,
    first_run,
    log_of,
)
from solved import small_plan

from benchmarks.learn import true_way, write_log
from planner.base.arrays import Array
from planner.base.errors import EXIT_INPUT
from planner.base.nearest import distance_to_polyline
from planner.feedback.learn_command import main
from planner.feedback.learn_fit import (
    errors_of,
)
from planner.feedback.learn_track import nozzle_path, recorded_way
from planner.feedback.recordings import read_log
from planner.feedback.tracking import TrackedPath, track
from planner.motion.as_run import asked_trajectory
from planner.plan import Plan


@pytest.fixture(scope="module")
def plan() -> Plan:
    return small_plan()


def brute_place(plan: TrackedPath, point: Array) -> float:
    a, b = plan.points[:-1], plan.points[1:]
    step = b - a
    u = np.clip(((point - a) * step).sum(axis=1) / (step**2).sum(axis=1), 0.0, 1.0)
    k = int(np.argmin(np.linalg.norm(a + u[:, None] * step - point, axis=1)))
    return k + float(u[k])


@given(seed=st.integers(0, 1000), every=st.floats(0.2, 3.0))
@settings(max_examples=20)
def test_places_along_an_open_curve_are_the_nearest_ones(seed: int, every: float) -> None:
    random = np.random.default_rng(seed)
    x = np.linspace(0.0, 0.05, 101)
    tip = np.column_stack([x, 0.004 * np.sin(90.0 * x + seed), np.zeros(101)])
    axis = np.tile([0.0, 0.0, -1.0], (101, 1))
    at = np.append(np.arange(0.0, 100.0, every), 100.0)
    run = np.column_stack([np.interp(at, np.arange(101), column) for column in tip.T])
    run += random.normal(0.0, 2e-5, run.shape)
    way = nozzle_path(tip, axis)
    ran = nozzle_path(run, np.tile(axis[0], (len(run), 1)))
    place, off = track(way, ran.points, np.diff(ran.way, prepend=0.0))
    there = [brute_place(way, np.append(point, 0.05 * axis[0])) for point in run]
    assert place == pytest.approx(np.array(there), abs=0.35)
    assert off.max() < 2e-4


def test_a_run_keeps_its_order_on_lines_that_lie_beside_each_other() -> None:
    """A zig-zag whose lines are 1 mm apart, run 0.6 mm aside: nearer to the next line than to its own."""
    lines = [np.column_stack([np.linspace(0, 0.03, 61)[:: 1 - 2 * (k % 2)], np.full(61, 1e-3 * k)]) for k in range(6)]
    tip = np.column_stack([np.vstack(lines), np.zeros(366)])
    axis = np.tile([0.0, 0.0, -1.0], (366, 1))
    run = tip + [0.0, 0.6e-3, 0.0]
    ran = nozzle_path(run, axis)
    place, _ = track(nozzle_path(tip, axis), ran.points, np.diff(ran.way, prepend=0.0))
    middle = np.abs(np.arange(366) % 61 - 30) < 20
    assert np.abs(place - np.arange(366))[middle].max() < 3.0


def test_rests_in_a_run_stay_where_they_are(plan: Plan) -> None:
    q = first_run()[1]
    k = len(q) // 2
    q = np.vstack([np.tile(q[0], (300, 1)), q[:k], np.tile(q[k], (500, 1)), q[k:], np.tile(q[-1], (100, 1))])
    rested = errors_of(plan.trajectory, true_way(plan, 4e-3 * np.arange(len(q)), q))
    moved = errors_of(plan.trajectory, true_way(plan, *first_run()))
    assert rested.known.all() == moved.known.all()
    assert rested.off == pytest.approx(moved.off, abs=2e-6)


def test_what_is_off_across_the_path_is_found_and_what_is_along_it_is_not(plan: Plan) -> None:
    t = plan.trajectory
    aside = np.zeros((len(t), 3))
    aside[t.deposit] = [0.0, 0.0, 0.3e-3]  # along the cylinder's axis
    moved = replace(t, tip=t.tip + aside)
    q = asked_trajectory(plan.cell, t, corrections_by(t, lambda s: np.tile([0.0, 0.0, 0.3e-3], (len(s), 1)))).q
    errors = errors_of(t, true_way(plan, t.t, q))
    along = np.gradient(t.tip, axis=0)
    along /= np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-12)
    expected = moved.tip - t.tip
    expected -= (expected * along).sum(axis=1, keepdims=True) * along
    inside = t.deposit & np.roll(t.deposit, 12) & np.roll(t.deposit, -12)
    straight = inside & ((along * np.roll(along, 12, axis=0)).sum(axis=1) > 0.999)
    straight &= (along * np.roll(along, -12, axis=0)).sum(axis=1) > 0.999
    assert errors.off[straight] == pytest.approx(expected[straight], abs=5e-6)
    assert errors.known[t.deposit].all()


def test_how_far_a_run_is_off_is_its_distance_from_the_beads(plan: Plan) -> None:
    """By another way: each bead's planned tips against the executed polyline of its time, whatever place belongs to which."""
    t, (time, q) = plan.trajectory, first_run()
    way = true_way(plan, time, q)
    errors = errors_of(t, way)
    for bead in np.unique(t.bead[t.deposit]):
        rows = np.flatnonzero(t.deposit & (t.bead == bead))
        near = (way.place > rows[0] - 30) & (way.place < rows[-1] + 30)
        nearest = distance_to_polyline(t.tip[rows], way.tip[near])
        told = np.linalg.norm(errors.off[rows], axis=1)
        assert np.median(told) == pytest.approx(np.median(nearest), rel=0.1)
        assert (told > nearest - 2e-5).mean() > 0.95
        assert np.quantile(told, 0.99) < 2.0 * np.quantile(nearest, 0.99) + 2e-5


def test_noise_of_a_recording_is_told(plan: Plan, tmp_path: Path) -> None:
    noise = np.radians(0.01)
    way = recorded_way(plan, read_log(log_of(plan, tmp_path, noise), plan.cell), "rapid")
    errors = errors_of(plan.trajectory, way)
    _, q = first_run()
    clean = plan.cell.T_part_nozzle(np.ascontiguousarray(q))[:, :3, 3]
    true = float((way.tip - clean).std())
    assert errors.noise == pytest.approx(true, rel=0.15)
    # rests before and behind, whose samples are all the same, as of an interface that mixes instants
    q = q + np.random.default_rng(1).normal(0.0, noise, q.shape)
    q = np.vstack([np.tile(q[0], (len(q), 1)), q, np.tile(q[-1], (len(q), 1))])
    assert errors_of(plan.trajectory, true_way(plan, 4e-3 * np.arange(len(q)), q)).noise == pytest.approx(
        true, rel=0.15
    )


@pytest.mark.parametrize("unit", ["rad", "deg", ""])
def test_units_are_read_off_the_recording_where_names_do_not_tell_them(plan: Plan, tmp_path: Path, unit: str) -> None:
    time, q = first_run()
    names = ["t_s", *(f"J{j}{'_' + unit if unit else ''}" for j in range(1, 7)), f"E1{'_' + unit if unit else ''}"]
    values = q if unit == "rad" else np.degrees(q)
    np.savetxt(tmp_path / "a.csv", np.column_stack([time, values]), delimiter=",", header=",".join(names), comments="")
    way = recorded_way(plan, read_log(tmp_path / "a.csv", plan.cell), "rapid")
    assert way.off[: len(way.off) // 2].max() < 3e-3
    assert bool(way.remarks) == (unit == "")


def test_a_bag_of_ros_teaches_what_a_table_does(plan: Plan, tmp_path: Path) -> None:
    bags = pytest.importorskip("tests.test_bags")
    time, q = first_run()
    bag = bags.bag_of(tmp_path, "mcap", {"/joint_states": bags.messages(plan.cell.joint_names, time, q)})
    log = read_log(bag, plan.cell)
    assert errors_of(plan.trajectory, recorded_way(plan, log, "rapid")).off == pytest.approx(
        errors_of(plan.trajectory, true_way(plan, time, q)).off, abs=1e-6
    )


def test_a_gap_teaches_nothing_there(plan: Plan, tmp_path: Path) -> None:
    time, q = first_run()
    on = np.flatnonzero(np.linalg.norm(np.diff(q, axis=0), axis=1) > 1e-4)
    a = int(on[len(on) // 2])
    kept = np.ones(len(q), dtype=bool)
    kept[a : a + 12] = False
    path = write_log(plan, time[kept], q[kept], 0.0, 1, tmp_path / "gap.csv")
    errors = errors_of(plan.trajectory, recorded_way(plan, read_log(path, plan.cell), "rapid"))
    whole = errors_of(plan.trajectory, true_way(plan, time, q))
    assert errors.off[errors.known] == pytest.approx(whole.off[errors.known], abs=2e-5)
    assert len(recorded_way(plan, read_log(path, plan.cell), "rapid").gaps) == 1


def another_program(plan: Plan, time: Array, q: Array) -> tuple[Array, Array]:
    q = q.copy()
    q[len(q) // 3 :, 0] += np.radians(3.0) * np.linspace(0.0, 1.0, len(q) - len(q) // 3)
    return time, q


def thinned(plan: Plan, time: Array, q: Array) -> tuple[Array, Array]:
    """Dense where the robot rests and travels, and only the ends of each bead."""
    way = true_way(plan, time, q)
    at = np.minimum(np.rint(way.place).astype(int), len(plan.trajectory) - 1)
    laid = plan.trajectory.deposit[at]
    kept = ~laid
    return time[kept], q[kept]


BAD: dict[str, tuple[Callable[[Plan, Array, Array], tuple[Array, Array]], str]] = {
    "another program": (another_program, "off the plan at bead"),
    "another start": (lambda plan, time, q: (time, q + 0.2), "is never where the program begins"),
    "joints in another order": (
        lambda plan, time, q: (time, np.roll(q, 1, axis=1)),
        "is never where the program begins",
    ),
    "too few samples": (lambda plan, time, q: (time[::20], q[::20]), "too few samples: one every 80 ms"),
    "nothing but gaps": (lambda plan, time, q: thinned(plan, time, q), "gaps leave nothing of any bead"),
    "an end before the first bead's": (lambda plan, time, q: (time[:120], q[:120]), "ends before the first bead does"),
    "a clock that runs back": (
        lambda plan, time, q: (np.where(time > 1.0, time - 0.5, time), q),
        "the clock runs back",
    ),
}


@pytest.mark.slow(keep=2)
@pytest.mark.parametrize("name", BAD)
def test_a_recording_of_something_else_is_refused(
    plan: Plan, tmp_path: Path, name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    spoil, words = BAD[name]
    time, q = spoil(plan, *first_run())
    saved = plan.save(tmp_path / "small.plan")
    log = write_log(plan, time, q, 0.0, 1, tmp_path / "run.csv")
    assert main([str(saved), str(log), "--out", str(tmp_path / "out"), "--quiet"]) == EXIT_INPUT
    told = capsys.readouterr().err
    assert words in told and "run.csv" in told
    assert not (tmp_path / "out").exists()


def test_a_robot_that_was_moved_before_its_run_is_followed_from_where_it_leaves_for_good(
    plan: Plan, tmp_path: Path
) -> None:
    """From the program's start along some of its way and back, and only then the run."""
    time, q = first_run()
    on = int(np.argmax(np.linalg.norm(q - q[0], axis=1) > np.radians(8.0)))
    jogged = np.vstack([q[:on], q[on::-1], np.tile(q[0], (100, 1)), q])
    log = write_log(plan, 4e-3 * np.arange(len(jogged)), jogged, 0.0, 1, tmp_path / "run.csv")
    found = errors_of(plan.trajectory, recorded_way(plan, read_log(log, plan.cell), "rapid"))
    plain = errors_of(plan.trajectory, true_way(plan, time, q))
    assert (found.known == plain.known).all()
    assert found.off == pytest.approx(plain.off, abs=2e-5)


def test_a_recording_that_is_too_noisy_or_too_coarse_is_refused(
    plan: Plan, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    saved, (time, q) = plan.save(tmp_path / "small.plan"), first_run()
    coarse = np.radians(0.1) * np.round(q / np.radians(0.1))
    for path, words in (
        (log_of(plan, tmp_path, np.radians(0.07)), "too noisy: the recorded tip scatters by"),
        (write_log(plan, time, coarse, 0.0, 1, tmp_path / "coarse.csv"), "is recorded in steps of 0.1 degrees"),
    ):
        assert main([str(saved), str(path), "--out", str(tmp_path / "out"), "--quiet"]) == EXIT_INPUT
        told = capsys.readouterr().err
        assert words in told and path.name in told and not (tmp_path / "out").exists()


def test_a_wrong_sample_teaches_nothing(plan: Plan, tmp_path: Path) -> None:
    time, q = first_run()
    wrong = q.copy()
    wrong[len(q) // 2, 1] += np.radians(0.5)
    way = recorded_way(plan, read_log(write_log(plan, time, wrong, 0.0, 1, tmp_path / "run.csv"), plan.cell), "rapid")
    assert any("1 sample left out as no joint can move like that" in words for words in way.remarks)
    plain = errors_of(plan.trajectory, true_way(plan, time, q))
    assert errors_of(plan.trajectory, way).off == pytest.approx(plain.off, abs=2e-5)


def test_noise_counts_for_less_where_the_robot_is_slow(plan: Plan, tmp_path: Path) -> None:
    """Where it is as slow as a fifth, five samples tell what one does elsewhere."""
    time, q = first_run()
    slow = np.column_stack([np.interp(np.arange(0.0, len(q) - 1.0, 0.2), np.arange(len(q)), column) for column in q.T])
    true = errors_of(plan.trajectory, true_way(plan, time, q))
    noises = []
    for name, each in (("fast", q), ("slow", slow)):
        log = write_log(plan, 4e-3 * np.arange(len(each)), each, np.radians(0.01), 3, tmp_path / f"{name}.csv")
        errors = errors_of(plan.trajectory, recorded_way(plan, read_log(log, plan.cell), "rapid"))
        noises.append(float((errors.off - true.off)[true.known].std()))
    assert noises[1] < 0.65 * noises[0]
