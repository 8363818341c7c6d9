"""Draws logo.svg, the logo of Beadwise: a shield with a robot arm that lays down its bead. Millimetres, y down.

Run it from anywhere: python problems/draw_logo.py
"""

from __future__ import annotations

import math
from pathlib import Path

TARGET = Path(__file__).with_name("logo.svg")
Point = tuple[float, float]

# Half of each border, from the middle of the top to the tip: the other half is its mirror image about x = 40.
OUTER: list[Point] = [(40, 1), (53, 4.2), (66, 4.6), (79, 4.2), (79, 47), (79, 66), (63, 78), (40, 84.5)]
INNER: list[Point] = [(40, 4.2), (53, 7.2), (65, 7.7), (75.8, 7.4), (75.8, 47), (75.8, 64), (61, 75), (40, 81)]

LETTERS = {
    "B": "M0 0H7C9.6 0 11 1.3 11 3.4 11 4.8 10.3 5.9 9.1 6.3 10.6 6.8 11.6 7.9 11.6 9.6 11.6 11.8 10 13 7.3 13H0Z"
    "M2.8 2.6V5.2H6.6C7.6 5.2 8 4.8 8 3.9S7.6 2.6 6.6 2.6Z"
    "M2.8 7.8V10.4H7C8.1 10.4 8.6 10 8.6 9.1S8.1 7.8 7 7.8Z",
    "E": "m0 0h10v2.8h-7.2v2.3h5.8v2.8h-5.8v2.3h7.2v2.8h-10z",
    "A": "M4.3 0H7.9L12.2 13H9.2L8.4 10.4H3.8L3 13H0ZM5.5 3.7 4.4 7.8H7.8L6.7 3.7Z",
    "D": "M0 0H5.6C9.6 0 11.6 2.6 11.6 6.5S9.6 13 5.6 13H0ZM2.8 2.8V10.2H5.4C7.7 10.2 8.7 8.8 8.7 6.5S7.7 2.8 5.4 2.8Z",
}
LETTER_PLACES = {"B": 10.1, "E": 26.5, "A": 41.0, "D": 58.0}

SHOULDER, ELBOW, WRIST = (22.5, 55.0), (27.0, 38.5), (51.0, 41.0)
JOINT_RADII = {SHOULDER: 3.9, ELBOW: 3.5, WRIST: 2.9}
GAP = 1.5  # between a joint and the link that reaches for it
STARS = [
    (65.5, 41.0, 4.6, 0),
    (68.0, 52.5, 3.3, 14),
    (61.0, 58.5, 2.6, -10),
    (13.5, 41.0, 3.6, -12),
    (11.5, 51.5, 2.6, 10),
]


def number(value: float) -> str:
    """Write a number with three decimals at most."""
    return f"{value:.3f}".rstrip("0").rstrip(".").replace("-0", "0", value > -0.0005)


def pair(point: Point) -> str:
    """Write a point."""
    return f"{number(point[0])},{number(point[1])}"


def border(half: list[Point]) -> str:
    """Path data of a shield: a curve to the corner, a straight side, a curve to the tip, and the mirror image back."""
    top, a, b, corner, side, c, d, tip = half
    back = [(80 - x, y) for x, y in (d, c, side, corner, b, a)]
    right = f"M{pair(top)}C{pair(a)} {pair(b)} {pair(corner)}L{pair(side)}C{pair(c)} {pair(d)} {pair(tip)}"
    left = (
        f"C{pair(back[0])} {pair(back[1])} {pair(back[2])}L{pair(back[3])}C{pair(back[4])} {pair(back[5])} {pair(top)}"
    )
    return right + left + "Z"


def link(start: Point, end: Point, widths: tuple[float, float]) -> str:
    """Path data of a link between two joints: a bar whose ends are hollow, so that they embrace the joints."""
    angle = math.atan2(end[1] - start[1], end[0] - start[0])
    corners = []
    for centre, width, turn in ((start, widths[0], 0.0), (end, widths[1], math.pi)):
        radius = JOINT_RADII[centre] + GAP
        opening = math.asin(width / 2 / radius)
        for side in (-1, 1):
            at = angle + turn + side * opening
            corners.append((centre[0] + radius * math.cos(at), centre[1] + radius * math.sin(at)))
    a, b, c, d = corners
    hollow = [number(JOINT_RADII[centre] + GAP) for centre in (start, end)]
    return f"M{pair(b)}A{hollow[0]} {hollow[0]} 0 0 0 {pair(a)}L{pair(d)}A{hollow[1]} {hollow[1]} 0 0 0 {pair(c)}Z"


def star(inner: float) -> str:
    """Points of a five-pointed star of radius 1."""
    points = []
    for k in range(10):
        radius, angle = (1.0, inner)[k % 2], math.pi * (k / 5 - 0.5)
        points.append(pair((radius * math.cos(angle), radius * math.sin(angle))))
    return " ".join(points)


