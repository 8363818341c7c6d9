"""A robot of the user's own, named by its file: the worked example of docs/own_robot.md, and what goes wrong."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
from coal_bodies import nearest_links
from solved import solve_alone

from planner.base.errors import InputError
from planner.cell.cell import build_cell
from planner.cell.solids import Hull
from planner.planning.solve_command import main
from planner.problem import load_problem

DOCS = Path(__file__).resolve().parents[1] / "docs"
EXAMPLE = DOCS / "own_robot"
COARSE = ("layers.count=1", "resolve.rung_mm=10", "resolve.roll_step_deg=30")


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A copy of the example, elsewhere."""
    return Path(shutil.copytree(EXAMPLE, tmp_path / "mine"))


def test_the_page_shows_the_files_that_are_solved_here() -> None:
    page = (DOCS / "own_robot.md").read_text(encoding="utf-8")
    for name in ("my_arm.urdf", "my_arm.yaml", "print.yaml"):
        assert f"`{name}`:" in page
        assert f"\n{(EXAMPLE / name).read_text(encoding='utf-8')}```" in page, f"{name} is not as on the page"


@pytest.mark.slow
def test_the_example_is_solved_and_verified(folder: Path) -> None:
    plan = solve_alone(load_problem(folder / "print.yaml", COARSE))
    assert [check.name for check in plan.checks if not check.ok] == []
    cell = plan.cell
    assert cell.arm_robot.name == "My arm"
    assert [len(own) for own in cell.arm_robot.bodies] == [1] * 7
    assert isinstance(cell.arm_robot.bodies[4][0].solid, Hull)
    np.testing.assert_allclose(np.degrees(cell.limits.q_max[[1, 5]]), [100, 360])  # problem's, then robot's file
    np.testing.assert_allclose(np.degrees(cell.limits.velocity[2]), 200)
    np.testing.assert_allclose(cell.limits.acceleration[:3], [12, 12, 10])
    for q in plan.trajectory.q[::200]:
        assert nearest_links(cell.arm_robot, q)[0] > 5e-3


def test_a_positioner_of_ones_own(folder: Path) -> None:
    robots = DOCS.parent / "robots"
    for name in ("irbp_a250.yaml", "irbp_a250.urdf"):
        shutil.copy(robots / name, folder / f"my_{name}")
    yaml = folder / "my_irbp_a250.yaml"
    yaml.write_text(yaml.read_text().replace("irbp_a250.urdf", "my_irbp_a250.urdf").replace("ABB", "Own"))
    problem = folder / "print.yaml"
    held = "positioner: {robot: my_irbp_a250.yaml, origin_mm: [420, 0, 150], free: [rotation]}"
    problem.write_text(problem.read_text().replace("bed_mm: [480, 0, 150]", held))
    cell = build_cell(load_problem(problem))
    assert cell.holder_robot is not None
    assert cell.holder_robot.name == "Own IRBP A250"


def test_the_file_counts_from_the_problems_folder(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(folder.parent)
    assert build_cell(load_problem("mine/print.yaml")).arm_robot.key == "my_arm"


@pytest.mark.parametrize("field", ["cell.arm", "cell.positioner.robot"])
def test_a_file_that_is_not_there(folder: Path, field: str) -> None:
    path = folder / "print.yaml"
    text = path.read_text().replace("arm: my_arm.yaml", "arm: my_amr.yaml")
    if field != "cell.arm":
        held = "positioner: {robot: my_amr.yaml, origin_mm: [420, 0, 150], free: []}"
        text = path.read_text().replace("bed_mm: [480, 0, 150]", held)
    path.write_text(text)
    with pytest.raises(
        InputError, match=r"no file .*mine/my_amr.yaml \(paths are relative to the problem file's folder"
    ) as caught:
        build_cell(load_problem(path))
    assert caught.value.field == field
    assert caught.value.file == path


def test_mistakes_in_own_files_end_with_exit_code_2(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (folder / "forearm.stl").unlink()
    assert main([str(folder / "print.yaml"), "--quiet", "--out", str(folder / "out")]) == 2
    said = capsys.readouterr().err
    assert "my_arm.urdf:18: link link_4: no mesh forearm.stl" in said
    assert "Traceback" not in said
    assert not (folder / "out").exists()
