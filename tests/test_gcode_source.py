"""G-code of slicers: how it is read, the beads it becomes, and the layers they lie on."""

from __future__ import annotations

import math
import runpy
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import trapezoid

from planner.base.arrays import Array
from planner.base.errors import InputError
from planner.base.nearest import distance_to_polyline
from planner.motion.extrusion import bead_area
from planner.planning.solve_command import main
from planner.problem import find_problem, load_problem
from planner.toolpath.bead import Toolpath
from planner.toolpath.build import build_toolpath
from planner.toolpath.gcode.arcs import arc_by_centre, centre_by_radius
from planner.toolpath.gcode.layers import LevelLayers
from planner.toolpath.gcode.reader import GcodeFile, read_gcode

CHORD = 1e-5
AREA = 0.25 * math.pi * 1.75e-3**2
Read = Callable[[str], GcodeFile]


@pytest.fixture
def read(tmp_path: Path) -> Read:
    """Read a text as a file of G-code."""

    def make(text: str) -> GcodeFile:
        path = tmp_path / "part.gcode"
        path.write_bytes(text.encode())
        return read_gcode(path, CHORD)

    return make


def threads(file: GcodeFile) -> list[list[list[float]]]:
    """Points in mm of all that is extruded, z with them."""
    return [(t.points * 1e3).round(6).tolist() for t in file.threads]


# Round trip

whole = st.integers(-50_000, 50_000)
steps = st.tuples(whole, whole, st.integers(1, 9_000))
pieces = st.lists(st.tuples(whole, whole, st.lists(steps, min_size=1, max_size=5)), min_size=1, max_size=4)


def clean(pieces: list[tuple[int, int, list[tuple[int, int, int]]]]) -> list[tuple[Array, Array]]:
    """Points (n, 2) [um] without repetition, and filament [um], of pieces that begin where none before ended."""
    out: list[tuple[Array, Array]] = []
    for x, y, moves in pieces:
        points, filament = [(x, y)], []
        for a, b, e in moves:
            if (a, b) != points[-1]:
                points.append((a, b))
                filament.append(e)
        if filament:
            out.append((np.array(points), np.array(filament)))
    return out


@settings(max_examples=80)
@given(
    st.lists(pieces, min_size=1, max_size=3),
    st.booleans(),
    st.booleans(),
    st.booleans(),
    st.sampled_from(["\n", "\r\n"]),
    st.sampled_from(["", ";LAYER_CHANGE", ";LAYER:7", "; CHANGE_LAYER", "; layer 3, Z = 0.600"]),
    st.integers(0, 3),
)
def test_what_is_written_is_read(
    tmp_path_factory: pytest.TempPathFactory,
    layers: list[list[tuple[int, int, list[tuple[int, int, int]]]]],
    relative: bool,
    filament_relative: bool,
    inches: bool,
    newline: str,
    mark: str,
    style: int,
) -> None:
    unit = 25_400.0 if inches else 1000.0  # um
    lines = ["G20" if inches else "G21", "G28", "G90", f"G1 Z{5000 / unit:.9f}", "G1 X0 Y0"]
    if mark:
        lines += ["G1 E1 X1", "G1 X0", "G92 E0"]  # the printer's own
    lines += ["G91"] * relative + ["M83" if filament_relative else "M82"]
    place, pushed = np.zeros(3), 0
    place[2] = 5000
    expected = []

    def move(goal: Array, e: int | None) -> str:
        nonlocal place, pushed
        words = [("X", goal[0], place[0]), ("Y", goal[1], place[1]), ("Z", goal[2], place[2])]
        text = [f"{axis}{(new - old if relative else new) / unit:.9f}" for axis, new, old in words if new != old]
        place = goal.copy()
        if e is not None:
            pushed += e
            text.append(f"E{(e if filament_relative else pushed) / unit:.9f}")
        form = ["G1 {}", "N12 G1 {} *71", "g01  {} ; remark", "G1{}"][style]
        return form.format((" " if style < 3 else "").join(text) if style != 2 else "  ".join(text).lower())

    for k, layer in enumerate(layers):
        lines += [mark] * bool(mark)
        z = 300.0 * (k + 1)
        for points, filament in clean(layer):
            lines += [move(np.array([*points[0], z]), None), move(place, 700)]
            lines += [move(np.array([*p, z]), int(e)) for p, e in zip(points[1:], filament, strict=True)]
            lines += [move(place, -700)]
            expected.append((points, filament, z))
    path = tmp_path_factory.mktemp("gcode") / "part.gcode"
    path.write_bytes(newline.join(lines).encode())
    if not expected:
        with pytest.raises(InputError, match="extrudes nothing"):
            read_gcode(path, CHORD)
        return
    found = read_gcode(path, CHORD)
    assert found.before == (1 if mark else 0) or not mark
    own = found.threads if mark else found.threads[-len(expected) :]
    assert len(own) == len(expected)
    for thread, (points, filament, z) in zip(own, expected, strict=True):
        assert thread.points[:, :2] * 1e6 == pytest.approx(points, abs=2e-3)
        assert thread.filament * 1e6 == pytest.approx(filament, abs=1e-2)
        assert thread.points[:, 2] * 1e6 == pytest.approx(z, abs=1e-2)


