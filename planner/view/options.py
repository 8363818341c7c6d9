"""The parser of `python -m planner.view`; importing it does not load the packages that serve a page."""

from __future__ import annotations

from planner.base.command_line import Command, one_of
from planner.base.web.options import add_page_options
from planner.planning.options import add_set, add_strategy
from planner.problem.settings import STRATEGY_NAMES


def view_command() -> Command:
    """The parser of `python -m planner.view`."""
    parser = Command(
        "view",
        "Show a problem's report in the browser, and solve it again whenever its files are saved. Nothing is written: "
        "planner.solve does that.",
        {
            "my_part.yaml": "solve, show, and solve again on every save",
            "my_part.yaml --strategy ladder --beside as_published": "two strategies side by side",
            "my_part.yaml --set layers.count=1": "with a field changed",
            "out/my_part": "show what planner.solve writes there, as it is written",
        },
        {0: "ended other than by Ctrl-C", 2: "wrong input, or a port that is taken", 130: "ended by Ctrl-C"},
    )
    parser.add_argument(
        "subject",
        metavar="PROBLEM|OUT_DIR",
        help="problem file (.yaml), or the name of a shipped one (solve --list); or a folder of results",
    )
    add_strategy(parser)
    parser.add_argument(
        "--beside", type=one_of(STRATEGY_NAMES), metavar="NAME", help="another strategy, in a second pane"
    )
    add_set(parser)
    parser.add_argument(
        "--no-drafts", dest="drafts", action="store_false", help="do not draft one layer first when a print is large"
    )
    add_page_options(parser, "--port")
    return parser
