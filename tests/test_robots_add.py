"""`python -m planner.robots add`: from a URDF to a robot's file that is read, and to a print that is verified."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from scipy.spatial import ConvexHull

from planner.base.arrays import Array
from planner.base.errors import EXIT_INPUT, InputError, OutputError
from planner.cell import pieces
from planner.cell.bodies import BodyRules, read_bodies
from planner.cell.cell import build_cell
from planner.cell.pieces import MOST_PLANES, convex_pieces, lean_hull
from planner.cell.robot import read_robot
from planner.cell.robot_file import read_robot_file
from planner.cell.solids import Hull
from planner.cell.urdf import Urdf, model_of, parse_urdf
from planner.export.support import unsupported_in_rapid
from planner.problem import load_problem
from planner.robots import survey as surveying
from planner.robots.adding import add_robot, added
from planner.robots.command import main
from planner.robots.face import depth
from planner.robots.files import cap_for, nozzle_of, spiral
from planner.robots.survey import key_of, survey
from planner.robots.trial import _places, trial
from planner.verify.bodies import CellBodies, coal_geometry, pairs
from tests.public_arms import ARMS, urdf_of

KR10 = ARMS["KUKA KR 10 R1420"]


def urdf(text: str) -> Urdf:
    return parse_urdf(text.encode(), Path("arm.urdf"))


def written(folder: Path, text: str) -> Path:
    (folder / "arm.urdf").write_text(text, encoding="utf-8")
    return folder / "arm.urdf"


# --- what is found ----------------------------------------------------------------------------------------------


@pytest.mark.slow(keep=("KUKA KR 6 R700 sixx",))
@pytest.mark.parametrize("name", ARMS)
def test_public_arms_are_added_as_they_are(name: str, tmp_path: Path) -> None:
    file, made = added(written(tmp_path, urdf_of(ARMS[name], bodies=True)), tmp_path / "arm.yaml")
    assert made.found.kind == "spherical_wrist"
    assert made.found.tip == "tool0"
    assert made.found.assumed == ("acceleration_rad_s2", "jerk_rad_s3")
    assert read_robot(file).assumed == made.found.assumed
    assert made.robot.joint_names == tuple(f"joint_{k}" for k in range(1, 7))
    assert "Written by: beadwise robots add arm.urdf" in file.read_text(encoding="utf-8")


def test_what_is_assumed_of_a_joint_that_says_little() -> None:
    text = (
        urdf_of(KR10).replace(' velocity="9.0"', "").replace('"joint_6" type="revolute"', '"joint_6" type="continuous"')
    )
    found = survey(urdf(text), None)
    assert found.ranges == {"joint_6": (-360.0, 360.0)}
    assert found.speeds == (4.0, 5.0, 6.0, 7.0, 8.0, surveying.ASSUMED_SPEED)
    assert set(found.assumed) == {"acceleration_rad_s2", "jerk_rad_s3", "speed_rad_s", "range_deg"}
    assert sum("assumed" in note for note in found.notes) == 3
    np.testing.assert_allclose(found.acceleration, np.array(found.speeds) / surveying.RISE)


@pytest.mark.parametrize(("lower", "upper"), [("-1e+16", "1e+16"), ("-inf", "inf"), ("0", "0.0"), ("-3.1", "")])
def test_ends_that_no_joint_has_are_none(lower: str, upper: str) -> None:
    low, high = (float(np.radians(end)) for end in KR10.ranges[5])
    own = f'lower="{low!r}" upper="{high!r}"'
    text = urdf_of(KR10)
    assert text.count(own) == 1
    given = f'lower="{lower}" upper="{upper}"' if upper else f'lower="{lower}"'
    assert survey(urdf(text.replace(own, given)), None).ranges == {"joint_6": (-360.0, 360.0)}


def test_a_gripper_is_no_part_of_the_arm() -> None:
    text = urdf_of(KR10).replace("tool0", "hand").replace(
        "</robot>",
        '<link name="finger"/><joint name="grip" type="prismatic"><parent link="hand"/><child link="finger"/>'
        '<limit lower="0" upper="0.04" velocity="0.1" effort="1"/></joint></robot>',
    )  # fmt: skip
    found = survey(urdf(text), None)
    assert found.tip == "link_6"  # no link is named as a flange: the last one that turns
    assert len(found.joints) == 6
    np.testing.assert_allclose(found.outwards, [1, 0, 0], atol=1e-12)
    assert any("nozzle.axis" in note for note in found.notes)


def test_a_finger_that_turns_is_no_seventh_axis() -> None:
    """Kinova names the flange end_effector, and its hand's fingers are joints as the arm's."""
    text = urdf_of(KR10).replace("tool0", "arm_end_effector").replace(
        "</robot>",
        '<link name="finger"/><joint name="grip" type="revolute"><parent link="arm_end_effector"/><child link="finger"/>'
        '<limit lower="0" upper="1" velocity="1" effort="1"/></joint></robot>',
    )  # fmt: skip
    found = survey(urdf(text), None)
    assert found.tip == "arm_end_effector" and len(found.joints) == 6


def test_a_gripper_whose_flange_has_no_name_may_be_told_from_the_arm() -> None:
    """A finger that turns, behind links of any names, counts as a seventh axis until the flange is named."""
    text = urdf_of(KR10).replace("tool0", "hand").replace(
        "</robot>",
        '<link name="finger"/><joint name="grip" type="revolute"><parent link="hand"/><child link="finger"/>'
        '<limit lower="0" upper="1" velocity="1" effort="1"/></joint></robot>',
    )  # fmt: skip
    with pytest.raises(InputError, match="give the flange with --tip, if grip belongs to a gripper, not to the arm"):
        survey(urdf(text), None)
    assert survey(urdf(text), "hand").kind == "spherical_wrist"


def test_of_several_frames_of_a_flange_it_is_one_whose_z_leaves_it() -> None:
    """A `flange` with x out of it, as ROS has it, and a maker's own beside it."""
    text = urdf_of(KR10).replace("tool0", "maker_flange").replace(
        "</robot>",
        '<link name="flange"/><joint name="f" type="fixed"><parent link="link_6"/><child link="flange"/></joint></robot>',
    )  # fmt: skip
    assert survey(urdf(text), None).tip == "maker_flange"


