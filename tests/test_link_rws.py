"""Robot Web Services: the client against strict and lenient servers of both versions, with TLS, with faults, and FTP."""

from __future__ import annotations

import json
import shutil
import socket
import subprocess
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager, suppress
from pathlib import Path
from urllib.request import parse_http_list, parse_keqv_list

import pytest
import requests
from hypothesis import given, settings
from hypothesis import strategies as st
from requests.auth import HTTPBasicAuth, HTTPDigestAuth
from simulate_fixtures import MODULE, program

from planner.base.errors import InputError
from planner.link import command, demo, robot
from planner.link import rws as client
from planner.link.connections import Address, Cutter, LinkError, Secret, part
from planner.link.ftp import Ftp
from planner.link.orders import Order, StopOrder
from planner.link.robot import RobotWatch, bring, start, stop_robot
from planner.link.rws import USER, Rws
from planner.simulate import rws as simulated
from planner.simulate.board import faults_of
from planner.simulate.controller import OTHER_PROGRAM, Controller
from planner.simulate.ftp import FTP_FAULTS, FtpAccess, FtpServer
from planner.simulate.rws import FILES_V2, FORM, RWS_FAULTS, Access, RwsServer
from planner.simulate.web_socket import SocketClosed, WebSocket

PASSWORD = "r0b0tics-of-ours"
SECOND = MODULE.replace("Made", "Second")


def pgf(name: str) -> bytes:
    return f"<Program>\n\t<Module>{name}.mod</Module>\n</Program>\n".encode()


def files_of(text: str) -> dict[str, bytes]:
    name = text.split()[1]
    return {f"{name}.mod": text.encode(), f"{name}.pgf": pgf(name)}


@contextmanager
def serving(
    version: int = 1, faults: tuple[str, ...] = (), strict: bool = True, lines: tuple[str, ...] = (), **access: object
) -> Iterator[tuple[RwsServer, Controller]]:
    """A controller in use, another program being loaded, whose programs run for 5 s."""
    made = program(lines, moves=51, speed=0.1)
    controller = Controller(("127.0.0.1", 0), read=lambda modules: (made,), loaded=OTHER_PROGRAM)
    who = Access(password=PASSWORD, version=version, strict=strict, **access)  # type: ignore[arg-type]
    with (
        closing(controller),
        closing(RwsServer("127.0.0.1", 0, controller, who, faults_of(faults, RWS_FAULTS))) as server,
    ):
        yield server, controller


def session(server: RwsServer, version: int = 1, **options: object) -> Rws:
    scheme = str(options.pop("scheme", "http"))
    return Rws(Address(*server.address), version, USER, Secret(PASSWORD), scheme=scheme, **options)  # type: ignore[arg-type]


def silent(text: str) -> None:
    """Says nothing."""


# ---- all six steps --------------------------------------------------------------------------------------------------


@pytest.mark.slow(keep=1)
@pytest.mark.parametrize("version", [1, 2])
def test_the_six_steps_against_a_strict_server(version: int) -> None:
    """Upload, load, start, stop, a second program, a second run; then the task is emptied."""
    with serving(version) as (server, controller), closing(session(server, version)) as rws:
        assert rws.modules() == ("MainModule",)
        for text in (MODULE, SECOND, MODULE):
            name = text.split()[1]
            bring(rws, files_of(text), silent)
            assert rws.modules() == (name,) and controller.modules() == [name]
            start(rws)
            assert controller.running and rws.running()
            assert stop_robot(rws) is None and not controller.running
        assert controller.files() == ["Made.mod", "Made.pgf", "Second.mod", "Second.pgf"]
        with rws.mastership():
            rws.to_main()
        start(rws)
        assert stop_robot(rws) is None
        with rws.mastership():
            rws.unload()
        assert rws.modules() == () and controller.modules() == []
        asked = server.requests()
    domain, load = ("edit/request", "program/load") if version == 2 else ("rapid?action=request", "action=loadprog")
    first = next(k for k, each in enumerate(asked) if load in each)
    assert any(domain in each for each in asked[:first]) and not any("loadmod" in each for each in asked)
    assert all("/fileservice/$home/" in each for each in asked if each.startswith("PUT"))


