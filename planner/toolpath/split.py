"""Splits beads into pieces: where the nozzle leaves a bead and returns, one bead becomes two that meet."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from planner.base.arrays import Array, Ints, ReadOnlyArrays
from planner.base.geometry import arc_lengths
from planner.toolpath.bead import Bead, Split, Surface, SurfaceOver, Toolpath

_DRIFT = 0.02  # × the source's length: how far a place on the source may be from the same share of its length


def split_toolpath(
    toolpath: Toolpath, places: Mapping[int, Sequence[tuple[float, str]]], backwards: Collection[int] = ()
) -> Toolpath:
    """The toolpath with beads (by index) split at places: sorted arc lengths [m], each with its reason.

    Pieces are named after their bead and listed in `splits`; the beads after them have higher numbers. Pieces of beads
    that run `backwards` are numbered from the end, so that those that lie on each other have the same name.
    """
    beads: list[Bead] = []
    splits: list[Split] = []
    origin, begin = [], []
    for k, bead in enumerate(toolpath.beads):
        at = [int(np.argmin(np.abs(bead.s - s))) for s, _ in places.get(k, ())]
        edges = [0, *at, len(bead.s) - 1]
        for j, (first, last) in enumerate(zip(edges[:-1], edges[1:], strict=True)):
            if j:
                splits.append(Split(len(beads), bead.name, bead.layer, float(bead.s[first]), places[k][j - 1][1]))
            origin.append(k)
            begin.append(float(bead.s[first]))
            number = len(edges) - 1 - j if k in backwards else j + 1
            beads.append(bead if len(edges) == 2 else _piece(bead, first, last, number))
    surface = PiecewiseSurface(toolpath.surface, np.array(origin), np.array(begin))
    notes = (*toolpath.notes, *_notes(splits))
    return replace(toolpath, beads=tuple(beads), surface=surface, notes=notes, splits=tuple(splits))


def _piece(bead: Bead, first: int, last: int, number: int) -> Bead:
    """Samples first .. last of a bead, as a bead of its own."""
    own = slice(first, last + 1)
    along = arc_lengths(bead.source)
    low, high = (_on_source(bead, along, i) for i in (first, last))
    inner = (along > low) & (along < high)
    ends = [np.stack([np.interp(at, along, column) for column in bead.source.T], axis=-1) for at in (low, high)]
    return replace(
        bead,
        name=f"{bead.name}, piece {number}",
        s=bead.s[own] - bead.s[first],
        points=bead.points[own],
        normals=bead.normals[own],
        roll_zero=bead.roll_zero[own],
        source=np.vstack([ends[0], bead.source[inner], ends[1]]),
        width=bead.width[own],
        height=bead.height[own],
        closed=False,
    )


def _on_source(bead: Bead, along: Array, i: int) -> float:
    """Arc length of the place on the source, whose points are at `along` (m), nearest to sample i of the bead.

    Only places near the same share of the length count, since other turns may come nearer.
    """
    if i in (0, len(bead.s) - 1):
        return float(along[0 if i == 0 else -1])
    middle = bead.s[i] / bead.length * along[-1]
    drift = _DRIFT * along[-1]
    k = np.flatnonzero((along[1:] >= middle - drift) & (along[:-1] <= middle + drift))
    a, way = bead.source[k], bead.source[k + 1] - bead.source[k]
    square = np.maximum((way**2).sum(axis=1), 1e-18)
    share = np.clip(((bead.points[i] - a) * way).sum(axis=1) / square, 0.0, 1.0)
    best = int(np.argmin(np.linalg.norm(a + share[:, None] * way - bead.points[i], axis=1)))
    return float(along[k[best]] + share[best] * np.sqrt(square[best]))


def _notes(splits: Sequence[Split]) -> tuple[str, ...]:
    """A sentence for each bead that is laid in pieces."""
    found: dict[tuple[str, int], list[Split]] = {}
    for split in splits:
        found.setdefault((split.name, split.layer), []).append(split)
    return tuple(
        f"path {name!r} of layer {layer + 1} is laid in {len(each) + 1} pieces, since it cannot be followed in one go: "
        + "; ".join(f"at {split.s * 1e3:.1f} mm {split.why}" for split in each)
        for (name, layer), each in found.items()
    )


@dataclass(frozen=True)
class PiecewiseSurface(ReadOnlyArrays, SurfaceOver):
    """The surface beneath pieces of beads: `origin` (n), the bead of each, and `begin` (n), its start on that [m]."""

    origin: Ints
    begin: Array

    def normals_on(self, bead: int, s: Array, tips: Array) -> Array:
        """Normals beneath a piece."""
        return self.surface.normals_on(int(self.origin[bead]), s + self.begin[bead], tips)

    def before(self, bead: int) -> Surface:
        """The surface after so many pieces have been printed; a bead counts only when it is complete."""
        whole = int(self.origin[bead]) if bead < len(self.origin) else int(self.origin[-1]) + 1
        return self.surface.before(whole)
