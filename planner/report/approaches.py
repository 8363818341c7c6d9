"""Where bodies come nearest to each other: a table, and the cell as it stands then, in the world frame (millimetres)."""

from __future__ import annotations

from html import escape
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from planner.report.part import earlier_beads
from planner.report.scene import INK, PAPER
from planner.report.thinning import keep_minima, stretches, turning
from planner.report.wording import number

if TYPE_CHECKING:
    from planner.plan import CellView, Plan

Array = NDArray[np.float64]

COLOURS = {"arm": "#a9b8c6", "head": "#6b7f93", "holder": "#cbb994", "carried": "#b9a67c", "fixture": "#d9dde1"}
PART, PRINT = "#e4e0d4", "#40566e"
MARKED = ("#d55e00", "#0072b2")  # the two bodies of a pair: told apart by all eyes
CLOSE_MM = 150.0  # to each side of the tip, in the close view
BEAD_POINTS = 6_000  # of all beads together


def approaches_section(plan: Plan) -> str:
    """Table of the pairs that come nearest, and the picture of the cell; nothing where no bodies come near."""
    if not plan.approaches or plan.view is None:
        return ""
    t = plan.trajectory
    rows, options = [], []
    for each in plan.approaches:
        bead = int(t.bead[each.sample])
        where = f"bead {bead}, {t.s[each.sample] * 1e3:.1f} mm along it" if bead >= 0 else "travel"
        bad = each.distance < each.need
        pair = f"{escape(each.a)} – {escape(each.b)}"
        rows.append(
            f"<tr{' class=bad' if bad else ''}><th scope=row>{pair}</th><td class=n>{number(each.distance * 1e3, 1)}</td>"
            f"<td class=n>{number(each.need * 1e3, 1)}</td><td class=n>{t.t[each.sample]:.2f}</td>"
            f"<td class=where>{where}</td></tr>"
        )
        options.append(f"<option>{pair}, {number(each.distance * 1e3, 1)} mm</option>")
    return (
        "<h2>What comes near</h2><p class=note>Pairs of bodies that come nearest to each other anywhere in the motion, "
        "those with the least to spare first. The picture shows the cell at that moment, the pair in orange and blue. "
        "Bodies are the simple ones that the checks use.</p>"
        "<div class=controls><label>Show <select id=approach autocomplete=off>"
        f"{''.join(options)}</select></label><label><input type=checkbox id=near autocomplete=off> close to the nozzle's tip"
        "</label></div><div id=cell class=view></div>"
        "<div class=wide><table><thead><tr><th class=left>pair</th><th>distance, mm</th><th>to be kept, mm</th>"
        f"<th>time, s</th><th class=left>where</th></tr></thead><tbody>{''.join(rows)}</tbody></table></div>"
    )


def cell_figure(plan: Plan) -> dict[str, Any] | None:
    """What the page draws the cell from: bodies in their carriers' frames, and the carriers' poses at each approach."""
    view = plan.view
    if view is None or not plan.approaches:
        return None
    part_carrier = view.poses.shape[1]
    bodies = [
        _body(name, COLOURS[kind], int(carrier), vertices, triangles)
        for name, kind, carrier, vertices, triangles in zip(
            view.names, view.kinds, view.carrier, view.vertices, view.triangles, strict=True
        )
    ]
    shape = plan.toolpath.shape
    if shape is not None:
        bodies.append(_body("part", PART, part_carrier, shape.vertices, shape.triangles))
    bodies.append({"name": "print", "colour": PRINT, "carrier": part_carrier, "points": _flat(_beads(plan))})
    poses = np.concatenate([view.poses, view.T_world_part[:, None]], axis=1).copy()
    poses[..., :3, 3] *= 1e3
    tips = [
        (T[:3, :3] @ plan.trajectory.tip[each.sample] + T[:3, 3]) * 1e3
        for each, T in zip(plan.approaches, view.T_world_part, strict=True)
    ]
    low, high = _extent(view, np.array(tips))
    aspect = 2.1 * (high - low) / np.linalg.norm(high - low)
    return {
        "bodies": bodies,
        "poses": [pose.astype(np.float32).ravel() for pose in poses],
        "pairs": [[_drawn(each.a), _drawn(each.b)] for each in plan.approaches],
        "tips": np.round(tips, 2).tolist(),
        "marked": list(MARKED),
        "close": CLOSE_MM,
        "ranges": np.column_stack([low, high]).round(1).tolist(),
        "aspect": aspect.round(4).tolist(),
        "layout": _layout(low, high, aspect),
    }


