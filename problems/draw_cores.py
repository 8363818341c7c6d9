"""Writes the meshes of the aerofoil cores: moulds with the lower surface in their top, and the middle of the tapered one.

Sizes are those of the meshes that Pollard et al. published with their program: a straight section of 100 mm chord and
10 mm half thickness in a block 70 mm long; one of 89 to 64 mm chord over 100 mm of span, twisted by 15 degrees. Their
sections have no name; these are of the NACA's four digits, 0020 and 0015.

Part frame in mm: x along the span, y along the chord towards the nose, z up.

Run it from anywhere: python problems/draw_cores.py
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

FOLDER = Path(__file__).parent

TOP = 45.0  # of the straight mould: its middle
CHORD, SPAN, THICKNESS = 100.0, 70.0, 0.20
NOSE = 50.0  # y of the nose, of both

TAPERED_TOP = 40.0  # of the tapered mould, at the nose
ROOT, TIP, TAPERED_SPAN, TAPERED_THICKNESS = 89.0, 64.0, 100.0, 0.15
TWIST = np.radians(15.0)  # at the tip, about the nose; it grows with the square of the span

RIM = 5.0  # of the moulds before the nose and behind the tail
STATIONS = 128  # along the chord of the straight section
TAPERED_STATIONS, RIBS, ROWS = (
    64,
    30,
    20,
)  # along the chord and the span of the tapered one, and along its middle's chord


def half_thickness(c: Array) -> Array:
    """Of a NACA section of unit chord and thickness at chord fractions c (n), closed at the tail; 0 beyond."""
    c = np.clip(c, 0.0, 1.0)
    return 5.0 * (0.2969 * np.sqrt(c) - 0.1260 * c - 0.3516 * c**2 + 0.2843 * c**3 - 0.1036 * c**4)


def straight(x: Array, y: Array) -> tuple[Array, Array]:
    """Heights (n) of the lower surface and of the middle of the straight core at x, y (n)."""
    middle = np.full(np.shape(x), TOP)
    return middle - CHORD * THICKNESS * half_thickness((NOSE - y) / CHORD), middle


def chord(x: Array) -> Array:
    """Chord (n) of the tapered core at x (n)."""
    return ROOT + (TIP - ROOT) * (x / TAPERED_SPAN + 0.5)


def tapered(x: Array, y: Array) -> tuple[Array, Array]:
    """Heights (n) of the lower surface and of the middle of the tapered core at x, y (n)."""
    middle = TAPERED_TOP - np.tan(TWIST * (x / TAPERED_SPAN + 0.5) ** 2) * (NOSE - y)
    c = chord(x)
    return middle - c * TAPERED_THICKNESS * half_thickness((NOSE - y) / c), middle


def block(x: Array, y: Array, z: Array) -> Array:
    """Facets (k, 3, 3) of a block that stands on z = 0 and whose top has the heights z at a grid x, y, all (n, m)."""
    top = np.stack([x, y, z], axis=-1)
    a, b, c, d = top[:-1, :-1], top[1:, :-1], top[1:, 1:], top[:-1, 1:]
    facets = [np.stack(corners, axis=-2).reshape(-1, 3, 3) for corners in ((a, b, c), (a, c, d))]
    rim = np.vstack([top[:, 0], top[-1, 1:], top[-2::-1, -1], top[0, -2::-1]])  # counter-clockwise from above
    foot = rim * [1.0, 1.0, 0.0]
    here, there, low, next_low = rim[:-1], rim[1:], foot[:-1], foot[1:]
    middle = np.broadcast_to(foot[:-1].mean(axis=0), here.shape)
    for corners in ((here, low, there), (there, low, next_low), (middle, next_low, low)):
        facets.append(np.stack(corners, axis=-2))
    return np.concatenate(facets)


def grid(span: float, ribs: int, stations: int, chords: Array | float) -> tuple[Array, Array]:
    """x, y (ribs, stations + 2): along each rib from the tail to the nose, closer at both, and the rims beyond."""
    x = np.linspace(-0.5 * span, 0.5 * span, ribs)
    c = 0.5 * (1.0 + np.cos(np.linspace(0.0, np.pi, stations)))
    y = NOSE - np.multiply.outer(np.broadcast_to(chords, x.shape), c)
    last = np.full((ribs, 1), NOSE - np.max(chords) - RIM)
    y = np.hstack([last, y, np.full((ribs, 1), NOSE + RIM)])
    return np.broadcast_to(x[:, None], y.shape), y


def stl(facets: Array) -> bytes:
    """The facets (k, 3, 3) as a binary STL file."""
    record = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
    across = np.cross(facets[:, 1] - facets[:, 0], facets[:, 2] - facets[:, 0])
    data = np.zeros(len(facets), record)
    data["normal"] = across / np.linalg.norm(across, axis=1)[:, None]
    data["corners"] = facets
    return bytes(80) + np.uint32(len(facets)).astype("<u4").tobytes() + data.tobytes()


def meshes() -> dict[str, bytes]:
    """The files by name."""
    x, y = grid(SPAN, 2, STATIONS, CHORD)
    files = {"aerofoil_core.stl": block(x, y, straight(x, y)[0])}
    ribs = np.linspace(-0.5 * TAPERED_SPAN, 0.5 * TAPERED_SPAN, RIBS)
    x, y = grid(TAPERED_SPAN, RIBS, TAPERED_STATIONS, chord(ribs))
    files["aerofoil_core_tapered.stl"] = block(x, y, tapered(x, y)[0])
    y = np.tile(np.linspace(y.min(), y.max(), ROWS), (RIBS, 1))
    x = np.broadcast_to(ribs[:, None], y.shape)
    files["aerofoil_core_middle.stl"] = block(x, y, tapered(x, y)[1])
    return {name: stl(facets) for name, facets in files.items()}


if __name__ == "__main__":
    for name, data in meshes().items():
        (FOLDER / name).write_bytes(data)
