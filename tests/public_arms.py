"""Arms by their makers' lengths, as public URDFs have them: each with the zero, the senses of axes and the frames of its URDF.

A row is a joint: where it stands in the one before [m] and its axis. Lengths and ranges are those of the makers' data sheets;
conventions are those of the packages named, whose files are not here.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

Row = tuple[tuple[float, float, float], tuple[int, int, int]]
X, Y, Z = (1, 0, 0), (0, 1, 0), (0, 0, 1)
LEFT, RIGHT, DOWN = (-1, 0, 0), (0, -1, 0), (0, 0, -1)


@dataclass(frozen=True)
class PublicArm:
    """An arm: whose it is, its joints base first, its tip behind the last one (xyz [m], rpy [rad]), ranges [deg], what its
    lengths should be read as (a1 a2 b c1 c2 c3 c4 [mm]), and its reach to the wrist by the data sheet [mm]."""

    source: str
    rows: tuple[Row, ...]
    tip: tuple[tuple[float, float, float], tuple[float, float, float]]
    ranges: tuple[tuple[float, float], ...]
    lengths: tuple[float, ...]
    reach: float | None = None


def kuka(*lengths: float) -> tuple[Row, ...]:
    """As kuka_experimental has them: upper arm level at zero, axes 1, 4 and 6 the other way round."""
    c1, a1, c2, a2, c3, c4 = (value * 1e-3 for value in lengths)
    return (
        ((0, 0, c1), DOWN), ((a1, 0, 0), Y), ((c2, 0, 0), Y), ((0, 0, a2), LEFT), ((c3, 0, 0), Y), ((c4, 0, 0), LEFT),
    )  # fmt: skip


def fanuc(*lengths: float) -> tuple[Row, ...]:
    """As ros-industrial/fanuc: upper arm upright at zero, axes 3 to 6 the other way round."""
    c1, a1, c2, a2, c3, c4 = (value * 1e-3 for value in lengths)
    return (
        ((0, 0, c1), Z), ((a1, 0, 0), Y), ((0, 0, c2), RIGHT), ((0, 0, a2), LEFT), ((c3, 0, 0), RIGHT), ((c4, 0, 0), LEFT),
    )  # fmt: skip


def staubli(*lengths: float) -> tuple[Row, ...]:
    """As ros-industrial/staubli: the whole arm upright at zero, the forearm beside the upper arm."""
    c1, a1, b, c2, c3, c4 = (value * 1e-3 for value in lengths)
    return (((0, 0, c1), Z), ((a1, 0, 0), Y), ((0, b, c2), Y), ((0, 0, 0), Z), ((0, 0, c3), Y), ((0, 0, c4), Z))


UPRIGHT = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
LEVEL = ((0.0, 0.0, 0.0), (0.0, np.pi / 2, 0.0))
OVER = ((0.0, 0.0, 0.0), (np.pi, -np.pi / 2, 0.0))
KUKA_SMALL = ((-170, 170), (-190, 45), (-120, 156), (-185, 185), (-120, 120), (-350, 350))
ARMS = {
    "KUKA KR 6 R700 sixx": PublicArm(
        "kuka_experimental", kuka(400, 25, 315, 35, 365, 80), LEVEL, KUKA_SMALL, (25, -35, 0, 400, 315, 365, 80), 706.7
    ),
    "KUKA KR 10 R1420": PublicArm(
        "kuka_experimental", kuka(450, 150, 610, 20, 660, 80), LEVEL,
        ((-170, 170), (-185, 65), (-137, 163), (-185, 185), (-120, 120), (-350, 350)),
        (150, -20, 0, 450, 610, 660, 80), 1420,
    ),
    "KUKA KR 16-2": PublicArm(
        "kuka_experimental", kuka(675, 260, 680, -35, 670, 158), LEVEL,
        ((-185, 185), (-155, 35), (-130, 154), (-350, 350), (-130, 130), (-350, 350)),
        (260, 35, 0, 675, 680, 670, 158), 1611,
    ),
    "Fanuc M-10iA": PublicArm(
        "ros-industrial/fanuc", fanuc(450, 150, 600, 200, 640, 100), OVER,
        ((-180, 180), (-90, 160), (-180, 264), (-190, 190), (-190, 190), (-360, 360)),
        (150, -200, 0, 450, 600, 640, 100), 1420,
    ),
    "Fanuc LR Mate 200iD/7L": PublicArm(
        "ros-industrial/fanuc", fanuc(330, 50, 440, 35, 420, 80), OVER,
        ((-170, 170), (-100, 145), (-70, 213), (-190, 190), (-125, 125), (-360, 360)),
        (50, -35, 0, 330, 440, 420, 80), 911,
    ),
    "Yaskawa GP25": PublicArm(  # its tip is rounded at 1e-6, and its last joint stands in the wrist
        "ros-industrial/motoman",
        (*fanuc(505, 150, 760, 200, 795, 0)[:5], ((0, 0, 0), LEFT)), ((0.1, 0, 0), (3.1415926, -1.570796, 0)),
        ((-180, 180), (-105, 155), (-86, 160), (-200, 200), (-155, 150), (-455, 455)),
        (150, -200, 0, 505, 760, 795, 100), 1730,
    ),
    "Yaskawa MH5": PublicArm(  # no tip frame: the last link's x leaves the arm; frames slide along their axes
        "ros-industrial/motoman",
        (
            ((0, 0, 0.199), Z), ((0.088, 0, 0.131), Y), ((0, 0, 0.31), RIGHT), ((0.0715, 0, 0.0399), LEFT),
            ((0.2335, 0, 0), RIGHT), ((0.0865, 0, 0), LEFT),
        ),
        UPRIGHT, ((-170, 170), (-65, 150), (-58, 185), (-190, 190), (-125, 125), (-360, 360)),
        (88, -39.9, 0, 330, 310, 305, 86.5), 706,
    ),
    "Yaskawa MotoMini": PublicArm(  # the flange looks down at zero: joint 5 is bent there
        "ros-industrial/motoman",
        (
            ((0, 0, 0.103), Z), ((0.02, 0, 0), Y), ((0, 0, 0.165), RIGHT), ((0.165, 0, 0), LEFT), ((0, 0, 0), RIGHT),
            ((0, 0, 0), Z),
        ),
        ((0, 0, -0.04), (np.pi, 0, 0)),
        ((-170, 170), (-85, 90), (-50, 90), (-140, 140), (-30, 210), (-360, 360)),
        (20, 0, 0, 103, 165, 165, 40), 350,
    ),
    "Stäubli TX2-60": PublicArm(
        "ros-industrial/staubli_experimental", staubli(375, 0, 20, 290, 310, 70), UPRIGHT,
        ((-180, 180), (-127.5, 127.5), (-152.5, 152.5), (-270, 270), (-121, 132.5), (-270, 270)),
        (0, 0, 20, 375, 290, 310, 70), 600,
    ),
    "Stäubli TX2-90": PublicArm(
        "ros-industrial/staubli_experimental", staubli(478, 50, 50, 425, 425, 100), UPRIGHT,
        ((-180, 180), (-130, 147.5), (-145, 145), (-270, 270), (-115, 140), (-270, 270)),
        (50, 0, 50, 478, 425, 425, 100), 900,
    ),
    "Stäubli RX160": PublicArm(
        "ros-industrial/staubli", staubli(550, 150, 0, 825, 625, 110), UPRIGHT,
        ((-160, 160), (-137.5, 137.5), (-150, 150), (-270, 270), (-105, 120), (-270, 270)),
        (150, 0, 0, 550, 825, 625, 110), 1600,
    ),
    "ABB IRB 2400": PublicArm(  # its tip is rounded at 1e-11, and its frames slide along their axes
        "ros-industrial/abb",
        (
            ((0, 0, 0), Z), ((0.1, 0, 0.615), Y), ((0, 0, 0.705), Y), ((0.258, 0, 0.135), X), ((0.497, 0, 0), Y),
            ((0.085, 0, 0), X),
        ),
        ((0, 0, 0), (0, 1.57079632679, 0)),
        ((-180, 180), (-100, 110), (-60, 65), (-200, 200), (-120, 120), (-400, 400)),
        (100, -135, 0, 615, 705, 755, 85),
    ),
}  # fmt: skip


def urdf_of(arm: PublicArm, name: str = "arm", bodies: bool = False) -> str:
    """The URDF of an arm, with links named as ros-industrial does; with bodies: slim ones along its links."""
    links = ["base_link", *(f"link_{k}" for k in range(1, 7)), "tool0"]
    lines = [f'<robot name="{name}">']
    ends = [(0.0, 0.0, 0.0) if k == 0 else arm.rows[k][0] for k in range(6)]
    for k, link in enumerate(links):
        body = _rod(ends[k], 0.02) if bodies and 0 < k < 6 else ""
        lines.append(f'  <link name="{link}">{body}</link>')
    for k, ((xyz, axis), (low, high)) in enumerate(zip(arm.rows, arm.ranges, strict=True), 1):
        lines += [
            f'  <joint name="joint_{k}" type="revolute">',
            f'    <parent link="{links[k - 1]}"/><child link="{links[k]}"/>',
            f'    <origin xyz="{_text(xyz)}"/><axis xyz="{_text(axis)}"/>',
            f'    <limit lower="{float(np.radians(low))!r}" upper="{float(np.radians(high))!r}" velocity="{3.0 + k}" effort="0"/>',
            "  </joint>",
        ]
    xyz, rpy = arm.tip
    lines += [
        '  <joint name="flange" type="fixed"><parent link="link_6"/><child link="tool0"/>',
        f'    <origin xyz="{_text(xyz)}" rpy="{_text(rpy)}"/></joint>',
        "</robot>",
    ]
    return "\n".join(lines) + "\n"


def _rod(end: tuple[float, float, float], radius: float) -> str:
    """A box along the way to the next joint, shortened at both ends."""
    size = [max(abs(value) - 0.08, 2 * radius) for value in end]
    return (
        f'<collision><origin xyz="{_text([0.5 * value for value in end])}"/>'
        f'<geometry><box size="{_text(size)}"/></geometry></collision>'
    )


def _text(values: object) -> str:
    return " ".join(f"{float(value)!r}" for value in values)  # type: ignore[attr-defined]
