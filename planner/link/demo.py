"""`--demo`: a print on simulators of the controller and the board, from its problem to its last line.

The only module of the link that knows of the simulators, and of them only where they listen.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from planner.base.errors import EXIT_VERIFIED, InputError
from planner.export.rapid.reader import read_rapid_files
from planner.link.connections import Address
from planner.planning.solve_command import main as solve
from planner.simulate.start import start

PROBLEM = "cylinder_logo"
CHANGES = ("layers.count=1", "program.style=socket")
PASSWORD = "simulated"  # of a controller that listens on this computer only, for as long as the demo takes
FOLDER = Path("out/demo")


def demo_program(say: Callable[[str], None]) -> Path:
    """The demo's program, solved unless it was before; InputError where that fails."""
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
def simulated(pace: float) -> Iterator[tuple[Address, Address, Address]]:
    """Both simulators: where the controller's web services, its program and the board listen."""
    with start(pace=pace, rws_password=PASSWORD) as made:
        yield Address(*made.rws), Address(*made.program), Address(*made.board)


def _found() -> Path | None:
    """The program that is there; none where another version wrote it otherwise than the simulator reads it."""
    tables = sorted(FOLDER.glob("*_lines.csv"))
    if not tables:
        return None
    try:
        read_rapid_files({path.name: path.read_text(encoding="utf-8") for path in FOLDER.glob("*.mod")})
    except (InputError, OSError, UnicodeDecodeError):
        return None
    return tables[0].with_name(tables[0].name.removesuffix("_lines.csv") + ".mod")