def test_the_flange_may_be_named() -> None:
    text = urdf_of(KR10)
    assert survey(urdf(text), "link_6").tip == "link_6"
    with pytest.raises(InputError, match="did you mean tool0"):
        survey(urdf(text), "tool")


def begins_in_the_wrist(folder: Path, end: str = "0.1 0 0") -> Path:
    """An arm whose last link begins where its axes meet, and reaches 100 mm from there; an empty frame stands at `end`."""
    text = urdf_of(ARMS["Yaskawa GP25"]).replace("tool0", "the_end").replace('xyz="0.1 0.0 0.0"', f'xyz="{end}"')
    assert f'xyz="{end}"' in text
    body = '<collision><origin xyz="0.05 0 0"/><geometry><box size="0.1 0.06 0.06"/></geometry></collision>'
    return written(folder, text.replace('<link name="link_6"></link>', f'<link name="link_6">{body}</link>'))


def test_a_frame_at_the_end_of_the_last_link_is_the_flange(tmp_path: Path) -> None:
    """Not where the link begins: a nozzle measured from the flange would be 100 mm too long."""
    _, made = added(begins_in_the_wrist(tmp_path), tmp_path / "arm.yaml")
    assert made.found.tip == made.robot.tip == "the_end"
    assert not any("beyond its frame" in note for note in made.found.notes)
    _, named = added(tmp_path / "arm.urdf", tmp_path / "named.yaml", tip="link_6")
    assert named.robot.tip == "link_6", "whoever names one gets it"


def test_what_is_mounted_on_a_flange_is_no_part_of_it(tmp_path: Path) -> None:
    """A sensor, and an empty frame where it ends: the controller's flange stays before both."""
    body = '<collision><origin xyz="0 0 0.025"/><geometry><box size="0.06 0.06 0.05"/></geometry></collision>'
    text = urdf_of(KR10, bodies=True).replace(
        "</robot>",
        f'<link name="sensor">{body}</link><link name="measured"/>'
        '<joint name="s" type="fixed"><parent link="tool0"/><child link="sensor"/></joint>'
        '<joint name="m" type="fixed"><parent link="tool0"/><child link="measured"/><origin xyz="0 0 0.05"/></joint></robot>',
    )
    _, made = added(written(tmp_path, text), tmp_path / "arm.yaml")
    assert made.found.tip == made.robot.tip == "tool0"
    assert not any("beyond its frame" in note for note in made.found.notes)
    assert any(note.startswith("sensor on the flange: counted") for note in made.found.notes)
    assert depth(made.robot, made.found.outwards) == pytest.approx(0.05), "which the trial's nozzle is longer by"


def test_what_an_arm_stands_on_is_told_and_stays_checked(tmp_path: Path) -> None:
    """A table, with a shelf that the upper arm is in at most of its angles: no reason to overlook both for good."""
    box = '<collision><origin xyz="0 0 {}"/><geometry><box size="2 2 0.1"/></geometry></collision>'
    body = box.format(0.0) + box.format(0.7)
    table = f'<link name="table">{body}</link><joint name="t" type="fixed"><parent link="table"/>'
    table += '<child link="base_link"/><origin xyz="0 0 0.05"/></joint></robot>'
    text = urdf_of(KR10, bodies=True)
    _, made = added(written(tmp_path, text.replace("</robot>", table)), tmp_path / "arm.yaml")
    assert any(note.startswith("table beneath the arm: counted as its foot") for note in made.found.notes)
    assert made.robot.bodies[0] and not any("table" in pair for pair in made.touch.may_touch)
    _, bare = added(written(tmp_path, text), tmp_path / "bare.yaml")
    assert not any("beneath the arm" in note for note in bare.found.notes)


