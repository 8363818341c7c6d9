"""Files of waypoints with named columns: CSV, text and NPZ, units, sizes, beads and layers, repetitions, smoothing."""

from __future__ import annotations

import io
import zipfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from test_waypoints import case_text

from planner.base.arrays import Array
from planner.base.errors import InputError
from planner.planning.solve_command import main
from planner.problem import load_problem
from planner.problem.layers import WaypointsSpec
from planner.toolpath.bead import Bead, Toolpath
from planner.toolpath.build import build_toolpath
from planner.toolpath.waypoints.normals import NOISY, UNASKED, calm_normals, jitter, smooth_normals
from planner.toolpath.waypoints.reader import NEEDED, OPTIONAL, Waypoints, read_waypoints
from planner.verify.reread.plane_curves import NotRead
from planner.verify.reread.points import segments_of

HEADER = "x,y,z,nx,ny,nz"


@pytest.fixture
def spec(tmp_path: Path) -> Callable[..., WaypointsSpec]:
    """Write a file and say how to read it: `spec("points.csv", text, unit='m')`."""

    def make(name: str, data: str | bytes, **options: object) -> WaypointsSpec:
        path = tmp_path / name
        path.write_bytes(data.encode() if isinstance(data, str) else data)
        return load_problem(case_text(tmp_path, name, **options)).layers.source

    return make


def packed(**arrays: object) -> bytes:
    stream = io.BytesIO()
    np.savez(stream, **{name: np.asarray(array) for name, array in arrays.items()})
    return stream.getvalue()


def line(count: int, **more: object) -> dict[str, Array]:
    """A straight path of `count` waypoints, 1 mm apart; and more columns."""
    zero = np.zeros(count)
    columns = {"x": np.arange(count) * 1.0, "y": zero, "z": zero, "nx": zero, "ny": zero, "nz": zero + 1.0}
    return columns | {name: np.broadcast_to(np.asarray(values, dtype=float), (count,)) for name, values in more.items()}


def csv(columns: dict[str, Array], separator: str = ",", comment: str = "", newline: str = "\n") -> str:
    head = comment + separator.join(columns)
    rows = [separator.join(f"{value:.10g}" for value in row) for row in zip(*columns.values(), strict=True)]
    return newline.join([head, *rows, ""])


# Reading


@settings(max_examples=40)
@given(
    st.permutations([*NEEDED, *OPTIONAL]),
    st.sampled_from(["npz", ",", " ", "\t", ", "]),
    st.sampled_from(["", "# ", "// "]),
    st.sampled_from(["\n", "\r\n"]),
    st.booleans(),
    st.sampled_from(["mm", "m"]),
    st.integers(0, 100),
)
def test_columns_in_any_order_say_the_same(
    tmp_path_factory: pytest.TempPathFactory,
    order: list[str],
    kind: str,
    comment: str,
    newline: str,
    mark: bool,
    unit: str,
    seed: int,
) -> None:
    rng = np.random.default_rng(seed)
    columns = line(9, layer=[3, 3, 3, 3, 5, 5, 5, 5, 5], bead=[1, 1, 2, 2, 1, 1, 1, 4, 4])
    columns |= {"width": rng.uniform(0.3, 0.9, 9), "height": rng.uniform(0.1, 0.3, 9)}
    columns |= {name: rng.normal(size=9) for name in ("nx", "ny", "nz")}
    scale = 1.0 if unit == "mm" else 1e-3
    written = {name: columns[name] * (scale if name in ("x", "y", "z", "width", "height") else 1.0) for name in order}
    folder = tmp_path_factory.mktemp("columns")
    if kind == "npz":
        data, name = packed(**written), "points.npz"
    else:
        text = ("\ufeff" if mark else "") + csv(written, kind, comment, newline)
        data, name = text.encode(), "points.csv"
    (folder / name).write_bytes(data)
    found = read_waypoints(load_problem(case_text(folder, name, unit=unit)).layers.source)
    assert [len(bead.points) for bead in found.beads] == [2, 2, 3, 2]
    assert [bead.layer for bead in found.beads] == [3, 3, 5, 5]
    assert found.notes == ()
    points = np.column_stack([columns[name] for name in ("x", "y", "z")]) * 1e-3
    normals = np.column_stack([columns[name] for name in ("nx", "ny", "nz")])
    assert np.vstack([bead.points for bead in found.beads]) == pytest.approx(points, abs=1e-10)
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    assert np.vstack([bead.normals for bead in found.beads]) == pytest.approx(normals, abs=1e-7)
    for size in ("width", "height"):
        values = np.concatenate([getattr(bead, size) for bead in found.beads])
        assert values == pytest.approx(columns[size] * 1e-3, rel=1e-8)
    lines = np.concatenate([bead.lines for bead in found.beads])
    assert lines.tolist() == list(range(1, 10) if kind == "npz" else range(2, 11))


def test_a_comment_that_is_no_header_is_a_remark(spec: Callable[..., WaypointsSpec]) -> None:
    text = "# nz ny nx, all in mm, z y x\n0 1 2 0 0 1\n1 1 2 0 0 1\n"
    (bead,) = read_waypoints(spec("a.txt", text)).beads
    assert bead.points[0] * 1e3 == pytest.approx([0, 1, 2])


