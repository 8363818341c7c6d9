"""Sends a plan's moves to a controller while it runs them, in place of a program that is loaded whole.

python -m planner.link.stream OUT_DIR --controller HOST
"""

from __future__ import annotations

import argparse
import select
import socket
import sys
import time
from collections.abc import Callable, Sequence
from ipaddress import AddressValueError, IPv4Address
from pathlib import Path

from planner.command import Command, exit_code
from planner.errors import EXIT_VERIFIED, InputError, OutputError
from planner.export.program import Program
from planner.export.rapid.reader import read_rapid_files
from planner.link.stream_frames import Stream, stream_of
from planner.link.stream_sender import Sender, StreamStopped
from planner.link.stream_server import MODULE, server_module

PORT = 1026
CONNECTING = 10.0  # s
LAST_WORDS = 2.0  # s in which the controller may say that it has stopped
LOOK = 0.01  # s between looks at the clock
LARGEST = 256 << 20  # bytes of all modules
BLOCK = 4096  # bytes read at once
LONGEST_NAME = 80  # bytes of a module's first line
TOLD_EVERY = 0.1  # share of all moves


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit code."""
    options = _options(arguments)
    say = lambda text: print(text, file=sys.stderr, flush=True)  # noqa: E731
    return exit_code(lambda: _run(options, say), say, "the robot was stopped")


def stream_command() -> Command:
    """The parser of `python -m planner.link.stream`."""
    parser = Command(
        "link.stream",
        f"Send a plan's moves to a controller that runs {MODULE}.mod, as fast as it takes them.",
        {
            "out/my_part --controller 192.168.125.1 --server player.mod": "write the module for this plan, and send",
            "out/my_part --controller 192.168.125.1": "send to a controller that runs the module already",
        },
        {0: "finished", 2: "wrong input", 3: "stopped before the end", 130: "interrupted"},
    )
    parser.add_argument("folder", type=Path, metavar="OUT_DIR", help="results of planner.solve")
    parser.add_argument("--controller", metavar="HOST[:PORT]", help=f"the controller (port {PORT} unless said)")
    parser.add_argument(
        "--server", type=Path, metavar="FILE", help=f"write {MODULE}.mod for this plan, to be loaded on the controller"
    )
    return parser


def _options(arguments: Sequence[str] | None) -> argparse.Namespace:
    parser = stream_command()
    options: argparse.Namespace = parser.parse_args(arguments)
    if options.controller is None and options.server is None:
        parser.error("a --controller to send to, or a file for the --server's module")
    return options


def _run(options: argparse.Namespace, say: Callable[[str], None]) -> int:
    program = program_in(options.folder)
    stream = stream_of(program)
    host, port = _address(options.controller) if options.controller else ("127.0.0.1", PORT)
    if options.server is not None:
        if not _is_ipv4(host):
            raise InputError(
                f"the server's module needs an address such as 192.168.125.1, not {host}", field="--controller"
            )
        try:
            _check_own(options.server)
            options.server.write_text(server_module(program, stream.signals, host, port), "ascii", newline="\n")
        except OSError as error:
            raise OutputError(f"cannot write {options.server}: {error.strerror or error}") from error
    if options.controller is not None:
        sender = send(stream, host, port, say)
        say(f"finished after {sender.total - 1} moves; the robot waited for moves {sender.starved} times within beads")
    return EXIT_VERIFIED


def _check_own(path: Path) -> None:
    """Raises InputError for a file that is there and is something else than the server's module: it is not replaced."""
    if path.is_file():
        with path.open("rb") as stream:
            if stream.readline(LONGEST_NAME).split() != [b"MODULE", MODULE.encode()]:
                raise InputError(f"holds something else than {MODULE}.mod, and stays as it is", file=path)


def program_in(folder: Path) -> Program:
    """The RAPID program in a folder of results. Raises InputError where there is none, or it cannot be read."""
    paths = [path for path in sorted(folder.glob("*.mod")) if path.stem != MODULE]
    if not paths:
        raise InputError("no RAPID program here", file=folder, hint="solve a problem first: python -m planner.solve")
    if sum(path.stat().st_size for path in paths) > LARGEST:
        raise InputError(f"modules larger than {LARGEST >> 20} MB together", file=folder)
    texts = {}
    for path in paths:
        try:
            texts[path.name] = path.read_text("ascii")
        except (OSError, UnicodeDecodeError) as error:
            raise InputError(f"cannot be read: {error}", file=path) from error
    return read_rapid_files(texts)


def send(stream: Stream, host: str, port: int, say: Callable[[str], None]) -> Sender:
    """Send all of a stream, from connection to end.

    Raises InputError where nobody answers, StreamStopped where it ended before its time; then, and when interrupted,
    the controller was told to stop as far as it can be told.
    """
    try:
        connection = socket.create_connection((host, port), timeout=CONNECTING)
    except OSError as error:
        reason = error.strerror or str(error)
        raise InputError(f"no connection to {host}:{port}: {reason}", field="--controller") from error
    with connection:
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        sender, waiting = Sender(stream, time.monotonic()), bytearray()
        try:
            _pump(connection, sender, waiting, say)
        except (StreamStopped, KeyboardInterrupt):
            _tell(connection, sender.stop(bytes(waiting)))
            raise
    return sender


def _pump(connection: socket.socket, sender: Sender, waiting: bytearray, say: Callable[[str], None]) -> None:
    told = 0.0
    connection.setblocking(False)
    while not sender.finished:
        if not waiting:
            waiting += sender.due(time.monotonic())
        readable, writable, _ = select.select([connection], [connection] if waiting else [], [], LOOK)
        try:
            if readable:
                data = connection.recv(BLOCK)
                if not data:
                    raise sender.lost()
                sender.hear(data, time.monotonic())
            if writable:
                del waiting[: connection.send(waiting)]
        except OSError as error:
            raise sender.lost() from error
        if sender.done >= told * sender.total:
            say(f"{sender.done} of {sender.total} moves begun")
            told = sender.done / sender.total + TOLD_EVERY


def _tell(connection: socket.socket, data: bytes) -> None:
    """Send a last frame and wait a little until the other side has closed."""
    connection.settimeout(LAST_WORDS)
    try:
        connection.sendall(data)
        while connection.recv(BLOCK):
            continue
    except OSError:
        return  # the controller notices by itself that the connection is gone


def _address(text: str) -> tuple[str, int]:
    host, colon, port = text.rpartition(":")
    if not colon:
        return text, PORT
    if not host or not port.isdigit() or not 0 < int(port) < 65536:
        raise InputError(f"{text!r} is not HOST or HOST:PORT", field="--controller")
    return host, int(port)


def _is_ipv4(host: str) -> bool:
    try:
        IPv4Address(host)
    except AddressValueError:
        return False
    return True


if __name__ == "__main__":
    sys.exit(main())