@pytest.mark.parametrize("end", ["0.2 0 0", "0.1 0.01 0"])
def test_a_frame_inside_its_link_is_told_and_the_trial_s_nozzle_longer(end: str, tmp_path: Path) -> None:
    file, made = added(begins_in_the_wrist(tmp_path, end), tmp_path / "arm.yaml")
    assert made.found.tip == "link_6"
    note = "link_6's body reaches 100 mm beyond its frame: nozzle.tip_mm is measured from the frame"
    assert note in made.found.notes and f"# {note}" in file.read_text(encoding="utf-8")
    assert depth(made.robot, made.found.outwards) == pytest.approx(0.1)
    tip = nozzle_of(made.found.outwards, 0.0, depth(made.robot, made.found.outwards)).tip
    np.testing.assert_allclose(tip, 0.2 * made.found.outwards)


def test_axes_4_and_6_that_pass_each_other_are_no_obstacle() -> None:
    found = survey(urdf(urdf_of(KR10).replace('xyz="0.08 0.0 0.0"', 'xyz="0.08 0.0 0.08"')), None)
    assert (found.kind, found.redundant) == ("skew_wrist", None)


# where a joint stands in the one before [m], its axes turning about z and y in turn: Kinova's Gen3 and Flexiv's Rizon 4, rounded
APART = {
    "Gen3": ((0, 0, 0.156), (0, 0.005, 0.128), (0, -0.017, 0.21), (0, 0, 0.21), (0, -0.013, 0.208), (0, 0, 0.106), (0, 0, 0.106)),
    "Rizon": ((0, 0, 0.155), (0, 0.03, 0.21), (0, -0.095, 0.205), (0.02, 0, 0.19), (-0.02, 0.055, 0.19), (0, 0, 0.195), (0, -0.1, 0.11)),
}  # fmt: skip


def seven(rows: tuple[tuple[float, ...], ...]) -> str:
    """The URDF of an arm of seven axes, bent a little at zero."""
    links = "".join(f'<link name="l{k}"/>' for k in range(8))
    joints = "".join(
        f'<joint name="j{k}" type="revolute"><parent link="l{k - 1}"/><child link="l{k}"/><origin xyz="{x} {y} {z}"/>'
        f'<axis xyz="{"0 0 1" if k % 2 else "0 1 0"}"/><limit lower="-2.8" upper="2.8" velocity="2" effort="1"/></joint>'
        for k, (x, y, z) in enumerate(rows, 1)
    )
    return f'<robot name="seven">{links}{joints}</robot>'


@pytest.mark.parametrize("name", APART)
def test_seven_axes_that_pass_each_other_are_found_from_an_arm_where_they_meet(name: str, tmp_path: Path) -> None:
    _, made = added(written(tmp_path, seven(APART[name])), tmp_path / "arm.yaml")
    assert made.found.kind == "seven_axes"
    assert made.found.roughly and any("of random ones are missed" in note for note in made.found.notes)
    inverse = made.robot.inverse
    assert inverse is not None and inverse.redundant_joint is not None
    q = np.random.default_rng(1).uniform(-2.8, 2.8, (200, 7))
    T = inverse.poses(q)
    solved, ok = inverse.solve(T, q[:, inverse.redundant_joint])
    np.testing.assert_allclose(inverse.poses(solved[ok]), np.repeat(T, ok.sum(axis=1), axis=0), atol=1e-9)
    away = np.abs((solved - q[:, None] + np.pi) % (2.0 * np.pi) - np.pi).max(axis=2)
    assert np.mean((ok & (away < 1e-6)).any(axis=1)) > 0.7


