"""The live view around its state machine: files, the server on this computer, processes that solve, the command."""

from __future__ import annotations

import asyncio
import json
import os
import re
import signal
import socket
import subprocess
import sys
import time
import webbrowser
from collections.abc import Awaitable, Callable
from http.client import HTTPConnection
from pathlib import Path
from threading import Timer
from typing import Any
from urllib.parse import urlsplit

import pytest
from solved import line_of, write_small
from tornado.httpclient import AsyncHTTPClient, HTTPRequest, HTTPResponse

from planner.base.errors import InputError
from planner.base.web import server
from planner.base.web.door import CODE_TIME, MOST_SESSIONS, Door
from planner.base.web.server import LARGEST_ORDER, News, Server
from planner.problem import Problem
from planner.view import child, command, solver
from planner.view.command import Subject, main, read_results, run_view
from planner.view.content import Content, changes, mistake_of, read_content, signatures
from planner.view.machine import Again, Beside, Choose, Drafts, View
from planner.view.server import order_of, view_site

ROOT = Path(__file__).resolve().parents[1]
PLAN = {
    "problem": "small",
    "strategy": "ladder",
    "verified": True,
    "checks": [{"name": "reach", "ok": True}],
    "metrics": {"beads": 3, "layers": 1, "at_speed_fraction": 0.5, "print_time_s": 12.0},
    "settings": {"dt": 0.004, "overrides": []},
}

# --- files -------------------------------------------------------------------------------------------------


def test_content_follows_every_file_that_decides(tmp_path: Path) -> None:
    path = write_small(tmp_path)
    first, named = read_content(path, ())
    assert named == (tmp_path / "small.svg",)
    assert read_content(path, ())[0] == first
    path.write_text(path.read_text() + "# a comment\n")
    assert read_content(path, ())[0] == first, "comments decide nothing"
    (tmp_path / "small.svg").write_text("<svg/>")
    drawn, _ = read_content(path, ())
    assert changes(first, drawn) == ("small.svg changed",)
    (tmp_path / "small.svg").unlink()
    assert changes(drawn, read_content(path, ())[0]) == ("small.svg changed",)


def test_own_robot_and_its_urdf_are_watched(tmp_path: Path) -> None:
    for name in ("irb140.yaml", "irb140.urdf"):
        (tmp_path / name).write_bytes((ROOT / "robots" / name).read_bytes())
    path = write_small(tmp_path, ("arm: irb140", "arm: irb140.yaml"))
    whole, named = read_content(path, ())
    assert {file.name for file in named} == {"irb140.yaml", "irb140.urdf", "small.svg"}
    robot = tmp_path / "irb140.yaml"
    robot.write_text("urdf: [\n" + robot.read_text(encoding="utf-8"), encoding="utf-8")
    broken, named = read_content(path, ())
    assert {file.name for file in named} == {"irb140.yaml", "small.svg"}, "one that is to be mended, too"
    assert changes(whole, broken) == ("irb140.yaml changed",)


def test_own_rail_and_its_urdf_are_watched(tmp_path: Path) -> None:
    for name in ("track_3m.yaml", "track_3m.urdf"):
        (tmp_path / name).write_bytes((ROOT / "robots" / name).read_bytes())
    base = "arm: irb140\n  base: {robot: track_3m.yaml, free: [rail]}"
    _, named = read_content(write_small(tmp_path, ("arm: irb140", base)), ())
    assert {file.name for file in named} == {"track_3m.yaml", "track_3m.urdf", "small.svg"}


def test_changes_are_told_by_field() -> None:
    before = Content((("a.b", "1"), ("list", "[1, 2]"), ("gone", "x")))
    after = Content((("a.b", "2"), ("list", "[1, 2]"), ("new", "true")))
    assert changes(before, after) == ("a.b: 1 → 2", "new: true added", "gone: x removed")


