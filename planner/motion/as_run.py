"""The motion a program commands so that the robot executes the plan: the planned one, corrected as learnt from runs.

A robot cuts corners and lags behind. To execute the plan, it has to be commanded a slightly different path. The
displacement is given at places along each bead and interpolated linearly between them; beyond a bead's ends it fades
out.
"""

from __future__ import annotations

import csv
import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from planner.base.arrays import Array, Flags, Indices, Ints, ReadOnlyArrays, true_runs
from planner.base.errors import Complaint
from planner.base.files import read_text
from planner.base.geometry import arc_lengths
from planner.cell.cell import Cell
from planner.plan.plan import by_nozzle
from planner.plan.trajectory import Trajectory
from planner.problem import Problem
from planner.toolpath.bead import Toolpath

COLUMNS = ("bead", "s_mm", "dx_mm", "dy_mm", "dz_mm")  # that the file must have; any others are for people
PLACES = ("x_mm", "y_mm", "z_mm")  # optional: the places in the part frame, which reveal changed beads
ASTRAY = 0.5e-3  # m: how far such a place may lie off its bead
LARGEST_FILE = 300_000_000  # bytes: some six million places, or a day of printing
LARGEST = 1e9  # a number in it: beads, and mm
FADE = 5e-3  # m of path over which a displacement fades out before and after a bead; at most half the travel
BEYOND = 1e-4  # m: how far a place may lie beyond its bead's end
ROUNDING = 1e-6  # relative, of numbers in the file
_WRITTEN = "beadwise learn writes them"
BLOCK = 20_000  # samples whose postures are solved at once: bounds the memory


@dataclass(frozen=True)
class Corrections(ReadOnlyArrays):
    """Displacements of the tip at k places, ordered by bead and along it.

    bead (k) index of the bead;  s (k) arc length along it [m];  shift (k, 3) of the tip in the part frame [m]
    """

    bead: Ints
    s: Array
    shift: Array

    @property
    def most(self) -> float:
        """The greatest displacement [m]."""
        return float(np.linalg.norm(self.shift, axis=1).max(initial=0.0))


def read_columns(
    path: Path, names: Sequence[str], complain: Complaint, further: Sequence[str] = ()
) -> tuple[list[int], Array]:
    """Columns of a corrections file: line numbers of the rows (k) and their values (k, c).

    The `further` columns follow the named ones if all of them are present. Raises InputError, made by `complain`, if
    the file holds no such table.
    """
    lines = read_text(path, LARGEST_FILE, complain)
    try:
        rows = [(i, row) for i, row in enumerate(csv.reader(lines), 1) if row and not row[0].startswith("#")]
    except csv.Error as error:
        raise complain(f"{path.name} is not CSV: {error}", hint=_WRITTEN) from None
    header = [name.strip() for name in rows[0][1]] if rows else []
    missing = [name for name in names if name not in header]
    if missing:
        raise complain(f"{path.name} holds no corrections: no column {missing[0]}", hint=_WRITTEN)
    names = (*names, *(further if set(further) <= set(header) else ()))
    at = [header.index(name) for name in names]
    try:
        table = np.array([[row[i] for i in at] for _, row in rows[1:]], dtype=np.float64).reshape(-1, len(names))
    except (ValueError, IndexError):
        line = next(line for line, row in rows[1:] if not _are_numbers(row, at))
        raise complain(f"{path.name}, line {line}: not {len(names)} numbers", hint=_WRITTEN) from None
    numbered = [line for line, _ in rows[1:]]
    wrong = np.asarray(~(np.abs(table) < LARGEST).all(axis=1))
    _wrong(path, complain, numbered, wrong, "a number is not finite, or far too large")
    return numbered, table


def read_corrections(path: Path, toolpath: Toolpath, complain: Complaint) -> Corrections:
    """The corrections in a file. Raises InputError, made by `complain`, if they do not belong to this toolpath."""
    numbered, table = read_columns(path, COLUMNS, complain, PLACES)
    wrong = partial(_wrong, path, complain, numbered)
    bead = table[:, 0].astype(np.int64)
    beads = toolpath.beads
    wrong((bead != table[:, 0]) | (bead < 0) | (bead >= len(beads)), f"no such bead: there are {len(beads)}")
    length = np.array([each.length for each in beads])
    s = table[:, 1] * 1e-3
    wrong(
        (s < 0.0) | (s > length[bead] + BEYOND), "beyond the end of its bead: these corrections belong to another print"
    )
    back = np.append(False, (np.diff(bead) < 0) | ((np.diff(bead) == 0) & (np.diff(s) <= 0.0)))
    wrong(back, "not after the previous place")
    shift, written = table[:, 2:5] * 1e-3, table[:, 5:] * 1e-3
    if written.shape[1]:
        off = np.linalg.norm(written - places_along(toolpath, bead, s), axis=1)
        wrong(off > ASTRAY, "off its bead: these corrections belong to another print, or to beads in another order")
    return Corrections(bead, s, shift)


