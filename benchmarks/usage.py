"""What a run used and where it ran: memory and processor time of a process, the machine, the commit."""

from __future__ import annotations

import hashlib
import os
import platform
import resource
import subprocess
import sys
import time
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path

from planner.base.processes import cores
from planner.base.versions import versions

ROOT = Path(__file__).resolve().parents[1]
MEGABYTE = 1e6  # bytes
# ru_maxrss counts kilobytes on Linux and bytes on macOS
RSS_UNIT = 1 if sys.platform == "darwin" else 1024
# What decides a result: not tests, docs and committed results.
SOURCES = ("planner", "robots", "problems", "benchmarks", ":(exclude)benchmarks/results")
UNKNOWN = "unknown"


@dataclass(frozen=True)
class Usage:
    """Processor time of a run, all its threads and processes together [s], and the most memory that it held [MB]."""

    cpu_s: float
    peak_mb: float


def cpu_seconds() -> float:
    """Processor time of this process and of its children that have ended, user and system together [s]."""
    parts = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(part.ru_utime + part.ru_stime for part in parts)


def peak_mb() -> float:
    """The most memory that this process has held so far, or one of its children that have ended [MB]."""
    parts = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return max(part.ru_maxrss for part in parts) * RSS_UNIT / MEGABYTE


def footer(*packages: str) -> str:
    """The day, the machine's kind, and the versions of what plans a print and of packages beside it."""
    used = versions() | {name: version(name) for name in packages}
    each = ", ".join(f"{name} {number}" for name, number in used.items())
    return f"{time.strftime('%Y-%m-%d')}, {platform.machine()}, {os.cpu_count()} cores; {each}"


def machine() -> str:
    """Processor, cores that may be used, memory, system: what figures depend on, and no name of a computer."""
    memory = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 1e9
    return f"{_processor()}, {cores()} cores, {memory:.0f} GB, {platform.system()} {platform.machine()}"


def _processor() -> str:
    """The processor's name for itself, where Linux tells it."""
    info = Path("/proc/cpuinfo")
    lines = info.read_text(encoding="utf-8", errors="replace").splitlines() if info.is_file() else []
    names = (line.partition(":")[2] for line in lines if line.startswith("model name"))
    return " ".join(next(names, platform.processor() or "processor").replace(",", " ").split())


def commit() -> str:
    """The commit that runs; with a digest of what was changed since, if anything was; "unknown" without git."""
    head = _git("rev-parse", "--short=12", "HEAD").decode().strip()
    if not head:
        return UNKNOWN
    changed = _git("diff", "HEAD", "--binary", "--", *SOURCES)
    return f"{head}+{hashlib.sha256(changed).hexdigest()[:6]}" if changed else head


def _git(*arguments: str) -> bytes:
    """What git says in the project's folder; nothing where there is no git, or no repository."""
    try:
        done = subprocess.run(["git", "-C", str(ROOT), *arguments], capture_output=True, check=False)
    except FileNotFoundError:
        return b""
    return done.stdout if done.returncode == 0 else b""