def test_mistake_has_the_line_that_it_names(tmp_path: Path) -> None:
    path = write_small(tmp_path, ("speed_mm_s: 40", "speed_mm_s: fast"))
    with pytest.raises(InputError) as caught:
        read_content(path, ())
    mistake = mistake_of(caught.value)
    assert (mistake.field, mistake.line) == ("process.speed_mm_s", line_of(path, "fast"))
    assert mistake.excerpt == "  speed_mm_s: fast"


def test_all_mistakes_of_a_file_are_told_once(tmp_path: Path) -> None:
    path = write_small(tmp_path, ("speed_mm_s: 40", "speed_mm_s: fast"), ("radius_mm: 34", "radius: 34"))
    with pytest.raises(InputError) as caught:
        read_content(path, ())
    mistake = mistake_of(caught.value)
    assert (mistake.field, mistake.line, mistake.hint) == ("part.cylinder.radius", 11, "did you mean radius_mm?")
    (other,) = mistake.more
    assert other.startswith(f"line {line_of(path, 'fast')}: process.speed_mm_s: must be a number")


def test_file_that_is_gone_is_waited_for(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"is gone \(the view resumes"):
        read_content(tmp_path / "a.yaml", ())
    with pytest.raises(InputError, match="and so is its folder"):
        read_content(tmp_path / "b" / "a.yaml", ())


def test_save_by_renaming_is_seen_even_with_time_and_size_kept(tmp_path: Path) -> None:
    path, other = tmp_path / "a", tmp_path / "b"
    for file in (path, other):
        file.write_text("same")
        os.utime(file, (0, 0))
    before = signatures([path])
    other.rename(path)
    assert signatures([path]) != before
    path.unlink()
    assert signatures([path]) == {path: None}


def write_results(folder: Path, **changed: Any) -> Path:
    """A folder as planner.solve leaves it, as far as the view looks at it."""
    folder.mkdir(exist_ok=True)
    (folder / "plan.json").write_text(json.dumps({**PLAN, **changed}))
    (folder / "report.html").write_text("<!doctype html><title>a report</title>")
    return folder


def test_folder_of_results_says_what_came_of_it(tmp_path: Path) -> None:
    problem, strategy, outcome, settings = read_results(write_results(tmp_path / "out"))
    assert (problem, strategy, outcome.kind) == ("small", "ladder", "verified")
    assert dict(outcome.figures) == {"at_speed_fraction": 0.5, "print_time_s": 12.0}
    assert ("dt", "0.004") in settings.fields
    failed = read_results(write_results(tmp_path / "out", verified=False, checks=[{"name": "reach", "ok": False}]))[2]
    assert (failed.kind, failed.words) == ("failed", "not verified: reach; 3 beads, 1 layer")
    assert read_results(write_results(tmp_path / "out", verified=False, metrics={}))[2].kind == "refused"
    none = read_results(write_results(tmp_path / "out", verified=False, checks=None))[2]
    assert (none.kind, none.words) == ("failed", "not verified: see the report; 3 beads, 1 layer")


@pytest.mark.parametrize("text", ["", "[", "[1, 2]", '{"problem": 3}', "[" * 100_000, "\x00"])
def test_folder_that_holds_something_else_is_refused(tmp_path: Path, text: str) -> None:
    folder = write_results(tmp_path / "out")
    (folder / "plan.json").write_text(text)
    with pytest.raises(InputError):
        read_results(folder)


# --- what the page may ask for -----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("order", "event"),
    [
        ({"do": "choose", "pane": 1, "strategy": "sqp"}, Choose(1, "sqp")),
        ({"do": "beside", "strategy": "ladder"}, Beside("ladder")),
        ({"do": "beside", "strategy": None}, Beside(None)),
        ({"do": "drafts", "wanted": False}, Drafts(False)),
        ({"do": "again"}, Again()),
        ({"do": "choose", "pane": 1, "strategy": "../sqp"}, None),
        ({"do": "choose", "pane": "1", "strategy": "sqp"}, None),
        ({"do": "choose", "pane": 1, "strategy": "sqp", "more": 1}, None),
        ({"do": "drafts", "wanted": 1}, None),
        ({"do": "solve"}, None),
        ([], None),
    ],
)
def test_orders_are_read_strictly(order: Any, event: object) -> None:
    assert order_of(json.dumps(order).encode()) == event


