"""The travelling salesman's order of a face's samples: an open tour, searched locally from the greedy one.

Onstein et al., algorithm 5. PyVRP searches (one vehicle, a depot next door to everywhere), stopped by a count of
iterations, never by a clock, so that the same tour comes out on any machine. It does not turn pieces of a tour round:
`two_opt` does, which takes away the last crossings.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pyvrp
from pyvrp.stop import MaxIterations

from planner.toolpath.coverage.orders import greedy
from planner.toolpath.coverage.sampled import Ints, SampledSurface, along_surface
from planner.toolpath.coverage.two_opt import improve

MOST_SAMPLES = 4000  # of a tour: distances between all pairs are held at once, 128 MB
ITERATIONS = 2000  # 4 s for 1,000 samples
_UNIT = 1e-6  # spacings: PyVRP counts in whole numbers
_SEED = 1


class TooManySamplesError(ValueError):
    """A tour over more samples than MOST_SAMPLES."""


def tour(surface: SampledSurface) -> Ints:
    """A short open tour over the samples (n,), from near the greedy one. Raises TooManySamplesError."""
    n = len(surface.points)
    if n > MOST_SAMPLES:
        raise TooManySamplesError(f"a tour over {n} samples: at most {MOST_SAMPLES}")
    start = greedy(surface)
    if n < 3:
        return start
    distance = along_surface(surface, surface.links(), np.arange(n, dtype=np.int64))
    distance = 0.5 * (distance + distance.T)
    unit = _UNIT * max(surface.spacing)
    whole: Any = np.zeros((n + 1, n + 1), dtype=np.int64)  # the first is the depot
    whole[1:, 1:] = np.rint(distance / unit)
    np.fill_diagonal(whole, 0)
    places = [pyvrp.Location(0.0, 0.0), *(pyvrp.Location(*xy) for xy in surface.points[:, :2].tolist())]
    data = pyvrp.ProblemData(
        places,
        [pyvrp.Client(place) for place in range(1, n + 1)],
        [pyvrp.Depot(0)],
        [pyvrp.VehicleType()],
        [whole],
        [0 * whole],
    )
    first = pyvrp.Solution(data, [[int(i) for i in improve(start, distance)]])
    found = pyvrp.solve(data, MaxIterations(ITERATIONS), seed=_SEED, collect_stats=False, initial_solution=first)
    visited = [step.idx for route in found.best.routes() for step in route if step.is_client()]
    return improve(np.array(visited, dtype=np.int64), distance)
