"""Lengths along polylines and angles within half a turn."""

from __future__ import annotations

import numpy as np

from planner.base.geometry import arc_lengths, wrap_angle


def test_arc_lengths_add_up_from_the_first_point() -> None:
    np.testing.assert_array_equal(arc_lengths(np.array([[1.0, 1.0], [4.0, 5.0], [4.0, 6.0]])), [0.0, 5.0, 6.0])
    np.testing.assert_array_equal(arc_lengths(np.zeros((1, 3))), [0.0])


def test_angles_come_within_half_a_turn() -> None:
    angles = np.linspace(-20.0, 20.0, 401)
    wrapped = wrap_angle(angles)
    assert (wrapped >= -np.pi).all() and (wrapped < np.pi).all()
    np.testing.assert_allclose(np.exp(1j * wrapped), np.exp(1j * angles), atol=1e-12)
