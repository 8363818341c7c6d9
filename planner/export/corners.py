"""Targets around sharp turns: near enough for a corner zone not to cut them off."""

from __future__ import annotations

import numpy as np

from planner.readonly import Array, Flags, Indices

ZONE = 0.3e-3  # m, of the targets of linear moves (RAPID's z0); controllers cut it to half of the neighbouring lines


def closer_at_turns(sample: Indices, tip: Array, target: Array, turns: Flags, most: float) -> Indices:
    """Samples (m, sorted) that are targets, and what must be added for no corner to be cut by more than `most` [m].

    Within a zone controllers fly a parabola. Where that passes too far inside of the sample's tip (n, 3), targets (n, 3)
    halfway to its neighbours make the zone smaller and the turn less sharp. turns (n) says at which samples this counts.
    """
    while True:
        a, k, b = sample[:-2], sample[1:-1], sample[2:]
        before, after = target[k] - target[a], target[b] - target[k]
        far_a, far_b = np.linalg.norm(before, axis=1), np.linalg.norm(after, axis=1)
        with np.errstate(invalid="ignore"):  # lines without length: nothing is cut there
            swing = after / far_b[:, None] - before / far_a[:, None]
        middle = target[k] + 0.25 * np.minimum(ZONE, 0.5 * np.minimum(far_a, far_b))[:, None] * swing
        bad = turns[k] & (np.linalg.norm(middle - tip[k], axis=1) > most)
        more = np.unique(np.concatenate([sample, (a[bad] + k[bad]) // 2, (k[bad] + b[bad] + 1) // 2]))
        if len(more) == len(sample):
            return sample
        sample = more
