"""The controller's part of a run: its program's files are uploaded, started, monitored, and stopped."""

from __future__ import annotations

import re
import threading
import time
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Protocol

from planner.base.errors import InputError
from planner.base.files import read_bytes
from planner.export.rapid.multimove import TASKS, second_name
from planner.link.connections import LinkError
from planner.link.orders import Order, RobotMoves, RobotStands, StopOrder
from planner.link.rws import TASK, ExecutionEvents, Rws

# ----------------------------------------------------------------------------------------------------
# The files of a program.

LARGEST_MODULE = 100_000_000  # bytes
_LOADED = re.compile(rb'\\File:="([A-Za-z][A-Za-z0-9_]{0,31}\.mod)"')
_HELLO = re.compile(rb'"H ([A-Za-z][A-Za-z0-9_]{0,31}) ([0-9]{1,9})\\0A"')
# a part moved by a second arm, whose module runs in its own task
_MOVER = re.compile(rb'PERS wobjdata \w+:=\[FALSE,FALSE,"(' + "|".join(TASKS).encode() + rb')"')
_IN_PROGRAM = re.compile(rb"<Module>\s*([^<]*?)\s*</Module>")


def program_files(program: Path) -> dict[str, bytes]:
    """Files of a program by name: its own module first, modules that it loads while it runs, and its program file; with
    two tasks, followed by those of the arm that moves the part.
    """

    def complain(reason: str, hint: str | None = None) -> InputError:
        return InputError(reason, file=program, hint=hint)

    if program.suffix.lower() != ".mod":
        raise complain("is not a RAPID module", "name the .mod that was written in style socket")
    files = _task_files(program)
    for module in list(programs_of(files).values()):
        if module != program.stem:
            files |= _task_files(program.with_name(f"{module}.mod"))
    return files


def programs_of(files: Mapping[str, bytes]) -> dict[str, str]:
    """Task → name of its main module, from a program's files: one task, or two if a second arm moves the part."""
    name = next(iter(files))
    stem, moved = name.removesuffix(".mod"), _MOVER.search(files[name])
    if moved is None:
        return {TASK: stem}
    unit = moved[1].decode("ascii")
    return {task: second_name(stem, unit) if each == unit else stem for each, task in TASKS.items()}


def _task_files(program: Path) -> dict[str, bytes]:
    """Files of one task: its module with main first, modules that it loads, and its program file."""

    def complain(reason: str, hint: str | None = None) -> InputError:
        return InputError(reason, file=program, hint=hint)

    main = read_bytes(program, LARGEST_MODULE, complain)
    if main.split(b"\n", 1)[0].split()[:2] != [b"MODULE", program.stem.encode()]:
        raise complain(f"its first line is not MODULE {program.stem}", "the file's name must be the module's")
    loaded = dict.fromkeys(name.decode("ascii") for name in _LOADED.findall(main))
    others = [program.with_name(name) for name in loaded]
    files = {program.name: main} | {path.name: read_bytes(path, LARGEST_MODULE, complain) for path in others}
    for name, data in files.items():
        if not data.rstrip().endswith(b"ENDMODULE"):
            raise InputError("does not end with ENDMODULE", file=program.with_name(name), hint="it was cut off")
    return {**files, f"{program.stem}.pgf": _program_file(program.with_suffix(".pgf"), program.name)}


def _program_file(path: Path, module: str) -> bytes:
    """The file by which a program is loaded: as written, or made for a module alone."""
    if not path.is_file():
        lines = (
            '<?xml version="1.0" encoding="ISO-8859-1" ?>',
            "<Program>",
            f"\t<Module>{module}</Module>",
            "</Program>",
        )
        return ("\n".join(lines) + "\n").encode("ascii")
    data = read_bytes(path, LARGEST_MODULE, lambda reason, hint=None: InputError(reason, file=path, hint=hint))
    if _IN_PROGRAM.findall(data) != [module.encode()]:
        raise InputError(f"does not name {module} alone", file=path, hint="both must be as they were written together")
    return data


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


# ----------------------------------------------------------------------------------------------------
# Preparing and starting the program.

READY = {"mode": "AUTO", "motors": "motoron"}
START_TIME = 5.0  # s in which a started program must run
LOOK_TIME = 0.1  # s between checks of that


