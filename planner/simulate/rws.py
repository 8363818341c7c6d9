"""Robot Web Services, limited to what a client needs to upload a program to a controller, start it and monitor it.

Written from ABB's references (developercenter.robotstudio.com: api/rwsApi for 1.0, api/RWS for 2.0) and users' reports
of real controllers. If strict, it refuses everything these do not offer; if lenient, it does what it can understand.

1.0 as on IRC5: digest authentication, `?action=`, XHTML or, for `?json=1`, JSON; rapid mastership for loading. 2.0 as on
OmniCore: basic authentication, actions as paths, edit mastership, `;v=2.0` in the content types.
"""

from __future__ import annotations

import base64
import hashlib
import hmac
import html
import json
import re
import secrets
import ssl
import threading
import time
from collections import OrderedDict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from email.message import Message
from functools import partial
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any
from urllib.parse import parse_qs, unquote, urlsplit
from urllib.request import parse_http_list, parse_keqv_list

from planner.base.errors import InputError
from planner.simulate.board import Fault, Faults, faults_of
from planner.simulate.controller import LARGEST_FILE, TASK, Controller, Denied
from planner.simulate.web_socket import CLOSE, PING, PONG, TEXT, SocketClosed, WebSocket, accepted

REALM = "validusers@robapi.abb"
USER = "Default User"  # ABB's, on every new controller
REFUSED = -1073442816  # the code of every refusal; clients must go by the HTTP status
LONGEST_FORM = 4096  # bytes
PATIENCE = 30.0  # s without a request, or a message on a subscription, after which the connection is closed
MOST_NONCES = 200  # valid for digests; a client with an older one is challenged again
MOST_COUNT = 0xFFFFFFFF
MOST_SESSIONS = 70  # as on an IRC5; 503 beyond
FORM = {1: "application/x-www-form-urlencoded", 2: "application/x-www-form-urlencoded;v=2.0"}
FILES_V2 = ("application/octet-stream;v=2.0", "text/plain;v=2.0")
ACCEPT_V2 = ("application/hal+json;v=2.0", "application/xhtml+xml;v=2.0")
SUBPROTOCOL = {1: "robapi2_subscription", 2: "rws_subscription"}
COOKIE = "-http-session-"
EXECUTION = "/rw/rapid/execution;ctrlexecstate"
LOOK = 0.02  # s between checks of the execution state for subscribers
START = ("regain", "execmode", "cycle", "condition", "stopatbp", "alltaskbytsp")  # all required

# Faults at a request, counted from the first authorised one.
RWS_FAULTS = {
    "refuse": "answers the request with 403, and does nothing",
    "error": "answers the request with 500, and does nothing",
    "broken": "does what was asked for, but answers 500",
    "login": "answers the request with 401, as for a password that was changed",
    "busy": "answers the request with 503, and does nothing",
    "drop": "closes the connection instead of doing it",
    "lose": "does what was asked for, and closes the connection without an answer",
    "slow": "answers the request VALUE seconds late",
    "drip": "answers the request a byte at a time, VALUE seconds apart",
    "garbage": "answers the request with bytes that are not HTTP",
    "nonsense": "answers the request with text of another kind",
    "deaf": "closes the subscription when the request comes",
}
STATUS = {"refuse": 403, "error": 500, "login": 401, "busy": 503}
GARBAGE = b"\x00\xfeRWS\x81 ?\r\n\r\n"

Form = Mapping[str, str]


@dataclass(frozen=True)
class Access:
    """User, password, version of the services, and strictness. certificate, key: PEM files for https; without, http."""

    user: str = USER
    password: str = "robotics"  # ABB's, on every new controller
    version: int = 1
    certificate: Path | None = None
    key: Path | None = None
    strict: bool = True


