"""Picture of a run's page for the documentation, taken in a browser: docs/pictures/link_page.png.

python -m benchmarks.link_page out/fibre_bowl/FibreBowl.mod

The program runs on the simulators, ten times as fast as the print. In the middle of a bead a jam is reported, and the
extruder is primed; then the picture is taken, and the run is stopped.
"""

from __future__ import annotations

import argparse
import re
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

from benchmarks.browser import chromium
from planner.base.errors import EXIT_VERIFIED, InputError

PICTURE = Path(__file__).resolve().parent.parent / "docs" / "pictures" / "link_page.png"
SIZE = (1300, 840)
PACE = "10"
SHARE = 0.3  # of the print, after which the jam is told
PATIENCE = 120_000  # ms


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit code."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.link_page")
    parser.add_argument("program", type=Path, metavar="PROGRAM.mod", help="of style socket")
    options = parser.parse_args(arguments)
    with tempfile.TemporaryDirectory() as folder:
        words = ["--demo", str(options.program), "--pace", PACE, "--page", "--no-browser", "--quiet"]
        words += ["--log", str(Path(folder) / "log.jsonl")]
        command = [sys.executable, "-m", "planner.link", *words]
        with subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, text=True) as link:
            found = re.search(r"http://\S+", link.stdout.readline() if link.stdout is not None else "")
            if found is None:
                raise InputError("the link shows no page", file=options.program)
            _take(found[0])
    return EXIT_VERIFIED


def _take(address: str) -> None:
    with chromium() as browser:
        page = browser.new_page(viewport={"width": SIZE[0], "height": SIZE[1]})
        page.on("dialog", lambda dialog: dialog.accept())
        page.goto(address)
        bar = page.locator("#print progress")
        while float(bar.evaluate("bar => bar.value")) < SHARE:
            page.wait_for_timeout(100)
        page.click("#jam")
        page.locator("#reprime:not([disabled])").click(timeout=PATIENCE)
        page.locator("#log td", has_text="reprimed").wait_for(timeout=PATIENCE)
        page.mouse.move(0, 0)
        page.wait_for_timeout(500)
        page.screenshot(path=str(PICTURE))
        page.click("#stop")
        page.locator("#word", has_text="Stopped").wait_for(timeout=PATIENCE)


if __name__ == "__main__":
    sys.exit(main())
