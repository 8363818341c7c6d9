"""The verdict is bound to the motion: what was changed since is verified anew, and files that were edited are not run."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from solved import small_plan, write_small

from planner.base.errors import InputError
from planner.cell.cell import build_cell
from planner.link.as_written import differing, program_as_written, table_as_written, within_limits
from planner.link.guided_motion import PERIOD, read_plan
from planner.link.streaming import main, modules_in
from planner.plan import Plan, Trajectory
from planner.plan.seal import changed_since, digest_of, seal_of, sealed
from planner.planning.files import BOUNDS, as_it_is, write
from planner.planning.pipeline import solve
from planner.problem import load_problem

Change = Callable[[Plan], Plan]


def with_rows(name: str, where: str, change: Callable[[Any], Any]) -> Change:
    """A change of six rows of an array, in the middle of a bead or in travel."""

    def changed(plan: Plan) -> Plan:
        values = getattr(plan.trajectory, name).copy()
        rows = np.flatnonzero(plan.trajectory.deposit == (where == "laid"))
        at = rows[len(rows) // 2] if where == "laid" else rows[-40]
        values[at - 3 : at + 3] = change(values[at - 3 : at + 3])
        return replace(plan, trajectory=replace(plan.trajectory, **{name: values}))

    return changed


def cut(first: int, last: int | None) -> Change:
    """All arrays without their first or last rows."""

    def changed(plan: Plan) -> Plan:
        t = plan.trajectory
        names = [field.name for field in fields(t) if isinstance(getattr(t, field.name), np.ndarray)]
        return replace(plan, trajectory=replace(t, **{name: getattr(t, name)[first:last].copy() for name in names}))

    return changed


def of_trajectory(**values: Any) -> Change:
    return lambda plan: replace(plan, trajectory=replace(plan.trajectory, **values))


def of_limits(plan: Plan) -> Plan:
    limits = plan.cell.limits
    return replace(plan, cell=replace(plan.cell, limits=replace(limits, velocity=limits.velocity * 2.0)))


def of_tool(plan: Plan) -> Plan:
    T_flange_nozzle = plan.cell.T_flange_nozzle.copy()
    T_flange_nozzle[0, 3] += 1e-3
    return replace(plan, cell=replace(plan.cell, T_flange_nozzle=T_flange_nozzle))


def of_toolpath(plan: Plan) -> Plan:
    first, *rest = plan.toolpath.beads
    return replace(plan, toolpath=replace(plan.toolpath, beads=(replace(first, points=first.points + 1e-3), *rest)))


def of_problem(plan: Plan) -> Plan:
    process = plan.problem.process.model_copy(update={"travel_speed": 1.0})
    return replace(plan, problem=plan.problem.model_copy(update={"process": process}))


# name → change, check that must fail then
CHANGES: dict[str, tuple[Change, str]] = {
    "joints of a bead": (with_rows("q", "laid", lambda a: a + 1e-3), "recorded poses"),
    "joints of travel": (with_rows("q", "travel", lambda a: a + 1e-3), "recorded poses"),
    "tip of a bead": (with_rows("tip", "laid", lambda a: a + 1e-4), "recorded poses"),
    "tip of travel": (with_rows("tip", "travel", lambda a: a + 1e-4), "recorded poses"),
    "axis": (with_rows("axis", "laid", lambda a: a + 1e-2), "recorded poses"),
    "orientation": (with_rows("quat", "travel", lambda a: a + 1e-2), "recorded poses"),
    "speed of a bead": (with_rows("speed", "laid", lambda a: a + 5e-3), "recorded speed"),
    "speed of travel": (with_rows("speed", "travel", lambda a: a + 5e-3), "recorded speed"),
    "flow of a bead": (with_rows("flow", "laid", lambda a: a + 1e-9), "extrusion balance"),
    "flow of travel": (with_rows("flow", "travel", lambda a: a + 1e-9), "extrusion balance"),
    "length of a bead": (with_rows("s", "laid", lambda a: a + 1e-3), "tip on the path"),
    "length of travel": (with_rows("s", "travel", lambda a: a + 1e-3), "recorded layers and lengths"),
    "times": (with_rows("t", "travel", lambda a: a + 1e-3), "recorded times and beads"),
    "volume": (with_rows("extruded", "laid", lambda a: a + 1e-9), "material keeps pace"),
    "filament": (with_rows("feed", "laid", lambda a: a + 1e-3), "filament fed"),
    "a bead that is not there": (with_rows("bead", "laid", lambda a: a * 0 + 99), "beads of the toolpath"),
    "a bead below nought": (with_rows("bead", "laid", lambda a: a * 0 - 7), "beads of the toolpath"),
    "another bead": (with_rows("bead", "laid", lambda a: a * 0), "tip on the path"),
    "layer of a bead": (with_rows("layer", "laid", lambda a: a + 9), "recorded layers and lengths"),
    "layer of travel": (with_rows("layer", "travel", lambda a: a + 9), "recorded layers and lengths"),
    "nothing deposited": (with_rows("deposit", "laid", lambda a: a & False), "recorded times and beads"),
    "deposited in travel": (with_rows("deposit", "travel", lambda a: a | True), "recorded times and beads"),
    "configuration": (with_rows("branch", "laid", lambda a: a + 8), "recorded branch"),
    "no number": (with_rows("q", "laid", lambda a: a * np.nan), "all numbers finite"),
    "end cut off": (cut(0, -400), "every bead complete"),
    "end of travel cut off": (cut(0, -20), "starts and ends at home"),
    "beginning cut off": (cut(20, None), "starts and ends at home"),
    "a later first bead": (of_trajectory(first_bead=2), "beads of the toolpath"),
    "no such first bead": (of_trajectory(first_bead=9), "beads of the toolpath"),
    "time step": (lambda plan: of_trajectory(dt=plan.trajectory.dt * 1.01)(plan), "recorded times and beads"),
    "limits": (of_limits, "as it was planned"),
    "tool": (of_tool, "as it was planned"),
    "toolpath": (of_toolpath, "as it was planned"),
    "problem": (of_problem, "as it was planned"),
}


@pytest.mark.slow(keep=("toolpath",))
@pytest.mark.parametrize("name", CHANGES)
def test_a_changed_plan_is_verified_anew(name: str) -> None:
    change, fails = CHANGES[name]
    plan = small_plan()
    assert plan.verified and changed_since(plan) == ()
    for verdict in ({}, {"checks": ()}):  # what it says of itself does not count
        judged = as_it_is(replace(change(plan), **verdict))
        assert not judged.verified
        assert fails in {check.name for check in judged.checks if not check.ok}
        assert changed_since(judged) == () and as_it_is(judged) is judged


def test_what_planning_found_of_its_own_motion_is_not_told_of_a_changed_one() -> None:
    plan = small_plan()
    judged = as_it_is(replace(plan, checks=()))
    assert plan.roll_maps and not judged.roll_maps and not judged.dips
    assert {name for name in plan.metrics if name not in judged.metrics} == set(BOUNDS)


def test_no_program_of_a_changed_plan_is_written(tmp_path: Path) -> None:
    plan = write(CHANGES["joints of a bead"][0](small_plan()), tmp_path)
    assert not plan.verified
    assert not list(tmp_path.glob("*.mod")) and json.loads((tmp_path / "plan.json").read_text())["verified"] is False


def test_a_verdict_that_was_changed_is_found_anew() -> None:
    plan = small_plan()
    spoilt = replace(plan, checks=plan.checks[:3], metrics={**plan.metrics, "at_speed_fraction": 1.0})
    assert changed_since(spoilt) == ("verdict",)
    judged = as_it_is(spoilt)
    assert judged.verified and judged.checks == plan.checks
    assert judged.metrics == {name: value for name, value in plan.metrics.items() if name not in BOUNDS}


def test_a_plan_without_a_seal_is_verified(tmp_path: Path) -> None:
    bare = replace(small_plan(), seal={})
    assert set(changed_since(bare)) == {"trajectory", "verdict"}
    assert as_it_is(bare).verified and not as_it_is(CHANGES["tool"][0](bare)).verified


def test_a_change_where_the_array_stands_is_seen() -> None:
    plan = small_plan()
    values = plan.trajectory.q.copy()
    other = replace(plan, trajectory=replace(plan.trajectory, q=values))
    assert changed_since(other) == ()
    stands = other.trajectory.q
    stands.flags.writeable = True
    stands[700, 2] = np.nextafter(stands[700, 2], 9.0)
    assert changed_since(other) == ("trajectory",)


@pytest.mark.slow
def test_a_tolerance_that_was_judged_is_not_carried_over(tmp_path: Path) -> None:
    plan = solve(write_small(tmp_path), tolerance="0.1mm", baseline=False)
    assert plan.headroom is not None and changed_since(plan) == ()
    changed = as_it_is(replace(plan, checks=()))
    assert next(check for check in changed.checks if not check.ok).where == "changed since: tolerance"


def test_arrays_of_different_lengths_are_told() -> None:
    plan = small_plan()
    with pytest.raises(InputError, match=r"trajectory\.q: \d+ rows for \d+ samples"):
        as_it_is(of_trajectory(q=plan.trajectory.q[:-5])(plan))


def test_arrays_of_another_kind_are_told() -> None:
    plan = small_plan()
    t, n = plan.trajectory, len(plan.trajectory)
    for values, told in (
        ({"deposit": t.deposit.astype(np.int64)}, f"trajectory.deposit: is int64 of shape ({n},)"),  # as in a table
        ({"bead": t.bead.astype(float)}, f"trajectory.bead: is float64 of shape ({n},)"),
        ({"q": t.q[:, :3]}, f"trajectory.q: is float64 of shape ({n}, 3)"),
        ({"tip": t.tip.tolist()}, "trajectory.tip: is of type list"),
    ):
        with pytest.raises(InputError, match=re.escape(told)):
            as_it_is(of_trajectory(**values)(plan))


@settings(max_examples=60, deadline=None)
@given(st.data())
def test_any_number_of_the_motion_changes_the_digest(data: st.DataObject) -> None:
    t: Trajectory = small_plan().trajectory
    names = [field.name for field in fields(t) if isinstance(getattr(t, field.name), np.ndarray)]
    name = data.draw(st.sampled_from(names))
    values = getattr(t, name).copy()
    at = data.draw(st.integers(0, values.size - 1))
    flat = values.reshape(-1)
    flat[at] = (
        ~flat[at] if values.dtype == bool else flat[at] + 1 if values.dtype.kind == "i" else np.nextafter(flat[at], 9.0)
    )
    assert digest_of(replace(t, **{name: values})) != digest_of(t)


def test_digests_tell_types_and_shapes_apart() -> None:
    values: list[object] = [
        0, 0.0, -0.0, False, None, "0", b"0", (), {}, (0,), ((0,),), (0, 0), {"a": 0}, {"a": 0.0}, np.zeros(4), np.zeros((2, 2)),
        np.zeros(4, np.float32), ("ab", "c"), ("a", "bc"), {1, 2}, {1, 3}, Path("a"), "a",
    ]  # fmt: skip
    assert len({digest_of(value) for value in values}) == len(values)
    assert digest_of({2, 1}) == digest_of({1, 2})
    with pytest.raises(TypeError, match="object has no digest"):
        digest_of(object())


def test_a_plan_is_not_lost_for_what_has_no_digest() -> None:
    plan = replace(small_plan(), toolpath=replace(small_plan().toolpath, notes=(object(),)))
    assert seal_of(plan)["toolpath"] == "" and changed_since(sealed(plan)) == ("toolpath",)
    assert not as_it_is(sealed(plan)).verified  # nor is it written as if nobody could have changed it


# ---- files that were edited -----------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """Results of the small problem, and the problem."""
    folder = tmp_path_factory.mktemp("written")
    problem = write_small(folder / "problem")
    write(small_plan(), folder / "out")
    return folder / "out", problem


@pytest.fixture
def results(written: tuple[Path, Path], tmp_path: Path) -> Path:
    """A copy of them to spoil."""
    folder = tmp_path / "out"
    folder.mkdir()
    for path in written[0].iterdir():
        (folder / path.name).write_bytes(path.read_bytes())
    return folder


def module_of(folder: Path) -> Path:
    return next(iter(modules_in(folder)))


def moved(text: str) -> str:
    """A program whose middle target is 50 mm farther along x."""
    targets = list(re.finditer(r"\[\[(-?[\d.]+),", text))
    middle = targets[len(targets) // 2]
    return f"{text[: middle.start(1)]}{float(middle[1]) + 50.0:.3f}{text[middle.end(1) :]}"


def without_a_move(text: str) -> str:
    lines = text.splitlines(keepends=True)
    moves = [k for k, line in enumerate(lines) if "MoveL" in line or "TriggL" in line]
    del lines[moves[len(moves) // 2]]
    return "".join(lines)


def test_plan_json_lists_what_was_written(results: Path) -> None:
    listed = json.loads((results / "plan.json").read_text())["files"]
    assert set(listed) == {path.name for path in results.iterdir()} - {"plan.json", "manifest.json", "report.html"}
    assert differing(results, listed) == {}


@pytest.mark.parametrize("spoil", [moved, without_a_move], ids=["moved", "without a move"])
def test_an_edited_program_is_not_streamed(
    spoil: Callable[[str], str], results: Path, written: tuple[Path, Path], capsys: pytest.CaptureFixture[str]
) -> None:
    module, server = module_of(results), results.parent / "server.mod"
    assert main([str(results), "--server", str(server)]) == 0
    server.unlink()
    module.write_text(spoil(module.read_text("ascii")), "ascii", newline="\n")
    assert main([str(results), "--server", str(server)]) == 2 and not server.exists()
    assert f"not the files that were verified: {module.name} was changed" in capsys.readouterr().err
    assert main([str(results), "--server", str(server), "--edited", str(written[1])]) == 0
    told = capsys.readouterr().err
    assert f"WARNING: not verified: {module.name} was changed" in told
    off = float(re.search(r"at most ([\d.]+) mm off the planned path", told)[1])  # type: ignore[index]
    assert (off > 20.0) == (spoil is moved)


def test_an_edited_program_that_cannot_be_reached_is_refused(results: Path, written: tuple[Path, Path]) -> None:
    module = module_of(results)
    far = re.sub(r"\[\[-?[\d.]+,", "[[9000.0,", module.read_text("ascii"), count=20)
    module.write_text(far, "ascii", newline="\n")
    with pytest.raises(InputError):
        program_as_written(results, [module.name], str(written[1]), lambda text: None)


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (lambda folder: (folder / "trajectory.csv").write_text("t_s\n"), "trajectory.csv was changed"),
        (lambda folder: (folder / "trajectory.csv").unlink(), "trajectory.csv is missing"),
        (lambda folder: (folder / "plan.json").unlink(), "no plan here"),
        (lambda folder: (folder / "plan.json").write_text('{"verified": true}'), "does not say which files"),
        (lambda folder: (folder / "plan.json").write_text("[]"), "not a plan"),
        (
            lambda folder: (folder / "plan.json").write_text((folder / "plan.json").read_text().replace("2", "3", 1)),
            "plan.json was changed",
        ),
    ],
)
def test_tables_that_are_not_the_plans_are_told(spoil: Callable[[Path], object], words: str, results: Path) -> None:
    assert table_as_written(results, None, lambda text: None) is None
    spoil(results)
    with pytest.raises(InputError, match=words):
        table_as_written(results, None, lambda text: None)


def test_an_edited_table_keeps_to_the_limits(results: Path, written: tuple[Path, Path]) -> None:
    told: list[str] = []
    plan, table = read_plan(results), results / "trajectory.csv"
    table.write_text(table.read_text() + "\n")
    cell = table_as_written(results, str(written[1]), told.append)
    assert cell is not None and told == ["WARNING: not verified: trajectory.csv was changed"]
    q = plan.q[:, plan.velocity > 0.0]
    within_limits(cell, q, PERIOD, told.append)
    assert "joints within range" in told[-1]
    for change, words in ((4.0, "leaves its range"), (0.1, "times its speed"), (1e-3, "times its acceleration")):
        jumped = q.copy()
        jumped[500:, 2] += change
        with pytest.raises(InputError, match=f"joint_3 .*{words}"):
            within_limits(cell, jumped, PERIOD, told.append)


def test_what_carries_the_arm_is_told_by_its_name() -> None:
    cell = build_cell(load_problem("rail_panel"))
    q = np.tile(cell.home, (3, 1))
    q[1, 0] = cell.limits.q_max[0] + 0.1
    with pytest.raises(InputError, match="rail leaves its range"):
        within_limits(cell, q, PERIOD, lambda text: None)


def test_what_was_not_written_with_the_plan_is_told(results: Path) -> None:
    (results / "Other.mod").write_text("MODULE Other\nENDMODULE\n")
    assert differing(results, ["Other.mod"]) == {"Other.mod": "was not written with the plan"}
