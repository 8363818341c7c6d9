"""Write the URDF and YAML files of the robots that are drawn from their makers' data: python robots/draw_urdf.py."""

from __future__ import annotations

from dataclasses import dataclass
from math import pi, radians
from pathlib import Path

from draw_bodies import (
    BEAM,
    BEAMS_APART,
    DOWN,
    GANTRY,
    GANTRY_HEIGHT,
    HANGS,
    ON_TRACK,
    TILT,
    TRACK,
    Links,
    Shape,
    a250_shapes,
    abb_shapes,
    gantry_shapes,
    iiwa_shapes,
    track_shapes,
    ur_shapes,
)

HERE = Path(__file__).resolve().parent
ABB_ACCELERATION = (15, 15, 15, 25, 25, 30)
JERK_TIME = 50  # 1/s: full acceleration is reached in 20 ms
WIDTHS = "Shapes: lengths along the arm are the maker's; how thick links are is ASSUMED (robots/draw_bodies.py)."


@dataclass(frozen=True)
class Abb:
    """An arm with a spherical wrist: OPW lengths [mm], ranges [deg] and speeds [deg/s] of its product specification."""

    name: str
    lengths: tuple[float, ...]  # a1 a2 b c1 c2 c3 c4
    ranges: tuple[tuple[float, float], ...]
    speeds: tuple[float, ...]
    assumed: tuple[str, ...] = ()  # of these: what the product specification was not at hand for
    colour: str = "#f26a21"  # the maker's orange
    recorded: tuple[tuple[float, ...], tuple[float, ...]] | None = None  # accelerations [rad/s^2] and jerks [rad/s^3]


WRIST_140 = ((-200, 200), (-115, 115), (-400, 400))
WRIST_1200 = ((-270, 270), (-130, 130), (-360, 360))
SPEEDS_1200 = (288, 240, 300, 400, 405, 600)
ABB = {
    "irb140": Abb(
        "ABB IRB 140-6/0.8",
        (70, 0, 0, 352, 360, 380, 65),
        ((-180, 180), (-90, 110), (-230, 50), *WRIST_140),
        (200, 200, 260, 360, 360, 450),
    ),
    "irb1600_12": Abb(
        "ABB IRB 1600-x/1.2",
        (150, 0, 0, 486.5, 475, 600, 65),
        ((-180, 180), (-63, 110), (-235, 55), *WRIST_140),
        (150, 160, 170, 320, 400, 460),
    ),
    "irb1600_145": Abb(
        "ABB IRB 1600-x/1.45",
        (150, 0, 0, 486.5, 700, 600, 65),
        ((-180, 180), (-90, 120), (-245, 65), *WRIST_140),
        (180, 180, 185, 385, 400, 460),
    ),
    "irb1200_09": Abb(
        "ABB IRB 1200-5/0.9",
        (0, -42, 0, 399.1, 448, 451, 82),
        ((-170, 170), (-100, 130), (-200, 70), *WRIST_1200),
        SPEEDS_1200,
        colour="#e6e6e1",
    ),
    "irb1200_07": Abb(
        "ABB IRB 1200-7/0.7",
        (0, -42, 0, 399.1, 350, 351, 82),
        ((-170, 170), (-100, 135), (-200, 70), *WRIST_1200),
        SPEEDS_1200,
        colour="#e6e6e1",
    ),
    "irb2600": Abb(
        "ABB IRB 2600-20/1.65",
        (150, -115, 0, 445, 700, 795, 85),
        ((-180, 180), (-95, 155), (-180, 75), (-400, 400), (-120, 120), (-400, 400)),
        (175, 175, 175, 360, 360, 500),
        assumed=("ranges", "speeds"),
    ),
    "irb6640": Abb(
        "ABB IRB 6640-180/2.55",
        (320, -200, 0, 780, 1075, 1142.5, 200),
        ((-170, 170), (-65, 85), (-180, 70), (-300, 300), (-120, 120), (-360, 360)),
        (100, 90, 90, 190, 140, 190),
        assumed=("ranges", "speeds"),
        recorded=((10, 8.7, 12, 20, 18, 17), (180, 180, 180, 400, 400, 400)),
    ),
}


