"""Programs that learn from runs: corrections, how what is asked for is verified, and what comes of it run by run."""

from __future__ import annotations

import csv
import json
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from learn_fixtures import (
    KEPT,
    MOST,
    WRONG,
    corrected,
    corrections_by,
    failed,
    first_run,
    lessons_of,
    log_of,
    toy_errors,
    with_corrections,
)
from solved import small_plan, small_problem, write_small

from benchmarks.learn import ROBOTS, recorded, runs_of, true_way, write_log
from planner.base.arrays import Array
from planner.base.errors import EXIT_INPUT, EXIT_VERIFIED, InputError
from planner.base.progress import Stages
from planner.base.results import digest
from planner.cell.cell import build_cell
from planner.export.controllers import CONTROLLERS
from planner.export.forecast import forecast
from planner.export.languages import LANGUAGES, chosen
from planner.export.player.executed import followed
from planner.feedback.learn_command import (
    TRIES,
    Learned,
    _not_followed,
    foretold,
    language_of,
    learned_plan,
    main,
    ran_plan,
)
from planner.feedback.learn_fit import (
    Lessons,
    RunErrors,
    _smoothed,
    bends,
    errors_of,
    evened,
    evened_around,
    less_around,
    next_lessons,
)
from planner.feedback.learn_telling import next_lines, next_name, off_at, read_lessons, write_problem
from planner.feedback.learn_track import recorded_way
from planner.feedback.planned import PlannedWith, check_as_planned, planned_problem, planned_with
from planner.feedback.recordings import read_log
from planner.motion.as_run import FADE, Corrections, displacements, read_corrections
from planner.plan import Check, Nearer, Plan, Trajectory
from planner.plan.seal import changed_since, sealed
from planner.planning.clearance import keeping
from planner.planning.files import as_it_is
from planner.planning.pipeline import solve
from planner.problem import Problem, load_problem
from planner.problem.as_run import AsRunSpec
from planner.verify.as_run import as_run, learned_shifts

# what a trajectory has of each sample, besides its time
SAMPLED = ("bead", "layer", "deposit", "s", "q", "tip", "quat", "axis", "branch", "speed", "flow", "extruded", "feed")


@pytest.fixture(scope="module")
def plan() -> Plan:
    return small_plan()


# ----------------------------------------------------------------------------------------------------
# Corrections.


