"""Where a run stands according to its log, if it was not reported: the link crashed, or its computer went down."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from planner.base.errors import InputError
from planner.base.files import read_text
from planner.link.program_lines import ProgramLines
from planner.link.relay import RunOutcome

LARGEST = 1_000_000_000  # bytes; three records per line of the program
LONGEST_PLAN = 1_000_000  # characters of a plan's record, which includes the overrides of --set
UNSAID = "the log does not say why"


def outcome_of(lines: ProgramLines, path: Path) -> RunOutcome:
    """How the run of a program ended, according to its log, whose last record may be truncated, as by a power failure.

    Raises InputError, with the line, for anything but a log of the link, and for another program's log.
    """
    rows = read_text(path, LARGEST, lambda reason, hint=None: InputError(reason, file=path, hint=hint))
    received = sent = acknowledged = 0
    ended, reason = False, None
    for at, row in enumerate(rows, 1):
        if not row:
            continue
        record = _record(row)
        if record is None and at >= len(rows) - 1:
            break
        if record is None:
            raise InputError("is not a record of the link's log", file=path, line=at)
        what, n, text = record
        if what == "hello" and text != lines.module:
            raise _other(f"it is of {text}, not of {lines.module}", path, at)
        if what in ("received", "sent", "acknowledged") and not 1 <= n <= len(lines):
            raise _other(f"line {n} of {len(lines)}", path, at)
        if what == "received":
            if n != received + 1 or text != lines[n].text:
                raise _other(f"line {n} is {text!r} there, and {lines[n].text!r} in the program's table", path, at)
            received = n
        elif what == "sent":
            sent = n
        elif what == "acknowledged":
            acknowledged = n
        elif what == "stop" and reason is None:
            reason = text
        ended = ended or what == "end"
    if not max(received, sent, acknowledged) == received or not acknowledged <= sent <= acknowledged + 1:
        raise InputError(
            "lines were acknowledged that were not sent", file=path, hint="it is not the complete log of one run"
        )
    if reason is None and not (ended and acknowledged == len(lines)):
        reason = UNSAID
    return RunOutcome(reason, lines.position(acknowledged, received + (1 if ended else 0)), sent, reason is None)


def plan_in(path: Path) -> dict[str, Any]:
    """What the log of a run says of its plan, as in plan.json; empty if it says nothing."""
    try:
        with path.open(encoding="utf-8", errors="replace") as stream:
            record = _record(stream.readline(LONGEST_PLAN))
        plan: Any = json.loads(record[2]) if record is not None and record[0] == "plan" else {}
    except (OSError, ValueError, RecursionError):
        return {}
    return plan if isinstance(plan, dict) else {}


def _other(reason: str, path: Path, line: int) -> InputError:
    return InputError(
        f"is the log of another program: {reason}", file=path, line=line, hint="name the program that ran"
    )


def _record(row: str) -> tuple[str, int, str] | None:
    """What happened, to which line, and the text; None if the row is no record."""
    try:
        found: Any = json.loads(row)
    except (ValueError, RecursionError):
        return None
    match found:
        case {"utc": str(), "ms": int() | float(), "what": str(what), "n": int(n), "text": str(text)}:
            return what, n, text
    return None
