"""The problems that ship: all of them verified, and the ladder better than every baseline on the logo."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pytest
from export_fixtures import executed_beads
from scipy.spatial import cKDTree
from solved import promises_kept, solve_alone

from planner.base.arrays import Array
from planner.base.errors import Refusal
from planner.export.rapid.reader import read_rapid
from planner.export.rapid.writer import rapid
from planner.export.readback import compare
from planner.plan import Plan
from planner.problem import load_problem, shipped_problems

UNIVERSITY = Path(__file__).resolve().parents[2] / "shared" / "data" / "bristol" / "uob_logo.svg"
COARSE = ("resolve.rung_mm=10", "resolve.roll_step_deg=30", "resolve.table_step_deg=30")
OTHERS = ("as_published", "fixed", "greedy")
WHOLE = ("fibre_bowl", "fibre_corrugated", "fibre_plane")  # test_fibre solves these as they are, and asks for the same

LOGOS = {
    "ours": (),
    "university": (f"layers.source.svg={UNIVERSITY}",),
}


@pytest.fixture(
    scope="module",
    params=[
        "ours",
        pytest.param(
            "university",
            marks=pytest.mark.skipif(not UNIVERSITY.exists(), reason="the authors' logo is not part of the project"),
        ),
    ],
)
def logo(request: pytest.FixtureRequest) -> str:
    """One layer of a logo on the cylinder, by its key in LOGOS."""
    return str(request.param)


@cache
def solved(logo: str, strategy: str) -> Plan:
    """A logo's first layer with a strategy, default settings. Refusal where it has no plan."""
    problem = load_problem("cylinder_logo", ("layers.count=1", *LOGOS[logo]))
    return solve_alone(problem, strategy)


# Less of the problems that are large.
THICK = (
    "layers.height_mm=1.5",
    "process.bead.width_mm=1.6",
    "layers.source.size_mm=[17, 80]",
    "layers.source.cell_mm=9.5",
)
WING = (
    "layers.source.span_mm=4",
    "layers.height_mm=1",
    "process.bead.width_mm=1",
    "layers.support.height_mm=2",
    "layers.support.curved=1",
)
SMALL = {
    "aerofoil_core": THICK,
    "aerofoil_core_tapered": (*THICK, "layers.least_height_mm=0.3"),
    "curved_plate": ("layers.source.spacing_mm=50",),
    "propeller_blade": ("layers.source.spacing_mm=30",),
    "shoehorn": ("layers.source.spacing_mm=20",),
    "cylinder_logo": ("layers.count=1",),
    "ceiling_logo": ("layers.count=1",),
    "hemisphere_logo": ("layers.count=1",),
    "saddle_ring": ("layers.infill.density=0.1",),
    "naca0015_wing": WING,
    "naca0015_wing_tapered": (*WING, "layers.source.tip={chord_mm: 76, sweep_mm: 1.5}"),
}


@pytest.mark.slow(keep=("peer_cap", "cylinder_logo"))
@pytest.mark.parametrize("name", sorted(set(shipped_problems()) - set(WHOLE)))
def test_shipped_problem_is_solved_and_verified(name: str) -> None:
    plan = solve_alone(load_problem(name, (*COARSE, *SMALL.get(name, ()))), "ladder")
    promises_kept(plan)
    assert plan.problem.name == name
    assert plan.metrics["deposited_length_mm"] > 100.0


@pytest.mark.slow
def test_ladder_keeps_the_promises(logo: str) -> None:
    plan = solved(logo, "ladder")
    promises_kept(plan)
    m = plan.metrics
    assert m["at_speed_fraction"] >= 0.75
    assert m["deposition_time_s"] <= 1.15 * m["ideal_deposition_time_s"]


@pytest.mark.slow
@pytest.mark.parametrize("other", OTHERS)
def test_ladder_beats(logo: str, other: str) -> None:
    ladder = solved(logo, "ladder").metrics
    try:
        beaten = solved(logo, other).metrics
    except Refusal as refusal:
        assert str(refusal)  # no plan at all counts as beaten
        return
    assert ladder["at_speed_fraction"] > beaten["at_speed_fraction"]
    assert ladder["deposition_time_s"] < beaten["deposition_time_s"]


@pytest.mark.slow
@pytest.mark.parametrize("other", OTHERS)
def test_no_strategy_is_refused_on_a_logo(logo: str, other: str) -> None:
    """If this fails, test_ladder_beats compares with nothing: say so wherever the comparison is shown."""
    assert solved(logo, other).metrics["beads"] == solved(logo, "ladder").metrics["beads"]


@pytest.mark.slow
def test_ladder_keeps_at_least_the_singularity_margin_of_fixed(logo: str) -> None:
    assert solved(logo, "ladder").metrics["sigma_min"] >= solved(logo, "fixed").metrics["sigma_min"]


@pytest.mark.slow
def test_rapid_program_replays_the_plan(logo: str) -> None:
    """Read back and run through: the same beads on the same path, both ways, within 0.1 mm, their ends within 0.05 mm."""
    plan = solved(logo, "ladder")
    program = read_rapid(rapid(plan))
    agreement = compare(plan, program)
    widest = plan.problem.program.widening * plan.problem.program.chord
    assert agreement.path <= widest == 0.1e-3
    assert agreement.conf == 0
    assert agreement.differences() == []

    beads = executed_beads(program, step=0.02e-3)
    assert len(beads) == len(plan.toolpath.beads)
    trajectory = plan.trajectory
    for i, (position, *_) in enumerate(beads):
        planned = dense(trajectory.tip[trajectory.bead == i])
        assert cKDTree(planned).query(position)[0].max() <= widest + 0.01e-3
        assert cKDTree(position).query(planned)[0].max() <= widest + 0.01e-3
        for end in (0, -1):
            assert np.linalg.norm(planned[end] - position[end]) <= 0.05e-3


def dense(points: Array) -> Array:
    """The same polyline, twenty points on each of its segments: some 10 um apart."""
    at = np.arange(len(points), dtype=float)
    finer = np.linspace(0.0, len(points) - 1.0, 20 * (len(points) - 1) + 1)
    return np.column_stack([np.interp(finer, at, points[:, k]) for k in range(3)])