@given(
    seed=st.integers(0, 10_000), n=st.integers(3, 80), step=st.integers(1, 7), noise=st.sampled_from([0.0, 1e-5, 1e-4])
)
@settings(max_examples=40)
def test_smoothing_is_the_least_of_its_sum_of_squares(seed: int, n: int, step: int, noise: float) -> None:
    """The banded solution against a dense one."""
    random = np.random.default_rng(seed)
    off, known = random.normal(0.0, 1e-4, (n, 3)), random.random(n) < 0.8
    knots = np.unique(np.append(np.arange(0, n - n // 3, step), n - 1 - n // 4))  # a rest at the end has no place
    k = len(knots)
    B = np.column_stack([np.interp(np.arange(n), knots, row) for row in np.eye(k)])
    D = np.diff(np.eye(k), n=2, axis=0)
    stiff = (max(noise, 2e-6) / 1e-4) ** 2
    matrix = B[known].T @ B[known] + stiff * D.T @ D + (1e-9 + 1e-3 * stiff) * np.eye(k)
    dense = np.linalg.solve(matrix, B[known].T @ off[known])
    assert _smoothed(off, known, knots, noise) == pytest.approx(dense, abs=1e-9)


def test_a_rest_on_a_bead_has_one_correction(plan: Plan, tmp_path: Path) -> None:
    t = plan.trajectory
    k = int(np.flatnonzero(t.deposit)[150])
    rows = np.insert(np.arange(len(t)), k, np.full(80, k))
    rested = replace(t, t=t.dt * np.arange(len(rows)), **{name: getattr(t, name)[rows] for name in SAMPLED})
    off = np.tile([0.0, 1e-4, 0.0], (len(rested), 1))
    lessons = next_lessons(rested, toy_errors(rested, off), None, MOST)
    with_corrections(replace(plan, trajectory=rested), lessons.corrections, tmp_path)
    found = read_corrections(tmp_path / "corrections.csv", plan.toolpath, WRONG)
    assert found.shift == pytest.approx(np.tile([0.0, -1e-4, 0.0], (len(found.s), 1)), abs=1e-8)


def test_lessons_bring_a_robot_that_follows_to_its_plan_and_one_that_does_the_contrary_do_no_harm(plan: Plan) -> None:
    t = plan.trajectory
    off = 0.3e-3 * np.column_stack([np.sin(40.0 * t.s / t.s.max()), np.cos(9.0 * t.s / t.s.max()), np.ones(len(t))])
    left = {}
    for sign in (1.0, -1.0):
        lessons, size = None, []
        for _ in range(6):
            shift = np.zeros_like(off) if lessons is None else displacements(lessons.corrections, t)
            errors = toy_errors(t, off + sign * followed(shift, 0.02, t.dt))
            size.append(float(np.sqrt((errors.off[t.deposit] ** 2).sum(axis=1).mean())))
            lessons = next_lessons(t, errors, lessons, MOST)
        left[sign] = np.array(size) / size[0]
    assert left[1.0][5] < 0.15
    assert (np.diff(left[1.0]) < 0.01).all()
    # with each try it goes less far from what did no harm
    assert left[-1.0][1] > 1.5
    assert (np.diff(left[-1.0][1:]) < 0.0).all()
    assert left[-1.0][5] < 1.15


def test_beads_that_a_resumed_print_does_not_lay_keep_what_they_had(plan: Plan) -> None:
    t = plan.trajectory
    off = 0.2e-3 * np.column_stack([np.sin(300.0 * t.s), np.cos(200.0 * t.s), np.ones(len(t))])
    before = next_lessons(t, toy_errors(t, off), None, MOST)
    rows = np.arange(int(np.argmax(t.deposit & (t.bead == 1))) - 1, len(t))
    rest = replace(t, t=t.t[: len(rows)], **{name: getattr(t, name)[rows] for name in SAMPLED})
    errors = toy_errors(rest, 0.5 * off[rows])
    after = next_lessons(rest, errors, before, MOST)
    kept = after.corrections.bead == 0
    assert after.corrections.bead.tolist() == before.corrections.bead.tolist() and kept.any()
    for found, had in zip(columns_of(after), columns_of(before), strict=True):
        assert np.array_equal(found[kept], had[kept])
        assert found[~kept] == pytest.approx(had[~kept], abs=0.3e-3)
    assert not np.array_equal(after.corrections.shift[~kept], before.corrections.shift[~kept])
    assert np.array_equal(np.isnan(off_at(after.corrections, rest, errors)), kept)
    assert next_lessons(rest, errors, before, 0.1e-3).corrections.most == pytest.approx(0.1e-3, abs=3e-9)


def test_what_a_forecast_taught_stays_where_a_run_shows_nothing(plan: Plan) -> None:
    t = plan.trajectory
    off = np.tile([0.0, 0.0, 2e-4], (len(t), 1))
    found = next_lessons(t, toy_errors(t, off), None, MOST)
    none = np.zeros_like(found.best)
    before = Lessons(found.corrections, none, none, np.zeros_like(found.gain))
    errors = replace(toy_errors(t, 0.5 * off), known=t.deposit & (t.bead != 1))
    after = next_lessons(t, errors, before, MOST)
    hidden = after.corrections.bead == 1
    assert after.corrections.shift[hidden] == pytest.approx(found.corrections.shift[hidden], abs=1e-12)
    assert (after.gain[hidden] == 0.0).all() and (after.gain[~hidden] == 1.0).all()
    assert after.corrections.shift[~hidden] == pytest.approx(1.5 * found.corrections.shift[~hidden], abs=1e-7)


# what the best runs had left [mm] and with which gain, what they have left now, of which beads this one tells, and what is said
LEFT: dict[str, tuple[float, float, float, list[int], str]] = {
    "hardly": (0.3, 1.0, 0.29, [0, 1], "(0.290 mm rms, 0.300)"),
    "by a third": (0.3, 1.0, 0.2, [0, 1], ""),
    "behind a forecast": (0.0, 0.0, 0.29, [0, 1], ""),
    "of one bead": (0.3, 1.0, 0.2, [1], ""),
    "of none": (0.3, 1.0, 0.3, [], ""),
}


@pytest.mark.parametrize("name", LEFT)
def test_it_is_told_when_runs_have_little_left_to_teach(name: str) -> None:
    was, gain, now, shown, figures = LEFT[name]
    none, s = np.zeros((4, 3)), np.array([0.0, 1e-3, 0.0, 1e-3])
    corrections, beads = Corrections(np.array([0, 0, 1, 1]), s, none), np.array(shown, dtype=np.int64)
    before = Lessons(corrections, none, np.tile([0.0, was * 1e-3, 0.0], (4, 1)), np.full(4, gain))
    of_run = np.isin(corrections.bead, beads)  # others keep what they had
    left = np.where(of_run[:, None], [0.0, now * 1e-3, 0.0], before.left)
    after = Lessons(corrections, none, left, np.where(of_run, 1.0, before.gain))
    told = next_lines(after, before, beads, 0)
    assert len(told) == 1 + bool(figures) and figures in told[-1]
    assert ("little left to teach" in told[-1]) == bool(figures)
    assert len(next_lines(after, None, beads, 0)) == 1


def columns_of(lessons: Lessons) -> tuple[Array, ...]:
    return lessons.corrections.s, lessons.corrections.shift, lessons.best, lessons.left


def test_what_bends_most_is_evened_and_what_is_not_safe_is_made_smaller() -> None:
    shift = np.zeros((9, 3))
    shift[4, 0], shift[7, 1] = 1e-3, 1e-3
    bead = np.array([0] * 6 + [1] * 3)
    corrections = Corrections(bead, np.arange(9) * 1e-3, shift)
    assert bends(corrections)[[0, 3, 4, 5, 6, 7]] == pytest.approx([0.0, 0.5e-3, 1e-3, 0.0, 0.0, 1e-3])
    even = evened(corrections, np.full(9, 0.7e-3))
    assert even.shift[[4, 7]].max(axis=1) == pytest.approx([0.5e-3, 0.5e-3])
    assert even.shift[3] == pytest.approx(0.0)
    near = evened_around(corrections, 0, 4e-3, 1.5e-3)
    assert near.shift[3:6, 0] == pytest.approx([0.25e-3, 0.5e-3, 0.0])  # the bead's end stays
    assert near.shift[7] == pytest.approx(shift[7])
    less = less_around(corrections, 0, 4e-3, 2e-3)
    assert less.shift[[4, 7]].max(axis=1) == pytest.approx([0.5e-3, 1e-3])


def test_displacements_are_straight_between_places_and_fade_beyond_beads(plan: Plan) -> None:
    t = plan.trajectory
    corrections = corrections_by(t, lambda s: np.column_stack([0.2e-3 * np.sin(300.0 * s), 0.0 * s, 0.1e-3 + 0.0 * s]))
    shift = displacements(corrections, t)
    at = t.deposit & (t.bead == 1)
    own = corrections.bead == 1
    for axis in range(3):
        expected = np.interp(t.s[at], corrections.s[own], corrections.shift[own, axis])
        assert shift[at, axis] == pytest.approx(expected, abs=1e-12)
    assert shift[0] == pytest.approx(0.0) and shift[-1] == pytest.approx(0.0)
    way = np.linalg.norm(np.diff(t.tip, axis=0), axis=1)
    # nowhere does it change by more than the fade's steepest slope
    assert (np.linalg.norm(np.diff(shift, axis=0), axis=1) <= 0.5 * way + 1e-7).all()
    before = np.cumsum(way[::-1])[::-1]
    first = int(np.argmax(t.deposit))
    far = np.flatnonzero(before[:first] - before[first] > FADE)
    assert np.abs(shift[far]).max() == 0.0


def test_the_asked_joints_hold_the_displaced_tip_and_the_same_axis(plan: Plan) -> None:
    t, asked = plan.trajectory, corrected().asked
    assert asked is not None
    T = plan.cell.T_part_nozzle(np.ascontiguousarray(asked.q))
    assert T[:, :3, 3] == pytest.approx(asked.tip, abs=1e-9)
    assert T[:, :3, 2] == pytest.approx(t.axis, abs=1e-9)
    assert np.linalg.norm(asked.tip - t.tip, axis=1).max() > 0.2e-3
    assert (asked.q[:, 6:] == t.q[:, 6:]).all()


@pytest.mark.parametrize("name", ["rail_panel", "peer_cap"])
def test_arms_on_rails_and_others_are_displaced_likewise(name: str) -> None:
    cell = build_cell(load_problem(name))
    random = np.random.default_rng(3)
    q = cell.home + random.uniform(-0.05, 0.05, (40, len(cell.home)))
    T = cell.T_part_nozzle(q)
    branch = np.array([int(b) for b in cell.inverse.branches(q[:, : len(cell.arm)])])
    T[:, :3, 3] += random.uniform(-5e-4, 5e-4, (40, 3))
    found, exist = cell.postures(T, q, branch)
    assert exist.all()
    assert cell.T_part_nozzle(np.ascontiguousarray(found)) == pytest.approx(T, abs=1e-8)
    assert np.abs(found - q).max() < 0.05
    assert (found[:, list(cell.chosen)] == q[:, list(cell.chosen)]).all()


ROWS = "bead,s_mm,dx_mm,dy_mm,dz_mm\n0,0.0,0.1,0,0\n0,1.0,0.1,0,0\n1,0.5,0,0.1,0\n"
SPOILT: dict[str, tuple[Callable[[str], str], str]] = {
    "no column": (lambda text: text.replace("dz_mm", "z"), "no column dz_mm"),
    "empty": (lambda text: "", "no column bead"),
    "no number": (lambda text: text.replace("1.0,0.1", "x,0.1"), "line 3: not 5 numbers"),
    "a short row": (lambda text: text.replace("0,1.0,0.1,0,0", "0,1.0"), "line 3: not 5 numbers"),
    "not finite": (lambda text: text.replace("1.0,0.1", "1.0,nan"), "line 3: a number is not finite"),
    "no such bead": (lambda text: text.replace("\n1,", "\n7,"), "line 4: no such bead: there are 3"),
    "half a bead": (lambda text: text.replace("\n1,", "\n1.5,"), "line 4: no such bead: there are 3"),
    "beyond the bead": (lambda text: text.replace("\n1,0.5", "\n1,5000"), "line 4: beyond the end of its bead"),
    "backwards": (lambda text: text.replace("0,1.0", "0,-0.0"), "line 3: not after the previous place"),
    "out of order": (lambda text: text + "0,3.0,0,0,0\n", "line 5: not after the previous place"),
}


@pytest.mark.parametrize("name", SPOILT)
def test_a_file_that_holds_no_corrections_is_refused_by_line(plan: Plan, tmp_path: Path, name: str) -> None:
    spoil, words = SPOILT[name]
    path = tmp_path / "corrections.csv"
    path.write_text(spoil(ROWS), encoding="utf-8")
    with pytest.raises(InputError, match=words):
        read_corrections(path, plan.toolpath, WRONG)
    path.write_text(ROWS, encoding="utf-8")
    assert len(read_corrections(path, plan.toolpath, WRONG).s) == 3


def test_corrections_of_beads_that_have_changed_their_places_are_refused(plan: Plan, tmp_path: Path) -> None:
    own = Corrections(np.array([0, 0, 1]), np.array([0.0, 2e-3, 1e-3]), np.full((3, 3), 1e-4))
    with_corrections(plan, own, tmp_path)
    path, (first, second, *others) = tmp_path / "corrections.csv", plan.toolpath.beads
    assert len(read_corrections(path, plan.toolpath, WRONG).s) == 3
    with pytest.raises(InputError, match=r"line 2: off its bead"):
        read_corrections(path, replace(plan.toolpath, beads=(second, first, *others)), WRONG)


@pytest.mark.filterwarnings("error")
def test_a_file_of_no_rows_displaces_nothing(plan: Plan, tmp_path: Path) -> None:
    path = tmp_path / "corrections.csv"
    path.write_text(ROWS.splitlines()[0] + "\n", encoding="utf-8")
    assert not learned_shifts(path, plan.trajectory).any()
    assert len(read_corrections(path, plan.toolpath, WRONG).s) == 0


def test_the_verifier_reads_corrections_with_a_mark_and_comments(plan: Plan, tmp_path: Path) -> None:
    path = tmp_path / "corrections.csv"
    path.write_text(ROWS, encoding="utf-8")
    plain = learned_shifts(path, plan.trajectory)
    path.write_text(f"# by hand\n{ROWS}# the end\n", encoding="utf-8-sig")
    assert plain.any() and np.array_equal(learned_shifts(path, plan.trajectory), plain)
    assert len(read_corrections(path, plan.toolpath, WRONG).s) == 3


SPOILERS = st.lists(
    st.tuples(
        st.floats(0.0, 1.0), st.sampled_from([b",", b"nan", b"1e308", b"-", b"\n", b"x", b'"', b"\x00", b";", b""])
    ),
    min_size=1,
    max_size=4,
)


@given(spoilers=SPOILERS, cut=st.floats(0.3, 1.0))
@settings(max_examples=60)
def test_spoilt_files_are_refused_or_read_and_never_anything_else(
    spoilers: list[tuple[float, bytes]], cut: float
) -> None:
    plan, folder = corrected(), Path(KEPT.name)
    for name in ("corrections.csv", "run.csv"):
        if not (folder / name).exists():
            write_log(plan, *first_run(), 0.0, 1, folder / "run.csv")
        text = bytearray((folder / name).read_bytes())
        del text[int(cut * len(text)) :]
        for where, what in spoilers:
            at = int(where * (len(text) - 1))
            text[at : at + len(what)] = what
        path = folder / f"spoilt_{name}"
        path.write_bytes(text)
        with suppress(InputError):
            if name == "run.csv":
                errors_of(plan.trajectory, recorded_way(plan, read_log(path, plan.cell), "rapid"))
            else:
                found = read_corrections(path, plan.toolpath, WRONG)
                assert np.isfinite(displacements(found, plan.trajectory)).all()


def learned_problem(folder: Path, rows: str, most: float) -> Problem:
    """The small problem with corrections of some rows."""
    (folder / "corrections.csv").write_text(rows, encoding="utf-8")
    target = folder / "small_run_2.yaml"
    target.write_text(write_problem(small_problem(), "small_run_2", most, folder), encoding="utf-8")
    return load_problem(target)


@pytest.mark.parametrize(
    ("rows", "most", "words"),
    [
        (ROWS, 0.05e-3, "as_run.most_mm: corrections.csv displaces by 0.1 mm, more than the 0.05 allowed"),
        (
            ROWS.replace("dz_mm", "up"),
            1e-3,
            "as_run.corrections: corrections.csv holds no corrections: no column dz_mm",
        ),
    ],
)
def test_corrections_that_cannot_be_are_refused_before_anything_is_planned(
    tmp_path: Path, rows: str, most: float, words: str
) -> None:
    with pytest.raises(InputError) as refused:
        solve(learned_problem(tmp_path, rows, most))
    assert words in str(refused.value) and "small_run_2.yaml:" in str(refused.value)


def test_a_message_of_samples_is_not_written_for_corrections(tmp_path: Path) -> None:
    problem = learned_problem(tmp_path, ROWS, 1e-3)
    with pytest.raises(InputError, match="joint_trajectory cannot say this: as_run displaces targets"):
        solve(problem.changed(["program.languages=[joint_trajectory]"]))


# ----------------------------------------------------------------------------------------------------
# What is asked for, verified.


def test_what_is_asked_is_verified(plan: Plan) -> None:
    own = corrected()
    names = {check.name for check in own.checks} - {check.name for check in plan.checks}
    assert own.verified
    assert {
        "asked as learned",
        "asked off the plan",
        "asked joint range",
        "asked joint velocity",
        "asked nozzle clear of part and print",
        "asked arm clear of part and print",
        "asked robots clear of each other and of fixtures",
    } == names
    assert own.metrics["asked_off_max_mm"] == pytest.approx(
        float(np.linalg.norm(own.asked.tip - plan.trajectory.tip, axis=1).max()) * 1e3 if own.asked else np.nan
    )


def moved_aside(t: Trajectory, own: Plan) -> Trajectory:
    k = np.flatnonzero(t.deposit)[len(t) // 10]
    q = t.q.copy()
    q[k, 0] += 3e-4
    return replace(t, q=q)


def leant(t: Trajectory, own: Plan) -> Trajectory:
    q = t.q.copy()
    q[:, 5] += 0.3  # about the flange, beside which the nozzle stands
    return replace(t, q=q)


def beyond_range(t: Trajectory, own: Plan) -> Trajectory:
    q = t.q.copy()
    q[5:9, 1] = own.cell.limits.q_max[1] + 0.01
    return replace(t, q=q)


CORRUPTED: dict[str, tuple[Callable[[Trajectory, Plan], Trajectory], set[str]]] = {
    "a place aside": (moved_aside, {"asked as learned"}),
    "another axis": (leant, {"asked as learned", "asked off the plan"}),
    "other times": (lambda t, own: replace(t, t=t.t + 0.001), {"asked as learned"}),
    "other flow": (lambda t, own: replace(t, flow=1.1 * t.flow), {"asked as learned"}),
    "another tip in the program": (lambda t, own: replace(t, tip=t.tip + 1e-3 * t.axis), {"asked as learned"}),
    "another orientation in the program": (
        lambda t, own: replace(t, quat=t.quat[:, ::-1].copy()),
        {"asked as learned"},
    ),
    "beyond a joint's range": (beyond_range, {"asked joint range", "asked joint velocity"}),
    "the plan itself": (lambda t, own: own.trajectory, {"asked as learned"}),
}


@pytest.mark.slow(keep=2)
@pytest.mark.parametrize("name", CORRUPTED)
def test_an_asked_motion_that_is_not_as_learned_fails(name: str) -> None:
    spoil, names = CORRUPTED[name]
    own = corrected()
    assert own.asked is not None
    assert names <= failed(own, spoil(own.asked, own))


def test_no_asked_motion_where_one_was_learned_fails_and_one_where_none_was_too(plan: Plan) -> None:
    own = corrected()
    assert failed(own, None) == {"asked as learned"}
    assert failed(plan, own.asked) == {"asked as learned"}
    assert failed(plan, None) == set()


def test_corrections_into_the_part_fail_and_those_beyond_the_bound(plan: Plan, tmp_path: Path) -> None:
    """Ten millimetres along the nozzle's axis: the head comes where the part is."""
    t = plan.trajectory
    into = corrections_by(t, lambda s: np.zeros((len(s), 3)))
    axis = np.vstack([t.axis[t.deposit & (t.bead == bead)][::6] for bead in np.unique(t.bead[t.deposit])])
    into = Corrections(into.bead, into.s, 0.03 * axis)
    own = with_corrections(plan, into, tmp_path, most=0.05)
    assert "asked nozzle clear of part and print" in {check.name for check in own.checks if not check.ok}
    tight = own.problem.model_copy(
        update={"as_run": AsRunSpec.model_construct(corrections=tmp_path / "corrections.csv", most=1e-3)}
    )
    found = as_run(tight, own.cell, own.toolpath, own.trajectory, own.asked)
    assert "asked off the plan" in {check.name for check in found.checks if not check.ok}


def test_a_file_that_was_changed_since_is_seen(tmp_path: Path, plan: Plan) -> None:
    own = with_corrections(plan, lessons_of(plan, tmp_path)[1].corrections, tmp_path)
    path = tmp_path / "corrections.csv"
    rows = list(csv.reader(path.read_text(encoding="utf-8").splitlines()))
    rows[len(rows) // 2][2] = "0.5"
    path.write_text("\n".join(",".join(row) for row in rows), encoding="utf-8")
    assert failed(own, own.asked) == {"asked as learned"}


def test_programs_ask_for_the_asked_motion_and_differ_from_one_that_asks_for_the_plan(plan: Plan) -> None:
    own, rapid = corrected(), LANGUAGES["rapid"]
    files = rapid.write(own)
    assert rapid.differences(own, files) == []
    assert any("path differs" in words for words in rapid.differences(plan, files))


@pytest.mark.slow
def test_plan_and_asked_motion_come_back_from_a_file_and_a_changed_one_is_seen(tmp_path: Path) -> None:
    own = corrected()
    back = Plan.load(sealed(own).save(tmp_path / "learned.plan"))
    assert back.asked is not None and own.asked is not None
    assert (back.asked.q == own.asked.q).all()
    assert changed_since(back) == ()
    spoilt = replace(back, asked=moved_aside(back.asked, back))
    assert changed_since(spoilt) == ("asked",)
    assert {check.name for check in as_it_is(spoilt).checks if not check.ok} == {"asked as learned"}


# ----------------------------------------------------------------------------------------------------
# Run by run.


@pytest.mark.slow
@pytest.mark.parametrize("robot", ROBOTS)
def test_runs_bring_simulated_robots_to_their_plan(plan: Plan, robot: str) -> None:
    """To a quarter of what they were off, root mean square, within three runs that teach."""
    rows = [run.figures(plan) for run in runs_of(plan, ROBOTS[robot], 3, np.radians(0.001))]
    rms, nearly, most = (np.array(column) for column in list(zip(*rows, strict=True))[:3])
    assert rms[0] > 0.1
    assert rms[3] < 0.25 * rms[0]
    assert nearly[3] < 0.5 * nearly[0]
    assert most[3] < most[0]


@pytest.mark.slow
def test_the_command_writes_a_program_that_is_nearer_and_goes_on_from_its_own_folder(
    plan: Plan, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    saved = plan.save(tmp_path / "small.plan")
    out = tmp_path / "second"
    assert main([str(saved), str(log_of(plan, tmp_path)), "--out", str(out), "--quiet"]) == EXIT_VERIFIED
    told = capsys.readouterr().out
    assert "run 1: 100.0% of the samples on beads recorded" in told and "most off:" in told
    assert {"corrections.csv", "learned.png", "small_run_2.yaml", "SmallRun2.mod", "plan.json", "manifest.json"} <= {
        path.name for path in out.iterdir()
    }
    held = json.loads((out / "plan.json").read_text(encoding="utf-8"))
    assert held["verified"] and held["problem_file"] == (out / "small_run_2.yaml").as_posix()
    foretold = json.loads((out / "forecast.json").read_text(encoding="utf-8"))["forecasts"]["rapid"]
    assert "off the plan, as learned" in foretold["words"][0]
    assert foretold["off_mm"] < 0.7 * 1e3 * errors_of(plan.trajectory, true_way(plan, *first_run())).size.max()
    # what its problem file gives is the same program
    second = ran_plan(str(out), (), None, Stages())
    assert (
        LANGUAGES["rapid"].write(second)["SmallRun2.mod"].splitlines()[-40:]
        == ((out / "SmallRun2.mod").read_text(encoding="utf-8").splitlines()[-40:])
    )
    # and the third run goes on from there
    time, q = recorded(second, ROBOTS["as fitted"])
    log = write_log(second, time, q, 0.0, 2, tmp_path / "run2.csv")
    third = tmp_path / "third"
    assert main([str(out), str(log), "--out", str(third), "--quiet"]) == EXIT_VERIFIED
    told = capsys.readouterr().out
    assert "run 2: 100.0%" in told
    assert next_name(load_problem(out / "small_run_2.yaml")) == "small_run_3"
    assert (third / "small_run_3.yaml").is_file()
    rows = list(csv.DictReader((third / "corrections.csv").read_text(encoding="utf-8").splitlines()))
    assert {float(row["gain"]) for row in rows} <= {0.5, 1.0}


@pytest.mark.slow
def test_the_model_of_a_controller_teaches_the_program_of_the_first_run(
    plan: Plan, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    saved, out = plan.save(tmp_path / "small.plan"), tmp_path / "first"
    assert main([str(saved), "--forecast", "--out", str(out), "--quiet"]) == EXIT_VERIFIED
    told = capsys.readouterr().out
    assert "by the model of ABB IRC5 / OmniCore, without a recording" in told
    first, *_, last = (float(line.split("plan by ")[1].split()[0]) for line in told.splitlines() if "plan by" in line)
    assert last < 0.3 * first
    own = json.loads((out / "forecast.json").read_text(encoding="utf-8"))["forecasts"]["rapid"]
    usual = recorded_forecast(plan)
    assert own["closer_than_warned"] <= usual["closer_than_warned"]
    assert (out / "small_run_1.yaml").is_file()
    assert main([str(out), "--forecast", "--out", str(tmp_path / "again"), "--quiet"]) == EXIT_INPUT
    assert "--forecast: small_run_1 is corrected by as_run already" in capsys.readouterr().err
    # of real runs none has taught anything yet
    problem = load_problem(out / "small_run_1.yaml")
    corrections = read_corrections(out / "corrections.csv", plan.toolpath, WRONG)
    assert (read_lessons(problem, corrections).gain == 0.0).all()
    assert next_name(problem) == "small_run_2"


@pytest.mark.parametrize("unsafe", [1, 2, 3])
def test_what_a_foretold_run_would_teach_is_left_out_where_that_is_not_safe(
    unsafe: int, plan: Plan, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """unsafe: which of the foretold runs teaches what breaks a check"""
    errors = toy_errors(plan.trajectory, np.tile([0.0, 0.0, 2e-4], (len(plan.trajectory), 1)))
    broken = Check("asked clear", 1.9, 2.0, "mm", False, "somewhere", least=True)
    made: list[Learned] = []

    def tried(own: Plan, lessons: Lessons, *_: object) -> Learned:
        made.append(Learned(own, lessons, 0, (broken,) if len(made) + 1 == unsafe else ()))
        return made[-1]

    rapid = SimpleNamespace(write=lambda _: {}, program=lambda *_: None, plan=lambda _: SimpleNamespace(cell=plan.cell))
    for name, instead in {
        "LANGUAGES": {"rapid": rapid},
        "play": lambda *_: None,
        "executed_run": lambda *_: SimpleNamespace(t=None, q=None),
        "way_along": lambda *_: None,
        "errors_of": lambda *_: errors,
        "learned_plan": tried,
    }.items():
        monkeypatch.setattr(f"planner.feedback.learn_command.{name}", instead)
    learned, first = foretold(plan, MOST, Stages())
    assert len(made) == unsafe and first is errors
    assert learned.failed == ((broken,) if unsafe == 1 else ())
    assert learned.lessons.corrections is made[max(unsafe - 2, 0)].lessons.corrections
    assert ("would teach next is not safe, and is left out: asked clear" in capsys.readouterr().out) == (unsafe > 1)


def recorded_forecast(plan: Plan) -> dict[str, Any]:
    rapid = LANGUAGES["rapid"]
    program = rapid.program(plan, rapid.write(plan))
    return dict(forecast(program, rapid.plan(plan).cell, CONTROLLERS["rapid"]).figures)


def test_a_recording_or_the_forecast_is_asked_for(capsys: pytest.CaptureFixture[str]) -> None:
    for arguments in (["peer_cap"], ["peer_cap", "run.csv", "--forecast"]):
        with pytest.raises(SystemExit) as ended:
            main(arguments)
        assert ended.value.code == EXIT_INPUT
    assert "--forecast" in capsys.readouterr().err


@pytest.mark.slow
def test_a_program_that_cannot_be_safe_is_not_written(plan: Plan, tmp_path: Path) -> None:
    """A clearance that no asked motion keeps: what fails is told, with no program."""
    errors, lessons = lessons_of(plan, tmp_path)
    narrow = plan.problem.collision.model_copy(update={"nozzle": 0.049, "arm": 0.049})
    spoilt = replace(plan, problem=plan.problem.model_copy(update={"collision": narrow}))
    learned = learned_plan(spoilt, lessons, errors, MOST, language_of(plan), Stages())
    assert "asked robots clear of each other and of fixtures" in {check.name for check in learned.failed}


def test_smoothing_leaves_tries_for_smaller_corrections(plan: Plan, monkeypatch: pytest.MonkeyPatch) -> None:
    """Lines that stay hasty whatever is smoothed, and corrections that are safe when they are a quarter as large."""
    t = plan.trajectory
    errors = toy_errors(t, np.tile([0.0, 0.0, 2e-4], (len(t), 1)))
    lessons, safe = next_lessons(t, errors, None, MOST), iter((False, False, True))

    def verified(asked: Plan, _: Stages) -> Plan:
        sample = int(np.argmax(t.deposit))
        return replace(asked, checks=(Check("asked clear", 1.9, 2.0, "mm", next(safe), "", least=True, sample=sample),))

    for name, instead in {
        "_hasty": lambda asked, _: [] if asked.asked is None else [5],
        "_differences": lambda *_: [],
        "asked_of": lambda *_: t,
        "with_asked": verified,
    }.items():
        monkeypatch.setattr(f"planner.feedback.learn_command.{name}", instead)
    learned = learned_plan(plan, lessons, errors, MOST, "rapid", Stages())
    assert learned.smoothed == TRIES - 1 and not learned.failed and next(safe, None) is None
    shift, before = (np.linalg.norm(each.corrections.shift, axis=1) for each in (learned.lessons, lessons))
    assert shift[0] == pytest.approx(0.25 * before[0], rel=1e-3) and shift[-1] == pytest.approx(before[-1])


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--most-mm", "0"], "not a length in mm from 0.01 to 5"),
        (["--most-mm", "x"], "not a length in mm from 0.01 to 5"),
    ],
)
def test_options_out_of_range_are_told(arguments: list[str], words: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["peer_cap", "run.csv", *arguments])
    assert ended.value.code == EXIT_INPUT
    assert words in capsys.readouterr().err


def test_arms_without_a_controller_that_plans_lines_are_refused() -> None:
    problem = small_problem().changed(["program.languages=[joint_trajectory]"])
    setup = replace(small_plan(), problem=problem)
    assert "rapid" not in chosen(setup).names
    with pytest.raises(InputError, match="no program of lines is written"):
        language_of(setup)


# ----------------------------------------------------------------------------------------------------
# What was planned.


def test_a_folder_of_results_of_ones_own_problem_tells_its_file(tmp_path: Path) -> None:
    folder = tmp_path / "out"
    folder.mkdir()
    held = {
        "problem": "small",
        "problem_file": small_problem().file.as_posix(),
        "settings": {"overrides": ["layers.count=1"]},
    }
    (folder / "plan.json").write_text(json.dumps(held), encoding="utf-8")
    problem, plan = planned_problem(str(folder))
    assert (problem.name, problem.overrides, plan) == ("small", ("layers.count=1",), None)
    held["problem_file"] = "gone.yaml"
    (folder / "plan.json").write_text(json.dumps(held), encoding="utf-8")
    with pytest.raises(InputError, match=r"its problem file gone\.yaml does not exist"):
        planned_problem(str(folder))
    (folder / "plan.json").write_text(json.dumps(held | {"problem_file": None}), encoding="utf-8")
    with pytest.raises(InputError, match="waypoints in arrays"):
        planned_problem(str(folder))


def test_what_is_planned_again_is_planned_as_it_was(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    held = {
        "problem": "small",
        "problem_file": small_problem().file.as_posix(),
        "strategy": "greedy",
        "first_bead": 1,
        "settings": {"dt": 0.01, "overrides": []},
    }
    (tmp_path / "plan.json").write_text(json.dumps(held), encoding="utf-8")
    asked = []

    def solved(problem: Problem, strategy: str | None, dt: float, *_: object, first_bead: int, **__: object) -> Plan:
        asked.append((strategy, dt, first_bead))
        return small_plan()

    monkeypatch.setattr("planner.feedback.learn_command.solve", solved)
    for changes, strategy in (((), None), ((), "ladder"), (("strategy=sqp",), None)):
        ran_plan(str(tmp_path), changes, strategy, Stages())
    assert asked == [("greedy", 0.01, 1), ("ladder", 0.01, 1), (None, 0.01, 1)]
    resumed = replace(small_plan(), trajectory=replace(small_plan().trajectory, first_bead=2))
    assert planned_with("small.plan", resumed) == PlannedWith("ladder", 2, resumed.settings["dt"])


def test_results_whose_problem_was_changed_since_teach_nothing(tmp_path: Path) -> None:
    file = write_small(tmp_path / "problem")
    held = {
        "problem": "small",
        "problem_file": file.as_posix(),
        "problem_sha256": digest(file),
        "settings": {"overrides": []},
    }
    (tmp_path / "plan.json").write_text(json.dumps(held), encoding="utf-8")
    assert load_problem(file, ["layers.count=1"]).sources.sha256 == digest(file)
    check_as_planned(str(tmp_path), load_problem(file))
    file.write_text(file.read_text(encoding="utf-8").replace("speed_mm_s: 40", "speed_mm_s: 30"), encoding="utf-8")
    with pytest.raises(InputError, match="was changed since"):
        ran_plan(str(tmp_path), (), None, Stages())
    check_as_planned(str(file), load_problem(file))


@pytest.mark.parametrize(
    ("kept", "old", "new"),
    [
        (None, "  speed_mm_s: 40", "  speed_mm_s: 10"),
        (1e-3, "strategy: ladder", "collision: {nozzle_mm: 1.1}\nstrategy: ladder"),
    ],
)
def test_a_saved_plan_is_taken_unless_its_problem_was_changed_since(
    tmp_path: Path, kept: float | None, old: str, new: str
) -> None:
    """kept: the distance of nozzle and head [m] where no plan has the usual one"""
    file = write_small(tmp_path)
    own = replace(small_plan(), problem=load_problem(file))
    if kept is not None:
        nearer = Nearer(kept, own.problem.collision.nozzle, "there is no way with that")
        own = replace(own, problem=keeping(own.problem, kept), nearer=nearer)
    own = sealed(own)
    saved = str(own.save(tmp_path / "small.plan"))
    taken = ran_plan(saved, (), None, Stages())
    assert (taken.seal, taken.checks) == (own.seal, own.checks)
    file.write_text(file.read_text(encoding="utf-8").replace(old, new), encoding="utf-8")
    with pytest.raises(InputError, match="as it was planned: 1 part, changed since: problem"):
        ran_plan(saved, (), None, Stages())


def taught_nothing(
    folder: Path, monkeypatch: pytest.MonkeyPatch, meanwhile: Callable[[], object], *changes: str
) -> list[str]:
    """Arguments of the command, for a recording that teaches nothing; something happens while it is looked at. changes: what was
    set when it was planned."""
    own = replace(small_plan(), problem=load_problem(write_small(folder), changes))
    none, n = np.zeros((0, 3)), len(own.trajectory)
    lessons = Lessons(Corrections(np.zeros(0, dtype=np.int64), np.zeros(0), none), none, none, np.zeros(0))
    errors = RunErrors(np.zeros((n, 3)), np.zeros(n, dtype=bool), np.full(n, np.nan), 0.0)

    def recorded(*_: object) -> tuple[Learned, RunErrors]:
        meanwhile()
        return Learned(own, lessons, 0, ()), errors

    for name, instead in {
        "ran_plan": lambda *_: own,
        "_recorded": recorded,
        "write_lessons": lambda *given: given[-1].write_text(ROWS, encoding="utf-8"),
        "write_picture": lambda *_: None,
    }.items():
        monkeypatch.setattr(f"planner.feedback.learn_command.{name}", instead)
    return ["small", "run.csv", "--out", str(folder / "out"), "--quiet"]


def test_a_problem_that_is_changed_meanwhile_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def changed() -> None:
        write_small(tmp_path, ("  speed_mm_s: 40", "  speed_mm_s: 30"))

    assert main(taught_nothing(tmp_path, monkeypatch, changed)) == EXIT_INPUT
    assert "small.yaml: was changed in the meantime" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("error", "code", "words"),
    [(KeyboardInterrupt(), 130, "interrupted: no program was written"), (OSError(28, "full"), 2, "cannot write into")],
)
def test_what_is_there_of_a_program_that_could_not_be_written_is_told(
    error: BaseException,
    code: int,
    words: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    def ended(*_: object) -> None:
        raise error

    monkeypatch.setattr("planner.feedback.learn_command.write_files", ended)
    assert main(taught_nothing(tmp_path, monkeypatch, lambda: None)) == code
    told = capsys.readouterr().err
    assert words in told and "small_run_2.yaml and its corrections.csv are there, their program is not" in told
    assert (tmp_path / "out" / "small_run_2.yaml").is_file()


def test_a_name_that_was_set_is_not_that_of_the_next_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    written: list[Problem] = []

    def ended(own: Plan, *_: object) -> None:
        written.append(own.problem)
        raise KeyboardInterrupt

    monkeypatch.setattr("planner.feedback.learn_command.write_files", ended)
    given = taught_nothing(tmp_path, monkeypatch, lambda: None, "name=fast", "process.travel_speed_mm_s=150")
    assert main(given) == 130
    assert written[0].name == "fast_run_2" and next_name(written[0]) == "fast_run_3"
    assert written[0].overrides == ("process.travel_speed_mm_s=150",)


TAUGHT = {
    "no number": ("0.5", "nan", "a number is not finite, or far too large"),
    "endless": ("0.5", "9" * 200_000, "is not CSV: field larger"),
    "too large": ("0.5", "1e300", "a number is not finite, or far too large"),
    "a gain beyond all": ("0.5", "7", "line 3: no run can have taught this"),
    "no gain": (",gain", ",gian", "no column gain"),
}


@pytest.mark.parametrize("name", TAUGHT)
def test_what_earlier_runs_cannot_have_taught_is_refused_by_line(name: str, tmp_path: Path) -> None:
    old, new, words = TAUGHT[name]
    head = "bead,s_mm,dx_mm,dy_mm,dz_mm,off_mm,best_dx_mm,best_dy_mm,best_dz_mm,left_dx_mm,left_dy_mm,left_dz_mm,gain"
    rows = [f"0,{s},0.1,0,0,0.2,0.1,0,0,0.01,0,0,{gain}" for s, gain in ((0.0, 1.0), (1.0, 0.5))]
    problem = learned_problem(tmp_path, "# by hand\n" + "\n".join([head, *rows]) + "\n", 1e-3)
    corrections = read_corrections(tmp_path / "corrections.csv", small_plan().toolpath, WRONG)
    assert read_lessons(problem, corrections).gain.tolist() == [1.0, 0.5]
    text = (tmp_path / "corrections.csv").read_text(encoding="utf-8")
    (tmp_path / "corrections.csv").write_text(text.replace(old, new), encoding="utf-8")
    words = words.replace("line 3", "line 4")  # the comment stands above
    with pytest.raises(InputError, match=words):
        read_lessons(problem, corrections)


@pytest.mark.parametrize(("value", "words"), [("9" * 200_000, "is not CSV"), ("1e300", "not finite, or far too large")])
def test_a_file_of_corrections_with_a_number_beyond_all_is_refused(
    plan: Plan, tmp_path: Path, value: str, words: str
) -> None:
    (tmp_path / "corrections.csv").write_text(ROWS.replace("\n1,0.5", f"\n1,{value}"), encoding="utf-8")
    with pytest.raises(InputError, match=words):
        read_corrections(tmp_path / "corrections.csv", plan.toolpath, WRONG)


@pytest.mark.slow
def test_corrections_are_smoothed_on_the_beads_alone_that_lines_do_not_follow(plan: Plan, tmp_path: Path) -> None:
    errors, lessons = lessons_of(plan, tmp_path)
    own = lessons.corrections
    shift, wild = own.shift.copy(), own.bead == 1
    shift[wild, 2] = 0.3e-3 * (-1.0) ** np.arange(wild.sum())
    taught = replace(lessons, corrections=Corrections(own.bead, own.s, shift))
    learned = learned_plan(plan, taught, errors, MOST, language_of(plan), Stages())
    found = learned.lessons.corrections
    assert learned.smoothed > 0 and not learned.failed
    assert (found.shift[~wild] == shift[~wild]).all()
    assert np.abs(found.shift[wild] - shift[wild]).max() > 0.1e-3
    assert _not_followed(plan, taught.corrections, np.arange(3), language_of(plan)).tolist() == [1]
    # where none is to blame by itself all of them are
    assert _not_followed(plan, own, np.arange(3), language_of(plan)).tolist() == [0, 1, 2]
