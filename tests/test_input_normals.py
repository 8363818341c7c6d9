"""The nozzle's axis against a file's own normals: what smoothing turns is bounded, and what turns it further is found."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from planner.base.arrays import Array
from planner.base.errors import InputError
from planner.planning.pipeline import load, solve
from planner.toolpath.build import build_toolpath
from planner.verify.checks import Findings
from planner.verify.input_normals import file_normals
from planner.verify.verdict import verify

TEXT = """name: try
cell:
  arm: irb2600
  nozzle: {{tip_mm: [0, 0, 200], axis: [0, 0, 1], diameter_mm: 0.8}}
  home_deg: [0, 0, 0, 0, 60, 0]
  positioner: {{robot: irbp_a250, origin_mm: [1100, 0, 600], free: [rotation]}}
layers: {{source: {{waypoints: path.txt{more}}}}}
process: {{speed_mm_s: 20, travel_speed_mm_s: 200, bead: {{width_mm: 0.8, height_mm: 0.5}}, cones: {{nozzle_normal_deg: {lean}}}}}
"""


def problem_of(folder: Path, points: Array, normals: Array, more: str = "", lean: float = 0.0) -> Any:
    """points (n, 3) [mm] and normals (n, 3) as they stand in the file."""
    np.savetxt(folder / "path.txt", np.hstack([points, normals]), fmt="%.9f")
    (folder / "try.yaml").write_text(TEXT.format(more=more, lean=lean))
    return load(folder / "try.yaml")


def line(noise_deg: float = 0.0) -> tuple[Array, Array]:
    """31 waypoints along x, 0.5 mm apart, their normals jittering about straight up."""
    x = np.arange(0.0, 15.01, 0.5)
    lean = np.radians(noise_deg) * np.random.default_rng(2).normal(size=(2, len(x)))
    normals = np.column_stack([*lean, np.ones(len(x))])
    return np.column_stack([x, 0 * x, 0 * x + 0.5]), normals / np.linalg.norm(normals, axis=1)[:, None]


def found(problem: Any, tip: Array, axis: Array, bead: Array | None = None) -> Findings:
    """What is found of a motion whose tip [m] and axis are at (n, 3), all of it printing."""
    n = len(tip)
    beads = np.zeros(n, dtype=np.int64) if bead is None else bead
    t = SimpleNamespace(deposit=beads >= 0, bead=beads, t=0.004 * np.arange(n), s=np.zeros(n))
    judged: Any = SimpleNamespace(
        problem=problem, trajectory=t, motion=SimpleNamespace(tip=tip, axis=axis), drawn_tip=tip
    )
    return file_normals(judged)


def moving(points: Array, normals: Array, n: int = 200) -> tuple[Array, Array]:
    """Tips [m] and axes (n, 3) along waypoints."""
    at, k = np.linspace(0.0, len(points) - 1.0, n), np.arange(len(points))
    tip, axis = (np.column_stack([np.interp(at, k, column) for column in rows.T]) for rows in (points, normals))
    return 1e-3 * tip, -axis / np.linalg.norm(axis, axis=1)[:, None]


def test_a_motion_that_passes_no_waypoint_is_not_verified(tmp_path: Path) -> None:
    points, normals = line(1.0)
    problem = problem_of(tmp_path, points, normals)
    tip, axis = moving(points, normals)
    (kept,) = found(problem, tip + problem.layers.source.origin, axis).checks
    (check,) = found(problem, tip + problem.layers.source.origin + [0.0, 0.01, 0.0], axis).checks
    assert kept.ok and not check.ok and check.worst == 180.0
    problem.layers.source.waypoints.unlink()
    with pytest.raises(InputError, match="cannot be read again"):
        found(problem, tip, axis)


@pytest.mark.parametrize("other", [(0.0, 0.995, 0.1), (0.0, 0.995, -0.1), (0.0, 0.0, -1.0)])
def test_of_waypoints_at_one_place_the_first_counts(tmp_path: Path, other: tuple[float, float, float]) -> None:
    """Repetitions with normals of their own are not judged, nor do they turn others round; the first of them is judged."""
    points, normals = line(1.0)
    twice = np.repeat(points, 2, axis=0)
    spoilt = np.repeat(normals, 2, axis=0)
    spoilt[1::2] = other
    problem = problem_of(tmp_path, twice, spoilt)
    tip, axis = moving(points, normals)
    (kept,) = found(problem, tip, axis).checks
    assert kept.ok and kept.worst < 0.5
    (check,) = found(problem, tip, turned(axis, slice(100, 130), 3.2)).checks
    assert not check.ok


def turned(axis: Array, where: slice, deg: float) -> Array:
    out = axis.copy()
    c, s = np.cos(np.radians(deg)), np.sin(np.radians(deg))
    out[where] = axis[where] @ np.array([[1, 0, 0], [0, c, s], [0, -s, c]])
    return out


@pytest.mark.parametrize(
    ("more", "lean", "bound"),
    [("", 0.0, 3.0), (", smooth_normals_deg: 1.5", 0.0, 1.5), ("", 4.0, 4.0), (", smooth_normals_deg: 1", 4.0, 5.0)],
)
def test_the_axis_may_be_turned_by_what_is_stated_and_no_more(
    tmp_path: Path, more: str, lean: float, bound: float
) -> None:
    problem = problem_of(tmp_path, *line(), more, lean)
    tip, axis = moving(*line())
    for deg, ok in ((0.0, True), (bound - 0.1, True), (bound + 0.1, False), (-bound - 0.1, False), (90.0, False)):
        result = found(problem, tip, turned(axis, slice(100, 130), deg))
        (check,) = result.checks
        assert check.ok is ok, deg
        assert check.limit == pytest.approx(bound)
        assert check.worst == pytest.approx(abs(deg), abs=1e-3)
        assert result.metrics["file_normal_max_deg"] == pytest.approx(abs(deg), abs=1e-3)
        assert deg == 0.0 or 100 <= check.sample < 130


def test_nothing_is_checked_where_nothing_may_turn_the_nozzle(tmp_path: Path) -> None:
    problem = problem_of(tmp_path, *line(), ", smooth_normals_deg: 0")
    assert found(problem, *moving(*line())) == Findings()
    assert file_normals(SimpleNamespace(problem=load("cylinder_logo"))) == Findings()  # type: ignore[arg-type]


@pytest.mark.parametrize(("up", "order", "signs"), [("y", [0, 2, 1], [1, 1, -1]), ("x", [2, 0, 1], [1, 1, 1])])
def test_units_axes_and_senses_are_the_files(tmp_path: Path, up: str, order: list[int], signs: list[int]) -> None:
    points, normals = line(0.5)
    as_written = [rows[:, order] * signs for rows in (1e-3 * points - [0, 0, 2e-3], -7.0 * normals)]
    problem = problem_of(tmp_path, *as_written, f", unit: m, up: {up}, normals: inward, origin_mm: [0, 0, 2]")
    (check,) = found(problem, *moving(points, normals, 601)).checks
    assert check.ok and check.worst < 0.01


def test_waypoints_that_are_not_printed_are_not_judged(tmp_path: Path) -> None:
    problem = problem_of(tmp_path, *line())
    tip, axis = moving(*line())
    travel = np.where(np.arange(len(tip)) < 100, 0, -1)
    (check,) = found(problem, tip, turned(axis, slice(110, 200), 20.0), travel).checks
    assert check.ok


@pytest.mark.parametrize("stray", [0, 1, 7, -2, -1])
def test_a_normal_the_other_way_is_one_turned_round(tmp_path: Path, stray: int) -> None:
    points, normals = line(
        noise_deg=0.5
    )  # the sum of a neighbour and the stray one is next to nothing, whatever way it points
    normals[stray] *= -1.0
    problem = problem_of(tmp_path, points, normals)
    assert found(problem, *moving(*line())).checks[0].ok
    assert not found(problem, *moving(points, -line()[1])).checks[0].ok


def test_another_bead_says_nothing_of_which_way_a_normal_points(tmp_path: Path) -> None:
    points, (ahead, aside) = line()[0], np.array([[0.0, 0.8, 0.6], [0.0, -0.9, 0.44]])
    first, second = points, points + [0.0, 30.0, 0.0]
    both = np.vstack([first, second])
    normals = np.vstack([np.tile(ahead, (len(first), 1)), np.tile(aside, (len(second), 1))])
    problem = problem_of(tmp_path, both, normals)
    tips, axes = zip(moving(first, normals[: len(first)]), moving(second, normals[len(first) :]), strict=True)
    bead = np.repeat([0, 1], [len(tips[0]), len(tips[1])])
    (check,) = found(problem, np.vstack(tips), np.vstack(axes), bead).checks
    assert check.ok and check.worst < 0.01


def test_where_a_corner_is_rounded_normals_may_be_a_mean_of_those_around_it(tmp_path: Path) -> None:
    x = np.arange(0.0, 20.01, 0.5)
    bent = np.radians(np.where(x < 10.0, 0.0, 8.0))  # a roof: at its ridge the normal turns by 8 degrees
    points = np.column_stack([np.minimum(x, 10.0), np.maximum(x - 10.0, 0.0), 0 * x + 0.5])
    normals = np.column_stack([np.sin(bent), 0 * x, np.cos(bent)])
    problem = problem_of(tmp_path, points, normals)
    rounded = points.copy()
    rounded[20] += [-0.1, 0.1, 0.0]
    mean = normals.copy()
    mean[18:22] = normals[18:22].mean(axis=0) / np.linalg.norm(normals[18:22].mean(axis=0))
    assert found(problem, *moving(rounded, mean, 2000)).checks[0].ok
    assert not found(problem, *moving(points, mean, 2000)).checks[0].ok  # there is no rounding that would explain it


@pytest.mark.slow
def test_a_plan_by_smoothed_normals_keeps_to_the_file_that_it_was_made_of(tmp_path: Path) -> None:
    problem = problem_of(tmp_path, *line(0.8))
    plan = solve(problem, "ladder", baseline=False)
    assert plan.verified and "normals smoothed" in plan.toolpath.notes[0]
    (check,) = (check for check in plan.checks if check.name == "axis near the file's normals")
    assert 0.5 < check.worst <= 3.0
    # all else holds the same if the file says that the surface leans by 5 degrees here
    points, normals = line(0.8)
    normals[10:14] = turned(normals, slice(10, 14), 5.0)[10:14]
    other = problem_of(tmp_path, points, normals)
    report = verify(other, plan.cell, plan.toolpath, plan.trajectory)
    (bad,) = (check for check in report.checks if not check.ok)
    assert bad.name == "axis near the file's normals" and bad.worst > 3.0
    assert build_toolpath(other).notes != plan.toolpath.notes
