"""Writes planar_box.gcode: a small box as a slicer would print it, 20 mm square with round corners, in three layers.

python problems/draw_gcode.py

Two walls and a filling of parallel lines, joined at their ends, that turn by a right angle from layer to layer. The
comments are those that PrusaSlicer writes; filament is counted from move to move (M83).
"""

from __future__ import annotations

import math
from pathlib import Path

SIDE, ROUND = 20.0, 4.0  # mm, of the outermost line: its side, and the radius of its corners
CENTRE = 110.0  # mm, x and y of the box on the printer's bed
LAYERS, HEIGHT, WIDTH, GAP = 3, 0.3, 0.5, 1.5  # mm; the gap is between lines of the filling
FILAMENT = 1.75  # mm
DRAWN_BACK = 0.8  # mm of filament between pieces
PUSH = ((WIDTH - HEIGHT) * HEIGHT + math.pi * HEIGHT**2 / 4) / (math.pi * FILAMENT**2 / 4)  # mm for each of the bead
Point = tuple[float, float]


def main() -> None:
    """Write the file beside this script."""
    Path(__file__).with_name("planar_box.gcode").write_text("\n".join(box()) + "\n", encoding="utf-8")


def box() -> list[str]:
    """The file's lines."""
    lines = ["; planar_box, written by draw_gcode.py", "G21 ; millimetres", "G90", "M83 ; filament from move to move"]
    lines += [
        "G28",
        "G1 Z5 F3000",
        *_to((60.0, 3.0)),
        "G1 Z0.2",
        f"G1 X100 Y3 E{40 * PUSH:.5f} F900 ; wipes the nozzle",
    ]
    lines += [f"G1 E-{DRAWN_BACK:g} F2400"]
    for layer in range(LAYERS):
        z = (layer + 1) * HEIGHT
        lines += [";LAYER_CHANGE", f";Z:{z:g}", f";HEIGHT:{HEIGHT:g}", f"G1 Z{z:g} F3000"]
        for k, kind in enumerate(("External perimeter", "Perimeter")):
            lines += [f";TYPE:{kind}", f";WIDTH:{WIDTH:g}", *_wall(0.5 * SIDE - k * WIDTH, ROUND - k * WIDTH)]
        lines += [";TYPE:Solid infill", *_filling(0.5 * SIDE - 2.0 * WIDTH - 0.1, layer % 2 == 1)]
    return [*lines, "G1 Z30 F3000", "M84"]


def _to(point: Point) -> list[str]:
    return [f"G1 X{point[0]:.3f} Y{point[1]:.3f} F9000"]


def _piece(start: Point, moves: list[str]) -> list[str]:
    """Go there, extrude, draw back."""
    return [*_to(start), f"G1 E{DRAWN_BACK:g} F2400", "G1 F2400", *moves, f"G1 E-{DRAWN_BACK:g} F2400"]


def _wall(half: float, radius: float) -> list[str]:
    """A square with round corners, counter-clockwise from the middle of its front."""
    inner, c = half - radius, CENTRE
    moves = []
    for x, y in ((1, -1), (1, 1), (-1, 1), (-1, -1)):  # corners; before each a straight line, then a quarter circle
        before = (c + x * inner, c + y * half) if x * y < 0 else (c + x * half, c + y * inner)
        after = (c + x * half, c + y * inner) if x * y < 0 else (c + x * inner, c + y * half)
        straight = inner if not moves else 2.0 * inner
        i, j = (0.0, -y * radius) if x * y < 0 else (-x * radius, 0.0)
        moves += [f"G1 X{before[0]:.3f} Y{before[1]:.3f} E{straight * PUSH:.5f}"]
        moves += [f"G3 X{after[0]:.3f} Y{after[1]:.3f} I{i:.3f} J{j:.3f} E{0.5 * math.pi * radius * PUSH:.5f}"]
    moves += [f"G1 X{c:.3f} Y{c - half:.3f} E{inner * PUSH:.5f}"]
    return _piece((c, c - half), moves)


def _filling(half: float, along_y: bool) -> list[str]:
    """Lines from side to side of a square without its corners, joined at their ends."""
    rows = int(2.0 * half / GAP)
    points: list[Point] = []
    for k in range(rows + 1):
        across = (k - 0.5 * rows) * GAP
        reach = half - max(0.0, abs(across) - (half - 2.0))  # the corners are round
        ends = [(-reach, across), (reach, across)]
        points += ends if k % 2 == 0 else ends[::-1]
    placed = [(CENTRE + (b if along_y else a), CENTRE + (a if along_y else b)) for a, b in points]
    moves = [
        f"G1 X{b[0]:.3f} Y{b[1]:.3f} E{math.dist(a, b) * PUSH:.5f}"
        for a, b in zip(placed[:-1], placed[1:], strict=True)
    ]
    return _piece(placed[0], moves)


if __name__ == "__main__":
    main()