def test_the_steps_of_the_demo(tmp_path: Path) -> None:
    path = tmp_path / "Made.mod"
    path.write_text(MODULE.replace("PROC main()\n", 'PROC main()\n        SocketSend bwClient\\Str:="H Made 1\\0A";\n'))
    told: list[str] = []
    with serving() as (server, controller), closing(session(server)) as rws:
        demo.show_steps(rws, path, told.append)
        assert not controller.running and controller.modules() == []
    assert told[0] == "Made: uploaded, loaded alone, and running" and f"{demo.SECOND}: stopped" in told
    assert len(told) == 7 and told[-1] == "unloaded: the task is empty"


def test_a_module_alone_leaves_another_main_in_the_way() -> None:
    """Why the program is loaded from its .pgf: what loads only a module meets an ambiguous main."""
    with serving() as (server, controller), closing(session(server)) as rws:
        rws.upload("Made.mod", MODULE.encode())
        with rws.mastership():
            rws._act("rw/rapid/tasks/T_ROB1", "loadmod", {"modulepath": "$HOME/Made.mod", "replace": "true"})
            with pytest.raises(LinkError, match="main is ambiguous: it is in MainModule and in Made"):
                rws.to_main()
        with pytest.raises(LinkError, match="no program pointer"):
            rws.start()
        assert not controller.running


def test_mastership_is_given_back_and_respected() -> None:
    with serving() as (server, controller), closing(session(server)) as rws, closing(session(server)) as other:
        with other.mastership(), pytest.raises(LinkError, match="held by someone else"):
            bring(rws, files_of(MODULE), silent)
        with pytest.raises(LinkError, match="no such file"), rws.mastership():
            rws.load("Missing.pgf")
        bring(other, files_of(MODULE), silent)  # it was given back
        start(other)
        with pytest.raises(LinkError, match="a program is running"):
            bring(rws, files_of(SECOND), silent)
        assert controller.running  # and whoever stops needs none
        with other.mastership():
            assert stop_robot(rws) is None


# ---- what a strict server refuses -----------------------------------------------------------------------------------


def raw(server: RwsServer, version: int) -> Callable[..., int]:
    """Requests as they are; the status."""
    made = requests.Session()
    made.trust_env = False
    made.auth = HTTPBasicAuth(USER, PASSWORD) if version == 2 else HTTPDigestAuth(USER, PASSWORD)
    if version == 2:
        made.headers["Accept"] = "application/hal+json;v=2.0"

    def ask(method: str, path: str, body: object = None, kind: str | None = None, **headers: str) -> int:
        if kind is not None:
            headers["Content-Type"] = kind
        url = "http://{}:{}".format(*server.address) + path
        return made.request(method, url, data=body, headers=headers, timeout=5.0).status_code  # type: ignore[arg-type]

    return ask


TASK = "/rw/rapid/tasks/T_ROB1"
START = "regain=continue&execmode=continue&cycle=once&condition=none&stopatbp=disabled&alltaskbytsp=false"


@pytest.mark.slow(keep=4)
@pytest.mark.parametrize(
    ("method", "path", "body", "kind", "strict", "lenient"),
    [
        ("PUT", "/fileservice/HOME:/x.mod", "x", None, 404, 201),
        ("PUT", "/fileservice/x.mod", "x", None, 404, 404),
        ("PUT", "/fileservice/$home/x.mod", "x", None, 201, 201),
        ("POST", f"{TASK}?action=loadmod", "modulepath=$HOME/Made.mod", FORM[1], 403, 204),
        ("POST", f"{TASK}/program?action=loadprog", "progpath=$HOME/Made.pgf", FORM[1], 403, 204),
        ("POST", f"{TASK}/program?action=loadprog", "progpath=HOME:/Made.pgf&loadmode=replace", FORM[1], 403, 204),
        ("POST", f"{TASK}/program?action=unloadprog", None, None, 403, 204),
        ("POST", f"{TASK}/program/load", "progpath=$HOME/Made.pgf", FORM[1], 400, 400),
        ("POST", "/rw/rapid/execution?action=start", START, "text/plain", 415, 403),
        ("POST", "/rw/rapid/execution?action=start", "regain=continue", FORM[1], 400, 400),
        ("POST", "/rw/rapid/execution?action=stop", "stopmode=at once", FORM[1], 400, 400),
        ("POST", "/rw/mastership/edit?action=request", None, None, 400, 400),
        ("POST", "/rw/mastership/rapid?action=release", None, None, 403, 403),
        ("POST", "/subscription", "resources=1&1=/rw/cfg&1-p=1", FORM[1], 400, 400),
        ("GET", "/rw/rapid/modules?json=1", None, None, 400, 200),
        ("GET", "/rw/panel/ctrl-state?json=1", None, None, 404, 200),
    ],
)
def test_what_version_1_refuses(
    method: str, path: str, body: str | None, kind: str | None, strict: int, lenient: int
) -> None:
    for expected in (strict, lenient):
        with serving(1, strict=expected == strict and strict != lenient) as (server, controller):
            if strict == lenient:
                assert raw(server, 1)(method, path, body, kind) == strict
                continue
            for name, data in files_of(MODULE).items():
                controller.put(f"$HOME/{name}", data)
            assert raw(server, 1)(method, path, body, kind) == expected


