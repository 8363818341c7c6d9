"""The live view's page in a browser: reports that give way to newer ones, and what is kept and shared between them."""

from __future__ import annotations

import json
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from solved import write_small

sync_api = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="there is no Chromium on this computer")

# A report that does what the page relies on: says when it is drawn, tells what its user does, takes what it is told.
REPORT = """\
<!doctype html><title>a report</title><p id=name>NAME</p><p id=told>nothing</p>
<button onclick="parent.postMessage({beadwise: 'state', t: 1.5, camera: [1, 2, 3], by: 'NAME'}, '*')">turn</button>
<script>
addEventListener("message", (event) => {
  if (event.source === parent) document.getElementById("told").textContent = JSON.stringify(event.data);
});
parent.postMessage({beadwise: "ready", state: {beadwise: "state", by: "NAME at first"}}, "*");
let reach = "reached";
try { void parent.document.title; } catch (error) { reach = "kept out"; }
document.title = reach;
</script>
"""
SOLVER = """\
import json, pathlib, sys
for line in sys.stdin:
    job = json.loads(line)
    folder = pathlib.Path(job["folder"]) / "whole"
    folder.mkdir(parents=True)
    text = pathlib.Path(__file__).with_name("report.html").read_text()
    (folder / "report.html").write_text(text.replace("NAME", job["strategy"] + " " + folder.parent.name))
    told = {"job": job["number"], "kind": "verified", "words": "verified: 1 check holds", "draft": ""}
    figures = [["at_speed_fraction", 0.9 if job["strategy"] == "sqp" else 0.4], ["print_time_s", 9.0]]
    print(json.dumps({**told, "figures": figures}), flush=True)
"""
VIEW = """\
import sys
from planner.view import command, solver
solver.CHILD = (sys.executable, "-S", sys.argv.pop(1))
sys.exit(command.main())
"""
PATIENCE = 30.0  # s


def until(page: Any, done: Callable[[], Any]) -> Any:
    """Wait until something is so; the view's policy lets no test wait inside its page."""
    end = time.monotonic() + PATIENCE
    while True:
        try:
            if found := done():
                return found
        except sync_api.Error as error:  # a report gave way to the next one meanwhile
            assert "detached" in str(error)
        assert time.monotonic() < end, "the page did not come so far"
        page.wait_for_timeout(30)


class Opened:
    """The page of a view, its problem file, and what went wrong in the browser."""

    def __init__(self, page: Any, problem: Path) -> None:
        self.page, self.problem = page, problem
        self.wrong: list[str] = []
        page.on("pageerror", lambda error: self.wrong.append(str(error)))
        page.on("console", lambda said: self.wrong.append(said.text) if said.type == "error" else None)

    def until(self, done: Callable[[], Any]) -> Any:
        """Wait until something is so."""
        return until(self.page, done)

    def reports(self) -> list[Any]:
        """The frames of the reports that are shown, left to right; none while one is on its way."""
        frames = self.page.query_selector_all("iframe")
        coming = any(frame.get_attribute("class") == "coming" for frame in frames)
        shown = [] if coming else [frame.content_frame() for frame in frames]
        return shown if all(frame is not None and frame.query_selector("#told") for frame in shown) else []

    def names(self) -> list[str]:
        """What the reports that are shown are of."""
        return [report.inner_text("#name") for report in self.reports()]

    def text(self, selector: str) -> str:
        """The text of a part of the page."""
        return str(self.page.inner_text(selector))


@pytest.fixture
def opened(tmp_path: Path) -> Iterator[Opened]:
    """A view of the small problem, with a solver that hands out the report above."""
    problem = write_small(tmp_path / "problem")
    (tmp_path / "report.html").write_text(REPORT)
    (tmp_path / "solver.py").write_text(SOLVER)
    command = [
        sys.executable,
        "-c",
        VIEW,
        str(tmp_path / "solver.py"),
        str(problem),
        "--no-browser",
        "--strategy",
        "sqp",
    ]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as view, sync_api.sync_playwright() as playwright:
        try:
            assert view.stdout is not None
            url = view.stdout.readline().split()[-1]
            browser = playwright.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
            page = browser.new_page(viewport={"width": 1366, "height": 768})
            found = Opened(page, problem)
            page.goto(url)
            page.wait_for_url(lambda there: "/enter/" not in there)
            yield found
            assert found.wrong == []
            browser.close()
        finally:
            view.send_signal(signal.SIGINT)


@pytest.mark.slow
def test_the_address_is_exchanged_for_a_cookie(opened: Opened) -> None:
    """The page's own address lets nobody else in, scripts do not see the cookie, and Back does not lead to the word."""
    page = opened.page
    opened.until(lambda: opened.names() == ["sqp 1"])
    (cookie,) = page.context.cookies()
    assert (cookie["httpOnly"], cookie["sameSite"]) == (True, "Strict")
    assert page.url.endswith(cookie["path"]) and cookie["value"] not in page.url
    assert page.evaluate("document.cookie") == "" and "/enter/" not in page.evaluate("document.referrer")
    other = page.context.browser.new_context().new_page()
    answer = other.goto(page.url)
    assert answer.status == 403 and "is shown in the terminal" in other.inner_text("body")
    page.go_back()
    assert "/enter/" not in page.url


@pytest.mark.slow
def test_page_from_an_edit_to_two_strategies(opened: Opened) -> None:
    page, problem = opened.page, opened.problem
    opened.until(lambda: opened.names() == ["sqp 1"])
    assert opened.reports()[0].title() == "kept out", "a report must not reach into the page"
    assert opened.reports()[0].inner_text("#told") == "nothing"
    # a report begins as the first one did, or as the user last had it
    problem.write_text(problem.read_text().replace("speed_mm_s: 40", "speed_mm_s: 45"))
    opened.until(lambda: opened.names() == ["sqp 2"] and "sqp 1 at first" in opened.reports()[0].inner_text("#told"))
    opened.reports()[0].click("button")
    problem.write_text(problem.read_text().replace("speed_mm_s: 45", "speed_mm_s: 50"))
    opened.until(lambda: opened.names() == ["sqp 3"] and "camera" in opened.reports()[0].inner_text("#told"))
    kept = json.loads(opened.reports()[0].inner_text("#told"))
    assert (kept["camera"], kept["t"], kept["by"]) == ([1, 2, 3], 1.5, "sqp 2")
    # a mistake leaves the report, and says where
    problem.write_text(problem.read_text().replace("speed_mm_s: 50", "speed_mm_s: fast"))
    opened.until(lambda: "process.speed_mm_s" in opened.text("#message"))
    assert "speed_mm_s: fast" in opened.text("#message pre") and "earlier save" in opened.text(".verdict")
    assert opened.names() == ["sqp 3"]
    problem.write_text(problem.read_text().replace("speed_mm_s: fast", "speed_mm_s: 50"))
    opened.until(lambda: not page.is_visible("#message"))
    # a second strategy beside it; what happens in one pane is told to the other, and not back
    page.check("#beside")
    opened.until(lambda: opened.names() == ["sqp 3", "as_published 4"])
    left, right = opened.reports()
    right.click("button")
    opened.until(lambda: "as_published" in left.inner_text("#told"))
    assert "as_published" not in right.inner_text("#told")
    page.click("summary")
    assert "✓ 90.00" in opened.text("#differences")
    assert "process.speed_mm_s: 45 → 50" in opened.text("#history")
    page.set_viewport_size({"width": 390, "height": 844})
    assert page.evaluate("document.documentElement.scrollWidth") == 390
    page.uncheck("#beside")
    opened.until(lambda: opened.names() == ["sqp 3"])
