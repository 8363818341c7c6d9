"""The command line of `python -m planner.place`: a map of where the part can be printed, and the best places."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import QuadMesh
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from rich.console import Console
from rich.table import Table

from planner.base.command_line import Command, exit_code
from planner.base.distribution import crew as spread_crew
from planner.base.errors import EXIT_VERIFIED, OutputError
from planner.base.progress import Stages
from planner.base.results import results_folder
from planner.base.signals import no_more_interruptions
from planner.cell.cell import build_cell
from planner.place.site import ANGLES, FREEDOMS, PartPlace, StudyRequest, axes_of, changed_fields, place_of, site_of
from planner.place.study import LAID_LIMITS, Crew, PlaceOutcome, Slice, Study, crew_of, study
from planner.planning.context import check_unchanged, found_anywhere
from planner.planning.options import add_problem, add_set, add_spread, add_strategy
from planner.problem import Problem, load_problem
from planner.problem.rewrite import write_changed

# ----------------------------------------------------------------------------------------------------
# The map of a placement's score: a table of all places scored, and a picture of slices through them.

COLOURS = "cividis"  # readable with any colour vision, and in grey
PRESENT, BEST = "#d55e00", "#ffffff"
_UNREACHABLE = "#d9d9d9"


def units(name: str) -> tuple[str, float]:
    """Unit of a coordinate in tables, and its factor from SI units."""
    return ("deg", 180.0 / np.pi) if name in ANGLES else ("mm", 1e3)


def number(place: PartPlace, name: str) -> str:
    """A coordinate in its unit, rounded to an integer; never -0."""
    return f"{round(getattr(place, name) * units(name)[1])}"


def words(place: PartPlace, names: Sequence[str]) -> str:
    """A place in words: the coordinates `names`."""
    return ", ".join(f"{name} {number(place, name)}" for name in names)


def write_table(study: Study, path: Path) -> None:
    """Write every place scored as CSV: its kind, its coordinates, and its score (0: out of reach)."""
    rows = [("present", study.now, study.now_rating.score)]
    rows += [("best", place, rating.score) for place, rating in study.best]
    rows += [("resolved", place, score) for place, score in study.resolved]
    rows += [("lattice", place, score) for place, score in study.tried]
    names = [axis.name for axis in study.axes]
    for piece in study.slices:
        for i, j in np.ndindex(piece.scores.shape):
            values = dict(zip(names[:2], (float(piece.u[i]), float(piece.v[j])), strict=False))
            place = PartPlace(**{name: values.get(name, getattr(piece.others, name)) for name in FREEDOMS})
            rows.append(("map", place, float(piece.scores[i, j])))
    head = ",".join(["kind", *(f"{name}_{units(name)[0]}" for name in FREEDOMS), "score"])
    lines = [
        ",".join([kind, *(f"{getattr(place, name) * units(name)[1]:.3f}" for name in FREEDOMS), f"{score:.5f}"])
        for kind, place, score in rows
    ]
    path.write_text("\n".join([head, *lines]) + "\n", encoding="utf-8")


def draw_map(study: Study, title: str, path: Path) -> None:
    """Draw the slices of a study side by side into a PNG, with the present place and the best ones marked.

    Places out of reach are grey and hatched; a dashed line marks scores of 1, above which everything is comfortable.
    """
    names = [axis.name for axis in study.axes]
    top = max(1e-3, *(float(piece.scores.max()) for piece in study.slices))
    norm = Normalize(0.0, top)
    n = len(study.slices)
    figure = Figure(figsize=(5.6 * n + 1.2, 5.4), dpi=130, facecolor="white", layout="constrained")
    panels = figure.subplots(1, n, squeeze=False)[0]
    for panel, piece in zip(panels, study.slices, strict=True):
        held = words(piece.others, names[2:])
        panel.set_title(f"{piece.title}{': ' + held if held else ''}", fontsize=10)
        panel.set_xlabel(f"{names[0]} [{units(names[0])[0]}]")
        if len(names) > 1:
            panel.set_ylabel(f"{names[1]} [{units(names[1])[0]}]")
            drawn = _field(panel, piece, names, norm)
        else:
            u = piece.u * units(names[0])[1]
            panel.plot(u, piece.scores[:, 0], color="#00224e")
            panel.fill_between(
                u, 0.0, top, where=piece.scores[:, 0] <= 0.0, color=_UNREACHABLE, hatch="///", step="mid"
            )
            panel.set_ylabel("score")
            drawn = None
        _mark(panel, study, names)
        panel.legend(loc="upper right", fontsize=8, facecolor="#8a8a8a", labelcolor="white", framealpha=0.9)
    if drawn is not None:
        figure.colorbar(drawn, ax=list(panels), label="score: least margin over the path (1: comfortable)")
    figure.suptitle(title)
    FigureCanvasAgg(figure).print_png(str(path), metadata={"Software": None})


def _field(panel: Axes, piece: Slice, names: Sequence[str], norm: Normalize) -> QuadMesh:
    u, v = piece.u * units(names[0])[1], piece.v * units(names[1])[1]
    scores = np.ma.masked_less_equal(piece.scores.T, 0.0)
    panel.set_facecolor(_UNREACHABLE)
    panel.patch.set(hatch="///", edgecolor="#9a9a9a")
    drawn = panel.pcolormesh(u, v, scores, cmap=COLOURS, norm=norm, shading="nearest")
    if piece.scores.min() < 1.0 < piece.scores.max() and min(piece.scores.shape) > 1:
        panel.contour(u, v, piece.scores.T, levels=[1.0], colors="white", linestyles="dashed", linewidths=1.0)
    if names[0] not in ANGLES and names[1] not in ANGLES:
        panel.set_aspect("equal")
    return drawn


def _mark(panel: Axes, study: Study, names: Sequence[str]) -> None:
    def at(place: PartPlace, score: float) -> tuple[float, float]:
        x = getattr(place, names[0]) * units(names[0])[1]
        return x, getattr(place, names[1]) * units(names[1])[1] if len(names) > 1 else score

    for i, (place, rating) in enumerate(study.best):
        x, y = at(place, rating.score)
        label = "best places" if i == 0 else None
        panel.plot(x, y, "*", color=BEST, markeredgecolor="black", markersize=14, label=label)
        panel.annotate(f"{i + 1}", (x, y), xytext=(7, 7), textcoords="offset points", color="black", fontsize=9,
                       bbox={"boxstyle": "round,pad=0.15", "facecolor": "white", "linewidth": 0.0, "alpha": 0.8})  # fmt: skip
    x, y = at(study.now, study.now_rating.score)
    panel.plot(x, y, "X", color=PRESENT, markeredgecolor="white", markersize=11, label="as it stands")


# ----------------------------------------------------------------------------------------------------
# Where to place the part: a map of how well it can be printed at each place, and the best places, verified.
#
# python -m planner.place hemisphere_honeycomb.yaml

MOST_SOLVED = 10
TABLE, PICTURE = "placement.csv", "placement.png"
METRICS = (  # of a verified plan, with their headings, factors and decimals
    ("sigma_min", "sigma", 1.0, 3),
    (LAID_LIMITS, "limits deg", 1.0, 1),
    ("wrist_margin_deg", "wrist deg", 1.0, 1),
    ("at_speed_fraction", "at speed %", 100.0, 1),
    ("deposition_time_s", "deposition s", 1.0, 1),
)


def outcomes(found: Study, crew: Crew, tick: Callable[[], None]) -> list[PlaceOutcome]:
    """Solve and verify the problem at its present place, then at the best places of a study."""
    rated = [(found.now, found.now_rating), *found.best]
    solved: list[PlaceOutcome] = crew("solve", [(place, rating.score) for place, rating in rated], tick)
    return solved


def best_of(solved: Sequence[PlaceOutcome]) -> PlaceOutcome | None:
    """The best verified place, if it is better than the first, the present one."""
    best = max(solved, key=lambda outcome: outcome.score)
    return best if best.score > solved[0].score else None


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit code."""
    options = place_command().parse_args(arguments)
    errors = Console(stderr=True, highlight=False)
    return exit_code(lambda: _run(options, errors), partial(errors.print, markup=False, soft_wrap=True), at_once=True)


