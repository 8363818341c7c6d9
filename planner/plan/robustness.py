"""How far a part may be from its planned place, which displacements were tried, and how the plan fared there.

A displacement shifts the part and turns it about the middle of the print. The tolerance is a ball of displacements:
shifts in any direction up to one length, and turns about any axis up to one angle, both at the same time.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy.spatial.transform import Rotation

from planner.base.arrays import Array

if TYPE_CHECKING:
    from planner.plan.plan import Check

Vector = tuple[float, float, float]

LARGEST_SHIFT_MM = 100.0  # beyond, the part is elsewhere: its place has to be measured, and the print planned again
LARGEST_TURN_DEG = 10.0  # likewise
NONE: Vector = (0.0, 0.0, 0.0)
_TERM = re.compile(r"(\d+\.?\d*|\.\d+)\s*([A-Za-z°]+)", re.ASCII)
# Metrics whose worst value over all placements is reported, and whether the least or the greatest is the worst.
LEAST, MOST = min, max
TOLD = {
    "joint_limit_margin_deg": LEAST,
    "rail_margin_mm": LEAST,
    "sigma_min": LEAST,
    "wrist_margin_deg": LEAST,
    "branch_changes_in_deposition": MOST,
    "at_speed_fraction": LEAST,
    "speed_min_mm_s": LEAST,
    "deposition_time_s": MOST,
    "print_time_s": MOST,
}
CLEARANCE = "clearance"  # in a metric's name: a distance from something, of which the least is the worst


@dataclass(frozen=True)
class Tolerance:
    """The greatest shift [m] of the part, and the greatest turn [rad] about its middle."""

    shift: float
    turn: float

    @property
    def words(self) -> str:
        """The tolerance as written on the command line: 2mm,1deg."""
        return f"{self.shift * 1e3:.6g}mm,{math.degrees(self.turn):.6g}deg"

    def times(self, factor: float) -> Tolerance:
        """The tolerance, scaled by a factor."""
        return Tolerance(factor * self.shift, factor * self.turn)


def parse_tolerance(text: str) -> Tolerance:
    """Read `2mm,1deg`: in any order, blanks allowed, one of the two if the other is 0.

    Raises ValueError, which says what is wrong.
    """
    values: dict[str, float] = {}
    for term in text.split(","):
        found = _TERM.fullmatch(term.strip())
        unit = "" if found is None else found[2]
        if found is None or unit not in ("mm", "deg"):
            raise ValueError(
                f"{text!r} is not a tolerance: give a shift in mm, a turn in deg, or both, such as 2mm,1deg"
            )
        if unit in values:
            raise ValueError(f"{text!r} gives {unit} twice")
        values[unit] = float(found[1])
    for unit, most in (("mm", LARGEST_SHIFT_MM), ("deg", LARGEST_TURN_DEG)):
        if values.get(unit, 0.0) > most:
            raise ValueError(f"{values[unit]:g} {unit} is too large for a tolerance: at most {most:g} {unit}")
    return Tolerance(values.get("mm", 0.0) / 1e3, math.radians(values.get("deg", 0.0)))


@dataclass(frozen=True)
class Displacement:
    """The part shifted [m] and turned by a rotation vector [rad] about its middle, both in the planned part frame."""

    name: str
    shift: Vector = NONE
    turn: Vector = NONE

    def matrix(self, middle: Array) -> Array:
        """T_planned_displaced (4, 4): the displaced part frame in the planned one, turned about `middle` (3) [m]."""
        T = np.eye(4)
        T[:3, :3] = Rotation.from_rotvec(self.turn).as_matrix()
        T[:3, 3] = middle + self.shift - T[:3, :3] @ middle
        return T


@dataclass(frozen=True)
class Bound:
    """How far a margin can change within the tolerance, to first order, where it comes closest to its limit.

    what     "joint range", or "singularity margin", which has no joint
    change   greatest change there, in any direction of the tolerance; room: the margin left  [rad; σ has no unit]
    factor   room / change: multiple of the tolerance up to which it holds, to first order
    bead, layer, s   where: arc length [m], below 0 or beyond the bead's length in its runs
    worst    the displacement within the tolerance that causes this change
    """

    what: str
    joint: str
    change: float
    room: float
    factor: float
    bead: int
    layer: int
    s: float
    worst: Displacement


@dataclass(frozen=True)
class TriedDisplacement:
    """The plan at one displacement: the verifier's checks and metrics, or why there is no motion."""

    displacement: Displacement
    checks: tuple[Check, ...] = ()
    metrics: dict[str, float] | None = None
    refusal: str = ""

    @property
    def verified(self) -> bool:
        """Whether there is a motion, and every check holds."""
        return not self.refusal and all(check.ok for check in self.checks)

    @property
    def failures(self) -> tuple[str, ...]:
        """What fails, and where."""
        failed = (check.words for check in self.checks if not check.ok)
        return (self.refusal,) if self.refusal else tuple(failed)


@dataclass(frozen=True)
class Robustness:
    """Whether the plan holds for parts displaced within a tolerance.

    middle   (3) middle of the print, about which the part is turned, part frame [m]
    bounds   to first order, along every bead: of the joints' ranges, tightest first, then of the singularity margin
    tried    displacements solved and verified in full; the first one is the part's planned place
    """

    tolerance: Tolerance
    middle: Vector
    bounds: tuple[Bound, ...]
    tried: tuple[TriedDisplacement, ...]

    @property
    def holds(self) -> bool:
        """Whether the plan is verified at every displacement that was tried."""
        return all(each.verified for each in self.tried)

    @property
    def worst_checks(self) -> tuple[tuple[Check, Displacement], ...]:
        """Every check at its worst over all displacements, with the displacement."""
        by_name: dict[str, list[tuple[Check, Displacement]]] = {}
        for each in self.tried:
            for check in each.checks:
                by_name.setdefault(check.name, []).append((check, each.displacement))
        return tuple(min(found, key=lambda pair: _severity(pair[0])) for found in by_name.values())

    @property
    def worst_metrics(self) -> dict[str, tuple[float, Displacement]]:
        """Metrics of print quality at their worst over all displacements, with the displacement."""
        names = {name: None for each in self.tried for name in each.metrics or {}}
        out = {}
        for name in names:
            worst = TOLD.get(name, LEAST if CLEARANCE in name else None)
            if worst is not None:
                out[name] = _worst(worst, name, self.tried)
        return out


def _severity(check: Check) -> tuple[bool, float]:
    """Sort key for checks of one name, the worst first: failures, then those closest to their limit."""
    if math.isnan(check.worst):
        return check.ok, -math.inf
    return check.ok, check.worst - check.limit if check.least else check.limit - check.worst


def _worst(
    worst: Callable[..., tuple[float, Displacement]], name: str, tried: Iterable[TriedDisplacement]
) -> tuple[float, Displacement]:
    found = [(each.metrics[name], each.displacement) for each in tried if each.metrics and name in each.metrics]
    return worst(found, key=lambda pair: pair[0])
