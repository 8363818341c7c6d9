"""Pictures of the report for the documentation, taken in a browser: docs/pictures/report_*.png and view.png.

python -m benchmarks.screenshots report_failed report_phone
"""

from __future__ import annotations

import argparse
import io
import sys
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from PIL import Image
from playwright.sync_api import Browser, Page
from rich.console import Console

from benchmarks.browser import chromium, page_of
from benchmarks.command import told
from planner.base.errors import EXIT_VERIFIED, Refusal
from planner.planning.pipeline import load, solve
from planner.planning.solve_command import report_refusal
from planner.report.html import write_report

PICTURES = Path(__file__).resolve().parent.parent / "docs" / "pictures"
DESK, PHONE = (1366, 768), (390, 844)
LOGO, CAP, HONEYCOMB = "cylinder_logo", "peer_cap", "hemisphere_honeycomb"
OUT_OF_REACH = (CAP, "cell.bed_mm=[820,-50,380]")
MOST = 250_000  # bytes; a larger picture gets a palette


@dataclass(frozen=True)
class Shot:
    """A picture: the report that it shows, the window, what is done first, and the part of the page (all, if none)."""

    report: Callable[[Path], Path]
    size: tuple[int, int]
    first: Callable[[Page], None] = lambda page: None
    part: str = ""


@told
def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit code."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"of {', '.join(SHOTS)}; all, if none is given")
    options = parser.parse_args(arguments)
    unknown = set(options.names) - set(SHOTS)
    if unknown:
        parser.error(f"no picture {sorted(unknown)[0]!r}; there are {', '.join(SHOTS)}")
    out = Console()
    with tempfile.TemporaryDirectory() as folder, chromium() as browser:
        for name in options.names or SHOTS:
            path = take(browser, SHOTS[name], Path(folder), PICTURES / f"{name}.png")
            out.print(f"{path.name}: {path.stat().st_size / 1e3:.0f} kB")
    return EXIT_VERIFIED


def take(browser: Browser, shot: Shot, folder: Path, picture: Path) -> Path:
    """Take a picture and write it small; returns where. A palette spoils the scales of colours: only if it has to be."""
    with page_of(browser, shot.report(folder), shot.size) as page:
        shot.first(page)
        page.wait_for_timeout(500)
        raw = page.locator(shot.part).screenshot() if shot.part else page.screenshot()
    image = Image.open(io.BytesIO(raw)).convert("RGB")
    image.save(picture, optimize=True)
    if picture.stat().st_size > MOST:
        image.quantize(dither=Image.Dither.FLOYDSTEINBERG).save(picture, optimize=True)
    return picture


@cache
def planned(folder: Path) -> Path:
    """The report of the logo of ten layers."""
    path = folder / "planned.html"
    write_report(solve(load(LOGO)), path)
    return path


@cache
def cap(folder: Path) -> Path:
    """The report of one spiral on a cap, whose map of roll is easily read."""
    path = folder / "cap.html"
    write_report(solve(load(CAP)), path)
    return path


@cache
def stacked(folder: Path) -> Path:
    """The report of three curved layers, each laid back from where the one before ended."""
    path = folder / "stacked.html"
    write_report(solve(load(HONEYCOMB)), path)
    return path


@cache
def refused(folder: Path) -> Path:
    """The report of a print that stands out of reach."""
    path = folder / "refused.html"
    problem = load(*OUT_OF_REACH)
    try:
        solve(problem)
    except Refusal as refusal:
        report_refusal(problem, problem.strategy, refusal, path)
    return path


def worst_place(page: Page) -> None:
    """Ride with the part, and look at the slowest place."""
    page.select_option("#ride", "part")
    page.locator(".judged [data-place]").first.click()


def by_age(page: Page) -> None:
    """The whole print, coloured by the age of what each place was laid on."""
    page.select_option("#colour", "interlayer_time_s")
    page.locator("#time").evaluate("time => { time.value = time.max; time.dispatchEvent(new Event('input')); }")
    page.get_by_role("button", name="Print", exact=True).click()


SHOTS = {
    "report_first_screen": Shot(planned, DESK),
    "report_worst_place": Shot(planned, DESK, worst_place),
    "report_failed": Shot(refused, DESK),
    "report_phone": Shot(planned, PHONE, lambda page: page.evaluate("() => scrollTo(0, 330)")),
    "report_interlayer": Shot(stacked, (1366, 620), by_age),
    "report_roll_map": Shot(cap, DESK, part="#roll-map"),
}

if __name__ == "__main__":
    sys.exit(main())