# Reading

PRUSA = """\
; generated by PrusaSlicer
M201 X1000 Y1000 ; sets maximum accelerations
M73 P0 R2
G28 W ; home all without mesh bed level
G80 ; mesh bed levelling
G21 ; set units to millimeters
G90
M83
G1 Z0.2 F720
G1 Y-3 F1000
G1 X60 E9 F1000 ; intro line
G92 E0
;LAYER_CHANGE
;Z:0.2
;HEIGHT:0.2
G1 E-.8 F2100
G1 X10 Y10 F9000
G1 E.8 F2100
;TYPE:External perimeter
;WIDTH:0.45
G1 F1200
G1 X20 Y10 E.4
G1 X20 Y20 E.4
;WIPE_START
G1 X15 Y20 E-.5
;WIPE_END
;TYPE:Solid infill
G1 X10 Y20
G1 F2400
G1 X10 Y12 E.3
;LAYER_CHANGE
;Z:0.35
;HEIGHT:0.15
G1 Z.35 F720
G1 F2400
G1 X20 Y12 E.3
"""
CURA = """\
;FLAVOR:Marlin
;Layer height: 0.2
;LAYER_COUNT:2
M82 ;absolute extrusion mode
G28 ;Home
G1 X0.1 Y20 Z0.3 F5000.0 ;Move to start position
G1 X0.1 Y200.0 Z0.3 F1500.0 E15 ;Draw the first line
G92 E0
G92 E0
G1 F2700 E-5
;LAYER:0
M107
G0 F6000 X10 Y10 Z0.2
;TYPE:WALL-OUTER
G1 F2700 E0
G1 F1200 X20 Y10 E0.4
G1 X20 Y20 E0.8
;MESH:NONMESH
G0 F6000 X10 Y20
;TYPE:SKIN
G1 F2400 X10 Y12 E1.1
;TIME_ELAPSED:12.5
G1 F2700 E-3.9
;LAYER:1
G0 F6000 X10 Y12 Z0.35
G1 F2700 E1.1
G1 F2400 X20 Y12 E1.4
G91 ;Relative positioning
G1 E-2 F2700 ;Retract a bit
G1 E-2 Z0.2 F2400 ;Retract and raise Z
M104 S0
"""
ORCA = """\
; HEADER_BLOCK_START
EXCLUDE_OBJECT_DEFINE NAME=box CENTER=15,15 POLYGON=[[10,10],[20,10]]
START_PRINT EXTRUDER_TEMP=220 BED_TEMP=60
G90
G21
M83
G1 X1 Y1 Z.2
G1 X9 E5
;LAYER_CHANGE
;Z:0.2
;HEIGHT:0.2
SET_VELOCITY_LIMIT ACCEL=5000
T0
G1 X10 Y10 F30000
G1 Z.4
G1 Z.2
; FEATURE: Outer wall
; LINE_WIDTH: 0.42
G1 E.8 F1800
G1 F1200
G1 X20 Y10 E.4
G1 X20 Y20 E.4
G1 E-.8 F1800
; FEATURE: Sparse infill
G1 X10 Y20 F30000
G1 E.8
G1 X10 Y12 E.3 F2400
;LAYER_CHANGE
; LAYER_HEIGHT: 0.15
G1 Z.35
M117 Layer 2: (almost) done
G1 X20 Y12 E.3
"""
S3D = """\
; G-Code generated by Simplify3D(R)
G90
M82
M106 S0
G28
; process Process1
; layer 1, Z = 0.200
T0
G92 E0.0000
G1 E-1.0000 F1800
; feature outer perimeter
; tool H0.2000 W0.4800
G1 Z0.200 F1000
G1 X10.000 Y10.000 F4800
G1 E0.0000 F1800
G92 E0.0000
G1 X20.000 Y10.000 E0.4000 F1200
G1 X20.000 Y20.000 E0.8000
; feature solid layer
G1 X10.000 Y20.000 F4800
G1 X10.000 Y12.000 E1.1000 F2400
; layer 2, Z = 0.350
; tool H0.1500 W0.4800
G1 Z0.350 F1000
G1 X20.000 Y12.000 E1.4000 F2400
; layer end
M84
"""
STYLES = {"prusa": PRUSA, "cura": CURA, "orca": ORCA, "simplify3d": S3D}


