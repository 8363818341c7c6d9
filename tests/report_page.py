"""What a report's page carries, unpacked again: its own text without the libraries, and the figures."""

from __future__ import annotations

import base64
import json
import re
import struct
import zlib
from pathlib import Path
from typing import Any

import numpy as np

KINDS = {"f4": "<f4", "f8": "<f8", "i4": "<i4", "i1": "i1", "u1": "u1", "u2": "<u2", "u4": "<u4"}
NO_NUMBER = 65535


def _block(path: Path, name: str) -> bytes:
    text = path.read_text(encoding="utf-8")
    (found,) = re.findall(rf"<script type=text/plain id={name}>([A-Za-z0-9+/=]*)</script>", text)
    return zlib.decompress(base64.b64decode(found))


def own_text(path: Path) -> str:
    """The page without the libraries and figures inside it."""
    return re.sub(r"(<script type=text/plain id=[\w-]+>)[^<]*", r"\1", path.read_text(encoding="utf-8"))


def figures(path: Path) -> dict[str, Any]:
    """The page's figures, arrays where it has arrays."""
    raw = _block(path, "data")
    (length,) = struct.unpack_from("<I", raw)

    def whole(value: dict[str, Any]) -> Any:
        if "array" not in value:
            return value
        kind, at, count = value["array"]
        return np.frombuffer(raw, KINDS[kind], count, 4 + length + at)

    return json.loads(raw[4 : 4 + length], object_hook=whole)


def library(path: Path, name: str) -> str:
    """A library of the page as the browser runs it."""
    return _block(path, f"{name}-source").decode()


def values(coarse: dict[str, Any]) -> np.ndarray:
    """Values that are kept as steps; NaN where there is none."""
    steps = np.asarray(coarse["steps"], dtype=float)
    return np.where(steps == NO_NUMBER, np.nan, coarse["low"] + coarse["step"] * steps)


def points(lines: dict[str, Any]) -> np.ndarray:
    """Points (n, 3) of lines [m]."""
    return np.column_stack([values(each) for each in lines["point"]])


def visible(path: Path) -> str:
    """The words that a reader sees."""
    text = re.sub(r"<(script|style).*?</\1>", "", own_text(path), flags=re.DOTALL)
    return re.sub(r"\s+", " ", re.sub(r"<[^>]*>", " ", text))
