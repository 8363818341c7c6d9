"""The verifier on material: every motor and section passes, and every way to spoil what flows or is fed is caught."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from dataclasses import fields, replace
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from solved import body_of, small_plan, solve_alone, write_small
from spoilt import paused, with_process

import planner.planning.pipeline
from planner.base.arrays import Array
from planner.export.extruder import gcode
from planner.motion.extrusion import feed, filament_area
from planner.plan import Event, Plan, Trajectory
from planner.problem import Problem, load_problem
from planner.problem.process import FibreSpec, FilamentMoveSpec, StartSpec
from planner.toolpath.bead import Toolpath
from planner.verify import material
from planner.verify.around_bead import around_beads
from planner.verify.checks import samples_of
from planner.verify.verdict import Report, verify
from tests.export_fixtures import with_board

MM = 1e-3
PACE = {"material keeps pace", "flow per millimetre"}
ASKED = "primes, retracts and cuts as asked"


@cache
def solved(*changes: str) -> Plan:
    """The small print, solved with changes to its problem."""
    with tempfile.TemporaryDirectory() as folder:
        return solve_alone(load_problem(write_small(Path(folder)), changes))


def report(plan: Plan, trajectory: Trajectory | None = None, toolpath: Toolpath | None = None) -> Report:
    body = body_of(plan.toolpath, plan.cell) if toolpath is None else None
    return verify(plan.problem, plan.cell, toolpath or plan.toolpath, trajectory or plan.trajectory, body=body)


def failed(plan: Plan, **changes: Any) -> set[str]:
    """Names of the checks that fail when fields of the trajectory are exchanged."""
    return {check.name for check in report(plan, replace(plan.trajectory, **changes)).checks if not check.ok}


def samples(plan: Plan, bead: int) -> NDArray[np.intp]:
    return np.flatnonzero(plan.trajectory.bead == bead)


def area(plan: Plan) -> float:
    return filament_area(plan.problem.process)


# --- what is right -----------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize(
    ("section", "mm2"),
    [("rectangle", 0.3), ("rounded", 0.1 * 0.5 + np.pi * 0.25**2), ("fibre", np.pi * 0.875**2)],
)
@pytest.mark.parametrize("motor", ["e_axis", "speed_demand"])
def test_every_section_and_motor_that_follows_is_verified(section: str, mm2: float, motor: str) -> None:
    plan = solved(f"process.bead.section={section}", f"process.extruder.motor={motor}")
    assert plan.verified
    assert plan.metrics["extruded_volume_mm3"] == pytest.approx(mm2 * plan.metrics["deposited_length_mm"], rel=1e-9)
    if section == "fibre":
        assert plan.metrics["extruded_mm"] == pytest.approx(plan.metrics["deposited_length_mm"], rel=1e-9)
    assert plan.metrics["flow_error_max"] < 0.001
    assert plan.metrics["speed_min_mm_s"] < 36.0, "there is a dip to follow"


@pytest.mark.slow
def test_flow_follows_the_real_speed() -> None:
    plan = solved()
    t = plan.trajectory
    inside = t.deposit & np.roll(t.deposit, 1) & np.roll(t.deposit, -1)
    np.testing.assert_allclose(t.flow[inside], 0.3 * MM**2 * t.speed[inside], rtol=1e-9)


def varied(toolpath: Toolpath) -> Toolpath:
    """Beads that grow and shrink in both measures along their length."""
    beads = []
    for bead in toolpath.beads:
        wave = np.sin(2.0 * np.pi * bead.s / (7.0 * MM))
        beads.append(replace(bead, width=bead.width * (1.0 + 0.3 * wave), height=bead.height * (1.0 - 0.2 * wave**2)))
    return replace(toolpath, beads=tuple(beads))


@pytest.fixture
def varying(monkeypatch: pytest.MonkeyPatch) -> Callable[..., Plan]:
    original = planner.planning.pipeline.build_toolpath
    monkeypatch.setattr(planner.planning.pipeline, "build_toolpath", lambda problem: varied(original(problem)))

    def solve_it(*changes: str) -> Plan:
        with tempfile.TemporaryDirectory() as folder:
            return solve_alone(load_problem(write_small(Path(folder)), changes))

    return solve_it


@pytest.mark.slow
@pytest.mark.parametrize("section", ["rectangle", "rounded"])
def test_measures_that_vary_along_a_bead(varying: Callable[..., Plan], section: str) -> None:
    plan = varying(f"process.bead.section={section}", "process.bead.width_mm=0.9")
    other = "beads as wide and high as asked"  # these are not
    assert {check.name for check in plan.checks if not check.ok} == {other}
    assert plan.metrics["flow_error_max"] < 0.002
    volume = 0.0
    for bead in plan.toolpath.beads:
        w, h = bead.width / MM, bead.height / MM
        mm2 = w * h if section == "rectangle" else (w - h) * h + np.pi * h**2 / 4.0
        volume += float(np.trapezoid(mm2, bead.s / MM))
    assert plan.metrics["extruded_volume_mm3"] == pytest.approx(volume, rel=1e-9)
    # the same motion, of beads that do not vary
    flat = replace(
        plan.toolpath, beads=tuple(replace(b, width=0.0 * b.s + b.width.mean()) for b in plan.toolpath.beads)
    )
    names = {check.name for check in report(plan, toolpath=flat).checks if not check.ok}
    assert {"flow per millimetre"} <= names <= {*PACE, "extrusion balance", other}


# --- flow --------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_flow_that_pulses_along_the_bead() -> None:
    """Three in a hundred, to and fro every two millimetres: right by bead, by sample and in sum."""
    plan = small_plan()
    t = plan.trajectory
    at = samples(plan, 2)
    wave = np.sin(2.0 * np.pi * t.s / (2.0 * MM)) * 0.03 * (t.bead == 2)
    wave[at[-1] - np.arange(40)] = 0.0
    flow = t.flow * (1.0 + wave)
    extruded = t.extruded + (np.cumsum(flow - t.flow) - 0.5 * (flow - t.flow)) * t.dt
    away = extruded[-1] - t.extruded[-1]
    assert abs(away) < 1e-3 * t.extruded[-1]
    assert failed(plan, flow=flow, extruded=extruded, feed=extruded / area(plan)) == {"flow per millimetre"}
    # each of the three records by itself
    assert "flow per millimetre" in failed(plan, flow=flow)
    assert "flow per millimetre" in failed(plan, extruded=extruded)
    assert "flow per millimetre" in failed(plan, feed=extruded / area(plan))


@pytest.mark.slow
def test_a_pulse_is_told_with_its_place_and_size() -> None:
    plan = small_plan()
    i = samples(plan, 1)[100]
    flow = plan.trajectory.flow.copy()
    flow[i] *= 1.2
    found = report(plan, replace(plan.trajectory, flow=flow))
    check = next(check for check in found.checks if check.name == "flow per millimetre")
    assert not check.ok
    # 0.16 mm a sample
    assert check.worst == pytest.approx(0.2 * 0.16, rel=0.1)
    bead, place = check.where.removesuffix(" mm").split(", ")
    assert bead == "bead 1"
    assert abs(float(place) - plan.trajectory.s[i] / MM) <= 1.1
    assert abs(check.sample - i) <= 7  # within that millimetre
    assert found.metrics["flow_error_max"] == check.worst


# --- filament ----------------------------------------------------------------------------------------------


def test_filament_that_is_fed_too_much_throughout() -> None:
    plan = small_plan()
    assert failed(plan, feed=1.006 * plan.trajectory.feed) == {"flow per millimetre", "filament fed"}


@pytest.mark.parametrize("away", [0.02, -0.02])
def test_filament_that_moves_in_travel(away: float) -> None:
    plan = small_plan()
    i = samples(plan, 1)[0] - 30
    moved = plan.trajectory.feed + away * MM * (np.arange(len(plan.trajectory)) >= i)
    assert failed(plan, feed=moved) == {"filament fed"}


@cache
def with_moves() -> Plan:
    """The small print with heating and a purge at the start, primes and retracts: in its problem, its events and its feed."""
    plan = small_plan()
    changes = {
        "start": StartSpec(heat_wait_s=0.1, purge_mm=5.0, purge_speed_mm_s=5.0 / 0.3),
        "prime": FilamentMoveSpec(length_mm=1.2, speed_mm_s=1.2 / 0.061),
        "retract": FilamentMoveSpec(length_mm=1.0, speed_mm_s=1.0 / 0.043),
    }
    at_home = paused(plan, 0, np.zeros((100, plan.trajectory.q.shape[1])))
    plan = replace(plan, problem=with_process(plan.problem, **changes), trajectory=at_home)
    t = plan.trajectory
    events = [Event("heat", -1, 0.0, 0.1, 0.0), Event("purge", -1, 0.1, 0.3, 5.0 * MM)]
    for bead in range(3):
        start, end = t.t[samples(plan, bead)[[0, -1]]] + [-0.5 * t.dt, 0.5 * t.dt]
        events += [Event("prime", bead, start - 0.061, 0.061, 1.2 * MM), Event("retract", bead, end, 0.043, -1.0 * MM)]
    return with_events(plan, tuple(events))


def with_events(plan: Plan, events: tuple[Event, ...]) -> Plan:
    t, lag = plan.trajectory, plan.problem.process.extruder.lag
    fed = feed(t.t, t.bead, t.extruded, t.flow, events, area(plan), lag)
    return replace(plan, trajectory=replace(t, feed=fed, events=events))


def test_primes_and_retracts_are_verified() -> None:
    plan = with_moves()
    found = report(plan)
    assert all(check.ok for check in found.checks)
    assert found.metrics["extruded_mm"] == pytest.approx(plan.metrics["extruded_mm"] + 5.0 + 3 * 0.2, rel=1e-9)


@pytest.mark.slow(keep=("1", "5"))
@pytest.mark.parametrize("which", range(1, 8))
def test_an_event_that_is_not_in_the_feed(which: int) -> None:
    plan = with_moves()
    events = plan.trajectory.events
    assert "filament fed" in failed(plan, events=events[:which] + events[which + 1 :])
    late = replace(events[which], start=events[which].start + 0.02)
    assert "filament fed" in failed(plan, events=(*events[:which], late, *events[which + 1 :]))
    more = replace(events[which], amount=1.01 * events[which].amount)
    assert failed(plan, events=(*events[:which], more, *events[which + 1 :])) == {"filament fed", ASKED}


def judged(plan: Plan) -> Any:
    """What the check of events looks at."""
    t = plan.trajectory
    return SimpleNamespace(**vars(plan), samples=samples_of(t, len(plan.toolpath.beads)))


def otherwise(plan: Plan) -> str:
    """Where something is not as asked, empty if all is; the filament is fed as the events say."""
    (check,) = around_beads(judged(with_events(plan, plan.trajectory.events))).checks
    assert check.name == ASKED and check.ok == (check.worst == 0.0)
    return "" if check.ok else check.where


def exchanged(which: int, **changes: Any) -> Callable[[Plan], Plan]:
    """The print with another event in place of one: without it, if nothing is said of it."""

    def change(plan: Plan) -> Plan:
        events = list(plan.trajectory.events)
        events[which : which + 1] = [replace(events[which], **changes)] if changes else []
        return replace(plan, trajectory=replace(plan.trajectory, events=tuple(events)))

    return change


def with_one_more(*fields: Any) -> Callable[[Plan], Plan]:
    def change(plan: Plan) -> Plan:
        t = plan.trajectory
        return replace(plan, trajectory=replace(t, events=(*t.events, Event(*fields))))

    return change


def without_rest(plan: Plan) -> Plan:
    """The robot begins to move while the nozzle heats up."""
    q = plan.trajectory.q.copy()
    q[10:20, 5] += 1e-6 * np.arange(10)
    return replace(plan, trajectory=replace(plan.trajectory, q=q))


@pytest.mark.parametrize(
    ("change", "where"),
    [
        (lambda plan: plan, ""),
        (exchanged(5), "retract of bead 1"),
        (exchanged(4), "prime of bead 1"),
        (exchanged(5, amount=-20.0 * MM), "retract of bead 1"),
        (exchanged(5, amount=np.nan), "retract of bead 1"),
        (exchanged(4, duration=0.05), "prime of bead 1"),
        (exchanged(4, bead=0), "prime of bead 0"),
        (exchanged(0), "heat at the start"),
        (exchanged(1, amount=2.0 * MM), "purge at the start"),
        (exchanged(1, start=0.05), "purge at the start"),
        (with_one_more("purge", 2, 9.0, 0.1, 5.0 * MM), "purge of bead 2"),
        (with_one_more("push", 2, 9.0, 0.1, 5.0 * MM), "push of bead 2"),
        (without_rest, "rest at the start"),
    ],
)
def test_what_the_extruder_does_around_beads_is_what_is_asked(change: Callable[[Plan], Plan], where: str) -> None:
    assert otherwise(change(with_moves())) == where


@pytest.mark.parametrize(("late", "where"), [(-0.02, "retract of bead 1"), (0.004, ""), (0.02, "retract of bead 1")])
def test_a_retract_begins_where_its_bead_ends(late: float, where: str) -> None:
    event = with_moves().trajectory.events[5]
    assert otherwise(exchanged(5, start=event.start + late)(with_moves())) == where


def test_what_a_problem_does_not_ask_for_is_found() -> None:
    plan = replace(with_moves(), problem=small_plan().problem)
    (check,) = around_beads(judged(plan)).checks
    assert (check.worst, check.ok) == (8.0, False)


@pytest.mark.slow
def test_an_event_of_no_number_never_passes() -> None:
    plan = with_moves()
    for spoilt in ({"start": np.nan}, {"duration": np.nan}, {"amount": np.nan}, {"amount": np.inf}):
        assert failed(plan, events=(replace(plan.trajectory.events[1], **spoilt),))
        lagging = solved("process.extruder.lag_s=0.05")
        assert failed(lagging, events=(replace(plan.trajectory.events[1], **spoilt),))


@cache
def with_cuts() -> Plan:
    """Fibre that is cut 8 mm before the end of each bead, without stopping for it, and fed forward before the next."""
    plan = solved("process.bead.section=fibre")
    fibre = FibreSpec(cut_length_mm=8.0, cut_wait_s=0.0)
    fed = FilamentMoveSpec(speed_mm_s=8.0 / 0.09)
    plan = replace(plan, problem=with_process(plan.problem, fibre=fibre, prime=fed))
    t = plan.trajectory
    events = []
    for bead, line in enumerate(plan.toolpath.beads):
        at = samples(plan, bead)
        cut = float(np.interp(line.length - 8.0 * MM, t.s[at], t.t[at]))
        events += [Event("prime", bead, t.t[at[0]] - 0.092, 0.09, 8.0 * MM), Event("cut", bead, cut, 0.0, 0.0)]
    return with_events(plan, tuple(events))


@pytest.mark.slow
def test_fibre_behind_a_cut_is_drawn_and_not_fed() -> None:
    plan = with_cuts()
    found = report(plan)
    assert [check for check in found.checks if not check.ok] == []
    assert found.metrics["extruded_mm"] == pytest.approx(plan.metrics["deposited_length_mm"], abs=1e-3)
    t = plan.trajectory
    behind = (t.bead == 1) & (t.s > plan.toolpath.beads[1].length - 7.5 * MM)
    assert np.ptp(t.feed[behind]) < 1e-12


@pytest.mark.parametrize(
    ("changes", "where"),
    [
        ({"start": 0.02}, "cut of bead 1"),
        ({"start": -0.02}, "cut of bead 1"),
        ({"start": 0.0}, ""),
        ({"duration": 0.5}, "cut of bead 1"),
    ],
)
def test_fibre_is_cut_where_it_has_to_be(changes: dict[str, float], where: str) -> None:
    plan = with_cuts()
    own = plan.trajectory.events[3]
    assert otherwise(exchanged(3, **{name: getattr(own, name) + by for name, by in changes.items()})(plan)) == where


def test_the_nozzle_rests_at_a_cut() -> None:
    """For as long as the problem asks; the motion passes there."""
    plan = with_cuts()
    fibre = plan.problem.process.fibre
    assert fibre is not None
    asked = with_process(plan.problem, fibre=fibre.model_copy(update={"cut_wait": 0.05}))
    events = tuple(replace(each, duration=0.05) if each.kind == "cut" else each for each in plan.trajectory.events)
    resting = replace(plan, problem=asked, trajectory=replace(plan.trajectory, events=events))
    assert otherwise(resting) == "rest at the cut of bead 0"


@pytest.mark.slow
def test_fibre_that_is_fed_on_behind_its_cut() -> None:
    plan = with_cuts()
    events = plan.trajectory.events
    fed_on = with_events(plan, tuple(event for event in events if event != events[3])).trajectory.feed
    assert failed(plan, feed=fed_on) == {"filament fed", "flow per millimetre", "fibre as long as its bead"}


def test_fibre_that_is_not_as_long_as_its_bead() -> None:
    plan = with_cuts()
    events = plan.trajectory.events
    for left_out in (2, 3):  # fed forward but not cut, cut but not fed forward
        other = with_events(plan, tuple(event for event in events if event != events[left_out]))
        found = report(other)
        wrong = [check for check in found.checks if not check.ok]
        event = events[left_out]
        expected = [("fibre as long as its bead", "bead 1"), (ASKED, f"{event.kind} of bead 1")]
        assert [(check.name, check.where) for check in wrong] == expected
        assert wrong[0].worst == pytest.approx(8.0 * MM / plan.toolpath.beads[1].length, rel=1e-6)


# --- lag ---------------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("lag", [0.02, 0.05, 0.1])
def test_flow_that_lags_is_right_outside_of_lag_zones(lag: float) -> None:
    plan = solved(f"process.extruder.lag_s={lag}")
    assert plan.verified
    t = plan.trajectory
    assert t.flow == pytest.approx(small_plan().trajectory.flow), "what is laid is the same"
    ahead = t.feed - small_plan().trajectory.feed
    straight = samples(plan, 1)[150:160]
    assert ahead[straight] == pytest.approx(lag * 0.3 * MM**2 * 0.04 / area(plan), rel=0.01)
    # each of three beads, at both ends
    assert plan.metrics["lag_zone_mm"] == pytest.approx(3 * 2 * 40.0 * (lag + 0.008), rel=0.1)


def test_a_lag_that_nobody_makes_up_for() -> None:
    plan = solved("process.extruder.lag_s=0.05")
    names = failed(plan, feed=small_plan().trajectory.feed)
    assert names == {"filament fed", "flow per millimetre"}


@pytest.mark.parametrize("factor", [0.8, 1.2])
def test_a_lag_that_is_made_up_for_by_too_little_or_too_much(factor: float) -> None:
    plan = solved("process.extruder.lag_s=0.05")
    bare = small_plan().trajectory.feed
    off = bare + factor * (plan.trajectory.feed - bare)
    assert failed(plan, feed=off) == {"filament fed", "flow per millimetre"}


def test_what_stands_in_a_lag_zone_is_not_weighed_and_what_stands_beyond_is() -> None:
    plan = solved("process.extruder.lag_s=0.05")
    t = plan.trajectory
    for first, expected in ((1, set()), (80, {"filament fed", "flow per millimetre"})):
        at = samples(plan, 1)[first : first + 5]
        spoilt = t.feed.copy()
        spoilt[at] += 0.003 * MM  # of filament, of which a millimetre of the bead takes 0.125 mm
        assert failed(plan, feed=spoilt) == expected


def test_a_short_thin_bead_that_gets_nothing_is_found_beside_a_thick_one() -> None:
    """All of it is within the lag of its ends; the thick one, 0.6 s before, holds seventy times as much in that time."""
    n, lag, dt = 440, 0.2, 0.004
    bead, flow = np.full(n, -1, dtype=np.int32), np.zeros(n)
    for i, (first, last, rate) in enumerate(((10, 150, 360e-9), (300, 400, 3e-9))):
        bead[first:last], flow[first:last] = i, rate
    laid = (np.cumsum(flow) - 0.5 * flow) * dt
    t: Any = SimpleNamespace(t=dt * np.arange(n), dt=dt, bead=bead, s=np.zeros(n), flow=flow, extruded=laid)
    near, sample = material._near_ends(t, lag), 360e-9 * dt
    assert near[300:400].all()
    thick = bead == 0
    both = feed(t.t, bead, laid, flow, (), 1.0, lag)
    one = feed(t.t, np.where(thick, bead, -1), np.minimum(laid, laid[200]), np.where(thick, flow, 0.0), (), 1.0, lag)
    assert material._fed(t, both, lag, near, sample).ok
    assert not material._fed(t, one, lag, near, sample).ok


# --- a motor that is only on or off ------------------------------------------------------------------------


def on_off() -> Plan:
    """Corners make it slow, so that only a wide tolerance of flow lets it pass."""
    return solved("process.extruder={motor: on_off, flow_tolerance: 10}")


@pytest.mark.slow
def test_flow_of_a_switched_motor_is_judged_by_the_millimetre() -> None:
    """The same print with the usual tolerance is not verified, and the place is told; a wider one is the user's."""
    plan, usual = on_off(), load_problem_with("process.extruder.motor=on_off")
    found = {check.name: check for check in report(replace(plan, problem=usual)).checks}
    flow = found["flow per millimetre"]
    assert (flow.ok, flow.limit) == (False, 0.1)
    assert flow.worst == plan.metrics["flow_error_max"] > 0.1
    assert flow.where.startswith("bead ") and flow.where.endswith(" mm")
    assert {name for name, check in found.items() if not check.ok} == {"flow per millimetre"}
    assert plan.metrics["even_flow_fraction"] == 1.0, "of a tolerance of ten times what a millimetre holds"


