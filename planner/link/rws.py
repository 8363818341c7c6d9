"""Robot Web Services of ABB's controllers, 1.0 and 2.0: what a client needs to upload a program and run it.

Paths and fields follow ABB's references (developercenter.robotstudio.com: api/rwsApi for 1.0, api/RWS for 2.0).
"""

from __future__ import annotations

import json
import re
import ssl
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import quote, urlsplit

from planner.base.errors import InputError
from planner.base.extras import missing_extra
from planner.link.connections import Address, Cutter, LinkError, Secret, connect

# ----------------------------------------------------------------------------------------------------
# Differences between the versions: 1.0 of IRC5 (RobotWare 6), 2.0 of OmniCore (RobotWare 7).

TASK = "T_ROB1"
USER = "Default User"  # on every new controller
START = {
    "regain": "continue",
    "execmode": "continue",
    "cycle": "once",
    "condition": "none",
    "stopatbp": "disabled",
    "alltaskbytsp": "false",
}
EXECUTION = "/rw/rapid/execution;ctrlexecstate"  # the resource of the subscription


@dataclass(frozen=True)
class Dialect:
    """The paths, names and headers of one version of the services."""

    scheme: str
    port: int
    home: str  # the controller's HOME when loading a program
    motors: str  # path of the controller's state
    modules: str  # path of a task's loaded modules
    domain: str  # of mastership, for loading and for the program pointer
    load: str  # action that loads a program
    unload: str
    subprotocol: str  # of the subscription's web socket
    ping: str  # text that probes the web socket; empty for its built-in ping
    headers: dict[str, str]
    form: dict[str, str]  # headers of posted forms
    file: dict[str, str]  # headers of uploaded files


DIALECTS = {
    1: Dialect(
        scheme="http",
        port=80,
        home="$HOME",
        motors="rw/panel/ctrlstate",
        modules="rw/rapid/modules?task={task}",
        domain="rapid",
        load="loadprog",
        unload="unloadprog",
        subprotocol="robapi2_subscription",
        ping="",
        headers={},
        form={"Content-Type": "application/x-www-form-urlencoded"},
        file={"Content-Type": "application/octet-stream"},
    ),
    2: Dialect(
        scheme="https",
        port=443,
        home="HOME",
        motors="rw/panel/ctrl-state",
        modules="rw/rapid/tasks/{task}/modules",
        domain="edit",
        load="load",
        unload="unload",
        subprotocol="rws_subscription",
        ping="PING",
        headers={"Accept": "application/hal+json;v=2.0"},
        form={"Content-Type": "application/x-www-form-urlencoded;v=2.0"},
        file={"Content-Type": "application/octet-stream;v=2.0"},
    ),
}

# ----------------------------------------------------------------------------------------------------
# A session.
#
# Based on `requests`. Every request has a deadline for the whole of it, and every answer a size limit. Proxies and
# .netrc files of the environment are not used, and redirections are not followed. A controller allows 70 sessions and
# answers 503 beyond 20 requests a second: it has done nothing then, so the request may be repeated.

CONNECT_TIME = 5.0  # s
QUICK = 10.0  # s for a request; a controller answers within a few tenths of a second
SLOW = 60.0  # s for loading a program; a long one takes several seconds
STOP_TIME = 3.0  # s for a request to stop, which leaves time to repeat it
SLOWEST_LINE = 50e3  # bytes/s of an upload
BUSY_TIME = 0.2  # s before a request to a busy controller is repeated
MOST_ANSWERED = 1_000_000  # bytes
MOST_MODULES = 10_000
_NOT_QUOTED = re.compile(r'["\\\x00-\x1f\x7f]|[^\x00-\xff]')  # characters that a digest header cannot carry
_MESSAGE = re.compile(r'class="msg"[^>]*>([^<]*)<')


