"""Robot Web Services of ABB's controllers, 1.0 and 2.0: what a client needs that brings a program and runs it.

Paths and fields are those of ABB's references (developercenter.robotstudio.com: api/rwsApi for 1.0, api/RWS for 2.0).
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
# What the versions say differently: 1.0 of IRC5 (RobotWare 6), 2.0 of OmniCore (RobotWare 7).

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
EXECUTION = "/rw/rapid/execution;ctrlexecstate"  # what is subscribed to


@dataclass(frozen=True)
class Dialect:
    """How a version of the services says things."""

    scheme: str
    port: int
    home: str  # the controller's HOME where a program is loaded from
    motors: str  # where the controller's state is
    modules: str  # where a task's loaded modules are
    domain: str  # of mastership, for loading and for the program pointer
    load: str  # action that loads a program
    unload: str
    subprotocol: str  # of the subscription's web socket
    ping: str  # text that asks it whether it is there; empty for a ping of the web socket's own
    headers: dict[str, str]
    form: dict[str, str]  # headers of what is posted
    file: dict[str, str]  # headers of a file


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
# Written on `requests`. Every request has a time for the whole of it, and every answer a bound. No proxy and no .netrc of
# the environment is used, and no redirection is followed. A controller has room for 70 sessions and answers 503 beyond 20
# requests a second: it has done nothing then, so that it may be asked again.

CONNECT_TIME = 5.0  # s
QUICK = 10.0  # s for a request; a controller answers within some tenths of a second
SLOW = 60.0  # s for loading a program; a long one takes some seconds
STOP_TIME = 3.0  # s for a request to stop, so that there is time to ask again
SLOWEST_LINE = 50e3  # bytes/s of an upload
BUSY_TIME = 0.2  # s until a busy controller is asked again
MOST_ANSWERED = 1_000_000  # bytes
MOST_MODULES = 10_000
_NOT_QUOTED = re.compile(r'["\\\x00-\x1f\x7f]|[^\x00-\xff]')  # characters that a header of digest cannot carry
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
        """verify: whether an https certificate is checked, or the PEM file to check it with; scheme: not the version's own."""
        sessions, auth = _requests()
        self._made_with = (address, version, user, secret, verify, scheme)
        self._dialect, self._two, self.address = DIALECTS[version], version == 2, address
        self._scheme = scheme or self._dialect.scheme
        self._verify, self._cutter = verify, Cutter()
        self._session = sessions.Session()
        self._session.trust_env = False
        self._session.verify = str(verify) if isinstance(verify, Path) else verify
        if verify is False:  # it was asked for, and need not be said at every request
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
        """Names of the tasks that run when the controller is started, as its task panel has them."""
        listed = self._states("rw/rapid/tasks")[:MOST_MODULES]
        return tuple(str(each.get("name")) for each in listed if str(each.get("active")).lower() == "on")

    def modules(self, task: str = TASK) -> tuple[str, ...]:
        """Names of the modules of a task's loaded program; those of the system are not among them."""
        listed = self._states(self._dialect.modules.format(task=task))[:MOST_MODULES]
        return tuple(str(each.get("name")) for each in listed if str(each.get("type")).lower().startswith("prog"))

    def upload(self, name: str, data: bytes) -> None:
        """Put a file into the controller's HOME, in place of one of that name."""
        seconds = QUICK + len(data) / SLOWEST_LINE
        self._ask("PUT", f"fileservice/$home/{quote(name)}", data, self._dialect.file, seconds)

    @contextmanager
    def mastership(self) -> Iterator[None]:
        """Hold what loading and the program pointer need; nobody else may change them meanwhile."""
        place = f"rw/mastership/{self._dialect.domain}"
        self._act(place, "request")
        done = False
        try:
            yield
            done = True
        finally:
            if not done:
                with suppress(LinkError, InputError):  # what went wrong before is what must be told
                    self._act(place, "release", seconds=STOP_TIME)
        self._act(place, "release")

    def load(self, program: str, task: str = TASK) -> None:
        """Load a program from its .pgf in HOME, in place of the task's whole program that is there. Needs mastership."""
        form = {"progpath": f"{self._dialect.home}/{program}", "loadmode": "replace"}
        self._act(f"rw/rapid/tasks/{task}/program", self._dialect.load, form, seconds=SLOW)

    def unload(self, task: str = TASK) -> None:
        """Unload the program, so that the task is empty. Needs mastership."""
        self._act(f"rw/rapid/tasks/{task}/program", self._dialect.unload)

    def to_main(self) -> None:
        """Set the program pointers of all tasks to main. Needs mastership."""
        self._act("rw/rapid/execution", "resetpp")

    def start(self) -> None:
        """Run the program once. Mastership must not be held any more: others may stop it."""
        self._act("rw/rapid/execution", "start", START, implicit=True)

    def stop(self) -> None:
        """Stop the program, as the pendant's stop button does. Asks for no mastership: whoever holds it, this must work."""
        self._act("rw/rapid/execution", "stop", {"stopmode": "stop", "usetsp": "normal"}, seconds=STOP_TIME)

    def subscribe(self) -> ExecutionEvents:
        """Be told the state of execution whenever it changes. Raises LinkError where the controller has no such thing."""
        # as ABB's samples have it: with the semicolon as it is, which controllers are known to want
        answer = self._ask("POST", "subscription", f"resources=1&1={EXECUTION}&1-p=1".encode(), self._dialect.form)
        place = urlsplit(answer.location).path
        group = re.fullmatch(r"/poll/([0-9]{1,9})", place)
        if answer.status != 201 or group is None:
            raise LinkError(f"the controller at {self.address} gives no subscription")
        cookies = "; ".join(f"{each.name}={each.value}" for each in self._session.cookies)
        context = None if self._scheme == "http" else self._tls()
        try:
            return ExecutionEvents(self.address, place, cookies, self._dialect, context)
        except LinkError:
            self.unsubscribe(group[1])
            raise

    def unsubscribe(self, group: str) -> None:
        """Give a subscription back."""
        try:
            self._ask("DELETE", f"subscription/{group}", None, {}, STOP_TIME)
        except (LinkError, InputError):
            return  # it ends with the session

    def close(self, seconds: float = STOP_TIME) -> None:
        """End the session; a controller has room for few."""
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
        """The states of an answer; none where it has another form."""
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
        """Request and answer within a time, asked again where the controller is busy."""
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
            raise InputError(
                f"the controller at {self.address} shows no certificate that is trusted", hint=hint
            ) from None
        except (sessions.exceptions.RequestException, sessions.packages.urllib3.exceptions.HTTPError, OSError) as error:
            raise self._unreachable(error) from None

    def _unreachable(self, error: Exception) -> LinkError | InputError:
        if "NameResolution" in repr(error):
            return InputError(f"there is no host {self.address.host}")
        slow = "Timeout" in type(error).__name__
        return LinkError(f"the controller's web services at {self.address} do not answer{' in time' if slow else ''}")

    def _tls(self) -> ssl.SSLContext:
        """What the web socket's certificate is checked with: the same as for all else."""
        context = ssl.create_default_context(cafile=str(self._verify) if isinstance(self._verify, Path) else None)
        if self._verify is False:
            context.check_hostname, context.verify_mode = False, ssl.CERT_NONE
        return context


