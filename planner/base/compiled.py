"""Compiled kernels: numba's decorator with a cache that knows of changes everywhere, or without one where none can be
written; and when it compiles."""

from __future__ import annotations

import hashlib
import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any

import numba
import numpy as np
from numba.core import event

SECONDS_A_KERNEL = 0.5  # of compiling, on two cores of a server of 2024: some 250 kernels take two minutes
WORTH_TELLING = 10  # kernels: fewer are there in a few seconds


def njit(**options: Any) -> Callable[[Callable[..., Any]], Any]:
    """As `numba.njit`; where numba finds no folder for its cache, the kernel is compiled without one, and that is told.

    numba looks in the folder NUMBA_CACHE_DIR, beside the sources, and in the user's cache folder. What it finds there is
    used if nothing has changed that the kernel is made of: numba by itself looks at the kernel's own file alone, and goes
    on with old code of kernels and constants of other files.
    """

    def decorate(function: Callable[..., Any]) -> Any:
        try:
            kernel = numba.njit(**options)(function)
            if options.get("cache"):
                _stamp(kernel)
            return kernel
        except RuntimeError as error:
            if "no locator available" not in str(error):
                raise
            _tell_once()
            return numba.njit(**{**options, "cache": False})(function)

    return decorate


_stamps: dict[str, str] = {}  # of each module with kernels, by its name


def _stamp(kernel: Any) -> None:
    """Have the cached code of a kernel count for just this content of all that it is made of."""
    kernel._cache._cache_file._source_stamp = _stamp_of(kernel.py_func)  # numba has no public way


def _stamp_of(function: Any) -> str:
    """Digest of a module's file, and of the constants and kernels that it imports, which stand above its first kernel."""
    module = function.__module__
    if module not in _stamps:
        digest = hashlib.blake2b(Path(function.__code__.co_filename).read_bytes(), digest_size=16)
        for name, value in sorted(function.__globals__.items()):
            if isinstance(value, bool | int | float | tuple):
                digest.update(f"{name} {value!r}".encode())
            elif isinstance(value, np.ndarray):
                digest.update(value.tobytes())
            elif isinstance(value, type) and hasattr(value, "_fields"):
                digest.update(f"{name} {value._fields}".encode())
            elif getattr(value, "py_func", function).__module__ != module:
                digest.update(_stamp_of(value.py_func).encode())
        _stamps[module] = digest.hexdigest()
    return _stamps[module]


@cache
def _tell_once() -> None:
    print(
        "note: no cache folder can be written, so kernels are compiled anew each time; "
        "set NUMBA_CACHE_DIR to a folder that can",
        file=sys.stderr,
    )


@contextmanager
def while_compiling(begun: Callable[[int, float], Callable[[], None]]) -> Iterator[None]:
    """In the block, tell when kernels begin to be compiled that were not found in numba's cache.

    begun: told how many kernels there are to compile, and about how long that takes [s]; what it returns is called after
    each kernel. It is not told of a few.
    """
    with event.install_listener("numba:compile", _Listener(begun)):
        yield


class _Listener(event.Listener):
    """Calls `begun` at the first kernel of ours that is compiled, and what that returns after every one."""

    def __init__(self, begun: Callable[[int, float], Callable[[], None]]) -> None:
        self._begun = begun
        self._done: Callable[[], None] | None = None

    def on_start(self, event: Any) -> None:
        if self._done is None and _is_ours(event.data["dispatcher"]):
            missing = kernels_to_compile()
            told = missing >= WORTH_TELLING
            self._done = self._begun(missing, missing * SECONDS_A_KERNEL) if told else lambda: None

    def on_end(self, event: Any) -> None:
        if self._done is not None and _is_ours(event.data["dispatcher"]):
            self._done()


def kernels_to_compile() -> int:
    """How many kernels of the modules that are loaded have nothing in numba's cache."""
    modules = [module for name, module in list(sys.modules.items()) if name.startswith("planner.")]
    kernels = {id(value): value for module in modules for value in vars(module).values() if _is_ours(value)}
    return sum(not os.path.exists(_index(kernel)) for kernel in kernels.values())


def _is_ours(value: Any) -> bool:
    function = getattr(value, "py_func", None)
    return getattr(function, "__module__", "").startswith("planner.")


def _index(kernel: Any) -> str:
    """The file in which numba lists what it has compiled of a kernel; empty where it keeps nothing."""
    file = getattr(getattr(kernel, "_cache", None), "_cache_file", None)
    return str(getattr(file, "_index_path", ""))