class Upload(Protocol):
    """A means of uploading files to the controller's HOME."""

    def upload(self, name: str, data: bytes) -> None:
        """Put a file there, replacing one of the same name."""
        ...


def check_ready(rws: Rws) -> None:
    """Raises LinkError if the robot cannot be started, or a program is running."""
    found = {"mode": rws.mode(), "motors": rws.motors()}
    if found["mode"] != READY["mode"]:
        raise LinkError(f"the controller is in mode {found['mode']}, not in AUTO")
    if found["motors"] != READY["motors"]:
        raise LinkError(f"the robot's motors are not on ({found['motors']})")
    if rws.running():
        raise LinkError("a program runs on the controller")


def bring(rws: Rws, files: Mapping[str, bytes], say: Callable[[str], None], way: Upload | None = None) -> None:
    """Upload the files, load the program of each task in place of what is there, and set the program pointers to main.

    way: how to upload, if not through the web services
    """
    programs = programs_of(files)
    if len(programs) > 1 and (idle := programs.keys() - rws.active()):
        raise LinkError(f"{min(idle)} is no active task of the controller, and both arms wait for each other")
    for name, data in files.items():
        say(f"uploading {name} ({len(data) / 1e3:.0f} kB)")
        (way or rws).upload(name, data)
    with rws.mastership():
        for task, module in programs.items():
            rws.load(f"{module}.pgf", task)
            loaded = rws.modules(task)
            if loaded != (module,):
                there = ", ".join(loaded[:5]) or "no module"
                raise LinkError(f"the controller was to load {module} alone into {task}, but has {there}")
        rws.to_main()


def start(rws: Rws) -> None:
    """Start the program, and check that it runs: a controller may accept the request and start nothing.

    Raises LinkError if it does not run, or if that is unknown. The caller must then stop the robot.
    """
    rws.start()
    end = time.monotonic() + START_TIME
    while not rws.running(seconds=START_TIME):
        if time.monotonic() > end:
            raise LinkError(f"the controller accepted the start, but runs nothing (motors: {rws.motors()})")
        time.sleep(LOOK_TIME)


# ----------------------------------------------------------------------------------------------------
# Stopping and monitoring the program.

STOP_TIME = 10.0  # s for all attempts to stop together
STOPPING_TIME = 2.0  # s from the stop request to standstill; ABB's arms need 0.3 s
AGAIN_TIME = 0.2  # s between attempts to stop
WATCH_TIME = 1.0  # s between checks that the program still runs, without a subscription
SURE_TIME = 5.0  # s between checks with a subscription
STILL = 2  # consecutive checks that must find it stopped, as its last messages may be under way
LOOK_LIMIT = 3.0  # s for one check
LOST = 3  # consecutive checks without a valid answer, after which the web services could not stop the robot either


def stop_robot(rws: Rws) -> str | None:
    """Stop what runs, in a new session, as often as it takes; returns what is wrong if standstill is not confirmed.

    A failed request may have been carried out or not, so the state of execution is decisive.
    """
    end, wrong = time.monotonic() + STOP_TIME, "no time"
    while time.monotonic() < end:
        fresh = rws.again()
        try:
            wrong = _stopped(fresh) or ""
        except (LinkError, InputError) as error:
            wrong = str(error)
        finally:
            fresh.close(AGAIN_TIME if wrong else STOPPING_TIME)
        if not wrong:
            return None
        time.sleep(AGAIN_TIME)
    return wrong


def _stopped(rws: Rws) -> str | None:
    refused: LinkError | InputError | None = None
    try:
        rws.stop()
    except (LinkError, InputError) as error:
        refused = error  # the robot may stand all the same
    end = time.monotonic() + STOPPING_TIME
    while rws.running(STOPPING_TIME):
        if refused is not None:
            raise refused
        if time.monotonic() > end:
            return "the controller accepted the stop, but goes on"
        time.sleep(LOOK_TIME)
    return None


