"""The map of a placement's score: a table of all places that were scored, and a picture of slices through them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import QuadMesh
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from planner.placement.freedom import ANGLES, FREEDOMS, Place
from planner.placement.study import Slice, Study

COLOURS = "cividis"  # the same to all eyes, and in grey
PRESENT, BEST = "#d55e00", "#ffffff"
_UNREACHABLE = "#d9d9d9"


def units(name: str) -> tuple[str, float]:
    """Unit of a coordinate in tables, and how many of it an SI unit is."""
    return ("deg", 180.0 / np.pi) if name in ANGLES else ("mm", 1e3)


def number(place: Place, name: str) -> str:
    """A coordinate in its unit, to the whole number; never -0."""
    return f"{round(getattr(place, name) * units(name)[1])}"


def words(place: Place, names: Sequence[str]) -> str:
    """A place in words: the coordinates that are searched."""
    return ", ".join(f"{name} {number(place, name)}" for name in names)


def write_table(study: Study, path: Path) -> None:
    """Write every place that was scored as CSV: what it was for, its coordinates, and its score (0: out of reach)."""
    rows = [("present", study.now, study.now_rating.score)]
    rows += [("best", place, rating.score) for place, rating in study.best]
    rows += [("resolved", place, score) for place, score in study.resolved]
    rows += [("lattice", place, score) for place, score in study.tried]
    names = [axis.name for axis in study.axes]
    for piece in study.slices:
        for i, j in np.ndindex(piece.scores.shape):
            values = dict(zip(names[:2], (float(piece.u[i]), float(piece.v[j])), strict=False))
            place = Place(**{name: values.get(name, getattr(piece.others, name)) for name in FREEDOMS})
            rows.append(("map", place, float(piece.scores[i, j])))
    head = ",".join(["kind", *(f"{name}_{units(name)[0]}" for name in FREEDOMS), "score"])
    lines = [
        ",".join([kind, *(f"{getattr(place, name) * units(name)[1]:.3f}" for name in FREEDOMS), f"{score:.5f}"])
        for kind, place, score in rows
    ]
    path.write_text("\n".join([head, *lines]) + "\n", encoding="utf-8")


def draw_map(study: Study, title: str, path: Path) -> None:
    """Draw the slices of a study side by side into a PNG, the present place and the best ones marked.

    What is out of reach is grey and hatched; a dashed line goes through scores of 1, from which on all is comfortable.
    """
    names = [axis.name for axis in study.axes]
    top = max(1e-3, *(float(piece.scores.max()) for piece in study.slices))
    norm = Normalize(0.0, top)
    n = len(study.slices)
    figure = Figure(figsize=(5.6 * n + 1.2, 5.4), dpi=130, facecolor="white", layout="constrained")
    panels = figure.subplots(1, n, squeeze=False)[0]
    for panel, piece in zip(panels, study.slices, strict=True):
        held = words(piece.others, names[2:])
        panel.set_title(f"{piece.title}{': ' + held if held else ''}", fontsize=10)
        panel.set_xlabel(f"{names[0]} [{units(names[0])[0]}]")
        if len(names) > 1:
            panel.set_ylabel(f"{names[1]} [{units(names[1])[0]}]")
            drawn = _field(panel, piece, names, norm)
        else:
            u = piece.u * units(names[0])[1]
            panel.plot(u, piece.scores[:, 0], color="#00224e")
            panel.fill_between(
                u, 0.0, top, where=piece.scores[:, 0] <= 0.0, color=_UNREACHABLE, hatch="///", step="mid"
            )
            panel.set_ylabel("score")
            drawn = None
        _mark(panel, study, names)
        panel.legend(loc="upper right", fontsize=8, facecolor="#8a8a8a", labelcolor="white", framealpha=0.9)
    if drawn is not None:
        figure.colorbar(drawn, ax=list(panels), label="score: least margin over the path (1: comfortable)")
    figure.suptitle(title)
    FigureCanvasAgg(figure).print_png(str(path), metadata={"Software": None})


def _field(panel: Axes, piece: Slice, names: Sequence[str], norm: Normalize) -> QuadMesh:
    u, v = piece.u * units(names[0])[1], piece.v * units(names[1])[1]
    scores = np.ma.masked_less_equal(piece.scores.T, 0.0)
    panel.set_facecolor(_UNREACHABLE)
    panel.patch.set(hatch="///", edgecolor="#9a9a9a")
    drawn = panel.pcolormesh(u, v, scores, cmap=COLOURS, norm=norm, shading="nearest")
    if piece.scores.max() > 1.0 and min(piece.scores.shape) > 1:
        panel.contour(u, v, piece.scores.T, levels=[1.0], colors="white", linestyles="dashed", linewidths=1.0)
    if names[0] not in ANGLES and names[1] not in ANGLES:
        panel.set_aspect("equal")
    return drawn


def _mark(panel: Axes, study: Study, names: Sequence[str]) -> None:
    def at(place: Place, score: float) -> tuple[float, float]:
        x = getattr(place, names[0]) * units(names[0])[1]
        return x, getattr(place, names[1]) * units(names[1])[1] if len(names) > 1 else score

    for i, (place, rating) in enumerate(study.best):
        x, y = at(place, rating.score)
        label = "best places" if i == 0 else None
        panel.plot(x, y, "*", color=BEST, markeredgecolor="black", markersize=14, label=label)
        panel.annotate(f"{i + 1}", (x, y), xytext=(7, 7), textcoords="offset points", color="black", fontsize=9,
                       bbox={"boxstyle": "round,pad=0.15", "facecolor": "white", "linewidth": 0.0, "alpha": 0.8})  # fmt: skip
    x, y = at(study.now, study.now_rating.score)
    panel.plot(x, y, "X", color=PRESENT, markeredgecolor="white", markersize=11, label="as it stands")
