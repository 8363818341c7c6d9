"""The report in a browser: the scene plays what the plan says, its places and filters work, on a desk and on a phone."""

from __future__ import annotations

import dataclasses
import io
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from browser_pages import NEEDS_CHROMIUM, PHONE, Opened, opened
from matplotlib.image import imread
from playwright.sync_api import Browser, expect
from report_fixtures import SHAPE, make_beads, make_plan, make_problem, with_dips
from solved import small_plan, small_problem

from benchmarks.browser import chromium
from planner.base.errors import Refusal
from planner.planning.pipeline import solve
from planner.planning.solve_command import report_refusal
from planner.report.failure import write_failure_report
from planner.report.html import write_report
from planner.report.judged import judged

pytestmark = NEEDS_CHROMIUM
DOUBLE_CLICK = 400  # ms: what plotly takes for one click if two come sooner (300), and some more
NO_WEBGL = "HTMLCanvasElement.prototype.getContext = ((old) => function (kind, ...more) {"
NO_WEBGL += " return kind.startsWith('webgl') ? null : old.call(this, kind, ...more); })(HTMLCanvasElement.prototype.getContext)"


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    with chromium() as found:
        yield found


@pytest.fixture(scope="module")
def stars(browser: Browser, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Opened]:
    """A synthetic plan without bodies: beads, dips, places and charts."""
    path = tmp_path_factory.mktemp("stars") / "report.html"
    with pytest.MonkeyPatch.context() as patch:  # without charts of the joints: they take most of a page's time
        patch.setattr("planner.report.html.joint_charts", lambda plan: [])
        write_report(with_dips(make_plan(8_000)), path)
    with opened(browser, path) as found:
        yield found


@pytest.fixture(scope="module")
def small(browser: Browser, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Opened]:
    """A solved plan with its whole cell."""
    path = tmp_path_factory.mktemp("small") / "report.html"
    write_report(small_plan(), path)
    with opened(browser, path) as found:
        yield found


