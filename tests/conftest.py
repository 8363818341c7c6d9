"""Shared fixtures: the shipped cell and problem, and what the planner makes of one coarse layer of it."""

from __future__ import annotations

import gc
import os
import signal
import threading
from collections.abc import Callable, Generator, Iterator
from fnmatch import fnmatchcase
from pathlib import Path
from zlib import crc32

import pytest
from hypothesis import HealthCheck, settings

from planner.base.compiled import compile_sparingly
from planner.cell.cell import Cell, build_cell
from planner.collision.scene import NOTHING
from planner.motion.timing.timed_path import TimedPath, time_path
from planner.problem import Problem, load_problem
from planner.resolve.joint_path import JointPath
from planner.resolve.strategies import STRATEGIES
from planner.toolpath.bead import Toolpath
from planner.toolpath.build import build_toolpath
from planner.toolpath.task import NozzleTask, make_tasks

# Compiled kernels and a shared machine make single examples slow at times, and the same run must be the same run.
settings.register_profile(
    "beadwise",
    deadline=None,
    derandomize=True,
    print_blob=False,
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large],
)
settings.load_profile("beadwise")

if signal.getsignal(signal.SIGINT) is signal.SIG_IGN and threading.current_thread() is threading.main_thread():
    # as a shell has it for what it runs in the background: processes that tests interrupt would inherit it
    signal.signal(signal.SIGINT, signal.default_int_handler)

if "PYTEST_XDIST_WORKER" in os.environ:
    compile_sparingly()

# Files to begin with. The first ones compile different kernels, and what starts processes of its own finds them compiled;
# those that take long come before those that do not, so that no worker waits for another one at the end.
FIRST = (
    "problems", "sqp_kernels", "timing_optimum", "table_path", "placement", "process_whole", "fibre", "bad_cases",
    "register", "headroom", "step", "notebooks", "browser", "command", "view_page", "step_top", "substrate", "corpora",
    "obstacles_refine", "link_command", "verify", "verify_extrusion", "positioners", "sqp", "resolve", "timing",
    "materials", "cores", "wing", "report", "resume", "dips", "svg", "volume",
)  # fmt: skip

COARSE = (
    "layers.count=1",
    "resolve.rung_mm=10",
    "resolve.roll_step_deg=30",
    "resolve.table_step_deg=30",
)
DT = 0.004

DRAWING = """\
<svg xmlns="http://www.w3.org/2000/svg" width="40mm" height="30mm" viewBox="0 0 40 30">
  <path id="zigzag" d="M1,1 L14,1 L14,12 L30,3"/>
  <circle id="ring" cx="9" cy="20" r="7"/>
  <path id="wave" d="M20,26 C24,10 30,10 32,22 S38,28 39,14"/>
</svg>
"""


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--all-tests", action="store_true", help="slow tests, too")
    parser.addoption(
        "--slice", metavar="K/N", help="of the slow tests the K-th of N parts, K from 0, besides the others"
    )


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Generator[None, object, object]:
    """What is collected stays to the end: the garbage collector need not look at it, now or later."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.collect()
        gc.freeze()
        gc.enable()


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Files in the order of FIRST, all others after them; slow tests only where they are asked for.

    `@pytest.mark.slow` is for tests that take seconds. Of the cases of such a test `keep` has those that run all the same: a
    number of them, spread evenly, or patterns of their names; `cases` has patterns of the only ones that are slow.
    """
    rank = {f"test_{name}.py": i for i, name in enumerate(FIRST)}
    items.sort(key=lambda item: rank.get(item.path.name, len(rank)))
    if not config.option.keyword and not any("::" in each for each in config.args):
        _refuse_unknown_cases(items)
    if config.getoption("--all-tests"):
        return
    part, parts = (int(each) for each in (config.getoption("--slice") or "-1/1").split("/"))
    spread = _spread_cases(items)
    left_out = [
        item
        for item in items
        if _is_slow(item) and item.nodeid not in spread and crc32(item.nodeid.encode()) % parts != part
    ]
    config.hook.pytest_deselected(items=left_out)
    kept = set(map(id, items)) - set(map(id, left_out))
    items[:] = [item for item in items if id(item) in kept]


def _is_slow(item: pytest.Item) -> bool:
    marker, case = item.get_closest_marker("slow"), getattr(item, "callspec", None)
    if marker is None or case is None:
        return marker is not None
    kept, slow = marker.kwargs.get("keep", ()), marker.kwargs.get("cases", ("*",))
    return _is_any(case.id, slow) and (isinstance(kept, int) or not _is_any(case.id, kept))


