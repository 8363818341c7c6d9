"""Recordings as robots and tools write them: columns by their names, units and clocks; what is none of the program is refused."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmarks.recordings import Recording, recorded, write_recording
from planner.base.errors import InputError
from planner.feedback.identify_match import match
from planner.feedback.identify_robot_file import robots_of
from planner.feedback.recordings import column_of, read_log
from tests.identify_fixtures import (
    RPI,
    asked_of,
    cell_of,
    header,
    matched,
    sample,
    table_text,
    truth_of,
)

# ---- names of columns ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "role", "joint", "unit"),
    [
        ("t_s", "time", None, 1.0),
        ("Timestamp", "time", None, np.nan),
        ("time (ms)", "time", None, 1e-3),
        ("header.stamp.nsecs", "time", None, 1e-9),
        ("joint_3_deg", "executed", 2, np.pi / 180.0),
        ("J3", "executed", 3, np.nan),
        ("actual_q_3", "executed", 3, np.nan),
        ("target_q_0", "commanded", 0, np.nan),
        ("Feedback joint 2 [rad]", "executed", 2, 1.0),
        ("$AXIS_ACT.A3", "executed", 3, np.nan),
        ("cmd j1 (deg)", "commanded", 1, np.pi / 180.0),
        ("/joint_states/joint_4/position", "executed", 3, np.nan),
        ("positioner_joint_1", None, None, None),
        ("actual_qd_0", None, None, None),
        ("joint_1_velocity", None, None, None),
        ("target_current_2", None, None, None),
        ("cmd_num", None, None, None),
        ("", None, None, None),
    ],
)
def test_names_of_columns(name: str, role: str | None, joint: int | None, unit: float | None) -> None:
    found = column_of(0, name, cell_of("cylinder_logo")[1])
    if role is None:
        assert found is None
        return
    assert found is not None and found.role == role
    np.testing.assert_equal(found.unit, unit)
    assert joint is None or joint in (found.named, found.number)


def test_joints_of_a_second_arm_that_only_holds_are_not_the_arms() -> None:
    _, held = cell_of("fibre_plane", "cell.positioner.free=[]")
    _, turning = cell_of("fibre_plane")
    for k in range(1, 7):
        name = f"actual_positioner_joint_{k}_deg"
        assert column_of(0, name, held) is None
        found = column_of(0, name, turning)
        assert (found is None) == (k != 6) and (found is None or found.named == 6)
        assert column_of(0, f"actual_joint_{k}_deg", held).named == k - 1


Y_ALONE = "cell.base={robot: gantry_xy, free: [gantry_y], held_mm: {gantry_x: 1500}, home_mm: {gantry_y: 500}}"


@pytest.mark.parametrize(
    ("problem", "overrides", "names", "joint", "column"),
    [
        ("cylinder_logo", (), "E1", 6, 6),
        ("cylinder_logo", (), "E1 E2", 6, 7),
        ("cylinder_logo", (), "eax_a eax_b eax_c eax_d eax_e eax_f", 6, 7),
        ("cylinder_logo", (), "E2", 6, 6),
        ("cylinder_logo", ("cell.positioner.free=[tilt]", "cell.positioner.held_deg={}"), "E1 E2", 6, 6),
        ("rail_panel", (), "E1 E2", 0, 6),
        ("rail_panel", (Y_ALONE,), "E1", 0, 6),
        ("rail_panel", (Y_ALONE,), "E1 E2", 0, 7),
    ],
)
def test_external_axes_are_numbered_as_in_programs(
    problem: str, overrides: tuple[str, ...], names: str, joint: int, column: int, tmp_path: Path
) -> None:
    """Held ones too, but where a file has only as many as move."""
    _, cell = cell_of(problem, *overrides)
    head = [*(f"J{k}" for k in range(1, 7)), *names.split()]
    time = 0.01 * np.arange(100)
    q = np.arange(len(head)) + 0.1 * np.sin(time[:, None] + np.arange(len(head)))
    (tmp_path / "a.csv").write_text(table_text(",".join(["t_s", *head]), np.column_stack([time, q])))
    np.testing.assert_allclose(read_log(tmp_path / "a.csv", cell).executed[:, joint], q[:, column])


@given(st.text(max_size=30))
def test_any_name_of_a_column_is_looked_at(name: str) -> None:
    found = column_of(0, name, cell_of("cylinder_logo")[1])
    assert found is None or found.role in ("time", "executed", "commanded")


# ---- files of robots and other tools -------------------------------------------------------------------------------


@pytest.mark.slow
def test_recordings_are_read_as_tools_write_them(tmp_path: Path) -> None:
    asked, recording = sample()
    t, q, told = recording.time, recording.executed, recording.commanded
    degrees = np.degrees(q)
    numbers = np.arange(len(t))
    rtde = "timestamp " + " ".join(f"{role}_{name}" for role in ("target", "actual") for name in (*SIX, "e1"))
    stamps = 1.7e9 + t
    files = {
        "abb": table_text("timestamp, cmd_num, J1, J2, J3, J4, J5, J6, E1", np.column_stack([t, numbers, degrees])),
        "kuka": table_text("t_ms;A1;A2;A3;A4;A5;A6;E1", np.column_stack([1e3 * t, degrees]), ";"),
        "from zero": table_text("time,q0,q1,q2,q3,q4,q5,rotation", np.column_stack([t, q])),
        "ros": table_text(
            "header.stamp.secs,header.stamp.nsecs," + ",".join(f"/js/{n}/position" for n in asked.joint_names),
            np.column_stack([np.floor(stamps), np.round(1e9 * (stamps % 1.0)), q]),
        ),
        "order": table_text(
            "rotation_rad\ttime\t" + "\t".join(f"joint_{k}" for k in range(6, 0, -1)),
            np.column_stack([q[:, 6], t, q[:, 5::-1]]), "\t",
        ),
    }  # fmt: skip
    for name, text in files.items():
        log = matched(tmp_path, text, asked)
        assert len(log.rests) == len(asked.moves) + 1, name
        np.testing.assert_allclose(log.postures, asked.postures, atol=2e-4, err_msg=name)
    log = matched(tmp_path, table_text(rtde, np.column_stack([t, told, q]), " "), asked)
    assert log.commanded is not None
    np.testing.assert_allclose(log.commanded, told, atol=1e-7)
    bare = table_text("", np.column_stack([t, degrees])).lstrip()
    names = ["t_s", *(f"J{k}_deg" for k in range(1, 7)), "E1_deg"]
    np.testing.assert_allclose(matched(tmp_path, bare, asked, names).postures, asked.postures, atol=2e-4)


def test_what_is_recorded_before_and_behind_the_program_does_not_matter(tmp_path: Path) -> None:
    asked, recording = sample()
    _, cell = cell_of("cylinder_logo")
    way = np.radians(7.0) * np.sin(np.linspace(0.0, 0.5 * np.pi, 500))[:, None] * np.ones(7)
    first, last = recording.executed[:100], recording.executed[-100:]
    before = np.concatenate([first[:1] + way[-1:].repeat(150, axis=0), first[:1] + way[::-1]])
    q = np.concatenate([before, recording.executed, last[-1:] + way, last + way[-1]])
    made = Recording(0.004 * np.arange(len(q)), q, q)
    log = match(read_log(write_recording(tmp_path / "run.csv", made, header(cell)), cell), asked)
    assert len(log.rests) == len(asked.moves) + 1 and log.rests[0, 0] >= len(before)
    np.testing.assert_allclose(log.postures, asked.postures, atol=2e-4)


SIX = tuple(f"q_{k}" for k in range(6))


@given(text=st.text(alphabet="t_s,jJ123456;\n\"'0.5-e \t", max_size=400))
def test_any_text_is_read_or_refused(text: str, tmp_path_factory: pytest.TempPathFactory) -> None:
    file = tmp_path_factory.getbasetemp() / "any.csv"
    file.write_text(text, encoding="utf-8")
    cell = cell_of("peer_cap")[1]
    for columns in (None, ["t_s", *(f"J{k}" for k in range(1, 7))]):
        with suppress(InputError):
            read_log(file, cell, columns)


@settings(max_examples=20)
@given(rows=st.lists(st.lists(st.sampled_from(["0", "1e400", "nan", "x", "-3.5", ""]), min_size=6, max_size=8), min_size=50,
                     max_size=60))  # fmt: skip
def test_any_numbers_are_read_or_refused(rows: list[list[str]], tmp_path_factory: pytest.TempPathFactory) -> None:
    file = tmp_path_factory.getbasetemp() / "rows.csv"
    file.write_text("\n".join(["t,J1,J2,J3,J4,J5,J6", *map(",".join, rows)]), encoding="utf-8")
    with suppress(InputError):
        match(read_log(file, cell_of("peer_cap")[1]), asked_of("peer_cap", joints=(0,)))


def test_two_arms_of_one_kind_have_a_file_each(tmp_path: Path) -> None:
    problem, cell = cell_of("fibre_bowl")
    names = [robot.target(tmp_path).name for robot in robots_of(problem, cell)]
    assert len(set(names)) == len(names) == 2


def test_two_tracks_of_one_kind_have_a_file_each(tmp_path: Path) -> None:
    table = "cell.positioner={robot: track_3m, base_mm: [0, 3000, 0], free: [rail]}"
    robots = robots_of(*cell_of("rail_panel", "cell.bed_mm=null", table))
    names = [robot.target(tmp_path).name for robot in robots]
    assert names == ["irb1600_12_measured.yaml", "track_3m_measured.yaml", "track_3m_positioner_measured.yaml"]
    assert [robot.joints for robot in robots[1:]] == [(0,), (7,)]


def test_another_unit_is_told_beside_a_rail(tmp_path: Path) -> None:
    """Its millimetres are right where the arm's degrees are radians."""
    _, cell = cell_of("rail_panel")
    asked = asked_of("rail_panel", joints=(2,), most=20.0)
    made = recorded(asked, truth_of(cell, delay=0.02))
    head = ",".join(["t_s", "rail_mm", *(f"joint_{k}_deg" for k in range(1, 7))])
    table = np.column_stack([made.time, 1e3 * made.executed[:, 0], made.executed[:, 1:]])
    (tmp_path / "run.csv").write_text(table_text(head, table))
    with pytest.raises(InputError, match="joints are in radians, but its header says degrees"):
        match(read_log(tmp_path / "run.csv", cell), asked)


