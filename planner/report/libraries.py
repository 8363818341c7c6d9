"""The scripts of other projects that a page carries, compressed: the same for every page, and half a second of work."""

from __future__ import annotations

import re
from concurrent.futures import Future, ThreadPoolExecutor
from functools import cache
from importlib.metadata import distribution
from pathlib import Path

from planner.report.packing import squeezed

# By name: the distribution, and its file. The script alone is read; the package, if it is one, is not imported.
LIBRARIES = {"k3d": "k3d/static/standalone.js", "plotly": "plotly/package_data/plotly.min.js"}
# K3D's fonts are for formulas; the report has none, and a browser would load them all.
FONTS = (r"@font-face\{(?:\$\{\w+\}|[^{}])*\}", r"data:font/woff2;base64,[A-Za-z0-9+/=]*")


def library(name: str) -> str:
    """One of LIBRARIES as `squeezed` has it."""
    return _begun(name).result()


def begin() -> None:
    """Begin to compress all of them beside what comes next: that takes no turns with Python. Not for a process that will
    be forked before it writes a page itself: no thread goes with the copy."""
    for name in LIBRARIES:
        _begun(name)


@cache
def _begun(name: str) -> Future[str]:
    pool = ThreadPoolExecutor(1)
    future = pool.submit(_squeezed, name)
    pool.shutdown(wait=False)
    return future


def _squeezed(name: str) -> str:
    source = Path(str(distribution(name).locate_file(LIBRARIES[name]))).read_text(encoding="utf-8")
    for font in FONTS if name == "k3d" else ():
        source = re.sub(font, "", source)
    return squeezed(source.encode())
