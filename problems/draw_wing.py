"""Writes naca0015_wing.stl: the segment of a wing that Arigela et al. print, as a closed mesh in mm, binary STL.

Its section is the curve of naca0015_wing.yaml: of degree 5, through the points of naca0015_arigela.dat. x runs along the
chord from 15 mm on, y along the span from 0 on, z up, the chord line 8.7016 mm above 0.

Run it from anywhere: python problems/draw_wing.py
"""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import make_interp_spline

Array = NDArray[np.float64]

FOLDER = Path(__file__).parent
SPAN = 20.0
PIECES = 120  # of a side, closer together at the nose


def outline() -> tuple[Array, Array]:
    """Points (n, 2) of the upper and of the lower side, both from the nose to the tail."""
    points = np.loadtxt(FOLDER / "naca0015_arigela.dat", skiprows=1)
    length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    curve = make_interp_spline(length, points, k=5)
    nose = length[int(np.argmin(points[:, 0]))]
    share = np.linspace(0.0, 1.0, PIECES + 1) ** 1.5
    return curve(nose * (1.0 - share)), curve(nose + (length[-1] - nose) * share)


def corners() -> Array:
    """Facets (n, 3, 3), counter-clockwise seen from outside."""
    upper, lower = outline()
    around = np.concatenate([upper[::-1], lower[1:]])  # from tail to tail, then closed by the tail's edge
    root, tip = (np.column_stack([around[:, 0], np.full(len(around), y), around[:, 1]]) for y in (0.0, SPAN))
    ahead = [np.roll(each, -1, axis=0) for each in (root, tip)]
    skin = [np.stack([root, tip, ahead[1]], axis=1), np.stack([root, ahead[1], ahead[0]], axis=1)]
    above, below = (np.column_stack([side[:, 0], np.zeros(len(side)), side[:, 1]]) for side in (upper, lower))
    near = np.concatenate(
        [
            np.stack([above[1:], above[:-1], below[:-1]], axis=1)[1:],  # above and below meet in the nose
            np.stack([above[1:], below[:-1], below[1:]], axis=1),
        ]
    )
    far = near[:, ::-1] + [0.0, SPAN, 0.0]
    return np.concatenate([*skin, near, far])


def stl(facets: Array) -> bytes:
    """The binary file: 80 bytes of title, the number of facets, then normal and corners of each."""
    record = np.zeros(len(facets), dtype=[("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
    across = np.cross(facets[:, 1] - facets[:, 0], facets[:, 2] - facets[:, 0])
    record["normal"] = across / np.linalg.norm(across, axis=1)[:, None]
    record["corners"] = facets
    return b"NACA 0015 wing".ljust(80) + struct.pack("<I", len(facets)) + record.tobytes()


if __name__ == "__main__":
    (FOLDER / "naca0015_wing.stl").write_bytes(stl(corners()))
