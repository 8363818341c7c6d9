"""Scripts with which shells complete the commands, their options, examples and robots."""

from __future__ import annotations

import argparse
import importlib
import sys
from collections.abc import Sequence
from typing import Any

import shtab

from planner.base.command_line import Command, exit_code, one_of
from planner.base.errors import EXIT_VERIFIED
from planner.base.launch import COMMANDS, end, launch
from planner.base.shipped import PROBLEMS, ROBOTS

# The functions that make the commands' parsers, by module.
PARSERS = (
    "report.demo.demo_command",
    "planning.options.solve_command",
    "planning.check_command.check_command",
    "new.command.new_command",
    "view.options.view_command",
    "place.command.place_command",
    "register.command.register_command",
    "feedback.scan_command.scan_command",
    "feedback.learn_command.learn_command",
    "feedback.identify_command.identify_write_command",
    "feedback.identify_command.identify_read_command",
    "feedback.identify_command.extruder_write_command",
    "feedback.identify_command.extruder_read_command",
    "robots.listing.robots_command",
    "robots.command.add_command",
    "link.command.link_command",
    "link.streaming.stream_command",
    "link.guided_motion.egm_command",
    "simulate.command.simulate_command",
    "base.completion.completion_command",
)
SHELLS = ("bash", "zsh", "tcsh")
_NAMED = {"problem": PROBLEMS, "robot": ROBOTS}  # arguments that may name a file of these folders, besides a path
_FILES = ("out", "folder", "contacts", "file", "program", "log", "asked", "plan", "table", "write")


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit code."""
    options = completion_command().parse_args(arguments)
    return exit_code(lambda: _run(options), lambda text: print(text, file=sys.stderr))


def completion_command() -> Command:
    """The parser of `python -m planner.base.completion`."""
    parser = Command(
        "base.completion",
        "Print a script that lets a shell complete the commands of beadwise, their options, examples and robots.",
        {
            "bash > ~/.local/share/bash-completion/completions/beadwise": "for bash, from the next shell on",
            "zsh > ~/.zfunc/_beadwise": "for zsh, where ~/.zfunc is in fpath",
        },
        {0: "printed", 2: "wrong input"},
    )
    parser.add_argument("shell", type=one_of(SHELLS), metavar="SHELL", help=f"one of {', '.join(SHELLS)}")
    return parser


def _run(options: argparse.Namespace) -> int:
    print(script(options.shell))
    return EXIT_VERIFIED


def parsers() -> tuple[Command, ...]:
    """The parsers of all commands."""
    makers = (maker.rpartition(".") for maker in PARSERS)
    return tuple(getattr(importlib.import_module(f"planner.{module}"), name)() for module, _, name in makers)


def script(shell: str) -> str:
    """The script for one of SHELLS."""
    whole = argparse.ArgumentParser(prog="beadwise")
    below = whole.add_subparsers()
    made = {parser.prog.rpartition(".")[2].removeprefix("beadwise "): parser for parser in parsers()}
    above: dict[tuple[str, ...], Any] = {(): below}  # commands that need a further word
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
    words = {name: " ".join(sorted(path.stem for path in folder.glob("*.yaml"))) for name, folder in _NAMED.items()}
    preamble: Any = {
        "bash": "\n".join(f"_beadwise_{n}() {{ compgen -W '{w}' -- $1; compgen -f -- $1; }}" for n, w in words.items()),
        "zsh": "\n".join(f"_beadwise_{n}() {{ compadd {w}; _files }}" for n, w in words.items()),
    }
    return str(shtab.complete(whole, shell, preamble=preamble))


def _completed(parser: Command) -> Command:
    """The parser, with each argument's way of completion set."""
    for action in parser._actions:
        if action.dest in _NAMED:
            own = f"_beadwise_{action.dest}"
            action.complete = {"bash": own, "zsh": own, "tcsh": "f"}  # type: ignore[attr-defined]
        elif action.dest in _FILES:
            action.complete = shtab.FILE  # type: ignore[attr-defined]
    return parser


if __name__ == "__main__":
    end(launch("completion"))