@dataclass(frozen=True)
class Ur:
    """An arm of Universal Robots' e-Series: lengths [mm] of the maker's Denavit-Hartenberg table, speeds [deg/s]."""

    name: str
    d1: float
    a2: float
    a3: float
    d4: float
    d5: float
    d6: float
    speeds: tuple[float, ...]


UR_SPEEDS = {5: (180,) * 6, 3: (180, 180, 180, 360, 360, 360), 10: (120, 120, 180, 180, 180, 180)}
UR_RANGES = ((-360, 360), (-360, 360), (-180, 180), (-360, 360), (-360, 360), (-360, 360))
UR_JOINTS = (
    "shoulder_pan_joint",
    "shoulder_lift_joint",
    "elbow_joint",
    "wrist_1_joint",
    "wrist_2_joint",
    "wrist_3_joint",
)
UR = {
    "ur3e": Ur("Universal Robots UR3e", 151.85, -243.55, -213.2, 131.05, 85.35, 92.1, UR_SPEEDS[3]),
    "ur5e": Ur("Universal Robots UR5e", 162.5, -425, -392.2, 133.3, 99.7, 99.6, UR_SPEEDS[5]),
    "ur10e": Ur("Universal Robots UR10e", 180.7, -612.7, -571.55, 174.15, 119.85, 116.55, UR_SPEEDS[10]),
    "ur16e": Ur("Universal Robots UR16e", 180.7, -478.4, -360, 174.15, 119.85, 116.55, UR_SPEEDS[10]),
}
TRACK_SPEED = 1.5  # m/s
GANTRY_SPEED = 1.0  # m/s
IIWA_RANGES = (170, 120, 170, 120, 170, 120, 175)
IIWA_SPEEDS = (85, 85, 100, 75, 130, 135, 135)


def urdf(
    key: str,
    comment: str,
    joints: list[tuple[tuple[float, ...], str]],
    ranges: tuple[tuple[float, float], ...],
    speeds: tuple[float, ...],
    flange: str,
    shapes: Links,
    names: tuple[str, ...] = (),
) -> str:
    """Text of a URDF: joints by their origin in the link before [mm, and rad after a blank] and axis, then the
    origin of tool0; shapes of all links; names of the joints, if not joint_1 and so on."""
    n = len(joints)
    names = names or tuple(f"joint_{i}" for i in range(1, n + 1))
    lines = ['<?xml version="1.0"?>', f"<!-- {comment} -->", f"<!-- {WIDTHS} -->", f'<robot name="{key}">']
    links = ("base_link", *(f"link_{i}" for i in range(1, n + 1)), "tool0")
    lines += [line for link, own in zip(links, shapes, strict=True) for line in link_lines(link, own)]
    for i, ((origin, axis), range_, speed) in enumerate(zip(joints, ranges, speeds, strict=True), 1):
        lines += joint_lines(names[i - 1], links[i - 1], links[i], origin, axis, range_, speed)
    lines += [
        '  <joint name="flange" type="fixed">',
        f'    <parent link="link_{n}"/><child link="tool0"/>',
        f"    <origin {flange}/>",
        "  </joint>",
        "</robot>",
    ]
    return "\n".join(lines) + "\n"


