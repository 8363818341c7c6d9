"""Several materials in one print: their names and tools in the problem, their changes in the motion, in what is checked
and in what is written."""

from __future__ import annotations

import json
import tempfile
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from export_fixtures import make_plan, with_board
from solved import small_plan, small_problem, solve_alone, write_small

import planner.export
import planner.planning.pipeline
from planner.base.errors import InputError
from planner.export.extruder import FILE, differences, gcode, read_gcode
from planner.export.plan_json import plan_json
from planner.export.rapid.reader import read_rapid
from planner.export.rapid.writer import rapid
from planner.export.readback import compare
from planner.export.write import ProgramDiffers, write_robot_code
from planner.motion.extrusion import feed_of_materials
from planner.plan import Event, Plan
from planner.plan.plan import materials_of, selected, used
from planner.planning.files import write, write_files
from planner.planning.solve_command import main
from planner.problem import Problem, load_problem
from planner.problem.layers import KINDS
from planner.report.summary import print_summary
from planner.toolpath.bead import Toolpath
from planner.toolpath.build import build_toolpath
from planner.verify.material import _as_named
from planner.verify.verdict import verify

MM = 1e-3
ORDER = ("pla", "pva", "pva")  # of the small print's beads
TWO = (
    "  travel_speed_mm_s: 200\n",
    """\
  travel_speed_mm_s: 200
  retract: {length_mm: 1}
  materials:
    pla: {}
    pva: {filament_diameter_mm: 2.85, nozzle_c: 190, prime: {length_mm: 2}}
  change: {wait_s: 2, purge_mm: 5}
""",
)
FED, REST = "material fed by its own tool", "rest for a change of material"
ASKED = "primes, retracts and cuts as asked"


def gcode_differences(plan: Plan, text: str) -> list[str]:
    """What the extruder's program says otherwise than its plan."""
    return differences(plan, {FILE: text})


def problem_of(*changes: tuple[str, str]) -> Problem:
    with tempfile.TemporaryDirectory() as folder:
        return load_problem(write_small(Path(folder), TWO, *changes))


@cache
def two_materials(order: tuple[str, ...] = ORDER, *changes: tuple[str, str]) -> Plan:
    """The small print, its beads of these materials, solved once: the first bead of one, the others of another."""
    build = planner.planning.pipeline.build_toolpath

    def mixed(problem: Problem) -> Toolpath:
        toolpath = build(problem)
        beads = zip(toolpath.beads, order, strict=True)
        return replace(toolpath, beads=tuple(replace(bead, material=material) for bead, material in beads))

    with tempfile.TemporaryDirectory() as folder, pytest.MonkeyPatch.context() as patch:
        patch.setattr(planner.planning.pipeline, "build_toolpath", mixed)
        return solve_alone(load_problem(write_small(Path(folder), TWO, *changes)))


def failed(plan: Plan) -> set[str]:
    """Names of the checks that fail."""
    checks = verify(plan.problem, plan.cell, plan.toolpath, plan.trajectory).checks
    return {check.name for check in checks if not check.ok}


def with_events(plan: Plan, change: Callable[[Event], Event | None]) -> Plan:
    """The plan with each event exchanged for another or, if that is None, left out; the filament stays as it is."""
    events = [change(event) for event in plan.trajectory.events]
    told = tuple(event for event in events if event is not None)
    return replace(plan, trajectory=replace(plan.trajectory, events=told))


# --- the problem file --------------------------------------------------------------------------------------


def test_a_problem_without_materials_has_one_without_a_name() -> None:
    problem = small_problem()
    assert materials_of(problem) == ()
    assert problem.process.of("") is problem.process
    assert {bead.material for bead in build_toolpath(problem).beads} == {""}


def test_what_a_material_does_not_say_is_the_process_own() -> None:
    problem = problem_of(("    pla: {}\n", "    pla: {tool: 7, extruder_signal: doPart}\n"))
    pla, pva = materials_of(problem)
    assert (pla.tool, pla.signal, pla.nozzle_c) == (7, "doPart", None)
    assert (pva.tool, pva.signal, pva.nozzle_c) == (1, "doExtrude1", 190.0)
    own = problem.process.of("pla")
    assert (own.filament_diameter, own.prime.length, own.retract.length) == pytest.approx((1.75 * MM, 0.0, 1.0 * MM))
    own = problem.process.of("pva")
    assert (own.filament_diameter, own.prime.length, own.retract.length) == pytest.approx((2.85 * MM, 2 * MM, 1.0 * MM))


