"""Clips plane curves to where a part can be printed on: the rest is reported and drawn, or refused above a share."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import uniform_filter1d
from scipy.spatial import cKDTree

from planner.base.arrays import Array, Flags, Ints, true_runs
from planner.base.geometry import arc_lengths
from planner.problem import Problem
from planner.toolpath.plane_paths import PlaneCurve, densify, length
from planner.toolpath.substrate.mesh_top import TooRoughMesh
from planner.toolpath.svg.outlines import PlanePath

STEEPEST = 75.0  # deg from the horizontal: steeper, a hair's breadth aside is far down, and the nozzle lies flat
SHORTEST = 3.0  # bead widths: shorter pieces of a cut curve are left out, too
_SAME = 1e-9  # m: vertices closer than this to a cut coincide with it
_AROUND = 5  # samples to either side over which facets' slopes are averaged: a single noisy one is no wall
_DRAWN = 10  # every so many dense points, one is drawn
_ROUNDED_UP = 1e-3  # step to which a share in a hint is rounded up

FITS, OFF, STEEP, EDGE, FOLDS, SHORT = range(6)
_WORDS = {
    OFF: "off the part",
    STEEP: f"where it is steeper than {STEEPEST:g} degrees",
    EDGE: "at edges of the part",
    FOLDS: "where it is bent inwards so tightly that layers would fold",
    SHORT: "too short for a bead",
}


@dataclass(frozen=True)
class Cut:
    """A piece (n, 2) of a path [m] that is left out, and why."""

    name: str
    why: int
    points: Array


@dataclass(frozen=True)
class Clipped:
    """Paths that can be printed, and what was cut from them; `drawn` is the length of the whole drawing [m].

    told: notes on the file that they come from
    """

    paths: tuple[PlanePath, ...]
    drawn: float
    cuts: tuple[Cut, ...] = ()
    told: tuple[str, ...] = ()

    @classmethod
    def of(cls, paths: Iterable[PlanePath], width: float) -> Clipped:
        """All paths except those shorter than a bead is wide [m]."""
        every = tuple(paths)
        lengths = [length(path.points) for path in every]
        short = [size < width for size in lengths]
        cuts = tuple(Cut(path.name, SHORT, path.points) for path, each in zip(every, short, strict=True) if each)
        return cls(tuple(path for path, each in zip(every, short, strict=True) if not each), sum(lengths), cuts)

    def without(self, reasons: Callable[[Array], Ints], width: float) -> Clipped:
        """The same, with paths cut where `reasons` at their places x, y (n, 2) are not FITS; width of a bead [m]."""
        paths: list[PlanePath] = []
        cuts = list(self.cuts)
        for path in self.paths:
            dense = densify(path.points)
            why = reasons(dense)
            if not why.any():
                paths.append(path)
                continue
            for reason in np.unique(why[why != FITS]).tolist():
                there = why == reason
                beside = np.zeros(len(why), dtype=bool)
                beside[1:] |= there[:-1]
                beside[:-1] |= there[1:]
                lost = there | (beside & (why == FITS))  # up to what is kept
                cuts += [Cut(path.name, reason, piece.points) for piece in trim_path(path, dense, lost)]
            for piece in trim_path(path, dense, why == FITS):
                if length(piece.points) < SHORTEST * width:
                    cuts.append(Cut(path.name, SHORT, piece.points))
                else:
                    paths.append(piece)
        return replace(self, paths=tuple(paths), cuts=tuple(cuts))

    @property
    def share(self) -> float:
        """How much of the length is left out."""
        return sum(length(cut.points) for cut in self.cuts) / max(self.drawn, _SAME)

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes on the file, and on what was left out."""
        if not self.cuts:
            return self.told
        parts = []
        for why, words in _WORDS.items():
            pieces = [cut for cut in self.cuts if cut.why == why]
            if pieces:
                x, y = pieces[0].points[0] * 1e3
                count = "1 piece" if len(pieces) == 1 else f"{len(pieces)} pieces, the first"
                total = sum(length(cut.points) for cut in pieces) * 1e3
                parts.append(f"{total:.1f} mm {words} ({count} of path {pieces[0].name!r} at x {x:.1f}, y {y:.1f} mm)")
        return (
            *self.told,
            f"layers.source: {self.share:.2%} of the length left out, {'; '.join(parts)}",
        )

    def drawn_on(self, plane: Array, heights: Array) -> tuple[Array, ...]:
        """The cuts as lines (n, 3) to be drawn, as high as the nearest printed places, plane (m, 2) and heights (m)."""
        tree, lines = cKDTree(plane), []
        for cut in self.cuts:
            dense = densify(cut.points)
            some = np.vstack([dense[:-1:_DRAWN], dense[-1:]])
            lines.append(np.column_stack([some, heights[tree.query(some)[1]]]))
        return tuple(lines)

    def check(self, most: float) -> None:
        """Raise TooMuchCut where more than a share `most` of the length is left out, or all of it."""
        if self.cuts and (self.share > most or not self.paths):
            raise TooMuchCut(self)

    def refusal(self, problem: Problem, size_key: str, needed: float | None) -> Exception:
        """The InputError that names the main cause of loss, and the share to leave out instead, if there is one."""
        lost = {
            why: sum(length(cut.points) for cut in self.cuts if cut.why == why)
            for why in {cut.why for cut in self.cuts}
        }
        cut = next(cut for cut in self.cuts if cut.why == max(lost, key=lost.__getitem__))
        x, y = cut.points[0] * 1e3
        reason = {
            OFF: f"path {cut.name!r} leaves the part at x {x:.1f}, y {y:.1f} mm",
            STEEP: f"path {cut.name!r} comes to a wall of {STEEPEST:g} degrees or more at x {x:.1f}, y {y:.1f} mm",
            EDGE: f"path {cut.name!r} crosses an edge of the part at x {x:.1f}, y {y:.1f} mm",
            FOLDS: f"the part is bent inwards too tightly under path {cut.name!r} at x {x:.1f}, y {y:.1f} mm: layers would fold",
            SHORT: f"path {cut.name!r} is only {length(cut.points) * 1e3:.3f} mm long at this size",
        }[cut.why]
        field, hint = {
            SHORT: (
                size_key,
                f"at least as long as the bead is wide, {problem.process.bead.width * 1e3:g} mm, once its corners are rounded "
                "within process.corner_tolerance_mm",
            ),
            FOLDS: ("layers.count", "fewer or thinner layers, or layers.offset: z"),
        }.get(
            cut.why,
            (
                "layers.source",
                f"make it smaller or move it (layers.centre_mm); the part may lean by {STEEPEST:g} degrees",
            ),
        )
        if needed is not None:
            hint += f"; layers.source.leave_out_share: {share_words(needed)} leaves out what cannot be printed"
        return problem.error(field, reason, hint)


