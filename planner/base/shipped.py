"""What ships beside the code: in an installed package within it, in a checkout at its top."""

from __future__ import annotations

from pathlib import Path

_PACKAGE = Path(__file__).resolve().parents[1]
INSTALLED = _PACKAGE / "shipped"
_HOME = INSTALLED if INSTALLED.is_dir() else _PACKAGE.parent

PROBLEMS = _HOME / "problems"
ROBOTS = _HOME / "robots"
PROBLEM_SCHEMA = (INSTALLED if INSTALLED.is_dir() else _PACKAGE.parent / "docs") / "problem.schema.json"
