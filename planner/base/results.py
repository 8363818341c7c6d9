"""The folder of a command's results: replaced whole or not at all, and nothing is lost that is not the command's own.

Results are written into a folder beside their place. Then they change places with what the command left there before:
`manifest.json` lists that with digests. What is not listed, or was changed since, is kept as a `.bak`. A journal says
how far the exchange is, so that a failure takes it back, and so does the next command where this one was killed.
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import sys
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from itertools import count
from pathlib import Path
from typing import Any

from planner.base.errors import OutputError
from planner.base.signals import ignored_interrupts, interrupted, interruptions_held, undone_at_the_end

if sys.platform != "win32":
    import fcntl

MANIFEST = "manifest.json"
FORMAT = "beadwise results 1"
WRITING, REPLACED = ".beadwise-writing-", ".beadwise-replaced-"  # folders, while a command runs
_LEFT = ".left"  # ends the name of a folder that goes
_JOURNAL, _OLD = "journal.json", "old"  # in the latter
_LARGEST_MANIFEST = 10_000_000  # bytes: some 80,000 files
_TRIES = 5  # of removing a folder, into which another thread may be writing yet

Tell = Callable[[str], None]


@dataclass(frozen=True)
class Listed:
    """A file as the manifest has it: its digest, and the command that wrote it."""

    sha256: str
    by: str


@dataclass(frozen=True)
class Exchange:
    """New results against old files of a folder.

    new    names of what comes in
    old    names of results that go
    kept   name → name of files that are nobody's to remove, and stand in the way
    """

    new: tuple[str, ...]
    old: tuple[str, ...]
    kept: Mapping[str, str]


def say(sentence: str) -> None:
    """Print a note on the standard error output."""
    print(f"note: {sentence}", file=sys.stderr)


@contextmanager
def results_folder(target: Path, by: str, tell: Tell = say) -> Iterator[Path]:
    """A fresh folder to write into; on success its files take the place of what `by` left in `target` before.

    by     the command's name: results of other commands in the folder stay, unless they have the same names
    tell   gets a sentence for each file that was kept under another name, and for what a killed run left

    On any exception nothing in `target` changes.
    Raises OutputError, before anything is computed, where `target` cannot be written.
    """
    missing = [folder for folder in (target, *target.parents) if not folder.exists()]

    def leave() -> None:
        left = Path(f"{fresh}{_LEFT}")
        with suppress(OSError):
            fresh.rename(left)  # threads may be writing there still: by its old name they find nothing
        for _ in range(_TRIES):
            shutil.rmtree(left, ignore_errors=True)
            shutil.rmtree(fresh, ignore_errors=True)
            if not (left.exists() or fresh.exists()):
                break
        _unlock(alive)
        for folder in missing:  # made here: gone again if nothing came of it
            if folder.is_dir() and not any(folder.iterdir()):
                folder.rmdir()

    with ExitStack() as stack:
        try:
            with interruptions_held():
                target.mkdir(parents=True, exist_ok=True)
                with _locked(target):
                    _clear_up(target, tell)
                    fresh = Path(tempfile.mkdtemp(prefix=WRITING, dir=target))
                    alive = _lock(fresh, wait=False)
                stack.enter_context(undone_at_the_end(leave))
        except OSError as error:
            raise OutputError(f"cannot write into {target}: {error.strerror}") from error
        try:
            yield fresh
            if interrupted():  # code in C dropped it
                raise KeyboardInterrupt
            kept = _put_in_place(fresh, target, by)
        except OSError as error:
            raise OutputError(f"cannot write into {target}: {error.strerror}; what was there is there still") from error
    for name, now in kept.items():
        tell(f"{target / name} was not written by an earlier run, or changed since: it is kept as {now}")


def listed(folder: Path) -> dict[str, Listed]:
    """What the manifest of a folder lists, by name; nothing where there is none, or it is not ours."""
    files = _manifest(folder) or {}
    return {name: Listed(**entry) for name, entry in files.items() if _is_entry(name, entry)}


def _manifest(folder: Path) -> dict[str, Any] | None:
    """The files of a manifest that a command wrote, unchecked; None where there is no such manifest."""
    try:
        with (folder / MANIFEST).open("rb") as stream:
            data = json.loads(stream.read(_LARGEST_MANIFEST))
    except (OSError, ValueError, RecursionError):
        return None
    if not isinstance(data, dict) or data.get("format") != FORMAT or not isinstance(data.get("files"), dict):
        return None
    return data["files"]


def digest(path: Path) -> str:
    """SHA-256 of a file's content, as hexadecimal digits."""
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def _is_entry(name: str, entry: Any) -> bool:
    """Whether a manifest's entry is a plain file name with two texts: others are not followed."""
    return (
        name == Path(name).name
        and isinstance(entry, dict)
        and entry.keys() == {"sha256", "by"}
        and all(isinstance(value, str) for value in entry.values())
    )


def _put_in_place(fresh: Path, target: Path, by: str) -> Mapping[str, str]:
    """Move the files of `fresh` into `target`, in place of earlier results; names of what was kept → new names."""
    made = {path.name: Listed(digest(path), by) for path in sorted(fresh.iterdir())}
    with _locked(target):
        earlier = listed(target)
        stay = {name: entry for name, entry in earlier.items() if entry.by != by and name not in made}
        files = {name: vars(entry) for name, entry in {**stay, **made}.items()}
        text = json.dumps({"format": FORMAT, "files": files}, indent=1) + "\n"
        (fresh / MANIFEST).write_text(text, encoding="utf-8")
        exchange = _exchange(target, earlier, tuple(sorted([*made, MANIFEST])), by)
        with ignored_interrupts(terminations=True):  # the work is done by now, and files change places in a moment
            _carry_out(exchange, fresh, target)
    return exchange.kept


