"""Plain drawings: the rule beside the nozzle's tip, shapes of a bead, and what happens around it."""

from __future__ import annotations

from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt  # after the choice of its backend
import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Circle, FancyBboxPatch, Polygon, Rectangle

from benchmarks.drawings.cells import DPI
from benchmarks.drawings.scene import INK

NOZZLE, BEAD, SURFACE, WARN, SOFT = "#ee9a42", "#7fa8cf", "#cfc8b8", "#b3261e", "#5b6b7b"
ARROW = {"arrowstyle": "-|>", "color": INK, "linewidth": 1.1}


def _note(axes: Axes, text: str, at: tuple[float, float], to: tuple[float, float] | None = None) -> None:
    """Words, with an arrow where they mean a place."""
    if to is None:
        axes.text(*at, text, fontsize=9, color=INK, ha="center", va="center")
    else:
        axes.annotate(text, to, at, fontsize=9, color=INK, ha="center", va="center", arrowprops=ARROW)


def _bare(axes: Axes, x: tuple[float, float], y: tuple[float, float]) -> None:
    axes.set(xlim=x, ylim=y, aspect="equal")
    axes.set_axis_off()


def tip_rule(picture: Path) -> None:
    """How near a body may come to the nozzle's side: r / 4 beside the tip, 2 mm from some 8 mm on."""
    figure, axes = plt.subplots(figsize=(8.6, 4.2), layout="constrained")
    axes.add_patch(Rectangle((-14, -0.5), 28, 0.5, color=BEAD))
    axes.add_patch(Rectangle((-14, -2.5), 28, 2.0, color=SURFACE))
    outline = [(0.6, 0.0), (7.5, 12.0), (7.5, 16.0)]
    nozzle = np.array([*outline, *[(-x, y) for x, y in reversed(outline)]])
    axes.add_patch(Polygon(nozzle, color=NOZZLE))
    # the edge of what must stay free: from the nozzle's side by the distance that is asked there
    edge = np.concatenate([np.linspace(outline[k], outline[k + 1], 60) for k in range(2)])
    across = np.concatenate([np.tile([0.867, -0.498], (60, 1)), np.tile([1.0, 0.0], (60, 1))])
    need = np.minimum(np.linalg.norm(edge, axis=1) / 4.0, 2.0)[:, None]
    for side in ((1.0, 1.0), (-1.0, 1.0)):
        axes.plot(*(side * (edge + need * across)).T, color=WARN, linewidth=1.8, linestyle="--")
    axes.plot(0, 0, "o", color=INK, markersize=4)
    _note(axes, "nozzle", (0, 10))
    _note(axes, "2 mm: the whole distance", (-17.0, 13.2), (-9.6, 13.2))
    _note(axes, "r / 4 at a distance r from the tip", (14.6, 7.6), (5.0, 5.4))
    _note(axes, "tip: no distance is left here,\nsince beads lie beside beads", (11.6, 2.6), (0.4, 0.2))
    _note(axes, "nothing may come\ninside the dashed lines", (-14.0, 6.2), (-4.4, 4.6))
    _note(axes, "bead and layers below", (-8.5, -1.5))
    _bare(axes, (-23, 23), (-2.6, 16.2))
    figure.savefig(picture, dpi=DPI)
    plt.close(figure)


def sections(picture: Path) -> None:
    """The three shapes of a bead's cross-section, with width, height and area."""
    figure, axes = plt.subplots(figsize=(8.6, 2.5), layout="constrained")
    for x, name, area in (
        (0.0, "rectangle", "w · h"),
        (9.0, "rounded", "(w − h) · h + π/4 · h²"),
        (18.0, "fibre", "π/4 · d², d of the filament"),
    ):
        if name == "rectangle":
            axes.add_patch(Rectangle((x - 2.4, 0), 4.8, 2.0, color=BEAD))
        elif name == "rounded":
            axes.add_patch(FancyBboxPatch((x - 1.4, 1.0), 2.8, 0.0, boxstyle="round,pad=1.0", color=BEAD))
        else:
            axes.add_patch(Circle((x, 1.0), 1.0, color=BEAD))
        _note(axes, f"{name}\n{area}", (x, 3.4))
    for x in (0.0, 9.0):
        axes.annotate("", (x - 2.4, -0.5), (x + 2.4, -0.5), arrowprops={"arrowstyle": "<|-|>", "color": INK})
        _note(axes, "w", (x, -1.0))
        axes.annotate("", (x + 2.8, 0.0), (x + 2.8, 2.0), arrowprops={"arrowstyle": "<|-|>", "color": INK})
        _note(axes, "h", (x + 3.2, 1.0))
    _bare(axes, (-4, 23), (-1.5, 4.4))
    figure.savefig(picture, dpi=DPI)
    plt.close(figure)


def around(picture: Path) -> None:
    """A bead from the side: travel, run-in, the bead, run-out."""
    figure, (upper, lower) = plt.subplots(2, 1, figsize=(9.0, 4.6), layout="constrained", height_ratios=(1.5, 1))
    upper.add_patch(Rectangle((-4, -1.2), 48, 1.2, color=SURFACE))
    upper.add_patch(Rectangle((10, 0), 20, 0.7, color=BEAD))
    u = np.linspace(0.0, 1.0, 40)
    path = np.concatenate(
        [
            np.column_stack([-2 + 5 * u, 7.0 - 3.2 * u**2]),
            np.column_stack([3 + 7 * u, 0.7 + 3.1 * (1 - u) ** 3]),
            np.column_stack([10 + 20 * u, np.full(40, 0.7)]),
            np.column_stack([30 + 7 * u, 0.7 + 3.1 * u**3]),
            np.column_stack([37 + 5 * u, 3.8 + 3.2 * (1 - (1 - u) ** 2)]),
        ]
    )
    upper.plot(*path.T, color=INK, linewidth=1.8)
    for x, text in ((0.6, "travel"), (6.5, "run-in"), (20.0, "bead"), (33.5, "run-out"), (39.6, "travel")):
        _note(upper, text, (x, 8.3))
    for x in (3, 10, 30, 37):
        upper.plot([x, x], [0, 7.6], color=SOFT, linewidth=0.7, linestyle=":")
    _note(upper, "lift_mm", (15.5, 4.6), (10.6, 4.6))
    upper.annotate("", (10.0, 0.7), (10.0, 7.0), arrowprops={"arrowstyle": "<|-|>", "color": SOFT})
    _note(upper, "ramp_deg: the angle of a straight run", (23.5, 2.7), (33.6, 1.4))
    upper.set(xlim=(-4, 44), ylim=(-1.3, 9.0))
    upper.set_axis_off()

    place = np.linspace(-4, 44, 600)
    speed = np.interp(place, [-4, 1, 3, 9, 10, 30, 31, 37, 39, 44], [150, 80, 0, 36, 40, 40, 36, 0, 80, 150])
    lower.plot(place, np.minimum(speed, 75), color=INK, linewidth=1.8)
    lower.fill_between(place, 0, np.where((place >= 10) & (place <= 30), 40, 0), color=BEAD, alpha=0.6, linewidth=0)
    lower.set(xlim=(-4, 44), ylim=(0, 75), xticks=[], yticks=[0, 40], yticklabels=["0", "commanded"])
    lower.spines[["top", "right"]].set_visible(False)
    _note(lower, "material flows", (20, 18))
    _note(lower, "hand_over: at rest here,\nor in motion", (8.6, 62), (3.1, 3))
    lower.set_ylabel("speed")
    figure.savefig(picture, dpi=DPI)
    plt.close(figure)
