"""Inverse kinematics of arms of any kind: the common interface; arms nearly of a kind, and arms on a rail or gantry."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from planner.base.arrays import Array
from planner.base.compiled import address_of, array_at, call_at, inner_njit, njit
from planner.cell.kinematics import offset_wrist, placed_wrist, seven_axes_kernel, skew_wrist_kernel, spherical_wrist
from planner.cell.kinematics.axes import wrap
from planner.cell.kinematics.chain import Chain, chain_state, refine
from planner.cell.kinematics.offset_wrist import OffsetWrist
from planner.cell.kinematics.placed_wrist import PlacedWrist
from planner.cell.kinematics.seven_axes import SevenAxes
from planner.cell.kinematics.skew_wrist import SkewWrist
from planner.cell.kinematics.spherical_wrist import SphericalWrist

# ----------------------------------------------------------------------------------------------------
# Arms that are nearly of a kind with a closed form: its postures, refined by Newton's method on the true chain.
#
# Such are measured (calibrated) arms, and those of URDF files whose right angles were rounded. Branches are those of
# the nearest ideal arm; poses are exact.

_ITERATIONS = 20  # two or three suffice, a few more near singularities


@dataclass(frozen=True)
class Corrected:
    """The closed form of the nearest ideal arm, and the arm's true chain from base to flange."""

    nominal: PlacedWrist | OffsetWrist | SevenAxes
    chain: Chain

    @property
    def joints(self) -> int:
        """Number of joints."""
        return self.nominal.joints

    @property
    def branch_count(self) -> int:
        """As many as the ideal arm has."""
        return self.nominal.branch_count

    @property
    def redundant_joint(self) -> int | None:
        """The ideal arm's."""
        return self.nominal.redundant_joint

    @property
    def parameters(self) -> Array:
        """The joint that is held (-1 for none), placements, axes and tip of the chain, then the ideal arm's own."""
        held = -1.0 if self.redundant_joint is None else float(self.redundant_joint)
        chain = self.chain
        pieces = [[held], chain.placements.ravel(), chain.axes.ravel(), chain.T_last_tip.ravel()]
        return np.concatenate([*pieces, self.nominal.parameters])

    def poses(self, q: Array) -> Array:
        """Flange poses T_base_flange (m, 4, 4) of postures q (m, n)."""
        return self.chain.poses(q)

    def solve(self, T_base_flange: Array, redundant: Array | None = None) -> tuple[Array, NDArray[np.bool_]]:
        """Postures q (m, B, n) in (-pi, pi] of flange poses (m, 4, 4), and which exist (m, B).

        Those of the ideal arm, refined; if that fails, at the edge of reach or in a singularity, there is none.
        """
        q, ok = self.nominal.solve(T_base_flange, redundant)
        _refine_all(self.parameters, np.ascontiguousarray(T_base_flange), q, ok)
        return q, ok

    def branches(self, q: Array) -> NDArray[np.int8]:
        """Branch numbers (m) of postures q (m, n), as if the arm were ideal."""
        return self.nominal.branches(q)

    def out_of_reach(self, T_base_flange: Array, redundant: Array | None = None) -> Array:
        """How far (m) the flange poses are out of the ideal arm's reach [m]; 0 within."""
        return self.nominal.out_of_reach(T_base_flange, redundant)


@inner_njit
def length(n: int) -> int:
    """Length of the parameters before the ideal arm's own, for n joints."""
    return 1 + 22 * n + 16


@inner_njit
def refine_branches(p: Array, R: Array, t: Array, q: Array, ok: NDArray[np.bool_]) -> None:
    """Refine the postures q (B, n) that exist (ok), all for one pose; ok becomes False where that fails."""
    n = q.shape[1]
    placements = p[1 : 1 + 16 * n].reshape(n, 4, 4)
    axes = p[1 + 16 * n : 1 + 22 * n].reshape(n, 6)
    tip = p[1 + 22 * n : length(n)].reshape(4, 4)
    for k in range(ok.size):
        if ok[k]:
            ok[k] = refine(placements, axes, tip, int(p[0]), R, t, q[k], _ITERATIONS)
            for j in range(n):
                q[k, j] = wrap(q[k, j])