def _exchange(target: Path, earlier: Mapping[str, Listed], new: Sequence[str], by: str) -> Exchange:
    """What goes, and what is kept under another name. Raises OutputError where a folder is in the way."""
    stale = {name for name, entry in earlier.items() if entry.by == by}
    there = sorted(name for name in {*new, *stale} if os.path.lexists(target / name))
    folders = [name for name in there if (target / name).is_dir() and not (target / name).is_symlink()]
    if in_the_way := set(folders) & set(new):
        raise OutputError(f"cannot write {target / min(in_the_way)}: a folder of that name is in the way")
    files = [name for name in there if name not in folders]
    ours = [name for name in files if _is_ours(target / name, earlier)]
    return Exchange(tuple(new), tuple(ours), {name: _spare(target, name) for name in files if name not in ours})


def _is_ours(path: Path, earlier: Mapping[str, Listed]) -> bool:
    """Whether a file is as a command wrote it."""
    if path.name == MANIFEST:
        return _manifest(path.parent) is not None
    return path.name in earlier and path.is_file() and digest(path) == earlier[path.name].sha256


def _spare(folder: Path, name: str) -> str:
    """A name that is free in a folder, for a file to be kept."""
    names = (f"{name}.bak{k if k > 1 else ''}" for k in count(1))
    return next(each for each in names if not os.path.lexists(folder / each))


def _carry_out(exchange: Exchange, fresh: Path, target: Path) -> None:
    """Move old files away and new ones in, or none at all: OSError with everything as it was."""
    aside = Path(tempfile.mkdtemp(prefix=REPLACED, dir=target))
    journal = {"writing": fresh.name, "new": exchange.new, "old": exchange.old, "kept": dict(exchange.kept)}
    part = aside / f"{_JOURNAL}.part"
    try:
        (aside / _OLD).mkdir()
        part.write_text(json.dumps(journal), encoding="utf-8")
        os.replace(part, aside / _JOURNAL)  # from here on what happened can be told
        for name, now in exchange.kept.items():
            (target / name).rename(target / now)
        for name in exchange.old:
            os.replace(target / name, aside / _OLD / name)
        for name in exchange.new:
            os.replace(fresh / name, target / name)
        (aside / _JOURNAL).unlink()  # and from here on there is nothing to take back
    except OSError:
        try:
            _take_back(exchange, fresh, aside, target)
        except OSError as error:
            what = (
                f"{error.strerror}; what was there before is in {aside / _OLD}, and the next run tries to put it back"
            )
            raise OutputError(f"cannot write into {target}, nor undo what was begun: {what}") from error
        raise
    shutil.rmtree(aside, ignore_errors=True)


def _take_back(exchange: Exchange, fresh: Path, aside: Path, target: Path) -> None:
    """Undo an exchange, however far it came. OSError leaves what can't be undone to the next command."""
    for name in exchange.new:
        if fresh.is_dir() and not os.path.lexists(fresh / name) and os.path.lexists(target / name):
            os.replace(target / name, fresh / name)
    for name in exchange.old:
        if os.path.lexists(aside / _OLD / name) and not os.path.lexists(target / name):
            os.replace(aside / _OLD / name, target / name)
    for name, now in exchange.kept.items():
        if os.path.lexists(target / now) and not os.path.lexists(target / name):
            (target / now).rename(target / name)
    (aside / _JOURNAL).unlink(missing_ok=True)
    shutil.rmtree(aside, ignore_errors=True)


def _clear_up(target: Path, tell: Tell) -> None:
    """Take back exchanges in the middle of which a command was killed, and remove what it had begun to write."""
    for aside in sorted(target.glob(f"{REPLACED}*")):
        if (aside / _JOURNAL).is_file():
            writing, exchange = _journal(aside)
            _take_back(exchange, target / writing, aside, target)
            tell(f"an earlier run was killed while it replaced the results in {target}: the ones before are back")
        else:
            shutil.rmtree(aside, ignore_errors=True)
    for begun in sorted(target.glob(f"{WRITING}*")):
        with suppress(BlockingIOError):  # a command that still runs
            held = _lock(begun, wait=False)
            if held is not None:
                shutil.rmtree(begun, ignore_errors=True)
            _unlock(held)


def _journal(aside: Path) -> tuple[str, Exchange]:
    """Name of the folder of new results, and how they were to change places. OutputError where it is not ours."""
    try:
        data = json.loads((aside / _JOURNAL).read_text(encoding="utf-8"))
        exchange = Exchange(tuple(data["new"]), tuple(data["old"]), dict(data["kept"]))
        names = [data["writing"], *exchange.new, *exchange.old, *exchange.kept, *exchange.kept.values()]
        plain = all(isinstance(name, str) and name == Path(name).name for name in names)
    except (ValueError, KeyError, TypeError, RecursionError):
        plain = False
    if not plain:  # such as in a folder that came from somewhere else: files would be moved that are not results
        raise OutputError(f"cannot write into {aside.parent}: {aside} is in the way; move it elsewhere")
    return data["writing"], exchange


@contextmanager
def _locked(folder: Path) -> Iterator[None]:
    """One command at a time in the block."""
    held = _lock(folder, wait=True)
    try:
        yield
    finally:
        _unlock(held)


def _lock(folder: Path, wait: bool) -> int | None:
    """A lock on a folder, which ends with the process at the latest; none on Windows, or where a file system has none.

    Raises BlockingIOError where another has it, and it is not waited for.
    """
    if sys.platform == "win32":
        return None
    held = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        fcntl.flock(held, fcntl.LOCK_EX if wait else fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        os.close(held)
        raise
    except OSError:
        os.close(held)
        return None
    return held


def _unlock(held: int | None) -> None:
    if held is not None:
        os.close(held)
