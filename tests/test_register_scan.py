"""Registration from a scan: the part is found among bed, noise and stray points, and bad scans get a clear message."""

from __future__ import annotations

import io
import runpy
from contextlib import redirect_stdout
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from benchmarks.touching import misplaced
from planner.base.arrays import Array
from planner.base.errors import EXIT_INPUT, EXIT_VERIFIED, InputError
from planner.problem import load_problem
from planner.problem.yaml_file import find_problem
from planner.register.command import main
from planner.register.finding import Ask, Scene, scene_of
from planner.register.fitting import Placement
from planner.register.scans import SCANS, register_scan

PROBLEMS = find_problem("aerofoil_core_tapered").parent
STRIP = ("layers.source.size_mm=[40, 85]", "layers.count=1")
RADIUS, MIDDLE = 50e-3, np.array([0.0, 0.0, -20e-3])  # m, of the dome
MOVED = (4.0, -3.0, 1.5)  # mm


@cache
def dome() -> Scene:
    return scene_of(load_problem("hemisphere_honeycomb", ("layers.count=1",)))


def dome_scan(truth: Placement, noise: float = 5e-5, radius: float = RADIUS, seed: int = 0) -> Array:
    """Points (n, 3) [mm] in the world on the dome above the bed, and on the bed around it."""
    random = np.random.default_rng(seed)
    up = random.normal(size=(6000, 3))
    up /= np.linalg.norm(up, axis=1)[:, None]
    points = MIDDLE + (radius + random.normal(0.0, noise, 6000))[:, None] * up
    points = points[points[:, 2] > 0.0]
    stray = random.uniform(size=len(points)) < 0.05
    points[stray] += random.uniform(-20e-3, 20e-3, (int(stray.sum()), 3))
    bed = np.column_stack([random.uniform(-0.1, 0.1, (2000, 2)), random.normal(0.0, noise, 2000)])
    bed = bed[np.hypot(*bed[:, :2].T) > radius]
    T = truth.T_plate_part
    return np.asarray(1e3 * (np.vstack([points, bed]) @ T[:3, :3].T + T[:3, 3]))


def write(path: Path, points: Array) -> Path:
    np.savetxt(path, points, fmt="%.4f")
    return path


@pytest.mark.parametrize("noise", [0.0, 5e-5, 3e-4])
def test_a_displaced_dome_is_found_among_bed_and_stray_points(tmp_path: Path, noise: float) -> None:
    here, truth = dome(), misplaced(dome(), MOVED)
    found = register_scan(here, write(tmp_path / "scan.xyz", dome_scan(truth, noise)), Ask())
    middle = truth.T_plate_part @ [*MIDDLE, 1.0] - found.fit.placement.T_plate_part @ [*MIDDLE, 1.0]
    assert np.linalg.norm(middle) < 1e-6 + 0.1 * noise
    assert found.fit.noise == pytest.approx(max(noise, 1e-6), rel=0.1) or noise == 0.0
    # a ball does not show how it is turned: that stays as the problem has it
    np.testing.assert_allclose(found.fit.placement.T_plate_part[:3, :3], here.start.T_plate_part[:3, :3], atol=1e-9)
    assert found.held == ("any turn about (0.0, 0.0, -20.0) mm",)
    assert 1000 < found.fit.kept.sum() < len(found.fit.kept)


def test_a_small_part_is_found_in_a_scan_of_the_whole_table(tmp_path: Path) -> None:
    """Of every so many points of all less than 200 are near it, of those about it thousands."""
    truth, random = misplaced(dome(), MOVED), np.random.default_rng(1)
    T = truth.T_plate_part
    table = np.column_stack([random.uniform(-1.0, 1.0, (400_000, 2)), random.normal(0.0, 5e-5, 400_000)])
    table = table[np.hypot(*table[:, :2].T) > RADIUS]
    cloud = np.vstack([dome_scan(truth), 1e3 * (table @ T[:3, :3].T + T[:3, 3])])
    np.save(tmp_path / "scan.npy", random.permutation(cloud))
    found = register_scan(dome(), tmp_path / "scan.npy", Ask())
    middle = truth.T_plate_part @ [*MIDDLE, 1.0] - found.fit.placement.T_plate_part @ [*MIDDLE, 1.0]
    assert np.linalg.norm(middle) < 6e-6 and found.fit.kept.sum() > 1000


def test_endings_of_clouds_are_taken_alike(tmp_path: Path) -> None:
    points = dome_scan(misplaced(dome(), MOVED))
    np.save(tmp_path / "scan.npy", points)
    one = register_scan(dome(), tmp_path / "scan.npy", Ask())
    other = register_scan(dome(), write(tmp_path / "scan.asc", points / 1e3), Ask(), "m")
    np.testing.assert_allclose(one.fit.placement.T_plate_part, other.fit.placement.T_plate_part, atol=1e-5)


def of_one_side(points: Array, truth: Placement) -> Array:
    """What is seen of the dome from one side."""
    return points[points[:, 0] > 1e3 * truth.T_plate_part[0, 3] + 5.0]


