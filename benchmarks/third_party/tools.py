"""Which parser or interpreter reads which files, and what it answers."""

from __future__ import annotations

import json
import shutil
import subprocess
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from benchmarks.third_party.written import Written

HERE = Path(__file__).resolve().parent
PYTHON = Path(".venv-third-party/bin/python")
SYSTEM_PYTHON = Path("/usr/bin/python3")  # Debian's modules are those of its own Python
LIMIT_S = 600.0  # for one tool on one program


@dataclass(frozen=True)
class Answer:
    """What a tool says of files; accepted is None where it did not run. Time [s], filament and path [mm]."""

    version: str
    accepted: bool | None
    said: str
    time: float | None = None
    filament: float | None = None
    path: float | None = None


@dataclass(frozen=True)
class Tool:
    """A parser or an interpreter.

    languages  those that it reads, as Written names them; endings: of the files among them
    command    from Python and files to what is run
    package    of Debian, where it comes from there
    """

    name: str
    languages: tuple[str, ...]
    endings: tuple[str, ...]
    command: Callable[[Path, tuple[Path, ...]], list[str]]
    package: str | None = None

    def reads(self, program: Written) -> bool:
        """Whether files of a program are for it."""
        return program.language in self.languages and bool(program.of(*self.endings))

    def answer(self, python: Path, program: Written) -> Answer:
        """What it says of a program."""
        if self.package is not None and (version := _debian(self.package)) is None:
            return Answer("", None, f"not installed: apt-get install {self.package}")
        if self.package is None and not python.is_file():
            return Answer("", None, f"not installed: there is no {python}; make third-party sets it up")
        own = SYSTEM_PYTHON if self.package is not None else python
        command = self.command(own, program.of(*self.endings))
        try:
            ran = subprocess.run(command, capture_output=True, text=True, timeout=LIMIT_S, check=False)
        except subprocess.TimeoutExpired:
            return Answer("", False, f"not done in {LIMIT_S:g} s")
        if ran.returncode != 0:
            return Answer("", False, "ends with: " + (ran.stderr.strip().rsplit("\n", 1)[-1] or str(ran.returncode)))
        told = json.loads(ran.stdout)
        return Answer(**({"version": version} if self.package is not None else {}) | told)


def _debian(package: str) -> str | None:
    """Version of a package of Debian's; None where it is not installed."""
    if shutil.which("dpkg-query") is None:
        return None
    command = ["dpkg-query", "--show", "--showformat", "${Version}", package]
    ran = subprocess.run(command, capture_output=True, text=True, check=False)
    return ran.stdout.strip() or None if ran.returncode == 0 else None


def _parser(name: str) -> Callable[[Path, tuple[Path, ...]], list[str]]:
    def command(python: Path, files: tuple[Path, ...]) -> list[str]:
        return [str(python), str(HERE / "run_parsers.py"), name, *map(str, files)]

    return command


def _klipper(python: Path, files: tuple[Path, ...]) -> list[str]:
    return [str(python), str(HERE / "run_klipper.py"), str(files[0])]


def _linuxcnc(python: Path, files: tuple[Path, ...]) -> list[str]:
    return [str(python), str(HERE / "run_linuxcnc.py"), str(files[0]), "W"]


# Waits and loops of RepRapFirmware (M577, while) and the words of Klipper are in no grammar that was found.
GCODE = ("axes linuxcnc", "axes reprap", "extruder marlin")
TOOLS = (
    Tool("rapidchecker", ("rapid",), (".mod",), _parser("rapidchecker")),
    Tool("krllint", ("krl",), (".src", ".dat"), _parser("krllint")),
    Tool("libxml2 (lxml)", ("val3",), (".pjx", ".dtx", ".pgx"), _parser("lxml")),
    Tool("libxml2 (lxml)", ("rapid",), (".pgf",), _parser("lxml")),
    Tool("rosbags", ("joint_trajectory",), ("_joint_trajectory.json",), _parser("rosbags")),
    Tool("tree-sitter-gcode", GCODE, (".ngc", ".gcode"), _parser("tree_sitter_gcode")),
    Tool("pygcode", ("axes reprap", "extruder marlin"), (".gcode",), _parser("pygcode")),
    Tool("LinuxCNC", ("axes linuxcnc",), (".ngc",), _linuxcnc, "linuxcnc-uspace"),
    Tool("Klipper", ("extruder klipper",), (".gcode",), _klipper),
)
