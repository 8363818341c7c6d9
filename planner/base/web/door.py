"""Who is let in to a page: words of its addresses, exchanged for a browser's session."""

from __future__ import annotations

import secrets
from collections import OrderedDict
from dataclasses import dataclass, replace

CODE_TIME = 60.0  # s in which a code is taken, once: a browser that has to be started needs some of them
MOST_SESSIONS = 50  # browsers; the oldest goes
MOST_CODES = 50


@dataclass(frozen=True)
class _Code:
    """A word of one use: until when it is taken [s], and the session that it was exchanged for."""

    end: float
    session: str | None = None


class Door:
    """Words that let a browser in, and the sessions that it gets for them; times [s] are of a steady clock.

    key   lasts as long as the page: for the terminal, and never in the arguments of a program, which all users of a
          computer can read
    code  is taken once and for a short time: for the browser's argument
    """

    def __init__(self) -> None:
        self.key = _word()
        self._codes: OrderedDict[str, _Code] = OrderedDict()
        self._sessions: OrderedDict[str, None] = OrderedDict()

    def code(self, now: float) -> str:
        """A new code."""
        made = _word()
        self._codes[made] = _Code(now + CODE_TIME)
        while len(self._codes) > MOST_CODES:
            self._codes.popitem(last=False)
        return made

    def enter(self, word: str, now: float) -> str | None:
        """A new session for a key or a code; None for what is neither, or not any more.

        A code that comes twice was read by somebody else, and nobody knows who was first: its session ends.
        """
        if secrets.compare_digest(word.encode(), self.key.encode()):
            return self._session()
        code = self._codes.get(word)
        if code is None or now > code.end:
            return None
        if code.session is not None:
            self._sessions.pop(code.session, None)
            return None
        session = self._session()
        self._codes[word] = replace(code, session=session)
        return session

    def knows(self, session: str) -> bool:
        """Whether somebody was let in under this name."""
        return session in self._sessions

    def _session(self) -> str:
        made = _word()
        self._sessions[made] = None
        while len(self._sessions) > MOST_SESSIONS:
            self._sessions.popitem(last=False)
        return made


def _word() -> str:
    return secrets.token_urlsafe(32)