def _spread_cases(items: list[pytest.Item]) -> set[str]:
    """Cases of slow tests of which a number is kept: from the first to the last, as far apart as can be."""
    cases: dict[str, list[str]] = {}
    number: dict[str, int] = {}
    for item in items:
        marker = item.get_closest_marker("slow")
        if marker is not None and isinstance(kept := marker.kwargs.get("keep"), int):
            test = item.nodeid.partition("[")[0]
            cases.setdefault(test, []).append(item.nodeid)
            number[test] = kept
    return {
        ids[round(k * (len(ids) - 1) / max(number[test] - 1, 1))]
        for test, ids in cases.items()
        for k in range(number[test])
    }


def _refuse_unknown_cases(items: list[pytest.Item]) -> None:
    """A pattern that means no case would keep, or leave out, something else than it says."""
    cases: dict[tuple[str, str], list[str]] = {}
    for item in items:
        marker, case = item.get_closest_marker("slow"), getattr(item, "callspec", None)
        named = [] if marker is None else [each for each in marker.kwargs.values() if not isinstance(each, int)]
        for pattern in (pattern for patterns in named for pattern in patterns):
            cases.setdefault((item.nodeid.partition("[")[0], pattern), []).append("" if case is None else case.id)
    unknown = [
        f"{test}: {pattern!r}" for (test, pattern), ids in cases.items() if not any(_is_any(i, (pattern,)) for i in ids)
    ]
    if unknown:
        raise pytest.UsageError("marked as slow, but no such case: " + "; ".join(unknown))


def _is_any(case: str, patterns: tuple[str, ...]) -> bool:
    return any(case == pattern or fnmatchcase(case, pattern) for pattern in patterns)


@pytest.fixture(autouse=True)
def interruptions_as_before() -> Iterator[None]:
    """A command that a test runs to its end lets nothing interrupt it any more; processes of later tests would inherit that."""
    handlers = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    yield
    if threading.current_thread() is threading.main_thread():
        for number, handler in handlers.items():
            signal.signal(number, handler)


@pytest.fixture(scope="session")
def problem() -> Problem:
    """The shipped problem with one layer and a coarse search."""
    return load_problem("cylinder_logo", COARSE)


@pytest.fixture(scope="session")
def cell(problem: Problem) -> Cell:
    """Pollard's cell: IRB 140 with its nozzle, A250 whose table turns."""
    return build_cell(problem)


@pytest.fixture(scope="session")
def bed_cell() -> Cell:
    """The same arm in front of a fixed bed."""
    return build_cell(load_problem("cylinder_logo", ["cell.positioner=null", "cell.bed_mm=[560, -93, 290]"]))


@pytest.fixture(scope="session")
def drawing_problem(tmp_path_factory: pytest.TempPathFactory) -> Problem:
    """Three curves in two layers: sharp corners, a closed curve, and a smooth open one."""
    svg = tmp_path_factory.mktemp("drawing") / "drawing.svg"
    svg.write_text(DRAWING, encoding="utf-8")
    changes = ["layers.count=2", f"layers.source.svg={svg}", "layers.source.width_mm=40"]
    return load_problem("cylinder_logo", [*COARSE, *changes])


@pytest.fixture(scope="session")
def toolpath(drawing_problem: Problem) -> Toolpath:
    """Six beads: the three curves, twice."""
    return build_toolpath(drawing_problem)


@pytest.fixture(scope="session")
def tasks(drawing_problem: Problem, toolpath: Toolpath) -> tuple[NozzleTask, ...]:
    """What the six beads ask of the nozzle."""
    return make_tasks(toolpath, drawing_problem.process.speed, drawing_problem.process.run_in)


@pytest.fixture(scope="session")
def joint_paths(
    cell: Cell, tasks: tuple[NozzleTask, ...], drawing_problem: Problem
) -> dict[str, tuple[JointPath, ...]]:
    """Joint paths of the six beads by every strategy but `nlp`, which is for single beads."""
    quick = {name: resolve for name, resolve in STRATEGIES.items() if name != "nlp"}
    return {name: resolve(cell, tasks, drawing_problem.resolve, NOTHING) for name, resolve in quick.items()}


@pytest.fixture(scope="session")
def timed(cell: Cell, joint_paths: dict[str, tuple[JointPath, ...]]) -> tuple[TimedPath, ...]:
    """The ladder's paths, timed."""
    return tuple(time_path(cell, path) for path in joint_paths["ladder"])


@pytest.fixture
def drawing(tmp_path: Path) -> Callable[..., Problem]:
    """Make the shipped problem with a drawing of one's own: `drawing('<path .../>', width_mm, *overrides)`."""

    def make(shapes: str, width_mm: float, *overrides: str) -> Problem:
        svg = tmp_path / "own.svg"
        svg.write_text(f'<svg xmlns="http://www.w3.org/2000/svg">{shapes}</svg>', encoding="utf-8")
        return load_problem(
            "cylinder_logo", [f"layers.source.svg={svg}", f"layers.source.width_mm={width_mm}", *overrides]
        )

    return make
