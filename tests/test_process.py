"""Around a bead: run-in and run-out on every curve, ramps, and the place where fibre is cut."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from planner.base.arrays import Array
from planner.base.errors import InputError
from planner.problem import Problem, load_problem
from planner.problem.process import FibreSpec
from planner.toolpath.bead import Bead, Toolpath
from planner.toolpath.build import build_toolpath
from planner.toolpath.plane_paths import PlaneCurve
from planner.toolpath.runs import BeadRun, cut_place, with_runs
from planner.toolpath.task import NozzleTask, Stop, make_tasks, roll_zeros, tasks_of
from planner.toolpath.wrapped import Cylinder, wrap_layer

MM = 1e-3
RUN = 3.0 * MM
HEIGHT = 0.5 * MM
CYLINDER = Cylinder(0.034, 0.1, np.array([0.0314, 0.037]))
RAMP = np.radians(30.0)


def on_cylinder(plane: Array) -> Bead:
    curve = PlaneCurve("curve", plane, plane, closed=False)
    return wrap_layer([curve], CYLINDER, 0, HEIGHT, 0.6 * MM, HEIGHT)[0]


def bead_of(points: Array, normals: Array, closed: bool = False) -> Bead:
    """A bead of one's own, however coarse."""
    s = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    return Bead("own", 0, s, points, normals, roll_zeros([normals])[0], points, 0.6 * MM, HEIGHT, closed)


def ends_of(bead: Bead, run: BeadRun) -> list[tuple[Array, Array, Array, Array]]:
    """For both ends: points (m, 3) from the bead's end outward, normals there, arc length, and the bead's (k, 3)."""
    out = []
    for walk, inner in ((slice(run.first, None, -1), bead.points), (slice(run.last, None), bead.points[::-1])):
        out.append((run.points[walk], run.normals[walk], np.abs(run.s[walk] - run.s[walk][0]), inner))
    return out


@st.composite
def smooth_curves(draw: st.DrawFn) -> Bead:
    """A bead on the cylinder whose direction and spacing change smoothly; radii of 2 mm and more."""
    number = st.floats(-1.0, 1.0)
    n = draw(st.integers(120, 300))
    step = draw(st.floats(0.05, 0.12)) * MM
    u = np.linspace(0.0, 1.0, n)
    stretch = 1.0 + 0.5 * draw(number) * np.cos(np.pi * u + 3.0 * draw(number))
    arc = np.concatenate([[0.0], np.cumsum(0.5 * (stretch[1:] + stretch[:-1]))]) * step
    wave = draw(st.floats(2.0, 10.0)) * MM
    turn = draw(number) * 500.0 * arc
    swing = draw(number) * min(1.0, 250.0 * wave) * np.sin(arc / wave + 3.0 * draw(number))
    heading = np.pi * draw(number) + 0.5 * turn + swing
    mid = 0.5 * (heading[1:] + heading[:-1])
    chord = np.diff(arc)[:, None] * np.column_stack([np.cos(mid), np.sin(mid)])
    return on_cylinder(np.concatenate([np.zeros((1, 2)), np.cumsum(chord, axis=0)]))


ramps = st.one_of(st.none(), st.floats(np.radians(5.0), np.radians(60.0)))


@given(smooth_curves(), ramps)
@settings(max_examples=60)
def test_runs_join_without_a_step_in_the_second_derivative(bead: Bead, ramp: float | None) -> None:
    """A step would be a spike in the third differences across the joint, beyond those on both sides of it."""
    run = with_runs(bead, RUN, ramp)
    for rows in (run.points / (0.1 * MM), run.normals, run.roll_zero):
        third = np.linalg.norm(np.diff(rows, 3, axis=0), axis=1)  # third[i] spans samples i to i + 3
        for joint in (run.first, run.last):
            across = third[joint - 2 : joint]
            beside = np.concatenate([third[joint - 11 : joint - 2], third[joint : joint + 9]])
            assert across.max() <= 1.6 * beside.max() + 1e-6


@given(smooth_curves(), st.floats(5.0, 60.0), st.floats(2.0, 12.0))
@settings(max_examples=60)
def test_a_ramp_is_straight_at_its_angle_to_the_surface(bead: Bead, degrees: float, length: float) -> None:
    run = with_runs(bead, length * MM, np.radians(degrees))
    for points, _, arc, inner in ends_of(bead, run):
        up = CYLINDER.normals(inner[:1])[0]
        assert length * MM * (1.0 - 1e-9) <= arc[-1] <= length * MM + 1.5 * np.diff(arc)[-1]
        far = arc >= 0.55 * arc[-1]
        direction = np.diff(points[far], axis=0)
        direction /= np.linalg.norm(direction, axis=1)[:, None]
        angle = np.degrees(np.arcsin(direction @ up))
        np.testing.assert_allclose(angle, degrees, rtol=0, atol=0.5)
        assert np.degrees(np.arccos(np.clip(direction @ direction[-1], -1.0, 1.0))).max() < 0.1, "straight"


