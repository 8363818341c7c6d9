"""The controller's part of a run: made ready, started, watched, and stopped, over its web services."""

from __future__ import annotations

import re
import threading
from collections.abc import Callable, Mapping
from pathlib import Path

from planner.errors import InputError
from planner.input_file import read_bytes
from planner.link.rws import Rws
from planner.link.sockets import LinkError

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
    """Raises InputError unless the program says that it will send as many lines as its table has."""
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


class Robot:
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