@pytest.mark.parametrize("body", [b"", b"{", b"\xff", b"[" * LARGEST_ORDER])
def test_orders_that_are_no_json(body: bytes) -> None:
    assert order_of(body) is None


# --- the server, with a solver that only says what it is told to ---------------------------------------------

FAKE = """\
import json, os, pathlib, sys, time
def say(**message):
    print(json.dumps({"job": job["number"], **message}), flush=True)
for line in sys.stdin:
    job = json.loads(line)
    if "cancel" in job:
        continue
    text = pathlib.Path(job["problem"]).read_text()
    if "speed_mm_s: 13" in text:
        sys.exit("a solver's last words")
    if "speed_mm_s: 19" in text:
        say(apart=True)
    say(stage="resolve", draft="")
    if "speed_mm_s: 17" in text:
        time.sleep(60)
    if "speed_mm_s: 19" in text:
        sys.stdin.readline()
        say(stage="what is too late", draft="")
        continue
    folder = pathlib.Path(job["folder"]) / "whole"
    folder.mkdir(parents=True)
    (folder / "report.html").write_text(f"report of {job['strategy']} by {os.getpid()}")
    say(kind="verified", words="verified: 1 check holds", figures=[["print_time_s", 9.0]], draft="")
    if "speed_mm_s: 23" in text:
        sys.exit()
"""


class Page:
    """What a browser does with the view."""

    def __init__(self, server: Server, url: str, cookie: str) -> None:
        self.server, self.url, self.cookie = server, url, cookie
        self._client = AsyncHTTPClient(force_instance=True)

    async def get(self, path: str, **changed: Any) -> HTTPResponse:
        """An answer, whatever its code."""
        headers = {"Cookie": self.cookie, **changed.pop("headers", {})}
        request = HTTPRequest(changed.pop("url", self.url) + path, headers=headers, **changed)
        return await self._client.fetch(request, raise_error=False)

    async def do(self, order: Any, **headers: str) -> int:
        """What the page's buttons do; the code of the answer."""
        given = {"Content-Type": "application/json", **headers}
        return (await self.get("do", method="POST", headers=given, body=json.dumps(order))).code

    async def until(self, wanted: Callable[[dict[str, Any]], object]) -> dict[str, Any]:
        """Listen until the page is told of a state that is wanted."""
        return await asyncio.to_thread(heard, self.url, self.cookie, wanted)


def visit(subject: Subject, scenario: Callable[[Page], Awaitable[None]], *panes: str) -> None:
    """Run a view in this process, and a scenario with its page."""

    async def both() -> None:
        over = asyncio.Event()
        made: asyncio.Future[Server] = asyncio.get_running_loop().create_future()
        view = View(panes=panes or ("ladder",), solving=not subject.folder)
        running = asyncio.create_task(run_view(subject, view, 0, made.set_result, over))
        try:
            there = await made
            await scenario(Page(there, *await asyncio.to_thread(entered, there.address)))
        finally:
            over.set()
            assert await running == 0

    asyncio.run(both())


