"""The scene of a plan in a notebook: a page of its own in a frame, that plays and asks for no network."""

from __future__ import annotations

from html import unescape
from pathlib import Path
from typing import Any

import pytest
from browser_pages import DESK, NEEDS_CHROMIUM, PATIENCE
from report_fixtures import make_plan
from solved import small_plan

from benchmarks.browser import chromium
from planner import show
from planner.base.errors import InputError, OutputError


def test_a_cell_of_a_notebook_gets_the_page_in_a_frame(tmp_path: Path) -> None:
    scene = small_plan().show(height=500)
    html = scene._repr_html_()
    assert html.startswith("<iframe") and "height:500px" in html and 'sandbox="allow-scripts"' in html
    page = unescape(html.partition('srcdoc="')[2].rpartition('"')[0])
    assert page == scene.html and "small by ladder: verified" in page
    assert repr(scene) == f"<InlineScene of {scene.told}>" and len(html) < 8e6
    assert scene.save(tmp_path / "scene.html").read_text(encoding="utf-8") == scene.html
    with pytest.raises(OutputError):
        scene.save(tmp_path / "nowhere" / "scene.html")


@pytest.mark.parametrize("height", [0, 1e3, "high", True, 10_000])
def test_a_height_that_is_none_is_said(height: Any) -> None:
    with pytest.raises(InputError, match=r"height: .* is not a valid height"):
        show(small_plan(), height)


@pytest.mark.slow
@NEEDS_CHROMIUM
def test_it_plays_in_its_frame(tmp_path: Path) -> None:
    path = tmp_path / "notebook.html"
    path.write_text(f"<!doctype html><body>{make_plan(2_000).show()._repr_html_()}</body>", encoding="utf-8")
    with chromium() as browser:
        context = browser.new_context(viewport={"width": DESK[0], "height": DESK[1]}, reduced_motion="reduce")
        page, asked, wrong = context.new_page(), [], []
        page.on("request", lambda request: asked.append(request.url))
        page.on("pageerror", lambda error: wrong.append(str(error)))
        page.goto(path.as_uri())
        frame = page.frame_locator("iframe")
        frame.locator("html[data-ready=yes]").wait_for(state="attached", timeout=PATIENCE)
        before = frame.locator("#clock").inner_text()
        frame.locator("#time").fill("5")
        assert frame.locator("#clock").inner_text() != before
        assert frame.locator("#no-scene").is_hidden() and frame.locator("#view canvas").count() >= 1
        context.close()
    assert not wrong and not [url for url in asked if url.startswith("http")]
