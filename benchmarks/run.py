"""Problems and strategies: each is planned and verified, with one table row per run.

python -m benchmarks.run
python -m benchmarks.run --problems peer_cap cylinder_logo --strategies ladder sqp --coarse --out quick.csv
python -m benchmarks.run --problems peer_cap@10000 --set process.speed_mm_s=30 --repeat 3 --limit 600

Each run has its own process and a warm-up: nothing is compiled during a measurement. A refusal, a crash, and a run that
takes too long or is killed are rows with their reason. To continue an interrupted run, give the same command again.
python -m benchmarks.report FILE.csv makes tables and figures of the rows.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TypeVar

from benchmarks.command import parser_of
from benchmarks.named import all_problems, coarse, load_named
from benchmarks.rows import KEY, Row, Run, append_row, check_columns, key_of, read_rows, row_without_plan
from benchmarks.single import Job, beadwise, run_apart
from benchmarks.usage import commit, machine
from planner.base.command_line import exit_code, one_of
from planner.base.distribution import spread
from planner.base.errors import EXIT_VERIFIED, PlannerError
from planner.planning.options import add_spread
from planner.problem.settings import STRATEGY_NAMES

Item = TypeVar("Item")

OUT = Path("out/benchmarks/runs.csv")
FOR_SMALL_ONES = ("nlp",)  # minutes for a thousand waypoints: run where it is asked for


def grid(
    problems: Sequence[str], strategies: Sequence[str], settings: Sequence[str], repeats: int, quick: bool
) -> list[Run]:
    """All runs, one round of repeats after the other. Raises InputError for whatever is wrong with a problem."""
    chosen: dict[str, tuple[str, ...]] = {}
    with tempfile.TemporaryDirectory() as folder:
        for name in problems:
            problem = load_named(name, (), Path(folder))
            chosen[name] = (*(coarse(problem) if quick else ()), *settings)
            load_named(name, chosen[name], Path(folder))
    planner, each = beadwise(), dict.fromkeys(strategies)
    return [
        Run(name, strategy, own, repeat, planner)
        for repeat in range(repeats)
        for name, own in chosen.items()
        for strategy in each
    ]


def left(runs: Sequence[Run], rows: Sequence[Row], here: Sequence[str]) -> list[Run]:
    """The runs that have no row yet; here: this commit, and this machine where it is the one that runs them."""
    done = {key_of(row)[: KEY.index("commit") + len(here)] for row in rows}
    return [run for run in runs if (*run.key, *here) not in done]


def told(runs: Sequence[Run], todo: Sequence[Run], rows: Sequence[Row], file: Path) -> list[str]:
    """What to know before it begins."""
    lines = [
        f"{len(todo)} runs" + (f", {len(runs) - len(todo)} are in {file} already" if len(todo) < len(runs) else "")
    ]
    here = (commit(), machine())
    others = [row for row in rows if (row["commit"], row["machine"]) != here]
    if others:
        of = ", ".join(dict.fromkeys(str(row["commit"]) for row in others))
        lines.append(f"{len(others)} rows in it are of another commit ({of}): they stay, and are reported apart")
    return lines


def line(row: Row) -> str:
    """A row in a line."""
    words = Run(str(row["problem"]), str(row["strategy"]), (), int(row["repeat"])).words
    if not row["found"]:
        return f"{words}: {row['reason']}"
    verdict = "verified" if row["verified"] else f"not verified: {row['reason']}"
    rate, seconds, memory = (float(row[name]) for name in ("waypoints_per_s", "seconds_total", "peak_mb"))
    return f"{words}: {rate:.0f} waypoints/s, {seconds:.1f} s, {memory:.0f} MB, {verdict}"


def whole_number(text: str) -> int:
    """A whole number from 1."""
    if not text.isdecimal() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"{text!r} is no whole number from 1")
    return int(text)


def some_seconds(text: str) -> float:
    """A time above 0 [s]."""
    try:
        seconds = float(text)
    except ValueError as error:
        raise argparse.ArgumentTypeError(f"{text!r} is no number of seconds") from error
    if not 0.0 < seconds < float("inf"):
        raise argparse.ArgumentTypeError(f"{text!r} is no time above 0")
    return seconds


def add_options(command: argparse.ArgumentParser, out: Path) -> None:
    """Add what every table of runs can be told: see `carry_out`."""
    command.add_argument(
        "--set", action="append", default=[], metavar="KEY=VALUE", help="change a field of all problems; repeatable"
    )
    command.add_argument("--repeat", type=whole_number, default=1, metavar="N", help="how many times to run each")
    command.add_argument("--coarse", action="store_true", help="a quick look: a coarse search, one layer")
    command.add_argument(
        "--limit", type=some_seconds, metavar="SECONDS", help="end a run that takes longer, its warm-up included"
    )
    add_spread(command)
    command.add_argument("--out", type=Path, default=out, metavar="FILE.csv", help=f"default: {out}")
    command.add_argument("--anew", action="store_true", help="also run what has a row already: the last row counts")


def parser() -> argparse.ArgumentParser:
    """The parser of the command."""
    command = parser_of("run", __doc__)
    usual = [name for name in STRATEGY_NAMES if name not in FOR_SMALL_ONES]
    command.add_argument(
        "--problems", nargs="+", default=all_problems(), metavar="NAME",
        help="shipped problems, files, or peer_cap@10000: that case in so many waypoints; default: all that ship, and the "
        "peers' cases in full",
    )  # fmt: skip
    command.add_argument(
        "--strategies", nargs="+", default=usual, type=one_of(STRATEGY_NAMES), metavar="NAME",
        help=f"of {', '.join(STRATEGY_NAMES)}; default: all but {', '.join(FOR_SMALL_ONES)}, which is for small problems",
    )  # fmt: skip
    add_options(command, OUT)
    return command


def carry_out(runs: Sequence[Run], options: argparse.Namespace) -> None:
    """Run what has no row yet, and append its row to the file."""
    rows = read_rows(options.out) if options.out.exists() else []
    here = (commit(), machine()) if options.scheduler is None else (commit(),)
    todo = runs if options.anew else left(runs, rows, here)
    for text in told(runs, todo, rows, options.out):
        print(text, file=sys.stderr)
    jobs: list[Job] = [(each, options.limit) for each in todo]
    fill(run_apart, jobs, todo, options)


def fill(work: Callable[[Item], Row], items: Sequence[Item], runs: Sequence[Run], options: argparse.Namespace) -> None:
    """Append to the table what work makes of each item, as it is done; runs: what stands for an item that is lost.

    Raises InputError, before anything is done, for a table with other columns.
    """
    if items:
        check_columns(options.out)
    for number, (i, done) in enumerate(spread(work, items, options.jobs, options.scheduler), 1):
        row = row_without_plan(runs[i], f"lost: {done}", {}) if isinstance(done, PlannerError) else done
        append_row(options.out, row)
        print(f"[{number}/{len(items)}] {line(row)}", file=sys.stderr, flush=True)


def ended(what: Callable[[], int], out: Path) -> int:
    """The exit code of a command that fills a table."""
    stays = f"what is done is in {out}; the same command continues"
    return exit_code(what, lambda text: print(text, file=sys.stderr), stays)


def _run(options: argparse.Namespace) -> int:
    carry_out(grid(options.problems, options.strategies, options.set, options.repeat, options.coarse), options)
    print(f"python -m benchmarks.report {options.out}")
    return EXIT_VERIFIED


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit code: 0 even where runs gave no plan, for that is what the rows are for."""
    options = parser().parse_args(arguments)
    return ended(lambda: _run(options), options.out)


if __name__ == "__main__":
    sys.exit(main())
