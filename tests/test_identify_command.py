"""The commands of `identify`, copies of robots' files, and the lag of the simulated robot."""

from __future__ import annotations

import re
import time as clock
from pathlib import Path

import numpy as np
import pytest

from benchmarks.recordings import Recording, TrueRobot, commands, recorded, write_recording
from planner.base.arrays import Array
from planner.base.errors import EXIT_INPUT, EXIT_NOT_VERIFIED, EXIT_VERIFIED, OutputError
from planner.cell.cell import build_cell
from planner.cell.robot import read_robot
from planner.feedback.identify_command import main
from planner.feedback.identify_delay import fit_delay
from planner.feedback.identify_fit import fit_joints
from planner.feedback.identify_match import match
from planner.feedback.identify_program import (
    asked_text,
    read_asked,
)
from planner.feedback.identify_robot_file import robots_of, write_measured
from planner.feedback.recordings import RobotLog, read_log
from planner.problem import load_problem
from tests.identify_fixtures import (
    NOISE,
    asked_of,
    cell_of,
    header,
    truth_of,
)

# ---- robots' files -------------------------------------------------------------------------------------------------


def _fitted(tmp_path: Path, name: str, joints: tuple[int, ...]) -> tuple[RobotLog, list, dict]:
    _, cell = cell_of(name)
    asked = asked_of(name, joints=joints, most=60.0)
    recording = recorded(asked, truth_of(cell, delay=0.02))
    file = write_recording(tmp_path / "run.csv", recording, header(cell, commanded=True), commanded=True)
    read = read_log(file, cell)
    limits = cell.limits
    log, fits = fit_joints(match(read, asked), asked, (limits.velocity, limits.acceleration, limits.jerk))
    return read, fits, {fit.joint: fit_delay(log, asked, fit.joint) for fit in fits}


@pytest.mark.slow
def test_robots_files_are_copied_with_what_was_measured(tmp_path: Path) -> None:
    problem, cell = cell_of("cylinder_logo")
    read, fits, delays = _fitted(tmp_path, "cylinder_logo", (1, 6))
    robots, truth = robots_of(problem, cell), truth_of(cell)
    written = write_measured(robots, fits, delays, read.file, tmp_path / "mine")
    assert [path.name for path in written] == ["irb140_measured.yaml", "irbp_a250_measured.yaml"]
    arm, table = map(read_robot, written)
    old = read_robot(robots[0].path)
    assert arm.acceleration[1] == pytest.approx(truth.acceleration[1], rel=0.01)
    assert table.jerk[1] == pytest.approx(truth.jerk[6], rel=0.01) and table.jerk[0] == 250.0
    np.testing.assert_array_equal(arm.acceleration[[0, 2, 3, 4, 5]], old.acceleration[[0, 2, 3, 4, 5]])
    assert arm.measured.endswith("acceleration_rad_s2 of joint_2; jerk_rad_s3 of joint_2; from run.csv")
    assert "acceleration_rad_s2" in arm.assumed  # of the other joints it still is
    text, before = written[0].read_text(), robots[0].path.read_text()
    lost = [line for line in before.splitlines() if line not in text.splitlines()]
    assert {line.partition(":")[0] for line in lost} == {"urdf", "assumed", "acceleration_rad_s2", "jerk_rad_s3"}
    assert re.search(r"# joint_2: speed .* follows 20\.[0-9] ms late", text)
    with pytest.raises(OutputError, match="is there already"):
        from planner.feedback.identify_robot_file import check_targets

        check_targets(robots, tmp_path / "mine")


@pytest.mark.slow
def test_a_measured_file_is_planned_with_and_measured_again(tmp_path: Path) -> None:
    problem, cell = cell_of("cylinder_logo")
    read, fits, delays = _fitted(tmp_path, "cylinder_logo", (3,))
    (path,) = write_measured(robots_of(problem, cell), fits, delays, read.file, tmp_path / "mine")
    again = load_problem("cylinder_logo", (f"cell.arm={path}",))
    assert build_cell(again).limits.acceleration[3] == pytest.approx(truth_of(cell).acceleration[3], rel=0.01)
    (second,) = write_measured(robots_of(again, build_cell(again)), fits, delays, read.file, tmp_path / "later")
    assert second.name == "irb140_measured.yaml" and "; before: " in read_robot(second).measured
    assert second.read_text().count("urdf:") == 1


