"""Terms of a user's own: those of the documentation, what they do to a print, and what is said of wrong ones."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from planner import OwnTerm, PathSamples, SamplePrice, check_term, load, random_samples, solve
from planner.base.arrays import Array
from planner.base.errors import InputError
from planner.base.processes import MANY
from planner.cell.cell import build_cell
from planner.planning.context import PlanningContext, context_of
from planner.resolve.joint_path import JointPath
from planner.resolve.ladder import ladder
from planner.resolve.own_terms import own_terms
from planner.resolve.refine import evaluate, expand, program_around, watched
from planner.resolve.sqp import refine_paths, start_track, whole, worth_a_copy
from planner.resolve.terms import model_of
from planner.toolpath.build import build_toolpath

PAGE = Path(__file__).parents[1] / "docs" / "own_terms.md"
JOINTS = ("joint_1", "joint_2", "joint_3")


def on_the_page(name: str) -> Callable[..., OwnTerm]:
    """A term as it stands on the page, not planned with."""
    blocks = re.findall(r"```python\n(.*?)```", PAGE.read_text(), re.DOTALL)
    (code,) = [each for each in blocks if f"class {name}" in each]
    found: dict[str, Any] = {}
    exec(code.split("plan = ")[0], found)
    made: Callable[..., OwnTerm] = found[name]
    return made


def start(name: str, *overrides: str, beads: int) -> tuple[PlanningContext, list[JointPath]]:
    problem = load(name, *overrides)
    cell = build_cell(problem)
    given = context_of(problem, cell, build_toolpath(problem))
    return given, list(ladder(cell, given.tasks, problem.resolve, given.obstacles))[:beads]


def refined(given: PlanningContext, paths: Sequence[JointPath], *terms: OwnTerm) -> tuple[JointPath, ...]:
    return refine_paths(given.cell, paths, given.problem.resolve, given.obstacles, own_terms(terms))


def test_terms_on_the_page_are_short_and_their_derivatives_right() -> None:
    for block in re.findall(r"```python\n(.*?)```", PAGE.read_text(), re.DOTALL)[:2]:
        own = block[block.index("@dataclass") : block.index("plan = ")].strip()
        assert len(own.splitlines()) <= 20
    check_term(on_the_page("KeepAway")("joint_2", 1.5, 5.0), random_samples(JOINTS))
    check_term(on_the_page("KeepSlow")("joint_3", 0.3, 0.5), random_samples(JOINTS))


def test_terms_are_never_asked_in_a_copy_of_the_process() -> None:
    cell = build_cell(load("peer_cap"))
    assert worth_a_copy(model_of(cell), MANY) and not worth_a_copy(model_of(cell), MANY - 1)
    assert not worth_a_copy(model_of(cell, terms=own_terms([Everything()])), MANY)


@pytest.mark.slow
def test_joint_5_stays_farther_from_0() -> None:
    given, paths = start("cylinder_logo", "layers.count=1", beads=8)
    term = on_the_page("KeepAway")("joint_5", room=1.5, cost=5.0)

    def least(found: Sequence[JointPath]) -> Array:
        return np.array([np.abs(path.q[:, 4]).min() for path in found])

    before, after = least(refined(given, paths)), least(refined(given, paths, term))
    assert (after > before).all()
    assert after.mean() > before.mean() + 0.1


@pytest.mark.slow
def test_the_rail_is_slower() -> None:
    given, paths = start("rail_panel", beads=5)
    term = on_the_page("KeepSlow")("rail", speed=0.08, cost=0.5)
    rail = given.cell.joint_names.index("rail")

    def fastest(found: Sequence[JointPath]) -> float:
        return max(
            float(np.abs(np.gradient(path.q[:, rail], path.task.s / path.task.speed)).max()) for path in found
        )  # fmt: skip

    before, after = fastest(refined(given, paths)), fastest(refined(given, paths, term))
    assert after < 0.95 * before


@dataclass(frozen=True)
class Everything:
    """Depends on all joints and speeds, smoothly."""

    name = "everything"

    def price(self, path: PathSamples) -> SamplePrice:
        q, qd = path.q, path.qd
        return SamplePrice(
            (1.0 + np.sin(q)).sum(axis=1) + (qd**2).sum(axis=1) * 3.0,
            np.cos(q), 6.0 * qd, np.maximum(-np.sin(q), 0.0), np.full(qd.shape, 6.0),
        )  # fmt: skip


def test_slopes_by_the_control_values_are_those_of_differences() -> None:
    given, paths = start("peer_cap", beads=1)
    model = model_of(given.cell, terms=own_terms([Everything()]))
    track = start_track(model, 2.5e-3, 0.05, paths[0], None)
    stretch = whole(track.task, track.clock, track.basis, track.anchor)
    stretch = replace(stretch, free=(np.arange(len(track.c)) % 7 != 3).astype(float))
    state = evaluate(model, stretch, track.c, track.q, 0.05)
    assert state is not None
    qp = program_around(model, stretch, state, expand(model, stretch, state), 0.1, watched(model, stretch, state, 0.1))
    typical = float(stretch.step.mean())
    rng = np.random.default_rng(1)
    for _ in range(4):
        x = np.sin(np.arange(len(state.c))[:, None] * rng.uniform(0.1, 0.6) + rng.uniform(0, 6, state.c.shape[1]))
        x *= stretch.free[:, None]
        h = 1e-4
        sides = [evaluate(model, stretch, state.c + sign * h * x, state.q, 0.05) for sign in (1.0, -1.0)]
        assert sides[0] is not None
        assert sides[1] is not None
        seen = (sides[0].price - sides[1].price) / (2 * h)
        # to what differences of five samples say of the speed of a rough move
        assert typical * float(qp.g @ x.ravel()) == pytest.approx(seen, rel=1e-2)
        curved = typical * (qp.value(h * x.ravel()) + qp.value(-h * x.ravel())) / h**2
        true = (sides[0].price + sides[1].price - 2 * state.price) / h**2
        assert curved > 0.5 * true  # of what is not convex, nothing


@dataclass(frozen=True)
class Answers:
    """Whatever it is told to answer."""

    answer: Callable[[PathSamples], Any]
    name: str = "wrong"

    def price(self, path: PathSamples) -> SamplePrice:
        answer: SamplePrice = self.answer(path)
        return answer


def ones(path: PathSamples) -> Array:
    return np.ones(len(path.q))


WRONG: dict[str, tuple[Callable[[PathSamples], Any], str]] = {
    "no answer": (lambda path: None, "NoneType"),
    "one number": (lambda path: SamplePrice(np.float64(1.0)), r"price has the shape \(\), not \("),  # type: ignore[arg-type]
    "a column lacks": (lambda path: SamplePrice(ones(path), by_q=path.q[:, 1:]), "by_q has the shape"),
    "no number": (lambda path: SamplePrice(ones(path), by_qd=path.qd * np.nan), "by_qd is not a finite number"),
    "endless": (lambda path: SamplePrice(ones(path) / 0.0), "price is not a finite number"),
    "negative": (lambda path: SamplePrice(-ones(path)), "price is negative"),
    "concave": (lambda path: SamplePrice(ones(path), curve_q=-np.ones(path.q.shape)), "curve_q is negative"),
    "another slope": (
        lambda path: SamplePrice(path.q[:, 1] ** 2, by_q=path.q * np.eye(len(path.joints))[1]),
        "by_q of joint_2 is .* differences give",
    ),
    "no slope": (lambda path: SamplePrice(path.qd[:, 0] ** 2), "by_qd of joint_1 is 0"),
}


@pytest.mark.filterwarnings("ignore:divide by zero")
@pytest.mark.parametrize("what", WRONG)
def test_a_wrong_term_is_named_with_what_is_wrong(what: str) -> None:
    answer, said = WRONG[what]
    with pytest.raises(InputError, match=said) as caught:
        check_term(Answers(answer), random_samples(JOINTS))
    assert caught.value.field == "term wrong"


def test_a_wrong_term_ends_the_plan() -> None:
    with pytest.raises(InputError, match="term wrong: by_q has the shape"):
        solve("peer_cap", terms=[Answers(WRONG["a column lacks"][0])], baseline=False)


def test_terms_that_nothing_would_ask_are_refused() -> None:
    term = on_the_page("KeepAway")("joint_5", 1.5, 5.0)
    with pytest.raises(InputError, match="strategy ladder refines nothing"):
        solve("peer_cap", strategy="ladder", terms=[term])
    with pytest.raises(InputError, match=r"terms\[1\]: 3 is not a term"):
        solve("peer_cap", terms=[term, 3])  # type: ignore[list-item]


@pytest.mark.slow
def test_a_plan_names_the_terms_that_it_was_made_with() -> None:
    term = on_the_page("KeepAway")("joint_5", 1.5, 5.0)
    plan = solve("peer_cap", terms=iter([term]), baseline=False)  # type: ignore[arg-type]
    assert plan.settings["terms"] == ["keep_away"]
    assert plan.verified
