"""Robots from URDF files: their bodies against Pinocchio's own reading, and what is wrong with files, told by joint."""

from __future__ import annotations

import re
from pathlib import Path

import coal
import numpy as np
import pinocchio as pin
import pytest

from planner.base.arrays import Array
from planner.base.errors import InputError
from planner.base.shipped import ROBOTS
from planner.cell.robot import read_robot
from planner.cell.solids import Body, Box, Capsule, Frustum, Hull, triangles_of
from planner.cell.urdf import read_urdf

SHARE = Path(coal.__file__).resolve().parents[4] / "share"

YAML = """\
name: Own arm
urdf: own.urdf
tip: tool
acceleration_rad_s2: [10, 10]
jerk_rad_s3: [500, 500]
"""
URDF = """\
<robot name="own">
  <link name="base">
    <collision name="foot"><origin xyz="0 0 0.1"/><geometry><cylinder radius="0.1" length="0.2"/></geometry></collision>
  </link>
  <link name="arm">
    <collision><origin xyz="0.1 0 0" rpy="0 1.5 0.2"/><geometry><box size="0.1 0.2 0.3"/></geometry></collision>
    <collision name="cap"><geometry><sphere radius="0.07"/></geometry></collision>
  </link>
  <link name="hand">
    <collision><origin rpy="0.3 0 0"/><geometry><mesh filename="hand.stl" scale="0.001 0.001 0.002"/></geometry></collision>
  </link>
  <link name="tool"/>
  <link name="finger">
    <collision><geometry><capsule radius="0.01" length="0.05"/></geometry></collision>
  </link>
  <joint name="turn" type="revolute">
    <parent link="base"/><child link="arm"/><origin xyz="0 0 0.3" rpy="0 0.4 0"/><axis xyz="0 0 2"/>
    <limit lower="-1" upper="2" velocity="3" effort="0"/>
  </joint>
  <joint name="wrist" type="continuous">
    <parent link="arm"/><child link="hand"/><origin xyz="0.4 0 0"/><axis xyz="1 0 0"/>
    <limit velocity="2" effort="0"/>
  </joint>
  <joint name="flange" type="fixed"><parent link="hand"/><child link="tool"/><origin xyz="0.1 0 0"/></joint>
  <joint name="slide" type="prismatic">
    <parent link="tool"/><child link="finger"/><origin xyz="0.02 0 0.1"/><axis xyz="0 1 0"/>
    <limit lower="0" upper="0.1" velocity="1" effort="0"/>
  </joint>
</robot>
"""
RANGE = "range_deg: {wrist: [-400, 300]}\n"
STL = """\
solid hand
facet normal 0 0 1
outer loop
vertex 0 0 0
vertex 50 0 0
vertex 0 60 0
endloop
endfacet
facet normal 0 0 1
outer loop
vertex 0 0 0
vertex 50 0 0
vertex 0 0 70
endloop
endfacet
endsolid
"""


def write(folder: Path, urdf: str = URDF, yaml: str = YAML + RANGE, stl: str = STL) -> Path:
    (folder / "own.urdf").write_text(urdf, encoding="utf-8")
    (folder / "hand.stl").write_text(stl, encoding="utf-8")
    (folder / "own.yaml").write_text(yaml, encoding="utf-8")
    return folder / "own.yaml"


def placed(body: Body, T: Array) -> Array:
    vertices = triangles_of(body.solid)[0]
    place = T @ body.T_frame_solid
    return np.asarray(vertices @ place[:3, :3].T + place[:3, 3])


# --- bodies -----------------------------------------------------------------------------------------------------


