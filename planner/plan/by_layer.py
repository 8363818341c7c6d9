"""A plan layer by layer: when each begins, how long it takes, and how old the material below is when it is laid."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from planner.plan.plan import Plan

AGES = "interlayer_time_s"  # the verifier's series with the age of the material that each place lies on


@dataclass(frozen=True)
class LayerTimes:
    """A layer in time.

    layer              its index
    begin, time        when its first place is laid, and the time from there to the next layer's first place, or for the
                       last layer to its own last place [s]
    covered            share of its time in which it is laid on material of this print
    least, median, greatest   age of that material [s]; None if there is none
    """

    layer: int
    begin: float
    time: float
    covered: float
    least: float | None
    median: float | None
    greatest: float | None


def layer_times(plan: Plan) -> tuple[LayerTimes, ...]:
    """All layers that are laid at least in part, in the order in which they begin."""
    t = plan.trajectory
    laid = np.flatnonzero(t.deposit)
    if not len(laid):
        return ()
    layers = t.layer[laid]
    numbers, first = np.unique(layers, return_index=True)
    order = np.argsort(first)
    begins = t.t[laid[first[order]]]
    ends = np.append(begins[1:], t.t[laid[-1]])
    ages = plan.series.get(AGES, np.full(len(t), np.nan))[laid]
    found = []
    for number, begin, end in zip(numbers[order].tolist(), begins.tolist(), ends.tolist(), strict=True):
        own = ages[layers == number]
        known = own[np.isfinite(own)]
        told = (float(known.min()), float(np.median(known)), float(known.max())) if len(known) else (None, None, None)
        found.append(LayerTimes(number, begin, end - begin, len(known) / len(own), *told))
    return tuple(found)
