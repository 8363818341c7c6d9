"""Commands that are run in this process on spoilt files: what they say, how they end, and what they leave."""

from __future__ import annotations

import contextlib
import io
import re
import shutil
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from benchmarks.attack.cases import BUGS, ESCAPED, FOUND, LEFT_OVER, REFUSED, Chance, Outcome, TimeLimit, time_limit
from benchmarks.attack.problems import LONGEST_MESSAGE
from benchmarks.attack.runs import left_over
from planner.base.errors import EXIT_INPUT, EXIT_NOT_VERIFIED, EXIT_VERIFIED

LONGEST = 90.0  # s of a command, on a busy machine


@dataclass(frozen=True)
class Said:
    """What a command said, and its exit code; None where it was not waited for."""

    code: int | None
    out: str
    err: str


def said_by(main: Callable[[Sequence[str]], int], arguments: Sequence[str]) -> Said:
    """Run a command; warnings of packages are said too, as at a terminal."""
    out, err = io.StringIO(), io.StringIO()
    with (
        warnings.catch_warnings(record=True) as warned,
        contextlib.redirect_stdout(out),
        contextlib.redirect_stderr(err),
    ):
        warnings.simplefilter("always")
        try:
            with time_limit(LONGEST):
                code: int | None = main(arguments)
        except TimeLimit:
            code = None
        except SystemExit as ended:
            code = ended.code if isinstance(ended.code, int) else 1
    told = [f"{each.category.__name__}: {each.message} ({Path(each.filename).name}:{each.lineno})" for each in warned]
    return Said(code, out.getvalue(), "\n".join([*told, err.getvalue()]))


def attack_command(
    main: Callable[[Sequence[str]], int],
    arguments: Sequence[str],
    out: Path,
    spoilt: Sequence[str],
    what: str,
    judged: Callable[[Said], Outcome],
) -> Outcome:
    """Run a command on a spoilt file: it ends with results, which are judged, or with a refusal that names the file and leaves
    nothing.

    out     folder of its results, which is not there before, and is removed;  spoilt: what may be named, a file or an option
    judged  results
    """
    try:
        said = said_by(main, arguments)
        wrong, harm = _wrong(said, out, spoilt)
        if wrong:
            return Outcome(what, ESCAPED, wrong, harm)
        if said.code == EXIT_INPUT:
            return Outcome(what, REFUSED, said.err.strip())
        if said.code == EXIT_NOT_VERIFIED:
            return Outcome(what, FOUND, said.err.strip() or said.out.strip().splitlines()[-1])
        return judged(said)
    finally:
        shutil.rmtree(out, ignore_errors=True)


def _wrong(said: Said, out: Path, spoilt: Sequence[str]) -> tuple[str, dict[str, int]]:
    """What no command may do, whatever it is given; and the harm in that."""
    if said.code is None:
        return f"no end in {LONGEST:.0f} s", {}
    if "Traceback" in said.err or "Warning" in said.err:
        return said.err.strip()[-300:], {BUGS: 1}
    if said.code not in (EXIT_VERIFIED, EXIT_INPUT, EXIT_NOT_VERIFIED):
        return f"exit code {said.code}: {said.err.strip()[-300:]}", {BUGS: 1}
    if out.is_dir() and left_over(out):
        return f"left {left_over(out)}", {LEFT_OVER: 1}
    if said.code == EXIT_VERIFIED:
        return "", {}
    if out.is_dir() and any(out.iterdir()):
        return f"exit code {said.code}, and wrote {sorted(path.name for path in out.iterdir())}", {LEFT_OVER: 1}
    if said.code == EXIT_INPUT:
        line = said.err.strip()
        if not any(name in line for name in spoilt):
            return f"names none of {', '.join(spoilt)}: {line}", {}
        if not all(c.isprintable() for c in line) or len(line) > LONGEST_MESSAGE:
            return f"not printable, or endless: {line[:200]!r}", {}
    return "", {}


def numbers_after(text: str, pattern: str) -> list[tuple[float, ...]]:
    """The numbers of each place that matches a pattern of groups."""
    return [tuple(float(group) for group in match.groups()) for match in re.finditer(pattern, text)]


def own_folder(folder: Path, by: Chance) -> Path:
    """A folder of one case."""
    own = folder / f"{by.getrandbits(60):x}"
    own.mkdir()
    return own
