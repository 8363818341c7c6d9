"""Write the waypoints of rail_panel: ribs on a long panel that is gently curved, with z = 0 at its lowest corners."""

from __future__ import annotations

from pathlib import Path

import numpy as np

LENGTH, WIDTH = 2600.0, 320.0  # mm, along x and y
ALONG, ACROSS = 90.0, 25.0  # mm, by which its middle is higher than its ends and than its sides
WAVE = 12.0  # mm, of a slow wave along it
RIBS = 5
STEP = 5.0  # mm between waypoints


def height(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Height of the panel above its corners and its slopes along x and y [mm, 1, 1]."""
    u, v, k = 2.0 * x / LENGTH, 2.0 * y / WIDTH, 4.0 * np.pi / LENGTH
    z = ALONG * (1.0 - u**2) + ACROSS * (1.0 - v**2) + WAVE * np.sin(k * x) * v
    by_x = -4.0 * ALONG * u / LENGTH + WAVE * k * np.cos(k * x) * v
    by_y = -4.0 * ACROSS * v / WIDTH + 2.0 * WAVE * np.sin(k * x) / WIDTH
    return z, by_x, by_y


def waypoints() -> str:
    """Lines x y z nx ny nz bead: ribs to and fro, from -y to +y."""
    lines = ["# x y z nx ny nz bead"]
    x = np.linspace(-0.5 * LENGTH, 0.5 * LENGTH, round(LENGTH / STEP) + 1)
    for bead, y in enumerate(np.linspace(-0.5 * WIDTH, 0.5 * WIDTH, RIBS)):
        way = x if bead % 2 == 0 else x[::-1]
        z, by_x, by_y = height(way, np.full_like(way, y))
        normals = np.column_stack([-by_x, -by_y, np.ones_like(way)])
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        for xi, zi, n in zip(way, z, normals, strict=True):
            lines.append(f"{xi:.3f} {y:.3f} {zi:.4f} {n[0]:.7f} {n[1]:.7f} {n[2]:.7f} {bead}")
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    (Path(__file__).resolve().parent / "rail_panel.txt").write_text(waypoints(), encoding="utf-8")
