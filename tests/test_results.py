"""The folder of results: replaced whole or not at all, whatever fails, and files that are not ours are kept."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest
from export_fixtures import in_modules, make_plan, socket_plan
from hypothesis import given
from hypothesis import strategies as st

from planner.base.errors import OutputError
from planner.base.results import MANIFEST, REPLACED, WRITING, digest, listed, results_folder
from planner.base.versions import versions
from planner.export.languages import LANGUAGES
from planner.plan import Plan
from planner.problem.settings import MachineSpec

ROOT = Path(__file__).resolve().parents[1]


def put(folder: Path, files: dict[str, str], by: str = "solve") -> list[str]:
    """Leave files as a command's results; the sentences that it was told."""
    told: list[str] = []
    with results_folder(folder, by, told.append) as fresh:
        for name, text in files.items():
            (fresh / name).write_text(text, encoding="utf-8")
    return told


def contents(folder: Path) -> dict[str, str]:
    return {path.name: path.read_text(encoding="utf-8") for path in folder.iterdir() if path.name != MANIFEST}


def short(**options: object) -> Plan:
    return make_plan(beads=1, length=0.010, **options)  # type: ignore[arg-type]


def for_machine(flavour: str) -> Plan:
    plan = short()
    rotary = ({"letter": "A", "direction": (1, 0, 0)}, {"letter": "C", "direction": (0, 0, 1)})
    machine = MachineSpec(flavour=flavour, type="table_table", rotary=rotary)
    program = plan.problem.program.model_copy(update={"machine": machine})
    return replace(plan, problem=SimpleNamespace(**vars(plan.problem) | {"program": program}))  # type: ignore[arg-type]


MADE: dict[str, tuple[str, Callable[[], Plan]]] = {
    "modules": ("rapid", lambda: in_modules(make_plan(), 30)),
    "socket": ("rapid", socket_plan),
    "urscript": ("urscript", lambda: short(positioner=False, arm="ur5e")),
    "krl": ("krl", lambda: short(arm="kr6_r900")),
    **{
        name: (name, lambda: short(positioner=False, arm="kr6_r900"))
        for name in ("fanuc", "inform", "val3", "kawasaki", "melfa")
    },
    "joint_trajectory": ("joint_trajectory", lambda: short(positioner=False)),
    "reprap": ("axes", lambda: for_machine("reprap")),
    "linuxcnc": ("axes", lambda: for_machine("linuxcnc")),
}


@pytest.mark.parametrize("kind", MADE)
def test_no_program_of_an_earlier_plan_stays(kind: str, tmp_path: Path) -> None:
    """A program that is there beside a plan that was not verified would be taken for that plan's."""
    language, made = MADE[kind]
    written = dict(LANGUAGES[language].write(replace(made(), versions=versions())))
    assert len(written) >= {"modules": 4, "socket": 3, "krl": 2, "val3": 6, "melfa": 2, "joint_trajectory": 2}.get(
        kind, 1
    )
    put(tmp_path, written)
    assert put(tmp_path, {"report.html": "refused"}) == []
    assert contents(tmp_path) == {"report.html": "refused"}


@pytest.mark.parametrize("kind", ["krl", "linuxcnc"])
def test_programs_name_all_that_made_them(kind: str) -> None:
    language, made = MADE[kind]
    used = versions()
    text = "".join(dict(LANGUAGES[language].write(replace(made(), versions=used))).values())
    assert {"coal", "pyvrp", "shapely", "cadquery-ocp-novtk", "trimesh"} <= set(used)
    assert all(f"{name} {version}" in text for name, version in used.items())


def test_files_of_others_stay_as_they_are(tmp_path: Path) -> None:
    """Whatever stands in them: an edited copy of a program keeps its header."""
    theirs = {"Logo_slower.mod": "! beadwise 0.2.0\nMODULE Logo\nENDMODULE\n", "notes.txt": "", "photo.png": "x"}
    put(tmp_path, {"Logo.mod": "! beadwise 0.2.0\n", "report.html": "1"})
    for name, text in theirs.items():
        (tmp_path / name).write_text(text)
    (tmp_path / "photos").mkdir()
    assert put(tmp_path, {"report.html": "2"}) == []
    (tmp_path / "photos").rmdir()
    assert contents(tmp_path) == theirs | {"report.html": "2"}


def test_a_result_that_was_changed_since_is_kept(tmp_path: Path) -> None:
    put(tmp_path, {"Logo.mod": "v40", "report.html": "1"})
    for k, text in enumerate(("v30, by hand", "v20, by hand")):
        (tmp_path / "Logo.mod").write_text(text)
        told = put(tmp_path, {"Logo.mod": f"v{k}", "report.html": "2"})
        assert len(told) == 1 and str(tmp_path / "Logo.mod") in told[0] and f"Logo.mod.bak{'2' * k}" in told[0]
    (tmp_path / "Logo.mod").write_text("v10, by hand")
    (told_now,) = put(tmp_path, {"report.html": "refused"})  # it would be taken for a program of what was refused
    assert "Logo.mod.bak3" in told_now
    assert contents(tmp_path) == {
        "Logo.mod.bak": "v30, by hand",
        "Logo.mod.bak2": "v20, by hand",
        "Logo.mod.bak3": "v10, by hand",
        "report.html": "refused",
    }


