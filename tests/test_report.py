"""The report: one offline file, honest words, nothing unescaped, and no extreme lost on the way to the screen."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Sequence
from html import unescape
from importlib.metadata import distribution
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import plotly.graph_objects as go
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from plotly.offline import get_plotlyjs
from report_fixtures import CENTRE, RADIUS, SHAPE, make_beads, make_plan, make_problem, with_dips
from report_page import figures, library, own_text, points, values, visible
from solved import small_plan

from planner.base.errors import OutputError
from planner.plan import Check, Event
from planner.plan.measures import CHECKS
from planner.problem import Problem, load_problem
from planner.problem.fields import described
from planner.report import places
from planner.report.charts import joint_charts, time_charts
from planner.report.extruder import even_flow, events_words, flow_note
from planner.report.failure import write_failure_report
from planner.report.html import _command, _header, write_report
from planner.report.judged import DEAREST, HEADLINES, MARGINS, judged
from planner.report.places import MOST_MARKS, MOST_ROWS, check_advice, worst_samples
from planner.report.scene import part_data, plan_scene
from planner.report.summary import print_summary
from planner.report.thinning import CURVE_BUDGET, SCENE_BUDGET, keep_minima, runs, stretches, thin_curve
from planner.report.wording import FARTHEST, GROUPS, METRICS, distance, duration, number, significant, with_ratios
from planner.toolpath.bead import Shape
from planner.verify.checks import FAR

MB = 1_000_000
EVIL = "</script><script>alert(1)</script><img src=x onerror=alert(2)>&\"'"


@pytest.fixture(scope="module")
def long_report(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("report") / "report.html"
    write_report(with_dips(make_plan(130_000)), path)
    return path


# ---- thinning ----------------------------------------------------------------------------------------------------

CURVES = arrays(np.float64, st.integers(1, 800), elements=st.floats(-1e3, 1e3) | st.just(float("nan")))


@given(CURVES, st.integers(8, 200))
def test_a_thinned_curve_keeps_both_extremes_both_ends_and_the_budget(y: np.ndarray, budget: int) -> None:
    kept = thin_curve(y, budget)
    assert len(kept) <= budget
    assert (np.diff(kept) > 0).all()
    assert kept[0] == 0 and kept[-1] == len(y) - 1
    if np.isfinite(y).any():
        assert np.nanmin(y[kept]) == np.nanmin(y)
        assert np.nanmax(y[kept]) == np.nanmax(y)


@given(arrays(np.float64, (3, 500), elements=st.floats(-9, 9)), st.sets(st.integers(0, 499), max_size=20))
def test_every_signal_keeps_its_minimum_and_every_demanded_sample_stays(signals: np.ndarray, must: set[int]) -> None:
    kept = keep_minima(list(signals), 80, np.array(sorted(must), dtype=np.intp))
    assert len(kept) <= 80
    assert must <= set(kept.tolist())
    assert (signals[:, kept].min(axis=1) == signals.min(axis=1)).all()


def test_a_short_dip_survives_where_a_stride_would_lose_it() -> None:
    y = np.full(130_000, 40.0)
    y[77_777] = 3.0
    kept = thin_curve(y)
    assert len(kept) <= CURVE_BUDGET
    assert y[kept].min() == 3.0 and y[:: len(y) // CURVE_BUDGET].min() == 40.0


@given(st.lists(st.tuples(st.booleans(), st.integers(0, 2)), min_size=0, max_size=60))
def test_runs_agree_with_a_plain_loop(samples: list[tuple[bool, int]]) -> None:
    mask = np.array([m for m, _ in samples], dtype=bool)
    label = np.array([k for _, k in samples], dtype=np.int32)
    expected: list[list[int]] = []
    for i, (on, k) in enumerate(samples):
        if on and expected and expected[-1][1] == i - 1 and samples[i - 1] == (True, k):
            expected[-1][1] = i
        elif on:
            expected.append([i, i])
    first, last = runs(mask, label)
    assert [list(pair) for pair in zip(first.tolist(), last.tolist(), strict=True)] == expected
    index, begin, end = stretches(mask, label)
    assert index[begin].tolist() == first.tolist() and index[end].tolist() == last.tolist()


# ---- the file ----------------------------------------------------------------------------------------------------


def test_a_long_report_is_one_small_file_that_loads_nothing(long_report: Path) -> None:
    assert long_report.stat().st_size <= 5 * MB
    text = own_text(long_report)
    assert not re.search(r"https?://|//cdn|@import|\bfetch\(|XMLHttpRequest|WebSocket|importScripts", text)
    assert not re.search(r"<(script|img|iframe|source|object|embed)[^>]*\ssrc\s*=", text)
    assert re.findall(r"<link[^>]*>", text) == ['<link rel=icon href="data:,">']
    assert "default-src 'none'" in text and "eval" not in text, "the page forbids itself the network"
    assert "showSendToCloud: false" in text, "the library's upload button stays away"


def test_the_libraries_are_inside_as_they_were_but_for_fonts(long_report: Path) -> None:
    assert library(long_report, "plotly") == get_plotlyjs()
    viewer = library(long_report, "k3d")
    source = distribution("k3d").locate_file("k3d/static/standalone.js").read_text(encoding="utf-8")
    assert source.count("fonts/KaTeX") > 20 and "fonts/KaTeX" not in viewer and "data:font/woff2" not in viewer
    assert 0.8 < len(viewer) / len(source) < 0.9
    begin, end = source.index("@font-face{"), source.rindex("data:font/woff2")
    assert viewer.startswith(source[: begin // 2]) and viewer.endswith(source[-(len(source) - end) // 2 :])


def test_same_plan_same_bytes(tmp_path: Path) -> None:
    for name in "ab":
        write_report(make_plan(6_000), tmp_path / name)
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()


def test_every_chart_has_a_place_on_the_page_and_is_valid_plotly(long_report: Path) -> None:
    data, text = figures(long_report), own_text(long_report)
    keys = [chart["key"] for chart in data["charts"]]
    assert keys[:5] == ["speed", "flow", "sigma", "margins", "ratios"] and len(keys) == 5 + 7
    for key in keys:
        assert text.count(f"id='chart-{key}'") == 1
    plan = make_plan(6_000)
    for chart in time_charts(plan) + joint_charts(plan):
        go.Figure({"data": chart["traces"], "layout": chart["layout"]})


def test_budgets_hold_and_the_page_shows_the_true_extremes(long_report: Path) -> None:
    plan, data = make_plan(130_000), figures(long_report)
    for chart in data["charts"]:
        for trace in chart["traces"]:
            assert np.isfinite(trace["x"]).sum() <= CURVE_BUDGET
    channels = data["scene"]["lines"]["channels"]
    speed = values(channels[0]["values"])
    assert len(speed) == len(data["scene"]["lines"]["sample"]) <= SCENE_BUDGET
    deposited = plan.trajectory.speed[plan.trajectory.deposit] * 1e3
    assert speed.min() == pytest.approx(deposited.min(), rel=1e-6)
    assert [channel["key"] for channel in channels] == [
        "speed",
        "sigma",
        "wrist_deg",
        "limit_margin_deg",
        "load",
        "flow",
        "layer",
    ]
    for channel in channels:
        shown = values(channel["values"])
        assert channel["min"] - 1e-6 <= np.nanmin(shown) and np.nanmax(shown) <= channel["max"] + 1e-6
    ratios = next(chart for chart in data["charts"] if chart["key"] == "ratios")
    assert ratios["traces"][2]["y"].max() == pytest.approx(plan.series["jerk_ratio"].max(), rel=1e-6)


@pytest.mark.slow
def test_lines_of_the_scene_end_where_beads_end_and_keep_corners() -> None:
    plan = make_plan(130_000)
    lines = plan_scene(plan, [])["lines"]
    x, traj = points(lines), plan.trajectory
    assert len(lines["first"]) == len(lines["bead"]) == 40 and lines["bead"].tolist() == list(range(40))
    assert lines["layer"].tolist() == [k // 4 for k in range(40)]
    first_end = np.flatnonzero(traj.bead == 0)[-1]
    assert lines["sample"][lines["first"][1] - 1] == first_end
    assert x == pytest.approx(traj.tip[lines["sample"]], abs=2e-6), "16 bits of the print's size"
    assert lines["normal"].reshape(-1, 3) / 127 == pytest.approx(-traj.axis[lines["sample"]], abs=0.005)
    # Where the first star turns, a drawn point stands no further off than the next sample.
    tip = traj.tip[traj.bead == 0] * 1e3
    d = np.diff(tip, axis=0)
    d /= np.linalg.norm(d, axis=1)[:, None]
    corners = tip[1:-1][(d[1:] * d[:-1]).sum(axis=1) < 0.9]
    assert len(corners) >= 9
    step = np.linalg.norm(np.diff(tip, axis=0), axis=1).max()
    off = np.linalg.norm(1e3 * x[: lines["first"][1], None] - corners, axis=2).min(axis=0)
    assert off.max() <= step + 0.002 < 0.12


def test_the_part_is_drawn_where_it_is() -> None:
    part = plan_scene(make_plan(4_000), [])["part"]
    x = part["points"].reshape(-1, 3)
    assert (x[:, 2].min(), x[:, 2].max()) == pytest.approx((0.0, 0.1), abs=2e-4)
    reach = np.hypot(*(x[:, :2] - CENTRE).T)
    assert 0.99 * RADIUS < reach[x[:, 2] == 0.0].min() < RADIUS - 1e-4, "a hair inside the first layer"


@pytest.mark.parametrize(("height", "sunk"), [(0.5e-3, 0.15e-3), (0.05e-3, 0.025e-3)])
def test_the_part_is_drawn_smaller_by_less_than_a_low_bead(height: float, sunk: float) -> None:
    corners = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    shape = Shape(corners, np.tile([0.0, 0.0, 1.0], (3, 1)), np.array([[0, 1, 2]]))
    bead: Any = SimpleNamespace(height=np.full(4, height))
    part = part_data(shape, [bead])
    assert part is not None and part["points"].reshape(-1, 3)[:, 2] == pytest.approx(-sunk)


# ---- dips --------------------------------------------------------------------------------------------------------


def test_dips_are_marked_where_they_are_and_say_why() -> None:
    plan = with_dips(make_plan(12_000))
    marks = plan_scene(plan, judged(plan).places)["dips"]
    assert len(plan.dips) == len(marks["words"]) == len(marks["sample"]) > 100
    for dip, at, point, normal, words in zip(
        plan.dips,
        marks["sample"],
        marks["point"].reshape(-1, 3),
        marks["normal"].reshape(-1, 3),
        marks["words"],
        strict=True,
    ):
        assert at == round(dip.t / plan.trajectory.dt)
        assert point == pytest.approx(plan.trajectory.tip[at], abs=1e-6)
        assert normal == pytest.approx(-plan.trajectory.axis[at], abs=1e-6)
        assert words[0].startswith(f"bead {dip.bead}, layer {dip.layer + 1}, {dip.from_s * 1e3:.1f} to ")
        assert f"{dip.speed * 1e3:.1f} of 40 mm/s" in words[1]
        assert words[2] in ("why: joint_4 jerk", "why: starts from rest")
    words = next(words for words in marks["words"] if "joint_4" in words[2])
    assert words[2:] == [
        "why: joint_4 jerk",
        "would avoid it: cell.limits.joint_4.jerk_rad_s3: 1800 and 2 other limits",
        "or process.corner_tolerance_mm: about 0.4",
    ]


def test_a_table_of_the_worst_dips_says_how_many_there_are(tmp_path: Path) -> None:
    plan = with_dips(make_plan(12_000), over=2.5e-9)
    write_report(plan, tmp_path / "r.html")
    words, text = visible(tmp_path / "r.html"), own_text(tmp_path / "r.html")
    lost = sum(dip.lost for dip in plan.dips)
    assert f"{len(plan.dips)} dips cost {lost:.2f} s" in words
    assert f"The {MOST_ROWS} of {len(plan.dips)} that cost most" in words
    table = text[text.index("that cost most") :]
    table = table[: table.index("</table>")]
    assert table.count("<tr>") == 1 + MOST_ROWS
    costs = [float(cost) for cost in re.findall(r"of 40</td><td class=n data-unit='s lost'>([\d.]+)</td>", table)]
    assert costs == sorted(costs, reverse=True) and costs[0] == max(round(dip.lost, 3) for dip in plan.dips)
    assert "too much material, mm³" in table and "<td class=n data-unit='mm³ too much'>2.500</td>" in table
    assert "process.corner_tolerance_mm: about 0.4" in table
    assert "starts from rest" in words and "joint_4 jerk" in words
    by_cause = re.search(r"starts from rest (\d+) ", words)
    assert by_cause and int(by_cause[1]) == sum(dip.limit == "start" for dip in plan.dips)
    write_report(with_dips(make_plan(12_000)), tmp_path / "even.html")
    assert "too much material" not in visible(tmp_path / "even.html")


def test_a_stop_that_was_asked_for_is_no_dip(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    plan = with_dips(make_plan(12_000))
    stop = dataclasses.replace(plan.dips[0], speed=0.0, lost=3.0, joint="", limit="stop", remedies=())
    lost = sum(dip.lost for dip in plan.dips[1:])
    plan = dataclasses.replace(plan, dips=(stop, *plan.dips[1:]))
    write_report(plan, tmp_path / "r.html")
    words = visible(tmp_path / "r.html")
    assert f"{len(plan.dips) - 1} dips cost {lost:.2f} s" in words and "stops here" not in words
    assert "the nozzle stops on its bead: 1 time, 3.00 s in all" in words
    print_summary(plan, tmp_path)
    assert f"{len(plan.dips) - 1} dips cost {lost:.2f} s" in capsys.readouterr().out
    write_report(dataclasses.replace(plan, dips=(stop,)), tmp_path / "only.html")
    words = visible(tmp_path / "only.html")
    assert "None: all beads are printed at the commanded speed, within 2 %. Where fibre is cut" in words
    print_summary(dataclasses.replace(plan, dips=(stop,)), tmp_path)
    assert not re.search(r"dips? costs?", capsys.readouterr().out)


def test_what_became_of_the_input_is_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    plan = make_plan(2_000)
    print_summary(plan, tmp_path)
    write_report(plan, tmp_path / "report.html")
    assert "note:" not in capsys.readouterr().out
    assert "became of the input" not in own_text(tmp_path / "report.html")
    told = SimpleNamespace(**{**vars(plan.toolpath), "notes": (f"3 points of {EVIL} left out",)})
    plan = dataclasses.replace(plan, toolpath=told)
    print_summary(plan, tmp_path)
    write_report(plan, tmp_path / "report.html")
    assert "note: 3 points of </script>" in capsys.readouterr().out
    page = own_text(tmp_path / "report.html")
    assert "What became of the input" in page
    assert "<li>3 points of &lt;/script&gt;" in page


def test_no_dip_is_said_too(tmp_path: Path) -> None:
    write_report(make_plan(4_000), tmp_path / "r.html")
    assert "None: all beads are printed at the commanded speed" in visible(tmp_path / "r.html")
    assert plan_scene(make_plan(4_000), [])["dips"] is None
    assert "id=dips" not in visible(tmp_path / "r.html").lower() and "type=checkbox id=dips" not in own_text(
        tmp_path / "r.html"
    )


@pytest.mark.slow
def test_thousands_of_dips_keep_the_report_small(tmp_path: Path) -> None:
    plan = with_dips(make_plan(180_000, layers=100))
    dips = tuple(dataclasses.replace(dip, lost=dip.lost + 1e-6 * k) for k, dip in enumerate(plan.dips * 4))
    assert len(dips) > 8_000
    plan = dataclasses.replace(plan, dips=dips)
    write_report(plan, tmp_path / "r.html")
    assert (tmp_path / "r.html").stat().st_size <= 5 * MB
    shown = plan_scene(plan, [])["dips"]["sample"]
    assert len(shown) == MOST_MARKS and (np.diff(shown) >= 0).all()
    assert f"the {MOST_MARKS} that cost most are white marks" in visible(tmp_path / "r.html")
    assert f"{len(dips):,} dips cost".replace(",", " ") in visible(tmp_path / "r.html")


# ---- the extruder ------------------------------------------------------------------------------------------------


def extruder_plan(*, events: tuple[Event, ...] = (), section: str = "rectangle", motor: str = "e_axis", lag: float = 0):
    plan = make_plan(4_000)
    problem = SimpleNamespace(**vars(plan.problem))
    process = vars(problem.process) | {"section": section, "extruder": SimpleNamespace(motor=motor, lag=lag)}
    problem.process = SimpleNamespace(**process)
    return dataclasses.replace(plan, problem=problem, trajectory=dataclasses.replace(plan.trajectory, events=events))


def flow_chart(plan) -> dict:
    return next(chart for chart in time_charts(plan) if chart["key"] == "flow")


PRIMES = (
    Event("heat", -1, 0.0, 5.0, 0.0),
    Event("prime", 0, 5.0, 0.15, 0.003),
    Event("retract", 0, 7.0, 0.2, -0.002),
    Event("prime", 1, 8.0, 0.15, 0.003),
)


def test_the_note_on_flow_is_true_of_every_motor() -> None:
    follows = "the bead stays even through a dip"
    assert follows in flow_note(extruder_plan()) and "proportion" not in flow_note(extruder_plan())
    demand = flow_note(extruder_plan(motor="speed_demand"))
    assert follows in demand and "in proportion to the nozzle's real speed" in demand
    plan = extruder_plan(motor="on_off")
    plan.metrics["over_extruded_mm3"] = 12.34
    assert follows not in flow_note(plan) and "gets too much material there: 12.34 mm³ in all" in flow_note(plan)
    cut = extruder_plan(section="fibre", events=(Event("cut", 0, 3.0, 3.0, 0.0),))
    assert "as fast as the nozzle really moves" in flow_note(cut) and "drawn, not pushed" in flow_note(cut)
    assert "lags the motor by 0.05 s" in flow_note(extruder_plan(lag=0.05))
    assert "pushes and pulls filament" in flow_note(extruder_plan(events=PRIMES))
    for each in (extruder_plan(), plan, cut):
        assert "lags" not in flow_note(each)


def test_the_note_on_flow_says_how_quick_a_motor_has_to_be_for_its_lag() -> None:
    """What is laid in twenty samples is pushed in one: ten times as fast, by the slope over two, beside what is laid."""
    plan = extruder_plan(lag=0.5)
    t = plan.trajectory
    assert "times the greatest flow" not in flow_note(plan)
    at_once = 20.0 * float(t.flow.max()) * t.dt / (0.25 * np.pi * 1.75e-3**2)
    feed = t.feed + np.where(np.arange(len(t.t)) > int(np.argmax(t.flow)), at_once, 0.0)
    quick = dataclasses.replace(plan, trajectory=dataclasses.replace(t, feed=feed))
    assert "it pushes up to 11 times the greatest flow laid" in flow_note(quick)


def test_what_the_motor_pushes_stands_beside_the_flow_where_they_differ() -> None:
    assert [trace["name"] for trace in flow_chart(extruder_plan())["traces"]] == ["laid down"]
    assert len(flow_chart(extruder_plan(lag=0.05))["traces"]) == 2
    plan = extruder_plan(events=PRIMES)
    feed = plan.trajectory.feed + np.interp(plan.trajectory.t, [5.0, 5.15], [0.0, 0.003])
    plan = dataclasses.replace(plan, trajectory=dataclasses.replace(plan.trajectory, feed=feed))
    push = next(trace for trace in flow_chart(plan)["traces"] if trace["name"] == "pushed by the motor")
    during = (push["x"] > 5.01) & (push["x"] < 5.14)
    prime = 0.003 / 0.15 * np.pi / 4 * 1.75e-3**2 * 1e9
    laid = 0.3 * 40.0  # at most, mm³/s
    assert during.any() and (push["y"][during] >= 0.99 * prime).all()
    assert (push["y"][during] <= prime + 1.01 * laid).all()


def test_the_part_samples_at_a_beads_ends_are_no_peaks_of_flow() -> None:
    plan = make_plan(4_000)
    flow = plan.trajectory.flow.copy()
    first, last = runs(plan.trajectory.deposit, plan.trajectory.bead)
    flow[first] *= 1.5
    flow[last] *= 0.5
    trajectory = dataclasses.replace(plan.trajectory, flow=flow)
    drawn = even_flow(trajectory)
    assert (drawn[first] <= flow[first + 1]).all() and (drawn[last] == flow[last]).all()
    inside = np.ones(len(flow), dtype=bool)
    inside[[*first, *last]] = False
    assert (drawn[inside] == flow[inside]).all()


def test_events_are_listed_shortly(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    plan = extruder_plan(events=PRIMES)
    write_report(plan, tmp_path / "r.html")
    words = visible(tmp_path / "r.html")
    assert "heat up, at home 1 5.00 – 0.00" in words
    assert "prime, before a bead 2 0.30 6.0 5.00" in words
    assert "retract, after a bead 1 0.20 −2.0 7.00" in words
    print_summary(plan, tmp_path)
    told = "extruder, apart from laying down: 1 x heat (5 s); 2 x prime (0.3 s, +6 mm); 1 x retract (0.2 s, -2 mm)\n"
    assert told in capsys.readouterr().out
    write_report(make_plan(4_000), tmp_path / "none.html")
    assert "What else the extruder does" not in visible(tmp_path / "none.html")
    print_summary(make_plan(4_000), tmp_path)
    assert "extruder" not in capsys.readouterr().out


def test_too_much_material_is_a_colour_a_row_and_a_metric(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    plan = with_dips(extruder_plan(motor="on_off"), over=2.5e-9)
    t = plan.trajectory
    flow = np.where(t.deposit, 0.3e-6 * 0.040, 0.0)
    over = (flow - np.where(t.deposit, 0.3e-6 * t.speed, 0.0)) * t.dt * 1e9
    plan = dataclasses.replace(
        plan,
        trajectory=dataclasses.replace(t, flow=flow),
        series=plan.series | {"over_extruded_mm3": over},
        metrics=plan.metrics | {"over_extruded_mm3": float(over.sum()), "flow_error_max": 0.42},
    )
    scene = plan_scene(plan, [])
    channel = next(channel for channel in scene["lines"]["channels"] if channel["key"] == "surplus")
    slowest = t.speed[t.deposit].min()
    assert channel["bad"] == "high" and channel["max"] == pytest.approx(100 * (1 - slowest / 0.040), rel=1e-6)
    assert all("too much material: 2.5 mm³" in words for words in scene["dips"]["words"])
    write_report(plan, tmp_path / "r.html")
    words = visible(tmp_path / "r.html")
    assert f"{over.sum():.2f} mm³" in words
    assert "42.00 %" in words
    print_summary(plan, tmp_path)
    out = " ".join(capsys.readouterr().out.split())
    assert "flow per millimetre │ 42.00" in out and f"too much material in dips │ {over.sum():.2f}" in out
    assert all(channel["key"] != "surplus" for channel in plan_scene(make_plan(4_000), [])["lines"]["channels"])


# ---- the words ---------------------------------------------------------------------------------------------------


def test_verdict_in_words(tmp_path: Path) -> None:
    write_report(make_plan(4_000), tmp_path / "good.html")
    write_report(make_plan(4_000, ok=False), tmp_path / "bad.html")
    good, bad = visible(tmp_path / "good.html"), visible(tmp_path / "bad.html")
    assert "✓ Verified: this motion can be printed All 7 independent checks" in good
    assert "Not verified" not in good and "fails" not in good
    assert (
        "✗ Not verified: do not print this 1 of 7 checks fails, so no robot code was written: joint jerk : 1.31 ratio"
        in bad
    )
    assert "A joint jerk joint_6, joint_4 at t 7.2 s ✗ 131.0 % ≤ 100 ✗ fails ✗ 470.0" in bad


@pytest.mark.slow
@given(st.lists(st.booleans(), min_size=7, max_size=7))
def test_the_banner_says_printable_only_if_every_check_holds(holds: list[bool]) -> None:
    plan = make_plan(2_000)
    checks = tuple(dataclasses.replace(check, ok=ok) for check, ok in zip(plan.checks, holds, strict=True))
    plan = dataclasses.replace(plan, checks=checks)
    banner = _header(plan)
    assert ("can be printed" in banner) == ("Verified:" in banner) == all(holds) == plan.verified
    assert ("do not print" in banner) == (not all(holds))


def test_deposition_time_stands_beside_both_bounds(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    plan = with_dips(make_plan(4_000))
    m = plan.metrics
    over = [m["deposition_time_s"] / m[f"{best}_deposition_time_s"] for best in ("ideal", "bound")]
    assert over[1] == pytest.approx(1 / 0.98)
    write_report(plan, tmp_path / "r.html")
    words = visible(tmp_path / "r.html")
    for ratio in over:
        assert f"{ratio:.3f} ×" in words
    print_summary(plan, tmp_path)
    out = " ".join(capsys.readouterr().out.split())
    assert f"deposition over that without dips │ {over[0]:.3f}" in out
    assert f"deposition over that without jerk limits │ {over[1]:.3f}" in out
    worst = max(plan.dips, key=lambda dip: dip.lost)
    assert f"{len(plan.dips)} dips cost" in out and f"the costliest: bead {worst.bead}, layer {worst.layer + 1}" in out
    assert "joint_4 jerk" in out and "process.speed_mm_s" not in out
    assert with_ratios({"deposition_time_s": 3.0, "bound_deposition_time_s": 0.0}) == {
        "deposition_time_s": 3.0,
        "bound_deposition_time_s": 0.0,
    }


# ---- the list of what is judged ------------------------------------------------------------------------------------


def test_a_figure_has_one_row_and_one_name() -> None:
    plan = with_dips(make_plan(8_000))
    found = judged(plan)
    names = [row.name for row in found.rows if not row.name.startswith("dip: ")]
    assert len(names) == len(set(names))
    assert len(found.headlines) <= len(HEADLINES) == 7
    assert [row.name for row in found.headlines[:4]] == [
        "length at commanded speed (±2 %)",
        "slowest in deposition",
        "print time",
        "joint jerk",
    ]
    assert [row.name for row in found.tight[:DEAREST]] == ["dip: joint_4 jerk"] * DEAREST
    margins = [row.share for row in found.tight[DEAREST:]]
    assert margins == sorted(margins, reverse=True)
    folded = [row for _, rows in found.rest for row in rows]
    assert {"joint velocity", "deposition time", "filament"} & {row.name for row in folded}
    assert all(row.place is None or not row.place.letter for row in folded)
    letters = [place.letter for place in found.places if place.letter]
    assert letters == [chr(ord("A") + k) for k in range(len(letters))] and len(letters) >= 6
    assert [row.key for row in found.rows if row.place is not None] == list(range(len(found.places)))


def test_every_place_has_letters_of_its_own() -> None:
    letters = [places.letter(k) for k in range(800)]
    assert letters[25:28] == ["Z", "AA", "AB"] and letters[702] == "AAA" and len(set(letters)) == 800


def test_a_solved_plans_figures_each_have_one_row() -> None:
    """No two rows tell one value of one check or metric; checks and metrics of the plan are all there."""
    plan = small_plan()
    rows = list(judged(plan).rows)
    names = [row.name for row in rows]
    assert {check.name for check in plan.checks} <= set(names)
    assert "least clearance" not in names and names.count("nozzle clear of part and print") == 1
    labels = {metric.key: metric.label for metric in METRICS}
    assert {label for key, label in labels.items() if key in plan.metrics} - set(names) == {"least clearance"}
    by_name = {row.name: row for row in rows}
    jerk = by_name["joint jerk"]
    assert (
        jerk.value == f"{100 * plan.metrics['jerk_ratio_max']:.1f}"
        and jerk.where.split(", ")[0] in plan.cell.joint_names
    )


def test_every_metric_and_check_stands_in_one_group() -> None:
    grouped = [name for names in GROUPS.values() for name in names]
    assert len(grouped) == len(set(grouped))
    assert set(grouped) == {metric.label for metric in METRICS} | set(CHECKS)
    assert set(grouped) >= MARGINS | {name for names in HEADLINES for name in names}


def test_what_fails_comes_first_and_is_no_headline() -> None:
    found = judged(make_plan(4_000, ok=False))
    (row,) = found.failed
    assert row.name == "joint jerk" and row.place is not None and (row.place.letter, row.place.kind) == ("A", "fail")
    assert row.name not in [each.name for each in (*found.headlines, *found.tight)]
    assert found.places[0] == row.place and "joint acceleration" in [each.name for each in found.headlines]


def test_the_other_strategy_stands_beside_and_the_better_one_is_marked() -> None:
    rows = {row.name: row for row in judged(make_plan(4_000)).rows}
    at_speed, jerk = rows["length at commanded speed (±2 %)"], rows["joint jerk"]
    assert at_speed.better and at_speed.rivals == (("81.00", False, False),)
    assert jerk.better and jerk.rivals == (("470.0", True, False),) and jerk.limit == "≤\u2009100"
    assert jerk.share == pytest.approx(0.99) and rows["singularity margin"].better


def test_the_strategy_is_not_repeated_as_its_own_baseline(tmp_path: Path) -> None:
    plan = make_plan(4_000)
    plan = dataclasses.replace(plan, baseline={"ladder": plan.metrics})
    assert all(row.rivals == () for row in judged(plan).rows)


def test_terminal_and_page_have_the_same_names(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    plan = make_plan(4_000)
    print_summary(plan, tmp_path)
    lines = [line.split("│")[1].strip() for line in capsys.readouterr().out.splitlines() if line.startswith("│")]
    assert len(lines) > 8 and set(lines) <= {row.name for row in judged(plan).rows}


@pytest.mark.parametrize(
    ("value", "digits", "text"),
    [(1234567.0, 0, "1\u202f234\u202f567"), (-0.25, 2, "−0.25"), (None, 1, "–"), (float("nan"), 1, "–"),
     (2e-7, 3, "<\u20090.001"), (0.0, 3, "0.000"), (float("inf"), 1, "∞")],
)  # fmt: skip
def test_numbers_as_people_read_them(value: float | None, digits: int, text: str) -> None:
    assert number(value, digits) == text


@pytest.mark.parametrize(
    ("value", "text"),
    [(12345.6, "12346"), (99999.7, "100000"), (-20000.0, "−20000"), (1234.56, "1235"), (0.012346, "0.01235"),
     (2e-7, "2e−07"), (3e8, "3e+08"), (float("inf"), "∞")],
)  # fmt: skip
def test_significant_digits_have_no_needless_exponent(value: float, text: str) -> None:
    assert significant(value) == text


def test_much_material_is_told_without_exponents() -> None:
    events = (
        Event("cool", 0, 0.0, 12345.0, 0.0),
        Event("retract", 0, 0.0, 1.0, -12.0),
        Event("purge", -1, 0.0, 1.0, 15.5),
    )
    told = "1 x cool (12345 s); 1 x retract (1 s, -12000 mm); 1 x purge (1 s, +15500 mm)"
    assert events_words(events) == f"extruder, apart from laying down: {told}"
    plan = extruder_plan(motor="on_off")
    plan.metrics["over_extruded_mm3"] = 1234.56
    assert "1\u202f234.56 mm³ in all" in flow_note(plan)


@pytest.mark.parametrize(
    ("seconds", "text"), [(42.14, "42.1 s"), (185.2, "3 min 05 s"), (7439.0, "2 h 04 min"), (float("nan"), "–")]
)
def test_durations(seconds: float, text: str) -> None:
    assert duration(seconds) == text


def test_worst_places_are_the_worst() -> None:
    plan = make_plan(20_000)
    speed = plan.trajectory.speed.copy()
    speed[np.flatnonzero(plan.trajectory.bead == 6)[30]] = 0.0021
    plan = dataclasses.replace(plan, trajectory=dataclasses.replace(plan.trajectory, speed=speed))
    slowest = worst_samples(plan)["speed_min_mm_s"]
    assert plan.trajectory.bead[slowest.sample] == 6 and speed[slowest.sample] == 0.0021


def test_joints_are_told_for_the_whole_motion_as_the_metrics_are() -> None:
    plan = make_plan(20_000)
    travel = int(np.flatnonzero(~plan.trajectory.deposit)[40])
    margin, jerk = plan.series["limit_margin_deg"].copy(), plan.series["jerk_ratio"].copy()
    margin[travel], jerk[travel] = 0.5, 1.5
    plan = dataclasses.replace(plan, series={**plan.series, "limit_margin_deg": margin, "jerk_ratio": jerk})
    found = worst_samples(plan)
    assert found["joint_limit_margin_deg"].sample == found["jerk_ratio_max"].sample == travel
    busiest = np.abs(np.diff(plan.q[travel - 2 : travel + 3], 3, axis=0)).max(axis=0).argmax()
    assert found["jerk_ratio_max"].joint == plan.cell.joint_names[busiest]
    assert found["jerk_ratio_max"].help == places.IN_TRAVEL


def test_of_end_stops_the_joint_is_one_that_turns() -> None:
    plan = make_plan(20_000)
    worst = worst_samples(plan)["joint_limit_margin_deg"]
    limits = plan.cell.limits
    limits.q_max[3], limits.turns[3] = plan.q[worst.sample, 3] + 1e-3, False  # a rail, a millimetre from its end
    assert worst.joint != "joint_4" and worst_samples(plan)["joint_limit_margin_deg"] == worst


def test_ranges_of_joints_have_their_units(tmp_path: Path) -> None:
    plan = make_plan(4_000)
    limits = plan.cell.limits
    limits.q_min[0], limits.q_max[0], limits.sliding = 0.0, 3.0, (0,)
    write_report(plan, tmp_path / "r.html")
    words = visible(tmp_path / "r.html")
    assert "joint used allowed least margin joint_1 " in words
    assert re.search(r"joint_1 −?[\d.]+ to −?[\d.]+ mm 0 to 3.?000 mm −?[\d.]+ mm joint_2 ", words)
    assert re.search(r"joint_2 −?[\d.]+ to −?[\d.]+° −90 to 110° −?[\d.]+° joint_3 ", words)


def test_how_to_make_it_again(tmp_path: Path) -> None:
    plan = dataclasses.replace(make_plan(4_000), settings={"overrides": ["process.speed_mm_s=25"]})
    write_report(plan, tmp_path / "r.html")
    assert "planner.solve cylinder_stars.yaml --strategy ladder --set process.speed_mm_s=25" in visible(
        tmp_path / "r.html"
    )


def test_how_to_make_a_resumed_print_again() -> None:
    plan = make_plan(4_000)
    plan = dataclasses.replace(plan, trajectory=dataclasses.replace(plan.trajectory, first_bead=3))
    assert _command(plan).endswith("planner.solve cylinder_stars.yaml --strategy ladder --from-bead 3")


def test_what_only_python_can_make_again_is_told_in_place_of_a_command(tmp_path: Path) -> None:
    plan = dataclasses.replace(make_plan(4_000), strategy="mine", settings={"terms": ["keep_away"]})
    plan.problem.from_arrays = True
    write_report(plan, tmp_path / "r.html")
    words = visible(tmp_path / "r.html")
    assert "made in Python, with waypoints from arrays, strategy mine, term keep_away; no command" in words
    assert "planner.solve" not in words


def test_advice_names_keys_that_exist() -> None:
    def known(model: type, keys: list[str]) -> bool:
        field = next((each for each in described(model).values() if each.key == keys[0]), None)
        return field is not None and (len(keys) == 1 or any(known(each, keys[1:]) for each in field.sections))

    words = " ".join(str(value) for name, value in vars(places).items() if name.isupper())
    keys = re.findall(r"\b(?:cell|part|layers|process|resolve|collision)\.[a-z_.]+[a-z]", words)
    assert len(keys) >= 6
    assert [key for key in keys if not known(Problem, key.split("."))] == []


@pytest.mark.parametrize(
    ("key", "value", "shown"),
    [
        ("arm_clearance_min_mm", 50.0, "≥\u200950.0"),
        ("clearance_min_mm", 49.9, "49.9"),
        ("tip_clearance_min_mm", 60.0, "60.0"),
        ("extruded_mm", 82.0, "82.0"),
    ],
)
def test_a_distance_that_was_not_looked_beyond_is_a_bound(key: str, value: float, shown: str) -> None:
    assert distance(key, value, 1) == shown
    assert FARTHEST == FAR * 1e3


def test_names_from_files_cannot_become_markup(tmp_path: Path) -> None:
    plan = dataclasses.replace(
        make_plan(4_000, name=EVIL, joint=EVIL),
        strategy=EVIL,
        settings={EVIL: EVIL},
        versions={EVIL: EVIL},
        baseline={EVIL + "2": {"print_time_s": 3.0}},
    )
    plan = with_dips(plan, joint=EVIL)
    checks = tuple(dataclasses.replace(check, name=EVIL, unit=EVIL, where=EVIL, ok=False) for check in plan.checks)
    plan = dataclasses.replace(plan, checks=checks)
    write_report(plan, tmp_path / "r.html")
    beads = make_beads(2)
    beads[0].name = EVIL
    write_failure_report(
        tmp_path / "f.html",
        problem=plan.problem,
        strategy=EVIL,
        message=EVIL,
        toolpath=SimpleNamespace(beads=beads, shape=None),
        bead=0,
        point_mm=None,
        facts={EVIL: EVIL},
    )
    for name in ("r.html", "f.html"):
        text = own_text(tmp_path / name)
        assert "<script>alert" not in text and "<img" not in text
        assert "&lt;img src=x onerror=alert(2)&gt;" in text
        assert text.count("</script>") == (4 if name == "r.html" else 3), "libraries, the data and the page's own"


def test_a_plan_on_a_bed_with_nothing_optional(tmp_path: Path) -> None:
    plan = make_plan(4_000)
    problem = SimpleNamespace(**vars(plan.problem))
    toolpath = SimpleNamespace(**vars(plan.toolpath) | {"shape": None})
    cell = SimpleNamespace(**vars(plan.cell))
    cell.holder_robot = None
    plan = dataclasses.replace(
        plan, problem=problem, toolpath=toolpath, cell=cell, series={}, baseline={}, metrics={}, versions={}
    )
    write_report(plan, tmp_path / "r.html")
    assert "Verified" in visible(tmp_path / "r.html")
    scene = figures(tmp_path / "r.html")["scene"]
    assert scene["part"] is None and scene["cell"] is None


def test_nowhere_to_write(tmp_path: Path) -> None:
    with pytest.raises(OutputError, match="cannot write"):
        write_report(make_plan(2_000), tmp_path / "missing" / "report.html")


# ---- a refusal ---------------------------------------------------------------------------------------------------


def test_failure_report_says_why_where_and_what_to_change(tmp_path: Path) -> None:
    beads = make_beads(6)
    place = tuple(beads[3].points[57] * 1e3)
    write_failure_report(
        tmp_path / "f.html",
        problem=make_problem(),
        strategy="ladder",
        message="out of reach by 41.3 mm",
        toolpath=SimpleNamespace(beads=beads, shape=SHAPE),
        bead=3,
        point_mm=place,
        facts={"missing": "41.3 mm", "what to change": "Move it."},
    )
    words = visible(tmp_path / "f.html")
    assert (
        words.index("out of reach by 41.3 mm") < words.index("3 of 6 (ring 3), layer 1") < words.index("What to change")
    )
    assert "Move it." in words and "cell.positioner.origin_mm" in words
    scene = figures(tmp_path / "f.html")["scene"]
    (mark,) = scene["places"]
    assert mark["point"] == pytest.approx([v * 1e-3 for v in place], abs=1e-6)
    assert mark["normal"] == pytest.approx(beads[3].normals[57], abs=1e-4)
    assert mark["where"].startswith("bead 3, layer 1; x ") and mark["help"] == "Would help: Move it."
    others, red = (points(lines) for lines in scene["still"])
    assert red[:, 2] == pytest.approx(0.026) and 0.026 not in others[:, 2].round(6).tolist()
    assert len(others) == 5 * 200 and scene["cell"] is None and scene["lines"] is None


@pytest.mark.parametrize(
    ("positioner", "key"),
    [(None, "cell.bed_mm"), (SimpleNamespace(base=np.zeros(3)), "cell.positioner.base_mm")],
    ids=("bed", "base"),
)
def test_a_refusal_names_the_keys_that_the_problem_has(tmp_path: Path, positioner: Any, key: str) -> None:
    problem = make_problem()
    problem.cell = SimpleNamespace(positioner=positioner)
    nothing: dict[str, Any] = {"toolpath": None, "bead": None, "point_mm": None, "facts": {}}
    write_failure_report(tmp_path / "f.html", problem=problem, strategy="ladder", message="no", **nothing)
    words = visible(tmp_path / "f.html")
    assert key in words and "origin_mm" not in words
    assert ("cell.positioner.free" in words) == (positioner is not None)


def test_failure_report_without_any_bead(tmp_path: Path) -> None:
    write_failure_report(
        tmp_path / "f.html",
        problem=make_problem(),
        strategy="ladder",
        message="no",
        toolpath=None,
        bead=None,
        point_mm=None,
        facts={},
    )
    assert figures(tmp_path / "f.html")["scene"] is None
    assert "No plan: this cannot be printed" in visible(tmp_path / "f.html")


# ---- what may help where a check fails ---------------------------------------------------------------------------

FAILING = {
    "beads cross nowhere": Check("beads cross nowhere", 1.0, 0.0, "places", False, "first at t 2 s", sample=500),
    "flow per millimetre": Check(
        "flow per millimetre", 0.4, 0.1, "of what a millimetre holds", False, "bead 3, 2.0 mm"
    ),
    "steering radius of the fibre": Check("steering radius of the fibre", 4.0, 20.0, "mm", False, "bead 1", least=True),
}
LONG_LAG = ("process.extruder.lag_s=0.1",)
NOW = ("layers.source.path=greedy",)
REMEDIED = [  # check, problem, changes of it, what the remedy names, each with a value that the problem takes
    ("beads cross nowhere", "curved_plate", NOW, ["layers.source.path=rows", "layers.source.path=tour"]),
    ("beads cross nowhere", "curved_plate", NOW, ["layers.source.direction=v", "layers.source.spacing_mm=20"]),
    ("beads cross nowhere", "curved_plate", NOW, ["process.crossings=told"]),
    ("beads cross nowhere", "cylinder_logo", ("process.crossings=refused",), ["process.crossings=told"]),
    ("flow per millimetre", "naca0015_wing", ("layers.passes=joined",), ["layers.passes=apart"]),
    ("flow per millimetre", "naca0015_wing", (), ["process.speed_mm_s=20", "process.corner_tolerance_mm=0.3"]),
    ("flow per millimetre", "naca0015_wing", (), ["process.extruder.motor=e_axis"]),
    ("flow per millimetre", "naca0015_wing", (), ["process.extruder.flow_tolerance=0.2"]),
    ("flow per millimetre", "peer_cap", LONG_LAG, ["process.extruder.lag_s=0.02", "process.speed_mm_s=20"]),
    ("steering radius of the fibre", "fibre_bowl", (), ["process.fibre.least_radius_mm=3"]),
]


@pytest.mark.parametrize(("check", "name", "changes", "named"), REMEDIED)
def test_a_failed_check_is_told_what_to_change(
    check: str,
    name: str,
    changes: Sequence[str],
    named: Sequence[str],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    problem = load_problem(name, changes)
    plan = dataclasses.replace(make_plan(4_000), problem=problem, checks=(FAILING[check],))
    advice = check_advice(check, plan, FAILING[check].sample)
    for setting in named:
        key, _, value = setting.partition("=")
        assert key in advice
        assert not value.isalpha() or value in advice
        problem.changed([setting])  # which the problem takes
    assert advice in unescape(_header(plan))
    one_material = problem.model_copy(update={"process": problem.process.model_copy(update={"materials": {}})})
    print_summary(dataclasses.replace(plan, problem=one_material), tmp_path)
    out = " ".join(capsys.readouterr().out.split())
    assert f"FAILED {FAILING[check].words} what may help: {advice}" in out


def test_zig_zags_that_are_apart_are_not_told_to_be() -> None:
    apart = dataclasses.replace(make_plan(2_000), problem=load_problem("naca0015_wing"))
    assert "layers.passes" not in check_advice("flow per millimetre", apart, -1)


@pytest.mark.parametrize(("count", "words"), [(1, "1 place, limit 0 (first"), (2, "2 places, limit 0 (first")])
def test_one_is_told_in_the_singular(count: int, words: str, tmp_path: Path) -> None:
    check = dataclasses.replace(FAILING["beads cross nowhere"], worst=float(count))
    assert f"beads cross nowhere: {words}" in check.words
    plan = dataclasses.replace(
        make_plan(2_000), problem=load_problem("curved_plate"), checks=(check, *make_plan(2_000).checks)
    )
    spoken = " ".join(re.sub("<[^>]+>", " ", _header(plan)).split())
    assert f"beads cross nowhere : {count} place{'s' if count > 1 else ''}, limit 0 places;" in spoken
    assert "1 of 8 checks fails," in spoken
