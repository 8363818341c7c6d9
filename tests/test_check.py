"""The command that reads a problem without planning it: what it says, every mistake, and how it ends."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from planner.planning.check_command import examine, is_quick, main
from planner.planning.estimate import estimate
from planner.planning.options import DEFAULT_DT
from planner.problem import load_problem, shipped_problems

ROOT = Path(__file__).resolve().parents[1]
SQUARE = '<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 20 20"><path d="M0 0h20v20H0z"/></svg>\n'
OWN = """\
name: own
cell:
  arm: {arm}
  nozzle: {{tip_mm: [-44.51, 9.9, 113.95], diameter_mm: 0.6}}
  home_deg: {home}
  positioner: {{robot: {holder}, origin_mm: [633.5, 9.87, 320], part_mm: [0, 0, 60], free: [rotation]}}
part:
  cylinder: {{radius_mm: 34, height_mm: 100, centre_mm: [31.4, 37]}}
layers:
  source: {{svg: {svg}, width_mm: 20}}
  wrap: cylinder
  count: 4
  height_mm: 0.5
process:
  speed_mm_s: 40
  travel_speed_mm_s: 200
  bead: {{width_mm: 0.6}}
"""
RIGHT = {"arm": "irb140", "home": "[30, 20, 30, 90, -80, 60]", "holder": "irbp_a250", "svg": "square.svg"}


def own(folder: Path, **changes: str) -> Path:
    (folder / "square.svg").write_text(SQUARE, encoding="utf-8")
    file = folder / "own.yaml"
    file.write_text(OWN.format(**{**RIGHT, **changes}), encoding="utf-8")
    return file


def test_what_a_problem_says(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([str(own(tmp_path))]) == 0
    said = capsys.readouterr()
    assert said.err == ""
    for words in (
        "ABB IRB 140-6/0.8 (irb140)",
        "ABB IRBP A250 (irbp_a250); free: rotation; held: tilt at 0 deg",
        "cylinder (radius_mm 34; height_mm 100; centre_mm [31.4, 37])",
        "1 bead, 0.08 m, 2 s at 40 mm/s, in the first layer alone",
        "its outline is assumed",
        "assumed of ABB IRB 140-6/0.8",
    ):
        assert words in said.out
    assert said.out.splitlines()[-1].startswith("nothing wrong found; python -m planner.solve ")
    assert {path.name for path in tmp_path.iterdir()} == {"own.yaml", "square.svg"}


def test_all_layers_when_asked_for(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([str(own(tmp_path)), "--toolpath", "--set", "process.speed_mm_s=20"]) == 0
    assert "4 beads, 0.32 m, 16 s at 20 mm/s, in 4 layers" in capsys.readouterr().out


def test_the_time_to_plan_is_that_at_the_speeds_of_beads(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    speeds = "process.speeds=[{speed_mm_s: 1}]"
    assert main([str(own(tmp_path)), "--toolpath", "--set", speeds]) == 0
    work = examine(load_problem(own(tmp_path), [speeds]), True).work
    assert work is not None
    assert f"planning them takes {estimate(work, 1e-3, DEFAULT_DT).words}" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("waits", "more", "resting"),
    [
        ("process.start.heat_wait_s=3600", [], 3600.0),
        ("process.layer_time={least_s: 3600, slowest_mm_s: 40}", ["--toolpath"], 3.0 * (3600.0 - 2.0)),
    ],
)
def test_the_time_to_plan_is_that_with_rests(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], waits: str, more: list[str], resting: float
) -> None:
    assert main([str(own(tmp_path)), "--set", waits, *more]) == 0
    work = examine(load_problem(own(tmp_path), [waits]), bool(more)).work
    assert work is not None
    assert f"planning them takes {estimate(work, 0.04, DEFAULT_DT, resting).words}" in capsys.readouterr().out


def test_a_bead_too_short_for_its_fibre(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([str(own(tmp_path)), "--set", "process.fibre={cut_length_mm: 100}"]) == 2
    assert "process.fibre" in capsys.readouterr().err


def test_every_mistake_of_the_file_at_once(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = own(tmp_path)
    text = file.read_text(encoding="utf-8").replace("speed_mm_s: 40", "sped_mm_s: 40").replace("count: 4", "count: 0")
    file.write_text(text.replace("width_mm: 0.6", "width_mm: wide"), encoding="utf-8")
    assert main([str(file)]) == 2
    said = capsys.readouterr()
    lines = said.err.splitlines()
    assert [line.split(": ")[2] for line in lines[:-1]] == [
        "layers.count",
        "process.sped_mm_s",
        "process.bead.width_mm",
    ]
    assert "did you mean speed_mm_s?" in said.err
    assert lines[-1] == "3 mistakes"
    assert said.out == ""


def test_every_mistake_beyond_the_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = own(tmp_path, arm="irb14", holder="irbp_a25", svg="sqare.svg")
    assert main([str(file)]) == 2
    lines = capsys.readouterr().err.splitlines()
    assert ["cell.arm" in lines[0], "cell.positioner.robot" in lines[1], "sqare.svg" in lines[2]] == [True] * 3
    assert "did you mean irb140?" in lines[0]
    assert "did you mean irbp_a250?" in lines[1]


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"home": "[30, 20, 30, 90, -80]"}, "cell.home_deg"),
        ({"home": "[30, 20, 300, 90, -80, 60]"}, "joint 3 is outside its range"),
    ],
)
def test_start_postures_that_cannot_be(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], changes: dict[str, str], said: str
) -> None:
    assert main([str(own(tmp_path, **changes))]) == 2
    assert said in capsys.readouterr().err


def test_a_start_posture_within_a_wall(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    wall = "cell.fixtures={wall: {box_mm: [100, 900, 900], centre_mm: [300, 0, 700]}}"
    assert main([str(own(tmp_path)), "--set", wall]) == 2
    assert "in the start posture" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("name", "field", "text"),
    [
        ("saddle_ring", "layers.source.mesh", "no mesh"),
        ("curved_plate", "part.step.file", "not a STEP file"),
        ("naca0015_wing", "layers.source.aerofoil", "no section"),
    ],
)
def test_files_of_slow_sources_are_read(tmp_path: Path, name: str, field: str, text: str) -> None:
    broken = tmp_path / "broken.txt"
    broken.write_text(text, encoding="utf-8")
    for value in (broken, tmp_path / "missing"):
        found = examine(load_problem(name, [f"{field}={value}"]))
        assert [field in str(mistake) or value.name in str(mistake) for mistake in found.mistakes] == [True]
    assert examine(load_problem(name)).mistakes == ()


MAP = "x_mm,y_mm,z_mm,nx,ny,nz,deviation_mm\n" + "".join(f"{x},0,1,0,0,1,0.05\n" for x in range(9))
SHIFTS = "bead,s_mm,dx_mm,dy_mm,dz_mm\n0,0,0,0,0.01\n"
CURVES = '{"curves": [{"degree": 1, "points_mm": [[-10, 0], [10, 0]]}]}'


@pytest.mark.parametrize("name", ["hemisphere_honeycomb", "saddle_ring"])
@pytest.mark.parametrize(
    ("section", "text", "bad"),
    [
        ("as_printed={{map: {}, after_layer: 1, most_mm: 0.05, smoothing_mm: 5}}", MAP, "is not a height map"),
        ("as_run={{corrections: {}, most_mm: 1}}", SHIFTS, "holds no corrections"),
    ],
    ids=["map", "corrections"],
)
def test_files_that_scans_and_runs_left_are_read(tmp_path: Path, name: str, section: str, text: str, bad: str) -> None:
    """Of problems that are laid at once, of which one layer is, and of others."""
    file = tmp_path / "left.csv"
    problem = load_problem(name, [section.format(file)])
    file.write_text(text, encoding="utf-8")
    assert examine(problem).mistakes == ()
    file.write_text("a,b\n1,2\n", encoding="utf-8")
    assert [bad in str(mistake) for mistake in examine(problem).mistakes] == [True]


def test_curves_on_a_slow_body_are_read(tmp_path: Path) -> None:
    file = tmp_path / "curves.json"
    layers = f"layers={{source: {{nurbs: {file}}}, project: z, count: 1, height_mm: 0.5}}"
    problem = load_problem("aerofoil_core", [layers])
    file.write_text(CURVES, encoding="utf-8")
    assert examine(problem).mistakes == ()
    file.write_text("{}", encoding="utf-8")
    assert ["curves" in str(mistake) for mistake in examine(problem).mistakes] == [True]


def test_an_order_that_a_source_has_already_is_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["planar_gcode", "--set", "process.order=['path*']"]) == 2
    assert "the order of beads is fixed by this source already" in capsys.readouterr().err


def test_most_that_ships_is_laid_at_once() -> None:
    quick = [name for name in shipped_problems() if is_quick(load_problem(name))]
    assert len(quick) > 6
    assert {"cylinder_logo", "peer_cap", "planar_gcode", "fibre_bowl", "hemisphere_honeycomb"} <= set(quick)


def test_what_it_imports_for_a_wrong_file(tmp_path: Path) -> None:
    """A mistake in the file itself is told without the packages that take most of a second."""
    file = own(tmp_path, arm="7")
    code = f"import sys; from planner.planning.check_command import main; main([{str(file)!r}]); print(*sys.modules)"
    ran = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    assert "cell.arm" in ran.stderr
    assert not {"numba", "pinocchio", "trimesh", "plotly", "matplotlib", "scipy.spatial"} & set(ran.stdout.split())
