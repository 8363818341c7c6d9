"""The folder of a command's results: replaced whole or not at all, without losing files that are not the command's own.

Results are first written into a temporary folder. Then they change places with what the command left there before,
which `manifest.json` lists with digests. Files that are not listed, or were changed since, are kept as a `.bak`. A
journal records the exchange, so that a failure undoes it, or the next command does if this one was killed.
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
WRITING, REPLACED = ".beadwise-writing-", ".beadwise-replaced-"  # prefixes of folders that exist while a command runs
_LEFT = ".left"  # suffix of a folder that is being removed
# In a folder REPLACED: how the exchange is to go, and the files that it replaces.
_JOURNAL, _OLD = "journal.json", "old"
_LARGEST_MANIFEST = 10_000_000  # bytes: some 80,000 files
_TRIES = 5  # to remove a folder, into which another thread may still be writing

Tell = Callable[[str], None]


@dataclass(frozen=True)
class Listed:
    """A file's entry in the manifest: its digest, and the command that wrote it."""

    sha256: str
    by: str


@dataclass(frozen=True)
class Exchange:
    """New results in exchange for old files of a folder.

    new    names of files to move in
    old    names of earlier results to remove
    kept   name → new name of files in the way that are not ours to remove
    """

    new: tuple[str, ...]
    old: tuple[str, ...]
    kept: Mapping[str, str]


def say(sentence: str) -> None:
    """Print a note to standard error."""
    print(f"note: {sentence}", file=sys.stderr)


@contextmanager
def results_folder(target: Path, by: str, tell: Tell = say) -> Iterator[Path]:
    """A fresh folder to write into; on success its files replace what `by` left in `target` before.

    by     the command's name: results of other commands in the folder stay, unless they have the same names
    tell   called with a sentence for each file kept under another name, and for each exchange of a killed run undone

    On any exception nothing in `target` changes.
    Raises OutputError, before anything is computed, if `target` cannot be written.
    """
    missing = [folder for folder in (target, *target.parents) if not folder.exists()]

    def leave() -> None:
        left = Path(f"{fresh}{_LEFT}")
        with suppress(OSError):
            fresh.rename(left)  # threads may still be writing there: under its old name they no longer find it
        for _ in range(_TRIES):
            shutil.rmtree(left, ignore_errors=True)
            shutil.rmtree(fresh, ignore_errors=True)
            if not (left.exists() or fresh.exists()):
                break
        _unlock(alive)
        for folder in missing:  # created here: removed again if nothing was put into it
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
            if interrupted():  # C code dropped the exception
                raise KeyboardInterrupt
            kept = _put_in_place(fresh, target, by)
        except OSError as error:
            raise OutputError(
                f"cannot write into {target}: {error.strerror}; what was there before is unchanged"
            ) from error
    for name, now in kept.items():
        tell(f"{target / name} was not written by an earlier run, or has changed since: it is kept as {now}")


def listed(folder: Path) -> dict[str, Listed]:
    """Entries of a folder's manifest by name; empty if there is none, or it is not ours."""
    files = _manifest(folder) or {}
    return {name: Listed(**entry) for name, entry in files.items() if _is_entry(name, entry)}


def _manifest(folder: Path) -> dict[str, Any] | None:
    """The files listed in a manifest that a command wrote, unchecked; None if there is no such manifest."""
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
    """Whether a manifest's entry is a plain file name with two strings; others are ignored."""
    return (
        name == Path(name).name
        and isinstance(entry, dict)
        and entry.keys() == {"sha256", "by"}
        and all(isinstance(value, str) for value in entry.values())
    )


def _put_in_place(fresh: Path, target: Path, by: str) -> Mapping[str, str]:
    """Move the files of `fresh` into `target`, in place of earlier results; returns name → new name of files kept."""
    made = {path.name: Listed(digest(path), by) for path in sorted(fresh.iterdir())}
    with _locked(target):
        earlier = listed(target)
        stay = {name: entry for name, entry in earlier.items() if entry.by != by and name not in made}
        files = {name: vars(entry) for name, entry in {**stay, **made}.items()}
        text = json.dumps({"format": FORMAT, "files": files}, indent=1) + "\n"
        (fresh / MANIFEST).write_text(text, encoding="utf-8")
        exchange = _exchange(target, earlier, tuple(sorted([*made, MANIFEST])), by)
        with ignored_interrupts(terminations=True):  # the work is done, and the exchange takes a moment only
            _carry_out(exchange, fresh, target)
    return exchange.kept


