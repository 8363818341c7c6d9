"""A web server for one page on this computer: its files, updates to it, and the user's requests."""

from __future__ import annotations

import asyncio
import secrets
import socket
import time
from collections.abc import Awaitable, Callable
from contextlib import suppress
from dataclasses import dataclass
from importlib.resources import files
from typing import Any

from tornado.httpserver import HTTPServer
from tornado.iostream import StreamClosedError
from tornado.web import Application, HTTPError, RequestHandler

from planner.base.errors import InputError
from planner.base.web.door import Door

# It listens on this computer only. A browser gets in with an address that contains a secret word, which is exchanged
# for a cookie (see `door`). The cookie is limited to the page's own path, whose name is random: cookies ignore ports,
# and other servers on this computer must not get it. The Host header is checked, so that another site's name that
# resolves to this computer is of no use.

HOST = "127.0.0.1"
LARGEST_ORDER = 1_000  # bytes of a request from the page
MOST_LISTENERS = 20  # pages that receive updates
SILENCE_TIME = 10.0  # s without news after which a listener is sent a sign of life
IDLE_TIME = 30.0  # s without a complete request, or without a listener reading, after which a connection is closed
BODY_TIME = 5.0  # s to receive the body of a request
COOKIE = "beadwise"
SHARED = "planner.base.web"
ASSETS = {
    "": ("page.html", "text/html"),
    "page.css": ("page.css", "text/css"),
    "page.js": ("page.js", "text/javascript"),
    "common.css": ("common.css", "text/css"),
    "common.js": ("common.js", "text/javascript"),
}
PAGE_POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self'; frame-src 'self'; img-src data:; "
    "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
TAKEN, NO_ORDER, NOT_NOW = 204, 400, 409  # answers to the page's requests


class News:
    """The latest text for all listeners; a slow one misses what came in between, and nobody waits for it."""

    def __init__(self) -> None:
        self.text = "{}"
        self.listeners: set[asyncio.Event] = set()

    def tell(self, text: str) -> None:
        """Publish a new text."""
        self.text = text
        for listener in self.listeners:
            listener.set()


def listen(port: int, field: str) -> socket.socket:
    """A socket on the loopback address; port 0 takes a free one. Raises InputError if the port is taken.

    field  the option that set the port
    """
    made = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    made.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        made.bind((HOST, port))
        made.listen(64)
    except OSError as error:
        made.close()
        hint = f"give another, or leave {field} out to use a free one"
        raise InputError(f"cannot listen on port {port}: {error.strerror}", field=field, hint=hint) from error
    made.setblocking(False)
    return made


@dataclass(frozen=True)
class PageSite:
    """What a server shows.

    name     in words, such as "live view"
    package  holds its page.html, page.css and page.js; common.css and common.js are next to this module
    news     what the page receives: one JSON value, complete, whenever something has changed
    take     handles a request from the page, as received; returns TAKEN, NO_ORDER or NOT_NOW
    routes   further handlers below the page's path: pattern, class (an `Inside`), and what it gets as `more`
    """

    name: str
    package: str
    news: News
    take: Callable[[bytes], int]
    routes: tuple[tuple[str, type[RequestHandler], dict[str, Any]], ...] = ()


