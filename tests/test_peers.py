"""What peers are given, how they are judged, and what becomes of those that are missing, crash, hang or eat memory."""

from __future__ import annotations

import json
import os
import sys
import time
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from benchmarks.peers import __main__ as command
from benchmarks.peers import judge, results
from benchmarks.peers.case import CASES, LIMITS, ROBOT, ROOM, WAYPOINTS, Case, given, write_case
from benchmarks.peers.one import judged_file
from benchmarks.peers.peer_list import PEERS
from benchmarks.peers.watch import watched
from benchmarks.rows import COLUMNS, Row, Run, append_row, make_row
from planner.collision.scene import NOTHING
from planner.planning.context import PlanningContext
from planner.resolve.strategies import STRATEGIES

ROOT = Path(__file__).resolve().parent.parent
LINES = 200  # waypoints of the small cases


@pytest.fixture(scope="module")
def cap(tmp_path_factory: pytest.TempPathFactory) -> PlanningContext:
    return given(Case("peer_cap", LINES), tmp_path_factory.mktemp("cap"))


@pytest.fixture(scope="module")
def beads(cap: PlanningContext) -> list[np.ndarray]:
    return [path.q for path in STRATEGIES["sqp"](cap.cell, cap.tasks, cap.problem.resolve, NOTHING)]


@pytest.mark.parametrize("name", ["peer_cap", "peer_cylinder"])
def test_a_written_cell_is_the_planners_own(name: str, tmp_path: Path) -> None:
    ready = given(Case(name, LINES), tmp_path)
    write_case(ready, tmp_path)
    model = pin.buildModelFromUrdf(str(tmp_path / ROBOT))
    data = model.createData()
    at = [model.joints[model.getJointId(joint)].idx_q for joint in ready.cell.joint_names]
    for q in np.random.default_rng(0).uniform(-2.0, 2.0, (5, model.nq)):
        pin.framesForwardKinematics(model, data, q)
        part, nozzle = (data.oMf[model.getFrameId(frame)] for frame in ("part", "nozzle"))
        expected = ready.cell.T_part_nozzle(q[at][None])[0]
        np.testing.assert_allclose(part.actInv(nozzle).homogeneous, expected, atol=1e-12)
    np.testing.assert_allclose(model.lowerPositionLimit[at], ready.cell.limits.q_min + ROOM)
    rows = np.loadtxt(tmp_path / WAYPOINTS, delimiter=",", skiprows=1)
    np.testing.assert_allclose(rows[:, 1:4], np.vstack([task.tip for task in ready.tasks]), atol=1e-12)
    np.testing.assert_allclose(rows[:, 4:7], np.vstack([task.frames[:, :, 2] for task in ready.tasks]), atol=1e-12)
    said = json.loads((tmp_path / LIMITS).read_text())
    assert said["joints"] == list(ready.cell.joint_names)
    assert said["opw"]["c2"] == ready.cell.wrist.c2


def test_what_a_peer_runs_imports_nothing_of_the_planner() -> None:
    scripts = [
        ROOT / "benchmarks" / "peers" / name
        for name in ("side.py", "follow.py", *(peer.script for peer in PEERS.values()))
    ]
    for script in scripts:
        imports = [line for line in script.read_text().splitlines() if line.startswith(("import ", "from "))]
        assert not [line for line in imports if line.split()[1].split(".")[0] in ("planner", "benchmarks")]


def test_joints_of_our_own_hold_and_verify(cap: PlanningContext, beads: list[np.ndarray]) -> None:
    row = judge.judge(cap, beads)
    assert row["found"] and row["holds"] is True and row["verified"], row["reason"] or row["holds_reason"]
    assert row["off_waypoints_mm"] < 1e-6
    assert row["at_speed_fraction"] > 0.9
    assert set(row) <= {*COLUMNS, *judge.PATH_COLUMNS}


def test_speeds_without_travel_are_those_of_the_verifier(cap: PlanningContext, beads: list[np.ndarray]) -> None:
    row, whole = judge.speeds(cap, judge.paths_of(cap, beads)), judge.judge(cap, beads)
    assert float(row["deposition_time_s"]) == pytest.approx(float(whole["deposition_time_s"]), rel=0.01)
    assert float(row["at_speed_fraction"]) == pytest.approx(float(whole["at_speed_fraction"]), abs=0.01)


