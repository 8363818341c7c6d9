"""What all parts of the verifier share: checks with the place of the worst sample, and the samples of each bead."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planner.plan import Check, Trajectory
from planner.readonly import Array

SPEED_TOLERANCE = 0.02  # of the commanded speed: within it a sample counts as at speed
DIGITS = 1e-9  # relative: limits are compared with this much room for rounding


def place(trajectory: Trajectory, i: int) -> str:
    """The place of a sample in words."""
    bead = int(trajectory.bead[i])
    spot = f"bead {bead}, {trajectory.s[i] * 1e3:.1f} mm" if bead >= 0 else "travel"
    return f"t = {trajectory.t[i]:.3f} s, {spot}"


def samples_of(t: Trajectory, beads: int) -> list[NDArray[np.intp]]:
    """Samples of each bead, in order of time; beads may come in any order, and more than once."""
    order = np.argsort(t.bead, kind="stable")
    bounds = np.searchsorted(t.bead[order], np.arange(beads + 1))
    return [order[a:b] for a, b in zip(bounds[:-1], bounds[1:], strict=True)]


def check_most(checks: list[Check], t: Trajectory, name: str, values: Array, limit: float, unit: str) -> float:
    """Append the check that no value (n) exceeds the limit; returns the worst. NaN fails."""
    i = int(np.argmax(np.where(np.isnan(values), np.inf, values)))
    worst = float(values[i])
    checks.append(Check(name, worst, limit, unit, bool(worst <= limit * (1.0 + DIGITS)), place(t, i), sample=i))
    return worst


def check_least(checks: list[Check], t: Trajectory, name: str, values: Array, limit: float, unit: str) -> float:
    """Append the check that no value (n) falls below the limit; returns the worst. NaN fails."""
    i = int(np.argmin(np.where(np.isnan(values), -np.inf, values)))
    worst = float(values[i])
    ok = bool(worst >= limit - DIGITS * abs(limit))
    checks.append(Check(name, worst, limit, unit, ok, place(t, i), least=True, sample=i))
    return worst
