"""The wheel and the command `beadwise`: what a stranger has after `pip install`."""

from __future__ import annotations

import os
import subprocess
import sys
import zipfile
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import pytest
from numba.core import event

from planner.base import compiled, extras, launch
from planner.base.completion import script
from planner.base.errors import InputError
from planner.base.shipped import PROBLEMS, ROBOTS
from planner.cell.robot import robot_names
from planner.problem import shipped_problems

ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture(scope="session")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with what a wheel of this checkout puts into site-packages."""
    folder = tmp_path_factory.mktemp("wheel")
    build = [sys.executable, "-m", "build", "--wheel", "--no-isolation", "--outdir", str(folder), str(ROOT)]
    subprocess.run(build, check=True, capture_output=True, cwd=folder)
    (wheel,) = folder.glob("*.whl")
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(folder / "site-packages")
    return folder / "site-packages"


@pytest.fixture
def run(installed: Path, tmp_path: Path) -> Callable[..., subprocess.CompletedProcess[str]]:
    """Run `beadwise …` of the installed package, in an empty folder."""
    code = f"import sys; sys.path.insert(0, {str(installed)!r}); sys.argv[0] = 'beadwise'\n"
    code += "from planner.base.launch import main; sys.exit(main())"

    def call(*arguments: str) -> subprocess.CompletedProcess[str]:
        command = [sys.executable, "-c", code, *arguments]
        return subprocess.run(command, capture_output=True, text=True, cwd=tmp_path, check=False)

    return call


def files_of(folder: Path, suffixes: tuple[str, ...]) -> set[str]:
    return {path.name for path in folder.iterdir() if path.suffix in suffixes}


@pytest.mark.slow
def test_a_wheel_has_all_that_ships_and_one_name_at_the_top(installed: Path) -> None:
    assert {path.name for path in installed.iterdir() if not path.name.endswith(".dist-info")} == {"planner"}
    inside = installed / "planner" / "shipped"
    for home, suffixes in (
        (PROBLEMS, (".yaml", ".svg", ".stl", ".step", ".dat", ".txt", ".gcode")),
        (ROBOTS, (".yaml", ".urdf")),
    ):
        assert files_of(inside / home.name, suffixes) == files_of(home, suffixes)
        assert not list((inside / home.name).glob("*.py"))
    assert (inside / "problem.schema.json").is_file() and (inside / "robot.schema.json").is_file()
    sources = {str(path.relative_to(ROOT)) for path in (ROOT / "planner").rglob("*") if "__pycache__" not in path.parts}
    there = {str(path.relative_to(installed)) for path in (installed / "planner").rglob("*")}
    assert sources <= there


@pytest.mark.slow
def test_an_installed_package_finds_its_examples_and_robots(
    run: Callable[..., subprocess.CompletedProcess[str]],
) -> None:
    listed = run("solve", "--list")
    assert listed.returncode == 0 and [line.split()[0] for line in listed.stdout.splitlines()] == shipped_problems()
    checked = run("check", "peer_cap")
    assert checked.returncode == 0 and "beadwise" not in checked.stderr
    assert "site-packages/planner/shipped/problems/peer_cap.yaml" in checked.stdout
    unknown = run("check", "xyzzy")
    assert unknown.returncode == 2 and "site-packages/planner/shipped/problems" in unknown.stderr
    robots = run("robots")
    assert robots.returncode == 0 and "irb140" in robots.stdout
    assert run("solve", "--help").stdout.startswith("usage: beadwise solve ")


@pytest.mark.parametrize(
    ("arguments", "code", "said"),
    [
        ([], 0, "commands:"),
        (["--help"], 0, "simulate"),
        (["--version"], 0, "beadwise "),
        (["slove"], 2, "did you mean solve?"),
        (["xyzzy"], 2, "commands: demo, solve, check"),
    ],
)
def test_beadwise(
    arguments: list[str], code: int, said: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "argv", ["beadwise", *arguments])
    assert launch.main() == code
    captured = capsys.readouterr()
    assert said in (captured.out if code == 0 else captured.err)


def test_every_command_is_there() -> None:
    for name, command in launch.COMMANDS.items():
        rooms = (ROOT / "planner" / room for room in (".", "base", "feedback", "link", "report"))
        assert (ROOT / "planner" / name / "__main__.py").is_file() or any((r / f"{name}.py").is_file() for r in rooms)
        assert (ROOT / f"{command.module.replace('.', '/')}.py").is_file()


def test_a_missing_extra_is_named(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setitem(sys.modules, "tornado", None)
    for name in [name for name in sys.modules if name.startswith(("planner.view", "tornado."))]:
        monkeypatch.delitem(sys.modules, name)
    assert launch.launch("view", ["peer_cap"]) == 2
    assert "needs the package tornado (pip install 'beadwise[view]')" in capsys.readouterr().err


def test_a_shell_completes_commands_whose_extras_are_missing() -> None:
    code = f"""
