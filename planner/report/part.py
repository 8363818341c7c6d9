"""The part under the print as a shaded solid, and the direction from which it is looked at."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

CIRCLE = 97
PART_LIT, PART_DARK = np.array([238.0, 242.0, 246.0]), np.array([176.0, 187.0, 199.0])


def part_traces(problem: Any, facing: Array) -> list[dict[str, Any]]:
    """The part as a light solid, where its shape is known: a cylinder from z = 0 to its height, lit from where it is seen."""
    cylinder = getattr(getattr(problem, "part", None), "cylinder", None)
    if cylinder is None:
        return []
    centre, radius, height = (np.asarray(cylinder.centre) * 1e3, cylinder.radius * 1e3, cylinder.height * 1e3)
    # A hair smaller than it is, so that the first layer's lines are not half sunk into it.
    radius *= 0.995
    a = np.linspace(0, 2 * np.pi, CIRCLE)
    ring = np.column_stack([centre[0] + radius * np.cos(a), centre[1] + radius * np.sin(a)])
    bottom = np.column_stack([ring, np.zeros(CIRCLE)])
    top = np.column_stack([ring, np.full(CIRCLE, height)])
    hub = np.array([[*centre[:2], height]])
    vertices = np.vstack([bottom, top, top, hub]).astype(np.float32)
    wall = np.column_stack([np.cos(a), np.sin(a), np.zeros(CIRCLE)])
    up = np.tile([0.0, 0.0, 1.0], (CIRCLE, 1))
    k = np.arange(CIRCLE - 1)
    side_i = np.concatenate([k, k + 1])
    side_j = np.concatenate([k + 1, k + 1 + CIRCLE])
    side_k = np.concatenate([k + CIRCLE, k + CIRCLE])
    i = np.concatenate([side_i, k + 2 * CIRCLE])
    j = np.concatenate([side_j, k + 1 + 2 * CIRCLE])
    kk = np.concatenate([side_k, np.full(CIRCLE - 1, 3 * CIRCLE)])
    return [
        {
            "type": "mesh3d",
            "x": vertices[:, 0].copy(),
            "y": vertices[:, 1].copy(),
            "z": vertices[:, 2].copy(),
            "i": i.astype(np.uint16),
            "j": j.astype(np.uint16),
            "k": kk.astype(np.uint16),
            # Shaded here: plotly lights an orthographic scene evenly, and a round part would look flat.
            "vertexcolor": _shade(np.vstack([wall, wall, up, up[:1]]), facing),
            # Opaque at first: plotly does not sort translucent triangles, and stripes would show.
            "opacity": 1.0,
            "hoverinfo": "skip",
            "lighting": {"ambient": 1.0, "diffuse": 0.0, "specular": 0.0, "fresnel": 0.0},
        }
    ]


def eye(facing: Array) -> dict[str, float]:
    """Camera direction: from where the print faces, a little from above; a fixed one if it faces everywhere."""
    flat = float(np.hypot(facing[0], facing[1]))
    sideways = flat > 0.15
    azimuth = (np.arctan2(facing[1], facing[0]) if sideways else np.radians(-60.0)) + np.radians(18.0)
    out, up = (1.6, 0.55) if sideways else (1.35, 1.1)
    return {"x": round(out * float(np.cos(azimuth)), 3), "y": round(out * float(np.sin(azimuth)), 3), "z": up}


def _shade(normals: Array, facing: Array) -> list[str]:
    """Colours of a matt surface with `normals` (n, 3), lit from beside and above the camera."""
    at = eye(facing)
    side = np.array([-at["y"], at["x"], 0.0])
    light = np.array([at["x"], at["y"], 0.9]) - 0.6 * side
    lit = np.clip(normals @ (light / np.linalg.norm(light)), 0.0, 1.0)[:, None]
    colours = np.round(PART_DARK + lit * (PART_LIT - PART_DARK)).astype(int)
    return [f"rgb({r},{g},{b})" for r, g, b in colours]
