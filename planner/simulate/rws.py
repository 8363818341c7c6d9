"""Robot Web Services: what of it a client needs that brings a program onto a controller, starts and watches it.

1.0 as on IRC5: digest authentication, `?action=`, JSON for `?json=1`. 2.0 as on OmniCore: basic authentication, actions
as paths, edit mastership for loading and for the program pointer, `;v=2.0` in the content types. Codes inside errors
stand for any refusal: go by the HTTP status.
"""

from __future__ import annotations

import base64
import hashlib
import hmac
import json
import re
import secrets
import ssl
import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any
from urllib.parse import parse_qs, unquote, urlsplit
from urllib.request import parse_http_list, parse_keqv_list

from planner.base.errors import InputError
from planner.simulate.controller import LARGEST_FILE, TASK, Controller, Denied

REALM = "validusers@robapi.abb"
USER = "Default User"  # ABB's, on every new controller
REFUSED = -1073442816  # stands for any refusal
LONGEST_FORM = 4096  # bytes
PATIENCE = 30.0  # s without a request until a connection is closed
FORM_V2 = "application/x-www-form-urlencoded;v=2.0"

Form = Mapping[str, str]


@dataclass(frozen=True)
class Access:
    """Who may come in, and which version is spoken. certificate, key: PEM files for https; http without."""

    user: str = USER
    password: str = "robotics"  # ABB's, on every new controller
    version: int = 1
    certificate: Path | None = None
    key: Path | None = None


