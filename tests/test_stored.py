"""Plans that are saved and loaded: the same to the last bit, and nothing of a changed file is believed."""

from __future__ import annotations

import json
import pickle
import re
import shutil
import zipfile
from collections.abc import Callable
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from solved import small_plan, write_small
from test_nearer import RIM, flat
from test_pauses import STIFF, helix

from planner import Plan, Toolpath, load, solve, write
from planner.base.errors import InputError, OutputError
from planner.base.shipped import ROBOTS
from planner.plan.seal import changed_since, digest_of, sealed
from planner.plan.stored import stored_parts
from planner.planning.files import as_it_is
from planner.problem import shipped_problems
from planner.toolpath.build import build_toolpath


def again(plan: Plan, folder: Path) -> Plan:
    return Plan.load(plan.save(folder / "plan.npz"))


def spoilt(file: Path, change: Callable[[dict[str, Any], dict[str, Any]], object]) -> Path:
    """The file with its text, as JSON, and its arrays changed."""
    with np.load(file, allow_pickle=False) as archive:
        arrays = {name: archive[name] for name in archive.files}
    text = json.loads(arrays.pop("structure").tobytes())
    change(text, arrays)
    other = file.with_name("other.npz")
    np.savez_compressed(other, structure=np.frombuffer(json.dumps(text).encode(), dtype=np.uint8), **arrays)
    return other


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return small_plan().save(tmp_path_factory.mktemp("saved") / "small.npz")


def test_a_plan_comes_back_to_the_last_bit(file: Path) -> None:
    plan, loaded = small_plan(), Plan.load(file)
    assert changed_since(loaded) == () and loaded.seal == plan.seal
    for field in fields(Plan):
        if field.name != "seal":
            assert digest_of(getattr(loaded, field.name)) == digest_of(getattr(plan, field.name)), field.name
    assert repr(loaded) == repr(plan) and loaded.summary() == plan.summary()
    assert loaded.problem.file == plan.problem.file and loaded.problem.sources == plan.problem.sources
    assert loaded.problem.model_fields_set == plan.problem.model_fields_set
    with pytest.raises(ValueError, match="read-only"):
        loaded.q[0] = 0.0


def test_its_files_are_the_same(file: Path, tmp_path: Path) -> None:
    write(small_plan(), tmp_path / "one")
    write(Plan.load(file), tmp_path / "other")
    for path in (tmp_path / "one").iterdir():
        if path.name not in ("plan.json", "report.html", "manifest.json"):  # which tell how long all took
            assert path.read_bytes() == (tmp_path / "other" / path.name).read_bytes(), path.name
    one, other = (json.loads((tmp_path / name / "plan.json").read_text()) for name in ("one", "other"))
    assert {**one, "timing_s": 0} == {**other, "timing_s": 0}


def test_saving_twice_gives_the_same_numbers(file: Path, tmp_path: Path) -> None:
    second = Plan.load(file).save(tmp_path / "again.npz")
    with np.load(file) as one, np.load(second) as other:
        assert one.files == other.files
        assert all(one[name].tobytes() == other[name].tobytes() for name in one.files if name != "structure")


def _joints(text: dict[str, Any], arrays: dict[str, Any]) -> None:
    told = text["objects"][text["plan"]["trajectory"][1]]
    kind, first, shape = text["objects"][told[1]["q"][1]][1]
    arrays[kind][first + 700 * shape[1] + 2] += 0.05


def _verdict(text: dict[str, Any], arrays: dict[str, Any]) -> None:
    text["plan"]["checks"][1] = text["plan"]["checks"][1][:2]


def _speed(text: dict[str, Any], arrays: dict[str, Any]) -> None:
    problem = text["objects"][text["plan"]["problem"][1]]
    text["objects"][problem[1]["process"][1]][1]["travel_speed"] = ["float", (5.0).hex()]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("change", "part", "verified"),
    [(_joints, "trajectory", False), (_verdict, "verdict", True)],
)
def test_what_was_changed_in_a_file_is_verified_anew(
    change: Callable[[dict[str, Any], dict[str, Any]], object], part: str, verified: bool, file: Path, tmp_path: Path
) -> None:
    loaded = Plan.load(spoilt(file, change))
    assert part in changed_since(loaded)
    judged = as_it_is(loaded)
    assert judged.verified == verified and len(judged.checks) >= len(small_plan().checks)
    write(loaded, tmp_path / "out")
    assert bool(list((tmp_path / "out").glob("*.mod"))) == verified


