"""Robot Web Services of ABB's controllers, 1.0 and 2.0, and the controller's part of a run over them."""

from __future__ import annotations

import json
import re
import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import quote

from planner.base.errors import InputError
from planner.base.extras import missing_extra
from planner.base.files import read_bytes
from planner.link.connections import Address, LinkError, Secret

# ----------------------------------------------------------------------------------------------------
# Robot Web Services 1.0 (IRC5, RobotWare 6) and 2.0 (OmniCore, RobotWare 7).
#
# Written on `requests`: every call has a time limit and every answer a bound, and what goes wrong is told apart. No proxy
# and no .netrc of the environment is used, and no redirection is followed.

CONNECT_TIME, ANSWER_TIME = 5.0, 15.0  # s; loading a long module takes some seconds
MOST_ANSWERED = 1_000_000  # bytes
TASK = "T_ROB1"
USER = "Default User"  # on every new controller
FOLDER = "HOME:"
START = {
    "regain": "continue",
    "execmode": "continue",
    "cycle": "once",
    "condition": "none",
    "stopatbp": "disabled",
    "alltaskbytsp": "false",
}


@dataclass(frozen=True)
class Dialect:
    """How a version of the services says things."""

    scheme: str
    port: int
    home: str  # of the file service
    motors: str  # where the controller's state is
    headers: dict[str, str]
    form: dict[str, str]  # headers of what is posted
    file: dict[str, str]  # headers of a file


_V2 = "application/x-www-form-urlencoded;v=2.0"
DIALECTS = {
    1: Dialect("http", 80, f"fileservice/{FOLDER}", "rw/panel/ctrlstate", {}, {}, {}),
    2: Dialect(
        "https",
        443,
        "fileservice/$HOME",
        "rw/panel/ctrl-state",
        {"Accept": "application/hal+json;v=2.0"},
        {"Content-Type": _V2},
        {"Content-Type": "application/octet-stream;v=2.0"},
    ),
}


