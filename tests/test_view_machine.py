"""The live view's state machine: what happens goes in, what is to be done comes out, no clock or process anywhere."""

from __future__ import annotations

from collections.abc import Sequence

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from planner.view.content import Content, Mistake
from planner.view.machine import (
    LONGEST_WAIT,
    MOST_ENTRIES,
    QUIET_TIME,
    ROWS,
    Again,
    Beside,
    Broke,
    Cancel,
    Choose,
    Drafts,
    Effect,
    Event,
    Read,
    ReadFiles,
    Remove,
    ReportReady,
    Shown,
    SolveOutcome,
    Staged,
    Start,
    Tick,
    Touched,
    View,
    difference,
    step,
    verdict,
)
from planner.view.server import snapshot

SLOW, FAST = (Content((("process.speed_mm_s", text), ("name", "a"))) for text in ("5", "10"))
WRONG = Mistake("must be a number", "a.yaml", 3, "process.speed_mm_s")
GOOD = SolveOutcome("verified", "verified: 28 checks hold", (("at_speed_fraction", 0.9), ("print_time_s", 60.0)))
BETTER = SolveOutcome("verified", "verified: 28 checks hold", (("at_speed_fraction", 0.95), ("print_time_s", 61.0)))
DRAFT = SolveOutcome("verified", "verified: 28 checks hold", (("at_speed_fraction", 0.8),), "one layer of 10")


def after(view: View, *events: Event) -> tuple[View, list[Effect]]:
    """The view after several events, and all effects of the last one."""
    effects: Sequence[Effect] = ()
    for event in events:
        view, effects = step(view, event)
    return view, list(effects)


def solved_once(*panes: str) -> View:
    """A view whose panes have all been solved with the slow content."""
    view, _ = after(View(panes=panes), Read(SLOW, "10:00"))
    for number in range(1, len(panes) + 1):
        view, _ = after(view, ReportReady(number, GOOD, "10:01"))
    return view


def test_burst_of_saves_is_read_once_when_it_is_over() -> None:
    view = View(panes=("sqp",))
    for k in range(10):
        view, effects = after(view, Touched(0.1 * k), Tick(0.1 * k + 0.09))
        assert not effects
    view, effects = after(view, Tick(0.9 + QUIET_TIME))
    assert effects == [ReadFiles()]
    assert after(view, Tick(5.0))[1] == []


def test_file_that_never_rests_is_read_all_the_same() -> None:
    view, read_at = View(panes=("sqp",)), []
    for k in range(40):
        now = 0.1 * k
        view, _ = after(view, Touched(now))
        view, effects = after(view, Tick(now))
        read_at += [now] if effects else []
    assert read_at and read_at[0] <= LONGEST_WAIT + 0.1


def test_change_while_files_are_read_is_read_after_that() -> None:
    view, effects = after(View(panes=("sqp",)), Touched(0.0), Tick(1.0), Touched(1.0), Tick(2.0))
    assert effects == []
    view, effects = after(view, Read(SLOW, "10:00"))
    assert effects == [Start(view.running)]
    assert after(view, Tick(2.0))[1] == [ReadFiles()]


def test_save_that_says_the_same_solves_nothing() -> None:
    view = solved_once("sqp")
    view, effects = after(view, Read(SLOW, "10:02"))
    assert effects == []
    assert "nothing that matters" in view.note


def test_newer_save_ends_the_solve_that_runs() -> None:
    view, effects = after(View(panes=("sqp",)), Read(SLOW, "10:00"))
    assert effects == [Start(view.running)]
    view, effects = after(view, Read(FAST, "10:01"))
    assert effects == [Cancel(), Start(view.running)]
    assert view.running is not None and view.running.number == 2
    late, effects = after(view, Staged(1, "verify"), ReportReady(1, GOOD, "10:02"))
    assert (late, effects) == (view, [Remove("1-whole")])
    assert after(view, Broke(1, WRONG)) == (view, [])


def test_mistake_leaves_the_last_good_result_and_says_where() -> None:
    view = solved_once("sqp")
    broken, effects = after(view, Read(WRONG, "10:02"))
    assert effects == []
    assert broken.results == view.results
    told = snapshot(broken, "a", "a.yaml")
    assert told["mistake"]["line"] == 3
    assert told["panes"][0]["result"]["old"]
    mended, effects = after(broken, Read(SLOW, "10:03"))
    assert effects == [] and mended.mistake is None, "as it was before: nothing is to be solved"
    assert after(broken, Read(FAST, "10:03"))[1] == [Start(after(broken, Read(FAST, "10:03"))[0].running)]


