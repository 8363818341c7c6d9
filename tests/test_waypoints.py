"""Files of waypoints: how they are read, the curve through them, and the surface that they stand for."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.interpolate import CubicSpline, make_interp_spline

from benchmarks.peer_cases import CASES, SHIPPED, cap, cylinder, waypoint_text, write_case
from benchmarks.scaling import sheet
from planner.base.arrays import Array
from planner.base.errors import InputError
from planner.base.geometry import arc_lengths
from planner.base.nearest import distance_to_polyline
from planner.problem import Problem, find_problem, load_problem
from planner.problem.layers import WaypointsSpec
from planner.toolpath.bead import Bead, Toolpath
from planner.toolpath.build import build_toolpath
from planner.toolpath.interpolation import CORNER_TURN, Interpolated, _led_on, interpolate
from planner.toolpath.plane_paths import arc_length
from planner.toolpath.task import roll_zeros
from planner.toolpath.waypoints.nearest import ALWAYS, FAR
from planner.toolpath.waypoints.reader import Waypoints, distinct, read_waypoints
from planner.toolpath.waypoints.surfels import Surfels, with_layers

CHEN = Path(__file__).resolve().parents[2] / "shared" / "data" / "chen2025" / "freeform_25.txt"
TOLERANCE = 0.2e-3
APART = 0.3e-3
UP = "0 0 1"


@pytest.fixture
def spec(tmp_path: Path) -> Callable[..., WaypointsSpec]:
    """Write a file and say how to read it: `spec(text, up='y')`."""

    def make(text: str | bytes, **options: object) -> WaypointsSpec:
        path = tmp_path / "points.txt"
        path.write_bytes(text.encode() if isinstance(text, str) else text)
        return load_problem(case_text(tmp_path, str(path), **options)).layers.source

    return make


def case_text(folder: Path, waypoints: str, **options: object) -> Path:
    """A problem file that reads a file of waypoints."""
    source = "".join(f", {key}: {value}" for key, value in options.items())
    path = folder / "case.yaml"
    path.write_text(
        f"""\
name: points
cell:
  arm: irb140
  nozzle: {{tip_mm: [0, 0, 100], diameter_mm: 0.6}}
  home_deg: [0, 0, 0, 0, 45, 0]
  bed_mm: [450, 0, 150]
layers:
  source: {{waypoints: "{waypoints}"{source}}}
process:
  speed_mm_s: 40
  travel_speed_mm_s: 200
  bead: {{width_mm: 0.6, height_mm: 0.5}}