def test_seven_axes_and_offset_wrists_are_known_by_their_geometry() -> None:
    for shipped, kind in (("iiwa", "seven_axes"), ("ur5e", "offset_wrist"), ("irb140", "spherical_wrist")):
        path = Path(surveying.__file__).parents[2] / "robots" / f"{shipped}.urdf"
        found = survey(parse_urdf(path.read_bytes(), path), None)
        assert found.kind == kind
        assert found.redundant == ("joint_3" if kind == "seven_axes" else None)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (('<joint name="joint_4" type="revolute">', '<joint name="joint_4" type="fixed">'), "no arm of six or seven axes"),
        (('xyz="0.66 0.0 0.0"', 'xyz="0.66 0.0 0.08"'), "no inverse kinematics.*axes 4 and 5 pass each other by 80.0 mm"),
        (('<joint name="joint_6" type="revolute">', '<joint name="joint_6" type="revolute"><mimic joint="joint_5"/>'),
         "no arm of six or seven axes"),
        (('<link name="base_link"></link>',
          '<link name="floor"/><link name="base_link"/><joint name="rail" type="prismatic"><parent link="floor"/>'
          '<child link="base_link"/><axis xyz="1 0 0"/><limit lower="0" upper="3" velocity="1"/></joint>'),
         "no arm of six or seven axes: .*what carries an arm needs a URDF and a file of its own"),
    ],
)  # fmt: skip
def test_what_cannot_be_planned_with_is_refused_and_nothing_written(
    change: tuple[str, str], said: str, tmp_path: Path
) -> None:
    text = urdf_of(KR10)
    assert change[0] in text
    with pytest.raises(InputError, match=said):
        added(written(tmp_path, text.replace(*change)), tmp_path / "arm.yaml")
    assert [path.name for path in tmp_path.iterdir()] == ["arm.urdf"]
    if "prismatic" in change[1]:
        with pytest.raises(InputError, match=r"joint rail: slides.*give the arm alone"):
            added(tmp_path / "arm.urdf", tmp_path / "arm.yaml", tip="tool0")


def test_two_arms_need_a_name() -> None:
    one = urdf_of(KR10)
    other = one.replace("link_", "left_link_").replace("joint_", "left_joint_").replace("tool0", "left_tool0")
    inner = other[other.index("\n") : other.index("</robot>")].replace('<link name="base_link"></link>', "")
    text = one.replace("</robot>", inner.replace('name="flange"', 'name="left_flange"') + "</robot>")
    with pytest.raises(InputError, match=r"several arms: tool0, left_tool0.*--tip"):
        survey(urdf(text), None)
    assert survey(urdf(text), "left_tool0").joints[0] == "left_joint_1"


@pytest.mark.parametrize("name", ["arm.yaml", "arm_print.yaml", "arm_print.txt"])
def test_a_file_that_is_there_stays(name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / name).write_text("mine", encoding="utf-8")
    assert main(["add", str(written(tmp_path, urdf_of(KR10))), "--out", str(tmp_path / "arm.yaml")]) == EXIT_INPUT
    assert f"{name} is there already, and stays as it is" in capsys.readouterr().err
    assert (tmp_path / name).read_text(encoding="utf-8") == "mine"
    assert {path.name for path in tmp_path.iterdir()} == {"arm.urdf", name}


def test_xacro_names_its_extra(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "xacro", None)
    (tmp_path / "arm.xacro").write_text("<robot/>", encoding="utf-8")
    assert main(["add", str(tmp_path / "arm.xacro"), "--out", str(tmp_path / "arm.yaml")]) == 2
    assert "beadwise[xacro]" in capsys.readouterr().err


def described(folder: Path) -> Path:
    """A ROS package whose xacro file includes a macro of another one beside it."""
    for name in ("arm_support", "arm_macros"):
        (folder / name / "urdf").mkdir(parents=True)
        (folder / name / "package.xml").write_text(
            f"<package format='2'><name>{name}</name><version>1.0.0</version><description>an arm</description>"
            "<maintainer email='a@b.example'>a</maintainer><license>none</license></package>",
            encoding="utf-8",
        )
    body = urdf_of(KR10)
    body = body[body.index("\n") : body.index("</robot>")].replace('name="link_', 'name="${prefix}link_')
    body = body.replace('link="link_', 'link="${prefix}link_')
    space = 'xmlns:xacro="http://www.ros.org/wiki/xacro"'
    macro = f'<robot {space}><xacro:macro name="kr10" params="prefix">{body}</xacro:macro></robot>'
    (folder / "arm_macros" / "urdf" / "macro.xacro").write_text(macro, encoding="utf-8")
    file = folder / "arm_support" / "urdf" / "kr10.xacro"
    include = '<xacro:include filename="$(find arm_macros)/urdf/macro.xacro"/>'
    file.write_text(f'<robot name="KR 10" {space}>{include}<xacro:kr10 prefix="a_"/></robot>', encoding="utf-8")
    return file


def test_a_xacro_file_is_expanded_with_the_packages_around_it(tmp_path: Path) -> None:
    pytest.importorskip("xacrodoc")
    file, made = added(described(tmp_path), tmp_path / "kr10.yaml")
    assert made.found.name == "KR 10"
    assert made.found.tip == "tool0"
    assert (tmp_path / "arm_support" / "urdf" / "kr10.urdf").is_file()
    assert read_robot(file).joint_names == made.found.joints


