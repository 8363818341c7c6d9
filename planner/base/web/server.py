"""A web server for one page on this computer: its files, what it is told, and what the user asks for."""

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

# It listens on this computer only. A browser is let in by an address with a word that others cannot know, which is
# exchanged for a cookie (see `door`). The cookie goes to the page's own place only, whose name is drawn, for cookies do
# not know ports: other servers of this computer must not get it. The Host is checked, so that no name of another site
# that points here helps.

HOST = "127.0.0.1"
LARGEST_ORDER = 1_000  # bytes of what the page may ask for
MOST_LISTENERS = 20  # pages that are told of changes
SILENCE_TIME = 10.0  # s after which a listener is told that the server is still there
IDLE_TIME = 30.0  # s without a whole request, or without a listener's reading, after which a connection ends
BODY_TIME = 5.0  # s for what is asked for
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
TAKEN, NO_ORDER, NOT_NOW = 204, 400, 409  # answers to what the page asks for


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


def listen(port: int, field: str) -> socket.socket:
    """A socket on this computer's own address; port 0 takes a free one. Raises InputError where the port is taken.

    field  the option that gave the port
    """
    made = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    made.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        made.bind((HOST, port))
        made.listen(64)
    except OSError as error:
        made.close()
        hint = f"give another one, or leave {field} out to have a free one"
        raise InputError(f"cannot listen on port {port}: {error.strerror}", field=field, hint=hint) from error
    made.setblocking(False)
    return made


@dataclass(frozen=True)
class PageSite:
    """What a server shows.

    name     in words, such as "live view"
    package  that holds its page.html, page.css and page.js; common.css and common.js stand beside this module
    news     what the page is told: one value as JSON, whole, whenever something changed
    take     gets an order of the page, as it came, and answers TAKEN, NO_ORDER or NOT_NOW
    routes   more handlers below the page's place: pattern, class (an `Inside`), what it finds as `more`
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
        """Lets browsers in as long as the server is there. Not for arguments of programs: all users can read them."""
        return f"{self._origin}/enter/{self._door.key}"

    def address_once(self) -> str:
        """Lets one browser in, for a short time from now on."""
        return f"{self._origin}/enter/{self._door.code(time.monotonic())}"

    async def close(self) -> None:
        """Nobody is served any more."""
        self._server.stop()
        await self._server.close_all_connections()


@dataclass(frozen=True)
class _Visit:
    """What all requests need: names of this server, its place, who is in, and what it shows."""

    hosts: set[str]
    root: str
    door: Door
    site: PageSite


def _quiet(handler: RequestHandler) -> None:
    """Requests are not logged."""


class _Open(RequestHandler):
    """For whoever comes to an address of this server, by one of its names."""

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
        self.finish(f"{status_code}: nothing here; the address of the {self.site.name} stands in the terminal\n")


class _Enter(_Open):
    """Exchanges a word for a cookie. The page moves on by itself: a redirection that a page of another site began, such as
    a terminal in a browser, would not carry the cookie.
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
    """For whoever was let in, from the page itself."""

    def prepare(self) -> None:
        super().prepare()
        # pages of other servers of this computer are of the same site, and so get past SameSite
        if self.request.headers.get("Sec-Fetch-Site", "none") not in ("none", "same-origin"):
            raise HTTPError(403)
        if not self._visit.door.knows(self.get_cookie(COOKIE, "") or ""):
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


class _Do(Inside):
    def post(self) -> None:
        if self.request.headers.get("Content-Type") != "application/json":  # which no other site may send unasked
            raise HTTPError(415)
        answer = self.site.take(self.request.body)
        if answer != TAKEN:
            raise HTTPError(answer)
        self.set_status(answer)
        self.finish()