def printed_bead(start: float, turns: list[float], top: float, pitch: float, bend: float) -> str:
    """Path data of the bead: rows on the parabolas y = top + k pitch + bend (x - 40)², with round turns at `turns`."""

    def on_row(k: int, x: float) -> Point:
        return x, top + k * pitch + bend * (x - 40) ** 2

    data = f"M{pair(on_row(0, start))}"
    for k, end in enumerate(turns):
        middle = (start + end) / 2  # the tangents at both ends of a row meet above its middle
        slope = 2 * bend * (end - 40)
        here, below = on_row(k, end), on_row(k + 1, end)
        data += f"Q{pair((middle, here[1] + slope * (middle - end)))} {pair(here)}"
        if k + 1 < len(turns):
            reach = 0.667 * pitch * (1 if end > start else -1) / math.hypot(1, slope)
            controls = [pair((x + reach, y + reach * slope)) for x, y in (here, below)]
            data += f"C{controls[0]} {controls[1]} {pair(below)}"
        start = end
    return data


def drawing() -> str:
    """Return the drawing as SVG."""
    lines = [
        '<svg xmlns="http://www.w3.org/2000/svg" width="80mm" height="85.5mm" viewBox="0 0 80 85.5">',
        "  <title>Beadwise</title>",
        "  <defs>",
        '    <circle id="bead" r="1"/>',
        f'    <polygon id="star" points="{star(0.5)}"/>',
        "  </defs>",
        '  <g id="logo" fill="none" stroke="#1d4e6b" stroke-width="0.6">',
        f'    <path id="border" d="{border(OUTER)}"/>',
        f'    <path id="inner_border" d="{border(INNER)}"/>',
        '    <g id="name" transform="translate(0 11.2)">',
    ]
    for letter, x in LETTER_PLACES.items():
        lines.append(f'      <path id="{letter}" transform="translate({number(x)})" d="{LETTERS[letter]}"/>')
    lines += ["    </g>", '    <g id="beads" transform="translate(40 30)" stroke-width="0.25">']
    x = 0.0
    for k in range(7):
        radius = 2.5 - 0.17 * k
        for side in (1, -1) if k else (1,):
            lines.append(f'      <use href="#bead" transform="translate({number(side * x)}) scale({number(radius)})"/>')
        x += 2 * radius - 0.17 + 1.3
    lines += ["    </g>", '    <g id="robot">']
    for name, (centre, radius) in zip(("shoulder", "elbow", "wrist"), JOINT_RADII.items(), strict=True):
        place = f'cx="{number(centre[0])}" cy="{number(centre[1])}"'
        lines.append(f'      <circle id="{name}" {place} r="{number(radius)}"/>')
        lines.append(f'      <circle id="{name}_pin" {place} r="{number(0.45 * radius)}"/>')
    hollow = JOINT_RADII[SHOULDER] + GAP
    drop = math.sqrt(hollow**2 - 4.4**2)
    left, right = (SHOULDER[0] - 4.4, SHOULDER[1] + drop), (SHOULDER[0] + 4.4, SHOULDER[1] + drop)
    base = f"M{pair(left)}A{number(hollow)} {number(hollow)} 0 0 0 {pair(right)}l1.2 3.4h1.4v2.6h-14v-2.6h1.4z"
    lines += [
        f'      <path id="lower_arm" d="{link(SHOULDER, ELBOW, (6.6, 5.6))}"/>',
        f'      <path id="upper_arm" d="{link(ELBOW, WRIST, (6.0, 4.4))}"/>',
        f'      <path id="base" d="{base}"/>',
        f'      <g id="head" transform="translate({number(WRIST[0])} {number(WRIST[1])})">',
        '        <rect id="extruder" x="-3.4" y="4.4" width="6.8" height="9.4" rx="1.6"/>',
        '        <polygon id="nozzle" points="-2.8,15.3 2.8,15.3 2.8,18.3 0.9,22.8 -0.9,22.8 -2.8,18.3"/>',
        "      </g>",
        "    </g>",
        f'    <path id="printed" d="{printed_bead(51.0, [18.8, 58.7, 24.0, 52.7, 31.2, 43.9], 65.6, 2.1, 0.0045)}"/>',
    ]
    for x, y, radius, turn in STARS:
        place = f"translate({number(x)} {number(y)}) rotate({number(turn)}) scale({number(radius)})"
        lines.append(f'    <use href="#star" transform="{place}" stroke-width="{number(0.6 / radius)}"/>')
    lines += ["  </g>", "</svg>", ""]
    return "\n".join(lines)


if __name__ == "__main__":
    TARGET.write_text(drawing(), encoding="utf-8")