@pytest.fixture
def few_charts(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without those of the joints: they take most of the time of a page."""
    monkeypatch.setattr("planner.report.html.joint_charts", lambda plan: [])


def seen(found: Opened) -> np.ndarray:
    """The scene as it is on the screen (height, width, 3), 0 to 1, without what lies over it."""
    found.settle()
    style = "#letters, .views, .legend, #card-box { visibility: hidden !important; }"
    return imread(io.BytesIO(found.page.locator("#view").screenshot(style=style)))[:, :, :3]


def put(found: Opened, name: str, value: float | str) -> None:
    """Set a slider or a choice as a reader does."""
    found.page.evaluate(
        "([id, value]) => { const e = document.getElementById(id); e.value = value;"
        " for (const type of ['input', 'change']) e.dispatchEvent(new Event(type)); }",
        [name, value],
    )
    found.settle()


def unfold(found: Opened) -> None:
    """Open all that is folded."""
    found.page.evaluate("() => document.querySelectorAll('details').forEach((each) => { each.open = true; })")
    found.settle()


def drawn(found: Opened) -> int:
    """How many corners of beads are drawn."""
    return found.page.evaluate(
        "() => { const g = report.scene.stage.beads.mesh.geometry; return Math.min(g.drawRange.count, g.index.count); }"
    )


@pytest.mark.slow
def test_a_report_complains_of_nothing_and_asks_the_network_for_nothing(stars: Opened, small: Opened) -> None:
    for found in (stars, small):
        assert found.complaints == []
        assert [url for url in found.requests if not url.startswith(("file:", "data:", "blob:"))] == []
        assert len([url for url in found.requests if url.startswith("file:")]) == 1
        assert found.page.locator(".js-plotly-plot").count() >= (6 if found is small else 5)


def test_the_first_screen_shows_verdict_figures_and_the_cell(small: Opened) -> None:
    page = small.page
    for what in (".verdict", ".deciding", "#view", "#play", ".deciding [data-place] >> nth=0"):
        box = page.locator(what).bounding_box()
        assert box is not None and 0 <= box["y"] < 768 - 40, f"{what} stands on the first screen"
    page.locator("[data-view=cell]").click()
    picture = seen(small)
    assert (picture.min(axis=2) < 0.9).mean() > 0.05, "robots, not paper"
    page.locator("#robots").uncheck()
    without = seen(small)
    page.locator("#robots").check()
    assert (without.min(axis=2) < 0.9).mean() < 0.5 * (picture.min(axis=2) < 0.9).mean()


@pytest.mark.slow
def test_the_print_is_large_and_the_arm_is_in_view_at_first(small: Opened, stars: Opened) -> None:
    """How much of the picture's height the beads take, and where the nozzle is, from -1 to 1."""
    share = (
        "() => { const { stage } = report.scene, seen = []; for (let i = 0; i < stage.beads.n; i++)"
        " seen.push(stage.inView(stage.beads.point(i)).project(stage.world.camera).y); return (Math.max(...seen) - Math.min(...seen)) / 2; }"
    )
    for found, least in (
        (small, 0.12),
        (stars, 0.25),
    ):  # the small print is 24 mm high: no nearer than 150 mm are shown
        found.page.locator("[data-view=print]").click()
        found.settle()
        assert least < found.page.evaluate(share) < 0.95
    head = small.page.evaluate(
        "() => { const { stage } = report.scene, { nozzle } = stage.now, at = new stage.THREE.Vector3(nozzle[3], nozzle[7], nozzle[11]);"
        " return at.project(stage.world.camera).toArray(); }"
    )
    assert np.abs(head[:2]).max() < 1.0
    small.page.locator("[data-view=cell]").click()
    small.settle()
    seen_all = small.page.evaluate(
        "() => { const { stage } = report.scene, box = new stage.THREE.Box3(), out = [];"
        " stage.bodies.filter((b) => b.kind === 'arm').forEach((b) => { const { min, max } = box.setFromObject(b.mesh);"
        "  const at = min.clone().add(max).multiplyScalar(0.5).project(stage.world.camera); out.push(Math.abs(at.x), Math.abs(at.y)); });"
        " return Math.max(...out); }"
    )
    assert seen_all < 1.0, "the middle of every link"


@pytest.mark.slow
def test_it_opens_playing_the_print_as_it_is_laid(browser: Browser, tmp_path: Path) -> None:
    write_report(make_plan(4_000), tmp_path / "r.html")
    context = browser.new_context(viewport={"width": 1366, "height": 768})
    page = context.new_page()
    page.goto((tmp_path / "r.html").as_uri())
    page.wait_for_selector("html[data-ready=yes]", state="attached")
    page.wait_for_function("() => report.scene.player.t > 0.2")
    assert page.evaluate("() => report.scene.player.playing") and page.locator("#grow").is_checked()
    assert page.evaluate("() => report.scene.stage.beads.ghost.visible"), "what is not laid yet is seen through"
    context.close()


@pytest.mark.slow
def test_what_is_not_chosen_is_a_ghost(stars: Opened) -> None:
    ghost = "() => report.scene.stage.beads.ghost.visible && report.scene.stage.beads.ghost.geometry.index.count"
    assert stars.page.evaluate(ghost) is False
    stars.page.locator("#only").check()
    stars.settle()
    points = stars.page.evaluate("() => report.scene.stage.beads.n")
    assert 0.9 * 6 * points < stars.page.evaluate(ghost) <= 6 * points
    stars.page.locator("#only").uncheck()
    stars.settle()
    assert stars.page.evaluate(ghost) is False


@pytest.mark.slow
def test_beads_are_as_wide_and_high_as_they_are(small: Opened) -> None:
    """Across the first point of a bead: 0.6 mm by 0.5 mm, below the tip."""
    corners = small.page.evaluate(
        "() => Array.from(report.scene.stage.beads.mesh.geometry.attributes.position.array.slice(0, 12))"
    )
    corners = np.reshape(corners, (4, 3))
    tip = small_plan().trajectory.tip[small_plan().trajectory.deposit][0]
    assert np.linalg.norm(corners[0] - corners[3]) == pytest.approx(0.6e-3, rel=0.02)
    assert np.linalg.norm(0.5 * (corners[1] + corners[2]) - tip) < 2e-5
    assert np.linalg.norm(0.5 * (corners[0] + corners[3] - corners[1] - corners[2])) == pytest.approx(0.5e-3, rel=0.05)
    numbers = small.page.evaluate(
        "() => report.scene.stage.bodies.flatMap((b) => ['position', 'normal'].map((k) =>"
        " b.mesh.geometry.attributes[k].array.every(Number.isFinite)))"
    )
    assert all(numbers) and len(numbers) > 20


def test_the_scenes_tip_is_where_the_trajectory_has_it(small: Opened) -> None:
    t = small_plan().trajectory
    rows = np.unique(np.linspace(0, len(t) - 1, 200).astype(int))
    tips = np.array(small.page.evaluate("(times) => times.map((t) => report.scene.motion.tip(t))", t.t[rows].tolist()))
    off = np.linalg.norm(tips - t.tip[rows], axis=1)
    assert off.max() < 0.51e-3, "of what the page says"
    at = small.page.evaluate(
        "(t) => { report.scene.seek(t); return report.scene.stage.now.nozzle; }", float(t.t[rows[50]])
    )
    cell = small_plan().cell
    expected = cell.arm.poses(t.q[rows[50]][None, : len(cell.arm)])[0]
    assert np.reshape(at, (4, 4)) == pytest.approx(expected, abs=3e-3)


@pytest.mark.slow
def test_playing_moves_the_robot_and_lays_the_beads(small: Opened) -> None:
    page = small.page
    small.page.evaluate("() => report.scene.seek(0)")
    whole, still = drawn(small), seen(small)
    put(small, "pace", "1")
    page.locator("#view").focus()
    page.keyboard.press("Space")
    page.wait_for_function("() => report.scene.player.t > 1.5", timeout=60_000, polling=20)
    page.keyboard.press("Space")
    t = page.evaluate("() => report.scene.player.t")
    assert 1.5 < t < small_plan().trajectory.t[-1], "a slow machine plays slower"
    assert not page.evaluate("() => report.scene.player.playing")
    assert np.abs(seen(small) - still).max() > 0.2
    assert 0 <= drawn(small) < whole and page.locator("#grow").is_checked()
    page.keyboard.press("ArrowLeft")
    assert page.evaluate("() => report.scene.player.t") == pytest.approx(t - 1, abs=1e-6)
    page.keyboard.press("End")
    small.settle()
    assert drawn(small) == whole and f"{small_plan().trajectory.t[-1]:.2f} s of" in page.locator("#clock").inner_text()
    page.locator("#grow").uncheck()


@pytest.mark.slow
def test_a_place_brings_time_camera_and_its_words(small: Opened) -> None:
    page, plan = small.page, small_plan()
    page.locator("[data-view=cell]").click()
    far = page.evaluate("() => report.scene.stage.world.camera.position.toArray()")
    button = page.locator(".judged [data-place]").first
    button.click()
    small.settle()
    place = page.evaluate("() => report.page.scene.places[0]")
    assert page.evaluate("() => report.scene.player.t") == pytest.approx(place["t"])
    near = page.evaluate("() => report.scene.stage.world.camera.position.toArray()")
    assert np.linalg.norm(np.subtract(near, far)) > 0.1
    card = page.locator("#card").inner_text()
    assert place["what"] in card and place["where"] in card and place["help"] in card
    assert button.get_attribute("aria-pressed") == "true"
    unfold(small)
    near = plan.approaches[0]
    show = page.locator("[data-place]", has_text=f"{near.a} – {near.b}").first
    if not show.count():  # the pair that a check tells stands in the row of that check
        show = page.locator(".judged tr", has_text=f"{near.a} and {near.b}").locator("[data-place]")
    show.click()
    small.settle()
    assert page.evaluate("() => report.scene.player.t") == pytest.approx(
        plan.trajectory.t[near.sample], abs=plan.trajectory.dt
    )
    painted = page.evaluate("() => report.scene.stage.bodies.map((b) => b.mesh.material.color.getHex())")
    drawn_for = page.evaluate("() => report.scene.stage.bodies.map((b) => b.bodies)")
    pair = [plan.approaches[0].a, plan.approaches[0].b]
    view = page.locator("#view").bounding_box()
    assert view is not None and 0 <= view["y"] < 768 / 2, "the scene is brought into sight"
    marked, others = (
        {colour for names, colour in zip(drawn_for, painted, strict=True) if bool({*names} & {*pair}) is wanted}
        for wanted in (True, False)
    )
    assert len(marked) == len(set(pair) & {name for names in drawn_for for name in names}) > 0
    assert not {0xD55E00, 0x0072B2} & others
    page.locator("#card-close").click()


@pytest.mark.slow
def test_riding_with_the_part_holds_it_still(browser: Browser, tmp_path: Path) -> None:
    """With the published way of moving, whose table does all the turning."""
    write_report(solve(small_plan().problem, "as_published", baseline=False), tmp_path / "report.html")
    pose = "() => { const s = report.scene; s.seek(%s); return s.stage.part.matrixWorld.elements.slice(); }"
    times = range(2, 20, 2)
    with opened(browser, tmp_path / "report.html") as found:
        moves = np.array([found.page.evaluate(pose % t) for t in times])
        put(found, "ride", "part")
        rides = np.array([found.page.evaluate(pose % t) for t in times])
    assert np.ptp(moves, axis=0).max() > 1e-3
    np.testing.assert_allclose(rides, np.tile(np.eye(4).ravel(), (len(rides), 1)), rtol=0, atol=1e-9)


@pytest.mark.slow
def test_layers_values_and_dips_filter(stars: Opened) -> None:
    page, whole = stars.page, drawn(stars)
    put(stars, "colour", "speed")
    put(stars, "layers", "3")
    four = drawn(stars)
    assert four == pytest.approx(0.4 * whole, rel=0.02) and page.locator("#layer-words").inner_text() == "up to 4"
    page.locator("#only").check()
    stars.settle()
    assert drawn(stars) == pytest.approx(0.1 * whole, rel=0.02)
    page.locator("#only").uncheck()
    put(stars, "layers", "9")
    put(stars, "to", "500")  # only the slower half of the scale
    assert 0 < drawn(stars) < 0.5 * whole and "mm/s" in page.locator("#range-words").inner_text()
    put(stars, "to", "1000")
    assert drawn(stars) == whole
    dips = "() => report.page.scene.dips && report.scene.dips.mesh.geometry.index.count"
    assert page.evaluate(dips) > 0
    page.locator("#dips").uncheck()
    stars.settle()
    assert page.evaluate(dips) == 0
    page.locator("#dips").check()


@pytest.mark.slow
def test_colours_follow_the_choice_and_say_their_ends(stars: Opened) -> None:
    page = stars.page
    page.locator("[data-view=print]").click()
    put(stars, "colour", "speed")
    before = seen(stars)
    put(stars, "colour", "sigma")
    classes = page.locator("#scale li").all_inner_texts()
    assert len(classes) == 6 and classes[0].startswith("0.130 – ") and classes[-1].endswith(" – 0.290")
    assert page.locator("#scale-words").inner_text() == "red: the tightest 5 % of what is laid"
    assert np.abs(seen(stars) - before).max() > 0.2
    put(stars, "colour", "layer")
    assert page.locator("#scale li").last.inner_text().endswith("10")
    put(stars, "colour", "speed")


def test_a_click_on_the_print_reads_it(stars: Opened) -> None:
    page = stars.page
    page.locator("#letters-shown").uncheck()
    page.locator("[data-view=print]").click()
    stars.settle()
    at = page.evaluate(
        "() => { const s = report.scene.stage, n = report.page.scene.lines.normal, box = s.canvas.getBoundingClientRect();"
        " for (let i = s.beads.n - 1; i > 0; i--) { const p = s.inView(s.beads.point(i));"
        "  const eye = s.world.camera.position.clone().sub(p).normalize();"
        "  if (eye.dot(s.along([n[3 * i], n[3 * i + 1], n[3 * i + 2]])) < 0.7) continue;"
        "  p.project(s.world.camera);"
        "  const at = [box.x + (0.5 + 0.5 * p.x) * box.width, box.y + (0.5 - 0.5 * p.y) * box.height];"
        "  if (document.elementFromPoint(...at) === s.canvas) return at; } }"
    )
    page.mouse.click(*at)
    stars.settle()
    words = page.locator("#card").inner_text()
    assert "Tip speed" in words or "Dip in speed" in words
    page.locator("#letters-shown").check()
    page.locator("#card-close").click()


def test_charts_and_scene_share_one_time(stars: Opened) -> None:
    page = stars.page
    page.evaluate("() => document.getElementById('chart-speed').emit('plotly_click', { points: [{ x: 5 }] })")
    stars.settle()
    assert page.evaluate("() => report.scene.player.t") == 5
    page.evaluate("() => Plotly.relayout('chart-speed', { 'xaxis.range[0]': 3, 'xaxis.range[1]': 9 })")
    stars.settle()
    assert page.evaluate("() => document.getElementById('chart-margins').layout.xaxis.range.join()") == "3,9"
    page.locator("#chart-speed").scroll_into_view_if_needed()
    stars.settle()
    where = page.evaluate(
        "() => { const c = document.getElementById('chart-speed'), l = c.querySelector('.cursor').getBoundingClientRect(),"
        " x = c._fullLayout.xaxis; return (l.x - c.getBoundingClientRect().x - x._offset) / x._length; }"
    )
    assert where == pytest.approx(1 / 3, abs=0.01)
    page.evaluate("() => scrollTo(0, 0)")


@pytest.mark.slow
def test_charts_run_over_the_length_laid_as_well(stars: Opened) -> None:
    page, plan = stars.page, make_plan(8_000)
    put(stars, "over", "length")
    longest = page.evaluate("() => Math.max(...document.getElementById('chart-margins').data[0].x)")
    assert longest == pytest.approx(plan.metrics["deposited_length_mm"] / 1e3, rel=0.02)
    page.evaluate("() => document.getElementById('chart-speed').emit('plotly_click', { points: [{ x: 1.0 }] })")
    stars.settle()
    t = page.evaluate("() => report.scene.player.t")
    traj = plan.trajectory
    laid = np.cumsum(np.where(traj.deposit, traj.speed, 0.0)) * traj.dt
    assert laid[round(t / traj.dt)] == pytest.approx(1.0, abs=0.02)
    put(stars, "over", "time")
    assert page.evaluate("() => Math.max(...document.getElementById('chart-margins').data[0].x)") == pytest.approx(
        traj.t[-1], rel=0.01
    )


@pytest.mark.slow(keep=("desk",))
@pytest.mark.parametrize("size", [pytest.param((1300, 900), id="desk"), pytest.param(PHONE, id="phone")])
def test_the_page_is_four_screens_high_at_most(browser: Browser, tmp_path: Path, size: tuple[int, int]) -> None:
    """As it opens; a larger print has as many charts, folds and rows that are not folded, give or take two."""
    plan = small_plan()
    assert len(judged(plan).tight) >= 5
    write_report(plan, tmp_path / "r.html")
    with opened(browser, tmp_path / "r.html", size) as found:
        assert found.page.evaluate("() => document.documentElement.scrollHeight") <= 4 * size[1]
        assert found.page.evaluate("() => document.documentElement.scrollWidth") <= size[0]


@pytest.mark.slow
def test_the_scene_stays_beside_what_is_read(small: Opened) -> None:
    small.page.evaluate("() => scrollTo(0, 1200)")
    view = small.page.locator("#view").bounding_box()
    assert view is not None and -5 <= view["y"] < 40
    small.page.evaluate("() => scrollTo(0, 0)")


def test_a_row_moves_scene_chart_and_card_by_the_keyboard_too(small: Opened) -> None:
    page, plan = small.page, small_plan()
    row = page.locator(".judged [data-place]", has_text="singularity margin").first
    row.focus()
    page.keyboard.press("Enter")
    small.settle()
    at = next(check.sample for check in plan.checks if check.name == "singularity margin")
    assert page.evaluate("() => report.scene.player.t") == pytest.approx(plan.trajectory.t[at])
    assert "singularity margin" in page.locator("#card").inner_text() and row.get_attribute("aria-pressed") == "true"
    page.locator("#chart-speed").scroll_into_view_if_needed()
    small.settle()
    where = page.evaluate(
        "() => { const c = document.getElementById('chart-speed'), l = c.querySelector('.cursor').getBoundingClientRect(),"
        " x = c._fullLayout.xaxis; return x.p2l(l.x - c.getBoundingClientRect().x - x._offset); }"
    )
    assert where == pytest.approx(plan.trajectory.t[at], abs=0.01 * plan.trajectory.t[-1])
    page.locator("#card-close").click()
    page.evaluate("() => scrollTo(0, 0)")


@pytest.mark.slow
def test_the_list_is_searched_by_a_word(small: Opened) -> None:
    page = small.page
    unfold(small)
    rows = page.locator("#rest tbody tr:not(.group):visible")
    whole = rows.count()
    page.fill("#find", "Filament")
    names = rows.all_inner_texts()
    assert 0 < len(names) < whole and all("filament" in name.lower() for name in names)
    assert page.locator("#found").inner_text() == f"{len(names)} row{'s' if len(names) > 1 else ''}"
    assert page.locator("#rest tr.group:visible").all_inner_texts() == ["material"]
    page.fill("#find", "")
    assert rows.count() == whole


@pytest.mark.slow
def test_a_refusal_shows_the_place_in_the_cell(browser: Browser, tmp_path: Path) -> None:
    plan = small_plan()
    bead = plan.toolpath.beads[1]
    x, y, z = (1e3 * bead.points[7]).tolist()
    refusal = Refusal("out of reach by 41 mm", bead=1, waypoint=7, s_mm=2.0, point_mm=(x, y, z), hints=("Move it.",))
    report_refusal(small_problem(), "ladder", refusal, tmp_path / "f.html")
    with opened(browser, tmp_path / "f.html") as found:
        page = found.page
        assert found.complaints == [] and page.locator("#play").count() == 0
        assert "bead 1, waypoint 7, 2.0 mm along it: out of reach by 41 mm" in page.locator(".verdict").inner_text()
        mark, view = page.locator("#letters .letter").bounding_box(), page.locator("#view").bounding_box()
        assert mark is not None and view is not None
        assert view["x"] < mark["x"] < view["x"] + view["width"] and view["y"] < mark["y"] < view["y"] + view["height"]
        assert "Move it." in page.locator("#card").inner_text()
        page.locator(".places button").click()
        red = np.abs(seen(found) - np.array([0xD1, 0x49, 0x5B]) / 255).max(axis=2) < 0.06
        assert red.sum() > 30, "the bead that fails"
        assert np.reshape(page.evaluate("() => report.scene.stage.now.q"), -1) == pytest.approx(plan.cell.home)


@pytest.mark.slow
@pytest.mark.usefixtures("few_charts")
def test_on_a_phone_nothing_overflows_and_a_failed_check_is_where_it_opens(browser: Browser, tmp_path: Path) -> None:
    plan = with_dips(make_plan(4_000, ok=False))
    at = int(plan.series["jerk_ratio"][: len(plan.trajectory) // 2].argmax())
    checks = tuple(c if c.ok else dataclasses.replace(c, sample=at) for c in plan.checks)
    write_report(dataclasses.replace(plan, checks=checks), tmp_path / "r.html")
    with opened(browser, tmp_path / "r.html", PHONE) as found:
        assert found.complaints == []
        assert found.page.evaluate("() => document.documentElement.scrollWidth") <= PHONE[0]
        box = found.page.locator("#view").bounding_box()
        assert box is not None and 300 < box["width"] <= PHONE[0] and box["height"] <= PHONE[1]
        assert "joint jerk" in found.page.locator("#card").inner_text()
        assert found.page.evaluate("() => report.scene.player.t") == pytest.approx(plan.trajectory.t[at])


@pytest.mark.slow
@pytest.mark.usefixtures("few_charts")
def test_without_webgl_the_page_says_so_and_its_charts_work(browser: Browser, tmp_path: Path) -> None:
    write_report(make_plan(4_000), tmp_path / "r.html")
    with opened(browser, tmp_path / "r.html", before=NO_WEBGL) as found:
        assert "no WebGL" in found.page.locator("#no-scene").inner_text()
        assert found.page.locator(".js-plotly-plot").count() >= 5 and not found.page.locator("#view").is_visible()
        assert found.complaints == []


@pytest.mark.slow
@pytest.mark.usefixtures("few_charts")
def test_inside_another_page_it_tells_and_follows(browser: Browser, tmp_path: Path) -> None:
    write_report(make_plan(4_000), tmp_path / "r.html")
    (tmp_path / "outer.html").write_text(
        "<iframe src=r.html sandbox=allow-scripts width=900 height=500></iframe><script>window.heard = [];"
        "addEventListener('message', (e) => { heard.push(e.data);"
        " if (e.data.beadwise === 'ready') document.documentElement.dataset.ready = 'yes'; })</script>"
    )
    with opened(browser, tmp_path / "outer.html") as found:
        page, inner = found.page, found.page.frames[1]
        say = "(m) => document.querySelector('iframe').contentWindow.postMessage({ beadwise: 'state', ...m }, '*')"
        camera = [1, 1, 1, 0, 0, 0, 0, 0, 1]
        page.evaluate(
            say, {"bead": 5, "s_mm": 10, "colour": "sigma", "camera": camera, "grow": True, "layers": "nonsense"}
        )
        found.settle()
        assert (
            "bead 5, 10" in inner.locator("#clock").inner_text() or "bead 5, 9" in inner.locator("#clock").inner_text()
        )
        assert inner.locator("#colour").input_value() == "sigma" and inner.locator("#grow").is_checked()
        page.evaluate(say, {"t": 3.0, "colour": "no such"})
        found.settle()
        assert inner.locator("#clock").inner_text().startswith("3.00 s of")
        assert page.evaluate("() => heard.length") == 1, "no echo"
        inner.locator("#only").check()
        page.wait_for_timeout(400)
        state = page.evaluate("() => heard[1]")
        assert state["beadwise"] == "state" and state["only"] is True and state["t"] == pytest.approx(3.0)
        assert state["camera"][:3] == pytest.approx([1, 1, 1], abs=1e-6) and len(str(state)) < 4_000


@pytest.mark.slow
def test_shapes_and_beads_alone_make_a_scene(browser: Browser, tmp_path: Path) -> None:
    write_failure_report(
        tmp_path / "f.html", problem=make_problem(), strategy="ladder", message="no", bead=2, point_mm=None, facts={},
        toolpath=SimpleNamespace(beads=make_beads(4), shape=SHAPE),
    )  # fmt: skip
    with opened(browser, tmp_path / "f.html") as found:
        assert found.complaints == [] and found.page.evaluate("() => Boolean(report.scene)")
    write_failure_report(
        tmp_path / "one.html", problem=make_problem(), strategy="ladder", message="no", bead=0, point_mm=None, facts={},
        toolpath=SimpleNamespace(beads=make_beads(1), shape=SHAPE),
    )  # fmt: skip
    with opened(browser, tmp_path / "one.html") as found:
        eye = found.page.evaluate("() => report.scene.stage.world.camera.position.toArray()")
        assert np.isfinite(eye).all(), "all other beads are none"


@pytest.mark.slow
def test_the_roll_map_says_what_is_under_the_pointer_and_leads_to_the_scene(small: Opened) -> None:
    page, plan = small.page, small_plan()
    page.locator("#roll-map").scroll_into_view_if_needed()
    for which, found in enumerate(plan.roll_maps[:2]):
        page.select_option("#roll-map-which", index=which)
        page.select_option("#roll-map-measure", label="joint range")
        small.settle()
        box = page.locator("#roll-map .nsewdrag").first.bounding_box()
        assert box is not None
        x, y = box["x"] + 0.7 * box["width"], box["y"] + 0.4 * box["height"]
        page.mouse.move(x, box["y"] - 40)
        page.locator("#roll-map .hovertext").wait_for(state="detached")
        page.mouse.move(x, y)
        page.locator("#roll-map .hovertext").wait_for(state="attached")
        i = int(np.argmin(np.abs(found.along - 0.7 * found.along[-1])))
        said = page.locator("#roll-map .hoverlayer").text_content() or ""
        assert said.startswith(f"bead {found.bead[i]}, ") and "joint range" in said
        assert float(said.split("mm")[0].split(", ")[1]) == pytest.approx(found.s[i] * 1e3, abs=1.5)
        page.wait_for_timeout(DOUBLE_CLICK)
        page.mouse.click(x, y)
        expect(page.locator("#clock")).to_contain_text(f"bead {found.bead[i]}, ")
        clock = page.locator("#clock").inner_text()
        assert float(clock.split(" mm along")[0].split(", ")[-1]) == pytest.approx(found.s[i] * 1e3, abs=1.5)
    assert small.complaints == []