class Rws:
    """A session with a controller's web services; one thread at a time."""

    def __init__(
        self,
        address: Address,
        version: int,
        user: str,
        secret: Secret,
        verify: bool | Path = True,
        scheme: str | None = None,
    ) -> None:
        """verify: whether to check an https certificate, or the PEM file for it; scheme: if not the version's own."""
        sessions, auth = _requests()
        self._made_with = (address, version, user, secret, verify, scheme)
        self._dialect, self._two, self.address = DIALECTS[version], version == 2, address
        self._scheme = scheme or self._dialect.scheme
        self._verify, self._cutter = verify, Cutter()
        self._session = sessions.Session()
        self._session.trust_env = False
        self._session.verify = str(verify) if isinstance(verify, Path) else verify
        if verify is False:  # it was requested, so no need to warn at every request
            sessions.packages.urllib3.disable_warnings(sessions.packages.urllib3.exceptions.InsecureRequestWarning)
        self._session.headers.update(self._dialect.headers)
        for prefix in ("http://", "https://"):
            self._session.mount(prefix, _adapter(self._cutter))
        if not self._two and _NOT_QUOTED.search(user):
            raise InputError(f"{user!r} cannot be a user of Robot Web Services 1.0", field="--user")
        word = secret.reveal()
        self._session.auth = (
            auth.HTTPBasicAuth(user.encode("utf-8"), word.encode("utf-8"))
            if self._two
            else auth.HTTPDigestAuth(user, word)
        )

    def again(self) -> Rws:
        """Another session with the same controller, for another thread."""
        return Rws(*self._made_with)

    def mode(self) -> str:
        """The operating mode: AUTO, MANR, MANF …"""
        return self._state("rw/panel/opmode", "opmode").upper()

    def motors(self) -> str:
        """The controller's state: motoron, motoroff, guardstop, emergencystop …"""
        return self._state(self._dialect.motors, "ctrlstate").lower()

    def running(self, seconds: float = QUICK) -> bool:
        """Whether RAPID runs in any task."""
        return self._state("rw/rapid/execution", "ctrlexecstate", seconds).lower() != "stopped"

    def active(self) -> tuple[str, ...]:
        """Names of the tasks that run when the controller is started, as selected in its task panel."""
        listed = self._states("rw/rapid/tasks")[:MOST_MODULES]
        return tuple(str(each.get("name")) for each in listed if str(each.get("active")).lower() == "on")

    def modules(self, task: str = TASK) -> tuple[str, ...]:
        """Names of the modules of a task's loaded program, without system modules."""
        listed = self._states(self._dialect.modules.format(task=task))[:MOST_MODULES]
        return tuple(str(each.get("name")) for each in listed if str(each.get("type")).lower().startswith("prog"))

    def upload(self, name: str, data: bytes) -> None:
        """Put a file into the controller's HOME, replacing one of the same name."""
        seconds = QUICK + len(data) / SLOWEST_LINE
        self._ask("PUT", f"fileservice/$home/{quote(name)}", data, self._dialect.file, seconds)

    @contextmanager
    def mastership(self) -> Iterator[None]:
        """Hold the mastership required for loading and the program pointer; nobody else may change them meanwhile."""
        place = f"rw/mastership/{self._dialect.domain}"
        self._act(place, "request")
        done = False
        try:
            yield
            done = True
        finally:
            if not done:
                with suppress(LinkError, InputError):  # the earlier error is the one to report
                    self._act(place, "release", seconds=STOP_TIME)
        self._act(place, "release")

    def load(self, program: str, task: str = TASK) -> None:
        """Load a program from its .pgf in HOME, replacing the task's whole program. Requires mastership."""
        form = {"progpath": f"{self._dialect.home}/{program}", "loadmode": "replace"}
        self._act(f"rw/rapid/tasks/{task}/program", self._dialect.load, form, seconds=SLOW)

    def unload(self, task: str = TASK) -> None:
        """Unload the program, so that the task is empty. Requires mastership."""
        self._act(f"rw/rapid/tasks/{task}/program", self._dialect.unload)

    def to_main(self) -> None:
        """Set the program pointers of all tasks to main. Requires mastership."""
        self._act("rw/rapid/execution", "resetpp")

    def start(self) -> None:
        """Run the program once. Mastership must have been released, so that others may stop it."""
        self._act("rw/rapid/execution", "start", START, implicit=True)

    def stop(self) -> None:
        """Stop the program, as the pendant's stop button does, without mastership: this must work whoever holds it."""
        self._act("rw/rapid/execution", "stop", {"stopmode": "stop", "usetsp": "normal"}, seconds=STOP_TIME)

    def subscribe(self) -> ExecutionEvents:
        """Subscribe to changes of the execution state. Raises LinkError if the controller offers no subscription."""
        # as in ABB's samples, with an unescaped semicolon, which controllers are known to require
        answer = self._ask("POST", "subscription", f"resources=1&1={EXECUTION}&1-p=1".encode(), self._dialect.form)
        place = urlsplit(answer.location).path
        group = re.fullmatch(r"/poll/([0-9]{1,9})", place)
        if answer.status != 201 or group is None:
            raise LinkError(f"the controller at {self.address} grants no subscription")
        cookies = "; ".join(f"{each.name}={each.value}" for each in self._session.cookies)
        context = None if self._scheme == "http" else self._tls()
        try:
            return ExecutionEvents(self.address, place, cookies, self._dialect, context)
        except LinkError:
            self.unsubscribe(group[1])
            raise

    def unsubscribe(self, group: str) -> None:
        """Cancel a subscription."""
        try:
            self._ask("DELETE", f"subscription/{group}", None, {}, STOP_TIME)
        except (LinkError, InputError):
            return  # it ends with the session

    def close(self, seconds: float = STOP_TIME) -> None:
        """End the session; a controller allows only a limited number."""
        try:
            self._ask("GET", "logout", None, {}, seconds)
        except (LinkError, InputError):
            pass  # it ends by itself after some minutes
        finally:
            self._session.close()

    def _act(
        self,
        path: str,
        action: str,
        form: dict[str, str] | None = None,
        implicit: bool = False,
        seconds: float = QUICK,
    ) -> None:
        if self._two:
            target = f"{path}/{action}" + ("?mastership=implicit" if implicit else "")
        else:
            target = f"{path}?action={action}"
        self._ask("POST", target, form or {}, self._dialect.form, seconds)

    def _states(self, path: str, seconds: float = QUICK) -> list[dict[str, Any]]:
        """The states in an answer; none if it has another form."""
        asked = path if self._two else path + ("&" if "?" in path else "?") + "json=1"
        body = self._ask("GET", asked, None, {}, seconds).body
        try:
            answer: Any = json.loads(body)
            embedded = answer.get("_embedded", {})
            found = embedded.get("_state") or answer.get("state") or embedded.get("resources") or []
        except (ValueError, AttributeError, RecursionError):
            return []
        return [each for each in found if isinstance(each, dict)] if isinstance(found, list) else []

    def _state(self, path: str, key: str, seconds: float = QUICK) -> str:
        """The value of a key in the first state of an answer."""
        states = self._states(path, seconds)
        value = states[0].get(key) if states else None
        if not isinstance(value, str) or len(value) > 100:
            raise LinkError(f"the controller at {self.address} gives no {key}; is --rws {1 if self._two else 2} meant?")
        return value

    def _ask(
        self,
        method: str,
        path: str,
        data: bytes | dict[str, str] | None,
        headers: dict[str, str],
        seconds: float = QUICK,
    ) -> _Answer:
        """Send a request and return the answer within a time, repeating it if the controller is busy."""
        end = time.monotonic() + seconds
        while True:
            answer = self._asked(method, path, data, headers, max(0.1, end - time.monotonic()))
            if answer.status != 503 or time.monotonic() + BUSY_TIME > end:
                break
            time.sleep(BUSY_TIME)
        if answer.status == 401:
            raise InputError(f"the controller at {self.address} does not take user and password", hint="see --user")
        if not 200 <= answer.status < 300 or len(answer.body) > MOST_ANSWERED:
            what = path.partition("?")[2].removeprefix("action=") if "action=" in path else path.partition("?")[0]
            raise LinkError(f"the controller at {self.address} refuses {what}: {_reason(answer)}")
        return answer

    def _asked(
        self, method: str, path: str, data: bytes | dict[str, str] | None, headers: dict[str, str], seconds: float
    ) -> _Answer:
        sessions, _ = _requests()
        url = f"{self._scheme}://{self.address}/{path}"
        try:
            with (
                self._cutter.within(seconds),
                self._session.request(
                    method, url, data=data, headers=headers, stream=True, allow_redirects=False,
                    timeout=(min(CONNECT_TIME, seconds), seconds),
                ) as answer,
            ):  # fmt: skip
                body: bytes = answer.raw.read(MOST_ANSWERED + 1, decode_content=True)
                return _Answer(answer.status_code, str(answer.headers.get("Location", "")), body)
        except TimeoutError:
            raise LinkError(f"the controller's web services at {self.address} do not answer in time") from None
        except sessions.exceptions.SSLError:
            hint = "give its certificate with --certificate, or --insecure"
            raise InputError(f"the controller at {self.address} shows no trusted certificate", hint=hint) from None
        except (sessions.exceptions.RequestException, sessions.packages.urllib3.exceptions.HTTPError, OSError) as error:
            raise self._unreachable(error) from None

    def _unreachable(self, error: Exception) -> LinkError | InputError:
        if "NameResolution" in repr(error):
            return InputError(f"there is no host {self.address.host}")
        slow = "Timeout" in type(error).__name__
        return LinkError(f"the controller's web services at {self.address} do not answer{' in time' if slow else ''}")

    def _tls(self) -> ssl.SSLContext:
        """The TLS context of the web socket, which checks certificates as for all other requests."""
        context = ssl.create_default_context(cafile=str(self._verify) if isinstance(self._verify, Path) else None)
        if self._verify is False:
            context.check_hostname, context.verify_mode = False, ssl.CERT_NONE
        return context


