"""docs/reference/metrics.md and commands.md: what a plan tells, and what can be typed."""

from __future__ import annotations

from collections.abc import Mapping

from planner.base.command_line import Command
from planner.export.plan_json import DIP_KEYS, KEYS, SPLIT_KEYS
from planner.feedback.identify_command import (
    extruder_read_command,
    extruder_write_command,
    identify_read_command,
    identify_write_command,
)
from planner.feedback.learn_command import learn_command
from planner.feedback.scan_command import scan_command
from planner.link.command import link_command
from planner.link.guided_motion import egm_command
from planner.link.streaming import stream_command
from planner.new.command import new_command
from planner.place.command import place_command
from planner.plan.measures import CHECKS, COLUMNS, METRICS, Measure
from planner.planning.check_command import check_command
from planner.planning.options import solve_command
from planner.reference.command import completion_command, reference_command
from planner.reference.markdown import table
from planner.register.command import register_command
from planner.report.demo import demo_command
from planner.robots.command import add_command
from planner.robots.listing import robots_command
from planner.simulate.command import simulate_command
from planner.view.options import view_command

_METRICS_HEAD = """\
# Metrics, checks and columns

*Made by `python -m planner.reference` from the tables beside the code; do not edit.*

A plan is written as `plan.json`, and its motion sample by sample as `trajectory.csv`. The verifier finds metrics \
and checks from the joints of the motion alone, by the robots' URDF files.
"""
_COMMANDS_HEAD = """\
# Commands

*Made by `python -m planner.reference` from the commands themselves; do not edit.*

All commands print their result on stdout, and progress and errors on stderr. A pipe gets no progress bars and no \
colours; `NO_COLOR` switches colours off on a terminal, too.
"""


def metrics_page() -> str:
    """The page of what a plan tells."""
    return "\n".join(
        [
            _METRICS_HEAD,
            "## Metrics\n",
            "`metrics` of plan.json, by name; `baseline` has the same of strategy `as_published`.\n",
            measures(METRICS),
            "## Checks\n",
            "`checks` of plan.json. A plan is verified if all of them hold; robot programs are written of verified plans only. "
            "The unit is that of the worst value and of the limit.\n",
            measures(CHECKS),
            "## Columns of trajectory.csv\n",
            "One row a sample, 4 ms apart unless `--dt` says otherwise. After these columns come the joints by name [rad, m of "
            "those that slide]: the free ones of what carries the arm, the arm's, then those of what holds the part.\n",
            measures(COLUMNS),
            "## Keys of plan.json\n",
            names(KEYS),
            "### A dip\n",
            "Each item of `dips`:\n",
            names(DIP_KEYS),
            "### A split\n",
            "Each item of `splits`, a place where a drawn bead goes on as another one after a pause:\n",
            names(SPLIT_KEYS),
        ]
    )


def measures(given: Mapping[str, Measure]) -> str:
    """A table of measures."""
    rows = [
        [f"`{name}`", each.text + (f"; only where {each.only}" if each.only else ""), each.unit, each.how]
        for name, each in given.items()
    ]
    return table(("name", "meaning", "unit", "how it is found"), rows)


def names(given: Mapping[str, str]) -> str:
    """A table of keys."""
    return table(("key", "meaning"), [[f"`{name}`", text] for name, text in given.items()])


def commands() -> tuple[Command, ...]:
    """The parsers of all commands."""
    makers = (
        demo_command, solve_command, check_command, new_command, view_command, place_command, register_command,
        scan_command, learn_command, identify_write_command, identify_read_command, extruder_write_command,
        extruder_read_command, robots_command, add_command, link_command,
        stream_command, egm_command, simulate_command, completion_command, reference_command,
    )  # fmt: skip
    return tuple(make() for make in makers)


def commands_page() -> str:
    """The page of all commands."""
    parts = [
        f"## {each.prog.removeprefix('python -m ')}\n\n```text\n{each.page().rstrip()}\n```\n" for each in commands()
    ]
    return "\n".join([_COMMANDS_HEAD, *parts])
