"""Every command of the benchmarks starts, says how it is used, and those that plan do so at their smallest."""

from __future__ import annotations

import importlib
import re
from collections.abc import Callable, Sequence
from concurrent import futures
from pathlib import Path

import pytest

from benchmarks import clearance, optimiser, strategies
from benchmarks.peer_cases import write_case
from planner.problem import load_problem

ROOT = Path(__file__).resolve().parents[1]
STARTED_BY_OTHERS = {
    "mesh_runs",
    "single",
    "peers.one",
    *(f"peers.run_{name}" for name in ("pink", "roboplan", "tesseract")),
    *(f"third_party.run_{name}" for name in ("klipper", "linuxcnc", "parsers")),
}
COARSE = ["--set", "resolve.rung_mm=10", "--set", "resolve.roll_step_deg=30", "--set", "resolve.knot_mm=5"]
SMALLEST = {
    "attack": ["--only", "rapid", "gcode", "--count", "8", "--jobs", "1"],
    "bound": ["planar_gcode", *COARSE],
    "collision": ["peer_cap"],
    "collision_cost": ["peer_cap", *COARSE],
    "optimiser": [*COARSE, "--cases", "300", "--sizes", "300"],
    "profile": ["peer_cap@100"],
    "programs": ["peer_cap", *COARSE],
    "relay": ["--seconds", "0.2", "--rate", "100"],
    "strategies": ["peer_cap", *COARSE],
    "targets": ["peer_cap", *COARSE],
    "timing": ["peer_cap", *COARSE],
}


def commands() -> list[str]:
    """Modules that can be started with `python -m benchmarks.`, but for those that others start."""
    found = []
    for path in sorted((ROOT / "benchmarks").rglob("*.py")):
        if '__name__ == "__main__"' in path.read_text(encoding="utf-8"):
            found.append(
                ".".join(path.relative_to(ROOT / "benchmarks").with_suffix("").parts).removesuffix(".__main__")
            )
    return [name for name in found if name not in STARTED_BY_OTHERS]


def main_of(name: str) -> Callable[[Sequence[str]], int]:
    folder = ROOT / "benchmarks" / name.replace(".", "/")
    module = importlib.import_module(f"benchmarks.{name}{'.__main__' if folder.is_dir() else ''}")
    main: Callable[[Sequence[str]], int] = module.main
    return main


def test_there_are_commands() -> None:
    assert len(commands()) > 30
    assert set(SMALLEST) <= set(commands())


def test_the_page_on_how_to_reproduce_names_every_command() -> None:
    page = (ROOT / "docs" / "citing.md").read_text(encoding="utf-8")
    assert set(re.findall(r"`benchmarks\.([a-z_]+)", page)) == {name.split(".")[0] for name in commands()}


@pytest.mark.slow(cases=("cluster",))
@pytest.mark.parametrize("name", commands())
def test_a_command_says_how_it_is_used(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main_of(name)(["--help"])
    assert ended.value.code == 0
    said = capsys.readouterr()
    assert said.out.startswith("usage: ") and said.err == ""


@pytest.mark.slow
@pytest.mark.parametrize("name", SMALLEST)
def test_a_command_runs(name: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(futures, "ThreadPoolExecutor", futures.ThreadPoolExecutor)  # which the profile replaces
    assert main_of(name)(SMALLEST[name]) == 0
    assert capsys.readouterr().out.strip()


def test_distances_are_measured_of_one_nozzle(capsys: pytest.CaptureFixture[str]) -> None:
    assert clearance.main(["naca0015_wing"]) == 2
    assert "the distances are those of one nozzle" in capsys.readouterr().err


@pytest.mark.slow
def test_the_parts_of_the_optimisers_figures_run(tmp_path: Path) -> None:
    problem = load_problem(write_case("peer_cap", 60, tmp_path))
    label, verified, at_speed, *_ = strategies.row("ladder", problem, "ladder")
    assert (label, verified) == ("ladder", "yes") and at_speed.endswith(" %")
    for _, rate in (optimiser.searched(60), optimiser.refined(problem)):
        assert float(rate.split()[0]) > 0.0


@pytest.mark.slow
def test_a_quick_look_has_a_row_for_each_problem(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(strategies, "shipped_problems", lambda: ["peer_cap"])
    *_, row = strategies.overview(["as_published", "fixed"], ())
    assert row == "| peer_cap | `turning_table` | 100.0 % | no plan |"
