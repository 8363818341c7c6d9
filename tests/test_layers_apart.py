"""Layers of a file that lie farther apart, or nearer together, than beads are high: told with the height that fits."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from test_tried import Planner

from planner.planning.pipeline import load
from planner.planning.tried import hints_that_hold
from planner.problem import Problem
from planner.toolpath.build import build_toolpath

CELL = """name: layers
cell:
  arm: irb2600
  nozzle: {tip_mm: [0, 0, 200], axis: [0, 0, 1], diameter_mm: 0.8}
  home_deg: [0, 0, 0, 0, 60, 0]
  bed_mm: [900, 0, 600]
layers: {source: {waypoints: layers.txt}}
process: {speed_mm_s: 20, travel_speed_mm_s: 200, bead: {width_mm: 0.8, height_mm: HEIGHT}}
"""


def layers(folder: Path, apart_mm: float, height_mm: float, count: int = 5, turn: Rotation | None = None) -> Problem:
    """Layers of three passes each, 20 mm long, so far apart; turned in space if wanted."""
    x = np.arange(0.0, 20.01, 0.5)
    passes = [
        np.column_stack([x, 0.0 * x + 0.8 * k, 0.0 * x + apart_mm * (i + 1), 0 * x, 0 * x, 0 * x + 1])
        for i in range(count)
        for k in range(3)
    ]
    rows = np.concatenate(passes)
    if turn is not None:
        rows = np.hstack([turn.apply(rows[:, :3]), turn.apply(rows[:, 3:])])
    np.savetxt(folder / "layers.txt", rows, fmt="%.6f")
    (folder / "layers.yaml").write_text(CELL.replace("HEIGHT", f"{height_mm:g}"))
    return load(folder / "layers.yaml")


@pytest.mark.parametrize(("apart_mm", "height_mm"), [(0.2, 0.5), (0.5, 0.2)])
def test_another_height_is_told_and_tried(tmp_path: Path, apart_mm: float, height_mm: float) -> None:
    problem = layers(tmp_path, apart_mm, height_mm)
    toolpath = build_toolpath(problem)
    (note,) = (note for note in toolpath.notes if "apart" in note)
    assert f"its layers lie {apart_mm:g} mm apart, and process.bead.height_mm is {height_mm:g}" in note
    fits = Planner(lambda p: p.process.bead.height == pytest.approx(apart_mm * 1e-3))
    told = hints_that_hold(problem, toolpath, (), fits)
    assert len(told) == 1
    assert told[0].startswith(
        f"process.bead.height_mm: {apart_mm:g} (the spacing of the file's layers) gives a verified"
    )
    assert hints_that_hold(problem, toolpath, (), Planner(lambda p: False)) == ()


@pytest.mark.slow
@settings(max_examples=8, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.floats(0.18, 1.0), st.integers(2, 4), st.integers(0, 1000))
def test_the_distance_is_found_whatever_way_layers_face(tmp_path: Path, apart_mm: float, count: int, seed: int) -> None:
    turn = Rotation.random(random_state=seed)
    for share in (0.4, 2.5):
        toolpath = build_toolpath(layers(tmp_path, apart_mm, round(share * apart_mm, 3), count, turn))
        assert any(f"its layers lie {apart_mm:.2g} mm apart" in note for note in toolpath.notes)
    toolpath = build_toolpath(layers(tmp_path, apart_mm, round(1.3 * apart_mm, 3), count, turn))
    assert not any("apart" in note for note in toolpath.notes)


def test_a_single_layer_has_no_distance(tmp_path: Path) -> None:
    assert not any("apart" in note for note in build_toolpath(layers(tmp_path, 0.2, 0.5, count=1)).notes)


@pytest.mark.parametrize("name", ["peer_cap", "peer_cylinder"])
def test_files_that_fit_get_no_note(name: str) -> None:
    assert not any(" apart, and" in note for note in build_toolpath(load(name)).notes)
