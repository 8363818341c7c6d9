"""Passwords: from the environment or a prompt, and never shown."""

from __future__ import annotations

import getpass
import os
import sys

from planner.errors import InputError


class Secret:
    """Text that neither `str` nor `repr` gives away."""

    def __init__(self, text: str) -> None:
        self._text = text

    def __repr__(self) -> str:
        return "Secret(…)"

    def reveal(self) -> str:
        """The text, to be handed on to where it is needed and nowhere else."""
        return self._text


def password(variable: str, whose: str) -> Secret:
    """The password in an environment variable, or what the user types; InputError where neither can be had."""
    found = os.environ.get(variable)
    if found is not None:
        return Secret(found)
    if not sys.stdin.isatty():
        raise InputError(f"there is no password for {whose}", hint=f"set {variable}")
    try:
        return Secret(getpass.getpass(f"password for {whose}: "))
    except EOFError:  # Ctrl-D
        raise InputError(f"no password was given for {whose}", hint=f"type it, or set {variable}") from None