def _outward(text: dict[str, Any], arrays: dict[str, Any]) -> None:
    bead = text["objects"][text["objects"][text["plan"]["toolpath"][1]][1]["beads"][1][0][1]]
    kind, first, _ = text["objects"][bead[1]["points"][1]][1]
    arrays[kind][first] += 1e-9


@pytest.mark.parametrize(("change", "part"), [(_speed, "problem"), (_outward, "toolpath")])
def test_what_compiled_code_trusts_is_not_taken_when_it_was_changed(
    change: Callable[[dict[str, Any], dict[str, Any]], object], part: str, file: Path
) -> None:
    with pytest.raises(InputError, match=f"changed since it was saved: its {part}"):
        Plan.load(spoilt(file, change))


def test_the_verdict_of_another_version_is_found_anew(tmp_path: Path) -> None:
    plan = small_plan()
    loaded = again(replace(plan, versions={**plan.versions, "beadwise": "0.0.1"}), tmp_path)
    assert changed_since(loaded) == ("verdict",) and loaded.checks == plan.checks


def test_an_input_of_another_version_is_not_taken_for_one_that_was_changed(file: Path) -> None:
    def older(text: dict[str, Any], arrays: dict[str, Any]) -> None:
        text["beadwise"] = "0.0.1"
        _speed(text, arrays)

    with pytest.raises(InputError, match=r"holds a plan of beadwise 0\.0\.1 that this version cannot read"):
        Plan.load(spoilt(file, older))


def test_a_plan_that_was_changed_before_it_was_saved_is_verified_anew(tmp_path: Path) -> None:
    plan = small_plan()
    process = plan.problem.process.model_copy(update={"travel_speed": 1.0})
    changed = replace(plan, problem=plan.problem.model_copy(update={"process": process}))
    loaded = again(changed, tmp_path)
    assert changed_since(loaded) == ("problem",) and not as_it_is(loaded).verified


@pytest.mark.slow
def test_a_problem_s_file_may_change_and_a_robot_s_may_not(tmp_path: Path) -> None:
    for path in ROBOTS.glob("irb140.*"):
        shutil.copy(path, tmp_path)
    problem = write_small(tmp_path, ("arm: irb140", "arm: irb140.yaml"))
    saved = solve(problem, baseline=False).save(tmp_path / "plan.npz")
    problem.write_text(problem.read_text().replace("speed_mm_s: 40", "speed_mm_s: 10"))
    assert changed_since(Plan.load(saved)) == ()  # the problem is in the file
    robot = tmp_path / "irb140.yaml"
    changed = re.sub(r"(jerk_rad_s3: \[)[\d.]+", r"\g<1>77", robot.read_text())
    assert changed != robot.read_text()
    robot.write_text(changed)
    loaded = Plan.load(saved)
    assert changed_since(loaded) == ("cell",)
    failed = [check.where for check in as_it_is(loaded).checks if not check.ok]
    assert "changed since: cell" in failed


@pytest.mark.slow
def test_a_plan_from_arrays_needs_no_other_file(tmp_path: Path) -> None:
    line = np.linspace([0.0, -0.02, 0.06], [0.0, 0.02, 0.06], 41)
    plan = solve(load("peer_cap", toolpath=Toolpath.from_arrays(line, [0.0, 0.0, 1.0])), baseline=False)
    loaded = again(plan, tmp_path)
    assert changed_since(loaded) == () and loaded.verified
    assert as_it_is(replace(loaded, checks=())).checks == plan.checks
    assert load(loaded.problem, process__speed_mm_s=20).from_arrays


def _named(home: str) -> Callable[[dict[str, Any], dict[str, Any]], object]:
    return lambda text, arrays: text["plan"].update(toolpath=[home, ["true"]])