IMPLICIT = "?mastership=implicit"


@pytest.mark.parametrize(
    ("method", "path", "body", "headers", "status"),
    [
        ("GET", "/rw/panel/opmode", None, {"Accept": "application/json"}, 406),
        ("GET", "/rw/panel/opmode", None, {"Accept": "application/xhtml+xml;v=2.0"}, 200),
        ("GET", "/rw/panel/ctrlstate", None, {}, 404),
        ("PUT", "/fileservice/$HOME/x.mod", "x", {"Content-Type": "text/plain"}, 415),
        ("PUT", "/fileservice/$HOME/x.mod", "x", {"Content-Type": FILES_V2[1]}, 201),
        ("PUT", "/fileservice/HOME:/x.mod", "x", {"Content-Type": FILES_V2[0]}, 404),
        ("POST", "/rw/rapid/execution/stop", None, {}, 415),
        ("POST", "/rw/rapid/execution/stop", None, {"Content-Type": FORM[1]}, 415),
        ("POST", "/rw/rapid/execution/stop", None, {"Content-Type": FORM[2]}, 204),
        ("POST", "/rw/rapid/execution?action=stop", None, {"Content-Type": FORM[2]}, 404),
        ("POST", "/rw/rapid/execution/resetpp", None, {"Content-Type": FORM[2]}, 403),
        ("POST", f"/rw/rapid/execution/resetpp{IMPLICIT}", None, {"Content-Type": FORM[2]}, 204),
        ("POST", "/rw/rapid/execution/start", START, {"Content-Type": FORM[2]}, 403),
        ("POST", f"{TASK}/program/load", "progpath=HOME/Made.pgf", {"Content-Type": FORM[2]}, 403),
        ("POST", f"{TASK}/program/load{IMPLICIT}", "progpath=HOME/Made.pgf", {"Content-Type": FORM[2]}, 204),
        ("POST", f"{TASK}/program/load{IMPLICIT}", "progpath=HOME:/Made.pgf", {"Content-Type": FORM[2]}, 400),
        ("POST", f"{TASK}/program/load{IMPLICIT}", "progpath=HOME/Made.mod", {"Content-Type": FORM[2]}, 400),
        ("POST", "/rw/mastership/rapid/request", None, {"Content-Type": FORM[2]}, 404),
    ],
)
def test_what_version_2_refuses(method: str, path: str, body: str | None, headers: dict[str, str], status: int) -> None:
    with serving(2) as (server, controller):
        for name, data in files_of(MODULE).items():
            controller.put(f"$HOME/{name}", data)
        assert raw(server, 2)(method, path, body, **headers) == status


def answers(monkeypatch: pytest.MonkeyPatch) -> list[dict[str, str]]:
    """The fields of each digest that comes, and whether it was let in."""
    came: list[dict[str, str]] = []
    real = simulated._Desk.lets_in

    def note(desk: object, method: str, path: str, header: str) -> bool:
        let_in = real(desk, method, path, header)  # type: ignore[arg-type]
        came.append(parse_keqv_list(parse_http_list(header.partition(" ")[2])) | {"in": str(let_in)})
        return let_in

    monkeypatch.setattr(simulated._Desk, "lets_in", note)
    return came


def test_each_digest_counts_one_further(monkeypatch: pytest.MonkeyPatch) -> None:
    """One challenge a session; then nc rises by one with each request, and no cnonce comes twice."""
    came = answers(monkeypatch)
    with serving(faults=("busy@2",)) as (server, _), closing(session(server)) as rws, closing(session(server)) as other:
        for _ in range(4):
            rws.mode()
        other.mode()
        assert [each["in"] for each in came] == ["False", *["True"] * 5, "False", "True"]
        digests = came[1:6]
        assert [each["nc"] for each in digests] == [f"{k:08x}" for k in range(1, 6)]
        assert len({each["nonce"] for each in digests}) == 1 and len({each["cnonce"] for each in digests}) == 5
        assert came[7]["nonce"] != digests[0]["nonce"] and came[7]["nc"] == "00000001"


