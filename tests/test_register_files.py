"""Files of contacts: what is read, and what is told of contacts that say too little, or the wrong thing."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from contact_files import MOVED, TURNED, chosen, contacts, scene, scratch
from hypothesis import given
from hypothesis import strategies as st

from benchmarks.touching import cartesian, misplaced, tips_of, write_contacts
from planner.base.errors import InputError
from planner.cell.cell import build_cell
from planner.problem import load_problem
from planner.register.contacts import contacts_of, read_readings
from planner.register.finding import Ask, register

# Files


HEAD = "x_mm,y_mm,z_mm,rotation"
GOOD = ["667,9,420,0", "600,10,430,10", "633,43,410,20", "640,-20,440,-30"]


def read(tmp_path: Path, *lines: str, name: str = "cylinder_logo"):
    file = tmp_path / "contacts.csv"
    file.write_text("\n".join(lines), encoding="utf-8")
    return read_readings(file, scene(name).cell)


@pytest.mark.slow
def test_columns_in_any_order_with_names_and_units(tmp_path: Path) -> None:
    rows_ = ["# touched on Monday", "", "Contact; rotation [deg]; Z (mm); y; x_mm; AX; ay; az"]
    readings = read(tmp_path, *rows_, "rim; 90; 3; 2; 1; 0; 0; -2", "", "top;-90;6;5;4;3;0;4")
    assert readings.names == ("rim", "top")
    np.testing.assert_array_equal(readings.tips, [[1, 2, 3], [4, 5, 6]])
    np.testing.assert_array_equal(readings.holder, [[90], [-90]])
    np.testing.assert_allclose(readings.axes, [[0, 0, -1], [0.6, 0, 0.8]])
    np.testing.assert_array_equal(readings.lines, [4, 6])


@pytest.mark.parametrize(
    ("lines", "line", "words_"),
    [
        ([], None, "holds no contacts"),
        (["# only a remark"], None, "holds no contacts"),
        ([HEAD], 1, "no contacts below its header"),
        (GOOD, 1, "a header that names the columns is missing"),
        (["x_mm,y_mm,z_mm", "1,2,3"], 1, "column rotation is missing"),
        (["x_mm,z_mm,rotation", "1,2,3"], 1, "column y is missing"),
        (["joint_1,joint_2,rotation", "1,2,3"], 1, "columns joint_3, joint_4, joint_5, joint_6 are missing"),
        (["x_mm,y_mm,z_mm,rotaton", "1,2,3,4"], 1, "did you mean rotation?"),
        (["x_mm,y_mm,z_mm,rotation,hue", "1,2,3,4,5"], 1, "unknown column 'hue'"),
        (["x_m,y_m,z_m,rotation", "1,2,3,4"], 1, "'x_m' is in m"),
        (["x_mm,y_mm,z_mm,rotation_rad", "1,2,3,4"], 1, "is in rad"),
        (["x_mm,x,y_mm,z_mm,rotation", "1,1,2,3,4"], 1, "column x appears twice"),
        (["x_mm,y_mm,z_mm,joint_1,rotation", "1,2,3,4,5"], 1, "leave one of them out"),
        (["x_mm,y_mm,z_mm,rotation,ax", "1,2,3,4,5"], 1, "columns ay, az are missing"),
        (["x_mm,y_mm,z_mm,rotation,ax,ay,az", "1,2,3,4,0,0,0"], 2, "no direction"),
        (["name,contact,x_mm,y_mm,z_mm,rotation", "a,b,1,2,3,4"], 1, "both name and contact"),
        ([HEAD, "1,2,3,4", "1,2,nan,4"], 3, "z: nan is not a finite number"),
        ([HEAD, "1,2,inf,4"], 2, "z: inf is not a finite number"),
        ([HEAD, "1,2,,4"], 2, "z: is missing"),
        ([HEAD, "1,2,high,4"], 2, "z: 'high' is not a number"),
        ([HEAD, "1,2,1_0,4"], 2, "z: '1_0' is not a number"),
        ([HEAD, "1,2,3e7,4"], 2, "3e7 is too large"),
        ([HEAD, "1,2,3,4000"], 2, "4000 is too large"),
        ([HEAD, "1,2,3"], 2, "the header names 4 columns; here are 3 values"),
        ([HEAD.replace(",", ";"), "1,5;2;3;4"], 2, "a decimal point, not a comma"),
    ],
)
def test_a_bad_file_is_told_with_its_line(tmp_path: Path, lines: list[str], line: int | None, words_: str) -> None:
    with pytest.raises(InputError) as caught:
        read(tmp_path, *lines)
    assert words_ in str(caught.value)
    assert (caught.value.line, caught.value.file) == (line, tmp_path / "contacts.csv")


def test_readings_of_a_rail_are_lengths(tmp_path: Path) -> None:
    cell = build_cell(load_problem("rail_panel"))
    q = cell.home[None] + np.array([[0.0] * 7, [0.25, 0.1, -0.1, 0.2, 0.3, -0.2, 0.4]])
    shown = np.where(cell.limits.turns, np.degrees(q), q * 1e3)
    joints = {name: shown[:, j] for j, name in enumerate(cell.joint_names)}
    file = write_contacts(tmp_path / "contacts.csv", {"rail_mm": joints.pop("rail"), **joints})
    found = contacts_of(cell, read_readings(file, cell))
    np.testing.assert_allclose(found.tips, cell.arm.poses(q)[:, :3, 3], atol=1e-7)
    file.write_text(file.read_text().replace("rail_mm", "rail_deg"))
    with pytest.raises(InputError, match="is in deg") as caught:
        read_readings(file, cell)
    assert caught.value.hint is not None and "rail_mm" in caught.value.hint
    file.write_text("x_mm,y_mm\n1,2\n")
    with pytest.raises(InputError) as caught:
        read_readings(file, cell)
    assert caught.value.hint is not None and "or rail_mm, joint_1, joint_2" in caught.value.hint


@given(st.text(alphabet=st.sampled_from("xyz_mrotain,;\t\n 0123456789.e-+#\"'nf\x00é[]"), max_size=200))
def test_any_text_is_read_or_refused(text: str) -> None:
    file = scratch() / "any.csv"
    file.write_text(text, encoding="utf-8")
    try:
        readings = read_readings(file, scene("cylinder_logo").cell)
    except InputError:
        return
    assert len(readings.lines) == len(readings.names) >= 1


@given(
    st.lists(st.tuples(*[st.floats(-1e5, 1e5)] * 3, st.floats(-3600, 3600)), min_size=1, max_size=20),
    st.sampled_from([",", ";", "\t", " "]),
)
def test_numbers_are_read_as_written(table: list[tuple[float, ...]], separator: str) -> None:
    file = scratch() / "numbers.csv"
    lines = [separator.join(HEAD.split(",")), *(separator.join(repr(v) for v in row) for row in table)]
    file.write_text("\n".join(lines), encoding="utf-8")
    readings = read_readings(file, scene("cylinder_logo").cell)
    np.testing.assert_array_equal(np.column_stack([readings.tips, readings.holder]), np.array(table))


# Contacts that say too little, or the wrong thing


def scaled(path: Path, factor: float, columns: Sequence[int] = (0, 1, 2)) -> Path:
    lines = path.read_text().splitlines()
    table = np.loadtxt(lines[1:], delimiter=",")
    table[:, list(columns)] *= factor
    return write_contacts(path, dict(zip(lines[0].split(","), table.T, strict=True)))


@pytest.mark.slow
@pytest.mark.parametrize(("unit", "factor"), [("m", 1e-3), ("inches", 1 / 25.4), ("cm", 0.1)])
def test_another_unit_is_told_by_the_residual(tmp_path: Path, unit: str, factor: float) -> None:
    here = scene("fibre_bowl")
    file = contacts(tmp_path, "fibre_bowl", misplaced(here, MOVED, TURNED), 12, [3e-5, -4e-5, 2e-5])
    with pytest.raises(InputError, match=f"seem to be in {unit}: read that way they fit the part to 0.0"):
        register(here, scaled(file, factor), Ask())


def test_angles_in_radians_are_told(tmp_path: Path) -> None:
    here = scene("cylinder_logo")
    file = contacts(tmp_path, "cylinder_logo", misplaced(here, (2.0, 1.0)), 9)
    with pytest.raises(InputError, match="seem to be in radians"):
        register(here, scaled(file, np.pi / 180.0, (3,)), Ask())


@pytest.mark.slow
def test_contacts_of_another_part(tmp_path: Path) -> None:
    here = scene("fibre_bowl")
    random = np.random.default_rng(0)
    points, q = chosen("fibre_bowl", 12)
    tips = tips_of(here, here.start, points, random.uniform(-20e-3, 20e-3, 12), q)
    file = write_contacts(tmp_path / "c.csv", cartesian(here, tips, q))
    with pytest.raises(InputError, match="do not lie on this part") as caught:
        register(here, file, Ask())
    assert caught.value.line is not None


@pytest.mark.slow
def test_contacts_far_from_the_part(tmp_path: Path) -> None:
    here = scene("fibre_bowl")
    file = contacts(tmp_path, "fibre_bowl", misplaced(here, (0.0, 0.0, 700.0)), 12)
    with pytest.raises(InputError, match=r"6\d\d mm from where the problem has the part"):
        register(here, file, Ask())


@pytest.mark.slow
def test_too_few_contacts(tmp_path: Path) -> None:
    here = scene("fibre_bowl")
    with pytest.raises(InputError, match="4 contacts cannot fix 5 freedoms") as caught:
        register(here, contacts(tmp_path, "fibre_bowl", here.start, 4), Ask())
    assert caught.value.hint is not None and "--free" in caught.value.hint


def test_contacts_in_one_line_name_the_freedom(tmp_path: Path) -> None:
    here = scene("fibre_plane")
    points = np.outer(np.linspace(-60e-3, 60e-3, 8), [1.0, 0.0, 0.0])
    tips = tips_of(here, here.start, points, np.zeros(8), np.zeros((8, 1)))
    file = write_contacts(tmp_path / "c.csv", cartesian(here, tips, np.zeros((8, 1))))
    with pytest.raises(InputError, match="do not fix what the nozzle's height depends on: a turn about x"):
        register(here, file, Ask())


@pytest.mark.slow
@pytest.mark.parametrize("ask", [Ask(table=True), Ask(size=True), Ask(free=())])
def test_what_cannot_be_asked(tmp_path: Path, ask: Ask) -> None:
    here = scene("saddle_ring")
    with pytest.raises(InputError):
        register(here, contacts(tmp_path, "saddle_ring", here.start, 6), ask)


def test_a_table_that_stood_still(tmp_path: Path) -> None:
    here = scene("cylinder_logo")
    points, q = chosen("cylinder_logo", 9)
    tips = tips_of(here, here.start, points, np.zeros(9), 0.0 * q)
    with pytest.raises(InputError, match="one angle in all contacts"):
        register(here, write_contacts(tmp_path / "c.csv", cartesian(here, tips, 0.0 * q)), Ask(table=True))
