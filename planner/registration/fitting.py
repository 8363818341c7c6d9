"""Least squares of contacts on a surface, where some of the contacts may be wrong.

Several starts, each with weights that fall with the residual, give a placement near the right one. There the problem is
nearly linear, so that the placement of the least trimmed squares (Rousseeuw, 1984) is searched over many small sets of
contacts in no time. From the contacts that it keeps a forward search takes in all others that agree with them
(Hadi and Simonoff, 1993), and plain least squares over these is the result.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.stats import norm, t

from planner.readonly import Array, Flags
from planner.registration.contacts import Contacts
from planner.registration.placement import TURNS, UNKNOWNS, Distance, Placement, rows, slopes
from planner.registration.unknowns import Unknowns, split

LEAST_NOISE = 5e-6  # m: readings are rounded to 0.01 mm, so that no fit is better than this
MOST_WRONG = 0.3  # share of contacts that may be wrong
_TURNED = np.radians(15.0)  # of further starts about each axis
_BETTER = 0.25  # of the trimmed sum of squares, by which another start must be better than the problem's own placement
_NEAR = 0.1e-3  # m: contacts that agree so well need no other start
_ROUNDS, _STEPS, _LAST_STEPS = 12, 3, 60
_CLOSE = 1e-11  # m: a step as small as this ends the search
_FARTHEST_STEP = 0.05  # m: the distance of a bent surface is no straight line
_SETS = 400  # of contacts that are tried, at most
_AGREEMENTS = 6  # times that contacts are chosen anew at the placement that the last choice gave
_UNSEEN = 1e-9  # added to squares of columns: a direction that none of the contacts sees, to far below SEEN
_DOUBT = 0.002  # probability of leaving out a contact that is as good as the others: that makes all seem more exact


@dataclass(frozen=True)
class Touch:
    """Contacts on a surface, and what is looked for: all that a fit is made of. ball [m]: radius of what touches.

    rough  a stand-in for the surface that knows no other side, for starts that are farther off than the part is thick
    """

    surface: Distance
    rough: Distance
    contacts: Contacts
    unknowns: Unknowns
    ball: float = 0.0

    def residuals(self, placement: Placement) -> Array:
        """How far each contact (n) is off the surface, positive outside [m]."""
        points = placement.seen(self.contacts.tips, self.contacts.T_world_plate)
        return np.asarray(self.surface.signed_distance(points) - self.ball - placement.growth)

    def columns(self, placement: Placement) -> Array:
        """How residuals change with each unknown (n, p)."""
        points = placement.seen(self.contacts.tips, self.contacts.T_world_plate)
        T_world_part = self.contacts.T_world_plate @ placement.T_plate_part
        return self.unknowns.columns(rows(points, slopes(self.surface, points), T_world_part, self.unknowns.centre))


@dataclass(frozen=True)
class Fit:
    """A placement and how contacts (n) agree with it.

    residuals (n) [m]; kept (n) which are not outliers; rank of what the kept ones see
    """

    touch: Touch
    placement: Placement
    kept: Flags

    @cached_property
    def residuals(self) -> Array:
        """How far each contact (n) is off the surface [m]."""
        return self.touch.residuals(self.placement)

    @cached_property
    def columns(self) -> Array:
        """How the residuals of the contacts that were kept change with each unknown (m, p)."""
        return self.touch.columns(self.placement)[self.kept]

    @property
    def spare(self) -> int:
        """By how many the contacts that were kept are more than what they fix."""
        return int(self.kept.sum()) - split(self.columns)[0].shape[1]

    @property
    def noise(self) -> float:
        """Standard deviation of a touch, from the residuals [m]; NaN where no contact is to spare."""
        if self.spare < 1:
            return math.nan
        return max(float(np.sqrt((self.residuals[self.kept] ** 2).sum() / self.spare)), LEAST_NOISE)


def fit(touch: Touch, start: Placement, noise: float | None = None) -> Fit:
    """The placement of a touched part; `noise` [m] is the standard deviation of a touch, where that is known."""
    n = len(touch.contacts)
    placement = _nearby(touch, start)
    everything = np.ones(n, dtype=bool)
    kept = everything
    for _ in range(_AGREEMENTS):
        r, J = touch.residuals(placement), touch.columns(placement)
        seen = split(J)[0]
        before, kept = kept, _agreeing(r, J @ seen, noise)
        placement = _settled(touch, placement, kept.astype(float), _LAST_STEPS)
        if (kept == before).all():
            break
    return Fit(touch, placement, kept)


def most_wrong(n: int, rank: int) -> int:
    """How many of n contacts may be wrong, if the others fix `rank` unknowns and still tell that they are wrong."""
    return max(0, min(int(MOST_WRONG * n), n - rank - 2))


def _nearby(touch: Touch, start: Placement) -> Placement:
    """The best of several starts, each brought to a minimum with weights that fall with the residual."""
    n = len(touch.contacts)
    h = n - most_wrong(n, touch.unknowns.basis.shape[1])
    best, least = start, math.inf
    rough = replace(touch, surface=touch.rough)
    for k, turned in enumerate(_starts(touch.unknowns, start)):
        placement = _weighted(touch, turned if k == 1 else _weighted(rough, turned, h), h)
        r = np.abs(touch.residuals(placement))
        cost = float((np.sort(r)[:h] ** 2).sum()) + h * LEAST_NOISE**2
        if cost < (_BETTER if k else 1.0) * least:
            best, least = placement, cost
        if least < h * _NEAR**2:
            break
    return best


def _weighted(touch: Touch, placement: Placement, h: int) -> Placement:
    """A minimum with weights that fall with the residual, by the size of the h-th of them."""
    r = np.abs(touch.residuals(placement))
    for _ in range(_ROUNDS):
        scale = max(float(np.sort(r)[h - 1]), LEAST_NOISE)
        placement = _settled(touch, placement, 1.0 / (1.0 + (2.0 * r / scale) ** 2), _STEPS)
        before, r = r, np.abs(touch.residuals(placement))
        if np.abs(r - before).max() < LEAST_NOISE:
            break
    return placement


def _starts(unknowns: Unknowns, start: Placement) -> list[Placement]:
    """The start itself twice, for a rough fit and for its own sake, and turned about each axis that may turn."""
    out = [start, start]
    for axis in range(3):
        if np.linalg.norm(unknowns.basis[TURNS][axis]) > 0.5:
            for angle in (-_TURNED, _TURNED):
                step = np.zeros(UNKNOWNS)
                step[TURNS][axis] = angle
                out.append(start.moved(step, unknowns.centre))
    return out


def _settled(touch: Touch, placement: Placement, weights: Array, steps: int) -> Placement:
    """A minimum of the weighted sum of squares, by Levenberg and Marquardt's method; what is not seen is left alone."""
    root = np.sqrt(weights)
    r = touch.residuals(placement)
    cost, damping = float(weights @ r**2), 0.0
    for _ in range(steps):
        J = touch.columns(placement)
        seen = split(J[weights > 0.0])[0]
        U, s, Vt = np.linalg.svd(root[:, None] * (J @ seen), full_matrices=False)
        for _ in range(_STEPS):
            z = -seen @ (Vt.T @ (s / (s * s + damping * s[:1] ** 2 + 1e-300) * (U.T @ (root * r))))
            z *= min(1.0, _FARTHEST_STEP / max(float(np.linalg.norm(z)), 1e-300))
            trial = placement.moved(touch.unknowns.step(z), touch.unknowns.centre)
            r_trial = touch.residuals(trial)
            better = float(weights @ r_trial**2)
            if better < cost:
                break
            damping = max(10.0 * damping, 1e-3)
        else:
            return placement
        placement, r, cost, damping = trial, r_trial, better, 0.1 * damping
        if np.linalg.norm(z) < _CLOSE:
            break
    return placement


