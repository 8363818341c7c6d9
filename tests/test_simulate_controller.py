"""The simulated controller: its web services as a client of ABB's meets them, and the program's socket."""

from __future__ import annotations

import socket
import subprocess
import time
from collections.abc import Callable
from contextlib import closing
from dataclasses import replace

import numpy as np
import pytest
import requests
from abb_robot_client.rws import RWS
from export_fixtures import in_modules, make_plan, socket_plan
from simulate_fixtures import MODULE, Client, program, reader

from planner.export.rapid.reader import read_rapid
from planner.export.rapid.writer import rapid, rapid_files
from planner.simulate.controller import OUTPUT, SEND, SETTLE, Controller, own_clock, played_motion
from planner.simulate.rws import FILES_V2, FORM, USER, Access, RwsServer
from planner.simulate.servers import TIMEOUT, WINDOW, Ended, ProgramSocket
from planner.simulate.start import Simulated, start

LINES = tuple(f"G1 E{0.1 + 0.01 * k:.3f} F300" for k in range(40))


def client_of(simulated: Simulated, password: str = "robotics") -> RWS:
    return RWS("http://{}:{}".format(*simulated.rws), password=password)


def load(rws: RWS, text: str = MODULE) -> None:
    rws.upload_file("$HOME/Made.mod", text.encode())
    load_module(rws, "Made", replace="true")
    rws.resetpp()


def load_module(rws: RWS, name: str, **form: str) -> None:
    rws._do_post("rw/mastership/rapid?action=request", {})
    try:
        rws._do_post("rw/rapid/tasks/T_ROB1?action=loadmod", {"modulepath": f"$HOME/{name}.mod", **form})
    finally:
        rws._do_post("rw/mastership/rapid?action=release", {})


def until(holds: Callable[[], bool], seconds: float = 15.0) -> bool:
    since = time.monotonic()
    while not holds() and time.monotonic() - since < seconds:
        time.sleep(0.01)
    return holds()


def started(**options: object) -> tuple[Simulated, RWS]:
    lines = options.pop("lines", LINES)
    simulated = start(pace=20.0, read=reader(program(lines)), **options)  # type: ignore[arg-type]
    rws = client_of(simulated)
    load(rws)
    rws.start(cycle="once")
    return simulated, rws


def test_own_clock_takes_what_the_slowest_part_takes() -> None:
    made = program(("M83", "G1 E1 F60"), moves=3)
    motion = own_clock(made)
    assert motion.duration == pytest.approx(0.2)
    assert [(h.kind, pytest.approx(h.time), h.text) for h in motion.happenings] == [
        (SEND, 0.0, "M83"),
        (OUTPUT, 0.0, "doExtrude=1"),
        (SEND, 0.1, "G1 E1 F60"),
        (OUTPUT, 0.2, "doExtrude=0"),
    ]
    move, tip = motion.at(0.15)
    assert move == 2 and tip == pytest.approx([0.015, 0.0, 0.0])
    turned = np.array([[0, 0, 0, 1], [0, 0, np.sin(0.5), np.cos(0.5)], [0, 0, np.sin(0.5), np.cos(0.5)]])
    slow = own_clock(type(made)(**{**vars(made), "quat": turned, "wait": np.array([0.0, 0.5, 0.0])}))
    assert slow.duration == pytest.approx(1.0 + 0.5 + 0.1)


@pytest.mark.parametrize(
    ("speed", "lasts"), [([0.1, 1.0, 0.5, np.radians(100.0)], 2.0), ([0.1, 1.0, 0.05, np.radians(100.0)], 10.0)]
)
def test_own_clock_gives_a_rail_the_time_of_an_axis_that_slides(speed: list[float], lasts: float) -> None:
    made = program(moves=2)
    external = np.full((2, 6), np.nan)
    external[:, 0] = np.radians([0.0, 1000.0])  # mm, read as degrees
    assert own_clock(replace(made, external=external, speed=np.array([speed, speed]))).duration == pytest.approx(lasts)


