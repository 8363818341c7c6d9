"""Fills the templates next to this file (*.html): every value is escaped, unless a template made it."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from planner.plan.measures import CHECKS
from planner.report.wording import CHECK_NAMES, METRICS, MISSING, counted, number, significant


def render(template: str, /, **values: Any) -> Markup:
    """HTML of the template `template`.html with these values; a value missing from them is an error."""
    return Markup(_environment().get_template(f"{template}.html").render(values))


@cache
def _environment() -> Environment:
    found = Environment(
        loader=PackageLoader("planner", "report"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    found.filters |= {"counted": counted, "mm": _mm, "number": number, "significant": significant, "spoken": _spoken}
    found.globals |= {"CHECKS": CHECKS, "METRICS": METRICS, "MISSING": MISSING, "bad": _bad}
    return found


def _mm(lengths: Sequence[float], digits: int) -> str:
    """Lengths [m] in millimetres, separated by commas."""
    return ", ".join(f"{1e3 * length:.{digits}f}" for length in lengths)


def _spoken(check: str) -> str:
    """Name of a check without underscores."""
    return check.translate(CHECK_NAMES)


def _bad(wrong: bool) -> str:
    """Attribute of a row that is marked as wrong."""
    return " class=bad" if wrong else ""
