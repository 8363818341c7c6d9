"""G-code in the manner of each slicer: start and end code, kinds, lifts, scarfs and spirals, tools; and what is left out."""

from __future__ import annotations

import math
import zipfile
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmarks import slicers
from benchmarks.slicer_count import count
from planner.base.errors import InputError
from planner.planning.check_command import examine
from planner.problem import Problem, load_problem
from planner.problem.layers import GcodeLayersSpec
from planner.toolpath.bead import Toolpath
from planner.toolpath.build import build_toolpath
from planner.toolpath.gcode.layers import LevelLayers, check_sizes
from planner.toolpath.gcode.reader import GcodeFile, read_gcode
from planner.toolpath.gcode.threads import choose

CHORD = 1e-5
Read = Callable[[str], GcodeFile]
Build = Callable[..., Toolpath]


@pytest.fixture
def read(tmp_path: Path) -> Read:
    def make(text: str) -> GcodeFile:
        path = tmp_path / "part.gcode"
        path.write_text(text, encoding="utf-8")
        return read_gcode(path, CHORD)

    return make


@pytest.fixture
def build(tmp_path: Path) -> Build:
    """Beads of a text, with settings of the problem."""

    def make(text: str, *settings: str) -> Toolpath:
        path = tmp_path / "part.gcode"
        path.write_text(text, encoding="utf-8")
        given = [f"layers.source.gcode={path}", "layers.source.origin_mm=[0, 0, 0]", *settings]
        return build_toolpath(load_problem("planar_gcode", given))

    return make


def lines_of(file: GcodeFile) -> list[list[list[float]]]:
    """Points of all threads [mm]."""
    return [(thread.points * 1e3).round(4).tolist() for thread in file.threads]


BAMBU = """\
; HEADER_BLOCK_START
; BambuStudio 01.09.07.52
; HEADER_BLOCK_END
; EXECUTABLE_BLOCK_START
M73 P0 R12
; FEATURE: Custom
G91
M17 Z0.4 ; lower the z-motor current
G380 S2 Z30 F300 ; like G38
G380 S2 Z-25 F300
G1 Z5 F300
G90
M1002 gcode_claim_action : 2
G29.1 Z0 ; clear z-trim value first
G392 S0
M620 S0A
T0
M621 S0A
T1000
M83
G28 X
G0 X18 Y1 Z0.8 F18000
G1 X240 E15 F6033
G2 X30 Y2 I1 J1 E3
; MACHINE_START_GCODE_END
; CHANGE_LAYER
; Z_HEIGHT: 0.2
; LAYER_HEIGHT: 0.2
G1 E-.8 F1800
; layer num/total_layer_count: 1/2
M622.1 S1
G1 X20 Y20 F30000
G1 Z.2
G1 E.8 F1800
; FEATURE: Outer wall
; LINE_WIDTH: 0.42
G1 X30 E.4 F1200
G3 X30 Y40 I0 J10 E1.2
; WIPE_START
G1 X29 E-.76 F6000
; WIPE_END
G17
G3 Z.6 I-1.2 J.3 P1 F30000
G1 X50 Y50 Z.6
G1 Z.2
G1 E.8
; FEATURE: Prime tower
G1 X60 E.4 F1200
; CP TOOLCHANGE START
; FLUSH_START
G1 E23.7 F523
G1 X62 E.5
; FLUSH_END
T1
; CP TOOLCHANGE END
; CHANGE_LAYER
; Z_HEIGHT: 0.4
; LAYER_HEIGHT: 0.2
G1 X20 Y20 Z.4 F30000
; FEATURE: Support
G1 X30 E.4 F1200
; FEATURE: Inner wall
G1 X40 E.4
; FEATURE: Custom
; MACHINE_END_GCODE_START
G1 X65 Y245 F12000
G1 X100 E4
; EXECUTABLE_BLOCK_END
"""


