"""Random cases by every strategy: whatever any of them verifies, the default verifies too, as well at speed and as fast.

python -m benchmarks.random_cases --cases 300 --out out/random_cases.jsonl
python -m benchmarks.random_cases --kinds bed cones --first 20 --cases 10
python -m benchmarks.random_cases turntable_17 --write out/cases         writes its files, to be solved by planner.solve

The promises, each with the name of a breach: if another strategy verifies a case, the default does too (not verified); its
share at speed is lower by at most 0.1 % of the length (slower); its print takes at most 1.02 times as long (longer). With
--brute, cases that no strategy verifies are also searched by brute force (minutes for each): if that finds a continuous
motion along which a plan is verified, the refusal was wrong (refused). The exit code is 1 if a promise is broken.

Cases that have a line in the file of --out, for the same strategies, are not run again: an interrupted run continues, and
another commit needs another file. The last line of a case counts.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import time
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from benchmarks.brute_force import find_motion, plan_along
from benchmarks.command import parser_of
from benchmarks.random_cells import KINDS, Case, make_case
from benchmarks.run import whole_number
from planner.base.command_line import one_of
from planner.base.errors import EXIT_BUG, EXIT_INPUT, EXIT_VERIFIED, PlannerError, Refusal, nearest_name
from planner.plan import Check
from planner.planning.pipeline import load, solve
from planner.problem import Problem
from planner.problem.settings import STRATEGY_NAMES

USUAL = tuple(name for name in STRATEGY_NAMES if name != "nlp")  # which takes minutes for a bead
LESS_AT_SPEED = 1e-3  # of the length
LONGER = 1.02  # times the shortest print time
BROKEN = ("not verified", "slower", "longer", "refused")


@dataclass(frozen=True)
class Outcome:
    """What a strategy made of a case.

    ended     verified, failed (checks do not hold), refused (no plan), invalid (wrong input) or crashed
    why       failed checks, or the error
    at_speed, print_time   metrics at_speed_fraction and print_time_s of a plan
    seconds   that planning and verification took
    """

    ended: str
    why: str = ""
    at_speed: float = 0.0
    print_time: float = 0.0
    seconds: float = 0.0


@dataclass(frozen=True)
class Result:
    """A case as every strategy ended.

    possible  whether brute force found a motion along which a plan is verified; None where it was not asked
    brute     what it says
    """

    kind: str
    number: int
    outcomes: dict[str, Outcome]
    possible: bool | None = None
    brute: str = ""

    @property
    def name(self) -> str:
        """The case's."""
        return f"{self.kind}_{self.number}"

    @property
    def verified(self) -> bool:
        """Whether any strategy verifies it."""
        return any(each.ended == "verified" for each in self.outcomes.values())

    def broken(self, default: str) -> list[str]:
        """The promises that the default strategy breaks here."""
        own = self.outcomes[default]
        good = [each for each in self.outcomes.values() if each.ended == "verified"]
        if not good:
            return ["refused"] if self.possible else []
        if own.ended != "verified":
            return ["not verified"]
        slower = own.at_speed < max(each.at_speed for each in good) - LESS_AT_SPEED
        longer = own.print_time > LONGER * min(each.print_time for each in good)
        return ["slower"] * slower + ["longer"] * longer

    def line(self, default: str) -> str:
        """For people."""
        words = []
        for name, each in self.outcomes.items():
            if each.ended == "verified":
                words.append(f"{name} {100 * each.at_speed:.1f} % {each.print_time:.1f} s")
            else:
                words.append(f"{name} {each.ended}: {each.why[:60]}" if name == default else f"{name} {each.ended}")
        broken = self.broken(default)
        words += [f"brute force: {self.brute}"] if self.brute else []
        return f"{self.name}: " + " | ".join([*words, *([f"BROKEN: {', '.join(broken)}"] if broken else [])])

    def json(self) -> str:
        """As a line of the file."""
        return json.dumps(asdict(self))


def result_of(line: str) -> Result:
    """A result from its line."""
    row: dict[str, Any] = json.loads(line)
    return Result(**row | {"outcomes": {name: Outcome(**each) for name, each in row["outcomes"].items()}})


def run(problem: Problem, strategy: str) -> Outcome:
    """Plan and verify; whatever goes wrong is an outcome, too."""
    start = time.perf_counter()

    def outcome(ended: str, why: str = "", at_speed: float = 0.0, print_time: float = 0.0) -> Outcome:
        return Outcome(ended, why, at_speed, print_time, round(time.perf_counter() - start, 2))

    try:
        plan = solve(problem, strategy, baseline=False)
    except Refusal as refusal:
        return outcome("refused", str(refusal))
    except PlannerError as error:
        return outcome("invalid", str(error))
    except Exception as error:  # a crash is a result: the others are to be run all the same
        return outcome("crashed", repr(error))
    at_speed, print_time = (float(plan.metrics[name]) for name in ("at_speed_fraction", "print_time_s"))
    return outcome("verified" if plan.verified else "failed", failed(plan.checks), at_speed, print_time)


def compare(case: Case, strategies: Sequence[str]) -> Result:
    """A case by each strategy."""
    with tempfile.TemporaryDirectory() as folder:
        problem = load(case.write(Path(folder)))
        return Result(case.kind, case.number, {name: run(problem, name) for name in strategies})