@pytest.mark.parametrize(
    ("change", "material"), [((), "pla"), ((("  count: 1", "  material: pva\n  count: 1"),), "pva")]
)
def test_layers_name_their_material_or_take_the_first(change: tuple[tuple[str, str], ...], material: str) -> None:
    with tempfile.TemporaryDirectory() as folder:
        toolpath = build_toolpath(load_problem(write_small(Path(folder), TWO, *change)))
    assert {bead.material for bead in toolpath.beads} == {material}


@pytest.mark.slow
@pytest.mark.parametrize(("own", "expected"), [("pva", "pva"), (None, "pla")])
def test_a_wing_and_its_support_are_of_two_materials(own: str | None, expected: str) -> None:
    changes = [
        "layers.source.span_mm=2",
        "process.materials={pva: {nozzle: tBlack}, pla: {nozzle: tYellow}}",
        "layers.material=pla",
    ]
    support = "{length_mm: 110, height_mm: 2, curved: 1" + (f", material: {own}" if own else "") + "}"
    toolpath = build_toolpath(load_problem("naca0015_wing", [*changes, f"layers.support={support}"]))
    found = {bead.name.split()[0]: bead.material for bead in toolpath.beads}
    assert found == {"support": expected, "layer": "pla"}


@pytest.mark.parametrize(
    ("old", "new", "field", "reason", "hint"),
    [
        (
            "  count: 1",
            "  material: plb\n  count: 1",
            "layers.material",
            "'plb'",
            "did you mean pla? choices: pla, pva",
        ),
        (
            "    pla: {}",
            "    pla: {tool: 1}",
            "process.materials",
            "tool 1 feeds both pla and pva",
            "a tool of its own",
        ),
        ("    pla: {}", "    pla: {tool: 100}", "process.materials.pla.tool", "100 is too large", "0 to 99"),
        ("    pla: {}", "    pla: {tol: 1}", "process.materials.pla.tol", "unknown key", "did you mean tool?"),
        ("    pla: {}", "    pla: 195", "process.materials.pla", "must be a section", "its keys: tool"),
        ("    pla: {}", "    if: {}", "process.materials.if", "'if' is a reserved word of RAPID", "my_if"),
        (
            "    pla: {}",
            "    pla: {extruder_signal: DOEXTRUDE1}",
            "process.materials.pva.extruder_signal",
            "already the name of pla",
            "its own",
        ),
        (
            "    pla: {}",
            "    pla: {extruder_signal: tPen}",
            "process.materials.pla.extruder_signal",
            "already the name of program.tool",
            "",
        ),
        ("wait_s: 2", "wait_s: 0", "process.change.wait_s", "0 s is too small", "0.1 to 3600"),
    ],
)
def test_mistakes_are_told_with_their_place(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], old: str, new: str, field: str, reason: str, hint: str
) -> None:
    file = write_small(tmp_path, TWO)
    file.write_text(file.read_text(encoding="utf-8").replace(old, new), encoding="utf-8")
    with pytest.raises(InputError) as caught:
        load_problem(file)
    error = caught.value
    assert (error.field or "").startswith(field) and reason in error.reason and hint in (error.hint or "")
    assert error.line is not None and error.file == file
    out = tmp_path / "out"
    assert main([str(file), "--out", str(out), "--quiet"]) == 2
    assert "Traceback" not in capsys.readouterr().err and not out.exists()


def test_a_material_where_there_are_none() -> None:
    with tempfile.TemporaryDirectory() as folder:
        file = write_small(Path(folder), ("  count: 1", "  material: pla\n  count: 1"))
        with pytest.raises(InputError) as caught:
            load_problem(file)
    assert caught.value.field == "layers.material" and "give process.materials" in (caught.value.hint or "")


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        (["process.bead.section=fibre", "process.materials={pla: {}}"], "fibre and several materials"),
        (
            ["process.extruder.motor=on_off", "process.materials={pla: {retract: {length_mm: 1}}}"],
            "cannot pull filament of pla back",
        ),
    ],
)
def test_what_materials_do_not_go_together_with(tmp_path: Path, changes: list[str], reason: str) -> None:
    file = write_small(tmp_path)
    with pytest.raises(InputError) as caught:
        load_problem(file, changes)
    assert reason in caught.value.reason


# --- the motion --------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_two_materials_are_verified_and_the_robot_rests_at_home_for_the_change() -> None:
    plan = two_materials()
    assert plan.verified, [check for check in plan.checks if not check.ok]
    assert {FED, REST} <= {check.name for check in plan.checks}
    t = plan.trajectory
    (change,) = (event for event in t.events if event.kind == "change")
    assert (change.bead, change.duration, change.material) == (1, 2.0, "pva")
    during = (t.t > change.start + t.dt) & (t.t < change.start + 2.0 + 1.0 - t.dt)  # 5 mm of purge at 5 mm/s
    assert during.sum() > 700
    home = plan.cell.home[: len(plan.cell.arm)]
    np.testing.assert_allclose(t.q[during][:, : len(home)], np.tile(home, (during.sum(), 1)), atol=1e-9)


