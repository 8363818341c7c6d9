"""Folders of other people's files: a row for each whatever happens, and exit code 1 only for a crash."""

from __future__ import annotations

import csv
from pathlib import Path

import pytest

from benchmarks.files_tried import EXIT_CRASHED, Found, try_all
from planner.base.errors import EXIT_VERIFIED, InputError


def trial(path: Path) -> Found:
    if path.stem == "bad":
        raise InputError("is no drawing", file=path)
    if path.stem == "worse":
        raise ZeroDivisionError
    return "made", {"beads": 3}, "a note"


def test_every_file_has_a_row(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for name in ("good.dxf", "bad.dxf", "notes.txt"):
        (tmp_path / name).write_text("")
    table = tmp_path / "out" / "rows.csv"
    assert try_all(tmp_path, (".dxf",), trial, table) == EXIT_VERIFIED
    with table.open(encoding="utf-8") as stream:
        bad, good = csv.DictReader(stream)
    assert (good["verdict"], good["beads"], good["told"]) == ("made", "3", "a note")
    assert (bad["verdict"], bad["beads"]) == ("refused", "") and "is no drawing" in bad["told"]
    assert capsys.readouterr().out.splitlines()[-1] == "1 made, 1 refused"
    (tmp_path / "worse.dxf").write_text("")
    assert try_all(tmp_path, (".dxf",), trial, None) == EXIT_CRASHED


def test_a_folder_that_holds_none_is_refused(tmp_path: Path) -> None:
    for folder, words in ((tmp_path, "holds no such files"), (tmp_path / "none", "no such folder")):
        with pytest.raises(InputError, match=words):
            try_all(folder, (".dxf",), trial, None)
