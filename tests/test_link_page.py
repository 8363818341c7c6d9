"""A run's page: its protocol against the simulated controller and board, and in a browser."""

from __future__ import annotations

import json
import re
import shutil
import socket
import threading
import time
from collections.abc import Callable, Iterator
from http.client import HTTPConnection
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import pytest
from link_ends import as_results
from simulate_fixtures import MODULE, program, reader
from test_view import entered, heard

from planner.link import command
from planner.link import run as board
from planner.link.page import near_lines, part_of, spans
from planner.link.program_lines import ProgramLine, ProgramLines
from planner.simulate.rws import Access
from planner.simulate.start import Simulated, start

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
PASSWORD = "r0b0tics-of-ours"
LINES = ["M83", *(f"G1 E0.{k} F600" for k in range(100, 160)), "M104 S0"]
TOTAL = len(LINES)


@pytest.fixture
def files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A program of a line, 3 beads with 20 lines each on two layers, and a line; with its table."""
    monkeypatch.setenv(command.PASSWORD, PASSWORD)
    monkeypatch.setenv(board.PASSWORD, "h3ad")
    made = tmp_path / "Made.mod"
    hello = f'        SocketSend bwClient\\Str:="H Made {TOTAL}\\0A";\n'
    text = MODULE.replace("MODULE Made\n", "MODULE Made\n    ! Problem cup_7, strategy sqp\n", 1)
    made.write_text(text.replace("PROC main()\n", f"PROC main()\n{hello}", 1))
    bead = [-1, *((n - 2) // 20 for n in range(2, TOTAL)), -1]
    rows = [f"{n},{bead[n - 1]},{max(bead[n - 1], 0) // 2},{0.1 * n:.3f},{gcode}" for n, gcode in enumerate(LINES, 1)]
    (tmp_path / "Made_lines.csv").write_text("\n".join(["n,bead,layer,t_s,text", *rows, ""]))
    as_results(tmp_path)
    return made


class Hub:
    """The link with its page, in a thread; and what browsers do with it."""

    def __init__(self, files: Path, machine: Simulated, told: list[str]) -> None:
        rws, head = (f"{host}:{port}" for host, port in (machine.rws, machine.board))
        self.machine, self.log = machine, files.with_name("log.jsonl")
        words = [str(files), "--controller", rws, "--head", head, "--socket-port", str(machine.program[1])]
        words += ["--quiet", "--log", str(self.log), "--page", "--no-browser"]
        self.code: list[int] = []
        self.thread = threading.Thread(target=lambda: self.code.append(command.main(words)), daemon=True)
        self.thread.start()
        end = time.monotonic() + 20.0
        while not told:
            assert time.monotonic() < end
            time.sleep(0.01)
        self.address = told[0]
        self.url, self.cookie = entered(self.address)

    def until(self, wanted: Callable[[dict[str, Any]], object]) -> dict[str, Any]:
        return heard(self.url, self.cookie, wanted)

    def at(self, state: str) -> dict[str, Any]:
        return self.until(lambda told: told.get("state") == state)

    def do(self, order: Any, **headers: str) -> int:
        given = {"Cookie": self.cookie, "Content-Type": "application/json", **headers}
        return self.get("do", "POST", json.dumps(order), given)

    def get(
        self, path: str, method: str = "GET", body: str | None = None, headers: dict[str, str] | None = None
    ) -> int:
        parts = urlsplit(self.url)
        connection = HTTPConnection(parts.hostname or "", parts.port, timeout=10)
        connection.request(method, parts.path + path, body, {"Cookie": self.cookie} if headers is None else headers)
        code = connection.getresponse().status
        connection.close()
        return code

    def ended(self) -> int:
        self.thread.join(30.0)
        return self.code[0]

    def printed(self) -> list[str]:
        lines = [(n, gcode) for n, gcode in self.machine.board_record().accepted if n is not None]
        assert [n for n, _ in lines] == list(range(1, len(lines) + 1))
        return [gcode for _, gcode in lines]

    def whats(self) -> list[str]:
        return [json.loads(line)["what"] for line in self.log.read_text().splitlines()]


@pytest.fixture
def hub(request: pytest.FixtureRequest, files: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Hub]:
    told: list[str] = []
    monkeypatch.setattr(command, "tell_address", lambda what, address, once: told.append(address))
    # bounds the wait of a page for its last news
    monkeypatch.setattr("planner.link.page.LAST_TIME", 0.3)
    given = {"access": Access(password=PASSWORD), **getattr(request, "param", {})}
    with start(pace=1.0, read=reader(program(LINES, moves=TOTAL + 1)), board_tool=0, **given) as machine:
        made = Hub(files, machine, told)
        yield made
        if made.thread.is_alive():
            made.do({"do": "stop"})
        made.ended()


@pytest.mark.slow
def test_pause_reprime_and_continue_within_the_bead(hub: Hub) -> None:
    """The board gets every line once; what primes it stands between two lines of a bead."""
    told = hub.until(lambda told: told.get("bead") and told["line"] > 5)
    assert (told["state"], told["title"], told["problem"], told["of"]) == ("running", "Made", "cup_7", TOTAL)
    assert told["may"] == ["jam", "pause", "stop"] and re.fullmatch(r"\d+:\d\d", told["left"])
    assert told["bead"]["n"] == 0 and told["bead"]["last"] == 2 and 0.0 < told["bead"]["share"] < 1.0
    assert hub.do({"do": "continue"}) == 409 and hub.do({"do": "reprime", "mm": 10, "mm_s": 5}) == 409
    assert hub.do({"do": "pause"}) == 204
    told = hub.until(lambda told: told.get("state") == "paused" and "reprime" in told["may"])
    assert told["reason"] == "paused on the page" and told["may"] == ["continue", "reprime", "stop"]
    assert not hub.machine.controller.running
    line = told["line"]
    assert hub.do({"do": "pause"}) == 409 and hub.do({"do": "jam"}) == 409
    assert hub.do({"do": "reprime", "mm": 3.0, "mm_s": 20}) == 204
    hub.until(lambda told: "reprimed" in [note["what"] for note in told["log"]])
    time.sleep(0.3)
    assert len(hub.printed()) == line == hub.at("paused")["line"]
    assert hub.do({"do": "continue"}) == 204
    hub.until(lambda told: told.get("state") == "running" and told["line"] > line)
    told = hub.at("done")
    assert told["reason"].startswith(f"done: all {TOTAL} lines were acknowledged") and told["may"] == []
    assert hub.ended() == 0 and hub.printed() == LINES
    plain = [gcode for n, gcode in hub.machine.board_record().accepted if n is None]
    assert plain == ["M115", "G1 E3.000 F1200.000", "M400", "G1 F600"]
    told_of = [what for what in hub.whats() if what in ("pause", "stands", "reprimed", "continue", "moves")]
    assert told_of == ["pause", "stands", "reprimed", "continue", "moves"]


@pytest.mark.slow
@pytest.mark.parametrize("hub", [{"board_faults": ["clog@25"]}], indirect=True)
def test_a_jam_that_the_board_tells_pauses_at_once(hub: Hub) -> None:
    told = hub.at("paused")
    assert "Filament error on extruder 0: tooLittleMovement" in told["reason"]
    assert 24 <= len(hub.printed()) <= 26 and not hub.machine.controller.running
    hub.until(lambda told: "reprime" in told["may"])
    assert hub.do({"do": "reprime", "mm": 2, "mm_s": 20}) == 204
    hub.until(lambda told: "reprimed" in [note["what"] for note in told["log"]])
    assert hub.do({"do": "continue"}) == 204
    assert hub.ended() == 0 and hub.printed() == LINES


@pytest.mark.slow
def test_stopped_from_the_page(hub: Hub) -> None:
    hub.until(lambda told: told.get("line", 0) > 3)
    assert hub.do({"do": "jam"}) == 204
    assert hub.at("paused")["reason"] == "the user reports a jam"
    assert hub.do({"do": "stop"}) == 204
    told = hub.at("stopped")
    assert "stopped on the page" in told["reason"] and "--from-bead 0" in told["reason"]
    assert hub.ended() == 3 and not hub.machine.controller.running
    assert hub.printed() == LINES[: len(hub.printed())]


@pytest.mark.slow
def test_two_pages_and_none_show_the_same_run(hub: Hub) -> None:
    """A second browser, a reload, an order of each; and the run goes on while nobody looks."""
    hub.until(lambda told: told.get("line", 0) > 3)
    second = entered(hub.address)
    assert second[0] == hub.url and second[1] != hub.cookie
    assert hub.do({"do": "pause"}) == 204
    first = hub.at("paused")
    other = heard(*second, lambda told: told.get("state") == "paused")
    assert {key: first[key] for key in ("line", "reason", "of")} == {
        key: other[key] for key in ("line", "reason", "of")
    }
    assert [note["what"] for note in first["log"]][:3] == [note["what"] for note in other["log"]][:3]
    codes = [hub.do({"do": "continue"}, Cookie=cookie) for cookie in (hub.cookie, second[1])]
    assert codes[0] == 204 and codes[1] in (204, 409), "pressed on both"
    assert hub.ended() == 0 and hub.printed() == LINES
    assert hub.whats().count("continue") == hub.whats().count("moves") == 1


@pytest.mark.slow
def test_others_neither_see_nor_steer_it(hub: Hub) -> None:
    parts = urlsplit(hub.url)
    good = {"Cookie": hub.cookie, "Content-Type": "application/json"}
    for cookie in ("", "beadwise=", "beadwise=" + "x" * 43, hub.cookie + "x"):
        for path in ("", "events", "page.js", "common.js", "page.css", "common.css"):
            assert hub.get(path, headers={"Cookie": cookie}) == 403
        assert hub.do({"do": "stop"}, Cookie=cookie) == 403
    for wrong in ({"Origin": "http://evil.example"}, {"Host": "evil.example"}, {"Sec-Fetch-Site": "cross-site"}):
        assert hub.do({"do": "stop"}, **wrong) == 403
    assert hub.get("do", "POST", '{"do": "stop"}', good | {"Content-Type": "text/plain"}) == 415
    for body in ('{"do": "M112"}', "", "[", '{"do": "reprime", "mm": 1e9, "mm_s": 5}', '{"do": "stop", "why": "so"}'):
        assert hub.get("do", "POST", body, good) == 400
    assert hub.get("../do", "POST", '{"do": "stop"}', good) == 404
    connection = HTTPConnection(parts.hostname or "", parts.port, timeout=10)
    connection.request("GET", "/enter/" + "x" * 43)
    assert connection.getresponse().status == 403
    connection.close()
    assert hub.ended() == 0 and hub.printed() == LINES, "all of that changed nothing"


def test_a_port_that_is_taken(files: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Told before anything is sent."""
    with (
        start(read=reader(program(LINES)), access=Access(password=PASSWORD), board_tool=0) as machine,
        socket.create_server(("127.0.0.1", 0)) as taken,
    ):
        ends = [f"{host}:{port}" for host, port in (machine.rws, machine.board)]
        words = [str(files), "--controller", ends[0], "--head", ends[1], "--page", "--no-browser", "--page-port"]
        assert command.main([*words, str(taken.getsockname()[1])]) == 2
        assert "--page-port: cannot listen on port" in capsys.readouterr().err
        assert machine.state() is None and machine.controller.files() == []
    with pytest.raises(SystemExit) as stopped:
        command.main([*words, "70000"])
    assert stopped.value.code == 2


