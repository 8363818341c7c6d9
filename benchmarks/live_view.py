"""How long the live view takes from a save to the picture: of a draft, if there is one, and of the whole print.

python -m benchmarks.live_view hemisphere_honeycomb

The problem's speed is edited in a copy of its files several times, each time some seconds after the last report was drawn,
as a user would. The command prints the median and the longest time until the new report's scene is drawn in a headless
browser, which renders on the CPU alone, on the same cores that solve.
"""

from __future__ import annotations

import argparse
import re
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from playwright.sync_api import Page

from benchmarks.browser import chromium
from planner.base.shipped import PROBLEMS
from planner.planning.options import add_set

SPEEDS = (40.0, 39.0, 38.0, 37.0, 36.0)  # mm/s, one after the other
SIZE = {"width": 1366, "height": 900}
PATIENCE = 600.0  # s for one solve
LOOK = 0.1  # s between looks, which take time from the solver
PAUSE = 10.0  # s before each save: so long the browser is at work after it has shown the whole print
SHOWN = """() => {
  const frame = document.querySelector("iframe:not(.coming)");
  const draft = document.querySelector(".draft");
  const idle = [...document.querySelectorAll(".progress")].every((each) => each.hidden);
  return [frame ? frame.src : "", !draft || draft.hidden, idle && !document.querySelector("iframe.coming")];
}"""


def save_to_picture(problem: str, overrides: Sequence[str]) -> list[tuple[float, float]]:
    """Seconds from each save to the first picture of what was saved, and to that of the whole print."""
    with tempfile.TemporaryDirectory() as folder:
        for path in PROBLEMS.iterdir():
            if path.is_file():
                shutil.copy(path, folder)
        file = Path(folder) / f"{problem}.yaml"
        words = [each for override in overrides for each in ("--set", override)]
        command = [sys.executable, "-m", "planner.view", str(file), "--no-browser", *words]
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as view, chromium() as browser:
            try:
                if view.stdout is None:
                    raise RuntimeError("the view has no output")
                page = browser.new_page(viewport=SIZE, reduced_motion="reduce")
                page.goto(view.stdout.readline().split()[-1])
                page.wait_for_url(lambda there: "/enter/" not in there)
                _drawn(page, "", whole=True)
                return [_times(page, file, before, speed) for before, speed in zip(SPEEDS, SPEEDS[1:], strict=False)]
            finally:
                view.terminate()


def _times(page: Page, file: Path, before: float, speed: float) -> tuple[float, float]:
    """Save another speed, and wait for its pictures."""
    shown = str(page.evaluate(SHOWN)[0])
    text = file.read_text(encoding="utf-8")
    changed = re.sub(rf"(?m)^  speed_mm_s: {before:g}\b", f"  speed_mm_s: {speed:g}", text)
    if changed == text:
        raise ValueError(f"{file.name} has no line speed_mm_s: {before:g}")
    time.sleep(PAUSE)
    file.write_text(changed, encoding="utf-8")
    saved = time.monotonic()
    first = _drawn(page, shown, whole=False) - saved
    return first, _drawn(page, shown, whole=True) - saved


def _drawn(page: Page, before: str, whole: bool) -> float:
    """When another report than one stands there, drawn: any, or that of the whole print."""
    end = time.monotonic() + PATIENCE
    while time.monotonic() < end:
        source, is_whole, idle = page.evaluate(SHOWN)
        if source and source != before and (not whole or (is_whole and idle)):
            return time.monotonic()
        time.sleep(LOOK)
    raise TimeoutError("the view does not come to rest")


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit code."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.live_view", description=__doc__.split("\n", 1)[0])
    parser.add_argument("problem", help="an example whose speed is 40 mm/s")
    add_set(parser)
    options = parser.parse_args(arguments)
    times = np.array(save_to_picture(options.problem, options.set))
    for name, own in zip(("first picture", "whole print"), times.T, strict=True):
        print(f"{name}: {np.median(own):.1f} s, at most {own.max():.1f} s, of {len(own)} saves")
    return 0


if __name__ == "__main__":
    sys.exit(main())
