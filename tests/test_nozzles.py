"""Several nozzles on one arm: in the problem, the cell, the plan, what is checked, and what is written and simulated."""

from __future__ import annotations

import json
import tempfile
from collections.abc import Callable
from dataclasses import replace
from functools import cache, partial
from pathlib import Path

import numpy as np
import pytest
from simulate_fixtures import program_at
from solved import BED, solve_alone, write_small

import planner.planning.pipeline
from planner import joint_paths
from planner.base.errors import InputError
from planner.cell.cell import Cell, build_cell
from planner.cell.robot import Robot
from planner.collision.print_body import tip_room
from planner.collision.scene import HEAD, collision_bodies, obstacles_of
from planner.export.controllers import CONTROLLERS
from planner.export.forecast import forecast, joined
from planner.export.languages import LANGUAGES, check_languages
from planner.export.plan_json import plan_json
from planner.export.rapid.reader import read_rapid_files
from planner.plan import TRAVEL, Plan, Trajectory
from planner.plan.plan import by_nozzle
from planner.problem import Problem, load_problem
from planner.report.scene import plan_scene
from planner.report.wording import resumed_words
from planner.resolve.by_nozzle import nozzles_of
from planner.resolve.ladder import ladder
from planner.resolve.roll_map import roll_maps
from planner.simulate.controller import MotionsInTurn, own_clock, played_motion, read_modules
from planner.toolpath.bead import Toolpath
from planner.toolpath.task import tasks_of
from planner.verify.collision import check_start
from planner.verify.verdict import verify

NOZZLE = "  nozzle: {tip_mm: [-44.51, 9.9, 113.95], axis: [0, 0, 1], diameter_mm: 0.6}\n"
NOZZLES = """\
  nozzles:
    tPla: {tip_mm: [-44.51, 9.9, 113.95], axis: [0, 0, 1], diameter_mm: 0.6}
    tPva: {tip_mm: [44.51, 9.9, 118], axis: [0.5, 0, 1], diameter_mm: 0.4}
"""
MATERIALS = """\
  travel_speed_mm_s: 200
  materials:
    pla: {nozzle: tPla}
    pva: {nozzle: tPva}
  change: {wait_s: 2}
"""
TWO = ((NOZZLE, NOZZLES), ("  travel_speed_mm_s: 200\n", MATERIALS))
ORDER = ("pla", "pva", "pla")  # of the small print's beads
CHANGED = "nozzles changed at home"
RAPID = LANGUAGES["rapid"]


def problem_of(*changes: tuple[str, str]) -> Problem:
    with tempfile.TemporaryDirectory() as folder:
        return load_problem(write_small(Path(folder), *changes))


@cache
def two_nozzles(mounted: str = "together") -> Plan:
    """The small print, its second bead with another nozzle, solved once."""
    build = planner.planning.pipeline.build_toolpath

    def mixed(problem: Problem) -> Toolpath:
        toolpath = build(problem)
        beads = zip(toolpath.beads, ORDER, strict=True)
        return replace(toolpath, beads=tuple(replace(bead, material=material) for bead, material in beads))

    changes = (NOZZLE, f"{NOZZLES}  mounted: {mounted}\n"), TWO[1]
    with tempfile.TemporaryDirectory() as folder, pytest.MonkeyPatch.context() as patch:
        patch.setattr(planner.planning.pipeline, "build_toolpath", mixed)
        return solve_alone(load_problem(write_small(Path(folder), *changes)))


def failed(plan: Plan, trajectory: Trajectory | None = None, cell: Cell | None = None) -> set[str]:
    """Names of the checks that fail."""
    report = verify(plan.problem, cell or plan.cell, plan.toolpath, trajectory or plan.trajectory)
    return {check.name for check in report.checks if not check.ok}


