"""How much time the link adds between controller and board, and how many lines a second it relays.

python -m benchmarks.relay [--rate 1000] [--seconds 5]

Both ends run in their own process, on loopback; the board answers at once. Every line is logged, as in a print.
For comparison, another relay only passes lines on, unchecked and unlogged: this is the machine's own share.
"""

from __future__ import annotations

import argparse
import multiprocessing
import multiprocessing.connection
import os
import selectors
import socket
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from planner.base.arrays import Array
from planner.link.program_lines import ProgramLine, ProgramLines
from planner.link.relay import WINDOW, Relay, RelaySide
from planner.link.run import Log, RelayRun, Requests

ASKED_P99 = 5e-3  # s
MODULE = "Bench"


def program(count: int, rate: float) -> ProgramLines:
    """Lines as a print of fibre has them."""
    lines = (ProgramLine(n, 0, 0, n / rate, f"G1 E{0.1 + n % 100 * 1e-5:.5f} F600") for n in range(1, count + 1))
    return ProgramLines(MODULE, tuple(lines))


def ends(lines: ProgramLines, rate: float, pipe: multiprocessing.connection.Connection) -> None:
    """Controller and board: sends lines at their times, and reports when each was sent, came to the board, was acknowledged.

    Sends the ports through the pipe, then (3, n) times [s] of the system's steady clock.
    """
    listeners = [socket.create_server(("127.0.0.1", 0)) for _ in range(2)]
    pipe.send([each.getsockname()[1] for each in listeners])
    controller, board = (each.accept()[0] for each in listeners)
    times = np.full((3, len(lines)), np.nan)
    for made in (controller, board):
        made.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    controller.sendall(f"H {MODULE} {len(lines)}\n".encode())
    assert controller.recv(100) == b"G 1\n"
    texts = [f"L {line.n} {line.text}\n".encode() for line in lines.lines]
    with selectors.SelectSelector() as selector:  # others wait for whole milliseconds
        selector.register(controller, selectors.EVENT_READ)
        selector.register(board, selectors.EVENT_READ)
        begin, sent, acknowledged = time.monotonic(), 0, 0
        while acknowledged < len(lines):
            due = begin + sent / rate
            while sent < len(lines) and sent - acknowledged < WINDOW and time.monotonic() >= due:
                times[0, sent] = time.monotonic()
                controller.sendall(texts[sent])
                sent += 1
                due = begin + sent / rate
            waits = sent < len(lines) and sent - acknowledged < WINDOW
            for key, _ in selector.select(max(due - time.monotonic(), 0.0) if waits else 0.1):
                data = key.fileobj.recv(65536)  # type: ignore[union-attr]
                now = time.monotonic()
                for raw in data.splitlines():
                    if key.fileobj is board:
                        times[1, int(raw[1:].split(b" ", 1)[0]) - 1] = now
                        board.sendall(b"ok\r\n")
                    else:
                        acknowledged = int(raw[2:])
                        times[2, acknowledged - 1] = now
    pipe.send(times)
    controller.sendall(f"E {len(lines)}\n".encode())
    controller.recv(100)  # until the relay closes it


class Idle:
    """A robot that nobody has to stop."""

    def stop(self, reason: str) -> None:
        """Nothing moves."""

    def pause(self) -> None:
        """Nothing moves."""

    def go_on(self) -> None:
        """Nothing moves."""


def relayed(lines: ProgramLines, controller: socket.socket, board: socket.socket) -> None:
    """The link's relay, with its log."""
    requests = Requests()
    with tempfile.TemporaryDirectory() as folder:
        log = Log(Path(folder) / "log.jsonl")
        relay = Relay(lines, time.monotonic())
        sockets = {RelaySide.CONTROLLER: controller, RelaySide.BOARD: board}
        outcome = RelayRun(relay, sockets, requests, log, Idle(), lambda status: None).run()
        log.close()
    requests.close()
    if outcome.reason is not None:
        raise RuntimeError(outcome.reason)


def passed_on(lines: ProgramLines, controller: socket.socket, board: socket.socket) -> None:
    """Lines and acks passed on as they come, and nothing else."""
    acknowledged = 0
    begun = b""
    controller.recv(100)
    controller.sendall(b"G 1\n")
    with selectors.DefaultSelector() as selector:
        selector.register(controller, selectors.EVENT_READ)
        selector.register(board, selectors.EVENT_READ)
        while acknowledged < len(lines):
            for key, _ in selector.select():
                if key.fileobj is board:
                    for _ in range(board.recv(4096).count(b"\n")):
                        acknowledged += 1
                        controller.sendall(b"A %d\n" % acknowledged)
                else:
                    *whole, begun = (begun + controller.recv(4096)).split(b"\n")
                    for raw in whole:
                        board.sendall(b"N" + raw[2:] + b"\n")
    controller.recv(100)  # the end
    controller.close()
    board.close()


def measure(
    rate: float, seconds: float, run: Callable[[ProgramLines, socket.socket, socket.socket], None]
) -> tuple[Array, float]:
    """(3, n) times of every line [s]: sent by the controller, at the board, its ack at the controller; CPU a line [s]."""
    lines = program(round(rate * seconds), rate)
    ours, theirs = multiprocessing.Pipe()
    process = multiprocessing.get_context("fork").Process(target=ends, args=(lines, rate, theirs))
    process.start()
    theirs.close()  # so that an end that fails is noticed
    ports = ours.recv()
    controller, board = (socket.create_connection(("127.0.0.1", port)) for port in ports)
    for made in (controller, board):
        made.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    begin = time.process_time()
    run(lines, controller, board)
    spent = time.process_time() - begin
    times: Array = ours.recv()
    process.join()
    return times, spent / len(lines)


def main(arguments: Sequence[str] | None = None) -> int:
    """Print a table."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.relay")
    parser.add_argument("--rate", type=float, default=1000.0, help="lines a second (default 1000)")
    parser.add_argument("--seconds", type=float, default=5.0, help="of each of three runs (default 5)")
    options = parser.parse_args(arguments)
    table = Table(title=f"Lines on loopback, {options.rate:g} a second asked, {os.cpu_count()} cores")
    columns = (
        "",
        "lines/s",
        "to the board p50, ms",
        "p99, ms",
        "worst, ms",
        "ack back p99, ms",
        "CPU a line, ms",
        "kept",
    )
    for column in columns:
        table.add_column(column, justify="right")
    for name, way in 3 * (("relay", relayed), ("passed on", passed_on)):
        (sent, arrived, acknowledged), spent = measure(options.rate, options.seconds, way)
        there, back = 1e3 * (arrived - sent), 1e3 * (acknowledged - arrived)
        rate = (len(sent) - 1) / (sent[-1] - sent[0])
        p50, p99 = np.percentile(there, [50, 99])
        kept = "yes" if p99 <= 1e3 * ASKED_P99 else "no"
        figures = (p50, p99, there.max(), np.percentile(back, 99), 1e3 * spent)
        table.add_row(name, f"{rate:.0f}", *(f"{figure:.3f}" for figure in figures), kept)
    Console(width=120).print(table)
    return 0


if __name__ == "__main__":
    sys.exit(main())
