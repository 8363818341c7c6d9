"""A user's own term of the refinement's price: how it sees a path, what it returns, and how it joins the others.

    @dataclass(frozen=True)
    class KeepAway:
        joint: str
        name = "keep_away"

        def price(self, path: PathSamples) -> SamplePrice: ...

A term sees joints and their speeds at samples and returns a price, its slopes with respect to these, and its curvature.
Splines, inverse kinematics and the quadratic program are not its concern: slopes with respect to the control values
follow by the chain rule.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from planner.base.arrays import Array, read_only
from planner.base.errors import InputError
from planner.resolve.price_kernels import expand_own
from planner.resolve.segment import Expansion, Model, PathSegment, PathState, Term
from planner.resolve.terms import samples_of


@dataclass(frozen=True)
class PathSamples:
    """Samples (n) of a path, as a term sees them; arrays are read-only.

    Attributes:
        joints: Names of the joints (nj), in the order of the columns.
        q: Joint positions (n, nj) [rad; m for sliding joints].
        qd: Joint speeds (n, nj) at the commanded speed [rad/s; m/s for sliding joints].
        max_speed: Speed limits (nj,) of the joints, less what timing needs [rad/s; m/s for sliding joints].
        low: Lower ends (nj,) of their ranges [rad; m for sliding joints].
        high: Upper ends (nj,) of their ranges [rad; m for sliding joints].
        deposits: Numbers (n,): 1 where material is laid down, else 0.
    """

    joints: tuple[str, ...]
    q: Array
    qd: Array
    max_speed: Array
    low: Array
    high: Array
    deposits: Array


@dataclass(frozen=True)
class SamplePrice:
    """What samples (n) cost, in seconds per second of printing, and how that changes with joints and speeds.

    The curves decide how long the refinement's steps are.

    Attributes:
        price: Price (n,), not negative; 0.1 at a sample weighs as much as losing a tenth of its time.
        by_q: Derivatives (n, nj) of the price by joint positions; None if it does not depend on them.
        by_qd: Derivatives (n, nj) of the price by joint speeds; None if it does not depend on them.
        curve_q: Convex part (n, nj) of the second derivatives by positions, joint by joint, not negative; None: the
            price is treated as linear.
        curve_qd: The same by joint speeds.
    """

    price: Array
    by_q: Array | None = None
    by_qd: Array | None = None
    curve_q: Array | None = None
    curve_qd: Array | None = None


class OwnTerm(Protocol):
    """A user's own term, for `solve(problem, terms=[...])`: any object with a name and a price.

    `price` is called from several threads, each time with samples of one bead or of a stretch of one. Samples are
    priced one by one: the price of one must not depend on the others.
    """

    @property
    def name(self) -> str:
        """What errors and plan.json call it."""

    def price(self, path: PathSamples) -> SamplePrice:
        """What each sample costs.

        Args:
            path: The samples.

        Returns:
            Their price, with its derivatives, see `SamplePrice`.
        """


@dataclass(frozen=True)
class Own(Term):
    """sum step * price of a user's term."""

    term: OwnTerm
    name = "own"

    def price(self, model: Model, stretch: PathSegment, state: PathState) -> float:
        return float(stretch.step @ self._asked(model, stretch, state).price)

    def expand(self, model: Model, stretch: PathSegment, state: PathState, around: Expansion) -> None:
        asked, none = self._asked(model, stretch, state), np.zeros(state.q.shape)
        by_q, by_qd, curve_q, curve_qd = (
            none if each is None else np.ascontiguousarray(each, dtype=float)
            for each in (asked.by_q, asked.by_qd, asked.curve_q, asked.curve_qd)
        )
        speed_slopes = around.slopes[:, : state.q.shape[1]] * model.limits[0, :, None]
        expand_own(
            samples_of(stretch), state.G, speed_slopes, np.stack([by_q, by_qd]), np.stack([curve_q, curve_qd]),
            around.H, around.g,
        )  # fmt: skip

    def _asked(self, model: Model, stretch: PathSegment, state: PathState) -> SamplePrice:
        q, qd, deposits = read_only(state.q.copy()), read_only(state.rates[:, 0].copy()), stretch.deposits.copy()
        seen = PathSamples(
            model.names, q, qd, read_only(model.limits[0].copy()), read_only(model.low.copy()),
            read_only(model.high.copy()), read_only(deposits),
        )  # fmt: skip
        return _checked(self.term, seen)