# --- the problem file --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("changes", "field", "words"),
    [
        (((NOZZLE, NOZZLE + NOZZLES), TWO[1]), "cell.nozzles", "both nozzle and nozzles are given"),
        (((NOZZLE, ""),), "cell", "neither nozzle nor nozzles is given"),
        (((NOZZLE, NOZZLE + "  mounted: one\n"),), "cell.mounted", "mounted is for several nozzles"),
        (((NOZZLE, NOZZLES),), "cell.nozzles", "there are no process.materials"),
        ((*TWO, ("pva: {nozzle: tPva}", "pva: {}")), "process.materials.pva.nozzle", "choices: tPla, tPva"),
        ((*TWO, ("pva: {nozzle: tPva}", "pva: {nozzle: tPvb}")), "process.materials.pva.nozzle", "did you mean tPva"),
        ((TWO[1],), "process.materials.pla.nozzle", "there are no cell.nozzles"),
        (
            (*TWO, ("tPva: {tip", "doExtrude: {tip"), ("nozzle: tPva", "nozzle: doExtrude")),
            "process.materials",
            "already",
        ),
        ((*TWO, ("tPva: {tip", "t-Pva: {tip")), "cell.nozzles", "letter"),
    ],
)
def test_what_does_not_fit_together_is_told(changes: tuple[tuple[str, str], ...], field: str, words: str) -> None:
    with pytest.raises(InputError) as caught:
        problem_of(*changes)
    assert words in str(caught.value)
    assert str(caught.value.field).startswith(field)


@pytest.mark.parametrize(
    ("changes", "field"),
    [
        ((("tPva: {tip", "fine: {tip"), ("nozzle: tPva", "nozzle: fine")), "cell.nozzles.fine"),
        ((("tPva: {tip", "Change1: {tip"), ("nozzle: tPva", "nozzle: Change1")), "cell.nozzles.Change1"),
        ((("{nozzle: tPva}", "{nozzle: tPva, extruder_signal: z10}"),), "process.materials.pva.extruder_signal"),
    ],
)
def test_names_that_rapid_has_for_something_else_are_told(changes: tuple[tuple[str, str], ...], field: str) -> None:
    problem = problem_of(*TWO, *changes)
    cell = build_cell(problem)
    with pytest.raises(InputError, match="may be a name of the program's own") as caught:
        check_languages(problem, cell)
    assert str(caught.value.field).startswith(field)
    elsewhere = ("strategy: ladder", "strategy: ladder\nprogram:\n  languages: [joint_trajectory]")
    check_languages(problem_of(*TWO, *changes, elsewhere), cell)


def test_a_nozzle_may_be_called_as_the_one_tool_that_there_is_not() -> None:
    problem = problem_of(*TWO, ("tPva: {tip", "tPen: {tip"), ("nozzle: tPva", "nozzle: tPen"))
    assert problem.program.tool == "tPen"
    assert list(problem.cell.nozzles) == ["tPla", "tPen"]


def test_nozzles_that_touch_are_told() -> None:
    problem = problem_of(
        *TWO, ("tip_mm: [44.51, 9.9, 118], axis: [0.5, 0, 1]", "tip_mm: [-40, 9.9, 114], axis: [0, 0, 1]")
    )
    with pytest.raises(InputError, match=r"cell\.nozzles\.tPva.*touches the nozzle tPla"):
        check_start(problem, build_cell(problem))
    exchanged = problem_of(
        (NOZZLE, f"{NOZZLES}  mounted: one\n"),
        TWO[1],
        ("tip_mm: [44.51, 9.9, 118], axis: [0.5, 0, 1]", "tip_mm: [-40, 9.9, 114], axis: [0, 0, 1]"),
    )
    check_start(exchanged, build_cell(exchanged))


# --- the cell ----------------------------------------------------------------------------------------------


