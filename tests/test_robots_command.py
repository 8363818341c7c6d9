"""`python -m planner.robots`: what it lists is what the robots' files and the makers say."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from planner.base.shipped import ROBOTS
from planner.cell.robot import read_robot, robot_names
from planner.robots.listing import main, reach

MAKERS_REACH = {  # m: to the wrist, product specifications of ABB
    "irb140": 0.810, "irb1600_12": 1.225, "irb1600_145": 1.450, "irb1200_09": 0.901, "irb1200_07": 0.703, "irb2600": 1.653,
}  # fmt: skip


@pytest.fixture(autouse=True)
def wide(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "120")


@pytest.mark.parametrize("key", MAKERS_REACH)
def test_reach_is_the_makers(key: str) -> None:
    assert reach(read_robot(ROBOTS / f"{key}.yaml")) == pytest.approx(MAKERS_REACH[key], abs=1.5e-3)


def test_reach_keeps_to_the_ranges() -> None:
    """The iiwa lies stretched out horizontally: shoulder to flange."""
    one = read_robot(ROBOTS / "iiwa.yaml")
    assert reach(one) == pytest.approx(0.42 + 0.40 + 0.126, abs=1e-4)
    held = np.zeros(7)
    one.model.lowerPositionLimit, one.model.upperPositionLimit = held - 0.1, held + 0.1
    assert reach(one) == pytest.approx(0.42 * np.sin(0.1) + 0.40 * np.sin(0.2) + 0.126 * np.sin(0.3), abs=1e-4)


def test_what_is_no_arm_has_no_reach() -> None:
    assert reach(read_robot(ROBOTS / "irbp_a250.yaml")) is None


@pytest.mark.slow
def test_all_robots_are_listed(capsys: pytest.CaptureFixture[str]) -> None:
    assert main([]) == 0
    out = capsys.readouterr().out
    for key in robot_names():
        assert f"│ {key} " in out
    assert "reach 810 mm (axis 1 to wrist)" in out
    assert "±181 200 turns deg*" in out
    assert "URDF: irb140.urdf" in out
    assert out.count("bodies") == len(robot_names())


def test_one_robot_in_detail(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["irb140"]) == 0
    out = capsys.readouterr().out
    assert "* assumed: acceleration_rad_s2, jerk_rad_s3, thickness of links" in out
    joint = next(line for line in out.splitlines() if "joint_3" in line)
    assert joint.replace("│", " ").split() == ["joint_3", "-230…50", "260", "15", "750"]
    body = next(line for line in out.splitlines() if "upper arm" in line)
    assert "joint_2" in body
    assert "box 100 x 120 x 460" in body


def test_the_users_own_robot_without_bodies(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    text = (ROBOTS / "irb140.yaml").read_text(encoding="utf-8")
    urdf = (ROBOTS / "irb140.urdf").read_text(encoding="utf-8").splitlines()
    (tmp_path / "irb140.urdf").write_text("\n".join(row for row in urdf if "<collision" not in row), encoding="utf-8")
    (tmp_path / "own.yaml").write_text(text, encoding="utf-8")
    assert main([str(tmp_path / "own.yaml")]) == 0
    assert "no bodies: its collisions are not checked" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("irb14", "did you mean irb140?"),
        ("xyzzy", "iiwa, irb1200_07"),
        ("nowhere.yaml", "nowhere.yaml: cannot be read"),
    ],
)
def test_an_unknown_robot(name: str, said: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([name]) == 2
    captured = capsys.readouterr()
    assert said in captured.err
    assert captured.out == ""