def test_bambu_studio(read: Read, build: Build) -> None:
    file = read(BAMBU)
    assert file.slicer == "Bambu Studio" and file.marked
    assert (file.before, file.after, file.between) == (2, 1, 0)
    assert [thread.kind for thread in file.threads] == [
        "Outer wall",
        "Prime tower",
        "Prime tower",
        "Support",
        "Inner wall",
    ]
    assert [thread.share for thread in file.threads] == ["", "purge", "purge", "support", ""]
    assert [thread.tool for thread in file.threads] == [0, 0, 0, 1, 1], "T1000 is no tool"
    wall = file.threads[0]
    assert wall.length == pytest.approx((10.0 + 10.0 * math.pi) * 1e-3, rel=5e-4)
    assert [thread.points[0, 2] for thread in file.threads] == pytest.approx([2e-4, 2e-4, 2e-4, 4e-4, 4e-4])
    toolpath = build(BAMBU)
    assert [bead.name for bead in toolpath.beads] == ["path 1 (Outer wall)", "path 2 (Support)", "path 3 (Inner wall)"]
    notes = "\n".join(toolpath.notes)
    assert "part.gcode: 2 moves that extrude before the first layer left out" in notes
    assert "part.gcode: 1 move that extrudes after the last layer left out" in notes
    assert "part.gcode: 2 pieces of purge (Prime tower), 0.012 m, left out" in notes
    assert "1 piece of support (Support), 0.010 m, printed; layers.source.leave_out would leave it out" in notes
    assert "M622.1 1" in notes
    assert len(build(BAMBU, "layers.source.leave_out=[support]").beads) == 4
    assert len(build(BAMBU, "layers.source.leave_out=[]").beads) == 5


IDEAMAKER = """\
;Sliced by ideaMaker 4.3.1.6600, 2023-01-08
;Filament Diameter #1: 1.750
M221 T0 S94.00
G28 X0 Y0
G90
M82
G1 F140 E29
G92 E0
;LAYER:-1
;Z:0.300
;HEIGHT:0.300
G0 F9000 X10 Y10
G0 F300 Z0.300
;TYPE:SKIRT
;WIDTH:0.420
G1 F1500 X40 Y10 E1.2
;LAYER:0
;Z:0.600
;HEIGHT:0.300
G0 X10 Y20 Z0.300
;TYPE:WALL-OUTER
G1 X20 Y20 Z0.400 E1.3
G1 X30 Y20 Z0.600 E1.7
G1 X30 Y30 Z0.600 E2.1
"""


def test_idea_maker_and_its_scarfs(read: Read, build: Build) -> None:
    file = read(IDEAMAKER)
    assert file.slicer == "ideaMaker" and file.flow == 1.0
    assert lines_of(file) == [
        [[10, 10, 0.3], [40, 10, 0.3]],
        [[10, 20, 0.3], [20, 20, 0.4], [30, 20, 0.6], [30, 30, 0.6]],
    ]
    toolpath = build(IDEAMAKER, "process.bead.section=rectangle")
    assert [bead.layer for bead in toolpath.beads] == [0, 1]
    scarf = toolpath.beads[1]
    assert scarf.height == pytest.approx(0.3e-3)
    assert scarf.points[:, 2] == pytest.approx(0.6e-3), "its start would be in the layer below"
    assert scarf.width[0] < 0.3 * scarf.width[-1], "but the flow is the file's"
    notes = "\n".join(toolpath.notes)
    assert "part.gcode: 1 piece rises within its layer and is laid level, as high as it ends" in notes
    assert "M221 is the slicer's own filament compensation: 94% of E is laid" in notes
    assert "1 piece of skirt (SKIRT), 0.030 m, printed" in notes
    assert len(build(IDEAMAKER, "layers.source.leave_out=[skirt]").beads) == 1


TWO_LINES = """\
;Generated with Cura_SteamEngine 5.9.1
M82
;LAYER_COUNT:2
;LAYER:0
G0 X10 Y10 Z0.3
G1 X30 Y10 E0.8
;LAYER:1
G0 X10 Y10 Z0.6
G1 X30 Y10 E1.6
"""


def test_idea_makers_compensation_is_counted_tool_by_tool(read: Read) -> None:
    pushed = [float(thread.filament.sum()) * 1e3 for thread in read(IDEAMAKER).threads]
    assert pushed == pytest.approx([0.94 * 1.2, 0.94 * 0.9])
    two = read(IDEAMAKER.replace("S94.00", "S94.00\nM221 T1 S90").replace(";LAYER:0\n", ";LAYER:0\nT1\n"))
    assert [float(thread.filament.sum()) * 1e3 for thread in two.threads] == pytest.approx([0.94 * 1.2, 0.9 * 0.9])
    assert two.counted == pytest.approx((0.9, 0.94))
    other = read(IDEAMAKER.replace("ideaMaker", "another"))
    assert float(other.threads[0].filament.sum()) * 1e3 == pytest.approx(1.2), "a printer's own matter"
    assert other.flow == pytest.approx(0.94) and other.counted == ()


