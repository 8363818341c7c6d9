"""Output that cannot fail a command: what a terminal or pipe cannot take is lost, but never the results."""

from __future__ import annotations

import errno
import io
import os
import sys
from typing import TextIO


class Forgiving(io.RawIOBase):
    """Passes bytes on to another stream until that fails; later ones are dropped, and the reason is reported once.

    A pipe whose reader has gone (`| head`) is not reported.
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
    """From here on printing never fails: characters the terminal lacks become `?`, bytes it cannot take are dropped."""
    sys.stderr = _forgiving(sys.stderr, None)
    sys.stdout = _forgiving(sys.stdout, sys.stderr)


def _forgiving(stream: TextIO | None, complain_on: TextIO | None) -> TextIO:
    """A forgiving stream to the same place; the stream itself if it is not an OS file, or forgives already."""
    if stream is None:  # closed before this process began
        return open(os.devnull, "w", encoding="utf-8")
    below = getattr(stream, "buffer", None)
    raw = getattr(below, "raw", below)  # unbuffered Python has no buffer in between
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
