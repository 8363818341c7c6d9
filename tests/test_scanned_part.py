"""A scanned bed or part: how near its smooth surface comes to the truth, in which files it may stand, and what is refused."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from benchmarks.scanned_bed import NOISE, above, dome, outward, save
from planner.base.arrays import Array
from planner.base.errors import InputError
from planner.planning.check_command import main as check
from planner.problem import load_problem
from planner.problem.part import ScanSpec
from planner.toolpath.bead import Toolpath
from planner.toolpath.build import build_toolpath
from planner.toolpath.substrate.scan_surface import scan_surface
from planner.verify.reread.scan import sheets_at

RADII = np.array([55.0, 55.0, 30.0])  # mm
YAML = """\
name: scanned
cell:
  arm: irb140
  nozzle: {{tip_mm: [0, 0, 120], axis: [0, 0, 1], diameter_mm: 0.6}}
  home_deg: [0, 0, 0, 0, 30, 0]
  bed_mm: [560, 0, 290]
part: {{scan: {{{scan}}}}}
layers:
  source: {{curves: [{{degree: 2, points_mm: [[-30, -18], [-10, 24], [10, -24], [30, 18]]}}]}}
  project: z
  count: 1
  height_mm: 0.3
process:
  speed_mm_s: 20
  travel_speed_mm_s: 200
  bead: {{width_mm: 1.2, height_mm: 0.3}}
"""


def built(folder: Path, scan: str) -> Toolpath:
    path = folder / "scanned.yaml"
    path.write_text(YAML.format(scan=scan))
    return build_toolpath(load_problem(path))


def errors(toolpath: Toolpath) -> tuple[float, float]:
    """The largest errors of height [mm] and of normals [deg] against the truth."""
    (bead,) = toolpath.beads
    points = 1e3 * (bead.points - 0.3e-3 * bead.normals)
    turned = np.arccos(np.clip((outward(RADII, points) * bead.normals).sum(axis=1), -1.0, 1.0))
    return float(np.abs(above(RADII, points)).max()), float(np.degrees(turned).max())


@pytest.mark.slow(cases=("ply", "xyz", "stl", "npy"))
@pytest.mark.parametrize("ending", ["xyz", "ply", "stl", "off", "npy"])
def test_noise_of_three_tenths_is_smoothed(tmp_path: Path, ending: str) -> None:
    """Of points up to 0.3 mm off, 1 mm apart: the path is within 0.06 mm of the truth, its normals within 0.6 degrees."""
    save(tmp_path / f"dome.{ending}", dome(RADII))
    toolpath = built(tmp_path, f"file: dome.{ending}")
    height, turn = errors(toolpath)
    assert height < 0.2 * NOISE and turn < 0.6
    (note,) = [note for note in toolpath.notes if note.startswith("part.scan: ")]
    most, rms = (float(note.split(" mm ")[k].split()[-1]) for k in (0, 1))
    assert NOISE <= most < NOISE + 0.06 and rms == pytest.approx(NOISE / np.sqrt(3.0), rel=0.05), note


@pytest.mark.slow
def test_without_noise_it_is_the_part_itself(tmp_path: Path) -> None:
    save(tmp_path / "dome.xyz", dome(RADII, noise=0.0))
    height, turn = errors(built(tmp_path, "file: dome.xyz"))
    assert height < 0.005 and turn < 0.1


@pytest.mark.slow
def test_denser_points_come_nearer(tmp_path: Path) -> None:
    heights = []
    for apart in (2.0, 1.0, 0.5):
        save(tmp_path / "dome.xyz", dome(RADII, apart))
        heights.append(errors(built(tmp_path, "file: dome.xyz"))[0])
    assert heights[0] > heights[2] and heights[2] < 0.03


@pytest.mark.slow
def test_a_scan_is_turned_moved_and_enlarged(tmp_path: Path) -> None:
    """Scanned lying on its side, elsewhere, in centimetres and at half its size: put in its place by the problem's keys."""
    turned = dome(RADII)[:, [0, 2, 1]] * [1.0, 1.0, -1.0]
    save(tmp_path / "dome.xyz", 0.05 * turned + [1.0, 2.0, 3.0])
    keys = "file: dome.xyz, unit: cm, scale: 2, rpy_deg: [90, 0, 0], origin_mm: [-20, 60, -40]"
    assert errors(built(tmp_path, keys))[0] < 0.06