def test_names_may_state_their_unit(spec: Callable[..., WaypointsSpec]) -> None:
    for head in (
        "X_mm,Y_mm,Z_mm,NX,NY,NZ,Width_mm",
        '"x [mm]",y (mm),z[mm],nx,ny,nz,width',
        "x [mm] y z nx ny nz width",
    ):
        separator = "," if "," in head else " "
        rows = "\n".join(separator.join(map(str, row)) for row in ([0, 1, 2, 0, 0, 1, 0.5], [1, 1, 2, 0, 0, 1, 0.6]))
        given = spec("a.csv", f"{head}\n{rows}\n")
        (bead,) = read_waypoints(given).beads
        assert bead.points[1] * 1e3 == pytest.approx([1, 1, 2])
        assert bead.width == pytest.approx([0.5e-3, 0.6e-3])
        assert starts_again(given) == pytest.approx(np.array([[0, 1, 2]]))


def starts_again(given: WaypointsSpec) -> Array:
    """Where the steps begin that the verifier reads of a file again [mm]."""
    again = segments_of(given)
    assert not isinstance(again, NotRead)
    return again.start * 1e3


ROWS = ([0, 1, 2, 0, 0, 1], [1.5, 1, 2, 0, 0, 1], [3, 1, 2, 0, 0, 1])


@pytest.mark.parametrize(
    ("head", "separator", "decimal"),
    [
        ("x;y;z;nx;ny;nz", ";", "."),
        ("x;y;z;nx;ny;nz", ";", ","),
        ("# exported", ";", ","),
        ("Path 7, 3 points\nof part A\n\nx,y,z,nx,ny,nz", ",", "."),
        ("X,Y,Z,I,J,K", ",", "."),
        ("x,y,z,nx,ny,nz\nmm,mm,mm,-,-,-", ",", "."),
        ("Path of a part", " ", "."),
        (",x,y,z,nx,ny,nz", ",", "."),
    ],
)
def test_spreadsheets_and_titles(
    tmp_path: Path, spec: Callable[..., WaypointsSpec], head: str, separator: str, decimal: str
) -> None:
    """Semicolons where the comma is decimal, titles above the names, units below them, a tool's axis, a column of numbers; and
    what the verifier reads of it again."""
    first = ["7"] if head.startswith(",") else []
    rows = "\n".join(separator.join(first + [str(v).replace(".", decimal) for v in row]) for row in ROWS)
    given = spec("a.csv", f"{head}\n{rows}\n")
    found = read_waypoints(given)
    assert found.beads[0].points * 1e3 == pytest.approx(np.array(ROWS)[:, :3])
    assert found.beads[0].normals == pytest.approx(np.array(ROWS)[:, 3:]) and not found.notes
    assert starts_again(given) == pytest.approx(np.array(ROWS)[:-1, :3])


# a pose that turns about y, with its x, y and z axes
TURNS = np.linspace(0.1, 0.6, 5)
PLACES = np.column_stack([np.arange(5.0), np.full(5, 2.0), np.full(5, 0.5)])
AXES = np.stack(
    [
        np.column_stack([np.cos(TURNS), 0 * TURNS, -np.sin(TURNS)]),
        np.tile([0.0, 1.0, 0.0], (5, 1)),
        np.column_stack([np.sin(TURNS), 0 * TURNS, np.cos(TURNS)]),
    ],
    axis=2,
)
POSES = np.concatenate([AXES, PLACES[:, :, None]], axis=2)
LAST = np.tile([0.0, 0.0, 0.0, 1.0], (5, 1))
COLUMNWISE = np.concatenate([POSES, LAST[:, None]], axis=1).transpose(0, 2, 1).reshape(5, 16)
QUATERNIONS = np.column_stack([0 * TURNS, np.sin(TURNS / 2), 0 * TURNS, np.cos(TURNS / 2)])


def numbers(*columns: np.ndarray) -> str:
    """Lines of numbers without names."""
    return "\n".join(" ".join(f"{value:.5f}" for value in row) for row in np.column_stack(columns)) + "\n"


@pytest.mark.parametrize(
    ("text", "reason", "hint"),
    [
        ("x,y,z,nx,ny,nz\nm,m,m,-,-,-\n0,0,0,0,0,1\n1,0,0,0,0,1\n", "column x is in m, but", "unit: m"),
        (
            "0 0 0 0.6 0 0.8 0\n1 0 0 0 0.7071 0.7071 0\n2 0 0 0.5 0.5 0.5 0.5\n",
            "a quaternion in each line",
            "nx ny nz",
        ),
        (numbers(PLACES, QUATERNIONS, TURNS), "a quaternion in each line, as in tool poses", "nx ny nz"),
        (numbers(TURNS, PLACES, QUATERNIONS), "as in tool poses in columns 5 to 8", "nx ny nz"),
        (numbers(POSES.reshape(5, 12), LAST), "the matrix of a pose", "its position and the direction"),
        (numbers(POSES.reshape(5, 12)), "the matrix of a pose", "its position and the direction"),
        (numbers(COLUMNWISE), "the matrix of a pose", "its position and the direction"),
        (
            numbers(AXES.transpose(0, 2, 1).reshape(5, 9)),
            "three axes of a frame in each line, and no point",
            "its position",
        ),
        (
            numbers(PLACES, AXES.transpose(0, 2, 1).reshape(5, 9)),
            "a point and the three axes",
            "of the axes, write only the direction",
        ),
        (
            numbers(np.arange(5.0), PLACES, AXES[:, :, 2]),
            "directions in columns 5 to 7, not in 4 to 6",
            "name the columns",
        ),
        (
            f"t,a,b,c,nx,ny,nz\n{numbers(np.arange(5.0), PLACES, AXES[:, :, 2])}",
            "columns x, y, z are missing",
            "x y z nx",
        ),
        (f"tip_a,tip_b,tip_c,q_x,q_y,q_z\n{numbers(PLACES, AXES[:, :, 2])}", "are missing", "columns: x y z"),
    ],
)
def test_what_is_meant_otherwise_is_refused(
    spec: Callable[..., WaypointsSpec], text: str, reason: str, hint: str
) -> None:
    with pytest.raises(InputError, match=reason) as caught:
        read_waypoints(spec("a.csv", text))
    assert hint in (caught.value.hint or "")


