"""The terms of a path's price, one object each: the price of a path is their sum, in seconds.

Sums run over samples; `step` is the time that a sample stands for at the commanded speed [s]. The prices, and where
they begin, are in `prices`; a weight is a factor on such a price. Bounds (ends of ranges, least singular value, cones,
clearance) have no weight: exceeding one costs more than all else, and a path that does so is rejected in the end.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from planner.base.arrays import Array, Flags, Ints
from planner.cell.cell import Cell
from planner.collision.scene import NOTHING, Obstacles
from planner.problem.settings import WeightsSpec
from planner.resolve.cone_kernels import watch_leans, watch_missed_leans
from planner.resolve.follow import HolderNumbers
from planner.resolve.price_kernels import (
    NEAR_SIGMA,
    RowPlaces,
    RowsFilled,
    SplineSamples,
    count_rows,
    expand_effort,
    expand_joint_limits,
    expand_singularity,
    expand_tilt,
    price_effort,
    price_joint_limits,
    price_singularity,
    price_time_lost,
    rows_of_cones,
    rows_of_ends,
    rows_of_rates,
    rows_of_sigma,
    watch_missed,
    watch_missed_ends,
    watch_near,
    watch_near_ends,
)
from planner.resolve.prices import ANCHOR, HARD_PRICE, TILT_PRICE
from planner.resolve.reach import arm_numbers
from planner.resolve.segment import (
    HOLDER,
    Expansion,
    Model,
    PathSegment,
    PathState,
    Rows,
    Step,
    Term,
    Watch,
    clearance_rows,
    shortage,
)


@dataclass(frozen=True)
class TimeLost(Term):
    """sum step * (slack + DIP_PRICE slack / (slack + DIP)) where material is laid down: the time lost, and each dip.

    Its rows bound all rates of a sample by what its slack allows, so they share one slack, priced by the tangent.
    """

    weight: float = 1.0
    name = "time_lost"

    def price(self, model: Model, stretch: PathSegment, state: PathState) -> float:
        return self.weight * price_time_lost(stretch.step, stretch.deposits, state.slack)

    def watch(self, model: Model, stretch: PathSegment, state: PathState, trust: float, watch: Watch) -> None:
        watch_near(state.rates, model.limits, stretch.deposits, state.slack, watch.rates)

    def missed(
        self, model: Model, stretch: PathSegment, state: PathState, around: Expansion, step: Step, watch: Watch
    ) -> int:
        return watch_missed(
            state.rates, model.limits, stretch.deposits, state.slack, around.slopes,
            stretch.first * state.c.shape[1], step.x, watch.rates,
        )  # fmt: skip

    def count(self, stretch: PathSegment, state: PathState, watch: Watch) -> tuple[Ints, Ints]:
        return count_rows(stretch.step * stretch.deposits, watch.rates.reshape(len(watch.rates), 1, -1))

    def fill(
        self, model: Model, stretch: PathSegment, state: PathState, around: Expansion, watch: Watch,
        places: RowPlaces, rows: RowsFilled,
    ) -> None:  # fmt: skip
        rows_of_rates(
            self.weight, model.limits, samples_of(stretch), state.rates, state.slack, around.slopes, watch.rates,
            places, rows,
        )  # fmt: skip


@dataclass(frozen=True)
class Effort(Term):
    """sum step * mean over joints of EFFORT r^2 / (1 + r^2), for speed, acceleration and jerk as shares r of their
    limits: of two choices the calmer one wins, even at full speed.

    In a window without a dip there is also PEAK_PRICE (speed / peak)^8: where no time can be won, peaks are lowered.
    """

    weight: float = 1.0
    name = "effort"

    def price(self, model: Model, stretch: PathSegment, state: PathState) -> float:
        return self.weight * price_effort(state.rates, model.limits, stretch.step, stretch.peak)

    def expand(self, model: Model, stretch: PathSegment, state: PathState, around: Expansion) -> None:
        expand_effort(
            self.weight, model.limits, samples_of(stretch), state.rates, stretch.peak, around.slopes, around.H, around.g
        )


@dataclass(frozen=True)
class JointLimits(Term):
    """sum step * LIMIT_PRICE max(0, 1 - room / LIMIT_COMFORT)^2 over the arm's joints; room [rad] to the nearer end.

    Beyond the end, HARD_PRICE per radian. Chosen joints have hard bounds only, on their control values: a B-spline
    stays within the hull of these.
    """

    weight: float = 1.0
    name = "joint_limits"

    def price(self, model: Model, stretch: PathSegment, state: PathState) -> float:
        return price_joint_limits(self.weight, stretch.step, state.q, *model.arm_range)

    def expand(self, model: Model, stretch: PathSegment, state: PathState, around: Expansion) -> None:
        expand_joint_limits(
            self.weight, samples_of(stretch), state.q, state.G, *model.arm_range, around.H, around.g
        )  # fmt: skip

    def watch(self, model: Model, stretch: PathSegment, state: PathState, trust: float, watch: Watch) -> None:
        watch_near_ends(state.q, state.G, *model.arm_range, stretch.step, trust, watch.ends)

    def missed(
        self, model: Model, stretch: PathSegment, state: PathState, around: Expansion, step: Step, watch: Watch
    ) -> int:
        return watch_missed_ends(state.q, step.q, *model.arm_range, stretch.step, watch.ends)

    def count(self, stretch: PathSegment, state: PathState, watch: Watch) -> tuple[Ints, Ints]:
        return count_rows(stretch.step, watch.ends[:, :, None])

    def fill(
        self, model: Model, stretch: PathSegment, state: PathState, around: Expansion, watch: Watch,
        places: RowPlaces, rows: RowsFilled,
    ) -> None:  # fmt: skip
        rows_of_ends(samples_of(stretch), state.q, state.G, *model.arm_range, watch.ends, places, rows)

    def further(self, model: Model, stretch: PathSegment, state: PathState, trust: float) -> Rows:
        k, m = state.c.shape
        width = stretch.B.shape[2] * m
        active = list(model.active(stretch.cones))
        rows: list[tuple[Array, Array]] = []
        chosen = [*range(model.arm, len(model.low)), *model.given]
        for h, joint in enumerate(chosen):
            for sign, end in ((1.0, model.high[joint]), (-1.0, -model.low[joint])):
                if np.isfinite(end):
                    row = np.zeros(m)
                    row[active.index(HOLDER + h)] = sign
                    rows.append((row, end - state.c @ row))
        A, b, at = [np.zeros((0, width))], [np.zeros(0)], [np.zeros(0, dtype=np.int64)]
        first = np.minimum(np.arange(k), k - width // m)
        for row, room in rows:
            near = np.flatnonzero((room < trust * np.abs(row).sum()) & (stretch.free > 0.0))
            own = np.zeros((len(near), width // m, m))
            own[np.arange(len(near)), near - first[near]] = row
            A.append(own.reshape(len(near), width))
            b.append(room[near])
            at.append(first[near] * m)
        count = sum(len(each) for each in b)
        price = np.full(count, HARD_PRICE * float(stretch.step.mean()))
        return np.concatenate(A), np.concatenate(b), np.concatenate(at), price


@dataclass(frozen=True)
class Singularity(Term):
    """sum step * SIGMA_PRICE max(0, SIGMA_COMFORT / sigma - 1)^2; sigma: least singular value of the arm's Jacobian.

    Where material is laid down, also HARD_PRICE per unit below the least one allowed.
    """

    weight: float = 1.0
    name = "singularity"

    def price(self, model: Model, stretch: PathSegment, state: PathState) -> float:
        return price_singularity(self.weight, stretch.step, stretch.deposits, state.sigma, state.least_sigma)

    def expand(self, model: Model, stretch: PathSegment, state: PathState, around: Expansion) -> None:
        expand_singularity(self.weight, samples_of(stretch), state.sigma, state.sigma_slope, around.H, around.g)

    def count(self, stretch: PathSegment, state: PathState, watch: Watch) -> tuple[Ints, Ints]:
        rows = self._held(stretch, state).astype(np.int64)
        return rows, rows

    def fill(
        self, model: Model, stretch: PathSegment, state: PathState, around: Expansion, watch: Watch,
        places: RowPlaces, rows: RowsFilled,
    ) -> None:  # fmt: skip
        held = self._held(stretch, state)
        rows_of_sigma(samples_of(stretch), state.sigma, state.sigma_slope, state.least_sigma, held, places, rows)

    def _held(self, stretch: PathSegment, state: PathState) -> Flags:
        return (stretch.step > 0.0) & (stretch.deposits > 0.0) & (state.sigma < NEAR_SIGMA * state.least_sigma)


@dataclass(frozen=True)
class ConeBounds(Term):
    """sum step * HARD_PRICE max(0, lean - cone) for each direction that is bounded [rad]: a bound, without a weight.

    Its rows are facets of a polygon around the cone; those of a sample and a cone share a slack.
    """

    name = "cones"

    def price(self, model: Model, stretch: PathSegment, state: PathState) -> float:
        excess = np.hypot(state.lean[..., 0], state.lean[..., 1]) - state.cones
        return HARD_PRICE * float(stretch.step @ np.maximum(excess, 0.0).sum(axis=1))

    def watch(self, model: Model, stretch: PathSegment, state: PathState, trust: float, watch: Watch) -> None:
        watch_leans(stretch.step, state.lean, state.cones, watch.facets)

    def missed(
        self, model: Model, stretch: PathSegment, state: PathState, around: Expansion, step: Step, watch: Watch
    ) -> int:
        return watch_missed_leans(
            stretch.step, state.lean, state.lean_slope, state.cones, stretch.first, stretch.B, stretch.free, step.x,
            watch.facets,
        )  # fmt: skip

    def count(self, stretch: PathSegment, state: PathState, watch: Watch) -> tuple[Ints, Ints]:
        return count_rows(stretch.step, watch.facets)

    def fill(
        self, model: Model, stretch: PathSegment, state: PathState, around: Expansion, watch: Watch,
        places: RowPlaces, rows: RowsFilled,
    ) -> None:  # fmt: skip
        rows_of_cones(samples_of(stretch), state.lean, state.lean_slope, state.cones, watch.facets, places, rows)


@dataclass(frozen=True)
class BodyClearance(Term):
    """sum step * HARD_PRICE CLEARANCE_UNIT max(0, ROOM - margin) [m] of near bodies: a bound, without a weight."""

    name = "clearance"

    def price(self, model: Model, stretch: PathSegment, state: PathState) -> float:
        return HARD_PRICE * float(stretch.step @ shortage(state.near))

    def further(self, model: Model, stretch: PathSegment, state: PathState, trust: float) -> Rows | None:
        if not len(state.near.sample):
            return None
        A, b, at, time = clearance_rows(state.near, stretch.step, stretch.first, stretch.B, stretch.free, trust)
        return A, b, at, HARD_PRICE * time


@dataclass(frozen=True)
class Tilt(Term):
    """sum step * TILT_PRICE lean^2, where the nozzle may lean: lean [rad] of its axis from the surface normal."""

    weight: float = 1.0
    name = "tilt"

    def price(self, model: Model, stretch: PathSegment, state: PathState) -> float:
        if stretch.cones.tilt == 0.0:
            return 0.0
        return self.weight * TILT_PRICE * float(stretch.step @ (state.lean[:, -1] ** 2).sum(axis=1))

    def expand(self, model: Model, stretch: PathSegment, state: PathState, around: Expansion) -> None:
        if stretch.cones.tilt > 0.0:
            expand_tilt(
                self.weight * TILT_PRICE, samples_of(stretch), state.lean[:, -1], state.lean_slope[:, -1],
                around.H, around.g,
            )  # fmt: skip


@dataclass(frozen=True)
class TravelTerm(Term):
    """ANCHOR times the squared distance [rad] of a bead's ends from where the search chose them for short travel."""

    weight: float = 1.0
    name = "travel"

    def price(self, model: Model, stretch: PathSegment, state: PathState) -> float:
        if not state.c.shape[1]:  # nothing may move
            return 0.0
        return self.weight * ANCHOR * float(stretch.hold @ ((state.c - stretch.anchor) ** 2).sum(axis=1))

    def expand(self, model: Model, stretch: PathSegment, state: PathState, around: Expansion) -> None:
        pull = 2.0 * self.weight * ANCHOR * np.repeat(stretch.hold * stretch.free, state.c.shape[1])
        around.H[:, 0] += pull
        around.g[:] += pull * (state.c - stretch.anchor).ravel()