""",
        encoding="utf-8",
    )
    return path


def refused(spec: WaypointsSpec) -> InputError:
    with pytest.raises(InputError) as caught:
        read_waypoints(spec)
    return caught.value


# Reading


@settings(max_examples=60)
@given(
    st.lists(
        st.tuples(
            *[st.integers(-(10**6), 10**6)] * 3,
            st.tuples(*[st.integers(-100, 100)] * 3).filter(any),
            st.sampled_from([" ", ", ", "\t", ",", "   "]),
            st.sampled_from(["", " 7 8", ",9", "  # not read"]),
            st.sampled_from(["", "# remark\n", "\n", "// remark\n", "  ; x y\n"]),
        ),
        min_size=2,
        max_size=8,
        unique_by=lambda row: row[:3],
    ),
    st.sampled_from(["\n", "\r\n", "\r"]),
    st.booleans(),
    st.booleans(),
)
def test_whatever_is_written_is_read(rows: list[tuple], newline: str, header: bool, mark: bool) -> None:  # type: ignore[type-arg]
    text = ("\ufeff" if mark else "") + ("x y z nx ny nz\n" if header else "")
    for x, y, z, n, blank, more, before in rows:
        text += (
            before + blank.join(f"{v * 1e-3:.3f}" for v in (x, y, z)) + blank + blank.join(map(str, n)) + more + "\n"
        )
    path = Path("/nowhere/points.txt")
    points = np.array([row[:3] for row in rows]) * 1e-6
    normals = np.array([row[3] for row in rows], dtype=float)
    found = read_text(path, text.replace("\n", newline))
    keep = distinct(points)
    assert np.vstack([bead.points for bead in found]) == pytest.approx(points[keep], abs=1e-12)
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    assert np.vstack([bead.normals for bead in found]) == pytest.approx(normals[keep], abs=1e-12)


def read_text(path: Path, text: str) -> tuple[Waypoints, ...]:
    """Read a text as if it stood in a file, as one bead."""

    class File(type(path)):  # type: ignore[misc]
        def is_file(self) -> bool:
            return True

        def open(self, mode: str = "r") -> object:  # type: ignore[override]
            import io

            return io.BytesIO(text.encode())

    return read_waypoints(
        WaypointsSpec.model_construct(
            waypoints=File(path),
            unit="mm",
            up="z",
            normals="outward",
            origin=(0, 0, 0),
            split=1e9,
            smoothing=0.0,
            crumbs=0.0,
        )
    ).beads


BAD = [
    # text of the third line, reason, hint
    ("1 2 3 0 0", "six numbers", "x y z nx ny nz; here are 5 values"),
    ("1 2 3 0 0 one", "'one' is not a number", ""),
    ("1 2 nan 0 0 1", "'nan' is not a number that a waypoint can have", ""),
    ("1 2 3 0 0 inf", "'inf' is not a number", ""),
    ("1 2 3 0 0 1_0", "'1_0' is not a number", ""),
    ("1 2 3 0 0 0", "the normal is zero", "direction"),
    ("1 2 3e9 0 0 1", "farther than 100 m", "mm"),
    ("x y z nx ny nz", "'x' is not a number", ""),
    ("1|2|3|0|0|1", "six numbers", "1 value"),
    ("1 2 3 0 0 1\x00", "is not a number", ""),
]


@pytest.mark.parametrize(("line", "reason", "hint"), BAD)
def test_a_bad_line_is_named(spec: Callable[..., WaypointsSpec], line: str, reason: str, hint: str) -> None:
    error = refused(spec(f"# x y z\n0 0 0 {UP}\n{line}\n9 0 0 {UP}\n"))
    assert error.line == 3
    assert str(error.file).endswith("points.txt")
    assert reason in str(error)
    assert hint in str(error)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("", "holds no waypoints"),
        ("# nothing\n", "holds no waypoints"),
        (f"0 0 0 {UP}\n", "no two different waypoints"),
        (f"0 0 0 {UP}\n" * 3, "no two different waypoints"),
        (b"0 0 0 0 0 1\n1 0 0 0 0 \xff\n", "not UTF-8"),
    ],
)
def test_a_bad_file_is_refused(spec: Callable[..., WaypointsSpec], text: str | bytes, reason: str) -> None:
    assert reason in str(refused(spec(text)))


def test_a_missing_file_is_an_error_of_the_field(tmp_path: Path) -> None:
    with pytest.raises(InputError) as caught:
        build_toolpath(load_problem(case_text(tmp_path, "nothing.txt")))
    assert caught.value.field == "layers.source.waypoints"
    assert caught.value.line == 8
    assert "there is no file" in str(caught.value)


def test_jumps_split_and_repetitions_are_dropped(spec: Callable[..., WaypointsSpec]) -> None:
    xs = [0, 1, 1, 1.001, 2, 3, 20, 21, 22, 22.9, 40, 41]
    text = "".join(f"{x} 0 0 {UP}\n" for x in xs)
    found = [(bead.points[:, 0] * 1e3).round(3).tolist() for bead in read_waypoints(spec(text)).beads]
    assert found == [[0, 1, 2, 3], [20, 21, 22, 22.9], [40, 41]]
    whole = read_waypoints(spec(text, split_mm=30)).beads
    assert [len(bead.points) for bead in whole] == [10]
    error = refused(spec(text + f"# alone\n90 0 0 {UP}\n"))
    assert (error.line, "stands alone" in str(error)) == (14, True)


@pytest.mark.parametrize(
    ("points", "source", "told"),
    [
        ([(x, 0) for x in (*range(6), *range(100, 106))], {}, "1 place"),  # dense at both ends of a side alone
        ([(x, 0) for x in (*range(6), *range(100, 106))], {"split_mm": 50}, ""),
        ([(x, 0) for x in (*range(50), *range(53, 100))], {}, "1 place"),
        ([(x, 0) for x in (*range(500), *range(504, 999))], {}, ""),  # 5 mm of 993: less than may be left out
        ([(x, y) for y in (0, 20) for x in range(20)], {}, ""),  # back to the next row
    ],
)
def test_where_nothing_is_laid_straight_on_is_told(
    spec: Callable[..., WaypointsSpec], points: list[tuple[int, int]], source: dict[str, int], told: str
) -> None:
    found = read_waypoints(spec("".join(f"{x} {y} 0 {UP}\n" for x, y in points), **source))
    assert len(found.beads) == 2
    assert [told in note and "where nothing is laid" in note for note in found.notes] == [True] * bool(told)


@pytest.mark.parametrize("seed", [16, 55, 64, 77])
def test_spikes_among_many_corners_are_rounded_within_the_tolerance(seed: int) -> None:
    """Corners that are rounded together are averaged on a grid, whose cells may miss a spike of one waypoint."""
    rng = np.random.default_rng(seed)
    x = np.cumsum(rng.uniform(0.1, 0.24, 260))
    y = np.zeros_like(x)
    y[60:200:7] = 0.24
    points = 1e-3 * np.column_stack([x, y, 0.0 * x])
    curve = interpolate(points, np.tile([0.0, 0.0, 1.0], (len(x), 1)), TOLERANCE, APART)
    n = len(curve.points)
    dense = make_interp_spline(np.arange(n), curve.points, k=3)(np.linspace(0.0, n - 1.0, 20 * n))
    assert distance_to_polyline(points, dense).max() < 0.905 * TOLERANCE  # a tenth is for the curve between samples


def crumbly(alone: int = 0, short: int = 0, stray: int = 0) -> str:
    """A line of 300 mm with crumbs behind it, and waypoints on it whose normal points the other way."""
    rows = [f"{x} 0 0 {'0 0 -1' if 50 <= x < 50 + 20 * stray and x % 20 == 10 else UP}" for x in range(301)]
    rows += [f"{x} 50 0 {UP}" for x in range(0, 20 * alone, 20)]
    rows += [f"{x + part} 90 0 {UP}" for x in range(0, 20 * short, 20) for part in (0, 0.25)]
    return "\n".join(rows) + "\n"


def test_a_few_crumbs_are_left_out_and_told(spec: Callable[..., WaypointsSpec]) -> None:
    found = read_waypoints(spec(crumbly(alone=1, short=2, stray=1)), width=0.6e-3)
    (bead,) = found.beads
    assert (len(bead.points), bead.name) == (301, "path 1")
    np.testing.assert_allclose(bead.normals, np.tile([0.0, 0.0, 1.0], (301, 1)), atol=1e-12)
    (note,) = found.notes
    assert note == (
        "points.txt: left out 1 waypoint that stands alone (line 302); "
        "left out 2 paths shorter than their beads are wide (lines 303, 305); "
        "turned round 1 normal that points the other way (line 51): 0.83% of the length"
    )


def test_one_normal_that_points_the_other_way_is_turned_in_a_short_file(spec: Callable[..., WaypointsSpec]) -> None:
    """It loses nothing, so its share of the length does not count; among three it cannot be told which is wrong."""
    rows = [f"{x} 0 0 {UP}" for x in range(4)]
    stray = ["0 0 0 0 0 -2", *rows[1:]]
    found = read_waypoints(spec("\n".join(stray)))
    np.testing.assert_allclose(found.beads[0].normals, np.tile([0.0, 0.0, 1.0], (4, 1)), atol=1e-12)
    assert "turned round 1 normal that points the other way (line 1)" in found.notes[0]
    for text, share in (("\n".join(stray), 0.0), ("\n".join(stray[:3]), 0.01)):
        (bead,) = read_waypoints(spec(text, leave_out_share=share)).beads
        assert bead.normals[0, 2] == -1.0


def test_normals_between_ones_that_point_the_other_way_stay(spec: Callable[..., WaypointsSpec]) -> None:
    """A good one between two bad ones is not turned, and a corner keeps its waypoint."""
    points = [(0, k) for k in range(100)] + [(k, 100) for k in range(101)]
    bad = {49, 51, 100}
    text = "".join(f"{x} {y} 0 0.1 0 {-1 if i in bad else 1}\n" for i, (x, y) in enumerate(points))
    (bead,) = read_waypoints(spec(text, leave_out_share=0.05)).beads
    assert len(bead.points) == 201
    assert (bead.normals[:, 2] > 0.9).all()


def test_a_file_of_single_waypoints_is_refused_without_a_warning(
    spec: Callable[..., WaypointsSpec], recwarn: pytest.WarningsRecorder
) -> None:
    assert "stands alone" in str(refused(spec(f"0 0 0 {UP}\n9 0 0 {UP}\n30 0 0 {UP}\n", split_mm=1)))
    assert not recwarn.list


@pytest.mark.parametrize(
    ("crumbs", "share", "line", "words"),
    [
        ({"alone": 4}, 0.01, 302, "stands alone"),
        ({"alone": 1}, 0.0, 302, "stands alone"),
        ({"short": 14}, 0.01, 302, "only 0.2500 mm long"),
        ({"stray": 4}, 0.01, 51, "turns by 180 degrees"),
    ],
)
def test_more_crumbs_are_refused(tmp_path: Path, crumbs: dict[str, int], share: float, line: int, words: str) -> None:
    (tmp_path / "points.txt").write_text(crumbly(**crumbs), encoding="utf-8")
    given_ = load_problem(case_text(tmp_path, "points.txt", leave_out_share=share))
    with pytest.raises(InputError, match=words) as caught:
        build_toolpath(given_)
    assert caught.value.line == line


def test_creeping_points_add_up_to_a_step() -> None:
    points = np.zeros((111, 3))
    points[:, 0] = np.concatenate([np.arange(61) * 1e-3, 0.06 + np.arange(1, 51) * 0.7e-5])
    keep = distinct(points)
    gaps = np.diff(points[keep, 0])
    assert keep[:61].all()
    assert gaps.min() > 0.02e-3 - 1e-12
    assert keep[61:].sum() == 16  # every third of the fifty


def test_axes_normals_and_origin(spec: Callable[..., WaypointsSpec]) -> None:
    given = spec("1 2 3 0 -2 1\n2 2 3 0 -2 1\n", up="y", normals="inward", origin_mm="[10, 0, 5]")
    (bead,) = read_waypoints(given).beads
    assert bead.points * 1e3 == pytest.approx(np.array([[11, -3, 7], [12, -3, 7]]))
    assert bead.normals[0] == pytest.approx(np.array([0, 1, 2]) / 5**0.5)
    (bead,) = read_waypoints(spec("1 2 3 1 0 -2\n1 2 4 1 0 -2\n", up="x")).beads
    assert bead.points * 1e3 == pytest.approx(np.array([[2, 3, 1], [2, 4, 1]]))
    assert bead.normals[0] * 5**0.5 == pytest.approx(np.array([0, -2, 1]))


@pytest.mark.slow
def test_many_lines_are_read_fast(spec: Callable[..., WaypointsSpec]) -> None:
    import time

    text = waypoint_text(sheet(100_000))
    given = spec(text)
    start = time.perf_counter()
    beads = read_waypoints(given).beads
    assert time.perf_counter() - start < 3.0  # some 0.2 s: no Python at every number
    assert sum(len(bead.points) for bead in beads) == 100_000


# The curve


def dense(curve: Interpolated, times: int = 10) -> Array:
    u = np.arange(len(curve.points), dtype=float)
    return np.asarray(make_interp_spline(u, curve.points, k=5)(np.linspace(0, u[-1], times * len(u))))


def helix(t: Array) -> tuple[Array, Array]:
    """A curve on a cone, with its normals: curvature and spacing change along it."""
    r = 0.03 + 0.02 * t
    points = np.column_stack([r * np.cos(5 * t), r * np.sin(5 * t), 0.04 * t])
    normals = np.column_stack([np.cos(5 * t), np.sin(5 * t), np.full(len(t), -0.5)])
    return points, normals / np.linalg.norm(normals, axis=1)[:, None]


def test_evenly_spaced_waypoints_are_the_samples() -> None:
    rows = cylinder(300)
    points, normals = rows[:, :3] * 1e-3, rows[:, 3:]
    curve = interpolate(points, normals, TOLERANCE, APART)
    assert curve.points == pytest.approx(points, abs=1e-12)
    assert curve.normals == pytest.approx(normals, abs=1e-12)


@pytest.mark.parametrize("scatter", [0.0, 0.3])
def test_the_curve_passes_through_smooth_waypoints(scatter: float) -> None:
    rng = np.random.default_rng(3)
    t = np.linspace(0.0, 1.0, 301) ** 1.3
    t[1:-1] += scatter * rng.uniform(-0.5, 0.5, 299) * np.minimum(np.diff(t)[:-1], np.diff(t)[1:])
    points, normals = helix(t)
    curve = interpolate(points, normals, TOLERANCE, APART)
    fine = helix(np.linspace(0, 1, 40_001))[0]
    assert distance_to_polyline(points, dense(curve)).max() < 1e-6
    assert distance_to_polyline(curve.points, fine).max() < 1e-6
    assert np.linalg.norm(curve.normals, axis=1) == pytest.approx(1.0, abs=1e-12)
    assert len(curve.points) <= 1.1 * len(points)
    assert_smooth(curve, 0.05)


def assert_smooth(curve: Interpolated, growth: float) -> None:
    """Neighbouring samples stand equally far apart, up to a share."""
    step = np.linalg.norm(np.diff(curve.points, axis=0), axis=1)
    assert np.abs(np.diff(np.log(step))).max() < growth


def zigzag(passes: int, length: int, pitch: float, step: float = 1e-3) -> Array:
    rows = []
    for k in range(passes):
        x = np.arange(length + 1) * step
        rows.append(np.column_stack([x if k % 2 == 0 else x[::-1], np.full(len(x), k * pitch), 0.0 * x]))
    return np.vstack(rows)


@pytest.mark.parametrize("ends", [1, 2])
def test_a_long_step_beside_dense_bends_is_straight(ends: int) -> None:
    """A wall of 40 mm behind a bend of 20 mm, with waypoints a millimetre apart in bends alone, and two of 1 and 2 mm in line behind
    it, or another bend. The spline goes on with the curvature of bends: by 40^2 / (64 * 20) = 1.25 mm off, or, of two, 2.5 mm."""
    angle = np.radians(np.linspace(180.0, 270.0, 32))
    bend = 20e-3 * np.column_stack([np.cos(angle), 1.0 + np.sin(angle), 0.0 * angle])
    behind = bend[::-1] * [-1.0, 1.0, 1.0] if ends == 2 else 1e-3 * np.array([[0.0, 0, 0], [1.0, 0, 0], [3.0, 0, 0]])
    points = np.vstack([bend, behind + [40e-3, 0.0, 0.0]])
    normals = np.tile([0.0, 0.0, 1.0], (len(points), 1))
    path = dense(interpolate(points, normals, TOLERANCE, APART, astray=TOLERANCE))
    wall = (path[:, 0] > 0.0) & (path[:, 0] < 40e-3)
    assert np.abs(path[wall, 1]).max() <= TOLERANCE


def test_a_long_step_behind_a_dense_arc_is_led_on_along_it() -> None:
    """Waypoints a millimetre apart and then 40 mm, all on a circle of 100 mm: the way is within 0.03 mm of that, the chord 2 mm off."""
    angle = np.append(np.linspace(-0.3, 0.0, 31), 0.4)
    points = 0.1 * np.column_stack([np.cos(angle), np.sin(angle), 0.0 * angle])
    which, off = _led_on(points, arc_lengths(points), np.zeros(0, dtype=np.int64))
    assert which.tolist() == [30]
    middle = points[30:].mean(axis=0) + off[0, 2]
    assert np.linalg.norm(middle) == pytest.approx(0.1, abs=0.03e-3)


@pytest.mark.parametrize("pitch", [0.4e-3, 1e-3, 6e-3])
@pytest.mark.parametrize("tolerance", [0.05e-3, 0.2e-3])
def test_corners_are_rounded_within_the_tolerance(pitch: float, tolerance: float) -> None:
    points = zigzag(4, 60, pitch)
    curve = interpolate(points, np.tile([0.0, 0.0, 1.0], (len(points), 1)), tolerance, APART)
    path = dense(curve)
    assert distance_to_polyline(path, curve.source).max() <= tolerance
    assert distance_to_polyline(curve.source, path).max() <= tolerance
    assert curve.points[0] == pytest.approx(points[0])
    assert curve.points[-1] == pytest.approx(points[-1])
    away = np.abs(points[:, 0] - 0.03) < 0.01
    assert distance_to_polyline(points[away], path).max() < 1e-6
    assert_smooth(curve, 0.35)
    turn = np.diff(path, axis=0)
    turn /= np.linalg.norm(turn, axis=1)[:, None]
    assert np.degrees(np.arccos(np.clip((turn[1:] * turn[:-1]).sum(axis=1), -1, 1))).max() < 10.0


def test_samples_stay_near_the_number_of_waypoints() -> None:
    for waypoints in (1000, 4000):
        rows = cylinder(waypoints)
        curve = interpolate(rows[:, :3] * 1e-3, rows[:, 3:], TOLERANCE, APART)
        corners = 2 * (waypoints // 309)
        assert waypoints <= len(curve.points) <= waypoints + 50 * corners


@settings(max_examples=40)
@given(st.integers(0, 10_000), st.integers(2, 40), st.floats(0.02, 3.0))
def test_any_waypoints_make_a_curve_within_the_tolerance(seed: int, count: int, wild: float) -> None:
    rng = np.random.default_rng(seed)
    direction = np.cumsum(rng.normal(0.0, wild, (count, 3)), axis=0) + [1.0, 0.0, 0.0]
    steps = rng.uniform(0.3e-3, 2e-3, count)[:, None] * direction / np.linalg.norm(direction, axis=1)[:, None]
    points = np.cumsum(steps, axis=0)
    normals = np.tile([0.0, 0.6, 0.8], (count, 1))
    curve = interpolate(points, normals, TOLERANCE, APART)
    assert np.isfinite(curve.points).all()
    assert distance_to_polyline(curve.source, dense(curve)).max() <= 1.02 * TOLERANCE
    assert curve.normals == pytest.approx(np.tile([0.0, 0.6, 0.8], (len(curve.normals), 1)), abs=1e-9)


@pytest.mark.parametrize("ends", [0.1e-3, 0.3e-3, 2e-3])
def test_samples_draw_together_at_the_ends(ends: float) -> None:
    rows = cylinder(300)
    curve = interpolate(rows[:, :3] * 1e-3, rows[:, 3:], TOLERANCE, APART, ends)
    step = np.linalg.norm(np.diff(curve.points, axis=0), axis=1)
    assert step[[0, -1]] == pytest.approx(min(ends, 1e-3), rel=0.1)
    assert step[100:200] == pytest.approx(1e-3, rel=0.02)
    assert_smooth(curve, 0.25)
    assert abs(np.log(step[1] / step[0])) < 0.05, "what is attached there keeps the last distance"


def test_a_corner_is_a_corner_only_beyond_its_angle() -> None:
    for angle, sharp in ((0.9 * CORNER_TURN, False), (1.1 * CORNER_TURN, True)):
        arm = np.arange(21)[:, None] * 1e-3
        points = np.vstack([-arm[::-1] * [1, 0, 0], arm[1:] * [np.cos(angle), np.sin(angle), 0]])
        curve = interpolate(points, np.tile([0.0, 0.0, 1.0], (41, 1)), TOLERANCE, APART)
        off = distance_to_polyline(points[20:21], dense(curve, 50))[0]
        assert (off > 50e-6) == sharp


# Roll


def test_roll_is_counted_from_one_axis_where_that_is_clear() -> None:
    normals = [cap(400)[:, 3:], cap(200)[:, 3:]]
    for tangent, n in zip(roll_zeros(normals), normals, strict=True):
        assert np.linalg.norm(tangent, axis=1) == pytest.approx(1.0)
        assert (tangent * n).sum(axis=1) == pytest.approx(0.0, abs=1e-12)
        assert (tangent[:, 0] > 0.6).all() or (tangent[:, 1] > 0.6).all()


def test_roll_is_carried_without_spin_where_no_axis_is_clear() -> None:
    t = np.linspace(0.0, 6.0, 3001)  # a spherical curve that meets all three axes
    normals = np.column_stack([np.cos(t) * np.cos(8 * t), np.cos(t) * np.sin(8 * t), np.sin(t)])
    (tangent,) = roll_zeros([normals])
    assert np.linalg.norm(tangent, axis=1) == pytest.approx(1.0)
    assert (tangent * normals).sum(axis=1) == pytest.approx(0.0, abs=1e-12)
    rate = np.gradient(tangent, t, axis=0)[5:-5]
    spin = (rate * np.cross(normals, tangent)[5:-5]).sum(axis=1)
    assert np.abs(spin).max() < 1e-3
    assert np.abs(np.diff(tangent, n=2, axis=0)).max() < 3e-4  # smooth: of the order of the step's square


# The surface


def beads_of(paths: list[Array], height: float = 0.5e-3) -> list[Bead]:
    """Beads as they come, of rows x y z nx ny nz [mm]."""
    return [
        Bead(
            f"path {i}",
            0,
            arc_length(rows[:, :3] * 1e-3),
            rows[:, :3] * 1e-3,
            rows[:, 3:],
            np.roll(rows[:, 3:], 1, axis=1),
            rows[:, :3] * 1e-3,
            np.full(len(rows), 0.6e-3),
            np.full(len(rows), height),
            False,
        )
        for i, rows in enumerate(paths)
    ]


@pytest.fixture(scope="module")
def dome() -> Surfels:
    """A cap, printed all over by one spiral of 2.6 mm pitch; its surface lies half a millimetre beneath."""
    return with_layers(beads_of([cap(10_000)]))[1]


def test_distance_from_a_dome(dome: Surfels) -> None:
    rng = np.random.default_rng(5)
    polar, azimuth = rng.uniform(0.0, 0.7, 2000), rng.uniform(0.0, 2 * np.pi, 2000)
    out = np.column_stack([np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.cos(polar)])
    height = rng.uniform(-8e-3, 30e-3, 2000)
    true = height + 0.5e-3
    found = dome.signed_distance((0.12 + height)[:, None] * out)
    clear = np.abs(true) > 2e-3  # nearer, the gaps between the rows count
    assert (np.sign(found) == np.sign(true))[clear].all()
    assert np.abs(found - true)[clear].max() < 0.4e-3
    assert (found >= true - 0.05e-3)[true > 0].all()


def test_far_away_is_outside_wherever_that_is(dome: Surfels) -> None:
    beside = np.array([[0.3, 0.0, 0.02], [0.0, -0.4, 0.1], [0.0, 0.0, 0.5], [0.0, 0.0, -0.2]])
    assert dome.signed_distance(beside) == pytest.approx(FAR)
    rim = np.array([[0.12, 0.0, 0.04]])  # 5 cm beneath the rim and beside it
    assert dome.signed_distance(rim)[0] > 0.02


def test_whoever_passes_through_the_dome_meets_a_shell(dome: Surfels) -> None:
    rng = np.random.default_rng(7)
    for _ in range(50):
        a = np.array([*rng.uniform(-0.06, 0.06, 2), 0.14])
        b = np.array([*rng.uniform(-0.05, 0.05, 2), 0.05])
        way = a + np.linspace(0, 1, 200)[:, None] * (b - a)
        assert dome.signed_distance(way).min() < 0.0


def test_normals_of_the_dome(dome: Surfels) -> None:
    points = dense(Interpolated(dome.tips, dome.outward, dome.tips, dome.along), 3)
    true = points / np.linalg.norm(points, axis=1)[:, None]
    assert np.degrees(np.linalg.norm(dome.normals(points) - true, axis=1)).max() < 0.01


def test_normals_where_passes_cross_are_those_of_each() -> None:
    k = np.arange(21.0)[:, None] - 10.0
    lean = np.array([[0.2, 0.0, 1.0], [0.0, -0.3, 1.0]])
    paths = [np.hstack([k * way, np.tile(lean[i], (21, 1))]) for i, way in enumerate(np.eye(3)[:2])]
    beads, surface = with_layers(beads_of(paths))
    for i, bead in enumerate(beads):
        s = np.linspace(0.0, bead.length, 401)
        tips = make_interp_spline(bead.s, bead.points, k=3)(s)
        true = np.tile(lean[i] / np.linalg.norm(lean[i]), (401, 1))
        np.testing.assert_allclose(surface.normals_on(i, s, tips), true, rtol=0, atol=1e-12)


def test_normals_on_a_bead_that_turns(dome: Surfels) -> None:
    points = dense(Interpolated(dome.tips, dome.outward, dome.tips, dome.along), 3)
    s = make_interp_spline(np.arange(len(dome.along)), dome.along, k=5)(
        np.linspace(0, len(dome.along) - 1, len(points))
    )
    true = points / np.linalg.norm(points, axis=1)[:, None]
    assert np.degrees(np.linalg.norm(dome.normals_on(0, s, points) - true, axis=1)).max() < 0.01


@pytest.fixture(scope="module")
def stack() -> tuple[tuple[Bead, ...], Surfels]:
    """Three layers of four strips on a bowed sheet, a bead each."""
    rows = sheet(3 * 9060)
    return with_layers(beads_of(list(np.split(rows, 12))))


def test_layers_are_what_lies_on_something(stack: tuple[tuple[Bead, ...], Surfels]) -> None:
    beads, surface = stack
    assert [bead.layer for bead in beads] == [0] * 4 + [1] * 4 + [2] * 4
    assert Toolpath(beads, surface).layers == 3
    bare = surface.tree.origin[surface.tree.bead == ALWAYS]
    assert len(bare) > 0
    assert (bare < 4 * len(beads[0].points)).mean() > 0.999


def test_a_layer_lies_on_long_straight_lines_between_few_waypoints() -> None:
    """Of lines 20 mm long, sampled at their ends alone, the middles are laid, too: what crosses them lies on them, not on a
    part that has been there from the beginning."""
    ends = np.concatenate([np.linspace(0.0, 0.3, 4), np.linspace(19.7, 20.0, 4)])
    rows = [np.column_stack([ends[:: (-1) ** k], np.full(8, 0.5 * k), np.full(8, 0.5)]) for k in range(30)]
    over = np.column_stack([np.full(141, 10.0), np.linspace(0.25, 14.25, 141), np.full(141, 1.0)])
    up = np.array([0.0, 0.0, 1.0])
    beads, surface = with_layers(beads_of([np.hstack([p, np.tile(up, (len(p), 1))]) for p in (np.vstack(rows), over)]))
    assert [bead.layer for bead in beads] == [0, 1]
    assert (surface.tree.origin[surface.tree.bead == ALWAYS] < len(beads[0].points)).all()
    assert (surface.before(0).signed_distance(1e-3 * (over - 0.6 * up)) > 0.3e-3).all()


def test_the_surface_grows(stack: tuple[tuple[Bead, ...], Surfels]) -> None:
    beads, surface = stack
    height = 0.5e-3
    for i, bead in enumerate(beads):
        assert surface.before(i + 1).signed_distance(bead.points) == pytest.approx(height, abs=2e-5)
        if bead.layer == 2:
            under = surface.before(i).signed_distance(bead.points[500:600])
            assert under == pytest.approx(2 * height, abs=0.15e-3), "there is nothing of its own layer there yet"
    nothing = surface.before(0)
    assert nothing.signed_distance(beads[8].points) == pytest.approx(3 * height, abs=2e-5)
    inside = beads[0].points - 3e-3 * beads[0].normals
    assert nothing.signed_distance(inside).max() < 0.0, "what the first layer lies on is there from the start"


def test_prefixes_agree_with_brute_force(stack: tuple[tuple[Bead, ...], Surfels]) -> None:
    beads, surface = stack
    rng = np.random.default_rng(11)
    points = beads[5].points[rng.integers(0, 2000, 40)] + rng.uniform(-2e-3, 6e-3, (40, 3))
    for count in (0, 1, 3, 4, 7, 12):
        there = np.arange(len(surface.tips)) < surface.first[count]
        there[surface.tree.origin[surface.tree.bead == ALWAYS]] = True
        away = points[:, None] - surface.centres[there]
        nearest = np.linalg.norm(away, axis=2).argmin(axis=1)
        v, n = away[np.arange(40), nearest], surface.outward[there][nearest]
        up = (v * n).sum(axis=1)
        aside = np.maximum(np.linalg.norm(v - up[:, None] * n, axis=1) - surface.radius, 0.0)
        assert np.abs(surface.before(count).signed_distance(points)) == pytest.approx(np.hypot(up, aside), abs=1e-12)


# Problems


def mistake(folder: Path, old: str, new: str) -> InputError:
    path = case_text(folder, "points.txt")
    text = path.read_text(encoding="utf-8")
    assert text.count(old) == 1
    path.write_text(text.replace(old, new), encoding="utf-8")
    with pytest.raises(InputError) as caught:
        load_problem(path)
    return caught.value


MISTAKES = [
    ('waypoints: "points.txt"', "waypoint: a.txt", "layers.source.waypoint", "unknown key", "did you mean waypoints?"),
    ('waypoints: "points.txt"', "waypoints: a.txt, slpit_mm: 3", "layers.source.slpit_mm", "unknown", "split_mm"),
    ('waypoints: "points.txt"', "waypoints: a.txt, up: w", "layers.source.up", "'w'", "choices: z, y, x"),
    ('waypoints: "points.txt"', "waypoints: a.txt, normals: in", "layers.source.normals", "'in'", "inward"),
    ('waypoints: "points.txt"', "waypoints: a.txt, svg: b.svg", "layers.source.svg", "both svg and waypoints", "one"),
    ('waypoints: "points.txt"', "up: y", "layers.source.waypoints", "is missing", "x y z nx ny nz"),
    ("layers:", "layers:\n  count: 2", "layers.count", "unknown key", "known keys: source"),
    ("layers:", "part: {cylinder: {radius_mm: 9, height_mm: 9}}\nlayers:", "part", "own surface", "leave out part"),
    (", height_mm: 0.5", "", "process.bead", "height_mm is missing", ""),
]


@pytest.mark.parametrize(("old", "new", "field", "reason", "hint"), MISTAKES)
def test_mistakes_are_told(tmp_path: Path, old: str, new: str, field: str, reason: str, hint: str) -> None:
    error = mistake(tmp_path, old, new)
    assert (error.field, error.line is not None) == (field, True)
    assert reason in error.reason
    assert hint in (error.hint or "")
    assert "more" not in (error.hint or "")


@pytest.mark.parametrize("name", sorted(CASES))
def test_shipped_files_are_what_the_script_writes(tmp_path: Path, name: str) -> None:
    written = write_case(name, SHIPPED, tmp_path)
    shipped = find_problem(name)
    for end in (".yaml", ".txt"):
        assert shipped.with_suffix(end).read_text("utf-8") == written.with_suffix(end).read_text("utf-8")


@pytest.mark.parametrize("name", sorted(CASES))
@pytest.mark.parametrize("waypoints", [200, 1000])
def test_cases_have_their_waypoints(name: str, waypoints: int) -> None:
    rows = CASES[name].path(waypoints)
    assert rows.shape == (waypoints, 6)
    assert np.linalg.norm(rows[:, 3:], axis=1) == pytest.approx(1.0)
    steps = np.linalg.norm(np.diff(rows[:, :3], axis=0), axis=1)
    assert np.median(steps) == pytest.approx(1.0, abs=1e-3)
    assert steps.max() < 1.001


def test_the_cap_is_that_of_the_facts() -> None:
    rows = cap(10_000)
    assert np.linalg.norm(rows[:, :3], axis=1) == pytest.approx(120.0)
    assert np.degrees(np.arccos(rows[-1, 5])) == pytest.approx(45.0)
    assert rows[0, 5] == 1.0


def test_a_problem_becomes_a_toolpath(tmp_path: Path) -> None:
    problem: Problem = load_problem(write_case("peer_cap", 500, tmp_path))
    toolpath = build_toolpath(problem)
    (bead,) = toolpath.beads
    assert np.linalg.norm(bead.points, axis=1)[5:] == pytest.approx(0.12, abs=1e-6)
    assert not bead.closed
    for sizes, size in ((bead.height, problem.process.bead.height), (bead.width, problem.process.bead.width)):
        assert sizes.tolist() == [size] * len(bead.s)
    assert bead.length == pytest.approx(0.499, rel=1e-3)
    assert replace(bead, layer=0).s is bead.s


@pytest.mark.skipif(not CHEN.exists(), reason="the authors' file is not part of the project")
def test_a_published_file_is_read(tmp_path: Path) -> None:
    problem = load_problem(case_text(tmp_path, str(CHEN), up="y", normals="inward", split_mm=3))
    (bead,) = build_toolpath(problem).beads
    points = np.loadtxt(CHEN)[:, [0, 2, 1]] * [1e-3, -1e-3, 1e-3]
    assert bead.normals[:, 2].min() > 0.5, "normals out of the part, which stands on its plate"
    path = make_interp_spline(np.arange(len(bead.s)), bead.points, k=5)(np.linspace(0, len(bead.s) - 1, 100_000))
    assert distance_to_polyline(points, path).max() <= problem.process.corner_tolerance
    assert np.median(distance_to_polyline(points, path)) < 5e-6


@pytest.mark.parametrize("corner", [False, True])
def test_waypoints_that_stand_too_close_together_are_not_all_sampled(corner: bool) -> None:
    """A published blade has them 0.035 mm apart: over such steps joints have no third derivatives but noise."""
    u = np.arange(0.0, 30.0, 0.035)  # mm along an arc, then off from it
    bent = np.where(u > 15.0, np.radians(80.0), 0.0) if corner else 0.0 * u
    heading = u / 40.0 + bent
    steps = 0.035e-3 * np.column_stack([np.cos(heading), np.sin(heading), 0.0 * u])
    points = np.cumsum(steps, axis=0)
    normals = np.column_stack([0.2 * np.sin(u / 12.0), 0.0 * u, np.ones(len(u))])
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    curve = interpolate(points, normals, TOLERANCE, 4e-4, 3e-4)
    assert len(curve.points) < len(points) / (2.5 if corner else 4.0)
    s = arc_lengths(curve.points)
    path, spin = CubicSpline(s, curve.points), CubicSpline(s, curve.normals)
    every = np.linspace(0.0, s[-1], 20 * len(s))
    off = distance_to_polyline(points, path(every))
    away = np.abs(u - 15.0) > 12.0 if corner else u >= 0.0
    assert off[away].max() < 2e-6
    assert off.max() < (TOLERANCE if corner else 2e-6)
    at = np.interp(arc_lengths(points), [0.0, arc_lengths(points)[-1]], [0.0, s[-1]])
    if not corner:
        assert np.degrees(np.linalg.norm(spin(at) - normals, axis=1)).max() < 0.01