@pytest.mark.parametrize(
    "said, diameters",
    [
        ("; filament_diameter = 2.85", [2.85]),
        ("; filament_diameter = 0.35", [0.35]),  # of a fibre
        (";filament_diameter: 120", [120.0]),  # of a cartridge that a ram empties
        ("; filament_diameter = 1.75,2.85\n; filament_diameter: 1.75,2.85", [1.75, 2.85]),
        ("; filament_diameter: 1.75", [1.75]),
        (";Filament Diameter #1: 2.850\n;Filament Diameter #2: 1.750", [2.85, 1.75]),
        ("; fiber_dia_mm = 3", [3.0]),
        (";   filamentDiameters,2.85|1.75|1.75", [2.85, 1.75, 1.75]),
        (";filament_diameter0: 1.75", [1.75]),
        ("; filament_diameter_mm_0 : \t2.85", [2.85]),
        ("; filament_diameter = 0", []),
        ("; filament_diameters", []),
    ],
)
def test_the_filament_that_a_file_was_sliced_for(read: Read, said: str, diameters: list[float]) -> None:
    assert [1e3 * each for each in read(f"{said}\n{TWO_LINES}").filament] == pytest.approx(diameters)


def test_beads_hold_what_the_files_filament_holds(build: Build) -> None:
    """Sliced for 2.85 mm, a file that was taken for one of 1.75 mm laid 38 % of it."""
    plain = build(TWO_LINES, "process.bead.section=rectangle")
    thick = build(f"; filament_diameter = 2.85\n{TWO_LINES}", "process.bead.section=rectangle")
    assert thick.beads[0].width == pytest.approx(plain.beads[0].width * (2.85 / 1.75) ** 2)
    assert (
        "part.gcode: its E is for 2.85 mm filament, as it says; process.filament_diameter_mm is what your extruder pushes"
        in (thick.notes)
    )
    unsaid = "part.gcode: does not say what filament its E is for; 1.75 mm is used, from process.filament_diameter_mm"
    assert unsaid in plain.notes and unsaid not in thick.notes
    given = build(f"; filament_diameter = 2.85\n{TWO_LINES}", "layers.source.filament_diameter_mm=1.75")
    assert (
        "part.gcode: says that its E is for 2.85 mm filament; layers.source.filament_diameter_mm, 1.75 mm, is used"
        in (given.notes)
    )
    said = build(
        f"; filament_diameter = 1.75\n{TWO_LINES}",
        "process.filament_diameter_mm=2.85",
        "process.bead.section=rectangle",
    )
    assert said.beads[0].width == pytest.approx(plain.beads[0].width), (
        "the robot pushes another than the file was sliced for"
    )
    none = build(TWO_LINES, "layers.source.filament_diameter_mm=1.75")
    assert not any("filament" in note for note in none.notes)


def test_tools_may_have_filaments_of_their_own(build: Build) -> None:
    text = "; filament_diameter = 1.75,2.85\n" + TWO_LINES.replace(";LAYER:1\n", ";LAYER:1\nT1\n")
    one, two = (build(each, "process.bead.section=rectangle") for each in (TWO_LINES, text))
    last = -1
    assert two.beads[0].width == pytest.approx(one.beads[0].width)
    assert two.beads[last].width == pytest.approx(one.beads[last].width * (2.85 / 1.75) ** 2)


def test_a_tool_is_parked_between_layers(read: Read) -> None:
    plain = read(TWO_LINES)
    parked = read(TWO_LINES.replace(";LAYER:1\n", ";LAYER:1\nP0 S1 L2 D0; park the tool\n"))
    assert lines_of(parked) == lines_of(plain) and ("P0", 1) in parked.passed


def test_a_wipe_tower_is_purge_beyond_the_change_of_tool_too(build: Build) -> None:
    """PrusaSlicer names it by its kind; between changes of tool, where the tower grows, by nothing else."""
    text = """\
; generated by PrusaSlicer 2.7.1
M83
;LAYER_CHANGE
;HEIGHT:0.3
G1 X10 Y10 Z.3
;TYPE:Solid infill
G1 X30 Y10 E0.8
;TYPE:Wipe tower
G1 X50 Y50
; CP TOOLCHANGE START
G1 X60 Y50 E0.4
; CP TOOLCHANGE END
G1 X60 Y60
G1 X80 Y60 E0.8
;TYPE:Perimeter
G1 X10 Y20
G1 X30 Y20 E0.8
"""
    toolpath = build(text)
    assert [bead.name for bead in toolpath.beads] == ["path 1 (Solid infill)", "path 2 (Perimeter)"]
    assert "part.gcode: 2 pieces of purge (Wipe tower), 0.030 m, left out" in toolpath.notes


