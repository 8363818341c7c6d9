"""Lock files and the page of licences are those of what is installed, and advisories that nobody answered are not "none"."""

from __future__ import annotations

import json
import sys
from importlib.metadata import distribution
from pathlib import Path

import pytest

from benchmarks import dependencies
from benchmarks.dependencies import COPYLEFT, PAGE, PURPOSES, RUNNING, STATED, TESTING, WITHIN, licence_of, pinned

TEST_TOOLS = {"pytest", "mypy", "ruff", "playwright", "hypothesis", "rapidchecker", "nbclient", "build", "ipykernel"}


NOT_HERE = {"cadquery-ocp-novtk", "euclid3"}  # no licence files in its wheel; not installed


def rows_of(lock: str) -> list[list[str]]:
    """The cells of a lock file's table on the page."""
    part = PAGE.read_text(encoding="utf-8").partition(f"## {PURPOSES[lock][0]}\n")[2].partition("\n## ")[0]
    lines = [line for line in part.splitlines() if line.startswith("| ") and not line.startswith("| package |")]
    return [[cell.strip() for cell in line.split("|")[1:-1]] for line in lines]


def test_the_lock_for_running_has_no_test_tools_and_neither_file_what_the_other_has() -> None:
    running, testing = pinned(RUNNING), pinned(TESTING)
    assert set(testing) >= TEST_TOOLS and not TEST_TOOLS & set(running)
    assert not set(running) & set(testing)
    assert (dependencies.ROOT / TESTING).read_text(encoding="utf-8").startswith(f"-r {RUNNING}\n")


def test_lock_files_hold_all_that_the_project_needs() -> None:
    """By name: with other releases than the lock's (`make test-floors`) names are the same but for what these need."""
    texts = dependencies.lock_texts()
    if not as_locked():
        pytest.skip("not the lock's versions are installed")
    for lock, text in texts.items():
        assert [line.partition("==")[0] for line in text.splitlines()] == [
            line.partition("==")[0] for line in (dependencies.ROOT / lock).read_text(encoding="utf-8").splitlines()
        ]


def as_locked() -> bool:
    """Whether the locks' versions are installed, those of the environment's own tools apart."""
    pins = {**pinned(RUNNING), **pinned(TESTING)}
    return all(distribution(name).version == version for key, (name, version) in pins.items() if key != "setuptools")


@pytest.mark.parametrize("lock", PURPOSES)
def test_the_page_lists_each_package_of_each_lock(lock: str) -> None:
    assert [(name, version) for name, version, *_ in rows_of(lock)] == [pin for _, pin in sorted(pinned(lock).items())]


@pytest.mark.slow
@pytest.mark.parametrize("lock", [RUNNING, TESTING])
def test_the_page_has_the_licences_of_what_is_installed(lock: str) -> None:
    compared = 0
    purposes = dependencies.needed_for()
    for name, version, licence, purpose in rows_of(lock):
        found = distribution(name)
        if found.version == version:
            assert licence == licence_of(name, found.metadata.json), name
            compared += 1
        assert purpose == purposes[dependencies.canonicalize_name(name)], name
    assert compared >= 60 or not as_locked()


def test_every_package_has_a_licence_and_copyleft_ones_are_named() -> None:
    listed = [row for lock in PURPOSES for row in rows_of(lock)]
    assert len(listed) > 200
    assert [row[0] for row in listed if row[2] in ("", "not stated")] == []
    top = PAGE.read_text(encoding="utf-8").partition("## LGPL")[2].partition("\n## ")[0]
    for name, _, licence, *_ in listed:
        asks = any(word in licence for word in COPYLEFT) or dependencies.canonicalize_name(name) in WITHIN
        assert (f"| {name} |" in top) == asks, name
    assert "casadi" in top and "LGPL" in top and "rapidchecker" in top and "AGPL" in top


