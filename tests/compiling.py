"""Test processes that run side by side compile each kernel once: the second one waits, and loads what the first wrote.

numba's cache alone does not see to that: both would compile everything in the first minutes of a fresh checkout.
"""

from __future__ import annotations

import fcntl
from typing import Any

from numba.core.compiler_lock import global_compiler_lock
from numba.core.dispatcher import Dispatcher

from planner.base.compiled import compare_options_quickly

_compile = Dispatcher.compile
_held: set[str] = set()  # locks of this process: a kernel that is compiled may ask for itself again


def take_turns() -> None:
    """From now on, of this process and all others that call this, one compiles a kernel at a time."""
    compare_options_quickly()
    Dispatcher.compile = _compile_in_turn


def _compile_in_turn(self: Dispatcher, sig: Any) -> Any:
    kept = getattr(self._cache, "_impl", None)  # numba's own functions are kept nowhere
    if kept is None or sig in self.overloads:
        return _compile(self, sig)
    kept.locator.ensure_cache_path()
    path = f"{kept.locator.get_cache_path()}/{kept.filename_base}.lock"
    with global_compiler_lock:  # first, so that no thread waits for the file while another one needs this
        if path in _held:
            return _compile(self, sig)
        with open(path, "w", encoding="utf-8") as file:
            fcntl.flock(file, fcntl.LOCK_EX)
            _held.add(path)
            try:
                return _compile(self, sig)
            finally:
                _held.discard(path)
