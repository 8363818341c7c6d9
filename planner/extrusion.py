"""Extrusion: how much material has flowed, from the arc length that is really reached."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planner.toolpath.bead import Bead

Array = NDArray[np.float64]


def deposited_volume(bead: Bead, s: Array) -> Array:
    """Volume (n) [m^3] laid down when the nozzle has come to arc length s (n) [m]: nothing before 0 or past the end.

    The bead's cross-section is taken as width times height.
    """
    return bead.width * bead.height * np.clip(s, 0.0, bead.length)


def flow(volume_at_edges: Array, dt: float) -> Array:
    """Mean flow (n) [m^3/s] over each sample's own dt, from the volume at its two edges (n + 1)."""
    return np.diff(volume_at_edges) / dt