def _run(options: argparse.Namespace, errors: Console) -> int:
    with Stages(None if options.quiet else errors) as stages:
        with stages.stage("load"):
            problem = load_problem(options.problem, options.set)
            cell = build_cell(problem)
        folder = options.out or Path("out") / f"{problem.name}_placement"
        target = folder / f"{problem.file.stem}_placed.yaml"
        if target.exists():  # before anything is computed
            raise OutputError(f"{target} is there already, and stays as it is: remove it, or choose another --out")
        asked = StudyRequest(
            found_anywhere(problem), tuple(options.set), options.strategy, options.free, tuple(options.range)
        )
        axes = axes_of(problem, cell, place_of(problem), options.free, options.range)
        beside = options.jobs > 1 or options.scheduler is not None
        # a folder that cannot be written and a scheduler that does not answer are reported at once
        with results_folder(folder, "place") as fresh, spread_crew(options.jobs, options.scheduler) as over:
            with stages.stage("toolpath"):
                site = site_of(asked, problem, cell, axes)
            crew = crew_of(asked, site, over, beside)
            found = study(site, crew, max(options.best, 1), stages.counted)
            write_table(found, fresh / TABLE)
            draw_map(found, f"{problem.name}: where it can be printed, and how well", fresh / PICTURE)
            solved: list[PlaceOutcome] = []
            if options.best:
                with stages.counted("solve", 1 + len(found.best)) as tick:
                    solved = outcomes(found, crew, tick)
                check_unchanged(problem, problem.changed(()))
    no_more_interruptions()  # which would say that nothing was written
    names = [axis.name for axis in found.axes]
    out = Console(highlight=False, width=None if sys.stdout.isatty() else 160)
    out.print(table_of(problem, found, solved, names))
    print_words(out, options, found, solved)
    best = best_of(solved) if solved else None
    if best is not None:
        write_changed(problem, changed_fields(problem, best.place), target)
        out.print(f"best verified: {words(best.place, names)}; written as {target}", markup=False, soft_wrap=True)
    out.print(f"map: {folder / PICTURE}, {folder / TABLE}", markup=False, soft_wrap=True)
    return EXIT_VERIFIED


