"""The decorator of compiled kernels: numba's, and kernels that are compiled anew where no cache can be written."""

from __future__ import annotations

import sys
from collections.abc import Callable
from functools import cache
from typing import Any

import numba


def njit(**options: Any) -> Callable[[Callable[..., Any]], Any]:
    """As `numba.njit`; where numba finds no folder for its cache, the kernel is compiled without one, and that is told.

    numba looks in the folder NUMBA_CACHE_DIR, beside the sources, and in the user's cache folder.
    """

    def decorate(function: Callable[..., Any]) -> Any:
        try:
            return numba.njit(**options)(function)
        except RuntimeError as error:
            if "no locator available" not in str(error):
                raise
            _tell_once()
            return numba.njit(**{**options, "cache": False})(function)

    return decorate


@cache
def _tell_once() -> None:
    print(
        "note: no cache folder can be written, so kernels are compiled anew each time; "
        "set NUMBA_CACHE_DIR to a folder that can",
        file=sys.stderr,
    )
