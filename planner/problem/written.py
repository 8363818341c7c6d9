"""Values as one line of YAML."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

_PLAIN = re.compile(r"[A-Za-z_./-][A-Za-z0-9_./ -]*")
_WORDS = {"true", "false", "null", "yes", "no", "on", "off"}


def yaml_text(value: Any) -> str:
    """A value in one line of YAML."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{key}: {yaml_text(each)}" for key, each in value.items()) + "}"
    if isinstance(value, (tuple, list)):
        return "[" + ", ".join(map(yaml_text, value)) + "]"
    if isinstance(value, float):
        return f"{value:.10g}"
    if isinstance(value, (str, Path)):
        text = str(value)
        plain = _PLAIN.fullmatch(text) and text.lower() not in _WORDS and not text.endswith(" ")
        return text if plain else "'" + text.replace("'", "''") + "'"
    return str(value)
