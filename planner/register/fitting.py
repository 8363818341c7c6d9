"""Least squares of contacts on a surface: a placement as unknowns, the fit, and its uncertainty."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from scipy.stats import chi2, norm, t
from scipy.stats import f as fisher

from planner.base.arrays import Array, Flags, ReadOnlyArrays
from planner.register.contacts import Contacts
from planner.toolpath.bead import Toolpath

# ----------------------------------------------------------------------------------------------------
# A part's placement as unknowns: its pose on its carrier, the place of the table's axis, and the size of the body.
#
# Contacts observe it through the distance of their tips from the part's bare surface; derivatives by the unknowns
# follow from the gradient of the distance alone, so any surface with a signed distance can be located.

TURNS = slice(3, 6)
SHIFTS = slice(6, 9)
SIZE = 9
UNKNOWNS = 10  # x, y, z, turns about x, y, z of the part frame; shift of the table in the world; growth of the body
_ASIDE = 1e-5  # m to either side: step of finite differences


class Distance(Protocol):
    """A surface with a signed distance of points (metres, part frame)."""

    def signed_distance(self, points: Array) -> Array:
        """Distance (n,) of points (n, 3); negative inside."""
        ...


@dataclass(frozen=True)
class Placement(ReadOnlyArrays):
    """Where the part is.

    T_plate_part (4, 4)  on its plate or flange; on a bed, in the world
    shift (3)            of the table from its place in the problem, in the world [m]
    growth               how much larger the body is than drawn, along its normals [m]
    """

    T_plate_part: Array
    shift: Array
    growth: float = 0.0

    def seen(self, tips: Array, T_world_plate: Array) -> Array:
        """Points of the world (n, 3) in the part frame (n, 3), with the plate at (n, 4, 4)."""
        T_world_part = T_world_plate @ self.T_plate_part
        away = tips - self.shift - T_world_part[:, :3, 3]
        return np.einsum("nji,nj->ni", T_world_part[:, :3, :3], away)

    def moved(self, step: Array, centre: Array) -> Placement:
        """The placement moved by unknowns (10) in metres and radians, turned about `centre` (3) of the part frame."""
        T = np.eye(4)
        T[:3, :3] = Rotation.from_rotvec(step[TURNS]).as_matrix()
        T[:3, 3] = centre + step[:3] - T[:3, :3] @ centre
        return replace(
            self,
            T_plate_part=self.T_plate_part @ T,
            shift=self.shift + step[SHIFTS],
            growth=self.growth + float(step[SIZE]),
        )


def slopes(surface: Distance, points: Array) -> Array:
    """Gradients (n, 3) of the signed distance at points (n, 3): outward unit normals where the surface is smooth."""
    n = len(points)
    steps = _ASIDE * np.vstack([np.eye(3), -np.eye(3)])
    around = surface.signed_distance((points[None] + steps[:, None]).reshape(-1, 3)).reshape(6, n)
    return np.asarray((around[:3] - around[3:]).T / (2.0 * _ASIDE))


def rows(points: Array, normals: Array, T_world_part: Array, centre: Array) -> Array:
    """Derivatives (n, 10), by each unknown, of the distance from the surface of points fixed in the world.

    points (n, 3) in the part frame, normals (n, 3) of the surface there, T_world_part (n, 4, 4), centre (3) about which
    the part turns.
    """
    away = np.einsum("nij,nj->ni", T_world_part[:, :3, :3], normals)
    return np.column_stack([-normals, -np.cross(points - centre, normals), -away, -np.ones(len(points))])


# ----------------------------------------------------------------------------------------------------
# The unknowns of a placement to be found, which of them a set of touched places determines, and words for the others.

FREEDOMS = ("x", "y", "z", "rx", "ry", "rz")
# A freedom that moves the touched places along their normals by less than this share of its own size is not observable:
# noise would be amplified a hundredfold. The facets of a round mesh reveal a turn about its own axis by less than that.
SEEN = 0.01
_ALIKE = 1e-3  # relative: a turn that shifts its axis by less is a pure turn, a slide that turns by less a pure slide


@dataclass(frozen=True)
class Unknowns(ReadOnlyArrays):
    """The unknowns to be found.

    basis (10, p)  orthonormal columns of unknowns, all in metres: turns are metres at a distance of `lever` [m] from
                   `centre` (3), in the part frame
    """

    basis: Array
    centre: Array
    lever: float

    @property
    def scale(self) -> Array:
        """Factors (10) from unknowns in metres to metres and radians."""
        out = np.ones(UNKNOWNS)
        out[TURNS] = 1.0 / self.lever
        return out

    @property
    def table(self) -> bool:
        """Whether the table is to be found."""
        return bool(np.abs(self.basis[SHIFTS]).max() > 0.0)

    def columns(self, rows: Array) -> Array:
        """Rows (n, 10) in metres and radians as rows (n, p) of the unknowns to be found."""
        return np.asarray((rows * self.scale) @ self.basis)

    def step(self, z: Array) -> Array:
        """Values (p) of the unknowns to be found as all unknowns (10) in metres and radians."""
        return np.asarray(self.scale * (self.basis @ z))


def looked_for(free: tuple[str, ...], table: Array, size: bool, places: Array) -> Unknowns:
    """Unknowns for named freedoms of the part frame, shifts of the table along directions (3, k), and the size.

    places (n, 3) of the part: they give the centre and the lever of turns.
    """
    columns = [np.eye(UNKNOWNS)[:, FREEDOMS.index(name)] for name in free]
    for direction in table.T:
        column = np.zeros(UNKNOWNS)
        column[SHIFTS] = direction
        columns.append(column)
    if size:
        columns.append(np.eye(UNKNOWNS)[:, SIZE])
    centre = places.mean(axis=0)
    lever = float(np.sqrt(((places - centre) ** 2).sum(axis=1).mean()))
    return Unknowns(np.column_stack(columns), centre, max(lever, 1e-3))


def table_ways(T_world_plate: Array) -> Array:
    """World directions (3, k) in which a table's place can be distinguished from that of the part on it.

    These are the directions in which its turns (n, 4, 4) move the part; a part that turns about the vertical only does
    not reveal how high its table is.
    """
    R = T_world_plate[:, :3, :3]
    turned = R @ R[0].T - np.eye(3)
    values, vectors = np.linalg.eigh(np.einsum("nij,nik->jk", turned, turned) / len(R))
    ways = vectors[:, values > SEEN**2]
    if ways.shape[1] == 2 and abs(np.linalg.det(ways[:2])) > 1.0 - 1e-9:
        return np.eye(3)[:, :2]
    return np.eye(3) if ways.shape[1] == 3 else np.asarray(ways)


def split(J: Array) -> tuple[Array, Array]:
    """Orthonormal directions (p, r) that rows (n, p) observe, and (p, k) that they do not."""
    square, ways = np.linalg.eigh(J.T @ J / max(len(J), 1))
    seen = square > SEEN**2
    return ways[:, seen], ways[:, ~seen]


def words(unknowns: Unknowns, hidden: Array) -> list[str]:
    """Each of the orthonormal directions (p, k) in plain words, in the part frame; mixtures are separated first."""
    full = unknowns.basis @ hidden
    if full.shape[1] == 0:
        return []
    out = []
    table = np.abs(full[SHIFTS]).max() > _ALIKE or np.abs(full[SIZE]).max() > _ALIKE
    if table:
        return [_mixture(column) for column in full.T]
    # slides first: combinations that do not turn
    _, s, Vt = np.linalg.svd(full[TURNS])
    s = np.append(s, np.zeros(Vt.shape[0] - len(s)))
    slides = full[:3] @ Vt[s <= _ALIKE].T
    out += [f"a slide along {_direction(way)}" for way in _straightened(slides).T]
    turns = full @ Vt[s > _ALIKE].T
    turns[:3] -= slides @ (slides.T @ turns[:3])
    if turns.shape[1] == 3:
        return [*out, f"any turn about {_point(unknowns.centre + _pivot(turns, unknowns.lever))}"]
    for turn in turns.T:
        axis = turn[TURNS] / np.linalg.norm(turn[TURNS])
        at = unknowns.centre + _pivot(turn[:, None], unknowns.lever)
        out.append(f"a turn about {_direction(axis)} through {_point(at)}")
    return out


def _pivot(turns: Array, lever: float) -> Array:
    """The point (3), relative to the centre, that turns (10, k) leave in place, as nearly as possible."""
    rows = [_cross(turn[TURNS] / lever) for turn in turns.T]  # the point moves by v + w x p
    return np.linalg.lstsq(np.vstack(rows), -np.concatenate([turn[:3] for turn in turns.T]), rcond=1e-9)[0]


def _cross(w: Array) -> Array:
    return np.array([[0.0, -w[2], w[1]], [w[2], 0.0, -w[0]], [-w[1], w[0], 0.0]])


def _straightened(slides: Array) -> Array:
    """The same span (3, k) by axes of the part frame, if some of them span it."""
    if slides.shape[1] == 0:
        return slides
    along = np.linalg.norm(slides, axis=1) / max(float(np.linalg.norm(slides, axis=0).max()), 1e-12)
    axes = np.flatnonzero(along > 1.0 - _ALIKE)
    return np.eye(3)[:, axes] if len(axes) == slides.shape[1] else slides


def _direction(way: Array) -> str:
    way = way / np.linalg.norm(way)
    k = int(np.argmax(np.abs(way)))
    if abs(way[k]) > 1.0 - _ALIKE:
        return "xyz"[k]
    way = way * np.sign(way[k])
    return "(" + ", ".join(f"{v + 0.0:.2f}" for v in np.round(way, 2)) + ")"


def _point(p: Array) -> str:
    return "(" + ", ".join(f"{v:.1f}" for v in np.round(p * 1e3, 1) + 0.0) + ") mm"


def _mixture(column: Array) -> str:
    names = [*(f"the part's {name}" for name in FREEDOMS), *(f"the table's {name}" for name in "xyz"), "the size"]
    return " with ".join(names[k] for k in np.argsort(-np.abs(column)) if abs(column[k]) > 0.1)


# ----------------------------------------------------------------------------------------------------
# Least squares of contacts on a surface, where some of the contacts may be wrong.
#
# Several starts, each with weights that fall with the residual, give a placement near the right one. There the problem
# is nearly linear, so that the placement of least trimmed squares (Rousseeuw, 1984) is quickly found over many small
# sets of contacts. From the contacts that it keeps, a forward search adds all others that agree with them (Hadi and
# Simonoff, 1993), and plain least squares over these is the result.

LEAST_NOISE = 5e-6  # m: readings are rounded to 0.01 mm, so that no fit is better than this
MOST_WRONG = 0.3  # share of contacts that may be wrong
_TURNED = np.radians(15.0)  # further starts are turned by this about each axis
_BETTER = 0.25  # × the trimmed sum of squares so far: another start must fall below this
_NEAR = 0.1e-3  # m: contacts that agree this well need no other start
_ROUNDS, _STEPS, _LAST_STEPS = 12, 3, 60
_CLOSE = 1e-11  # m: a smaller step ends the search
_FARTHEST_STEP = 0.05  # m: longest step, as the distance from a curved surface is not linear
_SETS = 400  # most sets of contacts tried
_AGREEMENTS = 6  # most times that contacts are chosen again at the placement from the last choice
_UNSEEN = 1e-9  # added to squares of columns, for directions that no contact observes; far below SEEN
_TURNS_FIRST = 1e9  # weight of an unobserved turn relative to a slide
_UNMOVED = 1e-9  # m along unobserved directions: a smaller step ends the way back
_DOUBT = 0.002  # probability of leaving out a contact as good as the others, which makes all seem more exact


@dataclass(frozen=True)
class Touch:
    """Contacts on a surface, and the unknowns: the input of a fit. ball [m]: radius of the probe's ball.

    rough  a stand-in for the surface without a far side, for starts that are farther off than the part is thick
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
        """Derivatives (n, p) of the residuals by each unknown."""
        points = placement.seen(self.contacts.tips, self.contacts.T_world_plate)
        T_world_part = self.contacts.T_world_plate @ placement.T_plate_part
        return self.unknowns.columns(rows(points, slopes(self.surface, points), T_world_part, self.unknowns.centre))