def _drawn(name: str) -> str:
    """The body that a name is drawn as: all beads are one line."""
    return "print" if name.startswith("bead ") else name


def _body(name: str, colour: str, carrier: int, vertices: Array, triangles: NDArray[np.int64]) -> dict[str, Any]:
    corners = triangles.astype(np.uint16 if len(vertices) <= np.iinfo(np.uint16).max else np.uint32)
    return {
        "name": name,
        "colour": colour,
        "carrier": carrier,
        "points": _flat(vertices),
        "corners": [corners[:, k].copy() for k in range(3)],
    }


def _flat(points: Array) -> NDArray[np.float32]:
    return (points * 1e3).astype(np.float32).ravel()


def _beads(plan: Plan) -> Array:
    """Points (n, 3) of all beads in the part frame, thinned; NaN between beads."""
    t = plan.trajectory
    earlier = earlier_beads(plan.toolpath.beads[: plan.first_bead], BEAD_POINTS)
    index, begin, end = stretches(t.deposit, t.bead)
    if not len(index):
        return earlier
    sharp = turning(t.tip[index], begin, end)
    kept = keep_minima([-sharp, np.zeros(len(index))], BEAD_POINTS, np.union1d(begin, end))
    starts = np.flatnonzero(np.isin(kept, begin))[1:]
    own = np.insert(t.tip[index[kept]], starts, np.nan, axis=0)
    return np.concatenate([earlier, np.full((1, 3), np.nan), own]) if len(earlier) else own


def _extent(view: CellView, tips: Array) -> tuple[Array, Array]:
    """Corners (3), (3) of the box around all robots, at all approaches [mm]; fixtures may reach beyond it."""
    points = [tips]
    for kind, carrier, vertices in zip(view.kinds, view.carrier, view.vertices, strict=True):
        if kind != "fixture":
            T = view.poses[:, carrier]
            box = np.array([vertices.min(axis=0), vertices.max(axis=0), vertices.mean(axis=0)])
            points.append(1e3 * (np.einsum("kij,nj->kni", T[:, :3, :3], box) + T[:, None, :3, 3]).reshape(-1, 3))
    every = np.concatenate(points)
    pad = 0.05 * float(np.ptp(every, axis=0).max())
    return every.min(axis=0) - pad, every.max(axis=0) + pad


def _layout(low: Array, high: Array, aspect: Array) -> dict[str, Any]:
    axes = {
        f"{name}axis": {
            "title": {"text": f"{name} mm"},
            "range": [float(low[k]), float(high[k])],
            "showbackground": False,
            "gridcolor": "#d5dce4",
            "zeroline": False,
            "showspikes": False,
            "tickfont": {"size": 10},
        }
        for k, name in enumerate("xyz")
    }
    return {
        "scene": {
            **axes,
            "aspectmode": "manual",
            "aspectratio": dict(zip("xyz", map(float, aspect), strict=True)),
            "camera": {"eye": {"x": 0.9, "y": -1.5, "z": 0.7}, "projection": {"type": "orthographic"}},
            "dragmode": "orbit",
        },
        "margin": {"l": 0, "r": 0, "t": 0, "b": 0},
        "paper_bgcolor": PAPER,
        "font": {"family": "system-ui, sans-serif", "color": INK, "size": 12},
        "showlegend": False,
        "uirevision": "keep",
    }