def test_what_is_stated_by_hand_is_what_licence_files_say() -> None:
    words = {
        "abb_robot_client": ("Apache License",),
        "rapidchecker": ("GNU AFFERO GENERAL PUBLIC LICENSE",),
        "xacro": ("Redistribution and use in source and binary forms",),
        "cmeel-qhull": ("Qhull, Copyright",),
        "apsw": ("This software is provided 'as-is'",),
        "casadi": ("CERFACS", "Eclipse Public License", "GNU LESSER GENERAL PUBLIC LICENSE"),
        "lxml": ("LGPL 2.1",),
        "numpy": ("LGPL-2.1-or-later", "GPL-3.0-or-later WITH GCC-exception"),
        "scipy": ("LGPL-2.1-or-later", "GPL-3.0-or-later WITH GCC-exception"),
        "shapely": ("LGPLv2.1",),
    }
    assert {dependencies.canonicalize_name(name) for name in words} | NOT_HERE >= {*STATED, *WITHIN}
    for name, phrases in words.items():
        files = distribution(name).files or []
        texts = [Path(str(each.locate())) for each in files if any(w in str(each).lower() for w in ("licen", "qhull"))]
        text = "\n".join(
            each.read_text(encoding="utf-8", errors="replace") for each in texts if each.suffix in ("", ".txt")
        )
        for phrase in phrases:
            assert phrase in text, (name, phrase)


@pytest.mark.parametrize(
    "fields, licence",
    [
        ({"license_expression": "MIT", "license": "other"}, "MIT"),
        ({"license": "BSD", "classifier": ["License :: OSI Approved :: BSD License"]}, "BSD"),
        ({"license": "a\nlong\ntext", "classifier": ["License :: OSI Approved :: MIT License"]}, "MIT License"),
        ({"license": "UNKNOWN", "classifier": ["License :: OSI Approved"]}, "not stated"),
        ({}, "not stated"),
    ],
)
def test_the_licence_of_metadata(fields: dict[str, object], licence: str) -> None:
    assert licence_of("package", fields) == licence


def answers(folder: Path, dependencies_told: object, said: str = "") -> str:
    """A command that answers as pip-audit does."""
    command = folder / "pip-audit"
    told = json.dumps({"dependencies": dependencies_told}) if dependencies_told is not None else ""
    command.write_text(
        f"#!{sys.executable}\nimport sys\nprint({told!r})\nprint({said!r}, file=sys.stderr)\n", encoding="utf-8"
    )
    command.chmod(0o755)
    return str(command)


SOUND = {"name": "numpy", "version": "2.4.6", "vulns": []}
FLAW = {"id": "GHSA-1", "aliases": ["CVE-2024-1"], "fix_versions": ["3.1.3"], "description": ""}


@pytest.mark.parametrize(
    "told, code, words",
    [
        ([SOUND], 0, "0 with known advisories, 0 not looked up"),
        (
            [SOUND, {"name": "jinja2", "version": "3.1.2", "vulns": [FLAW]}],
            3,
            "jinja2 3.1.2: GHSA-1, CVE-2024-1; fixed in 3.1.3",
        ),
        # an index without advisories: pip-audit ends in 0, "No known vulnerabilities found"
        ([{"name": "numpy", "skip_reason": "not found on the index"}], 4, "the index has no advisories"),
        ([SOUND, {"name": "jinja2", "skip_reason": "not found on the index"}], 4, "1 not looked up"),
        (None, 4, "the index was not reached, or did not answer"),
    ],
)
def test_advisories(tmp_path: Path, capsys: pytest.CaptureFixture[str], told: object, code: int, words: str) -> None:
    audit = answers(tmp_path, told, said="ConnectionError: no route")
    assert dependencies.main(["advisories", "--audit", audit]) == code
    assert words in capsys.readouterr().out


def test_without_pip_audit_the_way_to_it_is_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert dependencies.main(["advisories", "--audit", str(tmp_path / "none")]) == 2
    assert "make advisories" in capsys.readouterr().err


def test_a_lock_that_is_not_there_is_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert dependencies.main(["advisories", "--audit", answers(tmp_path, [SOUND]), "none.txt"]) == 2
    assert "no lock file none.txt" in capsys.readouterr().err