import sys
sys.modules.update(dict.fromkeys({sorted(extras.EXTRAS)}))
from planner.base.completion import main
main(["bash"])
"""
    ran = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    assert "--beside" in ran.stdout and "completion" in ran.stdout


def test_a_package_of_no_extra_is_a_bug() -> None:
    assert extras.missing_extra(ModuleNotFoundError("no", name="numpy")) is None
    told = extras.missing_extra(ModuleNotFoundError("no", name="dask.array"), "a cluster")
    assert isinstance(told, InputError) and "a cluster needs the package dask" in str(told)


def test_kernels_compile_without_a_cache(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    from numba.core import caching

    monkeypatch.setattr(caching.FunctionCache._impl_class, "_locator_classes", [])
    compiled._tell_once.cache_clear()

    @compiled.njit
    def doubled(x: float) -> float:
        return 2.0 * x

    assert doubled(3.0) == 6.0
    assert "set NUMBA_CACHE_DIR" in capsys.readouterr().err


@pytest.mark.slow
def test_what_is_compiled_is_counted_and_told(tmp_path: Path) -> None:
    """With an empty cache a kernel is told of once, and counted when it is done; with a full one nothing is."""
    code = """
from planner.base import compiled
from planner.base.singular_values import least_singular_values
import numpy as np
compiled.WORTH_TELLING = 1
said, done = [], []
with compiled.while_compiling(lambda kernels, seconds: said.append(kernels) or done.append):
    least_singular_values(np.eye(6)[None])
print(len(said), len(done) > 0 and done == sorted(done) and 0 < done[0])
"""
    told = [
        subprocess.run(
            [sys.executable, "-c", code],
            cwd=ROOT, env={**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}, capture_output=True, text=True, check=True,
        ).stdout.split()
        for _ in range(2)
    ]  # fmt: skip
    assert told == [["1", "True"], ["0", "False"]]


def test_where_most_kernels_are_there_a_few_others_are_not_told_of(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(compiled, "_loaded_kernels", lambda: list(range(100)))
    monkeypatch.setattr(compiled, "was_compiled", lambda kernel: kernel >= 30)
    start = {"dispatcher": SimpleNamespace(py_func=SimpleNamespace(__module__="planner.kernels"))}
    said: list[int] = []
    with compiled.while_compiling(lambda kernels, seconds: said.append(kernels) or (lambda there: None)):
        for _ in range(compiled.WORTH_TELLING):
            event.start_event("numba:compile", data=start)
            event.end_event("numba:compile", data=start)
        assert not said
        event.start_event("numba:compile", data=start)
        event.end_event("numba:compile", data=start)
    assert said == [30]


def test_processes_forked_from_one_tell_once_of_kernels_to_compile(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(compiled, "WORTH_TELLING", 0)
    said, hears = os.pipe()
    start = {"dispatcher": SimpleNamespace(py_func=SimpleNamespace(__module__="planner.kernels"))}
    with compiled.while_compiling(lambda kernels, seconds: lambda there: os.write(hears, b"x") and None):
        for _ in range(3):
            child = os.fork()
            if not child:
                try:
                    event.start_event("numba:compile", data=start)
                    event.end_event("numba:compile", data=start)
                finally:
                    os._exit(0)
            os.waitpid(child, 0)
    os.close(hears)
    with os.fdopen(said, "rb") as told:
        assert told.read() == b"x"


@pytest.mark.parametrize("called", ["beadwise", "python"])
def test_a_shell_completes_commands_options_examples_and_robots(called: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "argv", [called])
    text = script("bash")
    assert "peer_cap" in text and "irb140" in text and "--strategy" in text
    completes = f"""{text}
COMP_WORDS=(beadwise solve peer_c); COMP_CWORD=2; _shtab_beadwise; echo "${{COMPREPLY[@]}}"
COMP_WORDS=(beadwise ro); COMP_CWORD=1; _shtab_beadwise; echo "${{COMPREPLY[@]}}"
COMP_WORDS=(beadwise identify wr); COMP_CWORD=2; _shtab_beadwise; echo "${{COMPREPLY[@]}}"
COMP_WORDS=(beadwise identify write peer_c); COMP_CWORD=3; _shtab_beadwise; echo "${{COMPREPLY[@]}}"
COMP_WORDS=(beadwise identify extruder re); COMP_CWORD=3; _shtab_beadwise; echo "${{COMPREPLY[@]}}"
"""
    ran = subprocess.run(["bash", "-c", completes], capture_output=True, text=True, check=True)
    assert ran.stdout.splitlines() == ["peer_cap peer_cylinder", "robots", "write", "peer_cap peer_cylinder", "read"]
    assert robot_names() and "compadd" in script("zsh")
