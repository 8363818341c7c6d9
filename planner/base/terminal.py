"""What commands print on: a terminal or a pipe that cannot take a text costs that text, never what was computed."""

from __future__ import annotations

import errno
import io
import os
import sys
from typing import TextIO


class Forgiving(io.RawIOBase):
    """Bytes to another stream, until that fails: from then on they are forgotten, and the reason is said once.

    A pipe whose reader has gone (`| head`) is no failure.
    """

    def __init__(self, below: io.RawIOBase, complain_on: TextIO | None) -> None:
        self._below, self._complain_on, self._broken = below, complain_on, False

    def writable(self) -> bool:
        return True

    def isatty(self) -> bool:
        return self._below.isatty()

    def fileno(self) -> int:
        return self._below.fileno()

    def write(self, data: bytes) -> int | None:  # type: ignore[override]
        if self._broken:
            return len(data)
        try:
            return self._below.write(data)
        except OSError as error:
            self._broken = True
            if error.errno != errno.EPIPE and self._complain_on is not None:
                print(f"warning: what follows could not be printed: {error.strerror}", file=self._complain_on)
            return len(data)


def forgive_output() -> None:
    """From here on printing does not fail: letters that a terminal lacks become `?`, bytes that go nowhere are forgotten."""
    sys.stderr = _forgiving(sys.stderr, None)
    sys.stdout = _forgiving(sys.stdout, sys.stderr)


def _forgiving(stream: TextIO | None, complain_on: TextIO | None) -> TextIO:
    """A stream that prints where another does; that one itself if it is no file of the system, or forgives already."""
    if stream is None:  # was closed before this process began
        return open(os.devnull, "w", encoding="utf-8")
    below = getattr(stream, "buffer", None)
    raw = getattr(below, "raw", below)  # there is no buffer between where Python runs unbuffered
    if not isinstance(stream, io.TextIOWrapper) or not isinstance(raw, io.RawIOBase) or isinstance(raw, Forgiving):
        return stream
    stream.flush()
    return io.TextIOWrapper(
        io.BufferedWriter(Forgiving(raw, complain_on)),  # type: ignore[type-var]
        encoding=stream.encoding,
        errors="replace",
        newline=None,
        line_buffering=stream.line_buffering,
        write_through=stream.write_through,
    )
