"""Whether the changes that a plan advises do what they say: each is applied to the problem, which is planned again.

python -m benchmarks.advice cylinder_logo --set layers.count=1

The beads that a change was tried on are judged: their share at speed and their time, both within 10 %.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import dataclass

from planner.base.errors import EXIT_NOT_VERIFIED, EXIT_VERIFIED
from planner.plan import Advice
from planner.planning.advice import recorded
from planner.planning.options import add_problem, add_set
from planner.planning.pipeline import load, solve

WITHIN = 0.1  # relative


@dataclass(frozen=True)
class Applied:
    """An advised change, applied: what came of the beads that it was tried on, and of the whole print.

    share, time    of these beads, at speed and [s]
    whole          share of the whole print at speed
    """

    advice: Advice
    share: float
    time: float
    whole: float
    verified: bool

    @property
    def holds(self) -> bool:
        """Whether it does what was said, and the plan is verified."""
        share, time = self.share / self.advice.share, self.time / self.advice.time
        return self.verified and max(abs(share - 1.0), abs(time - 1.0)) <= WITHIN


def applied(problem: str, overrides: Sequence[str]) -> tuple[Applied, ...]:
    """All changes that a problem's plan advises. Raises InputError, and Refusal where there is no plan with one."""
    out = []
    for each in solve(load(problem, *overrides)).advice:
        plan = solve(load(problem, *overrides, f"{each.field}={each.value}"), baseline=False)
        beads = recorded(plan.trajectory, plan.commanded, each.beads)
        whole = plan.metrics["at_speed_fraction"]
        out.append(Applied(each, beads.share, beads.time, whole, plan.verified))
    return tuple(out)


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit code."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.advice", description=__doc__.split("\n", 1)[0])
    add_problem(parser)
    add_set(parser)
    options = parser.parse_args(arguments)
    print("change                                 at speed there %     time there s     whole at speed %")
    print("                                       said    measured   said  measured    at least  measured")
    rows = applied(options.problem, options.set)
    for row in rows:
        a = row.advice
        print(
            f"{f'{a.field}: {a.value:g}':<37}{a.share * 100:>6.1f}{row.share * 100:>12.1f}{a.time:>7.2f}{row.time:>10.2f}"
            f"{a.whole * 100:>12.1f}{row.whole * 100:>10.1f}  {'holds' if row.holds else 'DOES NOT HOLD'}"
        )
    return EXIT_VERIFIED if all(row.holds for row in rows) else EXIT_NOT_VERIFIED


if __name__ == "__main__":
    sys.exit(main())