def _spoilt(change: str) -> tuple[str, str]:
    """A recording that something is wrong with, and what is said."""
    asked, recording = sample()
    t, q = recording.time.copy(), np.degrees(recording.executed)
    head = "t_s," + ",".join(f"{name}_deg" for name in asked.joint_names)
    table = np.column_stack([t, q])
    half = len(t) // 2
    moved = half + int(np.argmax(np.abs(np.diff(q[half:, 3])) > 0.3))
    if change == "radians":
        table[:, 1:] = np.radians(q)
        return table_text(head, table), "joints are in radians, but its header says degrees"
    if change == "degrees":
        return table_text(head.replace("_deg", "_rad"), table), "joints are in degrees, but its header says radians"
    if change == "order":
        table[:, [2, 4]] = table[:, [4, 2]]
        return table_text(head, table), "that of joint_2 moves as joint_4 was asked to"
    if change == "turned":
        table[:, 4] *= -1.0
        return table_text(head, table), "joint_4 moves the other way round"
    if change == "zero":
        table[:, 2] += 90.0
        return table_text(head, table), "the zero of joint_2 is 90 degrees off"
    if change == "gap":
        return table_text(
            head, np.delete(table, slice(moved, moved + 30), axis=0)
        ), "1 gap between samples, the longest 0.124"
    if change == "jump":
        table[half:, 0] += 2.0
        return table_text(head, table), "the clock jumped"
    if change == "back":
        table[half:, 0] -= 2.0
        return table_text(head, table), "the clock runs back by 1.996 s"
    if change == "still":
        table[moved : moved + 3, 0] = table[moved, 0]
        return table_text(head, table), "the clock stands still"
    if change == "milliseconds":
        table[:, 0] *= 1e3
        return table_text(head.replace("t_s", "time"), table), "advances by 4 s from sample to sample"
    if change == "seconds":
        return table_text(head.replace("t_s", "t_ms"), table), "advances by 4e-06 s"
    if change == "microseconds":
        table[:, 0] *= 1e6
        return table_text(head.replace("t_s", "timestamp"), table), "advances by 4000 s"
    if change == "clock set":
        # at a new second of another clock in the middle of a move, as when a controller's is set
        table[moved:, 0] += 0.08
        return table_text(head, table), "samples are missing, or the clock jumped"
    if change == "twice over":
        return table_text(head, np.concatenate([table, table])), "the clock runs back"
    if change == "turns":
        table[:, 1:] = q / 360.0
        return table_text(head, table), "another program|never rest|was asked to"
    if change == "all shifted":
        table[:, 1:] = np.roll(q, 1, axis=1)
        return table_text(head, table), "columns are in another order"
    if change == "sparse":
        return table_text(head, table[::5]), "too few samples: one every 20 ms"
    if change == "short":
        return table_text(head, table[:20]), "holds 20 samples"
    if change == "cut":
        return table_text(head, table[:half]), "ends after [0-9]+ of"
    if change == "program":
        table[:, 1:] = np.degrees(asked.start) + 20.0 * np.sin(0.3 * t[:, None])
        return table_text(head, table), "never rest|another program"
    if change == "elsewhere":
        table[:, 3] += 3.0 * np.clip((t - t[half]) / 0.3, 0.0, 1.0)
        return table_text(head, table), "moves are as asked, then joint_3 rests 3 degrees from where it was asked to"
    if change == "stray":
        table[moved : moved + 30, 5] += 2.0 * np.sin(np.linspace(0.0, np.pi, 30)) ** 2
        return table_text(head, table), "joint_5 moves by 2.* while only joint_4 was asked to"
    if change == "no time":
        return table_text(head.replace("t_s", "x"), table), "no column has the time"
    if change == "no joint":
        return table_text(head.replace("joint_6_deg", "x"), table), "no column has joint_6"
    if change == "twice":
        return table_text(head.replace("joint_6_deg", "J5"), table), "are both of joint_5"
    if change == "commands only":
        return table_text(head.replace("joint", "cmd_joint").replace("rot", "cmd_rot"), table), "has commanded joints"
    if change == "no header":
        return table_text("", table).lstrip(), "a header that names the columns is missing"
    if change == "words":
        return table_text(head, table).replace("\n0.4,", "\nstop,", 1), "could not convert string 'stop'"
    if change == "columns":
        return table_text(head, table).replace("\n0.4,", "\n0.4,0,", 1), "has a different number of columns"
    if change == "nan":
        return table_text(head, table).replace("\n0.4,", "\nnan,", 1), "no finite number"
    if change == "comma":
        return table_text(head, table, ";").replace(".", ","), "could not convert|number of columns"
    return "", "holds no samples"