def shifted(q: np.ndarray) -> np.ndarray:
    q[100, 1] += 1e-3
    return q


def jumping(q: np.ndarray) -> np.ndarray:
    q[100:, 5] += 2.0 * np.pi  # the same poses, after a turn from one waypoint to the next
    return q


def outside(q: np.ndarray) -> np.ndarray:
    return q - np.eye(6)[5] * 4.0 * np.pi


@pytest.mark.parametrize(
    ("spoil", "word"), [(shifted, "off at waypoints"), (jumping, "axis between"), (outside, "beyond a joint's range")]
)
def test_joints_that_are_wrong_neither_hold_nor_verify(
    cap: PlanningContext, beads: list[np.ndarray], spoil: object, word: str
) -> None:
    row = judge.judge(cap, [spoil(q.copy()) for q in beads])  # type: ignore[operator]
    assert row["holds"] is False and word in str(row["holds_reason"])
    assert not row["verified"] and row["reason"]


def test_joints_of_other_numbers_are_no_plan(cap: PlanningContext, beads: list[np.ndarray], tmp_path: Path) -> None:
    assert "joints" in str(judge.judge(cap, [q[:-1] for q in beads])["reason"])
    assert "finite" in str(judge.judge(cap, [q * np.nan for q in beads])["reason"])
    np.savetxt(tmp_path / "q.csv", beads[0][:7], delimiter=",", header="j")
    assert "7 waypoints" in str(judged_file(cap, tmp_path)["reason"])


def test_a_peer_that_is_missing_is_a_row_with_its_reason(cap: PlanningContext, tmp_path: Path) -> None:
    row = command.one_peer("pink", "peer_cap@1000", cap, tmp_path / "python", tmp_path, (10.0, 1e3))
    assert "not installed" in str(row["reason"]) and "make peers" in str(row["reason"])


@pytest.mark.slow(keep=2)
@pytest.mark.parametrize(
    ("code", "reason"),
    [
        ("raise ValueError('no solution')", "exit code 1: ValueError: no solution"),
        ("import os; os.kill(os.getpid(), 9)", "killed by signal 9"),
        ("import time; time.sleep(60)", "out of time: more than 1.5 s"),
        ("import time; a = bytearray(300_000_000); time.sleep(60)", "out of memory: more than 0.2 GB"),
        ("pass", ""),
    ],
)
def test_what_becomes_of_a_run_is_said(code: str, reason: str, tmp_path: Path) -> None:
    start = time.monotonic()
    ended = watched([sys.executable, "-c", code], tmp_path / "log.txt", 1.5, 200.0, os.environ)
    assert ended.reason.startswith(reason) and bool(ended.reason) == bool(reason)
    assert time.monotonic() - start < 20.0


def test_results_are_read_again_and_compared(tmp_path: Path) -> None:
    def put(planner: str, strategy: str, seconds: float, verified: bool) -> None:
        values: Row = {"found": True, "verified": verified, "waypoints": 1000, "seconds_resolve": seconds}
        values |= {"seconds_verify": seconds, "waypoints_per_s": 500 / seconds, "at_speed_fraction": 1.0}
        row = make_row(Run("peer_cap@1000", strategy, planner=planner), **values)
        extra: Row = dict.fromkeys(results.EXTRA, 0.25) | {"holds": True, "holds_reason": "", "said": ""}
        append_row(tmp_path / results.ROWS_FILE, row)
        results.append_path(tmp_path / results.PATHS_FILE, row, extra)

    put("beadwise", results.ALONE, 0.5, True)
    put("slow 1.0", "slow", 5.0, True)
    put("fast 1.0", "fast", 0.1, False)
    assert results.done(tmp_path) == {("peer_cap@1000", name) for name in ("beadwise_alone", "slow", "fast")}
    text = results.table(results.read(tmp_path))
    assert (
        "verifies is slow 1.0: Beadwise has 10.0 × the joint paths/s of the fastest at these (slow), and 10.00 × the"
        in text
    )
    assert "holds its path is fast 1.0: Beadwise has 0.2 ×" in text


def test_all_cases_and_scripts_are_there() -> None:
    assert {"peer_cap@10000", "peer_cylinder@10000", "curved_plate"} <= set(CASES)
    assert all((ROOT / "benchmarks" / "peers" / peer.script).is_file() for peer in PEERS.values())
