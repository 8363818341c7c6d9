"""Published files of waypoints: what they are taken for, where their part is put, and a row for each whatever happens."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from benchmarks import published, run
from benchmarks.published import jobs_of, left, main, parser, planned, summary
from benchmarks.rows import Row, Run, make_row, read_rows
from benchmarks.single import Job as SingleJob
from benchmarks.waypoint_files import FIT, Meaning, as_the_file_counts, files_in, look_at, place, together
from planner.base.errors import InputError
from planner.problem import load_problem
from planner.problem.layers import WaypointLayersSpec
from planner.toolpath.build import build_toolpath

HEIGHT, REACH = 0.8e-3, 0.9  # m
BEAD = (1e-3, HEIGHT)
OVER = np.linspace(0.0, 2.0 * np.pi, 60)
RING = np.column_stack([100 + 20 * np.cos(OVER), -40 + 20 * np.sin(OVER), 7 + 0 * OVER])  # mm, z up
UPWARDS = np.tile([0.0, 0.1, 1.0], (len(OVER), 1))


def y_up(points: np.ndarray) -> np.ndarray:
    """As a file has it whose y points up."""
    return np.column_stack([points[:, 0], points[:, 2], -points[:, 1]])


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Files as they are found: plain, with further columns, CSV in metres, y up with normals inward, and worse."""
    folder = tmp_path / "set"
    (folder / "layers").mkdir(parents=True)
    plain = np.hstack([RING, UPWARDS])
    np.savetxt(folder / "10.txt", plain, fmt="%.4f")
    np.savetxt(folder / "2.txt", np.hstack([y_up(RING), -y_up(UPWARDS)]), fmt="%.4f")
    np.savetxt(folder / "fibre.txt", np.hstack([plain, np.tile([0, 0, 2], (len(OVER), 1))]), fmt="%.5g")
    np.savetxt(
        folder / "metres.csv", np.hstack([1e-3 * RING, UPWARDS]), fmt="%.6f", delimiter=",",
        header="x [m],y [m],z [m],nx,ny,nz", comments="",
    )  # fmt: skip
    (folder / "broken.txt").write_text("1 2 3 0 0 1\n1 2 3 0 zero 1\n", encoding="utf-8")
    (folder / "notes.md").write_text("no waypoints", encoding="utf-8")
    for k in (0, 1):
        np.savetxt(folder / "layers" / f"{k}.xyz", np.hstack([RING + [0, 0, k], UPWARDS]), fmt="%.4f")
    (folder / "huge.dat").write_text("\n".join(f"{1000 * k} 0 0 0 0 1" for k in range(9)), encoding="utf-8")
    return folder


def test_files_are_found_in_their_order(folder: Path) -> None:
    names = [path.name for path in files_in(folder, [])]
    assert names == ["2.txt", "10.txt", "broken.txt", "fibre.txt", "huge.dat", "0.xyz", "1.xyz", "metres.csv"]
    assert [path.name for path in files_in(folder, ["layers/*.xyz"])] == ["0.xyz", "1.xyz"]
    with pytest.raises(InputError, match="holds no files of waypoints"):
        files_in(folder, ["*.md"])
    with pytest.raises(InputError, match="no such folder"):
        files_in(folder / "none", [])


def test_a_layer_may_count_its_normals_the_other_way(folder: Path) -> None:
    """Two of three layers point up; the third one is the other way round, and is placed as such."""
    sideways = np.hstack([RING + [0, 0, 2], -UPWARDS])
    np.savetxt(folder / "layers" / "2.xyz", sideways, fmt="%.4f")
    looks = [look_at(folder / "layers" / f"{k}.xyz") for k in (0, 1, 2)]
    for order in ((0, 1, 2), (2, 1, 0)):
        all_three = together([looks[k] for k in order])
        for k, normals in ((0, "outward"), (1, "outward"), (2, "inward")):
            placed = place(as_the_file_counts(all_three, looks[k]), Meaning(), BEAD, REACH, False)
            assert (placed.up, placed.normals) == ("z", normals)