def test_a_program_that_we_write_runs_from_upload_to_end() -> None:
    plan = make_plan()
    with start(pace=10.0) as simulated:
        rws = client_of(simulated)
        assert rws.get_operation_mode() == "AUTO" and rws.get_controller_state() == "motoron"
        assert rws.get_tasks()["T_ROB1"].motiontask
        load(rws, rapid(plan))
        assert rws.get_execution_state().ctrlexecstate == "stopped"
        rws.start(cycle="once")
        assert rws.get_execution_state().ctrlexecstate == "running"
        seen = set()
        assert until(lambda: seen.add(simulated.state().outputs.get("doExtrude")) or simulated.state().reason != "")
        state = simulated.state()
        assert state.reason == "finished" and state.outputs == {"doExtrude": False} and True in seen
        # the fixture travels five times as fast as its program may, so the plan's own time is no measure
        assert state.time == pytest.approx(own_clock(read_rapid(rapid(plan))).duration)
        assert np.allclose(state.tip, plan.trajectory.tip[-1], atol=1e-3)
        assert rws.get_execution_state().ctrlexecstate == "stopped"


def test_files_of_the_controller() -> None:
    with start() as simulated:
        rws = client_of(simulated)
        rws.upload_file("$HOME/a.mod", b"abc")
        rws.upload_file("$home/b.mod", b"abcd")
        assert rws.list_files("$HOME") == ["a.mod", "b.mod"] and rws.read_file("$HOME/b.mod") == b"abcd"
        rws.delete_file("$HOME/a.mod")
        assert rws.list_files("$HOME") == ["b.mod"]
        for path in ("$HOME/../x", "$HOME/a/b.mod", "/etc/passwd", "$HOME/..", "HOME:/a.mod", "%24HOME/a.mod"):
            with pytest.raises(Exception, match="Not Found"):
                rws.upload_file(path.replace("..", "%2e%2e"), b"")


def test_what_is_not_allowed_is_denied() -> None:
    with start(read=reader(program())) as simulated:
        wrong = client_of(simulated, "robotic")
        with pytest.raises(Exception, match="401"):
            wrong.get_execution_state()
        rws = client_of(simulated)
        with pytest.raises(Exception, match="no program pointer"):
            rws.start()
        with pytest.raises(Exception, match="no program is loaded"):
            rws.resetpp()
        load(rws)
        with pytest.raises(Exception, match="loaded already"):
            load_module(rws, "Made")
        simulated.controller.motors = "motoroff"
        with pytest.raises(Exception, match="motors"):
            rws.start()
        simulated.controller.motors = "motoron"
        rws.start()
        for deed in (rws.start, rws.resetpp, lambda: load(rws)):
            with pytest.raises(Exception, match="is running"):
                deed()
        rws.stop()
        assert rws.get_execution_state().ctrlexecstate == "stopped"
        rws.resetpp()
    with start() as simulated, pytest.raises(Exception, match="errors"):
        load(client_of(simulated), MODULE.replace("ENDPROC", "MoveL nowhere;\nENDPROC"))


def test_lines_come_numbered_in_time_and_acknowledged() -> None:
    simulated, _ = started()
    with simulated, closing(Client(simulated.program)) as pc:
        assert pc.read() == f"H Made {len(LINES)}"
        pc.say("G 1")
        for n, text in enumerate(LINES, 1):
            assert pc.read() == f"L {n} {text}"
            pc.say(f"A {n}")
        assert pc.read() == f"E {len(LINES)}" and pc.read() == ""
        assert until(lambda: simulated.state().reason == "finished")
        assert simulated.state().acknowledged == len(LINES)


@pytest.mark.slow
def test_no_more_than_the_window_is_out_and_silence_stops_it() -> None:
    simulated, _ = started()
    with simulated, closing(Client(simulated.program)) as pc:
        pc.read()
        pc.say("G 1")
        got = [pc.read() for _ in range(WINDOW)]
        pc.say("A 1")
        since = time.monotonic()
        got += [pc.read(), pc.read()]
        assert got[-2] == f"L {WINDOW + 1} {LINES[WINDOW]}"
        assert got[-1] == f"X {WINDOW + 1} no acknowledgement for 2 s"
        assert 0.9 * TIMEOUT < time.monotonic() - since < 2 * TIMEOUT
        assert until(lambda: simulated.state().outputs == {"doExtrude": False})


@pytest.mark.slow
def test_it_rests_until_heating_is_over() -> None:
    simulated, _ = started(lines=("M109 S200", *LINES))
    with simulated, closing(Client(simulated.program)) as pc:
        pc.read()
        pc.say("G 1")
        assert pc.read() == "L 1 M109 S200"
        time.sleep(TIMEOUT + 0.3)
        assert simulated.state().sent == 1 and simulated.state().move == 0
        pc.say("A 1")
        assert pc.read() == f"L 2 {LINES[0]}"