def test_every_shape_is_read_where_it_stands(tmp_path: Path) -> None:
    robot = read_robot(write(tmp_path))
    assert robot.joint_names == ("turn", "wrist")
    (foot,), (box, cap), (hand, finger) = robot.bodies
    assert [body.name for body in (foot, box, cap, hand, finger)] == [
        "base (foot)",
        "arm",
        "arm (cap)",
        "hand",
        "finger",
    ]
    assert foot.solid == Frustum(0.1, 0.1, 0.2)
    np.testing.assert_allclose(foot.T_frame_solid, np.eye(4), atol=1e-12)
    assert box.solid == Box((0.1, 0.2, 0.3))
    np.testing.assert_allclose(box.T_frame_solid[:3, 3], [0.1, 0, 0], atol=1e-12)
    turned = pin.utils.rotate("z", 0.2) @ pin.utils.rotate("y", 1.5)
    np.testing.assert_allclose(box.T_frame_solid[:3, :3], turned, atol=1e-12)
    assert cap.solid == Capsule(0.07, 0.0)
    assert isinstance(hand.solid, Hull)
    corners = np.array([[0, 0, 0], [0.05, 0, 0], [0, 0.06, 0], [0, 0, 0.14]])
    np.testing.assert_allclose(np.sort(hand.solid.vertices.sum(axis=1)), np.sort(corners.sum(axis=1)), atol=1e-9)
    assert finger.solid == Capsule(0.01, 0.05)  # of a joint aside: where it stands at zero
    np.testing.assert_allclose(finger.T_frame_solid[:3, 3], [0.12, 0, 0.1], atol=1e-12)


def test_ranges_and_speeds_are_those_of_both_files(tmp_path: Path) -> None:
    robot = read_robot(write(tmp_path))
    np.testing.assert_allclose(robot.model.lowerPositionLimit, [-1, np.radians(-400)])
    np.testing.assert_allclose(robot.model.upperPositionLimit, [2, np.radians(300)])
    np.testing.assert_allclose(robot.model.velocityLimit, [3, 2])
    own = read_robot(write(tmp_path, yaml=YAML + "range_deg: {turn: [-9, 9], wrist: [-1, 1]}\nspeed_rad_s: [4, 5]\n"))
    np.testing.assert_allclose(np.degrees(own.model.upperPositionLimit), [9, 1])
    np.testing.assert_allclose(own.model.velocityLimit, [4, 5])


def test_links_that_are_not_there_are_left_out_with_what_hangs_on_them(tmp_path: Path) -> None:
    robot = read_robot(write(tmp_path, yaml=YAML + RANGE + "without: [hand]\n"))
    assert [[body.name for body in bodies] for bodies in robot.bodies] == [["base (foot)"], ["arm", "arm (cap)"], []]


def test_of_links_beneath_the_arm_all_is_left_out_but_the_arm(tmp_path: Path) -> None:
    box = '<collision><geometry><box size="{}"/></geometry></collision>'
    floor = f'<link name="floor">{box.format("3 3 0.1")}</link><link name="wall">{box.format("0.1 3 3")}</link>'
    for child in ("wall", "base"):
        floor += f'<joint name="to_{child}" type="fixed"><parent link="floor"/><child link="{child}"/></joint>'
    text, above = URDF.replace("</robot>", f"{floor}</robot>"), [["arm", "arm (cap)"], ["hand", "finger"]]
    for without, foot in ("wall", ["base (foot)", "floor"]), ("floor", ["base (foot)"]), ("base", ["floor", "wall"]):
        robot = read_robot(write(tmp_path, text, YAML + RANGE + f"without: [{without}]\n"))
        assert [sorted(body.name for body in bodies) for bodies in robot.bodies] == [sorted(foot), *map(sorted, above)]


def test_a_robot_without_bodies(tmp_path: Path) -> None:
    bare = "\n".join(line for line in URDF.splitlines() if "<collision" not in line)
    assert read_robot(write(tmp_path, bare)).bodies == ((), (), ())


def test_meshes_in_a_package_around_the_file_are_found(tmp_path: Path) -> None:
    folder = tmp_path / "own_description" / "urdf"
    (tmp_path / "own_description" / "meshes").mkdir(parents=True)
    folder.mkdir()
    (tmp_path / "own_description" / "meshes" / "a hand.stl").write_text(STL, encoding="utf-8")
    address = "package://own_description/meshes/a%20hand.stl"
    robot = read_robot(write(folder, URDF.replace("hand.stl", address)))
    assert robot.bodies[2][0].name == "hand"


