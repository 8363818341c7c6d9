"""The size of report.html, the time to its first picture, and the time per frame.

python -m benchmarks.report_page cylinder_logo --times 1 6
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

from rich.console import Console
from rich.table import Table

from benchmarks.browser import chromium, page_of
from benchmarks.command import told
from benchmarks.repeated import repeated
from planner.base.errors import EXIT_VERIFIED
from planner.planning.pipeline import load, solve
from planner.report.html import write_report

SIZE = (1366, 768)
OPENED = 3  # times each page is opened: the best of them counts
FRAMES = 40
# One step of the player without drawing it, and with: what the page does, and what the computer's renderer adds.
STEP = """(frames) => {
  const { player, stage } = report.scene, end = report.page.scene.end, draw = stage.draw;
  document.getElementById("grow").checked = true;
  stage.draw = () => {};
  const begin = performance.now();
  for (let k = 0; k < frames; k++) player.seek(end * (k + 0.5) / frames);
  stage.draw = draw;
  return (performance.now() - begin) / frames;
}"""
DRAW = """async (frames) => {
  const { player, stage } = report.scene, end = report.page.scene.end, gl = stage.world.renderer.getContext();
  const begin = performance.now();
  for (let k = 0; k < frames; k++) {
    player.seek(end * (k + 0.5) / frames);
    await stage.world.render(true);
    gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, new Uint8Array(4));  // waits until it is drawn
  }
  return (performance.now() - begin) / frames;
}"""


@told
def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit code."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("problem", help="problem file, or the name of a shipped one")
    parser.add_argument("--times", type=int, nargs="+", default=[1, 6], metavar="K", help="the motion K times in a row")
    options = parser.parse_args(arguments)
    out = Console()
    table = Table("waypoints", "layers", "samples", "written s", "MB", "picture s", "drawn s",
                  "step ms", "frame ms", title=f"report.html of {options.problem}")  # fmt: skip
    plan = solve(load(options.problem))
    with tempfile.TemporaryDirectory() as folder, chromium() as browser:
        for times in options.times:
            longer, path = repeated(plan, times), Path(folder) / f"{times}.html"
            begin = time.perf_counter()
            write_report(longer, path)
            written = time.perf_counter() - begin
            first, drawn, step, frame = [], [], [], []
            for _ in range(OPENED):
                with page_of(browser, path, SIZE) as page:
                    first.append(page.evaluate("() => performance.getEntriesByName('first picture')[0].startTime"))
                    drawn.append(page.evaluate("() => performance.getEntriesByName('all drawn')[0].startTime"))
                    step.append(page.evaluate(STEP, FRAMES))
                    frame.append(page.evaluate(DRAW, FRAMES))
            table.add_row(
                f"{times * plan.metrics['waypoints']:,.0f}",
                f"{times * plan.layers}",
                f"{len(longer.trajectory):,}",
                f"{written:.1f}",
                f"{path.stat().st_size / 1e6:.2f}",
                f"{min(first) / 1e3:.2f}",
                f"{min(drawn) / 1e3:.2f}",
                f"{min(step):.2f}",
                f"{min(frame):.1f}",
            )
    out.print(table)
    return EXIT_VERIFIED


if __name__ == "__main__":
    sys.exit(main())