@pytest.mark.parametrize("style", STYLES)
def test_slicers_say_the_same_in_their_ways(read: Read, style: str) -> None:
    file = read(STYLES[style])
    assert threads(file) == [
        [[10, 10, 0.2], [20, 10, 0.2], [20, 20, 0.2]],
        [[10, 20, 0.2], [10, 12, 0.2]],
        [[10, 12, 0.35], [20, 12, 0.35]],
    ]
    assert [t.filament.round(9).tolist() for t in file.threads] == [[4e-4, 4e-4], [3e-4], [3e-4]]
    assert file.before == (0 if style == "simplify3d" else 1)
    assert [t.height is not None for t in file.threads] == [style != "cura"] * 3
    if style != "cura":
        assert [round(1e3 * (t.height or 0.0), 6) for t in file.threads] == [0.2, 0.2, 0.15]
    kinds = ("external perimeter", "wall-outer", "outer wall", "outer perimeter")
    assert file.threads[0].kind.lower() in kinds
    assert file.speeds == pytest.approx((20e-3, 40e-3))


def test_filament_follows_the_axes_until_it_is_said_otherwise(read: Read) -> None:
    head = "G92 X0 Y0 Z0 E0\n"
    assert read(head + "G91\nG1 X1 E1\nG1 X1 E1\n").threads[0].filament == pytest.approx([1e-3, 1e-3])
    assert read(head + "G90\nG1 X1 E1\nG1 X2 E3\n").threads[0].filament == pytest.approx([1e-3, 2e-3])
    assert read(head + "M82\nG91\nG1 X1 E1\nG1 X1 E3\n").threads[0].filament == pytest.approx([1e-3, 2e-3])
    reset = read(head + "M82\nG1 X1 E100\nG92 E0\nG1 X2 E1\n")
    assert [t.filament.round(9).tolist() for t in reset.threads] == [[0.1, 1e-3]], "a count set anew is no interruption"


def test_g92_says_where_the_nozzle_is(read: Read) -> None:
    text = "G92 X5 Y5 Z1 E0\nG1 X6 E1\n"
    assert threads(read(text)) == [[[5, 5, 1], [6, 5, 1]]]


def test_g92_in_the_middle_of_a_print_moves_nothing(read: Read) -> None:
    text = "G92 X5 Y5 Z1 E0\nG1 X6 E1\nG92 X0\nG1 X1 E2\n"
    assert threads(read(text)) == [[[5, 5, 1], [6, 5, 1], [7, 5, 1]]]
    back = text + "G92 X7 Y0\nG1 X8 Y1 E3\nG91\nG1 X1 E1\n"
    assert threads(read(back))[0][-2:] == [[8, 6, 1], [9, 6, 1]]
    homed = text + "G28 X\nG1 X2\nG1 Y6 E3\n"
    assert threads(read(homed))[1:] == [[[2, 5, 1], [2, 6, 1]]]


