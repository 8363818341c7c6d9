"""Ideas switched off: each is what it says, comes back on, and the table tells how it was done."""

from __future__ import annotations

import importlib
from pathlib import Path

import numpy as np
import pytest

from benchmarks import ablations, ideas
from benchmarks.ideas import IDEAS, NAMES, changed, with_bends
from benchmarks.rows import Row, Run, make_row
from benchmarks.summary import results_of
from planner.base.errors import EXIT_INPUT
from planner.problem import load_problem
from planner.resolve import price_kernels as price_kernel
from planner.resolve import refine, search, terms
from planner.resolve import search as search_kernel
from planner.resolve import sqp as windows
from planner.resolve.quadratic import QuadraticProgram

ladder, sqp = (importlib.import_module(f"planner.resolve.{name}") for name in ("ladder", "sqp"))
PLACES = (
    (windows, "WINDOW"), (windows, "OVERLAP"), (sqp, "start_track"), (terms, "ANCHOR"), (refine, "PEAK"), (refine, "program_around"),
    (terms, "price_time_lost"), (price_kernel, "price_time_lost"), (price_kernel, "lost"), (ladder, "full_grid"),
    (search_kernel, "TRAVEL_PRICE"), (search_kernel, "travel_price"), (search, "search_best"),
)  # fmt: skip


def test_each_change_changes_something_and_is_taken_back() -> None:
    problem = load_problem("peer_cap")
    before = [getattr(module, name) for module, name in PLACES]
    for idea in IDEAS:
        with changed(idea.name, problem):
            here = [getattr(module, name) for module, name in PLACES]
            assert (idea.change is not None) == any(a is not b for a, b in zip(here, before, strict=True))
        assert all(getattr(m, n) is known for (m, n), known in zip(PLACES, before, strict=True))
    assert len(set(NAMES)) == len(NAMES) and all(idea.how for idea in IDEAS)


def test_compiled_loops_have_the_change_in_them() -> None:
    with changed("travel free", load_problem("peer_cap")):
        price = search_kernel.travel_price
        assert price(np.zeros(6), np.ones(6), 0.0, np.ones(7), np.ones(7), np.zeros(6, dtype=np.bool_)) == 0.0
    price = search_kernel.travel_price
    assert price(np.zeros(6), np.ones(6), 0.0, np.ones(7), np.ones(7), np.zeros(6, dtype=np.bool_)) > 0.0


def test_a_squared_price_is_that_of_the_slack_in_pieces() -> None:
    rng = np.random.default_rng(1)
    n, width = 8, 4
    lengths = np.array([2, 1, 3, 1])
    rows = int(lengths.sum())
    program = QuadraticProgram(
        np.tile([1.0, 0.0, 0.0, 0.0], (n, 1)), rng.normal(size=n), np.ones(n), rng.normal(size=(rows, width)), rng.normal(size=rows),
        np.repeat([0, 1, 3, 4], lengths), np.concatenate([[0], np.cumsum(lengths)]), np.array([1.0, 2.0, 1e3, 1.5]),
    )  # fmt: skip
    bent = with_bends(program, 100.0)
    assert (np.diff(bent.at) >= 0).all() and len(bent.price) == 3 * len(ideas._BENDS) + 1
    for _ in range(20):
        x = rng.uniform(-1.0, 1.0, n)
        over = [program.A[r] @ x[program.at[r] : program.at[r] + width] - program.b[r] for r in range(rows)]
        slack = [max(0.0, max(over[a:b])) for a, b in zip(program.group, program.group[1:], strict=False)]
        price = sum(p * (s if p > 100.0 else ideas._squared(s)) for p, s in zip(program.price, slack, strict=True))
        assert bent.value(x) == pytest.approx(0.5 * x @ x + program.g @ x + price)
    for s in ideas._KNOTS:
        assert ideas._squared(s) == pytest.approx(s * s / ideas._AS_DEAR_AT)


def test_ideas_are_asked_of_problems_that_have_them(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    runs = ablations.grid(["peer_cap", "cylinder_logo"], NAMES, (), 2, False)
    cap, logo = ({idea.name for idea, _ in runs[name]} for name in runs)
    assert logo - cap == {"table frozen", "layers start cold"} and logo == set(NAMES)
    frozen = next(own[0] for idea, own in runs["cylinder_logo"] if idea.name == "table frozen")
    assert frozen.settings[-1] == "cell.positioner.held_deg.rotation=165"
    assert [run.repeat for _, own in runs["peer_cap"] for run in own[:2]] == [0, 1] * len(cap)
    with pytest.raises(SystemExit, match="2"):
        ablations.main(["--only", "one windw"])
    assert "did you mean one window?" in capsys.readouterr().err
    assert ablations.main(["--problems", "per_cap", "--out", str(tmp_path / "a.csv")]) == EXIT_INPUT


def test_the_table_tells_how_and_what_came_of_it() -> None:
    runs = ablations.grid(["peer_cap"], ["everything on", "one window", "all to the table"], (), 1, False)
    rows: list[Row] = []
    for _, own in runs["peer_cap"]:
        plan = {"found": True, "verified": True, "sigma_min": 0.2, "at_speed_fraction": 0.99, "seconds_resolve": 2.0}
        rows += [make_row(run, **(plan if run.strategy == "sqp" else {"reason": "no plan: stuck"})) for run in own]
    lines = ablations.tables(runs, results_of(rows))
    assert "| one window | `sqp.WINDOW` without end | yes | 99.0 % | – | – | 0.200 | – | 2.00 |" in lines
    assert "| all to the table | `--strategy as_published` | no plan | – | – | – | – | – | – |" in lines
    assert Run("peer_cap", "sqp", change="one window").label == "sqp: one window"
