"""The frame of every report: one self-contained file with styles, scripts and figures inside."""

from __future__ import annotations

import base64
import json
import os
from collections.abc import Iterable, Mapping
from html import escape
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
from plotly.offline import get_plotlyjs

from planner.errors import OutputError

# The page forbids itself the network: even a library that wanted to fetch something could not.
POLICY = "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src data: blob:"
DTYPES = {"float32": "f4", "float64": "f8", "int32": "i4", "uint16": "u2", "uint32": "u4"}


def page(title: str, header: str, body: str, footer: str, figures: Mapping[str, Any]) -> str:
    """Complete HTML of a report. `title` is plain text; `header`, `body`, `footer` are HTML already."""
    assets = files("planner.report")
    css = assets.joinpath("page.css").read_text(encoding="utf-8")
    js = assets.joinpath("page.js").read_text(encoding="utf-8")
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
            f"<script>{get_plotlyjs()}</script>",
            "</head>",
            "<body>",
            f"<header><div>{header}</div></header>",
            "<noscript><main><p>The figures need JavaScript; the tables do not.</p></main></noscript>",
            f"<main>{body}</main>",
            f"<footer><div>{footer}</div></footer>",
            f"<script type=application/json id=data>{_json(figures)}</script>",
            f"<script>{js}</script>",
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


def _json(value: Any) -> str:
    """JSON that can stand inside a script element; arrays become plotly's typed arrays in base64."""
    text = json.dumps(value, default=_plain, allow_nan=False, ensure_ascii=False, separators=(",", ":"))
    return text.replace("<", "\\u003c").replace("\u2028", "\\u2028").replace("\u2029", "\\u2029")


def _plain(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        if value.dtype.name not in DTYPES:
            value = value.astype(np.float32)
        little = np.ascontiguousarray(value, dtype=value.dtype.newbyteorder("<"))
        return {"dtype": DTYPES[value.dtype.name], "bdata": base64.b64encode(little.tobytes()).decode("ascii")}
    if isinstance(value, np.generic):
        return value.item()
    raise TypeError(f"cannot put {type(value).__name__} into the report")