def test_brackets_within_brackets_are_a_comment(read: Read) -> None:
    nested = TWO_LINES.replace(";LAYER:1\n", ";LAYER:1\n(<bridgeRotation> (0.754+0.657j) )\n")
    assert lines_of(read(nested)) == lines_of(read(TWO_LINES))


KISS = """\
; KISSlicer - FREE
; *** G-code Prefix ***
G21
G90
G28
T0
; BEGIN_LAYER_OBJECT z=0.25 z_thickness=0.25
; 'Prime Pillar Path', 0.4 [feed mm/s], 15.0 [head mm/s]
G1 X40 Y40 Z0.25
G1 X45 Y40 E0.2
; 'Perimeter Path', 0.4 [feed mm/s], 15.0 [head mm/s]
G1 X10 Y10 Z0.25 E0 F900
; 'Destring Prime'
G1 E2.0 F900
G1 X20 Y10 E0.4
G1 X20 Y20 E0.4
G1 X10 Y20 E0.4
G1 X10 Y11 E0.36
; 'Destring Suck'
G1 E-2.0
; END_LAYER_OBJECT z=0.25
; BEGIN_LAYER_OBJECT z=0.5 z_thickness=0.25
G1 X10 Y10 Z0.5
; 'Solid Path', 0.4 [feed mm/s]
G1 E2.0
G1 X20 Y10 E0.4
; END_LAYER_OBJECT z=0.5
; *** G-code Postfix ***
G1 X30 E5
"""


def test_kiss_slicer_counts_anew_without_saying_so(read: Read, build: Build) -> None:
    file = read(KISS)
    assert file.guessed and file.after == 1
    assert [thread.filament.round(7).tolist() for thread in file.threads] == [[2e-4], [4e-4] * 3 + [3.6e-4], [4e-4]]
    assert [thread.kind for thread in file.threads] == ["Prime Pillar", "Perimeter", "Solid"]
    assert [thread.height for thread in file.threads] == pytest.approx([0.25e-3] * 3)
    toolpath = build(KISS)
    assert [bead.name for bead in toolpath.beads] == ["path 1 (Perimeter)", "path 2 (Solid)"]
    assert any("neither M82 nor M83 says how E counts" in note for note in toolpath.notes)
    absolute = KISS.replace("T0\n", "T0\nM82\n")
    assert not read(absolute).guessed, "what is said counts"


def test_travel_that_writes_e_does_not_make_it_count_anew(read: Read) -> None:
    body = "".join(f"G1 X{k} Y9 E{k // 2 * 2}.5\nG1 X{k} Y{10 + k} E{k // 2 * 2 + 1}.2\n" for k in range(1, 20))
    text = "G92 X0 Y0 Z0.2 E0\n;LAYER:0\nG1 X0 Y5 E0\nG1 X0 Y6 E0\n"
    assert not read(text + body).guessed
    assert read(text + "".join(f"G1 X{k} Y9 E0.5\n" for k in range(1, 20))).guessed, "as many as the move before"


SLIC3R = """\
; generated by Slic3r 1.2.9 on 2017-09-08 at 17:49:05
; perimeters extrusion width = 0.50mm
M190 S57 ; set bed temperature
G28 ; home all axes
G10 P0 S195 R160 ; Set tool 0 operating and standby temperatures
G1 X5 Y5 Z0.3 F5000
G1 X100 E20 F600 ; prime
G21 ; set units to millimeters
G90 ; use absolute coordinates
M83 ; use relative distances for extrusion
G1 Z0.300 F9000.000
G1 X10 Y10 F9000
G1 E3.5 F2400
G1 F1800
G1 X20 Y10 E0.4 ; skirt
G1 X20 Y20 F9000
G1 X10 Y20 E0.4 ; perimeter
G1 Z0.600 F9000.000
G1 X20 Y20 E0.4 ; perimeter
M107
; filament used = 1.2mm
; layer_height = 0.3
"""


