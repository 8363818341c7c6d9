"""Programs through other people's parsers: what they refuse, what interpreters count, and what a missing one is."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import pytest
from export_fixtures import GOLDEN, make_plan
from solved import small_plan

from benchmarks.third_party import __main__ as command
from benchmarks.third_party import run_klipper, run_parsers
from benchmarks.third_party.tools import SYSTEM_PYTHON, TOOLS, Answer, Tool, _debian
from benchmarks.third_party.written import Planned, Written, written

LINUXCNC = next(tool for tool in TOOLS if tool.name == "LinuxCNC")


def spoilt(folder: Path, name: str, old: str, new: str) -> Path:
    text = (GOLDEN / name).read_text(encoding="utf-8")
    assert old in text
    path = folder / name
    path.write_text(text.replace(old, new, 1), encoding="utf-8")
    return path


@pytest.mark.slow(cases=("rapidchecker-TwoArms*",))
@pytest.mark.filterwarnings("ignore::DeprecationWarning")
@pytest.mark.parametrize(
    ("tool", "name", "old", "new"),
    [
        ("rapidchecker", "AskedBead.mod", ",fine,tPen", ",fine tPen"),
        ("rapidchecker", "TwoArms.mod", "\\ID:=7,", "\\ID=7,"),
        ("rapidchecker", "TwoArms_Rob2.mod", "PERS tasks bwTasks{2}", "PERS tasks bwTasks{2"),
        ("tree_sitter_gcode", "two_beads.ngc", "G1 X-8.1393", "G1 X-8..1393"),
    ],
)
def test_a_parser_takes_our_files_and_refuses_spoilt_ones(tmp_path, tool, name, old, new):
    told = run_parsers.TOOLS[tool]([GOLDEN / name])
    assert told["accepted"] and not told["said"]
    told = run_parsers.TOOLS[tool]([spoilt(tmp_path, name, old, new)])
    assert not told["accepted"] and told["said"]


def test_ros_tells_the_time_of_the_last_point():
    told = run_parsers.rosbags([GOLDEN / "two_beads_joint_trajectory.json"])
    assert told["accepted"] and told["time"] == pytest.approx(1.58, abs=1e-9)


def test_programs_are_written_in_all_languages_that_can_say_them(tmp_path):
    found = {each.language: each for each in written(small_plan(), tmp_path)}
    assert {
        "rapid",
        "krl",
        "joint_trajectory",
        "axes linuxcnc",
        "axes reprap",
        "extruder reprap",
        "extruder klipper",
    } <= set(found)
    assert all(each.files or each.reason for each in found.values())
    assert [file.suffix for file in found["axes linuxcnc"].files] == [".ngc"]
    assert not found["fanuc"].files and "moves the arm alone" in found["fanuc"].reason


def test_a_tool_that_is_missing_is_told_and_fails_the_run(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(command, "solve", lambda problem: small_plan())
    assert command.main(["peer_cap", "--python", str(tmp_path / "python"), "--out", str(tmp_path)]) == 3
    assert "make third-party sets it up" in " ".join(capsys.readouterr().out.replace("│", " ").split())
    absent = replace(LINUXCNC, package="no-such-package-of-anybody")
    assert absent.answer(SYSTEM_PYTHON, Written("axes linuxcnc", (GOLDEN / "two_beads.ngc",))).accepted is None


def test_a_tool_that_breaks_refuses(tmp_path):
    broken = Tool("broken", ("rapid",), (".mod",), lambda python, files: [str(python), "-c", "raise OSError('no')"])
    answer = broken.answer(Path(sys.executable), Written("rapid", (GOLDEN / "TwoBeads.mod",)))
    assert answer.accepted is False and answer.said == "ends with: OSError: no"


def test_other_filament_than_planned_fails_the_run():
    planned = Planned.of(make_plan())
    assert command.agrees(Answer("1", True, "", filament=planned.filament + 0.005), planned)
    assert not command.agrees(Answer("1", True, "", filament=planned.filament + 0.02), planned)
    assert not command.agrees(Answer("1", False, ""), planned)


def test_steps_that_klipper_sends_become_filament():
    sent = (
        "set_next_step_dir oid=1 dir=1\nqueue_step oid=1 interval=9 count=3200 add=0\n"
        "set_next_step_dir oid=1 dir=0\nqueue_step oid=1 interval=9 count=800 add=-2\n"
    )
    assert run_klipper.filament(sent) == pytest.approx(0.75 * run_klipper.LEAD)


@pytest.mark.skipif(_debian("linuxcnc-uspace") is None, reason="LinuxCNC is not installed")
def test_linuxcnc_counts_time_and_filament(tmp_path):
    program = Written("axes linuxcnc", (GOLDEN / "two_beads.ngc",))
    answer = LINUXCNC.answer(SYSTEM_PYTHON, program)
    assert answer.accepted and answer.time == pytest.approx(1.688, abs=1e-3)
    bad = spoilt(tmp_path, "two_beads.ngc", "G64 P0.0500", "G64 P")
    answer = LINUXCNC.answer(SYSTEM_PYTHON, Written("axes linuxcnc", (bad,)))
    assert answer.accepted is False and answer.said.startswith("line ")