@pytest.mark.slow
def test_nothing_is_left_where_a_file_cannot_be_written(tmp_path: Path) -> None:
    problem, cell = cell_of("cylinder_logo")
    read, fits, delays = _fitted(tmp_path, "cylinder_logo", (1, 6))
    (tmp_path / "irbp_a250_measured.yaml").write_text("mine")
    with pytest.raises(OutputError):
        write_measured(robots_of(problem, cell), fits, delays, read.file, tmp_path)
    assert not (tmp_path / "irb140_measured.yaml").exists()
    assert (tmp_path / "irbp_a250_measured.yaml").read_text() == "mine"


# ---- the commands --------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_the_commands_together(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["write", "cylinder_logo", "--most", "40"]) == EXIT_VERIFIED
    assert "joint_1" in capsys.readouterr().out
    problem, cell = cell_of("cylinder_logo")
    asked = read_asked(Path("out/cylinder_logo_identify/cylinder_logo_asked.json"), problem, cell)
    recording = recorded(asked, truth_of(cell, delay=0.02))
    write_recording(Path("run.csv"), recording, header(cell, commanded=True), commanded=True)
    assert main(["read", "run.csv", "cylinder_logo"]) == EXIT_VERIFIED
    said = capsys.readouterr().out
    assert "off the path of the commands: tip not shown" in said
    assert "joints follow their commands 20.0" in said and "irb140_measured.yaml" in said
    assert main(["read", "run.csv", "cylinder_logo"]) == EXIT_INPUT
    assert "is there already" in capsys.readouterr().err
    assert main(["read", "run.csv", "peer_cap"]) == EXIT_INPUT


def test_words_that_are_no_command(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["raed"]) == EXIT_INPUT and "did you mean read?" in capsys.readouterr().err
    assert main([]) == EXIT_INPUT
    assert main(["--help"]) == EXIT_VERIFIED and "write" in capsys.readouterr().out


@pytest.mark.slow
def test_a_recording_that_tells_nothing_writes_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """A robot that follows the points of a trajectory shows what these asked, not what it can do."""
    monkeypatch.chdir(tmp_path)
    _, cell = cell_of("peer_cap")
    asked = asked_of("peer_cap", "joint_trajectory", joints=(5,))
    limits = cell.limits
    recording = recorded(asked, TrueRobot(limits.velocity, limits.acceleration, limits.jerk))
    write_recording(Path("run.csv"), recording, header(cell))
    Path("peer_cap_asked.json").write_text(asked_text(asked))
    code = main(["read", "run.csv", "peer_cap"])
    said = capsys.readouterr().out
    assert code == EXIT_NOT_VERIFIED and "nothing written" in said and "as asked" in said
    assert not list(tmp_path.glob("*.yaml"))


# ---- the simulator of externally guided motion ---------------------------------------------------------------------


@pytest.mark.slow
def test_the_lag_of_the_simulated_egm_robot_is_found(tmp_path: Path) -> None:
    from planner.link.egm_wire import egm_wire
    from planner.simulate.egm import PERIOD, TIME_CONSTANT, EgmRobot

    _, cell = cell_of("cylinder_logo")
    asked = asked_of("cylinder_logo", joints=(2,), most=20.0)
    t, told = commands(asked, truth_of(cell))
    told = told[:: round(PERIOD / (t[1] - t[0]))]

    def run() -> tuple[Array, Array, Array]:
        rows = []
        with egm_wire("127.0.0.1", 0) as wire:
            # its station has two axes, of which the cell's is the second
            stand = np.degrees(np.insert(told[0], 6, 0.0))
            robot = EgmRobot(("127.0.0.1", wire.port), stand, pace=5.0)
            try:
                until = clock.monotonic() + 60.0
                while len(rows) < len(told) and clock.monotonic() < until:
                    if (state := wire.newest()) is not None:
                        reference = np.insert(told[len(rows)], 6, 0.0)
                        wire.send(reference)
                        rows.append((state.clock, np.delete(state.joints, 6), told[len(rows)]))
            finally:
                robot.close()
        stamps, joints, references = (np.array(column) for column in zip(*rows, strict=True))
        return stamps, joints, references

    # the robot waits for nobody: what a busy machine was late for is run once more
    stamps, joints, references = run()
    for _ in range(4):
        if np.diff(stamps).max() < 3.0 * PERIOD:
            break
        stamps, joints, references = run()
    joints = joints + np.random.default_rng(1).normal(0.0, NOISE, joints.shape)
    file = write_recording(
        tmp_path / "run.csv", Recording(stamps, joints, references), header(cell, commanded=True), commanded=True
    )
    log = match(read_log(file, cell), asked)
    found = fit_delay(log, asked, 2)
    # a reference is held for a period: half of one on average, and one more where a busy machine answers late
    assert found is not None and 0.0 < found.total - TIME_CONSTANT < 1.5 * PERIOD + 2e-3
    assert found.lag == pytest.approx(TIME_CONSTANT, abs=2e-3)
