"""The local web server of the view: the page, what it is told, and what the user asks for."""

from __future__ import annotations

import asyncio
import json
import secrets
import socket
import time
from collections.abc import Awaitable, Callable
from contextlib import suppress
from dataclasses import asdict, dataclass
from importlib.resources import files
from pathlib import Path
from typing import Any

from tornado.httpserver import HTTPServer
from tornado.iostream import StreamClosedError
from tornado.web import Application, HTTPError, RequestHandler

from planner.base.errors import InputError
from planner.base.progress import STAGES
from planner.problem.settings import STRATEGY_NAMES
from planner.view.door import Door
from planner.view.machine import (
    NONE,
    ROWS,
    Again,
    Beside,
    Choose,
    Drafts,
    Entry,
    Event,
    Result,
    View,
    difference,
    heading,
    verdict,
    written,
)

# ----------------------------------------------------------------------------------------------------
# What the page is told of the view: one value, whole, whenever something changed.

_SHOWN = ("start", *STAGES, "baseline", "report")


def snapshot(view: View, title: str, file: str) -> dict[str, Any]:
    """The view as plain values."""
    return {
        "title": title,
        "file": file,
        "solving": view.solving,
        "drafts": view.drafts,
        "strategies": list(STRATEGY_NAMES),
        "note": view.note,
        "mistake": None if view.mistake is None else asdict(view.mistake),
        "trouble": None if view.trouble is None else asdict(view.trouble),
        "panes": [_pane(view, strategy) for strategy in view.panes],
        "differences": differences(view),
        "history": {"columns": _columns(view), "rows": [_row(view, entry) for entry in reversed(view.history)]},
    }


def _pane(view: View, strategy: str) -> dict[str, Any]:
    job, result = view.running, view.results.get(strategy)
    running = None
    if job is not None and job.strategy == strategy:
        running = {
            "job": job.number,
            "stage": job.stage,
            "draft": job.draft,
            "done": _SHOWN.index(job.stage) / len(_SHOWN) if job.stage in _SHOWN else None,
        }
    waiting = view.solving and running is None and strategy not in view.tried and view.content is not None
    return {"strategy": strategy, "running": running, "waiting": waiting, "result": _result(view, result)}


def _result(view: View, result: Result | None) -> dict[str, Any] | None:
    if result is None:
        return None
    outcome = result.outcome
    return {
        "key": result.key,
        "kind": outcome.kind,
        "words": outcome.words,
        "draft": outcome.draft,
        "old": result.turn != view.turn or view.mistake is not None or view.trouble is not None,
    }


def differences(view: View) -> list[dict[str, str]]:
    """Key figures of two panes side by side; none where there are not two whole plans of the same files."""
    if len(view.panes) < 2:
        return []
    pair = [view.results.get(strategy) for strategy in view.panes]
    sides = [dict(each.outcome.figures) for each in pair if each is not None and not each.outcome.draft]
    if len(sides) < 2 or not all(sides) or len({each.turn for each in pair if each is not None}) > 1:
        return []
    rows = []
    for row in ROWS:
        left, right = (side.get(row.key) for side in sides)
        if left is None and right is None:
            continue
        better = {"better": "left", "worse": "right"}.get(verdict(row, left, right), "")
        rows.append(
            {
                **heading(row),
                "left": written(row, left),
                "right": written(row, right),
                "difference": difference(row, right, left),
                "better": better,
            }
        )
    return rows


def _shown_keys(view: View) -> list[str]:
    present = {name for entry in view.history for name, _ in entry.outcome.figures}
    return [row.key for row in ROWS if row.key in present]


def _columns(view: View) -> list[dict[str, str]]:
    keys = _shown_keys(view)
    return [heading(row) for row in ROWS if row.key in keys]


def _row(view: View, entry: Entry) -> dict[str, Any]:
    keys = _shown_keys(view)
    now, before = dict(entry.outcome.figures), dict(entry.before)
    cells = []
    for row in ROWS:
        if row.key not in keys:
            continue
        value, old = now.get(row.key), before.get(row.key)
        change = difference(row, value, old)
        cells.append(
            {
                "text": written(row, value),
                "change": "" if change in (NONE, "0") else change,
                "verdict": verdict(row, value, old),
            }
        )
    return {
        "number": entry.number,
        "at": entry.at,
        "strategy": entry.strategy,
        "kind": entry.outcome.kind,
        "words": entry.outcome.words,
        "changes": None if entry.changes is None else list(entry.changes),
        "cells": cells,
    }


# ----------------------------------------------------------------------------------------------------
# The local web server of the view: the page, what it is told, and what the user asks for.
#
# It listens on this computer only. A browser is let in by an address with a word that others cannot know, which is
# exchanged for a cookie (see `door`). The cookie goes to the view's own place only, whose name is drawn, for cookies do
# not know ports: other servers of this computer must not get it. The Host is checked, so that no name of another site
# that points here helps, and reports are shown in a sandbox without an origin.