def test_layers_that_follow_each_other_tell_up(tmp_path: Path) -> None:
    """Normals lean 60 degrees aside, more than up; layers go up along y. Out of order they say nothing."""
    leaning = np.tile([0.0, -np.cos(np.radians(60)), np.sin(np.radians(60))], (len(OVER), 1))
    looks = []
    for k in range(5):
        np.savetxt(tmp_path / f"{k}.txt", np.hstack([y_up(RING) + [0, k, 0.3 * k], leaning]), fmt="%.4f")
        looks.append(look_at(tmp_path / f"{k}.txt"))
    placed = place(together(looks), Meaning(), BEAD, REACH, False)
    assert (placed.up, placed.normals) == ("y", "inward")
    for some in ([3, 0, 4, 1, 2], [0, 1]):
        placed = place(together([looks[k] for k in some]), Meaning(), BEAD, REACH, False)
        assert (placed.up, placed.normals) == ("z", "outward")


@pytest.mark.parametrize(("sense", "normals"), [(1.0, "outward"), (-1.0, "inward")])
def test_a_wall_is_laid_on_its_back(folder: Path, sense: float, normals: str) -> None:
    """Its waypoints stand in y and z, its normals along x."""
    wall = np.hstack([np.roll(RING, 1, axis=1), sense * np.roll(UPWARDS, 1, axis=1)])
    np.savetxt(folder / "wall.txt", wall, fmt="%.4f")
    placed = place(look_at(folder / "wall.txt"), Meaning(), BEAD, REACH, False)
    assert (placed.up, placed.normals) == ("x", normals)
    problem = load_problem(
        "curved_plate", [f"layers={json.dumps({'source': placed.source(folder / 'wall.txt')})}", "part=null"]
    )
    (bead,) = build_toolpath(problem).beads
    assert bead.normals[:, 2].min() > 0.99 and np.ptp(bead.points[:, 2]) < 1e-6


@pytest.mark.parametrize("axis", ["x", "y", "z"])
def test_normals_all_round_a_part_tell_its_axis(tmp_path: Path, axis: str) -> None:
    wall = np.column_stack([20 * np.cos(OVER), 20 * np.sin(OVER), 5 + 0 * OVER, np.cos(OVER), np.sin(OVER), 0 * OVER])
    order = {"x": [2, 0, 1, 5, 3, 4], "y": [1, 2, 0, 4, 5, 3], "z": [0, 1, 2, 3, 4, 5]}[axis]
    np.savetxt(tmp_path / "wall.txt", wall[:, order], fmt="%.4f")
    placed = place(look_at(tmp_path / "wall.txt"), Meaning(), BEAD, REACH, False)
    assert (placed.up, placed.normals) == (axis, "outward")


@pytest.mark.parametrize(
    ("name", "unit", "up", "normals"),
    [
        ("10.txt", "mm", "z", "outward"),
        ("2.txt", "mm", "y", "inward"),
        ("fibre.txt", "mm", "z", "outward"),
        ("metres.csv", "m", "z", "outward"),
    ],
)
def test_every_format_is_the_same_ring(folder: Path, name: str, unit: str, up: str, normals: str) -> None:
    """However it is written, it stands in the middle, a bead's height above the bed, its normals upwards."""
    placed = place(look_at(folder / name), Meaning(), BEAD, REACH, shrink=True)
    assert (placed.unit, placed.up, placed.normals, placed.scale) == (unit, up, normals, 1.0)
    source = json.dumps({"source": placed.source(folder / name)})
    problem = load_problem("curved_plate", [f"layers={source}", "part=null", "process.bead.height_mm=0.8"])
    (bead,) = build_toolpath(problem).beads
    np.testing.assert_allclose(bead.points.min(axis=0), [-0.02, -0.02, HEIGHT], atol=2e-4)
    np.testing.assert_allclose(bead.points.max(axis=0), [0.02, 0.02, HEIGHT], atol=2e-4)
    assert bead.normals[:, 2].min() > 0.99


def test_what_is_given_is_not_guessed(folder: Path) -> None:
    placed = place(look_at(folder / "10.txt"), Meaning("m", "y", "inward"), BEAD, REACH, shrink=False)
    assert (placed.unit, placed.up, placed.normals, placed.scale) == ("m", "y", "inward", 1.0)
    round_about = np.hstack([RING, np.column_stack([np.cos(OVER), np.sin(OVER), 0 * OVER])])  # a cylinder's
    np.savetxt(folder / "10.txt", round_about)
    placed = place(look_at(folder / "10.txt"), Meaning(), BEAD, REACH, shrink=False)
    assert (placed.up, placed.normals) == ("z", "outward")


