"""Steering of a fibre: geodesic curvature where it is known, noise and corners, and the check that bounds it."""

from __future__ import annotations

import tempfile
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from solved import body_of, solve_alone, write_small

from planner.base.arrays import Array
from planner.base.errors import InputError
from planner.plan import Plan
from planner.problem import load_problem
from planner.verify.steering import STRAIGHT, geodesic_curvature
from planner.verify.verdict import Report, verify

MM = 1e-3
SPAN = 4.8 * MM  # of a tow of 1.2 mm
UP = np.array([0.0, 0.0, 1.0])


def circle(radius: float, step: float = 0.05 * MM, angle: float = 3.0) -> Array:
    """Points (n, 3) [m] of an arc on the plane z = 0."""
    phi = np.arange(0.0, angle, step / radius)
    return radius * np.column_stack([np.cos(phi), np.sin(phi), 0.0 * phi])


def flat(points: Array) -> Array:
    return np.broadcast_to(UP, points.shape)


@pytest.mark.parametrize("radius", [8.0, 25.0, 200.0])
def test_a_circle_on_a_plane_has_its_radius(radius: float) -> None:
    points = circle(radius * MM)
    found = geodesic_curvature(points, flat(points), SPAN)
    assert found.shape == (len(points),)
    assert 1.0 / found == pytest.approx(np.full(len(points), radius * MM), rel=0.012)
    assert geodesic_curvature(points[::-1], flat(points), SPAN) == pytest.approx(-found[::-1], rel=1e-6)


@pytest.mark.parametrize("latitude", [10.0, 45.0, 70.0])
def test_a_parallel_on_a_sphere_has_the_tangent_of_its_latitude(latitude: float) -> None:
    """Of the angle from the pole the cotangent, over the sphere's radius."""
    radius, lat = 95.0 * MM, np.radians(latitude)
    phi = np.arange(0.0, 3.0, 0.05 * MM / (radius * np.cos(lat)))
    normals = np.column_stack([np.cos(lat) * np.cos(phi), np.cos(lat) * np.sin(phi), np.full(len(phi), np.sin(lat))])
    found = geodesic_curvature(radius * normals, normals, SPAN)
    assert found == pytest.approx(np.full(len(phi), np.tan(lat) / radius), rel=0.01)


def test_geodesics_are_not_steered() -> None:
    phi = np.linspace(0.0, 2.5, 4000)
    turned = np.array([[1.0, 0.0, 0.0], [0.0, 0.6, -0.8], [0.0, 0.8, 0.6]])
    normals = np.column_stack([np.cos(phi), np.sin(phi), 0.0 * phi]) @ turned.T
    assert np.abs(geodesic_curvature(95.0 * MM * normals, normals, SPAN)).max() < 1.0 / STRAIGHT, "a great circle"
    around = np.column_stack([np.cos(phi), np.sin(phi), 0.0 * phi])
    helix = 40.0 * MM * around + 15.0 * MM * phi[:, None] * UP
    assert np.abs(geodesic_curvature(helix, around, SPAN)).max() < 1.0 / STRAIGHT, "a helix on a cylinder"
    line = np.linspace(0.0, 0.1, 500)[:, None] * np.array([0.6, 0.8, 0.0])
    assert np.abs(geodesic_curvature(line, flat(line), SPAN)).max() < 1.0 / STRAIGHT


def test_noise_is_not_taken_for_steering() -> None:
    noise = np.random.default_rng(5)
    points = circle(50.0 * MM, step=0.1 * MM)
    rough = points + 0.005 * MM * noise.standard_normal(points.shape)
    tilted = flat(points) + np.radians(2.0) * noise.standard_normal(points.shape)
    tilted = tilted / np.linalg.norm(tilted, axis=1)[:, None]
    found = geodesic_curvature(rough, tilted, SPAN)
    assert 1.0 / found == pytest.approx(np.full(len(points), 50.0 * MM), rel=0.2)