def joint_lines(
    name: str,
    parent: str,
    child: str,
    origin: tuple[float, ...],
    axis: str,
    range_: tuple[float, float],
    speed: float,
) -> list[str]:
    """Lines of a revolute joint; origin in mm, and rad after a blank, range in deg, speed in deg/s."""
    xyz = " ".join(f"{value / 1000:g}" for value in origin[:3])
    rpy = f' rpy="{" ".join(map(repr, origin[3:]))}"' if len(origin) > 3 else ""
    low, high = map(radians, range_)
    return [
        f'  <joint name="{name}" type="revolute">',
        f'    <parent link="{parent}"/><child link="{child}"/>',
        f'    <origin xyz="{xyz}"{rpy}/><axis xyz="{axis}"/>',
        f'    <limit lower="{low}" upper="{high}" velocity="{radians(speed)}" effort="0"/>',
        "  </joint>",
    ]


def link_lines(name: str, shapes: list[Shape]) -> list[str]:
    """Lines of a link with its shapes."""
    if not shapes:
        return [f'  <link name="{name}"/>']
    return [f'  <link name="{name}">', *(line for shape in shapes for line in shape.urdf()), "  </link>"]


def abb_urdf(key: str) -> str:
    """URDF of an ABB arm: z up, x forwards, all joints 0 with the upper arm vertical and the forearm horizontal."""
    arm = ABB[key]
    a1, a2, b, c1, c2, c3, c4 = arm.lengths
    x, y, z = "1 0 0", "0 1 0", "0 0 1"
    joints: list[tuple[tuple[float, ...], str]] = [
        ((0, 0, c1), z),
        ((a1, b, 0), y),
        ((0, 0, c2), y),
        ((0, 0, -a2), x),
        ((c3, 0, 0), y),
        ((c4, 0, 0), x),
    ]
    shapes = abb_shapes(key, arm.lengths)
    comment = f"{arm.name}. At zero the upper arm is vertical, the forearm horizontal forwards."
    return urdf(key, comment, joints, arm.ranges, arm.speeds, f'xyz="0 0 0" rpy="0 {radians(90)} 0"', shapes)


# Editors complete and check the file by it.
SCHEMA_LINE = "# yaml-language-server: $schema=../docs/robot.schema.json"


def abb_yaml(key: str) -> str:
    """The YAML file beside that URDF."""
    arm = ABB[key]
    names = ("a1", "a2", "b", "c1", "c2", "c3", "c4")
    lengths = ", ".join(f"{name}_mm: {value:g}" for name, value in zip(names, arm.lengths, strict=True))
    given = "Lengths" if arm.assumed else "Lengths and ranges"
    return f"""\
{SCHEMA_LINE}
# {arm.name}. {given}: ABB product specification (as in the URDF beside this file).
# Ranges and speeds of the joints stand in the URDF; what a URDF cannot say stands here.
name: {arm.name}
language: rapid
urdf: {key}.urdf
tip: tool0
spherical_wrist: {{{lengths}}}
colours: {{others: "{arm.colour}", caps: "#50575f", flange: "#8b929a"}}
{_abb_dynamics(arm)}"""


def _abb_dynamics(arm: Abb) -> str:
    """Lines on what is assumed, and on acceleration and jerk: as recorded where they were, else assumed."""
    unsure = f"# ASSUMED as well: {' and '.join(arm.assumed)} are commonly cited ones.\n" if arm.assumed else ""
    if arm.recorded is not None:
        acceleration, jerk = arm.recorded
        unsure = f"# ASSUMED: {' and '.join(arm.assumed)} are commonly cited ones.\n" if arm.assumed else ""
        head = (
            "# Lengths agree with recorded joints and tips to 0.002 mm. Acceleration and jerk are the most that public\n"
            f"# recordings of this arm use, so they are lower bounds (docs/controller_model.md).\n{unsure}"
        )
        assumed: tuple[str, ...] = (*arm.assumed, "thickness of links")
    else:
        acceleration, jerk = ABB_ACCELERATION, tuple(JERK_TIME * value for value in ABB_ACCELERATION)
        head = (
            "# ASSUMED: ABB does not publish acceleration and jerk; yours belong into the problem file (cell.limits).\n"
            f"{unsure}"
        )
        assumed = ("acceleration_rad_s2", "jerk_rad_s3", *arm.assumed, "thickness of links")
    return f"""\
{head}assumed: [{", ".join(assumed)}]
acceleration_rad_s2: {list(acceleration)}
jerk_rad_s3: {list(jerk)}
"""