def test_a_program_that_we_write_for_the_socket_sends_its_table() -> None:
    plan = socket_plan()
    made = rapid_files(plan)
    table = [row.split(",") for row in made["OneBead_lines.csv"].splitlines()[1:]]
    with start(pace=20.0, cell=plan.cell) as simulated:
        rws = client_of(simulated)
        load(rws, made["OneBead.mod"])
        rws.start(cycle="once")
        with closing(Client(simulated.program)) as pc:
            assert pc.read() == f"H OneBead {len(table)}"
            pc.say("G 1")
            for n, *_, text in table:
                assert pc.read() == f"L {n} {text}"
                pc.say(f"A {n}")
            assert pc.read() == f"E {len(table)}"
        assert until(lambda: simulated.state().reason == "finished")
        # the player accelerates, so it is later than programmed speeds alone
        slower = simulated.state().time
    program = read_rapid(made["OneBead.mod"])
    assert own_clock(program).duration < slower and abs(slower / plan.trajectory.t[-1] - 1.0) < 0.06


def test_a_program_in_modules_is_found_in_home() -> None:
    made = rapid_files(in_modules(make_plan(), 50))
    modules = {name: text for name, text in made.items() if name.endswith(".mod")}
    with start(pace=50.0) as simulated:
        rws = client_of(simulated)
        rws.upload_file("$HOME/Old.mod", made["TwoBeads.mod"].replace("TwoBeads", "Old").encode())
        for name, text in list(modules.items())[:-1]:
            rws.upload_file(f"$HOME/{name}", text.encode())
        load_module(rws, "TwoBeads", replace="true")
        with pytest.raises(Exception, match="errors"):
            rws.resetpp()
        name, text = list(modules.items())[-1]
        rws.upload_file(f"$HOME/{name}", text.encode())
        rws.resetpp()
        rws.start(cycle="once")
        assert len(modules) > 2 and until(lambda: simulated.state().reason == "finished")
        assert simulated.state().move == len(read_rapid(rapid(make_plan())).position) - 1


def test_both_motions_tell_the_same_in_the_same_order() -> None:
    plan = socket_plan()
    program = read_rapid(rapid_files(plan)["OneBead.mod"])
    own, played = own_clock(program), played_motion(program, plan.cell)
    assert [(h.kind, h.text) for h in own.happenings] == [(h.kind, h.text) for h in played.happenings]
    # the robot rests for 4 s while all is heated, and 1 s before and after the cut of 2 s
    heated, cut = (h.time for h in own.happenings if h.kind == SETTLE)
    assert heated == pytest.approx(4.0)
    begun = next(h.time for h in own.happenings if h.text == "M106 P0 S1")
    assert cut - begun == pytest.approx(2.0)
    move, tip = played.at(played.duration)
    assert move == len(program.position) - 1 and np.allclose(tip, program.position[-1], atol=1e-5)


@pytest.mark.slow(keep=2)
@pytest.mark.parametrize(
    ("answer", "reason"),
    [
        ("G 2", "cannot begin with line 2"),
        ("A 1", "line 1 acknowledged"),
        ("G 1\nG 1", "cannot begin"),
        ("G 1\nA 500", "line 500 acknowledged"),
        ("G 1\nA 0", "line 0 acknowledged"),
        ("G 1\nS board lost", "stopped from outside: board lost"),
        ("G 01", "unknown answer"),
        ("hello", "unknown answer"),
        ("G 1\n" + "x" * 200, "garbage"),
    ],
)
def test_wrong_answers_stop_it(answer: str, reason: str) -> None:
    simulated, _ = started()
    with simulated, closing(Client(simulated.program)) as pc:
        pc.read()
        pc.say(answer)
        last = ""
        while line := pc.read():
            last = line
        assert last.startswith("X ") and reason in last
        assert until(lambda: reason in simulated.state().reason)


def test_a_lost_connection_stops_it() -> None:
    simulated, _ = started()
    with simulated:
        with closing(Client(simulated.program)) as pc:
            pc.read()
            pc.say("G 1")
            pc.read()
        assert until(lambda: simulated.state().reason == "connection lost")