@given(smooth_curves(), ramps)
@settings(max_examples=60)
def test_runs_never_go_below_the_surface(bead: Bead, ramp: float | None) -> None:
    run = with_runs(bead, RUN, ramp)
    for points, _, _, _ in ends_of(bead, run):
        height = CYLINDER.signed_distance(points) - HEIGHT
        assert height.min() > -1e-9
        assert (np.diff(height) > -1e-9).all()
        assert height[-1] > 0.05 * RUN


@st.composite
def coarse_beads(draw: st.DrawFn) -> Bead:
    """Loops and lines of few samples, with noise; normals that turn by anything, but not along the bead."""
    n = draw(st.integers(2, 16))
    size = draw(st.floats(0.02, 5.0)) * MM
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    turns = draw(st.sampled_from([0.0, 0.5, 1.0, 2.0]))
    along = np.linspace(0.0, 1.0, n) if draw(st.booleans()) else np.cumsum(rng.uniform(0.02, 1.0, n)) / n
    angle = 2.0 * np.pi * turns * along
    shape = np.column_stack([np.cos(angle), np.sin(angle), 0.3 * along]) if turns else np.outer(along, [1.0, 0.4, 0.1])
    points = size * (shape + draw(st.sampled_from([0.0, 1e-6, 1e-2, 0.2])) * rng.normal(size=(n, 3)))
    normals = np.array([0.0, 0.0, 1.0]) + draw(st.sampled_from([0.0, 0.1, 0.4])) * rng.normal(size=(n, 3))
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    step = np.diff(points, axis=0)
    length = np.linalg.norm(step, axis=1)
    assume(length.min() > 1e-6)
    for i in (0, -1):
        assume(abs(step[i] @ normals[i]) < 0.5 * length[i])
    return bead_of(points, normals)


@pytest.mark.slow
@given(coarse_beads(), ramps)
@settings(max_examples=300)
def test_runs_of_coarse_and_rough_beads_keep_their_shape(bead: Bead, ramp: float | None) -> None:
    run = with_runs(bead, RUN, ramp)
    for rows in (run.points, run.normals, run.roll_zero, run.s):
        assert np.isfinite(rows).all()
    assert (np.diff(run.s) > 0.0).all()
    np.testing.assert_allclose(np.linalg.norm(run.normals, axis=1), 1.0, rtol=0, atol=1e-12)
    np.testing.assert_allclose((run.normals * run.roll_zero).sum(axis=1), 0.0, rtol=0, atol=1e-12)
    for points, normals, arc, inner in ends_of(bead, run):
        steps, near = np.diff(arc), float(np.linalg.norm(inner[1] - inner[0]))
        asked = max(RUN, 8.0 * near)
        assert 0.9 * asked < arc[-1] < 1.8 * asked + steps[-1]
        assert 0.4 < steps[0] / near < 2.5
        assert ((steps[1:] / steps[:-1] > 0.4) & (steps[1:] / steps[:-1] < 2.5)).all()
        along = np.diff(points, axis=0) / steps[:, None]
        assert (along[1:] * along[:-1]).sum(axis=1).min() > 0.0, "it never folds back"
        straight = along[int(0.75 * len(along)) :]
        assert straight.shape[0] > 0
        assert (straight @ normals[0]).min() > np.sin(np.radians(4.0)), "it rises"
        assert np.arccos(np.clip(normals @ normals[0], -1.0, 1.0)).max() < 1.7, "the nozzle does not turn over"
        assert len(arc) < 2000


def test_a_coarse_ring_goes_on_as_the_ring() -> None:
    """Eight samples a turn are too coarse for a polynomial; the arc through three of them is exact."""
    angle = np.linspace(0.0, 2.0 * np.pi, 9)
    ring = 0.3 * MM * np.column_stack([np.cos(angle), np.sin(angle), 0.0 * angle])
    run = with_runs(bead_of(ring, np.tile([0.0, 0.0, 1.0], (9, 1)), closed=True), RUN)
    for points, _, _, _ in ends_of(bead_of(ring, np.tile([0.0, 0.0, 1.0], (9, 1))), run):
        first = points[1] - points[0]
        outward = np.array([1.0, 0.0, 0.0])
        assert abs(first @ outward) < np.sin(np.radians(25.0)) * np.linalg.norm(first), "off along the tangent"
        assert first @ outward < 0.0, "bent inward as the ring is"


