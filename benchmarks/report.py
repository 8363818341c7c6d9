"""Tables and figures from a table of runs: what was claimed and what was verified, how fast, and ours next to the peers.

python -m benchmarks.report out/benchmarks/runs.csv
python -m benchmarks.report runs.csv peers.csv published.csv --programs programs.csv --out benchmarks/results/2026-11-22

Writes report.md and its figures. The same rows give the same report. Of several commits, the one with the newest row counts.
Rows of `benchmarks.published` and `benchmarks.chen`, whose problems are files of others, are summarised for each cell.
"""

from __future__ import annotations

import math
import statistics
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

from benchmarks.command import parser_of
from benchmarks.figures import draw_figures
from benchmarks.programs import ASKED, DIFFERENCES, PLAYED, read_programs
from benchmarks.rows import Row, read_rows
from benchmarks.summary import (
    AT_SPEED,
    BOUND,
    FILES_ON,
    JERK,
    MARGIN,
    MEMORY,
    NOT_WORSE,
    OFF,
    OURS,
    OVER_BOUND,
    OVER_IDEAL,
    PATHS,
    PLANS,
    RATE,
    SECONDS,
    SIGMA,
    STEP,
    WHOLE,
    Measure,
    OfFiles,
    Race,
    Result,
    Versus,
    against_peers,
    files_of,
    is_file,
    of_one_commit,
    results_of,
)
from planner.base.command_line import exit_code
from planner.base.errors import EXIT_VERIFIED, InputError
from planner.base.results import results_folder
from planner.problem.settings import STRATEGY_NAMES
from planner.verify.checks import SPEED_TOLERANCE
from planner.verify.verdict import AXIS_TOLERANCE, POSITION_TOLERANCE

REPORT = "report.md"
AIM = 10.0  # times the waypoints per second of the fastest peer that verifies
NONE = "–"
LIMITATIONS = (
    "Nothing here was printed: plans are verified in simulation, against the robots' data sheets.",
    "Seconds are wall-clock on the one machine named above, and grow with whatever else runs there.",
    "Each problem and strategy has its default settings: none is tuned, none gets a second try.",
    "`as_published`, `fixed` and `greedy` are this project's own versions of common ways to decide the free motion, not "
    "the programs of those who published them.",
    "Waypoints per second depend on how close waypoints stand; compare within a problem. They count what plans and "
    "verifies (load, toolpath, obstacles, resolve, timing, travel, verify), not the writing of files.",
    "Repeats tell how far times scatter. Plans do not: the same input gives the same plan.",
    "The bound is that of the joint paths that were found, without jerk limits; other paths may have a lower one.",
    "Memory is the most that was held at once; what processes share is counted once, looked at four times a second.",
    "Robots, parts and speeds are few, and chosen by this project, but for those from papers and peers.",
)
MATRICES: tuple[tuple[Measure, str], ...] = (
    (AT_SPEED, "Share of the length printed at the commanded speed, within 2 %."),
    (OVER_IDEAL, "Deposition time over the time at constant speed. 1 is the best there can be."),
    (
        OVER_BOUND,
        "Deposition time over its bound: what joint speed and acceleration alone allow on the same joint paths.",
    ),
    (BOUND, "That bound over the time at constant speed."),
    (SIGMA, "Distance from singularities: least singular value of the arm's Jacobian while printing. More is better."),
    (MARGIN, "Least distance of any joint from an end of its range, at waypoints. More is better."),
    (STEP, "Largest change of any joint from one waypoint to the next. Less is better."),
    (JERK, "Greatest jerk over its limit; verified plans stay below 1."),
    (RATE, "Waypoints planned and verified per second."),
    (SECONDS, "Seconds of the whole run, dips and maps included, without the writing of files."),
    (MEMORY, "Memory, MB."),
)
OF_A_LOSS = (AT_SPEED, OVER_IDEAL, WHOLE, SIGMA, MARGIN, STEP)  # what a better measure is paid with, if with anything
OF_FILES: tuple[str, ...] = ("planned on", "planner", "files", "verified", "not all checks hold", "no plan")
OF_FILES += ("at speed, median", "lowest tenth", f"{OVER_IDEAL.name}, median", f"{SIGMA.name}, least")
OF_PEERS = (PLANS, PATHS, MEMORY, SIGMA, STEP, MARGIN, OFF, AT_SPEED)


