"""Simple shapes of the robots that are drawn here: boxes, cylinders and balls at true size, a handful a link [mm].

Lengths along an arm are its maker's. How thick its links are is ASSUMED: no maker publishes it as numbers. Those of the
UR e-Series are the widths of the CB series' meshes in the package example-robot-data, their offsets those of the
maker's own description of the arm.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import hypot, pi

Point = tuple[float, float, float]
ALONG = {"x": f"0 {pi / 2!r} 0", "y": f"{-pi / 2!r} 0 0", "z": ""}  # rpy that turns a cylinder's z there


@dataclass(frozen=True)
class Shape:
    """A box (size x, y, z), a cylinder (radius, length) along an axis, or a ball (radius), by the middle of it [mm]."""

    name: str
    middle: Point
    size: tuple[float, ...]
    axis: str = "z"

    def urdf(self) -> list[str]:
        """Lines of a collision shape and of the same to be seen."""
        sizes = [f"{value / 1000:g}" for value in self.size]
        if len(sizes) == 3:
            shape = f'<box size="{" ".join(sizes)}"/>'
        elif len(sizes) == 2:
            shape = f'<cylinder radius="{sizes[0]}" length="{sizes[1]}"/>'
        else:
            shape = f'<sphere radius="{sizes[0]}"/>'
        xyz = " ".join(f"{value / 1000:g}" for value in self.middle)
        rpy = f' rpy="{ALONG[self.axis]}"' if ALONG[self.axis] else ""
        inside = f'<origin xyz="{xyz}"{rpy}/><geometry>{shape}</geometry>'
        return [f'    <{tag} name="{self.name}">{inside}</{tag}>' for tag in ("collision", "visual")]


Links = list[list[Shape]]  # base_link first


def box(name: str, low: Point, high: Point) -> Shape:
    """A box between two corners."""
    x, y, z = ((a + b) / 2 for a, b in zip(low, high, strict=True))
    return Shape(name, (x, y, z), tuple(b - a for a, b in zip(low, high, strict=True)))


def cylinder(name: str, radius: float, start: Point, length: float, axis: str = "z") -> Shape:
    """A cylinder along an axis from the middle of its lower end."""
    x, y, z = (at + (0.5 * length if axis == name_ else 0.0) for at, name_ in zip(start, "xyz", strict=True))
    return Shape(name, (x, y, z), (radius, length), axis)


@dataclass(frozen=True)
class AbbWidths:
    """How thick an ABB arm is [mm]; all of it assumed.

    foot      how far its base reaches before and behind axis 1, its width and height
    turret    radius of what turns above it
    shoulder  radius about axis 2, and length along it
    upper     upper arm, along x and along y
    housing   of the forearm's motors: half its height, its length behind axis 3 and before it
    forearm, wrist, flange   radii
    """

    foot: tuple[float, float, float, float]
    turret: float
    shoulder: tuple[float, float]
    upper: tuple[float, float]
    housing: tuple[float, float, float]
    forearm: float
    wrist: float
    flange: float


ABB_WIDTHS = {
    "irb140": AbbWidths((200, 200, 450, 95), 140, (100, 250), (100, 120), (65, 130, 180), 45, 38, 40),
    "irb1600_12": AbbWidths((242, 406, 484, 120), 200, (140, 330), (140, 150), (90, 230, 270), 58, 42, 42),
    "irb1600_145": AbbWidths((242, 406, 484, 120), 200, (140, 330), (140, 150), (90, 230, 340), 58, 42, 42),
    "irb1200_09": AbbWidths((105, 105, 210, 80), 95, (88, 190), (110, 130), (62, 110, 200), 42, 38, 32),
    "irb1200_07": AbbWidths((105, 105, 210, 80), 95, (88, 190), (110, 130), (62, 110, 200), 42, 38, 32),
    "irb2600": AbbWidths((220, 456, 511, 100), 195, (165, 380), (170, 180), (105, 260, 330), 65, 52, 50),
    "irb6640": AbbWidths((360, 600, 760, 150), 350, (300, 640), (280, 260), (180, 420, 480), 170, 140, 160),
}
DISC = 22.0  # thickness of a flange, with room for the round end of a print head on it
FORK = 12.0  # thickness of the two plates that hold an ABB wrist
ROOM = 6.0  # between what turns about axis 5 and the forearm behind it
GAP = 3.0  # between the wrist and those plates


def abb_shapes(key: str, lengths: tuple[float, ...]) -> Links:
    """Shapes of an ABB arm by its OPW lengths, in frames that are all upright at zero."""
    a1, a2, b, c1, c2, c3, c4 = lengths
    w = ABB_WIDTHS[key]
    front, behind, width, height = w.foot
    half, rear, fore = w.housing
    waist = height + 0.15 * (c1 - height)
    # the disc's edge passes the forearm's end at this distance from axis 5
    free = hypot(c4, w.flange) + ROOM
    plate = max(w.wrist, w.flange) + GAP
    tall = 0.7 * w.wrist
    return [
        [
            box("foot", (-behind, -0.5 * width, 0), (front, 0.5 * width, height)),
            cylinder("column", w.turret, (0, 0, height), waist - height),
        ],
        [
            cylinder("turret", w.turret, (0, 0, waist - c1), c1 - waist),
            cylinder("shoulder", w.shoulder[0], (a1, b - 0.5 * w.shoulder[1], 0), w.shoulder[1], "y"),
        ],
        [
            box(
                "upper arm",
                (-0.5 * w.upper[0], -0.5 * w.upper[1], -0.5 * w.upper[0]),
                (0.5 * w.upper[0], 0.5 * w.upper[1], c2 + 0.5 * w.upper[0]),
            )
        ],
        [
            box("elbow", (-rear, -half, -a2 - half), (min(fore, c3 - free), half, -a2 + half)),
            *([cylinder("elbow joint", half, (0, -half, 0), 2 * half, "y")] if a2 else []),
        ],
        [
            cylinder("forearm", w.forearm, (fore - 10, 0, 0), c3 - free - fore + 10, "x"),
            *(
                box(f"fork {side}", (c3 - free - 5, y, -tall), (c3 + 0.5 * tall, y + FORK, tall))
                for side, y in (("left", plate), ("right", -plate - FORK))
            ),
        ],
        [
            cylinder("wrist joint", tall, (0, -plate, 0), 2 * plate, "y"),
            cylinder("wrist", w.wrist, (0, 0, 0), c4 - DISC, "x"),
        ],
        [cylinder("flange", w.flange, (-DISC, 0, 0), DISC, "x")],
        [],
    ]


@dataclass(frozen=True)
class UrWidths:
    """How thick a UR arm is [mm]: radii of base, shoulder, tubes, elbow and wrists; how far the upper arm's and the
    forearm's tubes stand beside axis 1, along axes 2 and 3."""

    base: float
    shoulder: float
    upper: float
    elbow: float
    forearm: float
    wrist: float
    beside: tuple[float, float]