@dataclass(frozen=True)
class Fit:
    """A placement and how contacts (n) agree with it.

    residuals (n) [m]; kept (n): whether each is not an outlier
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
        """Derivatives (m, p) of the residuals of kept contacts by each unknown."""
        return self.touch.columns(self.placement)[self.kept]

    @property
    def spare(self) -> int:
        """Redundancy: the number of kept contacts minus the number of unknowns that they determine."""
        return int(self.kept.sum()) - split(self.columns)[0].shape[1]

    @property
    def noise(self) -> float:
        """Standard deviation of a touch, from the residuals [m]; NaN if no contact is to spare."""
        if self.spare < 1:
            return math.nan
        return max(float(np.sqrt((self.residuals[self.kept] ** 2).sum() / self.spare)), LEAST_NOISE)


def fit(touch: Touch, start: Placement, noise: float | None = None) -> Fit:
    """The placement of a touched part; `noise` [m] is the standard deviation of a touch, if known."""
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
    return Fit(touch, least_moved(touch, start, placement, kept), kept)


def least_moved(touch: Touch, start: Placement, placement: Placement, kept: Flags) -> Placement:
    """Of all placements that the contacts cannot distinguish from this one, the one not moved from the start in
    directions that they do not observe; turns have priority where a slide and a turn are equivalent.

    Observed turns can add up to an unobserved one, and so can the starts of the search: a bowl would end up turned
    about its own axis by an arbitrary angle.
    """
    unknowns = touch.unknowns
    first = np.ones(UNKNOWNS)
    first[TURNS] = _TURNS_FIRST
    for _ in range(_LAST_STEPS):
        hidden = split(touch.columns(placement)[kept])[1]
        if hidden.shape[1] == 0:
            break
        unseen = (unknowns.basis @ hidden * first[:, None]).T
        away = _away(unknowns, start, placement)
        ahead = [placement.moved(unknowns.step(_ASIDE * way), unknowns.centre) for way in hidden.T]
        slope = np.column_stack([(_away(unknowns, start, each) - away) / _ASIDE for each in ahead])
        back = -np.linalg.lstsq(unseen @ slope, unseen @ away, rcond=None)[0]
        back *= min(1.0, _FARTHEST_STEP / max(float(np.linalg.norm(back)), 1e-300))
        placement = placement.moved(unknowns.step(hidden @ back), unknowns.centre)
        placement = _settled(touch, placement, kept.astype(float), _STEPS)
        if np.linalg.norm(back) < _UNMOVED:
            break
    return placement


def _away(unknowns: Unknowns, start: Placement, placement: Placement) -> Array:
    """The difference of a placement from the start as unknowns (10), all in metres."""
    T = np.linalg.inv(start.T_plate_part) @ placement.T_plate_part
    out = np.empty(UNKNOWNS)
    out[:3] = T[:3, :3] @ unknowns.centre + T[:3, 3] - unknowns.centre
    out[TURNS] = Rotation.from_matrix(T[:3, :3]).as_rotvec() * unknowns.lever
    out[SHIFTS], out[SIZE] = placement.shift - start.shift, placement.growth - start.growth
    return out


def most_wrong(n: int, rank: int) -> int:
    """How many of n contacts may be wrong, if the others must fix `rank` unknowns and still reveal the wrong ones."""
    return max(0, min(int(MOST_WRONG * n), n - rank - 2))


def _nearby(touch: Touch, start: Placement) -> Placement:
    """The best of several starts, each led to a minimum with weights that fall with the residual."""
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
    """A minimum with weights that fall with the residual, relative to the h-th smallest residual."""
    r = np.abs(touch.residuals(placement))
    for _ in range(_ROUNDS):
        scale = max(float(np.sort(r)[h - 1]), LEAST_NOISE)
        placement = _settled(touch, placement, 1.0 / (1.0 + (2.0 * r / scale) ** 2), _STEPS)
        before, r = r, np.abs(touch.residuals(placement))
        if np.abs(r - before).max() < LEAST_NOISE:
            break
    return placement


def _starts(unknowns: Unknowns, start: Placement) -> list[Placement]:
    """The start itself twice, with and without a rough fit first, and turned about each axis that may turn."""
    out = [start, start]
    for axis in range(3):
        if np.linalg.norm(unknowns.basis[TURNS][axis]) > 0.5:
            for angle in (-_TURNED, _TURNED):
                step = np.zeros(UNKNOWNS)
                step[TURNS][axis] = angle
                out.append(start.moved(step, unknowns.centre))
    return out


def _settled(touch: Touch, placement: Placement, weights: Array, steps: int) -> Placement:
    """A minimum of the weighted sum of squares by Levenberg-Marquardt; unobserved directions are left alone."""
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
    """Whether contacts (n) agree with each other, by residuals r (n) and their derivatives J (n, p) by the unknowns."""
    n, p = J.shape
    h = n - most_wrong(n, p)
    if h == n:
        return np.ones(n, dtype=bool)
    kept = _least_trimmed(r, J, h)
    while not kept.all():
        m = int(kept.sum())
        off = _left(r, J, kept)
        # a direction that only one contact observes is unknown without it: that one agrees whatever the others say
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
    """Ratio of the deviation of all to that of the `share` with the least residuals, for normal noise."""
    if share >= 1.0:
        return 1.0
    q = float(norm.ppf(0.5 * (1.0 + share)))
    return 1.0 / math.sqrt(1.0 - 2.0 * q * float(norm.pdf(q)) / share)


def _least_trimmed(r: Array, J: Array, h: int) -> Flags:
    """The h of n contacts with the least sum of squares after their own least squares, searched from sets of p."""
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
    """Residuals (n) after least squares over the kept contacts have moved the unknowns."""
    return np.asarray(r + J @ np.linalg.lstsq(J[kept], -r[kept], rcond=None)[0])


# ----------------------------------------------------------------------------------------------------
# The uncertainty of a placement, and what it means for the height of the nozzle over every bead.

CONFIDENCE = 0.95
_WAYPOINTS = 1_500  # about the number at which the height is evaluated


@dataclass(frozen=True)
class BeadWaypoints:
    """Waypoints (n) spread over all beads: points and normals (n, 3) in the part frame, bead (n), s (n) [m]."""

    points: Array
    normals: Array
    bead: NDArray[np.intp]
    s: Array

    def heights(self, unknowns: Unknowns, placement: Placement, plates: Array) -> Array:
        """Derivatives (n k, p) of the nozzle's height over the part by each unknown, for each of k plates (k, 4, 4)."""
        out = []
        for T_world_plate in plates:
            T = np.broadcast_to(T_world_plate @ placement.T_plate_part, (len(self.points), 4, 4))
            out.append(unknowns.columns(rows(self.points, self.normals, T, unknowns.centre)))
        return np.vstack(out)