def load_problem_with(*changes: str) -> Problem:
    with tempfile.TemporaryDirectory() as folder:
        return load_problem(write_small(Path(folder)), changes)


@pytest.mark.parametrize(("width", "ends"), [(4e-3, 2e-3), (0.5e-3, 2e-3), (0.1e-3, 0.4e-3)])
def test_less_is_left_unjudged_of_narrow_beads_of_a_switched_motor(width: float, ends: float) -> None:
    assert material.switched_ends(width) == pytest.approx(ends)


@pytest.mark.slow
def test_a_dip_of_a_switched_motor_is_caught() -> None:
    """A print at speed everywhere passes; the same motion with a rest in the middle of a bead does not."""
    straight = solved("process.extruder.motor=on_off", "process.speed_mm_s=4")
    assert straight.verified, [check.name for check in straight.checks if not check.ok]
    assert straight.metrics["flow_error_max"] < 0.1
    assert straight.metrics["even_flow_fraction"] > 0.98
    t, at = straight.trajectory, samples(straight, 1)
    k = at[len(at) // 2]
    rest = np.insert(np.arange(len(t)), k, np.full(100, k))
    arrays = {field.name: getattr(t, field.name) for field in fields(t)}
    stretched = {name: each[rest] for name, each in arrays.items() if isinstance(each, np.ndarray)}
    more = np.cumsum(np.where(t.deposit[rest], 1.0, 0.0) * stretched["flow"]) * t.dt
    own = {"t": np.arange(len(rest)) * t.dt, "extruded": more, "feed": more / area(straight)}
    lasts = replace(t, **(stretched | own))
    assert "flow per millimetre" in {check.name for check in report(straight, lasts).checks if not check.ok}


@pytest.mark.slow
def test_a_motor_that_is_on_or_off_lays_down_too_much_in_dips() -> None:
    plan = on_off()
    assert plan.verified
    t, like = plan.trajectory, small_plan().trajectory
    missing = ((0.04 - like.speed)[like.deposit] * 0.3 * MM**2).sum() * t.dt  # what the dips keep back
    assert missing * 1e9 > 0.1
    assert plan.metrics["over_extruded_mm3"] == pytest.approx(missing * 1e9, rel=0.05)
    over = plan.series["over_extruded_mm3"]
    assert over.sum() == pytest.approx(plan.metrics["over_extruded_mm3"])
    slow = t.deposit & (t.speed < 0.039)
    assert over[slow].sum() > 0.9 * over.sum()
    assert np.abs(over[~t.deposit]).max() == 0.0
    assert plan.metrics["flow_error_max"] > 0.1
    inner = t.deposit & np.roll(t.deposit, 1) & np.roll(t.deposit, -1)
    assert t.flow[inner] == pytest.approx(0.3 * MM**2 * 0.04, rel=1e-9)
    assert t.feed == pytest.approx(t.extruded / area(plan))


def test_a_motor_that_is_on_or_off_cannot_follow() -> None:
    like = small_plan().trajectory
    names = failed(on_off(), flow=like.flow, extruded=like.extruded, feed=like.feed)
    assert names == {"motor runs while a bead is laid"}


def shifted(plan: Plan, by: int) -> dict[str, Array]:
    """Material that comes `by` samples late."""
    t = plan.trajectory
    return {name: np.roll(getattr(t, name), by) for name in ("flow", "extruded", "feed")}


@pytest.mark.parametrize("by", [2, -2])
def test_a_motor_that_is_switched_too_late_or_too_soon(by: int) -> None:
    plan = on_off()
    t = plan.trajectory
    changes = shifted(plan, by)
    turned, end = (slice(0, by), 0) if by > 0 else (slice(by, None), -1)
    changes["extruded"][turned], changes["feed"][turned] = t.extruded[end], t.feed[end]
    assert failed(plan, **changes) == {"motor runs while a bead is laid"}


def test_a_motor_that_rests_within_a_bead_or_runs_in_travel() -> None:
    plan = on_off()
    t = plan.trajectory
    for i in (samples(plan, 1)[50], samples(plan, 1)[-1] + 40):
        flow = t.flow.copy()
        flow[i] = 0.3 * MM**2 * 0.04 - flow[i]
        found = failed(plan, flow=flow)
        assert "motor runs while a bead is laid" in found
    assert "motor runs while a bead is laid" in failed(plan, extruded=1.01 * t.extruded)


def test_a_motor_that_runs_at_another_rate() -> None:
    plan = on_off()
    t = plan.trajectory
    names = failed(plan, flow=1.01 * t.flow, extruded=1.01 * t.extruded, feed=1.01 * t.feed)
    assert names == {"motor runs while a bead is laid"}


# --- G-code ------------------------------------------------------------------------------------------------


def driven(text: str) -> tuple[Array, Array]:
    """Instants [s] and filament [mm] at the ends of all commands: what a board does with the file."""
    now, at, out = 0.0, 0.0, [(0.0, 0.0)]
    for line in text.splitlines():
        words = line.split(";")[0].split()
        if not words or words[0] in ("M83", "M104", "M106", "M140", "M203", "M595", "T0"):
            continue
        value = {word[0]: float(word[1:]) for word in words[1:]}
        if words[0] == "G4":
            now += value["P"] * 1e-3
        else:
            assert words[0] == "G1"
            assert value["F"] > 0.0
            now += 60.0 * abs(value["E"]) / value["F"]
            at += value["E"]
        out.append((now, at))
    instants, filament = np.array(out).T
    return instants, filament


@pytest.mark.parametrize(
    "make", [small_plan, on_off, with_moves, with_cuts, lambda: solved("process.extruder.lag_s=0.05")]
)
def test_gcode_read_back_moves_the_filament_as_planned(make: Callable[[], Plan]) -> None:
    plan = make()
    t = plan.trajectory
    instants, filament = driven(gcode(with_board(plan, sync="free")))
    assert instants[-1] == pytest.approx(t.t[-1], abs=1e-3)
    assert filament[-1] == pytest.approx(t.feed[-1] / MM, abs=1e-4)
    off = np.interp(t.t, instants, filament) - t.feed / MM
    most = np.abs(np.gradient(t.feed / MM, t.t)).max()
    # a command lasts 20 ms or moves evenly; commands begin within a sample
    assert np.abs(off).max() < 0.02 * most


def test_gcode_says_what_happens_when() -> None:
    plan = with_moves()
    text = gcode(plan)
    assert "M104" not in text and "M140" not in text
    said = [line for line in text.splitlines()[4:] if line.startswith(";")]
    beads = [[f"; prime, bead {i}", f"; bead {i}, layer 0", f"; retract, bead {i}"] for i in range(3)]
    assert said == ["; heat", "; purge", *(line for bead in beads for line in bead)]
    assert text.count("G1 E-") == 3
    assert "; purge\nG1 E5.00000 F1000.000\n" in text, "5 mm in 0.3 s"


def test_gcode_sets_the_temperatures_that_are_given() -> None:
    plan = with_moves()
    process = plan.problem.process
    start = process.start.model_copy(update={"nozzle_c": 280.0, "bed_c": 62.5})
    problem = plan.problem.model_copy(update={"process": process.model_copy(update={"start": start})})
    lines = gcode(replace(plan, problem=problem)).splitlines()
    i = lines.index("; heat")
    assert lines[i : i + 3] == ["; heat", "M140 S62.5", "M104 S280"]
    assert lines[i + 3] == "G4 P100"
    assert "M109" not in " ".join(lines), "who waits for an unknown time loses the robot"