class _Server(ThreadingHTTPServer):
    daemon_threads = True

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Ignore clients that leave in the middle of an answer."""


class RwsServer:
    """Serves a controller, in separate threads. requests: all authorised ones, as `POST /path?query`."""

    def __init__(
        self, host: str, port: int, controller: Controller, access: Access, faults: Sequence[Fault] = ()
    ) -> None:
        self._desk = desk = _Desk(controller, access, faults)

        class Handler(_RwsConnection):
            the_desk = desk

        try:
            self._server = _Server((host, port), Handler)
        except OSError as error:
            raise InputError(f"cannot listen on {host}:{port}: {error.strerror or error}", field="--port") from error
        if access.certificate is not None:
            context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
            try:
                context.load_cert_chain(access.certificate, access.key)
            except OSError as error:
                self._server.server_close()
                raise InputError("no certificate and key to be read", file=access.certificate) from error
            # each connection's own thread does the handshake, so that an unfinished one holds up nobody else
            self._server.socket = context.wrap_socket(
                self._server.socket, server_side=True, do_handshake_on_connect=False
            )
        self.address: tuple[str, int] = self._server.server_address[:2]  # type: ignore[assignment]
        self._thread = threading.Thread(target=self._server.serve_forever, args=(0.05,), name="rws", daemon=True)
        self._thread.start()

    def requests(self) -> list[str]:
        """The authorised requests so far."""
        return list(self._desk.asked)

    def inject(self, *words: str) -> None:
        """Add faults such as `error@1`, at requests counted from the next one."""
        self._desk.inject(faults_of(words, RWS_FAULTS))

    def close(self) -> None:
        """End the threads and close all sockets."""
        self._desk.ending.set()
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()


# ----------------------------------------------------------------------------------------------------
# Authorisation, resources and actions.


@dataclass(frozen=True)
class _Request:
    """An authorised request. raw: its path before unquoting."""

    method: str
    path: str
    raw: str
    query: Form
    form: Form
    body: bytes
    headers: Message[str, str]
    session: str


class _Desk:
    """Sessions, mastership, subscriptions, and the controller's resources."""

    def __init__(self, controller: Controller, access: Access, faults: Sequence[Fault]) -> None:
        self.controller, self.access = controller, access
        self.two, self.strict = access.version == 2, access.strict
        self._nonces: OrderedDict[str, int] = OrderedDict()  # issued nonce → its last count
        self._opaque = secrets.token_hex(8)
        self.ending = threading.Event()
        self.asked: list[str] = []
        self._faults = Faults(faults)
        self._more, self._more_from = Faults(), 0
        self._lock = threading.Lock()
        self._sessions: set[str] = set()
        self._master: dict[str, str] = {}  # domain → session that holds it
        self.groups: dict[str, str] = {}  # subscription → session
        self._deaf = False

    def challenge(self) -> str:
        """The challenge for a client that is not authorised; for digest, with a unique nonce."""
        if self.two:
            return f'Basic realm="{REALM}"'
        nonce = secrets.token_hex(16)
        with self._lock:
            self._nonces[nonce] = 0
            while len(self._nonces) > MOST_NONCES:
                self._nonces.popitem(last=False)
        return f'Digest realm="{REALM}", qop="auth", algorithm=MD5, nonce="{nonce}", opaque="{self._opaque}"'

    def lets_in(self, method: str, path: str, header: str) -> bool:
        """Whether a request's Authorization is valid. A digest is accepted once, as its count must rise (RFC 7616)."""
        kind, _, rest = header.partition(" ")
        if self.two:
            expected = base64.b64encode(f"{self.access.user}:{self.access.password}".encode())
            return kind == "Basic" and hmac.compare_digest(rest.strip().encode(), expected)
        if kind != "Digest":
            return False
        answer = parse_keqv_list([each for each in parse_http_list(rest) if "=" in each])
        nonce, count, own = (answer.get(name, "") for name in ("nonce", "nc", "cnonce"))
        if answer.get("username") != self.access.user or answer.get("qop") != "auth" or answer.get("uri") != path:
            return False
        if re.fullmatch(r"[0-9a-f]{8}", count) is None or not own:
            return False
        who = _md5(f"{self.access.user}:{REALM}:{self.access.password}")
        right = _md5(f"{who}:{nonce}:{count}:{own}:auth:{_md5(f'{method}:{path}')}")
        if not hmac.compare_digest(answer.get("response", "").encode(), right.encode()):
            return False
        with self._lock:
            if int(count, 16) <= self._nonces.get(nonce, MOST_COUNT):
                return False
            self._nonces[nonce] = int(count, 16)
        return True

    def session_of(self, cookies: str) -> tuple[str, bool]:
        """The session named by cookies, or a new one; and whether it is new."""
        found = re.search(rf"{COOKIE}=([0-9a-f]{{16}})", cookies)
        with self._lock:
            if found and found[1] in self._sessions:
                return found[1], False
            if len(self._sessions) >= MOST_SESSIONS:
                raise Denied(503, "too many sessions")
            new = secrets.token_hex(8)
            self._sessions.add(new)
            return new, True

    def fault(self, what: str) -> tuple[str, Fault] | None:
        """Record a request; returns the fault due at it."""
        with self._lock:
            self.asked.append(what)
            number = len(self.asked)
            for kind in RWS_FAULTS:
                if found := self._faults.take(kind, number) or self._more.take(kind, number - self._more_from):
                    self._deaf = self._deaf or kind == "deaf"
                    return kind, found
        return None

    def inject(self, faults: Sequence[Fault]) -> None:
        """Add faults at requests counted from the next one; faults injected before are forgotten."""
        with self._lock:
            self._more, self._more_from = Faults(faults), len(self.asked)

    def deaf(self) -> bool:
        """Whether subscriptions are to be closed; once."""
        with self._lock:
            deaf, self._deaf = self._deaf, False
            return deaf

    def leave(self, session: str) -> None:
        """End a session, with its mastership and subscriptions."""
        with self._lock:
            self._sessions.discard(session)
            self._master = {domain: who for domain, who in self._master.items() if who != session}
            self.groups = {group: who for group, who in self.groups.items() if who != session}

    # ---- reading ------------------------------------------------------------------------------------

    def get(self, asked: _Request) -> bytes | list[dict[str, str]]:
        """A file, or the states of a resource."""
        c, path = self.controller, asked.path
        if path.startswith("/fileservice/"):
            rest = self._file(asked)
            if rest.lower().rstrip("/") in ("home:", "$home", "home"):
                return [{"_type": "fs-file", "_title": name} for name in c.files()]
            return c.get(rest)
        running = "running" if c.running else "stopped"
        known: dict[str, Callable[[], list[dict[str, str]]]] = {
            "/rw/rapid/execution": lambda: [
                {"_type": "rap-execution", "_title": "execution", "ctrlexecstate": running, "cycle": "once"}
            ],
            "/rw/rapid/tasks": lambda: [
                {"_type": "rap-task-li", "_title": task, "name": task, "type": "normal", "taskstate": "linked"}
                | {"excstate": "started" if c.running else "ready", "active": "On", "motiontask": "TRUE"}
                for task in c.tasks
            ],
            "/rw/panel/ctrl-state" if self.two else "/rw/panel/ctrlstate": lambda: [
                {"_type": "pnl-ctrlstate", "_title": "ctrlstate", "ctrlstate": c.motors},
            ],
            "/rw/panel/opmode": lambda: [{"_type": "pnl-opmode", "_title": "opmode", "opmode": c.mode}],
            **self._module_lists(asked),
        }
        if not self.strict:
            for one, other in (("ctrlstate", "ctrl-state"), ("ctrl-state", "ctrlstate")):
                known.setdefault(f"/rw/panel/{other}", known.get(f"/rw/panel/{one}", list))
        if path not in known:
            raise Denied(404, "no such resource")
        return known[path]()

    def _module_lists(self, asked: _Request) -> dict[str, Callable[[], list[dict[str, str]]]]:
        if self.two:
            return {f"/rw/rapid/tasks/{task}/modules": partial(self._modules, task) for task in self.controller.tasks}
        task = asked.query.get("task", "" if self.strict else TASK)
        return {"/rw/rapid/modules": partial(self._modules, task)}

    def _modules(self, task: str) -> list[dict[str, str]]:
        if task not in self.controller.tasks:
            raise Denied(400, "task is missing")
        kinds = {"BASE": "SysMod", "user": "SysMod"} | dict.fromkeys(self.controller.modules(task), "ProgMod")
        return [{"_type": "rap-module-info-li", "_title": n, "name": n, "type": kind} for n, kind in kinds.items()]

    def _file(self, asked: _Request) -> str:
        """The path of a file, given by an environment variable of the controller."""
        rest = asked.path.removeprefix("/fileservice/")
        if self.strict:
            raw = asked.raw.removeprefix("/fileservice/").lower()
            if not raw.startswith(("$home", "home/") if self.two else "$home"):
                raise Denied(404, "path does not exist")
        return rest

    # ---- doing --------------------------------------------------------------------------------------

    def change(self, asked: _Request) -> int:
        """PUT or DELETE a file, or DELETE a subscription; returns the status."""
        if asked.method == "DELETE" and asked.path.startswith("/subscription/"):
            if self.groups.get(asked.path.removeprefix("/subscription/")) != asked.session:
                raise Denied(404, "no such subscription")
            del self.groups[asked.path.removeprefix("/subscription/")]
            return 200
        if not asked.path.startswith("/fileservice/"):
            raise Denied(405, "only files")
        name = self._file(asked)
        if asked.method == "DELETE":
            self.controller.delete(name)
            return 204
        if self.two and self.strict:
            self._kind(asked, FILES_V2)
        self.controller.put(name, asked.body)
        return 201

    def post(self, asked: _Request) -> None:
        """Carry out an action."""
        if self.strict and (self.two or asked.body):
            self._kind(asked, (FORM[self.access.version],))
        if self.two == ("action" in asked.query):
            raise Denied(404 if self.two else 400, "actions are of the other version")
        deed = asked.path if self.two else f"{asked.path}/{asked.query['action']}"
        c = self.controller
        load, unload = ("load", "unload") if self.two else ("loadprog", "unloadprog")
        deeds: dict[str, Callable[[], None]] = {
            "/rw/rapid/execution/resetpp": c.reset_pointer,
            "/rw/rapid/execution/start": partial(self._start, asked),
            "/rw/rapid/execution/stop": partial(self._stop, asked),
        }
        for task in c.tasks:
            place = f"/rw/rapid/tasks/{task}"
            deeds |= {
                f"{place}/loadmod": partial(self._load_module, asked, task),
                f"{place}/unloadmod": partial(self._unload_module, asked, task),
                f"{place}/program/{load}": partial(self._load_program, asked, task),
                f"{place}/program/{unload}": partial(c.unload_program, task),
            }
        for domain in ("edit", "motion") if self.two else ("cfg", "motion", "rapid"):
            for word in ("request", "release"):
                deeds[f"/rw/mastership/{domain}/{word}"] = partial(self._mastership, asked, domain, word)
        if deed not in deeds:
            raise Denied(404 if self.two else 400, "no such action")
        guarded = "loadmod" in deed or "/program/" in deed or (self.two and deed.endswith(("resetpp", "start")))
        if guarded:
            self._guard(asked)
        deeds[deed]()

    def _guard(self, asked: _Request) -> None:
        """Raises Denied if another session holds the mastership for loading, or, if strict, this one has none."""
        domain = "edit" if self.two else "rapid"
        holder = self._master.get(domain)
        if holder not in (None, asked.session):
            raise Denied(403, "the resource is held by someone else")
        implicit = self.two and asked.query.get("mastership") == "implicit"
        if self.strict and holder is None and not implicit:
            raise Denied(403, "the user does not have the required mastership")

    def _mastership(self, asked: _Request, domain: str, word: str) -> None:
        with self._lock:
            holder = self._master.get(domain)
            if holder not in (None, asked.session):
                raise Denied(403, "the resource is held by someone else")
            if word == "request":
                self._master[domain] = asked.session
            elif holder is None:
                raise Denied(403, "the user does not have the required mastership")
            else:
                del self._master[domain]

    def _load_module(self, asked: _Request, task: str) -> None:
        path = self._path(asked, "modulepath", (".mod", ".modx", ".sys"))
        self.controller.load(path, asked.form.get("replace", "false").lower() == "true", task)

    def _unload_module(self, asked: _Request, task: str) -> None:
        self.controller.unload(_field(asked.form, "module"), task)

    def _load_program(self, asked: _Request, task: str) -> None:
        mode = asked.form.get("loadmode", "add")
        if mode not in ("add", "replace"):
            raise Denied(400, "loadmode is add or replace")
        self.controller.load_program(self._path(asked, "progpath", (".pgf",)), mode == "replace", task)

    def _path(self, asked: _Request, name: str, kinds: tuple[str, ...]) -> str:
        path = _field(asked.form, name)
        if self.strict and not path.lower().startswith(("$home/", "home/") if self.two else "$home/"):
            raise Denied(400, "file not found")
        if self.strict and not path.lower().endswith(kinds):
            raise Denied(400, f"{name} is no {kinds[0]}")
        return path

    def _start(self, asked: _Request) -> None:
        for name in START:
            _field(asked.form, name)
        self.controller.start()

    def _stop(self, asked: _Request) -> None:
        if asked.form.get("stopmode", "stop") not in ("cycle", "instr", "stop", "qstop"):
            raise Denied(400, "stopmode is wrong")
        self.controller.stop()

    def subscribe(self, asked: _Request) -> str:
        """Subscribe to the execution state; returns the subscription's number."""
        if self.strict:
            self._kind(asked, (FORM[self.access.version],))
        which = _field(asked.form, "resources")
        if _field(asked.form, which) != EXECUTION or asked.form.get(f"{which}-p") not in ("0", "1"):
            raise Denied(400, "invalid resource URI or priority")
        with self._lock:
            group = str(len(self.groups) + 1 + 10 * secrets.randbelow(1000))
            self.groups[group] = asked.session
        return group

    def _kind(self, asked: _Request, kinds: tuple[str, ...]) -> None:
        if asked.headers.get("Content-Type", "").replace(" ", "") not in kinds:
            raise Denied(415, f"the content type is not {' or '.join(kinds)}")