def test_a_seventh_column_beside_normals_is_passed_over(spec: Callable[..., WaypointsSpec]) -> None:
    (bead,) = read_waypoints(
        spec("a.txt", "0 0 0 0 0 1 0\n1 0 0 0 0.6 0.8 0\n2 0 0 0 0 1 0.5\n", smooth_normals_deg=0)
    ).beads
    assert len(bead.points) == 3


@pytest.mark.parametrize(
    "head",
    ["pos_x,pos_y,pos_z,normal_x,normal_y,normal_z", "X (mm),Y (mm),Z (mm),Normal X,Normal Y,Normal Z",
     '"Points:0","Points:1","Points:2","Normals:0","Normals:1","Normals:2"', "px,py,pz,n_x,n_y,n_z"],
)  # fmt: skip
def test_names_as_tables_are_exported(spec: Callable[..., WaypointsSpec], head: str) -> None:
    """The order of columns is that of the names, not that of lines without."""
    words = [*head.split(",")[3:], *head.split(",")[:3]]
    rows = "\n".join(",".join(map(str, [*row[3:], *row[:3]])) for row in ROWS)
    given = spec("a.csv", f"{','.join(words)}\n{rows}\n", smooth_normals_deg=0)
    found = read_waypoints(given)
    assert found.beads[0].points * 1e3 == pytest.approx(np.array(ROWS)[:, :3])
    assert found.beads[0].normals == pytest.approx(np.array(ROWS)[:, 3:]) and not found.notes
    assert starts_again(given) == pytest.approx(np.array(ROWS)[:-1, :3])


@pytest.mark.parametrize("name", ["{}", "{}_mm", "pos_{}", "Points:{}"])
def test_arrays_by_other_names_are_read_again(spec: Callable[..., WaypointsSpec], name: str) -> None:
    axes = "012" if ":" in name else "xyz"
    normals, points = ("nx", "ny", "nz"), [name.format(axis) for axis in axes]
    data = packed(**dict(zip((*normals, *points), np.roll(np.array(ROWS, dtype=float), 3, axis=1).T, strict=True)))
    assert read_waypoints(spec("a.npz", data)).beads[0].points * 1e3 == pytest.approx(np.array(ROWS)[:, :3])
    assert starts_again(spec("a.npz", data)) == pytest.approx(np.array(ROWS)[:-1, :3])


def test_a_file_that_holds_no_points_any_more_is_not_read_again(spec: Callable[..., WaypointsSpec]) -> None:
    for name, data in (
        ("a.npz", packed(a=[1.0, 2.0])),
        ("a.npz", b"PK\x05\x06" + 18 * b"\0"),
        ("a.txt", b"no table\n"),
    ):
        assert isinstance(segments_of(spec(name, data)), NotRead)


def test_angles_without_names_are_told(spec: Callable[..., WaypointsSpec]) -> None:
    """Three angles look like a normal; that its length is none of a normal's is said."""
    found = read_waypoints(spec("a.txt", numbers(PLACES, 180.0 + 0 * TURNS, 10.0 * TURNS, 90.0 + TURNS)))
    assert found.notes == (
        "a.txt: columns 4 to 6 are taken for normals, though they are 201 to 202 long: they are directions, not angles",
    )
    assert not read_waypoints(spec("b.txt", numbers(PLACES, AXES[:, :, 2], 0 * TURNS))).notes


def test_columns_that_mean_nothing_are_told(spec: Callable[..., WaypointsSpec]) -> None:
    found = read_waypoints(spec("a.csv", csv(line(3, speed=1, qw=2))))
    assert found.notes == ("a.csv: unused columns: speed, qw",)


