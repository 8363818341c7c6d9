"""Data of the scene: cell, part and beads in metres, the motion, and the places to go to."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from planner.base.arrays import Array, Indices
from planner.plan.plan import by_nozzle
from planner.report.channels import channels
from planner.report.page import coarse
from planner.report.places import ReportPlace, dip_marks, places_data
from planner.report.thinning import SCENE_BUDGET, keep_minima, stretches, turning

if TYPE_CHECKING:
    from planner.cell.cell import Cell
    from planner.plan import CellView, Plan, Trajectory
    from planner.toolpath.bead import Bead, Shape

# ----------------------------------------------------------------------------------------------------
# The part's surface.

SUNK = 0.15e-3  # m: the part is drawn this much smaller, so that the first layer does not look half sunk into it,
SUNK_SHARE = 0.5  # but by no more than this share of the least bead height


def part_data(shape: Shape | None, beads: Sequence[Bead]) -> dict[str, Any] | None:
    """Points and normals (part frame, m) and triangles of the part's surface, flattened; None without a shape."""
    if shape is None:
        return None
    points = shape.vertices - min(SUNK, SUNK_SHARE * _least(beads, "height")) * shape.normals
    return {
        "points": points.astype(np.float32).ravel(),
        "normals": shape.normals.astype(np.float32).ravel(),
        "corners": _corners(shape.triangles, len(points)),
    }


def _least(beads: Sequence[Bead], measure: str) -> float:
    """The least width or height of beads [m]; infinite if unknown."""
    known = (getattr(bead, measure, ()) for bead in beads)
    return min((float(np.min(each)) for each in known if len(each)), default=math.inf)


# ----------------------------------------------------------------------------------------------------
# Lines of beads: points and normals in the part frame, thinned, with what they can be coloured by.

EVEN = 127  # steps of a component of a unit vector


def plan_lines(plan: Plan) -> dict[str, Any]:
    """Deposited lines by time: `point`, `normal`, `sample`, `along` of points; `first`, `bead`, `layer` of lines."""
    traj = plan.trajectory
    kept, starts = _kept_samples(plan)
    first = np.flatnonzero(starts)
    return {
        **_geometry(traj.tip[kept], -traj.axis[kept], first),
        **_sections(plan.toolpath.beads, traj.bead[kept], traj.s[kept]),
        "sample": kept.astype(np.int32),
        "along": coarse(traj.s[kept] * 1e3),
        "bead": traj.bead[kept[first]].astype(np.int32),
        "layer": traj.layer[kept[first]].astype(np.int32),
        "channels": channels(plan, kept),
    }


def bead_lines(beads: Sequence[Bead], budget: int) -> dict[str, Any]:
    """Beads as planned, without their motion: `point`, `normal` and `first`."""
    points = np.concatenate([bead.points for bead in beads] or [np.zeros((0, 3))])
    normals = np.concatenate([bead.normals for bead in beads] or [np.zeros((0, 3))])
    last = np.cumsum([len(bead.points) for bead in beads], dtype=np.intp) - 1
    first = last + 1 - np.array([len(bead.points) for bead in beads], dtype=np.intp)
    kept = np.arange(len(points))
    if len(points):
        sharp = turning(points, first, last)
        kept = keep_minima([-sharp, np.zeros(len(points))], budget, np.union1d(first, last))
    which = np.repeat(np.arange(len(beads)), last + 1 - first)[kept]
    along = np.concatenate([bead.s for bead in beads] or [np.zeros(0)])[kept]
    starts = np.flatnonzero(np.isin(kept, first))
    return _geometry(points[kept], normals[kept], starts) | _sections(beads, which, along)


def cut_lines(lines: Sequence[Array]) -> dict[str, Any]:
    """Lines (n, 3) that are not printed, in the part frame: `point`, `normal` and `first`."""
    points = np.concatenate(list(lines))
    first = np.concatenate([[0], np.cumsum([len(line) for line in lines])[:-1]]).astype(np.intp)
    section = {"wide": coarse(np.full(len(points), CUT_WIDTH)), "high": coarse(np.full(len(points), CUT_WIDTH))}
    return _geometry(points, np.tile([0.0, 0.0, 1.0], (len(points), 1)), first) | section


def _geometry(points: Array, normals: Array, first: NDArray[np.intp]) -> dict[str, Any]:
    return {
        "point": [coarse(points[:, k]) for k in range(3)],
        "normal": np.round(normals * EVEN).astype(np.int8).ravel(),
        "first": first.astype(np.int32),
    }


