"""The written files alone: nothing here uses the project's code but to write them.

Metrics are computed anew from plan.json and trajectory.csv, poses by a product of exponentials.
"""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
import pytest
from scipy.interpolate import CubicSpline
from solved import bed_plan, small_plan

from planner.base.arrays import Array
from planner.base.progress import STAGES
from planner.plan import Plan
from planner.planning.files import write


class Files:
    """plan.json and trajectory.csv, and a product of exponentials of what they say."""

    def __init__(self, folder: Path, made: Plan) -> None:
        self.made = made  # where a test needs what the files do not hold
        self.plan = json.loads((folder / "plan.json").read_text(encoding="utf-8"))
        with (folder / "trajectory.csv").open(encoding="utf-8") as stream:
            reader = csv.reader(stream)
            self.names = next(reader)
            self.table = np.array([[float(value) for value in row] for row in reader])
        self.metrics = self.plan["metrics"]
        self.joints = self.plan["cell"]["joints"]
        self.q = np.column_stack([self[joint["name"]] for joint in self.joints])
        self.dt = self["t_s"][1] - self["t_s"][0]
        self.tip = np.column_stack([self[name] for name in ("x_mm", "y_mm", "z_mm")]) * 1e-3
        self.deposit = self["deposit"] == 1

    def __getitem__(self, name: str) -> Array:
        return self.table[:, self.names.index(name)]

    def limit(self, name: str) -> Array:
        return np.array([joint[name] for joint in self.joints])

    def pose(self, moves: str) -> tuple[Array, list[tuple[Array, Array]]]:
        """Poses (n, 4, 4) in the world, and for each joint its axis' direction and a point on it (n, 3)."""
        T = np.tile(np.eye(4), (len(self.q), 1, 1))
        axes = []
        for j, joint in enumerate(self.joints):
            if joint["moves"] != moves:
                continue
            assert joint["type"] == "revolute"
            w, p = np.array(joint["direction"]), np.array(joint["origin_m"])
            axes.append((T[:, :3, :3] @ w, T[:, :3, :3] @ p + T[:, :3, 3]))
            K = np.array([[0, -w[2], w[1]], [w[2], 0, -w[0]], [-w[1], w[0], 0]])
            q = self.q[:, j, None, None]
            E = np.tile(np.eye(4), (len(q), 1, 1))
            E[:, :3, :3] = np.eye(3) + np.sin(q) * K + (1.0 - np.cos(q)) * (K @ K)
            E[:, :3, 3] = p - E[:, :3, :3] @ p
            T = T @ E
        return T @ np.array(self.plan["cell"][f"T_world_{moves}_zero"]), axes

    def nozzle_in_part(self) -> tuple[Array, Array]:
        """Tip (n, 3) and axis (n, 3) in the part frame."""
        nozzle, part = self.pose("nozzle")[0], self.pose("part")[0]
        R = np.swapaxes(part[:, :3, :3], 1, 2)
        tip = (R @ (nozzle[:, :3, 3] - part[:, :3, 3])[:, :, None])[:, :, 0]
        return tip, (R @ nozzle[:, :3, 2, None])[:, :, 0]

    def sigma(self) -> Array:
        """Smallest singular values of the arm's geometric Jacobian at the nozzle tip."""
        T, axes = self.pose("nozzle")
        J = np.stack([np.hstack([np.cross(w, T[:, :3, 3] - p), w]) for w, p in axes], axis=2)
        assert J.shape[1:] == (6, 6)
        return np.linalg.svd(J, compute_uv=False).min(axis=1)


