"""The frame of every report: one self-contained file with styles, scripts and figures packed inside."""

from __future__ import annotations

import base64
import json
import os
import re
import struct
import zlib
from collections.abc import Iterable, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from functools import cache
from html import escape
from importlib.metadata import distribution
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np

from planner.base.arrays import Array
from planner.base.errors import OutputError

# ----------------------------------------------------------------------------------------------------
# Figures and libraries as the page carries them: numbers as they are, all of it compressed, in base64.
#
# What is packed is four bytes with the length of a JSON text, the text, and the arrays that it refers to by
# {"array": [kind, offset, count]}; everything little-endian, arrays on whole eight bytes from where they begin.

KINDS = {"float32": "f4", "float64": "f8", "int32": "i4", "int8": "i1", "uint8": "u1", "uint16": "u2", "uint32": "u4"}
LEVEL = 9  # of compression: a page is written once and opened often
FINEST = 65534  # steps of a value from the least to the greatest; one more stands for no number
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
    """Values (n) in 16 bits: `low`, `step` and numbers of steps; FINEST + 1 for what is not finite."""
    finite = np.isfinite(values)
    low, high = (float(values[finite].min()), float(values[finite].max())) if finite.any() else (0.0, 0.0)
    step = (high - low) / FINEST
    steps = np.where(finite, np.round((np.where(finite, values, low) - low) / (step or 1.0)), FINEST + 1)
    return {"low": low, "step": step, "steps": steps.astype(np.uint16)}


# ----------------------------------------------------------------------------------------------------
# The scripts of other projects that a page carries, compressed: the same for every page, and half a second of work.

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


# ----------------------------------------------------------------------------------------------------
# The frame of every report: one self-contained file with styles, scripts and figures inside.

# The page forbids itself the network: even a library that wanted to fetch something could not.
POLICY = "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src data: blob:"
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


def page(title: str, header: str, body: str, footer: str, figures: Mapping[str, Any]) -> str:
    """Complete HTML of a report. `title` is plain text; `header`, `body`, `footer` are HTML already.

    figures: `scene` (see scene.py) or None, `charts`: each with `key`, `traces`, `layout`; `time` if its x is time; and
    `roll_map` (see roll_map.py) where there is one, beside charts.
    """
    assets = files("planner.report")
    css = assets.joinpath("page.css").read_text(encoding="utf-8")
    js = "".join(assets.joinpath(f"{name}.js").read_text(encoding="utf-8") for name in SCRIPTS)
    return "\n".join(
        [
            "<!doctype html>",
            "<html lang=en>",
            "<head>",
            "<meta charset=utf-8>",
            f'<meta http-equiv="Content-Security-Policy" content="{POLICY}">',
            '<meta name=viewport content="width=device-width, initial-scale=1">',
            '<link rel=icon href="data:,">',
            f"<title>{escape(title)}</title>",
            f"<style>{css}</style>",
            "</head>",
            "<body>",
            f"<header><div>{header}</div></header>",
            "<noscript><main><p>The figures need JavaScript; the tables do not.</p></main></noscript>",
            "<div id=too-old hidden><p>This browser is too old to unpack the figures: it needs DecompressionStream "
            "(Chrome 80, Firefox 113, Safari 16.4, or later). The tables can be read without.</p></div>",
            f"<main>{body}</main>",
            f"<footer><div>{footer}</div></footer>",
            f"<script type=text/plain id=data>{packed(figures)}</script>",
            *([f"<script type=text/plain id=k3d-source>{library('k3d')}</script>"] if figures.get("scene") else []),
            *([f"<script type=text/plain id=plotly-source>{library('plotly')}</script>"] if figures["charts"] else []),
            f'<script>"use strict";\n(() => {{\n{js}}})();</script>',
            "</body>",
            "</html>",
            "",
        ]
    )


def write_text(path: Path, text: str) -> None:
    """Write a file whole or not at all; OutputError where the place cannot be written."""
    partial = path.with_name(path.name + ".partial")
    try:
        partial.write_text(text, encoding="utf-8", newline="\n")
        os.replace(partial, path)
    except OSError as error:
        partial.unlink(missing_ok=True)
        raise OutputError(f"cannot write {path}: {error.strerror}") from error


def verdict(ok: bool, headline: str, detail: str) -> str:
    """The banner: a sign, a headline in plain text, and `detail` in HTML."""
    sign, kind = ("✓", "go") if ok else ("✗", "stop")
    return (
        f"<div class='verdict {kind}' role=status><div class=sign aria-hidden=true>{sign}</div>"
        f"<div><strong>{escape(headline)}</strong>{detail}</div></div>"
    )


def tiles(items: Iterable[tuple[str, str]]) -> str:
    """A row of figures: (value in HTML, what it is in HTML)."""
    each = "".join(f"<div class=tile><b>{value}</b><span>{label}</span></div>" for value, label in items)
    return f"<div class=tiles>{each}</div>"


def pairs_table(caption: str, pairs: Iterable[tuple[str, str]]) -> str:
    """Two columns of plain text under a small heading; nothing where there is nothing to say."""
    rows = "".join(f"<tr><th scope=row>{escape(k)}</th><td>{escape(v)}</td></tr>" for k, v in pairs)
    return f"<div><h3>{escape(caption)}</h3><table><tbody>{rows}</tbody></table></div>" if rows else ""


def flat(value: Any, prefix: str = "") -> list[tuple[str, str]]:
    """Nested settings as (dotted name, text); floats with six significant digits."""
    if isinstance(value, Mapping):
        return [pair for key, v in value.items() for pair in flat(v, f"{prefix}.{key}" if prefix else str(key))]
    if isinstance(value, float | np.floating):
        return [(prefix, f"{value:.6g}")]
    if isinstance(value, list | tuple | np.ndarray):
        return [(prefix, ", ".join(text for v in value for _, text in flat(v)))]
    return [(prefix, str(value))]
