"""Figures and libraries as the page carries them: numbers as they are, all of it compressed, in base64.

What is packed is four bytes with the length of a JSON text, the text, and the arrays that it refers to by
{"array": [kind, offset, count]}; everything little-endian, arrays on whole eight bytes from where they begin.
"""

from __future__ import annotations

import base64
import json
import struct
import zlib
from typing import Any

import numpy as np

from planner.readonly import Array

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