@pytest.mark.slow
def test_the_events_come_in_order_each_with_its_material() -> None:
    found = [(event.kind, event.bead, event.material) for event in two_materials().trajectory.events]
    assert found == [
        ("heat", -1, "pla"),
        ("select", -1, "pla"),
        ("retract", 0, "pla"),
        ("change", 1, "pva"),
        ("purge", 1, "pva"),
        ("prime", 1, "pva"),
        ("retract", 1, "pva"),
        ("prime", 2, "pva"),
        ("retract", 2, "pva"),
    ]


@pytest.mark.slow
def test_a_pause_before_a_change_purges_the_material_before() -> None:
    change = "  change: {wait_s: 2, purge_mm: 5}\n"
    pause = "  pauses: [{before_layer: 2, wait_s: 5, purge_mm: 20}]\n"
    plan = two_materials(("pla",) * 3 + ("pva",) * 3, ("  count: 1\n", "  count: 2\n"), (change, change + pause))
    assert plan.verified, [check for check in plan.checks if not check.ok]
    found = [(event.kind, event.material) for event in plan.trajectory.events if event.bead == 3]
    assert found == [
        ("pause", ""),
        ("purge", "pla"),
        ("change", "pva"),
        ("purge", "pva"),
        ("prime", "pva"),
        ("retract", "pva"),
    ]
    assert FED in failed(with_events(plan, lambda e: replace(e, material="pva") if e.amount == 20 * MM else e))
    assert FED in failed(with_events(plan, lambda e: replace(e, material="pla") if e.kind == "prime" else e))
    assert gcode_differences(plan, gcode(plan)) == []


def test_each_material_takes_what_its_beads_hold_and_what_is_pushed_of_it() -> None:
    plan = two_materials()
    pla, pva = used(plan)
    first, second, third = (0.6 * 0.5 * bead.length / MM for bead in plan.toolpath.beads)
    assert (pla.beads, pva.beads) == (1, 2)
    assert (pla.volume * 1e9, pva.volume * 1e9) == pytest.approx((first, second + third), rel=1e-6)
    assert pla.filament / MM == pytest.approx(first / (np.pi * 0.875**2) - 1.0, rel=1e-6)
    assert pva.filament / MM == pytest.approx((second + third) / (np.pi * 1.425**2) + 5.0 + 2 * (2.0 - 1.0), rel=1e-6)
    assert plan.metrics["extruded_mm"] == pytest.approx((pla.filament + pva.filament) / MM, rel=1e-9)


def test_the_tool_that_is_selected_follows_the_events() -> None:
    events = [Event("select", -1, 1.0, 0.0, 0.0, "a"), Event("change", 1, 3.0, 2.0, 0.0, "b")]
    found = selected(["b", "a"], events, np.array([0.5, 1.0, 2.9, 3.0, 9.0]))
    np.testing.assert_array_equal(found, [-1, 1, 1, 0, 0])


@pytest.mark.slow
def test_motion_handed_over_without_rests_stops_for_a_change_too() -> None:
    plan = two_materials()
    problem = plan.problem.model_copy(
        update={"process": plan.problem.process.model_copy(update={"hand_over": "motion"})}
    )
    toolpath = plan.toolpath
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(planner.planning.pipeline, "build_toolpath", lambda _: toolpath)
        other = solve_alone(problem)
    assert other.verified, [check for check in other.checks if not check.ok]
    assert sum(event.kind == "change" for event in other.trajectory.events) == 1


# --- what is checked ---------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_bead_that_another_tool_feeds() -> None:
    plan = two_materials()
    assert failed(plan) == set()
    never = with_events(plan, lambda event: None if event.kind == "change" else event)
    assert {FED, REST} <= failed(never)
    wrong = with_events(plan, lambda event: replace(event, material="pla") if event.kind == "change" else event)
    assert {FED, REST} <= failed(wrong)
    unknown = with_events(plan, lambda event: replace(event, material="abs") if event.kind == "change" else event)
    assert {FED, REST} <= failed(unknown)
    none = with_events(plan, lambda event: None if event.kind == "select" else event)
    assert FED in failed(none)
    late = with_events(plan, lambda event: replace(event, start=event.start + 9.0) if event.kind == "change" else event)
    assert {FED, REST} <= failed(late)


