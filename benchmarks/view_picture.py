"""The live view as the docs show it: two strategies side by side after an edit, as a headless browser sees it.

python -m benchmarks.view_picture docs/pictures/view.png
"""

from __future__ import annotations

import argparse
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

from PIL import Image
from playwright.sync_api import Page, sync_playwright

from planner.base.shipped import PROBLEMS

PROBLEM, FILES = "cylinder_logo", ("cylinder_logo.yaml", "logo.svg")
OPTIONS = ("--no-browser", "--set", "layers.count=1", "--strategy", "ladder", "--beside", "as_published")
EDIT = ("speed_mm_s: 40", "speed_mm_s: 30")
SIZE = {"width": 1366, "height": 1120}
PATIENCE = 300.0  # s for all solves
FLAGS = ("--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader")
IDLE = """() => document.querySelectorAll('iframe').length === 2 && !document.querySelector('iframe.coming')
  && [...document.querySelectorAll('.progress')].every((each) => each.hidden)"""
COLOURS = 256
SETTLED_TIME = 2.0  # s for the scenes to be painted


def view_picture(path: Path) -> None:
    """Write the picture, a PNG file with a palette."""
    with tempfile.TemporaryDirectory() as folder:
        for name in FILES:
            shutil.copy(PROBLEMS / name, folder)
        problem = Path(folder) / f"{PROBLEM}.yaml"
        command = [sys.executable, "-m", "planner.view", str(problem), *OPTIONS]
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as view:
            try:
                if view.stdout is None:
                    raise RuntimeError("the view has no output")
                _picture(view.stdout.readline().split()[-1], problem, path)
            finally:
                view.terminate()


def _picture(url: str, problem: Path, path: Path) -> None:
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=shutil.which("chromium"), args=list(FLAGS))
        page = browser.new_page(viewport=SIZE)
        page.goto(url)
        page.wait_for_url(lambda there: "/enter/" not in there)
        _until_idle(page)
        problem.write_text(problem.read_text(encoding="utf-8").replace(*EDIT), encoding="utf-8")
        time.sleep(1.0)
        _until_idle(page)
        page.click("summary")
        time.sleep(SETTLED_TIME)
        page.screenshot(path=path)
        Image.open(path).convert("RGB").quantize(COLOURS).save(path, optimize=True)
        browser.close()


def _until_idle(page: Page) -> None:
    end = time.monotonic() + PATIENCE
    while not page.evaluate(IDLE):
        if time.monotonic() > end:
            raise TimeoutError("the view does not come to rest")
        time.sleep(0.1)


def main(arguments: Sequence[str] | None = None) -> int:
    """Draw the picture into the file that is named."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.view_picture", description=__doc__)
    parser.add_argument("picture", type=Path)
    view_picture(parser.parse_args(arguments).picture)
    return 0


if __name__ == "__main__":
    sys.exit(main())
