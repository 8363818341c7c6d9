"""Names of the ways to visit the samples of a face; `rows` (rows.py) makes points of its own instead."""

from __future__ import annotations

from collections.abc import Callable
from types import MappingProxyType

from planner.toolpath.coverage.orders import greedy, weighted_greedy
from planner.toolpath.coverage.sampled import Ints, SampledSurface
from planner.toolpath.coverage.tour import tour

ORDERS: MappingProxyType[str, Callable[[SampledSurface], Ints]] = MappingProxyType(
    {"greedy": greedy, "weighted_greedy": weighted_greedy, "tour": tour}
)
