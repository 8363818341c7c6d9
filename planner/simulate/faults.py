"""Faults that a simulator makes on demand: `kind@line`, or `kind@line:value`."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from planner.errors import InputError, nearest_name

BOARD_FAULTS = {
    "error": "answers a line with an error instead of doing it",
    "delay": "holds back a line's ok, and all after it, for so many seconds (1 unless said)",
    "jam": "the filament jams when the line is begun: nothing is accepted any more once the queue is full",
    "drop": "closes the connection when the line's ok is due: the line is done, its ok is lost",
    "garbage": "sends bytes that mean nothing instead of a line's ok",
    "resend": "takes a line's checksum for wrong, once",
    "fatal": "says !! when the line comes, and does nothing more",
}
CONTROLLER_FAULTS = {
    "drop": "closes the program's connection after the line",
    "restart": "the controller restarts after the line: the program is lost, its network silent for a while",
    "stop": "stops by itself after the line, as for a stop button, and says so",
    "garbage": "sends bytes that mean nothing instead of the line",
    "skip": "leaves the line out and goes on with the next one",
}
STREAM_FAULTS = {
    "drop": "closes the connection after the frame",
    "mute": "says nothing more after the frame",
    "stop": "stops by itself after the frame",
    "garbage": "sends bytes that mean nothing after the frame",
}
EGM_FAULTS = {
    "mute": "says nothing more after the message",
    "stop": "the program stops after the message",
    "stray": "the first axis strays by so many degrees from the message on",
    "gap": "says nothing for so many hundredths of a second after the message",
    "garbage": "sends bytes that mean nothing instead of the message",
}
_FORM = re.compile(r"([a-z]+)@([1-9][0-9]{0,8})(?::([0-9]{1,6}(?:\.[0-9]{1,3})?))?")


@dataclass(frozen=True)
class Fault:
    """A fault of a kind at a line, which counts from 1; value in the kind's unit, 1 unless said."""

    kind: str
    line: int
    value: float = 1.0


class Faults:
    """Faults that have yet to happen; each happens once."""

    def __init__(self, faults: Iterable[Fault] = ()) -> None:
        self._left = list(faults)

    def take(self, kind: str, line: int | None) -> Fault | None:
        """The fault of a kind that is due at a line, which then is past; None if there is none."""
        for fault in self._left:
            if fault.kind == kind and fault.line == line:
                self._left.remove(fault)
                return fault
        return None


def faults_of(words: Sequence[str], kinds: Iterable[str]) -> tuple[Fault, ...]:
    """Faults from words such as `delay@10:1.5`. Raises InputError for what is no fault of these kinds."""
    known = tuple(kinds)
    out = []
    for word in words:
        match = _FORM.fullmatch(word)
        if match is None:
            raise InputError(f"{word!r} is no fault", field="--fault", hint="KIND@LINE or KIND@LINE:VALUE")
        kind, line, value = match.groups()
        if kind not in known:
            near = nearest_name(kind, known)
            hint = f"did you mean {near}?" if near else f"one of {', '.join(known)}"
            raise InputError(f"unknown fault {kind!r}", field="--fault", hint=hint)
        out.append(Fault(kind, int(line), 1.0 if value is None else float(value)))
    return tuple(out)
