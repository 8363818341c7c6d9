"""Every file of a published collection is printed, or refused with a reason: none crashes, hangs or comes out wrong.

python -m benchmarks.corpora aerofoils
python -m benchmarks.corpora logos --sample 100 --seed 1 --plan 3

Aerofoils (package aerosandbox) become wings with an 80 mm chord; logos (package @iconify-json/logos) become one layer,
60 mm wide, on the cylinder of cylinder_logo. The results are checked: a wing's beads lie in its section grown by a layer,
and fill as much of it as they should; a logo's beads lie on the cylinder and are as long as its lines. Exit code 1 for a
crash.
"""

from __future__ import annotations

import random
import re
import signal
import sys
import tempfile
import time
import traceback
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
import shapely
from rich.console import Console
from rich.table import Table

from benchmarks.command import parser_of
from benchmarks.corpus_archives import ARCHIVES, NoArchive
from planner.base.errors import EXIT_INPUT, EXIT_VERIFIED, InputError, PlannerError
from planner.planning.pipeline import solve
from planner.problem import Problem, find_problem, load_problem
from planner.problem.drawings import LayersSpec
from planner.problem.layers import AerofoilLayersSpec
from planner.toolpath.bead import Toolpath
from planner.toolpath.build import build_toolpath
from planner.toolpath.svg.outlines import read_svg_once
from planner.toolpath.wing.section import read_section

EXIT_CRASHED = 1
LONGEST = 120  # s of processor time for one file: beyond, it hangs
PLAN_DT = 0.008  # s: coarse, but flow is still checked by the millimetre
MADE, REFUSED, CRASHED = "made", "refused", "crashed"

# The shipped problem, and what is set in it for a file of the collection.
WING = (
    "layers={source: {aerofoil: '%s', chord_mm: 80, span_mm: 3, origin_mm: [15, 0, 40]}, height_mm: 1.5}",
    "process.bead.width_mm=1",
)
LOGO = ("layers.source={svg: '%s', width_mm: 60}", "layers.count=1")
SHIPPED = {"aerofoils": ("naca0015_wing", WING), "logos": ("cylinder_logo", LOGO)}

# Of a wing's section layers fill this share at least: steep places are left out. Thin sections may lack more, on average
# so much of a layer: one that is almost two layers thick gets one.
LEAST_FILLED, MOST_FILLED, MOST_MISSING = 0.65, 1.02, 1.1
# Rounding shortens the lines of a logo, small ones by up to a half; it makes none longer but by where it swings out.
SHORTEST_LINES, LONGEST_LINES = 0.5, 1.05
ON_SURFACE = 1e-6  # m


class Nonsense(Exception):
    """A toolpath that cannot be right."""


@dataclass(frozen=True)
class Outcome:
    """What became of a file; `plan` says what the planner made of it, where it was asked for."""

    name: str
    verdict: str
    detail: str
    seconds: float
    plan: str = ""


def check_wing(problem: Problem, toolpath: Toolpath) -> None:
    """Raise Nonsense for a wing whose beads do not fill its section."""
    spec = problem.layers
    if not isinstance(spec, AerofoilLayersSpec) or spec.source.aerofoil is None:
        raise Nonsense("is no wing")
    origin, height = np.array(spec.source.origin), spec.height
    points = spec.source.chord * read_section(spec.source.aerofoil) + origin[[0, 2]]
    section = shapely.make_valid(shapely.Polygon(points))
    area, grown = 0.0, shapely.buffer(section, height)
    for bead in toolpath.beads:
        if not shapely.contains_xy(grown, bead.points[:, 0], bead.points[:, 2]).all():
            raise Nonsense(f"bead {bead.name!r} lies outside of the section")
        y = bead.points[:, 1] - origin[1]
        if y.min() < 0.0 or y.max() > spec.source.span:
            raise Nonsense(f"bead {bead.name!r} lies beside the span")
        area += float(bead.s[-1] - bead.s[0]) * float(bead.width.mean() * bead.height.mean()) / spec.source.span
    filled, missing = area / section.area, (section.area - area) / (spec.source.chord * height)
    if filled > MOST_FILLED or (filled < LEAST_FILLED and missing > MOST_MISSING):
        raise Nonsense(f"beads fill {100 * filled:.0f} % of the section")


def check_logo(problem: Problem, toolpath: Toolpath) -> None:
    """Raise Nonsense for a logo whose beads do not lie on the cylinder, or are not as long as its lines."""
    spec, part = problem.layers, problem.part
    if not isinstance(spec, LayersSpec) or part is None or part.cylinder is None:
        raise Nonsense("is no drawing on a cylinder")
    drawn = sum(_length(path.points) for path in read_svg_once(spec.source.svg, spec.source.width, 1e-5)[0])
    printed, radius = 0.0, part.cylinder.radius + spec.height
    for bead in toolpath.beads:
        away = np.hypot(*(bead.points[:, :2] - part.cylinder.centre).T)
        if np.abs(away - radius).max() > ON_SURFACE:
            raise Nonsense(f"bead {bead.name!r} is {np.abs(away - radius).max():.2g} m off the cylinder")
        printed += float(bead.s[-1] - bead.s[0])
    share = printed / drawn
    if not SHORTEST_LINES <= share <= LONGEST_LINES * radius / part.cylinder.radius:
        raise Nonsense(f"beads are {100 * share:.0f} % as long as the lines")


