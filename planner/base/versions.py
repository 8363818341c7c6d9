"""Versions of everything that a result depends on."""

from __future__ import annotations

import platform
from importlib.metadata import version

PACKAGES = (
    "beadwise", "cadquery-ocp-novtk", "coal", "numba", "numpy", "pin", "pydantic", "pyvrp", "ruckig", "scipy", "shapely",
    "svgelements", "trimesh",
)  # fmt: skip


def versions() -> dict[str, str]:
    """Package → version, Python included."""
    return {"python": platform.python_version(), **{name: version(name) for name in PACKAGES}}