def places_along(toolpath: Toolpath, bead: Ints, s: Array) -> Array:
    """Places (k, 3) in the part frame [m] at arc lengths s (k) along beads (k), which are in order."""
    out = np.empty((len(s), 3))
    for a, b in itertools.pairwise([*np.flatnonzero(np.diff(bead, prepend=-1)).tolist(), len(s)]):
        own = toolpath.beads[bead[a]]
        for axis in range(3):
            out[a:b, axis] = np.interp(s[a:b], own.s, own.points[:, axis])
    return out


def _are_numbers(row: list[str], at: list[int]) -> bool:
    try:
        return bool([float(row[i]) for i in at])
    except (ValueError, IndexError):
        return False


def _wrong(path: Path, complain: Complaint, lines: list[int], bad: Flags, reason: str) -> None:
    if bad.any():
        raise complain(f"{path.name}, line {lines[int(np.argmax(bad))]}: {reason}", hint=_WRITTEN)


def displacements(corrections: Corrections, trajectory: Trajectory) -> Array:
    """Displacement of the tip at each sample (n, 3) [m], part frame."""
    t = trajectory
    out = np.zeros((len(t), 3))
    edges = true_runs(t.deposit)
    begin = np.searchsorted(corrections.bead, t.bead[edges[:, 0]], side="left")
    end = np.searchsorted(corrections.bead, t.bead[edges[:, 0]], side="right")
    for (first, last), a, b in zip(edges.tolist(), begin.tolist(), end.tolist(), strict=True):
        if a < b:
            for axis in range(3):
                out[first:last, axis] = np.interp(t.s[first:last], corrections.s[a:b], corrections.shift[a:b, axis])
    _fade(out, t, edges)
    return out


def _fade(out: Array, t: Trajectory, edges: Indices) -> None:
    """Fade displacements (n, 3) out smoothly along the path beyond the ends of deposition (k, 2), without overlap."""
    way = arc_lengths(t.tip)
    first, last = edges[:, 0], edges[:, 1] - 1
    begins, ends = np.append(first, len(t) - 1), np.append(0, last)  # of each stretch of travel
    for k, (a, b) in enumerate(zip(ends.tolist(), begins.tolist(), strict=True)):
        reach = min(FADE, 0.5 * (way[b] - way[a]))
        if reach <= 0.0:
            continue
        rows = np.arange(a + (k > 0), b + (k == len(first)))
        for at, there in ((a, k > 0), (b, k < len(first))):
            if there:
                share = np.clip(1.0 - np.abs(way[rows] - way[at]) / reach, 0.0, 1.0)
                out[rows] += (share**3 * (10.0 - 15.0 * share + 6.0 * share**2))[:, None] * out[at]


def asked_trajectory(cell: Cell, trajectory: Trajectory, corrections: Corrections) -> Trajectory:
    """The motion that a program commands: at each sample the same pose with the tip displaced, on the same branch.

    Raises ValueError if a displaced nozzle is out of reach.
    """
    t = trajectory
    shift = displacements(corrections, t)
    moved = np.flatnonzero((shift != 0.0).any(axis=1))
    q, tip = t.q.copy(), t.tip + shift
    for own, rows in _blocks(cell, t, moved):
        T_part_nozzle = np.tile(np.eye(4), (len(rows), 1, 1))
        T_part_nozzle[:, :3, :3] = Rotation.from_quat(t.quat[rows]).as_matrix()
        T_part_nozzle[:, :3, 3] = tip[rows]
        q[rows], exist = own.postures(T_part_nozzle, t.q[rows], t.branch[rows].astype(np.intp))
        if not exist.all():
            raise ValueError("a displaced nozzle is out of reach")
    return replace(t, q=q, tip=tip)


def _blocks(cell: Cell, t: Trajectory, moved: Indices) -> Iterator[tuple[Cell, Indices]]:
    """The displaced samples, in blocks, each with the cell as it is with their nozzle in use."""
    for own, stretch in by_nozzle(cell, t.events, t.t):
        rows = moved[(moved >= stretch.start) & (moved < stretch.stop)]
        yield from ((own, block) for block in np.array_split(rows, 1 + len(rows) // BLOCK))


def corrections_of(problem: Problem, toolpath: Toolpath) -> Corrections | None:
    """The corrections that a problem names; None if it names none. Raises InputError."""
    spec = problem.as_run
    if spec is None:
        return None
    corrections = read_corrections(spec.corrections, toolpath, partial(problem.error, "as_run.corrections"))
    if corrections.most > spec.most * (1.0 + ROUNDING):
        reason = f"{spec.corrections.name} displaces by {corrections.most * 1e3:.4g} mm, more than the {spec.most * 1e3:g} allowed"
        raise problem.error("as_run.most_mm", reason, f"at least {corrections.most * 1e3:.4g}")
    return corrections


def asked_of(problem: Problem, cell: Cell, toolpath: Toolpath, trajectory: Trajectory) -> Trajectory | None:
    """The motion that a problem's program is to command; None if it is the plan itself. Raises InputError."""
    corrections = corrections_of(problem, toolpath)
    if corrections is None:
        return None
    try:
        return asked_trajectory(cell, trajectory, corrections)
    except ValueError as error:
        raise problem.error("as_run.corrections", str(error)) from None