def test_what_is_too_big_is_shrunk_where_that_is_asked_for(folder: Path) -> None:
    look = look_at(folder / "huge.dat")
    assert place(look, Meaning(), BEAD, REACH, shrink=False).scale == 1.0
    placed = place(look, Meaning(), BEAD, REACH, shrink=True)
    assert placed.side_mm == 8000.0 and placed.scale == pytest.approx(FIT * REACH / 8.0, rel=1e-2)
    assert f"scale={placed.scale:g}" in placed.words and "side_mm=8000" in placed.words
    assert np.array(placed.origin_mm) == pytest.approx([-4000 * placed.scale, 0.0, 0.8])


def test_layers_stay_on_each_other(folder: Path) -> None:
    both = together([look_at(folder / "layers" / f"{k}.xyz") for k in (0, 1)])
    assert both.count == 2 * len(OVER)
    assert place(both, Meaning(), BEAD, REACH, shrink=False).origin_mm == pytest.approx((-100, 40, -6.2), abs=0.1)


def stack(side: float, step: float, layer: float) -> np.ndarray:
    """Waypoints of four passes beside each other, each two layers high, all in mm."""
    x = np.arange(0.0, side + 0.5 * step, step)
    rows = [
        np.column_stack([x[:: 1 - 2 * (k % 2)], np.full(len(x), 1.5 * layer * k), np.full(len(x), layer * n)])
        for n in range(2)
        for k in range(4)
    ]
    return np.hstack([np.vstack(rows), np.tile([0.0, 0.0, 1.0], (len(rows) * len(x), 1))])


@pytest.mark.parametrize("unit", ["mm", "m"])
@pytest.mark.parametrize(
    ("side", "step", "layer"),
    [(3.0, 0.2, 0.2), (4.9, 0.5, 0.4), (40.0, 0.5, 0.5), (300.0, 5.0, 4.0), (900.0, 10.0, 8.0)],
)
def test_the_unit_is_told_by_steps_and_passes_too(
    tmp_path: Path, unit: str, side: float, step: float, layer: float
) -> None:
    """A layer of 3 mm is not one of 3 m: its steps would be 200 mm long."""
    values = stack(side, step, layer) * ([1e-3 if unit == "m" else 1.0] * 3 + [1.0] * 3)
    np.savetxt(tmp_path / "a.txt", values, fmt="%.7g")
    look = look_at(tmp_path / "a.txt")
    for each in (look, together([look, look])):
        placed = place(each, Meaning(), BEAD, REACH, shrink=False, own_beads=True)
        assert placed.unit == unit
        assert placed.side_mm == pytest.approx(side, rel=0.15)
        assert placed.bead_mm == pytest.approx((1.5 * layer, layer), rel=0.02)
        assert placed.origin_mm[2] == pytest.approx(layer, rel=0.02)
    assert place(look, Meaning(), BEAD, REACH, shrink=False).bead_mm is None


def test_one_pass_says_nothing_of_beads(folder: Path) -> None:
    assert place(look_at(folder / "10.txt"), Meaning(), BEAD, REACH, shrink=False, own_beads=True).bead_mm is None