@dataclass(frozen=True)
class _Answer:
    """Status, where it leads to, and body of an answer."""

    status: int
    location: str
    body: bytes


def _reason(answer: _Answer) -> str:
    """What an answer says of a refusal; its status at least."""
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
    """What makes the connections of a session: each is watched from its first byte on, before TLS."""
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
# Events of the execution, over a web socket.

_STATE = re.compile(r'class="ctrlexecstate"[^>]*>\s*([a-z]{1,20})\s*<')
MOST_EVENT = 64_000  # characters
PING_EVERY = 5.0  # s; a connection is lost after two that are not answered


class ExecutionEvents:
    """States of execution (`running`, `stopped`) as the controller tells them."""

    def __init__(
        self, address: Address, place: str, cookies: str, dialect: Dialect, context: ssl.SSLContext | None
    ) -> None:
        """place: path of the web socket; context: for https. Raises LinkError where it cannot be opened."""
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
        """The next state within a time [s], None where there is none; raises LinkError once the connection has ended."""
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
        """Nothing more is listened to."""
        self._cutter.forget("events")
        self._socket.shutdown()


def _websocket() -> Any:
    """The package `websocket`, which comes with the link's extra."""
    try:
        import websocket
    except ImportError as error:
        raise missing_extra(error, "the link") or error from None
    return websocket