def test_a_prime_of_another_material() -> None:
    plan = two_materials()
    wrong = with_events(plan, lambda event: replace(event, material="pla") if event.kind == "prime" else event)
    assert failed(wrong) == {FED}


@pytest.mark.slow(keep=1)
@pytest.mark.parametrize("share", [0.0, 0.9])
def test_a_change_that_is_given_less_time_than_it_takes(share: float) -> None:
    plan = two_materials()
    t = plan.trajectory
    short = with_events(plan, lambda e: replace(e, duration=share * e.duration) if e.kind == "change" else e)
    assert failed(short) == {REST, ASKED}  # which the purge no longer follows
    (change,) = (event for event in t.events if event.kind == "change")
    q = t.q.copy()
    moving = (t.t > change.start + share * 2.0) & (t.t < change.start + 2.0)
    q[moving, 5] += 1e-7 * (np.arange(len(t)) % 2)[moving]
    assert REST in failed(replace(plan, trajectory=replace(t, q=q)))


@pytest.mark.parametrize(
    ("name", "part", "rest"),
    [
        ("naca0015_wing", ("support 2", "yellow_pla"), ("layer 9", "black_pla")),
        ("saddle_ring", ("layer 1 infill 2", "core"), ("layer 1 wall 1", "shell")),
    ],
)
def test_beads_of_another_material_than_the_layers_name(
    name: str, part: tuple[str, str], rest: tuple[str, str]
) -> None:
    problem = load_problem(name)

    def wrong(*beads: tuple[str, str]) -> list[float]:
        made = [SimpleNamespace(name=called, material=material, layer=0) for called, material in beads]
        judged: Any = SimpleNamespace(problem=problem, toolpath=SimpleNamespace(beads=made))
        return [check.worst for check in _as_named(judged)]

    assert wrong(part, rest) == [0.0]
    assert wrong((part[0], rest[1]), (rest[0], part[1])) == [2.0]
    assert wrong((part[0], rest[1]), rest) == [1.0]


def test_layers_that_name_no_material_ask_for_none() -> None:
    plan = two_materials()
    judged: Any = SimpleNamespace(problem=plan.problem, toolpath=plan.toolpath)
    assert not list(_as_named(judged))


def test_a_change_beside_home() -> None:
    plan = two_materials()
    t = plan.trajectory
    (change,) = (event for event in t.events if event.kind == "change")
    q = t.q.copy()
    q[(t.t >= change.start) & (t.t <= change.start + 2.0 + 1.0), 0] += 0.1
    assert REST in failed(replace(plan, trajectory=replace(t, q=q)))


def test_a_change_without_its_purge() -> None:
    plan = two_materials()
    dry = with_events(plan, lambda event: None if event.kind == "purge" else event)
    assert {REST, "filament fed"} <= failed(dry)


def test_filament_of_the_wrong_diameter() -> None:
    plan = two_materials()
    t, process = plan.trajectory, plan.problem.process
    begun = np.maximum.accumulate(np.maximum(t.bead, 0)).astype(np.int32)
    same = process.model_copy(update={"materials": {}})
    fed = feed_of_materials(same, ORDER, begun, t.t, t.bead, t.extruded, t.flow, t.events)
    assert {"filament fed", "flow per millimetre"} <= failed(replace(plan, trajectory=replace(t, feed=fed)))


# --- what is written ---------------------------------------------------------------------------------------


def test_robot_code_of_two_materials_is_written_and_read_back(tmp_path: Path) -> None:
    plan = two_materials()
    names = {path.name for path in write_robot_code(plan, tmp_path)}
    assert names == {"Small.mod", "Small.pgf", "extrusion.gcode"}
    extrusion = read_gcode((tmp_path / "extrusion.gcode").read_text())
    assert [tool for _, tool in extrusion.selections] == [0, 1]
    assert {tool: mm / MM for tool, mm in extrusion.filament.items()} == pytest.approx(
        {0: used(plan)[0].filament / MM, 1: used(plan)[1].filament / MM}, abs=1e-3
    )
    assert "M104 T1 S190\n" in (tmp_path / "extrusion.gcode").read_text()


def test_the_outputs_of_rapid_are_those_of_the_beads() -> None:
    plan = make_plan(materials=("pla", "pva"))
    text = rapid(plan)
    assert compare(plan, read_rapid(text)).differences() == []
    switched = [group[0].signal for _, group in sorted(read_rapid(text).triggers.items())]
    assert switched == ["doExtrude", "doExtrude", "doSupport", "doSupport"]
    for old, new in (("doSupport,1", "doExtrude,1"), ("trgOff2", "trgOff")):
        lines = [line.replace(old, new) if "Trig" in line else line for line in text.split("\n")]
        (difference,) = compare(plan, read_rapid("\n".join(lines))).differences()
        assert difference.startswith("output differs by 1 times")


