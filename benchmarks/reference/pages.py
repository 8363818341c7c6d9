"""docs/reference/metrics.md and commands.md: what a plan tells, and what can be typed."""

from __future__ import annotations

from collections.abc import Mapping

from benchmarks.reference.markdown import table
from planner.base.completion import parsers
from planner.export.plan_json import DIP_KEYS, KEYS, SPLIT_KEYS
from planner.plan.measures import CHECKS, COLUMNS, METRICS, Measure

_METRICS_HEAD = """\
# Metrics, checks and columns

*Made by `python -m benchmarks.reference` from the tables beside the code; do not edit.*

A plan is written as `plan.json`, and its motion sample by sample as `trajectory.csv`. The verifier finds metrics \
and checks from the joints of the motion alone, by the robots' URDF files.
"""
_COMMANDS_HEAD = """\
# Commands

*Made by `python -m benchmarks.reference` from the commands themselves; do not edit.*

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


def commands_page() -> str:
    """The page of all commands."""
    parts = [
        f"## {each.prog.removeprefix('python -m ')}\n\n```text\n{each.page().rstrip()}\n```\n" for each in parsers()
    ]
    return "\n".join([_COMMANDS_HEAD, *parts])
