"""What the extruder does besides depositing: in order, never two things at once, and exactly at the beads' ends."""

from __future__ import annotations

from itertools import accumulate, pairwise
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from planner.motion.extrusion import Span, events
from planner.motion.visits import Rest
from planner.plan import TRAVEL, Event
from planner.problem.by_layer import PauseSpec
from planner.problem.process import ProcessSpec
from planner.toolpath.runs import least_travel_time, prime_time

ROUNDING = 1e-9  # s


def process(**sections: Any) -> ProcessSpec:
    return ProcessSpec(speed_mm_s=40.0, travel_speed_mm_s=200.0, bead={"width_mm": 0.6, "height_mm": 0.5}, **sections)


PLAIN = process()
FILAMENT = process(
    prime={"length_mm": 2.0, "speed_mm_s": 20.0},
    retract={"length_mm": 1.5, "speed_mm_s": 30.0},
    start={"nozzle_c": 200.0, "bed_c": 60.0, "heat_wait_s": 90.0, "purge_mm": 30.0, "purge_speed_mm_s": 3.0},
)
FIBRE = process(prime={"speed_mm_s": 5.0}, fibre={"cut_length_mm": 40.0, "cut_wait_s": 2.5})


def test_without_settings_there_are_no_events_and_no_waiting() -> None:
    assert events(PLAIN, [Span(0, 1.0, 2.0), Span(1, 2.0, 3.0)]) == ()
    assert least_travel_time(PLAIN) == 0.0
    assert PLAIN.start.time == 0.0


def test_events_of_filament_stand_exactly_at_the_ends_of_the_beads() -> None:
    assert FILAMENT.start.time == pytest.approx(100.0)
    found = events(FILAMENT, [Span(0, 103.0, 108.0), Span(1, 109.0, 112.0)])
    expected = [
        Event("heat", TRAVEL, 0.0, 90.0, 0.0),
        Event("purge", TRAVEL, 90.0, 10.0, 0.03),
        Event("prime", 0, 102.9, 0.1, 0.002),
        Event("retract", 0, 108.0, 0.05, -0.0015),
        Event("prime", 1, 108.9, 0.1, 0.002),
        Event("retract", 1, 112.0, 0.05, -0.0015),
    ]
    assert [(e.kind, e.bead) for e in found] == [(e.kind, e.bead) for e in expected]
    for event, right in zip(found, expected, strict=True):
        assert (event.start, event.duration, event.amount) == pytest.approx(
            (right.start, right.duration, right.amount), abs=1e-12
        )
    assert least_travel_time(FILAMENT) == pytest.approx(0.15)
    assert least_travel_time(FILAMENT, leaves=None) == pytest.approx(0.1)
    assert least_travel_time(FILAMENT, reaches=None) == pytest.approx(0.05)


def test_fibre_is_fed_forward_before_every_bead_and_cut_in_every_bead() -> None:
    found = events(FIBRE, [Span(0, 10.0, 30.0, (20.0,)), Span(1, 40.0, 60.0, (52.0,))])
    assert [(e.kind, e.bead) for e in found] == [("prime", 0), ("cut", 0), ("prime", 1), ("cut", 1)]
    prime, cut = found[2], found[3]
    assert (prime.start, prime.duration, prime.amount) == pytest.approx((32.0, 8.0, 0.04))
    assert (cut.start, cut.duration, cut.amount) == (52.0, 2.5, 0.0)
    assert prime_time(FIBRE) == least_travel_time(FIBRE) == pytest.approx(8.0)


def test_heating_without_waiting_is_told_too() -> None:
    (heat,) = events(process(start={"nozzle_c": 210.0}), [Span(0, 1.0, 2.0)])
    assert heat == Event("heat", TRAVEL, 0.0, 0.0, 0.0)


def test_a_layer_cools_before_a_pause_and_that_comes_before_a_change() -> None:
    spec = process(materials={"a": {}, "b": {}}, change={"wait_s": 4.0, "purge_mm": 10.0})
    pause = PauseSpec(before_layer=2, wait_s=3.0, purge_mm=5.0, **{"for": "look"})
    rest = Rest(20.0, 1.5, pause, True)
    assert rest.time(spec) == pytest.approx(1.5 + 3.0 + 1.0 + 4.0 + 2.0)
    found = events(spec, [Span(0, 10.0, 19.0, material="a"), Span(1, 40.0, 50.0, material="b", at_home=rest)])
    assert found[1:] == (
        Event("cool", 1, 20.0, 1.5, 0.0),
        Event("pause", 1, 21.5, 3.0, 0.0, "", "look"),
        Event("purge", 1, 24.5, 1.0, 0.005, "a"),
        Event("change", 1, 25.5, 4.0, 0.0, "b"),
        Event("purge", 1, 29.5, 2.0, 0.01, "b"),
    )
    assert [event.words for event in found[1:3]] == ["cool, bead 1", "pause: look, bead 1"]