def test_slic3r_without_marks_begins_where_its_own_code_does(read: Read, build: Build) -> None:
    file = read(SLIC3R)
    assert (file.slicer, file.marked, file.before) == ("Slic3r", False, 1)
    assert [thread.share for thread in file.threads] == ["skirt", "", ""]
    assert lines_of(file)[0] == [[10, 10, 0.3], [20, 10, 0.3]]
    assert len(build(SLIC3R).beads) == 3
    rest = "G90\nM83\nG92 X0 Y0 Z0.3 E0\nG1 X20 E1\n"
    assert any("no comment says where a layer begins" in note for note in build(rest).notes)


SIMPLIFY3D_3 = """\
; G-Code generated by Simplify3D(R) Version 3.1.1
G90
M83
G 28 W ;
G92 E0.0
G1 Z0.200 F900
; layer 1, Z = 0.2
T0
; tool H0.200 W0.450
; skirt
G1 X10 Y10 F7200
G1 X40 Y10 E1.2 F390
; inner perimeter
G1 X10 Y20 F7200
G1 X40 Y20 E1.2 F390
; layer end
G1 X100 E4
"""


def test_simplify3d_of_old(read: Read) -> None:
    file = read(SIMPLIFY3D_3)
    assert (file.slicer, file.after) == ("Simplify3D", 1)
    assert [(thread.kind, thread.share) for thread in file.threads] == [("skirt", "skirt"), ("inner perimeter", "")]


def test_cura_for_ultimakers_counts_volume(read: Read, build: Build) -> None:
    text = (
        ";FLAVOR:UltiGCode\n;Layer height: 0.2\n;Generated with Cura_SteamEngine 4.8.0\nM82\n;LAYER_COUNT:1\n;LAYER:0\n"
        "G0 X10 Y10 Z0.2\n;TYPE:WALL-OUTER\nG11\nG1 X30 Y10 E1.6\nG10\n"
    )
    assert read(text).volume
    (bead,) = build(text, "process.bead.section=rectangle").beads
    assert bead.width == pytest.approx(0.4e-3)
    same = build(
        text.replace("UltiGCode", "Marlin").replace("M82", "M82\nM200 D2.85"), "process.bead.section=rectangle"
    )
    assert same.beads[0].width == pytest.approx(0.4e-3)


def vase(turns: int, marks: bool = True, height: str = ";HEIGHT:0.3") -> str:
    """A ring and a spiral on it."""
    lines = ["; generated by PrusaSlicer 2.7.1", "G28", "G90", "M83", ";LAYER_CHANGE", height, "G1 X10 Y0 Z.3"]
    corners = [(10 * math.cos(a), 10 * math.sin(a)) for a in np.linspace(0, 2 * math.pi, 73)[1:]]
    lines += [f"G1 X{x:.4f} Y{y:.4f} E.05" for x, y in corners]
    for turn in range(1, turns + 1):
        lines += [";LAYER_CHANGE", f";Z:{0.3 + 0.3 * turn:g}", height]
        lines += [f"G1 X{x:.4f} Y{y:.4f} Z{0.3 * turn + 0.3 * k / 72:.5f} E.05" for k, (x, y) in enumerate(corners, 1)]
    return "\n".join(line for line in lines if line and (marks or not line.startswith(";LAYER"))) + "\n"


def test_a_vase_is_one_bead_on_a_level_ring(read: Read, build: Build) -> None:
    file = read(vase(5))
    ring, spiral = file.threads
    assert np.ptp(ring.points[:, 2]) == 0.0
    assert spiral.points[[0, -1], 2] == pytest.approx([0.3e-3, 1.8e-3])
    toolpath = build(vase(5))
    assert [bead.layer for bead in toolpath.beads] == [0, 1]
    bead = toolpath.beads[1]
    assert bead.height == pytest.approx(0.3e-3)
    assert bead.length == pytest.approx(5 * 2e-2 * math.pi, rel=2e-3)
    rise = np.diff(bead.points[:, 2]) / np.diff(bead.s)
    assert rise == pytest.approx(0.3 / (20 * math.pi), rel=0.05), "it rises evenly"
    assert isinstance(toolpath.surface, LevelLayers)
    assert toolpath.surface.before(1).signed_distance(bead.points[5:-5]).min() > 0.0
    # without marks the spiral begins where z does; its height is that of the file
    alone = build(vase(5, marks=False, height="") + "; layer_height = 0.3\n", "process.bead.section=rectangle")
    assert [len(bead.s) > 100 for bead in alone.beads] == [True, True]
    assert alone.beads[1].height == pytest.approx(0.3e-3)


