"""A figure of residuals, and of how sure the nozzle's height is over the beads."""

from __future__ import annotations

import io
from html import escape
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure

from planner.errors import OutputError
from planner.registration.finding import Registration

KINDS = (".png", ".html")
_GOOD, _BAD = "#3b6ea8", "#c8503c"
_PAGE = """<!doctype html><html lang="en"><head><meta charset="utf-8"><title>{title}</title>
<style>body{{font:15px/1.5 system-ui,sans-serif;max-width:60em;margin:2em auto;padding:0 1em;color:#222}}
pre{{white-space:pre-wrap;background:#f5f5f3;padding:1em}}svg{{max-width:100%;height:auto}}</style></head>
<body><h1>{title}</h1><p><b>{verdict}</b></p>{figure}<pre>{lines}</pre></body></html>
"""


def write_picture(found: Registration, tolerance: float, verdict: str, lines: list[str], target: Path) -> None:
    """Write the figure as PNG, or as an HTML page of its own with all that is said. Raises OutputError."""
    figure = _figure(found, tolerance)
    try:
        if target.suffix == ".png":
            FigureCanvasAgg(figure).print_png(str(target), metadata={"Software": None})
            return
        stream = io.StringIO()
        FigureCanvasSVG(figure).print_svg(stream, metadata={"Date": None})
        svg = stream.getvalue()
        page = _PAGE.format(
            title=escape(f"Where {found.scene.problem.name} is"),
            verdict=escape(verdict),
            figure=svg[svg.index("<svg") :],
            lines=escape("\n".join(lines)),
        )
        target.write_text(page, encoding="utf-8")
    except OSError as error:
        raise OutputError(f"cannot write {target}: {error.strerror}") from error


def _figure(found: Registration, tolerance: float) -> Figure:
    fit, scene, sure = found.fit, found.scene, found.uncertainty
    residuals = fit.residuals * 1e3
    figure = Figure(figsize=(11.0, 4.6), dpi=120, facecolor="white", layout="constrained")
    bars, space = figure.add_subplot(1, 2, 1), figure.add_subplot(1, 2, 2, projection="3d")
    # outliers reach out of the picture, else nothing could be seen of the others
    reach = max(3.0 * float(np.abs(residuals[fit.kept]).max()), tolerance * 1.2e3)
    shown = np.clip(residuals, -reach, reach)
    at = np.arange(len(shown))
    bars.bar(at, shown, color=[_GOOD if kept else _BAD for kept in fit.kept])
    for k in np.flatnonzero(np.abs(residuals) > reach):
        bars.annotate(f"{residuals[k]:+.2f}", (k, shown[k]), ha="center", va="bottom" if shown[k] > 0 else "top")
    for side in (-tolerance, tolerance):
        bars.axhline(side * 1e3, color="#999", linestyle="--", linewidth=0.8)
    bars.set_ylim(-1.15 * reach, 1.15 * reach)
    if len(at) <= 30:
        bars.set_xticks(at, fit.touch.contacts.names, rotation=60 if len(at) > 12 else 0)
    bars.set_ylabel("residual [mm]")
    bars.set_title("contacts: off the surface (outliers in red)", fontsize=10)
    bars.spines[["top", "right"]].set_visible(False)

    shape = scene.toolpath.shape
    if shape is not None:
        space.plot_trisurf(*(shape.vertices.T * 1e3), triangles=shape.triangles, color="#999", alpha=0.12, shade=False)
    points = scene.waypoints.points * 1e3
    dots = space.scatter(*points.T, c=sure.height * 1e3, s=3, cmap="viridis")
    touched = fit.placement.seen(fit.touch.contacts.tips, fit.touch.contacts.T_world_plate) * 1e3
    space.scatter(*touched[fit.kept].T, color=_GOOD, s=30, depthshade=False)
    space.scatter(*touched[~fit.kept].T, color=_BAD, s=30, marker="x", depthshade=False)
    if not np.isnan(sure.height).any():
        figure.colorbar(dots, ax=space, shrink=0.7, label="standard error of the nozzle's height [mm]")
    space.set_aspect("equal")
    space.set_title("beads and contacts, part frame [mm]", fontsize=10)
    return figure