@njit
def _refine_all(p: Array, T: Array, q: Array, ok: NDArray[np.bool_]) -> None:
    for i in range(T.shape[0]):
        refine_branches(p, T[i, :3, :3], T[i, :3, 3], q[i], ok[i])


# ----------------------------------------------------------------------------------------------------
# Arms on a rail or a gantry: arms with more joints, whose first ones are redundant.
#
# These place the arm's base; seen from there, the arm keeps its closed form.


@dataclass(frozen=True)
class OnRail:
    """An arm on k joints that carry it, which slide or turn; poses are in the frame that these start from.

    arm    the arm's own inverse kinematics; if it has a redundant joint, that is given after those that carry the arm
    rail   the carrying joints, whose tip is the arm's base
    rest   default positions of all these joints, if none are given [rad, m]
    """

    arm: SphericalWrist | PlacedWrist | OffsetWrist | SkewWrist | SevenAxes | Corrected
    rail: Chain
    rest: tuple[float, ...]

    @property
    def joints(self) -> int:
        """Number of joints: the arm's and those that carry it."""
        return self.arm.joints + len(self.rail)

    @property
    def branch_count(self) -> int:
        """As many as the arm has."""
        return self.arm.branch_count

    @property
    def redundant_joint(self) -> int | None:
        """The first of the joints that carry the arm, which are all given."""
        return 0

    @property
    def parameters(self) -> Array:
        """Number of joints that carry the arm, their placements, axes and tip, then the arm's own parameters."""
        rail = self.rail
        pieces = [[float(len(rail))], rail.placements.ravel(), rail.axes.ravel(), rail.T_last_tip.ravel()]
        return np.concatenate([*pieces, self.arm.parameters])

    def poses(self, q: Array) -> Array:
        """Flange poses (m, 4, 4) of postures q (m, n)."""
        k = len(self.rail)
        return self.rail.poses(q[:, :k]) @ self.arm.poses(np.ascontiguousarray(q[:, k:]))

    def solve(self, T_base_flange: Array, redundant: Array | None = None) -> tuple[Array, NDArray[np.bool_]]:
        """Postures q (m, B, n) of flange poses (m, 4, 4), and which exist (m, B): those of the arm, with its base
        placed by the first k of the positions redundant (m, k or k + 1), which are `rest` if not given."""
        given = self._given(T_base_flange, redundant)
        k = len(self.rail)
        q, ok = self.arm.solve(self._from_arm(T_base_flange, given[:, :k]), self._own(given))
        return np.concatenate([np.broadcast_to(given[:, None, :k], (*ok.shape, k)), q], axis=2), ok

    def branches(self, q: Array) -> NDArray[np.int8]:
        """Branch numbers (m) of postures q (m, n): those of the arm."""
        return self.arm.branches(np.ascontiguousarray(q[:, len(self.rail) :]))

    def out_of_reach(self, T_base_flange: Array, redundant: Array | None = None) -> Array:
        """How far (m) the flange poses are out of the arm's reach from its base there [m]; 0 within."""
        given = self._given(T_base_flange, redundant)
        return self.arm.out_of_reach(self._from_arm(T_base_flange, given[:, : len(self.rail)]), self._own(given))

    def _own(self, given: Array) -> Array | None:
        """The given angles (m) of the arm's own redundant joint, if it has one."""
        return None if self.arm.redundant_joint is None else given[:, len(self.rail)]

    def _from_arm(self, T_base_flange: Array, given: Array) -> Array:
        """Flange poses (m, 4, 4) in the arm's own base frame, with the carrying joints at given (m, k)."""
        base = self.rail.poses(given)
        R = np.swapaxes(base[:, :3, :3], 1, 2)
        out = np.zeros_like(T_base_flange)
        out[:, :3, :3] = R @ T_base_flange[:, :3, :3]
        out[:, :3, 3] = np.einsum("mij,mj->mi", R, T_base_flange[:, :3, 3] - base[:, :3, 3])
        out[:, 3, 3] = 1.0
        return out

    def _given(self, T: Array, redundant: Array | None) -> Array:
        rest = np.tile(self.rest, (len(T), 1))
        return rest if redundant is None else np.ascontiguousarray(np.reshape(redundant, rest.shape), dtype=np.float64)