def test_a_package_is_known_by_its_name_not_its_folder(tmp_path: Path) -> None:
    """A repository that is downloaded, not cloned, lies in a folder with its branch's name."""
    package = tmp_path / "own_description-main"
    (package / "meshes").mkdir(parents=True)
    (package / "urdf").mkdir()
    (package / "meshes" / "hand.stl").write_text(STL, encoding="utf-8")
    named = "<package>\n  <name>{}</name>\n  <maintainer>own_description</maintainer>\n</package>\n"
    (package / "package.xml").write_text(named.format("own_description"), encoding="utf-8")
    file = write(package / "urdf", URDF.replace("hand.stl", "package://own_description/meshes/hand.stl"))
    assert read_robot(file).bodies[2][0].name == "hand"
    (package / "package.xml").write_text(named.format("another"), encoding="utf-8")
    with pytest.raises(InputError, match=r"no mesh.* in any whose package.xml names own_description"):
        read_robot(file)


@pytest.mark.parametrize(
    ("mine", "theirs"),
    [
        ("own_cell", "own_description-main"),
        ("own_cell", "robots/own_description-main"),
        ("mine/own_cell", "robots/own_description-main"),
    ],
)
def test_meshes_of_a_package_beside_that_of_the_urdf_are_found(mine: str, theirs: str, tmp_path: Path) -> None:
    """A workspace: a package with the cell, and the robot's as it was downloaded, each in a repository of several or not."""
    cell, package = (tmp_path / "workspace" / "src" / where for where in (mine, theirs))
    for folder, name in ((cell / "urdf", "own_cell"), (package / "meshes", "own_description")):
        folder.mkdir(parents=True)
        (folder.parent / "package.xml").write_text(f"<package><name>{name}</name></package>", encoding="utf-8")
    (package / "meshes" / "hand.stl").write_text(STL, encoding="utf-8")
    file = write(cell / "urdf", URDF.replace("hand.stl", "package://own_description/meshes/hand.stl"))
    assert read_robot(file).bodies[2][0].name == "hand"


@pytest.mark.parametrize("key", ["panda", "ur5", "ur10", "irb140", "iiwa"])
def test_bodies_stand_where_pinocchio_has_them(key: str) -> None:
    """Every point of every body, in random postures, against Pinocchio's geometry of the whole URDF."""
    robot = read_robot(ROBOTS / f"{key}.yaml")
    name = {"panda": "panda", "ur5": "ur5_robot", "ur10": "ur10_robot"}.get(key)
    path = next(SHARE.glob(f"example-robot-data/robots/*/urdf/{name}.urdf")) if name else ROBOTS / f"{key}.urdf"
    whole = pin.buildModelFromUrdf(str(path))
    geometry = pin.buildGeomFromUrdf(whole, str(path), pin.GeometryType.COLLISION, package_dirs=[str(SHARE)])
    data, places = whole.createData(), geometry.createData()
    own_data = robot.model.createData()
    rng = np.random.default_rng(3)
    absent = ("panda_hand", "panda_leftfinger", "panda_rightfinger")
    expected = [shape for shape in geometry.geometryObjects if not shape.name.startswith(absent)]
    own = [(i, body) for i, bodies in enumerate(robot.bodies) for body in bodies]
    assert len(own) == len(expected) > 0
    for _ in range(3):
        q = np.zeros(whole.nq)
        q[: robot.model.nq] = rng.uniform(-2, 2, robot.model.nq)
        pin.updateGeometryPlacements(whole, data, geometry, places, q)
        pin.forwardKinematics(robot.model, own_data, q[: robot.model.nq])
        for (i, body), shape in zip(own, expected, strict=True):
            assert shape.name.startswith(body.name.partition(" ")[0])
            points = placed(body, own_data.oMi[i].homogeneous)
            T = places.oMg[geometry.getGeometryId(shape.name)]
            local = (points - T.translation) @ T.rotation
            box = _box(shape.geometry)
            np.testing.assert_allclose(local.min(axis=0), box[0], atol=2e-4)
            np.testing.assert_allclose(local.max(axis=0), box[1], atol=2e-4)


def _box(shape: coal.CollisionGeometry) -> Array:
    shape.computeLocalAABB()
    return np.array([shape.aabb_local.min_, shape.aabb_local.max_])


# --- mistakes ---------------------------------------------------------------------------------------------------