def report(
    rows: Sequence[Row], figures: Sequence[tuple[str, str]], programs: Sequence[Mapping[str, str]] = ()
) -> list[str]:
    """The report's lines; figures: file and description of each; programs: rows of `benchmarks.programs`."""
    chosen, others = of_one_commit(rows)
    results = results_of([row for row in chosen if not is_file(row)])
    ours = [result for result in results if result.ours and result.strategy in STRATEGY_NAMES]
    sets = _sets(results)
    lines = [
        "# Benchmarks",
        "",
        *_heading(chosen, others),
        *(f"- settings {mark}: `{own}`" for own, mark in sets.items() if own),
    ]
    lines += ["", "## What these figures do not tell", "", *(f"- {text}" for text in LIMITATIONS)]
    if results:
        lines += ["", "## Claimed and verified", "", *_success(results)]
    if ours:
        lines += ["", *_verdicts(ours, sets)]
    lines += _peers(against_peers(results), sets)
    lines += [line for name, words in figures for line in ("", f"![{words}]({name})")]
    if ours:
        lines += ["", "## By problem and strategy", "", _KEY]
        lines += [line for measure, words in MATRICES for line in ("", words, "", *_matrix(ours, measure, sets))]
    return [*lines, *_files(files_of(chosen)), *_programs(programs, str(chosen[0]["commit"]))]


_KEY = (
    "Medians, least and greatest of repeats in brackets where they differ. *Slanted*: there is a plan, but not all its checks "
    f"hold. {NONE}: no plan."
)


def _heading(chosen: Sequence[Row], others: Sequence[Row]) -> list[str]:
    """On what, when, of what."""
    days = sorted({str(row["date"])[:10] for row in chosen})
    repeats = 1 + max(int(row["repeat"]) for row in chosen)
    versions = dict.fromkeys(str(row["versions"]) for row in chosen if row["versions"])
    lines = [
        f"- {len(chosen)} runs, {' to '.join(dict.fromkeys([days[0], days[-1]]))}; repeats: {repeats}",
        f"- machine: {chosen[0]['machine']}",
        f"- commit: {chosen[0]['commit']}",
        *(f"- {text}" for text in versions),
        f"- verified: all checks hold; tip within {POSITION_TOLERANCE * 1e3:g} mm of its bead, nozzle within "
        f"{math.degrees(AXIS_TOLERANCE):g}° of the normal or its cone, never more than {100 * SPEED_TOLERANCE:g} % faster than "
        "commanded, all joint limits held, clearances kept",
    ]
    if others:
        of = ", ".join(dict.fromkeys(str(row["commit"]) for row in others))
        lines.append(f"- rows left out, of another commit or machine: {len(others)} ({of})")
    return lines


def _sets(results: Sequence[Result]) -> dict[str, str]:
    """What marks settings other than none in the tables: letters, in order."""
    own = [text for text in dict.fromkeys(result.set for result in results) if text]
    return {"": "", **{text: f"[{chr(ord('a') + i % 26) * (1 + i // 26)}]" for i, text in enumerate(own)}}


def _named(result: Result, sets: dict[str, str]) -> str:
    return f"{result.problem} {sets[result.set]}".strip()


def table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    """A table in Markdown: the first column to the left, the others to the right."""
    ruled = ["---", *["---:"] * (len(header) - 1)]
    return [f"| {' | '.join(cell.replace('|', '/') for cell in row)} |" for row in (header, ruled, *rows)]


def _success(results: Sequence[Result]) -> list[str]:
    """How many runs of each strategy gave a plan, and how many of these hold."""
    groups: dict[str, list[Result]] = {}
    for result in results:
        groups.setdefault(result.label, []).append(result)
    rows = []
    for label, own in groups.items():
        claimed, held = sum(r.found for r in own), sum(r.verified for r in own)
        share = f"{100 * held / claimed:.0f} %" if claimed else NONE
        rows.append([label, f"{len(own)}", f"{claimed}", f"{held}", share])
    return table(("planner", "problems", "claimed", "verified", "of claimed"), rows)


def _verdicts(ours: Sequence[Result], sets: dict[str, str]) -> list[str]:
    """What became of each problem by each strategy, and why where it did not hold."""
    strategies = list(dict.fromkeys(result.strategy for result in ours))
    by = {(_named(r, sets), r.strategy): r for r in ours}
    problems = list(dict.fromkeys(name for name, _ in by))
    lines = table(("problem", *strategies), [[p, *(_verdict(by.get((p, s))) for s in strategies)] for p in problems])
    why = [f"- {p}, {s}: {r.reason}" for (p, s), r in by.items() if r.reason]
    return [*lines, "", *why] if why else lines