@inner_njit
def _seen_from_arm(p: Array, given: Array, R: Array, t: Array, out: Array) -> None:
    """Fill out (4, 4) with a flange pose, rotation R (3, 3) and origin t (3), in the arm's own base frame; p:
    parameters up to the arm's own; given (k, or more): positions of the joints that carry it."""
    k = int(p[0])
    placements, axes = p[1 : 1 + 16 * k].reshape(k, 4, 4), p[1 + 16 * k : 1 + 22 * k].reshape(k, 6)
    base, lines = np.empty((4, 4)), np.empty((2, k, 3))
    chain_state(placements, axes, p[1 + 22 * k :].reshape(4, 4), given[:k], lines[0], lines[1], base)
    for i in range(3):
        for j in range(3):
            out[i, j] = base[0, i] * R[0, j] + base[1, i] * R[1, j] + base[2, i] * R[2, j]
        out[i, 3] = (
            base[0, i] * (t[0] - base[0, 3]) + base[1, i] * (t[1] - base[1, 3]) + base[2, i] * (t[2] - base[2, 3])
        )
    out[3, 0], out[3, 1], out[3, 2], out[3, 3] = 0.0, 0.0, 0.0, 1.0


# ----------------------------------------------------------------------------------------------------
# The interface of an arm's inverse kinematics, whatever its kind.

SPHERICAL_WRIST, OFFSET_WRIST, SEVEN_AXES, PLACED_WRIST, SKEW_WRIST, CORRECTED, ON_RAIL = 0, 1, 2, 3, 4, 8, 16


class InverseKinematics(Protocol):
    """Inverse kinematics of an arm; poses are those of the flange in the arm's base frame.

    Branches are numbered: a posture's number is its index in the result of `solve`. With a closed form, it changes
    along a continuous motion only at a singularity; for a `SkewWrist`, in a few other places too.
    """

    @property
    def joints(self) -> int:
        """Number n of joints."""

    @property
    def branch_count(self) -> int:
        """Number B of branches."""

    @property
    def redundant_joint(self) -> int | None:
        """Index of the joint whose position is given to `solve`; None for an arm of six joints.

        If joints carry the arm, it is the first of these.
        """

    @property
    def parameters(self) -> Array:
        """The numbers that `solve_one` needs for this arm, in an order of its kind's own."""

    def poses(self, q: Array) -> Array:
        """Flange poses in the arm's base frame.

        Args:
            q: Postures (m, n) [rad; m for sliding joints].

        Returns:
            T_base_flange (m, 4, 4) for each posture.
        """

    def solve(self, T_base_flange: Array, redundant: Array | None = None) -> tuple[Array, NDArray[np.bool_]]:
        """All postures that have given flange poses, one for each branch.

        Args:
            T_base_flange: Flange poses (m, 4, 4) in the arm's base frame.
            redundant: Positions (m,) of the redundant joint, or (m, k) of k such joints [rad; m for sliding joints];
                ignored if the arm has none.

        Returns:
            Postures (m, B, n), in (-pi, pi] for joints that turn [rad; m for sliding joints].
            Which of them exist (m, B).
        """

    def branches(self, q: Array) -> NDArray[np.int8]:
        """Branch numbers of postures.

        Args:
            q: Postures (m, n) [rad; m for sliding joints].

        Returns:
            Branch numbers (m,).
        """

    def out_of_reach(self, T_base_flange: Array, redundant: Array | None = None) -> Array:
        """By how much the arm's lengths fail to reach flange poses, about the distance missed.

        Args:
            T_base_flange: Flange poses (m, 4, 4) in the arm's base frame.
            redundant: As in `solve`.

        Returns:
            Distances (m,) [m]; 0 within reach.
        """


def kind_of(inverse: InverseKinematics) -> int:
    """The kind that `solve_one` takes: one of the constants above, plus CORRECTED for a corrected arm, plus ON_RAIL for
    one that is carried."""
    if isinstance(inverse, OnRail):
        return ON_RAIL + kind_of(inverse.arm)
    if isinstance(inverse, Corrected):
        return CORRECTED + kind_of(inverse.nominal)
    if isinstance(inverse, SphericalWrist):
        return SPHERICAL_WRIST
    if isinstance(inverse, PlacedWrist):
        return PLACED_WRIST
    if isinstance(inverse, SkewWrist):
        return SKEW_WRIST
    return OFFSET_WRIST if isinstance(inverse, OffsetWrist) else SEVEN_AXES