def test_a_vase_from_the_bed_is_refused(build: Build) -> None:
    rising = "\n".join(
        f"G1 X{x:.3f} Y{y:.3f} Z{0.1 + k * 0.01:.3f} E.1" for k, (x, y) in enumerate([(10, 1), (20, 5)] * 40)
    )
    with pytest.raises(InputError, match=r"rises from the bed to 0\.890 mm") as caught:
        build(f"G90\nM83\nG92 X0 Y0 Z0.1 E0\n;LAYER_CHANGE\n;HEIGHT:0.2\n{rising}\n")
    assert caught.value.line == 6
    assert "level first layer" in (caught.value.hint or "")


HEAD = "G90\nM83\nG92 X0 Y0 Z0 E0\n"


def test_objects_one_after_another_are_printed_at_once(build: Build) -> None:
    one = "".join(f"G1 X{x} Y0 Z{z}\nG1 X{x + 10} E.5\n" for x in (0, 50) for z in (0.2, 0.4))
    toolpath = build(HEAD + one)
    assert [(bead.layer, round(bead.points[0, 0] * 1e3)) for bead in toolpath.beads] == [
        (0, 0),
        (0, 50),
        (1, 0),
        (1, 50),
    ]
    assert [bead.height[0] for bead in toolpath.beads] == pytest.approx([0.2e-3] * 4)
    assert any(
        "z goes down at line 9; layers are printed from the lowest on instead" in note for note in toolpath.notes
    )


def test_over_a_gap_a_layer_is_as_high_as_its_flow_says(build: Build) -> None:
    levels = (0.2, 0.4, 0.6, 0.94, 1.03, 1.23)  # over the third there is a gap of a raft, and after it less
    text = HEAD + ";Layer height: 0.2\n" + "".join(f"G1 X0 Y0 Z{z}\nG1 X10 E.3\n" for z in levels)
    assert [bead.height[0] for bead in build(text).beads] == pytest.approx([0.2e-3] * 6)
    thick = text.replace("Z0.94\nG1 X10 E.3", "Z0.94\nG1 X10 E.51")
    assert build(thick).beads[3].height[0] == pytest.approx(0.34e-3), "as wide as others only if it is so high"
    low = build(HEAD + ";LAYER:0\n;HEIGHT:0.2\nG1 Z.5\nG1 X10 E.3\n")
    note = "the first layer is 0.200 mm high and ends 0.500 mm above the bed; layers.source.origin_mm would lower it"
    assert f"part.gcode: {note}" in low.notes


def test_the_lowest_layers_alone(build: Build) -> None:
    text = HEAD + "".join(f"G1 X0 Y0 Z{z}\nG1 X10 E.5\n" for z in (0.2, 0.4, 0.6))
    toolpath = build(text, "layers.count=2")
    assert [bead.layer for bead in toolpath.beads] == [0, 1]
    assert "part.gcode: the lowest 2 of 3 layers" in toolpath.notes
    assert len(build(text, "layers.count=3").beads) == 3
    with pytest.raises(InputError, match=r"layers\.count.*part\.gcode has 3 layers \(valid: 1 to 3\)"):
        build(text, "layers.count=4")


def test_tools_may_have_materials(build: Build) -> None:
    text = HEAD + "G1 Z.3\nT0\nG1 X10 E.5\nT1\nG1 X20 E.5\n"
    two = ["process.materials={pla: {}, pva: {}}", "layers.source.tool_materials=[pva, pla]"]
    assert [bead.material for bead in build(text, *two).beads] == ["pva", "pla"]
    for materials, reason in (("[pla]", "tool 1 of part.gcode has no material"), ("[pla, pvb]", "no material 'pvb'")):
        with pytest.raises(InputError, match=reason):
            build(text, two[0], f"layers.source.tool_materials={materials}")


def test_ironing_is_no_bead(build: Build) -> None:
    text = (
        HEAD + ";LAYER_CHANGE\n;TYPE:Top solid infill\nG1 Z.3\nG1 X10 E.5\n;TYPE:Ironing\n;HEIGHT:0.005\nG1 X0 E.005\n"
    )
    toolpath = build(text)
    assert len(toolpath.beads) == 1
    assert "part.gcode: 1 piece of ironing (Ironing), 0.010 m, left out" in toolpath.notes