def _length(points: np.ndarray) -> float:
    return float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())


CHECKS: dict[str, Callable[[Problem, Toolpath], None]] = {"aerofoils": check_wing, "logos": check_logo}


def run(corpus: str, planned: frozenset[str], case: tuple[str, bytes]) -> Outcome:
    """Build one file's toolpath and check it; plan it too, if it is among those to be `planned`."""
    name, content = case
    shipped, settings = SHIPPED[corpus]
    began = time.process_time()
    verdict, detail, plan = MADE, "", ""

    def hangs(*_: object) -> None:
        raise Nonsense(f"takes more than {LONGEST} s")

    signal.signal(signal.SIGVTALRM, hangs)
    signal.setitimer(signal.ITIMER_VIRTUAL, LONGEST)
    try:
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder) / ("case" + Path(name).suffix)
            file.write_bytes(content)
            problem = _problem(shipped, Path(folder), [text % file.name if "%s" in text else text for text in settings])
            CHECKS[corpus](problem, build_toolpath(problem))
            signal.setitimer(signal.ITIMER_VIRTUAL, 0)
            plan = _plan(problem) if name in planned else ""
    except InputError as error:
        verdict, detail = REFUSED, error.reason if error.line is None else f"{error.reason} (line {error.line})"
    except Exception as error:  # whatever it is, it is what is looked for
        verdict, detail = CRASHED, f"{error!r} {traceback.format_tb(error.__traceback__)[-1].strip()}"
    finally:
        signal.setitimer(signal.ITIMER_VIRTUAL, 0)
    return Outcome(name, verdict, detail, time.process_time() - began, plan)


def _problem(shipped: str, folder: Path, settings: list[str]) -> Problem:
    """The shipped problem in another folder, without a support, with some settings."""
    text = re.sub(r"(?m)^  support:.*\n", "", find_problem(shipped).read_text("utf-8"))
    path = folder / f"{shipped}.yaml"
    path.write_text(text, encoding="utf-8")
    return load_problem(path, settings)


def _plan(problem: Problem) -> str:
    try:
        plan = solve(problem, dt=PLAN_DT)
    except PlannerError as error:
        return f"no plan: {error}"
    failed = [check.name for check in plan.checks if not check.ok]
    return "verified" if plan.verified else f"not verified: {', '.join(failed)}"


def sampled(files: dict[str, bytes], count: int | None, seed: int) -> dict[str, bytes]:
    """So many of the files, chosen by the seed; all, if None."""
    names = sorted(files)
    if count is not None and count < len(names):
        names = sorted(random.Random(seed).sample(names, count))
    return {name: files[name] for name in names}


def kind_of(detail: str) -> str:
    """A reason without names and numbers, so that equal ones can be counted."""
    return re.sub(r"'[^']*'|\S+\.(dat|svg)\b|-?\d[\d.e-]*", "…", detail)


def report(outcomes: Sequence[Outcome], seconds: float) -> Table:
    """The outcomes, counted by reason."""
    table = Table("files", "outcome", "for example", title_justify="left")
    table.title = f"{len(outcomes)} files, {seconds:.0f} s ({sum(o.seconds for o in outcomes):.0f} s of processor time)"
    groups: dict[tuple[str, str], list[Outcome]] = {}
    for outcome in outcomes:
        groups.setdefault((outcome.verdict, kind_of(outcome.detail)), []).append(outcome)
    for (verdict, _), group in sorted(groups.items(), key=lambda item: (item[0][0] != MADE, -len(item[1]))):
        example = group[0]
        table.add_row(f"{len(group)}", verdict, f"{example.name}: {example.detail}" if example.detail else "")
    slow = sorted(outcomes, key=lambda outcome: -outcome.seconds)[:3]
    table.add_row("", "slowest", ", ".join(f"{o.name} {o.seconds:.1f} s" for o in slow))
    for outcome in outcomes:
        if outcome.plan:
            table.add_row("", "planned", f"{outcome.name}: {outcome.plan}")
    return table


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit code."""
    parser = parser_of("corpora", __doc__)
    parser.add_argument("corpus", choices=sorted(ARCHIVES))
    parser.add_argument("--archive", type=Path, metavar="FILE", help="the package's file; default: it is downloaded")
    parser.add_argument("--sample", type=int, metavar="N", help="number of files; default: all")
    parser.add_argument("--seed", type=int, default=1, help="seed that chooses the sample, and what is planned")
    parser.add_argument("--plan", type=int, default=0, metavar="K", help="plan K of them completely")
    parser.add_argument("--jobs", type=int, default=2, help="processes")
    options = parser.parse_args(arguments)
    try:
        files = sampled(ARCHIVES[options.corpus].files(options.archive), options.sample, options.seed)
    except NoArchive as error:
        print(f"error: {error}", file=sys.stderr)
        return EXIT_INPUT
    planned = frozenset(sampled(files, options.plan, options.seed)) if options.plan else frozenset()
    began = time.perf_counter()
    with ProcessPoolExecutor(options.jobs) as pool:
        outcomes = list(pool.map(partial(run, options.corpus, planned), files.items(), chunksize=4))
    Console(width=170).print(report(outcomes, time.perf_counter() - began))
    return EXIT_CRASHED if any(outcome.verdict == CRASHED for outcome in outcomes) else EXIT_VERIFIED


if __name__ == "__main__":
    sys.exit(main())
