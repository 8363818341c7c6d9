"""A run as a page in the browser: what the terminal shows, and buttons for the user's orders."""

from __future__ import annotations

import asyncio
import json
import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from datetime import datetime
from typing import Any

from planner.base.errors import PlannerError
from planner.base.web.server import NO_ORDER, NOT_NOW, TAKEN, News, PageSite, Server, listen
from planner.link.orders import LENGTHS_MM, PRIME_MM, PRIME_MM_S, SPEEDS_MM_S, Order, order_in_json
from planner.link.program_lines import NO_BEAD, ProgramLine, ProgramLines
from planner.link.relay import LogNote
from planner.link.telling import RunProgress, duration

# ----------------------------------------------------------------------------------------------------
# The page's state: one value, sent whole whenever something changes.

LINES_BEFORE, LINES_AFTER = 4, 8  # lines of the program shown around the one at the board
MOST_LOGGED = 200  # log entries shown; the file has all
PREPARING, DONE, STOPPED = "preparing", "done", "stopped"
_UNSHOWN = {"received", "sent", "acknowledged", "plan"}  # records already shown by the lines, and the plan itself
_LIMITS = {"mm": PRIME_MM, "mm_s": PRIME_MM_S, "mm_limits": LENGTHS_MM, "mm_s_limits": SPEEDS_MM_S}


@dataclass(frozen=True)
class RunSpan:
    """First and last line of a bead or layer."""

    first: int
    last: int


def spans(lines: ProgramLines, of: Callable[[ProgramLine], int]) -> dict[int, RunSpan]:
    """The lines of each bead, or of each layer; lines that belong to no bead are left out."""
    out: dict[int, RunSpan] = {}
    for line in lines.lines:
        if line.bead != NO_BEAD:
            key = of(line)
            out[key] = RunSpan(out[key].first if key in out else line.n, line.n)
    return out


def part_of(lines: ProgramLines, where: Mapping[int, RunSpan], key: int | None, n: int) -> dict[str, Any] | None:
    """The bead or layer of line n: its number, the first and last number of the print, and the share that is done."""
    if key is None:
        return None
    span = where[key]
    begun, over, here = (lines[k].t for k in (span.first, span.last, min(max(n, span.first), span.last)))
    share = (here - begun) / (over - begun) if over > begun else float(n >= span.last)
    return {"n": key, "first": min(where), "last": max(where), "share": round(share, 4)}


def near_lines(lines: ProgramLines, received: int, sent: int, acknowledged: int) -> list[dict[str, Any]]:
    """Lines around the one at the board, with the state of each."""
    out = []
    for n in range(max(1, acknowledged + 1 - LINES_BEFORE), min(len(lines), acknowledged + 1 + LINES_AFTER) + 1):
        what = (
            "taken"
            if n <= acknowledged
            else "at the board"
            if n <= sent
            else "waits here"
            if n <= received
            else "to come"
        )
        out.append({"n": n, "text": lines[n].text, "what": what})
    return out


# ----------------------------------------------------------------------------------------------------
# The page, served from a separate thread: the run does not wait for it, and continues without it.

LAST_TIME = 0.5  # s for pages to receive the final state


class HubPage:
    """A run's page; its methods may be called from any thread.

    ask  is called with the orders of the page's buttons
    """

    def __init__(self, lines: ProgramLines, problem: str, port: int, ask: Callable[[Order], None]) -> None:
        """Raises InputError if the port is in use."""
        self._lines, self._problem, self._ask = lines, problem, ask
        self._beads, self._layers = spans(lines, lambda line: line.bead), spans(lines, lambda line: line.layer)
        self._log: deque[dict[str, Any]] = deque(maxlen=MOST_LOGGED)
        self._lock = threading.Lock()
        self._run: dict[str, Any] = {"state": PREPARING, "reason": "", "may": [], "share": 0.0, "left": "", "lines": []}
        self._may: frozenset[str] = frozenset()
        self._news = News()
        self._ready = threading.Event()
        where = listen(port, "--page-port")
        self._thread = threading.Thread(target=lambda: asyncio.run(self._serve(where)), name="page", daemon=True)
        self._thread.start()
        self._ready.wait()

    @property
    def address(self) -> str:
        """The address that admits browsers for as long as the page exists."""
        return self._server.address

    def address_once(self) -> str:
        """An address that admits one browser, for a short time from now."""
        return self._server.address_once()

    def show(self, now: RunProgress) -> None:
        """Show the progress of the run."""
        status = now.status
        bead = next((self._lines[k] for k in range(status.acknowledged, 0, -1) if self._lines[k].bead != NO_BEAD), None)
        key = (None, None) if bead is None else (bead.bead, bead.layer)
        n = status.acknowledged
        self._may = status.may
        self._tell(
            {
                "state": status.state.value,
                "reason": status.reason,
                "may": sorted(status.may),
                "share": round(now.share, 4),
                "left": duration(now.left),
                "line": n,
                "bead": part_of(self._lines, self._beads, key[0], n),
                "layer": part_of(self._lines, self._layers, key[1], n),
                "lines": near_lines(self._lines, status.received, status.sent, n),
            }
        )

    def log(self, notes: Iterable[LogNote]) -> None:
        """Add records of the log; they are shown with the next change."""
        for note in notes:
            if note.what not in _UNSHOWN:
                self._add(note.what, note.n, note.text)

    def say(self, text: str) -> None:
        """Show a message of the terminal."""
        self._add("", 0, text)
        self._tell({})

    def end(self, verdict: str, texts: Iterable[str]) -> None:
        """End the run as DONE or STOPPED, with a report."""
        self._may = frozenset()
        self._tell({"state": verdict, "reason": "\n".join(texts), "may": []})

    def close(self) -> None:
        """Send pages the final state, and stop serving."""
        with suppress(RuntimeError):  # the thread may have ended
            self._loop.call_soon_threadsafe(self._over.set)
        self._thread.join(2.0 * LAST_TIME + 1.0)

    def _add(self, what: str, n: int, text: str) -> None:
        with self._lock:
            self._log.append({"at": f"{datetime.now():%H:%M:%S}", "what": what, "n": n, "text": text})

    def _tell(self, changed: dict[str, Any]) -> None:
        with self._lock:
            self._run |= changed
            title = {"title": self._lines.module, "problem": self._problem, "of": len(self._lines), "prime": _LIMITS}
            text = json.dumps(title | self._run | {"log": list(self._log)}, separators=(",", ":"))
        with suppress(RuntimeError):
            self._loop.call_soon_threadsafe(self._news.tell, text)

    def _take(self, body: bytes) -> int:
        order = order_in_json(body)
        if order is None:
            return NO_ORDER
        if order[0] not in self._may:
            return NOT_NOW
        self._ask(order[1])
        return TAKEN

    async def _serve(self, where: Any) -> None:
        self._loop, self._over = asyncio.get_running_loop(), asyncio.Event()
        self._server = Server(where, PageSite("page of the run", "planner.link", self._news, self._take))
        self._ready.set()
        await self._over.wait()
        await asyncio.sleep(LAST_TIME)
        await self._server.close()


@contextmanager
def hub_page(lines: ProgramLines, problem: str, port: int, ask: Callable[[Order], None]) -> Iterator[HubPage]:
    """A page for the duration of a block; it reports what ended that early. Raises InputError if the port is in use."""
    page = HubPage(lines, problem, port, ask)
    try:
        page.say("the page is there")
        yield page
    except PlannerError as error:
        page.end(STOPPED, [str(error)])
        raise
    except KeyboardInterrupt:
        page.end(STOPPED, ["interrupted"])
        raise
    finally:
        page.close()
