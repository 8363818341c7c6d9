"""A headless Chromium for benchmarks and screenshots: the installed one, rendering on the CPU alone."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from playwright.sync_api import Browser, Page, sync_playwright

from planner.base.errors import InputError

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
FLAGS = (
    "--no-sandbox --disable-gpu --disable-quic --no-first-run --disable-background-networking "
    "--disable-component-update --disable-sync --use-gl=angle --use-angle=swiftshader --enable-unsafe-swiftshader"
)
PATIENCE = 120_000  # ms


@contextmanager
def chromium() -> Iterator[Browser]:
    """The browser; it ends with the block. InputError where there is none."""
    if CHROMIUM is None:
        raise InputError("there is no Chromium on this computer", hint="Debian: apt-get install chromium")
    with sync_playwright() as play:
        browser = play.chromium.launch(executable_path=CHROMIUM, args=FLAGS.split())
        try:
            yield browser
        finally:
            browser.close()


@contextmanager
def page_of(browser: Browser, path: Path, size: tuple[int, int]) -> Iterator[Page]:
    """A page of a file (width, height in px), once all on it is drawn, its camera not flying but jumping."""
    context = browser.new_context(viewport={"width": size[0], "height": size[1]}, reduced_motion="reduce")
    try:
        page = context.new_page()
        page.goto(path.resolve().as_uri())
        page.wait_for_selector("html[data-ready=yes]", state="attached", timeout=PATIENCE)
        yield page
    finally:
        context.close()
