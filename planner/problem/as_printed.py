"""What a scan of a print found: the section `as_printed`, by which layers above are laid on what is really there."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from planner.problem.by_layer import LayerNumber
from planner.problem.fields import PATH, Quantity, Section, key


class AsPrintedSpec(Section):
    """How far the top of a layer is from where it was planned, and how quickly that is made up for; see beadwise scan."""

    map: Annotated[Path, PATH] = key(
        "map", "the height map that beadwise scan wrote (CSV), counted from the folder of the problem file"
    )
    after_layer: LayerNumber = key(
        "after_layer", "the layer whose top was scanned, counted from 1; those above it are printed"
    )
    most: Annotated[float, Quantity("mm", 0.001, 10)] = key(
        "most_mm", "by how much beads are made higher or lower to make up for it, at most, in every layer [mm]"
    )
    smoothing: Annotated[float, Quantity("mm", 0.1, 100)] = key(
        "smoothing_mm", "radius around a place within which the map's places count [mm]"
    )