def test_beside_wide_beads_the_scan_is_known_as_far_as_they_are_wide() -> None:
    """Of a slope of 1 in 20 that was scanned every 5 mm, beneath a line that ends 200 mm from the scan's rim."""
    x, y = (each.ravel() for each in np.meshgrid(*[np.arange(-300, 301, 5) * 1e-3] * 2))
    line = np.column_stack([np.linspace(-0.1, 0.1, 2001), np.zeros(2001)])
    spec = ScanSpec.model_construct(file=Path("bed.xyz"), noise=0.5e-3, hole=None)
    found = scan_surface(spec, np.column_stack([x, y, 0.05 * x]), [line], 30e-3, InputError)
    beyond = np.abs(found.facets.corners[..., :2]).max(axis=(0, 1)) - [0.1, 0.0]
    assert (beyond > 24e-3).all() and (beyond < 31e-3).all()


def test_a_scan_whose_header_names_a_wrong_unit_is_told_its_scale(tmp_path: Path) -> None:
    np.savetxt(tmp_path / "dome.csv", dome(RADII), delimiter=",", header="x_m,y_m,z_m", comments="")
    with pytest.raises(InputError, match=r"mm across \(.*scale: 0\.001 makes it 10"):
        built(tmp_path, "file: dome.csv")


@pytest.mark.slow(keep=4)
@pytest.mark.parametrize(
    ("spoil", "keys", "words"),
    [
        (lambda p: p[np.hypot(p[:, 0], p[:, 1]) > 6], "", "has a hole under the curves: no point within"),
        (lambda p: 1e-3 * p, "", r"is 0\.101\d* mm across \(unit: m makes it 101"),
        (lambda p: 1e3 * p, "", r"mm across \(unit: um makes it 101"),
        (lambda p: p, ", noise_mm: 0.2", r"mm off the smooth surface at x .* and noise_mm allows 0\.2 .*noise_mm: 0\.3"),
        (lambda p: np.vstack([p, [[0.0, 3.0, 45.0]]]), "", r"a step, or a stray point: clean the scan\)$"),
        (lambda p: np.vstack([p, [[0.0, 3.0, p[:, 2].max() + 2.0]]]), "", r"clean the scan; or noise_mm: \d\.\d\d\)$"),
        (lambda p: np.vstack([p, p * [1.0, 1.0, 0.2]]), "", r"\d% of the points of dome.xyz near .*leave out the underside"),
        (lambda p: p + [500.0, 0.0, 0.0], "", r"has 0 points under the curves \(at least 200; it spans x 4"),
        (lambda p: p[:100], "", "holds 100 points"),
        (lambda p: np.where(np.arange(len(p))[:, None] == 7, np.nan, p), "", "not finite"),
    ],
)  # fmt: skip
def test_scans_that_cannot_be_printed_on(
    tmp_path: Path, spoil: Callable[[Array], Array], keys: str, words: str
) -> None:
    save(tmp_path / "dome.xyz", spoil(dome(RADII)))
    with pytest.raises(InputError, match=words) as caught:
        built(tmp_path, f"file: dome.xyz{keys}")
    assert caught.value.exit_code == 2
    assert caught.value.field in ("part.scan.file", None) and caught.value.file is not None


@pytest.mark.slow
def test_a_hole_is_bridged_where_it_may_be(tmp_path: Path) -> None:
    points = dome(RADII)
    save(tmp_path / "dome.xyz", points[np.hypot(points[:, 0], points[:, 1]) > 6])
    assert errors(built(tmp_path, "file: dome.xyz, hole_mm: 14"))[0] < 0.15


@pytest.mark.slow
def test_holes_aside_do_no_harm_and_beside_the_scan_curves_leave_it(tmp_path: Path) -> None:
    points = dome(RADII)
    save(tmp_path / "dome.xyz", points[np.hypot(points[:, 0], points[:, 1] - 30) > 8])
    assert errors(built(tmp_path, "file: dome.xyz"))[0] < 0.06
    save(tmp_path / "half.xyz", points[points[:, 0] < 10])
    with pytest.raises(InputError, match="leave_out_share"):
        built(tmp_path, "file: half.xyz")