def test_arcs_are_those_of_a_circle(read: Read) -> None:
    quarter = read("G92 X10 Y0 Z1 E0\nG3 X0 Y10 I-10 J0 E5\n").threads[0]
    assert np.hypot(*quarter.points[:, :2].T) == pytest.approx(10e-3, abs=1e-12)
    assert (np.diff(np.arctan2(quarter.points[:, 1], quarter.points[:, 0])) > 0).all()
    assert quarter.filament.sum() == pytest.approx(5e-3)
    assert np.ptp(quarter.filament) < 1e-12
    back = read("G92 X0 Y10 Z1 E0\nG2 X10 Y0 R10 E5\n").threads[0]
    assert back.points[::-1] == pytest.approx(quarter.points, abs=1e-9)
    circle = read("G92 X10 Y0 Z1 E0\nG2 I-10 E5\n").threads[0]
    assert np.linalg.norm(np.diff(circle.points, axis=0), axis=1).sum() == pytest.approx(20e-3 * math.pi, rel=1e-3)
    relative = read("G92 X10 Y0 Z1 E0\nG91\nG20\nG3 X-1 Y1 I-1 E1\n").threads[0]
    assert relative.points[-1, :2] * 1e3 == pytest.approx([10 - 25.4, 25.4])


@settings(max_examples=80)
@given(st.floats(-3.1, 3.1), st.floats(0.05, 6.2), st.floats(1e-4, 0.2), st.booleans(), st.floats(1e-6, 1e-4))
def test_arcs_by_radius_and_by_centre_agree(
    first: float, sweep: float, radius: float, clockwise: bool, tolerance: float
) -> None:
    centre = np.array([0.01, -0.02])
    turn = -sweep if clockwise else sweep
    start, end = (centre + radius * np.array([np.cos(a), np.sin(a)]) for a in (first, first + turn))
    points = arc_by_centre(start, end, centre, clockwise, tolerance)
    length = np.hypot(*np.diff(np.vstack([start, points]), axis=0).T).sum()
    assert radius * sweep * (1 - 4 * min(tolerance / radius, 1.0)) - 1e-12 <= length <= radius * sweep + 1e-12
    middle = 0.5 * (np.vstack([start, points])[1:] + np.vstack([start, points])[:-1])
    assert radius - np.hypot(*(middle - centre).T).min() <= tolerance * 1.01 + 1e-12
    if abs(sweep - math.pi) > 0.01:  # at half a turn the centre moves much for little
        signed = radius if sweep < math.pi else -radius
        assert centre_by_radius(start, end, signed, clockwise) == pytest.approx(centre, abs=1e-6 * radius + 1e-10)


START = "G21\nG90\nM83\nG92 X0 Y0 Z0.2 E0\n"
WRONG = [
    # the fifth line, reason, hint
    ("G1 X1..2 E1", "cannot read 'X1..2 E1'", "each with a number"),
    ("G1 X E1", "cannot read 'X E1'", ""),
    ("G1 X1 X2 E1", "X occurs twice in this line", ""),
    ("G1 Xnan E1", "cannot read", ""),
    ("X1 Y1 E1", "'X1 Y1 E1' is not a command", "its number"),
    ("Gl X1 Y1", "is not a command", ""),
    ("1;2", "is not a command", ""),
    ("G5 X1 Y1 I1 J1", "G5 is not known", "G0, G1, G2 and G3"),
    ("G18\nG2 X9 I4.5 E1", "an arc extrudes in the plane of G18", "level"),
    ("G2 X9 I4.5 P2 E1", "an arc of several turns", "P1"),
    ("G1 X10 Z0.1 E1", "z goes down while material flows", "curved layers cannot be read"),
    ("G1 X1e-05 E1", "cannot read 'X1e-05 E1'", ""),
    ("G1 X9999999 E1", "X is farther than 100 m", ""),
    ("G1 X9 E1 F0", "F is 0", "greater than 0"),
    ("G2 X9 E1", "needs its centre (I, J) or its radius (R)", ""),
    ("G2 X9 I1 R3 E1", "needs its centre (I, J) or its radius (R)", ""),
    ("G2 X9 I1 E1", "starts 1.000 mm from its centre and ends 8.000 mm from it", ""),
    ("G2 I0 J0 E1", "centre is where it starts", ""),
    ("G2 X9 R2 E1", "cannot join points 9.000 mm apart", ""),
    ("G2 R2 E1", "ends where it starts", ""),
    ("G1 X9 E1\nM200 D1.75", "E changes here", "one or the other"),
    ("G1 X9 E1\nM200 S1", "E changes here", "one or the other"),
    ("M200 D1.75:0", "E is a volume for some tools only", "one or the other"),
    ("G28\nG1 X1 Y1 E1", "before anything says where the nozzle is", "before it"),
    ("G28\nG2 X1 Y1 I1 E1", "before anything says where the nozzle is", "before it"),
    ("G1 X9 C90 E1", "C moves while material flows", "layers.source.waypoints"),
    ("G1 C90 E1", "C moves while material flows", "layers.source.waypoints"),
    ("G0 B-30\nG1 X9 E1", "material flows with B at -30", "layers.source.waypoints"),
    ("G0 A90\nG2 X9 I4.5 E1", "material flows with A at 90", "layers.source.waypoints"),
    ("G1 X9 I0.5 J0 K0.866 E1", "tool's axis (I, J, K) at 0.5 0 0.866", "layers.source.waypoints"),
    ("G91\nM83\nG1 X9 U5 E1", "U moves while material flows", "layers.source.waypoints"),
]  # fmt: skip


