"""Lines of a drawing that are drawn twice."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Sequence
from itertools import chain
from typing import Protocol, TypeVar

import numpy as np

from planner.base.arrays import Array
from planner.base.geometry import arc_lengths

_LOOKS = 33  # places of a line by which it is told from others: not at even shares of its length, where lattices meet


class _Line(Protocol):
    """Anything with points (n, 2)."""

    @property
    def points(self) -> Array: ...


Line = TypeVar("Line", bound=_Line)


def without_twins(
    lines: Sequence[Line], same: float, group: Callable[[Line], str] = lambda line: ""
) -> tuple[list[Line], int]:
    """The lines without those that lie on another of their group, either way round, and how many these are."""
    seen: dict[tuple[str, int], list[Array]] = defaultdict(list)
    kept = []
    for line in lines:
        arc = arc_lengths(line.points)
        at = 0.5 * arc[-1] * (1.0 - np.cos(np.linspace(0.0, np.pi, _LOOKS)))
        looks = np.column_stack([np.interp(at, arc, line.points[:, k]) for k in range(2)])
        long = round(float(arc[-1]) / (4.0 * same))  # twins may be of neighbouring lengths
        like = chain.from_iterable(seen[group(line), each] for each in (long - 1, long, long + 1))
        if any(min(np.abs(looks - o).max(), np.abs(looks[::-1] - o).max()) <= same for o in like):
            continue
        seen[group(line), long].append(looks)
        kept.append(line)
    return kept, len(lines) - len(kept)
