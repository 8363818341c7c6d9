"""Toolpaths from arrays: the same as those of a file with the same waypoints, and what is said of wrong arrays."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from planner import Toolpath, load, solve
from planner.base.arrays import Array
from planner.base.errors import InputError, Refusal
from planner.plan.seal import digest_of
from planner.problem import Problem
from planner.toolpath.build import build_toolpath
from planner.verify.verdict import verify

UP = np.array([0.0, 0.0, 1.0])


def rings(count: int = 60) -> tuple[list[Array], list[Array]]:
    """Two rings on the cap of peer_cap: points [mm] and normals of each."""
    points, normals = [], []
    for polar in (0.2, 0.3):
        a = np.linspace(0.0, 5.5, count)
        normal = np.column_stack([np.sin(polar) * np.cos(a), np.sin(polar) * np.sin(a), np.full(count, np.cos(polar))])
        points.append(60.0 * normal)
        normals.append(normal)
    return points, normals


def of_file(folder: Path, columns: dict[str, Array], *overrides: str | dict[str, Any]) -> Problem:
    """The problem peer_cap with a CSV file of some columns."""
    file = folder / "points.csv"
    rows = np.column_stack(list(columns.values()))
    file.write_text(
        "\n".join([",".join(columns), *(",".join(map(repr, row)) for row in rows.tolist())]), encoding="utf-8"
    )
    return load("peer_cap", {"layers": {"source": {"waypoints": file}}}, *overrides)


def columns_of(points: Array, normals: Array, **others: Array) -> dict[str, Array]:
    return dict(zip(("x", "y", "z", "nx", "ny", "nz"), (*points.T, *normals.T), strict=True)) | others


def same(one: Problem, other: Problem) -> None:
    """The toolpaths of two problems are the same to the last bit."""
    a, b = build_toolpath(one), build_toolpath(other)
    assert digest_of(a.beads) == digest_of(b.beads) and digest_of(a.surface) == digest_of(b.surface)
    told, other_told = (
        [re.sub(r"^[^:]*|\((line|waypoint)s? [^)]*\)", "", note) for note in each.notes] for each in (a, b)
    )
    assert told == other_told


def test_points_and_normals_are_those_of_a_file(tmp_path: Path) -> None:
    points, normals = (np.concatenate(each) for each in rings())
    arrays = Toolpath.from_arrays(points, normals, unit="mm")
    same(load("peer_cap", toolpath=arrays), of_file(tmp_path, columns_of(points, normals)))
    in_metres = Toolpath.from_arrays(1e-3 * points, 5.0 * normals)
    same(
        load("peer_cap", toolpath=in_metres),
        of_file(tmp_path, columns_of(1e-3 * points, 5.0 * normals), "layers.source.unit=m"),
    )


def test_all_columns_are_those_of_a_file(tmp_path: Path) -> None:
    points, normals = (np.concatenate(each) for each in rings())
    half = len(points) // 2
    others = {
        "layer": np.repeat([4.0, 4.0], half),
        "bead": np.repeat([1.0, 7.0], half),
        "width": np.linspace(0.5, 0.7, 2 * half),
        "height": np.full(2 * half, 0.4),
    }
    arrays = Toolpath.from_arrays(points, normals, unit="mm", **others)  # type: ignore[arg-type]
    same(load("peer_cap", toolpath=arrays), of_file(tmp_path, columns_of(points, normals, **others)))


@pytest.mark.parametrize(
    "overrides",
    [{"layers.source.kind": "spatial"}, {"layers.source.smooth_normals_deg": 2}, {"layers.source.split_mm": 3}, {"layers.source.up": "y"}],
    ids=lambda each: next(iter(each)),
)  # fmt: skip
def test_what_is_said_of_waypoints_holds_for_arrays(tmp_path: Path, overrides: dict[str, Any]) -> None:
    points, normals = (np.concatenate(each) for each in rings())
    rng = np.random.default_rng(1)
    points = np.vstack([points, [[0.0, 0.0, 90.0], [0.0, 0.1, 90.0]]])  # a crumb
    normals = np.vstack([normals, [UP, UP]]) + 0.01 * rng.standard_normal((len(points), 3))
    arrays = Toolpath.from_arrays(points, normals, unit="mm")
    same(load("peer_cap", overrides, toolpath=arrays), of_file(tmp_path, columns_of(points, normals), overrides))


def test_beads_one_by_one_are_a_column_of_beads(tmp_path: Path) -> None:
    points, normals = rings()
    points[1], normals[1] = points[1][:40], normals[1][:40]
    arrays = Toolpath.from_arrays(points, normals, unit="mm", layer=[0, 1], width=[0.6, 0.5], height=0.4)
    ends = np.repeat([0.0, 1.0], [60, 40])
    columns = columns_of(
        np.concatenate(points), np.concatenate(normals), layer=ends, bead=ends, width=0.6 - 0.1 * ends, height=np.full(100, 0.4)
    )  # fmt: skip
    columns["width"] = np.repeat([0.6, 0.5], [60, 40])
    same(load("peer_cap", toolpath=arrays), of_file(tmp_path, columns))
    nested = Toolpath.from_arrays([each.tolist() for each in points], [each.tolist() for each in normals], unit="mm")
    assert len(build_toolpath(load("peer_cap", toolpath=nested)).beads) == 2


def test_beads_may_be_tables() -> None:
    pandas = pytest.importorskip("pandas")
    points, normals = rings()
    tables = [[pandas.DataFrame(each, columns=list("xyz")) for each in which] for which in (points, normals)]
    given = Toolpath.from_arrays(*tables, unit="mm", layer=pandas.Series([0, 1]), width=np.array(0.6))
    plain = Toolpath.from_arrays(points, normals, unit="mm", layer=[0, 1], width=0.6)
    for name in ("points", "normals", "layer", "width", "firsts"):
        assert np.array_equal(getattr(given, name), getattr(plain, name)), name
    ups = [pandas.Series(UP), pandas.Series(-UP)]  # one normal for each bead
    assert (Toolpath.from_arrays(points, ups, unit="mm").normals[[0, -1]] == [UP, -UP]).all()


def test_one_normal_serves_all_points() -> None:
    line = np.linspace([0.0, 0.0, 0.0], [0.05, 0.0, 0.0], 30)
    assert (Toolpath.from_arrays(line, UP).normals == UP).all()
    assert (Toolpath.from_arrays([line, line + 0.01], [UP, -UP]).normals[[0, -1]] == [UP, -UP]).all()


def test_normals_may_be_products_of_small_steps(tmp_path: Path) -> None:
    points, normals = (np.concatenate(each) for each in rings())
    short = 2e-7 * normals  # of steps of 0.45 mm, in metres
    arrays = load("peer_cap", toolpath=Toolpath.from_arrays(points, short, unit="mm"))
    same(arrays, of_file(tmp_path, columns_of(points, short)))
    plain = build_toolpath(load("peer_cap", toolpath=Toolpath.from_arrays(points, normals, unit="mm")))
    for bead, other in zip(build_toolpath(arrays).beads, plain.beads, strict=True):
        assert np.abs(bead.normals - other.normals).max() < 1e-9
    assert len(Toolpath.from_arrays(points, 1e-100 * normals, unit="mm")) == len(points)


def test_arrays_take_the_place_of_layers_and_part() -> None:
    line = np.linspace([0.0, 0.0, 0.0], [0.05, 0.0, 0.0], 30)
    before = load("cylinder_logo")
    problem = load("cylinder_logo", toolpath=Toolpath.from_arrays(line, UP))
    assert before.part is not None and problem.part is None and problem.from_arrays and not before.from_arrays
    assert problem.process.bead.height == before.layers.height  # type: ignore[union-attr]
    again = load(problem, process__speed_mm_s=20)
    assert again.from_arrays and again.process.speed == pytest.approx(0.02)
    assert problem.overrides == ("layers=30 waypoints from arrays",)


def test_arrays_are_not_the_caller_s_to_change_afterwards() -> None:
    line, up = np.linspace([0.0, 0.0, 0.0], [0.05, 0.0, 0.0], 30), np.tile(UP, (30, 1))
    arrays = Toolpath.from_arrays(line, up)
    line[0], up[0] = 7.0, 0.0
    assert arrays.points[0, 0] == 0.0 and arrays.normals[0, 2] == 1.0
    with pytest.raises(ValueError, match="read-only"):
        arrays.points[0] = 1.0


GOOD = np.linspace([0.0, 0.0, 0.0], [0.05, 0.0, 0.0], 30)


def at(i: int, value: Any, of: Array = GOOD) -> Array:
    out = of.copy()
    out[i] = value
    return out


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Toolpath.from_arrays(GOOD[:, :2], UP), "points: has shape (30, 2) ((n, 3), or a list"),
        (lambda: Toolpath.from_arrays(GOOD[:1], UP), "points: has shape (1, 3) (at least two points"),
        (lambda: Toolpath.from_arrays([], UP), "points: has shape (0,)"),
        (lambda: Toolpath.from_arrays(3.0, UP), "points: has shape ()"),
        (lambda: Toolpath.from_arrays(None, UP), "points: must be numbers, not nothing"),  # type: ignore[arg-type]
        (lambda: Toolpath.from_arrays([[0, 0, 0], [1, 2]], UP), "points: is not an array: its rows differ in length"),
        (lambda: Toolpath.from_arrays([["a", "b", "c"]] * 2, UP), "points: must be numbers, not an array of <U1"),
        (lambda: Toolpath.from_arrays(GOOD + 1j, UP), "points: must be numbers, not an array of complex128"),
        (lambda: Toolpath.from_arrays([GOOD, GOOD[:, :2]], UP), "points[1]: has shape (30, 2)"),
        (lambda: Toolpath.from_arrays([GOOD, GOOD[:1]], UP), "points[1]: has shape (1, 3)"),
        (lambda: Toolpath.from_arrays(at(4, [0, np.nan, 1]), UP), "points[4]: (0, nan, 1) is not a point"),
        (lambda: Toolpath.from_arrays([GOOD, at(4, np.inf)], UP), "points[1][4]: (inf, inf, inf) is not a point"),
        (lambda: Toolpath.from_arrays(at(4, 150.0), UP), "points[4]: (150, 150, 150) m is farther than 100 m"),
        (lambda: Toolpath.from_arrays(at(4, 150.0), UP), "unit='mm'"),
        (lambda: Toolpath.from_arrays(1e3 * GOOD, UP), "points: are taken as metres, which makes the print 50 x 0 x 0 m in size (unit='mm' if"),
        (lambda: Toolpath.from_arrays(GOOD, np.tile(UP, (7, 1))), "normals: has shape (7, 3), points (30, 3)"),
        (lambda: Toolpath.from_arrays(GOOD, at(7, 0.0, np.tile(UP, (30, 1)))), "normals[7]: (0, 0, 0) has no length"),
        (lambda: Toolpath.from_arrays(GOOD, at(7, 1e-9, np.tile(UP, (30, 1)))), "normals[7]: (1e-09, 1e-09, 1e-09) has no length"),
        (lambda: Toolpath.from_arrays(GOOD, np.zeros(3)), "normals[0]: (0, 0, 0) has no length"),
        (lambda: Toolpath.from_arrays(GOOD, at(7, np.nan, np.tile(UP, (30, 1)))), "normals[7]: (nan, nan, nan) is not a direction"),
        (lambda: Toolpath.from_arrays([GOOD, GOOD], [UP]), "normals: has 1 beads, but points has 2"),
        (lambda: Toolpath.from_arrays([GOOD, GOOD], [GOOD, GOOD[:4]]), "normals[1]: has shape (4, 3), points[1] (30, 3)"),
        (lambda: Toolpath.from_arrays(GOOD, UP, width=[1, 2]), "width: has shape (2,), but there are 30 points"),
        (lambda: Toolpath.from_arrays(GOOD, UP, width=0.6), "width[0]: 0.6 m is not a valid width for a bead (valid: 1e-05 to 0.05 m)"),
        (lambda: Toolpath.from_arrays(GOOD, UP, height=at(3, np.nan, np.full(30, 1e-3))), "height[3]: nan m is not a valid height"),
        (lambda: Toolpath.from_arrays([GOOD, GOOD], UP, layer=[0, 0.5]), "layer[1][0]: 0.5 is not a valid number for a layer"),
        (lambda: Toolpath.from_arrays([GOOD, GOOD], UP, width=[1e-3, [1e-3]]), "width[1]: has shape (1,), points[1] (30, 3)"),
        (lambda: Toolpath.from_arrays([GOOD, GOOD], UP, bead=[0, 1]), "bead: is not needed where points are given bead by bead"),
        (lambda: Toolpath.from_arrays(GOOD, UP, unit="cm"), "unit: must be 'm' or 'mm', not 'cm'"),  # type: ignore[arg-type]
        (lambda: load("peer_cap", toolpath=GOOD), "toolpath: must be waypoints from arrays, not of type ndarray"),  # type: ignore[arg-type]
        (lambda: load("peer_cap", {"layers.cuont": 1}, toolpath=Toolpath.from_arrays(GOOD, UP)), "layers.cuont']: unknown key"),
    ],
)  # fmt: skip
def test_wrong_arrays_are_said(make: Callable[[], object], message: str) -> None:
    with pytest.raises(InputError) as error:
        make()
    assert message in str(error.value)


def test_what_is_said_to_be_in_metres_may_be_large() -> None:
    assert Toolpath.from_arrays(1e3 * GOOD, UP, unit="m").points[-1, 0] == 50.0
    assert Toolpath.from_arrays(1e3 * GOOD, UP, unit="mm").points[-1, 0] == pytest.approx(0.05)
    assert Toolpath.from_arrays(GOOD + 40.0, UP).points[0, 0] == 40.0  # which is far, not large


@pytest.mark.parametrize(
    ("points", "normals", "message"),
    [
        (GOOD, np.where(np.arange(30)[:, None] < 15, UP, -UP), "points[15]: the normal turns by 180 degrees"),
        (1e-3 * GOOD, UP, "points[0]: path 1, which begins here, is only 0.0500 mm long"),
        (np.zeros((5, 3)), UP, "points: there are no two different waypoints"),
        ([GOOD, GOOD + [0.0, 0.01, 0.0], 1e-4 * GOOD + 0.02], UP, "points[2][0]: path 3, which begins here, is only 0.0050 mm"),
    ],
)  # fmt: skip
def test_arrays_that_are_no_beads_are_told_by_index(points: Any, normals: Array, message: str) -> None:
    problem = load("peer_cap", {"layers.source.leave_out_share": 0}, toolpath=Toolpath.from_arrays(points, normals))
    with pytest.raises(InputError) as error:
        build_toolpath(problem)
    assert message in str(error.value)


def test_other_processes_see_no_arrays() -> None:
    problem = load("peer_cap", toolpath=Toolpath.from_arrays(GOOD, UP))
    with pytest.raises(InputError, match="over: other processes cannot see waypoints from arrays"):
        solve(problem, over=lambda function, pieces: iter(()))


@pytest.mark.slow
def test_what_a_refusal_advises_is_tried_with_the_arrays() -> None:
    line = np.linspace([0.0, -0.02, 0.06], [0.0, 0.02, 0.06], 41)
    problem = load("peer_cap", {"cell.bed_mm": [1500, 0, 300]}, toolpath=Toolpath.from_arrays(line, UP))
    with pytest.raises(Refusal, match="out of the arm's reach") as refused:
        solve(problem, baseline=False)
    (hint,) = refused.value.hints
    assert "cell.bed_mm" in hint and "gives a verified plan" in hint


@pytest.mark.slow
def test_a_plan_of_arrays_is_that_of_the_file_and_is_held_against_them(tmp_path: Path) -> None:
    points, normals = (np.concatenate(each) for each in rings())
    arrays = Toolpath.from_arrays(points, normals, unit="mm")
    ours = solve(load("peer_cap", toolpath=arrays), baseline=False)
    theirs = solve(of_file(tmp_path, columns_of(points, normals)), baseline=False)
    assert ours.verified and ours.seal["trajectory"] == theirs.seal["trajectory"]
    assert [check.name for check in ours.checks] == [check.name for check in theirs.checks]
    # the verifier looks at the arrays themselves: others, and the same plan fails
    other = load("peer_cap", toolpath=Toolpath.from_arrays(points + [0.0, 3.0, 0.0], normals, unit="mm"))
    report = verify(other, ours.cell, ours.toolpath, ours.trajectory)
    assert "print on the drawn path" in {check.name for check in report.checks if not check.ok}
