"""The demo: a report that ships, opened in a browser where there is one."""

from __future__ import annotations

import webbrowser
from pathlib import Path

import pytest

from planner.base.launch import COMMANDS
from planner.report.demo import NEXT, PROBLEM, SHIPPED, main, shipped_report


def test_the_report_is_shown(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[str] = []
    monkeypatch.setattr(webbrowser, "open", lambda address: bool(asked.append(address)) or True)
    assert main(["--out", str(tmp_path / "demo")]) == 0
    report = tmp_path / "demo" / "report.html"
    assert asked == [report.as_uri()]
    assert report.read_bytes() == shipped_report()
    out = capsys.readouterr().out
    assert str(report) in out
    assert [line.split("  ")[1] for line in out.splitlines()[2:]] == [command for command, _ in NEXT]


def test_without_a_browser_it_says_where(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(webbrowser, "open", lambda address: False)
    assert main(["--out", str(tmp_path / "demo")]) == 0
    assert f"open {tmp_path / 'demo' / 'report.html'}" in capsys.readouterr().out


def test_a_folder_that_cannot_be_written(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    assert main(["--out", str(tmp_path / "file" / "demo"), "--no-browser"]) == 2


def test_what_ships_is_a_verified_report_and_small() -> None:
    text = shipped_report().decode("utf-8")
    assert "<h1" in text and PROBLEM in text
    assert "NOT verified" not in text
    assert SHIPPED.stat().st_size < 3_000_000


def test_the_commands_that_follow_exist() -> None:
    assert all(command.split()[1] in COMMANDS for command, _ in NEXT)