UR_WIDTHS = {
    "ur3e": UrWidths(64, 46, 35, 38, 32, 32, (120, 27)),
    "ur5e": UrWidths(75, 60, 51, 58, 38, 39, (138, 7)),
    "ur10e": UrWidths(75, 75, 54, 60, 43, 46, (176.2, 39.3)),
    "ur16e": UrWidths(75, 75, 54, 60, 43, 46, (176, 40)),
}


COLLAR = 15.0  # between the base and what passes above it


def ur_shapes(key: str, d1: float, a2: float, a3: float, d4: float, d5: float, d6: float) -> Links:
    """Shapes of a UR arm by its Denavit-Hartenberg table; axes 2 to 4 are the z of their links, tubes lie along -x."""
    w = UR_WIDTHS[key]
    upper, fore = w.beside
    between = 0.5 * (upper - w.upper + fore + w.forearm)  # where the two halves of the elbow meet
    return [
        [cylinder("base", w.base, (0, 0, 0), d1 - w.shoulder - COLLAR)],
        [
            cylinder("shoulder", w.shoulder, (0, 0, d1 - w.shoulder - COLLAR), 2 * w.shoulder + COLLAR),
            cylinder("shoulder joint", w.shoulder, (0, w.shoulder - upper, d1), upper - w.shoulder, "y"),
        ],
        [
            cylinder("shoulder cap", w.shoulder, (0, 0, upper - w.shoulder), 2 * w.shoulder),
            cylinder("upper arm", w.upper, (a2, 0, upper), -a2, "x"),
            cylinder("elbow cap", w.elbow, (a2, 0, between), upper + w.elbow - between),
        ],
        [
            cylinder("elbow", w.elbow, (0, 0, fore - w.forearm), between - fore + w.forearm),
            cylinder("forearm", w.forearm, (a3, 0, fore), -a3, "x"),
            cylinder("forearm end", w.wrist, (a3, 0, fore - w.wrist), 2 * w.wrist),
        ],
        [cylinder("wrist 1", w.wrist, (0, 0, fore + w.wrist), d4 - fore)],
        [cylinder("wrist 2", w.wrist, (0, 0, -w.wrist), d5 + 2 * w.wrist)],
        [cylinder("wrist 3", w.wrist - 1, (0, 0, w.wrist), d6 - w.wrist)],
        [],
    ]


# LBR iiwa 14 R820 [mm]: radii of its foot, of the lower links, of the upper links, of wrist and flange
IIWA_RADII = (110, 78, 68, 60, 45)


