"""The run over a folder of meshes: what is asked, laid, told and lost is counted apart from the planner."""

from __future__ import annotations

import csv
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest
import trimesh

from benchmarks.mesh_runs import COLUMNS, MeshJob, row_of, told_of
from benchmarks.meshes import jobs_of, lost, main, parser, summary
from planner.base.errors import InputError


def save(folder: Path) -> Path:
    trimesh.creation.icosphere(subdivisions=3, radius=1.0).export(folder / "ball.ply")
    (folder / "part.stl").write_text("solid nothing")
    return folder


def job(folder: Path, kind: str, leave_out: float = 1.0) -> MeshJob:
    return MeshJob(str(folder / "ball.ply"), "ball.ply", kind, "hemisphere_honeycomb", 30.0, leave_out, False)


@pytest.mark.slow
def test_a_ball_of_any_unit_is_laid_as_both(tmp_path: Path) -> None:
    save(tmp_path)
    for kind in ("substrate", "volume"):
        row = row_of(job(tmp_path, kind))
        assert row["verdict"] == "laid", row["reason"]
        assert set(row) == set(COLUMNS) and not lost(row)
        assert float(str(row["printed"])) > 0.8 * float(str(row["asked"]))
    strict = row_of(job(tmp_path, "volume", 0.0))
    assert strict["verdict"] == "refused" and "leave_out_share" in str(strict["reason"])


@pytest.mark.slow
def test_an_open_body_is_closed_as_its_refusal_says(tmp_path: Path) -> None:
    ball = trimesh.creation.icosphere(subdivisions=3, radius=1.0).slice_plane([0, 0, -0.7], [0, 0, 1])
    ball.export(tmp_path / "ball.ply")
    row = row_of(job(tmp_path, "volume"))
    assert row["verdict"] == "laid", row["reason"]
    assert str(row["as"]).startswith("volume, level layers, holes to 2") and not lost(row)
    assert float(str(row["asked"])) == pytest.approx(np.pi / 3 * 15e-3**3 * (1.7**2 * 1.3), rel=0.05)


def test_what_is_told_is_read_off_the_notes() -> None:
    assert told_of(
        ["a.stl: 3 layers", "layers.source: 12.50% of the length left out, 3 mm off the part"]
    ) == pytest.approx(0.125)
    assert told_of(["a: left out 1.00% of the volume: x", "a: 2.00% of the volume stays open"]) == pytest.approx(0.03)
    assert told_of(["a: left out 1.00% of the volume: x", "a: beads hold 90.0% of the volume that"]) == pytest.approx(
        0.1
    )


def test_jobs_and_summary(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="holds no meshes"):
        jobs_of(parser().parse_args([str(tmp_path)]))
    jobs = jobs_of(parser().parse_args([str(save(tmp_path)), "--toolpath"]))
    assert [(each.name, each.kind) for each in jobs] == [
        ("ball.ply", "substrate"), ("ball.ply", "volume"), ("part.stl", "substrate"), ("part.stl", "volume"),
    ]  # fmt: skip
    assert all(each == replace(each, **asdict(each)) for each in jobs)
    row = dict.fromkeys(COLUMNS) | {
        "file": "a",
        "as": "substrate",
        "verdict": "verified",
        "silent": 0.5,
        "at_speed": 1.0,
    }
    told = summary(
        [row, row | {"verdict": "refused", "reason": "x: there is a hole", "silent": None, "at_speed": None}]
    )
    assert told[0] == "substrate: 2 meshes: 1 verified, 1 refused; 1 with silent loss"
    assert "there is a hole" in told[1] and "median 100.0%" in told[2]


@pytest.mark.slow
def test_the_command_writes_a_row_for_each(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "rows.csv"
    assert main([str(save(tmp_path)), "--kind", "substrate", "--toolpath", "--size", "30", "--out", str(out)]) == 0
    with out.open() as stream:
        rows = list(csv.DictReader(stream))
    assert [row["verdict"] for row in rows] == ["laid", "refused"]
    assert "2 meshes: 1 laid, 1 refused; 0 with silent loss" in capsys.readouterr().out