def test_a_digest_is_taken_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Neither again, nor with an older count, nor for another path, nor without a count or a cnonce."""
    with serving() as (server, _):
        url = "http://{}:{}".format(*server.address)
        auth, path = HTTPDigestAuth(USER, PASSWORD), "/rw/panel/opmode"
        assert requests.get(url + path, auth=auth, timeout=5.0).status_code == 200

        def ask(header: str | None, path: str = path) -> int:
            assert header is not None
            return requests.get(url + path, headers={"Authorization": header}, timeout=5.0).status_code

        second, third = (auth.build_digest_header("GET", url + path) for _ in range(2))
        assert [ask(third), ask(third), ask(second)] == [200, 401, 401]
        fourth = str(auth.build_digest_header("GET", url + path))
        assert ask(fourth, "/rw/rapid/execution") == 401
        for name in ("nc=", "cnonce=", "qop=", "nonce="):
            assert ask(fourth.replace(name, f"x{name}")) == 401
        assert ask(fourth.replace('nonce="', 'nonce="0')) == 401
        assert ask(fourth) == 200
        for header in ("Digest", "Digest nc", "Digest é", 'Digest username="', "Basic x"):
            assert ask(header) == 401


@pytest.mark.parametrize("user", ['a"b', "a\\b", "a\nb", "Ж"])
def test_a_user_that_digest_cannot_say_is_told(user: str) -> None:
    with pytest.raises(InputError, match="cannot be a user of Robot Web Services 1"):
        Rws(Address("127.0.0.1", 1), 1, user, Secret(PASSWORD))
    Rws(Address("127.0.0.1", 1), 2, user, Secret(PASSWORD))


@pytest.mark.parametrize("version", [1, 2])
def test_a_page_in_a_browser_is_refused_whatever_it_knows(version: int) -> None:
    """ABB's own password is no secret, and a browser adds a user's by itself."""
    with serving(version) as (server, controller):
        ask = raw(server, version)
        stop = "/rw/rapid/execution/stop" if version == 2 else "/rw/rapid/execution?action=stop"
        kind = {"Content-Type": FORM[version]}
        for header in ({"Origin": "http://elsewhere.example"}, {"Origin": "null"}, {"Sec-Fetch-Site": "cross-site"}):
            assert ask("POST", stop, None, **kind, **header) == 403
            assert ask("PUT", "/fileservice/$HOME/x.mod", "x", **header) == 403
        assert controller.files() == [] and server.requests() == []
        assert ask("POST", stop, None, **kind) == 204


def test_loading_while_something_runs_is_refused() -> None:
    with serving() as (server, controller), closing(session(server)) as rws:
        bring(rws, files_of(MODULE), silent)
        start(rws)
        with rws.mastership():
            for deed in (lambda: rws.load("Made.pgf"), rws.unload, rws.to_main):
                with pytest.raises(LinkError, match="a program is running"):
                    deed()
        assert controller.running


# ---- TLS ------------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def certificate(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """A certificate of this computer's own, made here, and its key."""
    if shutil.which("openssl") is None:
        pytest.skip("there is no openssl")
    folder = tmp_path_factory.mktemp("tls")
    made = ["openssl", "req", "-x509", "-newkey", "rsa:2048", "-nodes", "-days", "1", "-subj", "/CN=localhost"]
    made += ["-addext", "subjectAltName=IP:127.0.0.1", "-keyout", str(folder / "key"), "-out", str(folder / "cert")]
    subprocess.run(made, check=True, capture_output=True)
    return folder / "cert", folder / "key"


def test_version_2_over_tls(certificate: tuple[Path, Path]) -> None:
    cert, key = certificate
    with serving(2, certificate=cert, key=key) as (server, controller):
        with pytest.raises(InputError, match="shows no trusted certificate"):
            session(server, 2, scheme="https").mode()
        for verify in (cert, False):
            with closing(session(server, 2, scheme="https", verify=verify)) as rws:
                bring(rws, files_of(MODULE), silent)
                with closing(rws.subscribe()) as events:
                    start(rws)
                    assert events.next(2.0) == "running"
                    assert stop_robot(rws) is None and events.next(2.0) == "stopped"
        assert not controller.running


