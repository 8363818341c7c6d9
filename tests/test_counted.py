"""Arms as controllers count them: whatever a URDF's zero, programs speak of the makers' axes and frames."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from simulate_fixtures import program_at

from planner.base.arrays import Array
from planner.cell.cell import Cell, build_cell
from planner.export.fanuc import FANUC
from planner.export.inform import YASKAWA
from planner.export.krl import to_kuka
from planner.export.languages import LANGUAGES
from planner.export.program import ProblemSetup
from planner.export.val3 import STAUBLI
from planner.planning.pipeline import solve
from planner.problem import load_problem
from planner.simulate.controller import played_motion
from tests.public_arms import ARMS, urdf_of
from tests.test_placed_wrist import TEXT

SMALL = ("resolve.rung_mm=10", "resolve.roll_step_deg=30")
OF = {"KUKA": "krl", "Fanuc": "fanuc", "Yaskawa": "inform", "Stäubli": "val3", "ABB": "rapid"}


def cell_of(name: str, folder: Path, *overrides: str, beneath: str = "") -> Cell:
    """A cell with a public arm; beneath: what its URDF has besides, as the last elements of the file."""
    text = urdf_of(ARMS[name]).replace("</robot>", f"{beneath}</robot>")
    (folder / "arm.urdf").write_text(text, encoding="utf-8")
    (folder / "arm.yaml").write_text(TEXT.format(name="arm") + f"language: {OF[name.split()[0]]}\n", encoding="utf-8")
    middle = np.degrees(np.radians([0.5 * (low + high) for low, high in ARMS[name].ranges])).round(1).tolist()
    return build_cell(
        load_problem(
            "peer_cap", [f"cell.arm={folder / 'arm.yaml'}", "cell.limits={}", f"cell.home_deg={middle}", *overrides]
        )
    )


@pytest.mark.parametrize("name", ARMS)
def test_the_cell_as_counted_is_the_same_arm(name: str, tmp_path: Path) -> None:
    cell = cell_of(name, tmp_path, "cell.base_mm=[100, -50, 30]", "cell.base_rpy_deg=[0, 10, 40]")
    twin = cell.as_counted
    assert cell.tells_posture
    assert twin.spherical
    q = np.random.default_rng(0).uniform(-3, 3, (50, 6))
    theta = cell.counted(q)
    np.testing.assert_allclose(twin.arm.poses(theta), cell.arm.poses(q), rtol=0, atol=1e-12)
    T_base_flange = np.linalg.inv(twin.T_world_base) @ twin.arm.poses(theta) @ np.linalg.inv(twin.T_flange_nozzle)
    np.testing.assert_allclose(twin.inverse.poses(theta), T_base_flange, rtol=0, atol=1e-12)
    np.testing.assert_array_equal(twin.inverse.branches(theta), cell.inverse.branches(q))
    assert (twin.limits.q_min < twin.limits.q_max).all()
    inside = cell.counted(np.random.default_rng(1).uniform(cell.limits.q_min, cell.limits.q_max, (50, 6)))
    assert ((inside >= twin.limits.q_min) & (inside <= twin.limits.q_max)).all()


@pytest.mark.parametrize("name", ["KUKA KR 6 R700 sixx", "Fanuc M-10iA"])
def test_an_arm_on_a_track_is_counted_as_one_that_stands(name: str, tmp_path: Path) -> None:
    track = "cell.base={robot: track_3m, free: [rail], home_mm: {rail: 1500}}"
    cell = cell_of(name, tmp_path, track, "cell.base_mm=[100, -50, 30]", "cell.base_rpy_deg=[0, 10, 40]")
    twin = cell.as_counted
    assert twin.spherical
    q = np.random.default_rng(0).uniform(-3, 3, (50, 7))
    theta = cell.counted(q)
    np.testing.assert_array_equal(theta[:, 0], q[:, 0])
    np.testing.assert_allclose(twin.T_part_nozzle(theta), cell.T_part_nozzle(q), rtol=0, atol=1e-12)
    T_base_flange = np.linalg.inv(twin.T_world_base) @ twin.arm.poses(theta) @ np.linalg.inv(twin.T_flange_nozzle)
    np.testing.assert_allclose(twin.inverse.poses(theta), T_base_flange, rtol=0, atol=1e-12)
    np.testing.assert_array_equal(twin.inverse.branches(theta), cell.inverse.branches(q))
    assert (twin.limits.q_min[0], twin.limits.q_max[0]) == (0.0, 3.0)
    for language in ("krl", "rapid"):
        assert LANGUAGES[language].unsupported(ProblemSetup(load_problem("peer_cap"), cell)) is None


def axes_of(name: str, cell: Cell, q: Array) -> Array:
    """What the maker's controller would show."""
    theta = cell.counted(q)
    if name.startswith("KUKA"):
        return to_kuka(theta)
    conventions = {"Fanuc": FANUC, "Yaskawa": YASKAWA, "Stäubli": STAUBLI}
    return conventions[name.split()[0]].counted(theta)


