"""Fewest targets that still say it all: split spans of samples until interpolation meets every sample between."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from planner.readonly import Array, Indices

# (first, last, k) → how far interpolation between samples first and last misses sample k, in tolerances
Misfit = Callable[[Indices, Indices, Indices], Array]
# (first, last) → the worst of that over the samples between them; 0 where there is none
Judge = Callable[[Indices, Indices], Array]
MOST_PARTS = 4
LANE = 200  # targets that are chosen one after the other; as many lanes as there are go on at the same time
ENOUGH = 0.95  # misfit of a span that is as good as the longest one
SHORTER = 0.98  # of what the misfit says of the longest span
GUESSES = 4  # at the longest span before its bounds are halved


def fewest(kept: Indices, judge: Judge) -> Indices:
    """As `thin`, with fewer targets, for more work.

    `thin` leaves many spans that fit too well: stretches of some hundreds of them are gone through again, from target to
    target as far as each reaches.
    """
    found = thin(kept, judge)
    within = np.arange(len(found)) - np.searchsorted(found, kept)[np.searchsorted(kept, found, side="right") - 1]
    lanes = found[within % LANE == 0]
    reached = _reach(lanes, judge)
    fewer = np.diff(np.searchsorted(reached, lanes)) < np.diff(np.searchsorted(found, lanes))
    return np.unique(np.concatenate([lanes, _within(lanes, found, ~fewer), _within(lanes, reached, fewer)]))


def _within(lanes: Indices, found: Indices, chosen: NDArray[np.bool_]) -> Indices:
    """Those of `found` that stand in the chosen lanes."""
    owner = np.clip(np.searchsorted(lanes, found, side="right") - 1, 0, len(chosen) - 1)
    return found[chosen[owner]]


def _reach(lanes: Indices, judge: Judge) -> Indices:
    """Targets of each lane, each as far from the one before as misfit allows, or nearly."""
    found = [lanes]
    at, end = lanes[:-1].copy(), lanes[1:]
    fits, misses, tried = at + 1, end + 1, np.zeros(len(at), dtype=np.intp)  # bounds of the longest span's end
    guess = np.minimum(at + np.maximum((end - at) // LANE, 1), end)
    going = np.flatnonzero(at < end)
    while len(going):
        a, g = at[going], guess[going]
        worst = judge(a, g)
        good = worst <= 1.0
        fits[going] = np.where(good, g, fits[going])
        misses[going] = np.where(good, misses[going], g)
        tried[going] += 1
        low, high = fits[going], misses[going]
        done = (high - low <= 1) | (low == end[going]) | (good & (worst >= ENOUGH))
        step = (g - a) * SHORTER / np.sqrt(np.maximum(worst, 0.05))
        ahead = np.where(tried[going] < GUESSES, a + step.astype(np.intp), (low + high) // 2)
        guess[going] = np.clip(ahead, low + 1, np.maximum(high - 1, low + 1))
        arrived = going[done]
        length = fits[arrived] - at[arrived]
        at[arrived] = fits[arrived]
        found.append(fits[arrived])
        fits[arrived], misses[arrived], tried[arrived] = at[arrived] + 1, end[arrived] + 1, 0
        guess[arrived] = np.minimum(at[arrived] + length, end[arrived])
        going = going[at[going] < end[going]]
    return _balanced(lanes, np.unique(np.concatenate(found)), judge)


def _balanced(lanes: Indices, found: Indices, judge: Judge) -> Indices:
    """The same, with what was left over at the end of a lane shared with the span before, where that fits too."""
    last = np.searchsorted(found, lanes[1:])
    last = last[last - np.searchsorted(found, lanes[:-1]) >= 2]
    begin, end = found[last - 2], found[last]
    middle = (begin + end) // 2
    fits = np.maximum(judge(begin, middle), judge(middle, end)) <= 1.0
    found[last[fits] - 1] = middle[fits]
    return found


def by_samples(misfit: Misfit) -> Judge:
    """A judge of spans by the misfit of each sample within."""

    def judge(first: Indices, last: Indices) -> Array:
        out = np.zeros(len(first))
        inner = last - first - 1
        some = inner > 0
        if some.any():
            first, last, inner = first[some], last[some], inner[some]
            offset = np.concatenate([[0], np.cumsum(inner)[:-1]])
            k = np.arange(int(inner.sum())) - np.repeat(offset - first - 1, inner)
            out[some] = np.maximum.reduceat(misfit(np.repeat(first, inner), np.repeat(last, inner), k), offset)
        return out

    return judge


def thin(kept: Indices, judge: Judge) -> Indices:
    """Sorted sample indices: `kept` (sorted, unique, never dropped) and what must be added to bring misfit to <= 1.

    All spans are judged at once, level by level. A span that misses by e tolerances is cut into about sqrt(e)
    equal parts: this gives few targets in few passes.
    """
    found = [kept]
    first, last = kept[:-1], kept[1:]
    while True:
        worst = judge(first, last)
        bad = ~(worst <= 1.0)
        if not bad.any():
            return np.unique(np.concatenate(found))
        first, last, worst = first[bad], last[bad], worst[bad]
        parts = np.clip(np.ceil(np.sqrt(worst)), 2, np.minimum(MOST_PARTS, last - first)).astype(np.intp)
        owner = np.repeat(np.arange(len(first)), parts)
        part = np.arange(len(owner)) - np.repeat(np.cumsum(parts) - parts, parts)
        length = (last - first)[owner]
        first, last = (
            first[owner] + length * part // parts[owner],
            first[owner] + length * (part + 1) // parts[owner],
        )
        found.append(first)