SPOILT = (
    "radians", "degrees", "order", "turned", "zero", "gap", "jump", "back", "still", "milliseconds", "sparse", "short", "cut",
    "program", "elsewhere", "stray", "no time", "no joint", "twice", "commands only", "no header", "words", "columns", "nan",
    "comma", "empty", "seconds", "microseconds", "clock set", "twice over", "turns", "all shifted",
)  # fmt: skip


OTHER_KINDS = {
    "cloud.xyz": ("1 2 3\n4 5 6\n", "looks like a cloud of points"),
    "cloud.ply": ("ply\nformat ascii 1.0\n", "looks like a cloud of points"),
    "cloud.csv": ("x,y,z\n1,2,3\n", "looks like a cloud of points"),
    "named.csv": ("X [mm];Y [mm];Z [mm];intensity\n1;2;3;4\n", "looks like a cloud of points"),
    "bare.txt": ("1.5 2 3\n" * 60, "looks like a cloud of points"),
    "normals.txt": ("1.5 2 3 0 0.6 0.8\n" * 60, "looks like a cloud of points.*: with normals"),
    "scan.pcd": ("# .PCD v0.7\nFIELDS x y z\n", "looks like a cloud of points"),
    "part.stl": ("solid part\n", "is a mesh"),
    "program.mod": ("MODULE x\n", "is a program"),
    "plan.json": ("{}", "is no table"),
    "trajectory.csv": ("t_s,bead,layer,deposit,joint_1\n0,0,0,0,0\n", "is the trajectory of a plan"),
    "joints.txt": ("1.5 2 3 0 0.6 0.9\n" * 60, "a header that names the columns is missing"),
    "none.csv": (None, r"there is no file .*none.csv"),
}


