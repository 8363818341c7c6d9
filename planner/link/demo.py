"""`--demo`: a print on simulators of the controller and the board, from its problem to its last line.

The only module of the link that knows of the simulators; it uses only the addresses on which they listen.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

from planner.base.errors import EXIT_VERIFIED, InputError
from planner.export.rapid.reader import read_rapid_files
from planner.link.as_written import differing
from planner.link.connections import Address, LinkError
from planner.link.robot import bring, program_files, programs_of, start, stop_robot
from planner.link.rws import Rws
from planner.planning.solve_command import main as solve
from planner.simulate.rws import Access
from planner.simulate.start import start as start_simulators

PROBLEM = "cylinder_logo"
CHANGES = ("layers.count=1", "program.style=socket")
PASSWORD = "simulated"  # of a controller that listens on this computer only, while the demo lasts
FOLDER = Path("out/demo")
SECOND = "SecondProgram"


def demo_program(say: Callable[[str], None]) -> Path:
    """The demo's program, solved unless it already exists; InputError if solving fails."""
    found = _found()
    if found is None:
        say(f"solving {PROBLEM} with one layer into {FOLDER}, which takes half a minute")
        changes = [word for change in CHANGES for word in ("--set", change)]
        code = solve([PROBLEM, *changes, "--out", str(FOLDER)])
        found = _found()
        if code != EXIT_VERIFIED or found is None:
            raise InputError(f"{PROBLEM} was not solved (exit code {code})")
    return found


@contextmanager
def simulated(pace: float, version: int = 1, arms: int = 1) -> Iterator[tuple[Address, Address, Address]]:
    """Run both simulators: yields the addresses of the controller's web services, its program, and the board.

    The web services are strict, and another program is already loaded, as on a controller in use.
    """
    access = Access(password=PASSWORD, version=version)
    with start_simulators(pace=pace, access=access, in_use=True, arms=arms) as made:
        yield Address(*made.rws), Address(*made.program), Address(*made.board)


def show_steps(rws: Rws, program: Path, say: Callable[[str], None]) -> None:
    """Try what daily use needs besides a print: a second run, a stop, a second program, an empty task.

    Raises LinkError if the controller fails at one of them.
    """
    files = program_files(program)
    quiet: Callable[[str], None] = lambda text: None  # noqa: E731
    for which, what in ((files, program.stem), (_renamed(files, program.stem), SECOND), (files, program.stem)):
        bring(rws, which, quiet)
        start(rws)
        say(f"{what}: uploaded, loaded alone, and running")
        if (wrong := stop_robot(rws)) is not None:
            raise LinkError(f"{what} does not stop: {wrong}")
        say(f"{what}: stopped")
    tasks = programs_of(files)
    with rws.mastership():
        for task in tasks:
            rws.unload(task)
    for task in tasks:
        if rws.modules(task):
            raise LinkError(f"the task {task} is not empty")
    say(f"unloaded: {'both tasks are' if len(tasks) > 1 else 'the task is'} empty")


def _renamed(files: Mapping[str, bytes], stem: str) -> dict[str, bytes]:
    """A copy of a program under another name, as a second program."""
    old, new = re.compile(rb"\b" + stem.encode() + rb"(?=\b|_\d|_Rob\d)"), SECOND.encode()
    return {name.replace(stem, SECOND): old.sub(new, data) for name, data in files.items()}


def _found() -> Path | None:
    """The existing program; None if there is none, it was changed, or another version wrote it unreadably."""
    tables = sorted(FOLDER.glob("*_lines.csv"))
    if not tables:
        return None
    try:
        read_rapid_files({path.name: path.read_text(encoding="utf-8") for path in FOLDER.glob("*.mod")})
        if differing(FOLDER, [path.name for path in (*FOLDER.glob("*.mod"), *tables)]):
            return None
    except (InputError, OSError, UnicodeDecodeError):
        return None
    return tables[0].with_name(tables[0].name.removesuffix("_lines.csv") + ".mod")