def ur_urdf(key: str) -> str:
    """URDF of an e-Series arm by its Denavit-Hartenberg table; base_link is the controller's base."""
    arm = UR[key]
    right = radians(90)
    before = (
        (0, 0, 0),
        (0, 0, arm.d1, right),
        (arm.a2, 0, 0),
        (arm.a3, 0, 0),
        (0, 0, arm.d4, right),
        (0, 0, arm.d5, -right),
    )
    joints = [((*place, 0, 0) if len(place) > 3 else place, "0 0 1") for place in before]
    comment = f"{arm.name}. base_link is the controller's base; at zero the arm lies stretched out along its -x."
    shapes = ur_shapes(key, arm.d1, arm.a2, arm.a3, arm.d4, arm.d5, arm.d6)
    return urdf(key, comment, joints, UR_RANGES, arm.speeds, f'xyz="0 0 {arm.d6 / 1000:g}"', shapes, UR_JOINTS)


def ur_yaml(key: str) -> str:
    """The YAML file beside that URDF."""
    acceleration = [10, 10, 10, 15, 15, 15]
    return f"""\
{SCHEMA_LINE}
# {UR[key].name}. Lengths, ranges and speeds: the maker's tables (as in the URDF beside this file). Yours was
# calibrated: its own URDF is more exact by some millimetres.
name: {UR[key].name}
language: urscript
urdf: {key}.urdf
tip: tool0
inverse_kinematics: offset_wrist
colours: {{others: "#cfd3d7", caps: "#6ca6cd", base: "#9aa1a8", wrist 3: "#9aa1a8"}}
# ASSUMED: nobody publishes acceleration and jerk; yours belong into the problem file (cell.limits).
assumed: [acceleration_rad_s2, jerk_rad_s3, thickness of links]
acceleration_rad_s2: {acceleration}
jerk_rad_s3: {[JERK_TIME * value for value in acceleration]}
"""


def iiwa_urdf() -> str:
    """URDF of KUKA's LBR iiwa 14 R820, straight up at zero; the tip is the flange of the robot without a media flange."""
    axes = ("0 0 1", "0 1 0", "0 0 1", "0 -1 0", "0 0 1", "0 1 0", "0 0 1")
    up = (360, 0, 420, 0, 400, 0, 0)
    joints: list[tuple[tuple[float, ...], str]] = [((0, 0, z), axis) for z, axis in zip(up, axes, strict=True)]
    ranges = tuple((-value, value) for value in IIWA_RANGES)
    comment = "KUKA LBR iiwa 14 R820. At zero the arm stands straight up."
    return urdf("iiwa", comment, joints, ranges, IIWA_SPEEDS, 'xyz="0 0 0.126"', iiwa_shapes(360, 420, 400, 126))


def a250_urdf() -> str:
    """URDF of ABB's positioner IRBP A250; its base's frame stands on the floor below the plate."""
    links = ("positioner_base", "cradle", "plate")
    lines = [
        '<?xml version="1.0"?>',
        "<!-- ABB IRBP A250. Tilt axis horizontal, 1,020 mm above the floor; the plate lies 120 mm below it at tilt 0. -->",
        "<!-- Shapes: those two heights are the maker's; all else is ASSUMED (robots/draw_bodies.py). -->",
        '<robot name="irbp_a250">',
        *(line for link, own in zip(links, a250_shapes(), strict=True) for line in link_lines(link, own)),
        *joint_lines("tilt", links[0], links[1], (0, 0, TILT), "0 1 0", (-181, 181), 150),
        "  <!-- The rotation is continuous; the range is that of a revolution counter, ASSUMED to hold 100 turns. -->",
        *joint_lines("rotation", links[1], links[2], (0, 0, -DOWN), "0 0 1", (-36000, 36000), 180),
        "</robot>",
    ]
    return "\n".join(lines) + "\n"


