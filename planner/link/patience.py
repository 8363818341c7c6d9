"""How long the board may take over a line before it counts as lost."""

from __future__ import annotations

import re
from collections import deque

ACK_TIME = 5.0  # s; a board answers within milliseconds, a busy one within some tenths of a second
HEAT_TIME = 900.0  # s; a heavy bed takes a quarter of an hour
QUEUED = 40  # moves that RepRapFirmware keeps; a line that waits for standstill waits for all of them
LONGEST_MOVE = 600.0  # s; a move that claims to take longer is not believed
_WORD = re.compile(r"([A-Z])(-?[0-9]+(?:\.[0-9]*)?|-?\.[0-9]+)")
_WAITING = {"G4", "M109", "M190", "M191", "M116", "M400"}  # answered when they are over


class Patience:
    """Follows the lines that are sent and says how long each may wait for its ack [s]."""

    def __init__(self) -> None:
        self._feed = 0.0  # mm/min, as F was last given
        self._moves: deque[float] = deque(maxlen=QUEUED)

    def of(self, gcode: str) -> float:
        """The longest time to wait for the ack of the next line [s]."""
        code = gcode.split(" ", 1)[0]
        if code in _WAITING:
            return HEAT_TIME
        if code in ("G0", "G1"):
            words = {letter: float(value) for letter, value in _WORD.findall(gcode[len(code) :])}
            self._feed = words.get("F", self._feed)
            takes = 60.0 * abs(words.get("E", 0.0)) / self._feed if self._feed > 0.0 else 0.0
            self._moves.append(min(takes, LONGEST_MOVE))
            # a full queue takes the line once its oldest move is done
            return ACK_TIME + max(self._moves)
        return ACK_TIME + sum(self._moves)