def with_rest(inverse: InverseKinematics, *rest: float) -> InverseKinematics:
    """The same arm, with these positions [rad, m] of its redundant joints whenever `solve` is given none."""
    if isinstance(inverse, OnRail):
        return replace(inverse, rest=rest)
    if isinstance(inverse, Corrected) and isinstance(inverse.nominal, SevenAxes):
        return replace(inverse, nominal=replace(inverse.nominal, rest=rest[0]))
    return replace(inverse, rest=rest[0]) if isinstance(inverse, SevenAxes) else inverse


def given_joints(inverse: InverseKinematics) -> tuple[int, ...]:
    """Indices of the joints whose angles are given to `solve` from outside."""
    if isinstance(inverse, OnRail):
        k = len(inverse.rail)
        return (*range(k), *(k + j for j in given_joints(inverse.arm)))
    return () if inverse.redundant_joint is None else (inverse.redundant_joint,)


def track(
    inverse: InverseKinematics, T_base_flange: Array, redundant: Array | None, q_start: Array
) -> tuple[Array, NDArray[np.bool_]]:
    """Postures q (m, n) along a path of flange poses (m, 4, 4) on the branch of q_start (n), and where they exist (m).

    redundant as in `solve`. Joints are unwrapped, so that they are continuous from q_start on; where there is no
    posture, the previous one is repeated.
    """
    solutions, exists = inverse.solve(T_base_flange, redundant)
    branch = int(inverse.branches(q_start[None])[0])
    q, ok = solutions[:, branch], exists[:, branch]
    last = np.maximum.accumulate(np.where(ok, np.arange(len(q)), -1))
    held = np.where((last >= 0)[:, None], q[last], q_start)
    turned = np.unwrap(np.vstack([q_start, held]), axis=0)[1:]
    if isinstance(inverse, OnRail):
        slides = np.flatnonzero(inverse.rail.slides)
        turned[:, slides] = held[:, slides]
    return turned, ok


@njit
def branches_of(kind: int) -> int:
    """How many branches an arm of a kind has."""
    return skew_wrist_kernel.SLOTS if kind % CORRECTED == SKEW_WRIST else spherical_wrist.BRANCHES


# ----------------------------------------------------------------------------------------------------
# One compiled entry point for all kinds.
#
# Callers of `solve_one` compile no kind's solver: it is called by its address, and compiled only for arms of its kind.


class SolverAddresses(NamedTuple):
    """Addresses, in this process, of an arm's compiled solver.

    own    of its kind's closed form or search
    whole  of the solver that corrects postures or accounts for a carrier, and calls `own`; 0 if neither is needed
    """

    own: int
    whole: int


def solver_of(inverse: InverseKinematics) -> SolverAddresses:
    """The solver of an arm, compiled or loaded for this process."""
    kind = kind_of(inverse)
    own = address_of(_ENTRIES[kind % CORRECTED], _OWN)
    return SolverAddresses(own, address_of(_whole_entry, _WHOLE) if kind >= CORRECTED else 0)


@inner_njit
def solve_one(
    kind: int, solver: SolverAddresses, p: Array, redundant: Array, T: Array, q: Array, ok: NDArray[np.bool_]
) -> None:
    """Fill q (B, n) and ok (B) with the postures for one flange pose T (4, 4); B: `branches_of`.

    kind, solver, p  of the arm: `kind_of`, `solver_of`, `parameters`
    redundant (k)  the redundant joints' angles or places [rad, m]; without any, one arbitrary number
    """
    if kind < CORRECTED:
        call_at(solver.own, (p, p.size, redundant[0], T, q, ok))
    else:
        call_at(solver.whole, (kind, solver.own, p, p.size, redundant, redundant.size, T, q, q.shape[1], ok))