class Server:
    """Serves one site on a socket until it is closed."""

    def __init__(self, where: socket.socket, site: PageSite) -> None:
        port = where.getsockname()[1]
        self._door, self._origin = Door(), f"http://{HOST}:{port}"
        root = f"/{secrets.token_urlsafe(16)}/"
        shared = {"visit": _Visit({f"{HOST}:{port}", f"localhost:{port}"}, root, self._door, site)}
        routes: list[Any] = [
            (r"/enter/([A-Za-z0-9_-]{1,100})", _Enter, shared),
            (root + "events", _Events, shared),
            (root + "do", _Do, shared),
            *((root + pattern, handler, shared | more) for pattern, handler, more in site.routes),
            (root + r"(|page\.css|page\.js|common\.css|common\.js)", _Asset, shared),
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
        """Lets browsers in as long as the server runs. Not for arguments of programs, which all users can read."""
        return f"{self._origin}/enter/{self._door.key}"

    def address_once(self) -> str:
        """Lets one browser in, for a short time from now."""
        return f"{self._origin}/enter/{self._door.code(time.monotonic())}"

    async def close(self) -> None:
        """Stop serving, and close all connections."""
        self._server.stop()
        await self._server.close_all_connections()


@dataclass(frozen=True)
class _Visit:
    """What every request needs: this server's host names, the page's path, the door, and the site."""

    hosts: set[str]
    root: str
    door: Door
    site: PageSite


def _quiet(handler: RequestHandler) -> None:
    """Requests are not logged."""


class _Open(RequestHandler):
    """For anybody who calls this server by one of its own names."""

    def initialize(self, visit: _Visit, **more: Any) -> None:
        self._visit, self.site, self.more = visit, visit.site, more

    def prepare(self) -> None:
        if self.request.host not in self._visit.hosts:
            raise HTTPError(403)
        origin = self.request.headers.get("Origin")
        if origin is not None and origin.removeprefix("http://") not in self._visit.hosts:
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
        self.finish(f"{status_code}: nothing here; the address of the {self.site.name} is shown in the terminal\n")


class _Enter(_Open):
    """Exchanges a word for a cookie.

    The page moves on by itself: an HTTP redirect that started on another site, such as a terminal in a browser, would
    not carry the cookie.
    """

    def get(self, word: str) -> None:
        session = self._visit.door.enter(word, time.monotonic())
        if session is None:
            raise HTTPError(403)
        root, name = self._visit.root, self.site.name
        self.set_header("Set-Cookie", f"{COOKIE}={session}; Path={root}; HttpOnly; SameSite=Strict")
        self.set_header("Content-Type", "text/html; charset=utf-8")
        self.finish(
            f'<!doctype html><title>{name.capitalize()}</title><meta http-equiv=refresh content="0; url={root}">'
            f'<a href="{root}">To the {name}</a>\n'  # for browsers that do not move on by themselves
        )


class Inside(_Open):
    """For browsers that were let in, and requests from the page itself."""

    def prepare(self) -> None:
        super().prepare()
        # pages of other servers on this computer count as the same site, and so get past SameSite
        if self.request.headers.get("Sec-Fetch-Site", "none") not in ("none", "same-origin"):
            raise HTTPError(403)
        if not self._visit.door.knows(self.get_cookie(COOKIE, "") or ""):
            raise HTTPError(403)

    async def in_time(self, sending: Awaitable[None], seconds: float) -> bool:
        """Whether the data was taken in time [s]; closes the connection if not."""
        try:
            await asyncio.wait_for(sending, seconds)
        except TimeoutError:
            self.detach().close()
            return False
        return True


class _Nothing(_Open):
    def prepare(self) -> None:
        raise HTTPError(404)


class _Asset(Inside):
    def get(self, name: str) -> None:
        file, kind = ASSETS[name]
        package = SHARED if name.startswith("common") else self.site.package
        self.set_header("Content-Type", f"{kind}; charset=utf-8")
        self.finish(files(package).joinpath(file).read_bytes())


class _Events(Inside):
    def initialize(self, visit: _Visit, **more: Any) -> None:
        super().initialize(visit, **more)
        self._woken = asyncio.Event()

    async def get(self) -> None:
        listeners = self.site.news.listeners
        if len(listeners) >= MOST_LISTENERS:
            raise HTTPError(503)
        self.set_header("Content-Type", "text/event-stream")
        listeners.add(self._woken)
        try:
            with suppress(StreamClosedError):
                while True:
                    self._woken.clear()
                    self.write(f"data: {self.site.news.text}\n\n")
                    if not (await self.in_time(self.flush(), IDLE_TIME) and await self._changed()):
                        return
        finally:
            listeners.discard(self._woken)

    async def _changed(self) -> bool:
        """Wait until there is something new; False if the listener has gone."""
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


class _Do(Inside):
    def post(self) -> None:
        # other sites cannot send this type without asking first (CORS)
        if self.request.headers.get("Content-Type") != "application/json":
            raise HTTPError(415)
        answer = self.site.take(self.request.body)
        if answer != TAKEN:
            raise HTTPError(answer)
        self.set_status(answer)
        self.finish()
