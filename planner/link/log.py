"""The log of a run: one JSON object a line, written at once."""

from __future__ import annotations

import json
import os
import time
from collections.abc import Iterable
from datetime import UTC, datetime
from pathlib import Path

from planner.errors import OutputError
from planner.link.effects import Note


class Log:
    """Records with UTC and a steady clock [ms]. Each is with the system before anything follows from it, so that a crash
    of this program loses none; `close` waits until they are on the disk.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        try:
            self._file = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_APPEND, 0o644)
        except FileExistsError:
            raise OutputError(f"{path} is there already, and stays as it is: name another with --log") from None
        except OSError as error:
            raise OutputError(f"cannot write {path}: {error.strerror}") from None

    def write(self, notes: Iterable[Note]) -> None:
        """Append records; OSError where the disk does not take them."""
        now, clock = datetime.now(UTC).isoformat(timespec="milliseconds"), round(1e3 * time.monotonic(), 3)
        begin = f'{{"utc": "{now}", "ms": {clock}, '  # by hand, for a line of the program makes three records
        texts = [f'{begin}"what": "{note.what}", "n": {note.n}, "text": {json.dumps(note.text)}}}\n' for note in notes]
        left = memoryview("".join(texts).encode("ascii"))
        while left:
            left = left[os.write(self._file, left) :]

    def close(self) -> None:
        """Nothing more is written."""
        os.fsync(self._file)
        os.close(self._file)
