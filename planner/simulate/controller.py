"""A robot controller's inside: files, loaded modules, the program that runs, and what may be done when."""

from __future__ import annotations

import re
import shutil
import tempfile
import threading
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path

from planner.errors import InputError
from planner.export.program import Program
from planner.export.rapid.reader import read_rapid_files
from planner.simulate.faults import Fault
from planner.simulate.motion import Motion, own_clock
from planner.simulate.run import Run, RunState

LARGEST_FILE = 64 << 20  # bytes
MOST_FILES = 1000
RESTART_TIME = 2.0  # wall s in which a controller that restarts answers nothing
TASK = "T_ROB1"
_PLAIN = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.-]{0,63}")
_HOME = re.compile(r"(?i)(?:\$home|home:)/?")
_MODULE = re.compile(r"(?im)^\s*MODULE\s+([A-Za-z]\w{0,31})")

Reader = Callable[[Mapping[str, str]], Program]


class Denied(Exception):
    """The controller does not do that now: carries the HTTP status that says so."""

    def __init__(self, status: int, reason: str) -> None:
        self.status, self.reason = status, reason
        super().__init__(reason)


class Controller:
    """Its state; safe to use from several threads. Files are kept in a temporary folder until `close`.

    address   where programs listen for who takes their lines
    read      modules (name → text) → program; raises InputError
    move      program → its motion; raises InputError for what cannot be reached
    """

    def __init__(
        self,
        address: tuple[str, int],
        pace: float = 1.0,
        faults: Sequence[Fault] = (),
        read: Reader | None = None,
        move: Callable[[Program], Motion] = own_clock,
    ) -> None:
        self._address, self._pace, self._faults = address, pace, tuple(faults)
        self._read, self._move = read or read_modules, move
        self._home = Path(tempfile.mkdtemp(prefix="beadwise-controller-"))
        self._lock = threading.RLock()
        self._modules: dict[str, str] = {}
        self._run: Run | None = None
        self._silent_until = 0.0
        self.motors, self.mode = "motoron", "AUTO"

    def close(self) -> None:
        """End what runs and take the files away."""
        with self._lock:
            self._end_run()
            shutil.rmtree(self._home, ignore_errors=True)

    def state(self) -> RunState | None:
        """Where the program is; None if none was made ready since the start."""
        with self._lock:
            return None if self._run is None else self._run.state()

    @property
    def silent(self) -> bool:
        """It restarts and answers nothing."""
        with self._lock:
            if self._run is not None and self._run.restarted.is_set():
                self._end_run()
                self._run = None
                self._modules.clear()
                self._faults = ()
                self.motors = "motoroff"
                self._silent_until = time.monotonic() + RESTART_TIME
            return time.monotonic() < self._silent_until

    @property
    def running(self) -> bool:
        with self._lock:
            return self._run is not None and self._run.going

    def put(self, path: str, data: bytes) -> None:
        """Keep a file."""
        place = self._place(path)
        with self._lock:
            if not place.exists() and len(list(self._home.iterdir())) >= MOST_FILES:
                raise Denied(507, "no room for another file")
            place.write_bytes(data)

    def get(self, path: str) -> bytes:
        """A file's bytes."""
        place = self._place(path)
        if not place.is_file():
            raise Denied(404, "no such file")
        return place.read_bytes()

    def delete(self, path: str) -> None:
        """Take a file away."""
        place = self._place(path)
        if not place.is_file():
            raise Denied(404, "no such file")
        place.unlink()

    def files(self) -> list[str]:
        """Names of all files."""
        return sorted(each.name for each in self._home.iterdir())

    def load(self, path: str, replace: bool) -> None:
        """Load a module into the task; the program pointer is lost."""
        with self._lock:
            self._stopped()
            try:
                text = self.get(path).decode("ascii")
            except UnicodeDecodeError as error:
                raise Denied(400, "the module is not ASCII") from error
            match = _MODULE.search(text)
            if match is None:
                raise Denied(400, "no MODULE in the file")
            if match[1] in self._modules and not replace:
                raise Denied(400, f"module {match[1]} is loaded already")
            self._end_run()
            self._modules[match[1]] = text

    def unload(self, name: str) -> None:
        """Unload a module."""
        with self._lock:
            self._stopped()
            if name not in self._modules:
                raise Denied(404, "no such module")
            self._end_run()
            del self._modules[name]

    def modules(self) -> list[str]:
        """Names of the loaded modules."""
        with self._lock:
            return list(self._modules)

    def reset_pointer(self) -> None:
        """Program pointer to main: what ran before is over, its sockets are closed."""
        with self._lock:
            self._stopped()
            if not self._modules:
                raise Denied(400, "no program is loaded")
            try:
                program = self._read({**self._loaded_by(self._modules.values()), **self._modules})
                motion = self._move(program)
            except InputError as error:
                raise Denied(400, f"the program has errors: {error}") from error
            self._end_run()
            self._run = Run(program.module, motion, self._pace, self._address, self._faults)

    def start(self) -> None:
        """Run, or go on."""
        with self._lock:
            self._stopped()
            if self.mode != "AUTO" or self.motors != "motoron":
                raise Denied(403, "not in automatic mode with motors on")
            if self._run is None or self._run.over:
                raise Denied(403, "no program pointer")
            self._run.resume()

    def stop(self) -> None:
        """Stand still; the program keeps its place."""
        with self._lock:
            if self._run is not None:
                self._run.pause()

    def _stopped(self) -> None:
        if self.running:
            raise Denied(403, "a program is running")

    def _end_run(self) -> None:
        if self._run is not None:
            self._run.end()

    def _loaded_by(self, texts: Iterable[str]) -> dict[str, str]:
        """Modules in HOME that texts name, as a program does that loads them while it runs."""
        said = "\n".join(texts)
        out: dict[str, str] = {}
        for path in sorted(self._home.glob("*.mod")):
            if f'"{path.name}"' in said:
                text = path.read_text("ascii", errors="replace")
                match = _MODULE.search(text)
                out |= {} if match is None else {match[1]: text}
        return out

    def _place(self, path: str) -> Path:
        """A file's place, for `HOME:/name` or `$HOME/name` only."""
        home = _HOME.match(path)
        name = path[home.end() :] if home else ""
        if not _PLAIN.fullmatch(name):
            raise Denied(404, "only files directly in HOME:")
        return self._home / name


def read_modules(modules: Mapping[str, str]) -> Program:
    """The program of modules (name → text), one of which has the main procedure."""
    return read_rapid_files({f"{name}.mod": text for name, text in modules.items()})
