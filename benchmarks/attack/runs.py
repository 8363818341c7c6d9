"""Whole runs of the command in processes of their own: what they leave, and whether anything of them is left."""

from __future__ import annotations

import contextlib
import ctypes
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path

from planner.base.results import REPLACED, WRITING, digest, listed

ROOT = Path(__file__).resolve().parents[2]
LONGEST = 120.0  # s that a run may take, on a busy machine
GRACE = 5.0  # s in which what a run has started must end after it
_SUBREAPER = 36  # PR_SET_CHILD_SUBREAPER of Linux
OUT = "out"


def environment(**more: str) -> dict[str, str]:
    """That of this process, with this checkout's planner."""
    return {**os.environ, "PYTHONPATH": str(ROOT), **more}


def started(folder: Path, arguments: Sequence[str], env: Mapping[str, str] | None = None) -> subprocess.Popen[bytes]:
    """`planner.solve` in a folder, in a group of processes of its own."""
    return subprocess.Popen(
        [sys.executable, "-m", "planner.solve", *arguments],
        cwd=folder,
        env=dict(env or environment()),
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        start_new_session=True,
    )


def finished(folder: Path, arguments: Sequence[str], env: Mapping[str, str] | None = None) -> tuple[int, str]:
    """The exit code of a whole run, and what it said on its standard error output."""
    with started(folder, arguments, env) as process:
        try:
            _, said = process.communicate(timeout=LONGEST)
        finally:
            process.kill()
    return process.returncode, said.decode("utf-8", "replace")


def adopt() -> None:
    """From here on what outlives its parent becomes this process's child, so that it can be counted."""
    ctypes.CDLL(None, use_errno=True).prctl(_SUBREAPER, 1, 0, 0, 0)


def children(parent: int) -> list[int]:
    """Numbers of a process's children."""
    try:
        text = " ".join(task.read_text() for task in Path(f"/proc/{parent}/task").glob("*/children"))
    except OSError:
        return []
    return [int(number) for number in text.split()]


def state(process: int) -> str:
    """R, S, Z and so on; nothing of a process that is gone."""
    try:
        return Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0]
    except OSError:
        return ""


def zombies(session: int) -> int:
    """How many processes of a run (its number is that of their session) have ended and nobody takes notice of; to be asked
    when the run has ended, and what it left behind has been counted."""
    found = 0
    for path in Path("/proc").glob("[0-9]*/stat"):
        with contextlib.suppress(OSError):
            fields = path.read_text().rpartition(")")[2].split()
            found += int(fields[3]) == session and fields[0] == "Z"
    return found


def orphans() -> int:
    """How many adopted processes still run a while later; they are ended. Those that end by themselves are taken notice of."""
    deadline = time.monotonic() + GRACE
    while True:
        for child in children(os.getpid()):
            if state(child) == "Z":
                os.waitpid(child, 0)
        left = children(os.getpid())
        if not left or time.monotonic() > deadline:
            break
        time.sleep(0.05)
    for child in left:
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)
    return len(left)


def contents(folder: Path) -> dict[str, bytes]:
    """All files of a folder."""
    return (
        {path.name: path.read_bytes() for path in sorted(folder.iterdir()) if path.is_file()} if folder.is_dir() else {}
    )


def left_over(folder: Path) -> list[str]:
    """Folders that only a run that goes on may have."""
    return [path.name for path in folder.iterdir() if path.name.startswith((WRITING, REPLACED))]


def whole(folder: Path) -> str:
    """What is wrong with the results of a folder, or nothing: the manifest's files are all there as they were written."""
    files = listed(folder)
    if not files:
        return "no manifest"
    for name, entry in files.items():
        if not (folder / name).is_file():
            return f"{name} is missing"
        if digest(folder / name) != entry.sha256:
            return f"{name} is not as it was written"
    plan = json.loads((folder / "plan.json").read_bytes())
    wrong = [name for name, sha256 in plan.get("files", {}).items() if digest(folder / name) != sha256]
    return f"{wrong[0]} is not the plan's" if wrong else ""
