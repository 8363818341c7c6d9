"""Beads that pause: the fewest pauses against brute force, beads in pieces, and prints that need them."""

from __future__ import annotations

import itertools
import json
from pathlib import Path

import numpy as np
import pytest
from test_candidates import helix

from planner.base.arrays import Array
from planner.base.errors import InputError, Refusal
from planner.export.plan_json import SPLIT_KEYS, plan_json
from planner.planning.pipeline import solve
from planner.problem import load_problem
from planner.resolve.prices import FAR
from planner.resolve.search import LadderNumbers, TravelLimits, TurnsCounted, search_best
from planner.toolpath.build import build_toolpath
from planner.toolpath.split import split_toolpath

R, A, B, C = 12, 4, 3, 2
STEP = 2.0 * np.pi / B
LOW, HIGH = np.radians([-250.0, -200.0]), np.radians([250.0, 200.0])


def some_ladder(seed: int, sweeps: bool) -> tuple[LadderNumbers, TravelLimits, TurnsCounted]:
    """A bead's whole grid whose two joints drift along it, the first one round and round, with holes."""
    rng = np.random.default_rng(seed)
    b = B if sweeps else 1
    q = np.zeros((R, A, b, C, 2))
    q[..., 0] = np.cumsum(rng.uniform(-0.2, 0.9, R))[:, None, None, None]
    q += rng.uniform(-0.4, 0.4, q.shape)
    q[..., 0] = (q[..., 0] + np.pi) % (2.0 * np.pi) - np.pi
    price = rng.uniform(0.0, 1.0, q.shape[:4])
    price[rng.random(price.shape) < 0.35] = np.inf
    zero = np.zeros(R, dtype=np.int64)
    ladder = LadderNumbers(
        q.astype(np.float32), price, zero, zero, True, STEP if sweeps else 2.0 * np.pi,
        np.array([0, R]), np.full(R, 0.3),
    )  # fmt: skip
    wind = np.array([0, 2] if sweeps else [0])
    k = len(wind)
    turns = TurnsCounted(wind, np.full(k, -2), np.full(k, 5), LOW[:k], HIGH[:k])
    return ladder, TravelLimits(np.full(3, 3.0), np.full(3, 15.0), np.array([True, False]), FAR, FAR), turns


def reached(ladder: LadderNumbers, limits: TravelLimits, first: int, sweeps: bool) -> int:
    """The last rung that a way from any node of one rung leads to: whole angles, one after the other, in plain Python."""

    def places(r: int, i: int, b: int, c: int) -> list[tuple[float, ...]]:
        """All places of what winds at a node."""
        values = [float(ladder.q[r, i, b, c, 0])] + ([b * STEP] if sweeps else [])
        each = [
            [x for x in value + 2.0 * np.pi * np.arange(-4, 5) if low <= x <= high]
            for value, low, high in zip(values, LOW, HIGH, strict=False)
        ]
        return list(itertools.product(*each))

    nodes = list(itertools.product(range(A), range(ladder.price.shape[2]), range(C)))
    states = {
        (node, tuple(np.round(at, 6)))
        for node in nodes
        if np.isfinite(ladder.price[first, *node])
        for at in places(first, *node)
    }
    for r in range(first + 1, R):
        after = set()
        for ((i0, b0, c), at), (i, b, c1) in itertools.product(states, nodes):
            if c1 != c or not np.isfinite(ladder.price[r, i, b, c]) or not np.isfinite(ladder.price[r, i0, b0, c]):
                continue
            if (i - i0 + 1) % A > 2 or (sweeps and (b - b0 + 1) % B > 2):
                continue
            d = (ladder.q[r, i, b, c] - ladder.q[r - 1, i0, b0, c]).astype(float)
            d[0] -= 2.0 * np.pi * np.round(d[0] / (2.0 * np.pi))
            if np.abs(d).max() > FAR:
                continue
            ways = [d[0]] + ([(b - b0 + 1) % B * STEP - STEP] if sweeps else [])
            for to in places(r, i, b, c):
                if np.allclose(np.array(to) - at, ways, atol=1e-4):
                    after.add(((i, b, c), tuple(np.round(to, 6))))
        if not after:
            return r - 1
        states = after
    return R - 1