class TooMuchCut(ValueError):
    """More is cut from curves than may be left out; `rough` if that is due to edges of a mesh."""

    def __init__(self, clipped: Clipped, rough: TooRoughMesh | None = None) -> None:
        self.clipped, self.rough = clipped, rough
        super().__init__(f"{clipped.share:.1%} of the length cannot be printed")


def vanishes(drawn: Array, rounded: Array, width: float) -> bool:
    """Whether a short line (n, 2) is too short for a bead of a width [m] once its corners are rounded (m, 2)."""
    return length(drawn) < SHORTEST * width and length(rounded) < width


def share_words(share: float) -> str:
    """This share, rounded up, as written in a problem file."""
    return f"{min(np.ceil(share / _ROUNDED_UP + 0.01) * _ROUNDED_UP, 1.0):.3g}"


def off_or_steep(upward: Callable[[Array], Array]) -> Callable[[Array], Ints]:
    """Why places of a path cannot be printed, judged by the upward components of a surface's normals there."""

    def reasons(plane: Array) -> Ints:
        up = upward(plane)
        there = np.isfinite(up)
        weight = uniform_filter1d(there.astype(float), 2 * _AROUND + 1, mode="nearest")
        mean = uniform_filter1d(np.where(there, up, 0.0), 2 * _AROUND + 1, mode="nearest") / np.maximum(weight, _SAME)
        steep = np.maximum(up, mean) < np.cos(np.radians(STEEPEST))
        return np.where(~there, OFF, np.where(steep, STEEP, FITS))

    return reasons