def test_the_cell_of_a_nozzle_has_its_tip_on_the_same_arm() -> None:
    cell = build_cell(problem_of(*TWO))
    only = NOZZLE.replace("[-44.51, 9.9, 113.95], axis: [0, 0, 1]", "[44.51, 9.9, 118], axis: [0.5, 0, 1]")
    alone = build_cell(problem_of((NOZZLE, only)))
    q = np.random.default_rng(0).uniform(-1.0, 1.0, (5, len(cell.joint_names)))
    other = cell.at("pva")
    assert cell.at("pla") is cell and other.at("pla").nozzle_name == "tPla" and other.nozzle_name == "tPva"
    assert np.allclose(other.T_part_nozzle(q), alone.T_part_nozzle(q), atol=1e-12)
    assert np.allclose(other.as_counted.at("pla").T_part_nozzle(q), cell.T_part_nozzle(q), atol=1e-12)


def test_all_nozzles_are_obstacles_where_they_are_together_and_only_the_own_one_else() -> None:
    for mounted, beside in (("together", True), ("one", False)):
        cell = build_cell(problem_of((NOZZLE, f"{NOZZLES}  mounted: {mounted}\n"), TWO[1]))
        for material, own, other in (("pla", "tPla", "tPva"), ("pva", "tPva", "tPla")):
            names = {thing.body.name for thing in collision_bodies(cell.at(material)) if thing.whose == HEAD}
            assert f"nozzle of {own}" in names
            assert (f"nozzle of {other}" in names) == beside


def test_a_search_that_keeps_the_head_clear_does_so_for_each_nozzle(tmp_path: Path) -> None:
    problem = load_problem(write_small(tmp_path, *TWO))
    cell = build_cell(problem)
    obstacles = obstacles_of(problem, cell, planner.planning.pipeline.build_toolpath(problem))
    pva = obstacles.counting_head.for_nozzle(cell, cell.at("pva"))
    assert pva.but_head_on_part is pva
    usual = obstacles.for_nozzle(cell, cell.at("pva"))
    assert len(usual.but_head_on_part.table.look) < len(usual.table.look)


@pytest.mark.slow
def test_slack_at_the_tip_is_that_of_the_nozzle_which_lays_the_bead() -> None:
    plan = two_nozzles()
    problem, toolpath = plan.problem, plan.toolpath
    each = [tip_room(problem, toolpath, problem.cell.nozzles[name]).slack for name in ("tPla", "tPva", "tPla")]
    assert np.array_equal(tip_room(problem, toolpath).slack, [own[k] for k, own in enumerate(each)])


# --- the plan ----------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("mounted", ["together", "one"])
def test_a_print_with_two_nozzles_is_verified(mounted: str) -> None:
    plan = two_nozzles(mounted)
    assert plan.verified, [check for check in plan.checks if not check.ok]
    assert CHANGED in {check.name for check in plan.checks}
    assert failed(plan) == set()


@pytest.mark.slow
def test_each_bead_is_laid_by_its_nozzle() -> None:
    plan = two_nozzles()
    t = plan.trajectory
    assert [own.nozzle_name for own, _ in by_nozzle(plan.cell, t.events, t.t)] == ["tPla", "tPva", "tPla"]
    for own, rows in by_nozzle(plan.cell, t.events, t.t):
        assert np.allclose(own.T_part_nozzle(t.q[rows])[:, :3, 3], t.tip[rows], atol=1e-9)
        laid = set(t.bead[rows].tolist()) - {TRAVEL}
        assert {plan.toolpath.beads[bead].material for bead in laid} == {"pva" if own.nozzle_name == "tPva" else "pla"}


@pytest.mark.slow
def test_a_search_for_several_nozzles_is_a_search_for_each() -> None:
    plan = two_nozzles()
    problem, cell, toolpath = plan.problem, plan.cell, plan.toolpath
    tasks, obstacles = tasks_of(problem, toolpath), obstacles_of(problem, cell, toolpath)
    paths = ladder(cell, tasks, problem.resolve, obstacles)
    for own, which in nozzles_of(cell, tasks):
        alone = ladder(own, [tasks[i] for i in which], problem.resolve, obstacles.of(own))
        for i, path in zip(which, alone, strict=True):
            assert np.array_equal(paths[i].q, path.q)
    (whole, *_) = roll_maps(cell, paths, obstacles, problem.resolve.min_sigma)
    assert np.array_equal(whole.bead, np.sort(whole.bead)) and (np.diff(whole.along) > 0.0).all()
    assert set(whole.bead.tolist()) == {0, 1, 2} and whole.free.any(axis=1).all()


