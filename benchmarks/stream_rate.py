"""How many targets a second a streamed program keeps up, by the number that a controller's task reads per message.

python -m benchmarks.stream_rate [--reading 6.5] [--seconds 4]

The simulated controller does nothing else for the given milliseconds whenever it reads a message, as users report of
SocketReceive; the moves themselves take as long as targets at the requested rate do.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Sequence
from contextlib import closing
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from planner.base.arrays import Array
from planner.export.program import RobotProgram
from planner.link.streaming import StreamStopped, send, stream_of
from planner.simulate.stream import MESSAGE, StreamServer

RATES = (40, 100, 200, 400, 800)  # targets/s; real programs have 40 evenly spaced ones, ours had up to 57
SPEED = 0.04  # m/s


def straight(module: str, x: Array, *speed: float, **more: Any) -> RobotProgram:
    """Lines along x to places x (m) [m], as a reader would give them, with stops at the first and the last."""
    m, identity = len(x), np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
    fine = np.isin(np.arange(m), (0, m - 1))
    return RobotProgram(
        module=module, tool=identity, uframe=identity, oframe=identity, station="", start=np.zeros(12),
        linear=np.ones(m, bool), fine=fine, position=np.column_stack([x, 0.0 * x, 0.0 * x]),
        quat=np.tile([0.0, 0.0, 0.0, 1.0], (m, 1)), conf=np.zeros((m, 4), np.intp), external=np.full((m, 6), np.nan),
        zone=np.where(fine, 0.0, 0.3e-3), speed=np.tile(speed, (m, 1)), wait=np.zeros(m), triggers={}, **more,
    )  # fmt: skip


def kept(rate: float, seconds: float, reading: float, at_most: int) -> tuple[float, int, str]:
    """Targets a second that were kept up, waits within the bead, and what ended it, if anything did."""
    x = SPEED / rate * np.arange(round(rate * seconds))
    stream = stream_of(straight("Rate", x, SPEED, 10.0, 10.0, 10.0))
    with closing(StreamServer("127.0.0.1", 0, reading=reading, at_most=at_most)) as server:
        since = time.monotonic()
        reason = ""
        try:
            send(stream, *server.address, lambda text: None)
        except StreamStopped as stopped:
            reason = str(stopped).partition(";")[0]
        took, state = time.monotonic() - since, server.state()
        return state.done / took, state.starved, reason


def main(arguments: Sequence[str] | None = None) -> int:
    """Print a table."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.stream_rate")
    parser.add_argument("--reading", type=float, default=6.5, help="time to read a message, ms (default 6.5)")
    parser.add_argument("--seconds", type=float, default=4.0, help="of each run (default 4)")
    options = parser.parse_args(arguments)
    table = Table(title=f"Streaming to a task that reads a message in {options.reading:g} ms")
    for column in ("targets/s asked", "frames a message", "targets/s kept", "waits within the bead", "stopped by"):
        table.add_column(column, justify="right")
    for rate in RATES:
        for at_most in (1, MESSAGE):
            found, starved, reason = kept(rate, options.seconds, options.reading * 1e-3, at_most)
            table.add_row(f"{rate}", f"{at_most}", f"{found:.0f}", f"{starved}", reason)
    Console(width=110).print(table)
    return 0


if __name__ == "__main__":
    sys.exit(main())
