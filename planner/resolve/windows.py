"""A long bead in windows of control values that overlap: each second one first, then those between them."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from threading import Lock

from planner.readonly import Array
from planner.resolve.splines import Basis, Clock
from planner.resolve.stretch import State
from planner.task import NozzleTask

WINDOW = 240  # control values that move at once: fewer, and their seams cost more; more, and cores wait for each other
OVERLAP = 40  # of a window with each neighbour


@dataclass(frozen=True)
class Track:
    """A path as splines: its task, clock and basis, control values c (k, m), where they
    were given (anchor), joints q (n, nj), and price [s]."""

    task: NozzleTask
    branch: int
    clock: Clock
    basis: Basis
    c: Array
    q: Array
    anchor: Array
    price: float


@dataclass(frozen=True)
class Piece:
    """A refined window: the state over some samples and control values of a track."""

    samples: slice
    controls: slice
    state: State


def windows(controls: int) -> list[tuple[int, int]]:
    """Ranges of control values that move together; each second one is apart from the others."""
    if controls <= WINDOW + OVERLAP:
        return [(0, controls)]
    stride = WINDOW - OVERLAP
    count = -(-(controls - OVERLAP) // stride)
    return [(k * stride, min(k * stride + WINDOW, controls)) for k in range(count)]


class Windowed:
    """A track whose windows are refined by several threads: which may begin, and what each begins with.

    A window that lies between two others waits for these alone, so what comes out does not depend on the threads.
    """

    def __init__(self, track: Track) -> None:
        self._track = track
        self.edges = windows(track.basis.controls)
        self._pieces: dict[int, Piece | None] = {}
        self._lock = Lock()

    @property
    def first(self) -> range:
        """Numbers of the windows that may begin at once."""
        return range(0, len(self.edges), 2)

    def before(self, k: int) -> Track:
        """The track that window k is refined on."""
        return self._with(() if k % 2 == 0 else (k - 1, k + 1))

    def done(self, k: int, piece: Piece | None) -> tuple[list[int], bool]:
        """Take a refined window, or None where there is nothing to refine; windows that may begin now, and whether this
        was the last one."""
        n = len(self.edges)
        with self._lock:
            self._pieces[k] = piece
            between = [j for j in (k - 1, k + 1) if j % 2 and 0 < j < n]
            ready = [j for j in between if j - 1 in self._pieces and (j + 1 in self._pieces or j + 1 == n)]
            return ready, len(self._pieces) == n

    def after(self) -> Track:
        """The track with all windows in their places."""
        return self._with((*self.first, *range(1, len(self.edges), 2)))

    def _with(self, numbers: Iterable[int]) -> Track:
        c, q = self._track.c.copy(), self._track.q.copy()
        for piece in filter(None, (self._pieces.get(k) for k in numbers)):
            c[piece.controls], q[piece.samples] = piece.state.c, piece.state.q
        return replace(self._track, c=c, q=q)