def test_a_file_is_checked_before_it_is_planned(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "scanned.yaml"
    path.write_text(YAML.format(scan="file: dome.xyz"))
    assert check([str(path)]) == 2
    save(tmp_path / "dome.xyz", dome(RADII))
    assert check([str(path)]) == 0
    (tmp_path / "dome.xyz").write_text("1 2 3\n4 5\n" * 300)
    assert check([str(path)]) == 2
    assert "dome.xyz:2: does not hold three numbers" in capsys.readouterr().err


def test_the_verifiers_sheets_know_how_sure_they_are(tmp_path: Path) -> None:
    """Heights and normals of sheets are off the truth by less than they say."""
    save(tmp_path / "dome.xyz", dome(RADII))
    (tmp_path / "scanned.yaml").write_text(YAML.format(scan="file: dome.xyz"))
    part = load_problem(tmp_path / "scanned.yaml").part
    assert part is not None and part.scan is not None
    x, y = np.random.default_rng(3).uniform(-25.0, 25.0, (2, 300))
    z = RADII[2] * np.sqrt(1.0 - (x / RADII[0]) ** 2 - (y / RADII[1]) ** 2)
    truth = np.column_stack([x, y, z])
    found = sheets_at(part.scan, 1e-3 * truth[:, :2])
    assert (np.abs(1e3 * found.z - z) * found.normals[:, 2] <= 1e3 * found.unsure).all()
    assert 0.02 < 1e3 * found.unsure.mean() < 0.15
    turned = np.arccos(np.clip((found.normals * outward(RADII, truth)).sum(axis=1), -1.0, 1.0))
    assert (turned <= found.turn + 1e-4).all() and np.degrees(found.turn).mean() < 2.5


def relief(apart: float, wave: float, high: float, noise: float = 0.0) -> Array:
    """Points (n, 3) [mm] about `apart` from each other on waves as long as `wave` and so `high`, off them by `noise`."""
    plane = dome(RADII, apart)[:, :2]
    k, rng = 2.0 * np.pi / wave, np.random.default_rng(5)
    z = 30.0 + high * np.sin(k * plane[:, 0]) * np.cos(k * plane[:, 1]) + rng.uniform(-noise, noise, len(plane))
    return np.column_stack([plane, z])


@pytest.mark.parametrize("noise", [0.0, 0.02])
def test_sheets_follow_shape_that_is_finer_than_many_points(tmp_path: Path, noise: float) -> None:
    """On waves 24 mm long, of which 150 points cover most, sheets are off the truth by no more than they say, and say little."""
    save(tmp_path / "dome.xyz", relief(1.0, 24.0, 0.6, noise))
    (tmp_path / "scanned.yaml").write_text(YAML.format(scan="file: dome.xyz"))
    part = load_problem(tmp_path / "scanned.yaml").part
    assert part is not None and part.scan is not None
    x, y = np.random.default_rng(3).uniform(-25.0, 25.0, (2, 300))
    k = 2.0 * np.pi / 24.0
    found = sheets_at(part.scan, 1e-3 * np.column_stack([x, y]))
    up = np.column_stack([-np.cos(k * x) * np.cos(k * y), np.sin(k * x) * np.sin(k * y), np.full(300, 1.0 / (0.6 * k))])
    turned = np.arccos(np.clip((found.normals * up).sum(axis=1) / np.linalg.norm(up, axis=1), -1.0, 1.0))
    assert (turned <= found.turn + np.radians(1.0)).all()
    assert np.degrees(np.median(found.turn)) < 3.0
    assert (np.abs(1e3 * found.z - 30.0 - 0.6 * np.sin(k * x) * np.cos(k * y)) <= 1e3 * found.unsure + 0.05).all()


def test_sheets_of_points_in_lines_are_unsure_beside_these(tmp_path: Path) -> None:
    """Of profiles 2 mm apart with points every 0.1 mm, small sheets hold points of one line alone, which say nothing."""
    x, y = (each.ravel() for each in np.meshgrid(np.arange(-30.0, 30.0, 0.1), np.arange(-30.0, 30.0, 2.0)))
    save(tmp_path / "dome.xyz", np.column_stack([x, y, 30.0 + 0.1 * y]))
    (tmp_path / "scanned.yaml").write_text(YAML.format(scan="file: dome.xyz"))
    part = load_problem(tmp_path / "scanned.yaml").part
    assert part is not None and part.scan is not None
    found = sheets_at(part.scan, 1e-3 * np.array([[0.0, 0.0], [3.0, 0.9], [-7.3, 5.1]]))
    up = np.array([0.0, -0.1, 1.0]) / np.hypot(0.1, 1.0)
    turned = np.arccos(np.clip(found.normals @ up, -1.0, 1.0))
    assert (turned <= found.turn + 1e-6).all() and np.degrees(found.turn).max() < 2.0


def test_shape_finer_than_the_points_tell_is_refused_and_coarser_is_not(tmp_path: Path) -> None:
    """As of a carved relief: which way its slopes lean between points is not known, however little they are off."""
    save(tmp_path / "dome.xyz", relief(1.0, 8.0, 0.2))
    with pytest.raises(
        InputError, match=r"lean \d+\.\d deg or more off the smooth surface: .* too fine for points 1\.0"
    ) as caught:
        built(tmp_path, "file: dome.xyz")
    assert caught.value.field == "part.scan.file"
    save(tmp_path / "dome.xyz", relief(1.0, 24.0, 0.6, 0.02))
    built(tmp_path, "file: dome.xyz")