@pytest.mark.parametrize(("line", "reason", "hint"), WRONG)
def test_a_bad_line_is_named(read: Read, line: str, reason: str, hint: str) -> None:
    with pytest.raises(InputError) as caught:
        read(f"{START}{line}\nG1 X20 E1\n")
    assert caught.value.line == 5 + line.count("\n")
    assert reason in caught.value.reason
    assert hint in (caught.value.hint or "")


@pytest.mark.parametrize(
    ("said", "volume"),
    [
        (("D1.75",), True),
        (("D0",), False),
        (("S1",), True),
        (("D1.75", "S0"), False),
        (("S0 D1.75",), False),
        (("D1.75 S1",), True),
        (("S1 D0",), False),
        (("D1.75:1.75",), True),
        (("D0:0",), False),
        (("T1 D2.85", ""), True),
    ],
)
def test_e_is_a_volume_where_m200_switches_it_on(read: Read, said: tuple[str, ...], volume: bool) -> None:
    """As Marlin and RepRapFirmware take it: the diameter alone switches it on, and S does or does not."""
    lines = "".join(f"M200 {words}\n" for words in said)
    assert read(f"{lines}{START}G1 X20 E1\n").volume is volume


def test_axes_that_stand_still_do_no_harm(read: Read) -> None:
    """As of machines with a tilting table that print level, of carriages that are parked, and in start code."""
    text = "G0 C90\n;LAYER:0\nG0 B0 C0 U20\nG1 X9 B0. C0 U20 E1\nG0 C5\nG0 C0\nG1 Y5 E1\n"
    assert sum(thread.length for thread in read(START + text).threads) == pytest.approx(14e-3)


@settings(max_examples=200, deadline=None)
@given(st.text(st.sampled_from("G0123928 XYZEIJRF.-;\nMT:()*LAYERabc%"), max_size=120), st.binary(max_size=20))
def test_any_text_is_read_or_refused(tmp_path_factory: pytest.TempPathFactory, text: str, more: bytes) -> None:
    path = tmp_path_factory.mktemp("text") / "part.gcode"
    path.write_bytes(f"{START}G1 X1 E1\n{text}".encode() + more)
    try:
        found = read_gcode(path, CHORD)
    except InputError as error:
        assert "\n" not in str(error)
        assert error.exit_code == 2
    else:
        for thread in found.threads:
            assert np.isfinite(thread.points).all()
            assert (thread.filament > 0).all()


def test_another_tool_begins_a_thread_and_is_told(read: Read, tmp_path: Path) -> None:
    text = "T1\nT0\n" + START + "G1 X9 E1\nT1\nG1 X20 E1\n"
    assert [thread.tool for thread in read(text).threads] == [0, 1]
    assert "part.gcode: tools 0, 1 print in turn; here one nozzle lays all of it" in built(tmp_path, text).notes