def _kept_samples(plan: Plan) -> tuple[NDArray[np.intp], NDArray[np.bool_]]:
    """Samples of deposition to draw, in order, and which of them start a new line."""
    traj = plan.trajectory
    index, begin, end = stretches(traj.deposit, traj.bead)
    if not len(index):
        return index, np.empty(0, dtype=bool)
    sharp = turning(traj.tip[index], begin, end)
    signals = [traj.speed[index], -sharp, np.zeros(len(index))]
    signals += [
        plan.series[name][index] for name in ("sigma", "limit_margin_deg", "clearance_mm") if name in plan.series
    ]
    kept = keep_minima(signals, SCENE_BUDGET, np.union1d(begin, end))
    starts = np.zeros(len(index), dtype=bool)
    starts[begin] = True
    return index[kept], starts[kept]


def _sections(beads: Sequence[Bead], bead: NDArray[np.integer[Any]], along: Array) -> dict[str, Any]:
    """`wide` and `high` [m] of points, given the index of their bead and the arc length along it [m]."""
    wide, high = np.full(len(bead), DEFAULT_WIDTH), np.full(len(bead), DEFAULT_HEIGHT)
    order = np.argsort(bead, kind="stable")
    for mine in np.split(order, np.flatnonzero(np.diff(bead[order])) + 1) if len(bead) else ():
        own = beads[bead[mine[0]]]
        if len(getattr(own, "width", ())):
            wide[mine] = np.interp(along[mine], own.s, own.width)
            high[mine] = np.interp(along[mine], own.s, own.height)
    return {"wide": coarse(wide), "high": coarse(high)}


# ----------------------------------------------------------------------------------------------------
# Robots: their bodies, the screws that move them, and their posture over time.

TOLERANCE = 0.5e-3  # m: error of the tip allowed between the page's postures, at most the narrowest bead's width
MOST_POSTURES = 60_000
FIRST = 250  # samples between the initial postures; more if these would be half of MOST_POSTURES
LOOKS = 7  # places within a stretch that are checked first
BLOCK = 65_536  # postures at once
MOST_COLOURS = 255  # of a body
GROWTH = 2.0  # × the tolerance, if there would be too many postures


def cell_data(cell: Cell, view: CellView | None) -> dict[str, Any] | None:
    """Bodies with all joints at 0 (m, world), the joints' screws, and the two end frames; None without bodies.

    A pose is the product of exponentials of the screws that move it, in the given order, times its frame at 0.
    """
    if view is None:
        return None
    bodies = [
        {
            "name": view.names[k],
            "kind": view.kinds[k],
            "bodies": list(view.bodies[k]),
            "joints": view.joints[k].tolist(),
            "point": [coarse(view.vertices[k][:, axis]) for axis in range(3)],
            "normals": np.round(view.normals[k] * EVEN).astype(np.int8).ravel(),
            "corners": _corners(view.triangles[k], len(view.vertices[k])),
            **_painted(view.colours[k]),
        }
        for k in range(len(view.names))
    ]
    na, nh = len(cell.arm), len(cell.holder)
    return {
        "bodies": bodies,
        "screws": np.concatenate([cell.arm.screws, cell.holder.screws]).ravel(),
        "slides": np.concatenate([cell.arm.slides, cell.holder.slides]).tolist(),
        "arm": na,
        "joints": list(cell.joint_names),
        "nozzle": cell.arm.poses(np.zeros((1, na)))[0].ravel(),
        "tools": [],
        "part": cell.holder.poses(np.zeros((1, nh)))[0].ravel(),
    }


def _corners(triangles: NDArray[np.int64], vertices: int) -> NDArray[Any]:
    return triangles.astype(np.uint16 if vertices <= np.iinfo(np.uint16).max else np.uint32).ravel()


def _painted(colours: NDArray[np.uint8]) -> dict[str, Any]:
    """The colours of vertices (n, 3) as a `palette` of hex colours, and `paint` (n), each vertex's index in it."""
    palette, paint = np.unique(colours, axis=0, return_inverse=True)
    if len(palette) > MOST_COLOURS:
        palette, paint = colours.mean(axis=0, keepdims=True).round().astype(np.uint8), np.zeros(len(colours), dtype=int)
    return {"palette": ["#" + bytes(each).hex() for each in palette], "paint": paint.ravel().astype(np.uint8)}


