"""Many items by the same function: the same results here, in processes, on a cluster; dead processes cost a retry."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from planner.base import distribution as cluster_module
from planner.base.distribution import Lost, name_of, program_of, spread
from planner.base.errors import InputError, PlannerError, Refusal


def square(item: int) -> tuple[int, int]:
    return item * item, os.getpid()


def quick_last(item: float) -> float:
    time.sleep(item)
    return item


def refuse_odd(item: int) -> int:
    if item % 2:
        raise Refusal("is odd", bead=item, s_mm=2.5)
    return item


def bug(item: int) -> int:
    raise KeyError(item)


def die_once(item: tuple[int, str]) -> int:
    """Kill this process the first time the item with a file's name is tried."""
    number, mark = item
    if mark and not Path(mark).exists():
        Path(mark).touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return number


def die(item: int) -> int:
    if item == 1:
        os.kill(os.getpid(), signal.SIGKILL)
    return item


def results(*arguments: Any, **options: Any) -> list[Any]:
    """Results in the order of the items."""
    return [result for _, result in sorted(spread(*arguments, **options), key=lambda pair: pair[0])]


def test_processes_do_what_this_one_does() -> None:
    items = list(range(7))
    here, beside = results(square, items), results(square, items, jobs=2)
    assert [value for value, _ in here] == [value for value, _ in beside] == [k * k for k in items]
    assert {pid for _, pid in here} == {os.getpid()}
    assert len({pid for _, pid in beside}) == 2 and os.getpid() not in {pid for _, pid in beside}
    assert results(square, [], jobs=2) == []


def test_results_come_as_they_are_done() -> None:
    assert [i for i, _ in spread(quick_last, [1.0, 0.0], jobs=2)] == [1, 0]


def test_a_killed_process_costs_a_retry(tmp_path: Path) -> None:
    items = [(k, str(tmp_path / "mark") if k == 1 else "") for k in range(4)]
    assert results(die_once, items, jobs=2) == [0, 1, 2, 3]
    assert (tmp_path / "mark").exists()


def test_an_item_that_always_dies_is_lost_alone() -> None:
    out = results(die, [0, 1, 2], jobs=2)
    assert out[0] == 0 and out[2] == 2
    assert isinstance(out[1], Lost) and "item 1 has no result: 3 processes" in str(out[1]) and "-9" in str(out[1])


@pytest.mark.parametrize("jobs", [1, 2])
def test_errors_are_results_and_bugs_are_not(jobs: int, capfd: pytest.CaptureFixture[str]) -> None:
    out = results(refuse_odd, [0, 1, 2], jobs=jobs)
    assert out[0] == 0 and out[2] == 2
    assert isinstance(out[1], Refusal) and (out[1].bead, out[1].s_mm) == (1, 2.5)
    assert str(out[1]) == "bead 1, 2.5 mm along it: is odd"
    with pytest.raises(KeyError if jobs == 1 else RuntimeError):
        results(bug, [0, 1], jobs=jobs)
    if jobs > 1:
        assert "KeyError" in capfd.readouterr().err


def test_processes_end_with_the_iteration() -> None:
    under_way = spread(square, list(range(50)), jobs=2)
    _, (_, pid) = next(under_way)  # type: ignore[misc]
    os.kill(pid, 0)
    under_way.close()  # type: ignore[attr-defined]
    with pytest.raises(ProcessLookupError):
        os.kill(pid, 0)


def test_what_cannot_be_spread_is_told() -> None:
    with pytest.raises(TypeError, match="cannot be imported by name"):
        results(lambda item: item, [1, 2], jobs=2)
    for jobs in (0, 1000):
        with pytest.raises(InputError, match="is not a number of processes"):
            results(square, [1], jobs=jobs)


@pytest.mark.parametrize("address", ["localhost:8786", "tcp://localhost", "http://a:1", "tcp://:1", "tcp://a b:1", ""])
def test_what_is_no_address(address: str) -> None:
    with pytest.raises(InputError, match=r"--scheduler: .* is not an address"):
        results(square, [1], scheduler=address)


def test_nobody_answers(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cluster_module, "PATIENCE", 0.3)
    with pytest.raises(InputError, match=r"no scheduler answers at tcp://127.0.0.1:9"):
        results(square, [1], scheduler="tcp://127.0.0.1:9")


def test_without_dask(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(InputError, match=r"needs the package distributed .*beadwise.cluster"):
        results(square, [1], scheduler="tcp://127.0.0.1:9")


@pytest.fixture(scope="module")
def scheduler() -> Iterator[tuple[str, Any]]:
    """Address of a scheduler in this process without workers, and the cluster."""
    from distributed import LocalCluster

    with LocalCluster(
        n_workers=0, threads_per_worker=1, processes=False, protocol="tcp", host="127.0.0.1", dashboard_address=None
    ) as cluster:
        yield cluster.scheduler_address, cluster


def test_a_cluster(scheduler: tuple[str, Any], monkeypatch: pytest.MonkeyPatch) -> None:
    address, cluster = scheduler
    with monkeypatch.context() as short, pytest.raises(InputError, match=r"has no worker .*dask worker tcp://"):
        short.setattr(cluster_module, "PATIENCE", 0.3)
        results(square, [1], scheduler=address)
    cluster.scale(1)
    assert [value for value, _ in results(square, [1, 2, 3], scheduler=address)] == [1, 4, 9]
    out = results(refuse_odd, [0, 1], scheduler=address)
    assert out[0] == 0 and isinstance(out[1], PlannerError) and str(out[1]).endswith("is odd")
    with pytest.raises(RuntimeError, match=r"test_spread.bug failed on a worker: KeyError"):
        results(bug, [1], scheduler=address)
    monkeypatch.setattr(cluster_module, "program_of", _changing())
    with pytest.raises(InputError, match=r"runs a different program: numpy 1.0 instead of numpy 2.0 .*same version"):
        results(square, [1], scheduler=address)


def _changing() -> Any:
    told = iter(["python 3.11, numpy 2.0", "python 3.11, numpy 1.0"])
    return lambda module: next(told)


@pytest.mark.slow
def test_a_worker_that_is_killed(scheduler: tuple[str, Any], tmp_path: Path) -> None:
    """In a process of its own, for it kills itself; its nanny starts another."""
    address, cluster = scheduler
    cluster.scale(0)
    here = Path(__file__).parent
    worker = subprocess.Popen(
        [sys.executable, "-m", "distributed.cli.dask_worker", address, "--nthreads", "1", "--no-dashboard"],
        env={**os.environ, "PYTHONPATH": f"{here.parent}:{here}"},
        stderr=subprocess.DEVNULL,
        cwd=tmp_path,
    )
    try:
        items = [(k, str(tmp_path / "mark") if k == 1 else "") for k in range(4)]
        assert results(die_once, items, scheduler=address) == [0, 1, 2, 3]
        assert (tmp_path / "mark").exists()
    finally:
        worker.terminate()
        worker.wait()


def test_names_and_programs() -> None:
    assert name_of(square) == ("test_spread", "square")
    assert "numba" in program_of("planner.base.distribution") and program_of("planner.base.distribution") != program_of(
        "test_spread"
    )
