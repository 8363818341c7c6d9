"""Strategy `nlp`: the refinement of `sqp` as one sparse nonlinear program, solved by IPOPT. A slow reference.

The same splines with the same control values, the same bounds, and the same price but for peaks of the joints' speed
(`refine.calmed`). But nothing is eliminated and nothing linearised for good: besides the control values all joints,
rates, slacks and singular values are variables at every sample, and kinematics and differences are constraints with
exact first and second derivatives (`nlp_program`).
So where `sqp` stops early, or its elimination of the joints is wrong, this finds a lower price from the same start.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from planner.cell import Cell
from planner.errors import Refusal
from planner.problem.settings import ResolveSpec
from planner.readonly import Array
from planner.resolve.jointpath import JointPath, choose_turns
from planner.resolve.ladder import ladder
from planner.resolve.nlp_program import bounds_of, program_of, row_bounds, start_values
from planner.resolve.refine import evaluate
from planner.resolve.sqp import cheaper, given_prices, sigma_floor, start_track, whole
from planner.resolve.stretch import Model, Stretch, model_of
from planner.resolve.windows import Track
from planner.task import NozzleTask

MOST_SAMPLES = 1000  # of all beads: some minutes
_COMMON = {
    "print_level": 0,
    "sb": "yes",
    "bound_push": 1e-4,
    "bound_frac": 1e-4,
    "slack_bound_push": 1e-4,
    "slack_bound_frac": 1e-4,
}
# First with the convex part of the second derivatives alone, which needs no regularisation but creeps at the end;
# then, from a point that is nearly right, with all of them.
_APPROACH = {
    **_COMMON,
    "max_iter": 100,
    "mu_init": 1e-2,
    "acceptable_iter": 4,
    "acceptable_tol": 1e10,
    "acceptable_dual_inf_tol": 1e10,
    "acceptable_constr_viol_tol": 1e-5,
    "acceptable_compl_inf_tol": 3e-4,
    "acceptable_obj_change_tol": 1e-5,
}
_FINISH = {
    **_COMMON,
    "max_iter": 250,
    "mu_init": 1e-5,
    "tol": 1e-6,
    "warm_start_init_point": "yes",
    "warm_start_bound_push": 1e-8,
    "warm_start_bound_frac": 1e-8,
    "warm_start_slack_bound_push": 1e-8,
    "warm_start_slack_bound_frac": 1e-8,
    "warm_start_mult_bound_push": 1e-8,
}


@dataclass(frozen=True)
class Solution:
    """What IPOPT made of a track: the track, its steps, and what it said at the end."""

    track: Track
    steps: int
    status: str


def nlp(cell: Cell, tasks: Sequence[NozzleTask], settings: ResolveSpec) -> tuple[JointPath, ...]:
    """The ladder's paths, refined by IPOPT; for small problems, to judge `sqp` by. No path costs more than it did.

    Raises Refusal as `ladder` does, and for more samples than it can be asked to take.
    """
    count = sum(len(task) for task in tasks)
    if count > MOST_SAMPLES:
        raise Refusal(
            f"strategy nlp is a slow reference for small problems: {count} samples, at most {MOST_SAMPLES}; "
            "strategy sqp solves the same problem"
        )
    model = model_of(cell)
    paths = ladder(cell, tasks, settings)
    given = given_prices(model, paths, settings)
    floor = sigma_floor(given, settings)
    done = list(paths)
    for i in given:
        start = start_track(model, settings.knot, floor, paths[i], None)
        if np.isfinite(start.price):
            solved = solve_nlp(cell, start, floor).track
            done[i] = cheaper(cell, paths[i], given[i], solved, floor)
    return choose_turns(cell, done)


def solve_nlp(cell: Cell, track: Track, floor: float) -> Solution:
    """Refine a track; what comes back never costs more than what was given, and stays on its branch."""
    model = model_of(cell)
    stretch = whole(track.task, track.clock, track.basis, track.anchor)
    state = evaluate(model, stretch, track.c, track.q, floor)
    if state is None:
        return Solution(track, 0, "the start cannot be followed")
    program = program_of(cell, model, stretch, len(track.c))
    lbx, ubx = bounds_of(model, stretch, state, floor)
    lbg, ubg = row_bounds(stretch, program.rows, int(program.values.size1_out("g")))
    x, lam_x, lam_g = start_values(cell, model, stretch, state), np.zeros(len(lbx)), np.zeros(len(lbg))
    steps, status = 0, ""
    for exact, options in ((False, _APPROACH), (True, _FINISH)):
        solver = program.solver(exact, options)
        found = solver(x0=x, lam_x0=lam_x, lam_g0=lam_g, lbx=lbx, ubx=ubx, lbg=lbg, ubg=ubg)
        x, lam_x, lam_g = (np.asarray(found[name]).ravel() for name in ("x", "lam_x", "lam_g"))
        steps += int(solver.stats()["iter_count"])
        status = str(solver.stats()["return_status"])
        track = _cheaper(cell, model, stretch, track, x, floor)
    return Solution(track, steps, status)


def _cheaper(cell: Cell, model: Model, stretch: Stretch, track: Track, x: Array, floor: float) -> Track:
    """The track with the control values in x, if that costs less and stays on the branch."""
    c = x[len(x) - track.c.size :].reshape(track.c.shape)
    q = x[: len(x) - track.c.size].reshape(len(track.q), -1)[:, : track.q.shape[1]]
    state = evaluate(model, stretch, c, np.ascontiguousarray(q), floor)
    if state is None or state.price >= track.price:
        return track
    if (cell.inverse.branches(state.q[:, : model.arm]) != track.branch).any():
        return track
    return replace(track, c=state.c, q=state.q, price=state.price)