def test_a_handshake_that_does_not_end_is_cut(certificate: tuple[Path, Path]) -> None:
    """A server that drips its handshake, and holds nobody else up."""
    with socket.create_server(("127.0.0.1", 0)) as slow:
        over = threading.Event()

        def drip() -> None:
            made, _ = slow.accept()
            with made:
                for byte in b"\x16\x03\x03\x40\x00" + b"\x00" * 200:
                    if over.wait(0.1):
                        return
                    made.sendall(bytes([byte]))

        threading.Thread(target=drip, daemon=True).start()
        rws = Rws(Address(*slow.getsockname()), 2, USER, Secret(PASSWORD))
        since = time.monotonic()
        with pytest.raises((LinkError, InputError)):
            rws.running(0.8)
        assert time.monotonic() - since < 2.5
        over.set()


# ---- time -----------------------------------------------------------------------------------------------------------


def test_a_controller_that_drips_does_not_hold_a_request() -> None:
    """A byte every 0.2 s never lets a socket's own time limit run out."""
    with serving(faults=("drip@1:0.2",)) as (server, _):
        since = time.monotonic()
        rws = session(server)
        with pytest.raises(LinkError, match="do not answer in time"):
            rws.running(1.0)
        assert time.monotonic() - since < 2.0
        assert not rws.running()  # the session goes on, on another connection
        rws.close()


@pytest.mark.slow
def test_stopping_goes_on_past_whatever_is_answered() -> None:
    """Each of the first requests of the stop fails in another way, one of them with a byte every 4 s."""
    with serving() as (server, controller), closing(session(server)) as rws:
        bring(rws, files_of(MODULE), silent)
        start(rws)
        server.inject("drip@1:4", "error@2", "drop@3", "login@4", "lose@5", "nonsense@6")
        since = time.monotonic()
        assert stop_robot(rws) is None
        assert not controller.running and time.monotonic() - since < robot.STOP_TIME


@contextmanager
def dripping(seconds: float) -> Iterator[Address]:
    """A server that answers each connection a byte at a time, so many seconds apart, and never ends."""
    over = threading.Event()

    def drip(made: socket.socket) -> None:
        with made, suppress(OSError):
            for byte in b"HTTP/1.1 200 OK\r\nContent-Length: 9000\r\n\r\n" + b" " * 9000:
                made.sendall(bytes([byte]))
                if over.wait(seconds):
                    return

    def serve() -> None:
        with suppress(OSError):
            while True:
                threading.Thread(target=drip, args=(listener.accept()[0],), daemon=True).start()

    with socket.create_server(("127.0.0.1", 0)) as listener:
        threading.Thread(target=serve, daemon=True).start()
        yield Address(*listener.getsockname())
        over.set()
        listener.shutdown(socket.SHUT_RDWR)