def test_joint_paths_hold_each_task_with_its_own_nozzle() -> None:
    plan = two_nozzles()
    known, chosen = plan.paths, list(plan.cell.chosen)
    paths = joint_paths(
        plan.cell, [path.task for path in known], [path.roll for path in known],
        chosen=[path.q[:, chosen] for path in known], branches=[path.branch for path in known],
    )  # fmt: skip
    for path in paths:
        tip = plan.cell.at(path.task.material).T_part_nozzle(path.q)[:, :3, 3]
        assert np.abs(tip - path.task.tip).max() < 1e-9


def test_parts_of_a_motion_are_motions_of_their_own() -> None:
    plan = two_nozzles()
    parts = plan.stretches
    assert [part.first_bead for part in parts] == [0, 1, 2]
    assert sum(len(part.trajectory) for part in parts) == len(plan.trajectory)
    assert sum(len(part.trajectory.events) for part in parts) == len(plan.trajectory.events)
    for part in parts:
        assert part.trajectory.t[0] == 0.0 and part.trajectory.extruded[0] == 0.0
        for k in (0, -1):
            assert np.allclose(part.q[k, :6], plan.cell.home[:6], atol=1e-6)


# --- spoilt plans ------------------------------------------------------------------------------------------


def test_a_nozzle_that_is_changed_elsewhere() -> None:
    plan = two_nozzles()
    t = plan.trajectory
    early = tuple(replace(each, start=each.start - 0.5) if each.kind == "change" else each for each in t.events)
    assert CHANGED in failed(plan, replace(t, events=early))


@pytest.mark.slow
def test_a_bead_that_the_other_nozzle_would_lay() -> None:
    plan = two_nozzles()
    swapped = replace(plan.cell, nozzle_of={"pla": 1, "pva": 0})
    assert {"recorded poses", "tip on the path"} <= failed(plan, cell=swapped)
    moved = [replace(each, T_flange_nozzle=each.T_flange_nozzle.copy()) for each in plan.cell.nozzles]
    moved[1].T_flange_nozzle[0, 3] += 1e-3
    assert "tip on the path" in failed(plan, cell=replace(plan.cell, nozzles=tuple(moved)))


def test_an_idle_nozzle_that_is_in_the_way() -> None:
    plan = two_nozzles()
    first, second = plan.cell.nozzles
    # a ring of the idle nozzle's own body, hung as low as the tip that prints
    low = [replace(body, T_frame_solid=np.eye(4)) if body.name == "nozzle of tPla" else body for body in second.head]
    hung = replace(plan.cell, nozzles=(first, replace(second, head=tuple(low))))
    assert "nozzle clear of part and print" in failed(plan, cell=hung)


# --- what is written ---------------------------------------------------------------------------------------


@cache
def rapid_files() -> dict[str, str]:
    return RAPID.write(two_nozzles())


def spoilt(old: str, new: str, count: int = 1) -> list[str]:
    """Differences of a program in which a text is exchanged."""
    files = dict(rapid_files())
    assert old in files["Small.mod"]
    files["Small.mod"] = files["Small.mod"].replace(old, new, count)
    return RAPID.differences(two_nozzles(), files)


def test_a_program_changes_its_tool_at_home() -> None:
    text = rapid_files()["Small.mod"]
    assert RAPID.differences(two_nozzles(), rapid_files()) == []
    assert text.count("PERS tooldata tPla:=") == text.count("PERS tooldata tPva:=") == 1
    for name, tool in (("Change1", "tPva"), ("Change2", "tPla")):
        lines = text.split(f"PROC {name}()")[1].split("ENDPROC")[0].strip().split("\n")
        assert f"From here on with {tool}." in lines[0]
        assert "MoveAbsJ" in lines[2] and f"{tool}\\WObj" in lines[2]
        assert "MoveJ" in lines[3] and f"fine,{tool}\\WObj" in lines[3]
        assert lines[-1].strip() == "WaitTime 2.000;"


