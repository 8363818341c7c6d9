"""What all parts of the verifier share: checks with the place of the worst sample, and the nozzle's lean."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planner.base.arrays import Array
from planner.plan import Check, Trajectory
from planner.toolpath.bead import Toolpath

# ----------------------------------------------------------------------------------------------------
# What all parts of the verifier share: checks with the place of the worst sample, and the samples of each bead.

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


# ----------------------------------------------------------------------------------------------------
# What a nozzle that leans within its cone does to the bead, from what its joints really do.
#
# The end face of a nozzle is a plane square to its axis, through the tip, and what it irons is the bead's top. Leaning
# by an angle a from the surface normal, a point of the face at a distance r from the tip, up or down the slope, stands
# r sin(a) off the height of the tip. The face shapes a bead of width w as far as r = w/2 to each side: leaning across
# the bead it leaves one edge (w/2) sin(a) too high and the other as much too low; leaning along it, the rim that comes
# last leaves the bead that much too high or too low. The tip itself is the middle of the bore and stays on its line, so
# that no height is added to this by the lean, whichever way it is.


def bead_errors(toolpath: Toolpath, t: Trajectory, lean: Array) -> Array:
    """By how much (n) a bead's edges are off its height [m] where the nozzle leans from the normal by lean (n) [rad]."""
    width = np.zeros(len(t))
    for at, bead in zip(samples_of(t, len(toolpath.beads)), toolpath.beads, strict=True):
        width[at] = np.interp(t.s[at], bead.s, bead.width)
    return np.asarray(0.5 * width * np.sin(lean))
