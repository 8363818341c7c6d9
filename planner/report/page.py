"""The frame of every report: one self-contained file with styles, scripts and figures inside."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from html import escape
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np

from planner.errors import OutputError
from planner.report.libraries import library
from planner.report.packing import packed

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