def test_uneven_steps_are_not_torn_into_waypoints_that_stand_alone(tmp_path: Path) -> None:
    """A meander written by its corners: its long sides are steps of the path."""
    ends = [(0.0, 20.0), (20.0, 0.0)]
    corners = [[ends[k % 2][i], 0.8 * k + over] for k in range(25) for i, over in ((0, 0.0), (1, 0.0), (1, 0.4))]
    meander = np.hstack([corners, np.tile([0.5, 0.0, 0.0, 1.0], (len(corners), 1))])
    np.savetxt(tmp_path / "meander.txt", np.vstack([meander, meander[::-1] + [100, 0, 0, 0, 0, 0]]), fmt="%.5g")
    placed = place(look_at(tmp_path / "meander.txt"), Meaning(), BEAD, REACH, shrink=False)
    assert placed.split_mm == pytest.approx(20.0, rel=1e-3) and f"split_mm={placed.split_mm:.4g}" in placed.words
    source = json.dumps({"source": placed.source(tmp_path / "meander.txt")})
    settings = [f"layers={source}", "part=null", "process.bead={width_mm: 0.8, height_mm: 0.5}"]
    assert len(build_toolpath(load_problem("curved_plate", settings)).beads) == 2
    even = stack(40.0, 0.5, 0.5)
    for name, rows in {"even": even, "stray": np.vstack([even, even[-1:] + [50, 0, 0, 0, 0, 0]])}.items():
        np.savetxt(tmp_path / f"{name}.txt", rows, fmt="%.5g")
        placed = place(look_at(tmp_path / f"{name}.txt"), Meaning(), BEAD, REACH, shrink=False)
        assert placed.split_mm is None, name  # a single waypoint far off is left out by the reader


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch) -> list[SingleJob]:
    """Nothing is planned: what was asked for is kept, and its problem loaded."""
    out: list[SingleJob] = []

    def run_apart(job: SingleJob) -> Row:
        out.append(job)
        layers = load_problem(job[0].problem, job[0].settings).layers
        assert isinstance(layers, WaypointLayersSpec)
        reason = f"{layers.source.waypoints}:7: told"
        return make_row(job[0], found=True, verified=True, waypoints=60, reason=reason)

    monkeypatch.setattr(published, "run_apart", run_apart)
    monkeypatch.setattr(run, "line", lambda row: str(row["problem"]))
    return out


@pytest.mark.slow
def test_a_row_for_each_file(
    folder: Path, tmp_path: Path, asked: list[SingleJob], capsys: pytest.CaptureFixture[str]
) -> None:
    """Failures with their reasons; the same command goes on where it ended, another one begins."""
    out = tmp_path / "rows.csv"
    command = [str(folder), "--cell", "curved_plate", "--out", str(out), "--limit", "9"]
    assert main([*command, "--pattern", "*.*"]) == 0
    rows = read_rows(out)
    assert [row["problem"] for row in rows] == [
        "2.txt", "10.txt", "broken.txt", "fibre.txt", "huge.dat", "metres.csv",
    ]  # fmt: skip
    bad = rows[2]
    assert not bad["found"] and bad["reason"] == "refused: broken.txt:2: 'zero' is not a number"
    assert rows[0]["set"].split("; ")[:3] == ["cell=curved_plate", "unit=mm", "up=y"]  # type: ignore[union-attr]
    assert {limit for _, limit in asked} == {9.0}
    assert "6 files: 5 verified" in (said := capsys.readouterr()).out and "1 x refused: broken.txt:2" in said.out
    asked.clear()
    assert main(command) == 0
    assert [row["problem"] for row in read_rows(out)[6:]] == ["layers/0.xyz", "layers/1.xyz"]
    assert len(asked) == 2 and "2 files, 6 are in" in capsys.readouterr().err
    assert main([*command, "--strategy", "ladder", "--pattern", "2.txt"]) == 0
    assert len(read_rows(out)) == 9 and asked[-1][0].strategy == "ladder"


def test_a_shrunk_copy_is_planned(folder: Path, asked: list[SingleJob]) -> None:
    options = parser().parse_args(
        [
            str(folder),
            "--cell",
            "curved_plate",
            "--scale",
            "--pattern",
            "huge.dat",
            "--up",
            "z",
            "--set",
            "layers.source.split_mm=500",
        ]
    )
    (job,) = jobs_of(options)
    row = planned(job)
    assert job.asked == "cell=curved_plate up=z layers.source.split_mm=500 to fit" and "scale=" in str(row["set"])
    assert asked[0][0].settings[-1] == "layers.source.split_mm=500"
    assert "huge.npz" in asked[0][0].settings[0] and row["problem"] == "huge.dat"
    assert row["reason"] == "huge.dat:7: told"
    assert not left([job], [row], anywhere=True) and left([job], [], anywhere=True) == [job]


def test_wrong_input_ends_at_once(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for cell, where, said in (("curved_plat", folder, "curved_plate"), ("curved_plate", tmp_path / "no", "no such")):
        assert main([str(where), "--cell", cell, "--out", str(tmp_path / "rows.csv")]) == 2
        assert said in capsys.readouterr().err
    assert not (tmp_path / "rows.csv").exists()


def test_the_summary_counts_reasons() -> None:
    rows = [make_row(Run(name, "sqp"), reason="no plan: out of reach") for name in "abc"]
    assert summary(rows)[1] == "  3 x no plan: out of reach"
