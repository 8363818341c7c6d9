"""The terms of the refinement's price: each against differences of what it costs, and what their weights do."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from planner.base.errors import InputError
from planner.cell.cell import Cell, build_cell
from planner.problem import load_problem
from planner.problem.settings import WeightsSpec
from planner.resolve.cone_kernels import FACETS
from planner.resolve.joint_path import JointPath
from planner.resolve.ladder import ladder
from planner.resolve.refine import evaluate, expand, program_around
from planner.resolve.segment import ROOM, Clearances, Model, PathSegment, PathState, Term, Watch
from planner.resolve.sqp import refine_paths, start_track, whole
from planner.resolve.terms import (
    DEFAULT,
    BodyClearance,
    ConeBounds,
    Effort,
    JointLimits,
    Singularity,
    Tilt,
    TimeLost,
    TravelTerm,
    model_of,
    terms_of,
)
from planner.toolpath.build import build_toolpath
from planner.toolpath.task import tasks_of

FLOOR = 0.19  # least singular value that a part of the path lacks
Start = tuple[Model, PathSegment, PathState]


@pytest.fixture(scope="module")
def bead() -> tuple[Cell, JointPath]:
    """A bead at a speed that loses time, within cones, near the end of a joint's range."""
    problem = load_problem(
        "cylinder_logo",
        [
            "layers.count=1", "process.speed_mm_s=120", "resolve.rung_mm=10", "resolve.roll_step_deg=30",
            "process.cones={nozzle_normal_deg: 20, nozzle_gravity_deg: 80}",
            "cell.limits={joint_1: {range_deg: [-20, 40]}}",
        ],
    )  # fmt: skip
    cell = build_cell(problem)
    tasks = tasks_of(problem, build_toolpath(problem))
    (path,) = ladder(cell, [max(tasks, key=len)], problem.resolve)
    return cell, path


@pytest.fixture(scope="module")
def start_of(bead: tuple[Cell, JointPath]) -> Callable[..., Start]:
    """The bead's path, moved away from where the search put it, with the terms that are asked for alone."""

    def make(*terms: Term) -> Start:
        cell, path = bead
        model = model_of(cell, terms=terms)
        track = start_track(model, 5e-3, FLOOR, path, None)
        cones = replace(track.task.cones, tilt=0.1, nozzle_gravity=1.1)
        stretch = replace(whole(track.task, track.clock, track.basis, track.anchor), cones=cones)
        k, m = track.c.shape
        rng = np.random.default_rng(3)
        wave = np.sin(np.linspace(0.0, 3.0, k)[:, None] * rng.uniform(0.5, 2.0, m) + rng.uniform(0, 6, m))
        state = evaluate(model, stretch, track.c + 0.2 * wave, track.q, FLOOR)
        assert state is not None
        return model, stretch, state

    return make


def everything(state: PathState) -> Watch:
    return Watch(
        np.ones((*state.rates.shape, 2), dtype=np.bool_),
        np.ones((*state.lean.shape[:2], FACETS.size), dtype=np.bool_),
        np.ones((len(state.q), 6), dtype=np.bool_),
    )


@pytest.mark.slow(keep=2)
@pytest.mark.parametrize(
    "term", [TimeLost(2.0), Effort(0.7), JointLimits(3.0), Singularity(0.5), ConeBounds(), Tilt(2.0), TravelTerm(1.5)],
    ids=lambda term: term.name,
)  # fmt: skip
def test_a_term_of_the_program_is_its_price_to_first_order(term: Term, start_of: Callable[..., Start]) -> None:
    model, stretch, state = start_of(term)
    assert state.price > 0.0
    qp = program_around(model, stretch, state, expand(model, stretch, state), 0.1, everything(state))
    typical, now = float(stretch.step.mean()), qp.value(np.zeros(len(qp.g)))
    rng = np.random.default_rng(4)
    most = 0.0
    for _ in range(6):
        k = np.arange(len(state.c))[:, None]
        x = np.sin(k * rng.uniform(0.1, 1.0, state.c.shape[1]) + rng.uniform(0, 6, state.c.shape[1]))
        errors, changes = [], []
        for h in (2e-3, 2e-4, 2e-5):
            moved = evaluate(model, stretch, state.c + h * x, state.q, FLOOR)
            assert moved is not None
            change = typical * (qp.value(h * x.ravel()) - now)
            errors.append((moved.price - state.price - change) / h)
            changes.append(abs(change) / h)
        most = max(most, changes[2])
        # what the program leaves out is of second order, but for what the stencils of rates say less than exactly
        assert abs(errors[2]) < 0.25 * abs(errors[1]) + 1e-3 * changes[2] + 1e-5
    assert most > 1e-3


