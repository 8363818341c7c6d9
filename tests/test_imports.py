"""What commands import: packages that read one kind of source, or write one kind of file, come with that kind only."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
# Of sources, pictures, references, servers and clusters.
OF_SOME = {"trimesh", "shapely", "svgelements", "pyvrp", "OCP", "PIL", "matplotlib", "casadi", "osqp", "tornado"}
LANGUAGES = (
    "axes",
    "extruder",
    "fanuc",
    "inform",
    "joint_trajectory",
    "kawasaki",
    "krl",
    "melfa",
    "rapid",
    "urscript",
    "val3",
)


def modules_after(code: str) -> set[str]:
    """Names of all modules that a process of its own has after some code."""
    told = f"{code}\nimport sys; print(*sys.modules)"
    ran = subprocess.run([sys.executable, "-c", told], cwd=ROOT, capture_output=True, text=True, check=True)
    return set(ran.stdout.splitlines()[-1].split())


@pytest.mark.slow
def test_a_command_starts_without_what_only_some_problems_need() -> None:
    loaded = modules_after("import planner.planning.solve_command, planner.report.html")
    assert "planner.planning.pipeline" in loaded and not OF_SOME & loaded
    assert not {f"planner.export.{name}.{what}" for name in LANGUAGES for what in ("writer", "check")} & loaded


def test_the_live_view_starts_without_what_its_solver_needs() -> None:
    """It reads robots' files to follow them, and nothing else of a robot."""
    loaded = modules_after("import planner.view.command")
    assert "planner.cell.robot_file" in loaded and not {"numba", "pinocchio", "coal", "scipy"} & loaded


@pytest.mark.slow
@pytest.mark.parametrize(("problem", "needed"), [("peer_cap", set()), ("cylinder_logo", {"shapely", "svgelements"})])
def test_a_source_brings_its_own_packages(problem: str, needed: set[str]) -> None:
    loaded = modules_after(f"from planner.planning.check_command import main; main([{problem!r}])")
    assert "planner.toolpath.build" in loaded
    assert OF_SOME & loaded == needed


def test_a_command_looks_for_garbage_once_it_runs() -> None:
    """Not while it is imported, nor when it has ended: then there is nothing that would not go with the process."""
    code = """
import gc, pathlib, sys, tempfile
from planner.base import launch
folder = tempfile.mkdtemp()
text = "import gc; told = [gc.isenabled()]; main = lambda _: told.append(gc.isenabled()) or print(*told) or 0"
pathlib.Path(folder, "made_up.py").write_text(text)
sys.path.insert(0, folder)
launch.COMMANDS["made_up"] = launch.CommandModule("made_up", "")
launch.launch("made_up", [])
print(gc.isenabled(), gc.get_freeze_count() > 0)
"""
    ran = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    assert ran.stdout.split() == ["False", "True", "True", "True"]


def test_whoever_imports_the_package_keeps_python_s_ways() -> None:
    code = "import gc, planner, planner.base.command_line; print(gc.isenabled(), gc.get_freeze_count())"
    ran = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    assert ran.stdout.split() == ["True", "0"]
