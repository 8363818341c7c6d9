"""Shows the fields that a docstring lists, one a line, as a list.

Docstrings here name fields at the start of a line, before two blanks or a colon; what goes on is indented.
"""

from __future__ import annotations

import re
from typing import Any

import griffe

FIELD = re.compile(r"^([A-Za-z_]\w*(?:, [A-Za-z_]\w*)*)((?: +\([^)]*\))?)(?: {2,}|: +)(\S.*)$")


class FieldLists(griffe.Extension):
    """Rewrites docstrings as they are read."""

    def on_object(self, *, obj: griffe.Object, **kwargs: Any) -> None:
        """Called for every module, class, function and attribute."""
        if obj.docstring is not None:
            obj.docstring.value = as_lists(obj.docstring.value)


def as_lists(text: str) -> str:
    """The same text with lines of fields as items of a list."""
    lines: list[str] = []
    within = False
    for line in text.splitlines():
        found = FIELD.match(line)
        if found:
            if not within and lines and lines[-1]:
                lines.append("")
            names = ", ".join(f"`{name}`" for name in found[1].split(", "))
            lines.append(f"- {names}{found[2]}: {found[3]}")
            within = True
        elif within and line.startswith("  "):
            lines.append(f"    {line.strip()}")
        else:
            if within and line:
                lines.append("")
            within = False
            lines.append(line)
    return "\n".join(lines)