def _exchange(target: Path, earlier: Mapping[str, Listed], new: Sequence[str], by: str) -> Exchange:
    """What to replace, and what to keep under another name. Raises OutputError if a folder is in the way."""
    stale = {name for name, entry in earlier.items() if entry.by == by}
    there = sorted(name for name in {*new, *stale} if os.path.lexists(target / name))
    folders = [name for name in there if (target / name).is_dir() and not (target / name).is_symlink()]
    if in_the_way := set(folders) & set(new):
        raise OutputError(f"cannot write {target / min(in_the_way)}: a folder of that name is in the way")
    files = [name for name in there if name not in folders]
    ours = [name for name in files if _is_ours(target / name, earlier)]
    return Exchange(tuple(new), tuple(ours), {name: _spare(target, name) for name in files if name not in ours})


def _is_ours(path: Path, earlier: Mapping[str, Listed]) -> bool:
    """Whether a file is still as a command wrote it."""
    if path.name == MANIFEST:
        return _manifest(path.parent) is not None
    return path.name in earlier and path.is_file() and digest(path) == earlier[path.name].sha256


def _spare(folder: Path, name: str) -> str:
    """A free name in a folder, for a file to keep."""
    names = (f"{name}.bak{k if k > 1 else ''}" for k in count(1))
    return next(each for each in names if not os.path.lexists(folder / each))


def _carry_out(exchange: Exchange, fresh: Path, target: Path) -> None:
    """Move old files away and new ones in, or none at all: on OSError everything is as before."""
    aside = Path(tempfile.mkdtemp(prefix=REPLACED, dir=target))
    journal = {"writing": fresh.name, "new": exchange.new, "old": exchange.old, "kept": dict(exchange.kept)}
    part = aside / f"{_JOURNAL}.part"
    try:
        (aside / _OLD).mkdir()
        part.write_text(json.dumps(journal), encoding="utf-8")
        os.replace(part, aside / _JOURNAL)  # from here on the exchange can be undone
        for name, now in exchange.kept.items():
            (target / name).rename(target / now)
        for name in exchange.old:
            os.replace(target / name, aside / _OLD / name)
        for name in exchange.new:
            os.replace(fresh / name, target / name)
        (aside / _JOURNAL).unlink()  # and from here on there is nothing to undo
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
    """Undo an exchange, however far it got. On OSError, the next command undoes the rest."""
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
    """Undo exchanges during which a command was killed, and remove what killed commands had begun to write."""
    for aside in sorted(target.glob(f"{REPLACED}*")):
        if (aside / _JOURNAL).is_file():
            writing, exchange = _journal(aside)
            _take_back(exchange, target / writing, aside, target)
            tell(
                f"an earlier run was killed while it replaced the results in {target}: the previous ones were restored"
            )
        else:
            shutil.rmtree(aside, ignore_errors=True)
    for begun in sorted(target.glob(f"{WRITING}*")):
        with suppress(BlockingIOError):  # of a command that is still running
            held = _lock(begun, wait=False)
            if held is not None:
                shutil.rmtree(begun, ignore_errors=True)
            _unlock(held)


def _journal(aside: Path) -> tuple[str, Exchange]:
    """The folder of new results, and the exchange as planned. Raises OutputError if the journal is not ours."""
    try:
        data = json.loads((aside / _JOURNAL).read_text(encoding="utf-8"))
        exchange = Exchange(tuple(data["new"]), tuple(data["old"]), dict(data["kept"]))
        names = [data["writing"], *exchange.new, *exchange.old, *exchange.kept, *exchange.kept.values()]
        plain = all(isinstance(name, str) and name == Path(name).name for name in names)
    except (ValueError, KeyError, TypeError, RecursionError):
        plain = False
    if not plain:  # as in a folder from somewhere else: files that are not results would be moved
        raise OutputError(f"cannot write into {aside.parent}: {aside} is in the way; move it elsewhere")
    return data["writing"], exchange


@contextmanager
def _locked(folder: Path) -> Iterator[None]:
    """Only one command at a time in the block."""
    held = _lock(folder, wait=True)
    try:
        yield
    finally:
        _unlock(held)


def _lock(folder: Path, wait: bool) -> int | None:
    """A lock on a folder, which ends with the process at the latest; None on Windows and on file systems without locks.

    Raises BlockingIOError if another process holds it and `wait` is False.
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
