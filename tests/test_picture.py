"""The picture of a plan: what is on it, and that it refuses what is no plan."""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from matplotlib.image import imread
from report_fixtures import CENTRE, HEIGHT, RADIUS, make_plan, with_dips, write_folder

from planner.base.errors import InputError
from planner.export.write import write_part
from planner.report import picture
from planner.report.picture import read_part

# ---- the picture -------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_picture_shows_the_lines_on_the_part(tmp_path: Path) -> None:
    plan = make_plan(6_000)
    write_folder(plan, tmp_path / "out")
    write_part(plan, tmp_path / "out")
    assert picture.main([str(tmp_path / "out"), str(tmp_path / "p.png")]) == 0
    image = imread(tmp_path / "p.png")[:, :, :3]
    assert image.shape[0] > 800 and image.shape[1] > 1500
    left = image[:, : image.shape[1] // 2].reshape(-1, 3)
    blue = np.array([0x2D, 0x5C, 0x9E]) / 255
    assert (np.abs(left - blue).max(axis=1) < 0.05).mean() > 0.005, "beads at the commanded speed"
    grey = (np.ptp(left, axis=1) < 0.11) & (left.mean(axis=1) > 0.6) & (left.mean(axis=1) < 0.97)
    assert grey.mean() > 0.15, "the shaded part"


@pytest.mark.slow
def test_picture_marks_dips_on_the_near_side(tmp_path: Path) -> None:
    plan = make_plan(6_000)
    dipped = with_dips(plan)
    resting = replace(dipped, dips=tuple(replace(dip, limit="stop") for dip in dipped.dips))
    pictures = []
    for name, each in (("none", plan), ("rests", resting), ("some", dipped)):
        write_folder(each, tmp_path / name)
        picture.draw_picture(tmp_path / name, tmp_path / f"{name}.png")
        pictures.append(imread(tmp_path / f"{name}.png")[:, :, :3])
    assert (pictures[0] == pictures[1]).all(), "rests that were planned are no dips"
    half = pictures[0].shape[1] // 2
    none, some = (image[:, :half] for image in pictures[::2])
    dots = (some.min(axis=2) > 0.97) & (none.max(axis=2) < 0.97)
    rims = (some.max(axis=2) < 0.1) & (none.max(axis=2) > 0.2)
    assert dots.sum() > 100 and rims.sum() > 100
    old = json.loads((tmp_path / "none" / "plan.json").read_text())
    del old["dips"]
    (tmp_path / "none" / "plan.json").write_text(json.dumps(old))
    picture.draw_picture(tmp_path / "none", tmp_path / "old.png")  # of a plan that does not tell of dips
    assert (tmp_path / "old.png").exists()


@pytest.mark.slow
def test_the_part_is_drawn_behind_its_lines(tmp_path: Path) -> None:
    plan = make_plan(6_000)
    write_folder(plan, tmp_path / "bare")
    write_folder(plan, tmp_path / "whole")
    write_part(plan, tmp_path / "whole")
    triangles = read_part(tmp_path / "whole")
    assert np.allclose(triangles.min(axis=(0, 1)), [*(CENTRE - RADIUS) * 1e3, 0.0], atol=1e-3)
    assert np.allclose(triangles.max(axis=(0, 1)), [*(CENTRE + RADIUS) * 1e3, HEIGHT * 1e3], atol=1e-3)
    pictures = []
    for name in ("bare", "whole"):
        picture.draw_picture(tmp_path / name, tmp_path / f"{name}.png")
        pictures.append(imread(tmp_path / f"{name}.png")[:, :, :3])
    half = pictures[0].shape[1] // 2
    white = [(image[:, :half] > 0.999).all(axis=2).mean() for image in pictures]
    assert white[1] < 0.75 * white[0], "a shaded body where there was paper"
    assert len(read_part(tmp_path / "bare")) == 0
    (tmp_path / "bare" / "report_part.stl").write_bytes(b"solid nothing")
    with pytest.raises(InputError, match="no triangles"):
        read_part(tmp_path / "bare")


def test_picture_refuses_what_is_not_a_plan(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert picture.main([str(tmp_path / "none"), str(tmp_path / "p.png")]) == 2
    assert "no such folder" in capsys.readouterr().err
    folder = tmp_path / "out"
    write_folder(make_plan(2_000), folder)
    table, summary = folder / "trajectory.csv", folder / "plan.json"
    whole, said = table.read_text(), summary.read_text()

    for text, pattern in (
        (
            whole.replace("speed_mm_s", "speed_mms", 1),
            r"trajectory.csv:1: speed_mm_s: no such column \(there is speed_mms",
        ),
        (whole.replace("0.004,", "zero,", 1), "not a table of numbers"),
        (whole.splitlines()[0] + "\n", "empty"),
    ):
        table.write_text(text)
        with pytest.raises(InputError, match=pattern):
            picture.draw_picture(folder, tmp_path / "p.png")
    table.write_text(whole)
    for text, pattern in (("{", "plan.json:1: not JSON"), (said.replace('"verified"', '"v"'), "verified: missing")):
        summary.write_text(text)
        with pytest.raises(InputError, match=pattern):
            picture.draw_picture(folder, tmp_path / "p.png")
    summary.unlink()
    with pytest.raises(InputError, match=r"there is no plan\.json"):
        picture.draw_picture(folder, tmp_path / "p.png")
    assert not (tmp_path / "p.png").exists()


@pytest.mark.slow
def test_picture_from_the_command_line(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "planner.report.picture", str(tmp_path / "none"), str(tmp_path / "p.png")]
    done = subprocess.run(
        command, capture_output=True, text=True, cwd=Path(__file__).resolve().parent.parent, check=False
    )
    assert done.returncode == 2 and done.stderr.startswith("error: ") and "Traceback" not in done.stderr