def test_nothing_starts_while_the_file_is_wrong() -> None:
    broken, _ = after(solved_once("sqp"), Read(WRONG, "10:02"))
    waiting, effects = after(broken, Choose(0, "ladder"))
    assert effects == []
    assert after(waiting, Read(SLOW, "10:03"))[1] == [Start(after(waiting, Read(SLOW, "10:03"))[0].running)]


def test_draft_is_shown_and_gives_way_to_the_whole() -> None:
    view, effects = after(View(panes=("sqp",)), Read(SLOW, "10:00"), ReportReady(1, DRAFT, "10:01"))
    assert effects == [] and view.history == () and view.running is not None
    assert snapshot(view, "a", "a.yaml")["panes"][0]["result"]["draft"] == "one layer of 10"
    view, effects = after(view, ReportReady(1, GOOD, "10:02"))
    assert effects == [Remove("1-draft")] and view.running is None
    assert [entry.outcome for entry in view.history] == [GOOD]


def test_panes_are_solved_one_after_the_other_and_compared() -> None:
    view, effects = after(solved_once("sqp"), Beside("ladder"))
    assert effects == [Start(view.running)]
    assert snapshot(view, "a", "a.yaml")["differences"] == []
    view, _ = after(view, ReportReady(2, BETTER, "10:02"))
    rows = {row["label"]: row for row in snapshot(view, "a", "a.yaml")["differences"]}
    at_speed, time = rows["length at commanded speed (±2 %), %"], rows["print time, s"]
    assert (at_speed["left"], at_speed["right"], at_speed["better"]) == ("90.00", "95.00", "right")
    assert (time["difference"], time["better"]) == ("+1.0", "left")
    alone, effects = after(view, Beside(None), Beside("ladder"))
    assert effects == [], "what was solved with the same files is at hand"
    assert alone.panes == ("sqp", "ladder")


@pytest.mark.parametrize(
    ("value", "other", "told"),
    [(12.451, 12.449, "+0.1"), (1.06, 0.94, "+0.2"), (0.94, 1.06, "−0.2"), (1.04, 0.96, "0"), (-0.04, 0.04, "0")],
)
def test_differences_are_those_of_what_is_shown(value: float, other: float, told: str) -> None:
    (row,) = (row for row in ROWS if row.key == "print_time_s")
    assert difference(row, value, other) == told
    assert (verdict(row, value, other) == "same") == (told == "0")


def test_strategy_that_the_other_pane_shows_changes_places_with_it() -> None:
    assert after(solved_once("sqp", "ladder"), Choose(0, "ladder"))[0].panes == ("ladder", "sqp")
    assert after(solved_once("sqp"), Beside("sqp"))[0].panes == ("sqp",)
    assert after(solved_once("sqp"), Choose(1, "ladder"))[0].panes == ("sqp",), "there is no such pane"


def test_strategy_that_nobody_looks_at_any_more_is_not_solved_to_the_end() -> None:
    view, effects = after(View(panes=("sqp",)), Read(SLOW, "10:00"), Choose(0, "ladder"))
    assert effects == [Cancel(), Start(view.running)]
    assert view.running is not None and view.running.strategy == "ladder"


def test_pane_follows_the_strategy_of_the_file() -> None:
    view = View(panes=("sqp",))
    one, other = (Content((*SLOW.fields, ("strategy", name))) for name in ("sqp", "greedy"))
    view, _ = after(view, Read(one, "10:00"), Read(other, "10:01"))
    assert view.panes == ("greedy",)


def test_history_says_what_was_changed_and_what_it_did() -> None:
    view, _ = after(solved_once("sqp"), Read(FAST, "10:02"), ReportReady(2, BETTER, "10:03"))
    newest, first = snapshot(view, "a", "a.yaml")["history"]["rows"]
    assert first["changes"] is None
    assert newest["changes"] == ["process.speed_mm_s: 5 → 10"]
    assert [cell["verdict"] for cell in newest["cells"]] == ["better", "worse"]
    assert [cell["change"] for cell in newest["cells"]] == ["+5.00", "+1.0"]


def test_history_compares_with_the_last_solve_of_the_same_strategy() -> None:
    view, _ = after(solved_once("sqp"), Choose(0, "ladder"), ReportReady(2, BETTER, "10:02"), Read(FAST, "10:03"))
    view, _ = after(view, ReportReady(3, BETTER, "10:04"), Choose(0, "sqp"), ReportReady(4, GOOD, "10:05"))
    rows = snapshot(view, "a", "a.yaml")["history"]["rows"]
    assert [(row["strategy"], row["changes"]) for row in rows] == [
        ("sqp", ["process.speed_mm_s: 5 → 10"]),
        ("ladder", ["process.speed_mm_s: 5 → 10"]),
        ("ladder", None),
        ("sqp", None),
    ]