class Rws:
    """A session with a controller's web services; one thread at a time."""

    def __init__(
        self, address: Address, version: int, user: str, secret: Secret, verify: bool = True, scheme: str | None = None
    ) -> None:
        """verify: whether an https certificate is checked; scheme: in place of the version's own."""
        sessions, auth = _requests()
        self._dialect, self._two, self._address = DIALECTS[version], version == 2, address
        self._base = f"{scheme or self._dialect.scheme}://{address}/"
        self._session = sessions.Session()
        self._session.trust_env = False
        self._session.verify = verify
        self._session.headers.update(self._dialect.headers)
        word = secret.reveal()
        self._session.auth = (
            auth.HTTPBasicAuth(user.encode("utf-8"), word.encode("utf-8"))
            if self._two
            else auth.HTTPDigestAuth(user, word)
        )

    def mode(self) -> str:
        """The operating mode: AUTO, MANR, MANF …"""
        return self._get("rw/panel/opmode", "opmode").upper()

    def motors(self) -> str:
        """The controller's state: motoron, motoroff, guardstop, emergencystop …"""
        return self._get(self._dialect.motors, "ctrlstate").lower()

    def running(self) -> bool:
        """Whether RAPID runs in any task."""
        return self._get("rw/rapid/execution", "ctrlexecstate").lower() != "stopped"

    def upload(self, name: str, data: bytes) -> None:
        """Put a file into the controller's HOME."""
        self._ask("PUT", f"{self._dialect.home}/{quote(name)}", data=data, headers=self._dialect.file)

    def load(self, name: str) -> None:
        """Load a module from HOME into the task, in place of one of that name."""
        form = {"modulepath": f"{FOLDER}/{name}", "replace": "true"}
        self._act(f"rw/rapid/tasks/{TASK}", "loadmod", form, edits=True)

    def to_main(self) -> None:
        """Set the program pointer to main."""
        self._act("rw/rapid/execution", "resetpp", {}, edits=True)

    def start(self) -> None:
        """Run the program once."""
        self._act("rw/rapid/execution", "start", START)

    def stop(self) -> None:
        """Stop the program, as the pendant's stop button does."""
        self._act(
            "rw/rapid/execution",
            "stop",
            {"stopmode": "stop", "usetsp": "normal"} if self._two else {"stopmode": "stop"},
        )

    def close(self) -> None:
        """End the session; a controller has room for few."""
        try:
            self._ask("GET", "logout", data=None, headers={})
        except (LinkError, InputError):
            pass  # it ends by itself after some minutes
        finally:
            self._session.close()

    def _act(self, path: str, action: str, form: dict[str, str], edits: bool = False) -> None:
        if self._two:  # mastership is asked for with what needs it; in 1.0 the controller takes it itself
            target = f"{path}/{action}" + ("?mastership=implicit" if edits else "")
        else:
            target = f"{path}?action={action}"
        self._ask("POST", target, data=form, headers=self._dialect.form)

    def _get(self, path: str, key: str) -> str:
        """The value of a key in the first state of an answer."""
        raw = self._ask("GET", path if self._two else f"{path}?json=1", data=None, headers={})
        try:
            answer: Any = json.loads(raw)
            states = answer["state"] if self._two else answer["_embedded"]["_state"]
            value = states[0][key]
        except (ValueError, KeyError, IndexError, TypeError, RecursionError):
            value = None
        if not isinstance(value, str) or len(value) > 100:
            raise LinkError(
                f"the controller at {self._address} gives no {key}; is --rws {1 if self._two else 2} meant?"
            )
        return value

    def _ask(self, method: str, path: str, data: bytes | dict[str, str] | None, headers: dict[str, str]) -> bytes:
        sessions, _ = _requests()
        try:
            with self._session.request(
                method, self._base + path, data=data, headers=headers, stream=True, allow_redirects=False,
                timeout=(CONNECT_TIME, ANSWER_TIME),
            ) as answer:  # fmt: skip
                raw: bytes = answer.raw.read(MOST_ANSWERED + 1, decode_content=True)
                status = answer.status_code
        except sessions.exceptions.SSLError:
            hint = "give its certificate to this computer, or --insecure"
            raise InputError(
                f"the controller at {self._address} shows no certificate that is trusted", hint=hint
            ) from None
        except (sessions.exceptions.RequestException, sessions.packages.urllib3.exceptions.HTTPError, OSError) as error:
            raise self._unreachable(error) from None
        if status == 401:
            raise InputError(f"the controller at {self._address} does not take user and password", hint="see --user")
        if not 200 <= status < 300 or len(raw) > MOST_ANSWERED:
            what = path.partition("?")[2].removeprefix("action=") if "action=" in path else path.partition("?")[0]
            raise LinkError(f"the controller at {self._address} refuses {what}: {_reason(raw, status)}")
        return raw

    def _unreachable(self, error: Exception) -> LinkError | InputError:
        if "NameResolution" in repr(error):
            return InputError(f"there is no host {self._address.host}")
        slow = "Timeout" in type(error).__name__
        return LinkError(f"the controller's web services at {self._address} do not answer{' in time' if slow else ''}")


def _reason(raw: bytes, status: int) -> str:
    """What an answer says of a refusal; its status at least."""
    try:
        answer = json.loads(raw)
        details = answer["status"] if "status" in answer else answer["_embedded"]["status"]
        message = str(details["msg"])
    except (ValueError, KeyError, TypeError, RecursionError):
        return f"status {status}"
    return "".join(c if c.isprintable() else " " for c in message[:200])


def _requests() -> tuple[Any, Any]:
    """The package `requests`, which only the link needs."""
    try:
        import requests
        import requests.auth
    except ImportError as error:
        raise missing_extra(error, "the link") or error from None
    return requests, requests.auth


# ----------------------------------------------------------------------------------------------------
# The controller's part of a run: made ready, started, watched, and stopped.

LARGEST_MODULE = 100_000_000  # bytes
WATCH_TIME = 1.0  # s between looks at whether the program still runs
STILL = 2  # looks in a row that find it stopped, for its last words may be under way
STOP_TIME = 10.0  # s that stopping may take
_LOADED = re.compile(rb'\\File:="([A-Za-z][A-Za-z0-9_]{0,31}\.mod)"')
_HELLO = re.compile(rb'"H ([A-Za-z][A-Za-z0-9_]{0,31}) ([0-9]{1,9})\\0A"')
READY = {"mode": "AUTO", "motors": "motoron"}


