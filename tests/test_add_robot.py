"""Robots from Python: of a URDF or of a model of Pinocchio, and what is said of what is neither."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from planner import add_robot, load
from planner.base.errors import InputError, OutputError
from planner.cell.cell import build_cell
from planner.cell.robot import Robot, read_robot
from planner.robots import adding
from tests.public_arms import ARMS, urdf_of

KR10 = urdf_of(ARMS["KUKA KR 10 R1420"], bodies=True)


@pytest.fixture
def urdf(tmp_path: Path) -> Path:
    path = tmp_path / "kr10.urdf"
    path.write_text(KR10, encoding="utf-8")
    return path


def model_of(urdf: Path) -> tuple[pin.Model, pin.GeometryModel]:
    model = pin.buildModelFromUrdf(str(urdf))
    return model, pin.buildGeomFromUrdf(model, str(urdf), pin.GeometryType.COLLISION)


def same_motion(one: Robot, other: Robot) -> None:
    """Both robots bring their tips to the same places."""
    assert one.joint_names == other.joint_names
    rng = np.random.default_rng(3)
    for robot in (one, other):
        assert robot.model.nq == 6
    for _ in range(5):
        q, places = rng.uniform(-2.0, 2.0, 6), []
        for robot in (one, other):
            data = robot.model.createData()
            pin.framesForwardKinematics(robot.model, data, q)
            places.append(data.oMf[robot.model.getFrameId(robot.tip)].homogeneous)
        np.testing.assert_allclose(*places, atol=1e-12)


def test_a_urdf_becomes_a_robot_that_a_problem_may_name(urdf: Path, tmp_path: Path) -> None:
    file = add_robot(urdf, tmp_path / "mine.yaml", language="krl")
    assert read_robot(file).language == "krl"
    problem = load("peer_cap", {"cell.arm": file})
    assert build_cell(problem).arm_robot.name == read_robot(file).name


def test_a_file_that_is_there_is_kept_with_what_was_changed_in_it(urdf: Path, tmp_path: Path) -> None:
    file = add_robot(str(urdf), str(tmp_path / "mine.yaml"))
    text = file.read_text().replace("name: ", "name: My ")
    file.write_text(text)
    assert add_robot(urdf, file) == file and file.read_text() == text
    other = tmp_path / "other.urdf"
    other.write_text(KR10, encoding="utf-8")
    with pytest.raises(OutputError, match="describes another robot"):
        add_robot(other, file)


def test_nobody_sees_half_of_a_robot_s_file(urdf: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of several jobs that run one script, those that come later take a file that is there for the robot's."""
    there: list[bool] = []

    def nothing_touches(*_: object) -> adding.Touching:
        there.append((tmp_path / "mine.yaml").exists())
        return adding.NOTHING

    monkeypatch.setattr(adding, "touching", nothing_touches)
    file = add_robot(urdf, tmp_path / "mine.yaml")
    assert there == [False] and read_robot(file).key == "mine"
    assert {path.name for path in tmp_path.iterdir()} == {"kr10.urdf", "mine.yaml"}


def test_it_is_named_after_the_robot(urdf: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    file = add_robot(urdf)
    assert file.parent == Path() and file.exists() and read_robot(file).tip == "tool0"


@pytest.mark.slow
def test_a_model_of_pinocchio_moves_as_its_urdf(urdf: Path, tmp_path: Path) -> None:
    model, bodies = model_of(urdf)
    file = add_robot(model, tmp_path / "of_model.yaml", bodies=bodies)
    one, other = read_robot(add_robot(urdf, tmp_path / "of_urdf.yaml")), read_robot(file)
    same_motion(one, other)
    np.testing.assert_allclose(one.model.lowerPositionLimit, other.model.lowerPositionLimit)
    np.testing.assert_allclose(one.model.velocityLimit, other.model.velocityLimit)
    assert [len(each) for each in one.bodies] == [len(each) for each in other.bodies]
    assert add_robot(model, file, bodies=bodies) == file
    with pytest.raises(OutputError, match="does not describe this model"):
        add_robot(model, file)  # without its bodies
    with pytest.raises(InputError, match="only xacro files have arguments"):
        add_robot(model, tmp_path / "asked.yaml", arguments={"name": "of_model"})
    assert not list(tmp_path.glob("asked*"))


def test_a_model_with_joints_about_any_axis_and_endless_ones(tmp_path: Path) -> None:
    text = KR10.replace('"joint_6" type="revolute"', '"joint_6" type="continuous"')
    text = text.replace('<axis xyz="0 0 1"/>', '<axis xyz="0 0 1.0"/>', 1)
    urdf = tmp_path / "kr10.urdf"
    urdf.write_text(text, encoding="utf-8")
    model = pin.buildModelFromUrdf(str(urdf))
    file = add_robot(model, tmp_path / "of_model.yaml")
    assert "range_deg" in read_robot(file).assumed and not any(read_robot(file).bodies)
    same_motion(read_robot(add_robot(urdf, tmp_path / "of_urdf.yaml")), read_robot(file))


@pytest.mark.parametrize(
    ("given", "options", "message"),
    [
        ("urdf", {"tip": "tool"}, "no link 'tool' (did you mean tool0?)"),
        ("nowhere.urdf", {}, "nowhere.urdf"),
        ("urdf", {"file": "mine.txt"}, "file: mine.txt is not a name for a robot file (for example my_robot.yaml)"),
        ("urdf", {"language": "krll"}, "language: there is no language 'krll' (did you mean krl?)"),
        ("urdf", {"bodies": 3}, "bodies: a URDF has bodies of its own"),
        (3.5, {}, "urdf: must be a URDF or a model of Pinocchio, not of type float"),
        ("model", {"bodies": "all"}, "bodies: must be a GeometryModel, not of type str"),
        ("manipulator", {}, "no arm of six or seven axes"),
        ("free", {}, "urdf: joint root_joint has 6 degrees of freedom"),
    ],
)
def test_what_is_no_robot_is_said(
    given: Any, options: dict[str, Any], message: str, urdf: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    two = pin.Model()
    two.addJoint(0, pin.JointModelRX(), pin.SE3.Identity(), "only")
    free = pin.buildModelFromUrdf(str(urdf), pin.JointModelFreeFlyer())
    known = {"urdf": urdf, "model": model_of(urdf)[0], "manipulator": two, "free": free}
    before = {path.name for path in tmp_path.iterdir()}
    with pytest.raises(InputError) as error:
        add_robot(known.get(given, given) if isinstance(given, str) else given, **options)
    assert message in str(error.value)
    assert {path.name for path in tmp_path.iterdir()} == before


def test_xacro_names_its_extra(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "xacro", None)
    (tmp_path / "arm.xacro").write_text("<robot/>", encoding="utf-8")
    with pytest.raises(InputError, match=r"beadwise\[xacro\]"):
        add_robot(tmp_path / "arm.xacro", tmp_path / "arm.yaml")
