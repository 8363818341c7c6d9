"""Files that ship with the code: inside an installed package, or at the top of a checkout."""

from __future__ import annotations

from pathlib import Path

_PACKAGE = Path(__file__).resolve().parents[1]
INSTALLED = _PACKAGE / "shipped"
_HOME = INSTALLED if INSTALLED.is_dir() else _PACKAGE.parent

PROBLEMS = _HOME / "problems"
ROBOTS = _HOME / "robots"
PROBLEM_SCHEMA = (INSTALLED if INSTALLED.is_dir() else _PACKAGE.parent / "docs") / "problem.schema.json"
