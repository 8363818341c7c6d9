"""Files that a problem names, read whole up to a size limit, and new ones, written whole or not at all."""

from __future__ import annotations

from pathlib import Path

from planner.base.errors import Complaint, InputError
from planner.base.signals import interruptions_held


def read_bytes(path: Path, largest: int, complain: Complaint, hint: str | None = None) -> bytes:
    """The file's content; `complain` makes the InputError if it is missing, unreadable, or larger than `largest` bytes.

    hint: what to do about a file that is too large.
    """
    try:
        if not path.is_file():
            raise complain(f"there is no file {path}")
        with path.open("rb") as stream:
            data = stream.read(largest + 1)
    except OSError as error:
        raise complain(f"cannot read {path}: {error.strerror}") from error
    if len(data) > largest:
        raise complain(f"{path.name} is larger than {largest // 10**6} MB", hint=hint)
    return data


def stamp_of(path: Path) -> tuple[int, int]:
    """A file's modification time [ns] and size, which change if it is replaced; InputError if it is gone."""
    try:
        stamp = path.stat()
    except OSError as error:
        raise InputError("cannot be read again", file=path, hint="it was there when the print was planned") from error
    return stamp.st_mtime_ns, stamp.st_size


def read_lines(path: Path, largest: int, complain: Complaint) -> list[str]:
    """The lines of a text file, as `read_text`, with commas replaced by blanks; InputError if it is not UTF-8."""
    return [line.replace(",", " ") for line in read_text(path, largest, complain)]


def read_text(path: Path, largest: int, complain: Complaint) -> list[str]:
    """The lines of a text file, unchanged, read as by `read_bytes`; InputError if it is not UTF-8."""
    data = read_bytes(path, largest, complain)
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = data[: error.start].count(b"\n") + 1
        raise InputError("is not UTF-8 text", file=path, line=line, hint="save it as plain text") from None
    return text.replace("\r\n", "\n").replace("\r", "\n").split("\n")


def write_new(path: Path, text: str) -> None:
    """Write a text, line ends unchanged, into a file that does not exist yet.

    Raises OSError if it exists or cannot be written; no partial file is left then.
    """
    with interruptions_held():
        stream = path.open("x", encoding="utf-8", newline="")
        try:
            with stream:
                stream.write(text)
        except OSError:
            path.unlink(missing_ok=True)
            raise