def _md5(text: str) -> str:
    return hashlib.md5(text.encode(), usedforsecurity=False).hexdigest()


def _field(form: Form, name: str) -> str:
    if not form.get(name):
        raise Denied(400, f"{name} is missing")
    return form[name]


# ----------------------------------------------------------------------------------------------------
# HTTP.


class _RwsConnection(BaseHTTPRequestHandler):
    """One connection."""

    the_desk: _Desk
    protocol_version = "HTTP/1.1"
    timeout = PATIENCE
    _cookie = ""
    _json_asked = False

    def log_message(self, format: str, *args: object) -> None:
        """Say nothing."""

    def do_GET(self) -> None:
        self._answer("GET")

    def do_POST(self) -> None:
        self._answer("POST")

    def do_PUT(self) -> None:
        self._answer("PUT")

    def do_DELETE(self) -> None:
        self._answer("DELETE")

    def _answer(self, method: str) -> None:
        desk = self.the_desk
        self._cookie = ""
        parts = urlsplit(self.path)
        query = {name: values[-1] for name, values in parse_qs(parts.query).items()}
        self._json_asked = query.get("json") == "1" or (desk.two and "xhtml" not in self.headers.get("Accept", ""))
        try:
            body = self._body(LARGEST_FILE if method == "PUT" else LONGEST_FORM)
            if self._from_a_page():
                raise Denied(403, "requests of other pages are refused")
            if desk.controller.silent:
                raise Denied(503, "restarting")
            if parts.path.startswith("/poll/"):
                self._events(parts.path.removeprefix("/poll/"))
                return
            if not desk.lets_in(method, self.path, self.headers.get("Authorization", "")):
                self._reply(401, b"", {"WWW-Authenticate": desk.challenge()})
                return
            form = {k: v[-1] for k, v in parse_qs(body.decode("ascii", "replace"), keep_blank_values=True).items()}
            session, new = desk.session_of(self.headers.get("Cookie", ""))
            self._cookie = session if new else ""
            asked = _Request(method, unquote(parts.path), parts.path, query, form, body, self.headers, session)
            self._act_with_faults(asked)
        except Denied as denied:
            self._reply(denied.status, self._written([], denied.reason))

    def _from_a_page(self) -> bool:
        """Whether a foreign page in a browser sent this: it might know the password, which is ABB's default."""
        origin = self.headers.get("Origin")  # for a web socket, this server
        elsewhere = origin is not None and urlsplit(origin).netloc != self.headers.get("Host")
        return elsewhere or self.headers.get("Sec-Fetch-Site", "none") not in ("none", "same-origin")

    def _act_with_faults(self, asked: _Request) -> None:
        found = self.the_desk.fault(f"{asked.method} {self.path}")
        if found is None:
            self._act(asked)
            return
        kind, fault = found
        if kind in STATUS:
            headers = {"WWW-Authenticate": self.the_desk.challenge()} if kind == "login" else {}
            self._reply(STATUS[kind], self._written([], "simulated fault"), headers)
            return
        if kind in ("broken", "lose"):
            self.wfile, wire = _Nowhere(), self.wfile  # type: ignore[assignment]
            try:
                self._act(asked)
            finally:
                self.wfile = wire
        if kind == "broken":
            self._reply(500, self._written([], "simulated fault"))
        elif kind == "slow":
            self.the_desk.ending.wait(fault.value)
            self._act(asked)
        elif kind == "drip":
            self.wfile = _Drip(self.wfile, fault.value, self.the_desk.ending)  # type: ignore[assignment]
            self._act(asked)
        elif kind == "nonsense":
            self._reply(200, b'<html><body>{"state": [1, [2]]}</body></html>')
        elif kind == "deaf":
            self._act(asked)
        else:
            if kind == "garbage":
                self.wfile.write(GARBAGE)
            self.close_connection = True

    def _act(self, asked: _Request) -> None:
        desk = self.the_desk
        accept = asked.headers.get("Accept", "").replace(" ", "")
        file = asked.method == "GET" and asked.path.startswith("/fileservice/")
        if desk.two and desk.strict and not file and not any(each in accept for each in ACCEPT_V2):
            raise Denied(406, f"accept is not {' or '.join(ACCEPT_V2)}")
        if asked.path == "/logout":
            desk.leave(asked.session)
            self._reply(200, b"")
        elif asked.method in ("PUT", "DELETE"):
            self._reply(desk.change(asked), b"")
        elif asked.method == "POST" and asked.path == "/subscription":
            self._subscribed(desk.subscribe(asked))
        elif asked.method == "POST":
            desk.post(asked)
            self._reply(204, b"")
        else:
            found = desk.get(asked)
            if isinstance(found, bytes):
                self._reply(200, found, {"Content-Type": "application/octet-stream"})
            else:
                self._reply(200, self._written(found))

    def _subscribed(self, group: str) -> None:
        scheme = "ws" if self.the_desk.access.certificate is None else "wss"
        where = f"{scheme}://{self.headers.get('Host', '')}/poll/{group}"
        links = f'<a href="subscription/{group}" rel="group"/><a href="{where}" rel="self"/>'
        self._reply(201, _event(self.the_desk.controller.running, links).encode(), {"Location": where})

    def _events(self, group: str) -> None:
        """Report changes of the execution state until either side ends the subscription."""
        desk = self.the_desk
        found = re.search(rf"{COOKIE}=([0-9a-f]{{16}})", self.headers.get("Cookie", ""))
        if found is None or desk.groups.get(group) != found[1]:
            raise Denied(403, "the subscription is not of this session")
        if self.headers.get("Sec-WebSocket-Protocol", "") != SUBPROTOCOL[desk.access.version]:
            raise Denied(400, "unsupported Sec-WebSocket-Protocol")
        answer = accepted(self.headers, SUBPROTOCOL[desk.access.version])
        if answer is None:
            raise Denied(400, "no web socket")
        self.close_connection = True
        self.wfile.write(answer)
        connection, told, heard = WebSocket(self.connection), desk.controller.running, time.monotonic()
        try:
            while not desk.ending.is_set() and not desk.deaf() and time.monotonic() - heard < PATIENCE:
                if desk.controller.silent:
                    return
                running = desk.controller.running
                if running != told:
                    connection.say(_event(running, ""))
                    told = running
                for opcode, text in connection.heard(LOOK):
                    heard = time.monotonic()
                    # an IRC5 answers pings of the web socket, an OmniCore the text PING
                    if opcode == PING and not desk.two:
                        connection.say(text, PONG)
                    elif opcode == TEXT and text == "PING" and desk.two:
                        connection.say("PONG")
                    elif opcode == CLOSE:
                        return
        except SocketClosed:
            return

    def _body(self, most: int) -> bytes:
        """The body, whose length must be declared."""
        length = self.headers.get("Content-Length", "0")
        if not re.fullmatch(r"[0-9]{1,12}", length) or int(length) > most or "Transfer-Encoding" in self.headers:
            self.close_connection = True
            raise Denied(413, "too large, or of no stated length")
        return self.rfile.read(int(length))

    def _written(self, states: list[dict[str, str]], reason: str | None = None) -> bytes:
        """States, or a refusal, in the requested format."""
        if not self._json_asked:
            return _xhtml(states, reason).encode()
        status = {"code": 294912} if reason is None else {"code": REFUSED, "msg": reason}
        links = {"base": {"href": f"http://{self.headers.get('Host', '')}/"}}
        out: dict[str, Any] = {"_links": links}
        if self.the_desk.two:
            listed = any(each["_type"] == "rap-task-li" for each in states)
            out |= {"status": status, **({"_embedded": {"resources": states}} if listed else {"state": states})}
        else:
            out |= {"_embedded": {"_state": states} if reason is None else {"status": status}}
        return json.dumps(out).encode()

    def _reply(self, status: int, body: bytes, headers: Mapping[str, str] | None = None) -> None:
        self.send_response(status)
        kind = "json" if self._json_asked else "xhtml+xml"
        kind = (
            f"application/{'hal+json' if kind == 'json' else kind};v=2.0"
            if self.the_desk.two
            else f"application/{kind}"
        )
        for name, value in ({"Content-Type": kind} | dict(headers or {})).items():
            self.send_header(name, value)
        if self._cookie:
            self.send_header("Set-Cookie", f"{COOKIE}={self._cookie}; path=/; httponly")
            self.send_header("Set-Cookie", "ABBCX=1; path=/; httponly")
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        self.wfile.write(body)


