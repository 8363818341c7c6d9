"""Attacks on plans and programs: each is a change, and what is not found is judged by what it does."""

from __future__ import annotations

import random

import numpy as np
import pytest
from solved import small_plan

from benchmarks.attack import FEEDS, MOVES, fed_otherwise, main, played_otherwise, spoilt_lines, spoilt_plan
from planner.export.extruder import gcode
from planner.export.rapid.writer import rapid_files
from planner.plan.seal import changed_since


def test_every_attack_changes_something() -> None:
    plan, by = small_plan(), random.Random(3)
    text = gcode(plan)
    module = next(text for name, text in rapid_files(plan).items() if name.endswith(".mod"))
    for _ in range(60):
        assert changed_since(spoilt_plan(plan, by)[1])
        assert spoilt_lines(module, by, MOVES)[1] != module
        assert spoilt_lines(text, by, FEEDS)[1] != text


def test_filament_is_told_apart_by_amount_time_and_waits() -> None:
    text = "M577 P1 S1\nG1 E1.0 F60\nG4 P500\nG1 E2.0 F60\nM577 P1 S0\n"
    assert fed_otherwise(text, text) == 0.0
    assert fed_otherwise(text, text.replace("E2.0", "E2.5")) == pytest.approx(0.5)
    assert fed_otherwise(text, text.replace("G4 P500\n", "") + "G4 P500\n") == pytest.approx(0.5)
    assert fed_otherwise(text, text.replace("P1 S1", "P2 S1")) == np.inf


def test_a_program_is_told_apart_by_path_time_and_outputs() -> None:
    plan = small_plan()
    files = rapid_files(plan)
    name = next(name for name in files if name.endswith(".mod"))
    assert played_otherwise(plan, files, files) == ""
    slow = files | {name: files[name].replace("vel40:=[40,", "vel40:=[20,")}
    assert "in time" in played_otherwise(plan, files, slow)
    flipped = files | {name: files[name].replace("trgOn,0\\DOp:=doExtrude,1", "trgOn,0\\DOp:=doExtrude,0")}
    assert "outputs differ" in played_otherwise(plan, files, flipped)


def test_an_unknown_kind_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["plan"])
    assert ended.value.code == 2 and "there is no kind 'plan'" in capsys.readouterr().err
