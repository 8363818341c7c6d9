"""A headless Chromium for tests of pages: the computer's own, driven by playwright, which downloads none."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from playwright.sync_api import Browser, ConsoleMessage, Page

from benchmarks.browser import CHROMIUM, PATIENCE

NEEDS_CHROMIUM = pytest.mark.skipif(CHROMIUM is None, reason="needs Chromium (Debian: apt-get install chromium)")
DESK, PHONE = (1366, 768), (390, 844)


class Opened:
    """A page that is open, with what it complained of and asked for."""

    def __init__(self, page: Page) -> None:
        self.page = page
        self.complaints: list[str] = []
        self.requests: list[str] = []
        page.on("console", self._heard)
        page.on("pageerror", lambda error: self.complaints.append(str(error)))
        page.on("request", lambda request: self.requests.append(request.url))

    def _heard(self, message: ConsoleMessage) -> None:
        if message.type == "error":
            self.complaints.append(message.text)

    def settle(self) -> None:
        """Wait until what is due to be drawn is drawn."""
        self.page.evaluate(
            "() => new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(() => setTimeout(done, 60))))"
        )


@contextmanager
def opened(browser: Browser, path: Path, size: tuple[int, int] = DESK, before: str = "") -> Iterator[Opened]:
    """A page of a file, ready; `before` is a script that runs first. Nobody moves what asks for calm."""
    context = browser.new_context(viewport={"width": size[0], "height": size[1]}, reduced_motion="reduce")
    try:
        found = Opened(context.new_page())
        if before:
            found.page.add_init_script(before)
        found.page.goto(path.as_uri())
        found.page.wait_for_selector("html[data-ready=yes]", state="attached", timeout=PATIENCE)
        found.settle()
        yield found
    finally:
        context.close()
