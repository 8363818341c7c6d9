"""What a second worker buys: a grid of plans on a dask cluster of one worker, of two, and of two with one killed.

python -m benchmarks.cluster
python -m benchmarks.cluster --cells 6
python -m benchmarks.cluster --print cylinder_logo

Scheduler and workers are started here, each worker on its own core. Everything that a plan's verification measures is
compared bit for bit between the three runs. With --print the workers share one print: everything that `planner.solve` does
before writing is timed, and one process does most of it alone. Exit code 0 if everything is the same, otherwise 3.
"""

from __future__ import annotations

import argparse
import hashlib
import itertools
import os
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

from distributed import Client
from rich.console import Console
from rich.table import Table

from benchmarks.named import load_named
from planner.base.distribution import Spread, crew
from planner.base.errors import EXIT_NOT_VERIFIED, EXIT_VERIFIED, PlannerError, Refusal
from planner.planning.options import add_set
from planner.planning.pipeline import load, solve, try_out
from planner.toolpath.build import build_toolpath

PROBLEM = "peer_cap@3000"  # waypoints: some seconds a plan, so that what a worker imports first does not count
STRATEGIES = ("sqp", "ladder")
SPEEDS = range(22, 42, 2)  # mm/s; ten, so that the grid has 20 cells
WAIT = 60.0  # s for workers to be there
ROOT = Path(__file__).resolve().parents[1]

Cell = tuple[int, str]  # speed, strategy


def digest_of(cell: Cell) -> str:
    """Digest of all that verification says of a plan, or the reason why there is none."""
    speed, strategy = cell
    try:
        with tempfile.TemporaryDirectory() as folder:
            problem = load_named(PROBLEM, [f"process.speed_mm_s={speed}"], Path(folder))
            report = try_out(problem, build_toolpath(problem), strategy)
    except Refusal as refusal:
        return str(refusal)
    digest = hashlib.sha256(repr((report.checks, sorted(report.metrics.items()))).encode())
    for name, values in sorted(report.series.items()):
        digest.update(name.encode() + values.tobytes())
    return digest.hexdigest()


@contextmanager
def cluster(workers: int, folder: Path) -> Iterator[str]:
    """Address of a scheduler with so many workers, each a process of its own on a core of its own."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    address = f"tcp://127.0.0.1:{port}"
    cores = itertools.cycle(sorted(os.sched_getaffinity(0)))
    started = [_start("scheduler", ["--host", "127.0.0.1", "--port", str(port)], folder)]
    try:
        for core in itertools.islice(cores, workers):
            started.append(_start("worker", [address, "--nthreads", "1"], folder, core))
        with Client(address, timeout=WAIT, set_as_default=False) as client:
            client.wait_for_workers(workers, timeout=WAIT)
        yield address
    finally:
        for process in reversed(started):
            process.terminate()
            process.wait()


def _start(kind: str, options: Sequence[str], folder: Path, core: int | None = None) -> subprocess.Popen[bytes]:
    command = [sys.executable, "-m", f"distributed.cli.dask_{kind}", *options, "--no-dashboard"]
    threads = {"NUMBA_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    environment = {**os.environ, **threads, "PYTHONPATH": str(ROOT), "TMPDIR": str(folder)}
    with open(folder / f"{kind}.log", "ab") as log:
        process = subprocess.Popen(command, cwd=folder, env=environment, stdout=log, stderr=log)
    if core is not None:
        os.sched_setaffinity(process.pid, {core})  # before it has started anything of its own
    return process


def run(work: Callable[[Spread], list[str]], workers: int, folder: Path, kill: bool = False) -> tuple[float, list[str]]:
    """Seconds that some work takes, and its results; `kill`: one worker's process, once half of the items are done."""
    with cluster(workers, folder) as address:
        start = time.perf_counter()
        with crew(scheduler=address) as over:
            results = work(_killing(over, address) if kill else over)
        return time.perf_counter() - start, results


def of_grid(cells: Sequence[Cell], over: Spread) -> list[str]:
    """Digests of a grid's plans, in order."""
    results = [""] * len(cells)
    for i, result in over(digest_of, cells):
        if isinstance(result, PlannerError):
            raise result
        results[i] = result
    return results


def of_print(name: str, settings: Sequence[str], over: Spread) -> list[str]:
    """The digest of one plan, refined by the workers."""
    plan = solve(load(name, *settings), over=over, baseline=False)
    digest = hashlib.sha256(repr((plan.checks, sorted(plan.metrics.items()))).encode())
    digest.update(plan.trajectory.q.tobytes())
    return [digest.hexdigest()]


def _killing(over: Spread, address: str) -> Spread:
    def spread(function: Callable[[Any], Any], items: Sequence[Any]) -> Iterator[tuple[int, Any]]:
        for done, pair in enumerate(over(function, items), 1):
            yield pair
            if done == len(items) // 2:
                _kill_one(address)

    return spread


def _kill_one(address: str) -> None:
    with Client(address, timeout=WAIT, set_as_default=False) as client:
        pid = min(client.run(os.getpid).values())
    os.kill(pid, signal.SIGKILL)


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit code."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.cluster", description=__doc__)
    most = len(STRATEGIES) * len(SPEEDS)
    parser.add_argument("--cells", type=int, default=most, choices=range(2, most + 1), metavar="N", help=f"2 to {most}")
    parser.add_argument("--print", metavar="PROBLEM", help="share one print instead: file, or name of one that ships")
    add_set(parser)
    options = parser.parse_args(arguments)
    cells = list(itertools.product(SPEEDS, STRATEGIES))[: options.cells]
    work = partial(of_print, options.print, options.set) if options.print else partial(of_grid, cells)
    title = f"{PROBLEM}, {len(cells)} plans" if options.print is None else " ".join([options.print, *options.set])
    table = Table("workers", "killed", "s", "times as fast", "results", title=title)
    seconds, first = 0.0, [""]
    same = True
    with tempfile.TemporaryDirectory(prefix="cluster_") as folder:
        run(work, 1, Path(folder))  # compiles
        for workers, kill in ((1, False), (2, False), (2, True)):
            took, results = run(work, workers, Path(folder), kill)
            if not seconds:
                seconds, first = took, results
            same = same and results == first
            told = "the same" if results == first else "DIFFERENT"
            table.add_row(str(workers), "1" if kill else "", f"{took:.1f}", f"{seconds / took:.2f}", told)
    Console().print(table)
    return EXIT_VERIFIED if same else EXIT_NOT_VERIFIED


if __name__ == "__main__":
    sys.exit(main())
