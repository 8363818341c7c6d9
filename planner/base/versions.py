"""Versions of everything that a result depends on."""

from __future__ import annotations

import platform
from importlib.metadata import PackageNotFoundError, version

PACKAGES = (
    "beadwise", "cadquery-ocp-novtk", "coal", "numba", "numpy", "pin", "pydantic", "pyvrp", "ruckig", "scipy", "shapely",
    "svgelements", "trimesh",
)  # fmt: skip


def versions() -> dict[str, str]:
    """Package → version, including Python; "unknown" if an installer other than pip left no record of it."""
    return {"python": platform.python_version(), **{name: _version(name) for name in PACKAGES}}


def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return "unknown"