HOST = "127.0.0.1"
LARGEST_ORDER = 1_000  # bytes of what the page may ask for
LARGEST_REPORT = 100_000_000  # bytes; a report has 15 MB at most
MOST_LISTENERS = 20  # pages that are told of changes
SILENCE_TIME = 10.0  # s after which a listener is told that the view is still there
IDLE_TIME = 30.0  # s without a whole request, or without a listener's reading, after which a connection ends
BODY_TIME = 5.0  # s for what is asked for
SENDING_TIME = 120.0  # s for an answer; a report goes through a slow tunnel meanwhile
COOKIE = "beadwise-view"
ASSETS = {
    "": ("page.html", "text/html"),
    "page.css": ("page.css", "text/css"),
    "page.js": ("page.js", "text/javascript"),
}
PAGE_POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self'; frame-src 'self'; img-src data:; "
    "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
# A report from elsewhere must not steer the view: it has no origin, and reaches no address.
REPORT_POLICY = (
    "sandbox allow-scripts allow-downloads; default-src 'none'; script-src 'unsafe-inline' 'wasm-unsafe-eval' blob:; "
    "style-src 'unsafe-inline'; img-src data: blob:; font-src data:; worker-src blob:; frame-ancestors 'self'"
)


class News:
    """The newest text for all listeners; one that is slow misses what came between, and nobody waits for it."""

    def __init__(self) -> None:
        self.text = "{}"
        self.listeners: set[asyncio.Event] = set()

    def tell(self, text: str) -> None:
        """There is something new."""
        self.text = text
        for listener in self.listeners:
            listener.set()


def listen(port: int) -> socket.socket:
    """A socket on this computer's own address; port 0 takes a free one. Raises InputError where the port is taken."""
    made = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    made.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        made.bind((HOST, port))
        made.listen(64)
    except OSError as error:
        made.close()
        hint = "give another one, or leave --port out to have a free one"
        raise InputError(f"cannot listen on port {port}: {error.strerror}", field="--port", hint=hint) from error
    made.setblocking(False)
    return made


class Server:
    """Serves one view on a socket until it is closed."""

    def __init__(
        self, where: socket.socket, news: News, report: Callable[[str], Path | None], take: Callable[[Event], None]
    ) -> None:
        port = where.getsockname()[1]
        self._door, self._origin = Door(), f"http://{HOST}:{port}"
        root = f"/{secrets.token_urlsafe(16)}/"
        hosts = {f"{HOST}:{port}", f"localhost:{port}"}
        shared = {"view": _Shared(hosts, root, self._door, news, report, take)}
        routes: list[Any] = [
            (r"/enter/([A-Za-z0-9_-]{1,100})", _Enter, shared),
            (root + "events", _Events, shared),
            (root + r"report/([0-9]{1,9}-(?:draft|whole|folder))", _Report, shared),
            (root + "do", _Do, shared),
            (root + r"(|page\.css|page\.js)", _Asset, shared),
        ]
        application = Application(
            routes, default_handler_class=_Nothing, default_handler_args=shared, log_function=_quiet
        )
        self._server = HTTPServer(
            application, max_body_size=LARGEST_ORDER, max_header_size=16_384,
            idle_connection_timeout=IDLE_TIME, body_timeout=BODY_TIME,
        )  # fmt: skip
        self._server.add_socket(where)

    @property
    def address(self) -> str:
        """Lets browsers in as long as the view is there. Not for arguments of programs: all users can read them."""
        return f"{self._origin}/enter/{self._door.key}"

    def address_once(self) -> str:
        """Lets one browser in, for a short time from now on."""
        return f"{self._origin}/enter/{self._door.code(time.monotonic())}"

    async def close(self) -> None:
        """Nobody is served any more."""
        self._server.stop()
        await self._server.close_all_connections()


@dataclass(frozen=True)
class _Shared:
    """What all requests need: names of this server, its place, who is in, what is new, reports, and who takes orders."""

    hosts: set[str]
    root: str
    door: Door
    news: News
    report: Callable[[str], Path | None]
    take: Callable[[Event], None]


def _quiet(handler: RequestHandler) -> None:
    """Requests are not logged."""


class _Open(RequestHandler):
    """For whoever comes to an address of this server, by one of its names."""

    def initialize(self, view: _Shared) -> None:
        self._view = view

    def prepare(self) -> None:
        if self.request.host not in self._view.hosts:
            raise HTTPError(403)
        origin = self.request.headers.get("Origin")
        if origin is not None and origin.removeprefix("http://") not in self._view.hosts:
            raise HTTPError(403)

    def set_default_headers(self) -> None:
        self.set_header("Server", "beadwise")
        self.set_header("Cache-Control", "no-store")
        self.set_header("Referrer-Policy", "no-referrer")
        self.set_header("X-Content-Type-Options", "nosniff")
        self.set_header("Cross-Origin-Resource-Policy", "same-origin")
        self.set_header("Content-Security-Policy", PAGE_POLICY)

    def write_error(self, status_code: int, **_: Any) -> None:
        self.set_header("Content-Type", "text/plain; charset=utf-8")
        self.finish(f"{status_code}: nothing here; the view's address stands in the terminal\n")