@pytest.fixture(scope="module", params=[small_plan, bed_plan], ids=["positioner", "bed"])
def files(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Files:
    made = request.param()
    folder = tmp_path_factory.mktemp("written")
    write(made, folder)
    return Files(folder, made)


def test_the_files_have_the_promised_fields(files: Files) -> None:
    promised = "problem strategy verified checks metrics dips events cell timing_s versions"
    assert set(promised.split()) <= set(files.plan)
    metrics = """
    waypoints beads layers deposited_length_mm deposition_time_s ideal_deposition_time_s print_time_s at_speed_fraction
    speed_min_mm_s speed_max_mm_s sigma_min sigma_p01 wrist_margin_deg joint_limit_margin_deg velocity_ratio_max
    acceleration_ratio_max jerk_ratio_max position_error_max_mm axis_error_max_deg path_deviation_max_mm
    tip_clearance_min_mm nozzle_clearance_min_mm nozzle_pressed_max_mm arm_clearance_min_mm robot_clearance_min_mm clearance_min_mm
    branch_changes_in_deposition extruded_mm extruded_volume_mm3 bound_deposition_time_s bound_any_path_s bound_gap_fraction flow_error_max
    """
    assert set(metrics.split()) == set(files.metrics)
    assert {"load", "toolpath", "resolve", "timing", "travel", "verify", "export", "total"} <= set(
        files.plan["timing_s"]
    )
    assert set(STAGES) == set(files.plan["timing_s"]) - {"baseline", "export", "total"}
    joint = "name type moves origin_m direction q_min q_max v_max a_max j_max"
    assert all(set(entry) == set(joint.split()) for entry in files.joints)
    assert all(set(check) == {"name", "worst", "limit", "unit", "ok", "where"} for check in files.plan["checks"])
    columns = "t_s bead layer deposit s_mm x_mm y_mm z_mm ax ay az speed_mm_s flow_mm3_s e_mm"
    assert files.names == [*columns.split(), *(joint["name"] for joint in files.joints)]
    assert files.plan["verified"] is True


def test_written_poses_are_those_of_the_written_joints(files: Files) -> None:
    tip, axis = files.nozzle_in_part()
    assert np.abs(tip - files.tip).max() * 1e3 < 2e-6
    assert np.abs(axis - np.column_stack([files[name] for name in ("ax", "ay", "az")])).max() < 2e-9


def test_written_singularity_margins(files: Files) -> None:
    sigma = files.sigma()[files.deposit]
    assert files.metrics["sigma_min"] == pytest.approx(sigma.min(), rel=1e-9)
    assert files.metrics["sigma_p01"] == pytest.approx(np.quantile(sigma, 0.01), rel=1e-9)
    wrist = np.degrees(np.abs(files["joint_5"][files.deposit])).min()
    assert files.metrics["wrist_margin_deg"] == pytest.approx(wrist, rel=1e-9)


def test_written_joint_ratios(files: Files) -> None:
    q, dt = files.q, files.dt
    velocity = (q[2:] - q[:-2]) / (2.0 * dt)
    acceleration = (q[2:] - 2.0 * q[1:-1] + q[:-2]) / dt**2
    jerk = (q[4:] - 2.0 * q[3:-1] + 2.0 * q[1:-3] - q[:-4]) / (2.0 * dt**3)
    for values, limit, metric, accuracy in (
        (velocity, "v_max", "velocity_ratio_max", 1e-8),
        (acceleration, "a_max", "acceleration_ratio_max", 1e-6),
        (jerk, "j_max", "jerk_ratio_max", 1e-4),
    ):
        ratio = (np.abs(values) / files.limit(limit)).max()
        assert files.metrics[metric] == pytest.approx(ratio, rel=accuracy), metric
    margin = np.minimum(q - files.limit("q_min"), files.limit("q_max") - q).min()
    assert files.metrics["joint_limit_margin_deg"] == pytest.approx(np.degrees(margin), abs=1e-8)


def test_written_speeds(files: Files) -> None:
    speed = np.linalg.norm(np.gradient(files.nozzle_in_part()[0], files.dt, axis=0), axis=1) * 1e3
    on = files.deposit
    off = np.abs(speed - files["speed_mm_s"])[on]
    assert np.quantile(off, 0.9) < 0.05
    assert off.max() < 2.0  # at a corner, where speed changes within a sample
    near = on & (np.abs(speed - 40.0) <= 0.8)
    assert files.metrics["at_speed_fraction"] == pytest.approx(speed[near].sum() / speed[on].sum(), abs=0.005)
    least = np.minimum(speed, files["speed_mm_s"])[on].min()
    assert files.metrics["speed_min_mm_s"] == pytest.approx(least, rel=0.01)  # chords cut corners
    assert files.metrics["speed_min_mm_s"] <= files["speed_mm_s"][on].min() + 1e-3
    assert files.metrics["speed_max_mm_s"] == pytest.approx(speed[on].max(), rel=0.001)
    assert files.metrics["deposition_time_s"] == pytest.approx(on.sum() * files.dt)
    assert files.metrics["print_time_s"] == pytest.approx(files["t_s"][-1])
    assert files.metrics["ideal_deposition_time_s"] == pytest.approx(files.metrics["deposited_length_mm"] / 40.0)


def test_written_material(files: Files) -> None:
    flow = files["flow_mm3_s"]
    assert (flow[~files.deposit] == 0.0).all()
    laid = np.cumsum(flow) * files.dt
    assert files.metrics["extruded_volume_mm3"] == pytest.approx(laid[-1], rel=1e-6)
    assert laid[-1] == pytest.approx(0.6 * 0.5 * files.metrics["deposited_length_mm"], rel=1e-3)
    filament = np.pi * 1.75**2 / 4.0
    assert files.metrics["extruded_mm"] == pytest.approx(laid[-1] / filament, rel=1e-6)
    # both count the same material, at most a sample's share apart
    assert np.abs(files["e_mm"] - laid / filament).max() < 40.0 * 0.3 * files.dt / filament


def test_written_beads(files: Files) -> None:
    for bead in range(int(files.metrics["beads"])):
        s = files["s_mm"][files["bead"] == bead]
        assert (np.diff(s) > 0.0).all()
        along = np.linalg.norm(np.diff(files.tip[files["bead"] == bead], axis=0), axis=1).sum() * 1e3
        assert along == pytest.approx(s[-1] - s[0], rel=2e-3)
    last = [files["s_mm"][files["bead"] == bead].max() for bead in range(3)]
    assert sum(last) == pytest.approx(files.metrics["deposited_length_mm"], abs=3 * 0.17)


def test_written_position_error(files: Files) -> None:
    """Against the rounded path, which the files do not hold, evaluated by its own arc length."""
    off = 0.0
    for i, bead in enumerate(files.made.toolpath.beads):
        at = files["bead"] == i
        off = max(
            off,
            np.linalg.norm(CubicSpline(bead.s, bead.points)(files["s_mm"][at] * 1e-3) - files.tip[at], axis=1).max(),
        )
    assert files.metrics["position_error_max_mm"] == pytest.approx(off * 1e3, abs=2e-5)


def test_written_nozzle_stands_upright_on_the_cylinder(files: Files) -> None:
    """Against the problem file's own figures: radius 34 mm, centre (31.4, 37) mm, one layer of 0.5 mm."""
    on = files.deposit
    radial = files.tip[on, :2] - np.array([0.0314, 0.037])
    r = np.linalg.norm(radial, axis=1)
    assert r == pytest.approx(0.0345, abs=1e-7)
    axis = np.column_stack([files["ax"], files["ay"], files["az"]])[on]
    assert np.abs(axis[:, 2]).max() < 1e-6
    assert np.abs(axis[:, :2] + radial / r[:, None]).max() < 1e-6