@pytest.mark.slow(keep=("2-https",))
@pytest.mark.parametrize(("version", "scheme"), [(1, "http"), (2, "http"), (2, "https")])
def test_a_controller_that_only_drips_holds_no_stop(version: int, scheme: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Every answer of every session, in the header and in the handshake, too: stopping ends, and says that it failed."""
    for name, value in (("STOP_TIME", 1.0), ("STOPPING_TIME", 0.3)):
        monkeypatch.setattr(robot, name, value)
    monkeypatch.setattr(client, "STOP_TIME", 0.4)
    with dripping(0.15) as address:
        since = time.monotonic()
        assert "do not answer in time" in str(stop_robot(Rws(address, version, USER, Secret(PASSWORD), scheme=scheme)))
        assert time.monotonic() - since < 2.5


def test_a_peer_that_drips_does_not_hold_the_last_words() -> None:
    """Neither of the relay, the stream and the board, nor those that turn a program away which cannot be stopped otherwise."""
    with dripping(0.1) as address, socket.create_connection((address.host, address.port)) as made:
        since = time.monotonic()
        part(made, b"S over\n", 0.5)
        assert time.monotonic() - since < 1.0
    with dripping(0.1) as address:
        since = time.monotonic()
        with pytest.MonkeyPatch.context() as patched:
            patched.setattr(command, "CONNECT_TIME", 0.5)
            command._turn_away(address)
        assert time.monotonic() - since < 1.5


def test_a_busy_controller_is_asked_again() -> None:
    with serving(faults=("busy@1", "busy@2", "busy@4")) as (server, _), closing(session(server)) as rws:
        assert rws.mode() == "AUTO" and rws.motors() == "motoron" and len(server.requests()) == 5


def test_the_cutter_spares_what_is_in_time() -> None:
    cutter = Cutter()
    here, there = socket.socketpair()
    with here, there:
        cutter.watch("it", here)
        with cutter.within(5.0):
            there.sendall(b"x")
            assert here.recv(1) == b"x"
        with pytest.raises(TimeoutError), cutter.within(0.1):
            assert here.recv(1) == b""
        with pytest.raises(ZeroDivisionError), cutter.within(5.0):
            raise ZeroDivisionError
        cutter.forget("it")


# ---- watched --------------------------------------------------------------------------------------------------------


def watched(deed: Callable[[Controller, RwsServer], None], version: int = 1) -> tuple[str, float, bool]:
    """Why a watch asked for the end after something was done, how long it took [s], and whether it was subscribed."""
    asked: list[str] = []
    said = threading.Event()

    def ask(order: Order) -> None:
        if isinstance(order, StopOrder):
            asked.append(order.reason)
            said.set()

    with serving(version) as (server, controller), closing(session(server, version)) as rws:
        bring(rws, files_of(MODULE), silent)
        start(rws)
        watch = RobotWatch(rws, ask, lambda: False)
        until(lambda: watch.subscribed)
        deed(controller, server)
        since = time.monotonic()
        said.wait(20.0)
        took, subscribed = time.monotonic() - since, watch.subscribed
        watch.stop("over")
        assert watch.close() is None and not controller.running
    return (asked or [""])[0], took, subscribed


def until(holds: Callable[[], bool], seconds: float = 5.0) -> None:
    end = time.monotonic() + seconds
    while not holds() and time.monotonic() < end:
        time.sleep(0.01)


@pytest.mark.slow
@pytest.mark.parametrize("version", [1, 2])
def test_a_stop_on_the_controller_is_told(version: int) -> None:
    reason, took, subscribed = watched(lambda controller, _: controller.stop(), version)
    assert reason == "the program was stopped on the controller" and subscribed and took < 3.0


@pytest.mark.slow
def test_without_a_subscription_it_is_asked() -> None:
    def lose(controller: Controller, server: RwsServer) -> None:
        server.inject("deaf@1")
        with closing(session(server)) as other:
            other.mode()
        controller.stop()

    reason, took, subscribed = watched(lose)
    assert reason == "the program was stopped on the controller" and not subscribed and took < 5.0


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["error", "login", "refuse", "garbage", "nonsense"])
def test_web_services_that_fail_end_the_run(kind: str) -> None:
    def fail(controller: Controller, server: RwsServer) -> None:
        # all looks of the watch (each asks again after a 401); the stop, which comes after, finds them as they should be
        server.inject(*(f"{kind}@{k}" for k in range(1, 4 if kind != "login" else 7)))

    reason, took, _ = watched(fail)
    assert "cannot be watched any more" in reason and took < 15.0


# ---- wrong answers --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("kind", "words"),
    [
        ("refuse", "refuses rw/panel/opmode: simulated fault"),
        ("error", "refuses rw/panel/opmode: simulated fault"),
        ("login", "does not take user and password"),
        ("drop", "do not answer"),
        ("garbage", "do not answer"),
        ("nonsense", r"gives no opmode; is --rws 2 meant\?"),
    ],
)
def test_what_is_answered_wrongly_is_told(kind: str, words: str) -> None:
    with (
        serving(faults=(f"{kind}@1", f"{kind}@2")) as (server, _),
        closing(session(server)) as rws,
        pytest.raises((LinkError, InputError), match=words),
    ):
        rws.mode()


def test_a_start_that_starts_nothing_is_noticed(monkeypatch: pytest.MonkeyPatch) -> None:
    """A controller may say yes to a start, and refuse it in its log only."""
    monkeypatch.setattr(robot, "START_TIME", 0.3)
    with serving() as (server, controller), closing(session(server)) as rws:
        bring(rws, files_of(MODULE), silent)
        monkeypatch.setattr(controller, "start", lambda: None)
        with pytest.raises(LinkError, match=r"accepted the start, but runs nothing \(motors: motoron\)"):
            start(rws)


JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.text(max_size=8),
    lambda inner: (
        st.lists(inner, max_size=3)
        | st.dictionaries(
            st.sampled_from(["_embedded", "_state", "state", "status", "msg", "resources", "opmode"]), inner
        )
    ),
    max_leaves=12,
)


@pytest.mark.slow
@settings(max_examples=200, deadline=None)
@given(st.binary(max_size=200) | JSON.map(lambda value: json.dumps(value).encode()), st.sampled_from([1, 2]))
def test_no_answer_is_believed_or_ends_in_a_traceback(body: bytes, version: int) -> None:
    """Whatever comes with a 200 gives a mode or is told; whatever comes with a 500 gives a line of words."""
    rws = Rws(Address("127.0.0.1", 1), version, USER, Secret(PASSWORD))
    rws._asked = lambda *asked: client._Answer(200, "", body)  # type: ignore[method-assign]
    try:
        assert isinstance(rws.mode(), str) and all(isinstance(name, str) for name in rws.modules())
    except LinkError as error:
        assert "gives no opmode" in str(error)
    words = client._reason(client._Answer(500, "", body))
    assert words and words.isprintable() and len(words) <= 200


@settings(max_examples=100, deadline=None)
@given(st.lists(st.binary(max_size=40), max_size=5))
def test_no_frames_upset_the_simulated_web_socket(pieces: list[bytes]) -> None:
    here, there = socket.socketpair()
    with here, there:
        end = WebSocket(here)
        for piece in pieces:
            there.sendall(piece)
            try:
                frames = end.heard(0.0)
            except SocketClosed:
                return
            assert all(0 <= opcode < 16 and len(text) <= 125 for opcode, text in frames)


# ---- FTP ------------------------------------------------------------------------------------------------------------


@contextmanager
def ftp_serving(*faults: str) -> Iterator[tuple[Address, Controller]]:
    controller = Controller(("127.0.0.1", 0))
    access = FtpAccess(password=PASSWORD)
    with (
        closing(controller),
        closing(FtpServer("127.0.0.1", 0, controller, access, faults_of(faults, FTP_FAULTS))) as server,
    ):
        yield Address(*server.address), controller


def test_ftp_is_closed_to_a_page_in_a_browser() -> None:
    with ftp_serving() as (address, _), socket.create_connection((address.host, address.port), timeout=2.0) as page:
        assert page.recv(100) == b"220 ready\r\n"
        with suppress(OSError):
            page.sendall(f"POST / HTTP/1.1\r\n\r\nUSER {USER}\r\nPASS {PASSWORD}\r\n".encode())
            assert page.recv(100) == b""


def test_files_over_ftp() -> None:
    with ftp_serving() as (address, controller):
        with closing(Ftp(address, USER, Secret(PASSWORD))) as ftp:
            ftp.upload("Made.mod", MODULE.encode() * 3000)
            ftp.upload("Made.mod", MODULE.encode())
            ftp.upload("Made.pgf", pgf("Made"))
        assert controller.get("$HOME/Made.mod") == MODULE.encode() and controller.files() == ["Made.mod", "Made.pgf"]
        with pytest.raises(InputError, match="does not take user and password"):
            Ftp(address, USER, Secret("wrong"))
        with pytest.raises(InputError, match="has no folder ELSEWHERE"):
            Ftp(address, USER, Secret(PASSWORD), "ELSEWHERE")
        with pytest.raises(InputError, match="is no folder"):
            Ftp(address, USER, Secret(PASSWORD), "HOME\r\nDELE x")
    with pytest.raises(LinkError, match=r"FTP server at 127\.0\.0\.1:"):
        Ftp(address, USER, Secret(PASSWORD))


@pytest.mark.slow(keep=2)
@pytest.mark.parametrize(
    ("fault", "words"),
    [
        ("refuse@4", "550 refused"),
        ("drop@4", "EOFError"),
        ("cut@4", r"arrived with \d+ of \d+ bytes"),
        ("garbage@5", "FTP server"),
        ("mute@4:30", "does not answer in time"),
    ],
)
def test_ftp_that_fails_is_told(fault: str, words: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("planner.link.ftp.QUICK", 1.0)
    since = time.monotonic()
    with (
        ftp_serving(fault) as (address, _),
        pytest.raises(LinkError, match=words),
        closing(Ftp(address, USER, Secret(PASSWORD))) as ftp,
    ):
        ftp.upload("Made.mod", MODULE.encode())
        ftp.upload("Made.mod", MODULE.encode())
    assert time.monotonic() - since < 4.0