class _Nowhere:
    """Discards an answer."""

    def write(self, data: bytes) -> int:
        return len(data)

    def flush(self) -> None:
        """Nothing is held back."""


class _Drip:
    """Sends an answer, and all later ones on the connection, a byte at a time."""

    def __init__(self, wire: Any, seconds: float, ending: threading.Event) -> None:
        self._wire, self._seconds, self._ending = wire, seconds, ending

    def write(self, data: bytes) -> int:
        for byte in data:
            if self._ending.wait(self._seconds):
                break
            self._wire.write(bytes([byte]))
        return len(data)

    def flush(self) -> None:
        """Nothing is held back."""

    def close(self) -> None:
        self._wire.close()

    closed = False


def _event(running: bool, links: str) -> str:
    """An event with the execution state."""
    state = {
        "_type": "rap-ctrlexecstate-ev",
        "_title": "ctrlexecstate",
        "ctrlexecstate": "running" if running else "stopped",
    }
    return _xhtml([state], None, links, EXECUTION)


def _xhtml(states: Sequence[Mapping[str, str]], reason: str | None, links: str = "", place: str = "") -> str:
    head = '<?xml version="1.0" encoding="utf-8"?><html xmlns="http://www.w3.org/1999/xhtml"><head><title>rws</title></head>'
    if reason is not None:
        said = f'<span class="code">{REFUSED}</span><span class="msg">{html.escape(reason)}</span>'
        return f'{head}<body><div class="status">{said}</div></body></html>'
    items = []
    for state in states:
        spans = "".join(
            f'<span class="{name}">{html.escape(value)}</span>' for name, value in state.items() if name[0] != "_"
        )
        link = f'<a href="{place}" rel="self"/>' if place else ""
        items.append(f'<li class="{state["_type"]}" title="{html.escape(state["_title"])}">{link}{spans}</li>')
    return f'{head}<body><div class="state">{links}<ul>{"".join(items)}</ul></div></body></html>'