@pytest.mark.parametrize("sweeps", [False, True])
@pytest.mark.parametrize("seed", range(6))
def test_fewest_pauses_against_the_longest_pieces(seed: int, sweeps: bool) -> None:
    """Pieces as long as can be, one after the other, are as few as can be."""
    ladder, limits, turns = some_ladder(seed, sweeps)
    may = np.ones(R, dtype=np.bool_)
    may[[0, -1]] = False
    pieces, at = 0, 0
    while at < R - 1:
        to = reached(ladder, limits, at, sweeps)
        pieces, at = pieces + 1, to if to > at else R
    free = np.zeros((*ladder.price.shape[1:], int(turns.number.prod())))
    before, after, _, stuck = search_best(ladder, limits, turns, may, free, free)
    assert (stuck >= 0) == (at == R)
    if stuck >= 0:
        return
    paused = np.flatnonzero((before != after).any(axis=1))
    assert len(paused) == pieces - 1
    for r in range(R):
        assert np.isfinite(ladder.price[r, *before[r, :3]]) and np.isfinite(ladder.price[r, *after[r, :3]])
    for r in range(1, R):
        assert before[r, 2] == after[r - 1, 2]  # the branch changes at pauses alone


def test_random_ladders_need_pauses() -> None:
    """What the test above is worth."""
    assert len({reached(some_ladder(seed, False)[0], some_ladder(seed, False)[1], 0, False) for seed in range(6)}) > 1


@pytest.mark.slow
def test_a_bead_in_pieces_is_the_same_bead() -> None:
    toolpath = build_toolpath(load_problem("cylinder_logo", ["layers.count=1"]))
    k = int(np.argmax([bead.length for bead in toolpath.beads]))
    whole = toolpath.beads[k]
    places = [0.3 * whole.length, 0.61 * whole.length]
    cut = split_toolpath(toolpath, {k: [(s, f"because {i}") for i, s in enumerate(places)]})
    assert len(cut.beads) == len(toolpath.beads) + 2
    pieces = cut.beads[k : k + 3]
    assert cut.length == pytest.approx(toolpath.length)
    assert cut.beads[k + 3 :] == toolpath.beads[k + 1 :]
    assert not any(piece.closed for piece in pieces)
    assert len({bead.name for bead in cut.beads}) == len(cut.beads)
    np.testing.assert_array_equal(np.vstack([pieces[0].points, *(p.points[1:] for p in pieces[1:])]), whole.points)
    for before, after in itertools.pairwise(pieces):
        np.testing.assert_array_equal(before.points[-1], after.points[0])
        np.testing.assert_allclose(before.source[-1], after.source[0])
        assert np.linalg.norm(after.source[0] - after.points[0]) < 0.2e-3

    def drawn(source: Array) -> float:
        return float(np.linalg.norm(np.diff(source, axis=0), axis=1).sum())

    assert sum(drawn(piece.source) for piece in pieces) == pytest.approx(drawn(whole.source))
    begin = 0.0
    for i, piece in enumerate(pieces):
        tips = piece.points[::7]
        theirs = toolpath.surface.normals_on(k, piece.s[::7] + begin, tips)
        np.testing.assert_allclose(cut.surface.normals_on(k + i, piece.s[::7], tips), theirs)
        begin += piece.length
    assert [(split.bead, split.name, split.layer, split.why) for split in cut.splits] == [
        (k + 1, whole.name, 0, "because 0"),
        (k + 2, whole.name, 0, "because 1"),
    ]
    np.testing.assert_allclose([split.s for split in cut.splits], places, atol=0.5e-3)
    assert f"path '{whole.name}' of layer 1 is laid in 3 pieces" in cut.notes[-1]


def test_the_switch_is_true_or_false() -> None:
    with pytest.raises(InputError, match="must be true or false"):
        load_problem("cylinder_logo", ["process.split_beads='yes'"])


STIFF = "cell.limits={rotation: {range_deg: [-200, 200]}, joint_4: {range_deg: [-60, 60]}}"


@pytest.mark.slow
def test_a_helix_beyond_all_ranges_is_printed_in_pieces(tmp_path: Path) -> None:
    problem = load_problem(helix(tmp_path, 5.0).file, [STIFF])
    with pytest.raises(Refusal):
        solve(problem, baseline=False)
    plan = solve(load_problem(problem.file, [STIFF, "process.split_beads=true"]), baseline=False)
    assert plan.verified
    splits = json.loads(plan_json(plan))["splits"]
    assert [list(split) for split in splits] == [list(SPLIT_KEYS)] * len(splits)
    # five turns of the table, in 400 degrees each
    assert len(splits) == 4
    assert all(split["why"] == "rotation would turn further than its range" for split in splits)
    assert [split["bead"] for split in splits] == [1, 2, 3, 4]
    assert plan.metrics["at_speed_fraction"] > 0.99


@pytest.mark.slow
def test_what_can_be_followed_in_one_go_is_not_cut(tmp_path: Path) -> None:
    """A range of 800 degrees for three turns: the arm has to go round a part of them, which prices alone did not find."""
    limits = "cell.limits={rotation: {range_deg: [-400, 400]}}"
    plan = solve(load_problem(helix(tmp_path, 3.0).file, [limits, "process.split_beads=true"]), baseline=False)
    assert plan.verified
    assert plan.toolpath.splits == ()
    assert "splits" not in json.loads(plan_json(plan))