def _verdict(result: Result | None) -> str:
    if result is None:
        return ""
    return (
        "verified"
        if result.verified
        else "claimed"
        if result.found
        else result.reason.partition(":")[0].partition(" (")[0]
    )


def _matrix(ours: Sequence[Result], measure: Measure, sets: dict[str, str]) -> list[str]:
    """One measure of all problems by all strategies."""
    strategies = list(dict.fromkeys(result.strategy for result in ours))
    by = {(_named(r, sets), r.strategy): r for r in ours}
    problems = list(dict.fromkeys(name for name, _ in by))
    rows = [[p, *(cell(by[p, s], measure) if (p, s) in by else "" for s in strategies)] for p in problems]
    return table((measure.name, *strategies), rows)


def cell(result: Result, measure: Measure) -> str:
    """Median and spread of a measure, slanted where the plan does not hold."""
    spread = result.spread(measure)
    if spread is None:
        return NONE
    median, low, high = (measure.form(x) for x in (spread.median, spread.low, spread.high))
    text = median if low == high else f"{median} ({low} to {high})"
    return text if result.verified else f"*{text}*"


def _peers(against: Sequence[Versus], sets: dict[str, str]) -> list[str]:
    """Ours beside the peers; nothing where no peer ran."""
    if not against:
        return []
    lines = [
        "", "## Beside other planners", "",
        "Same waypoints, arm and limits. Peers plan joint paths, without collision, and know neither jerk limits nor the "
        "print; timing and verifying their paths is our work, checks on distances left out. *Plans* per second count resolve, "
        "timing, travel and verification on both sides, *joint paths* per second what resolves the free motion alone: of ours without "
        "collision too, where that was run. Both for the poses that the peer was given, "
        "beside the fastest peer that verifies. Margins and the share at speed are of ours with collision, beside the best of all these peers.",
        "",
    ]  # fmt: skip
    plans, joints = (
        (f"{what}/s: ours", "fastest peer", "ratio", f"{AIM:g} times") for what in ("plans", "joint paths")
    )
    judged = [f"{measure.name} no worse" for measure in NOT_WORSE]
    lines += table(("problem", *plans, *joints, *judged), [_against(each, sets) for each in against])
    words = dict.fromkeys((r.label, r.planner) for each in against for r in each.beside if r.label != r.planner)
    lines += ["", *(f"- {label}: {planner}" for label, planner in words if not planner.startswith(OURS))]
    lines += _where_we_lose(against, sets)
    for each in against:
        all_of_it = sorted((each.ours, *each.beside), key=lambda result: not result.ours)
        rows = [[r.label, "yes" if r.verified else "no", *(cell(r, m) for m in OF_PEERS)] for r in all_of_it]
        lines += ["", f"### {_named(each.ours, sets)}", ""]
        lines += table(("planner", "verified", *(m.name for m in OF_PEERS)), rows)
        why = [f"- {r.label}: {r.reason}" for r in all_of_it if r.reason]
        lines += ["", *why] if why else []
    return lines


def _files(groups: Sequence[OfFiles]) -> list[str]:
    """What became of files that others published; nothing where none was planned."""
    if not groups:
        return []
    lines = ["", "## Files that others published", "", "Shares, times and σ are those of verified plans.", ""]
    lines += table(OF_FILES, [_of_files(group) for group in groups])
    for group in (group for group in groups if group.reasons):
        lines += ["", f"- {group.on.removeprefix(FILES_ON)}, {group.strategy}, not verified:"]
        lines += [f"    - {count} × {reason}" for reason, count in group.reasons]
    return lines