def program_files(program: Path) -> dict[str, bytes]:
    """Files of a program by name: its own module first, those that it loads while it runs, and its program file."""

    def complain(reason: str, hint: str | None = None) -> InputError:
        return InputError(reason, file=program, hint=hint)

    if program.suffix.lower() != ".mod":
        raise complain("is no module of RAPID", "name the .mod that was written in style socket")
    main = read_bytes(program, LARGEST_MODULE, complain)
    if main.split(b"\n", 1)[0].split()[:2] != [b"MODULE", program.stem.encode()]:
        raise complain(f"its first line is not MODULE {program.stem}", "the file's name must be the module's")
    loaded = dict.fromkeys(name.decode("ascii") for name in _LOADED.findall(main))
    others = [program.with_name(name) for name in loaded]
    others += [path for path in [program.with_suffix(".pgf")] if path.is_file()]
    files = {program.name: main} | {path.name: read_bytes(path, LARGEST_MODULE, complain) for path in others}
    for name, data in files.items():
        if name.endswith(".mod") and not data.rstrip().endswith(b"ENDMODULE"):
            raise InputError("does not end with ENDMODULE", file=program.with_name(name), hint="it was cut off")
    return files


def check_together(program: Path, files: Mapping[str, bytes], lines: int) -> None:
    """Raises InputError unless the program sends as many lines as its table has."""
    hello = _HELLO.search(files[program.name])
    if hello is None:
        raise InputError("sends no lines", file=program, hint="the link runs programs of `program: style: socket`")
    if int(hello[2]) != lines:
        raise InputError(
            f"sends {int(hello[2])} lines, and its table has {lines}",
            file=program,
            hint="both must be as they were written together",
        )


def check_ready(rws: Rws) -> None:
    """Raises LinkError where the robot cannot be started, or something runs."""
    found = {"mode": rws.mode(), "motors": rws.motors()}
    if found["mode"] != READY["mode"]:
        raise LinkError(f"the controller is in mode {found['mode']}, not in AUTO")
    if found["motors"] != READY["motors"]:
        raise LinkError(f"the robot's motors are not on ({found['motors']})")
    if rws.running():
        raise LinkError("a program runs on the controller")


def bring(rws: Rws, files: Mapping[str, bytes], say: Callable[[str], None]) -> None:
    """Upload the files, load the first one, and set the program pointer to main."""
    for name, data in files.items():
        say(f"uploading {name} ({len(data) / 1e3:.0f} kB)")
        rws.upload(name, data)
    rws.load(next(iter(files)))
    rws.to_main()


class RobotWatch:
    """Watches a running program from a thread of its own, and stops it when asked to."""

    def __init__(self, rws: Rws, ask: Callable[[str], None], through: Callable[[], bool]) -> None:
        """ask: is told why the run is to end; through: whether the program said that it has ended."""
        self._rws, self._ask, self._through = rws, ask, through
        self._stop, self._over = threading.Event(), threading.Event()
        self._stopped: str | None = None
        self._thread = threading.Thread(target=self._watch, name="robot", daemon=True)
        self._thread.start()

    def stop(self, reason: str) -> None:
        """Stop the robot, without waiting for it."""
        self._stop.set()
        self._over.set()

    def close(self) -> str | None:
        """End the watch; in words what went wrong with stopping, None if nothing did."""
        self._over.set()
        self._thread.join(STOP_TIME + 2 * WATCH_TIME)
        if self._thread.is_alive():
            return "the controller's web services do not answer"
        return self._stopped

    def _watch(self) -> None:
        still = 0
        while not self._over.wait(WATCH_TIME):
            try:
                still = 0 if self._rws.running() else still + 1
            except (LinkError, InputError):
                continue  # the program's socket tells what matters; stopping has its own say
            if still >= STILL and not self._through():
                self._ask("the program was stopped on the controller")
        if self._stop.is_set():
            try:
                self._rws.stop()
            except (LinkError, InputError) as error:
                self._stopped = str(error)