def trim_path(path: PlanePath, dense: Array, keep: Flags) -> list[PlanePath]:
    """The pieces of a polyline where its dense points (n, 2) are kept (n); closed if all of a closed one are."""
    if keep.all():
        return [path]
    arc = arc_lengths(dense)
    return [
        PlanePath(path.name, _between(path.points, *ends), False)
        for ends in (_unrolled(arc, *run) for run in _runs(keep, path.closed))
        if ends[1] - ends[0] > _SAME
    ]


def trim_curve(curve: PlaneCurve, keep: Flags) -> list[PlaneCurve]:
    """The pieces of a rounded curve whose samples are kept (n), from sample to sample; at least two samples each."""
    if keep.all():
        return [curve]
    last = len(keep) - 1
    total = length(curve.source)
    pieces = []
    for first, end in _runs(keep, curve.closed):
        if end == first:
            continue
        index = np.arange(first, end + 1)
        index = np.where(index > last, index - last, index)  # past the seam of a closed curve
        source = _between(curve.source, first * total / last, end * total / last)
        pieces.append(replace(curve, points=curve.points[index], source=source, closed=False))
    return pieces


def _runs(keep: Flags, closed: bool) -> list[tuple[int, int]]:
    """First and last place of each run of kept places (n), if not all are; past n - 1 where it crosses the seam."""
    runs = [(first, end - 1) for first, end in true_runs(keep).tolist()]
    if closed and len(runs) > 1 and runs[0][0] == 0 and runs[-1][1] == len(keep) - 1:
        runs = [*runs[1:-1], (runs[-1][0], len(keep) - 1 + runs[0][1])]
    return runs


def _unrolled(arc: Array, first: int, end: int) -> tuple[float, float]:
    """Arc lengths of the places `first` and `end`, the latter past the seam if its number is beyond the last."""
    last = len(arc) - 1
    return float(arc[first]), float(arc[end]) if end <= last else float(arc[-1] + arc[end - last])


def _between(points: Array, low: float, high: float) -> Array:
    """A polyline (n, 2) from one arc length to another [m], which may lie one lap further on a closed one."""
    arc = arc_lengths(points)
    if high > arc[-1] + _SAME:
        points, arc = np.vstack([points, points[1:]]), np.concatenate([arc, arc[-1] + arc[1:]])
    inner = points[(arc > low + _SAME) & (arc < high - _SAME)]
    ends = np.column_stack([np.interp([low, high], arc, points[:, k]) for k in range(2)])
    return np.vstack([ends[:1], inner, ends[1:]])


def lost_pieces(curve: PlaneCurve, reasons: Ints) -> list[Cut]:
    """The pieces of a rounded curve that are cut for `reasons` (n) at its samples."""
    found = []
    for why in np.unique(reasons[reasons != FITS]).tolist():
        found += [Cut(curve.name, why, piece.points) for piece in trim_curve(curve, reasons == why)]
    return found


def creases(outline: Sequence[Array], normals: Callable[[Array], Array], crease: float) -> Array:
    """Places (k, 2) where paths, as dense points (n, 2), cross an edge between facets sharper than `crease` [rad]."""
    edges = [np.zeros((0, 2))]
    for dense in outline:
        n = normals(dense)
        sharp = np.flatnonzero((n[1:] * n[:-1]).sum(axis=1) < np.cos(crease))
        edges.append(0.5 * (dense[sharp] + dense[sharp + 1]))
    return np.vstack(edges)


def at_edges(places: Array, beside: float) -> Callable[[Array], Ints]:
    """Reasons to cut paths within `beside` [m] of places (k, 2)."""
    if len(places) == 0:
        return lambda points: np.zeros(len(points), dtype=np.int64)
    tree = cKDTree(places)
    return lambda points: np.where(tree.query(points)[0] <= beside, EDGE, FITS)