def test_a_file_that_was_there_before_is_kept(tmp_path: Path) -> None:
    (tmp_path / "plan.json").write_text("my plans for the summer")
    (tmp_path / MANIFEST).write_text('{"name": "an app of the web"}')
    (tmp_path / "elsewhere").write_text("a drawing")
    (tmp_path / "report.html").symlink_to("elsewhere")
    (tmp_path / "trajectory.csv").symlink_to("nowhere")
    told = put(tmp_path, {"plan.json": "{}", "report.html": "1", "trajectory.csv": "t"})
    assert len(told) == 4
    assert (tmp_path / "plan.json.bak").read_text() == "my plans for the summer"
    assert json.loads((tmp_path / f"{MANIFEST}.bak").read_text()) == {"name": "an app of the web"}
    assert (tmp_path / "elsewhere").read_text() == "a drawing"
    assert (tmp_path / "report.html.bak").is_symlink() and (tmp_path / "trajectory.csv.bak").is_symlink()
    assert not (tmp_path / "report.html").is_symlink() and not (tmp_path / "trajectory.csv").is_symlink()


def test_results_of_another_command_stay(tmp_path: Path) -> None:
    put(tmp_path, {"plan.json": "{}", "report.html": "1"})
    put(tmp_path, {"places.csv": "x,y"}, by="place")
    assert set(listed(tmp_path)) == {"plan.json", "report.html", "places.csv"}
    put(tmp_path, {"plan.json": "{2}"})
    assert contents(tmp_path) == {"plan.json": "{2}", "places.csv": "x,y"}
    assert {name: entry.by for name, entry in listed(tmp_path).items()} == {"plan.json": "solve", "places.csv": "place"}


def test_the_manifest_has_the_digest_of_each_file(tmp_path: Path) -> None:
    put(tmp_path, {"a.csv": "1", "b.mod": "2"})
    assert {name: entry.sha256 for name, entry in listed(tmp_path).items()} == {
        name: digest(tmp_path / name) for name in ("a.csv", "b.mod")
    }


@pytest.mark.parametrize(
    "text",
    [
        "",
        "[" * 100_000,
        "[]",
        '{"format": "beadwise results 1"}',
        '{"format": "beadwise results 1", "files": {"../mine": {"sha256": "a", "by": "solve"}}}',
        '{"format": "beadwise results 1", "files": {"a": {"sha256": 1, "by": "solve"}, "b": [], "c": {"by": "solve"}}}',
    ],
)
def test_a_manifest_that_lists_anything_else_lists_nothing(text: str, tmp_path: Path) -> None:
    (tmp_path / MANIFEST).write_text(text)
    assert listed(tmp_path) == {}


NAMES = ("a.csv", "b.mod", "c.html", "d.json")
FILES = st.dictionaries(st.sampled_from(NAMES), st.sampled_from(["1", "2"]))


@given(
    before=FILES,
    edited=st.sets(st.sampled_from(NAMES)),
    new=FILES,
    fails_at=st.integers(0, 12),
)
def test_a_failure_anywhere_changes_nothing(
    tmp_path_factory: pytest.TempPathFactory,
    before: dict[str, str],
    edited: set[str],
    new: dict[str, str],
    fails_at: int,
) -> None:
    """Of the moves of an exchange any one fails: all is as it was. Where none fails, what was edited is still there."""
    folder = tmp_path_factory.mktemp("results")
    put(folder, before)
    for name in edited:
        (folder / name).write_text("by hand")
    was = contents(folder)
    moves = 0

    def failing(real: Callable[..., None]) -> Callable[..., None]:
        def move(*arguments: object) -> None:
            nonlocal moves
            moves += 1
            if moves == fails_at:
                raise PermissionError(13, "Permission denied")
            real(*arguments)

        return move

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("planner.base.results.os.replace", failing(os.replace))
        patch.setattr("planner.base.results.Path.rename", failing(Path.rename))
        try:
            put(folder, new)
        except OutputError as error:
            assert "there before is unchanged" in str(error)
            assert contents(folder) == was
        else:
            now = contents(folder)
            assert {name: now[name] for name in new} == new
            assert [text for text in now.values() if text == "by hand"] == ["by hand"] * len(edited)
            assert set(now) - set(new) <= {*edited, *(f"{name}.bak" for name in edited)}
    assert not [path for path in folder.iterdir() if path.name.startswith((WRITING, REPLACED))]


KILLED = """
import os, signal, sys
from pathlib import Path
import planner.base.results as results

moves = 0
def killing(real):
    def move(*arguments):
        global moves
        moves += 1
        if moves == {at}:
            os.kill(os.getpid(), signal.SIGKILL)
        return real(*arguments)
    return move

results.os.replace, results.Path.rename = killing(os.replace), killing(Path.rename)
with results.results_folder(Path("out"), "solve") as fresh:
    (fresh / "plan.json").write_text("new")
    (fresh / "Logo.mod").write_text("new")
print("done")
"""


