"""What the plots share: colours that any eye tells apart, and axes where none are given."""

from __future__ import annotations

from typing import Any

import matplotlib.pyplot as plt
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap

from planner.report.scene import COLOURS as COLOURS_OF_SCENES

# Okabe and Ito, without their yellow, which is hard to see on white.
COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#56b4e9", "#e69f00", "#000000")
STYLES = ("-", "--", "-.", ":")
INK, SOFT, FAINT, ALARM = "#1b2733", "#5b6b7b", "#d9e0e7", "#b5402f"
MAP = LinearSegmentedColormap.from_list("calm", COLOURS_OF_SCENES)  # as in the report: light is where it gets tight


def axes_of(ax: Axes | None, **figure: Any) -> Axes:
    """The axes given, or those of a new figure (`figure`: as for matplotlib.pyplot.subplots)."""
    if ax is not None:
        return ax
    return plt.subplots(layout="constrained", **figure)[1]


def legend_above(ax: Axes) -> None:
    """A legend in one row above the axes, where nothing is drawn."""
    count = len(ax.get_legend_handles_labels()[0])
    ax.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=count, frameon=False, fontsize=8)


def tidy(ax: Axes) -> Axes:
    """Without a box around it."""
    ax.spines[["top", "right"]].set_visible(False)
    return ax