def test_a_xacro_file_that_is_wrong_is_told(tmp_path: Path) -> None:
    pytest.importorskip("xacrodoc")
    path = described(tmp_path)
    path.write_text(path.read_text(encoding="utf-8").replace("xacro:kr10", "xacro:kr11"), encoding="utf-8")
    with pytest.raises(InputError, match=r"xacro rejects it.*kr11"):
        added(path, tmp_path / "kr10.yaml")
    assert not (tmp_path / "kr10.yaml").exists()


def asking(folder: Path) -> Path:
    """The same, where the robot's name and the links' prefix are arguments."""
    path = described(folder)
    text = (
        path.read_text(encoding="utf-8")
        .replace('name="KR 10"', 'name="$(arg name)"')
        .replace('"a_"', '"$(arg prefix)"')
    )
    asked = '<xacro:arg name="name" default="any"/><xacro:arg default="a_" name="prefix"/>'
    path.write_text(text.replace("<xacro:include", f"{asked}<xacro:include"), encoding="utf-8")
    return path


def test_a_xacro_file_for_many_arms_gets_its_arguments(tmp_path: Path) -> None:
    pytest.importorskip("xacrodoc")
    path, support = asking(tmp_path), tmp_path / "arm_support" / "urdf"
    for name, prefix, beside in (("KR 10", "b_", "kr10_kr_10_b.urdf"), ("KR 11", "c_", "kr10_kr_11_c.urdf")):
        file, made = added(path, tmp_path / f"{prefix}.yaml", arguments={"name": name, "prefix": prefix})
        assert made.found.name == name
        assert read_robot_file(file).urdf().resolve() == (support / beside).resolve()
        assert f'"{prefix}link_1"' in (support / beside).read_text(encoding="utf-8")
    again = add_robot(path, tmp_path / "b_.yaml", arguments={"name": "KR 10", "prefix": "b_"})
    assert again == tmp_path / "b_.yaml"
    with pytest.raises(OutputError, match="describes another robot"):
        add_robot(path, tmp_path / "b_.yaml", arguments={"name": "KR 11", "prefix": "c_"})


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        ([], "Undefined substitution argument name; the file has name, prefix: give them after it, as in name:=…"),
        (["name:=k", "prefx:=b_"], "has no argument 'prefx' (did you mean prefix?)"),
        (["name:=k", "size:=2"], "has no argument 'size' (it has name, prefix)"),
    ],
)
def test_arguments_that_are_missing_or_unknown_are_told(
    arguments: list[str], told: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("xacrodoc")
    path = asking(tmp_path)
    path.write_text(path.read_text(encoding="utf-8").replace('"any"', '"$(find arm_support)"'), encoding="utf-8")
    assert main(["add", str(path), *arguments, "--out", str(tmp_path / "kr10.yaml")]) == 2
    assert told in capsys.readouterr().err
    assert not (tmp_path / "kr10.yaml").exists()


def test_the_name_of_the_robot_may_be_an_argument_with_a_value(tmp_path: Path) -> None:
    """xacro reads the first element before the value of its own argument, as files of Flexiv, Kinova and Neuromeka have it."""
    pytest.importorskip("xacrodoc")
    _, made = added(asking(tmp_path), tmp_path / "kr10.yaml")
    assert made.found.name == "any"


def test_a_xacro_file_of_macros_names_those_that_use_it(tmp_path: Path) -> None:
    pytest.importorskip("xacrodoc")
    described(tmp_path)
    macro = tmp_path / "arm_macros" / "urdf" / "macro.xacro"
    with pytest.raises(InputError, match=r"makes no links.*the robot is made by kr10.xacro"):
        added(macro, tmp_path / "kr10.yaml")
    assert sorted(file.name for file in macro.parent.iterdir()) == ["macro.xacro"]


def test_only_xacro_files_have_arguments(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = written(tmp_path, urdf_of(KR10))
    assert main(["add", str(path), "name:=k", "--out", str(tmp_path / "kr10.yaml")]) == 2
    assert "only xacro files have arguments (leave them out)" in capsys.readouterr().err
    with pytest.raises(InputError, match=r"arguments\['name'\]"):
        add_robot(tmp_path / "arm.xacro", tmp_path / "kr10.yaml", arguments={"name": 10})  # type: ignore[dict-item]
    with pytest.raises(SystemExit):
        main(["add", str(path), "name=k"])
    assert "'name=k' is not an argument of a xacro file: write name:=value" in capsys.readouterr().err


def test_a_missing_urdf(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["add", str(tmp_path / "none.urdf")]) == 2
    assert "none.urdf: cannot be read" in capsys.readouterr().err


def test_names_become_keys() -> None:
    assert key_of("Stäubli TX2-60") == "st_ubli_tx2_60"
    assert key_of("!") == "my_robot"


def test_other_words_are_those_of_the_listing(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["irb14"]) == 2
    assert "did you mean irb140?" in capsys.readouterr().err


# --- bodies: pieces, links that may touch ------------------------------------------------------------------------


def fork() -> trimesh.Trimesh:
    """Two prongs on a bridge, as a wrist has them: its hull fills what is between them."""
    boxes = [
        trimesh.creation.box((0.3, 0.04, 0.1), trimesh.transformations.translation_matrix((0.15, y, 0)))
        for y in (-0.08, 0.08)
    ]
    return trimesh.util.concatenate([*boxes, trimesh.creation.box((0.06, 0.2, 0.1))])


def test_a_fork_is_cut_into_its_prongs() -> None:
    mesh = fork()
    corners = np.asarray(mesh.vertices)[mesh.faces]
    prongs = [Hull(points) for points in convex_pieces(corners, 4)]
    assert 2 <= len(prongs) <= 4
    assert sum(piece.volume for piece in prongs) < 0.75 * Hull(np.asarray(mesh.vertices)).volume
    inside = np.asarray(trimesh.sample.sample_surface(mesh, 2000, seed=0)[0])
    depth = np.min([(inside @ piece.planes[:, :3].T + piece.planes[:, 3]).max(axis=1) for piece in prongs], axis=0)
    assert depth.max() < 1e-9  # no place of the body is left out
    between = np.array([0.25, 0.0, 0.0])
    assert all((piece.planes[:, :3] @ between + piece.planes[:, 3]).max() > 0.01 for piece in prongs)


def test_cuts_are_weighed_without_making_them(monkeypatch: pytest.MonkeyPatch) -> None:
    """A fine mesh took minutes, where all triangles were cut 21 times for each piece; the gain is the same."""
    rng = np.random.default_rng(3)
    ball = trimesh.creation.icosphere(subdivisions=2)
    bent = np.asarray(ball.vertices) * [0.1, 0.02, 0.02]
    bent[:, 2] += 4.0 * bent[:, 0] ** 2
    bent += 1e-4 * rng.normal(size=bent.shape)  # no two places are as far in any direction
    corners = bent[ball.faces]
    made: list[float] = []

    def counted(corners: Array, axis: int, place: float, sign: float) -> Array:
        made.append(sign)
        return side(corners, axis, place, sign)

    side = pieces._side
    monkeypatch.setattr(pieces, "_side", counted)
    cut = pieces._best_cut(corners)
    assert made == [-1.0, 1.0]

    def volume(part: Array) -> float:
        points = part.reshape(-1, 3)
        return float(ConvexHull(points[np.unique((points @ pieces._DIRECTIONS.T).argmax(axis=0))]).volume)

    gains = []
    for axis in range(3):
        low, high = corners[:, :, axis].min(), corners[:, :, axis].max()
        for place in low + pieces._PLACES * (high - low):
            gains.append(
                volume(corners) - volume(side(corners, axis, place, -1.0)) - volume(side(corners, axis, place, 1.0))
            )
    assert cut.gain == pytest.approx(max(gains), rel=1e-9)


def test_a_convex_body_stays_whole() -> None:
    mesh = trimesh.creation.box((0.3, 0.04, 0.1))
    assert len(convex_pieces(np.asarray(mesh.vertices)[mesh.faces], 6)) == 1


def test_a_flat_body_has_no_pieces() -> None:
    flat = np.array([[[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[1, 0, 0], [1, 1, 0], [0, 1, 0]]], dtype=float)
    with pytest.raises(ValueError, match="one plane"):
        convex_pieces(flat, 3)


def test_a_fine_ball_becomes_leaner_and_holds_it() -> None:
    rng = np.random.default_rng(0)
    points = rng.normal(size=(4000, 3))
    points *= 0.1 / np.linalg.norm(points, axis=1)[:, None]
    lean = Hull(lean_hull(points))
    assert len(lean.planes) < MOST_PLANES / 2
    assert (points @ lean.planes[:, :3].T + lean.planes[:, 3]).max() < 1e-9
    assert lean.volume < 1.03 * Hull(points).volume
    coarse = points[:100]
    np.testing.assert_array_equal(
        np.sort(lean_hull(coarse), axis=0), np.sort(coarse[np.unique(Hull(coarse)._hull.vertices)], axis=0)
    )


def test_a_finely_cut_cylinder_has_few_corners_at_each_end() -> None:
    """Each face of its rim has a corner there, and the triangles of an end meet in one: coal takes 254 at most."""
    a = np.radians(np.arange(360.0))
    points = 0.03 * np.vstack([np.column_stack([np.cos(a), np.sin(a), np.full(360, z)]) for z in (0.0, 1.5)])
    lean = Hull(lean_hull(points))
    assert np.bincount(lean.facets[1].ravel()).max() < 255
    assert (points @ lean.planes[:, :3].T + lean.planes[:, 3]).max() < 1e-9
    assert lean.volume < 1.05 * Hull(points).volume
    coal_geometry(lean)


def forked(folder: Path, drawn: str = "visual") -> Path:
    """An arm whose link 4 ends in a fork, in which the flange turns: hulls touch where the bodies do not."""
    fork().export(folder / "fork.stl")
    mesh = '<geometry><mesh filename="fork.stl"/></geometry>'
    place = '<origin xyz="0.4 0 0"/>'
    text = urdf_of(KR10).replace(
        '<link name="link_4"></link>',
        f'<link name="link_4"><{drawn}>{place}{mesh}</{drawn}><collision>{place}{mesh}</collision></link>',
    )
    ball = '<collision><origin xyz="{} 0 0"/><geometry><box size="0.05 0.03 0.03"/></geometry></collision>'
    text = text.replace('<link name="link_6"></link>', f'<link name="link_6">{ball.format(-0.03)}</link>')
    return written(folder, text)


def test_links_that_only_touch_as_hulls_are_named_or_cut(tmp_path: Path) -> None:
    """Without a drawing of the flange the fork counts as it is read: the file says so, and pieces part them."""
    path = forked(tmp_path)
    parsed = parse_urdf(path.read_bytes(), path)
    model = model_of(parsed, "tool0", {}, False)
    whole, cut = (read_bodies(parsed, model, BodyRules(pieces=each)) for each in ({}, {"link_4": 4}))
    assert len(whole[4]) == 1
    assert len(cut[4]) > 1
    assert {body.link for body in cut[4]} == {"link_4"}


def test_named_links_are_not_looked_at(tmp_path: Path) -> None:
    file, _ = added(written(tmp_path, urdf_of(KR10, bodies=True)), tmp_path / "arm.yaml")

    def looked_at(text: str) -> set[tuple[str, str]]:
        file.write_text(text, encoding="utf-8")
        cell = build_cell(
            load_problem("peer_cap", [f"cell.arm={file}", "cell.limits={}", "cell.home_deg=[0, -90, 100, 0, 60, 0]"])
        )
        bodies = CellBodies.of(cell)
        return {(bodies.things[p.a].name, bodies.things[p.b].name) for p in pairs(bodies, 0.005, 0.005)}

    text = file.read_text(encoding="utf-8")
    before = looked_at(text)
    assert ("link_2", "link_4") in before or ("link_1", "link_3") in before
    after = looked_at(text + "may_touch: [[link_4, link_2], [link_1, link_3]]\n")
    assert before - after <= {("link_2", "link_4"), ("link_1", "link_3")}
    assert not after & {("link_2", "link_4"), ("link_1", "link_3")}


@pytest.mark.slow(keep=("pieces: {link_44*",))
@pytest.mark.parametrize(
    ("line", "field", "said"),
    [
        ("may_touch: [[link_4, link_9]]", "may_touch", "no link 'link_9'"),
        ("may_touch: [link_4, link_6]", "may_touch", "pairs of links"),
        ("pieces: {link_4: 0}", "pieces", "whole number of pieces"),
        ("pieces: {link_44: 2}", "pieces", "did you mean link_4"),
        ("pieces: 4", "pieces", "numbers by link"),
    ],
)
def test_mistakes_about_bodies_are_told(line: str, field: str, said: str, tmp_path: Path) -> None:
    file, _ = added(written(tmp_path, urdf_of(KR10, bodies=True)), tmp_path / "arm.yaml")
    file.write_text(file.read_text(encoding="utf-8") + line + "\n", encoding="utf-8")
    with pytest.raises(InputError, match=said) as caught:
        read_robot(file)
    assert caught.value.field == field
    assert caught.value.line is not None


# --- the print ----------------------------------------------------------------------------------------------------


def test_the_cap_is_a_spiral_of_even_steps() -> None:
    rows = np.array([[float(word) for word in line.split()] for line in spiral(60.0).splitlines()])
    np.testing.assert_allclose(np.linalg.norm(rows[:, :3], axis=1), 60.0, atol=1e-4)
    np.testing.assert_allclose(rows[:, :3], 60.0 * rows[:, 3:], atol=1e-3)
    steps = np.linalg.norm(np.diff(rows[:, :3], axis=0), axis=1)
    assert steps.max() < 1.02
    assert steps.min() > 0.7  # its first turns are narrow, and chords shorter than arcs


@pytest.mark.parametrize("outwards", [(0, 0, 1), (1, 0, 0), (0, -1, 0)])
def test_the_nozzle_stands_before_the_flange(outwards: tuple[int, int, int]) -> None:
    nozzle = nozzle_of(np.array(outwards, dtype=float), np.radians(45.0))
    np.testing.assert_allclose(nozzle.tip, 0.1 * np.array(outwards))
    assert nozzle.axis @ np.array(outwards) == pytest.approx(np.cos(np.radians(45.0)))


@pytest.mark.parametrize(("place", "turn"), [((0.5, -0.2, 4.0), np.pi), ((0.0, 0.0, 2.0), 0.0)])
def test_a_trial_is_looked_for_where_the_urdf_has_the_arm(
    place: tuple[float, float, float], turn: float, tmp_path: Path
) -> None:
    """A URDF that begins with the room: the arm hangs 4 m above its floor, or stands 2 m above it."""
    room = '<link name="room"/><joint name="r" type="fixed"><parent link="room"/><child link="base_link"/>'
    room += f'<origin xyz="{place[0]} {place[1]} {place[2]}" rpy="{turn} 0 0"/></joint></robot>'
    _, made = added(written(tmp_path, urdf_of(KR10).replace("</robot>", room)), tmp_path / "arm.yaml")
    found = _places(made.robot, nozzle_of(made.found.outwards, 0.0), cap_for(1.4), 1.4)
    assert len(found) > 0
    away = np.array(found) - place
    assert (away[:, 0] > 0.5).all() and np.abs(away[:, 1]).max() < 1e-9
    assert (away[:, 2] < 0.0).all() if turn else (away[:, 2] > -0.3).all()


def test_an_interrupted_trial_leaves_the_file_and_says_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("planner.robots.command.trial", interrupted)
    assert main(["add", str(written(tmp_path, urdf_of(KR10))), "--out", str(tmp_path / "arm.yaml")]) == 130
    assert "interrupted: the robot's file is complete if its name was printed" in capsys.readouterr().err
    assert (tmp_path / "arm.yaml").exists()


def test_an_interruption_leaves_no_half_of_a_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("planner.robots.adding.touching", interrupted)
    with pytest.raises(KeyboardInterrupt):
        added(written(tmp_path, urdf_of(KR10)), tmp_path / "arm.yaml")
    assert [path.name for path in tmp_path.iterdir()] == ["arm.urdf"]


def test_a_urdf_may_end_in_xml(tmp_path: Path) -> None:
    path = written(tmp_path, urdf_of(KR10)).rename(tmp_path / "arm.xml")
    assert add_robot(path, tmp_path / "arm.yaml") == add_robot(path, tmp_path / "arm.yaml") == tmp_path / "arm.yaml"


@pytest.mark.slow
def test_a_trial_that_ends_leaves_no_waypoints(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file, made = added(written(tmp_path, urdf_of(KR10)), tmp_path / "gp-25.yaml")
    seen = []

    def interrupted(robot: object, file: object, name: str, *_: object) -> None:
        seen.append(name)
        raise KeyboardInterrupt

    monkeypatch.setattr("planner.robots.trial._tried", interrupted)
    with pytest.raises(KeyboardInterrupt):
        trial(made.robot, file, made.found.outwards)
    assert seen == ["gp_25_print"] and not list(tmp_path.glob("*.txt"))


@pytest.mark.slow
@pytest.mark.parametrize("name", ["KUKA KR 10 R1420", "Yaskawa MotoMini", "Stäubli TX2-90"])
def test_an_added_arm_prints(name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = written(tmp_path, urdf_of(ARMS[name], bodies=True))
    assert main(["add", str(path), "--out", str(tmp_path / "arm.yaml")]) == 0
    captured = capsys.readouterr()
    assert "verified: " in captured.err
    shown = [Path(line) for line in captured.out.splitlines()]
    assert [each.name for each in shown] == ["arm.yaml", "arm_print.yaml", "report.html"]
    assert all(each.is_file() for each in shown)


@pytest.mark.slow
def test_an_arm_without_a_closed_form_prints(tmp_path: Path) -> None:
    """Axis 6 passes the meeting of 4 and 5 by 80 mm: a verified plan, joint by joint; RAPID's targets could not tell."""
    text = urdf_of(KR10, bodies=True).replace('xyz="0.08 0.0 0.0"', 'xyz="0.08 0.0 0.08"')
    file, made = added(written(tmp_path, text), tmp_path / "arm.yaml")
    assert made.found.kind == "skew_wrist"
    tried = trial(made.robot, file, made.found.outwards)
    assert tried.plan is not None, tried.reason
    assert tried.plan.verified
    assert "wrist_margin_deg" not in tried.plan.metrics  # joint 5 straight is no singularity of such an arm
    reason = unsupported_in_rapid(tried.plan)
    assert reason is not None
    assert "spherical wrist" in reason


@pytest.mark.slow
def test_an_arm_that_hardly_moves_prints_nothing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    stiff = replace(KR10, ranges=((-1, 1), *KR10.ranges[1:]))
    path = written(tmp_path, urdf_of(stiff, bodies=True))
    assert main(["add", str(path), "--out", str(tmp_path / "arm.yaml")]) == 3
    assert "no print was verified: " in capsys.readouterr().err
    assert (tmp_path / "arm.yaml").is_file()
    assert not list(tmp_path.glob("arm_print.*"))