@pytest.mark.parametrize(
    "name", ["KUKA KR 6 R700 sixx", "KUKA KR 16-2", "Yaskawa GP25", "Stäubli TX2-60", "Stäubli RX160"]
)
def test_public_urdfs_count_as_their_makers(name: str, tmp_path: Path) -> None:
    """What URDFs of ROS-Industrial have as joints are the makers' own axes: two ways to the same numbers."""
    q = np.random.default_rng(2).uniform(-1, 1, (20, 6))
    np.testing.assert_allclose(axes_of(name, cell_of(name, tmp_path), q), q, rtol=0, atol=1e-12)


@pytest.mark.parametrize("name", ["KUKA KR 6 R700 sixx", "Yaskawa GP25"])
def test_an_arm_that_hangs_in_its_urdf_is_counted_from_its_own_base(name: str, tmp_path: Path) -> None:
    """A URDF that begins with the room: there axis 1 points down, for the controller it is as of an arm that stands."""
    room = '<link name="room"/><joint name="hung" type="fixed"><parent link="room"/><child link="base_link"/>'
    room += f'<origin xyz="0.2 -0.3 2.5" rpy="{np.pi} 0 0.5"/></joint>'
    cell, standing = cell_of(name, tmp_path, beneath=room), cell_of(name, tmp_path)
    q = np.random.default_rng(2).uniform(-1, 1, (20, 6))
    np.testing.assert_allclose(axes_of(name, cell, q), q, rtol=0, atol=1e-12)
    T_room_base = np.eye(4)
    T_room_base[:3, :3] = Rotation.from_euler("xyz", [np.pi, 0.0, 0.5]).as_matrix()
    T_room_base[:3, 3] = 0.2, -0.3, 2.5
    expected = T_room_base @ standing.as_counted.T_world_base
    np.testing.assert_allclose(cell.as_counted.T_world_base, expected, rtol=0, atol=1e-9)


def test_of_fanuc_the_third_axis_is_coupled_to_the_second(tmp_path: Path) -> None:
    """The controller's J3 is the forearm's angle to the ground, the URDF's joint 3 that to the upper arm."""
    q = np.random.default_rng(2).uniform(-1, 1, (20, 6))
    axes = axes_of("Fanuc M-10iA", cell_of("Fanuc M-10iA", tmp_path), q)
    np.testing.assert_allclose(axes[:, [0, 1, 3, 4, 5]], q[:, [0, 1, 3, 4, 5]], rtol=0, atol=1e-12)
    np.testing.assert_allclose(axes[:, 2], q[:, 2] - q[:, 1], rtol=0, atol=1e-12)


def test_the_simulator_plays_programs_as_they_are_counted(tmp_path: Path) -> None:
    cell, q = cell_of("KUKA KR 10 R1420", tmp_path), np.radians([0.0, -75.0, 110.0, 0.0, 35.0, 0.0])
    assert np.abs(cell.counted(q[None]) - q).max() > 0.1
    motion = played_motion(program_at(cell, q), cell)
    tip = cell.T_part_nozzle(q[None])[0, :3, 3]
    np.testing.assert_allclose(motion.at(0.0)[1], tip, rtol=0, atol=1e-6)
    np.testing.assert_allclose(motion.at(motion.duration)[1], tip + [0.01, 0.0, 0.0], rtol=0, atol=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "home"),
    [
        ("KUKA KR 10 R1420", [0, -75, 110, 0, 35, 0]), ("Fanuc M-10iA", [0, 0, -20, 0, -60, 0]),
        ("Yaskawa GP25", [0, 0, -20, 0, -60, 0]), ("Stäubli TX2-90", [0, 20, 90, 0, 60, 0]),
        ("ABB IRB 2400", [0, 0, 20, 0, 60, 0]),
    ],
)  # fmt: skip
def test_programs_of_public_arms_are_written_and_read_back(name: str, home: list[float], tmp_path: Path) -> None:
    cell_of(name, tmp_path)
    at = {"Stäubli": "[600, 0, 150]"}.get(name.split()[0], "[800, 0, 300]")
    problem = load_problem(
        "peer_cap",
        [
            f"cell.arm={tmp_path / 'arm.yaml'}",
            "cell.limits={}",
            f"cell.home_deg={home}",
            f"cell.bed_mm={at}",
            "cell.fixtures={}",
            *SMALL,
        ],
    )
    plan = solve(problem, "ladder", baseline=False)
    assert plan.verified, [check for check in plan.checks if not check.ok]
    language = LANGUAGES[OF[name.split()[0]]]
    assert language.unsupported(plan) is None
    files = language.write(plan)
    assert language.differences(plan, files) == []
    assert len(language.program(plan, files).linear) > 10
