"""Writes saddle_ring.stl: a ring with a level underside and a saddle on top, such as a spring washer, in mm, binary STL.

Run it from anywhere: python problems/draw_saddle_ring.py
"""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

TARGET = Path(__file__).with_name("saddle_ring.stl")

OUTER, INNER = 15.0, 6.0  # mm, radii
MIDDLE, RISE = 3.0, 0.9  # mm: height of the top, and by how much it rises and falls at the outer wall
AROUND, ACROSS = 72, 4  # facets' edges around, and from wall to wall


def corners() -> NDArray[np.float64]:
    """Facets (n, 3, 3) [mm], counter-clockwise seen from outside."""
    angle = np.arange(AROUND) * 2.0 * np.pi / AROUND
    radius = np.linspace(INNER, OUTER, ACROSS + 1)
    x, y = radius[:, None] * np.cos(angle), radius[:, None] * np.sin(angle)
    top = np.stack([x, y, MIDDLE + RISE * (x**2 - y**2) / OUTER**2], axis=-1)
    foot = np.stack([x, y, np.zeros_like(x)], axis=-1)[[0, -1]]
    # Up the inner wall, over the top, down the outer wall and back beneath: one closed strip around.
    around = np.concatenate([foot[:1], top, foot[1:], foot[:1]])
    a, c = around[:-1], around[1:]
    b, d = np.roll(a, -1, axis=1), np.roll(c, -1, axis=1)
    return np.concatenate([np.stack(each, axis=-2).reshape(-1, 3, 3) for each in ((a, c, d), (a, d, b))])


def stl(facets: NDArray[np.float64]) -> bytes:
    """The binary file: 80 bytes of title, the number of facets, then normal and corners of each."""
    record = np.zeros(len(facets), dtype=[("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
    across = np.cross(facets[:, 1] - facets[:, 0], facets[:, 2] - facets[:, 0])
    record["normal"] = across / np.linalg.norm(across, axis=1)[:, None]
    record["corners"] = facets
    return b"saddle ring".ljust(80) + struct.pack("<I", len(facets)) + record.tobytes()


if __name__ == "__main__":
    TARGET.write_bytes(stl(corners()))