def waypoints_of(toolpath: Toolpath) -> BeadWaypoints:
    """Waypoints of all beads, evenly thinned."""
    every = max(1, toolpath.waypoints // _WAYPOINTS)
    beads = toolpath.beads
    picks = [np.unique(np.append(np.arange(0, len(bead.s), every), len(bead.s) - 1)) for bead in beads]
    return BeadWaypoints(
        points=np.vstack([bead.points[k] for bead, k in zip(beads, picks, strict=True)]),
        normals=np.vstack([bead.normals[k] for bead, k in zip(beads, picks, strict=True)]),
        bead=np.repeat(np.arange(len(beads)), [len(k) for k in picks]),
        s=np.concatenate([bead.s[k] for bead, k in zip(beads, picks, strict=True)]),
    )


@dataclass(frozen=True)
class Uncertainty:
    """Standard errors of a placement; NaN if no contact is to spare and the noise of a touch is not known.

    position (3)  of the middle of the print, along the part frame's axes [m];  angle (3) about them [rad]
    shift (3)     of the table in the world [m]
    height (n)    of the nozzle over the part at each waypoint [m];  bound (n) of its error, at all of them at once with
                  95 % confidence (Scheffé, 1953)
    """

    position: Array
    angle: Array
    shift: Array
    height: Array
    bound: Array

    @property
    def worst(self) -> int:
        """The waypoint at which the height is most uncertain."""
        return int(np.argmax(self.height))


def uncertainty_of(fit: Fit, waypoints: BeadWaypoints, plates: Array, noise: float | None) -> Uncertainty:
    """Uncertainty of placement and nozzle height, from the contacts' residuals or a touch's known `noise` [m].

    plates (k, 4, 4): poses of the part's plate at the angles that count; the worst of them is reported.
    """
    unknowns, J = fit.touch.unknowns, fit.columns
    seen = split(J)[0]
    sigma = fit.noise if noise is None else noise
    covariance = sigma**2 * seen @ np.linalg.inv(seen.T @ J.T @ J @ seen) @ seen.T
    r = seen.shape[1]
    if noise is not None:
        factor = math.sqrt(float(chi2.ppf(CONFIDENCE, r)))
    elif fit.spare >= 1:
        factor = math.sqrt(r * float(fisher.ppf(CONFIDENCE, r, fit.spare)))
    else:
        factor = math.nan
    H = waypoints.heights(unknowns, fit.placement, plates)
    height = np.sqrt(np.einsum("ij,jk,ik->i", H, covariance, H)).reshape(len(plates), -1).max(axis=0)
    step = (np.eye(UNKNOWNS) * unknowns.scale[:, None]) @ unknowns.basis
    away = waypoints.points.mean(axis=0) - unknowns.centre
    cross = np.array([[0.0, away[2], -away[1]], [-away[2], 0.0, away[0]], [away[1], -away[0], 0.0]])

    def deviation(part: Array) -> Array:
        return np.sqrt(np.einsum("ij,jk,ik->i", part, covariance, part))

    return Uncertainty(
        position=deviation(step[:3] + cross @ step[TURNS]),
        angle=deviation(step[TURNS]),
        shift=deviation(step[SHIFTS]),
        height=height,
        bound=factor * height,
    )