@given(st.data())
@settings(max_examples=30, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_vertices_of_an_obj_file_are_waypoints(spec: Callable[..., WaypointsSpec], data: st.DataObject) -> None:
    """Points and normals, in whatever order lines of the two kinds stand."""
    count = data.draw(st.integers(2, 8))
    points = np.arange(3.0 * count).reshape(-1, 3)
    normals = np.array([[0.1 * k, 0.0, 1.0] for k in range(count)])
    rows = [("v", points), ("vn", normals)]
    order = data.draw(st.permutations(["v"] * count + ["vn"] * count))
    left = {name: iter(table) for name, table in rows}
    lines = [f"{name}  " + " ".join(f"{value:g}" for value in next(left[name])) for name in order]
    (bead,) = read_waypoints(spec("a.txt", "\n".join(["# a list", *lines, "e 0.2", ""]), smooth_normals_deg=0)).beads
    assert bead.points * 1e3 == pytest.approx(points)
    assert bead.normals == pytest.approx(normals / np.linalg.norm(normals, axis=1)[:, None])
    assert bead.lines.tolist() == [i for i, name in enumerate(order, 2) if name == "v"]


def test_repeated_waypoints_are_counted(spec: Callable[..., WaypointsSpec]) -> None:
    columns = line(7, bead=[1, 1, 1, 1, 2, 2, 2]) | {"x": np.array([0, 1, 1, 2, 2, 3, 3.0])}
    found = read_waypoints(spec("a.csv", csv(columns)))
    assert [bead.points[:, 0].tolist() for bead in found.beads] == [[0, 1e-3, 2e-3], [2e-3, 3e-3]]
    assert found.notes == ("a.csv: 2 waypoints that repeat the one before left out",)


def test_that_a_repeated_waypoint_says_otherwise_is_told(spec: Callable[..., WaypointsSpec]) -> None:
    text = "0 0 0 0 0 1\n1 0 0 0 0 1\n1 0 0 1 0 0\n2 0 0 0 0 1\n2 0 0 0 0.01 1\n"
    found = read_waypoints(spec("a.txt", text))
    assert found.beads[0].normals == pytest.approx(np.tile([0.0, 0.0, 1.0], (3, 1)))
    assert found.notes == (
        "a.txt: 2 waypoints that repeat the one before left out; their normals differ from its by up to 90 degrees",
    )


def test_a_column_of_beads_decides_where_they_end(spec: Callable[..., WaypointsSpec]) -> None:
    columns = line(8, bead=[0, 0, 0, 0, 0, 7, 7, 7]) | {"x": np.array([0, 1, 2, 20, 21, 22, 23, 24.0])}
    counts = [len(bead.points) for bead in read_waypoints(spec("a.csv", csv(columns))).beads]
    assert counts == [5, 3]
    counts = [len(bead.points) for bead in read_waypoints(spec("a.csv", csv(columns), split_mm=5)).beads]
    assert counts == [3, 2, 3]
    del columns["bead"]
    counts = [len(bead.points) for bead in read_waypoints(spec("a.csv", csv(columns))).beads]
    assert counts == [3, 5]
    layers = csv(columns | {"layer": np.array([0, 0, 0, 0, 0, 0, 1.0, 1])})
    counts = [len(bead.points) for bead in read_waypoints(spec("a.csv", layers)).beads]
    assert counts == [3, 3, 2]


# What is wrong

GOOD = "0,0,0,0,0,1"
WRONG = [
    # name, file, line, reason, hint
    ("a.csv", "x,y,z,nx,ny\n0,0,0,0,1\n", 1, "column nz is missing", "x y z nx ny nz"),
    ("a.csv", "x,y,z\n0,0,0\n1,0,0\n", 1, "columns nx, ny, nz are missing", ""),
    ("a.csv", f"{HEADER},widht\n{GOOD},1\n", 1, "unknown column 'widht'", "did you mean width?"),
    ("a.csv", f"{HEADER},x\n{GOOD},1\n", 1, "column x occurs twice", ""),
    ("a.csv", f"x_m,y_m,z_m,nx,ny,nz\n{GOOD}\n", 1, "column x is in m, but layers.source.unit is mm", "unit: m"),
    ("a.csv", f"x_in,y_in,z_in,nx,ny,nz\n{GOOD}\n", 1, "column x is in in", "lengths are read in mm or m"),
    ("a.csv", f"# X [inch] Y [inch] Z [inch] nx ny nz\n{GOOD}\n", 1, "column x is in inch", "mm or m"),
    ("a.csv", f"{HEADER}\ncm,cm,cm,-,-,-\n{GOOD}\n", 1, "column x is in cm", "mm or m"),
    ("a.csv", f"{HEADER},width\r\n{GOOD},1\r\n{GOOD},\r\n", 3, "width is missing", ""),
    ("a.csv", f"{HEADER},width\n{GOOD},1\n{GOOD}\n", 3, "the header names 7 columns; here are 6 values", ""),
    ("a.csv", f"{HEADER},width\n{GOOD},1\n1,0,0,0,0,1,-2\n", 3, "width is -2 mm", "0.01 to 50 mm"),
    ("a.csv", f"{HEADER},height\n{GOOD},1\n1,0,0,0,0,1,nan\n", 3, "'nan' is not a number", ""),
    ("a.csv", f"{HEADER},layer\n{GOOD},1\n1,0,0,0,0,1,1.5\n", 3, "layer is 1.5", "whole number"),
    ("a.csv", f"{HEADER},bead\n{GOOD},1\n1,0,0,0,0,1,1e9\n", 3, "bead is 1e+09", "whole number"),
    ("a.csv", f"{HEADER},bead\n{GOOD},1\n1,0,0,0,0,1,2\n2,0,0,0,0,1,2\n", 2, "is the only one of its bead", "two"),
    ("a.csv", f"{HEADER}\n{GOOD}\n1,0,0,0,0,0\n", 3, "the normal is zero", "direction"),
    ("a.csv", f"{HEADER}\n{GOOD}\n", None, "no two different waypoints", ""),
    ("a.csv", f"{HEADER}\n", None, "holds no waypoints", ""),
    ("a.obj", "v 0 0 0\nv 1 0 0\nvn 0 0 1\n", None, "has 2 points (v) and 1 normals (vn)", "a normal for each"),
    ("a.obj", "vn 0 0 1\n", None, "has 0 points (v) and 1 normals (vn)", ""),
    ("a.obj", "v 0 0 0\nvn 0 0 1\nv 1 0\nvn 0 0 1\n", 3, "is not a point or normal of three numbers", ""),
    ("a.obj", "v 0 0 0\nvn 0 0 1\nv 1 0 z\nvn 0 0 1\n", 3, "is not a point or normal of three numbers", ""),
    ("a.npz", packed(**(line(3) | {"z": np.array([0, np.nan, 0])})), 2, "'nan' is not a number", ""),
    ("a.npz", packed(**(line(3) | {"nz": np.array([1, 1, 0])})), 3, "the normal is zero", ""),
    ("a.npz", packed(**(line(3) | {"y": np.zeros(4)})), None, "array y has 4 numbers, x has 3", ""),
    ("a.npz", packed(**(line(3) | {"y": np.zeros((3, 1))})), None, "array y is 3 x 1 of float64", ""),
    ("a.npz", packed(**(line(3) | {"y": 1j * np.zeros(3)})), None, "of complex128", ""),
    ("a.npz", packed(**(line(3) | {"y": np.array(["a", "b", "c"])})), None, "array y is 3 of <U1", ""),
    ("a.npz", packed(**(line(3) | {"y": np.array([None, 1, 2])})), None, "allow_pickle=False", ""),
    ("a.npz", packed(**(line(3) | {"layr": np.zeros(3)})), None, "unknown column 'layr'", "did you mean layer?"),
    ("a.npz", packed(**{k: v for k, v in line(3).items() if k != "nz"}), None, "column nz is missing", ""),
    ("a.npz", packed(**line(0)), None, "holds no waypoints", ""),
    ("a.npz", packed(**line(1)), None, "no two different waypoints", ""),
    ("a.npz", b"x,y,z", None, "is not an NPZ file", "numpy.savez"),
    ("a.npz", packed(**line(3))[:-40], None, "is not an NPZ file", "numpy.savez"),
    ("a.npz", b"", None, "is not an NPZ file", "numpy.savez"),
]  # fmt: skip


@pytest.mark.parametrize(("name", "data", "line", "reason", "hint"), WRONG)
def test_mistakes_name_file_line_and_what_would_be_right(
    spec: Callable[..., WaypointsSpec], name: str, data: str | bytes, line: int | None, reason: str, hint: str
) -> None:
    with pytest.raises(InputError) as caught:
        read_waypoints(spec(name, data))
    error = caught.value
    assert (error.line, Path(str(error.file)).name) == (line, name)
    assert reason in error.reason
    assert hint in (error.hint or "")


@pytest.mark.parametrize(("name", "data"), [(row[0], row[1]) for row in WRONG[::4]])
def test_nothing_is_written_for_a_bad_file(
    tmp_path: Path, name: str, data: str | bytes, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / name).write_bytes(data.encode() if isinstance(data, str) else data)
    out = tmp_path / "out"
    assert main([str(case_text(tmp_path, name)), "--out", str(out), "--quiet"]) == 2
    assert not out.exists()
    message = capsys.readouterr().err
    assert message.startswith("error: ")
    assert message.count("\n") == 1


def test_a_file_in_metres_is_told_from_one_in_millimetres_by_its_size(tmp_path: Path) -> None:
    """A line of 120 mm, written in metres; and read so, it is one."""
    (tmp_path / "a.csv").write_text(csv(line(121) | {"x": np.linspace(0.0, 0.12, 121)}))
    told = "it measures only 0.12 x 0 x 0 mm; read in metres (layers.source.unit: m) it would measure 120 x 0 x 0 mm"
    with pytest.raises(InputError, match=r"is only 0\.1200 mm long") as caught:
        build_toolpath(load_problem(case_text(tmp_path, "a.csv")))
    assert caught.value.hint == told
    toolpath = build_toolpath(load_problem(case_text(tmp_path, "a.csv", unit="m")))
    assert toolpath.beads[0].length == pytest.approx(0.12)
    assert not any("in metres" in note for note in toolpath.notes)


def test_a_file_that_is_hardly_larger_than_a_bead_gets_a_note(tmp_path: Path) -> None:
    """A line of 1 m in metres, long enough for a bead in mm; and one that turns back, whose corners are too sharp then."""
    (tmp_path / "a.csv").write_text(csv(line(101) | {"x": np.linspace(0.0, 1.0, 101)}))
    notes = build_toolpath(load_problem(case_text(tmp_path, "a.csv"))).notes
    assert any("layers.source.unit: m" in note for note in notes)
    x = np.abs(np.arange(0.0, 40.0, 0.1) % 2.0 - 1.0) * 0.12
    (tmp_path / "a.csv").write_text(csv(line(len(x)) | {"x": x, "y": np.arange(len(x)) * 1e-4}))
    with pytest.raises(InputError, match="shrinks path") as caught:
        build_toolpath(load_problem(case_text(tmp_path, "a.csv")))
    assert "layers.source.unit: m" in str(caught.value)


@pytest.mark.slow
def test_an_archive_that_unpacks_to_too_much_is_refused(spec: Callable[..., WaypointsSpec]) -> None:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
        for name in NEEDED:
            archive.writestr(f"{name}.npy", bytes(90_000_000))
    assert len(stream.getvalue()) < 1_000_000
    with pytest.raises(InputError, match="unpacks to more than 500 MB"):
        read_waypoints(spec("a.npz", stream.getvalue()))


def test_an_array_that_lies_about_its_size_is_refused(spec: Callable[..., WaypointsSpec]) -> None:
    whole = packed(**line(3))
    assert whole.count(b"'shape': (3,), ") == 6
    with zipfile.ZipFile(io.BytesIO(whole)) as archive:
        parts = {entry: archive.read(entry) for entry in archive.namelist()}
    parts["x.npy"] = parts["x.npy"].replace(b"(3,), }        ", b"(30000000,), } ")
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as archive:
        for entry, data in parts.items():
            archive.writestr(entry, data)
    with pytest.raises(InputError, match="not an NPZ file"):
        read_waypoints(spec("a.npz", stream.getvalue()))


# What becomes of it


def built(folder: Path, name: str, data: str | bytes, process: str = "", **options: object) -> Toolpath:
    (folder / name).write_bytes(data.encode() if isinstance(data, str) else data)
    path = case_text(folder, name, **options)
    path.write_text(path.read_text("utf-8").replace("height_mm: 0.5", f"height_mm: 0.5{process}"), "utf-8")
    return build_toolpath(load_problem(path))


def test_widths_and_heights_are_those_of_the_file(tmp_path: Path) -> None:
    u = np.arange(21.0)
    columns = line(21, width=0.4 + 0.01 * u, height=0.2 + 0.005 * u)
    (bead,) = built(tmp_path, "a.csv", csv(columns)).beads
    assert bead.width == pytest.approx(0.4e-3 + 0.01 * bead.s, abs=1e-9)
    assert bead.height == pytest.approx(0.2e-3 + 0.005 * bead.s, abs=1e-9)
    (bead,) = built(tmp_path, "a.csv", csv(line(21, height=0.3))).beads
    assert (bead.width.min(), bead.width.max()) == (0.6e-3, 0.6e-3)
    assert bead.height == pytest.approx(0.3e-3)


def test_the_surface_lies_a_beads_own_height_beneath(tmp_path: Path) -> None:
    first = line(31, height=0.3, layer=4)
    second = line(31, height=0.7, layer=9) | {"z": np.full(31, 0.7)}
    text = csv({name: np.concatenate([first[name], second[name]]) for name in first})
    toolpath = built(tmp_path, "a.csv", text)
    assert [bead.layer for bead in toolpath.beads] == [0, 1]
    for i, height in enumerate((0.3e-3, 0.7e-3)):
        tips = toolpath.beads[i].points[10:20]
        assert toolpath.surface.before(i + 1).signed_distance(tips) == pytest.approx(height, abs=1e-9)


def test_layers_of_the_file_stand_even_where_nothing_lies_beneath(tmp_path: Path) -> None:
    columns = line(20, layer=np.repeat([2, 8], 10), bead=np.repeat([0, 1], 10))
    columns["x"] = np.concatenate([np.arange(10.0), 40 + np.arange(10.0)])
    text = csv(columns)
    assert [bead.layer for bead in built(tmp_path, "a.csv", text).beads] == [0, 1]
    del columns["layer"]
    assert [bead.layer for bead in built(tmp_path, "a.csv", csv(columns)).beads] == [0, 0]


def test_a_rounded_bead_is_at_least_as_wide_as_high(tmp_path: Path) -> None:
    text = csv(line(9, width=[0.6] * 5 + [0.4] * 4))
    with pytest.raises(InputError, match=r"rounded bead cannot be 0\.4 mm wide and 0\.5 mm high") as caught:
        built(tmp_path, "a.csv", text, process=", section: rounded")
    assert caught.value.line == 7


def test_metres_and_millimetres_make_the_same_bead(tmp_path: Path) -> None:
    u = np.linspace(0, 3, 40)
    columns = line(40) | {"x": 20 * np.cos(u), "y": 20 * np.sin(u), "nx": np.cos(u), "ny": np.sin(u), "nz": 0.5 + 0 * u}
    (a,) = built(tmp_path, "a.npz", packed(**columns)).beads
    metres = columns | {name: columns[name] * 1e-3 for name in ("x", "y", "z")}
    (b,) = built(tmp_path, "a.npz", packed(**metres), unit="m").beads
    for name in ("s", "points", "normals", "width"):
        assert getattr(a, name) == pytest.approx(getattr(b, name), abs=1e-12)
    assert replace(a, closed=False) is not None and isinstance(a, Bead)


# Smoothing

STEP = 1e-3  # m between waypoints


def along(count: int) -> Array:
    return STEP * np.arange(count)


def noisy(seed: int, count: int, noise: float) -> tuple[Array, Array]:
    """Normals along an arc of a dome, and the same with noise [rad]."""
    rng = np.random.default_rng(seed)
    u = np.linspace(0.0, 1.2, count)
    true = np.column_stack([np.sin(u) * np.cos(u), np.sin(u) ** 2, np.cos(u)])
    spoilt = true + rng.normal(0.0, noise, (count, 3))
    return true, spoilt / np.linalg.norm(spoilt, axis=1)[:, None]


def between(a: Array, b: Array) -> Array:
    return np.asarray(np.arctan2(np.linalg.norm(np.cross(a, b), axis=1), (a * b).sum(axis=1)))


@settings(max_examples=40)
@given(st.integers(0, 10_000), st.integers(2, 300), st.floats(0.0, 0.5), st.floats(1e-4, 0.5))
def test_no_normal_turns_by_more_than_the_bound(seed: int, count: int, noise: float, bound: float) -> None:
    _, given_ = noisy(seed, count, noise)
    smooth, turned = smooth_normals(given_, along(count), bound)
    assert np.linalg.norm(smooth, axis=1) == pytest.approx(1.0, abs=1e-12)
    assert between(smooth, given_).max() <= bound * (1 + 1e-9)
    assert turned == pytest.approx(between(smooth, given_), abs=1e-12)


@pytest.mark.parametrize("seed", range(5))
def test_noise_within_the_bound_goes(seed: int) -> None:
    noise = np.radians(0.5)
    true, given_ = noisy(seed, 400, noise)
    smooth, _ = smooth_normals(given_, along(400), np.radians(3.0))
    assert np.sqrt((between(smooth, true) ** 2).mean()) < 0.45 * np.sqrt((between(given_, true) ** 2).mean())
    shaken, still = (np.linalg.norm(np.diff(rows, 2, axis=0), axis=1).max() for rows in (given_, smooth))
    assert still < 0.02 * shaken


def test_one_outlier_does_not_keep_its_neighbours_rough() -> None:
    true, given_ = noisy(1, 400, np.radians(0.3))
    given_ = given_.copy()
    given_[200] = [0.3, 0.3, 0.9]
    given_[200] /= np.linalg.norm(given_[200])
    smooth, _ = smooth_normals(given_, along(400), np.radians(2.0))
    away = np.abs(np.arange(400) - 200) > 60
    assert np.degrees(between(smooth, true))[away].max() < 0.5


def test_smooth_normals_stay_as_they_are() -> None:
    true, _ = noisy(0, 300, 0.0)
    smooth, _ = smooth_normals(true, along(300), np.radians(1.0))
    assert np.degrees(between(smooth, true)).max() < 0.001


def test_slow_waves_stay() -> None:
    u = 2.0 * np.pi * np.arange(300) / 25.0  # a spiral about the top of a dome, 25 waypoints a turn
    cone = np.column_stack([np.cos(u), np.sin(u), np.full(300, 25.0)])
    cone /= np.linalg.norm(cone, axis=1)[:, None]
    smooth, _ = smooth_normals(cone, along(300), np.radians(5.0))
    assert np.degrees(between(smooth, cone)).max() < 0.3 * np.degrees(np.arctan(1.0 / 25.0))


@settings(max_examples=60, deadline=None)
@given(st.binary(max_size=400), st.sampled_from(["a.csv", "a.npz"]), st.booleans())
def test_any_bytes_are_read_or_refused(
    tmp_path_factory: pytest.TempPathFactory, data: bytes, name: str, like: bool
) -> None:
    if like:  # the middle of a file is spoilt
        whole = packed(**line(5)) if name == "a.npz" else csv(line(40)).encode()
        data = whole[:300] + data + whole[300 + len(data) :]
    folder = tmp_path_factory.mktemp("bytes")
    (folder / name).write_bytes(data)
    try:
        found = read_waypoints(load_problem(case_text(folder, name)).layers.source)
    except InputError as error:
        assert "\n" not in str(error)
    else:
        assert np.isfinite(np.vstack([bead.points for bead in found.beads])).all()


def test_smoothing_is_by_length_and_not_by_number() -> None:
    """Of uneven waypoints what is left of noise is as much as of even ones, and a slow wave stays."""
    rng = np.random.default_rng(4)
    for s in (along(400), np.cumsum(rng.choice([0.25, 1.75], 400) * STEP), along(1600) / 4.0):
        lean = 0.2 * np.sin(2.0 * np.pi * s / 0.06)
        true = np.column_stack([np.sin(lean), 0.0 * s, np.cos(lean)])
        spoilt = true + rng.normal(0.0, 5e-3, true.shape)
        spoilt /= np.linalg.norm(spoilt, axis=1)[:, None]
        smooth, _ = smooth_normals(spoilt, s, np.radians(3.0))
        inner = (s > 0.02) & (s < s[-1] - 0.02)
        assert np.sqrt((between(smooth, true)[inner] ** 2).mean()) < 0.45 * 5e-3 * np.sqrt(2.0)
        turning = np.linalg.norm(np.gradient(smooth, s, axis=0), axis=1)[inner]
        assert turning.max() < 1.35 * 0.2 * 2.0 * np.pi / 0.06
        np.testing.assert_allclose(smooth_normals(true, s, 0.1)[0][inner], true[inner], atol=5e-4)


@pytest.mark.parametrize("close", [0.1, 0.03, 0.021])
def test_waypoints_close_together_turn_no_faster_than_others(close: float) -> None:
    """What is smooth over the path's length is so between two waypoints that hardly are apart: a curve through all of them
    swings out where their normals differ by more than their distance is worth."""
    rng = np.random.default_rng(3)
    step = np.full(60, 0.5e-3)
    step[29:31] = close * 0.5e-3
    s = np.concatenate([[0.0], np.cumsum(step)])
    lean = 0.1 * np.sin(2.0 * np.pi * s / 0.04) + rng.normal(0.0, 0.01, len(s))
    noisy = np.column_stack([np.sin(lean), 0.0 * s, np.cos(lean)])
    smooth, _ = smooth_normals(noisy, s, np.radians(3.0))
    turning = np.linalg.norm(np.diff(smooth, axis=0), axis=1) / np.diff(s)
    assert turning[29:31].max() < 1.1 * max(turning[28], turning[31])


@pytest.mark.parametrize(
    ("wave", "swing_deg", "step"), [(20.0, 20.0, 2.0), (20.0, 45.0, 1.0), (30.0, 30.0, 2.0), (10.0, 20.0, 0.5)]
)
def test_what_is_curved_is_not_noisy(wave: float, swing_deg: float, step: float) -> None:
    """Exact normals of a corrugated sheet, however steep, and evenly or unevenly spaced; then with noise."""
    rng = np.random.default_rng(0)
    even = np.arange(0.0, 200.0, step)
    for s in (even, even + rng.uniform(-0.3, 0.3, len(even)) * step):
        lean = np.radians(swing_deg) * np.sin(2.0 * np.pi * s / wave)
        normals = np.column_stack([np.sin(lean), 0.0 * lean, np.cos(lean)])
        assert np.median(jitter(normals, s * 1e-3)) < NOISY
        spoilt = normals + rng.normal(0.0, np.radians(0.3), normals.shape)
        assert np.degrees(np.median(jitter(spoilt, s * 1e-3))) == pytest.approx(0.46, rel=0.35)  # of three components


def test_a_closed_path_is_smooth_where_it_closes() -> None:
    rng = np.random.default_rng(2)
    angle = np.linspace(0.0, 2.0 * np.pi, 201)
    points = 0.02 * np.column_stack([np.cos(angle), np.sin(angle), 0.0 * angle])
    normals = np.column_stack([0.3 * np.cos(angle), 0.3 * np.sin(angle), np.ones(201)])
    spoilt = normals + rng.normal(0.0, 0.01, normals.shape)
    spoilt[-1] = spoilt[0]
    spoilt /= np.linalg.norm(spoilt, axis=1)[:, None]
    ring = Waypoints("ring", points, spoilt, np.arange(201), None, None, None)
    (calm,), told = calm_normals([ring], None)
    assert "noisy" in told
    assert np.degrees(between(calm.normals[:1], calm.normals[-1:]))[0] < 0.02
    turning = np.linalg.norm(np.diff(np.vstack([calm.normals[-6:-1], calm.normals[:6]]), axis=0), axis=1)
    assert turning.max() < 2.0 * turning.min()


def test_nothing_is_told_where_nothing_is_smoothed() -> None:
    path = Waypoints("short", np.eye(3), np.tile([0.0, 0.0, 1.0], (3, 1)), np.arange(3), None, None, None)
    for asked in (None, np.radians(3.0), 1e-30):
        assert calm_normals([path], asked) == ((path,), "")


@pytest.mark.parametrize("noise", [0.0, 0.02])
def test_noise_is_smoothed_unless_asked_not_to_and_is_told(spec: Callable[..., WaypointsSpec], noise: float) -> None:
    _, normals = noisy(3, 50, noise)
    columns = line(50) | dict(zip(("nx", "ny", "nz"), normals.T, strict=True))
    beads = read_waypoints(spec("a.npz", packed(**columns))).beads
    assert beads[0].normals == pytest.approx(normals, abs=1e-12)
    for asked, unasked in ((0.0, UNASKED), (None, 0.0)):
        assert calm_normals(beads, asked, unasked) == (beads, "")
    (found,), told = calm_normals(beads, None)
    turned = np.degrees(between(found.normals, normals))
    if noise == 0.0:
        assert not told
        assert not turned.any()
    else:
        assert told.startswith("normals smoothed since they are noisy (half of them by more than")
        assert f"by {turned.max():.3f} degrees at most and {turned.mean():.3f} on average" in told
        assert 0.2 < turned.max() <= 3.0
    (found,), told = calm_normals(beads, np.radians(1.0))
    turned = np.degrees(between(found.normals, normals))
    assert turned.max() <= 1.0
    assert told == f"normals smoothed, by {turned.max():.3f} degrees at most and {turned.mean():.3f} on average"


@pytest.mark.parametrize(("cone", "smoothed"), [(0, True), (5, False)])
def test_a_nozzle_that_may_lean_needs_no_smoothing(tmp_path: Path, cone: float, smoothed: bool) -> None:
    _, normals = noisy(3, 50, 0.02)
    (tmp_path / "a.csv").write_text(csv(line(50) | dict(zip(("nx", "ny", "nz"), normals.T, strict=True))))
    notes = build_toolpath(
        load_problem(case_text(tmp_path, "a.csv"), [f"process.cones.nozzle_normal_deg={cone}"])
    ).notes
    assert any("normals smoothed since they are noisy" in note for note in notes) is smoothed