def tools(plan: Plan) -> list[dict[str, Any]]:
    """With several nozzles, when [s] each comes into use, its frame with all joints at 0, and absent bodies."""
    cell, t = plan.cell, plan.trajectory
    if not cell.nozzles:
        return []
    heads = [{body.name for body in nozzle.head} for nozzle in cell.nozzles]
    rest = np.zeros((1, len(cell.arm)))
    return [
        {
            "since": float(t.t[rows.start]),
            "frame": own.arm.poses(rest)[0].ravel(),
            "absent": sorted(set().union(*heads) - heads[own.in_use]),
        }
        for own, rows in by_nozzle(cell, t.events, t.t)
    ]


def postures(cell: Cell, trajectory: Trajectory, tolerance: float = TOLERANCE) -> dict[str, Any]:
    """Postures at enough samples that with linearly interpolated joints the tip is off by no more than the tolerance.

    `sample` (k), `q` (k, nj) row by row, and `off_mm`, the greatest error of the tip at any sample.
    """
    parts = [(own, rows.start, trajectory.part(rows)) for own, rows in by_nozzle(cell, trajectory.events, trajectory.t)]
    apart = max(FIRST, math.ceil(2 * len(trajectory) / MOST_POSTURES))

    def within(tolerance: float) -> tuple[Indices, float]:
        found = [(first, *_kept(own, part, tolerance, apart)) for own, first, part in parts]
        return np.concatenate([first + kept for first, kept, _ in found]), max(off for _, _, off in found)

    kept, off = within(tolerance)
    while len(kept) > MOST_POSTURES:
        tolerance *= GROWTH
        kept, off = within(tolerance)
    return {
        "sample": kept.astype(np.int32),
        "q": trajectory.q[kept].astype(np.float32).ravel(),
        "off_mm": round(off * 1e3, 3),
    }


