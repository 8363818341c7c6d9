"""Two curved layers on a wave, bead by bead, the second one wider."""

import numpy as np

from planner import Toolpath, load, solve

HEIGHT, APART = 0.0005, 0.004  # m: of a layer, and between its beads


def wave(x: np.ndarray, y: float) -> tuple[np.ndarray, np.ndarray]:
    """Points and upward normals of z = 3 mm cos(x / 15 mm)."""
    z, slope = 0.003 * np.cos(x / 0.015), -0.2 * np.sin(x / 0.015)
    points = np.column_stack([x, np.full_like(x, y), z])
    normals = np.column_stack([-slope, np.zeros_like(x), np.ones_like(x)])
    return points, normals / np.linalg.norm(normals, axis=1)[:, None]


points, normals, layers = [], [], []
x = np.linspace(-0.03, 0.03, 120)
for layer in (0, 1):
    for row in range(4):
        beneath, up = wave(x if row % 2 == 0 else x[::-1], APART * row)
        points.append(beneath + (layer + 1) * HEIGHT * up)  # where the nozzle's tip runs
        normals.append(up)
        layers.append(layer)
widths = [0.0006 if layer == 0 else 0.0008 for layer in layers]
patch = Toolpath.from_arrays(points, normals, layer=layers, width=widths, height=HEIGHT)

plan = solve(load("peer_cap", {"cell.bed_mm": [400, 0, 260]}, toolpath=patch), baseline=False)
print(plan.summary())
print([(bead.layer, round(1e3 * bead.length, 1)) for bead in plan.beads])
