"""The parsers of `python -m planner.reference`, with the files that it writes, and of `python -m planner.reference.completion`."""

from __future__ import annotations

from pathlib import Path

from planner.base.command_line import Command, one_of

# What can be asked for → its file below docs/.
FILES = {
    "schema": "problem.schema.json",
    "robot-schema": "robot.schema.json",
    "problem": "reference/problem_file.md",
    "robot": "reference/robot_file.md",
    "metrics": "reference/metrics.md",
    "commands": "reference/commands.md",
}
SHELLS = ("bash", "zsh", "tcsh")


def reference_command() -> Command:
    """The parser of `python -m planner.reference`."""
    parser = Command(
        "reference",
        "Write the references that are made from the code: JSON schemas, and pages of every key, metric and command.",
        {
            "schema": "print the JSON schema of the problem file",
            "all": "write all of them below docs/, as they are committed",
        },
        {0: "printed, or written", 2: "wrong input"},
    )
    parser.add_argument("what", type=one_of(("all", *FILES)), metavar="WHAT", help=f"all, or one of {', '.join(FILES)}")
    parser.add_argument("--out", type=Path, default=Path("docs"), metavar="DIR", help="where all goes (default docs)")
    return parser


def completion_command() -> Command:
    """The parser of `python -m planner.reference.completion`."""
    parser = Command(
        "reference.completion",
        "Print a script with which a shell completes the commands of beadwise, their options, examples and robots.",
        {
            "bash > ~/.local/share/bash-completion/completions/beadwise": "for bash, from the next shell on",
            "zsh > ~/.zfunc/_beadwise": "for zsh, where ~/.zfunc is in fpath",
        },
        {0: "printed", 2: "wrong input"},
    )
    parser.add_argument("shell", type=one_of(SHELLS), metavar="SHELL", help=f"one of {', '.join(SHELLS)}")
    return parser
