"""The command that writes figures of plans into the problems' pages changes these and nothing else."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import pytest

from benchmarks import problem_pages

PAGES = Path(__file__).parent.parent / "docs" / "problems"
METRICS = {
    "beads": 1, "layers": 2, "deposited_length_mm": 1234.5, "waypoints": 1019, "extruded_volume_mm3": 300.0,
    "at_speed_fraction": 0.9876, "speed_min_mm_s": 28.44, "deposition_time_s": 26.0, "ideal_deposition_time_s": 25.0,
    "print_time_s": 1030.4, "sigma_min": 0.1789, "joint_limit_margin_deg": 6.12, "wrist_margin_deg": None,
    "clearance_min_mm": 7.94, "position_error_max_mm": 0.0002, "axis_error_max_deg": 0.0123,
}  # fmt: skip
PLAN: dict[str, Any] = {
    "problem": "peer_cap", "strategy": "sqp", "verified": True, "checks": [{"ok": True}] * 3, "metrics": METRICS,
    "baseline": {"as_published": {**METRICS, "speed_min_mm_s": 1.0}},
    "dips": [
        {"lost_s": 3.0, "joint": "", "limit": "stop"},
        {"lost_s": 0.0162, "joint": "joint_4", "limit": "jerk"},
        {"lost_s": 0.001, "joint": "joint_1", "limit": "velocity"},
    ],
}  # fmt: skip


@pytest.fixture
def pages(tmp_path: Path) -> Path:
    for name in ("peer_cap", "index"):
        shutil.copy(PAGES / f"{name}.md", tmp_path)
    (tmp_path / "peer_cap").mkdir()
    (tmp_path / "peer_cap" / "plan.json").write_text(json.dumps(PLAN), encoding="utf-8")
    return tmp_path


def run(pages: Path) -> None:
    problem_pages.main(["peer_cap", "--out", str(pages), "--pages", str(pages)])


def test_figures_are_written_between_the_marks_and_nowhere_else(pages: Path) -> None:
    before = (pages / "peer_cap.md").read_text(encoding="utf-8")
    run(pages)
    after = (pages / "peer_cap.md").read_text(encoding="utf-8")
    marks = "<!-- figures: peer_cap -->", problem_pages.END
    assert before.split(marks[0])[0] == after.split(marks[0])[0]
    assert before.split(marks[1])[1] == after.split(marks[1])[1]
    told = after.split(marks[0])[1].split(marks[1])[0]
    assert "1 bead in 2 layers, 1.23 m" in told
    assert "| slowest while material is laid, mm/s | 28.4 | 1.0 |" in told
    assert "| least distance from the wrist's flip, ° | – | – |" in told
    assert "| tip off its line at most, mm | below 0.001 | below 0.001 |" in told
    assert "The speed dips 2 times; the costliest dip takes 16 ms (joint_4, jerk). It stops once" in told


def test_the_row_keeps_what_is_not_measured_here(pages: Path) -> None:
    rows = (pages / "index.md").read_text(encoding="utf-8").splitlines()
    run(pages)
    new = (pages / "index.md").read_text(encoding="utf-8").splitlines()
    changed = [(a, b) for a, b in zip(rows, new, strict=True) if a != b]
    assert len(changed) == 1
    old_cells, cells = ([cell.strip() for cell in line.split("|")] for line in changed[0])
    assert cells[3:] == ["1, 2", "1.2", old_cells[5], "98.8 %", "1,030", ""]
    assert cells[:3] == old_cells[:3]


def test_writing_twice_changes_nothing(pages: Path) -> None:
    run(pages)
    once = [(pages / f"{name}.md").read_bytes() for name in ("peer_cap", "index")]
    run(pages)
    assert once == [(pages / f"{name}.md").read_bytes() for name in ("peer_cap", "index")]


def test_a_page_without_marks_is_refused(pages: Path) -> None:
    (pages / "peer_cap.md").write_text("# peer_cap\n", encoding="utf-8")
    with pytest.raises(SystemExit, match="no lines"):
        run(pages)
    assert (pages / "peer_cap.md").read_text(encoding="utf-8") == "# peer_cap\n"