def _kept(cell: Cell, trajectory: Trajectory, tolerance: float, apart: int) -> tuple[Indices, float]:
    """Samples to keep, at least one in every `apart`, and the tip's greatest error at the others [m]."""
    n = len(trajectory)
    done: list[Indices] = []
    knots = np.unique(np.append(np.arange(0, n, apart), n - 1))
    a, b = knots[:-1], knots[1:]
    while len(a):  # first check each stretch at a few places only
        shares = np.arange(1, LOOKS + 1) / (LOOKS + 1)
        between = a[:, None] + np.round(shares * (b - a)[:, None]).astype(np.intp)
        off = _off(cell, trajectory, between.ravel(), np.repeat(a, LOOKS), np.repeat(b, LOOKS))
        far = (off.reshape(-1, LOOKS).max(axis=1) > tolerance) & (b - a > 1)
        done.append(a[~far])
        middle = (a[far] + b[far]) // 2
        a, b = np.concatenate([a[far], middle]), np.concatenate([middle, b[far]])
    kept = np.sort(np.append(np.concatenate(done) if done else np.empty(0, dtype=np.intp), n - 1))
    worst, open_ = 0.0, np.ones(len(kept) - 1, dtype=bool)
    while open_.any():  # then check every sample of the stretches that are not settled
        stretch = np.searchsorted(kept, np.arange(n), side="right") - 1
        between = ~np.isin(np.arange(n), kept)  # kept postures are exact, whatever tip is recorded
        looked = np.flatnonzero(open_[np.minimum(stretch, len(open_) - 1)] & between)
        k = stretch[looked]
        off = _off(cell, trajectory, looked, kept[k], kept[k + 1])
        bad = off > tolerance
        settled = ~np.isin(k, k[bad])  # halved stretches are checked again
        worst = max(worst, float(off[settled].max(initial=0.0)))
        middles = np.unique((kept[k[bad]] + kept[k[bad] + 1]) // 2)
        halved = np.union1d(kept, middles)
        fresh = np.isin(halved[:-1], middles) | np.isin(halved[1:], middles)
        kept, open_ = halved, fresh
    return np.unique(kept), worst


def _off(cell: Cell, trajectory: Trajectory, at: Indices, a: Indices, b: Indices) -> Array:
    """Error of the tip [m] at samples `at` if joints are interpolated linearly between samples a and b."""
    out = np.empty(len(at))
    for start in range(0, len(at), BLOCK):
        rows = slice(start, start + BLOCK)
        first, last = trajectory.q[a[rows]], trajectory.q[b[rows]]
        share = ((at[rows] - a[rows]) / np.maximum(b[rows] - a[rows], 1))[:, None]
        tip = cell.T_part_nozzle(first + share * (last - first))[:, :3, 3]
        out[rows] = np.linalg.norm(tip - trajectory.tip[at[rows]], axis=1)
    return out


# ----------------------------------------------------------------------------------------------------
# The whole scene, of a plan or of a refusal.

EARLIER_BUDGET = 10_000  # points of beads that are there before the motion
# From tight to ordinary; distinguishable by all eyes, and none as pale as the part.
COLOURS: list[tuple[float, str]] = [
    (0.0, "#c0272d"),
    (0.2, "#ea7a33"),
    (0.4, "#f0bd45"),
    (0.6, "#86b79a"),
    (0.8, "#4c97ba"),
    (1.0, "#2d5c9e"),
]
PAPER = "#ffffff"
INK = "#1b2733"
ALARM = "#d1495b"
PLANNED = "#40566e"
EARLIER = "#b9c4cf"  # beads shown without motion: they were there before
DEFAULT_WIDTH, DEFAULT_HEIGHT = 0.6e-3, 0.4e-3  # m: of a bead of unknown section
CUT_WIDTH = 0.4e-3  # m: of lines that are not printed


def plan_scene(plan: Plan, places: Sequence[ReportPlace]) -> dict[str, Any]:
    """Scene of a plan: `cell`, `part`, `motion`, `lines`, `earlier`, `places`, `dips`, `colours`, times in seconds."""
    traj = plan.trajectory
    cell = cell_data(plan.cell, plan.view)
    if cell is not None:
        cell |= {"tools": tools(plan)}
    look = {"round": _round(plan.beads)}
    earlier = plan.toolpath.beads[: plan.first_bead]
    still = [bead_lines(earlier, EARLIER_BUDGET) | look | {"colour": EARLIER}] if earlier else []
    if plan.toolpath.left_out:
        still.append(cut_lines(plan.toolpath.left_out) | {"round": True, "colour": ALARM})
    facing = -traj.axis[traj.deposit].mean(axis=0) if traj.deposit.any() else np.zeros(3)
    near = min(TOLERANCE, _least(plan.toolpath.beads, "width"))
    return {
        "cell": cell,
        "part": part_data(plan.toolpath.shape, plan.toolpath.beads),
        "motion": None if cell is None else postures(plan.cell, traj, near),
        "dt": traj.dt,
        "end": float(traj.t[-1]),
        "facing": facing.round(4).tolist(),
        "lines": plan_lines(plan) | look,
        "still": still,
        "places": places_data(plan, places),
        "dips": dip_marks(plan),
        "events": [[float(e.start), float(e.duration), e.words] for e in traj.events if e.duration > 0.0],
        "colours": COLOURS,
        "home": None,
    }


def failed_scene(
    shape: Shape | None,
    beads: Sequence[Bead],
    failed: int | None,
    places: list[dict[str, Any]],
    cell: Cell | None,
    view: CellView | None,
    posture: Sequence[float] | None = None,
) -> dict[str, Any]:
    """Scene without a trajectory: beads as planned, the failed one in red, robots in a posture or at their start."""
    look = {"round": _round(beads)}
    others = [bead for k, bead in enumerate(beads) if k != failed]
    still = [bead_lines(others, SCENE_BUDGET) | look | {"colour": PLANNED}]
    if failed is not None:
        still.append(bead_lines([beads[failed]], SCENE_BUDGET) | look | {"thick": 2.0, "colour": ALARM})
    shown = beads if failed is None else [beads[failed]]
    facing = np.mean([np.mean(bead.normals, axis=0) for bead in shown], axis=0) if shown else np.zeros(3)
    return {
        "cell": None if cell is None else cell_data(cell, view),
        "part": part_data(shape, beads),
        "motion": None,
        "dt": 0.0,
        "end": 0.0,
        "facing": facing.round(4).tolist(),
        "lines": None,
        "still": still,
        "places": places,
        "dips": None,
        "events": [],
        "colours": COLOURS,
        "home": None if cell is None else cell.home.tolist() if posture is None else [*posture],
    }


def _round(beads: Sequence[Bead]) -> bool:
    """Whether any of the beads are struts in space."""
    return any(bead.round for bead in beads)