@dataclass(frozen=True)
class _Answer:
    """Status, Location header, and body of an answer."""

    status: int
    location: str
    body: bytes


def _reason(answer: _Answer) -> str:
    """The reason that an answer gives for a refusal, or at least its status."""
    try:
        said = json.loads(answer.body)
        details = said["status"] if "status" in said else said["_embedded"]["status"]
        message = str(details["msg"])
    except (ValueError, KeyError, TypeError, RecursionError):
        found = _MESSAGE.search(answer.body[:MOST_ANSWERED].decode("utf-8", "replace"))
        message = found[1].strip() if found else ""
    message = "".join(c if c.isprintable() else " " for c in message[:200])
    return message or f"status {answer.status}"


def _requests() -> tuple[Any, Any]:
    """The package `requests`, which only the link needs."""
    try:
        import requests
        import requests.auth
    except ImportError as error:
        raise missing_extra(error, "the link") or error from None
    return requests, requests.auth


def _adapter(cutter: Cutter) -> Any:
    """An adapter for a session's connections, which are subject to the cutter's deadlines even before TLS."""
    import requests.adapters
    from urllib3.connection import HTTPConnection, HTTPSConnection
    from urllib3.connectionpool import HTTPConnectionPool, HTTPSConnectionPool

    class Watched:
        def _new_conn(self) -> Any:
            made = super()._new_conn()  # type: ignore[misc]
            cutter.watch(id(self), made)
            return made

        def close(self) -> None:
            cutter.forget(id(self))
            super().close()  # type: ignore[misc]

    class Plain(Watched, HTTPConnection):
        pass

    class Secure(Watched, HTTPSConnection):
        pass

    class PlainPool(HTTPConnectionPool):
        ConnectionCls = Plain

    class SecurePool(HTTPSConnectionPool):
        ConnectionCls = Secure

    out = requests.adapters.HTTPAdapter()
    out.poolmanager.pool_classes_by_scheme = {"http": PlainPool, "https": SecurePool}
    return out


