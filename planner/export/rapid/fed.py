"""What the extruder feeds while it lays beads, and what besides."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from planner.readonly import Array, Indices

if TYPE_CHECKING:
    from planner.plan import Event, Trajectory


def event_samples(trajectory: Trajectory) -> Indices:
    """Samples at which the extruder begins or ends to move filament besides depositing: lines begin or end there."""
    edges = [_samples(trajectory, event) for event in trajectory.events if event.amount != 0.0]
    return np.unique(np.array(edges, dtype=np.intp))


def laid_filament(trajectory: Trajectory) -> Array:
    """Filament (n) [m] that was fed until each sample, without what events move: primes, retracts and purges."""
    fed: Array = trajectory.feed - trajectory.feed[0]
    for event in trajectory.events:
        if event.amount != 0.0:
            fed = fed - event.amount * np.clip((trajectory.t - event.start) / event.duration, 0.0, 1.0)
    return fed


def _samples(t: Trajectory, event: Event) -> tuple[int, int]:
    """First and last sample between which an event moves its filament."""
    since = int(np.searchsorted(t.t, event.start, side="right")) - 1
    until = int(np.searchsorted(t.t, event.start + event.duration))
    return max(since, 0), min(until, len(t) - 1)