TURN_LIMIT = '<limit lower="-1" upper="2" velocity="3" effort="0"/>'
WRONG = {
    "no mesh": ('filename="hand.stl"', 'filename="hands.stl"', "link hand", "no mesh hands.stl"),
    "no mesh in a package": ("hand.stl", "package://own/hand.stl", "link hand", "all folders around own.urdf"),
    "mesh of a kind unknown": ("hand.stl", "own.yaml", "link hand", "own.yaml cannot be read"),
    "mesh without name": ('filename="hand.stl"', "", "link hand", "no filename"),
    "scale to nothing": ('scale="0.001 0.001 0.002"', 'scale="0.001 0.001 0"', "link hand", "in one plane"),
    "scale of two": ('scale="0.001 0.001 0.002"', 'scale="1 1"', "link hand", "must be 3 numbers, not '1 1'"),
    "mesh in mm": (' scale="0.001 0.001 0.002"', "", "link hand", "is 70 m across (sizes are in metres; for a file in mm, give scale="),
    "box in mm": ("0.1 0.2 0.3", "100 200 300", "link arm", "size of 300 m (sizes are in metres)"),
    "joint in mm": ('xyz="0.4 0 0"', 'xyz="400 0 0"', "joint wrist", "origin is 400 m away (origins are in metres)"),
    "shape in mm": ('xyz="0.1 0 0"', 'xyz="100 0 0"', "link arm", "origin is 100 m away"),
    "box of no size": ("0.1 0.2 0.3", "0.1 0 0.3", "link arm", "size of 0 m"),
    "ball inside out": ('radius="0.07"', 'radius="-0.07"', "link arm", "size of -0.07 m"),
    "no number": ('radius="0.07"', 'radius="7 cm"', "link arm", "must be a number"),
    "not finite": ('radius="0.07"', 'radius="nan"', "link arm", "must be a number"),
    "unknown shape": ('<sphere radius="0.07"/>', '<cone radius="0.07"/>', "link arm", "one of box, cylinder"),
    "no shape": ('<sphere radius="0.07"/>', "", "link arm", "needs one shape"),
    "unknown type": ('type="revolute"', 'type="revolut"', "joint turn", "did you mean revolute?"),
    "no type": (' type="revolute"', "", "joint turn", "unknown type ''"),
    "rail without limits": (
        'type="revolute">\n    <parent link="base"/><child link="arm"/><origin xyz="0 0 0.3" rpy="0 0.4 0"/><axis xyz="0 0 2"/>\n'
        f"    {TURN_LIMIT}", 'type="prismatic"><parent link="base"/><child link="arm"/>', "joint turn",
        "give range_mm: {turn: [0, 3000]}",
    ),
    "floating": ('type="revolute"', 'type="floating"', "joint turn", "is floating"),
    "planar": ('type="revolute"', 'type="planar"', "joint turn", "is planar"),
    "no limits": (TURN_LIMIT, "", "joint turn", "give range_deg: {turn: [-360, 360]}"),
    "no lower": (' lower="-1"', "", "joint turn", "has no limits"),
    "limits of zero": ('lower="-1" upper="2"', 'lower="0" upper="0"', "joint turn", "not above the lower one"),
    "no speed": (' velocity="3"', "", "joint turn", "has no speed"),
    "speed of zero": ('velocity="3"', 'velocity="0"', "joint turn", "speed_rad_s"),
    "mimic": (TURN_LIMIT, TURN_LIMIT + '<mimic joint="wrist"/>', "joint turn", "follows another joint"),
    "no axis": ('xyz="0 0 2"', 'xyz="0 0 0"', "joint turn", "no length"),
    "no parent": ('<parent link="base"/>', "", "joint turn", "has no parent link"),
    "unknown parent": ('<parent link="base"/>', '<parent link="bas"/>', "joint turn", "did you mean base?"),
    "two parents": ('<child link="finger"/>', '<child link="arm"/>', "joint slide", "another joint as well"),
    "circle": ('<parent link="base"/>', '<parent link="hand"/>', "is its own ancestor", "form a tree"),
    "link twice": ('<link name="tool"/>', '<link name="tool"/><link name="tool"/>', "link tool", "twice"),
    "joint without name": (' name="turn"', "", "joint", "has no name"),
    "macro": ('<link name="tool"/>', '<xacro:link name="tool"/>', "xacro", "run xacro"),
    "cut off": ("</robot>", "", "own.urdf", "not well-formed XML"),
    "another file": ('<robot name="own">', '<sdf name="own">', "own.urdf", "not well-formed XML"),
    "entities": ('<robot name="own">', '<!DOCTYPE robot [<!ENTITY a "b">]><robot name="own">', "own.urdf", "DOCTYPE"),
}  # fmt: skip