@pytest.mark.slow(keep=("4",))
@pytest.mark.parametrize("at", range(1, 9))
def test_what_a_killed_run_left_is_put_right_by_the_next(at: int, tmp_path: Path) -> None:
    """Old: plan.json, Logo.mod (edited), report.html, the manifest; each move of the exchange is the last thing done."""
    out = tmp_path / "out"
    put(out, {"plan.json": "old", "Logo.mod": "old", "report.html": "old"})
    (out / "Logo.mod").write_text("by hand")
    was = contents(out)
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    done = subprocess.run(
        [sys.executable, "-c", KILLED.format(at=at)], cwd=tmp_path, env=environment, capture_output=True, check=False
    )
    assert done.returncode == -signal.SIGKILL or b"done" in done.stdout, done.stderr
    told: list[str] = []
    with pytest.raises(ZeroDivisionError), results_folder(out, "solve", told.append):
        raise ZeroDivisionError  # the next run comes to nothing, and yet what was there is there again
    if b"done" in done.stdout:
        assert contents(out) == {"plan.json": "new", "Logo.mod": "new", "Logo.mod.bak": "by hand"}
    else:
        assert contents(out) == was
        assert [("the previous ones were restored" in each) for each in told] == [True] * (
            at > 1
        )  # the first writes the journal
    assert not [path for path in out.iterdir() if path.is_dir()]


def test_a_run_that_still_writes_is_left_alone(tmp_path: Path) -> None:
    with results_folder(tmp_path, "solve") as first:
        (first / "plan.json").write_text("first")
        (tmp_path / f"{WRITING}dead").mkdir()
        put(tmp_path, {"plan.json": "second"})
        assert first.is_dir() and not (tmp_path / f"{WRITING}dead").exists()
    assert contents(tmp_path) == {"plan.json": "first"}


@pytest.mark.parametrize("text", ["", "[]", '{"writing": "a", "new": [], "old": [], "kept": {"x": "../precious"}}'])
def test_a_journal_from_elsewhere_moves_nothing(text: str, tmp_path: Path) -> None:
    (tmp_path / "precious").write_text("precious")
    aside = tmp_path / "out" / f"{REPLACED}a"
    aside.mkdir(parents=True)
    (aside / "journal.json").write_text(text)
    with pytest.raises(OutputError, match="in the way"):
        put(tmp_path / "out", {"plan.json": "new"})
    assert (tmp_path / "precious").read_text() == "precious"


def test_a_folder_in_the_way_changes_nothing(tmp_path: Path) -> None:
    put(tmp_path, {"report.html": "1"})
    (tmp_path / "plan.json").mkdir()
    with pytest.raises(OutputError, match="a folder of that name"):
        put(tmp_path, {"plan.json": "{}", "report.html": "2"})
    assert (tmp_path / "report.html").read_text() == "1"


BACKGROUND = """
import os, time
from pathlib import Path
from planner.base.processes import in_background

def work():
    Path("child").write_text(str(os.getpid()))
    time.sleep(60.0)

with in_background(work) as wait:
    wait()
"""
READS_STEP = """
from pathlib import Path
from planner.problem.part import StepSpec
from planner.toolpath.step import files

files._READER = "held_up"
spec = StepSpec.model_construct(file=Path("a.step"), faces="all", sew=0.0, rpy=(0, 0, 0), origin=(0, 0, 0), normals="outward")
files.read_step(spec, 1e-3, lambda *told, **more: RuntimeError(told))
"""
HELD_UP_READER = """
import os, sys, time
from pathlib import Path
from planner.base.isolated import answer

def read(request):
    Path("child").write_text(str(os.getpid()))
    time.sleep(60.0)

sys.exit(answer(read))
"""


@pytest.mark.skipif(sys.platform != "linux", reason="signals at a parent's death, and /proc, as on Linux")
@pytest.mark.parametrize("script", [BACKGROUND, pytest.param(READS_STEP, marks=pytest.mark.slow)], ids=["fork", "STEP"])
def test_a_process_beside_ends_with_its_parent(script: str, tmp_path: Path) -> None:
    """However the parent ends, and although its child would have sent more than the pipe between them holds."""
    (tmp_path / "held_up.py").write_text(HELD_UP_READER)
    (tmp_path / "a.step").write_text("ISO-10303-21;\nEND-ISO-10303-21;\n")
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(ROOT), str(tmp_path)])}
    with subprocess.Popen([sys.executable, "-c", script], cwd=tmp_path, env=environment) as process:
        until = time.monotonic() + 60.0
        while not (tmp_path / "child").is_file() or not (tmp_path / "child").read_text():
            assert process.poll() is None and time.monotonic() < until
            time.sleep(0.02)
        process.kill()
    child = int((tmp_path / "child").read_text())
    until = time.monotonic() + 20.0
    while Path(f"/proc/{child}").exists() and "\nState:\tZ" not in Path(f"/proc/{child}/status").read_text():
        assert time.monotonic() < until
        time.sleep(0.02)
