"""Show a print that ships already planned: its report in the browser, and how to plan one's own.

python -m planner.report.demo
"""

from __future__ import annotations

import argparse
import gzip
import sys
import webbrowser
from collections.abc import Sequence
from functools import partial
from pathlib import Path

from planner.base.command_line import Command, exit_code
from planner.base.errors import EXIT_INPUT, EXIT_VERIFIED
from planner.base.launch import end, launch
from planner.base.results import results_folder

SHIPPED = Path(__file__).with_name("demo.html.gz")
PROBLEM = "hemisphere_honeycomb"
RESULTS_BY = "demo"
NEXT = (
    (f"beadwise solve {PROBLEM}", "plans the same print here; the first run compiles for some minutes"),
    ("beadwise new", "asks for your robot, part and process, and writes a problem file"),
    ("beadwise solve --list", "lists the examples that ship, to copy from"),
)


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit code."""
    options = demo_command().parse_args(arguments)
    return exit_code(lambda: _run(options), partial(print, file=sys.stderr))


def demo_command() -> Command:
    """The parser of the command."""
    parser = Command(
        "report.demo",
        "Show a print that ships planned: its report in the browser.",
        {"": "into out/demo", "--no-browser": "only write the report, and say where it is"},
        {EXIT_VERIFIED: "the report was written", EXIT_INPUT: "the folder cannot be written"},
    )
    parser.add_argument("--out", type=Path, default=Path("out/demo"), metavar="FOLDER", help="default: out/demo")
    parser.add_argument("--no-browser", action="store_true", help="only say where the report is")
    return parser


def _run(options: argparse.Namespace) -> int:
    with results_folder(options.out, RESULTS_BY) as fresh:
        (fresh / "report.html").write_bytes(shipped_report())
    report = (options.out / "report.html").resolve()
    shown = not options.no_browser and _opened(report.as_uri())
    print(f"{PROBLEM}, planned and verified: {'open in your browser, ' if shown else 'open '}{report}")
    print("now plan your own:")
    width = max(len(command) for command, _ in NEXT)
    for command, does in NEXT:
        print(f"  {command:<{width}}  {does}")
    return EXIT_VERIFIED


def shipped_report() -> bytes:
    """The report, as `python -m benchmarks.demo` made it."""
    return gzip.decompress(SHIPPED.read_bytes())


def _opened(address: str) -> bool:
    """Whether a browser opened it."""
    try:
        return webbrowser.open(address)
    except webbrowser.Error:
        return False


if __name__ == "__main__":
    end(launch("demo"))