@pytest.fixture
def fake(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    """The small problem, to be solved by a script that plans nothing."""
    script = tmp_path / "fake.py"
    script.write_text(FAKE)
    monkeypatch.setattr(solver, "CHILD", (sys.executable, "-S", str(script)))
    return write_small(tmp_path / "problem")


def save(path: Path, old: str, new: str) -> None:
    """Save as many editors do: a new file takes the place of the old one."""
    fresh = path.with_suffix(".new")
    fresh.write_text(path.read_text().replace(old, new))
    fresh.rename(path)


def shown(key: str) -> Callable[[dict[str, Any]], bool]:
    """Whether the first pane shows a report."""
    return lambda state: (state["panes"][0]["result"] or {}).get("key") == key


def test_view_from_the_first_solve_to_a_mended_mistake(fake: Path) -> None:
    async def scenario(page: Page) -> None:
        await page.until(shown("1-whole"))
        assert (await page.get("report/1-whole")).body.startswith(b"report of ladder by ")
        save(fake, "speed_mm_s: 40", "speed_mm_s: 50")
        state = await page.until(shown("2-whole"))
        assert state["history"]["rows"][0]["changes"] == ["process.speed_mm_s: 40 → 50"]
        assert (await page.get("report/1-whole")).code == 404
        save(fake, "speed_mm_s: 50", "speed_mm_s: fast")
        state = await page.until(lambda state: state["mistake"])
        assert state["mistake"]["field"] == "process.speed_mm_s"
        assert state["panes"][0]["result"] | {"old": True} == state["panes"][0]["result"]
        fake.unlink()
        await page.until(lambda state: state["mistake"] and state["mistake"]["text"] == "is gone")
        write_small(fake.parent, ("speed_mm_s: 40", "speed_mm_s: 60"))
        await page.until(shown("3-whole"))
        assert await page.do({"do": "beside", "strategy": "greedy"}) == 204
        state = await page.until(lambda state: len(state["panes"]) == 2 and state["panes"][1]["result"])
        assert [row["label"] for row in state["differences"]] == ["print time, s"]

    visit(Subject(fake, "small"), scenario)


@pytest.mark.slow
def test_solve_that_a_newer_save_overtakes_and_solver_that_dies(fake: Path, capfd: pytest.CaptureFixture[str]) -> None:
    async def scenario(page: Page) -> None:
        await page.until(shown("1-whole"))
        save(fake, "speed_mm_s: 40", "speed_mm_s: 17")  # which takes a minute
        await page.until(lambda state: (state["panes"][0]["running"] or {}).get("stage") == "resolve")
        save(fake, "speed_mm_s: 17", "speed_mm_s: 13")
        state = await page.until(lambda state: state["trouble"])
        assert state["trouble"]["text"] == "the solver ended unexpectedly"
        assert state["trouble"]["hint"] == "a solver's last words"
        save(fake, "speed_mm_s: 13", "speed_mm_s: 40")
        await page.until(shown("4-whole"))

    visit(Subject(fake, "small"), scenario)
    assert "a solver's last words" in capfd.readouterr().err


@pytest.mark.slow
def test_a_solver_stays_for_the_next_save(fake: Path) -> None:
    """One that has ended since is replaced, and so is one that is cancelled, but where a copy of it does the work."""

    async def scenario(page: Page) -> None:
        solvers = []
        before = "40"
        for job, speed in enumerate(("40", "50", "23", "51", "17", "52", "19", "53"), 1):
            save(fake, f"speed_mm_s: {before}", f"speed_mm_s: {speed}")
            if speed in ("17", "19"):
                await page.until(lambda state: (state["panes"][0]["running"] or {}).get("stage") == "resolve")
            else:
                await page.until(shown(f"{job}-whole"))
                solvers.append((await page.get(f"report/{job}-whole")).body.split()[-1])
            before = speed
        first, second, third, after_its_end, after_its_cancel, after_a_copy = solvers
        assert first == second == third
        assert after_its_end != third and after_its_cancel != after_its_end
        assert after_a_copy == after_its_cancel

    visit(Subject(fake, "small"), scenario)


def test_a_copy_of_the_solver_ends_alone(capfd: pytest.CaptureFixture[str]) -> None:
    forked, begun = child.ForkedSolve(), []
    forked.end()  # there is none
    assert forked.do(lambda: begun.append(1), lambda: None) and begun == [1]
    Timer(0.1, forked.end).start()
    since = time.monotonic()
    assert forked.do(lambda: None, lambda: time.sleep(60.0)) and time.monotonic() - since < 30.0
    assert not forked.do(lambda: None, lambda: os.kill(os.getpid(), signal.SIGKILL))
    assert "exit code -9" in capfd.readouterr().err
    assert not forked.do(lambda: None, lambda: sys.exit(3))


@pytest.mark.slow
def test_a_large_print_is_solved_by_a_copy_after_its_draft(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(child, "LARGE", 10)
    said: list[dict[str, Any]] = []
    copied: list[Callable[[], None]] = []

    class Kept(child.ForkedSolve):
        def do(self, begun: Callable[[], None], work: Callable[[], None]) -> bool:
            begun()
            copied.append(work)
            return True

    path = write_small(tmp_path, ("count: 1", "count: 2"))
    job = {"problem": str(path), "overrides": [], "strategy": "as_published", "drafts": True, "folder": str(tmp_path)}
    assert child.run(job, lambda **message: said.append(message), Kept())
    assert [message["draft"] for message in said if "kind" in message] == ["one layer of 2"]
    assert said[-1] == {"apart": True} and len(copied) == 1
    assert (tmp_path / "draft" / "report.html").is_file() and not (tmp_path / "whole").exists()
    copied[0]()
    assert [message["draft"] for message in said if "kind" in message] == ["one layer of 2", ""]
    assert (tmp_path / "whole" / "report.html").is_file()


def test_a_first_layer_that_cannot_be_laid_alone_is_no_mistake_of_the_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(child, "LARGE", 10)
    monkeypatch.setattr(child, "FORKS", False)
    solved: list[str] = []

    def solve(problem: Problem, strategy: str, folder: Path, draft: str, say: child.Say) -> None:
        if draft:
            raise InputError("the first layer has no bead")
        solved.append(folder.name)

    monkeypatch.setattr(child, "_solve", solve)
    path = write_small(tmp_path, ("count: 1", "count: 2"))
    said: list[dict[str, Any]] = []
    job = {"problem": str(path), "overrides": [], "strategy": "as_published", "drafts": True, "folder": str(tmp_path)}
    assert child.run(job, lambda **message: said.append(message), child.ForkedSolve())
    assert (solved, said) == (["whole"], [])


def test_a_problem_without_a_count_of_layers_has_a_draft_of_the_first(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(child, "FORKS", False)
    solved: list[tuple[int | None, str]] = []

    def solve(problem: Problem, strategy: str, folder: Path, draft: str, say: child.Say) -> None:
        solved.append((problem.layers.count, draft))

    monkeypatch.setattr(child, "_solve", solve)
    said: list[dict[str, Any]] = []
    job = {"problem": "planar_gcode", "overrides": [], "strategy": "ladder", "drafts": True, "folder": str(tmp_path)}
    for large in (10, 10**9):
        monkeypatch.setattr(child, "LARGE", large)
        assert child.run(job, lambda **message: said.append(message), child.ForkedSolve())
    assert (solved, said) == ([(1, "one layer of 3"), (None, ""), (None, "")], [])


def test_solver_that_cannot_be_started_is_said(fake: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(solver, "CHILD", (str(fake.parent / "no_python"),))

    async def scenario(page: Page) -> None:
        state = await page.until(lambda state: state["trouble"])
        assert state["trouble"]["text"] == "no solver can be started: No such file or directory"

    visit(Subject(fake, "small"), scenario)


def test_others_neither_see_nor_steer_the_view(fake: Path) -> None:
    async def scenario(page: Page) -> None:
        parts = urlsplit(page.url)
        bare = f"{parts.scheme}://{parts.netloc}/"
        for path in ("", "events", "page.js", "x" * 22 + "/"):
            assert (await page.get(path, url=bare)).code == 404
        assert (await page.get("", headers={"Host": "evil.example"})).code == 403
        assert (await page.get("events", headers={"Origin": "http://evil.example"})).code == 403
        assert await page.do({"do": "again"}, Origin="http://evil.example") == 403
        assert await page.do({"do": "again"}, Origin="null") == 403, "a report in its sandbox"
        assert (await page.get("do", method="POST", body='{"do": "again"}')).code == 415
        assert await page.do({"do": "anything"}) == 400
        assert (await page.get("do", method="POST", body="x" * (LARGEST_ORDER + 1))).code in (400, 599)
        for path in ("report/9-whole", "report/1-whole/../../x", "report/..%2f1-whole", "nothing"):
            assert (await page.get(path)).code == 404
        first = await page.get("")
        assert first.code == 200 and "frame-ancestors 'none'" in first.headers["Content-Security-Policy"]
        await page.until(shown("1-whole"))
        policy = (await page.get("report/1-whole")).headers["Content-Security-Policy"]
        assert "sandbox allow-scripts" in policy and "allow-same-origin" not in policy and "connect-src" not in policy

    visit(Subject(fake, "small"), scenario)


def test_the_place_alone_lets_nobody_in(fake: Path) -> None:
    """Whoever knows the page's address has not been let in by it; the cookie is of one view, and for its own page only."""

    async def scenario(page: Page) -> None:
        for cookie in ("", "beadwise=", "beadwise=" + "x" * 43, page.cookie + "x", page.cookie.upper()):
            for path in ("", "events", "page.js", "report/1-whole"):
                assert (await page.get(path, headers={"Cookie": cookie})).code == 403
            assert await page.do({"do": "again"}, Cookie=cookie) == 403
        for site in ("same-site", "cross-site"):  # another port of this computer is of the same site
            assert (await page.get("page.js", headers={"Sec-Fetch-Site": site})).code == 403
        assert (await page.get("", headers={"Sec-Fetch-Site": "same-origin"})).code == 200
        word = page.server.address.rsplit("/", 1)[1]
        assert word not in page.url and word not in page.cookie and page.cookie.split("=")[1] not in page.url

    visit(Subject(fake, "small"), scenario)


def test_a_code_is_taken_once(fake: Path) -> None:
    async def scenario(page: Page) -> None:
        once = page.server.address_once()
        assert once != page.server.address
        url, cookie = await asyncio.to_thread(entered, once)
        assert url == page.url and cookie != page.cookie
        assert (await page.get("", headers={"Cookie": cookie})).code == 200
        second = await page.get("", url=once)
        assert second.code == 403 and "Set-Cookie" not in second.headers
        assert (await page.get("", headers={"Cookie": cookie})).code == 403, "somebody else may have been first"
        assert (await page.get("")).code == 200
        assert (await page.get("", url=once + "x")).code == 403
        assert (await page.get("", url=once, headers={"Host": "evil.example"})).code == 403

    visit(Subject(fake, "small"), scenario)


def test_words_of_the_door() -> None:
    door = Door()
    code = door.code(100.0)
    assert door.enter(code, 100.0 + CODE_TIME + 0.1) is None, "too late"
    code = door.code(100.0)
    session = door.enter(code, 100.0 + CODE_TIME)
    assert session is not None and door.knows(session)
    assert door.enter(code, 1e6) is None and door.knows(session), "a tab that is restored the next day ends nothing"
    sessions = [door.enter(door.key, 1e6) for _ in range(MOST_SESSIONS)]
    assert len(set(sessions)) == MOST_SESSIONS and all(door.knows(each or "") for each in sessions)
    assert not door.knows(session), "the oldest goes"
    assert door.enter("", 0.0) is None and not door.knows("") and door.enter("é", 0.0) is None


def test_the_browser_is_started_with_a_code_only(
    fake: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Arguments of a program can be read by all users of a computer."""
    opened: list[str] = []
    monkeypatch.setattr(webbrowser, "open", opened.append)

    async def scenario(page: Page) -> None:
        command._ready(Subject(fake, "small"), True, page.server)
        while not opened:
            await asyncio.sleep(0.01)
        assert page.server.address in capsys.readouterr().out
        secret = (page.server.address.rsplit("/", 1)[1], page.cookie, urlsplit(page.url).path)
        assert not any(word in opened[0] for word in secret)
        assert (await asyncio.to_thread(entered, opened[0]))[0] == page.url
        assert (await page.get("", url=opened[0])).code == 403

    visit(Subject(fake, "small"), scenario)


@pytest.mark.slow(keep=2)
@pytest.mark.parametrize(
    "said",
    [
        b"",
        b"GET / HT",
        b"GET /nothing HTTP/1.1\r\nHost: x\r\n\r\n",
        b"POST /nothing HTTP/1.1\r\nHost: x\r\nContent-Length: 9\r\n\r\nx",
    ],
)
def test_idle_connections_end(fake: Path, said: bytes, monkeypatch: pytest.MonkeyPatch) -> None:
    """Without a word, with half a header, after an answer, and with half a body."""
    monkeypatch.setattr(server, "IDLE_TIME", 0.3)
    monkeypatch.setattr(server, "BODY_TIME", 0.3)

    def ended(port: int | None) -> float:
        since = time.monotonic()
        with socket.create_connection(("127.0.0.1", port or 0), timeout=5.0) as made:
            made.sendall(said)
            while made.recv(4096):
                continue
        return time.monotonic() - since

    async def scenario(page: Page) -> None:
        took = await asyncio.to_thread(ended, urlsplit(page.url).port)
        assert 0.2 < took < 2.0

    visit(Subject(fake, "small"), scenario)


def test_who_listens_and_does_not_read_is_left(fake: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """No memory and no place among the listeners is held by a page that takes nothing any more."""
    monkeypatch.setattr(server, "IDLE_TIME", 0.3)

    async def scenario() -> None:
        news, where = News(), server.listen(0, "--port")
        there = Server(where, view_site(news, lambda key: None, lambda event: None))
        news.tell("x" * 30_000_000)
        url, cookie = await asyncio.to_thread(entered, there.address)
        parts = urlsplit(url)
        with socket.create_connection(("127.0.0.1", parts.port or 0)) as made:
            made.sendall(
                f"GET {parts.path}events HTTP/1.1\r\nHost: {parts.netloc}\r\nCookie: {cookie}\r\n\r\n".encode()
            )
            for wanted in (1, 0):
                end = time.monotonic() + 3.0
                while len(news.listeners) != wanted and time.monotonic() < end:
                    await asyncio.sleep(0.01)
                assert len(news.listeners) == wanted
        await there.close()

    asyncio.run(scenario())


def test_folder_is_shown_again_when_it_is_written_again(tmp_path: Path) -> None:
    folder = write_results(tmp_path / "out")

    async def scenario(page: Page) -> None:
        await page.until(shown("1-folder"))
        assert b"a report" in (await page.get("report/1-folder")).body
        write_results(folder, settings={"dt": 0.002, "overrides": []})
        state = await page.until(shown("2-folder"))
        assert state["history"]["rows"][0]["changes"] == ["dt: 0.004 → 0.002"]
        (folder / "report.html").unlink()
        await page.until(lambda state: state["mistake"] and state["mistake"]["text"] == "has no report.html")

    visit(Subject(folder, "out", folder=True), scenario)


def test_slow_page_is_told_the_newest_only() -> None:
    async def scenario() -> None:
        news = News()
        listener = asyncio.Event()
        news.listeners.add(listener)
        for k in range(1000):
            news.tell(str(k))
        assert listener.is_set() and news.text == "999"

    asyncio.run(scenario())


# --- the command ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("arguments", "fragments"),
    [
        (["nowhere.yaml"], ["nowhere.yaml", "no such problem file"]),
        (["fibre_plan"], ["did you mean fibre_plane?"]),
        (["."], ["a folder without results"]),
        (["fibre_plane", "--set", "process.speed"], ["--set process.speed", "dotted.key=value"]),
        (["fibre_plane", "--port", "70000"], ["is not a port"]),
        (["fibre_plane", "--beside", "best"], ["is unknown", "sqp"]),
    ],
)
def test_wrong_arguments(
    arguments: list[str],
    fragments: list[str],
    capfd: pytest.CaptureFixture[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    try:
        code = main(arguments)
    except SystemExit as stop:
        code = int(stop.code or 0)
    message = capfd.readouterr().err
    assert code == 2
    for fragment in fragments:
        assert fragment in message


# as python -m planner.view, but for small prints, too, that share their work with a second process
SHARING = """\
import sys
from planner.view import child, command, solver
run_child = (
    "import sys, planner.planning.pipeline as p, planner.view.child as c;"
    "p.WORTH_A_FORK = p.WORTH_HALVES = 1; sys.exit(c.main())"
)
solver.CHILD = (sys.executable, "-c", run_child)
sys.exit(command.main())
"""


@pytest.mark.slow
def test_life_of_the_command(tmp_path: Path) -> None:
    """A real problem, solved; its port is taken for others; Ctrl-C leaves no process and no file behind."""
    path = write_small(tmp_path)
    keep = tmp_path / "tmp"
    keep.mkdir()
    arguments = [sys.executable, "-c", SHARING, str(path), "--no-browser", "--strategy", "as_published"]
    environment = {**os.environ, "TMPDIR": str(keep), "PYTHONPATH": str(ROOT)}
    with subprocess.Popen(
        arguments, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment
    ) as view:
        try:
            assert view.stdout is not None
            found = re.search(r"http://127\.0\.0\.1:(\d+)/\S+", view.stdout.readline())
            assert found is not None
            page = entered(found[0])
            stages: list[dict[str, Any]] = []
            state = heard(*page, lambda state: _note(state, stages) or state["panes"][0]["result"])
            assert len(stages) > 3 and all(stage["done"] is not None for stage in stages), "the page knows all stages"
            assert state["panes"][0]["result"]["kind"] == "verified"
            children = _children(view.pid)
            assert children
            assert main([str(path), "--no-browser", "--port", found[1]]) == 2
        finally:
            view.send_signal(signal.SIGINT)
            code = view.wait(20)
    assert code == 130
    assert list(keep.iterdir()) == []
    assert not [child for child in children if Path(f"/proc/{child}").exists()]


def _note(state: dict[str, Any], stages: list[dict[str, Any]]) -> None:
    running = state["panes"][0]["running"]
    if running is not None:
        stages.append(running)


def entered(address: str) -> tuple[str, str]:
    """The page that an address leads to, and the cookie that it gives."""
    parts = urlsplit(address)
    connection = HTTPConnection(parts.hostname or "", parts.port, timeout=60)
    connection.request("GET", parts.path)
    answer = connection.getresponse()
    moved = re.search(r"url=(/[^\"]+/)\"", answer.read().decode())
    assert answer.status == 200 and moved is not None
    cookie, *rules = str(answer.getheader("Set-Cookie")).split("; ")
    assert rules == [f"Path={moved[1]}", "HttpOnly", "SameSite=Strict"]
    connection.close()
    return f"{parts.scheme}://{parts.netloc}{moved[1]}", cookie


def heard(url: str, cookie: str, wanted: Callable[[dict[str, Any]], object]) -> dict[str, Any]:
    parts = urlsplit(url)
    connection = HTTPConnection(parts.hostname or "", parts.port, timeout=60)
    connection.request("GET", parts.path + "events", headers={"Cookie": cookie})
    answer, end = connection.getresponse(), time.monotonic() + 60
    while time.monotonic() < end:
        line = answer.readline()
        if line.startswith(b"data: ") and wanted(state := json.loads(line[6:])):
            connection.close()
            return state
    raise AssertionError("the view did not come so far")


def _children(pid: int) -> list[int]:
    return [int(child) for child in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]
