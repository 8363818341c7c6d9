"""Style `demand`: the flow that the extruder is asked for, on an analog output, as in Pollard et al."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from planner.errors import InputError
from planner.export.moves import Moves
from planner.export.rapid.fed import laid_filament
from planner.plan.materials import filament_areas
from planner.readonly import Array

if TYPE_CHECKING:
    from planner.plan import Plan


PERCENT = 0.01  # of the largest flow: the step of the demand
DECIMALS = 4  # of the output's value


@dataclass(frozen=True)
class Demand:
    """What moves (m) ask for.

    percent  (m,) of the largest flow; 0 where no material is laid
    top      output at the largest flow, in the output's own unit
    """

    percent: NDArray[np.intp]
    top: float

    def value(self, percent: int) -> float:
        """The output at a share of the largest flow."""
        return round(self.top * PERCENT * percent, DECIMALS)


def flow(plan: Plan) -> Array:
    """Volume of filament (n - 1) [m^3/s] that the motor feeds in each sample, for beads alone."""
    t = plan.trajectory
    area = np.broadcast_to(np.asarray(filament_areas(plan.problem, t.events, t.t)), t.t.shape)
    out: Array = np.maximum(np.diff(laid_filament(t)) / t.dt * area[1:], 0.0)
    return out


def demand_of(plan: Plan, moves: Moves) -> Demand:
    """Demand of each move: its mean flow. InputError where the largest one is beyond the output's range."""
    t, program = plan.trajectory, plan.problem.program
    volume = np.concatenate([[0.0], np.cumsum(flow(plan)) * t.dt])
    a, b = moves.start, moves.sample
    mean = np.where(moves.laid, (volume[b] - volume[a]) / (t.t[b] - t.t[a]), 0.0)
    largest = float(mean.max(initial=0.0))
    top = largest * 1e9 * program.demand_scale
    if top > program.demand_most:
        asked = f"{largest * 1e9:.3g} mm3/s ask for {top:.4g}, and the output goes to {program.demand_most:g}"
        hint = f"program.demand_scale of at most {program.demand_most / (largest * 1e9):.3g}"
        raise InputError(asked, field="program.demand_scale", hint=hint, file=plan.problem.file)
    percent = np.round(mean / largest / PERCENT) if largest > 0.0 else np.zeros(len(mean))
    return Demand(percent.astype(np.intp), top)