@pytest.mark.parametrize(
    ("data", "reason"),
    [
        (b"", "extrudes nothing"),
        (b"G28\nG1 X1 Y1 Z1\n", "extrudes nothing$|extrudes nothing .G-code"),
        (b"G28\nG1 X1 Y1 Z1 B3 C-9 A2\n", "extrudes nothing by E, but moves A, B, C .* as waypoints"),
        (b"G1 X\xff\n", "not UTF-8"),
    ],
)
def test_a_file_without_extrusion_is_refused(tmp_path: Path, data: bytes, reason: str) -> None:
    (tmp_path / "a.gcode").write_bytes(data)
    with pytest.raises(InputError, match=reason):
        read_gcode(tmp_path / "a.gcode", CHORD)


# Beads


def case(folder: Path, gcode: str, process: str = "bead: {width_mm: 0.5}", source: str = "") -> Path:
    """A problem that prints a text of G-code."""
    (folder / "part.gcode").write_text(gcode, encoding="utf-8")
    path = folder / "case.yaml"
    path.write_text(
        f"""\
name: part
cell:
  arm: irb140
  nozzle: {{tip_mm: [-44.51, 9.9, 113.95], axis: [0, 0, 1], diameter_mm: 0.6}}
  home_deg: [0, 0, 0, 0, 90, 0]
  bed_mm: [560, -93, 290]
layers:
  source: {{gcode: part.gcode{source}}}
process:
  speed_mm_s: 40
  travel_speed_mm_s: 200
  {process}
""",
        encoding="utf-8",
    )
    return path


def built(folder: Path, gcode: str, process: str = "bead: {width_mm: 0.5}", source: str = "") -> Toolpath:
    return build_toolpath(load_problem(case(folder, gcode, process, source)))


@pytest.mark.parametrize("section", ["rectangle", "rounded"])
@pytest.mark.parametrize("style", STYLES)
def test_beads_hold_what_the_file_extrudes(tmp_path: Path, style: str, section: str) -> None:
    path = case(tmp_path, STYLES[style], f"bead: {{width_mm: 0.4, section: {section}}}", ", origin_mm: [1, 2, 0]")
    problem = load_problem(path)
    toolpath = build_toolpath(problem)
    file = read_gcode(tmp_path / "part.gcode", CHORD)
    assert [bead.layer for bead in toolpath.beads] == [0, 0, 1]
    for bead, thread, height in zip(toolpath.beads, file.threads, (0.2e-3, 0.2e-3, 0.15e-3), strict=True):
        assert bead.height == pytest.approx(height)
        assert bead.points[[0, -1]] == pytest.approx(thread.points[[0, -1]] + [1e-3, 2e-3, 0.0])
        assert bead.normals.tolist() == [[0.0, 0.0, 1.0]] * len(bead.s)
        rounded = distance_to_polyline(bead.points, bead.source)
        assert rounded.max() <= problem.process.corner_tolerance
        held = trapezoid(bead_area(bead, problem.process), bead.s)
        assert held == pytest.approx(AREA * thread.filament.sum(), rel=0.03)  # a rounded corner is shorter
        straight = np.hypot(*(bead.points[:, :2] - [21e-3, 12e-3]).T) > 2e-3
        area = AREA * thread.filament[0] / np.linalg.norm(thread.points[1] - thread.points[0])
        assert bead_area(bead, problem.process)[straight] == pytest.approx(area, rel=1e-6)


def test_thin_threads_over_a_bridge_are_round(tmp_path: Path) -> None:
    thread = 10.0 * math.pi * 0.1e-3**2 / AREA  # mm of filament for 10 mm of a thread of 0.2 mm
    text = START.replace("Z0.2", "Z0.4") + f"G1 X10 E{thread:.9f}\n"
    (bead,) = built(tmp_path, text, "bead: {width_mm: 0.5, section: rounded}").beads
    assert bead.width == pytest.approx(0.2e-3)
    assert bead.height == pytest.approx(0.2e-3)


def test_widths_follow_the_extrusion_along_a_bead(tmp_path: Path) -> None:
    wide = 0.8e-3 * 0.2e-3 / AREA * 10
    (bead,) = built(tmp_path, f"{START}G1 X10 E{wide / 2:.9f}\nG1 X20 E{wide:.9f}\n").beads
    assert bead.width[bead.s < 9.9e-3] == pytest.approx(0.4e-3)
    assert bead.width[bead.s > 10.1e-3] == pytest.approx(0.8e-3)


