"""What the extruder's board does beside pushing filament: the sections `fan` and `fibre.cut_code` of `process`."""

from __future__ import annotations

import re
from typing import Annotated, Any

from pydantic import BeforeValidator

from planner.problem.fields import Form, Quantity, Section, key, refusal
from planner.problem.file import describe

CUT_PAUSE = 0.5  # s; Tawfik et al., section III.B: the cutter, on a fan's output, closes and opens in so long each
MOST_LINES = 20
_ORDER = re.compile(r"M(42|106|107|280)( [A-Z]-?\d{1,6}(\.\d{1,4})?)*|G4 P\d{1,6}")


def _order(value: Any) -> str:
    """One line of a board's macro: an output (M42, M106, M107), a servo (M280), or a pause in milliseconds."""
    if not isinstance(value, str):
        raise refusal(f"must be a line of G-code, not {describe(value)}", "quote it, for example 'M106 P0 S1'")
    if not _ORDER.fullmatch(value):
        raise refusal(
            f"{describe(value)} cannot stand here",
            "M42, M106, M107 or M280 with their words, or a pause such as G4 P500",
        )
    return value


def _few(value: Any) -> Any:
    if isinstance(value, tuple) and not 1 <= len(value) <= MOST_LINES:
        raise refusal(f"must be 1 to {MOST_LINES} lines, not {len(value)}", "for example [M106 P0 S1, G4 P500]")
    return value


CutCode = Annotated[
    tuple[Annotated[str, Form(_order, schema={"pattern": f"^({_ORDER.pattern})$"})], ...], BeforeValidator(_few)
]


def usual_cut(wait: float) -> tuple[str, ...]:
    """The published macro of a cut, its two pauses no longer than a wait [s] together."""
    ms = int(min(CUT_PAUSE, 0.5 * wait) * 1e3)
    pause = (f"G4 P{ms}",) if ms else ()
    return ("M106 P0 S1", *pause, "M106 P0 S0", *pause)


def time_of(code: tuple[str, ...]) -> float:
    """How long the pauses of a macro take together [s]."""
    return sum(int(line[len("G4 P") :]) for line in code if line.startswith("G4")) * 1e-3


class FanSpec(Section):
    """The fan that cools what is printed."""

    speed: Annotated[float, Quantity("", 0.01, 1)] = key("speed", "share of its full speed", 1)
    from_layer: Annotated[int, Quantity("", 1, 100_000, whole=True)] = key(
        "from_layer", "the first layer that it cools, counted from 1", 2
    )
    number: Annotated[int, Quantity("", 0, 31, whole=True)] = key("number", "of its output (P of M106)", 0)