def track_urdf() -> str:
    """URDF of a generic linear track of 3 m: a carriage that slides along x, and on it the place of the arm's foot."""
    links = ("floor", "carriage", "arm_place")
    lines = [
        '<?xml version="1.0"?>',
        "<!-- A generic linear track of 3 m along x. All of it is ASSUMED, after tracks for arms of this size: no data",
        "     sheet stands behind it (robots/draw_bodies.py). -->",
        '<robot name="track_3m">',
        *(line for link, own in zip(links, track_shapes(), strict=True) for line in link_lines(link, own)),
        '  <joint name="rail" type="prismatic">',
        f'    <parent link="{links[0]}"/><child link="{links[1]}"/>',
        f'    <origin xyz="0 0 {BEAM / 1000:g}"/><axis xyz="1 0 0"/>',
        f'    <limit lower="0" upper="{TRACK / 1000:g}" velocity="{TRACK_SPEED:g}" effort="0"/>',
        "  </joint>",
        '  <joint name="top" type="fixed">',
        f'    <parent link="{links[1]}"/><child link="{links[2]}"/>',
        f'    <origin xyz="0 0 {(ON_TRACK - BEAM) / 1000:g}"/>',
        "  </joint>",
        "</robot>",
    ]
    return "\n".join(lines) + "\n"


def gantry_urdf() -> str:
    """URDF of a generic gantry: a bridge that slides along x, on it a trolley that slides along y, and the place under it
    where an arm's foot hangs."""
    links = ("frame", "bridge", "trolley", "arm_place")
    along, across, apart, height = (length / 1000 for length in (*GANTRY, BEAMS_APART, GANTRY_HEIGHT))
    lines = [
        '<?xml version="1.0"?>',
        "<!-- A generic gantry over a floor of 3 by 2 m, from which an arm hangs. All of it is ASSUMED: no data sheet stands",
        "     behind it (robots/draw_bodies.py). -->",
        '<robot name="gantry_xy">',
        *(line for link, own in zip(links, gantry_shapes(), strict=True) for line in link_lines(link, own)),
    ]
    for i, (name, at, axis, length) in enumerate(
        (("x", f"0 {-apart:g} {height:g}", "1 0 0", along), ("y", f"0 {apart:g} 0", "0 1 0", across))
    ):
        lines += [
            f'  <joint name="gantry_{name}" type="prismatic">',
            f'    <parent link="{links[i]}"/><child link="{links[i + 1]}"/>',
            f'    <origin xyz="{at}"/><axis xyz="{axis}"/>',
            f'    <limit lower="0" upper="{length:g}" velocity="{GANTRY_SPEED:g}" effort="0"/>',
            "  </joint>",
        ]
    lines += [
        '  <joint name="hang" type="fixed">',
        f'    <parent link="{links[2]}"/><child link="{links[3]}"/>',
        f'    <origin xyz="0 0 {-HANGS / 1000:g}" rpy="{pi} 0 0"/>',
        "  </joint>",
        "</robot>",
    ]
    return "\n".join(lines) + "\n"


def files() -> dict[str, str]:
    """Texts of all files that are written here, by file name."""
    texts = {"iiwa.urdf": iiwa_urdf(), "irbp_a250.urdf": a250_urdf(), "track_3m.urdf": track_urdf()}
    texts["gantry_xy.urdf"] = gantry_urdf()
    for key in UR:
        texts |= {f"{key}.urdf": ur_urdf(key), f"{key}.yaml": ur_yaml(key)}
    for key in ABB:
        texts |= {f"{key}.urdf": abb_urdf(key), f"{key}.yaml": abb_yaml(key)}
    return texts


if __name__ == "__main__":
    for name, text in files().items():
        (HERE / name).write_text(text, encoding="utf-8")
