"""The harmonic field between two surfaces: against a field that is known, its layers, and the verifier's own solution."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from solved import solve_alone

from benchmarks.transitions import BLOCK, waved_block, write_stl
from planner.base.arrays import Array
from planner.base.errors import InputError
from planner.problem import load_problem
from planner.toolpath.bead import Toolpath
from planner.toolpath.build import build_toolpath
from planner.toolpath.volume.harmonic import departures, harmonic_departures
from planner.toolpath.volume.sections import Morph
from planner.verify.reread.harmonic import levels_off
from planner.verify.verdict import verify

GAP, HALF = 5e-3, 10e-3  # m: of the surfaces, on an average, and of the domain along x
PITCH = HALF / 30.0
COARSE = ("resolve.rung_mm=10", "resolve.roll_step_deg=30")


def level(x: Array, share: float, steep: float) -> Array:
    """Heights (n) of a level of the field z / GAP + steep sin(k x) sinh(k z) / sinh(k GAP), which is harmonic, is 0 on z = 0,
    and through whose sides at x = +-HALF nothing flows."""
    k = 0.5 * np.pi / HALF
    z = np.full_like(x, share * GAP)
    for _ in range(60):
        value = z / GAP + steep * np.sin(k * x) * np.sinh(k * z) / np.sinh(k * GAP)
        z = z - (value - share) / (1.0 / GAP + steep * k * np.sin(k * x) * np.cosh(k * z) / np.sinh(k * GAP))
    return z


@settings(max_examples=5, deadline=None)
@given(st.floats(-0.25, 0.25))
def test_levels_are_those_of_a_known_field(steep: float) -> None:
    x = np.linspace(-HALF, HALF, 61)
    upper = np.repeat(level(x, 1.0, steep)[:, None], 5, axis=1)
    factors = harmonic_departures(np.zeros_like(upper), upper, PITCH)
    for share in (0.1, 0.3, 0.5, 0.7, 0.9):
        found = share * upper + factors @ departures(np.array(share))
        np.testing.assert_allclose(
            found, np.repeat(level(x, share, steep)[:, None], 5, axis=1), atol=2e-6 * abs(steep) + 1e-10
        )


def test_between_planes_layers_share_the_height_out() -> None:
    plane = np.stack(np.meshgrid(np.linspace(0.0, 0.03, 31), np.linspace(0.0, 0.02, 21), indexing="ij"), axis=-1)
    flat = np.full(plane.shape[:2], 1e-3)
    assert np.abs(harmonic_departures(flat, flat + 4e-3, 1e-3)).max() < 1e-12


def waved(folder: Path, *changes: str) -> tuple[str, ...]:
    file = write_stl(folder / "block.stl", waved_block())
    return (f"layers.source.mesh={file}", *BLOCK, *changes)


def built(folder: Path, *changes: str) -> Toolpath:
    return build_toolpath(load_problem("saddle_ring", waved(folder, *changes)))


def stack(count: int) -> Morph:
    """Layers from z = 0 to a surface with short waves."""

    def upper(plane: Array) -> Array:
        return np.asarray(6e-3 + 0.6e-3 * np.cos(2.0 * np.pi * plane[:, 0] / 12e-3))

    low, high = np.array([-16e-3, -7e-3]), np.array([16e-3, 7e-3])
    return Morph.between(lambda p: np.zeros(len(p)), upper, 6.6e-3 / count, 0.1e-3, 6.6e-3, low, high)


@pytest.mark.slow
def test_harmonic_layers_lean_less_beneath_and_end_on_both_surfaces() -> None:
    linear = stack(12)
    harmonic = linear.harmonic()
    plane = np.random.default_rng(0).uniform([-15e-3, -6e-3], [15e-3, 6e-3], (500, 2))
    for k in (0, 12):
        np.testing.assert_allclose(harmonic.field(k).at(plane)[0], linear.field(k).at(plane)[0], atol=1e-9)
    lean = [np.arccos(each.field(6).at(plane)[1][:, 2]).max() for each in (linear, harmonic)]
    assert lean[1] < 0.6 * lean[0]
    # waves 12 mm long fade as sinh does
    waves = np.sinh(2.0 * np.pi / 12.0 * 3.0) / np.sinh(2.0 * np.pi / 12.0 * 6.0)
    assert lean[1] == pytest.approx(waves * 2.0 * np.pi * 0.6 / 12.0, rel=0.25)
    level_of = np.random.default_rng(1).uniform(0.2, 11.8, len(plane))
    points = np.column_stack([plane, harmonic.heights(plane, level_of)])
    np.testing.assert_allclose(harmonic.levels(points), level_of, atol=1e-6)
    for k in (3, 9):
        z, normals = harmonic.field(k).at(plane)
        np.testing.assert_allclose(harmonic.normals(z), normals, atol=1e-6)
        high = z[:, 2] - harmonic.field(k - 1).at(plane)[0][:, 2]
        np.testing.assert_allclose(harmonic.layer(k).at(plane)[0][:, 2], high, atol=1e-9)


@pytest.mark.slow
def test_the_verifiers_own_field_is_the_same() -> None:
    linear = stack(12)
    harmonic = linear.harmonic()
    low, high = linear.lower.span

    def surface(k: int):
        return lambda plane: linear.field(k).at(plane)[0][:, 2]

    off = levels_off(surface(0), surface(12), low, high)
    plane = np.random.default_rng(2).uniform(low + 1e-3, high - 1e-3, (400, 2))
    most = 0.0
    for k in (2, 5, 8, 11):
        even, field = (each.field(k).at(plane)[0][:, 2] for each in (linear, harmonic))
        np.testing.assert_allclose(even + off.at(plane, np.full(len(plane), k / 12.0)), field, atol=0.03e-3)
        most = max(most, float(np.abs(field - even).max()))
    assert most > 0.2e-3


@pytest.mark.slow
def test_no_layer_is_higher_or_lower_than_asked(tmp_path: Path) -> None:
    linear, harmonic = built(tmp_path), built(tmp_path, "layers.transition=harmonic")
    for toolpath in (linear, harmonic):
        along_z = np.concatenate([bead.height / bead.normals[:, 2] for bead in toolpath.beads])
        assert along_z.min() >= 0.25e-3 and along_z.max() <= 0.6e-3 * 1.03
    assert harmonic.layers > linear.layers
    with pytest.raises(
        InputError, match=r"harmonic field would be 0\.\d+ to 0\.\d+ mm high.*least_height_mm, such as 0\.4"
    ) as caught:
        built(tmp_path, "layers.transition=harmonic", "layers.least_height_mm=0.45")
    assert "layers.transition" in str(caught.value)


@pytest.mark.slow
def test_it_is_verified_and_other_layers_are_not(tmp_path: Path) -> None:
    """What was laid along one transition is told where the other is asked for."""
    plan = solve_alone(load_problem("saddle_ring", (*COARSE, *waved(tmp_path, "layers.transition=harmonic"))), "ladder")
    assert plan.verified, [check for check in plan.checks if not check.ok]
    asked = load_problem("saddle_ring", (*COARSE, *waved(tmp_path)))
    found = verify(asked, plan.cell, plan.toolpath, plan.trajectory)
    assert "layers on the part" in {check.name for check in found.checks if not check.ok}