def samples_of(stretch: PathSegment) -> SplineSamples:
    """A stretch's samples and splines, as the kernels take them."""
    return SplineSamples(stretch.step, stretch.deposits, stretch.first, stretch.B, stretch.free)


# ----------------------------------------------------------------------------------------------------
# The terms of a price, and the model that has them.

_RANGE_ROOM = 2e-3  # rad, m kept from the ends of joints' ranges, since these are only priced, and at samples only
# Shares of the joints' speed, acceleration and jerk that a path may use: five-point differences miss some of the peaks
# of the curve through the samples, and that curve is what is timed.
RATE_SHARES = 0.99, 0.95, 0.7


def terms_of(weights: WeightsSpec, own: Sequence[Term] = ()) -> tuple[Term, ...]:
    """All terms with a problem's weights, then a user's own. Their rows are in the program in this order."""
    return (
        TimeLost(weights.time_lost),
        Effort(weights.effort),
        JointLimits(weights.joint_limits),
        Singularity(weights.singularity),
        ConeBounds(),
        BodyClearance(),
        Tilt(weights.tilt),
        TravelTerm(weights.travel),
        *own,
    )


DEFAULT = terms_of(WeightsSpec())


def model_of(cell: Cell, obstacles: Obstacles = NOTHING, terms: tuple[Term, ...] = DEFAULT) -> Model:
    """The refinement's view of a cell, of its obstacles, and of what a path costs."""
    na = len(cell.arm)
    holder, limits = cell.holder, cell.limits
    return Model(
        numbers=arm_numbers(cell),
        holder=HolderNumbers(holder.placements, holder.axes, holder.T_last_tip),
        given=np.array([j for j in cell.chosen if j < na], dtype=np.int64),
        limits=np.array(RATE_SHARES)[:, None] * np.stack([limits.velocity, limits.acceleration, limits.jerk]),
        low=limits.q_min + _RANGE_ROOM,
        high=limits.q_max - _RANGE_ROOM,
        arm=na,
        names=cell.joint_names,
        terms=terms,
        obstacles=obstacles,
    )
