"""The page of every report: one self-contained file with styles, scripts and figures packed inside."""

from __future__ import annotations

import base64
import json
import os
import re
import struct
import zlib
from collections.abc import Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from functools import cache
from importlib.metadata import distribution
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import Markup

from planner.base.arrays import Array
from planner.base.errors import OutputError
from planner.report.templates import render

# ----------------------------------------------------------------------------------------------------
# Packing of figures: numbers in binary, compressed, in base64.
#
# The format: four bytes with the length of a JSON text, the text, and the arrays that it refers to by {"array": [kind,
# offset, count]}; everything is little-endian, and arrays are aligned to eight bytes from where they begin.

KINDS = {"float32": "f4", "float64": "f8", "int32": "i4", "int8": "i1", "uint8": "u1", "uint16": "u2", "uint32": "u4"}
LEVEL = 9  # of compression: a page is written once and opened often
FINEST = 65534  # steps of a value from the least to the greatest; one more marks a value that is not finite
ALIGNED = 8  # bytes


def packed(figures: Any) -> str:
    """Base64 text of figures: dictionaries, lists, texts, numbers and arrays. TypeError for anything else."""
    blobs: list[bytes] = []

    def plain(value: Any) -> Any:
        if isinstance(value, np.generic):
            return value.item()
        if not isinstance(value, np.ndarray):
            raise TypeError(f"cannot put {type(value).__name__} into the report")
        if value.dtype.name not in KINDS:
            value = value.astype(np.float32)
        raw = np.ascontiguousarray(value, dtype=value.dtype.newbyteorder("<")).tobytes()
        at = sum(map(len, blobs))
        blobs.append(raw + bytes(-len(raw) % ALIGNED))
        return {"array": [KINDS[value.dtype.name], at, value.size]}

    text = json.dumps(figures, default=plain, allow_nan=False, ensure_ascii=False, separators=(",", ":")).encode()
    text += b" " * (-(4 + len(text)) % ALIGNED)
    return squeezed(struct.pack("<I", len(text)) + text + b"".join(blobs))


def squeezed(data: bytes) -> str:
    """Base64 text of compressed bytes."""
    return base64.b64encode(zlib.compress(data, LEVEL)).decode("ascii")


def coarse(values: Array) -> dict[str, Any]:
    """Values (n) in 16 bits: `low`, `step` and numbers of steps; FINEST + 1 for values that are not finite."""
    finite = np.isfinite(values)
    low, high = (float(values[finite].min()), float(values[finite].max())) if finite.any() else (0.0, 0.0)
    step = (high - low) / FINEST
    steps = np.where(finite, np.round((np.where(finite, values, low) - low) / (step or 1.0)), FINEST + 1)
    return {"low": low, "step": step, "steps": steps.astype(np.uint16)}


# ----------------------------------------------------------------------------------------------------
# Scripts of other projects, compressed: the same for every page, and half a second of work.

# By name: the distribution's file. Only the script is read; its package, if there is one, is not imported.
LIBRARIES = {"k3d": "k3d/static/standalone.js", "plotly": "plotly/package_data/plotly.min.js"}
# K3D's fonts are for formulas; the report has no formulas, but a browser would load all fonts.
FONTS = (r"@font-face\{(?:\$\{\w+\}|[^{}])*\}", r"data:font/woff2;base64,[A-Za-z0-9+/=]*")


def library(name: str) -> str:
    """One of LIBRARIES, compressed by `squeezed`."""
    return _begun(name).result()


def begin() -> None:
    """Begin to compress all of them in the background, which does not hold up Python.

    Not for a process that will be forked before it writes a page itself: the copy would not have the threads.
    """
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


# ----------------------------------------------------------------------------------------------------
# The page.

SCRIPTS = (
    "unpack",
    "motion",
    "beads",
    "stage",
    "views",
    "marks",
    "player",
    "colours",
    "charts",
    "roll_map",
    "embed",
    "page",
)


def page(template: str, title: str, figures: Mapping[str, Any], /, **values: Any) -> str:
    """Complete HTML of a report, by a template that extends page.html.

    figures: `scene` (see scene.py) or None; `charts`, each with `key`, `traces`, `layout`, and `time` if its x is time;
    and `roll_map` (see roll_map.py) if there is one, next to charts.
    """
    assets = files("planner.report")
    needed = (("k3d", figures.get("scene")), ("plotly", figures["charts"]))
    # styles, scripts and packed data are our own and are not escaped; the latter is base64
    return render(
        template,
        title=title,
        css=Markup(assets.joinpath("page.css").read_text(encoding="utf-8")),
        script=Markup("".join(assets.joinpath(f"{name}.js").read_text(encoding="utf-8") for name in SCRIPTS)),
        data=packed(figures),
        libraries=[(name, library(name)) for name, drawn in needed if drawn],
        **values,
    )


def write_text(path: Path, text: str) -> None:
    """Write a file whole or not at all. Raises OutputError if it cannot be written."""
    partial = path.with_name(path.name + ".partial")
    try:
        partial.write_text(text, encoding="utf-8", newline="\n")
        os.replace(partial, path)
    except OSError as error:
        partial.unlink(missing_ok=True)
        raise OutputError(f"cannot write {path}: {error.strerror}") from error


def flat(value: Any, prefix: str = "") -> list[tuple[str, str]]:
    """Nested settings as pairs (dotted name, text); floats with six significant digits."""
    if isinstance(value, Mapping):
        return [pair for key, v in value.items() for pair in flat(v, f"{prefix}.{key}" if prefix else str(key))]
    if isinstance(value, float | np.floating):
        return [(prefix, f"{value:.6g}")]
    if isinstance(value, list | tuple | np.ndarray):
        return [(prefix, ", ".join(text for v in value for _, text in flat(v)))]
    return [(prefix, str(value))]