def _agreeing(r: Array, J: Array, noise: float | None) -> Flags:
    """Which contacts (n) agree with each other, their residuals r (n) changing with unknowns by J (n, p)."""
    n, p = J.shape
    h = n - most_wrong(n, p)
    if h == n:
        return np.ones(n, dtype=bool)
    kept = _least_trimmed(r, J, h)
    while not kept.all():
        m = int(kept.sum())
        off = _left(r, J, kept)
        # what only one contact sees is not known without it: it agrees with whatever the others say
        spread = np.linalg.inv(J[kept].T @ J[kept] + _UNSEEN * np.eye(p))
        lever = np.einsum("ij,jk,ik->i", J, spread, J)
        if noise is None:
            square = float((off[kept] ** 2).sum() / (m - p))
            sigma, bound = math.sqrt(square) * _trimmed(m / n), float(t.ppf(1.0 - 0.5 * _DOUBT, m - p))
        else:
            sigma, bound = noise, float(norm.ppf(1.0 - 0.5 * _DOUBT / n))
        sigma = max(sigma, LEAST_NOISE)
        excess = np.abs(off) / (sigma * np.sqrt(1.0 + np.where(kept, 0.0, lever)))
        excess[kept] = math.inf
        nearest = int(np.argmin(excess))
        if excess[nearest] > bound:
            break
        kept[nearest] = True
    return kept


def _trimmed(share: float) -> float:
    """How much larger the deviation of all is than that of the `share` with the least residuals, for normal noise."""
    if share >= 1.0:
        return 1.0
    q = float(norm.ppf(0.5 * (1.0 + share)))
    return 1.0 / math.sqrt(1.0 - 2.0 * q * float(norm.pdf(q)) / share)


def _least_trimmed(r: Array, J: Array, h: int) -> Flags:
    """The h of n contacts whose own least squares leave them the least sum of squares, as far as sets of p tell."""
    n, p = J.shape
    if math.comb(n, p) <= _SETS:
        sets: list[Sequence[int]] = list(itertools.combinations(range(n), p))
    else:
        draw = np.random.default_rng(0)
        sets = [draw.permutation(n)[:p].tolist() for _ in range(_SETS)]
    best, least = np.ones(n, dtype=bool), math.inf
    for each in sets:
        kept = np.zeros(n, dtype=bool)
        kept[list(each)] = True
        if np.linalg.matrix_rank(J[kept], tol=1e-6) < p:
            continue
        for _ in range(_STEPS):
            off = _left(r, J, kept) ** 2
            kept = np.zeros(n, dtype=bool)
            kept[np.argsort(off, kind="stable")[:h]] = True
        cost = float((_left(r, J, kept)[kept] ** 2).sum())
        if cost < least:
            best, least = kept, cost
    return best


def _left(r: Array, J: Array, kept: Flags) -> Array:
    """What residuals (n) become when least squares over the contacts that are kept have moved the unknowns."""
    return np.asarray(r + J @ np.linalg.lstsq(J[kept], -r[kept], rcond=None)[0])