class _Enter(_Open):
    """Exchanges a word for a cookie. The page moves on by itself: a redirection that a page of another site began, such as
    a terminal in a browser, would not carry the cookie.
    """

    def get(self, word: str) -> None:
        session = self._view.door.enter(word, time.monotonic())
        if session is None:
            raise HTTPError(403)
        root = self._view.root
        self.set_header("Set-Cookie", f"{COOKIE}={session}; Path={root}; HttpOnly; SameSite=Strict")
        self.set_header("Content-Type", "text/html; charset=utf-8")
        self.finish(
            f'<!doctype html><title>Live view</title><meta http-equiv=refresh content="0; url={root}">'
            f'<a href="{root}">To the live view</a>\n'  # for browsers that do not move on by themselves
        )


class _ViewHandler(_Open):
    """For whoever was let in, from the view's own page."""

    def prepare(self) -> None:
        super().prepare()
        # pages of other servers of this computer are of the same site, and so get past SameSite
        if self.request.headers.get("Sec-Fetch-Site", "none") not in ("none", "same-origin"):
            raise HTTPError(403)
        if not self._view.door.knows(self.get_cookie(COOKIE, "") or ""):
            raise HTTPError(403)

    async def in_time(self, sending: Awaitable[None], seconds: float) -> bool:
        """Whether somebody took what is sent; ends the connection where nobody did within a time [s]."""
        try:
            await asyncio.wait_for(sending, seconds)
        except TimeoutError:
            self.detach().close()
            return False
        return True


class _Nothing(_Open):
    def prepare(self) -> None:
        raise HTTPError(404)


class _Asset(_ViewHandler):
    def get(self, name: str) -> None:
        file, kind = ASSETS[name]
        self.set_header("Content-Type", f"{kind}; charset=utf-8")
        self.finish(files("planner.view").joinpath(file).read_bytes())


class _Report(_ViewHandler):
    async def get(self, key: str) -> None:
        path = self._view.report(key)
        data = None if path is None else await asyncio.to_thread(_bytes_of, path)
        if data is None:
            raise HTTPError(404)
        self.set_header("Content-Security-Policy", REPORT_POLICY)
        self.set_header("Content-Type", "text/html; charset=utf-8")
        await self.in_time(self.finish(data), SENDING_TIME)


def _bytes_of(path: Path) -> bytes | None:
    try:
        with path.open("rb") as stream:
            data = stream.read(LARGEST_REPORT + 1)
    except OSError:
        return None  # removed meanwhile, for a newer one
    return data if len(data) <= LARGEST_REPORT else None


class _Events(_ViewHandler):
    def initialize(self, view: _Shared) -> None:
        super().initialize(view)
        self._woken = asyncio.Event()

    async def get(self) -> None:
        listeners = self._view.news.listeners
        if len(listeners) >= MOST_LISTENERS:
            raise HTTPError(503)
        self.set_header("Content-Type", "text/event-stream")
        listeners.add(self._woken)
        try:
            with suppress(StreamClosedError):
                while True:
                    self._woken.clear()
                    self.write(f"data: {self._view.news.text}\n\n")
                    if not (await self.in_time(self.flush(), IDLE_TIME) and await self._changed()):
                        return
        finally:
            listeners.discard(self._woken)

    async def _changed(self) -> bool:
        """Wait until there is something new; False where nobody reads any more."""
        while True:
            try:
                await asyncio.wait_for(self._woken.wait(), SILENCE_TIME)
                return True
            except TimeoutError:
                self.write(": still here\n\n")
                if not await self.in_time(self.flush(), IDLE_TIME):
                    return False

    def on_connection_close(self) -> None:
        self._woken.set()  # the next flush finds nobody there


class _Do(_ViewHandler):
    def post(self) -> None:
        if self.request.headers.get("Content-Type") != "application/json":  # which no other site may send unasked
            raise HTTPError(415)
        event = order_of(self.request.body)
        if event is None:
            raise HTTPError(400)
        self._view.take(event)
        self.set_status(204)
        self.finish()


def order_of(body: bytes) -> Event | None:
    """What the page asks for; None where it is nothing that can be asked for."""
    try:
        order = json.loads(body)
    except (ValueError, RecursionError):
        return None
    match order:
        case {"do": "choose", "pane": int(pane), "strategy": str(strategy), **rest} if not rest and _known(strategy):
            return Choose(pane, strategy)
        case {"do": "beside", "strategy": str(strategy), **rest} if not rest and _known(strategy):
            return Beside(strategy)
        case {"do": "beside", "strategy": None, **rest} if not rest:
            return Beside(None)
        case {"do": "drafts", "wanted": bool(wanted), **rest} if not rest:
            return Drafts(wanted)
        case {"do": "again", **rest} if not rest:
            return Again()
        case _:
            return None


def _known(strategy: str) -> bool:
    return strategy in STRATEGY_NAMES