class RobotWatch:
    """Watches a running program from a separate thread, stops it, and pauses and continues it on request.

    The controller reports changes of its state over a subscription; if it offers none, or that is lost, it is polled.
    """

    def __init__(self, rws: Rws, ask: Callable[[Order], None], through: Callable[[], bool]) -> None:
        """ask: called to stop the run, and once the robot stands or moves; through: whether the program is over."""
        self._rws, self._ask, self._through = rws, ask, through
        self._over, self._paused, self._stands = threading.Event(), threading.Event(), threading.Event()
        self._stopped: str | None = None
        self._stopper: threading.Thread | None = None
        self._hand = ThreadPoolExecutor(1, "hand")  # one task after another
        self._going_on = False  # a start is under way, or was when the robot was to stop
        self.subscribed = False
        self._thread = threading.Thread(target=self._watch, name="robot", daemon=True)
        self._thread.start()

    def stop(self, reason: str) -> None:
        """Stop the robot without waiting for it, or for a check that is under way."""
        self._over.set()
        if self._stopper is None:
            self._stopper = threading.Thread(target=self._stop, name="stop", daemon=True)
            self._stopper.start()

    def pause(self) -> None:
        """Stop the robot where it is, without waiting for it; `RobotStands` is reported once it does."""
        self._paused.set()
        self._hand.submit(self._pause)

    def go_on(self) -> None:
        """Continue the program from where it stands, without waiting for it; `RobotMoves` is reported once it does."""
        self._hand.submit(self._go_on)

    def close(self) -> str | None:
        """End the watch; returns what went wrong with stopping, or None."""
        self._over.set()
        if self._stopper is not None:
            self._stopper.join(STOP_TIME + STOPPING_TIME)
            if self._stopper.is_alive():
                return "the controller's web services do not answer"
        self._hand.shutdown(wait=False, cancel_futures=True)
        self._thread.join(2 * WATCH_TIME)
        return self._stopped

    def _stop(self) -> None:
        self._stopped = stop_robot(self._rws)
        self._hand.shutdown(wait=True, cancel_futures=True)
        if self._going_on:  # a start that was under way may have come after the stop
            self._stopped = stop_robot(self._rws)

    def _pause(self) -> None:
        if self._over.is_set():
            return
        self._paused.set()  # again, as it may have been continuing when the pause was requested
        wrong = stop_robot(self._rws)
        if wrong is None:
            self._stands.set()
        self._ask(RobotStands() if wrong is None else StopOrder(f"the robot was not seen to pause: {wrong}"))

    def _go_on(self) -> None:
        if self._over.is_set():
            return
        self._going_on = True
        self._stands.clear()
        rws = self._rws.again()
        try:
            start(rws)
            self._paused.clear()
            self._ask(RobotMoves())
        except (LinkError, InputError) as error:
            self._ask(StopOrder(f"the robot does not go on: {error}"))
        finally:
            self._going_on = self._over.is_set()
            rws.close()

    def _watch(self) -> None:
        rws = self._rws.again()
        events = self._subscription(rws)
        try:
            self._look(rws, events)
        finally:
            if events is not None:
                events.close()
            rws.close()

    def _subscription(self, rws: Rws) -> ExecutionEvents | None:
        try:
            events = rws.subscribe()
        except (LinkError, InputError):
            return None  # polling works too
        self.subscribed = True
        return events

    def _look(self, rws: Rws, events: ExecutionEvents | None) -> None:
        still = lost = 0
        looked = -SURE_TIME
        while not self._over.is_set():
            told = None
            try:
                if events is None or still:
                    self._over.wait(WATCH_TIME)
                else:
                    told = events.next(WATCH_TIME)
            except LinkError:
                events = None
                self.subscribed = False
            if self._over.is_set():
                return
            if events is not None and told is None and not (still or lost) and time.monotonic() - looked < SURE_TIME:
                continue
            looked, stood = time.monotonic(), self._stands.is_set()
            try:
                still = 0 if rws.running(LOOK_LIMIT) else still + 1
                lost = 0
                if stood and self._stands.is_set() and not still:
                    self._ask(StopOrder("the program was started on the controller while it was paused"))
                    return
            except (LinkError, InputError) as error:
                lost += 1
                if lost >= LOST:
                    self._ask(StopOrder(f"the robot cannot be watched any more: {error}"))
                    return
            if self._paused.is_set():
                still = 0
            elif still >= STILL and not self._through():
                self._ask(StopOrder("the program was stopped on the controller"))
                return