# ----------------------------------------------------------------------------------------------------
# Execution events, over a web socket.

_STATE = re.compile(r'class="ctrlexecstate"[^>]*>\s*([a-z]{1,20})\s*<')
MOST_EVENT = 64_000  # characters
PING_EVERY = 5.0  # s; a connection is lost after two unanswered pings


class ExecutionEvents:
    """Execution states (`running`, `stopped`) as reported by the controller."""

    def __init__(
        self, address: Address, place: str, cookies: str, dialect: Dialect, context: ssl.SSLContext | None
    ) -> None:
        """place: path of the web socket; context: for https. Raises LinkError if it cannot be opened."""
        websocket = _websocket()
        self._cutter, self._errors = Cutter(), (websocket.WebSocketException, OSError, ValueError)
        self._late, self._ping = websocket.WebSocketTimeoutException, dialect.ping
        made = connect(address, "the controller's subscription")
        self._cutter.watch("events", made)
        scheme = "ws" if context is None else "wss"
        try:
            with self._cutter.within(CONNECT_TIME):
                if context is not None:
                    made = context.wrap_socket(made, server_hostname=address.host)
                self._socket = websocket.create_connection(
                    f"{scheme}://{address}{place}", timeout=CONNECT_TIME, socket=made, cookie=cookies,
                    subprotocols=[dialect.subprotocol], redirect_limit=0,
                )  # fmt: skip
        except (*self._errors, TimeoutError) as error:
            made.close()
            self._cutter.forget("events")
            raise LinkError(f"the controller's subscription cannot be opened: {error}") from None
        self._asked = self._heard = time.monotonic()

    def next(self, seconds: float) -> str | None:
        """The next state within a time [s], or None; raises LinkError once the connection has ended."""
        websocket, end = _websocket(), time.monotonic() + seconds
        try:
            while (left := end - time.monotonic()) > 0.0:
                self._keep_alive()
                self._socket.settimeout(left)
                try:
                    with self._cutter.within(left + CONNECT_TIME):
                        opcode, data = self._socket.recv_data(control_frame=True)
                except self._late:
                    return None
                self._heard = time.monotonic()
                if opcode == websocket.ABNF.OPCODE_CLOSE:
                    raise LinkError("the controller closed the subscription")
                text = data[:MOST_EVENT].decode("utf-8", "replace") if opcode == websocket.ABNF.OPCODE_TEXT else ""
                if found := _STATE.search(text):
                    return found[1]
        except (*self._errors, TimeoutError) as error:
            raise LinkError(f"the controller's subscription was lost: {error}") from None
        return None

    def _keep_alive(self) -> None:
        now = time.monotonic()
        if now - self._heard > 3 * PING_EVERY:
            raise OSError("no answer")
        if now - max(self._asked, self._heard) > PING_EVERY:
            self._asked = now
            if self._ping:
                self._socket.send(self._ping)
            else:
                self._socket.ping()

    def close(self) -> None:
        """Close the web socket."""
        self._cutter.forget("events")
        self._socket.shutdown()


def _websocket() -> Any:
    """The package `websocket`, part of the link's extra."""
    try:
        import websocket
    except ImportError as error:
        raise missing_extra(error, "the link") or error from None
    return websocket
