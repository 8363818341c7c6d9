"""Scripts with which shells complete the commands, their options, examples and robots."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from typing import Any

import shtab

from planner.base.command_line import Command, exit_code
from planner.base.errors import EXIT_VERIFIED
from planner.base.launch import COMMANDS, end, launch
from planner.cell.robot import robot_names
from planner.problem import shipped_problems
from planner.reference.command import completion_command
from planner.reference.pages import commands

NAMED = {"problem": shipped_problems, "robot": robot_names}  # what an argument may name, besides files


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit code."""
    options = completion_command().parse_args(arguments)
    return exit_code(lambda: _run(options), lambda text: print(text, file=sys.stderr))


def _run(options: argparse.Namespace) -> int:
    print(script(options.shell))
    return EXIT_VERIFIED


def script(shell: str) -> str:
    """The script for one of SHELLS."""
    whole = argparse.ArgumentParser(prog="beadwise")
    below = whole.add_subparsers()
    made = {parser.prog.rpartition(".")[2].removeprefix("beadwise "): parser for parser in commands()}
    above: dict[tuple[str, ...], Any] = {(): below}  # commands that are nothing without a further word
    for name, parser in made.items():
        *before, last = name.split()
        if (before[0] if before else last) not in COMMANDS or (before and before[0] in made):
            continue
        for k in range(1, len(before) + 1):
            path = tuple(before[:k])
            if path not in above:
                about = COMMANDS[path[0]].does if k == 1 else " ".join(path)
                above[path] = above[path[:-1]].add_parser(path[-1], help=about).add_subparsers()
        told = parser.description if before else COMMANDS[name].does
        one = above[tuple(before)].add_parser(last, help=told, add_help=False, parents=[_completed(parser)])
        one.description = None
    words = {name: " ".join(known()) for name, known in NAMED.items()}
    preamble: Any = {
        "bash": "\n".join(f"_beadwise_{n}() {{ compgen -W '{w}' -- $1; compgen -f -- $1; }}" for n, w in words.items()),
        "zsh": "\n".join(f"_beadwise_{n}() {{ compadd {w}; _files }}" for n, w in words.items()),
    }
    return str(shtab.complete(whole, shell, preamble=preamble))


def _completed(parser: Command) -> Command:
    """The parser, which says of its arguments how they are completed."""
    for action in parser._actions:
        if action.dest in NAMED:
            own = f"_beadwise_{action.dest}"
            action.complete = {"bash": own, "zsh": own, "tcsh": "f"}  # type: ignore[attr-defined]
        elif action.dest in ("out", "folder", "contacts", "file", "program", "log", "asked", "plan", "table", "write"):
            action.complete = shtab.FILE  # type: ignore[attr-defined]
    return parser


if __name__ == "__main__":
    end(launch("completion"))