@pytest.mark.parametrize("name", OTHER_KINDS)
def test_a_file_of_another_kind_is_told(tmp_path: Path, name: str) -> None:
    text, said = OTHER_KINDS[name]
    if text is not None:
        (tmp_path / name).write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=said):
        read_log(tmp_path / name, cell_of("peer_cap")[1])


@pytest.mark.parametrize("name", ["cloud.npy", "cloud.npz"])
def test_a_cloud_in_an_array_is_told(tmp_path: Path, name: str) -> None:
    points = np.zeros((30, 3))
    (np.save if name.endswith("npy") else np.savez)(tmp_path / name, points)
    with pytest.raises(InputError, match="looks like a cloud of points"):
        read_log(tmp_path / name, cell_of("peer_cap")[1])


@pytest.mark.slow(keep=6)
@pytest.mark.parametrize("change", SPOILT)
def test_what_is_no_recording_of_the_program_is_refused(tmp_path: Path, change: str) -> None:
    text, said = _spoilt(change)
    with pytest.raises(InputError, match=said):
        matched(tmp_path, text, sample()[0])


def test_joints_as_the_controller_counts_them_are_understood(tmp_path: Path) -> None:
    asked, (_, cell) = asked_of("peer_cap", "krl", joints=(1, 3), most=20.0), cell_of("peer_cap")
    recording = recorded(asked, truth_of(cell))
    kuka = replace(recording, executed=recording.executed * asked.counted.signs + asked.counted.offsets)
    file = write_recording(tmp_path / "run.csv", kuka, ["t_s", *(f"A{k}" for k in range(1, 7))])
    log = match(read_log(file, cell), asked)
    np.testing.assert_allclose(log.postures, asked.postures, atol=2e-4)
    assert "joints are counted as the controller does" in log.remarks


