"""Every command's help: one style, 80 columns, examples that the command itself takes; options that are misspelt."""

from __future__ import annotations

import io
import shlex
from pathlib import Path

import pytest
from rich.console import Console

from planner.base.command_line import Command
from planner.base.completion import parsers
from planner.base.progress import Stages
from planner.planning.options import solve_command
from planner.problem.describe import columns, shipped

ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture(params=parsers(), ids=lambda each: each.prog.removeprefix("python -m planner."))
def command(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Command:
    monkeypatch.setenv("COLUMNS", "80")
    made: Command = request.param
    return made


def test_help_has_80_columns_examples_and_exit_codes(command: Command) -> None:
    text = command.format_help()
    assert max(map(len, text.splitlines())) <= 80
    assert "examples:\n  python -m planner." in text
    assert "exit codes:\n  0 " in text
    assert {0, 2} <= set(command.codes)


def test_every_option_says_what_it_is(command: Command) -> None:
    assert [action.dest for action in command._actions if not action.help and action.dest != "kind"] == []


def test_examples_are_taken(command: Command) -> None:
    for typed in command.examples:
        words = shlex.split(
            typed.removeprefix(command.prog).partition(" > ")[0]
        )  # what a shell redirects is none of it
        if "--help" not in words:
            command.parse_args(words)


def test_every_command_is_listed() -> None:
    """Whatever can be started with `python -m planner.` is on the page of commands."""
    known = {each.prog.removeprefix("python -m planner.").split()[0] for each in parsers()}
    can = set()
    for path in sorted((ROOT / "planner").rglob("*.py")):
        if '__name__ == "__main__"' in path.read_text(encoding="utf-8"):
            can.add(".".join(path.relative_to(ROOT / "planner").with_suffix("").parts).removesuffix(".__main__"))
    assert known <= can
    assert can - known == {
        "problem.cad_curves",
        "problem.cad_facets",
        "report.picture",
        "toolpath.step.reader",
        "verify.reread.curve_process",
        "verify.reread.step_process",
        "view.child",
    }  # not typed by users


def test_the_version_is_told(command: Command, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        command.parse_args(["--version"])
    assert ended.value.code == 0
    assert capsys.readouterr().out.startswith("beadwise ")


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["peer_cap", "--strtegy", "sqp"], "did you mean --strategy?"),
        (["peer_cap", "--strategy", "lader"], "did you mean ladder?"),
        (["peer_cap", "--tolerance", "2"], "--tolerance"),
    ],
)
def test_what_was_meant(options: list[str], said: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        solve_command().parse_args(options)
    assert ended.value.code == 2
    assert said in capsys.readouterr().err


def test_the_list_of_problems_says_what_each_is() -> None:
    rows = {row.name: row for row in shipped()}
    assert rows["cylinder_logo"][1:4] == ("irb140", "irbp_a250", "cylinder")
    assert rows["hemisphere_honeycomb"].held_by == "bed"
    for row in rows.values():
        assert len(row.what) > 20
        assert "Lengths are" not in row.what and not row.what.startswith(("yaml", "#"))


def test_columns_are_wrapped_to_a_terminal() -> None:
    rows = [
        ("name", "arm", "bed", "sphere", "a honeycomb on a dome, printed by an arm that stands beside its bed " * 2)
    ]
    rows.append(("longer_name", "irb140", "irbp_a250", "corrugation", "short"))
    for width in (60, 80, 120):
        lines = columns(rows, width)
        assert max(map(len, lines)) <= width
        assert len(lines) > len(rows)
    assert [line.split()[0] for line in columns(rows, None)] == ["name", "longer_name"]


@pytest.mark.parametrize("terminal", [True, False])
def test_bars_are_for_terminals(terminal: bool) -> None:
    stream = io.StringIO()
    with Stages(Console(file=stream, force_terminal=terminal)) as stages, stages.stage("load"):
        pass
    assert bool(stream.getvalue()) == terminal
    assert list(stages.seconds) == ["load"]
