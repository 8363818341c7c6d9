"""Whether a part can be printed at all: a plain search of a fine grid for a continuous motion along each bead.

It shares no search with the planner, only the cell, its inverse kinematics and its obstacles. At rungs along a bead,
the states are all rolls and chosen joints on a grid, all branches, and joints in whole turns as their ranges allow. States
are connected where no joint leaps. Between rungs, roll and chosen joints run straight, and finally every sample of the task
is checked. A motion that is found is therefore real: it has been followed from end to end. If none is found, that proves
nothing: the grid has gaps, the nozzle is never tilted, and crowded rungs keep a random part of their states. Travel between
beads and the joints' speed limits are ignored; `plan_along` shows what a plan along the motion is worth.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

from planner.base.arrays import Array, Ints
from planner.cell.cell import Cell, build_cell, rigid_inverse
from planner.collision.scene import Obstacles
from planner.planning.context import context_of
from planner.planning.options import DEFAULT_DT
from planner.planning.pipeline import trajectory_of
from planner.problem import Problem
from planner.resolve.joint_path import JointPath, choose_turns, postures, upright
from planner.toolpath.build import build_toolpath
from planner.toolpath.task import NozzleTask
from planner.verify.verdict import Report, verify

STEPS_DEG = (5.0, 5.0, 10.0, 15.0)  # of roll and chosen joints on the grid, for 0, 1, 2, 3 chosen joints
MOVES = (2, 2, 1, 1)  # steps that each may go between rungs
RUNG, RUNG_TURN = 5e-3, np.radians(8.0)  # a rung is at most so far from the next one, along the bead and in its normal
MOST_RUNGS = 1000  # of all beads: beyond, nothing is searched
MOST_STATES = 2_500  # at a rung
TRIED = (20_000, 8_000)  # states at a rung that are looked at, at most: in ranges and cones, and for collisions
LOOKS = 4  # at ways between rungs, while they are many
LEAP, SMALL_LEAP = 0.5, 0.2  # rad: most that an arm's joint moves between rungs, and between samples
ROOM = 1e-3  # m of clearance besides what is needed, at rungs: between them it is looked at in the end only
MOST_STARTS = 50_000  # of the grid where a bead begins
STARTS = 3  # turns of a chosen joint that a bead may begin in, spread over its range
CLOSE = 1e-6  # m: how exactly a motion is on its bead
TURN = 2.0 * np.pi


@dataclass(frozen=True)
class Found:
    """A motion q (n, nj) for each bead, or none; words: what to say of it."""

    motion: tuple[Array, ...]
    words: str

    def __bool__(self) -> bool:
        return bool(self.motion)


@dataclass(frozen=True)
class _States:
    """Where the search may be at a rung: grid (n, 1 + k) numbers of roll and chosen joints, branch (n), joints q (n, nj)
    with whole turns, the state (n) at the rung before that led here, and how long (n) [s] it takes to come here with all
    joints at their greatest speeds."""

    grid: Ints
    branch: Ints
    q: Array
    parent: Ints
    time: Array

    def __len__(self) -> int:
        return len(self.branch)

    def only(self, kept: NDArray[np.bool_] | Ints) -> _States:
        return _States(*(getattr(self, field)[kept] for field in _FIELDS))


@dataclass(frozen=True)
class _Search:
    """What is searched: a bead in a cell. Angles of the grid are its numbers times the step [rad]."""

    cell: Cell
    task: NozzleTask
    obstacles: Obstacles
    min_sigma: float

    @property
    def chosen(self) -> list[int]:
        return list(self.cell.chosen)

    @property
    def step(self) -> float:
        return float(np.radians(STEPS_DEG[len(self.chosen)]))

    def solve(self, sample: Ints, roll: Array, chosen: Array) -> tuple[Array, NDArray[np.bool_]]:
        """Postures (m, B, nj) at samples (m) for rolls (m) and chosen joints (m, k) [rad], and which exist (m, B)."""
        cell, nh = self.cell, len(self.cell.holder)
        turned = np.tile(np.eye(4), (len(sample), 1, 1))
        c, s = np.cos(roll), np.sin(roll)
        turned[:, 0, 0], turned[:, 0, 1], turned[:, 1, 0], turned[:, 1, 1] = c, -s, s, c
        T_part_task = np.tile(np.eye(4), (len(sample), 1, 1))
        T_part_task[:, :3, :3], T_part_task[:, :3, 3] = self.task.frames[sample], self.task.tip[sample]
        T_world_nozzle = cell.holder.poses(chosen[:, :nh]) @ T_part_task @ turned
        T_base_flange = rigid_inverse(cell.T_world_base) @ T_world_nozzle @ rigid_inverse(cell.T_flange_nozzle)
        redundant = np.ascontiguousarray(chosen[:, nh:]) if cell.given else None
        arm, ok = cell.inverse.solve(np.ascontiguousarray(T_base_flange), redundant)
        q = np.zeros((*ok.shape, len(cell.home)))
        q[..., : len(cell.arm)] = arm
        q[..., self.chosen] = chosen[:, None]
        return q, ok

    def allowed(self, q: Array) -> NDArray[np.bool_]:
        """Which postures (n, nj) are within the joints' ranges, away from singularities and within the cones."""
        cell, cones = self.cell, self.task.cones
        ok = ((q >= cell.limits.q_min) & (q <= cell.limits.q_max)).all(axis=1)
        # not tilted, the nozzle is as far from plumb as the layer from level
        down = -cell.arm.poses(q[ok, : len(cell.arm)])[:, 2, 2]
        ok[ok] = down >= np.cos(min(cones.nozzle_gravity, cones.layer_gravity)) - 1e-9
        jacobians = cell.arm.jacobians(q[ok, : len(cell.arm)])[:, :, cell.rails :]  # a rail would hide singularities
        ok[ok] = np.linalg.svd(jacobians, compute_uv=False)[:, 5] >= self.min_sigma
        return ok

    def clear(self, q: Array, sample: Ints, room: float) -> NDArray[np.bool_]:
        """Which postures (n, nj) at samples (n) keep what is needed and some room [m] from everything."""
        margin, _ = self.obstacles.margins(q, self.task.moments[sample], 0.0, room)
        return np.asarray(margin >= 0.0)

    def start(self, sample: int, rng: np.random.Generator) -> _States:
        """All states at a sample, each joint of the arm in all its turns."""
        limits, across = self.cell.limits, [np.arange(round(TURN / self.step))]
        for j in self.chosen:
            low, high = limits.q_min[j], limits.q_max[j]
            first = np.arange(np.ceil(low / self.step), np.floor(high / self.step) + 1, dtype=np.int64)
            turn = round(TURN / self.step)
            if len(first) > STARTS * turn:
                begins = np.linspace(0, len(first) - turn, STARTS).astype(int)
                first = np.unique(np.concatenate([first[b : b + turn] for b in begins]))
            across.append(first)
        grid = np.stack(np.meshgrid(*across, indexing="ij"), axis=-1).reshape(-1, len(across)).astype(np.int64)
        grid = _some(grid, MOST_STARTS, rng)
        q, ok = self.solve(np.full(len(grid), sample), grid[:, 0] * self.step, grid[:, 1:] * self.step)
        at, branch = np.nonzero(ok)
        states = _States(grid[at], branch, q[at, branch], np.full(len(at), -1), np.zeros(len(at)))
        for j in self.cell.solved:
            turns = np.arange(np.ceil((limits.q_min[j] - np.pi) / TURN), np.floor((limits.q_max[j] + np.pi) / TURN) + 1)
            shifted = []
            for turn in turns:
                q = states.q.copy()
                q[:, j] += turn * TURN
                inside = (q[:, j] >= limits.q_min[j]) & (q[:, j] <= limits.q_max[j])
                shifted.append(replace(states, q=q).only(inside))
            states = _States(*(np.concatenate([getattr(each, field) for each in shifted]) for field in _FIELDS))
        return self.kept(states.only(self.allowed(states.q)), sample, rng)

    def kept(self, states: _States, sample: int, rng: np.random.Generator) -> _States:
        """A part of the states at a sample that may be."""
        states = _picked(states, TRIED[0], rng)
        states = _picked(states.only(self.allowed(states.q)), TRIED[1], rng)
        clear = self.clear(states.q, np.full(len(states), sample), ROOM)
        return _picked(states.only(clear), MOST_STATES, rng)

    def onward(self, before: _States, a: int, b: int, rng: np.random.Generator) -> _States:
        """The states at sample b that can be reached from those at sample a."""
        k, turn = len(self.chosen), round(TURN / self.step)
        moves = np.array(list(itertools.product(range(-MOVES[k], MOVES[k] + 1), repeat=1 + k)))
        grid = (before.grid[:, None] + moves).reshape(-1, 1 + k)
        grid[:, 0] %= turn
        parent = np.repeat(np.arange(len(before)), len(moves))
        places, which = _distinct(grid)
        q, ok = self.solve(np.full(len(places), b), places[:, 0] * self.step, places[:, 1:] * self.step)
        branch = before.branch[parent]
        there, was = q[which, branch], before.q[parent]
        arm = list(self.cell.solved)
        there[:, arm] += TURN * np.round((was[:, arm] - there[:, arm]) / TURN)
        leap = np.abs(there - was)[:, arm].max(axis=1)
        limits = self.cell.limits
        inside = ok[which, branch] & (leap <= LEAP) & ((there >= limits.q_min) & (there <= limits.q_max)).all(axis=1)
        time = before.time[parent] + (np.abs(there - was) / limits.velocity).max(axis=1)
        # of several ways to the same state the quickest
        at = np.nonzero(inside)[0][np.argsort(time[inside], kind="stable")]
        turns = np.round((there[at] - q[which[at], branch[at]]) / TURN).astype(np.int64)
        _, first = np.unique(_codes(np.column_stack([which[at], branch[at], turns])), return_index=True)
        at = at[first]
        states = self.kept(_States(grid[at], branch[at], there[at], parent[at], time[at]), b, rng)
        looks = np.unique(np.linspace(a, b, LOOKS + 1).astype(np.int64))
        return states.only(self.between(before, states, looks)[1])

    def between(self, before: _States, states: _States, looks: Ints) -> tuple[Array, NDArray[np.bool_]]:
        """Postures (n, m, nj) on the way to each state at samples (1 + m), the first of them left out, and which ways
        exist (n)."""
        n, samples, gone = len(states), looks[1:], self.task.s[looks] - self.task.s[looks[0]]
        share = (gone[1:] / gone[-1])[None, :, None]
        turn = round(TURN / self.step)
        from_, went = before.grid[states.parent], states.grid - before.grid[states.parent]
        went[:, 0] = (went[:, 0] + turn // 2) % turn - turn // 2
        angles = ((from_[:, None] + share * went[:, None]) * self.step).reshape(n * len(samples), from_.shape[1])
        every, exists = self.solve(np.tile(samples, n), angles[:, 0], angles[:, 1:])
        branch = np.repeat(states.branch, len(samples))
        q = every[np.arange(len(branch)), branch].reshape(n, len(samples), every.shape[-1])
        ok = exists[np.arange(len(branch)), branch].reshape(n, len(samples)).all(axis=1)
        arm = list(self.cell.solved)
        with_start = np.concatenate([before.q[states.parent][:, None], q], axis=1)
        with_start[..., arm] = np.unwrap(with_start[..., arm], axis=1)
        q, limits = with_start[:, 1:], self.cell.limits
        ok &= (np.abs(np.diff(with_start, axis=1))[..., arm] <= SMALL_LEAP).all(axis=(1, 2))
        ok &= (np.abs(q[:, -1] - states.q) < 1e-6).all(axis=1)
        return q, ok & ((q >= limits.q_min) & (q <= limits.q_max)).all(axis=(1, 2))

    def motion(self, rungs: Ints, rng: np.random.Generator) -> tuple[Array | None, int]:
        """Postures (n, nj) at all samples of the bead, or none, and the sample up to which there are some."""
        layers = [self.start(int(rungs[0]), rng)]
        for a, b in itertools.pairwise(rungs.tolist()):
            if not len(layers[-1]):
                return None, a
            layers.append(self.onward(layers[-1], a, b, rng))
        if not len(layers[-1]):
            return None, int(rungs[-1])
        k, pieces = int(np.argmin(layers[-1].time)), []
        for i in range(len(rungs) - 1, 0, -1):
            state = layers[i].only(np.array([k]))
            q, _ = self.between(layers[i - 1], state, np.arange(rungs[i - 1], rungs[i] + 1))
            pieces.append(q[0])
            k = int(state.parent[0])
        q = np.vstack([layers[0].q[[k]], *pieces[::-1]])
        every = np.arange(len(q))
        good = self.allowed(q) & self.clear(q, every, 0.0) & self.on_path(q)
        good[1:] &= (np.abs(np.diff(q, axis=0)) <= SMALL_LEAP).all(axis=1)
        return (q, len(q) - 1) if good.all() else (None, int(np.argmin(good)))

    def on_path(self, q: Array) -> NDArray[np.bool_]:
        """Which postures (n, nj) at all samples hold the tip on the bead and the axis on its normal."""
        T = self.cell.T_part_nozzle(q)
        off = np.linalg.norm(T[:, :3, 3] - self.task.tip, axis=1)
        lean = np.linalg.norm(T[:, :3, 2] - self.task.frames[:, :, 2], axis=1)
        return np.asarray((off < CLOSE) & (lean < CLOSE))


_FIELDS = tuple(field.name for field in fields(_States))


def _some(rows: Ints, most: int, rng: np.random.Generator) -> Ints:
    return rows if len(rows) <= most else rows[np.sort(rng.choice(len(rows), most, replace=False))]


def _picked(states: _States, most: int, rng: np.random.Generator) -> _States:
    return states.only(_some(np.arange(len(states)), most, rng))


def _codes(rows: Ints) -> Ints:
    """A number (n) for each row (n, m) of whole numbers; the same for the same rows only."""
    low = rows.min(axis=0, initial=0)
    sizes = rows.max(axis=0, initial=0) - low + 1
    return np.asarray((rows - low) @ np.concatenate([[1], np.cumprod(sizes[:-1])]))


def _distinct(rows: Ints) -> tuple[Ints, Ints]:
    """Distinct rows, and which of them each row is."""
    _, first, which = np.unique(_codes(rows), return_index=True, return_inverse=True)
    return rows[first], which


def rungs_of(task: NozzleTask) -> Ints:
    """Samples of a task, the first and the last among them, that are near enough to each other."""
    z = task.frames[:, :, 2]
    turned = 2.0 * np.arcsin(np.clip(0.5 * np.linalg.norm(np.diff(z, axis=0), axis=1), 0.0, 1.0))
    gone = np.concatenate([[0.0], np.cumsum(np.maximum(np.diff(task.s) / RUNG, turned / RUNG_TURN))])
    count = int(np.ceil(gone[-1]))
    return np.unique(np.searchsorted(gone, np.linspace(0.0, gone[-1], max(count, 1) + 1)).clip(0, len(z) - 1))


def find_motion(problem: Problem, seed: int = 0) -> Found:
    """Search each bead of a problem in turn; seed: of the part that crowded rungs keep."""
    cell = build_cell(problem)
    given = context_of(problem, cell, build_toolpath(problem))
    rungs = [rungs_of(task) for task in given.tasks]
    count = sum(len(each) for each in rungs)
    if count > MOST_RUNGS:
        return Found((), f"not searched: {count} rungs of at most {MOST_RUNGS}")
    if len(cell.chosen) >= len(STEPS_DEG):
        return Found((), f"not searched: {len(cell.chosen)} chosen joints")
    rng, motions, quickest = np.random.default_rng(seed), [], 0.0
    for task, at in zip(given.tasks, rungs, strict=True):
        q, end = _Search(cell, task, given.obstacles, problem.resolve.min_sigma).motion(at, rng)
        if q is None:
            return Found((), f"none found: bead {task.bead}, up to {1e3 * max(task.s[end], 0.0):.1f} mm")
        motions.append(q)
        quickest = max(quickest, _share_of_speed(cell, task, q))
    return Found(tuple(motions), f"a continuous motion, with joints at {quickest:.2g} times their greatest speed")


def _share_of_speed(cell: Cell, task: NozzleTask, q: Array) -> float:
    """The greatest joint speed along a motion at the commanded speed, over that joint's limit."""
    rates = np.abs(np.diff(q, axis=0) / np.diff(task.s)[:, None]) * task.speed
    return float((rates / cell.limits.velocity).max())


def plan_along(problem: Problem, motion: Sequence[Array]) -> Report:
    """What verification says of a plan along a motion that was found, its corners at rungs smoothed.

    Raises Refusal where smoothing takes it out of reach or range.
    """
    cell = build_cell(problem)
    given = context_of(problem, cell, build_toolpath(problem))
    paths = []
    for task, q in zip(given.tasks, motion, strict=True):
        x = cell.T_part_nozzle(q)[:, :3, 0]
        sine, cosine = ((x * task.frames[:, :, k]).sum(axis=1) for k in (1, 0))
        free = np.column_stack([np.unwrap(np.arctan2(sine, cosine)), q[:, list(cell.chosen)]])
        free = gaussian_filter1d(free, RUNG / float(np.diff(task.s).mean()), axis=0, mode="nearest")
        branch = int(cell.inverse.branches(q[:1, : len(cell.arm)])[0])
        arm = postures(cell, task, free[:, 0], free[:, 1:], branch)
        paths.append(JointPath(task, free[:, 0], upright(task), arm, branch))
    turned = choose_turns(cell, paths)
    trajectory, _ = trajectory_of(problem, cell, given.toolpath, turned, given.obstacles, DEFAULT_DT, False)
    return verify(problem, cell, given.toolpath, trajectory, given.body)