def test_commands_that_rest_elsewhere_are_refused(tmp_path: Path) -> None:
    asked, recording = sample()
    _, cell = cell_of("cylinder_logo")
    off = replace(recording, commanded=recording.commanded + np.radians(5.0))
    file = write_recording(tmp_path / "run.csv", off, header(cell, commanded=True), commanded=True)
    with pytest.raises(InputError, match=r"commanded and executed joints rest up to 5.* degrees apart"):
        match(read_log(file, cell), asked)


def test_commands_long_before_the_motion_are_refused(tmp_path: Path) -> None:
    asked, recording = sample()
    _, cell = cell_of("cylinder_logo")
    early = replace(recording, commanded=np.roll(recording.commanded, -75, axis=0))
    file = write_recording(tmp_path / "run.csv", early, header(cell, commanded=True), commanded=True)
    with pytest.raises(InputError, match=r"commands begin to move more than|commanded and executed joints rest"):
        match(read_log(file, cell), asked)


@pytest.mark.skipif(not RPI.is_dir(), reason="the public recordings are not here")
def test_a_real_robots_recording_of_another_program_is_refused() -> None:
    """Of a real IRB 6640, whose file has no header, a gap, and stamps that jitter."""
    overrides = ("cell.arm=irb6640", "cell.home_deg=[0, 0, 0, 0, 30, 0]")
    _, cell = cell_of("peer_cap", *overrides)
    asked = asked_of("peer_cap", overrides=overrides)
    with pytest.raises(InputError, match="a header that names the columns is missing"):
        read_log(RPI / "run0_b.csv", cell)
    log = read_log(RPI / "run0_b.csv", cell, ["timestamp", "-", *(f"J{k}_deg" for k in range(1, 7))])
    assert 0.006 < log.step < 0.01 and log.commanded is None
    with pytest.raises(InputError, match=r"never rest|another program"):
        match(log, asked)


