"""Writes naca0015_arigela.dat: the section's points as Arigela et al. print them (table 2), in mm, in Selig's layout.

Run it from anywhere: python problems/draw_aerofoil.py
"""

from __future__ import annotations

from pathlib import Path

TARGET = Path(__file__).with_name("naca0015_arigela.dat")

# x, z of the lower surface, z of the upper surface; the leading edge first, where both are one.
TABLE = [
    (15, 8.7016, 8.7016),
    (16, 6.8080, 10.5952),
    (17, 6.0872, 11.3160),
    (19, 5.1472, 12.2560),
    (21, 4.5016, 12.9016),
    (23, 4.0192, 13.3840),
    (27, 3.3560, 14.0472),
    (31, 2.9640, 14.4392),
    (35, 2.7600, 14.6432),
    (39, 2.7000, 14.7032),
    (47, 2.8984, 14.5048),
    (55, 3.4080, 13.9952),
    (63, 4.1384, 13.2648),
    (71, 5.0376, 12.3656),
    (79, 6.0784, 11.3248),
    (87, 7.2536, 10.1496),
    (91, 7.8952, 9.5080),
    (95, 8.5752, 8.8280),
]


def section() -> str:
    """The file's text: a header, then points from the trailing edge over the upper surface and back."""
    points = [(x, upper) for x, _, upper in TABLE[::-1]] + [(x, lower) for x, lower, _ in TABLE[1:]]
    lines = ["NACA 0015, Arigela et al., table 2 (mm)", *(f"{x:8.4f} {z:8.4f}" for x, z in points)]
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    TARGET.write_text(section(), encoding="utf-8")