@pytest.mark.slow(keep=("<lambda>0", "<lambda>8", "<lambda>16", "<lambda>17", "<lambda>18", "<lambda>20", "<lambda>21"))
@pytest.mark.parametrize(
    "change",
    [
        _named("os:system"),
        _named("builtins:tuple"),
        _named("planner.plan.stored:Path"),
        _named("planner.base.isolated:Path"),
        lambda text, arrays: text["objects"].__setitem__(
            text["plan"]["trajectory"][1], ["planner.plan.stored:_Taking", {}]
        ),
        lambda text, arrays: text.update(format=99),
        lambda text, arrays: text["plan"].pop("dips"),
        lambda text, arrays: text["plan"].update(dips=["tuple", [3]]),
        lambda text, arrays: text["plan"].update(metrics=None),
        lambda text, arrays: text.pop("inputs"),
        lambda text, arrays: text["objects"][text["plan"]["trajectory"][1]][1].update(first_bead="one"),
        lambda text, arrays: text["objects"][text["plan"]["trajectory"][1]][1].update(q=text["plan"]["problem"]),
        lambda text, arrays: text["objects"][text["plan"]["trajectory"][1]][1].update(bead=["object", 1e400]),
        lambda text, arrays: text["objects"][text["objects"][text["plan"]["trajectory"][1]][1]["tip"][1]][
            1
        ].__setitem__(2, [-1, 3]),
        lambda text, arrays: text["plan"].update(more=1),
        lambda text, arrays: text["plan"].update(toolpath=["object", 10**9]),
        lambda text, arrays: text["plan"].update(problem=None),
        lambda text, arrays: arrays.pop("float64"),
        lambda text, arrays: arrays.update(float64=arrays["float64"][:10]),
        lambda text, arrays: text.clear(),
        lambda text, arrays: text["plan"].update(checks=5),
        lambda text, arrays: text["plan"].update(headroom=5),
    ],
)
def test_a_file_of_anything_else_is_refused(
    change: Callable[[dict[str, Any], dict[str, Any]], object], file: Path, tmp_path: Path
) -> None:
    with pytest.raises(InputError) as error:
        Plan.load(spoilt(file, change))
    assert error.value.file is not None and error.value.hint == "plan it again"


class Evil:
    def __reduce__(self) -> tuple[Any, ...]:
        return (Path.touch, (Path("evil"),))


def test_nothing_in_a_file_is_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("a.npz").write_bytes(pickle.dumps(Evil()))
    np.savez("b.npz", structure=np.array([Evil()], dtype=object))
    np.save("c.npy", np.zeros(3))
    Path("d.npz").write_text("plan")
    with zipfile.ZipFile("e.npz", "w") as archive:
        archive.writestr("structure.npy", b"x")
    for name in ("a.npz", "b.npz", "c.npy", "d.npz", "e.npz"):
        with pytest.raises(InputError, match="is not a saved plan"):
            Plan.load(name)
    assert not Path("evil").exists()
    with pytest.raises(InputError, match="there is no such file"):
        Plan.load("nowhere.npz")
    with pytest.raises(InputError, match="cannot be read: Is a directory"):
        Plan.load(tmp_path)
    with zipfile.ZipFile("f.npz", "w") as archive, archive.open("structure.npy", "w") as stream:
        np.lib.format.write_array_header_1_0(stream, {"descr": "<f8", "fortran_order": False, "shape": (10**17,)})
    with pytest.raises(InputError, match="too large for the memory"):
        Plan.load("f.npz")


def test_what_cannot_be_written_is_told_and_leaves_nothing(tmp_path: Path) -> None:
    with pytest.raises(OutputError, match="cannot write"):
        small_plan().save(tmp_path / "nowhere" / "plan.npz")
    (tmp_path / "folder").mkdir()
    with pytest.raises(OutputError, match="cannot write"):
        small_plan().save(tmp_path / "folder")
    assert [path.name for path in tmp_path.iterdir()] == ["folder"]


@pytest.mark.slow
def test_plans_that_are_not_as_their_problem_was_come_back_as_they_are(tmp_path: Path) -> None:
    """With less clearance than usual, with beads in pieces, and judged for a tolerance."""
    near = solve(flat(tmp_path, RIM.format(0.9)), baseline=False)
    pieces = solve(load(helix(tmp_path, 5.0).file, STIFF, "process.split_beads=true"), baseline=False)
    judged = solve(write_small(tmp_path), tolerance="0.1mm", baseline=False)
    assert near.nearer is not None and pieces.toolpath.splits and judged.headroom is not None
    for plan in (near, pieces, judged):
        loaded = again(plan, tmp_path)
        assert changed_since(loaded) == () and loaded.verified == plan.verified
        assert loaded.nearer == plan.nearer and loaded.toolpath.splits == plan.toolpath.splits


@pytest.mark.slow(keep=("peer_cap", "saddle_ring"))
@pytest.mark.parametrize("name", shipped_problems())
def test_toolpaths_of_every_source_can_be_saved(name: str, tmp_path: Path) -> None:
    problem = load(name)
    plan = sealed(replace(small_plan(), problem=problem, toolpath=build_toolpath(problem)))
    layers = [bead.layer for bead in plan.toolpath.beads]
    plan.toolpath.surface.before(layers.index(min(1, max(layers))) + 1).signed_distance(np.array([[0.0, 0.0, 1e-3]]))
    assert changed_since(plan) == ()  # by being asked
    parts = stored_parts(plan.save(tmp_path / "plan.npz"), {each.name for each in fields(Plan)} - {"cell"})
    for part in ("toolpath", "problem"):
        assert digest_of(parts[part]) == digest_of(getattr(plan, part))