def test_rapid_waits_at_home_for_the_change() -> None:
    text = rapid(make_plan(materials=("pla", "pva")))
    assert "! change to pva, bead 1\n        WaitTime 2.000;\n        ! purge, bead 1\n        WaitTime 1.000;" in text
    plan = make_plan(materials=("pla", "pva"))
    hasty = compare(plan, read_rapid(text.replace("WaitTime 2.000", "WaitTime 1.000"))).differences()
    assert [difference.split()[0] for difference in hasty] == ["wait"]


@pytest.mark.parametrize(
    ("old", "new", "difference"),
    [
        ("\nT0\n", "\nT1\n", "tool T0 gets"),
        ("\nT0\n", "\n", "selects tools other"),
        ("G1 E5.00000 F300.000", "G1 E5.10000 F306.000", "tool T0 gets +0.1 mm"),
        (
            "; change to pva, bead 1\nT0\nG4 P2000",
            "G4 P2000\n; change to pva, bead 1\nT0",
            "a tool is selected 2 s off",
        ),
        ("G4 P2000", "G4 P1000", "it lasts"),
    ],
)
def test_gcode_that_was_spoilt_is_told(old: str, new: str, difference: str) -> None:
    plan = with_board(make_plan(materials=("pla", "pva")), sync="free")
    text = gcode(plan)
    assert gcode_differences(plan, text) == [] and text.count(old) == 1
    assert any(difference in each for each in gcode_differences(plan, text.replace(old, new)))


def test_gcode_of_one_material_is_held_against_its_plan_too(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    plan = make_plan()
    text = gcode(plan)
    assert gcode_differences(plan, text) == []
    spoilt = text.replace("G1 E0.99770", "G1 E1.09770", 1)
    assert gcode_differences(plan, spoilt)[0] == "tool T0 gets +0.1 mm of filament"
    with pytest.raises(InputError, match="unknown line"):
        read_gcode(text + "M999\n")
    monkeypatch.setattr("planner.export.extruder.write", lambda plan: {FILE: spoilt})
    with pytest.raises(ProgramDiffers, match="the extruder's G-code does not repeat the plan"):
        write_robot_code(plan, tmp_path)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("second_process", [False, True])
def test_a_program_that_differs_leaves_the_report_and_a_failed_check(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, second_process: bool
) -> None:
    plan = small_plan()
    text = gcode(plan)
    monkeypatch.setattr("planner.export.extruder.write", lambda plan: {FILE: text.replace("G1 E", "G1 E1", 1)})
    monkeypatch.setattr("planner.planning.files.WORTH_A_FORK", 0)
    written = write_files(plan, tmp_path, second_process=second_process)
    assert not written.verified
    (check,) = (check for check in written.checks if not check.ok)
    assert (check.name, check.worst) == ("programs repeat the plan", 1.0)
    assert "does not repeat the plan" in check.where
    names = {path.name for path in tmp_path.iterdir()}
    assert {"plan.json", "report.html", "trajectory.csv"} <= names
    assert not [name for name in names if name.endswith((".mod", ".gcode"))]
    assert json.loads((tmp_path / "plan.json").read_text())["verified"] is False


def test_materials_stand_in_plan_json_report_and_summary(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    plan = write(two_materials(), tmp_path)
    told = json.loads((tmp_path / "plan.json").read_text())
    assert [(each["name"], each["tool"], each["beads"]) for each in told["materials"]] == [("pla", 0, 1), ("pva", 1, 2)]
    assert sum(each["extruded_mm"] for each in told["materials"]) == pytest.approx(told["metrics"]["extruded_mm"])
    assert told["events"][3]["kind"] == "change" and told["events"][3]["material"] == "pva"
    html = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert "<h2>Materials</h2>" in html and "<th scope=row>pva</th><td class=n>T1</td>" in html
    assert "change tools, at home" in html
    print_summary(plan, tmp_path)
    assert "material pva: tool T1, 2 beads" in capsys.readouterr().out


def test_without_names_nothing_is_said_of_materials(tmp_path: Path) -> None:
    plan = make_plan()
    assert "materials" not in json.loads(plan_json(plan))
    assert used(plan) == ()


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: str(kind.tag))
def test_every_kind_of_layers_names_its_material(kind: Any) -> None:
    """And every one that will come: `build_toolpath` asks for it."""
    assert kind.model.model_fields["material"].alias == "material"
