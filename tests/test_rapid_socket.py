"""Style `socket`: which lines the program sends, where, and what is found when they are tampered with."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from export_fixtures import FILAMENT, GOLDEN, MATERIALS, make_plan, problem, socket_plan

from planner.base.errors import InputError
from planner.export.languages import LANGUAGES
from planner.export.rapid.reader import read_rapid
from planner.export.rapid.writer import rapid_files
from planner.problem.settings import ProgramSpec

RAPID = LANGUAGES["rapid"]


def lines_of(table):
    rows = [row.split(",") for row in table.splitlines()]
    assert rows[0] == ["n", "bead", "layer", "t_s", "text"]
    return [(int(n), int(bead), int(layer), float(t), text) for n, bead, layer, t, text in rows[1:]]


@pytest.mark.parametrize("name", ["OneBead.mod", "OneBead_lines.csv"])
def test_golden_file(name):
    assert rapid_files(socket_plan())[name] == (GOLDEN / name).read_text(encoding="utf-8")


@pytest.mark.parametrize("materials", [(), ("pla", "pva")])
def test_lines_have_the_filament_and_the_time_of_their_segments(materials):
    plan = make_plan(materials=materials)
    plan = replace(plan, problem=problem(materials=MATERIALS if materials else None, style="socket"))
    files = RAPID.write(plan)
    assert RAPID.differences(plan, files) == []
    t = plan.trajectory
    rows = lines_of(files["TwoBeads_lines.csv"])
    assert [n for n, *_ in rows] == list(range(1, len(rows) + 1)) and rows[0][4] == "M83"
    for bead in (0, 1):
        own = [(at, text) for _, which, _, at, text in rows if which == bead and text != "G1 E5.00000 F300.000"]
        amounts = np.array([re.fullmatch(r"G1 E([\d.]+) F([\d.]+)", text).groups() for _, text in own], dtype=float)
        took = amounts[:, 0] / amounts[:, 1] * 60.0
        samples = np.flatnonzero(t.bead == bead)
        assert took.min() >= 0.02 - 1e-3  # no more than 50 lines a second
        assert took.sum() == pytest.approx(t.t[samples[-1]] - t.t[samples[0]], abs=2e-3)
        starts = np.array([at for at, _ in own])
        assert np.abs(np.diff(starts) - took[:-1]).max() < 2e-3  # the next line is sent as this one is over
        diameter = {"pva": 2.85e-3}.get(materials[bead] if materials else "", FILAMENT)
        volume = t.extruded[samples[-1] + 1] - t.extruded[samples[0] - 1]
        assert amounts[:, 0].sum() == pytest.approx(1e3 * volume / (np.pi * diameter**2 / 4.0), abs=1e-4)


def test_reader_says_what_is_sent_where_and_when():
    plan = socket_plan()
    program = read_rapid(rapid_files(plan)["OneBead.mod"])
    rows = lines_of(rapid_files(plan)["OneBead_lines.csv"])
    assert [text for move in sorted(program.sends) for text in program.sends[move]] == [row[4] for row in rows]
    (cut,) = [move for move, texts in program.sends.items() if "M106 P0 S1" in texts]
    at = program.sends[cut].index("M106 P0 S1")
    # 1 s of rest, the cutter's second, and 1 s of rest, on the bead
    assert program.sends[cut][at : at + 4] == ("M106 P0 S1", "G4 P500", "M106 P0 S0", "G4 P500")
    assert program.send_rests[cut][at] == pytest.approx(1.0) and program.wait[cut] == pytest.approx(3.0)
    assert program.fine[cut] and program.linear[cut]
    heat = program.sends[0]
    assert heat == ("M83", "T0", "M140 S60", "M104 S200", "M190 S60", "M109 S200")
    assert program.wait[0] == pytest.approx(4.0)
    # whatever the board acknowledges late is waited for before anything else is sent
    text = rapid_files(plan)["OneBead.mod"]
    assert '        BwLine 6,"M109 S200";\n        WaitTime 4.000;\n        BwSettle 900;\n' in text
    assert re.search(
        r' {8}BwLine \d+,"G4 P500";\n {8}WaitTime 1\.000;\n {8}BwSettle 900;\n {8}WaitTime 1\.000;\n', text
    )


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_a_foreign_parser_accepts_the_program(monkeypatch):
    config = pytest.importorskip("rapidchecker.config")
    monkeypatch.setattr(config.CONFIG, "indentation_size", 4)
    check = pytest.importorskip("rapidchecker.check")
    whitespace = pytest.importorskip("rapidchecker.whitespace_checks")
    text = rapid_files(socket_plan())["OneBead.mod"]
    assert "MoveC " in text and "TriggC " in text
    for move in re.findall(r" *Move[JL] .*\n", text)[1:]:  # it takes 50 ms a target, and all are alike
        text = text.replace(move, "")
    text = text.replace(re.findall(r" *MoveC .*\n", text)[0], "")
    assert check.check_format(text) == []
    assert whitespace.check_whitespace(text) == []


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('BwLine 3,"', 'BwLine 4,"', "out of order"),
        ("        BwOpen;\n", "", "out of order"),
        ("        BwEnd;\n", "", "opened once and closed once"),
        ("bwSent-bwTaken>=16", "bwSent-bwTaken>=17", "instead of"),
        ("        StopMove;", "        ! StopMove;", "instead of"),
        ('"127.0.0.1",1025', '"1127.0.0.1",1025', "that is not allowed"),
        ('"127.0.0.1",1025', '"127.0.0.1",8080', "that is not allowed"),
        ("    VAR bool bwGo:=FALSE;\n", "", "the socket's variables"),
        ('"M83"', '"M83;"', "unknown statement"),
        ('"M83"', '"' + "M" * 61 + '"', "unknown statement"),
        ('"M83"', '"M83\\0A"', "unknown statement"),
    ],
)
def test_reader_refuses_another_socket(old, new, message):
    text = rapid_files(socket_plan())["OneBead.mod"]
    assert old in text
    with pytest.raises(InputError, match=message):
        read_rapid(text.replace(old, new, 1))


@pytest.mark.parametrize(
    ("pattern", "new", "difference"),
    [
        (r'"G1 E0\.\d+ F', '"G1 E0.90000 F', "mm of filament"),
        (r'"M106 P0 S1"', '"M106 P0 S0"', "other orders"),
        (r'"M109 S200"', '"M109 S250"', "other orders"),
    ],
)
def test_lines_that_say_something_else_are_found(pattern, new, difference):
    plan = socket_plan()
    files = RAPID.write(plan)
    text = files["OneBead.mod"]
    assert re.search(pattern, text)
    spoilt = files | {"OneBead.mod": re.sub(pattern, new, text, count=1)}
    found = RAPID.differences(plan, spoilt)
    assert any(difference in each for each in found) and any("table" in each for each in found)


def test_a_line_at_the_wrong_place_is_found():
    """The bead's first line is sent a run-in too early; the amounts are right."""
    plan = socket_plan()
    files = RAPID.write(plan)
    moved = re.sub(r"( *TriggL .*trgOn,.*\n)( *BwLine .*\n)", r"\2\1", files["OneBead.mod"])
    assert moved != files["OneBead.mod"]
    (found,) = RAPID.differences(plan, files | {"OneBead.mod": moved})
    assert "too early or too late" in found


@pytest.mark.parametrize("address", ["", "localhost", "1.2.3", "1.2.3.4.5", "::1", 5, "1.2.3.999"])
def test_only_addresses_are_bound(address):
    with pytest.raises(ValueError, match="is not an address"):
        ProgramSpec(socket={"address": address})
    assert ProgramSpec(socket={"address": "192.168.125.1"}).socket.address == "192.168.125.1"


@pytest.mark.parametrize(
    "name", ["bwLine", "Bead1", "Bead1Part2", "main", "vel40", "trgOn", "tool0", "wobj0", "fine", "V100", "z0"]
)
def test_names_of_the_program_s_own_are_refused(name):
    with pytest.raises(ValueError, match="of the program's own"):
        ProgramSpec(tool=name)