def test_a_run_is_as_long_as_asked_where_samples_draw_together() -> None:
    """On the logo a run of 3 mm was 2.2 or 5.9 mm long where the samples' distance changes at its end."""
    x = np.linspace(0.0, 1.0, 200)
    for warp in (1.0, -1.0):
        plane = np.column_stack([20.0 * MM * (x + warp * 0.12 * np.sin(2 * np.pi * x)), 0.0 * x])
        run = with_runs(on_cylinder(plane), RUN)
        for length in (-run.s[0], run.s[-1] - run.s[run.last]):
            assert RUN <= length < 1.3 * RUN


def test_a_bead_of_close_samples_has_runs_of_no_more_than_some_hundreds() -> None:
    points = np.column_stack([np.arange(200) * 1e-9, np.zeros(200), np.zeros(200)])
    run = with_runs(bead_of(points, np.tile([0.0, 0.0, 1.0], (200, 1))), RUN)
    assert run.s[-1] - run.s[run.last] >= RUN
    assert len(run.s) < 200 + 2 * 1000
    steps = np.diff(run.s)
    assert (steps[1:] / steps[:-1]).max() < 1.3


# --- fibre ------------------------------------------------------------------------------------------------------

FIBRE = FibreSpec(cut_length_mm=12.0, cut_wait_s=2.0)


def straight(length: float) -> Bead:
    return on_cylinder(np.column_stack([np.zeros(101), np.linspace(0.0, length, 101)]))


@given(st.floats(17.001, 60.0))
@settings(max_examples=30)
def test_fibre_is_cut_so_that_it_ends_where_the_bead_ends(millimetres: float) -> None:
    bead = straight(millimetres * MM)
    (task,) = make_tasks(Toolpath((bead,), CYLINDER), 0.04, RUN, fibre=FIBRE)
    (stop,) = task.stops
    assert (stop.kind, stop.wait) == ("cut", 2.0)
    assert bead.length - stop.s == pytest.approx(12.0 * MM, abs=1e-12)
    assert task.s[task.first] < stop.s < task.s[task.last]


def test_without_fibre_nothing_stops(tasks: tuple[NozzleTask, ...]) -> None:
    assert all(task.stops == () for task in tasks)


def test_a_bead_is_long_enough_at_the_least_length_and_not_below() -> None:
    assert FIBRE.least_length == pytest.approx(17.0 * MM)
    assert cut_place(straight(17.0 * MM + 1e-9), FIBRE) == pytest.approx(5.0 * MM)
    with pytest.raises(InputError):
        cut_place(straight(17.0 * MM - 1e-6), FIBRE)


def test_a_bead_too_short_for_fibre_is_refused_with_its_length_and_the_least(drawing_problem: Problem) -> None:
    file = drawing_problem.file
    svg = drawing_problem.layers.source.svg  # type: ignore[union-attr]
    changes = [f"layers.source.svg={svg}", "layers.count=1", "layers.source.width_mm=40"]
    problem = load_problem(file, [*changes, "process.fibre={cut_length_mm: 50}"])
    beads = build_toolpath(problem).beads
    short = min(beads, key=lambda bead: bead.length)
    assert sum(bead.length < 55.0 * MM for bead in beads) > 1, "the shortest of several"
    with pytest.raises(InputError) as caught:
        tasks_of(problem, build_toolpath(problem))
    error = caught.value
    assert error.field == "--set process.fibre: process.fibre.cut_length_mm"
    assert f"path {short.name!r} in layer 1 is {short.length * 1e3:.2f} mm long" in error.reason
    assert "at least 55 mm" in (error.hint or "")
    assert "5 laid before the cut (least_laid_mm), 50 after it (cut_length_mm)" in (error.hint or "")


def test_tasks_of_a_problem_have_its_ramp_and_its_stops(drawing_problem: Problem) -> None:
    svg = drawing_problem.layers.source.svg  # type: ignore[union-attr]
    changes = [f"layers.source.svg={svg}", "layers.count=1", "layers.source.width_mm=40"]
    fibre = load_problem(drawing_problem.file, [*changes, "process.fibre={cut_length_mm: 10, cut_wait_s: 1.5}"])
    plain = load_problem(drawing_problem.file, changes)
    toolpath = build_toolpath(plain)
    for bead, task, usual in zip(toolpath.beads, tasks_of(fibre, toolpath), tasks_of(plain, toolpath), strict=True):
        assert task.stops == (Stop(bead.length - 10.0 * MM, 1.5, "cut"),)
        assert usual.stops == ()
        np.testing.assert_array_equal(task.tip, with_runs(bead, RUN, RAMP).points)
        np.testing.assert_array_equal(usual.tip, with_runs(bead, RUN).points)