def searched(case: Case, result: Result) -> Result:
    """The result with what brute force says, and verification of a plan along what that found."""
    with tempfile.TemporaryDirectory() as folder:
        problem = load(case.write(Path(folder)))
        found = find_motion(problem)
        words, possible = found.words, False
        if found:
            try:
                wrong = failed(plan_along(problem, found.motion).checks)
                words, possible = f"{words}; a plan along it: {wrong or 'verified'}", not wrong
            except Refusal as refusal:
                words += f"; a plan along it: {refusal}"
    return replace(result, possible=possible, brute=words)


def failed(checks: Iterable[Check]) -> str:
    """The checks that do not hold, with what was found and what is allowed."""
    return "; ".join(f"{each.name}: {each.worst:.3g}, {each.limit:g} {each.unit}" for each in checks if not each.ok)


def named(names: Sequence[str], kinds: Sequence[str], first: int, count: int) -> list[tuple[str, int]]:
    """Kinds and numbers of the cases: those that are named, or so many, dealt to the kinds in turn from a number on.

    Raises ValueError for a name that is none.
    """
    if not names:
        return [(kinds[i % len(kinds)], first + i // len(kinds)) for i in range(count)]
    found = []
    for name in names:
        kind, _, number = name.rpartition("_")
        if kind not in KINDS or not number.isdecimal():
            near = nearest_name(kind, KINDS) or next(iter(KINDS))
            raise ValueError(f"there is no case {name!r} (such as {near}_0)")
        found.append((kind, int(number)))
    return found


def table(results: Iterable[Result], default: str) -> Table:
    """Promises kept and broken by kind."""
    columns = ("kind", "cases", "verified by any", f"by {default}", *BROKEN, "s", "broken in")
    out = Table(*columns, title=f"promises that {default} breaks", title_justify="left")
    rows = list(results)
    for kind in [*KINDS, "all"]:
        here = [row for row in rows if kind in (row.kind, "all")]
        if not here:
            continue
        broken = {row.name: row.broken(default) for row in here}
        numbers = [name.removeprefix(f"{kind}_") for name, each in broken.items() if each]
        out.add_row(
            kind,
            f"{len(here)}",
            f"{sum(row.verified for row in here)}",
            f"{sum(row.outcomes[default].ended == 'verified' for row in here)}",
            *(f"{sum(promise in each for each in broken.values())}" for promise in BROKEN),
            f"{sum(each.seconds for row in here for each in row.outcomes.values()):.0f}",
            f"{len(numbers)}" if kind == "all" else " ".join(numbers),
        )
    return out


def read_results(file: Path | None) -> dict[str, Result]:
    """The results of a file by their case's name; a torn last line is passed over."""
    if file is None or not file.exists():
        return {}
    lines = [line for line in file.read_text(encoding="utf-8").splitlines() if line.endswith("}")]
    return {result.name: result for result in map(result_of, lines)}


def parser() -> argparse.ArgumentParser:
    """The parser of the command."""
    command = parser_of("random_cases", __doc__)
    command.add_argument(
        "names", nargs="*", metavar="CASE", help="single cases, such as bed_3, in place of the next three"
    )
    command.add_argument("--cases", type=whole_number, default=300, metavar="N", help="how many; default: 300")
    command.add_argument(
        "--first", type=int, default=0, metavar="K", help="number of each kind's first case; default: 0"
    )
    command.add_argument("--kinds", nargs="+", choices=list(KINDS), default=list(KINDS))
    command.add_argument(
        "--strategies", nargs="+", default=list(USUAL), type=one_of(STRATEGY_NAMES), metavar="NAME",
        help=f"default: {', '.join(USUAL)}",
    )  # fmt: skip
    command.add_argument("--default", default="sqp", type=one_of(STRATEGY_NAMES), help="the strategy that is judged")
    command.add_argument("--brute", action="store_true", help="search by brute force where no strategy verifies")
    command.add_argument("--out", type=Path, metavar="FILE.jsonl", help="append a line for each case there")
    command.add_argument("--write", type=Path, metavar="DIR", help="write the cases' files there, and solve nothing")
    return command


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit code: 1 if a promise is broken."""
    options = parser().parse_args(arguments)
    try:
        cases = named(options.names, options.kinds, options.first, options.cases)
    except ValueError as error:
        print(f"error: {error}", file=sys.stderr)
        return EXIT_INPUT
    if options.write is not None:
        options.write.mkdir(parents=True, exist_ok=True)
        for kind, number in cases:
            print(make_case(kind, number).write(options.write))
        return EXIT_VERIFIED
    strategies = list(dict.fromkeys([*options.strategies, options.default]))
    done, results = read_results(options.out), []
    for kind, number in cases:
        case = make_case(kind, number)
        before = done.get(case.name)
        if before is not None and not set(strategies) <= set(before.outcomes):
            before = None
        result = before or compare(case, strategies)
        if options.brute and not result.verified and result.possible is None:
            result = searched(case, result)
        if result is not before:
            print(result.line(options.default), flush=True)
            if options.out is not None:
                options.out.parent.mkdir(parents=True, exist_ok=True)
                with options.out.open("a", encoding="utf-8") as stream:
                    stream.write(result.json() + "\n")
        results.append(result)
    Console(width=150).print(table(results, options.default))
    return EXIT_BUG if any(result.broken(options.default) for result in results) else EXIT_VERIFIED


if __name__ == "__main__":
    sys.exit(main())
