"""A problem that exists, as the start of one's own: its file and all files that it names, side by side."""

from __future__ import annotations

import re
from pathlib import Path

from planner.errors import OutputError
from planner.listing import MODELINE
from planner.new.text import modeline
from planner.problem import Problem
from planner.problem.fields import LONGEST_NAME
from planner.problem.rewrite import changed_text, paths_in

_MODELINE = re.compile(rf"{re.escape(MODELINE)}[^\n]*\n")
ROBOTS = {("cell", "arm"), ("cell", "positioner", "robot")}  # files that name others again: they stay where they are


def copied(problem: Problem, file: Path) -> dict[Path, bytes]:
    """What is to be written for a copy of a problem: path → content, the problem file itself last.

    Comments stay. Raises OutputError where another file of the same name stands already, InputError for one that
    cannot be read.
    """
    folder = file.parent
    changes: dict[str, float | list[float] | str] = {}
    contents: dict[Path, bytes] = {}
    for keys, path in paths_in(problem):
        if keys in ROBOTS:
            continue
        target = folder / path.name
        changes[".".join(map(str, keys))] = path.name
        try:
            content = path.read_bytes()
        except OSError as error:
            raise problem.error(".".join(map(str, keys)), f"cannot read {path}: {error.strerror}") from error
        if target.resolve() == path.resolve() or contents.get(target) == content:
            continue
        if target in contents or (target.exists() and target.read_bytes() != content):
            raise OutputError(f"{target} is there already, and is another file than {path}: choose another folder")
        contents[target] = content
    text = changed_text(problem, {**changes, "name": name_from(file)}, folder)
    text = modeline(folder) + _MODELINE.sub("", text, count=1)
    return {**contents, file: text.encode()}


def name_from(file: Path) -> str:
    """A problem's name from that of its file: letters, digits and _, a letter first."""
    name = re.sub(r"[^A-Za-z0-9_]+", "_", file.stem).strip("_")[:LONGEST_NAME]
    return name if name[:1].isalpha() else f"print_{name}"[:LONGEST_NAME].rstrip("_")
