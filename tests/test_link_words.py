"""What the link reads: lines from the wire, and the table beside a program."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from planner import link
from planner.base.errors import InputError
from planner.link.messages import (
    LONGEST_LINE,
    End,
    Framer,
    Garbage,
    Hello,
    Line,
    Ok,
    Remark,
    Resend,
    Stopped,
    Trouble,
    from_board,
    from_controller,
    stop,
)
from planner.link.program_lines import ProgramLine, read_program_lines
from planner.link.telling import going_on


@settings(max_examples=60, deadline=None)
@given(st.lists(st.text(st.characters(min_codepoint=32, max_codepoint=126), max_size=90), max_size=8), st.data())
def test_lines_come_whole_whatever_the_pieces(texts: list[str], data: st.DataObject) -> None:
    whole = b"".join(text.encode() + data.draw(st.sampled_from([b"\n", b"\r\n"])) for text in texts)
    framer, found = Framer(), []
    while whole:
        size = data.draw(st.integers(1, len(whole)))
        lines, wrong = framer.lines(whole[:size])
        assert wrong is None
        found += lines
        whole = whole[size:]
    assert found == texts


@settings(max_examples=100, deadline=None)
@given(st.binary(max_size=600))
def test_any_bytes_are_lines_or_garbage(data: bytes) -> None:
    """Never another exception, never an endless buffer."""
    lines, wrong = Framer().lines(data)
    clean = all(len(part) <= LONGEST_LINE for part in data.split(b"\n"))
    assert wrong is not None or (clean and len(lines) == data.count(b"\n"))
    for text in lines:
        from_board(text)
        try:
            from_controller(text)
        except Garbage as error:
            assert len(str(error)) < 400


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("H Cup 12", Hello("Cup", 12)),
        ("L 12 G1 E0.125 F300", Line(12, "G1 E0.125 F300")),
        ("L 1 M83", Line(1, "M83")),
        ("L 7 T1", Line(7, "T1")),
        ("L 7 G38.2 Z1", Line(7, "G38.2 Z1")),
        ("E 0", End(0)),
        ("X 3 no A for 2 s", Stopped(3, "no A for 2 s")),
    ],
)
def test_the_controller(text: str, message: object) -> None:
    assert from_controller(text) == message


@pytest.mark.parametrize(
    "text",
    [
        "", "L", "L 1", "L 1 ", "L 01 M83", "L 1  M83", "L 1 m83", "L 1 N1 M83", "L 1 M83*12", "L 1 M83;now", "L 123456789 M83",
        "L 1 M117 " + "x" * 70, "H 1Cup 3", "H Cup", "H Cup -1", "H Cup 1e3", "E", "E 1 ", "l 1 M83", "A 1", "X 1",
        "H " + "C" * 33 + " 1", "L ١ M83", "M83",
    ],
)  # fmt: skip
def test_what_the_controller_may_not_say(text: str) -> None:
    with pytest.raises(Garbage):
        from_controller(text)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("ok", Ok(None)),
        ("ok N17", Ok(17)),
        ("ok N17 P15 B3", Ok(17)),
        ("ok T:205.0 /205.0", Ok(None)),
        ("Resend: 17", Resend(17)),
        ("Resend:17", Resend(17)),
        ("rs 17", Trouble("rs 17")),
        ("Resend: all", Trouble("Resend: all")),
        ("Error: Heater 1 fault", Trouble("Error: Heater 1 fault")),
        ("!!", Trouble("!!")),
        ("okay", Remark("okay")),
        ("FIRMWARE_NAME: RepRapFirmware", Remark("FIRMWARE_NAME: RepRapFirmware")),
        ("", Remark("")),
    ],
)
def test_the_board(text: str, message: object) -> None:
    assert from_board(text) == message


def test_a_stop_is_one_short_line() -> None:
    assert stop("é\n" + "x" * 200) == b"S ??" + b"x" * 33 + b"\n"


TABLE = "n,bead,layer,t_s,text\n1,-1,-1,0.000,M83\n2,0,0,1.500,G1 E0.1 F300\n3,0,0,1.500,G1 E0.2\n"


def written(folder: Path, text: str) -> Path:
    (folder / "Cup_lines.csv").write_text(text, encoding="utf-8")
    return folder / "Cup.mod"


def test_a_line_may_have_commas(tmp_path: Path) -> None:
    assert read_program_lines(written(tmp_path, TABLE.replace("M83", 'M117 "a, b"')))[1].text == 'M117 "a, b"'


def test_the_table(tmp_path: Path) -> None:
    lines = read_program_lines(written(tmp_path, TABLE))
    assert (lines.module, len(lines), lines[2]) == ("Cup", 3, ProgramLine(2, 0, 0, 1.5, "G1 E0.1 F300"))


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("2,0,0,1.500", "3,0,0,1.500", ":3: n: 3 where 2 is due"),
        ("2,0,0,1.500", "2,x,0,1.500", ":3: bead: 'x' is not a whole number"),
        ("2,0,0,1.500", "2,-2,0,1.500", ":3: bead: less than -1"),
        ("2,0,0,1.500", "2,--1,0,1.500", ":3: bead: '--1' is not a whole number"),
        ("2,0,0,1.500", "2,0,0,nan", ":3: t_s: 'nan' is not a time"),
        ("3,0,0,1.500", "3,0,0,1.4", ":4: t_s: '1.4' is not a time from 1.5 s on"),
        ("2,0,0,1.500", "2,0,1.500", ":3: 4 columns, not 5"),
        ("G1 E0.2", "", ":4: text: '' is no line for the board"),
        ("G1 E0.2", "M117 é", ":4: text"),
        ("G1 E0.2", "M117 " + "x" * 70, ":4: text"),
        ("n,bead", "n;bead", ":1: the first line is not n,bead,layer,t_s,text"),
        (TABLE, "n,bead,layer,t_s,text\n", "holds 0 lines"),
        (TABLE, "", ":1: the first line"),
        ("G1 E0.2", "G1 E0.2 ; slowly", ":4: text"),
        ("G1 E0.2", "G1 E0.2*31", ":4: text"),
        ("G1 E0.2", "N3 G1 E0.2", ":4: text"),
    ],
)
def test_a_wrong_table_is_refused(tmp_path: Path, old: str, new: str, words: str) -> None:
    with pytest.raises(InputError) as caught:
        read_program_lines(written(tmp_path, TABLE.replace(old, new)))
    assert words in str(caught.value) and "Cup_lines.csv" in str(caught.value)


def test_a_program_without_its_table(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"there is no file .*Cup_lines.csv .*socket"):
        read_program_lines(tmp_path / "Cup.mod")


def test_only_the_demo_knows_of_the_simulators() -> None:
    for path in Path(link.__file__).parent.glob("*.py"):
        known = {
            word
            for word in ("planner.simulate", "planner.planning.solve_command")
            if f"from {word}" in path.read_text("utf-8")
        }
        assert bool(known) == (path.name == "demo.py"), path.name


def test_prints_that_were_made_in_python_are_gone_on_with_there() -> None:
    plan = {"problem": "cup", "problem_file": "cup.yaml", "strategy": "sqp", "settings": {"overrides": []}}
    command = "to go on: python -m planner.solve cup.yaml --from-bead 3 --strategy sqp"
    assert going_on(plan, "PROBLEM").lines(3) == [command]
    own = {"settings": {"overrides": [], "terms": ["keep_away"]}}
    for change in ({"problem_file": None}, {"strategy": "mine"}, own):
        (line,) = going_on(plan | change, "PROBLEM").lines(3)
        assert "solve(..., first_bead=3) in Python" in line