def test_history_and_results_stay_bounded() -> None:
    view, removed = View(panes=("sqp",)), 0
    for k in range(1, MOST_ENTRIES + 20):
        view, _ = after(view, Read(Content((("speed", str(k)),)), "10:00"))
        view, effects = after(view, ReportReady(k, GOOD, "10:01"))
        removed += len(effects)
    assert len(view.history) == MOST_ENTRIES
    assert len(view.results) == 1 and removed == MOST_ENTRIES + 18


def test_what_is_wrong_with_a_file_is_not_tried_with_every_strategy() -> None:
    view, _ = after(View(panes=("sqp", "ladder")), Read(SLOW, "10:00"))
    view, effects = after(view, Broke(1, Mistake("there is no file a.svg", "a.yaml", 9, "layers.source.svg")))
    assert effects == [] and view.running is None and view.trouble is not None
    again, effects = after(view, Read(SLOW, "10:01"))
    assert effects == [Start(again.running)] and again.trouble is None, "a save tries it again"


def test_solver_that_fails_leaves_the_other_pane_its_turn() -> None:
    view, effects = after(View(panes=("sqp", "ladder")), Read(SLOW, "10:00"), Broke(1, Mistake("ended early")))
    assert effects == [Start(view.running)]
    assert view.running is not None and view.running.strategy == "ladder"


def test_solve_again_and_drafts_are_for_the_user() -> None:
    view, effects = after(solved_once("sqp"), Drafts(False), Again())
    assert effects == [Start(view.running)]
    assert view.running is not None and not view.running.drafts


def test_folder_of_results_is_shown_and_never_solved() -> None:
    view = View(panes=("sqp",), solving=False)
    view, effects = after(view, Shown("ladder", GOOD, Content((("dt", "0.004"),)), "10:00"))
    assert effects == [] and view.panes == ("ladder",)
    for event in (Again(), Choose(0, "sqp"), Beside("sqp")):
        assert after(view, event)[1] == []
    view, effects = after(view, Shown("ladder", BETTER, Content((("dt", "0.002"),)), "10:01"))
    assert view.results["ladder"].key == "2-folder"
    assert view.history[-1].changes == ("dt: 0.004 → 0.002",)


NUMBERS, NAMES = st.integers(1, 6), st.sampled_from(["sqp", "ladder", "greedy"])
EVENTS = st.one_of(
    st.builds(Touched, st.floats(0, 10)),
    st.builds(Tick, st.floats(0, 20)),
    st.builds(Read, st.sampled_from([SLOW, FAST, WRONG]), st.just("10:00")),
    st.builds(Staged, NUMBERS, st.just("resolve")),
    st.builds(ReportReady, NUMBERS, st.sampled_from([GOOD, DRAFT]), st.just("10:00")),
    st.builds(Broke, NUMBERS, st.sampled_from([WRONG, Mistake("ended early")])),
    st.builds(Choose, st.integers(-1, 2), NAMES),
    st.builds(Beside, st.one_of(st.none(), NAMES)),
    st.builds(Drafts, st.booleans()),
    st.just(Again()),
)


@settings(max_examples=60)
@given(st.lists(EVENTS, max_size=40))
def test_one_solve_at_a_time_whatever_happens(events: list[Event]) -> None:
    """Starts and ends of solves alternate, shown reports are never removed, and the page can always be told."""
    view, running = View(panes=("sqp",)), False
    for event in events:
        ended = isinstance(event, Broke) or (isinstance(event, ReportReady) and not event.outcome.draft)
        if ended and view.running is not None and view.running.number == event.job:  # type: ignore[union-attr]
            running = False
        view, effects = step(view, event)
        for effect in effects:
            if isinstance(effect, Cancel):
                assert running
                running = False
            elif isinstance(effect, Start):
                assert not running
                running = True
        assert running == (view.running is not None)
        shown = {result.key for result in view.results.values()}
        assert not shown & {effect.key for effect in effects if isinstance(effect, Remove)}
        assert 1 <= len(view.panes) <= 2 and len(set(view.panes)) == len(view.panes)
        assert len(snapshot(view, "a", "a.yaml")["panes"]) == len(view.panes)
