"""The libraries of a page, compressed ahead of time."""

from __future__ import annotations

import base64
import zlib

from plotly.offline import get_plotlyjs

from planner.report import page as libraries


def source(name: str) -> str:
    return zlib.decompress(base64.b64decode(libraries.library(name))).decode()


def test_they_are_what_the_packages_have() -> None:
    assert source("plotly") == get_plotlyjs()
    k3d = source("k3d")
    assert "K3D" in k3d and "font/woff2" not in k3d


def test_each_is_compressed_once() -> None:
    libraries.begin()
    first = [libraries.library(name) for name in libraries.LIBRARIES]
    libraries.begin()
    assert all(
        again is library for again, library in zip(map(libraries.library, libraries.LIBRARIES), first, strict=True)
    )