def test_scans_that_cannot_be_used_are_told(tmp_path: Path) -> None:
    truth = misplaced(dome(), MOVED)
    points = dome_scan(truth)
    cases = (
        (points / 1e3, "a thousand times too small"),
        (points * 1e3, "a thousand times too large"),
        (points + [300.0, 0.0, 0.0], "mm from where the problem has the part"),
        (points[:100], "holds 100 points"),
        (of_one_side(points, truth), "of what lies under the print: nothing within"),
        (np.vstack([points, [[np.nan, 0.0, 0.0]]]), "not finite"),
        (dome_scan(truth, radius=62e-3), "does not lie on this part"),
    )
    for cloud, said in cases:
        with pytest.raises(InputError, match=said):
            register_scan(dome(), write(tmp_path / "scan.xyz", cloud), Ask())
    with pytest.raises(InputError, match="a thousand times too large"):
        register_scan(dome(), write(tmp_path / "scan.xyz", points), Ask(), "m")


def test_a_flat_scan_leaves_free_what_counts(tmp_path: Path) -> None:
    """A narrow band over a dome does not tell where that is along the band's axis."""
    truth = dome().start
    points = dome_scan(truth)
    band = points[np.abs(points[:, 1] - 1e3 * truth.T_plate_part[1, 3]) < 0.4]
    with pytest.raises(InputError, match=r"holds|covers|do not fix"):
        register_scan(dome(), write(tmp_path / "scan.xyz", band), Ask())


def run(*arguments: str) -> tuple[int, str]:
    stream = io.StringIO()
    with redirect_stdout(stream):
        code = main(arguments)
    return code, stream.getvalue()


@pytest.mark.slow
def test_the_command_takes_a_scan_and_writes_the_problem(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    truth = misplaced(dome(), MOVED)
    file, target = write(tmp_path / "scan.xyz", dome_scan(truth)), tmp_path / "new.yaml"
    code, said = run(
        str(file), "hemisphere_honeycomb", "--out", str(target), "--report", str(tmp_path / "fit.png")
    )  # fmt: skip
    assert code == EXIT_VERIFIED
    assert "points kept" in said and "cell.bed_mm" in said and "contact " not in said
    moved = np.asarray(load_problem(target).cell.bed) - np.asarray(dome().problem.cell.bed)
    np.testing.assert_allclose(1e3 * moved, MOVED, atol=0.01)
    assert (tmp_path / "fit.png").stat().st_size > 10_000
    bad = write(tmp_path / "bad.xyz", dome_scan(truth) / 1e3)
    assert run(str(bad), "hemisphere_honeycomb", "--out", str(tmp_path / "none.yaml"))[0] == EXIT_INPUT
    assert "a thousand times too small" in capsys.readouterr().err
    assert not (tmp_path / "none.yaml").exists()


@pytest.mark.parametrize("option", [("--published",), ("--table",), ("--ball-mm", "1")])
def test_what_a_scan_does_not_go_with_is_refused(option: tuple[str, ...], capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as caught:
        main(["scan.ply", "cylinder_logo", *option])
    assert caught.value.code == EXIT_INPUT
    assert "a scan shows the part at one angle" in capsys.readouterr().err
    with pytest.raises(SystemExit):
        main(["contacts.csv", "cylinder_logo", "--unit", "m"])
    assert SCANS[0] in capsys.readouterr().err


# The scan that ships


def test_the_scan_is_what_the_script_draws() -> None:
    script = runpy.run_path(str(PROBLEMS / "draw_scan.py"))
    assert script["TARGET"].read_bytes() == script["ply"](script["scan"](np.random.default_rng(0)))


@pytest.mark.slow
def test_the_scan_that_ships_finds_its_displacement() -> None:
    script = runpy.run_path(str(PROBLEMS / "draw_scan.py"))
    here = scene_of(load_problem("aerofoil_core_tapered", STRIP))
    found = register_scan(here, script["TARGET"], Ask())
    T = np.eye(4)
    T[:3, :3] = Rotation.from_rotvec(script["TURNED"]).as_matrix()
    T[:3, 3] = script["MOVED"] * 1e-3
    off = np.linalg.inv(here.start.T_plate_part @ T) @ found.fit.placement.T_plate_part
    assert np.linalg.norm(off[:3, 3]) < 0.01e-3
    assert np.degrees(np.linalg.norm(Rotation.from_matrix(off[:3, :3]).as_rotvec())) < 0.01
    assert found.fit.noise == pytest.approx(script["NOISE"] * 1e-3, rel=0.1)
    assert found.held == ()


@pytest.mark.slow
def test_the_scan_of_another_part_is_refused() -> None:
    here = scene_of(load_problem("aerofoil_core", ("layers.source.size_mm=[30, 99]", "layers.count=1")))
    with pytest.raises(InputError, match=r"does not lie on this part|covers"):
        register_scan(here, PROBLEMS / "aerofoil_core_tapered_scan.ply", Ask())
