"""Where a run stands by its log: as the run itself told it, whatever is cut off; logs of other programs are refused."""

from __future__ import annotations

import json
import shlex
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from link_ends import as_results, program
from link_servers import BoardEnd, ControllerEnd
from simulate_fixtures import MODULE
from test_link_sockets import Session

from planner.base.errors import InputError
from planner.base.results import digest
from planner.link.command import main
from planner.link.logged import UNSAID, outcome_of, plan_in
from planner.link.program_lines import ProgramLines
from planner.link.telling import for_the_log, going_on

PROGRAM = program()
TOTAL = len(PROGRAM)


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The log of a run that was printed."""
    path = tmp_path_factory.mktemp("log") / "whole.jsonl"
    assert Session(path, ControllerEnd(PROGRAM), BoardEnd()).run().reason is None
    return path


@pytest.mark.parametrize(
    ("end", "fault", "at"), [("board", "close", 9), ("board", "error", 17), ("controller", "gives up", 30)]
)
def test_it_tells_what_the_run_told(tmp_path: Path, end: str, fault: str, at: int) -> None:
    controller = ControllerEnd(PROGRAM, fault if end == "controller" else None, at)
    board = BoardEnd(fault=fault if end == "board" else None, at=at)
    told = Session(tmp_path / "log.jsonl", controller, board).run()
    assert outcome_of(PROGRAM, tmp_path / "log.jsonl") == replace(told, safe=False)


def test_a_printed_one_is_done(whole: Path) -> None:
    found = outcome_of(PROGRAM, whole)
    assert (found.reason, found.position.n, found.position.resume, found.safe) == (None, TOTAL, None, True)


def test_one_whose_program_was_not_heard_to_end_is_not_done(tmp_path: Path, whole: Path) -> None:
    """Its last line was acknowledged as the robot set out on the stretch of it."""
    rows = [row for row in whole.read_text().splitlines() if '"what": "end"' not in row]
    (tmp_path / "log.jsonl").write_text("\n".join([*rows, ""]))
    found = outcome_of(PROGRAM, tmp_path / "log.jsonl")
    assert (found.reason, found.position.n, found.safe) == (UNSAID, TOTAL, False)


@settings(max_examples=60, deadline=None)
@given(st.data())
def test_a_log_that_is_cut_off_anywhere_tells_as_much_as_it_holds(whole: Path, data: st.DataObject) -> None:
    """As when the power fails: what was acknowledged is never more than there was, and never less than is there."""
    raw = whole.read_bytes()
    size = data.draw(st.integers(0, len(raw)))
    cut = whole.with_name("cut.jsonl")
    cut.write_bytes(raw[:size])
    held = [json.loads(row) for row in raw[:size].split(b"\n") if row.endswith(b"}")]
    last = max([record["n"] for record in held if record["what"] == "acknowledged"], default=0)
    ended = any(record["what"] == "end" for record in held)
    found = outcome_of(PROGRAM, cut)
    assert found.position.n == last
    assert found.reason == (None if last == TOTAL and ended else UNSAID)


def other_module(text: str) -> str:
    return text.replace('"text": "Cup"', '"text": "Bowl"')


def other_line(text: str) -> str:
    return text.replace("G1 E0.105 F300", "G1 E9.105 F300")


def line_lost(text: str) -> str:
    return "\n".join(row for row in text.split("\n") if '"received", "n": 7,' not in row)


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (other_module, "is the log of another program: it is of Bowl, not of Cup"),
        (other_line, "is the log of another program: line 8 is 'G1 E9.105 F300' there, and 'G1 E0.105 F300' in"),
        (line_lost, "is the log of another program: line 8 is"),
        (lambda text: text.replace('"n": 12,', '"n": 99,'), "is the log of another program: line 99 of 39"),
        (lambda text: text.replace('"what": "sent"', '"what": "kept"'), "were acknowledged that were not sent"),
        (lambda text: "not json\n" + text, "is not a record of the link's log"),
        (lambda text: "n,bead,layer,t_s,text\n1,0,0,0,M83\n2,0,0,1,M84\n", "is not a record of the link's log"),
    ],
)  # fmt: skip
def test_logs_of_something_else_are_refused(tmp_path: Path, whole: Path, spoil, words: str) -> None:  # type: ignore[no-untyped-def]
    path = tmp_path / "log.jsonl"
    path.write_text(spoil(whole.read_text()))
    with pytest.raises(InputError, match=words) as caught:
        outcome_of(PROGRAM, path)
    assert caught.value.exit_code == 2 and caught.value.file == path


def test_the_command(tmp_path: Path, whole: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """It tells where to go on, from the log alone; nothing is asked of a machine."""
    made = write_program(tmp_path, PROGRAM)
    log = tmp_path / "log.jsonl"
    rows = whole.read_text().splitlines()
    at = next(k for k, row in enumerate(rows) if '"acknowledged", "n": 15,' in row)
    log.write_text("\n".join(rows[: at + 1]) + "\n")
    assert main([str(made), "--where", str(log)]) == 3
    said = capsys.readouterr().err
    assert f"stopped: {UNSAID}; last acknowledged line 15 of {TOTAL} (bead 1, layer 0)" in said
    assert "to go on: python -m planner.solve cup_7 --from-bead 1, with the same" in said
    plan = tmp_path / "plan.json"
    held = {
        "problem": "cup",
        "problem_file": "my cup.yaml",
        "strategy": "ladder",
        "settings": {"overrides": ["layers.count=2"]},
    }
    plan.write_text(json.dumps(json.loads(plan.read_text("utf-8")) | held), "utf-8")
    assert main([str(made), "--where", str(log)]) == 3
    said = capsys.readouterr().err
    assert "planner.solve 'my cup.yaml' --from-bead 1 --strategy ladder --set layers.count=2\n" in said
    # since that run the folder has got the plan of the next part
    note = for_the_log(held | {"problem_file": "cup 17.yaml", "checks": []})
    ran = {"utc": "2026-11-27T18:15:00.000+00:00", "ms": 1.0, "what": note.what, "n": note.n, "text": note.text}
    log.write_text("\n".join([json.dumps(ran), *rows[: at + 1]]) + "\n")
    assert set(json.loads(note.text)) == {"problem", "problem_file", "strategy", "settings"}
    assert main([str(made), "--where", str(log)]) == 3
    assert "planner.solve 'cup 17.yaml' --from-bead 1 --strategy ladder" in capsys.readouterr().err
    assert plan_in(whole) == plan_in(tmp_path / "none.jsonl") == {}
    assert main([str(made), "--where", str(whole)]) == 0
    log.write_text(other_module(whole.read_text()))
    assert main([str(made), "--where", str(log)]) == 2
    assert "is the log of another program" in capsys.readouterr().err
    assert main([str(made), "--where", str(tmp_path / "none.jsonl")]) == 2
    with pytest.raises(SystemExit) as stopped:
        main(["--where", str(log)])
    assert stopped.value.code == 2


def test_a_problem_that_was_changed_since_is_told(tmp_path: Path) -> None:
    """Its beads may count otherwise: the one to go on from may lie elsewhere."""
    file = tmp_path / "cup.yaml"
    file.write_text("name: cup\n")
    plan = {
        "problem": "cup",
        "problem_file": file.as_posix(),
        "problem_sha256": digest(file),
        "strategy": "ladder",
        "settings": {"overrides": []},
    }
    planned = going_on(plan, "cup")
    command = f"to go on: python -m planner.solve {shlex.quote(str(file))} --from-bead 3 --strategy ladder"
    assert planned.lines(3) == [command]
    file.write_text("name: cup\nstrategy: sqp\n")
    told = f"{file} was changed since it was planned: bead 3 may be a different one; restore the file"
    assert planned.lines(3) == [told, command]
    assert going_on(plan | {"problem_sha256": None}, "cup").lines(3) == [command]
    file.unlink()
    assert planned.lines(3) == [command]


def write_program(folder: Path, lines: ProgramLines) -> Path:
    """A module that says hello for lines, and their table."""
    made = folder / f"{lines.module}.mod"
    hello = f'        SocketSend bwClient\\Str:="H {lines.module} {len(lines)}\\0A";\n'
    head = f"MODULE {lines.module}\n    ! Problem cup_7, strategy sqp\n"
    made.write_text(MODULE.replace("MODULE Made\n", head, 1).replace("PROC main()\n", f"PROC main()\n{hello}", 1))
    rows = [f"{line.n},{line.bead},{line.layer},{line.t:.3f},{line.text}" for line in lines.lines]
    (folder / f"{lines.module}_lines.csv").write_text("\n".join(["n,bead,layer,t_s,text", *rows, ""]))
    as_results(folder)
    return made