@pytest.mark.slow
def test_nozzles_that_are_exchanged_are_named_before_the_print_begins() -> None:
    plan = two_nozzles("one")
    assert "! Begins with tPla, which has to be on the flange." in RAPID.write(plan)["Small.mod"]
    _, later, _ = plan.stretches
    assert resumed_words(later) == "resumed at bead 1 of 3, bead 0 assumed to be printed, tPva on the flange"
    assert "Begins with" not in rapid_files()["Small.mod"]


def test_what_was_changed_in_a_program_is_found() -> None:
    assert any(
        "frames differs" in each for each in spoilt("tooldata tPva:=[TRUE,[[44.510", "tooldata tPva:=[TRUE,[[44.610")
    )
    change = rapid_files()["Small.mod"].split("PROC Change1()")[1]
    waits = "        ! change to pva, bead 1\n        WaitTime"
    assert any(each.startswith("wait") for each in spoilt(f"{waits} 2.000;", f"{waits} 1.000;"))
    (absolute,) = (line for line in change.split("ENDPROC")[0].split("\n") if "MoveAbsJ" in line)
    with pytest.raises(InputError, match="MoveAbsJ is only for the start and for a change of tool"):
        spoilt(absolute + "\n", "")  # so that the next change is to the tool in use
    joint = absolute.split("[[")[1].split(",")[0]
    assert any(
        "frames differs" in each for each in spoilt(absolute, absolute.replace(joint, f"{float(joint) + 0.1:.5f}"))
    )
    move = next(line for line in change.split("PROC Bead0002")[1].split("\n") if "Move" in line)
    with pytest.raises(InputError, match="it moves tPla while tPva is in use"):
        spoilt(move, move.replace("tPva", "tPla"))
    with pytest.raises(InputError, match="MoveAbsJ is only for the start and for a change of tool"):
        spoilt(absolute, absolute.replace("tPva", "tPla"))
    with pytest.raises(InputError, match="a tool may be changed only at rest"):
        home = rapid_files()["Small.mod"].split("PROC Home1()")[1].split("ENDPROC")[0]
        last = home.strip().split("\n")[-1].strip()
        spoilt(last, last.replace(",fine,", ",z1,"))


def test_readers_made_for_one_nozzle_refuse_such_a_program() -> None:
    with pytest.raises(InputError, match="it changes its tool 2 times"):
        read_rapid_files(rapid_files())
    with pytest.raises(InputError, match="one nozzle"):
        RAPID.program(two_nozzles(), rapid_files())


def test_a_joint_trajectory_needs_no_tool() -> None:
    plan, language = two_nozzles(), LANGUAGES["joint_trajectory"]
    assert language.unsupported(plan) is None
    files = language.write(plan)
    assert language.differences(plan, files) == []
    one = replace(plan, cell=replace(plan.cell, nozzles=()))  # all of it by the first nozzle's tip
    assert any("path differs" in each for each in language.differences(one, files))


@pytest.mark.parametrize("name", sorted(set(LANGUAGES) - {"rapid", "extruder", "joint_trajectory"}))
def test_languages_written_for_one_nozzle_say_so(name: str) -> None:
    reason = LANGUAGES[name].unsupported(two_nozzles())
    assert reason is not None
    if name not in ("axes", "urscript"):  # which this arm and problem have not for other reasons
        assert "one nozzle, and the cell has tPla and tPva" in reason


def test_several_nozzles_are_written_with_outputs_only() -> None:
    for style in ("socket", "demand"):
        problem = problem_of(*TWO, ("strategy: ladder\n", f"strategy: ladder\nprogram: {{style: {style}}}\n"))
        setup = replace(two_nozzles(), problem=problem)
        assert RAPID.unsupported(setup) == f"with several nozzles program.style must be output, not {style}"


