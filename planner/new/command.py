"""The command line of `python -m planner.new`, and copies of existing problems to start from."""

from __future__ import annotations

import argparse
import os
import re
import tempfile
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path

from rich.console import Console

from planner.base.command_line import Command, exit_code, yaml_file
from planner.base.errors import EXIT_VERIFIED, InputError, OutputError
from planner.new.problem_file import modeline, problem_text
from planner.new.questions import Answers, Asker, answers_to, name_of
from planner.planning.check_command import examine
from planner.problem import Problem, load_problem
from planner.problem.describe import MODELINE
from planner.problem.fields import identifier_like
from planner.problem.problem import parse_problem
from planner.problem.rewrite import changed_text, paths_in

# ----------------------------------------------------------------------------------------------------
# A copy of an existing problem to start from: its file and all files that it names, in one folder.

_MODELINE = re.compile(rf"{re.escape(MODELINE)}[^\n]*\n")
# files that name further files: these are not copied
ROBOTS = {("cell", "arm"), ("cell", "base", "robot"), ("cell", "positioner", "robot")}


def copied(problem: Problem, file: Path) -> dict[Path, bytes]:
    """The files to write for a copy of a problem: path → content, the problem file itself last.

    Comments are kept. Raises OutputError if a different file of the same name exists already, InputError if one cannot
    be read.
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
            raise OutputError(f"{target} is there already, and differs from {path}: choose another folder")
        contents[target] = content
    text = changed_text(problem, {**changes, "name": identifier_like(file.stem)}, folder)
    text = modeline(folder) + _MODELINE.sub("", text, count=1)
    return {**contents, file: text.encode()}


# ----------------------------------------------------------------------------------------------------
# The command line of `python -m planner.new`.

USUAL_FILE = Path("my_print.yaml")


def new_command() -> Command:
    """The parser of `python -m planner.new`."""
    parser = Command(
        "new",
        "Write a problem file of your own: ask a few questions, each with a default, or begin from a problem that "
        "ships.",
        {
            "": "ask, and write my_print.yaml",
            "vase.yaml --yes": "take the default answer to every question",
            "vase.yaml --from cylinder_logo": "a copy of a shipped problem, with the files that it names",
        },
        {
            0: "written; planner.check accepts it",
            2: "wrong answer in a pipe, or a file that cannot be written; nothing written",
            130: "interrupted, or the input ended; nothing written",
        },
    )
    parser.add_argument(
        "file", nargs="?", type=yaml_file, default=USUAL_FILE, metavar="FILE", help="default my_print.yaml"
    )
    parser.add_argument(
        "--from", dest="start", metavar="NAME", help="begin from a problem that ships, or a file; no questions"
    )
    parser.add_argument("--yes", action="store_true", help="no questions: the default answers")
    return parser


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit code."""
    options = new_command().parse_args(arguments)
    errors = Console(stderr=True, highlight=False)
    return exit_code(lambda: _run(options, errors), partial(errors.print, markup=False, soft_wrap=True))


def _run(options: argparse.Namespace, errors: Console) -> int:
    file, ask = options.file, Asker(errors, options.yes or options.start is not None)
    if not file.parent.is_dir():
        raise OutputError(f"there is no folder {file.parent}")
    if file.exists() and (ask.take_defaults or not _over(ask, file)):
        raise OutputError(f"{file} is there already, and stays as it is: give another name")
    if options.start is None:
        contents = {file: _checked(answers_to(ask, file, identifier_like(file.stem)), file).encode()}
    else:
        contents = copied(load_problem(options.start), file)
    _write(contents)
    for path in contents:
        print(path)
    errors.print(
        f"next: python -m planner.check {file}, then python -m planner.solve {file}", markup=False, soft_wrap=True
    )
    return EXIT_VERIFIED


def _over(ask: Asker, file: Path) -> bool:
    return bool(
        ask(f"{file} is there already; overwrite it? yes or no", "no", name_of("answer", ("yes", "no"))) == "yes"
    )


def _checked(answers: Answers, file: Path) -> str:
    """The text of the problem file, with the first home posture that keeps all clearances.

    Raises the InputError for the first mistake that `planner.check` would find in it.
    """
    mistakes: tuple[InputError, ...] = ()
    for home_deg in answers["homes_deg"]:
        text = problem_text(answers, file, home_deg)
        mistakes = examine(parse_problem(text, file)).mistakes
        if not mistakes:
            return text
        if mistakes[0].field != "cell.home_deg":
            break
    raise mistakes[0]


def _write(contents: Mapping[Path, bytes]) -> None:
    """Write the files to a temporary folder next to their place; move them there once all are complete."""
    folder = next(iter(contents)).parent
    try:
        with tempfile.TemporaryDirectory(prefix=".new-", dir=folder) as beside:
            for path, content in contents.items():
                (Path(beside) / path.name).write_bytes(content)
            for path in contents:
                os.replace(Path(beside) / path.name, path)
    except OSError as error:
        raise OutputError(f"cannot write into {folder}: {error.strerror}") from error