def test_what_is_shown_of_lines() -> None:
    beads = (-1, 4, 4, 5, -1, 6)
    lines = ProgramLines(
        "Cup", tuple(ProgramLine(n, b, max(b, 4) // 5, 1.0 * n, "M83") for n, b in enumerate(beads, 1))
    )
    found = spans(lines, lambda line: line.bead)
    assert {bead: (span.first, span.last) for bead, span in found.items()} == {4: (2, 3), 5: (4, 4), 6: (6, 6)}
    assert part_of(lines, found, 4, 2) == {"n": 4, "first": 4, "last": 6, "share": 0.0}
    assert part_of(lines, found, 5, 5) == {"n": 5, "first": 4, "last": 6, "share": 1.0}
    assert part_of(lines, found, None, 0) is None
    whats = [line["what"] for line in near_lines(lines, 5, 4, 3)]
    assert whats == ["taken", "taken", "taken", "at the board", "waits here", "to come"]


@pytest.mark.slow
@pytest.mark.skipif(CHROMIUM is None, reason="there is no Chromium on this computer")
def test_the_page_in_a_browser(hub: Hub) -> None:
    """Buttons are grey where they have no effect; a reload loses nothing; it fits a phone."""
    sync_api = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    with sync_api.sync_playwright() as running:
        browser = running.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        wrong: list[str] = []
        page = browser.new_page(viewport={"width": 390, "height": 844})
        page.on("pageerror", lambda error: wrong.append(str(error)))
        page.goto(hub.address)
        page.locator("#word", has_text="Running").wait_for()

        def enabled() -> list[str]:
            return [name for name in ("pause", "jam", "reprime", "continue", "stop") if page.is_enabled(f"#{name}")]

        assert enabled() == ["pause", "jam", "stop"]
        page.click("#pause")
        page.locator("#reprime:not([disabled])").wait_for()
        page.reload()
        page.locator("#word", has_text="Paused").wait_for()
        assert enabled() == ["reprime", "continue", "stop"]
        assert page.inner_text("#reason") == "paused on the page"
        assert page.evaluate("document.documentElement.scrollWidth") <= 390
        page.fill("#mm", "900")
        page.click("#reprime")
        assert page.evaluate("document.getElementById('mm').validity.rangeOverflow"), "no such length is asked for"
        page.fill("#mm", "2")
        page.click("#reprime")
        page.locator("#log td", has_text="reprimed").wait_for()
        page.click("#continue")
        page.locator("#word", has_text="Done").wait_for()
        browser.close()
    assert hub.ended() == 0 and not wrong and hub.printed() == LINES
    assert "G1 E2.000 F300.000" in [gcode for n, gcode in hub.machine.board_record().accepted if n is None]