@pytest.mark.parametrize(
    ("fault", "end"),
    [
        ("drop@5", ["L 5 G1 E0.140 F300", ""]),
        ("stop@5", ["L 5 G1 E0.140 F300", "X 5 stopped at the controller"]),
        ("skip@5", ["L 4 G1 E0.130 F300", "L 6 G1 E0.150 F300"]),
        ("garbage@5", ["L 4 G1 E0.130 F300", "\x80L ?\x07"]),
    ],
)
def test_faults_of_the_controller(fault: str, end: list[str]) -> None:
    simulated, _ = started(controller_faults=(fault,))
    with simulated, closing(Client(simulated.program)) as pc:
        pc.read()
        pc.say("G 1")
        lines = [pc.read() for _ in range(6)]
        assert lines[-2:] == end or lines[-3:-1] == end


@pytest.mark.slow
def test_a_restart_loses_program_and_network() -> None:
    simulated, rws = started(controller_faults=("restart@3",))
    with simulated, closing(Client(simulated.program)) as pc:
        pc.read()
        pc.say("G 1")
        assert [pc.read() for _ in range(4)][-2:] == [f"L 3 {LINES[2]}", ""]
        with pytest.raises(Exception, match="Internal Server Error"):  # so the client calls a 503
            rws.get_execution_state()
        assert until(lambda: not simulated.controller.silent)
        assert rws.get_controller_state() == "motoroff" and simulated.state() is None


def test_a_stop_from_the_network_keeps_the_place() -> None:
    simulated, rws = started()
    with simulated, closing(Client(simulated.program)) as pc:
        pc.read()
        pc.say("G 1")
        pc.read()
        rws.stop()
        time.sleep(0.1)
        at = simulated.state().time
        time.sleep(0.2)
        assert simulated.state().time == at and simulated.state().reason == ""
        rws.start()
        assert until(lambda: simulated.state().time > at)


def test_version_2_with_a_certificate(tmp_path) -> None:
    made = ["openssl", "req", "-x509", "-newkey", "rsa:2048", "-nodes", "-days", "1", "-subj", "/CN=localhost"]
    made += ["-addext", "subjectAltName=IP:127.0.0.1"]
    subprocess.run([*made, "-keyout", tmp_path / "key", "-out", tmp_path / "cert"], check=True, capture_output=True)
    controller = Controller(("127.0.0.1", 0), read=reader(program()))
    access = Access(version=2, certificate=tmp_path / "cert", key=tmp_path / "key")
    with closing(controller), closing(RwsServer("127.0.0.1", 0, controller, access)) as server:
        base = f"https://127.0.0.1:{server.address[1]}"
        session = requests.Session()
        session.trust_env = False  # or certificates named in the environment come before ours
        session.verify, session.auth = str(tmp_path / "cert"), (USER, "robotics")
        session.headers["Accept"] = "application/hal+json;v=2.0"

        def post(path: str, **form: str) -> int:
            return session.post(base + path, data=form, headers={"Content-Type": FORM[2]}).status_code

        assert requests.get(base + "/rw/panel/opmode", verify=str(tmp_path / "cert")).status_code == 401
        odd = {"Authorization": b"Basic \xe4"}
        assert requests.get(base + "/rw/panel/opmode", headers=odd, verify=str(tmp_path / "cert")).status_code == 401
        assert session.get(base + "/rw/panel/opmode").json()["state"][0]["opmode"] == "AUTO"
        session.put(base + "/fileservice/$HOME/Made.mod", MODULE.encode(), headers={"Content-Type": FILES_V2[0]})
        assert controller.files() == ["Made.mod"]
        path = "/rw/rapid/tasks/T_ROB1/loadmod"
        assert post(path, modulepath="$HOME/Made.mod") == 403
        assert post("/rw/mastership/edit/request") == 204
        assert post(path, modulepath="$HOME/Made.mod") == 204
        assert post("/rw/rapid/execution/resetpp") == 204
        assert session.get(base + "/rw/rapid/tasks").json()["_embedded"]["resources"][0]["name"] == "T_ROB1"
        assert post("/rw/rapid/execution/stop") == 204


def test_a_page_in_a_browser_ends_a_program_and_moves_nothing() -> None:
    with socket.create_server(("127.0.0.1", 0)) as listener, socket.create_connection(listener.getsockname()) as there:
        here, _ = listener.accept()
        lines = ProgramSocket(here)
        there.sendall(b"POST / HTTP/1.1\r\nContent-Length: 4\r\n\r\nG 1\n")
        with pytest.raises(Ended, match=r"unknown answer|garbage"):
            lines.listen(1.0)
        assert not lines.begun
        here.close()