def test_a_change_of_material_stands_where_the_robot_rests_and_the_new_one_is_purged() -> None:
    spec = process(
        materials={"a": {"retract": {"length_mm": 3.0, "speed_mm_s": 30.0}}, "b": {"prime": {"length_mm": 2.0}}},
        change={"wait_s": 4.0, "purge_mm": 10.0},
        start={"heat_wait_s": 60.0, "purge_mm": 5.0},
    )
    found = events(
        spec,
        [Span(0, 70.0, 80.0, material="a"), Span(1, 95.0, 99.0, material="b", at_home=Rest(85.0, 0.0, None, True))],
    )
    assert found == (
        Event("heat", TRAVEL, 0.0, 60.0, 0.0, "a"),
        Event("select", TRAVEL, 60.0, 0.0, 0.0, "a"),
        Event("purge", TRAVEL, 60.0, 1.0, 0.005, "a"),
        Event("retract", 0, 80.0, 0.1, -0.003, "a"),
        Event("change", 1, 85.0, 4.0, 0.0, "b"),
        Event("purge", 1, 89.0, 2.0, 0.01, "b"),
        Event("prime", 1, 95.0 - 0.08, 0.08, 0.002, "b"),
    )
    assert [event.words for event in found][1:5:3] == ["select a", "change to b, bead 1"]
    assert least_travel_time(spec, "a", "b") == pytest.approx(0.18)
    assert least_travel_time(spec, "b", "a") == 0.0


specs = st.builds(
    lambda prime, retract, start: process(prime=prime, retract=retract, start=start),
    st.fixed_dictionaries({"length_mm": st.floats(0, 100), "speed_mm_s": st.floats(0.1, 200)}),
    st.fixed_dictionaries({"length_mm": st.floats(0, 100), "speed_mm_s": st.floats(0.1, 200)}),
    st.fixed_dictionaries({"heat_wait_s": st.floats(0, 600), "purge_mm": st.floats(0, 100)}),
) | st.builds(
    lambda fibre, speed: process(fibre=fibre, prime={"speed_mm_s": speed}),
    st.fixed_dictionaries({"cut_length_mm": st.floats(1, 500), "cut_wait_s": st.floats(0, 600)}),
    st.floats(0.1, 200),
)
gaps = st.lists(st.tuples(st.floats(0, 5), st.floats(0.01, 20), st.floats(0.01, 0.99)), min_size=1, max_size=8)


@given(specs, gaps)
def test_events_are_in_order_and_never_two_at_once(spec: ProcessSpec, print_: list[tuple[float, float, float]]) -> None:
    """With no more time than is asked for between the beads, all fits."""
    now, spans = spec.start.time, []
    for i, (spare, length, share) in enumerate(print_):
        start = now + spare + least_travel_time(spec, leaves="" if i > 0 else None)
        stop = start + share * length
        waits = spec.fibre.cut_wait if spec.fibre is not None else 0.0
        now = start + length + waits
        spans.append(Span(i, start, now, (stop,) if spec.fibre is not None else ()))
    found = events(spec, spans)
    assert all(event.start >= 0.0 and event.duration >= 0.0 for event in found)
    assert all(a.start + a.duration <= b.start + ROUNDING for a, b in pairwise(found))
    for span in spans:
        own = {event.kind: event for event in found if event.bead == span.bead}
        assert ("prime" in own) == (spec.prime_length > 0.0)
        if "prime" in own:
            assert own["prime"].start + own["prime"].duration == pytest.approx(span.start, abs=ROUNDING)
            assert own["prime"].amount == spec.prime_length
        if "retract" in own:
            assert own["retract"].start == span.end
            assert own["retract"].amount == -spec.retract.length
        if spec.fibre is not None:
            assert own["cut"].start == span.stops[0]
            assert own["cut"].start + own["cut"].duration <= span.end + ROUNDING
    pushed = list(accumulate(event.amount for event in found))
    assert not pushed or pushed[-1] == pytest.approx(
        spec.start.purge + len(spans) * (spec.prime_length - spec.retract.length), abs=1e-9
    )


@pytest.mark.parametrize(
    ("spans", "told"),
    [
        ([Span(0, 100.05, 101.0)], "prime of bead 0 begins 0.05 s before purge"),
        ([Span(0, 110.0, 111.0), Span(1, 111.1, 112.0)], "prime of bead 1 begins 0.05 s before retract of bead 0 ends"),
    ],
)
def test_too_little_time_is_told_and_not_overlapped(spans: list[Span], told: str) -> None:
    with pytest.raises(ValueError, match=told):
        events(FILAMENT, spans)