def _of_files(group: OfFiles) -> list[str]:
    speeds, over, sigma = (group.values(measure) for measure in (AT_SPEED, OVER_IDEAL, SIGMA))
    counts = (len(group.rows), len(group.verified), group.failed, group.without_plan)
    figures = (
        AT_SPEED.form(statistics.median(speeds)) if speeds else NONE,
        AT_SPEED.form(speeds[len(speeds) // 10]) if speeds else NONE,
        OVER_IDEAL.form(statistics.median(over)) if over else NONE,
        SIGMA.form(sigma[0]) if sigma else NONE,
    )
    return [group.on.removeprefix(FILES_ON), group.strategy, *map(str, counts), *figures]


def _programs(rows: Sequence[Mapping[str, str]], commit: str) -> list[str]:
    """What programs in RAPID ask of a controller, and how near they are to their plans when they are played."""
    if not rows:
        return []
    lines = ["", "## Programs in RAPID, read back and played", ""]
    others = sorted({row["commit"] for row in rows} - {commit})
    lines += [f"Of another commit: {', '.join(others)}.", ""] if others else []
    for columns in (ASKED, PLAYED):
        lines += [*table(columns, [[row[name] for name in columns] for row in rows]), ""]
    told = [f"- {row[PLAYED[0]]}: {row[DIFFERENCES]}" for row in rows if row[DIFFERENCES]]
    return [*lines, *(told or ["Read back and played, every program repeats its plan within its tolerances."])]


def _where_we_lose(against: Sequence[Versus], sets: dict[str, str]) -> list[str]:
    """Where ours is behind: what a peer that is better in one measure has in the others, and what holds rates down."""
    rows = [
        [_named(each.ours, sets), f"{measure.name}: {cell(each.ours, measure)} against {cell(peer, measure)}, {peer.label}",
         *(f"{cell(each.ours, other)}; {cell(peer, other)}" for other in OF_A_LOSS)]
        for each in against
        for measure in NOT_WORSE
        if not each.no_worse.get(measure.name, True)
        for peer in (each.best[measure.name],)
    ]  # fmt: skip
    slow = [
        [_named(each.ours, sets), f"{each.plans.ratio:.1f}", f"{each.ceiling:.1f}"]
        for each in against
        if each.plans is not None and each.ceiling is not None and each.plans.ratio < AIM
    ]
    lines = ["", "### Where a peer is ahead", ""] if rows or slow else []
    if rows:
        lines += ["Ours first, then the peer that is best at that measure.", ""]
        lines += table(("problem", "behind in", *(measure.name for measure in OF_A_LOSS)), rows)
    if slow:
        lines += [
            "", f"Plans/s below {AIM:g} times, and what the ratio would be if our joint paths took no time at all: timing, travel "
            "and verification are the same work on both sides.", "",
        ]  # fmt: skip
        lines += table(("problem", "ratio", "with joint paths in no time"), slow)
    return lines


def _against(each: Versus, sets: dict[str, str]) -> list[str]:
    judged = [_yes(each.no_worse[m.name]) if m.name in each.no_worse else NONE for m in NOT_WORSE]
    return [_named(each.ours, sets), *_race(each, each.plans), *_race(each, each.joints), *judged]


def _race(each: Versus, race: Race | None) -> list[str]:
    if race is None:
        why = "none verifies" if each.ours.verified else "ours is not verified"
        return [NONE, why, NONE, NONE]
    theirs = f"{RATE.form(race.theirs)}, {race.peer.label}"
    return [RATE.form(race.ours), theirs, f"{race.ratio:.1f}", _yes(race.ratio >= AIM)]


def _yes(value: bool) -> str:
    return "yes" if value else "**no**"


def write_report(rows: Sequence[Row], folder: Path, programs: Sequence[Mapping[str, str]] = ()) -> None:
    """Write the report and its figures, all or none. Raises OutputError where the folder cannot be written."""
    with results_folder(folder, "benchmarks.report") as fresh:
        figures = draw_figures(results_of([row for row in of_one_commit(rows)[0] if not is_file(row)]), fresh)
        (fresh / REPORT).write_text("\n".join(report(rows, figures, programs)) + "\n", encoding="utf-8")


def _run(files: Sequence[Path], folder: Path | None, programs: Path | None) -> int:
    rows = [row for file in files for row in read_rows(file)]
    if not rows:
        raise InputError("has no rows", file=files[0], hint="python -m benchmarks.run --out writes some")
    target = folder or files[0].parent / f"{files[0].stem}_report"
    write_report(rows, target, () if programs is None else read_programs(programs))
    print(target / REPORT)
    return EXIT_VERIFIED


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit code."""
    command = parser_of("report", __doc__)
    command.add_argument("files", nargs="+", type=Path, metavar="FILE.csv", help="tables of runs, peers' too")
    command.add_argument("--out", type=Path, metavar="FOLDER", help="default: beside the file, named after it")
    command.add_argument("--programs", type=Path, metavar="FILE.csv", help="what benchmarks.programs --out wrote")
    options = command.parse_args(arguments)
    return exit_code(
        lambda: _run(options.files, options.out, options.programs), lambda text: print(text, file=sys.stderr)
    )


if __name__ == "__main__":
    sys.exit(main())
