"""Versions of everything that a result depends on."""

from __future__ import annotations

import platform
from importlib.metadata import version

PACKAGES = ("beadwise", "numpy", "scipy", "numba", "pin", "ruckig", "svgelements", "pydantic")


def versions() -> dict[str, str]:
    """Package → version, Python included."""
    return {"python": platform.python_version(), **{name: version(name) for name in PACKAGES}}
