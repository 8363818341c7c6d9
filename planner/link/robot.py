"""The controller's part of a run: its program's files, made ready, started, watched, and stopped."""

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
# a part that an arm moves: its own module, in a task of its own
_MOVER = re.compile(rb'PERS wobjdata \w+:=\[FALSE,FALSE,"(' + "|".join(TASKS).encode() + rb')"')
_IN_PROGRAM = re.compile(rb"<Module>\s*([^<]*?)\s*</Module>")


def program_files(program: Path) -> dict[str, bytes]:
    """Files of a program by name: its own module first, those that it loads while it runs, and its program file; of two
    tasks, then those of the arm that moves the part.
    """

    def complain(reason: str, hint: str | None = None) -> InputError:
        return InputError(reason, file=program, hint=hint)

    if program.suffix.lower() != ".mod":
        raise complain("is no module of RAPID", "name the .mod that was written in style socket")
    files = _task_files(program)
    for module in list(programs_of(files).values()):
        if module != program.stem:
            files |= _task_files(program.with_name(f"{module}.mod"))
    return files


def programs_of(files: Mapping[str, bytes]) -> dict[str, str]:
    """Task → name of its main module, of a program's files: one task, or two where a second arm moves the part."""
    name = next(iter(files))
    stem, moved = name.removesuffix(".mod"), _MOVER.search(files[name])
    if moved is None:
        return {TASK: stem}
    unit = moved[1].decode("ascii")
    return {task: second_name(stem, unit) if each == unit else stem for each, task in TASKS.items()}


def _task_files(program: Path) -> dict[str, bytes]:
    """Files of one task: its module with main first, those that it loads, and its program file."""

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
    """The file that a program is loaded by: as it was written, or made for a module alone."""
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
# Made ready, and started.

READY = {"mode": "AUTO", "motors": "motoron"}
START_TIME = 5.0  # s in which a program that was started must run
LOOK_TIME = 0.1  # s between looks at that


class Upload(Protocol):
    """A way of files to the controller's HOME."""

    def upload(self, name: str, data: bytes) -> None:
        """Put a file there, in place of one of that name."""
        ...


def check_ready(rws: Rws) -> None:
    """Raises LinkError where the robot cannot be started, or something runs."""
    found = {"mode": rws.mode(), "motors": rws.motors()}
    if found["mode"] != READY["mode"]:
        raise LinkError(f"the controller is in mode {found['mode']}, not in AUTO")
    if found["motors"] != READY["motors"]:
        raise LinkError(f"the robot's motors are not on ({found['motors']})")
    if rws.running():
        raise LinkError("a program runs on the controller")


def bring(rws: Rws, files: Mapping[str, bytes], say: Callable[[str], None], way: Upload | None = None) -> None:
    """Upload the files, load the program of each task in place of what is there, and set the program pointers to main.

    way: of the files, where it is not the web services'.
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
                raise LinkError(f"the controller was to load {module} alone into {task}, and has {there}")
        rws.to_main()


def start(rws: Rws) -> None:
    """Start the program, and see that it runs: a controller may take the request and start nothing.

    Raises LinkError where it does not, or that cannot be told. Whoever calls this stops the robot then.
    """
    rws.start()
    end = time.monotonic() + START_TIME
    while not rws.running(seconds=START_TIME):
        if time.monotonic() > end:
            raise LinkError(f"the controller took the start, and runs nothing (motors: {rws.motors()})")
        time.sleep(LOOK_TIME)


# ----------------------------------------------------------------------------------------------------
# Stopped, and watched.

STOP_TIME = 10.0  # s that stopping may take, all attempts together
STOPPING_TIME = 2.0  # s from the stop to a robot that stands; ABB's arms need 0.3 s
AGAIN_TIME = 0.2  # s between attempts to stop
WATCH_TIME = 1.0  # s between looks at whether the program still runs, where the controller does not tell
SURE_TIME = 5.0  # s between looks where it does
STILL = 2  # looks in a row that find it stopped, for its last words may be under way
LOOK_LIMIT = 3.0  # s for one look
LOST = (
    3  # looks in a row without a right answer, after which the robot could not be stopped over the web services either
)


def stop_robot(rws: Rws) -> str | None:
    """Stop what runs, in a session of its own, as often as it takes; in words what is wrong if it cannot be told that it stands.

    A request that fails may have been carried out or not, so the state of execution has the last word.
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
        refused = error  # it may stand all the same
    end = time.monotonic() + STOPPING_TIME
    while rws.running(STOPPING_TIME):
        if refused is not None:
            raise refused
        if time.monotonic() > end:
            return "the controller took the stop, and goes on"
        time.sleep(LOOK_TIME)
    return None


class RobotWatch:
    """Watches a running program from a thread of its own, stops it, and lets it pause and go on when asked to.

    The controller tells changes of its state over a subscription; where it has none, or that is lost, it is asked.
    """

    def __init__(self, rws: Rws, ask: Callable[[Order], None], through: Callable[[], bool]) -> None:
        """ask: is told why the run is to end, and when the robot stands or goes on; through: the program has ended."""
        self._rws, self._ask, self._through = rws, ask, through
        self._over, self._paused, self._stands = threading.Event(), threading.Event(), threading.Event()
        self._stopped: str | None = None
        self._stopper: threading.Thread | None = None
        self._hand = ThreadPoolExecutor(1, "hand")  # one thing after the other
        self._going_on = False  # a start is under way, or was when it was to stop
        self.subscribed = False
        self._thread = threading.Thread(target=self._watch, name="robot", daemon=True)
        self._thread.start()

    def stop(self, reason: str) -> None:
        """Stop the robot, without waiting for it: neither here nor for a look that is under way."""
        self._over.set()
        if self._stopper is None:
            self._stopper = threading.Thread(target=self._stop, name="stop", daemon=True)
            self._stopper.start()

    def pause(self) -> None:
        """Stop the robot where it is, without waiting for it; `RobotStands` is asked for once it does."""
        self._paused.set()
        self._hand.submit(self._pause)

    def go_on(self) -> None:
        """Let the program go on where it stands, without waiting for it; `RobotMoves` is asked for once it does."""
        self._hand.submit(self._go_on)

    def close(self) -> str | None:
        """End the watch; in words what went wrong with stopping, None if nothing did."""
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
        self._paused.set()  # once more: it may have been going on when it was asked to pause
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
            return None  # asking does, too
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
