"""Which faces of a STEP file are meant by their names and numbers, and the refusal of what a file does not hold."""

from __future__ import annotations

from collections.abc import Sequence

Wanted = Sequence[int | str] | str

_SHOWN = 12  # names of faces in a message


class Damaged(ValueError):
    """What is wrong with a file, or with what is wanted of it, and what to do about it."""

    def __init__(self, reason: str, hint: str | None = None) -> None:
        self.reason, self.hint = reason, hint
        super().__init__(reason)


def choose_faces(wanted: Wanted, known: Sequence[tuple[int, str]], what: str) -> list[int]:
    """Numbers of the faces that are wanted, in the order of `known` (their numbers and names); a name may be several's.

    Raises Damaged for a face that is not there, with those that are.
    """
    if isinstance(wanted, str):  # all
        return [number for number, _ in known]
    chosen = set()
    for face in wanted:
        found = [number for number, name in known if face in (number, name)]
        if not found:
            names = sorted({name for _, name in known if name})
            shown = ", ".join(names[:_SHOWN]) + (", ..." if len(names) > _SHOWN else "")
            numbers = f"numbers {known[0][0]} to {known[-1][0]}" if known else "none"
            raise Damaged(
                f"there is no face {face!r} in {what}", hint=f"faces: {numbers}; names: {shown}" if names else numbers
            )
        chosen.update(found)
    return [number for number, _ in known if number in chosen]
