"""What is spoilt on purpose, at random: what is not found, though it is beyond tolerance, is an escape.

python -m benchmarks.attack [--only KIND …] [--count N] [--case N] [--seed 0] [--jobs 2] [--csv FILE]

An attack is the same for its kind, number and seed, whichever others are run: `--only krl --case 17` runs one again.
Exit code 1 if anything escaped.
"""

from __future__ import annotations

import argparse
import csv
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path

from rich.console import Console
from rich.table import Table

from benchmarks.attack.cases import ESCAPED, HARMS, VERDICTS, Attack, Kind, one, run
from planner.base.errors import EXIT_VERIFIED, nearest_name
from planner.base.processes import cores

EXIT_ESCAPED = 1
TABLE_WIDTH = 170  # columns, also where no terminal is
# modules that have KINDS
SUBJECTS = (
    "problems", "files", "motions", "programs", "extruder", "recordings", "tables", "clouds", "kills", "determinism",
)  # fmt: skip


def kinds() -> dict[str, Kind]:
    """All kinds of attack by name, in the order of SUBJECTS."""
    found: dict[str, Kind] = {}
    for subject in SUBJECTS:
        found |= import_module(f"benchmarks.attack.{subject}").KINDS
    return found


def table_of(done: Sequence[Attack], title: str) -> Table:
    """Verdicts and harm by kind, with their sums."""
    table = Table("kind", "cases", *VERDICTS, *HARMS, "s", title=title)
    names = list(dict.fromkeys(attack.kind for attack in done))
    for name in [*names, "all"]:
        own = [attack for attack in done if name in (attack.kind, "all")]
        verdicts = Counter(attack.outcome.verdict for attack in own)
        harm = sum((Counter(attack.outcome.harm) for attack in own), Counter[str]())
        seconds = f"{sum(attack.seconds for attack in own):.0f}"
        counts = [*(verdicts[verdict] for verdict in VERDICTS), *(harm[each] for each in HARMS)]
        table.add_row(name, str(len(own)), *map(str, counts), seconds, end_section=name == names[-1])
    return table


def command_line() -> argparse.ArgumentParser:
    """The parser of the command."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.attack",
        description=(__doc__ or "").split("\n")[0],
        epilog="kinds: " + "; ".join(f"{name}: {kind.does} ({kind.count})" for name, kind in kinds().items()),
    )
    parser.add_argument("--only", nargs="+", metavar="KIND", help="these kinds (default: all)")
    parser.add_argument("--count", type=int, help="attacks of each kind (default: as many as each kind has)")
    parser.add_argument("--case", type=int, help="the attack of this number alone, here and now")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--jobs", type=int, default=cores(), help="processes (default: as many as there are cores)")
    parser.add_argument("--csv", type=Path, metavar="FILE", help="a row for each attack")
    parser.add_argument("--told", action="store_true", help="a line on each attack, whatever came of it")
    return parser


def main(arguments: Sequence[str] | None = None) -> int:
    """The command; returns its exit code."""
    parser = command_line()
    options = parser.parse_args(arguments)
    known = kinds()
    chosen = options.only or list(known)
    for name in chosen:
        if name not in known:
            near = nearest_name(name, known)
            parser.error(
                f"there is no kind {name!r}" + (f": did you mean {near}?" if near else f": {', '.join(known)}")
            )
    done: list[Attack] = []
    began = time.monotonic()
    for name in chosen:
        with tempfile.TemporaryDirectory(prefix="beadwise-attack-") as folder:
            case = known[name].prepare(Path(folder))
            if options.case is not None:
                done.append(Attack(name, options.case, one(case, name, options.case, options.seed), 0.0, 0.0))
            else:
                count = known[name].count if options.count is None else options.count
                done += run(name, case, range(count), options.seed, options.jobs)
        print(f"{name}: done after {time.monotonic() - began:.0f} s", file=sys.stderr)
    if options.csv is not None:
        with options.csv.open("w", encoding="utf-8", errors="backslashreplace", newline="") as stream:
            rows = [
                (a.kind, a.number, a.outcome.what, a.outcome.verdict, a.outcome.told, a.seconds, a.memory) for a in done
            ]
            csv.writer(stream).writerows([("kind", "number", "what", "verdict", "told", "seconds", "MB"), *rows])
    Console(width=TABLE_WIDTH).print(table_of(done, f"seed {options.seed}, {time.monotonic() - began:.0f} s"))
    bad = [attack for attack in done if attack.outcome.verdict == ESCAPED or attack.outcome.harm]
    for attack in done if options.told or options.case is not None else bad:
        print(attack.words.encode("ascii", "backslashreplace").decode())
    return EXIT_ESCAPED if bad else EXIT_VERIFIED