def iiwa_shapes(shoulder: float, elbow: float, wrist: float, flange: float) -> Links:
    """Shapes of the iiwa by the heights [mm] of its joints' centres, each above the one before; upright at zero."""
    foot, low, high, end, disc = IIWA_RADII
    start = 0.42 * shoulder  # where link 1 begins; the others begin half-way
    return [
        [cylinder("foot", foot, (0, 0, 0), start)],
        [cylinder("link 1", low, (0, 0, start - shoulder), shoulder - start), Shape("shoulder", (0, 0, 0), (low + 8,))],
        [Shape("shoulder joint", (0, 0, 0), (low + 4,)), cylinder("link 2", low, (0, 0, 0), 0.5 * elbow)],
        [cylinder("link 3", low, (0, 0, -0.5 * elbow), 0.5 * elbow), Shape("elbow", (0, 0, 0), (low + 4,))],
        [Shape("elbow joint", (0, 0, 0), (high + 4,)), cylinder("link 4", high, (0, 0, 0), 0.5 * wrist)],
        [cylinder("link 5", end, (0, 0, -0.5 * wrist), 0.5 * wrist - 2.3 * disc), *_cheeks(end, disc)],
        [Shape("wrist", (0, 0, 0), (end,))],
        [
            cylinder("neck", 0.6 * disc, (0, 0, 0.4 * flange), 0.2 * flange),
            cylinder("flange", disc, (0, 0, 0.6 * flange), 0.4 * flange),
        ],
        [],
    ]


def _cheeks(end: float, disc: float) -> list[Shape]:
    return [
        box(f"cheek {side}", (-0.6 * end, y, -2.3 * disc), (0.6 * end, y + 18, 0.5 * end))
        for side, y in (("left", end - 18), ("right", -end))
    ]


# IRBP A250 [mm], in its base's frame, whose origin is on the floor below the plate; all assumed but the two heights.
PLATE = (125, 25)  # radius and thickness
GEAR = (105, 230)  # radius of the housing under the plate, and how far below the tilt axis its lower end is
BESIDE = 520  # from the plate's axis to the cradle's arm, beside the part: parts of 1 m across turn
TILT, DOWN = 1020, 120  # height of the tilt axis above the floor, and of the plate's top below that axis


def a250_shapes() -> Links:
    """Shapes of the positioner: a column at -y, an L-shaped cradle that it tilts about y, and the plate."""
    thick, arm, beam = PLATE[1], 110, 100
    low = -GEAR[1] - beam
    return [
        [
            box("foot", (-350, -1000, 0), (350, -BESIDE - arm - 30, 60)),
            box("column", (-200, -960, 60), (200, -BESIDE - arm - 30, TILT + 160)),
        ],
        [
            cylinder("tilt joint", 110, (0, -BESIDE - arm - 30, 0), 30 + 0.5 * arm, "y"),
            box("cradle arm", (-100, -BESIDE - arm, low), (100, -BESIDE, 110)),
            box("cradle beam", (-100, -BESIDE, low), (100, GEAR[0], -GEAR[1])),
            cylinder("gear", GEAR[0], (0, 0, -GEAR[1]), GEAR[1] - DOWN - thick),
        ],
        [cylinder("plate", PLATE[0], (0, 0, -thick), thick)],
    ]


TRACK = 3000.0  # how far the carriage goes
BEAM, ON_TRACK = 180.0, 300.0  # heights above the floor: of the beam that it runs on, and of the arm's foot


def track_shapes() -> Links:
    """Shapes of a linear track along x: a beam on the floor that is longer than the way of its carriage, and that."""
    plate, half = 60.0, 350.0
    low, top = 30.0, ON_TRACK - BEAM
    return [
        [box("beam", (-half - 100, -220, 0), (TRACK + half + 100, 220, BEAM))],
        [
            box("runners", (-half, -180, 0), (half, 180, low)),
            box("saddle", (-half, -260, low), (half, 260, top - plate)),
            box("plate", (-half, -half, top - plate), (half, half, top)),
        ],
        [],
    ]


# A gantry

GANTRY = (3000.0, 2000.0)  # ranges along x and y
GANTRY_HEIGHT = 2200.0  # of the beams that its bridge runs on
BEAMS_APART = 500.0  # how far these stand beyond the ranges
HANGS = 120.0  # below these: the arm's foot


def gantry_shapes() -> Links:
    """Shapes of a gantry: beams along x on posts, a bridge along y on them, and under it a trolley that the arm hangs from."""
    (along, across), post, beam, apart = GANTRY, 160.0, 200.0, BEAMS_APART
    frame = []
    for side, y in (("right", -apart), ("left", across + apart)):
        low, high = (-apart, y - 100, GANTRY_HEIGHT - beam), (along + apart, y + 100, GANTRY_HEIGHT)
        frame.append(box(f"{side} beam", low, high))
        for end, x in (("back", -apart), ("front", along + apart - post)):
            frame.append(
                box(f"{side} {end} post", (x, y - post / 2, 0), (x + post, y + post / 2, GANTRY_HEIGHT - beam))
            )
    return [
        frame,
        [box("bridge", (-200, -100, 0), (200, across + 2 * apart + 100, 250))],
        [box("trolley", (-250, -250, -HANGS), (250, 250, 0))],
        [],
    ]
