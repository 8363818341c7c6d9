"""The robots of the scene: their bodies, the screws that move them, and their posture over time."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from planner.readonly import Array, Indices

if TYPE_CHECKING:
    from planner.cell import Cell
    from planner.plan import CellView, Trajectory


TOLERANCE = 0.5e-3  # m: how far off the tip may be between postures that the page has
MOST_POSTURES = 60_000
FIRST = 250  # samples between the first postures looked at
LOOKS = 7  # places within a stretch where the first looks are taken
BLOCK = 65_536  # postures at once
GROWTH = 2.0  # of the tolerance, where there would be too many postures


def cell_data(cell: Cell, view: CellView | None) -> dict[str, Any] | None:
    """Bodies where all joints are 0 (m, world), the joints' screws, and the two end frames there; None without bodies.

    A pose is the product of exponentials of the screws that move it, in the order given, times its frame at 0.
    """
    if view is None:
        return None
    bodies = [
        {
            "name": name,
            "kind": kind,
            "joints": joints.tolist(),
            "points": vertices.astype(np.float32).ravel(),
            "corners": triangles.astype(np.uint16 if len(vertices) <= np.iinfo(np.uint16).max else np.uint32).ravel(),
        }
        for name, kind, joints, vertices, triangles in zip(
            view.names, view.kinds, view.joints, view.vertices, view.triangles, strict=True
        )
    ]
    na, nh = len(cell.arm), len(cell.holder)
    return {
        "bodies": bodies,
        "screws": np.concatenate([cell.arm.screws, cell.holder.screws]).ravel(),
        "arm": na,
        "joints": list(cell.joint_names),
        "nozzle": cell.arm.poses(np.zeros((1, na)))[0].ravel(),
        "part": cell.holder.poses(np.zeros((1, nh)))[0].ravel(),
    }


def postures(cell: Cell, trajectory: Trajectory) -> dict[str, Any]:
    """Postures at so many samples that between them, joints taken as moving evenly, the tip is no further off than told.

    `sample` (k), `q` (k, nj) row by row, and `off_mm`, the furthest that the tip is off at any sample.
    """
    tolerance = TOLERANCE
    kept, off = _kept(cell, trajectory, tolerance)
    while len(kept) > MOST_POSTURES:
        tolerance *= GROWTH
        kept, off = _kept(cell, trajectory, tolerance)
    return {
        "sample": kept.astype(np.int32),
        "q": trajectory.q[kept].astype(np.float32).ravel(),
        "off_mm": round(off * 1e3, 3),
    }


def _kept(cell: Cell, trajectory: Trajectory, tolerance: float) -> tuple[Indices, float]:
    """Samples to keep, and how far off the tip is at most at all others [m]."""
    n = len(trajectory)
    done: list[Indices] = []
    knots = np.unique(np.append(np.arange(0, n, FIRST), n - 1))
    a, b = knots[:-1], knots[1:]
    while len(a):  # first only a few looks at each stretch
        shares = np.arange(1, LOOKS + 1) / (LOOKS + 1)
        between = a[:, None] + np.round(shares * (b - a)[:, None]).astype(np.intp)
        off = _off(cell, trajectory, between.ravel(), np.repeat(a, LOOKS), np.repeat(b, LOOKS))
        far = (off.reshape(-1, LOOKS).max(axis=1) > tolerance) & (b - a > 1)
        done.append(a[~far])
        middle = (a[far] + b[far]) // 2
        a, b = np.concatenate([a[far], middle]), np.concatenate([middle, b[far]])
    kept = np.sort(np.append(np.concatenate(done) if done else np.empty(0, dtype=np.intp), n - 1))
    worst, open_ = 0.0, np.ones(len(kept) - 1, dtype=bool)
    while open_.any():  # then every sample of the stretches that were not looked at whole
        stretch = np.searchsorted(kept, np.arange(n), side="right") - 1
        looked = np.flatnonzero(open_[np.minimum(stretch, len(open_) - 1)] & (stretch < len(open_)))
        k = stretch[looked]
        off = _off(cell, trajectory, looked, kept[k], kept[k + 1])
        bad = off > tolerance
        settled = ~np.isin(k, k[bad])  # what is halved is looked at again
        worst = max(worst, float(off[settled].max(initial=0.0)))
        middles = np.unique((kept[k[bad]] + kept[k[bad] + 1]) // 2)
        halved = np.union1d(kept, middles)
        fresh = np.isin(halved[:-1], middles) | np.isin(halved[1:], middles)
        kept, open_ = halved, fresh
    return np.unique(kept), worst


def _off(cell: Cell, trajectory: Trajectory, at: Indices, a: Indices, b: Indices) -> Array:
    """How far the tip is off at samples `at` if joints move evenly from samples a to b [m]."""
    out = np.empty(len(at))
    for start in range(0, len(at), BLOCK):
        rows = slice(start, start + BLOCK)
        first, last = trajectory.q[a[rows]], trajectory.q[b[rows]]
        share = ((at[rows] - a[rows]) / np.maximum(b[rows] - a[rows], 1))[:, None]
        tip = cell.T_part_nozzle(first + share * (last - first))[:, :3, 3]
        out[rows] = np.linalg.norm(tip - trajectory.tip[at[rows]], axis=1)
    return out