@njit
def _solve_whole(
    kind: int, own_solver: int, p: Array, redundant: Array, T: Array, q: Array, ok: NDArray[np.bool_]
) -> None:
    """As `solve_one`, for an arm that is corrected, carried, or both."""
    if kind < ON_RAIL:
        _solve_standing(kind, own_solver, p, redundant[0], T, q, ok)
        return
    rails = int(p[0])
    seen, own = np.empty((4, 4)), np.empty((q.shape[0], q.shape[1] - rails))
    ends = length(rails)
    _seen_from_arm(p[:ends], redundant, T[:3, :3], T[:3, 3], seen)
    _solve_standing(kind - ON_RAIL, own_solver, p[ends:], redundant[redundant.size - 1], seen, own, ok)
    for k in range(ok.size):
        for j in range(rails):
            q[k, j] = redundant[j]
        for j in range(own.shape[1]):
            q[k, j + rails] = own[k, j]


@inner_njit
def _solve_standing(
    kind: int, own_solver: int, p: Array, redundant: float, T: Array, q: Array, ok: NDArray[np.bool_]
) -> None:
    """The same for an arm whose base does not move."""
    own = p[length(q.shape[1]) :] if kind >= CORRECTED else p
    call_at(own_solver, (own, own.size, redundant, T, q, ok))
    if kind >= CORRECTED:
        refine_branches(p, T[:3, :3], T[:3, 3], q, ok)


# Each kind's solver as C calls it: parameters and their number, the redundant joint, a flange pose (4, 4), q and ok.
_OWN = "void(CPointer(float64), int64, float64, CPointer(float64), CPointer(float64), CPointer(boolean))"
_WHOLE = (
    "void(int64, int64, CPointer(float64), int64, CPointer(float64), int64, CPointer(float64), CPointer(float64), int64,"
    " CPointer(boolean))"
)
_solve_spherical, _solve_offset, _solve_seven, _solve_placed, _solve_skew = (
    spherical_wrist.solve_one,
    offset_wrist.solve_one,
    seven_axes_kernel.solve_one,
    placed_wrist.solve_one,
    skew_wrist_kernel.solve_one,
)
_CLOSED, _SEARCHED = spherical_wrist.BRANCHES, skew_wrist_kernel.SLOTS


def _spherical_entry(p: Any, n: int, redundant: float, T: Any, q: Any, ok: Any) -> None:
    T = array_at(T, (4, 4))
    _solve_spherical(array_at(p, (n,)), T[:3, :3], T[:3, 3], array_at(q, (_CLOSED, 6)), array_at(ok, (_CLOSED,)))


def _offset_entry(p: Any, n: int, redundant: float, T: Any, q: Any, ok: Any) -> None:
    T = array_at(T, (4, 4))
    _solve_offset(array_at(p, (n,)), T[:3, :3], T[:3, 3], array_at(q, (_CLOSED, 6)), array_at(ok, (_CLOSED,)))


def _placed_entry(p: Any, n: int, redundant: float, T: Any, q: Any, ok: Any) -> None:
    T = array_at(T, (4, 4))
    _solve_placed(array_at(p, (n,)), T[:3, :3], T[:3, 3], array_at(q, (_CLOSED, 6)), array_at(ok, (_CLOSED,)))


def _skew_entry(p: Any, n: int, redundant: float, T: Any, q: Any, ok: Any) -> None:
    T = array_at(T, (4, 4))
    _solve_skew(array_at(p, (n,)), T[:3, :3], T[:3, 3], array_at(q, (_SEARCHED, 6)), array_at(ok, (_SEARCHED,)))


def _seven_entry(p: Any, n: int, redundant: float, T: Any, q: Any, ok: Any) -> None:
    T, q, ok = array_at(T, (4, 4)), array_at(q, (_CLOSED, 7)), array_at(ok, (_CLOSED,))
    _solve_seven(array_at(p, (n,)), redundant, T[:3, :3], T[:3, 3], q, ok)


_ENTRIES = {
    SPHERICAL_WRIST: _spherical_entry,
    OFFSET_WRIST: _offset_entry,
    SEVEN_AXES: _seven_entry,
    PLACED_WRIST: _placed_entry,
    SKEW_WRIST: _skew_entry,
}


def _whole_entry(
    kind: int, own_solver: int, p: Any, n: int, redundant: Any, k: int, T: Any, q: Any, joints: int, ok: Any
) -> None:
    branches = branches_of(kind)
    q, ok = array_at(q, (branches, joints)), array_at(ok, (branches,))
    _solve_whole(kind, own_solver, array_at(p, (n,)), array_at(redundant, (k,)), array_at(T, (4, 4)), q, ok)
