"""The measure of layers' spacing, on lines whose spacing is known."""

from __future__ import annotations

import dataclasses

import pytest

from benchmarks.parts import spacing
from planner.problem import load_problem
from planner.toolpath.bead import Toolpath
from planner.toolpath.build import build_toolpath


@pytest.fixture(scope="module")
def dome() -> Toolpath:
    return build_toolpath(load_problem("hemisphere_honeycomb", ["layers.count=2"]))


def test_layers_on_a_dome_lie_as_far_apart_as_they_should(dome: Toolpath) -> None:
    found = spacing(dome)
    assert found is not None and found.places > 1000
    assert found.median == pytest.approx(1.0, abs=1e-4) and found.within == 1.0


def test_layers_too_far_apart_are_seen(dome: Toolpath) -> None:
    lifted = [
        dataclasses.replace(bead, points=bead.points + 3e-5 * bead.normals) if bead.layer == 1 else bead
        for bead in dome.beads
    ]
    found = spacing(Toolpath(tuple(lifted), dome.surface))
    assert found is not None and found.median == pytest.approx(1.06, abs=1e-3) and found.within == 0.0


def test_a_single_layer_has_no_spacing() -> None:
    assert spacing(build_toolpath(load_problem("hemisphere_honeycomb", ["layers.count=1"]))) is None