def test_columns_are_told_by_role_and_joint_whatever_their_order(tmp_path: Path) -> None:
    asked, recording = sample()
    order = [3, 1, 2, 0, 6, 5, 4]
    names = [asked.joint_names[j] for j in order]
    head = ",".join(["t_s", *(f"target_{name}" for name in names), *names])
    table = np.column_stack(
        [recording.time, np.degrees(recording.commanded)[:, order], np.degrees(recording.executed)[:, order]]
    )
    (tmp_path / "run.csv").write_text(table_text(head, table), encoding="utf-8")
    log = read_log(tmp_path / "run.csv", cell_of("cylinder_logo")[1])
    assert log.told == ("t_s", *asked.joint_names, *(f"target_{name}" for name in asked.joint_names))


def _in_row(text: str, line: int, column: int, value: str) -> str:
    rows = text.splitlines()
    words = rows[line - 1].split(",")
    words[column] = value
    rows[line - 1] = ",".join(words)
    return "\n".join(rows) + "\n"


@pytest.mark.parametrize(
    ("line", "column", "value", "said"),
    [
        (30, 2, "1e300", r"run\.csv:30: column 'joint_2_deg' is 1e\+300 here, too large for a joint"),
        (31, 0, "1e30", r"run\.csv:31: column 't_s' is 1e\+30 here, too large for a clock"),
        (32, 2, '"' + "9" * 200_000 + '"', r"no number|no finite number|could not convert|is not CSV"),
    ],
)
def test_numbers_that_nothing_has_are_refused_by_line(
    tmp_path: Path, line: int, column: int, value: str, said: str
) -> None:
    asked, recording = sample()
    head = "t_s," + ",".join(f"{name}_deg" for name in asked.joint_names)
    text = table_text(head, np.column_stack([recording.time, np.degrees(recording.executed)]))
    with pytest.raises(InputError, match=said):
        matched(tmp_path, _in_row(text, line, column, value), asked)


def test_a_clock_that_never_goes_on_is_refused(tmp_path: Path) -> None:
    asked, recording = sample()
    head = "t_s," + ",".join(f"{name}_deg" for name in asked.joint_names)
    still = np.column_stack([0.0 * recording.time, np.tile(np.degrees(asked.start), (len(recording.time), 1))])
    with pytest.raises(InputError, match="holds 1 samples at different times"):
        matched(tmp_path, table_text(head, still), asked)


def test_a_wrong_sample_is_left_out_and_told(tmp_path: Path) -> None:
    asked, recording = sample()
    head = "t_s," + ",".join(f"{name}_deg" for name in asked.joint_names)
    text = table_text(head, np.column_stack([recording.time, np.degrees(recording.executed)]))
    log = matched(tmp_path, _in_row(text, 500, 4, "17.5"), asked)
    assert any(
        "1 sample left out as no joint can move like that, the first in line 500" in words for words in log.remarks
    )
    np.testing.assert_allclose(log.postures, asked.postures, atol=2e-4)