class RwsServer:
    """Serves a controller, in threads of its own."""

    def __init__(self, host: str, port: int, controller: Controller, access: Access) -> None:
        desk = _Desk(controller, access)

        class Handler(_Handler):
            the_desk = desk

        try:
            self._server = ThreadingHTTPServer((host, port), Handler)
        except OSError as error:
            raise InputError(f"cannot listen on {host}:{port}: {error.strerror or error}", field="--port") from error
        self._server.daemon_threads = True
        if access.certificate is not None:
            context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
            try:
                context.load_cert_chain(access.certificate, access.key)
            except OSError as error:
                self._server.server_close()
                raise InputError("no certificate and key to be read", file=access.certificate) from error
            self._server.socket = context.wrap_socket(self._server.socket, server_side=True)
        self.address: tuple[str, int] = self._server.server_address[:2]  # type: ignore[assignment]
        self._thread = threading.Thread(target=self._server.serve_forever, args=(0.05,), name="rws", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """End the threads and close all sockets."""
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()


class _Desk:
    """Who is let in, and what is done for whom."""

    def __init__(self, controller: Controller, access: Access) -> None:
        self.controller, self.access = controller, access
        self.nonce, self.opaque = secrets.token_hex(16), secrets.token_hex(8)
        self.edit_master = False

    @property
    def challenge(self) -> str:
        if self.access.version == 2:
            return f'Basic realm="{REALM}"'
        return f'Digest realm="{REALM}", qop="auth", algorithm=MD5, nonce="{self.nonce}", opaque="{self.opaque}"'

    def lets_in(self, method: str, header: str) -> bool:
        kind, _, rest = header.partition(" ")
        if self.access.version == 2:
            expected = base64.b64encode(f"{self.access.user}:{self.access.password}".encode()).decode()
            return kind == "Basic" and hmac.compare_digest(rest.strip(), expected)
        if kind != "Digest":
            return False
        answer = parse_keqv_list([each for each in parse_http_list(rest) if "=" in each])
        if (
            answer.get("nonce") != self.nonce
            or answer.get("username") != self.access.user
            or answer.get("qop") != "auth"
        ):
            return False
        who = _md5(f"{self.access.user}:{REALM}:{self.access.password}")
        what = _md5(f"{method}:{answer.get('uri', '')}")
        right = _md5(f"{who}:{self.nonce}:{answer.get('nc', '')}:{answer.get('cnonce', '')}:auth:{what}")
        return hmac.compare_digest(answer.get("response", ""), right)

    def get(self, path: str) -> bytes | list[dict[str, str]]:
        """A file, or the state of a resource."""
        c = self.controller
        if path.startswith("/fileservice/"):
            rest = path.removeprefix("/fileservice/")
            if rest.lower().rstrip("/") in ("home:", "$home"):
                return [{"_type": "fs-file", "_title": name} for name in c.files()]
            return c.get(rest)
        running = "running" if c.running else "stopped"
        known: dict[str, Callable[[], list[dict[str, str]]]] = {
            "/rw/rapid/execution": lambda: [
                {"_type": "rap-execution", "_title": "execution", "ctrlexecstate": running, "cycle": "once"}
            ],
            "/rw/rapid/tasks": lambda: [
                {"_type": "rap-task-li", "_title": TASK, "name": TASK, "type": "normal", "taskstate": "linked"}
                | {"excstate": "started" if c.running else "ready", "active": "On", "motiontask": "TRUE"}
            ],
            f"/rw/rapid/tasks/{TASK}/modules": lambda: [
                {"_type": "rap-module-info-li", "_title": name, "name": name, "type": "ProgMod"} for name in c.modules()
            ],
            "/rw/panel/ctrlstate": lambda: [
                {"_type": "pnl-ctrlstate", "_title": "ctrlstate", "ctrlstate": c.motors},
            ],
            "/rw/panel/opmode": lambda: [{"_type": "pnl-opmode", "_title": "opmode", "opmode": c.mode}],
        }
        known["/rw/panel/ctrl-state"] = known["/rw/panel/ctrlstate"]
        known["/rw/rapid/modules"] = known[f"/rw/rapid/tasks/{TASK}/modules"]
        if path not in known:
            raise Denied(404, "no such resource")
        return known[path]()

    def post(self, path: str, form: Form) -> None:
        """Do something; `path` ends with the action."""
        c = self.controller
        task = f"/rw/rapid/tasks/{TASK}"
        deeds: dict[str, Callable[[], None]] = {
            "/rw/rapid/execution/resetpp": c.reset_pointer,
            "/rw/rapid/execution/start": lambda: self._start(form),
            "/rw/rapid/execution/stop": c.stop,
            f"{task}/loadmod": lambda: c.load(_field(form, "modulepath"), form.get("replace", "").lower() == "true"),
            f"{task}/unloadmod": lambda: c.unload(_field(form, "module")),
            f"{task}/activate": lambda: None,
        }
        for domain in ("rapid", "edit", "motion"):
            for word, held in (("request", True), ("release", False)):
                deeds[f"/rw/mastership/{domain}/{word}"] = partial(self._master, domain, held)
        if path not in deeds:
            raise Denied(404, "no such resource")
        guarded = path.endswith(("resetpp", "loadmod"))
        if self.access.version == 2 and guarded and not self.edit_master and form.get("mastership") != "implicit":
            raise Denied(403, "edit mastership is needed")
        deeds[path]()

    def _master(self, domain: str, held: bool) -> None:
        if domain != "motion":
            self.edit_master = held

    def _start(self, form: Form) -> None:
        for name in ("regain", "execmode", "cycle", "condition", "stopatbp", "alltaskbytsp"):
            _field(form, name)
        self.controller.start()


def _md5(text: str) -> str:
    return hashlib.md5(text.encode(), usedforsecurity=False).hexdigest()


def _field(form: Form, name: str) -> str:
    if not form.get(name):
        raise Denied(400, f"{name} is missing")
    return form[name]


class _Handler(BaseHTTPRequestHandler):
    """One connection."""

    the_desk: _Desk
    protocol_version = "HTTP/1.1"
    timeout = PATIENCE

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
        parts = urlsplit(self.path)
        path = unquote(parts.path)
        query = {name: values[-1] for name, values in parse_qs(parts.query).items()}
        try:
            body = self._body(LARGEST_FILE if method == "PUT" else LONGEST_FORM)
            if desk.controller.silent:
                raise Denied(503, "restarting")
            if not desk.lets_in(method, self.headers.get("Authorization", "")):
                self._reply(401, b"", {"WWW-Authenticate": desk.challenge})
                return
            self._act(method, path, query, body)
        except Denied as denied:
            self._reply(denied.status, self._json([], denied.reason))

    def _act(self, method: str, path: str, query: Form, body: bytes) -> None:
        desk = self.the_desk
        if method in ("PUT", "DELETE"):
            if not path.startswith("/fileservice/"):
                raise Denied(405, "only files")
            name = path.removeprefix("/fileservice/")
            if method == "PUT":
                desk.controller.put(name, body)
            else:
                desk.controller.delete(name)
            self._reply(201 if method == "PUT" else 204, b"")
        elif method == "GET":
            found = desk.get(path)
            if isinstance(found, bytes):
                self._reply(200, found, {"Content-Type": "application/octet-stream"})
            else:
                self._reply(200, self._json(found))
        else:
            two = desk.access.version == 2
            if two and body and self.headers.get("Content-Type", "").replace(" ", "") != FORM_V2:
                raise Denied(415, f"the content type is not {FORM_V2}")
            if two == ("action" in query):
                raise Denied(404, "actions are of the other version")
            form = {k: v[-1] for k, v in parse_qs(body.decode("ascii", "replace"), keep_blank_values=True).items()}
            desk.post(path if two else f"{path}/{query['action']}", {**query, **form})
            self._reply(204, b"")

    def _body(self, most: int) -> bytes:
        """The body, whose length must be declared."""
        length = self.headers.get("Content-Length", "0")
        if not re.fullmatch(r"[0-9]{1,12}", length) or int(length) > most or "Transfer-Encoding" in self.headers:
            self.close_connection = True
            raise Denied(413, "too large, or of no stated length")
        return self.rfile.read(int(length))

    def _json(self, state: list[dict[str, str]], reason: str | None = None) -> bytes:
        status = {"code": 294912} if reason is None else {"code": REFUSED, "msg": reason}
        links = {"base": {"href": f"http://{self.headers.get('Host', '')}/"}}
        out: dict[str, Any] = {"_links": links}
        if self.the_desk.access.version == 2:
            listed = any(each["_type"].endswith("-li") for each in state)
            out |= {"status": status, **({"_embedded": {"resources": state}} if listed else {"state": state})}
        else:
            out |= {"_embedded": {"_state": state} if reason is None else {"status": status}}
        return json.dumps(out).encode()

    def _reply(self, status: int, body: bytes, headers: Mapping[str, str] | None = None) -> None:
        self.send_response(status)
        kind = "application/hal+json;v=2.0" if self.the_desk.access.version == 2 else "application/json"
        for name, value in ({"Content-Type": kind} | dict(headers or {})).items():
            self.send_header(name, value)
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        self.wfile.write(body)