def test_a_kind_that_is_all_there_is_cannot_be_left_out(build: Build) -> None:
    text = HEAD + ";LAYER:0\n;TYPE:SKIRT\nG1 Z.3\nG1 X10 E.5\n"
    with pytest.raises(InputError, match=r"layers\.source\.leave_out.*nothing else is in part\.gcode"):
        build(text, "layers.source.leave_out=[skirt]")
    with pytest.raises(InputError, match="unknown name 'skirts' \\(did you mean skirt"):
        build(text, "layers.source.leave_out=[skirts]")


# Files as they come
def test_a_packed_plate_is_unpacked(tmp_path: Path) -> None:
    def packed(*names: str) -> Path:
        path = tmp_path / "part.gcode.3mf"
        with zipfile.ZipFile(path, "w") as archive:
            archive.writestr("3D/3dmodel.model", "<model/>")
            for name in names:
                archive.writestr(name, BAMBU)
        return path

    assert len(read_gcode(packed("Metadata/plate_1.gcode"), CHORD).threads) == 5
    with pytest.raises(InputError, match="archive with G-code of 2 plates"):
        read_gcode(packed("Metadata/plate_1.gcode", "Metadata/plate_2.gcode"), CHORD)
    with pytest.raises(InputError, match="archive with G-code of 0 plates") as caught:
        read_gcode(packed(), CHORD)
    assert "slice it first" in (caught.value.hint or "")
    whole = packed("Metadata/plate_1.gcode").read_bytes()
    (tmp_path / "cut.3mf").write_bytes(whole[: len(whole) // 2])
    with pytest.raises(InputError, match="damaged archive"):
        read_gcode(tmp_path / "cut.3mf", CHORD)


def test_binary_and_foreign_text(tmp_path: Path) -> None:
    path = tmp_path / "part.gcode"
    path.write_bytes(b"GCDE\x01\x00\x00\x00")
    with pytest.raises(InputError, match="binary G-code"):
        read_gcode(path, CHORD)
    path.write_bytes("; Müller, 210 °C\n".encode("latin-1") + HEAD.encode() + b"G1 Z1\nG1 X9 E1\n")
    assert len(read_gcode(path, CHORD).threads) == 1
    path.write_bytes(HEAD.encode() + b"G1 Z1\nG1 X9 E1 \xff\n")
    with pytest.raises(InputError, match="not UTF-8") as caught:
        read_gcode(path, CHORD)
    assert caught.value.line == 5


def test_start_code_may_hold_anything_and_the_print_not(read: Read) -> None:
    start = "G1 X{first_layer_print_min[0]} E9\n{if x}\nG5 X1 Y1\nG2 X1 Y1\nM117 50% (ready)\n"
    body = "G1 Z.2\nG1 X9 E1\n"
    assert len(read(HEAD + start + ";LAYER_CHANGE\n" + body).threads) == 1
    for line in ("G1 X{a} E9", "{if x}", "G5 X1 Y1 I1 J1"):
        with pytest.raises(InputError) as caught:
            read(HEAD + ";LAYER_CHANGE\n" + body + line + "\n")
        assert caught.value.line == 7


@cache
def _planar() -> Problem:
    return load_problem("planar_gcode", ["layers.source.origin_mm=[0, 0, 0]"])


noise = st.sampled_from(
    [
        "M104 S210", "M73 P12 R3", "SET_VELOCITY_LIMIT ACCEL=5000", "EXCLUDE_OBJECT_START NAME=a_b-1", "M486 S1", "T0",
        "; a remark; with more", "M117 Layer 3 (of 9)", "G4 P100", "M204 S1500", "G10", "G11", "", "M600", ";WIDTH:0.42",
        "TIMELAPSE_TAKE_FRAME", "G17", "M1002 gcode_claim_action : 2", "@OBJECT 3", "M220 S100", "N5 G21*12",
    ]
)  # fmt: skip


@settings(max_examples=60)
@given(st.lists(st.tuples(noise, st.integers(0, 10_000)), max_size=30))
def test_what_a_printer_is_told_between_beads_changes_nothing(
    tmp_path_factory: pytest.TempPathFactory, added: list[tuple[str, int]]
) -> None:
    path = tmp_path_factory.mktemp("noise") / "part.gcode"
    text = IDEAMAKER.splitlines()
    path.write_text("\n".join(text))
    plain = read_gcode(path, CHORD)
    # anywhere but inside a bead, where a change of tool or a retraction ends it
    places = [k for k, line in enumerate(text, 1) if not (line.startswith("G1") and "E" in line)]
    for line, where in added:
        text.insert(places[where % len(places)], line)
        places = [k for k, each in enumerate(text, 1) if not (each.startswith("G1") and "E" in each)]
    path.write_text("\n".join(text))
    found = read_gcode(path, CHORD)
    assert lines_of(found) == lines_of(plain)
    assert [t.filament.tolist() for t in found.threads] == [t.filament.tolist() for t in plain.threads]


@settings(max_examples=60, deadline=None)
@given(
    st.sampled_from([BAMBU, IDEAMAKER, KISS, SLIC3R, vase(2)]),
    st.lists(
        st.tuples(st.integers(0, 10_000), st.text(st.sampled_from("GXYZE0123.-; :'MT\n"), max_size=4)),
        min_size=1,
        max_size=4,
    ),
)
def test_a_damaged_file_is_read_or_refused_by_line(
    tmp_path_factory: pytest.TempPathFactory, text: str, changes: list[tuple[int, str]]
) -> None:
    path = tmp_path_factory.mktemp("damaged") / "part.gcode"
    for where, instead in changes:
        at = where % len(text)
        text = text[:at] + instead + text[at + len(instead) :]
    path.write_text(text)
    problem = _planar()
    assert isinstance(problem.layers, GcodeLayersSpec)
    source = problem.layers.source.model_copy(update={"gcode": path})
    spec = problem.layers.model_copy(update={"source": source})
    try:
        read = read_gcode(path, CHORD)
        chosen = choose(problem, spec, read)
        check_sizes(problem, spec, read, chosen)
    except InputError as error:
        assert "\n" not in str(error)
        assert error.line is not None or error.field is not None or "extrudes nothing" in error.reason
    else:
        for step in chosen.steps:
            assert np.isfinite(step.thread.points).all()
            assert step.thread.length > 0.0 and (step.thread.filament > 0.0).all()
            assert 1e-5 <= step.height <= 0.05


# The independent count, and the command
@pytest.mark.parametrize("text", [BAMBU, IDEAMAKER, KISS, SLIC3R, SIMPLIFY3D_3, vase(3)])
def test_the_count_agrees(read: Read, tmp_path: Path, text: str) -> None:
    file = read(text)
    counted = count(tmp_path / "part.gcode").lengths
    for share in ("", "purge", "skirt", "support"):
        own = sum(thread.length for thread in file.threads if thread.share == share)
        assert counted.get(share or "part", 0.0) * 1e-3 == pytest.approx(own, rel=1e-3, abs=1e-9)


def test_the_command_has_a_row_for_each_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = tmp_path / "files"
    folder.mkdir()
    (folder / "a.gcode").write_text(IDEAMAKER)
    (folder / "b.gcode").write_text(BAMBU)
    (folder / "c.gcode").write_text(";LAYER_CHANGE\nG1 X1 Q\n")
    out = tmp_path / "table.csv"
    assert slicers.main([str(folder), "--out", str(out), "--beads"]) == 0
    rows = out.read_text("utf-8").splitlines()
    assert rows[0].split(",")[:4] == ["file", "slicer", "megabytes", "read_s"]
    assert rows[1].startswith("a.gcode,ideaMaker,")
    assert "c.gcode:2: cannot read 'Q'" in rows[3]
    said = capsys.readouterr().out
    assert "ideaMaker: 1 files, 1 read, 1 within 0.5 % of the count" in said
    assert slicers.main([str(tmp_path / "none")]) == 2


def test_check_lays_the_lowest_layer_and_looks_at_all(tmp_path: Path) -> None:
    found = examine(load_problem("planar_gcode"))
    assert found.first_layer and found.toolpath is not None
    assert {bead.layer for bead in found.toolpath.beads} == {0}
    (tmp_path / "part.gcode").write_text(HEAD + "G1 Z.2\nG1 X10 E.5\nG1 Z.4\nG1 X0 E9999\n")
    wide = examine(
        load_problem(
            "planar_gcode", [f"layers.source.gcode={tmp_path / 'part.gcode'}", "layers.source.origin_mm=[0, 0, 0]"]
        )
    )
    assert [mistake.line for mistake in wide.mistakes] == [7]