def test_specks_are_left_out_and_counted(tmp_path: Path) -> None:
    text = START + "G1 X10 E0.5\nG1 X30\nG1 X30.3 E0.02\nG1 X50\nG1 X50.3 E0.02\nG1 Y20\nG1 X40 E0.5\n"
    toolpath = built(tmp_path, text, source=", leave_out_share: 0.03")
    assert len(toolpath.beads) == 2
    share = 0.6 / 20.9
    pieces = "2 pieces shorter than a bead is wide, 0.5 mm"
    assert f"part.gcode: {pieces}, left out, {share:.2%} of the length (lines 7, 9)" in toolpath.notes
    with pytest.raises(InputError, match=rf"{pieces}, would be left out, {share:.2%} of the length") as caught:
        built(tmp_path, text)
    assert caught.value.line == 7
    assert "leave_out_share, now 0.01" in (caught.value.hint or "")


def test_what_the_file_says_of_itself_is_told(tmp_path: Path) -> None:
    notes = built(tmp_path, PRUSA, "bead: {width_mm: 0.4}").notes
    assert notes[0] == "part.gcode: 1 move that extrudes before the first layer left out"
    assert "beads are 0.451 to 0.481 mm wide and 0.150 to 0.200 mm high" in notes[-2]
    assert "20 to 40 mm/s, are ignored" in notes[-1]


def test_small_loops_are_rounded_less_not_lost(tmp_path: Path) -> None:
    angles = np.linspace(0, 2 * math.pi, 13)
    ring = "".join(f"G1 X{0.4 * math.cos(a):.5f} Y{0.4 * math.sin(a):.5f} E0.01\n" for a in angles[1:])
    process = "bead: {width_mm: 0.3}\n  corner_tolerance_mm: 0.3"
    (bead,) = built(tmp_path, START + "G1 X0.4\n" + ring, process).beads
    assert bead.closed
    assert bead.length > 0.8 * 2.4e-3


BAD_PRINTS = [
    # G-code, process, source, field or line, reason, hint
    (START.replace("Z0.2", "Z0") + "G1 X9 E1\n", "", "", "layers.source.origin_mm", "0.000 mm above the bed", ""),
    (START + "G1 X9 E1\n", "", ", origin_mm: [0, 0, -1]", "layers.source.origin_mm", "-0.800 mm above the bed", ""),
    (START + "G1 X9 E10000\n", "", "", 5, "bead 13362.", "M82 or M83"),
    (START + "G1 X9 E1\nG1 X20 E0.00001\n", "", "", 6, "bead 0.000 mm wide", "M82 or M83"),
    (START + "G1 X9 E1\n;LAYER:1\nG1 X8 Z1 E1\n", "", "", 7, "z rises by 0.800 mm in 1.000 mm", "upright"),
    (START + "G1 X0.3 E1\n", "", "", "process.bead.width_mm", "shorter than a bead is wide", "specks"),
    (START + "G1 X9 E1\n", "bead: {width_mm: 0.5, height_mm: 0.2}", "", "process.bead", "comes from the G-code", "leave"),
    (START + "G1 X9 E1\n", "", ", svg: a.svg", "layers.source.svg", "both svg and gcode", "one"),
    (START + "G1 X9 E1\n", "", ", up: y", "layers.source.up", "unknown key", "gcode"),
]  # fmt: skip


@pytest.mark.parametrize(("gcode", "process", "source", "place", "reason", "hint"), BAD_PRINTS)
def test_prints_that_cannot_be_are_refused(
    tmp_path: Path,
    gcode: str,
    process: str,
    source: str,
    place: int | str,
    reason: str,
    hint: str,
    capsys: pytest.CaptureFixture[str],
) -> None:
    path = case(tmp_path, gcode, process or "bead: {width_mm: 0.5}", source)
    with pytest.raises(InputError) as caught:
        build_toolpath(load_problem(path))
    error = caught.value
    assert place in (error.line, error.field)
    assert reason in error.reason
    assert hint in (error.hint or "")
    out = tmp_path / "out"
    assert main([str(path), "--out", str(out), "--quiet"]) == 2
    assert not out.exists()
    assert capsys.readouterr().err.count("\n") == 1