def test_a_corner_counts_as_the_radius_that_turns_as_much_over_some_widths() -> None:
    """A right angle, rounded or not, is steered by some 90 degrees over the span, and nothing far from it is."""
    side = np.arange(0.0, 30.0 * MM, 0.02 * MM)[:, None]
    right, left = np.array([1.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0])
    points = np.concatenate([side * right, side[-1] * right + side[1:] * left])
    found = np.abs(geodesic_curvature(points, flat(points), SPAN))
    assert 0.3 * SPAN < 1.0 / found.max() < SPAN
    assert found[: len(side) // 2].max() < 1.0 / STRAIGHT


def test_rests_and_paths_that_are_short() -> None:
    points = circle(20.0 * MM)
    rested = np.concatenate([points[:300], np.repeat(points[300:301], 500, axis=0), points[300:]])
    found = geodesic_curvature(rested, flat(rested), SPAN)
    assert 1.0 / found == pytest.approx(np.full(len(rested), 20.0 * MM), rel=0.01)
    few = points[: round(1.5 * MM / (0.05 * MM))]
    assert 1.0 / geodesic_curvature(few, flat(few), SPAN) == pytest.approx(np.full(len(few), 20.0 * MM), rel=0.02)
    assert (geodesic_curvature(np.zeros((10, 3)), flat(np.zeros((10, 3))), SPAN) == 0.0).all()


# --- the check ---------------------------------------------------------------------------------------------

# a ring of 8 mm, wrapped on a cylinder: what is drawn on it keeps its geodesic curvature
RING = """<svg xmlns="http://www.w3.org/2000/svg" width="30mm" height="24mm" viewBox="0 0 30 24">
  <circle cx="12" cy="12" r="8"/> <path d="M0,1 L30,1"/>
</svg>
"""
FIBRE = "process.fibre={cut_length_mm: 6, least_laid_mm: 3, cut_wait_s: 1, least_radius_mm: 7}"


@cache
def laid() -> Plan:
    with tempfile.TemporaryDirectory() as folder:
        return solve_alone(load_problem(write_small(Path(folder), svg=RING), (FIBRE,)))


def report(plan: Plan, least_mm: float | None, **changes: Array) -> Report:
    """What the verifier finds with another limit, and other samples."""
    fibre = plan.problem.process.fibre
    assert fibre is not None
    other = fibre.model_copy(update={"least_radius": None if least_mm is None else least_mm * MM})
    problem = plan.problem.model_copy(update={"process": plan.problem.process.model_copy(update={"fibre": other})})
    trajectory = replace(plan.trajectory, **changes)
    return verify(problem, plan.cell, plan.toolpath, trajectory, body=body_of(plan.toolpath, plan.cell))


@pytest.mark.slow
def test_the_least_radius_is_told_and_held_against_the_limit() -> None:
    plan = laid()
    assert plan.verified
    ring = next(i for i, bead in enumerate(plan.beads) if bead.closed)
    least = plan.metrics["steering_radius_min_mm"]
    assert least == pytest.approx(8.0, rel=0.03)
    for limit, ok in ((0.99 * least, True), (1.01 * least, False)):
        (check,) = (each for each in report(plan, limit).checks if each.name == "steering radius of the fibre")
        assert (check.ok, check.worst, check.limit) == (ok, least, pytest.approx(limit))
        assert f"bead {ring}, " in check.where
    free = report(plan, None)
    assert free.metrics["steering_radius_min_mm"] == least
    assert all(each.name != "steering radius of the fibre" for each in free.checks)


@pytest.mark.slow
def test_a_tow_that_swerves_is_found() -> None:
    """A joint that swings a little along the ring: 0.2 mm aside every 3 mm."""
    plan = laid()
    t = plan.trajectory
    ring = next(i for i, bead in enumerate(plan.beads) if bead.closed)
    at = np.flatnonzero(t.bead == ring)
    q = t.q.copy()
    q[at, 0] += 0.2 * MM / 0.6 * np.sin(2.0 * np.pi * t.s[at] / (3.0 * MM))
    found = report(plan, 7.0, q=q)
    (check,) = (each for each in found.checks if each.name == "steering radius of the fibre")
    assert not check.ok and check.worst < 5.0 and f"bead {ring}, " in check.where


def test_a_bead_of_no_fibre_is_not_steered() -> None:
    with tempfile.TemporaryDirectory() as folder:
        plan = load_problem(write_small(Path(folder)))
    assert plan.process.section == "rectangle"
    with pytest.raises(InputError, match="least_radius_mm"):
        load_problem("fibre_plane", ("process.fibre.least_radius_mm=0",))