def test_the_forecast_is_that_of_all_stretches() -> None:
    plan = two_nozzles()
    controller = CONTROLLERS["rapid"]
    parts = [forecast(program, part.cell, controller) for part, program in RAPID.programs(plan, rapid_files())]
    whole = joined(parts, controller)
    assert whole.time == pytest.approx(sum(part.time for part in parts))
    assert (whole.targets, whole.laid) == (sum(p.targets for p in parts), sum(p.laid for p in parts))
    assert min(p.mean for p in parts) <= whole.mean <= max(p.mean for p in parts)
    assert whole.off == max(p.off for p in parts) and whole.least == min(p.least for p in parts)
    assert joined(parts[:1], controller) is parts[0]


@pytest.mark.parametrize("move", ["own", "played"])
def test_the_simulator_runs_all_stretches(move: str) -> None:
    plan = two_nozzles()
    programs = read_modules({name.removesuffix(".mod"): text for name, text in rapid_files().items() if ".mod" in name})
    make: Callable[..., MotionsInTurn] = own_clock if move == "own" else partial(played_motion, cell=plan.cell.as_counted)  # type: ignore[assignment]  # fmt: skip
    motion = MotionsInTurn(tuple(map(make, programs)), tuple(len(each.position) for each in programs))
    assert motion.duration == pytest.approx(plan.trajectory.t[-1], rel=0.2)
    switched = [each.text for each in motion.happenings]
    assert switched == [f"doExtrude{k}={v}" for k in ("", "1", "") for v in (1, 0)]
    assert [each.move for each in motion.happenings] == sorted(each.move for each in motion.happenings)
    begin = motion.begins[1]
    before, tip_before = motion.at(begin - 1e-6)
    after, tip_after = motion.at(begin + 1e-6)
    assert after > before and np.linalg.norm(tip_after - tip_before) > 0.05  # another tip, the arm at home


def test_the_simulator_tells_nozzles_apart_by_their_axes_too() -> None:
    same_tip = NOZZLES.replace("[44.51, 9.9, 118]", "[-44.51, 9.9, 113.95]")
    cell = build_cell(problem_of((NOZZLE, f"{same_tip}  mounted: one\n"), TWO[1], BED[0]))
    for own in map(cell.with_nozzle, range(2)):
        made = program_at(own, own.home)
        played = played_motion(made, cell).played
        assert np.abs(played.quat[-1] @ made.quat[-1]) == pytest.approx(1.0, abs=1e-9)


@pytest.mark.slow
def test_the_table_and_the_picture_tell_each_nozzle() -> None:
    plan = two_nozzles("one")
    nozzles = json.loads(plan_json(plan))["cell"]["nozzles"]
    assert [(each["name"], each["materials"]) for each in nozzles] == [("tPla", ["pla"]), ("tPva", ["pva"])]
    rest = np.zeros((1, 6))
    for each, own in zip(nozzles, (plan.cell, plan.cell.at("pva")), strict=True):
        assert np.allclose(each["T_world_nozzle_zero"], own.arm.poses(rest)[0], atol=1e-9)
    scene = plan_scene(plan, ())
    tools = scene["cell"]["tools"]
    assert [tool["absent"] and "nozzle of tPva" in tool["absent"] for tool in tools] == [True, False, True]
    drawn = {name for body in scene["cell"]["bodies"] for name in body["bodies"]}
    assert {"nozzle of tPla", "nozzle of tPva"} <= drawn
    assert plan_scene(two_nozzles(), ())["cell"]["tools"][1]["absent"] == []
    assert scene["motion"]["off_mm"] < 1.0


def test_a_saved_plan_comes_back(tmp_path: Path) -> None:
    plan = two_nozzles()
    again = Plan.load(plan.save(tmp_path / "two.plan"))
    assert again.cell.nozzle_of == plan.cell.nozzle_of
    assert len(again.stretches) == 3
    assert isinstance(again.cell.arm_robot, Robot)


def test_a_problem_with_two_materials_in_one_toolpath_keeps_its_tasks_apart() -> None:
    plan = two_nozzles()
    assert [task.material for task in tasks_of(plan.problem, plan.toolpath)] == list(ORDER)