def test_a_missing_file_and_a_body_are_errors_of_their_fields(tmp_path: Path) -> None:
    path = case(tmp_path, START)
    (tmp_path / "part.gcode").unlink()
    with pytest.raises(InputError, match="there is no file") as caught:
        build_toolpath(load_problem(path))
    assert (caught.value.field, caught.value.line) == ("layers.source.gcode", 8)
    path.write_text(path.read_text("utf-8") + "part: {sphere: {radius_mm: 9}}\n", "utf-8")
    with pytest.raises(InputError, match="a slicer's layers are level") as caught:
        load_problem(path)
    assert caught.value.field == "part"


# The layers beneath


def test_the_layers_grow_as_they_are_printed(tmp_path: Path) -> None:
    text = START.replace("Z0.2", "Z0.3") + "G1 X20 E1\nG1 Z0.6\nG1 X0 E1\nG1 Z0.9\nG1 X20 E1\n"
    toolpath = built(tmp_path, text)
    surface = toolpath.surface
    assert isinstance(surface, LevelLayers)
    for i, bead in enumerate(toolpath.beads):
        inner = bead.points[5:-5]
        # laid on the layer before, which is there while the bead is laid, and not while it is approached
        assert surface.before(i + 1).signed_distance(inner) == pytest.approx(0.3e-3, abs=1e-9)
        assert surface.before(i).signed_distance(inner) == pytest.approx(min(i, 1) * 0.3e-3 + 0.3e-3, abs=1e-9)
    above = np.array([[10e-3, 0.0, 5e-3], [10e-3, 4e-3, 0.1e-3], [10e-3, 0.0, 0.2e-3], [10e-3, 0.0, -1e-3]])
    found = surface.before(3).signed_distance(above)
    half = 0.5 * toolpath.beads[0].width[50]
    assert found == pytest.approx([4.4e-3, 0.1e-3, -min(0.4e-3, half), -1e-3], abs=2e-6)


@pytest.mark.slow
def test_distance_agrees_with_brute_force(tmp_path: Path) -> None:
    rng = np.random.default_rng(2)
    toolpath = build_toolpath(load_problem("planar_gcode"))
    surface = toolpath.surface.before(7)
    points = rng.uniform([-12e-3, -12e-3, -0.2e-3], [12e-3, 12e-3, 4e-3], (300, 3))
    best = points[:, 2].copy()
    for bead in toolpath.beads[:6]:
        away = np.linalg.norm(points[:, None, :2] - bead.points[None, :, :2], axis=2).min(axis=1) - 0.5 * bead.width[0]
        above = points[:, 2] - bead.points[0, 2]
        outside = np.hypot(np.maximum(away, 0), np.maximum(above, 0))
        best = np.minimum(best, outside + np.minimum(np.maximum(away, above), 0))
    found = surface.signed_distance(points)
    assert found == pytest.approx(best, abs=1e-6)  # widths differ by that much
    assert (found < 0).any() and (found > 2e-3).any()
    assert surface.normals(points).tolist() == [[0.0, 0.0, 1.0]] * 300


# The problem that ships


def test_the_shipped_file_is_what_the_script_writes() -> None:
    folder = find_problem("planar_gcode").parent
    lines = runpy.run_path(str(folder / "draw_gcode.py"))["box"]()
    assert (folder / "planar_box.gcode").read_text("utf-8") == "\n".join(lines) + "\n"


def test_the_shipped_box_is_what_it_says() -> None:
    problem = load_problem("planar_gcode")
    toolpath = build_toolpath(problem)
    assert [bead.layer for bead in toolpath.beads] == [0] * 3 + [1] * 3 + [2] * 3
    points = np.vstack([bead.points for bead in toolpath.beads])
    assert np.abs(points[:, :2]).max() == pytest.approx(10e-3, abs=problem.process.corner_tolerance)
    assert sorted(set(points[:, 2].round(9))) == [0.3e-3, 0.6e-3, 0.9e-3]
    for bead in toolpath.beads:
        assert bead.width == pytest.approx(0.5e-3, rel=2e-3)  # chords are a little shorter than their arcs
        assert bead.height == pytest.approx(0.3e-3)
    rise = [float(np.diff(sorted(set(points[:, 2]))).min()), float(np.diff(sorted(set(points[:, 2]))).max())]
    assert rise == pytest.approx([0.3e-3] * 2, rel=1e-6)