def print_words(out: Console, options: argparse.Namespace, found: Study, solved: Sequence[PlaceOutcome]) -> None:
    """Print what the table lacks: failures, and settings that are not in the written file."""
    for i, outcome in enumerate(solved):
        if outcome.failure is not None:
            out.print(f"{'as it stands' if i == 0 else i}: {outcome.failure}", markup=False, soft_wrap=True)
    if solved and best_of(solved) is None:
        text = (
            "it is well placed: none of the places tried is both verified and better"
            if solved[0].score
            else "nothing written"
        )
        out.print(text, markup=False)
    if options.set and solved and best_of(solved) is not None:
        out.print("changes made with --set were used here, but are not written into the file", markup=False)


def table_of(problem: Problem, found: Study, solved: Sequence[PlaceOutcome], names: Sequence[str]) -> Table:
    """The present place and the best ones: predicted and verified scores, and the metrics of each plan."""
    table = Table(title=f"{problem.name}: where the part stands", title_justify="left")
    table.add_column("")
    table.add_column(", ".join(names))
    for heading in ("possible", "score", *(heading for _, heading, _, _ in METRICS)):
        table.add_column(heading, justify="right")
    rows = [(found.now, found.now_rating.score), *((place, rating.score) for place, rating in found.best)]
    for i, (place, predicted) in enumerate(rows):
        cells = [
            "as it stands" if i == 0 else f"{i}",
            ", ".join(number(place, name) for name in names),
            f"{predicted:.2f}",
        ]
        if solved:
            outcome = solved[i]
            good = outcome.failure is None
            cells.append(f"{outcome.score:.2f}" if good else "none")
            cells += [
                f"{outcome.metrics[key] * factor:.{digits}f}" if key in outcome.metrics else ""
                for key, _, factor, digits in METRICS
            ]
        table.add_row(*cells)
    return table


def place_command() -> Command:
    """The parser of `python -m planner.place`."""
    parser = Command(
        "place",
        "Search for the place from which the part is printed best; solve and verify the best few.",
        {
            "hemisphere_honeycomb": "search x, y, z and turn of its bed; results in out/<problem>_placement",
            "my_part.yaml --best 0": "only the map: nothing is solved",
            "my_part.yaml --free x,y --range x=300:700": "only along the floor, x between 300 and 700 mm",
            "my_part.yaml --jobs 4": "in four processes; the same result, sooner",
        },
        {
            0: "done; the best place, if it is better than the present one, is written as a problem file",
            2: "wrong input; nothing written",
            3: "no place reaches the whole part",
            130: "interrupted; nothing written",
        },
    )
    add_problem(parser)
    parser.add_argument(
        "--out", type=Path, metavar="DIR", help="where the results go (default out/<problem>_placement)"
    )
    parser.add_argument(
        "--best",
        type=_count,
        default=3,
        metavar="N",
        help="places that are solved and verified (default 3; 0: only the map)",
    )
    parser.add_argument(
        "--free",
        metavar="NAMES",
        help=f"what may change, of {','.join(FREEDOMS)}: x, y, z and turn of bed or table, part_x and part_y on a table "
        "(default x,y,z,turn on a bed, x,y,z of a table)",
    )
    parser.add_argument(
        "--range",
        action="append",
        default=[],
        metavar="NAME=LOW:HIGH",
        help="range to search, in mm or deg, e.g. x=300:700; repeatable (default: half the arm's reach to each side)",
    )
    add_strategy(parser)
    add_set(parser)
    add_spread(parser)
    parser.add_argument("--quiet", action="store_true", help="no progress bars")
    return parser


def _count(text: str) -> int:
    if not text.isdecimal() or int(text) > MOST_SOLVED:
        raise argparse.ArgumentTypeError(f"{text!r} is not a number from 0 to {MOST_SOLVED}")
    return int(text)
