"""When a played program lays material, and which of its moves and targets belong to that."""

from __future__ import annotations

import numpy as np

from planner.export.player.played import Played
from planner.readonly import Array, Flags

AT_ONCE = 1e-9  # s by which what happens at a target may miss it


def laid_spans(played: Played) -> Array:
    """When the extruder goes on, and off again (b, 2) [s], whatever its outputs."""
    spans, on = [], float("nan")
    for event in played.events:
        if event.kind == "output" and event.value and np.isnan(on):
            on = event.t
        elif event.kind == "output" and not event.value and not np.isnan(on):
            spans.append((on, event.t))
            on = float("nan")
    return np.array(spans).reshape(-1, 2)


def laid_targets(played: Played) -> tuple[Flags, Flags]:
    """Targets (m) within beads, and those at which beads begin or end."""
    on, off = _around(played)
    arrive, leave = played.arrive, played.leave[played.target]
    edges = np.zeros(len(arrive), dtype=bool)
    for switched in laid_spans(played).T:
        for passed in (arrive, leave):
            near = np.searchsorted(passed, switched - AT_ONCE)
            near = near[near < len(passed)]
            edges[near[np.isin(near, np.searchsorted(passed, switched + AT_ONCE, side="right") - 1)]] = True
    return (arrive > on + AT_ONCE) & (arrive < off - AT_ONCE) & ~edges, edges


def laid_moves(played: Played) -> Flags:
    """Moves (m) on which material is laid from beginning to end."""
    on, off = _around(played)
    began = np.append(0.0, played.leave[played.target[:-1]])
    out: Flags = (began >= on - AT_ONCE) & (played.arrive > on + AT_ONCE) & (played.arrive <= off + AT_ONCE)
    return out


def _around(played: Played) -> tuple[Array, Array]:
    """For each target (m) when the extruder last went on before the robot came there, and when it goes off after that."""
    spans = np.vstack([[-np.inf, -np.inf], laid_spans(played)])
    k = np.searchsorted(spans[:, 0], played.arrive - AT_ONCE) - 1
    return spans[k, 0], spans[k, 1]
