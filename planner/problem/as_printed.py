"""What a scan of a print found: the section `as_printed`, by which further layers are fitted to the real print."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from planner.problem.by_layer import LayerNumber
from planner.problem.fields import PATH, Quantity, Section, key


class AsPrintedSpec(Section):
    """How far a layer's top is from where it was planned, and how quickly that is made up for; see beadwise scan."""

    map: Annotated[Path, PATH] = key(
        "map", "the height map that beadwise scan wrote (CSV), path relative to the problem file's folder"
    )
    after_layer: LayerNumber = key(
        "after_layer", "the layer whose top was scanned, counted from 1; only those above it are printed"
    )
    most: Annotated[float, Quantity("mm", 0.001, 10)] = key(
        "most_mm", "how much higher or lower beads may be made in each layer to make up for it [mm]"
    )
    smoothing: Annotated[float, Quantity("mm", 0.1, 100)] = key(
        "smoothing_mm", "radius around a place within which points of the map count [mm]"
    )
