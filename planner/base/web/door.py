"""Access to a page: secret words in its addresses, exchanged for a browser's session."""

from __future__ import annotations

import secrets
from collections import OrderedDict
from dataclasses import dataclass, replace

CODE_TIME = 60.0  # s for which a code is valid, once: a browser may have to be started first
MOST_SESSIONS = 50  # browsers; the oldest is dropped
MOST_CODES = 50


@dataclass(frozen=True)
class _Code:
    """A one-time word: when it expires [s], and the session it was exchanged for."""

    end: float
    session: str | None = None


class Door:
    """Words that let a browser in, and the sessions it gets for them; times [s] are those of a monotonic clock.

    key   valid as long as the page is served: for the terminal, and never in the arguments of a program, which all
          users of a computer can read
    code  valid once and for a short time: for the browser's argument
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
        """A new session for a key or a valid code; None for anything else.

        If a code arrives twice, somebody else has read it, and nobody knows who came first: its session ends.
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
        """Whether this is the session of a browser that was let in."""
        return session in self._sessions

    def _session(self) -> str:
        made = _word()
        self._sessions[made] = None
        while len(self._sessions) > MOST_SESSIONS:
            self._sessions.popitem(last=False)
        return made


def _word() -> str:
    return secrets.token_urlsafe(32)
