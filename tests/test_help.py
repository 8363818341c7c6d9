"""Every command's help: one style, 80 columns, examples that the command itself takes; options that are misspelt."""

from __future__ import annotations

import shlex

import pytest

from planner.check import check_command
from planner.command import Command, solve_command
from planner.link.command import link_command
from planner.link.egm import egm_command
from planner.link.stream import stream_command
from planner.listing import columns, shipped
from planner.place import place_command
from planner.register import register_command
from planner.robots import robots_command
from planner.simulate.__main__ import simulate_command

COMMANDS = (
    solve_command,
    check_command,
    place_command,
    register_command,
    robots_command,
    link_command,
    egm_command,
    stream_command,
    simulate_command,
)


@pytest.fixture(params=COMMANDS, ids=lambda make: make.__name__)
def command(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Command:
    monkeypatch.setenv("COLUMNS", "80")
    made: Command = request.param()
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
        words = shlex.split(typed)[3:]
        if "--help" not in words:
            command.parse_args(words)


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
    lines = columns(shipped(), 80)
    assert max(map(len, lines)) <= 80
    assert len(lines) > len(shipped())
    assert len(columns(shipped(), None)) == len(shipped())
