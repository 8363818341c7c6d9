"""Helices on turntables: what the benchmark plans, and that more freedom refuses nothing."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from benchmarks import helices
from benchmarks.helices import Helix
from planner.planning.pipeline import solve
from planner.problem import load_problem
from planner.toolpath.build import build_toolpath


@pytest.mark.parametrize("wall", helices.SLOPES)
def test_a_helix_goes_round_its_wall(wall: str, tmp_path: Path) -> None:
    (bead,) = build_toolpath(load_problem(Helix("irb140", wall, "both", 2.0).write(tmp_path))).beads
    x, y, z = bead.points.T * 1e3
    radius = helices.CELLS["irb140"][2] - helices.SLOPES[wall] * (z - helices.FOOT)
    np.testing.assert_allclose(np.hypot(x, y), radius, atol=0.05)
    assert abs(np.unwrap(np.arctan2(y, x))[-1]) == pytest.approx(4.0 * np.pi, abs=0.02)
    assert z[-1] - z[0] == pytest.approx(2.0 * helices.PITCH, abs=0.01)
    np.testing.assert_allclose(
        bead.normals[:, 2], helices.SLOPES[wall] / np.hypot(1.0, helices.SLOPES[wall]), atol=0.02
    )


@pytest.mark.slow
def test_what_one_free_axis_prints_two_print_as_well(tmp_path: Path) -> None:
    """The search of two axes, one after the other, finds no way here that keeps the elbow clear of the table's cradle."""
    file = Helix("irb140", "cylinder", "both", 1.0).write(tmp_path)
    low = np.loadtxt(file.with_suffix(".txt"))
    low[:, 2] -= 50.0
    np.savetxt(file.with_suffix(".txt"), low, fmt="%.5f")
    assert solve(load_problem(file), baseline=False).verified


def test_the_table_tells_what_is_behind(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    ends = {"as_published": helices.Outcome("99 %", True, 0.99, 1.0), "sqp": helices.Outcome("98 %", True, 0.98, 1.0)}
    monkeypatch.setattr(helices, "outcome", lambda _, strategy: ends[strategy])
    assert helices.main(["--turns", "1", "--arms", "irb140"]) == 1
    assert "behind" in capsys.readouterr().out
    ends["sqp"] = helices.Outcome("99 %", True, 0.99, 1.0)
    assert helices.main(["--turns", "1", "--arms", "irb140"]) == 0
    with pytest.raises(SystemExit):
        helices.main(["--turns", "0"])
