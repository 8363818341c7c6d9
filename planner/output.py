"""The results' folder: written beside its place and moved there whole, so that nothing half-written is ever seen."""

from __future__ import annotations

import os
import shutil
import signal
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from planner.errors import OutputError

OURS = ("plan.json", "trajectory.csv", "extrusion.gcode", "report.html", "*.mod", "*.pgf")


@contextmanager
def results_folder(target: Path) -> Iterator[Path]:
    """A fresh folder to write into; on success its files take the place of all earlier results in `target`.

    Files in `target` that are not results are left alone. On any exception nothing in `target` changes.
    Raises OutputError, before anything is computed, where `target` cannot be written.
    """
    missing = [folder for folder in (target, *target.parents) if not folder.exists()]
    try:
        target.mkdir(parents=True, exist_ok=True)
        fresh = Path(tempfile.mkdtemp(prefix=".writing-", dir=target))
    except OSError as error:
        raise OutputError(f"cannot write into {target}: {error.strerror}") from error
    try:
        yield fresh
        with _uninterrupted():
            for pattern in OURS:
                for old in target.glob(pattern):
                    old.unlink()
            for new in sorted(fresh.iterdir()):
                os.replace(new, target / new.name)
    except OSError as error:
        raise OutputError(f"cannot write into {target}: {error.strerror}") from error
    finally:
        shutil.rmtree(fresh, ignore_errors=True)
        for folder in missing:  # made here: gone again if nothing came of it
            if folder.is_dir() and not any(folder.iterdir()):
                folder.rmdir()


@contextmanager
def _uninterrupted() -> Iterator[None]:
    """Hold Ctrl-C back for the moment in which files change places; it is delivered afterwards."""
    caught: list[int] = []
    previous = signal.signal(signal.SIGINT, lambda number, _frame: caught.append(number))
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, previous)
    if caught:
        raise KeyboardInterrupt