def test_what_clearance_lacks_falls_as_its_rows_say(start_of: Callable[..., Start]) -> None:
    """Of margins that change as their slopes say."""
    model, stretch, state = start_of(BodyClearance())
    rng = np.random.default_rng(5)
    n, m = state.sigma_slope.shape
    sample = np.sort(rng.choice(n, 40, replace=False))
    near = Clearances(np.ones(n), sample, ROOM + rng.uniform(-1e-3, 1e-3, 40), rng.normal(size=(40, m)))
    state = replace(state, near=near)
    term = BodyClearance()
    assert term.price(model, stretch, state) > 0.0
    rows = term.further(model, stretch, state, 0.1)
    assert rows is not None
    A, b, at, price = rows
    x = 1e-5 * rng.normal(size=state.c.shape)
    at_sample = np.einsum("nb,nbm->nm", stretch.B[:, 0], x[stretch.first[:, None] + np.arange(stretch.B.shape[2])])
    moved = replace(near, margin=near.margin + (near.slope * at_sample[sample]).sum(axis=1))
    over = np.einsum("rw,rw->r", A, x.ravel()[at[:, None] + np.arange(A.shape[1])]) - b
    change = price @ (np.maximum(over, 0.0) - np.maximum(-b, 0.0))
    true = term.price(model, stretch, replace(state, near=moved)) - term.price(model, stretch, state)
    assert change == pytest.approx(true, rel=1e-6)


def test_the_price_is_the_sum_of_its_terms(start_of: Callable[..., Start]) -> None:
    alone = [start_of(term)[2].price for term in DEFAULT]
    assert start_of(*DEFAULT)[2].price == pytest.approx(sum(alone), rel=1e-12)
    assert start_of()[2].price == 0.0


def test_weights_are_factors(start_of: Callable[..., Start]) -> None:
    for name in WeightsSpec.model_fields:
        weighted = [term for term in terms_of(WeightsSpec(**{name: 0.25})) if getattr(term, "weight", 1.0) != 1.0]
        assert [term.name for term in weighted] == [name]
    assert sorted(term.name for term in DEFAULT if hasattr(term, "weight")) == sorted(WeightsSpec.model_fields)
    for kind in (TimeLost, Effort, Tilt, TravelTerm):
        assert start_of(kind(3.0))[2].price == pytest.approx(3.0 * start_of(kind())[2].price, rel=1e-12)


@pytest.mark.slow
def test_weights_of_a_problem_reach_the_refinement(bead: tuple[Cell, JointPath]) -> None:
    cell, path = bead
    found = {}
    for weight in (0.1, 20.0):
        problem = load_problem("cylinder_logo", [f"resolve.weights={{tilt: {weight}}}"])
        (out,) = refine_paths(cell, [path], problem.resolve)
        found[weight] = float(np.square(out.tilt).sum())
    assert found[20.0] < 0.8 * found[0.1]


@pytest.mark.parametrize(
    ("weights", "said"),
    [
        ("{effort: -1}", "resolve.weights.effort"),
        ("{efort: 1}", "effort"),
        ("{effort: .nan}", "resolve.weights.effort"),
        ("{effort: heavy}", "resolve.weights.effort"),
        ("{cones: 2}", "cones"),
        ("3", "resolve.weights"),
    ],
)
def test_wrong_weights_are_named_with_their_line(weights: str, said: str, tmp_path: Path) -> None:
    shipped = Path(__file__).parents[1] / "problems" / "peer_cap.yaml"
    file = tmp_path / "weighted.yaml"
    text = shipped.read_text().replace("peer_cap.txt", str(shipped.with_name("peer_cap.txt")))
    text += f"\nresolve:\n  weights: {weights}\n"
    file.write_text(text)
    with pytest.raises(InputError, match=said) as caught:
        load_problem(str(file))
    assert caught.value.exit_code == 2
    assert caught.value.line == len(text.splitlines())