@pytest.mark.parametrize("name", WRONG)
def test_what_is_wrong_with_a_urdf_is_told_with_its_file_and_line(name: str, tmp_path: Path) -> None:
    old, new, field, said = WRONG[name]
    assert old in URDF
    file = write(tmp_path, URDF.replace(old, new, 1))
    with pytest.raises(InputError) as caught:
        read_robot(file)
    error = caught.value
    assert error.file == tmp_path / "own.urdf"
    assert error.exit_code == 2
    assert error.line is not None
    assert field in str(error)
    assert said in str(error)
    if error.field is not None and error.field.startswith("joint "):
        around = (tmp_path / "own.urdf").read_text().splitlines()[max(0, error.line - 3) : error.line]
        assert f'<joint name="{error.field.removeprefix("joint ")}"' in " ".join(around)


def test_a_joint_without_end_asks_for_its_range(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"joint wrist: turns without end.*range_deg: \{wrist: \[-360, 360\]\}"):
        read_robot(write(tmp_path, yaml=YAML))


@pytest.mark.parametrize("stl", ["", "rubbish", STL[: len(STL) // 3], STL.replace("50 0 0", "nan 0 0")])
def test_a_mesh_that_is_none(stl: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"own.urdf:10: link hand: mesh hand.stl"):
        read_robot(write(tmp_path, stl=stl))


def test_two_bases_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"own.urdf:12: link spare: has no parent, like base"):
        read_robot(write(tmp_path, URDF.replace('<link name="tool"/>', '<link name="tool"/><link name="spare"/>')))


def test_a_urdf_without_links(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"own.urdf:1: robot: has no links"):
        read_robot(write(tmp_path, "<robot name='own'></robot>"))


def test_no_urdf_but_another_xml_file(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"own.urdf:1: the root element is <sdf>, not <robot>"):
        read_robot(write(tmp_path, "<sdf></sdf>"))


@pytest.mark.parametrize(
    ("line", "field", "said"),
    [
        ("range_deg: {writ: [-1, 1], wrist: [-1, 1]}", "range_deg", "did you mean wrist?"),
        ("range_deg: {wrist: [1, -1]}", "range_deg", "a least and a greatest angle"),
        ("range_deg: {wrist: 5}", "range_deg", "a least and a greatest angle"),
        ("range_deg: [1, 2]", "range_deg", "ranges by joint"),
        (RANGE + "without: hand", "without", "list of names"),
        (RANGE + "without: [hands]", "without", "did you mean hand?"),
        (RANGE + "speed_rad_s: [1]", "speed_rad_s", "2 positive numbers"),
    ],
)
def test_mistakes_beside_the_urdf(line: str, field: str, said: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=field) as caught:
        read_robot(write(tmp_path, yaml=YAML + line + "\n"))
    assert caught.value.file == tmp_path / "own.yaml"
    assert said in str(caught.value)


def test_a_tip_that_nothing_turns(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no joint moves between the base and base"):
        read_robot(write(tmp_path, yaml=YAML.replace("tip: tool", "tip: base") + RANGE))


def test_lines_of_elements_are_those_of_the_file() -> None:
    urdf = read_urdf(ROBOTS / "irb140.urdf")
    rows = urdf.path.read_text(encoding="utf-8").splitlines()
    for name, link in urdf.links().items():
        assert f'<link name="{name}"' in rows[urdf.lines[link] - 1]


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ("quick", "must be values by name"),
        ("{lag: 3}", "did you mean lag_ms?"),
        ("{lag_ms: soon}", "lag_ms must be a number (0 to 300)"),
        ("{lag_ms: -1}", "lag_ms must be a number (0 to 300)"),
        ("{ahead_moves: 2.5}", "ahead_moves must be a whole number (1 to 1000)"),
    ],
)
def test_what_a_controller_does_is_read_with_its_bounds(given: str, said: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=re.escape(said)):
        read_robot(write(tmp_path, yaml=f"{YAML}range_deg: {{wrist: [-360, 360]}}\ncontroller: {given}\n"))