def own_terms(terms: Sequence[OwnTerm]) -> tuple[Own, ...]:
    """A user's terms, wrapped to join the others. Raises InputError for anything that is not a term."""
    for i, term in enumerate(terms):
        if not isinstance(getattr(term, "name", None), str) or not callable(getattr(term, "price", None)):
            hint = "an object with a name (a string) and a method price(path)"
            raise InputError(f"{term!r} is not a term", field=f"terms[{i}]", hint=hint)
    return tuple(Own(term) for term in terms)


def check_term(term: OwnTerm, path: PathSamples, step: float = 1e-6, tolerance: float = 1e-4) -> None:
    """Compare a term's derivatives with finite differences of its price, over samples such as `random_samples` makes.

    A kink between the two points that are compared counts as a difference.

    Args:
        term: The term to check.
        path: The samples.
        step: By how much positions and speeds are moved to both sides [rad, rad/s; m, m/s for sliding joints].
        tolerance: Greatest difference allowed, as a share of the greatest slope, or of 1 if that is less.

    Raises:
        InputError: If a derivative differs, with the joint and the sample where the difference is greatest; also for
            negative curves, wrong shapes and values that are not finite.
    """
    (own,) = own_terms([term])
    said = _checked(own.term, path)
    for which, slope in (("q", said.by_q), ("qd", said.by_qd)):
        values = getattr(path, which)
        claimed = np.zeros(values.shape) if slope is None else np.asarray(slope)
        seen = np.empty(values.shape)
        for j in range(values.shape[1]):
            moved = np.zeros(values.shape)
            moved[:, j] = step
            sides = [_checked(term, _with(path, which, values + sign * moved)).price for sign in (1.0, -1.0)]
            seen[:, j] = (sides[0] - sides[1]) / (2.0 * step)
        off = np.abs(seen - claimed)
        if off.max() > tolerance * max(1.0, float(np.abs(seen).max())):
            i, j = divmod(int(off.argmax()), off.shape[1])
            reason = f"by_{which} of {path.joints[j]} is {claimed[i, j]:.6g} at sample {i}, finite differences give {seen[i, j]:.6g}"
            raise InputError(
                reason, field=f"term {term.name}", hint="the derivative of price by each joint of each sample"
            )


def random_samples(joints: Sequence[str], samples: int = 200, seed: int = 0) -> PathSamples:
    """Samples to try a term on.

    Args:
        joints: Names of the joints (nj).
        samples: Number n of samples.
        seed: Seed of the random numbers.

    Returns:
        Joints within pi of zero [rad; m for sliding joints], speeds up to 1 rad/s or m/s.
    """
    rng = np.random.default_rng(seed)
    nj = len(joints)
    return PathSamples(
        joints=tuple(joints),
        q=read_only(rng.uniform(-np.pi, np.pi, (samples, nj))),
        qd=read_only(rng.uniform(-1.0, 1.0, (samples, nj))),
        max_speed=read_only(np.full(nj, 2.0)),
        low=read_only(np.full(nj, -np.pi)),
        high=read_only(np.full(nj, np.pi)),
        deposits=read_only(np.ones(samples)),
    )


def _with(path: PathSamples, which: str, values: Array) -> PathSamples:
    q, qd = (values, path.qd) if which == "q" else (path.q, values)
    return PathSamples(path.joints, q, qd, path.max_speed, path.low, path.high, path.deposits)


def _checked(term: OwnTerm, path: PathSamples) -> SamplePrice:
    """A term's price of samples. Raises InputError if it is not as `SamplePrice` requires."""
    answer, field = term.price(path), f"term {term.name}"
    if not isinstance(answer, SamplePrice):
        raise InputError(f"price returned {type(answer).__name__}", field=field, hint="return a SamplePrice")
    n, nj = path.q.shape
    shapes = {"price": (n,), "by_q": (n, nj), "by_qd": (n, nj), "curve_q": (n, nj), "curve_qd": (n, nj)}
    for part, shape in shapes.items():
        values = getattr(answer, part)
        if values is None and part != "price":
            continue
        if np.shape(values) != shape:
            hint = "a row for each sample" + (", a column for each joint" if len(shape) == 2 else "")
            raise InputError(f"{part} has the shape {np.shape(values)}, not {shape}", field=field, hint=hint)
        numbers = np.asarray(values)
        if numbers.dtype.kind not in "fiu" or not np.isfinite(numbers).all():
            raise InputError(f"{part} is not a finite number at every sample", field=field, hint="no NaN, no infinity")
        if part in ("price", "curve_q", "curve_qd") and (numbers < 0.0).any():
            raise InputError(f"{part} is negative", field=field, hint="clip it at 0")
    return answer
